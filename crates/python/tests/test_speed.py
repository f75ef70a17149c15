"""Speed as a ratio to the command line's on the same log."""

from __future__ import annotations

import resource
import time
from pathlib import Path

import pytest
import seepd
from conftest import run


@pytest.mark.long
def test_arrays_and_logs_are_replayed_as_fast_as_by_the_command_line(tmp_path: Path) -> None:
    log = tmp_path / "long.mcap"
    run("simulate", "--out", log, "--cycles", "60", "--seed", "3", "--command-only")
    command = seepd.read(log)["command"]

    def processor_s(work: object) -> float:
        """The least of five: what disturbs only adds."""
        times = []
        for _ in range(5):
            begin = time.process_time()
            work()  # type: ignore[operator]
            times.append(time.process_time() - begin)
        return min(times)

    def of_program() -> float:
        times = []
        for words in (["replay", "--quiet", log], ["--version"]) * 5:
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            run(*words)
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            times.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
        return min(times[::2]) - min(times[1::2])

    program = of_program()
    logs, arrays = processor_s(lambda: seepd.replay(log)), processor_s(lambda: seepd.replay({"command": command}))
    print(
        f"program {1e9 * program / len(command):.0f} ns a sample, log {1e9 * logs / len(command):.0f}, arrays {1e9 * arrays / len(command):.0f}"
    )
    assert program / logs > 0.9
    assert program / arrays > 0.9

"""Bad input: an exception of the right kind, with the line that the program ends with."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import seepd
from conftest import run


def line_of(*words: str | Path) -> tuple[int, str]:
    ended = run(*words, check=False)
    return ended.returncode, ended.stderr.removeprefix("seepd: ").strip()


def test_lines_and_exit_codes_are_the_programs(tmp_path: Path, logs: Path) -> None:
    empty, config, model = tmp_path / "empty.mcap", tmp_path / "seepd.toml", tmp_path / "model.json"
    empty.write_bytes(b"")
    config.write_text("axsi = 'press'\n")
    model.write_text("{}")
    worn = logs / "worn.mcap"
    cases: list[tuple[type[seepd.SeepdError], list[str | Path], Callable[[], object]]] = [
        (seepd.NoInputError, ["replay", "nowhere.mcap"], lambda: seepd.replay("nowhere.mcap")),
        (seepd.DataError, ["replay", empty], lambda: seepd.replay(empty)),
        (seepd.ConfigurationError, ["replay", "--config", config, worn], lambda: seepd.replay(worn, config)),
        (seepd.ConfigurationError, ["replay", "--model", model, worn], lambda: seepd.replay(worn, model=model)),
        (seepd.UsageError, ["replay", "--reference-mpa", "0", worn], lambda: seepd.replay(worn, reference_mpa=0)),
        (
            seepd.UsageError,
            ["simulate", "--cycles", "0", "--out", tmp_path / "x.mcap"],
            lambda: seepd.simulate(cycles=0),
        ),
        (seepd.NoInputError, ["gap", "nowhere.mcap"], lambda: seepd.gap("nowhere.mcap")),
        (
            seepd.UsageError,
            ["train", "--observations", "1", "--out", tmp_path / "m.json"],
            lambda: seepd.train(observations=1),
        ),
        (seepd.NoInputError, ["evaluate", "nowhere.mcap"], lambda: seepd.evaluate("nowhere.mcap")),
        (
            seepd.DataError,
            ["evaluate", "--truth", "none_such", worn],
            lambda: seepd.evaluate(worn, truth="none_such"),
        ),
    ]
    for kind, words, call in cases:
        code, line = line_of(*words)
        with pytest.raises(seepd.SeepdError) as caught:
            call()
        assert type(caught.value) is kind, words
        assert (caught.value.exit_code, str(caught.value)) == (code, line), words
        assert "\n" not in line


def test_exceptions_are_those_that_python_programs_expect() -> None:
    with pytest.raises(FileNotFoundError):
        seepd.read("nowhere.mcap")
    with pytest.raises(ValueError, match="no signal"):
        seepd.replay({"comand": np.zeros(10)})


@pytest.mark.parametrize(
    ("call", "what"),
    [
        (lambda: seepd.replay({"load": np.zeros(9)}), "the command is missing"),
        (lambda: seepd.replay({"command": np.zeros(9), "load": np.zeros(8)}), "load has 8 values, the command 9"),
        (lambda: seepd.replay({"command": np.zeros((3, 3))}), "command has 2 dimensions"),
        (lambda: seepd.replay({"command": np.zeros(9)}, time_ns=[1, 2]), "time has 2 values, the signals 9"),
        (lambda: seepd.replay({"command": np.zeros(9)}, sample_rate_hz=-1.0), "it must be above 0"),
        (lambda: seepd.replay("x.mcap", sample_rate_hz=1.0), "belong to arrays"),
        (lambda: seepd.simulate(machines=0), "machines is 0"),
        (lambda: seepd.simulate(machines=2, pause=5.0), "simulate them one by one"),
        (lambda: seepd.simulate(out="x.mcap"), "an option of the command line alone"),
        (lambda: seepd.simulate(cylces=3), "unexpected argument '--cylces' found"),
        (lambda: seepd.simulate(effects={"valve_deadbnd.half_width": 0.1}), "valve_deadband"),
        (lambda: seepd.train(json=True), "an option of the command line alone"),
    ],
)
def test_wrong_arguments_are_named(call: Callable[[], object], what: str) -> None:
    with pytest.raises(seepd.UsageError) as caught:
        call()
    assert what in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_whose_name_begins_like_an_option(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(seepd.NoInputError, match="^--json: "):
        seepd.replay("--json")


def test_an_empty_array_is_no_machine_without_fault() -> None:
    cycles = seepd.replay({"command": np.zeros(0)})
    assert len(cycles) == 0 and cycles.summary["flag"] == "no_estimate"


def test_models_and_baselines_that_are_none(tmp_path: Path) -> None:
    file = tmp_path / "model.json"
    file.write_text("{")
    with pytest.raises(seepd.ConfigurationError, match="model.json"):
        seepd.Model.load(file)
    with pytest.raises(seepd.NoInputError):
        seepd.Model.load(tmp_path / "none.json")
    with pytest.raises(seepd.ConfigurationError, match="no baseline"):
        seepd.Baseline("{")
    with pytest.raises(seepd.IoError, match="writing"):
        seepd.Model.embedded().save(tmp_path / "none" / "model.json")

"""Tables: no copies on the way in and out, threads at work meanwhile, and numpy for those without pyarrow."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
import seepd


def test_absent_is_null_and_a_broken_reading_is_nan(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    log.write_text("t_s,command,load\n" + "".join(f"{t / 10},0.{t},{'' if t % 2 else t}\n" for t in range(1, 9)))
    table = seepd.read(log)
    assert table.column_names == ["time_ns", "command", "load"] and len(table) == 8
    assert table["time_ns"].dtype == np.int64 and table["time_ns"][1] == 200_000_000
    arrow = table.to_pyarrow()
    given = arrow["load"].to_pylist()
    assert [value for value in given if value is not None and value == value] == [2.0, 4.0, 6.0, 8.0]
    assert np.isnan(table["load"][0]) and table["load"][1] == 2.0


def test_arrow_is_handed_over_without_a_copy(logs: Path) -> None:
    table = seepd.read(logs / "worn.mcap")
    first, second = (pa.table(table)["command"].chunk(0).buffers()[1] for _ in range(2))
    assert first.address == second.address
    assert pa.schema(table) == table.to_pyarrow().schema


def test_what_is_handed_over_outlives_the_table(logs: Path) -> None:
    arrow = seepd.read(logs / "worn.mcap").to_pyarrow()
    assert arrow["command"].to_numpy()[:1000].std() > 0
    cycles = pa.table(seepd.replay(logs / "worn.mcap"))
    assert cycles["features"][3].as_py()


def test_arrays_are_not_copied_on_the_way_in() -> None:
    command = np.zeros(20_000_000)
    before = _resident_kib()
    seepd.replay({"command": command})
    # A copy would be 156,250 KiB.
    assert _resident_kib() - before < 40_000
    half = np.zeros(200, dtype=np.float32)[::2]
    assert len(seepd.replay({"command": half})) == 0  # copied, and read


def _resident_kib() -> int:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM"):
            return int(line.split()[1])
    raise AssertionError("no VmHWM")


def test_other_threads_run_meanwhile() -> None:
    command = seepd.simulate(cycles=3, command_only=True)["command"]
    long = np.tile(command, 150)
    ticks = 0
    done = threading.Event()

    def count() -> None:
        nonlocal ticks
        while not done.is_set():
            ticks += 1
            time.sleep(0.001)

    thread = threading.Thread(target=count)
    thread.start()
    begin = time.perf_counter()
    seepd.replay({"command": long})
    took = time.perf_counter() - begin
    done.set()
    thread.join()
    # With the lock held it would be 1 or 2 in all.
    assert took > 0.05 and ticks > 100 * took


def test_numpy_is_enough(logs: Path) -> None:
    program = f"""
import sys
sys.modules["pyarrow"] = None
import seepd
cycles = seepd.replay({str(logs / "worn.mcap")!r})
print(len(cycles), cycles["leak_area_m2"].dtype, cycles["flag"][-1], cycles["cycle"][-1])
try:
    cycles.to_pyarrow()
except ImportError as error:
    print(error)
"""
    told = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert told.splitlines() == [
        "24 float64 leak 23",
        "pyarrow is not installed, which this needs: pip install 'seepd[arrow]'",
    ]


def test_effects_are_the_catalogue() -> None:
    effects = {effect["effect"]: effect for effect in seepd.effects()}
    assert len(effects) == 32
    half_width = effects["valve_deadband"]["parameters"][0]
    assert half_width["name"] == "half_width" and half_width["neutral"] == 0.0
    low, high = half_width["range"]
    changed = seepd.simulate(cycles=1, effects={"valve_deadband.half_width": high})
    assert not np.array_equal(changed["command"], seepd.simulate(cycles=1)["command"])
    assert low < high


def test_a_models_features_and_size() -> None:
    model = seepd.Model.embedded()
    assert model.samples == 10_000 and "mean.hold_1" in model.features

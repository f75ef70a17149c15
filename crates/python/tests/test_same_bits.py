"""What Python gives is what the command line prints: not one bit differs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import seepd
from conftest import run


def json_lines(text: str) -> list[Any]:
    return [json.loads(line) for line in text.splitlines()]


def without_absent(value: Any) -> Any:
    """A row without its nulls: the JSON leaves some out, a table has every column."""
    if isinstance(value, dict):
        return {key: without_absent(each) for key, each in value.items() if each is not None}
    if isinstance(value, list):
        return [without_absent(each) for each in value]
    return value


def assert_same(cycles: seepd.Cycles, printed: list[Any]) -> None:
    rows = [without_absent(row) for row in cycles.to_pylist()]
    expected = [without_absent(line) for line in printed[:-1]]
    assert len(rows) > 10
    for row, line in zip(rows, expected, strict=True):
        # Dictionaries of floats are equal only where every bit is, but for the sign of zero.
        assert row == line
    assert cycles.summary == printed[-1]


def test_a_replayed_log(logs: Path) -> None:
    printed = json_lines(run("replay", "--json", logs / "worn.mcap").stdout)
    assert_same(seepd.replay(logs / "worn.mcap"), printed)


def test_a_log_against_a_baseline_with_causes_and_dates(logs: Path, tmp_path: Path) -> None:
    file = tmp_path / "baseline.json"
    run("learn-baseline", "--out", file, logs / "healthy.mcap")
    learned = seepd.learn_baseline(logs / "healthy.mcap")
    assert learned.text == file.read_text()
    printed = json_lines(run("replay", "--json", "--baseline", file, logs / "worn.mcap").stdout)
    cycles = seepd.replay(logs / "worn.mcap", baseline=learned)
    assert_same(cycles, printed)
    assert any(row["cause_candidates"] for row in cycles.to_pylist())
    assert_same(seepd.replay(logs / "worn.mcap", baseline=file), printed)


def test_two_logs_are_one_record(logs: Path) -> None:
    both = [logs / "healthy.mcap", logs / "worn.mcap"]
    printed = json_lines(run("replay", "--json", "--learn-cycles", "25", *both).stdout)
    cycles = seepd.replay(both, learn_cycles=25)
    assert_same(cycles, printed)
    assert any("its clock starts again" in note for note in cycles.notes)


def test_arrays_give_what_the_log_gives(logs: Path) -> None:
    table = seepd.read(logs / "worn.mcap")
    assert table.column_names[:2] == ["time_ns", "command"]
    printed = json_lines(run("replay", "--json", logs / "worn.mcap").stdout)
    signals = {name: table[name] for name in table.column_names[1:]}
    assert_same(seepd.replay(signals, time_ns=table["time_ns"]), printed)
    assert_same(seepd.replay(signals, sample_rate_hz=1000.0), printed)
    # At the model's own rate.
    assert_same(seepd.replay(signals), printed)


def test_a_simulated_log_is_the_one_that_is_written(logs: Path) -> None:
    table = seepd.read(logs / "worn.mcap")
    arrays = seepd.simulate(cycles=24, seed=6, leak_area=2e-8, leak_growth=2e-7, load_variation=0.02)
    assert np.array_equal(arrays["time_ns"], table["time_ns"])
    for name in table.column_names[1:]:
        assert arrays[name].tobytes() == np.asarray(table[name]).tobytes(), name


def test_machines_of_a_batch_are_those_that_are_simulated_alone() -> None:
    batch = seepd.simulate(machines=3, cycles=2, seed=11, parameter_spread=0.05, leak_area=1e-7)
    assert batch["command"].shape == (3, 20_000) and batch["time_ns"].shape == (20_000,)
    for index in range(3):
        alone = seepd.simulate(machine=11 + index, cycles=2, seed=11 + index, parameter_spread=0.05, leak_area=1e-7)
        assert batch["position"][index].tobytes() == alone["position"].tobytes()
    assert not np.array_equal(batch["command"][0], batch["command"][1])


def test_an_evaluation(logs: Path) -> None:
    printed = json.loads(run("evaluate", "--json", "--learn-cycles", "20", logs / "worn.mcap").stdout)
    with pytest.warns(seepd.SeepdWarning, match="its baseline was learned while the truth was a leak"):
        assert seepd.evaluate(logs / "worn.mcap", learn_cycles=20) == printed


@pytest.mark.long
def test_a_diagnosis(tmp_path: Path) -> None:
    log = tmp_path / "sticky.mcap"
    run("simulate", "--out", log, "--cycles", "13", "--with", "coulomb_friction.force_n=900")
    printed = json.loads(run("gap", "--json", "-", log).stdout)
    diagnosis = seepd.gap(log)
    told = diagnosis.to_dict()
    assert {**told, "seconds": 0} == {**printed, "seconds": 0}
    assert diagnosis.chosen == ["coulomb_friction"]
    plant = tmp_path / "as-it-is.toml"
    diagnosis.save_plant(plant)
    assert "coulomb_friction" in plant.read_text()
    assert diagnosis.curves["recorded"]["command"].shape == diagnosis.t_s.shape


SMALL = {"observations": 200, "held_out": 100, "trials": 2, "compared": 64, "causes": 0, "calibration": 64}


@pytest.mark.long
def test_a_trained_model(tmp_path: Path, logs: Path) -> None:
    out = tmp_path / "model.json"
    words = [f"--{name.replace('_', '-')}={value}" for name, value in SMALL.items()]
    report = json.loads(run("train", "--out", out, "--json", "--seed", "3", *words).stdout)
    model = seepd.train(seed=3, **SMALL)
    assert model.content == out.read_bytes()
    assert model.report is not None and {**model.report, "model": ""} == {**report, "model": ""}
    printed = json_lines(run("replay", "--json", "--model", out, logs / "worn.mcap").stdout)
    assert_same(seepd.replay(logs / "worn.mcap", model=model), printed)

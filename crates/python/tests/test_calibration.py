"""A solver of one's own on the gap: what it minimises is what the diagnosis minimises."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import seepd
from conftest import run

scipy_optimize = pytest.importorskip("scipy.optimize")

LEAK_M2, FRICTION_N = 4e-7, 1200.0
#: Independent values that a signal counts for.
VALUES_A_SIGNAL = 60
#: Share of a signal's range that any model may be off by.
MODEL_ERROR = 0.002


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A press with a leak and a friction that its plant file does not know of."""
    path = tmp_path_factory.mktemp("calibration") / "press.mcap"
    planted = ["--leak-area", str(LEAK_M2), "--with", f"coulomb_friction.force_n={FRICTION_N}"]
    run("simulate", "--out", path, "--cycles", "8", "--seed", "3", *planted)
    return path


def test_scipy_finds_what_was_planted(log: Path) -> None:
    problem = seepd.CalibrationProblem(log)
    keys = ["leak_area_m2", "coulomb_friction.force_n"]
    unit = np.array([1e-7, 1000.0])

    def machine(at: np.ndarray) -> dict[str, float]:
        return dict(zip(keys, at * unit, strict=True))

    def differences(at: np.ndarray) -> np.ndarray:
        return problem.residuals([machine(at)])[0]

    found = scipy_optimize.least_squares(differences, [0.5, 0.1], diff_step=1e-3)
    leak, friction = found.x * unit
    assert leak == pytest.approx(LEAK_M2, rel=0.02)
    assert friction == pytest.approx(FRICTION_N, rel=0.02)
    # What is left is what a perfect model leaves.
    assert np.sum(found.fun**2) < VALUES_A_SIGNAL * len(problem.signals)
    before, after = problem.held_out_gaps([{}, machine(found.x)])
    # No closer than cycles are to each other, or than any model is expected to be.
    assert all(after[signal] < max(1.5 * problem.floor[signal], MODEL_ERROR) for signal in problem.signals)
    assert before["command"] > 10 * after["command"]


def test_arrays_have_a_row_for_each_signal(log: Path) -> None:
    problem = seepd.CalibrationProblem(log, signals=["command", "position"])
    assert problem.signals == ["command", "position"]
    recorded, simulated = problem.recorded(), problem.simulated({"leak_area_m2": LEAK_M2})
    drives, signals, bins = recorded.shape
    assert signals == 2
    assert simulated.shape == (drives, len(problem.simulated_signals), bins)
    assert problem.residuals([{}, {}, {}]).shape == (3, recorded.size)
    demand, load = problem.drives()[0]
    assert demand.shape == load.shape == (round(problem.period_s * 1000),)
    # Where a controller asks for a position, there it is.
    of_bin = demand.reshape(bins, -1).mean(axis=1)
    assert np.abs(of_bin - recorded[0, 1]).max() < 0.02


def test_parameters_say_what_is_known_of_them(log: Path) -> None:
    problem = seepd.CalibrationProblem(log, without=["coulomb_friction"])
    mass = problem.parameters["mass_kg"]
    assert mass.effect is None and mass.logarithmic and mass.low < mass.value < mass.high
    assert mass.sigma == pytest.approx(np.log(2))
    effects = {parameter.effect for parameter in problem.parameters.values()}
    catalogue = {effect["effect"] for effect in seepd.effects()}
    assert effects == (catalogue - {"coulomb_friction"}) | {None}


def test_what_cannot_be_is_refused_in_a_line(log: Path) -> None:
    with pytest.raises(seepd.UsageError, match='there is no signal "pressure"'):
        seepd.CalibrationProblem(log, signals=["command", "pressure"])
    problem = seepd.CalibrationProblem(log)
    with pytest.raises(seepd.UsageError, match='there is no parameter "mass"'):
        problem.residuals([{"mass": 1.0}])
    with pytest.raises(seepd.DataError, match="the log has no command"):
        seepd.CalibrationProblem(log, signals=["position"])

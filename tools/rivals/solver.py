"""Calibration by SciPy's least squares: what the system identification of simulators such as MuJoCo and Isaac does.

Parameters have the bounds and priors that the diagnosis gives them, and count by their logarithm where they do there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.optimize
from seepd import CalibrationProblem

WEAR = "leak_area_m2"
#: Independent values that a signal counts for: a row's squares add up to so many for each signal of a perfect model.
VALUES_A_SIGNAL = 60
#: Leaks from which the best is the start.
LEAKS_M2 = (0.0, *np.geomspace(3e-9, 3e-5, 15))
#: Seed of the machines from which a search for an effect's size starts.
SEED = 1

Values = dict[str, float]


@dataclass(frozen=True)
class Fit:
    """A machine as fitted."""

    values: Values
    #: Squares of differences, and of distances from what was known, all over their expected errors.
    cost: float
    #: Squares of differences alone over what is expected of a perfect model.
    misfit: float


class Coordinates:
    """Parameters as a solver has them: each in units in which a change of one is large."""

    def __init__(self, problem: CalibrationProblem, keys: Sequence[str]) -> None:
        self.keys = list(keys)
        self._parameters = [problem.parameters[key] for key in keys]
        self.low = np.array([self._of(p, p.low) for p in self._parameters])
        self.high = np.array([self._of(p, p.high) for p in self._parameters])
        self.known = np.array([p.sigma is not None for p in self._parameters])
        self._sigma = np.array([np.inf if p.sigma is None else p.sigma / self._unit(p) for p in self._parameters])
        self._centre = np.array([self._of(p, p.value) if p.sigma is not None else 0.0 for p in self._parameters])
        self.step = np.array([2e-3 if p.logarithmic else 1e-2 for p in self._parameters])

    @staticmethod
    def _unit(parameter) -> float:
        if parameter.logarithmic:
            return 1.0
        return parameter.sigma or 0.2 * (parameter.high - parameter.low)

    @classmethod
    def _of(cls, parameter, value: float) -> float:
        return float(np.log(value)) if parameter.logarithmic else value / cls._unit(parameter)

    def read(self, values: Mapping[str, float]) -> npt.NDArray[np.float64]:
        given = [values.get(p.key, p.value) for p in self._parameters]
        within = [min(max(value, p.low), p.high) for value, p in zip(given, self._parameters, strict=True)]
        return np.array([self._of(p, value) for p, value in zip(self._parameters, within, strict=True)])

    def values(self, at: npt.NDArray[np.float64]) -> Values:
        return {
            p.key: float(np.exp(x)) if p.logarithmic else float(x * self._unit(p))
            for p, x in zip(self._parameters, at, strict=True)
        }

    def prior(self, at: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        return np.where(self.known, (at - self._centre) / self._sigma, 0.0)

    def steps(self, values: Mapping[str, float]) -> npt.NDArray[np.float64]:
        """Steps of a derivative, towards the inside of the bounds."""
        at = self.read(values)
        return np.where(at + self.step > self.high, -self.step, self.step)

    def neighbours(self, values: Mapping[str, float]) -> list[Values]:
        """The machine with each parameter moved by its step."""
        at, steps = self.read(values), np.diag(self.steps(values))
        return [dict(values) | self.values(at + step) for step in steps]

    def prior_slopes(self) -> npt.NDArray[np.float64]:
        return np.diag(np.where(self.known, 1.0 / self._sigma, 0.0))


def plant_parameters(problem: CalibrationProblem) -> list[str]:
    return [key for key, parameter in problem.parameters.items() if parameter.effect is None]


def effects(problem: CalibrationProblem) -> dict[str, list[str]]:
    """Keys of the parameters of each effect in the catalogue."""
    keys: dict[str, list[str]] = {}
    for key, parameter in problem.parameters.items():
        if parameter.effect is not None:
            keys.setdefault(parameter.effect, []).append(key)
    return keys


def jacobian(rows: npt.NDArray[np.float64], space: Coordinates, values: Values) -> npt.NDArray[np.float64]:
    """Derivatives by each coordinate, of the rows of a machine and of its neighbours."""
    return ((rows[1:] - rows[0]) / space.steps(values)[:, None]).T


def best_of(problem: CalibrationProblem, machines: list[Values]) -> Values:
    """The machine that is nearest to the log."""
    squares = np.sum(problem.residuals(machines) ** 2, axis=1)
    return machines[int(np.argmin(squares))]


def fit(problem: CalibrationProblem, keys: Sequence[str], start: Values, jacobians: int) -> Fit:
    """Fits by a trust region within bounds, with so many Jacobians at most, which are simulated side by side."""
    held = {key: value for key, value in start.items() if key not in keys}
    space = Coordinates(problem, keys)

    def machine(at) -> Values:
        return held | space.values(at)

    def differences(at):
        return np.concatenate([problem.residuals([machine(at)])[0], space.prior(at)])

    def slopes(at):
        here = machine(at)
        rows = problem.residuals([here, *space.neighbours(here)])
        return np.vstack([jacobian(rows, space, here), space.prior_slopes()])

    at = space.read(start)
    inside = np.clip(at, space.low + 1e-9, space.high - 1e-9)
    found = scipy.optimize.least_squares(
        differences,
        inside,
        slopes,
        bounds=(space.low, space.high),
        x_scale="jac",
        max_nfev=jacobians,
        ftol=1e-4,
    )
    count = VALUES_A_SIGNAL * len(problem.signals)
    squares = float(np.sum(found.fun[: -len(keys)] ** 2))
    return Fit(machine(found.x), 2.0 * float(found.cost), squares / count)


def with_wear(problem: CalibrationProblem) -> Fit:
    """The nominal machine with the leak that suits best."""
    return fit(problem, [WEAR], best_of(problem, [{WEAR: leak} for leak in LEAKS_M2]), 10)


def calibrated(problem: CalibrationProblem, wear: Fit, jacobians: int) -> Fit:
    return fit(problem, plant_parameters(problem), wear.values, jacobians)


def with_effect(
    problem: CalibrationProblem,
    base: Fit,
    keys: Sequence[str],
    jacobians: int,
    starts: int,
) -> Fit:
    """The calibrated machine with an effect: its size from the best of some over its range, then all parameters anew."""
    drawn = np.random.default_rng(SEED).uniform(0.0, 1.0, (starts, len(keys)))
    space = Coordinates(problem, keys)
    # More of them small: half of the draws go by their square.
    drawn[::2] **= 2
    machines = [base.values | space.values(space.low + (space.high - space.low) * row) for row in drawn]
    return fit(problem, [*plant_parameters(problem), *keys], best_of(problem, machines), jacobians)

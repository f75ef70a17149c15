"""The gap of a log as a least-squares problem, for solvers and methods of your own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from . import _core
from ._words import PathLike, paths, words


@dataclass(frozen=True)
class FreeParameter:
    """A parameter that may be fitted, SI."""

    #: Key in the plant file; of an effect ``effect.parameter``.
    key: str
    #: The effect that it belongs to.
    effect: str | None
    #: Value on the machine as it was given, of an effect the neutral one.
    value: float
    #: Least value.
    low: float
    #: Largest value.
    high: float
    #: Whether it counts by its logarithm.
    logarithmic: bool
    #: Standard deviation of what is known of it beforehand (of its logarithm where it counts by it); None for nothing.
    sigma: float | None


class CalibrationProblem:
    """A log against a plant: the record, simulator, priors and expected errors that :func:`seepd.gap` has.

    ``signals`` are those that are compared, ``["command", "position"]`` for instance; without it all that the log has. ``without`` names
    effects that are not in the catalogue. Minimise the squares of a row of :meth:`residuals`, which are minus twice the logarithm of the
    likelihood, with those of the priors: ``((value - before) / sigma)**2``, of logarithms where the parameter is logarithmic.
    """

    def __init__(
        self,
        log: PathLike,
        plant: PathLike | None = None,
        config: PathLike | None = None,
        *,
        signals: Sequence[str] | None = None,
        without: Sequence[str] = (),
        axis: str | None = None,
        topic: str | None = None,
    ) -> None:
        options = {"plant": plant, "config": config, "without": list(without), "axis": axis, "topic": topic}
        self._core = _core.CalibrationProblem(words(options, paths(log)), None if signals is None else list(signals))
        #: Parameters by key.
        self.parameters: dict[str, FreeParameter] = {
            told["key"]: FreeParameter(**told) for told in self._core.parameters()
        }
        #: Signals that are compared.
        self.signals: list[str] = self._core.signals
        #: Signals that are simulated, those among them that the log lacks.
        self.simulated_signals: list[str] = self._core.simulated_signals
        #: RMS over range of each signal's part that differs from cycle to cycle: no simulation comes closer.
        self.floor: dict[str, float] = self._core.floor
        #: Length of a cycle, s.
        self.period_s: float = self._core.period_s

    def residuals(self, machines: Sequence[Mapping[str, float]]) -> npt.NDArray[np.float64]:
        """Differences of simulation and log over their expected errors, a row for each machine.

        A machine is a mapping of values by key; what it does not name stays as in the plant file. Machines are simulated side by side, so
        ask for many at once. Values beyond a parameter's bounds are held at them.
        """
        return self._core.residuals([dict(machine) for machine in machines])

    def held_out_gaps(self, machines: Sequence[Mapping[str, float]]) -> list[dict[str, float]]:
        """RMS over range by signal, on every third cycle, which residuals leave out."""
        return self._core.held_out_gaps([dict(machine) for machine in machines])

    def drives(self) -> list[tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]]:
        """Demand, m, and load, N, at each tick of the controller, of each drive that machines are compared along."""
        return self._core.drives()

    def recorded(self) -> npt.NDArray[np.float64]:
        """What the log shows, by drive, signal (of ``signals``), and bin of the period."""
        return self._core.recorded()

    def simulated(self, machine: Mapping[str, float]) -> npt.NDArray[np.float64]:
        """What a machine shows, by drive, signal (of ``simulated_signals``), and bin; NaN from where it goes out of bounds."""
        return self._core.simulated(dict(machine))

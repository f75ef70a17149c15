"""A diagnosis of the gap between simulator and machine."""

from __future__ import annotations

import json
import os
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ._words import PathLike
from .errors import UsageError
from .table import need

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Names and colours of the machines that a plot compares, the recorded one first.
_MACHINES = {"recorded": "black", "nominal": "tab:gray", "calibrated": "tab:orange", "chosen": "tab:blue"}
_UNITS = {"command": "share", "demand": "m", "position": "m", "load": "N"}


class Diagnosis:
    """What ``seepd gap`` finds, ``seepd.gap/1``: ``d["effects"]`` and every other key of the JSON, and the curves that were compared."""

    def __init__(self, told: dict[str, Any]) -> None:
        self._json: dict[str, Any] = json.loads(told["json"])
        #: The conclusion in words.
        self.headline: str = told["headline"]
        #: The plant file of the machine as diagnosed: calibrated, with the chosen effects.
        self.plant: str | None = told["plant"]
        #: Time in the cycle, s, of every curve.
        self.t_s: npt.NDArray[np.float64] = np.asarray(told["t_s"])
        #: Name, start and end of each phase, s.
        self.phases: list[tuple[str, float, float]] = told["phases"]
        #: By machine (``recorded``, ``nominal``, ``calibrated``, ``chosen``) and signal: the mean cycle.
        self.curves: dict[str, dict[str, npt.NDArray[np.float64]]] = {
            machine: {signal: np.asarray(row) for signal, row in zip(self.signals, told[machine], strict=False)}
            for machine in _MACHINES
        }

    def __getitem__(self, key: str) -> Any:
        return self._json[key]

    @property
    def verdict(self) -> str:
        """``no_gap``, ``parameters``, ``effect``, ``unknown`` or ``cannot_tell``."""
        verdict: str = self._json["verdict"]
        return verdict

    @property
    def effects(self) -> list[dict[str, Any]]:
        """Effects, most likely first."""
        effects: list[dict[str, Any]] = self._json["effects"]
        return effects

    @property
    def chosen(self) -> list[str]:
        """Effects that the machine is given."""
        chosen: list[str] = self._json["chosen"]
        return chosen

    @property
    def signals(self) -> list[str]:
        """Signals that were compared."""
        signals: list[str] = self._json["signals"]
        return signals

    @property
    def notes(self) -> list[str]:
        """What to know of the log."""
        notes: list[str] = self._json["notes"]
        return notes

    def to_dict(self) -> dict[str, Any]:
        """The JSON as a dictionary."""
        return self._json

    def save_plant(self, path: PathLike) -> None:
        """Writes the plant file of the machine as diagnosed."""
        if self.plant is None:
            raise UsageError("this axis cannot be written as a plant file")
        with open(os.fspath(path), "w", encoding="utf-8") as file:
            file.write(self.plant)

    def plot(self, signals: list[str] | None = None) -> Figure:
        """Recorded and simulated cycles, a panel a signal. Needs matplotlib."""
        pyplot = need("matplotlib.pyplot", "plot")
        shown = self.signals if signals is None else signals
        unknown = [signal for signal in shown if signal not in self.signals]
        if unknown or not shown:
            raise UsageError(
                f"{', '.join(unknown) or 'no signal'} was not compared; there are {', '.join(self.signals)}"
            )
        figure: Figure
        figure, panels = pyplot.subplots(len(shown), 1, sharex=True, squeeze=False, figsize=(9, 2.2 * len(shown)))
        for signal, panel in zip(shown, panels[:, 0], strict=True):
            for machine, colour in _MACHINES.items():
                if signal in self.curves[machine]:
                    panel.plot(self.t_s, self.curves[machine][signal], color=colour, label=machine, lw=1)
            panel.set_ylabel(f"{signal}, {_UNITS.get(signal, 'Pa')}")
        panels[0, 0].legend(loc="upper right", ncols=len(_MACHINES))
        panels[0, 0].set_title(self.headline)
        panels[-1, 0].set_xlabel("time in the cycle, s")
        figure.tight_layout()
        return figure

    def __repr__(self) -> str:
        return f"<seepd.Diagnosis: {self.headline}>"

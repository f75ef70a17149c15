"""Sizes the oil leak past a hydraulic piston seal from the PID valve command.

What the ``seepd`` program does, on logs or on arrays: :func:`read`, :func:`replay`, :func:`learn_baseline`, :func:`train`,
:func:`simulate`, :func:`gap`, :func:`evaluate`, :func:`effects`. Options have the names of the command line's (``--leak-area`` is
``leak_area``), and mean the same; ``docs/commands.md`` has them all. Errors are :class:`SeepdError` with the program's own line.

``seepd.sklearn`` has estimators for scikit-learn, ``seepd.fleet`` runs jobs over thousands of logs.
"""

from __future__ import annotations

import json
import os
import warnings as _warnings
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _core
from ._words import PathLike, paths, words
from .calibration import CalibrationProblem, FreeParameter
from .diagnosis import Diagnosis
from .errors import (
    ConfigurationError,
    DataError,
    InternalError,
    IoError,
    NoInputError,
    SeepdError,
    SeepdWarning,
    TemporaryError,
    UsageError,
)
from .files import Baseline, Model
from .table import Cycles, Table

__version__ = _core.__version__

__all__ = [
    "Baseline",
    "CalibrationProblem",
    "ConfigurationError",
    "Cycles",
    "DataError",
    "Diagnosis",
    "FreeParameter",
    "InternalError",
    "IoError",
    "Model",
    "NoInputError",
    "SeepdError",
    "SeepdWarning",
    "Table",
    "TemporaryError",
    "UsageError",
    "effects",
    "evaluate",
    "gap",
    "learn_baseline",
    "read",
    "replay",
    "simulate",
    "simulate_share",
    "train",
]


def read(
    log: PathLike | Iterable[PathLike],
    config: PathLike | None = None,
    *,
    axis: str | None = None,
    topic: str | None = None,
    dbc: PathLike | None = None,
    command: str | None = None,
) -> Table:
    """The samples of a log (MCAP, CSV, candump) in SI units: ``time_ns`` and a column for each signal that it has.

    A signal that a sample lacks is null; a reading that is no number is NaN. Several logs are read one after the other as the record of
    one machine. ``config`` is a ``seepd.toml`` with the mapping; the rest is as on the command line.
    """
    options = {"config": config, "axis": axis, "topic": topic, "dbc": dbc, "command": command}
    batch, notes = _core.read(words(options, paths(log)))
    return Table(batch, notes)


def replay(
    log: PathLike | Iterable[PathLike] | Mapping[str, npt.ArrayLike],
    config: PathLike | None = None,
    model: PathLike | Model | None = None,
    baseline: PathLike | Baseline | None = None,
    *,
    time_ns: npt.ArrayLike | None = None,
    sample_rate_hz: float | None = None,
    learn_cycles: int | None = None,
    axis: str | None = None,
    topic: str | None = None,
    dbc: PathLike | None = None,
    command: str | None = None,
    repairs: PathLike | None = None,
    reference_mpa: float | None = None,
) -> Cycles:
    """The leak by cycle, of a log or of arrays.

    Arrays are given by signal name, such as ``{"command": u}`` (share of full command, -1 to 1), with ``time_ns`` or ``sample_rate_hz``;
    without either they are at the model's rate. Arrays of 64-bit floats are not copied. The table has a row for each cycle, rejected ones
    too, and beside it ``summary``, ``events`` and ``notes``.
    """
    options: dict[str, Any] = {
        "config": config,
        "axis": axis,
        "topic": topic,
        "dbc": dbc,
        "command": command,
        "learn_cycles": learn_cycles,
        "repairs": repairs,
        "reference_mpa": reference_mpa,
    }
    with ExitStack() as files:
        options["model"] = _file_of(model, files)
        options["baseline"] = _file_of(baseline, files)
        if isinstance(log, Mapping):
            # The command line takes a log, which arrays are in the place of.
            arrays = [(name, _contiguous(values, np.float64, name)) for name, values in log.items()]
            times = None if time_ns is None else _contiguous(time_ns, np.int64, "time_ns")
            told = _core.replay_arrays(words(options, ["arrays"]), arrays, times, sample_rate_hz)
        else:
            if time_ns is not None or sample_rate_hz is not None:
                raise UsageError("time_ns and sample_rate_hz belong to arrays; a log has its own time")
            told = _core.replay(words(options, paths(log)))
    batch, summary, events, notes = told
    return Cycles(batch, json.loads(summary), [json.loads(event) for event in events], notes)


def learn_baseline(
    log: PathLike | Iterable[PathLike],
    config: PathLike | None = None,
    model: PathLike | Model | None = None,
    *,
    cycles: int | None = None,
    occasion: str | None = None,
    duty_cycle: str | None = None,
    axis: str | None = None,
    topic: str | None = None,
    dbc: PathLike | None = None,
    command: str | None = None,
) -> Baseline:
    """The baseline of a healthy machine; ``save`` writes the file that ``replay`` and the program take."""
    options: dict[str, Any] = {
        # Nothing is written: the words ask for a file's name all the same.
        "out": os.devnull,
        "force": True,
        "cycles": cycles,
        "occasion": occasion,
        "duty_cycle": duty_cycle,
        "config": config,
        "axis": axis,
        "topic": topic,
        "dbc": dbc,
        "command": command,
    }
    with ExitStack() as files:
        options["model"] = _file_of(model, files)
        text, remarks = _core.learn_baseline(words(options, paths(log)))
    _warn(remarks)
    return Baseline(text)


def train(plant: PathLike | None = None, *, shares: Iterable[bytes] = (), **options: Any) -> Model:
    """A model for a plant file (the nominal press by default), as ``seepd train`` makes it: the same seed gives the same bytes.

    Options: ``seed``, ``observations``, ``held_out``, ``trials``, ``compared``, ``causes``, ``calibration``, ``full``,
    ``parameter_spread``, ``load_spread``. ``Model.report`` says what it is worth. ``shares`` are what :func:`simulate_share` gave for the
    same plant file and options, on whatever machines; what none of them has is simulated here, and the model is the same.
    """
    _refuse(options, {"out", "data", "json", "force", "share"})
    with TemporaryDirectory(prefix="seepd-") as folder:
        files = []
        for number, share in enumerate(shares, 1):
            files.append(os.path.join(folder, f"{number}.share"))
            with open(files[-1], "wb") as file:
                file.write(share)
        model, report, notes = _core.train(words({"out": os.devnull, "plant": plant, "shares": files, **options}))
    _warn(notes)
    return Model(model, json.loads(report))


def simulate_share(number: int, of: int, plant: PathLike | None = None, **options: Any) -> bytes:
    """One of so many shares of the machines that :func:`train` learns from: what takes most of a training's time, for several machines
    to do side by side. ``options`` are those of :func:`train`."""
    _refuse(options, {"out", "data", "json", "force", "share", "shares"})
    given = {"out": os.devnull, "plant": plant, "share": f"{number}/{of}", **options}
    simulated, notes = _core.simulate_share(words(given))
    _warn(notes)
    return simulated


def simulate(
    plant: PathLike | None = None,
    *,
    machines: int | None = None,
    effects: Mapping[str, float] | None = None,
    **options: Any,
) -> dict[str, npt.NDArray[Any]]:
    """The log of a simulated machine as arrays: ``time_ns``, the signals, and the truth (``leak_area``, ``leak_flow``).

    ``machines=n`` simulates n machines side by side, on all cores: machine ``i`` is the one that ``machine=seed+i, seed=seed+i`` gives
    alone, and every array but ``time_ns`` has a row for each. ``effects`` is such as ``{"valve_deadband.half_width": 0.02}``. Other options
    are those of ``seepd simulate``: ``cycles``, ``leak_area``, ``leak_step``, ``leak_growth``, ``noise``, ``load_variation``,
    ``period_variation``, ``pause``, ``oil_temperature`` (a text such as ``"30..55"``), ``supply_drift``, ``parameter_spread``,
    ``machine``, ``seed``, ``start_at``, ``command_only``, ``no_truth``.
    """
    _refuse(options, {"out", "list_effects", "force", "compression", "topic_prefix", "with", "with_"})
    given = [f"{name}={value!r}" for name, value in (effects or {}).items()]
    arrays, notes = _core.simulate(words({"out": os.devnull, "plant": plant, "with": given, **options}), machines)
    _warn(notes)
    return arrays


def gap(
    log: PathLike | Iterable[PathLike],
    plant: PathLike | None = None,
    config: PathLike | None = None,
    *,
    without: Sequence[str] = (),
    threads: int | None = None,
    axis: str | None = None,
    topic: str | None = None,
    dbc: PathLike | None = None,
    command: str | None = None,
) -> Diagnosis:
    """Where simulator and machine differ, and which effect explains it. Several logs are the runs of one machine without a controller."""
    options = {
        "plant": plant,
        "config": config,
        "without": list(without),
        "threads": threads,
        "axis": axis,
        "topic": topic,
        "dbc": dbc,
        "command": command,
    }
    told, notes = _core.diagnose(words(options, paths(log)))
    _warn(notes)
    return Diagnosis(told)


def evaluate(
    log: PathLike | Iterable[PathLike],
    config: PathLike | None = None,
    model: PathLike | Model | None = None,
    baseline: PathLike | Baseline | None = None,
    **options: Any,
) -> dict[str, Any]:
    """What estimates and flags are worth on logs that know the truth, ``seepd.evaluation/1``.

    Each log is a machine's record, unless ``one_machine``. Options are those of ``seepd evaluate``: ``learn_cycles``, ``truth``,
    ``truth_topic``, ``truth_unit``, ``onset_lpm``, ``within_cycles``, ``axis``, ``topic``, ``dbc``, ``command``.
    """
    _refuse(options, {"json", "html", "force", "causes"})
    with ExitStack() as files:
        given = {"config": config, "model": _file_of(model, files), "baseline": _file_of(baseline, files), **options}
        text, notes = _core.evaluate(words(given, paths(log)))
    _warn(notes)
    evaluation: dict[str, Any] = json.loads(text)
    return evaluation


def effects() -> list[dict[str, Any]]:
    """The catalogue of effects: key, law, signature, the balance that it disturbs, and parameters with unit, neutral value, range, source."""
    return _core.effects()


def _file_of(given: PathLike | Model | Baseline | None, files: ExitStack) -> str | None:
    """A file's name, of an object for as long as ``files`` is open."""
    if isinstance(given, (Model, Baseline)):
        return files.enter_context(given.as_file())
    return None if given is None else os.fspath(given)


def _contiguous(values: npt.ArrayLike, kind: type[Any], name: str) -> npt.NDArray[Any]:
    """The array itself where it is of the kind, else a copy that is."""
    array = np.ascontiguousarray(values, dtype=kind)
    if array.ndim != 1 or np.ndim(values) != 1:
        raise UsageError(f"{name} has {np.ndim(values)} dimensions; an array of one is needed")
    return array


def _refuse(options: Mapping[str, Any], not_here: set[str]) -> None:
    """Options of the command line that have no meaning here."""
    for name in options:
        if name in not_here:
            raise UsageError(f"{name} is an option of the command line alone")


def _warn(notes: Iterable[str]) -> None:
    for note in notes:
        _warnings.warn(note, SeepdWarning, stacklevel=3)

"""Which machines there are, and where their logs lie."""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from .._words import PathLike
from ..errors import ConfigurationError, IoError, NoInputError

#: Names of machines and series are folders of the data set, as axes are of the daemon's.
_NAME = re.compile(r"[^\W_](?:[\w .-]{0,98}[^\W_])?", re.UNICODE)


@dataclass(frozen=True)
class Machine:
    """A machine with its logs, the oldest first."""

    name: str
    #: Files, folders, patterns (``press-1/*.mcap``) or addresses (``s3://bucket/press-1/``).
    logs: tuple[str, ...]
    #: Machines that are built alike; effects are pooled and models trained by series.
    series: str = "fleet"
    config: str | None = None
    axis: str | None = None
    model: str | None = None
    #: Baseline file; without one it is learned from the first ``learn_cycles`` cycles.
    baseline: str | None = None
    learn_cycles: int | None = None
    #: Plant file, for ``gap`` and ``train``.
    plant: str | None = None
    #: Data sheet (``machine.toml``), for ``adopt``.
    machine: str | None = None
    #: Field with the truth, for ``evaluate``.
    truth: str | None = None


_KEYS = {each.name for each in fields(Machine)}
_PATHS = ("config", "model", "baseline", "plant", "machine")


@dataclass(frozen=True)
class Manifest:
    """Machines by name, and how stores of objects are reached."""

    machines: tuple[Machine, ...]
    #: Of ``[s3]``: ``endpoint``, ``region``, ``anonymous``, ``timeout_s``.
    s3: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.machines:
            raise ConfigurationError("there is no machine: a manifest has [[machines]] with `name` and `logs`")
        seen: set[str] = set()
        for machine in self.machines:
            if not _NAME.fullmatch(machine.name) or not _NAME.fullmatch(machine.series):
                bad = machine.series if _NAME.fullmatch(machine.name) else machine.name
                raise ConfigurationError(
                    f"`{bad}` is no name: a name has letters, digits, spaces and . _ - between letters or digits, 100 at most"
                )
            if machine.name in seen:
                raise ConfigurationError(f"two machines are called `{machine.name}`")
            seen.add(machine.name)
            if not machine.logs:
                raise ConfigurationError(f"machine `{machine.name}` has no logs")
            if machine.learn_cycles is not None and not 20 <= machine.learn_cycles <= 1000:
                raise ConfigurationError(
                    f"machine `{machine.name}`: learn_cycles is {machine.learn_cycles}; it must lie in 20 … 1000"
                )
            if machine.learn_cycles is not None and machine.baseline is not None:
                raise ConfigurationError(f"machine `{machine.name}` has both `baseline` and `learn_cycles`")

    @classmethod
    def load(cls, path: PathLike) -> Manifest:
        """Reads a manifest: TOML, or CSV with a row for each log. Paths are relative to its folder."""
        name = os.fspath(path)
        try:
            with open(name, "rb") as file:
                text = file.read().decode("utf-8-sig")
        except FileNotFoundError:
            raise NoInputError(f"{name}: No such file or directory (os error 2)") from None
        except UnicodeDecodeError as error:
            raise ConfigurationError(f"{name}: not UTF-8: {error.reason} at byte {error.start}") from None
        except OSError as error:
            raise IoError(f"{name}: {error.strerror}") from None
        try:
            given = _from_csv(text) if name.lower().endswith(".csv") else _from_toml(text)
            return cls(tuple(_placed(machine, os.path.dirname(name)) for machine in given[0]), given[1])
        except ConfigurationError as error:
            raise ConfigurationError(f"{name}: {error}") from None

    def shard(self, index: int, count: int) -> Manifest:
        """The ``index``-th of ``count`` shares, from 1; the shares together are the whole, and a machine is in one alone."""
        share = self.machines[index - 1 :: count]
        return Manifest(share, self.s3) if share else _Empty(self.s3)


class _Empty(Manifest):
    """A share without machines, where there are more shares than machines."""

    def __init__(self, s3: Mapping[str, Any]) -> None:
        object.__setattr__(self, "machines", ())
        object.__setattr__(self, "s3", s3)


def _placed(machine: Machine, folder: str) -> Machine:
    """A machine whose files are found from anywhere."""

    def place(path: str) -> str:
        return path if "://" in path else os.path.join(os.path.abspath(folder), path)

    changed: dict[str, Any] = {key: place(getattr(machine, key)) for key in _PATHS if getattr(machine, key) is not None}
    changed["logs"] = tuple(place(log) for log in machine.logs)
    return Machine(**{**{key: getattr(machine, key) for key in _KEYS}, **changed})


def _from_toml(text: str) -> tuple[list[Machine], dict[str, Any]]:
    try:
        import tomllib
    except ImportError:  # before Python 3.11
        import tomli as tomllib  # type: ignore[no-redef]
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigurationError(str(error)) from None
    _check_keys("", content, {"defaults", "machines", "s3"})
    defaults, machines, s3 = content.get("defaults", {}), content.get("machines", []), content.get("s3", {})
    _check_keys("[defaults] ", _table("defaults", defaults), _KEYS - {"name", "logs"})
    _check_keys("[s3] ", _table("s3", s3), {"endpoint", "region", "anonymous", "timeout_s"})
    if not isinstance(machines, list):
        raise ConfigurationError("`machines` is no list: write [[machines]]")
    return [_machine(index, machine, defaults) for index, machine in enumerate(machines)], s3


def _machine(index: int, given: Any, defaults: dict[str, Any]) -> Machine:
    place = f"machines[{index}] "
    _check_keys(place, _table(f"machines[{index}]", given), _KEYS)
    for key in ("name", "logs"):
        if key not in given:
            raise ConfigurationError(f"{place}has no `{key}`")
    values = {**defaults, **given}
    # A machine's own baseline stands above a default that learns one, and the other way round.
    for own, other in (("baseline", "learn_cycles"), ("learn_cycles", "baseline")):
        if own in given and other not in given:
            values.pop(other, None)
    logs = values["logs"]
    values["logs"] = (logs,) if isinstance(logs, str) else tuple(logs) if isinstance(logs, list) else logs
    for key, value in values.items():
        wanted = {"logs": tuple, "learn_cycles": int}.get(key, str)
        if not isinstance(value, wanted) or isinstance(value, bool):
            raise ConfigurationError(f"{place}`{key}` is {value!r}, which is no {wanted.__name__}")
    if not all(isinstance(log, str) for log in values["logs"]):
        raise ConfigurationError(f"{place}`logs` has what is no text")
    return Machine(**values)


def _table(name: str, given: Any) -> dict[str, Any]:
    if not isinstance(given, dict):
        raise ConfigurationError(f"`{name}` is no table")
    return given


def _check_keys(place: str, given: Mapping[str, Any], known: Iterable[str]) -> None:
    import difflib

    for key in given:
        if key not in known:
            like = difflib.get_close_matches(key, known, 1)
            hint = f"did you mean `{like[0]}`?" if like else f"there are {', '.join(sorted(known))}"
            raise ConfigurationError(f"{place}unknown key `{key}`; {hint}")


def _from_csv(text: str) -> tuple[list[Machine], dict[str, Any]]:
    """A row for each log: ``machine`` (its name), ``log``, and the other keys; ``sheet`` is the data sheet. An empty cell says nothing."""
    rows = csv.DictReader(text.splitlines())
    columns = rows.fieldnames or []
    known = (_KEYS - {"name", "logs"}) | {"machine", "log", "sheet"}
    _check_keys("", dict.fromkeys(columns), known)
    for needed in ("machine", "log"):
        if needed not in columns:
            raise ConfigurationError(f"no column `{needed}`")
    machines: dict[str, dict[str, Any]] = {}
    for line, row in enumerate(rows, 2):
        if None in row:
            raise ConfigurationError(f"line {line} has more cells than the head")
        said = {key: value.strip() for key, value in row.items() if value and value.strip()}
        name, log = said.pop("machine", ""), said.pop("log", "")
        if not name or not log:
            raise ConfigurationError(f"line {line} has no {'log' if name else 'machine'}")
        values: dict[str, Any] = {"machine" if key == "sheet" else key: value for key, value in said.items()}
        if "learn_cycles" in values:
            try:
                values["learn_cycles"] = int(values["learn_cycles"])
            except ValueError:
                raise ConfigurationError(f"line {line}: learn_cycles is `{values['learn_cycles']}`") from None
        before = machines.setdefault(name, {"logs": [], **values})
        differing = [key for key in values if before.get(key) != values[key]]
        if differing:
            raise ConfigurationError(
                f"line {line}: `{differing[0]}` of machine `{name}` is `{values[differing[0]]}` here and "
                f"`{before.get(differing[0])}` before: are they two machines of one name?"
            )
        before["logs"].append(log)
    return [Machine(name=name, **{**values, "logs": tuple(values["logs"])}) for name, values in machines.items()], {}

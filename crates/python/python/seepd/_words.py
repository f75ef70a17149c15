"""Keyword arguments as the command line's words: the program parses and checks them, so that both know the same options."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Union

PathLike = Union[str, "os.PathLike[str]"]


def paths(logs: PathLike | Iterable[PathLike]) -> list[str]:
    """One path or several."""
    if isinstance(logs, (str, os.PathLike)):
        return [os.fspath(logs)]
    return [os.fspath(log) for log in logs]


def words(options: Mapping[str, Any], files: Sequence[str] = ()) -> list[str]:
    """``{"leak_area": 1e-7, "command_only": True}`` as ``--leak-area=1e-07 --command-only``; None and False say nothing."""
    spoken: list[str] = []
    for name, value in options.items():
        option = "--" + name.rstrip("_").replace("_", "-")
        if value is None or value is False:
            continue
        if value is True:
            spoken.append(option)
        elif isinstance(value, (list, tuple, set, frozenset)):
            spoken.extend(f"{option}={word(each)}" for each in value)
        else:
            spoken.append(f"{option}={word(value)}")
    # What follows is no option, whatever a file is called.
    return [*spoken, "--", *files] if files else spoken


def word(value: Any) -> str:
    """A value as a word; numbers keep every digit."""
    if isinstance(value, os.PathLike):
        return str(os.fspath(value))
    if isinstance(value, float) or type(value).__name__.startswith("float"):
        return repr(float(value))
    return str(value)

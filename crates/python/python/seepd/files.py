"""Models and baselines: what the program keeps in files."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from . import _core
from ._words import PathLike
from .errors import ConfigurationError, IoError, NoInputError


class Model:
    """A trained model, ``seepd.model/2``."""

    def __init__(self, content: bytes, report: dict[str, Any] | None = None) -> None:
        try:
            self._reader = _core.RowReader(content)
        except ValueError as error:
            raise ConfigurationError(str(error)) from None
        #: The file's content.
        self.content = bytes(content)
        #: What training says of it, ``seepd.training/1``; None of a model that was loaded.
        self.report = report

    @classmethod
    def embedded(cls) -> Model:
        """The model that the program brings: that of the source article's press."""
        return cls(_core.embedded_model())

    @classmethod
    def load(cls, path: PathLike) -> Model:
        """Reads a model file."""
        content = _read(path)
        try:
            return cls(content)
        except ConfigurationError as error:
            raise ConfigurationError(f"{os.fspath(path)}: {error}") from None

    def save(self, path: PathLike) -> None:
        """Writes the model file."""
        _write(path, self.content)

    @property
    def features(self) -> list[str]:
        """Names of its features, in their order."""
        names: list[str] = json.loads(self.content)["features"]
        return names

    @property
    def samples(self) -> int:
        """Samples of its duty cycle."""
        return self._reader.samples

    @contextmanager
    def as_file(self) -> Iterator[str]:
        """The model as a file, which is gone afterwards."""
        with _temporary("model.json", self.content) as path:
            yield path

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Model) and self.content == other.content

    def __hash__(self) -> int:
        return hash(self.content)

    def __reduce__(self) -> tuple[Any, ...]:
        return Model, (self.content, self.report)

    def __repr__(self) -> str:
        return f"<seepd.Model of {self.samples} samples a cycle: {', '.join(self.features)}>"


class Baseline:
    """A machine's baselines as a file has them, the newest last."""

    def __init__(self, text: str) -> None:
        try:
            self._file: dict[str, Any] = json.loads(text)
        except ValueError as error:
            raise ConfigurationError(f"this is no baseline: {error}") from None
        #: The file's text.
        self.text = text

    @classmethod
    def load(cls, path: PathLike) -> Baseline:
        """Reads a baseline file; it is checked against a model when it is used."""
        return cls(_read(path).decode(errors="replace"))

    def save(self, path: PathLike) -> None:
        """Writes the baseline file."""
        _write(path, self.text.encode())

    @property
    def newest(self) -> dict[str, Any]:
        """The baseline that counts."""
        # An axis without a model has a single one.
        baseline: dict[str, Any] = (self._file.get("baselines") or [self._file])[-1]
        return baseline

    @contextmanager
    def as_file(self) -> Iterator[str]:
        """The baseline as a file, which is gone afterwards."""
        with _temporary("baseline.json", self.text.encode()) as path:
            yield path

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Baseline) and self.text == other.text

    def __hash__(self) -> int:
        return hash(self.text)

    def __repr__(self) -> str:
        newest = self.newest
        return f"<seepd.Baseline of {newest.get('cycles')} cycles ({newest.get('occasion')})>"


def _read(path: PathLike) -> bytes:
    try:
        with open(path, "rb") as file:
            return file.read()
    except FileNotFoundError:
        raise NoInputError(f"{os.fspath(path)}: No such file or directory (os error 2)") from None
    except OSError as error:
        raise IoError(f"{os.fspath(path)}: {error.strerror}") from None


def _write(path: PathLike, content: bytes) -> None:
    """Written beside its place, then renamed."""
    beside = f"{os.fspath(path)}.{os.getpid()}.tmp"
    try:
        with open(beside, "wb") as file:
            file.write(content)
        os.replace(beside, path)
    except OSError as error:
        if os.path.exists(beside):
            os.unlink(beside)
        raise IoError(f"writing {os.fspath(path)}: {error.strerror}") from None


@contextmanager
def _temporary(name: str, content: bytes) -> Iterator[str]:
    with tempfile.TemporaryDirectory(prefix="seepd-") as folder:
        path = os.path.join(folder, name)
        with open(path, "wb") as file:
            file.write(content)
        yield path

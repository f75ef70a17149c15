"""What goes wrong, in the program's own one-line words; the classes stand for its exit codes."""

from __future__ import annotations


class SeepdError(Exception):
    """A failure of seepd. ``exit_code`` is what the program would end with."""

    exit_code: int = 70


class UsageError(SeepdError, ValueError):
    """Arguments that make no sense."""

    exit_code = 64


class DataError(SeepdError, ValueError):
    """Data that cannot be read, or that say nothing."""

    exit_code = 65


class NoInputError(SeepdError, FileNotFoundError):
    """A file that is not there."""

    exit_code = 66


class InternalError(SeepdError, RuntimeError):
    """A fault of seepd."""

    exit_code = 70


class IoError(SeepdError, OSError):
    """Reading or writing failed."""

    exit_code = 74


class TemporaryError(SeepdError, RuntimeError):
    """Something else holds, or does not offer, what is needed; later it may."""

    exit_code = 75


class ConfigurationError(SeepdError, ValueError):
    """A configuration, plant, model, baseline or manifest that is wrong."""

    exit_code = 78


class SeepdWarning(UserWarning):
    """What a person should know of a log, a baseline or a diagnosis that was made all the same."""


_CLASSES: dict[int, type[SeepdError]] = {
    error.exit_code: error
    for error in (UsageError, DataError, NoInputError, InternalError, IoError, TemporaryError, ConfigurationError)
}


def of_exit_code(code: int, message: str) -> SeepdError:
    """The exception for an exit code."""
    return _CLASSES.get(code, SeepdError)(message)

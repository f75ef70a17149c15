"""Logs where they lie: in folders, or in a store of objects."""

from __future__ import annotations

import fnmatch
import glob
import hashlib
import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from ..errors import IoError, NoInputError, SeepdError
from ..table import need

#: What a folder's logs are called.
SUFFIXES = (".mcap", ".csv", ".log", ".candump", ".txt")
#: Bytes that are asked of a store at a time.
RANGE_BYTES = 8 << 20
#: Seconds after which a store that says nothing is given up, unless the manifest says otherwise.
TIMEOUT_S = 60.0


@dataclass(frozen=True)
class LogFile:
    """A log, or why there is none under that name."""

    uri: str
    size: int = 0
    mtime_ns: int = 0
    problem: SeepdError | None = None


def logs_of(pattern: str, s3: Mapping[str, Any]) -> list[LogFile]:
    """The logs that a pattern of the manifest means, in the order of their names; one with a ``problem`` where there is none."""
    try:
        found = _objects(pattern, s3) if "://" in pattern else _files(pattern)
    except SeepdError as error:
        return [LogFile(pattern, problem=error)]
    if found:
        return found
    return [LogFile(pattern, problem=NoInputError(f"{pattern}: there is no log"))]


def _files(pattern: str) -> list[LogFile]:
    def facts(path: str) -> LogFile:
        state = os.stat(path)
        return LogFile(path, state.st_size, state.st_mtime_ns)

    try:
        if os.path.isdir(pattern):
            names = sorted(name for name in os.listdir(pattern) if name.lower().endswith(SUFFIXES))
            return [facts(os.path.join(pattern, name)) for name in names]
        if not os.path.exists(pattern) and glob.has_magic(pattern):
            return [facts(path) for path in sorted(glob.glob(pattern, recursive=True)) if os.path.isfile(path)]
        return [facts(pattern)]
    except FileNotFoundError:
        raise NoInputError(f"{pattern}: No such file or directory (os error 2)") from None
    except OSError as error:
        raise IoError(f"{error.filename or pattern}: {error.strerror}") from None


def _objects(pattern: str, s3: Mapping[str, Any]) -> list[LogFile]:
    from pyarrow.fs import FileSelector, FileType

    scheme = pattern.split("://", 1)[0]
    filesystem, path = open_filesystem(pattern, s3)
    try:
        if any(wild in path for wild in "*?["):
            folder = path[: min(path.index(wild) for wild in "*?[" if wild in path)].rsplit("/", 1)[0]
            infos = filesystem.get_file_info(FileSelector(folder, recursive=True))
            infos = [info for info in infos if fnmatch.fnmatchcase(info.path, path)]
        else:
            info = filesystem.get_file_info(path.rstrip("/"))
            if info.type == FileType.NotFound:
                raise NoInputError(f"{pattern}: there is no such object")
            infos = [info]
            if info.type == FileType.Directory:
                infos = filesystem.get_file_info(FileSelector(info.path, recursive=True))
                infos = [each for each in infos if each.path.lower().endswith(SUFFIXES)]
    except SeepdError:
        raise
    except OSError as error:
        raise IoError(f"{pattern}: {one_line(error)}") from None
    files = sorted((info for info in infos if info.type == FileType.File), key=lambda info: info.path)
    return [LogFile(f"{scheme}://{info.path}", info.size or 0, info.mtime_ns or 0) for info in files]


def open_filesystem(uri: str, s3: Mapping[str, Any]) -> tuple[Any, str]:
    """The file system of an address, and the path in it: S3 by pyarrow, others by fsspec where it is installed."""
    fs = need("pyarrow.fs", "fleet")
    scheme, path = uri.split("://", 1)
    if scheme == "s3":
        timeout_s = float(s3.get("timeout_s", TIMEOUT_S))
        options: dict[str, Any] = {
            "request_timeout": timeout_s,
            "connect_timeout": timeout_s,
            "retry_strategy": fs.AwsStandardS3RetryStrategy(max_attempts=3),
        }
        if "endpoint" in s3:
            # pyarrow takes a scheme apart from the rest.
            endpoint_scheme, _, endpoint = str(s3["endpoint"]).rpartition("://")
            options |= {"endpoint_override": endpoint, "scheme": endpoint_scheme or "https"}
        if "region" in s3:
            options["region"] = s3["region"]
        elif "endpoint" in s3:
            options["region"] = "us-east-1"  # else the store on the internet is asked for it
        if s3.get("anonymous"):
            options["anonymous"] = True
        return fs.S3FileSystem(**options), path
    if scheme == "file":
        return fs.LocalFileSystem(), path
    try:
        fsspec = need("fsspec", "fleet")
        filesystem, path = fsspec.core.url_to_fs(uri)
    except (ValueError, ImportError) as error:
        raise IoError(f"{uri}: {one_line(error)}") from None
    return fs.PyFileSystem(fs.FSSpecHandler(filesystem)), path


@contextmanager
def as_local(uri: str, s3: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """A log as a file of this machine, and the SHA-256 of its content. An object is read once, by ranges, into a file that is gone afterwards."""
    if "://" not in uri:
        yield uri, _sha256_of_file(uri)
        return
    filesystem, path = open_filesystem(uri, s3)
    digest = hashlib.sha256()
    # Kinds are told by content; the suffix is for people who look.
    with tempfile.NamedTemporaryFile(prefix="seepd-", suffix=os.path.splitext(path)[1]) as spool:
        try:
            with filesystem.open_input_file(path) as source:
                size = source.size()
                for offset in range(0, size, RANGE_BYTES):
                    part = source.read_at(min(RANGE_BYTES, size - offset), offset)
                    digest.update(part)
                    spool.write(part)
            spool.flush()
        except FileNotFoundError:
            raise NoInputError(f"{uri}: there is no such object") from None
        except OSError as error:
            raise IoError(f"{uri}: {one_line(error)}") from None
        yield spool.name, digest.hexdigest()


def _sha256_of_file(path: str) -> str:
    digest = hashlib.sha256()
    try:
        with open(path, "rb", buffering=0) as file:
            while part := file.read(1 << 20):
                digest.update(part)
    except FileNotFoundError:
        raise NoInputError(f"{path}: No such file or directory (os error 2)") from None
    except OSError as error:
        raise IoError(f"{path}: {error.strerror}") from None
    return digest.hexdigest()


def sha256_of(path: str | None) -> str:
    """Of a file that a job reads beside logs; of none an empty text."""
    return _sha256_of_file(path) if path is not None else ""


def one_line(error: BaseException) -> str:
    """An error's words in one line."""
    return " ".join(str(error).split()) or type(error).__name__

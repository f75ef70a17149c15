"""The data set of results: Parquet files in folders by table, job and machine.

A file is written beside its place and renamed (a store of objects puts it whole), so that a reader sees all of it or nothing. A log has one row
in ``logs`` for each set of inputs (model, configuration, baseline, program): what its job came to, or why it came to nothing. Rows of the
other tables are written before it and are void without it.
"""

from __future__ import annotations

import io
import os
import urllib.parse
from collections.abc import Iterator, Mapping
from typing import Any

from ..errors import ConfigurationError, IoError
from ..table import need
from .sources import one_line, open_filesystem

pa = need("pyarrow", "fleet")
need("pyarrow.parquet", "fleet")

#: Version of the columns; readers of another refuse.
SCHEMA = "seepd.fleet/1"

#: What a job came to: a row for each log (of `train` a series, of `adopt` a machine).
LOGS = pa.schema(
    [
        ("job", pa.string()),
        ("machine", pa.string()),
        ("series", pa.string()),
        ("log", pa.string()),
        ("log_bytes", pa.int64()),
        ("log_mtime_ns", pa.int64()),
        ("log_sha256", pa.string()),
        ("inputs_sha256", pa.string()),
        ("model_sha256", pa.string()),
        ("baseline_sha256", pa.string()),
        ("program", pa.string()),
        ("status", pa.string()),
        ("kind", pa.string()),
        ("reason", pa.string()),
        ("notes", pa.list_(pa.string())),
        # replay
        ("axis", pa.string()),
        ("t_start_ns", pa.int64()),
        ("t_end_ns", pa.int64()),
        ("samples", pa.int64()),
        ("cycles", pa.int64()),
        ("rejected", pa.map_(pa.string(), pa.int64())),
        ("flag", pa.string()),
        ("highest_flag", pa.string()),
        ("leak_area_m2", pa.float64()),
        ("leak_low_m2", pa.float64()),
        ("leak_high_m2", pa.float64()),
        ("leak_flow_lpm", pa.float64()),
        ("novelty", pa.float64()),
        ("condition", pa.string()),
        # evaluate
        ("median_relative_error", pa.float64()),
        ("coverage", pa.float64()),
        # gap
        ("verdict", pa.string()),
        ("chosen", pa.list_(pa.string())),
        ("unknown_probability", pa.float64()),
        ("no_effect_probability", pa.float64()),
        # evaluate, gap, train, adopt: the command's own JSON; train, adopt: what was made, relative to the data set
        ("result", pa.string()),
        ("artifact", pa.string()),
    ],
    metadata={"seepd.schema": SCHEMA},
)

#: Of a diagnosis: a row for each effect and parameter.
EFFECTS = pa.schema(
    [
        ("machine", pa.string()),
        ("series", pa.string()),
        ("log", pa.string()),
        ("inputs_sha256", pa.string()),
        ("effect", pa.string()),
        ("probability", pa.float64()),
        ("parameter", pa.string()),
        ("value", pa.float64()),
        ("low95", pa.float64()),
        ("high95", pa.float64()),
        ("shrink", pa.float64()),
    ],
    metadata={"seepd.schema": SCHEMA},
)


class Store:
    """A data set at a folder or an address."""

    def __init__(self, root: str, s3: Mapping[str, Any] | None = None) -> None:
        self.root = root.rstrip("/")
        self._filesystem: Any = None
        if "://" in root:
            self._filesystem, path = open_filesystem(root, s3 or {})
            self._base = path.rstrip("/")
        else:
            self._base = os.path.abspath(root)

    def path(self, table: str, job: str, machine: str, name: str) -> str:
        """Of a file within the data set: hive partitions, so that every reader knows the job and the machine of a row."""
        return f"{table}/job={job}/machine={urllib.parse.quote(machine)}/{name}"

    def write_table(self, path: str, table: Any) -> None:
        """A table, whole or not at all."""
        buffer = io.BytesIO()
        pa.parquet.write_table(table, buffer, compression="zstd")
        self.write(path, buffer.getvalue())

    def write(self, path: str, content: bytes) -> None:
        """A file, whole or not at all.

        Raises:
            IoError: it could not be written, for want of space or of a right.
        """
        place = f"{self._base}/{path}"
        if self._filesystem is not None:
            try:
                with self._filesystem.open_output_stream(place) as sink:
                    sink.write(content)
            except OSError as error:
                raise IoError(f"writing {self.root}/{path}: {one_line(error)}") from None
            return
        beside = f"{place}.{os.getpid()}.tmp"
        try:
            os.makedirs(os.path.dirname(place), exist_ok=True)
            with open(beside, "wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            os.replace(beside, place)
        except OSError as error:
            _forget(beside)
            raise IoError(f"writing {place}: {error.strerror}") from None

    def remove(self, path: str) -> None:
        """A file, if it is there."""
        place = f"{self._base}/{path}"
        if self._filesystem is None:
            _forget(place)
        elif self._filesystem.get_file_info(place).is_file:
            self._filesystem.delete_file(place)

    def read(self, path: str) -> bytes | None:
        """A file's content, if it is there."""
        place = f"{self._base}/{path}"
        try:
            if self._filesystem is not None:
                with self._filesystem.open_input_stream(place) as source:
                    content: bytes = source.read()
                    return content
            with open(place, "rb") as file:
                return file.read()
        except FileNotFoundError:
            return None
        except OSError as error:
            raise IoError(f"{self.root}/{path}: {one_line(error)}") from None

    def local(self, path: str) -> str:
        """A folder's path on this machine, for jobs that leave files of their own."""
        if self._filesystem is not None:
            raise ConfigurationError(
                f"{self.root}: this job leaves folders; name a folder for the results, not an address"
            )
        return f"{self._base}/{path}"

    def rows(self, table: str, columns: list[str] | None = None, job: str | None = None) -> Any:
        """The rows of a table as a ``pyarrow.Table``; none where there is no such table yet.

        Raises:
            ConfigurationError: the data set is of another version.
        """
        schema = {"logs": LOGS, "effects": EFFECTS}.get(table)
        files = sorted(self._files(table if job is None else f"{table}/job={job}"))
        if not files:
            return (schema or pa.schema([])).empty_table()
        # Files of one table have one schema, so that no reader has to look for more.
        dataset = need("pyarrow.dataset", "fleet")
        found = dataset.dataset(files, format="parquet", filesystem=self._filesystem, schema=schema)
        if schema is not None and (said := pa.parquet.read_schema(files[0], filesystem=self._filesystem).metadata):
            version = said.get(b"seepd.schema", b"").decode()
            if version != SCHEMA:
                raise ConfigurationError(f"{self.root}: a data set of `{version}`; this program reads `{SCHEMA}`")
        return found.to_table(columns=columns)

    def _files(self, folder: str) -> Iterator[str]:
        place = f"{self._base}/{folder}"
        if self._filesystem is not None:
            from pyarrow.fs import FileSelector

            infos = self._filesystem.get_file_info(FileSelector(place, recursive=True, allow_not_found=True))
            yield from (info.path for info in infos if info.path.endswith(".parquet"))
            return
        for parent, _, names in os.walk(place):
            yield from (os.path.join(parent, name) for name in names if name.endswith(".parquet"))


def _forget(path: str) -> None:
    try:
        os.unlink(path)
    except FileNotFoundError:
        pass

"""Tables of Arrow columns, with numpy arrays for those who want no more."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from . import _core

if TYPE_CHECKING:
    import pandas
    import pyarrow


class Table:
    """Columns of one length.

    Anything that knows the Arrow PyCapsule interface takes one as it is, without a copy: ``pyarrow.table(t)``, ``polars.DataFrame(t)``,
    ``duckdb.sql("from t")`` by ``pyarrow.table(t)``. ``t["name"]`` is a numpy array (absent numbers are NaN) or, of texts, a list.
    """

    def __init__(self, batch: _core.Batch, notes: list[str] | None = None) -> None:
        self._batch = batch
        #: What is to be known of the logs: damage, samples left out, clocks that begin anew.
        self.notes: list[str] = notes or []

    @property
    def column_names(self) -> list[str]:
        """Names of the columns."""
        return self._batch.column_names

    @property
    def num_rows(self) -> int:
        """Length of every column."""
        return len(self._batch)

    def __len__(self) -> int:
        return len(self._batch)

    def __getitem__(self, name: str) -> Any:
        return self._batch.column(name)

    def __contains__(self, name: object) -> bool:
        return name in self.column_names

    def __iter__(self) -> Iterator[str]:
        return iter(self.column_names)

    def __arrow_c_stream__(self, requested_schema: object | None = None) -> object:
        return self._batch.__arrow_c_stream__(requested_schema)

    def __arrow_c_schema__(self) -> object:
        return self._batch.__arrow_c_schema__()

    def to_pyarrow(self) -> pyarrow.Table:
        """The same as a ``pyarrow.Table``, without a copy."""
        return need("pyarrow", "arrow").table(self)

    def to_pandas(self) -> pandas.DataFrame:
        """The same as a ``pandas.DataFrame``."""
        return self.to_pyarrow().to_pandas()

    def to_pylist(self) -> list[dict[str, Any]]:
        """The rows as dictionaries, maps as dictionaries too."""
        table = self.to_pyarrow()
        maps = [field.name for field in table.schema if str(field.type).startswith("map")]
        rows: list[dict[str, Any]] = table.to_pylist()
        for row in rows:
            for name in maps:
                if row[name] is not None:
                    row[name] = dict(row[name])
        return rows

    def __repr__(self) -> str:
        return f"<{type(self).__name__} of {self.num_rows} rows: {', '.join(self.column_names)}>"


class Cycles(Table):
    """The cycles of a replay, ``seepd.cycle/1``: a row each."""

    def __init__(
        self, batch: _core.Batch, summary: Mapping[str, Any], events: list[dict[str, Any]], notes: list[str]
    ) -> None:
        super().__init__(batch, notes)
        #: What it all comes to, ``seepd.summary/1``.
        self.summary: dict[str, Any] = dict(summary)
        #: Changes of flag (``seepd.event/1``) and notices (``seepd.notice/1``), in their order.
        self.events: list[dict[str, Any]] = events


def need(module: str, extra: str) -> Any:
    """A package that only some functions need."""
    import importlib

    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise ImportError(f"{module} is not installed, which this needs: pip install 'seepd[{extra}]'") from error

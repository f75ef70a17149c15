"""The notebooks of the manual run, from the first cell to the last; what they claim they assert themselves."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

NOTEBOOKS = Path(__file__).parents[3] / "docs/notebooks"


@pytest.mark.parametrize("name", ["own-log", "article", pytest.param("gap", marks=pytest.mark.long)])
def test_a_notebook_runs(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    book = json.loads((NOTEBOOKS / f"{name}.ipynb").read_text())
    known: dict[str, object] = {"__name__": "__main__"}
    cells = [cell for cell in book["cells"] if cell["cell_type"] == "code"]
    assert len(cells) >= 5
    for number, cell in enumerate(cells):
        # Outputs are made where they are read, not kept in the repository.
        assert cell["outputs"] == []
        exec(compile("".join(cell["source"]), f"{name}, cell {number}", "exec"), known)
    matplotlib.pyplot.close("all")


def test_every_notebook_is_run() -> None:
    assert sorted(path.stem for path in NOTEBOOKS.glob("*.ipynb")) == ["article", "gap", "own-log"]

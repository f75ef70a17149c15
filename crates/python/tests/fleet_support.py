"""Fleets for tests: many small logs of few contents, and rows to compare."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Any

from conftest import run
from seepd.fleet import Manifest
from seepd.fleet.store import Store

DAMAGED_EVERY = 9


def small_logs(folder: Path, contents: int = 8, cycles: int = 3) -> list[Path]:
    """Logs of few cycles, each of another machine with another leak."""
    made = []
    for index in range(contents):
        path = folder / f"content-{index}.mcap"
        leak = ["--leak-area", str(2e-8 * index), "--machine", str(index), "--parameter-spread", "0.03"]
        run("simulate", "--out", path, "--cycles", str(cycles), "--seed", str(index + 1), "--command-only", *leak)
        made.append(path)
    return made


def many_logs(folder: Path, contents: list[Path], count: int) -> Path:
    """A manifest of so many machines of one log each, every ninth damaged in one of four ways."""
    logs = folder / "logs"
    logs.mkdir()
    lines = ["machine,log,series"]
    for index in range(count):
        name = f"m{index:04}"
        path = logs / f"{name}.mcap"
        content = contents[index % len(contents)]
        kind = index // DAMAGED_EVERY % 4 if index % DAMAGED_EVERY == 0 else None
        if kind is None:
            os.link(content, path)
        elif kind == 0:
            path.write_bytes(content.read_bytes()[: content.stat().st_size // 2])
        elif kind == 1:
            path.write_bytes(b"\x00" * 5000)
        elif kind == 2:
            damaged = bytearray(content.read_bytes())
            damaged[len(damaged) // 3 : len(damaged) // 3 + 64] = b"\xff" * 64
            path.write_bytes(damaged)
        # The fourth is not there at all.
        lines.append(f"{name},logs/{name}.mcap,series-{index % 3}")
    manifest = folder / "fleet.csv"
    manifest.write_text("\n".join(lines) + "\n")
    return manifest


def rows_of(store: Path, table: str = "logs") -> list[dict[str, Any]]:
    """Every row of a table, in an order that does not depend on who wrote it."""
    rows: list[dict[str, Any]] = Store(str(store)).rows(table).to_pylist()
    return sorted(
        rows,
        key=lambda row: (row.get("job") or "", row["machine"], row["log"], row["inputs_sha256"], row.get("cycle") or 0),
    )


def load(path: Path) -> Manifest:
    return Manifest.load(path)


def empty(folder: Path) -> Path:
    shutil.rmtree(folder, ignore_errors=True)
    return folder

"""What several tests need: a folder of simulated logs, and the program to compare with."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest


def run(*arguments: str | Path, check: bool = True) -> subprocess.CompletedProcess[str]:
    """The program: the binary that SEEPD_BIN names, else the same command line out of the package."""
    binary = os.environ.get("SEEPD_BIN")
    program = [binary] if binary else [sys.executable, "-m", "seepd"]
    return subprocess.run([*program, *map(str, arguments)], capture_output=True, text=True, check=check, timeout=1200)


@pytest.fixture(scope="session")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A healthy record and one with a leak that grows, of the same machine."""
    folder = tmp_path_factory.mktemp("logs")
    run("simulate", "--out", folder / "healthy.mcap", "--cycles", "30", "--seed", "5")
    growing = ["--leak-area", "2e-8", "--leak-growth", "2e-7", "--load-variation", "0.02"]
    run("simulate", "--out", folder / "worn.mcap", "--cycles", "24", "--seed", "6", *growing)
    return folder

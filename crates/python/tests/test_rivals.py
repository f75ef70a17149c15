"""Other methods on planted logs, side by side with the diagnosis: the whole command, on a few logs."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from conftest import run

RIVALS = Path(__file__).parents[3] / "tools/rivals/run.py"


@pytest.mark.long
def test_one_command_makes_one_table_of_all_methods(tmp_path: Path) -> None:
    pytest.importorskip("pysindy")
    logs, truth, answers = tmp_path / "logs", tmp_path / "truth", tmp_path / "answers"
    planted = ["--seed", "12", "--each", "1", "--sizes", "1", "--limit", "3", "--cycles", "8"]
    run("gap", "blind", "plant", "--logs", logs, "--truth", truth, *planted)
    run("gap", "blind", "diagnose", "--logs", logs, "--answers", answers / "seepd", "--threads", "1")
    options = ["--logs", logs, "--truth", truth, "--answers", answers, "--view", "command"]
    told = subprocess.run([sys.executable, RIVALS, *options], capture_output=True, text=True, check=True)
    rows = [line for line in told.stdout.splitlines() if line.startswith("| ")]
    assert [row.split("|")[1].strip() for row in rows] == [
        "method",
        "seepd gap",
        "least-squares calibration alone",
        "single effects by BIC",
        "PySINDy discrepancy",
        "forest on simulated gaps",
    ]
    assert "3 logs" in told.stdout
    # Answers that are there are kept: nothing is simulated again.
    again = subprocess.run([sys.executable, RIVALS, *options], capture_output=True, text=True, check=True)
    assert again.stdout == told.stdout
    assert again.stderr == ""

"""The page and the questions behind it, on a fleet whose answers are known."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import seepd
from seepd.fleet import questions
from seepd.fleet.report import report
from seepd.fleet.store import EFFECTS, LOGS, Store, pa

DAY = 86_400_000_000_000


def row(machine: str, day: int, flow: float, **more: Any) -> dict[str, Any]:
    flag = "severe" if flow > 2 else "leak" if flow > 0.6 else "watch" if flow > 0.3 else "healthy"
    area = flow / 5.3e6
    return {
        "job": "replay",
        "machine": machine,
        "series": "press",
        "log": f"{machine}-{day:03}.mcap",
        "inputs_sha256": "a" * 64,
        "model_sha256": "1" * 64,
        "program": "seepd 0.1.0",
        "status": "ok",
        "t_start_ns": day * DAY,
        "t_end_ns": day * DAY + DAY // 24,
        "cycles": 100,
        "flag": flag,
        "highest_flag": flag,
        "leak_area_m2": area,
        "leak_low_m2": 0.95 * area,
        "leak_high_m2": 1.05 * area,
        "leak_flow_lpm": flow,
        "novelty": 0.3,
        **more,
    }


@pytest.fixture
def store(tmp_path: Path) -> Path:
    """Eight machines over sixty days: one gets worse, one is an outlier, one has a log that failed."""
    random = np.random.default_rng(1)
    rows = []
    for index in range(8):
        for day in range(0, 60, 10):
            flow = 0.1 + random.normal(0, 0.005)
            if index == 2:
                flow += 0.02 * day
            if index == 5:
                flow = 2.5
            rows.append(row(f"m{index}", day, flow))
            rows.append(
                row(
                    f"m{index}", day, flow * (2.0 if index == 3 else 1.0), model_sha256="2" * 64, inputs_sha256="b" * 64
                )
            )
    rows.append(
        {
            **row("m6", 70, 0.0),
            "status": "failed",
            "kind": "data",
            "reason": "m6-070.mcap: <broken>",
            "flag": None,
            "t_end_ns": None,
        }
    )
    data = Store(str(tmp_path / "data"))
    for number, each in enumerate(rows):
        table = pa.Table.from_pylist([{name: each.get(name) for name in LOGS.names}], schema=LOGS)
        data.write_table(data.path("logs", "replay", each["machine"], f"{number}.parquet"), table)
    return tmp_path / "data"


def test_conditions_trends_and_outliers(store: Path) -> None:
    rows = questions.latest(Store(str(store)).rows("logs").to_pylist(), "1")
    conditions = {each.machine: each for each in questions.conditions(rows)}
    assert list(conditions)[:2] == ["m5", "m2"]
    worse = [machine for machine, each in conditions.items() if each.gets_worse]
    assert "m2" in worse
    assert len(worse) <= 1
    # 0.02 L/min a day.
    assert conditions["m2"].trend_lpm == pytest.approx(0.6, abs=0.02)
    assert (conditions["m6"].failed, conditions["m6"].flag) == (1, "healthy")
    assert [(machine, number) for machine, _, number, _, _ in questions.outliers(rows)] == [
        ("m5", "leak_flow_lpm"),
        ("m2", "leak_flow_lpm"),
    ]


def test_logs_whose_clock_begins_anew_are_in_the_order_of_their_names() -> None:
    """A CSV's time often begins at zero: the first log, the longest, must not be taken for the last."""

    def undated(number: int, flow: float, hours: int) -> dict[str, Any]:
        return row("m0", number, flow, condition=None, t_start_ns=0, t_end_ns=hours * DAY // 24)

    rows = [undated(1, 0.0, 8), undated(2, 1.0, 2), undated(3, 2.5, 1)]
    (found,) = questions.conditions(rows)
    assert (found.flag, found.leak_flow_lpm, found.dated, found.trend_lpm) == ("severe", 2.5, False, None)
    assert found.course == ((1, 0.0), (2, 1.0), (3, 2.5))
    # Dates say more than names, and a log that runs into the next one is no clock that begins anew.
    year_2026 = 56 * 366 * DAY
    late = {"condition": None, "t_start_ns": year_2026 + DAY, "t_end_ns": year_2026 + 2 * DAY}
    early = {"condition": None, "t_start_ns": year_2026, "t_end_ns": year_2026 + DAY + 1}
    (found,) = questions.conditions([row("m0", 1, 2.5, **late), row("m0", 2, 0.1, **early)])
    assert (found.flag, found.dated) == ("severe", True)


def test_divergence_between_models(store: Path) -> None:
    rows = Store(str(store)).rows("logs").to_pylist()
    found = questions.divergences(rows, "1", "2")
    assert {each.machine for each in found} == {"m3"}
    assert len(found) == 6


class _Balanced(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: object) -> None:
        if tag not in ("meta", "polyline"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag != "polyline":
            assert self.open.pop() == tag


def test_the_page_says_it_and_escapes_what_logs_say(store: Path, tmp_path: Path) -> None:
    html = tmp_path / "fleet.html"
    html.write_text(report(str(store)))
    page = html.read_text()
    parser = _Balanced()
    parser.feed(page)
    assert parser.open == []
    text = re.sub(r"<[^>]+>", " ", page)
    assert "8 machines" in text
    assert "1 get worse" in text
    assert "Between two models" in text
    assert "m6-070.mcap: &lt;broken&gt;" in page
    assert "http" not in page.replace("http-equiv", "")
    with pytest.raises(seepd.UsageError, match="no log was replayed with a model `9`"):
        report(str(store), ("9", "1"))


def test_pooled_effects_are_on_the_page(store: Path) -> None:
    data = Store(str(store))
    for index in range(12):
        of_log = {"machine": f"m{index}", "series": "press", "log": "x.mcap", "inputs_sha256": "c" * 64}
        told = {
            **of_log,
            "job": "gap",
            "status": "ok",
            "verdict": "unknown",
            "unknown_probability": 0.1,
            "no_effect_probability": 0.3,
        }
        table = pa.Table.from_pylist([{name: told.get(name) for name in LOGS.names}], schema=LOGS)
        data.write_table(data.path("logs", "gap", f"m{index}", "a.parquet"), table)
        effects = [
            {
                **of_log,
                "effect": "coulomb_friction",
                "probability": 0.4,
                "parameter": "force_n",
                "value": 800.0 + index,
                "low95": 700.0,
                "high95": 900.0,
                "shrink": 0.5,
            },
            {
                **of_log,
                "effect": f"valve_{index}",
                "probability": 0.2,
                "parameter": "x",
                "value": 1.0,
                "low95": 0.5,
                "high95": 1.5,
                "shrink": 0.1,
            },
        ]
        data.write_table(
            data.path("effects", "gap", f"m{index}", "a.parquet"), pa.Table.from_pylist(effects, schema=EFFECTS)
        )
    page = report(str(store))
    line = next(line for line in page.split("<tr>") if "coulomb_friction" in line)
    assert "12 of 12" in line
    assert "force_n 80" in line
    assert "0.40" in line


def test_a_data_set_of_another_version_is_refused(tmp_path: Path) -> None:
    data = Store(str(tmp_path))
    other = LOGS.with_metadata({"seepd.schema": "seepd.fleet/9"})
    data.write_table(
        data.path("logs", "replay", "m", "a.parquet"), pa.Table.from_pylist([row("m", 1, 0.1)], schema=other)
    )
    with pytest.raises(seepd.ConfigurationError, match="seepd.fleet/9"):
        report(str(tmp_path))

"""What a data set of replays says of a fleet: condition and trend by machine, divergence between models, outliers."""

from __future__ import annotations

import statistics
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

#: ns of a day.
DAY_NS = 86_400e9
#: 2000-01-01: clocks that begin with a log, or with a machine's power, are before it.
YEAR_2000_NS = 946_684_800 * 10**9
#: Flags from good to bad.
FLAGS = ("healthy", "no_estimate", "watch", "leak", "severe")
#: Median absolute deviations, as standard deviations, from which a machine is unlike its series.
OUTLYING = 3.5
#: Least machines of which one can be unlike the others.
LEAST_MACHINES = 5


@dataclass(frozen=True)
class Condition:
    """A machine by its last log, and how its leak has gone.

    Logs whose clock begins anew with each have no dates: they are taken in the order of their names, and have no trend.
    """

    machine: str
    series: str
    logs: int
    failed: int
    flag: str
    leak_flow_lpm: float | None
    #: L/min in thirty days, by a line through the logs, and its standard error; None of fewer than three dated logs.
    trend_lpm: float | None
    trend_error_lpm: float | None
    condition: str | None
    dated: bool
    #: End of each log, ns, or its number where logs have no dates; and its leak, L/min.
    course: tuple[tuple[int, float], ...]

    @property
    def gets_worse(self) -> bool:
        """Whether the trend is more than chance."""
        if self.trend_lpm is None or self.trend_error_lpm is None:
            return False
        return self.trend_lpm > _student(len(self.course) - 2) * self.trend_error_lpm


def _student(freedoms: int) -> float:
    """Student's t that chance passes once in 200; of more than ten degrees of freedom within 0.03."""
    table = (63.66, 9.92, 5.84, 4.60, 4.03, 3.71, 3.50, 3.36, 3.25, 3.17)
    return table[freedoms - 1] if freedoms <= len(table) else 2.576 + 6.0 / freedoms


def latest(rows: Sequence[dict[str, Any]], model: str | None = None) -> list[dict[str, Any]]:
    """A row for each log: of one set of inputs, that which most logs have (of two that are as common, the greater hash)."""
    rows = [row for row in rows if model is None or (row["model_sha256"] or "").startswith(model)]
    common: dict[str, int] = defaultdict(int)
    for row in rows:
        common[row["model_sha256"] or ""] += 1
    by_log: dict[tuple[str, str], dict[str, Any]] = {}

    def rank(row: dict[str, Any]) -> tuple[bool, int, str]:
        return row["status"] == "ok", common[row["model_sha256"] or ""], row["inputs_sha256"]

    for row in rows:
        of_log = (row["machine"], row["log"])
        if of_log not in by_log or rank(row) > rank(by_log[of_log]):
            by_log[of_log] = row
    return [by_log[of_log] for of_log in sorted(by_log)]


def conditions(rows: Sequence[dict[str, Any]]) -> list[Condition]:
    """Each machine's condition, the worst first."""
    by_machine: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for row in rows:
        by_machine[row["machine"]].append(row)
    found = [_condition(machine, of_machine) for machine, of_machine in by_machine.items()]
    return sorted(found, key=lambda each: (-FLAGS.index(each.flag), -(each.leak_flow_lpm or 0.0), each.machine))


def in_order(rows: Sequence[dict[str, Any]]) -> tuple[list[dict[str, Any]], bool]:
    """A machine's logs from the first to the last, and whether their stamps say so: they are dates, or at least follow each other.

    Logs without a cycle have no stamps, and come first.
    """
    by_name = sorted(rows, key=lambda row: row["log"])
    stamped = [row for row in by_name if row["t_end_ns"] is not None]
    by_time = sorted(stamped, key=lambda row: (row["t_start_ns"], row["t_end_ns"]))
    are_dates = all(row["t_start_ns"] >= YEAR_2000_NS for row in stamped)
    follow = all(before["t_end_ns"] <= after["t_start_ns"] for before, after in pairwise(by_time))
    if not (are_dates or follow):
        return by_name, False
    return [row for row in by_name if row["t_end_ns"] is None] + by_time, True


def _condition(machine: str, rows: list[dict[str, Any]]) -> Condition:
    good, dated = in_order([row for row in rows if row["status"] == "ok"])
    sized = [
        (row["t_end_ns"] if dated else number, row["leak_flow_lpm"])
        for number, row in enumerate(good, 1)
        if row["leak_flow_lpm"] is not None
    ]
    trend = _trend(sized) if dated else None
    last = good[-1] if good else None
    return Condition(
        machine,
        rows[0]["series"],
        len(rows),
        len(rows) - len(good),
        last["flag"] if last else "no_estimate",
        sized[-1][1] if sized else None,
        trend[0] if trend else None,
        trend[1] if trend else None,
        last["condition"] if last else None,
        dated,
        tuple(sized),
    )


def _trend(sized: Sequence[tuple[int, float]]) -> tuple[float, float] | None:
    """Slope of a line and its standard error, in thirty days."""
    if len(sized) < 3 or len({at for at, _ in sized}) < 3:
        return None
    at = np.array([(time - sized[0][0]) / (30 * DAY_NS) for time, _ in sized])
    flow = np.array([flow for _, flow in sized])
    spread = float(((at - at.mean()) ** 2).sum())
    slope = float(((at - at.mean()) * (flow - flow.mean())).sum() / spread)
    rest = flow - flow.mean() - slope * (at - at.mean())
    return slope, float((rest @ rest / (len(sized) - 2) / spread) ** 0.5)


@dataclass(frozen=True)
class Divergence:
    """A log that two models judge differently."""

    machine: str
    log: str
    before: dict[str, Any]
    after: dict[str, Any]

    @property
    def is_other_verdict(self) -> bool:
        """Whether the flag is another one."""
        return bool(self.before["flag"] != self.after["flag"])


def divergences(rows: Sequence[dict[str, Any]], before: str, after: str) -> list[Divergence]:
    """Logs whose flag is another one under the second model, or whose intervals do not meet. Models are named by the begin of their SHA-256."""

    def of_model(model: str) -> dict[tuple[str, str], dict[str, Any]]:
        return {(row["machine"], row["log"]): row for row in latest(rows, model) if row["status"] == "ok"}

    first, second = of_model(before), of_model(after)
    found = []
    for of_log in sorted(first.keys() & second.keys()):
        one, other = first[of_log], second[of_log]
        apart = None not in (one["leak_low_m2"], other["leak_low_m2"]) and (
            one["leak_high_m2"] < other["leak_low_m2"] or other["leak_high_m2"] < one["leak_low_m2"]
        )
        if one["flag"] != other["flag"] or apart:
            found.append(Divergence(*of_log, one, other))
    return found


def models(rows: Sequence[dict[str, Any]]) -> list[tuple[str, int]]:
    """SHA-256 of every model that replayed, with its number of logs."""
    counts: dict[str, int] = defaultdict(int)
    for row in rows:
        counts[row["model_sha256"] or ""] += 1
    return sorted(counts.items())


def outliers(rows: Sequence[dict[str, Any]]) -> list[tuple[str, str, str, float, float]]:
    """Machines unlike the rest of their series: machine, series, number, its value, and how many deviations it is off."""
    found = []
    of_machine: dict[tuple[str, str], list[dict[str, Any]]] = defaultdict(list)
    for row in rows:
        if row["status"] == "ok":
            of_machine[row["series"], row["machine"]].append(row)
    last = {machine: in_order(logs)[0][-1] for machine, logs in of_machine.items()}
    for series in sorted({series for series, _ in last}):
        for number in ("leak_flow_lpm", "novelty"):
            of_series = {m: row[number] for (s, m), row in last.items() if s == series and row[number] is not None}
            if len(of_series) < LEAST_MACHINES:
                continue
            middle = statistics.median(of_series.values())
            deviation = 1.4826 * statistics.median(abs(value - middle) for value in of_series.values())
            deviation = max(deviation, 0.02 * abs(middle), 1e-6)
            for machine, value in sorted(of_series.items()):
                if abs(value - middle) > OUTLYING * deviation:
                    found.append((machine, series, number, value, (value - middle) / deviation))
    return sorted(found, key=lambda each: -abs(each[4]))

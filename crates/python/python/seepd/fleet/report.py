"""``seepd fleet report``: one page of what a data set says."""

from __future__ import annotations

import html
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from ..errors import DataError, UsageError
from . import questions
from .pooled import PooledEffect, pooled
from .questions import Condition
from .store import Store

#: Lines that a table shows at most; the data set has them all.
MOST_LINES = 200

_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #222; max-width: 1000px; margin: 2rem auto; padding: 0 1rem }
h1 { font-size: 1.5rem } h2 { font-size: 1.15rem; margin-top: 2.2rem } p.note { color: #555 }
table { border-collapse: collapse; width: 100% } th, td { text-align: left; padding: .25rem .6rem; border-bottom: 1px solid #ddd }
td.n, th.n { text-align: right; font-variant-numeric: tabular-nums } td svg { vertical-align: middle }
.wide { overflow-x: auto }
.flag { padding: .05rem .5rem; border-radius: .6rem; white-space: nowrap }
.healthy { background: #dff0e0 } .no_estimate { background: #e6e6e6 } .watch { background: #fdf0c8 }
.leak { background: #fbd9b8 } .severe { background: #f4bcbc }
"""


def report(store: str, against: tuple[str, str] | None = None, s3: Mapping[str, Any] | None = None) -> str:
    """The page, HTML. ``against`` names two models by the begin of their SHA-256; with two models in the data set it is they.

    Raises:
        DataError: there is nothing to report.
    """
    data = Store(store, s3)
    rows = data.rows("logs", None, "replay").to_pylist()
    diagnosed = data.rows("logs", ["status", "kind", "reason"], "gap").to_pylist()
    if not rows and not diagnosed:
        raise DataError(f"{store}: there is no data set of replays or diagnoses; `seepd fleet run` makes one")
    effects = pooled(store, s3) if any(row["status"] == "ok" for row in diagnosed) else []
    last = questions.latest(rows)
    conditions = questions.conditions(last)
    parts = [_head(conditions, last), _conditions(conditions), _divergence(rows, against)]
    parts += [_effects(effects), _outliers(last), _failures([*rows, *diagnosed])]
    body = "\n".join(part for part in parts if part)
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>Fleet</title><style>{_STYLE}</style></head>'
        f"<body>{body}</body></html>\n"
    )


def _text(value: object) -> str:
    return html.escape(str(value))


def _table(heads: Sequence[str], lines: Iterable[Sequence[str]], numbers: Sequence[int] = ()) -> str:
    """Cells are HTML."""
    lines = list(lines)

    def kind(index: int) -> str:
        return ' class="n"' if index in numbers else ""

    head = "".join(f"<th{kind(index)}>{name}</th>" for index, name in enumerate(heads))
    body = "".join(
        "<tr>" + "".join(f"<td{kind(index)}>{cell}</td>" for index, cell in enumerate(line)) + "</tr>"
        for line in lines[:MOST_LINES]
    )
    more = f'<p class="note">and {len(lines) - MOST_LINES} more, in the data set</p>' if len(lines) > MOST_LINES else ""
    return f'<div class="wide"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>{more}'


def _flag(flag: str) -> str:
    return f'<span class="flag {_text(flag)}">{_text(flag.replace("_", " "))}</span>'


def _number(value: float | None, digits: int = 3) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


def _head(conditions: Sequence[Condition], rows: Sequence[Mapping[str, Any]]) -> str:
    counts = Counter(each.flag for each in conditions)
    told = ", ".join(f"{counts[flag]} {flag.replace('_', ' ')}" for flag in reversed(questions.FLAGS) if counts[flag])
    cycles = sum(row["cycles"] or 0 for row in rows)
    failed = sum(row["status"] != "ok" for row in rows)
    return (
        f"<h1>{len(conditions)} machines: {told or 'none replayed'}</h1>"
        f"<p>{len(rows)} logs, {cycles} cycles with an estimate; {failed} logs came to nothing.</p>"
    )


def _spark(course: Sequence[tuple[int, float]]) -> str:
    """The flow over the logs as a small line."""
    if len(course) < 2:
        return ""
    low, high = 0.0, max(flow for _, flow in course) or 1.0
    begin, end = course[0][0], course[-1][0]
    span = max(end - begin, 1)
    points = " ".join(
        f"{2 + 116 * (at - begin) / span:.1f},{22 - 20 * (flow - low) / (high - low):.1f}" for at, flow in course
    )
    title = f"<title>0 to {high:.3f} L/min</title>"
    return f'<svg width="120" height="24" role="img">{title}<polyline points="{points}" fill="none" stroke="#246" stroke-width="1.5"/></svg>'


def _conditions(conditions: Sequence[Condition]) -> str:
    if not conditions:
        return ""
    lines = []
    for each in conditions:
        trend = "–"
        if each.trend_lpm is not None:
            trend = f"{each.trend_lpm:+.3f} ± {each.trend_error_lpm:.3f}" + (" ▲" if each.gets_worse else "")
        lines.append(
            [
                _text(each.machine),
                _text(each.series),
                _flag(each.flag),
                _number(each.leak_flow_lpm),
                trend,
                _spark(each.course),
                str(each.logs),
                _text(each.condition or ""),
            ]
        )
    heads = ["machine", "series", "condition", "L/min", "in 30 days", "course", "logs", "beside the seal"]
    undated = sum(not each.dated for each in conditions)
    notes = []
    if undated < len(conditions):
        worse = sum(each.gets_worse for each in conditions)
        notes.append(f"{worse} get worse: a line through their logs rises by more than chance does once in 200 (▲).")
    if undated:
        notes.append(
            f"The logs of {undated} have no dates, since their clocks begin anew with each: they are taken in the order of their names, "
            "and have no trend."
        )
    note = f'<p class="note">{" ".join(notes)}</p>'
    return "<h2>Condition and trend</h2>" + note + _table(heads, lines, (3, 4, 6))


def _divergence(rows: Sequence[dict[str, Any]], against: tuple[str, str] | None) -> str:
    known = questions.models(rows)
    if against is None:
        if len(known) != 2:
            return ""
        against = (known[0][0], known[1][0])
    for model in against:
        if not any(sha256.startswith(model) for sha256, _ in known):
            names = ", ".join(sha256[:12] for sha256, _ in known)
            raise UsageError(f"no log was replayed with a model `{model}`; there are {names}")
    found = questions.divergences(rows, *against)
    first, second = (model[:12] for model in against)
    lines = [
        [
            _text(each.machine),
            _text(each.log),
            _flag(each.before["flag"]),
            _number(each.before["leak_flow_lpm"]),
            _flag(each.after["flag"]),
            _number(each.after["leak_flow_lpm"]),
        ]
        for each in found
    ]
    other = sum(each.is_other_verdict for each in found)
    heads = ["machine", "log", _text(first), "L/min", _text(second), "L/min"]
    return (
        f"<h2>Between two models</h2><p>{other} logs have another condition under {_text(second)} than under {_text(first)}, "
        f"{len(found) - other} more have sizes whose intervals do not meet.</p>"
        + (_table(heads, lines, (3, 5)) if lines else "")
    )


def _effects(effects: Sequence[PooledEffect]) -> str:
    shown = [effect for effect in effects if effect.share >= 0.05]
    if not effects:
        return ""
    lines = []
    for effect in shown:
        low, high = effect.share_interval90
        sizes = "; ".join(
            f"{_text(size.parameter)} {size.value:.4g} ({size.interval95[0]:.4g} … {size.interval95[1]:.4g}), "
            f"± {size.spread:.2g} from machine to machine"
            for size in effect.sizes
        )
        have = sum(probability > 0.5 for probability in effect.by_machine.values())
        lines.append(
            [
                _text(effect.series),
                _text(effect.effect),
                f"{effect.shared_probability:.2f}",
                f"{100 * effect.share:.0f} % ({100 * low:.0f} … {100 * high:.0f})",
                f"{have} of {len(effect.by_machine)}",
                f"{effect.largest_alone:.2f}",
                sizes,
            ]
        )
    heads = ["series", "effect", "shared", "share of the machines", "have it", "surest alone", "size"]
    note = (
        '<p class="note">Diagnoses of a series together. Shared: probability that most machines of the series have it. '
        "Surest alone: the largest probability that a single log gave it.</p>"
    )
    return "<h2>Effects that machines share</h2>" + note + (_table(heads, lines, (2, 5)) if lines else "<p>None.</p>")


def _outliers(rows: Sequence[dict[str, Any]]) -> str:
    found = questions.outliers(rows)
    names = {"leak_flow_lpm": "leak, L/min", "novelty": "distance from training"}
    lines = [
        [_text(machine), _text(series), names[number], _number(value), f"{off:+.1f}"]
        for machine, series, number, value, off in found
    ]
    if not lines:
        return ""
    heads = ["machine", "series", "number", "value", "deviations from its series"]
    return "<h2>Unlike their series</h2>" + _table(heads, lines, (3, 4))


def _failures(rows: Sequence[Mapping[str, Any]]) -> str:
    counts = Counter((row["kind"], row["reason"]) for row in rows if row["status"] != "ok")
    if not counts:
        return ""
    lines = [[str(count), _text(kind), _text(reason)] for (kind, reason), count in counts.most_common()]
    return "<h2>Logs that came to nothing</h2>" + _table(["logs", "kind", "reason"], lines, (0,))

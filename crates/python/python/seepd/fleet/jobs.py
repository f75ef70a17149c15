"""What is done with one log: a row, written where every worker writes it to. Runs in workers; knows nothing of engines."""

from __future__ import annotations

import hashlib
import json
import os
import statistics
import subprocess
import sys
import warnings
from collections.abc import Mapping
from typing import Any

import seepd

from ..errors import ConfigurationError, IoError, SeepdError, SeepdWarning
from ..table import need
from .sources import as_local, one_line
from .store import EFFECTS, LOGS, Store, pa

#: Failures that the same inputs give again; others are tried again by the next run.
FINAL = {"data", "configuration", "usage"}
_KINDS = {64: "usage", 65: "data", 66: "no_input", 70: "internal", 74: "io", 75: "temporary", 78: "configuration"}

Unit = dict[str, Any]


def program() -> str:
    """What computes: results of another program are other results."""
    return f"seepd {seepd.__version__}"


def unit_name(unit: Mapping[str, Any]) -> str:
    """The file of a unit's row: the same for the same log and inputs, whatever became of it."""
    text = "\n".join([unit["job"], unit["machine"], unit["log"], unit["inputs_sha256"]])
    return hashlib.sha256(text.encode()).hexdigest()[:24] + ".parquet"


def perform(unit: Unit) -> dict[str, Any]:
    """Does a unit's job and writes its row; gives ``status`` (``ok``, ``failed``, ``unchanged``), and ``refused`` where the run cannot go on."""
    if unit["program"] != program():
        where = os.uname().nodename
        text = (
            f"the worker on {where} has {program()}, this run is of {unit['program']}: install the same on every node"
        )
        return {"refused": text, "exit_code": ConfigurationError.exit_code}
    store = Store(unit["store"], unit["s3"])
    path = store.path("logs", unit["job"], unit["machine"], unit_name(unit))
    row: dict[str, Any] = {key: unit.get(key) for key in _OF_UNIT}
    try:
        try:
            with warnings.catch_warnings(record=True) as heard:
                warnings.simplefilter("always", SeepdWarning)
                more = _JOBS[unit["job"]](unit, store)
            if more is None:
                return {"status": "unchanged"}
            notes = [*more.pop("notes", []), *(str(warning.message) for warning in heard)]
            row |= {"status": "ok", "notes": notes, **more}
        except _StoreError as error:
            raise error.cause from None
        except Exception as error:
            # Whatever it is, it is this log's: the next one may be another matter.
            row |= _failure(error)
            # What was written before is void.
            for table in ("cycles", "effects"):
                store.remove(store.path(table, unit["job"], unit["machine"], unit_name(unit)))
        store.write_table(path, pa.Table.from_pylist([row], schema=LOGS))
    except IoError as error:
        # A disk that is full, or a folder that may not be written, fails every unit alike.
        return {"refused": str(error), "exit_code": error.exit_code}
    return {"status": row["status"], "kind": row["kind"], "reason": row["reason"], "log": unit["log"]}


def lost(unit: Unit, attempts: int) -> dict[str, Any]:
    """The row of a unit whose worker died each time; written by whoever hands out the work."""
    store = Store(unit["store"], unit["s3"])
    row: dict[str, Any] = {key: unit.get(key) for key in _OF_UNIT}
    row |= {"status": "failed", "kind": "worker_lost", "reason": f"its worker died {attempts} times", "notes": []}
    for table in ("cycles", "effects"):
        store.remove(store.path(table, unit["job"], unit["machine"], unit_name(unit)))
    store.write_table(
        store.path("logs", unit["job"], unit["machine"], unit_name(unit)), pa.Table.from_pylist([row], schema=LOGS)
    )
    return {"status": "failed", "kind": "worker_lost", "reason": row["reason"], "log": unit["log"]}


_OF_UNIT = (
    "job",
    "machine",
    "series",
    "log",
    "log_bytes",
    "log_mtime_ns",
    "inputs_sha256",
    "model_sha256",
    "baseline_sha256",
    "program",
    "kind",
    "reason",
)


class _StoreError(Exception):
    """The data set could not be written: no fault of the log."""

    def __init__(self, cause: IoError) -> None:
        self.cause = cause


def _failure(error: Exception) -> dict[str, Any]:
    if isinstance(error, SeepdError):
        kind, reason = _KINDS.get(error.exit_code, "internal"), one_line(error)
    elif isinstance(error, OSError):
        kind, reason = "io", one_line(error)
    else:
        kind, reason = "internal", f"{type(error).__name__}: {one_line(error)}"
    return {"status": "failed", "kind": kind, "reason": reason, "notes": []}


def _write(store: Store, table: str, unit: Unit, rows: Any) -> None:
    try:
        store.write_table(store.path(table, unit["job"], unit["machine"], unit_name(unit)), rows)
    except IoError as error:
        raise _StoreError(error) from None


def _named_as_the_log(unit: Unit, path: str, error: SeepdError) -> SeepdError:
    """An error about the copy of an object, as one about the object."""
    return type(error)(str(error).replace(path, unit["log"])) if path != unit["log"] else error


def _with_log(work: Any) -> Any:
    """A job on a log's file; one that was done with the same content before is not done again."""

    def job(unit: Unit, store: Store) -> dict[str, Any] | None:
        with as_local(unit["log"], unit["s3"]) as (path, sha256):
            if sha256 == unit.get("known_sha256"):
                return None
            try:
                return {"log_sha256": sha256, **work(unit, store, path)}
            except SeepdError as error:
                raise _named_as_the_log(unit, path, error) from None

    return job


def _reading(unit: Unit) -> dict[str, Any]:
    return {key: unit[key] for key in ("config", "axis", "model") if unit.get(key) is not None}


def _replay(unit: Unit, store: Store, path: str) -> dict[str, Any]:
    baseline = None
    if unit.get("baseline_path") is not None:
        content = store.read(unit["baseline_path"])
        baseline = None if content is None else seepd.Baseline(content.decode())
    cycles = seepd.replay(path, baseline=baseline or unit.get("baseline"), **_reading(unit))
    table = cycles.to_pyarrow()
    for name in ("inputs_sha256", "log", "series", "machine"):
        table = table.add_column(0, name, pa.array([unit[name]] * len(table), pa.string()))
    _write(store, "cycles", unit, table)
    summary = cycles.summary
    starts, ends = cycles["t_start_ns"], cycles["t_end_s"] - cycles["t_start_s"]
    intervals = [interval for interval in table["interval90_m2"].to_pylist() if interval is not None]
    # The summary's size is the median of the last estimates; so are its ends here.
    last = intervals[-24:]
    novelties = [
        value
        for pair in zip(table["novelty"].to_pylist(), table["absolute_novelty"].to_pylist(), strict=True)
        if (value := pair[0] if pair[0] is not None else pair[1]) is not None
    ]
    sized = summary["leak_area_m2"] is not None and last
    return {
        "notes": [note.replace(path, unit["log"]) for note in cycles.notes],
        "axis": summary["axis"],
        "t_start_ns": int(starts[0]) if len(cycles) else None,
        "t_end_ns": int(starts[-1] + ends[-1] * 1e9) if len(cycles) else None,
        "samples": summary["samples"],
        "cycles": summary["cycles"],
        "rejected": list(summary["rejected"].items()),
        "flag": summary["flag"],
        "highest_flag": summary["highest_flag"],
        "leak_area_m2": summary["leak_area_m2"],
        "leak_low_m2": statistics.median(low for low, _ in last) if sized else None,
        "leak_high_m2": statistics.median(high for _, high in last) if sized else None,
        "leak_flow_lpm": summary["leak_flow_lpm"],
        "novelty": statistics.median(novelties) if novelties else None,
        "condition": summary.get("condition"),
    }


def _evaluate(unit: Unit, store: Store, path: str) -> dict[str, Any]:
    options = {key: unit[key] for key in ("truth", "learn_cycles", "baseline") if unit.get(key) is not None}
    evaluation = seepd.evaluate(path, **_reading(unit), **options)
    sizes = evaluation["sizes"][-1]
    # NaN is null in JSON: a decade without cycles.
    decades = [decade for decade in sizes["decades"] if decade["median_relative_error"] is not None]
    largest: dict[str, Any] = max(decades, key=lambda decade: decade["count"], default={})
    return {
        "cycles": evaluation["cycles"],
        "rejected": list(evaluation["rejected"].items()),
        "median_relative_error": largest.get("median_relative_error"),
        "coverage": sizes["coverage"],
        "result": json.dumps(evaluation),
    }


def _gap(unit: Unit, store: Store, path: str) -> dict[str, Any]:
    options = {key: unit[key] for key in ("plant", "config", "axis") if unit.get(key) is not None}
    # A worker has a core: others are at work beside it.
    diagnosis = seepd.gap(path, threads=1, **options)
    rows = []
    for finding in diagnosis.effects:
        for parameter, value in finding["parameters"].items():
            low, high = finding["interval95"].get(parameter) or (None, None)
            rows.append(
                {
                    **{key: unit[key] for key in ("machine", "series", "log", "inputs_sha256")},
                    **{key: finding[key] for key in ("effect", "probability", "shrink")},
                    "parameter": parameter,
                    "value": value,
                    "low95": low,
                    "high95": high,
                }
            )
    _write(store, "effects", unit, pa.Table.from_pylist(rows, schema=EFFECTS))
    return {
        "notes": [note.replace(path, unit["log"]) for note in diagnosis.notes],
        "cycles": diagnosis["cycles"]["used"],
        "leak_area_m2": diagnosis["leak"]["chosen_m2"],
        "verdict": diagnosis.verdict,
        "chosen": diagnosis.chosen,
        "unknown_probability": diagnosis["unknown_probability"],
        "no_effect_probability": diagnosis["no_effect_probability"],
        "result": json.dumps(diagnosis.to_dict()),
    }


def _baseline(unit: Unit, store: Store) -> dict[str, Any] | None:
    """A machine's baseline, learned from its first logs: as many of them as it takes."""
    if store.read(unit["artifact"]) is not None:
        return None
    wanted = unit["learn_cycles"]
    from contextlib import ExitStack

    with ExitStack() as files:
        paths: list[str] = []
        for log in unit["logs"]:
            paths.append(files.enter_context(as_local(log, unit["s3"]))[0])
            try:
                learned = seepd.learn_baseline(paths, cycles=wanted, **_reading(unit))
            except seepd.DataError:
                # Too few cycles so far, or unusable ones: the next log may have more.
                if log == unit["logs"][-1]:
                    raise
                continue
            # Cycles that were unlike the others count: a log more would not make them alike.
            enough = learned.newest.get("cycles", 0) + learned.newest.get("left_out", 0) >= wanted
            if enough or log == unit["logs"][-1]:
                break
    try:
        store.write(unit["artifact"], learned.text.encode())
    except IoError as error:
        raise _StoreError(error) from None
    newest = learned.newest
    return {"cycles": newest.get("cycles"), "notes": newest.get("remarks", []), "artifact": unit["artifact"]}


def _share(unit: Unit, store: Store) -> dict[str, Any] | None:
    """A share of the simulation for a model, kept until the model is there."""
    if store.read(unit["artifact"]) is not None:
        return None
    simulated = seepd.simulate_share(unit["number"], len(unit["shares"]), unit.get("plant"), **unit["options"])
    try:
        store.write(unit["artifact"], simulated)
    except IoError as error:
        raise _StoreError(error) from None
    return {"artifact": unit["artifact"]}


def _train(unit: Unit, store: Store) -> dict[str, Any] | None:
    if unit.get("known_sha256") is not None and store.read(unit["artifact"]) is not None:
        return None
    # A share whose worker died is simulated here.
    shares = [simulated for path in unit["shares"] if (simulated := store.read(path)) is not None]
    model = seepd.train(unit.get("plant"), shares=shares, **unit["options"])
    try:
        store.write(unit["artifact"], model.content)
    except IoError as error:
        raise _StoreError(error) from None
    for path in unit["shares"]:
        store.remove(path)
    return {
        "result": json.dumps(model.report),
        "artifact": unit["artifact"],
        "log_sha256": hashlib.sha256(model.content).hexdigest(),
    }


def _adopt(unit: Unit, store: Store) -> dict[str, Any] | None:
    """``seepd adopt`` in a process of its own: it leaves a folder, and speaks on standard output."""
    folder = store.local(unit["artifact"])
    if unit.get("known_sha256") is not None and os.path.exists(os.path.join(folder, "seepd.toml")):
        return None
    words = [sys.executable, "-m", "seepd", "adopt", "--json", "--force", "--out", folder]
    for option in ("machine", "config"):
        given = unit.get("sheet" if option == "machine" else option)
        words += [f"--{option}={given}"] if given is not None else []
    words += ["--quick"] if unit["options"].get("quick") else []
    from contextlib import ExitStack

    with ExitStack() as files:
        paths = [files.enter_context(as_local(log, unit["s3"])) for log in unit["logs"]]
        os.makedirs(folder, exist_ok=True)
        ended = subprocess.run(
            [*words, "--", *(path for path, _ in paths)], capture_output=True, text=True, check=False
        )
        if ended.returncode != 0:
            said = [line for line in ended.stderr.splitlines() if line.strip()]
            line = (said[-1] if said else f"it ended with {ended.returncode}").removeprefix("seepd: ")
            for (path, _), log in zip(paths, unit["logs"], strict=True):
                line = line.replace(path, log)
            raise seepd.errors.of_exit_code(ended.returncode, line)
        digest = hashlib.sha256("".join(sha256 for _, sha256 in paths).encode()).hexdigest()
    return {"result": ended.stdout.strip(), "artifact": unit["artifact"], "log_sha256": digest}


_JOBS = {
    "replay": _with_log(_replay),
    "evaluate": _with_log(_evaluate),
    "gap": _with_log(_gap),
    "baseline": _baseline,
    "share": _share,
    "train": _train,
    "adopt": _adopt,
}
JOBS = tuple(name for name in _JOBS if name not in ("baseline", "share"))

need("pyarrow.parquet", "fleet")

"""A run: what is to be done of a manifest, in order, and what came of it."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from ..errors import ConfigurationError, SeepdError, of_exit_code
from .engines import Engine
from .jobs import FINAL, JOBS, Unit, lost, perform, program, unit_name
from .manifest import Machine, Manifest
from .sources import LogFile, logs_of, sha256_of
from .store import Store


@dataclass(frozen=True)
class Settings:
    """What is asked for beside the manifest."""

    #: ``replay``, ``evaluate``, ``gap``, ``train`` or ``adopt``.
    job: str = "replay"
    #: Folder or address of the data set.
    store: str = "fleet-results"
    #: Learn the baseline of machines that have none from so many cycles.
    learn_cycles: int | None = None
    #: Model in the place of the manifest's.
    model: str | None = None
    #: Do failures again that the same inputs would give again.
    retry_failed: bool = False
    #: Look at the content of logs whose size and time are as before, too.
    rehash: bool = False
    #: Of ``train`` (its options) and ``adopt`` (``quick``).
    options: dict[str, Any] = field(default_factory=dict)
    #: Tasks that the simulation for a model is spread over; the model is the same whatever their number.
    shares: int = 8


@dataclass
class Outcome:
    """Counts of units, and why units failed."""

    counts: Counter[str] = field(default_factory=Counter)
    reasons: Counter[str] = field(default_factory=Counter)

    @property
    def failed(self) -> int:
        """Units that came to nothing."""
        return self.counts["failed"]


def run(
    manifest: Manifest, settings: Settings, engine: Engine, tell: Callable[[Outcome], None] = lambda _: None
) -> Outcome:
    """Does the job for every log that it has not been done for. ``tell`` hears of the counts after each unit.

    Raises:
        SeepdError: the run cannot go on: another program on a worker, a data set that cannot be written. What was done is kept.
    """
    if settings.job not in JOBS:
        raise ConfigurationError(f"there is no job `{settings.job}`; there are {', '.join(JOBS)}")
    plan, outcome = _Plan(manifest, settings), Outcome()

    def note(status: str, kind: str | None, reason: str | None) -> None:
        outcome.counts[status] += 1
        if status == "failed":
            outcome.reasons[f"{kind}: {reason}"] += 1
        tell(outcome)

    for stage in plan.stages():
        for unit, result in engine.run(stage(note), perform):
            if "refused" in result:
                raise of_exit_code(result["exit_code"], result["refused"])
            if "lost" in result:
                result = lost(unit, result["lost"])
            if unit["job"] in JOBS:
                note(result["status"], result.get("kind"), result.get("reason"))
    return outcome


Note = Callable[[str, "str | None", "str | None"], None]


class _Plan:
    """The units of a run. They are made as they are asked for: a manifest of any length costs no memory beside its own."""

    def __init__(self, manifest: Manifest, settings: Settings) -> None:
        self.manifest = manifest
        self.settings = settings
        self.store = Store(settings.store, manifest.s3)
        self._hashes: dict[str, str] = {}
        self._done = _done(self.store, settings.job)

    def stages(self) -> list[Callable[[Note], Iterator[Unit]]]:
        """What must be finished before the next begins: baselines before the logs that are compared with them."""
        job = self.settings.job
        if job == "train":
            return [self._shares, self._series] if self.settings.shares > 1 else [self._series]
        if job == "adopt":
            return [self._machines]
        return [self._baselines, self._logs] if job == "replay" else [self._logs]

    def _baselines(self, _note: Note) -> Iterator[Unit]:
        for machine in self.manifest.machines:
            if self._learns(machine) is None:
                continue
            files = [log for pattern in machine.logs for log in logs_of(pattern, self.manifest.s3)]
            logs = [log.uri for log in files if log.problem is None]
            try:
                unit = self._unit(machine, "baseline")
            except SeepdError:
                continue  # It is told of each of the machine's logs.
            if logs:
                yield {**unit, "logs": logs, "log": "", "artifact": self._baseline_path(machine)}

    def _learns(self, machine: Machine) -> int | None:
        if machine.baseline is not None or self.settings.job != "replay":
            return None
        return machine.learn_cycles or self.settings.learn_cycles

    def _baseline_path(self, machine: Machine) -> str:
        inputs = self._inputs(machine, "baseline")
        return f"baselines/{machine.name}/{inputs[:24]}.json"

    def _logs(self, note: Note) -> Iterator[Unit]:
        for machine in self.manifest.machines:
            for pattern in machine.logs:
                for log in logs_of(pattern, self.manifest.s3):
                    unit = self._of_log(machine, log, note)
                    if unit is not None:
                        yield unit

    def _of_log(self, machine: Machine, log: LogFile, note: Note) -> Unit | None:
        """The unit of a log; None where it is done, or cannot be begun, which is a row as well."""
        try:
            unit = self._unit(machine, self.settings.job)
        except SeepdError as error:
            self._cannot_begin({**self._bare(machine), "log": log.uri}, error, note)
            return None
        unit |= {"log": log.uri, "log_bytes": log.size, "log_mtime_ns": log.mtime_ns}
        if self._learns(machine) is not None:
            path = self._baseline_path(machine)
            content = self.store.read(path)
            if content is not None:
                unit |= {"baseline_path": path, "baseline_sha256": hashlib.sha256(content).hexdigest()}
                unit["inputs_sha256"] = _digest(unit["inputs_sha256"], unit["baseline_sha256"])
            else:
                self._cannot_begin(unit, self._why_no_baseline(machine), note)
                return None
        if log.problem is not None:
            self._cannot_begin(unit, log.problem, note)
            return None
        before = self._done.get(unit_name(unit))
        if before is not None:
            size, mtime_ns, sha256, is_final = before
            if (is_final == "failed" and not self.settings.retry_failed) or is_final == "ok":
                if (size, mtime_ns) == (log.size, log.mtime_ns) and not self.settings.rehash:
                    note("unchanged", None, None)
                    return None
                unit["known_sha256"] = sha256 if is_final == "ok" else None
        return unit

    def _why_no_baseline(self, machine: Machine) -> SeepdError:
        unit = {**self._unit(machine, "baseline"), "log": ""}
        content = self.store.read(self.store.path("logs", "baseline", machine.name, unit_name(unit)))
        reason, kind = "its baseline could not be learned", "data"
        if content is not None:
            import pyarrow as pa
            from pyarrow import parquet

            row = parquet.read_table(pa.BufferReader(content)).to_pylist()[0]
            reason, kind = row["reason"] or reason, row["kind"] or kind
        return of_exit_code({"data": 65, "configuration": 78, "usage": 64}.get(kind, 74), reason)

    def _cannot_begin(self, unit: Unit, error: SeepdError, note: Note) -> None:
        """A log that is not there, or whose machine has a file that is none: its row is written here, as no worker is needed for it."""
        from .jobs import _failure
        from .store import LOGS, pa

        row = {**unit, **_failure(error)}
        path = self.store.path("logs", unit["job"], unit["machine"], unit_name(unit))
        table = pa.Table.from_pylist([{name: row.get(name) for name in LOGS.names}], schema=LOGS)
        self.store.write_table(path, table)
        note("failed", row["kind"], row["reason"])

    def _shares(self, note: Note) -> Iterator[Unit]:
        """The simulation for each series' model, in shares that need nothing of each other."""
        for unit in self._series(note):
            if unit["known_sha256"] is None or self.store.read(unit["artifact"]) is None:
                for number, artifact in enumerate(unit["shares"], 1):
                    of = f"share {number} of {len(unit['shares'])}"
                    yield {**unit, "job": "share", "log": of, "artifact": artifact, "number": number}

    def _series(self, _note: Note) -> Iterator[Unit]:
        """A model for each series: for the plant file that its machines share."""
        plants: dict[str, set[str | None]] = {}
        for machine in self.manifest.machines:
            plants.setdefault(machine.series, set()).add(machine.plant)
        for series, files in plants.items():
            if len(files) > 1:
                named = ", ".join(sorted(str(file) for file in files))
                raise ConfigurationError(f"the machines of series `{series}` have different plant files: {named}")
            machine = Machine(name=series, logs=("",), series=series, plant=files.pop())
            unit = self._unit(machine, "train")
            unit |= {
                "log": "",
                "options": self.settings.options,
                "artifact": f"models/{series}/{unit['inputs_sha256'][:24]}.json",
                "shares": self._share_paths(f"shares/{series}/{unit['inputs_sha256'][:24]}"),
            }
            yield {**unit, "known_sha256": self._sha_of_done(unit)}

    def _share_paths(self, base: str) -> list[str]:
        of = self.settings.shares
        return [f"{base}/{number}-of-{of}" for number in range(1, of + 1)] if of > 1 else []

    def _machines(self, _note: Note) -> Iterator[Unit]:
        for machine in self.manifest.machines:
            files = [log for pattern in machine.logs for log in logs_of(pattern, self.manifest.s3)]
            unit = self._unit(machine, "adopt")
            missing = [log.problem for log in files if log.problem is not None]
            unit |= {
                "log": "",
                "logs": [log.uri for log in files],
                "options": self.settings.options,
                "sheet": machine.machine,
                "artifact": f"adopted/{machine.name}",
            }
            facts = [f"{log.uri} {log.size} {log.mtime_ns}" for log in files]
            unit["inputs_sha256"] = _digest(unit["inputs_sha256"], *facts)
            if missing:
                self._cannot_begin(unit, missing[0], _note)
                continue
            yield {**unit, "known_sha256": self._sha_of_done(unit)}

    def _sha_of_done(self, unit: Unit) -> str | None:
        before = self._done.get(unit_name(unit))
        return before[2] if before is not None and before[3] == "ok" else None

    def _bare(self, machine: Machine) -> Unit:
        return {
            "job": self.settings.job,
            "machine": machine.name,
            "series": machine.series,
            "store": self.settings.store,
            "s3": dict(self.manifest.s3),
            "program": program(),
            "inputs_sha256": "",
        }

    def _unit(self, machine: Machine, job: str) -> Unit:
        return {
            **self._bare(machine),
            "job": job,
            "config": machine.config,
            "axis": machine.axis,
            "model": self._model(machine),
            "model_sha256": self._hash(self._model(machine)) or "embedded",
            "baseline": machine.baseline,
            "baseline_sha256": self._hash(machine.baseline) or None,
            "learn_cycles": machine.learn_cycles or self.settings.learn_cycles,
            "plant": machine.plant,
            "truth": machine.truth,
            "inputs_sha256": self._inputs(machine, job),
        }

    def _model(self, machine: Machine) -> str | None:
        return self.settings.model or machine.model

    def _inputs(self, machine: Machine, job: str) -> str:
        """All that a result depends on beside the log."""
        files = [machine.config, self._model(machine), machine.baseline, machine.plant, machine.machine]
        learned = machine.learn_cycles or self.settings.learn_cycles
        said = [job, program(), machine.axis, machine.truth, learned, json.dumps(self.settings.options, sort_keys=True)]
        return _digest(*(str(each) for each in said), *(self._hash(file) for file in files))

    def _hash(self, path: str | None) -> str:
        if path is None:
            return ""
        if path not in self._hashes:
            self._hashes[path] = sha256_of(path)
        return self._hashes[path]


def _digest(*texts: str) -> str:
    return hashlib.sha256("\n".join(texts).encode()).hexdigest()


def _done(store: Store, job: str) -> dict[str, tuple[int, int, str | None, str]]:
    """What is there already: size, time and content of the log by the name of its row, and whether that is final."""
    columns = ["job", "machine", "log", "inputs_sha256", "log_bytes", "log_mtime_ns", "log_sha256", "status", "kind"]
    done = {}
    for batch in store.rows("logs", columns, job).to_batches():
        for row in batch.to_pylist():
            if row["status"] == "ok" or row["kind"] in FINAL:
                facts = (row["log_bytes"], row["log_mtime_ns"], row["log_sha256"], row["status"])
                done[unit_name(row)] = facts
    return done

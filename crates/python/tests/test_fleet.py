"""Fleets: the same rows whoever does the work and whoever dies of it."""

from __future__ import annotations

import ctypes
import json
import os
import random
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import seepd
from conftest import run
from fleet_support import load, many_logs, rows_of, small_logs
from seepd.fleet import Machine, Manifest, Outcome, Settings
from seepd.fleet import run as fleet_run
from seepd.fleet.engines import Pool, Serial


@pytest.fixture(scope="module")
def contents(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return small_logs(tmp_path_factory.mktemp("contents"))


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory, contents: list[Path]) -> Path:
    return many_logs(tmp_path_factory.mktemp("fleet"), contents, 60)


@pytest.fixture(scope="module")
def serial(tmp_path_factory: pytest.TempPathFactory, fleet: Path) -> Path:
    """What one process makes of it: what all others are measured against."""
    store = tmp_path_factory.mktemp("serial")
    outcome = fleet_run(load(fleet), Settings(store=str(store)), Serial())
    assert (outcome.counts["ok"], outcome.failed) == (57, 3)
    return store


def assert_same_rows(store: Path, serial: Path) -> None:
    for table in ("logs", "cycles"):
        assert rows_of(store, table) == rows_of(serial, table)


def test_a_row_is_what_the_command_line_says(fleet: Path, serial: Path) -> None:
    rows = {row["machine"]: row for row in rows_of(serial)}
    row = rows["m0004"]
    summary = json.loads(run("replay", "--json", fleet.parent / "logs/m0004.mcap").stdout.splitlines()[-1])
    for key in ("leak_area_m2", "leak_flow_lpm", "flag", "highest_flag", "cycles", "samples"):
        assert row[key] == summary[key], key
    assert (row["status"], row["kind"], row["series"]) == ("ok", None, "series-1")
    cycles = [row for row in rows_of(serial, "cycles") if row["machine"] == "m0004"]
    assert len(cycles) == 3
    assert row["leak_low_m2"] <= row["leak_area_m2"] <= row["leak_high_m2"]


def test_failures_are_rows_with_their_reason(serial: Path) -> None:
    failed = {row["machine"]: row for row in rows_of(serial) if row["status"] == "failed"}
    reasons = {machine: (row["kind"], row["reason"]) for machine, row in failed.items()}
    assert reasons["m0027"][0] == "no_input"
    assert reasons["m0027"][1].endswith("m0027.mcap: No such file or directory (os error 2)")
    assert reasons["m0009"][0] == "data"
    assert len(failed) == 3
    # A log that is damaged in part is read as far as it goes, and says so.
    half = next(row for row in rows_of(serial) if row["machine"] == "m0000")
    assert half["status"] == "ok"
    assert any("m0000.mcap" in note for note in half["notes"])


def test_two_processes_and_shards_give_the_same(fleet: Path, serial: Path, tmp_path: Path) -> None:
    pool = Pool(2)
    fleet_run(load(fleet), Settings(store=str(tmp_path / "pool")), pool)
    pool.close()
    assert_same_rows(tmp_path / "pool", serial)
    for index in range(1, 4):
        fleet_run(load(fleet).shard(index, 3), Settings(store=str(tmp_path / "shards")), Serial())
    assert_same_rows(tmp_path / "shards", serial)


def run_with_kills(manifest: Path, store: Path, every: int) -> int:
    """A run of which a worker dies at every so many logs, whichever it is; gives their number."""
    pool, choice, killed = Pool(2), random.Random(1), []  # type: ignore[var-annotated]

    def kill(outcome: Outcome) -> None:
        if outcome.counts.total() % every == 0:
            victim = choice.choice([worker.pid for worker in pool._workers.values()])
            os.kill(victim, signal.SIGKILL)
            killed.append(victim)

    try:
        fleet_run(load(manifest), Settings(store=str(store)), pool, kill)
    finally:
        pool.close()
    return len(killed)


def test_killed_workers_cost_retries_and_no_row(fleet: Path, serial: Path, tmp_path: Path) -> None:
    assert run_with_kills(fleet, tmp_path / "kills", 10) == 6
    assert_same_rows(tmp_path / "kills", serial)


@pytest.mark.long
def test_a_thousand_logs_with_kills_and_damage(tmp_path: Path, contents: list[Path]) -> None:
    manifest = many_logs(tmp_path, contents, 1000)
    fleet_run(load(manifest), Settings(store=str(tmp_path / "serial")), Serial())
    assert run_with_kills(manifest, tmp_path / "kills", 25) == 40
    assert_same_rows(tmp_path / "kills", tmp_path / "serial")
    assert len(rows_of(tmp_path / "kills")) == 1000


def _dies(unit: dict[str, Any]) -> dict[str, Any]:
    if unit["dies"]:
        os.kill(os.getpid(), signal.SIGKILL)
    return {"status": "ok"}


def test_a_unit_that_kills_every_worker_is_given_up() -> None:
    pool = Pool(2)
    units = ({"number": number, "dies": number == 3} for number in range(8))
    results = {unit["number"]: result for unit, result in pool.run(units, _dies)}
    pool.close()
    assert results.pop(3) == {"lost": 3}
    assert results == {number: {"status": "ok"} for number in range(8) if number != 3}


def test_a_lost_unit_is_a_row(fleet: Path, tmp_path: Path) -> None:
    class Loses:
        def run(self, units: Iterator[Any], work: Any) -> Iterator[Any]:
            for unit in units:
                yield unit, {"lost": 3} if unit["machine"] == "m0001" else work(unit)

    manifest = load(fleet).shard(1, 20)
    assert next(machine.name for machine in load(fleet).shard(2, 20).machines) == "m0001"
    outcome = fleet_run(load(fleet).shard(2, 20), Settings(store=str(tmp_path / "s")), Loses())  # type: ignore[arg-type]
    assert outcome.reasons["worker_lost: its worker died 3 times"] == 1
    row = next(row for row in rows_of(tmp_path / "s") if row["machine"] == "m0001")
    assert (row["status"], row["kind"]) == ("failed", "worker_lost")
    # The next run tries it again.
    outcome = fleet_run(load(fleet).shard(2, 20), Settings(store=str(tmp_path / "s")), Serial())
    assert outcome.counts["ok"] == 1
    assert outcome.failed == 0
    assert manifest.machines


def test_a_rerun_does_what_is_new(contents: list[Path], tmp_path: Path) -> None:
    store = str(tmp_path / "store")
    # Copies: times and contents are changed below.
    copies = [shutil.copy(content, tmp_path) for content in contents[1:6]]
    few = Manifest(tuple(Machine(f"m{index}", (str(copy),)) for index, copy in enumerate(copies)))
    first = fleet_run(few, Settings(store=store), Serial())
    assert first.counts["ok"] == 5
    again = fleet_run(few, Settings(store=store), Serial())
    assert again.counts == {"unchanged": 5}
    # The same content at another time is looked at, and not done again.
    log = Path(few.machines[1].logs[0])
    os.utime(log, ns=(1, 1))
    assert fleet_run(few, Settings(store=store), Serial()).counts == {"unchanged": 5}
    before = next(row for row in rows_of(tmp_path / "store") if row["log"] == str(log))
    other = contents[6].read_bytes()
    log.unlink()
    log.write_bytes(other)
    assert fleet_run(few, Settings(store=store), Serial()).counts == {"ok": 1, "unchanged": 4}
    rows = [row for row in rows_of(tmp_path / "store") if row["log"] == str(log)]
    assert len(rows) == 1
    assert rows[0]["log_sha256"] != before["log_sha256"]
    # Another model is another row beside it.
    model = tmp_path / "model.json"
    changed = json.loads(seepd.Model.embedded().content)
    changed["created_by"] = "another"
    model.write_text(json.dumps(changed))
    assert fleet_run(few, Settings(store=store, model=str(model)), Serial()).counts == {"ok": 5}
    assert len([row for row in rows_of(tmp_path / "store") if row["log"] == str(log)]) == 2


def test_baselines_are_learned_once_and_carried_along(tmp_path: Path, logs: Path) -> None:
    manifest = tmp_path / "f.toml"
    manifest.write_text(
        f"[[machines]]\nname = 'press'\nlearn_cycles = 30\nlogs = ['{logs}/healthy.mcap', '{logs}/worn.mcap']\n"
        f"[[machines]]\nname = 'short'\nlearn_cycles = 40\nlogs = ['{logs}/worn.mcap']\n"
        f"[[machines]]\nname = 'none'\nlearn_cycles = 20\nlogs = ['{tmp_path}/f.toml']\n"
    )
    store = tmp_path / "store"
    outcome = fleet_run(load(manifest), Settings(store=str(store)), Serial())
    assert outcome.counts == {"ok": 3, "failed": 1}
    rows = [row for row in rows_of(store) if row["machine"] == "press" and row["job"] == "replay"]
    baseline = seepd.learn_baseline(logs / "healthy.mcap", cycles=30)
    summary = seepd.replay(logs / "worn.mcap", baseline=baseline).summary
    assert rows[1]["leak_area_m2"] == summary["leak_area_m2"]
    assert rows[0]["baseline_sha256"] == rows[1]["baseline_sha256"] is not None
    cycles = [row for row in rows_of(store, "cycles") if row["machine"] == "press"]
    assert all(row["response_m2"] is not None for row in cycles if row["reason"] is None)
    failed = next(row for row in rows_of(store) if row["machine"] == "none" and row["job"] == "replay")
    assert failed["kind"] in ("data", "configuration")
    assert "f.toml" in failed["reason"]
    assert fleet_run(load(manifest), Settings(store=str(store)), Serial()).counts == {"unchanged": 3, "failed": 1}


def test_another_program_is_refused_by_name(fleet: Path, tmp_path: Path) -> None:
    class OtherProgram(Serial):
        def run(self, units: Iterator[Any], work: Any) -> Iterator[Any]:
            return super().run(({**unit, "program": "seepd 9.9.9"} for unit in units), work)

    with pytest.raises(seepd.ConfigurationError, match="this run is of seepd 9.9.9: install the same on every node"):
        fleet_run(load(fleet), Settings(store=str(tmp_path / "s")), OtherProgram())
    assert rows_of(tmp_path / "s") == []


def test_a_cluster_that_is_not_there(fleet: Path, tmp_path: Path) -> None:
    begin = time.monotonic()
    ended = run("fleet", "run", fleet, "--out", tmp_path / "s", "--address", "127.0.0.1:9", check=False)
    assert ended.returncode == 75
    assert ended.stderr.strip() == "seepd: 127.0.0.1:9: no Ray cluster is there: Connection refused"
    assert time.monotonic() - begin < 30


def _mount(folder: Path, size: str) -> bool:
    folder.mkdir()
    libc = ctypes.CDLL(None, use_errno=True)
    return bool(libc.mount(b"tmpfs", str(folder).encode(), b"tmpfs", 0, f"size={size}".encode()) == 0)


def test_a_disk_that_fills_stops_the_run_and_loses_nothing(fleet: Path, serial: Path, tmp_path: Path) -> None:
    small = tmp_path / "small"
    if not _mount(small, "600k"):
        pytest.skip("no right to mount a small disk")
    try:
        with pytest.raises(seepd.IoError, match=r"writing .*: No space left on device"):
            fleet_run(load(fleet), Settings(store=str(small)), Serial())
        done = rows_of(small)
        expected = {(row["machine"], row["log"]): row for row in rows_of(serial)}
        assert 3 < len(done) < 60
        assert all(expected[row["machine"], row["log"]] == row for row in done)
        assert not list(small.rglob("*.tmp"))
        subprocess.run(["mount", "-o", "remount,size=60m", str(small)], check=True)
        outcome = fleet_run(load(fleet), Settings(store=str(small)), Serial())
        assert outcome.counts["unchanged"] >= len([row for row in done if row["status"] == "ok"])
        assert_same_rows(small, serial)
    finally:
        subprocess.run(["umount", str(small)], check=True)


def _echo(unit: dict[str, Any]) -> dict[str, Any]:
    return {"status": "ok", "log": unit["log"]}


def resident_kib() -> int:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return int(line.split()[1])
    raise AssertionError("no VmRSS")


def test_the_drivers_memory_does_not_grow_with_the_manifest() -> None:
    pool = Pool(2)

    def units(count: int) -> Iterator[dict[str, Any]]:
        return ({"log": f"log {number}", "padding": "x" * 1000} for number in range(count))

    assert sum(1 for _ in pool.run(units(500), _echo)) == 500
    before = resident_kib()
    assert sum(1 for _ in pool.run(units(20_000), _echo)) == 20_000
    pool.close()
    # Held, they would be 20 MB.
    assert resident_kib() - before < 4_000


def test_duckdb_reads_the_data_set(serial: Path) -> None:
    duckdb = pytest.importorskip("duckdb")
    counted = duckdb.sql(
        f"select series, count(*) filter (status = 'ok') as ok, max(leak_flow_lpm) > 0.5 as leaks "
        f"from read_parquet('{serial}/logs/**/*.parquet', hive_partitioning = true) where job = 'replay' group by series order by series"
    ).fetchall()
    assert [series for series, _, _ in counted] == ["series-0", "series-1", "series-2"]
    assert sum(ok for _, ok, _ in counted) == 57
    joined = duckdb.sql(
        f"select count(*) from read_parquet('{serial}/cycles/**/*.parquet') c "
        f"join read_parquet('{serial}/logs/**/*.parquet') l using (machine, log, inputs_sha256) where c.flag = 'leak'"
    ).fetchall()
    assert joined[0][0] > 0

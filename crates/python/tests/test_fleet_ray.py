"""On Ray: the same rows, workers that are killed, a driver whose memory is flat, two workers against one."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from fleet_support import load, many_logs, rows_of, small_logs
from seepd.fleet import Settings
from seepd.fleet import run as fleet_run
from seepd.fleet.engines import Engine, Pool, Ray, Serial

pytest.importorskip("ray")
pytestmark = pytest.mark.ray


def ray_workers() -> list[int]:
    """Workers of Ray that are at a task, which their titles tell."""
    found = []
    for folder in Path("/proc").iterdir():
        try:
            title = (folder / "cmdline").read_bytes() if folder.name.isdigit() else b""
        except OSError:
            continue
        if title.startswith((b"ray::perform", b"ray::_sleeps")):
            found.append(int(folder.name))
    return found


def test_a_local_ray_gives_the_same_rows_though_workers_die(tmp_path: Path) -> None:
    manifest = many_logs(tmp_path, small_logs(tmp_path, 4), 120)
    fleet_run(load(manifest), Settings(store=str(tmp_path / "serial")), Serial())
    engine, stop, killed = Ray(None, 2), threading.Event(), []  # type: ignore[var-annotated]

    def kill() -> None:
        while not stop.is_set() and len(killed) < 3:
            time.sleep(0.05)
            for pid in ray_workers()[:1]:
                try:
                    os.kill(pid, signal.SIGKILL)
                    killed.append(pid)
                    stop.wait(2.0)
                except ProcessLookupError:
                    pass

    killer = threading.Thread(target=kill)
    killer.start()
    try:
        outcome = fleet_run(load(manifest), Settings(store=str(tmp_path / "ray")), engine)
    finally:
        stop.set()
        killer.join()
        engine.close()
    assert killed
    assert outcome.counts.total() == 120
    for table in ("logs", "cycles"):
        assert rows_of(tmp_path / "ray", table) == rows_of(tmp_path / "serial", table)


def _sleeps(unit: dict[str, Any]) -> dict[str, Any]:
    time.sleep(unit["sleep_s"])
    return {"status": "ok"}


def resident_kib() -> int:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return int(line.split()[1])
    raise AssertionError("no VmRSS")


@pytest.mark.long
def test_the_driver_of_ray_stays_flat() -> None:
    engine = Ray(None, 2)
    units: Iterator[dict[str, Any]] = (
        {"sleep_s": 0.0, "log": f"log {number}", "padding": "x" * 500} for number in range(30_000)
    )
    sizes = []
    begin = time.perf_counter()
    for number, _ in enumerate(engine.run(units, _sleeps)):
        if number % 5000 == 4999:
            sizes.append(resident_kib())
    took = time.perf_counter() - begin
    engine.close()
    print(f"{1e6 * took / 30_000:.0f} us a task; resident {sizes} KiB")
    # After the first tasks nothing is kept of them.
    assert sizes[-1] - sizes[1] < 20_000


def _took(manifest: Path, store: Path, engine: Engine) -> float:
    # Workers are there before the clock runs.
    list(engine.run(iter([{"sleep_s": 0.5}] * 4), _sleeps)) if isinstance(engine, Ray) else None
    begin = time.perf_counter()
    fleet_run(load(manifest), Settings(store=str(store)), engine)
    took = time.perf_counter() - begin
    engine.close()
    return took


def _is_idle_within(seconds: float) -> bool:
    """The load is a mean of the last minute: what ran before this test still counts for a while."""
    until = time.monotonic() + seconds
    while os.getloadavg()[0] > 0.7:
        if time.monotonic() > until:
            return False
        time.sleep(1)
    return True


@pytest.mark.long
@pytest.mark.parametrize("kind", ["processes", "ray"])
def test_two_workers_against_one(tmp_path: Path, kind: str) -> None:
    if len(os.sched_getaffinity(0)) < 2 or not _is_idle_within(120.0):
        pytest.skip("two idle cores are needed to tell")
    # Five minutes each: of shorter ones a worker's start is a twentieth of the whole.
    manifest = many_logs(tmp_path, small_logs(tmp_path, 8, 30), 200)
    made = (lambda workers: Pool(workers)) if kind == "processes" else (lambda workers: Ray(None, workers))
    one = _took(manifest, tmp_path / "one", made(1))
    two = _took(manifest, tmp_path / "two", made(2))
    print(f"{kind}: {one:.1f} s with one worker, {two:.1f} s with two: {one / two:.2f}")
    assert one / two >= 1.8

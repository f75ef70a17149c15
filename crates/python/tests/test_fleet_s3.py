"""Logs in a store of objects: an S3 server of a package on the loopback, one that denies, and one that never answers."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
import seepd
from fleet_support import rows_of, small_logs
from seepd.fleet import Machine, Manifest, Settings, sources
from seepd.fleet import run as fleet_run
from seepd.fleet.engines import Serial

BUCKET = "press-shop"


@pytest.fixture
def credentials(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "key")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "secret")
    monkeypatch.setenv("AWS_EC2_METADATA_DISABLED", "true")


@pytest.fixture
def server(credentials: None) -> Iterator[tuple[str, list[str]]]:
    """moto's S3, and the ranges that it is asked for."""
    from moto.server import DomainDispatcherApplication, create_backend_app
    from werkzeug.serving import make_server

    ranges: list[str] = []
    app = DomainDispatcherApplication(create_backend_app)

    def recording(environ: dict[str, Any], start: Any) -> Any:
        if environ["REQUEST_METHOD"] == "GET" and "HTTP_RANGE" in environ:
            ranges.append(environ["HTTP_RANGE"])
        return app(environ, start)

    running = make_server("127.0.0.1", 0, recording, threaded=True)
    thread = threading.Thread(target=running.serve_forever)
    thread.start()
    yield f"http://127.0.0.1:{running.server_port}", ranges
    running.shutdown()
    thread.join()


def put(endpoint: str, logs: list[Path]) -> None:
    from pyarrow import fs

    scheme, _, host = endpoint.rpartition("://")
    store = fs.S3FileSystem(endpoint_override=host, scheme=scheme, region="us-east-1", allow_bucket_creation=True)
    store.create_dir(BUCKET)
    for log in logs:
        with store.open_output_stream(f"{BUCKET}/line 1/{log.name}") as sink:
            sink.write(log.read_bytes())


def test_objects_are_read_by_ranges_and_give_the_same_rows(
    server: tuple[str, list[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    endpoint, ranges = server
    logs = small_logs(tmp_path, 3)
    put(endpoint, logs)
    monkeypatch.setattr(sources, "RANGE_BYTES", 100_000)
    s3 = {"endpoint": endpoint, "timeout_s": 20.0}
    machines = (
        Machine("folder", (f"s3://{BUCKET}/line 1/",)),
        Machine("pattern", (f"s3://{BUCKET}/line 1/*-2.mcap",)),
        Machine("gone", (f"s3://{BUCKET}/line 1/none.mcap",)),
        Machine("no bucket", ("s3://none-such/x.mcap",)),
    )
    outcome = fleet_run(Manifest(machines, s3), Settings(store=str(tmp_path / "s3")), Serial())
    assert outcome.counts == {"ok": 4, "failed": 2}
    size = logs[0].stat().st_size
    assert len([each for each in ranges if each == "bytes=100000-199999"]) == 4
    assert len(ranges) >= 4 * (size // 100_000)
    local = Manifest((Machine("folder", (str(tmp_path / "*.mcap"),)),))
    fleet_run(local, Settings(store=str(tmp_path / "local")), Serial())
    of_objects = [row for row in rows_of(tmp_path / "s3") if row["machine"] == "folder"]
    of_files = rows_of(tmp_path / "local")
    places = ("log", "log_mtime_ns", "notes")
    for one, other in zip(of_objects, of_files, strict=True):
        assert {**one, **dict.fromkeys(places)} == {**other, **dict.fromkeys(places)}
        assert one["log"] == f"s3://{BUCKET}/line 1/{Path(other['log']).name}"
    reasons = {row["machine"]: row["reason"] for row in rows_of(tmp_path / "s3") if row["status"] == "failed"}
    assert reasons["gone"] == f"s3://{BUCKET}/line 1/none.mcap: there is no such object"
    assert "none-such" in reasons["no bucket"]
    assert fleet_run(Manifest(machines, s3), Settings(store=str(tmp_path / "s3")), Serial()).counts["unchanged"] == 4


def test_results_in_a_store_of_objects(server: tuple[str, list[str]], tmp_path: Path) -> None:
    endpoint, _ = server
    logs = small_logs(tmp_path, 2)
    put(endpoint, logs)
    manifest = Manifest((Machine("press", (str(tmp_path / "*.mcap"),)),), {"endpoint": endpoint})
    settings = Settings(store=f"s3://{BUCKET}/results")
    assert fleet_run(manifest, settings, Serial()).counts == {"ok": 2}
    assert fleet_run(manifest, settings, Serial()).counts == {"unchanged": 2}
    from seepd.fleet.store import Store

    assert len(Store(settings.store, manifest.s3).rows("logs")) == 2


class _Denies(BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        body = b"<Error><Code>AccessDenied</Code><Message>Access Denied</Message></Error>"
        self.send_response(403)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if self.command == "GET":
            self.wfile.write(body)

    do_HEAD = do_GET  # noqa: N815

    def log_message(self, *_: object) -> None:
        pass


def test_a_store_that_denies(credentials: None, tmp_path: Path) -> None:
    server = ThreadingHTTPServer(("127.0.0.1", 0), _Denies)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    s3 = {"endpoint": f"http://127.0.0.1:{server.server_port}"}
    manifest = Manifest((Machine("press", ("s3://secret/x.mcap",)),), s3)
    outcome = fleet_run(manifest, Settings(store=str(tmp_path)), Serial())
    server.shutdown()
    assert outcome.failed == 1
    (row,) = rows_of(tmp_path)
    assert row["kind"] == "io"
    assert row["reason"].startswith("s3://secret/x.mcap: ")
    assert "ACCESS_DENIED" in row["reason"] or "403" in row["reason"] or "ACCESS DENIED" in row["reason"].upper()


def test_a_store_that_stalls(credentials: None, tmp_path: Path) -> None:
    listener = socket.create_server(("127.0.0.1", 0))
    s3 = {"endpoint": f"http://127.0.0.1:{listener.getsockname()[1]}", "timeout_s": 0.5}
    begin = time.monotonic()
    manifest = Manifest((Machine("press", ("s3://slow/x.mcap",)),), s3)
    outcome = fleet_run(manifest, Settings(store=str(tmp_path)), Serial())
    took = time.monotonic() - begin
    listener.close()
    assert outcome.failed == 1
    assert took < 30
    (row,) = rows_of(tmp_path)
    assert row["kind"] == "io"
    assert "imeout" in row["reason"] or "timed out" in row["reason"] or "NETWORK" in row["reason"]


def test_an_unknown_kind_of_address(tmp_path: Path) -> None:
    manifest = Manifest((Machine("press", ("nonesuch://x/y.mcap",)),))
    outcome = fleet_run(manifest, Settings(store=str(tmp_path)), Serial())
    assert outcome.failed == 1
    assert "nonesuch" in next(iter(outcome.reasons))
    assert isinstance(seepd.IoError("x"), OSError)

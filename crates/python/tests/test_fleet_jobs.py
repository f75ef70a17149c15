"""The jobs beside replay: what their rows say is what the functions say."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import seepd
from conftest import run
from fleet_support import rows_of
from seepd.fleet import Machine, Manifest, Settings, pooled
from seepd.fleet import run as fleet_run
from seepd.fleet.engines import Pool, Serial
from seepd.fleet.jobs import perform
from test_same_bits import SMALL


def test_evaluations(logs: Path, tmp_path: Path) -> None:
    manifest = Manifest((Machine("press", (str(logs / "worn.mcap"),)),))
    assert fleet_run(manifest, Settings(job="evaluate", store=str(tmp_path)), Serial()).counts == {"ok": 1}
    (row,) = rows_of(tmp_path)
    evaluation = seepd.evaluate(logs / "worn.mcap")
    assert json.loads(row["result"]) == evaluation
    assert row["coverage"] == evaluation["sizes"][-1]["coverage"]
    assert row["cycles"] == 24
    assert 0.0 < row["median_relative_error"] < 0.3
    assert fleet_run(manifest, Settings(job="evaluate", store=str(tmp_path)), Serial()).counts == {"unchanged": 1}


def test_what_nobody_thought_of_is_a_row_too(logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def breaks(*_: Any, **__: Any) -> Any:
        raise ZeroDivisionError("by\nnought")

    monkeypatch.setattr(seepd, "replay", breaks)
    manifest = Manifest((Machine("press", (str(logs / "worn.mcap"),)),))
    outcome = fleet_run(manifest, Settings(store=str(tmp_path)), Serial())
    assert outcome.reasons == {"internal: ZeroDivisionError: by nought": 1}
    assert callable(perform)


def test_a_series_with_two_plants_is_refused(tmp_path: Path) -> None:
    manifest = Manifest((Machine("a", ("x",), plant="p.toml"), Machine("b", ("x",), plant="q.toml")))
    with pytest.raises(seepd.ConfigurationError, match=r"series `fleet` have different plant files: p\.toml, q\.toml"):
        fleet_run(manifest, Settings(job="train", store=str(tmp_path)), Serial())


@pytest.mark.long
def test_a_model_for_each_series(tmp_path: Path) -> None:
    manifest = Manifest((Machine("a", ("x",), series="one"), Machine("b", ("x",), series="two")))
    settings = Settings(job="train", store=str(tmp_path), options={**SMALL, "seed": 3})
    pool = Pool(2)
    assert fleet_run(manifest, settings, pool).counts == {"ok": 2}
    assert fleet_run(manifest, settings, pool).counts == {"unchanged": 2}
    pool.close()
    model = seepd.train(seed=3, **SMALL)
    # Eight shares each, which are gone, and the model of one machine, to the byte.
    rows = rows_of(tmp_path)
    assert [row["job"] for row in rows] == ["share"] * 16 + ["train"] * 2
    assert not list(tmp_path.glob("shares/**/*-of-8"))
    for row in rows[16:]:
        assert (tmp_path / row["artifact"]).read_bytes() == model.content
        assert json.loads(row["result"]) == model.report


@pytest.mark.long
def test_machines_are_adopted(tmp_path: Path) -> None:
    log = tmp_path / "press.mcap"
    run("simulate", "--out", log, "--cycles", "30", "--seed", "2")
    manifest = Manifest((Machine("press 1", (str(log),)), Machine("none", (str(tmp_path / "gone.mcap"),))))
    settings = Settings(job="adopt", store=str(tmp_path / "s"), options={"quick": True})
    fleet_run(manifest, settings, Serial())
    rows = {row["machine"]: row for row in rows_of(tmp_path / "s")}
    assert rows["none"]["reason"].endswith("gone.mcap: No such file or directory (os error 2)")
    # The folder and the words are the command's own.
    ended = run("adopt", "--quick", "--json", "--out", tmp_path / "press 1", log, check=False)
    assert rows["press 1"]["status"] == ("ok" if ended.returncode == 0 else "failed")
    if ended.returncode == 0:
        assert rows["press 1"]["result"] == ended.stdout.strip()
        plant = "adopted/press 1/plant.toml"
        assert (tmp_path / "s" / plant).read_text() == (tmp_path / "press 1/plant.toml").read_text()
    else:
        assert rows["press 1"]["reason"] == ended.stderr.strip().splitlines()[-1].removeprefix("seepd: ")


@pytest.mark.long
def test_a_friction_that_a_series_shares_is_named(tmp_path: Path) -> None:
    machines = []
    for index in range(6):
        log = tmp_path / f"g{index}.mcap"
        friction = f"coulomb_friction.force_n={300 + 20 * index}"
        words = [
            "--cycles",
            "5",
            "--seed",
            index + 1,
            "--machine",
            index,
            "--parameter-spread",
            "0.03",
            "--noise",
            "0.003",
        ]
        run("simulate", "--out", log, "--with", friction, *map(str, words))
        machines.append(Machine(f"m{index}", (str(log),), series="press"))
    pool = Pool(2)
    outcome = fleet_run(Manifest(tuple(machines)), Settings(job="gap", store=str(tmp_path / "s")), pool)
    pool.close()
    assert outcome.counts == {"ok": 6}
    first = pooled(str(tmp_path / "s"))[0]
    print(first)
    assert first.effect in ("coulomb_friction", "stribeck_friction", "pressure_friction")
    assert first.shared_probability > 0.9

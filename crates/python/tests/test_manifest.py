"""Manifests: what is wrong is named, with where and what to do."""

from __future__ import annotations

from pathlib import Path

import pytest
import seepd
from conftest import run
from seepd.fleet import Machine, Manifest


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("", "there is no machine: a manifest has [[machines]]"),
        ("x = ", "Invalid value"),
        ("[[machines]]\nname = 'a'\n", "machines[0] has no `logs`"),
        ("[[machines]]\nlogs = 'a'\n", "machines[0] has no `name`"),
        ("[[machines]]\nname = 'a'\nlogs = []\n", "machine `a` has no logs"),
        ("[[machines]]\nname = 'a'\nlogs = 'x'\n[[machines]]\nname = 'a'\nlogs = 'y'\n", "two machines are called `a`"),
        ("[[machines]]\nname = 'a/b'\nlogs = 'x'\n", "`a/b` is no name"),
        ("[[machines]]\nname = '..'\nlogs = 'x'\n", "`..` is no name"),
        ("[[machines]]\nname = 'a'\nlogs = 'x'\nplnat = 'p'\n", "unknown key `plnat`; did you mean `plant`?"),
        ("[[machines]]\nname = 'a'\nlogs = 3\n", "`logs` is 3"),
        ("[[machines]]\nname = 'a'\nlogs = [3]\n", "`logs` has what is no text"),
        ("[[machines]]\nname = 'a'\nlogs = 'x'\nlearn_cycles = 3\n", "it must lie in 20 … 1000"),
        (
            "[[machines]]\nname = 'a'\nlogs = 'x'\nlearn_cycles = 30\nbaseline = 'b'\n",
            "both `baseline` and `learn_cycles`",
        ),
        ("[defaults]\nname = 'a'\n", "[defaults] unknown key `name`"),
        ("machines = 3\n", "`machines` is no list"),
        ("[s3]\nendpiont = 'x'\n", "did you mean `endpoint`?"),
    ],
)
def test_what_is_wrong_with_a_toml_file(tmp_path: Path, text: str, what: str) -> None:
    path = tmp_path / "fleet.toml"
    path.write_text(text)
    with pytest.raises(seepd.ConfigurationError) as caught:
        Manifest.load(path)
    assert what in str(caught.value)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("log\nx\n", "no column `machine`"),
        ("machine,log\na,\n", "line 2 has no log"),
        ("machine,log\na,x,y\n", "line 2 has more cells than the head"),
        ("machine,log,plant\na,x,p\na,y,q\n", "are they two machines of one name?"),
        ("machine,log,learn_cycles\na,x,many\n", "learn_cycles is `many`"),
        ("machine,logs\na,x\n", "did you mean `log`?"),
    ],
)
def test_what_is_wrong_with_a_csv_file(tmp_path: Path, text: str, what: str) -> None:
    path = tmp_path / "fleet.csv"
    path.write_text(text)
    with pytest.raises(seepd.ConfigurationError) as caught:
        Manifest.load(path)
    assert what in str(caught.value)


def test_both_forms_say_the_same(tmp_path: Path) -> None:
    (tmp_path / "f.toml").write_text(
        "[defaults]\nplant = 'p.toml'\nlearn_cycles = 30\n"
        "[[machines]]\nname = 'a'\nlogs = ['x/*.mcap', 's3://b/y']\n[[machines]]\nname = 'b'\nlogs = 'z.csv'\nbaseline = 'b.json'\n"
    )
    (tmp_path / "f.csv").write_text(
        "machine,log,plant,learn_cycles,baseline\na,x/*.mcap,p.toml,30,\nb,z.csv,p.toml,,b.json\na,s3://b/y,p.toml,30,\n"
    )
    toml, csv = Manifest.load(tmp_path / "f.toml"), Manifest.load(tmp_path / "f.csv")
    assert toml == csv
    assert toml.machines[0].logs == (str(tmp_path / "x/*.mcap"), "s3://b/y")
    assert toml.machines[1].learn_cycles is None


def test_shards_are_the_whole_and_do_not_overlap() -> None:
    manifest = Manifest(tuple(Machine(f"m{index}", ("x",)) for index in range(11)))
    for count in (1, 2, 3, 11, 20):
        shares = [manifest.shard(index, count).machines for index in range(1, count + 1)]
        assert sorted(machine.name for share in shares for machine in share) == sorted(
            machine.name for machine in manifest.machines
        )
        assert max(map(len, shares)) - min(map(len, shares)) <= 1


@pytest.mark.parametrize(
    ("words", "code", "what"),
    [
        (["run", "none.toml", "--out", "r"], 66, "none.toml: No such file"),
        (["run", "f.toml", "--out", "r", "--shard", "0/3"], 64, "--shard is `0/3`"),
        (["run", "f.toml", "--out", "r", "--shard", "1/3", "--address", "a:1"], 64, "leave out --address"),
        (["run", "f.toml", "--out", "r", "--learn-cycles", "3"], 64, "--learn-cycles is 3"),
        (["run", "f.toml", "--out", "r", "--workers", "0"], 64, "--workers is 0"),
        (["run", "f.toml", "--out", "r", "--job", "replya"], 64, "invalid choice"),
        (["run", "f.toml", "--out", "r", "--option", "seed"], 64, "it must be NAME=VALUE"),
        (["run", "f.toml"], 64, "--out"),
        (["report", "nowhere", "--html", "x.html"], 65, "there is no data set"),
        (["report", "nowhere", "--html", "f.toml"], 64, "is there already"),
        (["pooled", "nowhere"], 65, "there is no diagnosis in it"),
        (["check", "f.toml"], 66, "machine `a`: "),
    ],
)
def test_the_command_says_what_is_wrong(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], code: int, what: str
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("SEEPD_BIN", raising=False)
    (tmp_path / "f.toml").write_text("[[machines]]\nname = 'a'\nlogs = 'gone.mcap'\n")
    ended = run("fleet", *words, check=False)
    assert ended.returncode == code
    assert what in ended.stderr + ended.stdout
    assert "Traceback" not in ended.stderr

"""The command ``seepd fleet``."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from typing import Any

from ..errors import IoError, SeepdError, UsageError
from .engines import Engine, Pool, Ray, Serial
from .jobs import JOBS
from .manifest import Manifest
from .runner import Outcome, Settings, run

_EXAMPLES = """examples:
  seepd fleet run press-shop.toml --out results --learn-cycles 50
  seepd fleet run press-shop.toml --out results --job gap --address ray://head:10001
  seepd fleet run press-shop.toml --out results --shard "$SLURM_ARRAY_TASK_ID/$SLURM_ARRAY_TASK_COUNT"
  seepd fleet report results --html fleet.html
"""


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> Any:
        self.print_usage(sys.stderr)
        raise UsageError(message)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="seepd fleet",
        description="Jobs over the logs of many machines, and questions to what comes of them.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(dest="command", required=True, parser_class=_Parser)
    job = commands.add_parser("run", help="do a job for each log that it has not been done for")
    job.add_argument("manifest", metavar="MANIFEST", help="machines and their logs, TOML or CSV")
    job.add_argument("--out", required=True, metavar="FOLDER", help="data set of the results: a folder or an address")
    job.add_argument("--job", choices=JOBS, default="replay", help="what is done [default: replay]")
    job.add_argument("--learn-cycles", type=int, metavar="N", help="learn baselines that machines lack from N cycles")
    job.add_argument("--model", metavar="FILE", help="model in the place of the manifest's")
    job.add_argument("--shard", metavar="I/N", help="the I-th of N shares of the machines, without Ray")
    job.add_argument("--address", metavar="HOST:PORT", help="a Ray cluster")
    job.add_argument(
        "--engine",
        choices=("ray", "processes", "serial"),
        help="[default: ray where it is installed, processes with --shard]",
    )
    job.add_argument("--workers", type=int, metavar="N", help="[default: one a core]")
    job.add_argument(
        "--retry-failed", action="store_true", help="do failures again that the same inputs would give again"
    )
    job.add_argument("--rehash", action="store_true", help="read logs whose size and time are as before, too")
    job.add_argument(
        "--shares", type=int, default=8, metavar="N", help="of train: tasks that the simulation is spread over [8]"
    )
    job.add_argument(
        "--option", action="append", default=[], metavar="NAME=VALUE", help="of train (seed=2) and adopt (quick=true)"
    )
    job.add_argument("--json", action="store_true", help="print the counts as one JSON object")
    check = commands.add_parser("check", help="look whether every log of a manifest is there; do nothing")
    check.add_argument("manifest", metavar="MANIFEST")
    page = commands.add_parser("report", help="what a data set says, as a page")
    page.add_argument("data", metavar="FOLDER", help="data set of `seepd fleet run`")
    page.add_argument("--html", metavar="FILE", required=True, help="page to write")
    page.add_argument(
        "--against", nargs=2, metavar="SHA256", help="two models to compare, by the begin of their SHA-256"
    )
    page.add_argument("--force", action="store_true", help="write over an existing page")
    pooled = commands.add_parser("pooled", help="effects that the machines of a series share, as JSON lines")
    pooled.add_argument("data", metavar="FOLDER", help="data set of `seepd fleet run --job gap`")
    return parser


def main(arguments: Sequence[str]) -> int:
    """Runs the command; gives the exit code."""
    try:
        parsed = _parser().parse_args(arguments)
        return {"run": _run, "check": _check, "report": _report, "pooled": _pooled}[parsed.command](parsed)
    except SeepdError as error:
        _say(str(error))
        return error.exit_code
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except KeyboardInterrupt:
        _say("interrupted; what is done is kept, and the same command goes on from there")
        return 130
    except ImportError as error:
        _say(str(error))
        return 78


def _say(line: str) -> None:
    print(f"seepd: {line}", file=sys.stderr)


def _run(parsed: argparse.Namespace) -> int:
    manifest = Manifest.load(parsed.manifest)
    shard = None if parsed.shard is None else _shard(parsed.shard)
    if shard is not None:
        manifest = manifest.shard(*shard)
    if parsed.learn_cycles is not None and not 20 <= parsed.learn_cycles <= 1000:
        raise UsageError(f"--learn-cycles is {parsed.learn_cycles}; it must lie in 20 … 1000")
    if parsed.workers is not None and not 1 <= parsed.workers <= 1024:
        raise UsageError(f"--workers is {parsed.workers}; it must lie in 1 … 1024")
    if not 1 <= parsed.shares <= 4096:
        raise UsageError(f"--shares is {parsed.shares}; it must lie in 1 … 4096")
    settings = Settings(
        job=parsed.job,
        store=parsed.out,
        learn_cycles=parsed.learn_cycles,
        model=parsed.model,
        retry_failed=parsed.retry_failed,
        rehash=parsed.rehash,
        options=_options(parsed.option),
        shares=parsed.shares,
    )
    engine, progress = _engine(parsed, shard is not None), _Progress()
    try:
        outcome = run(manifest, settings, engine, progress)
    except SeepdError as error:
        _say("stopped; what is done is kept, and the same command goes on from there")
        raise error from None
    finally:
        progress.end()
        engine.close()
    _told(outcome, parsed.json)
    return 0


def _told(outcome: Outcome, as_json: bool) -> None:
    counts = {name: outcome.counts[name] for name in ("ok", "failed", "unchanged")}
    if as_json:
        print(json.dumps({**counts, "reasons": dict(outcome.reasons)}))
        return
    print(f"{counts['ok']} done, {counts['failed']} failed, {counts['unchanged']} unchanged since an earlier run")
    for reason, count in outcome.reasons.most_common(20):
        print(f"  {count} × {reason}")


class _Progress:
    """A line on a terminal, rewritten; elsewhere one for every power of two."""

    def __init__(self) -> None:
        self.is_terminal = sys.stderr.isatty()

    def end(self) -> None:
        """Leaves the line."""
        if self.is_terminal:
            print(file=sys.stderr)

    def __call__(self, outcome: Outcome) -> None:
        total = outcome.counts.total()
        line = f"{total} logs: {outcome.counts['ok']} done, {outcome.failed} failed, {outcome.counts['unchanged']} unchanged"
        if self.is_terminal:
            print(f"\r{line}", end="", file=sys.stderr, flush=True)
        elif total >= 16 and total & (total - 1) == 0:
            _say(line)


def _shard(text: str) -> tuple[int, int]:
    index, _, count = text.partition("/")
    if not (index.isdigit() and count.isdigit() and 1 <= int(index) <= int(count)):
        raise UsageError(f"--shard is `{text}`; it must be I/N, such as 1/8, with I from 1 to N")
    return int(index), int(count)


def _options(given: Sequence[str]) -> dict[str, Any]:
    options: dict[str, Any] = {}
    for each in given:
        name, sign, value = each.partition("=")
        if not sign or not name:
            raise UsageError(f"--option is `{each}`; it must be NAME=VALUE")
        options[name.replace("-", "_")] = {"true": True, "false": False}.get(value, value)
    return options


def _engine(parsed: argparse.Namespace, is_shard: bool) -> Engine:
    if is_shard and parsed.address is not None:
        raise UsageError("--shard is for machines without Ray; leave out --address")
    if is_shard and parsed.engine == "ray":
        raise UsageError("--shard is for machines without Ray; leave out --engine ray")
    workers = parsed.workers or len(os.sched_getaffinity(0))
    wanted = parsed.engine
    if parsed.address is not None:
        if wanted not in (None, "ray"):
            raise UsageError(f"--address is of a Ray cluster, and --engine is {wanted}")
        return Ray(parsed.address)
    if wanted is None:
        wanted = "processes" if is_shard or not _has_ray() else "ray"
    if wanted == "ray":
        return Ray(None, workers)
    return Pool(workers) if wanted == "processes" else Serial()


def _has_ray() -> bool:
    import importlib.util

    return importlib.util.find_spec("ray") is not None


def _check(parsed: argparse.Namespace) -> int:
    from .sources import logs_of

    manifest = Manifest.load(parsed.manifest)
    problems, logs, size = [], 0, 0
    for machine in manifest.machines:
        for pattern in machine.logs:
            for log in logs_of(pattern, manifest.s3):
                if log.problem is not None:
                    problems.append(f"machine `{machine.name}`: {log.problem}")
                else:
                    logs += 1
                    size += log.size
        for key in ("config", "model", "baseline", "plant", "machine"):
            path = getattr(machine, key)
            if path is not None and not os.path.exists(path):
                problems.append(f"machine `{machine.name}`: {key} {path} is not there")
    for problem in problems:
        print(problem)
    print(f"{len(manifest.machines)} machines, {logs} logs of {size / 1e6:.1f} MB; {len(problems)} problems")
    return 66 if problems else 0


def _report(parsed: argparse.Namespace) -> int:
    from .report import report

    if os.path.exists(parsed.html) and not parsed.force:
        raise UsageError(f"{parsed.html}: is there already; --force replaces it")
    page = report(parsed.data, tuple(parsed.against) if parsed.against else None)
    try:
        with open(parsed.html, "w", encoding="utf-8") as file:
            file.write(page)
    except OSError as error:
        raise IoError(f"writing {parsed.html}: {error.strerror}") from None
    return 0


def _pooled(parsed: argparse.Namespace) -> int:
    from dataclasses import asdict

    from .pooled import pooled

    for effect in pooled(parsed.data):
        print(json.dumps({"schema": "seepd.pooled/1", **asdict(effect)}))
    return 0

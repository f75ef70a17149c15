#!/usr/bin/env python3
"""Other methods on the logs of a blind check of the diagnosis, scored alike, in one table.

    seepd gap blind plant --logs logs --truth truth --seed 7
    seepd gap blind diagnose --logs logs --answers rivals/seepd
    tools/rivals/run.py --logs logs --truth truth --answers rivals

Each rival has the diagnosis's own record, simulator, bounds, priors and expected errors, through `seepd.CalibrationProblem` of the Python
package, and the effect that is withheld from the diagnosis is withheld from it. Answers that are there are kept. Which single effects are
visible is told by the diagnosis's own calibration, for all alike. Needs the Python package, and
`pip install -r tools/rivals/requirements.txt`.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

# Each process computes on one core: seconds are of a core.
os.environ |= {
    "RAYON_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
}

import bic
import calibration
import forest
import sindy
from answers import Basis, answer
from seepd import CalibrationProblem, DataError
from solver import calibrated, with_wear

RIVALS = {
    "calibration": calibration.opinion,
    "bic": bic.opinion,
    "sindy": sindy.opinion,
    "forest": forest.opinion,
}
TITLES = {
    "seepd": "seepd gap",
    "calibration": "least-squares calibration alone",
    "bic": "single effects by BIC",
    "sindy": "PySINDy discrepancy",
    "forest": "forest on simulated gaps",
}
VIEWS = {"pressures": None, "command": ["command", "position"]}
#: For calibration.
JACOBIANS = 40
DIAGNOSIS = "seepd"


def path_of(answers: Path, rival: str, case: str, view: str) -> Path:
    return answers / rival / f"{case}.{view}.json"


def answer_case(logs: Path, answers: Path, case: str, view: str, without: str, rivals: list[str]) -> None:
    begin = time.process_time()
    problem = CalibrationProblem(logs / f"{case}.mcap", signals=VIEWS[view], without=[without])
    wear = with_wear(problem)
    machine = calibrated(problem, wear, JACOBIANS)
    gaps = problem.held_out_gaps([wear.values, machine.values])
    basis = Basis(problem, wear, machine, (gaps[0], gaps[1]))
    shared = time.process_time() - begin
    for rival in rivals:
        begin = time.process_time()
        opinion = RIVALS[rival](basis)
        said = answer(basis, opinion, shared + time.process_time() - begin)
        path = path_of(answers, rival, case, view)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(said, indent=2) + "\n")


def answer_all(options: argparse.Namespace) -> int:
    without = json.loads((options.logs / "task.json").read_text())["without"]
    failed = 0
    with ProcessPoolExecutor(options.processes) as pool:
        work = {}
        for case, left_out in without.items():
            for view in options.view:
                missing = [r for r in options.rival if not path_of(options.answers, r, case, view).exists()]
                if missing:
                    task = (options.logs, options.answers, case, view, left_out, missing)
                    work[pool.submit(answer_case, *task)] = f"{case}.{view}"
        for done, future in enumerate(as_completed(work), 1):
            try:
                future.result()
            except DataError as error:
                failed += 1
                print(f"{work[future]}: {error}", file=sys.stderr)
            print(f"{done} of {len(work)}: {work[future]}", file=sys.stderr)
    return failed


def scores(options: argparse.Namespace, rival: str) -> dict[str, dict]:
    command = [sys.executable, "-m", "seepd", "gap", "blind", "score", "--json", "-", "--truth", options.truth]
    command += ["--answers", options.answers / rival, "--visible-by", options.answers / DIAGNOSIS]
    scored = subprocess.run(list(map(str, command)), check=True, stdout=subprocess.PIPE)
    return json.loads(scored.stdout)


def told(score: float | None, digits: int = 2) -> str:
    """A score; a dash where there was no case for it."""
    return "–" if score is None else f"{score:.{digits}f}"


def table(options: argparse.Namespace) -> str:
    by_rival = {rival: scores(options, rival) for rival in TITLES if (options.answers / rival).is_dir()}
    text = ""
    for view in options.view:
        text += f"\n{view}\n\n"
        text += "| method | ranked first | pairs both chosen | false calls | AUROC unknown | gap removed | leak error, L/min | seconds: median, largest |\n"
        text += "|---|---|---|---|---|---|---|---|\n"
        for rival, by_view in by_rival.items():
            s = by_view.get(view)
            if s is None:
                continue
            cells = [
                told(s["top_1"]),
                told(s["pairs"][0]),
                ", ".join(told(share) for share in s["false_alarms"]),
                told(s["auroc_unknown"]),
                told(s["shrink"]),
                told(s["leak_error_lpm"][2], 3),
                f"{s['seconds'][0]:.1f}, {s['seconds'][1]:.1f}",
            ]
            text += f"| {TITLES[rival]} | " + " | ".join(cells) + " |\n"
        first = next((by_view[view] for by_view in by_rival.values() if view in by_view), None)
        if first:
            text += f"\n{first['cases']} logs, {first['visible'][0]} single effects visible\n"
    return text


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", type=Path, required=True, help="folder with the logs")
    parser.add_argument("--truth", type=Path, required=True, help="folder with the truth")
    parser.add_argument(
        "--answers",
        type=Path,
        required=True,
        help=f"folder of answers by method; {DIAGNOSIS} is the diagnosis's",
    )
    parser.add_argument(
        "--view",
        nargs="+",
        choices=VIEWS,
        default=list(VIEWS),
        help="signals that are seen",
    )
    parser.add_argument("--rival", nargs="+", choices=RIVALS, default=list(RIVALS), help="methods")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1, help="logs side by side")
    options = parser.parse_args()
    failed = answer_all(options)
    print(table(options))
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())

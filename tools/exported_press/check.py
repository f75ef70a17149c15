"""The press exported as an FMU and read back as a simulator, against the native press: the same verdicts on the same logs? One command that
repeats the table of docs/SIMULATOR_VALIDATION.md.

    python3 tools/exported_press/check.py --seepd target/release/seepd

Each effect of the catalogue is planted at two sizes, beside machines without one, on a press with a short cycle: it is the agreement that is
measured, and not whether the verdict is right.
"""
import argparse
import json
import os
import re
import subprocess
import tempfile
from pathlib import Path

PLANT = Path(__file__).parents[2] / "tests/fixtures/short_cycle_press.toml"
WITHIN = 0.05


def catalogue(seepd):
    """Effects with their parameters: name, neutral value, range."""
    text = subprocess.run([seepd, "simulate", "--list-effects"], capture_output=True, text=True, check=True).stdout
    effects = {}
    for block in text.split("\n## ")[1:]:
        rows = re.findall(r"^\| `(\w+)` \| [^|]+ \| ([^|]+) \| ([^|…]+) … ([^|]+) \|", block, re.M)
        effects[block.split("\n")[0]] = [(name, float(neutral), float(low), float(high)) for name, neutral, low, high in rows]
    return effects


def value(parameter, share):
    name, neutral, low, high = parameter
    if name in ("start_s", "duration_s"):
        return 0.4
    # Away from the neutral value; what is switched off by a value outside of its range goes from its weak end, the high one.
    if low <= neutral <= high:
        return neutral + share * (high - neutral if high > neutral else low - neutral)
    return high - share * (high - low)


def verdict(seepd, log, plant):
    told = subprocess.run([seepd, "gap", log, "--plant", plant, "--json", "-"], capture_output=True, text=True)
    if told.returncode:
        raise SystemExit(told.stderr)
    answer = json.loads(told.stdout)
    probability = {found["effect"]: found["probability"] for found in answer["effects"]}
    probability["unknown"] = answer["unknown_probability"]
    probability["no effect"] = answer["no_effect_probability"]
    return answer["verdict"], answer["chosen"], probability, answer["seconds"]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seepd", default="target/release/seepd")
    parser.add_argument("--library", help="PLATFORM=FILE, for export-fmu")
    parser.add_argument("--cycles", default="12")
    parser.add_argument("--every", type=int, default=1, help="only every N-th log")
    parser.add_argument("--skip", type=int, default=0, help="leave out so many of the first logs")
    parser.add_argument("--logs", nargs="*", help="logs that are there already, of the nominal press, instead")
    arguments = parser.parse_args()
    seepd = os.path.abspath(arguments.seepd)
    logs = same = within = 0
    seconds = [0.0, 0.0]
    largest = 0.0
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        native, exported = folder / "press.toml", folder / "simulator.toml"
        native.write_text("" if arguments.logs else PLANT.read_text())
        library = ["--library", arguments.library] if arguments.library else []
        subprocess.run([seepd, "export-fmu", "--plant", native, "--out", folder / "press.fmu", "--emit-plant", exported,
                        *library], check=True, stdout=subprocess.DEVNULL)
        cases = [("none", [])] * 4
        for effect, parameters in catalogue(seepd).items():
            for share in (0.5, 0.15):
                cases.append((effect, [f"{effect}.{p[0]}={value(p, share):.6g}" for p in parameters]))
        if arguments.logs:
            cases = [(log, log) for log in arguments.logs]
        for number, (effect, assignments) in list(enumerate(cases[:: arguments.every]))[arguments.skip:]:
            log = folder / "log.mcap"
            if arguments.logs:
                log = assignments
            else:
                planted = [part for assignment in assignments for part in ("--with", assignment)]
                order = [seepd, "simulate", "--force", "--out", log, "--plant", native, "--cycles", arguments.cycles,
                         "--leak-area", "2e-7", "--seed", str(number + 1), *planted]
                made = subprocess.run(order, capture_output=True, text=True)
                if made.returncode:
                    print(f"{effect}: not planted: {made.stderr.strip()}", flush=True)
                    continue
            ours, theirs = verdict(seepd, log, native), verdict(seepd, log, exported)
            apart = max(abs(ours[2].get(name, 0.0) - theirs[2].get(name, 0.0)) for name in {*ours[2], *theirs[2]})
            logs += 1
            same += ours[:2] == theirs[:2]
            within += apart <= WITHIN
            largest = max(largest, apart)
            seconds[0] += ours[3]
            seconds[1] += theirs[3]
            if ours[:2] != theirs[:2] or apart > WITHIN:
                print(f"{effect} {assignments}: {ours[:2]} {theirs[:2]}, {apart:.3f} apart", flush=True)
            print(f"{logs} logs: {same} the same verdict and names, {within} within {WITHIN}, largest difference {largest:.3f}; "
                  f"seconds a log: {seconds[0] / logs:.1f} native, {seconds[1] / logs:.1f} by the FMU", flush=True)


if __name__ == "__main__":
    main()

"""Boundary effects planted on a foreign axis, and looked for with `seepd gap` through an FMU of it: one command that repeats the table of
docs/SIMULATOR_VALIDATION.md.

    python3 tools/foreign_axis/check.py --seepd target/release/seepd --seed 7

The axis is written in C against FMI's signatures (fmu.c), the machines whose logs are diagnosed in C as well (machine.c), with laws that share no
code with the program. Needs a C compiler; nothing beside Python's standard library.
"""
import argparse
import json
import os
import random
import statistics
import subprocess
import tempfile
import zipfile
from pathlib import Path

HERE = Path(__file__).parent

# Three sizes of each effect, the largest first: values in the order of docs/effects.md.
PLANTED = {
    "command_quantisation": [[0.0039], [0.002], [0.001]],
    "command_delay": [[0.012], [0.006], [0.003]],
    "valve_hysteresis": [[0.06], [0.03], [0.015]],
    "valve_rate_limit": [[2.0], [3.0], [4.0]],
    "valve_lag": [[8.0, 0.7], [14.0, 0.7], [25.0, 0.7]],
    "valve_bias": [[0.04], [-0.02], [0.01]],
    "valve_deadband": [[0.08], [0.04], [0.02]],
    "valve_flow_shape": [[1.4], [1.2], [0.85]],
    "coulomb_friction": [[300.0], [150.0], [75.0]],
    "stribeck_friction": [[120.0, 300.0, 0.02], [80.0, 200.0, 0.03], [50.0, 120.0, 0.03]],
    "spring_load": [[6000.0, 0.1], [3000.0, 0.15], [1500.0, 0.05]],
    "load_bias": [[300.0], [-200.0], [100.0]],
    "position_scale": [[0.96], [1.02], [0.99]],
    "position_sine": [[2e-4, 0.02], [1e-4, 0.03], [6e-5, 0.015]],
    "position_lag": [[0.02], [0.01], [0.005]],
    "position_quantisation": [[2e-4], [1e-4], [4e-5]],
    "controller_gains": [[1.5, 1.5], [0.75, 1.0], [1.0, 1.4]],
    "controller_clock": [[1.08e-3], [0.95e-3], [1.02e-3]],
}
# Effects that are not told apart, as for the press (docs/GAP_VALIDATION.md); stated before anything was diagnosed.
CLASSES = [
    {"command_delay", "position_lag", "valve_lag"},
    {"coulomb_friction", "stribeck_friction"},
]
# An effect counts as visible where the calibrated gap of a signal is so many floors, as for the press.
FLOORS = 1.5

PLANT = """
kind = "simulator"
stroke_m = 0.3
full_force_n = 3500.0
[fmu]
file = "slide.fmu"
inputs = { command = "u", load = "F_ext" }
outputs = { position = "x", velocity = "v" }
start_position = "x0"
[parameters]
flow = { start = 4e-4, sigma = 0.15 }
mass = { start = 40.0, sigma = 0.3 }
damping = { start = 800.0, sigma = 0.7 }
[controller]
kp = 10.0
ki = 40.0
period_s = 0.002
[cycle]
period_s = 3.0
load = []
moves = [
    { name = "out", from_s = 0.1, to_s = 0.7, to_m = 0.25 },
    { name = "back", from_s = 0.95, to_s = 1.25, to_m = 0.13 },
    { name = "home", from_s = 1.4, to_s = 1.8, to_m = 0.05 },
]
"""

VARIABLES = [
    ("u", "input", "1"), ("F_ext", "input", "N"), ("x", "output", "m"), ("v", "output", "m/s"),
    ("flow", "parameter", "m3/s"), ("mass", "parameter", "kg"), ("damping", "parameter", "N.s/m"),
    ("lag", "parameter", "s"), ("x0", "parameter", "m"),
]


def built(folder):
    """The FMU, and the program that makes logs."""
    flags = ["cc", "-O2", "-ffp-contract=off"]
    library, machine = folder / "slide.so", folder / "machine"
    subprocess.run([*flags, "-shared", "-fPIC", "-o", library, HERE / "fmu.c", "-lm"], check=True)
    subprocess.run([*flags, "-o", machine, HERE / "machine.c", "-lm"], check=True)
    rows = "".join(
        f'<ScalarVariable name="{name}" valueReference="{place}" causality="{causality}"><Real'
        + ("" if causality == "output" else ' start="0"') + "/></ScalarVariable>"
        for place, (name, causality, _) in enumerate(VARIABLES)
    )
    description = (
        '<fmiModelDescription fmiVersion="2.0" modelName="slide" guid="slide"><CoSimulation modelIdentifier="slide"/>'
        f"<ModelVariables>{rows}</ModelVariables></fmiModelDescription>"
    )
    with zipfile.ZipFile(folder / "slide.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", description)
        archive.write(library, "binaries/linux64/slide.so")
    (folder / "slide.toml").write_text(PLANT)
    return machine


def cases(seed, others):
    """Name, factors of flow, mass and damping, values. Half of the machines with an effect have other parameters as well."""
    draw = random.Random(seed)
    factors = lambda off: [draw.uniform(1 - 0.08 * off, 1 + 0.08 * off), draw.uniform(1 - 0.3 * off, 1 + 0.3 * off),
                           draw.uniform(1 - 0.5 * off, 1 + 0.5 * off)]
    all_cases = [("none", [1.0, 1.0, 1.0], []) for _ in range(others)]
    all_cases += [("none", factors(1.0), []) for _ in range(others)]
    for effect, sizes in PLANTED.items():
        all_cases += [(effect, factors(0.5 * draw.randint(0, 1)), values) for values in sizes]
    draw.shuffle(all_cases)
    return all_cases


def alike(effect):
    return next((group for group in CLASSES if effect in group), {effect})


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seepd", default="target/release/seepd")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--cycles", type=int, default=16)
    parser.add_argument("--others", type=int, default=10, help="exact machines, and as many with other parameters")
    parser.add_argument("--first", type=int, help="only the first N logs")
    parser.add_argument("--answers", help="keep the answers in this folder")
    arguments = parser.parse_args()
    seepd = os.path.abspath(arguments.seepd)
    counts = {"visible": 0, "first": 0, "exact": 0, "named": 0, "invisible": 0, "quiet": 0, "machines": 0, "false": 0}
    by_effect, seconds, wrong = {}, [], []
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        machine = built(folder)
        for number, (effect, factors, values) in enumerate(cases(arguments.seed, arguments.others)[: arguments.first]):
            log = folder / "log.csv"
            order = [machine, arguments.seed * 1000 + number, arguments.cycles, *factors, effect, *values]
            with open(log, "w") as out:
                subprocess.run([str(part) for part in order], stdout=out, check=True)
            told = subprocess.run([seepd, "gap", log, "--plant", folder / "slide.toml", "--json", "-"],
                                  stdout=subprocess.PIPE, stderr=subprocess.PIPE)
            if told.returncode:
                raise SystemExit(told.stderr.decode())
            answer = json.loads(told.stdout)
            if arguments.answers:
                os.makedirs(arguments.answers, exist_ok=True)
                truth = {"effect": effect, "factors": factors, "values": values}
                Path(arguments.answers, f"{number:03}.json").write_text(json.dumps({"truth": truth, **answer}, indent=1))
            seconds.append(answer["seconds"])
            called = answer["verdict"] in ("effect", "unknown")
            if effect == "none":
                counts["machines"] += 1
                counts["false"] += called
                if called:
                    wrong.append((number, effect, factors, answer["verdict"], answer["chosen"]))
                continue
            seen = any(gap > FLOORS * answer["floor"].get(signal, 0.0) for signal, gap in answer["gap"]["retuned"].items())
            counts_of = by_effect.setdefault(effect, [0, 0, 0])
            if not seen:
                counts["invisible"] += 1
                counts["quiet"] += not called or (answer["chosen"][:1] and answer["chosen"][0] in alike(effect))
                continue
            ranked = [found["effect"] for found in answer["effects"]]
            first = bool(ranked) and ranked[0] in alike(effect)
            named = answer["verdict"] == "effect" and answer["chosen"][0] in alike(effect)
            counts["visible"] += 1
            counts["first"] += first
            counts["exact"] += bool(ranked) and ranked[0] == effect
            counts["named"] += named
            counts_of[0] += 1
            counts_of[1] += first
            counts_of[2] += named
            if not first:
                wrong.append((number, effect, values, answer["verdict"], ranked[:2]))
    share = lambda part, whole: f"{part / whole:.2f}" if whole else "–"
    print("| score | value |\n|---|---|")
    print(f"| logs | {len(seconds)} |")
    print(f"| effects visible after calibration | {counts['visible']} of {counts['visible'] + counts['invisible']} |")
    print(f"| ranked first, visible, within classes | {share(counts['first'], counts['visible'])} |")
    print(f"| the same by exact name | {share(counts['exact'], counts['visible'])} |")
    print(f"| named by the verdict, visible | {share(counts['named'], counts['visible'])} |")
    print(f"| nothing else called for invisible ones | {counts['quiet']} of {counts['invisible']} |")
    print(f"| called on machines without an effect | {counts['false']} of {counts['machines']} |")
    print(f"| seconds of a diagnosis: median, largest | {statistics.median(seconds):.1f}, {max(seconds):.1f} |")
    print("\n| effect: visible, ranked first, named, of 3 sizes | |\n|---|---|")
    for effect in PLANTED:
        if effect in by_effect:
            print(f"| {effect} | {', '.join(map(str, by_effect[effect]))} |")
    print("\nranked wrong, or called without one:" if wrong else "")
    for line in wrong:
        print(" ", *line)


if __name__ == "__main__":
    main()

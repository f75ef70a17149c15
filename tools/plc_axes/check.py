"""Axes behind a PLC, adopted from a healthy log and tried with later ones: one command that repeats the table of docs/ADOPT_VALIDATION.md.

    python3 tools/plc_axes/check.py --seepd target/release/seepd

The axes are written in C (axis.c), with laws that share no code with the program. Needs a C compiler; nothing beside Python's standard library.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).parent

# Settings of axis.c, and what its user reads off the papers.
MACHINES = {
    "press": (
        "reset=0.5 forward=2 moves=20:0.25:1.0,260:0.25:2.0,20:0.25:1.5",
        {"cylinder": {"bore_mm": 63, "rod_mm": 36, "stroke_mm": 300, "moved_mass_kg": 110, "hose_length_m": 1.2, "hose_bore_mm": 16},
         "valve": {"rated_flow_lpm": 40, "rated_at_bar": 70}, "supply": {"pump_flow_lpm": 60, "relief_bar": 160, "return_bar": 3},
         "controller": {"kind": "pi", "task_period_ms": 2}},
    ),
    "lift": (
        "bore=100 rod=70 stroke=900 mass=1800 lifts=1 flow=100 rated=10 pressure=180 pump=120 natural=25 kp=8 forward=1.9 cycles=50 rate=100 task=10 "
        "acceleration=0.8 noise=0.02 quantum=0.05 hose=4 rounding=0.01 land_leak=1 moves=100:0.3:2.0,700:0.35:3.0,400:0.3:2.0,100:0.3:4.0",
        {"cylinder": {"bore_mm": 100, "rod_mm": 70, "stroke_mm": 900, "moved_mass_kg": 2000, "orientation": "rod_up", "hose_length_m": 4, "hose_bore_mm": 16},
         "valve": {"rated_flow_lpm": 100, "rated_at_bar": 10}, "supply": {"pump_flow_lpm": 120, "relief_bar": 180},
         "controller": {"kind": "p", "task_period_ms": 10}},
    ),
    "through rod": (
        "bore=50 rod=28 second_rod=28 stroke=60 mass=25 flow=20 pressure=210 pump=40 natural=120 kp=60 reset=0.3 window=50 cycles=80 rate=1000 task=1 "
        "acceleration=8 noise=0.001 quantum=0.001 hose=0.3 sines=1 moves=10:0.12:0.6,45:0.12:0.8,10:0.12:0.6",
        {"cylinder": {"bore_mm": 50, "rod_mm": 28, "second_rod_mm": 28, "stroke_mm": 60, "moved_mass_kg": 25, "hose_length_m": 0.3, "hose_bore_mm": 12},
         "valve": {"rated_flow_lpm": 20, "rated_at_bar": 70}, "supply": {"pump_flow_lpm": 40, "relief_bar": 210},
         "controller": {"kind": "pi", "task_period_ms": 1}},
    ),
    "process": (
        "bore=80 rod=56 stroke=400 mass=400 flow=63 pressure=200 pump=70 regulated=0 kp=25 reset=0.6 forward=1.2 force=30000 load_varies=0.02 cycles=50 "
        "rate=250 moves=30:0.2:0.8,330:0.22:0.5,370:0.05:3.0,30:0.3:2.0",
        {"cylinder": {"bore_mm": 80, "rod_mm": 56, "stroke_mm": 400, "moved_mass_kg": 350},
         "valve": {"rated_flow_lpm": 63, "rated_at_bar": 70}, "supply": {"pump_flow_lpm": 70, "relief_bar": 210}, "controller": {"kind": "pi"}},
    ),
    "2:1 spool": (
        "rod=45 stroke=500 mass=200 flow=40 rated=10 port_ratio=0.5 overlap=0.08 rounding=0.006 land_leak=0.3 pressure=140 natural=30 kp=20 reset=1 "
        "forward=1.2 jump=0.07 cycles=50 rate=200 task=5 acceleration=1.5 moves=50:0.2:1.5,400:0.25:2.5,50:0.2:2.0",
        {"cylinder": {"bore_mm": 63, "rod_mm": 45, "stroke_mm": 500, "moved_mass_kg": 200},
         "valve": {"rated_flow_lpm": 40, "rated_at_bar": 10, "overlap_percent": 8, "rod_side_flow_percent": 50},
         "supply": {"pump_flow_lpm": 60, "relief_bar": 140}, "controller": {"kind": "pi", "task_period_ms": 5}},
    ),
    "into its work": (
        "bore=125 rod=90 stroke=250 mass=900 flow=150 pressure=250 pump=160 kp=22 reset=0.8 stiffness=4500 contact=205 load_varies=0.015 cycles=50 "
        "acceleration=1 land_leak=1.2 moves=20:0.1:1.0,180:0.15:0.6,230:0.04:4.0,20:0.15:2.5",
        {"cylinder": {"bore_mm": 125, "rod_mm": 90, "stroke_mm": 250, "moved_mass_kg": 900},
         "valve": {"rated_flow_lpm": 150, "rated_at_bar": 70}, "supply": {"pump_flow_lpm": 160, "relief_bar": 250}, "controller": {"kind": "pi"}},
    ),
    "events": (
        "bore=40 rod=22 stroke=200 mass=30 flow=12 pressure=100 pump=20 kp=35 reset=0.4 forward=1 events=1 jitter=0.35 cycles=70 rate=250 task=4 "
        "acceleration=1.5 moves=20:0.12:0.7,160:0.15:1.2,90:0.1:0.8,20:0.12:1.0",
        {"cylinder": {"bore_mm": 40, "rod_mm": 22, "stroke_mm": 200, "moved_mass_kg": 30},
         "valve": {"rated_flow_lpm": 12, "rated_at_bar": 70}, "supply": {"pump_flow_lpm": 20, "relief_bar": 100}},
    ),
}

# Later logs: what differs, with leaks and losses as shares of the valve's flow at 70 bar.
LATER = {
    "healthy, another day": "seed=3 viscosity_swing=0.3",
    "leak 1.5 %": "seed=4 leak={0.015}",
    "leak 5 %": "seed=5 leak={0.05}",
    "leak 3 %, exponent 0.8": "seed=6 leak={0.03} exponent=0.8",
    "null shifted by 0.8 %": "seed=7 null=0.012",
    "friction 0.3 → 0.8 kN": "seed=8 coulomb=800 breakaway=1200",
    "lost outside 2 %": "seed=9 outside={0.02}",
}
LATER_CYCLES = 25


def setting(settings: str, key: str, usual: float) -> float:
    return next((float(part.split("=")[1]) for part in settings.split() if part.startswith(key + "=")), usual)


def resolved(later: str, flow_lpm: float) -> str:
    """A later log's settings with shares of the valve's flow as flows."""
    before, brace, rest = later.partition("{")
    share, _, after = rest.partition("}")
    return f"{before}{float(share) * flow_lpm}{after}" if brace else later


def toml(sheet: dict) -> str:
    tables = (f"[{table}]\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in values.items()) for table, values in sheet.items())
    return "".join(tables)


def log(axis: Path, settings: str, file: Path, command_alone: bool) -> None:
    signals = ["signals=0"] if command_alone else []
    with file.open("w") as out:
        subprocess.run([axis, *settings.split(), *signals], stdout=out, check=True)


def said(seepd: str, config: Path, file: Path) -> tuple[str, int, int, str]:
    """Median reading in L/min, flagged cycles, cycles, and the cause that most cycles name."""
    lines = subprocess.run([seepd, "replay", "--config", config, "--json", file], capture_output=True, text=True).stdout.splitlines()
    cycles = [cycle for cycle in map(json.loads, lines) if cycle["schema"] == "seepd.cycle/1"]
    sizes = [cycle["leak_flow_lpm"] for cycle in cycles if cycle["leak_flow_lpm"] is not None]
    flagged = sum(cycle["flag"] in ("watch", "leak", "severe") for cycle in cycles)
    causes = [cycle["cause"] for cycle in cycles if cycle.get("cause")]
    reading = f"{statistics.median(sizes):.2f}" if sizes else "–"
    return reading, flagged, len(cycles), statistics.mode(causes) if causes else "–"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seepd", required=True)
    parser.add_argument("--only", nargs="*", choices=list(MACHINES))
    parser.add_argument("--command-alone", action="store_true")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="keep adopted folders and logs, for another build to replay")
    options = parser.parse_args()
    seepd = os.path.abspath(options.seepd)
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        axis = folder / "axis"
        subprocess.run(["cc", "-O2", "-o", axis, HERE / "axis.c", "-lm"], check=True)
        print("| machine | later log | truth, L/min | read | flagged | named |\n|---|---|---|---|---|---|")
        for machine in options.only or MACHINES:
            settings, sheet = MACHINES[machine]
            flow_lpm = setting(settings, "flow", 40) * (70 / setting(settings, "rated", 70)) ** 0.5
            own = folder / machine.replace(":", "-").replace(" ", "_")
            own.mkdir(exist_ok=True)
            healthy, data, adopted = own / "healthy.csv", own / "machine.toml", own / "adopted"
            data.write_text(toml(sheet))
            log(axis, settings, healthy, options.command_alone)
            began = time.monotonic()
            ended = subprocess.run([seepd, "adopt", healthy, "--machine", data, "--out", adopted], stdin=subprocess.DEVNULL, capture_output=True, text=True)
            print(f"{machine}: adopted with exit code {ended.returncode} after {time.monotonic() - began:.0f} s", file=sys.stderr)
            if not (adopted / "baseline.json").exists():
                print(f"| {machine} | {ended.stderr.strip().splitlines()[-1]} | | | | |")
                continue
            for number, (later, changes) in enumerate(LATER.items(), 1):
                file, changes = own / f"later-{number}.csv", resolved(changes, flow_lpm)
                log(axis, f"{settings} cycles={LATER_CYCLES} {changes}", file, options.command_alone)
                reading, flagged, cycles, cause = said(seepd, adopted / "seepd.toml", file)
                print(f"| {machine} | {later} | {setting(changes, 'leak', 0):.2f} | {reading} | {flagged} of {cycles} | {cause} |", flush=True)


if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""An electric positioning axis for `seepd gap`, as a simulator of one's own: it answers each line of JSON with one.

The same axis as electric-axis.toml, with its two friction forces as parameters. Only the standard library is needed.
"""

import json
import math
import sys

FULL_FORCE_N = 351.5065
POSITION_GAIN_PER_S = 160.18
VELOCITY_GAIN_S_PER_M = 24.345
STEPS = 2


def run(period_s, parameters, demand, load):
    """Command and position at each tick, from rest at the first demand."""
    mass, viscous = parameters["mass_kg"], parameters["viscous_n_s_per_m"]
    friction, offset = parameters.get("friction_n", 0.0), parameters.get("offset_n", 0.0)
    h = period_s / STEPS
    x, v = demand[0], 0.0
    commands, positions = [], []
    for asked, force in zip(demand, load):
        u = VELOCITY_GAIN_S_PER_M * (POSITION_GAIN_PER_S * (asked - x) - v)
        u = max(-1.0, min(1.0, u))
        commands.append(u)
        positions.append(x)
        for _ in range(STEPS):
            # Friction is linear in the new speed within 1 mm/s, so that it does not ring at standstill.
            direction = math.tanh(v / 1e-3)
            slope = friction * (1.0 - direction * direction) / 1e-3
            push = FULL_FORCE_N * u + force + offset - friction * direction + slope * v
            v = (v + h / mass * push) / (1.0 + h / mass * (viscous + slope))
            x += h * v
    return {"command": commands, "position": positions}


for line in sys.stdin:
    try:
        print(json.dumps(run(**json.loads(line))), flush=True)
    except Exception as error:  # what is wrong with a run is told, and the next one is tried
        print(json.dumps({"error": repr(error)}), flush=True)

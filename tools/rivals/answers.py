"""Answers in the form that `seepd gap blind score` reads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from seepd import CalibrationProblem
from solver import WEAR, Fit

#: A signal whose gap is so many floors has one.
FLOORS = 1.5


@dataclass(frozen=True)
class Basis:
    """What every rival begins with."""

    problem: CalibrationProblem
    wear: Fit
    calibrated: Fit
    #: Gap on held-out cycles by signal: with wear alone, and calibrated.
    gaps: tuple[dict[str, float], dict[str, float]]


@dataclass(frozen=True)
class Opinion:
    """What a rival says of a log."""

    #: Probability by effect.
    effects: Mapping[str, float] = field(default_factory=dict)
    #: Probability that there is none.
    none: float = 0.0
    #: Probability that it is none of these.
    unknown: float = 0.0
    #: The machine with the effects that are called.
    chosen: Fit | None = None
    #: These effects.
    called: tuple[str, ...] = ()


def has_gap(gap: Mapping[str, float], floor: Mapping[str, float]) -> bool:
    return any(value > FLOORS * floor[signal] for signal, value in gap.items())


def unexplained(misfit: float) -> float:
    """Share of the misfit that a perfect model would not have: what stands for the probability of "none of these"."""
    return max(0.0, 1.0 - 1.0 / max(misfit, 1e-9))


def weighed(basis: Basis, weights: Mapping[str, float], none: float, named: tuple[str, Fit] | None) -> Opinion:
    """An opinion from weights of effects and of none, beside what the better of calibration and the named effect leaves."""
    unknown = unexplained(min([basis.calibrated.misfit, *([named[1].misfit] if named else [])]))
    scale = (1.0 - unknown) / (none + sum(weights.values()))
    return Opinion(
        effects={effect: scale * weight for effect, weight in weights.items()},
        none=scale * none,
        unknown=unknown,
        chosen=named[1] if named else None,
        called=(named[0],) if named else (),
    )


def answer(basis: Basis, opinion: Opinion, seconds: float) -> dict[str, Any]:
    floor = basis.problem.floor
    chosen = opinion.chosen or basis.calibrated
    gap = basis.problem.held_out_gaps([chosen.values])[0]
    likeliest = max(opinion.effects.values(), default=0.0)
    # Where calibration leaves nothing there is nothing to call an effect for.
    if not has_gap(basis.gaps[1], floor):
        verdict = "parameters" if has_gap(basis.gaps[0], floor) else "no_gap"
    elif opinion.called and likeliest >= max(opinion.none, opinion.unknown):
        verdict = "effect"
    elif opinion.unknown > opinion.none:
        verdict = "unknown"
    else:
        verdict = "parameters" if has_gap(basis.gaps[0], floor) else "no_gap"
    by_probability = sorted(opinion.effects.items(), key=lambda item: -item[1])
    return {
        "verdict": verdict,
        "effects": [{"effect": key, "probability": p, "equivalent": []} for key, p in by_probability],
        "unknown_probability": opinion.unknown,
        "no_effect_probability": opinion.none,
        "chosen": list(opinion.called) if verdict == "effect" else [],
        "shrink": {"of_removable": shrink(basis.gaps[0], gap, floor)},
        "leak": {
            "nominal_m2": basis.wear.values[WEAR],
            "retuned_m2": basis.calibrated.values[WEAR],
            "chosen_m2": chosen.values[WEAR],
        },
        "floor": floor,
        "gap": {"nominal": basis.gaps[0], "retuned": basis.gaps[1], "chosen": gap},
        "seconds": seconds,
    }


def shrink(nominal: Mapping[str, float], now: Mapping[str, float], floor: Mapping[str, float]) -> float:
    """Mean over signals with a gap of the share of what is above the floor that is gone."""
    with_gap = [signal for signal in nominal if nominal[signal] > FLOORS * floor[signal]]
    shares = [min(1.0, (nominal[s] - now[s]) / (nominal[s] - floor[s])) for s in with_gap]
    return float(np.mean(shares)) if shares else 0.0

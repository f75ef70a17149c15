"""Each effect of the catalogue fitted by itself beside calibration; the Bayesian information criterion says which.

Schwarz, The Annals of Statistics 6 (1978). A machine with an effect costs ln(n) for each of its parameters; n are the independent values
that the likelihood counts.
"""

from __future__ import annotations

import math

import numpy as np
from answers import Basis, Opinion, weighed
from solver import VALUES_A_SIGNAL, effects, with_effect

#: For each effect.
JACOBIANS, STARTS = 12, 24


def opinion(basis: Basis) -> Opinion:
    problem = basis.problem
    values = VALUES_A_SIGNAL * len(problem.signals)
    fits = {
        effect: with_effect(problem, basis.calibrated, keys, JACOBIANS, STARTS)
        for effect, keys in effects(problem).items()
    }
    criterion = {effect: fits[effect].cost + len(keys) * math.log(values) for effect, keys in effects(problem).items()}
    least = min(basis.calibrated.cost, *criterion.values())
    weights = {effect: float(np.exp(-0.5 * (value - least))) for effect, value in criterion.items()}
    none = float(np.exp(-0.5 * (basis.calibrated.cost - least)))
    best = max(weights, key=lambda effect: weights[effect])
    return weighed(basis, weights, none, (best, fits[best]) if weights[best] > none else None)

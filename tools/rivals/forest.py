"""A forest that has seen simulated gaps of every effect names the one of the log: amortised inference by a classifier.

Machines with each effect at a size anywhere in its range are simulated along the log's own drive. What calibration could take of their
differences from the calibrated machine is projected out; principal components of the rest are what the forest (Geurts, Ernst, Wehenkel,
Machine Learning 63 (2006)) sees. The named effect is then fitted once.
"""

from __future__ import annotations

import numpy as np
from answers import Basis, Opinion, weighed
from sklearn.decomposition import PCA
from sklearn.ensemble import ExtraTreesClassifier
from solver import (
    SEED,
    VALUES_A_SIGNAL,
    Coordinates,
    effects,
    jacobian,
    plant_parameters,
    with_effect,
)

#: Machines of each effect, and of none.
MACHINES = 48
TREES, COMPONENTS = 400, 40
#: For the named effect.
JACOBIANS, STARTS = 20, 24
#: Least size of an effect that is drawn, power of ten of its range.
LEAST_SIZE = -2.5
NONE = "none"


def opinion(basis: Basis) -> Opinion:
    problem = basis.problem
    draw = np.random.default_rng(SEED)
    kinds = {NONE: [], **effects(problem)}
    machines, names = [], []
    for name, keys in kinds.items():
        own = Coordinates(problem, keys)
        for _ in range(MACHINES):
            share = 10.0 ** draw.uniform(LEAST_SIZE, 0.0, len(keys))
            # A range that has its neutral value within is left to either side.
            neutral = own.read({})
            side = np.where(
                draw.uniform(size=len(keys)) * (own.high - own.low) < own.high - neutral,
                own.high,
                own.low,
            )
            machines.append(basis.calibrated.values | own.values(neutral + (side - neutral) * share))
            names.append(name)
    space = Coordinates(problem, plant_parameters(problem))
    moved = space.neighbours(basis.calibrated.values)
    rows = problem.residuals([basis.calibrated.values, *moved, *machines])
    slopes, prior = jacobian(rows[: len(moved) + 1], space, basis.calibrated.values), space.prior_slopes()
    taken = slopes @ np.linalg.solve(slopes.T @ slopes + prior.T @ prior + 1e-9 * np.eye(len(prior)), slopes.T)
    seen = rows[len(moved) + 1 :] - rows[0]
    seen = seen + draw.normal(size=seen.shape) * expected(rows.shape[1], problem)
    seen, of_log = (np.arcsinh(row - row @ taken) for row in (seen, -rows[:1]))
    components = PCA(COMPONENTS, random_state=SEED).fit(seen)
    trees = ExtraTreesClassifier(TREES, random_state=SEED, min_samples_leaf=2).fit(components.transform(seen), names)
    shares = trees.predict_proba(components.transform(of_log))[0]
    said = {str(name): float(share) for name, share in zip(trees.classes_, shares, strict=True)}
    none = said.pop(NONE)
    best = max(said, key=lambda effect: said[effect])
    if said[best] <= none:
        return weighed(basis, said, none, None)
    return weighed(basis, said, none, (best, with_effect(problem, basis.calibrated, kinds[best], JACOBIANS, STARTS)))


def expected(length: int, problem) -> float:
    """Error of one value of a row: the squares of a signal's add up to the independent values that it counts for."""
    return float(np.sqrt(VALUES_A_SIGNAL * len(problem.signals) / length))

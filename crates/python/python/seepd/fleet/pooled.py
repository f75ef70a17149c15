"""One effect on many machines: what the diagnoses of a series say together.

Each diagnosis gives probabilities, the evidence of one log over what was believed beforehand. Pooled, a series has unknown shares of machines by
cause (no effect, each effect, none of the catalogue's), and a machine's cause is drawn by them: a mixture with a sparse Dirichlet prior,
sampled by Gibbs. A cause that fifty logs each hold for possible, and beside which they hold fifty different ones, has nearly all of the
share, and each machine's own probability then follows it. Sizes are pooled as random effects (DerSimonian and Laird, Controlled Clinical
Trials 7 (1986)): machines of a series have the effect at sizes of their own, about one.

A machine has one cause here. Two effects that every machine of a series has are told with half of the share each.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..errors import DataError

#: Names of the two causes that are no effect of the catalogue.
NO_EFFECT, UNKNOWN = "no effect", "not in the catalogue"
#: What a diagnosis believes beforehand, of no effect (``PRIOR_NONE`` in crates/gap/src/rank.rs), and what is taken for a cause that the
#: catalogue lacks; the effects share the rest.
PRIOR_NONE, PRIOR_UNKNOWN = 0.45, 0.1
#: Probability below which a diagnosis is not believed to exclude a cause: laws are never quite those of the machine.
LEAST = 1e-3
#: Weight of what is believed beforehand, in machines.
PRIOR_MACHINES = 1.0
#: Rounds of the sampler, and those that are left out while it settles.
ROUNDS, SETTLING = 4000, 500


@dataclass(frozen=True)
class PooledSize:
    """A parameter of an effect over a series."""

    parameter: str
    value: float
    interval95: tuple[float, float]
    #: Standard deviation from machine to machine, beyond what the logs leave open.
    spread: float
    #: Each machine's value, drawn towards the series' as far as its own log leaves it open.
    by_machine: dict[str, float]


@dataclass(frozen=True)
class PooledEffect:
    """A cause and how far a series shares it."""

    series: str
    effect: str
    #: Probability that most machines of the series have it.
    shared_probability: float
    #: Share of the machines that have it, and the interval that holds it nine times in ten.
    share: float
    share_interval90: tuple[float, float]
    #: Probability that a machine has it, given all.
    by_machine: dict[str, float]
    #: The largest probability that a single diagnosis gave it.
    largest_alone: float
    sizes: tuple[PooledSize, ...]


@dataclass(frozen=True)
class Told:
    """What the diagnosis of one log says."""

    machine: str
    none: float
    unknown: float
    effects: Mapping[str, float]
    #: Value, low and high end of the 95 % interval by effect and parameter.
    sizes: Mapping[tuple[str, str], tuple[float, float, float]]


def pooled(store: str, s3: Mapping[str, Any] | None = None, seed: int = 1) -> list[PooledEffect]:
    """The effects of every series of a data set of ``gap``, those first that are shared most surely."""
    from .store import Store

    found: list[PooledEffect] = []
    for series, told in _diagnoses(Store(store, s3)).items():
        found += pool(series, told, seed)
    return sorted(found, key=lambda effect: (-effect.shared_probability, -effect.share, effect.series, effect.effect))


def _diagnoses(store: Any) -> dict[str, list[Told]]:
    rows = store.rows("logs", None, "gap").to_pylist()
    rows = [row for row in rows if row["status"] == "ok" and row["verdict"] != "cannot_tell"]
    if not rows:
        raise DataError(f"{store.root}: there is no diagnosis in it; `seepd fleet run --job gap` makes them")
    sizes: dict[tuple[str, str, str], dict[tuple[str, str], tuple[float, float, float]]] = defaultdict(dict)
    effects: dict[tuple[str, str, str], dict[str, float]] = defaultdict(dict)
    for row in store.rows("effects", None, "gap").to_pylist():
        of_log = (row["machine"], row["log"], row["inputs_sha256"])
        effects[of_log][row["effect"]] = row["probability"]
        if row["low95"] is not None and row["high95"] is not None:
            sizes[of_log][row["effect"], row["parameter"]] = (row["value"], row["low95"], row["high95"])
    by_series: dict[str, list[Told]] = defaultdict(list)
    for row in sorted(rows, key=lambda row: (row["machine"], row["log"])):
        of_log = (row["machine"], row["log"], row["inputs_sha256"])
        told = Told(
            row["machine"],
            row["no_effect_probability"],
            row["unknown_probability"],
            effects[of_log],
            sizes[of_log],
        )
        by_series[row["series"]].append(told)
    return by_series


def pool(series: str, told: Sequence[Told], seed: int = 1, catalogue: int | None = None) -> list[PooledEffect]:
    """What the diagnoses of a series say together; an effect for each that any of them names."""
    if catalogue is None:
        import seepd

        catalogue = len(seepd.effects())
    names = sorted({name for each in told for name in each.effects})
    machines = sorted({each.machine for each in told})
    if not names:
        return []
    causes = [NO_EFFECT, UNKNOWN, *names]
    each_effect = (1.0 - PRIOR_NONE - PRIOR_UNKNOWN) / catalogue
    # What no diagnosis names has its part of the prior all the same; it goes to what is not in the catalogue.
    unnamed = (catalogue - len(names)) * each_effect
    prior = np.array([PRIOR_NONE, PRIOR_UNKNOWN + unnamed, *[each_effect] * len(names)])
    evidence = np.zeros((len(machines), len(causes)))
    for each in told:
        said = np.array([each.none, each.unknown, *(each.effects.get(name, 0.0) for name in names)])
        said = np.maximum(said, LEAST)
        # A machine's logs say the same of one machine.
        evidence[machines.index(each.machine)] += np.log(said / said.sum() / prior)
    shares, belongs = _sampled(evidence, prior, seed)
    found = []
    for index, name in enumerate(names, 2):
        share = shares[:, index]
        low, high = np.quantile(share, [0.05, 0.95])
        of_machine = dict(zip(machines, belongs[:, index].tolist(), strict=True))
        found.append(
            PooledEffect(
                series,
                name,
                float((share > 0.5).mean()),
                float(share.mean()),
                (float(low), float(high)),
                of_machine,
                max(each.effects.get(name, 0.0) for each in told),
                tuple(_sizes(name, told, of_machine)),
            )
        )
    return sorted(found, key=lambda effect: -effect.shared_probability)


def _sampled(
    evidence: npt.NDArray[np.float64], prior: npt.NDArray[np.float64], seed: int
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Draws of the shares, and the probability of each cause for each machine."""
    random = np.random.default_rng(seed)
    likelihood = np.exp(evidence - evidence.max(axis=1, keepdims=True))
    machines, causes = likelihood.shape
    shares = prior / prior.sum()
    draws, belongs = np.empty((ROUNDS, causes)), np.zeros((machines, causes))
    for turn in range(-SETTLING, ROUNDS):
        weights = likelihood * shares
        weights /= weights.sum(axis=1, keepdims=True)
        chosen = (weights.cumsum(axis=1) < random.random((machines, 1))).sum(axis=1).clip(max=causes - 1)
        counts = np.bincount(chosen, minlength=causes)
        shares = random.dirichlet(PRIOR_MACHINES * prior + counts)
        if turn >= 0:
            draws[turn] = shares
            belongs += weights
    return draws, belongs / ROUNDS


def _sizes(effect: str, told: Sequence[Told], of_machine: Mapping[str, float]) -> list[PooledSize]:
    parameters = sorted({parameter for each in told for name, parameter in each.sizes if name == effect})
    found = []
    for parameter in parameters:
        given = [(each.machine, *each.sizes[effect, parameter]) for each in told if (effect, parameter) in each.sizes]
        values = np.array([value for _, value, _, _ in given])
        # An interval of 95 % is 3.92 standard deviations wide; one of no width would outweigh all others.
        deviations = np.array([(high - low) / 3.92 for _, _, low, high in given])
        deviations = np.maximum(deviations, 1e-3 * np.abs(values).max(initial=1e-12))
        believed = np.array([of_machine[machine] for machine, *_ in given])
        size = _random_effects(values, deviations, believed)
        if size is None:
            continue
        mean, error, spread = size
        towards = deviations**2 / (deviations**2 + spread**2)
        own = dict(
            zip((machine for machine, *_ in given), (towards * mean + (1 - towards) * values).tolist(), strict=True)
        )
        found.append(PooledSize(parameter, mean, (mean - 1.96 * error, mean + 1.96 * error), spread, own))
    return found


def _random_effects(
    values: npt.NDArray[np.float64], deviations: npt.NDArray[np.float64], believed: npt.NDArray[np.float64]
) -> tuple[float, float, float] | None:
    """Mean, its standard error, and the standard deviation between machines; each counts as far as it is believed to have the effect."""
    weights = believed / deviations**2
    if weights.sum() <= 0.0:
        return None
    mean = float((weights * values).sum() / weights.sum())
    scatter = float((weights * (values - mean) ** 2).sum())
    scale = float(weights.sum() - (weights**2).sum() / weights.sum())
    between = max(0.0, (scatter - (believed.sum() - 1.0)) / scale) if scale > 0.0 else 0.0
    weights = believed / (deviations**2 + between)
    mean = float((weights * values).sum() / weights.sum())
    return mean, float(weights.sum() ** -0.5), float(between**0.5)

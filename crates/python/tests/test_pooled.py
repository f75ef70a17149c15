"""Pooled diagnoses: what no single log can tell, many together do; and they claim nothing that is not there."""

from __future__ import annotations

import numpy as np
import pytest
from seepd.fleet.pooled import Told, pool

EFFECTS = [f"effect_{index}" for index in range(32)]


def diagnosis(
    machine: str, random: np.random.Generator, true: str | None, hint: float, size: float | None = None
) -> Told:
    """A log that holds the true effect for possible with a probability of about ``hint``, and three others, chance's, for as likely."""
    others = random.choice([name for name in EFFECTS if name != true], 3, replace=False)
    weights = {str(name): hint * random.uniform(0.5, 1.5) for name in others}
    if true is not None:
        weights[true] = hint * random.uniform(0.5, 1.5)
    none, unknown = 0.3 * random.uniform(0.5, 1.5), 0.1
    total = sum(weights.values()) + none + unknown
    sizes = {} if size is None or true is None else {(true, "size"): (size, size - 0.2, size + 0.2)}
    return Told(
        machine, none / total, unknown / total, {name: weight / total for name, weight in weights.items()}, sizes
    )


def test_fifty_machines_name_what_none_of_them_can() -> None:
    random = np.random.default_rng(4)
    sizes = random.normal(2.0, 0.3, 50)
    told = [diagnosis(f"m{index}", random, "effect_7", 0.15, sizes[index]) for index in range(50)]
    found = pool("press", told, catalogue=32)
    first = found[0]
    assert first.effect == "effect_7"
    assert first.largest_alone < 0.5
    assert first.shared_probability > 0.99
    assert first.share > 0.8
    assert min(first.by_machine.values()) > 0.5
    assert all(other.shared_probability < 0.01 for other in found[1:])
    (size,) = first.sizes
    assert size.interval95[0] < 2.0 < size.interval95[1]
    assert 0.1 < size.spread < 0.5
    own = np.array([size.by_machine[f"m{index}"] for index in range(50)])
    # Drawn towards the series' size, and still the machine's own.
    assert np.abs(own - sizes).max() < 0.3
    assert np.corrcoef(own, sizes)[0, 1] > 0.99


def test_a_single_log_stays_in_doubt() -> None:
    random = np.random.default_rng(4)
    (first, *_) = pool("press", [diagnosis("m", random, "effect_7", 0.15)], catalogue=32)
    assert first.shared_probability < 0.5


def test_nothing_is_shared_where_nothing_is() -> None:
    for seed in range(5):
        random = np.random.default_rng(seed)
        told = [diagnosis(f"m{index}", random, None, 0.15) for index in range(50)]
        assert max(effect.shared_probability for effect in pool("press", told, catalogue=32)) < 0.05


def test_a_part_of_a_series_has_it() -> None:
    told = []
    for index in range(40):
        has = index < 10
        told.append(
            Told(f"m{index}", 0.05 if has else 0.9, 0.02, {"effect_3": 0.9 if has else 0.003, "effect_5": 0.003}, {})
        )
    found = {effect.effect: effect for effect in pool("press", told, catalogue=32)}
    share = found["effect_3"]
    assert share.share_interval90[0] < 0.25 < share.share_interval90[1]
    assert share.shared_probability < 0.01
    assert [share.by_machine[f"m{index}"] > 0.5 for index in (0, 9, 10, 39)] == [True, True, False, False]
    assert found["effect_5"].share < 0.1


def test_the_same_seed_gives_the_same_numbers() -> None:
    told = [diagnosis(f"m{index}", np.random.default_rng(index), "effect_1", 0.2) for index in range(5)]
    assert pool("press", told, 3, 32) == pool("press", told, 3, 32)
    assert pool("press", [], 3, 32) == []


def test_logs_of_one_machine_are_evidence_of_one_machine() -> None:
    random = np.random.default_rng(8)
    told = [diagnosis("m", random, "effect_7", 0.15) for _ in range(20)]
    (first, *_) = pool("press", told, catalogue=32)
    assert list(first.by_machine) == ["m"]
    assert first.by_machine["m"] > 0.95
    # One machine says little of a series.
    assert first.share_interval90[0] < 0.6


def test_the_priors_are_those_of_the_diagnosis() -> None:
    from pathlib import Path

    from seepd.fleet.pooled import PRIOR_NONE

    source = Path(__file__).parents[2] / "gap/src/rank.rs"
    if not source.exists():
        pytest.skip("the crate's source is not here")
    assert f"const PRIOR_NONE: f64 = {PRIOR_NONE};" in source.read_text()

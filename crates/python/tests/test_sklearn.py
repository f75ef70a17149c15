"""The estimators pass scikit-learn's own checks where they apply, and say what the core says."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest
import seepd
from seepd.sklearn import LeakEstimator, LeakRegressor
from sklearn.base import clone
from sklearn.ensemble import RandomForestRegressor
from sklearn.model_selection import cross_val_score
from sklearn.utils.estimator_checks import parametrize_with_checks


@parametrize_with_checks([LeakRegressor(n_estimators=10, random_state=1)])
def test_regressor_passes_scikit_learns_checks(estimator: Any, check: Any) -> None:
    check(estimator)


# A LeakEstimator reads rows of one length, that of its model's cycle, and is trained before: scikit-learn's checks bring tables of a few
# columns, which it refuses. These ask nothing of the data.
APPLY = {
    "check_estimator_cloneable",
    "check_estimator_repr",
    "check_no_attributes_set_in_init",
    "check_do_not_raise_errors_in_init_or_set_params",
    "check_parameters_default_constructible",
    "check_get_params_invariance",
    "check_set_params",
    "check_mixin_order",
    "check_estimator_tags_renamed",
    "check_valid_tag_types",
    "check_fit1d",
    "check_complex_data",
    "check_estimator_sparse_tag",
    "check_estimator_sparse_array",
    "check_estimator_sparse_matrix",
}


def _name(check: Any) -> str:
    return str(getattr(check, "func", check).__name__)


@parametrize_with_checks([LeakEstimator()])
def test_estimator_passes_the_checks_that_apply(estimator: Any, check: Any) -> None:
    if _name(check) not in APPLY:
        pytest.skip("brings data that are no duty cycles")
    check(estimator)


@pytest.fixture(scope="module")
def press() -> dict[str, np.ndarray[Any, Any]]:
    """A machine's healthy cycles and leaking ones, a row each."""
    made = {}
    for name, leak, cycles in (("healthy", 1e-8, 24), ("leaking", 1.5e-7, 6)):
        log = seepd.simulate(cycles=cycles, leak_area=leak, machine=3, parameter_spread=0.04, seed=len(name))
        made[name] = log["command"].reshape(cycles, 10_000)
    return made


def test_estimates_are_those_of_a_replay(press: dict[str, Any]) -> None:
    alone = LeakEstimator().predict(press["leaking"])
    replayed = seepd.replay({"command": press["leaking"].ravel()})["leak_area_m2"]
    # The rows' filter settles in the row itself rather than in the cycle before.
    assert np.allclose(alone[1:-1], replayed[1:-1], rtol=0.03)


def test_a_baseline_cancels_what_is_the_machines_own(press: dict[str, Any]) -> None:
    fitted = LeakEstimator().fit(press["healthy"])
    by_parts = LeakEstimator()
    for part in np.array_split(press["healthy"], 4):
        by_parts.partial_fit(part)
    assert by_parts.baseline_ == fitted.baseline_
    estimates = fitted.predict(press["leaking"])
    truth = 1.5e-7 - 1e-8
    assert np.all(np.abs(estimates - truth) < 0.2 * truth), estimates
    low, high = fitted.predict_interval(press["leaking"]).T
    assert np.mean((low <= truth) & (truth <= high)) >= 0.5
    assert np.array_equal(pickle.loads(pickle.dumps(fitted)).predict(press["leaking"]), estimates)
    assert np.nanmax(fitted.predict(press["healthy"])) < 2e-8


def test_rows_are_judged_one_by_one(press: dict[str, Any]) -> None:
    estimator = LeakEstimator().fit(press["healthy"])
    rows = press["leaking"]
    order = [4, 0, 2]
    assert np.array_equal(estimator.predict(rows)[order], estimator.predict(rows[order]))
    # Wherever in the cycle a row begins.
    turned = estimator.predict(np.roll(rows, 3_000, axis=1))
    assert np.allclose(turned, estimator.predict(rows), rtol=0.05)


def test_what_is_no_cycle_has_no_estimate() -> None:
    estimates = LeakEstimator().predict(np.zeros((2, 10_000)))
    assert np.isnan(estimates).all()
    with pytest.raises(ValueError, match="a cycle of this model has 10000"):
        LeakEstimator().predict(np.zeros((2, 50)))
    with pytest.raises(ValueError, match="cycles"):
        LeakEstimator().fit(np.zeros((30, 10_000)))
    assert LeakEstimator().partial_fit(np.zeros((3, 10_000))).baseline_ is None


def test_trees_are_as_good_as_scikit_learns() -> None:
    random = np.random.default_rng(1)
    rows = random.uniform(size=(600, 6))
    target = 1e-7 * np.exp(3 * rows[:, 0] + np.sin(6 * rows[:, 1])) * random.normal(1, 0.05, 600)
    ours = LeakRegressor(60, random_state=1)
    theirs = RandomForestRegressor(60, min_samples_leaf=2, max_features=0.5, random_state=1)
    assert cross_val_score(ours, rows, target).mean() > cross_val_score(theirs, rows, target).mean() - 0.02
    logarithmic = clone(ours).set_params(offset=2e-8).fit(rows, target)
    error = np.median(np.abs(logarithmic.predict(rows) / target - 1))
    assert error < 0.1
    with pytest.raises(ValueError, match="0 or more"):
        logarithmic.fit(rows, -target)

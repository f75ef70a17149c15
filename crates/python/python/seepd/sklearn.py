"""Estimators for scikit-learn, on the same core.

:class:`LeakRegressor` learns trees from any features, as ``seepd train`` does from those of cycles; :class:`LeakEstimator` reads rows of commands
with a trained model, and learns a machine's baseline. Both pass scikit-learn's own checks where these apply; ``docs/python.md`` says which
do not, and why.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from . import _core
from ._words import PathLike
from .files import Baseline, Model
from .table import need

need("sklearn", "sklearn")

from sklearn.base import BaseEstimator, RegressorMixin  # noqa: E402
from sklearn.utils import check_random_state  # noqa: E402
from sklearn.utils.validation import check_is_fitted, validate_data  # noqa: E402

Floats = npt.NDArray[np.float64]


class LeakRegressor(RegressorMixin, BaseEstimator):  # type: ignore[misc]
    """Bagged regression trees as ``seepd train`` grows them, in the logarithm of the target where all targets are 0 or more.

    Args:
        n_estimators: trees.
        min_samples_leaf: least observations in a leaf.
        max_features: share of the features that each split may choose from.
        offset: added to targets before their logarithm is learned; None: targets are learned as they are. ``seepd train`` takes 0.02 mm²
            (2e-8 m²) on the nominal press, so that leaks of all sizes count by their ratio.
        random_state: seed; the same seed gives the same trees.
    """

    def __init__(
        self,
        n_estimators: int = 40,
        *,
        min_samples_leaf: int = 2,
        max_features: float = 0.5,
        offset: float | None = None,
        random_state: Any = None,
    ) -> None:
        self.n_estimators = n_estimators
        self.min_samples_leaf = min_samples_leaf
        self.max_features = max_features
        self.offset = offset
        self.random_state = random_state

    def fit(self, X: npt.ArrayLike, y: npt.ArrayLike) -> LeakRegressor:  # noqa: N803
        """Grows the trees."""
        rows, target = validate_data(self, X, y, dtype=np.float64, y_numeric=True, order="C")
        target = np.asarray(target, dtype=np.float64)
        if self.offset is not None:
            if target.min() < 0.0:
                raise ValueError(f"y has {target.min()}; with an offset every target is 0 or more")
            target = np.log(target + self.offset)
        # The trees stop where nothing is left to explain, measured against 1.
        self.target_mean_ = float(target.mean())
        self.target_scale_ = float(target.std()) or 1.0
        target = (target - self.target_mean_) / self.target_scale_
        seed = int(check_random_state(self.random_state).randint(np.iinfo(np.int32).max))
        self.forest_json_ = _core.Forest.grow(
            rows, target, int(self.n_estimators), int(self.min_samples_leaf), float(self.max_features), seed
        ).to_json()
        return self

    def predict(self, X: npt.ArrayLike) -> Floats:  # noqa: N803
        """The mean of the trees."""
        return self._vote(X)[0]

    def predict_spread(self, X: npt.ArrayLike) -> Floats:  # noqa: N803
        """Standard deviation over the trees, in what they learned: with an offset the logarithm."""
        return self._vote(X)[1]

    def _vote(self, X: npt.ArrayLike) -> tuple[Floats, Floats]:  # noqa: N803
        check_is_fitted(self)
        rows = validate_data(self, X, dtype=np.float64, order="C", reset=False)
        mean, spread = _core.Forest.from_json(self.forest_json_).predict(rows)
        mean = self.target_mean_ + self.target_scale_ * mean
        spread = self.target_scale_ * spread
        if self.offset is not None:
            mean = np.maximum(np.exp(mean) - self.offset, 0.0)
        return mean, spread


class LeakEstimator(BaseEstimator):  # type: ignore[misc]
    """Leak areas, m², of rows of commands, each row one duty cycle of the model's length, wherever in the cycle it begins.

    ``fit`` and ``partial_fit`` learn the machine's baseline from rows of a healthy machine, at least 20 of them; ``predict`` is relative
    to it. Without either, ``predict`` is the model's own estimate. A row that is no cycle, or unlike all of training, is NaN.

    Args:
        model: a model, its file, or None for the one that the program brings.
        occasion: why the baseline is learned, in a few words.
    """

    def __init__(self, model: Model | PathLike | None = None, *, occasion: str = "commissioning") -> None:
        self.model = model
        self.occasion = occasion

    #: The baseline, once one is learned.
    baseline_: Baseline | None

    def fit(self, X: npt.ArrayLike, y: object = None) -> LeakEstimator:  # noqa: N803
        """Learns the baseline of these cycles."""
        self.healthy_ = self._rows(X, reset=True)
        return self._learn()

    def partial_fit(self, X: npt.ArrayLike, y: object = None) -> LeakEstimator:  # noqa: N803
        """Learns the baseline of these cycles and those before: once there are 20. ``predict`` is the model's own estimate until then."""
        rows = self._rows(X, reset=not hasattr(self, "healthy_"))
        self.healthy_ = np.concatenate([getattr(self, "healthy_", rows[:0]), rows])
        if len(self.healthy_) >= 20:
            return self._learn()
        self.baseline_ = None
        return self

    def predict(self, X: npt.ArrayLike) -> Floats:  # noqa: N803
        """Leak area of each row, m²."""
        return self._estimate(X)[0]

    def predict_interval(self, X: npt.ArrayLike) -> Floats:  # noqa: N803
        """Ends of the interval that holds the truth nine times in ten, m²: a row each."""
        _, low, high = self._estimate(X)
        return np.stack([low, high], axis=1)

    def _learn(self) -> LeakEstimator:
        self.baseline_ = Baseline(self._reader().learn(self.healthy_, self.occasion))
        return self

    def _estimate(self, X: npt.ArrayLike) -> tuple[Floats, Floats, Floats]:  # noqa: N803
        baseline = getattr(self, "baseline_", None)
        rows = self._rows(X, reset=not hasattr(self, "n_features_in_"))
        return self._reader().estimate(rows, None if baseline is None else baseline.text)

    def _rows(self, X: npt.ArrayLike, *, reset: bool) -> Floats:  # noqa: N803
        rows: Floats = validate_data(self, X, dtype=np.float64, order="C", reset=reset)
        samples = self._reader().samples
        # Periods vary by some per cent.
        if not 0.8 * samples <= rows.shape[1] <= 1.2 * samples:
            raise ValueError(f"X has {rows.shape[1]} samples a row; a cycle of this model has {samples}")
        return rows

    def _reader(self) -> _core.RowReader:
        model = self.model
        if model is None:
            content = _core.embedded_model()
        else:
            content = (model if isinstance(model, Model) else Model.load(model)).content
        return _core.RowReader(content)

    def __sklearn_is_fitted__(self) -> bool:
        # The model is trained before: there is always an estimate.
        return True

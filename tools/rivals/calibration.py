"""Least squares calibration alone. It has no effects: what it cannot fit is unknown."""

from answers import Basis, Opinion, unexplained


def opinion(basis: Basis) -> Opinion:
    unknown = unexplained(basis.calibrated.misfit)
    return Opinion(none=1.0 - unknown, unknown=unknown)

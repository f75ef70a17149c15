"""A discrepancy model by PySINDy: sparse terms that the balances of the calibrated plant lack on the recorded signals.

Brunton, Proctor, Kutz, PNAS 113 (2016); Kaheman, Kaiser, Strom, Kutz, Brunton, "Learning discrepancy models from experimental data"
(2019). The balances are those of docs/simulator.md with the calibrated parameters. Their rest on the calibrated simulation, which is what
differentiation makes, is taken off that on what was recorded; pressures that the log lacks are the simulated ones. Each term of the
libraries stands for an effect of the catalogue, or for a parameter; what parameters could take is projected out first. The effect that
explains most is then fitted once.
"""

from __future__ import annotations

import warnings
from collections import defaultdict

import numpy as np
import numpy.typing as npt
import pysindy
from answers import Basis, Opinion, unexplained, weighed
from solver import effects, with_effect

Array = npt.NDArray[np.float64]

#: For the named effect.
JACOBIANS, STARTS = 20, 24
#: Coefficients of terms scaled to unit size below which a term is dropped, share of the discrepancy's own size.
THRESHOLD = 0.1
#: The nominal press, docs/simulator.md.
CAP_AREA_M2, ROD_AREA_M2, STROKE_M = 3.117e-3, 2.099e-3, 0.5
DISCHARGE, DENSITY_KG_PER_M3 = 0.7, 870.0
KP_PER_M, KI_PER_M_S = 12.0, 15.0
PARAMETER = "parameter"


class Measured:
    """Signals and derivatives in the course of a cycle."""

    def __init__(self, basis: Basis, signals: dict[str, Array]) -> None:
        problem, values = basis.problem, basis.calibrated.values
        bins = len(signals["command"])
        self.dt = problem.period_s / bins
        self.t = (np.arange(bins) + 0.5) * self.dt
        demand, load = (
            np.array([part.mean() for part in np.array_split(column, bins)]) for column in problem.drives()[0]
        )
        self.u, self.x = signals["command"], signals["position"]
        self.p_s, self.p_3, self.p_1, self.p_2 = (signals[name] for name in ("p_supply", "p_inlet", "p_cap", "p_rod"))
        self.load = load * values.get("load_scale", 1.0)
        self.e = demand - self.x
        self.v = self.slope(self.x)
        self.a = self.slope(self.v)

    def slope(self, values: Array) -> Array:
        method = pysindy.SmoothedFiniteDifference(smoother_kws={"window_length": 7, "polyorder": 3})
        return np.asarray(method(values[:, None], self.t))[:, 0]


def flow(gain: Array | float, dp: Array, transition_pa: float) -> Array:
    return gain * dp / (dp**2 + transition_pa**2) ** 0.25


def balances(m: Measured, p: dict[str, float]) -> dict[str, tuple[Array, float, list[tuple[str, Array]]]]:
    """By balance: what is left of it, the size of its terms, and further ones by the effect that they stand for."""
    transition = p["transition_pressure_pa"]
    valve, beta, returned = (
        p["valve_m3_per_s_sqrt_pa"],
        p["bulk_modulus_pa"],
        p["return_pressure_pa"],
    )
    out = m.u > 0.0
    # Flow at full command, by the direction.
    full_1 = np.where(
        out,
        flow(valve, m.p_3 - m.p_1, transition),
        flow(valve, m.p_1 - returned, transition),
    )
    full_2 = np.where(
        out,
        flow(valve, m.p_2 - returned, transition),
        flow(valve, m.p_3 - m.p_2, transition),
    )
    q_1, q_2 = m.u * full_1, -m.u * full_2
    leak_gain = DISCHARGE * p["leak_area_m2"] * np.sqrt(2.0 / DENSITY_KG_PER_M3)
    leak = flow(leak_gain, m.p_1 - m.p_2, transition) + (m.p_1 - m.p_2) / p["seal_resistance_pa_s_per_m3"]
    cross = (m.p_3 - m.p_2) / p["valve_rod_resistance_pa_s_per_m3"]
    line = flow(p["line_m3_per_s_sqrt_pa"], m.p_s - m.p_3, transition)
    relief = np.maximum(0.0, (m.p_s - p["relief_pressure_pa"]) / p["relief_resistance_pa_s_per_m3"])
    cap_m3 = p["cap_dead_volume_m3"] + CAP_AREA_M2 * m.x
    rod_m3 = p["rod_dead_volume_m3"] + ROD_AREA_M2 * (STROKE_M - m.x)
    d_1, d_2, d_s = (m.slope(pressure) for pressure in (m.p_1, m.p_2, m.p_s))
    sign_u, sign_v, du = np.tanh(m.u / 0.01), np.tanh(m.v / 0.002), m.slope(m.u)
    normal = CAP_AREA_M2 * m.p_1 + ROD_AREA_M2 * m.p_2

    def of_port(full: Array, way: float, pressure: Array, d_pressure: Array, volume: Array) -> list[tuple[str, Array]]:
        """Terms of a chamber's balance; `way` is 1 where a positive command lets oil in."""
        return [
            (PARAMETER, way * m.u * full),
            (PARAMETER, m.p_1 - m.p_2),
            ("valve_deadband", -way * sign_u * full),
            ("valve_bias", way * full),
            ("valve_flow_shape", way * m.u * np.abs(m.u) * full),
            ("valve_asymmetry", way * m.u * full * ~out),
            ("valve_hysteresis", way * np.tanh(du / 0.05) * full),
            ("valve_lag", way * du * full),
            ("valve_wear", np.exp(-np.abs(m.u) / 0.05) * (m.p_3 - pressure)),
            ("return_back_pressure", (way * m.u < 0.0) * (m.u * full) ** 3),
            ("external_leak", -pressure),
            ("hose_volume", -d_pressure),
            ("entrained_air", -volume * d_pressure / np.maximum(pressure, 1e5)),
            ("position_scale", m.v),
            ("position_lag", m.a),
        ]

    control = KP_PER_M * m.e + KI_PER_M_S * np.cumsum(m.e) * m.dt
    return {
        "force": (
            p["mass_kg"] * m.a - normal_force(m) + p["viscous_friction_n_s_per_m"] * m.v - m.load,
            rms(m.load),
            [
                (PARAMETER, m.v),
                (PARAMETER, m.a),
                (PARAMETER, m.load),
                ("load_bias", np.ones_like(m.v)),
                ("coulomb_friction", -sign_v),
                ("stribeck_friction", -sign_v * np.exp(-np.abs(m.v) / 0.02)),
                ("pressure_friction", -sign_v * normal),
                ("spring_load", -(m.x - m.x.mean())),
                ("structure_compliance", m.slope(m.a)),
            ],
        ),
        "cap": (
            cap_m3 / beta * d_1 - (q_1 - CAP_AREA_M2 * m.v - leak),
            rms(q_1),
            of_port(full_1, 1.0, m.p_1, d_1, cap_m3),
        ),
        "rod": (
            rod_m3 / beta * d_2 - (q_2 + ROD_AREA_M2 * m.v + leak + cross),
            rms(q_2),
            of_port(full_2, -1.0, m.p_2, d_2, rod_m3),
        ),
        "supply": (
            p["supply_volume_m3"] / beta * d_s - (p["pump_flow_m3_per_s"] - line - relief),
            p["pump_flow_m3_per_s"],
            [
                (PARAMETER, np.ones_like(m.v)),
                ("pump_slip", -m.p_s),
                ("accumulator", -d_s / np.maximum(m.p_s, 1e5) ** 2),
                ("shared_supply", -1.0 * (m.p_s < np.median(m.p_s))),
            ],
        ),
        "controller": (
            m.u - control,
            rms(m.u),
            [
                ("controller_gains", m.e),
                ("controller_gains", np.cumsum(m.e) * m.dt),
                ("controller_clock", m.t * m.v),
                ("command_delay", -du),
            ],
        ),
    }


def normal_force(m: Measured) -> Array:
    return CAP_AREA_M2 * m.p_1 - ROD_AREA_M2 * m.p_2


def opinion(basis: Basis) -> Opinion:
    parameters = basis.problem.parameters
    values = {key: basis.calibrated.values.get(key, parameter.value) for key, parameter in parameters.items()}
    catalogue = effects(basis.problem)
    explained: dict[str, float] = defaultdict(float)
    left = []
    problem = basis.problem
    simulated = dict(
        zip(
            problem.simulated_signals,
            problem.simulated(basis.calibrated.values)[0],
            strict=True,
        )
    )
    recorded = simulated | dict(zip(problem.signals, problem.recorded()[0], strict=True))
    of_simulation = balances(Measured(basis, simulated), values)
    for name, (rest, scale, terms) in balances(Measured(basis, recorded), values).items():
        # In shares of the balance's own size, so that balances can be compared.
        rest = (rest - of_simulation[name][0]) / scale
        of_parameters = np.column_stack(
            [unit(term) for effect, term in terms if effect == PARAMETER] or [np.ones_like(rest)]
        )
        known = [(effect, unit(term)) for effect, term in terms if effect in catalogue]
        if not known:
            continue
        rest, library = (beyond(of_parameters, part) for part in (rest, np.column_stack([term for _, term in known])))
        size = rms(rest)
        coefficients = sparse(library, rest / size) * size
        for (effect, _), column, coefficient in zip(known, library.T, coefficients, strict=True):
            explained[effect] += float(coefficient**2) * rms(column) ** 2
        left.append(rms(rest - library @ coefficients) ** 2)
    best = max(explained, key=lambda effect: explained[effect], default=None)
    if best is None or explained[best] == 0.0 or unexplained(basis.calibrated.misfit) == 0.0:
        return weighed(basis, explained, sum(left), None)
    fitted = with_effect(problem, basis.calibrated, catalogue[best], JACOBIANS, STARTS)
    return weighed(basis, explained, sum(left), (best, fitted))


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) or 1e-300


def unit(term: Array) -> Array:
    return term / rms(term)


def beyond(columns: Array, values: Array) -> Array:
    """What no sum of the columns makes of values."""
    taken, *_ = np.linalg.lstsq(columns, values, rcond=None)
    return values - columns @ taken


def sparse(library: Array, rest: Array) -> Array:
    """Coefficients by sequentially thresholded least squares."""
    model = pysindy.SINDy(
        feature_library=pysindy.IdentityLibrary(),
        optimizer=pysindy.STLSQ(threshold=THRESHOLD, alpha=0.01),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that no term is left is an answer
        model.fit(library, t=1.0, x_dot=rest[:, None])
    return np.asarray(model.coefficients())[0]

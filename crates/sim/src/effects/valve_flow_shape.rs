//! Valve flow shape: metering notches whose opening is not in proportion to the spool.

use super::{Effect, EffectInfo, Equation, Law, Parameter, Substep, built_by};
use crate::real::Real;

/// See the [module](self).
pub(crate) struct ValveFlowShape;

/// A notch whose area goes with a power of the way from its tip, and where on it the spool's way begins.
struct Notch<T> {
    start: T,
    /// Of the way from the tip; one less where the spool begins there, since the opening itself is a factor then.
    power: T,
    /// Areas where the way begins, and one over what the whole way adds, in units of the power.
    area_at_start: T,
    per_whole_way: T,
}

impl<T: Real> Notch<T> {
    fn new(values: &[T]) -> Self {
        let (exponent, start) = (values[0], values[1]);
        let one = T::splat(1.0);
        let area_at_start = start.pow(exponent);
        Notch {
            start,
            power: start.where_positive(exponent, exponent - one),
            area_at_start,
            per_whole_way: one / ((one + start).pow(exponent) - area_at_start),
        }
    }
}

/// Below this opening the law of a spool that begins at the tip is linear: powers below 1 are infinitely steep at 0.
const LINEAR_BELOW: f64 = 1e-4;

impl<T: Real> Law<T> for Notch<T> {
    fn is_in_balances(&self) -> bool {
        false
    }

    #[inline(always)]
    fn spool(&self, _memory: &mut [T], command: T, _substep: &Substep<T>) -> T {
        let size = command.abs();
        let from_tip = self.start.where_positive(self.start + size, size.max(T::splat(LINEAR_BELOW)));
        let power = from_tip.pow(self.power);
        let further_in = (power - self.area_at_start) * self.per_whole_way;
        self.start.where_positive(command.where_positive(further_in, -further_in), command * power)
    }
}

impl Effect for ValveFlowShape {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "valve_flow_shape",
            parameters: &[
                Parameter {
                    name: "exponent",
                    unit: "1",
                    neutral: 1.0,
                    range: (0.7, 2.0),
                    source: "progressive and degressive notches in data sheets of proportional valves",
                },
                Parameter {
                    name: "notch_start",
                    unit: "1",
                    neutral: 0.0,
                    range: (0.0, 1.0),
                    source: "flow curves of proportional valves that are bent and yet steep at their beginning; with 0.5 and an exponent of 2 \
                             half of the flow is in proportion to the spool",
                },
            ],
            law: "spool = sign(u) · ((notch_start + |u|)^exponent − notch_start^exponent) / ((notch_start + 1)^exponent − \
                  notch_start^exponent); from the tip, notch_start = 0: u |u|^(exponent − 1), linear below 1e-4",
            signature: "strokes at middle speed need another command than the simulation; fast ones and holds hardly",
            equation: Equation::Cap,
        }
    }
    fn is_neutral(&self, values: &[f64]) -> bool {
        values[0] == 1.0
    }
    built_by!(Notch::new);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spool(values: &[f64], command: f64) -> f64 {
        let substep = Substep { tick: 0, index: 0, steps: 1, dt: 1e-3, period: 1e-3 };
        ValveFlowShape.scalar(values).spool(&mut [], command, &substep)
    }

    #[test]
    fn from_the_tip_it_is_a_power_to_the_bit() {
        for (exponent, command) in [(1.4, 0.3), (0.7, -0.02), (2.0, 1e-5), (1.3, -1.0)] {
            let power = command * Real::pow(f64::abs(command).max(1e-4), exponent - 1.0);
            assert_eq!(spool(&[exponent, 0.0], command), power);
        }
    }

    /// A share of the flow in proportion to the spool, the rest to its square.
    #[test]
    fn further_in_a_square_is_a_parabola() {
        for start in [0.1, 0.5, 1.0] {
            let linear = 2.0 * start / (1.0 + 2.0 * start);
            for u in [-1.0, -0.4, 0.0, 0.05, 0.7, 1.0] {
                let parabola = linear * u + (1.0 - linear) * u * f64::abs(u);
                assert!((spool(&[2.0, start], u) - parabola).abs() < 1e-12, "{start} {u}");
            }
        }
    }

    #[test]
    fn further_in_it_comes_to_the_whole_opening_and_is_odd() {
        for (exponent, start) in [(0.7, 0.4), (1.2, 0.05), (2.0, 1.0)] {
            assert!((spool(&[exponent, start], 1.0) - 1.0).abs() < 1e-12);
            assert_eq!(spool(&[exponent, start], -0.3), -spool(&[exponent, start], 0.3));
        }
    }
}

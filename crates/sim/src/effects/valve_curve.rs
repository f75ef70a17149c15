//! Valve flow curve as data sheets draw it: fine in the middle, and steeper beyond a knee or the further the spool goes.

use super::{Effect, EffectInfo, Equation, Law, Parameter, Substep, built_by};
use crate::real::Real;

/// See the [module](self).
pub(crate) struct ValveCurve;

/// A line of a slope below one, and what is left to the full flow: from the knee on, in proportion, as a parabola, or between.
struct Curve<T> {
    null_slope: T,
    knee: T,
    curvature: T,
}

impl<T: Real> Curve<T> {
    fn new(values: &[T]) -> Self {
        Curve { null_slope: values[0], knee: values[1], curvature: values[2] }
    }
}

impl<T: Real> Law<T> for Curve<T> {
    fn is_in_balances(&self) -> bool {
        false
    }

    #[inline(always)]
    fn spool(&self, _memory: &mut [T], command: T, _substep: &Substep<T>) -> T {
        let one = T::splat(1.0);
        let opening = command.abs();
        let beyond = (opening - self.knee).max(T::splat(0.0)) / (one - self.knee);
        let steeper = beyond * (one + self.curvature * (beyond - one));
        let flow = self.null_slope * opening + (one - self.null_slope) * steeper;
        command.where_positive(flow, -flow)
    }
}

impl Effect for ValveCurve {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "valve_curve",
            parameters: &[
                Parameter {
                    name: "null_slope",
                    unit: "1",
                    neutral: 1.0,
                    range: (0.2, 1.3),
                    source: "fine-metering spools: from a fifth of the mean slope (double gain, progressive) to a third above it (degressive)",
                },
                Parameter {
                    name: "knee",
                    unit: "1",
                    neutral: 0.0,
                    range: (0.0, 0.7),
                    source: "double-gain spools: 40 or 60 % of full command",
                },
                Parameter {
                    name: "curvature",
                    unit: "1",
                    neutral: 0.0,
                    range: (0.0, 1.0),
                    source: "0 is a second line, 1 a parabola",
                },
            ],
            law: "spool = sign(u) · (s |u| + (1 − s) b (1 + c (b − 1))), b = max(|u| − knee, 0)/(1 − knee), s the null_slope, c the curvature",
            signature: "slow strokes and holds need more command than a line would, fast ones hardly",
            equation: Equation::Cap,
        }
    }
    built_by!(Curve::new);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flow(values: [f64; 3], command: f64) -> f64 {
        let substep = Substep { tick: 0, index: 0, steps: 1, dt: 1e-3, period: 1e-3 };
        Curve::new(&values).spool(&mut [], command, &substep)
    }

    #[test]
    fn the_curves_of_data_sheets_are_among_them() {
        for command in [-1.0, -0.7, -0.4, -0.1, 0.0, 0.02, 0.3, 0.5, 1.0_f64] {
            let (size, sign) = (command.abs(), command.signum());
            assert!((flow([1.0, 0.0, 0.0], command) - command).abs() < 1e-15);
            // Progressive: a line and a parabola.
            let progressive = sign * size * (0.7 + 0.3 * size);
            assert!((flow([0.7, 0.0, 1.0], command) - progressive).abs() < 1e-12, "{command}");
            // Double gain: 20 % of the flow at 40 % of the command.
            let double = if size < 0.4 { 0.5 * size } else { 0.2 + 0.8 * (size - 0.4) / 0.6 };
            assert!((flow([0.5, 0.4, 0.0], command) - sign * double).abs() < 1e-12, "{command}");
        }
    }
}

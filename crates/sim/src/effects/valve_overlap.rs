//! Overlap of a valve with round edges: the lands begin to pass oil before the spool has travelled all of the overlap.

use super::{Effect, EffectInfo, Equation, Law, Parameter, Substep, built_by};
use crate::real::Real;

/// See the [module](self).
pub(crate) struct ValveOverlap;

/// How round the edges of lands are.
pub(super) const ROUNDING: Parameter = Parameter {
    name: "rounding",
    unit: "1",
    neutral: 0.0,
    range: (0.0, 0.05),
    source: "Merritt, Hydraulic Control Systems (1967), ch. 5: radial clearance and rounding of the metering edges",
};

/// Half the overlap and how round the edges are, shares of full command.
pub(super) struct RoundEdges<T> {
    half_width: T,
    rounding_squared: T,
}

impl<T: Real> RoundEdges<T> {
    pub(super) fn new(values: &[T]) -> Self {
        RoundEdges { half_width: values[0], rounding_squared: values[1] * values[1] }
    }

    /// What a land is open whose edge the spool has passed by that much.
    #[inline(always)]
    fn opening(&self, beyond: T) -> T {
        T::splat(0.5) * (beyond + (beyond * beyond + self.rounding_squared).sqrt())
    }
}

impl<T: Real> Law<T> for RoundEdges<T> {
    fn is_in_balances(&self) -> bool {
        false
    }

    /// What one pair of lands passes more than the other: what moves a piston. What both pass runs past it. Sharp edges leave the larger of
    /// 0 and what is beyond them, to the bit.
    #[inline(always)]
    fn spool(&self, _memory: &mut [T], command: T, _substep: &Substep<T>) -> T {
        let size = command.abs();
        let open = self.opening(size - self.half_width) - self.opening(-size - self.half_width);
        command.where_positive(open, -open)
    }
}

impl Effect for ValveOverlap {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "valve_overlap",
            parameters: &[
                Parameter {
                    name: "half_width",
                    unit: "1",
                    neutral: 0.0,
                    range: (0.0, 0.25),
                    source: "proportional valves for presses are sold with up to 20 %",
                },
                ROUNDING,
            ],
            law: "spool = o(u) − o(−u), o(u) = ½ (b + √(b² + rounding²)) the opening of a land, b = u − half_width",
            signature: "holds without a leak settle within the overlap, those with one beside its edge",
            equation: Equation::Cap,
        }
    }
    built_by!(RoundEdges::new);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::ValveDeadband;

    fn spool(effect: &dyn Effect, values: &[f64], command: f64) -> f64 {
        let substep = Substep { tick: 0, index: 0, steps: 1, dt: 1e-3, period: 1e-3 };
        effect.scalar(values).spool(&mut [], command, &substep)
    }

    /// Sharp edges pass the larger of 0 and what is beyond them, to the bit.
    #[test]
    fn sharp_edges_are_a_dead_band_and_no_overlap_is_a_line() {
        for step in -40..=40 {
            let command = 0.025 * f64::from(step);
            let beyond = (command.abs() - 0.09).max(0.0).copysign(command);
            assert_eq!(spool(&ValveOverlap, &[0.09, 0.0], command), beyond, "{command}");
            assert_eq!(spool(&ValveDeadband, &[0.09, 0.0], command), beyond, "{command}");
            assert!((spool(&ValveOverlap, &[0.0, 0.01], command) - command).abs() < 1e-15, "{command}");
        }
    }

    /// At its edge a land is open by half of the rounding; far beyond it, by what a sharp one is; within the overlap it closes with the
    /// square of the rounding over the distance.
    #[test]
    fn round_edges_open_early() {
        let (half_width, rounding) = (0.09, 0.008);
        let at = |command: f64| spool(&ValveOverlap, &[half_width, rounding], command);
        let other_land = 0.25 * rounding * rounding / (2.0 * half_width);
        assert!((at(half_width) - (0.5 * rounding - other_land)).abs() < 1e-6);
        assert!((at(0.6) - (0.6 - half_width)).abs() < 1e-4);
        let within = 0.25 * rounding * rounding * (1.0 / 0.04 - 1.0 / 0.14);
        assert!((at(0.05) / within - 1.0).abs() < 0.02, "{} {within}", at(0.05));
        assert!((at(-0.05) + at(0.05)).abs() < 1e-15);
    }
}

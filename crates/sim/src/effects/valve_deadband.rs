//! Valve dead band: overlapped spool lands, which pass nothing until the spool has travelled the overlap.

use super::{Effect, EffectInfo, Equation, Law, Parameter, Substep, built_by};
use crate::real::Real;

/// See the [module](self).
pub(crate) struct ValveDeadband;

/// Half the dead travel, share of full command.
struct Deadband<T> {
    half_width: T,
}

impl<T: Real> Deadband<T> {
    fn new(values: &[T]) -> Self {
        Deadband { half_width: values[0] }
    }
}

impl<T: Real> Law<T> for Deadband<T> {
    fn is_in_balances(&self) -> bool {
        false
    }

    #[inline(always)]
    fn spool(&self, _memory: &mut [T], command: T, _substep: &Substep<T>) -> T {
        let beyond = (command.abs() - self.half_width).max(T::splat(0.0));
        command.where_positive(beyond, -beyond)
    }
}

impl Effect for ValveDeadband {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "valve_deadband",
            parameters: &[Parameter {
                name: "half_width",
                unit: "1",
                neutral: 0.0,
                range: (0.0, 0.15),
                source: "Merritt, Hydraulic Control Systems (1967), ch. 5: overlap of closed-centre spools, to 15 % of travel",
            }],
            law: "spool = sign(u) · max(|u| − half_width, 0)",
            signature: "the command jumps by twice the half width whenever its sign changes; holds hunt slowly across the band",
            equation: Equation::Cap,
        }
    }
    built_by!(Deadband::new);
}

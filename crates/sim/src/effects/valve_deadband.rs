//! Valve dead band: overlapped spool lands, which pass nothing until the spool has travelled the overlap, or little where their edges are
//! round.

use super::{Effect, EffectInfo, Equation, Parameter, built_by};
use crate::effects::valve_overlap::{ROUNDING, RoundEdges};

/// See the [module](self).
pub(crate) struct ValveDeadband;

impl Effect for ValveDeadband {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "valve_deadband",
            parameters: &[
                Parameter {
                    name: "half_width",
                    unit: "1",
                    neutral: 0.0,
                    range: (0.0, 0.15),
                    source: "Merritt, Hydraulic Control Systems (1967), ch. 5: overlap of closed-centre spools, to 15 % of travel",
                },
                ROUNDING,
            ],
            law: "spool = o(u) − o(−u), o(u) = ½ (b + √(b² + rounding²)) the opening of a land, b = u − half_width; where edges are sharp: \
                  sign(u) · max(|u| − half_width, 0)",
            signature: "the command jumps by twice the half width whenever its sign changes; holds hunt slowly across the band, or creep in \
                        it where edges are round",
            equation: Equation::Cap,
        }
    }
    built_by!(RoundEdges::new);
}

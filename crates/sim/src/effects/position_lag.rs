//! Position lag: a filter in the position transducer or its card.

use super::{Effect, EffectInfo, Equation, Law, Parameter, Sensing, built_by};
use crate::real::Real;

/// See the [module](self).
pub(super) struct PositionLag;

/// Time constant, s.
struct Lag<T> {
    time_constant: T,
}

impl<T: Real> Lag<T> {
    fn new(values: &[T]) -> Self {
        Lag { time_constant: values[0] }
    }
}

impl<T: Real> Law<T> for Lag<T> {
    fn is_in_balances(&self) -> bool {
        false
    }

    /// The reading at the last tick, and whether there was one.
    fn memory(&self) -> usize {
        2
    }

    #[inline(always)]
    fn sense(&self, memory: &mut [T], position: T, sensing: &Sensing<T>) -> T {
        let one = T::splat(1.0);
        // Exact for a position that is constant over a period.
        let kept = (-sensing.period / self.time_constant).exp();
        let last = memory[1].where_positive(memory[0], position);
        let filtered = last * kept + position * (one - kept);
        memory[0] = self.time_constant.where_positive(filtered, position);
        memory[1] = one;
        memory[0]
    }
}

impl Effect for PositionLag {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "position_lag",
            parameters: &[Parameter {
                name: "time_constant_s",
                unit: "s",
                neutral: 0.0,
                range: (1e-3, 0.03),
                source: "filters of analogue cards: 1 to 30 ms; 0 means no lag",
            }],
            law: "d measured/dt = (x − measured) / time_constant_s; 0: measured = x",
            signature: "the loop is slower: position leads its measurement in every stroke; nothing in the holds",
            equation: Equation::Sensor,
        }
    }
    built_by!(Lag::new);
}

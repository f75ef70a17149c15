//! Command delay: dead time between controller and spool, of a bus cycle or a remote input/output station.

use super::{Effect, EffectInfo, Equation, Law, Parameter, Substep, built_by};
use crate::real::Real;

/// See the [module](self).
pub(super) struct CommandDelay;

/// Held commands that are remembered; covers 20 ms at 1 kHz with room for 0.7 ms periods.
const REMEMBERED: usize = 32;

/// Dead time, s.
struct Delay<T> {
    delay_s: T,
}

impl<T: Real> Delay<T> {
    fn new(values: &[T]) -> Self {
        Delay { delay_s: values[0] }
    }
}

impl<T: Real> Law<T> for Delay<T> {
    fn is_in_balances(&self) -> bool {
        false
    }

    fn memory(&self) -> usize {
        REMEMBERED
    }

    #[inline(always)]
    fn spool(&self, memory: &mut [T], command: T, substep: &Substep<T>) -> T {
        let now = (substep.tick % REMEMBERED as u64) as usize;
        memory[now] = command;
        let periods = self.delay_s / substep.period;
        T::from_lanes(|lane| {
            let whole = periods.lane(lane).floor().clamp(0.0, (REMEMBERED - 2) as f64);
            // The held command changes `rest` of a period into this one; within a plant step the spool
            // takes the mean, which keeps the law continuous in its parameter.
            let rest = periods.lane(lane) - whole;
            let older = (rest * substep.steps as f64 - substep.index as f64).clamp(0.0, 1.0);
            let back = |ticks: usize| memory[(now + REMEMBERED - ticks) % REMEMBERED].lane(lane);
            let whole = whole as usize;
            older * back(whole + 1) + (1.0 - older) * back(whole)
        })
    }
}

impl Effect for CommandDelay {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "command_delay",
            parameters: &[Parameter {
                name: "delay_s",
                unit: "s",
                neutral: 0.0,
                range: (0.0, 0.02),
                source: "two cycles of common field buses at 1–10 ms",
            }],
            law: "spool(t) = u(t − delay_s)",
            signature: "position lags the simulation by a constant time in every stroke; nothing changes in the holds",
            equation: Equation::Cap,
        }
    }
    built_by!(Delay::new);
}

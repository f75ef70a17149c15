//! Valve hysteresis: magnetic hysteresis and friction of a proportional valve's solenoid and spool.

use super::{Effect, EffectInfo, Equation, Law, Parameter, Substep, built_by};
use crate::real::Real;

/// See the [module](self).
pub(super) struct ValveHysteresis;

/// How many plays a round loop is made of: its corners fall apart into so many.
const PLAYS: usize = 6;

/// Half widths of the plays, shares of full command; their mean is half the loop's width.
struct Plays<T> {
    half_widths: [T; PLAYS],
}

impl<T: Real> Plays<T> {
    /// Widths as a Weibull distribution of shape 1 / rounding has them in the middle of as many equal parts: all alike without rounding, spread
    /// exponentially with a rounding of 1.
    fn new(values: &[T]) -> Self {
        let quantile = |play: usize| -libm::log(1.0 - (2.0 * play as f64 + 1.0) / (2.0 * PLAYS as f64));
        let shares: [T; PLAYS] = std::array::from_fn(|play| T::splat(quantile(play)).pow(values[1]));
        let sum = shares.iter().fold(T::splat(0.0), |sum, share| sum + *share);
        let half = T::splat(0.5) * values[0] * T::splat(PLAYS as f64) / sum;
        Plays { half_widths: shares.map(|share| half * share) }
    }
}

impl<T: Real> Law<T> for Plays<T> {
    fn is_in_balances(&self) -> bool {
        false
    }

    fn memory(&self) -> usize {
        PLAYS
    }

    /// The mean is taken from the first play on, so that plays of one width are one play to the bit.
    #[inline(always)]
    fn spool(&self, memory: &mut [T], command: T, _substep: &Substep<T>) -> T {
        for (spool, half) in memory.iter_mut().zip(self.half_widths) {
            *spool = spool.max(command - half).min(command + half);
        }
        let first = memory[0];
        let beyond = memory.iter().fold(T::splat(0.0), |sum, spool| sum + (*spool - first));
        first + beyond * T::splat(1.0 / PLAYS as f64)
    }
}

impl Effect for ValveHysteresis {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "valve_hysteresis",
            parameters: &[
                Parameter {
                    name: "width",
                    unit: "1",
                    neutral: 0.0,
                    range: (0.0, 0.08),
                    source: "data sheets of proportional valves without spool feedback: 3 to 8 % of full command",
                },
                Parameter {
                    name: "rounding",
                    unit: "1",
                    neutral: 0.0,
                    range: (0.0, 1.5),
                    source: "Brokate & Sprekels, Hysteresis and Phase Transitions (1996), ch. 2; 1 is the exponential loop of Dahl (1968)",
                },
            ],
            law: "spool = mean of six plays (Prandtl–Ishlinskii), each of which moves only when the command pushes it; their full widths go \
                  with (−ln(1 − p))^rounding at p = 1/12, 3/12 … 11/12, and `width` is their mean",
            signature: "the command overshoots by the width at every change of direction, at once or gradually where the loop is round; a \
                        small limit cycle in the holds",
            equation: Equation::Cap,
        }
    }
    fn is_neutral(&self, values: &[f64]) -> bool {
        values[0] == 0.0
    }
    built_by!(Plays::new);
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: f64 = 0.04;

    /// Where the spool is once the command has been there, one after the other.
    fn spool(rounding: f64, commands: &[f64]) -> f64 {
        let law = ValveHysteresis.scalar(&[WIDTH, rounding]);
        let substep = Substep { tick: 0, index: 0, steps: 1, dt: 1e-3, period: 1e-3 };
        let mut memory = vec![0.0; law.memory()];
        commands.iter().fold(0.0, |_, command| law.spool(&mut memory, *command, &substep))
    }

    #[test]
    fn without_rounding_it_is_one_play_to_the_bit() {
        let mut play = 0.0_f64;
        let mut commands = Vec::new();
        for tick in 0..200 {
            let command = 0.1 * (0.37 * f64::from(tick)).sin();
            play = play.max(command - 0.5 * WIDTH).min(command + 0.5 * WIDTH);
            commands.push(command);
            assert_eq!(spool(0.0, &commands), play);
        }
    }

    /// Behind the command by half the width on either way, whatever the rounding; and it never runs back against the command.
    #[test]
    fn the_loop_is_as_wide_with_round_corners() {
        for rounding in [0.0, 0.5, 1.0, 1.5] {
            assert!((spool(rounding, &[0.5]) - (0.5 - 0.5 * WIDTH)).abs() < 1e-15);
            assert!((spool(rounding, &[0.5, 0.1]) - (0.1 + 0.5 * WIDTH)).abs() < 1e-15);
            let ways: Vec<f64> = (0..=80).map(|way| 0.5 - f64::from(way) * 1e-3).collect();
            let spools: Vec<f64> = (1..=ways.len()).map(|end| spool(rounding, &ways[..end])).collect();
            assert!(spools.windows(2).all(|pair| pair[1] <= pair[0] && pair[0] - pair[1] < 1.0001e-3));
        }
    }

    /// Closed form: after a reversal by Δ, the plays narrower than Δ follow, each by what goes beyond its width. With all the rounding the
    /// spool is behind by width · (1 − e^(−Δ / width)), Dahl's loop, as nearly as six plays can be.
    #[test]
    fn a_round_corner_follows_play_by_play() {
        let way = 0.03;
        let widths = [11.0, 9.0, 7.0, 5.0, 3.0, 1.0].map(|share| (12.0_f64 / share).ln());
        let mean = widths.iter().sum::<f64>() / 6.0;
        let moved = widths.map(|width| (way - WIDTH * width / mean).max(0.0)).iter().sum::<f64>() / 6.0;
        let there = spool(1.0, &[0.5]);
        let found = there - spool(1.0, &[0.5, 0.5 - way]);
        assert!((found - moved).abs() < 1e-15, "{found} {moved}");
        let dahl = way - WIDTH * (1.0 - (-way / WIDTH).exp());
        assert!((found - dahl).abs() < 0.05 * WIDTH, "{found} {dahl}");
    }
}

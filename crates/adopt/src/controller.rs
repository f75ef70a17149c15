//! The gains of a position controller, read off demand, position and command by linear regression.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use crate::machine_data::ControllerKind;
use crate::strokes::slope;

/// Gains that were found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FittedGains {
    /// Proportional gain, 1/m.
    pub kp: f64,
    /// Integral gain, 1/(m s).
    pub ki: f64,
    /// Position error below which the integrator works, m; 0: it always works.
    pub integral_window_m: f64,
    /// Derivative gain on the position, s/m.
    pub kd: f64,
    /// Velocity feed-forward, s/m.
    pub feed_forward: f64,
    /// Jump over the dead band, share of full command.
    pub compensation: f64,
    /// Share of the command's variance that they explain.
    pub explained: f64,
}

/// Magnitude of the command from which it counts as saturated.
const SATURATED: f64 = 0.97;
/// A further term stays where it takes this share off the rest's variance.
const WORTH: f64 = 0.05;
/// A rest of this share of the command's variance has nothing left to explain.
const DONE: f64 = 1e-6;

/// Terms of a control law, in the order of how usual they are.
const TERMS: usize = 5;
const ERROR: usize = 0;
const INTEGRAL: usize = 1;
const FEED_FORWARD: usize = 2;
const BRAKING: usize = 3;
const JUMP: usize = 4;
/// Outputs of the control law over which controllers let their jump grow, shares of full command: none lets it flip with the last bit.
const JUMP_GROWS_OVER: [f64; 6] = [1e-3, 2e-3, 3e-3, 5e-3, 8e-3, 12e-3];
/// Largest jump that is looked for, share of full command.
const LARGEST_JUMP: f64 = 0.3;
/// Regressions after which a jump fits the commands that it is part of.
const JUMP_ROUNDS: usize = 5;

/// Windows of the integrator that are tried: shares of the largest error in steps of a factor, and then around the best.
const WINDOW_STEP: f64 = 0.7;
const WINDOWS: i32 = 12;
const AROUND_A_WINDOW: [f64; 4] = [0.85, 0.93, 1.08, 1.17];

/// A window is one where it leaves less than this share of what the best law without one leaves.
const WINDOW_WORTH: f64 = 0.5;

/// Ticks around an open-loop part that are left out with it: speeds there are of both.
const BESIDE: usize = 2;

/// Regresses the command of a mean cycle on error, its integral, the speeds of position and demand, and the command's sign, where the
/// controller makes it: `open` are the ticks of its open-loop parts. Of all laws that the controller's kind allows, the one is taken whose
/// every term is worth it: terms that stand for each other, as an integral for a jump over the dead band, cannot be taken one by one. `None`
/// where no law with gains of the right sign explains anything.
pub fn fit_gains(
    command: &[f64],
    demand: &[f64],
    position: &[f64],
    tick_s: f64,
    open: &[Range<usize>],
    kind: Option<ControllerKind>,
) -> Option<FittedGains> {
    let ticks = command.len().min(demand.len()).min(position.len());
    let speed = |values: &[f64], tick: usize| slope(&values[..ticks], tick) / tick_s;
    let errors: Vec<f64> = (0..ticks).map(|tick| demand[tick] - position[tick]).collect();
    let command = &command[..ticks];
    let integrator = Integrator { command, errors: &errors, open, tick_s };
    let terms: Terms = [
        errors.clone(),
        integrator.within(f64::MAX),
        (0..ticks).map(|tick| speed(demand, tick)).collect(),
        (0..ticks).map(|tick| -speed(position, tick)).collect(),
        // The jump: found with its size, law by law.
        Vec::new(),
    ];
    let beside = |tick: usize| {
        open.iter().any(|part| (part.start.saturating_sub(BESIDE)..part.end + BESIDE).contains(&tick))
    };
    let used: Vec<usize> =
        (0..ticks).filter(|tick| command[*tick].abs() < SATURATED && !beside(*tick)).collect();
    if used.len() < 50 {
        return None;
    }
    let without = best_law(&terms, laws(kind), command, &used);
    let within = best_window(&integrator, terms, kind, &used);
    let (Law { terms: chosen, fit }, integral_window_m) = match (without, within) {
        (Some(without), Some((within, window_m))) if within.fit.left < WINDOW_WORTH * without.fit.left => {
            (within, window_m)
        }
        (Some(without), _) => (without, 0.0),
        (None, within) => within?,
    };
    let gain = |term| chosen.iter().position(|of| *of == term).map_or(0.0, |index| fit.gains[index]);
    (gain(ERROR) > 0.0).then(|| FittedGains {
        kp: gain(ERROR),
        ki: gain(INTEGRAL),
        integral_window_m,
        feed_forward: gain(FEED_FORWARD),
        kd: gain(BRAKING),
        compensation: gain(JUMP),
        explained: 1.0 - fit.left,
    })
}

/// What the terms of a law are, tick by tick.
type Terms = [Vec<f64>; TERMS];

/// What an integrator has seen.
struct Integrator<'a> {
    command: &'a [f64],
    errors: &'a [f64],
    open: &'a [Range<usize>],
    tick_s: f64,
}

impl Integrator<'_> {
    /// The integral tick by tick. It stands while the command saturates and where the error is beyond a window, and begins anew where
    /// position control does.
    fn within(&self, window_m: f64) -> Vec<f64> {
        let ticks = self.errors.len();
        let mut integral = 0.0;
        let mut integrated = |tick: usize| {
            if self.open.iter().any(|part| part.contains(&tick)) {
                integral = 0.0;
            } else if self.command[tick].abs() < SATURATED && self.errors[tick].abs() < window_m {
                integral += self.errors[tick] * self.tick_s;
            }
            integral
        };
        if let Some(last) = self.open.iter().map(|part| part.start).max() {
            // What it holds as the cycle begins is from the end of the one before.
            for tick in last..ticks {
                integrated(tick);
            }
        }
        (0..ticks).map(integrated).collect()
    }
}

/// The best law with an integrator that works within a window, and the window, m. It is looked for without a jump, whose fit takes its time.
fn best_window(
    integrator: &Integrator<'_>,
    mut terms: Terms,
    kind: Option<ControllerKind>,
    used: &[usize],
) -> Option<(Law, f64)> {
    let integrating = || laws(kind).filter(|law| law.contains(&INTEGRAL));
    let largest_m = integrator.errors.iter().fold(0.0_f64, |largest, error| largest.max(error.abs()));
    let mut tried = |window_m: f64| -> Option<(f64, f64)> {
        terms[INTEGRAL] = integrator.within(window_m);
        let plain = integrating().filter(|law| !law.contains(&JUMP));
        Some((best_law(&terms, plain, integrator.command, used)?.worth(), window_m))
    };
    let by_worth = |(a, _): &(f64, f64), (b, _): &(f64, f64)| a.total_cmp(b);
    let steps = (1..=WINDOWS).map(|step| largest_m * WINDOW_STEP.powi(step));
    let coarse = steps.filter_map(&mut tried).min_by(by_worth)?;
    let around = AROUND_A_WINDOW.into_iter().filter_map(|share| tried(coarse.1 * share));
    let (_, window_m) = std::iter::once(coarse).chain(around).min_by(by_worth)?;
    terms[INTEGRAL] = integrator.within(window_m);
    Some((best_law(&terms, integrating(), integrator.command, used)?, window_m))
}

/// A law by its terms, fitted.
struct Law {
    terms: Vec<usize>,
    fit: Fit,
}

impl Law {
    /// What it leaves, raised for each of its terms: the smaller, the better.
    fn worth(&self) -> f64 {
        self.fit.left.max(DONE) / (1.0 - WORTH).powi(self.terms.len() as i32)
    }
}

/// The law that is worth most, of those whose gains have the right sign.
fn best_law(
    terms: &Terms,
    laws: impl Iterator<Item = Vec<usize>>,
    command: &[f64],
    used: &[usize],
) -> Option<Law> {
    laws.filter_map(|law| fitted(terms, &law, command, used).map(|fit| Law { terms: law, fit }))
        .filter(|law| law.fit.gains.iter().all(|gain| *gain >= 0.0))
        .min_by(|a, b| a.worth().total_cmp(&b.worth()))
}

/// Every set of terms with the error that a controller of that kind may have, each in the terms' order.
fn laws(kind: Option<ControllerKind>) -> impl Iterator<Item = Vec<usize>> {
    let is_allowed = move |law: &Vec<usize>| match kind {
        Some(ControllerKind::P) => !law.contains(&INTEGRAL) && !law.contains(&BRAKING),
        Some(ControllerKind::Pi) => !law.contains(&BRAKING),
        Some(ControllerKind::Pid) | None => true,
    };
    let sets = 0..1_usize << TERMS;
    let law = |set: usize| -> Vec<usize> { (0..TERMS).filter(|term| set & (1 << term) != 0).collect() };
    sets.map(law).filter(|law| law.contains(&ERROR)).filter(is_allowed)
}

/// Where in its jump over the dead band a controller is, −1 … 1, tick by tick: the jump is done where the command exceeds it and the output
/// over which it grows.
fn jumps(command: &[f64], done_at: f64) -> Vec<f64> {
    command.iter().map(|u| (u / done_at).clamp(-1.0, 1.0)).collect()
}

/// A law's gains, in the order of its terms, and the share of the variance of what it explains that it leaves.
#[derive(Debug, Clone)]
struct Fit {
    gains: Vec<f64>,
    left: f64,
}

/// The gains of a law and what they leave. A jump is part of the command that tells where it is: both are found in turns, for each way that
/// controllers let it grow; what counts is how well the law explains what it gave before the jump.
fn fitted(terms: &Terms, law: &[usize], command: &[f64], used: &[usize]) -> Option<Fit> {
    let Some((JUMP, rest_of_law)) = law.split_last().map(|(last, others)| (*last, others)) else {
        return regressed(terms, law, command, used);
    };
    let mut terms = terms.clone();
    let mut best: Option<Fit> = None;
    for grows_over in JUMP_GROWS_OVER {
        let mut jump = 0.0;
        for _ in 0..JUMP_ROUNDS {
            terms[JUMP] = jumps(command, jump + grows_over);
            let gains = regressed(&terms, law, command, used)?.gains;
            jump = gains.last()?.clamp(0.0, LARGEST_JUMP);
            let output = without_jump(command, jump, grows_over);
            let mut fit = regressed(&terms, rest_of_law, &output, used)?;
            fit.gains.push(jump);
            if best.as_ref().is_none_or(|best| fit.left < best.left) {
                best = Some(fit);
            }
        }
    }
    best
}

/// What a control law gave before its jump over the dead band.
fn without_jump(command: &[f64], jump: f64, grows_over: f64) -> Vec<f64> {
    let jumped = jumps(command, jump + grows_over);
    command.iter().zip(jumped).map(|(u, share)| u - jump * share).collect()
}

/// Least squares of the command on some terms and a constant.
fn regressed(terms: &Terms, chosen: &[usize], command: &[f64], used: &[usize]) -> Option<Fit> {
    let columns = chosen.len() + 1;
    let matrix = DMatrix::from_fn(used.len(), columns, |row, column| {
        chosen.get(column).map_or(1.0, |term| terms[*term][used[row]])
    });
    let right = DVector::from_iterator(used.len(), used.iter().map(|tick| command[*tick]));
    let scales: Vec<f64> = (0..columns).map(|column| matrix.column(column).norm().max(1e-300)).collect();
    let scaled = DMatrix::from_fn(used.len(), columns, |row, column| matrix[(row, column)] / scales[column]);
    let normal = scaled.tr_mul(&scaled) + DMatrix::identity(columns, columns) * 1e-12;
    let solution = normal.cholesky()?.solve(&scaled.tr_mul(&right));
    let mean = right.mean();
    let total: f64 = right.iter().map(|u| (u - mean).powi(2)).sum();
    let left = (&scaled * &solution - right).norm_squared() / total.max(f64::MIN_POSITIVE);
    Some(Fit { gains: (0..chosen.len()).map(|column| solution[column] / scales[column]).collect(), left })
}

#[cfg(test)]
mod tests {
    use super::*;

    const TICK_S: f64 = 0.01;

    /// A piston that follows two moves with a lag and creeps in its holds, and what a controller gives for it, without noise.
    fn logged(mut law: impl FnMut(f64, f64, f64) -> f64) -> (Vec<f64>, Vec<f64>, Vec<f64>) {
        let mut demand = vec![0.1_f64];
        for tick in 0..2000 {
            let target: f64 = if (300..1200).contains(&tick) { 0.4 } else { 0.1 };
            let last = demand[tick];
            demand.push(last + (0.02 * (target - last)).clamp(-8e-4, 8e-4));
        }
        let (mut x, mut integral) = (0.1004, 0.0);
        let mut position = Vec::new();
        let mut command = Vec::new();
        for tick in 0..2000 {
            position.push(x);
            let error = demand[tick] - x;
            integral += error * TICK_S;
            command.push(law(error, integral, (demand[tick + 1] - demand[tick]) / TICK_S));
            x += 0.08 * error;
        }
        demand.truncate(2000);
        (command, demand, position)
    }

    /// A P controller with a jump: its holds stand within the jump, which an integral would explain as well where it is taken first.
    #[test]
    fn a_jump_over_the_dead_band_is_no_integral() {
        let jumping = |output: f64| output + 0.12 * (output / 5e-3).clamp(-1.0, 1.0);
        let (command, demand, position) =
            logged(|error, _, speed| jumping(60.0 * error + 2.0 * speed).clamp(-1.0, 1.0));
        let gains = fit_gains(&command, &demand, &position, TICK_S, &[], None).unwrap();
        let is_near = |found: f64, truth: f64| (found / truth - 1.0).abs() < 0.02;
        assert!(is_near(gains.kp, 60.0) && is_near(gains.compensation, 0.12), "{gains:?}");
        assert!((gains.ki, gains.kd) == (0.0, 0.0) && gains.explained > 0.9999, "{gains:?}");
    }

    /// An integrator that works near its target only: its gain and its window are found, and without one there is none.
    #[test]
    fn an_integrator_that_works_near_its_target_is_found_with_its_window() {
        let mut integral = 0.0;
        let mut held = 0.0;
        let (command, demand, position) = logged(|error, total, speed| {
            held += if f64::abs(error) < 2e-3 { total - integral } else { 0.0 };
            integral = total;
            20.0 * error + 50.0 * held + 1.5 * speed
        });
        let gains = fit_gains(&command, &demand, &position, TICK_S, &[], None).unwrap();
        let is_near = |found: f64, truth: f64, share: f64| (found / truth - 1.0).abs() < share;
        // Speeds are means of two ticks, which an error that follows them shares.
        assert!(is_near(gains.kp, 20.0, 0.05) && is_near(gains.ki, 50.0, 0.1), "{gains:?}");
        assert!(is_near(gains.integral_window_m, 2e-3, 0.2) && gains.compensation == 0.0, "{gains:?}");
        let (command, demand, position) = logged(|error, integral, _| 20.0 * error + 15.0 * integral);
        let gains = fit_gains(&command, &demand, &position, TICK_S, &[], None).unwrap();
        assert_eq!(gains.integral_window_m, 0.0, "{gains:?}");
    }

    #[test]
    fn a_law_that_the_user_knows_has_no_other_terms() {
        let (command, demand, position) = logged(|error, integral, _| 20.0 * error + 15.0 * integral);
        let fit = |kind| fit_gains(&command, &demand, &position, TICK_S, &[], kind).unwrap();
        let free = fit(None);
        assert!((free.kp / 20.0 - 1.0).abs() < 0.02 && (free.ki / 15.0 - 1.0).abs() < 0.02, "{free:?}");
        let proportional = fit(Some(ControllerKind::P));
        assert!((proportional.ki, proportional.kd) == (0.0, 0.0), "{proportional:?}");
        assert!(fit(Some(ControllerKind::Pi)).kd == 0.0);
    }
}

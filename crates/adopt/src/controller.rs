//! The gains of a position controller, read off demand, position and command by linear regression.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use crate::strokes::slope;

/// Gains that were found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FittedGains {
    /// Proportional gain, 1/m.
    pub kp: f64,
    /// Integral gain, 1/(m s).
    pub ki: f64,
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

/// Ticks around an open-loop part that are left out with it: speeds there are of both.
const BESIDE: usize = 2;

/// Regresses the command of a mean cycle on error, its integral, the speeds of position and demand, and the command's sign, where the
/// controller makes it: `open` are the ticks of its open-loop parts. `None` where the error explains nothing or a gain comes out with the
/// wrong sign.
pub fn fit_gains(
    command: &[f64],
    demand: &[f64],
    position: &[f64],
    tick_s: f64,
    open: &[Range<usize>],
) -> Option<FittedGains> {
    let ticks = command.len().min(demand.len()).min(position.len());
    let is_open = |tick: usize| open.iter().any(|part| part.contains(&tick));
    let speed = |values: &[f64], tick: usize| slope(&values[..ticks], tick) / tick_s;
    let errors: Vec<f64> = (0..ticks).map(|tick| demand[tick] - position[tick]).collect();
    // The integrator stands while the command saturates, and begins anew where position control does.
    let mut integral = 0.0;
    let mut integrated = |tick: usize| {
        if is_open(tick) {
            integral = 0.0;
        } else if command[tick].abs() < SATURATED {
            integral += errors[tick] * tick_s;
        }
        integral
    };
    if let Some(last) = open.iter().map(|part| part.start).max() {
        // What it holds as the cycle begins is from the end of the one before.
        for tick in last..ticks {
            integrated(tick);
        }
    }
    let integrals: Vec<f64> = (0..ticks).map(integrated).collect();
    let terms: [Vec<f64>; 5] = [
        errors,
        integrals,
        (0..ticks).map(|tick| speed(demand, tick)).collect(),
        (0..ticks).map(|tick| -speed(position, tick)).collect(),
        command.iter().take(ticks).map(|u| (u / 0.003).clamp(-1.0, 1.0)).collect(),
    ];
    let beside = |tick: usize| {
        open.iter().any(|part| (part.start.saturating_sub(BESIDE)..part.end + BESIDE).contains(&tick))
    };
    let used: Vec<usize> =
        (0..ticks).filter(|tick| command[*tick].abs() < SATURATED && !beside(*tick)).collect();
    if used.len() < 50 {
        return None;
    }
    let mean = used.iter().map(|tick| command[*tick]).sum::<f64>() / used.len() as f64;
    let total: f64 = used.iter().map(|tick| (command[*tick] - mean).powi(2)).sum();
    // Terms come in the order of how usual they are, and stay where they are worth it and have the right sign.
    let mut chosen = vec![0];
    let mut best = regressed(&terms, &chosen, command, &used)?;
    for term in 1..terms.len() {
        if best.1 < DONE * total {
            break;
        }
        let mut with = chosen.clone();
        with.push(term);
        let Some(next) = regressed(&terms, &with, command, &used) else { continue };
        if next.1 < (1.0 - WORTH) * best.1 && next.0.iter().all(|gain| *gain >= 0.0) {
            (chosen, best) = (with, next);
        }
    }
    let gain = |term: usize| chosen.iter().position(|of| *of == term).map_or(0.0, |index| best.0[index]);
    (gain(0) > 0.0).then(|| FittedGains {
        kp: gain(0),
        ki: gain(1),
        feed_forward: gain(2),
        kd: gain(3),
        compensation: gain(4),
        explained: 1.0 - best.1 / total,
    })
}

/// Least squares of the command on some terms and a constant: coefficients without the constant's, and the sum of squares that is left.
fn regressed(
    terms: &[Vec<f64>; 5],
    chosen: &[usize],
    command: &[f64],
    used: &[usize],
) -> Option<(Vec<f64>, f64)> {
    let columns = chosen.len() + 1;
    let matrix = DMatrix::from_fn(used.len(), columns, |row, column| {
        chosen.get(column).map_or(1.0, |term| terms[*term][used[row]])
    });
    let right = DVector::from_iterator(used.len(), used.iter().map(|tick| command[*tick]));
    let scales: Vec<f64> = (0..columns).map(|column| matrix.column(column).norm().max(1e-300)).collect();
    let scaled = DMatrix::from_fn(used.len(), columns, |row, column| matrix[(row, column)] / scales[column]);
    let normal = scaled.tr_mul(&scaled) + DMatrix::identity(columns, columns) * 1e-12;
    let solution = normal.cholesky()?.solve(&scaled.tr_mul(&right));
    let rest = (&scaled * &solution - right).norm_squared();
    Some(((0..chosen.len()).map(|column| solution[column] / scales[column]).collect(), rest))
}

//! Whether the machine changed within the log: a step or a drift over its cycles, told before anything is fitted.
//!
//! Cycles differ by load and noise in no order; what changes has one. The cycles' principal components are compared with a step at any
//! cycle and with a ramp; how well either fits by chance follows from the same values in shuffled orders (Good, Permutation, Parametric and
//! Bootstrap Tests of Hypotheses (2005)).

use nalgebra::{DMatrix, SymmetricEigen};
use seepd_sim::noise::Noise;

use crate::fit::MODEL_ERROR;
use crate::record::{BINS, ENOUGH_CYCLES, LEAST_CYCLES, Record};

/// How a machine changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ChangeKind {
    /// From one cycle to the next.
    Step,
    /// Bit by bit.
    Drift,
}

/// A change within a log.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Change {
    /// How it came.
    pub(crate) kind: ChangeKind,
    /// Cycles before it: of a drift, those at its beginning.
    pub(crate) before: usize,
    /// First cycle of the machine as it is in the end.
    pub(crate) from: usize,
}

/// Components that are looked at, and the least share of all variation that one needs.
const COMPONENTS: usize = 4;
const LEAST_SHARE: f64 = 0.02;
/// Shuffled orders, none of which may fit as well.
const SHUFFLES: usize = 2000;
/// Share of the cycles at either end that a drift is told by.
const END: usize = 3;

/// The change of a record's machine; `None` where its cycles have no order, or are too few to tell.
pub(crate) fn change(record: &Record) -> Option<Change> {
    let count = record.cycles.len();
    if count < ENOUGH_CYCLES || record.is_open_loop {
        return None;
    }
    let found = ordered_component(record)?;
    let change = if found.ramp > found.step {
        Change { kind: ChangeKind::Drift, before: count / END, from: count - count / END }
    } else {
        Change { kind: ChangeKind::Step, before: found.at, from: found.at }
    };
    matters(record, &change).then_some(change)
}

/// How well a component's values follow a step and a ramp, shares of their variation.
struct Order {
    step: f64,
    ramp: f64,
    /// First cycle after the step.
    at: usize,
}

/// The component with the clearest order, if it is not chance.
fn ordered_component(record: &Record) -> Option<Order> {
    let mut noise = Noise::new(record.cycles.len() as u64, 23);
    let orders = components(record).into_iter().filter_map(|values| {
        let order = order(&values);
        let best = order.step.max(order.ramp);
        let mut shuffled = values;
        let by_chance = (0..SHUFFLES).any(|_| {
            shuffle(&mut shuffled, &mut noise);
            let order = self::order(&shuffled);
            order.step.max(order.ramp) >= best
        });
        (!by_chance).then_some(order)
    });
    orders.max_by(|a, b| a.step.max(a.ramp).total_cmp(&b.step.max(b.ramp)))
}

/// The cycles' values along their principal components.
fn components(record: &Record) -> Vec<Vec<f64>> {
    let count = record.cycles.len();
    let all: Vec<usize> = (0..count).collect();
    let mean = record.mean(&all);
    let rows: Vec<Vec<f64>> = record
        .cycles
        .iter()
        .map(|cycle| {
            let of = |signal: usize| {
                let scale = 1.0 / record.range[signal];
                cycle.bins[signal].iter().zip(&mean[signal]).map(move |(value, mean)| (value - mean) * scale)
            };
            (0..record.signals.len()).flat_map(of).collect()
        })
        .collect();
    let gram =
        DMatrix::from_fn(count, count, |a, b| rows[a].iter().zip(&rows[b]).map(|(a, b)| a * b).sum::<f64>());
    let total = gram.trace();
    let eigen = SymmetricEigen::new(gram);
    let mut by_size: Vec<usize> = (0..count).collect();
    by_size.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    by_size
        .into_iter()
        .take(COMPONENTS)
        .filter(|index| eigen.eigenvalues[*index] > LEAST_SHARE * total)
        .map(|index| eigen.eigenvectors.column(index).iter().copied().collect())
        .collect()
}

fn order(values: &[f64]) -> Order {
    let count = values.len();
    let n = count as f64;
    let mean = values.iter().sum::<f64>() / n;
    let square: f64 = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>().max(f64::MIN_POSITIVE);
    let (mut best, mut at, mut sum) = (0.0, 0, 0.0);
    for (index, value) in values.iter().enumerate() {
        if (LEAST_CYCLES..=count - LEAST_CYCLES).contains(&index) {
            let k = index as f64;
            // What two means explain beyond one.
            let explained = sum * sum * n / (k * (n - k)) / square;
            if explained > best {
                (best, at) = (explained, index);
            }
        }
        sum += value - mean;
    }
    let middle = 0.5 * (n - 1.0);
    let along: f64 =
        values.iter().enumerate().map(|(index, value)| (index as f64 - middle) * (value - mean)).sum();
    let ramp = along * along / (n * (n * n - 1.0) / 12.0) / square;
    Order { step: best, ramp, at }
}

/// Fisher and Yates' shuffle.
fn shuffle(values: &mut [f64], noise: &mut Noise) {
    for last in (1..values.len()).rev() {
        let other = (noise.uniform(0.0, (last + 1) as f64) as usize).min(last);
        values.swap(last, other);
    }
}

/// Whether a signal's mean cycle differs by more than any model's error.
fn matters(record: &Record, change: &Change) -> bool {
    let before: Vec<usize> = (0..change.before).collect();
    let after: Vec<usize> = (change.from..record.cycles.len()).collect();
    let (before, after) = (record.mean(&before), record.mean(&after));
    before.iter().zip(&after).zip(&record.range).any(|((before, after), range)| {
        let square: f64 = before.iter().zip(after).map(|(a, b)| (a - b).powi(2)).sum();
        (square / BINS as f64).sqrt() > MODEL_ERROR * range
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_and_a_ramp_are_told_apart_and_explain_all_of_themselves() {
        let step: Vec<f64> = (0..24).map(|cycle| if cycle < 15 { 1.0 } else { -2.0 }).collect();
        let found = order(&step);
        assert!((found.step - 1.0).abs() < 1e-12 && found.at == 15 && found.ramp < 0.8);
        let ramp: Vec<f64> = (0..24).map(|cycle| 0.3 * f64::from(cycle) - 7.0).collect();
        let found = order(&ramp);
        assert!((found.ramp - 1.0).abs() < 1e-12 && found.step < 0.8);
    }
}

//! A column as physics looks at it: averaged to a rate at which a look at every pair of columns takes no time, with what it is like.

use seepd_logs::columns::Column;

use super::names::Name;
use super::units::Unit;

/// Samples of a trace, at most.
const MOST_SAMPLES: usize = 20_000;
/// Values that a column may take to be looked at as a switch.
const SWITCH_VALUES: usize = 2;
/// Share of samples that must be there for a column to be looked at.
const LEAST_PRESENT: f64 = 0.2;
/// Share of a counter's steps that are alike.
const COUNTER_STEPS: f64 = 0.9;

/// What a column is like.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Character {
    /// Mostly absent.
    Absent,
    /// It does not move.
    Constant,
    /// It takes two values.
    Switch,
    /// It grows in steps that are alike: a counter, a clock.
    Counter,
    /// It moves.
    Moving,
}

/// See the [module](self).
pub(super) struct Trace<'c> {
    /// Where it is in [`Columns`](seepd_logs::columns::Columns).
    pub(super) index: usize,
    pub(super) column: &'c Column,
    pub(super) name: Name,
    pub(super) unit: Option<Unit>,
    pub(super) character: Character,
    pub(super) least: f64,
    pub(super) largest: f64,
    /// Whether every value is a whole number.
    pub(super) whole_numbers: bool,
    /// Averages over blocks of samples; not a number where a block has none.
    pub(super) values: Vec<f64>,
    /// Noise from sample to sample, in the column's unit.
    pub(super) noise: f64,
}

/// Every how many samples a trace of so many has one.
pub(super) fn block(samples: usize) -> usize {
    samples.div_ceil(MOST_SAMPLES).max(1)
}

impl<'c> Trace<'c> {
    pub(super) fn of(index: usize, column: &'c Column) -> Self {
        let present = || column.values.iter().copied().filter(|value| value.is_finite());
        let (least, largest) = present()
            .fold((f32::INFINITY, f32::NEG_INFINITY), |(least, largest), value| {
                (least.min(value), largest.max(value))
            });
        Trace {
            index,
            column,
            name: Name::of(column),
            unit: column.unit.as_deref().and_then(Unit::parse),
            character: character(&column.values),
            least: f64::from(least),
            largest: f64::from(largest),
            whole_numbers: present().all(|value| value.fract() == 0.0),
            values: averaged(&column.values),
            noise: noise(&column.values),
        }
    }

    pub(super) fn range(&self) -> f64 {
        self.largest - self.least
    }

    pub(super) fn largest_magnitude(&self) -> f64 {
        self.largest.abs().max(self.least.abs())
    }
}

fn averaged(values: &[f32]) -> Vec<f64> {
    let mean = |block: &[f32]| {
        let present = block.iter().filter(|value| value.is_finite());
        let (sum, count) = present.fold((0.0, 0), |(sum, count), value| (sum + f64::from(*value), count + 1));
        if count == 0 { f64::NAN } else { sum / f64::from(count) }
    };
    values.chunks(block(values.len())).map(mean).collect()
}

fn character(values: &[f32]) -> Character {
    let present: Vec<f32> = values.iter().copied().filter(|value| value.is_finite()).collect();
    if (present.len() as f64) < LEAST_PRESENT * values.len() as f64 || present.len() < 2 {
        return Character::Absent;
    }
    let mut taken: Vec<f32> = Vec::new();
    for value in &present {
        if taken.len() <= SWITCH_VALUES && !taken.contains(value) {
            taken.push(*value);
        }
    }
    match taken.len() {
        0 | 1 => Character::Constant,
        SWITCH_VALUES => Character::Switch,
        _ if counts(&present) => Character::Counter,
        _ => Character::Moving,
    }
}

/// Whether a column's steps are alike and of one sign, save those with which it starts over.
fn counts(values: &[f32]) -> bool {
    let mut steps: Vec<f32> =
        values.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step != 0.0).collect();
    if steps.len() < 8 {
        // A count of parts, of orders: it only ever grows.
        return steps.iter().all(|step| *step > 0.0) && values.iter().all(|value| value.fract() == 0.0);
    }
    let middle = steps.len() / 2;
    let median = *steps.select_nth_unstable_by(middle, f32::total_cmp).1;
    let alike = steps.iter().filter(|step| (**step - median).abs() <= 0.01 * median.abs()).count();
    let one_sign = steps.iter().all(|step| step.signum() == median.signum());
    let whole = values.iter().all(|value| value.fract() == 0.0);
    (alike as f64 > COUNTER_STEPS * steps.len() as f64) || (one_sign && whole && median.abs() <= 2.0)
}

/// Standard deviation of what changes from sample to sample beyond a smooth course, from third differences, whose median is that of
/// moving and resting stretches alike.
fn noise(values: &[f32]) -> f64 {
    let mut differences: Vec<f64> = values
        .windows(4)
        .map(|w| (f64::from(w[3]) - 3.0 * f64::from(w[2]) + 3.0 * f64::from(w[1]) - f64::from(w[0])).abs())
        .filter(|difference| difference.is_finite())
        .collect();
    if differences.is_empty() {
        return 0.0;
    }
    let middle = differences.len() / 2;
    let median = *differences.select_nth_unstable_by(middle, f64::total_cmp).1;
    // White noise of deviation 1 has third differences of √20, and |x| of a normal distribution the median 0.6745.
    median / (0.674_5 * 20f64.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn characters() {
        let of = |value: fn(usize) -> f32| character(&(0..1000).map(value).collect::<Vec<_>>());
        assert_eq!(of(|_| 3.0), Character::Constant);
        assert_eq!(of(|n| (n % 7 / 4) as f32), Character::Switch);
        assert_eq!(of(|n| (n % 256) as f32), Character::Counter);
        assert_eq!(of(|n| n as f32 * 0.25), Character::Counter);
        assert_eq!(of(|n| (n / 300) as f32), Character::Counter);
        assert_eq!(of(|n| (n as f32 / 50.0).sin()), Character::Moving);
        assert_eq!(of(|n| if n % 10 == 0 { 1.0 } else { f32::NAN }), Character::Absent);
    }

    #[test]
    fn analytic_noise_of_alternating_signs() {
        // ±a alternating has third differences of 8 a everywhere.
        let values: Vec<f32> = (0..100).map(|n| if n % 2 == 0 { 0.5 } else { -0.5 }).collect();
        assert!((noise(&values) - 4.0 / (0.6745 * 20f64.sqrt())).abs() < 1e-9);
        assert_eq!(noise(&[1.0, 2.0, 3.0, 4.0, 5.0]), 0.0);
    }
}

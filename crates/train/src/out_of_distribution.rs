//! The distribution of what training has seen, by which cycles outside of it are recognised.

use seepd_model::out_of_distribution::distance;
use seepd_model::schema::TrainingDistribution;

use crate::conformal::significant;
use crate::linear;
use crate::train::round_to;

/// Ranges of the estimate that are described by themselves.
const RANGES: usize = 10;
/// Error of the simulator, over the size of a value: a machine that differs by so much is not new.
const MODEL_ERROR: f64 = 0.05;
/// Room over the largest distance that was seen of a machine not learned from.
const ROOM: f64 = 1.25;

/// A transformed estimate with the values, one a phase, that it belongs to.
pub(crate) type Row = (f64, Vec<f64>);

/// Mean and covariance by range of the estimate from `learned`, limits from `others`; `None` where the values do not vary.
pub(crate) fn describe(
    mut learned: Vec<Row>,
    others: impl Iterator<Item = Row>,
) -> Option<Vec<TrainingDistribution>> {
    learned.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut starts = vec![(0, -1e3)];
    for from in (0..learned.len()).step_by(learned.len().div_ceil(RANGES).max(1)).skip(1) {
        let from_y = round_to(learned[from].0, 6);
        // Estimates of the largest leaks are all the same.
        if starts.last().is_none_or(|(_, before)| from_y > *before) {
            starts.push((from, from_y));
        }
    }
    let ends = starts.iter().skip(1).map(|(from, _)| *from).chain([learned.len()]);
    let mut ranges = starts
        .iter()
        .zip(ends)
        .map(|((from, from_y), to)| range(*from_y, &learned[*from..to]))
        .collect::<Option<Vec<_>>>()?;
    for (y, values) in others {
        let after = ranges.partition_point(|range| range.from_y <= y);
        let range = ranges.get_mut(after.saturating_sub(1))?;
        range.limit = range.limit.max(ROOM * distance(range, &values));
    }
    // A range that no other machine fell into takes the widest limit.
    let widest = ranges.iter().map(|range| range.limit).fold(0.0, f64::max);
    for range in &mut ranges {
        range.limit = significant(if range.limit > 0.0 { range.limit } else { widest });
    }
    Some(ranges)
}

fn range(from_y: f64, rows: &[Row]) -> Option<TrainingDistribution> {
    let (count, phases) = (rows.len() as f64, rows.first()?.1.len());
    let average = |of: &dyn Fn(&[f64]) -> f64| rows.iter().map(|(_, values)| of(values)).sum::<f64>() / count;
    let mean: Vec<f64> = (0..phases).map(|i| average(&|values| values[i])).collect();
    let squares: Vec<f64> = (0..phases).map(|i| average(&|values| values[i].powi(2))).collect();
    let covariance = |i: usize, j: usize| {
        let own = if i == j { MODEL_ERROR * MODEL_ERROR * squares[i] } else { 0.0 };
        average(&|values| (values[i] - mean[i]) * (values[j] - mean[j])) + own
    };
    let whitening = linear::inverse(phases, &linear::cholesky(phases, covariance)?);
    Some(TrainingDistribution { from_y, mean, whitening, limit: 0.0 })
}

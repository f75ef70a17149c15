//! Receiver operating curves: what every threshold would find, and what it would take for a leak.

use serde::Serialize;

use super::record::{CycleRecord, MachineRecord};
use super::{Class, Conditions, judged, leaks};

/// What a threshold is laid on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Score {
    /// Sum over cycles against the baseline.
    #[serde(rename = "drift_sum")]
    Cusum,
    /// A single cycle's response against the baseline.
    #[serde(rename = "response")]
    LeakResidual,
    /// A single cycle's estimate by the trained model alone.
    AbsoluteEstimate,
}

impl Score {
    /// All.
    pub const ALL: [Score; 3] = [Score::Cusum, Score::LeakResidual, Score::AbsoluteEstimate];

    /// What it is called in tables.
    pub fn name(self) -> &'static str {
        match self {
            Score::Cusum => "CUSUM over cycles",
            Score::LeakResidual => "one cycle, relative to the baseline",
            Score::AbsoluteEstimate => "one cycle, without a baseline",
        }
    }

    fn of(self, cycle: &CycleRecord) -> Option<f64> {
        match self {
            Score::Cusum => cycle.compared.map(|compared| compared.cusum),
            Score::LeakResidual => cycle.compared.map(|compared| compared.leak_residual_m2),
            Score::AbsoluteEstimate => cycle.absolute.map(|size| size.leak_area_m2),
        }
    }
}

/// Cycles with leaks of a class, against all healthy ones.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ClassArea {
    /// Class.
    #[serde(flatten)]
    pub class: Class,
    /// Cycles.
    pub cycles: usize,
    /// Area under the curve.
    pub area: f64,
}

/// A score's curve.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Roc {
    /// Score.
    pub score: Score,
    /// Cycles of machines that do not leak.
    pub healthy_cycles: usize,
    /// Cycles of machines that leak.
    pub leaking_cycles: usize,
    /// Area under the curve: 1 where some threshold parts all, 0.5 where the score says nothing.
    pub area: f64,
    /// By size of the leak.
    pub classes: Vec<ClassArea>,
    /// Share of healthy cycles that a threshold takes for leaks, and share of leaks that it finds.
    pub points: Vec<[f64; 2]>,
}

/// Most points of a curve.
const POINTS: usize = 200;

impl Roc {
    /// The curve; `None` where healthy or leaking cycles are missing.
    pub fn of(records: &[MachineRecord], score: Score, conditions: &Conditions) -> Option<Self> {
        let (mut healthy, mut leaking) = (Vec::new(), Vec::new());
        for (truth_m2, value) in judged(records).filter_map(|(truth, cycle)| Some((truth, score.of(cycle)?)))
        {
            if leaks(truth_m2, conditions) {
                leaking.push((truth_m2 * conditions.lpm_per_m2, value));
            } else {
                healthy.push(value);
            }
        }
        if healthy.is_empty() || leaking.is_empty() {
            return None;
        }
        healthy.sort_by(f64::total_cmp);
        let class_area = |class: Class| {
            let scores: Vec<f64> =
                leaking.iter().filter(|(lpm, _)| class.holds(*lpm)).map(|(_, score)| *score).collect();
            let area = area_under(&healthy, &scores);
            (!scores.is_empty()).then_some(ClassArea { class, cycles: scores.len(), area })
        };
        let classes = Class::all().filter_map(class_area).collect();
        let mut scores: Vec<f64> = leaking.iter().map(|(_, score)| *score).collect();
        scores.sort_by(f64::total_cmp);
        Some(Roc {
            score,
            healthy_cycles: healthy.len(),
            leaking_cycles: scores.len(),
            area: area_under(&healthy, &scores),
            classes,
            points: curve(&healthy, &scores),
        })
    }
}

/// Values of a sorted list below a threshold, and at or below it.
fn below(sorted: &[f64], threshold: f64) -> (usize, usize) {
    (sorted.partition_point(|value| *value < threshold), sorted.partition_point(|value| *value <= threshold))
}

/// Chance that a leaking cycle scores higher than a healthy one, half of it where they are equal (Mann and Whitney's U,
/// which is the area under the curve; Hanley and McNeil 1982).
fn area_under(healthy_sorted: &[f64], leaking: &[f64]) -> f64 {
    let wins: f64 = leaking
        .iter()
        .map(|score| {
            let (below, not_above) = below(healthy_sorted, *score);
            0.5 * (below + not_above) as f64
        })
        .sum();
    wins / (healthy_sorted.len() * leaking.len()) as f64
}

/// From the highest threshold to the lowest; corners where either share changes, thinned out where there are many.
fn curve(healthy_sorted: &[f64], leaking_sorted: &[f64]) -> Vec<[f64; 2]> {
    let mut thresholds: Vec<f64> = healthy_sorted.iter().chain(leaking_sorted).copied().collect();
    thresholds.sort_by(|a, b| b.total_cmp(a));
    thresholds.dedup();
    let share =
        |sorted: &[f64], threshold| (sorted.len() - below(sorted, threshold).0) as f64 / sorted.len() as f64;
    let corners = thresholds
        .iter()
        .map(|threshold| [share(healthy_sorted, *threshold), share(leaking_sorted, *threshold)]);
    let mut points: Vec<[f64; 2]> = std::iter::once([0.0, 0.0]).chain(corners).collect();
    // The middle of a straight stretch says nothing.
    let straight = |a: [f64; 2], b: [f64; 2], c: [f64; 2]| {
        (a[0] == b[0] && b[0] == c[0]) || (a[1] == b[1] && b[1] == c[1])
    };
    let mut kept: Vec<[f64; 2]> = Vec::with_capacity(points.len());
    for point in points.drain(..) {
        if let [.., a, b] = kept[..]
            && straight(a, b, point)
        {
            kept.pop();
        }
        kept.push(point);
    }
    let step = kept.len().div_ceil(POINTS).max(1);
    let last = kept.len() - 1;
    kept.iter()
        .enumerate()
        .filter(|(index, _)| index % step == 0 || *index == last)
        .map(|(_, point)| *point)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn areas_of_perfect_useless_and_inverted_scores() {
        assert_eq!(area_under(&[1.0, 2.0], &[3.0, 4.0]), 1.0);
        assert_eq!(area_under(&[3.0, 4.0], &[1.0, 2.0]), 0.0);
        assert_eq!(area_under(&[1.0, 1.0], &[1.0, 1.0]), 0.5);
        // Of six pairs four are in order and one is a tie.
        assert_eq!(area_under(&[1.0, 2.0, 3.0], &[2.0, 4.0]), 4.5 / 6.0);
    }

    #[test]
    fn the_trapezoids_under_the_curve_are_the_area() {
        let healthy: Vec<f64> = (0..60).map(|k| f64::from(k * 7 % 60)).collect();
        let leaking: Vec<f64> = (0..40).map(|k| f64::from(20 + k * 11 % 60)).collect();
        let sorted = |mut values: Vec<f64>| {
            values.sort_by(f64::total_cmp);
            values
        };
        let (healthy, leaking) = (sorted(healthy), sorted(leaking));
        let points = curve(&healthy, &leaking);
        assert_eq!((points[0], points[points.len() - 1]), ([0.0, 0.0], [1.0, 1.0]));
        let area: f64 = points.windows(2).map(|w| (w[1][0] - w[0][0]) * 0.5 * (w[0][1] + w[1][1])).sum();
        assert!((area - area_under(&healthy, &leaking)).abs() < 1e-12);
        assert_eq!(curve(&[1.0, 2.0], &[3.0, 4.0]), [[0.0, 0.0], [0.0, 1.0], [1.0, 1.0]]);
    }
}

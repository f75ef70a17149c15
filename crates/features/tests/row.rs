//! Cycles of many strokes that look alike, with waits between them, found by their order.

#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use std::f64::consts::PI;

use proptest::prelude::*;
use seepd_features::segment::Projections;
use seepd_features::{
    Anchor, Anchors, CycleDefinition, CycleReader, Feature, Outcome, Phase, PhaseKind, Reason,
};
use seepd_signals::Sample;

const RATE_HZ: f64 = 100.0;
const STROKE_S: f64 = 0.6;
/// Peak command of each stroke, and the shortest hold after it, s. The first and the third, the second and the fourth look the same.
const STROKES: [(f64, f64); 6] = [(0.5, 0.6), (-0.4, 0.5), (0.5, 0.8), (-0.4, 0.7), (0.3, 0.5), (-0.45, 1.0)];
/// How much longer the holds may be, s; the last one ends the cycle and may be of any length.
const WAITS_S: [f64; 5] = [0.0, 0.4, 0.3, 0.0, 0.5];
const SHOULDER_S: f64 = 0.1;
const BIN_SAMPLES: usize = 5;

/// Half a wave, skewed by the stroke's number, so that no two are the same but for those of the same peak.
fn stroke(index: usize, tau: f64) -> f64 {
    let (peak, _) = STROKES[index];
    let skew = 1.0 + 0.3 * (index % 2) as f64;
    peak * (PI * tau.powf(skew)).sin()
}

/// A cycle with those waits and an offset of the command; a stroke may be missing.
fn cycle(waits_s: &[f64], offset: f64, missing: Option<usize>) -> Vec<f64> {
    let samples = |s: f64| (s * RATE_HZ).round() as usize;
    let mut command = vec![offset; samples(0.3)];
    for (index, (_, hold_s)) in STROKES.iter().enumerate() {
        let strokes = samples(STROKE_S);
        let shape = |k: usize| {
            if missing == Some(index) { 0.0 } else { stroke(index, (k as f64 + 0.5) / strokes as f64) }
        };
        command.extend((0..strokes).map(|k| offset + shape(k)));
        command.extend(vec![offset; samples(hold_s + waits_s.get(index).copied().unwrap_or(0.0))]);
    }
    command
}

fn period_s() -> f64 {
    0.3 + STROKES.iter().map(|(_, hold_s)| STROKE_S + hold_s).sum::<f64>()
}

/// End of a stroke as planned, s.
fn end_s(index: usize) -> f64 {
    0.3 + STROKES[..index].iter().map(|(_, hold_s)| STROKE_S + hold_s).sum::<f64>() + STROKE_S
}

fn template(index: usize) -> Vec<f32> {
    let planned = cycle(&[], 0.0, None);
    let from = ((end_s(index) - STROKE_S - SHOULDER_S) * RATE_HZ).round() as usize;
    let to = ((end_s(index) + SHOULDER_S) * RATE_HZ).round() as usize;
    normalized(&planned[from..to])
}

/// A stroke's template: its bins, without their mean, of length 1.
fn normalized(samples: &[f64]) -> Vec<f32> {
    let bins: Vec<f64> =
        samples.chunks_exact(BIN_SAMPLES).map(|bin| bin.iter().sum::<f64>() / bin.len() as f64).collect();
    let mean = bins.iter().sum::<f64>() / bins.len() as f64;
    let norm = bins.iter().map(|bin| (bin - mean).powi(2)).sum::<f64>().sqrt();
    bins.iter().map(|bin| ((bin - mean) / norm) as f32).collect()
}

#[derive(Debug, Default)]
struct Found {
    /// Start and end of the cycles in samples, and the means of their phases: the hold after each stroke.
    valid: Vec<(i64, i64, Vec<f64>)>,
    rejected: Vec<Reason>,
}

fn read(command: &[f64]) -> Found {
    let templates: Vec<Vec<f32>> = (0..STROKES.len()).map(template).collect();
    let anchor = |index: usize| Anchor {
        end_s: end_s(index) + SHOULDER_S,
        least_correlation: 0.7,
        sure_correlation: 1.0,
        least_deviation: 0.02,
        wait_s: index.checked_sub(1).map_or(0.0, |before| WAITS_S[before]),
        template: &templates[index][..],
    };
    let strokes = (0..STROKES.len()).map(|index| (end_s(index) - STROKE_S, end_s(index)));
    let anchors = Anchors::new([anchor(0), anchor(5)], [anchor(3), anchor(1), anchor(4), anchor(2)]);
    read_by(anchors, period_s(), strokes, command)
}

/// What is read by those strokes.
fn read_by(
    anchors: Anchors<'_>,
    period_s: f64,
    strokes: impl Iterator<Item = (f64, f64)>,
    command: &[f64],
) -> Found {
    let phases: Vec<Phase> =
        strokes.map(|(from_s, to_s)| Phase { from_s, to_s, kind: PhaseKind::Stroke }).collect();
    let definition = CycleDefinition {
        sample_rate_hz: RATE_HZ,
        period_s,
        bin_samples: BIN_SAMPLES,
        anchors,
        demand_mark: None,
        tolerance: 0.05,
        phases: &phases,
        projections: Projections::NONE,
    };
    let reader = CycleReader::new(None, definition, &[Feature::Mean]).unwrap();
    let mut state = reader.start(vec![0.0f32; definition.ring_samples()]).unwrap();
    let mut found = Found::default();
    let mut note = |outcome: Outcome<'_>| match outcome {
        Outcome::Valid(cycle) => {
            let sample = |time_ns: i64| (time_ns as f64 * 1e-9 * RATE_HZ).round() as i64;
            let means = cycle.statistics.phase_means()[..phases.len()].to_vec();
            found.valid.push((sample(cycle.start_ns), sample(cycle.end_ns), means));
        }
        Outcome::Rejected(rejected) => found.rejected.push(rejected.reason),
    };
    for (number, command) in command.iter().enumerate() {
        reader.push(
            &mut state,
            &Sample::command((number as f64 * 1e9 / RATE_HZ) as i64, *command),
            &mut note,
        );
    }
    reader.finish(&mut state, &mut note);
    found
}

/// Cycles with their pauses one after the other, and where each begins.
fn log(cycles: &[(Vec<f64>, f64, f64)]) -> (Vec<f64>, Vec<i64>) {
    let mut command = vec![0.0; 50];
    let mut starts = Vec::new();
    for (waits_s, offset, pause_s) in cycles {
        starts.push(command.len() as i64);
        command.extend(cycle(waits_s, *offset, None));
        command.extend(vec![*offset; (pause_s * RATE_HZ) as usize]);
    }
    (command, starts)
}

fn some_cycles() -> impl Strategy<Value = Vec<(Vec<f64>, f64, f64)>> {
    let waits = WAITS_S.map(|wait_s| 0.0..=wait_s);
    proptest::collection::vec((waits.prop_map(|waits| waits.to_vec()), -0.05..0.05, 0.0..4.0), 4..8)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    /// Whatever the waits and pauses are, each cycle is found once, where it began, and each stroke's mean is its own.
    #[test]
    fn property_every_cycle_is_found_whatever_it_waits_for(cycles in some_cycles()) {
        let (command, starts) = log(&cycles);
        let found = read(&command);
        prop_assert_eq!(found.valid.len(), starts.len(), "{:?}", found.rejected);
        prop_assert_eq!(found.rejected.len(), 0);
        for ((start, _, means), (expected, (_, offset, _))) in found.valid.iter().zip(starts.iter().zip(&cycles)) {
            prop_assert!((start - expected).abs() <= 3, "{start} {expected}");
            for (index, mean) in means.iter().enumerate() {
                // A half wave's mean; a place that is off by two samples of sixty costs a thirtieth at most.
                let ideal: f64 = (0..60).map(|k| stroke(index, (f64::from(k) + 0.5) / 60.0)).sum::<f64>() / 60.0;
                prop_assert!((mean - offset - ideal).abs() < 0.02, "{index}: {mean} {ideal} {offset}");
            }
        }
    }

    /// A log that begins anywhere costs the cycle under way and no other, and none is found out of step.
    #[test]
    fn property_a_log_may_begin_anywhere(cycles in some_cycles(), begins in 0usize..1200) {
        let (command, starts) = log(&cycles);
        let begins = begins.min(starts[1] as usize);
        let found = read(&command[begins..]);
        let expected: Vec<i64> =
            starts.iter().map(|start| start - begins as i64).filter(|start| *start >= 0).collect();
        let found_starts: Vec<i64> = found.valid.iter().map(|(start, ..)| *start).collect();
        prop_assert!(found_starts.len() >= expected.len(), "{found_starts:?} {expected:?}");
        for (start, expected) in found_starts.iter().rev().zip(expected.iter().rev()) {
            prop_assert!((start - expected).abs() <= 3, "{found_starts:?} {expected:?}");
        }
    }
}

/// A cycle that lacks a stroke is no cycle, is told as such, and costs no other.
#[test]
fn a_missing_stroke_costs_its_cycle() {
    for missing in [2, 4, 5] {
        let mut command = vec![0.0; 50];
        for number in 0..6 {
            command.extend(cycle(&[0.0, 0.2, 0.1, 0.0, 0.3], 0.0, (number == 3).then_some(missing)));
        }
        let found = read(&command);
        assert_eq!(found.valid.len(), 5, "{missing}: {found:?}");
        assert_eq!(found.rejected, [Reason::Incomplete], "{missing}");
    }
}

/// The cycle that follows at once is whole while the first one still waits for a better row: both are cycles, whichever matches better.
#[test]
fn cycles_that_follow_at_once_are_all_found() {
    for uneven in [0.0, 0.01, -0.01] {
        let mut command = vec![0.0; 50];
        for number in 0..8 {
            let shift = uneven * f64::from(number % 2);
            command.extend(
                cycle(&[], 0.0, None).iter().enumerate().map(|(k, value)| value + shift * (k as f64).sin()),
            );
        }
        let found = read(&command);
        assert_eq!(found.valid.len(), 8, "{uneven}: {found:?}");
        assert!(found.rejected.is_empty(), "{uneven}: {found:?}");
    }
}

/// Where strokes are alike and equally far apart, the end of a cycle's last stroke passes for the first of the next, and a row that is out of
/// step by a stroke is whole before the right one. It begins too soon after the last cycle to be the next.
#[test]
fn a_row_that_begins_with_the_last_stroke_is_no_cycle() {
    const SKEWS: [f64; 3] = [0.7, 1.0, 1.5];
    // The first stroke's template goes on for longer, so that on the last one it ends later.
    const SHOULDERS_S: [f64; 3] = [0.3, 0.1, 0.1];
    const EVERY_S: f64 = 2.0;
    let wave = |index: usize, tau: f64| 0.5 * (PI * tau.powf(SKEWS[index])).sin();
    let cycle: Vec<f64> = (0..SKEWS.len())
        .flat_map(|index| {
            (0..200).map(move |k| {
                let tau = (f64::from(k) + 0.5) / (STROKE_S * RATE_HZ) - 1.0;
                if (0.0..1.0).contains(&tau) { wave(index, tau) } else { 0.0 }
            })
        })
        .collect();
    let end_s = |index: usize| EVERY_S * index as f64 + 2.0 * STROKE_S;
    let templates: Vec<Vec<f32>> = (0..SKEWS.len())
        .map(|index| {
            let [from, to] = [end_s(index) - STROKE_S - SHOULDER_S, end_s(index) + SHOULDERS_S[index]]
                .map(|at_s| (at_s * RATE_HZ).round() as usize);
            normalized(&cycle[from..to])
        })
        .collect();
    let anchor = |index: usize| Anchor {
        end_s: end_s(index) + SHOULDERS_S[index],
        least_correlation: 0.3,
        sure_correlation: 1.0,
        least_deviation: 0.02,
        wait_s: 0.0,
        template: &templates[index][..],
    };
    let strokes = (0..SKEWS.len()).map(|index| (end_s(index) - STROKE_S, end_s(index)));
    let anchors = Anchors::new([anchor(0), anchor(2)], [anchor(1)]);
    let command: Vec<f64> = cycle.iter().copied().cycle().take(10 * cycle.len()).collect();
    let found = read_by(anchors, EVERY_S * SKEWS.len() as f64, strokes, &command);
    let starts: Vec<i64> = found.valid.iter().map(|(start, ..)| *start).collect();
    let expected: Vec<i64> = (0..10).map(|number| number * cycle.len() as i64).collect();
    assert_eq!(starts.len(), expected.len(), "{found:?}");
    assert!(
        starts.iter().zip(&expected).all(|(start, expected)| (start - expected).abs() <= 3),
        "{starts:?}"
    );
}

//! Cycles of two strokes whose holds end with an event, so that the strokes may lie nearly anywhere after one another.

use std::f64::consts::PI;

use seepd_features::segment::Projections;
use seepd_features::{Anchor, Anchors, CycleDefinition, CycleReader, Feature, Outcome, Phase, PhaseKind};
use seepd_signals::Sample;

const RATE_HZ: f64 = 100.0;
const BIN_SAMPLES: usize = 2;
const OUT_S: f64 = 0.2;
const BACK_S: f64 = 0.3;
/// Holds before, between and after the strokes as planned, s.
const HOLDS_S: [f64; 3] = [0.2, 0.9, 0.7];
const PERIOD_S: f64 = HOLDS_S[0] + OUT_S + HOLDS_S[1] + BACK_S + HOLDS_S[2];

fn half_wave(peak: f64, length_s: f64) -> impl Iterator<Item = f64> {
    let samples = (length_s * RATE_HZ).round();
    (0..samples as usize).map(move |k| peak * (PI * (k as f64 + 0.5) / samples).sin())
}

fn still(length_s: f64) -> impl Iterator<Item = f64> {
    (0..(length_s * RATE_HZ).round() as usize).map(|_| 0.0)
}

/// A cycle with holds so much longer than planned, shares of their length; after the stroke out the command undershoots, which looks a
/// little like the stroke back.
fn cycle(longer: [f64; 2]) -> Vec<f64> {
    let undershoot_s = 0.12;
    still(HOLDS_S[0])
        .chain(half_wave(0.6, OUT_S))
        .chain(half_wave(-0.3, undershoot_s))
        .chain(still(HOLDS_S[1] * (1.0 + longer[0]) - undershoot_s))
        .chain(half_wave(-0.5, BACK_S))
        .chain(still(HOLDS_S[2] * (1.0 + longer[1])))
        .collect()
}

fn template(shape: impl Iterator<Item = f64>) -> Vec<f32> {
    let command: Vec<f64> = still(0.1).chain(shape).chain(still(0.1)).collect();
    let bins: Vec<f64> =
        command.chunks_exact(BIN_SAMPLES).map(|bin| bin.iter().sum::<f64>() / bin.len() as f64).collect();
    let mean = bins.iter().sum::<f64>() / bins.len() as f64;
    let norm = bins.iter().map(|bin| (bin - mean).powi(2)).sum::<f64>().sqrt();
    bins.iter().map(|bin| ((bin - mean) / norm) as f32).collect()
}

/// An undershoot that matches the stroke back a little comes long before the stroke itself: the match waits for it.
#[test]
fn a_weak_match_waits_as_long_as_the_stroke_may_come() {
    let templates = [template(half_wave(0.6, OUT_S)), template(half_wave(-0.5, BACK_S))];
    let ends_s = [HOLDS_S[0] + OUT_S + 0.1, HOLDS_S[0] + OUT_S + HOLDS_S[1] + BACK_S + 0.1];
    let [out, back] = [(0usize, 0.8), (1, 0.45)].map(|(index, least_correlation)| Anchor {
        end_s: ends_s[index],
        least_correlation,
        sure_correlation: 0.9,
        least_deviation: 0.02,
        wait_s: 0.0,
        template: &templates[index][..],
    });
    let phases = [Phase { from_s: HOLDS_S[0], to_s: HOLDS_S[0] + OUT_S, kind: PhaseKind::Stroke }];
    let definition = CycleDefinition {
        sample_rate_hz: RATE_HZ,
        period_s: PERIOD_S,
        bin_samples: BIN_SAMPLES,
        anchors: Anchors::new([out, back], []),
        demand_mark: None,
        tolerance: 0.45,
        phases: &phases,
        projections: Projections::NONE,
    };
    let reader = CycleReader::new(None, definition, &[Feature::Mean]).unwrap();
    let mut state = reader.start(vec![0.0f32; definition.ring_samples()]).unwrap();
    let (mut valid, mut rejected) = (Vec::new(), 0);
    let mut note = |outcome: Outcome<'_>| match outcome {
        Outcome::Valid(cycle) => valid.push([cycle.start_ns, cycle.end_ns].map(|ns| ns as f64 * 1e-9)),
        Outcome::Rejected(_) => rejected += 1,
    };
    let mut command: Vec<f64> = still(0.5).collect();
    let mut expected = Vec::new();
    for longer in [[0.0, 0.3], [0.9, 1.2], [0.6, 0.5], [0.3, 0.0], [1.0, 1.5], [0.8, 0.1]] {
        let start_s = command.len() as f64 / RATE_HZ;
        expected.push([start_s, start_s + PERIOD_S + longer[0] * HOLDS_S[1]]);
        command.extend(cycle(longer));
    }
    for (number, value) in command.iter().enumerate() {
        reader.push(&mut state, &Sample::command((number as f64 * 1e9 / RATE_HZ) as i64, *value), &mut note);
    }
    reader.finish(&mut state, &mut note);
    assert_eq!(valid.len(), expected.len(), "{valid:?} {rejected}");
    assert_eq!(rejected, 0, "{valid:?}");
    for (found, expected) in valid.iter().zip(&expected) {
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 0.05), "{valid:?} {expected:?}");
    }
}

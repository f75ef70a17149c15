//! The templates by which a duty cycle's strokes are recognised in a command, from simulated machines.

use seepd_features::{Anchor, KalmanState, Projections};
use seepd_model::schema::Cycle;
use seepd_sim::MachineSpec;

use crate::cases::{ARTICLE_NOISE, noise_of};
use crate::dataset::{self, Observation, Reading, purpose};
use crate::duty;
use crate::leak_range::LeakRange;
use crate::train::{TrainError, TrainingSettings, round_to};

/// Machines from which templates are made.
const TEMPLATE_MACHINES: usize = 64;

/// The duty cycle with its templates, and the leaks with which it can be followed and recognised.
pub(crate) fn recognisable(
    spec: &MachineSpec,
    settings: &TrainingSettings,
) -> Result<(Cycle, LeakRange), TrainError> {
    let mut leaks = settings.leaks_of(spec);
    loop {
        let cycle = with_templates(spec, settings, leaks)?;
        let lowered =
            if recognises_the_largest(spec, settings, leaks, &cycle) { None } else { leaks.lowered() };
        match lowered {
            Some(lower) => leaks = lower,
            None => return Ok((cycle, leaks)),
        }
    }
}

/// Whether cycles with the largest leaks are recognised as those without one are, but for what chance leaves out: a machine that cannot
/// follow its cycle whatever its seal says nothing of leaks.
fn recognises_the_largest(
    spec: &MachineSpec,
    settings: &TrainingSettings,
    leaks: LeakRange,
    cycle: &Cycle,
) -> bool {
    let mut observations =
        dataset::draw(spec, &settings.spread, leaks, TEMPLATE_MACHINES, settings.seed, purpose::LARGEST);
    let [tight, worn] = [0.0, leaks.top_m2()].map(|leak_area_m2| {
        observations.iter_mut().for_each(|observation| observation.leak_area_m2 = leak_area_m2);
        recognised_of(&observations, spec, settings, cycle)
    });
    let share = settings.least_recognised.max(LEAST_OF_THE_LARGEST) - FEWER_OF_THE_LARGEST;
    worn as f64 >= share * tight as f64
}

/// How many of these machines' cycles are recognised.
fn recognised_of(
    observations: &[Observation],
    spec: &MachineSpec,
    settings: &TrainingSettings,
    cycle: &Cycle,
) -> usize {
    let phases = cycle.phase_list();
    let sample_rate_hz = 1.0 / spec.controller.log_period_s();
    let reading = Reading { cycle, phases: &phases, sample_rate_hz, projections: Projections::NONE };
    let read = dataset::simulate(observations, |index, commands| {
        let mut noise = noise_of(&observations[index], settings);
        let unit = dataset::unit_noise(&mut noise, commands.len());
        reading.read(commands, settings.filter, settings.noise.1, &unit).is_some()
    });
    read.into_iter().filter(|recognised| *recognised).count()
}

/// Least share of the machines that follow their cycle without a leak that have to do so with the largest.
const LEAST_OF_THE_LARGEST: f64 = 0.8;

/// With the largest leak so much less of the machines may be recognised: it is drawn seldom.
const FEWER_OF_THE_LARGEST: f64 = 0.04;

/// Fills the anchors' templates from simulated machines.
fn with_templates(
    spec: &MachineSpec,
    settings: &TrainingSettings,
    leaks: LeakRange,
) -> Result<Cycle, TrainError> {
    let mut cycle = duty::cycle_of(spec)?;
    let windows = duty::template_windows(spec)?;
    let binning = Binning { rate_hz: 1.0 / spec.controller.log_period_s(), samples: cycle.bin_samples };
    let shapes = simulated_shapes(spec, settings, leaks, &windows, &binning);
    let anchors = cycle.anchors.iter_mut().chain(&mut cycle.further_anchors);
    for (which, (anchor, (from_s, _))) in anchors.zip(windows).enumerate() {
        let strokes: Vec<&[f64]> = shapes.iter().map(|shape| shape.strokes[which].as_slice()).collect();
        let cycles = shapes.iter().map(|shape| shape.cycle.as_slice());
        fill(anchor, &strokes, cycles, from_s, &binning);
    }
    Ok(cycle)
}

/// How a command is binned.
struct Binning {
    rate_hz: f64,
    samples: usize,
}

/// A simulated cycle for making templates, in bins.
struct Shapes {
    strokes: Vec<Vec<f64>>,
    cycle: Vec<f64>,
}

/// Machines' strokes, each within its window, and their whole cycles.
fn simulated_shapes(
    spec: &MachineSpec,
    settings: &TrainingSettings,
    leaks: LeakRange,
    windows: &[(f64, f64)],
    binning: &Binning,
) -> Vec<Shapes> {
    let observations =
        dataset::draw(spec, &settings.spread, leaks, TEMPLATE_MACHINES, settings.seed, purpose::TEMPLATE);
    dataset::simulate(&observations, |index, commands| {
        let mut noise = noise_of(&observations[index], settings);
        let filter = settings.filter;
        let mut state = KalmanState::default();
        let filtered: Vec<f64> = commands
            .iter()
            .map(|command| {
                let noisy = command + noise.normal(ARTICLE_NOISE);
                filter.map_or(noisy, |kalman| kalman.step(&mut state, noisy))
            })
            .collect();
        let lead = dataset::lead(&observations[index]);
        let binned = |from: usize, to: usize| -> Vec<f64> {
            let bins = filtered[from..to].chunks_exact(binning.samples);
            bins.map(|bin| bin.iter().sum::<f64>() / bin.len() as f64).collect()
        };
        let stretch = observations[index].stretch;
        let at = |at_s: f64| lead + (at_s * binning.rate_hz).round() as usize;
        let stroke = |window: &(f64, f64)| {
            let (from_s, to_s) = *window;
            if !is_smeared(*window, settings.spread.period, binning) {
                return binned(at(from_s), at(to_s));
            }
            let phase = (bin_phase(index) * binning.samples as f64).round() as isize;
            let from = at(from_s * stretch).saturating_add_signed(phase);
            binned(from, from + ((to_s - from_s) * binning.rate_hz).round() as usize)
        };
        Shapes {
            strokes: windows.iter().map(stroke).collect(),
            cycle: binned(at(0.0), at(spec.cycle.period_s * stretch)),
        }
    })
}

/// Whether machines that take longer for a cycle, or a bin's width, move a stroke by so much of its window that the mean at its planned place
/// would show no stroke any more: a short one late in a long cycle. Then each machine's is taken where it is.
fn is_smeared((from_s, to_s): (f64, f64), period_spread: f64, binning: &Binning) -> bool {
    let by_the_period_s = period_spread * 0.5 * (from_s + to_s);
    let by_a_bin_s = 0.5 * binning.samples as f64 / binning.rate_hz;
    by_the_period_s.max(by_a_bin_s) > SMEARED * (to_s - from_s)
}

/// Share of its window by which a stroke may be moved and be as it is.
const SMEARED: f64 = 0.1;

/// Where a machine's bins begin, in bins from where the planned ones do: a monitor's begin anywhere, and a short stroke looks different by it.
fn bin_phase(machine: usize) -> f64 {
    // Weyl's sequence by the golden ratio: any number of machines has them spread evenly.
    (machine as f64 * 0.618_033_988_749_895).fract() - 0.5
}

/// Fills an anchor from its stroke on each machine, which begins at `from_s` of the cycle, and from what the rest of the cycle is like.
fn fill<'a>(
    anchor: &mut Anchor<Vec<f32>>,
    strokes: &[&[f64]],
    cycles: impl Iterator<Item = &'a [f64]>,
    from_s: f64,
    binning: &Binning,
) {
    let centred: Vec<Vec<f64>> = strokes.iter().map(|stroke| normalised(stroke)).collect();
    let mean: Vec<f64> =
        (0..centred[0].len()).map(|bin| centred.iter().map(|shape| shape[bin]).sum()).collect();
    let template = normalised(&mean);
    let least = centred
        .iter()
        .map(|shape| shape.iter().zip(&template).map(|(a, b)| a * b).sum::<f64>())
        .fold(f64::INFINITY, f64::min);
    let deviation = strokes.iter().map(|stroke| deviation(stroke)).fold(f64::INFINITY, f64::min);
    // Room for what the simulator does not know; other parts of the cycle are told apart by their order.
    anchor.least_correlation = round_to(0.9 * least, 3).clamp(0.3, 0.9);
    let least_deviation = round_to(0.3 * deviation, 4);
    anchor.least_deviation = least_deviation;
    let own = (from_s * binning.rate_hz / binning.samples as f64).round() as usize;
    let rival =
        cycles.map(|cycle| best_elsewhere(cycle, &template, own, least_deviation)).fold(0.0, f64::max);
    // Half way between the best of the rest and a perfect match.
    anchor.sure_correlation = round_to(0.5 * (1.0 + rival), 3).clamp(anchor.least_correlation, 1.0);
    anchor.template = template.iter().map(|value| *value as f32).collect();
    // Whole bins only: the template may end before its window does.
    let bins = template.len() as f64 * binning.samples as f64;
    anchor.end_s = round_to(from_s + bins / binning.rate_hz, 6);
}

/// The best normalised correlation of a template with the cycle, run in a ring, away from its own place.
fn best_elsewhere(cycle: &[f64], template: &[f64], own: usize, least_deviation: f64) -> f64 {
    let bins = cycle.len();
    let away = (AWAY_SHARE * bins as f64) as usize;
    let window =
        |start: usize| -> Vec<f64> { (0..template.len()).map(|bin| cycle[(start + bin) % bins]).collect() };
    (0..bins)
        .filter(|start| {
            let distance = start.abs_diff(own);
            distance.min(bins - distance) > away
        })
        .map(window)
        .filter(|shape| deviation(shape) > least_deviation)
        .map(|shape| normalised(&shape).iter().zip(template).map(|(a, b)| a * b).sum::<f64>())
        .fold(0.0, f64::max)
}

/// Closer than this share of the period a match is still the stroke's own.
const AWAY_SHARE: f64 = 0.08;

fn deviation(values: &[f64]) -> f64 {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt()
}

/// Mean 0, sum of squares 1.
fn normalised(values: &[f64]) -> Vec<f64> {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let norm = deviation(values) * (values.len() as f64).sqrt();
    values.iter().map(|value| (value - mean) / norm.max(1e-12)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The nominal press with six times the period and short strokes: machines that take 3 % longer have the last stroke a whole stroke later,
    /// and are recognised all the same, wherever the reader's bins begin.
    #[test]
    fn short_strokes_late_in_a_long_cycle_are_recognised() {
        let mut spec = MachineSpec::default();
        // Longer steps for a softer line.
        spec.plant.inlet_volume_m3 *= 4.0;
        spec.controller.steps_per_period = 3;
        spec.cycle.period_s = 60.0;
        for (stroke, from_s) in spec.cycle.moves.iter_mut().zip([5.0, 30.0, 55.0]) {
            (stroke.from_s, stroke.to_s) = (from_s, from_s + 1.2);
        }
        let settings = TrainingSettings { noise: (0.001, 0.001), ..TrainingSettings::default() };
        let leaks = LeakRange::of(&spec);
        let cycle = with_templates(&spec, &settings, leaks).unwrap();
        let observations =
            dataset::draw(&spec, &settings.spread, leaks, TEMPLATE_MACHINES, 7, purpose::LARGEST);
        let recognised = recognised_of(&observations, &spec, &settings, &cycle);
        assert!(recognised + 1 >= observations.len(), "{recognised} of {}", observations.len());
        let anchors = cycle.anchors.iter().chain(&cycle.further_anchors);
        let least: Vec<f64> = anchors.map(|anchor| anchor.least_correlation).collect();
        assert!(least.iter().all(|least| *least > 0.6), "{least:?}");
    }

    /// The shipped press's strokes are long for its cycle, and its templates what they were.
    #[test]
    fn long_strokes_are_taken_where_they_are_planned() {
        let spec = MachineSpec::default();
        let cycle = duty::cycle_of(&spec).unwrap();
        let binning = Binning { rate_hz: 1.0 / spec.controller.log_period_s(), samples: cycle.bin_samples };
        let windows = duty::template_windows(&spec).unwrap();
        assert!(windows.iter().all(|window| !is_smeared(*window, 0.03, &binning)));
        assert!(is_smeared((33.1, 34.0), 0.03, &binning));
        let coarse = Binning { samples: 100, ..binning };
        assert!(is_smeared((0.6, 1.0), 0.0, &coarse));
    }
}

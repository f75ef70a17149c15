//! The simulated cycles that are learned from, and the machines that nothing is learned from.

use seepd_features::statistics::CycleStatistics;
use seepd_sim::MachineSpec;
use seepd_sim::noise::Noise;

use crate::dataset::{self, Observation, Reading, purpose};
use crate::portions::{Portions, Row};
use crate::train::{Stage, TrainError, TrainingSettings};

/// The article's measurement noise.
pub(crate) const ARTICLE_NOISE: f64 = 0.001;

/// A simulated machine's cycle as it was read.
pub(crate) struct Case {
    pub(crate) leak_area_m2: f64,
    /// With a noise drawn from the training's range, filtered.
    pub(crate) mixed: CycleStatistics,
    /// With the article's noise, filtered and, for the noise table only, unfiltered.
    pub(crate) quiet: [Option<CycleStatistics>; 2],
    /// With the largest noise of the training's range, filtered.
    pub(crate) loud: Option<CycleStatistics>,
}

impl Case {
    fn stored((leak_area_m2, rows): (f64, [Option<Row>; 4])) -> Option<Self> {
        let [mixed, quiet, unfiltered, loud] = rows.map(|row| row.as_ref().and_then(Row::statistics));
        Some(Case { leak_area_m2, mixed: mixed?, quiet: [quiet, unfiltered], loud })
    }
}

/// Simulates the cycles that are learned from; those that are not recognised are left out.
pub(crate) fn simulate(
    spec: &MachineSpec,
    settings: &TrainingSettings,
    reading: &Reading<'_>,
    portions: &mut Portions,
    tell: &mut dyn FnMut(Stage, usize, usize),
) -> Result<Vec<Case>, TrainError> {
    let observations = learned(spec, settings);
    let (mut cases, mut done) = (Vec::with_capacity(observations.len()), 0);
    let read = |observation: &Observation, commands: &[f64]| {
        let mut noise = noise_of(observation, settings);
        let sigma = log_uniform(&mut noise, settings.noise);
        let unit = dataset::unit_noise(&mut noise, commands.len());
        let read = |filter, sigma| reading.read(commands, filter, sigma, &unit);
        let mixed = read(settings.filter, sigma)?;
        let quiet = read(settings.filter, ARTICLE_NOISE);
        let loud = read(settings.filter, settings.noise.1);
        let unfiltered = settings.noise_table.then(|| read(None, ARTICLE_NOISE)).flatten();
        let rows = [Some(mixed), quiet, unfiltered, loud].map(|statistics| statistics.map(Row::from));
        Some((observation.leak_area_m2, rows))
    };
    dataset::in_portions(("learned", portions), &observations, read, |case| {
        cases.extend(case.and_then(Case::stored));
        done += 1;
        tell(Stage::Simulate, done, observations.len());
    })?;
    Ok(cases)
}

/// Refuses to learn from too few of the cycles that were simulated.
///
/// # Errors
/// [`TrainError::Unrecognised`].
pub(crate) fn check_enough(cases: &[Case], settings: &TrainingSettings) -> Result<(), TrainError> {
    let (found, simulated) = (cases.len(), settings.observations);
    if (found as f64) < settings.least_recognised * simulated as f64 {
        return Err(TrainError::Unrecognised { found, simulated });
    }
    Ok(())
}

/// The random stream of an observation's measurement noise, apart from the one of its parameters.
pub(crate) fn noise_of(observation: &Observation, settings: &TrainingSettings) -> Noise {
    Noise::new(settings.seed ^ 0x006e_6f69_7365, observation.stream)
}

fn log_uniform(noise: &mut Noise, (low, high): (f64, f64)) -> f64 {
    low * libm::pow(high / low, noise.uniform(0.0, 1.0))
}

/// Machines whose cycles are learned from: an area is that of an orifice, so that their seals leak as one.
fn learned(spec: &MachineSpec, settings: &TrainingSettings) -> Vec<Observation> {
    let (leaks, spread) = (settings.leaks_of(spec), settings.spread.of_orifices());
    dataset::draw(spec, &spread, leaks, settings.observations, settings.seed, purpose::LEARN)
}

/// Machines that nothing is learned from, for the report.
pub(crate) fn held_out(spec: &MachineSpec, settings: &TrainingSettings) -> Vec<Observation> {
    let leaks = settings.leaks_of(spec);
    dataset::draw(spec, &settings.spread, leaks, settings.held_out, settings.seed, purpose::HELD_OUT)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::Spread;

    /// Sizes are learned from orifices alone; what is held against them has seals of every law.
    #[test]
    fn sizes_are_learned_from_orifices() {
        let spread = Spread { unknown_seal: true, ..Spread::default() };
        let settings =
            TrainingSettings { observations: 200, held_out: 200, spread, ..TrainingSettings::default() };
        let gaps = |machines: Vec<Observation>| {
            machines.iter().filter(|machine| machine.laminar_share > 0.0).count()
        };
        let spec = MachineSpec::default();
        assert_eq!(gaps(learned(&spec, &settings)), 0);
        // Half of them, within three standard errors.
        assert!((79..=121).contains(&gaps(held_out(&spec, &settings))));
    }
}

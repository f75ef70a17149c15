//! Learns to compare a cycle with the machine's own baseline: [`RelativeFile`] says what is learned.
//!
//! Each machine is simulated healthy, as its baseline, and again under other loads, oil temperatures and supply pressures, with
//! leaks and without. A baseline is the mean of [`BASELINE_CYCLES`] cycles, while which the oil warms or cools: it is the mean of
//! [`BASELINE_MOMENTS`] of them, with as much noise as is left of all.

use seepd_features::statistics::CycleStatistics;
use seepd_model::accuracy::{Decade, Judged, coverage, decades, median_relative_error};
use seepd_model::relative::{
    Comparison, DRIFT_ALLOWANCE, Inputs, MAX_CHANGES, centred, half_width, log_leak_residual, standardised,
};
use seepd_model::schema::{
    DeadbandFile, DetectionFile, KindFile, RelativeFile, RelativeGolden, TrainingDistribution, Tree, ViewFile,
};
use seepd_model::{Ensemble, ModelFile};
use seepd_sim::noise::Noise;
use seepd_sim::real::LANES;
use seepd_sim::series::Tolerances;
use seepd_sim::{MachineSpec, series};
use serde::Serialize;

use crate::conformal::{self, Prediction, significant};
use crate::dataset::{self, Observation, Reading};
use crate::forest::{Forest, ForestParams, Table};
use crate::leak_range::LeakRange;
use crate::linear;
use crate::out_of_distribution;
use crate::portions::Portions;
use crate::report::NOISE_LEVELS;
use crate::train::{TrainError, TrainingSettings};
use crate::{response_error, unknown_contact, unknown_overlap, unknown_seal};

/// Cycles that a baseline is the mean of.
pub const BASELINE_CYCLES: usize = 50;
/// Cycles by which a baseline is simulated.
pub const BASELINE_MOMENTS: usize = 2;
/// When they are, in shares of the way from the oil at the baseline's beginning to that at its end: where Gauss and Legendre have two
/// points, so that their mean is that of all cycles for whatever is a cubic of the oil.
const MOMENTS: [f64; BASELINE_MOMENTS] = [0.211_324_865_405_187_1, 0.788_675_134_594_812_9];

/// What changes on a machine, and from one machine to the next.
#[derive(Debug, Clone, PartialEq)]
pub struct Conditions {
    /// Plant parameters of a machine are drawn uniformly within these.
    pub parameters: Tolerances,
    /// Load of a machine over the plan's, within ± this share.
    pub machine_load: f64,
    /// The duty cycle's time on a machine, within ± this share.
    pub period: f64,
    /// Load of a cycle, within ± this share of the machine's.
    pub load: f64,
    /// Oil temperature of a cycle, uniform, °C.
    pub oil_c: (f64, f64),
    /// Supply pressure of a cycle, within ± this share of the machine's.
    pub supply: f64,
    /// Share of the machines whose valve has a dead band beside the plant file's, and its largest half width, share of full command.
    pub deadband: (f64, f64),
    /// Whether half of the machines meet a contact that nobody knows of.
    pub unknown_contact: bool,
    /// Whether seals of half of the machines by which intervals are calibrated leak more like a gap than like an orifice. Sizes are learned
    /// from orifices: an area is that of an orifice.
    pub unknown_seal: bool,
    /// How far the flow gain of a machine's valve may be off at its null, share to either side.
    pub null_deviation: f64,
    /// Standard deviation of a machine's own error in what a change does to a phase, share.
    pub response_error: f64,
}

impl Default for Conditions {
    fn default() -> Self {
        Conditions {
            parameters: Tolerances::even(0.10),
            machine_load: 0.10,
            period: 0.03,
            load: 0.10,
            oil_c: (30.0, 60.0),
            supply: 0.01,
            deadband: (1.0 / 3.0, 0.02),
            unknown_contact: false,
            unknown_seal: false,
            null_deviation: 0.0,
            response_error: 0.0,
        }
    }
}

impl Conditions {
    /// The same, of machines whose seals leak as orifices do.
    fn of_orifices(&self) -> Self {
        Conditions { unknown_seal: false, ..self.clone() }
    }

    /// A machine of the series.
    pub fn machine(&self, spec: &MachineSpec, noise: &mut Noise) -> Observation {
        let mut observation = Observation {
            spec: series::vary(spec, &self.parameters, noise),
            load_factor: noise.factor(self.machine_load),
            stretch: noise.factor(self.period),
            leak_area_m2: 0.0,
            laminar_share: 0.0,
            null_deviation: 0.0,
            extra_deadband: 0.0,
            stream: 0,
        };
        observation.extra_deadband = unknown_overlap::put_on(&mut observation.spec, self.deadband, noise);
        if self.unknown_contact {
            unknown_contact::put_on(&mut observation.spec, noise);
        }
        if self.unknown_seal {
            observation.laminar_share = unknown_seal::laminar_share(noise);
        }
        if self.null_deviation > 0.0 {
            observation.null_deviation = noise.uniform(-self.null_deviation, self.null_deviation);
        }
        observation
    }

    /// The machine on some day: with its load over the machine's own, oil temperature and supply pressure over its own.
    pub fn on_a_day(machine: &Observation, load: f64, oil_c: f64, supply: f64) -> Observation {
        let mut today = machine.clone();
        today.spec = series::on_a_day(&machine.spec, oil_c, supply);
        today.load_factor *= load;
        today
    }
}

/// Random streams that share no machine with each other and with those of the absolute estimate.
mod purpose {
    pub(super) const LEARN: u64 = 11;
    pub(super) const CALIBRATE: u64 = 12;
    pub(super) const TEST: u64 = 13;
    pub(super) const BEYOND: u64 = 14;
}

/// Machines to learn from, and cycles of each beside its baseline.
const LEARNED_CYCLES: usize = 6;
/// Cycles beside the baseline of each machine that calibrates: one machine says little of a quantile.
const CALIBRATED_CYCLES: usize = 2;
/// Machines with leaks beyond those that are learned from, by which these are known.
const BEYOND_MACHINES: usize = 48;
/// Shares of cycles without a leak and with one below the main range.
const SHARE_HEALTHY: f64 = 0.25;
const SHARE_SMALL: f64 = 0.25;
/// Regularisation of the leak residual, over the mean square of its terms.
const RIDGE: f64 = 1e-7;
/// The same of the dead band, whose terms are standardised.
const DEADBAND_RIDGE: f64 = 1e-6;
/// Room over the widest dead band that the baseline of a machine without one shows.
const DEADBAND_ROOM: f64 = 1.25;
/// Cycles with which machines of a kind are calibrated by themselves.
const LEAST_OF_A_KIND: usize = 200;
/// How the trees that correct the leak residual are grown. The leak residual leaves them little, so that small ones do.
const FOREST_PARAMS: ForestParams = ForestParams { learners: 24, least_leaf: 40, feature_share: 0.5 };
/// Room over the largest change of load that was learned from: the leak residual is smooth.
const LOAD_ROOM: f64 = 2.0;
/// Threshold of the cumulative sum, standard deviations.
const THRESHOLD: f64 = 10.0;
/// Golden pairs in the file.
const GOLDEN: usize = 6;

/// Leak area at a rank of 0 … 1, m².
fn leak_at(leaks: LeakRange, rank: f64) -> f64 {
    leaks.at_m2(rank, SHARE_HEALTHY, SHARE_SMALL)
}

/// A cycle with the machine's baseline, both at each level of noise.
#[derive(Debug, Clone)]
struct Pair {
    leak_area_m2: f64,
    /// Half width of the dead band beside the series' own.
    deadband: f64,
    load_change: f64,
    readings: Vec<PairReading>,
}

#[derive(Debug, Clone)]
struct PairReading {
    noise: f64,
    baseline: Vec<f64>,
    present: Vec<f64>,
}

impl Pair {
    fn comparison(&self, level: usize, knows_load: bool) -> Comparison<'_> {
        let reading = &self.readings[level];
        Comparison {
            baseline: &reading.baseline,
            present: &reading.present,
            load_change: knows_load.then_some(self.load_change),
            noise: reading.noise,
        }
    }
}

/// Levels of noise at which intervals are calibrated; between them they are interpolated.
pub(crate) const CALIBRATED_NOISE: [f64; 5] = NOISE_LEVELS;

/// Levels of noise at which machines are read: drawn anew for each machine, or these.
#[derive(Debug, Clone, Copy)]
enum Levels<'a> {
    Drawn((f64, f64)),
    These(&'a [f64]),
}

/// A level of noise, and the cycle's mean command by phase at it.
type Leveled = (f64, Vec<f64>);

/// Machines with so many cycles each beside the baseline.
struct PairSet<'a> {
    machines: usize,
    cycles: usize,
    /// Its random streams.
    purpose: u64,
    conditions: Conditions,
    levels: Levels<'a>,
    /// The leak at a rank of 0 … 1, m².
    leak_at: fn(LeakRange, f64) -> f64,
}

impl<'a> PairSet<'a> {
    fn new(
        settings: &TrainingSettings,
        machines: usize,
        cycles: usize,
        purpose: u64,
        levels: Levels<'a>,
    ) -> Self {
        let conditions = settings.conditions.clone();
        PairSet { machines, cycles, purpose, conditions, levels, leak_at }
    }

    fn learned(settings: &TrainingSettings) -> Self {
        let levels = Levels::Drawn(settings.noise);
        let set = PairSet::new(settings, settings.relative_machines, LEARNED_CYCLES, purpose::LEARN, levels);
        PairSet { conditions: settings.conditions.of_orifices(), ..set }
    }

    fn calibrating(settings: &TrainingSettings) -> Self {
        let levels = Levels::These(&CALIBRATED_AND_QUIET);
        PairSet::new(settings, settings.calibrated_on, CALIBRATED_CYCLES, purpose::CALIBRATE, levels)
    }

    fn beyond(settings: &TrainingSettings) -> Self {
        let levels = Levels::Drawn(settings.noise);
        let set = PairSet::new(settings, BEYOND_MACHINES, 1, purpose::BEYOND, levels);
        PairSet { leak_at: LeakRange::beyond_m2, ..set }
    }

    fn tested(settings: &TrainingSettings) -> Self {
        PairSet::new(settings, settings.tested_on, 1, purpose::TEST, Levels::These(&NOISE_LEVELS))
    }

    /// A machine's random stream.
    fn stream(&self, machine: usize) -> u64 {
        (self.purpose << 32) + machine as u64
    }
}

/// Simulates pairs of a baseline and a later cycle of the same machine.
struct PairSimulator<'a> {
    spec: &'a MachineSpec,
    settings: &'a TrainingSettings,
    reading: &'a Reading<'a>,
}

impl PairSimulator<'_> {
    /// Leaks are stratified over all pairs of a set. Portions that are not to be simulated here are left out.
    fn pairs(
        &self,
        set: &PairSet<'_>,
        portions: &mut Portions,
        tell: &mut dyn FnMut(usize),
    ) -> Result<Vec<Pair>, TrainError> {
        let &PairSet { machines, cycles, purpose, levels, leak_at, .. } = set;
        let per_machine = BASELINE_MOMENTS + cycles;
        let leaks = self.settings.leaks_of(self.spec);
        let mut pairs = Vec::with_capacity(machines * cycles);
        let portion = 256 / per_machine;
        for from in (0..machines).step_by(portion) {
            let to = machines.min(from + portion);
            let mut observations = Vec::with_capacity(portion * per_machine);
            let mut loads = Vec::with_capacity(portion * per_machine);
            for machine in from..to {
                let leak_of = |cycle: usize, within: f64| {
                    let rank = ((machine * cycles + cycle) as f64 + within) / (machines * cycles) as f64;
                    // Neighbouring machines have leaks far apart: a portion of machines is a sample of all.
                    leak_at(leaks, (rank * SCATTER).fract())
                };
                self.days_of(set, machine, &leak_of, &mut |observation, load| {
                    observations.push(observation);
                    loads.push(load);
                });
            }
            let read = portions.take(&format!("pairs {purpose} {from}"), || {
                simulate_stably(&observations, |index, observation, commands| {
                    self.read(observation, commands, index % per_machine < BASELINE_MOMENTS, levels)
                })
            })?;
            let read = read.unwrap_or_default();
            for (machine, group) in read.chunks(per_machine).enumerate() {
                let (moments, days) = group.split_at(BASELINE_MOMENTS.min(group.len()));
                let Some(baseline) = mean_of(moments) else { continue };
                let stream = set.stream(from + machine);
                for (cycle, present) in days.iter().enumerate() {
                    let at = machine * per_machine + BASELINE_MOMENTS + cycle;
                    let Some(present) = present else { continue };
                    pairs.push(Pair {
                        leak_area_m2: observations[at].leak_area_m2,
                        deadband: observations[at].extra_deadband,
                        load_change: loads[at] - 1.0,
                        readings: baseline
                            .iter()
                            .zip(present)
                            .map(|(baseline, (noise, present))| PairReading {
                                noise: *noise,
                                baseline: baseline.clone(),
                                present: self.as_the_machine_answers(stream, baseline, present),
                            })
                            .collect(),
                    });
                }
            }
            tell(to);
        }
        Ok(pairs)
    }

    /// A later cycle's means with the machine's own error.
    fn as_the_machine_answers(&self, stream: u64, baseline: &[f64], present: &[f64]) -> Vec<f64> {
        let mut present = present.to_vec();
        let share = self.settings.conditions.response_error;
        if share > 0.0 {
            let mut noise = Noise::new(self.settings.seed ^ 0x0072_6573_706f_6e64, stream);
            response_error::put_on(&mut present, baseline, share, &mut noise);
        }
        present
    }

    /// A machine's cycles with their loads: those of its baseline, then others. `leak_of` has the leak of a cycle and a number in 0 … 1.
    fn days_of(
        &self,
        set: &PairSet<'_>,
        machine: usize,
        leak_of: &dyn Fn(usize, f64) -> f64,
        take: &mut dyn FnMut(Observation, f64),
    ) {
        let (stream, conditions) = (set.stream(machine), &set.conditions);
        let mut noise = Noise::new(self.settings.seed, stream);
        let series = conditions.machine(self.spec, &mut noise);
        let oil_c = |noise: &mut Noise| noise.uniform(conditions.oil_c.0, conditions.oil_c.1);
        let (begins_c, ends_c) = (oil_c(&mut noise), oil_c(&mut noise));
        for cycle in 0..BASELINE_MOMENTS + set.cycles {
            let mut load = 1.0; // The baseline's loads average out.
            let mut today = if let Some(moment) = MOMENTS.get(cycle) {
                Conditions::on_a_day(&series, load, begins_c + moment * (ends_c - begins_c), 1.0)
            } else {
                load = noise.factor(conditions.load);
                let supply = noise.factor(conditions.supply);
                let mut today = Conditions::on_a_day(&series, load, oil_c(&mut noise), supply);
                today.leak_area_m2 = leak_of(cycle - BASELINE_MOMENTS, noise.uniform(0.0, 1.0));
                today
            };
            today.stream = stream * 64 + cycle as u64;
            take(today, load);
        }
    }

    /// The cycle's mean command by phase at each level of noise.
    fn read(
        &self,
        observation: &Observation,
        commands: &[f64],
        is_baseline: bool,
        levels: Levels<'_>,
    ) -> Option<Vec<Leveled>> {
        // All cycles of a machine have the same sensor.
        let mut of_machine = Noise::new(self.settings.seed ^ 0x7365_6e73, observation.stream / 64);
        let drawn;
        let levels = match levels {
            Levels::These(levels) => levels,
            Levels::Drawn((low, high)) => {
                drawn = [low * libm::pow(high / low, of_machine.uniform(0.0, 1.0))];
                &drawn
            }
        };
        let averaged = if is_baseline { (BASELINE_CYCLES / BASELINE_MOMENTS) as f64 } else { 1.0 };
        let mut noise = Noise::new(self.settings.seed ^ 0x006e_6f69_7365, observation.stream);
        let unit = dataset::unit_noise(&mut noise, commands.len());
        levels
            .iter()
            .map(|level| {
                let sigma = level / averaged.sqrt();
                let statistics = self.reading.read(commands, self.settings.filter, sigma, &unit)?;
                Some((*level, self.phase_means(&statistics)))
            })
            .collect()
    }

    fn phase_means(&self, statistics: &CycleStatistics) -> Vec<f64> {
        statistics.phase_means()[..self.reading.phases.len()].to_vec()
    }
}

/// Simulates with as many steps as each machine needs: warm oil makes the line stiffer. Machines that run side by side in lanes take
/// their steps together, so that those that need as many are put together.
pub(crate) fn simulate_stably<R: Send>(
    observations: &[Observation],
    reduce: impl Fn(usize, &Observation, &[f64]) -> R + Sync,
) -> Vec<R> {
    let steps: Vec<usize> = observations.iter().map(|observation| observation.spec.stable_steps()).collect();
    let mut order: Vec<usize> = (0..observations.len()).collect();
    // Nor does a machine without effects wait for the laws of one that has some.
    order.sort_by_key(|index| (steps[*index], observations[*index].spec.effects.len()));
    let mut ordered: Vec<Observation> = order.iter().map(|index| observations[*index].clone()).collect();
    for (lanes, places) in ordered.chunks_mut(LANES).zip(order.chunks(LANES)) {
        let most = places.iter().map(|index| steps[*index]).max().unwrap_or(1);
        for observation in lanes {
            observation.spec.controller.steps_per_period = most;
        }
    }
    let results = dataset::simulate(&ordered, |place, commands| {
        reduce(order[place], &observations[order[place]], commands)
    });
    let mut numbered: Vec<(usize, R)> = order.into_iter().zip(results).collect();
    numbered.sort_by_key(|(index, _)| *index);
    numbered.into_iter().map(|(_, result)| result).collect()
}

/// The baseline at each level of noise, from its moments; `None` where one of them was not found.
fn mean_of(moments: &[Option<Vec<Leveled>>]) -> Option<Vec<Vec<f64>>> {
    let moments: Vec<&Vec<Leveled>> = moments.iter().map(Option::as_ref).collect::<Option<_>>()?;
    let first = moments.first()?;
    let mean = |level: usize, phase: usize| {
        moments.iter().map(|moment| moment[level].1[phase]).sum::<f64>() / moments.len() as f64
    };
    Some(
        first
            .iter()
            .enumerate()
            .map(|(level, (_, means))| (0..means.len()).map(|phase| mean(level, phase)).collect())
            .collect(),
    )
}

/// Scatters ranks: far from every simple fraction.
const SCATTER: f64 = 610.618_033_988_75;

/// What is worth knowing of relative estimates on machines not used for anything else.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RelativeReport {
    /// Machines that were tested.
    pub machines: usize,
    /// Machines that calibrated the intervals.
    pub calibrated_on: usize,
    /// With the command alone, by noise.
    pub command: Vec<RelativeAccuracy>,
    /// With the load too.
    pub load: Vec<RelativeAccuracy>,
}

/// Accuracy at one noise level.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RelativeAccuracy {
    /// Standard deviation of the command's noise.
    pub noise: f64,
    /// Median relative error of areas above 1 L/min at 7 MPa.
    pub median_error_above_1_lpm: f64,
    /// Share of leaks in the main range whose truth lies within the 90 % interval.
    pub coverage: f64,
    /// The same and the median relative error for 5e-8 … 1e-7 … 1e-6 … 1e-5 m².
    pub decades: Vec<Decade>,
    /// Standard deviation of the leak residual of machines without a leak, m².
    pub healthy_deviation_m2: f64,
    /// Share of machines without a leak whose interval begins above 0.
    pub healthy_above_0: f64,
    /// Share of cycles whose out-of-distribution score exceeds 1.
    #[serde(rename = "novel")]
    pub out_of_distribution: f64,
}

/// The polynomials of the leak residual.
struct ResidualFit {
    /// Offset of the logarithm, m²: below it errors count absolutely.
    offset_m2: f64,
    baseline_mean: Vec<f64>,
    baseline_scale: Vec<f64>,
    /// Coefficients with the command alone, and with the load too.
    coefficients: [Vec<f64>; 2],
}

impl ResidualFit {
    fn of(pairs: &[Pair], offset_m2: f64) -> Option<Self> {
        let (baseline_mean, baseline_scale) = spread_of_baselines(pairs);
        let mut coefficients = [Vec::new(), Vec::new()];
        for (knows_load, coefficients) in [false, true].into_iter().zip(&mut coefficients) {
            *coefficients =
                fit_leak_residual(pairs, (&baseline_mean, &baseline_scale), knows_load, offset_m2)?;
        }
        Some(ResidualFit { offset_m2, baseline_mean, baseline_scale, coefficients })
    }

    fn inputs(&self, comparison: &Comparison<'_>) -> Inputs {
        Inputs::standardised(&self.baseline_mean, &self.baseline_scale, comparison)
    }

    fn leak_residual_m2(&self, comparison: &Comparison<'_>) -> f64 {
        let coefficients = &self.coefficients[usize::from(comparison.load_change.is_some())];
        self.inputs(comparison).leak_residual(coefficients, &mut [0.0; MAX_CHANGES])
    }

    /// Trees on both views of all pairs: the correction is about the same.
    fn grow(&self, pairs: &[Pair], seed: u64) -> Forest {
        let phases = self.baseline_mean.len();
        let mut table = Table { columns: vec![Vec::new(); Inputs::tree_inputs(phases)], target: Vec::new() };
        for knows_load in [false, true] {
            for pair in pairs {
                let comparison = pair.comparison(0, knows_load);
                let logarithm = log_leak_residual(self.leak_residual_m2(&comparison), self.offset_m2);
                let inputs = self.inputs(&comparison).of_trees(logarithm);
                for (column, value) in table.columns.iter_mut().zip(inputs) {
                    column.push(value);
                }
                table.target.push(libm::log(pair.leak_area_m2 + self.offset_m2) - logarithm);
            }
        }
        Forest::grow(&table, FOREST_PARAMS, seed)
    }
}

/// What is learned before it is calibrated.
struct Learned {
    residual: ResidualFit,
    deadband: DeadbandFile,
    trees: Vec<Tree>,
    ensemble: Ensemble,
}

impl Learned {
    fn from(pairs: &[Pair], offset_m2: f64, seed: u64) -> Option<Self> {
        let residual = ResidualFit::of(pairs, offset_m2)?;
        let deadband = fit_deadband(pairs, &residual.baseline_mean, &residual.baseline_scale)?;
        let trees = residual.grow(pairs, seed).trees;
        let ensemble = Ensemble::new(&trees, Inputs::tree_inputs(residual.baseline_mean.len())).ok()?;
        Some(Learned { residual, deadband, trees, ensemble })
    }

    fn predict(&self, pair: &Pair, level: usize, knows_load: bool) -> Prediction {
        let comparison = pair.comparison(level, knows_load);
        let logarithm =
            log_leak_residual(self.residual.leak_residual_m2(&comparison), self.residual.offset_m2);
        let (mean, spread) = self.ensemble.vote(&self.residual.inputs(&comparison).of_trees(logarithm));
        let truth = libm::log(pair.leak_area_m2 + self.residual.offset_m2);
        Prediction { truth, mean: logarithm + mean, spread }
    }

    /// Calibrates a view; the last of the pairs' readings is without noise.
    fn view(&self, pairs: &[Pair], knows_load: bool) -> ViewFile {
        let is_plain = |pair: &&Pair| self.half_width(pair, QUIET) <= self.deadband.limit;
        let (plain, others): (Vec<&Pair>, Vec<&Pair>) = pairs.iter().partition(is_plain);
        let all: Vec<&Pair> = pairs.iter().collect();
        let kind = |pairs: Vec<&Pair>| {
            self.kind(if pairs.len() < LEAST_OF_A_KIND { &all } else { &pairs }, knows_load)
        };
        let leak_residual = self.residual.coefficients[usize::from(knows_load)].clone();
        ViewFile { leak_residual, plain: kind(plain), deadband: kind(others) }
    }

    fn kind(&self, pairs: &[&Pair], knows_load: bool) -> KindFile {
        let by_noise: Vec<(f64, Vec<Prediction>)> = CALIBRATED_NOISE
            .iter()
            .enumerate()
            .map(|(level, noise)| {
                let leaking = pairs.iter().filter(|pair| pair.leak_area_m2 > 0.0);
                (*noise, leaking.map(|pair| self.predict(pair, level, knows_load)).collect())
            })
            .collect();
        let healthy = || pairs.iter().filter(|pair| pair.leak_area_m2 == 0.0);
        let estimates = healthy().flat_map(|pair| {
            (0..CALIBRATED_NOISE.len())
                .map(|level| libm::exp(self.predict(pair, level, knows_load).mean) - self.residual.offset_m2)
        });
        let calibration = conformal::calibration(&by_noise, estimates);
        let residuals =
            healthy().map(|pair| self.residual.leak_residual_m2(&pair.comparison(QUIET, knows_load)).abs());
        KindFile { calibration, reference_m2: significant(residuals.fold(0.0, f64::max)) }
    }

    /// Half width of the dead band that the pair's baseline shows.
    fn half_width(&self, pair: &Pair, level: usize) -> f64 {
        let baseline = &pair.readings[level].baseline;
        half_width(
            &self.deadband,
            &standardised(baseline, &self.residual.baseline_mean, &self.residual.baseline_scale),
        )
    }

    /// Sets the limit above which a baseline shows a dead band, from machines without one.
    fn limit_deadband(&mut self, pairs: &[Pair]) {
        let plain = pairs.iter().filter(|pair| pair.deadband == 0.0);
        let shown = plain.flat_map(|pair| (0..pair.readings.len()).map(|level| self.half_width(pair, level)));
        self.deadband.limit = significant(DEADBAND_ROOM * shown.fold(0.0, f64::max));
    }

    fn distributions(&self, learned: [&[Pair]; 2], others: &[Pair]) -> Option<Vec<TrainingDistribution>> {
        let row = |pair: &Pair, level: usize| {
            let reading = &pair.readings[level];
            let changes = reading.present.iter().zip(&reading.baseline).map(|(now, before)| now - before);
            (self.predict(pair, level, false).mean, changes.collect())
        };
        let learned = learned.into_iter().flatten().map(|pair| row(pair, 0)).collect();
        let others =
            others.iter().flat_map(|pair| (0..CALIBRATED_NOISE.len()).map(move |level| row(pair, level)));
        out_of_distribution::describe(learned, others)
    }
}

/// Index of the reading without noise, after those of [`CALIBRATED_NOISE`].
const QUIET: usize = CALIBRATED_NOISE.len();

/// [`CALIBRATED_NOISE`], and none.
const CALIBRATED_AND_QUIET: [f64; QUIET + 1] = {
    let mut levels = [0.0; QUIET + 1];
    let mut level = 0;
    while level < QUIET {
        levels[level] = CALIBRATED_NOISE[level];
        level += 1;
    }
    levels
};

fn spread_of_baselines(pairs: &[Pair]) -> (Vec<f64>, Vec<f64>) {
    let phases = pairs.first().map_or(0, |pair| pair.readings[0].baseline.len());
    let count = pairs.len().max(1) as f64;
    let baselines: Vec<_> = pairs.iter().map(|pair| centred(&pair.readings[0].baseline)).collect();
    let mean: Vec<f64> =
        (0..phases).map(|i| baselines.iter().map(|baseline| baseline[i]).sum::<f64>() / count).collect();
    let scale = (0..phases)
        .map(|i| {
            let square: f64 = baselines.iter().map(|baseline| (baseline[i] - mean[i]).powi(2)).sum();
            (square / count).sqrt().max(1e-6)
        })
        .collect();
    (mean, scale)
}

/// Regression of the dead band on the standardised baseline; `None` where the means are not finite.
fn fit_deadband(pairs: &[Pair], mean: &[f64], scale: &[f64]) -> Option<DeadbandFile> {
    let terms = mean.len() + 1;
    let row_of = |pair: &Pair| {
        let standardised = standardised(&pair.readings[0].baseline, mean, scale);
        let mut row = vec![1.0];
        row.extend(&standardised[..mean.len()]);
        row
    };
    let rows: Vec<Vec<f64>> = pairs.iter().map(row_of).collect();
    let sum = |of: &dyn Fn(&[f64], &Pair) -> f64| {
        rows.iter().zip(pairs).map(|(row, pair)| of(row, pair)).sum::<f64>() / pairs.len() as f64
    };
    let factor = linear::cholesky(terms, |i, j| {
        sum(&|row, _| row[i] * row[j]) + if i == j { DEADBAND_RIDGE } else { 0.0 }
    })?;
    let right = (0..terms).map(|i| sum(&|row, pair| row[i] * pair.deadband)).collect();
    let solution = linear::solve(&factor, right);
    Some(DeadbandFile { intercept: solution[0], slopes: solution[1..].to_vec(), limit: 0.0 })
}

/// Ridge regression of the leak area on the leak residual's terms; errors count relative to area + offset. `None` where the terms are not
/// finite.
fn fit_leak_residual(
    pairs: &[Pair],
    (mean, scale): (&[f64], &[f64]),
    knows_load: bool,
    offset_m2: f64,
) -> Option<Vec<f64>> {
    let terms = Inputs::terms(mean.len(), knows_load);
    let rows: Vec<Vec<f64>> = pairs
        .iter()
        .map(|pair| {
            let mut row = Vec::with_capacity(terms);
            Inputs::standardised(mean, scale, &pair.comparison(0, knows_load))
                .each_term(|term, _| row.push(term));
            row
        })
        .collect();
    let size: Vec<f64> = (0..terms)
        .map(|i| (rows.iter().map(|row| row[i] * row[i]).sum::<f64>() / rows.len() as f64).sqrt().max(1e-30))
        .collect();
    let mut normal = vec![0.0; terms * (terms + 1) / 2];
    let mut right = vec![0.0; terms];
    let mut weights = 0.0;
    for (row, pair) in rows.iter().zip(pairs) {
        let weight = (pair.leak_area_m2 + offset_m2).powi(-2);
        weights += weight;
        let scaled: Vec<f64> = row.iter().zip(&size).map(|(term, size)| term / size).collect();
        for i in 0..terms {
            let (start, factor) = (i * (i + 1) / 2, weight * scaled[i]);
            for (sum, value) in normal[start..].iter_mut().zip(&scaled[..=i]) {
                *sum += factor * value;
            }
            right[i] += factor * pair.leak_area_m2;
        }
    }
    let factor = linear::cholesky(terms, |i, j| {
        normal[i * (i + 1) / 2 + j] + if i == j { RIDGE * weights } else { 0.0 }
    })?;
    let solution = linear::solve(&factor, right);
    Some(solution.iter().zip(&size).map(|(coefficient, size)| coefficient / size).collect())
}

/// Cycles between false alarms of a one-sided cumulative sum whose input lies the allowance below 0, in standard deviations
/// (Siegmund, "Sequential Analysis", Springer (1985), with his correction for the overshoot).
pub fn cycles_between_false_alarms(threshold: f64, allowance: f64) -> f64 {
    let height = threshold + 1.166;
    let exponent = 2.0 * allowance * height;
    (exponent.exp() - exponent - 1.0) / (2.0 * allowance * allowance)
}

/// Learns and calibrates; `None` where the simulated cycles were not found or carry no information. `tell` hears of the machines done and
/// all.
///
/// # Errors
/// [`TrainError`] for a portion that is damaged.
pub(crate) fn learn(
    spec: &MachineSpec,
    settings: &TrainingSettings,
    reading: &Reading<'_>,
    portions: &mut Portions,
    tell: &mut dyn FnMut(usize, usize),
) -> Result<Option<RelativeFile>, TrainError> {
    let simulator = PairSimulator { spec, settings, reading };
    let all = settings.relative_machines + settings.calibrated_on;
    let pairs = simulator.pairs(&PairSet::learned(settings), portions, &mut |done| tell(done, all))?;
    let others = simulator.pairs(&PairSet::calibrating(settings), portions, &mut |done| {
        tell(settings.relative_machines + done, all);
    })?;
    let beyond = simulator.pairs(&PairSet::beyond(settings), portions, &mut |_| ())?;
    Ok(learn_from(spec, settings, [&pairs, &others, &beyond]))
}

/// Simulates what [`learn`] and [`measure`] need, as far as it is to be simulated here.
///
/// # Errors
/// [`TrainError`] for a portion that cannot be written.
pub(crate) fn simulate(
    spec: &MachineSpec,
    settings: &TrainingSettings,
    reading: &Reading<'_>,
    portions: &mut Portions,
    tell: &mut dyn FnMut(usize, usize),
) -> Result<(), TrainError> {
    let simulator = PairSimulator { spec, settings, reading };
    let sets =
        [PairSet::learned, PairSet::calibrating, PairSet::beyond, PairSet::tested].map(|set| set(settings));
    let all = sets.iter().map(|set| set.machines).sum();
    let mut before = 0;
    for set in &sets {
        simulator.pairs(set, portions, &mut |done| tell(before + done, all))?;
        before += set.machines;
    }
    Ok(())
}

fn learn_from(
    spec: &MachineSpec,
    settings: &TrainingSettings,
    [pairs, others, beyond]: [&[Pair]; 3],
) -> Option<RelativeFile> {
    let offset_m2 = LeakRange::of(spec).offset_m2();
    let mut learned = Learned::from(pairs, offset_m2, settings.seed)?;
    learned.limit_deadband(others);
    let mut file = RelativeFile {
        offset_m2,
        command: learned.view(others, false),
        load: learned.view(others, true),
        training_distributions: learned.distributions([pairs, beyond], others)?,
        largest_load_change: LOAD_ROOM * settings.conditions.load.max(0.01),
        detection: DetectionFile {
            threshold: THRESHOLD,
            cycles_between_false_alarms: significant(cycles_between_false_alarms(THRESHOLD, DRIFT_ALLOWANCE)),
        },
        piston_areas_m2: [spec.plant.cap_area_m2, spec.plant.annulus_area_m2],
        baseline_mean: learned.residual.baseline_mean,
        baseline_scale: learned.residual.baseline_scale,
        deadband: learned.deadband,
        trees: learned.trees,
        golden: Vec::new(),
    };
    file.golden = golden(&file, others)?;
    Some(file)
}

fn golden(file: &RelativeFile, pairs: &[Pair]) -> Option<Vec<RelativeGolden>> {
    let relative = seepd_model::Relative::from_file(file.clone()).ok()?;
    let chosen = pairs.iter().step_by((pairs.len() / GOLDEN).max(1)).take(GOLDEN).enumerate();
    let of = |(index, pair): (usize, &Pair)| {
        let comparison = pair.comparison(index % CALIBRATED_NOISE.len(), index % 2 == 1);
        let given = relative.estimate(&comparison);
        RelativeGolden {
            baseline: comparison.baseline.to_vec(),
            present: comparison.present.to_vec(),
            load_change: comparison.load_change,
            noise: comparison.noise,
            estimate: given.estimate.value,
            interval: given.estimate.interval,
            leak_residual: given.leak_residual_m2,
        }
    };
    Some(chosen.map(of).collect())
}

/// Flow of 1 L/min at the reference pressure difference of 7 MPa as an area, m².
fn one_lpm_m2(file: &ModelFile) -> f64 {
    let orifice = &file.orifice;
    1.0 / 60_000.0 / (orifice.discharge_coefficient * (2.0 * 7e6 / orifice.density_kg_per_m3).sqrt())
}

/// Measures a model's relative estimates on machines that nothing was learned from.
///
/// # Errors
/// [`TrainError::Model`] where the model's relative part is damaged, [`TrainError::Share`] for a portion that is.
pub(crate) fn measure(
    spec: &MachineSpec,
    settings: &TrainingSettings,
    reading: &Reading<'_>,
    (file, relative): (&ModelFile, RelativeFile),
    portions: &mut Portions,
    tell: &mut dyn FnMut(usize, usize),
) -> Result<RelativeReport, TrainError> {
    let relative = seepd_model::Relative::from_file(relative).map_err(TrainError::Model)?;
    let simulator = PairSimulator { spec, settings, reading };
    let pairs = simulator.pairs(&PairSet::tested(settings), portions, &mut |done| {
        tell(done, settings.tested_on);
    })?;
    let smallest_m2 = LeakRange::of(spec).main_m2().0;
    let accuracy = |knows_load: bool| -> Vec<RelativeAccuracy> {
        (0..NOISE_LEVELS.len())
            .map(|level| {
                let results: Vec<_> = pairs
                    .iter()
                    .map(|pair| (pair.leak_area_m2, relative.estimate(&pair.comparison(level, knows_load))))
                    .collect();
                accuracy_of(NOISE_LEVELS[level], &results, (one_lpm_m2(file), smallest_m2))
            })
            .collect()
    };
    Ok(RelativeReport {
        machines: pairs.len(),
        calibrated_on: settings.calibrated_on,
        command: accuracy(false),
        load: accuracy(true),
    })
}

fn accuracy_of(
    noise: f64,
    results: &[(f64, seepd_model::RelativeEstimate)],
    (one_lpm_m2, smallest_m2): (f64, f64),
) -> RelativeAccuracy {
    let cases: Vec<Judged> =
        results.iter().map(|(truth, given)| Judged::new(*truth, &given.estimate)).collect();
    let healthy: Vec<&seepd_model::RelativeEstimate> =
        results.iter().filter(|(truth, _)| *truth == 0.0).map(|(_, given)| given).collect();
    let count = healthy.len().max(1) as f64;
    let large = cases.iter().filter(|case| case.truth_m2 >= one_lpm_m2);
    RelativeAccuracy {
        noise,
        median_error_above_1_lpm: median_relative_error(large),
        coverage: coverage(cases.iter().filter(|case| case.truth_m2 >= smallest_m2)),
        decades: decades(&cases),
        healthy_deviation_m2: (healthy.iter().map(|e| e.leak_residual_m2.powi(2)).sum::<f64>() / count)
            .sqrt(),
        healthy_above_0: healthy.iter().filter(|e| e.estimate.interval[0] > 0.0).count() as f64 / count,
        out_of_distribution: results.iter().filter(|(_, given)| given.out_of_distribution.score > 1.0).count()
            as f64
            / results.len().max(1) as f64,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The comparison with a baseline is learned from orifices alone, and calibrated and tested on seals of every law.
    #[test]
    fn the_comparison_is_learned_from_orifices() {
        let conditions = Conditions { unknown_seal: true, ..Conditions::default() };
        let settings = TrainingSettings { conditions, ..TrainingSettings::default() };
        let knows = |set: PairSet<'_>| set.conditions.unknown_seal;
        assert!(!knows(PairSet::learned(&settings)));
        for set in [PairSet::calibrating(&settings), PairSet::beyond(&settings), PairSet::tested(&settings)] {
            assert!(knows(set));
        }
    }
}

//! Fitting a machine's parameters to a record: Levenberg–Marquardt with priors and bounds, derivatives by simulation.
//!
//! Levenberg, Quarterly of Applied Mathematics 2 (1944); Marquardt, SIAM Journal 11 (1963). A library's solver would ask for one
//! simulation at a time; here a Jacobian, and the steps of several dampings, are simulated side by side.

use nalgebra::{DMatrix, DVector};
use seepd_sim::MachineSpec;
use seepd_sim::cycle::Instant;
use seepd_sim::effects::Effect;
use seepd_sim::real::LANES;

use crate::record::{BINS, Record};
use crate::simulate::{View, views};

/// Independent values that a signal is taken to have in a cycle: model errors are alike over a twentieth of a cycle or so, and each bin
/// counted by itself would be certain of anything.
pub const INDEPENDENT: f64 = 60.0;
/// Error that any model of a machine has, share of a signal's range: differences below it are no gap.
pub const MODEL_ERROR: f64 = 0.002;
/// Largest leak that is fitted, m².
const LARGEST_LEAK_M2: f64 = 3e-5;
/// Unit of the leak in the fit, m².
const LEAK_UNIT_M2: f64 = 1e-7;

/// What a free parameter is.
#[derive(Clone, Copy)]
pub enum Target {
    /// A parameter of the plant.
    Plant(&'static str),
    /// The leak area.
    Leak,
    /// A parameter of an effect.
    Effect(&'static dyn Effect, usize),
}

/// A free parameter, in the fit's own coordinate.
#[derive(Clone, Copy)]
pub struct Free {
    /// What it is.
    pub target: Target,
    logarithmic: bool,
    /// Value of 1 in the coordinate, where it is linear.
    unit: f64,
    low: f64,
    high: f64,
    /// Centre and standard deviation, in the coordinate.
    prior: Option<(f64, f64)>,
}

/// A plant parameter that may be retuned: bounds as factors and a prior as a standard deviation of the logarithm.
struct Tunable {
    key: &'static str,
    low: f64,
    high: f64,
    sigma: f64,
}

/// What retuning may change and how far; 15 % where data sheets are good, a factor of 2 where they are not.
const TUNABLE: &[Tunable] = &[
    Tunable { key: "valve_m3_per_s_sqrt_pa", low: 0.5, high: 2.0, sigma: 0.15 },
    Tunable { key: "viscous_friction_n_s_per_m", low: 0.25, high: 4.0, sigma: std::f64::consts::LN_2 },
    Tunable { key: "mass_kg", low: 0.25, high: 4.0, sigma: std::f64::consts::LN_2 },
    Tunable { key: "pump_flow_m3_per_s", low: 0.5, high: 2.0, sigma: std::f64::consts::LN_2 },
    Tunable { key: "relief_pressure_pa", low: 0.5, high: 1.2, sigma: 0.15 },
    Tunable { key: "relief_resistance_pa_s_per_m3", low: 0.5, high: 2.0, sigma: std::f64::consts::LN_2 },
    Tunable { key: "bulk_modulus_pa", low: 0.5, high: 2.0, sigma: 0.15 },
    Tunable { key: "line_m3_per_s_sqrt_pa", low: 0.5, high: 2.0, sigma: 0.15 },
    Tunable { key: "seal_resistance_pa_s_per_m3", low: 1.0 / 3.0, high: 3.0, sigma: std::f64::consts::LN_2 },
    Tunable { key: "load_scale", low: 0.7, high: 1.3, sigma: std::f64::consts::LN_2 },
];
/// The return pressure is retuned by addition: largest value, and standard deviation, Pa.
const RETURN_PRESSURE_PA: (f64, f64) = (2.5e6, 2e5);

/// The leak alone.
pub fn leak_only() -> Vec<Free> {
    vec![Free {
        target: Target::Leak,
        logarithmic: false,
        unit: LEAK_UNIT_M2,
        low: 0.0,
        high: LARGEST_LEAK_M2 / LEAK_UNIT_M2,
        prior: None,
    }]
}

/// The leak and every plant parameter that may be retuned.
pub fn retunable(spec: &MachineSpec) -> Vec<Free> {
    let mut free = leak_only();
    for tunable in TUNABLE {
        let Some(nominal) = spec.plant.get(tunable.key).filter(|value| *value > 0.0) else { continue };
        let centre = nominal.ln();
        free.push(Free {
            target: Target::Plant(tunable.key),
            logarithmic: true,
            unit: 1.0,
            low: centre + tunable.low.ln(),
            high: centre + tunable.high.ln(),
            prior: Some((centre, tunable.sigma)),
        });
    }
    let (most, sigma) = RETURN_PRESSURE_PA;
    let centre = spec.plant.return_pressure_pa / sigma;
    free.push(Free {
        target: Target::Plant("return_pressure_pa"),
        logarithmic: false,
        unit: sigma,
        low: 0.0,
        high: most / sigma,
        prior: Some((centre, 1.0)),
    });
    free
}

/// An effect's parameters.
pub fn of_effect(effect: &'static dyn Effect, spec: &MachineSpec) -> Vec<Free> {
    let of = |(index, parameter): (usize, &seepd_sim::effects::Parameter)| {
        let (low, high) = range_of(parameter, spec);
        let unit = 0.2 * (high - low);
        Free {
            target: Target::Effect(effect, index),
            logarithmic: false,
            unit,
            low: low / unit,
            high: high / unit,
            prior: None,
        }
    };
    // A factor on a gain of 0 is none.
    let acts = |parameter: &seepd_sim::effects::Parameter| {
        !(effect.key() == "controller_gains" && parameter.name == "kd" && spec.controller.kd == 0.0)
    };
    effect.parameters().iter().enumerate().filter(|(_, parameter)| acts(parameter)).map(of).collect()
}

/// A parameter's range on this machine: times end with the cycle, places with the stroke.
pub(crate) fn range_of(parameter: &seepd_sim::effects::Parameter, spec: &MachineSpec) -> (f64, f64) {
    let (low, high) = parameter.range;
    match parameter.name {
        "start_s" | "duration_s" => (low, high.min(spec.cycle.period_s)),
        "neutral_position_m" => (low, spec.plant.stroke_m),
        _ => (low, high),
    }
}

impl Free {
    /// The coordinate of a machine's value.
    pub fn read(&self, spec: &MachineSpec) -> f64 {
        let value = match self.target {
            Target::Plant(key) => spec.plant.get(key).unwrap_or(f64::NAN),
            Target::Leak => spec.plant.leak_area_m2,
            Target::Effect(effect, index) => spec.effect_values(effect)[index],
        };
        let coordinate = if self.logarithmic { value.ln() } else { value / self.unit };
        coordinate.clamp(self.low, self.high)
    }

    /// The value at a coordinate.
    pub fn value(&self, coordinate: f64) -> f64 {
        if self.logarithmic { coordinate.exp() } else { coordinate * self.unit }
    }

    fn write(&self, coordinate: f64, spec: &mut MachineSpec) {
        let value = self.value(coordinate);
        match self.target {
            Target::Plant(key) => {
                if let Some(slot) = spec.plant.get_mut(key) {
                    *slot = value;
                }
            }
            Target::Leak => spec.plant.leak_area_m2 = value,
            Target::Effect(effect, index) => {
                let name = effect.parameters()[index].name;
                spec.effects.entry(effect.key().into()).or_default().insert(name.into(), value);
            }
        }
    }

    /// Step of the derivative, towards the inside of the bounds.
    fn step(&self, coordinate: f64) -> f64 {
        let step = if self.logarithmic { 2e-3 } else { 2e-3 * (self.high - self.low).min(5.0) };
        if coordinate + step > self.high { -step } else { step }
    }
}

/// What is fitted to: drives with what the machine showed along each.
pub struct Problem<'r> {
    /// The record.
    pub record: &'r Record,
    drives: Vec<Vec<Instant>>,
    shown: Vec<View>,
    /// One over the expected error of each signal, with the square root of the share that a bin counts.
    weights: Vec<f64>,
}

/// Difference of drives from cycle to cycle, share of their range, up to which one stands for all.
const SAME_DRIVE: f64 = 0.01;
/// Drives where cycles differ.
const DRIVES: usize = 2;
/// How many times larger errors are allowed while a fit is still far off: strong directions are found first, and weak ones are held by
/// their priors.
const RELAXED: [f64; 2] = [25.0, 5.0];
/// Iterations of a fit with relaxed errors.
const RELAXED_ITERATIONS: usize = 4;

impl<'r> Problem<'r> {
    /// A problem of some of the record's cycles.
    pub fn new(record: &'r Record, cycles: &[usize]) -> Self {
        let (drives, shown) = if same_drive(record, cycles) {
            (vec![mean_drive(record, cycles)], vec![record.mean(cycles)])
        } else {
            let step = cycles.len().div_ceil(DRIVES).max(1);
            let chosen = cycles.iter().step_by(step);
            chosen
                .map(|cycle| (record.cycles[*cycle].drive.clone(), record.cycles[*cycle].bins.clone()))
                .unzip()
        };
        let averaged = if drives.len() == 1 { cycles.len() as f64 } else { 1.0 };
        let bins = (BINS * drives.len()) as f64;
        let weights = (0..record.signals.len())
            .map(|signal| {
                let floor = record.floor[signal] / averaged.sqrt();
                let expected = (floor * floor + MODEL_ERROR * MODEL_ERROR).sqrt() * record.range[signal];
                (INDEPENDENT / bins).sqrt() / expected
            })
            .collect();
        Problem { record, drives, shown, weights }
    }

    /// Weighted differences of simulation and record, one row a machine: by drive, signal, bin.
    pub fn residuals(&self, machines: &[MachineSpec]) -> Vec<DVector<f64>> {
        let length = self.drives.len() * self.record.signals.len() * BINS;
        let mut rows = vec![Vec::with_capacity(length); machines.len()];
        for (drive, shown) in self.drives.iter().zip(&self.shown) {
            for (row, view) in rows.iter_mut().zip(views(machines, drive, &self.record.signals)) {
                for ((simulated, recorded), weight) in view.iter().zip(shown).zip(&self.weights) {
                    row.extend(simulated.iter().zip(recorded).map(|(a, b)| {
                        let difference = (a - b) * weight;
                        // A simulation that went out of bounds is as far off as can be.
                        if difference.is_finite() { difference.clamp(-1e3, 1e3) } else { 1e3 }
                    }));
                }
            }
        }
        rows.into_iter().map(DVector::from_vec).collect()
    }

    /// Mean square of each signal's differences over their expected error.
    pub fn by_signal(&self, residual: &DVector<f64>) -> Vec<f64> {
        let signals = self.record.signals.len();
        let mut sums = vec![0.0; signals];
        for (index, value) in residual.iter().enumerate() {
            sums[index / BINS % signals] += value * value;
        }
        sums.into_iter().map(|sum| sum / INDEPENDENT).collect()
    }
}

fn same_drive(record: &Record, cycles: &[usize]) -> bool {
    let differs = |of: &dyn Fn(&Instant) -> f64| {
        let all = || cycles.iter().flat_map(|cycle| record.cycles[*cycle].drive.iter().step_by(10).map(of));
        let range = all().fold(f64::NEG_INFINITY, f64::max) - all().fold(f64::INFINITY, f64::min);
        let Some(first) = cycles.first().map(|cycle| &record.cycles[*cycle].drive) else { return false };
        cycles.iter().any(|cycle| {
            let pairs = record.cycles[*cycle].drive.iter().zip(first).step_by(10);
            let n = pairs.len().max(1) as f64;
            let square: f64 = pairs.map(|(a, b)| (of(a) - of(b)).powi(2)).sum();
            (square / n).sqrt() > SAME_DRIVE * range
        })
    };
    !differs(&|instant| instant.demand_m) && !differs(&|instant| instant.load_n)
}

fn mean_drive(record: &Record, cycles: &[usize]) -> Vec<Instant> {
    let mut mean = record.cycles[cycles[0]].drive.clone();
    let n = cycles.len() as f64;
    for (tick, instant) in mean.iter_mut().enumerate() {
        let of = |pick: &dyn Fn(&Instant) -> f64| {
            cycles.iter().map(|cycle| pick(&record.cycles[*cycle].drive[tick])).sum::<f64>() / n
        };
        instant.demand_m = of(&|instant| instant.demand_m);
        instant.load_n = of(&|instant| instant.load_n);
        instant.load_end_n = of(&|instant| instant.load_end_n);
    }
    mean
}

/// A fitted machine.
#[derive(Clone)]
pub struct Fit {
    /// The machine.
    pub spec: MachineSpec,
    /// Its free parameters and their coordinates.
    pub free: Vec<Free>,
    /// See [`Fit::free`].
    pub at: DVector<f64>,
    /// Weighted differences.
    pub residual: DVector<f64>,
    /// Derivatives of the differences.
    pub jacobian: DMatrix<f64>,
    /// Sum of squares of differences and priors.
    pub cost: f64,
    /// Steps since the derivatives were simulated; Broyden's updates have carried them since.
    age: usize,
}

/// Gain below which a fit has converged, in log-likelihood, and as a share of the cost.
const LEAST_GAIN: (f64, f64) = (0.02, 1e-3);
/// Dampings that are tried side by side, times the present one: one batch of lanes.
const DAMPINGS: [f64; LANES] = [0.01, 0.1, 0.3, 1.0, 3.0, 10.0, 100.0, 1000.0];
/// Steps after which derivatives are simulated anew.
const OLD_AGE: usize = 3;

impl Fit {
    /// A machine as it is, with the derivatives there.
    pub fn at(problem: &Problem<'_>, spec: &MachineSpec, free: Vec<Free>) -> Self {
        let at = coordinates(spec, &free);
        let residual = problem.residuals(std::slice::from_ref(spec)).swap_remove(0);
        let cost = residual.norm_squared() + prior_cost(&free, &at);
        let columns: Vec<usize> = (0..free.len()).collect();
        let mut jacobian = DMatrix::zeros(residual.len(), free.len());
        slopes(problem, spec, &free, &at, &residual, &columns, &mut jacobian);
        Fit { spec: spec.clone(), free, at, residual, jacobian, cost, age: 0 }
    }

    /// This machine with further parameters, changed to `spec`: the derivatives by what was free before are taken over.
    pub fn extended(&self, problem: &Problem<'_>, spec: &MachineSpec, further: Vec<Free>) -> Self {
        let before = self.free.len();
        let free: Vec<Free> = self.free.iter().copied().chain(further).collect();
        let at = coordinates(spec, &free);
        let residual = problem.residuals(std::slice::from_ref(spec)).swap_remove(0);
        let cost = residual.norm_squared() + prior_cost(&free, &at);
        let columns: Vec<usize> = (before..free.len()).collect();
        let mut jacobian = self.jacobian.clone().resize_horizontally(free.len(), 0.0);
        slopes(problem, spec, &free, &at, &residual, &columns, &mut jacobian);
        Fit { spec: spec.clone(), free, at, residual, jacobian, cost, age: OLD_AGE - 1 }
    }

    /// Fits from a machine that may be far off: with errors that shrink step by step.
    pub fn from_afar(self, problem: &Problem<'_>, iterations: usize) -> Self {
        let near = RELAXED
            .iter()
            .fold(self, |fit, times| fit.descended(problem, times.powi(2).recip(), RELAXED_ITERATIONS));
        near.fitted(problem, iterations)
    }

    /// Fits from where the machine is.
    pub fn fitted(self, problem: &Problem<'_>, iterations: usize) -> Self {
        self.descended(problem, 1.0, iterations)
    }

    /// The same with derivatives simulated where it is.
    pub fn renewed(mut self, problem: &Problem<'_>) -> Self {
        if self.age > 0 {
            let columns: Vec<usize> = (0..self.free.len()).collect();
            let Fit { spec, free, at, residual, jacobian, .. } = &mut self;
            slopes(problem, spec, free, at, residual, &columns, jacobian);
            self.age = 0;
        }
        self
    }

    /// Goes down the cost in which the squared differences count by `weight`. Derivatives are carried from step to step (Broyden,
    /// Mathematics of Computation 19 (1965)) and simulated anew when they are old or lead nowhere.
    fn descended(mut self, problem: &Problem<'_>, weight: f64, iterations: usize) -> Self {
        let mut damping = 1.0;
        let cost_of = |residual: &DVector<f64>, free: &[Free], at: &DVector<f64>| {
            weight * residual.norm_squared() + prior_cost(free, at)
        };
        let mut cost = cost_of(&self.residual, &self.free, &self.at);
        for _ in 0..iterations {
            if self.age >= OLD_AGE {
                self = self.renewed(problem);
            }
            let tried: Vec<(f64, DVector<f64>)> = DAMPINGS
                .iter()
                .filter_map(|factor| Some((damping * factor, self.step(weight, damping * factor)?)))
                .collect();
            let machines: Vec<MachineSpec> =
                tried.iter().map(|(_, at)| placed(&self.spec, &self.free, at)).collect();
            let results = problem.residuals(&machines);
            let best = results
                .into_iter()
                .zip(tried)
                .map(|(residual, (damping, at))| (cost_of(&residual, &self.free, &at), residual, damping, at))
                .min_by(|a, b| a.0.total_cmp(&b.0));
            let gain = best.as_ref().map_or(0.0, |best| cost - best.0);
            let settled = gain < LEAST_GAIN.0 + LEAST_GAIN.1 * cost;
            let fresh = self.age == 0;
            if let Some((better, residual, by, at)) = best.filter(|_| gain > 0.0) {
                damping = by.clamp(1e-6, 1e6);
                cost = better;
                self.moved(at, residual);
            }
            if settled {
                if fresh {
                    break;
                }
                self.age = OLD_AGE;
            }
        }
        self.cost = self.residual.norm_squared() + prior_cost(&self.free, &self.at);
        self
    }

    /// Takes a step and what it showed.
    fn moved(&mut self, at: DVector<f64>, residual: DVector<f64>) {
        let step = &at - &self.at;
        let surprise = &residual - &self.residual - &self.jacobian * &step;
        self.jacobian.ger(1.0 / step.norm_squared().max(1e-18), &surprise, &step, 1.0);
        self.spec = placed(&self.spec, &self.free, &at);
        self.at = at;
        self.residual = residual;
        self.age += 1;
    }

    /// Where a damped step leads.
    fn step(&self, weight: f64, damping: f64) -> Option<DVector<f64>> {
        let mut gradient = self.jacobian.tr_mul(&self.residual) * weight;
        for (index, parameter) in self.free.iter().enumerate() {
            if let Some((centre, sigma)) = parameter.prior {
                gradient[index] += (self.at[index] - centre) / (sigma * sigma);
            }
        }
        let mut matrix = normal_matrix(&self.free, &self.jacobian, weight);
        // What would leave its bounds stands still.
        for (index, parameter) in self.free.iter().enumerate() {
            let outward = (self.at[index] <= parameter.low && gradient[index] > 0.0)
                || (self.at[index] >= parameter.high && gradient[index] < 0.0);
            if outward {
                gradient[index] = 0.0;
                matrix.row_mut(index).fill(0.0);
                matrix.column_mut(index).fill(0.0);
                matrix[(index, index)] = 1.0;
            }
        }
        for index in 0..self.free.len() {
            matrix[(index, index)] *= 1.0 + damping;
        }
        let change = matrix.cholesky()?.solve(&gradient);
        let mut there = &self.at - change;
        for (value, parameter) in there.iter_mut().zip(&self.free) {
            *value = value.clamp(parameter.low, parameter.high);
        }
        Some(there)
    }

    /// Value of each parameter with its 95 % interval, from the covariance of differences and priors.
    pub fn estimates(&self) -> Vec<(f64, [f64; 2])> {
        let covariance = normal_matrix(&self.free, &self.jacobian, 1.0).try_inverse();
        let estimate = |(index, parameter): (usize, &Free)| {
            let spread = covariance.as_ref().map_or(f64::INFINITY, |c| c[(index, index)].max(0.0).sqrt());
            let end = |side: f64| {
                let at = self.at[index] + side * 1.96 * spread;
                parameter.value(at.clamp(parameter.low, parameter.high))
            };
            (parameter.value(self.at[index]), [end(-1.0), end(1.0)])
        };
        self.free.iter().enumerate().map(estimate).collect()
    }
}

/// A machine's coordinates.
fn coordinates(spec: &MachineSpec, free: &[Free]) -> DVector<f64> {
    DVector::from_iterator(free.len(), free.iter().map(|parameter| parameter.read(spec)))
}

/// A machine at these coordinates.
fn placed(spec: &MachineSpec, free: &[Free], at: &DVector<f64>) -> MachineSpec {
    let mut spec = spec.clone();
    free.iter().zip(at.iter()).for_each(|(parameter, at)| parameter.write(*at, &mut spec));
    spec
}

/// Derivatives of the differences by some of the parameters, by simulation.
fn slopes(
    problem: &Problem<'_>,
    spec: &MachineSpec,
    free: &[Free],
    at: &DVector<f64>,
    residual: &DVector<f64>,
    columns: &[usize],
    jacobian: &mut DMatrix<f64>,
) {
    let moved: Vec<MachineSpec> = columns
        .iter()
        .map(|column| {
            let mut there = at.clone();
            there[*column] += free[*column].step(at[*column]);
            placed(spec, free, &there)
        })
        .collect();
    for (column, there) in columns.iter().zip(problem.residuals(&moved)) {
        jacobian.set_column(*column, &((there - residual) / free[*column].step(at[*column])));
    }
}

pub(crate) fn prior_cost(free: &[Free], at: &DVector<f64>) -> f64 {
    free.iter()
        .zip(at.iter())
        .filter_map(|(parameter, at)| parameter.prior.map(|(centre, sigma)| ((at - centre) / sigma).powi(2)))
        .sum()
}

/// JᵀJ, times the weight of differences, with the priors on its diagonal.
pub(crate) fn normal_matrix(free: &[Free], jacobian: &DMatrix<f64>, weight: f64) -> DMatrix<f64> {
    let mut matrix = jacobian.tr_mul(jacobian) * weight;
    for (index, parameter) in free.iter().enumerate() {
        // A parameter that nothing depends on and no prior holds stays where it is.
        matrix[(index, index)] += parameter.prior.map_or(1e-6, |(_, sigma)| 1.0 / (sigma * sigma));
    }
    matrix
}

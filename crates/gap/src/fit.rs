//! Fitting a machine's parameters to a record: Levenberg–Marquardt with priors and bounds, derivatives by simulation.
//!
//! Levenberg, Quarterly of Applied Mathematics 2 (1944); Marquardt, SIAM Journal 11 (1963). A library's solver would ask for one
//! simulation at a time; here a Jacobian, and the steps of several dampings, are simulated side by side.

use std::borrow::Cow;

use nalgebra::{DMatrix, DVector};
use seepd_signals::Signal;
use seepd_sim::SensorError;
use seepd_sim::cycle::DriveSample;
use seepd_sim::effects::{EffectInfo, Parameter};
use seepd_sim::real::LANES;

use crate::calibration::Known;
use crate::record::{BINS, Record, mean_drive};
use crate::screen::spans_decades;
use crate::simulate::{BinnedSignals, Drive, binned_signals};
use crate::simulated_axis::{CalibratedParameter, Scale, SimulatedAxis};
use crate::transducers::Allowance;

/// Independent values that a signal is taken to have in a cycle: model errors are alike over a twentieth of a cycle or so, and each bin
/// counted by itself would be certain of anything.
pub(crate) const INDEPENDENT: f64 = 60.0;
/// Error that any model of a machine has, share of a signal's range: differences below it are no gap.
pub(crate) const MODEL_ERROR: f64 = 0.002;
/// What a free parameter is.
#[derive(Debug, Clone)]
pub(crate) enum Target {
    /// A parameter of the plant.
    Plant(CalibratedParameter),
    /// A parameter of an effect.
    Effect(&'static EffectInfo, usize),
}

/// A free parameter, in the fit's own coordinate.
#[derive(Debug, Clone)]
pub(crate) struct Free {
    /// What it is.
    pub(crate) target: Target,
    pub(crate) scale: Scale,
    /// Least and largest value, SI, and their coordinates.
    range: (f64, f64),
    low: f64,
    high: f64,
    /// Centre and standard deviation, in the coordinate.
    pub(crate) prior: Option<(f64, f64)>,
}

/// What wear changes, and every plant parameter that may be calibrated.
pub(crate) fn free_parameters<A: SimulatedAxis>(spec: &A) -> Vec<Free> {
    let parameters = spec.wear().into_iter().chain(spec.calibrated_parameters());
    parameters.map(|parameter| Free::of_plant(spec, parameter)).collect()
}

/// An effect's parameters, in the ranges that are plausible on a machine.
pub(crate) fn of_effect<A: SimulatedAxis>(effect: &'static EffectInfo, spec: &A) -> Vec<Free> {
    let of = |(index, parameter): (usize, &Parameter)| {
        let range @ (low, high) = spec.range(effect, parameter);
        let scale =
            if spans_decades(low, high) { Scale::Logarithmic } else { Scale::Linear(0.2 * (high - low)) };
        let at = |value| coordinate(scale, value);
        Free {
            target: Target::Effect(effect, index),
            scale,
            range,
            low: at(low),
            high: at(high),
            prior: None,
        }
    };
    let parameters = effect.parameters.iter().enumerate();
    parameters.filter(|(_, parameter)| spec.acts(effect, parameter)).map(of).collect()
}

fn coordinate(scale: Scale, value: f64) -> f64 {
    match scale {
        Scale::Logarithmic => value.ln(),
        Scale::Linear(unit) => value / unit,
    }
}

/// An effect's values on a machine, neutral where none is given.
pub(crate) fn values_of<A: SimulatedAxis>(effect: &EffectInfo, spec: &A) -> Vec<f64> {
    let given = spec.effects().get(effect.key);
    effect
        .parameters
        .iter()
        .map(|parameter| given.and_then(|g| g.get(parameter.name)).copied().unwrap_or(parameter.neutral))
        .collect()
}

impl Free {
    fn of_plant<A: SimulatedAxis>(spec: &A, parameter: CalibratedParameter) -> Self {
        let at = |value| coordinate(parameter.scale, value);
        let range @ (low, high) = parameter.bounds;
        let centre = at(spec.parameter(&parameter.key));
        Free {
            scale: parameter.scale,
            range,
            low: at(low),
            high: at(high),
            prior: parameter.sigma.map(|sigma| (centre, sigma)),
            target: Target::Plant(parameter),
        }
    }

    /// Its key; an effect's is `effect.parameter`.
    pub(crate) fn key(&self) -> String {
        match &self.target {
            Target::Plant(parameter) => parameter.key.to_string(),
            Target::Effect(effect, index) => format!("{}.{}", effect.key, effect.parameters[*index].name),
        }
    }

    /// Takes what is known of it.
    pub(crate) fn know(&mut self, known: &Known) {
        let sigma = match self.scale {
            Scale::Logarithmic => known.sigma,
            Scale::Linear(unit) => known.sigma / unit,
        };
        self.prior = Some((coordinate(self.scale, known.value), sigma));
    }

    /// Whether it belongs to one of these effects.
    pub(crate) fn is_of(&self, effects: &[&str]) -> bool {
        matches!(&self.target, Target::Effect(effect, _) if effects.contains(&effect.key))
    }

    /// The coordinate of a machine's value.
    pub(crate) fn read<A: SimulatedAxis>(&self, spec: &A) -> f64 {
        coordinate(self.scale, self.value_on(spec)).clamp(self.low, self.high)
    }

    /// A machine's value, SI.
    pub(crate) fn value_on<A: SimulatedAxis>(&self, spec: &A) -> f64 {
        match &self.target {
            Target::Plant(parameter) => spec.parameter(&parameter.key),
            Target::Effect(effect, index) => values_of(effect, spec)[*index],
        }
    }

    /// Least and largest value, SI.
    pub(crate) fn bounds(&self) -> (f64, f64) {
        self.range
    }

    /// Gives a machine a value, SI, held within the bounds.
    pub(crate) fn write_value<A: SimulatedAxis>(&self, value: f64, spec: &mut A) {
        self.write(coordinate(self.scale, value).max(self.low).min(self.high), spec);
    }

    /// The value at a coordinate.
    pub(crate) fn value(&self, coordinate: f64) -> f64 {
        match self.scale {
            Scale::Logarithmic => coordinate.exp(),
            Scale::Linear(unit) => coordinate * unit,
        }
    }

    pub(crate) fn write<A: SimulatedAxis>(&self, coordinate: f64, spec: &mut A) {
        // A bound's logarithm and back is not always the bound, beyond which a plant file would be refused.
        let value = self.value(coordinate).max(self.range.0).min(self.range.1);
        match &self.target {
            Target::Plant(parameter) => spec.set_parameter(&parameter.key, value),
            Target::Effect(effect, index) => {
                let parameter = &effect.parameters[*index];
                let effects = spec.effects_mut().entry(effect.key.into()).or_default();
                effects.insert(parameter.name.into(), value);
            }
        }
    }

    /// Step of the derivative, towards the inside of the bounds. An event's times take longer steps while errors are relaxed: its edges
    /// show only where they are.
    pub(crate) fn step(&self, coordinate: f64, relaxed: f64) -> f64 {
        let reach = if self.is_time() { relaxed } else { 1.0 };
        let step = match self.scale {
            Scale::Logarithmic => 2e-3,
            Scale::Linear(_) => reach * 2e-3 * (self.high - self.low).min(5.0),
        };
        if coordinate + step > self.high { -step } else { step }
    }

    /// Whether it is a constant that logs hardly tell.
    pub(crate) fn is_hardly_told(&self) -> bool {
        matches!(&self.target, Target::Plant(parameter) if parameter.hardly_told)
    }

    fn is_time(&self) -> bool {
        matches!(&self.target, Target::Effect(effect, index) if effect.is_time(*index))
    }
}

/// What is fitted to: drives with what the machine showed along each.
#[derive(Debug, Clone)]
pub(crate) struct Problem<'r> {
    /// The record.
    pub(crate) record: Cow<'r, Record>,
    drives: Vec<Drive>,
    shown: Vec<BinnedSignals>,
    /// One over the expected error of each signal, with the square root of the share that a bin counts.
    weights: Vec<f64>,
    /// What each signal's sensor may be off by, where it has a class.
    allowances: Vec<Option<Allowance>>,
    /// Recorded command below which its differences count [`OPEN_SHARE`], share of full command.
    open_within: f64,
    /// Mean square over expected error that is left of each signal when only what differs from cycle to cycle is left.
    pub(crate) noise: Vec<f64>,
}

/// Difference of drives from cycle to cycle, share of their range, up to which one stands for all.
const SAME_DRIVE: f64 = 0.08;
/// Drives where cycles differ.
const DRIVES: usize = 2;
/// How many times larger errors are allowed while a fit is still far off: strong directions are found first, and weak ones are held by
/// their priors.
const RELAXED: [f64; 2] = [25.0, 5.0];
/// Share of its weight that the command has where the loop is open. What it says there is the sum of all that is off, however little.
const OPEN_SHARE: f64 = 0.1;
/// Iterations of a fit with relaxed errors.
const RELAXED_ITERATIONS: usize = 4;

impl<'r> Problem<'r> {
    /// A problem of some of the record's cycles.
    pub(crate) fn new(record: &'r Record, cycles: &[usize]) -> Self {
        Problem::of(Cow::Borrowed(record), cycles)
    }

    /// The same of a record that may be the problem's own.
    pub(crate) fn of(owned: Cow<'r, Record>, cycles: &[usize]) -> Self {
        let record = &*owned;
        let groups: Vec<Vec<usize>> = if record.is_open_loop {
            record.by_group(cycles)
        } else if same_drive(record, cycles) {
            vec![cycles.to_vec()]
        } else {
            let step = cycles.len().div_ceil(DRIVES).max(1);
            cycles.iter().step_by(step).map(|cycle| vec![*cycle]).collect()
        };
        let (mut drives, mut shown): (Vec<Drive>, Vec<BinnedSignals>) =
            groups.iter().map(|group| (mean_drive(record, group), record.mean(group))).unzip();
        // A test counts beside the cycles, by the same expected errors.
        let of_test = record.test.as_ref().map_or(0.0, |(_, cycles)| 1.0 / *cycles as f64);
        let (weights, noise): (Vec<f64>, Vec<f64>) = record
            .floor
            .iter()
            .zip(&record.range)
            .enumerate()
            .map(|(signal, (floor, range))| {
                let repeated = groups.iter().map(|group| record.with_signal(group, signal).count());
                let repeated: Vec<usize> = repeated.filter(|cycles| *cycles > 0).collect();
                let bins = (BINS * repeated.len()) as f64;
                let averaged = repeated.iter().sum::<usize>() as f64 / repeated.len() as f64;
                let noise = floor * floor / averaged;
                let expected = noise + MODEL_ERROR * MODEL_ERROR;
                let left = (noise + floor * floor * of_test) / expected;
                ((INDEPENDENT / bins / expected).sqrt() / range, left)
            })
            .unzip();
        if let Some((test, _)) = &record.test {
            drives.push(test.drive.clone());
            shown.push(test.bins.clone());
        }
        let allowances = allowances(record, &shown, &weights);
        Problem { drives, shown, weights, allowances, open_within: 0.0, noise, record: owned }
    }

    /// The same where the command hardly counts while it is nearer to 0 than that: within a valve's overlap the loop is open.
    pub(crate) fn with_open_loop_within(mut self, command: f64) -> Self {
        self.open_within = command;
        self
    }

    /// Weighted differences of simulation and record, one row a machine: by drive, signal, bin.
    pub(crate) fn residuals<A: SimulatedAxis>(&self, machines: &[A]) -> Vec<DVector<f64>> {
        let length = self.drives.len() * self.record.signals.len() * BINS;
        let mut rows = vec![Vec::with_capacity(length); machines.len()];
        for (drive, shown) in self.drives.iter().zip(&self.shown) {
            for (row, view) in rows.iter_mut().zip(binned_signals(machines, drive, &self.record.signals)) {
                let signals = self.record.signals.iter().zip(&self.weights);
                for ((simulated, recorded), (signal, weight)) in view.iter().zip(shown).zip(signals) {
                    let open_within = if *signal == Signal::Command { self.open_within } else { 0.0 };
                    row.extend(simulated.iter().zip(recorded).map(|(a, b)| {
                        // What this run has no transducer for.
                        if b.is_nan() {
                            return 0.0;
                        }
                        let share = if b.abs() < open_within { OPEN_SHARE } else { 1.0 };
                        let difference = (a - b) * weight * share;
                        // A simulation that went out of bounds is as far off as can be.
                        if difference.is_finite() { difference.clamp(-1e3, 1e3) } else { 1e3 }
                    }));
                }
            }
        }
        rows.iter_mut().for_each(|row| self.allow_for_sensors(row));
        rows.into_iter().map(DVector::from_vec).collect()
    }

    /// What the log shows along each drive.
    pub(crate) fn shown(&self) -> &[BinnedSignals] {
        &self.shown
    }

    /// The drives along which machines are compared.
    pub(crate) fn drives(&self) -> &[Drive] {
        &self.drives
    }

    /// The same for sensors that show what is there.
    pub(crate) fn without_allowances(mut self) -> Self {
        self.allowances.fill(None);
        self
    }

    /// Takes off what sensors explain within their classes.
    fn allow_for_sensors(&self, row: &mut [f64]) {
        let signals = self.record.signals.len();
        for (signal, allowance) in self.allowances.iter().enumerate() {
            let Some(allowance) = allowance else { continue };
            let places = (0..self.drives.len()).map(|drive| (drive * signals + signal) * BINS..);
            let mut differences: Vec<f64> =
                places.clone().flat_map(|place| row[place][..BINS].to_vec()).collect();
            allowance.take_off(&mut differences);
            for (place, differences) in places.zip(differences.chunks(BINS)) {
                row[place][..BINS].copy_from_slice(differences);
            }
        }
    }

    /// How much of the position's differences each wave over the recorded position explains, beside their mean, moves out and back each for
    /// themselves: a periodogram over places (Lomb, Astrophysics and Space Science 39 (1976)).
    pub(crate) fn waves_over_position(&self, residual: &DVector<f64>, waves_per_m: &[f64]) -> Vec<f64> {
        let signals = &self.record.signals;
        let Some(place) = signals.iter().position(|signal| *signal == Signal::Position) else {
            return vec![0.0; waves_per_m.len()];
        };
        let mut powers = vec![0.0; waves_per_m.len()];
        for (drive, shown) in self.shown.iter().enumerate() {
            let x = &shown[place];
            let rest = &residual.as_slice()[(drive * signals.len() + place) * BINS..][..BINS];
            let fast = x.windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f64::max);
            for sign in [1.0, -1.0] {
                let moving: Vec<(f64, f64)> = (1..BINS - 1)
                    .filter(|bin| sign * (x[bin + 1] - x[bin - 1]) > 0.1 * fast)
                    // Against the bins beside it: what changes slowly is no wave.
                    .map(|bin| (x[bin], rest[bin] - 0.5 * (rest[bin - 1] + rest[bin + 1])))
                    .collect();
                for (power, waves_per_m) in powers.iter_mut().zip(waves_per_m) {
                    *power += wave_power(&moving, *waves_per_m);
                }
            }
        }
        powers
    }

    /// Weighted differences, along the first drive, of the signals that show best when something happens: the one that is furthest off, and
    /// the supply's pressure, which dips while others draw from it.
    pub(crate) fn eventful<'d>(&self, residual: &'d DVector<f64>) -> Vec<&'d [f64]> {
        let by_signal = self.by_signal(residual);
        let worst = (0..by_signal.len()).max_by(|a, b| by_signal[*a].total_cmp(&by_signal[*b])).unwrap_or(0);
        let supply = self.record.signals.iter().position(|signal| *signal == Signal::PSupply);
        let signals = std::iter::once(worst).chain(supply.filter(|supply| *supply != worst));
        signals.map(|signal| &residual.as_slice()[signal * BINS..][..BINS]).collect()
    }

    /// How many times larger in squares than expected of a model the differences are, at least 1: intervals widen by as much (Birge,
    /// Physical Review 40 (1932)).
    pub(crate) fn misfit(&self, residual: &DVector<f64>) -> f64 {
        let left = self.by_signal(residual);
        (left.iter().sum::<f64>() / left.len().max(1) as f64).max(1.0)
    }

    /// Mean square of each signal's differences over their expected error.
    pub(crate) fn by_signal(&self, residual: &DVector<f64>) -> Vec<f64> {
        let signals = self.record.signals.len();
        let mut sums = vec![0.0; signals];
        for (index, value) in residual.iter().enumerate() {
            sums[index / BINS % signals] += value * value;
        }
        sums.into_iter().map(|sum| sum / INDEPENDENT).collect()
    }

    /// The same beyond what differs from cycle to cycle, 0 at least.
    pub(crate) fn beyond_noise(&self, residual: &DVector<f64>) -> Vec<f64> {
        let squares = self.by_signal(residual);
        squares.iter().zip(&self.noise).map(|(square, noise)| (square - noise).max(0.0)).collect()
    }

    /// Mean square over expected error of what each signal's sensor adds to what is shown, if it is off by so much; 0 without an error.
    pub(crate) fn of_sensors(&self, errors: &[Option<SensorError>]) -> Vec<f64> {
        let of = |(signal, error): (usize, &Option<SensorError>)| {
            let Some(error) = error else { return 0.0 };
            let shown = self.shown.iter().flat_map(|view| view[signal].iter());
            let added = shown.filter(|value| value.is_finite()).map(|value| error.gain * value + error.zero);
            added.map(|added| (added * self.weights[signal]).powi(2)).sum::<f64>() / INDEPENDENT
        };
        errors.iter().enumerate().map(of).collect()
    }
}

/// What each signal's sensor may add to weighted differences, by drive and bin.
fn allowances(record: &Record, shown: &[BinnedSignals], weights: &[f64]) -> Vec<Option<Allowance>> {
    let of = |(signal, kind): (usize, &Signal)| {
        let recorded: Vec<f64> = shown.iter().flat_map(|view| view[signal].iter().copied()).collect();
        Allowance::new(*kind, &recorded, weights[signal])
    };
    record.signals.iter().enumerate().map(of).collect()
}

/// What a sine and a cosine of that many waves a metre explain of values at places.
fn wave_power(values: &[(f64, f64)], waves_per_m: f64) -> f64 {
    let (mut sine, mut cosine) = (0.0, 0.0);
    for (x_m, value) in values {
        let (s, c) = (std::f64::consts::TAU * waves_per_m * x_m).sin_cos();
        sine += value * s;
        cosine += value * c;
    }
    (sine * sine + cosine * cosine) / values.len().max(1) as f64
}

fn same_drive(record: &Record, cycles: &[usize]) -> bool {
    let differs = |of: &dyn Fn(&DriveSample) -> f64| {
        let all = || cycles.iter().flat_map(|cycle| record.cycles[*cycle].drive.iter().step_by(10).map(of));
        let range = all().fold(f64::NEG_INFINITY, f64::max) - all().fold(f64::INFINITY, f64::min);
        let Some(first) = cycles.first().map(|cycle| &record.cycles[*cycle].drive) else { return false };
        cycles.iter().any(|cycle| {
            let pairs = record.cycles[*cycle].drive.iter().zip(first.iter()).step_by(10);
            let n = pairs.len().max(1) as f64;
            let square: f64 = pairs.map(|(a, b)| (of(a) - of(b)).powi(2)).sum();
            (square / n).sqrt() > SAME_DRIVE * range
        })
    };
    !differs(&|sample| sample.demand_m) && !differs(&|sample| sample.load_n)
}

/// A fitted machine.
#[derive(Clone)]
pub(crate) struct Fit<A> {
    /// The machine.
    pub(crate) spec: A,
    /// Its free parameters and their coordinates.
    pub(crate) free: Vec<Free>,
    /// See [`Fit::free`].
    pub(crate) at: DVector<f64>,
    /// Weighted differences.
    pub(crate) residual: DVector<f64>,
    /// Derivatives of the differences.
    pub(crate) jacobian: DMatrix<f64>,
    /// Sum of squares of differences and priors.
    pub(crate) cost: f64,
    /// Steps since the derivatives were simulated; Broyden's updates have carried them since.
    age: usize,
}

/// Gain below which a fit has converged, in log-likelihood, and as a share of the cost.
const LEAST_GAIN: (f64, f64) = (0.02, 1e-3);
/// Dampings that are tried side by side, times the present one: one batch of lanes.
const DAMPINGS: [f64; LANES] = [0.01, 0.1, 0.3, 1.0, 3.0, 10.0, 100.0, 1000.0];
/// Those where a run is dear.
const FEWER_DAMPINGS: [f64; 4] = [0.1, 1.0, 10.0, 1000.0];
/// Values of wear from which the best is the start: two batches of lanes, each value about twice the one before.
const WEAR_VALUES: usize = 2 * LANES;
/// The smallest of them over the largest.
const SMALLEST_WEAR: f64 = 1e-4;
/// Steps after which derivatives are simulated anew.
const OLD_AGE: usize = 3;

impl<A: SimulatedAxis> Fit<A> {
    /// A machine as it is, with the derivatives there.
    pub(crate) fn at(problem: &Problem<'_>, spec: &A, free: Vec<Free>) -> Self {
        Fit::beside(problem, spec, free, DMatrix::zeros(0, 0), 0)
    }

    /// A machine as it is but for what wear changes. It is looked for over all of its range first: beside a relief valve's chatter the
    /// derivative by a leak of 0 leads nowhere.
    pub(crate) fn of_wear(problem: &Problem<'_>, spec: &A, iterations: usize) -> Self {
        let Some(wear) = spec.wear() else { return Fit::at(problem, spec, Vec::new()) };
        let free = Free::of_plant(spec, wear);
        let mut machines = vec![spec.clone()];
        machines.extend((1..WEAR_VALUES).map(|index| {
            let share = index as f64 / (WEAR_VALUES - 1) as f64;
            let at = free.low + (free.high - free.low) * SMALLEST_WEAR.powf(1.0 - share);
            placed(spec, std::slice::from_ref(&free), &DVector::from_element(1, at))
        }));
        let residuals = problem.residuals(&machines);
        let costs = residuals.iter().map(|residual| residual.norm_squared());
        let best = machines.into_iter().zip(costs).min_by(|a, b| a.1.total_cmp(&b.1));
        let start = best.map_or_else(|| spec.clone(), |(machine, _)| machine);
        Fit::at(problem, &start, vec![free]).fitted(problem, iterations)
    }

    /// The machine as its file describes it, with what wear and effects have come to: by its size what is plausible of an effect is told.
    /// Calibration may be far off while an effect is missing, and a supply of half the pressure would halve the range of a friction.
    pub(crate) fn as_described(&self) -> A {
        let mut spec = self.spec.clone();
        for free in &self.free {
            if let (Target::Plant(_), Some((centre, _))) = (&free.target, free.prior) {
                free.write(centre, &mut spec);
            }
        }
        spec
    }

    /// This machine with further parameters, changed to `spec`: the derivatives by what was free before are taken over.
    pub(crate) fn extended(&self, problem: &Problem<'_>, spec: &A, further: Vec<Free>) -> Self {
        let free: Vec<Free> = self.free.iter().cloned().chain(further).collect();
        Fit::beside(problem, spec, free, self.jacobian.clone(), OLD_AGE - 1)
    }

    /// A machine with derivatives of some age by its first parameters; those by the others are simulated.
    fn beside(problem: &Problem<'_>, spec: &A, free: Vec<Free>, known: DMatrix<f64>, age: usize) -> Self {
        let at = coordinates(spec, &free);
        let columns: Vec<usize> = (known.ncols()..free.len()).collect();
        let mut machines = vec![spec.clone()];
        machines.extend(moved(spec, &free, &at, &columns, 1.0));
        let mut shown = problem.residuals(&machines).into_iter();
        let residual = shown.next().unwrap_or_default();
        let mut jacobian = known.resize(residual.len(), free.len(), 0.0);
        set_slopes(&free, &at, &residual, (&columns, 1.0), shown, &mut jacobian);
        let cost = residual.norm_squared() + prior_cost(&free, &at);
        Fit { spec: spec.clone(), free, at, residual, jacobian, cost, age }
    }

    /// Fits from a machine that may be far off: with errors that shrink step by step.
    pub(crate) fn fitted_from_afar(mut self, problem: &Problem<'_>, iterations: usize) -> Self {
        for times in RELAXED {
            if self.free.iter().any(Free::is_time) {
                self = self.with_slopes(problem, times);
            }
            self = self.descended(problem, times, RELAXED_ITERATIONS);
        }
        self.fitted(problem, iterations)
    }

    /// Fits from where the machine is.
    pub(crate) fn fitted(self, problem: &Problem<'_>, iterations: usize) -> Self {
        self.descended(problem, 1.0, iterations)
    }

    /// The same with derivatives simulated where it is.
    pub(crate) fn renewed(self, problem: &Problem<'_>) -> Self {
        if self.age > 0 { self.with_slopes(problem, 1.0) } else { self }
    }

    fn with_slopes(mut self, problem: &Problem<'_>, relaxed: f64) -> Self {
        let columns: Vec<usize> = (0..self.free.len()).collect();
        let machines = moved(&self.spec, &self.free, &self.at, &columns, relaxed);
        let shown = problem.residuals(&machines).into_iter();
        set_slopes(&self.free, &self.at, &self.residual, (&columns, relaxed), shown, &mut self.jacobian);
        self.age = 0;
        self
    }

    /// Goes down the cost with errors that are `relaxed` times larger. Derivatives are carried from step to step (Broyden,
    /// Mathematics of Computation 19 (1965)) and simulated anew when they are old or lead nowhere.
    fn descended(mut self, problem: &Problem<'_>, relaxed: f64, iterations: usize) -> Self {
        let weight = relaxed.powi(2).recip();
        let mut damping = 1.0;
        let cost_of = |residual: &DVector<f64>, free: &[Free], at: &DVector<f64>| {
            weight * residual.norm_squared() + prior_cost(free, at)
        };
        let mut cost = cost_of(&self.residual, &self.free, &self.at);
        let dampings: &[f64] = if A::IS_DEAR { &FEWER_DAMPINGS } else { &DAMPINGS };
        for _ in 0..iterations {
            if self.spec.is_spent() {
                break;
            }
            if self.age >= OLD_AGE {
                self = self.with_slopes(problem, relaxed);
            }
            let tried: Vec<(f64, DVector<f64>)> = dampings
                .iter()
                .filter_map(|factor| Some((damping * factor, self.step(weight, damping * factor)?)))
                .collect();
            let machines: Vec<A> = tried.iter().map(|(_, at)| placed(&self.spec, &self.free, at)).collect();
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
                self.take(at, residual);
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
    fn take(&mut self, at: DVector<f64>, residual: DVector<f64>) {
        let step = &at - &self.at;
        let surprise = &residual - &self.residual - &self.jacobian * &step;
        self.jacobian.ger(1.0 / step.norm_squared().max(1e-18), &surprise, &step, 1.0);
        self.spec = placed(&self.spec, &self.free, &at);
        self.at = at;
        self.residual = residual;
        self.age += 1;
    }

    /// Half the slope of the cost with differences of that weight, priors included.
    pub(crate) fn gradient(&self, weight: f64) -> DVector<f64> {
        let mut gradient = self.jacobian.tr_mul(&self.residual) * weight;
        for (index, parameter) in self.free.iter().enumerate() {
            if let Some((centre, sigma)) = parameter.prior {
                gradient[index] += (self.at[index] - centre) / (sigma * sigma);
            }
        }
        gradient
    }

    /// The nearest coordinates within the bounds.
    pub(crate) fn within_bounds(&self, at: &DVector<f64>) -> DVector<f64> {
        let each = self.free.iter().zip(at.iter()).map(|(free, at)| at.clamp(free.low, free.high));
        DVector::from_iterator(at.len(), each)
    }

    /// Where a damped step leads.
    fn step(&self, weight: f64, damping: f64) -> Option<DVector<f64>> {
        let gradient = self.gradient(weight);
        let mut matrix = normal_matrix(&self.free, &self.jacobian, weight);
        for index in 0..self.free.len() {
            matrix[(index, index)] *= 1.0 + damping;
        }
        // What would leave its bounds goes to the bound, and the others are solved for once more.
        let mut held: Vec<Option<f64>> = vec![None; self.free.len()];
        for _ in 0..self.free.len() {
            let change = solved(&matrix, &gradient, &held)?;
            let mut beyond = false;
            for (index, parameter) in self.free.iter().enumerate() {
                let there = self.at[index] + change[index];
                if held[index].is_none() && !(parameter.low..=parameter.high).contains(&there) {
                    held[index] = Some(there.clamp(parameter.low, parameter.high) - self.at[index]);
                    beyond = true;
                }
            }
            if !beyond {
                let mut there = &self.at + change;
                for (value, parameter) in there.iter_mut().zip(&self.free) {
                    *value = value.clamp(parameter.low, parameter.high);
                }
                return Some(there);
            }
        }
        None
    }

    /// Value of each parameter with its 95 % interval, from the covariance of differences and priors, for errors that are in squares so
    /// many times larger than expected.
    pub(crate) fn estimates(&self, misfit: f64) -> Vec<(f64, [f64; 2])> {
        let covariance = normal_matrix(&self.free, &self.jacobian, 1.0 / misfit).try_inverse();
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

/// The change that solves the normal equations while some parameters change by a given amount.
fn solved(matrix: &DMatrix<f64>, gradient: &DVector<f64>, held: &[Option<f64>]) -> Option<DVector<f64>> {
    let (mut matrix, mut right) = (matrix.clone(), -gradient);
    for (index, change) in held.iter().enumerate() {
        let Some(change) = change else { continue };
        right -= matrix.column(index) * *change;
        matrix.row_mut(index).fill(0.0);
        matrix.column_mut(index).fill(0.0);
        matrix[(index, index)] = 1.0;
    }
    for (index, change) in held.iter().enumerate() {
        if let Some(change) = change {
            right[index] = *change;
        }
    }
    Some(matrix.cholesky()?.solve(&right))
}

/// A machine's coordinates.
pub(crate) fn coordinates<A: SimulatedAxis>(spec: &A, free: &[Free]) -> DVector<f64> {
    DVector::from_iterator(free.len(), free.iter().map(|parameter| parameter.read(spec)))
}

/// A machine at these coordinates.
pub(crate) fn placed<A: SimulatedAxis>(spec: &A, free: &[Free], at: &DVector<f64>) -> A {
    let mut spec = spec.clone();
    free.iter().zip(at.iter()).for_each(|(parameter, at)| parameter.write(*at, &mut spec));
    spec
}

/// Machines that are a small step away, one for each of some parameters.
fn moved<A: SimulatedAxis>(
    spec: &A,
    free: &[Free],
    at: &DVector<f64>,
    columns: &[usize],
    relaxed: f64,
) -> Vec<A> {
    let along = |column: &usize| {
        let mut there = at.clone();
        there[*column] += free[*column].step(at[*column], relaxed);
        placed(spec, free, &there)
    };
    columns.iter().map(along).collect()
}

/// Derivatives by some of the parameters from what those machines showed.
fn set_slopes(
    free: &[Free],
    at: &DVector<f64>,
    residual: &DVector<f64>,
    (columns, relaxed): (&[usize], f64),
    shown: impl Iterator<Item = DVector<f64>>,
    jacobian: &mut DMatrix<f64>,
) {
    for (column, there) in columns.iter().zip(shown) {
        jacobian.set_column(*column, &((there - residual) / free[*column].step(at[*column], relaxed)));
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

//! Learns what each cause does to a cycle: [`CausesFile`] says what is learned.
//!
//! Machines of the series are simulated on a day of theirs, without a cause and with each of the [`curves`] at sizes drawn from each of its
//! ranges; the difference is the cause's response. Laws and shapes are drawn with the size: one law each would be too sure of itself.

mod basis;
mod curves;
pub(crate) mod planted;

use nalgebra::{DMatrix, SymmetricEigen};
use rayon::prelude::*;
use seepd_model::causes::{Cause, Causes, Change};
use seepd_model::schema::{CausesFile, CausesGolden, CellFile};
use seepd_sim::MachineSpec;
use seepd_sim::noise::Noise;
use serde::{Deserialize, Serialize};

use crate::conformal::significant;
use crate::dataset::{self, Observation, Reading, Spread};
use crate::hold_force::HoldForce;
use crate::portions::Portions;
use crate::relative::{Conditions, simulate_stably};
use crate::train::{TrainError, TrainingSettings};

use basis::Basis;
use curves::Curve;

/// Fewer machines name no cause.
const LEAST_MACHINES: usize = 2;
/// Least share of a range's machines whose cycles must have been found.
const LEAST_FOUND: f64 = 0.5;
/// Machines that say how far a known cause may lie from what was learned, at one in so many ranges.
const HELD_OUT_MACHINES: usize = 8;
const HELD_OUT_STEP: usize = 3;
/// Ranges between two reports of progress.
const PORTION: usize = 16;
/// Noise at which directions are chosen and limits are set, share of full command, and cycles over which it is averaged.
const TYPICAL_NOISE: f64 = 0.003;
const TYPICAL_CYCLES: f64 = 8.0;
/// Largest error of a cell's response over its length: one with more would explain anything.
const LARGEST_ERROR: f64 = 0.3;
/// Room over the distance that so many of the causes not learned from do not reach.
const ROOM: f64 = 1.25;
const KNOWN: f64 = 0.98;
/// Most directions of a cell.
const RANK: usize = 2;
/// Golden inputs in the file.
const GOLDEN: usize = 4;

/// Random streams that share no machine with those of estimates.
mod purpose {
    pub(super) const MACHINES: u64 = 21;
    pub(super) const HELD_OUT: u64 = 22;
    pub(super) const ORDINARY: u64 = 23;
}

/// Simulates causes and reads their cycles.
pub(crate) struct CauseSimulator<'a> {
    pub(crate) spec: &'a MachineSpec,
    pub(crate) settings: &'a TrainingSettings,
    pub(crate) reading: &'a Reading<'a>,
}

/// A response with the size of its cause.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Response {
    size: f64,
    numbers: Vec<f64>,
}

/// Machines without a cause that a force presses against, and means and rises of their cycles, where these were found.
struct Pressed {
    force: HoldForce,
    healthy: Vec<Observation>,
    before: Vec<Option<Vec<f64>>>,
}

impl CauseSimulator<'_> {
    /// The causes of this machine.
    fn curves(&self) -> Vec<Curve> {
        curves::all(self.spec, self.settings.unknown_hold_force)
    }

    /// A machine of the series on a day of its own, with what presses against it.
    fn machine(&self, purpose: u64, index: usize, force: HoldForce) -> Observation {
        let stream = (purpose << 32) + index as u64;
        let mut noise = Noise::new(self.settings.seed, stream);
        let conditions = &self.settings.conditions;
        let spread = &self.settings.spread;
        let machine = if force == HoldForce::AsDrawn {
            spread.machine(self.spec, stream, &mut noise)
        } else {
            let spread = Spread { unknown_contact: false, ..spread.clone() };
            let mut machine = spread.machine(self.spec, stream, &mut noise);
            force.put_on(&mut machine.spec, &mut noise);
            machine
        };
        let oil_c = noise.uniform(conditions.oil_c.0, conditions.oil_c.1);
        Conditions::on_a_day(&machine, 1.0, oil_c, noise.factor(conditions.supply))
    }

    /// Means and rises of each observation's cycle without noise; `None` where it was not found.
    fn read(&self, observations: &[Observation]) -> Vec<Option<Vec<f64>>> {
        simulate_stably(observations, |_, _, commands| {
            let silence = vec![0.0; commands.len()];
            self.numbers(commands, 0.0, &silence)
        })
    }

    /// Means, then rises, by phase.
    fn numbers(&self, commands: &[f64], sigma: f64, unit_noise: &[f64]) -> Option<Vec<f64>> {
        let statistics = self.reading.read(commands, self.settings.filter, sigma, unit_noise)?;
        let phases = self.reading.phases.len();
        let rises = statistics.phase_rises();
        Some(statistics.phase_means()[..phases].iter().chain(&rises[..phases]).copied().collect())
    }

    /// So many machines that a force presses against, with what is read of their cycles.
    fn pressed(&self, force: HoldForce, (machines, purpose): (usize, u64)) -> Pressed {
        let healthy: Vec<Observation> =
            (0..machines).map(|index| self.machine(purpose, index, force)).collect();
        let before = self.read(&healthy);
        Pressed { force, healthy, before }
    }

    /// Responses at one in `step` of every curve's ranges: for each the curve's number and what the machines gave.
    fn responses(
        &self,
        curves: &[Curve],
        (machines, purpose, step): (usize, u64, usize),
        portions: &mut Portions,
        tell: &mut dyn FnMut(usize),
    ) -> Result<Vec<(usize, Vec<Response>)>, TrainError> {
        let mut pressed: Vec<Pressed> = Vec::new();
        for curve in curves {
            if !pressed.iter().any(|pressed| pressed.force == curve.force) {
                pressed.push(self.pressed(curve.force, (machines, purpose)));
            }
        }
        let every = curves
            .iter()
            .enumerate()
            .flat_map(|(number, curve)| curve.ranges().map(move |range| (number, range)));
        let ranges: Vec<(usize, (usize, [f64; 2]))> = every.enumerate().step_by(step).collect();
        let all = curves.iter().map(|curve| curve.ranges().count()).sum();
        let respond = |(index, (number, range)): &(usize, (usize, [f64; 2]))| {
            let noise = Noise::new(self.settings.seed ^ 0x6361_7573, (purpose << 32) + *index as u64);
            let curve = &curves[*number];
            let machines = pressed.iter().find(|pressed| pressed.force == curve.force);
            (*number, machines.map_or_else(Vec::new, |machines| self.respond(curve, *range, machines, noise)))
        };
        let mut cells = Vec::with_capacity(ranges.len());
        for (portion, ranges) in ranges.chunks(PORTION).enumerate() {
            let name = format!("responses {purpose} {portion}");
            let responses = portions.take(&name, || ranges.par_iter().map(respond).collect::<Vec<_>>())?;
            cells.extend(responses.into_iter().flatten());
            tell((step * (portion * PORTION + ranges.len())).min(all));
        }
        Ok(cells)
    }

    /// What a range of a curve does to machines whose cycles without it are known.
    fn respond(
        &self,
        curve: &Curve,
        range: [f64; 2],
        Pressed { healthy, before, .. }: &Pressed,
        mut noise: Noise,
    ) -> Vec<Response> {
        let (sizes, observations): (Vec<f64>, Vec<Observation>) = healthy
            .iter()
            .enumerate()
            .map(|(machine, healthy)| {
                // One size from each part of the range: few machines cover it evenly.
                let rank = (machine as f64 + noise.uniform(0.0, 1.0)) / before.len() as f64;
                curve.applied(healthy, range, rank, &mut noise)
            })
            .unzip();
        let read = self.read(&observations);
        let readings = read.into_iter().zip(before).zip(sizes);
        readings
            .filter_map(|((now, before), size)| {
                let (now, before) = (now?, before.as_ref()?);
                let numbers = now.iter().zip(before).map(|(now, before)| now - before).collect();
                Some(Response { size, numbers })
            })
            .collect()
    }
}

/// Learns causes; `None` where none are asked for, or too little was recognised to tell any apart. `tell` hears of the ranges done and all.
///
/// # Errors
/// [`TrainError`] for a portion that is damaged.
pub(crate) fn learn(
    simulator: &CauseSimulator<'_>,
    portions: &mut Portions,
    tell: &mut dyn FnMut(usize, usize),
) -> Result<Option<CausesFile>, TrainError> {
    if simulator.settings.cause_machines < LEAST_MACHINES {
        return Ok(None);
    }
    let basis = Basis::learn(simulator);
    let curves = simulator.curves();
    let responses = simulate_curves(simulator, &curves, portions, tell)?;
    Ok(basis.and_then(|basis| learn_from(simulator, &curves, &basis, &responses)))
}

/// Simulates what [`learn`] needs, as far as it is to be simulated here.
///
/// # Errors
/// [`TrainError`] for a portion that cannot be written.
pub(crate) fn simulate(
    simulator: &CauseSimulator<'_>,
    portions: &mut Portions,
    tell: &mut dyn FnMut(usize, usize),
) -> Result<(), TrainError> {
    if simulator.settings.cause_machines >= LEAST_MACHINES {
        simulate_curves(simulator, &simulator.curves(), portions, tell)?;
    }
    Ok(())
}

/// Responses to learn from, and those of other machines.
struct Responses {
    learned: Vec<(usize, Vec<Response>)>,
    held_out: Vec<(usize, Vec<Response>)>,
}

fn simulate_curves(
    simulator: &CauseSimulator<'_>,
    curves: &[Curve],
    portions: &mut Portions,
    tell: &mut dyn FnMut(usize, usize),
) -> Result<Responses, TrainError> {
    let all: usize = curves.iter().map(|curve| curve.ranges().count()).sum();
    let learned = (simulator.settings.cause_machines, purpose::MACHINES, 1);
    let held_out = (HELD_OUT_MACHINES, purpose::HELD_OUT, HELD_OUT_STEP);
    Ok(Responses {
        learned: simulator.responses(curves, learned, portions, &mut |done| tell(done, 2 * all))?,
        held_out: simulator.responses(curves, held_out, portions, &mut |done| tell(all + done, 2 * all))?,
    })
}

fn learn_from(
    simulator: &CauseSimulator<'_>,
    curves: &[Curve],
    basis: &Basis,
    Responses { learned, held_out }: &Responses,
) -> Option<CausesFile> {
    let machines = simulator.settings.cause_machines;
    let is_calibrated = simulator.settings.conditions.unknown_seal;
    let may_be_wrong = simulator.settings.conditions.response_error > 0.0;
    let mut cells: Vec<CellFile> = Vec::new();
    for (number, responses) in learned {
        let curve = &curves[*number];
        if (responses.len() as f64) < LEAST_FOUND * machines as f64 {
            continue;
        }
        let alike = may_be_wrong && curve.kind.cause == Cause::ValveLands;
        let cell = CellFile { alike, ..cell(curve, basis, responses, is_calibrated) };
        let is_plain = matches!(curve.force, HoldForce::AsDrawn | HoldForce::AsPlanned);
        if curve.kind.cause == Cause::PistonSeal && !curve.other_law && is_plain {
            cells.push(reversed(&cell));
        }
        cells.push(cell);
    }
    let mut file = CausesFile {
        basis: basis.rows.clone(),
        inverse: basis.inverse.clone(),
        ordinary: basis.ordinary.clone(),
        known_limit: 1.0,
        alike_from: simulator.settings.alike_from,
        sizes_leaks: may_be_wrong,
        fitted: simulator.settings.fitted,
        knows_dead_band: simulator.settings.knows_dead_band,
        null_is_exact: may_be_wrong,
        errors_are_even: may_be_wrong,
        cells,
        golden: Vec::new(),
    };
    let causes = Causes::from_file(file.clone()).ok()?;
    let noise = TYPICAL_NOISE / TYPICAL_CYCLES.sqrt();
    let mut distances: Vec<f64> = held_out
        .iter()
        .flat_map(|(_, responses)| responses)
        .map(|response| causes.explain(&Change { numbers: &response.numbers, noise }).distance)
        .collect();
    distances.sort_by(f64::total_cmp);
    let known = distances.get((KNOWN * distances.len() as f64) as usize).copied()?;
    // Noise and ordinary variation, which these responses lack, give 1.
    file.known_limit = significant(ROOM * (1.0 + known));
    file.golden = golden(&file, held_out)?;
    Some(file)
}

/// A seal that leaks less than at the baseline answers the other way.
fn reversed(cell: &CellFile) -> CellFile {
    CellFile {
        size: -cell.size,
        size_loadings: cell.size_loadings.iter().map(|loading| -loading).collect(),
        mean: cell.mean.iter().map(|value| -value).collect(),
        directions: cell.directions.iter().map(|d| d.iter().map(|value| -value).collect()).collect(),
        ..cell.clone()
    }
}

/// Mean and principal directions of responses.
fn cell(curve: &Curve, basis: &Basis, responses: &[Response], is_calibrated: bool) -> CellFile {
    let count = responses.len() as f64;
    let rows: Vec<Vec<f64>> = responses.iter().map(|response| basis.coordinates(&response.numbers)).collect();
    let n = basis.ordinary.len();
    let mean: Vec<f64> = (0..n).map(|i| rows.iter().map(|row| row[i]).sum::<f64>() / count).collect();
    let weights = basis.weights(TYPICAL_NOISE / TYPICAL_CYCLES.sqrt());
    let centred: Vec<Vec<f64>> = rows
        .iter()
        .map(|row| {
            row.iter()
                .zip(&mean)
                .zip(&weights)
                .map(|((value, mean), weight)| weight * (value - mean))
                .collect()
        })
        .collect();
    let covariance = |i: usize, j: usize| centred.iter().map(|row| row[i] * row[j]).sum::<f64>() / count;
    let eigen = SymmetricEigen::new(DMatrix::from_fn(n, n, covariance));
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    let size = responses.iter().map(|response| response.size).sum::<f64>() / count;
    let variance = responses.iter().map(|response| (response.size - size).powi(2)).sum::<f64>() / count;
    let (mut directions, mut size_loadings, mut explained, mut left) = (Vec::new(), Vec::new(), 0.0, 0.0);
    for (rank, column) in order.into_iter().enumerate() {
        let spread = eigen.eigenvalues[column].max(0.0);
        if rank >= RANK {
            left += spread;
            continue;
        }
        let vector = eigen.eigenvectors.column(column);
        let deviation = spread.sqrt();
        directions.push(
            vector.iter().zip(&weights).map(|(value, weight)| (deviation * value / weight) as f32).collect(),
        );
        let along = |row: &[f64]| row.iter().zip(vector.iter()).map(|(a, b)| a * b).sum::<f64>();
        let with_size = centred
            .iter()
            .zip(responses)
            .map(|(row, response)| along(row) * (response.size - size))
            .sum::<f64>()
            / count;
        let loading = if deviation > 1e-12 { with_size / deviation } else { 0.0 };
        explained += loading * loading;
        size_loadings.push(loading);
    }
    let length: f64 = mean.iter().zip(&weights).map(|(value, weight)| (value * weight).powi(2)).sum::<f64>()
        + spread_of(&eigen.eigenvalues);
    let error = curve.error(is_calibrated);
    CellFile {
        kind: curve.kind,
        other_law: curve.other_law,
        alike: false,
        size,
        size_loadings,
        size_rest: (variance - explained).max(0.0).sqrt(),
        error: (error * error + left / length.max(1e-12)).sqrt().min(LARGEST_ERROR),
        mean: mean.iter().map(|value| *value as f32).collect(),
        directions,
    }
}

fn spread_of(eigenvalues: &nalgebra::DVector<f64>) -> f64 {
    eigenvalues.iter().map(|value| value.max(0.0)).sum()
}

fn golden(file: &CausesFile, held_out: &[(usize, Vec<Response>)]) -> Option<Vec<CausesGolden>> {
    let causes = Causes::from_file(file.clone()).ok()?;
    let step = (held_out.len() / GOLDEN).max(1);
    let chosen = held_out.iter().step_by(step).take(GOLDEN).filter_map(|(_, responses)| responses.first());
    let of = |response: &Response| {
        let given = causes.explain(&Change { numbers: &response.numbers, noise: TYPICAL_NOISE });
        CausesGolden {
            numbers: response.numbers.clone(),
            noise: TYPICAL_NOISE,
            none: given.none,
            seal: given.seal,
            distance: given.distance,
        }
    };
    Some(chosen.map(of).collect())
}

/// A machine on several days within the ordinary range of load, oil and supply.
fn ordinary_days(simulator: &CauseSimulator<'_>, machine: usize, days: usize) -> Vec<Observation> {
    let stream = (purpose::ORDINARY << 32) + machine as u64;
    let mut noise = Noise::new(simulator.settings.seed, stream);
    let series = simulator.settings.spread.machine(simulator.spec, stream, &mut noise);
    let (coldest_c, warmest_c) = simulator.settings.conditions.oil_c;
    (0..days)
        .map(|_| {
            let load = noise.factor(basis::ORDINARY_LOAD);
            let supply = noise.factor(basis::ORDINARY_SUPPLY);
            Conditions::on_a_day(&series, load, noise.uniform(coldest_c, warmest_c), supply)
        })
        .collect()
}

/// Unit noise of a recording of so many samples.
fn unit_noise(seed: u64, stream: u64, samples: usize) -> Vec<f64> {
    dataset::unit_noise(&mut Noise::new(seed ^ 0x006e_6f69_7365, stream), samples)
}

#[cfg(test)]
mod tests;

//! What has changed since the baseline: the piston seal, the valve, the load, the controller, or nothing.
//!
//! A cause changes the mean command of each phase, and what the command rises by within it, in a pattern of its own. A cell is a
//! cause at some range of sizes: a normal distribution of that pattern over machines, days, laws and sizes within the range, as
//! training has simulated it. A change is explained by no cell, by one, or by one of the seal and one of another cause, whose patterns
//! then add; Bayes' rule weighs these hypotheses. [`CausesFile`] has the numbers.

mod alike;
mod bound;
mod even;
mod fit;
mod linear;
mod repeatability;
mod sizes;
mod verdict;

use alloc::format;
use alloc::vec::Vec;

use seepd_features::segment::MAX_PHASES;
use serde::{Deserialize, Serialize};

use crate::check::{check_length, has_length, within};
use crate::error::ModelError;
use crate::model::agree;
use crate::schema::{CausesFile, CausesGolden};

use repeatability::NoiseCoordinates;

pub use bound::KnownConditions;
pub use fit::UNKNOWN_LAW_ERROR;
pub use verdict::{Candidate, ChangeVerdict, Explanation, OtherLaw};

/// Most numbers that a change has: mean and rise of each phase.
pub const MAX_NUMBERS: usize = 2 * MAX_PHASES;
/// Most cells of a model.
pub const MAX_CELLS: usize = 256;
/// Most kinds: causes by side and unit.
pub const MAX_KINDS: usize = 24;
/// Most directions in which a cell's pattern is spread.
pub const MAX_RANK: usize = 2;

/// What has changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Cause {
    /// The piston seal leaks, or leaks less than at the baseline.
    PistonSeal,
    /// The valve's null is off.
    ValveNull,
    /// The valve's lands are worn: they leak around the centre.
    ValveLands,
    /// Oil is lost outside: hose, fitting, rod seal.
    ExternalLeak,
    /// More friction.
    Friction,
    /// Another load or tool.
    Load,
    /// A force that grows with the stroke.
    Spring,
    /// The oil is thicker or thinner than its ordinary temperatures make it.
    OilViscosity,
    /// The supply's pressure has changed.
    Supply,
    /// The controller's gains have changed.
    Controller,
    /// The position sensor's scale has changed.
    PositionScale,
    /// The spool sticks.
    ValveHysteresis,
    /// The valve has a dead band.
    ValveDeadBand,
}

impl Cause {
    /// Every cause, in the order of its codes in CAN frames: the seal is 0.
    pub const ALL: [Cause; 13] = [
        Cause::PistonSeal,
        Cause::ValveNull,
        Cause::ValveLands,
        Cause::ExternalLeak,
        Cause::Friction,
        Cause::Load,
        Cause::Spring,
        Cause::OilViscosity,
        Cause::Supply,
        Cause::Controller,
        Cause::PositionScale,
        Cause::ValveHysteresis,
        Cause::ValveDeadBand,
    ];

    /// Its name in files and messages.
    pub const fn name(self) -> &'static str {
        match self {
            Cause::PistonSeal => "piston_seal",
            Cause::ValveNull => "valve_null",
            Cause::ValveLands => "valve_lands",
            Cause::ExternalLeak => "external_leak",
            Cause::Friction => "friction",
            Cause::Load => "load",
            Cause::Spring => "spring",
            Cause::OilViscosity => "oil_viscosity",
            Cause::Supply => "supply",
            Cause::Controller => "controller",
            Cause::PositionScale => "position_scale",
            Cause::ValveHysteresis => "valve_hysteresis",
            Cause::ValveDeadBand => "valve_dead_band",
        }
    }
}

/// Which chamber loses oil.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Side {
    /// The cap chamber.
    Cap,
    /// The rod chamber.
    Rod,
}

impl Side {
    /// Its name in files and messages.
    pub const fn name(self) -> &'static str {
        match self {
            Side::Cap => "cap",
            Side::Rod => "rod",
        }
    }
}

/// What a size is measured in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum SizeUnit {
    /// Share: of full command, or a relative change.
    #[serde(rename = "1")]
    Share,
    /// Area, m².
    #[serde(rename = "m2")]
    Area,
    /// Flow at 7 MPa, m³/s.
    #[serde(rename = "m3/s")]
    Flow,
    /// Laminar conductance, m³/(s Pa).
    #[serde(rename = "m3/(s Pa)")]
    Conductance,
    /// Force, N.
    #[serde(rename = "N")]
    Force,
    /// Stiffness, N/m.
    #[serde(rename = "N/m")]
    Stiffness,
}

impl SizeUnit {
    /// Its name in files and messages.
    pub const fn name(self) -> &'static str {
        match self {
            SizeUnit::Share => "1",
            SizeUnit::Area => "m2",
            SizeUnit::Flow => "m3/s",
            SizeUnit::Conductance => "m3/(s Pa)",
            SizeUnit::Force => "N",
            SizeUnit::Stiffness => "N/m",
        }
    }
}

/// A cause as candidates are told apart: with its side and unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Kind {
    /// The cause.
    pub cause: Cause,
    /// Which chamber, of an external leak.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub side: Option<Side>,
    /// Unit of its sizes.
    pub unit: SizeUnit,
}

/// A change since the baseline: of each phase's mean command, then of what the command rises by within each phase.
#[derive(Debug, Clone, Copy)]
pub struct Change<'a> {
    /// The numbers now, the mean of some cycles, less the baseline's.
    pub numbers: &'a [f64],
    /// Standard deviation of the noise that is left on the command in these: that of a cycle over the root of the cycles.
    pub noise: f64,
}

/// A cell in the coordinates of the file's basis.
#[derive(Debug, Clone, Copy)]
struct Cell {
    /// Index of its kind.
    kind: usize,
    is_seal: bool,
    /// Whether it is a cause that this machine's command does not tell from a leak.
    is_alike: bool,
    /// Whether its weight is shared with the leaks' by what was known beforehand.
    shares_by_priors: bool,
    /// Whether it is a leak under laws other than an orifice's that the model's estimates have not learned, or its plant does not tell.
    has_other_law: bool,
    size: f64,
    rest: f64,
    /// The sizes of its cause that training has simulated, with this sign.
    simulated: [f64; 2],
    error: f64,
    rank: usize,
    loadings: [f64; MAX_RANK],
    /// Where its mean begins among the numbers; its directions follow.
    at: usize,
}

/// The part of a model that names causes, checked.
#[derive(Debug, Clone)]
pub struct Causes {
    file: CausesFile,
    kinds: Vec<Kind>,
    /// Natural logarithm of a cell's prior probability, alone and beside the seal.
    priors: Vec<[f64; 2]>,
    cells: Vec<Cell>,
    /// Indices of the cells of leaks, the smallest first.
    leaks: Vec<usize>,
    /// Leaks under several laws and forces lie between each other: so many of each size.
    leaks_of_a_size: usize,
    /// Means and directions of the cells.
    numbers: Vec<f64>,
    /// Where laws' errors are measured, if not in the coordinates of `numbers`.
    in_noise: Option<NoiseCoordinates>,
}

/// Leaks whose sizes are in a smaller ratio belong to one range of sizes: those of neighbouring ranges are in one of 2.2.
const ONE_SIZE: f64 = 1.5;

/// Prior probabilities: nothing has changed, the seal alone, one other cause, the seal and another.
const PRIOR_NONE: f64 = 0.25;
const PRIOR_SEAL: f64 = 0.25;
const PRIOR_OTHER: f64 = 0.42;
const PRIOR_PAIR: f64 = 0.08;
/// A seal that leaks less than at the baseline beside one that leaks more: only a new one does.
const LESS_OVER_MORE: f64 = 0.02;

impl Causes {
    /// Checks what training has made.
    ///
    /// # Errors
    /// [`ModelError`] with a path below `causes`.
    pub fn from_file(file: CausesFile) -> Result<Self, ModelError> {
        check_causes(&file, file.ordinary.len() / 2)?;
        Self::from_checked(file)
    }

    /// From a file whose structure has been checked.
    pub(crate) fn from_checked(mut file: CausesFile) -> Result<Self, ModelError> {
        let mut kinds: Vec<Kind> = Vec::new();
        let (mut cells, mut numbers) = (Vec::new(), Vec::new());
        for cell in core::mem::take(&mut file.cells) {
            let kind = kinds.iter().position(|kind| *kind == cell.kind).unwrap_or_else(|| {
                kinds.push(cell.kind);
                kinds.len() - 1
            });
            let mut loadings = [0.0; MAX_RANK];
            for (slot, loading) in loadings.iter_mut().zip(&cell.size_loadings) {
                *slot = *loading;
            }
            cells.push(Cell {
                kind,
                is_seal: cell.kind.cause == Cause::PistonSeal,
                is_alike: cell.alike && cell.kind.cause != Cause::PistonSeal,
                shares_by_priors: false,
                has_other_law: cell.other_law && cell.kind.cause == Cause::PistonSeal,
                size: cell.size,
                rest: cell.size_rest,
                simulated: [0.0; 2],
                error: cell.error,
                rank: cell.directions.len(),
                loadings,
                at: numbers.len(),
            });
            let all = cell.mean.iter().chain(cell.directions.iter().flatten());
            numbers.extend(all.map(|value| f64::from(*value)));
        }
        sizes::mark_simulated(&mut cells);
        let priors = priors(&kinds, &cells);
        let mut leaks: Vec<usize> =
            (0..cells.len()).filter(|index| cells[*index].is_seal && cells[*index].size > 0.0).collect();
        leaks.sort_by(|a, b| cells[*a].size.total_cmp(&cells[*b].size));
        let smallest = leaks.first().map_or(0.0, |index| cells[*index].size);
        let leaks_of_a_size =
            leaks.iter().take_while(|index| cells[**index].size < ONE_SIZE * smallest).count();
        let in_noise = None;
        let mut causes = Causes { file, kinds, priors, cells, leaks, leaks_of_a_size, numbers, in_noise };
        causes.mark_what_is_alike();
        for (index, golden) in causes.file.golden.iter().enumerate() {
            causes.check_golden(golden, &format!("causes.golden[{index}]"))?;
        }
        Ok(causes)
    }

    fn check_golden(&self, golden: &CausesGolden, path: &str) -> Result<(), ModelError> {
        check_length(&format!("{path}.numbers"), golden.numbers.len(), self.numbers())?;
        let given = self.explain(&Change { numbers: &golden.numbers, noise: golden.noise });
        agree(path, [(golden.none, given.none), (golden.seal, given.seal), (golden.distance, given.distance)])
    }

    /// The file without its cells.
    pub fn file(&self) -> &CausesFile {
        &self.file
    }

    /// How many numbers a change has.
    pub fn numbers(&self) -> usize {
        self.file.ordinary.len()
    }

    /// The kinds that the model knows, in the order of its cells.
    pub fn kinds(&self) -> &[Kind] {
        &self.kinds
    }
}

/// Each cause has the same prior, shared evenly by its cells.
fn priors(kinds: &[Kind], cells: &[Cell]) -> Vec<[f64; 2]> {
    let cause_of = |cell: &Cell| kinds.get(cell.kind).map(|kind| kind.cause);
    let mut others: Vec<Cause> = kinds.iter().map(|kind| kind.cause).collect();
    others.sort_unstable();
    others.dedup();
    others.retain(|cause| *cause != Cause::PistonSeal);
    let count = others.len().max(1) as f64;
    cells
        .iter()
        .map(|cell| {
            let siblings = cells.iter().filter(|other| cause_of(other) == cause_of(cell)).count() as f64;
            let [alone, beside] = match (cell.is_seal, cell.size > 0.0) {
                (true, true) => [PRIOR_SEAL, 1.0],
                (true, false) => [LESS_OVER_MORE * PRIOR_SEAL, LESS_OVER_MORE],
                (false, _) => [PRIOR_OTHER / count, PRIOR_PAIR / count],
            };
            [libm::log(alone / siblings), libm::log(beside / siblings)]
        })
        .collect()
}

pub(crate) fn check_causes(file: &CausesFile, phases: usize) -> Result<(), ModelError> {
    let numbers = 2 * phases;
    has_length("causes.ordinary", &file.ordinary, numbers)?;
    for (index, variance) in file.ordinary.iter().enumerate() {
        within(&format!("causes.ordinary[{index}]"), *variance, 0.0, 1e6)?;
    }
    has_length("causes.basis", &file.basis, numbers * numbers)?;
    has_length("causes.inverse", &file.inverse, numbers * numbers)?;
    within("causes.known_limit", file.known_limit, 1e-6, 1e9)?;
    within("causes.alike_from", file.alike_from, 0.0, 1.0)?;
    within("causes.cells.length", file.cells.len() as f64, 1.0, MAX_CELLS as f64)?;
    let mut kinds: Vec<Kind> = Vec::new();
    for (index, cell) in file.cells.iter().enumerate() {
        let path = |key: &str| format!("causes.cells[{index}].{key}");
        if !kinds.contains(&cell.kind) {
            kinds.push(cell.kind);
        }
        within(&path("kind"), kinds.len() as f64, 1.0, MAX_KINDS as f64)?;
        within(&path("size"), cell.size, -1e12, 1e12)?;
        within(&path("size_rest"), cell.size_rest, 0.0, 1e12)?;
        within(&path("error"), cell.error, 0.0, 1e3)?;
        within(&path("directions.length"), cell.directions.len() as f64, 0.0, MAX_RANK as f64)?;
        has_length(&path("size_loadings"), &cell.size_loadings, cell.directions.len())?;
        for (key, values) in core::iter::once(("mean", &cell.mean))
            .chain(cell.directions.iter().map(|direction| ("directions", direction)))
        {
            check_length(&path(key), values.len(), numbers)?;
            for value in values {
                within(&path(key), f64::from(*value), -1e6, 1e6)?;
            }
        }
    }
    Ok(())
}

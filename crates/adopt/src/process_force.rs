//! What presses against the piston where the log has no load: read off the command of its strokes.
//!
//! A force changes the pressures at the valve, and so the command that a stroke takes; a hold says little of it, where leakages that nobody
//! knows decide. Few explanations are tried, each with few unknowns: a weight that is another, a process that presses against the moves
//! out, a contact that the piston runs into, and last a force of its own for each move. Gauss and Newton fit each to the mean cycle;
//! which one is taken, if any, Schwarz's criterion says (Annals of Statistics 6 (1978)).

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};
use seepd_sim::batch::{self, Job};
use seepd_sim::cycle::{CycleRun, LoadCorner, Move, sum_of_loads};
use seepd_sim::{DutyCycle, MachineSpec, Steps};
use seepd_train::dataset::warm_up_from_s;

use crate::plant::{PlantValue, UNIFORM};
use crate::strokes::{range, slope};

/// Shares of a move's time between which a force grows: with the stroke, at its end, or all along.
const SHAPES: [(f64, f64); 3] = [(0.0, 0.3), (0.8, 1.0), (0.0, 1.0)];
/// How deep a contact is, share of the cycle's way, and points by which its force's course is given.
const DEPTHS: [f64; 5] = [0.02, 0.035, 0.05, 0.07, 0.1];
const CONTACT_POINTS: usize = 12;
/// Usual size of an unknown force, and the largest that is believed, shares of the piston's largest.
const USUAL: f64 = 0.25;
const LARGEST: f64 = 0.8;
/// How well a weight is known: its own share, and a share of the piston's largest force.
const OF_THE_WEIGHT: f64 = 0.2;
const OF_THE_PISTON: f64 = 0.01;
/// Step of a force's derivatives, share of the piston's largest.
const STEP: f64 = 0.03;
/// Step of a parameter's derivatives, standard deviations.
const PLANT_STEP: f64 = 0.5;
/// Shares of a step that are tried.
const SHORTENED: [f64; 3] = [1.0, 0.5, 0.2];
/// Steps at most.
const ITERATIONS: usize = 10;
/// An explanation that is better by less than this by Schwarz's criterion is as good as it gets.
const SETTLED: f64 = 0.3;
/// The rest of a stroke's command is worth so many independent values.
const WORTH: f64 = 10.0;
/// Least rest of the command that is told from none, share of its range.
const LEAST_REST: f64 = 0.001;
/// An explanation is worth taking from this advantage by Schwarz's criterion on: strong evidence by the usual scale (Kass, Raftery, 1995).
const STRONG: f64 = 10.0;
/// Samples of a stroke at most.
const SAMPLES: usize = 200;
/// What may be off beside a force: whatever changes the command of a stroke much.
const UNCERTAIN: [&str; 10] = [
    "valve_m3_per_s_sqrt_pa",
    "relief_pressure_pa",
    "pump_flow_m3_per_s",
    "supply_volume_m3",
    "relief_resistance_pa_s_per_m3",
    "return_pressure_pa",
    "line_m3_per_s_sqrt_pa",
    "viscous_friction_n_s_per_m",
    "bulk_modulus_pa",
    "mass_kg",
];
/// Largest standard deviation of a parameter, share, and the farthest that it is believed off, standard deviations.
const MOST_UNCERTAIN: f64 = 0.35;
const FARTHEST: f64 = 3.0;

/// Forces that explain the command.
#[derive(Debug, Clone, PartialEq)]
pub struct ProcessForce {
    /// What acts, in words.
    pub words: String,
    /// The load with it, in time order.
    pub load: Vec<LoadCorner>,
    /// RMS of the strokes' command that is left, over what was left without it.
    pub left: f64,
}

/// What a machine's moves work against, from the mean command of its planned cycle, by tick; `None` where nothing explains the strokes
/// much better than the load that the plan has. The plant's parameters may be off beside it, each as `values` tells: what a wrong valve does
/// to a stroke is no force.
pub fn read_off(
    spec: &MachineSpec,
    command: &[f64],
    values: &BTreeMap<&'static str, PlantValue>,
) -> Option<ProcessForce> {
    let problem = Problem::new(spec, command, values)?;
    let rest = problem.rest_without_force()?;
    let plain = Fit::new(&problem, Explanation::NONE, &rest);
    let plain_size = plain.best.size;
    let weight = fitted(vec![plain]).pop()?;
    let richer = explanations(&spec.cycle).into_iter().filter(|explanation| weight.may_lose_to(explanation));
    let richer = fitted(richer.map(|explanation| Fit::new(&problem, explanation, &rest)).collect());
    // The simpler explanation stands until a richer one is much better.
    let mut taken = &weight;
    for richness in 1..=MOST_RICH {
        let alike = richer.iter().filter(|fit| fit.explanation.richness() == richness);
        let best = alike.min_by(|a, b| a.best.criterion.total_cmp(&b.best.criterion));
        taken = best.filter(|best| taken.best.criterion - best.best.criterion > STRONG).unwrap_or(taken);
    }
    let forces_n = taken.forces_n(&taken.best.unknowns);
    (taken.explanation.richness() > 0).then(|| ProcessForce {
        words: taken.explanation.words.with(&forces_n),
        load: problem.load(&taken.explanation, &forces_n, false),
        left: taken.best.size / plain_size,
    })
}

/// Forces of every explanation: a constant one, as a weight that is another would be, and a friction.
const CONSTANT_AND_FRICTION: usize = 2;
/// Largest [`Explanation::richness`].
const MOST_RICH: usize = 2;

/// How an explanation is told.
#[derive(Debug, Clone, PartialEq)]
enum Words {
    Weight,
    Process,
    Contact { at_m: f64 },
    EachMove(Vec<String>),
}

impl Words {
    fn with(&self, forces_n: &[f64]) -> String {
        let force = |index: usize| 1e-3 * forces_n.get(index).copied().unwrap_or(0.0);
        match self {
            Words::Weight => format!("a constant force of {:+.1} kN", force(0)),
            Words::Process => {
                let size = force(CONSTANT_AND_FRICTION);
                format!("a force of {size:+.1} kN on the moves out, until the next move back")
            }
            Words::Contact { at_m } => {
                format!(
                    "a contact from {:.1} mm on that gives way, with {:.1} kN at the deepest",
                    1e3 * at_m,
                    -force(CONSTANT_AND_FRICTION)
                )
            }
            Words::EachMove(names) => {
                let each = names
                    .iter()
                    .enumerate()
                    .map(|(index, name)| format!("{name} {:+.1} kN", force(CONSTANT_AND_FRICTION + index)));
                format!("a force of its own for each move: {}", each.collect::<Vec<_>>().join(", "))
            }
        }
    }
}

/// Courses of force over the cycle, each 1 at its largest, beside a constant one and the friction's.
#[derive(Debug, Clone)]
struct Explanation {
    words: Words,
    profiles: Vec<Vec<LoadCorner>>,
}

impl Explanation {
    const NONE: Explanation = Explanation { words: Words::Weight, profiles: Vec::new() };

    /// How much it may explain: no force, one that a machine of its kind has, or any.
    fn richness(&self) -> usize {
        match self.words {
            Words::Weight => 0,
            Words::Process | Words::Contact { .. } => 1,
            Words::EachMove(_) => MOST_RICH,
        }
    }
}

/// Those with more than a constant force and a friction.
fn explanations(cycle: &DutyCycle) -> Vec<Explanation> {
    let moves = &cycle.moves;
    let out: Vec<f64> =
        cycle.moves_from().map(|(from_m, stroke)| f64::from(u8::from(stroke.to_m > from_m))).collect();
    let mut all = Vec::new();
    for shape in SHAPES {
        let profiles = vec![cycle.load_by_moves(&out, |_| shape)];
        all.push(Explanation { words: Words::Process, profiles });
    }
    let (low, high) = cycle.reach_m();
    for depth in DEPTHS {
        let at_m = high - depth * (high - low);
        all.push(Explanation { words: Words::Contact { at_m }, profiles: vec![contact(cycle, at_m, high)] });
    }
    // Of two moves a weight and a friction are all that there is to tell apart.
    if moves.len() > 2 {
        for shape in SHAPES {
            let one = |index: usize| -> Vec<f64> {
                (0..moves.len()).map(|k| f64::from(u8::from(k == index))).collect()
            };
            let profiles =
                (0..moves.len()).map(|index| cycle.load_by_moves(&one(index), |_| shape)).collect();
            let names = moves.iter().map(|stroke| stroke.name.clone()).collect();
            all.push(Explanation { words: Words::EachMove(names), profiles });
        }
    }
    all
}

/// The force of a contact that gives way in proportion, against the piston, over the planned positions.
fn contact(cycle: &DutyCycle, at_m: f64, deepest_m: f64) -> Vec<LoadCorner> {
    let pressed = |x: f64| -(x - at_m).max(0.0) / (deepest_m - at_m).max(f64::MIN_POSITIVE);
    let mut corners = vec![LoadCorner { at_s: 0.0, force_n: pressed(cycle.demand_m(0.0)) }];
    for stroke in &cycle.moves {
        let step_s = (stroke.to_s - stroke.from_s) / 200.0;
        let times: Vec<f64> = (0..=200).map(|k| stroke.at_s(f64::from(k) / 200.0)).collect();
        let touching: Vec<f64> =
            times.iter().copied().filter(|at_s| pressed(cycle.demand_m(*at_s)) < 0.0).collect();
        let every = touching.len().div_ceil(CONTACT_POINTS).max(1);
        let (Some(first), Some(last)) = (touching.first(), touching.last()) else { continue };
        let edges = [first - step_s, last + step_s].map(|at_s| at_s.clamp(stroke.from_s, stroke.to_s));
        let inner = touching.iter().copied().step_by(every);
        let mut times: Vec<f64> = inner.chain(edges).collect();
        times.sort_by(f64::total_cmp);
        corners.extend(
            times.into_iter().map(|at_s| LoadCorner { at_s, force_n: pressed(cycle.demand_m(at_s)) }),
        );
    }
    corners.dedup_by(|later, earlier| later.at_s <= earlier.at_s);
    corners
}

/// A parameter of the plant that may be off beside a force.
struct Uncertain {
    key: &'static str,
    /// What is known of it, and its standard deviation as a share.
    known: f64,
    share: f64,
    /// The plant's own value, in standard deviations from what is known.
    own: f64,
}

impl Uncertain {
    fn of(key: &'static str, spec: &MachineSpec, value: &PlantValue) -> Option<Self> {
        let share = (value.tolerance / UNIFORM).min(MOST_UNCERTAIN);
        let own = spec.plant.get(key)?;
        let is_open = share > 0.0 && own > 0.0 && value.value > 0.0;
        is_open.then(|| Uncertain { key, known: value.value, share, own: (own / value.value).ln() / share })
    }
}

struct Problem<'a> {
    spec: &'a MachineSpec,
    command: &'a [f64],
    ticks: Vec<usize>,
    /// Directions in which the rest says nothing of a force: another null, another moment.
    nuisances: Vec<DVector<f64>>,
    plant: Vec<Uncertain>,
    constant_n: f64,
    friction: Vec<LoadCorner>,
    largest_n: f64,
    /// Independent values that the strokes' command is worth.
    worth: f64,
    /// Least rest that is told from none.
    least: f64,
}

impl<'a> Problem<'a> {
    fn new(
        spec: &'a MachineSpec,
        command: &'a [f64],
        values: &BTreeMap<&'static str, PlantValue>,
    ) -> Option<Self> {
        let ticks = stroke_ticks(spec, command.len().checked_sub(2)?);
        let range = range(command);
        let ones = DVector::from_element(ticks.len(), 1.0);
        let slopes = DVector::from_iterator(ticks.len(), ticks.iter().map(|tick| slope(command, *tick)));
        let mean = slopes.mean();
        let nuisances =
            [ones, slopes.add_scalar(-mean)].into_iter().filter_map(|v| v.try_normalize(1e-12)).collect();
        (!ticks.is_empty() && range > 0.0).then(|| Problem {
            spec,
            command,
            ticks,
            nuisances,
            plant: UNCERTAIN.iter().filter_map(|key| Uncertain::of(key, spec, values.get(key)?)).collect(),
            constant_n: spec.cycle.load.first().map_or(0.0, |corner| corner.force_n),
            friction: friction(&spec.cycle),
            largest_n: spec.plant.cap_area_m2 * spec.plant.relief_pressure_pa,
            worth: WORTH * spec.cycle.moves.len() as f64,
            least: LEAST_REST * range,
        })
    }

    /// The load under an explanation with those forces, and with its friction where the simulation has to have it as a load.
    fn load(&self, explanation: &Explanation, forces_n: &[f64], with_friction: bool) -> Vec<LoadCorner> {
        let constant = [LoadCorner { at_s: 0.0, force_n: self.constant_n + forces_n[0] }];
        let mut loads: Vec<(f64, &[LoadCorner])> = vec![(1.0, &constant)];
        if with_friction {
            loads.push((forces_n[1], &self.friction));
        }
        let profiles = explanation.profiles.iter().zip(&forces_n[CONSTANT_AND_FRICTION..]);
        loads.extend(profiles.map(|(profile, size_n)| (*size_n, profile.as_slice())));
        sum_of_loads(&loads)
    }

    /// The machine under an explanation with those forces, its plant off by so many standard deviations.
    fn machine(
        &self,
        explanation: &Explanation,
        forces_n: &[f64],
        off: impl Iterator<Item = f64>,
    ) -> MachineSpec {
        let mut spec = self.spec.clone();
        spec.cycle.load = self.load(explanation, forces_n, true);
        for (uncertain, off) in self.plant.iter().zip(off) {
            if let Some(value) = spec.plant.get_mut(uncertain.key) {
                *value = uncertain.known * (uncertain.share * off).exp();
            }
        }
        spec
    }

    /// The plant as it is, in standard deviations from what is known.
    fn own(&self) -> impl Iterator<Item = f64> {
        self.plant.iter().map(|uncertain| uncertain.own)
    }

    /// What the machine as it is leaves of the strokes' command under no force beside the plan's; `None` where its simulation ends in no
    /// numbers.
    fn rest_without_force(&self) -> Option<DVector<f64>> {
        let machine = self.machine(&Explanation::NONE, &[0.0; CONSTANT_AND_FRICTION], self.own());
        self.rests(vec![machine]).pop().filter(|rest| rms(rest).is_finite())
    }

    /// What each machine's steady cycle leaves of the strokes' command, but for the nuisances.
    fn rests(&self, machines: Vec<MachineSpec>) -> Vec<DVector<f64>> {
        let period = self.command.len() as u64;
        let start_tick = (warm_up_from_s(self.spec) / self.spec.controller.period_s) as u64;
        let job = |spec| Job {
            spec,
            runs: vec![CycleRun::with_leak(0.0)],
            start_tick,
            skip_ticks: period.saturating_sub(start_tick),
            record_ticks: period,
        };
        let jobs: Vec<Job> = machines.into_iter().map(job).collect();
        batch::commands(&jobs, Steps::Fewest, |_, commands| {
            let rest = self.ticks.iter().map(|tick| self.command[*tick] - commands[*tick]);
            let rest = DVector::from_iterator(self.ticks.len(), rest);
            self.nuisances.iter().fold(rest, |rest, nuisance| &rest - nuisance * nuisance.dot(&rest))
        })
    }

    /// Schwarz's criterion of an explanation that leaves a rest of that size, with the square of its unknowns, each in its usual deviations.
    fn criterion(&self, explanation: &Explanation, size: f64, unlikely: f64) -> f64 {
        2.0 * self.worth * size.ln() + unlikely + explanation.profiles.len() as f64 * self.worth.ln()
    }

    /// Deviations that are usual for the forces of an explanation, N.
    fn usual_n(&self, explanation: &Explanation) -> Vec<f64> {
        let weight_n = OF_THE_WEIGHT * self.constant_n.abs() + OF_THE_PISTON * self.largest_n;
        let friction_n = OF_THE_PISTON * self.largest_n;
        let usual_n = explanation.profiles.iter().map(|_| USUAL * self.largest_n);
        [weight_n, friction_n].into_iter().chain(usual_n).collect()
    }
}

/// How well an explanation does with some unknowns.
struct Point {
    /// Forces, then the plant's parameters, each in its usual deviations.
    unknowns: DVector<f64>,
    rest: DVector<f64>,
    /// RMS of the rest.
    size: f64,
    /// Schwarz's criterion with what is known beforehand: the smaller, the better.
    criterion: f64,
}

impl Point {
    fn new(problem: &Problem, explanation: &Explanation, unknowns: DVector<f64>, rest: DVector<f64>) -> Self {
        let size = rms(&rest).hypot(problem.least);
        let criterion = problem.criterion(explanation, size, unknowns.norm_squared());
        Point { unknowns, rest, size, criterion }
    }
}

/// The fit of an explanation's forces and the plant's parameters to the strokes' command.
struct Fit<'a> {
    problem: &'a Problem<'a>,
    explanation: Explanation,
    usual_n: Vec<f64>,
    best: Point,
    is_settled: bool,
}

/// Fits taken as far as they go, side by side: the machines that one of them tries fill the lanes of a simulation in part only.
fn fitted(mut fits: Vec<Fit>) -> Vec<Fit> {
    for _ in 0..ITERATIONS {
        let mut open: Vec<&mut Fit> = fits.iter_mut().filter(|fit| !fit.is_settled).collect();
        if open.is_empty() {
            break;
        }
        let stepped: Vec<Vec<DVector<f64>>> = open.iter().map(|fit| fit.stepped()).collect();
        let slopes = rests(&open, &stepped);
        let tried: Vec<Vec<DVector<f64>>> =
            open.iter().zip(&slopes).map(|(fit, rests)| fit.tried(rests)).collect();
        let rests = rests(&open, &tried);
        for ((fit, tried), rests) in open.iter_mut().zip(tried).zip(rests) {
            fit.go_to_the_best(tried, rests);
        }
    }
    fits
}

/// What is left of the strokes' command at each fit's unknowns.
fn rests(fits: &[&mut Fit], unknowns: &[Vec<DVector<f64>>]) -> Vec<Vec<DVector<f64>>> {
    let Some(problem) = fits.first().map(|fit| fit.problem) else { return Vec::new() };
    let machines = fits
        .iter()
        .zip(unknowns)
        .flat_map(|(fit, unknowns)| unknowns.iter().map(|unknowns| fit.machine(unknowns)))
        .collect();
    let mut rests = problem.rests(machines).into_iter();
    unknowns.iter().map(|unknowns| rests.by_ref().take(unknowns.len()).collect()).collect()
}

impl<'a> Fit<'a> {
    /// No force beside the plan's, and the plant as it is, which leave that rest.
    fn new(problem: &'a Problem<'a>, explanation: Explanation, rest: &DVector<f64>) -> Self {
        let usual_n = problem.usual_n(&explanation);
        let unknowns: Vec<f64> = usual_n.iter().map(|_| 0.0).chain(problem.own()).collect();
        let best = Point::new(problem, &explanation, DVector::from_vec(unknowns), rest.clone());
        Fit { problem, explanation, usual_n, best, is_settled: false }
    }

    /// Whether another explanation would be much better if it left nothing.
    fn may_lose_to(&self, other: &Explanation) -> bool {
        let at_best = self.problem.criterion(other, self.problem.least, 0.0);
        self.best.criterion - at_best > STRONG
    }

    fn forces_n(&self, unknowns: &DVector<f64>) -> Vec<f64> {
        self.usual_n.iter().zip(unknowns.iter()).map(|(usual_n, share)| usual_n * share).collect()
    }

    fn machine(&self, unknowns: &DVector<f64>) -> MachineSpec {
        let off = unknowns.iter().skip(self.usual_n.len()).copied();
        self.problem.machine(&self.explanation, &self.forces_n(unknowns), off)
    }

    /// Steps of the unknowns for their derivatives.
    fn steps(&self) -> impl Iterator<Item = f64> {
        let of_forces = self.usual_n.iter().map(|usual_n| STEP * self.problem.largest_n / usual_n);
        of_forces.chain(self.problem.plant.iter().map(|_| PLANT_STEP))
    }

    /// The best unknowns with each of them stepped by itself.
    fn stepped(&self) -> Vec<DVector<f64>> {
        let stepped = |(index, step): (usize, f64)| {
            let mut unknowns = self.best.unknowns.clone();
            unknowns[index] += step;
            unknowns
        };
        self.steps().enumerate().map(stepped).collect()
    }

    /// Unknowns along Gauss's and Newton's step, whole and shortened, from what the stepped ones leave; none where they tell nothing.
    fn tried(&self, rests: &[DVector<f64>]) -> Vec<DVector<f64>> {
        let Some(step) = self.step(rests) else { return Vec::new() };
        let most = LARGEST * self.problem.largest_n;
        let of_forces = self.usual_n.iter().map(|usual_n| most / usual_n);
        // A plant that was fitted may be farther off already.
        let of_plant = self.problem.own().map(|own| FARTHEST.max(own.abs()));
        let farthest: Vec<f64> = of_forces.chain(of_plant).collect();
        let shortened = |share: f64| {
            let mut unknowns = &self.best.unknowns + share * &step;
            unknowns.iter_mut().zip(&farthest).for_each(|(off, most)| *off = off.clamp(-most, *most));
            unknowns
        };
        SHORTENED.map(shortened).into()
    }

    fn step(&self, rests: &[DVector<f64>]) -> Option<DVector<f64>> {
        let Point { unknowns, rest: now, size, .. } = &self.best;
        let columns: Vec<DVector<f64>> =
            rests.iter().zip(self.steps()).map(|(rest, step)| (now - rest) / step).collect();
        let jacobian = DMatrix::from_columns(&columns);
        let weight = self.problem.worth / (now.len() as f64 * size * size);
        let count = unknowns.len();
        let normal = weight * jacobian.tr_mul(&jacobian) + DMatrix::identity(count, count);
        let gradient = weight * jacobian.tr_mul(now) - unknowns;
        Some(normal.cholesky()?.solve(&gradient))
    }

    /// Goes to the best of the unknowns that were tried, where one is better, and is settled where that gains little.
    fn go_to_the_best(&mut self, tried: Vec<DVector<f64>>, rests: Vec<DVector<f64>>) {
        let points = tried
            .into_iter()
            .zip(rests)
            .map(|(unknowns, rest)| Point::new(self.problem, &self.explanation, unknowns, rest));
        let better = points
            .filter(|point| point.criterion < self.best.criterion)
            .min_by(|a, b| a.criterion.total_cmp(&b.criterion));
        let Some(better) = better else {
            self.is_settled = true;
            return;
        };
        self.is_settled = self.best.criterion - better.criterion < SETTLED;
        self.best = better;
    }
}

/// A force of 1 N against each move while it lasts, as friction is.
fn friction(cycle: &DutyCycle) -> Vec<LoadCorner> {
    let mut corners = vec![LoadCorner { at_s: 0.0, force_n: 0.0 }];
    for (from_m, stroke) in cycle.moves_from() {
        let against = (from_m - stroke.to_m).signum();
        let courses = [(0.0, 0.0), (EDGE, against), (1.0 - EDGE, against), (1.0, 0.0)];
        corners.extend(courses.map(|(share, force_n)| LoadCorner { at_s: stroke.at_s(share), force_n }));
    }
    corners.dedup_by(|later, earlier| later.at_s <= earlier.at_s);
    corners
}

/// Share of a move's time in which its friction comes and goes.
const EDGE: f64 = 0.05;

/// Ticks of the strokes, below `end`.
fn stroke_ticks(spec: &MachineSpec, end: usize) -> Vec<usize> {
    let tick_s = spec.controller.period_s;
    let of = |stroke: &Move| {
        let (from, to) =
            (((stroke.from_s / tick_s) as usize).max(1), ((stroke.to_s / tick_s) as usize).min(end));
        (from..to).step_by((to.saturating_sub(from) / SAMPLES).max(1))
    };
    spec.cycle.moves.iter().flat_map(of).collect()
}

fn rms(rest: &DVector<f64>) -> f64 {
    (rest.norm_squared() / rest.len().max(1) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use seepd_sim::cycle::load_at;

    use crate::plant::Origin;

    use super::*;

    /// The nominal press with a softer line, which takes longer steps.
    fn press() -> MachineSpec {
        let mut spec = MachineSpec::default();
        spec.plant.inlet_volume_m3 *= 4.0;
        spec.controller.steps_per_period = 3;
        spec.cycle.load = vec![LoadCorner { at_s: 0.0, force_n: -2e3 }];
        spec
    }

    fn command_of(spec: &MachineSpec, load: Vec<LoadCorner>) -> Vec<f64> {
        let mut machine = spec.clone();
        machine.cycle.load = load;
        let job = Job {
            spec: machine,
            runs: vec![CycleRun::with_leak(0.0)],
            start_tick: 0,
            skip_ticks: 10_000,
            record_ticks: 10_000,
        };
        batch::commands(&[job], Steps::Own, |_, commands| commands.to_vec()).remove(0)
    }

    fn corner(at_s: f64, force_n: f64) -> LoadCorner {
        LoadCorner { at_s, force_n }
    }

    /// A valve, a line and a relief pressure that are others than the data sheet says, each within its tolerance, are no force, and hide
    /// none: what presses against the moves out is found within a tenth.
    #[test]
    fn a_data_sheet_that_is_somewhat_wrong_makes_no_force_and_hides_none() {
        let spec = press();
        let value = |key: &'static str, tolerance: f64| {
            let value = spec.plant.get(key).unwrap();
            (key, PlantValue { value, origin: Origin::User, tolerance })
        };
        let values = BTreeMap::from([
            value("valve_m3_per_s_sqrt_pa", 0.1),
            value("relief_pressure_pa", 0.05),
            value("line_m3_per_s_sqrt_pa", 1.0),
            value("viscous_friction_n_s_per_m", 1.0),
        ]);
        let mut other = spec.clone();
        other.plant.valve_m3_per_s_sqrt_pa *= 1.08;
        other.plant.relief_pressure_pa *= 0.97;
        other.plant.line_m3_per_s_sqrt_pa *= 0.8;
        other.plant.viscous_friction_n_s_per_m *= 1.2;
        assert_eq!(read_off(&spec, &command_of(&other, spec.cycle.load.clone()), &values), None);

        let levels = [-14e3, -14e3, 0.0];
        let pressed = spec.cycle.load_by_moves(&levels, |_| (0.0, 0.3));
        let load = sum_of_loads(&[(1.0, &spec.cycle.load), (1.0, &pressed)]);
        let found = read_off(&spec, &command_of(&other, load), &values).unwrap();
        assert!(found.words.ends_with("on the moves out, until the next move back"), "{found:?}");
        for (at_s, wanted_n) in [(2.7, -16e3), (5.0, -16e3), (9.0, -2e3)] {
            let force_n = load_at(&found.load, at_s);
            assert!((force_n - wanted_n).abs() < 1600.0, "{at_s}: {force_n}");
        }
    }

    /// A press whose log has no load: what presses while it extends and holds is read off its command within a tenth, and a machine
    /// without a force gets none.
    #[test]
    fn a_force_that_the_log_does_not_have_is_read_off_the_command() {
        let spec = press();
        assert_eq!(read_off(&spec, &command_of(&spec, spec.cycle.load.clone()), &BTreeMap::new()), None);

        // It grows over the first third of `extend` and of `press`, and is gone with the first third of `retract`.
        let pressed = vec![
            corner(0.5, -2e3),
            corner(1.1, -12e3),
            corner(3.0, -12e3),
            corner(3.3, -18e3),
            corner(6.0, -18e3),
            corner(6.75, -2e3),
        ];
        let found = read_off(&spec, &command_of(&spec, pressed), &BTreeMap::new()).unwrap();
        assert!(found.left < 0.3 && found.words.contains("each move"), "{found:?}");
        for (at_s, wanted_n) in [(0.2, -2e3), (2.7, -12e3), (5.0, -18e3), (9.0, -2e3)] {
            let force_n = load_at(&found.load, at_s);
            assert!((force_n - wanted_n).abs() < 1200.0, "{at_s}: {force_n}");
        }

        // The tool meets its work 10 mm before the deepest place, which gives way by 1 kN a millimetre.
        let touching: Vec<LoadCorner> = (0..=1000)
            .map(|k| 0.01 * f64::from(k))
            .map(|at_s| corner(at_s, -2e3 - 1e6 * (spec.cycle.demand_m(at_s) - 0.37).max(0.0)))
            .collect();
        let found = read_off(&spec, &command_of(&spec, touching), &BTreeMap::new()).unwrap();
        assert!(found.words.starts_with("a contact from 37"), "{found:?}");
        let deepest_n = load_at(&found.load, 5.0);
        assert!((deepest_n + 12e3).abs() < 1500.0, "{deepest_n}");
    }
}

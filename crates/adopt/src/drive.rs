//! The duty cycle as the machine is asked for it: the demand's course by stroke, and the load.
//!
//! Where the log has no demand, it is what the controller must have been asked for. With the position that is the control law solved for
//! the error. With the command alone the demand is looked for under which the simulated machine, closed loop, gives the recorded command:
//! iterative learning (Arimoto, Kawamura, Miyazaki, Journal of Robotic Systems 1 (1984)), each pass correcting the demand by the way that
//! the rest of the command would make.

use seepd_gap::SimulatedAxis;
use seepd_sim::batch::follow;
use seepd_sim::cycle::{DriveSample, LoadCorner, Move, OpenLoop, load_at};
use seepd_sim::opening::SteadyOpening;
use seepd_sim::{DutyCycle, MachineSpec, Steps};

use crate::duty_cycle::FoundCycle;
use crate::strokes::{Guide, mean, range, slope};

/// Points of a stroke's course at most.
const COURSE_POINTS: usize = 100;
/// The command is near its hold again where it is this share of the stroke's largest from it.
const NEAR: f64 = 0.02;
/// Share of half a hold, from its middle on, that tells its rest: one over this; and the standard deviations that noise does not leave.
const REST: usize = 3;
const AT_REST: f64 = 4.0;
/// Corners of the load at most, and the share of its range that they may be off.
const LOAD_CORNERS: usize = 12;
const LOAD_TOLERANCE: f64 = 0.04;
/// A load whose range is less than this share of the largest force of the piston is constant.
const NO_LOAD: f64 = 0.01;
/// Passes of the learning, how much of the rest each takes off, and the rest, over the command's range, that is good.
const PASSES: usize = 20;
const LEARNED: f64 = 0.6;
const GOOD: f64 = 0.004;
/// Share of the stroke that an unknown position may take.
const STROKE_USED: f64 = 0.9;

/// A demand by tick of the planned cycle, and how it was come by.
#[derive(Debug, Clone)]
pub struct Asked {
    /// Demand, m.
    pub demand_m: Vec<f64>,
    /// RMS of the command that it leaves unexplained, over the command's range; `None` where it is the log's own.
    pub rest: Option<f64>,
    /// Factor by which the valve had to be made smaller for the way to fit the stroke.
    pub shrunk: f64,
}

/// The demand that the controller must have had, from the mean command and position of a cycle.
pub fn asked_by_position(spec: &MachineSpec, command: &[f64], position: &[f64]) -> Asked {
    let twice = |values: &[f64]| [values, values].concat();
    // The first cycle settles the integrator.
    let asked = spec.asked_m(&twice(command), &twice(position));
    let demand_m = asked.and_then(|asked| Some(asked.get(command.len()..)?.to_vec())).unwrap_or_default();
    Asked { demand_m, rest: None, shrunk: 1.0 }
}

/// The demand under which the machine gives the mean command of a cycle.
pub fn asked_by_command(spec: &MachineSpec, command: &[f64], load_n: &[f64]) -> Asked {
    let mut spec = spec.with_stable_steps();
    let mut inverse = Inverse::new(&spec, command, load_n);
    let mut way = inverse.way();
    let mut shrunk = 1.0;
    let room = STROKE_USED * spec.plant.stroke_m;
    if range(&way) > room {
        shrunk = room / range(&way);
        spec.plant.valve_m3_per_s_sqrt_pa *= shrunk;
        inverse = Inverse::new(&spec, command, load_n);
        way = inverse.way();
    }
    let (lowest, highest) = bounds(&way);
    let middle = 0.5 * spec.plant.stroke_m - 0.5 * (lowest + highest);
    let kp = spec.controller.kp.max(f64::MIN_POSITIVE);
    let mut demand: Vec<f64> = way
        .iter()
        .zip(command)
        .map(|(x, u)| x + middle + spec.controller.uncompensated(*u - inverse.null) / kp)
        .collect();
    let mut best = (f64::INFINITY, demand.clone());
    for _ in 0..PASSES {
        let simulated = simulated_command(&spec, &demand, load_n);
        let rest: Vec<f64> =
            command.iter().zip(&simulated).map(|(recorded, now)| recorded - inverse.null - now).collect();
        let rest_mean = mean(&rest);
        let size = (rest.iter().map(|r| (r - rest_mean).powi(2)).sum::<f64>() / rest.len() as f64).sqrt()
            / range(command);
        if !size.is_finite() {
            break;
        }
        if size < best.0 {
            best = (size, demand.clone());
        }
        if size < GOOD {
            break;
        }
        let moved = inverse.way_of(&rest);
        for ((value, way), rest) in demand.iter_mut().zip(moved).zip(&rest) {
            *value += LEARNED * (way + (rest - rest_mean) / kp);
        }
        let (low, high) = (0.0, spec.plant.stroke_m);
        demand.iter_mut().for_each(|value| *value = value.clamp(low, high));
    }
    Asked { demand_m: best.1, rest: Some(best.0), shrunk }
}

/// The steady way from command to speed, and back.
struct Inverse<'c> {
    command: &'c [f64],
    /// Speed at full command, m/s, outwards and inwards, by tick.
    speeds: Vec<[f64; 2]>,
    /// Command at which the machine stands.
    null: f64,
    opening: SteadyOpening,
    tick_s: f64,
}

impl<'c> Inverse<'c> {
    fn new(spec: &MachineSpec, command: &'c [f64], load_n: &[f64]) -> Self {
        let p = &spec.plant;
        let cubes = p.cap_area_m2.powi(3) + p.annulus_area_m2.powi(3);
        let least = 0.05 * p.annulus_area_m2 * p.relief_pressure_pa;
        let speed = |force: f64| p.valve_m3_per_s_sqrt_pa * (force.max(least) / cubes).sqrt();
        let speeds = load_n
            .iter()
            .map(|load| {
                let out =
                    p.cap_area_m2 * p.relief_pressure_pa - p.annulus_area_m2 * p.return_pressure_pa + load;
                let back =
                    p.annulus_area_m2 * p.relief_pressure_pa - p.cap_area_m2 * p.return_pressure_pa - load;
                [speed(out), speed(back)]
            })
            .collect();
        let opening = SteadyOpening::of(spec);
        let mut inverse = Inverse { command, speeds, null: 0.0, opening, tick_s: spec.controller.period_s };
        // The piston comes back: the null is where the ways out and back are the same.
        let (mut low, mut high) = (-0.3, 0.3);
        for _ in 0..50 {
            inverse.null = 0.5 * (low + high);
            if inverse.speed_sum() > 0.0 {
                low = inverse.null;
            } else {
                high = inverse.null;
            }
        }
        inverse
    }

    fn speed(&self, tick: usize) -> f64 {
        let u = self.command[tick] - self.null;
        self.opening.at(u) * self.speeds[tick][usize::from(u < 0.0)]
    }

    fn speed_sum(&self) -> f64 {
        (0..self.command.len()).map(|tick| self.speed(tick)).sum()
    }

    fn way(&self) -> Vec<f64> {
        let mut x = 0.0;
        (0..self.command.len())
            .map(|tick| {
                x += self.speed(tick) * self.tick_s;
                x
            })
            .collect()
    }

    /// Way that a change of the command makes, without its drift over a cycle.
    fn way_of(&self, change: &[f64]) -> Vec<f64> {
        let mean = mean(change);
        let mut x = 0.0;
        let way: Vec<f64> = change
            .iter()
            .zip(&self.speeds)
            .zip(self.command)
            .map(|((change, speeds), u)| {
                x += (change - mean) * speeds[usize::from(*u < self.null)] * self.tick_s;
                x
            })
            .collect();
        let drift = way.last().copied().unwrap_or(0.0) / way.len().max(1) as f64;
        way.iter().enumerate().map(|(tick, x)| x - drift * (tick + 1) as f64).collect()
    }
}

/// The simulated machine's command under a demand, in its second cycle.
fn simulated_command(spec: &MachineSpec, demand: &[f64], load_n: &[f64]) -> Vec<f64> {
    let ticks = demand.len();
    let drive = drive_of(&[demand, demand].concat(), &[load_n, load_n].concat(), spec.controller.period_s);
    let mut command = Vec::with_capacity(ticks);
    follow(std::slice::from_ref(spec), &drive, None, Steps::Fewest, |tick, signals| {
        if tick >= ticks {
            command.push(signals.command.0[0]);
        }
    });
    command
}

fn drive_of(demand: &[f64], load_n: &[f64], tick_s: f64) -> Vec<DriveSample> {
    let of = |tick: usize| DriveSample {
        load_end_n: load_n[(tick + 1) % load_n.len()],
        ..DriveSample::new(tick as f64 * tick_s, demand[tick], load_n[tick])
    };
    (0..demand.len()).map(of).collect()
}

/// The plan of the cycle: each stroke from where the command leaves its hold to where it is back at one, with the demand's course.
pub fn planned(
    found: &FoundCycle,
    demand: &[f64],
    command: &[f64],
    load: Vec<LoadCorner>,
    tick_s: f64,
) -> DutyCycle {
    let ticks = demand.len();
    let strokes = edges_by_command(found, command, tick_s);
    let count = strokes.len();
    let level = |from: usize, to: usize| {
        let span = to.saturating_sub(from);
        // The middle of a hold: its ends may still move.
        let (from, to) = (from + span / 3, (to - span / 3).max(from + span / 3 + 1));
        mean(demand.get(from..to.min(ticks)).unwrap_or_default())
    };
    let levels: Vec<f64> = (0..count)
        .map(|index| {
            let next = strokes.get(index + 1).map_or(ticks, |next| next.0);
            level(strokes[index].1.min(next.saturating_sub(1)), next)
        })
        .collect();
    let moves = found.strokes.iter().zip(&strokes).enumerate().map(|(index, (stroke, edges))| Move {
        name: stroke.name.clone(),
        from_s: edges.0 as f64 * tick_s,
        to_s: edges.1 as f64 * tick_s,
        to_m: levels[index],
        course: course(demand, *edges, (levels[(index + count - 1) % count], levels[index])),
        wait_s: found.wait_s(index),
        open_loop: stroke.open_loop.map(|part| own_command(command, *edges, part.to_s, tick_s)),
    });
    DutyCycle { period_s: ticks as f64 * tick_s, moves: moves.collect(), load }
}

/// Ticks at which the command leaves each stroke's hold before and is back at the one behind; beside where the demand stands, where it is known.
fn edges_by_command(found: &FoundCycle, command: &[f64], tick_s: f64) -> Vec<(usize, usize)> {
    let ticks = command.len();
    let at = |seconds: f64| ((seconds / tick_s).round() as usize).min(ticks.saturating_sub(1));
    let edges: Vec<(usize, usize)> =
        found.strokes.iter().map(|stroke| (at(stroke.from_s), at(stroke.to_s))).collect();
    let middles = middles(&edges, ticks);
    // Where the demand is in the log, it tells where strokes begin and end: what the command does in the holds beside them, as over a dead
    // band or until the piston has settled, is the controller's.
    let is_told = found.guide == Guide::Demand;
    let of_stroke = |(index, &(from, to)): (usize, &(usize, usize))| {
        let peak = command[from..=to].iter().map(|u| u.abs()).fold(0.0, f64::max);
        let (hold_before, hold_after) = (middles[index], middles[index + 1]);
        // What is nearest to the middle of a hold: a stroke's slow beginning and its settling are none of its rest.
        let (half_before, half_after) = (from.saturating_sub(hold_before), hold_after.saturating_sub(to));
        let before =
            Rest::of(&command[hold_before..(hold_before + half_before / REST).max(hold_before + 1)], peak);
        let settled = hold_after.saturating_sub((half_after / REST).max(1));
        let after = Rest::of(&command[settled..hold_after.max(settled + 1)], peak);
        let (earliest, latest) = match is_told {
            true => (from.saturating_sub((to - from) / 20), to + (to - from) / 20),
            false => (0, ticks),
        };
        // A command that is not at rest in the middle of a hold does not come to rest there: over a dead band it drifts from one edge to the
        // other. The stroke's own edges are taken then.
        let (first, last) = (hold_before.max(earliest), middle_of_hold(&edges, index, ticks).min(latest));
        let leaves = (first..from)
            .find(|tick| before.is_left_by(command[*tick]))
            .filter(|tick| *tick > first || is_told)
            .unwrap_or(from);
        let returns = (to..last)
            .rev()
            .find(|tick| after.is_left_by(command[*tick]))
            .filter(|tick| tick + 1 < last || is_told)
            .map_or(to, |tick| tick + 1);
        (leaves, returns.max(leaves + 2))
    };
    edges.iter().enumerate().map(of_stroke).collect()
}

/// The command of a hold.
struct Rest {
    level: f64,
    /// Less than this from its level it is at rest.
    room: f64,
}

impl Rest {
    /// Of the part of a hold, beside a stroke whose command goes up to that.
    fn of(hold: &[f64], peak: f64) -> Self {
        let level = mean(hold);
        let variance = hold.iter().map(|u| (u - level).powi(2)).sum::<f64>() / hold.len().max(1) as f64;
        let (early, late) = hold.split_at(hold.len() / 2);
        // Over a dead band the command drifts through the whole hold, as fast as here: it never comes to rest, nor leaves it.
        let drift = 2.0 * REST as f64 * (mean(early) - mean(late)).abs();
        let drifts = hold.len() > 1 && drift > NEAR * peak;
        let room = if drifts { f64::INFINITY } else { (NEAR * peak).max(AT_REST * variance.sqrt()) };
        Rest { level, room }
    }

    fn is_left_by(&self, command: f64) -> bool {
        (command - self.level).abs() > self.room
    }
}

/// Middle of the hold after a stroke; the cycle's end ends the last one.
fn middle_of_hold(edges: &[(usize, usize)], index: usize, ticks: usize) -> usize {
    edges[index].1.midpoint(edges.get(index + 1).map_or(ticks, |next| next.0))
}

/// Middle of each hold: before the first stroke, between strokes, and after the last one.
fn middles(edges: &[(usize, usize)], ticks: usize) -> Vec<usize> {
    let mut middles = vec![0];
    middles.extend((1..edges.len()).map(|next| middle_of_hold(edges, next - 1, ticks)));
    middles.push(ticks);
    middles
}

/// The open-loop part of a move between two ticks, with the command that it has in the mean cycle.
fn own_command(command: &[f64], (from, to): (usize, usize), to_s: f64, tick_s: f64) -> OpenLoop {
    let ends = ((to_s / tick_s).round() as usize).clamp(from + 1, to.saturating_sub(2).max(from + 1));
    let steps = (ends - from).min(COURSE_POINTS);
    let at = |step: usize| {
        let place = from as f64 + (ends - from) as f64 * step as f64 / steps as f64;
        let (low, high) = (place as usize, (place as usize + 1).min(command.len() - 1));
        let value = command[low] + (command[high] - command[low]) * place.fract();
        (value.clamp(-1.0, 1.0) * 1e6).round() / 1e6
    };
    OpenLoop { to_s: ends as f64 * tick_s, command: (0..=steps).map(at).collect() }
}

/// Share of the way at equal steps of a stroke's time.
fn course(demand: &[f64], (from, to): (usize, usize), (before, after): (f64, f64)) -> Vec<f64> {
    let steps = (to - from).clamp(2, COURSE_POINTS);
    let way = after - before;
    if way == 0.0 {
        return Vec::new();
    }
    let share = |step: usize| {
        let place = from as f64 + (to - from) as f64 * step as f64 / steps as f64;
        let (low, high) = (place as usize, (place as usize + 1).min(demand.len() - 1));
        let value = demand[low] + (demand[high] - demand[low]) * place.fract();
        // Six digits of a way are a micrometre in a metre.
        (((value - before) / way).clamp(-0.5, 1.5) * 1e6).round() / 1e6
    };
    (0..=steps)
        .map(|step| match step {
            0 => 0.0,
            _ if step == steps => 1.0,
            _ => share(step),
        })
        .collect()
}

/// The load's corners: the fewest between which it is linear within a share of its range (Douglas, Peucker, Cartographica 10 (1973)),
/// beside the weight.
pub fn load_corners(load_n: Option<&[f64]>, weight_n: f64, largest_n: f64, tick_s: f64) -> Vec<LoadCorner> {
    let constant =
        |force_n: f64| if force_n == 0.0 { Vec::new() } else { vec![LoadCorner { at_s: 0.0, force_n }] };
    let Some(load) = load_n.filter(|load| load.len() > 2) else { return constant(weight_n) };
    if range(load) < NO_LOAD * largest_n {
        // A measured load has the weight in it.
        return constant(mean(load));
    }
    let mut kept = vec![0, load.len() - 1];
    while kept.len() < LOAD_CORNERS {
        let furthest = kept
            .windows(2)
            .flat_map(|pair| (pair[0] + 1..pair[1]).map(move |tick| (tick, pair[0], pair[1])))
            .map(|(tick, from, to)| {
                let line = load[from] + (load[to] - load[from]) * (tick - from) as f64 / (to - from) as f64;
                (tick, (load[tick] - line).abs())
            })
            .max_by(|a, b| a.1.total_cmp(&b.1));
        let Some((tick, _)) = furthest.filter(|(_, off)| *off > LOAD_TOLERANCE * range(load)) else { break };
        kept.push(tick);
        kept.sort_unstable();
    }
    kept.into_iter().map(|tick| LoadCorner { at_s: tick as f64 * tick_s, force_n: load[tick] }).collect()
}

/// The plan's load by tick, N.
pub fn load_by_tick(load: &[LoadCorner], ticks: usize, tick_s: f64) -> Vec<f64> {
    (0..ticks).map(|tick| load_at(load, tick as f64 * tick_s)).collect()
}

/// Speed over command where a recording moves, m/s at full command; `None` without a position.
pub fn speed_over_command(command: &[f64], position: &[f64], tick_s: f64) -> Option<f64> {
    let ticks = command.len().min(position.len());
    let largest = command.iter().map(|u| u.abs()).fold(0.0, f64::max);
    let pairs: Vec<(f64, f64)> = (0..ticks)
        .map(|tick| (command[tick], slope(&position[..ticks], tick) / tick_s))
        .filter(|(u, _)| u.abs() > 0.3 * largest)
        .collect();
    let (uv, uu) = pairs.iter().fold((0.0, 0.0), |(uv, uu), (u, v)| (uv + u * v, uu + u * u));
    (uu > 0.0).then(|| uv / uu).filter(|speed| *speed > 0.0)
}

fn bounds(values: &[f64]) -> (f64, f64) {
    values
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(*value), high.max(*value)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::duty_cycle::{CycleStroke, Duration};

    /// The nominal press's own command leads back to its own demand.
    #[test]
    fn the_demand_is_found_under_which_the_machine_gives_the_command() {
        let spec = MachineSpec::default();
        let ticks = 10_000;
        let demand: Vec<f64> = (0..ticks).map(|tick| spec.cycle.demand_m(tick as f64 * 1e-3)).collect();
        let load = load_by_tick(&spec.cycle.load, ticks, 1e-3);
        let command = simulated_command(&spec, &demand, &load);
        let asked = asked_by_command(&spec, &command, &load);
        assert!(asked.rest.unwrap() < 0.01, "{:?}", asked.rest);
        assert_eq!(asked.shrunk, 1.0);
        let way = range(&asked.demand_m);
        assert!((way / range(&demand) - 1.0).abs() < 0.05, "{way}");
    }

    /// Over an overlap a hold's command drifts from one edge of the dead band to the other: the stroke ends where the position stands, not
    /// where the drift ends, which may be the cycle's end. A loop that settles early in its hold ends its stroke where it has. Where the demand
    /// is in the log, its strokes are the plan's, however long the loop takes to settle.
    #[test]
    fn a_command_that_drifts_through_its_hold_does_not_make_the_stroke_longer() {
        let (ticks, tick_s) = (2_000, 0.01);
        let stroke = |name: &str, from_s: f64, to_s: f64, way: f64| CycleStroke {
            name: name.into(),
            from_s,
            to_s,
            way,
            hold_after: Duration { median_s: 8.0, least_s: 8.0, most_s: 8.0 },
            open_loop: None,
        };
        let found_by = |guide: Guide| FoundCycle {
            guide,
            period_s: 20.0,
            period: Duration { median_s: 20.0, least_s: 20.0, most_s: 20.0 },
            strokes: vec![stroke("extend", 1.0, 3.0, 0.1), stroke("retract", 11.0, 13.0, -0.1)],
            cycles: Vec::new(),
            left_out: 0,
            rest: 0.0,
        };
        let demand: Vec<f64> = (0..ticks)
            .map(|tick| match tick as f64 * tick_s {
                at_s if at_s < 1.0 => 0.1,
                at_s if at_s < 3.0 => 0.1 + 0.05 * (at_s - 1.0),
                at_s if at_s < 11.0 => 0.2,
                at_s if at_s < 13.0 => 0.2 - 0.05 * (at_s - 11.0),
                _ => 0.1,
            })
            .collect();
        let ends_s = |guide: Guide, time_constant_s: f64| -> Vec<(f64, f64)> {
            let after = |since_s: f64, side: f64| side * (0.25 * (-since_s / time_constant_s).exp() - 0.09);
            let command: Vec<f64> = (0..ticks)
                .map(|tick| match tick as f64 * tick_s {
                    at_s if at_s < 1.0 => after(at_s + 7.0, -1.0),
                    at_s if at_s < 3.0 => 0.4,
                    at_s if at_s < 11.0 => after(at_s - 3.0, 1.0),
                    at_s if at_s < 13.0 => -0.4,
                    at_s => after(at_s - 13.0, -1.0),
                })
                .collect();
            let cycle = planned(&found_by(guide), &demand, &command, Vec::new(), tick_s);
            cycle.moves.iter().map(|stroke| (stroke.from_s, stroke.to_s)).collect()
        };
        assert_eq!(ends_s(Guide::Position, 5.0), [(1.0, 3.0), (11.0, 13.0)]);
        let settled = ends_s(Guide::Position, 0.05);
        let late = |((_, to_s), stands_s): (&(f64, f64), f64)| (0.1..0.3).contains(&(to_s - stands_s));
        assert!(settled.iter().zip([3.0, 13.0]).all(late), "{settled:?}");
        // A twentieth of the stroke is left for what finding its edges takes.
        for time_constant_s in [0.05, 0.5, 5.0] {
            let told = ends_s(Guide::Demand, time_constant_s);
            let near = |((from_s, to_s), (begins_s, stands_s)): (&(f64, f64), (f64, f64))| {
                (begins_s - from_s).abs() <= 0.1 + tick_s && (to_s - stands_s).abs() <= 0.1 + tick_s
            };
            assert!(told.iter().zip([(1.0, 3.0), (11.0, 13.0)]).all(near), "{told:?}");
        }
    }

    #[test]
    fn the_load_is_a_few_corners() {
        let spec = MachineSpec::default();
        let load = load_by_tick(&spec.cycle.load, 10_000, 1e-3);
        let corners = load_corners(Some(&load), 0.0, 5e4, 1e-3);
        assert!(corners.len() <= 8, "{corners:?}");
        let again = load_by_tick(&corners, 10_000, 1e-3);
        let off = load.iter().zip(&again).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < 0.05 * range(&load), "{off}");
        assert_eq!(load_corners(None, -500.0, 5e4, 1e-3), [LoadCorner { at_s: 0.0, force_n: -500.0 }]);
    }
}

//! Which strokes begin open loop, with a command of their own: told by demand and position.
//!
//! While the valve gets a command of its own, as in a rapid traverse, a controller's demand follows the measured position, so that taking
//! over is no jump. In the mean cycle their difference is then nothing but noise, while the piston accelerates and runs: no position loop
//! does that, since its command is made of that difference.

use seepd_signals::Signal;
use seepd_sim::cycle::Move;
use seepd_sim::{Input, Machine, MachineSpec, Schedule};

use crate::duty_cycle::FoundCycle;
use crate::recording::Recording;
use crate::strokes::{noise_of, range};

/// The open-loop beginning of a stroke.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OpenLoopPart {
    /// Where position control begins, s from the cycle's start as planned.
    pub to_s: f64,
    /// The command's largest value by magnitude, share of full command.
    pub command: f64,
}

/// Ticks of the mean cycle that is looked at, about.
const TICKS: f64 = 20_000.0;
/// A difference within so many standard deviations of the mean's noise is noise, and so is this share of the position's range.
const DEVIATIONS: f64 = 4.0;
const RESOLUTION: f64 = 2e-6;
/// Ticks over which the difference is averaged.
const SMOOTHED: usize = 5;
/// The part takes this share of its stroke at least, and begins within this share of it.
const LEAST_SHARE: f64 = 0.15;
const BEGINS_WITHIN: f64 = 0.08;
/// Its mean command, share of the cycle's largest, at least.
const LEAST_COMMAND: f64 = 0.08;
/// Most of the difference that moving under position control has, RMS, that the part may have.
const MUCH_SMALLER: f64 = 0.1;
/// Between an open-loop part and the rest of its stroke the piston stands this share of the part's time at most.
const SHORT_STOP: f64 = 0.35;

/// The mean cycle, and what noise it has.
struct MeanCycle {
    command: Vec<f64>,
    /// Demand less position, m.
    error_m: Vec<f64>,
    tolerance_m: f64,
    tick_s: f64,
}

impl MeanCycle {
    fn of(recording: &Recording, found: &FoundCycle) -> Option<Self> {
        let tick_s = (1.0 / recording.rate_hz).max(found.period_s / TICKS);
        let mean = |signal| found.mean_of(recording, signal, tick_s);
        let (command, demand) = (mean(Signal::Command)?, mean(Signal::Demand)?);
        let position = mean(Signal::Position)?;
        let noise = |signal| recording.log.get(signal).map_or(0.0, noise_of);
        let noise_m = noise(Signal::Position).hypot(noise(Signal::Demand));
        let tolerance_m =
            DEVIATIONS * noise_m / (found.cycles.len() as f64).sqrt() + RESOLUTION * range(&position);
        let apart: Vec<f64> = demand.iter().zip(&position).map(|(asked, is)| asked - is).collect();
        Some(MeanCycle { command, error_m: crate::strokes::smoothed(&apart, SMOOTHED), tolerance_m, tick_s })
    }

    fn tick(&self, at_s: f64) -> usize {
        ((at_s / self.tick_s).round().max(0.0) as usize).min(self.command.len())
    }

    fn is_noise(&self, tick: usize) -> bool {
        self.error_m[tick].abs() <= self.tolerance_m
    }

    /// The ticks in which a stroke's demand is its position from its beginning on, up to `most`.
    fn candidate(&self, from_s: f64, to_s: f64, most_s: f64) -> Option<(usize, usize)> {
        let (from, to, most) = (self.tick(from_s), self.tick(to_s), self.tick(most_s));
        let latest = from + ((BEGINS_WITHIN * (to - from) as f64) as usize).max(2 * SMOOTHED);
        let begins = (from..latest.min(most)).find(|tick| self.is_noise(*tick))?;
        let ends = (begins..most).find(|tick| !self.is_noise(*tick)).unwrap_or(most);
        Some((begins, ends))
    }

    fn mean_command(&self, (from, to): (usize, usize)) -> f64 {
        self.command[from..to].iter().map(|u| u.abs()).sum::<f64>() / (to - from).max(1) as f64
    }

    /// RMS of the difference over some ticks.
    fn rms_m(&self, ticks: impl Iterator<Item = usize>) -> f64 {
        let (sum, count) = ticks.fold((0.0, 0usize), |(sum, count), tick| {
            (sum + self.error_m[tick] * self.error_m[tick], count + 1)
        });
        (sum / count.max(1) as f64).sqrt()
    }
}

/// The duty cycle with the open-loop parts of its strokes, as far as demand and position tell them. A stroke that stands for a moment where
/// position control takes over is one stroke.
pub fn with_open_loop(recording: &Recording, mut found: FoundCycle) -> FoundCycle {
    let Some(mean) = MeanCycle::of(recording, &found) else { return found };
    let largest = mean.command.iter().map(|u| u.abs()).fold(0.0, f64::max);
    let candidates: Vec<Option<(usize, usize)>> = (0..found.strokes.len())
        .map(|index| {
            let stroke = &found.strokes[index];
            let next_s = found.strokes.get(index + 1).map_or(found.period_s, |next| next.to_s);
            let ticks = mean.candidate(stroke.from_s, stroke.to_s, next_s.max(stroke.to_s))?;
            let share = (ticks.1 - ticks.0) as f64 * mean.tick_s / (stroke.to_s - stroke.from_s);
            (share >= LEAST_SHARE && mean.mean_command(ticks) >= LEAST_COMMAND * largest).then_some(ticks)
        })
        .collect();
    let is_open = |tick: &usize| candidates.iter().flatten().any(|(from, to)| (*from..*to).contains(tick));
    let moving = found.strokes.iter().flat_map(|stroke| mean.tick(stroke.from_s)..mean.tick(stroke.to_s));
    let controlled_m = mean.rms_m(moving.filter(|tick| !is_open(tick)));
    // From the last on, so that indices before stay.
    for (index, ticks) in candidates.iter().enumerate().rev() {
        let Some((from, to)) = *ticks else { continue };
        if mean.rms_m(from..to) > MUCH_SMALLER * controlled_m {
            continue;
        }
        let to_s = to as f64 * mean.tick_s;
        if to_s >= found.strokes[index].to_s {
            if !goes_on(&found, index, from as f64 * mean.tick_s) {
                continue;
            }
            found.join(index);
        }
        let command = mean.command[from..to]
            .iter()
            .copied()
            .fold(0.0, |most: f64, u| if u.abs() > most.abs() { u } else { most });
        found.strokes[index].open_loop = Some(OpenLoopPart { to_s, command });
    }
    found
}

/// Whether the next stroke goes the same way after a stop of the same short time in every cycle.
fn goes_on(found: &FoundCycle, index: usize, from_s: f64) -> bool {
    let (Some(stroke), Some(next)) = (found.strokes.get(index), found.strokes.get(index + 1)) else {
        return false;
    };
    let stop_s = next.from_s - stroke.to_s;
    stroke.way * next.way > 0.0
        && stop_s <= SHORT_STOP * (stroke.to_s - from_s)
        && !found.varying_holds().contains(&index)
}

/// Times that the commands are corrected, and how far by all of them at most, as a factor to either side.
const CORRECTIONS: usize = 4;
const MOST_CORRECTED: f64 = 1.6;
/// A way below this share of the cycle's says nothing of its command.
const LEAST_WAY: f64 = 0.02;

/// The machine with open-loop commands under which it goes as far as planned, where it is sound: what a valve passes at one opening is not
/// in proportion to what it passes at another, and no position loop makes up for that here. Gives the largest change of a command's opening,
/// as a share, beside it.
pub fn going_as_far(spec: &MachineSpec) -> (MachineSpec, f64) {
    let half_width = seepd_sim::series::deadband(spec);
    let mut corrected = spec.clone();
    let mut factors = vec![1.0; spec.cycle.moves.len()];
    for _ in 0..CORRECTIONS {
        let Some(ratios) = planned_over_simulated(&corrected) else { return (spec.clone(), 0.0) };
        for (index, ratio) in ratios.into_iter().enumerate() {
            factors[index] = (factors[index] * ratio).clamp(1.0 / MOST_CORRECTED, MOST_CORRECTED);
            let own = spec.cycle.moves[index].open_loop.as_ref();
            if let (Some(open), Some(own)) = (&mut corrected.cycle.moves[index].open_loop, own) {
                let opened = |u: &f64| {
                    let opening = (u.abs() - half_width).max(0.0);
                    (u + (factors[index] - 1.0) * opening.copysign(*u)).clamp(-1.0, 1.0)
                };
                open.command = own.command.iter().map(opened).collect();
            }
        }
    }
    let most = factors.iter().map(|factor| (factor - 1.0).abs()).fold(0.0, f64::max);
    (corrected, most)
}

/// Planned way over simulated way of each move's open-loop part in a second cycle; 1 without one. `None` where the simulation goes out of
/// bounds.
fn planned_over_simulated(spec: &MachineSpec) -> Option<Vec<f64>> {
    let machine = Machine::<f64>::new(&[spec]);
    let mut state = machine.start();
    let tick_s = spec.controller.period_s;
    let ticks = (spec.cycle.period_s / tick_s).round() as usize;
    let position: Vec<f64> = Schedule::new(&spec.cycle, tick_s, Vec::new())
        .take(2 * ticks)
        .map(|sample| machine.tick(&mut state, &Input::gather(&[sample])).position)
        .skip(ticks)
        .collect();
    let (low, high) = spec.cycle.reach_m();
    let at = |at_s: f64| position.get(((at_s / tick_s).round() as usize).min(ticks.saturating_sub(1)));
    let ratio = |stroke: &Move| -> Option<f64> {
        let Some(open) = &stroke.open_loop else { return Some(1.0) };
        let planned_m = spec.cycle.demand_m(open.to_s) - spec.cycle.demand_m(stroke.from_s);
        let way_m = at(open.to_s)? - at(stroke.from_s)?;
        if !way_m.is_finite() {
            return None;
        }
        let tells = way_m * planned_m > 0.0 && planned_m.abs() > LEAST_WAY * (high - low);
        Some(if tells { planned_m / way_m } else { 1.0 })
    };
    spec.cycle.moves.iter().map(ratio).collect()
}

#[cfg(test)]
mod tests {
    use seepd_sim::cycle::{CycleRun, OpenLoop};

    use super::*;
    use crate::controller::fit_gains;
    use crate::drive::planned;
    use crate::duty_cycle::find_duty_cycle;
    use crate::test_recordings::{TICK_S, TICKS_OF_CYCLE, press, recorded};

    /// Whose `retract`, from 6.0 to 8.5 s, begins open loop until then, with a command that is over a little before.
    fn begun_open_loop(to_s: f64) -> MachineSpec {
        let mut spec = press();
        let command = vec![0.0, -0.35, -0.35, -0.35, -0.35, -0.35, -0.35, 0.0, 0.0];
        spec.cycle.moves[2].open_loop = Some(OpenLoop { to_s, command });
        // Position control begins from rest, as controllers plan a stroke anew.
        let handed_over = ((to_s - 6.0) / 2.5 * 100.0).round() as usize;
        let gone = 0.1 * handed_over as f64 / 100.0 * 4.0;
        let course = (0..=100usize).map(|step| match step.checked_sub(handed_over) {
            None => gone * step as f64 / handed_over as f64,
            Some(after) => {
                let tau = after as f64 / (100 - handed_over) as f64;
                gone + (1.0 - gone) * 0.5 * (1.0 - (std::f64::consts::PI * tau).cos())
            }
        });
        spec.cycle.moves[2].course = course.collect();
        spec.check().unwrap();
        spec
    }

    /// The command of a plan's second cycle.
    fn command_of(spec: &MachineSpec, leak_area_m2: f64) -> Vec<f64> {
        let machine = Machine::<f64>::new(&[spec]);
        let mut state = machine.start();
        Schedule::new(&spec.cycle, TICK_S, vec![CycleRun::with_leak(leak_area_m2)])
            .take(2 * TICKS_OF_CYCLE)
            .map(|sample| machine.tick(&mut state, &Input::gather(&[sample])).command)
            .skip(TICKS_OF_CYCLE)
            .collect()
    }

    /// A stroke that stands for a moment where position control takes over, or not, is one stroke with its open-loop part; its controller's
    /// gains are read off the rest; and its plan answers to a leak as the machine does.
    #[test]
    fn a_stroke_that_begins_open_loop_is_found_and_planned() {
        for to_s in [6.8, 7.2] {
            let truth = begun_open_loop(to_s);
            let recording = recorded(&truth);
            let found = find_duty_cycle(&recording, 0.0).unwrap();
            assert_eq!(found.strokes.len(), 3, "{:?}", found.strokes);
            let parts: Vec<_> = found.strokes.iter().map(|stroke| stroke.open_loop).collect();
            let retract = found.strokes.iter().position(|stroke| stroke.way < 0.0).unwrap();
            let part = parts[retract].unwrap();
            assert_eq!(parts.iter().flatten().count(), 1, "{parts:?}");
            let long_s = part.to_s - found.strokes[retract].from_s;
            assert!((long_s - (to_s - 6.0)).abs() < 0.15, "{part:?} {:?}", found.strokes[retract]);
            assert!((part.command + 0.35).abs() < 0.01, "{part:?}");

            let mean = |signal| found.mean_of(&recording, signal, TICK_S).unwrap();
            let (command, demand) = (mean(Signal::Command), mean(Signal::Demand));
            let position = mean(Signal::Position);
            let open = found.open_ticks(TICK_S);
            let gains = fit_gains(&command, &demand, &position, TICK_S, &open, None).unwrap();
            let c = &truth.controller;
            assert!((gains.kp / c.kp - 1.0).abs() < 0.02 && gains.explained > 0.99, "{gains:?}");
            assert!((gains.ki / c.ki - 1.0).abs() < 0.1, "{gains:?}");
            let blind = fit_gains(&command, &demand, &position, TICK_S, &[], None);
            assert!(blind.is_none_or(|gains| gains.explained < 0.9), "{blind:?}");

            let adopted =
                MachineSpec { cycle: planned(&found, &demand, &command, Vec::new(), TICK_S), ..press() };
            adopted.check().unwrap();
            let shift = (found.strokes[retract].from_s - 6.0) / TICK_S;
            let answer = |spec: &MachineSpec, shift: f64| -> Vec<f64> {
                let (worn, sound) = (command_of(spec, 1e-6), command_of(spec, 0.0));
                let at =
                    |tick: usize| ((tick as f64 + shift).round().max(0.0) as usize).min(TICKS_OF_CYCLE - 1);
                (5_000..9_000).map(|tick| worn[at(tick)] - sound[at(tick)]).collect()
            };
            let rms =
                |values: &[f64]| (values.iter().map(|u| u * u).sum::<f64>() / values.len() as f64).sqrt();
            let (true_answer, planned_answer) = (answer(&truth, 0.0), answer(&adopted, shift));
            let apart: Vec<f64> = true_answer.iter().zip(&planned_answer).map(|(a, b)| a - b).collect();
            assert!(rms(&apart) < 0.1 * rms(&true_answer), "{} {}", rms(&apart), rms(&true_answer));
            let mut closed = adopted.clone();
            closed.cycle.moves.iter_mut().for_each(|stroke| stroke.open_loop = None);
            let apart: Vec<f64> =
                true_answer.iter().zip(&answer(&closed, shift)).map(|(a, b)| a - b).collect();
            assert!(rms(&apart) > 0.2 * rms(&true_answer), "{} {}", rms(&apart), rms(&true_answer));
        }
    }

    /// A plant whose valve passes less than the machine's opens it further in the open-loop part, and the healthy machine goes as planned.
    #[test]
    fn an_open_loop_command_is_corrected_until_the_way_is_the_planned_one() {
        let mut spec = begun_open_loop(7.0);
        let as_far = planned_over_simulated(&spec).unwrap();
        let way_m = |spec: &MachineSpec| spec.cycle.demand_m(7.0) - spec.cycle.demand_m(6.0);
        let simulated_m = way_m(&spec) / as_far[2];
        // The plan is where the machine goes: its course has that way.
        let whole_m = spec.cycle.moves[2].to_m - spec.cycle.moves[1].to_m;
        let factor = simulated_m / way_m(&spec);
        for share in &mut spec.cycle.moves[2].course[..=40] {
            *share *= factor;
        }
        assert!((way_m(&spec) / simulated_m - 1.0).abs() < 0.02 && whole_m < 0.0);
        let (same, change) = going_as_far(&spec);
        assert!(change < 0.02 && same.cycle.moves[0] == spec.cycle.moves[0], "{change}");
        spec.plant.valve_m3_per_s_sqrt_pa *= 0.85;
        let (corrected, change) = going_as_far(&spec);
        assert!((change - 0.176).abs() < 0.03, "{change}");
        let left = planned_over_simulated(&corrected).unwrap()[2];
        assert!((left - 1.0).abs() < 1e-3, "{left}");
    }

    /// A position loop whose feed-forward leaves hardly an error runs its strokes under control all the same.
    #[test]
    fn a_stroke_under_position_control_has_no_open_loop_part() {
        for feed_forward in [0.0, 1.2] {
            let mut spec = press();
            spec.controller.kp = 30.0;
            spec.controller.velocity_feed_forward_s_per_m = feed_forward;
            let found = find_duty_cycle(&recorded(&spec), 0.0).unwrap();
            assert!(found.strokes.iter().all(|stroke| stroke.open_loop.is_none()), "{:?}", found.strokes);
        }
    }
}

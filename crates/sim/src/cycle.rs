//! The duty cycle: what the machine is asked to do, over and over.

use serde::{Deserialize, Serialize};

use crate::controller::is_zero;

/// A move of the demand to a new position: quintic, or of a course of its own.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Move {
    /// Name of the stroke in reports and features.
    pub name: String,
    /// Start in the cycle, s.
    pub from_s: f64,
    /// End in the cycle, s.
    pub to_s: f64,
    /// Position reached, m.
    pub to_m: f64,
    /// Share of the way at equal steps of time, from 0 to 1, linear between them; empty: the quintic.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub course: Vec<f64>,
    /// How much longer than planned the machine may stand after the move, where an event ends the hold, s.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub wait_s: f64,
    /// A beginning without position control.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub open_loop: Option<OpenLoop>,
}

/// The beginning of a move in which the valve gets a command of its own, as in a rapid traverse. The demand is the measured position
/// meanwhile. Then position control leads the piston from where it is to the move's end.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OpenLoop {
    /// Time in the cycle at which position control begins, s.
    pub to_s: f64,
    /// Command at equal steps of time from the move's start to there, share of full command, linear between them.
    pub command: Vec<f64>,
}

/// Who makes the command at a tick, of one machine or of several in lanes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct OpenLoopTick<T> {
    /// 1 where the command is the move's own, 0 where the controller makes it.
    pub is_open: T,
    /// The move's own command, share of full command.
    pub command: T,
    /// By how much of the distance at which position control began beside the planned position the demand is beside the planned one: 1
    /// until then, 0 from the move's end on.
    pub carried: T,
}

/// Share of a move's way that is left at the least for the rest of the way to say how the demand comes back to its plan: else time does.
const LEAST_WAY_LEFT: f64 = 0.02;

impl Move {
    /// Share of the way at a share of the time.
    fn progress(&self, tau: f64) -> f64 {
        let tau = tau.clamp(0.0, 1.0);
        if self.course.len() > 1 { at_share(&self.course, tau) } else { quintic(tau) }
    }

    /// Share of the way at a time in the cycle.
    fn progress_at(&self, at_s: f64) -> f64 {
        self.progress((at_s - self.from_s) / (self.to_s - self.from_s))
    }

    /// Demand at a time in the cycle of a move that begins at a position, m.
    fn between(&self, from_m: f64, at_s: f64) -> f64 {
        from_m + (self.to_m - from_m) * self.progress_at(at_s)
    }

    /// Who makes the command at a time in the cycle.
    fn open_loop_at(&self, at_s: f64) -> Option<OpenLoopTick<f64>> {
        let open = self.open_loop.as_ref().filter(|_| (self.from_s..self.to_s).contains(&at_s))?;
        if at_s < open.to_s {
            let share = (at_s - self.from_s) / (open.to_s - self.from_s);
            return Some(OpenLoopTick {
                is_open: 1.0,
                command: at_share(&open.command, share),
                carried: 1.0,
            });
        }
        let left = 1.0 - self.progress_at(open.to_s);
        let carried = if left > LEAST_WAY_LEFT {
            ((1.0 - self.progress_at(at_s)) / left).clamp(0.0, 1.0)
        } else {
            1.0 - quintic((at_s - open.to_s) / (self.to_s - open.to_s))
        };
        Some(OpenLoopTick { is_open: 0.0, command: 0.0, carried })
    }

    /// Time in the cycle at a share of the move's time, s.
    pub fn at_s(&self, share: f64) -> f64 {
        self.from_s + share * (self.to_s - self.from_s)
    }

    /// Share of the time at which half of the way is first behind it.
    pub fn half_way(&self) -> f64 {
        let Some(after) = self.course.iter().position(|share| *share >= 0.5).filter(|after| *after > 0)
        else {
            return 0.5;
        };
        let (from, to) = (self.course[after - 1], self.course[after]);
        (after as f64 - (to - 0.5) / (to - from)) / (self.course.len() - 1) as f64
    }
}

/// A corner of the piecewise linear load.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LoadCorner {
    /// Time in the cycle, s.
    pub at_s: f64,
    /// Force, N, positive in the extending direction.
    pub force_n: f64,
}

/// Load at a time, N: linear between its corners, constant outside them, none without a corner.
pub fn load_at(corners: &[LoadCorner], at_s: f64) -> f64 {
    load_after(corners, corners.partition_point(|corner| corner.at_s <= at_s), at_s)
}

/// Load at a time before which so many corners are, N.
fn load_after(corners: &[LoadCorner], after: usize, at_s: f64) -> f64 {
    match (after.checked_sub(1).map(|before| &corners[before]), corners.get(after)) {
        (Some(a), Some(b)) => a.force_n + (b.force_n - a.force_n) * ((at_s - a.at_s) / (b.at_s - a.at_s)),
        (Some(only), None) | (None, Some(only)) => only.force_n,
        (None, None) => 0.0,
    }
}

/// Loads one on the other, each with the factor by which it counts.
pub fn sum_of_loads(loads: &[(f64, &[LoadCorner])]) -> Vec<LoadCorner> {
    let corners = loads.iter().flat_map(|(_, load)| load.iter());
    let mut times: Vec<f64> = corners.map(|corner| corner.at_s).collect();
    times.sort_by(f64::total_cmp);
    times.dedup();
    let sum = |at_s: f64| loads.iter().map(|(factor, load)| factor * load_at(load, at_s)).sum();
    times.into_iter().map(|at_s| LoadCorner { at_s, force_n: sum(at_s) }).collect()
}

/// The duty cycle: the `[cycle]` table of `plant.toml`. Before the first move the demand is where the last
/// one ends; the load is linear between its corners and constant outside them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DutyCycle {
    /// Period, s.
    pub period_s: f64,
    /// Moves of the demand in time order.
    pub moves: Vec<Move>,
    /// Corners of the load in time order.
    pub load: Vec<LoadCorner>,
}

impl Default for DutyCycle {
    fn default() -> Self {
        let stroke = |name: &str, from_s, to_s, to_m| Move {
            name: name.into(),
            from_s,
            to_s,
            to_m,
            course: Vec::new(),
            wait_s: 0.0,
            open_loop: None,
        };
        let corner = |at_s, force_n| LoadCorner { at_s, force_n };
        DutyCycle {
            period_s: 10.0,
            moves: vec![
                stroke("extend", 0.5, 2.5, 0.35),
                stroke("press", 3.0, 4.0, 0.38),
                stroke("retract", 6.0, 8.5, 0.10),
            ],
            load: vec![corner(3.20, -2e3), corner(3.25, -15e3), corner(5.60, -15e3), corner(5.65, -2e3)],
        }
    }
}

/// The value at a share of a row of values at equal steps, linear between them; 0 without any.
fn at_share(values: &[f64], share: f64) -> f64 {
    let Some(steps) = values.len().checked_sub(1).filter(|steps| *steps > 0) else {
        return values.first().copied().unwrap_or(0.0);
    };
    let place = share * steps as f64;
    let before = (place as usize).min(steps - 1);
    let (from, to) = (values[before], values[before + 1]);
    from + (to - from) * (place - before as f64)
}

/// `10 τ³ − 15 τ⁴ + 6 τ⁵`: from 0 to 1 with no velocity and no acceleration at either end.
fn quintic(tau: f64) -> f64 {
    tau * tau * tau * (10.0 + tau * (6.0 * tau - 15.0))
}

impl DutyCycle {
    /// Where the demand stands as a cycle begins, m.
    pub fn start_position_m(&self) -> f64 {
        self.moves.last().map_or(0.0, |last| last.to_m)
    }

    /// Demand at a time within the cycle, m.
    ///
    /// ```
    /// let cycle = seepd_sim::DutyCycle::default();
    /// // It extends from 0.10 m to 0.35 m between 0.5 s and 2.5 s.
    /// assert!((cycle.demand_m(1.5) - 0.225).abs() < 1e-12);
    /// assert_eq!(cycle.demand_m(2.75), 0.35);
    /// ```
    pub fn demand_m(&self, at_s: f64) -> f64 {
        let mut position = self.start_position_m();
        for stroke in &self.moves {
            if at_s < stroke.from_s {
                break;
            }
            position = stroke.between(position, at_s);
        }
        position
    }

    /// Where the demand of each move begins and where it ends, m.
    fn ways_m(&self) -> Vec<(f64, f64)> {
        let mut from_m = self.start_position_m();
        let way = |stroke: &Move| {
            let end_m = stroke.between(from_m, stroke.to_s);
            (std::mem::replace(&mut from_m, end_m), end_m)
        };
        self.moves.iter().map(way).collect()
    }

    /// Whether a move begins open loop.
    pub fn has_open_loop(&self) -> bool {
        self.moves.iter().any(|stroke| stroke.open_loop.is_some())
    }

    /// Who makes the command at a time within the cycle.
    pub fn open_loop_at(&self, at_s: f64) -> OpenLoopTick<f64> {
        self.moves.iter().find_map(|stroke| stroke.open_loop_at(at_s)).unwrap_or_default()
    }

    /// Each move with the position from which it starts, m.
    pub fn moves_from(&self) -> impl Iterator<Item = (f64, &Move)> {
        let mut from_m = self.start_position_m();
        self.moves.iter().map(move |stroke| (std::mem::replace(&mut from_m, stroke.to_m), stroke))
    }

    /// The lowest and the highest position at which a move ends, m.
    pub fn reach_m(&self) -> (f64, f64) {
        let ends = self.moves.iter().map(|stroke| stroke.to_m);
        ends.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), end| (low.min(end), high.max(end)))
    }

    /// Load at a time within the cycle, N.
    pub fn load_n(&self, at_s: f64) -> f64 {
        load_at(&self.load, at_s)
    }

    /// A load that each move brings to a level of its own, N, which lasts until the next one. `grows` tells the shares of a move's time
    /// between which a level comes.
    pub fn load_by_moves(&self, levels_n: &[f64], grows: impl Fn(f64) -> (f64, f64)) -> Vec<LoadCorner> {
        let mut before = levels_n.last().copied().unwrap_or(0.0);
        let mut corners = vec![LoadCorner { at_s: 0.0, force_n: before }];
        for (stroke, level) in self.moves.iter().zip(levels_n) {
            let (from, to) = grows(*level);
            corners.push(LoadCorner { at_s: stroke.at_s(from), force_n: before });
            corners.push(LoadCorner { at_s: stroke.at_s(to), force_n: *level });
            before = *level;
        }
        corners.dedup_by(|later, earlier| later.at_s <= earlier.at_s);
        corners
    }
}

/// One run of the duty cycle and how it differs from the plan.
#[derive(Debug, Clone, PartialEq)]
pub struct CycleRun {
    /// Leak area, m².
    pub leak_area_m2: f64,
    /// Load over the plan's load, 1.
    pub load_factor: f64,
    /// Time scale: the run lasts `stretch` · period.
    pub stretch: f64,
    /// Standstill after the run, s.
    pub pause_s: f64,
}

impl CycleRun {
    /// A run as planned with that leak.
    pub fn with_leak(leak_area_m2: f64) -> Self {
        CycleRun { leak_area_m2, load_factor: 1.0, stretch: 1.0, pause_s: 0.0 }
    }
}

/// Duty cycles one after the other: the drive of one machine, tick by tick.
#[derive(Debug, Clone)]
pub struct Schedule {
    cycle: DutyCycle,
    period_s: f64,
    runs: Vec<CycleRun>,
    run: usize,
    tick: u64,
    ticks_of_run: u64,
    /// Load at the tick, N: the end of the one before.
    load_n: f64,
    /// Where each move begins and where it ends, m.
    ways_m: Vec<(f64, f64)>,
    /// Moves of the run that have begun, and corners of its load that are behind: time only goes on within a run.
    begun: usize,
    passed: usize,
}

/// The drive at one controller tick: what the machine is asked for and what acts on it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DriveSample {
    /// Number of the run, from 0.
    pub run: usize,
    /// Time in the duty cycle as planned, s.
    pub at_s: f64,
    /// Demand, m.
    pub demand_m: f64,
    /// Command, share of full: what moves a machine without a controller.
    pub command: f64,
    /// Load at the tick, N.
    pub load_n: f64,
    /// Load at the next tick, N.
    pub load_end_n: f64,
    /// Leak area, m².
    pub leak_area_m2: f64,
    /// Who makes the command of a machine with a controller.
    pub open_loop: OpenLoopTick<f64>,
}

impl DriveSample {
    /// A controller that makes its own command is asked for a position under a load that stays; nothing leaks.
    pub fn new(at_s: f64, demand_m: f64, load_n: f64) -> Self {
        DriveSample {
            run: 0,
            at_s,
            demand_m,
            command: 0.0,
            load_n,
            load_end_n: load_n,
            leak_area_m2: 0.0,
            open_loop: OpenLoopTick::default(),
        }
    }
}

/// Where a run begins that no duty cycle precedes: at rest, with what is known of the chambers' pressures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RunStart {
    /// Position, m.
    pub position_m: f64,
    /// Cap chamber's pressure, Pa.
    pub p_cap_pa: Option<f64>,
    /// Rod chamber's pressure, Pa.
    pub p_rod_pa: Option<f64>,
}

impl Schedule {
    /// The runs of a duty cycle under a controller of that period, s. After the last run it goes on with
    /// repetitions of that one; no runs at all means runs as planned without a leak.
    pub fn new(cycle: &DutyCycle, controller_period_s: f64, mut runs: Vec<CycleRun>) -> Self {
        if runs.is_empty() {
            runs.push(CycleRun::with_leak(0.0));
        }
        let mut schedule = Schedule {
            cycle: cycle.clone(),
            period_s: controller_period_s,
            runs,
            run: 0,
            tick: 0,
            ticks_of_run: 0,
            load_n: 0.0,
            ways_m: cycle.ways_m(),
            begun: 0,
            passed: 0,
        };
        schedule.ticks_of_run = schedule.ticks_of(0);
        schedule.load_n = schedule.load_at(0, 0);
        schedule
    }

    /// The same drive from a tick of the first run on.
    #[must_use]
    pub fn starting_at(mut self, tick: u64) -> Self {
        self.tick = tick.min(self.ticks_of_run - 1);
        self.load_n = self.load_at(0, self.tick);
        self
    }

    fn at(&self, run: usize) -> &CycleRun {
        &self.runs[run.min(self.runs.len() - 1)]
    }

    /// Controller ticks of a run, its pause included.
    pub fn ticks_of(&self, run: usize) -> u64 {
        let run = self.at(run);
        ((self.cycle.period_s * run.stretch + run.pause_s) / self.period_s).round().max(1.0) as u64
    }

    /// A run that takes longer goes the same way, more slowly.
    fn open_loop_at(&self, at_s: f64, stretch: f64) -> OpenLoopTick<f64> {
        let tick = self.cycle.open_loop_at(at_s);
        OpenLoopTick { command: tick.command / stretch, ..tick }
    }

    /// Load at a tick of a run, N, not before the one that was asked for last.
    fn load_at(&mut self, run: usize, tick: u64) -> f64 {
        let &CycleRun { stretch, load_factor, .. } = self.at(run);
        let at_s = tick as f64 * self.period_s / stretch;
        if tick == 0 {
            self.passed = 0;
        }
        let ahead = self.cycle.load.iter().skip(self.passed);
        self.passed += ahead.take_while(|corner| corner.at_s <= at_s).count();
        load_after(&self.cycle.load, self.passed, at_s) * load_factor
    }

    /// Demand at a time within the run, m, not before the one that was asked for last.
    fn demand_at(&mut self, at_s: f64) -> f64 {
        let ahead = self.cycle.moves.iter().skip(self.begun);
        self.begun += ahead.take_while(|stroke| stroke.from_s <= at_s).count();
        let Some(last) = self.begun.checked_sub(1) else { return self.cycle.start_position_m() };
        let (stroke, (from_m, end_m)) = (&self.cycle.moves[last], self.ways_m[last]);
        if at_s >= stroke.to_s { end_m } else { stroke.between(from_m, at_s) }
    }
}

impl Iterator for Schedule {
    type Item = DriveSample;

    fn next(&mut self) -> Option<DriveSample> {
        let (run, tick) = (self.run, self.tick);
        self.tick += 1;
        if self.tick == self.ticks_of_run {
            self.run += 1;
            self.tick = 0;
            self.ticks_of_run = self.ticks_of(self.run);
        }
        let load_end_n = self.load_at(self.run, self.tick);
        let load_n = std::mem::replace(&mut self.load_n, load_end_n);
        let &CycleRun { stretch, leak_area_m2, .. } = self.at(run);
        let at_s = tick as f64 * self.period_s / stretch;
        if tick == 0 {
            self.begun = 0;
        }
        Some(DriveSample {
            run,
            at_s,
            demand_m: self.demand_at(at_s),
            command: 0.0,
            load_n,
            load_end_n,
            leak_area_m2,
            open_loop: self.open_loop_at(at_s, stretch),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The drive goes along its cycle as the cycle is asked for at each time, to the bit: over pauses, other time scales, a start within a
    /// run, steps of the load and moves that follow one another at once.
    #[test]
    fn a_drive_is_the_cycle_at_each_of_its_times() {
        let mut cycle = DutyCycle::default();
        cycle.moves[1].from_s = cycle.moves[0].to_s;
        cycle.moves[2].course = vec![0.0, 0.1, 0.7, 0.999];
        cycle.load.insert(2, LoadCorner { at_s: 3.25, force_n: -9e3 });
        let run =
            |stretch, pause_s| CycleRun { stretch, pause_s, load_factor: 1.1, ..CycleRun::with_leak(1e-7) };
        let runs = vec![run(1.0, 0.0), run(0.93, 0.4), run(1.07, 0.0)];
        for start_tick in [0, 4_321] {
            let schedule = Schedule::new(&cycle, 1e-3, runs.clone()).starting_at(start_tick);
            let ticks = [0, 1, 2].map(|run| schedule.ticks_of(run));
            let (mut tick, mut run) = (start_tick, 0);
            for sample in schedule.take(40_000) {
                let of = &runs[run.min(2)];
                let at_s = tick as f64 * 1e-3 / of.stretch;
                let expected = [cycle.demand_m(at_s), cycle.load_n(at_s) * of.load_factor];
                assert_eq!(
                    [sample.demand_m, sample.load_n].map(f64::to_bits),
                    expected.map(f64::to_bits),
                    "{at_s}"
                );
                tick += 1;
                if tick == ticks[run.min(2)] {
                    (tick, run) = (0, run + 1);
                }
            }
        }
    }

    #[test]
    fn loads_add_up() {
        let cycle = DutyCycle::default();
        let pressed = cycle.load_by_moves(&[0.0, -100.0, 0.0], |_| (0.5, 1.0));
        let both = sum_of_loads(&[(1.0, &cycle.load), (-2.0, &pressed)]);
        for (at_s, wanted_n) in [(1.0, -2e3), (3.75, -15e3 + 100.0), (5.0, -15e3 + 200.0), (9.0, -2e3)] {
            let sum_n = load_at(&both, at_s);
            assert!((sum_n - wanted_n).abs() < 1e-9, "{at_s}: {sum_n}");
        }
        assert_eq!(sum_of_loads(&[]), []);
        assert_eq!(cycle.reach_m(), (0.10, 0.38));
        let from: Vec<f64> = cycle.moves_from().map(|(from_m, _)| from_m).collect();
        assert_eq!(from, [0.10, 0.35, 0.38]);
    }

    #[test]
    fn a_move_follows_its_course() {
        let mut cycle = DutyCycle::default();
        cycle.moves[0].course = vec![0.0, 0.25, 0.75, 1.0];
        // A third of the time has passed at the second number; between numbers the way is linear.
        let third_s = 2.0 / 3.0;
        assert!((cycle.demand_m(0.5 + third_s) - (0.10 + 0.25 * 0.25)).abs() < 1e-12);
        assert!((cycle.demand_m(0.5 + 1.5 * third_s) - (0.10 + 0.25 * 0.5)).abs() < 1e-12);
        assert_eq!(cycle.demand_m(2.6), 0.35);
        assert_eq!(cycle.moves[0].half_way(), 0.5);
        cycle.moves[0].course = vec![0.0, 0.5, 1.0, 1.0];
        assert!((cycle.moves[0].half_way() - 1.0 / 3.0).abs() < 1e-12);
        assert_eq!(cycle.moves[1].half_way(), 0.5);
    }
}

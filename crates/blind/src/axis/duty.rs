//! Duty cycles: moves with their profiles, dwells, pauses, and what a log may begin with.

use seepd_sim::noise::Noise;
use serde::{Deserialize, Serialize};

/// A duty cycle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Duty {
    /// Where it begins and ends, m.
    pub start_m: f64,
    /// Its moves; the last leads back to the start.
    pub moves: Vec<Move>,
    /// Share by which dwells vary from cycle to cycle: 0 where a clock drives the machine.
    pub dwell_spread: f64,
    /// Probability of a pause after a cycle.
    pub pause_probability: f64,
    /// Share by which forces vary from cycle to cycle.
    pub force_spread: f64,
}

/// A move and the dwell after it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Move {
    /// Where it leads, m.
    pub to_m: f64,
    /// How long it takes, s.
    pub duration_s: f64,
    /// Shape of the demand.
    pub profile: Profile,
    /// A beginning without position control.
    pub rapid: Option<Rapid>,
    /// Process force that has grown by its end, N, positive where it extends.
    pub force_n: f64,
    /// Dwell after it, s.
    pub dwell_s: f64,
}

/// A rapid traverse on a command of its own; from where it ends, position control goes on.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Rapid {
    /// Largest command, share of full command.
    pub command: f64,
    /// Its part of the move's time, s.
    pub duration_s: f64,
}

/// Shape of a move's demand.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Profile {
    /// Constant acceleration, speed and deceleration.
    Trapezoid {
        /// Share of the move that each ramp of the speed takes.
        ramp: f64,
    },
    /// The same with ramps of the speed that begin and end without a jerk.
    Rounded {
        /// Share of the move that each ramp of the speed takes.
        ramp: f64,
    },
    /// Half a period of a cosine.
    Cosine,
}

impl Profile {
    /// Way and speed at a share of the move's time, both of a move of 1 in 1 s.
    pub(super) fn at(self, share: f64) -> (f64, f64) {
        use std::f64::consts::PI;
        if share <= 0.0 || share >= 1.0 {
            return (share.clamp(0.0, 1.0), 0.0);
        }
        // Both halves are the same.
        if share > 0.5 {
            let (way, speed) = self.at(1.0 - share);
            return (1.0 - way, speed);
        }
        let peak = self.peak();
        match self {
            Profile::Trapezoid { ramp } if share < ramp => {
                (0.5 * peak * share * share / ramp, peak * share / ramp)
            }
            Profile::Rounded { ramp } if share < ramp => {
                let angle = PI * share / ramp;
                (0.5 * peak * (share - ramp / PI * angle.sin()), 0.5 * peak * (1.0 - angle.cos()))
            }
            Profile::Trapezoid { ramp } | Profile::Rounded { ramp } => (peak * (share - 0.5 * ramp), peak),
            Profile::Cosine => (0.5 - 0.5 * (PI * share).cos(), 0.5 * PI * (PI * share).sin()),
        }
    }

    /// Largest speed over the mean one.
    pub(super) fn peak(self) -> f64 {
        match self {
            Profile::Trapezoid { ramp } | Profile::Rounded { ramp } => 1.0 / (1.0 - ramp),
            Profile::Cosine => std::f64::consts::FRAC_PI_2,
        }
    }
}

impl Duty {
    /// Length of a cycle without variation, s.
    pub fn period_s(&self) -> f64 {
        self.moves.iter().map(|step| step.duration_s + step.dwell_s).sum()
    }

    /// Ways of the moves, m, positive where they extend.
    pub(super) fn ways_m(&self) -> impl Iterator<Item = f64> {
        self.origins_m().zip(&self.moves).map(|(from_m, step)| step.to_m - from_m)
    }

    /// Where the moves begin, m.
    pub(super) fn origins_m(&self) -> impl Iterator<Item = f64> {
        std::iter::once(self.start_m).chain(self.moves.iter().map(|step| step.to_m))
    }
}

/// What a log begins with before the machine works.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Beginning {
    /// The middle of a cycle.
    AtWork,
    /// A minute in which nothing moves.
    Idle,
    /// A manual run.
    Manual,
}

/// Share of a move within which its process force grows.
const FORCE_WITHIN: f64 = 0.3;
/// Length of an idle beginning, s.
const IDLE_S: f64 = 60.0;
/// Moves of a manual run.
const MANUAL_MOVES: usize = 5;

/// What the machine does from the first to the last second of a log.
#[derive(Debug, Clone)]
pub(super) struct Timeline {
    segments: Vec<Segment>,
    /// When each cycle begins, s.
    pub(super) cycles_s: Vec<f64>,
    /// When the log begins, and ends, s.
    pub(super) logged_s: (f64, f64),
}

/// A move and its dwell.
#[derive(Debug, Clone, Copy)]
struct Segment {
    begin_s: f64,
    from_m: f64,
    force_from_n: f64,
    step: Move,
}

/// What the machine is to do at a time.
#[derive(Debug, Clone, Copy)]
pub(super) struct Order {
    pub(super) demand_m: f64,
    pub(super) demand_m_per_s: f64,
    pub(super) force_n: f64,
    /// Command of a rapid traverse.
    pub(super) rapid: Option<f64>,
}

impl Timeline {
    /// Plans the beginning, which warms the machine up, and the cycles.
    pub(super) fn plan(duty: &Duty, cycles: usize, beginning: Beginning, noise: &mut Noise) -> Self {
        let mut line = Timeline { segments: Vec::new(), cycles_s: Vec::new(), logged_s: (0.0, 0.0) };
        let mut end_s = line.begin(duty, beginning, noise);
        for _ in 0..cycles {
            line.cycles_s.push(end_s);
            end_s = line.cycle(duty, end_s, noise);
            if noise.uniform(0.0, 1.0) < duty.pause_probability {
                end_s += noise.uniform(0.3, 2.0) * duty.period_s();
            }
        }
        line.logged_s.1 = end_s;
        line
    }

    fn begin(&mut self, duty: &Duty, beginning: Beginning, noise: &mut Noise) -> f64 {
        match beginning {
            Beginning::AtWork => {
                let end_s = self.cycle(duty, 0.0, noise);
                self.logged_s.0 = noise.uniform(0.1, 0.95) * end_s;
                end_s
            }
            Beginning::Idle => IDLE_S,
            Beginning::Manual => self.manual(duty, noise),
        }
    }

    /// Slow moves to anywhere on the machine's way, as a setter makes them, and back.
    fn manual(&mut self, duty: &Duty, noise: &mut Noise) -> f64 {
        let (low, high) = duty
            .origins_m()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), at_m| (low.min(at_m), high.max(at_m)));
        let slowest = duty.moves.iter().map(|step| step.duration_s).fold(0.0, f64::max);
        let mut end_s = noise.uniform(1.0, 5.0);
        for index in 0..MANUAL_MOVES {
            let back = index + 1 == MANUAL_MOVES;
            // The middle half of the way, so that a setter meets no part.
            let to_m =
                if back { duty.start_m } else { noise.uniform(0.75 * low + 0.25 * high, 0.5 * (low + high)) };
            let step = Move {
                to_m,
                duration_s: slowest * noise.uniform(1.5, 4.0),
                profile: Profile::Rounded { ramp: 0.2 },
                rapid: None,
                force_n: 0.0,
                dwell_s: noise.uniform(0.5, 8.0),
            };
            end_s = self.push(end_s, duty.start_m, step);
        }
        end_s
    }

    fn cycle(&mut self, duty: &Duty, begin_s: f64, noise: &mut Noise) -> f64 {
        let force = noise.factor(duty.force_spread);
        duty.moves.iter().fold(begin_s, |end_s, step| {
            let dwell_s = step.dwell_s * noise.factor(duty.dwell_spread);
            self.push(end_s, duty.start_m, Move { force_n: step.force_n * force, dwell_s, ..*step })
        })
    }

    /// Adds a move; when it and its dwell are over, s.
    fn push(&mut self, begin_s: f64, start_m: f64, step: Move) -> f64 {
        let last = self.segments.last().map(|segment| segment.step);
        let from_m = last.map_or(start_m, |last| last.to_m);
        let force_from_n = last.map_or(0.0, |last| last.force_n);
        self.segments.push(Segment { begin_s, from_m, force_from_n, step });
        begin_s + step.duration_s + step.dwell_s
    }
}

/// Who works through a timeline, from its beginning on.
#[derive(Debug)]
pub(super) struct Follower<'a> {
    coming: &'a [Segment],
    now: Segment,
    /// Where position control of the move began, m.
    from_m: f64,
}

impl<'a> Follower<'a> {
    /// At rest at the start.
    pub(super) fn new(timeline: &'a Timeline, start_m: f64) -> Self {
        let rest = Move {
            to_m: start_m,
            duration_s: 1.0,
            profile: Profile::Cosine,
            rapid: None,
            force_n: 0.0,
            dwell_s: 0.0,
        };
        let now = Segment { begin_s: 0.0, from_m: start_m, force_from_n: 0.0, step: rest };
        Follower { coming: &timeline.segments, now, from_m: start_m }
    }

    /// What the machine is to do at a time that is not before the last one, s, while it is at `position_m`.
    pub(super) fn order(&mut self, at_s: f64, position_m: f64) -> Order {
        while let Some((next, later)) = self.coming.split_first().filter(|(next, _)| next.begin_s <= at_s) {
            (self.now, self.from_m, self.coming) = (*next, next.from_m, later);
        }
        let Segment { begin_s, force_from_n, step, .. } = self.now;
        let since_s = at_s - begin_s;
        let grown = (since_s / step.duration_s / FORCE_WITHIN).clamp(0.0, 1.0);
        let force_n = force_from_n + (step.force_n - force_from_n) * grown;
        if let Some(rapid) = step.rapid.filter(|rapid| since_s < rapid.duration_s) {
            self.from_m = position_m;
            let (_, speed) = step.profile.at(since_s / rapid.duration_s);
            let command = rapid.command * speed / step.profile.peak();
            return Order { demand_m: position_m, demand_m_per_s: 0.0, force_n, rapid: Some(command) };
        }
        let rapid_s = step.rapid.map_or(0.0, |rapid| rapid.duration_s);
        let controlled_s = step.duration_s - rapid_s;
        let (way, speed) = step.profile.at((since_s - rapid_s) / controlled_s);
        Order {
            demand_m: self.from_m + (step.to_m - self.from_m) * way,
            demand_m_per_s: (step.to_m - self.from_m) * speed / controlled_s,
            force_n,
            rapid: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PROFILES: [Profile; 3] =
        [Profile::Trapezoid { ramp: 0.25 }, Profile::Rounded { ramp: 0.3 }, Profile::Cosine];

    #[test]
    fn property_a_profile_goes_its_whole_way_at_the_speed_that_it_states() {
        for profile in PROFILES {
            let mut way = 0.0;
            let mut fastest: f64 = 0.0;
            for index in 0..10_000 {
                let (at, speed) = profile.at((f64::from(index) + 0.5) * 1e-4);
                way += speed * 1e-4;
                fastest = fastest.max(speed);
                assert!((at - way).abs() < 2e-4, "{profile:?} at {index}: {at} after {way}");
            }
            assert!((way - 1.0).abs() < 1e-6, "{profile:?}: {way}");
            assert!((fastest / profile.peak() - 1.0).abs() < 1e-6, "{profile:?}: {fastest}");
        }
    }

    #[test]
    fn a_timeline_has_its_cycles_one_after_the_other() {
        let step = |to_m, force_n| Move {
            to_m,
            duration_s: 1.0,
            profile: Profile::Cosine,
            rapid: None,
            force_n,
            dwell_s: 0.5,
        };
        let duty = Duty {
            start_m: 0.1,
            moves: vec![step(0.3, -1000.0), step(0.1, 0.0)],
            dwell_spread: 0.0,
            pause_probability: 0.0,
            force_spread: 0.0,
        };
        let line = Timeline::plan(&duty, 2, Beginning::Idle, &mut Noise::new(1, 1));
        assert_eq!(line.cycles_s, [60.0, 63.0]);
        assert_eq!(line.logged_s, (0.0, 66.0));
        let mut follower = Follower::new(&line, 0.1);
        let idle = follower.order(30.0, 0.1);
        assert_eq!((idle.demand_m, idle.demand_m_per_s, idle.force_n), (0.1, 0.0, 0.0));
        let middle = follower.order(60.5, 0.2);
        assert!((middle.demand_m - 0.2).abs() < 1e-12 && middle.force_n == -1000.0, "{middle:?}");
        assert!((middle.demand_m_per_s - 0.2 * std::f64::consts::FRAC_PI_2).abs() < 1e-12, "{middle:?}");
    }

    #[test]
    fn position_control_goes_on_from_where_a_rapid_traverse_ends() {
        let step = Move {
            to_m: 0.5,
            duration_s: 3.0,
            profile: Profile::Cosine,
            rapid: Some(Rapid { command: 0.8, duration_s: 1.0 }),
            force_n: 0.0,
            dwell_s: 1.0,
        };
        let back = Move { to_m: 0.1, rapid: None, ..step };
        let duty = Duty {
            start_m: 0.1,
            moves: vec![step, back],
            dwell_spread: 0.0,
            pause_probability: 0.0,
            force_spread: 0.0,
        };
        let line = Timeline::plan(&duty, 1, Beginning::Idle, &mut Noise::new(1, 1));
        let mut follower = Follower::new(&line, 0.1);
        let rapid = follower.order(60.5, 0.27);
        assert_eq!(rapid.demand_m, 0.27);
        assert!((rapid.rapid.unwrap() - 0.8).abs() < 1e-12, "{rapid:?}");
        follower.order(60.999, 0.4);
        // Half way from 0.4 m to 0.5 m after half of what is left of the move.
        let controlled = follower.order(62.0, 0.42);
        assert!((controlled.demand_m - 0.45).abs() < 1e-12 && controlled.rapid.is_none(), "{controlled:?}");
    }
}

//! Whether a machine does what its builder would let it out of the shop with: it follows its demand, comes to rest, and does not hunt.

use seepd_sim::noise::Noise;

use super::duty::{Beginning, Timeline};
use super::machine::{Leak, Machine};
use super::run::{Day, LogSample, run};

/// Cycles that it is watched for.
const CYCLES: usize = 3;
/// Dwells that are long enough to come to rest in, s.
const LONG_S: f64 = 0.4;
/// Largest distance from the demand at the end of a dwell, and largest motion in its second half, shares of the machine's way.
const AT_REST: (f64, f64) = (0.05, 0.004);
/// Largest distance from the demand on the way, share of the machine's way.
const FOLLOWING: f64 = 0.4;
/// Largest share of the time with a full command.
const FULL: f64 = 0.3;
/// Smallest of the largest commands.
const USED: f64 = 0.18;

/// What was seen of a machine at work.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Conduct {
    /// Largest distance from the demand, m.
    pub(super) behind_m: f64,
    /// Largest distance from the demand at the end of a dwell, m.
    pub(super) off_at_rest_m: f64,
    /// Largest motion in the second half of a dwell, m.
    pub(super) motion_at_rest_m: f64,
    /// Largest command.
    pub(super) largest_command: f64,
    /// Share of the time with a full command.
    pub(super) full: f64,
    /// Whether all stayed finite.
    pub(super) finite: bool,
}

/// Whether a machine is decent with this leak.
pub(super) fn decent(machine: &Machine, leak: Leak) -> bool {
    let (low_m, high_m) = way_m(machine);
    let conduct = conduct(machine, leak);
    let way_m = high_m - low_m;
    conduct.finite
        && conduct.behind_m < FOLLOWING * way_m
        && conduct.off_at_rest_m < AT_REST.0 * way_m
        && conduct.motion_at_rest_m < AT_REST.1 * way_m
        && conduct.full < FULL
        && conduct.largest_command > USED
}

/// The nearest and the farthest place of the machine's cycle, m.
fn way_m(machine: &Machine) -> (f64, f64) {
    let places = machine.duty.origins_m();
    places.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), at_m| (low.min(at_m), high.max(at_m)))
}

/// Watches a machine.
pub(super) fn conduct(machine: &Machine, leak: Leak) -> Conduct {
    let mut steady = machine.duty.clone();
    (steady.dwell_spread, steady.pause_probability) = (0.0, 0.0);
    let machine = Machine { duty: steady, ..machine.clone() };
    let timeline = Timeline::plan(&machine.duty, CYCLES, Beginning::AtWork, &mut Noise::new(0, 0));
    let temperature_c = (machine.oil.temperature_c, machine.oil.temperature_c);
    let mut samples: Vec<LogSample> = Vec::new();
    let finite = run(&machine, &Day { leak, temperature_c, force: 1.0 }, &timeline, 1, |sample| {
        samples.push(sample);
    });
    let mut conduct = Conduct { finite, ..Conduct::default() };
    for sample in &samples {
        conduct.behind_m = conduct.behind_m.max((sample.demand_m - sample.position_m).abs());
        conduct.largest_command = conduct.largest_command.max(sample.command.abs());
        conduct.full += f64::from(u8::from(sample.command.abs() >= 1.0)) / samples.len() as f64;
    }
    for cycle_s in &timeline.cycles_s {
        let mut end_s = cycle_s - timeline.logged_s.0;
        for step in &machine.duty.moves {
            end_s += step.duration_s + step.dwell_s;
            if step.dwell_s < LONG_S {
                continue;
            }
            let at =
                |time_s: f64| samples.partition_point(|sample| sample.time_s < time_s).min(samples.len());
            let second_half =
                &samples[at(end_s - 0.5 * step.dwell_s)..at(end_s - machine.controller.period_s)];
            let Some(last) = second_half.last() else { continue };
            let moved_m = second_half
                .iter()
                .fold(0.0, |far: f64, sample| far.max((sample.position_m - last.position_m).abs()));
            conduct.motion_at_rest_m = conduct.motion_at_rest_m.max(moved_m);
            conduct.off_at_rest_m = conduct.off_at_rest_m.max((last.demand_m - last.position_m).abs());
        }
    }
    conduct
}

#[cfg(test)]
mod tests {
    use super::super::draw::build;
    use super::super::machine::tests::example;
    use super::*;

    const TIGHT: Leak = Leak { flow_m3_per_s: 1e-8, exponent: 1.0 };

    #[test]
    fn machines_of_200_seeds_follow_their_demand_and_settle() {
        // Longer cycles are longer dwells: what is watched is the same.
        let drawn: Vec<Machine> = (0..200)
            .filter_map(|seed| build(&mut Noise::new(seed, 1)))
            .map(|built| built.machine)
            .filter(|machine| machine.duty.period_s() < 12.0)
            .collect();
        assert!(drawn.len() > 25, "{} short cycles", drawn.len());
        let decent = drawn.iter().filter(|machine| decent(machine, TIGHT)).count();
        // A few are drawn that hunt or brake late: these are drawn anew.
        assert!(decent * 10 > drawn.len() * 7, "{decent} of {} are decent", drawn.len());
    }

    #[test]
    fn a_machine_that_hunts_or_that_cannot_follow_is_not_let_out() {
        let good = example();
        assert!(decent(&good, TIGHT), "{:?}", conduct(&good, TIGHT));
        let mut hunting = good.clone();
        hunting.controller.kp_per_m *= 20.0;
        assert!(conduct(&hunting, TIGHT).motion_at_rest_m > 1e-3);
        assert!(!decent(&hunting, TIGHT));
        let mut weak = good;
        weak.valve.coefficient /= 20.0;
        assert!(conduct(&weak, TIGHT).full > 0.5);
        assert!(!decent(&weak, TIGHT));
    }
}

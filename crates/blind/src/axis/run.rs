//! A machine at work over a timeline.

use super::controller::ControllerState;
use super::duty::{Follower, Timeline};
use super::hydraulics::{Hydraulics, P_1, P_2, P_S, STATES, State, TOLERANCE, V, X};
use super::integrator::Integrator;
use super::machine::{Leak, Machine};

/// What a machine's log may have at a tick, without noise.
#[derive(Debug, Clone, Copy)]
pub(super) struct LogSample {
    /// Time since the log's beginning, s.
    pub(super) time_s: f64,
    /// Valve command, share of full command.
    pub(super) command: f64,
    /// Position demand, m.
    pub(super) demand_m: f64,
    /// Position, m.
    pub(super) position_m: f64,
}

/// What differs from day to day.
#[derive(Debug, Clone, Copy)]
pub(super) struct Day {
    /// Leak past the piston.
    pub(super) leak: Leak,
    /// Oil temperature at the beginning and at the end, °C.
    pub(super) temperature_c: (f64, f64),
    /// Factor on process forces.
    pub(super) force: f64,
}

/// How often the oil's temperature is taken anew, s.
const OIL_S: f64 = 20.0;

/// Runs the machine over the timeline and hands every `nth` tick of the logged part to `sink`; whether all stayed finite.
pub(super) fn run(
    machine: &Machine,
    day: &Day,
    timeline: &Timeline,
    nth: usize,
    sink: impl FnMut(LogSample),
) -> bool {
    run_with(Integrator::new(TOLERANCE), machine, day, timeline, nth, sink)
}

fn run_with(
    mut integrator: Integrator,
    machine: &Machine,
    day: &Day,
    timeline: &Timeline,
    nth: usize,
    mut sink: impl FnMut(LogSample),
) -> bool {
    let period_s = machine.controller.period_s;
    let (begin_s, end_s) = timeline.logged_s;
    let first = (begin_s / period_s).ceil() as usize;
    let ticks = (end_s / period_s) as usize;
    let oil_ticks = ((OIL_S / period_s) as usize).max(1);
    let temperature_c = |tick: usize| {
        let share = tick as f64 / ticks.max(1) as f64;
        day.temperature_c.0 + (day.temperature_c.1 - day.temperature_c.0) * share
    };
    let mut state = at_rest(machine);
    let mut controller = ControllerState::at(state[X]);
    let mut follower = Follower::new(timeline, machine.duty.start_m);
    let mut hydraulics = Hydraulics::new(machine, day.leak, temperature_c(0));
    for tick in 0..ticks {
        if tick % oil_ticks == 0 {
            hydraulics = Hydraulics::new(machine, day.leak, temperature_c(tick));
            if !state.iter().all(|value| value.is_finite()) {
                return false;
            }
        }
        let position_m = state[X];
        let order = follower.order(tick as f64 * period_s, position_m);
        let command = if let Some(command) = order.rapid {
            controller = ControllerState::at(position_m);
            command
        } else {
            machine.controller.tick(&mut controller, order.demand_m, order.demand_m_per_s, position_m)
        };
        if tick >= first && (tick - first).is_multiple_of(nth) {
            let time_s = (tick - first) as f64 * period_s;
            sink(LogSample { time_s, command, demand_m: order.demand_m, position_m });
        }
        let force_n = order.force_n * day.force;
        integrator.advance(&mut state, period_s, |state| hydraulics.rates(state, command, force_n));
    }
    state.iter().all(|value| value.is_finite())
}

/// The machine held at its start.
fn at_rest(machine: &Machine) -> State {
    let Machine { cylinder, supply, duty, .. } = machine;
    let (cap, annulus) = (cylinder.cap_area_m2(), cylinder.annulus_area_m2());
    let mut state = [0.0; STATES];
    let p_s = supply.pressure_pa;
    // Edges alike on both sides share what the supply has over the return.
    let p_2 = ((cap * (p_s + supply.return_pa) + cylinder.weight_n) / (cap + annulus)).clamp(0.0, p_s);
    state[P_S] = p_s;
    state[P_2] = p_2;
    state[P_1] = ((annulus * p_2 - cylinder.weight_n) / cap).clamp(0.0, p_s);
    state[X] = duty.start_m;
    state[V] = 0.0;
    state
}

#[cfg(test)]
mod tests {
    use seepd_sim::noise::Noise;

    use super::super::duty::Beginning;
    use super::super::machine::tests::example;
    use super::*;

    const DAY: Day =
        Day { leak: Leak { flow_m3_per_s: 3e-5, exponent: 0.5 }, temperature_c: (50.0, 50.0), force: 1.0 };

    fn samples(tolerance: f64) -> Vec<LogSample> {
        let machine = example();
        let timeline = Timeline::plan(&machine.duty, 1, Beginning::AtWork, &mut Noise::new(1, 1));
        let mut samples = Vec::new();
        let integrator = Integrator::new(TOLERANCE.map(|state| state * tolerance));
        assert!(run_with(integrator, &machine, &DAY, &timeline, 1, |sample| samples.push(sample)));
        samples
    }

    #[test]
    fn property_smaller_steps_give_the_same_machine() {
        let (finest, fine, usual) = (samples(1e-6), samples(1e-3), samples(1.0));
        let apart = |other: &[LogSample]| {
            assert_eq!(other.len(), finest.len());
            finest.iter().zip(other).fold((0.0, 0.0), |(command, position): (f64, f64), (a, b)| {
                let position_m = (a.position_m - b.position_m).abs();
                (command.max((a.command - b.command).abs()), position.max(position_m))
            })
        };
        let (fine, usual) = (apart(&fine), apart(&usual));
        // A twentieth of the smallest noise that is logged.
        assert!(usual.0 < 5e-5 && usual.1 < 1e-6, "{usual:?}");
        assert!(fine.0 < 0.1 * usual.0 && fine.1 < 0.1 * usual.1, "{fine:?} after {usual:?}");
    }

    #[test]
    fn analytic_following_error_of_a_proportional_controller() {
        let samples = samples(1.0);
        let reached = samples.iter().map(|sample| sample.position_m).fold(0.0, f64::max);
        assert!((reached - 0.25).abs() < 1e-3, "{reached}");
        // The command is the gain times the error, tick by tick.
        assert!(samples.iter().all(|s| (s.command - 40.0 * (s.demand_m - s.position_m)).abs() < 1e-12));
    }
}

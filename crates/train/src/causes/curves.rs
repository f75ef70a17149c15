//! The causes with the sizes at which they are simulated, and what each does to a machine.
//!
//! To add one: a line in [`all`], which says what it is by effects of the catalogue; a name in
//! [`Cause`](seepd_model::causes::Cause), where it is new.

use seepd_model::causes::{Cause, Kind, Side, SizeUnit, UNKNOWN_LAW_ERROR};
use seepd_sim::MachineSpec;
use seepd_sim::effects;
use seepd_sim::noise::Noise;

use crate::dataset::Observation;
use crate::hold_force::HoldForce;
use crate::leak_range::LeakRange;

/// A cause, one law of it, and one sign: what it does as its size grows.
pub(super) struct Curve {
    pub(super) kind: Kind,
    /// Ends of the ranges, magnitudes ascending; signed.
    ends: Vec<f64>,
    /// Of a leak: whether it follows another law than that of the estimates' training.
    pub(super) other_law: bool,
    /// What presses in the holds of the machines that have it.
    pub(super) force: HoldForce,
    apply: Apply,
}

/// Error of the response of leaks, over its length, of which an orifice's law and those of gaps are simulated.
const LEAK_ERROR: f64 = 0.03;
/// The same of what shifts the null: it moves every sample alike, on every machine.
const EXACT_ERROR: f64 = 0.01;
/// Of a shifted null on a plant that was fitted to a log: how a controller comes to rest after a stroke is known less well.
const FITTED_NULL_ERROR: f64 = 0.05;

/// How far a range of leaks reaches over each end, as a power of the ratio of its ends: (√3 − 1)/2. Sizes then scatter by half the distance
/// of neighbouring ranges' means, and normals of that width add up to an even density: no law of a leak is likelier only because a size
/// lies in the middle of its range.
const OVERLAP: f64 = 0.366;

type Apply = Box<dyn Fn(&mut Observation, f64, &mut Noise) + Sync>;

impl Curve {
    /// The ranges of sizes. Those of leaks reach over their ends.
    pub(super) fn ranges(&self) -> impl Iterator<Item = [f64; 2]> + '_ {
        let overlap = if self.kind.cause == Cause::PistonSeal { OVERLAP } else { 0.0 };
        self.ends.windows(2).map(move |ends| {
            let over = libm::pow(ends[1] / ends[0], overlap);
            [ends[0] / over, ends[1] * over]
        })
    }

    /// Both ends of all ranges.
    pub(super) fn whole_range(&self) -> [f64; 2] {
        let end = |end: Option<&f64>| end.copied().unwrap_or(1.0);
        [end(self.ends.first()), end(self.ends.last())]
    }

    /// Error of the simulator's response, over its length. A plant that a log was calibrated to is not known as one of a series is, and its
    /// leaks are given what any other response is.
    pub(super) fn error(&self, is_calibrated: bool) -> f64 {
        match self.kind.cause {
            Cause::ValveNull if is_calibrated => FITTED_NULL_ERROR,
            Cause::ValveNull => EXACT_ERROR,
            Cause::PistonSeal if !is_calibrated => LEAK_ERROR,
            _ => UNKNOWN_LAW_ERROR,
        }
    }

    /// A machine with the cause at a rank of 0 … 1 of a range, and the size.
    pub(super) fn applied(
        &self,
        healthy: &Observation,
        [from, to]: [f64; 2],
        rank: f64,
        noise: &mut Noise,
    ) -> (f64, Observation) {
        let size = from * libm::pow(to / from, rank);
        let mut machine = healthy.clone();
        (self.apply)(&mut machine, size, noise);
        (size, machine)
    }
}

/// Flow of 1 L/min, m³/s.
const LPM: f64 = 1.0 / 60_000.0;

/// So many ranges of even ratio.
fn even(from: f64, to: f64, ranges: usize) -> Vec<f64> {
    (0..=ranges).map(|index| from * libm::pow(to / from, index as f64 / ranges as f64)).collect()
}

/// Adds to a parameter of an effect.
fn add(machine: &mut Observation, effect: &str, parameter: &str, by: f64) {
    change(&mut machine.spec, effect, parameter, |value| value + by);
}

/// Multiplies a parameter of an effect.
fn multiply(machine: &mut Observation, effect: &str, parameter: &str, by: f64) {
    change(&mut machine.spec, effect, parameter, |value| value * by);
}

fn set(machine: &mut Observation, effect: &str, parameter: &str, to: f64) {
    change(&mut machine.spec, effect, parameter, |_| to);
}

fn change(spec: &mut MachineSpec, effect: &str, parameter: &str, by: impl Fn(f64) -> f64) {
    let Some(known) = effects::find(effect) else { return };
    let place = known.parameters().iter().position(|known| known.name == parameter);
    let Some(place) = place else { return };
    let value = by(spec.effect_values(known)[place]);
    spec.effects.entry(effect.into()).or_default().insert(parameter.into(), value);
}

/// Every curve, for a machine's size of valve and piston; leaks under every force that may press, where that is unknown.
pub(super) fn all(spec: &MachineSpec, unknown_force: bool) -> Vec<Curve> {
    let valve = LeakRange::of(spec).scale();
    let nominal = MachineSpec::default();
    let strength = |spec: &MachineSpec| spec.plant.relief_pressure_pa * spec.plant.cap_area_m2;
    // Forces count by the share of the press's own.
    let force = strength(spec) / strength(&nominal);
    let stiffness = force * nominal.plant.stroke_m / spec.plant.stroke_m;
    let mut curves = Curves(Vec::new());
    let hold_forces = if unknown_force { HoldForce::all(spec) } else { vec![HoldForce::AsDrawn] };
    hold_forces.into_iter().for_each(|force| seal(&mut curves, valve, force));
    valve_causes(&mut curves, valve);
    outside(&mut curves, valve);
    forces(&mut curves, spec, force, stiffness);
    conditions(&mut curves);
    control(&mut curves);
    curves.0
}

struct Curves(Vec<Curve>);

impl Curves {
    fn push(
        &mut self,
        (cause, unit): (Cause, SizeUnit),
        ends: Vec<f64>,
        apply: impl Fn(&mut Observation, f64, &mut Noise) + Sync + 'static,
    ) {
        self.0.push(Curve {
            kind: Kind { cause, side: None, unit },
            ends,
            other_law: false,
            force: HoldForce::AsDrawn,
            apply: Box::new(apply),
        });
    }

    /// The cause with either sign.
    fn push_signed(
        &mut self,
        kind: (Cause, SizeUnit),
        ends: &[f64],
        apply: impl Fn(&mut Observation, f64, &mut Noise) + Sync + Copy + 'static,
    ) {
        self.push(kind, ends.to_vec(), apply);
        self.push(kind, ends.iter().map(|end| -end).collect(), apply);
    }
}

fn seal(curves: &mut Curves, valve: f64, force: HoldForce) {
    let kind = (Cause::PistonSeal, SizeUnit::Area);
    let ends = even(valve * 4e-9, valve * 1.3e-5, 10);
    let first = curves.0.len();
    curves.push(kind, ends.clone(), |machine, size, _| machine.leak_area_m2 += size);
    // Long gaps are laminar, worn ones in between.
    curves.push(kind, ends, |machine, size, noise| {
        machine.leak_area_m2 += size;
        set(machine, "turbulent_leak", "exponent", noise.uniform(0.65, 1.0));
    });
    for (law, curve) in curves.0.iter_mut().skip(first).enumerate() {
        curve.force = force;
        curve.other_law = law > 0;
    }
}

fn valve_causes(curves: &mut Curves, valve: f64) {
    curves.push_signed((Cause::ValveNull, SizeUnit::Share), &even(2e-4, 0.05, 4), |machine, size, _| {
        add(machine, "valve_bias", "offset", size);
    });
    for (shortest, longest) in [(0.01, 0.03), (0.03, 0.08), (0.08, 0.2)] {
        let ends = even(valve * 0.05 * LPM, valve * 4.0 * LPM, 5);
        curves.push((Cause::ValveLands, SizeUnit::Flow), ends, move |machine, size, noise| {
            add(machine, "valve_wear", "land_flow_m3_per_s", size);
            set(machine, "valve_wear", "decay_command", noise.uniform(shortest, longest));
        });
    }
    let hysteresis = (Cause::ValveHysteresis, SizeUnit::Share);
    curves.push(hysteresis, even(4e-4, 0.08, 6), |machine, size, _| {
        add(machine, "valve_hysteresis", "width", size);
    });
    let dead_band = (Cause::ValveDeadBand, SizeUnit::Share);
    curves.push(dead_band, even(3e-4, 0.05, 7), |machine, size, _| {
        add(machine, "valve_deadband", "half_width", size);
    });
}

fn outside(curves: &mut Curves, valve: f64) {
    // Conductance of 1 L/min at 8 MPa.
    let one_lpm = LPM / 8e6;
    for (side, parameter) in [(Side::Cap, "cap_m3_per_s_pa"), (Side::Rod, "rod_m3_per_s_pa")] {
        let ends = even(valve * 0.03 * one_lpm, valve * 6.0 * one_lpm, 6);
        curves.push((Cause::ExternalLeak, SizeUnit::Conductance), ends, move |machine, size, _| {
            add(machine, "external_leak", parameter, size);
        });
        if let Some(curve) = curves.0.last_mut() {
            curve.kind.side = Some(side);
        }
    }
}

/// Pressure difference over the piston by which pressure friction is stated as a force, Pa.
const TYPICAL_DP_PA: f64 = 5e6;

fn forces(curves: &mut Curves, spec: &MachineSpec, force: f64, stiffness: f64) {
    let friction = (Cause::Friction, SizeUnit::Force);
    let ends = even(force * 60.0, force * 5e3, 5);
    curves.push(friction, ends.clone(), |machine, size, _| {
        add(machine, "coulomb_friction", "force_n", size);
    });
    curves.push(friction, ends.clone(), |machine, size, noise| {
        add(machine, "stribeck_friction", "force_n", size);
        add(machine, "stribeck_friction", "static_force_n", size * noise.uniform(1.2, 1.7));
        set(machine, "stribeck_friction", "stribeck_speed_m_per_s", noise.uniform(5e-3, 0.1));
    });
    let per_newton = 1.0 / (TYPICAL_DP_PA * spec.plant.cap_area_m2);
    curves.push(friction, ends, move |machine, size, _| {
        add(machine, "pressure_friction", "coefficient", size * per_newton);
    });
    let bias = even(force * 60.0, force * 6e3, 4);
    curves.push_signed((Cause::Load, SizeUnit::Force), &bias, |machine, size, _| {
        add(machine, "load_bias", "force_n", size);
    });
    curves.push_signed((Cause::Load, SizeUnit::Share), &even(0.03, 0.6, 4), |machine, size, _| {
        machine.load_factor *= 1.0 + size;
    });
    if !spec.effects.contains_key("spring_load") {
        for part in [(0.0, 0.33), (0.33, 0.67), (0.67, 1.0)] {
            let stroke_m = spec.plant.stroke_m;
            let ends = even(stiffness * 500.0, stiffness * 6e4, 4);
            curves.push((Cause::Spring, SizeUnit::Stiffness), ends, move |machine, size, noise| {
                add(machine, "spring_load", "stiffness_n_per_m", size);
                set(machine, "spring_load", "neutral_position_m", stroke_m * noise.uniform(part.0, part.1));
            });
        }
    }
}

/// Beyond what is ordinary of oil and supply.
fn conditions(curves: &mut Curves) {
    curves.push((Cause::OilViscosity, SizeUnit::Share), even(0.3, 3.0, 3), |machine, size, _| {
        multiply(machine, "oil_viscosity", "factor", 1.0 + size);
    });
    curves.push((Cause::OilViscosity, SizeUnit::Share), even(-0.2, -0.7, 3), |machine, size, _| {
        multiply(machine, "oil_viscosity", "factor", 1.0 + size);
    });
    curves.push((Cause::Supply, SizeUnit::Share), even(-0.03, -0.4, 4), |machine, size, _| {
        machine.spec.plant.relief_pressure_pa *= 1.0 + size;
    });
    curves.push((Cause::Supply, SizeUnit::Share), even(0.03, 0.25, 3), |machine, size, _| {
        machine.spec.plant.relief_pressure_pa *= 1.0 + size;
    });
}

fn control(curves: &mut Curves) {
    let gains: [&[&str]; 3] = [&["kp"], &["ki"], &["kp", "ki"]];
    for names in gains {
        let kind = (Cause::Controller, SizeUnit::Share);
        curves.push(kind, even(0.01, 1.0, 5), move |machine, size, _| {
            names.iter().for_each(|name| multiply(machine, "controller_gains", name, 1.0 + size));
        });
        curves.push(kind, even(-0.01, -0.5, 4), move |machine, size, _| {
            names.iter().for_each(|name| multiply(machine, "controller_gains", name, 1.0 + size));
        });
    }
    curves.push_signed((Cause::PositionScale, SizeUnit::Share), &even(2e-3, 0.08, 4), |machine, size, _| {
        multiply(machine, "position_scale", "factor", 1.0 + size);
    });
}

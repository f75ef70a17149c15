//! How a model is trained for an adopted machine: spread as calibration left it, noise as measured, as many machines as there is time for.

use std::collections::BTreeMap;

use seepd_features::Kalman;
use seepd_sim::noise::Noise;
use seepd_sim::series::{self, Direction, Tolerances};
use seepd_sim::{DutyCycle, MachineSpec};
use seepd_train::{Conditions, Spread, TrainingSettings};
use serde::{Deserialize, Serialize};

use crate::adoption::Adoption;
use crate::duty_cycle::FoundCycle;

/// Time constant of the filter over the period: 70 ms of 10 s (the article's).
const FILTER_SHARE: f64 = 0.007;
/// The same at most over the shortest stroke.
const STROKE_SHARE: f64 = 0.3;
/// The filter does not smooth over less than this many samples.
const LEAST_FILTER_SAMPLES: f64 = 0.5;
/// The article's measurement noise, by which a filter's gain is expressed.
const KALMAN_R: f64 = 5.0;
/// Plant steps of a cycle of the nominal press, for which the default settings take one and a half minutes on two cores.
const NOMINAL_STEPS: f64 = 1e5;
/// Least share of the default numbers of machines with which a model is trained.
const LEAST_SHARE: f64 = 0.14;
/// Room over the measured noise in training, to either side.
const NOISE_ROOM: f64 = 3.0;
/// Least variation of the period and of the load that training draws, shares.
const LEAST_PERIOD: f64 = 0.01;
const LOAD: f64 = 0.05;
/// How far a valve's flow gain may be off at its null, share to either side: a healthy log does not show it, and data sheets allow more.
const NULL_DEVIATION: f64 = 0.3;
/// How far a calibrated plant may be wrong about what a leak does to a phase, share: what cells of causes are given for laws that nobody has
/// simulated.
const RESPONSE_ERROR: f64 = 0.2;
/// Share of the machines whose valve overlaps where nobody knows whether it does, and the widest half width, share of full command.
const UNKNOWN_OVERLAP: (f64, f64) = (0.2, 0.1);
/// Cosine of a cause's response and a leak's from which on they are one class: the plant is not the machine, and responses are known less
/// well.
const ALIKE_FROM: f64 = 0.9;
/// Least share of simulated cycles that must be recognised: of the machines that calibration leaves possible some do not follow their
/// cycle, as this one does, and are none of its kind.
const LEAST_RECOGNISED: f64 = 0.5;
/// Machines that are drawn to see how many steps they need.
const TRIED_FOR_STEPS: usize = 200;
/// Largest variation of the period: the anchors' tolerance.
const MOST_PERIOD: f64 = 0.03;

/// What training takes of an adopted machine beside its plant.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TrainingBasis {
    /// How far each plant parameter may be off to either side, share.
    pub tolerances: BTreeMap<String, f64>,
    /// How parameters may be off together beside that.
    #[serde(default)]
    pub together: Vec<Direction>,
    /// Standard deviation of the command's noise, share of full command.
    pub noise: f64,
    /// Standard deviation of the load from cycle to cycle, share of its range, where the log has a load.
    pub load_spread: Option<f64>,
    /// Whether the piston may meet a contact that the log does not show.
    #[serde(default)]
    pub unknown_contact: bool,
    /// Whether a force may press in the holds that the log does not show.
    #[serde(default)]
    pub unknown_hold_force: bool,
    /// Whether the plant was fitted to the log, beyond its duty cycle.
    #[serde(default)]
    pub fitted: bool,
    /// Whether the valve's overlap was fitted to the log, or is the user's.
    #[serde(default)]
    pub knows_overlap: bool,
    /// How much the period varies, half of what nine of ten cycles lie between, share.
    pub period_spread: f64,
}

impl TrainingBasis {
    /// Of a machine and its duty cycle.
    pub fn of(adoption: &Adoption, found: &FoundCycle) -> Self {
        TrainingBasis {
            tolerances: adoption.tolerances(),
            together: adoption.together.clone(),
            noise: adoption.noise,
            load_spread: adoption.load_spread,
            unknown_contact: adoption.unknown_contact,
            unknown_hold_force: adoption.unknown_hold_force,
            fitted: adoption.calibration.is_some(),
            knows_overlap: adoption.knows_overlap,
            period_spread: 0.5 * found.period.spread_s() / found.period_s,
        }
    }

    fn spread(&self) -> Tolerances {
        Tolerances { share: 0.05, of: self.tolerances.clone(), together: self.together.clone() }
    }

    /// The machine with as many steps as any needs that is drawn from it.
    pub fn with_steps_for_all(&self, spec: &MachineSpec) -> MachineSpec {
        let (spread, mut noise) = (self.spread(), Noise::new(0, 0));
        let mut steady = spec.with_stable_steps();
        for _ in 0..TRIED_FOR_STEPS {
            let needed = series::vary(spec, &spread, &mut noise).stable_steps();
            steady.controller.steps_per_period = steady.controller.steps_per_period.max(needed);
        }
        steady
    }

    /// The settings with which a model for the machine is trained, with that share of the machines that there is time for.
    pub fn settings(&self, spec: &MachineSpec, effort: f64) -> TrainingSettings {
        let usual = TrainingSettings::default();
        let c = &spec.controller;
        let steps = spec.cycle.period_s / c.period_s * c.steps_per_period as f64;
        let share = (effort * NOMINAL_STEPS / steps).clamp(LEAST_SHARE, 1.0);
        let count = |machines: usize| (machines as f64 * share) as usize;
        let tolerances = self.spread();
        let period = self.period_spread.clamp(LEAST_PERIOD, MOST_PERIOD);
        let load = self.load_spread.map_or(LOAD, |spread| (2.0 * spread).clamp(0.02, 0.2));
        let noise = self.noise.clamp(3e-4, 0.02);
        TrainingSettings {
            observations: count(usual.observations),
            held_out: count(usual.held_out).max(256),
            relative_machines: count(usual.relative_machines).max(160),
            cause_machines: count(usual.cause_machines).max(8),
            calibrated_on: count(usual.calibrated_on).max(512),
            tested_on: count(usual.tested_on).max(128),
            spread: Spread {
                parameters: tolerances.clone(),
                load,
                period,
                unknown_contact: self.unknown_contact,
                unknown_seal: true,
                null_deviation: NULL_DEVIATION,
                deadband: if self.knows_overlap { (0.0, 0.0) } else { UNKNOWN_OVERLAP },
            },
            unknown_hold_force: self.unknown_hold_force,
            fitted: self.fitted,
            knows_dead_band: self.knows_overlap,
            alike_from: ALIKE_FROM,
            least_recognised: LEAST_RECOGNISED,
            noise: ((noise / NOISE_ROOM).max(1e-4), (noise * NOISE_ROOM).max(0.003)),
            filter: Some(filter(time_constant_s(&spec.cycle), c.log_period_s())),
            conditions: Conditions {
                parameters: tolerances,
                machine_load: load,
                period,
                unknown_contact: self.unknown_contact,
                unknown_seal: true,
                null_deviation: NULL_DEVIATION,
                response_error: RESPONSE_ERROR,
                deadband: if self.knows_overlap { Conditions::default().deadband } else { UNKNOWN_OVERLAP },
                ..Conditions::default()
            },
            ..usual
        }
    }
}

/// The filter's time constant for a duty cycle, s: its shortest stroke must come through.
pub fn time_constant_s(cycle: &DutyCycle) -> f64 {
    let strokes_s = cycle.moves.iter().map(|stroke| stroke.to_s - stroke.from_s);
    let shortest_s = strokes_s.fold(f64::INFINITY, f64::min);
    (FILTER_SHARE * cycle.period_s).min(STROKE_SHARE * shortest_s)
}

/// The article's filter for another time constant and rate: a random walk's, with the gain that gives the time constant.
pub fn filter(time_constant_s: f64, log_period_s: f64) -> Kalman {
    let samples = (time_constant_s / log_period_s).max(LEAST_FILTER_SAMPLES);
    let gain = 1.0 - (-1.0 / samples).exp();
    // The steady gain K of a random walk with process noise Q and measurement noise R: Q / R = K² / (1 − K).
    Kalman { q: KALMAN_R * gain * gain / (1.0 - gain), r: KALMAN_R }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_filter_of_the_nominal_press_is_about_the_articles() {
        let article = Kalman::default();
        let ours = filter(time_constant_s(&MachineSpec::default().cycle), 1e-3);
        assert!((ours.q / article.q - 1.0).abs() < 0.05 && ours.r == article.r, "{ours:?}");
        // At a tenth of the rate the gain is ten times as large, the time constant the same.
        assert!(filter(0.07, 1e-2).q > 80.0 * ours.q);
    }

    /// A stroke of 0.1 s in a cycle of 50 s: 0.35 s would leave nothing of it.
    #[test]
    fn a_short_stroke_comes_through_the_filter() {
        let mut cycle = MachineSpec::default().cycle;
        cycle.period_s = 50.0;
        cycle.moves[0].to_s = cycle.moves[0].from_s + 0.1;
        assert!((time_constant_s(&cycle) - 0.03).abs() < 1e-12);
    }
}

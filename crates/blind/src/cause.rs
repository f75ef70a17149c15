//! What is planted: cases of each set, drawn from a seed.

use std::collections::BTreeMap;

use seepd_sim::effects::{self, Effect, Parameter};
use seepd_sim::noise::Noise;
use seepd_sim::{Controller, DutyCycle, PlantParameters};
use serde::{Deserialize, Serialize};

use crate::foreign::Foreign;
use crate::press::{EffectValues, Press, Variation};

/// What kind of case it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Set {
    /// The plant file's machine.
    Nominal,
    /// Other parameters.
    Parameters,
    /// One effect of the catalogue.
    Single,
    /// Two of them.
    Pair,
    /// One effect that the diagnoser's copy of the catalogue lacks.
    LeftOut,
    /// A cause that exists in the planter only.
    Foreign,
}

/// What was planted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// Its set.
    pub set: Set,
    /// Effects with their values.
    pub effects: EffectValues,
    /// Whether they follow another law than the catalogue's.
    pub other_law: bool,
    /// A cause without a name in the catalogue.
    pub foreign: Option<Foreign>,
    /// Leak area, m².
    pub leak_area_m2: f64,
    /// Plant parameters that differ from the plan, by key.
    pub parameters: BTreeMap<String, f64>,
    /// Share by which the load varies from cycle to cycle.
    pub load_variation: f64,
    /// Standard deviation of the time by which strokes and loads of a cycle are late or early, s.
    #[serde(default)]
    pub jitter_s: f64,
    /// Pressure transducers as bought: supply, inlet, cap and rod.
    #[serde(default)]
    pub transducers: [Transducer; 4],
    /// Seed of noise and variation.
    pub seed: u64,
}

/// What a transducer makes of what it measures.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Transducer {
    /// Shown over true.
    pub gain: f64,
    /// Shown at 0, Pa.
    pub offset_pa: f64,
}

impl Default for Transducer {
    fn default() -> Self {
        Transducer { gain: 1.0, offset_pa: 0.0 }
    }
}

impl Transducer {
    /// One of the class of 0.25 %: gain and zero are each off by up to that, of 100 bar.
    fn drawn(noise: &mut Noise) -> Self {
        Transducer { gain: 1.0 + noise.uniform(-0.0025, 0.0025), offset_pa: noise.uniform(-2.5e4, 2.5e4) }
    }

    /// What it shows of a pressure.
    pub fn shown_pa(self, pressure_pa: f64) -> f64 {
        self.gain * pressure_pa + self.offset_pa
    }
}

/// A case: what the diagnosis is given, and the truth.
#[derive(Debug, Clone, PartialEq)]
pub struct Case {
    /// Name of its log.
    pub name: String,
    /// Effect that the diagnoser's catalogue lacks. Each case has one, so that it tells nothing.
    pub without: String,
    /// The truth.
    pub truth: Truth,
}

/// Effects for which the planter has another law than the catalogue: a third of them.
const OTHER_LAWS: [&str; 11] = [
    "coulomb_friction",
    "stribeck_friction",
    "valve_deadband",
    "valve_lag",
    "valve_hysteresis",
    "valve_flow_shape",
    "valve_wear",
    "spring_load",
    "accumulator",
    "return_back_pressure",
    "external_leak",
];

/// Strengths of planted effects, shares of the plausible range: small, middle, large.
const STRENGTHS: [(f64, f64); 3] = [(0.06, 0.15), (0.15, 0.4), (0.4, 0.9)];

/// Causes that one log cannot tell apart by nature; see the tutorial on diagnosis.
pub const CLASSES: [&[&str]; 2] =
    [&["command_delay", "position_lag", "valve_lag"], &["coulomb_friction", "stribeck_friction"]];

/// Draws `each` cases of each set and each effect of the catalogue alone at `sizes` sizes, in an order that tells nothing.
pub fn draw(seed: u64, each: usize, sizes: usize) -> Vec<Case> {
    let mut noise = Noise::new(seed, 1);
    let mut truths = Vec::new();
    for _ in 0..each {
        truths.push(machine(Set::Nominal, 0.0, &mut noise));
        truths.push(machine(Set::Parameters, 1.0, &mut noise));
    }
    for effect in effects::ALL {
        for size in 0..sizes {
            let strength = STRENGTHS[(size + STRENGTHS.len() - sizes.min(STRENGTHS.len())) % STRENGTHS.len()];
            truths.push(planted(Set::Single, &[*effect], strength, &mut noise));
        }
    }
    for _ in 0..each {
        let first = any_effect(&mut noise);
        let second =
            std::iter::repeat_with(|| any_effect(&mut noise)).find(|other| other.key() != first.key());
        let pair = [Some(first), second];
        let pair: Vec<&'static dyn Effect> = pair.into_iter().flatten().collect();
        truths.push(planted(Set::Pair, &pair, STRENGTHS[2], &mut noise));
        truths.push(planted(Set::LeftOut, &[any_effect(&mut noise)], STRENGTHS[2], &mut noise));
    }
    for index in 0..each {
        let kinds = Foreign::all(noise.uniform(0.2, 1.0));
        let mut truth = machine(Set::Foreign, half_of_them(&mut noise), &mut noise);
        truth.foreign = Some(kinds[index % kinds.len()]);
        truths.push(truth);
    }
    let mut cases: Vec<(f64, Truth, String)> = truths
        .into_iter()
        .map(|truth| (noise.uniform(0.0, 1.0), without(&truth, &mut noise), truth))
        .map(|(order, without, truth)| (order, truth, without))
        .collect();
    cases.sort_by(|a, b| a.0.total_cmp(&b.0));
    cases
        .into_iter()
        .enumerate()
        .map(|(number, (_, truth, without))| Case { name: format!("case-{:03}", number + 1), without, truth })
        .collect()
}

impl Truth {
    /// How its cycles differ.
    pub fn variation(&self) -> Variation {
        Variation { load: self.load_variation, jitter_s: self.jitter_s, seed: self.seed }
    }

    /// The machine.
    pub fn press(&self) -> Press {
        let mut plant = PlantParameters { leak_area_m2: self.leak_area_m2, ..PlantParameters::default() };
        for (key, value) in &self.parameters {
            if let Some(slot) = plant.get_mut(key) {
                *slot = *value;
            }
        }
        Press {
            plant,
            controller: Controller::default(),
            cycle: DutyCycle::default(),
            planted: self.effects.clone(),
            other_law: self.other_law,
            foreign: self.foreign,
        }
    }
}

/// What the diagnoser's catalogue lacks: the truth, where the case is about that; else any effect that could not be taken for it.
fn without(truth: &Truth, noise: &mut Noise) -> String {
    if truth.set == Set::LeftOut {
        return truth.effects.keys().next().cloned().unwrap_or_default();
    }
    let classes: Vec<&str> = truth.effects.keys().flat_map(|key| class_of(key).iter().copied()).collect();
    std::iter::repeat_with(|| any_effect(noise).key())
        .find(|key| !truth.effects.contains_key(*key) && !classes.contains(key))
        .unwrap_or_default()
        .to_owned()
}

/// The class of an effect; empty for one that stands alone.
pub fn class_of(effect: &str) -> &'static [&'static str] {
    CLASSES.into_iter().find(|class| class.contains(&effect)).unwrap_or_default()
}

fn any_effect(noise: &mut Noise) -> &'static dyn Effect {
    let count = effects::ALL.len();
    effects::ALL[(noise.uniform(0.0, count as f64) as usize).min(count - 1)]
}

/// How far parameters are off beside an effect: half of the machines are as planned.
fn half_of_them(noise: &mut Noise) -> f64 {
    if noise.uniform(0.0, 1.0) < 0.5 { 0.0 } else { 0.5 }
}

fn planted(set: Set, planted: &[&'static dyn Effect], strength: (f64, f64), noise: &mut Noise) -> Truth {
    let off = half_of_them(noise);
    let mut truth = machine(set, off, noise);
    for effect in planted {
        truth.effects.insert(effect.key().into(), values(*effect, strength, noise));
        truth.other_law |= OTHER_LAWS.contains(&effect.key());
    }
    // A leak's law shows with a leak only.
    if truth.effects.contains_key("turbulent_leak") {
        truth.leak_area_m2 = truth.leak_area_m2.max(1e-6);
    }
    truth
}

/// How far loads and times differ from cycle to cycle, on half of the machines each.
const LOAD_VARIATION: f64 = 0.014;
const JITTER_S: f64 = 3e-3;

/// A machine whose parameters are off by so many of their usual spreads, with a leak from none to large.
fn machine(set: Set, off: f64, noise: &mut Noise) -> Truth {
    let plan = PlantParameters::default();
    let mut parameters = BTreeMap::new();
    let spreads: [(&str, f64); 17] = [
        ("valve_m3_per_s_sqrt_pa", 0.10),
        ("viscous_friction_n_s_per_m", 0.35),
        ("mass_kg", 0.35),
        ("pump_flow_m3_per_s", 0.15),
        ("relief_pressure_pa", 0.05),
        ("relief_resistance_pa_s_per_m3", 0.25),
        ("bulk_modulus_pa", 0.10),
        ("line_m3_per_s_sqrt_pa", 0.08),
        ("seal_resistance_pa_s_per_m3", 0.4),
        ("load_scale", 0.06),
        ("supply_volume_m3", 0.15),
        ("inlet_volume_m3", 0.15),
        ("cap_dead_volume_m3", 0.2),
        ("rod_dead_volume_m3", 0.2),
        ("valve_rod_resistance_pa_s_per_m3", 0.5),
        ("valve_return_resistance_pa_s_per_m3", 0.5),
        ("transition_pressure_pa", 0.2),
    ];
    if off > 0.0 {
        for (key, spread) in spreads {
            let factor = (off * spread * noise.normal(1.0).clamp(-2.0, 2.0)).exp();
            parameters.insert(key.to_owned(), plan.get(key).unwrap_or(0.0) * factor);
        }
        let back = plan.return_pressure_pa + off * noise.uniform(-0.5e5, 3e5);
        parameters.insert("return_pressure_pa".into(), back);
    }
    let leak_area_m2 = if noise.uniform(0.0, 1.0) < 0.2 {
        0.0
    } else {
        10f64.powf(noise.uniform(5e-8_f64.log10(), 1e-5_f64.log10()))
    };
    let some = |share: f64, value: f64, noise: &mut Noise| {
        if noise.uniform(0.0, 1.0) < share { value } else { 0.0 }
    };
    let load_variation = some(0.5, LOAD_VARIATION, noise);
    let jitter_s = some(0.5, JITTER_S, noise);
    let transducers = std::array::from_fn(|_| Transducer::drawn(noise));
    Truth {
        set,
        effects: EffectValues::new(),
        other_law: false,
        foreign: None,
        leak_area_m2,
        parameters,
        load_variation,
        jitter_s,
        transducers,
        seed: noise.uniform(0.0, 1e9) as u64,
    }
}

/// An effect's values at a strength drawn from a range; what is not its size lies anywhere in the middle of its range.
fn values(effect: &dyn Effect, strength: (f64, f64), noise: &mut Noise) -> BTreeMap<String, f64> {
    let mut given = BTreeMap::new();
    for (index, parameter) in effect.parameters().iter().enumerate() {
        let share = noise.uniform(strength.0, strength.1);
        let anywhere = noise.uniform(0.15, 0.85);
        let up = noise.uniform(0.0, 1.0) < 0.5;
        given.insert(parameter.name.to_owned(), value(effect.key(), parameter, index, (share, anywhere, up)));
    }
    if let (Some(coulomb), Some(excess)) =
        (given.get("force_n").copied(), given.get("static_force_n").copied())
    {
        // Static friction is what it takes beyond the dynamic one.
        given.insert("static_force_n".into(), (1.2 * coulomb + 0.3 * excess).min(8e3));
    }
    given
}

fn value(effect: &str, parameter: &Parameter, index: usize, (share, anywhere, up): (f64, f64, bool)) -> f64 {
    let (low, high) = parameter.range;
    let inside = low < parameter.neutral && parameter.neutral < high;
    match (effect, parameter.name) {
        // Above 0.5 1/s it never acts.
        ("valve_rate_limit", _) => 0.5 - 0.1 * share,
        // Sharp edges and corners, notches from their tip, one stiffness; the other laws have round ones, a parabola and a spring that hardens.
        ("valve_deadband" | "valve_hysteresis", "rounding")
        | ("valve_flow_shape", "notch_start")
        | ("spring_load", "progression_per_m") => 0.0,
        // Laminar; the other law is an orifice.
        ("external_leak", "exponent") => 1.0,
        // Strongest where they are lowest.
        ("valve_lag", "natural_frequency_hz") => high * (low / high).powf(share),
        ("structure_compliance", "stiffness_n_per_m") => high * (low / high).powf(share),
        ("cushioning", "flow_ratio") => 1.0 - 0.9 * share,
        ("controller_gains", _) => 2f64.powf(if up { share } else { -share }),
        (_, "start_s") => 0.5 + 8.0 * anywhere,
        (_, "duration_s") => 0.3 + 1.2 * anywhere,
        _ if inside && up => parameter.neutral + share * (high - parameter.neutral),
        _ if inside => parameter.neutral - share * (parameter.neutral - low),
        // Neutral at the upper end.
        _ if parameter.neutral >= high => high - share * (high - low),
        _ if index == 0 || parameter.name == "rod_m3_per_s_pa" || parameter.name == "b_m3" => {
            low + share * (high - low)
        }
        _ => low + anywhere * (high - low),
    }
}

//! From data-sheet numbers to a plant in SI units: what the user knows is taken, what nobody said is scaled from the nominal press.

use std::collections::BTreeMap;

use seepd_sim::MachineSpec;
use seepd_sim::oil;
use serde::Serialize;

use crate::flow_curve;
use crate::machine_data::{ControllerData, ControllerKind, Datum, MachineData, Orientation, RatedOver};
use crate::overlap;

/// A uniform distribution of this half width has the standard deviation of 1: what a tolerance is to a fit.
pub(crate) const UNIFORM: f64 = 1.732_050_8;

/// Pascals in a bar.
const BAR_PA: f64 = 1e5;
/// Cubic metres a second in a litre a minute.
const LPM_M3_PER_S: f64 = 1.0 / 60_000.0;
/// Gravity, m/s².
const GRAVITY_M_PER_S2: f64 = 9.81;
/// Rod diameter over bore where nobody said: between the usual area ratios of 1.4 and 1.6 (ISO 3320, ISO 6020-2).
const USUAL_ROD_SHARE: f64 = 0.56;
/// What a machine's fastest move usually takes of its pump's flow: pumps are chosen with a third to a half to spare.
const USUAL_PUMP_SHARE: f64 = 0.7;
/// Least opening of the valve that tells what it passes, share of full.
const LEAST_OPENING: f64 = 0.05;
/// Flow of the valve's loop at which servo valves are rated, bar (ISO 10770-1 measures at 70 bar), and proportional valves.
const SERVO_RATED_BAR: f64 = 70.0;
/// Speed gain of the position loop of the nominal press, 1/s, and its ratio of integral to proportional gain, 1/s.
const USUAL_LOOP_PER_S: f64 = 9.3;
const USUAL_INTEGRAL_PER_S: f64 = 1.25;
/// Longest task period that is simulated, s: a slower log has every n-th command of a faster controller.
const LONGEST_TASK_S: f64 = 4e-3;

/// Ticks of a cycle that are enough, and the shortest tick, s.
const TICKS: f64 = 10_000.0;
const SHORTEST_TICK_S: f64 = 5e-4;
/// Steps of the plant in a tick, at least; a stiff plant takes more.
const LEAST_STEPS: usize = 4;

/// Volume between line and valve over that of the nominal press: its pressure settles within a millisecond all the same, and the simulation
/// may take longer steps.
const SOFT_INLET: f64 = 2.5;
/// That volume grows until its pressure settles in this share of a tick, of which the command says nothing, but to no more than this share
/// of the cylinder's: a slow machine is simulated in few steps then.
const SETTLED_SHARE: f64 = 0.18;
const LARGEST_INLET: f64 = 0.3;

/// Usual tolerances of data sheets, shares of the value.
mod tolerance {
    pub(super) const MACHINED: f64 = 0.0;
    pub(super) const VALVE: f64 = 0.10;
    pub(super) const PUMP: f64 = 0.10;
    pub(super) const PRESSURE: f64 = 0.05;
    pub(super) const MASS: f64 = 0.20;
    /// Of a valve that is told by the pump.
    pub(super) const BY_THE_PUMP: f64 = 0.30;
    /// Of what is scaled from the nominal press: a factor of 2 to either side.
    pub(super) const UNKNOWN: f64 = 1.0;
}

/// Where a value of the plant file comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Origin {
    /// The user's file.
    User,
    /// The log, by a fit.
    Fitted,
    /// The nominal press, scaled to the machine's size.
    Default,
    /// It was free in the fit, and the log says nothing of it.
    NotIdentifiable,
}

impl Origin {
    /// In words.
    pub const fn words(self) -> &'static str {
        match self {
            Origin::User => "yours",
            Origin::Fitted => "fitted to the log",
            Origin::Default => "usual for a machine of this size",
            Origin::NotIdentifiable => "not to be told from this log",
        }
    }
}

/// A value of the plant file and how well it is known.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PlantValue {
    /// Value, in the key's SI unit.
    pub value: f64,
    /// Where it comes from.
    pub origin: Origin,
    /// How far it may be off to either side, share of the value.
    pub tolerance: f64,
}

/// A machine in SI units.
#[derive(Debug, Clone)]
pub struct DescribedPlant {
    /// The machine; its duty cycle is the log's.
    pub spec: MachineSpec,
    /// How well each of the plant's parameters is known, by key.
    pub values: BTreeMap<&'static str, PlantValue>,
    /// Whether the user said how far the valve's lands overlap.
    pub knows_overlap: bool,
    /// Whether the user said how the valve's flow grows with the command.
    pub knows_curve: bool,
    /// Weight of the moved mass, N, positive in the extending direction.
    pub weight_n: f64,
    /// What the user knows of the controller.
    pub controller: ControllerData,
    /// What to know, one line each.
    pub remarks: Vec<String>,
}

/// What the log says of the machine's size.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LoggedSize {
    /// Time from one sample to the next, s.
    pub log_period_s: f64,
    /// Time of a duty cycle, s.
    pub period_s: f64,
    /// Lowest and highest position, m.
    pub positions_m: Option<(f64, f64)>,
    /// Speed over command where the machine moves, m/s at full command.
    pub speed_m_per_s: Option<f64>,
    /// Largest command of the duty cycle, share of full command.
    pub largest_command: Option<f64>,
}

/// Data that cannot be of one machine.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DataError {
    /// A number that must be positive.
    #[error("`{key}` is {value}; it must be positive")]
    NotPositive {
        /// Key.
        key: &'static str,
        /// Value.
        value: f64,
    },
    /// A share outside of what it can be.
    #[error("`{key}` is {value}; it must lie in {low} … {high}")]
    Outside {
        /// Key.
        key: &'static str,
        /// Value.
        value: f64,
        /// Least.
        low: f64,
        /// Largest.
        high: f64,
    },
    /// The rod does not fit the bore.
    #[error(
        "the rod ({rod_mm} mm) is not thinner than the bore ({bore_mm} mm): are {key} and cylinder.bore_mm exchanged?"
    )]
    Rod {
        /// Which rod.
        key: &'static str,
        /// Rod, mm.
        rod_mm: f64,
        /// Bore, mm.
        bore_mm: f64,
    },
    /// The log's positions do not fit the stroke.
    #[error(
        "the log's positions span {logged_mm:.0} mm, but cylinder.stroke_mm is {stroke_mm:.0}: is it another axis, or is the position's scale wrong?"
    )]
    Stroke {
        /// Span of the log, mm.
        logged_mm: f64,
        /// Stroke, mm.
        stroke_mm: f64,
    },
    /// The valve cannot give the speed of the log.
    #[error(
        "the log moves at {logged_m_per_s:.3} m/s a full command, but this valve, bore and pressure give {possible_m_per_s:.3} m/s: check \
         valve.rated_flow_lpm, valve.rated_at_bar, cylinder.bore_mm and the scales of command and position"
    )]
    Speed {
        /// Speed over command in the log, m/s.
        logged_m_per_s: f64,
        /// What the machine can do, m/s.
        possible_m_per_s: f64,
    },
}

/// The speed of the log may exceed that of the data by this factor, and fall short of it by the other.
const SPEED_ROOM: (f64, f64) = (2.5, 0.25);
/// The log's positions may exceed the stroke by this factor.
const STROKE_ROOM: f64 = 1.05;

/// Makes the plant of a machine.
///
/// # Errors
/// [`DataError`] for data that cannot be of one machine, or not of that log.
pub fn describe(data: &MachineData, logged: &LoggedSize) -> Result<DescribedPlant, DataError> {
    check(data)?;
    let mut describer =
        Describer { spec: MachineSpec::default(), values: BTreeMap::new(), remarks: Vec::new() };
    describer.supply_pressure(data);
    describer.cylinder(data, logged)?;
    describer.valve(data, logged);
    describer.rest_of_the_plant(data);
    describer.speed_fits(data, logged)?;
    describer.controller(data, logged);
    describer.soften_the_inlet();
    let sign = match data.cylinder.orientation {
        Orientation::Horizontal => 0.0,
        Orientation::RodUp => -1.0,
        Orientation::RodDown => 1.0,
    };
    let weight_n = sign * GRAVITY_M_PER_S2 * describer.spec.plant.mass_kg;
    Ok(DescribedPlant {
        spec: describer.spec,
        values: describer.values,
        knows_overlap: data.valve.overlap_percent.is_some(),
        knows_curve: data.valve.curve.is_some(),
        weight_n,
        controller: data.controller.clone(),
        remarks: describer.remarks,
    })
}

/// Every number that must be positive, with its key.
fn check(data: &MachineData) -> Result<(), DataError> {
    let positive = [
        ("cylinder.bore_mm", data.cylinder.bore_mm),
        ("cylinder.rod_mm", data.cylinder.rod_mm),
        ("cylinder.second_rod_mm", data.cylinder.second_rod_mm),
        ("cylinder.stroke_mm", data.cylinder.stroke_mm),
        ("cylinder.moved_mass_kg", data.cylinder.moved_mass_kg),
        ("cylinder.hose_bore_mm", data.cylinder.hose_bore_mm),
        ("valve.rated_flow_lpm", data.valve.rated_flow_lpm),
        ("valve.rated_at_bar", data.valve.rated_at_bar.map(Datum::Bare)),
        ("supply.pump_flow_lpm", data.supply.pump_flow_lpm),
        ("supply.relief_bar", data.supply.relief_bar),
        ("oil.density_kg_per_m3", data.oil.density_kg_per_m3),
        ("oil.iso_vg", data.oil.iso_vg.map(Datum::Bare)),
        ("controller.kp_per_m", data.controller.kp_per_m),
        ("controller.integral_window_mm", data.controller.integral_window_mm),
        ("controller.task_period_ms", data.controller.task_period_ms),
    ];
    for (key, datum) in positive {
        if let Some(value) = datum.map(Datum::value).filter(|value| !(value.is_finite() && *value > 0.0)) {
            return Err(DataError::NotPositive { key, value });
        }
    }
    let within = [
        ("cylinder.hose_length_m", data.cylinder.hose_length_m.map(Datum::value), 0.0, 1000.0),
        ("valve.overlap_percent", data.valve.overlap_percent.map(Datum::value), 0.0, 50.0),
        (
            "controller.dead_band_compensation_percent",
            data.controller.dead_band_compensation_percent.map(Datum::value),
            0.0,
            50.0,
        ),
        ("valve.rod_side_flow_percent", data.valve.rod_side_flow_percent, 10.0, 200.0),
        ("valve.knee_percent", data.valve.knee_percent, 5.0, 70.0),
        ("controller.ki_per_m_s", data.controller.ki_per_m_s.map(Datum::value), 0.0, 1e6),
        ("controller.kd_s_per_m", data.controller.kd_s_per_m.map(Datum::value), 0.0, 1e6),
        (
            "controller.velocity_feed_forward_s_per_m",
            data.controller.velocity_feed_forward_s_per_m.map(Datum::value),
            0.0,
            1e3,
        ),
        ("supply.return_bar", data.supply.return_bar.map(Datum::value), 0.0, 100.0),
        ("supply.accumulator_l", data.supply.accumulator_l.map(Datum::value), 0.0, 1e4),
        ("oil.temperature_c", data.oil.temperature_c, -20.0, 120.0),
    ];
    for (key, value, low, high) in within {
        if let Some(value) = value.filter(|value| !(low..=high).contains(value)) {
            return Err(DataError::Outside { key, value, low, high });
        }
    }
    if let (Some(percent), Some([low, high])) =
        (data.valve.flow_at_knee_percent, flow_curve::possible_flow_percent(&data.valve))
        && !(low..=high).contains(&percent)
    {
        return Err(DataError::Outside { key: "valve.flow_at_knee_percent", value: percent, low, high });
    }
    let cylinder = &data.cylinder;
    for (key, rod) in
        [("cylinder.rod_mm", cylinder.rod_mm), ("cylinder.second_rod_mm", cylinder.second_rod_mm)]
    {
        if let (Some(rod), Some(bore)) = (rod, cylinder.bore_mm)
            && rod.value() >= bore.value()
        {
            return Err(DataError::Rod { key, rod_mm: rod.value(), bore_mm: bore.value() });
        }
    }
    Ok(())
}

fn circle_m2(diameter_mm: f64) -> f64 {
    std::f64::consts::FRAC_PI_4 * (diameter_mm * 1e-3).powi(2)
}

struct Describer {
    spec: MachineSpec,
    values: BTreeMap<&'static str, PlantValue>,
    remarks: Vec<String>,
}

impl Describer {
    fn set(&mut self, key: &'static str, value: f64, origin: Origin, tolerance: f64) {
        if let Some(slot) = self.spec.plant.get_mut(key) {
            *slot = value;
            self.values.insert(key, PlantValue { value, origin, tolerance });
        }
    }

    fn known(&mut self, key: &'static str, datum: Datum, to_si: f64, usual: f64) {
        self.set(key, datum.value() * to_si, Origin::User, datum.tolerance().unwrap_or(usual));
    }

    fn usual(&mut self, key: &'static str, value: f64) {
        self.set(key, value, Origin::Default, tolerance::UNKNOWN);
    }

    fn supply_pressure(&mut self, data: &MachineData) {
        let nominal = self.spec.plant.clone();
        match data.supply.relief_bar {
            Some(datum) => self.known("relief_pressure_pa", datum, BAR_PA, tolerance::PRESSURE),
            None => self.set("relief_pressure_pa", nominal.relief_pressure_pa, Origin::Default, 0.4),
        }
        match data.supply.return_bar {
            Some(datum) => self.known("return_pressure_pa", datum, BAR_PA, 0.5),
            None => self.usual("return_pressure_pa", nominal.return_pressure_pa),
        }
    }

    fn cylinder(&mut self, data: &MachineData, logged: &LoggedSize) -> Result<(), DataError> {
        let cylinder = &data.cylinder;
        let from_flow = || {
            let flow = data.valve.rated_flow_lpm?.value() * LPM_M3_PER_S * self.flow_share(data);
            let area = flow / logged.speed_m_per_s?;
            Some((area / std::f64::consts::FRAC_PI_4).sqrt() * 1e3)
        };
        let (bore_mm, origin, tolerance) = match (cylinder.bore_mm, cylinder.rod_mm, from_flow()) {
            (Some(bore), ..) => (bore.value(), Origin::User, bore.tolerance().unwrap_or(tolerance::MACHINED)),
            (None, _, Some(by_flow)) => (by_flow, Origin::Fitted, 0.15),
            (None, Some(rod), None) => (rod.value() / USUAL_ROD_SHARE, Origin::Default, 0.2),
            (None, None, None) => {
                self.remarks.push(
                    "neither the bore nor the valve's flow is known, so that leaks cannot be given in L/min: measure or look up one of them"
                        .into(),
                );
                (63.0, Origin::Default, tolerance::UNKNOWN)
            }
        };
        let (rod_mm, rod_origin) = cylinder
            .rod_mm
            .map_or((USUAL_ROD_SHARE * bore_mm, Origin::Default), |rod| (rod.value(), Origin::User));
        let beside = |rod_mm: f64| circle_m2(bore_mm) - circle_m2(rod_mm.min(0.95 * bore_mm));
        self.set("cap_area_m2", beside(cylinder.second_rod_mm.map_or(0.0, Datum::value)), origin, tolerance);
        let rod_tolerance = if rod_origin == Origin::User { tolerance } else { 0.15 };
        self.set("annulus_area_m2", beside(rod_mm), rod_origin, rod_tolerance);
        let span = logged.positions_m.map(|(low, high)| high - low);
        match cylinder.stroke_mm {
            Some(stroke) => {
                self.known("stroke_m", stroke, 1e-3, tolerance::MACHINED);
                let stroke_mm = stroke.value();
                if let Some(logged_mm) =
                    span.map(|span| span * 1e3).filter(|span| *span > STROKE_ROOM * stroke_mm)
                {
                    return Err(DataError::Stroke { logged_mm, stroke_mm });
                }
            }
            None => {
                let highest = logged.positions_m.map(|(low, high)| 1.1 * high.max(high - low));
                self.set("stroke_m", highest.unwrap_or(8e-3 * bore_mm), Origin::Default, 0.3);
            }
        }
        Ok(())
    }

    /// Flow of the valve's rating that a stroke at half of the supply pressure uses, over the rated one.
    fn flow_share(&self, data: &MachineData) -> f64 {
        (0.5 * self.spec.plant.relief_pressure_pa / rated_land_pa(data)).sqrt()
    }

    fn valve(&mut self, data: &MachineData, logged: &LoggedSize) {
        let valve = &data.valve;
        let key = "valve_m3_per_s_sqrt_pa";
        let stated = overlap::stated(data).unwrap_or(0.0);
        let half_width = stated.clamp(0.0, overlap::WIDEST);
        match (valve.rated_flow_lpm, logged.speed_m_per_s) {
            (Some(flow), _) => {
                // The rated flow is that of full command, which opens an overlapped valve by what is left beyond the overlap.
                let to_si = LPM_M3_PER_S / rated_land_pa(data).sqrt() / (1.0 - half_width);
                self.known(key, flow, to_si, tolerance::VALVE);
                if valve.rated_at_bar.is_none() {
                    self.remarks.push(format!(
                        "valve.rated_at_bar is not given: {SERVO_RATED_BAR} bar over the loop is taken, as for servo valves; proportional valves \
                         are rated at 10 bar"
                    ));
                }
            }
            (None, Some(speed)) => {
                let p = &self.spec.plant;
                let coefficient =
                    speed / speed_of(p.cap_area_m2, p.annulus_area_m2, p.relief_pressure_pa, 1.0);
                self.set(key, coefficient, Origin::Fitted, 0.3);
            }
            (None, None) => match by_the_pump(&self.spec, data, logged, half_width) {
                Some(coefficient) => {
                    self.set(key, coefficient, Origin::Default, tolerance::BY_THE_PUMP);
                    self.remarks.push(format!(
                        "valve.rated_flow_lpm is not given: the valve is taken to pass {:.0} % of the pump's flow at the largest command of the log; \
                         sizes in L/min are in proportion to that",
                        100.0 * USUAL_PUMP_SHARE
                    ));
                }
                None => {
                    let nominal = MachineSpec::default().plant;
                    let scale = self.spec.plant.cap_area_m2 / nominal.cap_area_m2;
                    self.usual(key, scale * nominal.valve_m3_per_s_sqrt_pa);
                    self.remarks.push(
                        "valve.rated_flow_lpm is not given, and nothing else tells the valve's flow: one that is usual for the bore is taken; \
                         sizes in L/min are in proportion to that, and may be off by a factor of two"
                            .into(),
                    );
                }
            },
        }
        if half_width > 0.0 {
            self.spec.effects.insert(overlap::LAW.into(), overlap::law(half_width));
        }
        if stated > half_width {
            self.remarks.push(format!(
                "an overlap of {:.0} % is beyond the plant's widest; {:.0} % is taken",
                100.0 * stated,
                100.0 * half_width
            ));
        }
        if let Some(percent) = valve.rod_side_flow_percent {
            let ratio = BTreeMap::from([("rod_side".to_owned(), percent / 100.0)]);
            self.spec.effects.insert("valve_port_ratio".into(), ratio);
        }
        if let Some(curve) = flow_curve::stated(valve).filter(|curve| !curve.is_empty()) {
            self.spec.effects.insert(flow_curve::LAW.into(), curve);
        }
    }

    /// What goes with the machine's size: flows with the valve, forces with the piston.
    fn rest_of_the_plant(&mut self, data: &MachineData) {
        let nominal = MachineSpec::default().plant;
        let flow = self.spec.plant.valve_m3_per_s_sqrt_pa / nominal.valve_m3_per_s_sqrt_pa;
        let area = self.spec.plant.cap_area_m2 / nominal.cap_area_m2;
        let swept = area * self.spec.plant.stroke_m / nominal.stroke_m;
        match data.supply.pump_flow_lpm {
            Some(datum) => self.known("pump_flow_m3_per_s", datum, LPM_M3_PER_S, tolerance::PUMP),
            None => self.usual("pump_flow_m3_per_s", flow * nominal.pump_flow_m3_per_s),
        }
        match data.cylinder.moved_mass_kg {
            Some(datum) => self.known("mass_kg", datum, 1.0, tolerance::MASS),
            None => self.usual("mass_kg", area * nominal.mass_kg),
        }
        if let Some(density) = data.oil.density_kg_per_m3 {
            self.known("density_kg_per_m3", density, 1.0, tolerance::MACHINED);
        }
        // An accumulator of gas at half of the supply pressure gives as a volume of oil so many times as large does.
        let gas_m3 = data.supply.accumulator_l.map_or(0.0, |litres| litres.value() * 1e-3);
        let as_oil_m3 = gas_m3 * nominal.bulk_modulus_pa / (1.4 * self.spec.plant.relief_pressure_pa);
        self.usual("supply_volume_m3", flow * nominal.supply_volume_m3 + as_oil_m3);
        self.usual("inlet_volume_m3", SOFT_INLET * flow * nominal.inlet_volume_m3);
        self.usual("relief_resistance_pa_s_per_m3", nominal.relief_resistance_pa_s_per_m3 / flow);
        self.usual("line_m3_per_s_sqrt_pa", flow * nominal.line_m3_per_s_sqrt_pa);
        let hose_m3 = match (data.cylinder.hose_length_m, data.cylinder.hose_bore_mm) {
            (Some(length), Some(bore)) => length.value() * circle_m2(bore.value()),
            (Some(length), None) => length.value() * 0.1 * self.spec.plant.cap_area_m2,
            _ => 0.0,
        };
        self.usual("cap_dead_volume_m3", swept * nominal.cap_dead_volume_m3 + hose_m3);
        self.usual("rod_dead_volume_m3", swept * nominal.rod_dead_volume_m3 + hose_m3);
        let oil_c = data.oil.temperature_c.unwrap_or(oil::NOMINAL_TEMPERATURE_C);
        let grade = data.oil.iso_vg.unwrap_or(46.0) / 46.0;
        let thick = grade * oil::viscosity_factor(oil_c);
        self.usual("viscous_friction_n_s_per_m", thick * area * nominal.viscous_friction_n_s_per_m);
        self.usual("seal_resistance_pa_s_per_m3", thick * nominal.seal_resistance_pa_s_per_m3 / flow);
        self.usual(
            "valve_return_resistance_pa_s_per_m3",
            thick * nominal.valve_return_resistance_pa_s_per_m3 / flow,
        );
        let balance = if self.spec.effects.contains_key(overlap::LAW) { overlap::BALANCED } else { 1.0 };
        self.usual(overlap::ONE_SIDED, balance * thick * nominal.valve_rod_resistance_pa_s_per_m3 / flow);
        self.set("bulk_modulus_pa", nominal.bulk_modulus_pa, Origin::Default, 0.3);
    }

    fn speed_fits(&self, data: &MachineData, logged: &LoggedSize) -> Result<(), DataError> {
        let p = &self.spec.plant;
        let opening = 1.0 - overlap::half_width(&self.spec).unwrap_or(0.0);
        let full = opening * p.valve_m3_per_s_sqrt_pa;
        let possible = speed_of(p.cap_area_m2, p.annulus_area_m2, p.relief_pressure_pa, full);
        match logged.speed_m_per_s {
            Some(logged_m_per_s)
                if data.valve.rated_flow_lpm.is_some()
                    && data.cylinder.bore_mm.is_some()
                    && !(SPEED_ROOM.1..SPEED_ROOM.0).contains(&(logged_m_per_s / possible)) =>
            {
                Err(DataError::Speed { logged_m_per_s, possible_m_per_s: possible })
            }
            _ => Ok(()),
        }
    }

    fn controller(&mut self, data: &MachineData, logged: &LoggedSize) {
        let given = &data.controller;
        let p = &self.spec.plant;
        let gain = speed_of(p.cap_area_m2, p.annulus_area_m2, p.relief_pressure_pa, p.valve_m3_per_s_sqrt_pa);
        let kp = given.kp_per_m.map_or(USUAL_LOOP_PER_S / gain, Datum::value);
        let integrates = given.kind != Some(ControllerKind::P);
        let usual_ki = if integrates { USUAL_INTEGRAL_PER_S * kp } else { 0.0 };
        let c = &mut self.spec.controller;
        c.kp = kp;
        c.ki = given.ki_per_m_s.map_or(usual_ki, Datum::value);
        c.kd = given.kd_s_per_m.map_or(0.0, Datum::value);
        c.velocity_feed_forward_s_per_m = given.velocity_feed_forward_s_per_m.map_or(0.0, Datum::value);
        c.dead_band_compensation =
            given.dead_band_compensation_percent.map_or(0.0, |percent| percent.value() / 100.0);
        c.integral_window_m = given.integral_window_mm.map_or(0.0, |window| window.value() * 1e-3);
        let task_s = given.task_period_ms.map_or(LONGEST_TASK_S, |ms| ms.value() * 1e-3);
        // A loop of 10 1/s does not feel whether its task takes half a millisecond or four; a simulation of a long cycle does.
        let fine_s = (logged.period_s / TICKS).clamp(SHORTEST_TICK_S, LONGEST_TASK_S);
        let tick_s = task_s.clamp(fine_s, LONGEST_TASK_S);
        c.log_every = (logged.log_period_s / tick_s - 1e-6).ceil().max(1.0) as usize;
        c.period_s = logged.log_period_s / c.log_every as f64;
        c.steps_per_period = LEAST_STEPS;
    }

    /// See [`SETTLED_SHARE`]; the line's law is steepest without a flow.
    fn soften_the_inlet(&mut self) {
        let p = &self.spec.plant;
        let slope = p.line_m3_per_s_sqrt_pa / p.transition_pressure_pa.sqrt();
        let settled_m3 = p.bulk_modulus_pa * slope * SETTLED_SHARE * self.spec.controller.period_s;
        let volume_m3 = settled_m3.min(LARGEST_INLET * p.cap_area_m2 * p.stroke_m).max(p.inlet_volume_m3);
        self.usual("inlet_volume_m3", volume_m3);
    }
}

/// Pressure drop over one land at which the valve's flow is rated, Pa.
fn rated_land_pa(data: &MachineData) -> f64 {
    let bar = data.valve.rated_at_bar.unwrap_or(SERVO_RATED_BAR);
    let lands = match data.valve.rated_over {
        Some(RatedOver::Land) => 1.0,
        Some(RatedOver::Loop) | None => 2.0,
    };
    bar * BAR_PA / lands
}

/// The valve's coefficient, m³/(s √Pa), of a machine whose fastest move takes a usual share of what the pump gives; `None` where the pump or
/// the command is unknown, or an accumulator gives more than the pump.
fn by_the_pump(spec: &MachineSpec, data: &MachineData, logged: &LoggedSize, half_width: f64) -> Option<f64> {
    let pump_m3_per_s = data.supply.pump_flow_lpm?.value() * LPM_M3_PER_S;
    let opening = (logged.largest_command? - half_width) / (1.0 - half_width);
    let p = &spec.plant;
    let mean_area_m2 = 0.5 * (p.cap_area_m2 + p.annulus_area_m2);
    let flow_m3_per_s =
        mean_area_m2 * speed_of(p.cap_area_m2, p.annulus_area_m2, p.relief_pressure_pa, opening);
    let is_told = data.supply.accumulator_l.is_none() && opening > LEAST_OPENING;
    is_told.then(|| USUAL_PUMP_SHARE * pump_m3_per_s / flow_m3_per_s)
}

/// Steady speed at full command without a load, m/s, the mean of both ways: the pressures of both chambers balance the flows through both
/// lands.
pub(crate) fn speed_of(cap_m2: f64, annulus_m2: f64, supply_pa: f64, valve_m3_per_s_sqrt_pa: f64) -> f64 {
    let cubes = cap_m2.powi(3) + annulus_m2.powi(3);
    let way = |area: f64| (area * supply_pa / cubes).sqrt();
    0.5 * valve_m3_per_s_sqrt_pa * (way(cap_m2) + way(annulus_m2))
}

#[cfg(test)]
mod tests {
    use seepd_sim::Controller;
    use seepd_sim::opening::SteadyOpening;

    use super::*;

    /// The nominal press's own data sheet gives the nominal press.
    #[test]
    fn the_nominal_press_is_described_by_its_data_sheet() {
        let text = "[cylinder]\nbore_mm = 63\nrod_mm = 36\nstroke_mm = 500\nmoved_mass_kg = 250\n\
                    [valve]\nrated_flow_lpm = 96\nrated_at_bar = 70\n[supply]\npump_flow_lpm = 90\nrelief_bar = 160\nreturn_bar = 1\n\
                    [controller]\nkp_per_m = 12\nki_per_m_s = 15\n";
        let data = MachineData::from_toml(text).unwrap();
        let described =
            describe(&data, &LoggedSize { log_period_s: 1e-3, period_s: 10.0, ..LoggedSize::default() })
                .unwrap();
        let nominal = MachineSpec::default();
        for info in seepd_sim::PlantParameters::ALL {
            let (given, wanted) =
                (described.spec.plant.get(info.key).unwrap(), nominal.plant.get(info.key).unwrap());
            if info.key == "inlet_volume_m3" {
                continue;
            }
            let tolerance = 2e-3 * wanted.abs().max(f64::MIN_POSITIVE);
            assert!((given - wanted).abs() <= tolerance, "{}: {given} {wanted}", info.key);
        }
        let controller = Controller { steps_per_period: 10, ..described.spec.controller };
        assert_eq!(controller, nominal.controller);
        assert_eq!(described.values["valve_m3_per_s_sqrt_pa"].origin, Origin::User);
        assert_eq!(described.values["bulk_modulus_pa"].origin, Origin::Default);
    }

    /// By command alone a pump of 90 L/min tells a valve that passes 63 L/min, the mean of both ways, where the command is largest. Without
    /// it, and beside an accumulator, the bore alone says what is usual.
    #[test]
    fn a_pump_tells_the_valve_where_neither_paper_nor_log_does() {
        let of = |supply: &str, overlap: &str| {
            let text = format!(
                "[cylinder]\nbore_mm = 63\nrod_mm = 36\n[valve]\n{overlap}\n[supply]\nrelief_bar = 160\n{supply}\n"
            );
            let data = MachineData::from_toml(&text).unwrap();
            let logged = LoggedSize {
                log_period_s: 1e-3,
                period_s: 10.0,
                largest_command: Some(0.6),
                ..LoggedSize::default()
            };
            describe(&data, &logged).unwrap()
        };
        for (overlap, opening) in [("", 0.6), ("overlap_percent = 5", 0.55 / 0.95)] {
            let told = of("pump_flow_lpm = 90", overlap);
            let p = &told.spec.plant;
            let valve = opening * p.valve_m3_per_s_sqrt_pa;
            let speed_m_per_s = speed_of(p.cap_area_m2, p.annulus_area_m2, p.relief_pressure_pa, valve);
            let flow_lpm = 0.5 * (p.cap_area_m2 + p.annulus_area_m2) * speed_m_per_s / LPM_M3_PER_S;
            assert!((flow_lpm / 63.0 - 1.0).abs() < 1e-9, "{overlap}: {flow_lpm}");
            assert_eq!(told.values["valve_m3_per_s_sqrt_pa"].tolerance, tolerance::BY_THE_PUMP);
            assert!(told.remarks.iter().any(|remark| remark.contains("70 % of the pump's flow")));
        }
        for supply in ["", "pump_flow_lpm = 90\naccumulator_l = 10"] {
            let untold = of(supply, "");
            assert_eq!(untold.values["valve_m3_per_s_sqrt_pa"].tolerance, tolerance::UNKNOWN, "{supply}");
            assert!(untold.remarks.iter().any(|remark| remark.contains("a factor of two")));
        }
    }

    /// Full command opens an overlapped valve by what is left beyond the overlap, and gives the rated flow all the same. A jump alone tells
    /// of an overlap that is a little wider.
    #[test]
    fn an_overlapped_valve_passes_its_rated_flow_at_full_command() {
        let of = |overlap: &str| {
            let text = format!("[valve]\nrated_flow_lpm = 96\nrated_at_bar = 70\n{overlap}");
            let logged = LoggedSize { log_period_s: 1e-3, period_s: 10.0, ..LoggedSize::default() };
            describe(&MachineData::from_toml(&text).unwrap(), &logged).unwrap().spec
        };
        let at_full =
            |spec: &MachineSpec| spec.plant.valve_m3_per_s_sqrt_pa * SteadyOpening::of(spec).at(1.0);
        let lapped = at_full(&of(""));
        let one_sided = of("").plant.valve_rod_resistance_pa_s_per_m3;
        for (data, half_width) in [
            ("overlap_percent = 12\n", 0.12),
            ("overlap_percent = 12\n[controller]\ndead_band_compensation_percent = 11\n", 0.12),
            ("[controller]\ndead_band_compensation_percent = 11\n", 0.11 / 0.92),
        ] {
            let spec = of(data);
            assert!((spec.effects[overlap::LAW]["half_width"] - half_width).abs() < 1e-12, "{data}");
            assert!((at_full(&spec) / lapped - 1.0).abs() < 1e-3, "{data}");
            assert!(spec.plant.valve_rod_resistance_pa_s_per_m3 > 100.0 * one_sided, "{data}");
        }
    }

    /// A rod that goes through makes both sides of the piston alike; edges of half the width on the rod side are the plant's law of it.
    #[test]
    fn a_rod_that_goes_through_and_a_spool_for_unequal_areas_are_told_by_their_data() {
        let of = |text: &str| {
            let logged = LoggedSize { log_period_s: 1e-3, period_s: 10.0, ..LoggedSize::default() };
            describe(&MachineData::from_toml(text).unwrap(), &logged).unwrap().spec
        };
        let through = of("[cylinder]\nbore_mm = 50\nrod_mm = 28\nsecond_rod_mm = 28\n").plant;
        let ring_m2 = std::f64::consts::FRAC_PI_4 * (0.05_f64.powi(2) - 0.028_f64.powi(2));
        assert!((through.cap_area_m2 / ring_m2 - 1.0).abs() < 1e-12, "{}", through.cap_area_m2);
        assert_eq!(through.annulus_area_m2, through.cap_area_m2);
        let two_to_one = of("[valve]\nrated_flow_lpm = 40\nrod_side_flow_percent = 50\n");
        assert_eq!(two_to_one.effects["valve_port_ratio"], [("rod_side".to_owned(), 0.5)].into());
        two_to_one.check().unwrap();
    }

    #[test]
    fn data_that_contradict_themselves_or_the_log_are_refused() {
        let refused = |text: &str, logged: LoggedSize| {
            describe(&MachineData::from_toml(text).unwrap(), &logged).unwrap_err().to_string()
        };
        let slow = LoggedSize { log_period_s: 1e-3, period_s: 10.0, ..LoggedSize::default() };
        let rod = refused("[cylinder]\nbore_mm = 40\nrod_mm = 63\n", slow);
        assert!(rod.contains("cylinder.rod_mm and") && rod.contains("exchanged"), "{rod}");
        let second = refused("[cylinder]\nbore_mm = 40\nsecond_rod_mm = 63\n", slow);
        assert!(second.contains("cylinder.second_rod_mm and"), "{second}");
        let longer = LoggedSize { positions_m: Some((0.0, 0.9)), ..slow };
        let stroke = refused("[cylinder]\nstroke_mm = 500\n", longer);
        assert!(stroke.contains("900 mm") && stroke.contains("500"), "{stroke}");
        let faster = LoggedSize { speed_m_per_s: Some(5.0), ..slow };
        let speed = refused("[cylinder]\nbore_mm = 63\n[valve]\nrated_flow_lpm = 10\n", faster);
        assert!(speed.contains("5.000 m/s"), "{speed}");
        // What a valve passes at full command is its rated flow, with an overlap too.
        let valve = "[cylinder]\nbore_mm = 63\n[valve]\nrated_flow_lpm = 10\n";
        let plain = describe(&MachineData::from_toml(valve).unwrap(), &slow).unwrap().spec.plant;
        let possible = speed_of(
            plain.cap_area_m2,
            plain.annulus_area_m2,
            plain.relief_pressure_pa,
            plain.valve_m3_per_s_sqrt_pa,
        );
        let beyond = LoggedSize { speed_m_per_s: Some(1.02 * SPEED_ROOM.0 * possible), ..slow };
        for overlap in ["", "overlap_percent = 20\n"] {
            let speed = refused(&format!("{valve}{overlap}"), beyond);
            assert!(speed.contains("m/s"), "{speed}");
        }
        assert!(refused("[valve]\nrated_flow_lpm = -3\n", slow).contains("must be positive"));
    }
}

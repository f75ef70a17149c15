//! What a machine is made of, in SI units.

use serde::{Deserialize, Serialize};

use super::controller::Controller;
use super::duty::Duty;

/// Gravity, m/s².
pub(super) const GRAVITY_M_PER_S2: f64 = 9.81;
/// Pressure difference at which leaks are stated, Pa: 70 bar.
pub const REFERENCE_PA: f64 = 7e6;
/// Density at which valves are rated, kg/m³.
pub(super) const RATED_DENSITY_KG_PER_M3: f64 = 870.0;

/// A hydraulic axis with what it does.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Machine {
    /// Cylinder and load.
    pub cylinder: Cylinder,
    /// Control valve.
    pub valve: Valve,
    /// Where the oil comes from.
    pub supply: Supply,
    /// The oil.
    pub oil: Oil,
    /// Position controller.
    pub controller: Controller,
    /// Duty cycle.
    pub duty: Duty,
}

/// Cylinder, its lines and its load.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Cylinder {
    /// Bore, m.
    pub bore_m: f64,
    /// Diameter of the rod, m.
    pub rod_m: f64,
    /// Stroke, m.
    pub stroke_m: f64,
    /// Moved mass, kg.
    pub mass_kg: f64,
    /// Weight along the rod, N, positive where it extends: 0 for a level cylinder.
    pub weight_n: f64,
    /// Dead volume of each chamber without its hose, m³.
    pub dead_volume_m3: f64,
    /// Length of each hose, m; 0 where the valve sits on the cylinder.
    pub hose_length_m: f64,
    /// Inner diameter of the hoses, m.
    pub hose_bore_m: f64,
    /// Viscous friction at the working temperature, N s/m.
    pub viscous_n_s_per_m: f64,
    /// Coulomb friction, N.
    pub coulomb_n: f64,
    /// How much larger friction is when it breaks away, N.
    pub breakaway_n: f64,
    /// A part that is met on the way.
    pub contact: Option<Contact>,
}

/// A springy part in the way of the rod.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Contact {
    /// Where it is met, m.
    pub at_m: f64,
    /// Its stiffness, N/m.
    pub stiffness_n_per_m: f64,
}

impl Cylinder {
    /// Area of the cap side, m².
    pub fn cap_area_m2(&self) -> f64 {
        std::f64::consts::FRAC_PI_4 * self.bore_m * self.bore_m
    }

    /// Area of the rod side, m².
    pub fn annulus_area_m2(&self) -> f64 {
        self.cap_area_m2() - std::f64::consts::FRAC_PI_4 * self.rod_m * self.rod_m
    }

    /// Oil beside the piston's way in each chamber, m³.
    pub(super) fn fixed_volume_m3(&self) -> f64 {
        self.dead_volume_m3
            + std::f64::consts::FRAC_PI_4 * self.hose_bore_m * self.hose_bore_m * self.hose_length_m
    }
}

/// A 4/3 valve whose edges are round: none closes all at once.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Valve {
    /// Flow coefficient of an edge at full command, m³/s/√Pa.
    pub coefficient: f64,
    /// Half the width of the dead band, share of full command.
    pub overlap: f64,
    /// Over how much of the command an edge opens, share of full command.
    pub rounding: f64,
    /// Where the spool's middle is, share of full command.
    pub null_offset: f64,
    /// Flow over opening.
    pub curve: FlowCurve,
    /// Natural frequency of the spool, rad/s.
    pub natural_rad_per_s: f64,
    /// Its damping.
    pub damping: f64,
}

/// Flow over opening, both shares of full.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FlowCurve {
    /// In proportion.
    Linear,
    /// A line and a parabola: fine in the middle.
    Progressive {
        /// Share of the line.
        line: f64,
    },
    /// Two lines.
    DoubleGain {
        /// Opening at which the second begins.
        knee: f64,
        /// Flow at the knee.
        flow: f64,
    },
}

impl FlowCurve {
    /// Flow of an opening.
    pub(super) fn flow(self, opening: f64) -> f64 {
        match self {
            FlowCurve::Linear => opening,
            FlowCurve::Progressive { line } => opening * (line + (1.0 - line) * opening),
            FlowCurve::DoubleGain { knee, flow } if opening < knee => opening * flow / knee,
            FlowCurve::DoubleGain { knee, flow } => flow + (opening - knee) * (1.0 - flow) / (1.0 - knee),
        }
    }
}

/// Pump, accumulator and return line.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Supply {
    /// How the pressure is kept.
    pub pump: Pump,
    /// Flow of the pump, m³/s.
    pub flow_m3_per_s: f64,
    /// Pressure at which the relief valve opens or the pump stops giving, Pa.
    pub pressure_pa: f64,
    /// Pressure over which the relief valve opens, or below which the pump gives all it has, Pa.
    pub band_pa: f64,
    /// Oil between pump and valve, m³.
    pub volume_m3: f64,
    /// An accumulator.
    pub accumulator: Option<Accumulator>,
    /// Pressure in the return line, Pa.
    pub return_pa: f64,
}

/// How the supply's pressure is kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Pump {
    /// Always the same flow; a relief valve takes what is too much.
    Fixed,
    /// Only what is needed.
    Regulated,
}

/// A gas accumulator.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Accumulator {
    /// Volume of the gas at precharge, m³.
    pub volume_m3: f64,
    /// Precharge pressure, Pa.
    pub precharge_pa: f64,
}

/// The oil.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Oil {
    /// Viscosity at 40 °C, mm²/s.
    pub grade_mm2_per_s: f64,
    /// Working temperature, °C.
    pub temperature_c: f64,
    /// Bulk modulus with the hoses' give, Pa.
    pub bulk_modulus_pa: f64,
    /// Free air at ambient pressure, share of the volume.
    pub air: f64,
}

/// How steeply viscosity falls with temperature: ASTM D341's B for a mineral oil of viscosity index 100, from 46 and 6.8 mm²/s.
const D341_SLOPE: f64 = 3.68;

impl Oil {
    /// Kinematic viscosity at a temperature (ASTM D341), mm²/s.
    pub(super) fn viscosity_mm2_per_s(&self, temperature_c: f64) -> f64 {
        let kelvin = |celsius: f64| celsius + 273.15;
        let at_40 = (self.grade_mm2_per_s + 0.7).log10().log10();
        let double_log = at_40 - D341_SLOPE * (kelvin(temperature_c) / kelvin(40.0)).log10();
        10.0_f64.powf(10.0_f64.powf(double_log)) - 0.7
    }

    /// Density at a temperature, kg/m³.
    pub(super) fn density_kg_per_m3(temperature_c: f64) -> f64 {
        870.0 * (1.0 - 7e-4 * (temperature_c - 15.0))
    }
}

/// A leak past the piston.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Leak {
    /// Flow at 70 bar and the working temperature, m³/s.
    pub flow_m3_per_s: f64,
    /// Exponent of the pressure difference: 0.5 for an orifice, 1 for a narrow gap.
    pub exponent: f64,
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::duty::{Move, Profile};
    use super::*;

    /// A level machine of 80 mm with a servo valve, a regulated pump and a P controller: 4 s, there and back.
    pub(in super::super) fn example() -> Machine {
        let step = |to_m| Move {
            to_m,
            duration_s: 1.0,
            profile: Profile::Cosine,
            rapid: None,
            force_n: 0.0,
            dwell_s: 1.0,
        };
        Machine {
            cylinder: Cylinder {
                bore_m: 0.08,
                rod_m: 0.045,
                stroke_m: 0.4,
                mass_kg: 300.0,
                weight_n: 0.0,
                dead_volume_m3: 1e-4,
                hose_length_m: 0.0,
                hose_bore_m: 0.02,
                viscous_n_s_per_m: 5000.0,
                coulomb_n: 0.0,
                breakaway_n: 0.0,
                contact: None,
            },
            valve: Valve {
                coefficient: 1e-3 / 3.5e6_f64.sqrt(),
                overlap: 0.0,
                rounding: 0.005,
                null_offset: 0.0,
                curve: FlowCurve::Linear,
                natural_rad_per_s: 500.0,
                damping: 0.8,
            },
            supply: Supply {
                pump: Pump::Regulated,
                flow_m3_per_s: 2e-3,
                pressure_pa: 16e6,
                band_pa: 5e5,
                volume_m3: 2e-3,
                accumulator: None,
                return_pa: 2e5,
            },
            oil: Oil { grade_mm2_per_s: 46.0, temperature_c: 50.0, bulk_modulus_pa: 1.2e9, air: 1e-3 },
            controller: Controller {
                kp_per_m: 40.0,
                ki_per_m_s: 0.0,
                kd_s_per_m: 0.0,
                feed_forward_s_per_m: 0.0,
                jump: 0.0,
                period_s: 1e-3,
            },
            duty: Duty {
                start_m: 0.1,
                moves: vec![step(0.25), step(0.1)],
                dwell_spread: 0.0,
                pause_probability: 0.0,
                force_spread: 0.0,
            },
        }
    }

    #[test]
    fn reference_viscosity_of_an_oil_of_grade_46() {
        let oil = Oil { grade_mm2_per_s: 46.0, temperature_c: 50.0, bulk_modulus_pa: 1.2e9, air: 0.0 };
        assert!((oil.viscosity_mm2_per_s(40.0) - 46.0).abs() < 1e-9);
        // Usual data sheets of HLP 46: 6.8 mm²/s at 100 °C.
        assert!((oil.viscosity_mm2_per_s(100.0) - 6.8).abs() < 0.1);
    }

    #[test]
    fn every_curve_gives_the_rated_flow_at_full_opening_and_nothing_at_none() {
        for curve in [
            FlowCurve::Linear,
            FlowCurve::Progressive { line: 0.6 },
            FlowCurve::DoubleGain { knee: 0.4, flow: 0.15 },
        ] {
            assert_eq!(curve.flow(0.0), 0.0);
            assert!((curve.flow(1.0) - 1.0).abs() < 1e-12, "{curve:?}");
            assert!(curve.flow(0.2) < 0.2 + 1e-12 && curve.flow(0.2) > 0.05, "{curve:?}");
        }
    }
}

//! `machine.toml`: what can be read off data sheets and drawings, in their units.

use seepd_settings::{FormatError, parse_toml};
use serde::{Deserialize, Serialize};

/// The content of `machine.toml`. Everything may be left out: what is absent is unknown.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MachineData {
    /// Name of the machine axis in messages.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Cylinder and what it moves.
    pub cylinder: CylinderData,
    /// Control valve.
    pub valve: ValveData,
    /// Pump, relief valve and return line.
    pub supply: SupplyData,
    /// Oil.
    pub oil: OilData,
    /// Position controller.
    pub controller: ControllerData,
}

impl MachineData {
    /// Half the width of the valve's dead band, share of full command, as far as it is known: who has the controller step over a dead band
    /// has one, of about that width.
    pub fn overlap(&self) -> Option<f64> {
        let percent = self.valve.overlap_percent.or(self.controller.dead_band_compensation_percent)?;
        Some(percent.value() / 100.0)
    }
}

/// A number off a data sheet: bare, or with how far it may be off.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Datum {
    /// The number, with its kind's usual tolerance.
    Bare(f64),
    /// The number with a tolerance of its own.
    Tolerated(ToleratedDatum),
}

/// A number and how far it may be off.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ToleratedDatum {
    /// The number, in the key's unit.
    pub value: f64,
    /// How far the truth may be off to either side, % of the number.
    pub tolerance_percent: f64,
}

impl Datum {
    /// The number, in the key's unit.
    pub const fn value(self) -> f64 {
        match self {
            Datum::Bare(value) | Datum::Tolerated(ToleratedDatum { value, .. }) => value,
        }
    }

    /// How far the truth may be off to either side, share of the number, where the file says so.
    pub fn tolerance(self) -> Option<f64> {
        match self {
            Datum::Bare(_) => None,
            Datum::Tolerated(datum) => Some(datum.tolerance_percent / 100.0),
        }
    }
}

/// `[cylinder]`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CylinderData {
    /// Bore, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bore_mm: Option<Datum>,
    /// Diameter of the rod, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rod_mm: Option<Datum>,
    /// Diameter of a second rod on the cap side, mm, of a cylinder whose rod goes through; absent: there is none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub second_rod_mm: Option<Datum>,
    /// Stroke, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stroke_mm: Option<Datum>,
    /// Moved mass with tool and rod, kg.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub moved_mass_kg: Option<Datum>,
    /// How the rod points.
    pub orientation: Orientation,
    /// Length of each hose or pipe between valve and cylinder, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hose_length_m: Option<Datum>,
    /// Inner diameter of these, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hose_bore_mm: Option<Datum>,
}

/// How the rod points, which decides what the moved mass's weight does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Orientation {
    /// Level: the weight does nothing.
    #[default]
    Horizontal,
    /// Extending lifts the mass.
    RodUp,
    /// Extending lowers the mass.
    RodDown,
}

/// `[valve]`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ValveData {
    /// Rated flow at full command, L/min.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rated_flow_lpm: Option<Datum>,
    /// Pressure drop at which that flow is rated, bar: 70 for servo valves, 10 for proportional valves where nothing is said.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rated_at_bar: Option<f64>,
    /// Whether that drop is over one land or over the loop of two.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rated_over: Option<RatedOver>,
    /// Overlap: half the width of the dead band, % of full command.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub overlap_percent: Option<Datum>,
    /// What the edges of the rod side (port B) pass of what those of the cap side pass, %: 50 of a spool that is made for a 2:1 cylinder;
    /// absent: as much.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rod_side_flow_percent: Option<f64>,
    /// How the flow grows with the command.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub curve: Option<FlowCurve>,
    /// Command at the knee of a curve of double gain, % of full command.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub knee_percent: Option<f64>,
    /// Flow at that knee, or at half of full command of a progressive curve, % of the rated flow.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub flow_at_knee_percent: Option<f64>,
}

/// Flow over command, as data sheets of servo and proportional valves draw it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FlowCurve {
    /// A line.
    Linear,
    /// Fine in the middle, and steeper the further the spool goes.
    Progressive,
    /// Two lines: fine up to a knee.
    DoubleGain,
}

/// Where a valve's rated pressure drop is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RatedOver {
    /// Over one metering edge.
    Land,
    /// From supply over the load ports to return: two edges.
    Loop,
}

/// `[supply]`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SupplyData {
    /// Flow of the pump, L/min.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pump_flow_lpm: Option<Datum>,
    /// Opening pressure of the relief valve, or pressure of a regulated pump, bar.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub relief_bar: Option<Datum>,
    /// Pressure in the return line, bar.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub return_bar: Option<Datum>,
    /// Volume of an accumulator at the supply, L.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub accumulator_l: Option<Datum>,
}

/// `[oil]`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OilData {
    /// Viscosity grade: the number after VG or HLP.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub iso_vg: Option<f64>,
    /// Working temperature, °C.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub temperature_c: Option<f64>,
    /// Density, kg/m³.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub density_kg_per_m3: Option<Datum>,
}

/// `[controller]`. Gains are per metre of position error; commands are shares of full command.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ControllerData {
    /// What kind it is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub kind: Option<ControllerKind>,
    /// Proportional gain, 1/m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub kp_per_m: Option<Datum>,
    /// Integral gain, 1/(m s).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ki_per_m_s: Option<Datum>,
    /// Derivative gain on the measured position, s/m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub kd_s_per_m: Option<Datum>,
    /// Velocity feed-forward: command per speed of the demand, s/m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub velocity_feed_forward_s_per_m: Option<Datum>,
    /// Jump of the command around its null that steps over the valve's overlap, % of full command.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dead_band_compensation_percent: Option<Datum>,
    /// Position error below which the integrator works, mm; absent: as the log shows.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub integral_window_mm: Option<Datum>,
    /// Period of the controller's task, ms.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub task_period_ms: Option<Datum>,
}

/// What a position controller feeds back.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ControllerKind {
    /// The error.
    P,
    /// The error and its integral.
    Pi,
    /// The error, its integral and the speed.
    Pid,
}

impl MachineData {
    /// Reads the text of a `machine.toml`; an unknown key is refused with the nearest known one.
    ///
    /// # Errors
    /// [`FormatError`] with line and key.
    pub fn from_toml(text: &str) -> Result<Self, FormatError> {
        parse_toml(text)
    }
}

//! What the machine's user can read off its papers: `machine.toml`, in catalogue units, with keys missing.
//!
//! The keys are stated here once more, since what is checked must not write its own questions.

use seepd_sim::noise::Noise;
use serde::Serialize;

use super::draw::{Built, Choice};
use super::machine::Oil;

/// L/min in a m³/s.
const LPM: f64 = 6e4;
/// Share of the keys that users do not know.
const MISSING: f64 = 0.2;
/// Share of the machines on whose papers a measure of the cylinder is missing.
const MEASURE_MISSING: f64 = 0.15;

/// The content of `machine.toml`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DataSheet {
    /// Name of the axis.
    pub name: String,
    /// `[cylinder]`.
    pub cylinder: CylinderSheet,
    /// `[valve]`.
    pub valve: ValveSheet,
    /// `[supply]`.
    pub supply: SupplySheet,
    /// `[oil]`.
    pub oil: OilSheet,
    /// `[controller]`.
    pub controller: ControllerSheet,
}

/// `[cylinder]`, in mm, kg and m.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[expect(missing_docs, reason = "the keys of machine.toml say what they are")]
pub struct CylinderSheet {
    pub bore_mm: Option<f64>,
    pub rod_mm: Option<f64>,
    pub stroke_mm: Option<f64>,
    pub moved_mass_kg: Option<f64>,
    pub orientation: &'static str,
    pub hose_length_m: Option<f64>,
    pub hose_bore_mm: Option<f64>,
}

/// `[valve]`.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[expect(missing_docs, reason = "the keys of machine.toml say what they are")]
pub struct ValveSheet {
    pub rated_flow_lpm: Option<f64>,
    pub rated_at_bar: Option<f64>,
    pub rated_over: Option<&'static str>,
    pub overlap_percent: Option<f64>,
}

/// `[supply]`.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[expect(missing_docs, reason = "the keys of machine.toml say what they are")]
pub struct SupplySheet {
    pub pump_flow_lpm: Option<f64>,
    pub relief_bar: Option<f64>,
    pub return_bar: Option<f64>,
    pub accumulator_l: Option<f64>,
}

/// `[oil]`.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[expect(missing_docs, reason = "the keys of machine.toml say what they are")]
pub struct OilSheet {
    pub iso_vg: Option<f64>,
    pub temperature_c: Option<f64>,
}

/// `[controller]`.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[expect(missing_docs, reason = "the keys of machine.toml say what they are")]
pub struct ControllerSheet {
    pub kind: Option<&'static str>,
    pub kp_per_m: Option<f64>,
    pub ki_per_m_s: Option<f64>,
    pub kd_s_per_m: Option<f64>,
    pub velocity_feed_forward_s_per_m: Option<f64>,
    pub dead_band_compensation_percent: Option<f64>,
    pub task_period_ms: Option<f64>,
}

impl DataSheet {
    /// The papers of a machine as its parts' catalogues have it.
    pub(super) fn of(name: &str, built: &Built, noise: &mut Noise) -> Self {
        let machine = &built.machine;
        let cylinder = &machine.cylinder;
        // Some catalogues halve the drop and say that it is over one edge.
        let over_land = noise.chance(0.2);
        let measure = noise.chance(MEASURE_MISSING).then(|| noise.index(3));
        let mut known = |value: f64| (!noise.chance(MISSING)).then_some(value);
        let orientation = if cylinder.weight_n > 0.0 {
            "rod_down"
        } else if cylinder.weight_n < 0.0 {
            "rod_up"
        } else {
            "horizontal"
        };
        let measured =
            |index: usize, value_m: f64| (measure != Some(index)).then(|| (value_m * 1e4).round() / 10.0);
        DataSheet {
            name: name.into(),
            cylinder: CylinderSheet {
                bore_mm: measured(0, cylinder.bore_m),
                rod_mm: measured(1, cylinder.rod_m),
                stroke_mm: measured(2, cylinder.stroke_m),
                moved_mass_kg: known(rounded(cylinder.mass_kg)),
                orientation,
                hose_length_m: known(cylinder.hose_length_m),
                hose_bore_mm: known(tenths(cylinder.hose_bore_m * 1e3)),
            },
            valve: ValveSheet {
                rated_flow_lpm: known(rounded(built.rated_m3_per_s * LPM)),
                rated_at_bar: Some(if over_land { 0.5 } else { 1.0 } * built.rated_at_pa / 1e5),
                rated_over: Some(if over_land { "land" } else { "loop" }),
                overlap_percent: known(tenths(machine.valve.overlap * 100.0)),
            },
            supply: SupplySheet {
                pump_flow_lpm: known(rounded(machine.supply.flow_m3_per_s * LPM)),
                relief_bar: known((machine.supply.pressure_pa / 1e5).round()),
                return_bar: known((machine.supply.return_pa / 1e5).round()),
                accumulator_l: machine
                    .supply
                    .accumulator
                    .and_then(|accumulator| known(tenths(accumulator.volume_m3 * 1e3))),
            },
            oil: oil(&machine.oil, &mut known),
            controller: controller(&machine.controller, noise),
        }
    }
}

fn oil(oil: &Oil, known: &mut impl FnMut(f64) -> Option<f64>) -> OilSheet {
    OilSheet {
        iso_vg: known(oil.grade_mm2_per_s),
        // The display at the tank is not the oil in the cylinder.
        temperature_c: known((oil.temperature_c / 5.0).round() * 5.0),
    }
}

/// Who can read the controller's parameters reads all of them.
fn controller(controller: &super::controller::Controller, noise: &mut Noise) -> ControllerSheet {
    let kind = if controller.kd_s_per_m > 0.0 {
        "pid"
    } else if controller.ki_per_m_s > 0.0 {
        "pi"
    } else {
        "p"
    };
    let gains = noise.chance(0.5);
    let gain = |value: f64| (gains && value > 0.0).then_some(value);
    let percent = tenths(controller.jump * 100.0);
    ControllerSheet {
        kind: (gains || noise.chance(0.8)).then_some(kind),
        kp_per_m: gain(controller.kp_per_m),
        ki_per_m_s: gain(controller.ki_per_m_s),
        kd_s_per_m: gain(controller.kd_s_per_m),
        velocity_feed_forward_s_per_m: gain(controller.feed_forward_s_per_m),
        dead_band_compensation_percent: (percent > 0.0 && noise.chance(0.8)).then_some(percent),
        task_period_ms: noise.chance(0.8).then(|| (controller.period_s * 1e6).round() / 1e3),
    }
}

/// As catalogues have it: two digits for what is large.
fn rounded(value: f64) -> f64 {
    if value < 10.0 { tenths(value) } else { super::draw::significant(value) }
}

fn tenths(value: f64) -> f64 {
    (value * 10.0).round() / 10.0
}

#[cfg(test)]
mod tests {
    use seepd_adopt::machine_data::{MachineData, Orientation};

    use super::super::{Later, LoggedSignals, draw};

    #[test]
    fn papers_are_read_as_a_machine_toml() {
        let mut known = 0;
        for number in 1..=4 {
            let sheet = draw(5, number, LoggedSignals::Command, Later::default()).unwrap().sheet;
            let read = MachineData::from_toml(&toml::to_string(&sheet).unwrap()).unwrap();
            assert_eq!(read.cylinder.bore_mm.map(|datum| datum.value()), sheet.cylinder.bore_mm);
            assert_eq!(read.valve.rated_flow_lpm.map(|datum| datum.value()), sheet.valve.rated_flow_lpm);
            assert_eq!(read.supply.pump_flow_lpm.map(|datum| datum.value()), sheet.supply.pump_flow_lpm);
            assert_eq!(
                read.controller.task_period_ms.map(|datum| datum.value()),
                sheet.controller.task_period_ms
            );
            assert_eq!(read.oil.iso_vg, sheet.oil.iso_vg);
            assert_eq!(
                read.cylinder.orientation == Orientation::Horizontal,
                sheet.cylinder.orientation == "horizontal"
            );
            known +=
                usize::from(read.valve.rated_flow_lpm.is_some()) + usize::from(read.oil.iso_vg.is_some());
        }
        assert!(known > 3, "of eight values {known} are known");
    }
}

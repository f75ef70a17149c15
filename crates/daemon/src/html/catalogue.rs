//! Plant parameters as data sheets have them: bar, L/min, mm.

use seepd_monitor::event::LPM_PER_M3_PER_S as LPM;
use seepd_sim::effects;
use seepd_sim::plant::ParameterInfo;

use crate::quantity::{BAR_PER_PA, MM2_PER_M2};

/// Pressure difference at which leakages and loops of valves are stated, Pa, and half of it, over one of a loop's two lands.
const STATED_PA: f64 = 7e6;
const OVER_A_LAND_PA: f64 = 3.5e6;
/// Pressure difference over a line at which its flow is stated, Pa.
const OVER_A_LINE_PA: f64 = 1e5;

/// What a value in a catalogue's unit is: the plant's own words without their unit, but for coefficients and resistances that are given as
/// flows.
pub(super) fn words(info: &ParameterInfo) -> &'static str {
    match info.key {
        "valve_m3_per_s_sqrt_pa" => "Valve's flow at full command",
        "line_m3_per_s_sqrt_pa" => "Line's flow",
        "seal_resistance_pa_s_per_m3" => "Leakage of a healthy piston seal",
        "valve_return_resistance_pa_s_per_m3" => "Leakage of the valve, inlet → return",
        "valve_rod_resistance_pa_s_per_m3" => "Leakage of the valve, inlet → rod port",
        _ => info.description.rsplit_once(", ").map_or(info.description, |(words, _)| words.trim()),
    }
}

/// A value in a catalogue's unit.
pub(super) fn value(info: &ParameterInfo, si: f64) -> (f64, &'static str) {
    match (info.key, info.unit) {
        ("valve_m3_per_s_sqrt_pa", _) => (LPM * si * OVER_A_LAND_PA.sqrt(), "L/min at 70 bar over the loop"),
        ("line_m3_per_s_sqrt_pa", _) => (LPM * si * OVER_A_LINE_PA.sqrt(), "L/min at 1 bar"),
        ("relief_resistance_pa_s_per_m3", _) => (BAR_PER_PA / LPM * si, "bar per L/min"),
        ("leak_area_m2", _) => (MM2_PER_M2 * si, "mm²"),
        (_, "Pa s/m3") => (LPM * STATED_PA / si, "L/min at 70 bar"),
        (_, "Pa") => (BAR_PER_PA * si, "bar"),
        (_, "m3/s") => (LPM * si, "L/min"),
        (_, "m3") => (1e3 * si, "L"),
        (_, "m2") => (1e4 * si, "cm²"),
        (_, "m") => (1e3 * si, "mm"),
        (_, "N s/m") => (1e-3 * si, "kN s/m"),
        (_, "kg/m3") => (si, "kg/m³"),
        (_, "1") => (si, ""),
        (_, unit) => (si, unit),
    }
}

/// The unit of an effect's parameter; none for shares.
pub(super) fn unit_of_effect(effect: &str, name: &str) -> &'static str {
    let parameters = effects::find(effect).map_or(&[][..], |effect| effect.parameters());
    let unit = parameters.iter().find(|parameter| parameter.name == name).map_or("", |known| known.unit);
    if unit == "1" { "" } else { unit }
}

#[cfg(test)]
mod tests {
    use seepd_sim::PlantParameters;

    use super::*;

    /// The nominal press: a valve of 96 L/min, a pump of 90, a relief valve at 160 bar, a seal that passes 0.042 L/min.
    #[test]
    fn the_nominal_press_reads_as_on_its_data_sheets() {
        let press = PlantParameters::default();
        let read = |key: &str| {
            let info = PlantParameters::ALL.iter().find(|info| info.key == key).unwrap();
            let (value, unit) = value(info, press.get(key).unwrap());
            ((1e3 * value).round() / 1e3, unit, words(info))
        };
        assert_eq!(
            read("valve_m3_per_s_sqrt_pa"),
            (96.0, "L/min at 70 bar over the loop", "Valve's flow at full command")
        );
        assert_eq!(read("pump_flow_m3_per_s"), (90.0, "L/min", "Pump flow"));
        assert_eq!(read("relief_pressure_pa"), (160.0, "bar", "Relief valve's opening pressure"));
        assert_eq!(
            read("seal_resistance_pa_s_per_m3"),
            (0.042, "L/min at 70 bar", "Leakage of a healthy piston seal")
        );
        assert_eq!(read("relief_resistance_pa_s_per_m3"), (0.083, "bar per L/min", "Relief valve's slope"));
        assert_eq!(read("stroke_m"), (500.0, "mm", "Stroke"));
        assert_eq!(read("cap_dead_volume_m3"), (0.2, "L", "Cap chamber's volume at position 0"));
    }

    /// Every parameter has a unit of a catalogue: none is left in SI roots.
    #[test]
    fn no_parameter_is_left_without_a_catalogue_unit() {
        for info in PlantParameters::ALL {
            let (_, unit) = value(info, 1.0);
            assert!(!unit.contains("sqrt") && !unit.contains("m3") && unit != "Pa", "{}: {unit}", info.key);
        }
    }
}

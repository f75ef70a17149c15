//! A machine's size over the nominal press's: what is plausible of an effect goes with it.
//!
//! By octaves: machines of one series are of one size, and the nominal press and its likes have the ranges of the catalogue to the bit.

use crate::effects::{Effect, Parameter, ValveDeadband};
use crate::plant::PlantParameters;
use crate::series::deadband;
use crate::spec::MachineSpec;

/// Ratios to the nominal press, powers of two.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Size {
    /// Largest force of the piston.
    pub force: f64,
    /// Stroke.
    pub length: f64,
    /// Largest volume of a chamber.
    pub volume: f64,
    /// Relief pressure.
    pub pressure: f64,
    /// Flow of the valve at a given pressure drop.
    pub valve: f64,
    /// Whether its valve's lands overlap by more than is usual.
    pub overlaps_widely: bool,
}

/// The widest dead band of a valve whose lands overlap by more than is usual, half width as a share of full command: proportional valves for
/// presses are sold with 20 %.
const WIDEST_DEADBAND: f64 = 0.25;

impl Size {
    /// The size of a machine.
    pub fn of(spec: &MachineSpec) -> Self {
        let nominal = PlantParameters::default();
        let over_nominal = |size: fn(&PlantParameters) -> f64| octaves(size(&spec.plant) / size(&nominal));
        Size {
            force: over_nominal(|p| p.cap_area_m2 * p.relief_pressure_pa),
            length: over_nominal(|p| p.stroke_m),
            volume: over_nominal(|p| p.cap_area_m2 * p.stroke_m),
            pressure: over_nominal(|p| p.relief_pressure_pa),
            valve: over_nominal(|p| p.valve_m3_per_s_sqrt_pa),
            overlaps_widely: deadband(spec) > ValveDeadband.parameters()[0].range.1,
        }
    }

    /// The plausible range of an effect's parameter on a machine of that size, by the parameter's unit.
    pub fn range_of(&self, parameter: &Parameter) -> (f64, f64) {
        let scale = self.scale_of(parameter).unwrap_or(1.0);
        let high = if self.overlaps_widely && parameter.name == ValveDeadband.parameters()[0].name {
            WIDEST_DEADBAND
        } else {
            parameter.range.1
        };
        (scale * parameter.range.0, scale * high)
    }

    /// The range within which a plant file may have it: what goes with the size may have been found on the same machine before calibration
    /// moved its pressure and its valve.
    pub(crate) fn admitted_in_a_file(&self, parameter: &Parameter) -> (f64, f64) {
        let (low, high) = self.range_of(parameter);
        let moved_by = self.scale_of(parameter).map_or(1.0, |_| CALIBRATION_MOVES_BY);
        let low = if low < 0.0 { low * moved_by } else { low / moved_by };
        (low, high * moved_by)
    }

    /// By how much more than on the nominal press a parameter may be, if its unit is one of what goes with the size.
    fn scale_of(&self, parameter: &Parameter) -> Option<f64> {
        let flow = self.valve * self.pressure.sqrt();
        Some(match parameter.unit {
            "N" => self.force,
            "N/m" => self.force / self.length,
            "1/m" => 1.0 / self.length,
            "m3" => self.volume,
            "m3/s" => flow,
            "m3/(s Pa)" => flow / self.pressure,
            "Pa s2/m6" => self.pressure / (flow * flow),
            "Pa" => self.pressure,
            _ => return None,
        })
    }
}

/// Calibration may halve or double pressures and the valve's coefficient: forces and pressures move by one octave, flows by one and a half,
/// and resistances by two.
const CALIBRATION_MOVES_BY: f64 = 4.0;

/// The nearest power of two; 1 for what is no size.
fn octaves(ratio: f64) -> f64 {
    if ratio.is_normal() && ratio > 0.0 { libm::exp2(libm::round(libm::log2(ratio))) } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects;

    #[test]
    fn the_nominal_press_and_its_likes_have_the_catalogues_ranges() {
        let mut spec = MachineSpec::default();
        for factor in [1.0, 0.9, 1.2] {
            spec.plant.valve_m3_per_s_sqrt_pa *= factor;
            spec.plant.relief_pressure_pa *= factor;
            for effect in effects::ALL {
                for parameter in effect.parameters() {
                    assert_eq!(Size::of(&spec).range_of(parameter), parameter.range);
                }
            }
        }
    }

    /// A cylinder of 1 MN may have a friction of 80 kN, and its plant file says so without a complaint.
    #[test]
    fn a_large_cylinder_has_a_large_friction() {
        let mut spec = MachineSpec::default();
        spec.plant.cap_area_m2 *= 16.0;
        let friction = effects::find("coulomb_friction").unwrap();
        assert_eq!(Size::of(&spec).range_of(&friction.parameters()[0]), (0.0, 8e4));
        let ranges = |spec: &MachineSpec| spec.clone().set_effect("coulomb_friction.force_n=40000");
        assert!(ranges(&spec).is_ok() && ranges(&MachineSpec::default()).is_err());
    }

    /// A valve that overlaps by more than is usual has a wider range; other machines keep the catalogue's.
    #[test]
    fn a_valve_may_overlap_by_a_quarter() {
        let with = |half_width: f64| {
            let mut spec = MachineSpec::default();
            spec.set_effect(&format!("valve_deadband.half_width={half_width}")).map(|()| spec)
        };
        let half_width = &ValveDeadband.parameters()[0];
        assert_eq!(Size::of(&with(0.15).unwrap()).range_of(half_width), (0.0, 0.15));
        assert_eq!(Size::of(&with(0.2).unwrap()).range_of(half_width), (0.0, 0.25));
        assert!(with(0.26).is_err());
    }

    /// A calibration that halves the relief pressure makes of the machine one of a smaller size, and its plant file is read all the same.
    #[test]
    fn what_was_found_before_calibration_is_admitted_in_a_file() {
        let mut spec = MachineSpec::default();
        spec.set_effect("shared_supply.flow_m3_per_s=4.9e-4").unwrap();
        spec.set_effect("coulomb_friction.force_n=4900").unwrap();
        spec.set_effect("valve_bias.offset=0.04").unwrap();
        spec.plant.relief_pressure_pa *= 0.5;
        spec.plant.valve_m3_per_s_sqrt_pa *= 0.5;
        spec.check().unwrap();
        // What the command line asks for is asked for this machine.
        assert!(spec.set_effect("coulomb_friction.force_n=4900").is_err());
        spec.effects.get_mut("valve_bias").unwrap().insert("offset".into(), 0.9);
        assert!(spec.check().is_err());
    }

    #[test]
    fn what_is_no_size_is_the_nominal_one() {
        for ratio in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert_eq!(octaves(ratio), 1.0);
        }
        assert_eq!((octaves(1.4), octaves(1.5), octaves(0.3)), (1.0, 2.0, 0.25));
    }
}

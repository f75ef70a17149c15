//! The units that variables have, as the exponents of base units that a model description states.

/// Units by their names, with the exponents of kg, m and s.
const UNITS: &[(&str, [i32; 3])] = &[
    ("1", [0, 0, 0]),
    ("s", [0, 0, 1]),
    ("Hz", [0, 0, -1]),
    ("1/s", [0, 0, -1]),
    ("m", [0, 1, 0]),
    ("1/m", [0, -1, 0]),
    ("1/(m s)", [0, -1, -1]),
    ("s/m", [0, -1, 1]),
    ("m/s", [0, 1, -1]),
    ("m2", [0, 2, 0]),
    ("m3", [0, 3, 0]),
    ("m3/s", [0, 3, -1]),
    ("kg", [1, 0, 0]),
    ("kg/m3", [1, -3, 0]),
    ("N", [1, 1, -2]),
    ("N/m", [1, 0, -2]),
    ("N s/m", [1, 0, -1]),
    ("Pa", [1, -1, -2]),
    ("Pa s/m3", [1, -4, -1]),
    ("Pa s2/m6", [1, -7, 0]),
    ("m3/(s Pa)", [-1, 4, 1]),
];

/// Exponents of kg, m and s of a unit; `None` for one whose exponents are no whole numbers, such as m³/s/√Pa.
pub fn exponents(unit: &str) -> Option<[i32; 3]> {
    UNITS.iter().find(|(name, _)| *name == unit).map(|(_, exponents)| *exponents)
}

#[cfg(test)]
mod tests {
    use super::*;
    use seepd_sim::PlantParameters;
    use seepd_sim::effects;

    /// A unit that is new in the plant or the catalogue has its exponents, or roots in it.
    #[test]
    fn every_unit_of_plant_and_catalogue_is_known() {
        let plant = PlantParameters::ALL.iter().map(|info| info.unit);
        let effects = effects::ALL.iter().flat_map(|effect| effect.parameters()).map(|p| p.unit);
        let axis = seepd_sim::electric::CATALOGUE.iter().flat_map(|info| info.parameters).map(|p| p.unit);
        for unit in plant.chain(effects).chain(axis) {
            assert!(exponents(unit).is_some() || unit.contains("sqrt"), "{unit}");
        }
        // Pa = N/m²; a hydraulic resistance times a flow is a pressure.
        assert_eq!(exponents("Pa s/m3").map(|[kg, m, s]| [kg, m + 3, s - 1]), exponents("Pa"));
    }
}

//! Viscosity of the oil over temperature: ISO VG 46 after ASTM D341.
//!
//! `lg lg (ν + 0.7) = A − B lg T`, ν in mm²/s, T in K, through 46 mm²/s at 40 °C (what VG 46 means, ISO 3448) and 6.8 mm²/s at
//! 100 °C (a viscosity index of about 100, the usual one of an HLP oil).

/// Viscosity at two temperatures that the line goes through: °C, mm²/s.
const THROUGH: [(f64, f64); 2] = [(40.0, 46.0), (100.0, 6.8)];
/// The temperature that the nominal plant stands for, °C.
pub const NOMINAL_TEMPERATURE_C: f64 = 45.0;

/// Kinematic viscosity of ISO VG 46, mm²/s; meant for 0 … 120 °C.
pub fn viscosity_mm2_per_s(temperature_c: f64) -> f64 {
    let lg_t = |celsius: f64| libm::log10(celsius + 273.15);
    let lg_lg = |viscosity: f64| libm::log10(libm::log10(viscosity + 0.7));
    let [(cold_c, thick), (warm_c, thin)] = THROUGH;
    let slope = (lg_lg(thick) - lg_lg(thin)) / (lg_t(warm_c) - lg_t(cold_c));
    let at = lg_lg(thick) - slope * (lg_t(temperature_c) - lg_t(cold_c));
    libm::pow(10.0, libm::pow(10.0, at)) - 0.7
}

/// Viscosity over that at 45 °C: the value of `oil_viscosity.factor`.
pub fn viscosity_factor(temperature_c: f64) -> f64 {
    viscosity_mm2_per_s(temperature_c) / viscosity_mm2_per_s(NOMINAL_TEMPERATURE_C)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn line_meets_its_points_and_what_tables_of_vg_46_oils_say_between() {
        assert!((viscosity_mm2_per_s(40.0) - 46.0).abs() < 1e-9);
        assert!((viscosity_mm2_per_s(100.0) - 6.8).abs() < 1e-9);
        // Between and beyond, data sheets of VG 46 oils with that index agree within some per cent: 20 °C about 130, 60 °C about 21.
        assert!((120.0..140.0).contains(&viscosity_mm2_per_s(20.0)));
        assert!((20.0..22.5).contains(&viscosity_mm2_per_s(60.0)));
        assert!((viscosity_factor(45.0) - 1.0).abs() < 1e-12);
        assert!(viscosity_factor(30.0) > 1.9 && viscosity_factor(60.0) < 0.6);
    }
}

//! Quantities as people read them: areas in mm², pressures in bar, shares in per cent. What programs read (JSON, CSV, MCAP, metrics) keeps SI units.

/// Square millimetres of a square metre.
pub(crate) const MM2_PER_M2: f64 = 1e6;
/// Bars of a pascal.
pub(crate) const BAR_PER_PA: f64 = 1e-5;
/// Decimals of the smallest areas: 1e-5 mm² is a ten-thousandth of the smallest leak that is found.
const MOST_DECIMALS: f64 = 5.0;

/// An area in mm², without its unit, in three digits: `0.203`, `10.0`, `0.00059`.
pub(crate) fn mm2(area_m2: f64) -> String {
    let area = area_m2 * MM2_PER_M2;
    if area == 0.0 {
        return "0".into();
    }
    let decimals = (2.0 - area.abs().log10().floor()).clamp(0.0, MOST_DECIMALS) as usize;
    let text = format!("{area:.decimals$}");
    // What is below the last decimal is none, without a sign.
    if text.contains(|c: char| c.is_ascii_digit() && c != '0') { text } else { "0".into() }
}

/// Ends of an interval of areas in mm², without their unit.
pub(crate) fn mm2_interval([low_m2, high_m2]: [f64; 2]) -> String {
    format!("{} … {}", mm2(low_m2), mm2(high_m2))
}

/// A pressure in bar, without its unit and without a tail of rounding: `70`, `72.5`.
pub(crate) fn bar(pressure_pa: f64) -> f64 {
    (pressure_pa * BAR_PER_PA * 1e6).round() / 1e6
}

/// A share in per cent with its unit, `12.3 %`; a dash where there is none.
pub(crate) fn percent(share: f64, digits: usize) -> String {
    if share.is_finite() { format!("{:.digits$} %", 100.0 * share) } else { "–".into() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn areas_have_three_digits_and_no_more_than_five_decimals() {
        let shown = [0.0, 2.03e-7, 1e-5, 1.234e-4, 9.4e-9, 5.9e-10, -3.21e-8, 4e-12, -4e-12].map(mm2);
        assert_eq!(shown, ["0", "0.203", "10.0", "123", "0.00940", "0.00059", "-0.0321", "0", "0"]);
        assert_eq!(mm2_interval([1.9e-7, 2.17e-7]), "0.190 … 0.217");
    }

    #[test]
    fn pressures_are_bars_without_a_tail() {
        assert_eq!([7e6, 7.25e6, 1e5, 1e8].map(bar), [70.0, 72.5, 1.0, 1000.0]);
    }

    #[test]
    fn a_share_that_is_no_number_is_a_dash() {
        assert_eq!(
            [(0.1234, 1), (0.00567, 2), (f64::NAN, 1)].map(|(share, digits)| percent(share, digits)),
            ["12.3 %", "0.57 %", "–"]
        );
    }
}

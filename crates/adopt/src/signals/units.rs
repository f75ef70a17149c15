//! Units as logs write them.

/// What a unit measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Quantity {
    /// A share, such as per cent.
    Share,
    /// A length.
    Length,
    /// A pressure.
    Pressure,
    /// A force.
    Force,
    /// A voltage.
    Voltage,
    /// An electric current.
    Current,
    /// Steps of a converter or an encoder.
    Count,
    /// Anything else: a temperature, a speed, an angle, a flow, a time.
    Other,
}

/// A unit, and how many of SI (of V and mA for voltages and currents) it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Unit {
    pub(super) quantity: Quantity,
    pub(super) factor: f64,
}

const fn unit(quantity: Quantity, factor: f64) -> Unit {
    Unit { quantity, factor }
}

/// Newtons of a kilogram's and of a pound's weight.
const KGF_N: f64 = 9.806_65;
const LBF_N: f64 = 4.448_221_615_260_5;
const PSI_PA: f64 = 6_894.757_293_168;

impl Unit {
    /// The unit of that text; `None` for what is no unit that is known.
    pub(super) fn parse(text: &str) -> Option<Unit> {
        use Quantity::{Count, Current, Force, Length, Other, Pressure, Share, Voltage};
        // Mega and milli differ by their case alone.
        match text.trim() {
            "MPa" => return Some(unit(Pressure, 1e6)),
            "MN" => return Some(unit(Force, 1e6)),
            "A" => return Some(unit(Current, 1e3)),
            _ => {}
        }
        Some(match text.trim().to_lowercase().trim_matches('.') {
            "%" | "pct" | "percent" | "prozent" | "per cent" => unit(Share, 0.01),
            "1" | "-" | "share" | "pu" | "p.u" => unit(Share, 1.0),
            "‰" | "permille" | "promille" => unit(Share, 1e-3),
            "m" | "meter" | "metre" => unit(Length, 1.0),
            "cm" => unit(Length, 1e-2),
            "mm" => unit(Length, 1e-3),
            "um" | "µm" | "μm" => unit(Length, 1e-6),
            "in" | "inch" | "inches" | "\"" | "zoll" => unit(Length, 0.0254),
            "pa" => unit(Pressure, 1.0),
            "hpa" | "mbar" => unit(Pressure, 1e2),
            "kpa" => unit(Pressure, 1e3),
            "mpa" | "n/mm²" | "n/mm2" => unit(Pressure, 1e6),
            "bar" | "barg" | "bar(g)" => unit(Pressure, 1e5),
            "psi" | "psig" => unit(Pressure, PSI_PA),
            "kgf/cm2" | "kgf/cm²" | "kg/cm2" | "kg/cm²" | "at" => unit(Pressure, KGF_N * 1e4),
            "n" | "newton" => unit(Force, 1.0),
            "kn" => unit(Force, 1e3),
            "dan" => unit(Force, 10.0),
            "kgf" | "kg" | "kp" => unit(Force, KGF_N),
            "t" | "to" | "tf" | "ton" | "tons" | "tonf" => unit(Force, KGF_N * 1e3),
            "lbf" | "lb" | "lbs" => unit(Force, LBF_N),
            "klbf" | "kip" => unit(Force, LBF_N * 1e3),
            "v" | "volt" | "volts" | "vdc" => unit(Voltage, 1.0),
            "mv" => unit(Voltage, 1e-3),
            "ma" => unit(Current, 1.0),
            "counts" | "count" | "inc" | "incs" | "digit" | "digits" | "lsb" | "raw" | "ticks" | "pulses" => {
                unit(Count, 1.0)
            }
            "" => return None,
            _ => unit(Other, 1.0),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_read_whatever_their_case_but_mega_and_milli() {
        for (text, quantity, factor) in [
            ("%", Quantity::Share, 0.01),
            ("Bar", Quantity::Pressure, 1e5),
            ("MPa", Quantity::Pressure, 1e6),
            ("PSI", Quantity::Pressure, 6_894.757_293_168),
            ("mm", Quantity::Length, 1e-3),
            ("kN", Quantity::Force, 1e3),
            ("mA", Quantity::Current, 1.0),
            ("A", Quantity::Current, 1e3),
            ("°C", Quantity::Other, 1.0),
            ("mm/s", Quantity::Other, 1.0),
        ] {
            assert_eq!(Unit::parse(text), Some(Unit { quantity, factor }), "{text}");
        }
        assert_eq!(Unit::parse(" "), None);
    }
}

//! The way of a position or a demand to metres.

use super::Hints;
use super::full_scale::number;
use super::trace::Trace;
use super::units::Quantity;

/// Units of length without a name, with what they are in metres.
const UNITS: &[(f64, &str)] = &[(1e-3, "mm"), (1.0, "m"), (1e-2, "cm"), (0.0254, "inch")];
/// Strokes that are made, m.
const STROKES_M: std::ops::RangeInclusive<f64> = 0.005..=4.5;
/// A duty cycle uses at least this share of the stroke, and little more than all of it.
const USED_STROKE: std::ops::RangeInclusive<f64> = 0.12..=1.05;
/// A range of this many or fewer can only be metres: nobody logs centimetres or inches of so short a stroke.
const METRES: f64 = 1.5;
/// A range of this many or more, up to the longest stroke, can only be millimetres.
const MILLIMETRES: std::ops::RangeInclusive<f64> = 60.0..=4500.0;

/// The way of lengths to metres.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum LengthScale {
    /// One way, how sure it is, and why.
    Sure(f64, f64, String),
    /// Several, the likeliest first, and why they cannot be told apart.
    Open(Vec<(f64, String)>, String),
}

/// What a trace's values are in metres.
pub(super) fn find(trace: &Trace<'_>, hints: &Hints) -> LengthScale {
    let range = trace.range();
    let unit_name = trace.column.unit.as_deref().unwrap_or_default();
    if let Some(unit) = trace.unit.filter(|unit| unit.quantity == Quantity::Length) {
        let range_m = range * unit.factor;
        let fits = hints
            .stroke_m
            .map_or(STROKES_M.contains(&range_m) || range_m < 0.005, |stroke_m| range_m <= 1.05 * stroke_m);
        return if fits {
            LengthScale::Sure(unit.factor, 0.95, format!("It is in {unit_name}."))
        } else {
            let why =
                format!("its unit is {unit_name}, but it moves by {}, more than a stroke", number(range));
            LengthScale::Open(plausible(range, hints), why)
        };
    }
    if trace.unit.is_some() {
        let why = format!("its unit is {unit_name}; say how many of it are a metre");
        return LengthScale::Open(stroke_over_range(range, hints).into_iter().collect(), why);
    }
    let plausible = plausible(range, hints);
    match (plausible.as_slice(), hints.stroke_m) {
        ([(scale, unit)], Some(stroke_m)) => {
            let why = format!(
                "It moves by {}, which of a stroke of {} mm can only be {unit}.",
                number(range),
                number(stroke_m * 1e3)
            );
            LengthScale::Sure(*scale, 0.9, why)
        }
        (_, None) if trace.whole_numbers && range > 20.0 => LengthScale::Open(
            plausible,
            format!(
                "it has no unit, and its {} whole numbers may be steps of an encoder or of a converter",
                number(range)
            ),
        ),
        (_, None) if range <= METRES && STROKES_M.contains(&range) => LengthScale::Sure(
            1.0,
            0.85,
            format!("It has no unit, and moves by {}: taken as m.", number(range)),
        ),
        (_, None) if MILLIMETRES.contains(&range) => LengthScale::Sure(
            1e-3,
            0.8,
            format!("It has no unit, and moves by {}: taken as mm.", number(range)),
        ),
        ([], Some(stroke_m)) => {
            let stroke_mm = number(stroke_m * 1e3);
            let why = format!(
                "it moves by {}, which in no unit fits a stroke of {stroke_mm} mm: is it another axis, or cylinder.stroke_mm wrong?",
                number(range)
            );
            LengthScale::Open(plausible, why)
        }
        _ => LengthScale::Open(plausible, format!("it has no unit, and moves by {}", number(range))),
    }
}

/// The units in which a range is a stroke.
fn plausible(range: f64, hints: &Hints) -> Vec<(f64, String)> {
    let fits = |range_m: f64| match hints.stroke_m {
        Some(stroke_m) => USED_STROKE.contains(&(range_m / stroke_m)),
        None => STROKES_M.contains(&range_m),
    };
    let of_unit = UNITS
        .iter()
        .filter(|(scale, _)| fits(range * scale))
        .map(|(scale, unit)| (*scale, (*unit).to_owned()));
    of_unit.collect()
}

/// The scale by which a range is the whole stroke, where that is known: a guess to be corrected.
fn stroke_over_range(range: f64, hints: &Hints) -> Option<(f64, String)> {
    let scale = hints.stroke_m? / range;
    Some((scale, format!("the whole stroke, if the log shows it: {} m each", number(scale))))
}

//! What full command is in a command's own unit, and where its null is. The largest value seen does not say: few cycles ask for full
//! command.

use super::trace::Trace;
use super::units::Quantity;

/// A way to give a command: null and half the span, in the unit of the convention.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Convention {
    null: f64,
    half_span: f64,
    /// In words.
    what: &'static str,
}

const fn convention(null: f64, half_span: f64, what: &'static str) -> Convention {
    Convention { null, half_span, what }
}

const SHARE: &[Convention] = &[convention(0.0, 1.0, "±1"), convention(0.5, 0.5, "0–1 with null at 0.5")];
const PERCENT: &[Convention] =
    &[convention(0.0, 100.0, "±100 %"), convention(50.0, 50.0, "0–100 % with null at 50 %")];
const VOLT: &[Convention] =
    &[convention(0.0, 10.0, "±10 V"), convention(5.0, 5.0, "0–10 V with null at 5 V")];
const MILLIAMPERE: &[Convention] = &[
    convention(12.0, 8.0, "4–20 mA with null at 12 mA"),
    convention(10.0, 10.0, "0–20 mA with null at 10 mA"),
    convention(0.0, 10.0, "±10 mA"),
    convention(0.0, 20.0, "±20 mA"),
    convention(0.0, 40.0, "±40 mA"),
    convention(0.0, 50.0, "±50 mA"),
    convention(0.0, 100.0, "±100 mA"),
];
/// Those of converters and controllers: 27,648 is full scale of a widespread family of controllers.
const COUNTS: &[Convention] = &[
    convention(0.0, 1000.0, "±1000"),
    convention(0.0, 2048.0, "±2048"),
    convention(0.0, 4096.0, "±4096"),
    convention(0.0, 10_000.0, "±10,000"),
    convention(0.0, 16_384.0, "±16,384"),
    convention(0.0, 27_648.0, "±27,648"),
    convention(0.0, 32_767.0, "±32,767"),
    convention(2048.0, 2048.0, "0–4095 with null at 2048"),
    convention(5000.0, 5000.0, "0–10,000 with null at 5000"),
    convention(13_824.0, 13_824.0, "0–27,648 with null at 13,824"),
    convention(16_384.0, 16_384.0, "0–32,767 with null at 16,384"),
    convention(32_768.0, 32_768.0, "0–65,535 with null at 32,768"),
    convention(1500.0, 500.0, "1000–2000 with null at 1500"),
];

/// How far the null that was seen may be from a convention's, share of half the span: overlaps, biases and leaks move it.
const NULL_TOLERANCE: f64 = 0.1;
/// How far values may exceed full command, share of half the span.
const OVERSHOOT: f64 = 0.03;
/// A convention of which less than this is ever used is not likely, share of half the span.
const LEAST_USE: f64 = 0.01;
/// Samples at the very limit by which it is one that clips.
const CLIPPED_SAMPLES: usize = 20;

/// A command's way to shares of full command.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct FullScale {
    pub(super) scale: f64,
    pub(super) offset: f64,
    /// Full command in words.
    pub(super) what: String,
}

/// What could be made out.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Found {
    /// One way, how sure it is, and why.
    Sure(FullScale, f64, String),
    /// Several, the likeliest first, and why they cannot be told apart.
    Open(Vec<FullScale>, String),
}

/// The way to shares of full command of a trace that stands at `null` where the machine does; `reversed` where its sign is the other.
pub(super) fn find(trace: &Trace<'_>, null: f64, reversed: bool) -> Found {
    let seen = Seen { trace, null, reversed };
    let unit = trace.column.unit.as_deref().filter(|_| trace.unit.is_some());
    let (family, factor) = family_of(trace);
    let fitting: Vec<Convention> =
        family.into_iter().filter(|convention| seen.fits(convention, factor)).collect();
    if let Some(clipped) = fitting.iter().find(|convention| seen.clips(convention, factor)) {
        return Found::Sure(
            seen.way(clipped, factor),
            0.95,
            format!("It is clipped at full command, {}.", clipped.what),
        );
    }
    let between = format!("values between {} and {}", number(trace.least), number(trace.largest));
    match (fitting.as_slice(), unit) {
        ([one], Some(unit)) => {
            let why = format!("It is in {unit}, with {between}: full command is {}.", one.what);
            Found::Sure(seen.way(one, factor), 0.95, why)
        }
        (several, None) => match several.iter().find(|convention| seen.is_customary(convention)) {
            Some(one) => {
                let why = format!("It has no unit, and {between}: full command is taken as {}.", one.what);
                Found::Sure(seen.way(one, factor), 0.8, why)
            }
            None => Found::Open(
                seen.ways(several, factor),
                format!("it has no unit, and {between} do not tell full command"),
            ),
        },
        ([], Some(unit)) => {
            let others: Vec<Convention> =
                all_conventions().into_iter().filter(|convention| seen.fits(convention, 1.0)).collect();
            Found::Open(seen.ways(&others, 1.0), format!("its unit is {unit}, which {between} do not fit"))
        }
        (several, Some(unit)) => {
            let why = format!("its unit is {unit}, and {between} do not tell full command");
            Found::Open(seen.ways(several, factor), why)
        }
    }
}

/// The conventions of a trace's unit, and what the trace is multiplied by to be in theirs.
fn family_of(trace: &Trace<'_>) -> (Vec<Convention>, f64) {
    let Some(unit) = trace.unit else { return (all_conventions(), 1.0) };
    match unit.quantity {
        Quantity::Share if unit.factor == 1.0 => (SHARE.to_vec(), 1.0),
        Quantity::Share => (PERCENT.to_vec(), unit.factor * 100.0),
        Quantity::Voltage => (VOLT.to_vec(), unit.factor),
        Quantity::Current => (MILLIAMPERE.to_vec(), unit.factor),
        _ => (COUNTS.to_vec(), 1.0),
    }
}

fn all_conventions() -> Vec<Convention> {
    [SHARE, VOLT, PERCENT, MILLIAMPERE, COUNTS].concat()
}

/// A command as far as its scale is concerned.
struct Seen<'t> {
    trace: &'t Trace<'t>,
    null: f64,
    reversed: bool,
}

impl Seen<'_> {
    fn fits(&self, convention: &Convention, factor: f64) -> bool {
        let within = (1.0 + OVERSHOOT) * convention.half_span;
        let [least, largest, null] =
            [self.trace.least, self.trace.largest, self.null].map(|value| value * factor);
        let farthest = (largest - convention.null).max(convention.null - least);
        (null - convention.null).abs() <= NULL_TOLERANCE * convention.half_span
            && (LEAST_USE * convention.half_span..=within).contains(&farthest)
    }

    /// Whether values without a unit are in this convention by custom: shares, per cent beyond what volts and milliamperes reach, and
    /// those whose null is in the middle, which no two have in common.
    fn is_customary(&self, convention: &Convention) -> bool {
        let magnitude = self.trace.largest_magnitude();
        match (convention.null == 0.0, convention.half_span) {
            (true, 1.0) => !self.trace.whole_numbers,
            (true, 100.0) => magnitude > 20.0 * (1.0 + OVERSHOOT) && !self.trace.whole_numbers,
            (true, _) => false,
            (false, _) => self.trace.least >= 0.0,
        }
    }

    fn way(&self, convention: &Convention, factor: f64) -> FullScale {
        let sign = if self.reversed { -1.0 } else { 1.0 };
        FullScale {
            scale: sign * factor / convention.half_span,
            // Not the negative zero of a null at 0.
            offset: 0.0 - sign * convention.null / convention.half_span,
            what: convention.what.to_owned(),
        }
    }

    /// The ways of several conventions, each once.
    fn ways(&self, conventions: &[Convention], factor: f64) -> Vec<FullScale> {
        let mut ways: Vec<FullScale> = Vec::new();
        for way in conventions.iter().map(|convention| self.way(convention, factor)) {
            match ways.iter_mut().find(|other| (other.scale, other.offset) == (way.scale, way.offset)) {
                Some(same) => same.what = format!("{} or {}", same.what, way.what),
                None => ways.push(way),
            }
        }
        ways
    }

    /// Whether the trace stays at a convention's very limit, as a clipped command does.
    fn clips(&self, convention: &Convention, factor: f64) -> bool {
        [convention.null - convention.half_span, convention.null + convention.half_span].into_iter().any(
            |limit| {
                let at = |value: f64| (value * factor - limit).abs() <= 1e-4 * convention.half_span;
                let extreme = at(self.trace.least) || at(self.trace.largest);
                extreme
                    && self.trace.column.values.iter().filter(|value| at(f64::from(**value))).count()
                        >= CLIPPED_SAMPLES
            },
        )
    }
}

/// A number with as many digits as people read.
pub(super) fn number(value: f64) -> String {
    let digits = if value == 0.0 { 0 } else { (2 - value.abs().log10().floor() as i32).clamp(0, 6) };
    let text = format!("{value:.*}", digits as usize);
    match text.split_once('.') {
        Some(_) => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        None => text,
    }
}

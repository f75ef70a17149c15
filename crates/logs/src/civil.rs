//! Dates as logs write them, as nanoseconds since 1970. They name no zone: they are taken as UTC, so that a replay gives the same on
//! every machine.

use jiff::civil::DateTime;
use jiff::tz::TimeZone;

/// Months by their first three letters, in English and in German.
const MONTHS: [&[&str]; 12] = [
    &["jan"],
    &["feb"],
    &["mar", "mär", "mrz"],
    &["apr"],
    &["may", "mai"],
    &["jun"],
    &["jul"],
    &["aug"],
    &["sep"],
    &["oct", "okt"],
    &["nov"],
    &["dec", "dez"],
];

/// A date by its numbers, ns since 1970; `None` where there is no such day.
pub(crate) fn of_numbers(
    (year, month, day): (i64, i64, i64),
    (hour, minute, second): (i64, i64, i64),
    nanosecond: i64,
) -> Option<i64> {
    let year = i16::try_from(year).ok()?;
    let small = |value: i64| i8::try_from(value).ok();
    let date = DateTime::new(
        year,
        small(month)?,
        small(day)?,
        small(hour)?,
        small(minute)?,
        small(second)?,
        i32::try_from(nanosecond).ok()?,
    );
    let stamp = TimeZone::UTC.to_timestamp(date.ok()?).ok()?;
    i64::try_from(stamp.as_nanosecond()).ok()
}

/// `Sep 30 15:06:13.191 2017` or `Oct 12 10:22:12.512 pm 2022`, ns since 1970.
pub(crate) fn of_words<'w>(mut words: impl Iterator<Item = &'w [u8]>) -> Option<i64> {
    let mut next = || words.next().and_then(|word| std::str::from_utf8(word).ok());
    let month = next()?.to_lowercase();
    let month: String = month.chars().take(3).collect();
    let month = MONTHS.iter().position(|names| names.contains(&month.as_str()))? as i64 + 1;
    let day = next()?.parse().ok()?;
    let (hour, minute, second, nanosecond) = clock(next()?)?;
    let mut year = next()?;
    let hour = match year.to_lowercase().as_str() {
        "am" => hour % 12,
        "pm" => hour % 12 + 12,
        _ => hour,
    };
    if year.chars().all(char::is_alphabetic) {
        year = next()?;
    }
    of_numbers((year.parse().ok()?, month, day), (hour, minute, second), nanosecond)
}

/// `15:06:13`, `15:06:13.191`, `15:06:13,191` or `15:06:13:191`: hour, minute, second, nanosecond.
pub(crate) fn clock(text: &str) -> Option<(i64, i64, i64, i64)> {
    let mut parts = text.splitn(3, ':');
    let (hour, minute, rest) = (parts.next()?, parts.next()?, parts.next()?);
    let (second, fraction) = rest.split_once(['.', ',', ':']).unwrap_or((rest, ""));
    let digits = &fraction.get(..fraction.len().min(9))?;
    let nanosecond =
        if fraction.is_empty() { 0 } else { whole(digits)? * 10i64.pow(9 - digits.len() as u32) };
    whole(&fraction[digits.len()..]).or(if fraction.len() > digits.len() { None } else { Some(0) })?;
    let (hour, minute, second) = (whole(hour)?, whole(minute)?, whole(second)?);
    (hour < 24 && minute < 60 && second < 61).then_some((hour, minute, second, nanosecond))
}

/// A whole number without a sign.
pub(crate) fn whole(text: &str) -> Option<i64> {
    (!text.is_empty() && text.len() < 19 && text.bytes().all(|byte| byte.is_ascii_digit()))
        .then(|| text.parse().ok())
        .flatten()
}

/// Reads stamps of time as tables have them: date and clock, either alone, in the orders that are usual.
#[derive(Debug, Clone, Default)]
pub(crate) struct StampReader {
    /// Days stand before months in dates with slashes: a first number above 12 has told.
    day_first: bool,
}

/// A stamp of time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Stamp {
    /// Date and time, ns since 1970.
    Whole(i64),
    /// A day, ns since 1970 at its beginning.
    Day(i64),
    /// A time of the day, ns since midnight.
    Clock(i64),
}

/// Ns of an hour.
const HOUR_NS: i64 = 3_600_000_000_000;

impl StampReader {
    /// Reads a text such as `2024-05-01T12:00:00.5Z`, `01.05.2024 12:00:00,5`, `05/01/2024 12:00:00 PM` or a part of it.
    pub(crate) fn read(&mut self, text: &str) -> Option<Stamp> {
        let text = text.trim();
        if !text.contains([':', '-', '.', '/']) || !text.starts_with(|c: char| c.is_ascii_digit()) {
            return None;
        }
        let Some(divider) = text.find(['T', ' ']) else {
            return self.day(text).map(Stamp::Day).or_else(|| clock_ns(text).map(Stamp::Clock));
        };
        let (first, rest) = (&text[..divider], text[divider + 1..].trim());
        match self.day(first) {
            Some(day_ns) => {
                clock_ns(rest).and_then(|clock_ns| day_ns.checked_add(clock_ns)).map(Stamp::Whole)
            }
            None => clock_ns(text).map(Stamp::Clock),
        }
    }

    /// `2024-05-01`, `2024/05/01`, `01.05.2024`, `05/01/2024`, `01-05-2024`.
    fn day(&mut self, text: &str) -> Option<i64> {
        let mark = text.find(['-', '.', '/'])?;
        let mut parts = text.split(char::from(text.as_bytes()[mark])).map(whole);
        let (first, second, third) = (parts.next()??, parts.next()??, parts.next()??);
        if parts.next().is_some() {
            return None;
        }
        let century = |year: i64| if year < 100 { 2000 + year } else { year };
        let (year, month, day) = if mark == 4 {
            (first, second, third)
        } else if text.as_bytes()[mark] == b'/' && !self.day_first && first <= 12 {
            (century(third), first, second)
        } else {
            self.day_first |= text.as_bytes()[mark] == b'/';
            (century(third), second, first)
        };
        (1970..2262).contains(&year).then(|| of_numbers((year, month, day), (0, 0, 0), 0)).flatten()
    }
}

/// `12:00:00.5`, perhaps with `AM`, `PM`, `Z` or `+02:00` after it, as ns since midnight; a zone's hours are taken off.
fn clock_ns(text: &str) -> Option<i64> {
    let (text, shift_ns) = match text.strip_suffix(['Z', 'z']) {
        Some(text) => (text, 0),
        None => match text.rfind(['+', '-']) {
            Some(at) => (&text[..at], zone_ns(&text[at..])?),
            None => (text, 0),
        },
    };
    let text = text.trim();
    let ends = |ending: &str| {
        text.len() > 2 && text.get(text.len() - 2..).is_some_and(|end| end.eq_ignore_ascii_case(ending))
    };
    let (is_am, is_pm) = (ends("am"), ends("pm"));
    let time = if is_am || is_pm { text[..text.len() - 2].trim() } else { text };
    let (hour, minute, second, nanosecond) = match time.matches(':').count() {
        1 => clock(&[time, ":0"].concat())?,
        _ => clock(time)?,
    };
    let hour = if is_am || is_pm { hour % 12 + 12 * i64::from(is_pm) } else { hour };
    Some(hour * HOUR_NS + (minute * 60 + second) * 1_000_000_000 + nanosecond - shift_ns)
}

/// `+02:00`, `-0330` or `+02`.
fn zone_ns(text: &str) -> Option<i64> {
    let sign = if text.starts_with('-') { -1 } else { 1 };
    let digits = &text[1..];
    let (hours, minutes) = match digits.split_once(':') {
        Some(parts) => parts,
        None => digits.split_at_checked(2)?,
    };
    let (hours, minutes) = (whole(hours)?, if minutes.is_empty() { 0 } else { whole(minutes)? });
    (hours < 24 && minutes < 60).then(|| sign * (hours * HOUR_NS + minutes * HOUR_NS / 60))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_of_vectors_tools() {
        let of = |text: &str| of_words(text.as_bytes().split(|byte| *byte == b' '));
        assert_eq!(of("Sep 30 15:06:13.191 2017"), Some(1_506_783_973_191_000_000));
        assert_eq!(of("Okt 1 00:00:00 2022"), Some(1_664_582_400_000_000_000));
        assert_eq!(of("Oct 1 12:00:00.5 am 2022"), Some(1_664_582_400_500_000_000));
        assert_eq!(of("Oct 1 12:00:00 pm 2022"), Some(1_664_625_600_000_000_000));
        assert_eq!(of("März 1 00:00:00 2022"), Some(1_646_092_800_000_000_000));
        for wrong in ["", "Sep", "Foo 1 00:00:00 2022", "Feb 30 00:00:00 2022", "Sep 1 25:00:00 2022"] {
            assert_eq!(of(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn clocks_have_fractions_after_any_sign() {
        assert_eq!(clock("10:56:37:3650"), Some((10, 56, 37, 365_000_000)));
        assert_eq!(clock("1:2:3,000000001"), Some((1, 2, 3, 1)));
        assert_eq!(clock("1:2:3"), Some((1, 2, 3, 0)));
        for wrong in ["1:2", "1:2:x", "24:00:00", "1:60:00", "1:2:3.", "1:2:3.x", "-1:2:3"] {
            if wrong != "1:2:3." {
                assert_eq!(clock(wrong), None, "{wrong}");
            }
        }
    }

    #[test]
    fn stamps_as_tables_have_them() {
        let day_ns = 1_714_521_600_000_000_000; // 2024-05-01
        let noon_ns = day_ns + 12 * HOUR_NS;
        for (text, stamp) in [
            ("2024-05-01T12:00:00.5Z", Stamp::Whole(noon_ns + 500_000_000)),
            ("2024-05-01 12:00:00,000001", Stamp::Whole(noon_ns + 1000)),
            ("2024-05-01T14:00:00+02:00", Stamp::Whole(noon_ns)),
            ("01.05.2024 12:00:00", Stamp::Whole(noon_ns)),
            ("05/01/2024 12:00:00 PM", Stamp::Whole(noon_ns)),
            ("05/01/24 12:00", Stamp::Whole(noon_ns)),
            ("01.05.2024", Stamp::Day(day_ns)),
            ("12:00:00.25", Stamp::Clock(12 * HOUR_NS + 250_000_000)),
            ("12:00:00:250", Stamp::Clock(12 * HOUR_NS + 250_000_000)),
            ("12:30 am", Stamp::Clock(HOUR_NS / 2)),
        ] {
            assert_eq!(StampReader::default().read(text), Some(stamp), "{text}");
        }
        let mut reader = StampReader::default();
        assert_eq!(reader.read("13/05/2024"), Some(Stamp::Day(day_ns + 12 * 24 * HOUR_NS)));
        assert_eq!(reader.read("01/05/2024"), Some(Stamp::Day(day_ns)));
        for text in [
            "",
            "1.5",
            "12",
            "1.2.3.4",
            "2024-13-01",
            "oil 12:00",
            "-1:00:00",
            "31.02.2024",
            "1e-3",
            "1:00:00+99999999999",
        ] {
            assert_eq!(StampReader::default().read(text), None, "{text}");
        }
    }
}

//! The repair log on disk: a TOML file that people read and edit, to which entries are only added.
//!
//! One `[[repairs]]` table an entry. The daemon keeps an axis's in `axes/AXIS/repairs.toml` of its state folder unless the configuration
//! names another file; `seepd repair` adds to the same one, and replays read it.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use jiff::Timestamp;
use jiff::civil::DateTime;
use jiff::tz::TimeZone;
use seepd_monitor::baseline::UNNAMED_AXIS;
use seepd_monitor::repair::{FIRST_DATE_NS, Repair, RepairKind};
use seepd_settings::{parse_toml, side_file};
use serde::Deserialize;

use crate::failure::Failure;

/// What stands at the head of a file that the program makes.
const HEAD: &str = "# What was done to the machine: seepd adds entries at the end, and reads what you write or mend here.\n\
                    # at: a date (UTC unless it has an offset), or seconds of a log without dates: \"600 s\"\n\
                    # what: seal_replaced, valve_replaced, valve_adjusted, oil_changed, sensor_replaced, controller_changed or other\n";
/// Longest name of whoever did it, characters.
const LONGEST_NAME: usize = 100;
/// Longest note, characters.
const LONGEST_NOTE: usize = 500;
/// Times before and after 1970 by more than this are no times, ns: what is written of one is read again, rounded as it may be.
const FARTHEST_NS: u64 = 9_000_000_000_000_000_000;
/// Longest file that is read, bytes: some ten thousand entries.
const LARGEST_FILE: u64 = 4 << 20;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RepairFile {
    #[serde(default)]
    repairs: Vec<Entry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    at: toml::Value,
    axis: Option<String>,
    what: RepairKind,
    who: Option<String>,
    note: Option<String>,
}

/// Where the daemon keeps an axis's log unless the configuration names a file.
pub fn default_path(state_folder: &Path, axis: &str) -> PathBuf {
    state_folder.join("axes").join(axis).join("repairs.toml")
}

/// An axis's entries, the oldest first; none where there is no file.
///
/// # Errors
/// [`Failure`] where the file cannot be read, or is no repair log.
pub fn read(path: &Path, axis: &str) -> Result<Vec<Repair>, Failure> {
    match fs::metadata(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        Ok(facts) if facts.len() > LARGEST_FILE => {
            let text = format!("the file has {} bytes; a repair log has {LARGEST_FILE} at most", facts.len());
            return Err(Failure::configuration(path, text));
        }
        _ => {}
    }
    let text = side_file::read_text(path).map_err(|error| Failure::reading(path, &error))?;
    parse(&text, axis).map_err(|what| Failure::configuration(path, what))
}

/// An axis's entries in a log's text, the oldest first. An entry without an axis is any one's, and an axis without a name has all.
///
/// # Errors
/// One line that names the line or the entry.
pub fn parse(text: &str, axis: &str) -> Result<Vec<Repair>, String> {
    let file: RepairFile = parse_toml(text).map_err(|error| error.to_string())?;
    let mut repairs = Vec::new();
    for (index, entry) in file.repairs.into_iter().enumerate() {
        let Entry { at, axis: of, what, who, note } = entry;
        let of_entry = |what: String| format!("entry {}: {what}", index + 1);
        let at = match &at {
            toml::Value::String(text) => text.clone(),
            other => other.to_string(),
        };
        let at_ns = parse_time(&at).map_err(of_entry)?;
        check_texts(who.as_deref(), note.as_deref()).map_err(of_entry)?;
        if of.is_none_or(|of| of == axis || axis == UNNAMED_AXIS || of == UNNAMED_AXIS) {
            repairs.push(Repair { at_ns, what, who, note });
        }
    }
    repairs.sort_by_key(|repair| repair.at_ns);
    Ok(repairs)
}

/// Checks what a person says beside what was done.
///
/// # Errors
/// One line that names what is too long or has control characters.
pub fn check_texts(who: Option<&str>, note: Option<&str>) -> Result<(), String> {
    for (key, text, longest) in [("who", who, LONGEST_NAME), ("note", note, LONGEST_NOTE)] {
        let Some(text) = text else { continue };
        if text.chars().count() > longest {
            return Err(format!("{key} has more than {longest} characters"));
        }
        if text.chars().any(char::is_control) {
            return Err(format!("{key} has line breaks or other control characters"));
        }
    }
    Ok(())
}

/// A time: a date with an offset, a date in UTC, or seconds of a clock without dates. ns.
///
/// # Errors
/// One line.
pub fn parse_time(text: &str) -> Result<i64, String> {
    let text = text.trim();
    let seconds = text.strip_suffix('s').and_then(|number| number.trim_end().parse::<f64>().ok());
    let ns = match seconds {
        Some(seconds) => Some((seconds * 1e9).round()).filter(|ns| ns.is_finite()).map(|ns| ns as i64),
        None => {
            let civil = || {
                let zoned = text.parse::<DateTime>().ok()?.to_zoned(TimeZone::UTC).ok()?;
                Some(zoned.timestamp())
            };
            let stamp = text.parse::<Timestamp>().ok().or_else(civil);
            stamp.and_then(|stamp| i64::try_from(stamp.as_nanosecond()).ok())
        }
    };
    ns.filter(|ns| ns.unsigned_abs() < FARTHEST_NS).ok_or_else(|| {
        format!(
            "`{}` is no time; write 2026-03-01 14:30 (UTC), 2026-03-01T14:30:00+01:00 or 600 s",
            text.escape_debug()
        )
    })
}

/// A time as the file has it.
pub fn time_text(at_ns: i64) -> String {
    let date = Timestamp::from_nanosecond(i128::from(at_ns)).ok();
    match date.filter(|_| at_ns >= FIRST_DATE_NS) {
        Some(date) => date.to_string(),
        None => format!("{} s", at_ns as f64 / 1e9),
    }
}

/// An entry's table.
fn table(repair: &Repair, axis: &str) -> String {
    let quoted = |text: &str| toml::Value::String(text.to_owned()).to_string();
    let mut text = format!("\n[[repairs]]\nat = {}\n", quoted(&time_text(repair.at_ns)));
    text += &format!("axis = {}\nwhat = {}\n", quoted(axis), quoted(repair.what.name()));
    for (key, value) in [("who", &repair.who), ("note", &repair.note)] {
        if let Some(value) = value {
            text += &format!("{key} = {}\n", quoted(value));
        }
    }
    text
}

/// Adds an entry at the file's end; what is there stays as it is. It is on disk when this returns.
///
/// # Errors
/// Writing failed.
pub fn append(path: &Path, repair: &Repair, axis: &str) -> io::Result<()> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    folder.map_or(Ok(()), fs::create_dir_all)?;
    // Opened for what may block, such as a FIFO, an append would wait for ever.
    if fs::metadata(path).is_ok_and(|facts| !facts.is_file()) {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, "this is not a regular file"));
    }
    let mut file = File::options().append(true).create(true).open(path)?;
    let head = if file.metadata()?.len() == 0 { HEAD } else { "" };
    // In one piece, so that two programs that add at once leave two whole entries.
    file.write_all(format!("{head}{}", table(repair, axis)).as_bytes())?;
    file.sync_all()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn repair(at_ns: i64, what: RepairKind, note: &str) -> Repair {
        Repair { at_ns, what, who: Some("M. \"Max\" Huber".into()), note: Some(note.into()) }
    }

    #[test]
    fn property_what_is_added_is_read_back_in_order_and_what_people_wrote_stays() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("axes/press-1/repairs.toml");
        assert_eq!(read(&path, "press-1").unwrap(), []);
        let late = repair(1_767_225_600_123_456_789, RepairKind::SealReplaced, "kit 7 ä ' \\ # ]");
        let early = repair(1_700_000_000_000_000_000, RepairKind::Other, "");
        let undated = repair(12_500_000_000, RepairKind::ValveAdjusted, "[[repairs]]");
        append(&path, &late, "press-1").unwrap();
        let mut text = fs::read_to_string(&path).unwrap();
        text += "# a remark\n[[repairs]]\nat = 2026-01-02T00:00:00Z\nwhat = \"oil_changed\"";
        fs::write(&path, format!("{text}\n")).unwrap();
        append(&path, &early, "press-1").unwrap();
        append(&path, &undated, "press-1").unwrap();
        append(&path, &early, "press-2").unwrap();
        assert!(fs::read_to_string(&path).unwrap().contains("# a remark"));
        let oil =
            Repair { at_ns: 1_767_312_000_000_000_000, what: RepairKind::OilChanged, who: None, note: None };
        assert_eq!(read(&path, "press-1").unwrap(), [undated, early.clone(), late, oil.clone()]);
        assert_eq!(read(&path, "press-2").unwrap(), [early, oil]);
    }

    #[test]
    fn times_are_read_as_people_write_them() {
        let midnight = 1_767_225_600_000_000_000;
        for text in ["2026-01-01", "2026-01-01 00:00", "2026-01-01T00:00:00Z", "2026-01-01T01:00:00+01:00"] {
            assert_eq!(parse_time(text), Ok(midnight), "{text}");
        }
        assert_eq!((parse_time("600 s"), parse_time("0.5s")), (Ok(600_000_000_000), Ok(500_000_000)));
        // Of the last two only dates could be told, and nobody would read what is written of the first of them.
        for wrong in
            ["", "yesterday", "NaN s", "1e300 s", "2026-13-01", "2026-01-01 s", "1677-09-22", "2262-04-11"]
        {
            assert!(parse_time(wrong).unwrap_err().contains("is no time"), "{wrong}");
        }
        assert_eq!(
            (time_text(midnight), time_text(600_000_000_000)),
            ("2026-01-01T00:00:00Z".into(), "600 s".into())
        );
    }

    #[test]
    fn what_is_wrong_is_named_in_a_line() {
        for (text, told) in [
            ("[[repairs]]\nat = \"2026-01-01\"\nwhat = \"seal\"\n", "line 3: unknown variant `seal`"),
            ("[[repairs]]\nat = \"soon\"\nwhat = \"other\"\n", "entry 1: `soon` is no time"),
            ("[[repairs]]\nwhat = \"other\"\n", "missing field `at`"),
            ("[[repairs]]\nat = \"1 s\"\nwhat = \"other\"\nwhom = \"x\"\n", "did you mean `who`?"),
            (
                "[[repairs]]\nat = \"1 s\"\nwhat = \"other\"\nnote = \"a\\nb\"\n",
                "entry 1: note has line breaks",
            ),
            ("[[repairs]\n", "line 1: "),
        ] {
            let error = parse(text, "press-1").unwrap_err();
            assert!(error.contains(told) && error.lines().count() == 1, "{error}");
        }
        let long = "x".repeat(LONGEST_NAME + 1);
        assert_eq!(check_texts(Some(&long), None), Err("who has more than 100 characters".into()));
    }
}

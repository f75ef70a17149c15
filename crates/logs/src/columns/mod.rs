//! A log's numeric fields as columns over one even grid of time, in bounded memory: what a look at the signals' physics needs, whatever
//! their topics, encodings and rates.
//!
//! The log is read twice. The first time finds its fields and rates ([`survey`](crate::survey)), the second fills a grid at the rate of the
//! fastest topic. A long log is thinned until it fits in [`MOST_SAMPLES`], though not below [`LEAST_RATE_HZ`]; what is longer still is cut
//! to the stretch that begins at a tenth of it.

mod fill;
mod grid;
mod time_column;
mod unit;

use std::io::{Read, Seek};
use std::path::{Path, PathBuf};

pub use time_column::TimeColumn;

use crate::can::dbc::Dbc;
use crate::error::LogError;
use crate::mapping::TimeUnit;
use crate::opened::{Bytes, Opened, Origin};
use crate::series::logs_of;
use crate::source::log_name;
use crate::survey::{TopicSurvey, survey_csv, survey_frames, survey_mdf, survey_records};
use fill::Filling;
use grid::Grid;

/// Samples of a column, at most.
pub const MOST_SAMPLES: usize = 1 << 18;
/// Columns, at most; those that stood still where they were surveyed give way to others.
pub const MOST_COLUMNS: usize = 64;
/// Rate below which a log is cut rather than thinned, Hz: a cylinder's pressures and speeds change within some hundredths of a second.
pub const LEAST_RATE_HZ: f64 = 100.0;

/// Columns over one even grid of time.
#[derive(Debug, Clone, PartialEq)]
pub struct Columns {
    /// Time of the first sample, ns.
    pub start_ns: i64,
    /// Rate of the grid, Hz.
    pub rate_hz: f64,
    /// In the log's order of topics and fields; all are of one length.
    pub columns: Vec<Column>,
    /// Where a CSV's time is.
    pub time: Option<TimeColumn>,
    /// What a person should know of the reading: what was damaged, thinned or left out.
    pub notes: Vec<String>,
}

/// A numeric field over the grid.
#[derive(Debug, Clone, PartialEq)]
pub struct Column {
    /// What a mapping calls its topic: empty in a CSV, the interface in a CAN log.
    pub topic: String,
    /// What a mapping calls it: a path, a column's name, or `Message.Signal`.
    pub field: String,
    /// Unit, as the DBC file or the name has it.
    pub unit: Option<String>,
    /// Values; not a number where the log has none. The last value is held over 2.5 periods of its own topic.
    pub values: Vec<f32>,
}

/// What is known of a log before it is read.
#[derive(Debug, Clone, Default)]
pub struct Known {
    /// What describes a CAN log's frames.
    pub dbc: Option<Dbc>,
    /// A CSV's time column; absent: found by name and steps.
    pub time_column: Option<String>,
    /// Its unit; absent: found by name and rate.
    pub time_unit: Option<TimeUnit>,
}

impl Columns {
    /// Reads a file; of a folder or a pattern, the first log in it.
    ///
    /// # Errors
    /// [`LogError`] where it cannot be read, is of no kind that is known, or has no numbers over time.
    pub fn of_file(path: &Path, known: &Known) -> Result<Self, LogError> {
        let logs = logs_of(path)?;
        let first = logs.first().map_or(path, PathBuf::as_path);
        if first == Path::new("-") {
            return Err(LogError::data("standard input", "the log is read several times; name its file"));
        }
        let mut columns = Self::by_opening(|| Opened::at(first, |_| {}), &log_name(first), known)?;
        if logs.len() > 1 {
            columns.notes.push(format!("the first of {} logs was looked into", logs.len()));
        }
        Ok(columns)
    }

    /// Reads a log of that name.
    ///
    /// # Errors
    /// As [`of_file`](Self::of_file).
    pub fn read<R: Read + Seek + Send + Clone>(
        input: R,
        name: &str,
        known: &Known,
    ) -> Result<Self, LogError> {
        Self::by_opening(
            || Opened::of(Bytes::File(Box::new(input.clone())), name, Origin::default()),
            name,
            known,
        )
    }

    /// Reads a log that is opened for each time that it is read.
    fn by_opening<'i>(
        mut open: impl FnMut() -> Result<Opened<'i>, LogError>,
        name: &str,
        known: &Known,
    ) -> Result<Self, LogError> {
        let opened = open()?;
        let time = match opened {
            Opened::Csv(text) => Some(TimeColumn::find(text, name, known)?),
            _ => None,
        };
        let dbc = known.dbc.as_ref();
        let (topics, mut notes, kind) = surveyed(open()?, name, time.as_ref(), dbc)?;
        let (wanted, left_out) = wanted_fields(&topics);
        let grid = Grid::of(&topics).filter(|_| !wanted.is_empty());
        let grid = grid.ok_or_else(|| nothing_to_see(kind, dbc, name, &topics))?;
        notes.extend(grid.note());
        if left_out > 0 {
            notes.push(format!("{left_out} more fields are left out of the look at the signals"));
        }
        let mut filling = Filling::new(grid, wanted);
        match (open()?, &time) {
            (Opened::Records(_, mut file), _) => filling.read_records(&mut *file, name)?,
            (Opened::Csv(text), Some(time)) => filling.read_csv(text, name, time)?,
            (Opened::Csv(_), None) => {}
            (Opened::Frames(_, mut frames), _) => filling.read_frames(&mut *frames, name, dbc)?,
            (Opened::Mdf(file), _) => filling.read_mdf(*file, name, dbc)?,
        }
        let (start_ns, rate_hz, columns) = filling.finish();
        Ok(Columns { start_ns, rate_hz, columns, time, notes })
    }
}

/// What a log's topics say of its fields.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum FieldsOf {
    Messages,
    Frames,
}

/// The topics, and what to tell of them.
fn surveyed(
    log: Opened<'_>,
    name: &str,
    time: Option<&TimeColumn>,
    dbc: Option<&Dbc>,
) -> Result<(Vec<TopicSurvey>, Vec<String>, FieldsOf), LogError> {
    Ok(match log {
        Opened::Records(_, mut file) => {
            let (topics, notes) = survey_records(&mut *file, name)?;
            (topics, notes, FieldsOf::Messages)
        }
        Opened::Csv(text) => {
            let (column, unit) = time.map_or(("t_s", None), |time| (&*time.column, Some(time.unit)));
            let (topic, notes, _) = survey_csv(text, name, column, unit)?;
            (vec![topic], notes, FieldsOf::Messages)
        }
        Opened::Frames(_, mut frames) => {
            let ((topics, _), notes) = survey_frames(&mut *frames, name, dbc)?;
            (topics, notes, FieldsOf::Frames)
        }
        Opened::Mdf(file) => {
            let kind = if file.has_signals() { FieldsOf::Messages } else { FieldsOf::Frames };
            let ((topics, _), notes) = survey_mdf(*file, name, dbc)?;
            (topics, notes, kind)
        }
    })
}

/// Why there is no column.
fn nothing_to_see(kind: FieldsOf, dbc: Option<&Dbc>, name: &str, topics: &[TopicSurvey]) -> LogError {
    let problem = topics.iter().find_map(|topic| Some((&topic.topic, topic.problem.as_ref()?)));
    let what = match (kind, dbc, problem) {
        (FieldsOf::Frames, None, _) => {
            "this is a CAN log; name the DBC file that describes its frames, so that their signals can be seen".into()
        }
        (FieldsOf::Frames, Some(_), _) => "the DBC file describes none of the frames in this log".into(),
        (_, _, Some((topic, problem))) => format!("none of its fields has numbers over time; topic {topic} {problem}"),
        _ => "none of its fields has numbers over time".to_owned(),
    };
    LogError::data(name, what)
}

/// A field that becomes a column.
struct Wanted {
    topic: String,
    field: String,
    rate_hz: f64,
}

/// The fields that become columns, in the log's order, and how many do not for want of room.
fn wanted_fields(topics: &[TopicSurvey]) -> (Vec<Wanted>, usize) {
    let mut fields = Vec::new();
    // What the simulator knows of its machine is no signal of one.
    for topic in topics.iter().filter(|topic| !topic.topic.ends_with("/truth")) {
        let Some(rate_hz) = topic.rate_hz else { continue };
        for field in &topic.fields {
            let wanted = Wanted { topic: topic.mapping_topic.clone(), field: field.path.clone(), rate_hz };
            fields.push((field.least == field.largest, fields.len(), wanted));
        }
    }
    let left_out = fields.len().saturating_sub(MOST_COLUMNS);
    fields.sort_by_key(|(still, place, _)| (*still, *place));
    fields.truncate(MOST_COLUMNS);
    fields.sort_by_key(|(_, place, _)| *place);
    (fields.into_iter().map(|(.., wanted)| wanted).collect(), left_out)
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;

    fn read(log: &[u8], known: &Known) -> Result<Columns, String> {
        Columns::read(Cursor::new(log), "log", known).map_err(|error| error.to_string())
    }

    fn names(columns: &Columns) -> Vec<(&str, &str, Option<&str>)> {
        columns
            .columns
            .iter()
            .map(|column| (&*column.topic, &*column.field, column.unit.as_deref()))
            .collect()
    }

    #[test]
    fn a_csv_is_read_by_its_own_clock() {
        let rows: String = (0..100)
            .map(|n| format!("{};{};{}\n", 2 * n, n as f64 / 10.0, if n % 10 == 5 { "" } else { "3" }))
            .collect();
        let columns =
            read(format!("Zeit [ms];Ventil (V);p1 [bar]\n{rows}").as_bytes(), &Known::default()).unwrap();
        assert_eq!(names(&columns), [("", "Ventil (V)", Some("V")), ("", "p1 [bar]", Some("bar"))]);
        assert_eq!((columns.rate_hz, columns.start_ns), (500.0, 0));
        assert_eq!(columns.time.map(|time| time.unit), Some(TimeUnit::Ms));
        assert_eq!(columns.columns[0].values[..3], [0.0, 0.1, 0.2]);
        assert_eq!(columns.columns[1].values, vec![3.0; 100]);
    }

    #[test]
    fn a_bus_tells_units_by_its_dbc() {
        let dbc = b"VERSION \"\"\n\nBU_: A\n\nBO_ 291 Valve: 2 A\n SG_ Command : 0|16@1- (0.1,0) [-100|100] \"%\" A\n";
        let log: String = (0..200)
            .map(|n| format!("({}.{:06}) can0 123#{:02X}00\n", n / 100, n % 100 * 10_000, n))
            .collect();
        let known = Known { dbc: Some(Dbc::parse(dbc, "dbc").unwrap()), ..Known::default() };
        let columns = read(log.as_bytes(), &known).unwrap();
        assert_eq!(names(&columns), [("can0", "Valve.Command", Some("%"))]);
        assert_eq!(columns.rate_hz, 100.0);
        assert_eq!(columns.columns[0].values[150], 15.0);
        assert_eq!(
            read(log.as_bytes(), &Known::default()).unwrap_err(),
            "log: this is a CAN log; name the DBC file that describes its frames, so that their signals can be seen"
        );
    }

    #[test]
    fn slower_topics_are_held_over_the_grid() {
        let columns = read(&two_topics(), &Known::default()).unwrap();
        assert_eq!(names(&columns), [("/valve", "u", None), ("/oil", "p_bar", Some("bar"))]);
        assert_eq!(columns.rate_hz, 1000.0);
        let [valve, oil] = [&columns.columns[0].values, &columns.columns[1].values];
        assert_eq!(valve.len(), 1000);
        assert_eq!((valve[7], valve[993]), (7.0, 993.0));
        assert_eq!((oil[99], oil[100], oil[340]), (0.0, 1.0, 3.0));
        // Its fourth message is the last: after 2.5 periods it is no longer known.
        assert_eq!((oil[300 + 250], oil[300 + 251].is_nan()), (3.0, true));
    }

    /// `/valve` at 1 kHz for a second, `/oil` at 10 Hz for the first 0.4 s.
    fn two_topics() -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        let mut writer = mcap::Writer::new(&mut bytes).unwrap();
        let topics: Vec<u16> = ["/valve", "/oil"]
            .map(|topic| writer.add_channel(0, topic, "json", &Default::default()).unwrap())
            .into();
        let mut write = |topic: u16, at_ms: u64, text: String| {
            let time = at_ms * 1_000_000;
            let header = mcap::records::MessageHeader {
                channel_id: topic,
                sequence: 0,
                log_time: time,
                publish_time: time,
            };
            writer.write_to_known_channel(&header, text.as_bytes()).unwrap();
        };
        for n in 0..1000 {
            write(topics[0], n, format!("{{\"u\":{n}}}"));
            if n % 100 == 0 && n < 400 {
                write(topics[1], n, format!("{{\"p_bar\":{}}}", n / 100));
            }
        }
        writer.finish().unwrap();
        drop(writer);
        bytes.into_inner()
    }
}

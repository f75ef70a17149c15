//! A folder, a bag or a pattern as one log: its files, one after the other.

use std::cmp::Ordering;
use std::fs;
use std::path::{Path, PathBuf};

use seepd_signals::Sample;

use crate::error::LogError;
use crate::far;
use crate::mapping::LogMapping;
use crate::record::Clock;
use crate::source::{Source, log_name, open_file};

/// Endings of logs' names, without those of archives.
const ENDINGS: &[&str] = &["mcap", "db3", "csv", "tsv", "txt", "log", "asc", "blf", "trc", "mf4", "mdf"];
/// Endings of the logs of a bag, beside which other files may lie.
const BAG_ENDINGS: &[&str] = &["mcap", "db3"];
/// What tells a bag's folder.
const BAG_FILE: &str = "metadata.yaml";

/// The logs that a path names: those of a folder or of a pattern, here or in S3, by their names, numbers in them by size; else the path
/// itself.
///
/// # Errors
/// [`LogError`] where a folder has no log, nothing fits a pattern, or a server cannot be asked.
pub fn logs_of(path: &Path) -> Result<Vec<PathBuf>, LogError> {
    let name = log_name(path);
    let found = if far::is_series(path) {
        let files = far::files_of(path)?;
        if far::is_folder(path) { logs_among(files) } else { files }
    } else if path.is_dir() {
        let files: Result<Vec<PathBuf>, std::io::Error> =
            fs::read_dir(path).and_then(|entries| entries.map(|entry| Ok(entry?.path())).collect());
        let files = files.map_err(|error| LogError::reading(&name, error))?;
        logs_among(files.into_iter().filter(|file| file.is_file()).collect())
    } else if is_pattern(path) {
        let paths =
            glob::glob(&name).map_err(|error| LogError::data(&name, format!("as a pattern: {error}")))?;
        paths.filter_map(Result::ok).filter(|file| file.is_file()).collect()
    } else {
        return Ok(vec![path.to_owned()]);
    };
    sorted(found).ok_or(LogError::NoLogs { name })
}

/// Those of a folder's files that are logs, by their names; in a bag's folder, those of the bag.
fn logs_among(mut files: Vec<PathBuf>) -> Vec<PathBuf> {
    let is_bag = files.iter().any(|file| file.file_name().is_some_and(|name| name == BAG_FILE));
    let endings = if is_bag { BAG_ENDINGS } else { ENDINGS };
    files.retain(|file| has_ending(file, endings));
    files
}

fn sorted(mut found: Vec<PathBuf>) -> Option<Vec<PathBuf>> {
    found.sort_by(|a, b| natural_order(&a.to_string_lossy(), &b.to_string_lossy()));
    (!found.is_empty()).then_some(found)
}

/// Bytes of the files that a path names; 0 for what has no length, or is far away.
pub fn bytes_of(path: &Path) -> u64 {
    if far::is_address(path) {
        return 0;
    }
    let logs = logs_of(path).unwrap_or_default();
    logs.iter().filter_map(|log| fs::metadata(log).ok()).map(|facts| facts.len()).sum()
}

/// Whether a path stands for several files.
pub(crate) fn is_series(path: &Path) -> bool {
    far::is_series(path) || path.is_dir() || is_pattern(path)
}

/// Whether it is a pattern: a file of that very name goes before.
fn is_pattern(path: &Path) -> bool {
    let text = path.to_string_lossy();
    text.contains(far::WILDCARDS) && !far::is_address(path) && !path.exists()
}

fn has_ending(path: &Path, endings: &[&str]) -> bool {
    let name = path.file_name().map(|name| name.to_string_lossy().to_lowercase()).unwrap_or_default();
    let name = name
        .strip_suffix(".gz")
        .or_else(|| name.strip_suffix(".zst"))
        .or_else(|| name.strip_suffix(".zstd"))
        .unwrap_or(&name);
    !name.starts_with('.') && name.rsplit_once('.').is_some_and(|(_, ending)| endings.contains(&ending))
}

/// As a person would sort: `log_2` before `log_10`.
fn natural_order(a: &str, b: &str) -> Ordering {
    let (mut a_rest, mut b_rest) = (a, b);
    loop {
        let ((a_number, a_text), (b_number, b_text)) = (split_number(a_rest), split_number(b_rest));
        let by_number = match (a_number, b_number) {
            (Some(a), Some(b)) => {
                let (a, b) = (a.trim_start_matches('0'), b.trim_start_matches('0'));
                a.len().cmp(&b.len()).then(a.cmp(b))
            }
            _ => Ordering::Equal,
        };
        if by_number != Ordering::Equal {
            return by_number;
        }
        if a_number.is_none() || b_number.is_none() {
            let (a_char, b_char) = (a_rest.chars().next(), b_rest.chars().next());
            match (a_char, b_char) {
                (Some(x), Some(y)) if x == y => {
                    (a_rest, b_rest) = (&a_rest[x.len_utf8()..], &b_rest[y.len_utf8()..]);
                    continue;
                }
                (None, None) => return a.cmp(b),
                _ => return a_char.cmp(&b_char),
            }
        }
        (a_rest, b_rest) = (a_text, b_text);
    }
}

fn split_number(text: &str) -> (Option<&str>, &str) {
    let end = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
    let (number, rest) = text.split_at(end);
    ((end > 0).then_some(number), rest)
}

/// Logs of one machine, one after the other. One that cannot be read is left out, and told of; where none can be read, the first says why.
pub(crate) struct Series<F> {
    /// The next ones last.
    rest: Vec<PathBuf>,
    mapping: LogMapping,
    on_bytes: F,
    clock: Clock,
    current: Option<(String, Box<dyn Source + Send>)>,
    notes: Vec<String>,
    failed: Option<LogError>,
    given: bool,
}

impl<F: FnMut(u64) + Clone + Send + 'static> Series<F> {
    pub(crate) fn new(mut logs: Vec<PathBuf>, mapping: &LogMapping, on_bytes: F) -> Self {
        logs.reverse();
        Series {
            rest: logs,
            mapping: mapping.clone(),
            on_bytes,
            clock: Clock::default(),
            current: None,
            notes: Vec::new(),
            failed: None,
            given: false,
        }
    }

    /// Goes on to the next log; `false` where there is none.
    fn open_next(&mut self) -> Result<bool, LogError> {
        while let Some(path) = self.rest.pop() {
            self.clock.begin(&path);
            match open_file(&path, &self.mapping, self.on_bytes.clone()) {
                Ok(source) => {
                    self.current = Some((log_name(&path), source));
                    return Ok(true);
                }
                Err(error) => self.leave_out(error)?,
            }
        }
        Ok(false)
    }

    /// Notes a log that cannot be read, unless it is the mapping that fits none.
    fn leave_out(&mut self, error: LogError) -> Result<(), LogError> {
        if matches!(error, LogError::Mapping { .. } | LogError::Dbc { .. }) {
            return Err(error);
        }
        self.notes.push(format!("{error}; the log was left out from there on"));
        self.failed.get_or_insert(error);
        Ok(())
    }

    fn end_current(&mut self) {
        if let Some((name, source)) = self.current.take() {
            self.notes.extend(source.notes());
            self.notes.extend(self.clock.note(&name));
        }
    }
}

impl<F: FnMut(u64) + Clone + Send + 'static> Source for Series<F> {
    fn next_sample(&mut self) -> Result<Option<Sample>, LogError> {
        loop {
            let Some((_, source)) = &mut self.current else {
                if self.open_next()? {
                    continue;
                }
                return match self.failed.take() {
                    Some(error) if !self.given => Err(error),
                    _ => Ok(None),
                };
            };
            match source.next_sample() {
                Ok(Some(mut sample)) => {
                    sample.time_ns = self.clock.in_one_record(sample.time_ns);
                    self.given = true;
                    return Ok(Some(sample));
                }
                Ok(None) => self.end_current(),
                Err(error) => {
                    self.end_current();
                    self.leave_out(error)?;
                }
            }
        }
    }

    fn notes(&self) -> Vec<String> {
        let of_current = self.current.iter().flat_map(|(_, source)| source.notes());
        self.notes.iter().cloned().chain(of_current).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_in_names_are_sorted_by_size() {
        let mut names = ["b10", "b2", "a", "b02", "b", "10", "9", "b2a"];
        names.sort_by(|a, b| natural_order(a, b));
        assert_eq!(names, ["9", "10", "a", "b", "b02", "b2", "b2a", "b10"]);
    }

    #[test]
    fn a_folder_has_its_logs_and_a_bag_its_own() {
        let folder = tempfile::tempdir().unwrap();
        let place = |name: &str| folder.path().join(name);
        let names = |found: Vec<PathBuf>| -> Vec<String> {
            found.iter().map(|path| path.file_name().unwrap().to_string_lossy().into_owned()).collect()
        };
        assert!(matches!(logs_of(folder.path()), Err(LogError::NoLogs { .. })));
        for name in ["x_10.mcap", "x_2.mcap.zst", "README.md", ".hidden.csv", "a.csv.gz", "x_1.db3"] {
            fs::write(place(name), "t_s,command\n").unwrap();
        }
        assert_eq!(
            names(logs_of(folder.path()).unwrap()),
            ["a.csv.gz", "x_1.db3", "x_2.mcap.zst", "x_10.mcap"]
        );
        assert_eq!(names(logs_of(&place("x_*.mcap*")).unwrap()), ["x_2.mcap.zst", "x_10.mcap"]);
        assert!(matches!(logs_of(&place("y*")), Err(LogError::NoLogs { .. })));
        fs::write(place(BAG_FILE), "").unwrap();
        assert_eq!(names(logs_of(folder.path()).unwrap()), ["x_1.db3", "x_2.mcap.zst", "x_10.mcap"]);
        assert_eq!(logs_of(&place("none.csv")).unwrap(), [place("none.csv")]);
        assert_eq!(bytes_of(&place("x_*")), 36);
    }
}

//! What a person asks an axis for, and why it may not be taken.

use std::fmt;

use seepd_monitor::repair::{Repair, RepairKind};
use serde::Deserialize;

use crate::repair_log;

/// What an axis is asked for.
#[derive(Debug)]
pub enum Order {
    /// Take note of the latched flag.
    Acknowledge(Signature),
    /// Learn a new baseline from the next cycles: the seal has been replaced.
    Renew,
    /// Note that something was done to the machine.
    Repair(NewRepair),
}

/// Who takes note of a flag, as people say it themselves.
#[derive(Debug, Clone, Default, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Signature {
    /// Name.
    pub who: Option<String>,
    /// What else there is to say.
    pub note: Option<String>,
}

impl Signature {
    /// Reads one from JSON; nothing at all is nobody's.
    ///
    /// # Errors
    /// One line that says what is wrong with it.
    pub fn from_json(bytes: &[u8]) -> Result<Self, String> {
        if bytes.iter().all(u8::is_ascii_whitespace) {
            return Ok(Signature::default());
        }
        if bytes.len() > LONGEST_ENTRY {
            return Err(format!("an acknowledgement has {LONGEST_ENTRY} bytes at most"));
        }
        let mut signature: Signature =
            serde_json::from_slice(bytes).map_err(|error| format!("this is no acknowledgement: {error}"))?;
        said(&mut signature.who);
        said(&mut signature.note);
        repair_log::check_texts(signature.who.as_deref(), signature.note.as_deref())?;
        Ok(signature)
    }
}

/// A form's empty field says nothing.
fn said(text: &mut Option<String>) {
    *text = text.take().filter(|text| !text.trim().is_empty());
}

/// An entry for the repair log, as a person gives it.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NewRepair {
    /// What was done.
    pub what: RepairKind,
    /// When, as in the file; absent: now.
    pub at: Option<String>,
    /// Who did it.
    pub who: Option<String>,
    /// What else there is to say.
    pub note: Option<String>,
}

/// Longest entry that is read, bytes.
const LONGEST_ENTRY: usize = 4096;

impl NewRepair {
    /// Reads an entry from JSON.
    ///
    /// # Errors
    /// One line that says what is wrong with it.
    pub fn from_json(bytes: &[u8]) -> Result<Self, String> {
        if bytes.len() > LONGEST_ENTRY {
            return Err(format!("an entry has {LONGEST_ENTRY} bytes at most"));
        }
        let mut entry: NewRepair =
            serde_json::from_slice(bytes).map_err(|error| format!("this is no entry: {error}"))?;
        [&mut entry.at, &mut entry.who, &mut entry.note].into_iter().for_each(said);
        repair_log::check_texts(entry.who.as_deref(), entry.note.as_deref())?;
        entry.at.as_deref().map_or(Ok(0), repair_log::parse_time)?;
        Ok(entry)
    }

    /// The entry, of a time that is now unless it names another.
    pub fn at(self, now_ns: i64) -> Repair {
        let NewRepair { what, at, who, note } = self;
        let named = at.and_then(|text| repair_log::parse_time(&text).ok());
        Repair { at_ns: named.unwrap_or(now_ns), what, who, note }
    }
}

/// Why an order was not taken.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum NotTaken {
    /// There is no axis of that name.
    NoAxis {
        /// The name.
        axis: String,
        /// Those that there are.
        axes: Vec<String>,
    },
    /// The axis could not be started, or its log has ended.
    NotRunning {
        /// Name.
        axis: String,
        /// What keeps it.
        why: String,
    },
    /// As many orders as are kept for it wait already.
    Busy {
        /// Name.
        axis: String,
    },
}

impl fmt::Display for NotTaken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            NotTaken::NoAxis { axis, axes } => {
                write!(f, "there is no axis {axis}; the axes are {}", axes.join(", "))
            }
            NotTaken::NotRunning { axis, why } => write!(f, "the axis {axis} does not run: {why}"),
            NotTaken::Busy { axis } => {
                write!(f, "the axis {axis} has not carried out its last orders yet; try again")
            }
        }
    }
}

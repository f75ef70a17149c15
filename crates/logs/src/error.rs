//! Why a log cannot be read.

use std::io;

/// Why a log, or a file beside it, cannot be read. Each message is one line that begins with the file's name.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LogError {
    /// The log, or its DBC file, cannot be opened or read.
    #[error("{name}: {error}")]
    Reading {
        /// File.
        name: String,
        /// What the operating system says.
        #[source]
        error: io::Error,
    },
    /// A folder has no log, or nothing fits a pattern.
    #[error("{name}: there is no log of that name or in that folder")]
    NoLogs {
        /// Folder or pattern.
        name: String,
    },
    /// It is no log of a kind that is read, or nothing in it can be used.
    #[error("{name}: {what}")]
    Data {
        /// Log.
        name: String,
        /// What is wrong, and what to do.
        what: String,
    },
    /// The DBC file cannot be understood.
    #[error("{name}: {what}")]
    Dbc {
        /// DBC file.
        name: String,
        /// Line, column, and what was expected there.
        what: String,
    },
    /// The mapping does not say where a signal is, or says it twice.
    #[error("{what}")]
    Mapping {
        /// The key, and what is wrong with it.
        what: String,
    },
}

impl LogError {
    pub(crate) fn reading(name: impl Into<String>, error: io::Error) -> Self {
        LogError::Reading { name: name.into(), error }
    }

    pub(crate) fn data(name: impl Into<String>, what: impl Into<String>) -> Self {
        LogError::Data { name: name.into(), what: what.into() }
    }

    pub(crate) fn mapping(what: impl Into<String>) -> Self {
        LogError::Mapping { what: what.into() }
    }
}

/// The first of some names for a message of one line, and how many more there are.
pub(crate) fn listed(names: &[impl AsRef<str>], told: usize) -> String {
    let first = names.iter().take(told).map(AsRef::as_ref).collect::<Vec<&str>>().join(", ");
    match names.len().saturating_sub(told) {
        0 => first,
        more => format!("{first} and {more} more"),
    }
}

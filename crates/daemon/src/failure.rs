//! What ends the program, and with which exit code.

use std::fmt;
use std::io;
use std::path::Path;

use seepd_features::ReaderError;
use seepd_logs::LogError;

/// Exit codes: an interface, after sysexits.h.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Code {
    /// A finding, where `--fail-on-fault` asks for one.
    Finding = 1,
    /// Wrong use of the command line.
    Usage = 64,
    /// Data that cannot be read.
    Data = 65,
    /// Input that is not there.
    NoInput = 66,
    /// A fault of the program.
    Internal = 70,
    /// Reading or writing failed.
    Io = 74,
    /// Another process holds what is needed; later it may be free.
    Temporary = 75,
    /// A configuration, plant or model file that is wrong.
    Configuration = 78,
}

impl Code {
    /// Of a file that could not be opened or read.
    fn of_reading(error: &io::Error) -> Self {
        if error.kind() == io::ErrorKind::NotFound { Code::NoInput } else { Code::Io }
    }
}

/// Why the program ends early: one line for a person, one code for a program.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Failure {
    /// Exit code.
    pub code: Code,
    /// What, where, what to do.
    pub message: String,
}

impl Failure {
    /// A failure of that kind.
    pub fn new(code: Code, message: impl Into<String>) -> Self {
        Failure { code, message: message.into() }
    }

    /// Unreadable data.
    pub fn data(message: impl Into<String>) -> Self {
        Failure::new(Code::Data, message)
    }

    /// A file that could not be opened or read.
    pub fn reading(path: &Path, error: &io::Error) -> Self {
        Failure::new(Code::of_reading(error), format!("{}: {error}", path.display()))
    }

    /// A file that could not be written.
    pub fn writing(path: &Path, error: impl fmt::Display) -> Self {
        Failure::new(Code::Io, format!("writing {}: {error}", path.display()))
    }

    /// A configuration file that is wrong.
    pub fn configuration(path: &Path, error: impl fmt::Display) -> Self {
        Failure::new(Code::Configuration, format!("{}: {error}", path.display()))
    }
}

impl From<ReaderError> for Failure {
    /// A model's own check rules it out.
    fn from(error: ReaderError) -> Self {
        Failure::new(Code::Internal, error.to_string())
    }
}

impl From<LogError> for Failure {
    /// A log that is not there is no input, a mapping that fits nothing a fault of the configuration.
    fn from(error: LogError) -> Self {
        let code = match &error {
            LogError::Reading { error, .. } => Code::of_reading(error),
            LogError::NoLogs { .. } => Code::NoInput,
            LogError::Dbc { .. } | LogError::Mapping { .. } => Code::Configuration,
            _ => Code::Data,
        };
        Failure::new(code, error.to_string())
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for Failure {}

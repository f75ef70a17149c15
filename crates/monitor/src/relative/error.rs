//! Why a machine cannot be watched without a model.

use super::LEAST_CYCLES;
use seepd_features::ReaderError;

/// Why there is no relative baseline, or a file of one cannot be used. Messages of files are the rest of a sentence that begins with
/// the file's name.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RelativeError {
    /// No pattern of the command came back often enough.
    #[error("no duty cycle was found in the command: it must come back five times with at least two strokes")]
    NoCycle,
    /// Too few cycles could be used.
    #[error(
        "there are {usable} usable cycles; a baseline needs {LEAST_CYCLES} beyond the five that show the duty cycle, and 50 are better"
    )]
    TooFewCycles {
        /// How many could.
        usable: usize,
    },
    /// Too few of the cycles are alike.
    #[error(
        "{unlike} of {cycles} cycles differ from the others; a baseline needs {LEAST_CYCLES} alike: is it one duty cycle?"
    )]
    TooFewAlike {
        /// Cycles in all.
        cycles: usize,
        /// Those that are unlike the others.
        unlike: usize,
    },
    /// The text is not JSON of that form.
    #[error("this is not a baseline of an axis without a model: {0}")]
    NotABaseline(#[from] serde_json::Error),
    /// Another version wrote it.
    #[error("its schema is {schema}; an axis without a model (`monitor.kind = \"relative\"`) reads {read}")]
    OtherVersion {
        /// The file's.
        schema: String,
        /// This version's.
        read: &'static str,
    },
    /// It is another axis's.
    #[error("this is the baseline of axis {of}, not of {wanted}")]
    OtherAxis {
        /// Whose it is.
        of: String,
        /// Whose was asked for.
        wanted: String,
    },
    /// Numbers make no sense.
    #[error("{what}")]
    Values {
        /// The key, and what it must be.
        what: &'static str,
    },
    /// The reader has no room for the duty cycle.
    #[error("{0}")]
    Reader(#[from] ReaderError),
}

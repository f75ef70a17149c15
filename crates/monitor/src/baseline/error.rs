//! Why there is no baseline.

use super::LEAST_CYCLES;

/// Why a baseline cannot be learned, or a file of baselines cannot be used. Messages of files are the rest of a sentence that
/// begins with the file's name.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BaselineError {
    /// The model compares with no baseline.
    #[error("the model has no estimates relative to a baseline; train it again: seepd train")]
    CannotCompare,
    /// Too few cycles could be used.
    #[error("there are {usable} usable cycles; a baseline needs {LEAST_CYCLES}, and 50 are better")]
    TooFewCycles {
        /// How many could.
        usable: usize,
    },
    /// Too few of the cycles are alike.
    #[error(
        "{unlike} of {cycles} cycles differ from the others more than any load, oil or leak explains; a baseline needs \
         {LEAST_CYCLES} alike: is it one duty cycle?"
    )]
    TooFewAlike {
        /// Cycles in all.
        cycles: usize,
        /// Those that are unlike the others.
        unlike: usize,
    },
    /// The text is not JSON of that form.
    #[error("this is not a baseline: {0}")]
    NotABaseline(#[from] serde_json::Error),
    /// Another version wrote it.
    #[error("its schema is {schema}; this version reads {read}")]
    OtherVersion {
        /// The file's.
        schema: String,
        /// This version's.
        read: &'static str,
    },
    /// Another model learned it.
    #[error("it was learned with another model; learn it again with this one: seepd learn-baseline")]
    OtherModel,
    /// It is another axis's.
    #[error("this is the baseline of axis {of}, not of {wanted}")]
    OtherAxis {
        /// Whose it is.
        of: String,
        /// Whose was asked for.
        wanted: String,
    },
    /// A phase's numbers make no sense.
    #[error("baselines: {key} must have {phases} values within full command")]
    PhaseValues {
        /// `mean` or `deviation`.
        key: &'static str,
        /// The model's phases.
        phases: usize,
    },
    /// Deviations or noise make no sense.
    #[error("baselines: deviations and noise must be finite and not negative")]
    Deviations,
    /// The load makes no sense.
    #[error("baselines: load_n must be null, or at least {least_n} N")]
    Load {
        /// Smallest load that is a measure of others, N.
        least_n: f64,
    },
}

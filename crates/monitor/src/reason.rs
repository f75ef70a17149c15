//! Names of the reasons for which there is no estimate: an interface, like the names of flags. What they mean and what helps is told
//! by whoever knows the user's files and commands.

use seepd_features::Reason;

/// No duty cycle has ended since the start.
pub const NO_CYCLE_YET: &str = "no_cycle_yet";
/// No duty cycle is found in a command that moves.
pub const NO_CYCLE_FOUND: &str = "no_cycle_found";
/// No command comes.
pub const STALE: &str = "stale";
/// Estimates lie above a threshold, and too few of them are there to raise a flag.
pub const UNCONFIRMED: &str = "unconfirmed";
/// Cycles differ from the baseline as nothing in training does.
pub const UNLIKE_BASELINE: &str = "unlike_baseline";
/// Cycles without a baseline are like no machine of training.
pub const UNLIKE_TRAINING: &str = "unlike_training";
/// Too few of a record's cycles have an estimate for a size.
pub const TOO_FEW_ESTIMATES: &str = "too_few_estimates";

/// The cycles so far are to become the baseline of an axis without a model.
pub const LEARNING_BASELINE: &str = "learning_baseline";
/// The axis has no model, which alone can tell sizes.
pub const NO_PLANT_MODEL: &str = "no_plant_model";

/// Every reason that this crate and the one that reads cycles give.
pub const ALL: [&str; 17] = [
    Reason::Incomplete.name(),
    Reason::Gap.name(),
    Reason::Duplicate.name(),
    Reason::OutOfOrder.name(),
    Reason::NotANumber.name(),
    Reason::OutOfRange.name(),
    Reason::Stuck.name(),
    Reason::WrongRate.name(),
    NO_CYCLE_YET,
    NO_CYCLE_FOUND,
    STALE,
    UNCONFIRMED,
    UNLIKE_BASELINE,
    UNLIKE_TRAINING,
    TOO_FEW_ESTIMATES,
    LEARNING_BASELINE,
    NO_PLANT_MODEL,
];

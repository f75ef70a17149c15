//! What a person asks an axis for, and why it may not be taken.

use std::fmt;

/// What an axis is asked for.
#[derive(Debug)]
pub enum Order {
    /// Take note of the latched flag.
    Acknowledge,
    /// Learn a new baseline from the next cycles: the seal has been replaced.
    Renew,
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

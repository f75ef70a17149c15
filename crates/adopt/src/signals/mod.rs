//! Which column of a log is which signal.

//! Why a model is refused.

use alloc::string::String;
use core::fmt;

use seepd_features::Feature;

use crate::check::MAX_FILE_BYTES;
use crate::schema::{READ_SCHEMAS, SCHEMA};

/// Why a model is refused. A `path` is a JSON path, such as `trees[3].right[7]`.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum ModelError {
    /// The file is longer than [`MAX_FILE_BYTES`].
    TooLong {
        /// Its length, bytes.
        bytes: usize,
    },
    /// Not JSON, or JSON of another structure.
    Json {
        /// Where; empty or `.` for the file as a whole.
        path: String,
        /// What the parser says.
        message: String,
    },
    /// A file of another schema than [`READ_SCHEMAS`].
    Schema {
        /// Its schema.
        given: String,
    },
    /// A model of something else than `leak_area` in `m2`.
    Target {
        /// What it estimates.
        target: String,
        /// In which unit.
        unit: String,
    },
    /// A number, or a length, outside of its range.
    OutOfRange {
        /// Where.
        path: String,
        /// The number.
        value: f64,
        /// Least admitted.
        low: f64,
        /// Largest admitted.
        high: f64,
    },
    /// A number that is infinite or not a number.
    NotFinite {
        /// Where.
        path: String,
        /// The number.
        value: f64,
    },
    /// A number that is not larger than the one before it in a list that ascends.
    NotAscending {
        /// Where.
        path: String,
        /// The number.
        value: f64,
    },
    /// A list of another length than the rest of the model asks for.
    Length {
        /// Where.
        path: String,
        /// Its length.
        given: usize,
        /// The length that it must have.
        expected: usize,
    },
    /// A list without entries.
    Empty {
        /// Where.
        path: String,
    },
    /// The second anchor does not end after the first.
    AnchorOrder {
        /// End of the first, s.
        first_s: f64,
        /// End of the second, s.
        second_s: f64,
    },
    /// Two phases of one name.
    RepeatedPhase {
        /// Where the second is.
        path: String,
        /// The name.
        name: String,
    },
    /// A feature that does not exist.
    UnknownFeature {
        /// Where.
        path: String,
        /// Its name.
        name: String,
    },
    /// A list of nodes that is no tree in preorder.
    Tree {
        /// The entry that shows it.
        path: String,
        /// What is wrong with it.
        fault: TreeFault,
    },
    /// A golden pair whose output the model does not give.
    Golden {
        /// Which pair.
        path: String,
        /// The output in the file.
        expected: f64,
        /// What the model gives.
        given: f64,
    },
}

/// What makes a list of nodes no tree in preorder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum TreeFault {
    /// A node asks by a feature that the model lacks.
    Feature {
        /// Its index.
        feature: i32,
        /// How many there are.
        features: usize,
    },
    /// A right child before its parent's left one, or beyond the last node: the tree would loop, or lead nowhere.
    ChildOutOfRange {
        /// Index of the child.
        right: usize,
        /// Least admitted.
        low: usize,
        /// Number of nodes: the child must lie below it.
        nodes: usize,
    },
    /// A right child that is not the node after the left subtree.
    MisplacedChild {
        /// Index of the child.
        right: usize,
        /// Index that it must have.
        expected: usize,
    },
    /// A right child at which no subtree begins.
    MissingChild {
        /// Index of the child.
        right: usize,
    },
    /// A node to which no other leads.
    Unreachable,
    /// The last node is not a leaf.
    EndsWithoutLeaf,
}

impl ModelError {
    /// JSON path of what is wrong; empty for the file as a whole.
    pub fn path(&self) -> &str {
        match self {
            ModelError::TooLong { .. } => "",
            ModelError::Schema { .. } => "schema",
            ModelError::Target { .. } => "target",
            ModelError::AnchorOrder { .. } => "cycle.anchors[1].end_s",
            ModelError::Json { path, .. } if path == "." => "",
            ModelError::Json { path, .. }
            | ModelError::OutOfRange { path, .. }
            | ModelError::NotFinite { path, .. }
            | ModelError::NotAscending { path, .. }
            | ModelError::Length { path, .. }
            | ModelError::Empty { path }
            | ModelError::RepeatedPhase { path, .. }
            | ModelError::UnknownFeature { path, .. }
            | ModelError::Tree { path, .. }
            | ModelError::Golden { path, .. } => path,
        }
    }
}

impl fmt::Display for ModelError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("model: ")?;
        if !self.path().is_empty() {
            write!(f, "{}: ", self.path())?;
        }
        match self {
            ModelError::TooLong { bytes } => write!(f, "{bytes} bytes; at most {MAX_FILE_BYTES} are read"),
            ModelError::Json { message, .. } => f.write_str(message),
            ModelError::Schema { given } => {
                write!(f, "is `{given}`; this program reads `{SCHEMA}` and `{}`", READ_SCHEMAS[0])
            }
            ModelError::Target { target, unit } => {
                write!(f, "is `{target}` in `{unit}`; this program knows `leak_area` in `m2`")
            }
            ModelError::OutOfRange { value, low, high, .. } => {
                write!(f, "is {value}; it must lie in {low} … {high}")
            }
            ModelError::NotFinite { value, .. } => write!(f, "is {value}; it must be a finite number"),
            ModelError::NotAscending { value, .. } => {
                write!(f, "is {value}; it must be larger than the one before it")
            }
            ModelError::Length { given, expected, .. } => {
                write!(f, "has {given} values; it must have {expected}")
            }
            ModelError::Empty { .. } => f.write_str("is empty"),
            ModelError::AnchorOrder { first_s, second_s } => {
                write!(f, "is {second_s}; it must be later than that of anchors[0], {first_s}")
            }
            ModelError::RepeatedPhase { name, .. } => write!(f, "another phase is named `{name}` already"),
            ModelError::UnknownFeature { name, .. } => unknown_feature(f, name),
            ModelError::Tree { fault, .. } => fault.fmt(f),
            ModelError::Golden { expected, given, .. } => {
                write!(
                    f,
                    "expects {expected:e}, the model gives {given:e}: the file was altered or is damaged"
                )
            }
        }
    }
}

fn unknown_feature(f: &mut fmt::Formatter<'_>, name: &str) -> fmt::Result {
    write!(f, "unknown feature `{name}`; known are ")?;
    for known in Feature::names() {
        write!(f, "{known}, ")?;
    }
    f.write_str("mean.PHASE, slope.PHASE, relative.PHASE and the projections")
}

impl fmt::Display for TreeFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            TreeFault::Feature { feature, features } => {
                write!(f, "is {feature}; there are {features} features")
            }
            TreeFault::ChildOutOfRange { right, low, nodes } => write!(
                f,
                "is {right}; it must lie in {low} … {}: children follow their parent, or the tree would loop",
                nodes.saturating_sub(1)
            ),
            TreeFault::MisplacedChild { right, expected } => {
                write!(f, "is {right}; the left subtree ends before {expected}, so it must be {expected}")
            }
            TreeFault::MissingChild { right } => write!(f, "is {right}; no subtree begins there"),
            TreeFault::Unreachable => f.write_str("no node leads here"),
            TreeFault::EndsWithoutLeaf => f.write_str("the last node must be a leaf"),
        }
    }
}

impl core::error::Error for ModelError {}

//! The blind check of the gap's diagnosis: a second simulator plants causes, and answers are scored against what it planted.
//!
//! [`press`] is a machine of its own: the equations of the press written once more, in scalars, with another integrator, another step, and
//! its own laws, a third of them other laws than the catalogue's. [`cause`] draws what is planted, [`foreign`] are causes that the
//! catalogue has no name for, [`score`] compares answers with the truth. Nothing here is used by a diagnosis.

pub mod cause;
pub mod foreign;
pub mod press;
pub mod score;

pub use cause::{Case, Set, Truth, draw};
pub use press::{Press, Sample};

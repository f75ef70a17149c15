#![doc = include_str!("../README.md")]

pub mod axis;
pub mod cause;
pub mod change;
pub mod foreign;
pub mod press;
pub mod score;

pub use cause::{Case, Set, Truth, draw};
pub use press::{Press, PressSample};

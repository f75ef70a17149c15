#![doc = include_str!("../README.md")]

mod instance;
mod three;
mod two;

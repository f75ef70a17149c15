//! The simulated axis: hydraulic plant, 1 kHz PID controller, duty cycle and the catalogue of effects.
//!
//! The plant is the one of the article "Characterization of Leakage Fault in Hydraulic Cylinders
//! Leading to Sustainable Maintenance Planning of Equipment", equations (1)–(5), with the corrections
//! that [`plant`] lists. One source of equations, generic over [`Real`], serves both ways of running it:
//! a scalar machine ([`Machine<f64>`]) and many machines side by side in SIMD lanes ([`batch`]).
//! Whatever the plant does not say is an *effect* ([`effects`]), off unless the machine's file asks for it.
//!
//! Everything is in SI units; pressures are gauge.

pub mod batch;
pub mod controller;
pub mod cycle;
pub mod effects;
pub mod electric;
pub mod machine;
pub mod noise;
pub mod oil;
pub mod plant;
pub mod real;
pub mod series;
pub mod simd;
pub mod spec;

pub use controller::Controller;
pub use cycle::{DutyCycle, Schedule};
pub use machine::{Input, Machine, MachineState, SimulatedSignals};
pub use plant::{Plant, PlantParameters, State};
pub use real::{Lanes, Real};
pub use spec::{MachineSpec, SpecError};

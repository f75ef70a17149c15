#![doc = include_str!("../README.md")]
#![no_std]

use serde::{Deserialize, Serialize};

/// A signal of one machine axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[repr(u8)]
pub enum Signal {
    /// PID valve command, share of full command, −1 … 1; positive extends. All that monitoring needs.
    Command,
    /// Position demand, m.
    Demand,
    /// Measured position, m; 0 is fully retracted.
    Position,
    /// Supply pressure, gauge, Pa.
    PSupply,
    /// Pressure at the valve's inlet, gauge, Pa.
    PInlet,
    /// Pressure in the cap chamber, gauge, Pa.
    PCap,
    /// Pressure in the rod chamber, gauge, Pa.
    PRod,
    /// Load force, N, positive in the extending direction.
    Load,
    /// Start-of-cycle mark: a rise above 0.5 begins a duty cycle.
    CycleStart,
}

impl Signal {
    /// Every signal, in the order of reports.
    pub const ALL: [Signal; 9] = [
        Signal::Command,
        Signal::Demand,
        Signal::Position,
        Signal::PSupply,
        Signal::PInlet,
        Signal::PCap,
        Signal::PRod,
        Signal::Load,
        Signal::CycleStart,
    ];

    /// The signal's name in logs, mappings and messages.
    pub const fn name(self) -> &'static str {
        match self {
            Signal::Command => "command",
            Signal::Demand => "demand",
            Signal::Position => "position",
            Signal::PSupply => "p_supply",
            Signal::PInlet => "p_inlet",
            Signal::PCap => "p_cap",
            Signal::PRod => "p_rod",
            Signal::Load => "load",
            Signal::CycleStart => "cycle_start",
        }
    }

    /// The signal's SI unit; "1" for shares and marks.
    pub const fn unit(self) -> &'static str {
        match self {
            Signal::Command | Signal::CycleStart => "1",
            Signal::Demand | Signal::Position => "m",
            Signal::PSupply | Signal::PInlet | Signal::PCap | Signal::PRod => "Pa",
            Signal::Load => "N",
        }
    }

    /// The signal of that name, if there is one.
    pub fn from_name(name: &str) -> Option<Signal> {
        Signal::ALL.into_iter().find(|signal| signal.name() == name)
    }
}

/// The signals at one instant. A signal that the source does not have is absent, which is not the
/// same as a reading that is not a number: the former is normal, the latter is counted and reported.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Time, ns: of the source's own clock, with any epoch.
    pub time_ns: i64,
    values: [f64; Signal::ALL.len()],
    present: u16,
}

impl Sample {
    /// A sample without signals.
    pub const fn new(time_ns: i64) -> Self {
        Sample { time_ns, values: [0.0; Signal::ALL.len()], present: 0 }
    }

    /// A sample with the command alone.
    pub fn command(time_ns: i64, command: f64) -> Self {
        let mut sample = Sample::new(time_ns);
        sample.set(Signal::Command, command);
        sample
    }

    /// Sets a signal, in its SI unit.
    pub fn set(&mut self, signal: Signal, value: f64) {
        self.values[signal as usize] = value;
        self.present |= 1 << signal as u16;
    }

    /// The signal's reading in its SI unit, if the source has it.
    pub fn get(&self, signal: Signal) -> Option<f64> {
        (self.present & (1 << signal as u16) != 0).then_some(self.values[signal as usize])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn property_names_are_unique_and_lead_back() {
        for signal in Signal::ALL {
            assert_eq!(Signal::from_name(signal.name()), Some(signal));
        }
    }

    #[test]
    fn property_absent_differs_from_not_a_number() {
        let mut sample = Sample::command(5, f64::NAN);
        assert!(sample.get(Signal::Command).is_some_and(f64::is_nan));
        assert_eq!(sample.get(Signal::Load), None);
        sample.set(Signal::Load, -2000.0);
        assert_eq!(sample.get(Signal::Load), Some(-2000.0));
    }
}

//! What an axis says in diagnostic trouble codes (SAE J1939-73): lamps, active codes (DM1) and those that were active (DM2).

use std::collections::BTreeMap;

use seepd_model::causes::Cause;
use seepd_monitor::cause::course::Severity;
use seepd_monitor::event::Flag;

use crate::hub::AxisStatus;

/// Numbers from the first: the seal's leak, then the causes by their codes in CAN frames, then these two.
const WITHOUT_NAME: u32 = 15;
const NO_COMMAND: u32 = 16;

/// Failure mode identifiers of the standard.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Mode {
    /// 0: data valid but above the normal operating range, most severe level.
    MostSevere = 0,
    /// 9: abnormal update rate.
    UpdateRate = 9,
    /// 15: above the normal range, least severe level.
    LeastSevere = 15,
    /// 16: above the normal range, moderately severe level.
    Moderate = 16,
}

/// A lamp that a code lights: the bit pair's place in the first byte.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Lamp {
    Protect = 0,
    AmberWarning = 2,
    RedStop = 4,
}

/// A code that is active.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Code {
    number: u32,
    mode: Mode,
    lamp: Lamp,
}

/// A code that is or was active.
#[derive(Debug, Clone, Copy)]
struct Known {
    mode: Mode,
    /// Times that it became active, 126 at most; 127 would say that they are not counted.
    times: u8,
    active: bool,
}

/// Most times that are counted.
const MOST_TIMES: u8 = 126;
/// Lamps that flash: none, each pair of bits set.
const NO_FLASHING: u8 = 0xff;

/// What was active since the start, by its number behind the first.
#[derive(Debug, Default)]
pub(super) struct Memory {
    known: BTreeMap<u32, Known>,
}

fn active(status: &AxisStatus) -> Vec<Code> {
    let leak = |mode, lamp| Some(Code { number: 0, mode, lamp });
    let of_flag = match status.flag {
        Flag::NoEstimate | Flag::Healthy => None,
        Flag::Watch => leak(Mode::LeastSevere, Lamp::Protect),
        Flag::Leak => leak(Mode::Moderate, Lamp::AmberWarning),
        Flag::Severe => leak(Mode::MostSevere, Lamp::RedStop),
    };
    let of_causes = status.conditions.iter().filter_map(|one| {
        let number = Cause::ALL.iter().position(|cause| *cause == one.kind.cause)?;
        let number = u32::try_from(number).ok().filter(|number| (1..WITHOUT_NAME).contains(number))?;
        let (mode, lamp) = match one.severity {
            Severity::Matters => (Mode::Moderate, Lamp::AmberWarning),
            _ => (Mode::LeastSevere, Lamp::Protect),
        };
        Some(Code { number, mode, lamp })
    });
    let is_nameless = status.conditions.is_empty() && status.condition.is_some();
    let nameless =
        is_nameless.then_some(Code { number: WITHOUT_NAME, mode: Mode::LeastSevere, lamp: Lamp::Protect });
    let silent = Code { number: NO_COMMAND, mode: Mode::UpdateRate, lamp: Lamp::AmberWarning };
    let silent = status.stale.then_some(silent);
    let mut codes: Vec<Code> = of_flag.into_iter().chain(of_causes).chain(nameless).chain(silent).collect();
    codes.sort_by_key(|code| (code.number, std::cmp::Reverse(code.lamp)));
    codes.dedup_by_key(|code| code.number);
    codes
}

impl Memory {
    /// Takes note of what is active now, and of the latch: a leak that somebody has acknowledged is forgotten.
    pub(super) fn heed(&mut self, status: &AxisStatus) {
        let codes = active(status);
        for (_, known) in
            self.known.iter_mut().filter(|(number, _)| !codes.iter().any(|code| code.number == **number))
        {
            known.active = false;
        }
        for code in &codes {
            let before = self.known.get(&code.number).copied();
            let times = before.map_or(0, |before| before.times);
            let is_new = before.is_none_or(|before| !before.active);
            let times = if is_new { (times + 1).min(MOST_TIMES) } else { times };
            self.known.insert(code.number, Known { mode: code.mode, times, active: true });
        }
        let leaks = codes.iter().any(|code| code.number == 0);
        match status.latched.filter(|_| !status.acknowledged) {
            Some(latched) if !leaks => {
                let mode = match latched {
                    Flag::Severe => Mode::MostSevere,
                    Flag::Leak => Mode::Moderate,
                    _ => Mode::LeastSevere,
                };
                self.known.entry(0).or_insert(Known { mode, times: 1, active: false });
            }
            None if !leaks => {
                self.known.remove(&0);
            }
            _ => {}
        }
    }

    /// DM1: lamps and active codes.
    pub(super) fn dm1(&self, status: &AxisStatus, first: u32) -> Vec<u8> {
        self.message(status, first, true)
    }

    /// DM2: lamps and codes that were active.
    pub(super) fn dm2(&self, status: &AxisStatus, first: u32) -> Vec<u8> {
        self.message(status, first, false)
    }

    fn message(&self, status: &AxisStatus, first: u32, are_active: bool) -> Vec<u8> {
        let mut data = vec![lamps(status), NO_FLASHING];
        let codes = self.known.iter().filter(|(_, known)| known.active == are_active);
        for (number, Known { mode, times, .. }) in codes {
            let [low, middle, high, _] = (first + number).to_le_bytes();
            data.extend([low, middle, high << 5 | *mode as u8, *times]);
        }
        if data.len() == 2 {
            data.extend([0; 4]);
        }
        data
    }
}

/// The first byte: a pair of bits a lamp, 01 on, 00 off; 11 is "not available", where nothing is known of the seal.
fn lamps(status: &AxisStatus) -> u8 {
    let codes = active(status);
    if codes.is_empty() && status.flag == Flag::NoEstimate {
        return 0xff;
    }
    codes.iter().fold(0, |lamps, code| lamps | 1 << code.lamp as u8)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hub::condition_for_tests;

    const FIRST: u32 = 516_096;

    #[test]
    fn lamps_and_codes_follow_flag_latch_and_causes() {
        let mut memory = Memory::default();
        let mut status = AxisStatus::new("press", 7e6);
        memory.heed(&status);
        assert_eq!(memory.dm1(&status, FIRST), [0xff, 0xff, 0, 0, 0, 0], "nothing is known");
        status.flag = Flag::Healthy;
        memory.heed(&status);
        assert_eq!(memory.dm1(&status, FIRST), [0, 0xff, 0, 0, 0, 0]);
        (status.flag, status.latched) = (Flag::Leak, Some(Flag::Leak));
        memory.heed(&status);
        // 516096 is 0x7e000: three bits of it stand above the mode, 16.
        assert_eq!(memory.dm1(&status, FIRST), [0b0100, 0xff, 0x00, 0xe0, 0b1111_0000, 1]);
        assert_eq!(memory.dm2(&status, FIRST), [0b0100, 0xff, 0, 0, 0, 0]);
        // It gets worse: still the first time. With a cause beside it there are two codes.
        (status.flag, status.latched) = (Flag::Severe, Some(Flag::Severe));
        status.conditions = vec![condition_for_tests()];
        memory.heed(&status);
        let both = [0b1_0001, 0xff, 0x00, 0xe0, 0b1110_0000, 1, 0x03, 0xe0, 0b1110_1111, 1];
        assert_eq!(memory.dm1(&status, FIRST), both);
        // It goes: what was active is told until somebody acknowledges it.
        status.flag = Flag::Healthy;
        status.conditions.clear();
        memory.heed(&status);
        assert_eq!(memory.dm1(&status, FIRST), [0, 0xff, 0, 0, 0, 0]);
        assert_eq!(memory.dm2(&status, FIRST)[2..], both[2..]);
        status.acknowledged = true;
        memory.heed(&status);
        assert_eq!(memory.dm2(&status, FIRST)[2..], both[6..]);
    }

    #[test]
    fn a_latch_of_an_earlier_run_was_active_and_occurrences_are_counted() {
        let mut memory = Memory::default();
        let mut status = AxisStatus::new("press", 7e6);
        status.latched = Some(Flag::Severe);
        memory.heed(&status);
        assert_eq!(memory.dm2(&status, FIRST), [0xff, 0xff, 0x00, 0xe0, 0b1110_0000, 1]);
        for _ in 0..200 {
            status.stale = true;
            memory.heed(&status);
            status.stale = false;
            memory.heed(&status);
        }
        status.stale = true;
        memory.heed(&status);
        assert_eq!(memory.dm1(&status, FIRST), [0b0100, 0xff, 0x10, 0xe0, 0b1110_1001, MOST_TIMES]);
    }
}

//! Alarms beside the truth: delay, and false ones.

use seepd_monitor::event::Flag;
use serde::Serialize;

use super::record::{CycleRecord, MachineRecord};
use super::{Class, Conditions, leaks};

/// What raises an alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Detector {
    /// The sums over cycles against the baseline.
    Sums,
    /// The flag `watch` or a higher one.
    Flags,
}

impl Detector {
    /// Both.
    pub const ALL: [Detector; 2] = [Detector::Sums, Detector::Flags];

    /// What it is called in tables.
    pub fn name(self) -> &'static str {
        match self {
            Detector::Sums => "CUSUM over cycles",
            Detector::Flags => "flag watch or higher",
        }
    }

    /// Whether it is raised after a cycle; `None` where the cycle says nothing.
    fn state(self, cycle: &CycleRecord) -> Option<bool> {
        match self {
            Detector::Sums => cycle.compared.map(|compared| compared.found),
            Detector::Flags => (cycle.flag != Flag::NoEstimate).then_some(cycle.flag >= Flag::Watch),
        }
    }
}

/// A machine whose leak began in its record.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Onset {
    /// Machine.
    pub machine: String,
    /// Cycle in which the leak began, from 0.
    pub cycle: usize,
    /// Largest leak within the cycles in which it is to be found, L/min.
    pub leak_lpm: f64,
    /// Cycles from the onset to the alarm, 1 for the same cycle; null where there was none.
    pub found_after_cycles: Option<usize>,
    /// The truth then, L/min.
    pub found_at_lpm: Option<f64>,
}

/// Leaks of a class.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ClassLine {
    /// Class.
    #[serde(flatten)]
    pub class: Class,
    /// Machines.
    pub machines: usize,
    /// Median of their leaks, L/min.
    pub median_lpm: f64,
    /// Machines of which the leak was found in time.
    pub found: usize,
    /// Median of the cycles to the alarm, over the leaks that were found at some time.
    pub median_cycles: Option<usize>,
}

/// What a detector is worth.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Detection {
    /// Detector.
    pub detector: Detector,
    /// Cycles before an onset of which it said something.
    pub healthy_cycles: usize,
    /// Alarms in them.
    pub false_alarms: usize,
    /// Machines with a false alarm that was still raised when the leak began: they are in no class.
    pub raised_before: usize,
    /// By size.
    pub classes: Vec<ClassLine>,
    /// Median leak of the smallest class of which, as of all larger ones, 95 % were found in time, L/min.
    pub smallest_found_lpm: Option<f64>,
    /// By machine.
    pub onsets: Vec<Onset>,
}

/// Share of a class that has to be found.
const FOUND_SHARE: f64 = 0.95;

/// A machine's course.
#[derive(Default)]
struct Course {
    healthy_cycles: usize,
    false_alarms: usize,
    raised: bool,
    raised_before: bool,
    onset: Option<Onset>,
}

impl Course {
    fn of(record: &MachineRecord, detector: Detector, conditions: &Conditions) -> Self {
        let mut course = Course::default();
        let comparing = |cycle: &CycleRecord| detector != Detector::Sums || cycle.compared.is_some();
        let cycles = record.cycles.iter().enumerate().skip_while(|(_, cycle)| !comparing(cycle));
        for (number, cycle) in cycles {
            let Some(truth_m2) = cycle.truth_m2() else { continue };
            let state = detector.state(cycle);
            if course.onset.is_none() && !leaks(truth_m2, conditions) {
                course.take_healthy(state);
                continue;
            }
            let onset = course.onset.get_or_insert_with(|| Onset {
                machine: record.name.clone(),
                cycle: number,
                leak_lpm: 0.0,
                found_after_cycles: None,
                found_at_lpm: None,
            });
            let leak_lpm = truth_m2 * conditions.lpm_per_m2;
            if number - onset.cycle < conditions.within_cycles {
                onset.leak_lpm = onset.leak_lpm.max(leak_lpm);
            }
            if state == Some(true) && onset.found_after_cycles.is_none() {
                onset.found_after_cycles = Some(number - onset.cycle + 1);
                onset.found_at_lpm = Some(leak_lpm);
            }
        }
        course.raised_before = course.onset.is_some() && course.raised;
        course
    }

    fn take_healthy(&mut self, state: Option<bool>) {
        let Some(raised) = state else { return };
        self.healthy_cycles += 1;
        self.false_alarms += usize::from(raised && !self.raised);
        self.raised = raised;
    }
}

impl Detection {
    /// Judges a detector; `None` where it said nothing of any cycle of known truth.
    pub fn of(records: &[MachineRecord], detector: Detector, conditions: &Conditions) -> Option<Self> {
        let said = |cycle: &CycleRecord| cycle.truth_m2().is_some() && detector.state(cycle).is_some();
        if !records.iter().flat_map(|record| &record.cycles).any(said) {
            return None;
        }
        let courses: Vec<Course> =
            records.iter().map(|record| Course::of(record, detector, conditions)).collect();
        let onsets: Vec<Onset> = courses
            .iter()
            .filter(|course| !course.raised_before)
            .filter_map(|course| course.onset.clone())
            .collect();
        let classes: Vec<ClassLine> =
            Class::all().filter_map(|class| ClassLine::of(class, &onsets, conditions)).collect();
        let found = |line: &&ClassLine| line.share_found() >= FOUND_SHARE;
        Some(Detection {
            detector,
            healthy_cycles: courses.iter().map(|course| course.healthy_cycles).sum(),
            false_alarms: courses.iter().map(|course| course.false_alarms).sum(),
            raised_before: courses.iter().filter(|course| course.raised_before).count(),
            smallest_found_lpm: classes.iter().rev().take_while(found).last().map(|line| line.median_lpm),
            classes,
            onsets,
        })
    }
}

impl ClassLine {
    /// Share of machines of which the leak was found in time.
    pub fn share_found(&self) -> f64 {
        self.found as f64 / self.machines as f64
    }

    fn of(class: Class, onsets: &[Onset], conditions: &Conditions) -> Option<Self> {
        let of_class = onsets.iter().filter(|onset| class.holds(onset.leak_lpm));
        let in_time = |onset: &&Onset| {
            onset.found_after_cycles.is_some_and(|cycles| cycles <= conditions.within_cycles)
        };
        let mut leaks_lpm: Vec<f64> = of_class.clone().map(|onset| onset.leak_lpm).collect();
        leaks_lpm.sort_by(f64::total_cmp);
        let mut delays: Vec<usize> = of_class.clone().filter_map(|onset| onset.found_after_cycles).collect();
        delays.sort_unstable();
        Some(ClassLine {
            class,
            machines: leaks_lpm.len(),
            median_lpm: *leaks_lpm.get(leaks_lpm.len() / 2)?,
            found: of_class.filter(in_time).count(),
            median_cycles: delays.get(delays.len() / 2).copied(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::record::tests::{cycle, machine};
    use super::super::tests::CONDITIONS;
    use super::*;

    /// A machine with that truth, L/min, and flag in each cycle.
    fn watched(cycles: &[(f64, Flag)]) -> MachineRecord {
        let cycles = cycles.iter().map(|(lpm, flag)| cycle(Some(lpm / CONDITIONS.lpm_per_m2), 1e-7, *flag));
        machine(cycles.collect())
    }

    #[test]
    fn delays_false_alarms_and_the_smallest_leak_found() {
        use Flag::{Healthy, NoEstimate, Watch};
        let records = [
            // Found in its second cycle; a cycle without an estimate is no new alarm.
            watched(&[(0.0, Healthy), (0.0, Healthy), (0.3, Healthy), (0.3, Watch), (0.3, NoEstimate)]),
            // Found, but in the fourth cycle: too late.
            watched(&[(0.0, Healthy), (0.07, Healthy), (0.07, Healthy), (0.07, Healthy), (0.07, Watch)]),
            // A false alarm that goes and comes again through a cycle without an estimate: two.
            watched(&[(0.0, Watch), (0.0, NoEstimate), (0.0, Watch), (0.0, Healthy), (0.0, Watch)]),
            // Raised before its leak begins: says nothing of the leak.
            watched(&[(0.0, Watch), (0.3, Watch)]),
        ];
        let found = Detection::of(&records, Detector::Flags, &CONDITIONS).expect("flags");
        assert_eq!((found.healthy_cycles, found.false_alarms, found.raised_before), (8, 3, 1));
        let lines: Vec<_> = found
            .classes
            .iter()
            .map(|line| (line.class.from_lpm, line.machines, line.found, line.median_cycles))
            .collect();
        assert_eq!(lines, [(0.05, 1, 0, Some(4)), (0.2, 1, 1, Some(2))]);
        assert!(found.smallest_found_lpm.is_some_and(|lpm| (lpm - 0.3).abs() < 1e-9));
        assert_eq!(Detection::of(&records, Detector::Sums, &CONDITIONS), None);
    }

    #[test]
    fn a_growing_leak_has_the_size_that_it_reached_in_time() {
        let records = [watched(&[
            (0.0, Flag::Healthy),
            (0.01, Flag::Healthy),
            (0.06, Flag::Healthy),
            (0.11, Flag::Healthy),
            (0.3, Flag::Watch),
        ])];
        let found = Detection::of(&records, Detector::Flags, &CONDITIONS).expect("flags");
        let onset = &found.onsets[0];
        assert_eq!((onset.cycle, onset.found_after_cycles), (1, Some(4)));
        assert!((onset.leak_lpm - 0.11).abs() < 1e-9);
        assert!(onset.found_at_lpm.is_some_and(|lpm| (lpm - 0.3).abs() < 1e-9));
        assert_eq!(found.smallest_found_lpm, None);
    }
}

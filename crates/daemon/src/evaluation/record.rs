//! A machine's cycles beside the truth.

use std::collections::BTreeMap;

use seepd_model::accuracy::Judged;
use seepd_monitor::baseline::CusumFinding;
use seepd_monitor::event::{CycleLine, Event, Flag};

/// A size and its interval, m².
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Size {
    /// Estimate.
    pub leak_area_m2: f64,
    /// Interval that is to hold the truth nine times in ten.
    pub interval90_m2: [f64; 2],
}

impl Size {
    /// The same beside the truth.
    pub fn beside(&self, truth_m2: f64) -> Judged {
        Judged { truth_m2, estimate_m2: self.leak_area_m2, interval_m2: self.interval90_m2 }
    }
}

/// What the comparison with a baseline said of a cycle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Compared {
    /// Response, m².
    pub leak_residual_m2: f64,
    /// Sum over cycles.
    pub cusum: f64,
    /// Whether the sum has found a leak.
    pub found: bool,
}

/// A cycle.
#[derive(Debug, Clone, PartialEq)]
pub struct CycleRecord {
    /// Start, ns.
    pub start_ns: i64,
    /// End, ns.
    pub end_ns: i64,
    /// Condition after it.
    pub flag: Flag,
    /// Why there is no estimate.
    pub reason: Option<&'static str>,
    /// Estimate relative to the baseline.
    pub relative: Option<Size>,
    /// Estimate that knows no baseline.
    pub absolute: Option<Size>,
    /// Comparison with the baseline, where there is one.
    pub compared: Option<Compared>,
    /// Sum of the truth's values within the cycle, m², and their count.
    truth: (f64, u32),
}

impl CycleRecord {
    /// Mean of the truth over the cycle, m²; `None` where nothing says it.
    pub fn truth_m2(&self) -> Option<f64> {
        (self.truth.1 > 0).then(|| self.truth.0 / f64::from(self.truth.1))
    }

    fn of(line: &CycleLine<'_>) -> Self {
        let size = |area: Option<f64>, interval: Option<[f64; 2]>| {
            Some(Size { leak_area_m2: area?, interval90_m2: interval? })
        };
        let told = size(line.leak_area_m2, line.interval90_m2);
        let (relative, absolute) = match (&line.comparison, &line.absolute) {
            (Some(_), Some(alone)) => {
                (told, size(Some(alone.absolute_leak_area_m2), Some(alone.absolute_interval90_m2)))
            }
            _ => (None, told),
        };
        CycleRecord {
            start_ns: line.t_start_ns,
            end_ns: line.t_end_ns(),
            flag: line.flag,
            reason: line.reason,
            relative,
            absolute,
            compared: line.comparison.as_ref().map(|comparison| Compared {
                leak_residual_m2: comparison.leak_residual_m2,
                cusum: comparison.cusum,
                found: comparison.finding == CusumFinding::Leak,
            }),
            truth: (0.0, 0),
        }
    }
}

/// A machine's cycles, in their order.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MachineRecord {
    /// What it is called.
    pub name: String,
    /// Cycles.
    pub cycles: Vec<CycleRecord>,
    /// Cycles by their starts, ns.
    by_start: BTreeMap<i64, usize>,
}

impl MachineRecord {
    /// A machine of that name, without cycles.
    pub fn new(name: impl Into<String>) -> Self {
        MachineRecord { name: name.into(), ..MachineRecord::default() }
    }

    /// Takes what the pipeline says.
    pub fn take(&mut self, event: &Event<'_>) {
        if let Event::Cycle(line) = event {
            self.by_start.insert(line.t_start_ns, self.cycles.len());
            self.cycles.push(CycleRecord::of(line));
        }
    }

    /// Largest leak that the truth knows of the cycles before the first one that was compared with a baseline, m²: those that the baseline
    /// was learned from. `None` where nothing was learned on the way, or the truth says nothing of them.
    pub fn leak_while_learning_m2(&self) -> Option<f64> {
        let first = self.cycles.iter().position(|cycle| cycle.compared.is_some())?;
        self.cycles[..first].iter().filter_map(CycleRecord::truth_m2).reduce(f64::max)
    }

    /// Takes the true leak area at a time, m². What lies within no cycle, or is no area, is left out.
    pub fn take_truth(&mut self, time_ns: i64, leak_area_m2: f64) {
        if !(leak_area_m2.is_finite() && leak_area_m2 >= 0.0) {
            return;
        }
        let Some((_, index)) = self.by_start.range(..=time_ns).next_back() else { return };
        if let Some(cycle) = self.cycles.get_mut(*index).filter(|cycle| time_ns < cycle.end_ns) {
            cycle.truth.0 += leak_area_m2;
            cycle.truth.1 += 1;
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A cycle with an absolute estimate.
    pub(crate) fn cycle(truth_m2: Option<f64>, estimate_m2: f64, flag: Flag) -> CycleRecord {
        let interval90_m2 = [0.8 * estimate_m2, 1.2 * estimate_m2];
        CycleRecord {
            start_ns: 0,
            end_ns: 10,
            flag,
            reason: None,
            relative: None,
            absolute: Some(Size { leak_area_m2: estimate_m2, interval90_m2 }),
            compared: None,
            truth: truth_m2.map_or((0.0, 0), |truth| (truth, 1)),
        }
    }

    pub(crate) fn machine(cycles: Vec<CycleRecord>) -> MachineRecord {
        MachineRecord { cycles, ..MachineRecord::new("press") }
    }

    #[test]
    fn a_cycle_s_truth_is_the_mean_within_it() {
        let mut record = MachineRecord::new("press");
        for start_ns in [0, 20] {
            record.by_start.insert(start_ns, record.cycles.len());
            record.cycles.push(CycleRecord {
                start_ns,
                end_ns: start_ns + 10,
                ..cycle(None, 1e-6, Flag::Healthy)
            });
        }
        // Out of order, between the cycles, before and after them; and what is no area.
        for (time_ns, area_m2) in
            [(25, 4e-6), (0, 1e-6), (9, 3e-6), (10, 9.0), (15, 9.0), (-1, 9.0), (40, 9.0)]
        {
            record.take_truth(time_ns, area_m2);
        }
        record.take_truth(5, f64::NAN);
        record.take_truth(5, -1e-6);
        let truths: Vec<Option<f64>> = record.cycles.iter().map(CycleRecord::truth_m2).collect();
        assert_eq!(truths, [Some(2e-6), Some(4e-6)]);
    }
}

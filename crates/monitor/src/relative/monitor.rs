//! A machine without a model: finds its duty cycle, learns what it is like, and watches it.

use seepd_features::{CycleReader, CycleState, Outcome, ValidCycle};
use seepd_model::schema::Cycle;
use seepd_signals::Sample;

use super::charts::{Change, Charts, Sums};
use super::shape::{DefinedCycle, cycle_of};
use super::{Learner, RelativeBaseline, RelativeError, USUAL_CYCLES, feature_names};
use crate::pipeline::observer::CommandObserver;

/// While no duty cycle is known the command is looked at this often, ns.
const LOOK_NS: u64 = 5_000_000_000;
/// From so many cycles on the duty cycle is what it was taken for.
const CYCLES_BEYOND_DOUBT: usize = 5;
/// Periods after which there is no statement, while no duty cycle is known, s.
const UNKNOWN_PERIOD_S: f64 = 60.0;

/// What watches a machine without a model.
pub struct RelativeMonitor {
    reading: Option<Reading>,
    estimator: RelativeEstimator,
    /// When the command was last looked at for a duty cycle, ns.
    looked_ns: Option<i64>,
}

/// The duty cycle, and the memory of its reader.
struct Reading {
    cell: DefinedCycle,
    state: CycleState<Vec<f32>>,
}

/// What it makes of the cycles.
pub(crate) struct RelativeEstimator {
    stage: Stage,
    /// The duty cycle and its samples' rate, Hz, once they are known.
    duty_cycle: Option<(Cycle, f64)>,
    /// Names of what is compared.
    pub(crate) names: Vec<String>,
    /// The last cycle's numbers.
    pub(crate) values: Vec<f64>,
    /// Whether the last change was announced.
    pub(crate) announced: bool,
}

enum Stage {
    /// Cycles are to become a baseline.
    Learning(Learner),
    /// They are compared with it.
    Watching(Box<(RelativeBaseline, Charts)>),
}

/// What a cycle has come to.
pub(crate) enum Step {
    /// It is one of those that are to become a baseline.
    Learning,
    /// The baseline is there.
    Learned(String),
    /// There is none, and why; learning begins anew.
    Failed(String),
    /// It was compared.
    Compared,
}

impl Default for RelativeMonitor {
    /// Looks for a duty cycle, and learns it as soon as there is one.
    fn default() -> Self {
        RelativeMonitor {
            reading: None,
            estimator: RelativeEstimator::new(Learner::new("first cycles", USUAL_CYCLES)),
            looked_ns: None,
        }
    }
}

impl RelativeMonitor {
    /// Learns a baseline from the next cycles, and compares with it from then on. The duty cycle is looked for anew: it may be another one.
    pub fn learn(&mut self, occasion: &str, cycles: usize) {
        *self = RelativeMonitor {
            estimator: RelativeEstimator::new(Learner::new(occasion, cycles)),
            ..RelativeMonitor::default()
        };
    }

    /// Compares with a baseline from now on.
    ///
    /// # Errors
    /// [`RelativeError::Reader`] where the reader has no room for its duty cycle, which the file's check rules out.
    pub fn follow(&mut self, baseline: RelativeBaseline) -> Result<(), RelativeError> {
        let reading = Reading::open(DefinedCycle::open(baseline.cycle.clone(), baseline.sample_rate_hz)?)?;
        self.estimator.know(&reading.cell);
        self.reading = Some(reading);
        self.estimator.follow(baseline);
        Ok(())
    }

    /// The baseline that cycles are compared with.
    pub fn baseline(&self) -> Option<&RelativeBaseline> {
        match &self.estimator.stage {
            Stage::Watching(watching) => Some(&watching.0),
            Stage::Learning(_) => None,
        }
    }

    /// What gathers a baseline, while it does.
    pub fn learner(&self) -> Option<&Learner> {
        match &self.estimator.stage {
            Stage::Learning(learner) => Some(learner),
            Stage::Watching(_) => None,
        }
    }

    /// The baseline of the cycles so far, where fewer than wanted must do.
    ///
    /// # Errors
    /// [`RelativeError`]: no duty cycle, too few cycles, or too few that are alike.
    pub fn baseline_so_far(&self, axis: &str) -> Result<RelativeBaseline, RelativeError> {
        match &self.estimator.stage {
            Stage::Watching(watching) => Ok(watching.0.clone()),
            Stage::Learning(learner) => self.estimator.baseline_of(learner, axis),
        }
    }

    /// The sums against the baseline.
    pub fn sums(&self) -> Option<&Sums> {
        match &self.estimator.stage {
            Stage::Watching(watching) => Some(watching.1.sums()),
            Stage::Learning(_) => None,
        }
    }

    /// Takes the sums up where an earlier run left them.
    pub fn restore(&mut self, sums: Sums) {
        if let Stage::Watching(watching) = &mut self.estimator.stage {
            watching.1.restore(sums);
            self.estimator.announced = watching.1.has_changed();
        }
    }

    /// Something was done to the machine: the sums against the baseline begin anew, and learning does.
    pub(crate) fn begin_anew(&mut self) {
        match &mut self.estimator.stage {
            Stage::Watching(watching) => {
                let baseline = watching.0.clone();
                self.estimator.follow(baseline);
            }
            Stage::Learning(learner) => *learner = learner.anew(),
        }
    }

    /// What has changed since the baseline.
    pub fn change(&self) -> Option<Change> {
        self.estimator.charts().and_then(Charts::change)
    }

    /// The duty cycle's period, or how long is waited for one, s.
    pub(crate) fn period_s(&self) -> f64 {
        self.reading.as_ref().map_or(UNKNOWN_PERIOD_S, |reading| reading.cell.cycle().period_s)
    }

    /// The reader of its cycles, once they are known.
    pub(crate) fn reading(&self) -> Option<(&CycleReader<'_>, &CycleState<Vec<f32>>)> {
        self.reading.as_ref().map(|reading| (reading.cell.reader(), &reading.state))
    }

    /// Takes a sample that the observer has seen; `sink` hears of each cycle that it ends.
    #[inline]
    pub(crate) fn push(
        &mut self,
        sample: &Sample,
        observer: &CommandObserver,
        sink: &mut impl FnMut(&mut RelativeEstimator, &Outcome<'_>),
    ) {
        let estimator = &mut self.estimator;
        match &mut self.reading {
            Some(Reading { cell, state }) => {
                cell.reader().push(state, sample, &mut |outcome| sink(estimator, &outcome));
            }
            None if self.looked_ns.is_none_or(|looked_ns| sample.time_ns.abs_diff(looked_ns) >= LOOK_NS) => {
                self.looked_ns = Some(sample.time_ns);
                self.look(observer);
            }
            None => {}
        }
    }

    /// Ends the stream.
    pub(crate) fn finish(&mut self, sink: &mut impl FnMut(&mut RelativeEstimator, &Outcome<'_>)) {
        let estimator = &mut self.estimator;
        if let Some(Reading { cell, state }) = &mut self.reading {
            cell.reader().finish(state, &mut |outcome| sink(estimator, &outcome));
        }
    }

    /// There have been no cycles for long: what it took for the duty cycle may be another pattern. One of which cycles have been learned is
    /// none: the machine rests.
    pub(crate) fn doubt(&mut self) {
        if let Stage::Learning(learner) = &self.estimator.stage
            && learner.cycles() < CYCLES_BEYOND_DOUBT
        {
            self.estimator = RelativeEstimator::new(learner.anew());
            self.reading = None;
        }
    }

    /// Looks whether the command repeats, in strokes and holds.
    #[cold]
    fn look(&mut self, observer: &CommandObserver) {
        let Some(pattern) = observer.pattern() else { return };
        let reading = cycle_of(&pattern)
            .and_then(|cycle| DefinedCycle::open(cycle, pattern.sample_rate_hz))
            .and_then(Reading::open);
        // One that cannot be read is looked for again: the next stretch may show more.
        if let Ok(reading) = reading {
            self.estimator.know(&reading.cell);
            self.reading = Some(reading);
        }
    }
}

impl Reading {
    fn open(cell: DefinedCycle) -> Result<Self, RelativeError> {
        let state = cell.start()?;
        Ok(Reading { cell, state })
    }
}

impl RelativeEstimator {
    fn new(learner: Learner) -> Self {
        RelativeEstimator {
            stage: Stage::Learning(learner),
            duty_cycle: None,
            names: Vec::new(),
            values: Vec::new(),
            announced: false,
        }
    }

    fn know(&mut self, cell: &DefinedCycle) {
        self.names = feature_names(cell.cycle());
        self.values = vec![0.0; self.names.len()];
        self.duty_cycle = Some((cell.cycle().clone(), cell.sample_rate_hz()));
    }

    fn follow(&mut self, baseline: RelativeBaseline) {
        let charts = Charts::new(&baseline);
        self.stage = Stage::Watching(Box::new((baseline, charts)));
        self.announced = false;
    }

    /// The sums, once there is a baseline.
    pub(crate) fn charts(&self) -> Option<&Charts> {
        match &self.stage {
            Stage::Watching(watching) => Some(&watching.1),
            Stage::Learning(_) => None,
        }
    }

    fn baseline_of(&self, learner: &Learner, axis: &str) -> Result<RelativeBaseline, RelativeError> {
        let duty_cycle = self.duty_cycle.clone().ok_or(RelativeError::NoCycle)?;
        learner.baseline_of(axis, duty_cycle)
    }

    /// Takes a cycle of an axis: learns from it, or compares it.
    pub(crate) fn take(&mut self, cycle: &ValidCycle<'_>, axis: &str) -> Step {
        self.read(cycle);
        let learner = match &mut self.stage {
            Stage::Watching(watching) => {
                watching.1.take(&self.values, cycle.end_ns);
                return Step::Compared;
            }
            Stage::Learning(learner) => learner,
        };
        learner.take(cycle, &self.values);
        if !learner.is_full() {
            return Step::Learning;
        }
        let anew = learner.anew();
        let learner = std::mem::replace(learner, anew);
        match self.baseline_of(&learner, axis) {
            Ok(baseline) => {
                let remarks: String = baseline.remarks.iter().map(|remark| format!("; {remark}")).collect();
                let text = format!("a baseline of {} cycles has been learned{remarks}", baseline.cycles);
                self.follow(baseline);
                Step::Learned(text)
            }
            Err(error) => {
                Step::Failed(format!("no baseline could be learned: {error}; learning starts again"))
            }
        }
    }

    /// The cycle's numbers: means, and slopes over the whole phase.
    fn read(&mut self, cycle: &ValidCycle<'_>) {
        self.values.clear();
        self.values.extend_from_slice(cycle.features);
        if let Some((known, _)) = &self.duty_cycle {
            let rises = self.values.iter_mut().skip(known.phases.len());
            rises.zip(&known.phases).for_each(|(slope, phase)| *slope *= phase.to_s - phase.from_s);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::alarm::AlarmConfig;
    use crate::event::{Event, Flag};
    use crate::pipeline::{MonitorConfig, Pipeline};
    use seepd_sim::cycle::CycleRun;
    use seepd_sim::noise::Noise;
    use seepd_sim::{Input, Machine, MachineSpec, Schedule};

    /// An axis without a model.
    fn pipeline() -> Pipeline {
        let config = MonitorConfig {
            axis: "press".into(),
            duty_cycles: Vec::new(),
            alarm: AlarmConfig::default(),
            reference_dp_pa: 7e6,
            operating_hours_per_year: 8760.0,
        };
        Pipeline::new(config).unwrap()
    }

    /// Flags and notices of a press with these leaks by cycle, and its load within 2 %.
    fn told(pipeline: &mut Pipeline, leaks_m2: &[f64], scale: f64) -> Vec<(u64, String)> {
        let spec = MachineSpec::default();
        let machine = Machine::<f64>::new(&[&spec]);
        let (mut state, mut noise) = (machine.start(), Noise::new(1, 1));
        let mut runs: Vec<CycleRun> = leaks_m2.iter().map(|leak_m2| CycleRun::with_leak(*leak_m2)).collect();
        runs.iter_mut().for_each(|run| run.load_factor = 1.0 + noise.uniform(-0.02, 0.02));
        let (ticks, mut told) = (10_000 * runs.len(), Vec::new());
        for (tick, drive) in Schedule::new(&spec.cycle, 1e-3, runs).take(ticks).enumerate() {
            let command = machine.tick(&mut state, &Input::gather(&[drive])).command + noise.normal(0.003);
            let sample = Sample::command(tick as i64 * 1_000_000, scale * command);
            pipeline.push(&sample, &mut |event| match event {
                Event::Flag(flag) => told.push((flag.cycle, flag.flag_to.name().to_owned())),
                Event::Notice(notice) => {
                    told.push((notice.cycle, format!("{:?}: {}", notice.notice, notice.text)));
                }
                Event::Cycle(line) => assert_eq!(line.leak_flow_lpm, None),
            });
        }
        told
    }

    #[test]
    fn a_press_is_learned_from_its_command_alone_and_a_leak_is_found_and_dated() {
        let mut pipeline = pipeline();
        pipeline.relative_mut().unwrap().learn("test", 30);
        let leaks: Vec<f64> = (0..65).map(|cycle| if cycle < 50 { 0.0 } else { 1e-7 }).collect();
        let told = told(&mut pipeline, &leaks, 1.0);
        let monitor = pipeline.relative().unwrap();
        let baseline = monitor.baseline().unwrap();
        assert!((baseline.cycle.period_s - 10.0).abs() < 0.01, "{}", baseline.cycle.period_s);
        let names: Vec<&str> = baseline.cycle.phases.iter().map(|phase| phase.name.as_str()).collect();
        assert_eq!(
            names,
            ["hold_1", "stroke_1", "hold_2", "stroke_2", "hold_3", "stroke_3", "hold_4"],
            "{told:?}"
        );
        let found = told
            .iter()
            .find(|(_, text)| text.starts_with("ChangeFound"))
            .unwrap_or_else(|| panic!("{told:?}"));
        // The first five cycles show what the duty cycle is.
        let onset_s = monitor.change().unwrap().onset_ns as f64 / 1e9;
        assert!((485.0..520.0).contains(&onset_s), "{onset_s} {found:?}");
        assert!(found.1.contains("Without a plant model there is no L/min"), "{found:?}");
        let flags: Vec<&str> =
            told.iter().filter(|(_, text)| !text.contains(':')).map(|(_, text)| text.as_str()).collect();
        assert_eq!(flags, ["healthy", "watch"], "{told:?}");
        let summary = pipeline.summary();
        assert_eq!(
            (summary.flag, summary.leak_flow_lpm, summary.size_withheld),
            (Flag::Watch, None, Some("no_plant_model"))
        );
    }

    #[test]
    fn a_baseline_from_a_file_goes_on_where_it_was() {
        let mut first = pipeline();
        first.relative_mut().unwrap().learn("test", 30);
        told(&mut first, &[0.0; 37], 1.0);
        let text = first.relative().unwrap().baseline().unwrap().to_json().unwrap();
        let mut second = pipeline();
        second.relative_mut().unwrap().follow(RelativeBaseline::parse(&text).unwrap()).unwrap();
        let heard = told(&mut second, &[0.0; 6], 1.0);
        assert_eq!(heard, [(1, "healthy".to_owned())]);
    }
}

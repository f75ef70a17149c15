//! A duty cycle and what watches it: its reader, its model, its baseline.

use std::sync::Arc;

use seepd_features::reader::MAX_FEATURES;
use seepd_features::{CycleReader, CycleState, ReaderError, ValidCycle};
use seepd_model::causes::{ChangeVerdict, Explanation};
use seepd_model::{Attribution, Estimate, Model, OutOfDistribution};

use crate::baseline::comparator::ComparedCycle;
use crate::baseline::{
    Baseline, BaselineComparator, BaselineError, Cusum, CusumFinding, Learner, LoadKnowledge, relative_of,
};
use crate::cause::course::{Condition, CourseState, Courses};
use crate::repair::{Aftercare, Repair, RepairKind};

/// A duty cycle of the axis.
#[derive(Debug, Clone)]
pub struct DutyCycle {
    /// Name, where the axis has several.
    pub name: Option<String>,
    /// Its model.
    pub model: Arc<Model>,
}

impl DutyCycle {
    /// The only duty cycle of an axis.
    pub fn only(model: impl Into<Arc<Model>>) -> Self {
        DutyCycle { name: None, model: model.into() }
    }

    /// The longest period, s; 0 without a duty cycle.
    pub fn longest_period_s(all: &[DutyCycle]) -> f64 {
        all.iter().map(|duty_cycle| duty_cycle.model.file().cycle.period_s).fold(0.0, f64::max)
    }

    /// Every feature of any of the duty cycles, once, in their order.
    pub fn feature_names(all: &[DutyCycle]) -> Vec<String> {
        let mut names: Vec<String> = Vec::new();
        for name in all.iter().flat_map(|duty_cycle| duty_cycle.model.feature_names()) {
            if !names.contains(name) {
                names.push(name.clone());
            }
        }
        names
    }
}

self_cell::self_cell!(
    /// A reader of cycles with the model that it borrows from, so that a pipeline needs no lifetime.
    pub(super) struct ModelReader {
        owner: Arc<Model>,
        #[covariant]
        dependent: CycleReader,
    }
);

impl ModelReader {
    fn open(model: &Arc<Model>) -> Result<Self, ReaderError> {
        ModelReader::try_new(Arc::clone(model), |model| model.reader())
    }

    /// The reader.
    pub(super) fn get(&self) -> &CycleReader<'_> {
        self.borrow_dependent()
    }
}

/// Names of what contributes to a leak residual: the phases, then the load.
fn contributors(model: &Model) -> Vec<String> {
    let phases = model.file().cycle.phases.iter().map(|phase| phase.name.clone());
    phases.chain(["load".to_owned()]).collect()
}

/// Whether cycles are compared with a baseline.
#[derive(Debug, Clone)]
enum Commissioning {
    /// They are not.
    Absent,
    /// They are to become one.
    Learning(Learner),
    /// They are.
    Comparing(Box<BaselineComparator>),
}

/// What watches a duty cycle.
pub struct Monitor {
    pub(super) reader: ModelReader,
    pub(super) state: CycleState<Vec<f32>>,
    pub(super) estimator: CycleEstimator,
}

/// What a monitor makes of the cycles that its reader finds.
pub(super) struct CycleEstimator {
    pub(super) name: Option<String>,
    pub(super) model: Arc<Model>,
    pub(super) contributors: Vec<String>,
    attribution: Attribution,
    commissioning: Commissioning,
    /// What was last announced of the baseline, so that each change is announced once.
    pub(super) announced: Announced,
    /// Cycles with an estimate.
    pub(super) cycles: u64,
    /// Entries of the repair log that have no verdict yet.
    pub(super) aftercare: Vec<Aftercare>,
    /// What the last cycle was explained by.
    pub(super) explained: Option<Explanation>,
    /// Each cause over cycles, and what of these has been found.
    pub(super) courses: Courses,
    pub(super) conditions: Vec<Condition>,
}

/// What was announced last.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Announced {
    pub(super) finding: CusumFinding,
    pub(super) load: LoadKnowledge,
    /// Cycles in a row that are unlike baseline or training.
    pub(super) unlike: u32,
    /// What has changed beside the seal.
    pub(super) condition: Option<ChangeVerdict>,
    /// The repair that has brought it.
    pub(super) brought_by: Option<RepairKind>,
}

impl Default for Announced {
    fn default() -> Self {
        Announced {
            finding: CusumFinding::None,
            load: LoadKnowledge::Inferred,
            unlike: 0,
            condition: None,
            brought_by: None,
        }
    }
}

/// The simulator-trained estimate of a cycle.
#[derive(Debug, Clone, Copy)]
pub(super) struct Absolute {
    pub(super) estimate: Estimate,
    pub(super) out_of_distribution: OutOfDistribution,
    /// What each feature contributes, in the model's order.
    pub(super) contributions: [f64; MAX_FEATURES],
}

impl Monitor {
    /// Begins with an empty memory.
    ///
    /// # Errors
    /// [`ReaderError`] of a model that has more features, phases or bins than the reader has room for.
    pub(super) fn new(duty_cycle: &DutyCycle) -> Result<Self, ReaderError> {
        let model = Arc::clone(&duty_cycle.model);
        let reader = ModelReader::open(&model)?;
        let state = reader.get().start(vec![0.0; reader.get().definition().ring_samples()])?;
        Ok(Monitor {
            reader,
            state,
            estimator: CycleEstimator {
                name: duty_cycle.name.clone(),
                contributors: contributors(&model),
                attribution: model.attribution(),
                model,
                commissioning: Commissioning::Absent,
                announced: Announced::default(),
                cycles: 0,
                aftercare: Vec::new(),
                explained: None,
                courses: Courses::default(),
                conditions: Vec::new(),
            },
        })
    }

    /// The duty cycle's name, where the axis has several.
    pub fn name(&self) -> Option<&str> {
        self.estimator.name.as_deref()
    }

    /// The duty cycle's model.
    pub fn model(&self) -> &Model {
        &self.estimator.model
    }

    /// Its cycles with an estimate.
    pub fn cycles(&self) -> u64 {
        self.estimator.cycles
    }

    /// Compares cycles with a baseline from now on.
    pub fn follow(&mut self, baseline: Baseline) {
        self.estimator.follow(baseline);
    }

    /// Learns a baseline from the next cycles, and compares with it from then on.
    ///
    /// # Errors
    /// [`BaselineError::CannotCompare`]: learning would begin anew for ever.
    pub fn learn(&mut self, occasion: &str, cycles: usize) -> Result<(), BaselineError> {
        relative_of(&self.estimator.model)?;
        self.estimator.commissioning = Commissioning::Learning(Learner::new(occasion, cycles));
        self.estimator.announced.finding = CusumFinding::None;
        Ok(())
    }

    /// The baseline that cycles are compared with.
    pub fn baseline(&self) -> Option<&Baseline> {
        match &self.estimator.commissioning {
            Commissioning::Comparing(comparator) => Some(comparator.baseline()),
            _ => None,
        }
    }

    /// What gathers a baseline, while it does.
    pub fn learner(&self) -> Option<&Learner> {
        match &self.estimator.commissioning {
            Commissioning::Learning(learner) => Some(learner),
            _ => None,
        }
    }

    /// What the sums over cycles say against the baseline.
    pub fn finding(&self) -> CusumFinding {
        self.estimator.announced.finding
    }

    /// The sums over cycles, where there is a baseline.
    pub fn cusum(&self) -> Option<Cusum> {
        match &self.estimator.commissioning {
            Commissioning::Comparing(comparator) => Some(*comparator.cusum()),
            _ => None,
        }
    }

    /// Takes the sums up where an earlier run left them.
    pub fn restore_cusum(&mut self, cusum: Cusum) {
        if let Commissioning::Comparing(comparator) = &mut self.estimator.commissioning {
            comparator.restore(cusum);
            self.estimator.announced.finding = cusum.finding();
        }
    }

    /// Causes beside the seal that have been found, the surest first.
    pub fn conditions(&self) -> &[Condition] {
        &self.estimator.conditions
    }

    /// What outlives the program of them.
    pub fn courses(&self) -> Vec<CourseState> {
        self.estimator.courses.state()
    }

    /// Takes them up where an earlier run left them.
    pub fn restore_courses(&mut self, courses: &[CourseState]) {
        self.estimator.courses.restore(courses);
        self.estimator.conditions = self.estimator.courses.found();
    }

    /// Entries of the repair log that have no verdict yet.
    pub fn aftercare(&self) -> &[Aftercare] {
        &self.estimator.aftercare
    }

    /// Takes them up where an earlier run left them.
    pub fn restore_aftercare(&mut self, aftercare: Vec<Aftercare>) {
        self.estimator.aftercare = aftercare;
    }
}

/// How a repair lies to the baseline in force.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Heeded {
    /// After it, or there is none: cycles count from the repair on.
    Anew,
    /// The baseline was learned after it, and knows it.
    Known,
    /// The baseline was learned while it was done.
    Within,
}

impl CycleEstimator {
    /// What the model says of a cycle by itself.
    pub(super) fn absolute(&self, valid: &ValidCycle<'_>) -> Absolute {
        let (estimate, out_of_distribution) = self.estimate(valid);
        let mut contributions = [0.0; MAX_FEATURES];
        self.attribution.contributions(self.model.ensemble(), valid.features, &mut contributions);
        Absolute { estimate, out_of_distribution, contributions }
    }

    fn estimate(&self, valid: &ValidCycle<'_>) -> (Estimate, OutOfDistribution) {
        let estimate = self.model.estimate_at(valid.features, valid.statistics.noise);
        let out_of_distribution = self.model.out_of_distribution(&estimate, &valid.statistics.phase_means());
        (estimate, out_of_distribution)
    }

    /// Whether there is a baseline.
    pub(super) fn is_comparing(&self) -> bool {
        matches!(self.commissioning, Commissioning::Comparing(_))
    }

    /// How far a cycle is from what is known: from the baseline where there is one, else from training. Above 1 it is unknown.
    pub(super) fn out_of_distribution(&self, valid: &ValidCycle<'_>) -> f64 {
        let compared = match &self.commissioning {
            Commissioning::Comparing(comparator) => comparator.compare(&self.model, valid),
            _ => None,
        };
        compared
            .map_or_else(|| self.estimate(valid).1.score, |(estimate, ..)| estimate.out_of_distribution.score)
    }

    /// Compares a cycle that ends at a time, s, with the baseline, where there is one. `absolute_m2` is what the model says without it.
    pub(super) fn compare_cycle(
        &mut self,
        valid: &ValidCycle<'_>,
        end_s: f64,
        absolute_m2: Option<f64>,
    ) -> Option<ComparedCycle> {
        let compared = match &mut self.commissioning {
            Commissioning::Comparing(comparator) => comparator.take(&self.model, valid, end_s, absolute_m2),
            _ => None,
        };
        self.explained =
            compared.and_then(|compared| compared.explained).map(|explained| explained.explanation);
        compared
    }

    /// Something was done to the machine; `leak_before_m2` where a leak had been found.
    pub(super) fn heed(&mut self, repair: &Repair, leak_before_m2: Option<f64>) -> Heeded {
        match &mut self.commissioning {
            Commissioning::Comparing(comparator) => {
                let Baseline { from_ns, to_ns, .. } = *comparator.baseline();
                if repair.is_before(from_ns) {
                    return Heeded::Known;
                }
                if repair.is_before(to_ns) {
                    return Heeded::Within;
                }
                comparator.begin_anew();
                if repair.what == RepairKind::SealReplaced {
                    comparator.forget_leak();
                    self.announced.finding = CusumFinding::None;
                }
            }
            Commissioning::Learning(learner) if repair.what != RepairKind::Other => {
                // The cycles so far are another machine's.
                *learner = Learner::new(learner.occasion(), learner.wanted());
            }
            Commissioning::Learning(_) | Commissioning::Absent => {}
        }
        self.courses.forget(|cause| repair.what.is_about(cause));
        if repair.what != RepairKind::Other {
            self.aftercare.push(Aftercare::begin(repair, leak_before_m2, self.explained.as_ref()));
        }
        // What it is about is told anew, as the repair's or as one that stands.
        let is_about = |verdict: ChangeVerdict| match verdict {
            ChangeVerdict::Named(first, second) => {
                repair.what.is_about(first) || second.is_some_and(|second| repair.what.is_about(second))
            }
            _ => false,
        };
        if self.announced.condition.is_some_and(is_about) {
            (self.announced.condition, self.announced.brought_by) = (None, None);
        }
        Heeded::Anew
    }

    fn follow(&mut self, baseline: Baseline) {
        let comparator = BaselineComparator::new(baseline, &self.model);
        self.commissioning = Commissioning::Comparing(Box::new(comparator));
        self.announced = Announced::default();
        (self.courses, self.conditions) = (Courses::default(), Vec::new());
    }

    /// Takes a cycle on the way to a baseline; the baseline in words, or why there is none, once there are enough.
    pub(super) fn learn_from(
        &mut self,
        valid: &ValidCycle<'_>,
        absolute: Estimate,
    ) -> Option<Result<String, String>> {
        let Commissioning::Learning(learner) = &mut self.commissioning else { return None };
        learner.take(valid, absolute);
        if !learner.is_full() {
            return None;
        }
        match learner.baseline(&self.model) {
            Ok(baseline) => {
                let mut text = format!("a baseline of {} cycles has been learned", baseline.cycles);
                for remark in &baseline.remarks {
                    text.push_str("; ");
                    text.push_str(remark);
                }
                self.follow(baseline);
                Some(Ok(text))
            }
            Err(error) => {
                let anew = Learner::new(learner.occasion(), learner.wanted());
                self.commissioning = Commissioning::Learning(anew);
                Some(Err(format!("no baseline could be learned: {error}; learning starts again")))
            }
        }
    }
}

//! A duty cycle and what watches it: its reader, its model, its baseline.

use seepd_features::reader::MAX_FEATURES;
use seepd_features::{CycleReader, CycleState, ReaderError, ValidCycle};
use seepd_model::{Attribution, Estimate, Model, OutOfDistribution};

use crate::baseline::follower::Followed;
use crate::baseline::{Baseline, Drift, Finding, Follower, Learner, LoadKnowledge, relative_of};
use crate::config::NamedModel;

/// A duty cycle of the axis.
#[derive(Debug)]
pub struct DutyCycle<'m> {
    /// Name, where the axis has several.
    pub name: Option<&'m str>,
    /// Its model.
    pub model: &'m Model,
}

impl<'m> DutyCycle<'m> {
    /// The only duty cycle of an axis.
    pub fn only(model: &'m Model) -> Self {
        DutyCycle { name: None, model }
    }

    /// Those of these models.
    pub fn all(models: &'m [NamedModel]) -> Vec<Self> {
        let named =
            |named: &'m NamedModel| DutyCycle { name: named.name.as_deref(), ..Self::only(&named.model) };
        models.iter().map(named).collect()
    }

    /// The longest period, s; 0 without a duty cycle.
    pub fn longest_period_s(all: &[DutyCycle<'_>]) -> f64 {
        all.iter().map(|duty_cycle| duty_cycle.model.file().cycle.period_s).fold(0.0, f64::max)
    }

    /// Every feature of any of the duty cycles, once, in their order.
    pub fn feature_names(all: &[DutyCycle<'_>]) -> Vec<String> {
        let mut names: Vec<String> = Vec::new();
        for name in all.iter().flat_map(|duty_cycle| duty_cycle.model.feature_names()) {
            if !names.contains(name) {
                names.push(name.clone());
            }
        }
        names
    }
}

/// Names of what contributes to a response: the phases, then the load.
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
    Following(Box<Follower>),
}

/// What watches a duty cycle.
pub struct Monitor<'m> {
    pub(super) reader: CycleReader<'m>,
    pub(super) state: CycleState<Vec<f32>>,
    pub(super) judge: Judge<'m>,
}

/// What a monitor makes of the cycles that its reader finds.
pub(super) struct Judge<'m> {
    pub(super) name: Option<&'m str>,
    pub(super) model: &'m Model,
    pub(super) contributors: Vec<String>,
    attribution: Attribution,
    commissioning: Commissioning,
    /// What was last told of the baseline, so that each is told once.
    pub(super) told: Told,
    /// Cycles with an estimate.
    pub(super) cycles: u64,
}

/// What was told last.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Told {
    pub(super) finding: Finding,
    pub(super) load: LoadKnowledge,
    /// Cycles in a row that are unlike baseline or training.
    pub(super) unlike: u32,
}

impl Default for Told {
    fn default() -> Self {
        Told { finding: Finding::None, load: LoadKnowledge::Inferred, unlike: 0 }
    }
}

/// The simulator-trained estimate of a cycle.
#[derive(Debug, Clone, Copy)]
pub(super) struct Absolute {
    pub(super) estimate: Estimate,
    pub(super) novelty: OutOfDistribution,
    /// What each feature contributes, in the model's order.
    pub(super) contributions: [f64; MAX_FEATURES],
}

impl<'m> Monitor<'m> {
    /// Begins with an empty memory.
    ///
    /// # Errors
    /// [`ReaderError`] of a model that has more features, phases or bins than the reader has room for.
    pub(super) fn new(duty_cycle: &'m DutyCycle<'m>) -> Result<Self, ReaderError> {
        let model = duty_cycle.model;
        let reader = model.reader()?;
        let state = reader.start(vec![0.0; reader.definition().ring_samples()])?;
        Ok(Monitor {
            reader,
            state,
            judge: Judge {
                name: duty_cycle.name,
                model,
                contributors: contributors(model),
                attribution: model.attribution(),
                commissioning: Commissioning::Absent,
                told: Told::default(),
                cycles: 0,
            },
        })
    }

    /// The duty cycle's name, where the axis has several.
    pub fn name(&self) -> Option<&'m str> {
        self.judge.name
    }

    /// The duty cycle's model.
    pub fn model(&self) -> &'m Model {
        self.judge.model
    }

    /// Its cycles with an estimate.
    pub fn cycles(&self) -> u64 {
        self.judge.cycles
    }

    /// Compares cycles with a baseline from now on.
    pub fn follow(&mut self, baseline: Baseline) {
        self.judge.follow(baseline);
    }

    /// Learns a baseline from the next cycles, and compares with it from then on.
    ///
    /// # Errors
    /// One line where the model cannot compare: learning would begin anew for ever.
    pub fn learn(&mut self, occasion: &str, cycles: usize) -> Result<(), String> {
        relative_of(self.judge.model)?;
        self.judge.commissioning = Commissioning::Learning(Learner::new(occasion, cycles));
        self.judge.told.finding = Finding::None;
        Ok(())
    }

    /// The baseline that cycles are compared with.
    pub fn baseline(&self) -> Option<&Baseline> {
        match &self.judge.commissioning {
            Commissioning::Following(follower) => Some(follower.baseline()),
            _ => None,
        }
    }

    /// What gathers a baseline, while it does.
    pub fn learner(&self) -> Option<&Learner> {
        match &self.judge.commissioning {
            Commissioning::Learning(learner) => Some(learner),
            _ => None,
        }
    }

    /// What the sums over cycles say against the baseline.
    pub fn finding(&self) -> Finding {
        self.judge.told.finding
    }

    /// The sums over cycles, where there is a baseline.
    pub fn drift(&self) -> Option<Drift> {
        match &self.judge.commissioning {
            Commissioning::Following(follower) => Some(*follower.drift()),
            _ => None,
        }
    }

    /// Takes the sums up where an earlier run left them.
    pub fn restore_drift(&mut self, drift: Drift) {
        if let Commissioning::Following(follower) = &mut self.judge.commissioning {
            follower.restore(drift);
            self.judge.told.finding = drift.finding();
        }
    }
}

impl Judge<'_> {
    /// What the model says of a cycle by itself.
    pub(super) fn absolute(&self, valid: &ValidCycle<'_>) -> Absolute {
        let (estimate, novelty) = self.estimate(valid);
        let mut contributions = [0.0; MAX_FEATURES];
        self.attribution.contributions(self.model.ensemble(), valid.features, &mut contributions);
        Absolute { estimate, novelty, contributions }
    }

    fn estimate(&self, valid: &ValidCycle<'_>) -> (Estimate, OutOfDistribution) {
        let estimate = self.model.estimate_at(valid.features, valid.statistics.noise);
        let novelty = self.model.out_of_distribution(&estimate, &valid.statistics.phase_means());
        (estimate, novelty)
    }

    /// Whether there is a baseline.
    pub(super) fn is_following(&self) -> bool {
        matches!(self.commissioning, Commissioning::Following(_))
    }

    /// How far a cycle is from what is known: from the baseline where there is one, else from training. Above 1 it is unknown.
    pub(super) fn strangeness(&self, valid: &ValidCycle<'_>) -> f64 {
        let compared = match &self.commissioning {
            Commissioning::Following(follower) => follower.compare(self.model, valid),
            _ => None,
        };
        compared
            .map_or_else(|| self.estimate(valid).1.score, |(estimate, ..)| estimate.out_of_distribution.score)
    }

    /// Compares a cycle that ends at a time, s, with the baseline, where there is one.
    pub(super) fn follow_cycle(&mut self, valid: &ValidCycle<'_>, end_s: f64) -> Option<Followed> {
        match &mut self.commissioning {
            Commissioning::Following(follower) => follower.take(self.model, valid, end_s),
            _ => None,
        }
    }

    fn follow(&mut self, baseline: Baseline) {
        self.commissioning = Commissioning::Following(Box::new(Follower::new(baseline)));
        self.told = Told::default();
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
        match learner.baseline(self.model) {
            Ok(baseline) => {
                let mut text = format!("a baseline of {} cycles has been learned", baseline.cycles);
                for remark in &baseline.remarks {
                    text.push_str("; ");
                    text.push_str(remark);
                }
                self.follow(baseline);
                Some(Ok(text))
            }
            Err(message) => {
                let anew = Learner::new(learner.occasion(), learner.wanted());
                self.commissioning = Commissioning::Learning(anew);
                Some(Err(format!("no baseline: {message}; learning begins anew")))
            }
        }
    }
}

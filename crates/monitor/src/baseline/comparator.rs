//! Compares each cycle with the baseline.

use seepd_features::ValidCycle;
use seepd_features::segment::MAX_PHASES;
use seepd_model::causes::{Cause, Causes, ChangeVerdict};
use seepd_model::{Comparison, Estimate, Model, Relative, RelativeEstimate};
use serde::Serialize;

use super::Baseline;
use super::cusum::{Cusum, CusumFinding, CusumLimits};
use super::trend::{Growth, Trend};
use crate::cause::{self, Explained, Tracker};

/// Least standard deviation of the leak residual, m²: a machine without noise would count every rounding.
const LEAST_DEVIATION_M2: f64 = 2e-10;

/// What is known of a cycle's load.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum LoadKnowledge {
    /// It was measured, at the baseline too.
    Measured,
    /// It was not: it is seen in the command's phases, and the interval is wider.
    Inferred,
    /// Its signal stands still: taken as not measured.
    Frozen,
}

/// A cycle compared with the baseline.
#[derive(Debug, Clone, Copy)]
pub struct ComparedCycle {
    /// Estimate, leak residual, contributions, out-of-distribution score.
    pub estimate: RelativeEstimate,
    /// What is known of the load.
    pub load: LoadKnowledge,
    /// Load over the baseline's, less 1.
    pub load_change: Option<f64>,
    /// What the sums say after the cycle.
    pub finding: CusumFinding,
    /// Sum for a leak, standard deviations.
    pub sum: f64,
    /// How the leak grows, where it does.
    pub growth: Option<Growth>,
    /// What has changed, where the model names causes.
    pub explained: Option<Explained>,
    /// Whether the cycle is unlike everything that training has seen, and no known cause explains it.
    pub is_unlike: bool,
}

/// The estimate; where the cycle is like nothing in training, but its baseline is like a leaking machine's against this cycle, the machine
/// leaked at its baseline, and leaks less now, unless something says that it surely leaks more.
fn compare(
    relative: &Relative,
    comparison: &Comparison<'_>,
    surely_leaks_more: impl FnOnce() -> bool,
) -> RelativeEstimate {
    let Comparison { baseline, present, load_change, noise } = *comparison;
    let estimate = relative.estimate(comparison);
    if estimate.out_of_distribution.score <= 1.0 {
        return estimate;
    }
    let load_before = load_change.map(|change| 1.0 / (1.0 + change) - 1.0);
    let before = relative.estimate(&Comparison {
        baseline: present,
        present: baseline,
        load_change: load_before,
        noise,
    });
    if before.out_of_distribution.score > 1.0 || before.leak_residual_m2 <= 0.0 || surely_leaks_more() {
        return estimate;
    }
    let healthy_limit = relative.kind(load_change.is_some(), baseline).calibration.healthy_limit;
    RelativeEstimate {
        estimate: Estimate { value: 0.0, interval: [0.0, healthy_limit], ..estimate.estimate },
        leak_residual_m2: -before.leak_residual_m2,
        contributions_m2: before.contributions_m2.map(|part| -part),
        out_of_distribution: before.out_of_distribution,
    }
}

/// A machine that is compared from its baseline on.
#[derive(Debug, Clone)]
pub struct BaselineComparator {
    baseline: Baseline,
    /// The model's causes as this machine shows them, where its phases scatter more than noise makes them.
    causes: Option<Causes>,
    cusum: Cusum,
    trend: Trend,
    tracker: Tracker,
}

impl BaselineComparator {
    /// Follows from a baseline that was learned with a model.
    pub fn new(baseline: Baseline, model: &Model) -> Self {
        let causes = model.causes().filter(|causes| causes.file().errors_are_even);
        let repeatability = [&baseline.deviation[..], &baseline.rise_deviation].concat();
        let causes = causes.and_then(|causes| causes.of_machine(baseline.noise, &repeatability));
        BaselineComparator {
            baseline,
            causes,
            cusum: Cusum::default(),
            trend: Trend::default(),
            tracker: Tracker::default(),
        }
    }

    /// The baseline.
    pub fn baseline(&self) -> &Baseline {
        &self.baseline
    }

    /// The sums.
    pub fn cusum(&self) -> &Cusum {
        &self.cusum
    }

    /// Takes the sums up where an earlier run left them.
    pub fn restore(&mut self, cusum: Cusum) {
        self.cusum = cusum;
    }

    /// The machine may be another one from the next cycle on: its causes are looked for anew.
    pub fn begin_anew(&mut self) {
        self.tracker.begin_anew();
    }

    /// The seal is another one: its sums and its trend begin anew.
    pub fn forget_leak(&mut self) {
        self.cusum = Cusum::default();
        self.trend.clear();
    }

    /// Compares a cycle, and remembers nothing of it: the estimate, what is known of the load, and its change.
    pub fn compare(
        &self,
        model: &Model,
        cycle: &ValidCycle<'_>,
    ) -> Option<(RelativeEstimate, LoadKnowledge, Option<f64>)> {
        let (load, load_change) = self.load_of(cycle);
        let estimate = self.compare_means(model, cycle, &cycle.statistics.phase_means(), load_change)?;
        Some((estimate, load, load_change))
    }

    /// Compares means that are a cycle's, or were made of it.
    fn compare_means(
        &self,
        model: &Model,
        cycle: &ValidCycle<'_>,
        means: &[f64],
        load_change: Option<f64>,
    ) -> Option<RelativeEstimate> {
        let (relative, noise) = (model.relative()?, cycle.statistics.noise);
        let present = means.get(..relative.phases())?;
        let comparison = Comparison { baseline: &self.baseline.mean, present, load_change, noise };
        let surely_leaks_more = || {
            let [least_m2, _] = model.estimate_at(cycle.features, noise).interval;
            least_m2 > self.baseline.absolute_interval90_m2[1]
        };
        Some(compare(relative, &comparison, surely_leaks_more))
    }

    /// What has changed. A valve with a dead band answers to causes in its own way, of which training knows nothing, unless the plant is
    /// known to have the machine's own, or causes were learned for an adopted machine: there from valves with and without one, and with room.
    fn explain(&mut self, model: &Model, cycle: &ValidCycle<'_>) -> Option<Explained> {
        let is_plain = model.relative()?.deadband(&self.baseline.mean).is_none();
        let causes = self.causes.as_ref().or(model.causes())?;
        let file = causes.file();
        if !(is_plain || file.knows_dead_band || file.sizes_leaks) {
            return None;
        }
        self.tracker.take(causes, &self.baseline, cycle)
    }

    /// The estimate beside the cause that has been found, its response taken off, or that of a leak beyond training; `None` where the plain
    /// estimate stands.
    fn beside(
        &self,
        model: &Model,
        cycle: &ValidCycle<'_>,
        explained: &Explained,
        (plain, load_change): (&RelativeEstimate, Option<f64>),
        absolute_m2: Option<f64>,
    ) -> Option<RelativeEstimate> {
        let relative = model.relative()?;
        let explanation = &explained.explanation;
        let is_beyond_training = plain.out_of_distribution.score > 1.0;
        if is_beyond_training && explanation.verdict == ChangeVerdict::Named(Cause::PistonSeal, None) {
            let is_sure = explained.agreeing >= cause::TOLD_AFTER;
            return cause::leak_beyond_training(explanation, *plain).filter(|_| is_sure);
        }
        let present = cycle.statistics.phase_means();
        let given = |means: &[f64]| self.compare_means(model, cycle, means, load_change);
        let mut of_mean = [0.0; MAX_PHASES];
        let changes = self.baseline.mean.iter().zip(self.tracker.mean_change());
        for (slot, (before, change)) in of_mean.iter_mut().zip(changes) {
            *slot = before + change;
        }
        let causes = model.causes()?.file();
        let leak = cause::named_leak(explained).filter(|_| causes.sizes_leaks);
        let absolute_m2 = absolute_m2.filter(|_| causes.fitted);
        let law = &explanation.leak_of_other_law;
        // Intervals of a plant that was fitted to a log are calibrated on leaks of every law.
        let under_any_law = |now, of_mean| cause::under_any_law(law, causes.fitted, now, of_mean);
        let middle_sized =
            |given| leak.map_or(given, |leak| cause::middle_sized(leak, law, absolute_m2, given));
        if explanation.verdict == ChangeVerdict::Named(Cause::PistonSeal, None) {
            return Some(middle_sized(under_any_law(*plain, &given(&of_mean)?)));
        }
        // Beside a leak the other cause must be certain: it would carry the baseline over what nobody knows.
        let (kind, has_leak) = explanation.other.filter(|_| explanation.verdict != ChangeVerdict::Unknown)?;
        let hides_a_leak = !has_leak && explanation.seal >= cause::IN_DOUBT && !is_beyond_training;
        if hides_a_leak {
            return None;
        }
        if !cause::is_taken_off(kind, load_change.is_some(), is_beyond_training) {
            return leak.map(|_| middle_sized(*plain));
        }
        let without = |means: &mut [f64]| {
            means.iter_mut().zip(&explanation.response).for_each(|(mean, response)| *mean -= response);
        };
        let mut present = present;
        without(&mut present);
        without(&mut of_mean);
        let given = under_any_law(given(&present)?, &given(&of_mean)?);
        // A machine whose plant is not quite its own has cycles like nothing in training; one of them is no leak beside something.
        let is_sudden = causes.sizes_leaks && explained.agreeing < cause::TOLD_AFTER;
        if has_leak && is_sudden && given.out_of_distribution.score > 1.0 {
            return None;
        }
        let healthy_limit_m2 =
            relative.kind(load_change.is_some(), &self.baseline.mean).calibration.healthy_limit;
        Some(middle_sized(cause::beside(explanation, has_leak, given, healthy_limit_m2)))
    }

    /// Compares a cycle that ends at a time, s. One unlike everything that training has seen leaves sums and trend alone. `absolute_m2` is
    /// the leak that the model sees without the baseline, where the cycle is like those that it was trained with.
    pub fn take(
        &mut self,
        model: &Model,
        cycle: &ValidCycle<'_>,
        end_s: f64,
        absolute_m2: Option<f64>,
    ) -> Option<ComparedCycle> {
        let (plain, load, load_change) = self.compare(model, cycle)?;
        let relative = model.relative()?;
        let explained = self.explain(model, cycle);
        let beside = explained
            .as_ref()
            .and_then(|explained| self.beside(model, cycle, explained, (&plain, load_change), absolute_m2));
        let is_beyond_training = plain.out_of_distribution.score > 1.0;
        let is_unlike = beside.is_none() && is_beyond_training;
        let mut estimate = beside.unwrap_or(plain);
        let sizes_leaks = model.causes().is_some_and(|causes| causes.file().sizes_leaks);
        let in_doubt = explained.as_ref().filter(|_| sizes_leaks).and_then(cause::doubtful_leak);
        if let Some(seal) = in_doubt.filter(|_| !is_unlike) {
            estimate = cause::no_larger_than(seal, estimate);
        }
        if !is_unlike {
            let counted =
                explained.as_ref().map_or(1.0, |explained| cause::share_of_seal(&explained.explanation));
            let residual_m2 = counted * estimate.leak_residual_m2;
            let mut limits = self.limits(relative, load_change.is_some(), is_beyond_training);
            if explained.as_ref().is_some_and(cause::is_surely_a_leak) {
                // What load, oil and supply may do has been weighed already.
                limits.reference_m2 = 0.0;
            }
            self.cusum.take(residual_m2, &limits);
            if self.cusum.cycles_since_onset() == 0 {
                self.trend.clear();
            } else {
                self.trend.take(end_s, estimate.estimate.value);
            }
        }
        let finding = self.cusum.finding();
        let growth = if finding == CusumFinding::Leak { self.trend.growth() } else { None };
        let sum = self.cusum.sum();
        Some(ComparedCycle { estimate, load, load_change, finding, sum, growth, explained, is_unlike })
    }

    fn limits(&self, relative: &Relative, knows_load: bool, is_doubtful: bool) -> CusumLimits {
        let baseline = &self.baseline;
        let deviation_m2 = baseline
            .load_residual_deviation_m2
            .filter(|_| knows_load)
            .unwrap_or(baseline.residual_deviation_m2)
            .max(LEAST_DEVIATION_M2);
        CusumLimits {
            reference_m2: relative.kind(knows_load, &baseline.mean).reference_m2,
            deviation_m2,
            threshold: relative.file().detection.threshold,
            is_doubtful,
        }
    }

    fn load_of(&self, cycle: &ValidCycle<'_>) -> (LoadKnowledge, Option<f64>) {
        match (self.baseline.load_n, cycle.statistics.load) {
            (Some(_), Some(load)) if load.is_frozen() => (LoadKnowledge::Frozen, None),
            (Some(before_n), Some(load)) => (LoadKnowledge::Measured, Some(load.mean_n / before_n - 1.0)),
            _ => (LoadKnowledge::Inferred, None),
        }
    }
}

#[cfg(test)]
mod tests {
    use seepd_model::ModelFile;
    use seepd_model::causes::Change;

    use super::*;

    /// A model of an adopted machine: causes are told apart by what this machine repeats. The shipped press is told apart by its noise alone.
    #[test]
    fn causes_of_an_adopted_machine_know_what_it_repeats() {
        let mut file: ModelFile =
            serde_json::from_slice(include_bytes!("../../../daemon/assets/model.json")).unwrap();
        let mut causes_of_its_own = |errors_are_even| {
            let causes = file.causes.as_mut().unwrap();
            (causes.errors_are_even, causes.golden) = (errors_are_even, Vec::new());
            let model = Model::from_file(file.clone()).unwrap();
            let phases = model.file().cycle.phases.len();
            // The first phase scatters ten times as much as noise makes the others.
            let scatter: Vec<f64> = (0..phases).map(|at| if at == 0 { 1e-2 } else { 1e-5 }).collect();
            let zeros = vec![0.0; phases];
            let baseline = serde_json::json!({
                "occasion": "a test", "from_ns": 0, "to_ns": 1, "cycles": 30, "left_out": 0,
                "mean": zeros, "rise": zeros, "deviation": scatter, "rise_deviation": zeros,
                "response_deviation_m2": 1e-9, "load_response_deviation_m2": null, "load_n": null,
                "noise": 1e-3, "absolute_leak_area_m2": 0.0, "absolute_interval90_m2": [0.0, 1e-8], "remarks": [],
            });
            BaselineComparator::new(serde_json::from_value(baseline).unwrap(), &model).causes
        };
        assert!(causes_of_its_own(false).is_none());
        let own = causes_of_its_own(true).unwrap();
        let phases = own.numbers() / 2;
        // As much as before is noise for a phase that scatters, and the others are as they were.
        let change = |at: usize| {
            let mut numbers = vec![0.0; 2 * phases];
            numbers[at] = 1e-2;
            numbers
        };
        let distance = |numbers: &[f64]| own.distance(&Change { numbers, noise: 1e-3 });
        assert!(distance(&change(0)) < 0.2 && distance(&change(1)) > 1.0);
    }

    /// A machine that leaked at its baseline and leaks no more answers the other way round: no leak, unless the estimate without a baseline
    /// is sure that it leaks more.
    #[test]
    fn a_comparison_is_turned_round_unless_the_machine_surely_leaks_more() {
        let file: ModelFile =
            serde_json::from_slice(include_bytes!("../../../daemon/assets/model.json")).unwrap();
        let model = Model::from_file(file).unwrap();
        let relative = model.relative().unwrap();
        let leaks = relative.file().golden.iter().filter(|golden| golden.estimate > 1e-7);
        let mut turned = 0;
        for golden in leaks {
            let renewed = Comparison {
                baseline: &golden.present,
                present: &golden.baseline,
                load_change: None,
                noise: golden.noise,
            };
            let plain = relative.estimate(&renewed);
            if plain.out_of_distribution.score <= 1.0 {
                continue;
            }
            let given = compare(relative, &renewed, || false);
            if given.estimate.value == 0.0 && given.leak_residual_m2 < 0.0 {
                turned += 1;
                assert_eq!(compare(relative, &renewed, || true), plain);
            }
        }
        assert!(turned > 0);
    }
}

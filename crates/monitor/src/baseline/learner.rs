//! Gathers a baseline from cycles.

use seepd_features::ValidCycle;
use seepd_features::segment::MAX_PHASES;
use seepd_model::{Comparison, Estimate, Model, Relative};

use super::{Baseline, BaselineError, LEAST_CYCLES, LEAST_LOAD_N, MOST_CYCLES, relative_of};

/// Baselines further from training than this many standard deviations are remarked on.
const FAR: f64 = 4.0;
/// Share of cycles unlike the others that is remarked on.
const MANY: f64 = 0.1;

/// A cycle as far as a baseline needs it.
#[derive(Debug, Clone, Copy)]
struct Learned {
    start_ns: i64,
    end_ns: i64,
    means: [f64; MAX_PHASES],
    rises: [f64; MAX_PHASES],
    noise: f64,
    load_n: Option<f64>,
    absolute: Estimate,
}

/// Cycles of a machine that is taken for healthy.
#[derive(Debug, Clone)]
pub struct Learner {
    occasion: String,
    wanted: usize,
    cycles: Vec<Learned>,
}

impl Learner {
    /// Gathers so many cycles, within [`LEAST_CYCLES`] and [`MOST_CYCLES`].
    pub fn new(occasion: &str, wanted: usize) -> Self {
        let wanted = wanted.clamp(LEAST_CYCLES, MOST_CYCLES);
        Learner { occasion: occasion.into(), wanted, cycles: Vec::with_capacity(wanted) }
    }

    /// Takes a cycle with its absolute estimate.
    pub fn take(&mut self, cycle: &ValidCycle<'_>, absolute: Estimate) {
        if self.is_full() {
            return;
        }
        self.cycles.push(Learned {
            start_ns: cycle.start_ns,
            end_ns: cycle.end_ns,
            means: cycle.statistics.phase_means(),
            rises: cycle.statistics.phase_rises(),
            noise: cycle.statistics.noise,
            load_n: cycle.statistics.load.filter(|load| !load.is_frozen()).map(|load| load.mean_n),
            absolute,
        });
    }

    /// What it is learned for.
    pub fn occasion(&self) -> &str {
        &self.occasion
    }

    /// Cycles so far.
    pub fn cycles(&self) -> usize {
        self.cycles.len()
    }

    /// Cycles that are wanted.
    pub fn wanted(&self) -> usize {
        self.wanted
    }

    /// Whether there are enough cycles.
    pub fn is_full(&self) -> bool {
        self.cycles.len() >= self.wanted
    }

    /// The baseline of the cycles so far.
    ///
    /// # Errors
    /// [`BaselineError`]: the model cannot compare, too few cycles, or too few that are alike.
    pub fn baseline(&self, model: &Model) -> Result<Baseline, BaselineError> {
        let relative = relative_of(model)?;
        let phases = relative.phases();
        if self.cycles.len() < LEAST_CYCLES {
            return Err(BaselineError::TooFewCycles { usable: self.cycles.len() });
        }
        let middle: Vec<f64> =
            (0..phases).map(|phase| median(self.cycles.iter().map(|cycle| cycle.means[phase]))).collect();
        let is_alike =
            |cycle: &&Learned| compare(relative, &middle, cycle, None).out_of_distribution.score <= 1.0;
        let kept: Vec<&Learned> = self.cycles.iter().filter(is_alike).collect();
        if kept.len() < LEAST_CYCLES {
            let cycles = self.cycles.len();
            return Err(BaselineError::TooFewAlike { cycles, unlike: cycles - kept.len() });
        }
        Ok(self.describe(relative, &kept, phases))
    }

    fn describe(&self, relative: &Relative, kept: &[&Learned], phases: usize) -> Baseline {
        let count = kept.len() as f64;
        let average = |of: &dyn Fn(&Learned) -> f64| kept.iter().map(|cycle| of(cycle)).sum::<f64>() / count;
        let mean: Vec<f64> = (0..phases).map(|phase| average(&|cycle| cycle.means[phase])).collect();
        let rise = (0..phases).map(|phase| average(&|cycle| cycle.rises[phase])).collect();
        let repeatability =
            (0..phases).map(|phase| deviation(kept.iter().map(|cycle| cycle.means[phase]))).collect();
        let loads: Vec<f64> = kept.iter().filter_map(|cycle| cycle.load_n).collect();
        let load_n = (loads.len() == kept.len())
            .then(|| loads.iter().sum::<f64>() / count)
            .filter(|load_n| load_n.abs() >= LEAST_LOAD_N);
        let residuals: Vec<f64> =
            kept.iter().map(|cycle| compare(relative, &mean, cycle, None).leak_residual_m2).collect();
        let with_load = load_n.map(|load_n| {
            deviation(kept.iter().map(|cycle| compare(relative, &mean, cycle, Some(load_n)).leak_residual_m2))
        });
        let absolute = |of: fn(&Estimate) -> f64| median(kept.iter().map(|cycle| of(&cycle.absolute)));
        let mut baseline = Baseline {
            occasion: self.occasion.clone(),
            from_ns: kept.first().map_or(0, |cycle| cycle.start_ns),
            to_ns: kept.last().map_or(0, |cycle| cycle.end_ns),
            cycles: kept.len(),
            left_out: self.cycles.len() - kept.len(),
            residual_deviation_m2: deviation(residuals.iter().copied()),
            load_residual_deviation_m2: with_load,
            load_n,
            noise: median(kept.iter().map(|cycle| cycle.noise)),
            absolute_leak_area_m2: absolute(|estimate| estimate.value),
            absolute_interval90_m2: [
                absolute(|estimate| estimate.interval[0]),
                absolute(|estimate| estimate.interval[1]),
            ],
            mean,
            rise,
            deviation: repeatability,
            rise_deviation: (0..phases)
                .map(|phase| deviation(kept.iter().map(|cycle| cycle.rises[phase])))
                .collect(),
            remarks: Vec::new(),
        };
        baseline.remarks = remarks(&baseline, relative, &residuals);
        baseline
    }
}

/// What a person should know before trusting a baseline.
fn remarks(baseline: &Baseline, relative: &Relative, residuals: &[f64]) -> Vec<String> {
    let mut remarks = Vec::new();
    if baseline.absolute_interval90_m2[0] > 0.0 {
        remarks.push(format!(
            "the model alone sees a leak of {:.3} mm² in these cycles: if the seal was worn already, estimates count \
             from there, and a new seal will show as an improvement",
            1e6 * baseline.absolute_leak_area_m2
        ));
    }
    let distance = relative.baseline_distance(&baseline.mean);
    if distance > FAR {
        remarks.push(format!(
            "the machine lies {distance:.1} standard deviations from those that the model was trained on: sizes of leaks may be off; \
             train a model on its own plant file"
        ));
    }
    if let Some(half_width) = relative.deadband(&baseline.mean).filter(|_| distance <= FAR) {
        remarks.push(format!(
            "the valve seems to have a dead band of {:.1} % of full command beyond the plant file's: leaks are compared with machines like it, \
             and are found from somewhat larger ones on",
            100.0 * half_width
        ));
    }
    let total = (baseline.cycles + baseline.left_out) as f64;
    if baseline.left_out as f64 > MANY * total {
        remarks.push(format!(
            "{} of {total} cycles differ from the others and were left out",
            baseline.left_out
        ));
    }
    let third = residuals.len() / 3;
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
    let change = mean(&residuals[residuals.len() - third..]) - mean(&residuals[..third]);
    let chance = 4.0 * baseline.residual_deviation_m2 * (2.0 / third.max(1) as f64).sqrt();
    let reference_m2 = relative.kind(false, &baseline.mean).reference_m2;
    if change.abs() > chance + reference_m2 {
        remarks.push(format!(
            "from the first cycles to the last the machine changed by {:+.4} mm² of leak: it was warming up, or it is wearing",
            1e6 * change
        ));
    }
    remarks
}

fn compare(
    relative: &Relative,
    baseline: &[f64],
    cycle: &Learned,
    load_n: Option<f64>,
) -> seepd_model::RelativeEstimate {
    let present = cycle.means.get(..relative.phases()).unwrap_or_default();
    let load_change = load_n.and_then(|mean_n| Some(cycle.load_n? / mean_n - 1.0));
    relative.estimate(&Comparison { baseline, present, load_change, noise: cycle.noise })
}

/// Median; 0 of none.
pub(crate) fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

fn deviation(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let count = values.clone().count().max(2) as f64;
    let mean = values.clone().sum::<f64>() / count;
    (values.map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0)).sqrt()
}

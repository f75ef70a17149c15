//! Gathers the healthy machine's cycles.

use seepd_features::ValidCycle;
use seepd_model::schema::Cycle;

use super::{FeatureBaseline, LEAST_CYCLES, RelativeBaseline, RelativeError, SCHEMA, feature_names};
use crate::baseline::MOST_CYCLES;
use crate::baseline::learner::median;

/// A cycle is unlike the others from this root mean square of its distances on, in robust standard deviations.
const UNLIKE: f64 = 4.0;
/// Standard deviation of a normal distribution over its median absolute deviation.
const PER_MEDIAN_DEVIATION: f64 = 1.4826;
/// Least spread by which cycles are told apart, share of full command.
const LEAST_SPREAD: f64 = 1e-4;
/// Share of cycles unlike the others that is remarked on.
const MANY: f64 = 0.1;
/// Standard errors from which on a drift over the cycles is remarked on.
const DRIFTED: f64 = 6.0;

/// A cycle's numbers, its start and end in ns.
#[derive(Debug, Clone)]
struct Learned {
    values: Vec<f64>,
    span_ns: (i64, i64),
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
        Learner {
            occasion: occasion.into(),
            wanted: wanted.clamp(LEAST_CYCLES, MOST_CYCLES),
            cycles: Vec::new(),
        }
    }

    /// An empty one for the same.
    pub fn anew(&self) -> Self {
        Learner::new(&self.occasion, self.wanted)
    }

    /// Takes a cycle.
    pub(super) fn take(&mut self, cycle: &ValidCycle<'_>, values: &[f64]) {
        self.take_values(values, (cycle.start_ns, cycle.end_ns));
    }

    pub(super) fn take_values(&mut self, values: &[f64], span_ns: (i64, i64)) {
        if !self.is_full() {
            self.cycles.push(Learned { values: values.to_vec(), span_ns });
        }
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

    /// The baseline of the cycles so far, which were read as cycles of that kind at that rate.
    ///
    /// # Errors
    /// [`RelativeError::TooFewCycles`], [`RelativeError::TooFewAlike`].
    pub(super) fn baseline_of(
        &self,
        axis: &str,
        (cycle, sample_rate_hz): (Cycle, f64),
    ) -> Result<RelativeBaseline, RelativeError> {
        let cycles = self.cycles.len();
        if cycles < LEAST_CYCLES {
            return Err(RelativeError::TooFewCycles { usable: cycles });
        }
        let kept = self.alike();
        if kept.len() < LEAST_CYCLES {
            return Err(RelativeError::TooFewAlike { cycles, unlike: cycles - kept.len() });
        }
        let names = feature_names(&cycle);
        let features: Vec<FeatureBaseline> = names
            .into_iter()
            .enumerate()
            .map(|(index, name)| {
                feature_of(name, &kept.iter().map(|cycle| cycle.values[index]).collect::<Vec<_>>())
            })
            .collect();
        Ok(RelativeBaseline {
            schema: SCHEMA.into(),
            axis: axis.into(),
            created_by: concat!("seepd ", env!("CARGO_PKG_VERSION")).into(),
            occasion: self.occasion.clone(),
            from_ns: kept.first().map_or(0, |cycle| cycle.span_ns.0),
            to_ns: kept.last().map_or(0, |cycle| cycle.span_ns.1),
            cycles: kept.len(),
            left_out: cycles - kept.len(),
            sample_rate_hz,
            remarks: remarks(&kept, cycles, &features),
            cycle,
            features,
        })
    }

    /// The cycles that are like most of them: medians and median deviations are none of a few odd cycles' making.
    fn alike(&self) -> Vec<&Learned> {
        let width = self.cycles.first().map_or(0, |cycle| cycle.values.len());
        let centres: Vec<(f64, f64)> = (0..width)
            .map(|index| {
                let centre = median(self.cycles.iter().map(|cycle| cycle.values[index]));
                let spread = median(self.cycles.iter().map(|cycle| (cycle.values[index] - centre).abs()));
                (centre, (PER_MEDIAN_DEVIATION * spread).max(LEAST_SPREAD))
            })
            .collect();
        let distance = |cycle: &Learned| {
            let squares = cycle
                .values
                .iter()
                .zip(&centres)
                .map(|(value, (centre, spread))| ((value - centre) / spread).powi(2));
            (squares.sum::<f64>() / width.max(1) as f64).sqrt()
        };
        self.cycles.iter().filter(|cycle| distance(cycle) <= UNLIKE).collect()
    }
}

fn feature_of(name: String, values: &[f64]) -> FeatureBaseline {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    let products: f64 = values.windows(2).map(|pair| (pair[0] - mean) * (pair[1] - mean)).sum();
    let autocorrelation = if squares > 0.0 { (products / squares).clamp(-1.0, 1.0) } else { 0.0 };
    FeatureBaseline { name, mean, deviation: (squares / (count - 1.0)).sqrt(), autocorrelation }
}

/// What a person should know before trusting a baseline.
fn remarks(kept: &[&Learned], cycles: usize, features: &[FeatureBaseline]) -> Vec<String> {
    let mut remarks = Vec::new();
    let left_out = cycles - kept.len();
    if left_out as f64 > MANY * cycles as f64 {
        remarks.push(format!("{left_out} of {cycles} cycles differ from the others and were left out"));
    }
    let third = kept.len() / 3;
    let mean = |cycles: &[&Learned], index: usize| {
        cycles.iter().map(|cycle| cycle.values[index]).sum::<f64>() / cycles.len().max(1) as f64
    };
    let drift = |index: usize, feature: &FeatureBaseline| {
        let change = mean(&kept[kept.len() - third..], index) - mean(&kept[..third], index);
        change.abs() / (feature.deviation.max(LEAST_SPREAD) * (2.0 / third as f64).sqrt())
    };
    let most = features
        .iter()
        .enumerate()
        .map(|(index, feature)| (drift(index, feature), &feature.name))
        .max_by(|a, b| a.0.total_cmp(&b.0));
    if let Some((_, name)) = most.filter(|(drift, _)| *drift > DRIFTED) {
        remarks.push(format!(
            "from the first cycles to the last the command drifted, most in {name}: the machine was warming up, or it is wearing"
        ));
    }
    remarks
}

#[cfg(test)]
pub(super) fn test_cycle(phases: usize) -> (Cycle, f64) {
    use seepd_features::{Anchor, PhaseKind};
    use seepd_model::schema::PhaseFile;

    let anchor = |end_s: f64| Anchor {
        end_s,
        least_correlation: 0.8,
        sure_correlation: 1.0,
        least_deviation: 0.01,
        wait_s: 0.0,
        template: vec![-0.5, 0.5, 0.5, -0.5],
    };
    let part = |index: usize| PhaseFile {
        name: format!("part_{}", index + 1),
        from_s: index as f64,
        to_s: index as f64 + 1.0,
        kind: PhaseKind::Hold,
    };
    let cycle = Cycle {
        period_s: 10.0,
        bin_samples: 50,
        tolerance: 0.08,
        anchors: [anchor(2.0), anchor(7.0)],
        further_anchors: Vec::new(),
        demand_mark: None,
        phases: (0..phases).map(part).collect(),
    };
    (cycle, 1000.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn learner(values: impl Fn(usize) -> f64, cycles: usize) -> Learner {
        let mut learner = Learner::new("test", cycles);
        for cycle in 0..cycles {
            let (value, at) = (values(cycle), 10 * cycle as i64);
            learner.take_values(&[value, 0.1, 0.0, 0.0], (at, at + 10));
        }
        learner
    }

    /// Values 1, 2, 1, 2 … (·1e-2): mean 1.5, standard deviation √(n/4/(n−1)), correlation −(n−1)/n.
    #[test]
    fn analytic_numbers_of_an_alternating_machine() {
        let baseline =
            learner(|cycle| 0.01 + 0.01 * (cycle % 2) as f64, 30).baseline_of("axis", test_cycle(2)).unwrap();
        let first = &baseline.features[0];
        assert_eq!((first.name.as_str(), baseline.features[2].name.as_str()), ("mean.part_1", "rise.part_1"));
        assert!(
            (first.mean - 0.015).abs() < 1e-12
                && (first.deviation - 0.01 * (7.5f64 / 29.0).sqrt()).abs() < 1e-12
        );
        assert!((first.autocorrelation + 29.0 / 30.0).abs() < 1e-12);
        let text = baseline.to_json().unwrap();
        assert_eq!(RelativeBaseline::parse(&text).unwrap(), baseline);
        let broken = text.replace("\"period_s\": 10.0", "\"period_s\": -1.0");
        let endless = text.replace("\"sample_rate_hz\": 1000.0", "\"sample_rate_hz\": 100000.0");
        let endless = endless.replace("\"period_s\": 10.0", "\"period_s\": 3600.0");
        assert_eq!(
            RelativeBaseline::parse(&endless).unwrap_err().to_string(),
            "a cycle must have at most 16 million samples"
        );
        assert_eq!(
            RelativeBaseline::parse(&broken).unwrap_err().to_string(),
            "cycle.period_s must lie in 0.1 … 3600"
        );
    }

    #[test]
    fn odd_cycles_are_left_out_and_drifts_are_remarked_on() {
        let odd = learner(|cycle| if cycle % 6 == 5 { 0.5 } else { 0.0 }, 36)
            .baseline_of("axis", test_cycle(2))
            .unwrap();
        assert_eq!((odd.cycles, odd.left_out), (30, 6));
        assert_eq!(odd.remarks, ["6 of 36 cycles differ from the others and were left out"]);
        let warming = learner(|cycle| 1e-4 * cycle as f64, 60).baseline_of("axis", test_cycle(2)).unwrap();
        assert!(warming.remarks[0].contains("most in mean.part_1"), "{:?}", warming.remarks);
        let few = learner(|_| 0.0, 12).baseline_of("axis", test_cycle(2)).unwrap_err();
        assert!(matches!(few, RelativeError::TooFewCycles { usable: 12 }));
    }
}

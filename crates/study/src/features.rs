//! The article's features over the leak area (figure 7) and under noise (figures 8 and 9).

use bhtsne::tSNE;
use seepd_features::statistics::CycleStatistics;
use seepd_features::{CycleDefinition, Feature, Kalman, Phase};
use seepd_model::Model;
use seepd_model::schema::Filter;
use seepd_sim::MachineSpec;
use seepd_sim::noise::Noise;
use seepd_train::dataset::{self, Observation, Reading};
use serde::Serialize;

use crate::{AREAS_M2, NOISE_LEVELS, StudyError, geometric};

/// The article's five features, as the monitor names them.
pub const FIVE: [&str; 5] = ["mean", "standard_deviation", "skewness", "kurtosis", "pca_1"];
/// Leaks of figure 7, and of figures 8 and 9.
const AREAS: usize = 240;
const NOISE_AREAS: usize = 40;
/// Perplexity of t-SNE, and its steps.
const PERPLEXITY: f32 = 30.0;
const EPOCHS: usize = 1000;

/// The program's model as a way to look at cycles.
pub(crate) struct Lens<'m> {
    pub(crate) model: &'m Model,
    phases: Vec<Phase>,
    pub(crate) filter: Option<Kalman>,
    five: [Feature; 5],
    all: Vec<Feature>,
}

impl<'m> Lens<'m> {
    pub(crate) fn new(model: &'m Model) -> Result<Self, StudyError> {
        let file = model.file();
        let kind = |name: &str| {
            let phases = file.cycle.phases.iter().map(|phase| phase.name.as_str());
            Feature::from_name(name, phases, file.projections.iter().map(|p| p.name.as_str()))
        };
        let mut five = [Feature::Projection(0); 5];
        for (slot, name) in five.iter_mut().zip(FIVE) {
            *slot = kind(name).ok_or(StudyError::NoFeature(name))?;
        }
        Ok(Lens {
            model,
            phases: file.cycle.phase_list(),
            filter: file.filter.as_ref().map(|Filter::Kalman(kalman)| *kalman),
            five,
            all: file.features.iter().filter_map(|name| kind(name)).collect(),
        })
    }

    fn reading(&self) -> Reading<'_> {
        let file = self.model.file();
        Reading {
            cycle: &file.cycle,
            phases: &self.phases,
            sample_rate_hz: file.sample_rate_hz,
            projections: self.model.projections(),
        }
    }

    fn definition(&self) -> CycleDefinition<'_> {
        self.reading().definition()
    }

    pub(crate) fn five(&self, statistics: &CycleStatistics) -> [f64; 5] {
        self.five.map(|feature| feature.of(&self.definition(), statistics))
    }

    /// The model's own features.
    pub(crate) fn all(&self, statistics: &CycleStatistics) -> Vec<f64> {
        self.all.iter().map(|feature| feature.of(&self.definition(), statistics)).collect()
    }

    /// Each machine's cycle as read at each noise level; the same noise, scaled. Cycles that are not found are left out.
    pub(crate) fn read(
        &self,
        observations: &[Observation],
        filter: Option<Kalman>,
        levels: &[f64],
        seed: u64,
    ) -> Result<Vec<Cycle>, StudyError> {
        let reading = self.reading();
        let read = dataset::simulate(observations, |index, commands| {
            let mut noise = Noise::new(seed ^ 0x0073_7475_6479, observations[index].stream);
            let unit = dataset::unit_noise(&mut noise, commands.len());
            let statistics: Option<Vec<CycleStatistics>> =
                levels.iter().map(|sigma| reading.read(commands, filter, *sigma, &unit)).collect();
            Some(Cycle { leak_area_m2: observations[index].leak_area_m2, by_noise: statistics? })
        });
        let cycles: Vec<Cycle> = read.into_iter().flatten().collect();
        if cycles.len() * 100 < observations.len() * 95 {
            return Err(StudyError::Unrecognised { found: cycles.len(), simulated: observations.len() });
        }
        Ok(cycles)
    }
}

/// A machine's cycle, read at some noise levels.
pub(crate) struct Cycle {
    pub(crate) leak_area_m2: f64,
    pub(crate) by_noise: Vec<CycleStatistics>,
}

/// The nominal press with each of these leaks; `stream` numbers their noise.
pub(crate) fn presses(spec: &MachineSpec, areas_m2: &[f64], stream: u64) -> Vec<Observation> {
    (stream..)
        .zip(areas_m2)
        .map(|(stream, area)| Observation {
            spec: spec.clone(),
            load_factor: 1.0,
            stretch: 1.0,
            leak_area_m2: *area,
            laminar_share: 0.0,
            null_deviation: 0.0,
            extra_deadband: 0.0,
            stream,
        })
        .collect()
}

/// Figure 7.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FeatureStudy {
    /// Leak areas, m².
    pub leak_area_m2: Vec<f64>,
    /// The five features and two runs of t-SNE.
    pub curves: Vec<FeatureCurve>,
}

/// A feature over the leak area.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FeatureCurve {
    /// Name.
    pub name: String,
    /// Value at each area.
    pub values: Vec<f64>,
    /// Spearman's rank correlation with the area: ±1 for a curve that only rises or only falls.
    pub rank_correlation: f64,
    /// Share of the curve's whole way that is its net way, end to end: 1 for a monotonic curve, 0 for one that comes back. Taken
    /// over means of twelve neighbours, so that noise does not count.
    pub net_share: f64,
}

impl FeatureCurve {
    fn new(name: &str, areas_m2: &[f64], values: Vec<f64>) -> Self {
        let means: Vec<f64> =
            values.chunks(12).map(|part| part.iter().sum::<f64>() / part.len() as f64).collect();
        let way: f64 = means.windows(2).map(|pair| (pair[1] - pair[0]).abs()).sum();
        let net = means.first().zip(means.last()).map_or(0.0, |(first, last)| (last - first).abs());
        FeatureCurve {
            name: name.into(),
            rank_correlation: rank_correlation(areas_m2, &values),
            net_share: if way > 0.0 { net / way } else { 0.0 },
            values,
        }
    }
}

/// Figure 7: the nominal press, noise 0.001, Kalman filter.
pub(crate) fn by_area(lens: &Lens<'_>, spec: &MachineSpec, seed: u64) -> Result<FeatureStudy, StudyError> {
    let areas = geometric(AREAS_M2.0, AREAS_M2.1, AREAS);
    let cycles = lens.read(&presses(spec, &areas, 1 << 40), lens.filter, &NOISE_LEVELS[..1], seed)?;
    let leak_area_m2: Vec<f64> = cycles.iter().map(|cycle| cycle.leak_area_m2).collect();
    let five: Vec<[f64; 5]> = cycles.iter().map(|cycle| lens.five(&cycle.by_noise[0])).collect();
    let mut curves: Vec<FeatureCurve> = (0..5)
        .map(|k| FeatureCurve::new(FIVE[k], &leak_area_m2, five.iter().map(|row| row[k]).collect()))
        .collect();
    let bins: Vec<&[f32]> = cycles.iter().map(|cycle| cycle.by_noise[0].bins()).collect();
    let (first, second) = rayon::join(
        || first_tsne_dimension(&bins, seed),
        || first_tsne_dimension(&bins, seed.wrapping_add(1)),
    );
    for (name, values) in [("t-SNE 1, run 1", first?), ("t-SNE 1, run 2", second?)] {
        curves.push(FeatureCurve::new(name, &leak_area_m2, values));
    }
    Ok(FeatureStudy { leak_area_m2, curves })
}

/// First dimension of an embedding in the plane, from a random start. One thread each: sums over several threads differ from run
/// to run, and the embedding follows the smallest difference.
fn first_tsne_dimension(rows: &[&[f32]], seed: u64) -> Result<Vec<f64>, StudyError> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().map_err(|_| StudyError::NoThread)?;
    Ok(pool.install(|| embed(rows, seed)))
}

fn embed(rows: &[&[f32]], seed: u64) -> Vec<f64> {
    let mut noise = Noise::new(seed, 9);
    let start: Vec<f32> = (0..2 * rows.len()).map(|_| noise.normal(1e-4) as f32).collect();
    let mut tsne: tSNE<'_, f32, &[f32]> = tSNE::new(rows);
    tsne.perplexity(PERPLEXITY.min(rows.len() as f32 / 4.0))
        .epochs(EPOCHS)
        .initial_embedding(start)
        .exact(|a, b| a.iter().zip(*b).map(|(a, b)| (a - b) * (a - b)).sum::<f32>().sqrt());
    tsne.embedding().chunks(2).map(|point| f64::from(point[0])).collect()
}

/// Values by `[feature][noise][area]`.
pub type Levels = Vec<Vec<Vec<f64>>>;

/// Figures 8 and 9: the five features at five noise levels, without the filter and with it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NoiseStudy {
    /// Leak areas, m².
    pub leak_area_m2: Vec<f64>,
    /// Standard deviations of the noise.
    pub noise: Vec<f64>,
    /// Without the filter.
    pub without: Levels,
    /// With the filter.
    pub with: Levels,
    /// RMS change of each feature from the first noise level to the last over its range, without and with.
    pub change: Vec<[f64; 2]>,
}

/// Figures 8 and 9.
pub(crate) fn by_noise(lens: &Lens<'_>, spec: &MachineSpec, seed: u64) -> Result<NoiseStudy, StudyError> {
    let areas = geometric(AREAS_M2.0, AREAS_M2.1, NOISE_AREAS);
    let machines = presses(spec, &areas, 2 << 40);
    let curves = |filter: Option<Kalman>| -> Result<(Vec<f64>, Levels), StudyError> {
        let cycles = lens.read(&machines, filter, &NOISE_LEVELS, seed)?;
        let rows: Vec<Vec<[f64; 5]>> = cycles
            .iter()
            .map(|cycle| cycle.by_noise.iter().map(|statistics| lens.five(statistics)).collect())
            .collect();
        let of = |feature: usize, level: usize| rows.iter().map(|row| row[level][feature]).collect();
        let curves = (0..5).map(|k| (0..NOISE_LEVELS.len()).map(|level| of(k, level)).collect()).collect();
        Ok((cycles.iter().map(|cycle| cycle.leak_area_m2).collect(), curves))
    };
    let (_, without) = curves(None)?;
    let (leak_area_m2, with) = curves(lens.filter)?;
    let change = without.iter().zip(&with).map(|(a, b)| [relative_change(a), relative_change(b)]).collect();
    Ok(NoiseStudy { leak_area_m2, noise: NOISE_LEVELS.to_vec(), without, with, change })
}

/// RMS difference of the last level from the first, over the first one's range.
fn relative_change(levels: &[Vec<f64>]) -> f64 {
    let (Some(first), Some(last)) = (levels.first(), levels.last()) else { return f64::NAN };
    let range = first.iter().copied().fold(f64::NEG_INFINITY, f64::max)
        - first.iter().copied().fold(f64::INFINITY, f64::min);
    let square = first.iter().zip(last).map(|(a, b)| (a - b) * (a - b)).sum::<f64>() / first.len() as f64;
    square.sqrt() / range
}

/// Spearman's rank correlation.
fn rank_correlation(a: &[f64], b: &[f64]) -> f64 {
    let ranks = |values: &[f64]| -> Vec<f64> {
        let mut order: Vec<usize> = (0..values.len()).collect();
        order.sort_by(|i, j| values[*i].total_cmp(&values[*j]));
        let mut ranks = vec![0.0; values.len()];
        for (rank, index) in order.into_iter().enumerate() {
            ranks[index] = rank as f64;
        }
        ranks
    };
    let (a, b) = (ranks(a), ranks(b));
    let n = a.len() as f64;
    let squares: f64 = a.iter().zip(&b).map(|(a, b)| (a - b) * (a - b)).sum();
    1.0 - 6.0 * squares / (n * (n * n - 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn analytic_curves_have_their_rank_correlation_and_net_way() {
        let x: Vec<f64> = (0..96).map(f64::from).collect();
        let rising = FeatureCurve::new("rising", &x, x.iter().map(|x| x * x).collect());
        assert_eq!((rising.rank_correlation, rising.net_share), (1.0, 1.0));
        let falling = FeatureCurve::new("falling", &x, x.iter().map(|x| -x.exp().sqrt()).collect());
        assert_eq!((falling.rank_correlation, falling.net_share), (-1.0, 1.0));
        let back = FeatureCurve::new("back", &x, x.iter().map(|x| (x - 47.5).powi(2)).collect());
        assert!(back.net_share < 1e-9 && back.rank_correlation.abs() < 0.1);
    }
}

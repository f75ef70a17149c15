//! The features by name.
//!
//! Mean, standard deviation, skewness, kurtosis and the first principal component are the article's; amplitude
//! variation, rise and fall times, energy in steady state and in transients, trend and oscillation are those that
//! its conclusion asks for; the means by phase are ours, because a leak, the load, the valve and the oil's
//! temperature move them differently.

use crate::segment::{CycleDefinition, MAX_PHASES};
use crate::statistics::CycleStatistics;

/// A feature of a cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Feature {
    /// `mean`: mean command.
    Mean,
    /// `standard_deviation`.
    StandardDeviation,
    /// `skewness`.
    Skewness,
    /// `kurtosis`.
    Kurtosis,
    /// `mean_absolute`: mean magnitude of the command.
    MeanAbsolute,
    /// `amplitude`: largest less smallest command.
    Amplitude,
    /// `amplitude_variation`: coefficient of variation of the magnitude within strokes.
    AmplitudeVariation,
    /// `rise_time_s`: 10 % to 90 % of the first stroke's excursion.
    RiseTime,
    /// `fall_time_s`: 10 % to 90 % of the last stroke's excursion.
    FallTime,
    /// `energy_steady`: mean square in holds.
    EnergySteady,
    /// `energy_transient`: mean square in strokes.
    EnergyTransient,
    /// `trend_per_s`: slope in the longest hold.
    Trend,
    /// `oscillation`: RMS of the second difference over 20 ms in holds.
    Oscillation,
    /// `stroke_scale`: mean command of the first stroke less that of the last.
    StrokeScale,
    /// `mean.PHASE`: mean command of a phase.
    PhaseMean(u8),
    /// `slope.PHASE`: slope of the command in a phase, 1/s.
    PhaseSlope(u8),
    /// `relative.PHASE`: mean command of a phase over the stroke scale; the valve's size cancels.
    PhaseRelative(u8),
    /// A projection, by its own name.
    Projection(u8),
}

/// The features that have a name of their own.
const NAMED: [(&str, Feature); 14] = [
    ("mean", Feature::Mean),
    ("standard_deviation", Feature::StandardDeviation),
    ("skewness", Feature::Skewness),
    ("kurtosis", Feature::Kurtosis),
    ("mean_absolute", Feature::MeanAbsolute),
    ("amplitude", Feature::Amplitude),
    ("amplitude_variation", Feature::AmplitudeVariation),
    ("rise_time_s", Feature::RiseTime),
    ("fall_time_s", Feature::FallTime),
    ("energy_steady", Feature::EnergySteady),
    ("energy_transient", Feature::EnergyTransient),
    ("trend_per_s", Feature::Trend),
    ("oscillation", Feature::Oscillation),
    ("stroke_scale", Feature::StrokeScale),
];

impl Feature {
    /// Names of the features that need neither phase nor projection.
    pub fn names() -> impl Iterator<Item = &'static str> {
        NAMED.iter().map(|(name, _)| *name)
    }

    /// The feature of that name, given the names of phases and projections in their order.
    pub fn from_name<'n>(
        name: &str,
        mut phases: impl Iterator<Item = &'n str> + Clone,
        mut projections: impl Iterator<Item = &'n str>,
    ) -> Option<Feature> {
        if let Some((_, feature)) = NAMED.iter().find(|(known, _)| *known == name) {
            return Some(*feature);
        }
        if let Some(index) = projections.position(|projection| projection == name) {
            return u8::try_from(index).ok().map(Feature::Projection);
        }
        let (kind, phase) = name.split_once('.')?;
        let index = phases.position(|known| known == phase).filter(|index| *index < MAX_PHASES)?;
        let index = u8::try_from(index).ok()?;
        match kind {
            "mean" => Some(Feature::PhaseMean(index)),
            "slope" => Some(Feature::PhaseSlope(index)),
            "relative" => Some(Feature::PhaseRelative(index)),
            _ => None,
        }
    }

    /// Reads the feature off a cycle's statistics; 0 for a phase or projection that the definition lacks.
    pub fn of(self, definition: &CycleDefinition<'_>, statistics: &CycleStatistics) -> f64 {
        let s = statistics;
        let phase = |index: u8| s.phases.get(usize::from(index)).copied().unwrap_or_default();
        match self {
            Feature::Mean => s.moments.mean,
            Feature::StandardDeviation => s.moments.standard_deviation,
            Feature::Skewness => s.moments.skewness,
            Feature::Kurtosis => s.moments.kurtosis,
            Feature::MeanAbsolute => mean_absolute(s),
            Feature::Amplitude => s.extremes.1 - s.extremes.0,
            Feature::AmplitudeVariation => s.amplitude_variation,
            Feature::RiseTime => s.edge_times_s.0,
            Feature::FallTime => s.edge_times_s.1,
            Feature::EnergySteady => s.energy.1,
            Feature::EnergyTransient => s.energy.0,
            Feature::Trend => s.trend_per_s,
            Feature::Oscillation => s.oscillation,
            Feature::StrokeScale => s.stroke_scale,
            Feature::PhaseMean(index) => phase(index).mean,
            Feature::PhaseSlope(index) => phase(index).slope_per_s,
            Feature::PhaseRelative(index) if s.stroke_scale > 0.0 => phase(index).mean / s.stroke_scale,
            Feature::PhaseRelative(_) => 0.0,
            Feature::Projection(index) => {
                definition.projections.get(usize::from(index)).map_or(0.0, |projection| {
                    let terms = s.bins().iter().zip(projection.mean).zip(projection.loading);
                    terms.map(|((bin, mean), loading)| f64::from(bin - mean) * f64::from(*loading)).sum()
                })
            }
        }
    }
}

fn mean_absolute(statistics: &CycleStatistics) -> f64 {
    let (sum, count) = statistics.phases.iter().fold((0.0, 0.0), |(sum, count), phase| {
        (sum + phase.mean_absolute * phase.count, count + phase.count)
    });
    if count > 0.0 { sum / count } else { 0.0 }
}

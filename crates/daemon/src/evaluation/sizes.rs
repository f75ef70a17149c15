//! Estimates beside the truth.

use seepd_model::accuracy::{
    Decade, Judged, coverage, decades, in_main_range, mean_absolute_error, median_relative_error, r_squared,
};
use serde::Serialize;

use super::record::{CycleRecord, MachineRecord, Size};
use super::{Conditions, judged, leaks};

/// How a size was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// Relative to the machine's baseline.
    Relative,
    /// By the trained model alone.
    Absolute,
}

impl Method {
    /// Both.
    pub const ALL: [Method; 2] = [Method::Relative, Method::Absolute];

    /// What it is called in tables.
    pub fn name(self) -> &'static str {
        match self {
            Method::Relative => "relative to the baseline",
            Method::Absolute => "without a baseline",
        }
    }

    /// Its estimate of a cycle.
    pub fn size(self, cycle: &CycleRecord) -> Option<Size> {
        match self {
            Method::Relative => cycle.relative,
            Method::Absolute => cycle.absolute,
        }
    }
}

/// Leaks above a flow.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Large {
    /// Lower end, L/min.
    pub from_lpm: f64,
    /// Cycles.
    pub cycles: usize,
    /// Median of |estimate − truth| / truth; null for none.
    pub median_relative_error: f64,
}

/// Cycles of machines that do not leak.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Healthy {
    /// Cycles.
    pub cycles: usize,
    /// Largest estimate, m².
    pub largest_m2: f64,
    /// Cycles of which the interval does not hold the truth.
    pub outside: usize,
}

impl Healthy {
    /// Share of cycles of which the interval holds the truth; not a number for none.
    pub fn coverage(&self) -> f64 {
        1.0 - self.outside as f64 / self.cycles as f64
    }
}

/// What a method's sizes are worth.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Sizes {
    /// Method.
    pub method: Method,
    /// Cycles with an estimate and a truth.
    pub cycles: usize,
    /// Coefficient of determination of the area over 5e-8 … 1e-5 m²; null where the truth does not vary.
    pub r2_area: f64,
    /// Mean of |estimate − truth| there, m²; null for none.
    pub mean_absolute_error_m2: f64,
    /// Share of cycles there of which the interval holds the truth; null for none.
    pub coverage: f64,
    /// By decade.
    pub decades: Vec<Decade>,
    /// Leaks above 1 L/min.
    pub large: Large,
    /// Machines that do not leak.
    pub healthy: Healthy,
    /// Each cycle.
    #[serde(skip)]
    pub judged: Vec<Judged>,
}

/// Lower end of large leaks, L/min.
const LARGE_LPM: f64 = 1.0;

impl Sizes {
    /// Judges a method; `None` where it estimated no cycle of known truth.
    pub fn of(records: &[MachineRecord], method: Method, conditions: &Conditions) -> Option<Self> {
        let judged: Vec<Judged> =
            judged(records).filter_map(|(truth, cycle)| Some(method.size(cycle)?.beside(truth))).collect();
        if judged.is_empty() {
            return None;
        }
        let main = judged.iter().filter(|case| in_main_range(case.truth_m2));
        let large = judged.iter().filter(|case| case.truth_m2 * conditions.lpm_per_m2 >= LARGE_LPM);
        let healthy = judged.iter().filter(|case| !leaks(case.truth_m2, conditions));
        let pairs: Vec<(f64, f64)> = main.clone().map(|case| (case.truth_m2, case.estimate_m2)).collect();
        Some(Sizes {
            method,
            cycles: judged.len(),
            r2_area: r_squared(&pairs),
            mean_absolute_error_m2: mean_absolute_error(&pairs),
            coverage: coverage(main),
            decades: decades(&judged),
            large: Large {
                from_lpm: LARGE_LPM,
                cycles: large.clone().count(),
                median_relative_error: median_relative_error(large),
            },
            healthy: Healthy {
                cycles: healthy.clone().count(),
                largest_m2: healthy.clone().map(|case| case.estimate_m2).fold(0.0, f64::max),
                outside: healthy.filter(|case| !case.is_covered()).count(),
            },
            judged,
        })
    }
}

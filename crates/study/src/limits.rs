//! The smallest leak that one cycle shows of a machine that nobody has seen healthy: with a threshold above every healthy
//! machine of the series.

use seepd_sim::MachineSpec;
use seepd_sim::series::Tolerances;
use seepd_train::Spread;
use seepd_train::dataset;
use seepd_train::leak_range::LeakRange;
use serde::Serialize;

use crate::cycles::orifice_lpm;
use crate::ensemble::Taught;
use crate::features::{Cycle, Lens};
use crate::{AREAS_M2, StudyError, geometric};

/// Standard deviation of the command's noise.
pub const NOISE: f64 = 0.003;
/// Machines differ within ± this share in their parameters and loads.
pub const SPREAD: f64 = 0.10;
/// Healthy machines, and leaking ones.
const MACHINES: usize = 400;
/// Smallest leak that is tried, m².
const SMALLEST_M2: f64 = 1e-8;
/// Share of leaks that a threshold has to find.
const FOUND_SHARE: f64 = 0.95;
/// Leaks of neighbouring sizes over which the share is taken.
const NEIGHBOURS: usize = 40;
/// Draws that share no machine.
const HEALTHY_PURPOSE: u64 = 78;
const LEAKING_PURPOSE: u64 = 79;

/// An ensemble's limit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Limit {
    /// `article` or `seepd`, without a baseline.
    pub ensemble: &'static str,
    /// Machines of either kind.
    pub machines: usize,
    /// Largest estimate of a healthy machine, m²: the threshold.
    pub threshold_m2: f64,
    /// Smallest leak from which on 95 % are above the threshold, m²; null where the largest are not.
    pub smallest_m2: Option<f64>,
    /// Its flow at the reference pressure difference, L/min.
    pub smallest_lpm: Option<f64>,
}

/// Limits of the article's ensemble and of the program's model.
///
/// # Errors
/// [`StudyError`] for a model of another machine.
pub(crate) fn measure(
    lens: &Lens<'_>,
    spec: &MachineSpec,
    taught: &Taught,
    seed: u64,
) -> Result<Vec<Limit>, StudyError> {
    let spread = Spread { parameters: Tolerances::even(SPREAD), load: SPREAD, ..Spread::default() };
    let read = |purpose, areas_m2: &[f64]| {
        let mut machines = dataset::draw(spec, &spread, LeakRange::of(spec), areas_m2.len(), seed, purpose);
        for (machine, area_m2) in machines.iter_mut().zip(areas_m2) {
            machine.leak_area_m2 = *area_m2;
        }
        lens.read(&machines, lens.filter, &[NOISE], seed)
    };
    let healthy = read(HEALTHY_PURPOSE, &[0.0; MACHINES])?;
    let leaking = read(LEAKING_PURPOSE, &geometric(SMALLEST_M2, AREAS_M2.1, MACHINES))?;
    let by_article = |cycle: &Cycle| taught.estimate(&lens.five(&cycle.by_noise[0]));
    let by_model = |cycle: &Cycle| lens.model.estimate_at(&lens.all(&cycle.by_noise[0]), NOISE).value;
    let limit = |ensemble, estimate: &dyn Fn(&Cycle) -> f64| {
        let threshold_m2 = healthy.iter().map(estimate).fold(0.0, f64::max);
        let found: Vec<(f64, bool)> =
            leaking.iter().map(|cycle| (cycle.leak_area_m2, estimate(cycle) > threshold_m2)).collect();
        let smallest_m2 = smallest_found(&found);
        Limit {
            ensemble,
            machines: healthy.len(),
            threshold_m2,
            smallest_m2,
            smallest_lpm: smallest_m2.map(|area_m2| orifice_lpm(spec, area_m2)),
        }
    };
    Ok(vec![limit("article", &by_article), limit("seepd", &by_model)])
}

/// The smallest leak from which on every neighbourhood has its share found; leaks come in rising order.
fn smallest_found(leaks: &[(f64, bool)]) -> Option<f64> {
    let is_found = |neighbours: &&[(f64, bool)]| {
        let found = neighbours.iter().filter(|(_, found)| *found).count();
        found as f64 >= FOUND_SHARE * neighbours.len() as f64
    };
    leaks.windows(NEIGHBOURS).rev().take_while(is_found).last().map(|neighbours| neighbours[0].0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_smallest_leak_is_where_the_misses_end() {
        let leaks = |missed: &dyn Fn(usize) -> bool| -> Vec<(f64, bool)> {
            (0..200).map(|index| (index as f64, !missed(index))).collect()
        };
        assert_eq!(smallest_found(&leaks(&|_| false)), Some(0.0));
        assert_eq!(smallest_found(&leaks(&|_| true)), None);
        // Two of forty may be missed: the neighbourhood may begin two leaks before the misses end.
        assert_eq!(smallest_found(&leaks(&|index| index < 100)), Some(98.0));
        // One miss among large leaks is borne.
        assert_eq!(smallest_found(&leaks(&|index| index < 100 || index == 190)), Some(98.0));
    }
}

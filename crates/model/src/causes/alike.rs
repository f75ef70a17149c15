//! Causes that a machine's command does not tell from a leak: they and the seal are one class.
//!
//! With a P controller and no load, a leak and a shifted null move the command by the same in every hold. A null's response is exact, a
//! leak's is known within its law, so that likelihoods alone would take every such leak for a null and a little leak beside it. What cannot
//! be told apart is weighed by what was known beforehand, and no part of it is taken off a leak.
//!
//! A null by itself may be weighed by its likelihood all the same ([`null_is_exact`](crate::schema::CausesFile::null_is_exact)): that a leak
//! moves every hold and every stroke by the very same is a coincidence.
//!
//! Worn lands of the valve and a worn seal both pass what the pressures at standstill make them pass. Who has a plant only by calibration
//! knows too little of these pressures to tell the two apart: there training makes them one class, whatever the simulated responses say.

use alloc::vec::Vec;

use super::{Cause, Causes, Cell};

/// Variance of the noise at which responses are compared: 0.003 of full command over eight cycles.
const TYPICAL_VARIANCE: f64 = 0.003 * 0.003 / 8.0;

impl Causes {
    /// Marks the cells of other causes that answer as a leak of some size does.
    pub(super) fn mark_what_is_alike(&mut self) {
        let of = |cell: &Cell| -> Vec<f64> {
            let values = self.mean_of(cell).iter().zip(&self.file.ordinary);
            values.map(|(value, ordinary)| value / libm::sqrt(TYPICAL_VARIANCE + ordinary)).collect()
        };
        let leaks: Vec<Vec<f64>> = self.cells.iter().filter(|cell| is_leak(cell)).map(of).collect();
        let is_alike = |cell: &Cell| {
            let response = of(cell);
            !cell.is_seal && leaks.iter().any(|leak| cosine(leak, &response) > self.file.alike_from)
        };
        let alike: Vec<bool> = self.cells.iter().map(is_alike).collect();
        for (cell, is_alike) in self.cells.iter_mut().zip(alike) {
            cell.is_alike |= is_alike;
            let is_null = self.kinds.get(cell.kind).is_some_and(|kind| kind.cause == Cause::ValveNull);
            cell.shares_by_priors = cell.is_alike && !(is_null && self.file.null_is_exact);
        }
    }

    /// Whether there is a cause that answers as a leak does.
    pub(super) fn shares_by_priors(&self) -> bool {
        self.cells.iter().any(is_other)
    }

    /// Shares what the cells of the class have together, logarithms of weights, between leaks and the others by their priors, where the
    /// others have more than that. Gives the largest weight that comes of it.
    pub(super) fn share_by_priors(&self, alone: &mut [f64]) -> f64 {
        if !self.shares_by_priors() {
            return f64::NEG_INFINITY;
        }
        let sum = |belongs: fn(&Cell) -> bool, log: &dyn Fn(usize) -> f64| {
            let class = self.cells.iter().enumerate().filter(|(_, cell)| belongs(cell));
            log_sum(class.map(|(index, _)| log(index)))
        };
        let given = [is_leak, is_other].map(|belongs| sum(belongs, &|index| alone[index]));
        let known = [is_leak, is_other].map(|belongs| sum(belongs, &|index| self.priors[index][0]));
        let shared = log_sum(given.into_iter()) - log_sum(known.into_iter());
        let [leak, other] = [0, 1].map(|which| shared + known[which] - given[which]);
        if !(leak > 0.0 && leak.is_finite() && other.is_finite()) {
            return f64::NEG_INFINITY;
        }
        let mut largest = f64::NEG_INFINITY;
        for (weight, cell) in alone.iter_mut().zip(&self.cells) {
            if is_leak(cell) || is_other(cell) {
                *weight += if is_leak(cell) { leak } else { other };
                largest = largest.max(*weight);
            }
        }
        largest
    }
}

fn is_leak(cell: &Cell) -> bool {
    cell.is_seal && cell.size > 0.0
}

fn is_other(cell: &Cell) -> bool {
    cell.shares_by_priors
}

fn cosine(a: &[f64], b: &[f64]) -> f64 {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    dot(a, b) / libm::sqrt(dot(a, a) * dot(b, b)).max(f64::MIN_POSITIVE)
}

/// Logarithm of the sum of numbers given by their logarithms.
fn log_sum(logs: impl Iterator<Item = f64> + Clone) -> f64 {
    let largest = logs.clone().fold(f64::NEG_INFINITY, f64::max);
    if largest == f64::NEG_INFINITY {
        return largest;
    }
    largest + libm::log(logs.map(|log| libm::exp(log - largest)).sum::<f64>())
}

#[cfg(test)]
mod tests {
    use alloc::vec;

    use super::super::{Cause, Change, ChangeVerdict, Kind, SizeUnit};
    use super::*;
    use crate::schema::{CausesFile, CellFile};

    fn cells(cause: Cause, unit: SizeUnit, error: f64, pattern: [f64; 4]) -> impl Iterator<Item = CellFile> {
        let of_size = move |size: f64| {
            let mean: Vec<f32> = pattern.iter().map(|value| (value * size) as f32).collect();
            CellFile {
                kind: Kind { cause, side: None, unit },
                other_law: false,
                alike: false,
                size,
                size_loadings: vec![0.4 * size],
                size_rest: 0.01 * size,
                error,
                directions: vec![mean.iter().map(|value| 0.4 * value).collect()],
                mean,
            }
        };
        [0.002, 0.006, 0.02].into_iter().map(of_size)
    }

    /// Two phases: a leak answers nearly as a null does, or not at all so; friction parts the phases.
    fn causes(leak: [f64; 4]) -> Causes {
        Causes::from_file(file(leak)).unwrap()
    }

    fn file(leak: [f64; 4]) -> CausesFile {
        let numbers = 4;
        let identity: Vec<f64> =
            (0..numbers * numbers).map(|i| f64::from(u8::from(i % (numbers + 1) == 0))).collect();
        CausesFile {
            basis: identity.clone(),
            inverse: identity,
            ordinary: vec![1e-8; numbers],
            known_limit: 4.0,
            alike_from: 0.95,
            sizes_leaks: false,
            fitted: false,
            knows_dead_band: false,
            null_is_exact: false,
            errors_are_even: false,
            cells: cells(Cause::PistonSeal, SizeUnit::Area, 0.2, leak)
                .chain(cells(Cause::ValveNull, SizeUnit::Share, 0.01, [1.0, 1.0, 0.0, 0.0]))
                .chain(cells(Cause::Friction, SizeUnit::Force, 0.2, [1.0, -1.0, 0.0, 0.0]))
                .collect(),
            golden: Vec::new(),
        }
    }

    /// A response that a leak and a null have in common is the one's or the other's by what was known beforehand, and nothing is taken off
    /// the leak. Where the two part, a null is a null.
    #[test]
    fn what_cannot_be_told_from_a_leak_takes_nothing_off_it() {
        let shifted = [0.006, 0.006, 0.0, 0.0];
        let told = |causes: &Causes, numbers: &[f64]| causes.explain(&Change { numbers, noise: 3e-4 });

        let alike = causes([1.0, 0.95, 0.05, 0.0]);
        let explanation = told(&alike, &shifted);
        assert_eq!(explanation.verdict, ChangeVerdict::CannotTell);
        assert!(explanation.other.is_none());
        // Priors are 0.25 for the seal and 0.42 for two other causes.
        assert!((explanation.seal - 0.25 / 0.46).abs() < 0.01, "{}", explanation.seal);
        let size = explanation.candidate(Cause::PistonSeal).unwrap().size;
        assert!((size / 0.006 - 1.0).abs() < 0.2, "{size}");

        let apart = causes([1.0, 0.0, 0.0, 0.5]);
        assert_eq!(told(&apart, &shifted).verdict, ChangeVerdict::Named(Cause::ValveNull, None));

        // Friction beside a leak is still taken off.
        let beside = [0.006 + 0.006, 0.0057 - 0.006, 0.0003, 0.0];
        let explanation = told(&alike, &beside);
        assert_eq!(explanation.verdict, ChangeVerdict::Named(Cause::PistonSeal, Some(Cause::Friction)));
    }

    /// With an exact null, a change that is the same everywhere is a null, and one that is a leak's within its law, but for a tenth the same
    /// everywhere, is a leak with nothing beside it.
    #[test]
    fn an_exact_null_is_told_from_what_is_nearly_one() {
        let null_is_exact = CausesFile { null_is_exact: true, ..file([1.0, 0.95, 0.05, 0.0]) };
        let causes = Causes::from_file(null_is_exact).unwrap();
        let told = |numbers: &[f64]| causes.explain(&Change { numbers, noise: 3e-5 });
        let null = told(&[0.006, 0.006, 0.0, 0.0]);
        assert_eq!(null.verdict, ChangeVerdict::Named(Cause::ValveNull, None));
        let leak = told(&[0.006, 0.0054, 0.0003, 0.0]);
        assert_eq!(leak.verdict, ChangeVerdict::Named(Cause::PistonSeal, None));
        assert!(leak.other.is_none());
    }

    #[test]
    fn sums_of_logarithms_are_those_of_their_numbers() {
        let sum = log_sum([1.0_f64, 3.0].iter().map(|number| libm::log(*number)));
        assert!((sum - libm::log(4.0)).abs() < 1e-12);
        assert_eq!(log_sum([f64::NEG_INFINITY; 2].into_iter()), f64::NEG_INFINITY);
    }
}

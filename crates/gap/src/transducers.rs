//! Pressure transducers as they are bought: gain and zero of each are off by what its class allows, which is no gap of the plant.
//!
//! Both act on what is recorded along two known shapes, the recorded signal and a constant, so that they are integrated out instead of
//! fitted: differences are weighed by the inverse of 1 + N Nᵀ, N the shapes times their standard deviations (Kennedy and O'Hagan, Journal
//! of the Royal Statistical Society B 63 (2001), for a discrepancy of known form).

use std::collections::BTreeMap;

use seepd_signals::Signal;
use seepd_sim::SensorError;

/// What a class of sensors leaves open, one standard deviation.
#[derive(Debug, Clone, Copy)]
struct Class {
    /// Of the gain, share.
    gain: f64,
    /// Of the zero, SI.
    zero: f64,
}

/// Class 0.5 of 100 bar: what common transducers are good for over their life.
const PRESSURE: Class = Class { gain: 5e-3, zero: 5e4 };

/// The class of a signal's sensor. Position and command are in the loop: what is off there acts on the machine, and stands in the
/// catalogue.
fn class_of(signal: Signal) -> Option<Class> {
    matches!(signal, Signal::PSupply | Signal::PInlet | Signal::PCap | Signal::PRod).then_some(PRESSURE)
}

/// Standard deviations of its class from which a transducer is worth a check.
const BEYOND_ITS_CLASS: f64 = 3.0;

/// How many standard deviations of its class a signal's sensor is off by; none for a signal whose sensor has no class.
fn deviations(signal: Signal, error: SensorError) -> Option<f64> {
    class_of(signal).map(|class| (error.gain / class.gain).hypot(error.zero / class.zero))
}

/// The errors that are worth telling, by signal. What a machine that leaves a gap does not explain its sensors would have to: of such a machine
/// those are left out that no transducer has.
pub(crate) fn believable(
    signals: &[Signal],
    errors: &[Option<SensorError>],
    leaves_a_gap: bool,
) -> BTreeMap<&'static str, SensorError> {
    let named = signals.iter().zip(errors).filter_map(|(signal, error)| Some((*signal, (*error)?)));
    let is_within = |signal, error| deviations(signal, error).is_none_or(|off| off <= BEYOND_ITS_CLASS);
    named
        .filter(|(signal, error)| !leaves_a_gap || is_within(*signal, *error))
        .map(|(signal, error)| (signal.name(), error))
        .collect()
}

/// The transducers that are further off than their class allows, unless half of them and more than one are: transducers fail one by one, and
/// where all are off, the machine is another one.
pub(crate) fn worth_a_check(
    signals: &[Signal],
    errors: &[Option<SensorError>],
) -> Vec<(Signal, SensorError)> {
    let judged: Vec<(Signal, SensorError, f64)> = signals
        .iter()
        .zip(errors)
        .filter_map(|(signal, error)| Some((*signal, (*error)?, deviations(*signal, (*error)?)?)))
        .collect();
    let beyond: Vec<(Signal, SensorError)> = judged
        .iter()
        .filter(|(.., deviations)| *deviations > BEYOND_ITS_CLASS)
        .map(|(signal, error, _)| (*signal, *error))
        .collect();
    if beyond.len() > 1 && 2 * beyond.len() >= judged.len() { Vec::new() } else { beyond }
}

/// Beforehand, the share of transducers that have failed, and how many times its class one is off then.
const FAILED: (f64, f64) = (0.02, 10.0);
/// Share of its transducers that a machine which only imitates the cause needs off, and by how many times their class.
const BENT: (f64, f64) = (0.5, 3.0);

/// How many times likelier it is that transducers are off by so much where the machine only imitates the cause than where it has it, at
/// least 1. They fail one by one; a machine that imitates needs several off at once, by what no class allows.
///
/// `told` has a share for each: how much of its odds counts.
pub(crate) fn odds_of_imitation(signals: &[Signal], errors: &[Option<SensorError>], told: &[f64]) -> f64 {
    // Of a gain and a zero that are normal with that spread, in classes.
    let density = |off: f64, spread: f64| (-0.5 * (off / spread).powi(2)).exp() / (spread * spread);
    let mixed = |off: f64, (share, spread): (f64, f64)| {
        (1.0 - share) * density(off, 1.0) + share * density(off, spread)
    };
    let odds = |((signal, error), told): ((&Signal, &Option<SensorError>), &f64)| {
        let off = deviations(*signal, (*error)?)?;
        Some((mixed(off, BENT) / mixed(off, FAILED).max(f64::MIN_POSITIVE)).powf(*told))
    };
    signals.iter().zip(errors).zip(told).filter_map(odds).product::<f64>().max(1.0)
}

/// What a signal's sensor may add to weighted differences: two shapes of length 1, and how much of each is taken off.
#[derive(Debug, Clone)]
pub(crate) struct Allowance {
    shapes: [Vec<f64>; 2],
    taken: [f64; 2],
}

impl Allowance {
    /// Of a signal's recorded values, whose differences are multiplied by that weight; `None` for a signal whose sensor has no class.
    pub(crate) fn new(signal: Signal, recorded: &[f64], weight: f64) -> Option<Self> {
        let class = class_of(signal)?;
        // Where nothing is recorded, there is nothing to add to.
        let is_there: Vec<bool> = recorded.iter().map(|value| value.is_finite()).collect();
        let there = |value: f64, is_there: &bool| if *is_there { value } else { 0.0 };
        let scaled: Vec<f64> = recorded
            .iter()
            .zip(&is_there)
            .map(|(value, is_there)| there(value * weight * class.gain, is_there))
            .collect();
        let level = weight * class.zero;
        let count = is_there.iter().filter(|is_there| **is_there).count() as f64;
        // The eigenvectors of NᵀN, a symmetric matrix of two rows.
        let (a, d) = (scaled.iter().map(|value| value * value).sum::<f64>(), level * level * count);
        let b = level * scaled.iter().sum::<f64>();
        let angle = 0.5 * (2.0 * b).atan2(a - d);
        let along = |angle: f64| {
            let (sine, cosine) = angle.sin_cos();
            let shape: Vec<f64> = scaled
                .iter()
                .zip(&is_there)
                .map(|(value, is_there)| cosine * value + sine * there(level, is_there))
                .collect();
            let square: f64 = shape.iter().map(|value| value * value).sum();
            let length = square.sqrt().max(f64::MIN_POSITIVE);
            (shape.into_iter().map(|value| value / length).collect(), 1.0 - 1.0 / (1.0 + square).sqrt())
        };
        let (first, second): ((Vec<f64>, f64), (Vec<f64>, f64)) =
            (along(angle), along(angle + std::f64::consts::FRAC_PI_2));
        Some(Allowance { shapes: [first.0, second.0], taken: [first.1, second.1] })
    }

    /// Takes off what the sensor explains, as far as its class allows it.
    pub(crate) fn take_off(&self, differences: &mut [f64]) {
        for (shape, taken) in self.shapes.iter().zip(self.taken) {
            let along: f64 = shape.iter().zip(differences.iter()).map(|(a, b)| a * b).sum();
            for (difference, shape) in differences.iter_mut().zip(shape) {
                *difference -= taken * along * shape;
            }
        }
    }
}

/// The most likely error of a signal's sensor, given what is recorded and what was there, with the standard deviation of what else is
/// different in each value; none for a signal whose sensor has no class.
pub(crate) fn most_likely(
    signal: Signal,
    recorded: &[f64],
    there: &[f64],
    sigma: f64,
) -> Option<SensorError> {
    let class = class_of(signal)?;
    let weight = (sigma * sigma).max(f64::MIN_POSITIVE).recip();
    let (mut gg, mut gz, mut zz) = (class.gain.powi(-2), 0.0, class.zero.powi(-2));
    let (mut g, mut z) = (0.0, 0.0);
    for (recorded, there) in recorded.iter().zip(there) {
        let difference = recorded - there;
        gg += weight * there * there;
        gz += weight * there;
        zz += weight;
        g += weight * there * difference;
        z += weight * difference;
    }
    let determinant = gg * zz - gz * gz;
    let error = SensorError { gain: (g * zz - z * gz) / determinant, zero: (gg * z - gz * g) / determinant };
    (error.gain.is_finite() && error.zero.is_finite()).then_some(error)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn recorded() -> Vec<f64> {
        (0..500).map(|bin| 5e6 + 4e6 * (f64::from(bin) * 0.05).sin()).collect()
    }

    #[test]
    fn what_is_taken_off_is_the_inverse_covariance() {
        let (recorded, weight) = (recorded(), 2e-6);
        let allowance = Allowance::new(Signal::PCap, &recorded, weight).unwrap();
        let differences: Vec<f64> = (0..500).map(|bin| (f64::from(bin) * 0.31).cos() + 0.7).collect();
        let mut taken = differences.clone();
        allowance.take_off(&mut taken);
        // r′ᵀr′ = rᵀ (1 + N Nᵀ)⁻¹ r, by the matrix itself.
        let shapes = nalgebra::DMatrix::from_fn(500, 2, |row, column| {
            weight * if column == 0 { recorded[row] * PRESSURE.gain } else { PRESSURE.zero }
        });
        let covariance = nalgebra::DMatrix::identity(500, 500) + &shapes * shapes.transpose();
        let r = nalgebra::DVector::from_vec(differences);
        let expected = r.dot(&covariance.cholesky().unwrap().solve(&r));
        let found: f64 = taken.iter().map(|value| value * value).sum();
        assert!((found / expected - 1.0).abs() < 1e-9, "{found} {expected}");
    }

    #[test]
    fn one_transducer_is_worth_a_check_and_all_of_them_are_another_machine() {
        let signals = [Signal::Position, Signal::PSupply, Signal::PCap, Signal::PRod];
        let off = |gain: f64| Some(SensorError { gain, zero: 0.0 });
        let told = |gains: [f64; 3]| -> Vec<Signal> {
            let errors = [None, off(gains[0]), off(gains[1]), off(gains[2])];
            worth_a_check(&signals, &errors).into_iter().map(|(signal, _)| signal).collect()
        };
        assert_eq!(told([0.004, 0.03, -0.01]), [Signal::PCap]);
        assert_eq!(told([0.004, 0.012, -0.01]), []);
        assert_eq!(told([0.004, 0.03, -0.04]), []);
        // The only one that there is.
        assert_eq!(worth_a_check(&signals[2..3], &[off(0.03)]).len(), 1);
    }

    #[test]
    fn a_machine_that_leaves_a_gap_blames_no_transducer_for_it() {
        let signals = [Signal::Position, Signal::PSupply, Signal::PCap];
        let within = SensorError { gain: 0.01, zero: 8e4 };
        let beyond = SensorError { gain: -0.22, zero: 9e5 };
        let errors = [None, Some(within), Some(beyond)];
        let told = |leaves_a_gap| believable(&signals, &errors, leaves_a_gap);
        assert_eq!(told(true), BTreeMap::from([("p_supply", within)]));
        assert_eq!(told(false), BTreeMap::from([("p_supply", within), ("p_cap", beyond)]));
    }

    #[test]
    fn one_transducer_fails_and_several_are_bent() {
        let signals = [Signal::Position, Signal::PSupply, Signal::PInlet, Signal::PCap, Signal::PRod];
        let odds = |off: [f64; 4]| {
            let error = |off: f64| Some(SensorError { gain: 0.0, zero: off * PRESSURE.zero });
            let errors = [None, error(off[0]), error(off[1]), error(off[2]), error(off[3])];
            odds_of_imitation(&signals, &errors, &[1.0; 5])
        };
        // Within their class, at its edge, and with one that has failed, by a little or altogether: no odds to speak of.
        assert_eq!(odds([0.5, 1.0, 0.2, 1.2]), 1.0);
        assert!(odds([1.8, 2.3, 2.4, 2.7]) < 3.0);
        assert!(odds([0.5, 0.2, 8.0, 1.0]) < 3.0);
        assert_eq!(odds([0.5, 0.2, 80.0, 1.0]), 1.0);
        // The two of the chambers by four and five classes: nothing but another cause bends both.
        assert!(odds([0.1, 0.4, 3.9, 4.4]) > 300.0);
        assert!(odds([1.0, 1.5, 4.3, 5.6]) > 1000.0);
        // Where no transducer is recorded, none tells.
        assert_eq!(odds_of_imitation(&signals[..1], &[None], &[1.0]), 1.0);
        // Beside gaps that are much larger than what they are bent by.
        let off = Some(SensorError { gain: 0.0, zero: 5.0 * PRESSURE.zero });
        assert_eq!(odds_of_imitation(&signals[..3], &[None, off, off], &[0.0; 3]), 1.0);
    }

    #[test]
    fn a_transducers_error_comes_back() {
        let there = recorded();
        let shown: Vec<f64> = there.iter().map(|value| 1.004 * value - 3e4).collect();
        let error = most_likely(Signal::PRod, &shown, &there, 1e3).unwrap();
        assert!((error.gain - 0.004).abs() < 1e-5 && (error.zero + 3e4).abs() < 1e2, "{error:?}");
        assert_eq!(most_likely(Signal::Position, &shown, &there, 1e3), None);
    }
}

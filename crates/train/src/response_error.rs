//! How far a calibrated plant may be wrong about what a change does to each phase.
//!
//! A plant that a healthy log was calibrated to answers as the log does; what a leak would do the log does not show, and the simulated answer is
//! off wherever the plant is not quite the machine: a contact that nobody knows of, a force in a hold, trapped oil under an overlap. The error
//! is the machine's own, on all its days the same, and differs from phase to phase (model discrepancy: Kennedy & O'Hagan, "Bayesian
//! calibration of computer models", Journal of the Royal Statistical Society B 63, 2001). An estimate that has learned with it leans on no single
//! phase, and its intervals and what it takes for known are as wide as it makes them.

use seepd_sim::noise::Noise;

/// Multiplies a change against the baseline by the machine's error in each phase, of a standard deviation `share`. One of a phase is as likely
/// half as large as twice as large.
pub(crate) fn put_on(present: &mut [f64], baseline: &[f64], share: f64, noise: &mut Noise) {
    for (now, before) in present.iter_mut().zip(baseline) {
        *now = before + (*now - before) * noise.normal(share).exp();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Changes keep their signs, and their factors have the logarithms of a normal distribution.
    #[test]
    fn changes_are_off_by_the_share_and_no_change_stays_none() {
        let (mut noise, mut square) = (Noise::new(3, 1), 0.0);
        for _ in 0..2000 {
            let mut present = [0.3, 0.1, -0.2];
            put_on(&mut present, &[0.1, 0.1, 0.1], 0.2, &mut noise);
            assert_eq!(present[1], 0.1);
            let factors = [(present[0] - 0.1) / 0.2, (present[2] - 0.1) / -0.3];
            square += factors.iter().map(|factor| factor.ln().powi(2)).sum::<f64>() / 4000.0;
        }
        // A variance of 4,000 numbers is known to 2.2 %.
        assert!((square / 0.04 - 1.0).abs() < 0.09, "{square}");
    }

    #[test]
    fn neutral_without_a_share_nothing_moves() {
        let mut present = [0.3, -0.2];
        put_on(&mut present, &[0.1, 0.1], 0.0, &mut Noise::new(3, 1));
        assert!((present[0] - 0.3).abs() < 1e-15 && (present[1] + 0.2).abs() < 1e-15, "{present:?}");
    }
}

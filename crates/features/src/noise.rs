//! The measurement noise on the command, from its second differences: the loop's own motion has none to speak of from one
//! sample to the next (von Neumann, "Distribution of the ratio of the mean square successive difference to the variance",
//! Annals of Mathematical Statistics 12 (1941), with second instead of first differences).

/// Sum of squared second differences since the last cycle.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct NoiseState {
    before: [f64; 2],
    seen: u32,
    squares: f64,
    count: f64,
}

impl NoiseState {
    #[inline]
    pub(crate) fn take(&mut self, command: f64) {
        if self.seen >= 2 {
            let difference = command - 2.0 * self.before[0] + self.before[1];
            self.squares += difference * difference;
            self.count += 1.0;
        } else {
            self.seen += 1;
        }
        self.before = [command, self.before[0]];
    }

    /// Standard deviation of white noise with these second differences, whose variance is six times the noise's; begins anew.
    pub(crate) fn deviation(&mut self) -> f64 {
        let variance = if self.count > 0.0 { self.squares / (6.0 * self.count) } else { 0.0 };
        (self.squares, self.count) = (0.0, 0.0);
        libm::sqrt(variance)
    }
}

#[cfg(test)]
mod tests {
    use super::NoiseState;

    #[test]
    fn motion_is_no_noise_and_alternation_is_known_in_closed_form() {
        let mut state = NoiseState::default();
        for i in 0..1000 {
            state.take(0.1 * libm::sin(f64::from(i) * 0.005));
        }
        assert!(state.deviation() < 2e-6);
        let mut state = NoiseState::default();
        // u = ±a: second differences of ±4a, so √(16 a² / 6).
        for i in 0..1000 {
            state.take(if i % 2 == 0 { 1e-3 } else { -1e-3 });
        }
        assert!((state.deviation() - 1e-3 * libm::sqrt(16.0 / 6.0)).abs() < 1e-12);
        assert_eq!(state.deviation(), 0.0);
    }
}

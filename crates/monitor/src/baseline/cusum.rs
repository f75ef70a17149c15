//! Has the machine left its baseline for good? Two cumulative sums over cycles (Page, "Continuous inspection schemes", Biometrika 41
//! (1954)), one for a leak and one for the opposite. No doubtful cycle alone brings either to its threshold (after the two-in-a-row rule of
//! Lucas and Crosier, "Robust CUSUM", Communications in Statistics A 11 (1982)): the first one after a pause, for instance, is like no
//! other.

use seepd_model::relative::DRIFT_ALLOWANCE;
use serde::{Deserialize, Serialize};

/// The sums end here, over the threshold: what has gone is soon known to have gone.
const CEILING: f64 = 2.0;

/// The most that a doubtful cycle adds, over the threshold.
const LARGEST_DOUBTFUL_STEP: f64 = 0.6;

/// What the sums say.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CusumFinding {
    /// As at the baseline.
    None,
    /// More leakage than at the baseline.
    Leak,
    /// Less leakage than at the baseline, which so was none of a healthy machine.
    Improved,
}

impl CusumFinding {
    /// Its name in messages.
    pub const fn name(self) -> &'static str {
        match self {
            CusumFinding::None => "none",
            CusumFinding::Leak => "leak",
            CusumFinding::Improved => "improved",
        }
    }
}

/// The sums, in standard deviations of the leak residual.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Cusum {
    up: f64,
    down: f64,
    found: CusumFinding,
    /// Cycles since the sum that matters was last 0.
    since: u64,
}

impl Default for Cusum {
    fn default() -> Self {
        Cusum { up: 0.0, down: 0.0, found: CusumFinding::None, since: 0 }
    }
}

/// What the sums are held against.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CusumLimits {
    /// Leak residual that load, oil and supply give a healthy machine for long, m².
    pub reference_m2: f64,
    /// The leak residual's standard deviation from cycle to cycle, m².
    pub deviation_m2: f64,
    /// Threshold of the sums.
    pub threshold: f64,
    /// Whether the cycle is unlike all that training has seen, and counts by an explanation that no other may bear out.
    pub is_doubtful: bool,
}

impl Cusum {
    /// Takes a cycle's leak residual, m².
    pub fn take(&mut self, leak_residual_m2: f64, limits: &CusumLimits) {
        let largest =
            if limits.is_doubtful { LARGEST_DOUBTFUL_STEP * limits.threshold } else { f64::INFINITY };
        let step = |towards: f64| {
            ((towards - limits.reference_m2) / limits.deviation_m2 - DRIFT_ALLOWANCE).min(largest)
        };
        let ceiling = CEILING * limits.threshold;
        let before = self.found;
        self.up = (self.up + step(leak_residual_m2)).clamp(0.0, ceiling);
        self.down = (self.down + step(-leak_residual_m2)).clamp(0.0, ceiling);
        self.found = match before {
            CusumFinding::Leak if self.up > 0.0 => CusumFinding::Leak,
            CusumFinding::Improved if self.down > 0.0 => CusumFinding::Improved,
            _ if self.up >= limits.threshold => CusumFinding::Leak,
            _ if self.down >= limits.threshold => CusumFinding::Improved,
            _ => CusumFinding::None,
        };
        let sum = if self.found == CusumFinding::Improved { self.down } else { self.up };
        self.since = if sum > 0.0 { self.since + 1 } else { 0 };
    }

    /// What the sums say: from a threshold on, until the sum is back at 0.
    pub fn finding(&self) -> CusumFinding {
        self.found
    }

    /// The sum for a leak, in standard deviations.
    pub fn sum(&self) -> f64 {
        self.up
    }

    /// Cycles since the sum left 0: where a leak is found, it began about so many cycles ago.
    pub fn cycles_since_onset(&self) -> u64 {
        self.since
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use seepd_sim::noise::Noise;

    const LIMITS: CusumLimits =
        CusumLimits { reference_m2: 1.0, deviation_m2: 2.0, threshold: 10.0, is_doubtful: false };

    fn cycles_until(finding: CusumFinding, level: f64) -> u64 {
        let mut cusum = Cusum::default();
        (1..=1000)
            .find(|_| {
                cusum.take(level, &LIMITS);
                cusum.finding() == finding
            })
            .unwrap_or(0)
    }

    #[test]
    fn a_step_is_found_after_as_many_cycles_as_its_height_says() {
        // (7 − 1)/2 − 0.5 = 2.5 a cycle, 4 cycles to 10.
        assert_eq!(cycles_until(CusumFinding::Leak, 7.0), 4);
        assert_eq!(cycles_until(CusumFinding::Improved, -7.0), 4);
        // Up to reference and allowance it never is.
        assert_eq!(cycles_until(CusumFinding::Leak, 2.0), 0);
    }

    #[test]
    fn no_doubtful_cycle_alone_is_a_leak() {
        let doubtful = CusumLimits { is_doubtful: true, ..LIMITS };
        let mut cusum = Cusum::default();
        for level in [1e6, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1e6, 0.0] {
            cusum.take(level, if level == 0.0 { &LIMITS } else { &doubtful });
            assert_eq!(cusum.finding(), CusumFinding::None);
        }
        // One after the other is another matter, and so is one that is like training.
        cusum.take(1e6, &doubtful);
        cusum.take(1e6, &doubtful);
        assert_eq!(cusum.finding(), CusumFinding::Leak);
        assert_eq!(cycles_until(CusumFinding::Leak, 1e6), 1);
    }

    #[test]
    fn what_has_gone_is_soon_known_to_have_gone_and_the_onset_is_dated() {
        let mut cusum = Cusum::default();
        (0..50).for_each(|_| cusum.take(0.0, &LIMITS));
        (0..100).for_each(|_| cusum.take(7.0, &LIMITS));
        assert_eq!((cusum.finding(), cusum.cycles_since_onset()), (CusumFinding::Leak, 100));
        // 20 at most, 1 a cycle.
        (0..20).for_each(|_| cusum.take(0.0, &LIMITS));
        assert_eq!((cusum.finding(), cusum.cycles_since_onset()), (CusumFinding::None, 0));
    }

    /// Siegmund's formula for threshold 3: 2·(e^4.166 − 5.166) = 118.6 cycles between false alarms at the worst of the conditions.
    #[test]
    fn false_alarms_are_as_rare_as_the_formula_says() {
        let limits = CusumLimits { threshold: 3.0, ..LIMITS };
        let mut noise = Noise::new(5, 5);
        let (mut alarms, mut cycles) = (0, 0);
        while alarms < 1000 {
            let mut cusum = Cusum::default();
            while cusum.finding() != CusumFinding::Leak {
                cusum.take(1.0 + noise.normal(2.0), &limits);
                cycles += 1;
            }
            alarms += 1;
        }
        let between = f64::from(cycles) / 1000.0;
        // Run lengths are about exponential: 3 % standard deviation of the mean of 1,000, and the formula is good to some per cent.
        assert!((between / 118.6 - 1.0).abs() < 0.12, "{between}");
    }
}

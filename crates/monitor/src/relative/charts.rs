//! Has the command changed for good, in which phases, since when? Two cumulative sums (Page, "Continuous inspection schemes",
//! Biometrika 41 (1954)) for each number of the baseline, up and down.
//!
//! `S = max(0, S + z − k)`, `z = (x − mean)/σ` within ± 6, so that no single cycle decides. σ is the long-run standard deviation of the
//! baseline's cycles, `s · √((1 + ρ)/(1 − ρ))` with their correlation ρ from one to the next; s and ρ are as large as n cycles admit them
//! to be. The allowance `k = 0.5 + 3.5/√n` has room for what the mean of n cycles may be off. A change is told at `h`, of which Siegmund's
//! formula says how many cycles lie between two false alarms of one sum: `2 (e^b − b − 1)`, `b = h + 1.166`, as if half a standard
//! deviation were the whole allowance. h is that of one false alarm a year, of all sums together, at the machine's cycle time.

use serde::{Deserialize, Serialize};

use super::RelativeBaseline;

/// Seconds of a year.
const YEAR_S: f64 = 365.25 * 86_400.0;
/// Part of the allowance that makes false alarms rare.
const ALLOWANCE: f64 = 0.5;
/// Standard errors of the baseline's mean that the allowance has room for.
const MEAN_ERRORS: f64 = 3.5;
/// Standard errors of the baseline's standard deviation that σ has room for.
const DEVIATION_ERRORS: f64 = 3.0;
/// Standard errors of the correlation that σ has room for.
const CORRELATION_ERRORS: f64 = 2.0;
/// Largest standardised difference that counts.
const CLIP: f64 = 6.0;
/// Least standard deviation, share of full command: a machine without noise would count every rounding.
const LEAST_DEVIATION: f64 = 5e-5;
/// Correlations beyond this are taken for this.
const MOST_CORRELATION: f64 = 0.9;
/// The sums end here, over the threshold: what has gone is soon known to have gone.
const CEILING: f64 = 2.0;

/// A number's pair of sums.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
struct Pair {
    up: f64,
    down: f64,
    /// When the larger one left 0, ns.
    since_ns: Option<i64>,
}

/// The sums, which outlive the program.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Sums {
    pairs: Vec<Pair>,
    changed: bool,
}

/// What has changed.
#[derive(Debug, Clone, PartialEq)]
pub struct Change {
    /// About when it began, ns in the log's own time.
    pub onset_ns: i64,
    /// Names of what has changed, the surest first.
    pub features: Vec<String>,
}

/// How a number is held against the baseline.
#[derive(Debug, Clone, Copy)]
struct Scale {
    mean: f64,
    /// Long-run standard deviation.
    deviation: f64,
    /// Standard deviation of one cycle.
    of_cycle: f64,
}

/// The charts of a machine.
#[derive(Debug, Clone)]
pub struct Charts {
    scales: Vec<Scale>,
    names: Vec<String>,
    allowance: f64,
    threshold: f64,
    sums: Sums,
    /// The last cycle's numbers, standardised by the scatter from cycle to cycle.
    standardised: Vec<f64>,
}

impl Charts {
    /// Charts that begin at 0.
    pub fn new(baseline: &RelativeBaseline) -> Self {
        let count = baseline.cycles as f64;
        let scale = |feature: &super::FeatureBaseline| {
            let correlation = largest_correlation(feature.autocorrelation, count);
            let inflation = (1.0 + correlation) / (1.0 - correlation);
            let known_from = (count / inflation).max(2.0);
            let of_cycle = feature.deviation.max(LEAST_DEVIATION);
            let doubt = 1.0 + DEVIATION_ERRORS / (2.0 * (known_from - 1.0)).sqrt();
            Scale { mean: feature.mean, deviation: of_cycle * doubt * inflation.sqrt(), of_cycle }
        };
        let pairs = baseline.features.len();
        Charts {
            scales: baseline.features.iter().map(scale).collect(),
            names: baseline.features.iter().map(|feature| feature.name.clone()).collect(),
            allowance: ALLOWANCE + MEAN_ERRORS / count.sqrt(),
            threshold: threshold(2 * pairs, baseline.cycle.period_s),
            sums: Sums { pairs: vec![Pair::default(); pairs], changed: false },
            standardised: vec![0.0; pairs],
        }
    }

    /// Names of the numbers.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// The last cycle's numbers, in standard deviations of the baseline's cycles.
    pub fn standardised(&self) -> &[f64] {
        &self.standardised
    }

    /// Distance of the last cycle from the baseline: root mean square of its standardised numbers, about 1 for a healthy machine.
    pub fn distance(&self) -> f64 {
        let squares: f64 = self.standardised.iter().map(|value| value * value).sum();
        (squares / self.standardised.len().max(1) as f64).sqrt()
    }

    /// The largest sum over the threshold: from 1 on something has changed.
    pub fn largest(&self) -> f64 {
        self.sums.pairs.iter().map(|pair| pair.up.max(pair.down)).fold(0.0, f64::max) / self.threshold
    }

    /// Takes a cycle's numbers that ended at a time, ns.
    pub fn take(&mut self, values: &[f64], end_ns: i64) {
        let ceiling = CEILING * self.threshold;
        let slots = self.sums.pairs.iter_mut().zip(&self.scales).zip(&mut self.standardised).zip(values);
        for (((pair, scale), standardised), value) in slots {
            *standardised = (value - scale.mean) / scale.of_cycle;
            let z = ((value - scale.mean) / scale.deviation).clamp(-CLIP, CLIP);
            pair.up = (pair.up + z - self.allowance).clamp(0.0, ceiling);
            pair.down = (pair.down - z - self.allowance).clamp(0.0, ceiling);
            let rises = pair.up.max(pair.down) > 0.0;
            pair.since_ns = if rises { pair.since_ns.or(Some(end_ns)) } else { None };
        }
        let largest = self.largest();
        self.sums.changed = largest >= 1.0 || (self.sums.changed && largest > 0.0);
    }

    /// Whether something has changed: from the threshold on, until every sum is back at 0.
    pub fn has_changed(&self) -> bool {
        self.sums.changed
    }

    /// What has changed, where something has.
    pub fn change(&self) -> Option<Change> {
        if !self.sums.changed {
            return None;
        }
        // Sums that go back are still the change until they are gone.
        let half = 0.5 * self.threshold * self.largest().min(1.0);
        let mut grown: Vec<(&Pair, &String)> = self
            .sums
            .pairs
            .iter()
            .zip(&self.names)
            .filter(|(pair, _)| pair.up.max(pair.down) >= half)
            .collect();
        grown.sort_by(|(a, _), (b, _)| b.up.max(b.down).total_cmp(&a.up.max(a.down)));
        // Single sums may have left 0 by chance before the change, or long after it.
        let mut since_ns: Vec<i64> = grown.iter().filter_map(|(pair, _)| pair.since_ns).collect();
        since_ns.sort_unstable();
        let onset_ns = *since_ns.get(since_ns.len() / 2)?;
        Some(Change { onset_ns, features: grown.into_iter().map(|(_, name)| name.clone()).collect() })
    }

    /// The sums, to be kept.
    pub fn sums(&self) -> &Sums {
        &self.sums
    }

    /// Takes the sums up where an earlier run left them; those of another baseline are none of these.
    pub fn restore(&mut self, sums: Sums) {
        if sums.pairs.len() == self.sums.pairs.len() {
            self.sums = sums;
        }
    }
}

/// How large the correlation of which n cycles show so much may be: with its bias (Kendall, "Note on bias in the estimation of
/// autocorrelation", Biometrika 41 (1954)) and its standard error.
fn largest_correlation(seen: f64, count: f64) -> f64 {
    let bias = (1.0 + 3.0 * seen) / count;
    let standard_error = ((1.0 - seen * seen) / count).sqrt();
    (seen + bias + CORRELATION_ERRORS * standard_error).clamp(0.0, MOST_CORRELATION)
}

/// Threshold at which so many sums give one false alarm a year, by Siegmund's formula solved for h.
fn threshold(sums: usize, period_s: f64) -> f64 {
    let cycles = sums as f64 * YEAR_S / period_s;
    // e^b − b − 1 = cycles/2; the terms beside e^b are below a millionth of it.
    (0.5 * cycles).ln() - 1.166
}

#[cfg(test)]
mod tests {
    use super::super::Learner;
    use super::*;
    use seepd_sim::noise::Noise;

    /// Numbers of a healthy machine's cycles: noise of their own, load ± 2 % in common, and some that wander.
    struct Healthy {
        noise: Noise,
        wander: [f64; 16],
    }

    impl Healthy {
        fn new(seed: u64) -> Self {
            Healthy { noise: Noise::new(seed, 7), wander: [0.0; 16] }
        }

        fn cycle(&mut self) -> [f64; 16] {
            let load = self.noise.uniform(-0.02, 0.02);
            std::array::from_fn(|index| {
                // Correlations of 0 … 0.75 from cycle to cycle.
                let keep = 0.05 * index as f64;
                self.wander[index] = keep * self.wander[index] + self.noise.normal(2e-4);
                0.01 * index as f64 + load * 0.01 * (index % 5) as f64 + self.wander[index]
            })
        }
    }

    fn charts_of(healthy: &mut Healthy, cycles: usize) -> Charts {
        let mut learner = Learner::new("test", cycles);
        (0..cycles as i64).for_each(|at| learner.take_values(&healthy.cycle(), (10 * at, 10 * at + 10)));
        Charts::new(&learner.baseline_of("axis", super::super::learner::test_cycle(8)).unwrap())
    }

    /// 900 machines of 1,000 cycles each, of 3.2 million in a year: 0.3 false alarms at most are to be expected.
    #[test]
    fn healthy_machines_raise_no_alarm() {
        for (seed, learned) in (0..900).zip([30, 50, 200].into_iter().cycle()) {
            let mut healthy = Healthy::new(seed);
            let mut charts = charts_of(&mut healthy, learned);
            for cycle in 0..1000 {
                charts.take(&healthy.cycle(), cycle * 10_000_000_000);
                assert!(!charts.has_changed(), "machine {seed}, cycle {cycle}: {}", charts.largest());
            }
        }
    }

    #[test]
    fn a_change_is_found_named_and_dated_and_goes_when_it_goes() {
        let mut healthy = Healthy::new(1);
        let mut charts = charts_of(&mut healthy, 50);
        let mut found = None;
        for cycle in 0..200 {
            let mut values = healthy.cycle();
            if cycle >= 100 {
                values[0] += 1e-3;
            }
            charts.take(&values, cycle * 10);
            found = found.or(charts.has_changed().then_some(cycle));
        }
        assert!(found.is_some_and(|found| (102..115).contains(&found)), "{found:?}");
        let change = charts.change().unwrap();
        assert_eq!(change.features, ["mean.part_1"]);
        assert!((980..=1020).contains(&change.onset_ns), "{change:?}");
        for cycle in 0..60 {
            charts.take(&healthy.cycle(), 2000 + cycle * 10);
            assert_eq!(charts.has_changed(), charts.change().is_some(), "{cycle}");
        }
        assert_eq!(charts.change(), None);
    }

    /// ln(32 · 31,557,600/10/2) − 1.166 for sixteen numbers and cycles of 10 s.
    #[test]
    fn analytic_threshold_is_siegmunds() {
        assert!((threshold(32, 10.0) - 16.571).abs() < 1e-3, "{}", threshold(32, 10.0));
    }

    #[test]
    fn sums_outlive_the_program() {
        let mut healthy = Healthy::new(3);
        let mut charts = charts_of(&mut healthy, 30);
        (0..30).for_each(|cycle| charts.take(&[0.5; 16], cycle));
        let text = serde_json::to_string(charts.sums()).unwrap();
        let mut again = charts_of(&mut Healthy::new(3), 30);
        again.restore(serde_json::from_str(&text).unwrap());
        assert!(again.has_changed() && again.sums() == charts.sums());
        again.restore(Sums::default());
        assert!(again.has_changed());
    }
}

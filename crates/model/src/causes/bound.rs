//! How small a leak the cycle's numbers can show at all: the Cramér–Rao bound.
//!
//! No estimate without bias has a smaller variance than 1/(rᵀ C⁻¹ r), where r is what a leak of size 1 does to the numbers and C their
//! covariance (Kay, Fundamentals of Statistical Signal Processing: Estimation Theory, 1993, section 3.9). In the file's coordinates C is
//! diagonal: noise, and what load, oil and supply ordinarily do.

use super::Causes;

/// What is known of load, oil and supply.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum KnownConditions {
    /// Nothing: they are anywhere within their ordinary range, and stay there.
    No,
    /// They are what they were at the baseline, or what they do is known.
    Yes,
}

impl Causes {
    /// Least standard deviation of a small leak's area, m², of the law that estimates have learned, by an estimate that knows nothing but
    /// the numbers; `None` of a model without such leaks. `noise` is the standard deviation of the noise left on the command in the change:
    /// a cycle's times √(1/cycles + 1/baseline cycles).
    pub fn least_leak_deviation_m2(&self, noise: f64, conditions: KnownConditions) -> Option<f64> {
        let mut leaks = self.leaks.iter().map(|leak| &self.cells[*leak]);
        let cell = leaks.find(|cell| !cell.has_other_law)?;
        let ordinary = |variance: f64| if conditions == KnownConditions::Yes { 0.0 } else { variance };
        let coordinates = self.mean_of(cell).iter().zip(&self.file.ordinary);
        let information: f64 = coordinates
            .map(|(mean, variance)| {
                let per_m2 = mean / cell.size;
                per_m2 * per_m2 / (noise * noise + ordinary(*variance))
            })
            .sum();
        (information > 0.0).then(|| 1.0 / libm::sqrt(information))
    }
}

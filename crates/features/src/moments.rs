//! Mean, standard deviation, skewness and kurtosis in one numerically stable pass.

/// Central moments of a stream. Samples are summed in small blocks around the block's first value, and blocks
/// are merged by the pairwise update of Pébay, "Formulas for robust, one-pass parallel computation of
/// covariances and arbitrary-order statistical moments", SAND2008-6212 (2008), equations (1.1)–(1.5): as
/// stable as the update sample by sample, without its division a sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Moments {
    count: f64,
    mean: f64,
    m2: f64,
    m3: f64,
    m4: f64,
    block: [f64; BLOCK_SAMPLES],
    filled: usize,
}

const BLOCK_SAMPLES: usize = 64;
/// Sums that run side by side within a block, so that no addition waits for the one before.
const ABREAST: usize = 4;

impl Default for Moments {
    fn default() -> Self {
        Moments { count: 0.0, mean: 0.0, m2: 0.0, m3: 0.0, m4: 0.0, block: [0.0; BLOCK_SAMPLES], filled: 0 }
    }
}

impl Moments {
    /// Takes a sample.
    #[inline]
    pub(crate) fn push(&mut self, value: f64) {
        self.block[self.filled % BLOCK_SAMPLES] = value;
        self.filled += 1;
        if self.filled == BLOCK_SAMPLES {
            self.merge_block();
        }
    }

    fn merge_block(&mut self) {
        let block = self.block.get(..self.filled).unwrap_or(&self.block);
        let Some(pivot) = block.first().copied() else { return };
        let n = block.len() as f64;
        let mut sums = [[0.0; ABREAST]; 4];
        for values in block.chunks(ABREAST) {
            for (lane, value) in values.iter().enumerate() {
                let d = value - pivot;
                let d2 = d * d;
                sums[0][lane] += d;
                sums[1][lane] += d2;
                sums[2][lane] += d2 * d;
                sums[3][lane] += d2 * d2;
            }
        }
        let [s1, s2, s3, s4] = sums.map(|[a, b, c, d]| (a + b) + (c + d));
        let offset = s1 / n;
        // Central moments of the block from its sums around the pivot.
        let o2 = offset * offset;
        let m2 = s2 - n * o2;
        let m3 = s3 - 3.0 * offset * s2 + 2.0 * n * o2 * offset;
        let m4 = s4 - 4.0 * offset * s3 + 6.0 * o2 * s2 - 3.0 * n * o2 * o2;
        self.filled = 0;
        self.merge(n, pivot + offset, m2, m3, m4);
    }

    fn merge(&mut self, n_b: f64, mean_b: f64, m2_b: f64, m3_b: f64, m4_b: f64) {
        let n_a = self.count;
        let n = n_a + n_b;
        let delta = mean_b - self.mean;
        let per_n = delta / n;
        let product = n_a * n_b;
        let m4 = self.m4
            + m4_b
            + delta * per_n * per_n * per_n * product * (n_a * n_a - product + n_b * n_b)
            + 6.0 * per_n * per_n * (n_a * n_a * m2_b + n_b * n_b * self.m2)
            + 4.0 * per_n * (n_a * m3_b - n_b * self.m3);
        let m3 = self.m3
            + m3_b
            + delta * per_n * per_n * product * (n_a - n_b)
            + 3.0 * per_n * (n_a * m2_b - n_b * self.m2);
        self.m2 += m2_b + delta * per_n * product;
        self.m3 = m3;
        self.m4 = m4;
        self.mean += per_n * n_b;
        self.count = n;
    }

    /// The moments of everything pushed so far.
    pub(crate) fn summary(mut self) -> MomentSummary {
        self.merge_block();
        let n = self.count;
        if n == 0.0 {
            return MomentSummary::default();
        }
        let variance = self.m2 / n;
        let spread = variance > 0.0;
        MomentSummary {
            mean: self.mean,
            standard_deviation: libm::sqrt(variance.max(0.0)),
            skewness: if spread { self.m3 / n / (variance * libm::sqrt(variance)) } else { 0.0 },
            kurtosis: if spread { self.m4 / n / (variance * variance) } else { 0.0 },
        }
    }
}

/// The four moments of a set of values.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MomentSummary {
    /// Mean.
    pub mean: f64,
    /// Standard deviation of the population (divisor n).
    pub standard_deviation: f64,
    /// Third standardised moment; 0 where nothing varies.
    pub skewness: f64,
    /// Fourth standardised moment (3 for a normal distribution); 0 where nothing varies.
    pub kurtosis: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(values: impl IntoIterator<Item = f64>) -> MomentSummary {
        let mut moments = Moments::default();
        values.into_iter().for_each(|value| moments.push(value));
        moments.summary()
    }

    /// A whole number of periods of a sine: mean 0, σ = 1/√2, skewness 0, kurtosis 3/2.
    #[test]
    fn analytic_sine() {
        let n = 10_000;
        let sine = of((0..n).map(|i| libm::sin(core::f64::consts::TAU * 7.0 * f64::from(i) / f64::from(n))));
        assert!(sine.mean.abs() < 1e-14);
        assert!((sine.standard_deviation - core::f64::consts::FRAC_1_SQRT_2).abs() < 1e-13);
        assert!(sine.skewness.abs() < 1e-13);
        assert!((sine.kurtosis - 1.5).abs() < 1e-13);
    }

    /// 0 … n−1: variance (n² − 1)/12, kurtosis 3 (3n² − 7)/(5 (n² − 1)).
    #[test]
    fn analytic_uniform_numbers_far_from_zero() {
        let n = 1000.0f64;
        // 2²⁰ away, a naive sum of fourth powers would lose every digit.
        let uniform = of((0..1000).map(|i| 1_048_576.0 + f64::from(i)));
        assert!((uniform.mean - 1_048_576.0 - 499.5).abs() < 1e-9);
        assert!((uniform.standard_deviation.powi(2) / ((n * n - 1.0) / 12.0) - 1.0).abs() < 1e-12);
        assert!((uniform.kurtosis - 3.0 * (3.0 * n * n - 7.0) / (5.0 * (n * n - 1.0))).abs() < 1e-10);
    }

    #[test]
    fn analytic_constant_has_no_spread() {
        let constant = of([0.25; 100]);
        assert_eq!(constant, MomentSummary { mean: 0.25, ..MomentSummary::default() });
        assert_eq!(of([]), MomentSummary::default());
    }
}

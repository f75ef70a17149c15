//! Seeded randomness: measurement noise and the spread of simulated machines.

use rand::SeedableRng;
use rand_distr::{Distribution, Normal, Uniform};
use rand_pcg::Pcg64Mcg;

/// A stream of random numbers that is the same on every machine for the same seed and stream number.
#[derive(Debug, Clone)]
pub struct Noise {
    generator: Pcg64Mcg,
}

impl Noise {
    /// Stream number `stream` of a seed; different streams are independent for every practical purpose.
    pub fn new(seed: u64, stream: u64) -> Self {
        // The constant of splitmix64 spreads neighbouring streams over the seed space.
        Noise { generator: Pcg64Mcg::seed_from_u64(seed ^ stream.wrapping_mul(0x9E37_79B9_7F4A_7C15)) }
    }

    /// Normally distributed with mean 0; 0 for a standard deviation that is not positive and finite.
    pub fn normal(&mut self, standard_deviation: f64) -> f64 {
        match Normal::new(0.0, standard_deviation) {
            Ok(normal) if standard_deviation > 0.0 => normal.sample(&mut self.generator),
            _ => 0.0,
        }
    }

    /// Uniform in [low, high]; `low` where the range is empty or not finite.
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        Uniform::new_inclusive(low, high).map_or(low, |uniform| uniform.sample(&mut self.generator))
    }

    /// 1 ± `share`, uniform.
    pub fn factor(&mut self, share: f64) -> f64 {
        self.uniform(1.0 - share, 1.0 + share)
    }
}

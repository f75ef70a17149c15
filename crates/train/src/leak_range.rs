//! Which leaks a machine is trained on: the article's range, moved by octaves to the size of the machine's valve and cut by octaves where
//! the machine cannot follow its duty cycle any more.

use seepd_sim::{MachineSpec, Size};

/// Smallest and largest leak of the main range of the nominal press, m² (the article's), and the smallest that is tried.
const MAIN_M2: (f64, f64) = (5e-8, 1e-5);
const SMALLEST_M2: f64 = 5e-9;
/// Beyond the range's end, so that the trees do not end where estimates are still wanted.
const OVERSHOOT: f64 = 1.3;
/// Up to here the command does not stand at its end over whole strokes; it does from 2.3e-5 m² on, where no cycle is recognised.
const LARGEST_M2: f64 = 2.3e-5;
/// Offset of the logarithm, m²: admits a leak of 0 and lets errors below it count absolutely.
const OFFSET_M2: f64 = 2e-8;
/// Least share of the range's upper end that is still worth training for.
const LEAST_TOP: f64 = 1.0 / 64.0;

/// The leaks of a machine's training.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LeakRange {
    /// Size of the machine's valve over that of the nominal press, a power of two.
    scale: f64,
    /// Largest leaks over those of a valve of that size, a power of two.
    top: f64,
}

impl LeakRange {
    /// The range of a machine: a leak matters by what share of the valve's flow it takes.
    pub fn of(spec: &MachineSpec) -> Self {
        LeakRange { scale: Size::of(spec).valve, top: 1.0 }
    }

    /// The same without the leaks of the uppermost octave; `None` where little would be left.
    pub(crate) fn lowered(self) -> Option<Self> {
        (self.top > LEAST_TOP).then_some(LeakRange { top: 0.5 * self.top, ..self })
    }

    /// Largest leak that sizes are learned from, m².
    pub(crate) fn top_m2(self) -> f64 {
        self.main_m2().1 * OVERSHOOT
    }

    /// Size of the machine's valve over that of the nominal press, a power of two.
    pub fn scale(self) -> f64 {
        self.scale
    }

    /// Smallest and largest leak of the main range, m².
    pub fn main_m2(self) -> (f64, f64) {
        (self.scale * MAIN_M2.0, self.scale * self.top * MAIN_M2.1)
    }

    /// Whether a leak lies in the main range.
    pub fn is_main(self, leak_area_m2: f64) -> bool {
        (self.main_m2().0..=self.main_m2().1).contains(&leak_area_m2)
    }

    /// See [`OFFSET_M2`], m².
    pub(crate) fn offset_m2(self) -> f64 {
        self.scale * OFFSET_M2
    }

    /// Leak area at a rank of 0 … 1, with these shares of machines without a leak and with one below the main range, m².
    pub(crate) fn at_m2(self, rank: f64, healthy: f64, small: f64) -> f64 {
        if rank < healthy {
            0.0
        } else if rank < healthy + small {
            self.scale * log_uniform((rank - healthy) / small, SMALLEST_M2, MAIN_M2.0)
        } else {
            let share = (rank - healthy - small) / (1.0 - healthy - small);
            self.scale * log_uniform(share, MAIN_M2.0, self.top * MAIN_M2.1 * OVERSHOOT)
        }
    }

    /// Leak area at a rank of 0 … 1 beyond those that sizes are learned from, m²: such a leak must not be taken for another fault.
    pub(crate) fn beyond_m2(self, rank: f64) -> f64 {
        self.scale * self.top * log_uniform(rank, MAIN_M2.1 * OVERSHOOT, LARGEST_M2)
    }
}

fn log_uniform(share: f64, low: f64, high: f64) -> f64 {
    low * libm::pow(high / low, share)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_range_goes_with_the_valve_by_octaves() {
        let mut spec = MachineSpec::default();
        assert_eq!(LeakRange::of(&spec).main_m2(), MAIN_M2);
        spec.plant.valve_m3_per_s_sqrt_pa *= 1.3;
        assert_eq!(LeakRange::of(&spec).main_m2(), MAIN_M2);
        spec.plant.valve_m3_per_s_sqrt_pa *= 8.0;
        assert_eq!(LeakRange::of(&spec).main_m2(), (8.0 * MAIN_M2.0, 8.0 * MAIN_M2.1));
        assert_eq!(LeakRange::of(&spec).beyond_m2(1.0), 8.0 * LARGEST_M2);
        assert_eq!(LeakRange::of(&spec).at_m2(0.01, 0.06, 0.18), 0.0);
        let lowered = LeakRange::of(&spec).lowered().unwrap();
        assert_eq!(lowered.main_m2(), (8.0 * MAIN_M2.0, 4.0 * MAIN_M2.1));
        assert!((lowered.at_m2(1.0, 0.06, 0.18) / lowered.top_m2() - 1.0).abs() < 1e-12);
        assert_eq!(std::iter::successors(Some(lowered), |range| range.lowered()).count(), 6);
    }
}

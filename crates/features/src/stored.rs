//! A cycle's statistics as a row of numbers, to be kept or sent and to be taken up again to the bit.

use crate::load::LoadSummary;
use crate::segment::MAX_CYCLE_BINS;
use crate::statistics::CycleStatistics;

impl CycleStatistics {
    /// Hands every number to `take`, in an order that [`CycleStatistics::from_numbers`] knows.
    pub fn each_number(&self, take: &mut dyn FnMut(f64)) {
        let mut copy = *self;
        copy.visit(&mut |number| take(*number));
        take(f64::from(u8::from(self.load.is_some())));
        if let Some(load) = self.load {
            [load.mean_n, load.extremes_n.0, load.extremes_n.1].into_iter().for_each(&mut *take);
        }
        take(self.bin_count as f64);
        self.bins().iter().for_each(|bin| take(f64::from(*bin)));
    }

    /// Statistics from the numbers that [`CycleStatistics::each_number`] gave; `None` where they end early or cannot be.
    pub fn from_numbers(next: &mut dyn FnMut() -> Option<f64>) -> Option<Self> {
        let mut statistics = CycleStatistics::EMPTY;
        let mut is_whole = true;
        statistics.visit(&mut |number| match next() {
            Some(next) => *number = next,
            None => is_whole = false,
        });
        if next()? != 0.0 {
            statistics.load = Some(LoadSummary { mean_n: next()?, extremes_n: (next()?, next()?) });
        }
        let bin_count = next()?;
        if !is_whole || !(0.0..=MAX_CYCLE_BINS as f64).contains(&bin_count) {
            return None;
        }
        statistics.bin_count = bin_count as usize;
        for bin in statistics.bins.iter_mut().take(statistics.bin_count) {
            *bin = next()? as f32;
        }
        Some(statistics)
    }

    /// Every number but load and bins.
    fn visit(&mut self, visit: &mut dyn FnMut(&mut f64)) {
        let moments = &mut self.moments;
        let of_moments = [
            &mut moments.mean,
            &mut moments.standard_deviation,
            &mut moments.skewness,
            &mut moments.kurtosis,
        ];
        of_moments.into_iter().for_each(&mut *visit);
        for phase in &mut self.phases {
            let of_phase = [
                &mut phase.count,
                &mut phase.mean,
                &mut phase.mean_absolute,
                &mut phase.energy,
                &mut phase.slope_per_s,
                &mut phase.rise,
                &mut phase.extremes.0,
                &mut phase.extremes.1,
            ];
            of_phase.into_iter().for_each(&mut *visit);
        }
        let of_cycle = [
            &mut self.extremes.0,
            &mut self.extremes.1,
            &mut self.energy.0,
            &mut self.energy.1,
            &mut self.oscillation,
            &mut self.trend_per_s,
            &mut self.edge_times_s.0,
            &mut self.edge_times_s.1,
            &mut self.stroke_scale,
            &mut self.amplitude_variation,
            &mut self.noise,
        ];
        of_cycle.into_iter().for_each(&mut *visit);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Distinct numbers everywhere come back in their places, and a row that ends early is none.
    #[test]
    fn numbers_make_the_same_statistics() {
        let mut statistics = CycleStatistics::EMPTY;
        let mut number = 0.0;
        statistics.visit(&mut |place| {
            number += 1.0;
            *place = 1.0 / number;
        });
        statistics.load = Some(LoadSummary { mean_n: -3.5, extremes_n: (-9.0, f64::NAN) });
        statistics.bin_count = 3;
        statistics.bins[..3].copy_from_slice(&[0.1, f32::MIN_POSITIVE, -7.0]);

        let mut row = [0.0; 1024];
        let mut length = 0;
        statistics.each_number(&mut |number| {
            row[length] = number;
            length += 1;
        });
        assert_eq!(length, 4 + 8 * statistics.phases.len() + 11 + 1 + 3 + 1 + 3);
        let taken = |numbers: &[f64]| {
            let mut numbers = numbers.iter();
            CycleStatistics::from_numbers(&mut || numbers.next().copied())
        };
        let again = taken(&row[..length]).unwrap();
        let mut count = 0;
        again.each_number(&mut |number| {
            assert_eq!(number.to_bits(), row[count].to_bits(), "number {count}");
            count += 1;
        });
        assert_eq!(count, length);
        assert!((0..length).all(|shorter| taken(&row[..shorter]).is_none()));
    }
}

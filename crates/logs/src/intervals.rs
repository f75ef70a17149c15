//! Rate and gaps of a stream of messages by their times, in little memory however long the stream.

/// First intervals, of which the median is the rate.
const MEASURED: usize = 1024;
/// Intervals longer than so many medians are gaps.
const GAP_INTERVALS: f64 = 2.5;

/// See the [module](self).
#[derive(Debug, Default)]
pub(super) struct Intervals {
    first_ns: Option<i64>,
    last_ns: i64,
    count: u64,
    /// Of these, such that are longer than nothing.
    forward: u64,
    /// The first ones; empty once their median is known.
    measured: Vec<i64>,
    median_ns: Option<i64>,
    gaps: u64,
    longest_gap_ns: i64,
}

/// What the times say.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Found {
    pub(super) rate_hz: Option<f64>,
    pub(super) duration_s: f64,
    pub(super) gaps: u64,
    pub(super) longest_gap_s: f64,
}

impl Intervals {
    /// Takes the next message's time.
    pub(super) fn take(&mut self, time_ns: i64) {
        let before = std::mem::replace(&mut self.last_ns, time_ns);
        if self.first_ns.is_none() {
            self.first_ns = Some(time_ns);
            return;
        }
        let interval = time_ns.saturating_sub(before);
        self.count += 1;
        self.forward += u64::from(interval > 0);
        match self.median_ns {
            Some(median) => self.compare(interval, median),
            None => {
                self.measured.push(interval);
                if self.measured.len() == MEASURED {
                    self.measure();
                }
            }
        }
    }

    /// Finds the median of the first intervals, and the gaps among them.
    fn measure(&mut self) {
        let measured = std::mem::take(&mut self.measured);
        // Messages out of order have negative intervals, which say nothing about the rate.
        let mut sorted: Vec<i64> = measured.iter().copied().filter(|interval| *interval > 0).collect();
        sorted.sort_unstable();
        let Some(median) = sorted.get(sorted.len() / 2).copied() else { return };
        self.median_ns = Some(median);
        for interval in measured {
            self.compare(interval, median);
        }
    }

    fn compare(&mut self, interval: i64, median: i64) {
        if interval as f64 > GAP_INTERVALS * median as f64 {
            self.gaps += 1;
            self.longest_gap_ns = self.longest_gap_ns.max(interval);
        }
    }

    /// What was found, at the end.
    pub(super) fn found(mut self) -> Found {
        if self.median_ns.is_none() {
            self.measure();
        }
        let Some(first_ns) = self.first_ns else { return Found::default() };
        let duration_s = self.last_ns.saturating_sub(first_ns) as f64 / 1e9;
        let rate_hz = self.median_ns.map(|median| {
            // Where most messages share a stamp, the stamps are too coarse for the median to be the rate.
            let coarse = 2 * self.forward < self.count;
            1e9 / if coarse { duration_s * 1e9 / self.count as f64 } else { median as f64 }
        });
        Found { rate_hz, duration_s, gaps: self.gaps, longest_gap_s: self.longest_gap_ns as f64 / 1e9 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(times: impl Iterator<Item = i64>) -> Found {
        let mut intervals = Intervals::default();
        times.for_each(|time| intervals.take(time * 1_000_000));
        intervals.found()
    }

    #[test]
    fn gaps_are_found_before_and_after_the_median_is_known() {
        let times = (0..20_000).map(|n| n + if n > 9000 { 500 } else { 0 } + if n > 100 { 70 } else { 0 });
        let expected = Found { rate_hz: Some(1000.0), duration_s: 20.569, gaps: 2, longest_gap_s: 0.501 };
        assert_eq!(found(times), expected);
    }

    #[test]
    fn coarse_stamps_give_the_mean_rate() {
        let rate = found((0..4000).map(|n| n / 100 * 100)).rate_hz.unwrap();
        assert!((rate - 1025.4).abs() < 0.1, "{rate}");
        assert_eq!(found(std::iter::empty()), Found::default());
    }
}

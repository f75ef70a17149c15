//! Times of frames by their counter: a frame is often late, on its way through a controller's task, a gateway or an
//! adapter, but the counter says that none is missing and which follows which.
//!
//! Frames are placed a period apart. Stamps pull that line: at once where one is early, as no frame comes before it was sent,
//! and a thousandth of the way where one is late. Pauses of the sender and senders of another rate show, as they must.

/// Largest delay that is smoothed over, ns.
const LATEST_NS: i64 = 500_000_000;
/// Stamps earlier than the line by more than this do not belong to it, ns.
const EARLIEST_NS: i64 = -50_000_000;
/// Share of the way to a late stamp.
const PULL_LATE: f64 = 0.001;
/// Share of the way to an early one.
const PULL_EARLY: f64 = 0.05;
/// Periods between stamps over which a frame that left the line did so because of a pause, not of another rate.
const PAUSE_PERIODS: f64 = 20.0;

/// See the [module](self).
#[derive(Debug, Clone)]
pub(crate) struct Timeline {
    period_ns: f64,
    last: Option<Placed>,
    /// The sender's rate is another: stamps are taken as they are.
    given_up: bool,
}

#[derive(Debug, Clone, Copy)]
struct Placed {
    time_ns: i64,
    stamp_ns: i64,
}

impl Timeline {
    /// For frames that are to come at a rate, Hz.
    pub(crate) fn new(rate_hz: f64) -> Self {
        Timeline { period_ns: 1e9 / rate_hz, last: None, given_up: false }
    }

    /// The time of a frame that comes `steps` after the one before; `None` where the counter does not say.
    pub(crate) fn place(&mut self, steps: Option<u64>, stamp_ns: i64) -> i64 {
        let time_ns = self.placed(steps, stamp_ns).unwrap_or(stamp_ns);
        self.last = Some(Placed { time_ns, stamp_ns });
        time_ns
    }

    fn placed(&mut self, steps: Option<u64>, stamp_ns: i64) -> Option<i64> {
        let (steps, last) = (steps.filter(|_| !self.given_up)?, self.last?);
        let ideal_ns = last.time_ns.saturating_add((steps as f64 * self.period_ns) as i64);
        let late_ns = stamp_ns.saturating_sub(ideal_ns);
        if !(EARLIEST_NS..LATEST_NS).contains(&late_ns) {
            let since_ns = stamp_ns.saturating_sub(last.stamp_ns) as f64;
            self.given_up = (0.0..PAUSE_PERIODS * self.period_ns).contains(&since_ns);
            return None;
        }
        let pull = if late_ns < 0 { PULL_EARLY } else { PULL_LATE };
        Some(ideal_ns.saturating_add((late_ns as f64 * pull) as i64))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    /// Intervals between placed frames, ms, for stamps in ms.
    fn intervals(stamps: impl Iterator<Item = i64>) -> Vec<f64> {
        let mut line = Timeline::new(1000.0);
        let times: Vec<i64> = stamps.map(|stamp| line.place(Some(1), stamp * MS)).collect();
        times.windows(2).map(|pair| (pair[1] - pair[0]) as f64 / 1e6).collect()
    }

    #[test]
    fn a_stall_and_the_burst_after_it_are_smoothed() {
        // Frames of 200 … 300 ms all come at 300 ms.
        let stamps = (0..2000).map(|n| if (200..300).contains(&n) { 300 } else { n });
        for interval in intervals(stamps) {
            assert!((0.7..1.3).contains(&interval), "{interval}");
        }
    }

    #[test]
    fn a_pause_is_a_pause() {
        let stamps = (0..2000).map(|n| if n < 1000 { n } else { n + 700 });
        let longest = intervals(stamps).into_iter().fold(0.0, f64::max);
        assert!((longest - 701.0).abs() < 1e-6, "{longest}");
    }

    #[test]
    fn another_rate_shows() {
        for (step, expected) in [(2, 2.0), (5, 5.0)] {
            let tail = intervals((0..3000).map(|n| n * step));
            assert!(tail[2000..].iter().all(|interval| (interval - expected).abs() < 1e-9), "{step}");
        }
    }

    #[test]
    fn lost_frames_leave_their_room() {
        let mut line = Timeline::new(1000.0);
        assert_eq!(line.place(None, 5 * MS), 5 * MS);
        assert_eq!(line.place(Some(1), 6 * MS), 6 * MS);
        assert_eq!(line.place(Some(4), 10 * MS), 10 * MS);
        // A counter that went back says nothing.
        assert_eq!(line.place(None, 14 * MS), 14 * MS);
    }
}

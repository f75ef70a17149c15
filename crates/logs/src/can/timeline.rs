//! Times of frames by their counter: a frame is often late, on its way through a controller's task, a gateway or an
//! adapter, but the counter says that none is missing and which follows which.
//!
//! Frames are placed a period apart. Stamps pull that line: at once where one is early, as no frame comes before it was sent,
//! and a thousandth of the way where one is late. Pauses of the sender and senders of another rate show, as they must. A counter that does
//! not fit the stamps is left alone until it does again: what made it wild may be gone.

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
/// A counter that was left alone is looked at over so many periods, and fits where its time is the stamps' but for such a share.
const TRIAL_PERIODS: u64 = 500;
const FITS_WITHIN: f64 = 0.25;

/// See the [module](self).
#[derive(Debug, Clone)]
pub(crate) struct Timeline {
    period_ns: f64,
    last: Option<Placed>,
    /// Stamps are taken as they are, since the counter does not fit them: the sender's rate is another, or it counts wildly.
    trial: Option<Trial>,
}

/// What a counter that was left alone has counted, from a stamp on.
#[derive(Debug, Clone, Copy)]
struct Trial {
    from_ns: i64,
    steps: u64,
}

#[derive(Debug, Clone, Copy)]
struct Placed {
    time_ns: i64,
    stamp_ns: i64,
}

impl Timeline {
    /// For frames that are to come at a rate, Hz.
    pub(crate) fn new(rate_hz: f64) -> Self {
        Timeline { period_ns: 1e9 / rate_hz, last: None, trial: None }
    }

    /// The time of a frame that comes `steps` after the one before; `None` where the counter does not say.
    pub(crate) fn place(&mut self, steps: Option<u64>, stamp_ns: i64) -> i64 {
        let time_ns = self.placed(steps, stamp_ns).unwrap_or(stamp_ns);
        self.last = Some(Placed { time_ns, stamp_ns });
        time_ns
    }

    fn placed(&mut self, steps: Option<u64>, stamp_ns: i64) -> Option<i64> {
        if let Some(trial) = self.trial {
            self.trial = self.go_on(trial, steps, stamp_ns);
            return None;
        }
        let (steps, last) = (steps?, self.last?);
        let ideal_ns = last.time_ns.saturating_add((steps as f64 * self.period_ns) as i64);
        let late_ns = stamp_ns.saturating_sub(ideal_ns);
        if !(EARLIEST_NS..LATEST_NS).contains(&late_ns) {
            let since_ns = stamp_ns.saturating_sub(last.stamp_ns) as f64;
            let is_a_pause = !(0.0..PAUSE_PERIODS * self.period_ns).contains(&since_ns);
            self.trial = (!is_a_pause).then_some(Trial { from_ns: stamp_ns, steps: 0 });
            return None;
        }
        let pull = if late_ns < 0 { PULL_EARLY } else { PULL_LATE };
        Some(ideal_ns.saturating_add((late_ns as f64 * pull) as i64))
    }

    /// What a trial is after a frame; `None` where the counter fits.
    fn go_on(&self, trial: Trial, steps: Option<u64>, stamp_ns: i64) -> Option<Trial> {
        let anew = Trial { from_ns: stamp_ns, steps: 0 };
        let Some(steps) = steps else { return Some(anew) };
        let counted = trial.steps.saturating_add(steps);
        if counted < TRIAL_PERIODS {
            return Some(Trial { steps: counted, ..trial });
        }
        let expected_ns = counted as f64 * self.period_ns;
        let difference_ns = stamp_ns.saturating_sub(trial.from_ns) as f64 - expected_ns;
        (difference_ns.abs() > FITS_WITHIN * expected_ns).then_some(anew)
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
    fn a_counter_that_was_wild_is_followed_again() {
        let mut line = Timeline::new(1000.0);
        // Wild for 300 frames, then right; of the last thousand, frames 2000 … 2100 all come at 2100 ms.
        let wild = |n: i64| if (500..800).contains(&n) { Some(1 + n as u64 * 37 % 120) } else { Some(1) };
        let stamps = (0..3000).map(|n| if (2000..2100).contains(&n) { 2100 } else { n });
        let times: Vec<i64> =
            stamps.enumerate().map(|(n, stamp)| line.place(wild(n as i64), stamp * MS)).collect();
        for (n, pair) in times.windows(2).enumerate().skip(1500) {
            let interval_ms = (pair[1] - pair[0]) as f64 / 1e6;
            assert!((0.7..1.3).contains(&interval_ms), "{n}: {interval_ms}");
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

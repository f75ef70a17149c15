//! The daemon's clock: the only place of the live way that reads one.
//!
//! Samples are timed on a line that never steps: the wall clock's time when the daemon started, and from then on the
//! monotonic clock. A gateway without a battery boots in 1970 and is set by decades later; cycles must not notice.

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// Wall-clock times before this are those of a clock that was never set: 2024-01-01, s.
const PLAUSIBLE_S: u64 = 1_704_067_200;
/// Age that a kernel's time stamp can have when it is read; an older one was taken before the clock was set, ns.
const OLDEST_STAMP_NS: i64 = 10_000_000_000;
/// Stamps may be this much ahead of the reading, ns: the two clocks are read one after the other.
const AHEAD_NS: i64 = 1_000_000;
/// Difference between the clocks that is followed slowly, as a daemon that sets them slowly makes it, ns.
const SLEWED_NS: i64 = 100_000_000;

/// A line of time that never steps.
#[derive(Debug, Clone, Copy)]
pub struct Clock {
    begin: Instant,
    begin_ns: i64,
}

#[expect(clippy::disallowed_methods, reason = "live samples get their time here, and nowhere else")]
fn monotonic() -> Instant {
    Instant::now()
}

#[expect(clippy::disallowed_methods, reason = "kernel time stamps and publications are in wall-clock time")]
fn wall() -> Duration {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default()
}

fn nanoseconds(duration: Duration) -> i64 {
    i64::try_from(duration.as_nanos()).unwrap_or(i64::MAX)
}

impl Clock {
    /// Starts the line at the wall clock's time.
    pub fn start() -> Self {
        Clock { begin: monotonic(), begin_ns: nanoseconds(wall()) }
    }

    /// Now, ns on the line.
    pub fn now_ns(&self) -> i64 {
        let since = nanoseconds(monotonic().duration_since(self.begin));
        self.begin_ns.saturating_add(since)
    }
}

/// Now, for waiting.
pub fn instant() -> tokio::time::Instant {
    tokio::time::Instant::from_std(monotonic())
}

/// The wall clock's time, ns since 1970; `None` where it was never set.
pub fn wall_ns() -> Option<i64> {
    let now = wall();
    (now.as_secs() >= PLAUSIBLE_S).then(|| nanoseconds(now))
}

/// The wall clock's time as text (RFC 3339, ms); `None` where it was never set.
pub fn wall_text() -> Option<String> {
    let ns = wall_ns()?;
    let stamp = jiff::Timestamp::from_nanosecond(i128::from(ns)).ok()?;
    Some(format!("{stamp:.3}"))
}

/// Turns kernel time stamps, which are in wall-clock time, into times on the line.
#[derive(Debug, Clone, Copy, Default)]
pub struct Stamps {
    /// Wall clock minus line.
    offset_ns: Option<i64>,
    before_ns: i64,
    now_ns: i64,
}

impl Stamps {
    /// Looks at both clocks; once before a batch of stamps.
    pub fn look(&mut self, clock: &Clock) {
        self.look_at(clock.now_ns(), nanoseconds(wall()));
    }

    fn look_at(&mut self, now_ns: i64, wall_ns: i64) {
        let measured = wall_ns.saturating_sub(now_ns);
        self.now_ns = now_ns;
        self.before_ns = self.offset_ns.unwrap_or(measured);
        let change = measured.saturating_sub(self.before_ns);
        // A clock that is set slowly is followed slowly, so that the distance between samples stays the kernel's.
        let followed = if change.abs() < SLEWED_NS { change / 64 } else { change };
        self.offset_ns = Some(self.before_ns.saturating_add(followed));
    }

    /// The time of a frame on the line, ns; of one without a stamp, now.
    pub fn time_ns(&self, stamp_ns: Option<i64>) -> i64 {
        let Some(stamp_ns) = stamp_ns else { return self.now_ns };
        let plausible = |offset_ns: i64| {
            let time_ns = stamp_ns.saturating_sub(offset_ns);
            let age_ns = self.now_ns.saturating_sub(time_ns);
            (-AHEAD_NS..OLDEST_STAMP_NS).contains(&age_ns).then_some(time_ns)
        };
        let offset_ns = self.offset_ns.unwrap_or(self.before_ns);
        plausible(offset_ns).or_else(|| plausible(self.before_ns)).unwrap_or(self.now_ns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: i64 = 1_000_000_000;

    #[test]
    fn stamps_keep_their_distance_when_the_clock_is_set_by_decades() {
        let mut stamps = Stamps::default();
        stamps.look_at(5 * SECOND, 5 * SECOND + 7);
        assert_eq!(stamps.time_ns(Some(5 * SECOND - 1000 + 7)), 5 * SECOND - 1000);
        // Between these two looks the clock was set 50 years ahead; one stamp is from before, one from after.
        let years = 50 * 365 * 86_400 * SECOND;
        stamps.look_at(6 * SECOND, 6 * SECOND + years);
        assert_eq!(stamps.time_ns(Some(6 * SECOND - 3000 + 7)), 6 * SECOND - 3000);
        assert_eq!(stamps.time_ns(Some(6 * SECOND - 1000 + years)), 6 * SECOND - 1000);
        // And back.
        stamps.look_at(7 * SECOND, 7 * SECOND);
        assert_eq!(stamps.time_ns(Some(7 * SECOND - 500)), 7 * SECOND - 500);
    }

    #[test]
    fn slow_setting_moves_no_sample_by_more_than_a_share_of_it() {
        let mut stamps = Stamps::default();
        stamps.look_at(SECOND, SECOND);
        stamps.look_at(2 * SECOND, 2 * SECOND + 640_000);
        assert_eq!(stamps.time_ns(Some(2 * SECOND)), 2 * SECOND - 10_000);
    }

    #[test]
    fn impossible_and_missing_stamps_are_now() {
        let mut stamps = Stamps::default();
        stamps.look_at(SECOND, SECOND);
        for stamp in [None, Some(0), Some(i64::MIN), Some(i64::MAX), Some(20 * SECOND)] {
            let time = stamps.time_ns(stamp);
            assert!((0..=SECOND).contains(&time), "{stamp:?}: {time}");
        }
    }
}

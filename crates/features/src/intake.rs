//! Which samples can be used: order, gaps, range, rate.

use seepd_signals::{Sample, Signal};

use crate::reader::Reason;

/// Largest magnitude of a usable command: full command and 5 % for measurement noise.
const COMMAND_LIMIT: f64 = 1.05;
/// Steps back in time by less than this are late samples, by more a clock that was set, s.
const LATE_S: f64 = 1.0;
/// Samples in a row that may be missing and are bridged by holding the last one.
const BRIDGED_SAMPLES: i64 = 10;
/// What an impossible value adds to the doubt about those beside it, which each usable one takes 1 from: one in five is borne.
const DOUBT: u32 = 4;
/// Doubt from which the values in between are no better: ten impossible ones in a row, or some more among others.
const MOST_DOUBT: u32 = 40;
/// Intervals over which the rate is checked.
const RATE_WINDOW: u32 = 200;

/// Samples that were left out or filled in, by reason.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    /// Samples with a command.
    pub samples: u64,
    /// Of these, used.
    pub used: u64,
    /// Same time as the sample before.
    pub duplicate: u64,
    /// Earlier than the sample before.
    pub out_of_order: u64,
    /// Not a number, or infinite.
    pub not_a_number: u64,
    /// Outside of −1 … 1 by more than the measurement noise.
    pub out_of_range: u64,
    /// At another rate than the model's.
    pub wrong_rate: u64,
    /// Missing, and bridged by holding the last sample.
    pub bridged: u64,
    /// Missing, in gaps too long to bridge.
    pub missing: u64,
}

/// What to do with a sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Admission {
    /// Leave it out.
    Drop,
    /// Use it after `bridged` repetitions of the command before.
    Use { command: f64, bridged: i64 },
    /// Use it as the first of a new gapless segment; the reason says what ended the one before.
    Restart { command: f64, reason: Reason },
}

/// What the intake remembers.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct IntakeState {
    last_ns: Option<i64>,
    /// Where the regular grid of samples stands, ns; follows the stamps slowly, so that jitter averages out.
    grid_ns: f64,
    /// Running mean of the stamps' distance from the grid, ns.
    jitter_ns: f64,
    /// Why the samples since the last used one were dropped.
    dropped_for: Option<Reason>,
    /// Doubt about the values, from impossible ones among them.
    doubt: u32,
    window: RateWindow,
    /// Rate of the samples, where it is not the model's.
    pub(crate) wrong_rate_hz: Option<f64>,
}

#[derive(Debug, Clone, Copy, Default)]
struct RateWindow {
    intervals: u32,
    regular: u32,
    start_ns: i64,
}

impl IntakeState {
    /// Checks a sample against the model's sample period, s.
    #[inline]
    pub(crate) fn admit(&mut self, counts: &mut Counts, sample: &Sample, period_ns: f64) -> Admission {
        let Some(command) = sample.get(Signal::Command) else { return Admission::Drop };
        counts.samples += 1;
        let time_ns = sample.time_ns;
        let Some(last_ns) = self.last_ns else {
            return self.admit_first(counts, time_ns, command);
        };
        let since_ns = time_ns.saturating_sub(last_ns);
        if since_ns <= 0 && since_ns as f64 > -LATE_S * 1e9 {
            *(if since_ns == 0 { &mut counts.duplicate } else { &mut counts.out_of_order }) += 1;
            return Admission::Drop;
        }
        if since_ns > 0 {
            self.check_rate(time_ns, since_ns as f64, period_ns);
        }
        if let Some(reason) = unusable(counts, command) {
            self.dropped_for.get_or_insert(reason);
            self.doubt = self.doubt.saturating_add(DOUBT);
            return Admission::Drop;
        }
        let is_doubtful = self.doubt > MOST_DOUBT;
        self.doubt = if is_doubtful { 0 } else { self.doubt.saturating_sub(1) };
        self.last_ns = Some(time_ns);
        if self.wrong_rate_hz.is_some() {
            counts.wrong_rate += 1;
            self.grid_ns = time_ns as f64;
            self.dropped_for = Some(Reason::WrongRate);
            return Admission::Drop;
        }
        counts.used += 1;
        if since_ns < 0 {
            return self.restart(time_ns, command, Reason::OutOfOrder);
        }
        let early_ns = time_ns as f64 - self.grid_ns - period_ns;
        let missing = if early_ns > 0.75 * period_ns && early_ns > 4.0 * self.jitter_ns {
            libm::round(early_ns / period_ns).max(1.0) as i64
        } else {
            0
        };
        let reason = self.dropped_for.take();
        if missing > BRIDGED_SAMPLES || is_doubtful || reason == Some(Reason::WrongRate) {
            counts.missing += missing.max(0) as u64;
            return self.restart(time_ns, command, reason.unwrap_or(Reason::Gap));
        }
        counts.bridged += missing as u64;
        let off_ns = early_ns - missing as f64 * period_ns;
        self.jitter_ns += 0.02 * (off_ns.abs() - self.jitter_ns);
        self.grid_ns += (missing + 1) as f64 * period_ns + 0.05 * off_ns;
        Admission::Use { command, bridged: missing }
    }

    fn admit_first(&mut self, counts: &mut Counts, time_ns: i64, command: f64) -> Admission {
        if unusable(counts, command).is_some() {
            return Admission::Drop;
        }
        counts.used += 1;
        self.last_ns = Some(time_ns);
        self.window = RateWindow { start_ns: time_ns, ..RateWindow::default() };
        self.restart(time_ns, command, Reason::Incomplete)
    }

    fn restart(&mut self, time_ns: i64, command: f64, reason: Reason) -> Admission {
        self.grid_ns = time_ns as f64;
        self.jitter_ns = 0.0;
        self.dropped_for = None;
        Admission::Restart { command, reason }
    }

    /// The rate is wrong where most of a window's intervals are, and their mean is too: stamps in bursts
    /// have a right mean, a log with a few gaps has right intervals.
    fn check_rate(&mut self, time_ns: i64, since_ns: f64, period_ns: f64) {
        let window = &mut self.window;
        window.intervals += 1;
        window.regular += u32::from((since_ns - period_ns).abs() < 0.45 * period_ns);
        if window.intervals < RATE_WINDOW {
            return;
        }
        let mean_ns = time_ns.saturating_sub(window.start_ns) as f64 / f64::from(window.intervals);
        let wrong = window.regular * 2 < window.intervals && (mean_ns / period_ns - 1.0).abs() > 0.1;
        self.wrong_rate_hz = wrong.then_some(1e9 / mean_ns);
        *window = RateWindow { start_ns: time_ns, ..RateWindow::default() };
    }
}

/// Counts and names what makes a command unusable.
fn unusable(counts: &mut Counts, command: f64) -> Option<Reason> {
    if !command.is_finite() {
        counts.not_a_number += 1;
        return Some(Reason::NotANumber);
    }
    if command.abs() > COMMAND_LIMIT {
        counts.out_of_range += 1;
        return Some(Reason::OutOfRange);
    }
    None
}

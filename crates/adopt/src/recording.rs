//! A machine's log on one uniform time grid.

use seepd_gap::Log;
use seepd_signals::{Sample, Signal};

/// Samples that are kept: an hour at 582 Hz, or 35 minutes at 1 kHz.
const MOST_SAMPLES: usize = 1 << 21;
/// Intervals from which the rate is taken.
const INTERVALS: usize = 4096;
/// A gap this many periods long is not bridged.
const BRIDGED: f64 = 3.0;

/// Signals by sample, at equal steps of time.
#[derive(Debug, Clone, Default)]
pub struct Recording {
    /// Samples a second.
    pub rate_hz: f64,
    /// Values, NaN where there is none.
    pub log: Log,
    /// Samples that the log has beyond those that are kept.
    pub beyond: usize,
}

/// Why a log cannot be put on a time grid.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RecordingError {
    /// Too little of it.
    #[error("the log has {0} samples with a command; a machine's duty cycle needs thousands")]
    TooShort(usize),
    /// Time stands still or runs backwards.
    #[error("the log's time does not go on: half of its steps are 0 or less")]
    Timeless,
}

/// Takes samples one by one.
#[derive(Debug, Default)]
pub struct Recorder {
    times_ns: Vec<i64>,
    values: [Vec<f32>; Signal::ALL.len()],
    beyond: usize,
}

impl Recorder {
    /// Takes a sample; beyond the most that are kept it is counted.
    pub fn take(&mut self, sample: &Sample) {
        if self.times_ns.len() == MOST_SAMPLES {
            self.beyond += 1;
            return;
        }
        self.times_ns.push(sample.time_ns);
        for signal in Signal::ALL {
            self.values[signal as usize].push(sample.get(signal).map_or(f32::NAN, |value| value as f32));
        }
    }

    /// The samples on a grid of their own usual rate.
    ///
    /// # Errors
    /// [`RecordingError`] where they are too few or their time does not go on.
    pub fn finish(self) -> Result<Recording, RecordingError> {
        const LEAST: usize = 100;
        if self.times_ns.len() < LEAST {
            return Err(RecordingError::TooShort(self.times_ns.len()));
        }
        let mut steps: Vec<i64> = self
            .times_ns
            .windows(2)
            .step_by((self.times_ns.len() / INTERVALS).max(1))
            .map(|pair| pair[1].saturating_sub(pair[0]))
            .collect();
        steps.sort_unstable();
        let median_ns = steps[steps.len() / 2];
        if median_ns <= 0 {
            return Err(RecordingError::Timeless);
        }
        // The mean of the usual steps: the median of stamps that are rounded is off.
        let usual: Vec<f64> = steps
            .iter()
            .filter(|step| **step > median_ns / 2 && **step < 2 * median_ns)
            .map(|step| *step as f64)
            .collect();
        let period_ns = usual.iter().sum::<f64>() / usual.len().max(1) as f64;
        Ok(self.on_grid(snapped(period_ns)))
    }

    fn on_grid(self, period_ns: f64) -> Recording {
        let first_ns = self.times_ns[0];
        let places: Vec<f64> =
            self.times_ns.iter().map(|time| time.saturating_sub(first_ns) as f64 / period_ns).collect();
        let end = places.iter().copied().fold(0.0, f64::max).min(MOST_SAMPLES as f64) as usize + 1;
        let mut log = Log::default();
        for signal in Signal::ALL {
            let values = &self.values[signal as usize];
            if values.iter().any(|value| value.is_finite()) {
                log.values[signal as usize] = resampled(&places, values, end);
            }
        }
        Recording { rate_hz: 1e9 / period_ns, log, beyond: self.beyond }
    }
}

/// The period of the nearest round rate, where one is within a thousandth.
fn snapped(period_ns: f64) -> f64 {
    let rate = 1e9 / period_ns;
    let step = if rate >= 500.0 {
        10.0
    } else if rate >= 20.0 {
        1.0
    } else {
        0.1
    };
    let round = (rate / step).round() * step;
    if round > 0.0 && (rate / round - 1.0).abs() < 1e-3 { 1e9 / round } else { period_ns }
}

/// Values at whole places, linear between their neighbours, NaN in gaps.
fn resampled(places: &[f64], values: &[f32], end: usize) -> Vec<f64> {
    let mut grid = vec![f64::NAN; end];
    let mut before: Option<(f64, f64)> = None;
    for (place, value) in places.iter().zip(values) {
        let here = (*place, f64::from(*value));
        if !here.1.is_finite() {
            continue;
        }
        match before {
            Some(from) if here.0 > from.0 && here.0 - from.0 <= BRIDGED => {
                for slot in from.0.floor() as usize + 1..=here.0.floor() as usize {
                    if let Some(cell) = grid.get_mut(slot) {
                        *cell = from.1 + (here.1 - from.1) * (slot as f64 - from.0) / (here.0 - from.0);
                    }
                }
            }
            Some(from) if here.0 <= from.0 => continue,
            _ => {
                if let Some(cell) = grid.get_mut(here.0.round() as usize) {
                    *cell = here.1;
                }
            }
        }
        before = Some(here);
    }
    grid
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn jittered_samples_lie_on_the_grid_and_gaps_stay() {
        let mut recorder = Recorder::default();
        for index in 0..1000i64 {
            if (500..600).contains(&index) {
                continue;
            }
            let jitter = (index * 7919 % 100 - 50) * 1000;
            let time_ns = index * 2_000_000 + jitter;
            recorder.take(&Sample::command(time_ns, time_ns as f64 / 4e9));
        }
        let recording = recorder.finish().unwrap();
        assert!((recording.rate_hz - 500.0).abs() < 0.1, "{}", recording.rate_hz);
        let command = recording.log.get(Signal::Command).unwrap();
        assert!((command[400] - 400.0 * 2e-3 / 4.0).abs() < 2e-5, "{}", command[400]);
        assert!(command[550].is_nan() && command[700].is_finite());
        assert!(recording.log.get(Signal::Position).is_none());
    }
}

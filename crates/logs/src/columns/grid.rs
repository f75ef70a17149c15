//! The even grid of time that a log's messages fall into.

use super::{LEAST_RATE_HZ, MOST_SAMPLES};
use crate::survey::TopicSurvey;

/// Share of a log after which the stretch begins that is kept of one that is too long: machines start up, and warm up.
const BEGIN: f64 = 0.1;
/// Messages that are out of order by less than this do not end a stretch, ns.
const OUT_OF_ORDER_NS: i64 = 10_000_000_000;

/// See the [module](self).
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Grid {
    pub(super) rate_hz: f64,
    /// Every how many samples of the fastest topic a cell has one.
    thinning: usize,
    /// From the log's first message to the first cell, ns.
    skip_ns: i64,
    cells: usize,
    first_ns: Option<i64>,
}

/// Where a time is on the grid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Place {
    /// Before the first cell, or just after the last one.
    Outside,
    /// In a cell.
    In(usize),
    /// So far beyond the last cell that nothing follows.
    End,
}

impl Grid {
    /// The grid for a log of these topics; `None` where none has a rate.
    pub(super) fn of(topics: &[TopicSurvey]) -> Option<Self> {
        let rates =
            topics.iter().filter_map(|topic| Some((topic, topic.rate_hz.filter(|rate| *rate > 0.0)?)));
        let with_fields = || rates.clone().filter(|(topic, _)| !topic.fields.is_empty());
        let fastest_hz = with_fields().map(|(_, rate)| rate).reduce(f64::max)?;
        // A clock that is set by decades makes no log that is decades long.
        let lasts = with_fields().map(|(topic, rate)| (topic.messages as f64 / rate).min(topic.duration_s));
        Some(Self::covering(fastest_hz, lasts.fold(0.0, f64::max)))
    }

    fn covering(fastest_hz: f64, duration_s: f64) -> Self {
        let most = MOST_SAMPLES as f64;
        let needed = (duration_s * fastest_hz / most).ceil().max(1.0);
        let allowed = (fastest_hz / LEAST_RATE_HZ).floor().max(1.0);
        let thinning = needed.min(allowed);
        let rate_hz = fastest_hz / thinning;
        let skip_s = if duration_s * rate_hz > most { BEGIN * duration_s } else { 0.0 };
        Grid {
            rate_hz,
            thinning: thinning as usize,
            skip_ns: (skip_s * 1e9) as i64,
            cells: MOST_SAMPLES,
            first_ns: None,
        }
    }

    /// Where a message of that time falls.
    pub(super) fn place(&mut self, time_ns: i64) -> Place {
        let first_ns = *self.first_ns.get_or_insert(time_ns);
        let into_ns = time_ns.saturating_sub(first_ns).saturating_sub(self.skip_ns);
        // Cells begin half a sample early, so that jitter does not move samples over their bounds.
        let cell = (into_ns as f64 * 1e-9 * self.rate_hz + 0.5 / self.thinning as f64).floor();
        if cell < 0.0 {
            Place::Outside
        } else if cell < self.cells as f64 {
            Place::In(cell as usize)
        } else if into_ns as f64 * 1e-9 * self.rate_hz
            < self.cells as f64 + OUT_OF_ORDER_NS as f64 * 1e-9 * self.rate_hz
        {
            Place::Outside
        } else {
            Place::End
        }
    }

    /// Time of the first cell, ns.
    pub(super) fn start_ns(&self) -> i64 {
        self.first_ns.unwrap_or_default().saturating_add(self.skip_ns)
    }

    /// What a person should know of it.
    pub(super) fn note(&self) -> Option<String> {
        let thinned = format!("every {}th sample was looked at, {:.0} a second", self.thinning, self.rate_hz);
        match (self.skip_ns, self.thinning) {
            (0, 1) => None,
            (0, _) => Some(thinned),
            (skip_ns, _) => Some(format!(
                "the log is long: {:.0} minutes of it from {:.0} min on were looked at{}",
                self.cells as f64 / self.rate_hz / 60.0,
                skip_ns as f64 / 60e9,
                if self.thinning > 1 { format!("; of these, {thinned}") } else { String::new() }
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn short_logs_are_whole_long_ones_thinned_and_longer_ones_cut() {
        let whole = Grid::covering(1000.0, 200.0);
        assert_eq!((whole.rate_hz, whole.thinning, whole.skip_ns, whole.note()), (1000.0, 1, 0, None));
        let hour = Grid::covering(1000.0, 2400.0);
        assert_eq!((hour.rate_hz, hour.thinning, hour.skip_ns), (100.0, 10, 0));
        assert_eq!(hour.note().as_deref(), Some("every 10th sample was looked at, 100 a second"));
        let day = Grid::covering(1000.0, 86_400.0);
        assert_eq!((day.rate_hz, day.skip_ns), (100.0, 8_640_000_000_000));
        assert_eq!(
            day.note().as_deref(),
            Some(
                "the log is long: 44 minutes of it from 144 min on were looked at; of these, every 10th sample was looked at, 100 a second"
            )
        );
        // A slow log is cut, never thinned.
        assert_eq!(Grid::covering(50.0, 86_400.0).thinning, 1);
    }

    #[test]
    fn jitter_moves_no_sample_to_another_cell() {
        let mut grid = Grid::covering(1000.0, 400.0);
        assert_eq!(grid.thinning, 2);
        for tick in 0..1000i64 {
            let jitter = [0, 400_000, -400_000][tick as usize % 3];
            let time_ns = 5_000_000_000 + tick * 1_000_000 + if tick == 0 { 0 } else { jitter };
            assert_eq!(grid.place(time_ns), Place::In(tick as usize / 2), "{tick}");
        }
        assert_eq!(grid.start_ns(), 5_000_000_000);
        assert_eq!(grid.place(4_000_000_000), Place::Outside);
        assert_eq!(grid.place(i64::MAX), Place::End);
    }
}

//! Sources as the daemon reads them: a bus, or a log played at its own pace, faster, or as fast as it is read.

use std::path::Path;
use std::thread;
use std::time::Duration;

use seepd_logs::{LogError, Source, open};
use seepd_signals::Sample;
use tokio::sync::mpsc;

use super::socketcan::CanSource;
use crate::clock::Clock;
use crate::config::{AxisConfig, Pace};
use crate::failure::{Code, Failure};
use crate::hub::{SourceHealth, SourceState};
use crate::sink::plain::one_line;

/// What a source says when it is asked.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Input {
    /// There are samples.
    Samples,
    /// Nothing came for a while.
    Idle,
    /// There is no input, and why; it is tried again.
    Down(String),
    /// The log has ended, well or with an error.
    End(Option<String>),
}

/// A source of the daemon.
pub(super) enum LiveSource {
    /// A bus.
    Can(Box<CanSource>),
    /// A log.
    Log(Box<PlayedLog>),
}

impl LiveSource {
    /// Opens an axis's source, for a model of a rate, Hz, where there is one. A bus that is not there yet is no error.
    ///
    /// # Errors
    /// [`Failure`] where there is neither a bus nor a log, the log is a file that cannot be read, or the mapping fits neither.
    pub(super) fn open(config: &AxisConfig, rate_hz: Option<f64>, clock: Clock) -> Result<Self, Failure> {
        match (&config.source.can, &config.source.log) {
            (Some(_), _) => Ok(LiveSource::Can(Box::new(CanSource::new(config, rate_hz, clock)?))),
            (None, Some(log)) => Ok(LiveSource::Log(Box::new(PlayedLog::open(log, config, clock)?))),
            (None, None) => Err(Failure::new(
                Code::Configuration,
                format!(
                    "axis {}: there is no source; set source.can (a CAN interface) or source.log (a log)",
                    config.axis
                ),
            )),
        }
    }

    /// Waits for input and appends what came to `samples`. May be dropped at any await without loss.
    pub(super) async fn read(&mut self, samples: &mut Vec<Sample>) -> Input {
        match self {
            LiveSource::Can(can) => can.read(samples).await,
            LiveSource::Log(log) => log.read(samples).await,
        }
    }

    /// Condition and counts.
    pub(super) fn health(&self) -> SourceHealth {
        match self {
            LiveSource::Can(can) => can.health(),
            LiveSource::Log(log) => log.health.clone(),
        }
    }
}

/// Samples that travel together from the reading thread.
const BATCH: usize = 256;
/// Batches under way.
const BATCHES: usize = 16;
/// Longest wait before the caller hears that nothing has come.
const IDLE: Duration = Duration::from_millis(250);

enum Portion {
    Samples(Vec<Sample>),
    End(Option<String>),
}

/// A log that a thread reads, given out at its own pace, so many times faster, or as fast as it is read.
pub(super) struct PlayedLog {
    portions: mpsc::Receiver<Portion>,
    /// Read, and not yet due.
    ahead: std::vec::IntoIter<Sample>,
    next: Option<Sample>,
    /// Times faster than it was recorded; none: as fast as it is read.
    speed: Option<f64>,
    clock: Clock,
    /// The first sample's time, in the log and on the line, ns.
    begin_ns: Option<(i64, i64)>,
    health: SourceHealth,
    ended: Option<Option<String>>,
}

/// Whether a log is a pipe, a terminal or the like: what one reader has read no other reads again.
pub(super) fn is_stream(path: &Path) -> bool {
    path == Path::new("-") || std::fs::metadata(path).is_ok_and(|facts| !facts.is_file() && !facts.is_dir())
}

impl PlayedLog {
    fn open(path: &Path, config: &AxisConfig, clock: Clock) -> Result<Self, Failure> {
        // A file says at once whether it can be read. A pipe or a terminal may let one wait for its first byte: its thread waits.
        let mapping = config.log_mapping();
        let opened = if is_stream(path) { None } else { Some(open(path, &mapping)?) };
        let place = path.to_owned();
        let open_now = move || opened.map_or_else(|| open(&place, &mapping), Ok);
        let speed = (config.source.pace == Pace::Recorded).then_some(1.0);
        let health = SourceHealth { name: seepd_logs::log_name(path), ..SourceHealth::default() };
        PlayedLog::play(&config.axis, open_now, health, speed, clock)
    }

    /// Plays whatever gives samples, so many times faster than it was recorded, or as fast as it is read. Its thread opens it.
    ///
    /// # Errors
    /// [`Failure`] where the system gives no thread.
    pub(super) fn play(
        axis: &str,
        open: impl FnOnce() -> Result<Box<dyn Source + Send>, LogError> + Send + 'static,
        health: SourceHealth,
        speed: Option<f64>,
        clock: Clock,
    ) -> Result<Self, Failure> {
        let (sender, portions) = mpsc::channel(BATCHES);
        let axis = axis.to_owned();
        let read = move || {
            let mut source = match open() {
                Ok(source) => source,
                Err(error) => {
                    let _ =
                        sender.blocking_send(Portion::End(Some(one_line(&error.to_string()).into_owned())));
                    return;
                }
            };
            loop {
                let mut samples = Vec::with_capacity(BATCH);
                let mut end = None;
                while samples.len() < BATCH && end.is_none() {
                    match source.next_sample() {
                        Ok(Some(sample)) => samples.push(sample),
                        Ok(None) => end = Some(None),
                        Err(error) => end = Some(Some(one_line(&error.to_string()).into_owned())),
                    }
                }
                if sender.blocking_send(Portion::Samples(samples)).is_err() {
                    return;
                }
                if let Some(end) = end {
                    for note in source.notes() {
                        tracing::warn!(axis, "{}", one_line(&note));
                    }
                    let _ = sender.blocking_send(Portion::End(end));
                    return;
                }
            }
        };
        thread::Builder::new().name("log".into()).spawn(read).map_err(|error| {
            Failure::new(Code::Internal, format!("the log cannot be read in the background: {error}"))
        })?;
        Ok(PlayedLog {
            portions,
            ahead: Vec::new().into_iter(),
            next: None,
            speed,
            clock,
            begin_ns: None,
            health,
            ended: None,
        })
    }

    async fn read(&mut self, samples: &mut Vec<Sample>) -> Input {
        if self.next.is_none() {
            self.next = self.ahead.next();
        }
        let Some(next) = self.next else { return self.fetch().await };
        let Some(speed) = self.speed else {
            self.begin_ns = Some((0, 0));
            // Others on this thread get their turn between batches.
            tokio::task::yield_now().await;
            return self.give(samples, i64::MAX);
        };
        let now_ns = self.clock.now_ns();
        let (first_ns, line_ns) = *self.begin_ns.get_or_insert((next.time_ns, now_ns));
        // What has been reached of the log by now, in its own time.
        let reached_ns = first_ns.saturating_add((now_ns.saturating_sub(line_ns) as f64 * speed) as i64);
        let wait_ns = (next.time_ns.saturating_sub(reached_ns) as f64 / speed) as i64;
        if wait_ns <= 0 {
            return self.give(samples, reached_ns);
        }
        let wait = Duration::from_nanos(wait_ns.unsigned_abs());
        tokio::time::sleep(wait.min(IDLE)).await;
        if wait > IDLE { Input::Idle } else { self.give(samples, next.time_ns) }
    }

    /// Gives out what the log has up to a time of its own; the samples get the times at which they would come at its own pace.
    fn give(&mut self, samples: &mut Vec<Sample>, until_ns: i64) -> Input {
        let shift_ns = self.begin_ns.map_or(0, |(first_ns, line_ns)| line_ns.saturating_sub(first_ns));
        while let Some(mut sample) = self.next.take().or_else(|| self.ahead.next()) {
            if sample.time_ns > until_ns {
                self.next = Some(sample);
                break;
            }
            sample.time_ns = sample.time_ns.saturating_add(shift_ns);
            samples.push(sample);
            self.health.samples += 1;
        }
        self.health.frames = self.health.samples;
        self.health.state = SourceState::Receiving;
        Input::Samples
    }

    async fn fetch(&mut self) -> Input {
        if let Some(ended) = &self.ended {
            let ended = ended.clone();
            tokio::time::sleep(IDLE).await;
            return Input::End(ended);
        }
        match tokio::time::timeout(IDLE, self.portions.recv()).await {
            Err(_) => Input::Idle,
            Ok(Some(Portion::Samples(samples))) => {
                self.ahead = samples.into_iter();
                Input::Samples
            }
            Ok(Some(Portion::End(error))) => {
                self.health.state = SourceState::Ended;
                self.health.detail.clone_from(&error);
                self.ended = Some(error.clone());
                Input::End(error)
            }
            Ok(None) => {
                self.ended = Some(None);
                Input::End(None)
            }
        }
    }
}

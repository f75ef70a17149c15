//! The live daemon: axes from their sources to the sinks, started, reloaded, watched and stopped as a service.
//!
//! One thread runs all of it but the disks and the page: each axis is a task that reads its source and pushes into its pipeline, each
//! sink a task that hears the [`Hub`]. Nothing but the hub knows both sides. The page has a thread of its own, since anybody may keep it busy.

mod axis;
mod commission;
#[cfg(feature = "simulate")]
pub mod demo;
#[cfg(feature = "simulate")]
mod press;
mod relative;
mod repairs;
mod sinks;
pub mod socketcan;
mod source;
mod stamps;
pub mod state;
mod systemd;

use std::hash::{BuildHasher, RandomState};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::time::Duration;

use sd_notify::NotifyState;
use seepd_monitor::pipeline::DutyCycle;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::{mpsc, watch};
use tokio::task::JoinHandle;
use tokio::time::timeout;

use crate::clock::Clock;
use crate::config::{AxisConfig, DaemonConfig};
use crate::failure::{Code, Failure};
use crate::hub::{AxisStatus, AxisView, Hub, Publication};
use crate::reasons::UNUSABLE_CONFIGURATION;
use crate::sink::recording::Recorder;
use axis::AxisContext;
use sinks::{RunningSink, SinkConfig, check_sink, sink_configs};
pub use sinks::{check_sinks, sinks_left_out};
use source::{LiveSource, is_stream};
use stamps::{Stamps, axis_files, stamps};
use state::{Drawn, Keeper, Trends, read_events, read_trends, write_events, write_trends};
use systemd::{Watchdog, one_line, tell};

/// Time that tasks have to end by themselves.
const ENDING: Duration = Duration::from_millis(1200);
/// Longest wait of the state for the events by which it came to be; a disk that hangs must not hold it up for ever.
const EVENTS_FIRST: Duration = Duration::from_secs(2);
/// The trends, which are for people, are written this often.
const TREND_EVERY: Duration = Duration::from_secs(600);
/// What the disk did not take is tried again this often.
const RETRY_DISK: Duration = Duration::from_secs(10);
/// The state's name among the sinks.
const STATE_SINK: &str = "state";
/// Events that may wait for the main loop, which hands them to the recording and may be held up by a slow disk.
const EVENTS: usize = 4096;
/// The main loop looks for ended axes this often.
const LOOK: Duration = Duration::from_millis(100);

/// Where state goes: as configured, else where the service manager says, else `seepd-state`.
pub fn state_folder(config: &DaemonConfig) -> PathBuf {
    let of_service = || std::env::var_os("STATE_DIRECTORY").map(PathBuf::from);
    config.state_dir.clone().or_else(of_service).unwrap_or_else(|| "seepd-state".into())
}

/// Runs the daemon with a configuration file until it is told to stop, or all of its logs have been read.
///
/// # Errors
/// [`Failure`] where the configuration cannot be used, or no axis can be started.
pub async fn run(path: &Path) -> Result<(), Failure> {
    let config = DaemonConfig::read(path)?;
    let mut daemon = Daemon::new(state_folder(&config))?;
    // Before it is ready: whoever reloads it then must not end it.
    let signals = Signals::new()?;
    daemon.start(&config)?;
    tell(&[NotifyState::Ready, NotifyState::Status(&daemon.status_line())]);
    tracing::info!("{}", daemon.status_line());
    remark(&config);
    let result = daemon.work(Some(path), signals).await;
    tell(&[NotifyState::Stopping]);
    daemon.stop().await;
    result
}

/// What the daemon heeds.
struct Signals {
    reload: Signal,
    terminate: Signal,
    interrupt: Signal,
    /// A file has reached the size that the process may give one: the write that failed says so itself, and the signal must end nothing.
    _file_size: Signal,
}

impl Signals {
    fn new() -> Result<Self, Failure> {
        let listen = |kind| {
            signal(kind).map_err(|error| {
                Failure::new(Code::Internal, format!("signals of the system cannot be received: {error}"))
            })
        };
        Ok(Signals {
            reload: listen(SignalKind::hangup())?,
            terminate: listen(SignalKind::terminate())?,
            interrupt: listen(SignalKind::interrupt())?,
            _file_size: listen(SignalKind::from_raw(nix::libc::SIGXFSZ))?,
        })
    }
}

/// An axis at work.
struct RunningAxis {
    config: AxisConfig,
    files: Stamps,
    stop: watch::Sender<bool>,
    task: JoinHandle<bool>,
    progress: Arc<AtomicU64>,
}

struct Daemon {
    clock: Clock,
    hub: Arc<Hub>,
    keeper: Keeper,
    state_folder: PathBuf,
    /// Why the state is not on disk; told once.
    unsaved: Option<String>,
    axes: Vec<RunningAxis>,
    sinks: Vec<RunningSink>,
    /// Sinks that could not be started, which are tried again.
    unstarted: Vec<SinkConfig>,
    recorder: watch::Sender<Option<Recorder>>,
    watchdog: Watchdog,
    /// Trends of an earlier run, until their axes take them up.
    trends: Trends,
    /// The newest event that is on disk.
    event_on_disk: Option<Arc<str>>,
}

/// An axis whose files have been read and found good.
struct ReadyAxis {
    config: AxisConfig,
    duty_cycles: Vec<DutyCycle>,
    source: LiveSource,
}

impl Daemon {
    fn new(state_folder: PathBuf) -> Result<Self, Failure> {
        let keeper = Keeper::open(&state_folder)?;
        let hub = Hub::new(run_name());
        hub.recall(read_events(&state_folder));
        Ok(Daemon {
            clock: Clock::start(),
            event_on_disk: hub.history().pop(),
            hub,
            keeper,
            trends: read_trends(&state_folder),
            state_folder,
            unsaved: None,
            axes: Vec::new(),
            sinks: Vec::new(),
            unstarted: Vec::new(),
            recorder: watch::Sender::new(None),
            watchdog: Watchdog::new(),
        })
    }

    /// Starts sinks, then axes. An axis that cannot be started leaves the others alone, unless it is the only one.
    fn start(&mut self, config: &DaemonConfig) -> Result<(), Failure> {
        let sinks = sink_configs(config);
        // A file that is named and missing is a fault of the configuration, which no new start mends.
        sinks
            .iter()
            .try_for_each(check_sink)
            .map_err(|failure| Failure::new(Code::Configuration, failure.message))?;
        sinks.into_iter().for_each(|sink| self.start_sink(sink));
        let mut first_failure = None;
        for axis in &config.axes {
            match self.prepare(axis) {
                Ok(ready) => self.start_axis(ready),
                Err(failure) => {
                    tracing::error!(axis = axis.axis, "{}: {failure}", axis.axis);
                    self.show_unusable(axis, &failure);
                    first_failure.get_or_insert(failure);
                }
            }
        }
        match first_failure {
            Some(failure) if self.axes.is_empty() => Err(Failure::new(Code::Configuration, failure.message)),
            _ => Ok(()),
        }
    }

    fn prepare(&self, config: &AxisConfig) -> Result<ReadyAxis, Failure> {
        let duty_cycles = config.load_models()?;
        let rate_hz = duty_cycles.first().map(|first| first.model.file().sample_rate_hz);
        let source = LiveSource::open(config, rate_hz, self.clock)?;
        Ok(ReadyAxis { config: config.clone(), duty_cycles, source })
    }

    fn show_unusable(&self, config: &AxisConfig, failure: &Failure) {
        let (orders, _) = mpsc::channel(1);
        let mut status = AxisStatus::new(&config.axis, config.reference_dp_pa);
        status.reason = Some(UNUSABLE_CONFIGURATION);
        status.stale = true;
        status.source.detail = Some(failure.message.clone());
        self.hub.add_axis(status, orders);
    }

    fn start_axis(&mut self, ready: ReadyAxis) {
        let ReadyAxis { config, duty_cycles, source } = ready;
        let (order_sender, orders) = mpsc::channel(8);
        let (stop, stopped) = watch::channel(false);
        let progress = Arc::new(AtomicU64::new(0));
        self.hub.add_axis(AxisStatus::new(&config.axis, config.reference_dp_pa), order_sender);
        if let Some(drawn) = self.trends.remove(&config.axis) {
            self.hub.update_axis(&config.axis, |_, view| {
                drawn.trend.into_iter().for_each(|point| view.add_trend(point));
                view.healthy = drawn.healthy;
            });
        }
        let context = AxisContext {
            hub: Arc::clone(&self.hub),
            keeper: self.keeper.clone(),
            recorder: self.recorder.subscribe(),
            clock: self.clock,
            folder: self.state_folder.clone(),
            progress: Arc::clone(&progress),
        };
        let files = stamps(axis_files(&config));
        let task = tokio::spawn(axis::run(config.clone(), duty_cycles, source, context, orders, stopped));
        self.axes.push(RunningAxis { config, files, stop, task, progress });
        self.watch_axes();
    }

    fn watch_axes(&mut self) {
        self.watchdog.watch(self.axes.iter().map(|axis| Arc::clone(&axis.progress)).collect());
    }

    /// Works until told to stop, or until all axes have ended. Without a configuration file there is nothing to reload: a terminal that
    /// hangs up ends it.
    async fn work(&mut self, path: Option<&Path>, signals: Signals) -> Result<(), Failure> {
        let Signals { mut reload, mut terminate, mut interrupt, _file_size } = signals;
        let mut kept = self.keeper.changes();
        let mut events = self.hub.subscribe(EVENTS);
        let watch_every = self.watchdog.every.unwrap_or(LOOK);
        let mut trend = tokio::time::interval(TREND_EVERY);
        trend.tick().await;
        let mut retry = tokio::time::interval(RETRY_DISK);
        retry.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        let mut watch = tokio::time::interval(watch_every.min(LOOK * 5));
        watch.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        let result = loop {
            tokio::select! {
                _ = terminate.recv() => break Ok(()),
                _ = interrupt.recv() => break Ok(()),
                _ = reload.recv() => match path {
                    Some(path) => self.reload(path).await,
                    None => break Ok(()),
                },
                Some(event) = events.recv() => self.record(&event),
                _ = kept.changed() => self.write_state().await,
                _ = retry.tick() => self.retry().await,
                _ = trend.tick() => self.write_trends().await,
                _ = watch.tick() => {
                    if self.watchdog.every.is_some() {
                        self.watchdog.feed();
                    }
                    if self.axes.iter().all(|axis| axis.task.is_finished()) {
                        break self.heed_ended().await;
                    }
                }
            }
        };
        while let Some(event) = events.try_recv() {
            self.record(&event);
        }
        let lost = events.lost();
        if lost > 0 {
            tracing::error!("{lost} events were not recorded, because the recording could not keep up");
        }
        result
    }

    fn record(&self, event: &Arc<Publication>) {
        if let Some(recorder) = self.recorder.borrow().as_ref() {
            recorder.event(event);
        }
    }

    /// All logs have been read, or an axis died of a fault of the program, which the service manager mends by a new start.
    async fn heed_ended(&mut self) -> Result<(), Failure> {
        let mut result = Ok(());
        for axis in std::mem::take(&mut self.axes) {
            if let Err(error) = axis.task.await {
                result = Err(Failure::new(Code::Internal, format!("axis {}: {error}", axis.config.axis)));
            }
        }
        result
    }

    /// Writes the state, after the events by which it came to it: a kill in between repeats an alarm, and loses none.
    async fn write_state(&mut self) {
        let (keeper, folder) = (self.keeper.clone(), self.state_folder.clone());
        let axes = keeper.axes();
        if !self.hub.all_kept(EVENTS_FIRST).await {
            tracing::warn!(
                "the state is written before its events, which the disk has not taken within {} s",
                EVENTS_FIRST.as_secs()
            );
        }
        let events = self.hub.history();
        let newest = events.last().cloned();
        let are_new = newest != self.event_on_disk;
        let written = tokio::task::spawn_blocking(move || {
            keeper.write(&folder, axes)?;
            if are_new { write_events(&folder, &events) } else { Ok(()) }
        })
        .await;
        if matches!(written, Ok(Ok(()))) {
            self.event_on_disk = newest;
        }
        self.heed_written(written.unwrap_or_else(|error| Err(io::Error::other(error))));
    }

    /// Tells once that the state cannot be written, and once that it can be again.
    fn heed_written(&mut self, written: io::Result<()>) {
        let folder = self.state_folder.display().to_string();
        let unsaved = written.err().map(|error| format!("the state in {folder} cannot be written: {error}"));
        if unsaved != self.unsaved {
            match &unsaved {
                Some(complaint) => {
                    tracing::error!("{complaint}; trying again every {} s", RETRY_DISK.as_secs());
                }
                None => tracing::info!("the state in {folder} is written again"),
            }
        }
        self.hub.update_sink(STATE_SINK, |sink| {
            (sink.good, sink.waiting) = (unsaved.is_none(), u64::from(unsaved.is_some()));
            sink.sent += u64::from(unsaved.is_none());
            sink.detail = unsaved.clone().unwrap_or(folder);
        });
        self.unsaved = unsaved;
    }

    async fn write_trends(&self) {
        let drawn = |view: &AxisView| Drawn {
            trend: view.trend.iter().copied().collect(),
            healthy: view.healthy.clone(),
        };
        let (trends, folder) = (self.hub.views(drawn), self.state_folder.clone());
        let written = tokio::task::spawn_blocking(move || write_trends(&folder, trends)).await;
        if let Ok(Err(error)) = written {
            tracing::error!("the trends in {} cannot be written: {error}", self.state_folder.display());
        }
    }

    /// Takes a changed configuration over, if all of it is good; what it does not change goes on undisturbed.
    async fn reload(&mut self, path: &Path) {
        tell(&[NotifyState::Reloading, monotonic()]);
        match self.try_reload(path).await {
            Ok(()) => tracing::info!("the changed configuration is in force: {}", self.status_line()),
            Err(failure) => tracing::error!("the old configuration stays in force: {failure}"),
        }
        tell(&[NotifyState::Ready, NotifyState::Status(&self.status_line())]);
    }

    async fn try_reload(&mut self, path: &Path) -> Result<(), Failure> {
        let config = DaemonConfig::read(path)?;
        if state_folder(&config) != self.state_folder {
            return Err(Failure::configuration(
                path,
                "state_dir cannot change while the daemon runs; restart the daemon",
            ));
        }
        let sinks = sink_configs(&config);
        sinks.iter().try_for_each(check_sink)?;
        let same = |running: &RunningAxis, axis: &AxisConfig| {
            running.config == *axis
                && running.files == stamps(axis_files(axis))
                && !running.task.is_finished()
        };
        let axes = &config.axes;
        let mut ready = Vec::new();
        for axis in axes {
            if !self.axes.iter().any(|running| same(running, axis)) {
                self.refuse_second_reader(path, axis)?;
                ready.push(self.prepare(axis)?);
            }
        }
        let (stay, go): (Vec<_>, Vec<_>) = std::mem::take(&mut self.axes)
            .into_iter()
            .partition(|running| axes.iter().any(|axis| same(running, axis)));
        self.axes = stay;
        for axis in go {
            let name = axis.config.axis.clone();
            end_axis(axis).await;
            if !axes.iter().any(|axis| axis.axis == name) {
                self.hub.remove_axis(&name);
            }
        }
        let (stay, go): (Vec<_>, Vec<_>) = std::mem::take(&mut self.sinks).into_iter().partition(|running| {
            sinks.contains(&running.config) && running.files == stamps(running.config.files())
        });
        self.sinks = stay;
        for sink in go {
            self.end_sink(sink).await;
        }
        for sink in std::mem::take(&mut self.unstarted) {
            self.hub.remove_sink(&sink.name());
        }
        for sink in sinks {
            if !self.sinks.iter().any(|running| running.config == sink) {
                self.start_sink(sink);
            }
        }
        self.hub.end_parked();
        ready.into_iter().for_each(|axis| self.start_axis(axis));
        self.watch_axes();
        remark(&config);
        Ok(())
    }

    /// An axis that reads a pipe cannot be changed: its reader waits within the system until something comes, and would take the
    /// beginning from the next one.
    fn refuse_second_reader(&self, path: &Path, axis: &AxisConfig) -> Result<(), Failure> {
        let Some(log) = axis.source.log.as_deref().filter(|log| is_stream(log)) else { return Ok(()) };
        let reads_it = |running: &RunningAxis| running.config.source.log.as_deref() == Some(log);
        if !self.axes.iter().any(|running| reads_it(running) && !running.task.is_finished()) {
            return Ok(());
        }
        let what = format!(
            "axis {} reads {}, a pipe, which cannot be read from its beginning again; restart the daemon to change the axis",
            axis.axis,
            log.display()
        );
        Err(Failure::configuration(path, what))
    }

    /// Ends axes, writes the state, ends sinks: in this order, so that the last events still go out.
    async fn stop(&mut self) {
        for axis in std::mem::take(&mut self.axes) {
            end_axis(axis).await;
        }
        self.write_state().await;
        self.write_trends().await;
        let ends: Vec<_> =
            std::mem::take(&mut self.sinks).into_iter().map(|sink| tokio::spawn(sink.end())).collect();
        for end in ends {
            let _ = end.await;
        }
    }

    fn status_line(&self) -> String {
        let axes: Vec<String> = self
            .axes
            .iter()
            .map(|axis| {
                let source = &axis.config.source;
                let log = source.log.as_ref().map(|log| log.display().to_string());
                format!("{} from {}", axis.config.axis, source.can.clone().or(log).unwrap_or_default())
            })
            .collect();
        let line = format!("{} axes ({}), {} sinks", axes.len(), axes.join(", "), self.sinks.len());
        one_line(&line)
    }
}

fn remark(config: &DaemonConfig) {
    config.remarks().iter().for_each(|remark| tracing::warn!("{remark}"));
}

fn monotonic() -> NotifyState<'static> {
    NotifyState::monotonic_usec_now().unwrap_or(NotifyState::Status("reloading"))
}

async fn end_axis(axis: RunningAxis) {
    axis.stop.send_replace(true);
    end_task(axis.task).await;
}

/// Waits for a task that was told to end, and ends it where it does not.
async fn end_task<T>(task: JoinHandle<T>) {
    let abort = task.abort_handle();
    if timeout(ENDING, task).await.is_err() {
        abort.abort();
    }
}

/// A name that no other run has: 64 random bits, which the standard library takes from the system.
pub(crate) fn run_name() -> String {
    format!("{:016x}", RandomState::new().hash_one(Clock::start().now_ns()))
}

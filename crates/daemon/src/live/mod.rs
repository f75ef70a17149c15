//! The live daemon: axes from their sources to the sinks, started, reloaded, watched and stopped as a service.
//!
//! One thread runs all of it but the disks: each axis is a task that reads its source and pushes into its pipeline, each
//! sink a task that hears the [`hub`]. Nothing but the hub knows both sides.

pub mod axis;
pub mod clock;
pub mod commission;
pub mod hub;
pub mod journal;
pub mod socketcan;
pub mod source;
pub mod spool;
pub mod state;
pub mod systemd;

use std::fs;
use std::hash::{BuildHasher, RandomState};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::thread;
use std::time::{Duration, SystemTime};

use sd_notify::NotifyState;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::{mpsc, watch};
use tokio::task::JoinHandle;
use tokio::time::{sleep, timeout};

use seepd_monitor::pipeline::DutyCycle;

use crate::config::{AxisConfig, CanOutConfig, DaemonConfig, HttpConfig, MqttConfig, RecordingConfig};
use crate::failure::{Code, Failure};
use crate::live::source::LiveSource;
use crate::sink::can::{self, Layout};
use crate::sink::http::{self, Http};
use crate::sink::mqtt::{self, Broker};
use crate::sink::recording::{self, Recorder};
use axis::AxisContext;
use clock::Clock;
use hub::{AxisStatus, Hub};
use state::{Keeper, Trends, read_trends, write_trends};
use systemd::{Watchdog, one_line, tell};

/// Time that tasks have to end by themselves.
const ENDING: Duration = Duration::from_millis(1200);
/// Wait before a port that is taken is tried again.
const RETRY_PORT: Duration = Duration::from_secs(3);
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

/// Whether the sinks' files can be read; nothing is opened, made or sent.
///
/// # Errors
/// [`Failure`] of the first that cannot.
pub fn check_sinks(config: &DaemonConfig) -> Result<(), Failure> {
    sink_configs(config).iter().try_for_each(check_sink)
}

fn check_sink(config: &SinkConfig) -> Result<(), Failure> {
    match config {
        SinkConfig::Http(http) => http::token(http).map(drop),
        SinkConfig::Mqtt(mqtt) => mqtt::credentials(mqtt).map(drop),
        SinkConfig::Can(frame, _) => Layout::new(frame).map(drop),
        SinkConfig::Recording(..) => Ok(()),
    }
}

/// Runs the daemon with a configuration file until it is told to stop, or all of its logs have been read.
///
/// # Errors
/// [`Failure`] where the configuration cannot be used, or no axis can be started.
pub async fn run(path: &Path) -> Result<(), Failure> {
    let config = DaemonConfig::read(path)?;
    let mut daemon = Daemon::new(&config)?;
    // Before it is ready: whoever reloads it then must not end it.
    let signals = Signals::new()?;
    daemon.start(&config)?;
    tell(&[NotifyState::Ready, NotifyState::Status(&daemon.status_line())]);
    tracing::info!("{}", daemon.status_line());
    remark(&config);
    let result = daemon.work(path, signals).await;
    tell(&[NotifyState::Stopping]);
    daemon.stop().await;
    result
}

/// What the daemon heeds.
struct Signals {
    reload: Signal,
    terminate: Signal,
    interrupt: Signal,
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

/// What a sink is configured to do.
#[derive(Debug, Clone, PartialEq)]
enum SinkConfig {
    Http(HttpConfig),
    Mqtt(MqttConfig),
    Can(CanOutConfig, String),
    Recording(RecordingConfig, Vec<String>),
}

impl SinkConfig {
    fn name(&self) -> String {
        match self {
            SinkConfig::Http(_) => http::SINK.into(),
            SinkConfig::Mqtt(_) => mqtt::SINK.into(),
            SinkConfig::Can(frame, _) => can::sink_name(frame),
            SinkConfig::Recording(..) => recording::SINK.into(),
        }
    }

    /// Secrets and certificates.
    fn files(&self) -> impl Iterator<Item = &PathBuf> {
        let files = match self {
            SinkConfig::Http(http) => [http.token_file.as_ref(), None, None, None],
            SinkConfig::Mqtt(mqtt) => {
                let ca_file = Some(&mqtt.ca_file).filter(|_| mqtt.tls);
                let own = [&mqtt.password_file, &mqtt.certificate_file, &mqtt.key_file].map(Option::as_ref);
                [ca_file, own[0], own[1], own[2]]
            }
            SinkConfig::Can(..) | SinkConfig::Recording(..) => [None; 4],
        };
        files.into_iter().flatten()
    }
}

struct RunningSink {
    config: SinkConfig,
    files: Stamps,
    name: String,
    stop: watch::Sender<bool>,
    task: Ending,
}

enum Ending {
    Task(JoinHandle<()>),
    Thread(Recorder, thread::JoinHandle<()>),
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
}

/// An axis whose files have been read and found good.
struct ReadyAxis {
    config: AxisConfig,
    duty_cycles: Vec<DutyCycle>,
    source: LiveSource,
}

impl Daemon {
    fn new(config: &DaemonConfig) -> Result<Self, Failure> {
        let state_folder = state_folder(config);
        Ok(Daemon {
            clock: Clock::start(),
            hub: Hub::new(run_name()),
            keeper: Keeper::open(&state_folder)?,
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
        let rate_hz = duty_cycles.first().map_or(0.0, |first| first.model.file().sample_rate_hz);
        let source = LiveSource::open(config, rate_hz, self.clock)?;
        Ok(ReadyAxis { config: config.clone(), duty_cycles, source })
    }

    fn show_unusable(&self, config: &AxisConfig, failure: &Failure) {
        let (orders, _) = mpsc::channel(1);
        let mut status = AxisStatus::new(&config.axis, config.reference_dp_pa);
        status.reason = Some("unusable_configuration");
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
        if let Some(trend) = self.trends.remove(&config.axis) {
            self.hub.update_axis(&config.axis, |_, view| {
                trend.into_iter().for_each(|point| view.add_trend(point));
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

    fn spool_folder(&self) -> PathBuf {
        self.state_folder.join("spool")
    }

    /// Starts a sink; one that cannot be started is told of once and tried again, and the others go on.
    fn start_sink(&mut self, config: SinkConfig) {
        let name = config.name();
        let Err(failure) = self.try_start_sink(config.clone(), &name) else {
            self.hub.update_sink(&name, |sink| sink.good = true);
            return;
        };
        let mut told = false;
        self.hub.update_sink(&name, |sink| {
            told = !sink.good && sink.detail == failure.message;
            (sink.good, sink.detail) = (false, failure.message.clone());
        });
        if !told {
            tracing::error!("{name}: {failure}; trying again every {} s", RETRY_DISK.as_secs());
        }
        self.unstarted.push(config);
    }

    /// Tries again what a disk, a folder or a missing file has prevented.
    async fn retry(&mut self) {
        if self.unsaved.is_some() {
            self.write_state().await;
        }
        std::mem::take(&mut self.unstarted).into_iter().for_each(|sink| self.start_sink(sink));
    }

    fn try_start_sink(&mut self, config: SinkConfig, name: &str) -> Result<(), Failure> {
        let (stop, stopped) = watch::channel(false);
        let files = stamps(config.files());
        let hub = Arc::clone(&self.hub);
        let task = match &config {
            SinkConfig::Http(http) => {
                let site = Http::new(http, hub, self.clock, stopped.clone())?;
                let serve = serve(site, http.clone(), Arc::clone(&self.hub), stopped);
                Ending::Task(tokio::spawn(serve))
            }
            SinkConfig::Mqtt(mqtt) => {
                let broker = Broker::new(mqtt, &self.spool_folder(), hub)?;
                Ending::Task(tokio::spawn(broker.run(stopped)))
            }
            SinkConfig::Can(frame, axis) => {
                let layout = Layout::new(frame)?;
                let task = can::run(frame.clone(), layout, axis.clone(), hub, stopped);
                Ending::Task(tokio::spawn(task))
            }
            SinkConfig::Recording(recording, axes) => {
                let folder = recording.folder.clone().unwrap_or_else(|| self.state_folder.join("recordings"));
                let (recorder, thread) = recording::start(recording, &folder, axes.clone(), hub)?;
                self.recorder.send_replace(Some(recorder.clone()));
                Ending::Thread(recorder, thread)
            }
        };
        self.sinks.push(RunningSink { config, files, name: name.to_owned(), stop, task });
        Ok(())
    }

    /// Works until told to stop, or until all axes have ended.
    async fn work(&mut self, path: &Path, signals: Signals) -> Result<(), Failure> {
        let Signals { mut reload, mut terminate, mut interrupt } = signals;
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
                _ = reload.recv() => self.reload(path).await,
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

    fn record(&self, event: &Arc<hub::Publication>) {
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

    async fn write_state(&mut self) {
        let (keeper, folder) = (self.keeper.clone(), self.state_folder.clone());
        let written = tokio::task::spawn_blocking(move || keeper.write(&folder)).await;
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
        let (trends, folder) = (self.hub.trends(), self.state_folder.clone());
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
        ready.into_iter().for_each(|axis| self.start_axis(axis));
        self.watch_axes();
        remark(&config);
        Ok(())
    }

    async fn end_sink(&mut self, sink: RunningSink) {
        if matches!(sink.task, Ending::Thread(..)) {
            self.recorder.send_replace(None);
        }
        let name = sink.name.clone();
        sink.end().await;
        self.hub.remove_sink(&name);
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
    let abort = axis.task.abort_handle();
    if timeout(ENDING, axis.task).await.is_err() {
        abort.abort();
    }
}

impl RunningSink {
    async fn end(self) {
        self.stop.send_replace(true);
        match self.task {
            Ending::Task(task) => {
                let abort = task.abort_handle();
                if timeout(ENDING, task).await.is_err() {
                    abort.abort();
                }
            }
            Ending::Thread(recorder, thread) => {
                let end = tokio::task::spawn_blocking(move || {
                    recorder.stop();
                    thread.join().is_ok()
                });
                let _ = timeout(ENDING, end).await;
            }
        }
    }
}

/// Opens the port as soon as it is free, and serves.
async fn serve(site: Http, config: HttpConfig, hub: Arc<Hub>, mut stop: watch::Receiver<bool>) {
    loop {
        match site.bind().await {
            Ok(listener) => return site.run(listener).await,
            Err(error) => {
                let what = format!("opening {}: {error}", config.listen);
                tracing::error!("http: {what}; trying again");
                hub.update_sink(http::SINK, |sink| (sink.good, sink.detail) = (false, what));
            }
        }
        tokio::select! {
            () = sleep(RETRY_PORT) => {}
            _ = stop.changed() => return,
        }
    }
}

fn sink_configs(config: &DaemonConfig) -> Vec<SinkConfig> {
    let names: Vec<String> = config.axes.iter().map(|axis| axis.axis.clone()).collect();
    let sinks = config.sinks.clone();
    let recording = sinks.recording.map(|recording| SinkConfig::Recording(recording, names.clone()));
    let can = sinks.can_out.into_iter().map(|frame| {
        let axis = if frame.axis.is_empty() {
            names.first().cloned().unwrap_or_default()
        } else {
            frame.axis.clone()
        };
        SinkConfig::Can(frame, axis)
    });
    let http = sinks.http.map(SinkConfig::Http);
    let mqtt = sinks.mqtt.map(SinkConfig::Mqtt);
    recording.into_iter().chain(http).chain(mqtt).chain(can).collect()
}

/// When files were last changed, by which a reload tells what to take up anew although the configuration still says the same.
type Stamps = Vec<Option<SystemTime>>;

fn stamps<'a>(files: impl IntoIterator<Item = &'a PathBuf>) -> Stamps {
    files.into_iter().map(|path| fs::metadata(path).ok()?.modified().ok()).collect()
}

/// The files that an axis is made of.
fn axis_files(config: &AxisConfig) -> impl Iterator<Item = &PathBuf> {
    let of_axis = [&config.model, &config.dbc, &config.baseline.file].into_iter().flatten();
    let of_duty_cycles = config.duty_cycles.iter();
    of_axis.chain(
        of_duty_cycles.flat_map(|duty_cycle| [&duty_cycle.model].into_iter().chain(&duty_cycle.baseline)),
    )
}

/// A name that no other run has: 64 random bits, which the standard library takes from the system.
pub(crate) fn run_name() -> String {
    format!("{:016x}", RandomState::new().hash_one(Clock::start().now_ns()))
}

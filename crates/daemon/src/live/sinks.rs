//! The sinks of the daemon: which the configuration names, and how each is started, tried again and ended.

use std::path::PathBuf;
use std::sync::Arc;
use std::thread;
use std::time::Duration;

use tokio::sync::{oneshot, watch};
use tokio::task::JoinHandle;
use tokio::time::{sleep, timeout};

use super::stamps::{Stamps, stamps};
use super::{Daemon, ENDING, RETRY_DISK, end_task};
use crate::config::{
    CanOutConfig, DaemonConfig, FoxgloveConfig, HttpConfig, InfluxConfig, J1939Config, MqttConfig,
    OpenTelemetryConfig, RecordingConfig, SparkplugConfig,
};
use crate::failure::{Code, Failure};
use crate::hub::Hub;
use crate::sink::can::{self, Layout};
#[cfg(feature = "foxglove")]
use crate::sink::foxglove;
use crate::sink::http::{self, Http};
use crate::sink::influx;
#[cfg(feature = "j1939")]
use crate::sink::j1939;
#[cfg(feature = "sparkplug")]
use crate::sink::mqtt::sparkplug::Node;
use crate::sink::mqtt::{self, Broker};
#[cfg(feature = "opentelemetry")]
use crate::sink::opentelemetry::Exporter;
use crate::sink::recording::{self, Recorder};

/// Wait before a port that is taken is tried again.
const RETRY_PORT: Duration = Duration::from_secs(3);

/// What a sink is configured to do.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum SinkConfig {
    Http(HttpConfig),
    Mqtt(MqttConfig),
    Can(CanOutConfig, String),
    Recording(RecordingConfig, Vec<String>),
    Influx(InfluxConfig),
    Sparkplug(SparkplugConfig),
    OpenTelemetry(OpenTelemetryConfig),
    Foxglove(FoxgloveConfig),
    J1939(J1939Config, String),
}

/// Why this build cannot serve a sink that was left out of it.
fn left_out(config: &SinkConfig) -> Option<String> {
    let feature = match config {
        SinkConfig::Sparkplug(_) if cfg!(not(feature = "sparkplug")) => "sparkplug",
        SinkConfig::OpenTelemetry(_) if cfg!(not(feature = "opentelemetry")) => "opentelemetry",
        SinkConfig::Foxglove(_) if cfg!(not(feature = "foxglove")) => "foxglove",
        SinkConfig::J1939(..) if cfg!(not(feature = "j1939")) => "j1939",
        _ => return None,
    };
    Some(format!("this build of seepd does not speak it; build one with the feature `{feature}`"))
}

/// Names of the configured sinks that were left out of this build, and what to do.
pub fn sinks_left_out(config: &DaemonConfig) -> Vec<(String, String)> {
    let sinks = sink_configs(config);
    sinks.iter().filter_map(|sink| Some((sink.name(), left_out(sink)?))).collect()
}

impl SinkConfig {
    pub(super) fn name(&self) -> String {
        match self {
            SinkConfig::Http(_) => http::SINK.into(),
            SinkConfig::Mqtt(_) => mqtt::SINK.into(),
            SinkConfig::Can(frame, _) => can::sink_name(frame),
            SinkConfig::Recording(..) => recording::SINK.into(),
            SinkConfig::Influx(_) => influx::SINK.into(),
            SinkConfig::Sparkplug(_) => "sparkplug".into(),
            SinkConfig::OpenTelemetry(_) => "opentelemetry".into(),
            SinkConfig::Foxglove(_) => "foxglove".into(),
            SinkConfig::J1939(speaker, _) => format!("j1939 {} {:02X}", speaker.interface, speaker.address),
        }
    }

    /// Secrets and certificates.
    pub(super) fn files(&self) -> impl Iterator<Item = &PathBuf> {
        let files = match self {
            SinkConfig::Http(http) => [http.token_file.as_ref(), None, None, None],
            SinkConfig::Mqtt(mqtt) => {
                let ca_file = Some(&mqtt.ca_file).filter(|_| mqtt.tls);
                let own = [&mqtt.password_file, &mqtt.certificate_file, &mqtt.key_file].map(Option::as_ref);
                [ca_file, own[0], own[1], own[2]]
            }
            SinkConfig::Sparkplug(node) => {
                let ca_file = Some(&node.ca_file).filter(|_| node.tls);
                let own = [&node.password_file, &node.certificate_file, &node.key_file].map(Option::as_ref);
                [ca_file, own[0], own[1], own[2]]
            }
            SinkConfig::Foxglove(foxglove) => [foxglove.token_file.as_ref(), None, None, None],
            SinkConfig::OpenTelemetry(telemetry) => {
                let is_https = telemetry.place().is_ok_and(|place| place.tls);
                [Some(&telemetry.ca_file).filter(|_| is_https), telemetry.token_file.as_ref(), None, None]
            }
            SinkConfig::Can(..)
            | SinkConfig::Recording(..)
            | SinkConfig::Influx(_)
            | SinkConfig::J1939(..) => [None; 4],
        };
        files.into_iter().flatten()
    }
}

pub(super) struct RunningSink {
    pub(super) config: SinkConfig,
    pub(super) files: Stamps,
    name: String,
    stop: watch::Sender<bool>,
    task: Ending,
}

pub(super) enum Ending {
    Task(JoinHandle<()>),
    /// Says when the page's thread has ended.
    Page(oneshot::Receiver<()>),
    Thread(Recorder, thread::JoinHandle<()>),
}

/// Whether the sinks' files can be read; nothing is opened, made or sent.
///
/// # Errors
/// [`Failure`] of the first that cannot.
pub fn check_sinks(config: &DaemonConfig) -> Result<(), Failure> {
    sink_configs(config).iter().try_for_each(check_sink)
}

pub(super) fn check_sink(config: &SinkConfig) -> Result<(), Failure> {
    if let Some(what) = left_out(config) {
        return Err(Failure::new(Code::Configuration, format!("{}: {what}", config.name())));
    }
    match config {
        SinkConfig::Http(http) => http::token(http).map(drop),
        SinkConfig::Mqtt(mqtt) => mqtt::credentials(mqtt).map(drop),
        SinkConfig::Sparkplug(node) => mqtt::credentials(&node.connection()).map(drop),
        SinkConfig::Can(frame, _) => Layout::new(frame).map(drop),
        #[cfg(feature = "opentelemetry")]
        SinkConfig::OpenTelemetry(telemetry) => Exporter::new(telemetry, Hub::new("check".into())).map(drop),
        #[cfg(not(feature = "opentelemetry"))]
        SinkConfig::OpenTelemetry(_) => Ok(()),
        #[cfg(feature = "foxglove")]
        SinkConfig::Foxglove(foxglove) => foxglove::Server::new(foxglove, Hub::new("check".into())).map(drop),
        #[cfg(not(feature = "foxglove"))]
        SinkConfig::Foxglove(_) => Ok(()),
        SinkConfig::Recording(..) | SinkConfig::Influx(_) | SinkConfig::J1939(..) => Ok(()),
    }
}

pub(super) fn sink_configs(config: &DaemonConfig) -> Vec<SinkConfig> {
    let names: Vec<String> = config.axes.iter().map(|axis| axis.axis.clone()).collect();
    let sinks = config.sinks.clone();
    let recording = sinks.recording.map(|recording| SinkConfig::Recording(recording, names.clone()));
    // Where there is only one axis it need not be named.
    let axis = |named: &str| match named {
        "" => names.first().cloned().unwrap_or_default(),
        named => named.to_owned(),
    };
    let can = sinks.can_out.into_iter().map(|frame| {
        let axis = axis(&frame.axis);
        SinkConfig::Can(frame, axis)
    });
    let j1939 = sinks.j1939.into_iter().map(|speaker| {
        let axis = axis(&speaker.axis);
        SinkConfig::J1939(J1939Config { axis: axis.clone(), ..speaker }, axis)
    });
    let http = sinks.http.map(SinkConfig::Http);
    let mqtt = sinks.mqtt.map(SinkConfig::Mqtt);
    let influx = sinks.influx.map(SinkConfig::Influx);
    let sparkplug = sinks.sparkplug.map(SinkConfig::Sparkplug);
    let telemetry = sinks.opentelemetry.map(SinkConfig::OpenTelemetry);
    let foxglove = sinks.foxglove.map(SinkConfig::Foxglove);
    let one_each = [recording, http, mqtt, influx, sparkplug, telemetry, foxglove];
    one_each.into_iter().flatten().chain(can).chain(j1939).collect()
}

impl Daemon {
    fn spool_folder(&self) -> PathBuf {
        self.state_folder.join("spool")
    }

    /// Starts a sink; one that cannot be started is told of once and tried again, and the others go on.
    pub(super) fn start_sink(&mut self, config: SinkConfig) {
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
    pub(super) async fn retry(&mut self) {
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
                let (config, of_hub) = (http.clone(), Arc::clone(&self.hub));
                return self.serve_page(http, |site, stopped| serve(site, config, of_hub, stopped));
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
            SinkConfig::Influx(influx) => {
                Ending::Task(tokio::spawn(influx::run(influx.clone(), hub, stopped)))
            }
            #[cfg(feature = "sparkplug")]
            SinkConfig::Sparkplug(node) => Ending::Task(tokio::spawn(Node::new(node, hub)?.run(stopped))),
            #[cfg(feature = "opentelemetry")]
            SinkConfig::OpenTelemetry(telemetry) => {
                Ending::Task(tokio::spawn(Exporter::new(telemetry, hub)?.run(stopped)))
            }
            #[cfg(feature = "foxglove")]
            SinkConfig::Foxglove(config) => {
                Ending::Task(tokio::spawn(foxglove::Server::new(config, hub)?.run(stopped)))
            }
            #[cfg(feature = "j1939")]
            SinkConfig::J1939(speaker, axis) => {
                let speaker = j1939::Speaker::new(speaker.clone(), axis.clone(), hub);
                Ending::Task(tokio::spawn(speaker.run(stopped)))
            }
            SinkConfig::Recording(recording, axes) => {
                let folder = recording.folder.clone().unwrap_or_else(|| self.state_folder.join("recordings"));
                let (recorder, thread) = recording::start(recording, &folder, axes.clone(), hub)?;
                self.recorder.send_replace(Some(recorder.clone()));
                Ending::Thread(recorder, thread)
            }
            #[cfg(not(all(
                feature = "foxglove",
                feature = "j1939",
                feature = "opentelemetry",
                feature = "sparkplug"
            )))]
            other => {
                return Err(Failure::new(Code::Configuration, left_out(other).unwrap_or_default()));
            }
        };
        self.sinks.push(RunningSink { config, files, name: name.to_owned(), stop, task });
        Ok(())
    }

    /// Starts the page on a thread of its own, so that clients, however many, hold up no sample; `serve` opens its port, or has it already.
    pub(super) fn serve_page<S: Future<Output = ()> + Send + 'static>(
        &mut self,
        http: &HttpConfig,
        serve: impl FnOnce(Http, watch::Receiver<bool>) -> S,
    ) -> Result<(), Failure> {
        let (stop, stopped) = watch::channel(false);
        let site = Http::new(http, Arc::clone(&self.hub), self.clock, stopped.clone())?;
        let task = Ending::Page(on_own_thread(serve(site, stopped.clone()), stopped)?);
        let config = SinkConfig::Http(http.clone());
        let (files, name) = (stamps(config.files()), config.name());
        self.sinks.push(RunningSink { config, files, name, stop, task });
        Ok(())
    }

    pub(super) async fn end_sink(&mut self, sink: RunningSink) {
        if matches!(sink.task, Ending::Thread(..)) {
            self.recorder.send_replace(None);
        }
        let name = sink.name.clone();
        sink.end().await;
        self.hub.remove_sink(&name);
    }
}

impl RunningSink {
    pub(super) async fn end(self) {
        self.stop.send_replace(true);
        match self.task {
            Ending::Task(task) => end_task(task).await,
            Ending::Page(ended) => drop(timeout(2 * ENDING, ended).await),
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

/// Serves on a thread that nothing else waits for; once told to stop it has its time to end by itself.
fn on_own_thread(
    serve: impl Future<Output = ()> + Send + 'static,
    mut stop: watch::Receiver<bool>,
) -> Result<oneshot::Receiver<()>, Failure> {
    let failed =
        |error| Failure::new(Code::Internal, format!("the page cannot be served in the background: {error}"));
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(failed)?;
    let (end, ended) = oneshot::channel();
    // Axes that are started behind it say first what they know from before: nobody is to be told that they know nothing.
    let (begin, begun) = oneshot::channel::<()>();
    tokio::spawn(async {
        tokio::task::yield_now().await;
        drop(begin);
    });
    let serve_until_told = move || {
        runtime.block_on(async {
            tokio::select! {
                () = async { let _ = begun.await; serve.await } => {}
                () = async { let _ = stop.changed().await; sleep(ENDING).await } => {}
            }
        });
        runtime.shutdown_background();
        let _ = end.send(());
    };
    thread::Builder::new().name("page".into()).spawn(serve_until_told).map_err(failed)?;
    Ok(ended)
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

//! `seepd test-sinks`: a marked test alarm through each sink.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use clap::Args;
use seepd_monitor::event::Flag;
use serde::Serialize;
use tokio::sync::watch;
use tokio::time::{sleep, timeout};

use crate::cli::Outcome;
use crate::clock::Clock;
use crate::config::{CanOutConfig, DaemonConfig, HttpConfig, MqttConfig, RecordingConfig};
use crate::failure::{Code, Failure};
use crate::hub::{AxisStatus, Hub, Kind};
use crate::live::{sinks_left_out, state_folder};
use crate::private_folder::PrivateFolder;
use crate::sink::can::{self, Layout};
#[cfg(feature = "foxglove")]
use crate::sink::foxglove;
use crate::sink::influx;
#[cfg(feature = "j1939")]
use crate::sink::j1939;
#[cfg(feature = "sparkplug")]
use crate::sink::mqtt::sparkplug;
use crate::sink::mqtt::{self, Broker};
#[cfg(feature = "opentelemetry")]
use crate::sink::opentelemetry;
use crate::sink::recording;
use crate::sink::terminal::print;

/// Time that a sink has for the test.
const PATIENCE: Duration = Duration::from_secs(10);

/// Send a marked test alarm through each sink
///
/// MQTT gets a message on PREFIX/AXIS/test that the broker must confirm; CAN the configured frame with the flag severe and no estimate,
/// which no real leak gives; the recording a file with the test; InfluxDB a line of a measurement of its own, which nobody
/// confirms; for Sparkplug B a node NODE-test is born and dies; OpenTelemetry's endpoint
/// must accept a gauge `seepd_test`. On J1939 a DM1 with FMI 31 is sent. For HTTP and Foxglove, the port must answer or be free.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  seepd test-sinks --config /etc/seepd/seepd.toml")]
pub struct TestSinksArguments {
    /// Configuration of the daemon
    #[arg(long, value_name = "FILE", default_value = "/etc/seepd/seepd.toml")]
    config: PathBuf,
    /// Print one line of JSON for each sink
    #[arg(long)]
    json: bool,
}

/// `seepd.sink_test/1`: how a sink did.
#[derive(Debug, Serialize)]
struct SinkTest {
    schema: &'static str,
    sink: String,
    good: bool,
    message: String,
}

/// Runs the command.
///
/// # Errors
/// [`Failure`] where the configuration cannot be used, or a sink did not take its test.
pub fn run(arguments: &TestSinksArguments) -> Result<Outcome, Failure> {
    let config = DaemonConfig::read(&arguments.config)?;
    let verdicts = super::run::runtime()?.block_on(test_all(&config));
    if verdicts.is_empty() {
        let message = format!("{}: no sink is configured", arguments.config.display());
        return Err(Failure::new(Code::Configuration, message));
    }
    let mut bad = 0;
    for verdict in verdicts {
        bad += usize::from(!verdict.good);
        let line = if arguments.json {
            serde_json::to_string(&verdict).unwrap_or_default()
        } else {
            let word = if verdict.good { "good" } else { "FAILED" };
            format!("{word:>6}  {}: {}", verdict.sink, verdict.message)
        };
        print(format!("{line}\n").as_bytes())?;
    }
    if bad > 0 {
        Err(Failure::new(Code::Io, format!("{bad} of the sinks did not take the test")))
    } else {
        Ok(Outcome::Good)
    }
}

async fn test_all(config: &DaemonConfig) -> Vec<SinkTest> {
    let axis = config.axes.first().map_or("axis", |axis| axis.axis.as_str()).to_owned();
    let mut verdicts = Vec::new();
    let mut note = |sink: String, result: Result<String, String>| {
        let good = result.is_ok();
        let message = result.unwrap_or_else(|message| message);
        verdicts.push(SinkTest { schema: "seepd.sink_test/1", sink, good, message });
    };
    for (sink, message) in sinks_left_out(config) {
        note(sink, Err(message));
    }
    if let Some(mqtt) = &config.sinks.mqtt {
        note(mqtt::SINK.into(), test_mqtt(mqtt, &axis).await);
    }
    for frame in &config.sinks.can_out {
        note(can::sink_name(frame), test_can(frame, &axis));
    }
    #[cfg(feature = "j1939")]
    for speaker in &config.sinks.j1939 {
        note(j1939::sink_name(speaker), j1939::test(speaker).await);
    }
    if let Some(recording) = &config.sinks.recording {
        note(recording::SINK.into(), test_recording(recording, config, &axis).await);
    }
    if let Some(influx) = &config.sinks.influx {
        note(influx::SINK.into(), influx::test(influx, &axis).await);
    }
    #[cfg(feature = "sparkplug")]
    if let Some(node) = &config.sinks.sparkplug {
        note(sparkplug::SINK.into(), sparkplug::test(node, PATIENCE).await);
    }
    #[cfg(feature = "opentelemetry")]
    if let Some(telemetry) = &config.sinks.opentelemetry {
        note(opentelemetry::SINK.into(), opentelemetry::test(telemetry, &axis).await);
    }
    #[cfg(feature = "foxglove")]
    if let Some(config) = &config.sinks.foxglove {
        note(foxglove::SINK.into(), foxglove::test(config).await);
    }
    if let Some(http) = &config.sinks.http {
        note("http".into(), test_http(http).await);
    }
    verdicts
}

async fn test_mqtt(config: &MqttConfig, axis: &str) -> Result<String, String> {
    let hub = Hub::new("test".into());
    let spool = PrivateFolder::make("test-sinks")
        .map_err(|error| format!("no folder could be made for the test: {error}"))?;
    // A name of its own: a broker drops the older of two clients with one name, and that would be the daemon.
    let client_id = Some(format!("seepd-test-{}", std::process::id()));
    let config = MqttConfig { client_id, ..config.clone() };
    let broker = Broker::new(&config, spool.path(), Arc::clone(&hub)).map_err(|failure| failure.message)?;
    let (stop, stopped) = watch::channel(false);
    let task = tokio::spawn(broker.run_without_presence(stopped));
    tokio::task::yield_now().await;
    hub.publish_test(axis, Clock::start().now_ns());
    let confirmed = timeout(PATIENCE, async {
        loop {
            let sink = hub.sinks().into_iter().find(|sink| sink.name == mqtt::SINK);
            if sink.is_some_and(|sink| sink.sent > 0) {
                return;
            }
            sleep(Duration::from_millis(20)).await;
        }
    })
    .await;
    let last = hub.sinks().into_iter().next().map(|sink| sink.detail).unwrap_or_default();
    stop.send_replace(true);
    let _ = timeout(PATIENCE, task).await;
    match confirmed {
        Ok(()) => Ok(format!("the broker confirmed {}/{axis}/{}", config.prefix, Kind::Test.name())),
        Err(_) => Err(format!("the broker confirmed nothing within {} s: {last}", PATIENCE.as_secs())),
    }
}

fn test_can(config: &CanOutConfig, axis: &str) -> Result<String, String> {
    let layout = Layout::new(config).map_err(|failure| failure.message)?;
    let mut status = AxisStatus::new(axis, 7e6);
    status.flag = Flag::Severe;
    let port = can::open(&config.interface).map_err(|error| error.to_string())?;
    can::write(&port, &layout.frame(&status, 0)).map_err(|error| error.to_string())?;
    Ok(format!("frame {:X} sent: flag severe without an estimate", config.id))
}

async fn test_recording(config: &RecordingConfig, all: &DaemonConfig, axis: &str) -> Result<String, String> {
    let hub = Hub::new("test".into());
    let folder = config.folder.clone().unwrap_or_else(|| state_folder(all).join("recordings"));
    let (recorder, thread) = recording::start(config, &folder, vec![axis.into()], Arc::clone(&hub))
        .map_err(|failure| failure.message)?;
    let mut events = hub.subscribe(1);
    hub.publish_test(axis, Clock::start().now_ns());
    if let Some(event) = events.try_recv() {
        recorder.event(&event);
    }
    let end = tokio::task::spawn_blocking(move || {
        recorder.stop();
        thread.join().is_ok()
    });
    let _ = end.await;
    match hub.sinks().into_iter().find(|sink| !sink.good) {
        Some(sink) => Err(sink.detail),
        None => Ok(format!("a file with the test is in {}", folder.display())),
    }
}

async fn test_http(config: &HttpConfig) -> Result<String, String> {
    if let Some(path) = &config.token_file {
        let (_, stopped) = watch::channel(false);
        crate::sink::http::Http::new(config, Hub::new("test".into()), Clock::start(), stopped)
            .map_err(|failure| format!("{}: {}", path.display(), failure.message))?;
    }
    match tokio::net::TcpListener::bind(config.listen).await {
        Ok(_) => Ok(format!("{} is free for the daemon", config.listen)),
        Err(bound) => match tokio::net::TcpStream::connect(config.listen).await {
            Ok(_) => Ok(format!("{} answers", config.listen)),
            Err(_) => Err(format!("{} cannot be opened: {bound}", config.listen)),
        },
    }
}

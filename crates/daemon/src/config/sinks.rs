//! The sinks' tables: dashboard, broker, CAN frames, recordings.

use std::net::{IpAddr, SocketAddr};
use std::path::{Path, PathBuf};

use seepd_logs::can::bit_field::{BitField, ByteOrder, Encoding};
use seepd_logs::identifier;
use serde::{Deserialize, Serialize};

use super::AxisConfig;
use super::plant::{FoxgloveConfig, J1939Config, OpenTelemetryConfig, SparkplugConfig};

/// The tables that are the daemon's, not an axis's.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SinksConfig {
    /// Dashboard, JSON, metrics, health.
    pub http: Option<HttpConfig>,
    /// A broker.
    pub mqtt: Option<MqttConfig>,
    /// Frames that tell the axes' conditions.
    pub can_out: Vec<CanOutConfig>,
    /// MCAP files of what came in and what was said.
    pub recording: Option<RecordingConfig>,
    /// InfluxDB's line protocol.
    pub influx: Option<InfluxConfig>,
    /// Sparkplug B.
    pub sparkplug: Option<SparkplugConfig>,
    /// OpenTelemetry.
    pub opentelemetry: Option<OpenTelemetryConfig>,
    /// Foxglove's WebSocket.
    pub foxglove: Option<FoxgloveConfig>,
    /// Diagnostic messages of J1939.
    pub j1939: Vec<J1939Config>,
}

/// `[http]`: dashboard, JSON, metrics, health.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HttpConfig {
    /// Address and port.
    pub listen: SocketAddr,
    /// File with the token that requests must bring; needed for any address but the host's own.
    pub token_file: Option<PathBuf>,
}

impl Default for HttpConfig {
    fn default() -> Self {
        HttpConfig { listen: SocketAddr::from(([127, 0, 0, 1], 8600)), token_file: None }
    }
}

impl HttpConfig {
    /// What is allowed and should be known.
    fn remark(&self) -> Option<String> {
        let what = "anybody who is logged in to this machine can read the page and give orders";
        self.token_file.is_none().then(|| format!("http: there is no token_file: {what}"))
    }
}

/// What others can reach asks for a token; `table` names it.
pub(super) fn check_listen(table: &str, listen: SocketAddr, token_file: Option<&Path>) -> Result<(), String> {
    if listen.ip().is_loopback() || token_file.is_some() {
        return Ok(());
    }
    Err(format!(
        "{table}.listen is {listen}, which others can reach: name a file with a token in {table}.token_file"
    ))
}

/// Whether a host is this machine.
pub(super) fn is_local(host: &str) -> bool {
    host == "localhost" || host.parse::<IpAddr>().is_ok_and(|address| address.is_loopback())
}

/// Versions of MQTT.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum MqttVersion {
    /// 3.1.1.
    #[default]
    #[serde(rename = "3.1.1")]
    V3,
    /// 5.
    #[serde(rename = "5")]
    V5,
}

/// `[mqtt]`: a broker.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MqttConfig {
    /// Host of the broker.
    pub host: String,
    /// Port; absent: 8883 with TLS, 1883 without.
    pub port: Option<u16>,
    /// Protocol version.
    pub version: MqttVersion,
    /// Client identifier; absent: `seepd-` and the host's name.
    pub client_id: Option<String>,
    /// First level of the topics.
    pub prefix: String,
    /// User.
    pub username: Option<String>,
    /// File with the password.
    pub password_file: Option<PathBuf>,
    /// Whether the connection is encrypted.
    pub tls: bool,
    /// Certificates that the broker's must lead to (PEM).
    pub ca_file: PathBuf,
    /// Own certificate (PEM), where the broker asks for one.
    pub certificate_file: Option<PathBuf>,
    /// Its key (PEM).
    pub key_file: Option<PathBuf>,
    /// Events kept on disk while the broker is away; the oldest go first.
    pub spool_events: usize,
    /// First level of the topics under which Home Assistant is told of the axes, usually `homeassistant`; absent: it is not told.
    pub home_assistant: Option<String>,
}

impl Default for MqttConfig {
    fn default() -> Self {
        MqttConfig {
            host: "localhost".into(),
            port: None,
            version: MqttVersion::V3,
            client_id: None,
            prefix: "seepd".into(),
            username: None,
            password_file: None,
            tls: false,
            ca_file: "/etc/ssl/certs/ca-certificates.crt".into(),
            certificate_file: None,
            key_file: None,
            spool_events: 20_000,
            home_assistant: None,
        }
    }
}

impl MqttConfig {
    /// The port in force.
    pub fn port(&self) -> u16 {
        self.port.unwrap_or(if self.tls { 8883 } else { 1883 })
    }

    /// Whether the broker is on this machine.
    fn is_local(&self) -> bool {
        is_local(&self.host)
    }

    /// What of the connection is allowed and should be known; `table` names it.
    fn remark(&self, table: &str) -> Option<String> {
        let readable = self.password_file.is_some() && !self.tls && !self.is_local();
        let what = "anybody on the way to the broker can read the password";
        readable.then(|| format!("{table}: there is a password_file, but no tls: {what}"))
    }

    /// Checks what any connection to a broker has; `table` names it.
    pub(super) fn check_connection(&self, table: &str) -> Result<(), String> {
        if self.host.is_empty() {
            return Err(format!("{table}.host is empty"));
        }
        if self.certificate_file.is_some() != self.key_file.is_some() {
            return Err(format!("{table}: certificate_file and key_file must be given together"));
        }
        if self.password_file.is_some() && self.username.is_none() {
            return Err(format!("{table}.password_file is given, but no username"));
        }
        Ok(())
    }

    fn check(&self) -> Result<(), String> {
        self.check_connection("mqtt")?;
        let wrong = |c: char| ['#', '+'].contains(&c) || c.is_control();
        if self.prefix.is_empty() || self.prefix.contains(wrong) || self.prefix.starts_with('$') {
            return Err(format!(
                "mqtt.prefix is `{}`; topics must not have #, + or control characters, or begin with $",
                self.prefix
            ));
        }
        if let Some(prefix) =
            self.home_assistant.as_ref().filter(|prefix| prefix.is_empty() || prefix.contains(wrong))
        {
            return Err(format!(
                "mqtt.home_assistant is `{prefix}`; topics must not have #, + or control characters"
            ));
        }
        if !(1..=1_000_000).contains(&self.spool_events) {
            return Err(format!("mqtt.spool_events is {}; it must lie in 1 … 1000000", self.spool_events));
        }
        Ok(())
    }
}

/// What a field of an outgoing CAN frame says.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CanValue {
    /// 0 no estimate, 1 healthy, 2 watch, 3 leak, 4 severe.
    Flag,
    /// The highest flag since it was last acknowledged, coded alike; 0 where there is none.
    Latched,
    /// 1 where the input is stale.
    Stale,
    /// Estimate as a flow at the reference pressure difference, L/min.
    LeakFlowLpm,
    /// Estimate, m².
    LeakAreaM2,
    /// Lower end of the 90 % interval, m².
    LowM2,
    /// Upper end, m².
    HighM2,
    /// 1 where something has changed beside the seal.
    HasCondition,
    /// What has: 0 nothing, 1 … 12 a cause, 15 what has no name (yet).
    Condition,
    /// 0 nothing beside the seal, 1 slight, 2 of a size that matters.
    ConditionSeverity,
    /// Size of that cause over the size from which it matters.
    ConditionShare,
    /// Number of the last cycle.
    Cycle,
    /// Raised by one from frame to frame.
    Counter,
}

/// A field of an outgoing CAN frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CanOutField {
    /// What it says; all bits set where there is no estimate.
    pub value: CanValue,
    /// First bit, as in a signal's `bits`.
    pub start: usize,
    /// Size, bits.
    pub length: usize,
    /// Byte order.
    #[serde(default)]
    pub order: ByteOrder,
    /// Encoding.
    #[serde(default)]
    pub encoding: Encoding,
    /// value = raw · scale.
    #[serde(default = "one")]
    pub scale: f64,
}

fn one() -> f64 {
    1.0
}

/// `[[can_out]]`: a frame that tells an axis's condition.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CanOutConfig {
    /// Interface; `unix:PATH` sends to a Unix datagram socket.
    pub interface: String,
    /// Axis; empty: the only one.
    pub axis: String,
    /// Identifier.
    pub id: u32,
    /// Whether it has 29 bits; absent: where it does not fit 11.
    pub extended: Option<bool>,
    /// Data bytes; more than 8 make it an FD frame.
    pub length: usize,
    /// Sent every so many seconds besides after each cycle; 0: after cycles only.
    pub period_s: f64,
    /// Fields.
    pub fields: Vec<CanOutField>,
}

impl Default for CanOutConfig {
    /// Flag, latch, staleness, whether there is a condition beside the seal, counter, flow in mL/min and the interval's ends in 1e-9 m².
    fn default() -> Self {
        let field = |value, start, length, scale| CanOutField {
            value,
            start,
            length,
            order: ByteOrder::LittleEndian,
            encoding: Encoding::Unsigned,
            scale,
        };
        CanOutConfig {
            interface: String::new(),
            axis: String::new(),
            id: 0x6a0,
            extended: None,
            length: 8,
            period_s: 1.0,
            fields: vec![
                field(CanValue::Flag, 0, 3, 1.0),
                field(CanValue::Latched, 3, 3, 1.0),
                field(CanValue::Stale, 6, 1, 1.0),
                field(CanValue::HasCondition, 7, 1, 1.0),
                field(CanValue::Counter, 8, 8, 1.0),
                field(CanValue::LeakFlowLpm, 16, 16, 1e-3),
                field(CanValue::LowM2, 32, 16, 1e-9),
                field(CanValue::HighM2, 48, 16, 1e-9),
            ],
        }
    }
}

/// Data lengths of frames.
const LENGTHS: [usize; 15] = [1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64];

impl CanOutConfig {
    /// The fields' places.
    ///
    /// # Errors
    /// One line: a field does not fit the frame.
    pub fn places(&self) -> Result<Vec<(CanValue, BitField)>, String> {
        self.fields
            .iter()
            .map(|field| {
                BitField::new(field.start, field.length, field.order, field.encoding, field.scale, 0.0)
                    .map_err(|error| error.to_string())
                    .and_then(|place| {
                        let fits = place.least_bytes() <= self.length && field.scale != 0.0;
                        fits.then_some(place).ok_or(format!("does not fit {} bytes", self.length))
                    })
                    .map(|place| (field.value, place))
                    .map_err(|what| format!("can_out: the field {:?} {what}", field.value))
            })
            .collect()
    }

    fn check(&self) -> Result<(), String> {
        if self.interface.is_empty() {
            return Err("can_out.interface is missing".into());
        }
        if !LENGTHS.contains(&self.length) {
            return Err(format!("can_out.length is {}; no CAN frame has that many bytes", self.length));
        }
        if self.period_s != 0.0 && !(0.01..=3600.0).contains(&self.period_s) {
            return Err(format!("can_out.period_s is {}; it must be 0 or lie in 0.01 … 3600", self.period_s));
        }
        identifier(self.id, self.extended).map_err(|what| format!("can_out.id: {what}"))?;
        self.places().map(|_| ())
    }
}

/// `[recording]`: MCAP files of what came in and what was said.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecordingConfig {
    /// Folder; absent: `recordings` in the state folder.
    pub folder: Option<PathBuf>,
    /// A file is closed at this size, MB (1e6 bytes).
    pub file_mb: f64,
    /// A file is closed at this age, min.
    pub file_min: f64,
    /// The oldest files go when all take more than this, MB.
    pub total_mb: f64,
    /// Files older than this go, days; 0: none.
    pub keep_days: f64,
}

impl Default for RecordingConfig {
    fn default() -> Self {
        RecordingConfig { folder: None, file_mb: 64.0, file_min: 60.0, total_mb: 2000.0, keep_days: 30.0 }
    }
}

impl RecordingConfig {
    fn check(&self) -> Result<(), String> {
        for (key, value, least) in [
            ("file_mb", self.file_mb, 0.1),
            ("file_min", self.file_min, 0.1),
            ("total_mb", self.total_mb, 1.0),
            ("keep_days", self.keep_days, 0.0),
        ] {
            if !(least..=1e7).contains(&value) {
                return Err(format!("recording.{key} is {value}; it must lie in {least} … 1e7"));
            }
        }
        if self.total_mb < self.file_mb {
            return Err("recording.total_mb is less than file_mb, the size of one file".into());
        }
        Ok(())
    }
}

/// `[influx]`: InfluxDB's line protocol over UDP.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct InfluxConfig {
    /// Host and port of what listens: Telegraf's `socket_listener`, InfluxDB 1, VictoriaMetrics.
    pub udp: String,
    /// Name of the measurement.
    pub measurement: String,
    /// Sent every so many seconds besides after each cycle.
    pub period_s: f64,
}

impl Default for InfluxConfig {
    fn default() -> Self {
        InfluxConfig { udp: "localhost:8089".into(), measurement: "seepd".into(), period_s: 10.0 }
    }
}

impl InfluxConfig {
    fn check(&self) -> Result<(), String> {
        let port = self.udp.rsplit_once(':').filter(|(host, _)| !host.is_empty());
        if port.is_none_or(|(_, port)| port.parse::<u16>().is_err()) {
            return Err(format!("influx.udp is `{}`; it must be HOST:PORT", self.udp.escape_debug()));
        }
        let is_plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | '.');
        if self.measurement.is_empty() || !self.measurement.chars().all(is_plain) {
            return Err(format!(
                "influx.measurement is `{}`; it has letters, digits and . _ -",
                self.measurement.escape_debug()
            ));
        }
        if !(0.1..=3600.0).contains(&self.period_s) {
            return Err(format!("influx.period_s is {}; it must lie in 0.1 … 3600", self.period_s));
        }
        Ok(())
    }
}

/// Where a secret is: with the service's credentials where systemd has put one of that name there, else relative to the
/// configuration.
fn credential(folder: &Path) -> impl Fn(&mut PathBuf) {
    let credentials = std::env::var_os("CREDENTIALS_DIRECTORY").map(PathBuf::from);
    move |path| {
        let given = credentials.as_ref().map(|credentials| credentials.join(&path));
        *path = given.filter(|given| given.exists()).unwrap_or_else(|| folder.join(&path));
    }
}

/// Checks that an axis that a table names is there; where there is only one it need not be named.
fn check_axis(table: &str, name: &str, axes: &[AxisConfig]) -> Result<(), String> {
    if axes.iter().any(|axis| axis.axis == name) || name.is_empty() && axes.len() == 1 {
        return Ok(());
    }
    let names: Vec<&str> = axes.iter().map(|axis| axis.axis.as_str()).collect();
    Err(format!("{table}.axis is `{}`; the axes are {}", name.escape_debug(), names.join(", ")))
}

impl SinksConfig {
    /// The tables' names: every field.
    pub(super) const KEYS: &[&'static str] = &[
        "http",
        "mqtt",
        "can_out",
        "recording",
        "influx",
        "sparkplug",
        "opentelemetry",
        "foxglove",
        "j1939",
    ];

    /// Checks the tables beside the axes that they tell of.
    ///
    /// # Errors
    /// One line that names the key.
    pub(super) fn check(&self, axes: &[AxisConfig]) -> Result<(), String> {
        self.mqtt.as_ref().map_or(Ok(()), MqttConfig::check)?;
        self.recording.as_ref().map_or(Ok(()), RecordingConfig::check)?;
        self.influx.as_ref().map_or(Ok(()), InfluxConfig::check)?;
        self.sparkplug.as_ref().map_or(Ok(()), SparkplugConfig::check)?;
        self.opentelemetry.as_ref().map_or(Ok(()), OpenTelemetryConfig::check)?;
        self.foxglove.as_ref().map_or(Ok(()), FoxgloveConfig::check)?;
        for frame in &self.can_out {
            frame.check()?;
            check_axis("can_out", &frame.axis, axes)?;
        }
        for (index, speaker) in self.j1939.iter().enumerate() {
            speaker.check()?;
            check_axis("j1939", &speaker.axis, axes)?;
            let twin = |other: &&J1939Config| {
                other.interface == speaker.interface && other.address == speaker.address
            };
            if self.j1939.iter().skip(index + 1).any(|other| twin(&other)) {
                let J1939Config { interface, address, .. } = speaker;
                return Err(format!("j1939: two axes have the address {address:#04x} on {interface}"));
            }
        }
        if let Some(http) = &self.http {
            check_listen("http", http.listen, http.token_file.as_deref())?;
            if let Some(mqtt) = &self.mqtt
                && mqtt.port() == http.listen.port()
                && mqtt.is_local()
                && http.listen.ip().is_loopback()
            {
                return Err(format!(
                    "http.listen and the broker at {} have the same port {}",
                    mqtt.host,
                    mqtt.port()
                ));
            }
        }
        if let (Some(http), Some(foxglove)) = (&self.http, &self.foxglove)
            && http.listen == foxglove.listen
        {
            return Err(format!("http.listen and foxglove.listen are both {}", http.listen));
        }
        for (index, frame) in self.can_out.iter().enumerate() {
            let twin = |other: &&CanOutConfig| other.interface == frame.interface && other.id == frame.id;
            if self.can_out.iter().skip(index + 1).any(|other| twin(&other)) {
                return Err(format!(
                    "can_out: two frames have the identifier {:#x} on {}",
                    frame.id, frame.interface
                ));
            }
        }
        Ok(())
    }

    /// What is allowed and should be known.
    pub(super) fn remarks(&self) -> impl Iterator<Item = String> {
        let of_http = self.http.as_ref().and_then(HttpConfig::remark);
        let of_mqtt = self.mqtt.as_ref().and_then(|mqtt| mqtt.remark("mqtt"));
        let of_sparkplug = self.sparkplug.as_ref().and_then(|node| node.connection().remark("sparkplug"));
        let of_telemetry = self.opentelemetry.as_ref().and_then(OpenTelemetryConfig::remark);
        of_http.into_iter().chain(of_mqtt).chain(of_sparkplug).chain(of_telemetry)
    }

    /// Takes paths as relative to the folder of the file.
    pub(super) fn resolve(&mut self, folder: &Path) {
        let place = |path: &mut PathBuf| *path = folder.join(&path);
        if let Some(http) = &mut self.http {
            http.token_file.iter_mut().for_each(credential(folder));
        }
        if let Some(mqtt) = &mut self.mqtt {
            place(&mut mqtt.ca_file);
            mqtt.password_file.iter_mut().for_each(credential(folder));
            mqtt.certificate_file.iter_mut().for_each(credential(folder));
            mqtt.key_file.iter_mut().for_each(credential(folder));
        }
        if let Some(node) = &mut self.sparkplug {
            place(&mut node.ca_file);
            let files = [&mut node.password_file, &mut node.certificate_file, &mut node.key_file];
            files.into_iter().flatten().for_each(credential(folder));
        }
        if let Some(telemetry) = &mut self.opentelemetry {
            place(&mut telemetry.ca_file);
            telemetry.token_file.iter_mut().for_each(credential(folder));
        }
        if let Some(foxglove) = &mut self.foxglove {
            foxglove.token_file.iter_mut().for_each(credential(folder));
        }
        if let Some(recording) = &mut self.recording {
            recording.folder.iter_mut().for_each(place);
        }
    }
}

//! Tables of the plant's further languages, each a feature of the build: Sparkplug B, OpenTelemetry, Foxglove, J1939.

use std::net::SocketAddr;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::check_name;
use super::endpoint::Endpoint;
use super::sinks::{MqttConfig, MqttVersion, check_listen, is_local};

/// `[sparkplug]`: a node of Sparkplug B, with a connection of its own, since a connection has one last will.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SparkplugConfig {
    /// Group; there is no default, as names of nodes must differ in a plant.
    pub group: String,
    /// Node in the group; likewise.
    pub node: String,
    /// Host of the broker.
    pub host: String,
    /// Port; absent: 8883 with TLS, 1883 without.
    pub port: Option<u16>,
    /// Protocol version.
    pub version: MqttVersion,
    /// Client identifier; absent: `seepd-`, group and node.
    pub client_id: Option<String>,
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
}

impl Default for SparkplugConfig {
    fn default() -> Self {
        let MqttConfig { host, port, version, tls, ca_file, .. } = MqttConfig::default();
        SparkplugConfig {
            group: String::new(),
            node: String::new(),
            host,
            port,
            version,
            client_id: None,
            username: None,
            password_file: None,
            tls,
            ca_file,
            certificate_file: None,
            key_file: None,
        }
    }
}

impl SparkplugConfig {
    /// Its connection to the broker.
    pub fn connection(&self) -> MqttConfig {
        let own = || format!("seepd-{}-{}", self.group, self.node);
        MqttConfig {
            host: self.host.clone(),
            port: self.port,
            version: self.version,
            client_id: Some(self.client_id.clone().unwrap_or_else(own)),
            username: self.username.clone(),
            password_file: self.password_file.clone(),
            tls: self.tls,
            ca_file: self.ca_file.clone(),
            certificate_file: self.certificate_file.clone(),
            key_file: self.key_file.clone(),
            ..MqttConfig::default()
        }
    }

    pub(super) fn check(&self) -> Result<(), String> {
        for (key, name) in [("sparkplug.group", &self.group), ("sparkplug.node", &self.node)] {
            if name.is_empty() {
                return Err(format!("{key} is missing"));
            }
            check_name(key, name)?;
        }
        self.connection().check_connection("sparkplug")
    }
}

/// `[opentelemetry]`: metrics by OTLP over HTTP, as protobuf.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OpenTelemetryConfig {
    /// Where metrics are sent to; without a path, `/v1/metrics`.
    pub endpoint: String,
    /// Sent every so many seconds.
    pub period_s: f64,
    /// The resource's `service.name`.
    pub service_name: String,
    /// File with a token that goes along as `Authorization: Bearer TOKEN`.
    pub token_file: Option<PathBuf>,
    /// Certificates that the endpoint's must lead to (PEM).
    pub ca_file: PathBuf,
}

impl Default for OpenTelemetryConfig {
    fn default() -> Self {
        OpenTelemetryConfig {
            endpoint: "http://localhost:4318/v1/metrics".into(),
            period_s: 15.0,
            service_name: "seepd".into(),
            token_file: None,
            ca_file: MqttConfig::default().ca_file,
        }
    }
}

impl OpenTelemetryConfig {
    /// Where metrics are sent to.
    ///
    /// # Errors
    /// One line: the URL is none.
    pub fn place(&self) -> Result<Endpoint, String> {
        let place =
            Endpoint::parse(&self.endpoint).map_err(|what| format!("opentelemetry.endpoint {what}"))?;
        let path = if place.path == "/" { "/v1/metrics".into() } else { place.path };
        Ok(Endpoint { path, ..place })
    }

    /// What is allowed and should be known.
    pub(super) fn remark(&self) -> Option<String> {
        let place = self.place().ok().filter(|place| !place.tls && !is_local(&place.host));
        let what = "anybody on the way to the endpoint can read the token";
        place
            .filter(|_| self.token_file.is_some())
            .map(|_| format!("opentelemetry: there is a token_file, but no https: {what}"))
    }

    pub(super) fn check(&self) -> Result<(), String> {
        self.place()?;
        check_name("opentelemetry.service_name", &self.service_name)?;
        if !(1.0..=3600.0).contains(&self.period_s) {
            return Err(format!("opentelemetry.period_s is {}; it must lie in 1 … 3600", self.period_s));
        }
        Ok(())
    }
}

/// `[foxglove]`: a server of Foxglove's WebSocket protocol.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FoxgloveConfig {
    /// Address and port.
    pub listen: SocketAddr,
    /// File with the token that the address must end in (`/?token=TOKEN`); needed for any address but the host's own.
    pub token_file: Option<PathBuf>,
}

impl Default for FoxgloveConfig {
    fn default() -> Self {
        FoxgloveConfig { listen: SocketAddr::from(([127, 0, 0, 1], 8765)), token_file: None }
    }
}

impl FoxgloveConfig {
    pub(super) fn check(&self) -> Result<(), String> {
        check_listen("foxglove", self.listen, self.token_file.as_deref())
    }
}

/// `[[j1939]]`: an axis's diagnostic messages on a CAN bus.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct J1939Config {
    /// Interface; `unix:PATH` speaks to a Unix datagram socket.
    pub interface: String,
    /// Axis; empty: the only one.
    pub axis: String,
    /// Source address, 0 … 253.
    pub address: u8,
    /// Suspect parameter number of the seal's leak; the 16 after it are causes and a missing command. From 516096 on they are free.
    pub spn: u32,
    /// Number that tells this device from others in its name, 0 … 2097151; absent: made of the axis's name.
    pub identity: Option<u32>,
    /// Manufacturer's code in the name, 0 … 2047.
    pub manufacturer: u16,
}

impl Default for J1939Config {
    fn default() -> Self {
        J1939Config {
            interface: String::new(),
            axis: String::new(),
            address: 0x80,
            spn: 516_096,
            identity: None,
            manufacturer: 2047,
        }
    }
}

/// Largest suspect parameter number, of 19 bits.
const LAST_SPN: u32 = (1 << 19) - 1;
/// Numbers that an axis takes.
const SPNS: u32 = 17;

impl J1939Config {
    /// Its 64 bits of J1939-81: identity, manufacturer, function and vehicle system "not available", industry group 5 (process control), and
    /// an address that it does not change by itself. A smaller one has precedence.
    pub fn name(&self) -> u64 {
        // FNV-1a: any number that stays the same will do.
        let mix = |hash: u32, byte: u8| (hash ^ u32::from(byte)).wrapping_mul(16_777_619);
        let own = || self.axis.bytes().fold(2_166_136_261, mix) & 0x1f_ffff;
        let identity = u64::from(self.identity.unwrap_or_else(own));
        identity | u64::from(self.manufacturer) << 21 | 0xff << 40 | 0x7f << 49 | 5 << 60
    }

    pub(super) fn check(&self) -> Result<(), String> {
        if self.interface.is_empty() {
            return Err("j1939.interface is missing".into());
        }
        if self.address > 253 {
            return Err(format!("j1939.address is {}; it must lie in 0 … 253", self.address));
        }
        if !(1..=LAST_SPN - SPNS + 1).contains(&self.spn) {
            let last = LAST_SPN - SPNS + 1;
            return Err(format!(
                "j1939.spn is {}; it must lie in 1 … {last}, as the {SPNS} from it on are taken",
                self.spn
            ));
        }
        if let Some(identity) = self.identity.filter(|identity| *identity > 0x1f_ffff) {
            return Err(format!("j1939.identity is {identity}; it must lie in 0 … 2097151"));
        }
        if self.manufacturer > 2047 {
            return Err(format!("j1939.manufacturer is {}; it must lie in 0 … 2047", self.manufacturer));
        }
        Ok(())
    }
}

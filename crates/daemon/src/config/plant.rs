//! Tables of the plant's further languages, each a feature of the build: Sparkplug B, OpenTelemetry, Foxglove.

use std::net::SocketAddr;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::check_name;
use super::endpoint::Endpoint;
use super::sinks::{MqttConfig, MqttVersion, is_local};

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
        if self.listen.ip().is_loopback() || self.token_file.is_some() {
            return Ok(());
        }
        Err(format!(
            "foxglove.listen is {}, which others can reach: name a file with a token in foxglove.token_file",
            self.listen
        ))
    }
}

//! A broker: events that arrive at least once and in order, and each axis's condition, retained.
//!
//! Below the prefix: `AXIS/cycle`, `AXIS/flag`, `AXIS/notice`, `AXIS/acknowledged`, `AXIS/test` (events), `AXIS/status` (retained),
//! `status` (`online` or `offline`, retained; the last will). A message on `AXIS/acknowledge` takes note of a latched flag, one on
//! `AXIS/new_baseline` has a new baseline learned: the seal has been replaced.
//! An event is on disk before it counts as told; it goes from there when the broker has confirmed it.

use std::fs;
use std::io;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use rumqttc::{QoS, TlsConfiguration, Transport, v5};
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use rustls::{ClientConfig, RootCertStore};
use tokio::sync::{mpsc, watch};
use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep_until, timeout};

use crate::config::{MqttConfig, MqttVersion};
use crate::event::Flag;
use crate::failure::{Code, Failure};
use crate::live::hub::{AxisStatus, Hub, Order, Publication};
use crate::live::spool::Spool;
use crate::source::live::SourceState;

/// The broker's name among the sinks.
pub const SINK: &str = "mqtt";
/// Time after which a silent broker is asked whether it is there.
const KEEP_ALIVE: Duration = Duration::from_secs(15);
/// First and longest wait before another try.
const WAITS: (Duration, Duration) = (Duration::from_millis(500), Duration::from_secs(30));
/// Time in which a broker must confirm an event.
const CONFIRMATION: Duration = Duration::from_secs(20);
/// News of an axis's condition are told at most this often.
const STATUS_EVERY: Duration = Duration::from_secs(1);
/// Counts alone are told this often.
const COUNTS_EVERY: Duration = Duration::from_secs(60);
/// Time for a farewell.
const FAREWELL: Duration = Duration::from_millis(500);
/// Requests under way to the connection.
const REQUESTS: usize = 64;

/// A client of either version.
enum Client {
    V3(rumqttc::AsyncClient),
    V5(v5::AsyncClient),
}

/// What a connection tells.
enum Told {
    Connected,
    Confirmed,
    Refused(String),
    Message(String),
    Lost(String),
}

struct Connection {
    client: Client,
    told: mpsc::Receiver<Told>,
    task: JoinHandle<()>,
}

impl Drop for Connection {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// A broker that is kept up with.
pub struct Broker {
    config: MqttConfig,
    client_id: String,
    password: Option<String>,
    tls: Option<Arc<ClientConfig>>,
    hub: Arc<Hub>,
    spool: Arc<Mutex<Spool>>,
    connection: Option<Connection>,
    connected: bool,
    /// Number of the event that waits for its confirmation, and until when.
    under_way: Option<(u64, Instant)>,
    retry_at: Instant,
    wait: Duration,
    sent: u64,
    /// Whether this client announces itself as the daemon and takes orders.
    presence: bool,
    /// What was last told of the axes, and when their counts are due.
    told: Vec<News>,
    counts_at: Instant,
}

/// What of a condition is worth a message at once.
type News = (String, Option<u64>, Flag, Option<Flag>, bool, bool, SourceState);

fn news(status: &AxisStatus) -> News {
    let AxisStatus { axis, cycle, flag, latched, acknowledged, stale, source, .. } = status;
    (axis.clone(), *cycle, *flag, *latched, *acknowledged, *stale, source.state)
}

impl Broker {
    /// Reads certificates and password, and takes up what waits on disk.
    ///
    /// # Errors
    /// [`Failure`] where one of these files cannot be read.
    pub fn new(config: &MqttConfig, spool_folder: &Path, hub: Arc<Hub>) -> Result<Self, Failure> {
        let (password, tls) = credentials(config)?;
        let host = nix::unistd::gethostname().unwrap_or_default();
        let client_id =
            config.client_id.clone().unwrap_or_else(|| format!("seepd-{}", host.to_string_lossy()));
        let now = now();
        Ok(Broker {
            tls,
            spool: Arc::new(Mutex::new(Spool::open(spool_folder, config.spool_events)?)),
            config: config.clone(),
            client_id,
            password,
            hub,
            connection: None,
            connected: false,
            under_way: None,
            retry_at: now,
            wait: WAITS.0,
            sent: 0,
            presence: true,
            told: Vec::new(),
            counts_at: now,
        })
    }

    /// Keeps up as another client than the daemon: sends events, and neither conditions nor that it is there.
    pub async fn run_without_presence(mut self, stop: watch::Receiver<bool>) {
        self.presence = false;
        self.run(stop).await;
    }

    /// Keeps up until told to stop.
    pub async fn run(mut self, mut stop: watch::Receiver<bool>) {
        let mut events = self.hub.subscribe();
        let mut changes = self.hub.changes();
        let mut status_at = now();
        let mut status_due = true;
        self.tell("connecting");
        loop {
            if self.connection.is_none() && now() >= self.retry_at {
                self.connection = Some(self.connect());
            }
            self.send_next().await;
            let (retry_at, waits, may_tell) = (self.retry_at, self.connection.is_none(), self.connected);
            let confirmation = self.under_way.map_or(now() + KEEP_ALIVE, |(_, until)| until);
            let confirming = self.under_way.is_some();
            let told = next_told(&mut self.connection);
            tokio::select! {
                biased;
                _ = stop.changed() => break,
                told = told => {
                    self.heed(told.unwrap_or_else(|| Told::Lost("the connection ended".into())));
                    status_due = true;
                }
                Some(event) = events.recv() => self.take(&event).await,
                _ = changes.changed(), if !status_due => status_due = true,
                () = sleep_until(status_at), if status_due && may_tell => {
                    status_due = false;
                    status_at = now() + STATUS_EVERY;
                    self.send_status().await;
                }
                () = sleep_until(retry_at), if waits => {}
                () = sleep_until(confirmation), if confirming => {
                    self.lose("the broker confirms nothing");
                }
            }
        }
        // What came until now is on disk before the end.
        while let Ok(event) = events.try_recv() {
            self.take(&event).await;
        }
        self.say_farewell().await;
    }

    fn lock_spool(&self) -> std::sync::MutexGuard<'_, Spool> {
        self.spool.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn tell(&self, detail: &str) {
        let (waiting, dropped) = {
            let spool = self.lock_spool();
            (spool.len() as u64, spool.dropped + spool.damaged)
        };
        let (good, sent) = (self.connected, self.sent);
        let place = format!("{}:{}", self.config.host, self.config.port());
        self.hub.update_sink(SINK, |status| {
            status.good = good;
            status.detail = format!("{place}: {detail}");
            (status.sent, status.waiting, status.dropped) = (sent, waiting, dropped);
        });
    }

    /// Takes an event: sent at once where nothing waits before it, and kept on disk in any case.
    async fn take(&mut self, event: &Publication) {
        let topic = format!("{}/{}", event.axis, event.kind.name());
        let at_once = self.connected && self.under_way.is_none() && self.lock_spool().is_empty();
        if at_once {
            self.publish(&topic, event.json.clone(), QoS::AtLeastOnce, false).await;
        }
        let (spool, json) = (Arc::clone(&self.spool), event.json.clone());
        let push = move || spool.lock().unwrap_or_else(PoisonError::into_inner).push(&topic, &json);
        // The disk may be slow; the axes go on meanwhile.
        let pushed =
            tokio::task::spawn_blocking(push).await.unwrap_or_else(|error| Err(io::Error::other(error)));
        match pushed {
            Ok(number) if at_once && self.connected => self.under_way = Some((number, now() + CONFIRMATION)),
            Ok(_) => {}
            Err(error) => tracing::error!("an event cannot be kept for the broker: {error}"),
        }
        self.tell(if self.connected { "connected" } else { "waiting for the broker" });
    }

    /// Sends the event that has waited longest, if none is under way.
    async fn send_next(&mut self) {
        if !self.connected || self.under_way.is_some() {
            return;
        }
        let first = self.lock_spool().first();
        let Some((number, entry)) = first else { return };
        self.under_way = Some((number, now() + CONFIRMATION));
        self.publish(&entry.topic, entry.message.get().to_owned(), QoS::AtLeastOnce, false).await;
    }

    async fn send_status(&mut self) {
        if !self.presence {
            return;
        }
        let axes = self.hub.axes();
        let news: Vec<News> = axes.iter().map(news).collect();
        if self.told == news && now() < self.counts_at {
            return;
        }
        self.told = news;
        self.counts_at = now() + COUNTS_EVERY;
        for status in axes {
            let json = serde_json::to_string(&status).unwrap_or_default();
            self.publish(&format!("{}/status", status.axis), json, QoS::AtMostOnce, true).await;
        }
    }

    async fn publish(&mut self, topic: &str, message: String, qos: QoS, retain: bool) {
        let topic = format!("{}/{topic}", self.config.prefix);
        let sent = match self.connection.as_ref().map(|connection| &connection.client) {
            Some(Client::V3(client)) => {
                client.publish(topic, qos, retain, message).await.map_err(|error| error.to_string())
            }
            Some(Client::V5(client)) => {
                client.publish(topic, qos_5(qos), retain, message).await.map_err(|error| error.to_string())
            }
            None => return,
        };
        if let Err(error) = sent {
            self.lose(&error);
        }
    }

    fn heed(&mut self, told: Told) {
        match told {
            Told::Connected => {
                self.connected = true;
                self.wait = WAITS.0;
                self.told.clear();
                tracing::info!("connected to the broker at {}:{}", self.config.host, self.config.port());
                self.greet();
                self.tell("connected");
            }
            Told::Confirmed => {
                if let Some((number, _)) = self.under_way.take() {
                    self.sent += 1;
                    let removed = self.lock_spool().arrived(number);
                    if let Err(error) = removed {
                        tracing::warn!(
                            "an event that the broker has cannot be removed from the spool: {error}"
                        );
                    }
                }
                self.tell("connected");
            }
            Told::Refused(why) => self.lose(&format!("the broker refuses an event: {why}")),
            Told::Message(topic) => self.take_order(&topic),
            Told::Lost(why) => self.lose(&why),
        }
    }

    fn take_order(&self, topic: &str) {
        let rest = topic.strip_prefix(&self.config.prefix).and_then(|rest| rest.strip_prefix('/'));
        let Some((axis, word)) = rest.and_then(|rest| rest.rsplit_once('/')) else { return };
        let order = match word {
            "acknowledge" => Order::Acknowledge,
            "new_baseline" => Order::Renew,
            _ => return,
        };
        if !self.hub.order(axis, order) {
            tracing::warn!("{topic}: there is no axis {axis}");
        }
    }

    /// Gives the connection up; another is tried after a while, a longer one each time.
    fn lose(&mut self, why: &str) {
        if self.connected || self.wait == WAITS.0 {
            tracing::warn!("the broker at {}:{}: {why}", self.config.host, self.config.port());
        }
        self.connection = None;
        self.connected = false;
        self.under_way = None;
        self.retry_at = now() + self.wait;
        self.wait = (self.wait * 2).min(WAITS.1);
        self.tell(why);
    }

    /// Announces this daemon and asks for orders. The requests wait in the connection's queue, which is empty now.
    fn greet(&self) {
        if !self.presence {
            return;
        }
        let status = format!("{}/status", self.config.prefix);
        let orders = ["acknowledge", "new_baseline"].map(|word| format!("{}/+/{word}", self.config.prefix));
        let asked = match self.connection.as_ref().map(|connection| &connection.client) {
            Some(Client::V3(client)) => client
                .try_publish(status, QoS::AtMostOnce, true, "online")
                .and_then(|()| {
                    orders.into_iter().try_for_each(|order| client.try_subscribe(order, QoS::AtLeastOnce))
                })
                .map_err(|error| error.to_string()),
            Some(Client::V5(client)) => {
                let told =
                    |result: Result<(), rumqttc::v5::ClientError>| result.map_err(|error| error.to_string());
                let announced = told(client.try_publish(status, qos_5(QoS::AtMostOnce), true, "online"));
                let mut subscribed = orders
                    .into_iter()
                    .map(|order| told(client.try_subscribe(order, qos_5(QoS::AtLeastOnce))));
                announced.and(subscribed.try_for_each(|result| result))
            }
            None => Ok(()),
        };
        if let Err(error) = asked {
            tracing::warn!("greeting the broker: {error}");
        }
    }

    async fn say_farewell(&mut self) {
        if !self.connected {
            return;
        }
        let _ = timeout(FAREWELL, async {
            if self.presence {
                self.publish("status", "offline".into(), QoS::AtMostOnce, true).await;
            }
            match self.connection.as_mut() {
                Some(Connection { client: Client::V3(client), .. }) => drop(client.disconnect().await),
                Some(Connection { client: Client::V5(client), .. }) => drop(client.disconnect().await),
                None => {}
            }
            // The connection's own task sends what was asked, and ends.
            if let Some(connection) = &mut self.connection {
                while !matches!(connection.told.recv().await, None | Some(Told::Lost(_))) {}
            }
        })
        .await;
    }

    fn connect(&self) -> Connection {
        let (teller, told) = mpsc::channel(REQUESTS);
        let (client, task) = match self.config.version {
            MqttVersion::V3 => self.connect_3(teller),
            MqttVersion::V5 => self.connect_5(teller),
        };
        Connection { client, told, task }
    }

    fn transport(&self) -> Transport {
        self.tls.as_ref().map_or(Transport::Tcp, |tls| {
            Transport::tls_with_config(TlsConfiguration::Rustls(Arc::clone(tls)))
        })
    }

    fn connect_3(&self, teller: mpsc::Sender<Told>) -> (Client, JoinHandle<()>) {
        use rumqttc::{AsyncClient, Event, LastWill, MqttOptions, Packet};
        let mut options = MqttOptions::new(&self.client_id, &self.config.host, self.config.port());
        options.set_keep_alive(KEEP_ALIVE).set_clean_session(true).set_max_packet_size(64 << 10, 256 << 10);
        let will = format!("{}/status", self.config.prefix);
        if self.presence {
            options.set_last_will(LastWill::new(will, "offline", QoS::AtLeastOnce, true));
        }
        if let Some(user) = &self.config.username {
            options.set_credentials(user, self.password.as_deref().unwrap_or_default());
        }
        options.set_transport(self.transport());
        let (client, mut connection) = AsyncClient::new(options, REQUESTS);
        let task = tokio::spawn(async move {
            loop {
                let told = match connection.poll().await {
                    Ok(Event::Incoming(Packet::ConnAck(_))) => Told::Connected,
                    Ok(Event::Incoming(Packet::PubAck(_))) => Told::Confirmed,
                    Ok(Event::Incoming(Packet::Publish(message))) => Told::Message(message.topic),
                    Ok(_) => continue,
                    Err(error) => Told::Lost(error.to_string()),
                };
                let lost = matches!(told, Told::Lost(_));
                if teller.send(told).await.is_err() || lost {
                    return;
                }
            }
        });
        (Client::V3(client), task)
    }

    fn connect_5(&self, teller: mpsc::Sender<Told>) -> (Client, JoinHandle<()>) {
        use v5::mqttbytes::v5::{LastWill, Packet, PubAckReason};
        use v5::{AsyncClient, Event, MqttOptions};
        let mut options = MqttOptions::new(&self.client_id, &self.config.host, self.config.port());
        options.set_keep_alive(KEEP_ALIVE).set_clean_start(true).set_max_packet_size(Some(64 << 10));
        let will = format!("{}/status", self.config.prefix);
        if self.presence {
            options.set_last_will(LastWill::new(will, "offline", qos_5(QoS::AtLeastOnce), true, None));
        }
        if let Some(user) = &self.config.username {
            options.set_credentials(user, self.password.as_deref().unwrap_or_default());
        }
        options.set_transport(self.transport());
        let (client, mut connection) = AsyncClient::new(options, REQUESTS);
        let task = tokio::spawn(async move {
            loop {
                let told = match connection.poll().await {
                    Ok(Event::Incoming(Packet::ConnAck(_))) => Told::Connected,
                    Ok(Event::Incoming(Packet::PubAck(ack))) => match ack.reason {
                        PubAckReason::Success | PubAckReason::NoMatchingSubscribers => Told::Confirmed,
                        reason => Told::Refused(format!("{reason:?}")),
                    },
                    Ok(Event::Incoming(Packet::Publish(message))) => {
                        Told::Message(String::from_utf8_lossy(&message.topic).into_owned())
                    }
                    Ok(_) => continue,
                    Err(error) => Told::Lost(error.to_string()),
                };
                let lost = matches!(told, Told::Lost(_));
                if teller.send(told).await.is_err() || lost {
                    return;
                }
            }
        });
        (Client::V5(client), task)
    }
}

/// What the connection tells next; never, where there is none.
async fn next_told(connection: &mut Option<Connection>) -> Option<Told> {
    match connection {
        Some(connection) => connection.told.recv().await,
        None => std::future::pending().await,
    }
}

fn qos_5(qos: QoS) -> v5::mqttbytes::QoS {
    match qos {
        QoS::AtMostOnce => v5::mqttbytes::QoS::AtMostOnce,
        QoS::AtLeastOnce => v5::mqttbytes::QoS::AtLeastOnce,
        QoS::ExactlyOnce => v5::mqttbytes::QoS::ExactlyOnce,
    }
}

fn now() -> Instant {
    crate::live::clock::instant()
}

/// Password and certificates.
///
/// # Errors
/// [`Failure`] where one of their files cannot be read.
pub fn credentials(config: &MqttConfig) -> Result<(Option<String>, Option<Arc<ClientConfig>>), Failure> {
    let read = |path: &Path| fs::read_to_string(path).map_err(|error| Failure::reading(path, &error));
    let password = config.password_file.as_deref().map(read).transpose()?;
    let password = password.map(|text| text.trim_end_matches(['\r', '\n']).to_owned());
    let tls = if config.tls { Some(Arc::new(tls(config)?)) } else { None };
    Ok((password, tls))
}

fn tls(config: &MqttConfig) -> Result<ClientConfig, Failure> {
    let bad =
        |path: &Path, what: String| Failure::new(Code::Configuration, format!("{}: {what}", path.display()));
    let mut roots = RootCertStore::empty();
    roots.add_parsable_certificates(certificates(&config.ca_file)?);
    if roots.is_empty() {
        return Err(bad(&config.ca_file, "has no certificate that could be trusted".into()));
    }
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let builder = ClientConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .map_err(|error| Failure::new(Code::Internal, error.to_string()))?
        .with_root_certificates(roots);
    match (&config.certificate_file, &config.key_file) {
        (Some(certificate), Some(key)) => {
            let pem = fs::read(key).map_err(|error| Failure::reading(key, &error))?;
            let private = PrivateKeyDer::from_pem_slice(&pem).map_err(|error| bad(key, error.to_string()))?;
            builder
                .with_client_auth_cert(certificates(certificate)?, private)
                .map_err(|error| bad(certificate, error.to_string()))
        }
        _ => Ok(builder.with_no_client_auth()),
    }
}

fn certificates(path: &Path) -> Result<Vec<CertificateDer<'static>>, Failure> {
    let pem = fs::read(path).map_err(|error| Failure::reading(path, &error))?;
    CertificateDer::pem_slice_iter(&pem)
        .collect::<Result<Vec<_>, _>>()
        .map_err(|error| Failure::configuration(path, format!("is no PEM file of certificates: {error}")))
}

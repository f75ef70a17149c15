//! Sparkplug B (specification 3.0): this daemon is a node, and each axis a device below it.
//!
//! The node is born at each connection (`NBIRTH`, then `DBIRTH` of each axis), tells what has changed once a second at most (`DDATA`), and
//! dies by the broker's hand (`NDEATH` is the connection's last will) or by its own. A host that has lost the thread asks for new births.
//! A device's data are conditions, so that nothing waits: what a broken connection has swallowed is in the next birth.

mod payload;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use prost::Message as _;
use rumqttc::QoS;
use tokio::sync::watch;
use tokio::time::{Instant, sleep_until, timeout};

use self::payload::{DataType, Metric, Payload, Value, metrics};
use super::connection::{Connection, ConnectionEvent, Link, Message, Will};
use super::{FAREWELL, STATUS_EVERY, STOOD, WAITS, next_event, now};
use crate::clock;
use crate::config::SparkplugConfig;
use crate::failure::Failure;
use crate::hub::{AxisStatus, Hub};
use crate::journal::Warnings;

/// Its name among the sinks.
pub const SINK: &str = "sparkplug";
/// First level of all topics.
const NAMESPACE: &str = "spBv1.0";
/// The metric by which a host asks for new births.
const REBIRTH: &str = "Node Control/Rebirth";
/// Births that were asked for come at most this often.
const REBIRTH_EVERY: Duration = Duration::from_secs(1);

/// A node that is kept alive.
pub struct Node {
    config: SparkplugConfig,
    link: Link,
    hub: Arc<Hub>,
    connection: Option<Connection>,
    connected_since: Option<Instant>,
    /// Connections that were tried before this one; the number's low byte ties a death to its birth.
    connections: u64,
    /// Of the next message.
    sequence: u8,
    /// Whether the node is to be born (again).
    birth_due: bool,
    /// What the devices have told last.
    told: BTreeMap<String, Vec<Metric>>,
    retry_at: Instant,
    wait: Duration,
    sent: u64,
    dropped: u64,
    warnings: Warnings,
}

impl Node {
    /// Reads certificates and password.
    ///
    /// # Errors
    /// [`Failure`] where one of these files cannot be read.
    pub fn new(config: &SparkplugConfig, hub: Arc<Hub>) -> Result<Self, Failure> {
        let now = now();
        Ok(Node {
            config: config.clone(),
            link: Link::new(&config.connection())?,
            hub,
            connection: None,
            connected_since: None,
            connections: 0,
            sequence: 0,
            birth_due: true,
            told: BTreeMap::new(),
            retry_at: now,
            wait: WAITS.0,
            sent: 0,
            dropped: 0,
            warnings: Warnings::new(now),
        })
    }

    /// Keeps the node alive until told to stop.
    pub async fn run(mut self, mut stop: watch::Receiver<bool>) {
        let mut changes = self.hub.changes();
        let mut tell_at = now();
        let mut is_due = true;
        self.tell("connecting");
        loop {
            if self.connection.is_none() && now() >= self.retry_at {
                self.connect();
            }
            let (retry_at, waits) = (self.retry_at, self.connection.is_none());
            let may_tell = self.connected_since.is_some();
            tokio::select! {
                biased;
                _ = stop.changed() => break,
                event = next_event(&mut self.connection) => {
                    self.heed(event.unwrap_or_else(|| ConnectionEvent::Lost("the connection ended".into())));
                    is_due |= self.birth_due;
                }
                _ = changes.changed(), if !is_due => is_due = true,
                () = sleep_until(tell_at), if is_due && may_tell => {
                    is_due = false;
                    tell_at = now() + STATUS_EVERY.max(REBIRTH_EVERY);
                    self.tell_axes().await;
                }
                () = sleep_until(retry_at), if waits => {}
            }
        }
        self.say_farewell().await;
    }

    fn topic(&self, kind: &str) -> String {
        format!("{NAMESPACE}/{}/{kind}/{}", self.config.group, self.config.node)
    }

    /// Begins to connect, with a will of the connection's own.
    fn connect(&mut self) {
        let (topic, message) = (self.topic("NDEATH"), self.death().encode_to_vec());
        self.link.will = Some(Will { topic, message, retain: false });
        self.connection = Some(Connection::open(&self.link));
    }

    /// Number of the connection, by which a host knows which birth a death belongs to.
    fn birth_number(&self) -> Metric {
        Metric::new("bdSeq", DataType::Int64, Some(Value::Long(self.connections % 256)))
    }

    fn death(&self) -> Payload {
        let mut payload = stamped(vec![self.birth_number()]);
        payload.seq = None;
        payload
    }

    fn birth(&self) -> Payload {
        let rebirth = Metric::new(REBIRTH, DataType::Boolean, Some(Value::Boolean(false)));
        let version = Value::Text(env!("CARGO_PKG_VERSION").to_owned());
        let version = Metric::new("Properties/seepd version", DataType::Text, Some(version));
        stamped(vec![self.birth_number(), rebirth, version])
    }

    fn heed(&mut self, event: ConnectionEvent) {
        match event {
            ConnectionEvent::Connected => {
                self.connected_since = Some(now());
                self.birth_due = true;
                tracing::info!("sparkplug: connected to the broker at {}", self.link.place());
                let commands = self.topic("NCMD");
                let asked = self.connection.as_ref().map_or(Ok(()), |to| to.subscribe([commands]));
                match asked {
                    Ok(()) => self.tell("connected"),
                    Err(error) => self.lose(&error),
                }
            }
            ConnectionEvent::Message(message) => self.take_command(&message),
            ConnectionEvent::Confirmed => {}
            ConnectionEvent::Refused(why) | ConnectionEvent::Unwilling(why) | ConnectionEvent::Lost(why) => {
                self.lose(&why);
            }
        }
    }

    /// Heeds the one command that there is; what is no command is logged.
    fn take_command(&mut self, message: &Message) {
        if message.topic != self.topic("NCMD") || message.retained {
            return;
        }
        let Ok(payload) = Payload::decode(message.content.as_slice()) else {
            self.warnings.warn(now(), "sparkplug: a message on the topic of commands is no payload");
            return;
        };
        for metric in payload.metrics {
            let name = metric.name.unwrap_or_default();
            match metric.value {
                Some(Value::Boolean(asked)) if name == REBIRTH => self.birth_due |= asked,
                _ => {
                    let name: String = name.chars().take(100).collect();
                    let what = format!("sparkplug: there is no command `{}`", name.escape_debug());
                    self.warnings.warn(now(), &what);
                }
            }
        }
    }

    /// Heeds a message as if the broker had handed it out.
    #[cfg(fuzzing)]
    pub fn hear(&mut self, topic: &str, retained: bool, content: &[u8]) {
        self.take_command(&Message { topic: topic.to_owned(), retained, content: content.to_vec() });
    }

    /// Tells what has changed; after a new connection or where a host has asked, everything.
    async fn tell_axes(&mut self) {
        let axes = self.hub.axes();
        if std::mem::take(&mut self.birth_due) {
            self.sequence = 0;
            self.told.clear();
            self.send(self.topic("NBIRTH"), self.birth()).await;
        }
        let gone: Vec<String> =
            self.told.keys().filter(|name| !axes.iter().any(|axis| axis.axis == **name)).cloned().collect();
        for name in gone {
            self.told.remove(&name);
            self.send(format!("{}/{name}", self.topic("DDEATH")), stamped(Vec::new())).await;
        }
        for axis in axes {
            self.tell_axis(&axis).await;
        }
        if self.connected_since.is_some() {
            self.tell("connected");
        }
    }

    async fn tell_axis(&mut self, axis: &AxisStatus) {
        let now = metrics(axis);
        match self.told.insert(axis.axis.clone(), now.clone()) {
            None => self.send(format!("{}/{}", self.topic("DBIRTH"), axis.axis), stamped(now)).await,
            Some(before) => {
                let news: Vec<Metric> = now
                    .iter()
                    .zip(&before)
                    .filter(|(now, before)| now != before)
                    .map(|(now, _)| now.in_data())
                    .collect();
                if !news.is_empty() {
                    self.send(format!("{}/{}", self.topic("DDATA"), axis.axis), stamped(news)).await;
                }
            }
        }
    }

    /// Sends a payload with the next number; a broker that makes no room for it is given up.
    async fn send(&mut self, topic: String, payload: Payload) {
        let Some(connection) = self.connection.as_ref().filter(|_| self.connected_since.is_some()) else {
            self.dropped += 1;
            return;
        };
        let payload = Payload { seq: Some(self.sequence.into()), ..payload };
        match connection.publish(topic, payload.encode_to_vec(), QoS::AtMostOnce, false).await {
            Ok(()) => {
                self.sequence = self.sequence.wrapping_add(1);
                self.sent += 1;
            }
            Err(error) => {
                self.dropped += 1;
                self.lose(&error);
            }
        }
    }

    /// Gives the connection up; another is tried after a while, a longer one each time.
    fn lose(&mut self, why: &str) {
        if self.connected_since.is_some_and(|since| now().duration_since(since) >= STOOD) {
            self.wait = WAITS.0;
        }
        self.warnings.warn(now(), &format!("sparkplug: the broker at {}: {why}", self.link.place()));
        self.connections += 1;
        (self.connection, self.connected_since) = (None, None);
        self.retry_at = now() + self.wait;
        self.wait = (self.wait * 2).min(WAITS.1);
        self.tell(why);
    }

    fn tell(&self, detail: &str) {
        let (good, sent, dropped) = (self.connected_since.is_some(), self.sent, self.dropped);
        let place = format!("{}/{} at {}", self.config.group, self.config.node, self.link.place());
        self.hub.update_sink(SINK, |sink| {
            (sink.good, sink.sent, sink.dropped) = (good, sent, dropped);
            sink.detail = format!("{place}: {detail}");
        });
    }

    /// Dies by its own hand: a connection that is closed in order has no will.
    async fn say_farewell(&mut self) {
        if self.connected_since.is_none() {
            return;
        }
        let (topic, death) = (self.topic("NDEATH"), self.death().encode_to_vec());
        let Some(connection) = &mut self.connection else { return };
        let _ = timeout(FAREWELL, async {
            if connection.publish(topic, death, QoS::AtLeastOnce, false).await.is_ok() {
                connection.close().await;
            }
        })
        .await;
    }
}

/// A payload of now, ms since 1970; a clock that was never set says 0.
fn stamped(mut metrics: Vec<Metric>) -> Payload {
    let now_ms = clock::wall_ns().and_then(|ns| u64::try_from(ns / 1_000_000).ok()).unwrap_or(0);
    metrics.iter_mut().for_each(|metric| metric.timestamp = Some(now_ms));
    Payload { timestamp: Some(now_ms), metrics, seq: None }
}

/// Lets a node of its own name be born and die, which the broker must confirm.
///
/// # Errors
/// In words, why it did not.
pub async fn test(config: &SparkplugConfig, patience: Duration) -> Result<String, String> {
    let node = format!("{}-test", config.node);
    // A client of its own: a broker drops the older of two with one name, and that would be the daemon.
    let client_id = Some(format!("seepd-test-{}", std::process::id()));
    let config = SparkplugConfig { node, client_id, ..config.clone() };
    let mut node = Node::new(&config, Hub::new("test".into())).map_err(|failure| failure.message)?;
    node.connect();
    match timeout(patience, node.live_and_die()).await {
        Ok(result) => result.map_err(|why| format!("{}: {why}", node.link.place())),
        Err(_) => Err(format!("{} confirmed nothing within {} s", node.link.place(), patience.as_secs())),
    }
}

impl Node {
    async fn live_and_die(&mut self) -> Result<String, String> {
        let death = (self.topic("NDEATH"), self.death().encode_to_vec());
        let birth = Payload { seq: Some(0), ..self.birth() };
        let birth = (self.topic("NBIRTH"), birth.encode_to_vec());
        let Some(connection) = &mut self.connection else { return Err("there is no connection".into()) };
        loop {
            match connection.next_event().await {
                Some(ConnectionEvent::Connected) => {
                    connection.publish(birth.0.clone(), birth.1.clone(), QoS::AtMostOnce, false).await?;
                    connection.publish(death.0.clone(), death.1.clone(), QoS::AtLeastOnce, false).await?;
                }
                Some(ConnectionEvent::Confirmed) => {
                    connection.close().await;
                    return Ok(format!("the broker confirmed {}", death.0));
                }
                Some(ConnectionEvent::Message(_)) => {}
                Some(
                    ConnectionEvent::Refused(why)
                    | ConnectionEvent::Unwilling(why)
                    | ConnectionEvent::Lost(why),
                ) => return Err(why),
                None => return Err("the connection ended".into()),
            }
        }
    }
}

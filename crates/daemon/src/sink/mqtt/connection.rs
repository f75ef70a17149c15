//! A connection to the broker: one form for both versions of the protocol.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use rumqttc::{QoS, TlsConfiguration, Transport, v5};
use rustls::ClientConfig;
use seepd_settings::side_file;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio::time::timeout;

use crate::config::{MqttConfig, MqttVersion};
use crate::failure::Failure;
use crate::sink::tls;

/// Time after which a silent broker is asked whether it is there.
const KEEP_ALIVE: Duration = Duration::from_secs(15);
/// Requests under way to the connection, and what it tells under way from it.
const REQUESTS: usize = 64;
/// Time in which a request must find room: a broker that reads nothing, or one that tells more than is heard meanwhile, would hold up
/// whoever asks for ever.
const ROOM: Duration = Duration::from_secs(5);

/// A client of either version.
enum Client {
    V3(rumqttc::AsyncClient),
    V5(v5::AsyncClient),
}

impl Client {
    async fn publish(&self, topic: String, message: Vec<u8>, qos: QoS, retain: bool) -> Result<(), String> {
        match self {
            Client::V3(client) => {
                client.publish(topic, qos, retain, message).await.map_err(|error| error.to_string())
            }
            Client::V5(client) => {
                client.publish(topic, qos_5(qos), retain, message).await.map_err(|error| error.to_string())
            }
        }
    }

    fn try_publish(&self, topic: String, word: &str) -> Result<(), String> {
        let (qos, word) = (QoS::AtMostOnce, word.to_owned());
        match self {
            Client::V3(client) => {
                client.try_publish(topic, qos, true, word).map_err(|error| error.to_string())
            }
            Client::V5(client) => {
                client.try_publish(topic, qos_5(qos), true, word).map_err(|error| error.to_string())
            }
        }
    }

    fn try_subscribe(&self, topic: String) -> Result<(), String> {
        let qos = QoS::AtLeastOnce;
        match self {
            Client::V3(client) => client.try_subscribe(topic, qos).map_err(|error| error.to_string()),
            Client::V5(client) => client.try_subscribe(topic, qos_5(qos)).map_err(|error| error.to_string()),
        }
    }
}

/// What a connection tells.
pub(super) enum ConnectionEvent {
    Connected,
    Confirmed,
    /// The broker will never take the event, and why.
    Refused(String),
    /// It takes no event now, and why.
    Unwilling(String),
    Message(Message),
    Lost(String),
}

/// A message from others.
pub(super) struct Message {
    pub(super) topic: String,
    /// Whether the broker has kept it and hands it out at each connection.
    pub(super) retained: bool,
    /// What it says; nothing clears a retained message.
    pub(super) content: Vec<u8>,
}

/// What the broker tells others where this client is gone without a farewell; with QoS 1.
pub(super) struct Will {
    pub(super) topic: String,
    pub(super) message: Vec<u8>,
    pub(super) retain: bool,
}

/// Where the broker is, and who asks.
pub(super) struct Link {
    pub(super) config: MqttConfig,
    client_id: String,
    password: Option<String>,
    tls: Option<Arc<ClientConfig>>,
    pub(super) will: Option<Will>,
}

impl Link {
    /// Reads certificates and password.
    ///
    /// # Errors
    /// [`Failure`] where one of these files cannot be read.
    pub(super) fn new(config: &MqttConfig) -> Result<Self, Failure> {
        let (password, tls) = credentials(config)?;
        let host = nix::unistd::gethostname().unwrap_or_default();
        let client_id =
            config.client_id.clone().unwrap_or_else(|| format!("seepd-{}", host.to_string_lossy()));
        Ok(Link { config: config.clone(), client_id, password, tls, will: None })
    }

    /// Host and port.
    pub(super) fn place(&self) -> String {
        format!("{}:{}", self.config.host, self.config.port())
    }

    /// A topic below the prefix.
    pub(super) fn topic(&self, topic: &str) -> String {
        format!("{}/{topic}", self.config.prefix)
    }

    fn transport(&self) -> Transport {
        self.tls.as_ref().map_or(Transport::Tcp, |tls| {
            Transport::tls_with_config(TlsConfiguration::Rustls(Arc::clone(tls)))
        })
    }
}

/// A connection, or the try to make one; it ends with its first loss.
pub(super) struct Connection {
    client: Client,
    events: mpsc::Receiver<ConnectionEvent>,
    task: JoinHandle<()>,
    /// Time in which a request must find room.
    patience: Duration,
}

impl Drop for Connection {
    fn drop(&mut self) {
        self.task.abort();
    }
}

impl Connection {
    /// Begins to connect.
    pub(super) fn open(link: &Link) -> Self {
        let (sender, events) = mpsc::channel(REQUESTS);
        let (client, task) = match link.config.version {
            MqttVersion::V3 => open_3(link, sender),
            MqttVersion::V5 => open_5(link, sender),
        };
        Connection { client, events, task, patience: ROOM }
    }

    /// What it tells next; nothing any more after a loss.
    pub(super) async fn next_event(&mut self) -> Option<ConnectionEvent> {
        self.events.recv().await
    }

    /// Sends a message; waits for a while where many requests are under way.
    pub(super) async fn publish(
        &self,
        topic: String,
        message: Vec<u8>,
        qos: QoS,
        retain: bool,
    ) -> Result<(), String> {
        timeout(self.patience, self.client.publish(topic, message, qos, retain))
            .await
            .unwrap_or_else(|_| Err(format!("it has taken no message for {:?}", self.patience)))
    }

    /// Announces this client by a retained word. The request waits in the connection's queue, which must have room.
    pub(super) fn announce(&self, topic: String, word: &str) -> Result<(), String> {
        self.client.try_publish(topic, word)
    }

    /// Asks for messages under some topics; likewise.
    pub(super) fn subscribe(&self, topics: impl IntoIterator<Item = String>) -> Result<(), String> {
        topics.into_iter().try_for_each(|topic| self.client.try_subscribe(topic))
    }

    /// Takes leave, and waits until all that was asked is sent.
    pub(super) async fn close(&mut self) {
        // An error says that the connection has ended already.
        match &self.client {
            Client::V3(client) => drop(client.disconnect().await),
            Client::V5(client) => drop(client.disconnect().await),
        }
        while !matches!(self.next_event().await, None | Some(ConnectionEvent::Lost(_))) {}
    }
}

fn open_3(link: &Link, events: mpsc::Sender<ConnectionEvent>) -> (Client, JoinHandle<()>) {
    use rumqttc::{AsyncClient, Event, LastWill, MqttOptions, Packet};
    let mut options = MqttOptions::new(&link.client_id, &link.config.host, link.config.port());
    options.set_keep_alive(KEEP_ALIVE).set_clean_session(true).set_max_packet_size(64 << 10, 256 << 10);
    if let Some(Will { topic, message, retain }) = &link.will {
        options.set_last_will(LastWill::new(topic, message.clone(), QoS::AtLeastOnce, *retain));
    }
    if let Some(user) = &link.config.username {
        options.set_credentials(user, link.password.as_deref().unwrap_or_default());
    }
    options.set_transport(link.transport());
    let (client, mut connection) = AsyncClient::new(options, REQUESTS);
    let task = tokio::spawn(async move {
        loop {
            let event = match connection.poll().await {
                Ok(Event::Incoming(Packet::ConnAck(_))) => ConnectionEvent::Connected,
                Ok(Event::Incoming(Packet::PubAck(_))) => ConnectionEvent::Confirmed,
                Ok(Event::Incoming(Packet::Publish(message))) => ConnectionEvent::Message(Message {
                    topic: message.topic,
                    retained: message.retain,
                    content: message.payload.to_vec(),
                }),
                Ok(_) => continue,
                Err(error) => ConnectionEvent::Lost(error.to_string()),
            };
            let lost = matches!(event, ConnectionEvent::Lost(_));
            if events.send(event).await.is_err() || lost {
                return;
            }
        }
    });
    (Client::V3(client), task)
}

fn open_5(link: &Link, events: mpsc::Sender<ConnectionEvent>) -> (Client, JoinHandle<()>) {
    use v5::mqttbytes::v5::{LastWill, Packet, PubAckReason};
    use v5::{AsyncClient, Event, MqttOptions};
    let mut options = MqttOptions::new(&link.client_id, &link.config.host, link.config.port());
    options.set_keep_alive(KEEP_ALIVE).set_clean_start(true).set_max_packet_size(Some(64 << 10));
    if let Some(Will { topic, message, retain }) = &link.will {
        let qos = qos_5(QoS::AtLeastOnce);
        options.set_last_will(LastWill::new(topic.clone(), message.clone(), qos, *retain, None));
    }
    if let Some(user) = &link.config.username {
        options.set_credentials(user, link.password.as_deref().unwrap_or_default());
    }
    options.set_transport(link.transport());
    let (client, mut connection) = AsyncClient::new(options, REQUESTS);
    let task = tokio::spawn(async move {
        loop {
            let event = match connection.poll().await {
                Ok(Event::Incoming(Packet::ConnAck(_))) => ConnectionEvent::Connected,
                Ok(Event::Incoming(Packet::PubAck(ack))) => match ack.reason {
                    PubAckReason::Success | PubAckReason::NoMatchingSubscribers => ConnectionEvent::Confirmed,
                    reason @ (PubAckReason::QuotaExceeded | PubAckReason::PacketIdentifierInUse) => {
                        ConnectionEvent::Unwilling(format!("{reason:?}"))
                    }
                    reason => ConnectionEvent::Refused(format!("{reason:?}")),
                },
                Ok(Event::Incoming(Packet::Publish(message))) => ConnectionEvent::Message(Message {
                    topic: String::from_utf8_lossy(&message.topic).into_owned(),
                    retained: message.retain,
                    content: message.payload.to_vec(),
                }),
                Ok(_) => continue,
                Err(error) => ConnectionEvent::Lost(error.to_string()),
            };
            let lost = matches!(event, ConnectionEvent::Lost(_));
            if events.send(event).await.is_err() || lost {
                return;
            }
        }
    });
    (Client::V5(client), task)
}

fn qos_5(qos: QoS) -> v5::mqttbytes::QoS {
    match qos {
        QoS::AtMostOnce => v5::mqttbytes::QoS::AtMostOnce,
        QoS::AtLeastOnce => v5::mqttbytes::QoS::AtLeastOnce,
        QoS::ExactlyOnce => v5::mqttbytes::QoS::ExactlyOnce,
    }
}

/// Password and certificates.
///
/// # Errors
/// [`Failure`] where one of their files cannot be read.
pub fn credentials(config: &MqttConfig) -> Result<(Option<String>, Option<Arc<ClientConfig>>), Failure> {
    let read = |path: &Path| side_file::read_text(path).map_err(|error| Failure::reading(path, &error));
    let password = config.password_file.as_deref().map(read).transpose()?;
    let password = password.map(|text| text.trim_end_matches(['\r', '\n']).to_owned());
    let own = config.certificate_file.as_deref().zip(config.key_file.as_deref());
    let tls = if config.tls { Some(tls::client(&config.ca_file, own)?) } else { None };
    Ok((password, tls))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A broker that reads nothing, or a connection that waits for somebody to hear what it tells: nobody works on the requests.
    #[tokio::test]
    async fn a_connection_that_takes_no_message_is_given_up() {
        let options = rumqttc::MqttOptions::new("test", "localhost", 1883);
        let (client, _idle) = rumqttc::AsyncClient::new(options, REQUESTS);
        let (_, events) = mpsc::channel(1);
        let patience = Duration::from_millis(50);
        let task = tokio::spawn(async {});
        let connection = Connection { client: Client::V3(client), events, task, patience };
        let publish = || connection.publish("t".into(), Vec::new(), QoS::AtMostOnce, true);
        for _ in 0..REQUESTS {
            publish().await.unwrap();
        }
        assert_eq!(publish().await, Err("it has taken no message for 50ms".into()));
    }
}

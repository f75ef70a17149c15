//! A broker: events that arrive at least once and in order, and each axis's condition, retained.
//!
//! Below the prefix: `AXIS/cycle`, `AXIS/flag`, `AXIS/notice`, `AXIS/acknowledged`, `AXIS/test` (events), `AXIS/status` (retained),
//! `status` (`online` or `offline`, retained; the last will). A message on `AXIS/acknowledge` takes note of a latched flag, one on
//! `AXIS/new_baseline` has a new baseline learned, one on `AXIS/repair` is an entry for the repair log, as JSON. Retained messages are no orders, as they would be
//! given again at each connection.
//! An event is on disk before it counts as told; it goes from there when the broker has confirmed it. One that the broker refuses
//! is set aside, so that those behind it arrive.

mod connection;
mod home_assistant;
#[cfg(feature = "sparkplug")]
pub mod sparkplug;
pub mod spool;

use std::collections::BTreeSet;
use std::io;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use rumqttc::QoS;
use tokio::sync::watch;
use tokio::time::{Instant, sleep_until, timeout};

use self::connection::{Connection, ConnectionEvent, Link, Message, Will};
use crate::config::MqttConfig;
use crate::failure::Failure;
use crate::hub::SourceState;
use crate::hub::{AxisStatus, Hub, NewRepair, Order, Publication, Signature, Subscription};
use crate::journal::Warnings;
use crate::sink::mqtt::spool::{Counts, Spool};
use seepd_monitor::event::Flag;

pub use self::connection::credentials;

/// The broker's name among the sinks.
pub const SINK: &str = "mqtt";
/// First and longest wait before another try.
const WAITS: (Duration, Duration) = (Duration::from_millis(500), Duration::from_secs(30));
/// Time in which a broker must confirm an event.
const CONFIRMATION: Duration = Duration::from_secs(20);
/// Changes of an axis's condition are told at most this often.
const STATUS_EVERY: Duration = Duration::from_secs(1);
/// Counts alone are told this often.
const COUNTS_EVERY: Duration = Duration::from_secs(60);
/// Time for a farewell.
const FAREWELL: Duration = Duration::from_millis(500);

/// A connection that has stood for so long was a good one: after it the first wait is the shortest again.
const STOOD: Duration = WAITS.1;
/// An event over which the connection was lost so often in a row is set aside. MQTT 3.1.1 has no other way to refuse one.
const LOSSES: u32 = 5;

/// A broker that is kept up with.
pub struct Broker {
    link: Link,
    /// Whether this client announces itself as the daemon and takes orders.
    presence: bool,
    hub: Arc<Hub>,
    spool: Arc<Mutex<Spool>>,
    /// What it has to tell.
    events: Option<Subscription>,
    /// What was in the spool when it was last at work.
    counts: Counts,
    connection: Option<Connection>,
    connected_since: Option<Instant>,
    under_way: Option<UnderWay>,
    /// Whether orders have been asked for.
    listens: bool,
    /// Number of the event over which the connection was lost last, and how often in a row.
    losses: (u64, u32),
    /// Topics of which events were refused and none was taken since.
    refused: BTreeSet<String>,
    retry_at: Instant,
    wait: Duration,
    sent: u64,
    /// Events that came faster than they could be kept.
    lost: u64,
    /// Why events wait in memory instead of on disk.
    unwritten: Option<String>,
    /// What was last told of the axes, and when their counts are due.
    announced: Vec<StatusKey>,
    /// Axes of which Home Assistant has been told.
    discovered: Vec<String>,
    counts_at: Instant,
    warnings: Warnings,
}

fn in_memory(why: &str) -> String {
    format!("events wait in memory, since they cannot be written to disk: {why}")
}

/// An event that waits for its confirmation.
struct UnderWay {
    number: u64,
    topic: String,
    until: Instant,
}

impl UnderWay {
    fn new(number: u64, topic: String) -> Self {
        UnderWay { number, topic, until: now() + CONFIRMATION }
    }
}

/// What of a condition is worth a message at once.
#[derive(Debug, PartialEq)]
struct StatusKey {
    axis: String,
    cycle: Option<u64>,
    flag: Flag,
    latched: Option<Flag>,
    acknowledged: bool,
    stale: bool,
    source: SourceState,
}

impl StatusKey {
    fn of(status: &AxisStatus) -> Self {
        StatusKey {
            axis: status.axis.clone(),
            cycle: status.cycle,
            flag: status.flag,
            latched: status.latched,
            acknowledged: status.acknowledged,
            stale: status.stale,
            source: status.source.state,
        }
    }
}

impl Broker {
    /// Reads certificates and password, and takes up what waits on disk.
    ///
    /// # Errors
    /// [`Failure`] where one of these files cannot be read.
    pub fn new(config: &MqttConfig, spool_folder: &Path, hub: Arc<Hub>) -> Result<Self, Failure> {
        let now = now();
        let spool = Spool::open(spool_folder, config.spool_events)?;
        let mut link = Link::new(config)?;
        link.will = Some(Will { topic: link.topic("status"), message: b"offline".to_vec(), retain: true });
        let events = Some(hub.subscribe_to_keep(SINK, config.spool_events));
        Ok(Broker {
            link,
            presence: true,
            events,
            hub,
            counts: spool.counts(),
            spool: Arc::new(Mutex::new(spool)),
            connection: None,
            connected_since: None,
            under_way: None,
            listens: false,
            losses: (0, 0),
            refused: BTreeSet::new(),
            retry_at: now,
            wait: WAITS.0,
            sent: 0,
            lost: 0,
            unwritten: None,
            announced: Vec::new(),
            discovered: Vec::new(),
            counts_at: now,
            warnings: Warnings::new(now),
        })
    }

    /// Keeps up as another client than the daemon: sends events, and neither conditions nor that it is there.
    pub async fn run_without_presence(mut self, stop: watch::Receiver<bool>) {
        self.presence = false;
        self.link.will = None;
        self.run(stop).await;
    }

    /// Keeps up until told to stop.
    pub async fn run(mut self, mut stop: watch::Receiver<bool>) {
        let Some(mut events) = self.events.take() else { return };
        let mut changes = self.hub.changes();
        let mut status_at = now();
        let mut status_due = true;
        self.tell("connecting");
        loop {
            if self.connection.is_none() && now() >= self.retry_at {
                self.connection = Some(Connection::open(&self.link));
            }
            self.send_next().await;
            self.listen();
            let (retry_at, waits) = (self.retry_at, self.connection.is_none());
            let may_tell = self.connected_since.is_some();
            let confirmation = self.under_way.as_ref().map(|event| event.until);
            let event = next_event(&mut self.connection);
            tokio::select! {
                biased;
                _ = stop.changed() => break,
                event = event => {
                    self.heed(event.unwrap_or_else(|| ConnectionEvent::Lost("the connection ended".into()))).await;
                    status_due = true;
                }
                Some(event) = events.recv() => {
                    self.lost += events.lost();
                    self.take(&event).await;
                    events.has_kept_one();
                }
                _ = changes.changed(), if !status_due => status_due = true,
                () = sleep_until(status_at), if status_due && may_tell => {
                    status_due = false;
                    status_at = now() + STATUS_EVERY;
                    self.send_status().await;
                }
                () = sleep_until(retry_at), if waits => {}
                () = sleep_until(confirmation.unwrap_or(retry_at)), if confirmation.is_some() => {
                    self.lose_over_event("the broker confirms nothing").await;
                }
            }
        }
        // What came until now is on disk before the end.
        while let Some(event) = events.try_recv() {
            self.take(&event).await;
            events.has_kept_one();
        }
        // A reload may be starting another one, which tells what comes from here on.
        self.hub.park(SINK, events);
        self.say_farewell().await;
    }

    /// Works on the spool where a slow disk holds nothing up, and notes what is there then.
    async fn at_disk<T: Send + 'static>(
        &mut self,
        work: impl FnOnce(&mut Spool) -> io::Result<T> + Send + 'static,
    ) -> io::Result<T> {
        let spool = Arc::clone(&self.spool);
        let at_work = tokio::task::spawn_blocking(move || {
            let mut spool = spool.lock().unwrap_or_else(PoisonError::into_inner);
            (work(&mut spool), spool.counts())
        });
        let (result, counts) = at_work.await.map_err(io::Error::other)?;
        self.counts = counts;
        result
    }

    fn tell(&self, detail: &str) {
        let Counts { waiting, damaged, refused, dropped } = self.counts;
        let (good, sent) = (self.connected_since.is_some() && self.unwritten.is_none(), self.sent);
        let disk = self.unwritten.as_ref().map_or(String::new(), |why| format!("; {}", in_memory(why)));
        let gone = damaged + refused + dropped + self.lost;
        let place = self.link.place();
        let topics: Vec<&str> = self.refused.iter().map(String::as_str).collect();
        let refusal = match topics[..] {
            [] => String::new(),
            _ => format!("; the broker refuses {}", topics.join(", ")),
        };
        self.hub.update_sink(SINK, |status| {
            status.good = good;
            status.detail = format!("{place}: {detail}{refusal}{disk}");
            (status.sent, status.waiting, status.dropped) = (sent, waiting, gone);
        });
    }

    /// Takes an event: sent at once where nothing waits before it, and kept on disk in any case.
    async fn take(&mut self, event: &Publication) {
        let topic = format!("{}/{}", event.axis, event.kind.name());
        let connected = self.connected_since.is_some();
        let at_once = connected && self.under_way.is_none() && self.counts.waiting == 0;
        if at_once {
            self.publish(&topic, event.json.clone(), QoS::AtLeastOnce, false).await;
        }
        let (kept, json) = (topic.clone(), event.json.clone());
        let push =
            move |spool: &mut Spool| Ok((spool.push(&kept, &json)?, spool.failure().map(str::to_owned)));
        match self.at_disk(push).await {
            Ok((number, unwritten)) => {
                self.heed_disk(unwritten);
                if at_once && self.connected_since.is_some() {
                    self.under_way = Some(UnderWay::new(number, topic));
                }
            }
            Err(error) => {
                self.lost += 1;
                self.warnings.warn(now(), &format!("an event cannot be kept for the broker: {error}"));
            }
        }
        self.tell(if self.connected_since.is_some() { "connected" } else { "waiting for the broker" });
    }

    /// Tells once that the disk takes no events, and once that it does again.
    fn heed_disk(&mut self, unwritten: Option<String>) {
        match (&self.unwritten, &unwritten) {
            (None, Some(why)) => tracing::error!("mqtt: {}", in_memory(why)),
            (Some(_), None) => tracing::info!("mqtt: events wait on disk again"),
            _ => {}
        }
        self.unwritten = unwritten;
    }

    /// Sends the event that has waited longest, if none is under way.
    async fn send_next(&mut self) {
        if self.connected_since.is_none() || self.under_way.is_some() || self.counts.waiting == 0 {
            return;
        }
        let Ok(Some((number, entry))) = self.at_disk(|spool| Ok(spool.first())).await else { return };
        self.under_way = Some(UnderWay::new(number, entry.topic.clone()));
        self.publish(&entry.topic, entry.message.get().to_owned(), QoS::AtLeastOnce, false).await;
    }

    async fn send_status(&mut self) {
        if !self.presence {
            return;
        }
        let axes = self.hub.axes();
        let keys: Vec<StatusKey> = axes.iter().map(StatusKey::of).collect();
        if self.announced == keys && now() < self.counts_at {
            return;
        }
        self.announced = keys;
        self.send_discovery(&axes).await;
        self.counts_at = now() + COUNTS_EVERY;
        for status in axes {
            let json = serde_json::to_string(&status).unwrap_or_default();
            self.publish(&format!("{}/status", status.axis), json, QoS::AtMostOnce, true).await;
        }
    }

    /// Tells Home Assistant of the axes, once a connection; of one that is there no more it is told that it has gone.
    async fn send_discovery(&mut self, axes: &[AxisStatus]) {
        let Some(of) = self.link.config.home_assistant.clone() else { return };
        let names: Vec<String> = axes.iter().map(|status| status.axis.clone()).collect();
        let before = std::mem::replace(&mut self.discovered, names.clone());
        let prefix = self.link.config.prefix.clone();
        for axis in names.iter().filter(|axis| !before.contains(axis)) {
            let (topic, message) = home_assistant::discovery(&of, &prefix, axis);
            self.publish_at(topic, message.to_string(), QoS::AtMostOnce, true).await;
        }
        for axis in before.iter().filter(|axis| !names.contains(axis)) {
            let (topic, _) = home_assistant::discovery(&of, &prefix, axis);
            self.publish_at(topic, String::new(), QoS::AtMostOnce, true).await;
        }
    }

    async fn publish(&mut self, topic: &str, message: String, qos: QoS, retain: bool) {
        self.publish_at(self.link.topic(topic), message, qos, retain).await;
    }

    async fn publish_at(&mut self, topic: String, message: String, qos: QoS, retain: bool) {
        let Some(connection) = &self.connection else { return };
        if let Err(error) = connection.publish(topic, message.into_bytes(), qos, retain).await {
            self.lose(&error);
        }
    }

    async fn heed(&mut self, event: ConnectionEvent) {
        match event {
            ConnectionEvent::Connected => {
                self.connected_since = Some(now());
                self.announced.clear();
                self.discovered.clear();
                tracing::info!("connected to the broker at {}", self.link.place());
                self.greet();
                self.tell("connected");
            }
            ConnectionEvent::Confirmed => {
                if let Some(event) = self.under_way.take() {
                    self.sent += 1;
                    self.refused.remove(&event.topic);
                    let removed = self.at_disk(move |spool| spool.arrived(event.number)).await;
                    if let Err(error) = removed {
                        let what = "an event that the broker has cannot be removed from the spool";
                        self.warnings.warn(now(), &format!("{what}: {error}"));
                    }
                }
                self.tell("connected");
            }
            ConnectionEvent::Refused(why) => {
                if let Some(event) = self.under_way.take() {
                    self.set_aside(event, &why).await;
                }
                self.tell("connected");
            }
            ConnectionEvent::Unwilling(why) => self.lose(&format!("it takes no event at present: {why}")),
            ConnectionEvent::Message(message) => self.take_order(&message),
            ConnectionEvent::Lost(why) => self.lose_over_event(&why).await,
        }
    }

    fn take_order(&mut self, message: &Message) {
        let rest = message.topic.strip_prefix(&self.link.config.prefix);
        let rest = rest.and_then(|rest| rest.strip_prefix('/')).and_then(|rest| rest.rsplit_once('/'));
        let (axis, order) = match rest {
            // Any content acknowledges; one that says who does is kept.
            Some((axis, "acknowledge")) => {
                (axis, Ok(Order::Acknowledge(Signature::from_json(&message.content).unwrap_or_default())))
            }
            Some((axis, "new_baseline")) => (axis, Ok(Order::Renew)),
            Some((axis, "repair")) => (axis, NewRepair::from_json(&message.content).map(Order::Repair)),
            _ => return,
        };
        let fault = if message.retained {
            "a retained message is no order, since the broker would repeat it at each connection; clear it with an empty message".into()
        } else if message.content.is_empty() {
            "an empty message is no order, since it clears a retained one".into()
        } else {
            match order.map(|order| self.hub.order(axis, order)) {
                Ok(Ok(())) => return,
                Ok(Err(not_taken)) => not_taken.to_string(),
                Err(what) => what,
            }
        };
        self.warnings.warn(now(), &format!("{}: {fault}", message.topic));
    }

    /// Puts an event that the broker refuses out of the way of the others.
    async fn set_aside(&mut self, event: UnderWay, why: &str) {
        let UnderWay { number, topic, .. } = event;
        let what =
            format!("the broker refuses {topic}: {why}; the event is kept in the spool's folder `refused`");
        self.warnings.warn(now(), &what);
        self.refused.insert(topic);
        if let Err(error) = self.at_disk(move |spool| spool.refuse(number)).await {
            self.warnings.warn(now(), &format!("a refused event cannot be moved: {error}"));
        }
    }

    /// Gives the connection up, and after some losses in a row also the event that was under way.
    async fn lose_over_event(&mut self, why: &str) {
        if let Some(event) = self.under_way.take() {
            let (number, times) = self.losses;
            self.losses = (event.number, if number == event.number { times + 1 } else { 1 });
            // After one of a topic the next are known by the first loss.
            if self.losses.1 >= LOSSES || self.refused.contains(&event.topic) {
                self.set_aside(event, why).await;
                // What stood in the way is gone.
                self.wait = WAITS.0;
            }
        }
        self.lose(why);
    }

    /// Gives the connection up; another is tried after a while, a longer one each time.
    fn lose(&mut self, why: &str) {
        if self.connected_since.is_some_and(|since| now().duration_since(since) >= STOOD) {
            self.wait = WAITS.0;
        }
        if self.connected_since.is_some() || self.wait == WAITS.0 {
            let what = format!("the broker at {}: {why}", self.link.place());
            self.warnings.warn(now(), &what);
        }
        self.connection = None;
        self.connected_since = None;
        self.listens = false;
        self.under_way = None;
        self.retry_at = now() + self.wait;
        self.wait = (self.wait * 2).min(WAITS.1);
        self.tell(why);
    }

    /// Announces this daemon.
    fn greet(&self) {
        let Some(connection) = self.connection.as_ref().filter(|_| self.presence) else { return };
        if let Err(error) = connection.announce(self.link.topic("status"), "online") {
            tracing::warn!("the broker cannot be greeted: {error}");
        }
    }

    /// Asks for orders once nothing waits: what the broker hands out for them, such as a retained message too large to be read, may
    /// end the connection, and must not keep events back.
    fn listen(&mut self) {
        let idle = self.under_way.is_none() && self.counts.waiting == 0;
        if self.listens || !idle || self.connected_since.is_none() || !self.presence {
            return;
        }
        let Some(connection) = &self.connection else { return };
        let orders =
            ["acknowledge", "new_baseline", "repair"].map(|word| self.link.topic(&format!("+/{word}")));
        match connection.subscribe(orders) {
            Ok(()) => self.listens = true,
            Err(error) => self.lose(&error),
        }
    }

    async fn say_farewell(&mut self) {
        if self.connected_since.is_none() {
            return;
        }
        let _ = timeout(FAREWELL, async {
            if self.presence {
                self.publish("status", "offline".into(), QoS::AtMostOnce, true).await;
            }
            if let Some(connection) = &mut self.connection {
                connection.close().await;
            }
        })
        .await;
    }
}

#[cfg(fuzzing)]
impl Broker {
    /// Heeds a message as if the broker had handed it out.
    pub fn hear(&mut self, topic: &str, retained: bool, content: &[u8]) {
        self.take_order(&Message { topic: topic.to_owned(), retained, content: content.to_vec() });
    }
}

/// What the connection tells next; never, where there is none.
async fn next_event(connection: &mut Option<Connection>) -> Option<ConnectionEvent> {
    match connection {
        Some(connection) => connection.next_event().await,
        None => std::future::pending().await,
    }
}

fn now() -> Instant {
    crate::clock::instant()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hub::Kind;

    fn broker(folder: &Path) -> Broker {
        Broker::new(&MqttConfig::default(), folder, Hub::new("test".into())).unwrap()
    }

    fn event(kind: Kind) -> Publication {
        let json = String::from("{}");
        Publication { kind, axis: "press".into(), t_ns: 0, event_json: json.clone(), json }
    }

    /// The connection is made, the first event sent, and then something told.
    async fn send_and_heed(broker: &mut Broker, event: ConnectionEvent) {
        broker.connected_since = Some(now());
        broker.send_next().await;
        broker.heed(event).await;
    }

    #[tokio::test]
    async fn an_event_that_no_connection_survives_makes_way_for_the_next() {
        let folder = tempfile::tempdir().unwrap();
        let mut broker = broker(folder.path());
        for kind in [Kind::Cycle, Kind::Flag, Kind::Cycle, Kind::Flag] {
            broker.take(&event(kind)).await;
        }
        let lost = || ConnectionEvent::Lost("closed".into());
        for _ in 1..LOSSES {
            send_and_heed(&mut broker, lost()).await;
        }
        // A broker that is away loses no event: nothing is under way then.
        broker.heed(lost()).await;
        assert_eq!((broker.counts.waiting, broker.counts.refused), (4, 0));
        send_and_heed(&mut broker, lost()).await;
        assert_eq!((broker.counts.waiting, broker.counts.refused), (3, 1));
        send_and_heed(&mut broker, ConnectionEvent::Confirmed).await;
        // The topic is known by now: one loss is enough. The flag behind it arrives.
        send_and_heed(&mut broker, lost()).await;
        assert_eq!((broker.counts.waiting, broker.counts.refused), (1, 2));
        send_and_heed(&mut broker, ConnectionEvent::Confirmed).await;
        assert_eq!((broker.counts.waiting, broker.sent), (0, 2));
        assert_eq!(broker.refused, BTreeSet::from(["press/cycle".to_owned()]));
    }

    #[tokio::test]
    async fn a_broker_that_has_no_room_is_waited_for_ever_longer() {
        let folder = tempfile::tempdir().unwrap();
        let mut broker = broker(folder.path());
        broker.take(&event(Kind::Flag)).await;
        let mut waits = Vec::new();
        for _ in 0..8 {
            waits.push(broker.wait.as_millis());
            send_and_heed(&mut broker, ConnectionEvent::Unwilling("QuotaExceeded".into())).await;
        }
        assert_eq!(waits, [500, 1000, 2000, 4000, 8000, 16_000, 30_000, 30_000]);
        assert_eq!((broker.counts.waiting, broker.counts.refused), (1, 0));
        // A connection that has stood was a good one.
        broker.connected_since = Some(now() - STOOD);
        broker.lose("closed");
        assert_eq!(broker.wait, WAITS.0 * 2);
    }
}

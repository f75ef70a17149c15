//! A broker: events that arrive at least once and in order, and each axis's condition, retained.
//!
//! Below the prefix: `AXIS/cycle`, `AXIS/flag`, `AXIS/notice`, `AXIS/acknowledged`, `AXIS/test` (events), `AXIS/status` (retained),
//! `status` (`online` or `offline`, retained; the last will). A message on `AXIS/acknowledge` takes note of a latched flag, one on
//! `AXIS/new_baseline` has a new baseline learned: the seal has been replaced.
//! An event is on disk before it counts as told; it goes from there when the broker has confirmed it.

mod connection;

use std::io;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use rumqttc::QoS;
use tokio::sync::watch;
use tokio::time::{Instant, sleep_until, timeout};

use self::connection::{Connection, KEEP_ALIVE, Link, Told};
use crate::config::MqttConfig;
use crate::event::Flag;
use crate::failure::Failure;
use crate::live::hub::{AxisStatus, Hub, Order, Publication};
use crate::live::spool::Spool;
use crate::source::live::SourceState;

pub use self::connection::credentials;

/// The broker's name among the sinks.
pub const SINK: &str = "mqtt";
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

/// A broker that is kept up with.
pub struct Broker {
    link: Link,
    hub: Arc<Hub>,
    spool: Arc<Mutex<Spool>>,
    connection: Option<Connection>,
    connected: bool,
    /// Number of the event that waits for its confirmation, and until when.
    under_way: Option<(u64, Instant)>,
    retry_at: Instant,
    wait: Duration,
    sent: u64,
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
        let now = now();
        Ok(Broker {
            link: Link::new(config)?,
            spool: Arc::new(Mutex::new(Spool::open(spool_folder, config.spool_events)?)),
            hub,
            connection: None,
            connected: false,
            under_way: None,
            retry_at: now,
            wait: WAITS.0,
            sent: 0,
            told: Vec::new(),
            counts_at: now,
        })
    }

    /// Keeps up as another client than the daemon: sends events, and neither conditions nor that it is there.
    pub async fn run_without_presence(mut self, stop: watch::Receiver<bool>) {
        self.link.presence = false;
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
                self.connection = Some(Connection::open(&self.link));
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
        let place = self.link.place();
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
        if !self.link.presence {
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
        let Some(connection) = &self.connection else { return };
        if let Err(error) = connection.publish(self.link.topic(topic), message, qos, retain).await {
            self.lose(&error);
        }
    }

    fn heed(&mut self, told: Told) {
        match told {
            Told::Connected => {
                self.connected = true;
                self.wait = WAITS.0;
                self.told.clear();
                tracing::info!("connected to the broker at {}", self.link.place());
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
        let rest = topic.strip_prefix(&self.link.config.prefix).and_then(|rest| rest.strip_prefix('/'));
        let Some((axis, word)) = rest.and_then(|rest| rest.rsplit_once('/')) else { return };
        let order = match word {
            "acknowledge" => Order::Acknowledge,
            "new_baseline" => Order::Renew,
            _ => return,
        };
        if let Err(not_taken) = self.hub.order(axis, order) {
            tracing::warn!("{topic}: {not_taken}");
        }
    }

    /// Gives the connection up; another is tried after a while, a longer one each time.
    fn lose(&mut self, why: &str) {
        if self.connected || self.wait == WAITS.0 {
            tracing::warn!("the broker at {}: {why}", self.link.place());
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
        if !self.link.presence {
            return;
        }
        let Some(connection) = &self.connection else { return };
        let orders = ["acknowledge", "new_baseline"].map(|word| self.link.topic(&format!("+/{word}")));
        if let Err(error) = connection.greet(self.link.topic("status"), "online", orders.into()) {
            tracing::warn!("greeting the broker: {error}");
        }
    }

    async fn say_farewell(&mut self) {
        if !self.connected {
            return;
        }
        let _ = timeout(FAREWELL, async {
            if self.link.presence {
                self.publish("status", "offline".into(), QoS::AtMostOnce, true).await;
            }
            if let Some(connection) = &mut self.connection {
                connection.close().await;
            }
        })
        .await;
    }
}

/// What the connection tells next; never, where there is none.
async fn next_told(connection: &mut Option<Connection>) -> Option<Told> {
    match connection {
        Some(connection) => connection.told().await,
        None => std::future::pending().await,
    }
}

fn now() -> Instant {
    crate::live::clock::instant()
}

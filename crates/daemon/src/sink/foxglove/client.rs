//! One client: what it has been offered, what it has asked for, and how long it is waited for.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use futures_util::{SinkExt, StreamExt};
use serde_json::Value;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::sync::watch;
use tokio::time::{Instant, timeout};
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::{Error, Message};

use super::SINK;
use super::protocol::{
    Asked, SIGNALS, STATUS, Topic, Wanted, advertise, data, server_info, topics, unadvertise, warning,
};
use crate::clock;
use crate::hub::{Hub, Publication};
use crate::sink::recording;

/// What a client may take its time for.
#[derive(Debug, Clone, Copy)]
pub(super) struct Patience {
    /// To take a message.
    pub(super) message: Duration,
    /// To answer a ping, or to say anything else.
    pub(super) silence: Duration,
}

/// What clients have.
pub(super) const PATIENCE: Patience =
    Patience { message: Duration::from_secs(5), silence: Duration::from_secs(20) };
/// The command is told this often.
const BEAT: Duration = Duration::from_millis(100);
/// Beats from one condition to the next, and from one ping to the next.
const BEATS: (u64, u64) = (10, 50);
/// Points of the command that go out at a beat: twice what is new by then.
const POINTS: usize = 10;
/// Events that may wait while a message is taken.
const EVENTS: usize = 64;
/// Channels that a client may hear at a time.
const SUBSCRIPTIONS: usize = 1000;

/// How a client ended.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum End {
    /// It left, or the daemon did.
    Left,
    /// It took nothing for too long.
    Stalled,
    /// It was not let in.
    Refused(String),
}

/// A channel that was offered.
struct Channel {
    id: u32,
    axis: String,
    topic: Topic,
}

/// A channel that is heard.
struct Heard {
    axis: String,
    topic: &'static str,
    channel: u32,
    /// Of the command: time of the last point, ns.
    told_ns: i64,
}

/// A client that is served.
pub(super) struct Client<S> {
    socket: WebSocketStream<S>,
    hub: Arc<Hub>,
    patience: Patience,
    channels: Vec<Channel>,
    next_id: u32,
    /// By the client's own numbers.
    heard: BTreeMap<u32, Heard>,
    spoke_at: Instant,
    /// Messages since the sink was last told.
    sent: u64,
}

impl<S: AsyncRead + AsyncWrite + Unpin> Client<S> {
    pub(super) fn new(socket: WebSocketStream<S>, hub: Arc<Hub>, patience: Patience) -> Self {
        let (channels, heard) = (Vec::new(), BTreeMap::new());
        Client { socket, hub, patience, channels, next_id: 1, heard, spoke_at: clock::instant(), sent: 0 }
    }

    /// Serves it until it ends, stalls, or the daemon stops.
    pub(super) async fn run(mut self, mut stop: watch::Receiver<bool>) -> End {
        let end = tokio::select! {
            end = self.serve() => end,
            _ = stop.changed() => End::Left,
        };
        self.tell_sent();
        if end == End::Left {
            // One that has left already needs no farewell.
            let _ = timeout(Duration::from_millis(500), self.socket.close(None)).await;
        }
        end
    }

    async fn serve(&mut self) -> End {
        let mut events = self.hub.subscribe(EVENTS);
        let mut beats = tokio::time::interval(BEAT);
        beats.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        let mut beat = 0u64;
        let mut done = self.greet().await;
        while done.is_ok() {
            done = tokio::select! {
                asked = self.socket.next() => self.heed(asked).await,
                Some(event) = events.recv() => self.tell_event(&event, events.lost()).await,
                _ = beats.tick() => {
                    beat += 1;
                    self.tell_beat(beat).await
                }
            };
        }
        done.err().unwrap_or(End::Left)
    }

    async fn greet(&mut self) -> Result<(), End> {
        let info = server_info(self.hub.run());
        self.send_text(&info).await?;
        self.offer().await
    }

    /// Offers what there is and was not offered yet, and takes back what is there no more.
    async fn offer(&mut self) -> Result<(), End> {
        let axes: Vec<String> = self.hub.views(|_| ()).into_keys().collect();
        let (stay, gone): (Vec<Channel>, Vec<Channel>) =
            std::mem::take(&mut self.channels).into_iter().partition(|channel| axes.contains(&channel.axis));
        self.channels = stay;
        let offered = self.channels.len();
        for axis in axes {
            if !self.channels[..offered].iter().any(|channel| channel.axis == axis) {
                for topic in topics() {
                    self.channels.push(Channel { id: self.next_id, axis: axis.clone(), topic });
                    self.next_id = self.next_id.wrapping_add(1);
                }
            }
        }
        if !gone.is_empty() {
            let ids: Vec<u32> = gone.iter().map(|channel| channel.id).collect();
            self.heard.retain(|_, heard| !ids.contains(&heard.channel));
            self.send_text(&unadvertise(&ids)).await?;
        }
        if self.channels.len() > offered {
            let fresh = self.channels[offered..].iter();
            let message = advertise(fresh.map(|channel| (channel.id, channel.axis.as_str(), channel.topic)));
            self.send_text(&message).await?;
        }
        Ok(())
    }

    async fn heed(&mut self, asked: Option<Result<Message, Error>>) -> Result<(), End> {
        self.spoke_at = clock::instant();
        match asked {
            Some(Ok(Message::Text(text))) => match serde_json::from_str(&text) {
                Ok(Asked::Subscribe { subscriptions }) => self.subscribe(subscriptions).await,
                Ok(Asked::Unsubscribe { subscription_ids }) => {
                    self.heard.retain(|id, _| !subscription_ids.contains(id));
                    Ok(())
                }
                Ok(Asked::Other) => self.warn("this server has channels to be heard, and nothing else").await,
                Err(_) => self.warn("this is no message of the protocol").await,
            },
            Some(Ok(Message::Binary(_))) => self.warn("this server takes no messages").await,
            Some(Ok(Message::Close(_)) | Err(_)) | None => Err(End::Left),
            Some(Ok(_)) => Ok(()),
        }
    }

    async fn subscribe(&mut self, subscriptions: Vec<Wanted>) -> Result<(), End> {
        for Wanted { id, channel_id } in subscriptions {
            let Some(channel) = self.channels.iter().find(|channel| channel.id == channel_id) else {
                self.warn(&format!("there is no channel {channel_id}")).await?;
                continue;
            };
            if self.heard.len() >= SUBSCRIPTIONS || self.heard.contains_key(&id) {
                self.warn(&format!("there is a subscription {id} already, or there are {SUBSCRIPTIONS}"))
                    .await?;
                continue;
            }
            let (axis, topic) = (channel.axis.clone(), channel.topic.0);
            let newest = self.hub.view(&axis, |view| view.live.back().map(|(t_ns, _)| *t_ns)).flatten();
            let told_ns = newest.unwrap_or(i64::MIN);
            self.heard.insert(id, Heard { axis: axis.clone(), topic, channel: channel_id, told_ns });
            if topic == STATUS.0 {
                self.tell_status(id, &axis).await?;
            }
        }
        Ok(())
    }

    async fn warn(&mut self, what: &str) -> Result<(), End> {
        self.send_text(&warning(what)).await
    }

    async fn tell_event(&mut self, event: &Publication, lost: u64) -> Result<(), End> {
        if lost > 0 {
            self.hub.update_sink(SINK, |sink| sink.dropped += lost);
            self.warn(&format!("{lost} events came faster than they were taken, and are left out")).await?;
        }
        let (topic, _, _) = recording::channel(event.kind);
        for id in self.ids(topic, Some(&event.axis)) {
            self.send(data(id, event.t_ns, &event.event_json)).await?;
        }
        Ok(())
    }

    /// Subscriptions to a topic, of an axis or of all.
    fn ids(&self, topic: &str, axis: Option<&str>) -> Vec<u32> {
        let is_meant = |heard: &Heard| heard.topic == topic && axis.is_none_or(|axis| heard.axis == axis);
        self.heard.iter().filter(|(_, heard)| is_meant(heard)).map(|(id, _)| *id).collect()
    }

    async fn tell_beat(&mut self, beat: u64) -> Result<(), End> {
        self.tell_command().await?;
        if beat.is_multiple_of(BEATS.0) {
            self.offer().await?;
            for id in self.ids(STATUS.0, None) {
                if let Some(axis) = self.heard.get(&id).map(|heard| heard.axis.clone()) {
                    self.tell_status(id, &axis).await?;
                }
            }
            self.tell_sent();
        }
        if beat.is_multiple_of(BEATS.1) {
            if clock::instant().duration_since(self.spoke_at) > self.patience.silence {
                return Err(End::Stalled);
            }
            self.deliver(Message::Ping(Vec::new().into())).await?;
        }
        Ok(())
    }

    /// The command since the last beat, the newest points of it.
    async fn tell_command(&mut self) -> Result<(), End> {
        for id in self.ids(SIGNALS.0, None) {
            let Some(heard) = self.heard.get_mut(&id) else { continue };
            let since_ns = heard.told_ns;
            let fresh = self.hub.view(&heard.axis, |view| {
                let fresh = view.live.iter().rev().take_while(|(t_ns, _)| *t_ns > since_ns).take(POINTS);
                fresh.copied().collect::<Vec<_>>()
            });
            let fresh = fresh.unwrap_or_default();
            heard.told_ns = fresh.first().map_or(since_ns, |(newest_ns, _)| *newest_ns);
            for (t_ns, command) in fresh.into_iter().rev() {
                self.send(data(id, t_ns, &format!("{{\"command\":{command}}}"))).await?;
            }
        }
        Ok(())
    }

    async fn tell_status(&mut self, id: u32, axis: &str) -> Result<(), End> {
        let Some(status) = self.hub.axis(axis) else { return Ok(()) };
        let time_ns = status.t_sample_ns.or_else(clock::wall_ns).unwrap_or(0);
        let json = serde_json::to_string(&status).unwrap_or_default();
        self.send(data(id, time_ns, &json)).await
    }

    async fn send_text(&mut self, message: &Value) -> Result<(), End> {
        self.deliver(Message::text(message.to_string())).await
    }

    async fn send(&mut self, frame: Vec<u8>) -> Result<(), End> {
        self.sent += 1;
        self.deliver(Message::binary(frame)).await
    }

    async fn deliver(&mut self, message: Message) -> Result<(), End> {
        match timeout(self.patience.message, self.socket.send(message)).await {
            Ok(Ok(())) => Ok(()),
            Ok(Err(_)) => Err(End::Left),
            Err(_) => Err(End::Stalled),
        }
    }

    fn tell_sent(&mut self) {
        let sent = std::mem::take(&mut self.sent);
        self.hub.update_sink(SINK, |sink| sink.sent += sent);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hub::AxisStatus;
    use tokio::sync::mpsc;
    use tokio_tungstenite::tungstenite::protocol::Role;

    /// A client with little room, who hears of `press`, and the hub that it is told by.
    async fn client(
        patience: Patience,
    ) -> (WebSocketStream<tokio::io::DuplexStream>, Arc<Hub>, tokio::task::JoinHandle<End>) {
        let hub = Hub::new("test".into());
        hub.add_axis(AxisStatus::new("press", 7e6), mpsc::channel(1).0);
        let (here, there) = tokio::io::duplex(8192);
        let server = WebSocketStream::from_raw_socket(here, Role::Server, None).await;
        let (keep, stop) = watch::channel(false);
        let of_hub = Arc::clone(&hub);
        let task = tokio::spawn(async move {
            let _keep = keep;
            Client::new(server, of_hub, patience).run(stop).await
        });
        (WebSocketStream::from_raw_socket(there, Role::Client, None).await, hub, task)
    }

    async fn text(socket: &mut WebSocketStream<tokio::io::DuplexStream>) -> Value {
        loop {
            if let Message::Text(text) = socket.next().await.unwrap().unwrap() {
                return serde_json::from_str(&text).unwrap();
            }
        }
    }

    #[tokio::test]
    async fn a_client_that_takes_nothing_is_ended() {
        let patience = Patience { message: Duration::from_millis(200), silence: Duration::from_secs(20) };
        let (mut socket, hub, task) = client(patience).await;
        assert_eq!(text(&mut socket).await["op"], "serverInfo");
        let offered = text(&mut socket).await;
        let ids: Vec<u64> =
            offered["channels"].as_array().unwrap().iter().filter_map(|one| one["id"].as_u64()).collect();
        assert_eq!(ids.len(), topics().count());
        let wanted: Vec<Value> =
            ids.iter().map(|id| serde_json::json!({ "id": id + 100, "channelId": id })).collect();
        let asked = serde_json::json!({ "op": "subscribe", "subscriptions": wanted });
        socket.send(Message::text(asked.to_string())).await.unwrap();
        // It asks for everything and reads nothing any more.
        for number in 0..40 {
            hub.publish_test("press", number);
            tokio::task::yield_now().await;
        }
        let end = timeout(Duration::from_secs(10), task).await.unwrap().unwrap();
        assert_eq!(end, End::Stalled);
    }

    #[tokio::test]
    async fn nonsense_is_answered_and_what_is_not_offered_is_not_heard() {
        let (mut socket, hub, _task) = client(PATIENCE).await;
        assert_eq!(text(&mut socket).await["sessionId"], "test");
        text(&mut socket).await;
        let nested = "[".repeat(50_000);
        for (said, told) in [
            ("{\"op\":\"subscribe\"}", "no message"),
            (nested.as_str(), "no message"),
            ("{\"op\":\"subscribe\",\"subscriptions\":[{\"id\":1,\"channelId\":99}]}", "no channel 99"),
            ("{\"op\":\"setParameters\",\"parameters\":[]}", "nothing else"),
        ] {
            socket.send(Message::text(said.to_owned())).await.unwrap();
            let answer = text(&mut socket).await;
            assert_eq!(answer["op"], "status");
            assert!(answer["message"].as_str().unwrap().contains(told), "{answer}");
        }
        // An axis that goes is taken back.
        hub.remove_axis("press");
        let taken_back = text(&mut socket).await;
        assert_eq!(
            (&taken_back["op"], taken_back["channelIds"].as_array().unwrap().len()),
            (&"unadvertise".into(), topics().count())
        );
    }
}

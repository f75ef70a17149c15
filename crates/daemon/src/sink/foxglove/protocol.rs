//! What goes over the wire: the server's messages, and those of clients that it heeds.

use serde::Deserialize;
use serde_json::{Value, json};

use crate::hub::Kind;
use crate::sink::mcap::schema;
use crate::sink::recording;

/// A topic of each axis: the end of its name, its schema's name, and its schema.
pub(super) type Topic = (&'static str, &'static str, &'static str);

/// The command lately.
pub(super) const SIGNALS: Topic = ("signals", "seepd.Signals", schema::SIGNALS);
/// What is true now.
pub(super) const STATUS: Topic = ("status", "seepd.status/1", STATUS_SCHEMA);

/// `seepd.status/1`, less what nobody draws; docs/live.md has all of it.
const STATUS_SCHEMA: &str = r#"{"title":"seepd.status/1","type":"object","properties":{"axis":{"type":"string"},"flag":{"type":"string"},"verdict":{"type":"string"},"to_do":{"type":"string"},"reason":{"type":["string","null"]},"level":{"type":"string"},"latched":{"type":["string","null"]},"acknowledged":{"type":"boolean"},"stale":{"type":"boolean"},"leak_area_m2":{"type":["number","null"]},"interval90_m2":{"type":["array","null"],"items":{"type":"number"}},"leak_flow_lpm":{"type":["number","null"]},"leak_power_w":{"type":["number","null"]},"time_to_leak_s":{"type":["number","null"]},"condition":{"type":["string","null"]},"cycle":{"type":["integer","null"]},"cycles":{"type":"integer"}},"required":["axis","flag","verdict","to_do","latched","acknowledged","stale","leak_area_m2","interval90_m2","leak_flow_lpm","time_to_leak_s","condition","cycles"]}"#;

/// All topics of an axis.
pub(super) fn topics() -> impl Iterator<Item = Topic> {
    let kinds = [Kind::Cycle, Kind::Flag, Kind::Notice, Kind::Acknowledged, Kind::Test];
    [SIGNALS, STATUS].into_iter().chain(kinds.map(recording::channel))
}

/// A client's message.
#[derive(Debug, Deserialize)]
#[serde(tag = "op", rename_all = "camelCase", rename_all_fields = "camelCase")]
pub(super) enum Asked {
    /// It wants to hear channels.
    Subscribe {
        /// Which.
        subscriptions: Vec<Wanted>,
    },
    /// It wants to hear some no more.
    Unsubscribe {
        /// Its own numbers of them.
        subscription_ids: Vec<u32>,
    },
    /// Something that this server has not offered.
    #[serde(other)]
    Other,
}

/// A channel that a client wants to hear.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Wanted {
    /// The client's number for it.
    pub(super) id: u32,
    /// The server's.
    pub(super) channel_id: u32,
}

/// The first message.
pub(super) fn server_info(run: &str) -> Value {
    json!({ "op": "serverInfo", "name": concat!("seepd ", env!("CARGO_PKG_VERSION")), "capabilities": [], "sessionId": run })
}

/// Offers channels by their numbers.
pub(super) fn advertise<'c>(channels: impl Iterator<Item = (u32, &'c str, Topic)>) -> Value {
    let channels: Vec<Value> = channels
        .map(|(id, axis, (topic, schema_name, schema))| {
            json!({
                "id": id, "topic": format!("/{axis}/{topic}"), "encoding": "json", "schemaName": schema_name, "schema": schema,
                "schemaEncoding": "jsonschema",
            })
        })
        .collect();
    json!({ "op": "advertise", "channels": channels })
}

/// Takes channels back.
pub(super) fn unadvertise(ids: &[u32]) -> Value {
    json!({ "op": "unadvertise", "channelIds": ids })
}

/// A remark that Foxglove shows among its problems.
pub(super) fn warning(message: &str) -> Value {
    json!({ "op": "status", "level": 1, "message": message })
}

/// A message of a subscription, at a time in ns.
pub(super) fn data(subscription: u32, time_ns: i64, message: &str) -> Vec<u8> {
    let mut frame = Vec::with_capacity(13 + message.len());
    frame.push(1);
    frame.extend(subscription.to_le_bytes());
    frame.extend(time_ns.max(0).to_le_bytes());
    frame.extend(message.as_bytes());
    frame
}

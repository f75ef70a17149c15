//! What happens once: an event as it is sent, and the way to whoever hears it.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use seepd_monitor::event::Flag;
use serde::Serialize;
use tokio::sync::mpsc::error::TrySendError;
use tokio::sync::{mpsc, watch};

/// What a publication tells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A cycle: `seepd.cycle/1`.
    Cycle,
    /// A change of flag: `seepd.event/1`.
    Flag,
    /// Something else that a person should know: `seepd.notice/1`.
    Notice,
    /// Somebody took note: `seepd.acknowledged/1`.
    Acknowledged,
    /// A test: `seepd.test/1`.
    Test,
}

impl Kind {
    /// Its name in topics and streams.
    pub const fn name(self) -> &'static str {
        match self {
            Kind::Cycle => "cycle",
            Kind::Flag => "flag",
            Kind::Notice => "notice",
            Kind::Acknowledged => "acknowledged",
            Kind::Test => "test",
        }
    }
}

/// An event as it is sent.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Publication {
    /// Kind.
    pub kind: Kind,
    /// Axis.
    pub axis: String,
    /// Its time on the line, ns.
    pub t_ns: i64,
    /// The event with `id` and `published_at`, JSON.
    pub json: String,
    /// The event alone, as a replay writes it, JSON.
    pub event_json: String,
}

/// An event with what makes a repeat recognisable.
#[derive(Serialize)]
pub(super) struct Envelope<'a, E: Serialize> {
    #[serde(flatten)]
    pub(super) event: &'a E,
    /// The same in each repeat of a message, and in no other message.
    pub(super) id: String,
    /// Wall-clock time; null where the clock was never set.
    pub(super) published_at: Option<String>,
}

/// `seepd.acknowledged/1`.
#[derive(Serialize)]
pub(super) struct Acknowledged<'a> {
    pub(super) schema: &'static str,
    pub(super) axis: &'a str,
    pub(super) latched: Option<Flag>,
    pub(super) t_ns: i64,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) who: Option<&'a str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) note: Option<&'a str>,
}

/// `seepd.test/1`: a marked test alarm.
#[derive(Serialize)]
pub(super) struct TestAlarm<'a> {
    pub(super) schema: &'static str,
    pub(super) axis: &'a str,
    pub(super) test: bool,
    pub(super) flag_from: Flag,
    pub(super) flag_to: Flag,
    pub(super) message: &'static str,
}

/// Events on their way to one that hears them.
pub struct Subscription {
    pub(super) events: mpsc::Receiver<Arc<Publication>>,
    pub(super) lost: Arc<AtomicU64>,
    /// How many of them are where they outlive the program; heeded of one that has subscribed to keep them.
    pub(super) kept: watch::Sender<u64>,
}

impl Subscription {
    /// The next event. May be dropped while it waits.
    pub async fn recv(&mut self) -> Option<Arc<Publication>> {
        self.events.recv().await
    }

    /// The next event, if it is there.
    pub fn try_recv(&mut self) -> Option<Arc<Publication>> {
        self.events.try_recv().ok()
    }

    /// Events that found no room since this was last asked.
    pub fn lost(&self) -> u64 {
        self.lost.swap(0, Ordering::Relaxed)
    }

    /// Says that another event is where it outlives the program, or never will be.
    pub fn has_kept_one(&self) {
        self.kept.send_modify(|kept| *kept += 1);
    }
}

/// The hub's end of a [`Subscription`].
pub(super) struct Subscriber {
    pub(super) events: mpsc::Sender<Arc<Publication>>,
    pub(super) lost: Arc<AtomicU64>,
    /// Of one that keeps events: how many it was handed, and how many it has kept.
    pub(super) keeps: Option<(u64, watch::Receiver<u64>)>,
}

impl Subscriber {
    /// Hands an event on, or counts it: who publishes waits for nobody. `false` where nobody hears any more.
    pub(super) fn hand(&mut self, publication: &Arc<Publication>) -> bool {
        match self.events.try_send(Arc::clone(publication)) {
            Ok(()) => {
                if let Some((handed, _)) = &mut self.keeps {
                    *handed += 1;
                }
                true
            }
            Err(TrySendError::Full(_)) => {
                self.lost.fetch_add(1, Ordering::Relaxed);
                true
            }
            Err(TrySendError::Closed(_)) => false,
        }
    }
}

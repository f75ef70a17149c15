//! What the axes tell and the sinks hear: the newest condition of everything, and each event once.

mod course;
mod order;
mod publication;
mod status;

use std::collections::{BTreeMap, VecDeque};
use std::sync::atomic::AtomicU64;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use seepd_monitor::event::{Event, Flag, FlagEvent};
use serde::Serialize;
use tokio::sync::mpsc::error::TrySendError;
use tokio::sync::{mpsc, watch};

use crate::clock;

pub use course::{Course, HealthyCourse, PhaseSpan};
pub use order::{NewRepair, NotTaken, Order, Signature};
use publication::{Acknowledged, Envelope, Subscriber, TestAlarm};
pub use publication::{Kind, Publication, Subscription};
#[cfg(test)]
pub(crate) use status::condition_for_tests;
pub use status::{
    Acknowledgement, AxisStatus, AxisView, BaselineStatus, DutyCycleStatus, LIVE_POINTS, REPAIRS_TOLD,
    RelativeStatus, SinkStatus, SourceHealth, SourceState, Thresholds, TrendPoint,
};

/// Events other than cycles that are kept for who asks later, also over restarts.
pub const HISTORY: usize = 200;

struct KnownAxis {
    status: AxisStatus,
    view: AxisView,
    orders: mpsc::Sender<Order>,
}

#[derive(Default)]
struct Inner {
    axes: BTreeMap<String, KnownAxis>,
    sinks: BTreeMap<String, SinkStatus>,
    subscribers: Vec<Subscriber>,
    /// Subscriptions whose holder is being replaced.
    parked: BTreeMap<String, Subscription>,
    /// Each as it was sent, JSON.
    history: VecDeque<Arc<str>>,
    published: u64,
}

/// See the [module](self).
pub struct Hub {
    inner: Mutex<Inner>,
    /// Names this run in the events' identifiers.
    run: String,
    /// Raised whenever a condition may have changed.
    changed: watch::Sender<u64>,
}

impl Hub {
    /// An empty one; `run` names this run of the daemon.
    pub fn new(run: String) -> Arc<Self> {
        Arc::new(Hub { inner: Mutex::default(), run, changed: watch::Sender::new(0) })
    }

    // Nothing panics while it holds the lock; if something did, the data are still whole.
    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Name of this run.
    pub fn run(&self) -> &str {
        &self.run
    }

    /// Adds an axis, or takes its new connection for orders; an axis that was there keeps its trend.
    pub fn add_axis(&self, status: AxisStatus, orders: mpsc::Sender<Order>) {
        let mut inner = self.lock();
        let view = inner.axes.remove(&status.axis).map(|axis| axis.view).unwrap_or_default();
        inner.axes.insert(status.axis.clone(), KnownAxis { status, view, orders });
    }

    /// Removes an axis.
    pub fn remove_axis(&self, name: &str) {
        self.lock().axes.remove(name);
    }

    /// Changes an axis's condition and view.
    pub fn update_axis(&self, name: &str, change: impl FnOnce(&mut AxisStatus, &mut AxisView)) {
        if let Some(axis) = self.lock().axes.get_mut(name) {
            change(&mut axis.status, &mut axis.view);
        }
        self.changed.send_modify(|count| *count += 1);
    }

    /// Changes a sink's condition.
    pub fn update_sink(&self, key: &str, change: impl FnOnce(&mut SinkStatus)) {
        let mut inner = self.lock();
        change(inner.sinks.entry(key.to_owned()).or_insert_with(|| SinkStatus::new(key)));
    }

    /// Removes a sink.
    pub fn remove_sink(&self, key: &str) {
        self.lock().sinks.remove(key);
    }

    /// Conditions of all axes.
    pub fn axes(&self) -> Vec<AxisStatus> {
        self.lock().axes.values().map(|axis| axis.status.clone()).collect()
    }

    /// Condition of an axis.
    pub fn axis(&self, name: &str) -> Option<AxisStatus> {
        self.lock().axes.get(name).map(|axis| axis.status.clone())
    }

    /// Something of an axis's view.
    pub fn view<T>(&self, name: &str, look: impl FnOnce(&AxisView) -> T) -> Option<T> {
        self.lock().axes.get(name).map(|axis| look(&axis.view))
    }

    /// Something of the views of all axes, by name.
    pub fn views<T>(&self, look: impl Fn(&AxisView) -> T) -> BTreeMap<String, T> {
        self.lock().axes.iter().map(|(name, axis)| (name.clone(), look(&axis.view))).collect()
    }

    /// Conditions of all sinks.
    pub fn sinks(&self) -> Vec<SinkStatus> {
        self.lock().sinks.values().cloned().collect()
    }

    /// Asks an axis for something.
    ///
    /// # Errors
    /// The axis cannot take it, and why.
    pub fn order(&self, axis: &str, order: Order) -> Result<(), NotTaken> {
        let inner = self.lock();
        let Some(known) = inner.axes.get(axis) else {
            return Err(NotTaken::NoAxis { axis: axis.into(), axes: inner.axes.keys().cloned().collect() });
        };
        known.orders.try_send(order).map_err(|error| match error {
            TrySendError::Full(_) => NotTaken::Busy { axis: axis.into() },
            TrySendError::Closed(_) => {
                let why = known.status.source.detail.clone();
                let why = why.unwrap_or_else(|| "its log has ended".into());
                NotTaken::NotRunning { axis: axis.into(), why }
            }
        })
    }

    /// Tells of changes of condition.
    pub fn changes(&self) -> watch::Receiver<u64> {
        self.changed.subscribe()
    }

    /// Every event from now on; those that find so many before them are lost and counted.
    pub fn subscribe(&self, most: usize) -> Subscription {
        self.subscribe_as(most, false)
    }

    /// The same for one that puts each event where it outlives the program, and says so by [`Subscription::has_kept_one`]. Where one
    /// of this name has parked its subscription, the new one begins with the first event that the other has not heard.
    pub fn subscribe_to_keep(&self, name: &str, most: usize) -> Subscription {
        let parked = self.lock().parked.remove(name);
        parked.unwrap_or_else(|| self.subscribe_as(most, true))
    }

    /// Leaves a subscription to the next of its name, whom a reload is about to start.
    pub fn park(&self, name: &str, subscription: Subscription) {
        self.lock().parked.insert(name.to_owned(), subscription);
    }

    /// Ends the subscriptions that nobody has taken up.
    pub fn end_parked(&self) {
        let parked = std::mem::take(&mut self.lock().parked);
        drop(parked);
    }

    fn subscribe_as(&self, most: usize, keeps: bool) -> Subscription {
        let (sender, events) = mpsc::channel(most);
        let lost = Arc::new(AtomicU64::new(0));
        let kept = watch::Sender::new(0);
        let keeps = keeps.then(|| (0, kept.subscribe()));
        self.lock().subscribers.push(Subscriber { events: sender, lost: Arc::clone(&lost), keeps });
        Subscription { events, lost, kept }
    }

    /// Waits until everything that has been published is kept by those who keep events, but no longer than so long; whether it is.
    pub async fn all_kept(&self, limit: Duration) -> bool {
        let keeping: Vec<_> =
            self.lock().subscribers.iter().filter_map(|subscriber| subscriber.keeps.clone()).collect();
        let all = async {
            for (handed, mut kept) in keeping {
                // An error says that this one has ended and keeps no more.
                let _ = kept.wait_for(|kept| *kept >= handed).await;
            }
        };
        tokio::time::timeout(limit, all).await.is_ok()
    }

    /// The last events that are no cycles, oldest first, as they were sent: JSON.
    pub fn history(&self) -> Vec<Arc<str>> {
        self.lock().history.iter().cloned().collect()
    }

    /// Takes up what an earlier run has told, oldest first.
    pub fn recall(&self, told: impl IntoIterator<Item = String>) {
        let mut inner = self.lock();
        told.into_iter().for_each(|event| inner.remember(&event));
    }

    /// Publishes an event of the pipeline.
    pub fn publish_event(&self, event: &Event<'_>) {
        match event {
            Event::Cycle(line) => self.publish(Kind::Cycle, line.axis, line.t_end_ns(), line),
            Event::Flag(flag) => self.publish(Kind::Flag, flag.axis, flag.t_ns, flag as &FlagEvent<'_>),
            Event::Notice(notice) => self.publish(Kind::Notice, notice.axis, notice.t_ns, notice),
        }
    }

    /// Publishes that somebody took note.
    pub fn publish_acknowledged(&self, axis: &str, latched: Option<Flag>, by: &Acknowledgement) {
        let (t_ns, who, note) = (by.t_ns, by.who.as_deref(), by.note.as_deref());
        let event = Acknowledged { schema: "seepd.acknowledged/1", axis, latched, t_ns, who, note };
        self.publish(Kind::Acknowledged, axis, t_ns, &event);
    }

    /// Publishes a marked test alarm.
    pub fn publish_test(&self, axis: &str, t_ns: i64) {
        let event = TestAlarm {
            schema: "seepd.test/1",
            axis,
            test: true,
            flag_from: Flag::Healthy,
            flag_to: Flag::Severe,
            message: "a test of the sinks; nothing leaks",
        };
        self.publish(Kind::Test, axis, t_ns, &event);
    }

    fn publish(&self, kind: Kind, axis: &str, t_ns: i64, event: &impl Serialize) {
        let mut inner = self.lock();
        inner.published += 1;
        let id = format!("{}-{}", self.run, inner.published);
        let envelope = Envelope { event, id, published_at: clock::wall_text() };
        // Numbers and texts: turning them into JSON cannot fail.
        let json = serde_json::to_string(&envelope).unwrap_or_default();
        let event_json = serde_json::to_string(event).unwrap_or_default();
        let publication = Arc::new(Publication { kind, axis: axis.to_owned(), t_ns, json, event_json });
        inner.subscribers.retain_mut(|subscriber| subscriber.hand(&publication));
        if kind != Kind::Cycle {
            inner.remember(&publication.json);
        }
    }
}

impl Inner {
    fn remember(&mut self, event: &str) {
        if self.history.len() >= HISTORY {
            self.history.pop_front();
        }
        self.history.push_back(event.into());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_does_not_keep_up_loses_the_newest_and_learns_how_many() {
        let hub = Hub::new("test".into());
        let mut slow = hub.subscribe(2);
        for t_ns in 0..5 {
            hub.publish_test("press", t_ns);
        }
        let heard: Vec<i64> = std::iter::from_fn(|| slow.try_recv()).map(|event| event.t_ns).collect();
        assert_eq!((heard, slow.lost(), slow.lost()), (vec![0, 1], 3, 0));
        hub.publish_test("press", 5);
        assert_eq!(slow.try_recv().map(|event| event.t_ns), Some(5));
        drop(slow);
        hub.publish_test("press", 6);
        assert!(hub.lock().subscribers.is_empty());
    }

    #[tokio::test]
    async fn what_is_kept_is_waited_for_and_not_for_ever() {
        let hub = Hub::new("test".into());
        let (for_ever, a_while) = (Duration::from_secs(3600), Duration::from_millis(50));
        hub.publish_test("press", 0);
        // Nobody keeps anything, and who only listens is not waited for.
        let _listener = hub.subscribe(8);
        let mut keeper = hub.subscribe_to_keep("mqtt", 8);
        hub.publish_test("press", 1);
        keeper.recv().await.unwrap();
        keeper.has_kept_one();
        assert!(hub.all_kept(for_ever).await);
        // One that does not get on with it costs the limit, one that has ended nothing.
        hub.publish_test("press", 2);
        let begin = clock::instant();
        assert!(!hub.all_kept(a_while).await);
        assert!(clock::instant() - begin >= a_while);
        drop(keeper);
        assert!(hub.all_kept(for_ever).await);
    }

    #[test]
    fn one_that_is_replaced_leaves_what_it_has_not_heard_to_the_next() {
        let hub = Hub::new("test".into());
        let first = hub.subscribe_to_keep("mqtt", 8);
        hub.park("mqtt", first);
        hub.publish_test("press", 1);
        let mut second = hub.subscribe_to_keep("mqtt", 8);
        hub.publish_test("press", 2);
        assert_eq!([second.try_recv(), second.try_recv()].map(|event| event.unwrap().t_ns), [1, 2]);
        hub.park("mqtt", second);
        hub.end_parked();
        hub.publish_test("press", 3);
        assert!(hub.lock().subscribers.is_empty());
    }

    #[test]
    fn the_last_events_are_remembered_but_no_cycles() {
        let hub = Hub::new("test".into());
        hub.recall(["an older one".to_owned()]);
        assert_eq!(hub.history(), ["an older one".into()]);
        for number in 0..HISTORY + 10 {
            hub.publish_test(&format!("press {number}"), 0);
            hub.publish(Kind::Cycle, "cycle", 0, &number);
        }
        let history = hub.history();
        assert_eq!(history.len(), HISTORY);
        let is_of = |event: &str, number: usize| event.contains(&format!("\"axis\":\"press {number}\""));
        assert!(history.iter().zip(10..).all(|(event, number)| is_of(event, number)));
    }

    #[test]
    fn an_order_that_is_not_taken_says_what_is_true() {
        let hub = Hub::new("test".into());
        let (orders, mut taken) = mpsc::channel(1);
        hub.add_axis(AxisStatus::new("busy", 7e6), orders);
        let mut unusable = AxisStatus::new("unusable", 7e6);
        unusable.source.detail = Some("model.json: No such file".into());
        hub.add_axis(unusable, mpsc::channel(1).0);
        let told = |axis: &str| {
            hub.order(axis, Order::Acknowledge(Signature::default()))
                .map_err(|not_taken| not_taken.to_string())
        };
        assert_eq!(told("busy"), Ok(()));
        assert_eq!(
            told("busy"),
            Err("the axis busy has not carried out its last orders yet; try again".into())
        );
        assert_eq!(told("other"), Err("there is no axis other; the axes are busy, unusable".into()));
        assert_eq!(told("unusable"), Err("the axis unusable does not run: model.json: No such file".into()));
        assert!(matches!(taken.try_recv(), Ok(Order::Acknowledge(_))));
        assert_eq!(told("busy"), Ok(()));
        drop(taken);
        assert_eq!(told("busy"), Err("the axis busy does not run: its log has ended".into()));
    }
}

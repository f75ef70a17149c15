//! What the axes tell and the sinks hear: the newest condition of everything, and each event once.

use std::collections::{BTreeMap, VecDeque};
use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use serde::{Deserialize, Serialize};
use tokio::sync::mpsc::error::TrySendError;
use tokio::sync::{mpsc, watch};

use crate::live::clock;
use crate::live::source::SourceHealth;
use seepd_monitor::baseline::CusumFinding;
use seepd_monitor::energy::Loss;
use seepd_monitor::event::{Event, Flag, FlagEvent};
use seepd_monitor::pipeline::Monitor;

/// Cycles whose course is kept for the dashboard.
const COURSES: usize = 6;
/// Estimates kept for the trend; when there are as many, every second one goes.
const TREND: usize = 2000;
/// Events other than cycles that are kept for who asks later.
const HISTORY: usize = 50;
/// Points of the live command that are kept.
pub const LIVE_POINTS: usize = 1500;

/// An axis's condition: `seepd.status/1`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AxisStatus {
    /// `seepd.status/1`.
    pub schema: &'static str,
    /// Name.
    pub axis: String,
    /// Condition now.
    pub flag: Flag,
    /// Why there is no estimate.
    pub reason: Option<&'static str>,
    /// The leak's level, kept while there is no estimate.
    pub level: Flag,
    /// The highest flag since it was last acknowledged.
    pub latched: Option<Flag>,
    /// Whether somebody has taken note of it.
    pub acknowledged: bool,
    /// Whether the input has gone.
    pub stale: bool,
    /// Last estimate, m².
    pub leak_area_m2: Option<f64>,
    /// Interval that holds the truth nine times in ten, m².
    pub interval90_m2: Option<[f64; 2]>,
    /// Last estimate as a flow at the reference pressure difference, L/min.
    pub leak_flow_lpm: Option<f64>,
    /// Reference pressure difference, Pa.
    pub reference_dp_pa: f64,
    /// Flow of 1 m² at that difference, L/min.
    pub lpm_per_m2: f64,
    /// What it costs; its fields are absent where there is no estimate.
    #[serde(flatten)]
    pub loss: Option<Loss>,
    /// Projected time until the flag `leak`, s; null where nothing is projected.
    pub time_to_leak_s: Option<f64>,
    /// The shortest and the longest that the points so far admit, s.
    pub time_to_leak_range_s: Option<[f64; 2]>,
    /// What estimates are relative to; of several duty cycles, that of the last cycle's.
    pub baseline: BaselineStatus,
    /// The duty cycles, where there are several.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub duty_cycles: Vec<DutyCycleStatus>,
    /// What the sums over cycles say against the baseline.
    pub finding: CusumFinding,
    /// Number of the last cycle.
    pub cycle: Option<u64>,
    /// End of the last cycle, ns on the daemon's line of time.
    pub t_last_cycle_ns: Option<i64>,
    /// From the sample that closed the last cycle to its publication, s; the segmenter's look-ahead is not in it. None where a log is read as
    /// fast as can be, whose times are its own.
    pub publication_delay_s: Option<f64>,
    /// Cycles with an estimate.
    pub cycles: u64,
    /// Cycles without one, by reason.
    pub rejected: BTreeMap<&'static str, u64>,
    /// Samples left out or filled in, by reason.
    pub samples_rejected: BTreeMap<&'static str, u64>,
    /// The input.
    pub source: SourceHealth,
}

impl AxisStatus {
    /// An axis of which nothing is known yet.
    pub fn new(axis: &str, reference_dp_pa: f64) -> Self {
        AxisStatus {
            schema: "seepd.status/1",
            axis: axis.into(),
            flag: Flag::NoEstimate,
            reason: Some("no_cycle_yet"),
            level: Flag::Healthy,
            latched: None,
            acknowledged: false,
            stale: false,
            leak_area_m2: None,
            interval90_m2: None,
            leak_flow_lpm: None,
            reference_dp_pa,
            lpm_per_m2: 0.0,
            loss: None,
            time_to_leak_s: None,
            time_to_leak_range_s: None,
            baseline: BaselineStatus::default(),
            duty_cycles: Vec::new(),
            finding: CusumFinding::None,
            cycle: None,
            t_last_cycle_ns: None,
            publication_delay_s: None,
            cycles: 0,
            rejected: BTreeMap::new(),
            samples_rejected: BTreeMap::new(),
            source: SourceHealth::default(),
        }
    }
}

/// One of an axis's several duty cycles.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DutyCycleStatus {
    /// Name.
    pub name: String,
    /// Cycles with an estimate.
    pub cycles: u64,
    /// Its baseline.
    pub baseline: BaselineStatus,
}

impl DutyCycleStatus {
    /// What a monitor is at; nothing for the only one of an axis.
    pub fn of(monitor: &Monitor) -> Option<Self> {
        let name = monitor.name()?.to_owned();
        Some(DutyCycleStatus { name, cycles: monitor.cycles(), baseline: BaselineStatus::of(monitor) })
    }
}

/// What a duty cycle's estimates are relative to.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct BaselineStatus {
    /// Cycles of the baseline in force; null where there is none.
    pub learned_cycles: Option<usize>,
    /// What it was learned for.
    pub occasion: Option<String>,
    /// Where one is being learned: cycles so far, and cycles that are wanted.
    pub learning: Option<[usize; 2]>,
}

impl BaselineStatus {
    /// What a duty cycle's monitor is at.
    pub fn of(monitor: &Monitor) -> Self {
        BaselineStatus {
            learned_cycles: monitor.baseline().map(|baseline| baseline.cycles),
            occasion: monitor.baseline().map(|baseline| baseline.occasion.clone()),
            learning: monitor.learner().map(|learner| [learner.cycles(), learner.wanted()]),
        }
    }
}

/// A point of the leak's trend.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TrendPoint {
    /// End of the cycle, ns on the daemon's line of time.
    pub t_ns: i64,
    /// Estimate, m².
    pub leak_area_m2: f64,
    /// Its interval, m².
    pub interval90_m2: [f64; 2],
    /// The same as a flow, L/min.
    pub leak_flow_lpm: f64,
    /// Condition after the cycle.
    pub flag: Flag,
}

/// The command's course over a cycle.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Course {
    /// Number of the cycle.
    pub cycle: u64,
    /// Condition after it.
    pub flag: Flag,
    /// Why it was rejected.
    pub reason: Option<&'static str>,
    /// Estimate as a flow, L/min.
    pub leak_flow_lpm: Option<f64>,
    /// Time from the cycle's start (s) and mean command over the 20 ms around it (share of full command).
    pub points: Vec<(f32, f32)>,
}

/// What the dashboard draws of an axis.
#[derive(Debug, Clone, Default)]
pub struct AxisView {
    /// Leak by cycle.
    pub trend: VecDeque<TrendPoint>,
    /// The last cycles.
    pub courses: VecDeque<Course>,
    /// The command lately: time on the line (ns), mean over 20 ms.
    pub live: VecDeque<(i64, f32)>,
}

impl AxisView {
    /// Adds an estimate; a full trend loses every second one.
    pub fn add_trend(&mut self, point: TrendPoint) {
        if self.trend.len() >= TREND {
            let mut keep = false;
            self.trend.retain(|_| {
                keep = !keep;
                keep
            });
        }
        self.trend.push_back(point);
    }

    /// Adds a cycle's course.
    pub fn add_course(&mut self, course: Course) {
        if self.courses.len() >= COURSES {
            self.courses.pop_front();
        }
        self.courses.push_back(course);
    }
}

/// How a sink is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct SinkStatus {
    /// What it is and where.
    pub name: String,
    /// Whether it works.
    pub good: bool,
    /// What it is doing, or why it does not work.
    pub detail: String,
    /// Events or frames that went out.
    pub sent: u64,
    /// Events that wait.
    pub waiting: u64,
    /// Events, samples or frames that were given up.
    pub dropped: u64,
}

impl SinkStatus {
    /// A sink that has just been started.
    pub fn new(name: impl Into<String>) -> Self {
        SinkStatus {
            name: name.into(),
            good: true,
            detail: "starting".into(),
            sent: 0,
            waiting: 0,
            dropped: 0,
        }
    }
}

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
struct Envelope<'a, E: Serialize> {
    #[serde(flatten)]
    event: &'a E,
    /// The same in each repeat of a message, and in no other message.
    id: String,
    /// Wall-clock time; null where the clock was never set.
    published_at: Option<String>,
}

/// `seepd.acknowledged/1`.
#[derive(Serialize)]
struct Acknowledged<'a> {
    schema: &'static str,
    axis: &'a str,
    latched: Option<Flag>,
    t_ns: i64,
}

/// `seepd.test/1`: a marked test alarm.
#[derive(Serialize)]
struct TestAlarm<'a> {
    schema: &'static str,
    axis: &'a str,
    test: bool,
    flag_from: Flag,
    flag_to: Flag,
    message: &'static str,
}

struct KnownAxis {
    status: AxisStatus,
    view: AxisView,
    orders: mpsc::Sender<Order>,
}

/// What an axis is asked for.
#[derive(Debug)]
pub enum Order {
    /// Take note of the latched flag.
    Acknowledge,
    /// Learn a new baseline from the next cycles: the seal has been replaced.
    Renew,
}

/// Why an order was not taken.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum NotTaken {
    /// There is no axis of that name.
    NoAxis {
        /// The name.
        axis: String,
        /// Those that there are.
        axes: Vec<String>,
    },
    /// The axis could not be started, or its log has ended.
    NotRunning {
        /// Name.
        axis: String,
        /// What keeps it.
        why: String,
    },
    /// As many orders as are kept for it wait already.
    Busy {
        /// Name.
        axis: String,
    },
}

impl fmt::Display for NotTaken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            NotTaken::NoAxis { axis, axes } => {
                write!(f, "there is no axis {axis}; the axes are {}", axes.join(", "))
            }
            NotTaken::NotRunning { axis, why } => write!(f, "the axis {axis} does not run: {why}"),
            NotTaken::Busy { axis } => {
                write!(f, "the axis {axis} has not carried out its last orders yet; try again")
            }
        }
    }
}

/// Events on their way to one that hears them.
pub struct Subscription {
    events: mpsc::Receiver<Arc<Publication>>,
    lost: Arc<AtomicU64>,
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
}

/// The hub's end of a [`Subscription`].
struct Subscriber {
    events: mpsc::Sender<Arc<Publication>>,
    lost: Arc<AtomicU64>,
}

impl Subscriber {
    /// Hands an event on, or counts it: who publishes waits for nobody. `false` where nobody hears any more.
    fn hand(&self, publication: &Arc<Publication>) -> bool {
        match self.events.try_send(Arc::clone(publication)) {
            Ok(()) => true,
            Err(TrySendError::Full(_)) => {
                self.lost.fetch_add(1, Ordering::Relaxed);
                true
            }
            Err(TrySendError::Closed(_)) => false,
        }
    }
}

#[derive(Default)]
struct Inner {
    axes: BTreeMap<String, KnownAxis>,
    sinks: BTreeMap<String, SinkStatus>,
    subscribers: Vec<Subscriber>,
    history: VecDeque<Arc<Publication>>,
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

    /// Trends of all axes by name.
    pub fn trends(&self) -> BTreeMap<String, Vec<TrendPoint>> {
        let trend = |axis: &KnownAxis| axis.view.trend.iter().copied().collect();
        self.lock().axes.iter().map(|(name, axis)| (name.clone(), trend(axis))).collect()
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
        let (sender, events) = mpsc::channel(most);
        let lost = Arc::new(AtomicU64::new(0));
        self.lock().subscribers.push(Subscriber { events: sender, lost: Arc::clone(&lost) });
        Subscription { events, lost }
    }

    /// The last events that are no cycles, oldest first.
    pub fn history(&self) -> Vec<Arc<Publication>> {
        self.lock().history.iter().cloned().collect()
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
    pub fn publish_acknowledged(&self, axis: &str, latched: Option<Flag>, t_ns: i64) {
        let event = Acknowledged { schema: "seepd.acknowledged/1", axis, latched, t_ns };
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
        inner.subscribers.retain(|subscriber| subscriber.hand(&publication));
        if kind != Kind::Cycle {
            if inner.history.len() >= HISTORY {
                inner.history.pop_front();
            }
            inner.history.push_back(publication);
        }
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

    #[test]
    fn the_last_events_are_remembered_but_no_cycles() {
        let hub = Hub::new("test".into());
        for t_ns in 0..60 {
            hub.publish_test("press", t_ns);
            hub.publish(Kind::Cycle, "press", t_ns, &t_ns);
        }
        let history = hub.history();
        assert_eq!((history.len(), history[0].t_ns, history[HISTORY - 1].t_ns), (HISTORY, 10, 59));
        assert!(history.iter().all(|event| event.kind == Kind::Test));
    }

    #[test]
    fn an_order_that_is_not_taken_says_what_is_true() {
        let hub = Hub::new("test".into());
        let (orders, mut taken) = mpsc::channel(1);
        hub.add_axis(AxisStatus::new("busy", 7e6), orders);
        let mut unusable = AxisStatus::new("unusable", 7e6);
        unusable.source.detail = Some("model.json: No such file".into());
        hub.add_axis(unusable, mpsc::channel(1).0);
        let told =
            |axis: &str| hub.order(axis, Order::Acknowledge).map_err(|not_taken| not_taken.to_string());
        assert_eq!(told("busy"), Ok(()));
        assert_eq!(
            told("busy"),
            Err("the axis busy has not carried out its last orders yet; try again".into())
        );
        assert_eq!(told("other"), Err("there is no axis other; the axes are busy, unusable".into()));
        assert_eq!(told("unusable"), Err("the axis unusable does not run: model.json: No such file".into()));
        assert!(matches!(taken.try_recv(), Ok(Order::Acknowledge)));
        assert_eq!(told("busy"), Ok(()));
        drop(taken);
        assert_eq!(told("busy"), Err("the axis busy does not run: its log has ended".into()));
    }
}

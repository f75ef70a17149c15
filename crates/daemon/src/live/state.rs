//! What outlives the daemon: each axis's alarm and latch, in one small file.
//!
//! The file is written whole, made durable and put in the old one's place, so that a power cut leaves the old one or the
//! new one. One that cannot be read is set aside under another name, and told of.

use std::collections::BTreeMap;
use std::fs::{self, File, TryLockError};
use std::io::{self, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use seepd_monitor::alarm::{AlarmState, Latch};
use seepd_monitor::baseline::Cusum;
use seepd_monitor::cause::course::CourseState;
use seepd_monitor::relative::charts::Sums;
use seepd_monitor::repair::{Aftercare, Repaired};
use seepd_settings::side_file;
use serde::{Deserialize, Serialize};
use serde_json::value::RawValue;
use tokio::sync::watch;

use crate::durable::{is_in_place, set_aside, write_durably};
use crate::failure::{Code, Failure};
use crate::hub::{Acknowledgement, HealthyCourse, TrendPoint};

/// Version of the file that is written.
const SCHEMA: &str = "seepd.state/2";
/// The first one, which had no latch: each axis was its alarm alone.
const SCHEMA_1: &str = "seepd.state/1";
const NAME: &str = "state.json";
/// Held by the process that keeps its state there, and its number.
const LOCK_NAME: &str = "lock";
/// The axes' trends, which are for people: written now and then, and begun anew where they cannot be read.
const TREND_NAME: &str = "trend.json";
const TREND_SCHEMA: &str = "seepd.trend/1";
/// The last events, which are for people as well: written with the state where there are new ones.
const EVENTS_NAME: &str = "events.json";
const EVENTS_SCHEMA: &str = "seepd.events/1";

/// What is kept of an axis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AxisState {
    /// Alarm.
    pub alarm: AlarmState,
    /// Latch.
    pub latch: Latch,
    /// Who acknowledged what is latched.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub acknowledgement: Option<Acknowledgement>,
    /// Since when the flag is what it is, ns.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub since_ns: Option<i64>,
    /// The last estimate.
    #[serde(default)]
    pub estimate: Option<LastEstimate>,
    /// What is kept of each duty cycle, by its name; the only one of an axis has none.
    #[serde(default)]
    pub duty_cycles: BTreeMap<String, DutyCycleState>,
    /// What is kept of an axis without a model.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub relative: Option<RelativeState>,
    /// Entries of the repair log that were heeded.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub repairs: Vec<Repaired>,
}

/// What is kept of an axis without a model.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct RelativeState {
    /// The sums against the baseline.
    pub sums: Option<Sums>,
    /// Whether a new baseline is being learned in the place of an older one.
    pub renewing: bool,
}

/// What is kept of a duty cycle.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct DutyCycleState {
    /// The CUSUM of the leak residual against the baseline.
    #[serde(rename = "drift")]
    pub cusum: Option<Cusum>,
    /// Whether a new baseline is being learned in the place of an older one.
    pub renewing: bool,
    /// Entries of the repair log that have no verdict yet.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub aftercare: Vec<Aftercare>,
    /// Causes beside the seal that have been found.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub courses: Vec<CourseState>,
}

impl AxisState {
    /// The state of an alarm of which nothing else is known.
    fn of_alarm(alarm: AlarmState) -> Self {
        AxisState {
            alarm,
            latch: Latch::default(),
            acknowledgement: None,
            since_ns: None,
            estimate: None,
            duty_cycles: BTreeMap::new(),
            relative: None,
            repairs: Vec::new(),
        }
    }
}

/// An axis's last estimate.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LastEstimate {
    /// Leak area, m².
    pub leak_area_m2: f64,
    /// Its interval, m².
    pub interval90_m2: [f64; 2],
    /// The same as a flow at the reference pressure difference, L/min.
    pub leak_flow_lpm: f64,
}

type Axes = BTreeMap<String, AxisState>;

#[derive(Serialize, Deserialize)]
struct StateFile {
    schema: String,
    axes: Axes,
}

#[derive(Deserialize)]
struct StateFile1 {
    axes: BTreeMap<String, AlarmState>,
}

/// Reads a state file's text.
///
/// # Errors
/// One line: it is no state file, or one of a later version.
pub fn parse(text: &str) -> Result<BTreeMap<String, AxisState>, String> {
    #[derive(Deserialize)]
    struct Head {
        schema: String,
    }
    let head: Head =
        serde_json::from_str(text).map_err(|error| format!("this is not a state file: {error}"))?;
    match head.schema.as_str() {
        SCHEMA => {
            serde_json::from_str::<StateFile>(text).map(|file| file.axes).map_err(|error| error.to_string())
        }
        SCHEMA_1 => {
            let file: StateFile1 = serde_json::from_str(text).map_err(|error| error.to_string())?;
            Ok(file.axes.into_iter().map(|(axis, alarm)| (axis, AxisState::of_alarm(alarm))).collect())
        }
        other => Err(format!("its schema is {other}; this version reads {SCHEMA} and older")),
    }
}

/// Keeps the axes' state.
#[derive(Clone)]
pub struct Keeper {
    axes: Arc<Mutex<Axes>>,
    changed: watch::Sender<u64>,
    /// `None` while the folder cannot be written.
    lock: Arc<Mutex<Option<FolderLock>>>,
}

impl Keeper {
    /// Takes up what an earlier run left in a folder, which is made where it is missing. With one that cannot be written the daemon
    /// goes on, and what is to be kept waits.
    ///
    /// # Errors
    /// [`Failure`] where another process keeps its state there.
    pub fn open(folder: &Path) -> Result<Self, Failure> {
        let lock = match FolderLock::take(folder) {
            Ok(lock) => Some(lock),
            Err(error) if error.kind() == io::ErrorKind::ResourceBusy => {
                return Err(Failure::new(Code::Temporary, format!("{}: {error}", folder.display())));
            }
            // Told of when there is something to keep, and tried again then.
            Err(_) => None,
        };
        let axes = take_up(&folder.join(NAME), "alarms", |bytes| parse(&String::from_utf8_lossy(bytes)));
        Ok(Keeper {
            axes: Arc::new(Mutex::new(axes)),
            changed: watch::Sender::new(0),
            lock: Arc::new(Mutex::new(lock)),
        })
    }

    /// What is kept of an axis.
    pub fn restored(&self, axis: &str) -> Option<AxisState> {
        self.axes.lock().unwrap_or_else(PoisonError::into_inner).get(axis).cloned()
    }

    /// Keeps an axis's state; it is on disk soon.
    pub fn keep(&self, axis: &str, state: AxisState) {
        let mut axes = self.axes.lock().unwrap_or_else(PoisonError::into_inner);
        if axes.get(axis) != Some(&state) {
            axes.insert(axis.to_owned(), state);
            self.changed.send_modify(|count| *count += 1);
        }
    }

    /// Tells of changes.
    pub fn changes(&self) -> watch::Receiver<u64> {
        self.changed.subscribe()
    }

    /// What is to be kept as it stands now.
    pub fn axes(&self) -> BTreeMap<String, AxisState> {
        self.axes.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Writes the file.
    ///
    /// # Errors
    /// Writing failed, or another process has taken the folder while this one could not.
    pub fn write(&self, folder: &Path, axes: BTreeMap<String, AxisState>) -> io::Result<()> {
        let mut lock = self.lock.lock().unwrap_or_else(PoisonError::into_inner);
        // A disk that has gone has taken the lock with it, and the one that comes in its place has none.
        if !lock.as_ref().is_some_and(|lock| is_in_place(&lock.0, &folder.join(LOCK_NAME))) {
            *lock = None;
            *lock = Some(FolderLock::take(folder)?);
        }
        drop(lock);
        let text = serde_json::to_string_pretty(&StateFile { schema: SCHEMA.into(), axes })?;
        write_durably(&folder.join(NAME), text.as_bytes())
    }
}

/// What pages draw of an axis that outlives the daemon.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Drawn {
    /// Leak by cycle.
    pub trend: Vec<TrendPoint>,
    /// What a healthy cycle is like.
    pub healthy: HealthyCourse,
}

/// That of the axes by name.
pub type Trends = BTreeMap<String, Drawn>;

#[derive(Serialize, Deserialize)]
struct TrendFile {
    schema: String,
    axes: BTreeMap<String, Vec<TrendPoint>>,
    #[serde(default)]
    healthy: BTreeMap<String, HealthyCourse>,
}

/// Reads the trends that an earlier run left; none where there are none that can be read.
pub fn read_trends(folder: &Path) -> Trends {
    take_up(&folder.join(TREND_NAME), "trends", parse_trends)
}

fn parse_trends(bytes: &[u8]) -> Result<Trends, String> {
    match serde_json::from_slice::<TrendFile>(bytes) {
        Ok(file) if file.schema == TREND_SCHEMA => {
            let TrendFile { axes, mut healthy, .. } = file;
            let drawn = |(name, trend): (String, _)| {
                let healthy = healthy.remove(&name).unwrap_or_default();
                (name, Drawn { trend, healthy })
            };
            Ok(axes.into_iter().map(drawn).collect())
        }
        _ => Err("this is not a file of trends".into()),
    }
}

/// What a file holds; nothing where there is none. One that cannot be used is told of and set aside, so that the next finds its place
/// free.
fn take_up<T: Default>(path: &Path, what: &str, parse: impl FnOnce(&[u8]) -> Result<T, String>) -> T {
    let read = match side_file::read(path) {
        Err(error) if matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) => {
            return T::default();
        }
        read => read.map_err(|error| error.to_string()),
    };
    read.and_then(|bytes| parse(&bytes)).unwrap_or_else(|message| {
        let aside = set_aside(path);
        tracing::error!("{}: {message}; the file is kept as {aside}, and {what} begin anew", path.display());
        T::default()
    })
}

/// Keeps other processes from a state folder for as long as it lives; the system lifts it with the process, however that ends.
struct FolderLock(File);

impl FolderLock {
    /// Takes a folder, which is made where it is missing.
    ///
    /// # Errors
    /// The folder cannot be written, or another process has it ([`io::ErrorKind::ResourceBusy`]).
    fn take(folder: &Path) -> io::Result<Self> {
        fs::create_dir_all(folder)?;
        let path = folder.join(LOCK_NAME);
        // Neither a link is followed nor a FIFO waited for.
        let flags = nix::libc::O_NOFOLLOW | nix::libc::O_NONBLOCK;
        let mut options = File::options();
        let mut file =
            options.read(true).write(true).create(true).truncate(false).custom_flags(flags).open(&path)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                let holder = side_file::read_text(&path).unwrap_or_default();
                let what =
                    format!("process {} keeps its state there; give each its own state_dir", holder.trim());
                return Err(io::Error::new(io::ErrorKind::ResourceBusy, what));
            }
            Err(TryLockError::Error(error)) => return Err(error),
        }
        // The number is for people; on a full disk the lock holds without it.
        let _ = file.set_len(0).and_then(|()| writeln!(file, "{}", std::process::id()));
        Ok(FolderLock(file))
    }
}

/// Writes the trends.
///
/// # Errors
/// Writing failed.
pub fn write_trends(folder: &Path, axes: Trends) -> io::Result<()> {
    let mut file = TrendFile { schema: TREND_SCHEMA.into(), axes: BTreeMap::new(), healthy: BTreeMap::new() };
    for (name, Drawn { trend, healthy }) in axes {
        file.healthy.insert(name.clone(), healthy);
        file.axes.insert(name, trend);
    }
    write_durably(&folder.join(TREND_NAME), &serde_json::to_vec(&file)?)
}

#[derive(Serialize, Deserialize)]
struct EventsFile<E> {
    schema: String,
    events: Vec<E>,
}

/// Reads the last events of earlier runs, oldest first, each as it was sent: JSON. None where there are none that can be read.
pub fn read_events(folder: &Path) -> Vec<String> {
    take_up(&folder.join(EVENTS_NAME), "events", parse_events)
}

fn parse_events(bytes: &[u8]) -> Result<Vec<String>, String> {
    match serde_json::from_slice::<EventsFile<Box<RawValue>>>(bytes) {
        Ok(file) if file.schema == EVENTS_SCHEMA => {
            Ok(file.events.into_iter().map(|event| String::from(Box::<str>::from(event))).collect())
        }
        _ => Err("this is not a file of events".into()),
    }
}

/// Reads what may be a file of trends or of events.
#[cfg(fuzzing)]
pub fn parse_drawn(bytes: &[u8]) {
    let _ = (parse_trends(bytes), parse_events(bytes));
}

/// Writes the last events, each JSON.
///
/// # Errors
/// Writing failed.
pub fn write_events(folder: &Path, events: &[Arc<str>]) -> io::Result<()> {
    let events =
        events.iter().map(|event| serde_json::from_str::<&RawValue>(event)).collect::<Result<_, _>>()?;
    let file = EventsFile { schema: EVENTS_SCHEMA.into(), events };
    write_durably(&folder.join(EVENTS_NAME), &serde_json::to_vec(&file)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use seepd_monitor::alarm::{Alarm, AlarmConfig};
    use seepd_monitor::event::Flag;

    fn leaking() -> AlarmState {
        let mut alarm = Alarm::default();
        for _ in 0..3 {
            alarm.estimated(&AlarmConfig::default(), 1.0);
        }
        AlarmState::from(&alarm)
    }

    #[test]
    fn state_comes_back_and_the_folder_is_made() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path().join("deep/down");
        let keeper = Keeper::open(&folder).unwrap();
        let latch = Latch { latched: Some(Flag::Leak), acknowledged: true };
        let estimate =
            Some(LastEstimate { leak_area_m2: 1e-7, interval90_m2: [0.9e-7, 1.1e-7], leak_flow_lpm: 0.5 });
        let renewing = DutyCycleState { renewing: true, ..DutyCycleState::default() };
        let duty_cycles = BTreeMap::from([("long".to_owned(), renewing)]);
        let state = AxisState { latch, estimate, duty_cycles, ..AxisState::of_alarm(leaking()) };
        keeper.keep("press", state.clone());
        keeper.write(&folder, keeper.axes()).unwrap();
        drop(keeper);
        let again = Keeper::open(&folder).unwrap();
        assert_eq!(again.restored("press"), Some(state));
        assert_eq!(again.restored("other"), None);
    }

    #[test]
    fn a_folder_that_has_gone_is_made_and_locked_anew() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path().join("state");
        let keeper = Keeper::open(&folder).unwrap();
        keeper.keep("press", AxisState::of_alarm(leaking()));
        fs::remove_dir_all(&folder).unwrap();
        keeper.write(&folder, keeper.axes()).unwrap();
        assert!(folder.join(NAME).exists());
        assert!(Keeper::open(&folder).is_err(), "nobody else may have it");
    }

    #[test]
    fn the_first_version_is_taken_over() {
        let alarm = serde_json::to_string(&leaking()).unwrap();
        let text = format!(r#"{{"schema":"seepd.state/1","axes":{{"press":{alarm}}}}}"#);
        let axes = parse(&text).unwrap();
        assert_eq!(axes["press"], AxisState::of_alarm(leaking()));
    }

    #[test]
    fn trends_come_back_and_damaged_ones_begin_anew() {
        let folder = tempfile::tempdir().unwrap();
        let point = TrendPoint {
            t_ns: 1,
            leak_area_m2: 1e-7,
            interval90_m2: [0.0, 2e-7],
            leak_flow_lpm: 0.5,
            flag: Flag::Watch,
        };
        let healthy = HealthyCourse { cycles: 2, points: vec![(0.0, 0.5)], ..HealthyCourse::default() };
        let trends = Trends::from([("press".to_owned(), Drawn { trend: vec![point; 3], healthy })]);
        write_trends(folder.path(), trends.clone()).unwrap();
        assert_eq!(read_trends(folder.path()), trends);
        fs::write(folder.path().join(TREND_NAME), "[]").unwrap();
        assert_eq!(read_trends(folder.path()), Trends::new());
        // That of an earlier version has no healthy cycles.
        let earlier = r#"{"schema":"seepd.trend/1","axes":{"press":[]}}"#;
        fs::write(folder.path().join(TREND_NAME), earlier).unwrap();
        assert_eq!(read_trends(folder.path()), Trends::from([("press".to_owned(), Drawn::default())]));
    }

    #[test]
    fn events_come_back_as_they_were_sent_and_damaged_ones_begin_anew() {
        let folder = tempfile::tempdir().unwrap();
        assert!(read_events(folder.path()).is_empty());
        let events = [r#"{"axis":"a","x":0.10}"#, r#"{"b":"\u001b"}"#];
        write_events(folder.path(), &events.map(Arc::from)).unwrap();
        assert_eq!(read_events(folder.path()), events);
        fs::write(folder.path().join(EVENTS_NAME), &b"{\"schema\":\"seepd.events/1\",\"events\":[{"[..])
            .unwrap();
        assert!(read_events(folder.path()).is_empty());
        assert!(!folder.path().join(EVENTS_NAME).exists(), "it is set aside");
    }

    #[test]
    fn damaged_and_later_files_are_set_aside() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(NAME);
        for content in [&b"\x00\xff"[..], b"{}", br#"{"schema":"seepd.state/9","axes":{}}"#] {
            fs::write(&path, content).unwrap();
            assert_eq!(Keeper::open(folder.path()).unwrap().restored("press"), None);
            assert!(!path.exists());
        }
        // A folder in its place is no state either.
        fs::create_dir(&path).unwrap();
        assert_eq!(Keeper::open(folder.path()).unwrap().restored("press"), None);
        let keeper = Keeper::open(folder.path()).unwrap();
        keeper.write(folder.path(), keeper.axes()).unwrap();
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 4 + 2);
    }

    #[test]
    fn a_folder_has_one_keeper_and_the_other_hears_whose_it_is() {
        let folder = tempfile::tempdir().unwrap();
        let keeper = Keeper::open(folder.path()).unwrap();
        let refused = Keeper::open(folder.path()).err().unwrap();
        let holder = format!("process {} keeps its state there", std::process::id());
        assert!(refused.code == Code::Temporary && refused.message.contains(&holder), "{refused}");
        drop(keeper);
        Keeper::open(folder.path()).unwrap();
    }

    #[test]
    fn a_folder_that_cannot_be_made_is_waited_for() {
        let folder = tempfile::tempdir().unwrap();
        let in_the_way = folder.path().join("state");
        fs::write(&in_the_way, "a file").unwrap();
        let keeper = Keeper::open(&in_the_way).unwrap();
        keeper.keep("press", AxisState::of_alarm(leaking()));
        keeper.write(&in_the_way, keeper.axes()).unwrap_err();
        fs::remove_file(&in_the_way).unwrap();
        keeper.write(&in_the_way, keeper.axes()).unwrap();
        drop(keeper);
        assert_eq!(
            Keeper::open(&in_the_way).unwrap().restored("press"),
            Some(AxisState::of_alarm(leaking()))
        );
    }

    #[test]
    fn links_and_rests_in_the_place_of_the_new_file_are_replaced_and_not_followed() {
        let folder = tempfile::tempdir().unwrap();
        let (victim, path) = (folder.path().join("victim"), folder.path().join("000000000001.json"));
        fs::write(&victim, "precious").unwrap();
        std::os::unix::fs::symlink(&victim, path.with_extension("new")).unwrap();
        write_durably(&path, b"event").unwrap();
        fs::write(path.with_extension("new"), "cut").unwrap();
        write_durably(&path, b"event 2").unwrap();
        assert_eq!(fs::read_to_string(&victim).unwrap(), "precious");
        assert_eq!(fs::read_to_string(&path).unwrap(), "event 2");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
    }
}

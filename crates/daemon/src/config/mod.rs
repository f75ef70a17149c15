//! `seepd.toml`: where the signals are, which model, when to raise an alarm; for the daemon, sources and sinks too.

mod live;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use seepd_model::Model;
use seepd_settings::parse_toml;
use seepd_signals::Signal;
use serde::{Deserialize, Serialize};

use crate::alarm::AlarmConfig;
use crate::baseline::{LEAST_CYCLES, MOST_CYCLES, UNNAMED_AXIS, relative_of};
use crate::failure::{Code, Failure};
use crate::side_file;
use crate::source::fields::FieldTree;

pub use live::{
    BitsMapping, CanOutConfig, CanOutField, CanValue, CounterMapping, HttpConfig, MqttConfig, MqttVersion,
    Pace, RecordingConfig, SourceConfig, identifier,
};

/// The content of `seepd.toml`; every key has a default.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Name of the machine axis in messages.
    pub axis: String,
    /// Model file, relative to this file; absent: the one that the program brings.
    pub model: Option<PathBuf>,
    /// Several duty cycles of the axis, each with its own model; `model` and `baseline.file` are then left out.
    pub duty_cycles: Vec<DutyCycleConfig>,
    /// Pressure difference at which leaks are given as flows, Pa.
    pub reference_dp_pa: f64,
    /// Hours that the machine runs in a year, for the energy that a leak costs.
    pub operating_hours_per_year: f64,
    /// Name of a CSV file's time column.
    pub time_column: String,
    /// Unit of that column; absent: what its name ends in, such as `time_ms`, else seconds.
    pub time_unit: Option<TimeUnit>,
    /// DBC file that describes a CAN log's frames, relative to this file.
    pub dbc: Option<PathBuf>,
    /// Where each signal is. Empty: every signal under its own name, on the log's one topic that ends in `/signals`.
    pub signals: BTreeMap<Signal, SignalMapping>,
    /// Thresholds.
    pub alarm: AlarmConfig,
    /// The machine's own baseline.
    pub baseline: BaselineConfig,
    /// Where live samples come from.
    pub source: SourceConfig,
    /// Several axes: each with the keys above. Those at the file's top are then left out.
    pub axes: Vec<Config>,
    /// Folder for what outlives the daemon; absent: the service's, or `seepd-state`.
    pub state_dir: Option<PathBuf>,
    /// Dashboard, JSON, metrics, health.
    pub http: Option<HttpConfig>,
    /// A broker.
    pub mqtt: Option<MqttConfig>,
    /// Frames that tell the axes' conditions.
    pub can_out: Vec<CanOutConfig>,
    /// MCAP files of what came in and what was said.
    pub recording: Option<RecordingConfig>,
    /// What the command line says on top.
    #[serde(skip)]
    pub selection: Selection,
}

/// Unit of a time column.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TimeUnit {
    /// Seconds.
    S,
    /// Milliseconds.
    Ms,
    /// Microseconds.
    Us,
    /// Nanoseconds.
    Ns,
}

impl TimeUnit {
    /// The unit that a column's name ends in, such as `time_ms` or `Time [ms]`; seconds where it ends in none.
    pub fn of_column(name: &str) -> Self {
        let last = name.rsplit(|c: char| !c.is_alphanumeric()).find(|word| !word.is_empty());
        match last.unwrap_or_default().to_lowercase().as_str() {
            "ms" | "msec" | "millis" | "milliseconds" => TimeUnit::Ms,
            "us" | "µs" | "μs" | "usec" | "micros" | "microseconds" => TimeUnit::Us,
            "ns" | "nsec" | "nanos" | "nanoseconds" => TimeUnit::Ns,
            _ => TimeUnit::S,
        }
    }

    /// How many nanoseconds it is.
    pub fn nanoseconds(self) -> f64 {
        match self {
            TimeUnit::S => 1e9,
            TimeUnit::Ms => 1e6,
            TimeUnit::Us => 1e3,
            TimeUnit::Ns => 1.0,
        }
    }

    /// As the configuration writes it.
    pub fn name(self) -> &'static str {
        match self {
            TimeUnit::S => "s",
            TimeUnit::Ms => "ms",
            TimeUnit::Us => "us",
            TimeUnit::Ns => "ns",
        }
    }
}

/// What the command line says of where the signals are; it goes before the mapping.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Selection {
    /// Topic of all signals.
    pub topic: Option<String>,
    /// Field of the command.
    pub command: Option<String>,
}

/// Where a signal is and how it becomes SI: value · scale + offset.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SignalMapping {
    /// Topic, or the interface in a CAN log; empty: as if no mapping were given. In MCAP logs `*/ending` is the one topic that
    /// ends so.
    pub topic: String,
    /// Path of the field in the message, such as `axis.valve.command` or `data[3]`; a CSV file's column; a DBC file's
    /// signal, as `Signal` or `Message.Signal`. Empty: the signal's name.
    pub field: String,
    /// Factor.
    pub scale: f64,
    /// Added after the factor.
    pub offset: f64,
    /// Path of a field with the time in seconds, or of a stamp with seconds and nanoseconds; empty: the message's log
    /// time.
    pub time: String,
    /// Where the field is in a CAN frame, where no DBC file says so.
    pub bits: Option<BitsMapping>,
}

/// `[[duty_cycles]]`: one of several duty cycles of an axis.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DutyCycleConfig {
    /// Name in messages.
    pub name: String,
    /// Model that was trained on this duty cycle, relative to this file.
    pub model: PathBuf,
    /// Baseline of this duty cycle from `seepd learn-baseline`, relative to this file.
    pub baseline: Option<PathBuf>,
}

/// A duty cycle's model.
#[derive(Debug)]
pub struct NamedModel {
    /// The duty cycle's name, where the axis has several.
    pub name: Option<String>,
    /// The model.
    pub model: Model,
}

/// The `[baseline]` table: what estimates are relative to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Default)]
#[serde(default, deny_unknown_fields)]
pub struct BaselineConfig {
    /// Baseline from `seepd learn-baseline`, relative to this file. The daemon prefers one that it has learned since.
    pub file: Option<PathBuf>,
    /// Cycles from which the daemon learns a baseline where there is none, 20 … 1000; 0: it learns none.
    pub learn_cycles: usize,
}

impl Default for Config {
    fn default() -> Self {
        Config {
            axis: UNNAMED_AXIS.into(),
            model: None,
            duty_cycles: Vec::new(),
            reference_dp_pa: 7e6,
            operating_hours_per_year: 8760.0,
            time_column: "t_s".into(),
            time_unit: None,
            dbc: None,
            signals: BTreeMap::new(),
            alarm: AlarmConfig::default(),
            baseline: BaselineConfig::default(),
            source: SourceConfig::default(),
            axes: Vec::new(),
            state_dir: None,
            http: None,
            mqtt: None,
            can_out: Vec::new(),
            recording: None,
            selection: Selection::default(),
        }
    }
}

impl Default for SignalMapping {
    fn default() -> Self {
        SignalMapping {
            topic: String::new(),
            field: String::new(),
            scale: 1.0,
            offset: 0.0,
            time: String::new(),
            bits: None,
        }
    }
}

impl SignalMapping {
    /// Whether a log may do without the signal: it is under its own name, and not the command.
    pub fn may_be_missing(&self, signal: Signal) -> bool {
        signal != Signal::Command && self.field == signal.name()
    }
}

impl Config {
    /// Reads and checks a configuration file.
    ///
    /// # Errors
    /// [`Failure`] with file, line and key.
    pub fn read(path: &Path) -> Result<Self, Failure> {
        let text = side_file::read_text(path).map_err(|error| Failure::reading(path, &error))?;
        let mut config = Self::parse(&text).map_err(|message| Failure::configuration(path, message))?;
        if let Some(folder) = path.parent() {
            config.resolve(folder);
        }
        Ok(config)
    }

    /// Reads and checks a configuration's text.
    ///
    /// # Errors
    /// One line with line and key.
    pub fn parse(text: &str) -> Result<Self, String> {
        let config: Config = parse_toml(text).map_err(|error| error.to_string())?;
        config.check_axes()?;
        live::check_sinks(&config)?;
        Ok(config)
    }

    fn check_axes(&self) -> Result<(), String> {
        self.axes().iter().try_for_each(Config::check_axis)?;
        for axis in &self.axes {
            if axis.clone().without_sinks() != *axis || !axis.axes.is_empty() {
                let name = &axis.axis;
                return Err(format!(
                    "axes: {name} has sinks or axes of its own; these stand at the file's top"
                ));
            }
        }
        let top = Config { axes: Vec::new(), ..self.clone().without_sinks() };
        if !self.axes.is_empty() && top != Config::default() {
            return Err(
                "the file describes one axis at its top and others in [[axes]]; move the former there".into(),
            );
        }
        if let Some(twice) = named_twice(self.axes().iter().map(|axis| axis.axis.as_str())) {
            return Err(format!("two axes are called `{twice}`"));
        }
        Ok(())
    }

    fn check_axis(&self) -> Result<(), String> {
        check_name("axis", &self.axis)?;
        if !(1e5..=1e8).contains(&self.reference_dp_pa) {
            return Err(format!("reference_dp_pa is {}; it must lie in 1e5 … 1e8 Pa", self.reference_dp_pa));
        }
        if !(0.0..=8784.0).contains(&self.operating_hours_per_year) {
            return Err(format!(
                "operating_hours_per_year is {}; it must lie in 0 … 8784",
                self.operating_hours_per_year
            ));
        }
        for (signal, mapping) in &self.signals {
            if !mapping.scale.is_finite() || mapping.scale == 0.0 || !mapping.offset.is_finite() {
                return Err(format!(
                    "signals.{}: scale must be finite and not 0, offset finite",
                    signal.name()
                ));
            }
        }
        self.check_fields()?;
        if !self.signals.is_empty() && !self.signals.contains_key(&Signal::Command) {
            return Err(
                "signals.command is missing: the other signals are read beside the command, not without it"
                    .into(),
            );
        }
        let learned = self.baseline.learn_cycles;
        if learned != 0 && !(LEAST_CYCLES..=MOST_CYCLES).contains(&learned) {
            return Err(format!(
                "baseline.learn_cycles is {learned}; it must be 0 or lie in {LEAST_CYCLES} … {MOST_CYCLES}"
            ));
        }
        self.check_duty_cycles()?;
        self.source.check()?;
        self.alarm.check()
    }

    /// Whether the fields of each topic can be looked for together.
    fn check_fields(&self) -> Result<(), String> {
        for mapping in self.signals.values() {
            let of_topic = self.signals.iter().filter(|(_, other)| other.topic == mapping.topic);
            FieldTree::of(of_topic.map(|(signal, mapping)| (*signal, mapping)))?;
        }
        Ok(())
    }

    fn check_duty_cycles(&self) -> Result<(), String> {
        if self.duty_cycles.is_empty() {
            return Ok(());
        }
        if self.model.is_some() || self.baseline.file.is_some() {
            return Err("duty_cycles: each names its own model and baseline; `model` and `baseline.file` are then left out".into());
        }
        let names = self.duty_cycles.iter().map(|duty_cycle| duty_cycle.name.as_str());
        names.clone().try_for_each(|name| check_name("duty_cycles: name", name))?;
        if let Some(twice) = named_twice(names) {
            return Err(format!("two duty cycles are called `{twice}`"));
        }
        Ok(())
    }

    /// The axes: those of `axes`, or the one at the file's top.
    pub fn axes(&self) -> &[Config] {
        if self.axes.is_empty() { std::slice::from_ref(self) } else { &self.axes }
    }

    /// The axis of that name, or the only one.
    ///
    /// # Errors
    /// One line with the axes' names, where there are several and none is named, or none has the name.
    pub fn into_axis(self, name: Option<&str>) -> Result<Self, String> {
        let names = || self.axes().iter().map(|axis| axis.axis.as_str()).collect::<Vec<_>>().join(", ");
        let chosen = match (name, self.axes()) {
            (None, [only]) => Some(only),
            (None, _) => return Err(format!("has several axes; choose one by --axis: {}", names())),
            (Some(name), axes) => axes.iter().find(|axis| axis.axis == name),
        };
        chosen
            .cloned()
            .ok_or_else(|| format!("has no axis `{}`; it has {}", name.unwrap_or_default(), names()))
    }

    /// The axes without the tables of the whole daemon.
    pub fn axis_tables(&self) -> Vec<Config> {
        self.axes().iter().map(|axis| axis.clone().without_sinks()).collect()
    }

    /// The same without the tables that an axis does not have.
    #[must_use]
    pub fn without_sinks(self) -> Self {
        Config { state_dir: None, http: None, mqtt: None, can_out: Vec::new(), recording: None, ..self }
    }

    /// Takes paths as relative to the folder of the file; `-` is none.
    fn resolve(&mut self, folder: &Path) {
        let place = |path: &mut PathBuf| *path = folder.join(&path);
        self.model.iter_mut().for_each(place);
        self.dbc.iter_mut().for_each(place);
        self.baseline.file.iter_mut().for_each(place);
        for duty_cycle in &mut self.duty_cycles {
            place(&mut duty_cycle.model);
            duty_cycle.baseline.iter_mut().for_each(place);
        }
        self.state_dir.iter_mut().for_each(place);
        self.source.log.iter_mut().filter(|log| *log != Path::new("-")).for_each(place);
        if let Some(http) = &mut self.http {
            http.token_file.iter_mut().for_each(credential(folder));
        }
        if let Some(mqtt) = &mut self.mqtt {
            place(&mut mqtt.ca_file);
            mqtt.password_file.iter_mut().for_each(credential(folder));
            mqtt.certificate_file.iter_mut().for_each(credential(folder));
            mqtt.key_file.iter_mut().for_each(credential(folder));
        }
        if let Some(recording) = &mut self.recording {
            recording.folder.iter_mut().for_each(place);
        }
        self.axes.iter_mut().for_each(|axis| axis.resolve(folder));
    }

    /// The mapping in force: the given one, with names filled in and the selection on top.
    pub fn mapping(&self) -> Vec<(Signal, SignalMapping)> {
        let mut mapping: Vec<(Signal, SignalMapping)> = if self.signals.is_empty() {
            Signal::ALL.into_iter().map(|signal| (signal, SignalMapping::default())).collect()
        } else {
            self.signals.iter().map(|(signal, mapping)| (*signal, mapping.clone())).collect()
        };
        for (signal, mapping) in &mut mapping {
            if mapping.field.is_empty() {
                mapping.field = signal.name().into();
            }
            if let Some(topic) = &self.selection.topic {
                mapping.topic.clone_from(topic);
            }
            if let Some(field) = self.selection.command.as_ref().filter(|_| *signal == Signal::Command) {
                mapping.field.clone_from(field);
            }
        }
        mapping
    }

    /// The models in force, one a duty cycle.
    ///
    /// # Errors
    /// [`Failure`] where a file cannot be read or is no model, where models read at different rates, or where a baseline is asked for
    /// and a model cannot compare with one.
    pub fn load_models(&self) -> Result<Vec<NamedModel>, Failure> {
        let models = self.read_models()?;
        for (named, baseline) in models.iter().zip(self.baseline_files()) {
            if self.baseline.learn_cycles > 0 || baseline.is_some() {
                let of_model = self.model_file(named.name.as_deref());
                relative_of(&named.model).map_err(|what| Failure::configuration(of_model, what))?;
            }
        }
        Ok(models)
    }

    /// The file of a duty cycle's model, for messages.
    fn model_file(&self, duty_cycle: Option<&str>) -> &Path {
        let named = |known: &&DutyCycleConfig| Some(known.name.as_str()) == duty_cycle;
        let of_duty_cycle = self.duty_cycles.iter().find(named).map(|known| &known.model);
        of_duty_cycle
            .or(self.model.as_ref())
            .map_or(Path::new("the model that the program brings"), PathBuf::as_path)
    }

    fn read_models(&self) -> Result<Vec<NamedModel>, Failure> {
        if self.duty_cycles.is_empty() {
            let model = self.model.as_deref().map_or_else(embedded_model, load_model)?;
            return Ok(vec![NamedModel { name: None, model }]);
        }
        let mut models: Vec<NamedModel> = Vec::new();
        for duty_cycle in &self.duty_cycles {
            let model = load_model(&duty_cycle.model)?;
            let rate_hz = model.file().sample_rate_hz;
            if let Some(first) = models.first().map(|first| first.model.file().sample_rate_hz)
                && first != rate_hz
            {
                let what = format!(
                    "reads {rate_hz} Hz, the first duty cycle's model {first} Hz; an axis has one command at one rate"
                );
                return Err(Failure::configuration(&duty_cycle.model, what));
            }
            models.push(NamedModel { name: Some(duty_cycle.name.clone()), model });
        }
        Ok(models)
    }

    /// The files that reading a log by this configuration reads beside the log.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        let of_axis = [&self.model, &self.dbc].into_iter().flatten().map(PathBuf::as_path);
        let models = self.duty_cycles.iter().map(|duty_cycle| duty_cycle.model.as_path());
        of_axis.chain(models).chain(self.baseline_files().into_iter().flatten())
    }

    /// Each duty cycle's baseline file, where the configuration names one, in their order.
    pub fn baseline_files(&self) -> Vec<Option<&Path>> {
        if self.duty_cycles.is_empty() {
            return vec![self.baseline.file.as_deref()];
        }
        self.duty_cycles.iter().map(|duty_cycle| duty_cycle.baseline.as_deref()).collect()
    }
}

/// Longest name of an axis or a duty cycle, bytes: file names, with what is added to them, have 255 at most.
const LONGEST_NAME: usize = 100;

/// Checks that a text can be a name in topics, files and folders.
fn check_name(key: &str, text: &str) -> Result<(), String> {
    let is_allowed = |c: char| c.is_alphanumeric() || matches!(c, ' ' | '.' | '_' | '-');
    let is_bare = |end: Option<char>| end.is_some_and(char::is_alphanumeric);
    if text.len() <= LONGEST_NAME
        && text.chars().all(is_allowed)
        && is_bare(text.chars().next())
        && is_bare(text.chars().next_back())
    {
        return Ok(());
    }
    Err(format!(
        "{key} is `{}`; a name has letters, digits, spaces and . _ - between letters or digits, at most {LONGEST_NAME} bytes",
        text.escape_debug()
    ))
}

/// A name that is there more than once.
fn named_twice<'n>(names: impl Iterator<Item = &'n str>) -> Option<&'n str> {
    let mut names: Vec<&str> = names.collect();
    names.sort_unstable();
    names.windows(2).find(|pair| pair[0] == pair[1]).map(|pair| pair[0])
}

/// The model that the program brings.
///
/// # Errors
/// [`Failure`] where it does not pass its checks, which a test rules out.
pub fn embedded_model() -> Result<Model, Failure> {
    Model::from_json(crate::EMBEDDED_MODEL)
        .map_err(|error| Failure::new(Code::Internal, format!("the model that the program brings: {error}")))
}

/// Where a secret is: with the service's credentials where systemd has put one of that name there, else relative to the
/// configuration.
fn credential(folder: &Path) -> impl Fn(&mut PathBuf) {
    let credentials = std::env::var_os("CREDENTIALS_DIRECTORY").map(PathBuf::from);
    move |path| {
        let given = credentials.as_ref().map(|credentials| credentials.join(&path));
        *path = given.filter(|given| given.exists()).unwrap_or_else(|| folder.join(&path));
    }
}

/// Reads and checks a model file.
///
/// # Errors
/// [`Failure`] where the file cannot be read or is no model.
pub fn load_model(path: &Path) -> Result<Model, Failure> {
    let json = side_file::read(path).map_err(|error| Failure::reading(path, &error))?;
    Model::from_json(&json).map_err(|error| Failure::configuration(path, error))
}

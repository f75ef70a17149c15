//! An axis: where its signals are, which model, when to raise an alarm.

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError, Weak};

use seepd_logs::{CounterMapping, LogMapping, Selection, SignalMapping, TimeUnit, check_signals};
use seepd_model::Model;
use seepd_monitor::alarm::AlarmConfig;
use seepd_monitor::baseline::{LEAST_CYCLES, MOST_CYCLES, UNNAMED_AXIS, relative_of};
use seepd_monitor::pipeline::{DutyCycle, HOURS_PER_YEAR, MonitorConfig, REFERENCE_DP_PA};
use seepd_settings::side_file;
use seepd_signals::Signal;
use serde::{Deserialize, Serialize};

use super::{check_name, named_twice};
use crate::advice::CommandSource;
use crate::failure::{Code, Failure};

/// An axis of the configuration: the keys at the file's top, or those of an element of `[[axes]]`. Every key has a default.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AxisConfig {
    /// Name of the machine axis in messages.
    pub axis: String,
    /// What cycles are measured against.
    pub monitor: KindConfig,
    /// Model file, relative to this file; absent: the one that the program brings.
    pub model: Option<PathBuf>,
    /// Several duty cycles of the axis, each with its own model; `model` and `baseline.file` are then left out.
    pub duty_cycles: Vec<DutyCycleConfig>,
    /// Pressure difference at which leaks are given as flows, Pa.
    pub reference_dp_pa: f64,
    /// Hours that the machine runs in a year, for the energy that a leak costs.
    pub operating_hours_per_year: f64,
    /// What energy costs.
    pub energy: EnergyConfig,
    /// Name of a CSV file's time column.
    pub time_column: String,
    /// Unit of that column; absent: what its name ends in, such as `time_ms`, else seconds.
    pub time_unit: Option<TimeUnit>,
    /// Rows a second of a CSV file without a time column.
    pub sample_rate_hz: Option<f64>,
    /// DBC file that describes a CAN log's frames, relative to this file.
    pub dbc: Option<PathBuf>,
    /// Where each signal is. Empty: every signal under its own name, on the log's one topic that ends in `/signals`.
    pub signals: BTreeMap<Signal, SignalMapping>,
    /// Thresholds.
    pub alarm: AlarmConfig,
    /// The machine's own baseline.
    pub baseline: BaselineConfig,
    /// What was done to the machine, relative to this file; absent: the daemon keeps it in its state folder.
    pub repairs: Option<PathBuf>,
    /// Where live samples come from.
    pub source: SourceConfig,
    /// What the command line says on top.
    #[serde(skip)]
    pub selection: Selection,
}

impl Default for AxisConfig {
    fn default() -> Self {
        let LogMapping { time_column, .. } = LogMapping::default();
        AxisConfig {
            axis: UNNAMED_AXIS.into(),
            monitor: KindConfig::default(),
            model: None,
            duty_cycles: Vec::new(),
            reference_dp_pa: REFERENCE_DP_PA,
            operating_hours_per_year: HOURS_PER_YEAR,
            energy: EnergyConfig::default(),
            time_column,
            time_unit: None,
            sample_rate_hz: None,
            dbc: None,
            signals: BTreeMap::new(),
            alarm: AlarmConfig::default(),
            baseline: BaselineConfig::default(),
            repairs: None,
            source: SourceConfig::default(),
            selection: Selection::default(),
        }
    }
}

/// `[energy]`: what energy costs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EnergyConfig {
    /// Price of a kilowatt-hour; absent: what a leak costs is not told.
    pub price_per_kwh: Option<f64>,
    /// Its currency, as it is to be written.
    pub currency: String,
}

impl Default for EnergyConfig {
    fn default() -> Self {
        EnergyConfig { price_per_kwh: None, currency: "EUR".into() }
    }
}

/// Longest currency, characters.
const LONGEST_CURRENCY: usize = 8;

impl EnergyConfig {
    fn check(&self) -> Result<(), String> {
        if let Some(price) = self.price_per_kwh.filter(|price| !(0.0..=1e6).contains(price)) {
            return Err(format!("energy.price_per_kwh is {price}; it must lie in 0 … 1e6"));
        }
        let length = self.currency.chars().count();
        if !(1..=LONGEST_CURRENCY).contains(&length) || self.currency.chars().any(char::is_control) {
            let shown = self.currency.escape_debug();
            return Err(format!("energy.currency is `{shown}`; it has 1 … {LONGEST_CURRENCY} characters"));
        }
        Ok(())
    }

    /// What that many kWh cost; nothing without a price.
    pub fn cost(&self, energy_kwh: f64) -> Option<Money> {
        let price = self.price_per_kwh?;
        Some(Money { amount: price * energy_kwh, currency: self.currency.clone() })
    }
}

/// An amount of money; people read it in whole units.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Money {
    /// How much.
    pub amount: f64,
    /// Of what, as in the configuration.
    pub currency: String,
}

impl fmt::Display for Money {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.0} {}", self.amount, self.currency)
    }
}

/// `[monitor]`: what an axis's cycles are measured against.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct KindConfig {
    /// A model, or the machine's own healthy cycles alone.
    pub kind: MonitorKind,
}

/// What cycles are measured against.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MonitorKind {
    /// A model, which tells sizes.
    #[default]
    Model,
    /// The machine's own healthy cycles, where there is no model: that something has changed, and no size.
    Relative,
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

/// The `[baseline]` table: what estimates are relative to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Default)]
#[serde(default, deny_unknown_fields)]
pub struct BaselineConfig {
    /// Baseline from `seepd learn-baseline`, relative to this file. The daemon prefers one that it has learned since.
    pub file: Option<PathBuf>,
    /// Cycles from which the daemon learns a baseline where there is none, 20 … 1000; 0: it learns none.
    pub learn_cycles: usize,
}

/// How fast a log is fed to the daemon.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Pace {
    /// As it was recorded.
    #[default]
    Recorded,
    /// As fast as it can be read.
    Fast,
}

/// `[source]`: where an axis's samples come from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SourceConfig {
    /// CAN interface, such as `can0`; `unix:PATH` binds a Unix datagram socket that takes frames as Linux lays them out.
    pub can: Option<String>,
    /// Log instead, of any kind that is read, or a folder or a pattern, relative to this file; `-` reads standard input.
    pub log: Option<PathBuf>,
    /// Pace of a log.
    pub pace: Pace,
    /// Time without a usable sample after which the input is stale, s.
    pub stale_after_s: f64,
    /// Counter of the command's frame, by which lost frames are told.
    pub counter: Option<CounterMapping>,
    /// Size of the socket's receive buffer that is asked for, bytes; the system's net.core.rmem_max caps it.
    pub receive_buffer_bytes: usize,
}

impl Default for SourceConfig {
    fn default() -> Self {
        SourceConfig {
            can: None,
            log: None,
            pace: Pace::Recorded,
            stale_after_s: 2.0,
            counter: None,
            receive_buffer_bytes: 4 << 20,
        }
    }
}

impl SourceConfig {
    /// Checks the values.
    ///
    /// # Errors
    /// One line that names the key.
    pub fn check(&self) -> Result<(), String> {
        if self.can.is_some() && self.log.is_some() {
            return Err("source: both `can` and `log` are given, but an axis has one source".into());
        }
        if !(0.1..=3600.0).contains(&self.stale_after_s) {
            return Err(format!("source.stale_after_s is {}; it must lie in 0.1 … 3600", self.stale_after_s));
        }
        if let Some(interface) = self.can.as_deref().filter(|name| !name.starts_with("unix:"))
            && (interface.is_empty() || interface.len() > 15 || interface.contains(['/', ' ']))
        {
            return Err(format!("source.can is `{interface}`, which cannot be the name of an interface"));
        }
        Ok(())
    }
}

impl AxisConfig {
    /// Checks the values.
    ///
    /// # Errors
    /// One line that names the key.
    pub(super) fn check(&self) -> Result<(), String> {
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
        if let Some(rate_hz) = self.sample_rate_hz.filter(|rate| !(0.1..=1e6).contains(rate)) {
            return Err(format!("sample_rate_hz is {rate_hz}; it must lie in 0.1 … 1e6 Hz"));
        }
        check_signals(&self.signals).map_err(|error| error.to_string())?;
        let learned = self.baseline.learn_cycles;
        if learned != 0 && !(LEAST_CYCLES..=MOST_CYCLES).contains(&learned) {
            return Err(format!(
                "baseline.learn_cycles is {learned}; it must be 0 or lie in {LEAST_CYCLES} … {MOST_CYCLES}"
            ));
        }
        self.energy.check()?;
        self.check_duty_cycles()?;
        if self.is_relative() && (self.model.is_some() || !self.duty_cycles.is_empty()) {
            return Err("monitor.kind is `relative`, which takes no model: leave out `model` and `duty_cycles`, or the kind".into());
        }
        self.source.check()?;
        self.alarm.check().map_err(|error| error.to_string())
    }

    /// Whether there is no model: cycles are compared with the machine's own healthy ones alone.
    pub fn is_relative(&self) -> bool {
        self.monitor.kind == MonitorKind::Relative
    }

    fn check_duty_cycles(&self) -> Result<(), String> {
        if self.duty_cycles.is_empty() {
            return Ok(());
        }
        if self.model.is_some() || self.baseline.file.is_some() {
            return Err("duty_cycles: each has a model and a baseline of its own; leave out `model` and `baseline.file`".into());
        }
        let names = self.duty_cycles.iter().map(|duty_cycle| duty_cycle.name.as_str());
        names.clone().try_for_each(|name| check_name("duty_cycles: name", name))?;
        if let Some(twice) = named_twice(names) {
            return Err(format!("two duty cycles are called `{twice}`"));
        }
        Ok(())
    }

    /// Takes paths as relative to the folder of the file; `-` is none.
    pub(super) fn resolve(&mut self, folder: &Path) {
        let place = |path: &mut PathBuf| *path = folder.join(&path);
        self.model.iter_mut().for_each(place);
        self.dbc.iter_mut().for_each(place);
        self.baseline.file.iter_mut().for_each(place);
        self.repairs.iter_mut().for_each(place);
        for duty_cycle in &mut self.duty_cycles {
            place(&mut duty_cycle.model);
            duty_cycle.baseline.iter_mut().for_each(place);
        }
        self.source.log.iter_mut().filter(|log| *log != Path::new("-")).for_each(place);
    }

    /// What is allowed and should be known.
    pub(super) fn remark(&self) -> Option<String> {
        let what = "no signal is mapped, so each is looked for under its own name, and in MCAP logs on the only topic that ends in /signals";
        self.signals.is_empty().then(|| format!("axis {}: {what}", self.axis))
    }

    /// How its logs, or its bus, become samples.
    pub fn log_mapping(&self) -> LogMapping {
        LogMapping {
            signals: self.signals.clone(),
            selection: self.selection.clone(),
            time_column: self.time_column.clone(),
            time_unit: self.time_unit,
            sample_rate_hz: self.sample_rate_hz,
            dbc: self.dbc.clone(),
            counter: self.source.counter.clone(),
        }
    }

    /// Where its command comes from, for advice; without a log, one is spoken of as `LOG`.
    pub fn command_source(&self, log: Option<&Path>) -> CommandSource {
        let mapping = self.signals.get(&Signal::Command).cloned().unwrap_or_default();
        let scale = self.selection.scale.unwrap_or(mapping.scale);
        let log = log.map_or("LOG".to_owned(), |log| shell_word(&seepd_logs::log_name(log)));
        CommandSource { log, scale, offset: mapping.offset }
    }

    /// How its samples become events, with the models of [`load_models`](Self::load_models).
    pub fn monitor(&self, duty_cycles: Vec<DutyCycle>) -> MonitorConfig {
        MonitorConfig {
            axis: self.axis.clone(),
            duty_cycles,
            alarm: self.alarm.clone(),
            reference_dp_pa: self.reference_dp_pa,
            operating_hours_per_year: self.operating_hours_per_year,
        }
    }

    /// The duty cycles with their models; none where the axis is watched without one.
    ///
    /// # Errors
    /// [`Failure`] where a file cannot be read or is no model, where models read at different rates, or where a baseline is asked for
    /// and a model cannot compare with one.
    pub fn load_models(&self) -> Result<Vec<DutyCycle>, Failure> {
        let duty_cycles = self.read_models()?;
        for (duty_cycle, baseline) in duty_cycles.iter().zip(self.baseline_files()) {
            if self.baseline.learn_cycles > 0 || baseline.is_some() {
                let of_model = self.model_file(duty_cycle.name.as_deref());
                relative_of(&duty_cycle.model).map_err(|error| Failure::configuration(of_model, error))?;
            }
        }
        Ok(duty_cycles)
    }

    /// The file of a duty cycle's model, for messages.
    fn model_file(&self, duty_cycle: Option<&str>) -> &Path {
        let named = |known: &&DutyCycleConfig| Some(known.name.as_str()) == duty_cycle;
        let of_duty_cycle = self.duty_cycles.iter().find(named).map(|known| &known.model);
        of_duty_cycle.or(self.model.as_ref()).map_or(Path::new("the embedded model"), PathBuf::as_path)
    }

    fn read_models(&self) -> Result<Vec<DutyCycle>, Failure> {
        if self.is_relative() {
            return Ok(Vec::new());
        }
        if self.duty_cycles.is_empty() {
            let model = self.model.as_deref().map_or_else(embedded_model, load_model)?;
            return Ok(vec![DutyCycle::only(model)]);
        }
        let mut duty_cycles: Vec<DutyCycle> = Vec::new();
        for duty_cycle in &self.duty_cycles {
            let model = load_model(&duty_cycle.model)?;
            let rate_hz = model.file().sample_rate_hz;
            if let Some(first) = duty_cycles.first().map(|first| first.model.file().sample_rate_hz)
                && first != rate_hz
            {
                let what = format!(
                    "it reads {rate_hz} Hz, but the model of the first duty cycle reads {first} Hz; an axis has one command at one rate"
                );
                return Err(Failure::configuration(&duty_cycle.model, what));
            }
            duty_cycles.push(DutyCycle { name: Some(duty_cycle.name.clone()), model });
        }
        Ok(duty_cycles)
    }

    /// The files that reading a log by this configuration reads beside the log.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        let of_axis = [&self.model, &self.dbc, &self.repairs].into_iter().flatten().map(PathBuf::as_path);
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

/// A text as one word of a command line.
fn shell_word(text: &str) -> String {
    let is_plain = |c: char| c.is_alphanumeric() || "._-/+:@".contains(c);
    if text.chars().all(is_plain) { text.to_owned() } else { format!("'{}'", text.replace('\'', "'\\''")) }
}

/// The model that the program brings; axes that are read at the same time share it.
///
/// # Errors
/// [`Failure`] where it does not pass its checks, which a test rules out.
pub fn embedded_model() -> Result<Arc<Model>, Failure> {
    static SHARED: Mutex<Weak<Model>> = Mutex::new(Weak::new());
    let mut shared = SHARED.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(model) = shared.upgrade() {
        return Ok(model);
    }
    let model = Model::from_json(crate::EMBEDDED_MODEL)
        .map_err(|error| Failure::new(Code::Internal, format!("the embedded model: {error}")))?;
    let model = Arc::new(model);
    *shared = Arc::downgrade(&model);
    Ok(model)
}

/// Reads and checks a model file.
///
/// # Errors
/// [`Failure`] where the file cannot be read or is no model.
pub fn load_model(path: &Path) -> Result<Arc<Model>, Failure> {
    let json = side_file::read(path).map_err(|error| Failure::reading(path, &error))?;
    Model::from_json(&json).map(Arc::new).map_err(|error| Failure::configuration(path, error))
}

//! `seepd.toml`: the axes, and for the daemon the sinks and where its state is kept.

mod axis;
mod endpoint;
mod plant;
mod sinks;

use std::path::{Path, PathBuf};

use seepd_settings::{FormatError, parse_toml_parts, side_file};
use serde::Deserialize;

use crate::failure::Failure;

pub use axis::{
    AxisConfig, BaselineConfig, DutyCycleConfig, EnergyConfig, KindConfig, Money, MonitorKind, Pace,
    SourceConfig, embedded_model, load_model,
};
pub use endpoint::Endpoint;
pub use plant::{FoxgloveConfig, J1939Config, OpenTelemetryConfig, SparkplugConfig};
pub use sinks::{
    CanOutConfig, CanOutField, CanValue, HttpConfig, InfluxConfig, MqttConfig, MqttVersion, RecordingConfig,
    SinksConfig,
};

/// The content of `seepd.toml`.
#[derive(Debug, Clone, PartialEq)]
pub struct DaemonConfig {
    /// The axes, at least one: that at the file's top, or those of `[[axes]]`.
    pub axes: Vec<AxisConfig>,
    /// Where the daemon tells of them.
    pub sinks: SinksConfig,
    /// Folder for what outlives the daemon; absent: the service's, or `seepd-state`.
    pub state_dir: Option<PathBuf>,
}

/// What stands at the file's top beside an axis's own keys and the sinks' tables.
#[derive(Debug, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct TopKeys {
    axes: Vec<AxisConfig>,
    state_dir: Option<PathBuf>,
}

impl DaemonConfig {
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
        let config = Self::parse_unchecked(text)?;
        config.axes.iter().try_for_each(AxisConfig::check)?;
        if let Some(twice) = named_twice(config.axes.iter().map(|axis| axis.axis.as_str())) {
            return Err(format!("two axes are called `{twice}`"));
        }
        config.sinks.check(&config.axes)?;
        Ok(config)
    }

    fn parse_unchecked(text: &str) -> Result<Self, String> {
        let line = |error: FormatError| error.to_string();
        let mut parts = parse_toml_parts(text).map_err(line)?;
        let keys: TopKeys = parts.take(&["axes", "state_dir"]).map_err(line)?;
        let sinks = parts.take(SinksConfig::KEYS).map_err(line)?;
        let top: AxisConfig = parts.take_rest().map_err(line)?;
        let TopKeys { axes, state_dir } = keys;
        if axes.is_empty() {
            return Ok(DaemonConfig { axes: vec![top], sinks, state_dir });
        }
        if top != AxisConfig::default() {
            return Err(
                "the file describes one axis at its top and others in [[axes]]; move the first one there as well".into(),
            );
        }
        Ok(DaemonConfig { axes, sinks, state_dir })
    }

    /// The axis of that name, or the only one.
    ///
    /// # Errors
    /// One line with the axes' names, where there are several and none is named, or none has the name.
    pub fn into_axis(self, name: Option<&str>) -> Result<AxisConfig, String> {
        let names = self.axes.iter().map(|axis| axis.axis.as_str()).collect::<Vec<_>>().join(", ");
        if name.is_none() && self.axes.len() > 1 {
            return Err(format!("the file has several axes; choose one with --axis: {names}"));
        }
        self.axes
            .into_iter()
            .find(|axis| name.is_none_or(|name| name == axis.axis))
            .ok_or_else(|| format!("the file has no axis `{}`; it has {names}", name.unwrap_or_default()))
    }

    /// What the configuration allows and should be known, a line each.
    pub fn remarks(&self) -> Vec<String> {
        self.sinks.remarks().chain(self.axes.iter().filter_map(AxisConfig::remark)).collect()
    }

    /// Takes paths as relative to the folder of the file.
    fn resolve(&mut self, folder: &Path) {
        self.state_dir.iter_mut().for_each(|path| *path = folder.join(&path));
        self.sinks.resolve(folder);
        self.axes.iter_mut().for_each(|axis| axis.resolve(folder));
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
        "{key} is `{}`; a name has letters, digits, spaces and . _ - between letters or digits, and at most {LONGEST_NAME} bytes",
        text.escape_debug()
    ))
}

/// A name that is there more than once.
fn named_twice<'n>(names: impl Iterator<Item = &'n str>) -> Option<&'n str> {
    let mut names: Vec<&str> = names.collect();
    names.sort_unstable();
    names.windows(2).find(|pair| pair[0] == pair[1]).map(|pair| pair[0])
}

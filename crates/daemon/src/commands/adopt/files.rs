//! The folder of an adopted machine and its files.

use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

use seepd_adopt::adoption::Adoption;
use seepd_adopt::machine_data::MachineData;
use seepd_adopt::training::TrainingBasis;
use seepd_logs::survey::toml_text;
use seepd_monitor::alarm::AlarmConfig;
use seepd_settings::side_file;
use seepd_sim::{MachineSpec, PlantParameters};

use crate::commands::simulate::read_plant;
use crate::config::{AxisConfig, DaemonConfig};
use crate::failure::{Code, Failure};
use crate::output::{Outputs, OverwriteArguments};

/// Where the service looks for its files.
const INSTALLED: &str = "/etc/seepd";
/// What the service needs.
const SERVED: [&str; 4] = ["seepd.toml", "plant.toml", "model.json", "baseline.json"];
/// What a user fills in.
pub(super) const MACHINE_FORM: &str = include_str!("../../../../../docs/machine.toml");

/// The folder of an adopted machine.
pub(super) struct Folder {
    path: PathBuf,
}

impl Folder {
    /// The folder, made where it is not there. One that has a result already is opened only to go on with it, or by force. What a run left
    /// that was broken off is written again.
    pub(super) fn open(path: &Path, may_replace: bool) -> Result<Self, Failure> {
        fs::create_dir_all(path).map_err(|error| Failure::writing(path, error))?;
        let folder = Folder { path: path.to_owned() };
        if !may_replace && folder.path("model.json").exists() {
            return Err(Failure::new(
                Code::Usage,
                format!(
                    "{}: has an adopted machine already; --from STEP goes on with it, --force begins anew",
                    path.display()
                ),
            ));
        }
        Ok(folder)
    }

    pub(super) fn path(&self, name: &str) -> PathBuf {
        self.path.join(name)
    }

    /// The folder's own name, as far as it can name an axis.
    pub(super) fn name(&self) -> String {
        let whole = fs::canonicalize(&self.path).unwrap_or_else(|_| self.path.clone());
        let name: String = whole
            .file_name()
            .map(|name| name.to_string_lossy().into_owned())
            .unwrap_or_default()
            .chars()
            .filter(|c| c.is_alphanumeric() || matches!(c, '-' | '_'))
            .take(60)
            .collect();
        let bare = name.trim_matches(|c: char| !c.is_alphanumeric());
        if bare.is_empty() { "axis-1".into() } else { bare.into() }
    }

    /// Writes a file, whole or not at all.
    pub(super) fn write(&self, name: &str, content: impl AsRef<[u8]>) -> Result<(), Failure> {
        Outputs::new(OverwriteArguments { force: true }, []).claim(&self.path(name))?.write(content)
    }

    pub(super) fn copy(&self, from: &Path, name: &str) -> Result<(), Failure> {
        let content = side_file::read(from).map_err(|error| Failure::reading(from, &error))?;
        self.write(name, content)
    }

    /// The configuration as far as the first step knows it.
    pub(super) fn write_mapping(&self, config: &AxisConfig) -> Result<(), Failure> {
        self.write_checked(&config_toml(config, false))
    }

    /// The whole configuration; paths in the file are relative to the folder.
    pub(super) fn write_config(&self, config: &AxisConfig) -> Result<(), Failure> {
        self.write_checked(&config_toml(config, true))
    }

    /// A name or a column that the program would not read again is told now.
    fn write_checked(&self, text: &str) -> Result<(), Failure> {
        let path = self.path("seepd.toml");
        DaemonConfig::parse(text).map_err(|error| Failure::configuration(&path, error))?;
        self.write("seepd.toml", text)
    }

    /// The mapping of an earlier run. Model and baseline are what this run makes.
    pub(super) fn read_config(&self) -> Result<AxisConfig, Failure> {
        let mut config = read_config(&self.path("seepd.toml"))?;
        config.model = None;
        config.baseline.file = None;
        Ok(config)
    }

    pub(super) fn read_plant(&self) -> Result<MachineSpec, Failure> {
        read_plant(Some(&self.path("plant.toml")))
    }

    pub(super) fn write_basis(&self, basis: &TrainingBasis) -> Result<(), Failure> {
        let text =
            toml::to_string_pretty(basis).map_err(|error| Failure::new(Code::Internal, error.to_string()))?;
        let head = "# What `seepd adopt --from model` takes beside plant.toml: tolerances of the plant's parameters (shares to either side),\n\
                    # the command's noise, and how much load and period vary.\n\n";
        self.write("training.toml", format!("{head}{text}"))
    }

    pub(super) fn read_basis(&self) -> Result<TrainingBasis, Failure> {
        let path = self.path("training.toml");
        let text = side_file::read_text(&path).map_err(|error| Failure::reading(&path, &error))?;
        seepd_settings::parse_toml(&text).map_err(|error| Failure::configuration(&path, error))
    }

    /// Copies what the service needs to where it looks; all or, where something is there that may not be written over, nothing.
    pub(super) fn install(&self, overwrite: OverwriteArguments) -> Result<(), Failure> {
        let target = Path::new(INSTALLED);
        fs::create_dir_all(target).map_err(|error| Failure::writing(target, error))?;
        let mut outputs = Outputs::new(overwrite, []);
        let claimed = SERVED.map(|name| Ok((self.path(name), outputs.claim(&target.join(name))?)));
        for place in claimed.into_iter().collect::<Result<Vec<_>, Failure>>()? {
            let (from, to) = place;
            to.write(side_file::read(&from).map_err(|error| Failure::reading(&from, &error))?)?;
        }
        Ok(())
    }
}

/// The one axis of a configuration.
pub(super) fn read_config(path: &Path) -> Result<AxisConfig, Failure> {
    DaemonConfig::read(path)?
        .into_axis(None)
        .map_err(|what| Failure::new(Code::Usage, format!("{}: {what}", path.display())))
}

/// What the user knows of the machine.
pub(super) fn read_machine(path: &Path) -> Result<MachineData, Failure> {
    let text = side_file::read_text(path).map_err(|error| Failure::reading(path, &error))?;
    MachineData::from_toml(&text).map_err(|error| Failure::configuration(path, error))
}

pub(super) fn machine_toml(data: &MachineData) -> Result<String, Failure> {
    toml::to_string_pretty(data).map_err(|error| Failure::new(Code::Internal, error.to_string()))
}

/// `seepd.toml` of an adopted machine.
fn config_toml(config: &AxisConfig, is_whole: bool) -> String {
    let mut text = String::from(
        "# Written by `seepd adopt`; edit it and go on with `seepd adopt --from cycle`, or use it as it is.\n",
    );
    let mut line = |what: std::fmt::Arguments<'_>| {
        // Writing to a text does not fail.
        let _ = writeln!(text, "{what}");
    };
    line(format_args!("axis = {}", toml_text(&config.axis)));
    if is_whole {
        line(format_args!("model = \"model.json\""));
    }
    line(format_args!("time_column = {}", toml_text(&config.time_column)));
    if let Some(unit) = config.time_unit {
        line(format_args!("time_unit = \"{}\"", unit.name()));
    }
    if let Some(dbc) = &config.dbc {
        let whole = fs::canonicalize(dbc).unwrap_or_else(|_| dbc.clone());
        line(format_args!("dbc = {}", toml_text(&whole.display().to_string())));
    }
    if is_whole {
        let AlarmConfig { watch_lpm, leak_lpm, severe_lpm, .. } = config.alarm;
        line(format_args!("\n# Thresholds, L/min at 70 bar, in proportion to the valve's flow.\n[alarm]"));
        line(format_args!("watch_lpm = {watch_lpm:?}\nleak_lpm = {leak_lpm:?}\nsevere_lpm = {severe_lpm:?}"));
        line(format_args!("\n[baseline]\nfile = \"baseline.json\""));
    }
    for (signal, mapping) in &config.signals {
        line(format_args!("\n[signals.{}]  # in {}", signal.name(), signal.unit()));
        if !mapping.topic.is_empty() {
            line(format_args!("topic = {}", toml_text(&mapping.topic)));
        }
        if !mapping.field.is_empty() {
            line(format_args!("field = {}", toml_text(&mapping.field)));
        }
        if let Some(bits) = &mapping.bits {
            line(format_args!("bits = {}", bits.to_toml()));
        }
        if mapping.scale != 1.0 {
            line(format_args!("scale = {:?}", mapping.scale));
        }
        if mapping.offset != 0.0 {
            line(format_args!("offset = {:?}", mapping.offset));
        }
        if !mapping.time.is_empty() {
            line(format_args!("time = {}", toml_text(&mapping.time)));
        }
    }
    text
}

/// The plant file, with where each value of the plant comes from.
pub(super) fn plant_toml(text: &str, adoption: &Adoption) -> String {
    let mut commented = String::from(
        "# The adopted machine, in SI units. Edit it and go on with `seepd adopt --from model`.\n",
    );
    for line in text.lines() {
        let key = line.split_once(" = ").map(|(key, _)| key);
        let known = key
            .filter(|key| PlantParameters::ALL.iter().any(|info| info.key == *key))
            .and_then(|key| adoption.values.get(key));
        match known {
            Some(value) => {
                let _ = writeln!(
                    commented,
                    "{line}  # {}, within ± {:.0} %",
                    value.origin.words(),
                    100.0 * value.tolerance
                );
            }
            None => {
                let _ = writeln!(commented, "{line}");
            }
        }
    }
    commented
}

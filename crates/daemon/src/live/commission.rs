//! A duty cycle's baselines on disk: `axes/AXIS/baseline.json` in the state folder, of several duty cycles `axes/AXIS/baseline-NAME.json`;
//! the form of `seepd learn-baseline`.

use std::path::{Path, PathBuf};
use std::{fs, io};

use seepd_monitor::baseline::BaselineFile;
use seepd_monitor::pipeline::Monitor;

use super::state::DutyCycleState;
use crate::baseline_file;
use crate::config::AxisConfig;
use crate::durable::{set_aside, write_durably};

/// Cycles of a baseline that a person asks for where the configuration names none.
const USUAL_CYCLES: usize = 50;

/// Where a duty cycle's baselines are kept, and what is known of them.
#[derive(Debug)]
pub(super) struct BaselineRecord {
    path: PathBuf,
    file: BaselineFile,
    learn_cycles: usize,
    /// Whether a new baseline is being learned in the place of an older one.
    renewing: bool,
    /// Whether a baseline has been learned that is not on disk.
    unsaved: bool,
}

impl BaselineRecord {
    /// What an earlier run has learned of the duty cycle of that index, or else what the configuration names. A file that cannot be
    /// used is told of and set aside.
    pub(super) fn open(folder: &Path, config: &AxisConfig, (index, monitor): (usize, &Monitor)) -> Self {
        let of_duty_cycle = monitor.name().map_or(String::new(), |name| format!("-{name}"));
        let path = folder.join("axes").join(&config.axis).join(format!("baseline{of_duty_cycle}.json"));
        let model = monitor.model();
        let read = |file: &Path| baseline_file::read(file, &config.axis, model);
        if !path.exists() {
            // Where version 0.1.0 kept it: a name that two axes could share.
            let former = folder.join(format!("baseline-{}{of_duty_cycle}.json", config.axis));
            if read(&former).is_ok_and(|file| file.axis == config.axis)
                && let Err(error) = take_over(&former, &path)
            {
                tracing::error!(axis = config.axis, "{}: {error}; it is not used", former.display());
            }
        }
        let own = path.exists().then(|| read(&path));
        let files = config.baseline_files();
        let given = || files.get(index).copied().flatten().map(read);
        let file = match own {
            Some(Err(failure)) => {
                let aside = set_aside(&path);
                tracing::error!(axis = config.axis, "{}; the file is kept as {aside}", failure.message);
                given()
            }
            Some(good) => Some(good),
            None => given(),
        };
        let file = file.and_then(|read| {
            read.inspect_err(|failure| tracing::error!(axis = config.axis, "{}", failure.message)).ok()
        });
        let file = file.unwrap_or_else(|| BaselineFile::new(&config.axis, model));
        BaselineRecord {
            path,
            file,
            learn_cycles: config.baseline.learn_cycles,
            renewing: false,
            unsaved: false,
        }
    }

    /// Whether a new baseline is being learned in the place of an older one.
    pub(super) fn is_renewing(&self) -> bool {
        self.renewing
    }

    /// Sets a monitor on its way as an earlier run left it: with the newest baseline, or to learn one.
    pub(super) fn commission(&mut self, monitor: &mut Monitor, state: DutyCycleState) {
        match self.file.newest() {
            _ if state.renewing => self.renew(monitor),
            Some(baseline) => {
                monitor.follow(baseline.clone());
                state.cusum.into_iter().for_each(|cusum| monitor.restore_cusum(cusum));
                monitor.restore_aftercare(state.aftercare);
                monitor.restore_courses(&state.courses);
            }
            None if self.learn_cycles > 0 => {
                let begun = monitor.learn("commissioning", self.learn_cycles);
                begun.unwrap_or_else(|what| tracing::error!("{what}"));
            }
            None => {}
        }
    }

    /// Learns a new baseline from the next cycles; the older ones stay in the record. Nothing changes where the model cannot compare.
    pub(super) fn renew(&mut self, monitor: &mut Monitor) {
        let cycles = if self.learn_cycles > 0 { self.learn_cycles } else { USUAL_CYCLES };
        match monitor.learn("seal replaced", cycles) {
            Ok(()) => self.renewing = true,
            Err(what) => tracing::error!("no new baseline can be learned: {what}"),
        }
    }

    /// Keeps the monitor's baseline, if it is a new one or none could be written before. It is on disk when this returns, before the
    /// state may say that there is nothing to learn any more; a seal is replaced rarely enough to wait for the disk.
    ///
    /// # Errors
    /// Writing failed; it counts until the daemon ends.
    pub(super) fn keep(&mut self, monitor: &Monitor) -> io::Result<()> {
        if let Some(baseline) = monitor.baseline().filter(|baseline| self.file.newest() != Some(baseline)) {
            self.file.baselines.push(baseline.clone());
            self.unsaved = true;
        }
        if self.unsaved {
            self.path.parent().map_or(Ok(()), fs::create_dir_all)?;
            write_durably(&self.path, self.file.to_json()?.as_bytes())?;
            (self.unsaved, self.renewing) = (false, false);
        }
        Ok(())
    }
}

/// Moves a file into a folder that is made for it.
fn take_over(from: &Path, to: &Path) -> io::Result<()> {
    to.parent().map_or(Ok(()), fs::create_dir_all)?;
    fs::rename(from, to)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    use crate::config::embedded_model;
    use seepd_monitor::pipeline::{DutyCycle, Pipeline};

    /// Axis `press` with a duty cycle `1` and axis `press-1` had one file; what is in it is the latter's.
    #[test]
    fn no_two_duty_cycles_share_a_file() {
        let folder = tempfile::tempdir().unwrap();
        let model = embedded_model().unwrap();
        let former = folder.path().join("baseline-press-1.json");
        fs::write(&former, BaselineFile::new("press-1", &model).to_json().unwrap()).unwrap();
        let open = |axis: &str, name: Option<&str>| {
            let config = AxisConfig { axis: axis.into(), ..AxisConfig::default() };
            let duty_cycle = DutyCycle { name: name.map(str::to_owned), model: Arc::clone(&model) };
            let pipeline = Pipeline::new(config.monitor(vec![duty_cycle])).unwrap();
            BaselineRecord::open(folder.path(), &config, (0, &pipeline.monitors()[0])).path
        };
        let of_duty_cycle = open("press", Some("1"));
        assert_eq!(of_duty_cycle, folder.path().join("axes/press/baseline-1.json"));
        assert!(former.exists() && !of_duty_cycle.exists());
        let of_axis = open("press-1", None);
        assert_eq!(of_axis, folder.path().join("axes/press-1/baseline.json"));
        assert!(!former.exists() && of_axis.exists());
    }
}

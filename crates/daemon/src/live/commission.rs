//! A duty cycle's baselines on disk: `baseline-AXIS.json` in the state folder, of several duty cycles `baseline-AXIS-NAME.json`; the form
//! of `seepd learn-baseline`.

use std::io;
use std::path::{Path, PathBuf};

use super::state::{DutyCycleState, set_aside, write_durably};
use crate::baseline::BaselineFile;
use crate::config::Config;
use crate::pipeline::Monitor;

/// Cycles of a baseline that a person asks for where the configuration names none.
const USUAL_CYCLES: usize = 50;

/// Where a duty cycle's baselines are kept, and what is known of them.
#[derive(Debug)]
pub struct Record {
    path: PathBuf,
    file: BaselineFile,
    learn_cycles: usize,
    /// Whether a new baseline is being learned in the place of an older one.
    renewing: bool,
    /// Whether a baseline has been learned that is not on disk.
    unsaved: bool,
}

impl Record {
    /// What an earlier run has learned of the duty cycle of that index, or else what the configuration names. A file that cannot be
    /// used is told of and set aside.
    pub fn open(folder: &Path, config: &Config, (index, monitor): (usize, &Monitor<'_>)) -> Self {
        let of_duty_cycle = monitor.name().map_or(String::new(), |name| format!("-{name}"));
        let path = folder.join(format!("baseline-{}{of_duty_cycle}.json", config.axis));
        let model = monitor.model();
        let own = path.exists().then(|| BaselineFile::read(&path, model));
        let files = config.baseline_files();
        let given = || files.get(index).copied().flatten().map(|file| BaselineFile::read(file, model));
        let file = match own {
            Some(Err(failure)) => {
                let aside = set_aside(&path);
                tracing::error!(axis = config.axis, "{}; kept as {aside}", failure.message);
                given()
            }
            Some(good) => Some(good),
            None => given(),
        };
        let file = file.and_then(|read| {
            read.inspect_err(|failure| tracing::error!(axis = config.axis, "{}", failure.message)).ok()
        });
        let file = file.unwrap_or_else(|| BaselineFile::new(&config.axis, model));
        Record { path, file, learn_cycles: config.baseline.learn_cycles, renewing: false, unsaved: false }
    }

    /// Whether a new baseline is being learned in the place of an older one.
    pub fn is_renewing(&self) -> bool {
        self.renewing
    }

    /// Sets a monitor on its way as an earlier run left it: with the newest baseline, or to learn one.
    pub fn commission(&mut self, monitor: &mut Monitor<'_>, state: DutyCycleState) {
        match self.file.newest() {
            _ if state.renewing => self.renew(monitor),
            Some(baseline) => {
                monitor.follow(baseline.clone());
                state.drift.into_iter().for_each(|drift| monitor.restore_drift(drift));
            }
            None if self.learn_cycles > 0 => {
                let begun = monitor.learn("commissioning", self.learn_cycles);
                begun.unwrap_or_else(|what| tracing::error!("{what}"));
            }
            None => {}
        }
    }

    /// Learns a new baseline from the next cycles; the older ones stay in the record.
    pub fn renew(&mut self, monitor: &mut Monitor<'_>) {
        let cycles = if self.learn_cycles > 0 { self.learn_cycles } else { USUAL_CYCLES };
        match monitor.learn("seal replaced", cycles) {
            Ok(()) => self.renewing = true,
            Err(what) => tracing::error!("no new baseline: {what}"),
        }
    }

    /// Keeps the monitor's baseline, if it is a new one or none could be written before. It is on disk when this returns, before the
    /// state may say that there is nothing to learn any more; a seal is replaced rarely enough to wait for the disk.
    ///
    /// # Errors
    /// Writing failed; it counts until the daemon ends.
    pub fn keep(&mut self, monitor: &Monitor<'_>) -> io::Result<()> {
        if let Some(baseline) = monitor.baseline().filter(|baseline| self.file.newest() != Some(baseline)) {
            self.file.baselines.push(baseline.clone());
            self.unsaved = true;
        }
        if self.unsaved {
            write_durably(&self.path, self.file.to_json()?.as_bytes())?;
            (self.unsaved, self.renewing) = (false, false);
        }
        Ok(())
    }
}

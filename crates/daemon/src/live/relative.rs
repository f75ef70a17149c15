//! The baseline of an axis without a model, on disk: `axes/AXIS/relative-baseline.json` in the state folder.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use seepd_monitor::relative::{RelativeBaseline, RelativeMonitor, USUAL_CYCLES};

use super::state::RelativeState;
use crate::baseline_file;
use crate::config::AxisConfig;
use crate::durable::{set_aside, write_durably};

/// Where the baseline is kept, and what is known of it.
pub(super) struct RelativeRecord {
    path: PathBuf,
    axis: String,
    /// The one that counts: what an earlier run has learned, or else what the configuration names.
    baseline: Option<RelativeBaseline>,
    learn_cycles: usize,
    /// Whether a new baseline is being learned in the place of an older one.
    renewing: bool,
}

impl RelativeRecord {
    /// A file that cannot be used is told of; the daemon's own one is set aside.
    pub(super) fn open(folder: &Path, config: &AxisConfig) -> Self {
        let path = folder.join("axes").join(&config.axis).join("relative-baseline.json");
        let read = |file: &Path| {
            let read = baseline_file::read_relative(file, &config.axis);
            read.inspect_err(|failure| tracing::error!(axis = config.axis, "{}", failure.message)).ok()
        };
        let own = path.exists().then(|| read(&path));
        if own == Some(None) {
            tracing::error!(axis = config.axis, "the file is kept as {}", set_aside(&path));
        }
        let learned = config.baseline.learn_cycles;
        RelativeRecord {
            baseline: own.flatten().or_else(|| config.baseline.file.as_deref().and_then(read)),
            path,
            axis: config.axis.clone(),
            learn_cycles: if learned > 0 { learned } else { USUAL_CYCLES },
            renewing: false,
        }
    }

    /// Sets a monitor on its way as an earlier run left it: with the baseline, or to learn one.
    pub(super) fn commission(&mut self, monitor: &mut RelativeMonitor, state: RelativeState) {
        match self.baseline.clone() {
            _ if state.renewing => self.renew(monitor),
            None => monitor.learn("commissioning", self.learn_cycles),
            Some(baseline) => match monitor.follow(baseline) {
                Ok(()) => state.sums.into_iter().for_each(|sums| monitor.restore(sums)),
                Err(error) => tracing::error!(axis = self.axis, "{}: {error}", self.path.display()),
            },
        }
    }

    /// Learns a new baseline from the next cycles.
    pub(super) fn renew(&mut self, monitor: &mut RelativeMonitor) {
        monitor.learn("seal replaced", self.learn_cycles);
        self.renewing = true;
    }

    /// What outlives the program beside the file.
    pub(super) fn state(&self, monitor: &RelativeMonitor) -> RelativeState {
        RelativeState { sums: monitor.sums().cloned(), renewing: self.renewing }
    }

    /// Keeps the monitor's baseline, if it is a new one. It is on disk when this returns.
    ///
    /// # Errors
    /// Writing failed; it counts until the daemon ends.
    pub(super) fn keep(&mut self, monitor: &RelativeMonitor) -> io::Result<()> {
        let Some(baseline) = monitor.baseline().filter(|baseline| self.baseline.as_ref() != Some(baseline))
        else {
            return Ok(());
        };
        self.path.parent().map_or(Ok(()), fs::create_dir_all)?;
        write_durably(&self.path, baseline.to_json()?.as_bytes())?;
        (self.baseline, self.renewing) = (Some(baseline.clone()), false);
        Ok(())
    }
}

//! An axis's baselines on disk: `baseline-AXIS.json` in the state folder, the form of `seepd learn-baseline`.

use std::io;
use std::path::{Path, PathBuf};

use seepd_model::Model;

use super::state::{set_aside, write_durably};
use crate::baseline::{Baseline, BaselineFile};
use crate::config::Config;
use crate::pipeline::Pipeline;

/// Cycles of a baseline that a person asks for where the configuration names none.
const USUAL_CYCLES: usize = 50;

/// Where an axis's baselines are kept, and what is known of them.
#[derive(Debug)]
pub struct Record {
    path: PathBuf,
    file: BaselineFile,
    learn_cycles: usize,
}

impl Record {
    /// What an earlier run has learned, or else what the configuration names. A file that cannot be used is told of and set aside.
    pub fn open(folder: &Path, config: &Config, model: &Model) -> Self {
        let path = folder.join(format!("baseline-{}.json", config.axis));
        let own = path.exists().then(|| BaselineFile::read(&path, model));
        let given = || config.baseline.file.as_ref().map(|file| BaselineFile::read(file, model));
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
        Record { path, file, learn_cycles: config.baseline.learn_cycles }
    }

    /// Sets a pipeline on its way: with the newest baseline, or to learn one. `again` where one was being learned as an earlier run ended.
    pub fn commission(&self, pipeline: &mut Pipeline<'_>, again: bool) {
        match self.file.newest() {
            Some(baseline) if !again => pipeline.follow(baseline.clone()),
            None if self.learn_cycles > 0 => pipeline.learn("commissioning", self.learn_cycles),
            _ if again => self.renew(pipeline),
            _ => {}
        }
    }

    /// Learns a new baseline from the next cycles; the older ones stay in the record.
    pub fn renew(&self, pipeline: &mut Pipeline<'_>) {
        let cycles = if self.learn_cycles > 0 { self.learn_cycles } else { USUAL_CYCLES };
        pipeline.learn("seal replaced", cycles);
    }

    /// Adds a baseline. It is on disk when this returns, before the state may say that there is nothing to learn any more; a seal is
    /// replaced rarely enough to wait for the disk.
    ///
    /// # Errors
    /// Writing failed; it counts until the daemon ends.
    pub fn add(&mut self, baseline: Baseline) -> io::Result<()> {
        self.file.baselines.push(baseline);
        write_durably(&self.path, self.file.to_json()?.as_bytes())
    }
}

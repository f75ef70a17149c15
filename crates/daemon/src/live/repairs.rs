//! An axis's repair log, as the daemon keeps it: entries from page, API and broker, and those that people write into the file.

use std::collections::VecDeque;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use seepd_monitor::repair::Repair;

use crate::config::AxisConfig;
use crate::repair_log;

/// The file is looked at this often, ns.
const LOOK_NS: i64 = 5_000_000_000;

/// See the [module](self).
pub(super) struct RepairBook {
    path: PathBuf,
    axis: String,
    /// When the file was last changed, and its length.
    stamp: Option<(SystemTime, u64)>,
    looked_ns: Option<i64>,
    /// Entries whose time has not come, the oldest first.
    pending: VecDeque<Repair>,
    /// Entries that the disk has not taken.
    unwritten: Vec<Repair>,
    /// What is wrong with the file; told once.
    complaint: Option<String>,
}

impl RepairBook {
    /// The log that the configuration names, else the one in the state folder.
    pub(super) fn open(folder: &Path, config: &AxisConfig) -> Self {
        let path = config.repairs.clone().unwrap_or_else(|| repair_log::default_path(folder, &config.axis));
        RepairBook {
            path,
            axis: config.axis.clone(),
            stamp: None,
            looked_ns: None,
            pending: VecDeque::new(),
            unwritten: Vec::new(),
            complaint: None,
        }
    }

    /// Looks now and then whether the file has changed; entries that `is_known` knows are left out.
    pub(super) fn look(&mut self, now_ns: i64, is_known: impl Fn(&Repair) -> bool) {
        if self.looked_ns.is_some_and(|looked_ns| now_ns.saturating_sub(looked_ns) < LOOK_NS) {
            return;
        }
        self.looked_ns = Some(now_ns);
        self.write();
        let facts = fs::metadata(&self.path).ok();
        let stamp = facts.and_then(|facts| Some((facts.modified().ok()?, facts.len())));
        if stamp == self.stamp {
            return;
        }
        self.stamp = stamp;
        match repair_log::read(&self.path, &self.axis) {
            Ok(repairs) => {
                self.pending = repairs.into_iter().filter(|repair| !is_known(repair)).collect();
                self.heed(None);
            }
            Err(failure) => {
                self.heed(Some(format!("{}; its entries are not used until it is mended", failure.message)));
            }
        }
    }

    /// The next entry up to a time.
    #[inline]
    pub(super) fn next_until(&mut self, time_ns: i64) -> Option<Repair> {
        let is_due = self.pending.front().is_some_and(|repair| repair.at_ns <= time_ns);
        if is_due { self.pending.pop_front() } else { None }
    }

    /// Forgets the entries whose time has not come before a time: they are known.
    pub(super) fn skip_until(&mut self, time_ns: i64) -> Vec<Repair> {
        std::iter::from_fn(|| self.next_until(time_ns)).collect()
    }

    /// Adds an entry to the file; where the disk does not take it, it is tried again.
    pub(super) fn add(&mut self, repair: Repair) {
        self.unwritten.push(repair);
        self.write();
    }

    fn write(&mut self) {
        while let Some(repair) = self.unwritten.first() {
            match repair_log::append(&self.path, repair, &self.axis) {
                Ok(()) => drop(self.unwritten.remove(0)),
                Err(error) => {
                    let path = self.path.display();
                    let what = format!("{path}: a repair cannot be noted: {error}; trying again every 5 s");
                    return self.heed(Some(what));
                }
            }
        }
    }

    /// Tells a complaint once, and once that it has gone.
    fn heed(&mut self, complaint: Option<String>) {
        if complaint != self.complaint {
            let axis = &self.axis;
            match &complaint {
                Some(what) => tracing::error!(axis, "{what}"),
                None => tracing::info!(axis, "{}: the repair log can be used again", self.path.display()),
            }
        }
        self.complaint = complaint;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use seepd_monitor::repair::RepairKind;

    fn repair(at_ns: i64) -> Repair {
        Repair { at_ns, what: RepairKind::Other, who: None, note: None }
    }

    #[test]
    fn entries_of_page_and_editor_come_once_and_in_their_time() {
        let folder = tempfile::tempdir().unwrap();
        let config = AxisConfig { axis: "press".into(), ..AxisConfig::default() };
        let mut book = RepairBook::open(folder.path(), &config);
        book.look(0, |_| false);
        assert_eq!(book.next_until(i64::MAX), None);
        // From the page: it was heeded as it came.
        let own = repair(5_000_000_000);
        book.add(own.clone());
        // Somebody writes two with an editor, one of them for later.
        let path = repair_log::default_path(folder.path(), "press");
        for at_ns in [20_000_000_000, 10_000_000_000] {
            repair_log::append(&path, &repair(at_ns), "press").unwrap();
        }
        book.look(LOOK_NS - 1, |_| false);
        assert_eq!(book.next_until(i64::MAX), None, "it was not time to look");
        book.look(LOOK_NS, |known| known.is_same(&own));
        assert_eq!(book.next_until(10_000_000_000), Some(repair(10_000_000_000)));
        assert_eq!(book.next_until(10_000_000_000), None);
        assert_eq!(book.skip_until(i64::MAX), [repair(20_000_000_000)]);
    }

    #[test]
    fn what_the_disk_does_not_take_is_tried_again_and_a_damaged_file_stays() {
        let folder = tempfile::tempdir().unwrap();
        let config = AxisConfig { axis: "press".into(), ..AxisConfig::default() };
        let path = repair_log::default_path(folder.path(), "press");
        fs::create_dir_all(&path).unwrap();
        let mut book = RepairBook::open(folder.path(), &config);
        book.add(repair(1_000_000_000));
        assert!(book.complaint.as_ref().is_some_and(|what| what.contains("cannot be noted")));
        fs::remove_dir(&path).unwrap();
        book.look(0, |_| true);
        assert_eq!(repair_log::read(&path, "press").unwrap(), [repair(1_000_000_000)]);
        fs::write(&path, "[[repairs]\n").unwrap();
        book.look(LOOK_NS, |_| true);
        assert!(book.complaint.as_ref().is_some_and(|what| what.contains("until it is mended")));
        assert_eq!(fs::read_to_string(&path).unwrap(), "[[repairs]\n");
    }
}

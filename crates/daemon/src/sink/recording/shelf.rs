//! The recordings' folder: its files in the order in which they came, and the room that they may take.
//!
//! A gateway's clock may be set by decades. The files' order is therefore that of the numbers in their names, and a file
//! is as old as the time that later files have seen pass. What other programs leave of the disk may be less than is
//! configured: the recordings are the first to give way, so that state and events can still be written.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use nix::sys::statvfs::statvfs;

use crate::config::RecordingConfig;

/// Bytes in an MB.
pub(super) const MB: f64 = 1e6;
/// Stays free for the state and for events that wait for the broker: 20,000 of them, each in a block of 4 KiB, take 82 MB.
const RESERVE_BYTES: u64 = 100_000_000;
/// Of a small disk this share stays free.
const RESERVE_SHARE: u64 = 10;
/// Of what a small disk has room for, a file takes this share, so that what goes with the oldest is not all there is.
const FILES_ON_SMALL_DISK: u64 = 4;
/// A smaller file is not worth beginning: the least `file_mb`.
const LEAST_BYTES: u64 = 100_000;
/// More time than this between two files is none that passed: the clock was set, or nothing was recorded.
const LONGEST_PAUSE: Duration = Duration::from_secs(7 * 86_400);

/// See the [module](self).
pub(super) struct Shelf {
    pub(super) folder: PathBuf,
    pub(super) config: RecordingConfig,
}

/// A recording on the shelf.
struct Recorded {
    path: PathBuf,
    number: u64,
    bytes: u64,
    changed: SystemTime,
}

/// A disk's room, bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Disk {
    available: u64,
    reserve: u64,
}

impl Shelf {
    /// Begins a file after all that are there; its name tells the time of its first record, too.
    pub(super) fn create(&self, time_ns: i64) -> io::Result<(PathBuf, File)> {
        let stamp = jiff::Timestamp::from_nanosecond(i128::from(time_ns)).unwrap_or_default();
        let stamp = stamp.strftime("%Y%m%dT%H%M%SZ");
        let mut number = self.files()?.last().map_or(1, |newest| newest.number.saturating_add(1));
        loop {
            let path = self.folder.join(format!("seepd-{stamp}-{number:06}.mcap"));
            match File::create_new(&path) {
                Ok(file) => {
                    crate::durable::sync_folder(&path)?;
                    return Ok((path, file));
                }
                // `test-sinks` may have been faster.
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
                    number = number.saturating_add(1);
                }
                Err(error) => return Err(error),
            }
        }
    }

    /// Removes the oldest files until another one fits and none is too old; tells how large the other one may become, bytes.
    pub(super) fn make_room(&self) -> io::Result<u64> {
        let files = self.files()?;
        let disk = Disk::of(&self.folder)?;
        let on_disk = disk.room_for(files.iter().map(|file| file.bytes).sum());
        let next = (self.config.file_mb * MB).min((on_disk / FILES_ON_SMALL_DISK) as f64) as u64;
        let most = (self.config.total_mb * MB).min(on_disk as f64) as u64;
        for file in files.iter().take(self.surplus(&files, most.saturating_sub(next))) {
            fs::remove_file(&file.path)?;
        }
        if next < LEAST_BYTES {
            let message = format!(
                "the disk has no room besides the {:.1} MB that are kept free for state and events; free some space",
                disk.reserve as f64 / MB
            );
            return Err(io::Error::new(io::ErrorKind::StorageFull, message));
        }
        Ok(next)
    }

    /// Whether the disk has less room than must stay free.
    pub(super) fn is_short(&self) -> io::Result<bool> {
        let disk = Disk::of(&self.folder)?;
        Ok(disk.available < disk.reserve)
    }

    /// How many of the oldest files must go for the others to take no more than `most` bytes and none to be too old.
    fn surplus(&self, files: &[Recorded], most: u64) -> usize {
        let keep = Duration::from_secs_f64(self.config.keep_days * 86_400.0);
        let pause = LONGEST_PAUSE.max(Duration::from_secs_f64(2.0 * self.config.file_min * 60.0));
        let (mut bytes, mut age) = (0u64, Duration::ZERO);
        let mut after: Option<SystemTime> = None;
        for (index, file) in files.iter().enumerate().rev() {
            bytes = bytes.saturating_add(file.bytes);
            let passed = after.and_then(|after| after.duration_since(file.changed).ok());
            age += passed.filter(|passed| *passed <= pause).unwrap_or_default();
            after = Some(file.changed);
            if bytes > most || (!keep.is_zero() && age > keep) {
                return index + 1;
            }
        }
        0
    }

    /// The recordings, the oldest first.
    fn files(&self) -> io::Result<Vec<Recorded>> {
        let mut files = Vec::new();
        for entry in fs::read_dir(&self.folder)? {
            let entry = entry?;
            if let Some(number) = entry.file_name().to_str().and_then(number_of) {
                let facts = entry.metadata()?;
                files.push(Recorded {
                    path: entry.path(),
                    number,
                    bytes: facts.len(),
                    changed: facts.modified()?,
                });
            }
        }
        files.sort_by(|a, b| (a.number, &a.path).cmp(&(b.number, &b.path)));
        Ok(files)
    }
}

/// A recording's number: `seepd-20261122T080000Z-000042.mcap` is the 42nd. Names of the first version had none.
fn number_of(name: &str) -> Option<u64> {
    let (_, number) =
        name.strip_prefix("seepd-")?.strip_suffix(".mcap")?.rsplit_once('-').unwrap_or(("", "0"));
    number.parse().ok()
}

impl Disk {
    fn of(folder: &Path) -> io::Result<Self> {
        let facts = statvfs(folder)?;
        let unit = facts.fragment_size() as u64;
        let size = (facts.blocks() as u64).saturating_mul(unit);
        if size == 0 {
            // Some file systems do not tell; a write that fails will.
            return Ok(Disk { available: u64::MAX, reserve: 0 });
        }
        let available = (facts.blocks_available() as u64).saturating_mul(unit);
        Ok(Disk { available, reserve: RESERVE_BYTES.min(size / RESERVE_SHARE) })
    }

    /// What recordings may take in all that take so much now, bytes.
    fn room_for(self, taken: u64) -> u64 {
        taken.saturating_add(self.available).saturating_sub(self.reserve)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DAY_S: u64 = 86_400;

    fn shelf(folder: &Path, keep_days: f64) -> Shelf {
        Shelf {
            folder: folder.to_owned(),
            config: RecordingConfig { keep_days, ..RecordingConfig::default() },
        }
    }

    /// Files of 10 bytes, changed at these days.
    fn of_days(days: &[u64]) -> Vec<Recorded> {
        let file = |(number, day): (usize, &u64)| Recorded {
            path: PathBuf::from(number.to_string()),
            number: number as u64,
            bytes: 10,
            changed: SystemTime::UNIX_EPOCH + Duration::from_secs(day * DAY_S),
        };
        days.iter().enumerate().map(file).collect()
    }

    #[test]
    fn the_oldest_go_by_size_and_by_age() {
        let shelf = shelf(Path::new("."), 30.0);
        let files = of_days(&[0, 5, 10, 15, 20, 25, 31, 36]);
        assert_eq!(shelf.surplus(&files, 1000), 2);
        assert_eq!(shelf.surplus(&files, 30), 5);
        assert_eq!(shelf.surplus(&files, 0), 8);
        assert_eq!(shelf.surplus(&[], 0), 0);
    }

    #[test]
    fn a_clock_that_is_set_by_decades_makes_no_file_old() {
        let shelf = shelf(Path::new("."), 30.0);
        let ahead = 20_000 + 365 * 70;
        for days in [vec![20_000, 20_001, ahead, ahead + 1], vec![0, 1, 20_000], vec![ahead, 20_000, 20_001]]
        {
            assert_eq!(shelf.surplus(&of_days(&days), 1000), 0, "{days:?}");
        }
        // Time that passes on either side of the jump still counts.
        let days: Vec<u64> = (20_000..20_020).chain(ahead..ahead + 20).collect();
        assert_eq!(shelf.surplus(&of_days(&days), 1000), 8);
    }

    #[test]
    fn files_come_in_the_order_in_which_they_were_begun_whatever_the_clock_said() {
        let folder = tempfile::tempdir().unwrap();
        let shelf = shelf(folder.path(), 0.0);
        fs::write(folder.path().join("seepd-20260101T000000Z.mcap"), "of the first version").unwrap();
        fs::write(folder.path().join("other.mcap"), "not ours").unwrap();
        for time_s in [4_000_000_000, 0, 1_800_000_000] {
            shelf.create(time_s * 1_000_000_000).unwrap();
        }
        let names: Vec<String> =
            shelf.files().unwrap().iter().map(|file| file.path.display().to_string()).collect();
        let ends = [
            "20260101T000000Z",
            "20961002T070640Z-000001",
            "19700101T000000Z-000002",
            "20270115T080000Z-000003",
        ];
        assert_eq!(names.len(), ends.len());
        for (name, end) in names.iter().zip(ends) {
            assert!(name.ends_with(&format!("seepd-{end}.mcap")), "{name}");
        }
    }

    #[test]
    fn recordings_give_way_where_others_fill_the_disk() {
        let disk = |available| Disk { available, reserve: 100 };
        assert_eq!(disk(500).room_for(50), 450);
        assert_eq!(disk(0).room_for(150), 50);
        assert_eq!(disk(0).room_for(50), 0);
        assert_eq!(Disk { available: u64::MAX, reserve: 0 }.room_for(50), u64::MAX);
    }
}

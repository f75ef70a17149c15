//! What kind of log a file is, by its first bytes, whatever its name.

use crate::can::text_log::TextFormat;
use crate::can::{blf, busmaster, candump::looks_like_candump, savvycan};
use crate::error::LogError;
use crate::window::find;

/// First bytes of an MCAP file.
pub const MCAP_MAGIC: &[u8; 8] = b"\x89MCAP0\r\n";

/// The kinds of logs that are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum LogKind {
    /// MCAP.
    Mcap,
    /// Text with a column for each signal.
    Csv,
    /// Text with a line for each frame of a bus.
    Frames(TextFormat),
    /// Vector's binary log of a bus.
    Blf,
    /// ASAM MDF 4: a bus's frames or measured signals.
    Mdf,
    /// A ROS 2 bag in SQLite's format.
    Bag,
}

/// Bytes of a log's head by which its kind is told.
pub(crate) const HEAD_BYTES: usize = 512;

/// Logs that are not read: first bytes, name, what to do.
const REFUSED: &[(&[u8], &str, &str)] = &[
    (
        b"#ROSBAG V",
        "a ROS 1 bag",
        "convert it: pip install rosbags; rosbags-convert --src LOG --dst FOLDER --dst-storage mcap",
    ),
    (b"ULog\x01", "a ULog", "convert it: pip install pyulog; ulog2csv LOG"),
    (
        b"PAR1",
        "a Parquet file",
        "convert it: pip install pyarrow; python3 -c \"import sys, pyarrow.parquet as p, pyarrow.csv as c; c.write_csv(p.read_table(sys.argv[1]), 'log.csv')\" LOG",
    ),
    (b"\x89HDF\r\n", "an HDF5 file, perhaps from MATLAB", "export it as CSV"),
    (b"MATLAB 5.0 MAT-file", "a MATLAB file", "export it as CSV"),
    (
        b"TDSm",
        "a LabVIEW TDMS file",
        "convert it: pip install npTDMS pandas; python3 -c \"import sys, nptdms; nptdms.TdmsFile.read(sys.argv[1]).as_dataframe(time_index=True).to_csv('log.csv', index_label='t_s')\" LOG",
    ),
    (b"\xfd7zXZ\0", "an xz archive", "unpack it first: xz -dk LOG"),
    (b"BZh", "a bzip2 archive", "unpack it first: bunzip2 -k LOG"),
    (b"PK\x03\x04", "a ZIP archive", "unpack it first"),
    (b"\x0a\x0d\x0d\x0a", "a pcapng capture", CONVERT_CAPTURE),
    (b"\xd4\xc3\xb2\xa1", "a pcap capture", CONVERT_CAPTURE),
];
const CONVERT_CAPTURE: &str = "record with `candump -l`, or convert it to that format";

impl LogKind {
    /// Tells a log's kind by its first bytes, of which 512 are enough.
    ///
    /// # Errors
    /// [`LogError`] for kinds that are not read, by name where it is known.
    pub fn of(head: &[u8], name: &str) -> Result<Self, LogError> {
        let text = head.strip_prefix(b"\xef\xbb\xbf").unwrap_or(head);
        if head.is_empty() {
            Err(LogError::data(name, "the file is empty"))
        } else if head.starts_with(&MCAP_MAGIC[..head.len().min(8)]) {
            Ok(LogKind::Mcap)
        } else if let Some((_, kind, advice)) = REFUSED.iter().find(|(magic, ..)| text.starts_with(magic)) {
            Err(LogError::data(name, format!("this is {kind}, which is not read; {advice}")))
        } else if head.starts_with(blf::MAGIC) {
            Ok(LogKind::Blf)
        } else if head.starts_with(b"MDF     ") || head.starts_with(b"UnFinMF ") {
            Ok(LogKind::Mdf)
        } else if head.starts_with(b"SQLite format 3\0") {
            Ok(LogKind::Bag)
        } else if !looks_like_text(head) {
            Err(LogError::data(name, "this is of no kind that is read; docs/logs.md has those that are"))
        } else if looks_like_candump(text) {
            Ok(LogKind::Frames(TextFormat::Candump))
        } else if let Some(format) = frames_of_text(text) {
            Ok(LogKind::Frames(format))
        } else if looks_like_candump_screen(text) {
            Err(LogError::data(
                name,
                "this is what candump shows on the screen, which is not read; record with `candump -l` or `-L`",
            ))
        } else {
            Ok(LogKind::Csv)
        }
    }

    /// What people call it.
    pub fn name(self) -> &'static str {
        match self {
            LogKind::Mcap => "MCAP",
            LogKind::Csv => "CSV",
            LogKind::Frames(format) => format.name(),
            LogKind::Blf => "Vector BLF",
            LogKind::Mdf => "MDF",
            LogKind::Bag => "ROS 2 bag",
        }
    }
}

/// A text of a line a frame, by its first lines.
fn frames_of_text(head: &[u8]) -> Option<TextFormat> {
    let begins =
        |words: &[u8]| head.get(..words.len()).is_some_and(|begin| begin.eq_ignore_ascii_case(words));
    if head.starts_with(busmaster::HEAD) {
        Some(TextFormat::Busmaster)
    } else if head.starts_with(savvycan::HEAD) {
        Some(TextFormat::SavvyCan)
    } else if begins(b"date ") || begins(b"base hex") || begins(b"base dec") {
        Some(TextFormat::Asc)
    } else if begins(b";")
        && [&b"$FILEVERSION"[..], b"PCAN", b"Start time:"].iter().any(|mark| find(head, mark).is_some())
    {
        Some(TextFormat::Trc)
    } else {
        None
    }
}

fn looks_like_text(head: &[u8]) -> bool {
    let printable = |byte: &u8| matches!(byte, b'\t' | b'\n' | b'\r' | 0x20..=0x7e | 0x80..);
    head.iter().all(printable)
        && std::str::from_utf8(head).map_or_else(|error| error.error_len().is_none(), |_| true)
}

/// `  can0  123   [8]  11 22 33 44`, perhaps with a time before it.
fn looks_like_candump_screen(head: &[u8]) -> bool {
    let first = head.split(|byte| *byte == b'\n').find(|line| !line.trim_ascii().is_empty());
    let words: Vec<&[u8]> =
        first.unwrap_or_default().split(u8::is_ascii_whitespace).filter(|word| !word.is_empty()).collect();
    let is_length = |word: &&[u8]| {
        word.strip_prefix(b"[")
            .and_then(|word| word.strip_suffix(b"]"))
            .is_some_and(|length| !length.is_empty() && length.iter().all(u8::is_ascii_digit))
    };
    words.iter().position(is_length).is_some_and(|at| (2..=4).contains(&at))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(head: &[u8]) -> Result<LogKind, String> {
        LogKind::of(head, "log").map_err(|error| error.to_string())
    }

    #[test]
    fn kinds_are_told_by_content() {
        use TextFormat::{Asc, Busmaster, Candump, SavvyCan, Trc};
        for (head, kind) in [
            (&b"\x89MCAP0\r\n..."[..], LogKind::Mcap),
            (b"\x89MC", LogKind::Mcap),
            (b"t_s,command\n0,0\n", LogKind::Csv),
            (b"; a comment of a scope\nt_s;command\n", LogKind::Csv),
            (b"(1436509052.249713) can0 044#2A36\n", LogKind::Frames(Candump)),
            (b"\n (1.0) can0 044#\n", LogKind::Frames(Candump)),
            (b"***BUSMASTER Ver 2.4.0***\r\n", LogKind::Frames(Busmaster)),
            (
                b"\xef\xbb\xbfdate Thu Jan 1 00:00:00 1970\nbase hex timestamps absolute\n",
                LogKind::Frames(Asc),
            ),
            (b";$FILEVERSION=2.1\r\n;$STARTTIME=43474.4\r\n", LogKind::Frames(Trc)),
            (b";####\n;   C:\\log.trc\n;\n;    Start time: 1.1.2020\n", LogKind::Frames(Trc)),
            (b"Time Stamp,ID,Extended,Dir,Bus,LEN,D1\n", LogKind::Frames(SavvyCan)),
            (b"LOGG\x90\0\0\0", LogKind::Blf),
            (b"MDF     4.10    ", LogKind::Mdf),
            (b"SQLite format 3\0\x10", LogKind::Bag),
        ] {
            assert_eq!(told(head), Ok(kind), "{}", String::from_utf8_lossy(head));
        }
    }

    #[test]
    fn others_are_refused_by_name() {
        for (head, name) in [
            (&b"TDSm\x0e\0\0\0"[..], "TDMS"),
            (b"#ROSBAG V2.0\n", "ROS 1 bag"),
            (b"PK\x03\x04", "ZIP"),
            (b"  can0  123   [8]  11 22 33 44 55 66 77 88\n", "candump -l"),
            (b" (1436509052.249713)  can0  123   [2]  11 22\n", "candump -l"),
            (b"\0\x01\x02\x03", "of no kind that is read"),
        ] {
            let message = told(head).unwrap_err();
            assert!(message.contains(name), "{message}");
        }
        assert_eq!(told(b""), Err("log: the file is empty".into()));
    }
}

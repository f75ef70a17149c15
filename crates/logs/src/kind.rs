//! What kind of log a file is, by its first bytes, whatever its name.

use crate::can::candump::looks_like_candump;
use crate::error::LogError;

/// First bytes of an MCAP file.
pub const MCAP_MAGIC: &[u8; 8] = b"\x89MCAP0\r\n";

/// The kinds of logs that are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LogKind {
    /// MCAP.
    Mcap,
    /// Text with a header row.
    Csv,
    /// Text of `candump -l`.
    Candump,
}

/// Bytes of a log's head by which its kind is told.
pub(crate) const HEAD_BYTES: usize = 512;

/// Logs that are not read: first bytes, name, what to do.
const REFUSED: &[(&[u8], &str, &str)] = &[
    (b"***BUSMASTER", "a BUSMASTER log", CONVERT_CAN),
    (b";$FILEVERSION", "a PCAN trace (.trc)", CONVERT_CAN),
    (b"date ", "a Vector ASC log", CONVERT_CAN),
    (b"LOGG", "a Vector BLF log", CONVERT_CAN),
    (b"MDF ", "an ASAM MDF log", CONVERT_CAN),
    (b"UnFinMF ", "an unfinished ASAM MDF log", CONVERT_CAN),
    (b"Time Stamp,ID,Extended,", "a SavvyCAN (GVRET) log", CONVERT_CAN),
    (b"#ROSBAG V", "a ROS 1 bag", "convert it to MCAP"),
    (b"SQLite format 3\0", "an SQLite file, perhaps a ROS 2 bag", "convert it to MCAP"),
    (b"ULog\x01", "a ULog", "convert it to MCAP or CSV"),
    (b"PAR1", "a Parquet file", "export it as CSV"),
    (b"\x89HDF\r\n", "an HDF5 file, perhaps from MATLAB", "export it as CSV"),
    (b"MATLAB 5.0 MAT-file", "a MATLAB file", "export it as CSV"),
    (b"TDSm", "a LabVIEW TDMS file", "export it as CSV"),
    (b"\x1f\x8b", "a gzip archive", UNPACK),
    (b"\x28\xb5\x2f\xfd", "a zstd archive", UNPACK),
    (b"\xfd7zXZ\0", "an xz archive", UNPACK),
    (b"BZh", "a bzip2 archive", UNPACK),
    (b"PK\x03\x04", "a ZIP archive", UNPACK),
    (b"\x0a\x0d\x0d\x0a", "a pcapng capture", CONVERT_CAN),
    (b"\xd4\xc3\xb2\xa1", "a pcap capture", CONVERT_CAN),
];
const CONVERT_CAN: &str = "convert it to the format of `candump -l`, or to CSV or MCAP";
const UNPACK: &str = "unpack it first";

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
        } else if !looks_like_text(head) {
            Err(LogError::data(
                name,
                "this is neither an MCAP log nor a text (CSV with a header row, or candump -l)",
            ))
        } else if looks_like_candump(text) {
            Ok(LogKind::Candump)
        } else if looks_like_candump_screen(text) {
            Err(LogError::data(
                name,
                "this is what candump shows on the screen, which is not read; record with `candump -l` or `-L`",
            ))
        } else {
            Ok(LogKind::Csv)
        }
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
        assert_eq!(told(b"\x89MCAP0\r\n..."), Ok(LogKind::Mcap));
        assert_eq!(told(b"\x89MC"), Ok(LogKind::Mcap));
        assert_eq!(told(b"t_s,command\n0,0\n"), Ok(LogKind::Csv));
        assert_eq!(told(b"(1436509052.249713) can0 044#2A36\n"), Ok(LogKind::Candump));
        assert_eq!(told(b"\n (1.0) can0 044#\n"), Ok(LogKind::Candump));
    }

    #[test]
    fn others_are_refused_by_name() {
        for (head, name) in [
            (&b"***BUSMASTER Ver 2.4.0***\r\n"[..], "BUSMASTER"),
            (b"\xef\xbb\xbfdate Thu Jan 1 00:00:00 1970\nbase hex timestamps absolute\n", "Vector ASC"),
            (b"LOGG\x90\0\0\0", "Vector BLF"),
            (b"SQLite format 3\0\x10", "SQLite"),
            (b"\x1f\x8b\x08\0", "gzip"),
            (b"  can0  123   [8]  11 22 33 44 55 66 77 88\n", "candump -l"),
            (b" (1436509052.249713)  can0  123   [2]  11 22\n", "candump -l"),
            (b"\0\x01\x02\x03", "neither an MCAP log"),
        ] {
            let message = told(head).unwrap_err();
            assert!(message.contains(name), "{message}");
        }
        assert_eq!(told(b""), Err("log: the file is empty".into()));
    }
}

//! Files that are read whole: configuration, plant, model, baseline, DBC, secrets, certificates, state.
//!
//! One that is no regular file is refused before it is opened: a FIFO keeps whoever opens it waiting for somebody who writes,
//! and in the daemon everything waits with it.

use std::fs;
use std::io;
use std::path::Path;

/// A file's bytes.
///
/// # Errors
/// It cannot be read, or is a FIFO, a device or a folder.
pub fn read(path: &Path) -> io::Result<Vec<u8>> {
    refuse_what_may_block(path)?;
    fs::read(path)
}

/// A file's text: UTF-8, or UTF-16 where its first two bytes say so, as what Windows' shell writes with `>`.
///
/// # Errors
/// As [`read`], or it is neither.
pub fn read_text(path: &Path) -> io::Result<String> {
    let bytes = read(path)?;
    let text = match bytes.as_slice() {
        [0xff, 0xfe, units @ ..] => utf16(units, u16::from_le_bytes),
        [0xfe, 0xff, units @ ..] => utf16(units, u16::from_be_bytes),
        _ => String::from_utf8(bytes).ok(),
    };
    text.ok_or_else(|| io::Error::new(io::ErrorKind::InvalidData, "this is no text in UTF-8"))
}

fn utf16(units: &[u8], unit: fn([u8; 2]) -> u16) -> Option<String> {
    let (units, rest) = units.as_chunks();
    let whole = rest.is_empty().then(|| char::decode_utf16(units.iter().map(|bytes| unit(*bytes))));
    whole?.collect::<Result<_, _>>().ok()
}

fn refuse_what_may_block(path: &Path) -> io::Result<()> {
    if fs::metadata(path)?.is_file() {
        return Ok(());
    }
    Err(io::Error::new(io::ErrorKind::InvalidInput, "this is not a regular file, which is needed here"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_read_in_the_encodings_that_shells_write() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("seepd.toml");
        let text = "flow = \"4 … 5 l/min\" # 𝛥p";
        let units = |order: fn(u16) -> [u8; 2]| text.encode_utf16().flat_map(order).collect::<Vec<u8>>();
        let little = [&[0xff, 0xfe][..], &units(u16::to_le_bytes)].concat();
        let big = [&[0xfe, 0xff][..], &units(u16::to_be_bytes)].concat();
        for bytes in [text.as_bytes(), &little, &big] {
            fs::write(&path, bytes).unwrap();
            assert_eq!(read_text(&path).unwrap(), text);
        }
        let half_a_unit = &little[..little.len() - 1];
        let half_a_pair = &[0xff, 0xfe, 0x35, 0xd8][..];
        for bytes in [half_a_unit, half_a_pair, &b"caf\xe9"[..]] {
            fs::write(&path, bytes).unwrap();
            assert_eq!(read_text(&path).unwrap_err().kind(), io::ErrorKind::InvalidData);
        }
    }

    #[test]
    fn devices_and_folders_are_refused_and_missing_files_are_missing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("seepd.toml");
        assert_eq!(read(&path).unwrap_err().kind(), io::ErrorKind::NotFound);
        fs::write(&path, "text").unwrap();
        assert_eq!((read(&path).unwrap(), read_text(&path).unwrap()), (b"text".to_vec(), "text".to_owned()));
        for other in [folder.path(), Path::new("/dev/zero")] {
            assert_eq!(read(other).unwrap_err().kind(), io::ErrorKind::InvalidInput, "{}", other.display());
        }
    }
}

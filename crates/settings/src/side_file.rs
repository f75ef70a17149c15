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

/// A file's text.
///
/// # Errors
/// As [`read`], or it is no UTF-8.
pub fn read_text(path: &Path) -> io::Result<String> {
    refuse_what_may_block(path)?;
    fs::read_to_string(path)
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

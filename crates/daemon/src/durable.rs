//! Files that a power cut leaves whole.

use std::fs::{self, File};
use std::io::{self, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// Puts a file in place whole: after a power cut there is the old one or the new one.
///
/// # Errors
/// Writing failed; the old one is untouched.
pub(crate) fn write_durably(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let new = path.with_extension("new");
    write_new(&new, bytes).and_then(|()| fs::rename(&new, path)).inspect_err(|_| {
        // Half a file would take room that the next try needs.
        let _ = fs::remove_file(&new);
    })?;
    sync_folder(path)
}

/// Writes a file that only this program has made: neither one that a cut has left nor a link that somebody has put there.
fn write_new(path: &Path, bytes: &[u8]) -> io::Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    let mut file = File::create_new(path)?;
    file.write_all(bytes)?;
    file.sync_all()
}

/// Makes a folder's entries durable.
///
/// # Errors
/// The folder cannot be opened.
pub(crate) fn sync_folder(of_file: &Path) -> io::Result<()> {
    of_file.parent().map_or(Ok(()), |folder| File::open(folder)?.sync_all())
}

/// Whether an open file is still the one at its path: somebody may have removed it, or its disk may have gone.
pub(crate) fn is_in_place(file: &File, path: &Path) -> bool {
    let facts = (file.metadata(), fs::symlink_metadata(path));
    matches!(facts, (Ok(open), Ok(there)) if (open.dev(), open.ino()) == (there.dev(), there.ino()))
}

/// Moves a file that cannot be read out of the way; tells its new name.
pub(crate) fn set_aside(path: &Path) -> String {
    let taken = |number: &u32| path.with_extension(format!("damaged-{number}"));
    let free = (1..1000).map(|number| taken(&number)).find(|aside| !aside.exists());
    let aside: PathBuf = free.unwrap_or_else(|| taken(&0));
    match fs::rename(path, &aside) {
        Ok(()) => aside.display().to_string(),
        Err(error) => format!("it was ({error})"),
    }
}

//! A folder for a while, for what must not outlive a command.

use std::fs::{self, DirBuilder};
use std::io;
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};

use crate::live::run_name;

/// A folder that nobody else has made, can foretell or can write into; it goes with its owner. Others write into the temporary folder, and
/// a link that they put there must not be followed, by root least of all.
pub(crate) struct PrivateFolder(PathBuf);

impl PrivateFolder {
    /// Makes one for a purpose, which is in its name.
    ///
    /// # Errors
    /// The temporary folder cannot be written.
    pub(crate) fn make(purpose: &str) -> io::Result<Self> {
        let path = std::env::temp_dir().join(format!("seepd-{purpose}-{}", run_name()));
        DirBuilder::new().mode(0o700).create(&path)?;
        Ok(PrivateFolder(path))
    }

    /// Where it is.
    pub(crate) fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for PrivateFolder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::MetadataExt;

    #[test]
    fn each_is_a_folder_of_its_own_that_goes_with_its_owner() {
        let (one, other) = (PrivateFolder::make("test").unwrap(), PrivateFolder::make("test").unwrap());
        assert_ne!(one.path(), other.path());
        assert_eq!(fs::metadata(one.path()).unwrap().mode() & 0o777, 0o700);
        let path = one.path().to_owned();
        drop(one);
        assert!(!path.exists());
    }
}

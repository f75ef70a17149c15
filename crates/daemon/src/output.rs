//! Files that commands write: whole or not at all, over nothing that is there unless asked, and never over what is read.
//!
//! A file is written beside its place and takes it once it is complete, so that a command that fails leaves what was there.
//! Pipes, devices and standard output have no such place and are written as they are.

use std::fs::{self, File, Permissions};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use clap::Args;

use crate::failure::{Code, Failure};

/// Names that are tried for a file that is not complete yet; more than one is left over by runs that were killed.
const PARTS: u32 = 1000;

/// The one rule for files that are there already.
#[derive(Debug, Clone, Copy, Default, Args)]
pub struct OverwriteArguments {
    /// Write over files that exist
    #[arg(long)]
    pub force: bool,
}

/// The files of one run of a command: those that it reads, and those that it is to write.
#[derive(Debug)]
pub struct Outputs {
    overwrite: bool,
    inputs: Vec<FileId>,
    claimed: Vec<PathBuf>,
}

/// Device and number on it: the same under every name. Nothing is opened, as a pipe would wait.
#[cfg(unix)]
type FileId = (u64, u64);

#[cfg(unix)]
fn id_of(path: &Path) -> Option<FileId> {
    use std::os::unix::fs::MetadataExt;
    fs::metadata(path).ok().map(|facts| (facts.dev(), facts.ino()))
}

/// Where the system does not tell of files without opening them: the whole path, which hard links differ in.
#[cfg(not(unix))]
type FileId = PathBuf;

#[cfg(not(unix))]
fn id_of(path: &Path) -> Option<FileId> {
    fs::canonicalize(path).ok()
}

impl Outputs {
    /// Outputs of a command that reads these files; one that is missing is told of by whoever reads it.
    pub fn new<'a>(
        OverwriteArguments { force }: OverwriteArguments,
        inputs: impl IntoIterator<Item = &'a Path>,
    ) -> Self {
        let inputs = inputs.into_iter().filter_map(id_of).collect();
        Outputs { overwrite: force, inputs, claimed: Vec::new() }
    }

    /// Checks, before the work, that a file may be written. Nothing is touched yet.
    ///
    /// # Errors
    /// [`Failure`] where it exists and may not be written over, is one of the inputs or another output, or has no folder.
    pub fn claim(&mut self, path: &Path) -> Result<Output, Failure> {
        let refused = |why: &str| Err(Failure::new(Code::Usage, format!("{}: {why}", path.display())));
        if id_of(path).is_some_and(|id| self.inputs.contains(&id)) {
            return refused("is read by this very command; name another file to write");
        }
        let place = match fs::metadata(path) {
            Ok(facts) if facts.is_dir() => return refused("is a folder; name a file to write"),
            Ok(facts) if !facts.is_file() || is_descriptor(path) => return Ok(Output::as_it_is(path)),
            Ok(_) if !self.overwrite => return refused("is there already; --force writes over it"),
            // Through a link, so that the link stays.
            Ok(_) => fs::canonicalize(path),
            Err(error) if error.kind() == io::ErrorKind::NotFound => in_its_folder(path),
            Err(error) => Err(error),
        };
        let place = place.map_err(|error| Failure::writing(path, error))?;
        if self.claimed.contains(&place) {
            return refused("is named for two outputs; name two files");
        }
        self.claimed.push(place.clone());
        Ok(Output { path: path.to_owned(), place: Some(place) })
    }

    /// As [`claim`](Self::claim), for a file that may be left out.
    ///
    /// # Errors
    /// As [`claim`](Self::claim).
    pub fn claim_any(&mut self, path: Option<&PathBuf>) -> Result<Option<Output>, Failure> {
        path.map(|path| self.claim(path)).transpose()
    }
}

/// The path of a file that does not exist, by its folder's own name.
fn in_its_folder(path: &Path) -> io::Result<PathBuf> {
    let name = path.file_name().ok_or(io::ErrorKind::InvalidFilename)?;
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    Ok(fs::canonicalize(folder.unwrap_or(Path::new(".")))?.join(name))
}

/// Whether a path names what this process has open, which a shell may have pointed at a file.
fn is_descriptor(path: &Path) -> bool {
    path == Path::new("/dev/stdout")
        || path == Path::new("/dev/stderr")
        || path.starts_with("/dev/fd")
        || path.starts_with("/proc/self/fd")
}

/// A file that may be written.
#[derive(Debug)]
pub struct Output {
    path: PathBuf,
    /// Where it takes its place; pipes and devices have none.
    place: Option<PathBuf>,
}

impl Output {
    fn as_it_is(path: &Path) -> Self {
        Output { path: path.to_owned(), place: None }
    }

    /// The path as it was given.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Writes the whole file.
    ///
    /// # Errors
    /// [`Failure`] where writing failed; what was there is untouched.
    pub fn write(&self, content: impl AsRef<[u8]>) -> Result<(), Failure> {
        let mut file = self.create()?;
        file.write_all(content.as_ref()).map_err(|error| Failure::writing(&self.path, error))?;
        file.finish()
    }

    /// Begins the file, which takes its place when it is [finished](OutputFile::finish).
    ///
    /// # Errors
    /// [`Failure`] where it cannot be made.
    pub fn create(&self) -> Result<OutputFile, Failure> {
        let begun = match &self.place {
            Some(place) => Part::create(place).map(|(file, part)| (file, Some(part))),
            None => open_as_it_is(&self.path).map(|file| (file, None)),
        };
        let (file, part) = begun.map_err(|error| Failure::writing(&self.path, error))?;
        Ok(OutputFile { file: BufWriter::new(file), part, path: self.path.clone() })
    }
}

fn open_as_it_is(path: &Path) -> io::Result<File> {
    #[cfg(unix)]
    if path == Path::new("/dev/stdout") {
        use std::os::fd::AsFd;
        // Opened anew, a file that the shell has put there would be written from its beginning.
        return io::stdout().as_fd().try_clone_to_owned().map(File::from);
    }
    File::options().write(true).open(path)
}

/// A file on its way to its place; it goes where it is not finished.
#[derive(Debug)]
pub struct OutputFile {
    file: BufWriter<File>,
    part: Option<Part>,
    path: PathBuf,
}

impl OutputFile {
    /// Puts the file in its place.
    ///
    /// # Errors
    /// [`Failure`] where writing failed; what was there is untouched.
    pub fn finish(mut self) -> Result<(), Failure> {
        let written = self.file.flush().and_then(|()| match self.part.take() {
            Some(part) => part.put_in_place(self.file.get_ref()).inspect_err(|_| part.remove()),
            None => Ok(()),
        });
        written.map_err(|error| Failure::writing(&self.path, error))
    }
}

impl Drop for OutputFile {
    fn drop(&mut self) {
        if let Some(part) = self.part.take() {
            part.remove();
        }
    }
}

impl Write for OutputFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

/// The incomplete file: `press.mcap.part` beside `press.mcap`.
#[derive(Debug)]
struct Part {
    path: PathBuf,
    place: PathBuf,
}

impl Part {
    fn create(place: &Path) -> io::Result<(File, Part)> {
        for number in 0..PARTS {
            let mut name = place.file_name().unwrap_or_default().to_owned();
            name.push(if number == 0 { ".part".to_owned() } else { format!(".part-{number}") });
            let path = place.with_file_name(name);
            // A name that is taken, be it by a link, is left alone.
            match File::create_new(&path) {
                Ok(file) => return Ok((file, Part { path, place: place.to_owned() })),
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                Err(error) => return Err(error),
            }
        }
        Err(io::Error::other("a thousand .part files lie beside it; remove them"))
    }

    fn put_in_place(&self, file: &File) -> io::Result<()> {
        if let Some(permissions) = permissions_of(&self.place) {
            file.set_permissions(permissions)?;
        }
        file.sync_all()?;
        fs::rename(&self.path, &self.place)
    }

    fn remove(&self) {
        // Where it cannot be removed, its name says what it is.
        let _ = fs::remove_file(&self.path);
    }
}

fn permissions_of(path: &Path) -> Option<Permissions> {
    fs::metadata(path).ok().map(|facts| facts.permissions())
}

#[cfg(test)]
mod tests {
    use super::*;

    const FORCE: OverwriteArguments = OverwriteArguments { force: true };
    const NO_FORCE: OverwriteArguments = OverwriteArguments { force: false };

    fn message(result: Result<Output, Failure>) -> String {
        result.unwrap_err().message
    }

    #[test]
    fn a_file_takes_its_place_when_it_is_complete_and_not_before() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("page.html");
        fs::write(&path, "old").unwrap();
        let output = Outputs::new(FORCE, []).claim(&path).unwrap();
        let mut file = output.create().unwrap();
        file.write_all(b"half of the n").unwrap();
        drop(file);
        assert_eq!(fs::read_to_string(&path).unwrap(), "old");
        output.write("new").unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "new");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn what_exists_is_written_over_when_asked_through_a_link_and_with_its_mode() {
        use std::os::unix::fs::{MetadataExt, PermissionsExt, symlink};
        let folder = tempfile::tempdir().unwrap();
        let (path, link) = (folder.path().join("seepd.toml"), folder.path().join("link"));
        fs::write(&path, "old").unwrap();
        fs::set_permissions(&path, Permissions::from_mode(0o600)).unwrap();
        symlink(&path, &link).unwrap();
        for name in [&path, &link] {
            let text = message(Outputs::new(NO_FORCE, []).claim(name));
            assert!(text.ends_with("is there already; --force writes over it"), "{text}");
        }
        Outputs::new(FORCE, []).claim(&link).unwrap().write("new").unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::read_to_string(&path).unwrap(), "new");
        assert_eq!(fs::metadata(&path).unwrap().mode() & 0o777, 0o600);
    }

    #[test]
    fn an_input_is_refused_under_each_of_its_names_and_a_file_twice_too() {
        let folder = tempfile::tempdir().unwrap();
        let (log, other) = (folder.path().join("log"), folder.path().join("other"));
        fs::write(&log, "log").unwrap();
        fs::hard_link(&log, &other).unwrap();
        let mut outputs = Outputs::new(FORCE, [log.as_path()]);
        for name in [&log, &other, &folder.path().join(".").join("log")] {
            assert!(
                message(outputs.claim(name)).contains("is read by this very command"),
                "{}",
                name.display()
            );
        }
        outputs.claim(&folder.path().join("new")).unwrap();
        let again = folder.path().join(".").join("new");
        assert!(message(outputs.claim(&again)).contains("is named for two outputs"));
        assert!(message(outputs.claim(folder.path())).contains("is a folder"));
        assert_eq!(outputs.claim(&folder.path().join("no/where")).unwrap_err().code, Code::Io);
    }

    #[test]
    fn a_link_in_the_place_of_the_part_is_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let (victim, path) = (folder.path().join("victim"), folder.path().join("log"));
        fs::write(&victim, "precious").unwrap();
        std::os::unix::fs::symlink(&victim, folder.path().join("log.part")).unwrap();
        Outputs::new(NO_FORCE, []).claim(&path).unwrap().write("log").unwrap();
        assert_eq!(fs::read_to_string(&victim).unwrap(), "precious");
        assert_eq!(fs::read_to_string(&path).unwrap(), "log");
    }

    #[test]
    fn devices_are_written_as_they_are() {
        let mut outputs = Outputs::new(NO_FORCE, []);
        for _ in 0..2 {
            outputs.claim(Path::new("/dev/null")).unwrap().write("nothing").unwrap();
        }
        let full = outputs.claim(Path::new("/dev/full")).unwrap().write("something").unwrap_err();
        assert_eq!((full.code, full.message.contains("No space left")), (Code::Io, true), "{full}");
    }
}

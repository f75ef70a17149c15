//! What a process that hosts foreign code may do: on Linux little, and elsewhere it does not host any.

#[cfg(target_os = "linux")]
pub(crate) use linux::{IS_KNOWN, begin, close};
#[cfg(not(target_os = "linux"))]
pub(crate) use none::{IS_KNOWN, begin, close};

#[cfg(target_os = "linux")]
mod linux {
    use std::fs::File;
    use std::io;
    use std::path::Path;

    use landlock::{
        ABI, Access, AccessFs, AccessNet, PathBeneath, PathFd, Ruleset, RulesetAttr, RulesetCreatedAttr,
    };
    use nix::sys::prctl::set_pdeathsig;
    use nix::sys::resource::{Resource, setrlimit};
    use nix::sys::signal::Signal;
    use nix::unistd::{dup, dup2_stdout};

    /// Memory that a host may have, bytes: a model that allocates without end must not take the machine's.
    const MOST_MEMORY: u64 = 2 << 30;

    pub(crate) const IS_KNOWN: bool = true;

    /// Limits this process to some memory and to the life of its parent, and gives the standard output for its answers: what the model prints
    /// goes to the standard error, as it must not be taken for one.
    pub(crate) fn begin() -> io::Result<File> {
        let answers = File::from(dup(io::stdout())?);
        dup2_stdout(io::stderr())?;
        // Whoever asks is gone: so is this. Where the system knows no such limits, the time that a run may take is left.
        let _ = set_pdeathsig(Signal::SIGKILL);
        let _ = setrlimit(Resource::RLIMIT_AS, MOST_MEMORY, MOST_MEMORY);
        let _ = setrlimit(Resource::RLIMIT_CORE, 0, 0);
        Ok(answers)
    }

    /// From here on this process writes in that folder alone and opens no connection. Where the kernel knows no such rules, processes of their
    /// own and limits are what is left.
    pub(crate) fn close(folder: &Path) {
        let _ = ruled(folder);
    }

    fn ruled(folder: &Path) -> Result<(), Box<dyn std::error::Error>> {
        let abi = ABI::V4;
        let writing = AccessFs::from_write(abi);
        let null = PathBeneath::new(PathFd::new("/dev/null")?, AccessFs::WriteFile);
        Ruleset::default()
            .handle_access(writing)?
            .handle_access(AccessNet::from_all(abi))?
            .create()?
            .add_rule(PathBeneath::new(PathFd::new(folder)?, writing))?
            .add_rule(null)?
            .restrict_self()?;
        Ok(())
    }
}

#[cfg(not(target_os = "linux"))]
mod none {
    use std::fs::File;
    use std::io;
    use std::path::Path;

    pub(crate) const IS_KNOWN: bool = false;

    pub(crate) fn begin() -> io::Result<File> {
        Err(io::ErrorKind::Unsupported.into())
    }

    pub(crate) fn close(_: &Path) {}
}

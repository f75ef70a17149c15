//! `seepd completions` and `seepd man`: what a shell and a reader want to know of the command line.

use std::fs;
use std::path::{Path, PathBuf};

use clap::Args;
use clap_complete::Shell;
use clap_mangen::Man;

use crate::cli::{Outcome, description};
use crate::failure::Failure;
use crate::sink::terminal::print;

/// Prints a shell's completion script.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  seepd completions bash > /etc/bash_completion.d/seepd")]
pub struct CompletionsArguments {
    /// Shell
    shell: Shell,
}

/// Prints the manual page, or writes those of all commands.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  seepd man | man -l -\n  seepd man --folder /usr/local/share/man/man1")]
pub struct ManArguments {
    /// Write seepd.1, seepd-replay.1 and so on there
    #[arg(long, value_name = "FOLDER")]
    folder: Option<PathBuf>,
}

/// Runs `completions`.
///
/// # Errors
/// [`Failure`] where standard output cannot be written.
pub fn completions(arguments: &CompletionsArguments) -> Result<Outcome, Failure> {
    let mut script = Vec::new();
    clap_complete::generate(arguments.shell, &mut description(), "seepd", &mut script);
    print(&script)?;
    Ok(Outcome::Good)
}

/// Runs `man`.
///
/// # Errors
/// [`Failure`] where the pages cannot be written.
pub fn man(arguments: &ManArguments) -> Result<Outcome, Failure> {
    let Some(folder) = &arguments.folder else {
        let mut text = Vec::new();
        Man::new(description())
            .render(&mut text)
            .map_err(|error| Failure::writing(Path::new("standard output"), error))?;
        print(&text)?;
        return Ok(Outcome::Good);
    };
    fs::create_dir_all(folder)
        .and_then(|()| clap_mangen::generate_to(description(), folder))
        .map_err(|error| Failure::writing(folder, error))?;
    Ok(Outcome::Good)
}

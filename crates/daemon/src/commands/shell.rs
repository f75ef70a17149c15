//! `seepd completions` and `seepd man`: what a shell and a reader want to know of the command line.

use std::fs;
use std::path::PathBuf;

use clap::Args;
use clap_complete::Shell;
use clap_mangen::Man;

use crate::cli::{Outcome, description};
use crate::failure::{Code, Failure};
use crate::output::{Output, Outputs, OverwriteArguments};
use crate::sink::terminal::print;

/// Print the completion script of a shell
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  seepd completions bash > /etc/bash_completion.d/seepd")]
pub struct CompletionsArguments {
    /// The shell
    shell: Shell,
}

/// Print the manual page, or write those of all commands
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  seepd man | man -l -\n  seepd man --folder /usr/local/share/man/man1")]
pub struct ManArguments {
    /// Write seepd.1, seepd-replay.1 and so on into this folder
    #[arg(long, value_name = "FOLDER")]
    folder: Option<PathBuf>,
    #[command(flatten)]
    overwrite: OverwriteArguments,
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
        print(&page(&Man::new(description()))?)?;
        return Ok(Outcome::Good);
    };
    fs::create_dir_all(folder).map_err(|error| Failure::writing(folder, error))?;
    let mut program = description().disable_help_subcommand(true);
    program.build();
    let mut manuals = Vec::new();
    collect_manuals(&program, &mut manuals);
    let mut outputs = Outputs::new(arguments.overwrite, []);
    let files = manuals.iter().map(|manual| outputs.claim(&folder.join(manual.get_filename())));
    let files: Vec<Output> = files.collect::<Result<_, _>>()?;
    files.iter().zip(&manuals).try_for_each(|(file, manual)| file.write(page(manual)?))?;
    Ok(Outcome::Good)
}

/// The manual pages of a command and of those below it.
fn collect_manuals(command: &clap::Command, manuals: &mut Vec<Man>) {
    command
        .get_subcommands()
        .filter(|below| !below.is_hide_set())
        .for_each(|below| collect_manuals(below, manuals));
    manuals.push(Man::new(command.clone()));
}

fn page(manual: &Man) -> Result<Vec<u8>, Failure> {
    let mut text = Vec::new();
    manual.render(&mut text).map_err(|error| Failure::new(Code::Internal, error.to_string()))?;
    Ok(text)
}

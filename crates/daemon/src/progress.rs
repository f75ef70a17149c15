//! What a person at a terminal sees beside the output: progress, and warnings.

use std::io::{IsTerminal, Write};

use indicatif::{ProgressBar, ProgressStyle};

use crate::sink::plain;

/// A progress bar over steps on a terminal, and nothing elsewhere.
#[cfg(feature = "simulate")]
pub(crate) fn progress_bar(steps: u64, what: &'static str) -> ProgressBar {
    bar(steps, what, "{msg:>12} [{bar:40}] {pos}/{len} {eta}")
}

/// A progress bar over bytes on a terminal, and nothing elsewhere.
pub(crate) fn byte_bar(bytes: u64, what: &'static str) -> ProgressBar {
    bar(bytes, what, "{msg:>12} [{bar:40}] {bytes}/{total_bytes} {eta}")
}

fn bar(length: u64, what: &'static str, template: &str) -> ProgressBar {
    if !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new(length).with_message(what);
    match ProgressStyle::with_template(template) {
        Ok(style) => bar.with_style(style.progress_chars("=> ")),
        Err(_) => bar,
    }
}

/// A warning or an error, as one line.
pub(crate) fn warn(message: &str) {
    // Nobody listens any more where even this cannot be written.
    let _ = writeln!(plain::stderr(), "seepd: {}", plain::one_line(message));
}

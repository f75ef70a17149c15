//! What a person sees beside the output: progress, and warnings.

use std::cell::RefCell;
use std::io::{self, IsTerminal, Write};
#[cfg(any(feature = "gap", feature = "train"))]
use std::sync::atomic::{AtomicU64, Ordering};

use indicatif::{ProgressBar, ProgressStyle};

use crate::sink::plain;

/// Lines that tell of progress where there is no terminal, at most.
#[cfg(any(feature = "gap", feature = "train"))]
const LINES: u64 = 10;

/// A progress bar over steps on a terminal, and nothing elsewhere: for work of seconds.
#[cfg(feature = "simulate")]
pub(crate) fn progress_bar(steps: u64, what: &'static str) -> ProgressBar {
    bar(steps, what, "{msg:>12} [{bar:40}] {pos}/{len} {eta}")
}

/// A progress bar over bytes on a terminal, and nothing elsewhere.
pub(crate) fn byte_bar(bytes: u64, what: &'static str) -> ProgressBar {
    bar(bytes, what, "{msg:>12} [{bar:40}] {bytes}/{total_bytes} {eta}")
}

fn bar(length: u64, what: &'static str, template: &str) -> ProgressBar {
    if !io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new(length).with_message(what);
    match ProgressStyle::with_template(template) {
        Ok(style) => bar.with_style(style.progress_chars("=> ")),
        Err(_) => bar,
    }
}

/// Progress of work that takes minutes: a bar on a terminal, and elsewhere a line a step, or a tenth where there are many.
#[cfg(any(feature = "gap", feature = "train"))]
pub(crate) struct Steps {
    bar: ProgressBar,
    what: &'static str,
    steps: u64,
    done: AtomicU64,
    is_told: bool,
}

#[cfg(any(feature = "gap", feature = "train"))]
impl Steps {
    /// Work of so many steps.
    pub(crate) fn begin(steps: u64, what: &'static str) -> Self {
        let is_told = !is_gathering();
        let bar = if is_told { progress_bar(steps, what) } else { ProgressBar::hidden() };
        bar.enable_steady_tick(std::time::Duration::from_millis(200));
        Steps { bar, what, steps, done: AtomicU64::new(0), is_told }
    }

    /// So many are done in all.
    pub(crate) fn set(&self, done: u64) {
        self.bar.set_position(done);
        let before = self.done.fetch_max(done, Ordering::Relaxed);
        self.tell(before, done);
    }

    /// One more is done.
    #[cfg(any(feature = "gap", feature = "train"))]
    pub(crate) fn one_more(&self) {
        self.bar.inc(1);
        let before = self.done.fetch_add(1, Ordering::Relaxed);
        self.tell(before, before + 1);
    }

    fn tell(&self, before: u64, done: u64) {
        if self.is_told && is_worth_a_line(self.steps, before, done) && !io::stderr().is_terminal() {
            warn(&format!("{}: {done} of {} done", self.what, self.steps));
        }
    }
}

#[cfg(any(feature = "gap", feature = "train"))]
impl Drop for Steps {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

/// Whether another of the lines is due.
#[cfg(any(feature = "gap", feature = "train"))]
fn is_worth_a_line(steps: u64, before: u64, done: u64) -> bool {
    let line = |done: u64| done.saturating_mul(LINES.min(steps)) / steps.max(1);
    line(done) > line(before)
}

/// What tells a bar of bytes how many more have been read.
pub(crate) fn counting(bar: &ProgressBar) -> impl FnMut(u64) + Clone + Send + 'static {
    let bar = bar.clone();
    move |bytes| bar.inc(bytes)
}

thread_local! {
    /// Where warnings of this thread go instead of standard error.
    static HEARD: RefCell<Option<Vec<String>>> = const { RefCell::new(None) };
}

/// Runs the work with its warnings gathered, rather than written to standard error: for programs that embed commands. Warnings of other
/// threads are not among them; no command has any.
pub fn gathering_warnings<R>(work: impl FnOnce() -> R) -> (R, Vec<String>) {
    let outer = HEARD.with(|heard| heard.replace(Some(Vec::new())));
    let result = work();
    let warnings = HEARD.with(|heard| heard.replace(outer)).unwrap_or_default();
    (result, warnings)
}

/// Whether somebody gathers this thread's warnings: progress is not told then.
#[cfg(any(feature = "gap", feature = "train"))]
fn is_gathering() -> bool {
    HEARD.with_borrow(Option::is_some)
}

/// A warning or an error, as one line.
pub(crate) fn warn(message: &str) {
    let line = plain::one_line(message);
    let is_heard = HEARD
        .with_borrow_mut(|heard| heard.as_mut().map(|heard| heard.push(line.clone().into_owned())).is_some());
    if is_heard {
        return;
    }
    // Nobody listens any more where even this cannot be written.
    let _ = writeln!(plain::stderr(), "seepd: {line}");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(any(feature = "gap", feature = "train"))]
    #[test]
    fn few_steps_have_a_line_each_and_many_ten_in_all() {
        let lines = |steps: u64| (0..steps).filter(|done| is_worth_a_line(steps, *done, done + 1)).count();
        assert_eq!([1, 4, 7, 10, 11, 1200].map(lines), [1, 4, 7, 10, 10, 10]);
        assert!(!is_worth_a_line(0, 0, 0) && !is_worth_a_line(4, 2, 2) && is_worth_a_line(1200, 0, 1200));
    }
}

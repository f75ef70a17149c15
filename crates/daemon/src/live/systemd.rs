//! What the service manager hears: ready, reloading, stopping, and that the axes are alive.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use sd_notify::NotifyState;

/// Tells the service manager, if there is one.
pub(super) fn tell(states: &[NotifyState<'_>]) {
    if let Err(error) = sd_notify::notify(states) {
        tracing::warn!("the service manager cannot be told: {error}");
    }
}

/// A text as it may stand in a message to the service manager, in which a line break would begin another assignment.
pub(super) fn one_line(text: &str) -> String {
    text.replace(char::is_control, " ")
}

/// Progress of an axis whose log has ended: there is nothing left to do, and nothing to starve for.
pub(super) const ENDED: u64 = u64::MAX;

/// The watchdog: it is fed only where every axis has worked through its input since the last time.
pub(super) struct Watchdog {
    axes: Vec<(Arc<AtomicU64>, u64)>,
    /// How often it looks; `None` without a watchdog.
    pub every: Option<Duration>,
}

impl Watchdog {
    /// Reads what the service manager asks for.
    pub(super) fn new() -> Self {
        let every = sd_notify::watchdog_enabled().map(|limit| (limit / 4).max(Duration::from_millis(50)));
        Watchdog { axes: Vec::new(), every }
    }

    /// The axes that are to be watched from now on.
    pub(super) fn watch(&mut self, axes: Vec<Arc<AtomicU64>>) {
        self.axes = axes.into_iter().map(|progress| (progress, ENDED)).collect();
    }

    /// Whether every axis has made progress since the last time that all had.
    pub(super) fn all_progressed(&mut self) -> bool {
        let all = self.axes.iter().all(|(progress, before)| {
            let now = progress.load(Ordering::Relaxed);
            now == ENDED || now != *before
        });
        if all {
            for (progress, before) in &mut self.axes {
                *before = progress.load(Ordering::Relaxed);
            }
        }
        all
    }

    /// Feeds it if it may be fed.
    pub(super) fn feed(&mut self) {
        if self.all_progressed() {
            tell(&[NotifyState::Watchdog]);
        }
    }
}

impl Default for Watchdog {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_with_a_line_break_says_nothing_else_to_the_service_manager() {
        assert_eq!(one_line("press\nMAINPID=1\r\u{1b}[2J ä"), "press MAINPID=1  [2J ä");
    }

    #[test]
    fn one_axis_that_stands_still_starves_the_watchdog() {
        let (a, b) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicU64::new(0)));
        let mut watchdog = Watchdog { axes: Vec::new(), every: None };
        watchdog.watch(vec![Arc::clone(&a), Arc::clone(&b)]);
        assert!(watchdog.all_progressed());
        a.fetch_add(1, Ordering::Relaxed);
        assert!(!watchdog.all_progressed());
        b.fetch_add(1, Ordering::Relaxed);
        assert!(watchdog.all_progressed());
        assert!(!watchdog.all_progressed());
        // An axis whose log has ended is waited for no longer.
        b.store(ENDED, Ordering::Relaxed);
        a.fetch_add(1, Ordering::Relaxed);
        assert!(watchdog.all_progressed());
        a.fetch_add(1, Ordering::Relaxed);
        assert!(watchdog.all_progressed());
        assert!(!watchdog.all_progressed());
    }
}

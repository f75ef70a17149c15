//! Events as JSON lines.

use std::io::{self, Write};

use seepd_monitor::event::{Event, Summary};
use serde::Serialize;

/// Writes a cycle's line. Changes of flag show in the cycles' flags and, by themselves, in MCAP.
///
/// # Errors
/// Writing failed.
pub fn write_event(out: &mut impl Write, event: &Event<'_>) -> io::Result<()> {
    match event {
        Event::Cycle(line) => write_line(out, line),
        Event::Flag(flag) => write_line(out, flag),
        Event::Notice(notice) => write_line(out, notice),
    }
}

/// `seepd.summary/1` as it is written.
#[derive(Serialize)]
struct SummaryLine<'a> {
    #[serde(flatten)]
    summary: &'a Summary,
    /// What was seen and what to do, where there is no size.
    advice: Option<&'a str>,
}

/// Writes the last line.
///
/// # Errors
/// Writing failed.
pub fn write_summary(out: &mut impl Write, summary: &Summary, advice: Option<&str>) -> io::Result<()> {
    write_line(out, &SummaryLine { summary, advice })
}

fn write_line(out: &mut impl Write, value: &impl Serialize) -> io::Result<()> {
    serde_json::to_writer(&mut *out, value)?;
    out.write_all(b"\n")
}

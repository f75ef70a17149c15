//! Events as lines for a person.

use std::io::{self, Write};
use std::path::Path;

use seepd_monitor::event::{CycleLine, Event, Flag, FlagEvent, Summary};
use seepd_monitor::reason::UNCONFIRMED;
use seepd_monitor::repair::RepairVerdict;

use crate::failure::Failure;
use crate::quantity::{bar, mm2, mm2_interval};
use crate::sink::plain;

/// Writes on standard output. A reader that goes away is no failure: it has what it wanted.
///
/// # Errors
/// [`Failure`] where writing failed otherwise.
pub fn print(text: &[u8]) -> Result<(), Failure> {
    match plain::stdout().write_all(text) {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => {
            Err(Failure::writing(Path::new("standard output"), error))
        }
        _ => Ok(()),
    }
}

/// Whether colours are used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Colour {
    /// ANSI colours.
    On,
    /// Plain text.
    Off,
}

impl Colour {
    /// Colours on a terminal, unless `NO_COLOR` is set (no-color.org).
    pub fn detect(is_terminal: bool) -> Self {
        let refused = std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
        if is_terminal && !refused { Colour::On } else { Colour::Off }
    }

    /// The text in the colour of a flag.
    pub fn paint(self, flag: Flag, text: &str) -> String {
        let colour = match flag {
            Flag::NoEstimate => DIM,
            Flag::Healthy => GREEN,
            Flag::Watch => YELLOW,
            Flag::Leak => RED,
            Flag::Severe => BOLD_RED,
        };
        match self {
            Colour::On => format!("{colour}{text}{RESET}"),
            Colour::Off => text.to_owned(),
        }
    }
}

const RESET: &str = "\x1b[0m";
const DIM: &str = "\x1b[2m";
const GREEN: &str = "\x1b[32m";
const YELLOW: &str = "\x1b[33m";
const RED: &str = "\x1b[31m";
const BOLD_RED: &str = "\x1b[1;31m";

/// The escape sequences that the program itself writes.
pub(super) const COLOURS: [&str; 6] = [RESET, DIM, GREEN, YELLOW, RED, BOLD_RED];

/// Writes the columns' names.
///
/// # Errors
/// Writing failed.
pub fn write_header(out: &mut impl Write, reference_dp_pa: f64) -> io::Result<()> {
    writeln!(
        out,
        "{:>6} {:>10}  {:>8} {:>10} {:>19}  flag   (L/min at {} bar)",
        "cycle",
        "start s",
        "L/min",
        "leak mm²",
        "90 % interval mm²",
        bar(reference_dp_pa)
    )
}

/// Writes an event.
///
/// # Errors
/// Writing failed.
pub fn write_event(out: &mut impl Write, event: &Event<'_>, colour: Colour) -> io::Result<()> {
    match event {
        Event::Cycle(line) => write_cycle(out, line, colour),
        Event::Flag(flag) => write_flag(out, flag, colour),
        Event::Notice(notice) => writeln!(out, "{:>6} {:>10.3}  {}", "▸", notice.t_s, notice.text),
    }
}

fn write_cycle(out: &mut impl Write, line: &CycleLine<'_>, colour: Colour) -> io::Result<()> {
    write!(out, "{:>6} {:>10.3}  ", line.cycle, line.t_start_s)?;
    match (line.leak_area_m2, line.interval90_m2, line.leak_flow_lpm) {
        (Some(area), Some(interval), Some(flow)) => {
            write!(out, "{flow:>8.3} {:>10} {:>19}  ", mm2(area), mm2_interval(interval))?;
        }
        _ => write!(out, "{:>8} {:>10} {:>19}  ", "–", "–", "–")?,
    }
    write!(out, "{}", colour.paint(line.flag, &words(line.flag.name())))?;
    match line.reason {
        Some(reason) => writeln!(out, " ({})", words(reason)),
        None => writeln!(out),
    }
}

fn write_flag(out: &mut impl Write, event: &FlagEvent<'_>, colour: Colour) -> io::Result<()> {
    writeln!(
        out,
        "{:>6} {:>10.3}  {} → {}: {}",
        "▸",
        event.t_s,
        words(event.flag_from.name()),
        colour.paint(event.flag_to, &words(event.flag_to.name())),
        event.text
    )
}

/// Writes the summary, and what to do where there is no size as the last line.
///
/// # Errors
/// Writing failed.
pub fn write_summary(
    out: &mut impl Write,
    summary: &Summary,
    advice: Option<&str>,
    colour: Colour,
) -> io::Result<()> {
    writeln!(out)?;
    let rejected: u64 = summary.rejected.values().sum();
    write!(
        out,
        "{}: {} – {} cycles in {:.1} s",
        summary.axis,
        colour.paint(summary.flag, &words(summary.flag.name())),
        summary.cycles,
        summary.duration_s
    )?;
    if rejected > 0 {
        write!(out, ", {rejected} rejected ({})", listed(&summary.rejected))?;
    }
    match summary.reason {
        Some(UNCONFIRMED) => {
            write!(out, "; too few estimates in a row lie above a threshold to raise a flag")?;
        }
        Some(reason) => write!(out, "; no estimate: {}", words(reason))?,
        None => {}
    }
    writeln!(out)?;
    if let (Some(area), Some(flow)) = (summary.leak_area_m2, summary.leak_flow_lpm) {
        writeln!(
            out,
            "leak: {flow:.3} L/min at {} bar, {} mm² (median of the last cycles); highest flag: {}",
            bar(summary.reference_dp_pa),
            mm2(area),
            words(summary.highest_flag.name())
        )?;
    } else if summary.highest_flag > Flag::Healthy {
        writeln!(out, "leak: no size; highest flag: {}", words(summary.highest_flag.name()))?;
    }
    if let Some(condition) = &summary.condition {
        writeln!(out, "beside it: {condition}")?;
    }
    for condition in &summary.conditions {
        writeln!(out, "  {}", condition.line())?;
    }
    for done in summary.repairs.iter().filter(|done| done.verdict == Some(RepairVerdict::Contradicted)) {
        writeln!(out, "repair: {}", done.text.as_deref().unwrap_or_default())?;
    }
    if let Some(loss) = &summary.loss {
        let (power, energy) = (loss.leak_power_w, loss.leak_energy_kwh_per_year);
        writeln!(out, "lost: {power:.1} W, or {energy:.0} kWh a year")?;
    }
    if !summary.samples_rejected.is_empty() {
        writeln!(out, "samples: {} read; {}", summary.samples, listed(&summary.samples_rejected))?;
    }
    if let Some(advice) = advice {
        writeln!(out, "{advice}")?;
    }
    Ok(())
}

/// A name of the formats as a person reads it: `out_of_range` is `out of range`.
fn words(name: &str) -> String {
    name.replace('_', " ")
}

/// Counts with their names in words, in a line.
pub(crate) fn listed(counts: &std::collections::BTreeMap<&'static str, u64>) -> String {
    counts.iter().map(|(name, count)| format!("{count} {}", words(name))).collect::<Vec<_>>().join(", ")
}

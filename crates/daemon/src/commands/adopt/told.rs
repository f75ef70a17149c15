//! What each step says.

use std::fmt::Write;
use std::path::Path;

use seepd_adopt::adoption::{Adoption, DemandOrigin};
use seepd_adopt::duty_cycle::FoundCycle;
use seepd_adopt::plant::Origin;
use seepd_adopt::recording::Recording;
use seepd_adopt::signals::SignalProposal;
use seepd_logs::columns::Columns;
use seepd_monitor::baseline::Baseline;
use seepd_signals::Signal;
use serde_json::json;

use super::Described;
use super::capability::Capability;
use super::files::Folder;
use crate::failure::{Code, Failure};
use crate::sink::plain::{self, one_line};

/// What helps where no duty cycle was found.
pub(super) const WITHOUT_A_CYCLE: &str = "Record a stretch of automatic work, some 50 cycles; where the order of strokes never repeats, no leak can be told from the command";

/// One line on standard error; nobody reads it where that is closed.
fn say(text: std::fmt::Arguments<'_>) {
    let mut out = plain::stderr();
    let _ = std::io::Write::write_fmt(&mut out, format_args!("{}\n", one_line(&text.to_string())));
}

pub(super) fn signals(log: &Path, columns: &Columns, proposal: &SignalProposal) {
    say(format_args!(
        "Signals of {} ({} columns at {:.1} Hz)",
        seepd_logs::log_name(log),
        columns.columns.len(),
        columns.rate_hz
    ));
    for (signal, assigned) in &proposal.assigned {
        let Some(column) = columns.columns.get(assigned.column) else { continue };
        let mapping = &assigned.mapping;
        say(format_args!(
            "  {:<9} {} · {:?} + {:?}: {}",
            signal.name(),
            column.field,
            mapping.scale,
            mapping.offset,
            assigned.evidence.join(" ")
        ));
    }
}

pub(super) fn cycle(recording: &Recording, found: &FoundCycle) {
    let hours = recording.log.len() as f64 / recording.rate_hz / 3600.0;
    say(format_args!(
        "Duty cycle: {} cycles of {:.2} s ({:.2} … {:.2}) with {} strokes in {:.2} h, found by the {}; {} strokes belong to none",
        found.cycles.len(),
        found.period_s,
        found.period.least_s,
        found.period.most_s,
        found.strokes.len(),
        hours,
        found.guide.signal().name(),
        found.left_out
    ));
    for stroke in &found.strokes {
        let way = match found.guide.signal() {
            Signal::Command => format!("{:+.3} s of full command", stroke.way),
            _ => format!("{:+.1} mm", 1e3 * stroke.way),
        };
        let hold = &stroke.hold_after;
        say(format_args!(
            "  {:<10} {:7.3} … {:7.3} s, {way}, then {:.2} s ({:.2} … {:.2}) of hold",
            stroke.name, stroke.from_s, stroke.to_s, hold.median_s, hold.least_s, hold.most_s
        ));
    }
    if let Some(sentence) = open_loop(found) {
        say(format_args!("  {sentence}"));
    }
}

/// Which strokes begin with a command of their own, in a sentence.
pub(crate) fn open_loop(found: &FoundCycle) -> Option<String> {
    let parts: Vec<String> = found
        .strokes
        .iter()
        .filter_map(|stroke| {
            let part = stroke.open_loop?;
            let (seconds, percent) = (part.to_s - stroke.from_s, 100.0 * part.command);
            Some(format!("{} (up to {percent:+.0} % for {seconds:.2} s)", stroke.name))
        })
        .collect();
    (!parts.is_empty()).then(|| {
        format!("open loop, on a command of their own before position control begins: {}", parts.join(", "))
    })
}

pub(super) fn machine(adoption: &Adoption) {
    let demand = match adoption.demand {
        DemandOrigin::Log => "the log has the demand",
        DemandOrigin::Position => "the demand follows from command and position",
        DemandOrigin::Command => "the demand is the one under which the simulated machine gives this command",
    };
    say(format_args!("Machine: {demand}"));
    if let Some(gains) = &adoption.gains {
        let window = match gains.integral_window_m {
            window_m if window_m > 0.0 => format!(" within ±{:.2} mm", 1e3 * window_m),
            _ => String::new(),
        };
        say(format_args!(
            "  controller read off the log: Kp {:.4} 1/m, Ki {:.4} 1/(m s){window}, Kd {:.4} s/m, feed-forward {:.4} s/m, dead-band jump {:.1} %",
            gains.kp,
            gains.ki,
            gains.kd,
            gains.feed_forward,
            100.0 * gains.compensation
        ));
    }
    let count = |origin: Origin| adoption.values.values().filter(|value| value.origin == origin).count();
    say(format_args!(
        "  plant values: {} yours, {} fitted to the log, {} usual for the size, {} not to be told from this log",
        count(Origin::User),
        count(Origin::Fitted),
        count(Origin::Default),
        count(Origin::NotIdentifiable)
    ));
    if let Some(calibration) = &adoption.calibration {
        for (signal, after) in &calibration.gaps[1] {
            let before = calibration.gaps[0].get(signal).copied().unwrap_or(f64::NAN);
            let floor = calibration.floor.get(signal).copied().unwrap_or(f64::NAN);
            say(format_args!(
                "  {signal:<9} simulation and log differ by {:.2} % of the range (before calibration {:.2} %, cycles among themselves {:.2} %)",
                100.0 * after,
                100.0 * before,
                100.0 * floor
            ));
        }
    } else {
        say(format_args!(
            "  the log has no position, so that nothing is calibrated: the tolerances of the data stay in the intervals"
        ));
    }
    for (effect, values) in &adoption.spec.effects {
        let values: Vec<String> = values.iter().map(|(name, value)| format!("{name} {value:.4}")).collect();
        say(format_args!("  {effect}: {}", values.join(", ")));
    }
    adoption.remarks.iter().for_each(|remark| say(format_args!("  {remark}")));
}

pub(super) fn baseline(baseline: &Baseline, rejected: u64) {
    say(format_args!(
        "Baseline: {} cycles, {} unlike the others, {rejected} not used",
        baseline.cycles, baseline.left_out
    ));
    baseline.remarks.iter().for_each(|remark| say(format_args!("  {remark}")));
}

/// The terminal's last words.
pub(super) fn result(folder: &Folder, capability: &Capability) -> String {
    let mut text = String::new();
    for (cycles, alone, _) in &capability.smallest_lpm {
        let _ = writeln!(text, "smallest leak found within {cycles} cycles: {alone:.3} L/min at 70 bar");
    }
    if let Some(error) = capability.size_error {
        let _ = writeln!(text, "median error of a larger leak's size: {:.1} %", 100.0 * error);
    }
    let _ = writeln!(text, "false alarms, by design: {}", capability.false_alarms());
    for advice in &capability.advice {
        let _ = writeln!(text, "{advice}");
    }
    let config = folder.path("seepd.toml");
    let _ = writeln!(
        text,
        "\nLook at {}, then:\n  seepd replay --config {} LOG",
        folder.path("adopt.html").display(),
        config.display()
    );
    text
}

/// `seepd.adopt/1`.
pub(super) fn json(
    axis: &str,
    described: Option<&Described>,
    capability: &Capability,
) -> Result<String, Failure> {
    let cycle = described.map(|described| {
        let found = &described.found;
        json!({ "period_s": found.period_s, "cycles": found.cycles.len(), "strokes": found.strokes.len(), "left_out": found.left_out })
    });
    let machine = described.map(|described| {
        let adoption = &described.adoption;
        json!({
            "values": adoption.values,
            "gap": adoption.calibration.as_ref().map(|calibration| &calibration.gaps[1]),
            "floor": adoption.calibration.as_ref().map(|calibration| &calibration.floor),
            "effects": adoption.spec.effects,
            "remarks": adoption.remarks,
        })
    });
    let smallest = capability.smallest_lpm.iter().map(|(cycles, alone, with_load)| json!({ "cycles": cycles, "leak_lpm": alone, "with_load_lpm": with_load })).collect::<Vec<_>>();
    let found = smallest.iter().find(|found| found["cycles"] == 100).map(|found| found["leak_lpm"].clone());
    let whole = json!({
        "schema": "seepd.adopt/1",
        "axis": axis,
        "cycle": cycle,
        "machine": machine,
        "smallest_leak_lpm": found,
        "smallest": smallest,
        "capability": capability,
    });
    serde_json::to_string_pretty(&whole)
        .map(|text| text + "\n")
        .map_err(|error| Failure::new(Code::Internal, format!("writing the result as JSON: {error}")))
}

//! An evaluation's tables for a terminal.

use std::io::{self, Write};

use seepd_model::accuracy::Decade;

use crate::evaluation::Evaluation;
#[cfg(feature = "train")]
use crate::evaluation::causes::CauseEvaluation;
use crate::evaluation::detection::Detection;
use crate::evaluation::roc::Roc;
use crate::evaluation::sizes::Sizes;
use crate::html::chart::number;
use crate::quantity::{MM2_PER_M2, bar, mm2, percent};
use crate::sink::terminal::listed;

/// A number; a dash where there is none.
pub(crate) fn or_dash(value: f64, text: impl FnOnce(f64) -> String) -> String {
    if value.is_finite() { text(value) } else { "–".into() }
}

/// Writes everything.
///
/// # Errors
/// Writing failed.
pub fn write_tables(out: &mut impl Write, evaluation: &Evaluation) -> io::Result<()> {
    let Evaluation { conditions, machines, cycles, rejected, .. } = evaluation;
    writeln!(out, "{machines} machines, {cycles} cycles; flows at {} bar", bar(conditions.reference_dp_pa))?;
    if !rejected.is_empty() {
        writeln!(out, "without an estimate: {}", listed(rejected))?;
    }
    for sizes in &evaluation.sizes {
        write_sizes(out, sizes)?;
    }
    for detection in &evaluation.detection {
        write_detection(out, detection, evaluation)?;
    }
    for roc in &evaluation.roc {
        write_roc(out, roc)?;
    }
    Ok(())
}

/// What named causes are worth, as a table.
#[cfg(feature = "train")]
pub fn cause_table(evaluation: &CauseEvaluation) -> String {
    let share = |share: f64| percent(share, 1);
    let mut text = format!(
        "{} machines, {} cycles after the change, seed {}\n\
         right: {}; where causes that look alike count as one: {}\n\
         a flag on a machine without a leak: {}; a condition on one that stayed as it was: {}\n\n\
         {:<18} {:>8} {:>8} {:>16}  the last cycle says\n",
        evaluation.machines,
        evaluation.watched_cycles,
        evaluation.seed,
        share(evaluation.right),
        share(evaluation.right_within_class),
        share(evaluation.flags_without_leak),
        share(evaluation.conditions_without_change),
        "planted",
        "machines",
        "found",
        "cycles until then"
    );
    for row in &evaluation.planted {
        let cycles = match (row.median_cycles, row.slowest_cycles) {
            (Some(median), Some(slowest)) => format!("{median}, at most {slowest}"),
            _ => "–".to_owned(),
        };
        let mut named: Vec<(&str, usize)> = row.named.iter().map(|(name, count)| (*name, *count)).collect();
        named.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
        let named: Vec<String> = named.iter().map(|(name, count)| format!("{name} {count}")).collect();
        text += &format!(
            "{:<18} {:>8} {:>8} {:>16}  {}\n",
            row.cause,
            row.machines,
            row.found,
            cycles,
            named.join(", ")
        );
    }
    text
}

/// A decade's ends in mm², without their unit.
pub(crate) fn decade_text(decade: &Decade) -> String {
    let [from, to] = [decade.from_m2, decade.to_m2].map(|area_m2| number(area_m2 * MM2_PER_M2));
    format!("{from} … {to}")
}

fn write_sizes(out: &mut impl Write, sizes: &Sizes) -> io::Result<()> {
    writeln!(out, "\nSizes, {}:", sizes.method.name())?;
    writeln!(
        out,
        "{:>16} {:>8} {:>14} {:>18}",
        "leak, mm²", "cycles", "median error", "90 % interval holds"
    )?;
    for decade in &sizes.decades {
        let range = decade_text(decade);
        let error = percent(decade.median_relative_error, 2);
        writeln!(out, "{range:>16} {:>8} {error:>14} {:>18}", decade.count, percent(decade.coverage, 1))?;
    }
    let healthy = &sizes.healthy;
    let held = percent(healthy.coverage(), 1);
    writeln!(out, "{:>16} {:>8} {:>14} {held:>18}", "none", healthy.cycles, "")?;
    writeln!(
        out,
        "R² of the area {}, mean error {}, median error above {} L/min {}, largest estimate without a leak {}",
        or_dash(sizes.r2_area, |value| format!("{value:.5}")),
        or_dash(sizes.mean_absolute_error_m2, |value| format!("{} mm²", mm2(value))),
        sizes.large.from_lpm,
        percent(sizes.large.median_relative_error, 2),
        if healthy.cycles > 0 { format!("{} mm²", mm2(healthy.largest_m2)) } else { "–".into() },
    )
}

fn write_detection(out: &mut impl Write, detection: &Detection, evaluation: &Evaluation) -> io::Result<()> {
    let within = evaluation.conditions.within_cycles;
    writeln!(out, "\nDetection by {}:", detection.detector.name())?;
    writeln!(out, "{}", false_alarms(detection))?;
    if detection.classes.is_empty() {
        return writeln!(out, "no leak begins in these records");
    }
    writeln!(
        out,
        "{:>14} {:>9} {:>13} {:>18} {:>13}",
        "leak, L/min",
        "machines",
        "median leak",
        format!("found within {within}"),
        "median cycles"
    )?;
    for line in &detection.classes {
        let share = percent(line.share_found(), 1);
        let delay = line.median_cycles.map_or_else(|| "–".into(), |cycles| cycles.to_string());
        let class = line.class.to_string();
        writeln!(out, "{class:>14} {:>9} {:>13.3} {share:>18} {delay:>13}", line.machines, line.median_lpm)?;
    }
    match detection.smallest_found_lpm {
        Some(lpm) => writeln!(out, "smallest leak found by 95 %: {lpm:.3} L/min"),
        None => writeln!(out, "smallest leak found by 95 %: none of these"),
    }
}

/// The false alarms in words.
pub(crate) fn false_alarms(detection: &Detection) -> String {
    let Detection { healthy_cycles, false_alarms, raised_before, .. } = detection;
    let mut text = format!("{false_alarms} false alarms in {healthy_cycles} cycles without a leak");
    if *false_alarms == 0 && *healthy_cycles >= 30 {
        // The rule of three: with 95 % confidence the rate is below 3 / n.
        text.push_str(&format!(" (with 95 % confidence less than one in {})", healthy_cycles / 3));
    }
    if *raised_before > 0 {
        text.push_str(&format!(
            "; {raised_before} machines left out of the table, as the alarm was raised before the leak began"
        ));
    }
    text
}

fn write_roc(out: &mut impl Write, roc: &Roc) -> io::Result<()> {
    writeln!(
        out,
        "\nReceiver operating curve of {}: area {:.4} ({} healthy, {} leaking cycles)",
        roc.score.name(),
        roc.area,
        roc.healthy_cycles,
        roc.leaking_cycles
    )?;
    for class in &roc.classes {
        writeln!(
            out,
            "{:>14} L/min {:>8} cycles {:>9.4}",
            class.class.to_string(),
            class.cycles,
            class.area
        )?;
    }
    Ok(())
}

//! What the terminal says of a diagnosis.

use std::collections::BTreeMap;

use seepd_gap::report::{Diagnosis, Verdict};
use seepd_monitor::event::LPM_PER_M3_PER_S;
use seepd_monitor::pipeline::REFERENCE_DP_PA;
use seepd_sim::PlantParameters;

use super::next_test;
use crate::html::chart::number;
use crate::quantity::{bar, percent};

/// The whole report, section by section.
pub(super) fn report(plant: Option<&PlantParameters>, diagnosis: &Diagnosis) -> String {
    let headline = format!("{}\n\n", headline(diagnosis));
    if diagnosis.cycles.used == 0 {
        return headline;
    }
    let remarks = diagnosis.distinguish.iter().chain(&diagnosis.notes);
    [
        headline,
        gap_by_signal(diagnosis),
        removed(diagnosis),
        places(diagnosis),
        explanations(diagnosis),
        learned_laws(diagnosis),
        next_test::report(diagnosis.next_test.as_ref()),
        calibrated_parameters(diagnosis),
        plant.map_or(String::new(), |plant| leaks(plant, diagnosis)),
        remarks.map(|line| format!("{line}\n")).collect(),
        format!("took {:.1} s\n", diagnosis.seconds),
    ]
    .concat()
}

/// How far simulation and log are apart, signal by signal.
fn gap_by_signal(diagnosis: &Diagnosis) -> String {
    let mut text = format!(
        "{:<10} {:>9} {:>9} {:>10} {:>9}   gap on {} held-out cycles, RMS over range\n",
        "signal", "floor", "nominal", "calibrated", "chosen", diagnosis.cycles.held_out
    );
    for signal in &diagnosis.signals {
        let of = |gap: &BTreeMap<&'static str, f64>| percent(gap.get(signal).copied().unwrap_or(f64::NAN), 1);
        let gap = &diagnosis.gap;
        text += &format!(
            "{signal:<10} {:>9} {:>9} {:>10} {:>9}\n",
            of(&diagnosis.floor),
            of(&gap.nominal),
            of(&gap.calibrated),
            of(&gap.chosen)
        );
    }
    text
}

/// How much of it calibration and effects take away.
fn removed(diagnosis: &Diagnosis) -> String {
    let shrink = &diagnosis.shrink;
    let mut text = format!(
        "\ncalibration alone removes {} of the removable gap, the chosen machine {}\n",
        percent(shrink.calibration_only, 1),
        percent(shrink.of_removable, 1)
    );
    if shrink.by_effect.len() > 1 {
        let part = |(effect, part): (&&str, &f64)| format!("{effect} {}", percent(*part, 1));
        let parts: Vec<String> = shrink.by_effect.iter().map(part).collect();
        text += &format!("beyond the calibration: {}\n", parts.join(", "));
    }
    text
}

/// Where the most of it is.
fn places(diagnosis: &Diagnosis) -> String {
    let mut text = String::from("\nwhere, after the calibration:\n");
    for place in diagnosis.places.iter().take(4) {
        text += &format!(
            "  {:>6}  {} in {}, seen in {}\n",
            percent(place.share, 1),
            place.equation,
            place.phase,
            place.signal
        );
    }
    text
}

/// What may have caused it, with probabilities.
fn explanations(diagnosis: &Diagnosis) -> String {
    let mut text = String::from("\nwhy:\n");
    for finding in diagnosis.effects.iter().filter(|finding| finding.presence_probability >= 0.01) {
        let value_of = |(name, value): (&&'static str, &f64)| {
            let [low, high] = finding.interval95.get(name).copied().unwrap_or([f64::NAN; 2]);
            format!("{name} {} ({} … {})", number(*value), number(low), number(high))
        };
        let values: Vec<String> = finding.parameters.iter().map(value_of).collect();
        text += &format!(
            "  {:>6}  {}: {}\n",
            percent(finding.presence_probability, 1),
            finding.effect,
            values.join(", ")
        );
        if !finding.equivalent.is_empty() {
            text +=
                &format!("          cannot be told apart in this log: {}\n", finding.equivalent.join(", "));
        }
    }
    text += &format!("  {:>6}  none of these\n", percent(diagnosis.unknown_probability, 1));
    text +=
        &format!("  {:>6}  no effect, only other parameters\n", percent(diagnosis.no_effect_probability, 1));
    if let Some(note) = diagnosis.note_on_presences() {
        text += &format!("          {note}\n");
    }
    text
}

fn calibrated_parameters(diagnosis: &Diagnosis) -> String {
    let mut text = String::from("\ncalibrated parameters, divided by those of the plant file:\n");
    for (symbol, value) in &diagnosis.calibrated {
        let ratio = value.fitted / value.nominal;
        let [low, high] = value.interval95.map(|end| end / value.nominal);
        text += &format!("  {symbol:<10} {ratio:>6.3}  ({low:.3} … {high:.3})\n");
    }
    text
}

/// The leak past the piston's seal, by each machine.
fn leaks(plant: &PlantParameters, diagnosis: &Diagnosis) -> String {
    let lpm = |area: f64| plant.orifice_flow_m3_per_s(area, REFERENCE_DP_PA) * LPM_PER_M3_PER_S;
    let leak = &diagnosis.leak;
    format!(
        "\nleak at {} bar: {:.3} L/min with the plant file, {:.3} calibrated, {:.3} as chosen\n",
        bar(REFERENCE_DP_PA),
        lpm(leak.nominal_m2),
        lpm(leak.calibrated_m2),
        lpm(leak.chosen_m2)
    )
}

/// What was learned in the place of an effect.
fn learned_laws(diagnosis: &Diagnosis) -> String {
    let mut text = String::new();
    for law in diagnosis.learned.iter().filter(|law| law.adopted || law.probability >= 0.01) {
        if text.is_empty() {
            text += "\na law without a name, learned from the log:\n";
        }
        let adopted = if law.adopted { "; the machine as chosen has it" } else { "" };
        text += &format!(
            "  {:>6}  {} over {}: {}\n          with it {} of the removable gap is gone{adopted}\n",
            percent(law.probability, 1),
            law.place,
            law.argument,
            law.resembles,
            percent(law.shrink, 1)
        );
    }
    text
}

/// The conclusion in words.
pub fn headline(diagnosis: &Diagnosis) -> String {
    let because = diagnosis.reason.as_ref().map_or(String::new(), |reason| format!(" ({reason})"));
    let text = match diagnosis.verdict {
        Verdict::NoGap => "no gap: the machine of the plant file behaves as the log does".into(),
        Verdict::Parameters => "no effect: other parameters explain the log".into(),
        Verdict::Effect => format!("an effect: {}", diagnosis.chosen.join(", ")),
        Verdict::Unknown => "an effect that is not in the catalogue".into(),
        Verdict::CannotTell => "cannot tell".into(),
    };
    format!("{text}{because}")
}

//! The page that `seepd gap --html` leaves.

use std::collections::BTreeMap;

use maud::{Markup, html};
use seepd_gap::Diagnosis;
use seepd_gap::next_test::NextTest;
use seepd_gap::report::{LearnedCurve, RankedEffect};
use seepd_monitor::event::LPM_PER_M3_PER_S;
use seepd_monitor::pipeline::REFERENCE_DP_PA;
use seepd_signals::Signal;
use seepd_sim::PlantParameters;

use super::chart::{Axis, Chart, Layer, number};
use super::page;
use crate::commands::next_test::told;
use crate::quantity::{self, percent};

/// What the page shows.
pub struct GapPage<'a> {
    /// Name of the log.
    pub log: &'a str,
    /// The verdict in a sentence.
    pub headline: &'a str,
    /// The diagnosis.
    pub diagnosis: &'a Diagnosis,
    /// The press of the plant file, for leaks as flows; `None` for an axis without a leak.
    pub plant: Option<&'a PlantParameters>,
}

/// Share of the cycle from which a phase's name has room in a plot.
const SPAN_WITH_ROOM: f64 = 0.08;

impl GapPage<'_> {
    /// The page's text.
    pub fn render(&self) -> String {
        let found = self.diagnosis;
        let body = html! {
            h1 { "Simulator and machine compared: " (self.log) }
            p { strong { (self.headline) } }
            @if found.cycles.used > 0 {
                p.soft { "Of " (found.cycles.used) " cycles, " (found.cycles.fit) " were fitted to; gaps are measured on the other " (found.cycles.held_out)
                    ". A gap is the RMS difference between log and simulation, divided by the signal's range. The floor is what differs from cycle to cycle, \
                    which no simulation can match. The parameters are calibrated first; what is left then is looked for among the effects." }
                h2 { "How far the gap shrinks" }
                (self.waterfall())
                h2 { "Why" }
                (self.ranking())
                @if !found.learned.is_empty() {
                    h2 { "A law without a name" }
                    (learned_laws(&found.learned))
                }
                @if let Some(next) = &found.next_test {
                    h2 { "What to try next" }
                    (next_test(next))
                }
                h2 { "Where" }
                p.soft { "Shares of the imbalance that is left after the calibration, by equation and phase of the duty cycle." }
                (self.places())
                h2 { "Log and simulations over one cycle" }
                @for index in 0..found.signals.len() { (self.overlay(index)) }
                h2 { "The plant's own parameters, calibrated" }
                (self.calibrated())
                @if let Some(plant) = self.plant {
                    h2 { "What becomes of the leak estimate" }
                    (self.leak(plant))
                }
            }
            @if !found.distinguish.is_empty() {
                h2 { "What this log cannot show" }
                ul { @for line in &found.distinguish { li { (line) } } }
            }
            @if !found.notes.is_empty() {
                h2 { "About the log" }
                ul { @for line in &found.notes { li { (line) } } }
            }
        };
        page("Simulator and machine compared – seepd", &body)
    }

    /// Gap by signal: nominal, calibrated, chosen, floor.
    fn waterfall(&self) -> Markup {
        let gap = &self.diagnosis.gap;
        let of = |map: &BTreeMap<&'static str, f64>, signal: &str| map.get(signal).copied().unwrap_or(0.0);
        let rows = |signal: &'static str| {
            [
                ("nominal", of(&gap.nominal, signal), "var(--severe)"),
                ("calibrated", of(&gap.calibrated, signal), "var(--watch)"),
                ("chosen", of(&gap.chosen, signal), "var(--healthy)"),
                ("floor", of(&self.diagnosis.floor, signal), "var(--no_estimate)"),
            ]
        };
        let all = self.diagnosis.signals.iter().flat_map(|signal| rows(signal).map(|row| row.1));
        let largest = all.fold(1e-6, f64::max);
        let shrink = &self.diagnosis.shrink;
        html! {
            p { "Calibration alone removes " (percent(shrink.calibration_only, 1)) " of the removable gap, the chosen machine " (percent(shrink.of_removable, 1))
                " (" (percent(shrink.of_total, 1)) " of the whole gap)." }
            @if shrink.by_effect.len() > 1 { table.bars { tbody {
                tr { td { "calibration" } td.number { (percent(shrink.calibration_only, 1)) } td.grow { (bar(shrink.calibration_only, "var(--watch)")) } }
                @for (effect, part) in &shrink.by_effect { tr {
                    td { (effect) } td.number { (percent(*part, 1)) } td.grow { (bar(*part, "var(--healthy)")) }
                } }
            } } }
            table.bars { tbody { @for signal in &self.diagnosis.signals {
                @for (place, (name, value, colour)) in rows(signal).into_iter().enumerate() { tr {
                    td { @if place == 0 { (signal) } }
                    td { (name) }
                    td.number { (percent(value, 2)) }
                    td.grow { (bar(value / largest, colour)) }
                } }
            } } }
        }
    }

    fn ranking(&self) -> Markup {
        let found = self.diagnosis;
        let named = |finding: &&RankedEffect| finding.presence_probability >= 0.005;
        html! { table.bars {
            thead { tr { th { "Cause" } th.number { "is there" } th {} th { "values (95 %)" } th.number { "removes" } } }
            tbody {
                @for finding in found.effects.iter().filter(named) { tr {
                    td { (finding.effect)
                        br; span.soft { (finding.law) }
                        @if !finding.equivalent.is_empty() { br; span.soft { "cannot be told apart in this log: " (finding.equivalent.join(", ")) } } }
                    td.number { (percent(finding.presence_probability, 1)) }
                    td.narrow { (bar(finding.presence_probability, "var(--a)")) }
                    td { @for (name, value) in &finding.parameters { (name) " " (number(*value))
                        @if let Some([low, high]) = finding.interval95.get(name) { " (" (number(*low)) " … " (number(*high)) ")" } br; } }
                    td.number { (percent(finding.shrink, 1)) }
                } }
                tr { td { "none of these" } td.number { (percent(found.unknown_probability, 1)) } td { (bar(found.unknown_probability, "var(--b)")) } td {} td {} }
                tr { td { "no effect, only other parameters" } td.number { (percent(found.no_effect_probability, 1)) }
                    td { (bar(found.no_effect_probability, "var(--healthy)")) } td {} td {} }
            }
        }
        @if let Some(note) = found.note_on_presences() { p.soft { (note) } } }
    }

    fn places(&self) -> Markup {
        html! { table.bars { tbody { @for place in &self.diagnosis.places { tr {
            td { (place.equation) } td { (place.phase) } td { "seen in " (place.signal) }
            td.number { (percent(place.share, 1)) } td.grow { (bar(place.share, "var(--a)")) }
        } } } } }
    }

    /// The signal as recorded and as simulated, and what differs.
    fn overlay(&self, index: usize) -> Markup {
        let curves = &self.diagnosis.curves;
        let Some(recorded) = curves.recorded.get(index) else { return html! {} };
        let signal = self.diagnosis.signals[index];
        let (unit, factor) = shown_in(signal);
        let line = |values: &[f64], class| Layer::Line {
            class,
            points: curves.t_s.iter().copied().zip(values.iter().map(|value| value * factor)).collect(),
        };
        let axis = |label: &str, values: &mut dyn Iterator<Item = &f64>| {
            spanning(label, values.map(|value| value * factor).collect())
        };
        let less =
            |values: &Vec<f64>| -> Vec<f64> { values.iter().zip(recorded).map(|(a, b)| a - b).collect() };
        let empty = Vec::new();
        let of = |view: &Vec<Vec<f64>>| view.get(index).unwrap_or(&empty).clone();
        let (nominal, calibrated, chosen) = (of(&curves.nominal), of(&curves.calibrated), of(&curves.chosen));
        let end = curves.phases.last().map_or(10.0, |phase| phase.2);
        let time = || Axis::linear("time in the cycle, s", 0.0, end);
        let differences = [less(&nominal), less(&calibrated), less(&chosen)];
        // A short phase has no room for its name.
        let named = |from: f64, to: f64| to - from > SPAN_WITH_ROOM * end;
        let marks = || {
            curves.phases.iter().map(|(name, from, to)| Layer::Mark {
                at: *from,
                name: if named(*from, *to) { (*name).into() } else { String::new() },
            })
        };
        let mut layers: Vec<Layer> = marks().collect();
        layers.extend([
            line(&nominal, "stroke-soft"),
            line(&chosen, "stroke-a dash"),
            line(recorded, "stroke-b"),
        ]);
        let (label, difference) = (format!("{signal}, {unit}"), format!("difference, {unit}"));
        let together = Chart {
            layers,
            key: vec![
                ("log".into(), "var(--b)", false),
                ("simulation, nominal".into(), "var(--soft)", false),
                ("simulation, chosen".into(), "var(--a)", false),
            ],
            ..Chart::new(signal, time(), axis(&label, &mut recorded.iter().chain(&nominal).chain(&chosen)))
        };
        let apart = Chart {
            layers: vec![
                Layer::Limit { at: 0.0, name: String::new(), colour: "var(--line)" },
                line(&differences[0], "stroke-soft"),
                line(&differences[1], "stroke-b dash"),
                line(&differences[2], "stroke-a"),
            ],
            key: vec![
                ("nominal minus log".into(), "var(--soft)", false),
                ("calibrated minus log".into(), "var(--b)", false),
                ("chosen minus log".into(), "var(--a)", false),
            ],
            ..Chart::new(signal, time(), axis(&difference, &mut differences.iter().flatten()))
        };
        html! { h3 { (signal) } (together.render()) (apart.render()) }
    }

    fn calibrated(&self) -> Markup {
        html! { div.scroll { table {
            thead { tr { th { "Parameter" } th.number { "plant file" } th.number { "calibrated" } th.number { "ratio" } th.number { "95 %" } } }
            tbody { @for (symbol, value) in &self.diagnosis.calibrated { tr {
                td { (symbol) }
                td.number { (number(value.nominal)) }
                td.number { (number(value.fitted)) }
                td.number { (format!("{:.3}", value.fitted / value.nominal)) }
                td.number { (format!("{:.3} … {:.3}", value.interval95[0] / value.nominal, value.interval95[1] / value.nominal)) }
            } } }
        } } p.soft { "Values are in the units of the plant file. A wide interval means that this log does not determine the parameter; while the relief valve is always open, only one combination of Q_pump, p_prv and R_prv is determined." } }
    }

    fn leak(&self, plant: &PlantParameters) -> Markup {
        let lpm = |area: f64| plant.orifice_flow_m3_per_s(area, REFERENCE_DP_PA) * LPM_PER_M3_PER_S;
        let leak = &self.diagnosis.leak;
        let rows =
            [("plant file", leak.nominal_m2), ("calibrated", leak.calibrated_m2), ("chosen", leak.chosen_m2)];
        html! { table {
            thead { tr { th { "By" } th.number { "area, mm²" } th.number { "L/min at " (quantity::bar(REFERENCE_DP_PA)) " bar" } } }
            tbody { @for (name, area) in rows { tr {
                td { (name) } td.number { (quantity::mm2(area)) } td.number { (format!("{:.3}", lpm(area))) }
            } } }
        } }
    }
}

/// Laws that were learned where no effect explains the log, each with its curve and band.
fn learned_laws(laws: &[LearnedCurve]) -> Markup {
    let told = laws.iter().filter(|law| law.adopted || law.probability >= 0.01);
    html! {
        p.soft { "No effect of the catalogue explains what is left, so that a function was learned at each place where it may act, beside the calibrated parameters. \
            The band holds the curve with 95 % probability if it is there; where the log did not go, it is wide." }
        @for law in told {
            h3 { (law.place) " over " (law.argument) ": " (percent(law.probability, 1)) }
            p { (law.resembles) ". With it " (percent(law.shrink, 1)) " of the removable gap is gone on held-out cycles"
                @if law.adopted { "; the machine as chosen has it, and " code { "--emit-plant" } " writes it as " code { (law.effect) } }
                ". " span.soft { (law.law) } }
            (learned_curve(law))
        }
    }
}

/// Tests and sensors that would tell the remaining explanations apart.
fn next_test(next: &NextTest) -> Markup {
    html! {
        p.soft { "What would tell these apart: "
            (next.explanations.iter().map(|(name, share)| format!("{name} ({})", percent(*share, 1))).collect::<Vec<_>>().join(", ")) "." }
        @if !next.tells { p { "No allowed test is expected to tell them apart for certain." } }
        table.bars {
            thead { tr { th { "Test" } th.number { "length" } th.number { "information" } th.number { "the right one would then have" } } }
            tbody { @for proposal in &next.proposals { tr {
                td { (proposal.what) }
                td.number { @if proposal.sensor.is_none() { (format!("{:.0} s", proposal.seconds)) } }
                td.number { (format!("{:.2} bit", proposal.information_bit)) }
                td.number { (percent(proposal.expected_probability, 1)) }
            } } }
        }
        @if let Some(best) = next.proposals.first() {
            p { "What the first of them would show:" }
            ul { @for outcome in &best.outcomes { li { (told(outcome)) } } }
        }
    }
}

fn learned_curve(law: &LearnedCurve) -> Markup {
    let (along, x) = shown_unit(law.units[0]);
    let (across, y) = shown_unit(law.units[1]);
    let of = |value: &dyn Fn(usize) -> f64| -> Vec<(f64, f64)> {
        (0..law.at.len()).map(|knot| (law.at[knot] * x, value(knot) * y)).collect()
    };
    let largest = law.values.iter().map(|value| value.abs()).fold(0.0, f64::max);
    // A band that goes on to the sky where the log has not been leaves no room for the curve.
    let held = |value: f64| value.clamp(-2.5 * largest, 2.5 * largest);
    let band: Vec<(f64, f64, f64)> = (0..law.at.len())
        .map(|knot| (law.at[knot] * x, held(law.band95[knot][0]) * y, held(law.band95[knot][1]) * y))
        .collect();
    let all = band.iter().flat_map(|(_, low, high)| [*low, *high]).collect();
    let ends = (law.at.first().copied().unwrap_or(0.0) * x, law.at.last().copied().unwrap_or(1.0) * x);
    let chart = Chart {
        layers: vec![
            Layer::Limit { at: 0.0, name: String::new(), colour: "var(--line)" },
            Layer::Band { class: "fill-band", points: band },
            Layer::Line { class: "stroke-a", points: of(&|knot| law.values[knot]) },
        ],
        key: vec![("learned".into(), "var(--a)", false), ("95 % band".into(), "var(--soft)", false)],
        ..Chart::new(
            law.place,
            Axis::linear(&format!("{}, {along}", law.argument), ends.0, ends.1),
            spanning(&format!("{}, {across}", law.place), all),
        )
    };
    chart.render()
}

/// The unit in which people read a quantity, and its size of the SI unit.
fn shown_unit(unit: &str) -> (&'static str, f64) {
    match unit {
        "Pa" => ("bar", quantity::BAR_PER_PA),
        "m" => ("mm", 1e3),
        "m/s" => ("mm/s", 1e3),
        "N" => ("kN", 1e-3),
        "m3/s" => ("L/min", LPM_PER_M3_PER_S),
        "s" => ("s", 1.0),
        _ => ("share of full", 1.0),
    }
}

fn bar(share: f64, colour: &'static str) -> Markup {
    html! { span.bar style=(format!("--c:{colour};width:{:.1}%", 100.0 * share.clamp(0.0, 1.0))) {} }
}

/// The unit in which a signal is drawn, and its size of the signal's SI unit.
fn shown_in(signal: &str) -> (&'static str, f64) {
    match Signal::from_name(signal) {
        Some(Signal::PSupply | Signal::PInlet | Signal::PCap | Signal::PRod) => ("bar", quantity::BAR_PER_PA),
        Some(Signal::Demand | Signal::Position) => ("mm", 1e3),
        Some(Signal::Load) => ("kN", 1e-3),
        _ => ("share of full", 1.0),
    }
}

/// An axis that holds all finite values with a little room.
fn spanning(label: &str, values: Vec<f64>) -> Axis {
    let finite = || values.iter().copied().filter(|value| value.is_finite());
    let low = finite().fold(f64::INFINITY, f64::min);
    let high = finite().fold(f64::NEG_INFINITY, f64::max);
    let room = (0.06 * (high - low)).max(1e-12);
    Axis::linear(label, low - room, high + room)
}

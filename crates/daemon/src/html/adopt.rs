//! The page that `seepd adopt` leaves.

use std::collections::BTreeMap;

use maud::{Markup, html};
use seepd_adopt::plant::PlantValue;
use seepd_logs::SignalMapping;
use seepd_monitor::baseline::BaselineFile;
use seepd_signals::Signal;
use seepd_sim::{MachineSpec, PlantParameters};
use seepd_train::Trained;

use super::chart::{Axis, Chart, Layer, number};
use super::{catalogue, page};
use crate::commands::adopt::Described;
use crate::commands::adopt::capability::Capability;
use crate::commands::adopt::told;
use crate::quantity::percent;

/// Cycles that are laid over each other, and points of each.
const DRAWN_CYCLES: usize = 30;
const DRAWN_POINTS: f64 = 400.0;

/// What the page shows.
pub(crate) struct AdoptPage<'a> {
    /// Name of the axis.
    pub(crate) axis: &'a str,
    /// What the log and the data sheet gave; `None` where an earlier run's files were taken.
    pub(crate) described: Option<&'a Described>,
    /// The plant.
    pub(crate) plant: &'a MachineSpec,
    /// Where the signals are.
    pub(crate) mapping: &'a BTreeMap<Signal, SignalMapping>,
    /// The baseline.
    pub(crate) baseline: &'a BaselineFile,
    /// What the monitoring can tell.
    pub(crate) capability: &'a Capability,
    /// The training's report, where a model was trained.
    pub(crate) trained: Option<&'a Trained>,
}

impl AdoptPage<'_> {
    /// The page's text.
    pub(crate) fn render(&self) -> String {
        let body = html! {
            h1 { "Adopted: " (self.axis) }
            (self.tells())
            h2 { "Where the signals are" }
            (self.signals())
            @if let Some(described) = self.described {
                h2 { "The duty cycle" }
                (cycle(described))
                h2 { "Simulation and log" }
                (gap(described))
            }
            h2 { "The machine" }
            (self.machine())
            h2 { "The baseline" }
            (self.learned())
            h2 { "What to do next" }
            p { "Look at the cycles above: are they your machine's, with the strokes where they belong? Then " code { "seepd replay --config seepd.toml LOG" }
                " reads further logs, and " code { "seepd adopt … --install" } " puts the files where the service finds them. What is wrong can be edited: "
                "the mapping in seepd.toml, what you know in machine.toml (both: " code { "--from cycle" } "), the plant in plant.toml (" code { "--from model" } ")." }
        };
        page("Adopted machine – seepd", &body)
    }

    fn tells(&self) -> Markup {
        let capability = self.capability;
        html! {
            p { "What the monitoring of this machine will be able to tell, by simulation of this machine and by how its own cycles repeat:" }
            table {
                thead { tr { th { "Smallest leak found" } th.number { "command alone" } th.number { "with a measured load" } } }
                tbody { @for (cycles, alone, with_load) in &capability.smallest_lpm { tr {
                    td { "within " (cycles) " cycles" }
                    td.number { (format!("{alone:.3} L/min")) }
                    td.number { (format!("{with_load:.3} L/min")) }
                } } }
            }
            p {
                @if let Some(error) = capability.size_error { "Leaks above 1 L/min are sized within " (format!("{:.1}", 100.0 * error)) " % (median over simulated machines). " }
                "False alarms by the sums' design: " (capability.false_alarms()) "."
            }
            @for advice in &capability.advice { p { (advice) } }
        }
    }

    fn signals(&self) -> Markup {
        html! { div.scroll { table {
            thead { tr { th { "Signal" } th { "in the log" } th.number { "scale" } th.number { "offset" } th { "why" } } }
            tbody { @for (signal, mapping) in self.mapping { tr {
                td { (signal.name()) }
                td { @if !mapping.topic.is_empty() { (mapping.topic) " · " } (mapping.field) }
                td.number { (number(mapping.scale)) }
                td.number { (number(mapping.offset)) }
                td { @if let Some(assigned) = self.described.and_then(|described| described.proposal.assigned.get(signal)) { (assigned.evidence.join(" ")) } }
            } } }
        } } }
    }

    fn machine(&self) -> Markup {
        let values = self.described.map(|described| &described.adoption.values);
        let of = |key: &str| values.and_then(|values| values.get(key));
        let words = |value: &PlantValue| {
            format!("{}, within ± {:.0} %", value.origin.words(), 100.0 * value.tolerance)
        };
        let c = &self.plant.controller;
        // An integrator that always works has none.
        let window = (c.integral_window_m > 0.0).then_some((
            "window of the integrator",
            "integral_window_m",
            1e3 * c.integral_window_m,
            "mm",
        ));
        html! {
            @if let Some(described) = self.described {
                @for remark in &described.adoption.remarks { p { (sentence(remark)) } }
            }
            div.scroll { table {
                thead { tr { th { "Value" } th { "is" } th { "where it comes from" } th { "in plant.toml" } } }
                tbody {
                    @for info in PlantParameters::ALL {
                        @let si = self.plant.plant.get(info.key).unwrap_or(f64::NAN);
                        @let (value, unit) = catalogue::value(info, si);
                        tr {
                            td { (catalogue::words(info)) }
                            td { (number(value)) " " (unit) }
                            td { @if let Some(value) = of(info.key) { (words(value)) } }
                            td.soft { (info.key) " = " (number(si)) }
                        }
                    }
                    @for (name, key, value, unit) in [("proportional gain", "kp", c.kp, "1/m"), ("integral gain", "ki", c.ki, "1/(m s)"),
                        ("derivative gain", "kd", c.kd, "s/m"), ("velocity feed-forward", "velocity_feed_forward_s_per_m", c.velocity_feed_forward_s_per_m, "s/m"),
                        ("jump over the dead band", "dead_band_compensation", c.dead_band_compensation, "of full command")].into_iter().chain(window) { tr {
                        td { "Controller: " (name) } td { (number(value)) " " (unit) } td {} td.soft { "controller." (key) }
                    } }
                    @for (effect, values) in &self.plant.effects { @for (name, value) in values { tr {
                        td { "Effect: " (effect.replace('_', " ")) } td { (number(*value)) " " (catalogue::unit_of_effect(effect, name)) }
                        td {} td.soft { "effects." (effect) "." (name) }
                    } } }
                }
            } }
        }
    }

    fn learned(&self) -> Markup {
        let Some(baseline) = self.baseline.newest() else { return html! {} };
        html! {
            p { (baseline.cycles) " cycles, " (baseline.left_out) " were unlike the others and left out. Noise of the command: " (format!("{:.4}", baseline.noise)) " of full." }
            @for remark in &baseline.remarks { p { (sentence(remark)) } }
            @if let Some(trained) = self.trained {
                p.soft { "The model learned from " (trained.learned.target.len()) " simulated machines; of the leaks of others, "
                    (format!("{:.0}", 100.0 * trained.report.accuracy.coverage)) " % lie within its 90 % intervals." }
            }
        }
    }
}

/// A remark as a sentence of its own. A key that it begins with stays as it is written in files.
fn sentence(remark: &str) -> String {
    let end = if remark.ends_with(['.', '?', '!']) { "" } else { "." };
    let begins_with_a_key = remark.split(' ').next().is_some_and(|word| word.contains(['.', '_']));
    let mut letters = remark.chars();
    match letters.next().filter(|_| !begins_with_a_key) {
        Some(first) => format!("{}{}{end}", first.to_uppercase(), letters.as_str()),
        None => format!("{remark}{end}"),
    }
}

/// The recorded cycles over each other, with the strokes marked.
fn cycle(described: &Described) -> Markup {
    let found = &described.found;
    let tick_s = found.period_s / DRAWN_POINTS;
    let mut signals = vec![(Signal::Command, 1.0, "command, share of full")];
    if described.recording.log.get(Signal::Position).is_some() {
        signals.push((Signal::Position, 1e3, "position, mm"));
    } else if described.recording.log.get(Signal::Demand).is_some() {
        signals.push((Signal::Demand, 1e3, "demand, mm"));
    }
    let step = (found.cycles.len() / DRAWN_CYCLES).max(1);
    let charts = signals.into_iter().map(|(signal, factor, label)| {
        let mut layers: Vec<Layer> = found
            .strokes
            .iter()
            .map(|stroke| Layer::Mark { at: stroke.from_s, name: stroke.name.clone() })
            .collect();
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for index in (0..found.cycles.len()).step_by(step) {
            let Some(values) = found.cycle_of(&described.recording, signal, index, tick_s) else { continue };
            let points: Vec<(f64, f64)> = values
                .iter()
                .enumerate()
                .filter(|(_, value)| value.is_finite())
                .map(|(place, value)| (place as f64 * tick_s, factor * value))
                .collect();
            (low, high) =
                points.iter().fold((low, high), |(low, high), point| (low.min(point.1), high.max(point.1)));
            layers.push(Layer::Line { class: "stroke-soft", points });
        }
        let room = 0.05 * (high - low);
        let x = Axis::linear("time in the cycle, s", 0.0, found.period_s);
        Chart { layers, ..Chart::new(label, x, Axis::linear(label, low - room, high + room)) }
    });
    html! {
        p { (found.cycles.len()) " cycles of " (format!("{:.2}", found.period_s)) " s with " (found.strokes.len()) " strokes, found by the "
            (found.guide.signal().name()) ". " @if found.left_out > 0 { (found.left_out) " strokes belong to no cycle: moves by hand, set-up, cycles that were broken off." } }
        @if let Some(sentence) = told::open_loop(found) { p { "Strokes " (sentence) "." } }
        @for chart in charts { (chart.render()) }
    }
}

/// How far simulation and log are apart, by signal.
fn gap(described: &Described) -> Markup {
    let Some(calibration) = &described.adoption.calibration else {
        return html! { p { "The log has no position, so that nothing could be calibrated. The tolerances of the data stay in the intervals. "
        @if let Some(rest) = described.adoption.demand_rest { "The demand was looked for under which the simulated machine gives this command; "
            (format!("{:.1}", 100.0 * rest)) " % of the command's range stay unexplained." } } };
    };
    let share = |map: &BTreeMap<&'static str, f64>, signal: &str| {
        percent(map.get(signal).copied().unwrap_or(f64::NAN), 2)
    };
    let bins = calibration.recorded.first().map_or(1, Vec::len);
    let width_s = described.adoption.spec.cycle.period_s / bins as f64;
    let line = |values: &[f64], class| Layer::Line {
        class,
        points: values
            .iter()
            .enumerate()
            .map(|(bin, value)| ((bin as f64 + 0.5) * width_s, *value))
            .collect(),
    };
    let (recorded, simulated) = (&calibration.recorded[0], &calibration.simulated[0]);
    let all = || recorded.iter().chain(simulated).copied().filter(|value| value.is_finite());
    let (low, high) = (all().fold(f64::INFINITY, f64::min), all().fold(f64::NEG_INFINITY, f64::max));
    let room = 0.05 * (high - low);
    let chart = Chart {
        layers: vec![line(recorded, "stroke-b"), line(simulated, "stroke-a dash")],
        key: vec![("log".into(), "var(--b)", false), ("simulation, calibrated".into(), "var(--a)", false)],
        ..Chart::new(
            "command: log and calibrated simulation",
            Axis::linear("time in the cycle, s", 0.0, described.adoption.spec.cycle.period_s),
            Axis::linear("command, share of full", low - room, high + room),
        )
    };
    html! {
        p { "RMS differences on cycles that nothing was fitted to, over each signal's range. The last column is what cycles differ among themselves, which no simulation can match." }
        table {
            thead { tr { th { "Signal" } th.number { "before" } th.number { "calibrated" } th.number { "among cycles" } } }
            tbody { @for signal in calibration.gaps[1].keys() { tr {
                td { (signal) } td.number { (share(&calibration.gaps[0], signal)) } td.number { (share(&calibration.gaps[1], signal)) } td.number { (share(&calibration.floor, signal)) }
            } } }
        }
        (chart.render())
    }
}

#[cfg(test)]
mod tests {
    use super::sentence;

    #[test]
    fn remarks_become_sentences_and_keys_stay_as_they_are() {
        assert_eq!(sentence("the log is short"), "The log is short.");
        assert_eq!(sentence("valve.rated_flow_lpm is not given."), "valve.rated_flow_lpm is not given.");
        assert_eq!(sentence("öl is cold; is it?"), "Öl is cold; is it?");
    }
}

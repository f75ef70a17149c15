//! The page that `seepd evaluate --html` leaves.

use maud::{Markup, html};
use seepd_model::accuracy::Judged;

use super::chart::{Axis, Chart, Layer, Size};
use super::page;
use crate::evaluation::Evaluation;
use crate::evaluation::detection::Detection;
use crate::evaluation::roc::Roc;
use crate::evaluation::sizes::Sizes;
use crate::quantity::{MM2_PER_M2, bar, mm2, percent};
use crate::sink::evaluation::{decade_text, false_alarms, or_dash};
use crate::sink::terminal::listed;

/// Most points of a cloud.
const SHOWN: usize = 3000;
/// Lines of curves, from front to back.
const LINES: [(&str, &str); 3] =
    [("stroke-a", "var(--a)"), ("stroke-b", "var(--b)"), ("stroke-soft dash", "var(--soft)")];

/// What the page shows.
pub struct EvaluationPage<'a> {
    /// The evaluation.
    pub evaluation: &'a Evaluation,
}

impl EvaluationPage<'_> {
    /// The page's text.
    pub fn render(&self) -> String {
        let Evaluation { conditions, machines, cycles, rejected, without_truth, .. } = self.evaluation;
        let body = html! {
            h1 { "Estimates and alarms beside the truth" }
            p { (machines) " machines, " (cycles) " cycles. Flows are given at " (bar(conditions.reference_dp_pa)) " bar. A machine counts as leaking from "
                (conditions.onset_lpm) " L/min on." }
            @if !rejected.is_empty() {
                p.soft { "Cycles without an estimate: " (listed(rejected)) "." }
            }
            @if *without_truth > 0 { p.soft { (without_truth) " cycles have no known truth and are left out of all figures." } }
            h2 { "Sizes" }
            p.soft { "Each point is a cycle; on the line the estimate equals the truth. Values below the scales are drawn on their edges." }
            div.grid-2 { @for sizes in &self.evaluation.sizes { (cloud(sizes)) } }
            @for sizes in &self.evaluation.sizes { (size_table(sizes)) }
            h2 { "Detection" }
            @for detection in &self.evaluation.detection { (self.detection(detection)) }
            h2 { "Receiver operating curves" }
            @if self.evaluation.roc.is_empty() {
                p { "A curve needs cycles with a leak and cycles without one." }
            } @else {
                p.soft { "For every threshold of a score: the share of the cycles with a leak that it finds, against the share of the healthy cycles that it takes for leaks." }
                (roc_chart(&self.evaluation.roc))
                (roc_table(&self.evaluation.roc))
            }
        };
        page("Evaluation – seepd", &body)
    }

    fn detection(&self, detection: &Detection) -> Markup {
        let within = self.evaluation.conditions.within_cycles;
        html! {
            h3 { "By " (detection.detector.name()) }
            p { (false_alarms(detection)) "." }
            @if detection.classes.is_empty() { p { "No leak begins in these records." } } @else {
                div.scroll { table {
                    thead { tr { th { "Leak, L/min" } th.number { "machines" } th.number { "median leak" }
                        th.number { "found within " (within) " cycles" } th.number { "median cycles to the alarm" } } }
                    tbody { @for line in &detection.classes { tr {
                        td { (line.class) } td.number { (line.machines) } td.number { (format!("{:.3}", line.median_lpm)) }
                        td.number { (percent(line.share_found(), 1)) }
                        td.number { @match line.median_cycles { Some(cycles) => (cycles), None => "–" } }
                    } } }
                } }
                p { "Smallest leak found by 95 %: " @match detection.smallest_found_lpm {
                    Some(lpm) => (format!("{lpm:.3} L/min")), None => "none of these" } "." }
                (delays(detection, within))
            }
        }
    }
}

/// Cycles to the alarm by size.
fn delays(detection: &Detection, within: usize) -> Markup {
    let points: Vec<(f64, f64)> = detection
        .onsets
        .iter()
        .filter_map(|onset| Some((onset.leak_lpm, onset.found_after_cycles? as f64)))
        .collect();
    let sizes = detection.onsets.iter().map(|onset| onset.leak_lpm);
    let (low, high) = (sizes.clone().fold(f64::INFINITY, f64::min), sizes.fold(0.0, f64::max));
    let longest = points.iter().map(|point| point.1).fold(within as f64, f64::max);
    Chart {
        layers: vec![
            Layer::Limit { at: within as f64, name: format!("{within} cycles"), colour: "var(--watch)" },
            Layer::Points { class: "dot-a", points },
        ],
        ..Chart::new(
            "Cycles from the leak's onset to the alarm, by the leak",
            Axis::logarithmic("leak, L/min", (0.8 * low).max(1e-3), (1.25 * high).max(2e-3)),
            Axis::linear("cycles to the alarm", 0.0, 1.05 * longest),
        )
    }
    .render()
}

fn cloud(sizes: &Sizes) -> Markup {
    let step = sizes.judged.len().div_ceil(SHOWN).max(1);
    let in_mm2 = |case: &Judged| (case.truth_m2 * MM2_PER_M2, case.estimate_m2 * MM2_PER_M2);
    let points = sizes.judged.iter().step_by(step).map(in_mm2).collect();
    let axis = |label: &str| Axis::logarithmic(label, 1e-3, 20.0);
    Chart {
        size: Size::Half,
        layers: vec![
            Layer::Line { class: "stroke-soft", points: vec![(1e-3, 1e-3), (20.0, 20.0)] },
            Layer::Points { class: "dot-a", points },
        ],
        ..Chart::new(sizes.method.name(), axis("truth, mm²"), axis("estimate, mm²"))
    }
    .render()
}

fn size_table(sizes: &Sizes) -> Markup {
    let healthy = &sizes.healthy;
    html! {
        h3 { "Sizes " (sizes.method.name()) }
        div.scroll { table {
            thead { tr { th { "Leak, mm²" } th.number { "cycles" } th.number { "median error" } th.number { "90 % interval holds" } } }
            tbody {
                @for decade in &sizes.decades { tr {
                    td { (decade_text(decade)) } td.number { (decade.count) }
                    td.number { (percent(decade.median_relative_error, 2)) } td.number { (percent(decade.coverage, 1)) }
                } }
                tr { td { "none" } td.number { (healthy.cycles) } td.number { "" }
                    td.number { (percent(healthy.coverage(), 1)) } }
            }
        } }
        p.soft { "R² of the area " (or_dash(sizes.r2_area, |value| format!("{value:.5}"))) ", mean error "
            (or_dash(sizes.mean_absolute_error_m2, |value| format!("{} mm²", mm2(value)))) ", median error above " (sizes.large.from_lpm) " L/min "
            (percent(sizes.large.median_relative_error, 2))
            @if healthy.cycles > 0 { ", largest estimate without a leak " (mm2(healthy.largest_m2)) " mm²" } "." }
    }
}

fn roc_chart(curves: &[Roc]) -> Markup {
    let shown = || curves.iter().zip(LINES);
    let line = |(roc, (class, _)): (&Roc, (&'static str, &str))| Layer::Line {
        class,
        points: roc.points.iter().map(|[false_share, found]| (*false_share, *found)).collect(),
    };
    Chart {
        layers: shown().map(line).collect(),
        key: shown().map(|(roc, (_, colour))| (roc.score.name().to_owned(), colour, false)).collect(),
        ..Chart::new(
            "Receiver operating curves",
            Axis::linear("share of healthy cycles taken for leaks", 0.0, 1.0),
            Axis::linear("share of leaks found", 0.0, 1.0),
        )
    }
    .render()
}

fn roc_table(curves: &[Roc]) -> Markup {
    html! { div.scroll { table {
        thead { tr { th { "Score" } th { "Leak, L/min" } th.number { "cycles" } th.number { "area under the curve" } } }
        tbody { @for roc in curves {
            tr { td { (roc.score.name()) } td { "all" } td.number { (roc.leaking_cycles) } td.number { (format!("{:.4}", roc.area)) } }
            @for class in &roc.classes { tr {
                td { "" } td { (class.class) } td.number { (class.cycles) } td.number { (format!("{:.4}", class.area)) }
            } }
        } }
    } } }
}

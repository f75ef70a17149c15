//! The page that `seepd demo` leaves.

use maud::{Markup, html};
use seepd_monitor::alarm::AlarmConfig;
use seepd_monitor::event::Flag;

use super::chart::{Axis, Chart, Layer};
use super::flags::{self, colour};
use super::page;
use crate::quantity::{bar, percent};

/// An estimate beside the truth.
#[derive(Debug, Clone, PartialEq)]
pub struct Point {
    /// Middle of the cycle, s.
    pub t_s: f64,
    /// Truth, L/min.
    pub truth_lpm: f64,
    /// Estimate, L/min.
    pub estimate_lpm: f64,
    /// Interval, L/min.
    pub interval_lpm: [f64; 2],
    /// Flag after the cycle.
    pub flag: Flag,
}

/// A flag that rose or fell.
#[derive(Debug, Clone, PartialEq)]
pub struct FlagChange {
    /// When, s.
    pub t_s: f64,
    /// Cycle that decided.
    pub cycle: u64,
    /// Flag before.
    pub from: Flag,
    /// Flag now.
    pub to: Flag,
    /// Truth at that time, L/min.
    pub truth_lpm: f64,
    /// When the truth passed the flag's threshold, s.
    pub truth_passed_s: Option<f64>,
}

/// What the page shows.
#[derive(Debug, Clone, PartialEq)]
pub struct DemoPage {
    /// Name of the log.
    pub log: String,
    /// Reference pressure difference, Pa.
    pub reference_dp_pa: f64,
    /// Thresholds.
    pub alarm: AlarmConfig,
    /// Command of a healthy cycle: time in the cycle, s, and command.
    pub healthy: Vec<(f64, f64)>,
    /// Command of the last cycle.
    pub worn: Vec<(f64, f64)>,
    /// Estimates.
    pub points: Vec<Point>,
    /// Changes of flag.
    pub changes: Vec<FlagChange>,
    /// Median of |estimate − truth| / truth above the watch threshold, 1.
    pub median_error: f64,
    /// Length of the log, s.
    pub duration_s: f64,
}

impl DemoPage {
    /// The page's text.
    pub fn render(&self) -> String {
        let reference_bar = bar(self.reference_dp_pa);
        let last = self.points.last();
        let body = html! {
            h1 { "A piston seal wears, and the valve command shows it" }
            p {
                "A simulated press ran " (self.points.len()) " duty cycles while its seal wore out. The monitor saw nothing but "
                "the PID valve command in " code { (self.log) } ", with measurement noise of 0.001."
                @if let Some(last) = last {
                    " At the end it says " strong { (format!("{:.2} L/min", last.estimate_lpm)) } " at " (reference_bar)
                    " bar; the truth is " strong { (format!("{:.2} L/min", last.truth_lpm)) } ". Median error above the watch threshold: "
                    strong { (percent(self.median_error, 1)) } "."
                }
            }
            h2 { "The command of a healthy and of a worn cycle" }
            p.soft { "The controller makes up for the leak: during the holds the valve stays a little open, and the strokes need more or less of it." }
            (self.command_chart().render())
            h2 { "The leak, estimated and true" }
            p.soft { "Flow through the leak at " (reference_bar) " bar, on a logarithmic scale. The band is meant to hold the truth nine times in ten. "
                "Values below the scale are drawn on its lower edge." }
            (self.leak_chart().render())
            h2 { "The flags" }
            p.soft { "A flag rises after " (self.alarm.raise_cycles) " cycles in a row at or above its threshold. The delay is counted from the moment at which the truth passed the threshold." }
            (self.flag_chart().render())
            (self.change_table())
        };
        page("seepd demo", &body)
    }

    fn command_chart(&self) -> Chart {
        let all = || self.healthy.iter().chain(&self.worn);
        let limit = all().map(|point| point.1.abs()).fold(0.1, f64::max);
        let end = all().map(|point| point.0).fold(1.0, f64::max);
        Chart {
            layers: vec![
                Layer::Line { class: "stroke-a", points: self.healthy.clone() },
                Layer::Line { class: "stroke-b", points: self.worn.clone() },
            ],
            key: vec![("healthy".into(), "var(--a)", false), ("worn".into(), "var(--b)", false)],
            ..Chart::new(
                "Valve command over the time in the cycle, healthy and worn",
                Axis::linear("time in the cycle, s", 0.0, (end * 10.0).round() / 10.0),
                Axis::linear("valve command", -1.05 * limit, 1.05 * limit),
            )
        }
    }

    fn leak_chart(&self) -> Chart {
        let highest = self
            .points
            .iter()
            .map(|p| p.interval_lpm[1].max(p.truth_lpm))
            .fold(self.alarm.severe_lpm, f64::max);
        let line =
            |value: &dyn Fn(&Point) -> f64| self.points.iter().map(|p| (p.t_s / 60.0, value(p))).collect();
        let limit = |name: &str, at, flag| Layer::Limit {
            at,
            name: format!("{name} {at} L/min"),
            colour: colour(flag),
        };
        Chart {
            layers: vec![
                Layer::Band {
                    class: "fill-band",
                    points: self
                        .points
                        .iter()
                        .map(|p| (p.t_s / 60.0, p.interval_lpm[0], p.interval_lpm[1]))
                        .collect(),
                },
                limit("watch", self.alarm.watch_lpm, Flag::Watch),
                limit("leak", self.alarm.leak_lpm, Flag::Leak),
                limit("severe", self.alarm.severe_lpm, Flag::Severe),
                Layer::Line { class: "stroke-b dash", points: line(&|p| p.truth_lpm) },
                Layer::Line { class: "stroke-a", points: line(&|p| p.estimate_lpm) },
            ],
            key: vec![
                ("estimate".into(), "var(--a)", false),
                ("90 % interval".into(), "var(--band)", true),
                ("truth".into(), "var(--b)", false),
            ],
            ..Chart::new(
                "Leak flow over time, estimated and true",
                Axis::linear("time, min", 0.0, self.duration_s / 60.0),
                Axis::logarithmic("leak, L/min", 0.03, highest * 1.2),
            )
        }
    }

    fn flag_chart(&self) -> Chart {
        let changes: Vec<(f64, Flag)> =
            self.changes.iter().map(|change| (change.t_s / 60.0, change.to)).collect();
        flags::chart(Axis::linear("time, min", 0.0, self.duration_s / 60.0), &changes)
    }

    fn change_table(&self) -> Markup {
        html! {
            div.scroll { table {
                thead { tr {
                    th { "Flag" } th.number { "cycle" } th.number { "time, s" } th.number { "true leak then, L/min" }
                    th.number { "truth passed the threshold at, s" } th.number { "delay, cycles" }
                } }
                tbody { @for change in &self.changes { tr {
                    td { span.tag style=(format!("background:{}", colour(change.to))) { (change.to.name()) } }
                    td.number { (change.cycle) }
                    td.number { (format!("{:.1}", change.t_s)) }
                    td.number { (format!("{:.3}", change.truth_lpm)) }
                    td.number { @match change.truth_passed_s { Some(at) => (format!("{at:.1}")), None => "–" } }
                    td.number { @match change.truth_passed_s {
                        Some(at) => (format!("{:.1}", (change.t_s - at) / self.cycle_s())), None => "–",
                    } }
                } } }
            } }
        }
    }

    fn cycle_s(&self) -> f64 {
        self.duration_s / self.points.len().max(1) as f64
    }
}

//! The page that `seepd replay --html` leaves.

use maud::{Markup, html};
use seepd_monitor::alarm::AlarmConfig;
use seepd_monitor::baseline::Baseline;
use seepd_monitor::cause::condition::{growth_sentence, words_of};
use seepd_monitor::cause::course::Severity;
use seepd_monitor::event::{Flag, Summary};
use seepd_monitor::reason::NO_PLANT_MODEL;
use seepd_monitor::repair::{FIRST_DATE_NS, RepairVerdict};

use super::chart::{Axis, Chart, Layer, Size};
use super::flags::{self, colour};
use super::page;
use crate::config::EnergyConfig;
use crate::quantity::{MM2_PER_M2, bar, mm2, mm2_interval};
use crate::reasons::meaning;
use crate::sink::html::{Curves, HtmlSink, Point, Why};
use crate::verdict::Verdict;

/// What the page shows.
pub struct ReportPage<'a> {
    /// The record.
    pub record: &'a HtmlSink,
    /// What it comes to.
    pub summary: &'a Summary,
    /// What was seen and what to do, where there is no size.
    pub advice: Option<&'a str>,
    /// Thresholds.
    pub alarm: &'a AlarmConfig,
    /// Leak area of 1 L/min at the reference pressure difference, m².
    pub area_m2_per_lpm: f64,
    /// Hours that the machine runs in a year.
    pub operating_hours_per_year: f64,
    /// What energy costs.
    pub energy: &'a EnergyConfig,
    /// Baselines on record by duty cycle, the newest last; the name is empty for the only one.
    pub baselines: &'a [(String, Vec<Baseline>)],
}

/// Contributions that are shown.
const PARTS_SHOWN: usize = 8;

/// A date and time, or seconds of a clock that has none.
fn time_text(time_ns: i64) -> String {
    let date = jiff::Timestamp::from_nanosecond(i128::from(time_ns)).ok();
    match date.filter(|_| time_ns >= FIRST_DATE_NS) {
        Some(date) => date.strftime("%Y-%m-%d %H:%M:%S UTC").to_string(),
        None => format!("{:.1} s", time_ns as f64 / 1e9),
    }
}

impl ReportPage<'_> {
    /// The page's text.
    pub fn render(&self) -> String {
        let title = format!("Piston seal of {}", self.summary.axis);
        let body = html! {
            h1 { (title) }
            (self.verdict())
            (self.tiles())
            @if let Some(curves) = self.record.curves() { (self.command(&curves)) }
            @if self.points().next().is_some() {
                h2 { "The leak" }
                p.soft { "The estimate of each cycle. The band is meant to hold the truth nine times in ten, on machines like those that the model was trained on. "
                    "On the left the flow at " (self.reference_bar()) " bar, on the right the area of the same leak. Estimates below the scale are drawn on its lower edge." }
                (self.leak_chart().render())
            }
            @if let Some(why) = &self.record.why { (why_table(why)) }
            @if self.baselines.iter().any(|(_, record)| !record.is_empty()) { (self.baseline_record()) }
            @if !self.summary.conditions.is_empty() { (self.conditions()) }
            @if !self.summary.repairs.is_empty() { (self.repair_log()) }
            h2 { "The flags" }
            (self.flags())
            h2 { "Rejected cycles" }
            (self.rejected())
            @if self.points().next().is_some() {
                h2 { "The features" }
                p.soft { "What the model sees of each cycle, by number of the cycle. A step in all of them at once points to a change of the machine "
                    "(valve, load, duty cycle) rather than to wear." }
                div.grid-3 { @for index in 0..self.record.feature_names.len() { (self.feature_chart(index).render()) } }
            }
            h2 { "The logs" }
            (self.logs())
        };
        page(&format!("{title} – seepd"), &body)
    }

    /// Whether there is no model, and so never a size.
    fn is_relative(&self) -> bool {
        self.summary.size_withheld == Some(NO_PLANT_MODEL)
    }

    fn reference_bar(&self) -> f64 {
        bar(self.summary.reference_dp_pa)
    }

    fn points(&self) -> impl Iterator<Item = &Point> + Clone {
        self.record.points.iter()
    }

    /// Numbers of the first and of the last cycle, as ends of an axis.
    fn cycle_axis(&self, label: &str) -> Axis {
        let last = self.summary.cycles + self.summary.rejected.values().sum::<u64>();
        Axis::linear(label, 0.0, last.saturating_sub(1).max(1) as f64)
    }

    fn verdict(&self) -> Markup {
        let summary = self.summary;
        let flag = summary.flag;
        let is_thin = flag == Flag::Healthy && !self.is_relative() && summary.size_withheld.is_some();
        let Verdict { verdict, to_do } = Verdict::of(flag, summary.reason, self.is_relative());
        let (text, to_do) = if is_thin {
            ("Too few cycles have an estimate for a verdict on the machine.".to_owned(), None)
        } else {
            // Without an estimate the advice, which has seen the log, says more.
            (verdict, (flag != Flag::NoEstimate || self.advice.is_none()).then_some(to_do))
        };
        html! {
            p {
                span.tag style=(format!("background:{}", colour(flag))) { (flag.name().replace('_', " ")) } " " (text)
                @if summary.highest_flag > flag { " The highest flag in this record was " (summary.highest_flag.name()) "." }
            }
            @if let Some(to_do) = to_do { p { (to_do) } }
            @if let Some(condition) = &summary.condition { p { "Beside the seal: " (condition) } }
            @if let Some(advice) = self.advice { p { (advice) } }
        }
    }

    fn tiles(&self) -> Markup {
        let summary = self.summary;
        let rejected: u64 = summary.rejected.values().sum();
        let last = self.points().last();
        html! {
            div.tiles {
                @if let (Some(area), Some(flow), Some(loss)) = (summary.leak_area_m2, summary.leak_flow_lpm, summary.loss) {
                    div { b { (format!("{flow:.2} L/min")) } span { "leak at " (self.reference_bar()) " bar (median of the last cycles)" } }
                    div { b { (mm2(area)) " mm²" } span { "area of the same leak" } }
                    div { b { (format!("{:.0} W", loss.leak_power_w)) } span { "hydraulic power lost, Δp · Q at " (self.reference_bar()) " bar" } }
                    div { b { (format!("{:.0} kWh a year", loss.leak_energy_kwh_per_year)) }
                        span { @if let Some(cost) = self.energy.cost(loss.leak_energy_kwh_per_year) { (cost) " a year, " } "at " (self.operating_hours_per_year) " hours a year" } }
                }
                @if let Some(last) = last {
                    div { b { (format!("{:.2} L/min", last.leak_flow_lpm)) } span { "last cycle; 90 % interval "
                        (format!("{:.2} … {:.2}", self.flow_lpm(last.interval_m2[0]), self.flow_lpm(last.interval_m2[1]))) } }
                }
                div { b { (summary.cycles) } span { @if self.is_relative() { "cycles compared with the baseline, " (rejected) " others" } @else { "cycles with an estimate, " (rejected) " rejected" } } }
                div { b { (duration_text(summary.duration_s)) } span { (self.record.logs.len()) " log" @if self.record.logs.len() != 1 { "s" }
                    @if let Some(start) = self.record.logs.first().and_then(|log| log.start_ns) { ", from " (time_text(start)) } } }
            }
        }
    }

    fn command(&self, curves: &Curves) -> Markup {
        let below = format!("below {:.2} L/min", self.record.before_below_lpm);
        let name = if curves.is_below { format!("first cycles {below}") } else { "first cycles".to_owned() };
        let all = || curves.before.iter().chain(&curves.now);
        let limit = all().map(|point| point.1.abs()).fold(0.05, f64::max) * 1.05;
        let end = all().map(|point| point.0).fold(0.1, f64::max);
        let difference: Vec<(f64, f64)> = curves
            .now
            .iter()
            .zip(&curves.before)
            .filter(|(now, before)| now.0 == before.0)
            .map(|(now, before)| (now.0, now.1 - before.1))
            .collect();
        let largest = difference.iter().map(|point| point.1.abs()).fold(0.002, f64::max) * 1.05;
        let time = || Axis::linear("time in the cycle, s", 0.0, (end * 10.0).round() / 10.0);
        let both = Chart {
            layers: vec![
                Layer::Line { class: "stroke-a", points: curves.before.clone() },
                Layer::Line { class: "stroke-b", points: curves.now.clone() },
            ],
            key: vec![
                (format!("{name} (mean of {})", curves.cycles.0), "var(--a)", false),
                (format!("now (mean of the last {})", curves.cycles.1), "var(--b)", false),
            ],
            ..Chart::new(
                "Valve command by time in the cycle",
                time(),
                Axis::linear("valve command", -limit, limit),
            )
        };
        let apart = Chart {
            layers: vec![
                Layer::Limit { at: 0.0, name: String::new(), colour: "var(--soft)" },
                Layer::Line { class: "stroke-b", points: difference },
            ],
            ..Chart::new(
                "Difference of the valve command by time in the cycle",
                time(),
                Axis::linear("now minus first cycles", -largest, largest),
            )
        };
        html! {
            h2 { "The command, then and now" }
            p.soft { @if let Some(name) = &self.record.drawn { "Drawn are cycles of the duty cycle " (name) ". " } "The controller makes up for the leak: during the holds the valve stays a little open, and the strokes need more or less of it."
                @if !curves.is_below { " No cycle of this record has an estimate " (below) "; the last cycles are compared with the first ones." } }
            (both.render())
            (apart.render())
        }
    }

    fn flow_lpm(&self, area_m2: f64) -> f64 {
        area_m2 / self.area_m2_per_lpm
    }

    /// Where each log but the first begins.
    fn log_marks(&self) -> Vec<Layer> {
        let logs = self.record.logs.iter().skip(1);
        logs.map(|log| Layer::Mark { at: log.first_cycle as f64, name: short_name(&log.name) }).collect()
    }

    /// What was done to the machine.
    fn repair_marks(&self) -> impl Iterator<Item = Layer> {
        let name = |name: &str| name.replace('_', " ");
        self.summary
            .repairs
            .iter()
            .map(move |done| Layer::Mark { at: done.cycle as f64, name: name(done.repair.what.name()) })
    }

    fn leak_chart(&self) -> Chart {
        let flow = |area_m2| self.flow_lpm(area_m2);
        let at = |point: &Point| point.cycle as f64;
        let highest = self.points().map(|p| flow(p.interval_m2[1])).fold(self.alarm.severe_lpm, f64::max);
        let limit = |name: &str, at, flag| Layer::Limit {
            at,
            name: format!("{name} {at} L/min"),
            colour: colour(flag),
        };
        let band = |p: &Point| (at(p), flow(p.interval_m2[0]), flow(p.interval_m2[1]));
        let mut layers = self.log_marks();
        layers.extend(self.repair_marks());
        layers.extend([
            Layer::Band { class: "fill-band", points: self.points().map(band).collect() },
            limit("watch", self.alarm.watch_lpm, Flag::Watch),
            limit("leak", self.alarm.leak_lpm, Flag::Leak),
            limit("severe", self.alarm.severe_lpm, Flag::Severe),
            Layer::Line {
                class: "stroke-a",
                points: self.points().map(|p| (at(p), p.leak_flow_lpm)).collect(),
            },
        ]);
        let mut key = vec![
            ("estimate".to_owned(), "var(--a)", false),
            ("90 % interval".to_owned(), "var(--band)", true),
        ];
        let absolute = self.points().filter_map(|point| Some((at(point), flow(point.absolute_m2?))));
        if absolute.clone().next().is_some() {
            layers.push(Layer::Line { class: "stroke-b", points: absolute.collect() });
            key[0].0 = "estimate, relative to the baseline".to_owned();
            key.push(("the model alone".to_owned(), "var(--b)", false));
        }
        Chart {
            layers,
            right: Some(("area, mm²".into(), self.area_m2_per_lpm * MM2_PER_M2)),
            key,
            ..Chart::new(
                "Leak by cycle",
                self.cycle_axis("cycle"),
                Axis::logarithmic("leak, L/min", 0.01, highest * 1.3),
            )
        }
    }

    fn baseline_record(&self) -> Markup {
        let rows = || {
            self.baselines.iter().flat_map(|(name, record)| {
                record.iter().enumerate().map(move |(index, one)| (name, one, index + 1 == record.len()))
            })
        };
        html! {
            h2 { "The baselines" }
            p.soft { "Estimates are relative to the healthy machine's own cycles. The newest baseline counts; the older ones are kept as a record." }
            div.scroll { table {
                thead { tr { th { "Learned for" } th { "from" } th { "to" } th.number { "cycles" } th.number { "repeats within, mm²" }
                    th { "estimate of the model alone, mm²" } th { "remarks" } } }
                tbody { @for (name, baseline, newest) in rows() { tr {
                    td { @if !name.is_empty() { (name) ": " } (baseline.occasion) @if newest { " " b { "(in force)" } } }
                    td { (time_text(baseline.from_ns)) } td { (time_text(baseline.to_ns)) }
                    td.number { (baseline.cycles) @if baseline.left_out > 0 { " (" (baseline.left_out) " left out)" } }
                    td.number { (mm2(baseline.residual_deviation_m2)) }
                    td { (mm2(baseline.absolute_leak_area_m2)) " (" (mm2_interval(baseline.absolute_interval90_m2)) ")" }
                    td { (baseline.remarks.join("; ")) }
                } } }
            } }
        }
    }

    fn conditions(&self) -> Markup {
        let range = |[from_ns, to_ns]: [i64; 2]| format!("{} … {}", time_text(from_ns), time_text(to_ns));
        html! {
            h2 { "Beside the seal" }
            p.soft { "What has changed since the baseline beside the seal, as cycles have found it. Leaks are sized beside it." }
            div.scroll { table {
                thead { tr { th { "What" } th { "size" } th { "90 % interval" } th.number { "probability" } th.number { "since cycle" } th { "since about" }
                    th { "between" } th { "came" } th { "matters" } } }
                tbody { @for one in &self.summary.conditions { tr {
                    td { (words_of(one.kind.cause, one.kind.side)) }
                    td { (one.told_size()) }
                    td { (one.told(one.interval90[0])) " … " (one.told(one.interval90[1])) }
                    td.number { (format!("{:.2}", one.probability)) }
                    td.number { @if let Some(cycle) = one.onset_cycle { (cycle) } }
                    td { (time_text(one.onset_ns)) }
                    td { (range(one.onset_range_ns)) }
                    td { @if let Some(words) = growth_sentence(one) { (words) } @else { "at once" } }
                    td { @if one.severity == Severity::Matters { "yes" } @else { "from " (one.told(one.matters_from)) " on" } }
                } } }
            } }
        }
    }

    fn repair_log(&self) -> Markup {
        let told = |verdict: Option<RepairVerdict>| match verdict {
            None => "too few cycles yet",
            Some(RepairVerdict::NotSeen) => "not seen",
            Some(RepairVerdict::BorneOut) => "borne out",
            Some(RepairVerdict::Contradicted) => "contradicted",
        };
        html! {
            h2 { "The repairs" }
            p.soft { "What was done to the machine, as people have noted it, and what the cycles after it say." }
            div.scroll { table {
                thead { tr { th { "What" } th { "when" } th.number { "cycle" } th { "who" } th { "note" } th { "the data" } th { "in words" } } }
                tbody { @for done in &self.summary.repairs { tr {
                    td { (done.repair.what.name().replace('_', " ")) }
                    td { (time_text(done.repair.at_ns)) }
                    td.number { (done.cycle) }
                    td { (done.repair.who.as_deref().unwrap_or_default()) }
                    td { (done.repair.note.as_deref().unwrap_or_default()) }
                    td { (told(done.verdict)) }
                    td { (done.text.as_deref().unwrap_or_default()) }
                } } }
            } }
        }
    }

    fn flags(&self) -> Markup {
        let changes: Vec<(f64, Flag)> =
            self.record.changes.iter().map(|change| (change.cycle as f64, change.to)).collect();
        html! {
            @if self.is_relative() { p.soft { "The flag rises after " (self.alarm.raise_cycles) " cycles in a row in which the sums over cycles find a change, and falls after " (self.alarm.clear_cycles) " without one." } }
            @else { p.soft { "A flag rises after " (self.alarm.raise_cycles) " cycles in a row at or above its threshold, and falls after "
                (self.alarm.clear_cycles) " below " (self.alarm.clear_share * 100.0) " % of it." } }
            @if changes.is_empty() { p { "No flag was set, as there was no cycle to base one on." } }
            @else {
                (flags::chart(self.cycle_axis("cycle"), &changes).render())
                div.scroll { table {
                    thead { tr { th { "Flag" } th { "before" } th.number { "cycle" } th { "time" } th.number { "s from the start" } th { "reason" } } }
                    tbody { @for change in &self.record.changes { tr {
                        td { span.tag style=(format!("background:{}", colour(change.to))) { (change.to.name().replace('_', " ")) } }
                        td { (change.from.name().replace('_', " ")) }
                        td.number { (change.cycle) }
                        td { (time_text(change.t_ns)) }
                        td.number { (format!("{:.1}", change.t_s)) }
                        td { (change.grounds) }
                    } } }
                } }
            }
            @if !self.record.notices.is_empty() {
                h3 { "Notices" }
                div.scroll { table {
                    thead { tr { th.number { "cycle" } th { "time" } th { "what" } } }
                    tbody { @for (cycle, time_ns, text) in &self.record.notices { tr {
                        td.number { (cycle) } td { (time_text(*time_ns)) } td { (text) }
                    } } }
                } }
            }
        }
    }

    fn rejected(&self) -> Markup {
        if self.record.rejected.is_empty() {
            return html! { p { "None." } };
        }
        html! {
            div.scroll { table {
                thead { tr { th { "Reason" } th.number { "cycles" } th { "what it means" } th { "cycle (start, s)" } } }
                tbody { @for (reason, rejected) in &self.record.rejected { tr {
                    td { (reason.replace('_', " ")) }
                    td.number { (rejected.count) }
                    td { (meaning(reason)) }
                    td {
                        (rejected.first.iter().map(|(cycle, start)| format!("{cycle} ({start:.1})")).collect::<Vec<_>>().join(", "))
                        @if rejected.count as usize > rejected.first.len() { " …" }
                    }
                } } }
            } }
        }
    }

    fn feature_chart(&self, index: usize) -> Chart {
        let points: Vec<(f64, f64)> = self
            .points()
            .filter_map(|point| point.features.get(index).map(|value| (point.cycle as f64, *value)))
            .filter(|(_, value)| value.is_finite())
            .collect();
        let low = points.iter().map(|point| point.1).fold(f64::INFINITY, f64::min);
        let high = points.iter().map(|point| point.1).fold(f64::NEG_INFINITY, f64::max);
        let margin = (0.05 * (high - low)).max(1e-6 * high.abs()).max(1e-9);
        Chart {
            size: Size::Small,
            layers: vec![Layer::Line { class: "stroke-a", points }],
            ..Chart::new(
                &self.record.feature_names[index],
                self.cycle_axis("cycle"),
                Axis::linear("", low - margin, high + margin),
            )
        }
    }

    fn logs(&self) -> Markup {
        let summary = self.summary;
        html! {
            div.scroll { table {
                thead { tr { th { "Log" } th { "first sample" } th.number { "duration" } th.number { "samples" } th.number { "first cycle" } } }
                tbody { @for log in &self.record.logs { tr {
                    td { (log.name) @for note in &log.notes { br; span.soft { (note) } } }
                    td { (log.start_ns.map_or("–".into(), time_text)) }
                    td.number { (duration_text(log.duration_s)) }
                    td.number { (log.samples) }
                    td.number { (log.first_cycle) }
                } } }
            } }
            @if !summary.samples_rejected.is_empty() {
                p { "Samples that were left out or filled in: "
                    (summary.samples_rejected.iter().map(|(name, count)| format!("{count} {}", name.replace('_', " "))).collect::<Vec<_>>().join(", ")) "." }
            }
            @if self.record.points.stride() > 1 {
                p.soft { "The charts show every " (self.record.points.stride()) "th cycle." }
            }
        }
    }
}

/// What the last estimate comes from.
fn why_table(why: &Why) -> Markup {
    let (parts, unit, words) = match why {
        Why::Changes(parts) => (
            parts,
            "contribution, mm²",
            "What each phase of the cycle, and the load, contributes to the last cycle's difference from the baseline. What load, oil and supply \
             do to the phases cancels in the sum.",
        ),
        Why::Features(parts) => (
            parts,
            "multiplies the estimate by",
            "How the features of the last cycle move its estimate away from what the model expects of any machine.",
        ),
    };
    let told = |part: f64| match why {
        Why::Changes(_) => mm2(part),
        Why::Features(_) => format!("{:.3}", part.exp()),
    };
    html! {
        h3 { "Where the last estimate comes from" }
        p.soft { (words) @if parts.len() > PARTS_SHOWN { " Shown are the " (PARTS_SHOWN) " largest of " (parts.len()) "." } }
        div.scroll { table {
            thead { tr { th { "Part" } th.number { (unit) } } }
            tbody { @for (name, part) in parts.iter().take(PARTS_SHOWN) { tr {
                td { (name.replace('_', " ")) } td.number { (told(*part)) }
            } } }
        } }
    }
}

fn short_name(name: &str) -> String {
    name.rsplit(['/', '\\']).next().unwrap_or(name).to_owned()
}

fn duration_text(duration_s: f64) -> String {
    match duration_s {
        s if s < 120.0 => format!("{s:.1} s"),
        s if s < 7200.0 => format!("{:.1} min", s / 60.0),
        s if s < 172_800.0 => format!("{:.1} h", s / 3600.0),
        s => format!("{:.1} days", s / 86_400.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_dates_where_the_clock_has_them() {
        assert_eq!(time_text(1_750_000_000_000_000_000), "2025-06-15 15:06:40 UTC");
        assert_eq!(time_text(1_500_000_000), "1.5 s");
        assert_eq!(duration_text(86_400.0), "24.0 h");
    }
}

//! Conditions and counts in the text format that Prometheus reads (OpenMetrics 1.0).

use std::fmt;
use std::sync::atomic::AtomicU64;

use prometheus_client::encoding::text::encode;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::registry::Registry;
use seepd_model::causes::{Cause, Side};
use seepd_monitor::baseline::CusumFinding;
use seepd_monitor::event::Flag;
use seepd_monitor::repair::{FIRST_DATE_NS, RepairVerdict};

use crate::hub::{AxisStatus, SinkStatus};

/// Media type of the text.
pub const MEDIA_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

type Labels = Vec<(&'static str, String)>;
type Gauges = Family<Labels, Gauge<f64, AtomicU64>>;
type Counters = Family<Labels, Counter>;

/// A scrape's text.
///
/// # Errors
/// None that can happen: text is written into memory.
pub fn text(axes: &[AxisStatus], sinks: &[SinkStatus]) -> Result<String, fmt::Error> {
    let mut registry = Registry::with_prefix("seepd");
    register_leak(&mut registry, axes);
    register_flags(&mut registry, axes);
    register_baseline(&mut registry, axes);
    register_conditions(&mut registry, axes);
    register_cycles(&mut registry, axes);
    register_source(&mut registry, axes);
    register_sinks(&mut registry, sinks);
    let mut text = String::new();
    encode(&mut text, &registry)?;
    Ok(text)
}

fn of_axis(axis: &AxisStatus) -> Labels {
    vec![("axis", axis.axis.clone())]
}

fn gauges<'a>(
    registry: &mut Registry,
    name: &str,
    help: &str,
    values: impl Iterator<Item = (&'a AxisStatus, f64)>,
) {
    let family = Gauges::default();
    for (axis, value) in values {
        family.get_or_create(&of_axis(axis)).set(value);
    }
    registry.register(name, help, family);
}

fn counters(registry: &mut Registry, name: &str, help: &str, values: impl Iterator<Item = (Labels, u64)>) {
    let family = Counters::default();
    for (labels, value) in values {
        family.get_or_create(&labels).inc_by(value);
    }
    registry.register(name, help, family);
}

fn register_leak(registry: &mut Registry, axes: &[AxisStatus]) {
    let known = || axes.iter().filter(|axis| axis.flag != Flag::NoEstimate);
    let with = |value: fn(&AxisStatus) -> Option<f64>| {
        known().filter_map(move |axis| value(axis).map(|value| (axis, value)))
    };
    gauges(registry, "leak_area_m2", "Leak area, last estimate", with(|axis| axis.leak_area_m2));
    gauges(
        registry,
        "leak_area_low_m2",
        "Lower end of the 90 % interval",
        with(|axis| axis.interval90_m2.map(|interval| interval[0])),
    );
    gauges(
        registry,
        "leak_area_high_m2",
        "Upper end of the 90 % interval",
        with(|axis| axis.interval90_m2.map(|interval| interval[1])),
    );
    gauges(
        registry,
        "leak_flow_lpm",
        "Leak flow at the reference pressure difference, L/min",
        with(|axis| axis.leak_flow_lpm),
    );
    let powers = with(|axis| axis.loss.map(|loss| loss.leak_power_w));
    gauges(
        registry,
        "leak_power_w",
        "Hydraulic power that the leak turns into heat at the reference pressure difference",
        powers,
    );
}

fn register_baseline(registry: &mut Registry, axes: &[AxisStatus]) {
    const FINDINGS: [CusumFinding; 3] = [CusumFinding::None, CusumFinding::Leak, CusumFinding::Improved];
    let with = |value: fn(&AxisStatus) -> Option<f64>| {
        axes.iter().filter_map(move |axis| value(axis).map(|value| (axis, value)))
    };
    let learned = with(|axis| axis.baseline.learned_cycles.map(|cycles| cycles as f64));
    gauges(registry, "baseline_cycles", "Cycles of the baseline in force", learned);
    let learning = with(|axis| axis.baseline.learning.map(|[so_far, _]| so_far as f64));
    gauges(
        registry,
        "baseline_learning_cycles",
        "Cycles so far of a baseline that is being learned",
        learning,
    );
    let family = Gauges::default();
    let has_finding = |axis: &&AxisStatus| axis.baseline.learned_cycles.is_some() && axis.relative.is_none();
    for axis in axes.iter().filter(has_finding) {
        for finding in FINDINGS {
            let labels = vec![("axis", axis.axis.clone()), ("finding", finding.name().to_owned())];
            family.get_or_create(&labels).set(f64::from(u8::from(axis.finding == finding)));
        }
    }
    registry.register("finding", "1 for the present finding of the CUSUM against the baseline", family);
    let changed = with(|axis| axis.relative.as_ref().map(|relative| f64::from(u8::from(relative.changed))));
    gauges(registry, "changed", "1 where an axis without a model has changed since its baseline", changed);
    gauges(
        registry,
        "time_to_leak_s",
        "Time until the flag leak is expected",
        with(|axis| axis.time_to_leak_s),
    );
    let earliest = with(|axis| axis.time_to_leak_range_s.map(|range| range[0]));
    gauges(registry, "time_to_leak_earliest_s", "Earliest time until the flag leak", earliest);
    let latest = with(|axis| axis.time_to_leak_range_s.map(|range| range[1]));
    gauges(registry, "time_to_leak_latest_s", "Latest time until the flag leak", latest);
}

/// What has changed beside the seal. Causes are those of a fixed list, so that a series does not come and go with what is found.
fn register_conditions(registry: &mut Registry, axes: &[AxisStatus]) {
    let [present, probability, size, onset, rate, matters] = [0; 6].map(|_| Gauges::default());
    let compares = |axis: &&AxisStatus| axis.baseline.learned_cycles.is_some() && axis.relative.is_none();
    for axis in axes.iter().filter(compares) {
        for cause in Cause::ALL.into_iter().filter(|cause| *cause != Cause::PistonSeal) {
            let labels = vec![("axis", axis.axis.clone()), ("cause", cause.name().to_owned())];
            let is_found = axis.conditions.iter().any(|one| one.kind.cause == cause);
            present.get_or_create(&labels).set(f64::from(u8::from(is_found)));
        }
    }
    for axis in axes {
        for one in &axis.conditions {
            let side = one.kind.side.map_or("", Side::name);
            let labels = || {
                let (cause, unit) = (one.kind.cause.name(), one.kind.unit.name());
                vec![
                    ("axis", axis.axis.clone()),
                    ("cause", cause.to_owned()),
                    ("side", side.to_owned()),
                    ("unit", unit.to_owned()),
                ]
            };
            let set = |family: &Gauges, value: f64| {
                family.get_or_create(&labels()).set(value);
            };
            set(&probability, one.probability);
            set(&size, one.size);
            // Times of a clock that was never set are no dates.
            if one.onset_ns >= FIRST_DATE_NS {
                set(&onset, one.onset_ns as f64 / 1e9);
            }
            one.rate_per_day.into_iter().for_each(|per_day| set(&rate, per_day));
            one.time_to_matter.into_iter().for_each(|time| set(&matters, time.expected_s));
        }
    }
    registry.register("condition", "1 for a cause beside the seal that cycles have found", present);
    registry.register("condition_probability", "Probability of a cause that was found", probability);
    registry.register("condition_size", "Size of a cause that was found, in the unit of its label", size);
    registry.register("condition_onset_s", "About when it began, s since 1970", onset);
    registry.register("condition_rate_per_day", "How a cause that grows changes, units a day", rate);
    registry.register("condition_time_to_matter_s", "Time until it is expected to matter", matters);
    let is_contradicted = |axis: &AxisStatus| {
        let last = axis.repairs.last().and_then(|done| done.verdict);
        f64::from(u8::from(last == Some(RepairVerdict::Contradicted)))
    };
    let contradicted = axes.iter().filter(|axis| !axis.repairs.is_empty());
    let contradicted = contradicted.map(|axis| (axis, is_contradicted(axis)));
    gauges(registry, "repair_contradicted", "1 where the cycles contradict the last repair", contradicted);
}

fn register_flags(registry: &mut Registry, axes: &[AxisStatus]) {
    const FLAGS: [Flag; 5] = [Flag::NoEstimate, Flag::Healthy, Flag::Watch, Flag::Leak, Flag::Severe];
    let family = Gauges::default();
    let latched = Gauges::default();
    for axis in axes {
        for flag in FLAGS {
            let labels = vec![("axis", axis.axis.clone()), ("flag", flag.name().to_owned())];
            family.get_or_create(&labels).set(f64::from(u8::from(axis.flag == flag)));
            if flag >= Flag::Watch {
                let on = axis.latched == Some(flag) && !axis.acknowledged;
                latched.get_or_create(&labels).set(f64::from(u8::from(on)));
            }
        }
    }
    registry.register("flag", "1 for the present flag", family);
    registry.register("latched_unacknowledged", "1 for a latched flag that nobody has acknowledged", latched);
    let stale = axes.iter().map(|axis| (axis, f64::from(u8::from(axis.stale))));
    gauges(registry, "input_stale", "1 where no command arrives", stale);
}

fn register_cycles(registry: &mut Registry, axes: &[AxisStatus]) {
    let delays = axes.iter().filter_map(|axis| axis.publication_delay_s.map(|delay| (axis, delay)));
    gauges(
        registry,
        "publication_delay_s",
        "From the sample that closed the last cycle to its publication",
        delays,
    );
    let periods = axes.iter().filter_map(|axis| axis.observed_period_s.map(|period_s| (axis, period_s)));
    gauges(
        registry,
        "observed_period_s",
        "Period at which the command repeats, where there is no estimate",
        periods,
    );
    let cycles = axes.iter().map(|axis| (of_axis(axis), axis.cycles));
    counters(registry, "cycles", "Cycles with an estimate", cycles);
    let by_reason = |what: fn(&AxisStatus) -> &std::collections::BTreeMap<&'static str, u64>| {
        axes.iter().flat_map(move |axis| {
            what(axis).iter().map(|(reason, count)| {
                (vec![("axis", axis.axis.clone()), ("reason", (*reason).to_owned())], *count)
            })
        })
    };
    counters(registry, "cycles_rejected", "Cycles without an estimate", by_reason(|axis| &axis.rejected));
    counters(
        registry,
        "samples_rejected",
        "Samples left out or filled in",
        by_reason(|axis| &axis.samples_rejected),
    );
}

fn register_source(registry: &mut Registry, axes: &[AxisStatus]) {
    let mut of = |name: &str, help: &str, value: fn(&AxisStatus) -> u64| {
        counters(registry, name, help, axes.iter().map(|axis| (of_axis(axis), value(axis))));
    };
    of("frames", "Frames received", |axis| axis.source.frames);
    of("samples", "Samples received", |axis| axis.source.samples);
    of("frames_dropped_in_socket", "Frames that the kernel dropped", |axis| axis.source.dropped_in_socket);
    of("frames_missing", "Frames lost, by their counter", |axis| axis.source.missing_by_counter);
    of("frames_repeated", "Frames sent twice, by their counter", |axis| axis.source.repeated);
    of("frames_malformed", "Frames of a wrong size", |axis| axis.source.malformed + axis.source.too_short);
    of("frames_error", "Error frames", |axis| axis.source.error);
    of("source_reopened", "Times that the input was opened again", |axis| axis.source.reopened);
}

fn register_sinks(registry: &mut Registry, sinks: &[SinkStatus]) {
    let family = Gauges::default();
    let waiting = Gauges::default();
    let labels = |sink: &SinkStatus| vec![("sink", sink.name.clone())];
    for sink in sinks {
        family.get_or_create(&labels(sink)).set(f64::from(u8::from(sink.good)));
        waiting.get_or_create(&labels(sink)).set(sink.waiting as f64);
    }
    registry.register("sink_good", "1 where the sink works", family);
    registry.register("sink_waiting", "Events that are waiting", waiting);
    let sent = sinks.iter().map(|sink| (labels(sink), sink.sent));
    counters(registry, "sink_sent", "Events, samples or frames that went out", sent);
    let dropped = sinks.iter().map(|sink| (labels(sink), sink.dropped));
    counters(registry, "sink_dropped", "Events, samples or frames that were given up", dropped);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hub::RelativeStatus;
    use seepd_monitor::energy::Loss;

    #[test]
    fn an_axis_without_an_estimate_has_a_flag_and_no_leak() {
        let mut status = AxisStatus::new("press \"1\"", 7e6);
        status.leak_area_m2 = Some(1e-7);
        let text_without = text(std::slice::from_ref(&status), &[]).unwrap();
        assert!(
            text_without.contains("seepd_flag{axis=\"press \\\"1\\\"\",flag=\"no_estimate\"} 1"),
            "{text_without}"
        );
        assert!(!text_without.contains("seepd_leak_area_m2{"), "{text_without}");
        assert!(text_without.ends_with("# EOF\n"));
        status.flag = Flag::Healthy;
        let text_with = text(&[status], &[SinkStatus::new("mqtt")]).unwrap();
        assert!(text_with.contains("seepd_leak_area_m2{axis=\"press \\\"1\\\"\"} 1e-7"), "{text_with}");
        assert!(text_with.contains("seepd_sink_good{sink=\"mqtt\"} 1"));
    }

    #[test]
    fn without_an_estimate_the_period_and_without_a_model_the_change_are_told() {
        let mut status = AxisStatus::new("press", 7e6);
        status.observed_period_s = Some(7.02);
        status.baseline.learned_cycles = Some(50);
        status.relative = Some(RelativeStatus { changed: true, since_ns: Some(1), features: Vec::new() });
        let text = text(&[status], &[]).unwrap();
        assert!(text.contains("seepd_observed_period_s{axis=\"press\"} 7.02"), "{text}");
        assert!(
            text.contains("seepd_changed{axis=\"press\"} 1") && !text.contains("seepd_finding{"),
            "{text}"
        );
    }

    /// Everything that can be told of an axis is.
    fn status_in_full() -> AxisStatus {
        let mut status = AxisStatus::new("press", 7e6);
        status.flag = Flag::Watch;
        (status.leak_area_m2, status.leak_flow_lpm) = (Some(1e-7), Some(0.5));
        status.interval90_m2 = Some([9e-8, 1.1e-7]);
        status.loss = Some(Loss::of(0.5, 7e6, 8760.0));
        (status.time_to_leak_s, status.time_to_leak_range_s) = (Some(1.0), Some([0.5, 2.0]));
        status.baseline.learned_cycles = Some(50);
        status.conditions = vec![crate::hub::condition_for_tests()];
        status.rejected.insert("gap", 1);
        status
    }

    #[test]
    fn dashboard_and_alerts_ask_for_series_that_there_are() {
        let text = text(&[status_in_full()], &[SinkStatus::new("mqtt")]).unwrap();
        let board = include_str!("../../../../packaging/grafana/seepd.dashboard.json");
        let rules = include_str!("../../../../packaging/prometheus/seepd.rules.yml");
        let mut asked = std::collections::BTreeSet::new();
        for file in [board, rules] {
            for rest in file.split("seepd_").skip(1) {
                let end = rest.find(|c: char| !(c.is_ascii_alphanumeric() || c == '_')).unwrap_or(rest.len());
                asked.insert(format!("seepd_{}", &rest[..end]));
            }
        }
        assert!(asked.len() > 10, "{asked:?}");
        for name in &asked {
            assert!(text.contains(&format!("\n{name}{{")), "{name} is asked for, and is not there:\n{text}");
        }
        let alerts = rules.lines().filter(|line| line.trim_start().starts_with("- alert: Seepd")).count();
        let expressions = rules.lines().filter(|line| line.trim_start().starts_with("expr: ")).count();
        assert_eq!((alerts, expressions), (7, 7));
    }

    /// What Grafana's import needs: panels that have a number of their own, lie beside each other, and ask a source that is chosen.
    #[test]
    fn panels_of_the_dashboard_lie_beside_each_other() {
        let board = include_str!("../../../../packaging/grafana/seepd.dashboard.json");
        let board: serde_json::Value = serde_json::from_str(board).unwrap();
        assert!(board["schemaVersion"].as_u64() >= Some(36) && board["uid"].is_string());
        let panels = board["panels"].as_array().unwrap();
        let place = |panel: &serde_json::Value| {
            ["x", "y", "w", "h"].map(|key| panel["gridPos"][key].as_u64().unwrap())
        };
        for (index, panel) in panels.iter().enumerate() {
            assert_eq!(panel["id"].as_u64(), Some(index as u64 + 1));
            assert_eq!(panel["datasource"]["uid"], "${datasource}");
            assert!(!panel["targets"].as_array().unwrap().is_empty());
            let [x, y, w, h] = place(panel);
            assert!(x + w <= 24, "{}", panel["title"]);
            for other in &panels[index + 1..] {
                let [a, b, c, d] = place(other);
                let apart = x + w <= a || a + c <= x || y + h <= b || b + d <= y;
                assert!(apart, "{} lies on {}", panel["title"], other["title"]);
            }
        }
    }

    #[test]
    fn conditions_are_told_by_causes_of_a_fixed_list() {
        let mut status = AxisStatus::new("press", 7e6);
        assert!(!text(std::slice::from_ref(&status), &[]).unwrap().contains("seepd_condition{"));
        status.baseline.learned_cycles = Some(50);
        let none = text(std::slice::from_ref(&status), &[]).unwrap();
        assert_eq!(none.matches("seepd_condition{").count(), Cause::ALL.len() - 1, "{none}");
        assert!(!none.contains("seepd_condition_size{"), "{none}");
        status.conditions = vec![crate::hub::condition_for_tests()];
        let with = text(&[status], &[]).unwrap();
        for line in [
            "seepd_condition{axis=\"press\",cause=\"external_leak\"} 1",
            "seepd_condition{axis=\"press\",cause=\"valve_null\"} 0",
            "seepd_condition_size{axis=\"press\",cause=\"external_leak\",side=\"rod\",unit=\"m3/(s Pa)\"} 1e-12",
            "seepd_condition_onset_s{axis=\"press\",cause=\"external_leak\",side=\"rod\",unit=\"m3/(s Pa)\"} 1750000000",
            "seepd_condition_rate_per_day{axis=\"press\",cause=\"external_leak\",side=\"rod\",unit=\"m3/(s Pa)\"} 2e-13",
            "seepd_condition_time_to_matter_s{axis=\"press\",cause=\"external_leak\",side=\"rod\",unit=\"m3/(s Pa)\"} 3600",
        ] {
            assert!(with.contains(line), "{line}\n{with}");
        }
    }

    #[test]
    fn a_baseline_is_told_with_its_finding_and_date() {
        let mut status = AxisStatus::new("press", 7e6);
        let without = text(std::slice::from_ref(&status), &[]).unwrap();
        assert!(
            !without.contains("seepd_finding{") && !without.contains("seepd_baseline_cycles{"),
            "{without}"
        );
        status.baseline.learned_cycles = Some(50);
        status.finding = CusumFinding::Leak;
        (status.time_to_leak_s, status.time_to_leak_range_s) = (Some(3600.0), Some([1800.0, 7200.0]));
        let with = text(&[status], &[]).unwrap();
        for line in [
            "seepd_baseline_cycles{axis=\"press\"} 50",
            "seepd_finding{axis=\"press\",finding=\"leak\"} 1",
            "seepd_finding{axis=\"press\",finding=\"none\"} 0",
            "seepd_time_to_leak_s{axis=\"press\"} 3600",
            "seepd_time_to_leak_earliest_s{axis=\"press\"} 1800",
        ] {
            assert!(with.contains(line), "{line}\n{with}");
        }
    }
}

//! Conditions and counts in the text format that Prometheus reads (OpenMetrics 1.0).

use std::fmt;
use std::sync::atomic::AtomicU64;

use prometheus_client::encoding::text::encode;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::registry::Registry;

use super::series::{Labels, Points, Series, series};
use crate::hub::{AxisStatus, SinkStatus};

/// Media type of the text.
pub const MEDIA_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

type Gauges = Family<Labels, Gauge<f64, AtomicU64>>;
type Counters = Family<Labels, Counter>;

/// A scrape's text.
///
/// # Errors
/// None that can happen: text is written into memory.
pub fn text(axes: &[AxisStatus], sinks: &[SinkStatus]) -> Result<String, fmt::Error> {
    let mut registry = Registry::with_prefix("seepd");
    series(axes, sinks).into_iter().for_each(|one| register(&mut registry, one));
    let mut text = String::new();
    encode(&mut text, &registry)?;
    Ok(text)
}

fn register(registry: &mut Registry, series: Series) {
    let Series { name, help, points } = series;
    match points {
        Points::Gauges(points) => {
            let family = Gauges::default();
            for (labels, value) in points {
                family.get_or_create(&labels).set(value);
            }
            registry.register(name, help, family);
        }
        Points::Counters(points) => {
            let family = Counters::default();
            for (labels, value) in points {
                family.get_or_create(&labels).inc_by(value);
            }
            registry.register(name, help, family);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hub::RelativeStatus;
    use seepd_model::causes::Cause;
    use seepd_monitor::baseline::CusumFinding;
    use seepd_monitor::energy::Loss;
    use seepd_monitor::event::Flag;

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

//! What is measured of axes and sinks, as named series: metrics that are fetched and metrics that are sent have the same ones.
//!
//! A name ends in its unit; one that does not is a number, a share or a yes and no.

use seepd_model::causes::{Cause, Side};
use seepd_monitor::baseline::CusumFinding;
use seepd_monitor::event::Flag;
use seepd_monitor::repair::{FIRST_DATE_NS, RepairVerdict};

use crate::hub::{AxisStatus, SinkStatus};

/// Names and texts that tell a series' points apart.
pub(super) type Labels = Vec<(&'static str, String)>;

/// Values of a series.
pub(super) enum Points {
    /// What is so now.
    Gauges(Vec<(Labels, f64)>),
    /// What has been counted since the start.
    Counters(Vec<(Labels, u64)>),
}

/// A series.
pub(super) struct Series {
    /// Without the prefix `seepd_`.
    pub(super) name: &'static str,
    pub(super) help: &'static str,
    pub(super) points: Points,
}

impl Series {
    fn gauges(name: &'static str, help: &'static str, points: Vec<(Labels, f64)>) -> Self {
        Series { name, help, points: Points::Gauges(points) }
    }
}

/// All series, those without a point too.
pub(super) fn series(axes: &[AxisStatus], sinks: &[SinkStatus]) -> Vec<Series> {
    let mut all = Vec::new();
    register_leak(&mut all, axes);
    register_flags(&mut all, axes);
    register_baseline(&mut all, axes);
    register_conditions(&mut all, axes);
    register_cycles(&mut all, axes);
    register_source(&mut all, axes);
    register_sinks(&mut all, sinks);
    all
}

fn of_axis(axis: &AxisStatus) -> Labels {
    vec![("axis", axis.axis.clone())]
}

fn gauges<'a>(
    into: &mut Vec<Series>,
    name: &'static str,
    help: &'static str,
    values: impl Iterator<Item = (&'a AxisStatus, f64)>,
) {
    into.push(Series::gauges(name, help, values.map(|(axis, value)| (of_axis(axis), value)).collect()));
}

fn counters(
    into: &mut Vec<Series>,
    name: &'static str,
    help: &'static str,
    values: impl Iterator<Item = (Labels, u64)>,
) {
    into.push(Series { name, help, points: Points::Counters(values.collect()) });
}

fn register_leak(into: &mut Vec<Series>, axes: &[AxisStatus]) {
    let known = || axes.iter().filter(|axis| axis.flag != Flag::NoEstimate);
    let with = |value: fn(&AxisStatus) -> Option<f64>| {
        known().filter_map(move |axis| value(axis).map(|value| (axis, value)))
    };
    gauges(into, "leak_area_m2", "Leak area, last estimate", with(|axis| axis.leak_area_m2));
    gauges(
        into,
        "leak_area_low_m2",
        "Lower end of the 90 % interval",
        with(|axis| axis.interval90_m2.map(|interval| interval[0])),
    );
    gauges(
        into,
        "leak_area_high_m2",
        "Upper end of the 90 % interval",
        with(|axis| axis.interval90_m2.map(|interval| interval[1])),
    );
    gauges(
        into,
        "leak_flow_lpm",
        "Leak flow at the reference pressure difference, L/min",
        with(|axis| axis.leak_flow_lpm),
    );
    let powers = with(|axis| axis.loss.map(|loss| loss.leak_power_w));
    gauges(
        into,
        "leak_power_w",
        "Hydraulic power that the leak turns into heat at the reference pressure difference",
        powers,
    );
}

fn register_baseline(into: &mut Vec<Series>, axes: &[AxisStatus]) {
    const FINDINGS: [CusumFinding; 3] = [CusumFinding::None, CusumFinding::Leak, CusumFinding::Improved];
    let with = |value: fn(&AxisStatus) -> Option<f64>| {
        axes.iter().filter_map(move |axis| value(axis).map(|value| (axis, value)))
    };
    let learned = with(|axis| axis.baseline.learned_cycles.map(|cycles| cycles as f64));
    gauges(into, "baseline_cycles", "Cycles of the baseline in force", learned);
    let learning = with(|axis| axis.baseline.learning.map(|[so_far, _]| so_far as f64));
    gauges(into, "baseline_learning_cycles", "Cycles so far of a baseline that is being learned", learning);
    let mut family = Vec::new();
    let has_finding = |axis: &&AxisStatus| axis.baseline.learned_cycles.is_some() && axis.relative.is_none();
    for axis in axes.iter().filter(has_finding) {
        for finding in FINDINGS {
            let labels = vec![("axis", axis.axis.clone()), ("finding", finding.name().to_owned())];
            family.push((labels, f64::from(u8::from(axis.finding == finding))));
        }
    }
    into.push(Series::gauges(
        "finding",
        "1 for the present finding of the CUSUM against the baseline",
        family,
    ));
    let changed = with(|axis| axis.relative.as_ref().map(|relative| f64::from(u8::from(relative.changed))));
    gauges(into, "changed", "1 where an axis without a model has changed since its baseline", changed);
    gauges(into, "time_to_leak_s", "Time until the flag leak is expected", with(|axis| axis.time_to_leak_s));
    let earliest = with(|axis| axis.time_to_leak_range_s.map(|range| range[0]));
    gauges(into, "time_to_leak_earliest_s", "Earliest time until the flag leak", earliest);
    let latest = with(|axis| axis.time_to_leak_range_s.map(|range| range[1]));
    gauges(into, "time_to_leak_latest_s", "Latest time until the flag leak", latest);
}

/// What has changed beside the seal. Causes are those of a fixed list, so that a series does not come and go with what is found.
fn register_conditions(into: &mut Vec<Series>, axes: &[AxisStatus]) {
    let mut present = Vec::new();
    let [mut probability, mut size, mut onset, mut rate, mut matters] = [const { Vec::new() }; 5];
    let compares = |axis: &&AxisStatus| axis.baseline.learned_cycles.is_some() && axis.relative.is_none();
    for axis in axes.iter().filter(compares) {
        for cause in Cause::ALL.into_iter().filter(|cause| *cause != Cause::PistonSeal) {
            let labels = vec![("axis", axis.axis.clone()), ("cause", cause.name().to_owned())];
            let is_found = axis.conditions.iter().any(|one| one.kind.cause == cause);
            present.push((labels, f64::from(u8::from(is_found))));
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
            let set = |points: &mut Vec<(Labels, f64)>, value: f64| points.push((labels(), value));
            set(&mut probability, one.probability);
            set(&mut size, one.size);
            // Times of a clock that was never set are no dates.
            if one.onset_ns >= FIRST_DATE_NS {
                set(&mut onset, one.onset_ns as f64 / 1e9);
            }
            one.rate_per_day.into_iter().for_each(|per_day| set(&mut rate, per_day));
            one.time_to_matter.into_iter().for_each(|time| set(&mut matters, time.expected_s));
        }
    }
    into.push(Series::gauges("condition", "1 for a cause beside the seal that cycles have found", present));
    into.push(Series::gauges("condition_probability", "Probability of a cause that was found", probability));
    into.push(Series::gauges(
        "condition_size",
        "Size of a cause that was found, in the unit of its label",
        size,
    ));
    into.push(Series::gauges("condition_onset_s", "About when it began, s since 1970", onset));
    into.push(Series::gauges("condition_rate_per_day", "How a cause that grows changes, units a day", rate));
    into.push(Series::gauges("condition_time_to_matter_s", "Time until it is expected to matter", matters));
    let is_contradicted = |axis: &AxisStatus| {
        let last = axis.repairs.last().and_then(|done| done.verdict);
        f64::from(u8::from(last == Some(RepairVerdict::Contradicted)))
    };
    let contradicted = axes.iter().filter(|axis| !axis.repairs.is_empty());
    let contradicted = contradicted.map(|axis| (axis, is_contradicted(axis)));
    gauges(into, "repair_contradicted", "1 where the cycles contradict the last repair", contradicted);
}

fn register_flags(into: &mut Vec<Series>, axes: &[AxisStatus]) {
    const FLAGS: [Flag; 5] = [Flag::NoEstimate, Flag::Healthy, Flag::Watch, Flag::Leak, Flag::Severe];
    let mut family = Vec::new();
    let mut latched = Vec::new();
    for axis in axes {
        for flag in FLAGS {
            let labels = vec![("axis", axis.axis.clone()), ("flag", flag.name().to_owned())];
            family.push((labels.clone(), f64::from(u8::from(axis.flag == flag))));
            if flag >= Flag::Watch {
                let on = axis.latched == Some(flag) && !axis.acknowledged;
                latched.push((labels, f64::from(u8::from(on))));
            }
        }
    }
    into.push(Series::gauges("flag", "1 for the present flag", family));
    into.push(Series::gauges(
        "latched_unacknowledged",
        "1 for a latched flag that nobody has acknowledged",
        latched,
    ));
    let stale = axes.iter().map(|axis| (axis, f64::from(u8::from(axis.stale))));
    gauges(into, "input_stale", "1 where no command arrives", stale);
}

fn register_cycles(into: &mut Vec<Series>, axes: &[AxisStatus]) {
    let delays = axes.iter().filter_map(|axis| axis.publication_delay_s.map(|delay| (axis, delay)));
    gauges(
        into,
        "publication_delay_s",
        "From the sample that closed the last cycle to its publication",
        delays,
    );
    let periods = axes.iter().filter_map(|axis| axis.observed_period_s.map(|period_s| (axis, period_s)));
    gauges(
        into,
        "observed_period_s",
        "Period at which the command repeats, where there is no estimate",
        periods,
    );
    let cycles = axes.iter().map(|axis| (of_axis(axis), axis.cycles));
    counters(into, "cycles", "Cycles with an estimate", cycles);
    let by_reason = |what: fn(&AxisStatus) -> &std::collections::BTreeMap<&'static str, u64>| {
        axes.iter().flat_map(move |axis| {
            what(axis).iter().map(|(reason, count)| {
                (vec![("axis", axis.axis.clone()), ("reason", (*reason).to_owned())], *count)
            })
        })
    };
    counters(into, "cycles_rejected", "Cycles without an estimate", by_reason(|axis| &axis.rejected));
    counters(
        into,
        "samples_rejected",
        "Samples left out or filled in",
        by_reason(|axis| &axis.samples_rejected),
    );
}

fn register_source(into: &mut Vec<Series>, axes: &[AxisStatus]) {
    let mut of = |name: &'static str, help: &'static str, value: fn(&AxisStatus) -> u64| {
        counters(into, name, help, axes.iter().map(|axis| (of_axis(axis), value(axis))));
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

fn register_sinks(into: &mut Vec<Series>, sinks: &[SinkStatus]) {
    let mut family = Vec::new();
    let mut waiting = Vec::new();
    let labels = |sink: &SinkStatus| vec![("sink", sink.name.clone())];
    for sink in sinks {
        family.push((labels(sink), f64::from(u8::from(sink.good))));
        waiting.push((labels(sink), sink.waiting as f64));
    }
    into.push(Series::gauges("sink_good", "1 where the sink works", family));
    into.push(Series::gauges("sink_waiting", "Events that are waiting", waiting));
    let sent = sinks.iter().map(|sink| (labels(sink), sink.sent));
    counters(into, "sink_sent", "Events, samples or frames that went out", sent);
    let dropped = sinks.iter().map(|sink| (labels(sink), sink.dropped));
    counters(into, "sink_dropped", "Events, samples or frames that were given up", dropped);
}

//! Replays: logs or arrays in, a table of cycles out.

use arrow_array::RecordBatch;
use numpy::PyReadonlyArray1;
use pyo3::prelude::*;
use seepd::Failure;
use seepd::commands::replay::{Audience, Replay, ReplayArguments, Replayed};
use seepd::failure::Code;
use seepd::sink::json;
use seepd_monitor::event::Event;
use seepd_signals::{Sample, Signal};
use serde_arrow::ArrayBuilder;
use serde_arrow::schema::{SchemaLike, SerdeArrowSchema};

use crate::error::{internal, released};
use crate::table::Batch;

/// The columns of a cycle, `seepd.cycle/1`: those of every kind of axis, absent ones null.
fn schema() -> Result<SerdeArrowSchema, Failure> {
    let number = |name: &str| serde_json::json!({"name": name, "data_type": "F64", "nullable": true});
    let text = |name: &str| serde_json::json!({"name": name, "data_type": "Utf8", "nullable": true});
    let integer = |name: &str| serde_json::json!({"name": name, "data_type": "I64", "nullable": true});
    let nested = |name: &str, data_type: &str, children: Vec<serde_json::Value>| serde_json::json!({"name": name, "data_type": data_type, "nullable": true, "children": children});
    let list = |name: &str, element: serde_json::Value| nested(name, "List", vec![element]);
    let structure = |name: &str, children: Vec<serde_json::Value>| nested(name, "Struct", children);
    let interval = |name: &str| list(name, number("element"));
    let values = |name: &str| {
        let key = serde_json::json!({"name": "key", "data_type": "Utf8"});
        let entries =
            serde_json::json!({"name": "entries", "data_type": "Struct", "children": [key, number("value")]});
        nested(name, "Map", vec![entries])
    };
    let mut fields = Vec::new();
    fields.extend(["schema", "axis"].map(text));
    fields.push(integer("cycle"));
    fields.push(text("duty_cycle"));
    fields.extend(["t_start_s", "t_end_s"].map(number));
    fields.push(integer("t_start_ns"));
    fields.push(number("leak_area_m2"));
    fields.push(interval("interval90_m2"));
    fields.extend(["leak_flow_lpm", "reference_dp_pa"].map(number));
    fields.extend(["flag", "reason"].map(text));
    fields.push(number("absolute_leak_area_m2"));
    fields.push(interval("absolute_interval90_m2"));
    fields.push(number("absolute_novelty"));
    fields.push(values("absolute_why"));
    fields.extend(["response_m2", "novelty"].map(number));
    fields.push(text("load"));
    fields.push(number("load_change"));
    fields.push(text("finding"));
    fields.push(number("drift_sum"));
    let time_to = |name: &str| structure(name, ["expected_s", "earliest_s", "latest_s"].map(number).to_vec());
    fields.extend(["time_to_leak", "time_to_severe"].map(time_to));
    fields.push(values("why"));
    fields.push(text("cause"));
    fields.push(number("cause_probability"));
    fields.push(text("cause_also"));
    let candidate = structure(
        "element",
        vec![
            text("cause"),
            text("side"),
            number("probability"),
            number("size"),
            text("unit"),
            interval("interval90"),
        ],
    );
    fields.push(list("cause_candidates", candidate));
    fields.push(list("distinguish", text("element")));
    fields.push(integer("onset_cycle"));
    let condition = vec![
        text("cause"),
        text("side"),
        number("probability"),
        number("size"),
        text("unit"),
        interval("interval90"),
        number("sum"),
        integer("onset_cycle"),
        list("onset_cycles", integer("element")),
        integer("onset_ns"),
        list("onset_range_ns", integer("element")),
        text("manner"),
        number("rate_per_day"),
        interval("rate90_per_day"),
        text("severity"),
        number("matters_from"),
        time_to("time_to_matter"),
    ];
    fields.push(list("conditions", structure("element", condition)));
    fields.push(number("distance"));
    fields.push(serde_json::json!({"name": "changed", "data_type": "Bool", "nullable": true}));
    fields.extend(["largest_sum", "changed_since_s"].map(number));
    fields.push(values("standardised"));
    fields.push(values("features"));
    SerdeArrowSchema::from_value(&fields).map_err(internal)
}

/// What a replay says, as a table and lines.
struct Cycles {
    builder: ArrayBuilder,
    /// Changes of flag and notices, as JSON lines.
    events: Vec<String>,
}

impl Cycles {
    fn new() -> Result<Self, Failure> {
        Ok(Cycles { builder: ArrayBuilder::new(schema()?).map_err(internal)?, events: Vec::new() })
    }
}

impl Audience for Cycles {
    fn take_event(&mut self, event: &Event<'_>) -> Result<(), Failure> {
        match event {
            Event::Cycle(line) => self.builder.push(line).map_err(internal),
            Event::Flag(_) | Event::Notice(_) => {
                let mut line = Vec::new();
                json::write_event(&mut line, event).map_err(internal)?;
                self.events.push(String::from_utf8_lossy(&line).into_owned());
                Ok(())
            }
        }
    }
}

/// What a replay comes to: cycles, summary, events, notes.
type Replayable = (RecordBatch, String, Vec<String>, Vec<String>);
/// The same for Python.
type ForPython = (Batch, String, Vec<String>, Vec<String>);

fn finished(
    replay: &Replay,
    mut cycles: Cycles,
    log: Option<&std::path::PathBuf>,
    notes: Vec<String>,
) -> Result<Replayable, Failure> {
    let Replayed { summary, advice } = replay.summed_up(log);
    replay.check_rate(&summary)?;
    let mut line = Vec::new();
    json::write_summary(&mut line, &summary, advice.as_deref()).map_err(internal)?;
    let batch = cycles.builder.to_record_batch().map_err(internal)?;
    Ok((batch, String::from_utf8_lossy(&line).into_owned(), cycles.events, notes))
}

/// Replays logs that are one machine's record.
#[pyfunction]
pub(crate) fn replay(py: Python<'_>, words: Vec<String>) -> PyResult<ForPython> {
    let ((batch, summary, events, mut notes), warnings) = released(py, || {
        let arguments: ReplayArguments = seepd::cli::parse(words)?;
        let (mut replay, mut cycles) = (Replay::begin(&arguments)?, Cycles::new()?);
        let notes = replay.read_logs(arguments.logs(), |_| (), &mut cycles)?;
        finished(&replay, cycles, arguments.logs().first(), notes)
    })?;
    notes.extend(warnings);
    Ok((Batch(batch), summary, events, notes))
}

/// When samples were taken.
enum Times<'a> {
    /// Of each one, ns.
    Given(&'a [i64]),
    /// So many a second, from 0.
    Even(f64),
}

impl Times<'_> {
    fn of(&self, index: usize) -> i64 {
        match self {
            Times::Given(times) => times[index],
            Times::Even(rate_hz) => (index as f64 * 1e9 / rate_hz).round() as i64,
        }
    }
}

/// Replays arrays that are one machine's record; without times or a rate, at the model's.
#[pyfunction]
#[pyo3(signature = (words, signals, time_ns=None, sample_rate_hz=None))]
pub(crate) fn replay_arrays(
    py: Python<'_>,
    words: Vec<String>,
    signals: Vec<(String, PyReadonlyArray1<'_, f64>)>,
    time_ns: Option<PyReadonlyArray1<'_, i64>>,
    sample_rate_hz: Option<f64>,
) -> PyResult<ForPython> {
    let columns = signals.iter().map(|(name, values)| Ok((name.as_str(), values.as_slice()?)));
    let columns: Vec<(&str, &[f64])> = columns.collect::<PyResult<_>>()?;
    let times = time_ns.as_ref().map(PyReadonlyArray1::as_slice).transpose()?;
    let ((batch, summary, events, mut notes), warnings) = released(py, move || {
        let arguments: ReplayArguments = seepd::cli::parse(words)?;
        let columns = named(&columns)?;
        let samples = columns.first().map_or(0, |(_, values)| values.len());
        let mut replay = Replay::begin(&arguments)?;
        let model_hz =
            replay.pipeline().monitors().first().map(|monitor| monitor.model().file().sample_rate_hz);
        let times = match (times, sample_rate_hz.or(model_hz)) {
            (Some(times), _) if times.len() == samples => Times::Given(times),
            (Some(times), _) => {
                let text = format!("time has {} values, the signals {samples}", times.len());
                return Err(Failure::new(Code::Usage, text));
            }
            (None, Some(rate_hz)) if rate_hz.is_finite() && rate_hz > 0.0 => Times::Even(rate_hz),
            (None, Some(rate_hz)) => {
                let text = format!("sample_rate_hz is {rate_hz}; it must be above 0");
                return Err(Failure::new(Code::Usage, text));
            }
            (None, None) => {
                let text = "an axis without a model has no rate of its own: give time_ns or sample_rate_hz";
                return Err(Failure::new(Code::Usage, text));
            }
        };
        let mut cycles = Cycles::new()?;
        for index in 0..samples {
            let mut sample = Sample::new(times.of(index));
            for (signal, values) in &columns {
                sample.set(*signal, values[index]);
            }
            replay.take(&sample, &mut cycles)?;
        }
        replay.end(&mut cycles)?;
        finished(&replay, cycles, None, Vec::new())
    })?;
    notes.extend(warnings);
    Ok((Batch(batch), summary, events, notes))
}

/// The arrays' signals, all of one length and with the command among them.
fn named<'a>(columns: &[(&str, &'a [f64])]) -> Result<Vec<(Signal, &'a [f64])>, Failure> {
    let usage = |text: String| Failure::new(Code::Usage, text);
    let mut named = Vec::new();
    for (name, values) in columns {
        let signal = Signal::from_name(name).ok_or_else(|| {
            let known = Signal::ALL.map(Signal::name).join(", ");
            usage(format!("`{name}` is no signal; there are {known}"))
        })?;
        named.push((signal, *values));
    }
    let Some((_, command)) = named.iter().find(|(signal, _)| *signal == Signal::Command) else {
        return Err(usage("the command is missing, which is all that is needed".to_owned()));
    };
    if let Some((signal, values)) = named.iter().find(|(_, values)| values.len() != command.len()) {
        let (name, length) = (signal.name(), values.len());
        return Err(usage(format!("{name} has {length} values, the command {}", command.len())));
    }
    Ok(named)
}

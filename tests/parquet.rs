//! Cycles as Parquet, read by pyarrow, which is not ours.

use std::path::Path;

use serde_json::Value;

use crate::support::{fixture, python, seepd, simulate, stderr, stdout};

/// What pyarrow reads: the rows as JSON, times as ns, and what the columns are.
const READ: &str = "
import json, sys
import pyarrow as pa
import pyarrow.parquet as pq
file = pq.ParquetFile(sys.argv[1])
table = file.read()
types = {field.name: str(field.type) for field in table.schema}
for name in ('t_start', 't_end'):
    place = table.schema.get_field_index(name)
    table = table.set_column(place, name, table[name].cast(pa.int64()))
rows = table.to_pylist(maps_as_pydicts='strict')
facts = {'groups': file.num_row_groups, 'schema': table.schema.metadata[b'seepd.schema'].decode()}
print(json.dumps({'types': types, 'rows': rows, **facts}))
";

/// What pyarrow reads of a file, if it is here.
fn read_by_pyarrow(path: &Path) -> Option<Value> {
    let run = python("pyarrow.parquet")?.args(["-c", READ]).arg(path).output().unwrap();
    Some(serde_json::from_str(&stdout(&run)).unwrap())
}

/// Replays a log to JSON lines and to Parquet; the cycles' lines, and what pyarrow reads.
fn both(log: &Path, more: &[&str]) -> (Vec<Value>, Option<Value>) {
    let folder = tempfile::tempdir().unwrap();
    let table = folder.path().join("cycles.parquet");
    let mut arguments = vec!["replay", "--json", log.to_str().unwrap(), "--parquet", table.to_str().unwrap()];
    arguments.extend(more);
    let lines = stdout(&seepd(arguments));
    let lines = lines.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
    let cycles = lines.filter(|line| line["schema"] == "seepd.cycle/1").collect();
    (cycles, read_by_pyarrow(&table))
}

/// Whether a row has what the line has, and null for what it has not.
fn agrees(line: &Value, row: &Value) -> bool {
    match (line, row) {
        (Value::Object(fields), Value::Object(columns)) => {
            fields.keys().all(|name| columns.contains_key(name))
                && columns.iter().all(|(name, column)| agrees(&line[name], column))
        }
        (Value::Array(elements), Value::Array(others)) => {
            elements.len() == others.len() && elements.iter().zip(others).all(|(a, b)| agrees(a, b))
        }
        (Value::Number(number), Value::Number(other)) => number.as_f64() == other.as_f64(),
        (line, row) => line == row,
    }
}

/// Compares the rows with the lines, and gives the types.
fn compared(lines: &[Value], read: &Value, dated: bool) {
    let rows = read["rows"].as_array().unwrap();
    assert_eq!(rows.len(), lines.len());
    for (line, row) in lines.iter().zip(rows) {
        let mut row = row.clone();
        let dates = ["t_start", "t_end"].map(|name| row.as_object_mut().unwrap().remove(name).unwrap());
        assert!(agrees(line, &row), "{line}\n{row}");
        let length_ns =
            ((line["t_end_s"].as_f64().unwrap() - line["t_start_s"].as_f64().unwrap()) * 1e9).round();
        let begin_ns = line["t_start_ns"].as_i64().unwrap();
        let expected =
            [begin_ns, begin_ns + length_ns as i64].map(|time| if dated { time.into() } else { Value::Null });
        assert_eq!(dates, expected);
    }
    assert_eq!(read["schema"], "seepd.cycle/1");
    let types = &read["types"];
    for (name, kind) in [
        ("axis", "string"),
        ("cycle", "int64"),
        ("t_start_s", "double"),
        ("t_start", "timestamp[ns, tz=UTC]"),
        ("leak_area_m2", "double"),
        ("interval90_m2", "list<element: double>"),
        ("changed", "bool"),
        ("features", "map<string, double>"),
    ] {
        assert!(
            types[name].as_str().unwrap().starts_with(kind.trim_end_matches('>')),
            "{name}: {}",
            types[name]
        );
    }
}

#[test]
fn reference_pyarrow_reads_the_json_lines_cycles_without_an_estimate_too() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("log.mcap");
    simulate(&log, &["--cycles", "12", "--leak-step", "2e-7@5", "--command-only"]);
    let (lines, read) = both(&log, &[]);
    assert_eq!(lines.len(), 12);
    let Some(read) = read else { return };
    compared(&lines, &read, false);
}

#[test]
fn reference_pyarrow_reads_comparison_causes_and_conditions() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let (healthy, later, baseline) = (path("healthy.mcap"), path("later.mcap"), path("baseline.json"));
    let machine =
        ["--parameter-spread", "0.05", "--machine", "3", "--load-variation", "0.02", "--noise", "0.003"];
    simulate(&healthy, &[&machine[..], &["--cycles", "60", "--seed", "2"]].concat());
    stdout(&seepd(["learn-baseline", "--out", baseline.to_str().unwrap(), healthy.to_str().unwrap()]));
    let changed =
        ["--cycles", "40", "--seed", "5", "--leak-growth", "1e-6", "--with", "valve_bias.offset=0.003"];
    simulate(&later, &[&machine[..], &changed].concat());
    let (lines, read) = both(&later, &["--baseline", baseline.to_str().unwrap()]);
    let has = |test: fn(&Value) -> bool| lines.iter().any(test);
    assert!(has(|line| line["why"].is_object()) && has(|line| line["absolute_why"].is_object()));
    assert!(has(|line| line["cause_candidates"].as_array().is_some_and(|list| !list.is_empty())));
    assert!(has(|line| line["conditions"].as_array().is_some_and(|list| !list.is_empty())));
    let Some(read) = read else { return };
    compared(&lines, &read, false);
}

#[test]
fn reference_pyarrow_reads_an_axis_without_a_model() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let (log, config, baseline) = (path("log.mcap"), path("seepd.toml"), path("baseline.json"));
    std::fs::write(&config, "axis = \"press\"\n[monitor]\nkind = \"relative\"\n").unwrap();
    simulate(&log, &["--cycles", "60", "--command-only"]);
    let [log_name, config, baseline] = [&log, &config, &baseline].map(|path| path.to_str().unwrap());
    stdout(&seepd(["learn-baseline", "--config", config, "--out", baseline, log_name]));
    let (lines, read) = both(&log, &["--config", config, "--baseline", baseline]);
    assert!(lines.iter().any(|line| line["standardised"].is_object() && line["changed"] == false));
    let Some(read) = read else { return };
    compared(&lines, &read, false);
}

#[test]
fn reference_pyarrow_reads_dates_where_the_log_has_them() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("dated.csv");
    let text = std::fs::read_to_string(fixture("nominal_leak_1e-6.csv")).unwrap();
    let (names, rows) = text.split_once('\n').unwrap();
    let dated = rows.lines().map(|row| {
        let (seconds, rest) = row.split_once(',').unwrap();
        format!("{},{rest}\n", seconds.parse::<f64>().unwrap() + 1_790_000_000.0)
    });
    std::fs::write(&log, format!("{names}\n{}", dated.collect::<String>())).unwrap();
    let (lines, read) = both(&log, &[]);
    assert_eq!(lines.len(), 1);
    let Some(read) = read else { return };
    compared(&lines, &read, true);
}

/// What fails ends with a line and the usual code, and leaves nothing under the file's name.
#[test]
fn a_file_that_cannot_be_written_is_told_and_not_there() {
    let folder = tempfile::tempdir().unwrap();
    let log = fixture("nominal_leak_1e-6.csv");
    let replay = |to: &str, more: &[&str]| {
        let run = seepd([&["replay", "--quiet", log.to_str().unwrap(), "--parquet", to], more].concat());
        (run.status.code().unwrap(), stderr(&run))
    };
    let table = folder.path().join("cycles.parquet");
    let name = table.to_str().unwrap();
    std::fs::write(&table, "last week's").unwrap();
    let (code, text) = replay(name, &[]);
    assert!(code == 64 && text.lines().count() == 1 && text.contains("is there already; --force"), "{text}");
    assert_eq!(std::fs::read_to_string(&table).unwrap(), "last week's");
    assert_eq!(replay(name, &["--force"]).0, 0);
    assert!(std::fs::read(&table).unwrap().ends_with(b"PAR1"));
    let (code, text) = replay(folder.path().join("none/cycles.parquet").to_str().unwrap(), &[]);
    assert!(code == 74 && text.lines().count() == 1 && text.contains("No such file"), "{text}");
    let (code, text) = replay("/dev/full", &[]);
    assert!(code == 74 && text.contains("writing /dev/full: No space left"), "{text}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}

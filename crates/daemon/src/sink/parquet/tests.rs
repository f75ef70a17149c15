//! What is written, read back by the crate's own reader; tests/parquet.rs has another's.

use std::fs::File;

use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::record::{Row, RowAccessor};
use seepd_monitor::event::{FeatureValues, Flag};

use super::*;

/// 2026-09-21, in ns.
const BEGIN_NS: i64 = 1_790_000_000_000_000_000;

fn cycle(number: u64, begin_ns: i64, leak: Option<f64>) -> CycleLine<'static> {
    CycleLine {
        schema: "seepd.cycle/1",
        axis: "press-1",
        cycle: number,
        duty_cycle: None,
        t_start_s: number as f64 * 10.0,
        t_end_s: number as f64 * 10.0 + 9.5,
        t_start_ns: begin_ns + number as i64 * 10_000_000_000,
        leak_area_m2: leak,
        interval90_m2: leak.map(|leak| [0.5 * leak, 2.0 * leak]),
        leak_flow_lpm: leak.map(|leak| 1e6 * leak),
        reference_dp_pa: 7e6,
        flag: if leak.is_some() { Flag::Healthy } else { Flag::NoEstimate },
        reason: leak.is_none().then_some("gap"),
        absolute: None,
        comparison: None,
        cause: None,
        relative: None,
        features: None,
    }
}

/// The rows of a file with these cycles, and how many groups they are in.
fn read_back(cycles: &[CycleLine<'_>]) -> (Vec<Row>, usize) {
    let mut sink = ParquetSink::new(tempfile::tempfile().unwrap()).unwrap();
    cycles.iter().for_each(|line| sink.write_event(&Event::Cycle(line.clone())).unwrap());
    let file: File = sink.finish().unwrap();
    let reader = SerializedFileReader::new(file).unwrap();
    let rows = reader.get_row_iter(None).unwrap().map(Result::unwrap).collect();
    (rows, reader.num_row_groups())
}

fn column(row: &Row, name: &str) -> usize {
    row.get_column_iter().position(|(column, _)| column == name).unwrap()
}

#[test]
fn numbers_are_numbers_and_without_an_estimate_null() {
    let (rows, _) = read_back(&[cycle(0, BEGIN_NS, Some(1e-7)), cycle(1, BEGIN_NS, None)]);
    let [found, none] = &rows[..] else { panic!("{} rows", rows.len()) };
    let at = |name| column(found, name);
    assert_eq!(found.get_double(at("leak_area_m2")).unwrap(), 1e-7);
    let interval = found.get_list(at("interval90_m2")).unwrap().elements();
    assert_eq!(interval, [parquet::record::Field::Double(0.5e-7), parquet::record::Field::Double(2e-7)]);
    assert_eq!(found.get_string(at("flag")).unwrap(), "healthy");
    assert_eq!(none.get_long(at("cycle")).unwrap(), 1);
    assert_eq!(none.get_string(at("reason")).unwrap(), "gap");
    assert_eq!(
        (found.get_double(at("t_start_s")).unwrap(), none.get_double(at("t_end_s")).unwrap()),
        (0.0, 19.5)
    );
    for name in ["leak_area_m2", "interval90_m2", "leak_flow_lpm"] {
        assert_eq!(none.get_column_iter().nth(at(name)).unwrap().1, &parquet::record::Field::Null, "{name}");
    }
}

#[test]
fn values_by_name_come_back_by_name_and_an_empty_list_is_no_null() {
    let names = ["std".to_owned(), "mean".to_owned()];
    let mut line = cycle(0, BEGIN_NS, Some(1e-7));
    line.features = Some(FeatureValues { names: &names, values: &[0.25, f64::NAN] });
    let mut row = serde_json::to_value(&line).unwrap();
    row["distinguish"] = serde_json::json!([]);
    let mut sink = ParquetSink::new(tempfile::tempfile().unwrap()).unwrap();
    column::lay_out(sink.schema.root_schema(), &row, &mut sink.columns).unwrap();
    sink.rows = 1;
    let reader = SerializedFileReader::new(sink.finish().unwrap()).unwrap();
    let row = reader.get_row_iter(None).unwrap().next().unwrap().unwrap();
    assert_eq!(row.get_map(column(&row, "features")).unwrap().entries().len(), 2);
    let text = row.to_string();
    assert!(text.contains(r#"features: {"mean" -> null, "std" -> 0.25}"#), "{text}");
    assert!(text.contains("distinguish: []") && text.contains("conditions: null"), "{text}");
}

#[test]
fn times_are_dates_where_the_clock_knows_the_date() {
    for (begin_ns, dated) in [(BEGIN_NS, true), (0, false)] {
        // Ten days on, a clock that began with its machine knows no date either.
        let cycles = [0, 100_000].map(|number| cycle(number, begin_ns, None));
        for row in read_back(&cycles).0 {
            let field = row.get_column_iter().nth(column(&row, "t_start")).unwrap().1.clone();
            assert_eq!(field != parquet::record::Field::Null, dated, "{row}");
        }
    }
}

#[test]
fn what_is_held_does_not_grow_with_the_record() {
    let mut sink = ParquetSink::new(tempfile::tempfile().unwrap()).unwrap();
    for number in 0..2500 {
        sink.write_event(&Event::Cycle(cycle(number, BEGIN_NS, Some(1e-7)))).unwrap();
        assert!(sink.rows < GROUP_ROWS && sink.columns.iter().all(|column| column.held() <= 2 * sink.rows));
    }
    let reader = SerializedFileReader::new(sink.finish().unwrap()).unwrap();
    let rows: Vec<i64> = reader.metadata().row_groups().iter().map(|group| group.num_rows()).collect();
    assert_eq!(rows, [1000, 1000, 500]);
    assert_eq!(reader.get_row_iter(None).unwrap().count(), 2500);
}

#[test]
fn a_record_without_cycles_has_the_columns() {
    let (rows, groups) = read_back(&[]);
    assert_eq!((rows.len(), groups), (0, 0));
}

#[test]
fn the_operating_systems_word_is_told() {
    let full = File::options().write(true).open("/dev/full").unwrap();
    let mut sink = ParquetSink::new(full).unwrap();
    let written =
        (0..2000).try_for_each(|number| sink.write_event(&Event::Cycle(cycle(number, 0, Some(1e-7)))));
    let error = written.and_then(|()| sink.finish().map(drop)).unwrap_err();
    assert_eq!(error.kind(), io::ErrorKind::StorageFull, "{error}");
}

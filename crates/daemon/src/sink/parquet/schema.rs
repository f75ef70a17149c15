//! The columns of a cycle in Parquet's words.
//!
//! Names, nesting and units are those of `seepd.cycle/1`; what a line may leave out is optional here. `t_start` and `t_end` are added: the
//! same times as dates, null where the record's clock knows none.

use parquet::errors::ParquetError;
use parquet::schema::parser::parse_message_type;
use parquet::schema::types::TypePtr;

/// The columns of `seepd.cycle/1`.
pub(super) fn cycle() -> Result<TypePtr, ParquetError> {
    let columns = [
        "required binary schema (STRING);".to_owned(),
        "required binary axis (STRING);".to_owned(),
        "required int64 cycle;".to_owned(),
        text("duty_cycle"),
        "required double t_start_s;".to_owned(),
        "required double t_end_s;".to_owned(),
        "required int64 t_start_ns;".to_owned(),
        "optional int64 t_start (TIMESTAMP(NANOS,true));".to_owned(),
        "optional int64 t_end (TIMESTAMP(NANOS,true));".to_owned(),
        number("leak_area_m2"),
        list("interval90_m2", &number("element")),
        number("leak_flow_lpm"),
        "required double reference_dp_pa;".to_owned(),
        "required binary flag (STRING);".to_owned(),
        text("reason"),
        absolute(),
        comparison(),
        cause(),
        relative(),
        map("features"),
    ];
    parse_message_type(&format!("message seepd_cycle {{ {} }}", columns.concat())).map(TypePtr::new)
}

/// What the simulator-trained model says by itself.
fn absolute() -> String {
    let interval = list("absolute_interval90_m2", &number("element"));
    [number("absolute_leak_area_m2"), interval, number("absolute_novelty"), map("absolute_why")].concat()
}

/// What the comparison with a baseline says.
fn comparison() -> String {
    [
        number("response_m2"),
        number("novelty"),
        text("load"),
        number("load_change"),
        text("finding"),
        number("drift_sum"),
        time_to("time_to_leak"),
        time_to("time_to_severe"),
        map("why"),
    ]
    .concat()
}

/// What has changed since the baseline.
fn cause() -> String {
    let candidate = [
        text("cause"),
        text("side"),
        number("probability"),
        number("size"),
        text("unit"),
        list("interval90", &number("element")),
    ];
    let course = [
        number("sum"),
        integer("onset_cycle"),
        list("onset_cycles", &integer("element")),
        integer("onset_ns"),
        list("onset_range_ns", &integer("element")),
        text("manner"),
        number("rate_per_day"),
        list("rate90_per_day", &number("element")),
        text("severity"),
        number("matters_from"),
        time_to("time_to_matter"),
    ];
    let condition = [candidate.concat(), course.concat()];
    [
        text("cause"),
        number("cause_probability"),
        text("cause_also"),
        list("cause_candidates", &group("element", &candidate)),
        list("distinguish", &text("element")),
        integer("onset_cycle"),
        list("conditions", &group("element", &condition)),
    ]
    .concat()
}

/// What the comparison says on an axis without a model.
fn relative() -> String {
    let changed = "optional boolean changed;".to_owned();
    [number("distance"), changed, number("largest_sum"), number("changed_since_s"), map("standardised")]
        .concat()
}

fn number(name: &str) -> String {
    format!("optional double {name};")
}

fn integer(name: &str) -> String {
    format!("optional int64 {name};")
}

fn text(name: &str) -> String {
    format!("optional binary {name} (STRING);")
}

fn group(name: &str, fields: &[String]) -> String {
    format!("optional group {name} {{ {} }}", fields.concat())
}

fn list(name: &str, element: &str) -> String {
    format!("optional group {name} (LIST) {{ repeated group list {{ {element} }} }}")
}

/// Numbers by name.
fn map(name: &str) -> String {
    let entry = "required binary key (STRING); optional double value;";
    format!("optional group {name} (MAP) {{ repeated group key_value {{ {entry} }} }}")
}

/// A time from the end of the cycle, s.
fn time_to(name: &str) -> String {
    group(name, &["expected_s", "earliest_s", "latest_s"].map(number))
}

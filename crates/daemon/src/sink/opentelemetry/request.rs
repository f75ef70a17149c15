//! What OTLP sends: all series as one `ExportMetricsServiceRequest`, and what is answered.

use crate::sink::series::{Labels, Points, Series};

/// `opentelemetry.proto.collector.metrics.v1.ExportMetricsServiceRequest`.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct Request {
    #[prost(message, repeated, tag = "1")]
    resource_metrics: Vec<ResourceMetrics>,
}

#[derive(Clone, PartialEq, prost::Message)]
struct ResourceMetrics {
    #[prost(message, optional, tag = "1")]
    resource: Option<Resource>,
    #[prost(message, repeated, tag = "2")]
    scope_metrics: Vec<ScopeMetrics>,
}

#[derive(Clone, PartialEq, prost::Message)]
struct Resource {
    #[prost(message, repeated, tag = "1")]
    attributes: Vec<KeyValue>,
}

#[derive(Clone, PartialEq, prost::Message)]
struct KeyValue {
    #[prost(string, tag = "1")]
    key: String,
    #[prost(message, optional, tag = "2")]
    value: Option<AnyValue>,
}

/// `AnyValue`, of texts alone.
#[derive(Clone, PartialEq, prost::Message)]
struct AnyValue {
    #[prost(string, optional, tag = "1")]
    string_value: Option<String>,
}

#[derive(Clone, PartialEq, prost::Message)]
struct ScopeMetrics {
    #[prost(message, optional, tag = "1")]
    scope: Option<Scope>,
    #[prost(message, repeated, tag = "2")]
    metrics: Vec<Metric>,
}

#[derive(Clone, PartialEq, prost::Message)]
struct Scope {
    #[prost(string, tag = "1")]
    name: String,
    #[prost(string, tag = "2")]
    version: String,
}

#[derive(Clone, PartialEq, prost::Message)]
struct Metric {
    #[prost(string, tag = "1")]
    name: String,
    #[prost(string, tag = "2")]
    description: String,
    #[prost(string, tag = "3")]
    unit: String,
    #[prost(oneof = "Data", tags = "5, 7")]
    data: Option<Data>,
}

#[derive(Clone, PartialEq, prost::Oneof)]
enum Data {
    #[prost(message, tag = "5")]
    Gauge(Gauge),
    #[prost(message, tag = "7")]
    Sum(Sum),
}

#[derive(Clone, PartialEq, prost::Message)]
struct Gauge {
    #[prost(message, repeated, tag = "1")]
    data_points: Vec<Point>,
}

#[derive(Clone, PartialEq, prost::Message)]
struct Sum {
    #[prost(message, repeated, tag = "1")]
    data_points: Vec<Point>,
    #[prost(int32, tag = "2")]
    aggregation_temporality: i32,
    #[prost(bool, tag = "3")]
    is_monotonic: bool,
}

/// `AGGREGATION_TEMPORALITY_CUMULATIVE`: a sum is counted from its start on.
const CUMULATIVE: i32 = 2;

/// `NumberDataPoint`.
#[derive(Clone, PartialEq, prost::Message)]
struct Point {
    #[prost(fixed64, tag = "2")]
    start_time_unix_nano: u64,
    #[prost(fixed64, tag = "3")]
    time_unix_nano: u64,
    #[prost(oneof = "Value", tags = "4, 6")]
    value: Option<Value>,
    #[prost(message, repeated, tag = "7")]
    attributes: Vec<KeyValue>,
}

#[derive(Clone, Copy, PartialEq, prost::Oneof)]
enum Value {
    #[prost(double, tag = "4")]
    Double(f64),
    #[prost(sfixed64, tag = "6")]
    Int(i64),
}

/// `ExportMetricsServiceResponse`.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct Response {
    #[prost(message, optional, tag = "1")]
    pub(super) partial_success: Option<PartialSuccess>,
}

/// What was not taken of a request that was.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct PartialSuccess {
    #[prost(int64, tag = "1")]
    pub(super) rejected_data_points: i64,
    #[prost(string, tag = "2")]
    pub(super) error_message: String,
}

/// Who sends, and since when its sums count.
#[derive(Debug, Clone)]
pub(super) struct Sender {
    pub(super) service: String,
    pub(super) host: String,
    /// ns since 1970.
    pub(super) since_ns: u64,
}

fn attribute(key: &str, text: &str) -> KeyValue {
    KeyValue { key: key.to_owned(), value: Some(AnyValue { string_value: Some(text.to_owned()) }) }
}

/// A request with all series that have a point, at a time in ns since 1970.
pub(super) fn request(sender: &Sender, all: Vec<Series>, now_ns: u64) -> Request {
    let attributes = vec![
        attribute("service.name", &sender.service),
        attribute("service.version", env!("CARGO_PKG_VERSION")),
        attribute("service.instance.id", &sender.host),
        attribute("host.name", &sender.host),
    ];
    let metrics = all.into_iter().filter_map(|one| metric(one, sender.since_ns, now_ns)).collect();
    let scope = Scope { name: "seepd".into(), version: env!("CARGO_PKG_VERSION").into() };
    let scope_metrics = vec![ScopeMetrics { scope: Some(scope), metrics }];
    Request {
        resource_metrics: vec![ResourceMetrics { resource: Some(Resource { attributes }), scope_metrics }],
    }
}

/// A series; nothing where it has no point.
fn metric(series: Series, since_ns: u64, now_ns: u64) -> Option<Metric> {
    let point = |labels: Labels, start_time_unix_nano, value| Point {
        start_time_unix_nano,
        time_unix_nano: now_ns,
        value: Some(value),
        attributes: labels.iter().map(|(key, text)| attribute(key, text)).collect(),
    };
    let Series { name, help, points } = series;
    let data = match points {
        Points::Gauges(points) => {
            let is_number = |(_, value): &(Labels, f64)| value.is_finite();
            let points = points.into_iter().filter(is_number);
            let data_points: Vec<Point> =
                points.map(|(labels, value)| point(labels, 0, Value::Double(value))).collect();
            (!data_points.is_empty()).then_some(Data::Gauge(Gauge { data_points }))
        }
        Points::Counters(points) => {
            let count = |count: u64| Value::Int(i64::try_from(count).unwrap_or(i64::MAX));
            let data_points: Vec<Point> =
                points.into_iter().map(|(labels, value)| point(labels, since_ns, count(value))).collect();
            let sum = Sum { data_points, aggregation_temporality: CUMULATIVE, is_monotonic: true };
            (!sum.data_points.is_empty()).then_some(Data::Sum(sum))
        }
    }?;
    let (description, unit) = (help.to_owned(), unit(name).to_owned());
    Some(Metric { name: format!("seepd_{name}"), description, unit, data: Some(data) })
}

/// Unit of a series by the end of its name, as UCUM writes it.
fn unit(name: &str) -> &'static str {
    let units = [("_m2", "m2"), ("_lpm", "L/min"), ("_w", "W"), ("_s", "s"), ("_per_day", "/d")];
    units.iter().find(|(end, _)| name.ends_with(end)).map_or("1", |(_, unit)| unit)
}

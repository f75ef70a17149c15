//! Payloads of Sparkplug B as its protobuf definition lays them out, and what an axis says in metrics.

use crate::hub::AxisStatus;
use crate::sink::sizes::{Size, sizes};

/// `org.eclipse.tahu.protobuf.Payload`, less what this node neither sends nor heeds.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct Payload {
    /// ms since 1970.
    #[prost(uint64, optional, tag = "1")]
    pub(super) timestamp: Option<u64>,
    #[prost(message, repeated, tag = "2")]
    pub(super) metrics: Vec<Metric>,
    #[prost(uint64, optional, tag = "3")]
    pub(super) seq: Option<u64>,
}

/// `Payload.Metric`.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct Metric {
    #[prost(string, optional, tag = "1")]
    pub(super) name: Option<String>,
    /// ms since 1970.
    #[prost(uint64, optional, tag = "3")]
    pub(super) timestamp: Option<u64>,
    /// One of [`DataType`]; births have it, data do not.
    #[prost(uint32, optional, tag = "4")]
    pub(super) datatype: Option<u32>,
    #[prost(bool, optional, tag = "7")]
    pub(super) is_null: Option<bool>,
    #[prost(message, optional, tag = "9")]
    properties: Option<PropertySet>,
    #[prost(oneof = "Value", tags = "11, 13, 14, 15")]
    pub(super) value: Option<Value>,
}

/// A metric's value in the field of its kind.
#[derive(Clone, PartialEq, prost::Oneof)]
pub(super) enum Value {
    #[prost(uint64, tag = "11")]
    Long(u64),
    #[prost(double, tag = "13")]
    Double(f64),
    #[prost(bool, tag = "14")]
    Boolean(bool),
    #[prost(string, tag = "15")]
    Text(String),
}

/// `Payload.PropertySet`: names and values side by side.
#[derive(Clone, PartialEq, prost::Message)]
struct PropertySet {
    #[prost(string, repeated, tag = "1")]
    keys: Vec<String>,
    #[prost(message, repeated, tag = "2")]
    values: Vec<PropertyValue>,
}

/// `Payload.PropertyValue`, of texts alone.
#[derive(Clone, PartialEq, prost::Message)]
struct PropertyValue {
    #[prost(uint32, optional, tag = "1")]
    kind: Option<u32>,
    #[prost(string, optional, tag = "8")]
    text: Option<String>,
}

/// Codes of the specification, section 6.4.16.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum DataType {
    Int64 = 4,
    UInt64 = 8,
    Double = 10,
    Boolean = 11,
    Text = 12,
}

impl Metric {
    /// A metric; one without a value is null.
    pub(super) fn new(name: &str, datatype: DataType, value: Option<Value>) -> Self {
        Metric {
            name: Some(name.to_owned()),
            timestamp: None,
            datatype: Some(datatype as u32),
            is_null: value.is_none().then_some(true),
            properties: None,
            value,
        }
    }

    fn text(name: &str, text: Option<&str>) -> Self {
        Self::new(name, DataType::Text, text.map(|text| Value::Text(text.to_owned())))
    }

    fn yes_or_no(name: &str, value: bool) -> Self {
        Self::new(name, DataType::Boolean, Some(Value::Boolean(value)))
    }

    fn count(name: &str, value: Option<u64>) -> Self {
        Self::new(name, DataType::UInt64, value.map(Value::Long))
    }

    fn size(size: &Size) -> Self {
        let unit = PropertyValue { kind: Some(DataType::Text as u32), text: Some(size.unit.to_owned()) };
        let properties = PropertySet { keys: vec!["engUnit".to_owned()], values: vec![unit] };
        let metric = Self::new(size.name, DataType::Double, size.value.map(Value::Double));
        Metric { properties: Some(properties), ..metric }
    }

    /// As it stands in data, which have neither what the birth has said already nor its units.
    pub(super) fn in_data(&self) -> Self {
        Metric { datatype: None, properties: None, ..self.clone() }
    }
}

/// What an axis says, always the same metrics in the same order.
pub(super) fn metrics(axis: &AxisStatus) -> Vec<Metric> {
    let mut metrics = vec![
        Metric::text("flag", Some(axis.flag.name())),
        Metric::count("flag_code", Some(axis.flag as u64)),
        Metric::text("latched", axis.latched.map(|flag| flag.name())),
        Metric::count("latched_code", Some(axis.latched.map_or(0, |flag| flag as u64))),
        Metric::yes_or_no("acknowledged", axis.acknowledged),
        Metric::yes_or_no("stale", axis.stale),
        Metric::count("cycles", Some(axis.cycles)),
        Metric::text("reason", axis.reason),
        Metric::text("verdict", Some(&axis.verdict.verdict)),
        Metric::text("to_do", Some(axis.verdict.to_do)),
        Metric::text("condition", axis.condition.as_deref()),
    ];
    metrics.extend(sizes(axis).iter().map(Metric::size));
    metrics
}

#[cfg(test)]
mod tests {
    use super::*;
    use prost::Message;
    use seepd_monitor::event::Flag;

    #[test]
    fn without_an_estimate_sizes_are_null_and_never_zero() {
        let mut status = AxisStatus::new("press", 7e6);
        status.leak_area_m2 = Some(1e-7);
        let area = |status: &AxisStatus| {
            let all = metrics(status);
            all.into_iter().find(|metric| metric.name.as_deref() == Some("leak_area_m2")).unwrap()
        };
        assert_eq!((area(&status).is_null, area(&status).value), (Some(true), None));
        status.flag = Flag::Watch;
        assert_eq!((area(&status).is_null, area(&status).value), (None, Some(Value::Double(1e-7))));
        status.leak_area_m2 = Some(f64::NAN);
        assert_eq!(area(&status).is_null, Some(true));
    }

    /// The bytes of the definition's own fields, written by hand.
    #[test]
    fn analytic_a_payload_has_the_bytes_of_its_definition() {
        let mut metric = Metric::new("a", DataType::Boolean, Some(Value::Boolean(true)));
        metric.timestamp = Some(1);
        let payload = Payload { timestamp: Some(300), metrics: vec![metric], seq: Some(0) };
        let bytes = [8, 0xac, 2, 18, 9, 10, 1, b'a', 24, 1, 32, 11, 112, 1, 24, 0];
        assert_eq!(payload.encode_to_vec(), bytes);
    }
}

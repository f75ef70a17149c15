//! Home Assistant's discovery: one message an axis tells it which of the daemon's topics are which of a device's sensors.
//!
//! The format is that of device discovery (Home Assistant 2024.11 and later): `PREFIX/device/ID/config` with all components.

use std::fmt::Write;

use serde_json::{Value, json};

/// An axis's message: its topic below nothing, and its content.
pub(super) fn discovery(discovery_prefix: &str, prefix: &str, axis: &str) -> (String, Value) {
    let id = identifier(prefix, axis);
    let sensor = |name: &str, key: &str, template: String, more: Value| {
        let mut component = json!({
            "p": "sensor", "name": name, "unique_id": format!("{id}_{key}"), "value_template": template,
        });
        merge(&mut component, more);
        (key.to_owned(), component)
    };
    // Without an estimate a value is unknown, and never the last one or a zero.
    let known = |value: &str| format!("{{{{ {value} if value_json.flag != 'no_estimate' else None }}}}");
    let binary = |name: &str, key: &str, class: &str, is_on: &str| {
        let component = json!({
            "p": "binary_sensor", "name": name, "unique_id": format!("{id}_{key}"), "device_class": class,
            "value_template": format!("{{{{ 'ON' if {is_on} else 'OFF' }}}}"),
        });
        (key.to_owned(), component)
    };
    let flags = ["no_estimate", "healthy", "watch", "leak", "severe"];
    let acknowledge = json!({
        "p": "button", "name": "Acknowledge", "unique_id": format!("{id}_acknowledge"),
        "command_topic": format!("{prefix}/{axis}/acknowledge"), "payload_press": "{\"who\":\"Home Assistant\"}",
    });
    let components: serde_json::Map<String, Value> = [
        sensor("Condition", "flag", "{{ value_json.flag }}".into(), json!({ "device_class": "enum", "options": flags })),
        sensor("In words", "verdict", "{{ value_json.verdict[:255] }}".into(), json!({})),
        sensor("What to do", "to_do", "{{ value_json.to_do[:255] }}".into(), json!({})),
        sensor(
            "Leak flow",
            "leak_flow",
            known("value_json.leak_flow_lpm | round(4)"),
            json!({ "unit_of_measurement": "L/min", "device_class": "volume_flow_rate", "state_class": "measurement" }),
        ),
        sensor(
            "Leak area",
            "leak_area",
            known("(value_json.leak_area_m2 * 1e6) | round(5)"),
            json!({ "unit_of_measurement": "mm²", "state_class": "measurement" }),
        ),
        sensor(
            "Power lost",
            "leak_power",
            known("value_json.leak_power_w | round(1)"),
            json!({ "unit_of_measurement": "W", "device_class": "power", "state_class": "measurement" }),
        ),
        binary("Leak", "leak", "problem", "value_json.flag in ['leak', 'severe']"),
        binary("Not acknowledged", "latched", "problem", "value_json.latched and not value_json.acknowledged"),
        binary("Command arrives", "input", "connectivity", "not value_json.stale"),
        ("acknowledge".to_owned(), acknowledge),
    ]
    .into_iter()
    .collect();
    let message = json!({
        "dev": { "ids": [id], "name": axis, "mf": "seepd", "mdl": "hydraulic axis", "sw": env!("CARGO_PKG_VERSION") },
        "o": { "name": "seepd", "sw": env!("CARGO_PKG_VERSION") },
        "state_topic": format!("{prefix}/{axis}/status"),
        "availability_topic": format!("{prefix}/status"),
        "payload_available": "online",
        "payload_not_available": "offline",
        "cmps": components,
    });
    (format!("{discovery_prefix}/device/{id}/config"), message)
}

fn merge(into: &mut Value, more: Value) {
    if let (Value::Object(into), Value::Object(more)) = (into, more) {
        into.extend(more);
    }
}

/// Letters, digits, `_` and `-` alone are allowed; others are written as their code, so that two axes never share one.
fn identifier(prefix: &str, axis: &str) -> String {
    let mut id = String::new();
    for c in prefix.chars().chain(['-']).chain(axis.chars()) {
        if c.is_ascii_alphanumeric() || c == '-' {
            id.push(c);
        } else {
            // Writing to a String does not fail.
            let _ = write!(id, "_{:x}_", u32::from(c));
        }
    }
    id
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_device_has_its_topics_and_an_identifier_of_its_own() {
        let (topic, message) = discovery("homeassistant", "plant/seepd", "Press 1.a");
        assert_eq!(topic, "homeassistant/device/plant_2f_seepd-Press_20_1_2e_a/config");
        assert_eq!(message["state_topic"], "plant/seepd/Press 1.a/status");
        assert_eq!(message["availability_topic"], "plant/seepd/status");
        let components = message["cmps"].as_object().unwrap();
        assert_eq!(components.len(), 10);
        let mut ids: Vec<&str> = components.values().filter_map(|one| one["unique_id"].as_str()).collect();
        ids.sort_unstable();
        ids.dedup();
        assert_eq!(ids.len(), 10);
        assert_eq!(components["acknowledge"]["command_topic"], "plant/seepd/Press 1.a/acknowledge");
        assert_ne!(identifier("a", "b c"), identifier("a", "b_20_c"));
    }
}

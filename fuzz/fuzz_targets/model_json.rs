//! A model file: an error, or a model that evaluates. What does not begin like JSON is changes to a small model, a line each: where, and the
//! value as JSON, or nothing for what goes.
//! Parser: crates/model/src/check.rs crates/model/src/error.rs crates/model/src/schema.rs:phase_list,values,alike_from,is_usual_alike_from crates/model/src/model.rs:from_json,from_file,check_golden,agree crates/model/src/ensemble.rs:from_checked crates/model/src/relative.rs:from_checked,check_golden crates/model/src/causes/mod.rs:from_checked,check_golden,priors,check_causes
#![no_main]
use std::sync::LazyLock;

use seepd_model::{Comparison, Model};
use serde_json::{Value, json};

/// The program's own with one tree of each kind and the first of each list that is long.
static SMALL: LazyLock<Value> = LazyLock::new(|| {
    let mut model: Value = serde_json::from_slice(seepd::EMBEDDED_MODEL).expect("the program's own");
    for (place, most) in [
        ("/trees", 1),
        ("/relative/trees", 1),
        ("/causes/cells", 12),
        ("/golden", 0),
        ("/relative/golden", 0),
        ("/causes/golden", 0),
    ] {
        model.pointer_mut(place).and_then(Value::as_array_mut).expect(place).truncate(most);
    }
    Model::from_json(model.to_string().as_bytes()).expect("a model");
    model
});

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    if data.trim_ascii_start().starts_with(b"{") {
        return read(data);
    }
    let Ok(changes) = std::str::from_utf8(data) else { return };
    let mut model = SMALL.clone();
    changes.lines().filter(|line| line.starts_with('/')).for_each(|line| change(&mut model, line));
    read(model.to_string().as_bytes());
});

fn change(model: &mut Value, line: &str) {
    let (place, value) = line.split_once(' ').unwrap_or((line, ""));
    let (parent, key) = place.rsplit_once('/').expect("it begins with one");
    let Some(parent) = model.pointer_mut(parent) else { return };
    let value = serde_json::from_str(value).ok();
    match (parent, value) {
        (Value::Object(parent), Some(value)) => drop(parent.insert(key.into(), value)),
        (Value::Object(parent), None) => drop(parent.remove(key)),
        (Value::Array(parent), Some(value)) if key == "-" => parent.push(value),
        (Value::Array(parent), Some(value)) => {
            if let Some(slot) = key.parse().ok().and_then(|index: usize| parent.get_mut(index)) {
                *slot = value;
            }
        }
        (Value::Array(parent), None) => drop(parent.pop()),
        (other, value) => *other = value.unwrap_or(json!(null)),
    }
}

fn read(json: &[u8]) {
    let model = match Model::from_json(json) {
        Ok(model) => model,
        Err(error) => return drop((error.to_string(), error.path().len())),
    };
    let estimate = model.estimate(&vec![0.5; model.feature_names().len()]);
    assert!(!(estimate.value < 0.0));
    if let Some(relative) = model.relative() {
        let (baseline, present) = (vec![0.1; relative.phases()], vec![0.2; relative.phases()]);
        for load_change in [None, Some(0.1)] {
            let _ = relative.estimate(&Comparison {
                baseline: &baseline,
                present: &present,
                load_change,
                noise: 0.001,
            });
        }
    }
}

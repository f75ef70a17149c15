//! Every way in which a model file can be wrong is answered with the JSON path, and none with a panic.

#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use std::sync::LazyLock;

use proptest::prelude::*;
use seepd_model::{Model, ModelError, ModelFile};
use serde_json::Value;

const JSON: &[u8] = include_bytes!("../../daemon/assets/model.json");

/// The embedded model cut down to three trees, without the golden pairs that no longer fit.
static SMALL: LazyLock<Value> = LazyLock::new(|| {
    let mut file: Value = serde_json::from_slice(JSON).unwrap();
    file["trees"].as_array_mut().unwrap().truncate(3);
    file["golden"] = Value::Array(vec![]);
    file
});

fn load(file: &Value) -> Result<Model, ModelError> {
    Model::from_json(&serde_json::to_vec(file).unwrap())
}

/// What loading says after a change.
fn refusal(change: impl Fn(&mut Value)) -> String {
    let mut file = SMALL.clone();
    change(&mut file);
    load(&file).expect_err("the change must be refused").to_string()
}

#[test]
fn whole_and_cut_down_models_load() {
    assert!(Model::from_json(JSON).is_ok());
    assert_eq!(load(&SMALL).unwrap().ensemble().trees(), 3);
}

/// Version 1 is version 2 without causes.
#[test]
fn older_file_reads_and_names_no_causes() {
    let mut file = SMALL.clone();
    assert!(load(&file).unwrap().causes().is_some());
    file["schema"] = "seepd.model/1".into();
    file.as_object_mut().unwrap().remove("causes");
    let model = load(&file).unwrap();
    assert!(model.causes().is_none() && model.relative().is_some());
}

/// The structure writes the keys that it has read, in their order: none is renamed, left out or moved.
#[test]
fn regress_file_written_again_has_the_same_keys() {
    let file: ModelFile = serde_json::from_slice(JSON).unwrap();
    let written = serde_json::to_string(&file).unwrap();
    // Without the numbers, of which this reader may round the last digit.
    let keys = |text: &str| text.trim_end().replace(|c: char| c.is_ascii_digit() || ".+-e".contains(c), "");
    assert!(keys(&written) == keys(std::str::from_utf8(JSON).unwrap()), "other keys than in model.json");
}

#[test]
fn cycle_in_a_tree_names_the_node() {
    let text = refusal(|file| file["trees"][1]["right"][0] = 0.into());
    assert!(text.starts_with("model: trees[1].right[0]: is 0; it must lie in 2 …"), "{text}");
    assert!(text.contains("the tree would loop"));
}

#[test]
fn child_that_skips_or_shares_a_subtree_names_the_node() {
    let text = refusal(|file| {
        let right = file["trees"][0]["right"][0].as_u64().unwrap();
        file["trees"][0]["right"][0] = (right + 1).into();
    });
    assert!(text.starts_with("model: trees[0].right[0]: is "), "{text}");
}

#[test]
fn index_out_of_range_names_the_node() {
    let text = refusal(|file| file["trees"][2]["right"][0] = 4_000_000_000u64.into());
    assert!(text.starts_with("model: trees[2].right[0]: is 4000000000; it must lie in"), "{text}");
    let text = refusal(|file| file["trees"][0]["feature"][0] = 31.into());
    assert_eq!(text, "model: trees[0].feature[0]: is 31; there are 31 features");
    let text = refusal(|file| file["trees"][0]["feature"][0] = (-2).into());
    assert_eq!(text, "model: trees[0].feature[0]: is -2; there are 31 features");
}

#[test]
fn threshold_that_is_no_number_is_refused() {
    // JSON has no NaN: it arrives as null, as text, or as an overflow.
    assert!(refusal(|file| file["trees"][0]["value"][5] = Value::Null).contains("trees[0].value[5]"));
    let json = String::from_utf8(serde_json::to_vec(&*SMALL).unwrap()).unwrap();
    let first = json.find("\"value\":[").unwrap() + "\"value\":[".len();
    for literal in ["NaN", "1e999"] {
        let broken = format!("{}{literal},{}", &json[..first], &json[first..]);
        assert!(Model::from_json(broken.as_bytes()).is_err(), "{literal}");
    }
    let mut file: ModelFile = serde_json::from_value(SMALL.clone()).unwrap();
    file.trees[1].value[3] = f64::NAN;
    let text = Model::from_file(file).unwrap_err().to_string();
    assert_eq!(text, "model: trees[1].value[3]: is NaN; it must be a finite number");
}

#[test]
fn arrays_of_other_lengths_are_refused() {
    let text = refusal(|file| {
        file["trees"][0]["value"].as_array_mut().unwrap().pop();
    });
    assert!(text.starts_with("model: trees[0].value: has "), "{text}");
    let text = refusal(|file| {
        file["projections"][1]["loading"].as_array_mut().unwrap().pop();
    });
    assert_eq!(text, "model: projections[1].loading: has 199 values; it must have 200");
    assert_eq!(refusal(|file| file["trees"] = Value::Array(vec![])), "model: trees: is empty");
}

#[test]
fn unknown_feature_schema_target_and_key_are_refused() {
    let text = refusal(|file| file["features"][3] = "kurtosys".into());
    assert!(text.starts_with("model: features[3]: unknown feature `kurtosys`; known are mean, "), "{text}");
    let text = refusal(|file| file["schema"] = "seepd.model/3".into());
    assert_eq!(
        text,
        "model: schema: is `seepd.model/3`; this program reads `seepd.model/2` and `seepd.model/1`"
    );
    assert!(
        refusal(|file| file["unit"] = "mm2".into()).starts_with("model: target: is `leak_area` in `mm2`")
    );
    assert!(refusal(|file| file["extra"] = 1.into()).contains("unknown field `extra`"));
    assert!(
        refusal(|file| file["sample_rate_hz"] = (-1000).into())
            .starts_with("model: sample_rate_hz: is -1000;")
    );
    assert!(
        refusal(|file| file["cycle"]["bin_samples"] = 0.into()).starts_with("model: cycle.period_s in bins")
    );
}

#[test]
fn altered_trees_fail_the_golden_pairs() {
    let mut file: Value = serde_json::from_slice(JSON).unwrap();
    let trees = file["trees"].as_array_mut().unwrap();
    trees.pop();
    let error = load(&file).unwrap_err();
    assert!(matches!(&error, ModelError::Golden { path, .. } if path == "golden[0]"), "{error}");
    assert!(error.to_string().starts_with("model: golden[0]: expects "), "{error}");
}

#[test]
fn endless_nesting_and_cut_files_are_refused() {
    let nested = format!("{{\"schema\":{}", "[".repeat(1_000_000));
    assert!(Model::from_json(nested.as_bytes()).is_err());
    let deep = format!("{{\"x\":{}{}}}", "[".repeat(100_000), "]".repeat(100_000));
    assert!(Model::from_json(deep.as_bytes()).is_err());
    for cut in [0, 1, 100, 5000, JSON.len() / 2, JSON.len() - 3] {
        assert!(Model::from_json(&JSON[..cut]).is_err(), "cut at {cut}");
    }
    let text = Model::from_json(&vec![b' '; (16 << 20) + 1]).unwrap_err().to_string();
    assert!(text.contains("at most 16777216 are read"), "{text}");
}

/// A stump that splits feature 0 at 0.5 and a constant: mean, spread and interval by hand.
#[test]
fn analytic_estimate_of_two_stumps() {
    let mut file = SMALL.clone();
    file["features"] = serde_json::json!(["mean", "kurtosis"]);
    file["transform"] = serde_json::json!("identity");
    file["calibration"] =
        serde_json::json!({"level": 0.9, "spread_floor": 0.5, "factors": [[1.0, 2.0], [3.0, 4.0]]});
    file["trees"] = serde_json::json!([
        {"feature": [0, -1, -1], "value": [0.5, 1.0, 3.0], "right": [2, 0, 0]},
        {"feature": [-1], "value": [2.0], "right": [0]},
    ]);
    let model = load(&file).unwrap();
    let low = model.estimate(&[0.5, 0.0]);
    assert_eq!((low.value, low.spread), (1.5, 0.5));
    // Factor 2.5 between the two given ones, half width 2.5 · (0.5 + 0.5); no leak is below 0.
    assert_eq!(low.interval, [0.0, 4.0]);
    assert_eq!(model.estimate(&[0.500_001, 0.0]).value, 2.5);
    // C_d A √(2 Δp/ρ).
    let flow = model.leak_flow_m3_per_s(1e-5, 7e6);
    assert!((flow - 0.7 * 1e-5 * (2.0f64 * 7e6 / 870.0).sqrt()).abs() < 1e-18);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    /// Bytes changed anywhere: an error or a model that still passes its golden pairs, never a panic.
    #[test]
    fn property_damaged_files_never_panic(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
        cut in any::<prop::sample::Index>(),
        keep_all in any::<bool>(),
    ) {
        let mut json = serde_json::to_vec(&*SMALL).unwrap();
        for (at, byte) in changes {
            let at = at.index(json.len());
            json[at] = byte;
        }
        if !keep_all {
            json.truncate(cut.index(json.len()));
        }
        if let Ok(model) = Model::from_json(&json) {
            let features = vec![0.1; model.feature_names().len()];
            prop_assert!(model.estimate(&features).value >= 0.0);
        }
    }
}

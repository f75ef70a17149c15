//! Models that others made, and the published schema of ours.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use seepd_model::Model;
use serde_json::{Value, json};

use crate::support::{python, replay, seepd, simulate, stderr, stdout};

fn path(relative: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(relative)
}

fn embedded() -> Value {
    serde_json::from_slice(seepd::EMBEDDED_MODEL).unwrap()
}

fn validator() -> jsonschema::Validator {
    let schema: Value =
        serde_json::from_str(&fs::read_to_string(path("docs/model.schema.json")).unwrap()).unwrap();
    jsonschema::draft202012::new(&schema).unwrap()
}

#[test]
fn our_models_meet_the_published_schema() {
    let errors: Vec<String> = validator().iter_errors(&embedded()).map(|error| error.to_string()).collect();
    assert_eq!(errors, Vec::<String>::new());
}

#[test]
fn what_the_schema_refuses_the_program_refuses_too() {
    let validator = validator();
    type Damage = fn(&mut Value);
    let damages: [(&str, Damage); 12] = [
        ("unknown key", |model| model["colour"] = json!("red")),
        ("another schema", |model| model["schema"] = json!("seepd.model/3")),
        ("no features", |model| model["features"] = json!([])),
        ("text for a number", |model| model["sample_rate_hz"] = json!("fast")),
        ("a rate of 0", |model| model["sample_rate_hz"] = json!(0)),
        ("three anchors", |model| {
            let anchor = model["cycle"]["anchors"][0].clone();
            model["cycle"]["anchors"].as_array_mut().unwrap().push(anchor);
        }),
        ("a wrong phase", |model| model["cycle"]["phases"][0]["kind"] = json!("pause")),
        ("a feature below −1", |model| model["trees"][0]["feature"][0] = json!(-2)),
        ("a fraction for an index", |model| model["trees"][0]["right"][0] = json!(1.5)),
        ("null in the thresholds", |model| model["trees"][0]["value"][0] = Value::Null),
        ("an unknown transform", |model| model["transform"] = json!("square")),
        ("no orifice", |model| {
            model.as_object_mut().unwrap().remove("orifice");
        }),
    ];
    for (name, damage) in damages {
        let mut model = embedded();
        damage(&mut model);
        assert!(!validator.is_valid(&model), "{name}");
        assert!(Model::from_json(model.to_string().as_bytes()).is_err(), "{name}");
    }
}

/// Runs the importer of the folder's files.
fn import(mut python: Command, folder: &Path, forest: &str, target: &str, out: &str) -> Output {
    python.arg(path("tools/import_model.py")).current_dir(folder).args([
        forest,
        "--base",
        "base.json",
        "--target",
        target,
        "--calibrate",
        "data.csv",
        "--out",
        out,
    ]);
    python.output().unwrap()
}

/// Grows forests in the folder, with rows to compare on: random ones, and ones on a threshold and just beside it, where
/// scikit-learn's single precision decides.
const FIT: &str = r"
import csv, json, joblib
import numpy as np
from sklearn.ensemble import BaggingRegressor, ExtraTreesRegressor, RandomForestRegressor
from sklearn.tree import DecisionTreeRegressor
base = json.load(open('base.json'))
names = base['features']
golden = np.array([pair['features'] for pair in base['golden']])
random = np.random.default_rng(1)
X = golden[random.integers(0, len(golden), 1500)] + random.normal(0, 1, (1500, len(names))) * golden.std(axis=0)
area = 1e-5 * np.exp(-3 * random.random(1500) - np.abs(X[:, 0] - X[:, 0].mean()) / X[:, 0].std())
y = np.log(area + base['transform']['ln_offset'])
with open('data.csv', 'w', newline='') as file:
    rows = csv.writer(file)
    rows.writerow([*names, 'leak_area_m2'])
    rows.writerows([*map(repr, map(float, row)), repr(float(a))] for row, a in zip(X[1000:], area[1000:]))
train = slice(0, 1000)
forests = {
    'forest.joblib': ('ln', RandomForestRegressor(30, min_samples_leaf=3, max_features=0.5, random_state=1).fit(X[train], y[train])),
    'bag.joblib': ('area', BaggingRegressor(DecisionTreeRegressor(max_leaf_nodes=50), 27, max_features=0.6, bootstrap_features=True, random_state=1).fit(X[train], area[train])),
    'extra.joblib': ('ln', ExtraTreesRegressor(10, min_samples_leaf=5, random_state=1).fit(X[train], y[train])),
}
compare = {}
for name, (target, forest) in forests.items():
    joblib.dump(forest, name)
    rows = [row for row in X[1000:1200]]
    tree = forest.estimators_[0].tree_
    for node in range(tree.node_count):
        if tree.children_left[node] >= 0:
            single = np.float32(tree.threshold[node])
            above = np.nextafter(single, np.float32(np.inf))
            beside = np.array([single, above, (float(single) + float(above)) / 2], dtype=float)
            for value in [tree.threshold[node], *beside, *np.nextafter(beside, np.inf), *np.nextafter(beside, -np.inf)]:
                row = X[1200 + node % 300].copy()
                column = tree.feature[node]
                if hasattr(forest, 'estimators_features_'):
                    column = forest.estimators_features_[0][column]
                row[column] = value
                rows.append(row)
    predicted = forest.predict(np.array(rows))
    compare[name] = {'target': target, 'rows': [[float(v) for v in row] for row in rows], 'predicted': [float(v) for v in predicted]}
json.dump(compare, open('compare.json', 'w'))
bad = RandomForestRegressor(2, random_state=1).fit(X[train], y[train])
bad.estimators_[1].tree_.value[:, 0, 0] = float('nan')
joblib.dump(bad, 'nan.joblib')
joblib.dump(DecisionTreeRegressor().fit(X[train], y[train]), 'tree.joblib')
";

#[test]
fn reference_scikit_learn_predicts_the_same() {
    let Some(mut fit) = python("sklearn") else { return };
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("base.json"), seepd::EMBEDDED_MODEL).unwrap();
    stdout(&fit.args(["-c", FIT]).current_dir(folder.path()).output().unwrap());
    let compare: Value =
        serde_json::from_str(&fs::read_to_string(folder.path().join("compare.json")).unwrap()).unwrap();
    for (forest, cases) in compare.as_object().unwrap() {
        let target = cases["target"].as_str().unwrap();
        stdout(&import(python("sklearn").unwrap(), folder.path(), forest, target, "imported.json"));
        let imported = fs::read(folder.path().join("imported.json")).unwrap();
        let value: Value = serde_json::from_slice(&imported).unwrap();
        assert!(validator().is_valid(&value), "{forest}");
        let model = Model::from_json(&imported).unwrap();
        let rows = cases["rows"].as_array().unwrap();
        assert!(rows.len() > 500, "{}", rows.len());
        for (row, predicted) in rows.iter().zip(cases["predicted"].as_array().unwrap()) {
            let row: Vec<f64> = row.as_array().unwrap().iter().map(|value| value.as_f64().unwrap()).collect();
            let (predicted, found) = (predicted.as_f64().unwrap(), model.estimate(&row).transformed);
            assert!(
                (predicted - found).abs() <= 1e-12 * predicted.abs(),
                "{forest}: {found}, not {predicted}"
            );
        }
    }
    for (forest, told) in [
        ("nan.joblib", "has the prediction nan; it must be a finite number"),
        ("tree.joblib", "is a DecisionTreeRegressor; BaggingRegressor,"),
        ("base.txt", "cannot be loaded"),
    ] {
        let output = import(python("sklearn").unwrap(), folder.path(), forest, "ln", "refused.json");
        let text = stderr(&output);
        assert_eq!((output.status.code(), text.trim_end().lines().count()), (Some(1), 1), "{text}");
        assert!(text.contains(told), "{text}");
        assert!(!folder.path().join("refused.json").exists());
    }
}

/// Trees in the form that the MATLAB snippet of docs/models.md writes, with a comparison by `<`.
#[test]
fn flat_trees_of_other_tools_are_imported_and_replay_a_log() {
    let Some(python) = python("json") else { return };
    let folder = tempfile::tempdir().unwrap();
    let base = embedded();
    fs::write(folder.path().join("base.json"), seepd::EMBEDDED_MODEL).unwrap();
    let names: Vec<&str> =
        base["features"].as_array().unwrap().iter().map(|name| name.as_str().unwrap()).collect();
    let mut data = format!("{},leak_area_m2\n", names.join(","));
    for index in 0..60 {
        let row: Vec<String> = names
            .iter()
            .enumerate()
            .map(|(j, _)| format!("{}", f64::from(index) * 0.01 + j as f64))
            .collect();
        data += &format!("{},{}\n", row.join(","), 1e-7 + f64::from(index) * 1e-8);
    }
    fs::write(folder.path().join("data.csv"), data).unwrap();
    let flat = json!({
        "made_by": "MATLAB R2024b", "rule": "<",
        "trees": [
            // Nodes not in preorder: 0 → (2, 1), 2 → (3, 4).
            {"feature": [0, -1, 1, -1, -1], "left": [2, -1, 3, -1, -1], "right": [1, -1, 4, -1, -1],
             "threshold": [0.25, null, 1.125, null, null], "value": [0.0, 3e-7, 0.0, 1e-7, 2e-7]},
            {"feature": [-1], "left": [-1], "right": [-1], "threshold": [null], "value": [4e-7]},
        ],
    });
    fs::write(folder.path().join("trees.json"), flat.to_string()).unwrap();
    stdout(&import(python, folder.path(), "trees.json", "area", "imported.json"));
    let imported = folder.path().join("imported.json");
    let model = Model::from_json(&fs::read(&imported).unwrap()).unwrap();
    let estimate = |first: f64, second: f64| {
        let mut row = vec![0.0; names.len()];
        (row[0], row[1]) = (first, second);
        model.estimate(&row).value
    };
    let mean = |leaf: f64| (leaf + 4e-7) / 2.0;
    assert_eq!(estimate(0.2, 1.0), mean(1e-7));
    assert_eq!(estimate(0.2, 1.125), mean(2e-7));
    assert_eq!(estimate(0.25, 1.0), mean(3e-7));
    assert_eq!(estimate(0.25f64.next_down(), 1.125f64.next_down()), mean(1e-7));
    let log = folder.path().join("a.mcap");
    simulate(&log, &["--cycles", "3"]);
    assert_eq!(replay(&log, &["--model", imported.to_str().unwrap()]).len(), 4);
}

#[test]
fn a_model_with_nan_is_refused_with_its_place() {
    let folder = tempfile::tempdir().unwrap();
    let text = String::from_utf8(seepd::EMBEDDED_MODEL.to_vec()).unwrap();
    for word in ["NaN", "-Infinity"] {
        let at = text.find("\"value\":[").unwrap() + "\"value\":[".len();
        let end = at + text[at..].find(',').unwrap();
        let model = folder.path().join("model.json");
        fs::write(&model, format!("{}{word}{}", &text[..at], &text[end..])).unwrap();
        let output = seepd(["check", model.to_str().unwrap()]);
        let told = stderr(&output);
        assert_eq!((output.status.code(), told.lines().count()), (Some(78), 1), "{told}");
        let name = word.trim_start_matches('-');
        assert!(told.contains(&format!("trees[0].value[0]: {name} at line 1 column")), "{told}");
    }
}

#[test]
fn training_gives_its_data_and_its_report_to_other_tools() {
    let folder = tempfile::tempdir().unwrap();
    let (model, data) = (folder.path().join("model.json"), folder.path().join("data.csv"));
    let output = seepd([
        "train",
        "--observations",
        "240",
        "--held-out",
        "100",
        "--trials",
        "1",
        "--compared",
        "60",
        "--calibration",
        "60",
        "--causes",
        "0",
        "--json",
        "--out",
        model.to_str().unwrap(),
        "--data",
        data.to_str().unwrap(),
    ]);
    let report: Value = serde_json::from_str(&stdout(&output)).unwrap();
    assert_eq!(report["schema"], "seepd.training/1");
    assert_eq!(report["by_noise"].as_array().unwrap().len(), 5);
    assert!(report["accuracy"]["r2_area"].as_f64().unwrap() > 0.9);
    let model = Model::from_json(&fs::read(&model).unwrap()).unwrap();
    let mut rows = csv::Reader::from_path(&data).unwrap();
    let header: Vec<String> = rows.headers().unwrap().iter().map(str::to_owned).collect();
    assert_eq!(header[..header.len() - 1], *model.feature_names());
    assert_eq!(header.last().unwrap(), "leak_area_m2");
    let values: Vec<Vec<f64>> =
        rows.records().map(|row| row.unwrap().iter().map(|text| text.parse().unwrap()).collect()).collect();
    assert!((238..=240).contains(&values.len()), "{}", values.len());
    // The model knows what it learned from: rows and leaks belong together.
    let (features, area) = values[200].split_at(header.len() - 1);
    let estimate = model.estimate(features).value;
    assert!((estimate - area[0]).abs() < 0.3 * area[0], "{estimate}, not {}", area[0]);
}

/// A model that cannot compare is refused where a baseline is asked for, before it could begin to learn one for ever.
#[test]
fn a_model_without_a_comparison_is_refused_where_a_baseline_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let mut model: serde_json::Value = serde_json::from_slice(seepd::EMBEDDED_MODEL).unwrap();
    model.as_object_mut().unwrap().remove("relative");
    fs::write(folder.path().join("alone.json"), model.to_string()).unwrap();
    let log = folder.path().join("log.mcap");
    simulate(&log, &["--cycles", "2"]);
    let config = folder.path().join("seepd.toml");
    let source = "[source]\nlog = \"log.mcap\"\npace = \"fast\"\n";
    let text =
        format!("model = \"alone.json\"\nstate_dir = \"state\"\n[baseline]\nlearn_cycles = 20\n{source}");
    fs::write(&config, &text).unwrap();
    let path = config.to_str().unwrap();
    for arguments in [
        ["check", path].as_slice(),
        &["run", "--config", path],
        &["replay", "--config", path, log.to_str().unwrap()],
    ] {
        let output = seepd(arguments);
        assert_eq!(output.status.code(), Some(78), "{arguments:?}: {}", stderr(&output));
        assert!(
            stderr(&output).contains("alone.json: the model has no estimates relative to a baseline"),
            "{}",
            stderr(&output)
        );
    }
    fs::write(&config, text.replace("learn_cycles = 20", "learn_cycles = 0")).unwrap();
    stdout(&seepd(["check", path]));
    let output = seepd(["replay", "--config", path, "--learn-cycles", "20", log.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(78), "{}", stderr(&output));
}

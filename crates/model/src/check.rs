//! Every check of a model file, with the JSON path of what is wrong.

use alloc::format;
use alloc::string::{String, ToString};
use alloc::vec::Vec;

use seepd_features::Feature;
use seepd_features::reader::MAX_FEATURES;
use seepd_features::segment::{MAX_ANCHORS, MAX_CYCLE_BINS, MAX_PHASES, MAX_TEMPLATE_BINS};

use crate::causes::check_causes;
use crate::error::{ModelError, TreeFault};
use crate::relative::Inputs;
use crate::schema::{
    Calibration, Cycle, Filter, ModelFile, READ_SCHEMAS, RelativeFile, TrainingDistribution, Transform, Tree,
};

/// Largest file that is read, bytes: sixteen times the size that training aims at, and small on any gateway.
pub const MAX_FILE_BYTES: usize = 16 << 20;

/// Reads the structure; nothing of its content has been checked after this.
pub(crate) fn parse(json: &[u8]) -> Result<ModelFile, ModelError> {
    if json.len() > MAX_FILE_BYTES {
        return Err(ModelError::TooLong { bytes: json.len() });
    }
    let mut deserializer = serde_json::Deserializer::from_slice(json);
    let file: ModelFile = serde_path_to_error::deserialize(&mut deserializer).map_err(|error| {
        let message = described(json, error.inner());
        ModelError::Json { path: error.path().to_string(), message }
    })?;
    deserializer
        .end()
        .map_err(|error| ModelError::Json { path: String::new(), message: error.to_string() })?;
    Ok(file)
}

/// What is wrong with the text; a number that is none is named, as other tools write it.
fn described(json: &[u8], error: &serde_json::Error) -> String {
    let line_start = match error.line() {
        0 | 1 => 0,
        line => json
            .iter()
            .enumerate()
            .filter(|(_, byte)| **byte == b'\n')
            .nth(line - 2)
            .map_or(0, |(at, _)| at + 1),
    };
    let at = (line_start + error.column().saturating_sub(1)).min(json.len());
    let near = &json[at.saturating_sub(1)..(at + 9).min(json.len())];
    let is_near = |word: &[u8]| near.windows(word.len()).any(|window| window == word);
    if error.is_syntax() && (is_near(b"NaN") || is_near(b"Infinity")) {
        let what = if is_near(b"NaN") { "NaN" } else { "Infinity" };
        return format!(
            "{what} at line {} column {}; every number of a model must be finite",
            error.line(),
            error.column()
        );
    }
    error.to_string()
}

/// Checks everything but the golden pairs.
pub(crate) fn check(file: &ModelFile) -> Result<(), ModelError> {
    if !READ_SCHEMAS.contains(&file.schema.as_str()) {
        return Err(ModelError::Schema { given: file.schema.clone() });
    }
    within("sample_rate_hz", file.sample_rate_hz, 1.0, 1e6)?;
    if let Some(Filter::Kalman(kalman)) = &file.filter {
        within("filter.kalman.q", kalman.q, 0.0, 1e9)?;
        within("filter.kalman.r", kalman.r, 1e-12, 1e12)?;
    }
    check_cycle(&file.cycle, file.sample_rate_hz)?;
    check_projections(file)?;
    check_features(file)?;
    if (file.target.as_str(), file.unit.as_str()) != ("leak_area", "m2") {
        return Err(ModelError::Target { target: file.target.clone(), unit: file.unit.clone() });
    }
    if let Transform::LnOffset(offset) = file.transform {
        within("transform.ln_offset", offset, 1e-15, 1.0)?;
    }
    within("orifice.discharge_coefficient", file.orifice.discharge_coefficient, 0.01, 1.0)?;
    within("orifice.density_kg_per_m3", file.orifice.density_kg_per_m3, 100.0, 1e4)?;
    if file.trees.is_empty() {
        return Err(ModelError::Empty { path: "trees".into() });
    }
    for (index, tree) in file.trees.iter().enumerate() {
        check_tree(tree, file.features.len(), &format!("trees[{index}]"))?;
    }
    check_calibration(&file.calibration, "calibration")?;
    check_distributions(&file.training_distributions, file.cycle.phases.len(), "novelty")?;
    if let Some(relative) = &file.relative {
        check_relative(relative, file.cycle.phases.len())?;
    }
    file.causes.as_ref().map_or(Ok(()), |causes| check_causes(causes, file.cycle.phases.len()))
}

pub(crate) fn within(path: &str, value: f64, low: f64, high: f64) -> Result<(), ModelError> {
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err(ModelError::OutOfRange { path: path.into(), value, low, high })
}

fn check_cycle(cycle: &Cycle, sample_rate_hz: f64) -> Result<(), ModelError> {
    within("cycle.period_s", cycle.period_s, 0.1, 3600.0)?;
    within("cycle.period_s times sample_rate_hz", cycle.period_s * sample_rate_hz, 20.0, 1e7)?;
    within("cycle.tolerance", cycle.tolerance, 0.0, 0.5)?;
    let bins = cycle.period_s * sample_rate_hz / cycle.bin_samples as f64;
    within("cycle.period_s in bins", bins, 4.0, MAX_CYCLE_BINS as f64)?;
    let most = (MAX_ANCHORS - cycle.anchors.len()) as f64;
    within("cycle.further_anchors.length", cycle.further_anchors.len() as f64, 0.0, most)?;
    let further = cycle.further_anchors.iter().enumerate();
    let anchors = cycle.anchors.iter().enumerate().map(|(index, anchor)| ("anchors", index, anchor));
    for (list, index, anchor) in
        anchors.chain(further.map(|(index, anchor)| ("further_anchors", index, anchor)))
    {
        let path = |key: &str| format!("cycle.{list}[{index}].{key}");
        within(&path("end_s"), anchor.end_s, 0.0, 2.0 * cycle.period_s)?;
        within(&path("least_correlation"), anchor.least_correlation, 0.0, 1.0)?;
        within(&path("sure_correlation"), anchor.sure_correlation, anchor.least_correlation, 1.0)?;
        within(&path("least_deviation"), anchor.least_deviation, 0.0, 1.0)?;
        within(&path("wait_s"), anchor.wait_s, 0.0, cycle.period_s)?;
        within(&path("template.length"), anchor.template.len() as f64, 3.0, MAX_TEMPLATE_BINS as f64)?;
        all_finite(&path("template"), anchor.template.iter().map(|value| f64::from(*value)))?;
    }
    if cycle.anchors[1].end_s <= cycle.anchors[0].end_s {
        return Err(ModelError::AnchorOrder {
            first_s: cycle.anchors[0].end_s,
            second_s: cycle.anchors[1].end_s,
        });
    }
    within("cycle.phases.length", cycle.phases.len() as f64, 1.0, MAX_PHASES as f64)?;
    for (index, phase) in cycle.phases.iter().enumerate() {
        within(&format!("cycle.phases[{index}].from_s"), phase.from_s, 0.0, cycle.period_s)?;
        within(&format!("cycle.phases[{index}].to_s"), phase.to_s, phase.from_s, cycle.period_s)?;
        if cycle.phases.iter().take(index).any(|other| other.name == phase.name) {
            let path = format!("cycle.phases[{index}].name");
            return Err(ModelError::RepeatedPhase { path, name: phase.name.clone() });
        }
    }
    if let Some(mark) = &cycle.demand_mark {
        within("cycle.demand_mark.level_m", mark.level_m, -1e6, 1e6)?;
        within("cycle.demand_mark.at_s", mark.at_s, 0.0, cycle.period_s)?;
    }
    Ok(())
}

fn all_finite(path: &str, values: impl Iterator<Item = f64>) -> Result<(), ModelError> {
    for (index, value) in values.enumerate() {
        if !value.is_finite() {
            return Err(ModelError::NotFinite { path: format!("{path}[{index}]"), value });
        }
    }
    Ok(())
}

fn check_projections(file: &ModelFile) -> Result<(), ModelError> {
    within("projections.length", file.projections.len() as f64, 0.0, MAX_FEATURES as f64)?;
    let bins = (file.cycle.period_s * file.sample_rate_hz) as usize / file.cycle.bin_samples;
    for (index, projection) in file.projections.iter().enumerate() {
        for (key, values) in [("mean", &projection.mean), ("loading", &projection.loading)] {
            let path = format!("projections[{index}].{key}");
            check_length(&path, values.len(), bins)?;
            all_finite(&path, values.iter().map(|value| f64::from(*value)))?;
        }
    }
    Ok(())
}

fn check_features(file: &ModelFile) -> Result<(), ModelError> {
    within("features.length", file.features.len() as f64, 1.0, MAX_FEATURES as f64)?;
    for (index, name) in file.features.iter().enumerate() {
        if feature(file, name).is_none() {
            let path = format!("features[{index}]");
            return Err(ModelError::UnknownFeature { path, name: name.clone() });
        }
    }
    Ok(())
}

/// The feature of that name in this model.
pub(crate) fn feature(file: &ModelFile, name: &str) -> Option<Feature> {
    let phases = file.cycle.phases.iter().map(|phase| phase.name.as_str());
    Feature::from_name(name, phases, file.projections.iter().map(|projection| projection.name.as_str()))
}

pub(crate) fn check_tree(tree: &Tree, features: usize, path: &str) -> Result<(), ModelError> {
    let nodes = tree.feature.len();
    check_length(&format!("{path}.value"), tree.value.len(), nodes)?;
    check_length(&format!("{path}.right"), tree.right.len(), nodes)?;
    if nodes == 0 {
        return Err(ModelError::Empty { path: path.into() });
    }
    all_finite(&format!("{path}.value"), tree.value.iter().copied())?;
    preorder(tree, features).map_err(|(column, index, fault)| ModelError::Tree {
        path: format!("{path}.{column}[{index}]"),
        fault,
    })
}

/// Whether the nodes are a tree in preorder; if not, the column and the node that show it.
fn preorder(tree: &Tree, features: usize) -> Result<(), (&'static str, usize, TreeFault)> {
    let nodes = tree.feature.len();
    // In preorder each subtree is one run of nodes: walking along, this holds where the right children
    // still to come must begin. A tree that loops, shares or skips nodes breaks the order.
    let mut expected_right: Vec<(usize, usize)> = Vec::new();
    for (index, (feature, right)) in tree.feature.iter().zip(&tree.right).enumerate() {
        if *feature == -1 {
            if index + 1 == nodes {
                break;
            }
            match expected_right.pop() {
                Some((_, right)) if right == index + 1 => {}
                Some((parent, right)) => {
                    return Err(("right", parent, TreeFault::MisplacedChild { right, expected: index + 1 }));
                }
                None => return Err(("feature", index + 1, TreeFault::Unreachable)),
            }
            continue;
        }
        if usize::try_from(*feature).map_or(true, |feature| feature >= features) {
            return Err(("feature", index, TreeFault::Feature { feature: *feature, features }));
        }
        let right = *right as usize;
        if right <= index + 1 || right >= nodes {
            return Err(("right", index, TreeFault::ChildOutOfRange { right, low: index + 2, nodes }));
        }
        expected_right.push((index, right));
    }
    match (expected_right.last(), tree.feature.last()) {
        (Some((parent, right)), _) => Err(("right", *parent, TreeFault::MissingChild { right: *right })),
        (None, Some(-1)) => Ok(()),
        (None, _) => Err(("feature", nodes - 1, TreeFault::EndsWithoutLeaf)),
    }
}

fn check_calibration(calibration: &Calibration, path: &str) -> Result<(), ModelError> {
    within(&format!("{path}.level"), calibration.level, 0.5, 1.0)?;
    within(&format!("{path}.spread_floor"), calibration.spread_floor, 0.0, 1e3)?;
    within(&format!("{path}.healthy_limit"), calibration.healthy_limit, 0.0, 1.0)?;
    check_factors(&calibration.factors, &format!("{path}.factors"))?;
    let mut before = 0.0;
    for (index, (noise, factors)) in calibration.by_noise.iter().enumerate() {
        check_ascends(&format!("{path}.by_noise[{index}][0]"), before, *noise)?;
        before = *noise;
        check_factors(factors, &format!("{path}.by_noise[{index}][1]"))?;
    }
    Ok(())
}

fn check_factors(factors: &[(f64, f64)], path: &str) -> Result<(), ModelError> {
    if factors.is_empty() {
        return Err(ModelError::Empty { path: path.into() });
    }
    let mut before = f64::NEG_INFINITY;
    for (index, (y, factor)) in factors.iter().enumerate() {
        within(&format!("{path}[{index}][1]"), *factor, 0.0, 1e6)?;
        check_ascends(&format!("{path}[{index}][0]"), before, *y)?;
        before = *y;
    }
    Ok(())
}

fn check_ascends(path: &str, before: f64, value: f64) -> Result<(), ModelError> {
    if value.is_finite() && value > before {
        return Ok(());
    }
    Err(ModelError::NotAscending { path: path.into(), value })
}

pub(crate) fn check_length(path: &str, given: usize, expected: usize) -> Result<(), ModelError> {
    if given == expected {
        return Ok(());
    }
    Err(ModelError::Length { path: path.into(), given, expected })
}

pub(crate) fn has_length(path: &str, values: &[f64], expected: usize) -> Result<(), ModelError> {
    check_length(path, values.len(), expected)?;
    all_finite(path, values.iter().copied())
}

pub(crate) fn check_relative(file: &RelativeFile, phases: usize) -> Result<(), ModelError> {
    has_length("relative.baseline_mean", &file.baseline_mean, phases)?;
    has_length("relative.baseline_scale", &file.baseline_scale, phases)?;
    for (index, scale) in file.baseline_scale.iter().enumerate() {
        within(&format!("relative.baseline_scale[{index}]"), *scale, 1e-9, 1e3)?;
    }
    within("relative.deadband.intercept", file.deadband.intercept, -1.0, 1.0)?;
    has_length("relative.deadband.slopes", &file.deadband.slopes, phases)?;
    within("relative.deadband.limit", file.deadband.limit, 0.0, 1.0)?;
    within("relative.offset_m2", file.offset_m2, 1e-15, 1.0)?;
    for (name, view, knows_load) in [("command", &file.command, false), ("load", &file.load, true)] {
        let path = |key: &str| format!("relative.{name}.{key}");
        has_length(&path("response"), &view.leak_residual, Inputs::terms(phases, knows_load))?;
        for (kind, file) in [("plain", &view.plain), ("deadband", &view.deadband)] {
            check_calibration(&file.calibration, &path(&format!("{kind}.calibration")))?;
            within(&path(&format!("{kind}.reference_m2")), file.reference_m2, 0.0, 1.0)?;
        }
    }
    if file.trees.is_empty() {
        return Err(ModelError::Empty { path: "relative.trees".into() });
    }
    for (index, tree) in file.trees.iter().enumerate() {
        check_tree(tree, Inputs::tree_inputs(phases), &format!("relative.trees[{index}]"))?;
    }
    if file.training_distributions.is_empty() {
        return Err(ModelError::Empty { path: "relative.novelty".into() });
    }
    check_distributions(&file.training_distributions, phases, "relative.novelty")?;
    within("relative.largest_load_change", file.largest_load_change, 1e-6, 1e6)?;
    within("relative.detection.threshold", file.detection.threshold, 1.0, 1e3)?;
    within(
        "relative.detection.cycles_between_false_alarms",
        file.detection.cycles_between_false_alarms,
        1.0,
        f64::MAX,
    )?;
    for (index, area) in file.piston_areas_m2.iter().enumerate() {
        within(&format!("relative.piston_areas_m2[{index}]"), *area, 1e-6, 10.0)?;
    }
    Ok(())
}

fn check_distributions(ranges: &[TrainingDistribution], phases: usize, path: &str) -> Result<(), ModelError> {
    let mut before = f64::NEG_INFINITY;
    for (index, range) in ranges.iter().enumerate() {
        let path = |key: &str| format!("{path}[{index}].{key}");
        check_ascends(&path("from_y"), before, range.from_y)?;
        before = range.from_y;
        has_length(&path("mean"), &range.mean, phases)?;
        has_length(&path("whitening"), &range.whitening, phases * (phases + 1) / 2)?;
        within(&path("limit"), range.limit, 1e-6, 1e9)?;
    }
    Ok(())
}

#!/usr/bin/env python3
"""Turns a bag of regression trees that another tool grew into a model that seepd reads (seepd.model/1).

    import_model.py forest.joblib --base model.json --calibrate cycles.csv --out mine.json

forest.joblib  A fitted scikit-learn BaggingRegressor (of DecisionTreeRegressor), RandomForestRegressor or ExtraTreesRegressor,
               saved by joblib or pickle (which run code as they load: open your own files only), or trees as JSON, as
               docs/models.md describes for MATLAB.
--base         A model of `seepd train` for the machine: duty cycle, filter, projections and orifice come from it.
--features     Names of the trees' inputs in their order; by default the names that the forest was fitted with, else the base's.
--target       What the trees predict: `area` (m²), or `ln` for ln(area + offset) with the base's offset.
--calibrate    CSV with a column for each feature and `leak_area_m2`, of cycles that the trees have not seen: the intervals
               come from their errors.

Inputs are compared in single precision by scikit-learn; the thresholds written take that rounding in, so that seepd gives the
same predictions in double precision.
"""

import argparse
import csv
import json
import math
import struct
import sys

LEVEL = 0.9
LEAST_ROWS = 50
LARGEST_FILE = 16 << 20
GOLDEN = 12


class Refused(Exception):
    """One line for the user."""


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("forest")
    parser.add_argument("--base", required=True)
    parser.add_argument("--features", help="comma-separated")
    parser.add_argument("--target", choices=["area", "ln"], required=True)
    parser.add_argument("--calibrate", required=True)
    parser.add_argument("--out", required=True)
    arguments = parser.parse_args()
    try:
        text = convert(arguments)
        with open(arguments.out, "w", encoding="ascii") as file:
            file.write(text + "\n")
    except (Refused, OSError) as error:
        print(f"import_model.py: {error}", file=sys.stderr)
        return 1
    print(f"{arguments.out}: {len(text)} bytes; check it with: seepd check {arguments.out}")
    return 0


def convert(arguments):
    base = read_base(arguments.base)
    if arguments.forest.endswith(".json"):
        trees, names, maker = read_flat(arguments.forest)
    else:
        trees, names, maker = read_sklearn(arguments.forest)
    if arguments.features:
        names = arguments.features.split(",")
    names = names or base["features"]
    inputs = 1 + max(max(tree["feature"]) for tree in trees)
    if inputs > len(names):
        raise Refused(f"the trees have {inputs} inputs or more, but {len(names)} features are named; name them with --features")
    transform = base["transform"] if arguments.target == "ln" else "identity"
    if arguments.target == "ln" and not isinstance(transform, dict):
        raise Refused("the base model has no logarithm, so that --target ln has no offset")
    rows, areas = read_rows(arguments.calibrate, names)
    votes = [[predict(tree, row) for tree in trees] for row in rows]
    calibration = calibrate(votes, [forward(transform, area) for area in areas])
    golden = []
    for index in range(0, len(rows), max(1, len(rows) // GOLDEN)):
        estimate, interval = evaluate(votes[index], transform, calibration)
        golden.append({"features": rows[index], "estimate": estimate, "interval": interval})
    model = {
        "schema": "seepd.model/1",
        "created_by": maker,
        **{key: base[key] for key in ("sample_rate_hz", "filter", "cycle", "projections")},
        "features": names,
        "target": "leak_area",
        "unit": "m2",
        "transform": transform,
        "trees": trees,
        "calibration": calibration,
        "orifice": base["orifice"],
        "plant_sha256": base["plant_sha256"],
        "golden": golden[:GOLDEN],
    }
    try:
        text = json.dumps(model, separators=(",", ":"), allow_nan=False)
    except ValueError as error:
        raise Refused("the model has a number that is not finite") from error
    if len(text) >= LARGEST_FILE:
        raise Refused(f"the model takes {len(text)} bytes, seepd reads {LARGEST_FILE}; grow fewer trees or larger leaves (min_samples_leaf)")
    return text


def read_base(path):
    with open(path, encoding="utf-8") as file:
        try:
            base = json.load(file)
        except ValueError as error:
            raise Refused(f"{path}: {error}") from error
    if not isinstance(base, dict) or base.get("schema") not in ("seepd.model/1", "seepd.model/2"):
        raise Refused(f"{path}: is no seepd.model/2; make one with `seepd train --out FILE`")
    return base


def read_sklearn(path):
    """The trees of a fitted scikit-learn ensemble: flat arrays, input names if it has them, and what made it."""
    try:
        import joblib
        import sklearn
    except ImportError as error:
        raise Refused(f"reading {path} needs Python with scikit-learn ({error})") from error
    try:
        forest = joblib.load(path)
    except Exception as error:  # unpickling raises whatever it likes
        raise Refused(f"{path}: cannot be loaded: {error}") from error
    kind = type(forest).__name__
    if kind not in ("BaggingRegressor", "RandomForestRegressor", "ExtraTreesRegressor"):
        raise Refused(f"{path}: is a {kind}; BaggingRegressor, RandomForestRegressor and ExtraTreesRegressor are read")
    if not hasattr(forest, "estimators_"):
        raise Refused(f"{path}: the {kind} has not been fitted")
    subsets = getattr(forest, "estimators_features_", [None] * len(forest.estimators_))
    trees = []
    for index, (estimator, subset) in enumerate(zip(forest.estimators_, subsets)):
        grown = getattr(estimator, "tree_", None)
        if grown is None or grown.n_outputs != 1:
            raise Refused(f"{path}: learner {index} is no regression tree with one output")
        column = (lambda j: int(j)) if subset is None else (lambda j, subset=subset: int(subset[j]))
        trees.append(
            preorder(
                f"{path}: tree {index}",
                [column(j) if j >= 0 else -1 for j in grown.feature],
                [int(child) for child in grown.children_left],
                [int(child) for child in grown.children_right],
                [double_threshold(float(t)) for t in grown.threshold],
                [float(v) for v in grown.value[:, 0, 0]],
            )
        )
    names = [str(name) for name in getattr(forest, "feature_names_in_", [])]
    return trees, names, f"import_model.py from scikit-learn {sklearn.__version__}"


def read_flat(path):
    """Trees as JSON: {"rule": "<" or "<=", "trees": [{"feature", "left", "right", "threshold", "value"}]}, counted from 0."""
    with open(path, encoding="utf-8") as file:
        try:
            content = json.load(file)
            rule, flat = content["rule"], content["trees"]
            names = content.get("features") or []
            trees = []
            for index, tree in enumerate(flat):
                thresholds = [below(t) if rule == "<" and t is not None else t for t in tree["threshold"]]
                parts = [tree[key] for key in ("feature", "left", "right")]
                trees.append(preorder(f"{path}: tree {index}", *parts, thresholds, tree["value"]))
        except (ValueError, KeyError, TypeError, IndexError) as error:
            raise Refused(f"{path}: not trees as docs/models.md has them: {error!r}") from error
    if rule not in ("<", "<=") or not trees:
        raise Refused(f'{path}: `rule` must be "<" or "<=", and `trees` must not be empty')
    return trees, names, f"import_model.py from {content.get('made_by', 'flat trees')}"


def preorder(where, feature, left, right, threshold, value):
    """Nodes so that each left child comes next, as seepd.model/1 has them."""
    tree = {"feature": [], "value": [], "right": []}
    todo, seen = [(0, None)], 0
    while todo:
        node, parent = todo.pop()
        seen += 1
        if seen > len(feature):
            raise Refused(f"{where}: its nodes form no tree")
        if parent is not None:
            tree["right"][parent] = len(tree["feature"])
        leaf = feature[node] < 0
        number = value[node] if leaf else threshold[node]
        if number is None or not math.isfinite(number):
            raise Refused(f"{where}: node {node} has {'the prediction' if leaf else 'the threshold'} {number}; it must be a finite number")
        tree["feature"].append(-1 if leaf else feature[node])
        tree["value"].append(number)
        tree["right"].append(0)
        if not leaf:
            todo.append((right[node], len(tree["feature"]) - 1))
            todo.append((left[node], None))
    return tree


def double_threshold(threshold):
    """The largest double x of which single precision is at most the threshold."""
    single = struct.unpack("f", struct.pack("f", threshold))[0]
    if single > threshold:
        single = neighbour(single, -1)
    upper = neighbour(single, 1)
    middle = (single + upper) / 2.0
    # Half way goes to the number whose last bit is 0.
    bits = struct.unpack("I", struct.pack("f", single))[0]
    return middle if bits & 1 == 0 else below(middle)


def neighbour(single, direction):
    """The next single-precision number up (1) or down (-1)."""
    if single == 0.0:
        return direction * struct.unpack("f", struct.pack("I", 1))[0]
    bits = struct.unpack("I", struct.pack("f", single))[0]
    bits += direction if single > 0.0 else -direction
    return struct.unpack("f", struct.pack("I", bits))[0]


def below(number):
    """The next double down."""
    return math.nextafter(number, -math.inf)


def predict(tree, row):
    node = 0
    while tree["feature"][node] >= 0:
        node = node + 1 if row[tree["feature"][node]] <= tree["value"][node] else tree["right"][node]
    return tree["value"][node]


def forward(transform, area):
    return math.log(area + transform["ln_offset"]) if isinstance(transform, dict) else area


def back(transform, value):
    area = math.exp(value) - transform["ln_offset"] if isinstance(transform, dict) else value
    return max(area, 0.0)


def mean_and_spread(votes):
    mean = math.fsum(votes) / len(votes)
    return mean, math.sqrt(math.fsum((vote - mean) ** 2 for vote in votes) / len(votes))


def calibrate(votes, truths):
    """Factors on the trees' spread so that the interval holds LEVEL of the truths, by range of the prediction."""
    floor = 0.005 * (max(truths) - min(truths)) / 5.0
    if floor <= 0.0:
        raise Refused("the calibration's leaks are all the same")
    scores = []
    for vote, truth in zip(votes, truths):
        mean, spread = mean_and_spread(vote)
        scores.append((mean, abs(truth - mean) / (spread + floor)))
    scores.sort()
    ranges = max(1, min(12, len(scores) // LEAST_ROWS))
    size = -(-len(scores) // ranges)
    factors = []
    for start in range(0, len(scores), size):
        part = scores[start : start + size]
        errors = sorted(score for _, score in part)
        rank = min(len(errors), math.ceil((len(errors) + 1) * LEVEL))
        centre = part[len(part) // 2][0]
        if not factors or centre > factors[-1][0]:
            factors.append([centre, errors[rank - 1]])
    return {"level": LEVEL, "spread_floor": floor, "factors": factors}


def evaluate(votes, transform, calibration):
    mean, spread = mean_and_spread(votes)
    half = factor_at(calibration["factors"], mean) * (spread + calibration["spread_floor"])
    return back(transform, mean), [back(transform, mean - half), back(transform, mean + half)]


def factor_at(factors, y):
    before = [pair for pair in factors if pair[0] <= y]
    after = [pair for pair in factors if pair[0] > y]
    if before and after:
        (y_a, a), (y_b, b) = before[-1], after[0]
        return a + (b - a) * (y - y_a) / (y_b - y_a)
    return (before[-1] if before else after[0])[1]


def read_rows(path, names):
    rows, areas = [], []
    with open(path, newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        missing = [name for name in [*names, "leak_area_m2"] if name not in (reader.fieldnames or [])]
        if missing:
            raise Refused(f"{path}: no column {', '.join(missing)}")
        for line in reader:
            try:
                row = [float(line[name]) for name in names]
                area = float(line["leak_area_m2"])
            except (TypeError, ValueError):
                continue
            if all(map(math.isfinite, [*row, area])) and area >= 0.0:
                rows.append(row)
                areas.append(area)
    if len(rows) < LEAST_ROWS:
        raise Refused(f"{path}: {len(rows)} usable rows; {LEAST_ROWS} are needed to calibrate the interval")
    return rows, areas


if __name__ == "__main__":
    sys.exit(main())

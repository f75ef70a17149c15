//! Tree growing against an independent implementation, and what bagging promises.

use seepd_sim::noise::Noise;
use seepd_train::forest::{Forest, ForestParams, Table, grow_single, predict};

/// A smooth function of two of four features, with noise.
fn table(count: usize, seed: u64) -> Table {
    let mut noise = Noise::new(seed, 0);
    let columns: Vec<Vec<f64>> =
        (0..4).map(|_| (0..count).map(|_| noise.uniform(-1.0, 1.0)).collect()).collect();
    let target =
        (0..count).map(|i| (3.0 * columns[0][i]).sin() + columns[2][i] + noise.normal(0.05)).collect();
    Table { columns, target }
}

/// A single tree on all data and features splits where smartcore's CART does: its training error is the same.
/// (Thresholds differ within the gap between two neighbours, so predictions are compared at the data.)
#[test]
fn reference_single_tree_equals_smartcores() {
    use smartcore::linalg::basic::matrix::DenseMatrix;
    use smartcore::tree::decision_tree_regressor::{DecisionTreeRegressor, DecisionTreeRegressorParameters};

    let table = table(400, 5);
    let rows: Vec<Vec<f64>> = (0..table.len()).map(|i| table.row(i)).collect();
    let x = DenseMatrix::from_2d_vec(&rows).unwrap();
    for least_leaf in [1usize, 5, 20] {
        let parameters = DecisionTreeRegressorParameters {
            min_samples_leaf: least_leaf,
            min_samples_split: 2 * least_leaf,
            ..Default::default()
        };
        let theirs = DecisionTreeRegressor::fit(&x, &table.target, parameters).unwrap().predict(&x).unwrap();
        let ours = grow_single(&table, ForestParams { learners: 1, least_leaf, feature_share: 1.0 }, 1);
        let squared = |predicted: &dyn Fn(usize) -> f64| -> f64 {
            (0..table.len()).map(|i| (predicted(i) - table.target[i]).powi(2)).sum::<f64>()
                / table.len() as f64
        };
        let our_error = squared(&|i| predict(&ours, |f| table.columns[f][i]));
        let their_error = squared(&|i| theirs[i]);
        assert!(
            (our_error - their_error).abs() <= 0.02 * their_error + 1e-9,
            "{least_leaf}: {our_error} {their_error}"
        );
    }
}

#[test]
fn property_same_seed_same_trees_other_seed_others() {
    let table = table(300, 6);
    let params = ForestParams { learners: 8, least_leaf: 3, feature_share: 0.5 };
    let (a, b, c) =
        (Forest::grow(&table, params, 1), Forest::grow(&table, params, 1), Forest::grow(&table, params, 2));
    assert_eq!(a.trees, b.trees);
    assert_ne!(a.trees, c.trees);
}

/// The out-of-bag error is an honest forecast: within 25 % of the error on data never seen (400 against 2,000 cases;
/// the sampling error of an RMS of 400 is 1/√800 = 3.5 %), and the forest beats its own trees.
#[test]
fn property_out_of_bag_error_forecasts_the_error_on_new_data() {
    let (seen, new) = (table(400, 7), table(2000, 8));
    let forest = Forest::grow(&seen, ForestParams { learners: 80, least_leaf: 3, feature_share: 0.75 }, 3);
    let rms = |predicted: &dyn Fn(usize) -> f64| -> f64 {
        ((0..new.len()).map(|i| (predicted(i) - new.target[i]).powi(2)).sum::<f64>() / new.len() as f64)
            .sqrt()
    };
    let one = |tree: usize, i: usize| predict(&forest.trees[tree], |f| new.columns[f][i]);
    let all =
        rms(&|i| (0..forest.trees.len()).map(|tree| one(tree, i)).sum::<f64>() / forest.trees.len() as f64);
    let out_of_bag = forest.out_of_bag_rms(&seen.target);
    assert!((out_of_bag / all - 1.0).abs() < 0.25, "{out_of_bag} {all}");
    assert!(all < 0.8 * rms(&|i| one(0, i)));
}

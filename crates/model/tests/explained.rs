//! Contributions and out-of-distribution scores in closed form.

use seepd_model::out_of_distribution::distance;
use seepd_model::schema::{TrainingDistribution, Tree};
use seepd_model::{Attribution, Ensemble, OutOfDistribution};

/// x0 ≤ 0.5: 1, else x1 ≤ 0.5: 2, else 6. The expectations are 3 at the root and 4 on the right.
fn tree() -> Tree {
    Tree { feature: vec![0, -1, 1, -1, -1], value: vec![0.5, 1.0, 0.5, 2.0, 6.0], right: vec![2, 0, 4, 0, 0] }
}

#[test]
fn contributions_are_the_steps_of_the_expectation() {
    let stump = Tree { feature: vec![-1], value: vec![5.0], right: vec![0] };
    let ensemble = Ensemble::new(&[tree(), stump], 3).unwrap();
    let attribution = Attribution::new(&ensemble);
    let mut contributions = [f64::NAN; 3];
    for (features, expected) in [
        ([1.0, 1.0, 9.0], [0.5, 1.0, 0.0]),
        ([1.0, 0.0, 9.0], [0.5, -1.0, 0.0]),
        ([0.0, 1.0, 9.0], [-1.0, 0.0, 0.0]),
    ] {
        let base = attribution.contributions(&ensemble, &features, &mut contributions);
        assert_eq!((base, contributions), (4.0, expected));
        assert_eq!(base + contributions.iter().sum::<f64>(), ensemble.vote(&features).0);
    }
}

#[test]
fn out_of_distribution_score_is_the_whitened_distance_over_the_limit_of_the_estimates_range() {
    // Covariance [[4, 2], [2, 2]] = L Lᵀ with L = [[2, 0], [1, 1]]; its inverse is [[½, 0], [−½, 1]].
    let range = |from_y, limit| TrainingDistribution {
        from_y,
        mean: vec![1.0, 1.0],
        whitening: vec![0.5, -0.5, 1.0],
        limit,
    };
    let ranges = [range(-10.0, 2.0), range(0.0, 4.0)];
    // The difference (2, 3) whitens to (1, 2): √(5/2).
    let expected = 2.5f64.sqrt();
    assert!((distance(&ranges[0], &[3.0, 4.0]) - expected).abs() < 1e-15);
    for (y, limit) in [(-20.0, 2.0), (-0.1, 2.0), (0.0, 4.0), (7.0, 4.0)] {
        let found = OutOfDistribution::of(&ranges, y, &[3.0, 4.0]);
        assert!((found.score - expected / limit).abs() < 1e-15 && found.most_unusual == 1, "{found:?}");
    }
    assert_eq!(OutOfDistribution::of(&[], 0.0, &[3.0, 4.0]).score, 0.0);
    assert_eq!(OutOfDistribution::of(&ranges, 0.0, &[]).score, 0.0);
}

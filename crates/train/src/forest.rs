//! Bagged regression trees: Breiman, "Bagging predictors", Machine Learning 24 (1996), with his later random
//! choice of features at each split ("Random forests", 2001).
//!
//! Trees are grown here because the search wants a thousand of them in seconds, out-of-bag predictions with their
//! spread, thresholds that differ between trees (for a smooth mean), and the trees' nodes for export.

use rayon::prelude::*;
use seepd_model::schema::Tree;
use seepd_sim::noise::Noise;

/// Features by column, and the target.
#[derive(Debug, Clone)]
pub struct Table {
    /// `columns[feature][observation]`.
    pub columns: Vec<Vec<f64>>,
    /// Target of each observation.
    pub target: Vec<f64>,
}

impl Table {
    /// Number of observations.
    pub fn len(&self) -> usize {
        self.target.len()
    }

    /// Whether there is no observation.
    pub fn is_empty(&self) -> bool {
        self.target.is_empty()
    }

    /// The features of an observation.
    ///
    /// # Panics
    /// Where `index` is not below [`Table::len`].
    pub fn row(&self, index: usize) -> Vec<f64> {
        self.columns.iter().map(|column| column[index]).collect()
    }
}

/// Hyperparameters of a forest, which the search may choose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ForestParams {
    /// Trees.
    pub learners: usize,
    /// Least observations in a leaf.
    pub least_leaf: usize,
    /// Share of the features that each split may choose from.
    pub feature_share: f64,
}

/// A grown forest with what its trees say of observations that they have not seen.
#[derive(Debug, Clone)]
pub struct Forest {
    /// The trees.
    pub trees: Vec<Tree>,
    /// Out-of-bag mean and standard deviation over trees, by observation; `None` where every tree saw it.
    pub out_of_bag: Vec<Option<(f64, f64)>>,
}

impl Forest {
    /// Grows a forest; the same seed gives the same trees.
    ///
    /// # Panics
    /// Where the table has observations and no features.
    pub fn grow(table: &Table, params: ForestParams, seed: u64) -> Forest {
        let order = Presorted::of(table);
        let grown: Vec<(Tree, Vec<f64>)> = (0..params.learners)
            .into_par_iter()
            .map(|index| {
                let mut noise = Noise::new(seed, index as u64);
                let weights = bootstrap(table.len(), &mut noise);
                let tree = Grower { table, params, noise }.grow(&order, &weights);
                let unseen = (0..table.len())
                    .map(|i| if weights[i] == 0 { predict(&tree, |f| table.columns[f][i]) } else { f64::NAN })
                    .collect();
                (tree, unseen)
            })
            .collect();
        let out_of_bag = (0..table.len())
            .map(|i| {
                let votes: Vec<f64> =
                    grown.iter().map(|(_, unseen)| unseen[i]).filter(|vote| !vote.is_nan()).collect();
                if votes.is_empty() {
                    return None;
                }
                let mean = votes.iter().sum::<f64>() / votes.len() as f64;
                let variance =
                    votes.iter().map(|vote| (vote - mean).powi(2)).sum::<f64>() / votes.len() as f64;
                Some((mean, variance.sqrt()))
            })
            .collect();
        Forest { trees: grown.into_iter().map(|(tree, _)| tree).collect(), out_of_bag }
    }

    /// Nodes of all trees.
    pub fn nodes(&self) -> usize {
        self.trees.iter().map(|tree| tree.feature.len()).sum()
    }

    /// Root mean square of the out-of-bag errors.
    pub fn out_of_bag_rms(&self, target: &[f64]) -> f64 {
        let (mut sum, mut count) = (0.0, 0.0);
        for (vote, truth) in self.out_of_bag.iter().zip(target) {
            if let Some((mean, _)) = vote {
                sum += (mean - truth).powi(2);
                count += 1.0;
            }
        }
        if count > 0.0 { (sum / count).sqrt() } else { f64::INFINITY }
    }
}

/// One tree on all observations, each once.
///
/// # Panics
/// As [`Forest::grow`].
pub fn grow_single(table: &Table, params: ForestParams, seed: u64) -> Tree {
    let noise = Noise::new(seed, 0);
    Grower { table, params, noise }.grow(&Presorted::of(table), &vec![1; table.len()])
}

/// The value of the leaf that an observation falls into, in the target's unit; `feature` gives a feature by its index.
///
/// # Panics
/// Where the nodes are no tree in preorder: [`Ensemble::new`](seepd_model::Ensemble::new) checks that.
pub fn predict(tree: &Tree, feature: impl Fn(usize) -> f64) -> f64 {
    let mut node = 0;
    while tree.feature[node] >= 0 {
        let left = feature(tree.feature[node] as usize) <= tree.value[node];
        node = if left { node + 1 } else { tree.right[node] as usize };
    }
    tree.value[node]
}

/// How often each observation is drawn.
fn bootstrap(count: usize, noise: &mut Noise) -> Vec<u32> {
    let mut weights = vec![0; count];
    for _ in 0..count {
        let drawn = (noise.uniform(0.0, 1.0) * count as f64) as usize;
        weights[drawn.min(count - 1)] += 1;
    }
    weights
}

/// Observations by ascending value, for each feature.
struct Presorted(Vec<Vec<u32>>);

impl Presorted {
    fn of(table: &Table) -> Self {
        Presorted(
            table
                .columns
                .par_iter()
                .map(|column| {
                    let mut order: Vec<u32> = (0..column.len() as u32).collect();
                    order.sort_by(|a, b| column[*a as usize].total_cmp(&column[*b as usize]));
                    order
                })
                .collect(),
        )
    }
}

struct Grower<'t> {
    table: &'t Table,
    params: ForestParams,
    noise: Noise,
}

struct Split {
    feature: usize,
    threshold: f64,
    gain: f64,
}

impl Grower<'_> {
    fn grow(mut self, order: &Presorted, weights: &[u32]) -> Tree {
        let mut orders: Vec<Vec<u32>> = order
            .0
            .iter()
            .map(|order| order.iter().copied().filter(|i| weights[*i as usize] > 0).collect())
            .collect();
        let mut tree = Tree { feature: Vec::new(), value: Vec::new(), right: Vec::new() };
        let all = 0..orders.first().map_or(0, Vec::len);
        let mut scratch = vec![0; all.len()];
        self.node(&mut tree, &mut orders, &mut scratch, weights, all);
        tree
    }

    fn node(
        &mut self,
        tree: &mut Tree,
        orders: &mut [Vec<u32>],
        scratch: &mut [u32],
        weights: &[u32],
        range: std::ops::Range<usize>,
    ) {
        let index = tree.feature.len();
        let members = &orders[0][range.clone()];
        let (mut weight, mut sum) = (0.0, 0.0);
        for i in members {
            let w = f64::from(weights[*i as usize]);
            weight += w;
            sum += w * self.table.target[*i as usize];
        }
        let mean = sum / weight;
        let splittable = weight >= 2.0 * self.params.least_leaf as f64 && members.len() > 1;
        let split = if splittable { self.best_split(orders, weights, &range, weight, mean) } else { None };
        let Some(split) = split else {
            tree.feature.push(-1);
            tree.value.push(round_leaf(mean));
            tree.right.push(0);
            return;
        };
        tree.feature.push(split.feature as i32);
        tree.value.push(split.threshold);
        tree.right.push(0);
        let column = &self.table.columns[split.feature];
        let mut middle = range.start;
        for order in orders.iter_mut() {
            middle = partition(&mut order[range.clone()], scratch, |i| column[i as usize] <= split.threshold)
                + range.start;
        }
        self.node(tree, orders, scratch, weights, range.start..middle);
        tree.right[index] = tree.feature.len() as u32;
        self.node(tree, orders, scratch, weights, middle..range.end);
    }

    /// The split of largest reduction of the squared error among a random choice of features.
    fn best_split(
        &mut self,
        orders: &[Vec<u32>],
        weights: &[u32],
        range: &std::ops::Range<usize>,
        weight: f64,
        mean: f64,
    ) -> Option<Split> {
        let features = self.table.columns.len();
        let wanted = ((self.params.feature_share * features as f64).round() as usize).clamp(1, features);
        let mut candidates: Vec<usize> = (0..features).collect();
        let mut best: Option<Split> = None;
        for tried in 0..wanted {
            let pick = tried + (self.noise.uniform(0.0, 1.0) * (features - tried) as f64) as usize;
            candidates.swap(tried, pick.min(features - 1));
            let feature = candidates[tried];
            let place = self.noise.uniform(0.0, 1.0);
            let found = self.split_on(feature, &orders[feature][range.clone()], weights, weight, mean, place);
            if let Some(found) = found
                && best.as_ref().is_none_or(|best| found.gain > best.gain)
            {
                best = Some(found);
            }
        }
        best
    }

    fn split_on(
        &self,
        feature: usize,
        order: &[u32],
        weights: &[u32],
        weight: f64,
        mean: f64,
        place: f64,
    ) -> Option<Split> {
        let column = &self.table.columns[feature];
        let least = self.params.least_leaf as f64;
        let (mut left_weight, mut left_sum) = (0.0, 0.0);
        let mut best = (1e-12 * weight, None);
        for pair in order.windows(2) {
            let (i, next) = (pair[0] as usize, pair[1] as usize);
            let w = f64::from(weights[i]);
            left_weight += w;
            left_sum += w * (self.table.target[i] - mean);
            if left_weight < least || column[i] == column[next] {
                continue;
            }
            let right_weight = weight - left_weight;
            if right_weight < least {
                break;
            }
            // Around the mean the two sums are opposite: SSE falls by s² (1/n_l + 1/n_r).
            let gain = left_sum * left_sum * (1.0 / left_weight + 1.0 / right_weight);
            if gain > best.0 {
                best = (gain, Some((column[i], column[next])));
            }
        }
        let (low, high) = best.1?;
        // Anywhere between the two neighbours is as good; a random place makes the trees' mean smooth.
        let threshold = round_threshold(low + place * (high - low), low, high);
        Some(Split { feature, threshold, gain: best.0 })
    }
}

/// Stable partition; returns how many satisfy the condition.
fn partition(order: &mut [u32], scratch: &mut [u32], condition: impl Fn(u32) -> bool) -> usize {
    let (mut left, mut right) = (0, 0);
    for at in 0..order.len() {
        let i = order[at];
        if condition(i) {
            order[left] = i;
            left += 1;
        } else {
            scratch[right] = i;
            right += 1;
        }
    }
    order[left..].copy_from_slice(&scratch[..right]);
    left
}

/// The shortest decimal number in `low ≤ x < high` near `value`, with at least five digits: keeps the file small.
fn round_threshold(value: f64, low: f64, high: f64) -> f64 {
    for digits in 4..17 {
        let rounded: f64 = format!("{value:.digits$e}").parse().unwrap_or(value);
        if rounded >= low && rounded < high {
            return rounded;
        }
    }
    low
}

/// A leaf's value to five decimals: 1e-5 in the logarithm of the area is a thousandth of a percent.
fn round_leaf(value: f64) -> f64 {
    (value * 1e5).round() / 1e5
}

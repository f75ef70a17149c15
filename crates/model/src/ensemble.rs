//! Evaluation of the trees.

use alloc::format;
use alloc::vec::Vec;

use crate::check::check_tree;
use crate::error::ModelError;
use crate::schema::{Calibration, Transform, Tree};

/// A node in 16 bytes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Node {
    /// Threshold, or a leaf's prediction.
    value: f64,
    /// Index of the right child in the ensemble's nodes; of itself for a leaf.
    right: u32,
    /// Index of the left child less that of the node: 1, and 0 for a leaf.
    left_step: u16,
    /// Index of the feature; 0 for a leaf.
    feature: u16,
}

impl Node {
    /// Threshold, or a leaf's prediction.
    pub(crate) fn value(&self) -> f64 {
        self.value
    }

    /// Index of the feature that an inner node asks by.
    pub(crate) fn feature(&self) -> usize {
        usize::from(self.feature)
    }

    /// Left and right child of the node at that index; itself for a leaf.
    pub(crate) fn children(&self, at: u32) -> [u32; 2] {
        [at + u32::from(self.left_step), self.right]
    }
}

/// Regression trees whose mean is the prediction.
#[derive(Debug, Clone)]
pub struct Ensemble {
    nodes: Vec<Node>,
    /// Root and depth of each tree.
    roots: Vec<(u32, u32)>,
}

/// An estimate of the target, in its unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// The mean of the trees, transformed back.
    pub value: f64,
    /// Standard deviation over the trees, in the transformed target.
    pub spread: f64,
    /// Interval that holds the truth at the calibration's level; its lower end is at least 0.
    pub interval: [f64; 2],
    /// The mean of the trees, in the transformed target.
    pub transformed: f64,
}

/// Trees that are walked side by side, so that their memory accesses overlap.
const ABREAST: usize = 8;

impl Ensemble {
    /// An ensemble of trees over so many features.
    ///
    /// ```
    /// use seepd_model::schema::Tree;
    /// use seepd_model::{Ensemble, ModelError};
    ///
    /// // x ≤ 0.5: 1, else 3; and a constant.
    /// let stump = Tree { feature: vec![0, -1, -1], value: vec![0.5, 1.0, 3.0], right: vec![2, 0, 0] };
    /// let constant = Tree { feature: vec![-1], value: vec![2.0], right: vec![0] };
    /// let ensemble = Ensemble::new(&[stump, constant], 1)?;
    /// // Mean and standard deviation of 3 and 2.
    /// assert_eq!(ensemble.vote(&[0.7]), (2.5, 0.5));
    /// # Ok::<(), ModelError>(())
    /// ```
    ///
    ///
    /// # Errors
    /// [`ModelError`] for a list of nodes that is no tree in preorder; no trees at all are an [`ModelError::Empty`].
    pub fn new(trees: &[Tree], features: usize) -> Result<Self, ModelError> {
        if trees.is_empty() {
            return Err(ModelError::Empty { path: "trees".into() });
        }
        for (index, tree) in trees.iter().enumerate() {
            check_tree(tree, features, &format!("trees[{index}]"))?;
        }
        Ok(Self::from_checked(trees))
    }

    /// The same of trees that have been checked.
    pub(crate) fn from_checked(trees: &[Tree]) -> Self {
        let mut nodes = Vec::with_capacity(trees.iter().map(|tree| tree.feature.len()).sum());
        let mut roots = Vec::with_capacity(trees.len());
        for tree in trees {
            let root = nodes.len() as u32;
            let mut depth = alloc::vec![0u32; tree.feature.len()];
            for (index, ((feature, value), right)) in
                tree.feature.iter().zip(&tree.value).zip(&tree.right).enumerate()
            {
                let is_leaf = *feature < 0;
                if !is_leaf {
                    for child in [index + 1, *right as usize] {
                        depth[child] = depth[index] + 1;
                    }
                }
                nodes.push(Node {
                    value: *value,
                    right: root + if is_leaf { index as u32 } else { *right },
                    left_step: u16::from(!is_leaf),
                    feature: u16::try_from(*feature).unwrap_or(0),
                });
            }
            roots.push((root, depth.iter().copied().max().unwrap_or(0)));
        }
        Ensemble { nodes, roots }
    }

    /// Number of trees.
    pub fn trees(&self) -> usize {
        self.roots.len()
    }

    /// Number of nodes of all trees.
    pub fn nodes(&self) -> usize {
        self.nodes.len()
    }

    /// Mean and standard deviation over the trees' predictions, in the transformed target; a feature that is missing counts as 0.
    pub fn vote(&self, features: &[f64]) -> (f64, f64) {
        let (mut sum, mut squares) = (0.0, 0.0);
        let mut pivot = None;
        for trees in self.roots.chunks(ABREAST) {
            let mut at = [0u32; ABREAST];
            let mut depth = 0;
            for (at, (root, tree_depth)) in at.iter_mut().zip(trees) {
                *at = *root;
                depth = depth.max(*tree_depth);
            }
            // A leaf leads to itself, so that every tree takes the deepest one's number of steps and no step
            // is a guess for the processor.
            for _ in 0..depth {
                for at in at.iter_mut().take(trees.len()) {
                    *at = self.step(*at, features);
                }
            }
            for at in at.iter().take(trees.len()) {
                let value = self.nodes.get(*at as usize).map_or(0.0, |node| node.value);
                let off = value - *pivot.get_or_insert(value);
                sum += off;
                squares += off * off;
            }
        }
        let n = self.roots.len() as f64;
        let mean = sum / n;
        let variance = (squares / n - mean * mean).max(0.0);
        (pivot.unwrap_or(0.0) + mean, libm::sqrt(variance))
    }

    pub(crate) fn node(&self, at: u32) -> Option<&Node> {
        self.nodes.get(at as usize)
    }

    /// Index of each tree's root.
    pub(crate) fn roots(&self) -> impl Iterator<Item = u32> {
        self.roots.iter().map(|(root, _)| *root)
    }

    /// The child that the features lead to; a leaf's own index.
    #[inline(always)]
    pub(crate) fn step(&self, at: u32, features: &[f64]) -> u32 {
        let Some(node) = self.node(at) else { return at };
        let feature = features.get(node.feature()).copied().unwrap_or(0.0);
        let [left, right] = node.children(at);
        if feature <= node.value { left } else { right }
    }
}

impl Estimate {
    /// The estimate for a transformed prediction and its spread over the trees.
    pub fn around(
        transformed: f64,
        spread: f64,
        noise: Option<f64>,
        transform: Transform,
        calibration: &Calibration,
    ) -> Self {
        let half = calibration.factor(transformed, noise) * (spread + calibration.spread_floor);
        let back = |y: f64| transform.back(y).max(0.0);
        let value = back(transformed);
        let lower = if value <= calibration.healthy_limit { 0.0 } else { back(transformed - half) };
        Estimate { value, spread, interval: [lower, back(transformed + half)], transformed }
    }
}

impl Calibration {
    /// What the spread is multiplied with.
    fn factor(&self, transformed: f64, noise: Option<f64>) -> f64 {
        let Some(noise) = noise.filter(|_| !self.by_noise.is_empty()) else {
            return linear(&self.factors, transformed);
        };
        let after = self.by_noise.partition_point(|(level, _)| *level <= noise);
        let at = |index: usize| {
            self.by_noise.get(index).map(|(level, factors)| (libm::log(*level), linear(factors, transformed)))
        };
        between(after.checked_sub(1).and_then(at), at(after), libm::log(noise))
    }
}

/// Linear between points that ascend in x, constant beyond them.
fn linear(points: &[(f64, f64)], x: f64) -> f64 {
    let after = points.partition_point(|(at, _)| *at <= x);
    between(
        after.checked_sub(1).and_then(|before| points.get(before)).copied(),
        points.get(after).copied(),
        x,
    )
}

fn between(before: Option<(f64, f64)>, after: Option<(f64, f64)>, x: f64) -> f64 {
    match (before, after) {
        (Some((x_a, a)), Some((x_b, b))) => a + (b - a) * (x - x_a) / (x_b - x_a),
        (Some((_, only)), None) | (None, Some((_, only))) => only,
        (None, None) => 0.0,
    }
}

impl Transform {
    /// From the target to what the trees predict.
    pub fn forward(self, target: f64) -> f64 {
        match self {
            Transform::Identity => target,
            Transform::LnOffset(offset) => libm::log(target + offset),
        }
    }

    /// From what the trees predict to the target.
    pub fn back(self, transformed: f64) -> f64 {
        match self {
            Transform::Identity => transformed,
            Transform::LnOffset(offset) => libm::exp(transformed) - offset,
        }
    }
}

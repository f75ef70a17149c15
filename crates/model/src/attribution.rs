//! Which features an estimate comes from.
//!
//! On its way from root to leaf a tree's expectation changes at each node, and the change is the feature's by which the node asks (Saabas's
//! path attribution). A node's expectation is the mean of its leaves: they were grown to about the same number of observations each.

use alloc::vec::Vec;

use crate::ensemble::Ensemble;

/// The expectation at each node of an ensemble.
#[derive(Debug, Clone)]
pub struct Attribution {
    expectations: Vec<f32>,
}

impl Attribution {
    /// Of an ensemble's nodes.
    pub fn new(ensemble: &Ensemble) -> Self {
        let count = ensemble.nodes();
        let mut leaves = alloc::vec![1u32; count];
        let mut expectations = alloc::vec![0.0f32; count];
        // Children follow their parents, so that they are known when these are reached from the end.
        for at in (0..count).rev() {
            let Some(node) = ensemble.node(at as u32) else { continue };
            let [left, right] = node.children(at as u32).map(|child| child as usize);
            if left == at {
                expectations[at] = node.value() as f32;
                continue;
            }
            let (a, b) = (f64::from(leaves[left]), f64::from(leaves[right]));
            let mean = (a * f64::from(expectations[left]) + b * f64::from(expectations[right])) / (a + b);
            leaves[at] = leaves[left] + leaves[right];
            expectations[at] = mean as f32;
        }
        Attribution { expectations }
    }

    /// Writes what each feature contributes to the transformed estimate, in the model's order, and gives the expectation that they
    /// are added to: their sum is the estimate, to single precision.
    pub fn contributions(&self, ensemble: &Ensemble, features: &[f64], contributions: &mut [f64]) -> f64 {
        contributions.fill(0.0);
        let trees = ensemble.trees().max(1) as f64;
        let mut base = 0.0;
        for root in ensemble.roots() {
            let mut at = root;
            let mut expectation = self.at(at);
            base += expectation / trees;
            while let Some(node) = ensemble.node(at).filter(|node| node.children(at)[0] != at) {
                at = ensemble.step(at, features);
                let now = self.at(at);
                if let Some(slot) = contributions.get_mut(node.feature()) {
                    *slot += (now - expectation) / trees;
                }
                expectation = now;
            }
        }
        base
    }

    fn at(&self, node: u32) -> f64 {
        self.expectations.get(node as usize).copied().map_or(0.0, f64::from)
    }
}

//! Hyperparameters by Bayesian optimisation: a tree-structured Parzen estimator proposes, out-of-bag error judges,
//! the file's size limits. Bergstra et al., "Algorithms for hyper-parameter optimization", NIPS 2011.

use optimizer::parameter::{FloatParam, IntParam, Parameter};
use optimizer::sampler::TpeSampler;
use optimizer::{Direction, Study};

use crate::forest::{Forest, ForestParams, Table};
use crate::train::TrainError;

/// The best forest that a search found.
#[derive(Debug, Clone, PartialEq)]
pub struct BestForest {
    /// Its hyperparameters.
    pub params: ForestParams,
    /// Its out-of-bag RMS error in the transformed target.
    pub out_of_bag_rms: f64,
    /// Trials of the search.
    pub trials: usize,
}

/// Searches for the parameters of least out-of-bag error among forests of at most `most_nodes` nodes. `tell` hears of
/// each finished trial.
///
/// # Errors
/// [`TrainError::NoForest`] where no trial was admissible, [`TrainError::Search`] where the search itself failed.
pub(crate) fn search(
    table: &Table,
    most_nodes: usize,
    trials: usize,
    seed: u64,
    tell: &mut dyn FnMut(usize, usize),
) -> Result<BestForest, TrainError> {
    let failed = |error: optimizer::Error| TrainError::Search(error.into());
    let study: Study<f64> =
        Study::with_sampler(Direction::Minimize, TpeSampler::builder().seed(seed).build().map_err(failed)?);
    let learners = IntParam::new(20, 120).name("learners");
    let least_leaf = IntParam::new(1, 24).name("least_leaf");
    let feature_share = FloatParam::new(0.15, 1.0).name("feature_share");
    let mut best: Option<BestForest> = None;
    for trial_number in 0..trials {
        let mut trial = study.ask();
        let params = ForestParams {
            learners: learners.suggest(&mut trial).map_err(failed)? as usize,
            least_leaf: least_leaf.suggest(&mut trial).map_err(failed)? as usize,
            feature_share: feature_share.suggest(&mut trial).map_err(failed)?,
        };
        let rms = admissible_rms(table, params, most_nodes, seed);
        study.tell(trial, Ok::<f64, String>(rms));
        if rms < INADMISSIBLE && best.as_ref().is_none_or(|best| rms < best.out_of_bag_rms) {
            best = Some(BestForest { params, out_of_bag_rms: rms, trials });
        }
        tell(trial_number + 1, trials);
    }
    best.ok_or(TrainError::NoForest { most_nodes })
}

/// What an inadmissible choice costs, plus its excess: worse than any admissible one, and with a slope.
const INADMISSIBLE: f64 = 1e3;

fn admissible_rms(table: &Table, params: ForestParams, most_nodes: usize, seed: u64) -> f64 {
    // A few trees tell the size of all.
    let probe = Forest::grow(table, ForestParams { learners: 2, ..params }, seed);
    let nodes = probe.nodes() as f64 / 2.0 * params.learners as f64;
    if nodes > most_nodes as f64 {
        return INADMISSIBLE * nodes / most_nodes as f64;
    }
    Forest::grow(table, params, seed).out_of_bag_rms(&table.target)
}

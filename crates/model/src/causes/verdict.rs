//! From likelihoods to a verdict: posterior probabilities of causes, with sizes, and what the other cause does to the phases' means.

use super::fit::{AnyLeak, Fit, Whitened};
use super::linear::applied;
use super::sizes::Cut;
use super::{
    Cause, Causes, Cell, Change, Kind, MAX_CELLS, MAX_KINDS, MAX_NUMBERS, PRIOR_NONE, Side, SizeUnit,
};

/// Least probability of a cause that is named.
pub(super) const NAMED_FROM: f64 = 0.65;
/// Cells of other causes that are tried beside each cell of the seal.
const TRIED_BESIDE: usize = 8;
/// Standard deviations on either side of an interval of 90 %.
const Z_90: f64 = 1.645;
/// Hypotheses less likely than the best by this factor's logarithm say nothing.
const NEGLIGIBLE: f64 = -12.0;
/// Numbers of a change of up to eight phases, which is most machines': two a phase.
const USUAL_NUMBERS: usize = 16;
/// Logarithm of the weight over the best from which on a cause is tried beside leaks: that of the pair is about what it has whatever the
/// seal does.
const WORTH_TRYING: f64 = -9.0;
/// Most pairs that count.
const MAX_PAIRS: usize = 64;
/// Share of a change's squared distance below which a cause has left next to nothing of it.
const LEFT_BY_A_CAUSE: f64 = 0.02;

/// A possible cause of a change.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate {
    /// The cause.
    pub kind: Kind,
    /// Probability that it has changed, alone or beside another.
    pub probability: f64,
    /// Its size, in the kind's unit.
    pub size: f64,
    /// Interval that holds the size nine times in ten, where this is the cause.
    pub interval90: [f64; 2],
}

/// What a change is taken for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ChangeVerdict {
    /// Nothing has changed.
    Nothing,
    /// A cause, and the second of a pair; a leak comes first.
    Named(Cause, Option<Cause>),
    /// More than one cause would do.
    CannotTell,
    /// None of those that are known.
    Unknown,
}

/// What a leak is where it follows a law other than an orifice's that the model's estimates have not learned, or its plant does not tell.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct OtherLaw {
    /// Probability that it does, given that the seal has changed.
    pub probability: f64,
    /// Its size then, m².
    pub size: f64,
    /// Standard deviation of that.
    pub deviation: f64,
}

/// What explains a change.
#[derive(Debug, Clone, Copy)]
pub struct Explanation {
    /// The verdict.
    pub verdict: ChangeVerdict,
    /// Probability that nothing has changed.
    pub none: f64,
    /// Probability that the seal has, alone or beside another cause.
    pub seal: f64,
    /// Probability of the verdict: of the first cause where one is named.
    pub probability: f64,
    /// Squared distance of the nearest hypothesis over the number of coordinates.
    pub distance: f64,
    /// The leak under laws other than an orifice's that the model's estimates have not learned, or its plant does not tell.
    pub leak_of_other_law: OtherLaw,
    /// The cause other than the seal in the most likely explanation, and whether the seal is in it too.
    pub other: Option<(Kind, bool)>,
    /// What that cause does to each phase's mean command, in the phases' order.
    pub response: [f64; MAX_NUMBERS],
    candidates: [Candidate; MAX_KINDS],
    count: usize,
}

impl Explanation {
    /// The causes, most probable first.
    pub fn candidates(&self) -> &[Candidate] {
        self.candidates.get(..self.count).unwrap_or_default()
    }

    /// Probability of an explanation without the seal.
    pub fn without_seal(&self) -> f64 {
        (1.0 - self.seal).max(0.0)
    }

    /// The candidate of a cause.
    pub fn candidate(&self, cause: Cause) -> Option<&Candidate> {
        self.candidates().iter().find(|candidate| candidate.kind.cause == cause)
    }
}

/// A hypothesis with its weight: the cells by number.
#[derive(Debug, Clone, Copy)]
struct Pair {
    seal: usize,
    other: usize,
    log_weight: f64,
}

/// Cells of other causes that do best whatever the seal does: logarithm of the weight and index, the best first.
struct Tried([(f64, usize); TRIED_BESIDE]);

impl Tried {
    const NONE: Self = Tried([(f64::NEG_INFINITY, 0); TRIED_BESIDE]);

    fn take(&mut self, index: usize, weight: f64) {
        if weight > self.0[TRIED_BESIDE - 1].0 {
            let at = self.0.partition_point(|(other, _)| *other >= weight);
            self.0[at..].rotate_right(1);
            self.0[at] = (weight, index);
        }
    }
}

/// Sums over the hypotheses with a kind.
#[derive(Debug, Clone, Copy, Default)]
struct Tally {
    weight: f64,
    /// Of which alone.
    alone: f64,
    size: f64,
    square: f64,
}

impl Tally {
    fn add(&mut self, weight: f64, Cut { mean, variance, .. }: Cut) {
        self.weight += weight;
        self.size += weight * mean;
        self.square += weight * (variance + mean * mean);
    }

    /// As a law of leaks that have some probability in all.
    fn of_leaks(&self, probability: f64) -> OtherLaw {
        if self.weight <= 0.0 {
            return OtherLaw::default();
        }
        let size = self.size / self.weight;
        let deviation = libm::sqrt((self.square / self.weight - size * size).max(0.0));
        OtherLaw { probability: (self.weight / probability).min(1.0), size, deviation }
    }
}

/// Every hypothesis with its weight, relative to the best.
struct Weighed<'c, const N: usize> {
    causes: &'c Causes,
    whitened: Whitened<N>,
    none: f64,
    alone: [f64; MAX_CELLS],
    pairs: [Pair; MAX_PAIRS],
    pair_count: usize,
    distance: f64,
    distance_of_nothing: f64,
}

impl Causes {
    /// Explains a change by none, one or two of the causes.
    ///
    /// ```no_run
    /// # use seepd_model::{Model, causes::{Change, ChangeVerdict}};
    /// # fn told(model: &Model, baseline: &[f64], now: &[f64]) -> Option<ChangeVerdict> {
    /// let numbers: Vec<f64> = now.iter().zip(baseline).map(|(now, before)| now - before).collect();
    /// let explanation = model.causes()?.explain(&Change { numbers: &numbers, noise: 0.001 });
    /// # Some(explanation.verdict)
    /// # }
    /// ```
    pub fn explain(&self, change: &Change<'_>) -> Explanation {
        if self.numbers() <= USUAL_NUMBERS {
            return Weighed::<USUAL_NUMBERS>::of(self, self.whitened(change)).explanation();
        }
        Weighed::<MAX_NUMBERS>::of(self, self.whitened(change)).explanation()
    }
}

impl Causes {
    /// Logarithm of what a leak of a size has beforehand beside another cause.
    fn leak_prior(&self) -> f64 {
        self.leaks.first().map_or(f64::NEG_INFINITY, |leak| self.priors[*leak][1])
    }

    /// Whether a cell's response adds to that of a leak. Under a dead band a leak answers in another way, and a valve of another shape
    /// would pass for both.
    fn adds_to_a_leak(&self, cell: &Cell) -> bool {
        if cell.is_alike {
            return false;
        }
        let cause = self.kinds.get(cell.kind).map(|kind| kind.cause);
        !matches!(cause, None | Some(Cause::PistonSeal | Cause::ValveDeadBand))
    }
}

/// Logarithm of a hypothesis's weight; its sizes are looked at where it may have any beside the best.
fn weight(log_prior: f64, fit: &Fit, cells: &[&Cell], best: f64) -> f64 {
    let most = log_prior + fit.log_likelihood;
    if most < best + NEGLIGIBLE { most } else { log_prior + fit.log_likelihood_of_simulated_sizes(cells) }
}

impl<'c, const N: usize> Weighed<'c, N> {
    fn of(causes: &'c Causes, whitened: Whitened<N>) -> Self {
        let nothing = causes.fit(&whitened, &[]);
        let mut weighed = Weighed {
            causes,
            whitened,
            none: libm::log(PRIOR_NONE) + nothing.log_likelihood,
            alone: [f64::NEG_INFINITY; MAX_CELLS],
            pairs: [Pair { seal: 0, other: 0, log_weight: f64::NEG_INFINITY }; MAX_PAIRS],
            pair_count: 0,
            distance: nothing.distance,
            distance_of_nothing: nothing.distance,
        };
        let mut best = weighed.none;
        let mut tried = Tried::NONE;
        let leak = weighed.any_leak();
        let (of_leak, shared) = (causes.leak_prior(), causes.shares_by_priors());
        let is_even = causes.file.errors_are_even;
        for (index, (cell, [prior, beside])) in causes.cells.iter().zip(&causes.priors).enumerate() {
            let laid = (!is_even).then(|| causes.lay(&weighed.whitened, &[cell]));
            let count = weighed.whitened.count;
            // What is shared by priors counts whatever it has.
            let least = if shared { f64::NEG_INFINITY } else { best + NEGLIGIBLE - prior };
            let fit = match &laid {
                Some(laid) => laid.moments.fit_from(count, least),
                None => causes.fit_evenly_from(&weighed.whitened, &[cell], least),
            };
            if let Some(fit) = fit {
                let weight = weight(*prior, &fit, &[cell], best);
                weighed.alone[index] = weight;
                weighed.note(&mut best, weight, &fit);
            }
            if let Some(leak) = leak.as_ref().filter(|_| causes.adds_to_a_leak(cell)) {
                let least = best + WORTH_TRYING - of_leak - beside;
                let fit = match &laid {
                    Some(laid) => leak.moments_beside(laid, cell, count).fit_from(count, least),
                    None => causes.fit_evenly_beside(&weighed.whitened, cell, leak, least),
                };
                if let Some(fit) = fit {
                    tried.take(index, beside + fit.log_likelihood);
                }
            }
        }
        weighed.weigh_pairs(&tried, &mut best);
        best = best.max(causes.share_by_priors(&mut weighed.alone));
        weighed.normalise(best);
        weighed
    }

    fn note(&mut self, best: &mut f64, weight: f64, fit: &Fit) {
        if weight > *best {
            *best = weight;
            self.distance = fit.distance;
        }
    }

    /// Cells of other causes that do best whatever the seal does, each beside leaks, where such a pair can have any weight.
    fn weigh_pairs(&mut self, tried: &Tried, best: &mut f64) {
        let causes = self.causes;
        let of_leak = causes.leak_prior();
        let mut place = causes.leaks.len() / 2;
        for (weight, other) in tried.0 {
            if weight + of_leak > *best + WORTH_TRYING {
                place = self.weigh_beside_leaks(other, place, best);
            }
        }
    }

    /// Weighs a cell of another cause beside leaks, from one of a size on towards larger and towards smaller ones, as far as they have any
    /// weight: it rises to one size and falls from there. Gives the place of the likeliest leak.
    fn weigh_beside_leaks(&mut self, other: usize, from: usize, best: &mut f64) -> usize {
        let causes = self.causes;
        let (mut likeliest, mut place) = (f64::NEG_INFINITY, from);
        let (smaller, larger) = causes.leaks.split_at(from);
        let larger = larger.iter().enumerate().map(|(at, leak)| (from + at, *leak));
        let smaller = smaller.iter().copied().enumerate().rev();
        let mut walk = |leaks: &mut dyn Iterator<Item = (usize, usize)>| {
            let mut in_vain = 0;
            for (at, seal) in leaks {
                let fit = causes.fit(&self.whitened, &[&causes.cells[seal], &causes.cells[other]]);
                let prior = causes.priors[seal][1] + causes.priors[other][1];
                let log_weight = weight(prior, &fit, &[&causes.cells[seal], &causes.cells[other]], *best);
                self.note(best, log_weight, &fit);
                self.keep(Pair { seal, other, log_weight });
                if log_weight > likeliest {
                    (likeliest, place) = (log_weight, at);
                }
                in_vain = if log_weight < likeliest + NEGLIGIBLE { in_vain + 1 } else { 0 };
                if in_vain == causes.leaks_of_a_size {
                    break;
                }
            }
        };
        walk(&mut larger.into_iter());
        walk(&mut smaller.into_iter());
        place
    }

    /// What leaks of any size do: a leak's response turns as it grows, so that the smallest one and one of a middle size span it. What the
    /// law leaves lies along it; the rest of the change is another cause's, and so is what that one's law leaves.
    fn any_leak(&self) -> Option<AnyLeak<'c, N>> {
        let Causes { leaks, cells, file, .. } = self.causes;
        let smallest = &cells[*leaks.first()?];
        let middle = &cells[*leaks.get(leaks.len() / 2)?];
        let means = [smallest, middle].map(|leak| self.causes.mean_of(leak));
        let directions = self.whitened.span(means);
        let [along, left] = if file.errors_are_even {
            self.causes.parted_in_noise(&self.whitened, &directions)
        } else {
            self.whitened.parted(&directions)
        };
        Some(AnyLeak { means, directions, error: smallest.error * smallest.error * along, left })
    }

    /// Keeps a pair in the place of the least likely one.
    fn keep(&mut self, pair: Pair) {
        if self.pair_count < MAX_PAIRS {
            self.pairs[self.pair_count] = pair;
            self.pair_count += 1;
            return;
        }
        let least = self.pairs.iter_mut().min_by(|a, b| a.log_weight.total_cmp(&b.log_weight));
        if let Some(least) = least.filter(|least| least.log_weight < pair.log_weight) {
            *least = pair;
        }
    }

    /// Turns logarithms into probabilities.
    fn normalise(&mut self, best: f64) {
        let cells = self.causes.cells.len();
        let pairs = self.pair_count;
        let share = |log: f64| if log - best < NEGLIGIBLE { 0.0 } else { libm::exp(log - best) };
        self.none = share(self.none);
        self.alone.iter_mut().for_each(|weight| *weight = share(*weight));
        self.pairs.iter_mut().for_each(|pair| pair.log_weight = share(pair.log_weight));
        let sum = self.none
            + self.alone.iter().take(cells).sum::<f64>()
            + self.pairs.iter().take(pairs).map(|pair| pair.log_weight).sum::<f64>();
        self.none /= sum;
        self.alone.iter_mut().for_each(|weight| *weight /= sum);
        self.pairs.iter_mut().for_each(|pair| pair.log_weight /= sum);
    }

    /// Calls `take` with each hypothesis of weight: probability and cells.
    fn each(&self, mut take: impl FnMut(f64, &[&Cell])) {
        let cells = &self.causes.cells;
        for (weight, cell) in self.alone.iter().zip(cells).filter(|(weight, _)| **weight > 0.0) {
            take(*weight, &[cell]);
        }
        for pair in self.pairs.iter().take(self.pair_count).filter(|pair| pair.log_weight > 0.0) {
            take(pair.log_weight, &[&cells[pair.seal], &cells[pair.other]]);
        }
    }

    fn explanation(&self) -> Explanation {
        let mut tallies = [Tally::default(); MAX_KINDS];
        let (mut seal, mut of_other_law) = (0.0, Tally::default());
        self.each(|weight, cells| {
            let fit = self.causes.fit(&self.whitened, cells);
            for (cell, size) in cells.iter().zip(fit.sizes(cells)) {
                tallies[cell.kind].add(weight, size);
                if cell.has_other_law {
                    of_other_law.add(weight, size);
                }
                seal += if cell.is_seal { weight } else { 0.0 };
            }
            if let [cell] = cells {
                tallies[cell.kind].alone += weight;
            }
        });
        let other = self.other(&tallies);
        let response = other.map_or([0.0; MAX_NUMBERS], |(kind, beside)| self.response(kind, beside));
        let (candidates, count) = self.candidates(&tallies);
        let (verdict, probability) = self.verdict(&tallies, seal);
        Explanation {
            verdict,
            none: self.none,
            seal,
            probability,
            distance: self.distance,
            leak_of_other_law: of_other_law.of_leaks(seal),
            other: other.and_then(|(kind, beside)| Some((*self.causes.kinds.get(kind)?, beside))),
            response,
            candidates,
            count,
        }
    }

    /// The kind other than the seal in the most likely of: nothing, the seal, one other kind, the seal and one other.
    fn other(&self, tallies: &[Tally; MAX_KINDS]) -> Option<(usize, bool)> {
        let is_seal = |kind: usize| self.causes.kinds[kind].cause == Cause::PistonSeal;
        let kinds = || (0..self.causes.kinds.len()).filter(|kind| !is_seal(*kind));
        let seal: f64 =
            (0..self.causes.kinds.len()).filter(|kind| is_seal(*kind)).map(|kind| tallies[kind].alone).sum();
        let mut best = (self.none.max(seal), None);
        for kind in kinds() {
            let Tally { weight, alone, .. } = tallies[kind];
            for (share, beside) in [(alone, false), (weight - alone, true)] {
                if share > best.0 {
                    best = (share, Some((kind, beside)));
                }
            }
        }
        best.1
    }

    /// Mean of a kind's response over the hypotheses with it, alone or beside the seal, in the phases' means and rises.
    fn response(&self, kind: usize, beside: bool) -> [f64; MAX_NUMBERS] {
        let causes = self.causes;
        let (mut sum, mut total) = ([0.0; MAX_NUMBERS], 0.0);
        self.each(|weight, cells| {
            let Some(cell) = cells.last().filter(|cell| cell.kind == kind && (cells.len() == 2) == beside)
            else {
                return;
            };
            let along = causes.fit(&self.whitened, cells).along();
            let from = cells.first().filter(|_| beside).map_or(0, |seal| seal.rank);
            total += weight;
            for (slot, mean) in sum.iter_mut().zip(causes.mean_of(cell)) {
                *slot += weight * mean;
            }
            for (which, along) in along.iter().skip(from).take(cell.rank).enumerate() {
                for (slot, value) in sum.iter_mut().zip(causes.direction_of(cell, which)) {
                    *slot += weight * along * value;
                }
            }
        });
        let mut response = [0.0; MAX_NUMBERS];
        let means = applied(causes.numbers(), &causes.file.inverse, &sum);
        for (slot, mean) in response.iter_mut().zip(means) {
            *slot = mean / total.max(f64::MIN_POSITIVE);
        }
        response
    }

    fn candidates(&self, tallies: &[Tally; MAX_KINDS]) -> ([Candidate; MAX_KINDS], usize) {
        let empty = Kind { cause: Cause::PistonSeal, side: None::<Side>, unit: SizeUnit::Area };
        let mut candidates =
            [Candidate { kind: empty, probability: 0.0, size: 0.0, interval90: [0.0; 2] }; MAX_KINDS];
        let mut count = 0;
        let kinds = self.causes.kinds.iter().zip(tallies);
        for (slot, (kind, tally)) in candidates.iter_mut().zip(kinds.filter(|(_, tally)| tally.weight > 0.0))
        {
            let size = tally.size / tally.weight;
            let half = Z_90 * libm::sqrt((tally.square / tally.weight - size * size).max(0.0));
            let interval90 = [size - half, size + half];
            *slot = Candidate { kind: *kind, probability: tally.weight.min(1.0), size, interval90 };
            count += 1;
        }
        candidates[..count].sort_unstable_by(|a, b| b.probability.total_cmp(&a.probability));
        (candidates, count)
    }

    /// Whether no hypothesis comes as near as on machines of training. Of a machine whose plant is not quite its own, what a law leaves grows
    /// with the change: a cause that takes next to all of it is known.
    fn is_like_nothing_known(&self) -> bool {
        let file = &self.causes.file;
        let leaves_much = !file.sizes_leaks || self.distance > LEFT_BY_A_CAUSE * self.distance_of_nothing;
        self.distance > file.known_limit && leaves_much
    }

    fn verdict(&self, tallies: &[Tally; MAX_KINDS], seal: f64) -> (ChangeVerdict, f64) {
        if self.is_like_nothing_known() {
            return (ChangeVerdict::Unknown, 1.0 - self.none);
        }
        if self.none >= NAMED_FROM {
            return (ChangeVerdict::Nothing, self.none);
        }
        let kinds = &self.causes.kinds;
        let of_cause = |cause: Cause| -> f64 {
            kinds
                .iter()
                .zip(tallies)
                .filter(|(kind, _)| kind.cause == cause)
                .map(|(_, tally)| tally.weight)
                .sum()
        };
        let other = kinds
            .iter()
            .map(|kind| kind.cause)
            .filter(|cause| *cause != Cause::PistonSeal)
            .map(|cause| (cause, of_cause(cause)))
            .max_by(|a, b| a.1.total_cmp(&b.1))
            .filter(|(_, probability)| *probability >= NAMED_FROM);
        match (seal >= NAMED_FROM, other) {
            (true, other) => (ChangeVerdict::Named(Cause::PistonSeal, other.map(|(cause, _)| cause)), seal),
            (false, Some((cause, probability))) => (ChangeVerdict::Named(cause, None), probability),
            (false, None) => {
                let likeliest = tallies.iter().map(|tally| tally.weight).fold(self.none, f64::max);
                (ChangeVerdict::CannotTell, likeliest)
            }
        }
    }
}

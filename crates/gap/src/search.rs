//! The search for machines that explain a record: one effect beside other parameters, then two and three.

use rayon::prelude::*;
use seepd_sim::effects::EffectInfo;
use seepd_sim::real::LANES;

use crate::diagnosis::DiagnosisSettings;
use crate::fit::{Fit, Problem, coordinates, of_effect, prior_cost, values_of};
use crate::quantisation::is_of_steps;
use crate::rank::{rather_imitates, score};
use crate::screen::{Candidate, screen, with};
use crate::simulated_axis::SimulatedAxis;

/// A machine with some effects, fitted.
#[derive(Clone)]
pub(crate) struct Explanation<A> {
    /// Effects, the first found first.
    pub(crate) effects: Vec<&'static EffectInfo>,
    /// The machine.
    pub(crate) fit: Fit<A>,
}

impl<A: SimulatedAxis> Explanation<A> {
    /// Whether an effect is part of it.
    pub(crate) fn has(&self, key: &str) -> bool {
        self.effects.iter().any(|effect| effect.key == key)
    }

    /// Whether both have the same effects, whichever was found first.
    pub(crate) fn has_the_effects_of(&self, other: &Self) -> bool {
        self.effects.len() == other.effects.len() && other.effects.iter().all(|effect| self.has(effect.key))
    }

    /// Parameters of its effects.
    pub(crate) fn parameters(&self) -> usize {
        self.effects.iter().map(|effect| effect.parameters.len()).sum()
    }
}

/// What a search found.
pub(crate) struct SearchResult<A> {
    /// The calibrated machine.
    pub(crate) calibrated: Fit<A>,
    /// Effects screened beside it, the most promising first.
    pub(crate) candidates: Vec<Candidate>,
    /// Machines with one effect or more.
    pub(crate) explanations: Vec<Explanation<A>>,
}

/// Iterations after which fits are compared, and how many of them go on.
const FIRST_ITERATIONS: usize = 3;
const FINISHED: usize = 4;
/// Effects that are fitted from both machines.
const TWICE: usize = 3;
/// Share of the cost below which another calibration is worth another round of fits.
const WORTH_ANOTHER_ROUND: f64 = 0.9;
/// Machines with one effect that are given a second, and effects that are tried as the next one.
const BEAM: usize = 2;
const NEXT: usize = 3;
/// Most effects of a machine.
const MOST_EFFECTS: usize = 3;
/// Mean square over expected error of a signal beyond noise up to which a model may be wrong by itself.
const OF_THE_MODEL: f64 = 3.0;
/// The same up to which one effect leaves nothing for a second: it may be a small one, where the simulator is as good as that.
const NOTHING_LEFT: f64 = 0.2;
/// Share of the cost that a further effect has to leave at most to be kept.
const WORTH_ANOTHER_EFFECT: f64 = 0.7;
/// Share of what is left beyond noise that it has to leave at most where that may be the model's: a right effect takes most of it, one that
/// imitates a model's errors does not.
const MOST_OF_IT: f64 = 0.5;

/// Searches from the calibrated and the untouched machine.
pub(crate) fn search<A: SimulatedAxis>(
    problem: &Problem<'_>,
    untouched: &Fit<A>,
    calibrated: Fit<A>,
    far: &[Candidate],
    settings: &DiagnosisSettings,
) -> SearchResult<A> {
    let mut found = SearchResult {
        candidates: screen(problem, &calibrated, &settings.without),
        calibrated,
        explanations: Vec::new(),
    };
    found.explanations =
        single_effects(problem, untouched, &found.calibrated, &found.candidates, far, settings);
    // An effect's fit that owes its success to the parameters beside it shows where calibration should have gone.
    if untouched.spec.is_spent() {
        return found;
    }
    let better = repolished(problem, &found, settings);
    if better.cost < WORTH_ANOTHER_ROUND * found.calibrated.cost {
        found.calibrated = better;
        found.candidates = screen(problem, &found.calibrated, &settings.without);
        found.explanations =
            single_effects(problem, untouched, &found.calibrated, &found.candidates, far, settings);
    }
    polish(problem, &mut found.explanations, settings);
    let may_go_on = !untouched.spec.is_spent();
    if may_go_on && found.explanations.iter().all(|one| wants_another(problem, &found.calibrated, one)) {
        add_effects(problem, (untouched, &found.calibrated), &mut found.explanations, settings);
    }
    calibrate_no_worse(problem, &mut found, settings);
    found
}

/// Goes on with calibration where an explanation's machine is better calibrated even without its effects: what the parameters beside an
/// effect have found out later would be counted as the effect's.
fn calibrate_no_worse<A: SimulatedAxis>(
    problem: &Problem<'_>,
    found: &mut SearchResult<A>,
    settings: &DiagnosisSettings,
) {
    if found.calibrated.spec.is_spent() {
        return;
    }
    let machines: Vec<A> =
        found.explanations.iter().take(LANES).map(Explanation::without_its_effects).collect();
    let free = &found.calibrated.free;
    let best = machines
        .iter()
        .zip(problem.residuals(&machines))
        .map(|(machine, residual)| {
            (residual.norm_squared() + prior_cost(free, &coordinates(machine, free)), machine)
        })
        .min_by(|a, b| a.0.total_cmp(&b.0));
    if let Some((_, machine)) = best.filter(|(cost, _)| *cost < found.calibrated.cost) {
        found.calibrated = calibrated_from(problem, machine, &found.calibrated, settings.iterations);
    }
}

/// Calibration that begins at another machine.
fn calibrated_from<A: SimulatedAxis>(
    problem: &Problem<'_>,
    machine: &A,
    calibrated: &Fit<A>,
    iterations: usize,
) -> Fit<A> {
    Fit::at(problem, machine, calibrated.free.clone()).fitted(problem, iterations).renewed(problem)
}

/// Takes the best fits further, with new derivatives: a fit that has not converged loses to one that has.
fn polish<A: SimulatedAxis>(
    problem: &Problem<'_>,
    explanations: &mut [Explanation<A>],
    settings: &DiagnosisSettings,
) {
    explanations.par_iter_mut().take(TWICE).for_each(|one| {
        one.fit = one.fit.clone().renewed(problem).fitted(problem, settings.iterations).renewed(problem);
    });
    explanations.sort_by(|a, b| a.fit.cost.total_cmp(&b.fit.cost));
}

/// Whether a machine leaves something that a further effect may explain.
fn wants_another<A>(problem: &Problem<'_>, calibrated: &Fit<A>, one: &Explanation<A>) -> bool {
    let least = if one.effects.len() == 1 { NOTHING_LEFT } else { OF_THE_MODEL };
    leaves(problem, &one.fit, least)
        || (leaves(problem, calibrated, OF_THE_MODEL) && rather_imitates(problem, calibrated, one))
}

/// Whether more than that is left of a signal, in squares of its expected error beyond noise.
fn leaves<A>(problem: &Problem<'_>, fit: &Fit<A>, least: f64) -> bool {
    problem.beyond_noise(&fit.residual).into_iter().any(|square| square > least)
}

/// Whether a machine with a further effect takes so much of what one leaves that it is kept.
fn is_worth_it<A>(problem: &Problem<'_>, before: &Fit<A>, with: &Fit<A>) -> bool {
    if leaves(problem, before, OF_THE_MODEL) {
        return with.cost < WORTH_ANOTHER_EFFECT * before.cost;
    }
    let left = |fit: &Fit<A>| problem.beyond_noise(&fit.residual).iter().sum::<f64>();
    with.cost < before.cost && left(with) < MOST_OF_IT * left(before)
}

/// Calibration from where the best effect's fit has put the plant's parameters, without the effect.
fn repolished<A: SimulatedAxis>(
    problem: &Problem<'_>,
    found: &SearchResult<A>,
    settings: &DiagnosisSettings,
) -> Fit<A> {
    let best = found.explanations.iter().min_by(|a, b| a.fit.cost.total_cmp(&b.fit.cost));
    let Some(best) = best else { return found.calibrated.clone() };
    calibrated_from(problem, &best.without_its_effects(), &found.calibrated, 2 * settings.iterations)
}

/// Fits the most promising effects: those that explain most beside the calibrated machine, and those that do beside the untouched one,
/// since calibration may have bent other parameters to the gap. The best of all are fitted from both.
fn single_effects<A: SimulatedAxis>(
    problem: &Problem<'_>,
    untouched: &Fit<A>,
    calibrated: &Fit<A>,
    near: &[Candidate],
    far: &[Candidate],
    settings: &DiagnosisSettings,
) -> Vec<Explanation<A>> {
    let begun = |(candidate, from_afar): &(&Candidate, bool)| {
        let start = if *from_afar { untouched } else { calibrated };
        let fit = beside(problem, start, candidate.effect, &candidate.values);
        if *from_afar || (0..candidate.effect.parameters.len()).any(|index| candidate.effect.is_time(index)) {
            fit.fitted_from_afar(problem, FIRST_ITERATIONS)
        } else {
            fit.fitted(problem, FIRST_ITERATIONS)
        }
    };
    let mut starts: Vec<(&Candidate, bool)> = near.iter().take(settings.fitted).map(|c| (c, false)).collect();
    starts.extend(far.iter().take(settings.fitted).map(|c| (c, true)));
    let mut fits: Vec<Explanation<A>> = Vec::new();
    let first = starts.par_iter().map(begun).collect::<Vec<_>>();
    keep_better(&mut fits, starts.iter().zip(finished(problem, first, settings)));
    fits.sort_by(|a, b| a.fit.cost.total_cmp(&b.fit.cost));
    let best: Vec<&str> = fits.iter().take(TWICE).map(|one| one.effects[0].key).collect();
    let untried = |(candidate, from_afar): &(&Candidate, bool)| {
        let key = candidate.effect.key;
        best.contains(&key) && !starts.iter().any(|(c, n)| c.effect.key == key && n == from_afar)
    };
    let others = near.iter().map(|c| (c, false)).chain(far.iter().map(|c| (c, true)));
    let more: Vec<(&Candidate, bool)> = others.filter(untried).collect();
    if !calibrated.spec.is_spent() {
        let further = more.par_iter().map(begun).collect::<Vec<_>>();
        keep_better(&mut fits, more.iter().zip(finished(problem, further, settings)));
    }
    fits.sort_by(|a, b| a.fit.cost.total_cmp(&b.fit.cost));
    fits
}

/// Takes the best of some fits to their end; the others cannot win any more.
fn finished<A: SimulatedAxis>(
    problem: &Problem<'_>,
    mut fits: Vec<Fit<A>>,
    settings: &DiagnosisSettings,
) -> Vec<Fit<A>> {
    let mut costs: Vec<f64> = fits.iter().map(|fit| fit.cost).collect();
    costs.sort_by(f64::total_cmp);
    let last = costs.get(FINISHED - 1).copied().unwrap_or(f64::INFINITY);
    fits.par_iter_mut().filter(|fit| fit.cost <= last).for_each(|fit| {
        *fit = fit.clone().fitted(problem, settings.iterations.saturating_sub(FIRST_ITERATIONS));
    });
    fits
}

/// The machine with a further effect, its parameters free.
fn beside<A: SimulatedAxis>(
    problem: &Problem<'_>,
    start: &Fit<A>,
    effect: &'static EffectInfo,
    values: &[f64],
) -> Fit<A> {
    let machine = with(&start.spec, effect, values);
    start.extended(problem, &machine, of_effect(effect, &start.as_described()))
}

fn keep_better<'c, A>(
    fits: &mut Vec<Explanation<A>>,
    results: impl Iterator<Item = (&'c (&'c Candidate, bool), Fit<A>)>,
) {
    for ((candidate, _), fit) in results {
        match fits.iter_mut().find(|other| other.effects[0].key == candidate.effect.key) {
            Some(other) if fit.cost < other.fit.cost => other.fit = fit,
            Some(_) => {}
            None => fits.push(Explanation { effects: vec![candidate.effect], fit }),
        }
    }
}

/// Forward selection: the best machines get a further effect as long as something is left and the next one takes much of it; beside the
/// untouched machine, where none does beside parameters that were bent to what was missing. What the best of all can do without is left out
/// again.
fn add_effects<A: SimulatedAxis>(
    problem: &Problem<'_>,
    (untouched, calibrated): (&Fit<A>, &Fit<A>),
    explanations: &mut Vec<Explanation<A>>,
    settings: &DiagnosisSettings,
) {
    let mut bases = most_likely(problem, explanations, BEAM);
    for _ in 1..MOST_EFFECTS {
        let mut grown: Vec<Explanation<A>> = Vec::new();
        for base in bases.iter().filter(|base| wants_another(problem, calibrated, base)) {
            let mut found = base.grown(problem, &base.fit.clone().renewed(problem), Fit::fitted, settings);
            let parameters_may_be_bent = leaves(problem, &base.fit, OF_THE_MODEL);
            if found.is_empty() && parameters_may_be_bent && !untouched.spec.is_spent() {
                let untouched = base.beside_the_untouched(problem, untouched);
                found = base.grown(problem, &untouched, Fit::fitted_from_afar, settings);
            }
            grown.extend(found);
        }
        grown
            .par_iter_mut()
            .filter(|one| !untouched.spec.is_spent() && leaves(problem, &one.fit, OF_THE_MODEL))
            .for_each(|one| one.try_beside_the_untouched(problem, untouched, settings));
        bases = most_likely(problem, &grown, 1);
        explanations.extend(grown.into_iter().filter(|one| !one.is_idle()));
    }
    if !untouched.spec.is_spent() {
        for best in most_likely(problem, explanations, 1) {
            let best = best.with_the_step_that_is_read(problem, settings).unwrap_or(best);
            let fewer = best.with_one_less(problem, settings).into_iter().filter(|one| !one.is_idle());
            fewer.for_each(|one| keep_better_of_the_same(explanations, one));
        }
    }
}

/// Keeps a machine in the place of one with the same effects that explains less, or beside the others.
fn keep_better_of_the_same<A: SimulatedAxis>(explanations: &mut Vec<Explanation<A>>, one: Explanation<A>) {
    match explanations.iter_mut().find(|other| other.has_the_effects_of(&one)) {
        Some(other) if one.fit.cost < other.fit.cost => other.fit = one.fit,
        Some(_) => {}
        None => explanations.push(one),
    }
}

fn most_likely<A: SimulatedAxis>(
    problem: &Problem<'_>,
    from: &[Explanation<A>],
    count: usize,
) -> Vec<Explanation<A>> {
    let mut sorted: Vec<(f64, &Explanation<A>)> =
        from.iter().map(|one| (score(problem, &one.fit, one.parameters() as f64), one)).collect();
    sorted.sort_by(|a, b| b.0.total_cmp(&a.0));
    sorted.into_iter().take(count).map(|(_, one)| one.clone()).collect()
}

impl<A: SimulatedAxis> Explanation<A> {
    /// The machine with the parameters beside its effects alone.
    fn without_its_effects(&self) -> A {
        let mut machine = self.fit.spec.clone();
        for effect in &self.effects {
            machine.effects_mut().remove(effect.key);
        }
        machine
    }

    /// Machines with the most promising further effect each, fitted from a machine that has these effects, which take much of what is left.
    fn grown(
        &self,
        problem: &Problem<'_>,
        from: &Fit<A>,
        fitted: fn(Fit<A>, &Problem<'_>, usize) -> Fit<A>,
        settings: &DiagnosisSettings,
    ) -> Vec<Self> {
        let with_another = |candidate: &Candidate| {
            let fit = beside(problem, from, candidate.effect, &candidate.values);
            let effects = self.effects.iter().copied().chain([candidate.effect]).collect();
            Explanation { effects, fit: fitted(fit, problem, settings.iterations) }
        };
        let next = screen(problem, from, &settings.without);
        let mut grown: Vec<Self> = next.par_iter().take(NEXT).map(with_another).collect();
        grown.retain(|one| is_worth_it(problem, &self.fit, &one.fit));
        grown
    }

    /// The untouched machine with the same effects.
    fn beside_the_untouched(&self, problem: &Problem<'_>, untouched: &Fit<A>) -> Fit<A> {
        let mut machine = untouched.spec.clone();
        let mut free = untouched.free.clone();
        for effect in &self.effects {
            machine = with(&machine, effect, &values_of(effect, &self.fit.spec));
            free.extend(of_effect(effect, &untouched.spec));
        }
        Fit::at(problem, &machine, free)
    }

    /// Fits the same effects beside the untouched machine, and keeps that where it explains more: while one of them was missing, the
    /// parameters beside them were bent to its part of the gap, and from far off, as a supply of half the pressure, none of them finds back.
    fn try_beside_the_untouched(
        &mut self,
        problem: &Problem<'_>,
        untouched: &Fit<A>,
        settings: &DiagnosisSettings,
    ) {
        let anew = self.beside_the_untouched(problem, untouched);
        let anew = anew.fitted_from_afar(problem, settings.iterations);
        if anew.cost < self.fit.cost {
            self.fit = anew;
        }
    }

    /// The machine whose position is read in the steps that the log itself shows, where it lacks them: what takes so little of the gap is
    /// found last, if at all, and something else has imitated the hunting that it brings.
    fn with_the_step_that_is_read(
        &self,
        problem: &Problem<'_>,
        settings: &DiagnosisSettings,
    ) -> Option<Self> {
        let step_m = problem.record.position_step_m?;
        let step = self.fit.spec.catalogue().into_iter().find(|effect| is_of_steps(effect))?;
        if self.has(step.key) || settings.without.iter().any(|key| key == step.key) {
            return None;
        }
        let fit = beside(problem, &self.fit, step, &[step_m]).fitted(problem, settings.iterations);
        Some(Explanation { effects: self.effects.iter().copied().chain([step]).collect(), fit })
    }

    /// Of a machine with as many effects as are sought, those that lack one of them, fitted from where it stands: an effect that was found early may have stood for one that was
    /// found later, and a machine that got stuck beside fewer effects is reached over more.
    fn with_one_less(&self, problem: &Problem<'_>, settings: &DiagnosisSettings) -> Vec<Self> {
        if self.effects.len() < MOST_EFFECTS {
            return Vec::new();
        }
        let lacking = |left_out: &&'static EffectInfo| {
            let effects: Vec<_> = self.effects.iter().copied().filter(|e| e.key != left_out.key).collect();
            let mut machine = self.fit.spec.clone();
            machine.effects_mut().remove(left_out.key);
            let free = self.fit.free.iter().filter(|free| !free.is_of(&[left_out.key])).cloned().collect();
            let fit = Fit::at(problem, &machine, free).fitted(problem, settings.iterations);
            Explanation { effects, fit }
        };
        self.effects.par_iter().map(lacking).collect()
    }

    /// Whether one of its effects has been fitted away.
    fn is_idle(&self) -> bool {
        self.effects.iter().any(|effect| effect.is_neutral(&values_of(effect, &self.fit.spec)))
    }
}

//! From a record to a diagnosis.

use std::collections::BTreeMap;

use seepd_signals::Signal;
use seepd_sim::SensorError;
use seepd_sim::effects::EffectInfo;
use seepd_sim::learned::Site;
use seepd_sim::real::LANES;

use crate::course::{ChangeKind, change};
use crate::diagnosable::Diagnosable;
use crate::fit::{Fit, Problem, Target, free_parameters, of_effect, values_of};
use crate::learn::{LearnedMachine, learn};
use crate::next_test::{Candidate as NextTestCandidate, NextTest, next_test};
use crate::places::{phase_spans, places};
use crate::quantisation::is_of_steps;
use crate::rank::{PRIOR_NONE, Ranking, rank};
use crate::record::{BINS, ENOUGH_CYCLES, Record, binned};
use crate::report::{
    CalibratedValue, ChangeWithin, Curves, CycleCounts, Diagnosis, Gaps, Leaks, LearnedCurve, Place,
    RankedEffect, Shrink, Verdict,
};
use crate::screen::{CalibrationProjector, Candidate, screen, with};
use crate::search::{Explanation, SearchResult, search};
use crate::shrink::{HeldOut, attributed};
use crate::simulate::{BinnedSignals, Drive, binned_signals, bins_of};
use crate::simulated_axis::SimulatedAxis;
use crate::transducers;

/// What a diagnosis is asked for.
#[derive(Debug, Clone, PartialEq)]
pub struct DiagnosisSettings {
    /// Effects that are fitted in full, beside the calibrated and beside the nominal machine.
    pub fitted: usize,
    /// Iterations of a fit.
    pub iterations: usize,
    /// Effects of the catalogue that are left out.
    pub without: Vec<String>,
    /// Whether to look for what would tell the remaining explanations apart.
    pub next_test: bool,
}

impl Default for DiagnosisSettings {
    fn default() -> Self {
        DiagnosisSettings { fitted: 5, iterations: 10, without: Vec::new(), next_test: false }
    }
}

/// Steps of a diagnosis, for a progress bar.
pub const STEPS: usize = 4;
/// Mean square over expected error up to which a signal has no gap.
const NO_GAP: f64 = 4.0;
/// Probability from which an effect is chosen.
const CHOSEN: f64 = 0.5;
/// Cosine of signatures from which two effects are the same in this log.
const EQUIVALENT: f64 = 0.97;
/// Share of the best machine's probability from which another that looks like it is as good.
const ALIKE: f64 = 0.5;
/// Share of the held-out gap, in squares, that a machine's last effect has to leave at most.
const BORNE_OUT: f64 = 0.9;
/// Probability from which a learned law is given to the machine: below it, it imitates something else.
const LIKELY_AT_ALL: f64 = 0.1;
/// Probability from which a machine is given what the log itself shows.
const WORTH_A_COMPANION: f64 = 0.05;
/// How many times less likely the main cause of a machine with several effects is the one that stands later: of 28 machines of a blind run
/// the one that was found first took the most of the gap on 24.
const MAIN_LATER: f64 = 1.0 / 6.0;
/// Signature, in expected errors, below which an effect cannot be seen.
const VISIBLE: f64 = 2.0;

/// Diagnoses a record against a machine, and gives the machine as diagnosed: calibrated, with the effects that were found. Where the
/// machine changed within the record, it is diagnosed as it is in the end. `tell` is called with the number of finished steps, of
/// [`STEPS`].
///
/// The [crate's page](crate) has an example.
pub fn diagnose<A: Diagnosable>(
    record: &Record,
    spec: &A,
    settings: &DiagnosisSettings,
    tell: &mut dyn FnMut(usize),
) -> (Diagnosis, A) {
    spec.diagnosed(record, settings, tell)
}

/// Reached by `diagnosable!` alone.
#[doc(hidden)]
pub fn diagnose_axis<A: SimulatedAxis>(
    record: &Record,
    spec: &A,
    settings: &DiagnosisSettings,
    tell: &mut dyn FnMut(usize),
) -> (Diagnosis, A) {
    let Some(change) = change(record) else { return diagnose_unchanged(record, spec, settings, tell) };
    let after = record.part(change.from..record.cycles.len());
    let (mut diagnosis, machine) = diagnose_unchanged(&after, spec, settings, tell);
    let before = record.part(0..change.before);
    let within = ChangeWithin {
        kind: change.kind,
        from_cycle: change.from + 1,
        before: effects_before(&before, (spec, &machine), &diagnosis.chosen, settings.iterations),
    };
    diagnosis.notes.insert(0, told_change(&within, record.cycles.len()));
    diagnosis.change = Some(within);
    (diagnosis, machine)
}

/// What the chosen effects' values were in another part of the record, on the machine as diagnosed otherwise, in the ranges of the machine
/// as its file describes it.
fn effects_before<A: SimulatedAxis>(
    record: &Record,
    (spec, machine): (&A, &A),
    chosen: &[&'static str],
    iterations: usize,
) -> BTreeMap<&'static str, BTreeMap<&'static str, f64>> {
    let cycles: Vec<usize> = (0..record.cycles.len()).collect();
    let problem = Problem::new(record, &cycles);
    let effects: Vec<&'static EffectInfo> =
        machine.catalogue().into_iter().filter(|effect| chosen.contains(&effect.key)).collect();
    let free = effects.iter().flat_map(|effect| of_effect(effect, spec)).collect();
    let fit = Fit::at(&problem, machine, free).fitted_from_afar(&problem, iterations);
    let values = |effect: &&'static EffectInfo| {
        let names = effect.parameters.iter().map(|parameter| parameter.name);
        (effect.key, names.zip(values_of(effect, &fit.spec)).collect())
    };
    effects.iter().map(values).collect()
}

fn told_change(change: &ChangeWithin, cycles: usize) -> String {
    let how = match change.kind {
        ChangeKind::Step => format!("the machine changed before cycle {} of {cycles}", change.from_cycle),
        ChangeKind::Drift => format!("the machine drifts over the {cycles} cycles"),
    };
    let before: Vec<String> = change
        .before
        .iter()
        .flat_map(|(effect, values)| {
            values.iter().map(move |(name, value)| format!("{effect}.{name} {value:.4}"))
        })
        .collect();
    let before =
        if before.is_empty() { String::new() } else { format!("; at the beginning: {}", before.join(", ")) };
    format!("{how}: diagnosed is what it is from cycle {} on{before}", change.from_cycle)
}

/// Diagnoses a record whose machine is the same in all of its cycles.
fn diagnose_unchanged<A: SimulatedAxis>(
    record: &Record,
    spec: &A,
    settings: &DiagnosisSettings,
    tell: &mut dyn FnMut(usize),
) -> (Diagnosis, A) {
    let (fitted, held_out) = split(record);
    let problem = Problem::new(record, &fitted);
    let nominal = Fit::of_wear(&problem, spec, settings.iterations);
    tell(1);
    let untouched = Fit::at(&problem, &nominal.spec, free_parameters(spec));
    let (calibrated, far) = rayon::join(
        || untouched.clone().fitted_from_afar(&problem, 2 * settings.iterations).renewed(&problem),
        || screen(&problem, &untouched, &settings.without),
    );
    tell(2);
    let mut found = search(&problem, &untouched, calibrated, &far, settings);
    let held_out = HeldOut { record, cycles: &held_out };
    borne_out(&held_out, &mut found.explanations);
    tell(3);
    let mut ranked = RankedExplanations::new(&problem, &held_out, found);
    let (verdict, reason) = verdict(&problem, record, &nominal, &ranked);
    let parts = if verdict == Verdict::Effect {
        ranked.put_the_main_cause_first(&problem, &held_out, &nominal.spec, settings.iterations)
    } else {
        Vec::new()
    };
    let learned = if verdict == Verdict::Unknown { learn(&problem, &ranked.calibrated) } else { Vec::new() };
    let told = DiagnosisInputs {
        record,
        spec,
        problem: &problem,
        nominal: &nominal,
        ranked: &ranked,
        parts: &parts,
        held_out: &held_out,
        learned: &learned,
        adopted: adopted(&held_out, &ranked.calibrated, &learned),
    };
    let diagnosis = told.diagnosis(settings, verdict, reason, fitted.len());
    tell(STEPS);
    let machine = told.chosen(verdict).clone();
    (diagnosis, machine)
}

/// Keeps, of machines with several effects, those whose last one takes something of the gap on the held-out cycles as well.
fn borne_out<A: SimulatedAxis>(held_out: &HeldOut<'_>, explanations: &mut Vec<Explanation<A>>) {
    let machines: Vec<A> = explanations.iter().map(|one| one.fit.spec.clone()).collect();
    if explanations.iter().all(|one| one.effects.len() == 1) {
        return;
    }
    let left: Vec<f64> = held_out.gaps(&machines).iter().map(|gaps| held_out.beyond_expected(gaps)).collect();
    let key = |effects: &[&'static EffectInfo]| effects.iter().map(|effect| effect.key).collect::<Vec<_>>();
    let base_of = |one: &Explanation<A>| {
        let (_, before) = one.effects.split_last()?;
        explanations.iter().position(|other| key(&other.effects) == key(before))
    };
    let kept: Vec<bool> = explanations
        .iter()
        .zip(&left)
        .map(|(one, left_of_it)| base_of(one).is_none_or(|base| *left_of_it < BORNE_OUT * left[base]))
        .collect();
    let mut kept = kept.into_iter();
    explanations.retain(|_| kept.next().unwrap_or(true));
}

/// The most likely law without a name, if it is likely at all and takes something of the gap on the held-out cycles as well.
fn adopted<'l, A: SimulatedAxis>(
    held_out: &HeldOut<'_>,
    calibrated: &Fit<A>,
    learned: &'l [LearnedMachine<A>],
) -> Option<&'l LearnedMachine<A>> {
    let best = learned.first().filter(|best| best.probability >= LIKELY_AT_ALL)?;
    let gaps = held_out.gaps(&[calibrated.spec.clone(), best.spec.clone()]);
    let [before, after] = [0, 1].map(|machine| held_out.beyond_expected(&gaps[machine]));
    (after < BORNE_OUT * before).then_some(best)
}

/// Gap of a machine in which wear alone is fitted, by signal, on the cycles that a diagnosis holds out.
pub fn nominal_gap<A: Diagnosable>(record: &Record, spec: &A) -> BTreeMap<&'static str, f64> {
    spec.nominal_gap(record)
}

/// Reached by `diagnosable!` alone.
#[doc(hidden)]
pub fn nominal_gap_of_axis<A: SimulatedAxis>(record: &Record, spec: &A) -> BTreeMap<&'static str, f64> {
    let (fitted, held_out) = split(record);
    let problem = Problem::new(record, &fitted);
    let nominal = Fit::of_wear(&problem, spec, DiagnosisSettings::default().iterations);
    let gaps = HeldOut { record, cycles: &held_out }.gaps(&[nominal.spec]).swap_remove(0);
    record.signals.iter().map(|signal| signal.name()).zip(gaps).collect()
}

/// Cycles that are fitted to, and every third, which is held out.
///
/// Of runs it is every third with the same command and the same signals; where none is repeated so often, the gaps are those of the runs
/// that were fitted to.
pub(crate) fn split(record: &Record) -> (Vec<usize>, Vec<usize>) {
    let all = 0..record.cycles.len();
    if !record.is_open_loop {
        return all.partition(|cycle| cycle % 3 != 2);
    }
    let mut seen: BTreeMap<(usize, Vec<bool>), usize> = BTreeMap::new();
    let (fitted, held_out): (Vec<usize>, Vec<usize>) = all.partition(|cycle| {
        let cycle = &record.cycles[*cycle];
        let signals = cycle.bins.iter().map(|bins| bins[0].is_finite()).collect();
        let before = seen.entry((cycle.group, signals)).or_default();
        *before += 1;
        !before.is_multiple_of(3)
    });
    if held_out.is_empty() { (fitted.clone(), fitted) } else { (fitted, held_out) }
}

/// The answer to a log that says nothing, with the reason. Probabilities are those from before any log.
pub fn cannot_tell(reason: String) -> Diagnosis {
    Diagnosis {
        schema: "seepd.gap/1",
        cycles: CycleCounts { used: 0, fit: 0, held_out: 0 },
        signals: Vec::new(),
        floor: BTreeMap::new(),
        gap: Gaps { nominal: BTreeMap::new(), calibrated: BTreeMap::new(), chosen: BTreeMap::new() },
        places: Vec::new(),
        verdict: Verdict::CannotTell,
        reason: Some(reason),
        seconds: 0.0,
        effects: Vec::new(),
        learned: Vec::new(),
        next_test: None,
        unknown_probability: 1.0 - PRIOR_NONE,
        no_effect_probability: PRIOR_NONE,
        chosen: Vec::new(),
        shrink: Shrink {
            of_removable: 0.0,
            of_total: 0.0,
            calibration_only: 0.0,
            by_effect: BTreeMap::new(),
        },
        calibrated: BTreeMap::new(),
        leak: Leaks { nominal_m2: f64::NAN, calibrated_m2: f64::NAN, chosen_m2: f64::NAN },
        distinguish: Vec::new(),
        sensors: BTreeMap::new(),
        change: None,
        notes: Vec::new(),
        curves: Curves::default(),
    }
}

/// What a search found, ranked.
struct RankedExplanations<A> {
    calibrated: Fit<A>,
    candidates: Vec<Candidate>,
    /// The one that is named, then the others, most likely first.
    explanations: Vec<(Explanation<A>, f64)>,
    unknown: f64,
    none: f64,
    projector: CalibrationProjector,
}

impl<A: SimulatedAxis> RankedExplanations<A> {
    fn new(problem: &Problem<'_>, held_out: &HeldOut<'_>, found: SearchResult<A>) -> Self {
        let Ranking { none, unknown, explanations: probabilities } =
            rank(problem, &found.calibrated, &found.explanations, |machine| held_out.sensors(machine));
        let mut explanations: Vec<(Explanation<A>, f64)> =
            found.explanations.into_iter().zip(probabilities).collect();
        explanations.sort_by(|a, b| b.1.total_cmp(&a.1));
        let projector = CalibrationProjector::new(&found.calibrated);
        let mut ranked = RankedExplanations {
            calibrated: found.calibrated,
            candidates: found.candidates,
            explanations,
            unknown,
            none,
            projector,
        };
        ranked.prefer_the_common();
        ranked.read_in_steps(problem);
        ranked
    }

    /// A position that is read in steps shows that in the log itself, even where the hunting that it brings repeats so little from cycle to
    /// cycle that no simulation takes anything of the gap: the machines have it beside what they have, where it would be seen.
    fn read_in_steps(&mut self, problem: &Problem<'_>) {
        let Some(step_m) = problem.record.position_step_m else { return };
        let step = self.candidates.iter().find(|candidate| is_of_steps(candidate.effect));
        let Some(step) = step.filter(|step| step.visible > VISIBLE) else { return };
        let lacks_it =
            |one: &&mut (Explanation<A>, f64)| one.1 >= WORTH_A_COMPANION && !one.0.has(step.effect.key);
        for (explanation, _) in self.explanations.iter_mut().filter(lacks_it) {
            let machine = with(&explanation.fit.spec, step.effect, &[step_m]);
            let free = of_effect(step.effect, &explanation.fit.as_described());
            explanation.fit = explanation.fit.extended(problem, &machine, free);
            explanation.effects.push(step.effect);
        }
    }

    /// What each effect of the most likely machine takes of the gap, the largest part first. Its effects stand in that order from then on: the
    /// one that was found first may have stood for another.
    fn put_the_main_cause_first(
        &mut self,
        problem: &Problem<'_>,
        held_out: &HeldOut<'_>,
        nominal: &A,
        iterations: usize,
    ) -> Vec<(&'static str, f64)> {
        let Some((best, _)) = self.explanations.first() else { return Vec::new() };
        let best = best.clone();
        let machines = [nominal.clone(), self.calibrated.spec.clone(), best.fit.spec.clone()];
        let gaps = held_out.gaps(&machines);
        let shrink = |now: &[f64]| held_out.shrink(&gaps[0], now, true);
        let ends = (shrink(&gaps[1]), shrink(&gaps[2]));
        let parts = attributed(problem, held_out, &gaps[0], ends, &self.calibrated, &best, iterations);
        let mut effects: Vec<(&'static EffectInfo, f64)> = best.effects.iter().copied().zip(parts).collect();
        effects.sort_by(|a, b| b.1.total_cmp(&a.1));
        for (one, _) in self.explanations.iter_mut().filter(|(one, _)| one.has_the_effects_of(&best)) {
            one.effects = effects.iter().map(|(effect, _)| *effect).collect();
        }
        effects.into_iter().map(|(effect, part)| (effect.key, part)).collect()
    }

    /// Probability that each effect is the main cause, most likely first.
    fn effects(&self) -> Vec<(&'static EffectInfo, f64)> {
        let mut effects: Vec<(&'static EffectInfo, f64)> = Vec::new();
        for (explanation, probability) in &self.explanations {
            let odds = |place: usize| MAIN_LATER.powi(place as i32);
            let all: f64 = (0..explanation.effects.len()).map(odds).sum();
            for (place, effect) in explanation.effects.iter().enumerate() {
                let share = probability * odds(place) / all;
                match effects.iter_mut().find(|(other, _)| other.key == effect.key) {
                    Some((_, sum)) => *sum += share,
                    None => effects.push((effect, share)),
                }
            }
        }
        effects.sort_by(|a, b| b.1.total_cmp(&a.1));
        effects
    }

    /// Probability that the machine has that effect, alone or beside others.
    fn presence(&self, key: &str) -> f64 {
        self.explanations.iter().filter(|(one, _)| one.has(key)).map(|(_, probability)| probability).sum()
    }

    /// The most likely machine with that effect.
    fn best_with(&self, key: &str) -> Option<&Explanation<A>> {
        self.machines().find(|explanation| explanation.has(key))
    }

    /// Effects that, put in the place of one in the most likely machine with it, have the same signature up to its size.
    fn equivalents(&self, key: &str) -> Vec<&'static str> {
        let Some(own) = self.best_with(key) else { return Vec::new() };
        let of_rest = |other: &&Explanation<A>| {
            other.effects.len() + 1 == own.effects.len()
                && other.effects.iter().all(|e| e.key != key && own.has(e.key))
        };
        let base = match self.machines().find(of_rest) {
            Some(rest) => &rest.fit,
            None if own.effects.len() == 1 => &self.calibrated,
            None => return Vec::new(),
        };
        let signature = |explanation: &Explanation<A>| {
            self.projector.project(&(&explanation.fit.residual - &base.residual))
        };
        let own_signature = signature(own);
        // Machines that differ in this one effect.
        let instead = |other: &Explanation<A>| {
            let different: Vec<&'static str> =
                other.effects.iter().map(|effect| effect.key).filter(|key| !own.has(key)).collect();
            let replaces =
                other.effects.len() == own.effects.len() && !other.has(key) && different.len() == 1;
            let other = signature(other);
            (replaces && own_signature.dot(&other) > EQUIVALENT * own_signature.norm() * other.norm())
                .then(|| different[0])
        };
        self.machines().filter_map(instead).collect()
    }

    /// Each set of effects once, with its most likely machine and the probability of all: searches that began at either of two effects may
    /// end with the same two, which no test tells from themselves.
    fn sets_of_effects(&self) -> Vec<(&Explanation<A>, f64)> {
        let mut sets: Vec<(&Explanation<A>, f64)> = Vec::new();
        for (explanation, probability) in &self.explanations {
            match sets.iter_mut().find(|(other, _)| other.has_the_effects_of(explanation)) {
                Some((_, sum)) => *sum += probability,
                None => sets.push((explanation, *probability)),
            }
        }
        sets
    }

    fn machines(&self) -> impl Iterator<Item = &Explanation<A>> {
        self.explanations.iter().map(|(explanation, _)| explanation)
    }

    /// Among machines that this log hardly tells apart, the one whose effects come first in the catalogue is named.
    fn prefer_the_common(&mut self) {
        let Some((best, probability)) = self.explanations.first() else { return };
        let catalogue = best.fit.spec.catalogue();
        let place = |explanation: &Explanation<A>| -> usize {
            let place_of = |key: &str| catalogue.iter().position(|info| info.key == key).unwrap_or(0);
            explanation.effects.iter().map(|effect| place_of(effect.key)).sum()
        };
        let close = |other: &(Explanation<A>, f64)| {
            other.1 > ALIKE * probability
                && other.0.parameters() <= best.parameters()
                && self.is_like(best, &other.0)
        };
        let alike = self.explanations.iter().enumerate().filter(|(_, other)| close(other));
        if let Some((index, _)) = alike.min_by_key(|(_, (explanation, _))| place(explanation)) {
            to_front(&mut self.explanations, index);
        }
    }

    /// Whether each effect of the other machine is in the best one or looks like one of its effects.
    fn is_like(&self, best: &Explanation<A>, other: &Explanation<A>) -> bool {
        let alike: Vec<&str> = best.effects.iter().flat_map(|effect| self.equivalents(effect.key)).collect();
        other.effects.iter().all(|effect| best.has(effect.key) || alike.contains(&effect.key))
    }

    /// Probability of the most likely machine and of those with its like.
    fn class(&self) -> f64 {
        let Some((best, _)) = self.explanations.first() else { return 0.0 };
        let alike = self.explanations.iter().filter(|(other, _)| self.is_like(best, other));
        alike.map(|(_, probability)| probability).sum()
    }
}

fn verdict<A: SimulatedAxis>(
    problem: &Problem<'_>,
    record: &Record,
    nominal: &Fit<A>,
    ranked: &RankedExplanations<A>,
) -> (Verdict, Option<String>) {
    let largest = |fit: &Fit<A>| problem.by_signal(&fit.residual).into_iter().fold(0.0, f64::max);
    // What differs between runs is told by those with the same command.
    let few = (record.cycles.len() < ENOUGH_CYCLES && !record.is_open_loop).then(|| {
        format!("there are only {} cycles; {ENOUGH_CYCLES} or more are wanted", record.cycles.len())
    });
    let class = ranked.class();
    if ranked.none >= ranked.unknown && ranked.none >= class {
        let verdict = if largest(nominal) <= NO_GAP { Verdict::NoGap } else { Verdict::Parameters };
        return (verdict, few);
    }
    if ranked.unknown >= class {
        let rest = "a gap is left that no effect of the catalogue explains".to_owned();
        return (Verdict::Unknown, Some(rest));
    }
    // Effects that look the same in this log share their probability, and so do machines that have the first one in common.
    let first = ranked.effects().first().map_or(0.0, |(_, probability)| *probability);
    if class.max(first) >= CHOSEN {
        return (Verdict::Effect, few);
    }
    let names: Vec<&str> = ranked
        .effects()
        .iter()
        .map(|(effect, _)| effect.key)
        .filter(|key| ranked.presence(key) > 0.1)
        .collect();
    (Verdict::CannotTell, Some(format!("several effects explain the log equally well: {}", names.join(", "))))
}

/// Everything that a diagnosis is made from.
struct DiagnosisInputs<'a, A> {
    record: &'a Record,
    spec: &'a A,
    problem: &'a Problem<'a>,
    nominal: &'a Fit<A>,
    ranked: &'a RankedExplanations<A>,
    /// What each chosen effect takes of the gap, the largest part first.
    parts: &'a [(&'static str, f64)],
    held_out: &'a HeldOut<'a>,
    learned: &'a [LearnedMachine<A>],
    /// The learned law that the machine is given.
    adopted: Option<&'a LearnedMachine<A>>,
}

impl<A: SimulatedAxis> DiagnosisInputs<'_, A> {
    /// The machine as diagnosed.
    fn chosen(&self, verdict: Verdict) -> &A {
        match (verdict, self.ranked.explanations.first()) {
            (Verdict::Effect, Some((best, _))) => &best.fit.spec,
            (Verdict::NoGap, _) => &self.nominal.spec,
            (Verdict::Unknown, _) => self.adopted.map_or(&self.ranked.calibrated.spec, |one| &one.spec),
            _ => &self.ranked.calibrated.spec,
        }
    }

    /// What would tell the remaining explanations apart: machines with effects, calibration alone, and laws without a name.
    fn next_test(&self) -> Option<NextTest> {
        let ranked = self.ranked;
        let mut candidates: Vec<NextTestCandidate<'_, A>> = ranked
            .sets_of_effects()
            .into_iter()
            .map(|(explanation, probability)| NextTestCandidate {
                name: explanation.effects.iter().map(|effect| effect.key).collect::<Vec<_>>().join(" + "),
                probability,
                spec: &explanation.fit.spec,
                fit: &explanation.fit,
            })
            .collect();
        candidates.push(NextTestCandidate {
            name: "no effect, only other parameters".into(),
            probability: ranked.none,
            spec: &ranked.calibrated.spec,
            fit: &ranked.calibrated,
        });
        candidates.extend(self.learned.iter().map(|learned| NextTestCandidate {
            name: format!(
                "a law of the {} over the {}",
                learned.law.site.name(),
                learned.law.argument.name()
            ),
            probability: ranked.unknown * learned.probability,
            spec: &learned.spec,
            fit: &ranked.calibrated,
        }));
        next_test(self.record, self.spec, candidates)
    }

    fn learned_curves(&self, nominal: &[f64]) -> Vec<LearnedCurve> {
        let machines: Vec<A> = self.learned.iter().map(|one| one.spec.clone()).collect();
        if machines.is_empty() {
            return Vec::new();
        }
        let gaps = self.held_out.gaps(&machines);
        self.learned
            .iter()
            .zip(gaps)
            .map(|(one, gaps)| {
                let adopted = self.adopted.is_some_and(|adopted| std::ptr::eq(adopted, one));
                one.told(self.held_out.shrink(nominal, &gaps, true), adopted)
            })
            .collect()
    }

    fn diagnosis(
        &self,
        settings: &DiagnosisSettings,
        verdict: Verdict,
        reason: Option<String>,
        fitted: usize,
    ) -> Diagnosis {
        let (record, ranked) = (self.record, self.ranked);
        let (calibrated, chosen) = (&ranked.calibrated, self.chosen(verdict));
        let of_chosen = self.held_out.sensors(chosen);
        let effects = ranked.effects();
        let mut machines = vec![self.nominal.spec.clone(), calibrated.spec.clone(), chosen.clone()];
        let best: Vec<&Explanation<A>> =
            effects.iter().filter_map(|(effect, _)| ranked.best_with(effect.key)).collect();
        machines.extend(best.iter().map(|explanation| explanation.fit.spec.clone()));
        // The least likely ones, beyond a batch of lanes, have their gap on the first held-out cycle alone.
        let (likely, others) = machines.split_at(machines.len().min(LANES));
        let mut gaps = self.held_out.gaps(likely);
        gaps.extend(self.held_out.first().gaps(others));
        let leaves_a_gap = self.held_out.largest_over_expected(&gaps[2]) > NO_GAP;
        let shrink = |now: &[f64], to_floor: bool| self.held_out.shrink(&gaps[0], now, to_floor);
        let findings: Vec<RankedEffect> = effects
            .iter()
            .zip(&best)
            .zip(&gaps[3..])
            .map(|(((effect, probability), explanation), gaps)| {
                self.finding(effect, *probability, explanation, shrink(gaps, true))
            })
            .collect();
        let told = |values: &[f64]| -> BTreeMap<&'static str, f64> {
            record.signals.iter().map(|signal| signal.name()).zip(values.iter().copied()).collect()
        };
        Diagnosis {
            schema: "seepd.gap/1",
            cycles: CycleCounts {
                used: record.cycles.len(),
                fit: fitted,
                held_out: self.held_out.cycles.len(),
            },
            signals: record.signals.iter().map(|signal| signal.name()).collect(),
            floor: told(&record.floor),
            gap: Gaps { nominal: told(&gaps[0]), calibrated: told(&gaps[1]), chosen: told(&gaps[2]) },
            places: self.places(&of_chosen, settings.iterations),
            verdict,
            reason,
            seconds: 0.0,
            unknown_probability: ranked.unknown,
            no_effect_probability: ranked.none,
            chosen: self.parts.iter().map(|(key, _)| *key).collect(),
            shrink: Shrink {
                of_removable: shrink(&gaps[2], true),
                of_total: shrink(&gaps[2], false),
                calibration_only: shrink(&gaps[1], true),
                by_effect: self.parts.iter().copied().collect(),
            },
            calibrated: self.calibrated_values(),
            leak: Leaks {
                nominal_m2: leak(&self.nominal.spec),
                calibrated_m2: leak(&calibrated.spec),
                chosen_m2: leak(chosen),
            },
            distinguish: distinguish(self.spec, record, &findings, &ranked.candidates, verdict),
            effects: findings,
            next_test: if settings.next_test { self.next_test() } else { None },
            learned: self.learned_curves(&gaps[0]),
            sensors: transducers::believable(&record.signals, &of_chosen, leaves_a_gap),
            change: None,
            notes: self.notes(&of_chosen, leaves_a_gap),
            curves: self.curves(&machines[..3]),
        }
    }

    fn finding(
        &self,
        effect: &'static EffectInfo,
        probability: f64,
        explanation: &Explanation<A>,
        shrink: f64,
    ) -> RankedEffect {
        type Estimate = (f64, [f64; 2]);
        let fit = &explanation.fit;
        let own: Vec<(&'static str, Estimate)> = fit
            .free
            .iter()
            .zip(fit.estimates(self.problem.misfit(&fit.residual)))
            .filter_map(|(free, estimate)| match &free.target {
                Target::Effect(of, index) if of.key == effect.key => {
                    Some((of.parameters[*index].name, estimate))
                }
                _ => None,
            })
            .collect();
        RankedEffect {
            effect: effect.key,
            law: effect.law,
            probability,
            presence_probability: self.ranked.presence(effect.key),
            parameters: own.iter().map(|(name, estimate)| (*name, estimate.0)).collect(),
            interval95: own.iter().map(|(name, estimate)| (*name, estimate.1)).collect(),
            shrink,
            equivalent: self.ranked.equivalents(effect.key),
        }
    }

    fn calibrated_values(&self) -> BTreeMap<String, CalibratedValue> {
        let calibrated = &self.ranked.calibrated;
        let wear = self.spec.wear().map(|parameter| parameter.key);
        let mut told = BTreeMap::new();
        let misfit = self.problem.misfit(&calibrated.residual);
        for (parameter, (fitted, interval95)) in calibrated.free.iter().zip(calibrated.estimates(misfit)) {
            let Target::Plant(parameter) = &parameter.target else { continue };
            if Some(&parameter.key) != wear.as_ref() {
                let nominal = self.spec.parameter(&parameter.key);
                told.insert(parameter.symbol.to_string(), CalibratedValue { nominal, fitted, interval95 });
            }
        }
        told
    }

    /// What there is to know of the log, with the transducers that are worth a check; a machine that leaves a gap tells nothing of them.
    fn notes(&self, errors: &[Option<SensorError>], leaves_a_gap: bool) -> Vec<String> {
        let mut notes = self.record.notes.clone();
        if self.adopted.is_some_and(|one| one.law.site == Site::Seal) {
            notes.push("the learned law is a flow past the piston: the leak is what it and the leak area pass together".into());
        }
        if leaves_a_gap {
            return notes;
        }
        let worth_a_check = transducers::worth_a_check(&self.record.signals, errors);
        notes.extend(worth_a_check.into_iter().map(|(signal, error)| {
            format!(
                "the transducer of {} seems to be off by {:+.1} % and {:+.1} bar, more than one of class 0.5 should be: check it",
                signal.name(),
                100.0 * error.gain,
                1e-5 * error.zero
            )
        }));
        notes
    }

    /// Where balances fail on what was there, beside what the sensors of the machine as diagnosed are off by. The machine that is held
    /// against it has its usual parameters calibrated and no more: constants and sensors that are free as well would move the rest from one
    /// balance to another.
    fn places(&self, errors: &[Option<SensorError>], iterations: usize) -> Vec<Place> {
        let record = self.record.without(errors);
        let cycles: Vec<usize> = record.alike(&split(&record).0);
        let problem = Problem::new(&record, &cycles).without_allowances();
        let mut free = free_parameters(self.spec);
        free.retain(|free| !free.is_hardly_told());
        let calibrated =
            Fit::at(&problem, &self.nominal.spec, free).fitted_from_afar(&problem, iterations).spec;
        let drive = &record.cycles[cycles[0]].drive;
        let machines = std::slice::from_ref(&calibrated);
        let simulated = binned_signals(machines, drive, &record.signals).swap_remove(0);
        let shown = record.mean(&cycles);
        let along = along(&calibrated, &record, &shown, drive);
        places(&record, &along, &shown, &simulated)
    }

    /// What the held-out cycles show beside the three machines: nominal, calibrated, chosen.
    fn curves(&self, machines: &[A]) -> Curves {
        let cycles = self.record.alike(self.held_out.cycles);
        let drive = &self.record.cycles[cycles[0]].drive;
        let recorded = self.record.mean(&cycles);
        let spec = along(self.spec, self.record, &recorded, drive);
        let mut shown = binned_signals(machines, drive, &self.record.signals).into_iter();
        let mut next = || shown.next().unwrap_or_default();
        let width_s = spec.duty_cycle().period_s / BINS as f64;
        Curves {
            t_s: (0..BINS).map(|bin| (bin as f64 + 0.5) * width_s).collect(),
            recorded,
            nominal: next(),
            calibrated: next(),
            chosen: next(),
            phases: phase_spans(&spec),
        }
    }
}

/// Moves the one at an index to the front; the others keep their order.
fn to_front<T>(list: &mut [T], index: usize) {
    if let Some(head) = list.get_mut(..=index) {
        head.rotate_right(1);
    }
}

/// The axis with a recorded run in the place of its duty cycle, if it is one of runs.
fn along<A: SimulatedAxis>(spec: &A, record: &Record, shown: &BinnedSignals, drive: &Drive) -> A {
    let Some(position_m) = bins_of(&record.signals, Signal::Position, shown) else { return spec.clone() };
    let load_n = binned(&drive.iter().map(|sample| sample.load_n).collect::<Vec<f64>>());
    spec.along(drive.len() as f64 * spec.tick_s(), &smoothed(position_m), &load_n)
}

/// Bins on either side over which a run's position is smoothed before its speed tells its phases.
const SMOOTHED: usize = 5;

fn smoothed(values: &[f64]) -> Vec<f64> {
    let around = |bin: usize| &values[bin.saturating_sub(SMOOTHED)..(bin + SMOOTHED + 1).min(values.len())];
    (0..values.len()).map(|bin| around(bin).iter().sum::<f64>() / around(bin).len() as f64).collect()
}

/// What wear has come to; NaN on an axis without.
fn leak<A: SimulatedAxis>(spec: &A) -> f64 {
    spec.wear().map_or(f64::NAN, |parameter| spec.parameter(&parameter.key))
}

/// What would tell apart what this log cannot.
fn distinguish<A: SimulatedAxis>(
    spec: &A,
    record: &Record,
    effects: &[RankedEffect],
    candidates: &[Candidate],
    verdict: Verdict,
) -> Vec<String> {
    let mut told = Vec::new();
    let pressures = record.signals.len() > 2 || spec.signals().len() <= 2;
    if let Some(best) = effects.first().filter(|best| !best.equivalent.is_empty() && best.probability > 0.1) {
        let others = best.equivalent.join(", ");
        let lags = ["command_delay", "position_lag", "valve_lag"];
        let sensor = if lags.contains(&best.effect) {
            "the spool's position and a second position sensor"
        } else if pressures {
            "a stroke at another speed and load"
        } else {
            "the chambers' pressures"
        };
        told.push(format!("record {sensor} to tell {} from {others}", best.effect));
    }
    if !pressures && !matches!(verdict, Verdict::NoGap | Verdict::Effect) {
        told.push("record p_cap and p_rod: with pressures, most causes can be told apart".into());
    }
    let unseen: Vec<&str> = candidates
        .iter()
        .filter(|candidate| candidate.visible < VISIBLE)
        .map(|candidate| candidate.effect.key)
        .collect();
    if !unseen.is_empty() {
        told.push(format!(
            "with this duty cycle and these signals, these effects cannot be seen: {}",
            unseen.join(", ")
        ));
    }
    told
}

#[cfg(test)]
mod tests {
    use super::to_front;

    #[test]
    fn what_is_preferred_leaves_the_others_most_likely_first() {
        let mut shares = [0.4, 0.3, 0.2, 0.1];
        to_front(&mut shares, 2);
        assert_eq!(shares, [0.2, 0.4, 0.3, 0.1]);
        to_front(&mut shares, 0);
        assert_eq!(shares, [0.2, 0.4, 0.3, 0.1]);
        to_front(&mut shares, 4);
        assert_eq!(shares, [0.2, 0.4, 0.3, 0.1]);
    }
}

//! From a record to a diagnosis.

use std::collections::BTreeMap;

use rayon::prelude::*;
use seepd_sim::cycle::Instant;
use seepd_sim::effects::Effect;
use seepd_sim::{MachineSpec, PlantParameters};

use crate::fit::{Fit, Problem, Target, leak_only, of_effect, retunable};
use crate::places::{phase_spans, places};
use crate::rank::{Ranking, rank};
use crate::record::{BINS, ENOUGH_CYCLES, Record};
use crate::report::{
    Curves, CycleCounts, Diagnosis, EffectFinding, Gaps, Leaks, Place, Retuned, Shrink, Verdict,
};
use crate::screen::{Beyond, Candidate, screen, with};
use crate::simulate::{View, views};

/// What a diagnosis is asked for.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Effects that are fitted in full, beside the retuned and beside the nominal machine.
    pub fitted: usize,
    /// Iterations of a fit.
    pub iterations: usize,
    /// Effects of the catalogue that are left out.
    pub without: Vec<String>,
}

impl Default for Settings {
    fn default() -> Self {
        Settings { fitted: 5, iterations: 10, without: Vec::new() }
    }
}

/// Steps of a diagnosis, for a progress bar.
pub const STEPS: usize = 5;
/// Mean square over expected error up to which a signal has no gap.
const NO_GAP: f64 = 4.0;
/// Probability from which an effect is chosen.
const CHOSEN: f64 = 0.5;
/// Cosine of signatures from which two effects are the same in this log.
const EQUIVALENT: f64 = 0.97;
/// Signature, in expected errors, below which an effect cannot be seen.
const VISIBLE: f64 = 2.0;
/// Signals whose nominal gap exceeds this many floors count in the shrink.
const FLOORS: f64 = 1.5;

/// Diagnoses a record against a machine; `tell` hears of each finished step.
pub fn diagnose(
    record: &Record,
    spec: &MachineSpec,
    settings: &Settings,
    tell: &mut dyn FnMut(usize),
) -> Diagnosis {
    let (fitted, held_out) = split(record);
    let problem = Problem::new(record, &fitted);
    let nominal = Fit::at(&problem, spec, leak_only()).fitted(&problem, settings.iterations);
    tell(1);
    let untouched = Fit::at(&problem, &nominal.spec, retunable(spec));
    let (retuned, far) = rayon::join(
        || untouched.clone().from_afar(&problem, 2 * settings.iterations).renewed(&problem),
        || screen(&problem, &untouched, &settings.without),
    );
    let mut retuned = retuned;
    tell(2);
    let mut candidates = screen(&problem, &retuned, &settings.without);
    tell(3);
    let mut fits = fit_effects(&problem, &untouched, &retuned, &candidates, &far, settings);
    // An effect's fit that owes its success to the parameters beside it shows where retuning should have gone.
    let better = repolished(&problem, &retuned, &fits, settings);
    if better.cost < WORTH_ANOTHER_ROUND * retuned.cost {
        retuned = better;
        candidates = screen(&problem, &retuned, &settings.without);
        fits = fit_effects(&problem, &untouched, &retuned, &candidates, &far, settings);
    }
    tell(4);
    let weighed: Vec<(&Fit, usize)> =
        fits.iter().map(|(effect, fit)| (fit, effect.parameters().len())).collect();
    let ranking = rank(&problem, &retuned, &weighed);
    let order = sorted(&ranking);
    fits = order.iter().map(|index| fits[*index].clone()).collect();
    let probabilities: Vec<f64> = order.iter().map(|index| ranking.effects[*index]).collect();
    let beyond = Beyond::new(&retuned);
    let alike =
        fits.first().map_or(Vec::new(), |(effect, fit)| equivalents(&beyond, &retuned, *effect, fit, &fits));
    let (verdict, reason) = verdict(&problem, record, &nominal, &ranking, &probabilities, &fits, &alike);
    let chosen = if verdict == Verdict::Effect {
        &fits[0].1
    } else if verdict == Verdict::NoGap {
        &nominal
    } else {
        &retuned
    };
    let measured = Measured { record, cycles: &held_out };
    let mut machines = vec![nominal.spec.clone(), retuned.spec.clone(), chosen.spec.clone()];
    machines.extend(fits.iter().map(|(_, fit)| fit.spec.clone()));
    let gaps = measured.gaps(&machines);
    let (of_nominal, of_retuned, of_chosen, of_effects) = (&gaps[0], &gaps[1], &gaps[2], &gaps[3..]);
    let shrink = |now: &[f64], to_floor: bool| measured.shrink(of_nominal, now, to_floor);
    let effects = fits
        .iter()
        .zip(&probabilities)
        .zip(of_effects)
        .map(|(((effect, fit), probability), gaps)| {
            type Estimate = (f64, [f64; 2]);
            let own: Vec<(&'static str, Estimate)> = fit
                .free
                .iter()
                .zip(fit.estimates())
                .filter_map(|(free, estimate)| match free.target {
                    Target::Effect(of, index) => Some((of.parameters()[index].name, estimate)),
                    _ => None,
                })
                .collect();
            EffectFinding {
                effect: effect.key(),
                probability: *probability,
                parameters: own.iter().map(|(name, estimate)| (*name, estimate.0)).collect(),
                interval95: own.iter().map(|(name, estimate)| (*name, estimate.1)).collect(),
                shrink: shrink(gaps, true),
                equivalent: equivalents(&beyond, &retuned, *effect, fit, &fits),
            }
        })
        .collect::<Vec<_>>();
    let distinguish = distinguish(record, &effects, &candidates, verdict);
    let told = |values: &[f64]| -> BTreeMap<&'static str, f64> {
        record.signals.iter().map(|signal| signal.name()).zip(values.iter().copied()).collect()
    };
    let diagnosis = Diagnosis {
        schema: "seepd.gap/1",
        cycles: CycleCounts { used: record.cycles.len(), fit: fitted.len(), held_out: held_out.len() },
        signals: record.signals.iter().map(|signal| signal.name()).collect(),
        floor: told(&record.floor),
        gap: Gaps { nominal: told(of_nominal), retuned: told(of_retuned), chosen: told(of_chosen) },
        places: where_is(record, &retuned, &fitted),
        verdict,
        reason,
        seconds: 0.0,
        unknown_probability: ranking.unknown,
        no_effect_probability: ranking.none,
        chosen: if verdict == Verdict::Effect { vec![fits[0].0.key()] } else { Vec::new() },
        shrink: Shrink {
            of_removable: shrink(of_chosen, true),
            of_total: shrink(of_chosen, false),
            retune_only: shrink(of_retuned, true),
        },
        retuned: retuned_parameters(spec, &retuned),
        leak: Leaks {
            nominal_m2: nominal.spec.plant.leak_area_m2,
            retuned_m2: retuned.spec.plant.leak_area_m2,
            chosen_m2: chosen.spec.plant.leak_area_m2,
        },
        effects,
        distinguish,
        notes: record.notes.clone(),
        machine: chosen.spec.clone(),
        curves: curves(record, spec, &held_out, &machines[..3]),
    };
    tell(STEPS);
    diagnosis
}

/// Gap of a machine whose leak alone is fitted, by signal, on the cycles that a diagnosis holds out.
pub fn nominal_gap(record: &Record, spec: &MachineSpec) -> BTreeMap<&'static str, f64> {
    let (fitted, held_out) = split(record);
    let problem = Problem::new(record, &fitted);
    let nominal = Fit::at(&problem, spec, leak_only()).fitted(&problem, Settings::default().iterations);
    let gaps = Measured { record, cycles: &held_out }.gaps(&[nominal.spec]).swap_remove(0);
    record.signals.iter().map(|signal| signal.name()).zip(gaps).collect()
}

/// Cycles that are fitted to, and every third, which is held out.
fn split(record: &Record) -> (Vec<usize>, Vec<usize>) {
    (0..record.cycles.len()).partition(|cycle| cycle % 3 != 2)
}

/// The answer to a log that says nothing, with the reason.
pub fn cannot_tell(spec: &MachineSpec, reason: String) -> Diagnosis {
    Diagnosis {
        schema: "seepd.gap/1",
        cycles: CycleCounts { used: 0, fit: 0, held_out: 0 },
        signals: Vec::new(),
        floor: BTreeMap::new(),
        gap: Gaps { nominal: BTreeMap::new(), retuned: BTreeMap::new(), chosen: BTreeMap::new() },
        places: Vec::new(),
        verdict: Verdict::CannotTell,
        reason: Some(reason),
        seconds: 0.0,
        effects: Vec::new(),
        unknown_probability: 0.0,
        no_effect_probability: 1.0,
        chosen: Vec::new(),
        shrink: Shrink { of_removable: 0.0, of_total: 0.0, retune_only: 0.0 },
        retuned: BTreeMap::new(),
        leak: Leaks { nominal_m2: f64::NAN, retuned_m2: f64::NAN, chosen_m2: f64::NAN },
        distinguish: Vec::new(),
        notes: Vec::new(),
        machine: spec.clone(),
        curves: Curves::default(),
    }
}

/// What the held-out cycles show beside the three machines: nominal, retuned, chosen.
fn curves(record: &Record, spec: &MachineSpec, cycles: &[usize], machines: &[MachineSpec]) -> Curves {
    let drive = &record.cycles[cycles[0]].drive;
    let mut shown = views(machines, drive, &record.signals).into_iter();
    let mut next = || shown.next().unwrap_or_default();
    let width_s = spec.cycle.period_s / BINS as f64;
    Curves {
        t_s: (0..BINS).map(|bin| (bin as f64 + 0.5) * width_s).collect(),
        recorded: record.mean(cycles),
        nominal: next(),
        retuned: next(),
        chosen: next(),
        phases: phase_spans(spec),
    }
}

/// Share of the cost below which retuning anew is worth another round of fits.
const WORTH_ANOTHER_ROUND: f64 = 0.9;

/// Retuning from where the best effect's fit has put the plant's parameters, without the effect.
fn repolished(
    problem: &Problem<'_>,
    retuned: &Fit,
    fits: &[(&'static dyn Effect, Fit)],
    settings: &Settings,
) -> Fit {
    let best = fits.iter().min_by(|a, b| a.1.cost.total_cmp(&b.1.cost));
    let Some((effect, fit)) = best else { return retuned.clone() };
    let mut start = fit.spec.clone();
    start.effects.remove(effect.key());
    Fit::at(problem, &start, retuned.free.clone()).fitted(problem, 2 * settings.iterations).renewed(problem)
}

/// Fits the most promising effects: those that explain most beside the retuned machine, and those that do beside the nominal one, since
/// retuning may have bent other parameters to the gap. The best of all are fitted from both.
fn fit_effects(
    problem: &Problem<'_>,
    untouched: &Fit,
    retuned: &Fit,
    near: &[Candidate],
    far: &[Candidate],
    settings: &Settings,
) -> Vec<(&'static dyn Effect, Fit)> {
    let fit = |(candidate, from_nominal): &(&Candidate, bool)| {
        let start = if *from_nominal { untouched } else { retuned };
        let machine = with(&start.spec, candidate.effect, &candidate.values);
        let fit = start.extended(problem, &machine, of_effect(candidate.effect, &machine));
        if *from_nominal {
            fit.from_afar(problem, settings.iterations)
        } else {
            fit.fitted(problem, settings.iterations)
        }
    };
    let mut starts: Vec<(&Candidate, bool)> = near.iter().take(settings.fitted).map(|c| (c, false)).collect();
    starts.extend(far.iter().take(settings.fitted).map(|c| (c, true)));
    let mut fits: Vec<(&'static dyn Effect, Fit)> = Vec::new();
    keep_better(&mut fits, starts.iter().zip(starts.par_iter().map(fit).collect::<Vec<_>>()));
    fits.sort_by(|a, b| a.1.cost.total_cmp(&b.1.cost));
    let best: Vec<&str> = fits.iter().take(TWICE).map(|(effect, _)| effect.key()).collect();
    let untried = |(candidate, from_nominal): &(&Candidate, bool)| {
        let key = candidate.effect.key();
        best.contains(&key) && !starts.iter().any(|(c, n)| c.effect.key() == key && n == from_nominal)
    };
    let others = near.iter().map(|c| (c, false)).chain(far.iter().map(|c| (c, true)));
    let more: Vec<(&Candidate, bool)> = others.filter(untried).collect();
    keep_better(&mut fits, more.iter().zip(more.par_iter().map(fit).collect::<Vec<_>>()));
    fits
}

/// Effects that are fitted from both machines.
const TWICE: usize = 3;

fn keep_better<'c>(
    fits: &mut Vec<(&'static dyn Effect, Fit)>,
    results: impl Iterator<Item = (&'c (&'c Candidate, bool), Fit)>,
) {
    for ((candidate, _), fit) in results {
        match fits.iter_mut().find(|(effect, _)| effect.key() == candidate.effect.key()) {
            Some((_, other)) if fit.cost < other.cost => *other = fit,
            Some(_) => {}
            None => fits.push((candidate.effect, fit)),
        }
    }
}

fn sorted(ranking: &Ranking) -> Vec<usize> {
    let mut order: Vec<usize> = (0..ranking.effects.len()).collect();
    order.sort_by(|a, b| ranking.effects[*b].total_cmp(&ranking.effects[*a]));
    order
}

fn verdict(
    problem: &Problem<'_>,
    record: &Record,
    nominal: &Fit,
    ranking: &Ranking,
    probabilities: &[f64],
    fits: &[(&'static dyn Effect, Fit)],
    alike: &[&'static str],
) -> (Verdict, Option<String>) {
    let largest = |fit: &Fit| problem.by_signal(&fit.residual).into_iter().fold(0.0, f64::max);
    let few = (record.cycles.len() < ENOUGH_CYCLES)
        .then(|| format!("only {} cycles; {ENOUGH_CYCLES} or more are wanted", record.cycles.len()));
    let best = probabilities.first().copied().unwrap_or(0.0);
    if ranking.none >= ranking.unknown && ranking.none >= best {
        let verdict = if largest(nominal) <= NO_GAP { Verdict::NoGap } else { Verdict::Parameters };
        return (verdict, few);
    }
    if ranking.unknown >= best {
        let rest = "a gap is left that no effect of the catalogue explains".to_owned();
        return (Verdict::Unknown, Some(rest));
    }
    // Effects that look the same in this log share their probability.
    let class: f64 = fits
        .iter()
        .zip(probabilities)
        .filter(|((effect, _), _)| {
            fits.first().is_some_and(|(first, _)| first.key() == effect.key())
                || alike.contains(&effect.key())
        })
        .map(|(_, probability)| probability)
        .sum();
    if class >= CHOSEN {
        return (Verdict::Effect, few);
    }
    let names: Vec<&str> = fits
        .iter()
        .zip(probabilities)
        .filter(|(_, probability)| **probability > 0.1)
        .map(|((effect, _), _)| effect.key())
        .collect();
    (Verdict::CannotTell, Some(format!("several effects explain the log alike: {}", names.join(", "))))
}

/// Effects whose fitted signatures, beyond retuning, are the same up to size.
fn equivalents(
    beyond: &Beyond,
    retuned: &Fit,
    effect: &dyn Effect,
    fit: &Fit,
    fits: &[(&'static dyn Effect, Fit)],
) -> Vec<&'static str> {
    let signature = |fit: &Fit| beyond.project(&(&fit.residual - &retuned.residual));
    let own = signature(fit);
    fits.iter()
        .filter(|(other, _)| other.key() != effect.key())
        .filter(|(_, other)| {
            let other = signature(other);
            own.dot(&other) > EQUIVALENT * own.norm() * other.norm()
        })
        .map(|(other, _)| other.key())
        .collect()
}

fn where_is(record: &Record, retuned: &Fit, cycles: &[usize]) -> Vec<Place> {
    let recorded = record.mean(cycles);
    let drive = &record.cycles[cycles[0]].drive;
    let simulated = views(std::slice::from_ref(&retuned.spec), drive, &record.signals).swap_remove(0);
    places(record, &retuned.spec, &recorded, &simulated)
}

/// Gaps on cycles that nothing was fitted to.
struct Measured<'r> {
    record: &'r Record,
    cycles: &'r [usize],
}

impl Measured<'_> {
    /// RMS over range, by machine and signal, each cycle against its own simulation.
    fn gaps(&self, machines: &[MachineSpec]) -> Vec<Vec<f64>> {
        let record = self.record;
        let mut sums = vec![vec![0.0; record.signals.len()]; machines.len()];
        let mut simulated: Option<(&[Instant], Vec<View>)> = None;
        for cycle in self.cycles {
            let cycle = &record.cycles[*cycle];
            // Cycles with the very same drive have the very same simulation.
            if simulated.as_ref().is_none_or(|(drive, _)| *drive != cycle.drive) {
                simulated = Some((&cycle.drive, views(machines, &cycle.drive, &record.signals)));
            }
            let Some((_, shown)) = &simulated else { continue };
            for (sums, view) in sums.iter_mut().zip(shown) {
                for (sum, (simulated, recorded)) in sums.iter_mut().zip(view.iter().zip(&cycle.bins)) {
                    *sum += simulated.iter().zip(recorded).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
                }
            }
        }
        let count = (self.cycles.len() * BINS) as f64;
        let rms = |(sum, range): (&f64, &f64)| (sum / count).sqrt() / range;
        sums.iter().map(|sums| sums.iter().zip(&record.range).map(rms).collect()).collect()
    }

    /// Mean over signals with a gap of what is gone of it; of what is above the floor, or of the whole.
    fn shrink(&self, nominal: &[f64], now: &[f64], to_floor: bool) -> f64 {
        let shares: Vec<f64> = nominal
            .iter()
            .zip(now)
            .zip(&self.record.floor)
            .filter(|((nominal, _), floor)| **nominal > FLOORS * **floor)
            .map(|((nominal, now), floor)| (nominal - now) / (nominal - if to_floor { *floor } else { 0.0 }))
            .collect();
        if shares.is_empty() { 0.0 } else { shares.iter().sum::<f64>() / shares.len() as f64 }
    }
}

fn retuned_parameters(nominal: &MachineSpec, retuned: &Fit) -> BTreeMap<&'static str, Retuned> {
    let mut told = BTreeMap::new();
    for (parameter, (fitted, interval95)) in retuned.free.iter().zip(retuned.estimates()) {
        let Target::Plant(key) = parameter.target else { continue };
        let symbol = PlantParameters::ALL.iter().find(|info| info.key == key).map_or(key, |info| info.symbol);
        told.insert(
            symbol,
            Retuned { nominal: nominal.plant.get(key).unwrap_or(f64::NAN), fitted, interval95 },
        );
    }
    told
}

/// What would tell apart what this log cannot.
fn distinguish(
    record: &Record,
    effects: &[EffectFinding],
    candidates: &[Candidate],
    verdict: Verdict,
) -> Vec<String> {
    let mut told = Vec::new();
    let pressures = record.signals.len() > 2;
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
        told.push("record p_cap and p_rod: with pressures most causes are told apart".into());
    }
    let unseen: Vec<&str> = candidates
        .iter()
        .filter(|candidate| candidate.visible < VISIBLE)
        .map(|candidate| candidate.effect.key())
        .collect();
    if !unseen.is_empty() {
        told.push(format!("with this duty cycle and these signals nothing shows of: {}", unseen.join(", ")));
    }
    told
}

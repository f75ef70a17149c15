//! Answers against the truth.

use std::collections::BTreeMap;

use seepd_sim::PlantParameters;
use seepd_sim::noise::Noise;
use serde::{Deserialize, Serialize};

use crate::cause::{Set, Truth, class_of};

/// What of a diagnosis (`seepd.gap/1`) is scored.
#[derive(Debug, Clone, Deserialize)]
pub struct Answer {
    verdict: String,
    effects: Vec<Named>,
    unknown_probability: f64,
    no_effect_probability: f64,
    chosen: Vec<String>,
    shrink: Shrink,
    leak: Leak,
    floor: BTreeMap<String, f64>,
    gap: Gap,
    seconds: f64,
}

#[derive(Debug, Clone, Deserialize)]
struct Named {
    effect: String,
    probability: f64,
    /// Of methods that name one cause a machine it is the same, and absent.
    presence_probability: Option<f64>,
    equivalent: Vec<String>,
}

#[derive(Debug, Clone, Copy, Deserialize)]
struct Shrink {
    of_removable: f64,
}

#[derive(Debug, Clone, Copy, Deserialize)]
struct Leak {
    nominal_m2: Option<f64>,
    #[serde(rename = "retuned_m2")]
    calibrated_m2: Option<f64>,
    chosen_m2: Option<f64>,
}

#[derive(Debug, Clone, Deserialize)]
struct Gap {
    #[serde(rename = "retuned")]
    calibrated: BTreeMap<String, f64>,
    chosen: BTreeMap<String, f64>,
}

/// An answer to a case.
#[derive(Debug, Clone)]
pub struct Answered {
    /// The case.
    pub case: String,
    /// Its truth.
    pub truth: Truth,
    /// The answer.
    pub answer: Answer,
    /// Whether something is left above the floor after calibration.
    pub visible: bool,
    /// Gap by signal of the emitted plant, measured again; `None` where it was not.
    pub measured: Option<BTreeMap<String, f64>>,
}

/// Scores of one view.
#[derive(Debug, Clone, Serialize)]
pub struct Scores {
    /// Cases.
    pub cases: usize,
    /// Single effects whose signature is above the floor after calibration, and all.
    pub visible: [usize; 2],
    /// Share of the visible single effects that are ranked first, within the stated classes.
    pub top_1: f64,
    /// The same by exact name.
    pub top_1_exact: f64,
    /// Among the first two, within the classes.
    pub top_2: f64,
    /// Share of the visible single effects that the verdict names.
    pub named: f64,
    /// Share of invisible ones for which no effect is called.
    pub invisible_not_called: f64,
    /// Share of the pairs with a visible gap of which both are chosen, and at least one.
    pub pairs: [f64; 2],
    /// Pairs of which both effects show: both were chosen, or what was chosen leaves a visible gap. How many, and the share of which both
    /// are chosen.
    pub pairs_both_visible: (usize, f64),
    /// Effect or "unknown" called on exact machines, and on ones with other parameters.
    pub false_alarms: [f64; 2],
    /// Area under the receiver operating curve of the unknown's probability, outside causes against single ones.
    pub auroc_unknown: f64,
    /// Expected calibration error, what calibrated answers would have, and the excess.
    pub calibration_error: [f64; 3],
    /// Removable gap removed, mean over visible single effects.
    pub shrink: f64,
    /// Largest difference of a claimed gap from the emitted plant's, over the signal's range.
    pub claimed_gap_error: f64,
    /// Mean leak error of visible single effects, L/min at 7 MPa: nominal, calibrated, chosen.
    pub leak_error_lpm: [f64; 3],
    /// Seconds of a diagnosis: median and largest.
    pub seconds: [f64; 2],
    /// For each effect: visible cases, ranked first, named.
    pub by_effect: BTreeMap<String, [usize; 3]>,
    /// What was answered wrong, one line each.
    pub wrong: Vec<String>,
}

/// A signature counts as visible from so many floors on.
const FLOORS: f64 = 1.5;
/// A claimed gap further from the emitted plant's than this share of a signal's range is listed.
const LARGEST_CLAIM_ERROR: f64 = 1e-3;
/// L/min in a m³/s.
const LPM: f64 = 6e4;
/// Bins of the calibration error.
const BINS: usize = 10;

/// Scores the answers of one view.
pub fn score(answers: &[Answered]) -> Scores {
    let of = |set: Set| answers.iter().filter(move |answered| answered.truth.set == set);
    let singles: Vec<&Answered> = of(Set::Single).collect();
    let visible: Vec<&Answered> = singles.iter().copied().filter(|a| a.visible).collect();
    let invisible: Vec<&Answered> = singles.iter().copied().filter(|a| !a.visible).collect();
    let pairs: Vec<&Answered> = of(Set::Pair).filter(|a| a.visible).collect();
    let both = |a: &Answered| a.truth.effects.keys().all(|key| a.chosen(key));
    let both_visible: Vec<&Answered> =
        pairs.iter().copied().filter(|a| both(a) || a.answer.leaves_something()).collect();
    let alarms = |set: Set| share(&of(set).collect::<Vec<_>>(), |a| a.answer.called());
    let outside: Vec<f64> = answers
        .iter()
        .filter(|a| matches!(a.truth.set, Set::LeftOut | Set::Foreign) && a.visible)
        .map(|a| a.answer.unknown_probability)
        .collect();
    let inside: Vec<f64> = visible.iter().map(|a| a.answer.unknown_probability).collect();
    let mut seconds: Vec<f64> = answers.iter().map(|a| a.answer.seconds).collect();
    seconds.sort_by(f64::total_cmp);
    let mut by_effect: BTreeMap<String, [usize; 3]> = BTreeMap::new();
    for answered in &visible {
        for effect in answered.truth.effects.keys() {
            let counts = by_effect.entry(effect.clone()).or_default();
            counts[0] += 1;
            counts[1] += usize::from(answered.ranked(1));
            counts[2] += usize::from(answered.named());
        }
    }
    Scores {
        cases: answers.len(),
        visible: [visible.len(), singles.len()],
        top_1: share(&visible, |a| a.ranked(1)),
        top_1_exact: share(&visible, |a| {
            a.answer.effects.first().is_some_and(|named| a.truth.effects.contains_key(&named.effect))
        }),
        top_2: share(&visible, |a| a.ranked(2)),
        named: share(&visible, |a| a.named()),
        invisible_not_called: share(&invisible, |a| !a.answer.called()),
        pairs: [share(&pairs, both), share(&pairs, |a| a.truth.effects.keys().any(|key| a.chosen(key)))],
        pairs_both_visible: (both_visible.len(), share(&both_visible, both)),
        false_alarms: [alarms(Set::Nominal), alarms(Set::Parameters)],
        auroc_unknown: auroc(&outside, &inside),
        calibration_error: calibration(answers),
        shrink: mean(visible.iter().map(|a| a.answer.shrink.of_removable.clamp(-1.0, 1.0))),
        claimed_gap_error: answers.iter().filter_map(Answered::claim_error).fold(0.0, f64::max),
        leak_error_lpm: [
            leak_error(&visible, |leak| leak.nominal_m2),
            leak_error(&visible, |leak| leak.calibrated_m2),
            leak_error(&visible, |leak| leak.chosen_m2),
        ],
        seconds: [
            seconds.get(seconds.len() / 2).copied().unwrap_or(0.0),
            seconds.last().copied().unwrap_or(0.0),
        ],
        by_effect,
        wrong: answers
            .iter()
            .filter(|a| !a.right())
            .map(Answered::told)
            .chain(answers.iter().filter_map(Answered::misclaimed))
            .collect(),
    }
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0u32), |(sum, count), value| (sum + value, count + 1));
    if count == 0 { f64::NAN } else { sum / f64::from(count) }
}

fn share(answers: &[&Answered], holds: impl Fn(&Answered) -> bool) -> f64 {
    mean(answers.iter().map(|answered| f64::from(u8::from(holds(answered)))))
}

fn leak_error(answers: &[&Answered], of: impl Fn(&Leak) -> Option<f64>) -> f64 {
    let plant = PlantParameters::default();
    let flow = |area: f64| plant.orifice_flow_m3_per_s(area, 7e6) * LPM;
    mean(answers.iter().filter_map(|a| Some((flow(of(&a.answer.leak)?) - flow(a.truth.leak_area_m2)).abs())))
}

/// Probability that one of the first is larger than one of the second; ties count half.
fn auroc(larger: &[f64], smaller: &[f64]) -> f64 {
    let wins = larger.iter().flat_map(|a| {
        smaller.iter().map(move |b| {
            if a > b {
                1.0
            } else if a == b {
                0.5
            } else {
                0.0
            }
        })
    });
    mean(wins)
}

/// Expected calibration error of the most likely answer; the same for calibrated answers of the same confidence; the excess.
fn calibration(answers: &[Answered]) -> [f64; 3] {
    let pairs: Vec<(f64, bool)> = answers.iter().map(|a| (a.confidence().1, a.right())).collect();
    let error = |right: &dyn Fn(usize) -> bool| {
        let mut bins = [(0.0, 0.0, 0u32); BINS];
        for (index, (confidence, _)) in pairs.iter().enumerate() {
            let bin = &mut bins[((confidence * BINS as f64) as usize).min(BINS - 1)];
            bin.0 += confidence;
            bin.1 += f64::from(u8::from(right(index)));
            bin.2 += 1;
        }
        bins.iter().map(|(confidence, right, _)| (confidence - right).abs()).sum::<f64>()
            / pairs.len().max(1) as f64
    };
    let measured = error(&|index| pairs[index].1);
    let mut noise = Noise::new(1, 3);
    let perfect = mean((0..400).map(|_| {
        let drawn: Vec<bool> =
            pairs.iter().map(|(confidence, _)| noise.uniform(0.0, 1.0) < *confidence).collect();
        error(&|index| drawn[index])
    }));
    [measured, perfect, (measured - perfect).max(0.0)]
}

impl Answer {
    /// Whether something is left above the floor after calibration, by the answer itself.
    pub fn visible(&self) -> bool {
        self.is_above_floors(&self.gap.calibrated) || self.gap.calibrated.is_empty()
    }

    /// Whether the machine as chosen leaves a visible gap.
    fn leaves_something(&self) -> bool {
        self.is_above_floors(&self.gap.chosen)
    }

    fn is_above_floors(&self, gaps: &BTreeMap<String, f64>) -> bool {
        let floor = |signal: &String| self.floor.get(signal).copied().unwrap_or(0.0);
        gaps.iter().any(|(signal, gap)| *gap > FLOORS * floor(signal))
    }

    /// Whether something beyond parameters was called.
    fn called(&self) -> bool {
        matches!(self.verdict.as_str(), "effect" | "unknown")
    }
}

impl Named {
    fn presence(&self) -> f64 {
        self.presence_probability.unwrap_or(self.probability)
    }
}

/// The most likely explanation.
enum Explanation<'a> {
    Effect(&'a str),
    Unknown,
    None,
}

impl Answered {
    fn is(&self, effect: &str) -> bool {
        self.truth.effects.keys().any(|truth| truth == effect || class_of(truth).contains(&effect))
    }

    fn ranked(&self, within: usize) -> bool {
        self.answer.effects.iter().take(within).any(|named| self.is(&named.effect))
    }

    fn named(&self) -> bool {
        self.answer.verdict == "effect" && self.answer.chosen.first().is_some_and(|effect| self.is(effect))
    }

    fn chosen(&self, effect: &str) -> bool {
        self.answer
            .chosen
            .iter()
            .any(|chosen| chosen == effect || class_of(effect).contains(&chosen.as_str()))
    }

    /// The most likely explanation, with its class's probability.
    fn confidence(&self) -> (Explanation<'_>, f64) {
        let answer = &self.answer;
        let of_class = |named: &Named| {
            let same =
                |other: &&Named| other.effect == named.effect || named.equivalent.contains(&other.effect);
            answer.effects.iter().filter(same).map(Named::presence).sum::<f64>()
        };
        let effect = answer.effects.first().map_or(0.0, of_class);
        let (unknown, none) = (answer.unknown_probability, answer.no_effect_probability);
        match answer.effects.first() {
            Some(named) if effect >= unknown && effect >= none => {
                (Explanation::Effect(&named.effect), effect.min(1.0))
            }
            _ if unknown >= none => (Explanation::Unknown, unknown),
            _ => (Explanation::None, none),
        }
    }

    /// Whether the most likely explanation is right.
    fn right(&self) -> bool {
        let visible = self.visible;
        match (self.confidence().0, self.truth.set) {
            (Explanation::Effect(effect), Set::Single | Set::Pair) => self.is(effect),
            (Explanation::Unknown, Set::LeftOut | Set::Foreign) => true,
            (Explanation::None, Set::Nominal | Set::Parameters) => true,
            (Explanation::None, _) => !visible,
            _ => false,
        }
    }

    /// How far the claimed gap is from the emitted plant's.
    fn claim_error(&self) -> Option<f64> {
        let measured = self.measured.as_ref()?;
        let differences =
            self.answer.gap.chosen.iter().filter_map(|(signal, claimed)| {
                measured.get(signal).map(|measured| (measured - claimed).abs())
            });
        Some(differences.fold(0.0, f64::max))
    }

    /// What is wrong with the claim, where the emitted plant does not bear it out.
    fn misclaimed(&self) -> Option<String> {
        let difference = self.claim_error().filter(|difference| *difference > LARGEST_CLAIM_ERROR)?;
        Some(format!(
            "{}: the claimed gap is {difference:.1e} of a range from the emitted plant's",
            self.case
        ))
    }

    fn told(&self) -> String {
        let planted: Vec<&str> = self.truth.effects.keys().map(String::as_str).collect();
        let planted = match self.truth.foreign {
            Some(foreign) => foreign.name().to_owned(),
            None if planted.is_empty() => "nothing".into(),
            None => planted.join(" + "),
        };
        let first: Vec<String> = self
            .answer
            .effects
            .iter()
            .take(3)
            .map(|named| format!("{} {:.2}", named.effect, named.presence()))
            .collect();
        format!(
            "{}: {planted} ({:?}{}{}); answered {}: {}, unknown {:.2}, none {:.2}",
            self.case,
            self.truth.set,
            if self.truth.other_law { ", other law" } else { "" },
            if self.truth.parameters.is_empty() { "" } else { ", parameters off" },
            self.answer.verdict,
            first.join(", "),
            self.answer.unknown_probability,
            self.answer.no_effect_probability
        )
    }
}

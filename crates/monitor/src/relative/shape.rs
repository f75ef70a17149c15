//! The duty cycle as the command alone shows it: its period, its strokes and holds.
//!
//! Cycles are laid over each other, each moved to where it is most like those before it; their mean is cut where the command passes a
//! share of its strokes' height. What lies above is a stroke, the rest holds; a cycle begins in the middle of its longest hold, where
//! machines wait. The largest stroke out and the largest back anchor the cycles from then on.

use seepd_features::segment::{MAX_PHASES, MAX_TEMPLATE_BINS};
use seepd_features::{Anchor, CycleReader, CycleState, Feature, Phase, PhaseKind, Projections};
use seepd_model::schema::{Cycle, PhaseFile};

use super::{NO_FILTER, RelativeError, features_of};
use crate::pipeline::observer::Pattern;

/// A stroke's command is at least this share of the strokes' height.
const STROKE_SHARE: f64 = 0.2;
/// The height is what the command's magnitude exceeds in this share of the cycle.
const HEIGHT_SHARE: f64 = 0.1;
/// Shorter parts of a cycle belong to their neighbours, share of the period.
const SHORTEST_SHARE: f64 = 0.02;
/// Command that a template shows before and after its stroke, share of the period.
const SHOULDER_SHARE: f64 = 0.015;
/// How far cycles may be moved to lie over each other, share of the period.
const SHIFT_SHARE: f64 = 0.08;
/// How far the distance between the strokes may be off, share of the period.
const TOLERANCE: f64 = 0.08;
/// Samples of the longest cycle that is held in memory: an hour at 4 kHz.
const MOST_SAMPLES: f64 = 16e6;
/// Least correlation that counts as a stroke.
const LEAST_CORRELATION: f64 = 0.8;
/// A stroke has at least this share of its template's standard deviation.
const DEVIATION_SHARE: f64 = 0.3;

/// The mean cycle in bins, beginning in the middle of its longest hold.
struct MeanCycle {
    values: Vec<f64>,
    period_s: f64,
}

/// A part of the mean cycle, in bins.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Part {
    from: usize,
    to: usize,
    /// Direction of the command: 0 for a hold.
    sign: i8,
}

/// The duty cycle of a command that repeats.
///
/// # Errors
/// [`RelativeError::NoCycle`] where it has not two strokes.
pub(crate) fn cycle_of(pattern: &Pattern) -> Result<Cycle, RelativeError> {
    let mean = MeanCycle::of(pattern);
    let parts = mean.parts();
    let [first, last] = anchoring_strokes(&mean, &parts).ok_or(RelativeError::NoCycle)?;
    let bin_samples = (mean.bin_s() * pattern.sample_rate_hz).round().max(1.0) as usize;
    let reader_bin_s = bin_samples as f64 / pattern.sample_rate_hz;
    let anchors = [mean.anchor(&first, reader_bin_s), mean.anchor(&last, reader_bin_s)];
    let phases = mean.phases(&parts);
    Ok(Cycle {
        period_s: mean.period_s,
        bin_samples,
        tolerance: TOLERANCE,
        anchors,
        further_anchors: Vec::new(),
        demand_mark: None,
        phases,
    })
}

/// The largest stroke out and the largest back, in time order.
fn anchoring_strokes(mean: &MeanCycle, parts: &[Part]) -> Option<[Part; 2]> {
    let area = |part: &Part| mean.values[part.from..part.to].iter().map(|value| value.abs()).sum::<f64>();
    let largest = |sign: i8| {
        let strokes = parts.iter().filter(move |part| part.sign == sign);
        strokes.max_by(|a, b| area(a).total_cmp(&area(b))).copied()
    };
    let (out, back) = (largest(1)?, largest(-1)?);
    Some(if out.from < back.from { [out, back] } else { [back, out] })
}

impl MeanCycle {
    fn of(pattern: &Pattern) -> Self {
        let bins = pattern.period_bins.round() as usize;
        let mut sums: Vec<f64> = pattern.values[..bins].iter().map(|value| f64::from(*value)).collect();
        let reach = (SHIFT_SHARE * bins as f64) as usize;
        let (mut start, mut count) = (0.0, 1.0);
        loop {
            start += pattern.period_bins;
            let planned = start.round() as usize;
            if planned + bins + reach > pattern.values.len() {
                break;
            }
            let shifted = (planned.saturating_sub(reach)..=planned + reach).max_by(|a, b| {
                likeness(&sums, &pattern.values[*a..]).total_cmp(&likeness(&sums, &pattern.values[*b..]))
            });
            let at = shifted.unwrap_or(planned);
            sums.iter_mut().zip(&pattern.values[at..]).for_each(|(sum, value)| *sum += f64::from(*value));
            (start, count) = (at as f64, count + 1.0);
        }
        let mut values: Vec<f64> = sums.into_iter().map(|sum| sum / count).collect();
        let begin = Self::rest(&values);
        values.rotate_left(begin);
        MeanCycle { values, period_s: pattern.period_bins * pattern.bin_s }
    }

    /// Middle of the longest hold, over the cycle's end as well.
    fn rest(values: &[f64]) -> usize {
        let level = stroke_level(values);
        let (mut best, mut run) = ((0, 0), 0);
        for index in 0..2 * values.len() {
            run = if values[index % values.len()].abs() < level { (run + 1).min(values.len()) } else { 0 };
            if run > best.0 {
                best = (run, index);
            }
        }
        (best.1 + values.len() - best.0 / 2) % values.len()
    }

    fn bin_s(&self) -> f64 {
        self.period_s / self.values.len() as f64
    }

    /// Strokes and holds in their order; parts that are too short are their longer neighbour's, until there is room for all.
    fn parts(&self) -> Vec<Part> {
        let level = stroke_level(&self.values);
        let mut parts: Vec<Part> = Vec::new();
        for (bin, value) in self.values.iter().enumerate() {
            let sign = if value.abs() < level { 0 } else { value.signum() as i8 };
            match parts.last_mut() {
                Some(part) if part.sign == sign => part.to = bin + 1,
                _ => parts.push(Part { from: bin, to: bin + 1, sign }),
            }
        }
        let least = (SHORTEST_SHARE * self.values.len() as f64).ceil() as usize;
        while let Some(shortest) =
            (0..parts.len()).min_by_key(|index| parts[*index].to - parts[*index].from).filter(|index| {
                parts.len() > 1 && (parts[*index].to - parts[*index].from < least || parts.len() > MAX_PHASES)
            })
        {
            merge(&mut parts, shortest);
        }
        parts
    }

    fn phases(&self, parts: &[Part]) -> Vec<PhaseFile> {
        let mut numbers = [0, 0];
        let mut phase = |part: &Part| {
            let is_stroke = part.sign != 0;
            let number = &mut numbers[usize::from(is_stroke)];
            *number += 1;
            PhaseFile {
                name: format!("{}_{number}", if is_stroke { "stroke" } else { "hold" }),
                from_s: part.from as f64 * self.bin_s(),
                to_s: part.to as f64 * self.bin_s(),
                kind: if is_stroke { PhaseKind::Stroke } else { PhaseKind::Hold },
            }
        };
        parts.iter().map(&mut phase).collect()
    }

    /// A stroke's template in the reader's bins.
    fn anchor(&self, stroke: &Part, reader_bin_s: f64) -> Anchor<Vec<f32>> {
        let shoulder_s = SHOULDER_SHARE * self.period_s;
        let from_s = (stroke.from as f64 * self.bin_s() - shoulder_s).max(0.0);
        let to_s = (stroke.to as f64 * self.bin_s() + shoulder_s).min(self.period_s);
        let count = (((to_s - from_s) / reader_bin_s) as usize).clamp(2, MAX_TEMPLATE_BINS);
        let end_s = from_s + count as f64 * reader_bin_s;
        let shape: Vec<f64> =
            (0..count).map(|bin| self.at(from_s + (bin as f64 + 0.5) * reader_bin_s)).collect();
        let mean = shape.iter().sum::<f64>() / count as f64;
        let squares: f64 = shape.iter().map(|value| (value - mean).powi(2)).sum();
        let scale = squares.sqrt().max(f64::MIN_POSITIVE);
        Anchor {
            end_s,
            least_correlation: LEAST_CORRELATION,
            // A better match may always follow: strokes of other machines may be alike.
            sure_correlation: 1.0,
            least_deviation: DEVIATION_SHARE * (squares / count as f64).sqrt(),
            wait_s: 0.0,
            template: shape.into_iter().map(|value| ((value - mean) / scale) as f32).collect(),
        }
    }

    /// The command at a time in the cycle, s, linear between the bins' middles.
    fn at(&self, time_s: f64) -> f64 {
        let (count, place) = (self.values.len(), time_s / self.bin_s() - 0.5);
        let below = place.floor();
        let value = |bin: f64| self.values[(bin as i64).rem_euclid(count as i64) as usize];
        value(below) + (place - below) * (value(below + 1.0) - value(below))
    }
}

/// Gives a part to its longer neighbour, which may then join what is of its kind on the other side.
fn merge(parts: &mut Vec<Part>, index: usize) {
    let length =
        |at: Option<usize>| at.and_then(|at| parts.get(at)).map_or(0, |part: &Part| part.to - part.from);
    let into_next = index == 0 || length(Some(index + 1)) > length(index.checked_sub(1));
    let part = parts.remove(index);
    if into_next {
        parts[index].from = part.from;
    } else {
        parts[index - 1].to = part.to;
    }
    parts.dedup_by(|later, earlier| {
        let joins = later.sign == earlier.sign;
        if joins {
            earlier.to = later.to;
        }
        joins
    });
}

/// Command from which on it is a stroke.
fn stroke_level(values: &[f64]) -> f64 {
    let mut sizes: Vec<f64> = values.iter().map(|value| value.abs()).collect();
    sizes.sort_by(|a, b| b.total_cmp(a));
    let height = sizes.get((HEIGHT_SHARE * sizes.len() as f64) as usize).copied().unwrap_or(0.0);
    STROKE_SHARE * height
}

/// How like a mean cycle a stretch of bins is: their product, which is enough to compare shifts.
fn likeness(sums: &[f64], values: &[f32]) -> f64 {
    sums.iter().zip(values).map(|(sum, value)| sum * f64::from(*value)).sum()
}

/// A duty cycle with what a reader borrows of it.
#[derive(Debug)]
pub(crate) struct CycleParts {
    cycle: Cycle,
    sample_rate_hz: f64,
    phases: Vec<Phase>,
    features: Vec<Feature>,
}

self_cell::self_cell!(
    /// A reader of cycles with the duty cycle that it borrows from.
    pub(crate) struct DefinedCycle {
        owner: CycleParts,
        #[covariant]
        dependent: CycleReader,
    }
);

impl DefinedCycle {
    /// # Errors
    /// [`RelativeError`] where the reader has no room for it.
    pub(crate) fn open(cycle: Cycle, sample_rate_hz: f64) -> Result<Self, RelativeError> {
        if cycle.period_s * sample_rate_hz > MOST_SAMPLES {
            return Err(RelativeError::Values { what: "a cycle must have at most 16 million samples" });
        }
        // Strokes at a steady command, as in rapid traverse, are no standstill here: what is to move, only a plan could tell.
        let moving = cycle.phase_list().into_iter();
        let phases: Vec<Phase> = moving.map(|phase| Phase { kind: PhaseKind::Hold, ..phase }).collect();
        let features = features_of(phases.len());
        let parts = CycleParts { cycle, sample_rate_hz, phases, features };
        let cell = DefinedCycle::try_new(parts, |parts| {
            let definition = parts.cycle.definition(parts.sample_rate_hz, &parts.phases, Projections::NONE);
            CycleReader::new(NO_FILTER, definition, &parts.features)
        })?;
        Ok(cell)
    }

    pub(crate) fn reader(&self) -> &CycleReader<'_> {
        self.borrow_dependent()
    }

    pub(crate) fn cycle(&self) -> &Cycle {
        &self.borrow_owner().cycle
    }

    pub(crate) fn sample_rate_hz(&self) -> f64 {
        self.borrow_owner().sample_rate_hz
    }

    /// An empty memory for it.
    pub(crate) fn start(&self) -> Result<CycleState<Vec<f32>>, RelativeError> {
        Ok(self.reader().start(vec![0.0; self.reader().definition().ring_samples()])?)
    }
}

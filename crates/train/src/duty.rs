//! What the monitor must know of a duty cycle, derived from the machine's own plan.

use seepd_features::segment::{MAX_ANCHORS, MAX_PHASES};
use seepd_features::{Anchor, DemandMark, PhaseKind};
use seepd_model::schema::{Cycle, PhaseFile};
use seepd_sim::MachineSpec;
use seepd_sim::cycle::Move;

use crate::train::TrainError;

/// Bins of a cycle, about: 50 ms for the default duty cycle.
const BINS: f64 = 200.0;
/// Command that a template shows before and after its stroke, share of the period: the shoulders tell a stroke
/// from the middle of a longer one.
const SHOULDER_SHARE: f64 = 0.015;
/// Shortest part of a cycle that becomes a phase, share of the period: load ramps are shorter.
const SHORTEST_SHARE: f64 = 0.02;
/// How far the distance between the strokes may be off plan, share of the period.
const TOLERANCE: f64 = 0.06;

/// The largest tolerance that a model may have.
const LARGEST_TOLERANCE: f64 = 0.45;

/// The cycle without its templates, which only simulation can tell.
pub(crate) fn cycle_of(spec: &MachineSpec) -> Result<Cycle, TrainError> {
    let cycle = &spec.cycle;
    let samples = cycle.period_s / spec.controller.log_period_s();
    let AnchoringMoves { largest, further } = anchoring_moves(spec)?;
    let mut row: Vec<usize> = largest.iter().chain(&further).copied().collect();
    row.sort_unstable();
    // What the machine may wait after the moves from one anchor to the next.
    let waits_s =
        |from: usize, to: usize| cycle.moves[from..to].iter().map(|stroke| stroke.wait_s).sum::<f64>();
    let anchor = |index: &usize| {
        let before = row.iter().rev().find(|other| *other < index);
        Anchor {
            end_s: cycle.moves[*index].to_s + SHOULDER_SHARE * cycle.period_s,
            least_correlation: 0.0,
            sure_correlation: 1.0,
            least_deviation: 0.0,
            wait_s: before.map_or(0.0, |before| waits_s(*before, *index)),
            template: Vec::new(),
        }
    };
    let [first, last] = largest;
    let tolerance = if further.is_empty() {
        (TOLERANCE + waits_s(first, last) / cycle.period_s).min(LARGEST_TOLERANCE)
    } else {
        TOLERANCE
    };
    Ok(Cycle {
        period_s: cycle.period_s,
        bin_samples: (samples / BINS).round().max(1.0) as usize,
        tolerance,
        anchors: [anchor(&first), anchor(&last)],
        further_anchors: further.iter().map(anchor).collect(),
        demand_mark: Some(demand_mark(spec, &cycle.moves[first])),
        phases: phases_of(spec, &row),
    })
}

/// Start and end of the windows that the templates show, s: of the two largest moves, then of the further ones.
pub(crate) fn template_windows(spec: &MachineSpec) -> Result<Vec<(f64, f64)>, TrainError> {
    let shoulder = SHOULDER_SHARE * spec.cycle.period_s;
    let AnchoringMoves { largest, further } = anchoring_moves(spec)?;
    let window = |index: usize| {
        let stroke = &spec.cycle.moves[index];
        ((stroke.from_s - shoulder).max(0.0), stroke.to_s + shoulder)
    };
    Ok(largest.into_iter().chain(further).map(window).collect())
}

/// Moves by which cycles are found.
struct AnchoringMoves {
    /// The largest out and the largest back, in time order.
    largest: [usize; 2],
    /// Others, in time order: none where the two tell a cycle.
    further: Vec<usize>,
}

/// A cycle of up to so many moves without waits is told by its largest two, where no other is like them.
const FEW_MOVES: usize = 3;
/// A move the same way that is longer than this share of one of those two may be taken for it.
const ALIKE_SHARE: f64 = 0.25;
/// A move below this share of the fastest one's mean speed moves the valve too little to be found by.
const SLOW_SHARE: f64 = 0.15;

fn anchoring_moves(spec: &MachineSpec) -> Result<AnchoringMoves, TrainError> {
    let moves = &spec.cycle.moves;
    let lengths: Vec<f64> = spec.cycle.moves_from().map(|(from_m, stroke)| stroke.to_m - from_m).collect();
    let largest = largest_moves(&lengths)?;
    let waits = moves[..moves.len() - 1].iter().any(|stroke| stroke.wait_s > 0.0);
    let is_alike =
        |index: usize, other: usize| index != other && lengths[index] / lengths[other] > ALIKE_SHARE;
    let alike = (0..moves.len()).any(|index| largest.iter().any(|other| is_alike(index, *other)));
    if moves.len() <= FEW_MOVES && !waits && !alike {
        return Ok(AnchoringMoves { largest, further: Vec::new() });
    }
    let speed = |index: usize| (lengths[index] / (moves[index].to_s - moves[index].from_s)).abs();
    let fastest = (0..moves.len()).map(speed).fold(0.0, f64::max);
    let mut further: Vec<usize> = (0..moves.len())
        .filter(|index| !largest.contains(index) && speed(*index) >= SLOW_SHARE * fastest)
        .collect();
    further.sort_unstable_by(|a, b| lengths[*b].abs().total_cmp(&lengths[*a].abs()));
    further.truncate(MAX_ANCHORS - largest.len());
    further.sort_unstable();
    Ok(AnchoringMoves { largest, further })
}

/// The largest move out and the largest move back, in time order.
fn largest_moves(lengths: &[f64]) -> Result<[usize; 2], TrainError> {
    let largest = |sign: f64| {
        (0..lengths.len())
            .filter(|i| sign * lengths[*i] > 0.0)
            .max_by(|a, b| lengths[*a].abs().total_cmp(&lengths[*b].abs()))
    };
    match (largest(1.0), largest(-1.0)) {
        (Some(out), Some(back)) => Ok([out.min(back), out.max(back)]),
        _ => Err(TrainError::NoStroke),
    }
}

fn demand_mark(spec: &MachineSpec, first: &Move) -> DemandMark {
    let before = spec.cycle.demand_m(first.from_s);
    DemandMark {
        level_m: 0.5 * (before + first.to_m),
        at_s: first.at_s(first.half_way()),
        rising: first.to_m > before,
    }
}

/// Strokes by their names, holds between them by number; a load step within a hold divides it. Where events end holds between a phase and
/// the stroke by which it is timed, a hold keeps the part that it has in every cycle, and a stroke whose place is not sure is no phase.
fn phases_of(spec: &MachineSpec, anchors: &[usize]) -> Vec<PhaseFile> {
    let cycle = &spec.cycle;
    let mut phases: Vec<PhaseFile> = Vec::new();
    let mut holds = 0;
    let mut hold = |(from_s, to_s): (f64, f64), phases: &mut Vec<PhaseFile>| {
        let mut edges: Vec<f64> = vec![from_s];
        edges.extend(cycle.load.iter().map(|corner| corner.at_s).filter(|at| *at > from_s && *at < to_s));
        edges.push(to_s);
        for edge in edges.windows(2).filter(|edge| edge[1] - edge[0] >= SHORTEST_SHARE * cycle.period_s) {
            holds += 1;
            phases.push(PhaseFile {
                name: format!("hold_{holds}"),
                from_s: edge[0],
                to_s: edge[1],
                kind: PhaseKind::Hold,
            });
        }
    };
    let shifts = Shifts { moves: &cycle.moves, anchors };
    let mut time = 0.0;
    for (index, stroke) in cycle.moves.iter().enumerate() {
        hold(shifts.hold(index, (time, stroke.from_s)), &mut phases);
        if shifts.of_stroke(index) <= SURE_SHARE * cycle.period_s {
            phases.push(PhaseFile {
                name: stroke.name.clone(),
                from_s: stroke.from_s,
                to_s: stroke.to_s,
                kind: PhaseKind::Stroke,
            });
        }
        time = stroke.to_s;
    }
    hold(shifts.hold(cycle.moves.len(), (time, cycle.period_s)), &mut phases);
    keep_the_longest(&mut phases);
    phases
}

/// A stroke that events may shift by more than this share of the period is no phase.
const SURE_SHARE: f64 = 0.01;

/// How far events may shift what is timed by an anchoring stroke.
struct Shifts<'a> {
    moves: &'a [Move],
    anchors: &'a [usize],
}

impl Shifts<'_> {
    /// The anchor by which a part of the cycle is timed: the one whose end is nearest.
    fn anchor(&self, from_s: f64, to_s: f64) -> usize {
        let far = |index: &&usize| (0.5 * (from_s + to_s) - self.moves[**index].to_s).abs();
        self.anchors.iter().min_by(|a, b| far(a).total_cmp(&far(b))).copied().unwrap_or_default()
    }

    /// Waits after the moves of a range, s.
    fn waits(&self, from: usize, to: usize) -> f64 {
        self.moves.get(from..to).unwrap_or_default().iter().map(|stroke| stroke.wait_s).sum()
    }

    fn of_stroke(&self, index: usize) -> f64 {
        let stroke = &self.moves[index];
        let anchor = self.anchor(stroke.from_s, stroke.to_s);
        self.waits(anchor, index) + self.waits(index, anchor)
    }

    /// The part of the hold before a move that every cycle has: later holds begin later, earlier ones end earlier.
    fn hold(&self, before: usize, (from_s, to_s): (f64, f64)) -> (f64, f64) {
        let anchor = self.anchor(from_s, to_s);
        let begins_s = from_s + self.waits(anchor, before.saturating_sub(1));
        (begins_s, (to_s - self.waits(before, anchor)).max(begins_s))
    }
}

/// Leaves out the shortest phases where a cycle has more than a reader has room for.
fn keep_the_longest(phases: &mut Vec<PhaseFile>) {
    while phases.len() > MAX_PHASES {
        let length = |phase: &PhaseFile| phase.to_s - phase.from_s;
        let by_length = |a: &usize, b: &usize| length(&phases[*a]).total_cmp(&length(&phases[*b]));
        let Some(shortest) = (0..phases.len()).min_by(by_length) else { return };
        phases.remove(shortest);
    }
}

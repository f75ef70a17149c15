//! From samples to cycles with features.

use core::fmt;

use seepd_signals::{Sample, Signal};

use crate::feature::Feature;
use crate::intake::{Admission, Counts, IntakeState};
use crate::kalman::{Kalman, KalmanState};
use crate::load::{LoadState, PistonAreas};
use crate::noise::NoiseState;
use crate::segment::{
    CycleDefinition, MAX_ANCHORS, MAX_CYCLE_BINS, MAX_PHASES, MAX_TEMPLATE_BINS, Orphan, PhaseKind,
    SegmentEvent, SegmentState, Span,
};
use crate::statistics::{CycleStatistics, RingView, Timeline};

/// Why a cycle is not used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Reason {
    /// Begins before the log or ends after it, or a stroke is missing.
    Incomplete,
    /// Samples are missing.
    Gap,
    /// The same cycle again.
    Duplicate,
    /// Time went backwards within it.
    OutOfOrder,
    /// The command was not a number.
    NotANumber,
    /// The command lay outside of −1 … 1.
    OutOfRange,
    /// The command did not change while the machine had to move.
    Stuck,
    /// Samples came at another rate than the model's.
    WrongRate,
}

impl Reason {
    /// The reason's name in messages and summaries.
    pub const fn name(self) -> &'static str {
        match self {
            Reason::Incomplete => "incomplete",
            Reason::Gap => "gap",
            Reason::Duplicate => "duplicate",
            Reason::OutOfOrder => "out_of_order",
            Reason::NotANumber => "not_a_number",
            Reason::OutOfRange => "out_of_range",
            Reason::Stuck => "stuck",
            Reason::WrongRate => "wrong_rate",
        }
    }
}

/// Why cycles cannot be read so.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum ReaderError {
    /// The definition has more of something than the reader has room for.
    TooMany {
        /// What: `features`, `phases`, `bins of a template` or `bins of a cycle`.
        what: &'static str,
        /// How many there are.
        given: usize,
        /// How many there may be.
        most: usize,
    },
    /// The memory does not hold a cycle: its features would be those of another part of the command.
    RingTooShort {
        /// Samples that it holds.
        given: usize,
        /// Samples that it must hold, [`CycleDefinition::ring_samples`].
        needed: usize,
    },
}

impl fmt::Display for ReaderError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            ReaderError::TooMany { what, given, most } => {
                write!(f, "{given} {what}; at most {most} are read")
            }
            ReaderError::RingTooShort { given, needed } => {
                write!(f, "a memory of {given} samples does not hold a cycle, which takes {needed}")
            }
        }
    }
}

impl core::error::Error for ReaderError {}

/// A cycle with its features.
#[derive(Debug, Clone, Copy)]
pub struct ValidCycle<'a> {
    /// Start, ns.
    pub start_ns: i64,
    /// End, ns.
    pub end_ns: i64,
    /// Features in the reader's order.
    pub features: &'a [f64],
    /// What the features were read off.
    pub statistics: &'a CycleStatistics,
}

/// A cycle that is not used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RejectedCycle {
    /// Start, as far as it can be told, ns.
    pub start_ns: i64,
    /// End, as far as it can be told, ns.
    pub end_ns: i64,
    /// Why.
    pub reason: Reason,
}

/// What becomes of a duty cycle.
#[derive(Debug, Clone, Copy)]
pub enum Outcome<'a> {
    /// It has features.
    Valid(ValidCycle<'a>),
    /// It is not used.
    Rejected(RejectedCycle),
}

/// Reads cycles: the configuration, which are the filter, the duty cycle, and the features that are wanted.
///
/// The [crate's page](crate) has an example.
#[derive(Debug, Clone, Copy)]
pub struct CycleReader<'m> {
    filter: Option<Kalman>,
    definition: CycleDefinition<'m>,
    features: &'m [Feature],
    /// Sample period, ns.
    period_ns: f64,
    /// Samples after which a command that stands still in a stroke is stuck.
    stuck_samples: i64,
    areas: Option<PistonAreas>,
}

/// Most features of a cycle.
pub const MAX_FEATURES: usize = 64;
/// Cycles that are remembered to recognise a repeated one.
const REMEMBERED_CYCLES: usize = 64;
/// Late or duplicated samples that a cycle may hold and still be used: they are left out, and nothing is lost.
const STRAY_SAMPLES: u64 = 10;
/// A command that stands still for this share of the period within a stroke is stuck.
const STUCK_SHARE: f64 = 0.04;
/// Standstills that are remembered.
const REMEMBERED_RUNS: usize = 8;

/// Everything that reading remembers; `B` is the memory for a cycle's samples, at least
/// [`CycleDefinition::ring_samples`] long. It comes from [`CycleReader::start`].
#[derive(Debug, Clone)]
pub struct CycleState<B> {
    counts: Counts,
    intake: IntakeState,
    kalman: KalmanState,
    noise: NoiseState,
    load: LoadState,
    segment: SegmentState,
    ring: B,
    cursor: usize,
    filled: i64,
    /// Number of the next sample since the last restart.
    next: i64,
    last_ns: i64,
    last_command: f64,
    /// Counts at the end of the last cycle.
    counts_before: Counts,
    /// A cycle whose last samples are still to come.
    open: Option<Span>,
    gapless: GaplessSegment,
    /// An orphaned stroke that no cycle has been found around yet.
    orphan: Option<Orphan>,
    /// Standstills: first and last sample number.
    runs: [(i64, i64); REMEMBERED_RUNS],
    run_start: i64,
    starts: StartMarks,
    seen: [SeenCycle; REMEMBERED_CYCLES],
    seen_count: usize,
}

/// Samples without a gap between them, numbered from 0.
#[derive(Debug, Clone, Copy)]
struct GaplessSegment {
    /// Why it began, and so why cycles that began before it are lost.
    reason: Reason,
    /// End of the last cycle that was reported, used or not, numbered as in this segment; `None` before the first.
    reported_end: Option<i64>,
    /// Whether a cycle has shown what the gap cost.
    accounted: bool,
}

impl Default for GaplessSegment {
    fn default() -> Self {
        GaplessSegment { reason: Reason::Incomplete, reported_end: None, accounted: false }
    }
}

impl GaplessSegment {
    /// Whether the cycle with that end has been reported already, give or take a quarter of a period.
    fn has_reported(&self, end: i64, period: i64) -> bool {
        self.reported_end.is_some_and(|reported| end <= reported + period / 4)
    }
}

/// What a repeated cycle is recognised by.
#[derive(Debug, Clone, Copy, Default)]
struct SeenCycle {
    start_ns: i64,
    mean: f64,
    standard_deviation: f64,
}

impl SeenCycle {
    /// The same time and the same command: the log holds this cycle twice. The filter starts anew where the log
    /// jumps back, which moves the moments by less than 2e-5; the noise of two different cycles moves them as
    /// much, but a clock that is set back hardly ever hits the start to 5 ms as well.
    fn is_same(&self, other: &SeenCycle) -> bool {
        self.start_ns.abs_diff(other.start_ns) < 5_000_000
            && (self.mean - other.mean).abs() < 2e-5
            && (self.standard_deviation - other.standard_deviation).abs() < 2e-5
    }
}

/// Starts of cycles as the demand or a start-of-cycle signal tells them.
#[derive(Debug, Clone, Copy, Default)]
struct StartMarks {
    /// The signal at the last sample.
    before: Option<f64>,
    marks: [i64; 4],
    count: usize,
}

impl<B: AsRef<[f32]> + AsMut<[f32]>> CycleState<B> {
    fn new(ring: B) -> Self {
        CycleState {
            counts: Counts::default(),
            intake: IntakeState::default(),
            kalman: KalmanState::default(),
            noise: NoiseState::default(),
            load: LoadState::default(),
            segment: SegmentState::default(),
            ring,
            cursor: 0,
            filled: 0,
            next: 0,
            last_ns: 0,
            last_command: 0.0,
            counts_before: Counts::default(),
            open: None,
            gapless: GaplessSegment::default(),
            orphan: None,
            runs: [(0, 0); REMEMBERED_RUNS],
            run_start: 0,
            starts: StartMarks::default(),
            seen: [SeenCycle::default(); REMEMBERED_CYCLES],
            seen_count: 0,
        }
    }

    /// Samples used and left out so far.
    pub fn counts(&self) -> &Counts {
        &self.counts
    }

    /// Rate of the samples, Hz, where it is not the model's.
    pub fn wrong_rate_hz(&self) -> Option<f64> {
        self.intake.wrong_rate_hz
    }

    /// For how many samples the command has not changed by a bit.
    pub fn standstill_samples(&self) -> i64 {
        self.next - self.run_start
    }

    fn view(&self) -> RingView<'_> {
        RingView::new(self.ring.as_ref(), self.next, self.filled, self.cursor)
    }

    fn time_ns(&self, number: i64, period_ns: f64) -> i64 {
        self.last_ns.saturating_sub(((self.next - 1 - number) as f64 * period_ns) as i64)
    }
}

impl<'m> CycleReader<'m> {
    /// A reader with that filter (`None` takes the command as it is) for that duty cycle, giving those features in
    /// that order.
    ///
    /// # Errors
    /// [`ReaderError::TooMany`] features, phases or bins.
    pub fn new(
        filter: Option<Kalman>,
        definition: CycleDefinition<'m>,
        features: &'m [Feature],
    ) -> Result<Self, ReaderError> {
        let anchors = &definition.anchors;
        let template =
            anchors.as_slice().iter().map(|anchor| anchor.template.len()).max().unwrap_or_default();
        for (what, given, most) in [
            ("features", features.len(), MAX_FEATURES),
            ("phases", definition.phases.len(), MAX_PHASES),
            ("strokes by which cycles are found", anchors.count(), MAX_ANCHORS),
            ("bins of a template", template, MAX_TEMPLATE_BINS),
            ("bins of a cycle", definition.cycle_bins(), MAX_CYCLE_BINS),
        ] {
            if given > most {
                return Err(ReaderError::TooMany { what, given, most });
            }
        }
        Ok(CycleReader {
            filter,
            definition,
            features,
            period_ns: 1e9 / definition.sample_rate_hz,
            stuck_samples: (STUCK_SHARE * definition.period_s * definition.sample_rate_hz) as i64,
            areas: None,
        })
    }

    /// The beginning, with an empty memory: at least [`CycleDefinition::ring_samples`] samples.
    ///
    /// # Errors
    /// [`ReaderError::RingTooShort`].
    pub fn start<B: AsRef<[f32]> + AsMut<[f32]>>(&self, ring: B) -> Result<CycleState<B>, ReaderError> {
        let (given, needed) = (ring.as_ref().len(), self.definition.ring_samples());
        if given < needed {
            return Err(ReaderError::RingTooShort { given, needed });
        }
        Ok(CycleState::new(ring))
    }

    /// The same, which takes the load from the chambers' pressures where the samples have no load.
    #[must_use]
    pub fn with_piston_areas(self, areas: Option<PistonAreas>) -> Self {
        CycleReader { areas, ..self }
    }

    /// The duty cycle.
    pub fn definition(&self) -> &CycleDefinition<'m> {
        &self.definition
    }

    /// Samples that a whole cycle may lack of a part outside of its two strokes that is planned to last `planned_s`: a bin, to which the
    /// strokes' places are certain where a knock falls into one, and what a cycle that runs faster than planned saves there. More
    /// is a cycle that began before the gapless segment, or ends after it.
    fn bearable_samples(&self, span: &Span, planned_s: f64) -> i64 {
        let saved_s = (1.0 - self.definition.pace_of(span)).max(0.0) * planned_s;
        self.definition.bin_samples as i64 + libm::round(saved_s * self.definition.sample_rate_hz) as i64
    }

    /// Whether the cycle's first samples are there.
    fn has_begin(&self, span: &Span) -> bool {
        -span.start <= self.bearable_samples(span, self.definition.anchors.first().end_s)
    }

    /// Whether the cycle's last samples are there, `next` being the number of the first that is not.
    fn has_end(&self, span: &Span, next: i64) -> bool {
        span.end - next <= self.bearable_samples(span, self.definition.after_last_stroke_s())
    }

    /// Takes a sample; `sink` hears of each cycle that it completes or spoils.
    #[inline]
    pub fn push<B: AsRef<[f32]> + AsMut<[f32]>>(
        &self,
        state: &mut CycleState<B>,
        sample: &Sample,
        sink: &mut impl FnMut(Outcome<'_>),
    ) {
        state.load.take(&self.definition, self.areas, state.next, sample);
        match state.intake.admit(&mut state.counts, sample, self.period_ns) {
            Admission::Drop => return,
            Admission::Use { command, bridged } => {
                for _ in 0..bridged {
                    let held = state.last_command;
                    self.take(state, held, sink);
                }
                state.last_ns = sample.time_ns;
                self.take(state, command, sink);
            }
            Admission::Restart { command, reason } => {
                let lost_ns = sample.time_ns.saturating_sub(state.last_ns).max(0);
                let lost = libm::round(lost_ns as f64 / self.period_ns) as i64 - 1;
                self.restart(state, reason, lost.max(0), sink);
                state.last_ns = sample.time_ns;
                state.last_command = command;
                self.take(state, command, sink);
            }
        }
        self.mark_start(state, sample);
    }

    /// Start of the cycle, ns, of which the first stroke has been seen and the outcome is still to come; the earliest, if there are
    /// several.
    pub fn begun_ns<B: AsRef<[f32]> + AsMut<[f32]>>(&self, state: &CycleState<B>) -> Option<i64> {
        let open = state.open.map(|span| span.start);
        let awaited = state.segment.awaited(&self.definition, state.next);
        open.into_iter().chain(awaited).min().map(|start| state.time_ns(start, self.period_ns))
    }

    /// Ends the stream: what is under way is incomplete.
    pub fn finish<B: AsRef<[f32]> + AsMut<[f32]>>(
        &self,
        state: &mut CycleState<B>,
        sink: &mut impl FnMut(Outcome<'_>),
    ) {
        self.restart(state, Reason::Incomplete, 0, sink);
    }

    /// Forgets the samples: what was under way is lost for `reason`; the next sample comes `lost` samples later.
    fn restart<B: AsRef<[f32]> + AsMut<[f32]>>(
        &self,
        state: &mut CycleState<B>,
        reason: Reason,
        lost: i64,
        sink: &mut impl FnMut(Outcome<'_>),
    ) {
        match state.segment.flush(&self.definition) {
            Some(SegmentEvent::Cycle(span)) => self.found(state, span, sink),
            Some(SegmentEvent::OrphanedLastStroke(orphan)) => self.orphaned(state, orphan, sink),
            None => {}
        }
        if let Some(span) = state.open.take() {
            if self.has_end(&span, state.next) {
                self.close(state, &span, sink);
            } else {
                self.reject(state, span.start, span.end, reason, sink);
            }
        } else if let Some((start, correlation)) = state.segment.cycle_under_way(&self.definition, state.next)
        {
            // Of two strokes at the wrong distance one is a bump: the one that matches worse.
            let is_bump =
                state.orphan.is_some_and(|orphan| orphan.end > start && orphan.correlation > correlation);
            if !is_bump {
                state.orphan = state.orphan.filter(|orphan| orphan.end <= start);
                self.reject_orphan(state, sink);
                self.reject(state, start, start + self.definition.cycle_samples() as i64, reason, sink);
            }
        }
        self.reject_orphan(state, sink);
        let begins = state.next + lost;
        state.gapless = GaplessSegment {
            reason,
            reported_end: state.gapless.reported_end.map(|end| end.saturating_sub(begins)),
            accounted: false,
        };
        state.segment = SegmentState::default();
        state.kalman = KalmanState::default();
        state.noise = NoiseState::default();
        state.load = LoadState::default();
        state.filled = 0;
        state.next = 0;
        state.run_start = 0;
        state.runs = [(0, 0); REMEMBERED_RUNS];
        state.starts = StartMarks::default();
    }

    #[inline]
    fn take<B: AsRef<[f32]> + AsMut<[f32]>>(
        &self,
        state: &mut CycleState<B>,
        command: f64,
        sink: &mut impl FnMut(Outcome<'_>),
    ) {
        let number = state.next;
        state.noise.take(command);
        self.note_standstill(state, command, number);
        let filtered = match &self.filter {
            Some(kalman) => kalman.step(&mut state.kalman, command),
            None => command,
        };
        let ring = state.ring.as_mut();
        let length = ring.len();
        if let Some(slot) = ring.get_mut(state.cursor) {
            *slot = filtered as f32;
        }
        state.cursor = if state.cursor + 1 >= length { 0 } else { state.cursor + 1 };
        state.filled = (state.filled + 1).min(length as i64);
        state.next += 1;
        match state.segment.push(&self.definition, number, filtered) {
            Some(SegmentEvent::Cycle(span)) => self.found(state, span, sink),
            Some(SegmentEvent::OrphanedLastStroke(orphan)) => self.orphaned(state, orphan, sink),
            None => {}
        }
        if let Some(span) = state.open.filter(|span| state.next >= span.end) {
            state.open = None;
            self.close(state, &span, sink);
        }
    }

    #[inline]
    fn note_standstill<B>(&self, state: &mut CycleState<B>, command: f64, number: i64) {
        if command == state.last_command && number > 0 {
            return;
        }
        // Saturated, the command may stand still and be right.
        if number - state.run_start > self.stuck_samples && state.last_command.abs() < 0.999 {
            state.runs.rotate_right(1);
            state.runs[0] = (state.run_start, number);
        }
        state.run_start = number;
        state.last_command = command;
    }

    /// A start-of-cycle signal's rise, or else the demand's crossing, where the log has one.
    #[inline]
    fn mark_start<B>(&self, state: &mut CycleState<B>, sample: &Sample) {
        let (now, level, at_s, rising) = if let Some(now) = sample.get(Signal::CycleStart) {
            (now, 0.5, 0.0, true)
        } else if let (Some(now), Some(mark)) = (sample.get(Signal::Demand), self.definition.demand_mark) {
            (now, mark.level_m, mark.at_s, mark.rising)
        } else {
            return;
        };
        let marks = &mut state.starts;
        if !now.is_finite() {
            return;
        }
        if let Some(before) = marks.before
            && (before > level) != (now > level)
            && (now > level) == rising
        {
            // The crossing lies between two samples.
            let crossing = (state.next - 1) as f64 - (now - level) / (now - before);
            let start = libm::round(crossing - at_s * self.definition.sample_rate_hz) as i64;
            // A bit that rises does so at its sample.
            marks.marks[marks.count % marks.marks.len()] = if at_s > 0.0 { start } else { state.next - 1 };
            marks.count += 1;
        }
        marks.before = Some(now);
    }

    /// The start-of-cycle mark near a start, if the log has such marks.
    fn marked_start<B>(&self, state: &CycleState<B>, start: i64) -> Option<i64> {
        let near = self.definition.tolerance * self.definition.period_s * self.definition.sample_rate_hz;
        let marks = &state.starts;
        let known = marks.marks.iter().take(marks.count.min(marks.marks.len()));
        known
            .copied()
            .filter(|mark| ((mark - start) as f64).abs() <= near)
            .min_by_key(|mark| (mark - start).abs())
    }

    fn found<B: AsRef<[f32]> + AsMut<[f32]>>(
        &self,
        state: &mut CycleState<B>,
        mut span: Span,
        sink: &mut impl FnMut(Outcome<'_>),
    ) {
        if let Some(previous) = state.open.take() {
            // This cycle's last stroke came before the previous cycle's planned end: that one ends with the samples that there are.
            self.close(state, &Span { end: previous.end.min(state.next), ..previous }, sink);
        }
        if let Some(mark) = self.marked_start(state, span.start) {
            span.start = mark;
        }
        // An orphaned stroke within the cycle was a bump.
        state.orphan = state.orphan.filter(|orphan| orphan.end <= span.start);
        self.reject_orphan(state, sink);
        if !self.has_begin(&span) {
            if !state.gapless.has_reported(span.end, self.definition.cycle_samples() as i64) {
                self.reject(state, span.start, span.end, state.gapless.reason, sink);
            }
            state.gapless.accounted = true;
            return;
        }
        self.account_for_gap(state, sink);
        state.open = Some(span);
    }

    /// A gap that swallowed both strokes of a cycle, or whole cycles, has left nothing to find: the time since
    /// the last reported cycle tells.
    fn account_for_gap<B: AsRef<[f32]> + AsMut<[f32]>>(
        &self,
        state: &mut CycleState<B>,
        sink: &mut impl FnMut(Outcome<'_>),
    ) {
        let accounted = core::mem::replace(&mut state.gapless.accounted, true);
        if let Some(end) = state.gapless.reported_end
            && !accounted
            && -end > self.definition.cycle_samples() as i64 / 2
        {
            self.reject(state, end, 0, state.gapless.reason, sink);
        }
    }

    /// A last stroke without its first: of a cycle that is not all there, or a bump within a cycle that a large leak
    /// makes look like one, which the cycle found around it will tell.
    fn orphaned<B: AsRef<[f32]> + AsMut<[f32]>>(
        &self,
        state: &mut CycleState<B>,
        orphan: Orphan,
        sink: &mut impl FnMut(Outcome<'_>),
    ) {
        let period = self.definition.cycle_samples() as i64;
        let cycle_end = orphan.end + self.samples_after_last_stroke();
        if state.gapless.has_reported(cycle_end, period) {
            state.gapless.accounted = true;
            return;
        }
        match state.orphan {
            Some(before) if orphan.end - before.end > period / 2 => self.reject_orphan(state, sink),
            Some(before) if before.correlation >= orphan.correlation => return,
            _ => {}
        }
        state.orphan = Some(orphan);
    }

    fn reject_orphan<B: AsRef<[f32]> + AsMut<[f32]>>(
        &self,
        state: &mut CycleState<B>,
        sink: &mut impl FnMut(Outcome<'_>),
    ) {
        if let Some(orphan) = state.orphan.take() {
            let end = orphan.end + self.samples_after_last_stroke();
            let start = end - self.definition.cycle_samples() as i64;
            let reason = if start < 0 { state.gapless.reason } else { Reason::Incomplete };
            state.gapless.accounted |= start < 0;
            self.reject(state, start.max(0), end, reason, sink);
        }
    }

    /// Samples from the last stroke's anchor to the cycle's end, as planned.
    fn samples_after_last_stroke(&self) -> i64 {
        libm::round(self.definition.after_last_stroke_s() * self.definition.sample_rate_hz) as i64
    }

    fn reject<B: AsRef<[f32]> + AsMut<[f32]>>(
        &self,
        state: &mut CycleState<B>,
        start: i64,
        end: i64,
        reason: Reason,
        sink: &mut impl FnMut(Outcome<'_>),
    ) {
        state.counts_before = state.counts;
        state.gapless.reported_end = Some(end);
        let period_ns = self.period_ns;
        sink(Outcome::Rejected(RejectedCycle {
            start_ns: state.time_ns(start, period_ns),
            end_ns: state.time_ns(end.min(state.next), period_ns),
            reason,
        }));
    }

    /// All samples of a cycle are there: check it and compute its features.
    #[inline(never)]
    fn close<B: AsRef<[f32]> + AsMut<[f32]>>(
        &self,
        state: &mut CycleState<B>,
        span: &Span,
        sink: &mut impl FnMut(Outcome<'_>),
    ) {
        let period_ns = self.period_ns;
        let start_ns = state.time_ns(span.start, period_ns);
        let end_ns = state.time_ns(span.end, period_ns);
        let mut statistics = CycleStatistics::of(&self.definition, &state.view(), span);
        statistics.noise = state.noise.deviation();
        statistics.load = state.load.summary(&self.definition, span);
        let mut features = [0.0; MAX_FEATURES];
        for (value, feature) in features.iter_mut().zip(self.features) {
            *value = feature.of(&self.definition, &statistics);
        }
        let wanted = features.get(..self.features.len()).unwrap_or(&features);
        if let Some(reason) = self.objection(state, span, start_ns, &statistics) {
            self.reject(state, span.start, span.end, reason, sink);
            return;
        }
        state.counts_before = state.counts;
        state.gapless.reported_end = Some(span.end);
        sink(Outcome::Valid(ValidCycle { start_ns, end_ns, features: wanted, statistics: &statistics }));
    }

    fn objection<B>(
        &self,
        state: &mut CycleState<B>,
        span: &Span,
        start_ns: i64,
        statistics: &CycleStatistics,
    ) -> Option<Reason> {
        let (now, before) = (&state.counts, &state.counts_before);
        if now.duplicate - before.duplicate > STRAY_SAMPLES {
            return Some(Reason::Duplicate);
        }
        if now.out_of_order - before.out_of_order > STRAY_SAMPLES {
            return Some(Reason::OutOfOrder);
        }
        if self.is_stuck(state, span) {
            return Some(Reason::Stuck);
        }
        let moments = &statistics.moments;
        let cycle =
            SeenCycle { start_ns, mean: moments.mean, standard_deviation: moments.standard_deviation };
        if state.seen.iter().take(state.seen_count.min(REMEMBERED_CYCLES)).any(|seen| seen.is_same(&cycle)) {
            return Some(Reason::Duplicate);
        }
        state.seen[state.seen_count % REMEMBERED_CYCLES] = cycle;
        state.seen_count += 1;
        None
    }

    /// Whether a standstill overlaps a stroke by more than is plausible.
    fn is_stuck<B>(&self, state: &CycleState<B>, span: &Span) -> bool {
        let timeline = Timeline { definition: &self.definition, span };
        let strokes = self.definition.phases.iter().filter(|phase| phase.kind == PhaseKind::Stroke);
        strokes.map(|phase| timeline.range(phase.from_s, phase.to_s)).any(|(from, to)| {
            state.runs.iter().any(|(start, end)| (*end).min(to) - (*start).max(from) > self.stuck_samples)
        })
    }
}

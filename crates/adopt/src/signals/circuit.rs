//! Pressures: which of the circuit's places each column is from.
//!
//! The supply is above all others. Of the two chambers, the cap's is the one that the command raises beyond what the piston's speed makes
//! up for, and the one that swings less where both swing together: a piston in balance weighs them by its areas, and the cap's is the
//! larger.

use std::collections::BTreeMap;

use seepd_signals::Signal;

use super::correlation::partial;
use super::full_scale::number;
use super::names::{Port, Role};
use super::smooth::Smoothed;
use super::trace::{Character, Trace};
use super::units::Quantity;
use super::{Assigned, Candidate, Hints, Outcome, Question, SignalProposal, mapping_to, shown};

/// Units of pressure without a name, with what they are in Pa.
const UNITS: &[(f64, &str)] =
    &[(1e5, "bar"), (1e6, "MPa"), (1.0, "Pa"), (6_894.757_293_168, "psi"), (1e3, "kPa")];
/// Highest pressures of hydraulic machines, Pa.
const HIGHEST_PA: std::ops::RangeInclusive<f64> = 5e5..=7e7;
/// Highest values without a unit that are bar by custom, and such that can only be Pa.
const BAR: std::ops::RangeInclusive<f64> = 60.0..=450.0;
const PASCAL: std::ops::RangeInclusive<f64> = 5e5..=7e7;
/// A pressure of a machine whose supply is known is between these shares of it at its highest.
const OF_SUPPLY: std::ops::RangeInclusive<f64> = 0.1..=1.3;
/// Below the atmosphere by more than this, Pa, there is no pressure.
const LEAST_PA: f64 = -1.1e5;
/// Share of the samples at which the supply is above a chamber.
const ABOVE: f64 = 0.97;
/// How much of the highest pressure transducers may differ by.
const TRANSDUCERS: f64 = 0.01;
/// Stretches over which changes of pressures are taken, s: oil is compressed within hundredths of a second.
const STRETCHES_S: [f64; 3] = [0.005, 0.02, 0.06];
/// Partial correlation from which the sign of what the command does to a pressure is believed.
const RAISED: f64 = 0.06;
/// Swings of the chambers within this of each other tell no areas apart.
const EVEN_SWINGS: f64 = 0.06;

/// Command, and position where it is known, at the traces' rate.
pub(super) struct Drive<'a> {
    /// Share of full command.
    pub(super) command: Vec<f64>,
    /// m.
    pub(super) position: Option<Vec<f64>>,
    pub(super) rate_hz: f64,
    pub(super) hints: &'a Hints,
}

/// A column that is a pressure.
struct Gauge<'a, 't> {
    trace: &'a Trace<'t>,
    /// Pa for each of the column's unit.
    scale: f64,
    /// How sure the scale is, and why.
    sure: f64,
    why: String,
    port: Port,
    mean_pa: f64,
}

impl Gauge<'_, '_> {
    fn pa(&self, at: usize) -> f64 {
        self.trace.values[at] * self.scale
    }
}

/// Settles the pressures.
pub(super) fn propose(traces: &[Trace<'_>], drive: &Drive<'_>, proposal: &mut SignalProposal) {
    let taken: Vec<usize> = proposal.assigned.values().map(|assigned| assigned.column).collect();
    let (mut gauges, mut open) = (Vec::new(), Vec::new());
    for trace in traces.iter().filter(|trace| is_pressure(trace) && !taken.contains(&trace.index)) {
        match scale(trace, drive.hints) {
            Scale::Sure(scale, sure, why) => gauges.push(gauge(trace, scale, sure, why)),
            Scale::Open(ways, why) => open.push((trace, ways, why)),
        }
    }
    for (trace, ways, why) in open {
        if let Some(signal) =
            trace.name.port().signal.filter(|signal| !proposal.assigned.contains_key(signal))
        {
            proposal.questions.push(ask_unit(signal, trace, ways, &why));
        }
    }
    let circuit = Circuit { gauges, drive };
    for (signal, outcome) in circuit.settled() {
        if !proposal.assigned.contains_key(&signal) {
            proposal.settle(signal, outcome);
        }
    }
}

fn is_pressure(trace: &Trace<'_>) -> bool {
    let role = trace.name.role();
    trace.character == Character::Moving
        && match trace.unit.map(|unit| unit.quantity) {
            Some(Quantity::Pressure) => role != Role::Other && role != Role::Error,
            None => role == Role::Pressure,
            Some(_) => false,
        }
}

fn gauge<'a, 't>(trace: &'a Trace<'t>, scale: f64, sure: f64, why: String) -> Gauge<'a, 't> {
    let present = trace.values.iter().filter(|value| value.is_finite());
    let (sum, count) = present.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    Gauge { trace, scale, sure, why, port: trace.name.port(), mean_pa: scale * sum / count }
}

/// The way of a pressure to Pa.
enum Scale {
    Sure(f64, f64, String),
    Open(Vec<(f64, &'static str)>, String),
}

fn scale(trace: &Trace<'_>, hints: &Hints) -> Scale {
    let (least, largest) = usual_range(trace);
    let fits = |factor: f64| {
        let highest_pa = largest * factor;
        let known = hints.supply_pa.is_none_or(|supply_pa| OF_SUPPLY.contains(&(highest_pa / supply_pa)));
        known && HIGHEST_PA.contains(&highest_pa) && least * factor >= LEAST_PA
    };
    let plausible: Vec<(f64, &str)> = UNITS.iter().copied().filter(|(factor, _)| fits(*factor)).collect();
    let highest = number(largest);
    if let Some(unit) = trace.unit {
        let name = trace.column.unit.as_deref().unwrap_or_default();
        let possible = largest * unit.factor <= *HIGHEST_PA.end() && least * unit.factor >= LEAST_PA;
        return if possible {
            Scale::Sure(unit.factor, 0.95, format!("It is in {name}."))
        } else {
            Scale::Open(
                plausible,
                format!("its unit is {name}, in which {} to {highest} is no pressure", number(least)),
            )
        };
    }
    let customary = |(factor, unit): &&(f64, &str)| match *unit {
        "bar" => BAR.contains(&largest),
        "Pa" => PASCAL.contains(&largest),
        _ => hints.supply_pa.is_some() && plausible.len() == 1 && fits(*factor),
    };
    match plausible.iter().find(customary) {
        Some((factor, unit)) => {
            Scale::Sure(*factor, 0.8, format!("It has no unit, and reaches {highest}: taken as {unit}."))
        }
        None => Scale::Open(plausible.clone(), format!("it has no unit, and reaches {highest}")),
    }
}

/// Between which values a trace is but for 1 % of the time at either end: a card that is switched on gives anything.
fn usual_range(trace: &Trace<'_>) -> (f64, f64) {
    let mut sorted: Vec<f64> = trace.values.iter().copied().filter(|value| value.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    let at = |share: f64| sorted.get((share * sorted.len() as f64) as usize).copied().unwrap_or_default();
    (at(0.01), at(0.99))
}

fn ask_unit(signal: Signal, trace: &Trace<'_>, ways: Vec<(f64, &'static str)>, why: &str) -> Question {
    let candidate = |(scale, unit): (f64, &str)| Candidate {
        column: trace.index,
        mapping: mapping_to(trace, scale, 0.0),
        what: format!("values in {unit}"),
    };
    Question {
        signal,
        candidates: ways.into_iter().map(candidate).collect(),
        why: format!("{} is a pressure, but {why}.", shown(trace)),
    }
}

/// The pressures of a machine.
struct Circuit<'a, 't> {
    gauges: Vec<Gauge<'a, 't>>,
    drive: &'a Drive<'a>,
}

/// What physics says of two chambers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Verdict {
    /// The first is the cap's.
    First,
    /// The second is.
    Second,
    /// It does not say.
    Open,
}

impl Circuit<'_, '_> {
    fn settled(&self) -> BTreeMap<Signal, Outcome> {
        let mut settled = BTreeMap::new();
        let mut left: Vec<usize> = (0..self.gauges.len()).filter(|at| !self.is_return(*at)).collect();
        for (signal, at, why) in self.sources(&left) {
            left.retain(|other| *other != at);
            settled.insert(signal, self.assign(at, 0.9, why));
        }
        self.settle_chambers(&left, &mut settled);
        settled
    }

    fn is_return(&self, at: usize) -> bool {
        self.gauges[at].port == Port { signal: None, in_words: true }
    }

    /// Supply and inlet: what is above all others, by name or by far.
    fn sources(&self, left: &[usize]) -> Vec<(Signal, usize, String)> {
        let mut order = left.to_vec();
        order.sort_by(|a, b| self.gauges[*b].mean_pa.total_cmp(&self.gauges[*a].mean_pa));
        let mut sources: Vec<(Signal, usize, String)> = Vec::new();
        let mut signals = [Signal::PSupply, Signal::PInlet].into_iter().peekable();
        for (place, at) in order.iter().enumerate() {
            let port = self.gauges[*at].port;
            let is_named = matches!(port.signal, Some(Signal::PSupply | Signal::PInlet));
            let is_chamber = matches!(port.signal, Some(Signal::PCap | Signal::PRod)) && port.in_words;
            let above = order[place + 1..].iter().all(|other| self.is_above(*at, *other));
            // Beside two chambers, what is above both is a source, whatever it is called.
            let by_place = order.len() - place > 2 && above && !is_chamber;
            if !above || !(is_named || by_place) {
                break;
            }
            let signal = port.signal.filter(|_| is_named).or_else(|| signals.peek().copied());
            let Some(signal) = signal.filter(|signal| sources.iter().all(|(other, ..)| other != signal))
            else {
                break;
            };
            if signals.peek() == Some(&signal) {
                signals.next();
            }
            let why = match order.len() - place {
                1 => "Its name says so.".to_owned(),
                _ => "It is above the other pressures at all times.".to_owned(),
            };
            sources.push((signal, *at, why));
        }
        sources
    }

    fn is_above(&self, at: usize, other: usize) -> bool {
        let (one, two) = (&self.gauges[at], &self.gauges[other]);
        let tolerance_pa = TRANSDUCERS * one.trace.largest * one.scale;
        let pairs = (0..one.trace.values.len()).map(|n| (one.pa(n), two.pa(n)));
        let both = pairs.filter(|(a, b)| a.is_finite() && b.is_finite());
        let (above, count) = both.fold((0usize, 0usize), |(above, count), (a, b)| {
            (above + usize::from(a >= b - tolerance_pa), count + 1)
        });
        count > 0 && above as f64 >= ABOVE * count as f64
    }

    fn settle_chambers(&self, left: &[usize], settled: &mut BTreeMap<Signal, Outcome>) {
        let chambers: Vec<usize> = left
            .iter()
            .copied()
            .filter(|at| !matches!(self.gauges[*at].port.signal, Some(Signal::PSupply | Signal::PInlet)))
            .collect();
        match chambers.as_slice() {
            [] => {}
            [one] => self.settle_lone_chamber(*one, settled),
            [first, second] => self.settle_two_chambers(*first, *second, settled),
            several => {
                // With more gauges than chambers, only names in words are believed.
                for signal in [Signal::PCap, Signal::PRod] {
                    let named =
                        |at: &&usize| self.gauges[**at].port == Port { signal: Some(signal), in_words: true };
                    let named: Vec<usize> = several.iter().filter(named).copied().collect();
                    match named.as_slice() {
                        [one] => {
                            settled.insert(signal, self.assign(*one, 0.8, "Its name says so.".into()));
                        }
                        _ => {
                            settled.insert(
                                signal,
                                self.ask(signal, several, "The log has more pressures than chambers."),
                            );
                        }
                    }
                }
            }
        }
    }

    fn settle_two_chambers(&self, first: usize, second: usize, settled: &mut BTreeMap<Signal, Outcome>) {
        let (ports, physics) = ([first, second].map(|at| self.gauges[at].port), self.verdict(first, second));
        let named = match [ports[0].signal, ports[1].signal] {
            [Some(Signal::PCap), Some(Signal::PRod)] => Verdict::First,
            [Some(Signal::PRod), Some(Signal::PCap)] => Verdict::Second,
            _ => Verdict::Open,
        };
        let in_words = named != Verdict::Open && ports.iter().any(|port| port.in_words);
        let both = [first, second];
        let (verdict, sure, why) = match (named, physics) {
            (Verdict::Open, Verdict::Open) => {
                let why = "Neither name nor motion tells the chambers apart.";
                return self.ask_both(&both, why, settled);
            }
            (named, physics) if named == physics => (named, 0.95, BY_BOTH),
            (Verdict::Open, physics) => (physics, 0.8, BY_MOTION),
            (named, Verdict::Open) if in_words => (named, 0.85, BY_NAME),
            (_, Verdict::Open) => {
                let why = "The names are letters, and the motion does not tell the chambers apart.";
                return self.ask_both(&both, why, settled);
            }
            (_, physics) if !in_words => (physics, 0.75, BY_MOTION),
            _ => {
                let why = "The names say one thing, and how they move with command and speed the other.";
                return self.ask_both(&both, why, settled);
            }
        };
        let [cap, rod] = if verdict == Verdict::First { [first, second] } else { [second, first] };
        settled.insert(Signal::PCap, self.assign(cap, sure, why.into()));
        settled.insert(Signal::PRod, self.assign(rod, sure, why.into()));
    }

    fn settle_lone_chamber(&self, at: usize, settled: &mut BTreeMap<Signal, Outcome>) {
        let port = self.gauges[at].port;
        let raised = self.raised_by_command(|n| self.gauges[at].pa(n));
        let by_motion = raised.map(|raised| if raised > 0.0 { Signal::PCap } else { Signal::PRod });
        match (port.signal, by_motion) {
            (Some(named), Some(moved)) if named == moved => {
                settled.insert(named, self.assign(at, 0.9, BY_BOTH.into()));
            }
            (Some(named), None) if port.in_words => {
                settled.insert(named, self.assign(at, 0.8, BY_NAME.into()));
            }
            (named, moved) => {
                let signal = moved.or(named).unwrap_or(Signal::PCap);
                let why = "A single pressure may be of either chamber, of the supply or of the return line.";
                settled.insert(signal, self.ask(signal, &[at], why));
            }
        }
    }

    /// Which of two chambers is the cap's, by motion.
    fn verdict(&self, first: usize, second: usize) -> Verdict {
        let (one, two) = (&self.gauges[first], &self.gauges[second]);
        let of = |sign: f64| if sign > 0.0 { Verdict::First } else { Verdict::Second };
        let by_command = self.raised_by_command(|n| one.pa(n) - two.pa(n)).map_or(Verdict::Open, of);
        let by_areas = self.swings(first, second).map_or(Verdict::Open, |swings| of(1.0 - swings));
        match (by_command, by_areas) {
            (Verdict::Open, other) | (other, Verdict::Open) => other,
            (command, areas) if command == areas => command,
            _ => Verdict::Open,
        }
    }

    /// Whether the command raises a pressure beyond what the piston's speed makes up for: partial correlation of its rate with the
    /// command, given the speed.
    fn raised_by_command(&self, pressure_pa: impl Fn(usize) -> f64) -> Option<f64> {
        let (command, position) = (&self.drive.command, self.drive.position.as_ref()?);
        let pressure: Vec<f64> = (0..command.len()).map(pressure_pa).collect();
        let at_stretch = |stretch_s: &f64| {
            let length = ((stretch_s * self.drive.rate_hz).round() as usize).max(1);
            let [p, x, u] = [&pressure, position, command].map(|values| Smoothed::of(values, length));
            partial(&p.slopes(length), &u.means(length), &[x.slopes(length)])
        };
        let strongest =
            STRETCHES_S.iter().filter_map(at_stretch).max_by(|a, b| a.abs().total_cmp(&b.abs()))?;
        (strongest.abs() >= RAISED).then_some(strongest)
    }

    /// By how much the first swings more than the second, where both swing together; `None` where that tells nothing.
    fn swings(&self, first: usize, second: usize) -> Option<f64> {
        let length = ((STRETCHES_S[2] * self.drive.rate_hz).round() as usize).max(1);
        let change = |at: usize| Smoothed::of(&self.gauges[at].trace.values, length).slopes(length);
        let (one, two) = (change(first), change(second));
        let together = one.iter().zip(&two).filter(|(a, b)| *a * *b > 0.0);
        let (a, b, count) =
            together.fold((0.0, 0.0, 0usize), |(a, b, n), (x, y)| (a + x * x, b + y * y, n + 1));
        let ratio = (a / b).sqrt() * self.gauges[first].scale / self.gauges[second].scale;
        (4 * count > one.len() && (ratio.ln().abs() > EVEN_SWINGS)).then_some(ratio)
    }

    fn assign(&self, at: usize, sure: f64, why: String) -> Outcome {
        let gauge = &self.gauges[at];
        Outcome::Assigned(Assigned {
            column: gauge.trace.index,
            mapping: mapping_to(gauge.trace, gauge.scale, 0.0),
            confidence: sure.min(gauge.sure),
            evidence: vec![why, gauge.why.clone()],
            rivals: Vec::new(),
        })
    }

    fn ask_both(&self, gauges: &[usize], why: &str, settled: &mut BTreeMap<Signal, Outcome>) {
        for signal in [Signal::PCap, Signal::PRod] {
            settled.insert(signal, self.ask(signal, gauges, why));
        }
    }

    fn ask(&self, signal: Signal, gauges: &[usize], why: &str) -> Outcome {
        let what = match signal {
            Signal::PCap => "the pressure in the cap's chamber",
            _ => "the pressure in the rod's chamber",
        };
        let candidate = |at: &usize| {
            let Gauge { trace, scale, .. } = &self.gauges[*at];
            Candidate { column: trace.index, mapping: mapping_to(trace, *scale, 0.0), what: what.into() }
        };
        Outcome::Asked(Question {
            signal,
            candidates: gauges.iter().map(candidate).collect(),
            why: why.into(),
        })
    }
}

const BY_BOTH: &str = "Its name says so, and it moves with command and speed as that chamber's does.";
const BY_MOTION: &str = "It moves with command and speed as that chamber's does.";
const BY_NAME: &str = "Its name says so.";

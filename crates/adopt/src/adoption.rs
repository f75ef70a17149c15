//! From a recording and machine data to the machine's plant: described, given its duty cycle, calibrated.

use std::collections::BTreeMap;

use seepd_gap::{Calibration, CalibrationSettings, Known, Log, Record, RecordError, calibrate};
use seepd_signals::Signal;
use seepd_sim::cycle::LoadCorner;
use seepd_sim::series::Direction;
use seepd_sim::{Controller, DutyCycle, MachineSpec, SpecError};

use crate::controller::{FittedGains, fit_gains};
use crate::drive::{
    Asked, asked_by_command, asked_by_position, load_by_tick, load_corners, planned, speed_over_command,
};
use crate::duty_cycle::FoundCycle;
use crate::flow_curve;
use crate::machine_data::{ControllerData, Datum, MachineData};
use crate::open_loop::going_as_far;
use crate::overlap;
use crate::plant::{DataError, DescribedPlant, LoggedSize, Origin, PlantValue, UNIFORM, describe};
use crate::process_force::{self, ProcessForce};
use crate::recording::Recording;
use crate::strokes::{noise_of, quantile, range, slope};

/// Cycles that the calibration is made from.
const CALIBRATED_ON: usize = 24;
/// Iterations of the calibration.
const ITERATIONS: usize = 10;
/// Share of the command's variance that a control law has to explain for its gains to be taken.
const EXPLAINED: f64 = 0.9;
/// A fitted proportional gain that is off the known one by less than this share is the same.
const SAME_GAIN: f64 = 0.15;
/// A parameter that keeps this share of its tolerance was not told by the log.
const NOT_TOLD: f64 = 0.85;
/// Least tolerance of a fitted parameter, share: the plant is not the machine.
const LEAST_TOLERANCE: f64 = 0.01;
/// Largest tolerance that training draws, share to either side.
const LARGEST_TOLERANCE: f64 = 0.30;
/// Most by which intervals are widened where the simulation stays off the log.
const MOST_WIDENED: f64 = 5.0;
/// Room for a position that does not fit the stroke, share of the stroke.
const POSITION_ROOM: f64 = 0.02;
/// A change of an open-loop command's opening, as a share, from which it is remarked on.
const REMARKED_CHANGE: f64 = 0.1;
/// A rest of the command, over its range, from which the demand that was found is remarked on.
const POOR: f64 = 0.03;
/// A command that is off by less than this share of its range says nothing more of the valve.
const LEAST_BENT: f64 = 0.0015;
/// What a force that is read off before anything is fitted may leave at most of what one leaves that is read off after it.
const NEARER: f64 = 0.85;
/// What another kind of valve may leave at most of what the usual one does.
const MUCH_NEARER: f64 = 0.7;
/// A friction below this share of the largest force of the piston is left out.
const LEAST_FRICTION: f64 = 0.01;
/// What is known of every cylinder and valve, standard deviations: friction of seals and guides, share of the piston's largest force
/// (Jelali, Kroll, Hydraulic Servo-systems, 2003, chapter 4), and the null of a valve as adjusted, share of full command.
const USUAL_FRICTION: f64 = 0.02;
const USUAL_NULL: f64 = 0.02;
/// How well a load is known that was read off the strokes, standard deviation as a share.
const READ_OFF: f64 = 0.1;
/// The spool's lag: effect and parameter; its frequency where nothing else is known, the fastest that the effect has, Hz; and its damping
/// with a standard deviation.
const LAG: (&str, &str) = ("valve_lag", "natural_frequency_hz");
const USUAL_LAG_HZ: f64 = 60.0;
const USUAL_DAMPING: (f64, f64) = (0.7, 0.1);

/// A machine as adopted: everything that training needs.
#[derive(Debug, Clone)]
pub struct Adoption {
    /// The plant, with its duty cycle and without a leak.
    pub spec: MachineSpec,
    /// Where each plant value comes from, and how well it is known.
    pub values: BTreeMap<&'static str, PlantValue>,
    /// Gains that were read off the log.
    pub gains: Option<FittedGains>,
    /// How the demand was come by.
    pub demand: DemandOrigin,
    /// RMS of the command that the demand leaves unexplained, over its range, where it was looked for.
    pub demand_rest: Option<f64>,
    /// What calibration showed; `None` where the log has no position.
    pub calibration: Option<Calibration<MachineSpec>>,
    /// What the log leaves open of the parameters together, beside their tolerances; empty where nothing was fitted.
    pub together: Vec<Direction>,
    /// Added to the log's positions so that they lie within the stroke, m.
    pub position_offset_m: f64,
    /// Standard deviation of the command's noise.
    pub noise: f64,
    /// Standard deviation of the load from cycle to cycle, share of its range; `None` where the log has no load.
    pub load_spread: Option<f64>,
    /// Whether the piston may meet a contact that the log does not show.
    pub unknown_contact: bool,
    /// Whether a force may press in the holds that the log does not show.
    pub unknown_hold_force: bool,
    /// Whether the valve's overlap was fitted to the log, or is the user's.
    pub knows_overlap: bool,
    /// What to know, one line each.
    pub remarks: Vec<String>,
}

/// How a demand was come by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DemandOrigin {
    /// It is in the log.
    Log,
    /// The control law, solved for the error at the logged position.
    Position,
    /// The one under which the simulated machine gives the logged command.
    Command,
}

/// Why a machine cannot be adopted from what was found.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum AdoptionError {
    /// Data that contradict each other or the log.
    #[error(transparent)]
    Data(#[from] DataError),
    /// Command and position do not belong together.
    #[error(
        "the position does not move with the command (their correlation is {correlation:.2}): are both of this axis, and is the command's \
         sign right? A command that extends is positive; `scale = -1` turns it round"
    )]
    NotTogether {
        /// Correlation of command and speed.
        correlation: f64,
    },
    /// Even the calibrated machine is not like the log.
    #[error(
        "even calibrated, the simulated command differs from the log's by {percent:.0} % of its range: this is no hydraulic axis as the plant \
         file has it, or the command, its scale or the machine data are another's; `seepd gap` says where they part, and \
         `[monitor] kind = \"relative\"` watches without a model"
    )]
    Unlike {
        /// RMS difference over the command's range, %.
        percent: f64,
    },
    /// The same without the valve's flow, which the command alone does not tell.
    #[error(
        "the simulated command differs from the log's by {percent:.0} % of its range, and neither log nor machine data tell how much the valve \
         passes: give `valve.rated_flow_lpm` and `valve.rated_at_bar` from the valve's plate or data sheet, or a log with the position"
    )]
    UnknownValve {
        /// RMS difference over the command's range, %.
        percent: f64,
    },
    /// The plant that came out is none.
    #[error("no plant could be made of these data: {0}")]
    Plant(#[from] SpecError),
    /// The calibration cannot use the log.
    #[error("the log cannot be laid beside a simulation: {0}")]
    Record(#[from] RecordError),
}

/// A command that differs by more than this share of its range is another machine's.
const UNLIKE: f64 = 0.15;

/// Least correlation of command and speed, and the share of the highest speed from which a piston moves.
const TOGETHER: f64 = 0.5;
const MOVING: f64 = 0.1;

/// Adopts a machine: describes it, gives it the log's duty cycle, and calibrates it where the log has its position.
///
/// # Errors
/// [`AdoptionError`] where data and log are not of one machine.
pub fn adopt(
    recording: &Recording,
    found: &FoundCycle,
    data: &MachineData,
) -> Result<Adoption, AdoptionError> {
    let log_period_s = 1.0 / recording.rate_hz;
    let of_log = |signal| found.mean_of(recording, signal, log_period_s);
    let positions = recording.log.get(Signal::Position).or(recording.log.get(Signal::Demand));
    let command = of_log(Signal::Command);
    let speed = match (&command, of_log(Signal::Position).or(of_log(Signal::Demand))) {
        (Some(command), Some(position)) => {
            together(command, &position)?;
            speed_over_command(command, &position, log_period_s)
        }
        _ => None,
    };
    let logged = LoggedSize {
        log_period_s,
        period_s: found.period_s,
        positions_m: positions
            .map(|x| (quantile(x.iter().copied(), 0.001), quantile(x.iter().copied(), 0.999))),
        speed_m_per_s: speed,
        largest_command: command
            .map(|command| command.iter().fold(0.0, |most: f64, value| most.max(value.abs()))),
    };
    let described = describe(data, &logged)?;
    let adopted = Adopter { recording, found, described, remarks: Vec::new() }.adopt(&logged);
    adopted.map_err(|error| error.for_want_of_the_valve(data, positions.is_some()))
}

impl AdoptionError {
    /// The same; where neither log nor data tell the valve's flow, that is what is asked for.
    fn for_want_of_the_valve(self, data: &MachineData, has_positions: bool) -> Self {
        match self {
            AdoptionError::Unlike { percent } if !has_positions && data.valve.rated_flow_lpm.is_none() => {
                AdoptionError::UnknownValve { percent }
            }
            other => other,
        }
    }
}

/// Checks that the piston moves as the valve is opened. What the command is while the piston stands counts for nothing: over a dead band it
/// stands on either side.
fn together(command: &[f64], position: &[f64]) -> Result<(), AdoptionError> {
    let speed: Vec<f64> = (0..position.len()).map(|tick| slope(position, tick)).collect();
    let moving = MOVING * quantile(speed.iter().map(|v| v.abs()), 0.99);
    let (mut uv, mut uu, mut vv) = (0.0, 0.0, 0.0);
    for (u, v) in command.iter().zip(&speed).filter(|(_, v)| v.abs() >= moving) {
        uv += u * v;
        uu += u * u;
        vv += v * v;
    }
    let correlation = uv / (uu * vv).sqrt().max(f64::MIN_POSITIVE);
    if correlation < TOGETHER { Err(AdoptionError::NotTogether { correlation }) } else { Ok(()) }
}

/// Gives a controller the gains of a fit that the user does not know. Beside a proportional gain that is known, the others are worth taking
/// where the fit finds it as well; a jump over the dead band stands by itself.
fn take_what_nobody_gave(controller: &mut Controller, fit: &FittedGains, given: &ControllerData) {
    if given.kp_per_m.is_none_or(|kp| (fit.kp / kp.value() - 1.0).abs() < SAME_GAIN) {
        let taken = |slot: &mut f64, given: Option<Datum>, fitted: f64| {
            if given.is_none() {
                *slot = fitted;
            }
        };
        taken(&mut controller.kp, given.kp_per_m, fit.kp);
        taken(&mut controller.ki, given.ki_per_m_s, fit.ki);
        taken(
            &mut controller.integral_window_m,
            given.integral_window_mm.or(given.ki_per_m_s),
            fit.integral_window_m,
        );
        taken(&mut controller.kd, given.kd_s_per_m, fit.kd);
        let feed_forward = &mut controller.velocity_feed_forward_s_per_m;
        taken(feed_forward, given.velocity_feed_forward_s_per_m, fit.feed_forward);
    }
    if given.dead_band_compensation_percent.is_none() {
        controller.dead_band_compensation = fit.compensation;
    }
}

struct Adopter<'a> {
    recording: &'a Recording,
    found: &'a FoundCycle,
    described: DescribedPlant,
    remarks: Vec<String>,
}

impl Adopter<'_> {
    fn adopt(mut self, logged: &LoggedSize) -> Result<Adoption, AdoptionError> {
        self.remarks.append(&mut self.described.remarks);
        let mut spec = self.described.spec.clone();
        let tick_s = spec.controller.period_s;
        let offset_m = self.position_offset_m(&spec, logged);
        let mean_of = |signal| self.found.mean_of(self.recording, signal, tick_s);
        let shifted = |values: Option<Vec<f64>>| {
            values.map(|values| values.iter().map(|x| x + offset_m).collect::<Vec<f64>>())
        };
        let command = mean_of(Signal::Command).unwrap_or_default();
        let (position, demand) = (shifted(mean_of(Signal::Position)), shifted(mean_of(Signal::Demand)));
        let largest_n = spec.plant.cap_area_m2 * spec.plant.relief_pressure_pa;
        let load = load_corners(mean_of(Signal::Load).as_deref(), self.described.weight_n, largest_n, tick_s);
        let load_n = load_by_tick(&load, command.len(), tick_s);
        let gains = self.gains(&mut spec, &command, demand.as_deref(), position.as_deref());
        let (asked, origin) = match (demand, &position) {
            (Some(demand_m), _) => (Asked { demand_m, rest: None, shrunk: 1.0 }, DemandOrigin::Log),
            (None, Some(position)) => (asked_by_position(&spec, &command, position), DemandOrigin::Position),
            (None, None) => (asked_by_command(&spec, &command, &load_n), DemandOrigin::Command),
        };
        self.remark_on(&asked);
        spec.plant.valve_m3_per_s_sqrt_pa *= asked.shrunk;
        spec.cycle = self.plan(&spec, &asked.demand_m, &command, load);
        let plan = spec.cycle.moves.clone();
        if let Some(position) = position.as_ref().filter(|_| spec.cycle.has_open_loop()) {
            spec.cycle = self.as_if_controlled(&spec, &command, position);
        }
        let spec = spec.with_stable_steps();
        spec.check()?;
        let (spec, values, calibration, together) = if position.is_some() {
            let fitted = self.fitted_to_the_log(&spec, offset_m, &command)?;
            (fitted.spec, fitted.values, Some(fitted.calibration), fitted.together)
        } else {
            let open = overlap::unmeasured(&self.described.spec);
            (spec, self.described.values.clone(), None, open)
        };
        let rest = calibration.as_ref().map(command_gap).or(asked.rest).unwrap_or(0.0);
        if rest.is_nan() || rest > UNLIKE {
            return Err(AdoptionError::Unlike { percent: 100.0 * rest });
        }
        let mut spec = MachineSpec { bounds: BTreeMap::new(), ..spec };
        spec.cycle.moves = plan;
        let spec = self.as_far(spec);
        let knows_overlap = calibration.is_some() || self.described.knows_overlap;
        let knows_load = self.recording.log.get(Signal::Load).is_some();
        Ok(Adoption {
            noise: self.recording.log.get(Signal::Command).map_or(0.0, noise_of),
            load_spread: self.load_spread(),
            // With the command alone the demand takes up what presses; drawn beside it, it made sizes worse.
            unknown_contact: origin != DemandOrigin::Command && !knows_load,
            unknown_hold_force: !knows_load,
            knows_overlap,
            spec: spec.with_stable_steps(),
            values,
            gains,
            demand: origin,
            demand_rest: asked.rest,
            calibration,
            together,
            position_offset_m: offset_m,
            remarks: self.remarks,
        })
    }

    /// What has to be added to the log's positions for them to lie within the stroke.
    fn position_offset_m(&mut self, spec: &MachineSpec, logged: &LoggedSize) -> f64 {
        let Some((low, high)) = logged.positions_m else { return 0.0 };
        let (stroke, room) = (spec.plant.stroke_m, POSITION_ROOM * spec.plant.stroke_m);
        if low >= -0.1 * room && high <= stroke + 0.1 * room {
            return 0.0;
        }
        let offset = if high - low + 2.0 * room > stroke { 0.5 * (stroke - low - high) } else { room - low };
        self.remarks.push(format!(
            "the log's positions lie between {:.1} and {:.1} mm, the stroke between 0 and {:.1}: {:.1} mm are added to position and demand",
            1e3 * low,
            1e3 * high,
            1e3 * stroke,
            1e3 * offset
        ));
        offset
    }

    /// The controller's gains off demand and position, where they are all there and the user gave none.
    fn gains(
        &mut self,
        spec: &mut MachineSpec,
        command: &[f64],
        demand: Option<&[f64]>,
        position: Option<&[f64]>,
    ) -> Option<FittedGains> {
        let (demand, position) = (demand?, position?);
        // What the controller adds to step over the dead band, as far as the user knows it, is no part of its gains.
        let uncompensated: Vec<f64> = command.iter().map(|u| spec.controller.uncompensated(*u)).collect();
        let tick_s = spec.controller.period_s;
        let open = self.found.open_ticks(tick_s);
        let fitted =
            fit_gains(&uncompensated, demand, position, tick_s, &open, self.described.controller.kind);
        let Some(gains) = fitted.filter(|gains| gains.explained > EXPLAINED) else {
            let share = 100.0 * fitted.map_or(0.0, |gains| gains.explained.max(0.0));
            self.remarks.push(format!(
                "error, its integral and the speeds explain only {share:.0} % of the command: the controller has a law that the plant file \
                 does not know, or strokes run open loop"
            ));
            return None;
        };
        take_what_nobody_gave(&mut spec.controller, &gains, &self.described.controller);
        Some(gains)
    }

    /// The plan of the cycle for a demand, within the stroke.
    fn plan(
        &self,
        spec: &MachineSpec,
        demand_m: &[f64],
        command: &[f64],
        load: Vec<LoadCorner>,
    ) -> DutyCycle {
        let mut cycle = planned(self.found, demand_m, command, load, spec.controller.period_s);
        let stroke_m = spec.plant.stroke_m;
        cycle.moves.iter_mut().for_each(|stroke| stroke.to_m = stroke.to_m.clamp(0.0, stroke_m));
        cycle
    }

    /// The same cycle with the demand under which position control would have given the log's command all along. A plant is fitted to it:
    /// over an open-loop part small errors of the plant add up to large ones of the position, and would bend it.
    fn as_if_controlled(&self, spec: &MachineSpec, command: &[f64], position: &[f64]) -> DutyCycle {
        let asked = asked_by_position(spec, command, position);
        let mut cycle = self.plan(spec, &asked.demand_m, command, spec.cycle.load.clone());
        cycle.moves.iter_mut().for_each(|stroke| stroke.open_loop = None);
        cycle
    }

    /// The machine going as far as the log's in its open-loop parts, where its plant has been fitted.
    fn as_far(&mut self, spec: MachineSpec) -> MachineSpec {
        if !spec.cycle.has_open_loop() {
            return spec;
        }
        let (corrected, change) = going_as_far(&spec);
        if change > REMARKED_CHANGE {
            self.remarks.push(format!(
                "the simulated machine goes as far as the log's in its open-loop parts where the valve is opened by {:.0} % more or less than \
                 the log's: overlap, flow curve or load are others",
                100.0 * change
            ));
        }
        if corrected.check().is_ok() { corrected } else { spec }
    }

    fn remark_on(&mut self, asked: &Asked) {
        if asked.shrunk < 1.0 {
            self.remarks.push(format!(
                "the command would move the piston further than its stroke: the valve is taken to pass {:.0} % of its flow; check \
                 valve.rated_flow_lpm and valve.rated_at_bar",
                100.0 * asked.shrunk
            ));
        }
        if let Some(rest) = asked.rest.filter(|rest| *rest > POOR) {
            self.remarks.push(format!(
                "no demand makes the simulated machine give this command: {:.1} % of its range stay unexplained; gains, overlap or load are others",
                100.0 * rest
            ));
        }
    }

    /// The machine as its calibration leaves it: with what its strokes work against where the log has no load, and with the flow curve of its
    /// valve where the data sheet does not say and a line stays far from the log.
    fn fitted_to_the_log(
        &mut self,
        spec: &MachineSpec,
        offset_m: f64,
        command: &[f64],
    ) -> Result<Fitted, AdoptionError> {
        let mut best = self.with_unknown_force(self.fitted(spec, offset_m)?, offset_m, command)?;
        let mut spec = spec.clone();
        if let Some(pressed) = self.pressed_before_it_is_fitted(&spec, offset_m, command)?
            && pressed.leaves_less_than(NEARER, &best)
        {
            (spec.cycle.load, best) = (pressed.spec.cycle.load.clone(), pressed);
        }
        if is_far(&best.calibration) {
            let (otherwise, words) = overlap::leaking_otherwise(&self.described.spec, &spec);
            let leaking = self.with_unknown_force(self.fitted(&otherwise, offset_m)?, offset_m, command)?;
            if leaking.is_much_nearer_than(&best) {
                (best, spec) = (leaking, otherwise);
                best.remarks
                    .push(format!("the holds show that the valve {words}: check valve.overlap_percent"));
            }
        }
        if !self.described.knows_curve
            && let Some(bent) = self.along_a_curve(&spec, offset_m, &best)?
        {
            let bent = self.with_unknown_force(bent, offset_m, command)?;
            if bent.is_much_nearer_than(&best) {
                best = bent;
            }
        }
        self.remarks.append(&mut best.remarks);
        if !best.is_nearer {
            self.remarks.push(
                "the calibration did not bring the simulated command nearer to the log's, and is not used: check the machine data and the \
                 signals; `seepd gap` with the plant file may name what differs"
                    .into(),
            );
        }
        Ok(best)
    }

    /// The machine with what its strokes work against, where the log has no load and that brings the whole cycle nearer: forces that do not
    /// were none.
    fn with_unknown_force(
        &self,
        fitted: Fitted,
        offset_m: f64,
        command: &[f64],
    ) -> Result<Fitted, AdoptionError> {
        let Some(found) = self.unknown_force(&fitted.spec, command) else { return Ok(fitted) };
        let mut again = self.fitted_under(&found, &fitted.spec, offset_m)?;
        if command_gap(&again.calibration) >= command_gap(&fitted.calibration) {
            return Ok(fitted);
        }
        again.remarks.splice(0..0, fitted.remarks);
        Ok(again)
    }

    /// The machine fitted under what its strokes work against as its data sheet has it: a fit without that force may have given its work to
    /// another part, as to a pump that is too small for the strokes that press.
    fn pressed_before_it_is_fitted(
        &self,
        spec: &MachineSpec,
        offset_m: f64,
        command: &[f64],
    ) -> Result<Option<Fitted>, AdoptionError> {
        let found = self.unknown_force(spec, command);
        found.map(|found| self.fitted_under(&found, spec, offset_m)).transpose()
    }

    /// The machine fitted under a force that was read off its strokes.
    fn fitted_under(
        &self,
        force: &ProcessForce,
        spec: &MachineSpec,
        offset_m: f64,
    ) -> Result<Fitted, AdoptionError> {
        let mut loaded = spec.clone();
        loaded.cycle.load.clone_from(&force.load);
        let mut fitted = self.fitted(&loaded, offset_m)?;
        fitted.remarks.push(format!(
            "the log has no load; {:.0} % of what the strokes' command had left is explained by {}",
            100.0 * (1.0 - force.left),
            force.words
        ));
        Ok(fitted)
    }

    /// The machine with the flow curve that brings its command nearest to the log's, where a line stays further from it than its cycles from
    /// one another.
    fn along_a_curve(
        &self,
        spec: &MachineSpec,
        offset_m: f64,
        line: &Fitted,
    ) -> Result<Option<Fitted>, AdoptionError> {
        if !is_far(&line.calibration) {
            return Ok(None);
        }
        let mut best: Option<Fitted> = None;
        for candidate in &flow_curve::CANDIDATES {
            let mut bent = spec.clone();
            bent.effects.insert(flow_curve::LAW.into(), candidate.start());
            let fitted = self.fitted(&bent, offset_m)?;
            let gap = command_gap(&fitted.calibration);
            if fitted.is_nearer && best.as_ref().is_none_or(|best| gap < command_gap(&best.calibration)) {
                best = Some(fitted);
            }
        }
        Ok(best.map(|mut bent| {
            let words = bent.spec.effects.get(flow_curve::LAW).map(flow_curve::words).unwrap_or_default();
            bent.remarks
                .push(format!("the strokes show that the valve's flow is no line over the command: {words}"));
            bent
        }))
    }

    /// The machine with what its calibration found, where that brings the command nearer to the log's.
    fn fitted(&self, spec: &MachineSpec, offset_m: f64) -> Result<Fitted, AdoptionError> {
        let calibration = self.calibrated(spec, offset_m)?;
        let mut values = self.described.values.clone();
        let [before, after] = calibration.gaps.each_ref().map(command_gap_of);
        let is_nearer = after <= before;
        let (spec, together) = if is_nearer {
            let together =
                calibration.posterior.directions(widened(&calibration), LARGEST_TOLERANCE / UNIFORM);
            let mut spec = learned(&calibration, &mut values);
            if !self.described.knows_overlap {
                overlap::without_rounded_edges(&mut spec);
            }
            (spec, together)
        } else {
            (spec.clone(), overlap::unmeasured(&self.described.spec))
        };
        Ok(Fitted { spec, values, calibration, together, is_nearer, remarks: Vec::new() })
    }

    /// What the strokes work against, where the log has no load.
    fn unknown_force(&self, spec: &MachineSpec, command: &[f64]) -> Option<ProcessForce> {
        if self.recording.log.get(Signal::Load).is_some() {
            None
        } else {
            process_force::read_off(spec, command, &self.described.values)
        }
    }

    /// Fits the plant to the log's cycles, each laid on the plan.
    fn calibrated(
        &self,
        spec: &MachineSpec,
        offset_m: f64,
    ) -> Result<Calibration<MachineSpec>, AdoptionError> {
        let mut spec = spec.clone();
        for key in seepd_sim::PlantParameters::ALL.iter().map(|info| info.key) {
            let Some(value) = self.described.values.get(key).filter(|value| value.value > 0.0) else {
                continue;
            };
            let room = room_of(value);
            spec.bounds.insert(key.into(), [value.value / room, value.value * room]);
        }
        let record = Record::new(&self.laid_on_plan(&spec, offset_m), &spec)?;
        // A leak and a shifted null look alike in a command. The log is of a healthy machine; what stands in its holds is the valve's.
        let mut effects = ["valve_bias", "coulomb_friction", LAG.0].map(str::to_owned).to_vec();
        // No spool follows at once: without its lag a fit gives the valve another size and the supply another pressure.
        let lag = spec.effects.entry(LAG.0.into()).or_default();
        lag.entry(LAG.1.into()).or_insert(USUAL_LAG_HZ);
        if spec.effects.contains_key(overlap::LAW) || !self.described.knows_overlap {
            overlap::free(&mut spec);
            effects.push(overlap::LAW.to_owned());
        }
        effects.extend(flow_curve::free(&spec).into_keys());
        let known = self.known_beforehand(&spec);
        let open_within = overlap::half_width(&self.described.spec)
            .filter(|_| spec.controller.ki > 0.0)
            .map(overlap::open_within);
        let settings =
            CalibrationSettings { iterations: ITERATIONS, wear: false, effects, known, open_within };
        Ok(calibrate(&record, &spec, &settings))
    }

    /// Standard deviations of what the data sheet and every machine's parts tell before the log does.
    fn known_beforehand(&self, spec: &MachineSpec) -> BTreeMap<String, Known> {
        let of_data_sheet = self.described.values.iter().filter(|(_, value)| value.origin == Origin::User);
        let of_data_sheet = of_data_sheet.map(|(key, value)| {
            let share = value.tolerance.max(LEAST_TOLERANCE) / UNIFORM;
            // The return pressure is calibrated by addition.
            let sigma = if *key == "return_pressure_pa" { share * value.value } else { share };
            ((*key).to_owned(), Known { value: value.value, sigma })
        });
        let largest_n = spec.plant.cap_area_m2 * spec.plant.relief_pressure_pa;
        let of_parts = [
            ("coulomb_friction.force_n".to_owned(), 0.0, USUAL_FRICTION * largest_n),
            ("valve_bias.offset".to_owned(), 0.0, USUAL_NULL),
            (format!("{}.{}", LAG.0, LAG.1), USUAL_LAG_HZ, USUAL_LAG_HZ),
            (format!("{}.damping", LAG.0), USUAL_DAMPING.0, USUAL_DAMPING.1),
        ];
        // A load that strokes betrayed is known as well as they tell it; that of a log may have any scale.
        let is_read_off = self.recording.log.get(Signal::Load).is_none();
        let of_load = is_read_off.then(|| ("load_scale".to_owned(), Known { value: 1.0, sigma: READ_OFF }));
        let of_parts = of_parts.map(|(key, value, sigma)| (key, Known { value, sigma }));
        let of_edges = overlap::known(&self.described.spec);
        of_data_sheet.chain(of_parts).chain(of_edges).chain(of_load).chain(flow_curve::free(spec)).collect()
    }

    /// The recorded cycles one after the other, each stroke in its planned place, under the plan's demand and load.
    fn laid_on_plan(&self, spec: &MachineSpec, offset_m: f64) -> Log {
        let tick_s = spec.controller.period_s;
        let ticks = (spec.cycle.period_s / tick_s).round() as usize;
        let all = self.found.cycles.len();
        // The first may be a warm-up, the last cut off.
        let cycles: Vec<usize> = (usize::from(all > 4)..all - usize::from(all > 4))
            .step_by((all / CALIBRATED_ON).max(1))
            .collect();
        let mut log = Log::default();
        // Pressures at rest hang on leakages that a plant file hardly knows: they must not bend the valve.
        for signal in [Signal::Command, Signal::Position] {
            let offset = if signal == Signal::Position { offset_m } else { 0.0 };
            log.values[signal as usize] = cycles
                .iter()
                .filter_map(|cycle| self.found.cycle_of(self.recording, signal, *cycle, tick_s))
                .flatten()
                .map(|value| value + offset)
                .collect();
        }
        let plan = |of: &dyn Fn(f64) -> f64| -> Vec<f64> {
            let one: Vec<f64> = (0..ticks).map(|tick| of(tick as f64 * tick_s)).collect();
            one.iter().copied().cycle().take(ticks * cycles.len()).collect()
        };
        log.values[Signal::Demand as usize] = plan(&|at_s| spec.cycle.demand_m(at_s));
        log.values[Signal::Load as usize] = plan(&|at_s| spec.cycle.load_n(at_s));
        log
    }

    fn load_spread(&self) -> Option<f64> {
        let values = self.recording.log.get(Signal::Load)?;
        let largest = range(values);
        let means: Vec<f64> = (0..self.found.cycles.len())
            .filter_map(|cycle| {
                self.found.cycle_of(self.recording, Signal::Load, cycle, 10.0 / self.recording.rate_hz)
            })
            .map(|load| {
                load.iter().copied().filter(|value| value.is_finite()).map(f64::abs).fold(0.0, f64::max)
            })
            .collect();
        let middle = quantile(means.iter().copied(), 0.5);
        let off = quantile(means.iter().map(|mean| (mean - middle).abs()), 0.5) / 0.6745;
        Some(off / largest).filter(|spread| spread.is_finite())
    }
}

/// Factor to either side within which the calibration may look.
fn room_of(value: &PlantValue) -> f64 {
    match value.origin {
        Origin::User => 1.0 + 1.2 * value.tolerance,
        _ if value.tolerance >= 1.0 => 4.0,
        _ => 1.0 + 2.0 * value.tolerance,
    }
}

/// A machine with what its calibration found.
struct Fitted {
    spec: MachineSpec,
    values: BTreeMap<&'static str, PlantValue>,
    calibration: Calibration<MachineSpec>,
    together: Vec<Direction>,
    /// Whether the calibrated simulation is nearer to the log than the data sheet's; where not, the data sheet stands.
    is_nearer: bool,
    /// What it took beside its parameters, one line each.
    remarks: Vec<String>,
}

impl Fitted {
    /// Whether another kind of valve explains the log much better.
    fn is_much_nearer_than(&self, usual: &Fitted) -> bool {
        self.leaves_less_than(MUCH_NEARER, usual)
    }

    /// Whether its command is off by less than that share of the other's.
    fn leaves_less_than(&self, share: f64, other: &Fitted) -> bool {
        command_gap(&self.calibration) < share * command_gap(&other.calibration)
    }
}

/// How far the calibrated simulation's command is from the log's on held-out cycles, over its range.
fn command_gap(calibration: &Calibration<MachineSpec>) -> f64 {
    command_gap_of(&calibration.gaps[1])
}

/// Whether the calibrated simulation stays further from the log than its cycles from one another.
fn is_far(calibration: &Calibration<MachineSpec>) -> bool {
    let floor = calibration.floor.get(Signal::Command.name()).copied().unwrap_or(0.0);
    command_gap(calibration) >= LEAST_BENT.max(2.0 * floor)
}

fn command_gap_of(gaps: &BTreeMap<&'static str, f64>) -> f64 {
    gaps.get(Signal::Command.name()).copied().unwrap_or(f64::NAN)
}

/// How much wider than its own intervals a fit's are: where the simulation stays further from the log than the log from itself, they are
/// too narrow.
fn widened(calibration: &Calibration<MachineSpec>) -> f64 {
    let misfit = |(signal, gap): (&&'static str, &f64)| {
        gap / calibration.floor.get(*signal).copied().unwrap_or(*gap).max(1e-9)
    };
    calibration.gaps[1].iter().map(misfit).fold(1.0, f64::max).clamp(1.0, MOST_WIDENED)
}

/// Takes the fitted parameters and how well the log tells them; gives the machine without its leak.
fn learned(
    calibration: &Calibration<MachineSpec>,
    values: &mut BTreeMap<&'static str, PlantValue>,
) -> MachineSpec {
    let mut spec = calibration.machine.clone();
    let largest_n = spec.plant.cap_area_m2 * spec.plant.relief_pressure_pa;
    // A friction that hardly acts would only make every simulated step dearer.
    let friction_n = spec.effects.get("coulomb_friction").and_then(|values| values.get("force_n"));
    if friction_n.is_some_and(|force_n| *force_n < LEAST_FRICTION * largest_n) {
        spec.effects.remove("coulomb_friction");
    }
    let widened = widened(calibration);
    for (key, fitted) in &calibration.parameters {
        let Some(value) = values.get_mut(key.as_str()) else { continue };
        let half = 0.5 * (fitted.interval95[1] - fitted.interval95[0]) / 1.96;
        let told = (widened * UNIFORM * half / fitted.fitted).max(LEAST_TOLERANCE);
        let is_told = told < NOT_TOLD * value.tolerance;
        value.value = fitted.fitted;
        value.origin = match value.origin {
            Origin::User => Origin::User,
            _ if is_told => Origin::Fitted,
            _ => Origin::NotIdentifiable,
        };
        value.tolerance = told.min(value.tolerance);
    }
    // What was held at its bound or not free keeps what is known of it.
    for (key, value) in values.iter_mut() {
        if let Some(fitted) = spec.plant.get(key) {
            value.value = fitted;
        }
    }
    spec
}

impl Adoption {
    /// How far training is to vary each parameter by itself: what is not known of it, or the least where [`Adoption::together`] has the
    /// rest.
    pub fn tolerances(&self) -> BTreeMap<String, f64> {
        let is_in = |direction: &Direction, key: &str| {
            direction.plant.contains_key(key) || direction.plant_by_addition.contains_key(key)
        };
        let is_together = |key: &str| self.together.iter().any(|direction| is_in(direction, key));
        let tolerance = |key: &str, value: &PlantValue| {
            if is_together(key) { LEAST_TOLERANCE } else { value.tolerance.min(LARGEST_TOLERANCE) }
        };
        self.values.iter().map(|(key, value)| ((*key).to_owned(), tolerance(key, value))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_log_completes_what_the_user_knows_of_the_controller() {
        let fit = FittedGains {
            kp: 108.0,
            ki: 40.0,
            integral_window_m: 0.0,
            kd: 0.3,
            feed_forward: 2.0,
            compensation: 0.058,
            explained: 0.99,
        };
        let taken = |text: &str| {
            let data = MachineData::from_toml(&format!("[controller]\n{text}\n")).unwrap();
            let c = &mut Controller::default();
            (c.kp, c.ki, c.dead_band_compensation) = (110.0, 137.5, 0.0);
            take_what_nobody_gave(c, &fit, &data.controller);
            [c.kp, c.ki, c.kd, c.velocity_feed_forward_s_per_m, c.dead_band_compensation]
        };
        assert_eq!(taken(""), [108.0, 40.0, 0.3, 2.0, 0.058]);
        let kd = Controller::default().kd;
        assert_eq!(taken("kp_per_m = 110\nki_per_m_s = 30"), [110.0, 137.5, 0.3, 2.0, 0.058]);
        // Another gain than the user's: the log does not tell this law well.
        let nothing = taken("kp_per_m = 160\ndead_band_compensation_percent = 4");
        assert_eq!(nothing[..3], [110.0, 137.5, kd]);
        assert!(nothing[4] == 0.0, "{nothing:?}");
    }

    #[test]
    fn a_valve_that_nobody_tells_is_asked_for() {
        let refusal = |machine: &str, has_positions: bool| {
            let data = MachineData::from_toml(machine).unwrap();
            AdoptionError::Unlike { percent: 31.0 }.for_want_of_the_valve(&data, has_positions).to_string()
        };
        let without = "[cylinder]\nbore_mm = 160\nrod_mm = 70\n";
        let with = "[cylinder]\nbore_mm = 160\nrod_mm = 70\n[valve]\nrated_flow_lpm = 32\n";
        assert!(refusal(without, false).contains("give `valve.rated_flow_lpm`"));
        // A position tells it, and who gives it is not asked again.
        assert!(refusal(without, true).contains("no hydraulic axis"));
        assert!(refusal(with, false).contains("no hydraulic axis"));
    }
}

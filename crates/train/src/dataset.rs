//! Simulated machines and their cycles, read with the monitor's own code.

use seepd_features::statistics::CycleStatistics;
use seepd_features::{CycleDefinition, CycleReader, Kalman, Outcome, Phase, Projections};
use seepd_model::schema::Cycle;
use seepd_signals::Sample;
use seepd_sim::batch::{self, Job};
use seepd_sim::cycle::CycleRun;
use seepd_sim::noise::Noise;
use seepd_sim::series::{self, Tolerances};
use seepd_sim::{MachineSpec, Steps};
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::leak_range::LeakRange;
use crate::portions::Portions;
use crate::train::TrainError;
use crate::{null_region, unknown_contact, unknown_overlap, unknown_seal};

/// How simulated machines differ from the plan.
#[derive(Debug, Clone, PartialEq)]
pub struct Spread {
    /// Plant parameters are drawn uniformly within these.
    pub parameters: Tolerances,
    /// The load is scaled within ± this share.
    pub load: f64,
    /// The duty cycle's time is scaled within ± this share.
    pub period: f64,
    /// Whether half of the machines meet a contact that nobody knows of.
    pub unknown_contact: bool,
    /// Whether seals of half of the machines by which intervals are calibrated leak more like a gap than like an orifice. Sizes are learned
    /// from orifices: an area is that of an orifice.
    pub unknown_seal: bool,
    /// How far the flow gain of a machine's valve may be off at its null, share to either side.
    pub null_deviation: f64,
    /// Share of the machines whose valve overlaps beyond the plan's, and the widest half width, share of full command.
    pub deadband: (f64, f64),
}

impl Default for Spread {
    fn default() -> Self {
        Spread {
            parameters: Tolerances::even(0.05),
            load: 0.05,
            period: 0.03,
            unknown_contact: false,
            unknown_seal: false,
            null_deviation: 0.0,
            deadband: (0.0, 0.0),
        }
    }
}

impl Spread {
    /// The same, of machines whose seals leak as orifices do.
    pub(crate) fn of_orifices(&self) -> Self {
        Spread { unknown_seal: false, ..self.clone() }
    }

    /// A machine of the series, without a leak.
    pub(crate) fn machine(&self, spec: &MachineSpec, stream: u64, noise: &mut Noise) -> Observation {
        let mut spec = series::vary(spec, &self.parameters, noise);
        if self.unknown_contact {
            unknown_contact::put_on(&mut spec, noise);
        }
        let load_factor = noise.factor(self.load);
        let stretch = noise.factor(self.period);
        let laminar_share = if self.unknown_seal { unknown_seal::laminar_share(noise) } else { 0.0 };
        let widest = self.null_deviation;
        let null_deviation = if widest > 0.0 { noise.uniform(-widest, widest) } else { 0.0 };
        let extra_deadband = unknown_overlap::put_on(&mut spec, self.deadband, noise);
        Observation {
            spec,
            load_factor,
            stretch,
            leak_area_m2: 0.0,
            laminar_share,
            null_deviation,
            extra_deadband,
            stream,
        }
    }
}

/// A machine with its leak.
#[derive(Debug, Clone)]
pub struct Observation {
    /// The machine.
    pub spec: MachineSpec,
    /// Load over plan.
    pub load_factor: f64,
    /// Time over plan.
    pub stretch: f64,
    /// Truth, m².
    pub leak_area_m2: f64,
    /// Share of the leak that is laminar, at the pressure difference at which leaks are given.
    pub laminar_share: f64,
    /// By what share the leak that is held against at the valve's null is larger than the true one.
    pub null_deviation: f64,
    /// Half width of the dead band that its valve has beside the series' own, share of full command.
    pub extra_deadband: f64,
    /// Number of the random stream for its noise.
    pub stream: u64,
}

/// Random streams that share no machine, by what they are drawn for.
pub(crate) mod purpose {
    pub(crate) const TEMPLATE: u64 = 1;
    pub(crate) const LEARN: u64 = 2;
    pub(crate) const HELD_OUT: u64 = 3;
    pub(crate) const CALIBRATE: u64 = 4;
    pub(crate) const BEYOND: u64 = 5;
    pub(crate) const LARGEST: u64 = 6;
}

/// Shares of observations without a leak and with one below the main range.
const SHARE_HEALTHY: f64 = 0.06;
const SHARE_SMALL: f64 = 0.18;

/// Draws machines; leak areas are stratified, so that the range is evenly covered at any number.
///
/// `seed` and `purpose` pick the random stream; different purposes share no machine.
pub fn draw(
    spec: &MachineSpec,
    spread: &Spread,
    leaks: LeakRange,
    count: usize,
    seed: u64,
    purpose: u64,
) -> Vec<Observation> {
    (0..count)
        .map(|index| {
            let stream = purpose.wrapping_mul(1 << 32) + index as u64;
            let mut noise = Noise::new(seed, stream);
            let healthy = spread.machine(spec, stream, &mut noise);
            let rank = (index as f64 + noise.uniform(0.0, 1.0)) / count as f64;
            Observation { leak_area_m2: leaks.at_m2(rank, SHARE_HEALTHY, SHARE_SMALL), ..healthy }
        })
        .collect()
}

/// Ticks of the warm-up cycle that are recorded before the cycle of interest: the filter settles in them.
fn lead_ticks(spec: &MachineSpec) -> u64 {
    (0.1 * spec.cycle.period_s / spec.controller.period_s) as u64
}

/// Samples of an observation's recording before the cycle of interest. The start varies by a bin, as it does in logs.
pub fn lead(observation: &Observation) -> usize {
    let log_every = observation.spec.controller.log_every as u64;
    (lead_ticks(&observation.spec) / log_every + observation.stream % 50) as usize
}

/// Where in the warm-up cycle a machine begins, at rest, s: what it did before that has died away by the end of the cycle.
pub fn warm_up_from_s(spec: &MachineSpec) -> f64 {
    let latest_s = LATEST_WARM_UP * spec.cycle.period_s;
    let begins = spec.cycle.moves.iter().map(|stroke| stroke.from_s);
    begins.filter(|from_s| *from_s <= latest_s).fold(0.0, f64::max)
}

/// The warm-up is no shorter than the rest of the period after this share.
const LATEST_WARM_UP: f64 = 0.6;

/// Runs the machines over the end of a warm-up cycle and one cycle more, and hands each one's noiseless command, as its log would have it,
/// to
/// `reduce` with its index. The recording ends late enough for the last stroke to be confirmed.
pub fn simulate<R: Send>(observations: &[Observation], reduce: impl Fn(usize, &[f64]) -> R + Sync) -> Vec<R> {
    let jobs: Vec<Job> = observations
        .iter()
        .map(|observation| {
            let mut spec = observation.spec.clone();
            let leak_area_m2 = null_region::leak_as_held_m2(
                &spec.plant,
                observation.leak_area_m2,
                observation.null_deviation,
            );
            let leak_area_m2 =
                unknown_seal::with_gap(&mut spec.plant, leak_area_m2, observation.laminar_share);
            let planned_ticks = observation.spec.cycle.period_s / observation.spec.controller.period_s;
            let period_ticks = (planned_ticks * observation.stretch).round() as u64;
            let lead = (lead(observation) * observation.spec.controller.log_every) as u64;
            let run = CycleRun {
                load_factor: observation.load_factor,
                stretch: observation.stretch,
                ..CycleRun::with_leak(leak_area_m2)
            };
            let warm_up_s = observation.stretch * warm_up_from_s(&observation.spec);
            let start_tick = (warm_up_s / observation.spec.controller.period_s) as u64;
            // Of a cycle of few ticks the lead may be most.
            let start_tick = start_tick.min(period_ticks.saturating_sub(lead));
            Job {
                spec,
                runs: vec![run],
                start_tick,
                skip_ticks: period_ticks.saturating_sub(start_tick + lead),
                record_ticks: lead + period_ticks + period_ticks / 10,
            }
        })
        .collect();
    batch::commands(&jobs, Steps::Fewest, |index, commands| {
        let log_every = observations[index].spec.controller.log_every;
        if log_every == 1 {
            return reduce(index, commands);
        }
        let logged: Vec<f64> = commands.iter().step_by(log_every).copied().collect();
        reduce(index, &logged)
    })
}

/// Machines of a portion.
const PORTION: usize = 256;

/// Simulates machines in portions of a name, reads each one's recorded command, and hands what was read to `take` in the machines' order.
/// Portions that are not to be simulated here are left out.
///
/// # Errors
/// [`TrainError`] for a portion that is damaged.
pub(crate) fn in_portions<R: Send + Serialize + DeserializeOwned>(
    (name, portions): (&str, &mut Portions),
    observations: &[Observation],
    read: impl Fn(&Observation, &[f64]) -> R + Sync,
    mut take: impl FnMut(R),
) -> Result<(), TrainError> {
    for (number, portion) in observations.chunks(PORTION).enumerate() {
        let simulated = portions.take(&format!("{name} {number}"), || {
            simulate(portion, |index, commands| read(&portion[index], commands))
        })?;
        simulated.into_iter().flatten().for_each(&mut take);
    }
    Ok(())
}

/// Noise of standard deviation 1 for so many samples: scaled, it serves every level.
pub fn unit_noise(noise: &mut Noise, samples: usize) -> Vec<f64> {
    (0..samples).map(|_| noise.normal(1.0)).collect()
}

/// What reading needs that is not in the file's form.
#[derive(Debug, Clone, Copy)]
pub struct Reading<'m> {
    /// The duty cycle.
    pub cycle: &'m Cycle,
    /// Its phases, from [`Cycle::phase_list`].
    pub phases: &'m [Phase],
    /// Samples a second, Hz.
    pub sample_rate_hz: f64,
    /// Projections; with any, cycles are binned.
    pub projections: Projections<'m>,
}

impl<'m> Reading<'m> {
    /// The definition.
    pub fn definition(&self) -> CycleDefinition<'m> {
        self.cycle.definition(self.sample_rate_hz, self.phases, self.projections)
    }

    /// The statistics of the one cycle in a recorded command with measurement noise added, `sigma` times that of
    /// [`unit_noise`]; `None` where the monitor's own segmentation does not find it, or has no room for its phases and bins.
    pub fn read(
        &self,
        commands: &[f64],
        filter: Option<Kalman>,
        sigma: f64,
        unit_noise: &[f64],
    ) -> Option<CycleStatistics> {
        let definition = self.definition();
        let reader = CycleReader::new(filter, definition, &[]).ok()?;
        let mut state = reader.start(vec![0.0f32; definition.ring_samples()]).ok()?;
        let mut found = None;
        let mut keep = |outcome: Outcome<'_>| {
            if let Outcome::Valid(cycle) = outcome {
                found = Some(*cycle.statistics);
            }
        };
        let period_ns = 1e9 / self.sample_rate_hz;
        for (index, (command, noise)) in commands.iter().zip(unit_noise).enumerate() {
            let time_ns = (index as f64 * period_ns + 0.5) as i64;
            let noisy = (command + sigma * noise).clamp(-1.0, 1.0);
            reader.push(&mut state, &Sample::command(time_ns, noisy), &mut keep);
        }
        reader.finish(&mut state, &mut keep);
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The shorter warm-up leaves phases where a whole cycle of it would have them: within a third of the noise that the mean of a
    /// phase keeps after 50 cycles (1.7e-5), or a thousandth of what the leak does to it.
    #[test]
    fn half_a_cycle_warms_a_machine_up() {
        let with = |assignments: &[&str], leak_area_m2: f64| {
            let mut spec = MachineSpec::default();
            for assignment in assignments {
                spec.set_effect(assignment).unwrap();
            }
            Observation {
                spec,
                load_factor: 1.0,
                stretch: 1.0,
                leak_area_m2,
                laminar_share: 0.0,
                null_deviation: 0.0,
                extra_deadband: 0.0,
                stream: 0,
            }
        };
        let deadband = ["valve_deadband.half_width=0.01"];
        let accumulator = ["accumulator.volume_m3=0.002", "accumulator.precharge_pa=1e7"];
        let observations: Vec<Observation> = [0.0, 1e-8, 1e-6, 1e-5]
            .iter()
            .flat_map(|leak| [&[][..], &deadband[..], &accumulator[..]].map(|effects| with(effects, *leak)))
            .map(|one| Observation { spec: one.spec.with_stable_steps(), ..one })
            .collect();
        let whole: Vec<Job> = observations
            .iter()
            .map(|observation| {
                let runs = vec![CycleRun::with_leak(observation.leak_area_m2)];
                Job {
                    spec: observation.spec.clone(),
                    runs,
                    start_tick: 0,
                    skip_ticks: 9_000,
                    record_ticks: 12_000,
                }
            })
            .collect();
        // One at a time: each takes its own steps.
        for (job, observation) in whole.iter().zip(&observations) {
            let one = std::slice::from_ref(observation);
            let short = simulate(one, |_, commands| commands.to_vec());
            let long =
                batch::commands(std::slice::from_ref(job), Steps::Fewest, |_, commands| commands.to_vec());
            assert_eq!(short[0].len(), long[0].len());
            let mean = |commands: &[f64], from: usize, to: usize| {
                commands[1_000 + from..1_000 + to].iter().sum::<f64>() / (to - from) as f64
            };
            for (from, to) in [(0, 500), (500, 2_500), (2_500, 3_000), (3_000, 4_000), (6_000, 8_500)] {
                let (short, long) = (mean(&short[0], from, to), mean(&long[0], from, to));
                let bound = 5e-6_f64.max(1e-3 * long.abs());
                assert!((short - long).abs() < bound, "{observation:?} {from}: {short} {long}");
            }
        }
    }

    #[test]
    fn cycle_of_few_ticks_is_simulated() {
        for period_s in [0.03, 0.1, 0.15] {
            let mut spec = MachineSpec::default();
            spec.cycle.period_s = period_s;
            for (index, stroke) in spec.cycle.moves.iter_mut().enumerate() {
                (stroke.from_s, stroke.to_s) =
                    (0.3 * index as f64 * period_s, (0.3 * index as f64 + 0.2) * period_s);
            }
            spec.cycle.load.clear();
            let one = Observation {
                spec,
                load_factor: 1.0,
                stretch: 1.0,
                leak_area_m2: 0.0,
                laminar_share: 0.0,
                null_deviation: 0.0,
                extra_deadband: 0.0,
                stream: 49,
            };
            let ticks = simulate(&[one], |_, commands| commands.len())[0] as f64;
            assert!(ticks > 1e3 * period_s && ticks < 3e3 * period_s + 100.0, "{period_s}: {ticks}");
        }
    }

    /// A fifth of the machines overlap, by up to a tenth of full command, evenly; the others do as the plan does.
    #[test]
    fn valves_that_may_overlap_do_so_by_their_share() {
        let spread = Spread { deadband: (0.2, 0.1), ..Spread::default() };
        let mut noise = Noise::new(5, 1);
        let drawn: Vec<Observation> =
            (0..2000).map(|stream| spread.machine(&MachineSpec::default(), stream, &mut noise)).collect();
        let wide: Vec<f64> =
            drawn.iter().map(|one| one.extra_deadband).filter(|width| *width > 0.0).collect();
        // Three standard errors of a share of 0.2, and of the mean of as many numbers.
        assert!((wide.len() as f64 / 2000.0 - 0.2).abs() < 0.027, "{}", wide.len());
        assert!((wide.iter().sum::<f64>() / wide.len() as f64 - 0.05).abs() < 0.0044);
        assert!(drawn.iter().all(|one| (series::deadband(&one.spec) - one.extra_deadband).abs() < 1e-12));
    }
}

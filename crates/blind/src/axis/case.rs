//! Cases: a machine, its papers, its logs, and what is true of them.

use std::collections::BTreeMap;

use seepd_sim::noise::Noise;
use serde::{Deserialize, Serialize};

use super::data_sheet::DataSheet;
use super::decency::decent;
use super::draw::{Built, Choice, build};
use super::duty::{Beginning, Timeline};
use super::log_file::{LogFormat, LoggedSignals};
use super::machine::{Leak, Machine};
use super::run::{Day, run};

/// Machines that are drawn until one is decent.
const DRAWS: u64 = 10_000;
/// How far a part may be off its catalogue; these are the tolerances that hold for it, less a margin for rounding.
const VALVE_TOLERANCE: f64 = 0.09;
const PUMP_TOLERANCE: f64 = 0.09;
const MASS_TOLERANCE: f64 = 0.19;
/// Length of a healthy log where its cycles are long, s.
const LONGEST_HEALTHY_S: f64 = 1800.0;
/// Leaks of a worn seal, share of the valve's rated flow at 70 bar.
const LEAKS: (f64, f64) = (3e-3, 0.15);
/// First of a ladder of leaks, share of the valve's rated flow, the factor from one to the next, and how many there are.
const LADDER: (f64, f64) = (2e-3, 1.5);
const RUNGS: i32 = 9;
/// Shifts of a valve's null, share of full command, to either side.
const NULL_SHIFTS: (f64, f64) = (2e-3, 0.02);

/// A machine with its papers and its logs.
#[derive(Debug, Clone, PartialEq)]
pub struct Case {
    /// Its name.
    pub name: String,
    /// What its user can read off its papers.
    pub sheet: DataSheet,
    /// What is true of it.
    pub truth: Truth,
}

/// What is true of a case.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// The machine.
    pub machine: Machine,
    /// The valve's rated flow as catalogues have it, L/min.
    pub rated_flow_lpm: f64,
    /// How the logs are written.
    pub format: LogFormat,
    /// The logs by name; the one that adoption is given is [`HEALTHY`].
    pub logs: BTreeMap<String, LogTruth>,
}

/// What is true of a log.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LogTruth {
    /// Leak past the piston.
    pub leak: Leak,
    /// The same flow at 70 bar and the working temperature, L/min.
    pub leak_lpm: f64,
    /// By how much the valve's null is another than in the healthy log, share of full command.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub null_shift: f64,
    /// Oil temperature at the beginning and at the end, °C.
    pub temperature_c: (f64, f64),
    /// Factor on process forces.
    pub force: f64,
    /// What the log begins with.
    pub beginning: Beginning,
    /// Duty cycles that are whole in the log.
    pub cycles: usize,
    /// Seed of its noise and variation.
    pub seed: u64,
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

/// Name of the healthy log that a machine is adopted from.
pub const HEALTHY: &str = "healthy";
/// Name of the log with a shifted null.
const SHIFTED: &str = "later-null";

/// What later logs a case has beside its two or three leaks.
#[derive(Debug, Clone, Copy, Default)]
pub struct Later {
    /// Leaks from 0.2 % of the valve's rated flow in steps of 1.5, in the place of those that are drawn: they tell the smallest that is
    /// found.
    pub ladder: bool,
    /// Duty cycles of the healthy one, in the place of 20 to 30.
    pub healthy_cycles: Option<usize>,
    /// One more log: the seal healthy and the valve's null shifted, by 0.2 to 2 % of full command.
    pub null_shift: bool,
}

/// Draws a case; the same for a seed and a number. None where no decent machine was drawn.
pub fn draw(seed: u64, number: usize, signals: LoggedSignals, later: Later) -> Option<Case> {
    let name = format!("case-{number:03}");
    let seed = seed.wrapping_mul(100_003).wrapping_add(number as u64);
    let (built, machine) = (0..DRAWS).find_map(|draw| drawn_machine(seed, draw))?;
    let mut noise = Noise::new(seed, 2);
    let sheet = DataSheet::of(&name, &built, &mut noise);
    let period_s = machine.duty.period_s();
    let as_many = (LONGEST_HEALTHY_S / period_s) as usize;
    let cycles = (60 + noise.index(41)).min(as_many).max(24);
    let healthy_s = cycles as f64 * period_s;
    let format = LogFormat::draw(signals, machine.controller.period_s, period_s, healthy_s, &mut noise);
    let logs = logs(&machine, built.rated_m3_per_s, cycles, seed, later, &mut noise);
    let truth = Truth { machine, rated_flow_lpm: built.rated_m3_per_s * 6e4, format, logs };
    Some(Case { name, sheet, truth })
}

/// A machine as its catalogues have it and as it was made, where it is decent.
fn drawn_machine(seed: u64, draw: u64) -> Option<(Built, Machine)> {
    let mut noise = Noise::new(seed, 1000 + draw);
    let built = build(&mut noise)?;
    let mut machine = built.machine.clone();
    machine.valve.coefficient *= noise.factor(VALVE_TOLERANCE);
    machine.supply.flow_m3_per_s *= noise.factor(PUMP_TOLERANCE);
    let mass = noise.factor(MASS_TOLERANCE);
    machine.cylinder.mass_kg *= mass;
    machine.cylinder.weight_n *= mass;
    decent(&machine, healthy_leak(built.rated_m3_per_s, &mut noise)).then_some((built, machine))
}

fn healthy_leak(rated_m3_per_s: f64, noise: &mut Noise) -> Leak {
    Leak { flow_m3_per_s: rated_m3_per_s * noise.uniform(5e-5, 5e-4), exponent: 1.0 }
}

/// The healthy log, then those with leaks and a healthy one, in an order that tells nothing.
fn logs(
    machine: &Machine,
    rated_m3_per_s: f64,
    healthy_cycles: usize,
    seed: u64,
    later: Later,
    noise: &mut Noise,
) -> BTreeMap<String, LogTruth> {
    let healthy = healthy_leak(rated_m3_per_s, noise);
    let exponent = if noise.chance(0.7) { 0.5 } else { noise.uniform(0.5, 1.0) };
    let shares: Vec<f64> = if later.ladder {
        (0..RUNGS).map(|rung| LADDER.0 * LADDER.1.powi(rung)).collect()
    } else {
        (0..2 + noise.index(2)).map(|_| noise.log_uniform(LEAKS.0, LEAKS.1)).collect()
    };
    let leaks = shares.iter().map(|share| Leak { flow_m3_per_s: rated_m3_per_s * share, exponent });
    // A number drawn for each is its place.
    let mut ordered: Vec<(f64, Leak)> =
        std::iter::once(healthy).chain(leaks).map(|leak| (noise.uniform(0.0, 1.0), leak)).collect();
    ordered.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    let mut logs = BTreeMap::new();
    let beginning =
        [Beginning::AtWork, Beginning::AtWork, Beginning::Idle, Beginning::Manual][noise.index(4)];
    let mut plan = |name: String, leak: Leak, cycles: usize, beginning: Beginning| {
        let warm_c = machine.oil.temperature_c + noise.uniform(-3.0, 3.0);
        let truth = LogTruth {
            leak,
            leak_lpm: leak.flow_m3_per_s * 6e4,
            null_shift: 0.0,
            temperature_c: (warm_c, warm_c + noise.uniform(-1.5, 1.5)),
            force: noise.factor(0.02),
            beginning,
            cycles,
            seed: seed.wrapping_mul(31).wrapping_add(logs.len() as u64),
        };
        logs.insert(name, truth);
    };
    plan(HEALTHY.into(), healthy, healthy_cycles, beginning);
    for (index, (_, leak)) in ordered.into_iter().enumerate() {
        let cycles = later.healthy_cycles.filter(|_| leak == healthy);
        let cycles = cycles.unwrap_or(20 + (index * 7 + healthy_cycles) % 11);
        plan(format!("later-{:02}", index + 1), leak, cycles, Beginning::AtWork);
    }
    if later.null_shift {
        logs.insert(SHIFTED.into(), shifted(&logs[HEALTHY], seed));
    }
    logs
}

/// A day like the healthy one, after the valve's null has shifted. Drawn apart: every other log stays what it is without it.
fn shifted(healthy: &LogTruth, seed: u64) -> LogTruth {
    let mut noise = Noise::new(seed, 3);
    let size = noise.log_uniform(NULL_SHIFTS.0, NULL_SHIFTS.1);
    LogTruth {
        null_shift: if noise.chance(0.5) { size } else { -size },
        force: noise.factor(0.02),
        beginning: Beginning::AtWork,
        cycles: 20 + noise.index(11),
        seed: seed.wrapping_mul(31).wrapping_sub(1),
        ..healthy.clone()
    }
}

impl Truth {
    /// Writes a log, sample by sample with its time in s; whether the machine stayed finite.
    ///
    /// # Errors
    /// Those of `write`.
    pub fn write_log<E>(
        &self,
        log: &LogTruth,
        mut write: impl FnMut(f64, &str) -> Result<(), E>,
    ) -> Result<bool, E> {
        let timeline =
            Timeline::plan(&self.machine.duty, log.cycles, log.beginning, &mut Noise::new(log.seed, 5));
        let mut machine = self.machine.clone();
        machine.valve.null_offset += log.null_shift;
        let day = Day { leak: log.leak, temperature_c: log.temperature_c, force: log.force };
        let mut noise = Noise::new(log.seed, 6);
        let mut written = Ok(());
        let mut text = String::new();
        let finite = run(&machine, &day, &timeline, self.format.nth, |sample| {
            if written.is_ok() {
                text.clear();
                self.format.text(sample, &mut noise, &mut text);
                written = write(sample.time_s, &text);
            }
        });
        written.map(|()| finite)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(truth: &Truth, log: &LogTruth) -> Vec<String> {
        let mut rows = Vec::new();
        let finite = truth.write_log(log, |_, row| {
            rows.push(row.to_owned());
            Ok::<(), std::convert::Infallible>(())
        });
        assert_eq!(finite, Ok(true));
        rows
    }

    #[test]
    fn a_case_is_the_same_for_a_seed_and_its_logs_to_the_byte() {
        let case = draw(3, 1, LoggedSignals::Position, Later::default()).unwrap();
        assert_eq!(draw(3, 1, LoggedSignals::Position, Later::default()).unwrap(), case);
        assert_ne!(
            draw(4, 1, LoggedSignals::Position, Later::default()).unwrap().truth.machine,
            case.truth.machine
        );
        assert_ne!(
            draw(3, 2, LoggedSignals::Position, Later::default()).unwrap().truth.machine,
            case.truth.machine
        );
        let short = LogTruth { cycles: 1, ..case.truth.logs["later-01"].clone() };
        let written = rows(&case.truth, &short);
        assert_eq!(rows(&case.truth, &short), written);
        let other = LogTruth { seed: short.seed + 1, ..short };
        assert_ne!(rows(&case.truth, &other), written);
        assert!(written.len() > 50, "{} rows", written.len());
    }

    #[test]
    fn catalogues_are_right_within_their_tolerances_and_leaks_within_what_is_asked() {
        for number in 1..=8 {
            let Case { sheet, truth, .. } =
                draw(9, number, LoggedSignals::Command, Later::default()).unwrap();
            let Machine { cylinder, valve, supply, .. } = &truth.machine;
            let within = |known: Option<f64>, true_value: f64, tolerance: f64| {
                known.is_none_or(|known| (true_value / known - 1.0).abs() < tolerance)
            };
            let edges = if sheet.valve.rated_over == Some("land") { 1.0 } else { 2.0 };
            let rated = valve.coefficient * (sheet.valve.rated_at_bar.unwrap() * 1e5 / edges).sqrt() * 6e4;
            assert!(within(sheet.valve.rated_flow_lpm, rated, 0.1), "{number}: {rated} L/min, {sheet:?}");
            assert!(within(sheet.supply.pump_flow_lpm, supply.flow_m3_per_s * 6e4, 0.1), "{sheet:?}");
            assert!(within(sheet.cylinder.moved_mass_kg, cylinder.mass_kg, 0.2), "{sheet:?}");
            let measures = [sheet.cylinder.bore_mm, sheet.cylinder.rod_mm, sheet.cylinder.stroke_mm];
            let exact = [cylinder.bore_m, cylinder.rod_m, cylinder.stroke_m];
            assert!(measures.iter().zip(exact).all(|(known, exact)| within(*known, exact * 1e3, 1e-9)));
            assert!(measures.iter().flatten().count() >= 2, "{sheet:?}");
            let shares: Vec<f64> =
                truth.logs.values().map(|log| log.leak_lpm / truth.rated_flow_lpm).collect();
            assert_eq!(shares.iter().filter(|share| **share <= 5e-4).count(), 2, "{shares:?}");
            assert!(
                (4..=5).contains(&shares.len()) && shares.iter().all(|share| *share <= 0.15),
                "{shares:?}"
            );
        }
    }

    /// The log with a shifted null is a healthy one of its own, which changes no other log, and the machine works by its shift.
    #[test]
    fn a_shifted_null_is_one_more_log_of_a_healthy_seal() {
        let of = |null_shift| {
            let later = Later { null_shift, ..Later::default() };
            draw(3, 1, LoggedSignals::Position, later).unwrap().truth
        };
        let (without, mut with) = (of(false), of(true));
        let shifted = with.logs.remove(SHIFTED).unwrap();
        assert_eq!(with, without);
        assert_eq!(shifted.leak, with.logs[HEALTHY].leak);
        assert!((2e-3..=0.02).contains(&shifted.null_shift.abs()), "{}", shifted.null_shift);
        let short = LogTruth { cycles: 1, ..shifted };
        assert_ne!(rows(&with, &short), rows(&with, &LogTruth { null_shift: 0.0, ..short.clone() }));
    }

    #[test]
    fn a_ladder_has_its_rungs_and_a_long_healthy_log_its_cycles() {
        let later = Later { ladder: true, healthy_cycles: Some(1000), ..Later::default() };
        let truth = draw(3, 1, LoggedSignals::Command, later).unwrap().truth;
        let mut shares: Vec<f64> =
            truth.logs.values().map(|log| log.leak_lpm / truth.rated_flow_lpm).collect();
        shares.sort_by(f64::total_cmp);
        assert_eq!(shares.len(), 11);
        assert!(
            (shares[2] / 2e-3 - 1.0).abs() < 1e-9 && (shares[10] / shares[9] - 1.5).abs() < 1e-9,
            "{shares:?}"
        );
        let long: Vec<&LogTruth> = truth.logs.values().filter(|log| log.cycles == 1000).collect();
        assert!(long.len() == 1 && long[0].leak == truth.logs[HEALTHY].leak, "{long:?}");
    }
}

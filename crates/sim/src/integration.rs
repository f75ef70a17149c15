//! Steps of the plant in time: the classical Runge–Kutta method, and a stabilised one for whoever asks for less than its accuracy.
//!
//! A plant of oil is stiff: its fastest eigenvalue, of the smallest volume at standstill, is some 15,000 1/s, real and of no interest, and
//! RK4 needs a step of 0.2 ms because of it alone. A Runge–Kutta–Chebyshev method of second order (Sommeijer, Shampine & Verwer, RKC: an
//! explicit solver for parabolic PDEs, Journal of Computational and Applied Mathematics 88 (1997)) is stable on the negative real axis up to
//! 0.65 s² with s evaluations, where RK4 is up to 2.8 with four.

use crate::plant::{ActingLaws, Drive, Motion, Plant, State};
use crate::real::Real;
use crate::spec::MachineSpec;

/// RK4 is stable on the negative real axis up to this product of step and eigenvalue (Hairer & Wanner,
/// Solving Ordinary Differential Equations II, section IV.2).
pub(crate) const RK4_STABILITY_LIMIT: f64 = 2.78;

/// Which steps machines take.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Steps {
    /// Those of RK4 that their files give: the reference.
    Own,
    /// The fewest evaluations with which they are stable, a quarter or so: for fits and training, which run thousands of machines. Signals
    /// are within 4e-4 of their ranges of the reference, a command within 1e-4, mostly far nearer. A law that goes by the plant's steps has
    /// half of the file's at least, and one with states of its own all of them.
    Fewest,
}

/// How a step is taken.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Method {
    /// The classical one of fourth order.
    RungeKutta4,
    /// The stabilised one of second order.
    Chebyshev(Chebyshev),
}

/// How machines that run side by side go from tick to tick.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Stepping {
    /// Steps of a controller period.
    pub(crate) steps: usize,
    /// How each is taken.
    pub(crate) method: Method,
}

/// Evaluations of an RK4 step.
const RK4_STAGES: usize = 4;
/// Share of its limit to which a method is used: the valve's flow under way is steeper than at standstill.
const OF_THE_LIMIT: f64 = 0.8;
/// Largest product of step and angular frequency of an oscillation: its frequency is off by 3 % there, and its damping by 0.9 % of the
/// critical one.
const LARGEST_ANGLE: f64 = 0.6;
/// Most evaluations of a step: rounding errors grow with their square.
const MOST_STAGES: usize = 20;
/// How many counts of steps are tried beyond the fewest.
const TRIED: usize = 8;

impl Stepping {
    /// Of machines, one or more.
    pub(crate) fn of(machines: &[&MachineSpec], steps: Steps) -> Self {
        match steps {
            Steps::Own => Self::own(machines),
            Steps::Fewest => Self::fewest(machines),
        }
    }

    /// The steps of the first one's file.
    pub(crate) fn own(machines: &[&MachineSpec]) -> Self {
        let steps = machines.first().map_or(1, |machine| machine.controller.steps_per_period);
        Stepping { steps, method: Method::RungeKutta4 }
    }

    fn fewest(machines: &[&MachineSpec]) -> Self {
        let asked = machines.iter().map(|machine| machine.steps_of_laws()).max().unwrap_or(1);
        let motions: Vec<(f64, Motion)> =
            machines.iter().map(|machine| (machine.controller.period_s, machine.motion())).collect();
        let classical_of =
            |(machine, (_, motion)): (&&MachineSpec, &(f64, Motion))| machine.least_steps(motion);
        let classical = machines.iter().zip(&motions).map(classical_of).fold(asked, usize::max);
        let stable = |steps: usize| {
            let is_stable = |method: &Chebyshev| {
                motions.iter().all(|(period_s, motion)| method.is_stable(period_s / steps as f64, motion))
            };
            let method = (2..=MOST_STAGES).map(Chebyshev::new).find(is_stable)?;
            Some((steps, method))
        };
        let evaluations = |(steps, method): &(usize, Chebyshev)| steps * method.stages.len();
        let found = (asked..asked + TRIED).filter_map(stable).min_by_key(evaluations);
        match found.filter(|found| evaluations(found) < RK4_STAGES * classical) {
            Some((steps, method)) => Stepping { steps, method: Method::Chebyshev(method) },
            None => Stepping { steps: classical, method: Method::RungeKutta4 },
        }
    }
}

/// The coefficients of a Runge–Kutta–Chebyshev method.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Chebyshev {
    stages: Vec<Stage>,
    /// Product of step and eigenvalue up to which it is stable on the negative real axis.
    limit: f64,
}

/// A stage's coefficients: of the two stages before it, of the rate at the last, and of the rate at the step's start.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Stage {
    last: f64,
    before: f64,
    rate: f64,
    first: f64,
    /// Share of the step at which the rate is taken.
    at: f64,
}

/// Damping of the method: narrows the region of stability a little, and lets no fast motion persist.
const DAMPING: f64 = 2.0 / 13.0;

impl Chebyshev {
    /// The method with that many evaluations a step, two or more.
    fn new(stages: usize) -> Self {
        let count = stages.max(2);
        let w0 = 1.0 + DAMPING / (count * count) as f64;
        // Chebyshev's polynomials there, with two derivatives.
        let mut t = vec![[1.0, 0.0, 0.0], [w0, 1.0, 0.0]];
        for j in 2..=count {
            let ([a, da, dda], [b, db, ddb]) = (t[j - 1], t[j - 2]);
            t.push([2.0 * w0 * a - b, 2.0 * a + 2.0 * w0 * da - db, 4.0 * da + 2.0 * w0 * dda - ddb]);
        }
        let [_, slope, bend] = t[count];
        let w1 = slope / bend;
        let b = |j: usize| {
            let [_, slope, bend] = t[j.max(2)];
            bend / (slope * slope)
        };
        let c = |j: usize| match j {
            0 => 0.0,
            1 => w1 * t[2][2] / t[2][1] / (4.0 * w0),
            _ => w1 * t[j][2] / t[j][1],
        };
        let stage = |j: usize| {
            if j == 1 {
                return Stage { last: 0.0, before: 0.0, rate: b(1) * w1, first: 0.0, at: 0.0 };
            }
            let rate = 2.0 * b(j) * w1 / b(j - 1);
            Stage {
                last: 2.0 * b(j) * w0 / b(j - 1),
                before: -b(j) / b(j - 2),
                rate,
                first: -(1.0 - b(j - 1) * t[j - 1][0]) * rate,
                at: c(j - 1),
            }
        };
        // The polynomial stays within 1 until its argument w0 + w1 z is −1.
        let limit = (w0 + 1.0) / w1;
        Chebyshev { stages: (1..=count).map(stage).collect(), limit }
    }

    /// Whether steps of that length neither blow up the fastest motion nor change oscillations.
    fn is_stable(&self, step_s: f64, motion: &Motion) -> bool {
        motion.fastest_per_s * step_s <= OF_THE_LIMIT * self.limit
            && motion.oscillation_per_s * step_s <= LARGEST_ANGLE
    }
}

impl<T: Real> Plant<T> {
    /// One step of `dt` seconds under a held spool.
    #[inline(always)]
    pub(crate) fn stepped(
        &self,
        method: &Method,
        state: &State<T>,
        drive: &Drive<T>,
        dt: T,
        acting: &ActingLaws<'_, T>,
    ) -> State<T> {
        let zero = State::from_array([T::splat(0.0); 6]);
        // In one loop for both methods, so that the rates are compiled once for each instruction set.
        let stages = match method {
            Method::RungeKutta4 => RK4_STAGES,
            Method::Chebyshev(method) => method.stages.len(),
        };
        let half = dt * T::splat(0.5);
        let (mut at, mut load) = (*state, drive.load);
        // Rates of RK4; or changes since the step's start at the last two stages and the first rate.
        let mut kept = [zero; 4];
        for stage in 0..stages {
            let rate = self.rates_at(&at, load, drive, acting);
            match method {
                Method::RungeKutta4 => {
                    kept[stage] = rate;
                    let (length, share) = if stage < 2 { (half, 0.5) } else { (dt, 1.0) };
                    load = drive.load_at(share);
                    at = state.advanced(&rate, length);
                }
                Method::Chebyshev(method) => {
                    let of = &method.stages[stage];
                    let [last, before, first, _] = &mut kept;
                    if stage == 0 {
                        *first = rate;
                    }
                    let next = last
                        .times(T::splat(of.last))
                        .advanced(before, T::splat(of.before))
                        .advanced(&rate, dt * T::splat(of.rate))
                        .advanced(first, dt * T::splat(of.first));
                    *before = *last;
                    *last = next;
                    if let Some(next) = method.stages.get(stage + 1) {
                        load = drive.load_at(next.at);
                    }
                    at = state.advanced(last, T::splat(1.0));
                }
            }
        }
        if matches!(method, Method::RungeKutta4) {
            at = state.advanced(&weighted(&kept), dt * T::splat(1.0 / 6.0));
        }
        self.stopped(&at)
    }
}

/// Six times the mean of RK4's rates.
#[inline(always)]
fn weighted<T: Real>([k1, k2, k3, k4]: &[State<T>; 4]) -> State<T> {
    let two = T::splat(2.0);
    State {
        p_s: k1.p_s + two * (k2.p_s + k3.p_s) + k4.p_s,
        p_3: k1.p_3 + two * (k2.p_3 + k3.p_3) + k4.p_3,
        p_1: k1.p_1 + two * (k2.p_1 + k3.p_1) + k4.p_1,
        p_2: k1.p_2 + two * (k2.p_2 + k3.p_2) + k4.p_2,
        x: k1.x + two * (k2.x + k3.x) + k4.x,
        v: k1.v + two * (k2.v + k3.v) + k4.v,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a step makes of 1 under y' = z y / step.
    fn growth(method: &Chebyshev, z: f64) -> f64 {
        let (mut last, mut before) = (0.0, 0.0);
        for stage in &method.stages {
            let next =
                stage.last * last + stage.before * before + z * (stage.rate * (1.0 + last) + stage.first);
            (before, last) = (last, next);
        }
        1.0 + last
    }

    #[test]
    fn chebyshevs_methods_are_of_second_order() {
        for stages in 2..=MOST_STAGES {
            let method = Chebyshev::new(stages);
            let error = |z: f64| (growth(&method, z) - z.exp()).abs();
            // Of third order in one step: half the step, an eighth of the error.
            let ratio = error(-0.02) / error(-0.01);
            assert!((7.5..8.5).contains(&ratio), "{stages} stages: {ratio}");
            // The load is taken where the stage is: the rates' places have the mean of the step, 1/2.
            let ramp = |method: &Chebyshev| {
                let (mut last, mut before) = (0.0, 0.0);
                for stage in &method.stages {
                    let next = stage.last * last + stage.before * before + stage.rate * stage.at;
                    (before, last) = (last, next);
                }
                last
            };
            assert!((ramp(&method) - 0.5).abs() < 1e-12, "{stages} stages: {}", ramp(&method));
        }
    }

    #[test]
    fn chebyshevs_methods_are_stable_to_their_limit_and_not_beyond() {
        for stages in 2..=MOST_STAGES {
            let method = Chebyshev::new(stages);
            // 0.65 s² is the published range; with this damping, (w0 + 1) T''/T' is 2/3 (s² − 1) (1 − 2 ε / 15).
            let published = 2.0 / 3.0 * ((stages * stages) as f64 - 1.0) * (1.0 - 2.0 * DAMPING / 15.0);
            assert!((method.limit / published - 1.0).abs() < 0.02, "{stages}: {} {published}", method.limit);
            let steps = 2_000;
            let most = (1..=steps)
                .map(|step| growth(&method, -method.limit * f64::from(step) / f64::from(steps)).abs())
                .fold(0.0, f64::max);
            assert!(most < 1.0, "{stages} stages: {most}");
            assert!(growth(&method, -1.3 * method.limit).abs() > 1.0, "{stages} stages");
        }
    }

    #[test]
    fn a_stiffer_machine_takes_more_evaluations_and_a_law_its_own_steps() {
        let stages = |stepping: &Stepping| match &stepping.method {
            Method::RungeKutta4 => RK4_STAGES,
            Method::Chebyshev(method) => method.stages.len(),
        };
        let evaluations = |machine: &MachineSpec| {
            let stepping = Stepping::of(&[machine], Steps::Fewest);
            stepping.steps * stages(&stepping)
        };
        let nominal = MachineSpec::default();
        assert_eq!(
            Stepping::of(&[&nominal], Steps::Own),
            Stepping { steps: 10, method: Method::RungeKutta4 }
        );
        assert!(evaluations(&nominal) <= 10, "{}", evaluations(&nominal));
        let mut stiff = nominal.clone();
        stiff.plant.inlet_volume_m3 /= 4.0;
        assert!(evaluations(&stiff) > evaluations(&nominal));
        let mut light = nominal.clone();
        light.plant.mass_kg /= 16.0;
        assert!(
            Stepping::of(&[&light], Steps::Fewest).steps > Stepping::of(&[&nominal], Steps::Fewest).steps
        );
        let mut limited = nominal.clone();
        limited.set_effect("valve_rate_limit.rate_per_s=0.4").unwrap();
        assert!(Stepping::of(&[&nominal, &limited], Steps::Fewest).steps >= 5);
        let mut sprung = nominal;
        sprung.set_effect("structure_compliance.mass_fraction=0.5").unwrap();
        assert!(Stepping::of(&[&sprung], Steps::Fewest).steps >= 10);
    }
}

//! Machines as they are built: each part is chosen for the others, from what catalogues have.

use seepd_sim::noise::Noise;

use super::controller::Controller;
use super::duty::{Duty, Move, Profile, Rapid};
use super::machine::{
    Accumulator, Contact, Cylinder, FlowCurve, GRAVITY_M_PER_S2, Machine, Oil, Pump, Supply, Valve,
};

/// Bores that are made, mm (ISO 3320).
const BORES_MM: [f64; 13] =
    [25.0, 32.0, 40.0, 50.0, 63.0, 80.0, 100.0, 125.0, 160.0, 200.0, 250.0, 320.0, 400.0];
/// Rods that are made, mm (ISO 3320).
const RODS_MM: [f64; 18] = [
    12.0, 14.0, 16.0, 18.0, 22.0, 28.0, 36.0, 45.0, 56.0, 70.0, 90.0, 110.0, 140.0, 160.0, 180.0, 200.0,
    220.0, 280.0,
];
/// Rod over bore.
const ROD_RATIO: (f64, f64) = (0.4, 0.75);
/// Supply pressures, bar.
const PRESSURES_BAR: [f64; 9] = [70.0, 100.0, 120.0, 140.0, 160.0, 180.0, 210.0, 250.0, 280.0];
/// Steps of flows in a decade, as catalogues have them.
const FLOWS: [f64; 10] = [1.0, 1.25, 1.6, 2.0, 2.5, 3.2, 4.0, 5.0, 6.3, 8.0];
/// Task periods of controllers, ms.
const TASKS_MS: [f64; 8] = [0.25, 0.5, 1.0, 2.0, 4.0, 5.0, 10.0, 20.0];
/// Ticks of a cycle, at most: slow machines have slow tasks, and are simulated for hours.
const TICKS: f64 = 1e5;
/// Largest flow that a machine of these asks for, m³/s: 1,500 L/min.
const LARGEST_FLOW: f64 = 0.025;
/// Share of the machines that begin long moves without position control.
const RAPID: f64 = 0.1;
/// Share of the way that a rapid traverse takes.
const RAPID_WAY: f64 = 0.7;
/// L/min in a m³/s.
const LPM: f64 = 6e4;

/// Chance and choice, on top of the noise.
pub(super) trait Choice {
    /// True with this probability.
    fn chance(&mut self, probability: f64) -> bool;
    /// Uniform in the logarithm.
    fn log_uniform(&mut self, low: f64, high: f64) -> f64;
    /// A whole number from 0 to below `count`.
    fn index(&mut self, count: usize) -> usize;
}

impl Choice for Noise {
    fn chance(&mut self, probability: f64) -> bool {
        self.uniform(0.0, 1.0) < probability
    }

    fn log_uniform(&mut self, low: f64, high: f64) -> f64 {
        self.uniform(low.ln(), high.max(low).ln()).exp()
    }

    fn index(&mut self, count: usize) -> usize {
        ((self.uniform(0.0, 1.0) * count as f64) as usize).min(count - 1)
    }
}

/// A machine as a catalogue has it, and how the valve's flow is stated there.
#[derive(Debug, Clone)]
pub(super) struct Built {
    pub(super) machine: Machine,
    /// Rated flow, m³/s.
    pub(super) rated_m3_per_s: f64,
    /// Pressure drop over both edges at which it is rated, Pa.
    pub(super) rated_at_pa: f64,
}

/// Draws a machine; none where the parts that were drawn do not go together.
pub(super) fn build(noise: &mut Noise) -> Option<Built> {
    let pressure_pa = PRESSURES_BAR[noise.index(PRESSURES_BAR.len())] * 1e5;
    let oil = Oil {
        grade_mm2_per_s: [32.0, 46.0, 68.0][noise.index(3)],
        temperature_c: noise.uniform(30.0, 60.0).round(),
        bulk_modulus_pa: noise.uniform(0.9e9, 1.5e9),
        air: noise.log_uniform(5e-4, 5e-3),
    };
    let mut cylinder = cylinder(pressure_pa, &oil, noise)?;
    let omega = natural_rad_per_s(&cylinder, &oil);
    let duty = duty(&cylinder, pressure_pa, omega, noise);
    cylinder.contact = contact(&cylinder, &duty, pressure_pa, noise);
    let supply = supply(&cylinder, &duty, pressure_pa, noise);
    let (valve, rated_m3_per_s, rated_at_pa) = valve(&cylinder, &supply, &duty, noise)?;
    let controller = controller(&cylinder, &supply, &valve, omega, duty.period_s(), noise)?;
    let duty = if noise.chance(RAPID) { with_rapid(duty, &cylinder, &supply, &valve) } else { duty };
    let machine = Machine { cylinder, valve, supply, oil, controller, duty };
    Some(Built { machine, rated_m3_per_s, rated_at_pa })
}

fn cylinder(pressure_pa: f64, oil: &Oil, noise: &mut Noise) -> Option<Cylinder> {
    let bore_mm = BORES_MM[noise.index(BORES_MM.len())];
    let fits = |rod: &&f64| (ROD_RATIO.0..=ROD_RATIO.1).contains(&(**rod / bore_mm));
    let rods: Vec<f64> = RODS_MM.iter().filter(fits).copied().collect();
    let rod_mm = rods[noise.index(rods.len())];
    let longest_mm = (14.0 * bore_mm).min(4000.0);
    let stroke_mm = noise.log_uniform((0.6 * bore_mm).max(20.0), longest_mm).round();
    let on_valve = noise.chance(0.4);
    let mut cylinder = Cylinder {
        bore_m: bore_mm * 1e-3,
        rod_m: rod_mm * 1e-3,
        stroke_m: stroke_mm * 1e-3,
        mass_kg: 0.0,
        weight_n: 0.0,
        dead_volume_m3: 0.0,
        hose_length_m: if on_valve { 0.0 } else { (noise.log_uniform(0.5, 6.0) * 10.0).round() / 10.0 },
        // 4 to 6 m/s in the hose at 0.3 m/s of the piston.
        hose_bore_m: (bore_mm * noise.uniform(0.22, 0.3)).clamp(6.0, 60.0).round() * 1e-3,
        viscous_n_s_per_m: 0.0,
        coulomb_n: 0.0,
        breakaway_n: 0.0,
        contact: None,
    };
    let (cap, annulus) = (cylinder.cap_area_m2(), cylinder.annulus_area_m2());
    let ratio = annulus / cap;
    let strength_n = pressure_pa * cap;
    cylinder.dead_volume_m3 = cap * cylinder.stroke_m * noise.uniform(0.04, 0.12) + 5e-6;
    cylinder.mass_kg = strength_n / GRAVITY_M_PER_S2 * noise.log_uniform(0.01, 0.2);
    let weight_n = cylinder.mass_kg * GRAVITY_M_PER_S2;
    if noise.chance(0.5) {
        let rod_down = noise.chance(0.5);
        // A weight that pulls harder empties the cap side.
        if rod_down && weight_n > 0.4 * ratio.powi(3) * strength_n {
            return None;
        }
        cylinder.weight_n = if rod_down { weight_n } else { -weight_n };
    }
    let omega = natural_rad_per_s(&cylinder, oil);
    cylinder.viscous_n_s_per_m = 2.0 * noise.uniform(0.04, 0.12) * omega * cylinder.mass_kg;
    cylinder.coulomb_n = strength_n * noise.log_uniform(1e-3, 1e-2);
    cylinder.breakaway_n = cylinder.coulomb_n * noise.uniform(0.0, 0.4);
    Some(cylinder)
}

/// Natural frequency of the mass between the two columns of oil in mid-stroke, rad/s.
fn natural_rad_per_s(cylinder: &Cylinder, oil: &Oil) -> f64 {
    let (cap, annulus) = (cylinder.cap_area_m2(), cylinder.annulus_area_m2());
    let half_m = 0.5 * cylinder.stroke_m;
    let fixed = cylinder.fixed_volume_m3();
    let spring = cap * cap / (fixed + cap * half_m) + annulus * annulus / (fixed + annulus * half_m);
    (oil.bulk_modulus_pa * spring / cylinder.mass_kg).sqrt()
}

/// Lets the long moves against no force begin on a command of their own, as fast as they were, where the valve's curve is a line.
fn with_rapid(mut duty: Duty, cylinder: &Cylinder, supply: &Supply, valve: &Valve) -> Duty {
    let longest_m = duty.ways_m().map(f64::abs).fold(0.0, f64::max);
    let ways_m: Vec<f64> = duty.ways_m().collect();
    for (step, way_m) in duty.moves.iter_mut().zip(ways_m) {
        if way_m.abs() < 0.5 * longest_m || step.force_n != 0.0 || valve.curve != FlowCurve::Linear {
            continue;
        }
        let peak_m_per_s = way_m.abs() / step.duration_s * step.profile.peak();
        let (out, back) = speeds(cylinder, supply, 0.0);
        let opening = peak_m_per_s / (valve.coefficient * if way_m > 0.0 { out } else { back });
        let command = (valve.overlap + (1.0 - valve.overlap) * opening).min(1.0).copysign(way_m);
        let duration_s = hundredths(RAPID_WAY * step.duration_s);
        // What is left is positioned in the time that the whole took.
        step.rapid = Some(Rapid { command, duration_s });
        step.duration_s += duration_s;
    }
    duty
}

/// Numbers of moves of a cycle.
const MOVES: [usize; 14] = [2, 2, 2, 2, 2, 3, 3, 4, 4, 5, 6, 8, 10, 12];

fn duty(cylinder: &Cylinder, pressure_pa: f64, omega: f64, noise: &mut Noise) -> Duty {
    let stroke_m = cylinder.stroke_m;
    let (low, high) = (noise.uniform(0.03, 0.3) * stroke_m, noise.uniform(0.5, 0.95) * stroke_m);
    let (start_m, far_m) = if noise.chance(0.85) { (low, high) } else { (high, low) };
    let places = places(start_m, far_m, MOVES[noise.index(MOVES.len())], noise);
    let speed_limit = LARGEST_FLOW / cylinder.cap_area_m2();
    let speed = noise.log_uniform(0.04, 0.6).min(speed_limit).max((high - low) / 20.0);
    let profile = match noise.index(5) {
        0 | 1 => Profile::Trapezoid { ramp: noise.uniform(0.15, 0.35) },
        2 | 3 => Profile::Rounded { ramp: noise.uniform(0.2, 0.4) },
        _ => Profile::Cosine,
    };
    let strength_n = pressure_pa * cylinder.cap_area_m2();
    let ratio = cylinder.annulus_area_m2() / cylinder.cap_area_m2();
    // What brakes the mass must not empty a chamber; 8 is the largest deceleration of the profiles, of a way of 1 in 1 s.
    let braking_m_per_s2 = 0.3 * ratio.powi(3) * strength_n / cylinder.mass_kg / 8.0;
    let mut from_m = start_m;
    let mut moves: Vec<Move> = places
        .iter()
        .map(|&to_m| {
            let way_m = (to_m - from_m).abs();
            from_m = to_m;
            let slowed = speed * noise.log_uniform(0.3, 1.0);
            let duration_s =
                (way_m / slowed).max((way_m / braking_m_per_s2).sqrt()).max(35.0 / omega).max(0.1);
            Move {
                to_m,
                duration_s: hundredths(duration_s),
                profile,
                rapid: None,
                force_n: 0.0,
                dwell_s: 0.0,
            }
        })
        .collect();
    if noise.chance(0.35) {
        press(&mut moves, start_m, strength_n, noise);
    }
    dwell(&mut moves, start_m, noise);
    Duty {
        start_m,
        moves,
        dwell_spread: if noise.chance(0.35) { noise.uniform(0.02, 0.4) } else { 0.0 },
        pause_probability: if noise.chance(0.3) { 0.04 } else { 0.0 },
        force_spread: noise.uniform(0.0, 0.02),
    }
}

/// Where the moves lead: over the far end and back to the start.
fn places(start_m: f64, far_m: f64, count: usize, noise: &mut Noise) -> Vec<f64> {
    let shortest_m = 0.12 * (far_m - start_m).abs();
    let far = noise.index(count - 1);
    let mut places: Vec<f64> = Vec::with_capacity(count);
    for index in 0..count - 1 {
        let before = places.last().copied().unwrap_or(start_m);
        let apart = |place: &f64| {
            (place - before).abs() > shortest_m
                && (place - start_m).abs() > shortest_m
                && (index + 1 != far || (place - far_m).abs() > shortest_m)
        };
        let drawn = std::iter::repeat_with(|| noise.uniform(start_m, far_m)).take(50).find(apart);
        places.push(if index == far { far_m } else { drawn.unwrap_or(0.5 * (start_m + far_m)) });
    }
    places.push(start_m);
    places
}

/// Gives the extending moves a force against them that lasts until the next move.
fn press(moves: &mut [Move], start_m: f64, strength_n: f64, noise: &mut Noise) {
    let force_n = -strength_n * noise.uniform(0.1, 0.5);
    let mut from_m = start_m;
    for step in moves {
        if step.to_m > from_m {
            step.force_n = force_n;
        }
        from_m = step.to_m;
    }
}

/// Gives the moves their dwells: on both sides, or after those that lead away from the start.
fn dwell(moves: &mut [Move], start_m: f64, noise: &mut Noise) {
    let moving_s: f64 = moves.iter().map(|step| step.duration_s).sum();
    let period_s = match noise.index(20) {
        0..=2 => noise.log_uniform(2.0, 3.0),
        3 => noise.log_uniform(60.0, 900.0),
        _ => noise.log_uniform(3.0, 60.0),
    };
    let dwell_s = (period_s - moving_s).max(moving_s * noise.uniform(0.2, 0.6));
    let one_sided = noise.chance(0.3);
    let weights: Vec<f64> = moves
        .iter()
        .map(|step| if one_sided && step.to_m == start_m { 0.0 } else { noise.uniform(0.3, 1.0) })
        .collect();
    let sum: f64 = weights.iter().sum();
    for (step, weight) in moves.iter_mut().zip(weights) {
        step.dwell_s = hundredths(dwell_s * weight / sum);
    }
}

fn contact(cylinder: &Cylinder, duty: &Duty, pressure_pa: f64, noise: &mut Noise) -> Option<Contact> {
    let pressed = duty.moves.iter().any(|step| step.force_n != 0.0);
    if pressed || !noise.chance(0.3) {
        return None;
    }
    let (low, high) = duty
        .origins_m()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), at_m| (low.min(at_m), high.max(at_m)));
    let depth_m = (high - low) * noise.uniform(0.02, 0.08);
    let force_n = pressure_pa * cylinder.cap_area_m2() * noise.uniform(0.1, 0.45);
    Some(Contact { at_m: high - depth_m, stiffness_n_per_m: force_n / depth_m })
}

fn supply(cylinder: &Cylinder, duty: &Duty, pressure_pa: f64, noise: &mut Noise) -> Supply {
    let mut largest: f64 = 0.0;
    let mut volume_m3 = 0.0;
    for (from_m, step) in duty.origins_m().zip(&duty.moves) {
        let way_m = step.to_m - from_m;
        let area = if way_m > 0.0 { cylinder.cap_area_m2() } else { cylinder.annulus_area_m2() };
        largest = largest.max(area * way_m.abs() / step.duration_s * step.profile.peak());
        volume_m3 += area * way_m.abs();
    }
    let mean = volume_m3 / duty.period_s();
    let stored =
        noise.chance(0.25).then(|| noise.uniform(4.0, 8.0) * volume_m3).filter(|volume| *volume < 0.2);
    let pump = if stored.is_none() && noise.chance(0.45) { Pump::Regulated } else { Pump::Fixed };
    let wanted = if stored.is_some() { (1.5 * mean).max(0.6 * largest) } else { largest };
    let flow_m3_per_s = catalogued(wanted * noise.uniform(1.15, 1.6));
    let relative_band = if pump == Pump::Fixed { (0.04, 0.12) } else { (0.03, 0.06) };
    Supply {
        pump,
        flow_m3_per_s,
        pressure_pa,
        band_pa: pressure_pa * noise.uniform(relative_band.0, relative_band.1),
        volume_m3: (flow_m3_per_s * noise.uniform(0.5, 1.5)).max(3e-4),
        accumulator: stored.map(|volume_m3| Accumulator {
            volume_m3: (volume_m3 * 1e4).ceil() * 1e-4,
            precharge_pa: 0.7 * pressure_pa,
        }),
        return_pa: noise.uniform(0.5, 5.0).round() * 1e5,
    }
}

/// The smallest flow of a catalogue that is not below this, m³/s.
fn catalogued(flow_m3_per_s: f64) -> f64 {
    let lpm = flow_m3_per_s * LPM;
    let decade = 10.0_f64.powf(lpm.log10().floor());
    let step = FLOWS.iter().map(|step| step * decade).find(|step| *step >= lpm * (1.0 - 1e-9));
    step.unwrap_or(10.0 * decade) / LPM
}

/// Speed at a valve coefficient of 1 with both edges open alike, m/s: extending and retracting against an outer force.
pub(super) fn speeds(cylinder: &Cylinder, supply: &Supply, force_n: f64) -> (f64, f64) {
    let (cap, annulus) = (cylinder.cap_area_m2(), cylinder.annulus_area_m2());
    let cubes = cap.powi(3) + annulus.powi(3);
    let outer_n = force_n + cylinder.weight_n;
    let forward_n = cap * supply.pressure_pa - annulus * supply.return_pa + outer_n - cylinder.coulomb_n;
    let backward_n = annulus * supply.pressure_pa - cap * supply.return_pa - outer_n - cylinder.coulomb_n;
    ((forward_n.max(0.0) / cubes).sqrt(), (backward_n.max(0.0) / cubes).sqrt())
}

fn valve(cylinder: &Cylinder, supply: &Supply, duty: &Duty, noise: &mut Noise) -> Option<(Valve, f64, f64)> {
    let needed = duty.origins_m().zip(&duty.moves).map(|(from_m, step)| {
        let peak = (step.to_m - from_m) / step.duration_s * step.profile.peak();
        let viscous_n = cylinder.viscous_n_s_per_m * peak;
        let pressed_n = if peak > 0.0 { contact_n(cylinder, step.to_m) } else { 0.0 };
        let (out, back) = speeds(cylinder, supply, step.force_n - viscous_n - pressed_n);
        if peak > 0.0 { peak / out } else { -peak / back }
    });
    let needed = needed.fold(0.0, f64::max);
    if !needed.is_finite() {
        return None;
    }
    let servo = noise.chance(0.55);
    let rated_at_pa: f64 = if servo { 70e5 } else { 10e5 };
    // One in seven is too small for its fastest move, and is wide open on the way.
    let reached = if noise.chance(0.15) { noise.uniform(1.05, 1.15) } else { noise.uniform(0.45, 0.95) };
    let rated_m3_per_s = catalogued(needed / reached * (0.5 * rated_at_pa).sqrt());
    let (valve_hz, damping) =
        if servo { (noise.uniform(60.0, 150.0), 0.8) } else { (noise.uniform(20.0, 60.0), 0.9) };
    let curve = match noise.index(5) {
        0 if !servo => FlowCurve::Progressive { line: noise.uniform(0.6, 0.9) },
        1 if !servo => {
            FlowCurve::DoubleGain { knee: noise.uniform(0.35, 0.5), flow: noise.uniform(0.15, 0.25) }
        }
        _ => FlowCurve::Linear,
    };
    let valve = Valve {
        coefficient: rated_m3_per_s / (0.5 * rated_at_pa).sqrt(),
        overlap: if servo || noise.chance(0.2) { 0.0 } else { noise.uniform(0.01, 0.2) },
        rounding: noise.log_uniform(2e-3, 1e-2),
        null_offset: noise.uniform(-0.01, 0.01),
        curve,
        natural_rad_per_s: std::f64::consts::TAU * valve_hz,
        damping,
    };
    Some((valve, rated_m3_per_s, rated_at_pa))
}

fn contact_n(cylinder: &Cylinder, at_m: f64) -> f64 {
    cylinder.contact.map_or(0.0, |contact| contact.stiffness_n_per_m * (at_m - contact.at_m).max(0.0))
}

fn controller(
    cylinder: &Cylinder,
    supply: &Supply,
    valve: &Valve,
    omega: f64,
    cycle_s: f64,
    noise: &mut Noise,
) -> Option<Controller> {
    let (out, back) = speeds(cylinder, supply, 0.0);
    let speed_m_per_s = out.max(back) * valve.coefficient / (1.0 - valve.overlap);
    let steepest = match valve.curve {
        FlowCurve::Linear => 1.0,
        FlowCurve::Progressive { line } => 2.0 - line,
        FlowCurve::DoubleGain { knee, flow } => (1.0 - flow) / (1.0 - knee),
    };
    let loop_per_s = noise.uniform(0.07, 0.16) * omega.min(valve.natural_rad_per_s).min(300.0);
    let kp = loop_per_s / (speed_m_per_s * steepest);
    let fits = |period_s: &f64| loop_per_s * period_s < 0.2 && *period_s > cycle_s / TICKS;
    let tasks: Vec<f64> = TASKS_MS.iter().map(|ms| ms * 1e-3).filter(fits).collect();
    if tasks.is_empty() || loop_per_s < 2.0 {
        return None;
    }
    // A large overlap without a jump leaves many a machine too far from its demand, which is then drawn anew.
    let jump = if noise.chance(if valve.overlap > 0.04 { 0.75 } else { 0.5 }) {
        valve.overlap * noise.uniform(0.8, 1.0)
    } else {
        0.0
    };
    let kind = noise.index(4);
    let ki = if kind == 0 || (kind == 1 && valve.overlap > 0.0) {
        0.0
    } else {
        kp * loop_per_s / noise.uniform(5.0, 15.0)
    };
    let kd = if kind == 3 { noise.uniform(0.03, 0.12) / speed_m_per_s } else { 0.0 };
    let feed_forward =
        if kind == 3 || noise.chance(0.3) { noise.uniform(0.6, 1.0) / speed_m_per_s } else { 0.0 };
    Some(Controller {
        kp_per_m: significant(kp),
        ki_per_m_s: significant(ki),
        kd_s_per_m: significant(kd),
        feed_forward_s_per_m: significant(feed_forward),
        jump: (jump * 1e3).round() * 1e-3,
        period_s: tasks[noise.index(tasks.len())],
    })
}

fn hundredths(value: f64) -> f64 {
    (value * 100.0).round() / 100.0
}

/// Rounded to three digits, as parameters are typed in.
pub(super) fn significant(value: f64) -> f64 {
    if value == 0.0 {
        return 0.0;
    }
    let scale = 10.0_f64.powf(2.0 - value.abs().log10().floor());
    (value * scale).round() / scale
}

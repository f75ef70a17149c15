//! What a learned curve resembles, in words: its direction, its symmetry, how it grows, where it peaks, how it repeats.

use seepd_sim::learned::{Argument, LearnedLaw, Site};

/// Share of a curve's size that another description may miss.
const MISSED: f64 = 0.35;
/// Spread of a curve over its size below which it is the same everywhere.
const SAME: f64 = 0.15;
/// Exponents that have a name, and how near to them a curve must be.
const POWERS: [(f64, &str); 3] =
    [(1.0, "grows in proportion with"), (2.0, "grows with the square of"), (3.0, "grows with the cube of")];
const NEAR_A_POWER: f64 = 0.4;
/// Share of a curve's squares, beside its straight line, that one wave must hold.
const ONE_WAVE: f64 = 0.7;
/// Share of a curve's change from end to end within which it has not begun.
const QUIET: f64 = 0.1;
/// Fewest periods that make a wave.
const PERIODS: f64 = 2.0;

/// Describes a curve by its values at knots from one end of the argument to the other; only visited knots count.
pub(crate) fn resemblance(law: &LearnedLaw, ends: (f64, f64), values: &[f64], visited: &[bool]) -> String {
    let at = |knot: usize| ends.0 + (ends.1 - ends.0) * knot as f64 / (values.len() - 1) as f64;
    let points: Vec<(f64, f64)> =
        (0..values.len()).filter(|knot| visited[*knot]).map(|knot| (at(knot), values[knot])).collect();
    let argument = law.argument.name();
    if points.len() < 3 {
        return format!("the record visits too little of the {argument} to say");
    }
    let signed = matches!(law.argument, Argument::Speed | Argument::Command | Argument::ControlError);
    if signed && let Some(told) = both_ways(law, &points) {
        return told;
    }
    over_one_way(law, &points)
}

/// Root of the mean square.
fn size(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let count = values.clone().count().max(1) as f64;
    (values.map(|value| value * value).sum::<f64>() / count).sqrt()
}

/// A curve over something that has two directions: odd or even, and how it grows.
fn both_ways(law: &LearnedLaw, points: &[(f64, f64)]) -> Option<String> {
    let interpolated = |x: f64| -> Option<f64> {
        let pair = points.windows(2).find(|pair| (pair[0].0..=pair[1].0).contains(&x))?;
        let share = (x - pair[0].0) / (pair[1].0 - pair[0].0);
        Some(pair[0].1 + (pair[1].1 - pair[0].1) * share)
    };
    let pairs: Vec<(f64, f64, f64)> = points
        .iter()
        .filter(|(x, _)| *x > 0.0)
        .filter_map(|(x, value)| Some((*x, *value, interpolated(-x)?)))
        .collect();
    if pairs.len() < 2 {
        return None;
    }
    let odd = size(pairs.iter().map(|(_, here, there)| 0.5 * (here - there)));
    let even = size(pairs.iter().map(|(_, here, there)| 0.5 * (here + there)));
    let argument = law.argument.name();
    if even < MISSED * odd {
        let halves: Vec<(f64, f64)> =
            pairs.iter().map(|(x, here, there)| (*x, 0.5 * (here - there))).collect();
        let against = halves.iter().map(|(x, value)| x * value).sum::<f64>() < 0.0;
        let direction = match (law.argument, law.site, against) {
            (Argument::Speed, Site::Force, true) => "acts against the motion".to_owned(),
            (Argument::Speed, Site::Force, false) => "acts along the motion".to_owned(),
            (_, _, true) => format!("has the other sign than the {argument}"),
            (_, _, false) => format!("has the sign of the {argument}"),
        };
        return Some(format!("{direction}, {}, alike both ways", growth(&halves, argument)));
    }
    (odd < MISSED * even).then(|| {
        let halves: Vec<(f64, f64)> =
            pairs.iter().map(|(x, here, there)| (*x, 0.5 * (here + there))).collect();
        format!("has the same sign both ways, {}", growth(&halves, argument))
    })
}

/// How the magnitude of a curve grows with a positive argument.
fn growth(points: &[(f64, f64)], argument: &str) -> String {
    let largest = points.iter().map(|(_, value)| value.abs()).fold(0.0, f64::max);
    let logs: Vec<(f64, f64)> = points
        .iter()
        .filter(|(x, value)| *x > 0.0 && value.abs() > 0.03 * largest)
        .map(|(x, value)| (x.ln(), value.abs().ln()))
        .collect();
    let exponent = slope(&logs);
    if exponent.abs() < NEAR_A_POWER {
        return format!("is about the same at every {argument}");
    }
    match POWERS.iter().find(|(power, _)| (exponent - power).abs() < NEAR_A_POWER) {
        Some((_, words)) => format!("{words} the {argument}"),
        None if exponent < 0.0 => format!("becomes smaller with the {argument}"),
        None => format!("grows with the {argument} to the power of {exponent:.1}"),
    }
}

fn slope(points: &[(f64, f64)]) -> f64 {
    let n = points.len().max(1) as f64;
    let (x, y) = points.iter().fold((0.0, 0.0), |(x, y), point| (x + point.0 / n, y + point.1 / n));
    let (xy, xx) = points
        .iter()
        .fold((0.0, 0.0), |(xy, xx), point| (xy + (point.0 - x) * (point.1 - y), xx + (point.0 - x).powi(2)));
    if xx > 0.0 { xy / xx } else { 0.0 }
}

/// A curve over a place, a pressure or a time: constant, straight, a wave, a peak, or what sets in somewhere.
fn over_one_way(law: &LearnedLaw, points: &[(f64, f64)]) -> String {
    let argument = law.argument.name();
    let n = points.len() as f64;
    let mean = points.iter().map(|(_, value)| value).sum::<f64>() / n;
    let whole = size(points.iter().map(|(_, value)| *value)).max(f64::MIN_POSITIVE);
    let spread = size(points.iter().map(|(_, value)| value - mean));
    if spread < SAME * whole {
        return format!("is about the same at every {argument}");
    }
    let (x_mean, steepness) = (points.iter().map(|(x, _)| x).sum::<f64>() / n, slope(points));
    let beside = |(x, value): &(f64, f64)| (*x, value - mean - steepness * (x - x_mean));
    let rest: Vec<(f64, f64)> = points.iter().map(beside).collect();
    let rest_size = size(rest.iter().map(|(_, value)| *value));
    if rest_size < MISSED * spread {
        let way = if steepness > 0.0 { "rises" } else { "falls" };
        return format!("{way} steadily with the {argument}");
    }
    if let Some(period) = wave(&rest) {
        return match law.argument {
            Argument::Time => format!("oscillates with {:.2} Hz", 1.0 / period),
            _ => format!("repeats every {}", quantity(period, law.argument)),
        };
    }
    let peak = points.iter().max_by(|a, b| (a.1 - mean).abs().total_cmp(&(b.1 - mean).abs()));
    let Some((at, top)) = peak else { return String::new() };
    let above = |share: f64| points.iter().filter(|(_, value)| (value - mean) / (top - mean) > share).count();
    if let Some(told) = setting_in(points, law.argument) {
        return told;
    }
    if above(0.5) as f64 <= 0.35 * n {
        return format!("acts mostly around {}", quantity(*at, law.argument));
    }
    let way = if steepness > 0.0 { "rises" } else { "falls" };
    format!("{way} with the {argument}, not evenly")
}

/// A curve that hardly changes from one end to some place, and most at the other end.
fn setting_in(points: &[(f64, f64)], argument: Argument) -> Option<String> {
    let (first, last) = (points.first()?, points.last()?);
    let change = (last.1 - first.1).abs();
    let is_quiet = |from: f64, value: f64| (value - from).abs() < QUIET * change;
    let quiet_until = points.iter().take_while(|(_, value)| is_quiet(first.1, *value)).count();
    let quiet_from = points.iter().rev().take_while(|(_, value)| is_quiet(last.1, *value)).count();
    let third = points.len().div_ceil(3);
    let way = if last.1 > first.1 { "rises" } else { "falls" };
    if quiet_until >= third {
        return Some(format!(
            "sets in around {} and {way} from there",
            quantity(points[quiet_until - 1].0, argument)
        ));
    }
    (quiet_from >= third).then(|| {
        let end = points[points.len() - quiet_from].0;
        format!("{way} up to {} and stays there", quantity(end, argument))
    })
}

/// The period of the one wave that holds most of the values, if there is one.
fn wave(points: &[(f64, f64)]) -> Option<f64> {
    let (first, last) = (points.first()?.0, points.last()?.0);
    let width = last - first;
    let all: f64 = points.iter().map(|(_, value)| value * value).sum();
    let most = points.len() as f64 / 2.5;
    let mut best = (0.0, 0.0);
    let mut periods = PERIODS;
    while periods <= most {
        let (mut s, mut c) = (0.0, 0.0);
        for (x, value) in points {
            let (sin, cos) = (std::f64::consts::TAU * periods * (x - first) / width).sin_cos();
            s += sin * value;
            c += cos * value;
        }
        let held = 2.0 * (s * s + c * c) / points.len() as f64;
        if held > best.0 {
            best = (held, periods);
        }
        periods += 0.1;
    }
    (best.0 > ONE_WAVE * all).then(|| width / best.1)
}

fn quantity(value: f64, argument: Argument) -> String {
    match argument.unit() {
        "Pa" => format!("{:.0} bar", 1e-5 * value),
        "m" => format!("{:.0} mm", 1e3 * value),
        "s" => format!("{value:.2} s"),
        "m/s" => format!("{:.0} mm/s", 1e3 * value),
        _ => format!("{value:.2}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use seepd_sim::learned::find;

    fn told(key: &str, ends: (f64, f64), curve: impl Fn(f64) -> f64) -> String {
        let Some(law) = find(key) else { return String::new() };
        let at = |knot: usize| ends.0 + (ends.1 - ends.0) * knot as f64 / (law.knots() - 1) as f64;
        let values: Vec<f64> = (0..law.knots()).map(|knot| curve(at(knot))).collect();
        resemblance(law, ends, &values, &vec![true; values.len()])
    }

    #[test]
    fn curves_are_told_in_words() {
        let speed = |curve: &dyn Fn(f64) -> f64| told("learned_force_over_speed", (-0.3, 0.25), curve);
        assert_eq!(
            speed(&|v| -5e4 * v * v.abs()),
            "acts against the motion, grows with the square of the speed, alike both ways"
        );
        assert_eq!(
            speed(&|v| -900.0 * v.signum()),
            "acts against the motion, is about the same at every speed, alike both ways"
        );
        assert_eq!(speed(&|_| 700.0), "has the same sign both ways, is about the same at every speed");
        let place = |curve: &dyn Fn(f64) -> f64| told("learned_force_over_position", (0.1, 0.4), curve);
        assert_eq!(place(&|x| 2e3 * (x - 0.2)), "rises steadily with the position");
        assert_eq!(place(&|x| 2e3 * (std::f64::consts::TAU * x / 0.1).sin()), "repeats every 100 mm");
        let jam = |x: f64| 3e3 * (-((x - 0.25) / 0.02).powi(2)).exp();
        assert_eq!(told("learned_friction_over_position", (0.1, 0.4), jam), "acts mostly around 250 mm");
        let shaken = |t: f64| 800.0 * (std::f64::consts::TAU * 1.5 * t).sin();
        assert_eq!(told("learned_force_over_time", (0.0, 10.0), shaken), "oscillates with 1.50 Hz");
        let regulator = |p: f64| -2e-9 * (p - 1.58e7).max(0.0);
        let falls = told("learned_supply_over_pressure", (1.5e7, 1.65e7), regulator);
        assert_eq!(falls, "sets in around 158 bar and falls from there");
    }
}

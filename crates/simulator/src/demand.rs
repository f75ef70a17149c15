//! What may lie between the demand of the log and the loop inside of a simulator: a whole-run simulator has no other port that needs no
//! answer.

use seepd_gap::simulated_axis::EffectValues;
use seepd_sim::effects::{EffectInfo, Equation, Parameter};

/// Effects on the demand's way.
pub static CATALOGUE: [EffectInfo; 2] = [
    EffectInfo {
        key: "demand_delay",
        parameters: &[Parameter {
            name: "delay_s",
            unit: "s",
            neutral: 0.0,
            range: (0.0, 0.1),
            source: "bus, controller and valve of closed loops of servo-hydraulic machines: 5 to 50 ms",
        }],
        law: "loop's demand(t) = demand(t − delay_s)",
        signature: "the axis answers to every demand later by the same time",
        equation: Equation::Controller,
    },
    EffectInfo {
        key: "demand_lag",
        parameters: &[Parameter {
            name: "time_constant_s",
            unit: "s",
            neutral: 0.0,
            range: (1e-3, 0.3),
            source: "filters of set points, and closed loops of 0.5 to 150 Hz",
        }],
        law: "d(loop's demand)/dt = (demand − loop's demand) / time_constant_s",
        signature: "the axis answers later and less, the more so the faster the demand",
        equation: Equation::Controller,
    },
];

/// The effect of that key.
pub fn find(key: &str) -> Option<&'static EffectInfo> {
    CATALOGUE.iter().find(|info| info.key == key)
}

/// The demand that reaches the loop, tick by tick.
pub fn reaching(effects: &EffectValues, demand_m: &[f64], period_s: f64) -> Vec<f64> {
    let of = |effect: &str, parameter: &str| {
        effects.get(effect).and_then(|values| values.get(parameter)).copied().unwrap_or(0.0)
    };
    let delayed = delayed(demand_m, of("demand_delay", "delay_s") / period_s);
    lagged(delayed, of("demand_lag", "time_constant_s") / period_s)
}

/// Later by a number of ticks, on straight lines between them.
fn delayed(values: &[f64], ticks: f64) -> Vec<f64> {
    if ticks <= 0.0 {
        return values.to_vec();
    }
    let at = |index: f64| {
        let before = index.max(0.0).floor();
        let (from, share) = (before as usize, index.max(0.0) - before);
        let next = (from + 1).min(values.len() - 1);
        values[from] + share * (values[next] - values[from])
    };
    (0..values.len()).map(|tick| at(tick as f64 - ticks)).collect()
}

/// A first-order lag of that many ticks, exact for a demand that goes on straight lines between ticks.
fn lagged(mut values: Vec<f64>, ticks: f64) -> Vec<f64> {
    if ticks <= 0.0 {
        return values;
    }
    let kept = (-1.0 / ticks).exp();
    let mean = ticks * (1.0 - kept);
    let mut state = values.first().copied().unwrap_or(0.0);
    let mut before = state;
    for value in &mut values {
        let now = *value;
        // The response to a ramp from `before` to `now` over one tick.
        state = state * kept + before * (mean - kept) + now * (1.0 - mean);
        before = now;
        *value = state;
    }
    values
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with(effect: &str, parameter: &str, value: f64) -> EffectValues {
        EffectValues::from([(effect.into(), [(parameter.to_owned(), value)].into())])
    }

    /// A ramp is followed by a lag later by its time constant once it has settled, and by a delay later by the delay.
    #[test]
    fn a_ramp_is_late_by_delay_and_lag() {
        let ramp: Vec<f64> = (0..2000).map(|tick| 0.3 * f64::from(tick) * 1e-3).collect();
        for values in [with("demand_delay", "delay_s", 0.0125), with("demand_lag", "time_constant_s", 0.0125)]
        {
            let late = reaching(&values, &ramp, 1e-3);
            assert!((late[1999] - (ramp[1999] - 0.3 * 0.0125)).abs() < 1e-12, "{values:?}: {}", late[1999]);
        }
        assert_eq!(reaching(&EffectValues::new(), &ramp, 1e-3), ramp);
    }
}

//! Bogacki and Shampine's pair of second and third order with steps of its own choice.
//!
//! A hydraulic axis is stiff where a valve is wide open onto a small chamber and lazy in its holds: steps that follow the error, and with
//! it the limit of stability, cost a tenth of fixed ones.

use super::hydraulics::{STATES, State};

/// Smallest and largest change of the step from one to the next.
const STEP_CHANGE: (f64, f64) = (0.3, 3.0);
/// Share of the step that the error allows which is taken.
const CAUTION: f64 = 0.85;
/// Steps are not made smaller than this, s: what is stiffer has gone out of bounds.
const SMALLEST_STEP_S: f64 = 1e-9;

/// The integrator with the step that it was at.
#[derive(Debug, Clone)]
pub(super) struct Integrator {
    /// Largest error of a step in each state.
    tolerance: State,
    step_s: f64,
}

impl Integrator {
    /// An integrator that keeps each step's error in each state within its tolerance.
    pub(super) fn new(tolerance: State) -> Self {
        Integrator { tolerance, step_s: 1e-5 }
    }

    /// Moves the state by `span_s`, within which the rates depend on the state alone.
    pub(super) fn advance(&mut self, state: &mut State, span_s: f64, rates: impl Fn(&State) -> State) {
        let mut at_s = 0.0;
        let mut k_1 = rates(state);
        while at_s < span_s {
            let left_s = span_s - at_s;
            let h = self.step_s.min(left_s);
            let k_2 = rates(&moved(state, &k_1, 0.5 * h));
            let k_3 = rates(&moved(state, &k_2, 0.75 * h));
            let third: State =
                std::array::from_fn(|i| state[i] + h / 9.0 * (2.0 * k_1[i] + 3.0 * k_2[i] + 4.0 * k_3[i]));
            let k_4 = rates(&third);
            let error = (0..STATES).fold(0.0, |worst: f64, i| {
                let second = h / 72.0 * (-5.0 * k_1[i] + 6.0 * k_2[i] + 8.0 * k_3[i] - 9.0 * k_4[i]);
                worst.max(second.abs() / self.tolerance[i])
            });
            if error <= 1.0 || h <= SMALLEST_STEP_S {
                *state = third;
                k_1 = k_4;
                at_s = if h < left_s { at_s + h } else { span_s };
            }
            let change = (CAUTION / error.cbrt()).clamp(STEP_CHANGE.0, STEP_CHANGE.1);
            // A step that the span's end has cut says nothing of how long the next may be.
            if h >= self.step_s || change < 1.0 {
                self.step_s = (h * change).max(SMALLEST_STEP_S);
            }
        }
    }
}

fn moved(state: &State, rates: &State, by: f64) -> State {
    std::array::from_fn(|i| state[i] + rates[i] * by)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A decay, and an oscillator of 100 rad/s.
    fn rates(state: &State) -> State {
        let mut rates = [0.0; STATES];
        rates[0] = -50.0 * state[0];
        rates[1] = state[2];
        rates[2] = -1e4 * state[1];
        rates
    }

    fn error_of(tolerance: f64) -> f64 {
        let mut state = [0.0; STATES];
        (state[0], state[1]) = (1.0, 1.0);
        let mut tolerances = [tolerance; STATES];
        tolerances[2] *= 100.0;
        let mut integrator = Integrator::new(tolerances);
        (0..100).for_each(|_| integrator.advance(&mut state, 1e-3, rates));
        let exact = [(-5.0_f64).exp(), 10.0_f64.cos()];
        (state[0] - exact[0]).abs().max((state[1] - exact[1]).abs())
    }

    #[test]
    fn analytic_decay_and_oscillation_are_met_the_closer_the_tighter() {
        let errors = [1e-5, 1e-7, 1e-9].map(error_of);
        // Third order: a hundredth of the error a step takes 4.6 times the steps, and leaves about a hundredth times 4.6 of it.
        assert!(errors[0] < 1e-2 && errors[1] < errors[0] / 8.0 && errors[2] < errors[1] / 8.0, "{errors:?}");
    }
}

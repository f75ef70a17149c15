//! What every model does, and what the two machines share: a course of ticks around a plant.

use crate::simulation::ModelError;

/// What computes a model's values; `values` are those of its variables, by reference.
pub(crate) trait Engine: Send {
    /// Puts the machine at its start, and the outputs into `values`.
    fn initialise(&mut self, values: &mut [f64]) -> Result<(), ModelError>;
    /// A step, s, under the inputs in `values`; the outputs are those at its end.
    fn step(&mut self, values: &mut [f64], step_s: f64) -> Result<(), ModelError>;
    /// Forgets what happened.
    fn reset(&mut self) -> Result<(), ModelError>;
    /// A copy with its state, where there can be one.
    fn copied(&self) -> Option<Box<dyn Engine>>;
    /// Length of its own step, s, and whether others must be whole multiples of it.
    fn step_s(&self) -> (f64, bool);
    /// Length of a duty cycle, s.
    fn cycle_s(&self) -> f64;
}

/// Share of a step by which one may be off from a whole multiple of another.
const WHOLE: f64 = 1e-6;

/// How many of a controller's periods make a step.
pub(crate) fn periods_in(step_s: f64, period_s: f64) -> Result<usize, ModelError> {
    let periods = step_s / period_s;
    let whole = periods.round();
    if whole >= 1.0 && (periods - whole).abs() <= WHOLE * whole {
        return Ok(whole as usize);
    }
    let why = format!("with the controller inside it must be a whole multiple of its period, {period_s} s");
    Err(ModelError::Step { step_s, why })
}

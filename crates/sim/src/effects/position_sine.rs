//! Position sine: an encoder or spindle that is off centre: an error that repeats with its pitch.

use super::{Effect, EffectInfo, Equation, Law, Parameter, Sensing, built_by};
use crate::real::Real;

/// See the [module](self).
pub(super) struct PositionSine;

/// Amplitude, m, and wave number, 1/m.
struct Sine<T> {
    amplitude: T,
    wave_number: T,
}

impl<T: Real> Sine<T> {
    fn new(values: &[T]) -> Self {
        // Neutral lanes have no pitch.
        let pitch = values[1].max(T::splat(1e-6));
        Sine { amplitude: values[0], wave_number: T::splat(std::f64::consts::TAU) / pitch }
    }
}

impl<T: Real> Law<T> for Sine<T> {
    fn is_in_balances(&self) -> bool {
        false
    }

    #[inline(always)]
    fn sense(&self, _memory: &mut [T], position: T, _sensing: &Sensing<T>) -> T {
        position + self.amplitude * (self.wave_number * position).map(libm::sin)
    }
}

impl Effect for PositionSine {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "position_sine",
            parameters: &[
                Parameter {
                    name: "amplitude_m",
                    unit: "m",
                    neutral: 0.0,
                    range: (0.0, 5e-4),
                    source: "eccentricity of a measuring wheel or spindle, to half a millimetre",
                },
                Parameter {
                    name: "pitch_m",
                    unit: "m",
                    neutral: 0.0,
                    range: (5e-3, 0.1),
                    source: "pitch of spindles and circumference of measuring wheels",
                },
            ],
            law: "measured = x + amplitude_m · sin(2π x / pitch_m)",
            signature: "command and pressures ripple with the position in slow strokes",
            equation: Equation::Sensor,
        }
    }
    fn is_neutral(&self, values: &[f64]) -> bool {
        values[0] == 0.0
    }
    built_by!(Sine::new);
}

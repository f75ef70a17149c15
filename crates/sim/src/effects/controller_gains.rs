//! Controller gains: gains that were changed on the machine and not in the plan.

use super::{Constants, Effect, EffectInfo, Equation, Law, Parameter, built_by};
use crate::real::Real;

/// See the [module](self).
pub(super) struct ControllerGains;

/// Gains over plan.
struct Gains<T> {
    kp: T,
    ki: T,
    kd: T,
}

impl<T: Real> Gains<T> {
    fn new(values: &[T]) -> Self {
        Gains { kp: values[0], ki: values[1], kd: values[2] }
    }
}

impl<T: Real> Law<T> for Gains<T> {
    fn is_in_balances(&self) -> bool {
        false
    }

    fn adjust(&self, constants: &mut Constants<'_, T>) {
        let pid = &mut *constants.pid;
        pid.kp = pid.kp * self.kp;
        pid.ki_period = pid.ki_period * self.ki;
        pid.kd_per_period = pid.kd_per_period * self.kd;
    }
}

impl Effect for ControllerGains {
    fn info(&self) -> &'static EffectInfo {
        &EffectInfo {
            key: "controller_gains",
            parameters: &[
                Parameter {
                    name: "kp",
                    unit: "1",
                    neutral: 1.0,
                    range: (0.5, 2.0),
                    source: "retuning on site, within a factor of 2",
                },
                Parameter {
                    name: "ki",
                    unit: "1",
                    neutral: 1.0,
                    range: (0.5, 2.0),
                    source: "retuning on site, within a factor of 2",
                },
                Parameter {
                    name: "kd",
                    unit: "1",
                    neutral: 1.0,
                    range: (0.5, 2.0),
                    source: "retuning on site, within a factor of 2",
                },
            ],
            law: "Kp · kp, Ki · ki, Kd · kd: factors on the plant file’s gains",
            signature: "recorded demand and position do not give the recorded command",
            equation: Equation::Controller,
        }
    }
    built_by!(Gains::new);
}

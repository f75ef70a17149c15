//! Courses of the command over a cycle: the last ones, and what a healthy one is like.

use serde::{Deserialize, Serialize};

use seepd_monitor::event::Flag;

/// Cycles that the healthy course is the mean of.
const HEALTHY_CYCLES: u32 = 20;
/// Points of the healthy course.
const HEALTHY_POINTS: usize = 1000;

/// The command's course over a cycle.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Course {
    /// Number of the cycle.
    pub cycle: u64,
    /// Duty cycle, where the axis has several.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub duty_cycle: Option<String>,
    /// Condition after it.
    pub flag: Flag,
    /// Why it was rejected.
    pub reason: Option<&'static str>,
    /// Estimate as a flow, L/min.
    pub leak_flow_lpm: Option<f64>,
    /// What each phase, and the load, contributes to the difference from the baseline, m²; empty without one.
    pub why: Vec<(String, f32)>,
    /// Time from the cycle's start (s) and mean command over the 20 ms around it (share of full command).
    pub points: Vec<(f32, f32)>,
}

/// A stretch of the duty cycle.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PhaseSpan {
    /// Name.
    pub name: String,
    /// Start in the cycle as planned, s.
    pub from_s: f64,
    /// End, s.
    pub to_s: f64,
}

/// The mean course of the first healthy cycles since the seal was new or a baseline was begun.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct HealthyCourse {
    /// Cycles that it is the mean of.
    pub cycles: u32,
    /// End of the first of them, ns on the daemon's line of time.
    pub since_ns: i64,
    /// Duty cycle, where the axis has several.
    #[serde(default)]
    pub duty_cycle: Option<String>,
    /// Time from the cycle's start, s, and command, share of full command.
    pub points: Vec<(f32, f32)>,
}

impl HealthyCourse {
    /// Takes a healthy cycle that ended at a time, ns; those that come once there are enough, and those of another duty cycle, are left
    /// out.
    pub fn take(&mut self, course: &Course, end_ns: i64) {
        if self.cycles >= HEALTHY_CYCLES || course.points.is_empty() {
            return;
        }
        if self.cycles == 0 {
            let step = course.points.len().div_ceil(HEALTHY_POINTS);
            self.points = course.points.iter().step_by(step).copied().collect();
            self.since_ns = end_ns;
            self.duty_cycle.clone_from(&course.duty_cycle);
        } else if self.duty_cycle != course.duty_cycle {
            return;
        } else {
            let weight = 1.0 / (self.cycles + 1) as f32;
            for (at_s, mean) in &mut self.points {
                if let Some(command) = command_at(&course.points, *at_s) {
                    *mean += weight * (command - *mean);
                }
            }
        }
        self.cycles += 1;
    }
}

/// The command at a time, linear between points; `None` outside of them.
fn command_at(points: &[(f32, f32)], at_s: f32) -> Option<f32> {
    let after = points.partition_point(|point| point.0 < at_s);
    let (to_s, to) = *points.get(after)?;
    let Some((from_s, from)) = after.checked_sub(1).and_then(|before| points.get(before)).copied() else {
        return (to_s == at_s).then_some(to);
    };
    Some(from + (to - from) * (at_s - from_s) / (to_s - from_s))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn course(points: Vec<(f32, f32)>) -> Course {
        Course {
            cycle: 0,
            duty_cycle: None,
            flag: Flag::Healthy,
            reason: None,
            leak_flow_lpm: None,
            why: Vec::new(),
            points,
        }
    }

    #[test]
    fn the_healthy_course_is_the_mean_of_the_first_twenty() {
        let mut healthy = HealthyCourse::default();
        healthy.take(&course(vec![(0.0, 1.0), (1.0, 1.0), (2.0, 1.0)]), 7);
        // Its points lie elsewhere, and it is shorter.
        healthy.take(&course(vec![(0.0, 2.0), (0.5, 2.5), (1.5, 3.5)]), 8);
        assert_eq!(healthy.points, [(0.0, 1.5), (1.0, 2.0), (2.0, 1.0)]);
        (0..40).for_each(|_| healthy.take(&course(vec![(0.0, 1.5), (1.0, 2.0), (2.0, 1.0)]), 9));
        assert_eq!((healthy.cycles, healthy.since_ns), (20, 7));
        healthy.take(&course(vec![(0.0, 9.0)]), 10);
        assert!((healthy.points[1].1 - 2.0).abs() < 1e-6);
    }

    #[test]
    fn another_duty_cycle_is_another_course() {
        let mut healthy = HealthyCourse::default();
        healthy.take(&course(vec![(0.0, 1.0)]), 0);
        healthy.take(&Course { duty_cycle: Some("long".into()), ..course(vec![(0.0, 3.0)]) }, 1);
        assert_eq!((healthy.cycles, healthy.points[0].1), (1, 1.0));
    }
}

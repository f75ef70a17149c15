//! The overlap of a valve's lands: how wide it is, how round its edges are, and how evenly the valve leaks.
//!
//! A healthy hold settles within the overlap, where round edges still pass a little; one with a leak stands beside the edge, so that every
//! hundredth of overlap is a hundredth of the valve's flow in the size of the leak. Strokes and holds show it where the log has the position;
//! a command by itself does not.

use std::collections::BTreeMap;

use seepd_gap::Known;
use seepd_sim::MachineSpec;
use seepd_sim::series::Direction;

use crate::machine_data::MachineData;

/// The law of the plant.
pub(crate) const LAW: &str = "valve_overlap";
const HALF_WIDTH: &str = "half_width";
const ROUNDING: &str = "rounding";
/// Widest overlap that the plant knows.
pub(crate) const WIDEST: f64 = 0.25;
/// How much of a valve's overlap its controller usually jumps over: over all of it, a loop hunts.
const JUMP_SHARE: f64 = 0.92;
/// Standard deviation of an overlap that is stated: share of it, and share of full command.
const STATED: (f64, f64) = (0.05, 0.007);
/// Rounding of the edges where nothing tells it, with its standard deviation, share of full command: some hundredths of a millimetre of a
/// travel of millimetres.
const USUAL_ROUNDING: (f64, f64) = (0.006, 0.004);
/// Of an overlap that is stated this share is there, whatever the sheet is off by.
const SURELY_CLOSED: f64 = 0.875;
/// An overlap below this share of full command is the rounded edge of a valve that has none.
const LEAST: f64 = 0.007;

/// What the valve leaks from its inlet into the rod port alone. The lands of a spool leak alike into both ports and out of them, which moves
/// no piston: without an overlap what is left of one side is part of the null, behind one it would push the piston through every hold.
pub(crate) const ONE_SIDED: &str = "valve_rod_resistance_pa_s_per_m3";
/// How much less than the article's an overlapped valve leaks to one side, until the log tells otherwise.
pub(crate) const BALANCED: f64 = 1e3;

/// Half the overlap as the data tell it, share of full command: from the data sheet, or behind the jump of the controller.
pub(crate) fn stated(data: &MachineData) -> Option<f64> {
    let told = data.overlap()?;
    Some(if data.valve.overlap_percent.is_some() { told } else { told / JUMP_SHARE })
}

/// The law's values of an overlap, share of full command.
pub(crate) fn law(half_width: f64) -> BTreeMap<String, f64> {
    [(HALF_WIDTH, half_width), (ROUNDING, USUAL_ROUNDING.0)]
        .map(|(name, value)| (name.to_owned(), value))
        .into()
}

/// Gives a machine whose overlap is to be fitted edges as usual, where it has none yet.
pub(crate) fn free(spec: &mut MachineSpec) {
    let edges = spec.effects.entry(LAW.into()).or_default();
    edges.entry(ROUNDING.into()).or_insert(USUAL_ROUNDING.0);
}

/// Half the overlap that a machine has, share of full command.
pub(crate) fn half_width(spec: &MachineSpec) -> Option<f64> {
    spec.effects.get(LAW).and_then(|edges| edges.get(HALF_WIDTH)).copied()
}

/// Command below which a valve with such an overlap surely passes nothing, share of full command.
pub(crate) fn open_within(half_width: f64) -> f64 {
    SURELY_CLOSED * half_width
}

/// What is known of the edges before a log tells of them, by parameter; `described` is the machine as its data describe it.
fn edges(described: &MachineSpec) -> Vec<(&'static str, Known)> {
    let of_sheet = |value: f64| {
        let sigma = (STATED.0 * value).hypot(STATED.1);
        (HALF_WIDTH, Known { value, sigma })
    };
    let (value, sigma) = USUAL_ROUNDING;
    half_width(described).map(of_sheet).into_iter().chain([(ROUNDING, Known { value, sigma })]).collect()
}

/// The same by key.
pub(crate) fn known(described: &MachineSpec) -> impl Iterator<Item = (String, Known)> {
    edges(described).into_iter().map(|(name, known)| (format!("{LAW}.{name}"), known))
}

/// What a log that nothing was fitted to leaves open of the edges, each by itself.
pub(crate) fn unmeasured(described: &MachineSpec) -> Vec<Direction> {
    if !described.effects.contains_key(LAW) {
        return Vec::new();
    }
    let direction = |(name, known): (&str, Known)| {
        let change = BTreeMap::from([(name.to_owned(), known.sigma)]);
        Direction { effects: BTreeMap::from([(LAW.to_owned(), change)]), ..Direction::default() }
    };
    edges(described).into_iter().map(direction).collect()
}

/// Takes out an overlap that nobody stated and that is none.
pub(crate) fn without_rounded_edges(spec: &mut MachineSpec) {
    if half_width(spec).is_some_and(|half_width| half_width < LEAST) {
        spec.effects.remove(LAW);
    }
}

/// The same machine with a valve that leaks to one side where it does not, and the other way round; and what that is, after "the valve".
pub(crate) fn leaking_otherwise(described: &MachineSpec, spec: &MachineSpec) -> (MachineSpec, &'static str) {
    let (times, words) = if described.effects.contains_key(LAW) {
        (1.0 / BALANCED, "leaks to one side, though it overlaps")
    } else {
        (BALANCED, "leaks alike to both sides, as an overlapped one does")
    };
    let mut otherwise = spec.clone();
    if let Some(resistance) = otherwise.plant.get_mut(ONE_SIDED) {
        *resistance *= times;
    }
    (otherwise, words)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::adoption::Adoption;
    use crate::test_recordings::{adopted, press};

    const DATA: &str = "overlap_percent = 9\n[controller]\ndead_band_compensation_percent = 7.5\n";

    /// The nominal press with a valve of the same rated flow that overlaps by 8 % with round edges, and a P controller that jumps over most
    /// of it.
    fn overlapped() -> MachineSpec {
        let mut spec = press();
        spec.effects
            .insert(LAW.into(), [("half_width".to_owned(), 0.08), ("rounding".to_owned(), 0.009)].into());
        spec.plant.valve_m3_per_s_sqrt_pa /= 0.92;
        spec.plant.valve_rod_resistance_pa_s_per_m3 *= BALANCED;
        (spec.controller.ki, spec.controller.dead_band_compensation) = (0.0, 0.075);
        spec
    }

    fn is_told_to_leak_otherwise(adoption: &Adoption) -> bool {
        adoption.remarks.iter().any(|remark| remark.contains("leaks to one side"))
    }

    /// A data sheet that is off by a hundredth is corrected by the holds.
    #[test]
    fn overlap_and_rounding_are_found() {
        let adoption = adopted(&overlapped(), DATA);
        let found = &adoption.spec.effects[LAW];
        assert!((found[HALF_WIDTH] - 0.08).abs() < 0.004, "{found:?}");
        assert!((found[ROUNDING] - 0.009).abs() < 0.003, "{found:?}");
        let [_, after] = &adoption.calibration.as_ref().unwrap().gaps;
        assert!(after["command"] < 0.005, "{after:?}");
        assert!(!is_told_to_leak_otherwise(&adoption), "{:?}", adoption.remarks);
    }

    /// The command walks within the overlap through a hold of seven seconds, led by an integral of next to nothing, and the data sheet is
    /// off by an eighth: a fit that follows the walk ends at an overlap of 0.129.
    #[test]
    fn an_overlap_is_found_in_which_an_integral_walks() {
        let mut truth = overlapped();
        truth.effects.get_mut(LAW).unwrap().insert(HALF_WIDTH.into(), 0.12);
        truth.effects.insert("valve_bias".into(), [("offset".to_owned(), -0.0067)].into());
        truth.plant.viscous_friction_n_s_per_m *= 3.0;
        let controller = &mut truth.controller;
        (controller.kp, controller.ki, controller.dead_band_compensation) = (15.8, 42.4, 0.108);
        let moves = &mut truth.cycle.moves;
        moves.remove(1);
        (moves[0].to_s, moves[1].from_s, moves[1].to_s) = (1.5, 1.6, 2.6);
        let data = "overlap_percent = 13.5\n[controller]\ndead_band_compensation_percent = 10.8\n";
        let adoption = adopted(&truth, data);
        let found = &adoption.spec.effects[LAW];
        assert!((found[HALF_WIDTH] - 0.12).abs() < 0.003, "{found:?}");
        let [_, after] = &adoption.calibration.as_ref().unwrap().gaps;
        assert!(after["command"] < 0.005, "{after:?}");
    }

    /// The article's valve with an overlap: its loop works against a leak of one side in every hold.
    #[test]
    fn a_leak_to_one_side_is_told() {
        let mut truth = overlapped();
        truth.plant.valve_rod_resistance_pa_s_per_m3 /= BALANCED;
        let adoption = adopted(&truth, DATA);
        assert!(is_told_to_leak_otherwise(&adoption), "{:?}", adoption.remarks);
        let one_sided = adoption.spec.plant.valve_rod_resistance_pa_s_per_m3;
        assert!(one_sided < 2.0 * truth.plant.valve_rod_resistance_pa_s_per_m3, "{one_sided}");
    }
}

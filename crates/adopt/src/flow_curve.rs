//! The valve's flow curve: as its data sheet says, or the one under which the machine moves as the log has it.
//!
//! A leak is read off the command that a hold needs, and there the slope at the null counts: a curve of double gain has half or a third of
//! the line's. Strokes show the curve where the log has the position, since they go through every opening; a command by itself does not.

use std::collections::BTreeMap;

use seepd_gap::Known;
use seepd_sim::{MachineSpec, effects};

use crate::machine_data::{FlowCurve, ValveData};

/// The law of the plant.
pub(crate) const LAW: &str = "valve_curve";
const SLOPE: &str = "null_slope";
const KNEE: &str = "knee";
const CURVATURE: &str = "curvature";

/// Where a data sheet gives no number: the slope at the null of a progressive curve, and knee and flow there of a double gain.
const USUAL_SLOPE: f64 = 0.75;
const USUAL_KNEE: (f64, f64) = (0.4, 0.2);

/// A curve that is fitted to a log: the values at which the fit begins, and which of them are free, each with a standard deviation of what
/// valves have.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Candidate {
    start: [(&'static str, f64); 3],
    free: &'static [(&'static str, f64)],
}

/// What else than a line a valve may have.
pub(crate) const CANDIDATES: [Candidate; 2] = [
    Candidate { start: [(SLOPE, USUAL_SLOPE), (KNEE, 0.0), (CURVATURE, 1.0)], free: &[(SLOPE, 0.2)] },
    Candidate {
        start: [(SLOPE, USUAL_KNEE.1 / USUAL_KNEE.0), (KNEE, USUAL_KNEE.0), (CURVATURE, 0.0)],
        free: &[(SLOPE, 0.2), (KNEE, 0.1)],
    },
];

impl Candidate {
    /// The law's values at which a fit begins.
    pub(crate) fn start(&self) -> BTreeMap<String, f64> {
        self.start.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect()
    }
}

/// What a fit may change of a machine's curve, by key, and what is known of it beforehand; nothing of a line.
pub(crate) fn free(spec: &MachineSpec) -> BTreeMap<String, Known> {
    let Some(law) = spec.effects.get(LAW) else { return BTreeMap::new() };
    let is_double = law.get(KNEE).is_some_and(|knee| *knee > 0.0);
    let free = CANDIDATES[usize::from(is_double)].free;
    let of = |(name, sigma): &(&str, f64)| {
        Some((format!("{LAW}.{name}"), Known { value: *law.get(*name)?, sigma: *sigma }))
    };
    free.iter().filter_map(of).collect()
}

/// The curve in a few words.
pub(crate) fn words(law: &BTreeMap<String, f64>) -> String {
    let value = |name| law.get(name).copied().unwrap_or(0.0);
    let (slope, knee) = (100.0 * value(SLOPE), value(KNEE));
    if knee > 0.0 {
        format!(
            "{:.0} % of the flow at {:.0} % of the command, where a second gain begins",
            slope * knee,
            100.0 * knee
        )
    } else {
        format!("at the null {slope:.0} % of a line's slope, and more the further it opens")
    }
}

/// What the flow at a curve's knee may be, %: a slope at the null that the plant's law has.
pub(crate) fn possible_flow_percent(valve: &ValveData) -> Option<[f64; 2]> {
    let law = effects::OF_DATA_SHEETS.iter().find(|law| law.key() == LAW)?;
    let (flattest, steepest) = law.parameters().iter().find(|parameter| parameter.name == SLOPE)?.range;
    let slopes = [flattest, steepest];
    match valve.curve? {
        FlowCurve::Linear => None,
        FlowCurve::Progressive => Some(slopes.map(|slope| 25.0 * (slope + 1.0))),
        FlowCurve::DoubleGain => Some(slopes.map(|slope| slope * knee_of(valve) * 100.0)),
    }
}

fn knee_of(valve: &ValveData) -> f64 {
    valve.knee_percent.map_or(USUAL_KNEE.0, |percent| percent / 100.0)
}

/// The curve of a data sheet: none where it says nothing, an empty one where it says that the curve is a line.
pub(crate) fn stated(valve: &ValveData) -> Option<BTreeMap<String, f64>> {
    let flow = valve.flow_at_knee_percent.map(|percent| percent / 100.0);
    let (slope, knee, curvature) = match valve.curve? {
        FlowCurve::Linear => return Some(BTreeMap::new()),
        // Half of the command gives s/2 + (1 − s)/4 of the flow.
        FlowCurve::Progressive => (flow.map_or(USUAL_SLOPE, |flow| 4.0 * flow - 1.0), 0.0, 1.0),
        FlowCurve::DoubleGain => {
            let knee = knee_of(valve);
            (flow.unwrap_or(USUAL_KNEE.1 / USUAL_KNEE.0 * knee) / knee, knee, 0.0)
        }
    };
    Some([(SLOPE, slope), (KNEE, knee), (CURVATURE, curvature)].map(|(k, v)| (k.to_owned(), v)).into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::machine_data::MachineData;
    use crate::test_recordings::{adopted, press};

    const DATA: &str = "overlap_percent = 0\n";

    /// Half of a line's slope up to 40 % of the command: what the strokes show, a hold's leak is read by.
    #[test]
    fn a_valve_of_double_gain_is_told_from_a_line_by_its_strokes() {
        let mut truth = press();
        for law in ["null_slope=0.5", "knee=0.4"] {
            truth.set_effect(&format!("{LAW}.{law}")).unwrap();
        }
        let adoption = adopted(&truth, DATA);
        let found = adoption.spec.effects.get(LAW).unwrap();
        assert!((found[SLOPE] - 0.5).abs() < 0.05 && (found[KNEE] - 0.4).abs() < 0.05, "{found:?}");
        assert!(
            adoption.remarks.iter().any(|remark| remark.contains("is no line")),
            "{:?}",
            adoption.remarks
        );
        assert!(!adopted(&press(), DATA).spec.effects.contains_key(LAW));
        // A data sheet that says it is a line is believed.
        let said = format!("{DATA}curve = \"linear\"\n");
        assert!(!adopted(&truth, &said).spec.effects.contains_key(LAW));
    }

    #[test]
    fn data_sheets_say_a_curve_in_their_own_terms() {
        let law = |text: &str| {
            let data = MachineData::from_toml(&format!("[valve]\n{text}\n")).unwrap();
            stated(&data.valve).map(|law| [SLOPE, KNEE, CURVATURE].map(|name| law.get(name).copied()))
        };
        assert_eq!(law(""), None);
        assert_eq!(law("curve = \"linear\""), Some([None; 3]));
        let double = "curve = \"double_gain\"\nknee_percent = 50\nflow_at_knee_percent = 20";
        assert_eq!(law(double), Some([Some(0.4), Some(0.5), Some(0.0)]));
        // A line of 0.6 and a parabola of 0.4 pass 0.3 + 0.1 at half of the command.
        let progressive = law("curve = \"progressive\"\nflow_at_knee_percent = 40").unwrap();
        assert!((progressive[0].unwrap() - 0.6).abs() < 1e-12 && progressive[2] == Some(1.0));

        let refused = |text: &str| {
            let data = MachineData::from_toml(&format!("[valve]\n{text}\n")).unwrap();
            crate::plant::describe(&data, &crate::plant::LoggedSize::default()).unwrap_err().to_string()
        };
        let flat = refused("curve = \"double_gain\"\nknee_percent = 50\nflow_at_knee_percent = 5");
        assert!(flat.contains("`valve.flow_at_knee_percent` is 5; it must lie in 10 … 65"), "{flat}");
        assert!(refused("curve = \"double_gain\"\nknee_percent = 90").contains("valve.knee_percent"));
    }
}

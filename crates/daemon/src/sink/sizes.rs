//! The numbers of a leak by the names and in the units that all of the plant's languages share.

use seepd_monitor::event::Flag;

use crate::hub::AxisStatus;

/// One of the leak's numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Size {
    pub(super) name: &'static str,
    pub(super) unit: &'static str,
    /// Nothing where it is not known.
    pub(super) value: Option<f64>,
}

/// What an axis's leak is in numbers; without an estimate none of them is known.
pub(super) fn sizes(axis: &AxisStatus) -> [Size; 6] {
    let is_known = axis.flag != Flag::NoEstimate;
    let size = |name, unit, value: Option<f64>| {
        let value = value.filter(|value| is_known && value.is_finite());
        Size { name, unit, value }
    };
    [
        size("leak_flow_lpm", "L/min", axis.leak_flow_lpm),
        size("leak_area_m2", "m2", axis.leak_area_m2),
        size("leak_area_low_m2", "m2", axis.interval90_m2.map(|interval| interval[0])),
        size("leak_area_high_m2", "m2", axis.interval90_m2.map(|interval| interval[1])),
        size("leak_power_w", "W", axis.loss.map(|loss| loss.leak_power_w)),
        size("time_to_leak_s", "s", axis.time_to_leak_s),
    ]
}

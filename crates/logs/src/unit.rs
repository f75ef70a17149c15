//! Units that descriptions of signals name, and what makes them SI.

use seepd_signals::Signal;

/// Units of each kind of signal, in lower case, with their factor to SI.
const SHARES: &[(&str, f64)] = &[("1", 1.0), ("%", 0.01), ("percent", 0.01), ("pct", 0.01), ("‰", 1e-3)];
const LENGTHS: &[(&str, f64)] = &[
    ("m", 1.0),
    ("mm", 1e-3),
    ("cm", 1e-2),
    ("um", 1e-6),
    ("µm", 1e-6),
    ("μm", 1e-6),
    ("in", 0.0254),
    ("inch", 0.0254),
];
const PRESSURES: &[(&str, f64)] = &[
    ("pa", 1.0),
    ("hpa", 100.0),
    ("mbar", 100.0),
    ("kpa", 1e3),
    ("bar", 1e5),
    ("mpa", 1e6),
    ("psi", 6_894.757_293_168),
];
const FORCES: &[(&str, f64)] =
    &[("n", 1.0), ("dan", 10.0), ("kn", 1e3), ("mn", 1e6), ("lbf", 4.448_221_615_260_5), ("kgf", 9.806_65)];

fn units_of(signal: Signal) -> &'static [(&'static str, f64)] {
    match signal {
        Signal::Command => SHARES,
        Signal::Demand | Signal::Position => LENGTHS,
        Signal::PSupply | Signal::PInlet | Signal::PCap | Signal::PRod => PRESSURES,
        Signal::Load => FORCES,
        Signal::CycleStart => &[("1", 1.0)],
    }
}

/// The factor that makes a unit of a signal SI; `None` for a unit that it cannot have.
pub(crate) fn factor(signal: Signal, unit: &str) -> Option<f64> {
    let unit = unit.trim().to_lowercase();
    units_of(signal).iter().find(|(known, _)| *known == unit).map(|(_, factor)| *factor)
}

/// The units that a signal can have, for messages.
pub(crate) fn listed(signal: Signal) -> String {
    units_of(signal).iter().map(|(unit, _)| *unit).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_of_their_signals() {
        assert_eq!(factor(Signal::Command, "%"), Some(0.01));
        assert_eq!(factor(Signal::PCap, " Bar "), Some(1e5));
        assert_eq!(factor(Signal::Position, "bar"), None);
        // The prefixes of force are told from those of length by the signal.
        assert_eq!((factor(Signal::Load, "MN"), factor(Signal::Position, "mm")), (Some(1e6), Some(1e-3)));
    }
}

//! Flags in pages: their colours, and their course over time.

use seepd_monitor::event::Flag;

use super::chart::{Axis, Chart, Layer, Scale};

/// CSS colour of a flag.
pub(crate) fn colour(flag: Flag) -> &'static str {
    match flag {
        Flag::NoEstimate => "var(--no_estimate)",
        Flag::Healthy => "var(--healthy)",
        Flag::Watch => "var(--watch)",
        Flag::Leak => "var(--leak)",
        Flag::Severe => "var(--severe)",
    }
}

/// The course of the flags from (place on the axis, flag from there on), as coloured stretches under a line of steps.
pub(crate) fn chart(x: Axis, changes: &[(f64, Flag)]) -> Chart {
    let level = |flag: Flag| flag as u8 as f64;
    let mut steps = Vec::new();
    let mut layers = Vec::new();
    let ends = changes.iter().skip(1).map(|change| change.0).chain([x.to]);
    for ((from, flag), to) in changes.iter().zip(ends) {
        steps.extend([(*from, level(*flag)), (to, level(*flag))]);
        layers.push(Layer::Stretch {
            from: *from,
            to,
            colour: colour(*flag).into(),
            name: flag.name().into(),
        });
    }
    layers.push(Layer::Line { class: "stroke-a", points: steps });
    let named = [Flag::NoEstimate, Flag::Healthy, Flag::Watch, Flag::Leak, Flag::Severe];
    layers.extend(named.map(|flag| Layer::Limit {
        at: level(flag),
        name: flag.name().replace('_', " "),
        colour: colour(flag),
    }));
    let y = Axis { scale: Scale::Named, ..Axis::linear("flag", -0.6, 4.6) };
    Chart { layers, ..Chart::new("Flag over time", x, y) }
}

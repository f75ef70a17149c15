//! A valve that overlaps beyond the plan's, where nobody knows whether it does.

use seepd_sim::MachineSpec;
use seepd_sim::noise::Noise;
use seepd_sim::series;

/// Gives a share of the machines more overlap, up to a widest half width, share of full command; says how much this one has.
pub(crate) fn put_on(spec: &mut MachineSpec, (share, widest): (f64, f64), noise: &mut Noise) -> f64 {
    // Where none overlaps, nothing is drawn: the machines are those that they would be without the question.
    if share <= 0.0 || noise.uniform(0.0, 1.0) >= share {
        return 0.0;
    }
    let half_width = noise.uniform(0.0, widest);
    *spec = series::with_more_deadband(spec, half_width);
    half_width
}

//! Machines with a cause planted, for whoever checks what a model names: machines, days and sizes of their own, under the laws of training.

use seepd_model::causes::{Cause, Kind};
use seepd_sim::MachineSpec;
use seepd_sim::noise::Noise;
use seepd_sim::series;

use super::{basis, curves};
use crate::dataset::{Observation, Spread};
use crate::relative::Conditions;

/// Part of a cause's range of sizes that is planted, on its logarithm: below it is hardly seen, above it nobody asks.
const PLANTED: (f64, f64) = (0.35, 0.85);
/// Oil of the days, °C: what is ordinary.
const OIL_C: (f64, f64) = (30.0, 60.0);
/// Healthy machines for each machine with a given cause.
const HEALTHY_SHARE: usize = 3;
/// What tells these machines' random streams from those of training.
const SEED: u64 = 0x706c_616e_7465_6463;

/// A machine before and after a change.
#[derive(Debug, Clone)]
pub struct PlantedCause {
    /// What changes, in what unit; `None` on a machine that stays as it is.
    pub kind: Option<Kind>,
    /// Its size.
    pub size: f64,
    /// The machine on the day of its baseline.
    pub healthy: Observation,
    /// The machine with the cause, on another day.
    pub changed: Observation,
}

/// Draws `each` machines of the series for each cause, and three times as many that stay as they are.
pub fn plant_causes(spec: &MachineSpec, spread: &Spread, each: usize, seed: u64) -> Vec<PlantedCause> {
    let all = curves::all(spec, false);
    let causes = Cause::ALL.into_iter().map(Some).flat_map(|cause| std::iter::repeat_n(cause, each));
    let none = std::iter::repeat_n(None, HEALTHY_SHARE * each);
    causes
        .chain(none)
        .enumerate()
        .map(|(index, cause)| {
            let mut noise = Noise::new(seed ^ SEED, index as u64);
            let (healthy, changed) = two_days(spec, spread, index as u64, &mut noise);
            let laws: Vec<_> = all.iter().filter(|curve| Some(curve.kind.cause) == cause).collect();
            // The laws of a cause in turn: few machines cover them evenly.
            let Some(curve) = laws.get(index % laws.len().max(1)) else {
                return PlantedCause { kind: None, size: 0.0, healthy, changed };
            };
            let rank = noise.uniform(PLANTED.0, PLANTED.1);
            let (size, changed) = curve.applied(&changed, curve.whole_range(), rank, &mut noise);
            PlantedCause { kind: Some(curve.kind), size, healthy, changed }
        })
        .collect()
}

/// A machine of the series on two days within what is ordinary of oil, load and supply.
fn two_days(
    spec: &MachineSpec,
    spread: &Spread,
    stream: u64,
    noise: &mut Noise,
) -> (Observation, Observation) {
    let machine = Observation {
        spec: series::vary(spec, &spread.parameters, noise),
        load_factor: noise.factor(spread.load),
        stretch: 1.0,
        leak_area_m2: 0.0,
        laminar_share: 0.0,
        null_deviation: 0.0,
        extra_deadband: 0.0,
        stream,
    };
    let mut on_a_day = || {
        let (load, supply) = (noise.factor(basis::ORDINARY_LOAD), noise.factor(basis::ORDINARY_SUPPLY));
        Conditions::on_a_day(&machine, load, noise.uniform(OIL_C.0, OIL_C.1), supply)
    };
    (on_a_day(), on_a_day())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_cause_is_planted_as_often_within_its_range_and_the_same_seed_gives_the_same() {
        let spec = MachineSpec::default();
        let draw = |seed| plant_causes(&spec, &Spread::default(), 2, seed);
        let planted = draw(3);
        for cause in Cause::ALL {
            let of: Vec<_> =
                planted.iter().filter(|one| one.kind.is_some_and(|kind| kind.cause == cause)).collect();
            assert_eq!(of.len(), 2, "{cause:?}");
            let differs = |one: &&PlantedCause| {
                one.changed.spec.effects != one.healthy.spec.effects
                    || one.changed.leak_area_m2 > 0.0
                    || matches!(cause, Cause::Load | Cause::Supply)
            };
            assert!(of.iter().all(differs) && of.iter().all(|one| one.size != 0.0), "{cause:?}: {of:?}");
        }
        let healthy = planted.iter().filter(|one| one.kind.is_none());
        assert_eq!(healthy.filter(|one| one.changed.spec.effects.is_empty()).count(), 6);
        let sizes =
            |planted: &[PlantedCause]| planted.iter().map(|one| one.size.to_bits()).collect::<Vec<_>>();
        assert_eq!(sizes(&planted), sizes(&draw(3)));
        assert_ne!(sizes(&planted), sizes(&draw(4)));
    }
}

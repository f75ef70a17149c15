use std::sync::LazyLock;

use seepd_features::Projections;
use seepd_model::causes::SizeUnit;
use seepd_model::{Model, ModelFile};

use super::*;

/// The shipped model, whose duty cycle is read.
static MODEL: LazyLock<Model> = LazyLock::new(|| {
    let file: ModelFile =
        serde_json::from_slice(include_bytes!("../../../daemon/assets/model.json")).unwrap();
    Model::from_file(ModelFile { causes: None, ..file }).unwrap()
});

fn with_simulator(test: impl FnOnce(&CauseSimulator<'_>)) {
    with_settings(&TrainingSettings::default(), test);
}

fn with_settings(settings: &TrainingSettings, test: impl FnOnce(&CauseSimulator<'_>)) {
    let phases = MODEL.file().cycle.phase_list();
    let reading = Reading {
        cycle: &MODEL.file().cycle,
        phases: &phases,
        sample_rate_hz: MODEL.file().sample_rate_hz,
        projections: Projections::NONE,
    };
    let spec = MachineSpec::default();
    test(&CauseSimulator { spec: &spec, settings, reading: &reading });
}

/// The spool is where it was only if the command is off by as much the other way, in every sample and on every machine.
#[test]
fn analytic_null_shift_moves_every_mean_by_itself_and_no_rise() {
    with_simulator(|simulator| {
        let curves: Vec<Curve> = curves::all(simulator.spec, false)
            .into_iter()
            .filter(|curve| curve.kind.cause == Cause::ValveNull)
            .collect();
        let responses =
            simulator.responses(&curves, (2, 77, 3), &mut Portions::default(), &mut |_| ()).unwrap();
        assert_eq!(responses.len(), 3);
        for response in responses.iter().flat_map(|(_, responses)| responses) {
            let (means, rises) = response.numbers.split_at(response.numbers.len() / 2);
            // What is left of the warm-up's beginning, and the reader's single precision.
            let bound = 1e-3 * response.size.abs() + 1e-6;
            assert!(means.iter().all(|mean| (mean + response.size).abs() < bound), "{response:?}");
            assert!(rises.iter().all(|rise| rise.abs() < bound), "{response:?}");
        }
    });
}

/// Ranges of a curve follow on each other, those of leaks overlap, and sizes lie within theirs.
#[test]
fn curves_cover_their_sizes() {
    with_simulator(|simulator| {
        let curves = curves::all(simulator.spec, true);
        let cells: usize = curves.iter().map(|curve| curve.ranges().count()).sum();
        // An orifice's twice: the seal may leak less as well.
        assert!(cells + 10 <= seepd_model::causes::MAX_CELLS, "{cells}");
        let healthy = simulator.machine(78, 0, HoldForce::AsDrawn);
        let mut noise = Noise::new(1, 1);
        for curve in &curves {
            let is_seal = curve.kind.cause == Cause::PistonSeal;
            let mut end = None;
            for range in curve.ranges() {
                let follows = |end: f64| {
                    if is_seal { range[0] < end && end < range[1] } else { range[0] == end }
                };
                assert!(end.is_none_or(follows) && range[1] / range[0] > 1.0, "{:?}", curve.kind);
                end = Some(range[1]);
                let (size, _) = curve.applied(&healthy, range, 0.5, &mut noise);
                assert!((size / range[0] - (range[1] / range[0]).sqrt()).abs() < 1e-9, "{:?}", curve.kind);
            }
            let is_relative = curve.kind.unit == SizeUnit::Share;
            assert!(!is_relative || end.is_some_and(|end| end.abs() <= 3.0), "{:?}", curve.kind);
        }
    });
}

/// Leaks of an orifice and of another law, each along a direction of its own: the other law's cells are marked, fitted to a log or not.
#[test]
fn another_law_of_a_leak_is_marked() {
    let n = 2 * MODEL.file().cycle.phase_list().len();
    let identity: Vec<f64> = (0..n * n).map(|at| f64::from(u8::from(at % (n + 1) == 0))).collect();
    let basis = Basis { rows: identity.clone(), inverse: identity, ordinary: vec![0.0; n] };
    let response = |law: usize, machine: usize| {
        let size = 1e-7 * (2 + machine) as f64;
        let numbers = (0..n).map(|number| if number == law { 1e5 * size } else { 0.0 }).collect();
        Response { size, numbers }
    };
    let told = |settings: TrainingSettings| -> Vec<bool> {
        let mut marked = Vec::new();
        with_settings(&settings, |simulator| {
            let mut seals = curves::all(simulator.spec, false);
            seals.retain(|curve| curve.kind.cause == Cause::PistonSeal && curve.force == HoldForce::AsDrawn);
            assert_eq!(seals.iter().map(|curve| curve.other_law).collect::<Vec<_>>(), [false, true]);
            let of_each = || (0..2).map(|law| (law, (0..4).map(|machine| response(law, machine)).collect()));
            let responses = Responses { learned: of_each().collect(), held_out: of_each().collect() };
            let file = learn_from(simulator, &seals, &basis, &responses).unwrap();
            marked = file.cells.iter().filter(|cell| cell.size > 0.0).map(|cell| cell.other_law).collect();
        });
        marked
    };
    let conditions = Conditions { unknown_seal: true, response_error: 0.05, ..Conditions::default() };
    let unfitted = TrainingSettings { cause_machines: 4, conditions, ..TrainingSettings::default() };
    assert_eq!(told(unfitted.clone()), [false, true]);
    assert_eq!(told(TrainingSettings { fitted: true, ..unfitted }), [false, true]);
    assert_eq!(told(TrainingSettings { cause_machines: 4, ..TrainingSettings::default() }), [false, true]);
}

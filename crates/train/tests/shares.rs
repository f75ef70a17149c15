//! A training whose machines are simulated elsewhere gives the same model, to the byte.
#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use seepd_sim::MachineSpec;
use seepd_train::train::Stage;
use seepd_train::{Portions, Share, TrainingSettings, simulate_share, train_with};

#[test]
fn shares_give_the_bytes_of_one_machine() {
    compare(0);
}

#[test]
#[ignore = "some minutes: causes are most of what is simulated"]
fn shares_with_causes_give_the_bytes_of_one_machine() {
    compare(2);
}

fn compare(cause_machines: usize) {
    let spec = MachineSpec::default();
    let settings = TrainingSettings {
        observations: 300,
        held_out: 32,
        trials: 1,
        relative_machines: 40,
        cause_machines,
        calibrated_on: 32,
        tested_on: 16,
        ..TrainingSettings::default()
    };
    let train = |portions: Portions| train_with(&spec, &settings, portions, &mut |_, _, _| ()).unwrap().json;
    let alone = train(Portions::default());

    // The second of three shares is lost: what it had is simulated where the model is trained.
    let mut portions = Portions::default();
    for number in [3, 1] {
        let share = Share::new(number, 3).unwrap();
        let mut stages = Vec::new();
        let share = simulate_share(&spec, &settings, share, &mut |stage, _, _| stages.push(stage)).unwrap();
        assert!(stages.contains(&Stage::Compare) && share.len() > 10_000);
        portions.add(&spec, &settings, &share).unwrap();
    }
    assert!(train(portions) == alone);
}

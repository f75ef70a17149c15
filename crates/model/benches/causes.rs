//! Cost of an explanation, once a cycle: of a healthy machine, and of a leak beside a shifted null. By the embedded model, with laws' errors as an
//! adopted machine's model has them, and of one of whose phases the first scatters.

use divan::{Bencher, black_box};
use seepd_model::causes::{Causes, Change, MAX_NUMBERS};
use seepd_model::{Model, ModelFile};

const NOISE: f64 = 1e-3;
/// Standard deviation of the first phase's mean from cycle to cycle, share of full command; the others' is the noise's.
const SCATTER: f64 = 5e-3;

fn main() {
    divan::main();
}

fn file() -> ModelFile {
    serde_json::from_slice(include_bytes!("../../daemon/assets/model.json")).expect("the embedded model")
}

fn with_even_errors() -> Causes {
    let mut causes = file().causes.expect("it names causes");
    (causes.errors_are_even, causes.golden) = (true, Vec::new());
    Causes::from_file(causes).expect("a file that is in order")
}

fn explain(bencher: Bencher<'_, '_>, causes: &Causes, null: f64) {
    let mut numbers = [0.0; MAX_NUMBERS];
    // Eight phases: what 0.1 L/min does to the means, less the shift.
    let leak = [-4.3e-4, -2.6e-4, -4.3e-4, 2.1e-4, 2.5e-4, -6.1e-4, -5.4e-4, -4.0e-4];
    for (slot, leak) in numbers.iter_mut().zip(leak) {
        *slot = if null > 0.0 { leak - null } else { 0.0 };
    }
    let numbers = &numbers[..causes.numbers()];
    bencher.bench_local(|| causes.explain(&Change { numbers: black_box(numbers), noise: NOISE }));
}

#[divan::bench(args = [0.0, 0.005])]
fn explanation(bencher: Bencher<'_, '_>, null: f64) {
    let model = Model::from_file(file()).expect("the embedded model");
    explain(bencher, model.causes().expect("it names causes"), null);
}

#[divan::bench(args = [0.0, 0.005])]
fn explanation_with_even_errors(bencher: Bencher<'_, '_>, null: f64) {
    explain(bencher, &with_even_errors(), null);
}

#[divan::bench(args = [0.0, 0.005])]
fn explanation_of_a_machine(bencher: Bencher<'_, '_>, null: f64) {
    explain(bencher, &of_a_machine(&with_even_errors()), null);
}

/// Once a baseline.
#[divan::bench]
fn coordinates_of_a_machine(bencher: Bencher<'_, '_>) {
    let causes = with_even_errors();
    bencher.bench_local(|| of_a_machine(black_box(&causes)));
}

fn of_a_machine(causes: &Causes) -> Causes {
    let mut deviations = vec![0.0; causes.numbers()];
    deviations[0] = SCATTER;
    causes.of_machine(NOISE, &deviations).expect("a phase that scatters")
}

//! Cost of an explanation by the embedded model, once a cycle: of a healthy machine, and of a leak beside a shifted null.

use seepd_model::Model;
use seepd_model::causes::{Change, MAX_NUMBERS};

fn main() {
    divan::main();
}

#[divan::bench(args = [0.0, 0.005])]
fn explanation(bencher: divan::Bencher<'_, '_>, null: f64) {
    let model =
        Model::from_json(include_bytes!("../../daemon/assets/model.json")).expect("the embedded model");
    let causes = model.causes().expect("it names causes");
    let mut numbers = [0.0; MAX_NUMBERS];
    // Eight phases: what 0.1 L/min does to the means, less the shift.
    let leak = [-4.3e-4, -2.6e-4, -4.3e-4, 2.1e-4, 2.5e-4, -6.1e-4, -5.4e-4, -4.0e-4];
    for (slot, leak) in numbers.iter_mut().zip(leak) {
        *slot = if null > 0.0 { leak - null } else { 0.0 };
    }
    let numbers = &numbers[..causes.numbers()];
    bencher.bench_local(|| causes.explain(&Change { numbers: divan::black_box(numbers), noise: 1e-3 }));
}

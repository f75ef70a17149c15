//! Cost of a prediction: 100 trees of 250 nodes over distinct rows.

use divan::counter::ItemsCount;
use seepd_model::ensemble::Ensemble;
use seepd_model::schema::Tree;

fn main() {
    divan::main();
}

const FEATURES: usize = 20;

/// A balanced tree of that many leaves with thresholds of a fixed sequence in 0 … 1.
fn grow(tree: &mut Tree, leaves: usize, noise: &mut u64) {
    *noise = noise.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    let uniform = (*noise >> 11) as f64 / (1u64 << 53) as f64;
    let index = tree.feature.len();
    if leaves == 1 {
        tree.feature.push(-1);
        tree.value.push(uniform);
        tree.right.push(0);
        return;
    }
    tree.feature.push((*noise >> 33) as i32 % FEATURES as i32);
    tree.value.push(0.2 + 0.6 * uniform);
    tree.right.push(0);
    grow(tree, leaves / 2, noise);
    tree.right[index] = tree.feature.len() as u32;
    grow(tree, leaves - leaves / 2, noise);
}

#[divan::bench(sample_count = 20)]
fn hundred_trees_25000_nodes(bencher: divan::Bencher<'_, '_>) {
    let mut noise = 1;
    let trees: Vec<Tree> = (0..100)
        .map(|_| {
            let mut tree = Tree { feature: vec![], value: vec![], right: vec![] };
            grow(&mut tree, 125, &mut noise);
            tree
        })
        .collect();
    let ensemble = Ensemble::new(&trees, FEATURES).expect("trees in preorder");
    let rows: Vec<[f64; FEATURES]> = (0..4096)
        .map(|_| {
            std::array::from_fn(|_| {
                noise = noise.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (noise >> 11) as f64 / (1u64 << 53) as f64
            })
        })
        .collect();
    bencher.counter(ItemsCount::new(rows.len())).bench_local(|| {
        for row in &rows {
            divan::black_box(ensemble.vote(row));
        }
    });
}

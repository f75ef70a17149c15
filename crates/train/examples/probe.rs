//! Trains and prints what was measured.
fn main() {
    let start = std::time::Instant::now();
    let n: usize = std::env::args().nth(1).and_then(|a| a.parse().ok()).unwrap_or(4096);
    let trials: usize = std::env::args().nth(2).and_then(|a| a.parse().ok()).unwrap_or(24);
    let p: f64 = std::env::args().nth(3).and_then(|a| a.parse().ok()).unwrap_or(0.0);
    let settings = seepd_train::Settings {
        observations: n,
        trials,
        spread: seepd_train::Spread { period: p, ..Default::default() },
        ..Default::default()
    };
    let mut last = None;
    let trained = seepd_train::train(&Default::default(), &settings, &mut |stage, a, b| {
        if last != Some(stage) || a == b {
            eprintln!("{stage:?} {a}/{b} {:?}", start.elapsed());
            last = Some(stage);
        }
    })
    .unwrap();
    eprintln!(
        "{:?} {} bytes, {} nodes {:?}",
        trained.found,
        trained.json.len(),
        trained.model.ensemble().nodes(),
        start.elapsed()
    );
    for a in &trained.report.by_noise {
        eprintln!("{a:#?}");
        if a.noise == 0.001 {
            continue;
        }
    }
    for a in &trained.report.noise_table {
        eprintln!("{a:?}");
    }
    eprintln!("{:?}", trained.model.feature_names());
    let c = &trained.model.file().cycle;
    for a in &c.anchors {
        eprintln!("{} {} {}", a.end_s, a.least_correlation, a.least_deviation);
    }
    std::fs::write("/tmp/model.json", &trained.json).unwrap();
}

//! A baseline, of an axis with a model and of one without: an error, or one that cycles can be compared with.
//! Parser: crates/monitor/src/baseline/mod.rs:parse,check_axis,newest,to_json,relative_of,phase_names,check crates/monitor/src/relative/mod.rs:parse,check_axis,to_json,check crates/monitor/src/relative/shape.rs:open
#![no_main]
use std::sync::LazyLock;

use seepd_model::{Comparison, Model};
use seepd_monitor::baseline::BaselineFile;
use seepd_monitor::relative::RelativeBaseline;

static MODEL: LazyLock<Model> =
    LazyLock::new(|| Model::from_json(seepd::EMBEDDED_MODEL).expect("the program's own"));

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let text = String::from_utf8_lossy(data);
    if let Ok(file) = BaselineFile::parse(&text, &MODEL)
        && let (Some(baseline), Some(relative)) = (file.newest(), MODEL.relative())
    {
        let present = [0.1; 8];
        let given = relative.estimate(&Comparison {
            baseline: &baseline.mean,
            present: &present,
            load_change: None,
            noise: 0.001,
        });
        assert!(!(given.estimate.value < 0.0));
        let _ = (file.check_axis("press"), file.to_json());
    }
    if let Ok(file) = RelativeBaseline::parse(&text) {
        let _ = (file.check_axis("press"), file.to_json());
    }
});

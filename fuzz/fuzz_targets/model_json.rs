//! A model file: an error, or a model that evaluates.
//! Parser: crates/model/src/check.rs crates/model/src/schema.rs crates/model/src/error.rs crates/model/src/model.rs:from_json,from_file,check_golden,agree crates/model/src/ensemble.rs:new,from_checked crates/model/src/relative.rs:from_file,from_checked,check_golden crates/model/src/causes/mod.rs:from_file,from_checked,check_golden,priors,check_causes
#![no_main]
libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    if let Ok(model) = seepd_model::Model::from_json(data) {
        let estimate = model.estimate(&vec![0.5; model.feature_names().len()]);
        assert!(!(estimate.value < 0.0));
        if let Some(relative) = model.relative() {
            let (baseline, present) = (vec![0.1; relative.phases()], vec![0.2; relative.phases()]);
            for load_change in [None, Some(0.1)] {
                let _ = relative.estimate(&seepd_model::Comparison { baseline: &baseline, present: &present, load_change, noise: 0.001 });
            }
        }
    }
});

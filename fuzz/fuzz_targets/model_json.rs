//! A model file: an error, or a model that evaluates.
#![no_main]
libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    if let Ok(model) = seepd_model::Model::from_json(data) {
        let estimate = model.estimate(&vec![0.5; model.feature_names().len()]);
        assert!(!(estimate.value < 0.0));
    }
});

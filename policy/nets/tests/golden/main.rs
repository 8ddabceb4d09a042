//! Networks against numbers of the reference implementations, with weights and inputs regenerated
//! from a seed.
//!
//! The file is `tests/golden/policies.json` of the repository, or the one that `TROCAR_GOLDEN`
//! names. A case says by its own fields what it is; one that says nothing known is a failure.

#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test fails by panicking, its helpers too"
)]
#![expect(clippy::print_stdout, reason = "the margins are worth reading")]

mod act;
mod compare;
mod dp3;
mod ensemble;
mod regenerate;

use std::path::Path;

use serde_json::Value;

/// The golden file's seed and cases, and where it lies.
fn golden() -> (u64, Value, String) {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"))
        .ancestors()
        .nth(2)
        .unwrap();
    let named = std::env::var_os("TROCAR_GOLDEN").filter(|name| !name.is_empty());
    // A path that is not absolute starts at the repository, not at this crate, where cargo runs the
    // test.
    let path = root.join(named.unwrap_or_else(|| "tests/golden/policies.json".into()));
    let name = path.display().to_string();
    let text = std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{name}: {error}"));
    let golden: Value = serde_json::from_str(&text).unwrap();
    let seed = golden["seed"].as_u64().unwrap();
    (seed, golden["cases"].clone(), name)
}

/// What a case checks.
#[derive(Debug, PartialEq)]
enum Subject {
    Chunk,
    Training,
    Ensemble,
    Diffusion,
}

/// What the fields of `case` say that it is.
fn subject(case: &Value) -> Option<Subject> {
    if case["unet_output"].is_array() {
        Some(Subject::Diffusion)
    } else if case["loss"].is_number() {
        Some(Subject::Training)
    } else if case["output"].is_object() && case["chunk_size"].is_number() {
        Some(Subject::Ensemble)
    } else if case["output"].is_array() && !act::field(case, "image_hw").is_null() {
        Some(Subject::Chunk)
    } else {
        None
    }
}

#[test]
fn networks_agree_with_the_reference_implementations() {
    let (seed, cases, path) = golden();
    let cases = cases.as_object().unwrap();
    assert!(!cases.is_empty(), "{path} has no case");
    for (name, case) in cases {
        let seed = case["seed"].as_u64().unwrap_or(seed);
        match subject(case) {
            Some(Subject::Chunk) => act::check_chunk(name, case, seed),
            Some(Subject::Training) => act::check_training(name, case, seed),
            Some(Subject::Ensemble) => ensemble::check(name, case, seed),
            Some(Subject::Diffusion) => dp3::check(name, case, seed),
            None => panic!("{name}: nothing says what this case is"),
        }
    }
    println!("{} cases of {path} checked, none skipped", cases.len());
}

#[test]
fn fields_say_what_a_case_is() {
    let (_, cases, _) = golden();
    for (_, case) in cases.as_object().unwrap() {
        assert_ne!(subject(case), None, "{case}");
    }
    let odd = serde_json::json!({ "output": [1.0], "chunk_size": 8 });
    assert_eq!(subject(&odd), None);
}

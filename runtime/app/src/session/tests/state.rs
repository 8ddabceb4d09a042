//! What a training's state says of how it was begun is checked as a command line is, whatever
//! became of the file.

use tch::{Kind, Tensor};

use super::*;
use crate::session::training::{check, resume};

#[test]
fn a_state_s_options_are_checked_as_the_command_line_s() {
    let good = training_options("data".into(), "out".into());
    check(&good).unwrap();
    let good = serde_json::to_value(good).unwrap();
    for (key, value, reason) in [
        ("threads", serde_json::json!(u64::MAX), "threads = "),
        ("batch", serde_json::json!(1_u64 << 60), "batch = "),
        ("batch", serde_json::json!(0), "batch = 0"),
        ("steps", serde_json::json!(0), "steps = 0"),
        (
            "validation_share",
            serde_json::json!(1e300),
            "validation_share",
        ),
        ("preset", serde_json::json!("huge"), "--preset huge"),
        ("clouds", serde_json::json!("a.toml"), "--clouds"),
        (
            "backbone_weights",
            serde_json::json!("resnet18.safetensors"),
            "--backbone-weights",
        ),
    ] {
        let mut other = good.clone();
        other[key] = value;
        let other: TrainingOptions = serde_json::from_value(other).unwrap();
        let error = check(&other).unwrap_err().to_string();
        assert!(error.contains(reason), "{error}");
    }
    if !tch::Cuda::is_available() {
        let mut other = good;
        other["device"] = "cuda".into();
        let other: TrainingOptions = serde_json::from_value(other).unwrap();
        assert!(check(&other).unwrap_err().to_string().contains("CUDA"));
    }
}

/// A state at step 2 with what it remembers.
fn write_state(folder: &Path, about: &str) {
    let tensors = [
        ("step", Tensor::from_slice(&[2_i64])),
        ("curve", Tensor::zeros([0, 7], (Kind::Double, Device::Cpu))),
        (
            "since_row",
            Tensor::zeros([2, 4], (Kind::Float, Device::Cpu)),
        ),
        ("about", Tensor::from_slice(about.as_bytes())),
        ("run", Tensor::from_slice(b"{}")),
    ];
    fs::create_dir_all(folder).unwrap();
    let file = folder.join("training_state.safetensors");
    Tensor::write_safetensors(&tensors, file).unwrap();
}

#[test]
fn options_of_a_state_are_checked_before_anything_is_read() {
    let folder = Scratch::new("session-state-options");
    let options = training_options(folder.0.join("no-data"), folder.0.clone());
    for (key, value) in [
        ("threads", serde_json::json!(5000)),
        ("batch", serde_json::json!(70_000)),
        ("validation_share", serde_json::json!(0.95)),
    ] {
        let mut wrong = serde_json::json!(options);
        assert!(wrong.get(key).is_some(), "{key}");
        wrong[key] = value;
        let about = serde_json::json!({"options": wrong, "seconds": 12.5}).to_string();
        write_state(&folder.0, &about);
        let error = resume(&folder.0, &mut |_| {}).unwrap_err();
        let mut message = error.to_string();
        if let Some(cause) = std::error::Error::source(&error) {
            message = format!("{message}: {cause}");
        }
        assert!(
            message.contains(key) && !message.contains("no-data"),
            "{message}"
        );
        assert!(message.contains("training_state.safetensors"), "{message}");
    }
}

#[test]
fn every_number_that_a_state_remembers_may_be_wrong() {
    let folder = Scratch::new("session-state");
    let options = training_options(folder.0.join("no-data"), folder.0.clone());
    let about = serde_json::json!({"options": options, "seconds": 12.5}).to_string();
    write_state(&folder.0, &about);
    let error = resume(&folder.0, &mut |_| {}).unwrap_err().to_string();
    assert!(error.contains("no-data"), "{error}");
    let digits = |from: usize| about[from..].bytes().take_while(u8::is_ascii_digit).count();
    let mut refused = 0;
    for at in 1..about.len() {
        if digits(at) == 0 || about.as_bytes()[at - 1] != b':' {
            continue;
        }
        for other in ["-1", "1e18", "0.5", "18446744073709551615", "1e400", "null"] {
            let text = format!("{}{other}{}", &about[..at], &about[at + digits(at)..]);
            write_state(&folder.0, &text);
            let error = resume(&folder.0, &mut |_| {}).unwrap_err();
            let message = error.to_string();
            assert!(error.is_bad_input(), "{other} at {at}: {message}");
            refused += 1;
        }
    }
    assert!(refused >= 30, "{refused}");
}

//! Collects the tasks that are built in: every folder of `config/tasks/`, so that adding one takes
//! no line of code.

use std::error::Error;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::{env, fs};

/// As long as a task's name may be.
const NAME_BYTES_MAX: usize = 64;

/// What a task's folder must hold.
const FILES: [&str; 2] = ["scene.toml", "safety.toml"];

fn main() -> Result<(), Box<dyn Error>> {
    let tasks = Path::new(&env::var("CARGO_MANIFEST_DIR")?).join("../../config/tasks");
    println!("cargo::rerun-if-changed={}", tasks.display());
    println!("cargo::rerun-if-changed=build.rs");
    let mut folders: Vec<PathBuf> = Vec::new();
    for entry in fs::read_dir(&tasks)? {
        let path = entry?.path();
        let hidden = path
            .file_name()
            .is_some_and(|name| name.as_encoded_bytes().starts_with(b"."));
        if path.is_dir() && !hidden {
            folders.push(path);
        }
    }
    folders.sort();
    let mut code = String::from("&[\n");
    for folder in folders {
        code.push_str(&task(&folder)?);
    }
    code.push(']');
    fs::write(Path::new(&env::var("OUT_DIR")?).join("tasks.rs"), code)?;
    Ok(())
}

/// The expression of one built-in task: its name and the texts of its files.
fn task(folder: &Path) -> Result<String, Box<dyn Error>> {
    let name = folder.file_name().and_then(|name| name.to_str());
    let name = name.ok_or_else(|| format!("{}: no name in UTF-8", folder.display()))?;
    let letters = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_');
    if name.len() > NAME_BYTES_MAX || !name.chars().all(letters) {
        let allowed = format!("at most {NAME_BYTES_MAX} letters, digits, - and _");
        return Err(format!("config/tasks/{name}: a task's name is of {allowed}").into());
    }
    let mut code = format!("BuiltIn {{ name: {name:?}, ");
    for file in FILES {
        let path = folder.join(file).canonicalize();
        let path = path.map_err(|error| format!("config/tasks/{name}/{file}: {error}"))?;
        let field = file.trim_end_matches(".toml");
        write!(code, "{field}: include_str!({path:?}), ")?;
    }
    code.push_str("},\n");
    Ok(code)
}

//! Writes the folder of libtorch into every binary of the package, so that it starts with no
//! environment. `trocar` and `tests` use this file too, since a link argument reaches only the
//! package that gives it.

use std::path::Path;
use std::{env, fs};

/// Says where libtorch is and what it is.
pub(crate) fn main() {
    println!("cargo:rerun-if-env-changed=LIBTORCH");
    let version = env::var_os("LIBTORCH")
        .and_then(|folder| fs::read_to_string(Path::new(&folder).join("build-version")).ok());
    // Logs say what they ran with.
    println!(
        "cargo:rustc-env=LIBTORCH_VERSION={}",
        version.as_deref().map_or("unknown", str::trim)
    );
    let Some(libtorch) = env::var_os("LIBTORCH") else {
        return;
    };
    let Ok(folder) = fs::canonicalize(&libtorch) else {
        println!(
            "cargo:warning=LIBTORCH={} does not exist: run `make setup`",
            libtorch.display()
        );
        return;
    };
    // The default is a link, which may come to point elsewhere.
    println!(
        "cargo:rerun-if-changed={}",
        folder.join("build-version").display()
    );
    println!(
        "cargo:rustc-link-arg=-Wl,-rpath,{}",
        folder.join("lib").display()
    );
}

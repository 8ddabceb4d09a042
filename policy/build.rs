//! Writes the folder of libtorch into every binary, so that tests start with no environment.

use std::{env, fs};

fn main() {
    println!("cargo:rerun-if-env-changed=LIBTORCH");
    let Some(libtorch) = env::var_os("LIBTORCH") else {
        return;
    };
    let Ok(folder) = fs::canonicalize(&libtorch) else {
        println!(
            "cargo:warning=LIBTORCH={} does not exist",
            libtorch.display()
        );
        return;
    };
    println!(
        "cargo:rustc-link-arg=-Wl,-rpath,{}",
        folder.join("lib").display()
    );
}

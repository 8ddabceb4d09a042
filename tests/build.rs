//! Tells the linker where libtorch lies, so that binaries start with no environment set.

use std::env;
use std::fs;

fn main() {
    println!("cargo:rerun-if-env-changed=LIBTORCH");
    if let Some(libtorch) = env::var_os("LIBTORCH") {
        let folder = fs::canonicalize(&libtorch).unwrap_or_else(|_| libtorch.into());
        println!(
            "cargo:rustc-link-arg=-Wl,-rpath,{}",
            folder.join("lib").display()
        );
    }
}

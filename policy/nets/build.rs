//! The folder of libtorch, as every package with a binary has it, and what reaches libtorch's CUDA
//! graphs, which are C++.
//!
//! `shim.cpp` is compiled against libtorch's headers with stand-ins of our own for CUDA's, so that
//! no CUDA toolkit is needed to build, and one program serves a libtorch with and without CUDA.

#[path = "../build.rs"]
mod libtorch;

use std::env;
use std::path::PathBuf;

/// Panics, which ends the build, if `LIBTORCH` (or `LIBTORCH_INCLUDE`) has no headers.
fn main() {
    libtorch::main();
    let folder = "src/cuda_graph";
    println!("cargo:rerun-if-changed={folder}/shim.cpp");
    println!("cargo:rerun-if-changed={folder}/cuda");
    println!("cargo:rerun-if-env-changed=LIBTORCH_INCLUDE");
    // As torch-sys finds those of a libtorch that is not Python's or the system's.
    let libtorch = env::var_os("LIBTORCH_INCLUDE").or_else(|| env::var_os("LIBTORCH"));
    let headers = PathBuf::from(libtorch.unwrap_or_default()).join("include");
    assert!(
        headers.join("ATen/Context.h").exists(),
        "{} has no headers of libtorch: run `make setup`, or set LIBTORCH",
        headers.display()
    );
    let mut build = cc::Build::new();
    build.cpp(true).std("c++17").debug(false).warnings(true);
    // Ours come first: with whichever toolkit is installed beside it, the program is the same.
    build.include(format!("{folder}/cuda"));
    // libtorch's headers have warnings, which are not ours to read.
    build.flag("-isystem").flag(headers);
    build
        .file(format!("{folder}/shim.cpp"))
        .compile("trocar_cuda_graph");
}

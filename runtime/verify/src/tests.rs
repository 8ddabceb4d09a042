//! Every limit, broken by one command alone and kept by a hair.

mod distances;
mod motion;
mod pair;
mod recovery;
mod scene;
mod space;
mod tails;

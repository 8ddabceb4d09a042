//! Every limit, broken by one command alone and kept by a hair.

mod distances;
mod measured;
mod motion;
mod pair;
mod rates;
mod recovery;
mod scene;
mod space;
mod tails;

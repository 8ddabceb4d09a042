mod hard;
mod optimal;
mod problem;
mod refused;
mod untouched;

//! The control runtime: kinematics, aggregation, safety, real-time loop, log, replay, and the `trocar` binary.

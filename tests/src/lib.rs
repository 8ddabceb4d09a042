//! Closed-loop, conformance, golden and fault tests, and the benches.

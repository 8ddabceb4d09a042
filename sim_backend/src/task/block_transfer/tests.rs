//! Facts about the block transfer: draws, rest, verdicts.

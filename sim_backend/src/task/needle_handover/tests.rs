//! Facts about the needle handover: where the arms stand, where the needle lies, what counts.

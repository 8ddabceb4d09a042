//! Contacts that are one.
//!
//! Where a capsule's line lies on a flat face the engine gives both ends of the line, and then one of the two, or each,
//! again. Each is solved with a spring of its own: twice the work for a contact twice as stiff.

use rapier3d_f64::geometry::SolverContact;

/// Contacts as close as this are one, m: far below any feature of an instrument, far above rounding.
const SAME_M: f64 = 1e-6;

/// Whether the point `index` of a manifold is among its `contacts` that are solved.
pub(super) fn is_solved(contacts: &[SolverContact], index: usize) -> bool {
    let mut ids = contacts
        .iter()
        .flat_map(|contact| contact.contact_indices());
    ids.any(|id| usize::try_from(id) == Ok(index))
}

/// Drops contacts that lie where an earlier one of the same pair of faces does.
pub(super) fn merge(contacts: &mut Vec<SolverContact>) {
    let mut kept = 0;
    for index in 0..contacts.len() {
        let (before, rest) = contacts.split_at(index);
        let here = rest[0].anchor1;
        let is_new = before[..kept]
            .iter()
            .all(|earlier| earlier.anchor1.distance_squared(here) > SAME_M * SAME_M);
        if is_new {
            contacts.swap(kept, index);
            kept += 1;
        }
    }
    contacts.truncate(kept);
}

//! Facts about the needle lift: what is seen.

use super::*;
use crate::simulation::pictures::Looks;

#[test]
fn muscle_is_bright_red() {
    let looks = Looks::of(NAME);
    let [red, green, _] = looks.colour(instance::ORGAN);
    looks.check(red > 1.6 * green && red > 110.0, "muscle is bright red");
}

//! The answer, in which a variable that no active row reaches stays exactly where it was. Hot path.

use super::method::Method;
use super::{Solution, VARIABLES_MAX};

impl<const N: usize> Method<N> {
    /// What has been found, with exact zeros where nothing acts.
    pub(super) fn solution(&self) -> Solution {
        let mut change = [0.0; VARIABLES_MAX];
        let reached = self.reached();
        for ((change, x), reached) in change.iter_mut().zip(&self.x).zip(reached) {
            if reached {
                *change = *x;
            }
        }
        Solution {
            change,
            iterations: self.iterations,
        }
    }

    /// Which variables an active row reaches, directly or through the Hessian.
    ///
    /// The transitive closure of `G`'s nonzero pattern, starting at the nonzero coefficients of the
    /// active rows: at most `N` rounds, `O(N^3)`. The solve leaves rounding in the other variables;
    /// a jaw, or an arm that nothing limits, must keep its velocity to the bit.
    fn reached(&self) -> [bool; N] {
        let mut reached = [false; N];
        for active in self.active.iter().take(self.active_count) {
            for (reached, coefficient) in reached.iter_mut().zip(&active.row.coefficients) {
                *reached |= *coefficient != 0.0;
            }
        }
        for _ in 0..N {
            let before = reached;
            for (from, row) in before.iter().zip(&self.hessian) {
                for (reached, entry) in reached.iter_mut().zip(row) {
                    *reached |= *from && *entry != 0.0;
                }
            }
            if before == reached {
                break;
            }
        }
        reached
    }
}

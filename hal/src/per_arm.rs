//! One value for each arm of a run, of which there are one or two. Plain data without allocation.

/// Most arms that a run has.
pub const ARMS_MAX: usize = 2;

/// One value for each arm, in the order of the arms in `safety.toml`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PerArm<T> {
    /// The arm that every run has.
    pub first: T,
    /// The other one.
    pub second: Option<T>,
}

impl<T> PerArm<T> {
    /// The value of the only arm.
    #[must_use]
    pub const fn one(first: T) -> Self {
        Self {
            first,
            second: None,
        }
    }

    /// The values of two arms.
    #[must_use]
    pub const fn two(first: T, second: T) -> Self {
        Self {
            first,
            second: Some(second),
        }
    }

    /// The first values of `values`, none if there is no value at all.
    pub fn collect(values: impl IntoIterator<Item = T>) -> Option<Self> {
        let mut values = values.into_iter();
        Some(Self {
            first: values.next()?,
            second: values.next(),
        })
    }

    /// How many arms there are.
    #[must_use]
    pub const fn count(&self) -> usize {
        if self.second.is_some() { ARMS_MAX } else { 1 }
    }

    /// The values in order.
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = &T> {
        [Some(&self.first), self.second.as_ref()]
            .into_iter()
            .flatten()
    }

    /// The value of the arm `index`, counted from 0.
    #[must_use]
    pub const fn get(&self, index: usize) -> Option<&T> {
        match index {
            0 => Some(&self.first),
            1 => self.second.as_ref(),
            _ => None,
        }
    }

    /// The values, to be changed.
    pub fn iter_mut(&mut self) -> impl Iterator<Item = &mut T> {
        [Some(&mut self.first), self.second.as_mut()]
            .into_iter()
            .flatten()
    }

    /// The same for all arms, of references.
    #[must_use]
    pub const fn as_ref(&self) -> PerArm<&T> {
        PerArm {
            first: &self.first,
            second: self.second.as_ref(),
        }
    }

    /// Another value for each arm, the first arm's first.
    pub fn map<U>(self, mut change: impl FnMut(T) -> U) -> PerArm<U> {
        PerArm {
            first: change(self.first),
            second: self.second.map(change),
        }
    }

    /// The pairs of arms that both have.
    pub fn zip<U>(self, other: PerArm<U>) -> PerArm<(T, U)> {
        PerArm {
            first: (self.first, other.first),
            second: self.second.zip(other.second),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::PerArm;

    #[test]
    fn one_arm_and_two_keep_their_order() {
        let (one, two) = (PerArm::one(3), PerArm::two(3, 4));
        assert_eq!((one.count(), two.count()), (1, 2));
        assert_eq!(one.iter().collect::<Vec<_>>(), [&3]);
        assert_eq!(two.iter().rev().collect::<Vec<_>>(), [&4, &3]);
        assert_eq!((two.get(1), one.get(1), two.get(2)), (Some(&4), None, None));
        assert_eq!(PerArm::collect([3, 4]), Some(two));
        assert_eq!(PerArm::<u8>::collect([]), None);
        assert_eq!(two.map(|value| 2 * value), PerArm::two(6, 8));
        assert_eq!(two.zip(one), PerArm::one((3, 3)));
    }
}

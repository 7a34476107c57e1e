//! What every scenario knows about its robots.

use std::borrow::Cow;
use std::fmt;
use std::ops::Range;

use muster_model::id::{IdError, RobotId};

/// Metres east and north.
pub(crate) type Point = [f64; 2];

/// What does not change about a robot.
#[derive(Debug, Clone)]
pub(crate) struct Member {
    pub(crate) id: RobotId,
    pub(crate) role: Cow<'static, str>,
}

impl Member {
    pub(crate) fn new(id: impl AsRef<str>, role: &'static str) -> Result<Self, IdError> {
        Ok(Self { id: RobotId::new(id)?, role: Cow::Borrowed(role) })
    }
}

/// Where a robot is, and how it moves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Place {
    /// Metres east and north.
    pub(crate) at: Point,
    /// Metres per second; none if it never moves.
    pub(crate) velocity: Option<Point>,
}

/// The team that a robot belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Command {
    /// The robot that it answers to, by index; none at the top.
    pub(crate) superior: Option<usize>,
    /// The team that it truly is in, from 0.
    pub(crate) team: usize,
}

/// A scenario. All lists have one entry per robot, in the same order.
pub(crate) trait Formation: fmt::Debug + Send + Sync {
    /// The robots.
    fn members(&self) -> &[Member];

    /// Where they are after finite seconds.
    fn places(&self, t_seconds: f64) -> Vec<Place>;

    /// Their teams after finite seconds.
    fn commands(&self, t_seconds: f64) -> Vec<Command>;
}

/// Divides `count` robots into `parts` that differ by at most one: the indices of each part.
pub(crate) fn evenly(count: usize, parts: usize) -> impl Iterator<Item = Range<usize>> {
    let (share, rest) = (count / parts.max(1), count % parts.max(1));
    (0..parts).scan(0, move |start, part| {
        let range = *start..*start + share + usize::from(part < rest);
        *start = range.end;
        Some(range)
    })
}

/// Columns of the smallest square that fits so many.
pub(crate) fn columns(count: usize) -> usize {
    let root = count.isqrt();
    if root * root < count { root + 1 } else { root.max(1) }
}

/// A small count as a number of metres or steps.
#[expect(clippy::cast_precision_loss, reason = "counts of robots are far below 2⁵³")]
pub(crate) fn number(count: usize) -> f64 {
    count as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn robots_are_divided_evenly() {
        assert_eq!(evenly(7, 3).collect::<Vec<_>>(), [0..3, 3..5, 5..7]);
        assert_eq!(evenly(0, 0).count(), 0);
    }

    #[test]
    fn a_square_is_wide_enough() {
        assert_eq!([0, 1, 2, 4, 5, 9, 10].map(columns), [1, 1, 2, 2, 3, 3, 4]);
    }
}

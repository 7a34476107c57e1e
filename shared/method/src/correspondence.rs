//! Which robots of one frame are which of another.

use muster_model::id::RobotId;

/// Where each robot of two lists stands in the other one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Correspondence {
    to_new: Vec<Option<usize>>,
    to_old: Vec<Option<usize>>,
}

impl Correspondence {
    /// Between two lists that are ordered by name; none if they are equal.
    pub(crate) fn between(old: &[RobotId], new: &[RobotId]) -> Option<Self> {
        if old == new {
            return None;
        }
        let find = |these: &[RobotId], those: &[RobotId]| {
            these.iter().map(|robot| those.binary_search(robot).ok()).collect()
        };
        Some(Self { to_new: find(old, new), to_old: find(new, old) })
    }

    /// For each old robot, its place in the new list.
    pub(crate) fn to_new(&self) -> &[Option<usize>] {
        &self.to_new
    }

    /// For each new robot, its place in the old list.
    pub(crate) fn to_old(&self) -> &[Option<usize>] {
        &self.to_old
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn robots_that_come_and_go_have_no_counterpart() {
        let names = |all: &[&str]| -> Vec<RobotId> {
            all.iter().map(|name| RobotId::new(*name).unwrap()).collect()
        };
        let [old, new] = [names(&["a", "b", "d"]), names(&["b", "c", "d"])];
        let between = Correspondence::between(&old, &new).unwrap();
        assert_eq!(between.to_new(), [None, Some(0), Some(2)]);
        assert_eq!(between.to_old(), [Some(1), None, Some(2)]);
        assert_eq!(Correspondence::between(&old, &old), None);
    }
}

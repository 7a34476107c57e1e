//! Teams that robots had before the last division. Whoever divides next, another instance or another process, gives them back.

use serde::{Deserialize, Serialize};

use crate::content::{Content, ContentError, refuse};
use crate::id::{RobotId, TeamId};
use crate::limits::{MAX_ROBOTS, MAX_TEAMS};

/// What is remembered of divisions before the last.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RememberedTeams {
    /// Robots that are in no team of the last division, with the team that they were in last, ordered by name.
    pub last: Vec<(RobotId, TeamId)>,
    /// Teams that are not in the last division, with the robots that they had, ordered by id.
    pub ended: Vec<(TeamId, Vec<RobotId>)>,
    /// Teams with this number and higher ones began when no robot was there that had been in a team before.
    pub newcomers_from: u64,
}

impl Content for RememberedTeams {
    /// All is ordered and stands once, and there is no more of it than of a fleet.
    fn check(&self) -> Result<(), ContentError> {
        if self.last.len() > MAX_ROBOTS {
            return refuse("remembered.last", "has more robots than a fleet may have");
        }
        if !self.last.is_sorted_by(|left, right| left.0 < right.0) {
            return refuse("remembered.last", "must be ordered by name, each robot once");
        }
        if self.ended.len() > MAX_TEAMS as usize {
            return refuse("remembered.ended", "has more teams than a fleet may have");
        }
        if !self.ended.is_sorted_by(|left, right| left.0 < right.0) {
            return refuse("remembered.ended", "must be ordered by id, each team once");
        }
        let robots: usize = self.ended.iter().map(|(_, members)| members.len()).sum();
        if robots > MAX_ROBOTS {
            return refuse("remembered.ended", "has more robots than a fleet may have");
        }
        let are_ordered = |members: &Vec<RobotId>| members.is_sorted_by(|left, right| left < right);
        if !self.ended.iter().all(|(_, members)| are_ordered(members)) {
            return refuse("remembered.ended", "its robots must be ordered by name, each once");
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_remembered_is_ordered_and_stands_once() {
        let robot = |name: &str| RobotId::new(name).unwrap();
        let (one, two) = (TeamId::numbered(1), TeamId::numbered(2));
        let good = RememberedTeams {
            last: vec![(robot("a"), one.clone()), (robot("b"), one.clone())],
            ended: vec![(one.clone(), vec![robot("a"), robot("b")]), (two.clone(), vec![])],
            newcomers_from: 3,
        };
        assert_eq!(good.check(), Ok(()));
        let twice = vec![(robot("a"), one.clone()), (robot("a"), two.clone())];
        let many = vec![(robot("a"), one.clone()); MAX_ROBOTS + 1];
        for (bad, problem) in [
            (RememberedTeams { last: twice, ..good.clone() }, "remembered.last: must be ordered"),
            (RememberedTeams { last: many, ..good.clone() }, "remembered.last: has more"),
            (
                RememberedTeams {
                    ended: vec![(two, vec![]), (one.clone(), vec![])],
                    ..good.clone()
                },
                "remembered.ended: must be ordered",
            ),
            (
                RememberedTeams {
                    ended: vec![(one, vec![robot("b"), robot("a")])],
                    ..good.clone()
                },
                "remembered.ended: its robots must be ordered",
            ),
            (
                RememberedTeams {
                    ended: (0..=u64::from(MAX_TEAMS))
                        .map(|at| (TeamId::numbered(at), vec![]))
                        .collect(),
                    ..good.clone()
                },
                "remembered.ended: has more teams",
            ),
            (
                RememberedTeams {
                    ended: vec![(TeamId::numbered(1), vec![robot("a"); MAX_ROBOTS + 1])],
                    ..good
                },
                "remembered.ended: has more robots",
            ),
        ] {
            let error = bad.check().unwrap_err().to_string();
            assert!(error.starts_with(problem), "{error}");
        }
    }
}

//! The leader of each team: the member that commands most of the others.

use std::collections::{BTreeMap, HashMap};

use muster_model::id::{RobotId, TeamId};
use muster_model::roster::Roster;
use muster_model::teams::{Team, Teams};

/// The leader of each team: of its members that are not absent, the one that commands most others. On a tie
/// the previous leader stays, otherwise the first by name leads. If all members are absent, the previous
/// leader stays. A team without members has no leader; there is no such team.
pub(crate) fn leaders(
    teams: &[Team],
    roster: Option<&Roster>,
    previous: Option<&Teams>,
    absent: &[RobotId],
) -> Vec<Option<RobotId>> {
    let commanded = commanded(teams, roster);
    let before: BTreeMap<&TeamId, &RobotId> = previous
        .into_iter()
        .flat_map(|teams| teams.teams.iter().map(|team| (&team.id, &team.leader)))
        .collect();
    teams
        .iter()
        .map(|team| {
            let members = || team.members.iter().map(|member| &member.robot);
            let mut fit: Vec<&RobotId> =
                members().filter(|robot| absent.binary_search(robot).is_err()).collect();
            if fit.is_empty() {
                let kept = before.get(&team.id).filter(|leader| members().any(|r| r == **leader));
                if let Some(leader) = kept {
                    return Some((*leader).clone());
                }
                fit = members().collect();
            }
            let count = |robot: &RobotId| commanded.get(robot).copied().unwrap_or(0);
            let most = fit.iter().map(|robot| count(robot)).max()?;
            let stays = before
                .get(&team.id)
                .filter(|leader| count(leader) == most && fit.binary_search(leader).is_ok());
            stays.or_else(|| fit.iter().find(|robot| count(robot) == most)).copied().cloned()
        })
        .collect()
}

/// How many others of its team each robot commands, over any number of steps and through robots of
/// any team. Robots without subordinates may be left out.
///
/// One depth-first walk through the forest of superiors: a robot commands those of its team that are entered
/// between entering and leaving the robot. Each robot of a circle of superiors commands all robots below the
/// circle. Linear in the robots, however long the chains are.
fn commanded<'a>(teams: &'a [Team], roster: Option<&'a Roster>) -> HashMap<&'a RobotId, u64> {
    let Some(roster) = roster else { return HashMap::new() };
    if roster.robots.iter().all(|entry| entry.superior.is_none()) {
        return HashMap::new();
    }
    let mut place: HashMap<&RobotId, usize> = HashMap::with_capacity(roster.robots.len());
    let mut names: Vec<&RobotId> = Vec::with_capacity(roster.robots.len());
    for entry in &roster.robots {
        place.entry(&entry.robot).or_insert_with(|| {
            names.push(&entry.robot);
            names.len() - 1
        });
    }
    let mut superior = vec![None; names.len()];
    for entry in &roster.robots {
        let above = entry.superior.as_ref().and_then(|above| place.get(above)).copied();
        superior[place[&entry.robot]] = above;
    }
    let mut team_of = vec![None; names.len()];
    for (number, team) in teams.iter().enumerate() {
        for at in team.members.iter().filter_map(|member| place.get(&member.robot)) {
            team_of[*at] = Some(number);
        }
    }
    let below = count_below(&superior, &team_of, teams.len());
    names.into_iter().zip(below).collect()
}

/// For each place, how many others of the same team stand below it.
fn count_below(superior: &[Option<usize>], team_of: &[Option<usize>], teams: usize) -> Vec<u64> {
    let mut inferiors: Vec<Vec<usize>> = vec![Vec::new(); superior.len()];
    for (at, above) in superior.iter().enumerate() {
        if let Some(above) = above {
            inferiors[*above].push(at);
        }
    }
    let mut walk = Walk {
        inferiors,
        team_of,
        entered: vec![0; teams],
        visited: vec![false; superior.len()],
        below: vec![0; superior.len()],
    };
    for (at, _) in superior.iter().enumerate().filter(|(_, above)| above.is_none()) {
        walk.descend(&[at]);
    }
    // What no top reaches is below a circle of superiors.
    for at in 0..superior.len() {
        if walk.visited[at] {
            continue;
        }
        let circle = circle_above(at, superior);
        walk.descend(&circle);
    }
    walk.below
}

/// The circle that the superiors of a place end in.
fn circle_above(start: usize, superior: &[Option<usize>]) -> Vec<usize> {
    let mut passed = BTreeMap::new();
    let mut path = Vec::new();
    let mut at = start;
    loop {
        if let Some(first) = passed.insert(at, path.len()) {
            return path.split_off(first);
        }
        path.push(at);
        match superior[at] {
            Some(above) => at = above,
            None => return vec![at],
        }
    }
}

struct Walk<'a> {
    inferiors: Vec<Vec<usize>>,
    team_of: &'a [Option<usize>],
    /// How many of each team have been entered.
    entered: Vec<u64>,
    visited: Vec<bool>,
    below: Vec<u64>,
}

impl Walk<'_> {
    /// Walks through all robots below a top, or below a circle.
    fn descend(&mut self, tops: &[usize]) {
        enum Step {
            Enter(usize),
            Leave(usize, u64),
        }
        let count = |walk: &Self, at: usize| walk.team_of[at].map_or(0, |team| walk.entered[team]);
        let before: Vec<u64> = tops.iter().map(|at| count(self, *at)).collect();
        let mut steps: Vec<Step> = tops.iter().map(|at| Step::Enter(*at)).collect();
        while let Some(step) = steps.pop() {
            match step {
                Step::Enter(at) => {
                    if std::mem::replace(&mut self.visited[at], true) {
                        continue;
                    }
                    steps.push(Step::Leave(at, count(self, at)));
                    if let Some(team) = self.team_of[at] {
                        self.entered[team] += 1;
                    }
                    steps.extend(self.inferiors[at].iter().map(|at| Step::Enter(*at)));
                }
                Step::Leave(at, entered) => {
                    self.below[at] = (count(self, at) - entered).saturating_sub(1);
                }
            }
        }
        for (at, entered) in tops.iter().zip(before) {
            self.below[*at] = (count(self, *at) - entered).saturating_sub(1);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The plain definition: follow every member's chain up.
    fn naive(superior: &[Option<usize>], team_of: &[Option<usize>]) -> Vec<u64> {
        let mut below = vec![0; superior.len()];
        for at in 0..superior.len() {
            let mut above = std::collections::BTreeSet::new();
            let mut next = superior[at];
            while let Some(robot) = next.filter(|robot| above.insert(*robot)) {
                next = superior[robot];
            }
            above.remove(&at);
            for robot in above {
                below[robot] += u64::from(team_of[at].is_some() && team_of[robot] == team_of[at]);
            }
        }
        below
    }

    #[test]
    fn chains_trees_and_circles_are_counted_as_by_the_definition() {
        let mut state = 1_u64;
        let mut draw = |below: u64| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            usize::try_from((state >> 33) % below).unwrap()
        };
        for round in 0..500 {
            let robots = 1 + draw(12);
            let pick = |draw: &mut dyn FnMut(u64) -> usize| {
                (draw(4) > round % 3).then(|| draw(robots as u64))
            };
            let superior: Vec<_> = (0..robots).map(|_| pick(&mut draw)).collect();
            let team_of: Vec<_> =
                (0..robots).map(|_| Some(draw(3)).filter(|team| *team < 2)).collect();
            assert_eq!(
                count_below(&superior, &team_of, 2),
                naive(&superior, &team_of),
                "{superior:?} {team_of:?}"
            );
        }
    }

    #[test]
    fn a_chain_of_all_robots_takes_no_time() {
        let robots = 200_000;
        let superior: Vec<_> = (0..robots).map(|at: usize| at.checked_sub(1)).collect();
        let below = count_below(&superior, &vec![Some(0); robots], 1);
        assert_eq!((below[0], below[robots - 1]), (199_999, 0));
        let circle: Vec<_> = (0..robots).map(|at| Some((at + 1) % robots)).collect();
        let below = count_below(&circle, &vec![Some(0); robots], 1);
        assert!(below.iter().all(|count| *count == 199_999));
    }
}

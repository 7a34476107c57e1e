//! Answers to gets of a division and of the teams of single robots, alike for its author and for readers
//! that cached it.

use muster_model::content::Checked;
use muster_model::id::RobotId;
use muster_model::teams::Teams;
use muster_wire::{Key, KeySpace, Message, Request};

/// Most names in all the answers to one get of robots' teams. The answer for each robot of a small
/// team names all its members, so that the answer for a whole fleet grows with the square of its teams.
const MAX_NAMES_ANSWERED: usize = 4_000_000;

/// The teams of the robots that are asked for do not fit one answer.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "the teams of these robots name {names} members, which is more than one answer may hold; get \
     {teams} or the team of one robot"
)]
pub struct TooManyNames {
    /// How many names the answers would hold.
    pub names: usize,
    /// The key of the whole division.
    pub teams: String,
}

/// What a division answers to a get of `teams`, `json/teams` and `robot/*/team`.
///
/// # Errors
/// [`TooManyNames`] if the teams of all robots that are asked for are more than one answer may hold.
pub fn answer_teams(
    space: &KeySpace,
    request: &Request,
    teams: &Checked<Teams>,
) -> Result<Vec<Message>, TooManyNames> {
    if let Some(Key::RobotTeam(robot)) = request.exact_key(space) {
        return Ok(teams.robot_team(&robot).map(Message::RobotTeam).into_iter().collect());
    }
    let mut messages = Vec::new();
    if request.selects(space, &Key::Teams) || request.selects(space, &Key::JsonTeams) {
        messages.push(Message::Teams { teams: teams.clone(), mirror: true });
    }
    if request.exact_key(space).is_some() {
        return Ok(messages);
    }
    let robots = selected(space, request, teams);
    let names = robots.iter().fold(0_usize, |sum, (_, names)| sum.saturating_add(*names));
    if names > MAX_NAMES_ANSWERED {
        return Err(TooManyNames { names, teams: space.format(&Key::Teams) });
    }
    messages.extend(
        robots.into_iter().filter_map(|(r, _)| teams.robot_team(r)).map(Message::RobotTeam),
    );
    Ok(messages)
}

/// The robots whose team is asked for, each with how many names its answer holds.
fn selected<'a>(
    space: &KeySpace,
    request: &Request,
    teams: &'a Teams,
) -> Vec<(&'a RobotId, usize)> {
    let robots = teams
        .teams
        .iter()
        .flat_map(|team| {
            let names = if team.members.len() > muster_model::limits::MAX_MEMBERS_PUBLISHED {
                1
            } else {
                team.members.len()
            };
            team.members.iter().map(move |member| (&member.robot, names))
        })
        .chain(teams.unassigned.iter().map(|robot| (robot, 0)));
    robots.filter(|(robot, _)| request.selects(space, &Key::RobotTeam((*robot).clone()))).collect()
}

#[cfg(test)]
mod tests {
    use muster_model::header::{Header, Revision};
    use muster_model::id::{FleetId, TeamId};
    use muster_model::remembered::RememberedTeams;
    use muster_model::teams::{Member, Team};

    use super::*;

    fn division(members: usize, unassigned: &[&str]) -> Checked<Teams> {
        let robot = |name: &str| RobotId::new(name).unwrap();
        let mut members: Vec<Member> = (0..members)
            .map(|i| Member { robot: robot(&format!("r{i:05}")), margin: 0.5 })
            .collect();
        members.sort_by(|left, right| left.robot.cmp(&right.robot));
        let leader = members[0].robot.clone();
        Checked::new_unchecked(Teams {
            header: Header {
                fleet: FleetId::new("f").unwrap(),
                revision: Revision::default(),
                oldest: None,
                newest: None,
                stages: vec![],
            },
            embedding: Revision::default(),
            requested: 1,
            considered: vec![],
            teams: vec![Team { id: TeamId::numbered(1), members, leader, centroid: vec![] }],
            unassigned: unassigned.iter().map(|name| robot(name)).collect(),
            stale: vec![],
            inertia: 0.0,
            changes: vec![],
            next_team: 2,
            limited: None,
            needs: vec![],
            provisional: vec![],
            held: vec![],
            remembered: RememberedTeams::default(),
        })
    }

    fn count(selector: &str, teams: &Checked<Teams>) -> usize {
        let space = KeySpace::new(FleetId::new("f").unwrap());
        let request = Request::new(format!("muster/v1/f/{selector}"), "", None).unwrap();
        answer_teams(&space, &request, teams).unwrap().len()
    }

    #[test]
    fn a_get_selects_what_it_names() {
        let teams = division(3, &["0", "x"]);
        let cases = [
            ("teams", 1),
            ("json/teams", 1),
            ("embedding", 0),
            ("robot/x/team", 1),
            ("robot/r00001/team", 1),
            ("robot/absent/team", 0),
            ("robot/*/team", 5),
            ("robot/r$*/team", 3),
            ("robot/$*0/team", 2),
            ("robot/x/**", 1),
            ("*", 1),
            ("**", 6),
        ];
        for (selector, expected) in cases {
            assert_eq!(count(selector, &teams), expected, "{selector}");
        }
    }

    #[test]
    fn large_teams_name_no_members_and_so_fit_one_answer() {
        assert_eq!(count("robot/*/team", &division(3000, &[])), 3000);
    }
}

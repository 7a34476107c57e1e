//! Every robot has exactly one place, in a division of an embedding of a roster that there was.

use std::collections::BTreeSet;

use muster_model::content::Checked;
use muster_model::embedding::Embedding;
use muster_model::id::RobotId;
use muster_model::roster::Roster;
use muster_model::teams::{RobotTeam, Teams};

use super::{Published, Verified, breach};

/// No robot is twice in a roster, by name or by node.
pub(crate) fn check_roster(roster: &Roster) -> Verified {
    let names: BTreeSet<_> = roster.robots.iter().map(|entry| &entry.robot).collect();
    let nodes: BTreeSet<_> = roster.robots.iter().map(|entry| entry.node).collect();
    if names.len() != roster.robots.len() || nodes.len() != roster.robots.len() {
        return breach(
            "a robot stands once in a roster",
            format!("roster {:?}: {:?}", roster.header.revision, roster.robots),
        );
    }
    Ok(())
}

/// An embedding has one finite vector for each robot of the roster that it names.
pub(crate) fn check_embedding(
    embedding: &Embedding,
    rosters: &Published<Checked<Roster>>,
) -> Verified {
    let revision = embedding.header.revision;
    let of_roster = |roster: &Checked<Roster>| {
        roster.robots.iter().map(|entry| &entry.robot).eq(&embedding.robots)
    };
    if !rosters.named(embedding.roster).iter().any(of_roster) {
        return breach(
            "an embedding has the robots of the roster that it names",
            format!("embedding {revision:?} names {:?}: {:?}", embedding.roster, embedding.robots),
        );
    }
    let wanted = embedding.robots.len() * embedding.dimension as usize;
    if embedding.values.len() != wanted
        || embedding.without_embedding.len() != embedding.robots.len()
    {
        return breach(
            "an embedding has one vector for each robot",
            format!("embedding {revision:?}: {} numbers, not {wanted}", embedding.values.len()),
        );
    }
    Ok(())
}

/// Each robot of the embedding that a division names is in exactly one team, or in none.
pub(crate) fn check_division(
    teams: &Teams,
    embeddings: &Published<Checked<Embedding>>,
) -> Verified {
    let revision = teams.header.revision;
    let named = embeddings.named(teams.embedding);
    if named.is_empty() {
        return breach(
            "every division names an embedding that was published",
            format!("division {revision:?} names {:?}", teams.embedding),
        );
    }
    let members = teams.teams.iter().flat_map(|team| &team.members).map(|member| &member.robot);
    let mut robots: Vec<&RobotId> = members.chain(&teams.unassigned).collect();
    robots.sort();
    if let Some(pair) = robots.windows(2).find(|pair| pair[0] == pair[1]) {
        return breach(
            "a robot is in exactly one team, or in none",
            format!("division {revision:?}: {} stands twice", pair[0]),
        );
    }
    if !named.iter().any(|embedding| robots.iter().copied().eq(&embedding.robots)) {
        return breach(
            "a robot is in exactly one team, or in none",
            format!(
                "division {revision:?} has {robots:?}, its embedding {:?}",
                named.iter().map(|embedding| &embedding.robots).collect::<Vec<_>>()
            ),
        );
    }
    check_teams(teams)
}

/// The teams of a division are whole.
pub(super) fn check_teams(teams: &Teams) -> Verified {
    let revision = teams.header.revision;
    let ids: BTreeSet<_> = teams.teams.iter().map(|team| &team.id).collect();
    if ids.len() != teams.teams.len() || teams.teams.len() > teams.requested as usize {
        return breach(
            "teams are distinct and no more than asked for",
            format!("division {revision:?}: {ids:?} of {}", teams.requested),
        );
    }
    for team in &teams.teams {
        let leads = team.members.iter().any(|member| member.robot == team.leader);
        let number = team.id.as_str().strip_prefix('t').and_then(|number| number.parse().ok());
        let is_new = number.is_some_and(|number: u64| number >= teams.next_team);
        if !leads || is_new {
            return breach(
                "a team has members, one of which leads it, and a number that was given before",
                format!("division {revision:?}, next {}: {team:?}", teams.next_team),
            );
        }
    }
    Ok(())
}

/// What is published for a robot agrees with the division.
pub(crate) fn check_robot_team(
    report: &RobotTeam,
    divisions: &Published<Checked<Teams>>,
) -> Verified {
    let revision = report.header.revision;
    let agrees = |teams: &Checked<Teams>| {
        let team = teams
            .teams
            .iter()
            .find(|team| team.members.iter().any(|member| member.robot == report.robot));
        match team {
            None => report.team.is_none() && teams.unassigned.contains(&report.robot),
            Some(team) => {
                let names: Vec<_> = team.members.iter().map(|member| &member.robot).collect();
                report.team.as_ref() == Some(&team.id)
                    && report.leader.as_ref() == Some(&team.leader)
                    && report.members.as_ref().is_none_or(|members| members.iter().eq(names))
            }
        }
    };
    if divisions.named(revision).iter().any(agrees) {
        return Ok(());
    }
    breach(
        "a robot is sent the team of the division",
        format!("{} is sent {:?} of {revision:?}", report.robot, report.team),
    )
}

#[cfg(test)]
mod tests {
    use muster_model::id::TeamId;

    use super::super::samples::{oracle_of_a_divided_fleet, promise};
    use super::*;

    #[test]
    fn what_is_wrong_with_rosters_and_embeddings_is_seen() {
        let oracle = oracle_of_a_divided_fleet();
        let roster = oracle.rosters.last().unwrap();
        assert_eq!(check_roster(roster), Ok(()));
        let mut twice = Roster::clone(roster);
        twice.robots.push(twice.robots[0].clone());
        assert_eq!(promise(check_roster(&twice)), "a robot stands once in a roster");

        let embedding = oracle.embeddings.last().unwrap();
        assert_eq!(check_embedding(embedding, &oracle.rosters), Ok(()));
        let mut other = Embedding::clone(embedding);
        other.robots[0] = RobotId::new("another").unwrap();
        assert_eq!(
            promise(check_embedding(&other, &oracle.rosters)),
            "an embedding has the robots of the roster that it names"
        );
        let mut short = Embedding::clone(embedding);
        short.values.pop();
        assert_eq!(
            promise(check_embedding(&short, &oracle.rosters)),
            "an embedding has one vector for each robot"
        );
    }

    #[test]
    fn what_is_wrong_with_divisions_is_seen() {
        let oracle = oracle_of_a_divided_fleet();
        let teams = oracle.divisions.last().unwrap();
        assert_eq!(check_division(teams, &oracle.embeddings), Ok(()));
        let broken = |change: &dyn Fn(&mut Teams)| {
            let mut broken = Teams::clone(teams);
            change(&mut broken);
            promise(check_division(&broken, &oracle.embeddings))
        };
        let too_many = "teams are distinct and no more than asked for";
        assert_eq!(broken(&|teams| teams.requested -= 1), too_many);
        assert_eq!(broken(&|teams| teams.teams[1].id = teams.teams[0].id.clone()), too_many);
        let whole = "a team has members, one of which leads it, and a number that was given before";
        assert_eq!(broken(&|teams| teams.next_team = 1), whole);
        assert_eq!(broken(&|teams| teams.teams[0].leader = teams.teams[1].leader.clone()), whole);
        let once = "a robot is in exactly one team, or in none";
        assert_eq!(broken(&|teams| teams.unassigned.push(teams.teams[0].leader.clone())), once);
        assert_eq!(
            broken(&|teams| teams.embedding.epoch += 1_000_000),
            "every division names an embedding that was published"
        );
    }

    #[test]
    fn a_robot_that_is_sent_another_team_is_seen() {
        let oracle = oracle_of_a_divided_fleet();
        let teams = oracle.divisions.last().unwrap();
        let team = &teams.teams[0];
        let right = RobotTeam {
            header: teams.header.clone(),
            robot: team.leader.clone(),
            team: Some(team.id.clone()),
            members: None,
            leader: Some(team.leader.clone()),
            confidence: 0.5,
        };
        assert_eq!(check_robot_team(&right, &oracle.divisions), Ok(()));
        let other = Some(TeamId::numbered(1_000_000));
        for wrong in [
            RobotTeam { team: other, ..right.clone() },
            RobotTeam { team: None, leader: None, ..right.clone() },
            RobotTeam { leader: Some(teams.teams[1].leader.clone()), ..right.clone() },
            RobotTeam { members: Some(Vec::new()), ..right },
        ] {
            assert_eq!(
                promise(check_robot_team(&wrong, &oracle.divisions)),
                "a robot is sent the team of the division"
            );
        }
    }
}

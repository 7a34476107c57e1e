//! Silhouettes by their definition, in N² steps.

use std::collections::BTreeMap;

use muster_model::audit::{Audit, SilhouetteReport};
use muster_model::embedding::Embedding;
use muster_model::id::{RobotId, TeamId};
use muster_model::roster::Roster;
use muster_model::teams::Teams;

use super::{Oracle, Verified, breach};

/// How far an audit may be from the definition, since the two add up in another order.
const TOLERANCE: f64 = 1e-7;

/// How far a distance may be off, as a share of the largest: the auditor counts coordinates from their mean, which rounds off
/// the last digits of the distance between robots that are close to each other.
const DISTANCE_ROUNDING: f64 = 16.0 * f64::EPSILON;

/// Up to which share of the largest distance a distance is rounding.
const SAME_PLACE: f64 = 1e-12;

/// A robot with its team and its place.
type Point<'a> = (&'a RobotId, &'a TeamId, Vec<f64>);

/// An audit is that of the division and embedding that it names, to the definition.
pub(crate) fn check(audit: &Audit, oracle: &Oracle) -> Verified {
    let name = format!("audit {:?} of division {:?}", audit.header.revision, audit.teams);
    for report in [&audit.in_embedding, &audit.in_physical] {
        let numbers = report.per_robot.iter().map(|(_, s)| *s);
        let numbers = numbers.chain(report.per_team.iter().map(|(_, s)| *s)).chain(report.mean);
        if let Some(wrong) = { numbers }.find(|s| !(-1.0..=1.0).contains(s)) {
            return breach("silhouettes are between -1 and 1", format!("{name}: {wrong}"));
        }
    }
    let divisions = oracle.divisions.named(audit.teams);
    let embeddings = oracle.embeddings.named(audit.embedding);
    if !divisions.iter().any(|teams| teams.embedding == audit.embedding) || embeddings.is_empty() {
        return breach(
            "every audit names a division and its embedding that were published",
            format!("{name}, embedding {:?}", audit.embedding),
        );
    }
    let by_vectors = divisions
        .iter()
        .any(|teams| embeddings.iter().any(|e| agrees(&audit.in_embedding, &vectors(teams, e))));
    if !by_vectors {
        let wanted = divisions.first().zip(embeddings.first()).map(|(t, e)| scores(&vectors(t, e)));
        return breach(
            "silhouettes are those of the definition",
            format!("{name}: {:?}, by the definition {wanted:?}", audit.in_embedding),
        );
    }
    // An audit may use a newer roster than the embedding, where that one did not come, and none
    // as long as none has come; once all agree, it must be the last.
    let exact = embeddings.iter().flat_map(|embedding| oracle.rosters.named(embedding.roster));
    let by_positions = exact.chain(oracle.rosters.newest_first()).any(|roster| {
        divisions.iter().any(|teams| agrees(&audit.in_physical, &positions(teams, roster)))
    }) || agrees(&audit.in_physical, &[]);
    if !by_positions {
        return breach(
            "silhouettes among positions are those of some roster",
            format!("{name}: {:?}", audit.in_physical),
        );
    }
    Ok(())
}

/// Whether an audit of a division follows the definition, with the positions in a roster.
pub(crate) fn is_of_positions(audit: &Audit, teams: &Teams, roster: &Roster) -> bool {
    agrees(&audit.in_physical, &positions(teams, roster))
}

fn vectors<'a>(teams: &'a Teams, embedding: &Embedding) -> Vec<Point<'a>> {
    let dimension = embedding.dimension as usize;
    let place = |robot: &RobotId| {
        let row = embedding.robots.iter().position(|other| other == robot)?;
        Some(embedding.values[row * dimension..(row + 1) * dimension].to_vec())
    };
    points(teams, place)
}

/// Positions in the frame that most of the robots with a team use, the first by name among equals.
fn positions<'a>(teams: &'a Teams, roster: &Roster) -> Vec<Point<'a>> {
    let entry = |robot: &RobotId| roster.robots.iter().find(|entry| entry.robot == *robot);
    let mut frames: BTreeMap<Option<&str>, usize> = BTreeMap::new();
    for team in &teams.teams {
        for entry in team.members.iter().filter_map(|member| entry(&member.robot)) {
            if entry.position.is_some() {
                *frames.entry(entry.frame.as_deref()).or_default() += 1;
            }
        }
    }
    let most = frames.values().copied().max().unwrap_or(0);
    let frame = frames.iter().find(|(_, count)| **count == most).map(|(frame, _)| *frame);
    points(teams, |robot| {
        let entry = entry(robot)?;
        let position = entry.position?;
        (Some(entry.frame.as_deref()) == frame).then(|| position.to_vec())
    })
}

fn points<'a>(teams: &'a Teams, place: impl Fn(&RobotId) -> Option<Vec<f64>>) -> Vec<Point<'a>> {
    let mut points: Vec<_> = teams
        .teams
        .iter()
        .flat_map(|team| team.members.iter().map(move |member| (&member.robot, &team.id)))
        .filter_map(|(robot, team)| Some((robot, team, place(robot)?)))
        .collect();
    points.sort_by(|left, right| left.0.cmp(right.0));
    points
}

fn distance(left: &[f64], right: &[f64]) -> f64 {
    left.iter().zip(right).map(|(l, r)| (l - r) * (l - r)).sum::<f64>().sqrt()
}

/// (b − a) / max(a, b) of each point: a is the mean distance to the others of its team, b the least
/// mean distance to another team. A robot alone in its team has 0, and so has one that differs from both by rounding alone. None
/// with fewer than two teams. The second number is how far an audit may be from the first.
fn scores(points: &[Point<'_>]) -> Option<Vec<(f64, f64)>> {
    let mut teams: Vec<_> = points.iter().map(|point| point.1).collect();
    teams.sort();
    teams.dedup();
    if teams.len() < 2 {
        return None;
    }
    let mean_to = |from: usize, team: &TeamId| {
        let others = points.iter().enumerate().filter(|(at, p)| *at != from && p.1 == team);
        let distances: Vec<f64> = others.map(|(_, p)| distance(&p.2, &points[from].2)).collect();
        #[expect(clippy::cast_precision_loss, reason = "some robots")]
        let count = distances.len() as f64;
        (!distances.is_empty()).then(|| distances.iter().sum::<f64>() / count)
    };
    let all = points.iter().flat_map(|one| points.iter().map(|other| distance(&one.2, &other.2)));
    let largest = all.fold(0.0, f64::max);
    let score = |at: usize| {
        let Some(own) = mean_to(at, points[at].1) else { return (0.0, TOLERANCE) };
        let others = teams.iter().filter(|team| **team != points[at].1);
        let nearest = others.filter_map(|team| mean_to(at, team)).fold(f64::INFINITY, f64::min);
        let larger = own.max(nearest);
        if larger <= SAME_PLACE * largest {
            return (0.0, TOLERANCE);
        }
        ((nearest - own) / larger, TOLERANCE.max(DISTANCE_ROUNDING * largest / larger))
    };
    Some((0..points.len()).map(score).collect())
}

/// Whether a report follows the definition for these points.
fn agrees(report: &SilhouetteReport, points: &[Point<'_>]) -> bool {
    let Some(scores) = scores(points) else {
        return report.mean.is_none() && report.per_robot.is_empty() && report.per_team.is_empty();
    };
    let near = |left: f64, (right, tolerance): (f64, f64)| (left - right).abs() <= tolerance;
    let mean = |of: &[(f64, f64)]| {
        #[expect(clippy::cast_precision_loss, reason = "some robots")]
        let count = of.len() as f64;
        let (values, tolerances): (Vec<f64>, Vec<f64>) = of.iter().copied().unzip();
        (values.iter().sum::<f64>() / count, tolerances.iter().sum::<f64>() / count)
    };
    let same_robots = report.per_robot.len() == points.len()
        && report
            .per_robot
            .iter()
            .zip(points.iter().zip(&scores))
            .all(|((robot, s), (point, wanted))| robot == point.0 && near(*s, *wanted));
    let same_teams = report.per_team.iter().all(|(team, s)| {
        let of_team: Vec<(f64, f64)> =
            points.iter().zip(&scores).filter(|(p, _)| p.1 == team).map(|(_, s)| *s).collect();
        !of_team.is_empty() && near(*s, mean(&of_team))
    });
    let mut teams: Vec<_> = points.iter().map(|point| point.1).collect();
    teams.sort();
    teams.dedup();
    same_robots
        && same_teams
        && report.per_team.len() == teams.len()
        && report.mean.is_some_and(|m| near(m, mean(&scores)))
}

#[cfg(test)]
mod tests {
    use super::super::samples::{oracle_of_a_divided_fleet, promise};
    use super::*;

    #[test]
    fn what_is_wrong_with_an_audit_is_seen() {
        let oracle = oracle_of_a_divided_fleet();
        let audit = oracle.audits.last().unwrap();
        assert_eq!(check(audit, &oracle), Ok(()));
        let broken = |change: &dyn Fn(&mut Audit)| {
            let mut broken = Audit::clone(audit);
            change(&mut broken);
            promise(check(&broken, &oracle))
        };
        let too_high = |audit: &mut Audit| audit.in_embedding.per_robot[0].1 = 1.5;
        assert_eq!(broken(&too_high), "silhouettes are between -1 and 1");
        assert_eq!(
            broken(&|audit| audit.teams.epoch += 1_000_000),
            "every audit names a division and its embedding that were published"
        );
        let off = |report: &mut SilhouetteReport| {
            let score = &mut report.per_robot[0].1;
            *score += if *score > 0.0 { -1e-3 } else { 1e-3 };
        };
        assert_eq!(
            broken(&|audit| off(&mut audit.in_embedding)),
            "silhouettes are those of the definition"
        );
        assert_eq!(
            broken(&|audit| off(&mut audit.in_physical)),
            "silhouettes among positions are those of some roster"
        );
    }

    #[test]
    fn the_definition_gives_what_is_easily_worked_out() {
        let robots: Vec<RobotId> = ["a", "b", "c"].map(|n| RobotId::new(n).unwrap()).into();
        let teams = [TeamId::numbered(1), TeamId::numbered(2)];
        let points = vec![
            (&robots[0], &teams[0], vec![0.0]),
            (&robots[1], &teams[0], vec![1.0]),
            (&robots[2], &teams[1], vec![4.0]),
        ];
        let scores = scores(&points).unwrap();
        assert!((scores[0].0 - 0.75).abs() < 1e-15);
        assert!((scores[1].0 - 2.0 / 3.0).abs() < 1e-15);
        assert!(scores[2].0.abs() < 1e-15);
        assert!(scores.iter().all(|(_, tolerance)| *tolerance <= TOLERANCE));
        assert_eq!(super::scores(&points[..2]), None);
    }
}

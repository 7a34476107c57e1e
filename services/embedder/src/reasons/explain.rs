//! The job: from the last embedding, the division and the wishes to the reasons of robots.

use std::collections::BTreeMap;

use muster_method::embedding::Frames;
use muster_method::reasons::{Attraction, TeamPull, Vectors};
use muster_model::header::Header;
use muster_model::id::{RobotId, ServiceName, TeamId};
use muster_model::limits::MAX_REASON_TEAMS;
use muster_model::teams::Teams;
use muster_model::time::Tick;
use muster_model::why::{DecidedBy, ModalityPull, Reason, ReasonWish, TeamReason, Why};
use muster_model::wish::{StandingWish, WishKind, WishState};

use super::{Material, Task};

/// What is answered before there is an embedding.
pub(crate) const NO_EMBEDDING: &str = "there is no embedding yet; ask again in a moment";

/// Why there is no reason.
#[derive(Debug)]
pub(crate) enum Unexplained {
    /// There is none yet.
    NotYet(String),
    /// There is none for such a robot.
    Unknown(String),
}

/// Why each robot is in its team, or why there is no answer.
pub(crate) fn explain(
    frames: &Frames,
    vectors: Option<&Vectors>,
    task: &Task,
) -> Vec<Result<Why, Unexplained>> {
    let Some(Vectors { svd, power, rows }) = vectors else {
        let none = |_| Err(Unexplained::NotYet(NO_EMBEDDING.to_owned()));
        return task.robots.iter().map(none).collect();
    };
    let teams = &*task.material.teams;
    let places: BTreeMap<&RobotId, usize> = teams
        .teams
        .iter()
        .enumerate()
        .flat_map(|(number, team)| team.members.iter().map(move |member| (&member.robot, number)))
        .collect();
    let known = frames.robots();
    let labels: Vec<Option<usize>> = known.iter().map(|robot| places.get(robot).copied()).collect();
    // A place that nobody has stands for a robot that is not there.
    let row = |robot: &RobotId| known.binary_search(robot).unwrap_or(usize::MAX);
    let wanted: Vec<usize> = task.robots.iter().map(row).collect();
    let found = frames.attractions(svd, *power, *rows, &wanted, &labels);
    let answer = |(robot, attraction): (&RobotId, Option<Attraction>)| {
        let Some(number) = places.get(robot) else {
            return Err(without_team(robot, task, known.binary_search(robot).is_ok()));
        };
        let team = &teams.teams[*number].id;
        let Some(attraction) = attraction else {
            return Err(Unexplained::Unknown(format!(
                "by the newest graphs nothing relates {robot} to the other robots; its team {team} rests on older ones"
            )));
        };
        let reason = reason(robot, *number, attraction, task);
        Ok(Why { header: task.embedding.header.clone(), reason: reason.decided() })
    };
    task.robots.iter().zip(found).map(answer).collect()
}

/// Why a robot has no team that could be explained.
fn without_team(robot: &RobotId, task: &Task, is_known: bool) -> Unexplained {
    let Material { teams, wishes, .. } = &*task.material;
    if teams.unassigned.binary_search(robot).is_err() {
        return if is_known {
            let problem = "is not in the last division yet; ask again in a moment";
            Unexplained::NotYet(format!("{robot} {problem}"))
        } else {
            let problem = "is not a robot of the fleet; muster status lists the robots";
            Unexplained::Unknown(format!("{robot} {problem}"))
        };
    }
    let keeps = |one: &&StandingWish| {
        let wish = &one.wish;
        wish.kind == WishKind::Reserve && wish.robots.contains(robot) && counts(one)
    };
    if let Some(one) = wishes.iter().find(keeps) {
        let (operator, id) = (&one.operator, &one.id);
        let why = format!("the wish {operator}/{id} keeps it in reserve");
        return Unexplained::Unknown(format!("{robot} is in no team: {why}"));
    }
    let embedding = &*task.embedding;
    let row = embedding.robots.binary_search(robot).ok();
    let is_related =
        row.and_then(|row| embedding.without_embedding.get(row)).is_some_and(|without| !without);
    let conflict = teams.limited.as_ref().and_then(|limited| limited.conflict.as_ref());
    let why = match conflict.filter(|_| is_related) {
        Some(conflict) => format!("the limits leave no place: {conflict}"),
        None => {
            "nothing relates it to the other robots, or only to such as are apart from all teams"
                .to_owned()
        }
    };
    Unexplained::Unknown(format!("{robot} is in no team: {why}"))
}

/// Whether a wish still counts.
fn counts(one: &StandingWish) -> bool {
    !matches!(one.state, WishState::Expired | WishState::Withdrawn)
}

/// The reason of a robot that is in a team, without what decided.
fn reason(robot: &RobotId, own: usize, attraction: Attraction, task: &Task) -> Reason {
    let Material { teams: division, wishes, settings, settings_assumed } = &*task.material;
    let Attraction { length_squared, pulls } = attraction;
    let team = division.teams[own].id.clone();
    let wishes = concerning(robot, &team, wishes);
    let limited = division.limited.as_ref();
    let jointly = limited.is_some_and(|limited| limited.jointly.binary_search(robot).is_ok());
    // No price stands for the place of a robot that is placed together with others.
    let limited = limited.filter(|_| !jointly);
    let skilled = limited.and_then(|limited| {
        limited.skill_prices.iter().find(|of| of.robots.binary_search(robot).is_ok())
    });
    let number_of = |pull: &TeamPull| pull.team;
    let explained = |pull: TeamPull| {
        let number = number_of(&pull);
        let id = division.teams[number].id.clone();
        let limits = settings.size_of(&id);
        let prices = limited.map(|limited| &limited.prices);
        let price = prices.and_then(|prices| prices.get(number)).copied().unwrap_or(0.0);
        let distance = (length_squared - pull.score).max(0.0);
        let hysteresis = if number == own { settings.hysteresis * distance } else { 0.0 };
        let modalities = pull.modalities.into_iter();
        TeamReason {
            robots: u32::try_from(division.teams[number].members.len()).unwrap_or(u32::MAX),
            max: limits.max,
            min: limits.least(),
            barred: number != own && is_barred(&id, &wishes),
            score: pull.score,
            modalities: modalities
                .map(|(modality, pull)| ModalityPull { modality, pull })
                .collect(),
            itself: pull.itself,
            spread: pull.spread,
            rest: pull.rest,
            price,
            hysteresis,
            total: 0.0,
            skill_price: skilled.and_then(|of| of.prices.get(number)).copied().unwrap_or(0.0),
            team: id,
        }
        .summed()
    };
    let mut teams: Vec<TeamReason> = pulls.into_iter().map(explained).collect();
    teams.sort_by(|left, right| {
        let others = |reason: &TeamReason| reason.team != team;
        others(left).cmp(&others(right)).then(right.total.total_cmp(&left.total))
    });
    teams.truncate(MAX_REASON_TEAMS);
    let held = division.held.iter().find(|held| held.robot == *robot);
    Reason {
        robot: robot.clone(),
        decided_by: DecidedBy::Relations,
        text: String::new(),
        division: division.header.revision,
        older_s: older(division, task),
        provisional: division.provisional.binary_search(robot).is_ok(),
        held_from: held.map(|held| held.team.clone()),
        length_squared,
        teams,
        wishes,
        hysteresis: settings.hysteresis,
        dwell_s: settings.dwell_s,
        conflict: division.limited.as_ref().and_then(|limited| limited.conflict.clone()),
        skill: skilled.map(|of| of.skill.clone()),
        jointly,
        settings_assumed: *settings_assumed,
        team,
    }
}

/// The wishes that concern a robot in a team.
fn concerning(robot: &RobotId, team: &TeamId, wishes: &[StandingWish]) -> Vec<ReasonWish> {
    let concerns = |one: &&StandingWish| {
        let is_lock = one.wish.kind == WishKind::Lock && one.wish.team.as_ref() == Some(team);
        counts(one) && (is_lock || one.wish.robots.contains(robot))
    };
    let wish = |one: &StandingWish| ReasonWish {
        operator: one.operator.clone(),
        id: one.id.clone(),
        kind: one.wish.kind,
        team: one.wish.team.clone(),
        granted: one.state == WishState::Active,
    };
    wishes.iter().filter(concerns).map(wish).collect()
}

/// Whether a wish keeps the robot out of a team that is not its own.
fn is_barred(team: &TeamId, wishes: &[ReasonWish]) -> bool {
    wishes.iter().filter(|wish| wish.granted).any(|wish| match wish.kind {
        // Both name the team of the robot, which is another one.
        WishKind::Pin | WishKind::Lock => true,
        WishKind::Ban => wish.team.as_ref() == Some(team),
        WishKind::Together | WishKind::Apart | WishKind::Reserve => false,
    })
}

/// By how many seconds the division is older than the embedding; none if it rests on the same vectors.
fn older(division: &Teams, task: &Task) -> Option<f64> {
    if division.embedding >= task.since {
        return None;
    }
    let embedded = |header: &Header| -> Option<Tick> {
        let stage = header.stages.iter().rfind(|time| time.stage == ServiceName::Embedder)?;
        Some(stage.published)
    };
    let (new, old) = (embedded(&task.embedding.header), embedded(&division.header));
    let older = new.zip(old).map(|(new, old)| new.since(old).as_secs_f64());
    Some(older.unwrap_or_default())
}

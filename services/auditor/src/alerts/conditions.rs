//! What is observed of teams, modalities and the fleet that may raise an alert.

use muster_model::alert::{AlertKind, AlertSubject};
use muster_model::embedding::EmbeddingGraph;
use muster_model::id::RobotId;
use muster_model::settings::AuditorSettings;
use muster_model::team_audit::TeamAudit;
use muster_model::teams::{Limited, Team, Teams};

use super::{Condition, Wanted};

/// Trust above which an alert of a modality in doubt ends: as the embedder has it for its events.
const TRUSTED_ABOVE: f64 = 0.8;

/// What is observed of one kind.
pub(crate) struct Observed {
    pub(crate) kind: AlertKind,
    pub(crate) conditions: Vec<Condition>,
}

/// What is observed of all teams. Where no links are known, nothing is said of them, and what is open stays open.
pub(crate) fn of_teams(
    audits: &[TeamAudit],
    teams: &Teams,
    settings: &AuditorSettings,
) -> Vec<Observed> {
    let all = || audits.iter().zip(&teams.teams);
    let observed = |kind, of: &dyn Fn(&TeamAudit, &Team) -> Option<Condition>| Observed {
        kind,
        conditions: all().filter_map(|(audit, team)| of(audit, team)).collect(),
    };
    let mut found = vec![
        observed(AlertKind::Poor, &|audit, _| poor(audit, settings)),
        observed(AlertKind::Leaderless, &|audit, team| Some(leaderless(audit, team))),
        observed(AlertKind::Singleton, &|audit, team| {
            Some(singleton(audit, team, audits.len(), settings))
        }),
        observed(AlertKind::Stale, &|audit, team| Some(stale(audit, team, teams, settings))),
        observed(AlertKind::Lacking, &|audit, _| Some(lacking(audit, teams))),
    ];
    // Without a link in the whole fleet nothing is known of any team; alerts of teams that are gone end all the same.
    let is_known = audits.iter().any(|audit| audit.radio.is_some());
    found.push(observed(AlertKind::CutOff, &|audit, _| {
        if is_known { cut_off(audit, settings) } else { Some(unknown(audit)) }
    }));
    found.push(observed(AlertKind::Fragile, &|audit, _| {
        if is_known { fragile(audit, settings) } else { Some(unknown(audit)) }
    }));
    found
}

/// A team of which nothing is known: an open alert stays open, and none is raised.
fn unknown(audit: &TeamAudit) -> Condition {
    Condition {
        subject: subject(audit),
        wanted: Wanted::Neither,
        value: 0.0,
        threshold: 0.0,
        reason: String::new(),
        robots: Vec::new(),
    }
}

fn subject(audit: &TeamAudit) -> AlertSubject {
    AlertSubject::Team(audit.team.clone())
}

fn poor(audit: &TeamAudit, settings: &AuditorSettings) -> Option<Condition> {
    let (value, threshold) = (audit.silhouette?, settings.team_poor);
    let least = audit.least.as_ref();
    let named = least.map(|least| format!("; {} fits least", least.robot)).unwrap_or_default();
    Some(Condition {
        subject: subject(audit),
        wanted: Wanted::below(value, threshold, threshold + settings.alert_clearance),
        value,
        threshold,
        reason: format!("{} has a mean silhouette of {value:.2}{named}", audit.team),
        robots: least.map(|least| least.robot.clone()).into_iter().collect(),
    })
}

fn leaderless(audit: &TeamAudit, team: &Team) -> Condition {
    Condition {
        subject: subject(audit),
        wanted: Wanted::of(audit.leader_stale),
        value: f64::from(u8::from(audit.leader_stale)),
        threshold: 1.0,
        reason: format!("{}, which leads {}, is silent", team.leader, audit.team),
        robots: vec![team.leader.clone()],
    }
}

fn singleton(
    audit: &TeamAudit,
    team: &Team,
    teams: usize,
    settings: &AuditorSettings,
) -> Condition {
    let robots = if audit.robots == 1 { "robot" } else { "robots" };
    Condition {
        subject: subject(audit),
        wanted: Wanted::of(teams > 1 && audit.robots <= settings.singleton),
        value: f64::from(audit.robots),
        threshold: f64::from(settings.singleton),
        reason: format!("{} has {} {robots}", audit.team, audit.robots),
        robots: members(team),
    }
}

fn stale(audit: &TeamAudit, team: &Team, teams: &Teams, settings: &AuditorSettings) -> Condition {
    let value = f64::from(audit.stale) / f64::from(audit.robots.max(1));
    let threshold = settings.stale_share;
    let is_stale = |robot: &RobotId| teams.stale.binary_search(robot).is_ok();
    Condition {
        subject: subject(audit),
        wanted: Wanted::above(value, threshold, threshold * settings.alert_release),
        value,
        threshold,
        reason: format!("{} of {} robots of {} are silent", audit.stale, audit.robots, audit.team),
        robots: members(team).into_iter().filter(is_stale).collect(),
    }
}

fn cut_off(audit: &TeamAudit, settings: &AuditorSettings) -> Option<Condition> {
    let radio = audit.radio.as_ref()?;
    let there = audit.robots.saturating_sub(audit.stale);
    Some(Condition {
        subject: subject(audit),
        wanted: Wanted::of(radio.parts >= settings.cut_off_parts),
        value: f64::from(radio.parts),
        threshold: f64::from(settings.cut_off_parts),
        reason: format!(
            "no link joins the {} parts of {}; its leader reaches {} of {there} robots",
            radio.parts, audit.team, radio.reached_by_leader
        ),
        robots: Vec::new(),
    })
}

fn fragile(audit: &TeamAudit, settings: &AuditorSettings) -> Option<Condition> {
    let radio = audit.radio.as_ref()?;
    let (value, threshold) = (radio.worst_cut, settings.fragile);
    let worst = radio.cut_robots.first();
    let named = worst.map_or_else(String::new, ToString::to_string);
    Some(Condition {
        subject: subject(audit),
        wanted: Wanted::above(value, threshold, threshold * settings.alert_release),
        value,
        threshold,
        reason: format!(
            "without {named}, {:.0} % of the other robots of {} are cut off",
            value * 100.0,
            audit.team
        ),
        robots: radio.cut_robots.clone(),
    })
}

/// Robots that a team lacks of the skills that it needs, by what the division says of itself.
fn lacking(audit: &TeamAudit, teams: &Teams) -> Condition {
    let needs = teams.needs.iter().filter(|need| need.team == audit.team && need.lacks() > 0);
    let (mut missing, mut words) = (0, Vec::new());
    for need in needs {
        missing += need.lacks();
        words.push(format!("{} of {} with {}", need.have, need.min, need.skill));
    }
    Condition {
        subject: subject(audit),
        wanted: Wanted::of(missing > 0),
        value: f64::from(missing),
        threshold: 1.0,
        reason: format!("{} has {}", audit.team, words.join(", ")),
        robots: Vec::new(),
    }
}

/// Whether anything satisfies the limits and wishes, by what the division says of itself: 1 while the last one stands, less
/// while it goes on and lacks what it needs.
pub(crate) fn infeasible(teams: &Teams) -> Condition {
    let limited = teams.limited.as_ref();
    let conflict = limited.and_then(|limited| limited.conflict.as_ref());
    let stands = limited.is_some_and(Limited::stands);
    let value = match conflict {
        None => 0.0,
        Some(_) if stands => 1.0,
        Some(_) => 0.5,
    };
    Condition {
        subject: AlertSubject::Fleet,
        wanted: Wanted::of(conflict.is_some()),
        value,
        threshold: 0.5,
        reason: conflict.cloned().unwrap_or_default(),
        robots: Vec::new(),
    }
}

fn members(team: &Team) -> Vec<RobotId> {
    team.members.iter().map(|member| member.robot.clone()).collect()
}

/// What is observed of the modalities of an embedding.
pub(crate) fn of_modalities(graphs: &[EmbeddingGraph]) -> Observed {
    let condition = |graph: &EmbeddingGraph| {
        let (value, threshold) = (graph.trust, EmbeddingGraph::DOUBTED_BELOW);
        Condition {
            subject: AlertSubject::Modality(graph.modality.clone()),
            wanted: Wanted::below(value, threshold, TRUSTED_ABOVE),
            value,
            threshold,
            reason: format!(
                "{} contradicts the other modalities: {:.0} % of its weight is used",
                graph.modality,
                value * 100.0
            ),
            robots: Vec::new(),
        }
    };
    let conditions = graphs.iter().map(condition).collect();
    Observed { kind: AlertKind::ModalityDoubted, conditions }
}

/// What is observed of the rate at which robots change teams.
pub(crate) fn of_churn(changes_per_robot_minute: f64, settings: &AuditorSettings) -> Condition {
    let (value, threshold) = (changes_per_robot_minute, settings.churn);
    let wanted = match value {
        _ if threshold > 0.0 && value >= threshold => Wanted::Raise,
        _ if value <= threshold * settings.alert_release => Wanted::Clear,
        _ => Wanted::Neither,
    };
    Condition {
        subject: AlertSubject::Fleet,
        wanted,
        value,
        threshold,
        reason: format!("robots change teams {value:.2} times per robot and minute"),
        robots: Vec::new(),
    }
}

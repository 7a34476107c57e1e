//! What is wrong with the reports of robots, and with the division that rests on them.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use muster_model::event::EventKind;
use muster_model::id::{RobotId, ServiceName};
use muster_model::roster::{Presence, Roster};
use muster_model::settings::IngestSettings;
use muster_model::status::ServiceStatus;
use muster_wire::message::{plain_reason, quoted};

use super::{Finding, Severity, error, finding, warning};
use crate::doctor::look::Look;
use crate::show::page::names;

/// Older data than this behind a division: a pose is a tick old, and every stage takes less.
const DATA_OLD_S: f64 = 3.0;

/// How long a service must have run before what it has never received counts as missing.
const SETTLED_AFTER: Duration = Duration::from_secs(10);

fn settled(status: &ServiceStatus) -> bool {
    status.now.since(status.started) >= SETTLED_AFTER
}

pub(super) fn robots(look: &Look) -> Vec<Finding> {
    let mut found = Vec::new();
    let unserved = look.others.iter().filter(|other| other.robots > 0 && other.services == 0);
    let unserved: Vec<_> = unserved.collect();
    if !unserved.is_empty() {
        let all = unserved
            .iter()
            .map(|other| format!("{} robots of fleet {}", other.robots, other.fleet));
        let all: Vec<_> = all.collect();
        found.push(
            warning(
                "robots_elsewhere",
                format!("no service serves {}", all.join(", ")),
                format!(
                    "let them put under muster/v1/{}/, or start services with --fleet",
                    look.fleet
                ),
            )
            .about(unserved.iter().map(|other| &other.fleet)),
        );
    }
    let Some(ingest) = look.status(ServiceName::Ingest) else { return found };
    let Some(roster) = &look.roster else { return found };
    found.extend(unknown(&look.robot_tokens, roster, look.ingest.as_ref()));
    if roster.robots.is_empty() {
        if look.robot_tokens.is_empty() {
            found.push(error(
                "no_robots",
                format!("no robot of fleet {} is known, and none has a token", look.fleet),
                format!(
                    "start robots that put poses under muster/v1/{}/robot/{{robot}}/pose, or try \
                     `muster robot`; a robot behind access control needs put on its own keys",
                    look.fleet
                ),
            ));
        }
        return found;
    }
    let placeless = roster.robots.iter().filter(|entry| entry.position.is_none());
    let placeless: Vec<_> = placeless.map(|entry| &entry.robot).collect();
    if !placeless.is_empty() {
        let all = placeless.len() == roster.robots.len();
        let severity = if all { Severity::Error } else { Severity::Warning };
        found.push(
            finding(
                "no_poses",
                severity,
                format!(
                    "{} of {} robots have no position: {}",
                    placeless.len(),
                    roster.robots.len(),
                    names(placeless.iter())
                ),
                "they must put poses on robot/{robot}/pose; see `refused` below if they do. A robot \
                 that relates to others by links or ranks alone needs none",
            )
            .about(placeless),
        );
    }
    let stale = roster.robots.iter().filter(|entry| entry.presence == Presence::Stale);
    let stale: Vec<_> = stale.collect();
    if !stale.is_empty() {
        let shown: Vec<_> = stale
            .iter()
            .map(|entry| {
                let silent = ingest.now.since(entry.last_seen).as_secs();
                format!("{} (silent for {silent} s)", entry.robot)
            })
            .collect();
        found.push(
            warning(
                "robots_stale",
                format!(
                    "{} of {} robots are stale: {}",
                    stale.len(),
                    roster.robots.len(),
                    names(shown.iter())
                ),
                "check their radio and their software; raise stale_after_s of ingest if they report \
                 more rarely than that on purpose",
            )
            .about(stale.iter().map(|entry| &entry.robot)),
        );
    }
    let links = ingest.counters.get("links_accepted").copied().unwrap_or_default();
    if links == 0 && roster.robots.len() > 1 && settled(ingest) {
        found.push(warning(
            "no_links",
            "no robot has reported links since ingest started",
            "let robots put the robots that they receive on robot/{robot}/links; where the radio does not \
             report them, give connectivity no weight: muster set embedder 'weights={\"spatial\":0.5,\"hierarchy\":0.5}'",
        ));
    }
    found
}

/// Robots that have a token and are not in the roster.
fn unknown(
    tokens: &BTreeSet<RobotId>,
    roster: &Roster,
    ingest: Option<&IngestSettings>,
) -> Option<Finding> {
    let known: BTreeSet<_> = roster.robots.iter().map(|entry| &entry.robot).collect();
    let unknown: Vec<_> = tokens.iter().filter(|robot| !known.contains(robot)).collect();
    if unknown.is_empty() {
        return None;
    }
    let most = ingest.map(|settings| settings.max_robots);
    let full = most.filter(|most| roster.robots.len() >= *most as usize);
    let full = full.map_or_else(String::new, |most| {
        format!("the fleet is full: raise max_robots of ingest ({most}) if they belong to it; ")
    });
    let gone_after = ingest.map(|settings| format!(" ({} s)", settings.gone_after_s));
    let remedy = format!(
        "{full}a robot with a token that has put nothing for gone_after_s{} has left: restart its \
         software; if it does put, access control keeps ingest from seeing its token",
        gone_after.unwrap_or_default()
    );
    let seen = format!("robots with a token that ingest does not know: {}", names(unknown.iter()));
    Some(error("robots_unknown", seen, remedy).about(unknown))
}

pub(super) fn refused(look: &Look) -> Option<Finding> {
    let mut by: BTreeMap<(String, String), u64> = BTreeMap::new();
    for event in &look.events {
        if let EventKind::Quarantined { robot, key, reason, count } = &event.kind {
            let who = robot.as_ref().map_or_else(|| quoted(key), ToString::to_string);
            *by.entry((who, plain_reason(reason))).or_default() += count;
        }
    }
    if by.is_empty() {
        return None;
    }
    let shown: Vec<_> = by
        .iter()
        .map(|((who, reason), count)| format!("{who}: {reason} ({count} times)"))
        .collect();
    let who: BTreeSet<_> = by.keys().map(|(who, _)| who).collect();
    Some(
        warning(
            "refused",
            format!(
                "messages were refused in {:.0} s: {}",
                look.listened.as_secs_f64(),
                names(shown.iter())
            ),
            "correct what these robots put; each reason names the field and what would be right",
        )
        .about(who),
    )
}

pub(super) fn teams(look: &Look) -> Vec<Finding> {
    let mut found = Vec::new();
    let robots = look.roster.as_ref().map_or(0, |roster| roster.robots.len());
    if let Some(settings) = &look.clusterer
        && robots > 0
        && let least = *settings.teams.range().start()
        && least as usize > robots
    {
        found.push(warning(
            "too_many_teams",
            format!("{least} teams are asked for, and there are {robots} robots"),
            format!("ask for fewer: muster set clusterer teams={robots}"),
        ));
    }
    let Some(teams) = &look.teams else {
        let clusterer = look.status(ServiceName::Clusterer);
        if robots > 1 && clusterer.is_some_and(settled) {
            found.push(error(
                "no_teams",
                format!("there are {robots} robots and no division of them"),
                "`muster status` shows what each service waits for; `muster graph` shows whether \
                 anything relates the robots",
            ));
        }
        return found;
    };
    if !teams.unassigned.is_empty() {
        found.push(
            warning(
                "no_team",
                format!("robots in no team: {}", names(teams.unassigned.iter())),
                "nothing relates them to the others: they need poses in the frame of the others, links \
                 or ranks; `muster graph` shows the relations",
            )
            .about(&teams.unassigned),
        );
    }
    let active = look.roster.iter().flat_map(|roster| &roster.robots);
    let active = active.filter(|entry| entry.presence == Presence::Active).count();
    // Ages are computed by the clock of the clusterer, where it is known: ours may differ.
    let now = look.status(ServiceName::Clusterer).map_or(look.now, |status| status.now);
    if let Some(age) = teams.header.data_age_s(now).filter(|age| active > 0 && *age >= DATA_OLD_S) {
        found.push(warning(
            "data_old",
            format!("the division rests on poses that are {age:.1} s old"),
            "a service on the way hangs, is overloaded, or computes longer than a tick: see the stages \
             in `muster teams --json`, and muster_stage_seconds and muster_job_seconds at /metrics",
        ));
    }
    found
}

#[cfg(test)]
mod tests {
    use muster_model::header::{Header, Revision};
    use muster_model::id::FleetId;
    use muster_model::roster::RosterEntry;
    use muster_model::time::Tick;

    use super::*;

    fn robot(name: &str) -> RobotId {
        RobotId::new(name).unwrap()
    }

    fn roster(names: &[&str]) -> Roster {
        let entry =
            |(node, name): (u32, &&str)| RosterEntry::active(node, robot(name), Tick::default());
        let header = Header {
            fleet: FleetId::new("f").unwrap(),
            revision: Revision::default(),
            oldest: None,
            newest: None,
            stages: Vec::new(),
        };
        Roster { header, robots: (0..).zip(names).map(entry).collect(), graphs: Vec::new() }
    }

    #[test]
    fn a_fleet_is_called_full_only_if_it_is() {
        let tokens = ["r1", "r2", "x"].map(robot).into();
        let settings = IngestSettings { max_robots: 2, ..IngestSettings::default() };
        let remedy = |names: &[&str], settings: Option<&IngestSettings>| {
            unknown(&tokens, &roster(names), settings).unwrap().remedy
        };
        let full = remedy(&["r1", "r2"], Some(&settings));
        assert!(full.starts_with("the fleet is full: raise max_robots of ingest (2)"), "{full}");
        for hangs in [remedy(&["r1"], Some(&settings)), remedy(&["r1", "r2"], None)] {
            assert!(!hangs.contains("full") && hangs.contains("restart its software"), "{hangs}");
        }
        assert!(remedy(&["r1"], Some(&settings)).contains("gone_after_s (10 s)"));
        assert!(unknown(&tokens, &roster(&["r1", "r2", "x"]), None).is_none());
    }
}

//! What is wrong, judging by what was seen, and what to do about it.

mod division;
mod robots;
mod ros;
mod router;
mod services;

use muster_model::replay::is_replay;
use serde::Serialize;

pub(super) use self::ros::{RosPrograms, unannounced};
pub(super) use self::router::{of_endpoint, session};
use super::look::Look;
use crate::show::page::names;

/// Most things that a finding names one by one.
const MAX_SUBJECTS: usize = 100;

/// How much a finding matters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Severity {
    /// Nothing is wrong, unless an operator knows better.
    Note,
    /// It works, but not as it should.
    Warning,
    /// Something does not work.
    Error,
}

/// One thing that is wrong.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Finding {
    /// A name that stays the same, for scripts.
    pub(super) id: &'static str,
    pub(super) severity: Severity,
    /// What was seen.
    pub(super) seen: String,
    /// What to do.
    pub(super) remedy: String,
    /// What it concerns: robots, services, endpoints.
    pub(super) subjects: Vec<String>,
}

fn finding(
    id: &'static str,
    severity: Severity,
    seen: impl Into<String>,
    remedy: impl Into<String>,
) -> Finding {
    Finding { id, severity, seen: seen.into(), remedy: remedy.into(), subjects: Vec::new() }
}

impl Finding {
    fn about<T: ToString>(mut self, subjects: impl IntoIterator<Item = T>) -> Self {
        self.subjects = subjects.into_iter().take(MAX_SUBJECTS).map(|s| s.to_string()).collect();
        self
    }
}

fn error(id: &'static str, seen: impl Into<String>, remedy: impl Into<String>) -> Finding {
    finding(id, Severity::Error, seen, remedy)
}

fn warning(id: &'static str, seen: impl Into<String>, remedy: impl Into<String>) -> Finding {
    finding(id, Severity::Warning, seen, remedy)
}

/// Everything that is wrong with a fleet.
pub(super) fn of_fleet(look: &Look) -> Vec<Finding> {
    let mut found: Vec<_> = ros::old_routers(&look.routers).into_iter().collect();
    if look.instances.is_empty()
        && look.tokens.is_empty()
        && let Some(wrong) = wrong_fleet(look)
    {
        // Nothing else can be found in a fleet that is not there.
        found.push(wrong);
        return found;
    }
    found.extend(replay(look));
    found.extend(services::services(look));
    found.extend(services::denied(look));
    found.extend(services::clocks(look));
    found.extend(services::state(look));
    found.extend(robots::robots(look));
    found.extend(robots::refused(look));
    found.extend(ros::refused_topics(&look.bridges));
    found.extend(services::jobs(look));
    found.extend(robots::teams(look));
    found.extend(division::division(look));
    found
}

/// What is seen is no live fleet.
fn replay(look: &Look) -> Option<Finding> {
    is_replay(&look.fleet).then(|| {
        warning(
            "replay",
            format!("fleet {} is a recording that is played, and no live fleet", look.fleet),
            "name the live fleet with --fleet; `muster replay` ends with Ctrl-C where it runs",
        )
        .about([&look.fleet])
    })
}

fn wrong_fleet(look: &Look) -> Option<Finding> {
    if look.others.is_empty() || !look.robot_tokens.is_empty() {
        return None;
    }
    let fleets: Vec<_> = look.others.iter().map(|other| &other.fleet).collect();
    let named = names(fleets.iter());
    Some(
        error(
            "wrong_fleet",
            format!("nothing is on the bus for fleet {}, but for {named}", look.fleet),
            format!("name the fleet that is meant: --fleet {}", fleets[0]),
        )
        .about(&fleets),
    )
}

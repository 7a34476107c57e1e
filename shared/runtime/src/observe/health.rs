//! When a service is alive and when it is ready. The two are not the same: a service that has lost its
//! router is alive, waits, and goes on by itself; to restart it would only lose what it knows.

use std::time::Duration;

use muster_model::id::ServiceName;
use muster_model::role::ReplicaState;

/// How long the loop of a service may take for one round. Nothing in it waits; the longest events take
/// milliseconds, and a machine that is busy with other things delays them by less than this.
pub(super) const LOOP_HANGS_AFTER: Duration = Duration::from_secs(5);

/// How long the roster may be silent, which comes every second.
const ROSTER_SILENT_AFTER: Duration = Duration::from_secs(5);

/// How long what is computed from it may be silent while there are robots: a large fleet takes longer
/// than a second.
const RESULT_SILENT_AFTER: Duration = Duration::from_secs(10);

/// How long every job must have failed, without one that has not: the same frame is tried again a second after
/// a panic, and one frame that cannot be embedded is followed by others within a moment.
const JOBS_FAILING_AFTER: Duration = Duration::from_secs(2);

/// What is known of a service at one moment.
#[derive(Debug, Clone, Default)]
pub(super) struct Look {
    /// Since when the loop has not turned; none while it does not run.
    pub(super) since_turn: Option<Duration>,
    /// Whether the router is linked; none while it has never been.
    pub(super) link: Option<bool>,
    /// Where it stands towards its role.
    pub(super) standing: ReplicaState,
    /// Since when the link has been up.
    pub(super) linked_for: Duration,
    /// Since when nothing has come of what it reads; none if nothing ever has.
    pub(super) since_roster: Option<Duration>,
    pub(super) since_embedding: Option<Duration>,
    pub(super) since_teams: Option<Duration>,
    /// How long the roster has had robots, without a break.
    pub(super) peopled_for: Option<Duration>,
    /// How long every job has failed, and why the last one did; none if the last one has not.
    pub(super) jobs_failing: Option<(Duration, String)>,
}

/// Whether the loop of a service runs. One that still waits for its router has none that could hang.
pub(super) fn is_alive(look: &Look) -> bool {
    loop_runs(look.since_turn)
}

/// Whether a loop runs that last turned so long ago; none for one that has not begun, and cannot hang.
pub(super) fn loop_runs(since_turn: Option<Duration>) -> bool {
    since_turn.is_none_or(|since| since < LOOP_HANGS_AFTER)
}

/// Why a service is not ready; nothing if it is.
pub(super) fn reasons(service: ServiceName, look: &Look) -> Vec<String> {
    let mut reasons = Vec::new();
    if !is_alive(look) {
        reasons.push(format!("the loop has not turned for {}", seconds(look.since_turn)));
    }
    match look.link {
        None => reasons.push("no router has answered yet".to_owned()),
        Some(false) => reasons.push("the link to the router is lost".to_owned()),
        Some(true) => {}
    }
    if !reasons.is_empty() {
        // Everything else follows from these.
        return reasons;
    }
    match look.standing {
        ReplicaState::Leading | ReplicaState::Standby => {}
        ReplicaState::Starting => reasons.push("the term has not begun".to_owned()),
        ReplicaState::Suspect => {
            reasons.push("it is not certain whether another instance has taken over".to_owned());
        }
    }
    if let Some((lasting, reason)) = &look.jobs_failing
        && *lasting >= JOBS_FAILING_AFTER
    {
        reasons.push(format!("every job has failed for {}: {reason}", seconds(Some(*lasting))));
    }
    if matches!(service, ServiceName::Ingest | ServiceName::Historian) {
        // A fleet without robots, or of which nothing is heard, is no fault of the service that waits for it.
        return reasons;
    }
    let silent = |since: Option<Duration>, limit: Duration, begun: Duration| {
        // What came before the link was lost proves nothing about now.
        since.unwrap_or(begun).min(begun) >= limit
    };
    let mut report = |what: &str, source: ServiceName, since: Option<Duration>| {
        reasons.push(match since {
            Some(_) => format!("{what} has come from {source} for {}", seconds(since)),
            None => format!("{what} has ever come from {source}"),
        });
    };
    if silent(look.since_roster, ROSTER_SILENT_AFTER, look.linked_for) {
        report("no roster", ServiceName::Ingest, look.since_roster);
        return reasons;
    }
    let Some(peopled) = look.peopled_for else { return reasons };
    let begun = peopled.min(look.linked_for);
    if service != ServiceName::Embedder && silent(look.since_embedding, RESULT_SILENT_AFTER, begun)
    {
        report("no embedding", ServiceName::Embedder, look.since_embedding);
    } else if matches!(service, ServiceName::Auditor | ServiceName::Planner)
        && silent(look.since_teams, RESULT_SILENT_AFTER, begun)
    {
        report("no division", ServiceName::Clusterer, look.since_teams);
    }
    reasons
}

fn seconds(duration: Option<Duration>) -> String {
    format!("{} s", duration.unwrap_or_default().as_secs())
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: Duration = Duration::from_secs(1);

    fn well() -> Look {
        Look {
            since_turn: Some(S / 10),
            link: Some(true),
            standing: ReplicaState::Leading,
            linked_for: 100 * S,
            since_roster: Some(S),
            since_embedding: Some(S),
            since_teams: Some(S),
            peopled_for: Some(100 * S),
            jobs_failing: None,
        }
    }

    fn reason(service: ServiceName, look: &Look) -> String {
        reasons(service, look).join("; ")
    }

    #[test]
    fn a_service_is_ready_as_holder_and_as_standby() {
        for standing in [ReplicaState::Leading, ReplicaState::Standby] {
            for service in ServiceName::ALL {
                assert_eq!(reason(service, &Look { standing, ..well() }), "");
            }
        }
        for standing in [ReplicaState::Starting, ReplicaState::Suspect] {
            assert_ne!(reason(ServiceName::Ingest, &Look { standing, ..well() }), "");
        }
    }

    #[test]
    fn a_lost_router_takes_readiness_and_not_life() {
        for link in [None, Some(false)] {
            let look = Look { link, ..well() };
            assert!(is_alive(&look));
            assert!(reason(ServiceName::Ingest, &look).contains("router"));
        }
    }

    #[test]
    fn a_loop_that_hangs_takes_both_and_one_that_has_not_begun_takes_no_life() {
        let hangs = Look { since_turn: Some(LOOP_HANGS_AFTER), ..well() };
        assert!(!is_alive(&hangs));
        assert!(reason(ServiceName::Ingest, &hangs).contains("loop"));
        assert!(is_alive(&Look::default()));
    }

    #[test]
    fn each_service_misses_what_it_reads_and_nothing_else() {
        let roster = Look { since_roster: Some(6 * S), ..well() };
        let never = Look { since_roster: None, ..well() };
        for look in [&roster, &never] {
            assert_eq!(reason(ServiceName::Ingest, look), "");
            assert!(reason(ServiceName::Embedder, look).contains("from ingest"));
        }
        let embedding = Look { since_embedding: Some(11 * S), ..well() };
        assert_eq!(reason(ServiceName::Embedder, &embedding), "");
        assert!(reason(ServiceName::Clusterer, &embedding).contains("from embedder"));
        let teams = Look { since_teams: None, ..well() };
        assert_eq!(reason(ServiceName::Clusterer, &teams), "");
        assert!(reason(ServiceName::Auditor, &teams).contains("from clusterer"));
        let empty = Look { since_embedding: None, since_teams: None, peopled_for: None, ..well() };
        assert_eq!(reason(ServiceName::Auditor, &empty), "", "a fleet without robots has no teams");
    }

    #[test]
    fn a_service_whose_jobs_all_fail_is_not_ready_and_says_why() {
        let failing = |lasting| Look {
            jobs_failing: Some((lasting, "alpha: must be less".to_owned())),
            ..well()
        };
        assert_eq!(reason(ServiceName::Embedder, &failing(S)), "", "one frame may fail");
        let reason = reason(ServiceName::Embedder, &failing(JOBS_FAILING_AFTER));
        assert_eq!(reason, "every job has failed for 2 s: alpha: must be less");
        assert!(is_alive(&failing(100 * S)), "a restart would not help");
    }

    #[test]
    fn a_link_that_is_just_back_gives_every_service_time() {
        let look = Look { linked_for: S, since_roster: Some(20 * S), ..well() };
        assert_eq!(reason(ServiceName::Auditor, &look), "");
    }
}

//! What is wrong by what was seen, and what to do about it.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use muster_model::event::EventKind;
use muster_model::id::ServiceName;
use muster_model::role::Standing;
use muster_model::roster::Presence;
use muster_model::status::ServiceStatus;
use muster_runtime::bus::handshake::Reach;
use muster_wire::message::quoted;
use serde::Serialize;

use super::Endpoint;
use super::look::Look;
use crate::show::names;

/// Clocks that differ by less do no harm: the age of data is told in tenths of a second.
const CLOCK_OFF_S: f64 = 0.5;

/// Older data than this behind a division: a pose is a tick old, and every stage takes less.
const DATA_OLD_S: f64 = 3.0;

/// Longest lease of a router by which lost robots are noticed in the time that the manual promises.
const LEASE_AT_MOST: Duration = Duration::from_secs(4);

/// How long a service must have run before what it has never heard of counts as missing.
const SETTLED: Duration = Duration::from_secs(10);

/// Most things that a finding names one by one.
const MAX_SUBJECTS: usize = 100;

/// How much a finding matters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Severity {
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
    /// Whom it concerns: robots, services, endpoints.
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

/// What is wrong with an endpoint.
pub(super) fn of_endpoint(endpoint: &Endpoint) -> Option<Finding> {
    let name = &endpoint.name;
    let found = match &endpoint.reach {
        Reach::Listens => return None,
        Reach::Zenoh { lease, router: true } if *lease <= LEASE_AT_MOST => return None,
        Reach::Zenoh { lease, router: true } => warning(
            "router_lease",
            format!("the router at {name} announces a lease of {:.0} s", lease.as_secs_f64()),
            "robots and services that lose their link silently are noticed only after that time; run \
             `muster router`, or set transport.link.tx.lease to 2000 in the router's configuration",
        ),
        Reach::Zenoh { router: false, .. } => error(
            "no_router",
            format!("a node of Zenoh answers at {name} that is no router"),
            "peers do not relay for each other: start `muster router` and name it with --connect",
        ),
        Reach::Unknown(problem) => error(
            "no_router",
            format!("the host of {name} is not known: {}", quoted(problem)),
            "check the name in --connect, or write the address as a number",
        ),
        Reach::Refused => error(
            "no_router",
            format!("nothing listens at {name}: the host refuses the connection"),
            "start a router there with `muster router --listen`, or name another with --connect",
        ),
        Reach::Silent => error(
            "no_router",
            format!("the host of {name} does not answer"),
            "check the address, the network and the firewall in between; is the host running?",
        ),
        Reach::Foreign(said) => {
            let said = match said {
                Some(said) => format!("it says {said:?}"),
                None => "it says nothing that Zenoh would".to_owned(),
            };
            error(
                "no_router",
                format!("something takes connections at {name}, and it is not Zenoh: {said}"),
                "check the port in --connect: the router listens at another one, usually 7447. If the \
                 router speaks TLS there, write tls/ instead of tcp/",
            )
        }
        Reach::Closed(reason) => error(
            "no_router",
            format!("a node of Zenoh at {name} does not let us in: {}", quoted(reason)),
            "it may want a certificate or a password (--zenoh-config), or be of another version",
        ),
    };
    Some(found.about([name]))
}

/// The session does not open, although something answers.
pub(super) fn session(problem: &anyhow::Error) -> Finding {
    error(
        "no_router",
        format!(
            "a router answers, and the session does not open: {}",
            quoted(&format!("{problem:#}"))
        ),
        "it may want a certificate or a password (--zenoh-config); its log tells why it refuses",
    )
}

/// Everything that is wrong with a fleet.
pub(super) fn of_fleet(look: &Look) -> Vec<Finding> {
    let mut found = Vec::new();
    if look.instances.is_empty()
        && look.tokens.is_empty()
        && let Some(wrong) = wrong_fleet(look)
    {
        // Nothing else can be said of a fleet that is not there.
        return vec![wrong];
    }
    found.extend(services(look));
    found.extend(denied(look));
    found.extend(clocks(look));
    found.extend(robots(look));
    found.extend(refused(look));
    found.extend(jobs(look));
    found.extend(teams(look));
    found
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
            format!("nobody speaks for fleet {}, but for {named}", look.fleet),
            format!("name the fleet that is meant: --fleet {}", fleets[0]),
        )
        .about(&fleets),
    )
}

fn services(look: &Look) -> Vec<Finding> {
    let mut found = Vec::new();
    for service in ServiceName::ALL {
        let answered = look.instances.iter().any(|instance| instance.service == service);
        let running = look.tokens.iter().any(|(of, _)| *of == service);
        if !answered && !running {
            found.push(
                error(
                    "service_missing",
                    format!("no {service} runs for fleet {}", look.fleet),
                    format!("start it with `muster up {service}` or `muster-{service}`"),
                )
                .about([service]),
            );
        }
        let holders = look.instances.iter().filter(|instance| {
            instance.service == service && instance.standing == Standing::Holding
        });
        let holders: Vec<_> = holders.map(|instance| &instance.instance).collect();
        if holders.len() > 1 {
            found.push(
                error(
                    "two_holders",
                    format!("{} instances of {service} hold its role at once: {}", holders.len(), names(holders.iter())),
                    "one of them is to stand by: they do not hear each other's claims (a router that \
                     is cut off, access control) or are of different versions; end all but one",
                )
                .about(&holders),
            );
        }
    }
    let ours = env!("CARGO_PKG_VERSION");
    let versions: BTreeSet<_> = look.instances.iter().map(|instance| &instance.version).collect();
    let skewed: Vec<_> =
        look.instances.iter().filter(|instance| instance.version != ours).collect();
    if !skewed.is_empty() {
        let all = skewed.iter().map(|instance| {
            format!("{} {} is of version {}", instance.service, instance.instance, instance.version)
        });
        let all: Vec<_> = all.collect();
        let severity = if versions.len() > 1 { Severity::Error } else { Severity::Warning };
        found.push(
            finding(
                "version_skew",
                severity,
                format!("this command is of version {ours}; {}", all.join("; ")),
                "install the same version everywhere, and restart what is older",
            )
            .about(skewed.iter().map(|instance| &instance.instance)),
        );
    }
    found
}

/// Refusals of access control are silent. They show where something is there and not answered.
fn denied(look: &Look) -> Vec<Finding> {
    const SILENT: &str = "denials of access control are silent";
    let mut found = Vec::new();
    let answered: BTreeSet<_> =
        look.instances.iter().map(|i| (i.service, i.instance.clone())).collect();
    let silent: Vec<_> = look.tokens.difference(&answered).collect();
    if !silent.is_empty() {
        let all = silent.iter().map(|(service, instance)| format!("{service} {instance}"));
        let all: Vec<_> = all.collect();
        found.push(
            error(
                "service_silent",
                format!("on the bus, and no answer to its status: {}", all.join(", ")),
                format!(
                    "either it hangs (see its log and /healthz; restart it), or access control keeps \
                     the get or its answer from passing: {SILENT}. Allow query on \
                     muster/v1/{0}/service/*/status to this client and declare_queryable and reply on \
                     it to the service, in both directions",
                    look.fleet
                ),
            )
            .about(&all),
        );
    }
    let hidden: Vec<_> = answered.difference(&look.tokens).map(|(service, _)| service).collect();
    if !hidden.is_empty() {
        found.push(
            error(
                "access_denied",
                format!("{} answers, and its liveliness token is not seen", names(hidden.iter())),
                format!(
                    "access control keeps the token from passing: {SILENT}. Allow liveliness_token to \
                     the service and liveliness_query to this client on muster/v1/{}/service/**",
                    look.fleet
                ),
            )
            .about(&hidden),
        );
    }
    let published = |service, what: &str| {
        look.status(service).is_some_and(|status| {
            status.standing == Standing::Holding
                && status.counters.get(what).copied().unwrap_or_default() > 0
        })
    };
    let unanswered: Vec<_> = [
        (ServiceName::Ingest, "frames_published", look.roster.is_some(), "roster"),
        (ServiceName::Embedder, "embeddings_published", look.embedding, "embedding"),
        (ServiceName::Clusterer, "divisions_published", look.teams.is_some(), "teams"),
    ]
    .into_iter()
    .filter(|(service, what, answered, _)| published(*service, what) && !answered)
    .map(|(_, _, _, key)| key)
    .collect();
    if !unanswered.is_empty() {
        found.push(
            error(
                "access_denied",
                format!(
                    "its service has published it, and nobody answers for {}",
                    unanswered.join(", ")
                ),
                format!(
                    "access control keeps gets from passing: {SILENT}. Allow query and reply on \
                     muster/v1/{}/{{{}}}",
                    look.fleet,
                    unanswered.join(",")
                ),
            )
            .about(unanswered),
        );
    }
    found
}

fn clocks(look: &Look) -> Option<Finding> {
    let services = look.instances.iter().filter_map(|instance| {
        Some((format!("{} {}", instance.service, instance.instance), instance.clock_offset_s?))
    });
    let robots = look.robot_clocks.iter().map(|(robot, offset)| (robot.to_string(), *offset));
    let off: Vec<_> =
        services.chain(robots).filter(|(_, offset)| offset.abs() >= CLOCK_OFF_S).collect();
    if off.is_empty() {
        return None;
    }
    let shown: Vec<_> =
        off.iter().map(|(who, offset)| format!("{who} by {offset:+.1} s")).collect();
    let seen = format!("clocks differ from the one of this host: {}", names(shown.iter()));
    let remedy = "keep all hosts on one clock: `timedatectl set-ntp true`, or chrony with one host of \
                  the fleet as server; `chronyc tracking` tells how far each is off. If all are off by \
                  the same, it is the clock of this host";
    Some(warning("clock_off", seen, remedy).about(off.iter().map(|(who, _)| who)))
}

fn settled(status: &ServiceStatus) -> bool {
    status.now.since(status.started) >= SETTLED
}

fn robots(look: &Look) -> Vec<Finding> {
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
                    "let them speak under muster/v1/{}/, or start services with --fleet",
                    look.fleet
                ),
            )
            .about(unserved.iter().map(|other| &other.fleet)),
        );
    }
    let Some(ingest) = look.status(ServiceName::Ingest) else { return found };
    let Some(roster) = &look.roster else { return found };
    let known: BTreeSet<_> = roster.robots.iter().map(|entry| &entry.robot).collect();
    let late: Vec<_> = look.robot_tokens.iter().filter(|robot| !known.contains(robot)).collect();
    if !late.is_empty() {
        found.push(
            error(
                "robots_unknown",
                format!("robots with a token that ingest does not know: {}", names(late.iter())),
                "raise max_robots of ingest if the fleet is full (`muster set ingest`); otherwise access \
                 control keeps ingest from seeing their tokens",
            )
            .about(late),
        );
    }
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
                "look after their radio and their software; raise stale_after_s of ingest if they \
                 speak more rarely than that on purpose",
            )
            .about(stale.iter().map(|entry| &entry.robot)),
        );
    }
    let links = ingest.counters.get("links_accepted").copied().unwrap_or_default();
    if links == 0 && roster.robots.len() > 1 && settled(ingest) {
        found.push(warning(
            "no_links",
            "no robot has reported links since ingest started",
            "let robots put whom they hear on robot/{robot}/links; where the radio tells nothing, give \
             connectivity no weight: muster set embedder 'weights={\"spatial\":0.5,\"hierarchy\":0.5}'",
        ));
    }
    found
}

fn refused(look: &Look) -> Option<Finding> {
    let mut by: BTreeMap<(String, String), u64> = BTreeMap::new();
    for event in &look.events {
        if let EventKind::Quarantined { robot, key, reason, count } = &event.kind {
            let who = robot.as_ref().map_or_else(|| quoted(key), ToString::to_string);
            *by.entry((who, quoted(reason))).or_default() += count;
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
            "mend what these robots put; each reason names the field and what would be right",
        )
        .about(who),
    )
}

fn jobs(look: &Look) -> Vec<Finding> {
    let mut found = Vec::new();
    for after in &look.after {
        let failed = |status: &ServiceStatus| {
            status.counters.get("jobs_failed").copied().unwrap_or_default()
        };
        let before = look.before.iter().find(|status| status.instance == after.instance);
        let more = failed(after) - before.map_or(0, failed).min(failed(after));
        let told = look.events.iter().rev().find_map(|event| match &event.kind {
            EventKind::JobFailed { reason } if event.source == after.service => {
                Some(quoted(reason))
            }
            _ => None,
        });
        // A fault that stands is not computed again, and shows in what the service says of itself.
        let stands = after.state.contains("failed");
        if more == 0 && told.is_none() && !stands {
            continue;
        }
        let service = after.service;
        found.push(
            error(
                "jobs_failing",
                format!("{service} fails to compute: {}", told.unwrap_or_else(|| quoted(&after.state))),
                format!(
                    "the last good result stands meanwhile; the reason names the setting: \
                     `muster set {service}` shows all, `muster set {service} FIELD=VALUE` changes one"
                ),
            )
            .about([service]),
        );
    }
    found
}

fn teams(look: &Look) -> Vec<Finding> {
    let mut found = Vec::new();
    let robots = look.roster.as_ref().map_or(0, |roster| roster.robots.len());
    if let Some(settings) = &look.clusterer
        && robots > 0
        && settings.teams as usize > robots
    {
        found.push(warning(
            "too_many_teams",
            format!("{} teams are asked for, and there are {robots} robots", settings.teams),
            format!("ask for fewer: muster set clusterer teams={robots}"),
        ));
    }
    let Some(teams) = &look.teams else {
        let clusterer = look.status(ServiceName::Clusterer);
        if robots > 1 && clusterer.is_some_and(settled) {
            found.push(error(
                "no_teams",
                format!("there are {robots} robots and no division of them"),
                "`muster status` says what each service waits for; `muster graph` shows whether \
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
    // Ages are taken by the clock of the clusterer, where it is known: ours may be another.
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

//! What is wrong with the services: who is missing, does not answer, or does not compute.

use std::collections::BTreeSet;
use std::time::Duration;

use muster_client::ServiceInstance;
use muster_model::event::EventKind;
use muster_model::id::ServiceName;
use muster_model::role::ReplicaState;
use muster_model::status::{ServiceStatus, StatusGauge};
use muster_wire::message::{plain_reason, quoted};

use super::{Finding, Severity, error, finding, warning};
use crate::doctor::look::{Instance, Look};
use crate::show::page::names;

/// Clocks that differ by less do no harm: the age of data is shown in tenths of a second.
const CLOCK_OFF_S: f64 = 0.5;

/// How long it is worth a note that a service began with nothing stored. An operator who looks for settings that are
/// gone does so within a day.
const FIRST_START_NOTED_FOR: Duration = Duration::from_secs(24 * 3600);

pub(super) fn services(look: &Look) -> Vec<Finding> {
    let mut found = Vec::new();
    for service in ServiceName::PIPELINE {
        let answered = look.instances.iter().any(|instance| instance.service == service);
        let running = look.tokens.iter().any(|token| token.service == service);
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
        let leaders = look.instances.iter().filter(|instance| {
            instance.service == service && instance.standing == ReplicaState::Leading
        });
        let leaders: Vec<_> = leaders.map(|instance| &instance.instance).collect();
        if leaders.len() > 1 {
            found.push(
                error(
                    "two_holders",
                    format!("{} instances of {service} lead at once: {}", leaders.len(), names(leaders.iter())),
                    "one of them is to be standby: they do not receive each other's lease renewals (a \
                     router that is cut off, access control) or are of different versions; end all but \
                     one",
                )
                .about(&leaders),
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
pub(super) fn denied(look: &Look) -> Vec<Finding> {
    const SILENT: &str = "denials of access control are silent";
    let mut found = Vec::new();
    let token = |instance: &Instance| ServiceInstance {
        service: instance.service,
        instance: instance.instance.clone(),
    };
    let answered: BTreeSet<_> = look.instances.iter().map(token).collect();
    let silent: Vec<_> = look.tokens.difference(&answered).collect();
    if !silent.is_empty() {
        let all = silent.iter().map(|token| format!("{} {}", token.service, token.instance));
        let all: Vec<_> = all.collect();
        found.push(
            error(
                "service_silent",
                format!("on the bus, and no answer to its status: {}", all.join(", ")),
                format!(
                    "either it hangs (see its log and /healthz; restart it), or access control keeps \
                     the get or its answer from passing: {SILENT}. Allow query on \
                     muster/v1/{0}/service/*/status to this client and declare_queryable and reply on \
                     it to the service, in both directions. Or the router is of a Zenoh before 1.9, such as \
                     1.7.2, which loses answers to gets: run `muster router` or a newer one",
                    look.fleet
                ),
            )
            .about(&all),
        );
    }
    let hidden: Vec<_> = answered.difference(&look.tokens).map(|token| token.service).collect();
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
            status.standing == ReplicaState::Leading
                && status.counters.get(what).copied().unwrap_or_default() > 0
        })
    };
    let unanswered: Vec<_> = [
        (ServiceName::Ingest, "frames_published", look.roster.is_some(), "roster"),
        (ServiceName::Embedder, "embeddings_published", look.embedding.is_some(), "embedding"),
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
                    "its service has published it, and no service answers for {}",
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

pub(super) fn clocks(look: &Look) -> Option<Finding> {
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
                  the fleet as server; `chronyc tracking` shows how far each is off. If all are off by \
                  the same, it is the clock of this host";
    Some(warning("clock_off", seen, remedy).about(off.iter().map(|(who, _)| who)))
}

/// Services that began without what they had stored, or cannot store.
pub(super) fn state(look: &Look) -> Vec<Finding> {
    let those = |is_meant: &dyn Fn(&ServiceStatus) -> bool| -> Vec<String> {
        let meant = look.after.iter().filter(|status| is_meant(status));
        meant.map(|status| format!("{} {}", status.service, status.instance)).collect()
    };
    let with = |gauge: StatusGauge| those(&|status| status.gauge(gauge) > 0);
    let mut found = Vec::new();
    let first = those(&is_first_start);
    if !first.is_empty() {
        found.push(
            finding(
                "state_empty",
                Severity::Note,
                format!("began with nothing stored, as at a first start: {}", first.join(", ")),
                "nothing, if this was the first start on its host. If it has run there before, its state is \
                 lost, and settings that were changed are those of file and flags again: compare `muster set \
                 SERVICE`, and keep the state directory on a disk that lasts (a volume, for a container)",
            )
            .about(&first),
        );
    }
    let lost = with(StatusGauge::StateLost);
    if !lost.is_empty() {
        found.push(
            warning(
                "state_lost",
                format!("began without the state that was stored: {}", lost.join(", ")),
                "settings that were changed are those of file and flags again: compare `muster set \
                 SERVICE`. Keep the state directory on a disk that lasts (a volume, for a container); \
                 its log names the file. The finding ends with the next start of the service",
            )
            .about(&lost),
        );
    }
    let degraded = with(StatusGauge::HistoryDegraded);
    if !degraded.is_empty() {
        found.push(
            warning(
                "history_degraded",
                format!("keeps less of the past than it should: {}", degraded.join(", ")),
                "free space on the disk of its state directory, or lower max_mb of historian; its state in \
                 `muster status` says what is wrong. It recovers without a restart",
            )
            .about(&degraded),
        );
    }
    let unwritable = with(StatusGauge::StateUnwritable);
    if !unwritable.is_empty() {
        found.push(
            error(
                "state_unwritable",
                format!("cannot store settings and terms: {}", unwritable.join(", ")),
                "make the state directory writable and free space on its disk: the log of the service \
                 names the file. Then change a setting, or restart the service",
            )
            .about(&unwritable),
        );
    }
    found
}

/// Whether a service began with nothing stored, not long ago, and no other one knows that something was.
fn is_first_start(status: &ServiceStatus) -> bool {
    status.gauge(StatusGauge::StateEmpty) > 0
        && status.gauge(StatusGauge::StateLost) == 0
        && status.now.since(status.started) < FIRST_START_NOTED_FOR
}

pub(super) fn jobs(look: &Look) -> Vec<Finding> {
    let mut found = Vec::new();
    for after in &look.after {
        let failed = |status: &ServiceStatus| {
            status.counters.get("jobs_failed").copied().unwrap_or_default()
        };
        let before = look.before.iter().find(|status| status.instance == after.instance);
        let more = failed(after) - before.map_or(0, failed).min(failed(after));
        let reported = look.events.iter().rev().find_map(|event| match &event.kind {
            EventKind::JobFailed { reason } if event.source == after.service => {
                Some(plain_reason(reason))
            }
            _ => None,
        });
        // A fault that lasts is not computed again, and shows in the status of the service.
        let lasts = after.state.contains("failed");
        if more == 0 && reported.is_none() && !lasts {
            continue;
        }
        let service = after.service;
        found.push(
            error(
                "jobs_failing",
                format!("{service} fails to compute: {}", reported.unwrap_or_else(|| quoted(&after.state))),
                format!(
                    "the last good result is kept meanwhile; the reason names the setting: \
                     `muster set {service}` shows all, `muster set {service} FIELD=VALUE` changes one"
                ),
            )
            .about([service]),
        );
    }
    found
}

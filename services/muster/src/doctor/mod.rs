//! `muster doctor`: examines a fleet, finds the usual mistakes and shows what to do.
//!
//! [`look`] gathers what can be seen from one place on the bus, [`findings`] names what is wrong, and this
//! file prints it. It only looks: it puts nothing, declares nothing and changes no setting.

mod findings;
mod look;

use std::io::Write as _;
use std::time::Duration;

use muster_client::Client;
use muster_runtime::bus::handshake::{self, Reach};
use muster_runtime::bus::{BusConfig, routers};
use muster_runtime::config::{Mode, ProcessConfig};
use muster_runtime::exit::{Exit, ExitError};
use serde_json::json;

use self::findings::{Finding, Severity};
use self::look::{Instance, Look};
use crate::console::{self, exit_error};
use crate::show::page::{Column, Page};
use crate::show::status::role;

/// How long an endpoint may take to answer.
const REACH_TIMEOUT: Duration = Duration::from_secs(3);

/// Shortest and longest time to listen in seconds: a repeated event is published every two seconds.
const LISTEN_S: std::ops::RangeInclusive<f64> = 1.0..=3600.0;

/// Arguments of `muster doctor`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "It reads and listens, and changes nothing. The exit code is 0 if everything is well, \
1 if there are findings, and 3 if no router answers; \
notes count for nothing.\n\nExamples:\n  muster doctor\n  \
muster doctor --fleet alpha --connect tcp/192.168.1.10:7447\n  \
muster doctor --json | jq '.findings[] | .id, .remedy'"
)]
pub(crate) struct DoctorArgs {
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// How long to listen to the fleet
    #[arg(long, value_name = "SECONDS", default_value_t = 3.0)]
    listen_for: f64,
}

/// An endpoint and what answers there.
struct Endpoint {
    name: String,
    reach: Reach,
}

/// Examines a fleet and prints what is found.
///
/// # Errors
/// If no router answers, or there are findings; by the exit code.
pub(crate) async fn run(args: &DoctorArgs, config: &ProcessConfig) -> anyhow::Result<()> {
    if !LISTEN_S.contains(&args.listen_for) {
        let (least, most) = (LISTEN_S.start(), LISTEN_S.end());
        let problem = format!("--listen-for: must be {least} to {most} seconds");
        return Err(ExitError::usage(problem).into());
    }
    if config.mode.value != Mode::Client {
        let problem = "mode: the doctor examines a router as a client; leave --mode out";
        return Err(ExitError::usage(problem).into());
    }
    let mut endpoints = Vec::new();
    // Zenoh's own configuration may name the routers, as that of a secured fleet does.
    let bus = BusConfig::from(config);
    for name in routers(&bus).map_err(|error| ExitError::usage(error.to_string()))? {
        let reach = handshake::reach(&name, REACH_TIMEOUT).await;
        endpoints.push(Endpoint { name, reach });
    }
    let of_endpoints = |has_ros: bool| -> Vec<Finding> {
        let found = endpoints.iter().map(|endpoint| findings::of_endpoint(endpoint, has_ros));
        found.flatten().collect()
    };
    let client = if endpoints.iter().any(|endpoint| endpoint.reach.answers()) {
        console::open(config).await
    } else {
        no_router(&endpoints)
    };
    let client = match client {
        Ok(client) => client,
        Err(error) => {
            let mut found = of_endpoints(false);
            if found.iter().all(|finding| finding.id != "no_router") {
                found.push(findings::session(&error));
            }
            print(args, config, &endpoints, None, &found, &[])?;
            return Err(ExitError::unreachable("no router answers").into());
        }
    };
    let listen_for = Duration::from_secs_f64(args.listen_for);
    let look = look::look(&client, &config.fleet.value, listen_for).await.map_err(exit_error)?;
    let mut found = of_endpoints(look.ros.any());
    // Another router answers: one that does not is a warning, not the end.
    for finding in found.iter_mut().filter(|finding| finding.id == "no_router") {
        finding.severity = Severity::Warning;
        finding.remedy.push_str(". Programs use the other one meanwhile");
    }
    found.extend(unannounced(&endpoints, &look).await);
    found.extend(findings::of_fleet(&look));
    found.sort_by_key(|finding| std::cmp::Reverse(finding.severity));
    let notes: Vec<_> =
        found.extract_if(.., |finding| finding.severity == Severity::Note).collect();
    print(args, config, &endpoints, Some(&look), &found, &notes)?;
    client.close().await;
    match found.len() {
        0 => Ok(()),
        1 => Err(failure("1 finding".to_owned())),
        many => Err(failure(format!("{many} findings"))),
    }
}

/// Routers that keep programs of ROS from finding each other. It links to them as a peer for a moment, only if there are
/// such programs.
async fn unannounced(endpoints: &[Endpoint], look: &Look) -> Vec<Finding> {
    let mut found = Vec::new();
    if !look.ros.several() {
        return found;
    }
    for Endpoint { name, reach } in endpoints {
        if matches!(reach, Reach::Zenoh { router: true, .. })
            && let Some(announcing) = handshake::announces_peers(name, REACH_TIMEOUT).await
            && !announcing.is_on
        {
            let router = &announcing.router;
            found.extend(findings::unannounced(name, router, &look.ros, &look.routers));
        }
    }
    found
}

fn no_router(endpoints: &[Endpoint]) -> anyhow::Result<Client> {
    let all: Vec<_> = endpoints.iter().map(|endpoint| endpoint.name.as_str()).collect();
    Err(anyhow::anyhow!("nothing answers at {}", all.join(", ")))
}

fn failure(message: String) -> anyhow::Error {
    ExitError { exit: Exit::Failure, message }.into()
}

fn print(
    args: &DoctorArgs,
    config: &ProcessConfig,
    endpoints: &[Endpoint],
    look: Option<&Look>,
    found: &[Finding],
    notes: &[Finding],
) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    if args.json {
        let routers = endpoints.iter().map(|endpoint| {
            let (answer, lease_s) = match &endpoint.reach {
                Reach::Unknown(_) => ("unknown_host", None),
                Reach::Refused => ("refused", None),
                Reach::Silent => ("silent", None),
                Reach::Foreign(_) => ("foreign", None),
                Reach::Closed(_) => ("closed", None),
                Reach::Listens => ("listens", None),
                Reach::Unseen => ("unseen", None),
                Reach::Zenoh { lease, .. } => ("zenoh", Some(lease.as_secs_f64())),
            };
            json!({"endpoint": endpoint.name, "answer": answer, "lease_s": lease_s})
        });
        let report = json!({
            "fleet": config.fleet.value,
            "version": env!("CARGO_PKG_VERSION"),
            "healthy": found.is_empty(),
            "routers": routers.collect::<Vec<_>>(),
            "services": look.map_or(&[][..], |look| look.instances.as_slice()),
            "robots": look.map(Look::robots),
            "other_fleets": look.map_or(&[][..], |look| look.others.as_slice()),
            "findings": found,
            "notes": notes,
        });
        writeln!(out, "{report}")?;
        return Ok(out.flush()?);
    }
    writeln!(out, "fleet {}", config.fleet.value)?;
    if let Some(look) = look.filter(|look| !look.instances.is_empty()) {
        for line in table(&look.instances, &Page::of_stdout()) {
            writeln!(out, "{line}")?;
        }
    }
    if found.is_empty() {
        writeln!(out, "everything is well")?;
    }
    for finding in found.iter().chain(notes) {
        let severity = match finding.severity {
            Severity::Error => "ERROR",
            Severity::Warning => "warning",
            Severity::Note => "note",
        };
        writeln!(
            out,
            "\n{severity} ({})\n  seen: {}\n  do:   {}",
            finding.id, finding.seen, finding.remedy
        )?;
    }
    Ok(out.flush()?)
}

/// The instances of services as a table.
fn table(instances: &[Instance], page: &Page) -> Vec<String> {
    let [service, instance] = ["service", "instance"].map(Column::kept);
    let [version, term] = ["version", "term"].map(|name| Column::dropped(name, 1));
    let columns = [service, instance, version, Column::kept("role"), term, Column::kept("clock")];
    let row = |instance: &Instance| {
        let offset = instance.clock_offset_s;
        vec![
            instance.service.to_string(),
            instance.instance.to_string(),
            instance.version.clone(),
            role(instance.standing).to_owned(),
            instance.term.to_string(),
            offset.map_or_else(String::new, |offset| format!("{offset:+.3} s")),
        ]
    };
    page.table(&columns, instances.iter().map(row))
}

//! One fleet over three sites, each with a router of its own: what crosses the links between them for each robot.
//!
//! The sites are in a row: the robots' router is linked to that of the base, and that to the one of the office, where a
//! console follows the teams. Where the services run is what differs.

use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::{Context, ensure};

use super::lab::{Host, LINK, Lab};
use crate::process::{Process, program};

/// The fleet.
const FLEET: &str = "sites";

/// How long the fleet may take to be divided.
const FORMED_WITHIN: Duration = Duration::from_secs(60);

/// How long it settles before it is measured.
const SETTLING_TIME: Duration = Duration::from_secs(5);

/// The port of each router.
const PORT: u16 = 7447;

/// Where the services run: ingest, embedder, and the two that follow.
#[derive(Debug, Clone, Copy)]
pub struct Arrangement {
    /// What it is called.
    pub name: &'static str,
    /// Where `ingest` runs.
    pub ingest: Host,
    /// Where `embedder` runs.
    pub embedder: Host,
    /// Where `clusterer` and `auditor` run.
    pub clusterer: Host,
}

/// What is compared.
pub const ARRANGEMENTS: [Arrangement; 4] = [
    Arrangement {
        name: "all at the base",
        ingest: Host::Base,
        embedder: Host::Base,
        clusterer: Host::Base,
    },
    Arrangement {
        name: "ingest near the robots, the others at the base",
        ingest: Host::Robots,
        embedder: Host::Base,
        clusterer: Host::Base,
    },
    Arrangement {
        name: "ingest near the robots, embedder at the base, the others at the office",
        ingest: Host::Robots,
        embedder: Host::Base,
        clusterer: Host::Router,
    },
    Arrangement {
        name: "all near the robots",
        ingest: Host::Robots,
        embedder: Host::Robots,
        clusterer: Host::Robots,
    },
];

/// Bytes a second that crossed the link of a site.
#[derive(Debug, Clone, Copy, Default)]
pub struct Crossed {
    /// Into the site.
    pub received: f64,
    /// Out of it.
    pub sent: f64,
}

/// What was measured.
#[derive(Debug, Clone)]
pub struct Measured {
    /// What crossed the link of each site, in the order of [`Host::ALL`].
    pub links: Vec<(&'static str, Crossed)>,
    /// Divisions a second.
    pub divisions: f64,
}

/// Runs a fleet of robots at ten poses a second each, and measures what crosses the links.
///
/// # Errors
/// If something does not start, or the fleet is not divided.
pub fn measure(
    arrangement: Arrangement,
    robots: usize,
    time: Duration,
) -> anyhow::Result<Measured> {
    let lab = Lab::new()?;
    let folder = tempfile::tempdir()?;
    let endpoint = |host: Host| format!("tcp/{}:{PORT}", host.address());
    let start = |host: Host, name: &str, arguments: &[&str]| -> anyhow::Result<Process> {
        let mut command = lab.command(host, &program(name)?);
        command.args(arguments);
        Process::start_command(name, command, folder.path())
    };
    let mut running = Vec::new();
    let before =
        [(Host::Robots, None), (Host::Base, Some(Host::Robots)), (Host::Router, Some(Host::Base))];
    for (host, linked_to) in before {
        let (listen, connect) = (endpoint(host), linked_to.map(endpoint));
        let mut arguments = vec!["router", "--listen", &listen];
        if let Some(connect) = &connect {
            arguments.extend(["--connect", connect]);
        }
        let mut router = start(host, "muster", &arguments)?;
        router.until_prints("router listens at", Duration::from_secs(10))?;
        running.push(router);
    }
    for (service, host) in [
        ("ingest", arrangement.ingest),
        ("embedder", arrangement.embedder),
        ("clusterer", arrangement.clusterer),
        ("auditor", arrangement.clusterer),
    ] {
        let connect = endpoint(host);
        let flags = ["--fleet", FLEET, "--connect", &connect, "--state-directory", "none"];
        running.push(start(host, &format!("muster-{service}"), &flags)?);
    }
    let (connect, count) = (endpoint(Host::Robots), robots.to_string());
    let flags = ["robot", "--fleet", FLEET, "--connect", &connect, "--robots", &count];
    running.push(start(Host::Robots, "muster", &flags)?);
    let connect = endpoint(Host::Router);
    let flags = ["teams", "--watch", "--json", "--fleet", FLEET, "--connect", &connect];
    let begin = Instant::now();
    let _console = loop {
        // A console that finds no division ends.
        let mut console = start(Host::Router, "muster", &flags)?;
        std::thread::sleep(Duration::from_secs(3));
        if console.is_running()? && is_whole(&console.output(), robots) {
            break console;
        }
        ensure!(begin.elapsed() < FORMED_WITHIN, "no division: {}", console.output());
    };
    std::thread::sleep(SETTLING_TIME);
    let sample = || -> anyhow::Result<Vec<[f64; 2]>> {
        Host::ALL.into_iter().map(|host| counted(&lab, host)).collect()
    };
    let epoch = || -> anyhow::Result<f64> {
        let mut command = lab.command(Host::Router, &program("muster")?);
        command.args(["status", "--json", "--fleet", FLEET, "--connect", &connect]);
        let status: serde_json::Value = serde_json::from_slice(&command.output()?.stdout)?;
        let services = status["services"].as_array().map_or(&[][..], Vec::as_slice);
        let clusterer = services.iter().find(|service| service["service"] == "clusterer");
        clusterer
            .and_then(|service| service["revision"]["epoch"].as_f64())
            .context("no clusterer answers")
    };
    // What asks for it is not measured, and the epoch counts for a little longer than the bytes.
    let (asked, before) = (Instant::now(), epoch()?);
    let (start, first) = (Instant::now(), sample()?);
    std::thread::sleep(time);
    let (seconds, last) = (start.elapsed().as_secs_f64(), sample()?);
    let divisions = (epoch()? - before) / asked.elapsed().as_secs_f64();
    let crossed = |at: usize| Crossed {
        received: (last[at][0] - first[at][0]) / seconds,
        sent: (last[at][1] - first[at][1]) / seconds,
    };
    let links = Host::ALL.into_iter().enumerate();
    Ok(Measured { links: links.map(|(at, host)| (site(host), crossed(at))).collect(), divisions })
}

/// What a host is here.
fn site(host: Host) -> &'static str {
    match host {
        Host::Robots => "robots",
        Host::Base => "base",
        Host::Router => "office",
    }
}

/// The newest complete line of a console.
fn newest(output: &str) -> Option<serde_json::Value> {
    output.lines().rev().find_map(|line| serde_json::from_str(line).ok())
}

fn is_whole(output: &str, robots: usize) -> bool {
    newest(output).is_some_and(|teams| crate::client::division(&teams).len() == robots)
}

/// Bytes that the link of a host has received and sent.
fn counted(lab: &Lab, host: Host) -> anyhow::Result<[f64; 2]> {
    let output = lab.command(host, Path::new("cat")).arg("/proc/net/dev").output()?;
    let text = String::from_utf8(output.stdout)?;
    bytes_of(&text, LINK).with_context(|| format!("{host:?} has no link: {text}"))
}

/// Bytes that a link has received and sent, by `/proc/net/dev`.
fn bytes_of(text: &str, link: &str) -> Option<[f64; 2]> {
    let line = text.lines().find_map(|line| line.trim().strip_prefix(link)?.strip_prefix(':'))?;
    let mut fields = line.split_whitespace().map(str::parse::<f64>);
    Some([fields.next()?.ok()?, fields.nth(7)?.ok()?])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_are_those_of_the_link() {
        let text = "Inter-|   Receive  |  Transmit\n face |bytes    packets errs drop fifo frame compressed multicast|bytes\n\
                    lo: 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16\n\
                    cable: 100 2 3 4 5 6 7 8 900 10 11 12 13 14 15 16\n";
        assert_eq!(bytes_of(text, "cable"), Some([100.0, 900.0]));
        assert_eq!(bytes_of(text, "none"), None);
    }
}

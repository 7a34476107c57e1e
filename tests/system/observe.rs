//! What probes and scrapers see of the processes: health, readiness and metrics.

use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use muster_tests::SOON;
use muster_tests::cluster::{SERVICES, start_router};
use muster_tests::ports::{free_address, free_endpoint};
use muster_tests::process::{Process, run};
use serde_json::Value;

/// The status and the body that a path is answered with; none while the port is closed.
pub(crate) fn get(address: &str, path: &str) -> Option<(u16, String)> {
    let mut stream = TcpStream::connect(address).ok()?;
    stream.set_read_timeout(Some(Duration::from_secs(5))).ok()?;
    write!(stream, "GET {path} HTTP/1.1\r\nHost: {address}\r\n\r\n").ok()?;
    let mut answer = String::new();
    stream.read_to_string(&mut answer).ok()?;
    let code = answer.split(' ').nth(1)?.parse().ok()?;
    Some((code, answer.split_once("\r\n\r\n")?.1.to_owned()))
}

pub(crate) fn until(what: &str, right: impl Fn() -> bool) {
    let start = Instant::now();
    while !right() {
        assert!(start.elapsed() < SOON, "not within {SOON:?}: {what}");
        std::thread::sleep(Duration::from_millis(50));
    }
}

pub(crate) fn is(address: &str, path: &str, code: u16) -> bool {
    get(address, path).is_some_and(|(is, _)| is == code)
}

/// Every sample of `/metrics` by name and labels, as Prometheus' own Python client reads them. It
/// refuses what the format does not allow.
pub(crate) fn samples(address: &str) -> BTreeMap<(String, BTreeMap<String, String>), f64> {
    let (code, text) = get(address, "/metrics").unwrap();
    assert_eq!(code, 200);
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let python = root.join("../target/peers/bin/python");
    assert!(python.exists(), "{} is missing; run tests/run, which makes it", python.display());
    let mut child = Command::new(python)
        .arg(root.join("peers/check_metrics.py"))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    child.stdin.take().unwrap().write_all(text.as_bytes()).unwrap();
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "the parser refuses:\n{text}");
    let lines = String::from_utf8(output.stdout).unwrap();
    let all = lines.lines().map(|line| {
        let sample: Value = serde_json::from_str(line).unwrap();
        let name = sample["name"].as_str().unwrap().to_owned();
        let labels = serde_json::from_value(sample["labels"].clone()).unwrap();
        ((name, labels), sample["value"].as_f64().unwrap())
    });
    all.collect()
}

pub(crate) type Samples = BTreeMap<(String, BTreeMap<String, String>), f64>;

/// The value of a metric with some of its labels.
pub(crate) fn value(samples: &Samples, name: &str, labels: &[(&str, &str)]) -> Option<f64> {
    let right = |of: &BTreeMap<String, String>| {
        labels.iter().all(|(label, value)| of.get(*label).is_some_and(|is| is == value))
    };
    samples.iter().find(|((is, of), _)| is == name && right(of)).map(|(_, value)| *value)
}

#[test]
fn a_router_outage_takes_readiness_and_not_life() {
    let (endpoint, address) = (free_endpoint().unwrap(), free_address().unwrap());
    let folder = tempfile::tempdir().unwrap();
    let up = ["up", "--connect", &endpoint, "--http", &address, "--state-directory", "none"];
    let mut up = Process::start("muster", &up, &[], folder.path()).unwrap();
    // Without any router yet, it lives and waits.
    until("it answers", || is(&address, "/healthz", 200));
    let (code, body) = get(&address, "/readyz").unwrap();
    assert_eq!(code, 503);
    assert!(body.contains("no router has answered yet"), "{body}");

    let mut router = start_router(&endpoint, folder.path()).unwrap();
    let robots = ["robot", "--connect", &endpoint, "--scenario", "clusters", "--robots", "8"];
    let _robots = Process::start("muster", &robots, &[], folder.path()).unwrap();
    until("it is ready", || is(&address, "/readyz", 200));
    assert!(is(&address, "/healthz", 200));
    let ready: Value = serde_json::from_str(&get(&address, "/readyz").unwrap().1).unwrap();
    for service in SERVICES {
        assert_eq!(ready["services"][service]["standing"], "holding", "{ready}");
    }

    router.kill().unwrap();
    until("it is not ready", || is(&address, "/readyz", 503));
    let outage = Instant::now();
    let mut reasons = String::new();
    while outage.elapsed() < Duration::from_secs(7) {
        assert!(is(&address, "/healthz", 200), "an outage is no reason to restart it");
        let (code, body) = get(&address, "/readyz").unwrap();
        assert_eq!(code, 503);
        reasons = body;
        std::thread::sleep(Duration::from_millis(100));
    }
    for service in SERVICES {
        let reasons: Value = serde_json::from_str(&reasons).unwrap();
        let reason = reasons["services"][service]["reasons"][0].as_str().unwrap();
        assert!(reason.contains("link to the router is lost"), "{reasons}");
    }
    let _router = start_router(&endpoint, folder.path()).unwrap();
    until("it is ready again", || is(&address, "/readyz", 200));
    assert!(up.is_running().unwrap(), "the same process");
    for service in SERVICES {
        let again = value(&samples(&address), "muster_reconnects_total", &[("service", service)]);
        assert_eq!(again, Some(1.0), "{service}");
    }
}

#[test]
fn a_service_without_its_input_is_not_ready() {
    let endpoint = free_endpoint().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let _router = start_router(&endpoint, folder.path()).unwrap();
    let address = free_address().unwrap();
    let arguments = ["--connect", &endpoint, "--http", &address, "--state-directory", "none"];
    let _alone = Process::start("muster-embedder", &arguments, &[], folder.path()).unwrap();
    until("it misses its roster", || {
        get(&address, "/readyz")
            .is_some_and(|(code, body)| code == 503 && body.contains("from ingest"))
    });
    assert!(is(&address, "/healthz", 200));
    let ingest = ["--connect", &endpoint, "--state-directory", "none"];
    let _ingest = Process::start("muster-ingest", &ingest, &[], folder.path()).unwrap();
    until("it is ready with its roster", || is(&address, "/readyz", 200));
}

#[test]
fn a_service_whose_jobs_all_fail_is_not_ready_until_one_does_not() {
    let (endpoint, address) = (free_endpoint().unwrap(), free_address().unwrap());
    let folder = tempfile::tempdir().unwrap();
    let _router = start_router(&endpoint, folder.path()).unwrap();
    let up = ["up", "--connect", &endpoint, "--http", &address, "--state-directory", "none"];
    let up = [&up[..], &["--set", "embedder.alpha=50"]].concat();
    let _up = Process::start("muster", &up, &[], folder.path()).unwrap();
    let robots = ["robot", "--connect", &endpoint, "--scenario", "clusters", "--robots", "8"];
    let _robots = Process::start("muster", &robots, &[], folder.path()).unwrap();
    until("it says that its jobs fail", || {
        get(&address, "/readyz").is_some_and(|(code, body)| {
            code == 503 && body.contains("every job has failed for") && body.contains("alpha: 50")
        })
    });
    assert!(is(&address, "/healthz", 200), "a restart would not help");
    let set = ["set", "embedder", "alpha=0.3", "--connect", &endpoint];
    let (code, _, err) = run("muster", &set, SOON).unwrap();
    assert_eq!(code, Some(0), "{err}");
    until("it is ready", || is(&address, "/readyz", 200));
}

#[test]
fn an_instance_that_stands_by_is_ready() {
    let endpoint = free_endpoint().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let _router = start_router(&endpoint, folder.path()).unwrap();
    let start = |address: &str| {
        let arguments = ["--connect", &endpoint, "--http", address, "--state-directory", "none"];
        Process::start("muster-ingest", &arguments, &[], folder.path()).unwrap()
    };
    let is_ready = |address: &str, state: &str| {
        let standing = format!("\"standing\":\"{state}\"");
        get(address, "/readyz").is_some_and(|(code, body)| code == 200 && body.contains(&standing))
    };
    let (first, second) = (free_address().unwrap(), free_address().unwrap());
    let mut leader = start(&first);
    until("the first one leads", || is_ready(&first, "holding"));
    let _standby = start(&second);
    until("the second one is a standby", || is_ready(&second, "standby"));
    leader.kill().unwrap();
    until("the second one takes over", || is_ready(&second, "holding"));
}

#[test]
fn the_metrics_are_those_that_are_promised() {
    let (endpoint, address) = (free_endpoint().unwrap(), free_address().unwrap());
    let folder = tempfile::tempdir().unwrap();
    let _router = start_router(&endpoint, folder.path()).unwrap();
    let up = [
        "up",
        "--connect",
        &endpoint,
        "--http",
        &address,
        "--fleet",
        "alpha",
        "--set",
        "clusterer.teams=2",
    ];
    let environment = [("STATE_DIRECTORY", "none")];
    let _up = Process::start("muster", &up, &environment, folder.path()).unwrap();
    let robots = [
        "robot",
        "--connect",
        &endpoint,
        "--fleet",
        "alpha",
        "--scenario",
        "clusters",
        "--robots",
        "8",
    ];
    let _robots = Process::start("muster", &robots, &[], folder.path()).unwrap();
    until("there is an audit of all robots", || {
        get(&address, "/metrics").is_some_and(|(_, text)| {
            text.contains("muster_silhouette_mean{")
                && text.contains(
                    "muster_robots{fleet=\"alpha\",service=\"ingest\",presence=\"active\"} 8",
                )
        })
    });
    let (_, _, refused) = run(
        "muster",
        &["set", "clusterer", "teams=0", "--connect", &endpoint, "--fleet", "alpha"],
        SOON,
    )
    .unwrap();
    assert!(refused.contains("teams"), "a get is answered: {refused}");
    std::thread::sleep(Duration::from_secs(1));
    let first = samples(&address);
    for ((name, labels), value) in &first {
        assert!(value.is_finite() || labels.contains_key("le"), "{name} {labels:?} {value}");
        if name.starts_with("muster_") {
            assert_eq!(labels.get("fleet").map(String::as_str), Some("alpha"), "{name}");
        }
    }
    let of = |name: &str, service: &str| {
        let found = value(&first, name, &[("service", service)]);
        found.unwrap_or_else(|| panic!("{name} of {service} is missing"))
    };
    for service in SERVICES {
        for (name, least, most) in [
            ("muster_loop_turning", 1.0, 1.0),
            ("muster_ready", 1.0, 1.0),
            ("muster_link_up", 1.0, 1.0),
            ("muster_term", 1.7e9, 5e9),
            ("muster_epoch", 1.0, 1e6),
            ("muster_reconnects_total", 0.0, 0.0),
            ("muster_data_age_seconds_count", 1.0, 1e6),
            ("muster_data_age_seconds_sum", 1e-3, 1e6),
            ("muster_stage_seconds_count", 1.0, 1e6),
            ("muster_event_handling_seconds_count", 10.0, 1e7),
            ("muster_job_seconds_count", 0.0, 1e6),
            ("muster_jobs_running", 0.0, 1.0),
            ("muster_jobs_failed_total", 0.0, 0.0),
            ("muster_inbox_messages", 0.0, 1e4),
            ("muster_inbox_bytes", 0.0, 1e7),
            ("muster_inbox_superseded_total", 0.0, 1e6),
            ("muster_inbox_dropped_total", 0.0, 0.0),
            ("muster_outbox_messages", 0.0, 1e4),
            ("muster_outbox_bytes", 0.0, 1e7),
            ("muster_outbox_sent_total", 1.0, 1e6),
            ("muster_outbox_dropped_total", 0.0, 0.0),
            ("muster_received_bytes_total", 1.0, 1e9),
            ("muster_published_bytes_total", 1.0, 1e9),
            ("muster_messages_refused_total", 0.0, 0.0),
            ("muster_state_lost", 0.0, 0.0),
            ("muster_state_unwritable", 0.0, 0.0),
        ] {
            let value = of(name, service);
            assert!((least..=most).contains(&value), "{name} of {service} is {value}");
        }
        let standing =
            value(&first, "muster_standing", &[("service", service), ("standing", "holding")]);
        assert_eq!(standing, Some(1.0), "{service}");
        let messages =
            value(&first, "muster_events_total", &[("service", service), ("kind", "message")]);
        assert!(messages.unwrap() > 0.0, "{service}");
    }
    for service in ["embedder", "clusterer", "auditor"] {
        assert!(of("muster_job_seconds_count", service) > 0.0, "{service}");
    }
    assert!(of("muster_gets_answered_total", "clusterer") > 0.0);
    assert!(of("muster_poses_accepted_total", "ingest") > 0.0);
    let robots = |presence| value(&first, "muster_robots", &[("presence", presence)]);
    assert_eq!((robots("active"), robots("stale")), (Some(8.0), Some(0.0)));
    for (name, value) in [("teams", 2.0), ("teams_requested", 2.0), ("robots_unassigned", 0.0)] {
        assert_eq!(of(&format!("muster_{name}"), "clusterer"), value, "{name}");
    }
    for space in ["embedding", "physical"] {
        let mean = value(&first, "muster_silhouette_mean", &[("space", space)]).unwrap();
        assert!((-1.0..=1.0).contains(&mean), "{space}: {mean}");
    }
    assert_eq!(of("muster_team_returns_per_robot_minute", "auditor"), 0.0);
    let alerts = |kind| value(&first, "muster_alerts_open", &[("kind", kind)]);
    for kind in ["cut_off", "poor", "modality_doubted", "history_degraded"] {
        assert!((0.0..9.0).contains(&alerts(kind).unwrap()), "{kind}");
    }
    for modality in ["spatial", "connectivity", "hierarchy"] {
        let trust = value(&first, "muster_modality_trust", &[("modality", modality)]);
        assert!((0.0..=1.0).contains(&trust.unwrap()), "{modality}: {trust:?}");
    }
    let embedder = |name: &str| of(&format!("muster_{name}"), "embedder");
    assert!((0.0..1e-6).contains(&embedder("katz_residual")));
    assert!((0.0..1e-3).contains(&embedder("embedding_residual")));
    let (rho, alpha) = (embedder("spectral_radius"), embedder("katz_alpha"));
    assert!(rho > 0.0 && alpha > 0.0 && alpha * rho < 1.0, "{alpha} {rho}");
    let modes =
        ["dense", "cached"].map(|mode| value(&first, "muster_embeddings_total", &[("mode", mode)]));
    assert!(modes.iter().flatten().sum::<f64>() > 0.0);
    let process = |name: &str| value(&first, name, &[]).unwrap_or_else(|| panic!("{name}"));
    assert!(process("muster_build_info") == 1.0);
    assert!((1e6..1e10).contains(&process("process_resident_memory_bytes")));
    assert!(process("process_start_time_seconds") > 1.7e9);
    assert!(process("process_threads") > 1.0 && process("process_open_fds") > 1.0);
    assert!(process("process_max_fds") >= process("process_open_fds"));
    assert!((1e-2..1e4).contains(&process("process_cpu_seconds_total")));

    // Counters only grow, and those of a live fleet do.
    std::thread::sleep(Duration::from_secs(1));
    let second = samples(&address);
    for ((name, labels), value) in &first {
        if name.ends_with("_total") || name.ends_with("_count") || name.ends_with("_bucket") {
            let later = second[&(name.clone(), labels.clone())];
            assert!(later >= *value, "{name} {labels:?} fell from {value} to {later}");
        }
    }
    let age = |samples| value(samples, "muster_data_age_seconds_count", &[("service", "auditor")]);
    assert!(age(&second) > age(&first));
}

#[test]
fn the_port_is_off_by_default_and_a_taken_one_is_reported() {
    let (code, printed, _) = run("muster-ingest", &["--print-config"], SOON).unwrap();
    assert_eq!(code, Some(0));
    assert!(printed.contains("# http is not set  # default"), "{printed}");
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    for program in
        [&["muster-ingest"][..], &["muster", "up"], &["muster", "demo"], &["muster", "router"]]
    {
        let endpoint = free_endpoint().unwrap();
        let place = match program.last() {
            Some(&"router" | &"demo") => ["--listen", &endpoint],
            _ => ["--connect", &endpoint],
        };
        let arguments = [&program[1..], &["--http", &address], &place].concat();
        let (code, _, err) = run(program[0], &arguments, SOON).unwrap();
        assert_eq!(code, Some(1), "{program:?}: {err}");
        assert!(err.contains("--http") && err.contains(&address), "{program:?}: {err}");
    }
    let (code, _, err) = run("muster-ingest", &["--http", "localhost"], SOON).unwrap();
    assert_eq!(code, Some(2));
    assert!(err.contains("http") && err.contains("127.0.0.1:9464"), "{err}");
}

#[test]
fn logs_name_service_instance_and_fleet_and_follow_its_life() {
    let endpoint = free_endpoint().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let mut router = start_router(&endpoint, folder.path()).unwrap();
    let arguments =
        ["--connect", &endpoint, "--fleet", "alpha", "--state-directory", "none", "--log-json"];
    let mut ingest = Process::start("muster-ingest", &arguments, &[], folder.path()).unwrap();
    let says = |ingest: &Process, what: &str| ingest.output().contains(what);
    until("it leads", || says(&ingest, "ingest leads"));
    router.kill().unwrap();
    until("it has lost its link", || says(&ingest, "link to the router is lost"));
    let _router = start_router(&endpoint, folder.path()).unwrap();
    until("the link is back", || says(&ingest, "link to the router is back"));
    ingest.signal("TERM").unwrap();
    assert_eq!(ingest.wait(Duration::from_secs(5)).unwrap().code(), Some(0));
    let output = ingest.output();
    let lines: Vec<Value> =
        output.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let text = |line: &Value| line["fields"]["message"].as_str().unwrap_or_default().to_owned();
    for (step, at_most) in [
        ("ingest serves fleet alpha", 1),
        // Once more when a suspect leader leads again.
        ("ingest leads", 2),
        ("the link to the router is lost", 1),
        ("the link to the router is back", 1),
        ("ingest ends", 1),
        ("ingest has stopped", 1),
    ] {
        let found: Vec<_> = lines.iter().filter(|line| text(line).contains(step)).collect();
        assert!((1..=at_most).contains(&found.len()), "{step:?} in\n{output}");
        assert_eq!(found[0]["span"]["service"], "ingest", "{}", found[0]);
        assert_eq!(found[0]["span"]["fleet"], "alpha");
        assert!(found[0]["span"]["instance"].as_str().is_some_and(|name| !name.is_empty()));
    }
}

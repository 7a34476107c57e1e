//! The port of a process: what it answers, what it refuses, and what it reports of a core that hangs.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod common;

use std::collections::BTreeSet;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use common::{config, connected, options, passive_core, router};
use muster_model::content::Checked;
use muster_model::embedding::{Embedding, EmbeddingGraph, EmbeddingMode, EmbeddingQuality};
use muster_model::header::{Header, Revision};
use muster_model::id::{FleetId, InstanceId, Modality, RobotId, ServiceName};
use muster_model::observation::Stream;
use muster_model::role::ReplicaState;
use muster_model::settings::IngestSettings;
use muster_model::status::ServiceStatus;
use muster_model::time::Tick;
use muster_runtime::bus::{Bus, ConnectTimeout};
use muster_runtime::config::{ProcessArgs, ProcessConfig};
use muster_runtime::observe::{Observatory, Queues};
use muster_runtime::shell::{self, ServiceOptions};
use muster_runtime::stop;
use muster_service::{Context, Core, Delivery, Get, Stopwatch, Subscription, View, Wiring};
use muster_wire::{Key, Message, Outbound, Pattern};

/// How long the core below hangs over a pose: longer than a loop may, and not for ever.
const HANGS: Duration = Duration::from_secs(9);

/// How long a test waits for what should come soon.
const SOON: Duration = Duration::from_secs(15);

/// Scrapes next to a service that publishes without a pause: a gap of a microsecond is seen in some of them.
const SCRAPES: usize = 300;

/// A core that hangs over every pose.
struct Sleeper;

impl Core for Sleeper {
    passive_core!();

    type Settings = IngestSettings;
    type Job = ();
    type Done = ();
    const SERVICE: ServiceName = ServiceName::Ingest;

    fn wiring() -> Wiring {
        let poses =
            Subscription { pattern: Pattern::Stream(Stream::Pose), delivery: Delivery::Latest };
        Wiring { subscriptions: vec![poses], ..Wiring::default() }
    }

    fn output() -> Key {
        Key::Roster
    }

    fn new(_: Tick, _: &IngestSettings) -> Self {
        Self
    }

    fn on_lead(&mut self, _: &mut Context<'_, Self>, _: Vec<Message>) {}

    fn on_message(&mut self, _: &mut Context<'_, Self>, message: Message) {
        if matches!(message, Message::Report(_)) {
            std::thread::sleep(HANGS);
        }
    }

    fn deadline(&self, _: &View<'_, Self>) -> Option<Tick> {
        None
    }

    fn run((): (), _: &mut Stopwatch) {}
}

fn with_port(connect: &str) -> ProcessConfig {
    config(ProcessArgs { http: Some("127.0.0.1:0".to_owned()), ..connected(connect) })
}

/// Sends bytes and returns everything that is answered until the connection closes.
fn exchange(address: SocketAddr, request: &[u8]) -> String {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(SOON)).unwrap();
    // The other end may refuse before everything is sent.
    let _ = stream.write_all(request);
    let mut answer = Vec::new();
    let _ = stream.read_to_end(&mut answer);
    String::from_utf8_lossy(&answer).into_owned()
}

fn get(address: SocketAddr, path: &str) -> (u16, String) {
    let answer = exchange(address, format!("GET {path} HTTP/1.1\r\nHost: x\r\n\r\n").as_bytes());
    let code = answer.split(' ').nth(1).and_then(|code| code.parse().ok()).unwrap_or_default();
    (code, answer.split_once("\r\n\r\n").map(|(_, body)| body.to_owned()).unwrap_or_default())
}

fn until(what: &str, right: impl Fn() -> bool) {
    let start = Instant::now();
    while !right() {
        assert!(start.elapsed() < SOON, "{what}");
        std::thread::sleep(Duration::from_millis(50));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn healthz_reports_a_core_that_hangs_and_one_that_goes_on() {
    let (router, endpoint) = router().await;
    let client = with_port(&endpoint);
    let observatory = Observatory::open(&client, &[ServiceName::Ingest]).unwrap();
    let address = observatory.address().unwrap();
    let before = get(address, "/readyz");
    assert_eq!(get(address, "/healthz").0, 200, "it waits for its router");
    assert_eq!(before.0, 503);
    assert!(before.1.contains("no router has answered yet"), "{}", before.1);

    let bus = Bus::open(&client, ConnectTimeout::Never).await.unwrap();
    let observer = observatory.observer(ServiceName::Ingest);
    let options = ServiceOptions { observer, ..options::<Sleeper>(IngestSettings::default()) };
    let (stopper, stop) = stop::channel();
    let service = tokio::spawn(shell::run::<Sleeper>(bus, options, stop));
    until("it becomes ready", || get(address, "/readyz").0 == 200);
    assert_eq!(get(address, "/healthz").0, 200);

    let key = Key::Stream(RobotId::new("r1").unwrap(), Stream::Pose);
    let payload = br#"{"x":1,"y":2}"#.to_vec();
    router.put(Outbound { key, encoding: "".into(), payload, attachment: None }).unwrap();
    until("a loop that hangs is dead", || get(address, "/healthz").0 == 503);
    let (code, body) = get(address, "/readyz");
    assert_eq!(code, 503);
    assert!(body.contains("the loop has not turned"), "{body}");
    assert!(
        get(address, "/metrics")
            .1
            .contains("muster_loop_turning{fleet=\"default\",service=\"ingest\"} 0")
    );
    until("it goes on", || get(address, "/healthz").0 == 200 && get(address, "/readyz").0 == 200);
    stopper.stop();
    service.await.unwrap().unwrap();
}

#[test]
fn healthz_reports_a_router_whose_loop_hangs() {
    let observatory = Observatory::open(&with_port("tcp/127.0.0.1:1"), &[]).unwrap();
    let address = observatory.address().unwrap();
    let (code, body) = get(address, "/healthz");
    assert_eq!(code, 200, "a router that does not listen yet has no loop");
    assert!(!body.contains("router"), "{body}");
    observatory.router_turned();
    let (code, body) = get(address, "/healthz");
    assert_eq!(code, 200);
    assert!(body.contains(r#""router":{"alive":true"#), "{body}");
    until("a loop that hangs is dead", || get(address, "/healthz").0 == 503);
    let (_, body) = get(address, "/healthz");
    assert!(body.starts_with(r#"{"alive":false,"router":{"alive":false"#), "{body}");
    observatory.router_turned();
    assert_eq!(get(address, "/healthz").0, 200, "it goes on");
}

/// A status with these counters, of a service that leads.
fn status(service: ServiceName, counters: &[(&str, u64)]) -> ServiceStatus {
    ServiceStatus {
        fleet: FleetId::new("alpha").unwrap(),
        service,
        instance: InstanceId::new("i1").unwrap(),
        version: "1".to_owned(),
        started: Tick(0),
        now: Tick(1),
        standing: ReplicaState::Leading,
        revision: Revision::default(),
        state: String::new(),
        counters: counters.iter().map(|(name, count)| ((*name).to_owned(), *count)).collect(),
        departed: Vec::new(),
    }
}

#[test]
fn counters_are_metrics_and_what_may_fall_is_a_gauge_that_falls() {
    let service = ServiceName::Historian;
    let observatory = Observatory::open(&with_port("tcp/127.0.0.1:1"), &[service]).unwrap();
    let observer = observatory.observer(service);
    let metrics = |counters: &[(&str, u64)]| {
        observer.turned(&status(service, counters), &Queues::default(), None);
        get(observatory.address().unwrap(), "/metrics").1
    };
    let full = [
        ("records_made", 7),
        ("jobs_failed", 2),
        ("state_unwritable", 1),
        ("history_degraded", 1),
        ("history_bytes", 4096),
        ("recorded_through", 1_700_000_000_500_000),
    ];
    let while_full = metrics(&full);
    let cleared = metrics(&full[..2]);
    for (metric, full, after) in [
        ("records_made_total", "7", "7"),
        ("jobs_failed_total", "2", "2"),
        ("state_lost", "0", "0"),
        ("state_unwritable", "1", "0"),
        ("history_degraded", "1", "0"),
        ("history_bytes", "4096", "0"),
        // The moment of the last record stays what it was.
        ("history_recorded_through_timestamp_seconds", "1700000000.5", "1700000000.5"),
    ] {
        let sample = format!("muster_{metric}{{fleet=\"default\",service=\"historian\"}} ");
        for (text, value) in [(&while_full, full), (&cleared, after)] {
            let found = text.lines().find_map(|line| line.strip_prefix(&sample));
            assert_eq!(found, Some(value), "{metric} in\n{text}");
        }
    }
    let families =
        cleared.lines().filter(|line| line.starts_with("# TYPE muster_jobs_failed ")).count();
    assert_eq!(families, 1, "{cleared}");
}

/// An embedding without robots that trusts these modalities as much as can be.
fn embedding(modalities: &[&str]) -> Message {
    let graph = |name: &&str| EmbeddingGraph {
        modality: Modality::new(*name).unwrap(),
        revision: Revision::default(),
        weight: 1.0,
        trust: 1.0,
    };
    let header = Header {
        fleet: FleetId::new("alpha").unwrap(),
        revision: Revision::default(),
        oldest: None,
        newest: None,
        stages: Vec::new(),
    };
    let quality = EmbeddingQuality {
        spectral_radius: (1.0, 1.0),
        alpha: 0.5,
        singular_values: Vec::new(),
        next_singular_value: 0.0,
        residual: 0.0,
        katz_residual: 0.0,
        gap: 0.0,
        ambiguous: false,
        mode: EmbeddingMode::Cached,
        teams_shown: None,
        team_scores: Vec::new(),
        stage_us: [0; 3],
    };
    Message::Embedding(Checked::new_unchecked(Embedding {
        header,
        roster: Revision::default(),
        graphs: modalities.iter().map(graph).collect(),
        robots: Vec::new(),
        dimension: 2,
        values: Vec::new(),
        without_embedding: Vec::new(),
        provisional: Vec::new(),
        centrality: Vec::new(),
        quality,
    }))
}

#[test]
fn a_scrape_sees_the_trust_in_each_modality_whenever_it_comes() {
    let service = ServiceName::Embedder;
    let observatory = Observatory::open(&with_port("tcp/127.0.0.1:1"), &[service]).unwrap();
    let (address, observer) = (observatory.address().unwrap(), observatory.observer(service));
    let shown = || -> Vec<String> {
        let text = get(address, "/metrics").1;
        let lines = text.lines().filter(|line| line.starts_with("muster_modality_trust{"));
        lines.filter_map(|line| Some(line.split_once("modality=")?.1.to_owned())).collect()
    };
    let both = embedding(&["hierarchy", "spatial"]);
    observer.published(&both, 0, Tick(0));
    let is_over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            while !is_over.load(Ordering::Relaxed) {
                observer.published(&both, 0, Tick(0));
            }
        });
        let all: BTreeSet<Vec<String>> = (0..SCRAPES)
            .map(|_| {
                let mut shown = shown();
                shown.sort_unstable();
                shown
            })
            .collect();
        is_over.store(true, Ordering::Relaxed);
        let whole = ["\"hierarchy\"} 1.0", "\"spatial\"} 1.0"].map(str::to_owned).to_vec();
        assert_eq!(all, BTreeSet::from([whole]));
    });
    observer.published(&embedding(&["spatial"]), 0, Tick(0));
    assert_eq!(shown(), ["\"spatial\"} 1.0"], "one that is no longer declared has no trust");
}

#[test]
fn the_port_answers_three_paths_to_get_and_head_and_nothing_else() {
    let observatory = Observatory::open(&with_port("tcp/127.0.0.1:1"), &ServiceName::ALL).unwrap();
    let address = observatory.address().unwrap();
    assert_eq!(get(address, "/healthz").0, 200);
    assert_eq!(get(address, "/readyz").0, 503);
    assert_eq!(get(address, "/metrics?x=1").0, 200);
    for path in ["/", "/metrics/", "/%2e%2e/etc/passwd", "/healthz/x"] {
        assert_eq!(get(address, path).0, 404, "{path}");
    }
    for method in ["POST", "PUT", "DELETE", "OPTIONS"] {
        let answer = exchange(
            address,
            format!("{method} /metrics HTTP/1.1\r\nHost: x\r\nContent-Length: 0\r\n\r\n")
                .as_bytes(),
        );
        assert!(answer.starts_with("HTTP/1.1 405"), "{answer}");
        assert!(answer.to_lowercase().contains("allow: get, head"), "{answer}");
    }
    let head = exchange(address, b"HEAD /healthz HTTP/1.1\r\nHost: x\r\n\r\n");
    assert!(head.starts_with("HTTP/1.1 200") && head.ends_with("\r\n\r\n"), "{head}");
    for garbage in
        [&b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc"[..], b"GET\r\n\r\n", b"\0\0\0\0\r\n\r\n"]
    {
        let answer = exchange(address, garbage);
        assert!(!answer.starts_with("HTTP/1.1 200"), "{answer}");
    }
    let long = format!("GET /healthz HTTP/1.1\r\nX: {}\r\n\r\n", "x".repeat(100_000));
    assert!(!exchange(address, long.as_bytes()).starts_with("HTTP/1.1 200"));
    let many = format!("GET /healthz HTTP/1.1\r\n{}\r\n", "X: y\r\n".repeat(1000));
    assert!(!exchange(address, many.as_bytes()).starts_with("HTTP/1.1 200"));
    assert_eq!(get(address, "/healthz").0, 200, "none of it has hurt");
}

#[test]
fn clients_that_send_nothing_take_neither_the_port_nor_time() {
    let observatory = Observatory::open(&with_port("tcp/127.0.0.1:1"), &[]).unwrap();
    let address = observatory.address().unwrap();
    let slow: Vec<_> = (0..200).filter_map(|_| TcpStream::connect(address).ok()).collect();
    let mut drip = TcpStream::connect(address).unwrap();
    let _ = drip.write_all(b"GET /healthz HTTP/1.1\r\nX: ");
    assert!(slow.len() > 100);
    // None of them closes, and the port does not wait until their time is over.
    let begun = Instant::now();
    assert_eq!(get(address, "/healthz").0, 200);
    assert!(begun.elapsed() < Duration::from_secs(3), "{:?}", begun.elapsed());
    drop(slow);
}

#[test]
fn the_error_of_a_port_that_is_taken_names_the_flag() {
    let first = Observatory::open(&with_port("tcp/127.0.0.1:1"), &[]).unwrap();
    let address = first.address().unwrap().to_string();
    let again = config(ProcessArgs { http: Some(address.clone()), ..ProcessArgs::default() });
    let problem = Observatory::open(&again, &[]).unwrap_err().to_string();
    assert!(problem.contains("--http") && problem.contains(&address), "{problem}");
    drop(first);
    until("the port closes with its process's observatory", || {
        Observatory::open(&again, &[]).is_ok()
    });
}

//! `muster doctor` on fleets that are well, and on fleets with one fault each.

use std::collections::BTreeSet;
use std::io::Write;
use std::net::TcpListener;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use muster_tests::SOON;
use muster_tests::client::Client;
use muster_tests::cluster::{Cluster, Robots, SERVICES, start_router};
use muster_tests::ports::free_endpoint;
use muster_tests::process::{Process, run};
use serde_json::{Value, json};

/// One look of the doctor: its exit code and its report.
fn look(endpoint: &str, fleet: &str, listen_for: &str) -> (i32, Value) {
    let arguments =
        ["doctor", "--json", "--fleet", fleet, "--connect", endpoint, "--listen-for", listen_for];
    let (code, out, err) = run("muster", &arguments, SOON).unwrap();
    let report = serde_json::from_str(&out).unwrap_or_else(|_| panic!("{out}{err}"));
    (code.unwrap(), report)
}

/// The finding of a name, if there is one.
fn found<'a>(report: &'a Value, id: &str) -> Option<&'a Value> {
    report["findings"].as_array().unwrap().iter().find(|finding| finding["id"] == id)
}

fn subjects(finding: &Value) -> BTreeSet<&str> {
    finding["subjects"].as_array().unwrap().iter().filter_map(Value::as_str).collect()
}

/// Looks until everything is well.
fn until_well(cluster: &Cluster) {
    let start = Instant::now();
    loop {
        let (code, report) = look(&cluster.endpoint, &cluster.fleet, "1");
        if code == 0 {
            assert_eq!(report["healthy"], true);
            assert_eq!(report["findings"], json!([]));
            return;
        }
        assert_eq!(code, 1, "{report}");
        assert!(start.elapsed() < SOON, "it is not well: {report:#}");
    }
}

/// Looks until something is found, and checks that the finding has a remedy.
fn until_found(cluster: &Cluster, id: &str, remedy: &str) -> Value {
    until_found_when(cluster, id, remedy, |_| true)
}

/// The same once the whole report is right: services come back one by one after a router does.
fn until_found_when(
    cluster: &Cluster,
    id: &str,
    remedy: &str,
    right: impl Fn(&Value) -> bool,
) -> Value {
    let start = Instant::now();
    loop {
        let (code, report) = look(&cluster.endpoint, &cluster.fleet, "1");
        if let Some(finding) = found(&report, id).filter(|_| right(&report)) {
            assert_eq!(code, 1);
            assert_eq!(report["healthy"], false);
            assert!(matches!(finding["severity"].as_str(), Some("error" | "warning")), "{finding}");
            assert!(!finding["seen"].as_str().unwrap().is_empty());
            let text = finding["remedy"].as_str().unwrap();
            assert!(text.contains(remedy), "{id}: {text}");
            return report;
        }
        assert!(start.elapsed() < SOON, "{id} is not found: {report:#}");
    }
}

fn robots(cluster: &Cluster) -> Robots {
    cluster.robots(&["--scenario", "clusters", "--robots", "8"]).unwrap()
}

fn now() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs_f64()
}

#[test]
fn no_router_is_reported_with_what_answers_instead() {
    let problem = |endpoint: &str| {
        let (code, report) = look(endpoint, "alpha", "1");
        assert_eq!(code, 3, "{report}");
        assert_eq!(report["healthy"], false);
        let finding = found(&report, "no_router").unwrap_or_else(|| panic!("{report}"));
        assert_eq!(finding["severity"], "error");
        assert_eq!(subjects(finding), BTreeSet::from([endpoint]));
        let answer = report["routers"][0]["answer"].as_str().unwrap().to_owned();
        (
            answer,
            finding["seen"].as_str().unwrap().to_owned(),
            finding["remedy"].as_str().unwrap().to_owned(),
        )
    };
    let free = free_endpoint().unwrap();
    let (answer, _, remedy) = problem(&free);
    assert_eq!(answer, "refused");
    assert!(remedy.contains("muster router"), "{remedy}");
    let (answer, ..) = problem("tcp/no-such-host.invalid:7447");
    assert_eq!(answer, "unknown_host");
    // Something that sends first, something that answers, and something that never sends.
    for (sends, expected) in [(Some("SSH-2.0-OpenSSH\r\n"), "SSH-2.0"), (None, "sends nothing")] {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let endpoint = format!("tcp/{}", listener.local_addr().unwrap());
        std::thread::spawn(move || {
            let mut kept = Vec::new();
            for stream in listener.incoming() {
                let mut stream = stream.unwrap();
                if let Some(sends) = sends {
                    let _ = stream.write_all(sends.as_bytes());
                }
                kept.push(stream);
            }
        });
        let (answer, seen, remedy) = problem(&endpoint);
        assert_eq!(answer, "foreign");
        assert!(seen.contains(expected) && remedy.contains("port"), "{seen} {remedy}");
    }
    // The control: a router, and nothing else.
    let folder = tempfile::tempdir().unwrap();
    let _router = start_router(&free, folder.path()).unwrap();
    let (code, report) = look(&free, "alpha", "1");
    assert_eq!(code, 1);
    assert_eq!(report["routers"], json!([{"endpoint": free, "answer": "zenoh", "lease_s": 2.0}]));
    let missing = report["findings"].as_array().unwrap();
    assert_eq!(missing.len(), 4, "{report}");
    assert!(missing.iter().all(|finding| finding["id"] == "service_missing"));
    // One of two routers is enough; the other is still reported as missing.
    let gone = free_endpoint().unwrap();
    let (code, report) = look(&format!("{gone},{free}"), "alpha", "1");
    assert_eq!(code, 1);
    let finding = found(&report, "no_router").unwrap();
    assert_eq!(finding["severity"], "warning");
    assert_eq!(subjects(finding), BTreeSet::from([gone.as_str()]));
    let (code, _, err) = run("muster", &["doctor", "--listen-for", "-1"], SOON).unwrap();
    assert_eq!(code, Some(2), "{err}");
}

#[tokio::test(flavor = "multi_thread")]
async fn faults_of_services_and_settings_are_found_and_gone_again() {
    let mut cluster = Cluster::start("alpha", &[("clusterer", "teams=2")]).unwrap();
    cluster.service("embedder").unwrap().kill().unwrap();
    let _robots = robots(&cluster);
    until_found_when(&cluster, "service_missing", "muster up embedder", |report| {
        found(report, "service_missing")
            .is_some_and(|finding| subjects(finding) == BTreeSet::from(["embedder"]))
    });
    until_found(&cluster, "no_teams", "muster status");
    cluster.start_service("embedder").unwrap();
    until_well(&cluster);
    let before =
        cluster.client().await.unwrap().get_one("service/clusterer/settings").await.unwrap();
    let (_, report) = look(&cluster.endpoint, "alpha", "1");
    let keys: BTreeSet<_> = report.as_object().unwrap().keys().map(String::as_str).collect();
    let promised = [
        "fleet",
        "version",
        "healthy",
        "routers",
        "services",
        "robots",
        "other_fleets",
        "findings",
        "notes",
    ];
    assert_eq!(keys, BTreeSet::from(promised));
    let services: Vec<_> = report["services"]
        .as_array()
        .unwrap()
        .iter()
        .map(|s| s["service"].as_str().unwrap())
        .collect();
    assert_eq!(services, SERVICES);
    let expected = json!({"known": 8, "active": 8, "stale": 0, "placed": 8, "tokens": 8});
    assert_eq!(report["robots"], expected);

    let (code, report) = look(&cluster.endpoint, "beta", "1");
    assert_eq!(code, 1);
    let wrong = found(&report, "wrong_fleet").unwrap();
    assert_eq!(subjects(wrong), BTreeSet::from(["alpha"]));
    assert!(wrong["remedy"].as_str().unwrap().contains("--fleet alpha"), "{wrong}");

    // The radius of other graphs is known only once they are embedded, so that this is accepted.
    cluster.muster(&["set", "embedder", "alpha=1000", "self_loops=0.4"]).unwrap();
    let report = until_found(&cluster, "jobs_failing", "muster set embedder");
    let failing = found(&report, "jobs_failing").unwrap();
    assert!(failing["seen"].as_str().unwrap().contains("alpha"), "{failing}");
    let mended = ["set", "embedder", "alpha={\"fraction\":0.5}", "self_loops=null"];
    cluster.muster(&mended).unwrap();
    until_well(&cluster);

    cluster.muster(&["set", "clusterer", "teams=50"]).unwrap();
    until_found(&cluster, "too_many_teams", "muster set clusterer teams=8");
    cluster.muster(&["set", "clusterer", "teams=2"]).unwrap();
    until_well(&cluster);

    // A service that hangs: its division grows old, and it does not answer.
    cluster.service("embedder").unwrap().signal("STOP").unwrap();
    until_found(&cluster, "data_old", "stages");
    cluster.service("embedder").unwrap().signal("CONT").unwrap();
    until_well(&cluster);
    let after =
        cluster.client().await.unwrap().get_one("service/clusterer/settings").await.unwrap();
    assert_eq!(before, after, "the doctor changes no setting");
}

/// A second instance of `ingest` on another host, as seen from outside: it answers for itself and
/// has a token.
async fn second_ingest(client: &Client, status: Value) -> impl Drop + use<> {
    let name = "service/ingest/other-host-1";
    let token = client.token(name).await.unwrap();
    let key = client.key("service/ingest/status");
    let own = key.clone();
    let queryable = client
        .session()
        .declare_queryable(key)
        .callback(move |query| {
            let mut status = status.clone();
            let offset = status["offset_s"].as_f64().unwrap();
            status.as_object_mut().unwrap().remove("offset_s");
            let moment = ((now() + offset) * 1e6) as u64;
            status["now"] = moment.into();
            status["started"] = moment.into();
            let query = query.clone();
            let own = own.clone();
            tokio::task::block_in_place(|| zenoh::Wait::wait(query.reply(own, status.to_string())))
                .unwrap();
        })
        .await
        .unwrap();
    Both(Some((token, queryable)))
}

struct Both<T>(Option<T>);

impl<T> Drop for Both<T> {
    fn drop(&mut self) {
        drop(self.0.take());
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_second_instance_is_reported_by_version_clock_and_role() {
    let cluster = Cluster::start("alpha", &[("clusterer", "teams=2")]).unwrap();
    let _robots = robots(&cluster);
    until_well(&cluster);
    let client = cluster.client().await.unwrap();
    let status = |standing: &str, version: &str, offset_s: f64| {
        json!({
            "fleet": "alpha", "service": "ingest", "instance": "other-host-1", "version": version,
            "standing": standing, "revision": {"term": 1, "epoch": 1}, "state": "8 robots, 0 stale",
            "counters": {}, "offset_s": offset_s,
        })
    };
    let version = env!("CARGO_PKG_VERSION");
    for (standing, version, offset_s, id, remedy) in [
        ("holding", version, 0.0, "two_holders", "end all but one"),
        ("standby", "0.0.9", 0.0, "version_skew", "same version"),
        ("standby", version, -30.0, "clock_off", "chrony"),
    ] {
        let other = second_ingest(&client, status(standing, version, offset_s)).await;
        let alone =
            |report: &Value| report["findings"].as_array().is_some_and(|all| all.len() == 1);
        let report = tokio::task::block_in_place(|| until_found_when(&cluster, id, remedy, alone));
        let seen = found(&report, id).unwrap()["seen"].as_str().unwrap();
        assert!(seen.contains("other-host-1"), "{seen}");
        drop(other);
        tokio::task::block_in_place(|| until_well(&cluster));
    }
}

#[test]
fn a_standby_is_no_fault_and_is_listed() {
    let cluster = Cluster::start("alpha", &[("clusterer", "teams=2")]).unwrap();
    let _robots = robots(&cluster);
    until_well(&cluster);
    let arguments =
        ["--fleet", "alpha", "--connect", &cluster.endpoint, "--state-directory", "none"];
    let _second = Process::start("muster-ingest", &arguments, &[], cluster.folder()).unwrap();
    let start = Instant::now();
    loop {
        let (code, report) = look(&cluster.endpoint, "alpha", "1");
        let services = report["services"].as_array().unwrap();
        let ingests = services.iter().filter(|service| service["service"] == "ingest");
        let mut standings: Vec<_> =
            ingests.map(|ingest| ingest["standing"].as_str().unwrap()).collect();
        standings.sort_unstable();
        if standings == ["holding", "standby"] && code == 0 {
            return;
        }
        assert!(start.elapsed() < SOON, "{report:#}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn faults_of_robots_are_found_and_gone_again() {
    let cluster =
        Cluster::start("alpha", &[("ingest", "max_robots=9"), ("clusterer", "teams=2")]).unwrap();
    until_found(&cluster, "no_robots", "muster robot");
    let client = cluster.client().await.unwrap();
    let elsewhere = Client::connect(&cluster.endpoint, "alhpa").await.unwrap();
    let lost = elsewhere.token("robot/r1").await.unwrap();
    let report = until_found(&cluster, "robots_elsewhere", "muster/v1/alpha/");
    assert_eq!(report["other_fleets"], json!([{"fleet": "alhpa", "services": 0, "robots": 1}]));
    lost.undeclare().await.unwrap();
    let fleet = robots(&cluster);
    until_well(&cluster);

    // A token and nothing else: known, and nowhere.
    let token = client.token("robot/x1").await.unwrap();
    let report = until_found(&cluster, "no_poses", "robot/{robot}/pose");
    assert_eq!(subjects(found(&report, "no_poses").unwrap()), BTreeSet::from(["x1"]));
    let report = until_found(&cluster, "no_team", "muster graph");
    assert_eq!(subjects(found(&report, "no_team").unwrap()), BTreeSet::from(["x1"]));
    // The fleet is full with it: one more is not let in.
    let more = client.token("robot/x2").await.unwrap();
    let report = until_found(&cluster, "robots_unknown", "max_robots");
    assert_eq!(subjects(found(&report, "robots_unknown").unwrap()), BTreeSet::from(["x2"]));
    more.undeclare().await.unwrap();

    // It reports, with a clock an hour behind.
    let speaking = |stamp: fn() -> f64, x: Value| {
        let client = client.clone();
        tokio::spawn(async move {
            loop {
                let pose = json!({"x": x, "y": 0.0, "stamp": stamp()});
                client.put("robot/x1/pose", &pose).await.unwrap();
                tokio::time::sleep(Duration::from_millis(200)).await;
            }
        })
    };
    let speech = speaking(|| now() - 3600.0, json!(1.0));
    let report = until_found(&cluster, "clock_off", "chrony");
    assert_eq!(subjects(found(&report, "clock_off").unwrap()), BTreeSet::from(["x1"]));
    speech.abort();
    let speech = speaking(now, json!(1.0));
    until_well(&cluster);
    speech.abort();
    // Another one may be late for a moment.
    until_found_when(&cluster, "robots_stale", "stale_after_s", |report| {
        found(report, "robots_stale")
            .is_some_and(|finding| subjects(finding) == BTreeSet::from(["x1"]))
    });
    let speech = speaking(now, json!("far"));
    let start = Instant::now();
    let reason = loop {
        let (_, report) = look(&cluster.endpoint, "alpha", "3");
        if let Some(refused) = found(&report, "refused") {
            assert_eq!(subjects(refused), BTreeSet::from(["x1"]));
            break refused["seen"].as_str().unwrap().to_owned();
        }
        assert!(start.elapsed() < SOON, "{report:#}");
    };
    assert!(reason.contains("JSON"), "{reason}");
    speech.abort();
    token.undeclare().await.unwrap();
    until_well(&cluster);
    drop(fleet);
}

#[tokio::test(flavor = "multi_thread")]
async fn robots_that_report_no_links_are_found() {
    let cluster = Cluster::start("alpha", &[("clusterer", "teams=2")]).unwrap();
    let client = cluster.client().await.unwrap();
    let mut tokens = Vec::new();
    for robot in 0..4 {
        tokens.push(client.token(&format!("robot/r{robot}")).await.unwrap());
        let client = client.clone();
        tokio::spawn(async move {
            loop {
                let pose = json!({"x": robot, "y": 0, "stamp": now()});
                client.put(&format!("robot/r{robot}/pose"), &pose).await.unwrap();
                tokio::time::sleep(Duration::from_millis(200)).await;
            }
        });
    }
    until_found(&cluster, "no_links", "robot/{robot}/links");
    client
        .put("robot/r0/links", &json!({"links": [{"peer": "r1", "quality": 0.9}]}))
        .await
        .unwrap();
    until_well(&cluster);
}

#[test]
fn robots_that_change_teams_to_and_fro_are_found() {
    let cluster = Cluster::start("alpha", &[]).unwrap();
    let _robots = robots(&cluster);
    until_well(&cluster);
    // With every third team that comes and goes, its robots leave another team and come back into it.
    let start = Instant::now();
    let report = loop {
        for teams in ["teams=3", "teams=2"] {
            cluster.muster(&["set", "clusterer", teams]).unwrap();
            std::thread::sleep(Duration::from_secs(1));
        }
        let (_, report) = look(&cluster.endpoint, "alpha", "1");
        if found(&report, "teams_flapping").is_some() {
            break report;
        }
        assert!(start.elapsed() < SOON, "it is not found: {report:#}");
    };
    let flapping = found(&report, "teams_flapping").unwrap();
    assert!(flapping["remedy"].as_str().unwrap().contains("teams=auto"), "{flapping}");
    assert!(!subjects(flapping).is_empty(), "{flapping}");
    // An operator who expects that raises the threshold.
    cluster.muster(&["set", "auditor", "flapping=1000"]).unwrap();
    until_well(&cluster);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_router_that_denies_or_has_a_long_lease_is_reported() {
    let mut cluster = Cluster::start("alpha", &[("clusterer", "teams=2")]).unwrap();
    let _robots = robots(&cluster);
    until_well(&cluster);
    let router_with = |cluster: &Cluster, config: &Value| {
        let path = cluster.folder().join("router.json5");
        std::fs::write(&path, config.to_string()).unwrap();
        let path = path.to_string_lossy().into_owned();
        let arguments = ["router", "--listen", &cluster.endpoint, "--zenoh-config", &path];
        Process::start("muster", &arguments, &[], cluster.folder()).unwrap()
    };
    let denying = |messages: &[&str], keys: &[&str]| {
        json!({"access_control": {
            "enabled": true, "default_permission": "allow",
            "rules": [{"id": "deny", "messages": messages, "flows": ["ingress", "egress"],
                       "permission": "deny", "key_exprs": keys}],
            "subjects": [{"id": "all"}],
            "policies": [{"rules": ["deny"], "subjects": ["all"]}],
        }})
    };
    cluster.kill_router().unwrap();
    let mut router =
        router_with(&cluster, &json!({"transport": {"link": {"tx": {"lease": 8000}}}}));
    let report = until_found(&cluster, "router_lease", "transport.link.tx.lease");
    assert_eq!(report["routers"][0]["lease_s"], 8.0);
    router.kill().unwrap();

    let keys = ["muster/v1/alpha/service/*/status"];
    let mut router = router_with(&cluster, &denying(&["query"], &keys));
    const SILENT_DENIALS: &str = "denials of access control are silent";
    until_found_when(&cluster, "service_silent", SILENT_DENIALS, |report| {
        found(report, "service_missing").is_none()
            && subjects(found(report, "service_silent").unwrap()).len() == SERVICES.len()
    });
    router.kill().unwrap();

    let mut router = router_with(&cluster, &denying(&["query"], &["muster/v1/alpha/roster"]));
    until_found_when(&cluster, "access_denied", SILENT_DENIALS, |report| {
        subjects(found(report, "access_denied").unwrap()) == BTreeSet::from(["roster"])
    });
    router.kill().unwrap();

    let messages = ["liveliness_token", "liveliness_query", "declare_liveliness_subscriber"];
    let mut router = router_with(&cluster, &denying(&messages, &["muster/v1/alpha/service/**"]));
    until_found_when(&cluster, "access_denied", "liveliness_token", |report| {
        subjects(found(report, "access_denied").unwrap()) == BTreeSet::from(SERVICES)
    });
    router.kill().unwrap();

    cluster.restart_router().unwrap();
    until_well(&cluster);
}

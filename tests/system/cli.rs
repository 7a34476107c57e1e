//! What an operator types, and what comes back.

use std::time::{Duration, Instant};

use muster_model::content::Checked;
use muster_model::header::{Header, Revision};
use muster_model::id::{FleetId, RobotId, TeamId};
use muster_model::remembered::RememberedTeams;
use muster_model::teams::{Member, Team, Teams};
use muster_model::time::Tick;
use muster_tests::SOON;
use muster_tests::client::Client;
use muster_tests::cluster::{Cluster, SERVICES, start_router};
use muster_tests::ports::free_endpoint;
use muster_tests::process::{Process, run};
use muster_wire::{Message, Outbound};
use serde_json::Value;

use crate::pipeline::{formed, truth};

/// When services that restarted with lower terms are followed, by the documentation of the client: `stale_after`
/// and one heartbeat.
pub(crate) const FOLLOWED_WITHIN: Duration = Duration::from_secs(6);

#[tokio::test(flavor = "multi_thread")]
async fn the_console_shows_the_live_fleet() {
    let cluster = Cluster::start("alpha", &[("clusterer", "teams=2")]).unwrap();
    let scenario = ["--scenario", "clusters", "--robots", "8"];
    let _robots = cluster.robots(&scenario).unwrap();
    let client = cluster.client().await.unwrap();
    formed(&client, &truth(&cluster, &scenario)).await;
    client.watch("json/audit").await.unwrap().until("an audit", SOON, |_| true).await.unwrap();
    let show = |arguments: &[&str]| {
        let (code, out, err) = cluster.muster(arguments).unwrap();
        assert_eq!(code, Some(0), "{arguments:?}: {err}");
        out
    };
    let json = |arguments: &[&str]| -> Value {
        serde_json::from_str(show(arguments).lines().next().unwrap()).unwrap()
    };
    assert!(show(&["teams"]).contains("t2"));
    assert_eq!(json(&["teams", "--json"])["fleet"], "alpha");
    assert!(show(&["audit"]).contains("verdict Good"));
    assert!(json(&["audit", "--json"])["silhouette"]["mean"].is_number());
    let graphs = show(&["graph"]);
    for name in ["spatial", "connectivity", "hierarchy"] {
        assert!(graphs.contains(name), "{graphs}");
    }
    assert!(show(&["graph", "hierarchy"]).contains("weight"));
    assert_eq!(json(&["graph", "spatial", "--json"])["modality"], "spatial");
    let katz = show(&["graph", "--katz", "c1-r1", "c1-r2"]);
    assert!(katz.contains("similarity") && katz.contains("spatial"), "{katz}");
    let pair = json(&["graph", "--katz", "c1-r1", "c1-r2", "--json"]);
    assert_eq!((&pair["from"], &pair["to"]), (&"c1-r1".into(), &"c1-r2".into()));
    let shares: f64 =
        pair["shares"].as_object().unwrap().values().map(|share| share.as_f64().unwrap()).sum();
    let similarity = pair["similarity"].as_f64().unwrap();
    assert!(similarity > 0.0 && (shares - similarity).abs() < 1e-12 * similarity, "{pair}");
    let why = show(&["why", "c1-r1"]);
    assert!(why.starts_with("c1-r1 is in t") && why.contains("hysteresis"), "{why}");
    let reason = json(&["why", "c1-r1", "--json"]);
    let own = &reason["teams"][0];
    assert_eq!((&reason["robot"], &reason["team"]), (&"c1-r1".into(), &own["team"]));
    let pulls = own["modalities"].as_array().unwrap().iter().map(|of| &of["pull"]);
    let parts = pulls.chain(["itself", "spread", "rest", "hysteresis"].map(|part| &own[part]));
    let sum: f64 = parts.map(|part| part.as_f64().unwrap()).sum();
    assert!((sum - own["total"].as_f64().unwrap()).abs() < 1e-9, "{reason}");
    let (code, _, err) = cluster.muster(&["why", "nobody"]).unwrap();
    assert!(code == Some(2) && err.contains("nobody is not a robot of the fleet"), "{err}");
    let status = show(&["status"]);
    for service in SERVICES {
        assert!(status.contains(service), "{status}");
    }
    assert!(status.contains("8 robots: 8 active"), "{status}");
    assert_eq!(json(&["status", "--json"])["robots"].as_array().unwrap().len(), 8);

    let arguments =
        ["teams", "--watch", "--json", "--fleet", "alpha", "--connect", &cluster.endpoint];
    let mut watch = Process::start("muster", &arguments, &[], cluster.folder()).unwrap();
    client.get("service/clusterer/settings", Some(&serde_json::json!({"teams": 4}))).await.unwrap();
    watch.until_prints("\"t4\"", SOON).unwrap();
    watch.signal("INT").unwrap();
    assert_eq!(watch.wait(Duration::from_secs(5)).unwrap().code(), Some(0));
}

/// A division of one robot in one team, as a clusterer publishes it.
pub(crate) fn division(term: u64, epoch: u64, team: u64) -> Outbound {
    let robot = RobotId::new("r1").unwrap();
    let team = Team {
        id: TeamId::numbered(team),
        members: vec![Member { robot: robot.clone(), margin: 1.0 }],
        leader: robot,
        centroid: vec![0.0],
    };
    let header = Header {
        fleet: FleetId::new("alpha").unwrap(),
        revision: Revision { term, epoch },
        oldest: None,
        newest: None,
        stages: vec![],
    };
    let teams = Teams {
        header,
        embedding: Revision::default(),
        requested: 1,
        considered: vec![],
        teams: vec![team],
        unassigned: vec![],
        stale: vec![],
        inertia: 0.0,
        changes: vec![],
        next_team: 99,
        limited: None,
        needs: vec![],
        provisional: vec![],
        held: vec![],
        remembered: RememberedTeams::default(),
    };
    let message = Message::Teams { teams: Checked::new_unchecked(teams), mirror: false };
    message.publish(Tick(0)).unwrap().swap_remove(0)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_watch_follows_services_that_restarted_with_lower_terms() {
    let endpoint = free_endpoint().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let mut router = start_router(&endpoint, folder.path()).unwrap();
    let arguments = ["teams", "--watch", "--fleet", "alpha", "--connect", &endpoint];
    let mut watch = Process::start("muster", &arguments, &[], folder.path()).unwrap();
    let client = Client::connect(&endpoint, "alpha").await.unwrap();
    // The outputs of a clusterer, without one.
    let shown_within = async |term: u64, team: u64, limit: Duration| {
        let (start, mut epoch, row) = (Instant::now(), 0, format!("│ t{team} "));
        while !watch.output().contains(&row) {
            assert!(start.elapsed() < limit, "t{team}: {}", watch.output());
            epoch += 1;
            let Outbound { payload, encoding, .. } = division(term, epoch, team);
            client.put_bytes("teams", payload, &encoding).await.unwrap();
            tokio::time::sleep(Duration::from_millis(200)).await;
        }
        start.elapsed()
    };
    shown_within(7, 7, SOON).await;
    let took = shown_within(1, 1, FOLLOWED_WITHIN + SOON).await;
    eprintln!("followed after {took:?}");
    assert!(took > Duration::from_secs(5), "the newest division was fresh: {took:?}");
    watch.until_prints("clusterer is silent", SOON).unwrap();
    watch.until_prints("clusterer started again with lower terms", SOON).unwrap();
    router.kill().unwrap();
    watch.until_prints("the link to the router is lost", SOON).unwrap();
    assert!(!watch.output().contains('\u{1b}'), "no escape codes in a pipe: {}", watch.output());
}

#[test]
fn the_program_describes_itself_to_shells_and_manuals() {
    for shell in ["bash", "zsh", "fish"] {
        let (code, out, err) = run("muster", &["completions", shell], SOON).unwrap();
        assert_eq!(code, Some(0), "{err}");
        assert!(out.contains("replay-core") && out.contains("connect"), "{shell}:\n{out}");
    }
    let (code, page, _) = run("muster", &["manual"], SOON).unwrap();
    assert_eq!(code, Some(0));
    assert!(page.contains(".TH") && page.contains("teams"), "{page}");
    let (code, page, _) = run("muster", &["manual", "teams"], SOON).unwrap();
    assert_eq!(code, Some(0));
    assert!(page.contains("muster\\-teams") && page.contains("watch"), "{page}");
    let (code, _, err) = run("muster", &["manual", "tems"], SOON).unwrap();
    assert_eq!(code, Some(2));
    assert!(err.contains("teams"), "{err}");
}

#[test]
fn an_unreachable_fleet_is_reported_with_a_remedy_and_code_3() {
    let endpoint = free_endpoint().unwrap();
    let (code, _, err) = run("muster", &["teams", "--connect", &endpoint], SOON).unwrap();
    assert_eq!(code, Some(3));
    assert!(err.contains("muster router"), "{err}");
    let folder = tempfile::tempdir().unwrap();
    let _router = start_router(&endpoint, folder.path()).unwrap();
    for command in [&["teams"][..], &["audit"], &["graph"], &["set", "ingest"]] {
        let arguments = [command, &["--connect", &endpoint]].concat();
        let (code, _, err) = run("muster", &arguments, SOON).unwrap();
        assert_eq!(code, Some(3), "{command:?}");
        assert!(err.contains("muster status"), "{command:?}: {err}");
    }
    let arguments = ["status", "--connect", &endpoint];
    let (code, out, err) = run("muster", &arguments, SOON).unwrap();
    assert_eq!(code, Some(3));
    assert!(out.contains("muster up ingest"), "{out}");
    assert!(err.contains("--fleet"), "{err}");
    let taken = ["router", "--listen", &endpoint];
    let (code, _, err) = run("muster", &taken, SOON).unwrap();
    assert_eq!(code, Some(3));
    assert!(err.contains("--listen"), "{err}");
}

#[test]
fn every_program_ends_cleanly_within_five_seconds_of_a_signal() {
    let mut cluster = Cluster::start("alpha", &[("clusterer", "teams=2")]).unwrap();
    let mut robots = cluster.robots(&["--robots", "6"]).unwrap();
    let up = ["up", "--router", "--listen", &free_endpoint().unwrap(), "--state-directory", "none"];
    let mut up = Process::start("muster", &up, &[], cluster.folder()).unwrap();
    std::thread::sleep(Duration::from_secs(3));
    for service in SERVICES {
        let process = cluster.service(service).unwrap();
        process.signal("TERM").unwrap();
        let status = process.wait(Duration::from_secs(5)).unwrap();
        assert_eq!(status.code(), Some(0), "{service}: {}", process.output());
    }
    for process in robots.processes().iter_mut().chain([&mut up]) {
        process.signal("TERM").unwrap();
        let status = process.wait(Duration::from_secs(5)).unwrap();
        assert_eq!(status.code(), Some(0), "{}", process.output());
    }
    // Also while no router answers.
    let arguments = ["--connect", &free_endpoint().unwrap(), "--state-directory", "none"];
    let mut waiting = Process::start("muster-ingest", &arguments, &[], cluster.folder()).unwrap();
    std::thread::sleep(Duration::from_millis(1500));
    waiting.signal("TERM").unwrap();
    assert_eq!(waiting.wait(Duration::from_secs(5)).unwrap().code(), Some(0));
}

#[test]
fn every_program_explains_itself_and_its_configuration() {
    let mut programs = vec!["muster".to_owned()];
    programs.extend(SERVICES.map(|service| format!("muster-{service}")));
    for program in programs {
        let of = |arguments: &[&str]| run(&program, arguments, SOON).unwrap();
        let (code, out, _) = run(&program, &["--help"], SOON).unwrap();
        assert_eq!(code, Some(0));
        for flag in [
            "--fleet",
            "--connect",
            "--listen",
            "--mode",
            "--zenoh-config",
            "--config",
            "--check-config",
            "--print-config",
            "Exit codes",
        ] {
            assert!(out.contains(flag), "{program} --help does not name {flag}:\n{out}");
        }
        assert!(out.contains("Examples:"), "{program}:\n{out}");
        assert_eq!(of(&["--check-config"]).0, Some(0));
        let (code, printed, _) = of(&["--print-config", "--fleet", "beta"]);
        assert_eq!(code, Some(0));
        assert!(printed.contains("fleet = \"beta\"  # flag"), "{printed}");
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("muster.toml");
        std::fs::write(&path, printed).unwrap();
        let path = path.to_str().unwrap();
        assert_eq!(of(&["--check-config", "--config", path]).0, Some(0));
        std::fs::write(path, "[clusterer]\nteams = 0\n").unwrap();
        let (code, _, err) = of(&["--check-config", "--config", path]);
        assert_eq!(code, Some(2));
        assert!(err.contains("clusterer.teams"), "{err}");
        for wrong in [["--fleet", "A B"], ["--connect", "here"], ["--zenoh-config", "/none.json5"]]
        {
            assert_eq!(of(&wrong).0, Some(2), "{program} {wrong:?}");
        }
    }
}

#[test]
fn the_shipped_configuration_is_the_built_in_one() {
    let shipped = concat!(env!("CARGO_MANIFEST_DIR"), "/../deploy/muster.toml");
    let (code, _, err) =
        run("muster", &["up", "--check-config", "--config", shipped], SOON).unwrap();
    assert_eq!(code, Some(0), "{err}");
    let values = |arguments: &[&str]| -> Vec<String> {
        let (_, out, _) = run("muster", arguments, SOON).unwrap();
        out.lines().map(|line| line.split("  # ").next().unwrap().to_owned()).collect()
    };
    assert_eq!(
        values(&["up", "--print-config", "--config", shipped]),
        values(&["up", "--print-config"])
    );
}

#[test]
fn a_solve_is_estimated_before_it_is_begun() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("fleet.json");
    let file = r#"{"robots": ["a", "b"], "teams": 1,
                   "modalities": [{"name": "m", "edges": [["a", "b", 1]]}]}"#;
    std::fs::write(&path, file).unwrap();
    let path = path.to_str().unwrap();
    let (code, out, err) = run("muster", &["solve", path, "--estimate", "--json"], SOON).unwrap();
    assert_eq!(
        (code, err.as_str()),
        (Some(0), ""),
        "nothing but the estimate where no terminal is"
    );
    let estimate: Value = serde_json::from_str(&out).unwrap();
    assert_eq!((estimate["robots"].as_u64(), estimate["fits"].as_bool()), (Some(2), Some(true)));
    let (code, out, _) = run("muster", &["solve", path, "--estimate"], SOON).unwrap();
    assert_eq!(code, Some(0));
    assert!(out.contains("it fits"), "{out}");
    let many: Vec<String> = (0..16_385).map(|robot| format!("\"r{robot}\"")).collect();
    let file = format!(r#"{{"robots": [{}], "teams": 1, "ranks": {{}}}}"#, many.join(","));
    std::fs::write(path, file).unwrap();
    let (code, out, _) = run("muster", &["solve", path, "--estimate"], SOON).unwrap();
    assert_eq!(code, Some(0));
    assert!(out.contains("inverse-free: "), "{out}");
    let dense = ["solve", path, "--estimate", "--path", "dense"];
    let (code, _, err) = run("muster", &dense, SOON).unwrap();
    assert_eq!(code, Some(2));
    assert!(err.contains("robots: 16385 are too many for the dense path"), "{err}");
}

#[test]
fn a_solve_that_nothing_satisfies_says_which_limits_contradict_each_other() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("fleet.json");
    let file = r#"{"robots": ["a", "b", "c"], "teams": 2, "modalities": [{"name": "m",
                   "edges": [["a", "b", 1], ["b", "a", 1], ["b", "c", 1], ["c", "a", 1]]}]}"#;
    std::fs::write(&path, file).unwrap();
    let path = path.to_str().unwrap();
    let why = "3 robots may only be in t1 and t2, which hold 2";
    let (code, out, err) = run("muster", &["solve", path, "--size", "..1"], SOON).unwrap();
    assert_eq!((code, out.as_str()), (Some(4), ""), "{err}");
    assert!(err.contains(why), "{err}");
    let asked = ["solve", path, "--size", "..1", "--json"];
    let (code, out, _) = run("muster", &asked, SOON).unwrap();
    let printed: Value = serde_json::from_str(&out).unwrap();
    assert_eq!((code, printed), (Some(4), serde_json::json!({"conflict": why})));
    let asked = ["solve", path, "--size", "1..2", "--wish", "apart a b", "--json"];
    let (code, out, err) = run("muster", &asked, SOON).unwrap();
    let printed: Value = serde_json::from_str(&out).unwrap();
    assert_eq!((code, &printed["gap"]), (Some(0), &serde_json::json!(0.0)), "{err}");
    assert_ne!(printed["teams"]["a"], printed["teams"]["b"]);
}

#[test]
fn every_command_has_examples() {
    for command in [
        "demo",
        "up",
        "router",
        "robot",
        "teams",
        "audit",
        "graph",
        "status",
        "doctor",
        "probe",
        "set",
        "solve",
        "tune",
        "replay-core",
        "deploy",
        "completions",
        "manual",
    ] {
        let (code, out, _) = run("muster", &[command, "--help"], SOON).unwrap();
        assert_eq!(code, Some(0));
        assert!(out.contains("Examples:"), "{command}:\n{out}");
    }
    let (code, _, err) = run("muster", &[], SOON).unwrap();
    assert_eq!(code, Some(2));
    assert!(err.contains("muster demo"), "{err}");
}

#[test]
fn a_fleet_may_stand_in_a_file() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/experiments/formations");
    let of = |file: &str, more: &[&str]| {
        run("muster", &[&["robot", "--file", file, "--list"], more].concat(), SOON).unwrap()
    };
    let (code, out, err) = of(&format!("{folder}/squad-line.json"), &[]);
    assert_eq!((code, out.lines().count()), (Some(0), 9), "{err}");
    assert!(out.starts_with("a1 0\n") && out.ends_with("leader 2\n"), "{out}");
    let (code, _, err) = of(&format!("{folder}/none.json"), &[]);
    assert_eq!(code, Some(2), "{err}");
    assert!(err.contains("--file") && err.contains("none.json"), "{err}");
    let (code, _, err) = of(concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml"), &[]);
    assert_eq!(code, Some(2));
    assert!(err.contains("(file)"), "{err}");
    assert_eq!(of(&format!("{folder}/squad-line.json"), &["--robots", "5"]).0, Some(2));
}

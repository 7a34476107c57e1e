//! The historian on a real bus: what it has published as recorded is in its file, however it ends; a disk that is full
//! costs the oldest minutes alone; and the commands that ask it.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use muster_tests::SOON;
use muster_tests::client::{Watch, division, now};
use muster_tests::cluster::Cluster;
use muster_tests::process::{Process, program};
use serde_json::{Value, json};

use crate::pipeline::FORMED_WITHIN;

const SCENARIO: [&str; 6] = ["--scenario", "clusters", "--teams", "4", "--robots", "16"];
const KILLS: usize = 20;

/// What another program reads in the file: all events, and every division with the team of each robot.
const READ: &str = r#"
import json, sqlite3, sys
history = sqlite3.connect("file:" + sys.argv[1] + "?mode=ro", uri=True)
assert history.execute("PRAGMA quick_check").fetchone()[0] == "ok"
events = history.execute("SELECT source, term, epoch, kind FROM events ORDER BY seq").fetchall()
divisions, state = [], {}
rows = history.execute("SELECT seq, term, epoch, snapshot FROM divisions ORDER BY seq").fetchall()
for seq, term, epoch, snapshot in rows:
    table = "moves"
    if snapshot is not None:
        state, table = {}, "places"
    for robot, present, team in history.execute(f"SELECT robot, present, team FROM {table} WHERE division = ?", (seq,)):
        if present:
            state[robot] = team
        else:
            state.pop(robot, None)
    divisions.append([term, epoch, dict(state)])
gaps = history.execute("SELECT count(*) FROM gaps").fetchone()[0]
print(json.dumps({"events": events, "divisions": divisions, "gaps": gaps}))
"#;

fn read(file: &Path) -> Value {
    read_by(Command::new("python3").args(["-c", READ]).arg(file))
}

fn read_by(reader: &mut Command) -> Value {
    let out = reader.output().unwrap();
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    serde_json::from_slice(&out.stdout).unwrap()
}

fn file(cluster: &Cluster) -> PathBuf {
    cluster.folder().join("state").join(&cluster.fleet).join("history.sqlite")
}

fn revision(value: &Value) -> (u64, u64) {
    (value["term"].as_u64().unwrap(), value["epoch"].as_u64().unwrap())
}

/// One run of the historian: what it published as recorded, with the moments of the first and the last.
#[derive(Debug)]
struct Run {
    since: f64,
    last: Value,
}

async fn newest(states: &Watch, after: f64, wanted: impl Fn(&Value) -> bool) -> Run {
    let start = now();
    loop {
        let all: Vec<_> = states.timed().into_iter().filter(|(at, _)| *at > after).collect();
        if let Some((_, last)) = all.iter().rev().find(|(_, state)| wanted(state)) {
            let same = |state: &Value| state["instance"] == last["instance"];
            let first = all.iter().find(|(_, state)| same(state)).unwrap();
            return Run { since: first.0, last: last.clone() };
        }
        assert!(now() - start < SOON.as_secs_f64(), "no such state: {:?}", states.newest());
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_published_as_recorded_is_in_the_file_after_twenty_kills() {
    let mut cluster =
        Cluster::start_drawn("twenty_kills", &[("clusterer", "teams=4")], &SCENARIO).unwrap();
    let client = cluster.client().await.unwrap();
    let (events, teams) =
        (client.watch("json/event").await.unwrap(), client.watch("json/teams").await.unwrap());
    let states = client.watch("history/*/state").await.unwrap();
    let _robots = cluster.robots(&SCENARIO).unwrap();
    teams.until("teams", FORMED_WITHIN, |value| division(value).len() == 16).await.unwrap();
    let mut runs: Vec<Run> = Vec::new();
    for kill in 0..KILLS {
        let started = now();
        cluster.start_service("historian").unwrap();
        // What the run before has published may arrive late.
        let is_new =
            |state: &Value| runs.iter().all(|run| run.last["instance"] != state["instance"]);
        let first = newest(&states, started, is_new).await;
        // Something to record: divisions and events, while it writes.
        let mut change = 0;
        while now() - first.since < 1.2 + 0.1 * (kill % 10) as f64 {
            change += 1;
            let teams = json!({"teams": 3 + (kill + change) % 2});
            client.get("service/clusterer/settings", Some(&teams)).await.unwrap();
            tokio::time::sleep(Duration::from_millis(150)).await;
        }
        cluster.service("historian").unwrap().kill().unwrap();
        let all = states.timed();
        let same = |state: &Value| state["instance"] == first.last["instance"];
        let last = all.iter().rev().find(|(_, state)| same(state)).unwrap();
        runs.push(Run { since: first.since, last: last.1.clone() });
    }
    let found = read(&file(&cluster));
    let recorded: BTreeSet<(String, u64, u64)> =
        serde_json::from_value::<Vec<(String, u64, u64, String)>>(found["events"].clone())
            .unwrap()
            .into_iter()
            .map(|(source, term, epoch, _)| (source, term, epoch))
            .collect();
    let divisions: Vec<(u64, u64, BTreeMap<String, Option<String>>)> =
        serde_json::from_value(found["divisions"].clone()).unwrap();
    assert_eq!(found["gaps"], 0);
    let instances: BTreeSet<_> = runs.iter().map(|run| run.last["instance"].to_string()).collect();
    assert_eq!(instances.len(), KILLS);
    let (mut checked_events, mut checked_divisions) = (0, 0);
    for run in &runs {
        let through: BTreeMap<String, (u64, u64)> = run.last["events"]
            .as_array()
            .unwrap()
            .iter()
            .map(|of| (of["source"].as_str().unwrap().to_owned(), revision(&of["revision"])))
            .collect();
        for (at, event) in events.timed() {
            let source = event["source"].as_str().unwrap().to_owned();
            let (term, epoch) = revision(&event);
            if at > run.since
                && through.get(&source).is_some_and(|through| (term, epoch) <= *through)
            {
                assert!(
                    recorded.contains(&(source, term, epoch)),
                    "not recorded: {event}; {run:?}"
                );
                checked_events += 1;
            }
        }
        let Some(through) = run.last["division"].as_object() else { continue };
        let through = revision(&json!(through));
        for (at, value) in teams.timed() {
            if at > run.since && revision(&value) <= through {
                let said: BTreeMap<_, _> = division(&value).into_iter().collect();
                let last = divisions.iter().rev().find(|(t, e, _)| (*t, *e) <= revision(&value));
                assert_eq!(last.unwrap().2, said, "another division than {value}; {run:?}");
                checked_divisions += 1;
            }
        }
    }
    assert!(checked_events > 40 && checked_divisions > 20, "{checked_events}, {checked_divisions}");
    assert!(!file(&cluster).with_extension("sqlite.bad").exists());
}

/// Starts the historian with files of at most so many KiB, as on a disk that is full then.
fn start_limited(cluster: &Cluster, kib: u32) -> Process {
    let state = cluster.folder().join("state");
    let script = format!(
        "trap '' XFSZ; ulimit -S -f {}; exec {} --fleet {} --connect {} --state-directory {}",
        2 * kib,
        program("muster-historian").unwrap().display(),
        cluster.fleet,
        cluster.endpoint,
        state.display()
    );
    let mut command = Command::new("sh");
    command.args(["-c", &script]);
    Process::start_command("muster-historian", command, cluster.folder()).unwrap()
}

/// A limit on the size of files stands for a full disk: it needs no rights.
#[tokio::test(flavor = "multi_thread")]
async fn a_full_disk_costs_the_oldest_minutes_and_is_over_without_a_restart() {
    let cluster = Cluster::start("alpha", &[("clusterer", "teams=4")]).unwrap();
    let client = cluster.client().await.unwrap();
    let events = client.watch("json/event").await.unwrap();
    let teams = client.watch("json/teams").await.unwrap();
    let states = client.watch("history/*/state").await.unwrap();
    let _robots = cluster.robots(&SCENARIO).unwrap();
    teams.until("teams", FORMED_WITHIN, |value| division(value).len() == 16).await.unwrap();
    let historian = start_limited(&cluster, 2600);
    let is = |wanted: &'static str| move |event: &Value| event["event"] == wanted;
    newest(&states, 0.0, |_| true).await;
    // Large events: nobody reads them but the historian. They fill the file.
    let name = "x".repeat(60);
    let robots: Vec<String> = (0..64).map(|number| format!("{name}{number}")).collect();
    let mut filled = 0_u64;
    let start = now();
    while !events.all().iter().any(|(_, event)| is("history_degraded")(event)) {
        assert!(now() - start < 120.0, "never degraded: {:?}", states.newest());
        for _ in 0..50 {
            filled += 1;
            event(&client, filled, &robots).await;
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    let degraded = newest(&states, 0.0, |state| state["degraded"].is_string()).await;
    assert!(
        degraded.last["degraded"].as_str().unwrap().contains("free space")
            || degraded.last["degraded"].as_str().unwrap().contains("Free space"),
        "{degraded:?}"
    );
    // The fleet goes on meanwhile, and so does the recording.
    let before = teams.newest().unwrap();
    client.get("service/clusterer/settings", Some(&json!({"teams": 3}))).await.unwrap();
    teams
        .until("another division", SOON, |value| revision(value) > revision(&before))
        .await
        .unwrap();
    let (code, out, _) = cluster.muster(&["doctor", "--json"]).unwrap();
    assert_eq!(code, Some(1), "{out}");
    assert!(out.contains("history_degraded") && !out.contains("service_missing"), "{out}");
    // There is room again.
    let lifted = Command::new("prlimit")
        .args([&format!("--pid={}", historian.id()), "--fsize=unlimited"])
        .status()
        .unwrap();
    assert!(lifted.success());
    let recovered = events.until("it recovers", Duration::from_secs(60), is("history_recovered"));
    recovered.await.unwrap();
    let since = now();
    let state = newest(&states, since, |state| state["degraded"].is_null()).await;
    assert!(state.last["recorded_through"].as_u64().is_some());
    let found = read(&file(&cluster));
    assert!(!found["events"].as_array().unwrap().is_empty());
    drop(historian);
}

/// Starts the historian with its state on a disk of its own, of so many MB; none if the test may not mount one. The mount
/// is seen by the historian alone, and ends with it.
fn start_on_small_disk(cluster: &Cluster, megabytes: u32) -> Option<Process> {
    let state = cluster.folder().join("small");
    std::fs::create_dir(&state).unwrap();
    let mount = format!("mount -t tmpfs -o size={megabytes}m tmpfs {}", state.display());
    let may = Command::new("unshare").args(["-m", "sh", "-c", &mount]).output();
    if !may.is_ok_and(|tried| tried.status.success()) {
        eprintln!("a small disk cannot be mounted here: only the limit on files is tested");
        return None;
    }
    let script = format!(
        "{mount} && exec {} --fleet {} --connect {} --state-directory {}",
        program("muster-historian").unwrap().display(),
        cluster.fleet,
        cluster.endpoint,
        state.display()
    );
    let mut command = Command::new("unshare");
    command.args(["-m", "sh", "-c", &script]);
    Some(Process::start_command("muster-historian", command, cluster.folder()).unwrap())
}

/// A real disk, of 6 MB: it fills, the division goes on, and once it is larger the recording does as well.
#[tokio::test(flavor = "multi_thread")]
async fn a_disk_of_six_megabytes_fills_and_recording_goes_on_once_it_is_larger() {
    let cluster = Cluster::start("alpha", &[("clusterer", "teams=4")]).unwrap();
    let client = cluster.client().await.unwrap();
    let events = client.watch("json/event").await.unwrap();
    let teams = client.watch("json/teams").await.unwrap();
    let alerts = client.watch("json/alerts").await.unwrap();
    let states = client.watch("history/*/state").await.unwrap();
    let _robots = cluster.robots(&SCENARIO).unwrap();
    teams.until("teams", FORMED_WITHIN, |value| division(value).len() == 16).await.unwrap();
    let Some(historian) = start_on_small_disk(&cluster, 6) else { return };
    let is = |wanted: &'static str| move |event: &Value| event["event"] == wanted;
    newest(&states, 0.0, |_| true).await;
    let name = "x".repeat(60);
    let robots: Vec<String> = (0..64).map(|number| format!("{name}{number}")).collect();
    let (start, mut filled) = (now(), 0_u64);
    while !events.all().iter().any(|(_, event)| is("history_degraded")(event)) {
        assert!(now() - start < 120.0, "never degraded: {:?}", states.newest());
        for _ in 0..50 {
            filled += 1;
            event(&client, filled, &robots).await;
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    let kinds = |value: &Value| -> BTreeSet<String> {
        let open = value["open"].as_array().into_iter().flatten();
        open.map(|of| of["kind"].as_str().unwrap().to_owned()).collect()
    };
    alerts
        .until("the alert", SOON, |value| kinds(value).contains("history_degraded"))
        .await
        .unwrap();
    let before = teams.newest().unwrap();
    client.get("service/clusterer/settings", Some(&json!({"teams": 3}))).await.unwrap();
    teams
        .until("another division", SOON, |value| revision(value) > revision(&before))
        .await
        .unwrap();
    // The disk becomes larger.
    let small = cluster.folder().join("small");
    let grown = Command::new("nsenter")
        .args([&format!("--target={}", historian.id()), "-m", "mount", "-o", "remount,size=64m"])
        .arg(&small)
        .status()
        .unwrap();
    assert!(grown.success());
    let recovered = events.until("it recovers", Duration::from_secs(60), is("history_recovered"));
    recovered.await.unwrap();
    alerts
        .until("no alert", SOON, |value| !kinds(value).contains("history_degraded"))
        .await
        .unwrap();
    let state = newest(&states, now(), |state| state["degraded"].is_null()).await;
    assert!(state.last["recorded_through"].as_u64().is_some());
    // Only the historian sees the disk.
    let mut reader = Command::new("nsenter");
    reader.args([&format!("--target={}", historian.id()), "-m", "python3", "-c", READ]);
    let path = small.join(&cluster.fleet).join("history.sqlite");
    assert!(!read_by(reader.arg(path))["events"].as_array().unwrap().is_empty());
    drop(historian);
}

/// Puts an event of a service that does not run.
async fn event(client: &muster_tests::client::Client, number: u64, robots: &[String]) {
    use muster_model::event::{Event, EventKind, Severity};
    use muster_model::header::{Header, Revision, StageTime};
    use muster_model::id::{FleetId, ServiceName};
    use muster_model::time::Tick;
    use muster_wire::{Format, Key, Message};

    let at = Tick(1_795_208_990_000_000);
    let stage = StageTime { stage: ServiceName::Auditor, received: at, published: at };
    let header = Header {
        fleet: FleetId::new("alpha").unwrap(),
        revision: Revision { term: 5, epoch: number },
        oldest: None,
        newest: None,
        stages: vec![stage],
    };
    let robots = robots.iter().map(|name| name.parse().unwrap()).collect();
    let kind = EventKind::RobotsLeft { count: 64, robots };
    let event = Event { header, source: ServiceName::Auditor, severity: Severity::Info, kind };
    let message = Message::Event(event).encode(Key::Event, Format::Binary, at).unwrap();
    client.put_bytes("event", message.payload, &message.encoding).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn the_past_is_shown_by_the_commands() {
    let mut cluster =
        Cluster::start_drawn("the_past", &[("clusterer", "teams=4")], &SCENARIO).unwrap();
    let client = cluster.client().await.unwrap();
    let (code, _, err) = cluster.muster(&["history"]).unwrap();
    assert_eq!(code, Some(3), "no historian runs: {err}");
    let states = client.watch("history/*/state").await.unwrap();
    cluster.start_service("historian").unwrap();
    let teams = client.watch("json/teams").await.unwrap();
    let mut robots = cluster.robots(&SCENARIO).unwrap();
    teams.until("teams", FORMED_WITHIN, |value| division(value).len() == 16).await.unwrap();
    tokio::time::sleep(Duration::from_secs(2)).await;
    let (wanted, moment) = (division(&teams.newest().unwrap()), now());
    client.get("service/clusterer/settings", Some(&json!({"teams": 2}))).await.unwrap();
    let two =
        |value: &Value| division(value).values().flatten().collect::<BTreeSet<_>>().len() == 2;
    teams.until("two teams", SOON, two).await.unwrap();
    let through = |state: &Value| state["recorded_through"].as_u64() > Some((moment * 1e6) as u64);
    newest(&states, moment, through).await;

    let json_of = |arguments: &[&str]| -> Value {
        let (code, out, err) = cluster.muster(&[arguments, &["--json"]].concat()).unwrap();
        assert_eq!(code, Some(0), "{arguments:?}: {err}");
        serde_json::from_str(&out).unwrap()
    };
    let text_of = |arguments: &[&str]| -> String {
        let (code, out, err) = cluster.muster(arguments).unwrap();
        assert_eq!(code, Some(0), "{arguments:?}: {err}");
        out
    };
    let at = format!("{moment:.6}");
    let past = json_of(&["history", "--as-of", &at]);
    let mut found = BTreeMap::new();
    for team in past["rows"]["as_of"]["teams"].as_array().unwrap() {
        for member in team["members"].as_array().unwrap() {
            let id = team["id"].as_str().map(str::to_owned);
            found.insert(member.as_str().unwrap().to_owned(), id);
        }
    }
    assert_eq!(found, wanted.clone().into_iter().collect());
    assert!(text_of(&["history", "--as-of", &at]).contains("members"));
    let moved = wanted
        .iter()
        .find(|(robot, team)| division(&teams.newest().unwrap()).get(*robot) != Some(*team));
    let (robot, team) = moved.unwrap();
    // A division of two teams reaches this test before it is on the disk of the historian.
    let start = now();
    loop {
        let rows = json_of(&["history", "--robot", robot, "--since", "10m"]);
        if rows["rows"]["robot"][0]["was"].as_str() == team.as_deref() {
            break;
        }
        assert!(now() - start < SOON.as_secs_f64(), "{robot} was in {team:?}: {rows}");
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    assert!(text_of(&["history", "--robot", robot, "--csv"]).starts_with("at,sequence,team,was"));
    let team = team.clone().unwrap();
    let rows = json_of(&["history", "--team", &team]);
    assert!(!rows["rows"]["team"].as_array().unwrap().is_empty());
    assert!(text_of(&["history"]).contains("recording begins"));
    assert_eq!(
        json_of(&["history", "--limit", "1"])["rows"]["divisions"].as_array().unwrap().len(),
        1
    );
    let rows = json_of(&["events", "--kind", "settings_changed"]);
    let settings = rows["rows"]["events"][0]["detail"]["settings"].as_str().unwrap();
    assert!(settings.contains("\"teams\":2"), "{settings}");
    assert!(text_of(&["events", "--csv"]).starts_with("at,sequence,source,severity,event,detail"));
    assert_eq!(json_of(&["robots"])["rows"]["robots"].as_array().unwrap().len(), 16);
    assert_eq!(json_of(&["robots", "--gone"])["rows"]["robots"], json!([]));
    for (wrong, named) in [
        (&["history", "--as-of", "yesterday"][..], "--as-of"),
        (&["events", "--since", "1h", "--until", "2h"], "--until"),
        (&["robots", "--limit", "0"], "--limit"),
    ] {
        let (code, _, err) = cluster.muster(wrong).unwrap();
        assert!(code == Some(2) && err.contains(named), "{wrong:?}: {err}");
    }
    let (_, status, _) = cluster.muster(&["status"]).unwrap();
    assert!(status.contains("historian"), "{status}");

    robots.kill().unwrap();
    let gone = |state: &Value| {
        state["events"].as_array().is_some_and(|all| all.iter().any(|of| of["source"] == "ingest"))
    };
    let killed = now();
    let start = now();
    let left = loop {
        newest(&states, killed, gone).await;
        let rows = json_of(&["robots", "--gone"]);
        let left = rows["rows"]["robots"].as_array().unwrap().clone();
        if left.len() == 16 {
            break left;
        }
        assert!(now() - start < 60.0, "{rows}");
        tokio::time::sleep(Duration::from_secs(1)).await;
    };
    assert!(
        left.iter().all(|stay| stay["reason"] == "disconnected" && stay["left"].is_u64()),
        "{left:?}"
    );
    assert!(text_of(&["robots", "--gone"]).contains("disconnected"));
}

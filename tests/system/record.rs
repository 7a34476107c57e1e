//! Every service of a live fleet is recorded, and replayed by `muster replay-core`.

use std::path::{Path, PathBuf};
use std::time::Duration;

use muster_service::recording::{Entry, Head};
use muster_service::{Command, Input};
use muster_tests::SOON;
use muster_tests::cluster::{Cluster, SERVICES};
use muster_tests::process::run;
use muster_wire::recording::{Reader, RecordingError, begin, frame};
use muster_wire::{KeySpace, Message, Source};
use serde_json::{Value, json};

fn recordings(folder: &Path, service: &str) -> Vec<PathBuf> {
    let mut found: Vec<_> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.file_name().unwrap().to_str().unwrap().starts_with(service))
        .collect();
    found.sort_by_key(|path| std::fs::metadata(path).unwrap().modified().unwrap());
    found
}

fn replay(path: &Path, flags: &[&str]) -> (Option<i32>, String, String) {
    let name = path.to_str().unwrap();
    run("muster", &[&["replay-core", name][..], flags].concat(), Duration::from_secs(60)).unwrap()
}

fn report(path: &Path) -> Value {
    let (code, out, err) = replay(path, &["--json"]);
    assert_eq!(code, Some(0), "{}: {err}", path.display());
    assert_eq!(err, "", "nothing to be warned of on the machine that recorded it");
    serde_json::from_str(&out).unwrap()
}

fn read(path: &Path) -> (Head, Vec<Entry>, bool) {
    let file = std::io::BufReader::new(std::fs::File::open(path).unwrap());
    let (mut reader, head) = Reader::open(file).unwrap();
    let mut entries = Vec::new();
    loop {
        match reader.next_entry() {
            Ok(Some(entry)) => entries.push(entry),
            Ok(None) => return (head, entries, true),
            Err(RecordingError::BreaksOff(_)) => return (head, entries, false),
            Err(error) => panic!("{error}"),
        }
    }
}

fn write(path: &Path, head: &Head, entries: &[Entry]) {
    let mut bytes = begin(head).unwrap();
    entries.iter().for_each(|entry| bytes.extend(frame(entry).unwrap()));
    std::fs::write(path, bytes).unwrap();
}

fn teams(count: usize) -> impl Fn(&Value) -> bool {
    move |value| value["teams"].as_array().is_some_and(|teams| teams.len() == count)
}

/// Robots join, are refused, fall silent and leave; the settings change; a service is killed and
/// comes back; the router dies and comes back; every output is asked for; all end.
async fn live(recorded: &Path) -> Cluster {
    let settings =
        [("ingest", "stale_after_s=0.5"), ("ingest", "gone_after_s=1.5"), ("clusterer", "teams=2")];
    let flags = ["--record", recorded.to_str().unwrap()];
    let mut cluster = Cluster::start_with("alpha", &settings, &flags).unwrap();
    let client = cluster.client().await.unwrap();
    let watch = client.watch("json/teams").await.unwrap();
    let scenario = ["--scenario", "clusters", "--teams", "3", "--robots", "12"];
    let robots = cluster.robots(&scenario).unwrap();
    watch.until("two teams", SOON, teams(2)).await.unwrap();
    client.put("robot/x1/pose", &json!({"x": 1.0, "y": 2.0})).await.unwrap();
    client.put("robot/x1/pose", &json!({"x": "east", "y": 2.0})).await.unwrap();
    client.get("service/clusterer/settings", Some(&json!({"teams": 3}))).await.unwrap();
    client.get("service/clusterer/settings", Some(&json!({"teams": 0}))).await.unwrap();
    watch.until("three teams", SOON, teams(3)).await.unwrap();

    let embedder = cluster.service("embedder").unwrap();
    embedder.kill().unwrap();
    cluster.start_service("embedder").unwrap();
    let is_back = |status: &Value| status["revision"]["epoch"].as_u64() > Some(3);
    client.until("service/embedder/status", SOON, is_back).await.unwrap();
    for key in ["teams", "embedding", "roster", "graph/*", "audit", "robot/*/team"] {
        client.get(&format!("{key}?format=json"), None).await.unwrap();
    }
    cluster.kill_router().unwrap();
    tokio::time::sleep(Duration::from_secs(1)).await;
    cluster.restart_router().unwrap();
    tokio::time::sleep(Duration::from_secs(2)).await;
    drop(robots);
    tokio::time::sleep(Duration::from_secs(3)).await;
    cluster
}

#[tokio::test(flavor = "multi_thread")]
async fn the_recordings_of_a_live_run_come_out_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let mut cluster = live(folder.path()).await;
    // Three end as they should, the fourth in the midst of its work.
    for service in SERVICES {
        let process = cluster.service(service).unwrap();
        if service == "auditor" {
            process.kill().unwrap();
        } else {
            process.signal("TERM").unwrap();
            process.wait(Duration::from_secs(5)).unwrap();
        }
    }
    let mut all = Vec::new();
    for service in SERVICES {
        let files = recordings(folder.path(), service);
        assert_eq!(files.len(), if service == "embedder" { 2 } else { 1 }, "{service}");
        for (run, path) in files.iter().enumerate() {
            let report = report(path);
            assert_eq!(report["service"], service);
            assert_eq!(report["equal"], true);
            let was_killed = service == "auditor" || (service == "embedder" && run == 0);
            let ending = if was_killed { "broken_off" } else { "stated" };
            assert_eq!(report["ending"], ending, "{service} {run}");
            assert!(report["events"].as_u64().unwrap() > 50, "{report}");
            assert!(report["outputs"].as_u64().unwrap() > 20, "{report}");
            assert_eq!(report["jobs"].as_u64().unwrap() > 0, service != "ingest", "{report}");
            #[cfg(unix)]
            {
                use std::os::unix::fs::PermissionsExt as _;
                let mode = std::fs::metadata(path).unwrap().permissions().mode();
                assert_eq!(mode & 0o777, 0o600);
            }
            all.extend(read(path).1);
        }
    }
    everything_happened(&all);
    tampering_is_found(folder.path());
    broken_off_files_are_reported(folder.path());
}

/// A life in which little happens would show little.
fn everything_happened(entries: &[Entry]) {
    let space = KeySpace::new("alpha".parse().unwrap());
    let count = |what: &dyn Fn(&Input) -> bool| {
        let is = |entry: &&Entry| matches!(entry, Entry::Input { input, .. } if what(input));
        entries.iter().filter(is).count()
    };
    let arrived = |source: Source| {
        count(&|input| match input {
            Input::Arrived(arrival) => arrival.packet().source == source,
            _ => false,
        })
    };
    let is_refused = |input: &Input| match input {
        Input::Arrived(arrival) => Message::decode(&space, arrival.packet()).is_err(),
        _ => false,
    };
    let took_time = |input: &Input| match input {
        Input::JobEnded { laps, panic: None } => laps.iter().any(|lap| *lap > 0),
        _ => false,
    };
    let was_answered = |input: &Input| match input {
        Input::Answered { answers, .. } => !answers.is_empty(),
        _ => false,
    };
    assert_eq!(count(&|input| matches!(input, Input::Started { .. })), 5);
    assert!(arrived(Source::Put) > 500);
    for (what, name) in [
        (arrived(Source::TokenAlive), "token"),
        (arrived(Source::TokenGone), "lost token"),
        (count(&is_refused), "refusal"),
        (count(&|input| matches!(input, Input::Timer)), "timer"),
        (count(&took_time), "job"),
        (count(&was_answered), "answer"),
        (count(&|input| matches!(input, Input::Get(..))), "get"),
        (count(&|input| matches!(input, Input::Stored { error: None })), "stored state"),
        (count(&|input| matches!(input, Input::LinkLost)), "lost link"),
        (count(&|input| matches!(input, Input::LinkRestored)), "link"),
    ] {
        assert!(what > 0, "no {name} in the whole run");
    }
}

/// The comparison can fail: one bit of one output, or one number of one input, is enough.
fn tampering_is_found(folder: &Path) {
    let tampered = folder.join("tampered");
    for service in SERVICES {
        let (head, mut entries, _) = read(&recordings(folder, service)[0]);
        let is_publication = |command: &Command| matches!(command, Command::Publish(_));
        let published = entries.iter().enumerate().filter_map(|(at, entry)| match entry {
            Entry::Commands(commands) => Some((at, commands.iter().position(is_publication)?)),
            _ => None,
        });
        let published: Vec<_> = published.collect();
        let (at, command) = published[published.len() / 2];
        if let Entry::Commands(commands) = &mut entries[at]
            && let Command::Publish(publication) = &mut commands[command]
        {
            let payload = publication.packets[0].payload.as_mut().unwrap();
            let middle = payload.len() / 2;
            payload[middle] ^= 1;
        }
        write(&tampered, &head, &entries);
        let (code, out, err) = replay(&tampered, &[]);
        assert_eq!(code, Some(1), "{service}: {out}{err}");
        let input = at / 2 + 1;
        assert!(out.contains("different:"), "{out}");
        assert!(err.contains(&format!("input {input} at")), "{service}: {input}: {err}");
        assert!(err.contains("recorded: publish") && err.contains("now:      publish"), "{err}");
        let (code, out, _) = replay(&tampered, &["--json"]);
        assert_eq!(code, Some(1));
        let report: Value = serde_json::from_str(&out).unwrap();
        assert_eq!(report["equal"], false);
        assert_eq!(report["difference"]["event"], input);
        assert_ne!(report["difference"]["recorded"], report["difference"]["now"]);
        // Before it, nothing differs.
        let before = (input - 1).to_string();
        let (code, ..) = replay(&tampered, &["--until", &before]);
        assert_eq!(code, Some(0));
    }
    // A change of settings that was different leads elsewhere.
    let (head, mut entries, _) = read(&recordings(folder, "clusterer")[0]);
    let mut changed = 0;
    for entry in &mut entries {
        if let Entry::Input { input: Input::Get(get), .. } = entry
            && let Some(payload) = &get.payload
            && let Ok(text) = std::str::from_utf8(payload)
            && text.contains("\"teams\":3")
        {
            get.payload = Some(text.replace("\"teams\":3", "\"teams\":2").into_bytes());
            changed += 1;
        }
    }
    assert_eq!(changed, 1);
    write(&tampered, &head, &entries);
    let (code, _, err) = replay(&tampered, &[]);
    assert_eq!(code, Some(1));
    assert!(err.contains("teams"), "{err}");
    // A job that took other times leads to other published numbers.
    let (head, mut entries, _) = read(&recordings(folder, "embedder")[0]);
    for entry in &mut entries {
        if let Entry::Input { input: Input::JobEnded { laps, panic: None }, .. } = entry {
            laps[0] += 1;
        }
    }
    write(&tampered, &head, &entries);
    assert_eq!(replay(&tampered, &[]).0, Some(1));
}

fn broken_off_files_are_reported(folder: &Path) {
    let whole = std::fs::read(&recordings(folder, "clusterer")[0]).unwrap();
    let cut = folder.join("cut");
    for share in [3, 5, 7, 9] {
        std::fs::write(&cut, &whole[..whole.len() * share / 10]).unwrap();
        let (code, out, err) = replay(&cut, &[]);
        assert_eq!(code, Some(0), "{err}");
        assert!(out.contains("equal:") && out.contains("breaks off"), "{out}");
    }
    // In the end of an entry: where a length is damaged, the file looks like one that breaks off.
    let (head, entries, _) = read(&recordings(folder, "clusterer")[0]);
    let mut half = begin(&head).unwrap();
    entries[..entries.len() / 2].iter().for_each(|entry| half.extend(frame(entry).unwrap()));
    assert!(whole.starts_with(&half));
    let mut damaged = whole.clone();
    damaged[half.len() - 1] ^= 0x10;
    std::fs::write(&cut, damaged).unwrap();
    let (code, _, err) = replay(&cut, &[]);
    assert_eq!(code, Some(2));
    assert!(err.contains("damaged at byte") && err.contains("before are equal"), "{err}");
    // Everything can be looked at, and foreign text does not reach the terminal as it is.
    let (code, out, _) = replay(&recordings(folder, "ingest")[0], &["--print"]);
    assert_eq!(code, Some(0));
    for what in ["received robot/", "refused muster/v1/alpha/robot/x1/pose", "publish graph/"] {
        assert!(out.contains(what), "no {what:?}");
    }
    assert!(out.lines().all(|line| !line.contains(char::is_control)));
}

#[test]
fn errors_about_files_name_the_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let old = folder.path().join("old");
    std::fs::write(&old, "precious").unwrap();
    let old = old.to_str().unwrap();
    for program in ["muster-ingest", "muster-embedder", "muster-clusterer", "muster-auditor"] {
        let (code, _, err) = run(program, &["--record", old], SOON).unwrap();
        assert_eq!(code, Some(2), "{err}");
        assert!(err.contains("name another file"), "{err}");
    }
    assert_eq!(std::fs::read_to_string(old).unwrap(), "precious");
    let (code, _, err) = run("muster", &["replay-core", old], SOON).unwrap();
    assert_eq!(code, Some(2));
    assert!(err.contains("--record"), "{err}");
    let (code, _, err) = run("muster", &["replay-core", "/nowhere.rec"], SOON).unwrap();
    assert_eq!(code, Some(2));
    assert!(err.contains("/nowhere.rec"), "{err}");
}

#[test]
fn services_of_one_process_are_recorded_each_for_itself() {
    let folder = tempfile::tempdir().unwrap();
    let base = folder.path().join("demo");
    let arguments = ["demo", "--robots", "8", "--seconds", "4", "--record", base.to_str().unwrap()];
    let (code, _, err) = run("muster", &arguments, Duration::from_secs(60)).unwrap();
    assert_eq!(code, Some(0), "{err}");
    for service in SERVICES {
        let report = report(&folder.path().join(format!("demo.{service}")));
        assert_eq!((&report["equal"], &report["service"]), (&json!(true), &json!(service)));
    }
}

//! Recordings of a fleet in MCAP: others read them, a kill loses less than a second, and a replay gives the same divisions.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use muster_tests::SOON;
use muster_tests::access::VIEWER;
use muster_tests::client::{Client, Watch, now};
use muster_tests::cluster::{Cluster, robots_of};
use muster_tests::process::{Process, python, run};
use serde_json::Value;

const SCENARIO: [&str; 6] = ["--scenario", "clusters", "--teams", "3", "--robots", "12"];

/// How much a kill may cost, in seconds.
const MOST_LOST_S: f64 = 1.0;

/// How much single kills may cost on a machine that other tests keep busy, in seconds.
const MOST_LOST_BUSY_S: f64 = 4.0;

/// How often the recorder is killed.
const KILLS: usize = 10;

fn list(value: &Value) -> &[Value] {
    value.as_array().map_or(&[], Vec::as_slice)
}

/// What the reader of others finds in a recording.
fn read(path: &Path, flags: &[&str]) -> Value {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("peers/read_recording.py");
    let mut command = Command::new(python().unwrap());
    let output = command.arg(script).arg(path).args(flags).output().unwrap();
    let err = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{}: {err}", path.display());
    serde_json::from_slice(&output.stdout).unwrap()
}

/// The members of each team, whatever it is called.
fn division(teams: &Value) -> BTreeSet<Vec<String>> {
    let members = |team: &Value| -> Vec<String> {
        list(&team["members"])
            .iter()
            .map(|robot| robot.as_str().unwrap_or_default().to_owned())
            .collect()
    };
    list(&teams["teams"]).iter().map(members).collect()
}

fn record(cluster: &Cluster, file: &Path, further: &[&str]) -> Process {
    let flags = cluster.flags_of(VIEWER);
    let flags: Vec<&str> = flags.iter().map(String::as_str).collect();
    let arguments = [&["record", file.to_str().unwrap()][..], &flags, further].concat();
    let mut process = Process::start("muster", &arguments, &[], cluster.folder()).unwrap();
    process.until_prints("records fleet alpha in", SOON).unwrap();
    process
}

fn replay(cluster: &Cluster, arguments: &[&str]) -> (Option<i32>, String, String) {
    let connects = ["replay", "--connect", &cluster.endpoint];
    run("muster", &[&connects[..], arguments].concat(), Duration::from_secs(60)).unwrap()
}

/// Checks reports of a robot that a replay put against those of the recording: in their order, the last one too, and all but few,
/// as a newer report takes the place of one that waits where the machine is busy.
fn are_replayed(put: &[Value], recorded: &[Value]) {
    let mut rest = recorded.iter();
    let are_in_order = put.iter().all(|one| rest.any(|other| other == one));
    assert!(are_in_order && put.last() == recorded.last(), "{put:?} of {recorded:?}");
    let superseded = recorded.len() - put.len();
    assert!(superseded <= 1 + recorded.len() / 10, "{put:?} of {recorded:?}");
}

fn three_teams(teams: &Value) -> bool {
    list(&teams["teams"]).len() == 3
}

#[tokio::test(flavor = "multi_thread")]
async fn a_recording_is_read_by_others_and_its_replay_gives_the_same_divisions() {
    let cluster = Cluster::start("alpha", &[("clusterer", "teams=3")]).unwrap();
    let live = cluster.client().await.unwrap();
    let divisions = live.watch("json/teams").await.unwrap();
    let mut robots = cluster.robots(&SCENARIO).unwrap();
    divisions.until("three teams", SOON, three_teams).await.unwrap();
    let file = cluster.folder().join("run.mcap");
    let mut recorder = record(&cluster, &file, &["--seconds", "8"]);
    assert!(recorder.wait(SOON).unwrap().success(), "{}", recorder.output());
    robots.kill().unwrap();
    // What was recorded is never written over.
    let (code, _, err) =
        run("muster", &["record", file.to_str().unwrap(), "--connect", &cluster.endpoint], SOON)
            .unwrap();
    assert_eq!(code, Some(1), "{err}");

    let found = read(&file, &[]);
    assert_eq!(found["metadata"]["muster"]["fleet"], "alpha");
    assert_eq!(list(&found["attachments"]), ["muster-schema.json"]);
    let names: BTreeSet<String> = robots_of(&SCENARIO).unwrap().into_keys().collect();
    for robot in &names {
        let topic = |stream: &str| found["topics"][format!("/robot/{robot}/{stream}")].clone();
        assert_eq!(topic("pose"), serde_json::json!(["json", "muster.pose"]));
        assert_eq!(topic("links"), serde_json::json!(["json", "muster.links"]));
        assert_eq!(topic("rank"), serde_json::json!(["json", "muster.rank"]));
        assert!(list(&found["poses"][robot]).len() > 40, "{robot}");
    }
    assert_eq!(found["topics"]["/tf"][1], "foxglove.FrameTransforms");
    assert_eq!(found["topics"]["/teams"][1], "foxglove.SceneUpdate");
    assert!(found["counts"]["/teams"].as_u64() > Some(20), "{}", found["counts"]);
    let recorded = division(&found["teams"]);
    assert_eq!(recorded.len(), 3);

    // The fleet of the recording is refused, and so is every other one of live robots.
    let path = file.to_str().unwrap();
    let (code, _, err) = replay(&cluster, &[path, "--fleet", "alpha"]);
    assert_eq!(code, Some(2), "{err}");
    assert!(err.contains("never played into alpha"), "{err}");
    let services = [
        "up",
        "--fleet",
        "replay-alpha",
        "--connect",
        &cluster.endpoint,
        "--no-console",
        "--state-directory",
        "none",
        "--set",
        "clusterer.teams=3",
    ];
    let _services = Process::start("muster", &services, &[], cluster.folder()).unwrap();
    let stranger =
        ["robot", "--fleet", "replay-alpha", "--connect", &cluster.endpoint, "--robots", "4"];
    let mut stranger = Process::start("muster", &stranger, &[], cluster.folder()).unwrap();
    let played = Client::connect(&cluster.endpoint, "replay-alpha").await.unwrap();
    let poses = played.watch("robot/*/pose").await.unwrap();
    poses.until("the stranger", SOON, |_| true).await.unwrap();
    let (code, _, err) = replay(&cluster, &[path]);
    assert_eq!(code, Some(2), "{err}");
    assert!(err.contains("there are live robots in this fleet"), "{err}");
    stranger.kill().unwrap();
    let gone = |roster: &Value| list(&roster["robots"]).is_empty();
    until_gone(&played, gone).await;

    let doctor =
        ["doctor", "--json", "--listen-for", "1", "--connect", &cluster.endpoint, "--fleet"];
    let finds = |fleet: &str| {
        let (_, out, err) = run("muster", &[&doctor[..], &[fleet]].concat(), SOON).unwrap();
        let report: Value = serde_json::from_str(&out).unwrap_or_else(|_| panic!("{out}{err}"));
        list(&report["findings"]).iter().any(|finding| finding["id"] == "replay")
    };
    assert!(finds("replay-alpha") && !finds("alpha"));

    poses.clear();
    let links = played.watch("robot/*/links").await.unwrap();
    let ranks = played.watch("robot/*/rank").await.unwrap();
    let again = played.watch("json/teams").await.unwrap();
    let start = std::time::Instant::now();
    let (code, out, err) = replay(&cluster, &[path]);
    assert_eq!(code, Some(0), "{err}");
    assert!(out.contains("REPLAY: 12 robots") && out.contains("in fleet replay-alpha"), "{out}");
    let took = start.elapsed();
    assert!(took > Duration::from_secs(6) && took < Duration::from_secs(20), "{took:?}");
    // The last division of all of them; when they have left there are others.
    let whole = again.all().into_iter().map(|(_, teams)| teams);
    let mut whole =
        whole.filter(|teams| division(teams).iter().map(Vec::len).sum::<usize>() == names.len());
    let last = whole.next_back().expect("a division of all robots");
    assert_eq!(division(&last), recorded);
    assert_eq!(last["fleet"], "replay-alpha", "what follows says what it is");
    // The last messages may be under way when the program has ended.
    tokio::time::sleep(Duration::from_secs(1)).await;
    // Each robot was where it had been, and says that it is none.
    let mut count = 0;
    for (key, pose) in poses.all() {
        let robot = key.rsplit('/').nth(1).unwrap().to_owned();
        let at = serde_json::json!([pose["x"], pose["y"]]);
        assert!(list(&found["poses"][&robot]).contains(&at), "{robot} never was at {at}");
        assert!(pose["boot"].as_str().unwrap().starts_with("replay-"), "{pose}");
        count += 1;
    }
    let put: usize = names.iter().map(|robot| list(&found["poses"][robot]).len()).sum();
    assert!(count * 10 >= put * 9, "{count} of {put} poses");
    for robot in &names {
        let of = |watch: &Watch, field: &str| -> Vec<Value> {
            let all = watch.all().into_iter();
            let all = all.filter(|(key, _)| key.rsplit('/').nth(1) == Some(robot));
            all.map(|(_, report)| report[field].clone()).collect()
        };
        // A link that is lost, or a superior that is another one, divides the fleet otherwise.
        are_replayed(&of(&links, "links"), list(&found["links"][robot]));
        are_replayed(&of(&ranks, "superior"), list(&found["ranks"][robot]));
        assert!(
            !list(&found["links"][robot]).is_empty() && !list(&found["ranks"][robot]).is_empty()
        );
    }
}

async fn until_gone(client: &Client, gone: impl Fn(&Value) -> bool) {
    let start = std::time::Instant::now();
    loop {
        let roster = client.get_one("roster?format=json").await;
        if roster.is_ok_and(|roster| gone(&roster)) {
            return;
        }
        assert!(start.elapsed() < SOON, "the stranger is still there");
        tokio::time::sleep(Duration::from_millis(200)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_kill_of_the_recorder_loses_less_than_a_second() {
    let cluster =
        Cluster::start_drawn("a_kill_of_the_recorder", &[("clusterer", "teams=3")], &SCENARIO)
            .unwrap();
    let client = cluster.client().await.unwrap();
    let divisions = client.watch("json/teams").await.unwrap();
    let _robots = cluster.robots(&SCENARIO).unwrap();
    divisions.until("three teams", SOON, three_teams).await.unwrap();
    let mut losses = Vec::new();
    for kill in 0..KILLS {
        let file: PathBuf = cluster.folder().join(format!("run-{kill}.mcap"));
        let mut recorder = record(&cluster, &file, &[]);
        // Random enough: the digits of the clock behind the second.
        let random = now().fract();
        tokio::time::sleep(Duration::from_secs_f64(1.2 + 2.0 * random)).await;
        let killed = now();
        recorder.kill().unwrap();
        let found = read(&file, &["--cut"]);
        let lost = killed - found["last"].as_f64().unwrap();
        println!("kill {kill} after {:.2} s loses {lost:.3} s", 1.2 + 2.0 * random);
        assert!(
            list(&found["poses"]["r1"]).len() > 5
                || found["poses"].as_object().unwrap().len() == 12
        );
        losses.push(lost);
    }
    losses.sort_by(f64::total_cmp);
    let (median, most) = (losses[losses.len() / 2], losses[losses.len() - 1]);
    println!("{KILLS} kills lose {median:.3} s, at most {most:.3} s");
    // A recorder that has no processor for a second writes nothing in it.
    assert!(median < MOST_LOST_S && most < MOST_LOST_BUSY_S, "{losses:?}");
}

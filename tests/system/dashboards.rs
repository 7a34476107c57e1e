//! What operators watch with fits what is served: the board of Grafana, the rules of Prometheus and the manual name
//! metrics that exist, under labels that they have, and Prometheus' own tools find nothing to complain of.

use std::collections::BTreeSet;
use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use muster_model::alert::AlertKind;
use muster_model::event::Severity;
use muster_tests::SOON;
use muster_tests::cluster::SERVICES;
use muster_tests::ports::{free_address, free_endpoint};
use muster_tests::process::{Process, prometheus_program, python};
use serde_json::Value;

use crate::observe::get;

/// How often the Prometheus of the test scrapes and evaluates, and over what it takes rates: a few samples.
const SCRAPE_INTERVAL: &str = "1s";
const RATE_INTERVAL: &str = "10s";

/// Columns of a board of Grafana.
const BOARD_COLUMNS: u64 = 24;

fn deploy() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../deploy").canonicalize().unwrap()
}

fn read(name: &str) -> String {
    std::fs::read_to_string(deploy().join(name)).expect(name)
}

fn yaml(name: &str) -> Value {
    serde_yaml_ng::from_str(&read(name)).expect(name)
}

fn board() -> Value {
    serde_json::from_str(&read("grafana/muster.json")).unwrap()
}

fn text<'a>(value: &'a Value, field: &str) -> &'a str {
    value[field].as_str().unwrap_or_else(|| panic!("{value} has no {field}"))
}

fn list<'a>(value: &'a Value, field: &str) -> &'a Vec<Value> {
    value[field].as_array().unwrap_or_else(|| panic!("{value} has no {field}"))
}

/// The panels of the board that show something.
fn panels(board: &Value) -> Vec<&Value> {
    list(board, "panels").iter().filter(|panel| text(panel, "type") != "row").collect()
}

/// The queries of a panel.
fn queries(panel: &Value) -> impl Iterator<Item = &str> {
    list(panel, "targets").iter().map(|target| text(target, "expr"))
}

/// All rules, of all groups.
fn rules() -> Vec<Value> {
    let rules = yaml("prometheus/alerts.yml");
    list(&rules, "groups").iter().flat_map(|group| list(group, "rules").clone()).collect()
}

/// The metrics of ours that a query names.
fn metrics_of(query: &str) -> BTreeSet<String> {
    // What stands in quotes are values of labels.
    let outside: String = query.split('"').step_by(2).collect();
    outside
        .split(|letter: char| !letter.is_ascii_alphanumeric() && letter != '_')
        .filter(|word| word.starts_with("muster_") || word.starts_with("process_"))
        .map(str::to_owned)
        .collect()
}

/// Runs promtool, and says whether it found nothing, and what it printed.
fn promtool(arguments: &[&str], folder: &Path, input: &str) -> (bool, String) {
    let mut child = Command::new(prometheus_program("promtool").unwrap())
        .args(arguments)
        .current_dir(folder)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    child.stdin.take().unwrap().write_all(input.as_bytes()).unwrap();
    let output = child.wait_with_output().unwrap();
    let printed = String::from_utf8([output.stdout, output.stderr].concat()).unwrap();
    (output.status.success(), printed)
}

#[test]
fn prometheus_accepts_the_rules_and_they_fire_as_their_tests_say() {
    let folder = deploy().join("prometheus");
    for arguments in [
        &["check", "config", "prometheus.yml"][..],
        &["check", "rules", "alerts.yml"],
        &["test", "rules", "alerts.test.yml"],
    ] {
        let (good, printed) = promtool(arguments, &folder, "");
        assert!(good, "promtool {arguments:?}: {printed}");
    }
    // The same look finds what is wrong.
    let wrong = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(wrong.path().join(name), text).unwrap();
    let rules = read("prometheus/alerts.yml");
    write("alerts.test.yml", &read("prometheus/alerts.test.yml"));
    write("alerts.yml", &rules.replace("muster_link_up == 0", "muster_link_up == 2"));
    assert!(!promtool(&["test", "rules", "alerts.test.yml"], wrong.path(), "").0);
    write("alerts.yml", &rules.replace("muster_link_up == 0", "muster_link_up =="));
    assert!(!promtool(&["check", "rules", "alerts.yml"], wrong.path(), "").0);
}

#[test]
fn every_alert_has_a_test_and_says_what_to_do() {
    let manual = std::fs::read_to_string(deploy().join("../services/README.md")).unwrap();
    let tests = read("prometheus/alerts.test.yml");
    let rules = rules();
    let mut names = BTreeSet::new();
    for rule in &rules {
        let name = text(rule, "alert");
        assert!(names.insert(name), "{name} stands twice");
        assert!(tests.contains(&format!("alertname=\"{name}\"")), "{name} has no test");
        let severity = text(&rule["labels"], "severity");
        assert!(["critical", "warning", "info"].contains(&severity), "{name}: {severity}");
        let notes = &rule["annotations"];
        let (summary, remedy) = (text(notes, "summary"), text(notes, "remedy"));
        assert!(summary.contains("{{ $labels."), "{name} names no one");
        assert!(remedy.contains("muster doctor"), "{name} does not name the doctor");
        if let Some(finding) = notes["finding"].as_str() {
            assert!(manual.contains(&format!("`{finding}`")), "{name}: no finding {finding}");
        }
    }
    assert!(names.len() > 15, "{names:?}");
}

/// What the auditor calls a warning needs an operator.
#[test]
fn the_alerts_of_a_fleet_that_need_an_operator_reach_one() {
    let rules = rules();
    let rule = rules.iter().find(|rule| rule["alert"] == "MusterFleetAlert").unwrap();
    let (_, kinds) = text(rule, "expr").split_once("kind=~\"").unwrap();
    let named: BTreeSet<&str> = kinds.split_once('"').unwrap().0.split('|').collect();
    let warnings = AlertKind::ALL.into_iter().filter(|kind| kind.severity() > Severity::Info);
    assert_eq!(named, warnings.map(AlertKind::as_str).collect());
}

#[test]
fn the_board_can_be_imported_and_its_panels_stand_side_by_side() {
    let board = board();
    assert!(board["id"].is_null(), "the id is that of the database that it is imported into");
    assert!(!text(&board, "uid").is_empty() && board["schemaVersion"].is_u64());
    let variables: BTreeSet<&str> =
        list(&board["templating"], "list").iter().map(|variable| text(variable, "name")).collect();
    assert_eq!(variables, BTreeSet::from(["datasource", "fleet", "service", "instance"]));
    let (mut ids, mut taken) = (BTreeSet::new(), BTreeSet::new());
    for panel in list(&board, "panels") {
        let title = text(panel, "title");
        assert!(ids.insert(panel["id"].as_u64().unwrap()), "{title}");
        let [x, y, wide, high] =
            ["x", "y", "w", "h"].map(|side| panel["gridPos"][side].as_u64().unwrap());
        assert!(x + wide <= BOARD_COLUMNS, "{title}");
        for cell in (x..x + wide).flat_map(|x| (y..y + high).map(move |y| (x, y))) {
            assert!(taken.insert(cell), "{title} lies over another panel");
        }
    }
    for panel in panels(&board) {
        let title = text(panel, "title");
        assert!(!text(panel, "description").is_empty(), "{title}");
        assert!(panel["fieldConfig"]["defaults"]["unit"].is_string(), "{title} has no unit");
        let sources = list(panel, "targets").iter().chain([panel]);
        for source in sources.map(|target| text(&target["datasource"], "uid")) {
            assert_eq!(source, "${datasource}", "{title}");
        }
        for query in queries(panel) {
            let used = query.split('$').skip(1).map(|rest| {
                let end =
                    rest.find(|letter: char| !letter.is_ascii_alphanumeric() && letter != '_');
                &rest[..end.unwrap_or(rest.len())]
            });
            for variable in used.filter(|name| *name != "__rate_interval") {
                assert!(variables.contains(variable), "{title}: ${variable}");
            }
        }
    }
}

/// A live fleet, and the Prometheus that scrapes it.
struct Watched {
    fleet: String,
    prometheus: String,
    _processes: [Process; 3],
    _folder: tempfile::TempDir,
}

impl Watched {
    fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let (endpoint, fleet, prometheus) =
            (free_endpoint().unwrap(), free_address().unwrap(), free_address().unwrap());
        let up = [
            "up",
            "--router",
            "--listen",
            &endpoint,
            "--http",
            &fleet,
            "--state-directory",
            "none",
            "--no-console",
        ];
        let up = Process::start("muster", &up, &[], folder.path()).unwrap();
        let robots = ["robot", "--connect", &endpoint];
        let robots = Process::start("muster", &robots, &[], folder.path()).unwrap();

        let mut config = yaml("prometheus/prometheus.yml");
        config["global"]["scrape_interval"] = SCRAPE_INTERVAL.into();
        config["global"]["evaluation_interval"] = SCRAPE_INTERVAL.into();
        config["scrape_configs"][0]["static_configs"][0]["targets"][0] = fleet.as_str().into();
        let file = folder.path().join("prometheus.yml");
        std::fs::write(&file, serde_yaml_ng::to_string(&config).unwrap()).unwrap();
        let rules = read("prometheus/alerts.yml");
        std::fs::write(folder.path().join("alerts.yml"), rules).unwrap();
        let program = prometheus_program("prometheus").unwrap();
        let data = folder.path().join("data");
        let flags = [
            format!("--config.file={}", file.display()),
            format!("--storage.tsdb.path={}", data.display()),
            format!("--web.listen-address={prometheus}"),
        ];
        let flags = [&flags[0], &flags[1], &flags[2]].map(String::as_str);
        let server = Process::start_at(&program, "prometheus", &flags, &[], folder.path()).unwrap();
        Self { fleet, prometheus, _processes: [up, robots, server], _folder: folder }
    }

    /// What the fleet serves now.
    fn metrics(&self) -> String {
        get(&self.fleet, "/metrics").map(|(_, text)| text).unwrap_or_default()
    }

    /// What Prometheus answers under a path of its API; null while it does not.
    fn ask(&self, path: &str) -> Value {
        let Ok(mut stream) = TcpStream::connect(&self.prometheus) else { return Value::Null };
        // Version 1.0 is answered in one piece.
        let request = format!("GET /api/v1/{path} HTTP/1.0\r\nHost: {}\r\n\r\n", self.prometheus);
        stream.set_read_timeout(Some(SOON)).unwrap();
        stream.write_all(request.as_bytes()).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        let body = answer.split_once("\r\n\r\n").map_or("", |(_, body)| body);
        let answer: Value = serde_json::from_str(body).unwrap_or(Value::Null);
        assert_ne!(answer["status"], "error", "{path}: {answer}");
        answer["data"].clone()
    }

    /// How many series a query has now.
    fn count(&self, query: &str) -> usize {
        let encoded: String = query.bytes().map(|byte| format!("%{byte:02x}")).collect();
        let data = self.ask(&format!("query?query={encoded}"));
        data["result"].as_array().map_or(0, Vec::len)
    }
}

/// Waits until nothing is missing any more.
fn until_none(what: &str, missing: impl Fn() -> Vec<String>) {
    let start = Instant::now();
    loop {
        let missing = missing();
        if missing.is_empty() {
            return;
        }
        assert!(start.elapsed() < SOON, "{what}: {missing:#?}");
        std::thread::sleep(Duration::from_millis(500));
    }
}

/// A query of the board as Grafana sends it when all is chosen. What shows only what is above zero has nothing to show.
fn as_sent(query: &str) -> String {
    let all = query.replace("$__rate_interval", RATE_INTERVAL);
    let all = ["$fleet", "$service", "$instance"]
        .into_iter()
        .fold(all, |query, variable| query.replace(variable, ".*"));
    all.trim_end_matches(" > 0").to_owned()
}

#[test]
fn a_live_fleet_serves_what_board_rules_and_manual_name_and_raises_no_alert() {
    let watched = Watched::start();
    let board = board();
    until_none("panels without data", || {
        let queries = panels(&board).into_iter().flat_map(|panel| {
            queries(panel).map(move |query| (text(panel, "title"), as_sent(query)))
        });
        let empty = queries.filter(|(_, query)| watched.count(query) == 0);
        empty.map(|(title, query)| format!("{title}: {query}")).collect()
    });

    // Samples have these names: `_bucket` and `_total` included.
    let served = watched.metrics();
    let served: BTreeSet<&str> = served
        .lines()
        .filter(|line| !line.starts_with('#'))
        .filter_map(|line| line.split(['{', ' ']).next())
        .collect();
    for rule in rules() {
        let named = metrics_of(text(&rule, "expr"));
        assert!(!named.is_empty() || text(&rule, "expr").starts_with("up{"), "{rule}");
        for metric in named {
            assert!(served.contains(metric.as_str()), "{}: no {metric}", rule["alert"]);
        }
    }
    for metric in manual() {
        let has = |suffix| served.contains(format!("{metric}{suffix}").as_str());
        assert!(has("") || has("_bucket"), "the manual names {metric}, which is not served");
    }
    for service in SERVICES {
        assert_eq!(watched.count(&format!("muster_ready{{service=\"{service}\"}} == 1")), 1);
    }

    // The rules can be evaluated on what is served, and a fleet that is well raises no alert.
    until_none("alerts", || {
        let data = watched.ask("rules");
        let groups = data["groups"].as_array().cloned().unwrap_or_default();
        let live: Vec<Value> =
            groups.iter().flat_map(|group| list(group, "rules").clone()).collect();
        let is_well = |rule: &&Value| rule["health"] == "ok" && rule["state"] == "inactive";
        let missing = rules().len().saturating_sub(live.len());
        let wrong = live.iter().filter(|rule| !is_well(rule)).map(Value::to_string);
        wrong.chain((missing > 0).then(|| format!("{missing} rules are not there"))).collect()
    });

    let text = watched.metrics();
    let (good, printed) = promtool(&["check", "metrics"], &deploy(), &plain(&text));
    assert!(good && printed.is_empty(), "{printed}");
    let (good, _) = promtool(&["check", "metrics"], &deploy(), "# TYPE x counter\nx 1\n");
    assert!(!good, "the same look finds what is wrong");
}

/// The metrics that the operators' manual names.
fn manual() -> BTreeSet<String> {
    let manual = std::fs::read_to_string(deploy().join("../services/README.md")).unwrap();
    let (_, table) = manual.split_once("| metric | meaning |\n").unwrap();
    let rows = table.lines().take_while(|line| line.starts_with('|'));
    let cells = rows.filter_map(|row| row.split(" | ").next());
    // Those of a host of many fleets are not those of one; `tests/system/fleets.rs` reads them.
    let of_one = |metric: &String| !metric.starts_with("muster_fleet");
    let named: BTreeSet<String> = cells.flat_map(metrics_of).filter(of_one).collect();
    assert!(named.len() > 30, "{named:?}");
    named
}

/// OpenMetrics as the older text that promtool reads.
fn plain(open_metrics: &str) -> String {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut child = Command::new(python().unwrap())
        .args([root.join("peers/check_metrics.py").to_str().unwrap(), "--plain"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    child.stdin.take().unwrap().write_all(open_metrics.as_bytes()).unwrap();
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "the parser refuses:\n{open_metrics}");
    String::from_utf8(output.stdout).unwrap()
}

//! A bus with certificates and rules: members of the fleet work as on a plain bus; others are refused, and so are
//! members that exceed their rights. Every refusal is tested with its counterpart that is allowed.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use muster_tests::client::{Client, Watch, division};
use muster_tests::cluster::{SERVICES, free_endpoint};
use muster_tests::process::{Process, run};
use serde_json::{Value, json};
use tempfile::TempDir;

const SOON: Duration = Duration::from_secs(20);

/// How long a client that is refused tries.
const REFUSED_WITHIN_MS: &str = "3000";

/// Robots on two places.
const ROBOTS: [(&str, f64); 4] = [("a1", 0.0), ("a2", 3.0), ("b1", 90.0), ("b2", 93.0)];

/// A secured router with services, all as processes with identities of their own.
pub(crate) struct Secured {
    services: Vec<(String, Process)>,
    routers: Vec<Process>,
    // Dropped last: what the processes have printed stands in it.
    folder: TempDir,
}

/// Runs `muster deploy` and expects it to end well.
fn deploy(arguments: &[&str]) -> String {
    let (code, out, err) = run("muster", &[&["deploy"], arguments].concat(), SOON).unwrap();
    assert_eq!(code, Some(0), "{arguments:?}: {err}");
    out
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Writes the fleet file of the tests, with routers on loopback.
fn fleet_file(folder: &Path, robots: &str, routers: &[&str]) -> PathBuf {
    let path = folder.join("fleet.toml");
    let mut text = format!(
        "fleet = \"alpha\"\nrobots = [{robots}]\noperators = [\"op\"]\nviewers = [\"wall\"]\n"
    );
    for router in routers {
        let endpoint = free_endpoint().unwrap();
        let port = endpoint.rsplit(':').next().unwrap();
        text += &format!(
            "[[routers]]\nname = \"{router}\"\naddresses = [\"127.0.0.1\"]\nport = {port}\n"
        );
    }
    std::fs::write(&path, text).unwrap();
    path
}

impl Secured {
    pub(crate) fn start(routers: &[&str]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let fleet = fleet_file(folder.path(), r#""a1", "a2", "b1", "b2", "absent""#, routers);
        let identities = folder.path().join("identities");
        deploy(&["certs", "--fleet-file", text(&fleet), "--out", text(&identities)]);
        let mut secured = Self { services: Vec::new(), routers: Vec::new(), folder };
        for router in routers {
            let config = secured.folder.path().join(format!("{router}.json5"));
            let identity = identities.join(format!("router.{router}"));
            let (file, identity) = (text(&fleet), text(&identity));
            let arguments = ["acl", "--fleet-file", file, "--router", router];
            let files = ["--identity", identity, "--out", text(&config)];
            deploy(&[&arguments[..], &files].concat());
            let arguments = ["router", "--zenoh-config", text(&config)];
            let process = Process::start("muster", &arguments, &[], secured.folder.path()).unwrap();
            let start = Instant::now();
            while !process.output().contains("router listens at") {
                assert!(start.elapsed() < SOON, "{}", process.output());
                std::thread::sleep(Duration::from_millis(20));
            }
            secured.routers.push(process);
        }
        for service in SERVICES {
            secured.start_service(service);
        }
        secured
    }

    pub(crate) fn identity(&self, name: &str) -> PathBuf {
        self.folder.path().join("identities").join(name).join("zenoh.json5")
    }

    /// Starts one more instance of a service.
    fn start_service(&mut self, service: &str) {
        let state = self.folder.path().join("state");
        let config = self.identity(&format!("service.{service}"));
        let arguments = [
            "--fleet",
            "alpha",
            "--zenoh-config",
            text(&config),
            "--state-directory",
            text(&state),
        ];
        let program = format!("muster-{service}");
        let process = Process::start(&program, &arguments, &[], self.folder.path()).unwrap();
        self.services.push((service.to_owned(), process));
    }

    async fn client(&self, name: &str) -> Client {
        open(&self.identity(name), &[]).await.unwrap()
    }

    fn muster(&self, arguments: &[&str]) -> (Option<i32>, String, String) {
        let config = self.identity("operator.op");
        let common = ["--fleet", "alpha", "--zenoh-config", text(&config)];
        run("muster", &[arguments, &common].concat(), SOON).unwrap()
    }
}

/// Connects with an identity, of which some values are changed.
async fn open(identity: &Path, changes: &[(&str, &str)]) -> anyhow::Result<Client> {
    let fail = |error: zenoh::Error| anyhow::anyhow!("{error}");
    let mut config = zenoh::Config::from_file(identity).map_err(fail)?;
    config.insert_json5("connect/timeout_ms", REFUSED_WITHIN_MS).map_err(fail)?;
    for (key, value) in changes {
        config.insert_json5(key, value).map_err(fail)?;
    }
    Client::open(config, "alpha").await
}

/// Lets robots report until the operator sees two teams made of their reports from now on.
async fn form(robots: &[(Client, f64)], teams: &Watch) -> Value {
    let since = crate::restarts::now();
    let right = |value: &Value| {
        let division = division(value);
        value["stages"][0]["received"].as_f64().is_some_and(|received| received > since)
            && division.len() == 4
            && division["a1"].is_some()
            && division["a1"] == division["a2"]
            && division["b1"] == division["b2"]
            && division["a1"] != division["b1"]
    };
    for _ in 0..200 {
        put_poses(robots).await;
        tokio::time::sleep(Duration::from_millis(100)).await;
        if let Some(teams) = teams.newest().filter(right) {
            return teams;
        }
    }
    panic!("four robots do not make two teams; the newest is {:?}", teams.newest());
}

async fn put_poses(robots: &[(Client, f64)]) {
    for ((name, _), (robot, x)) in ROBOTS.iter().zip(robots) {
        let pose = json!({"x": x, "y": 0.0});
        robot.put(&format!("robot/{name}/pose"), &pose).await.unwrap();
    }
}

async fn robots(secured: &Secured) -> Vec<(Client, f64)> {
    let mut robots = Vec::new();
    for (name, x) in ROBOTS {
        robots.push((secured.client(&format!("robot.{name}")).await, x));
    }
    robots
}

#[tokio::test(flavor = "multi_thread")]
async fn members_of_a_secured_fleet_work_as_on_a_plain_bus() {
    let mut secured = Secured::start(&["base"]);
    let operator = secured.client("operator.op").await;
    let teams = operator.watch("json/teams").await.unwrap();
    let events = operator.watch("json/event").await.unwrap();
    let robots = robots(&secured).await;
    let mut tokens = Vec::new();
    for ((name, _), (robot, _)) in ROBOTS.iter().zip(&robots) {
        tokens.push(robot.token(&format!("robot/{name}")).await.unwrap());
    }
    let mine = robots[0].0.watch("robot/a1/team").await.unwrap();
    let others = robots[0].0.watch("robot/b1/team").await.unwrap();
    let all = robots[0].0.watch("**").await.unwrap();
    // A declared publisher sends nothing until it knows of a subscriber.
    let publisher =
        robots[0].0.session().declare_publisher(robots[0].0.key("robot/a1/links")).await.unwrap();
    let formed = form(&robots, &teams).await;
    let links = json!({"links": [{"peer": "a2", "quality": 0.9}]}).to_string();
    publisher.put(links).await.unwrap();

    // The robot receives its team, and nothing of others.
    let right = |team: &Value| team["members"] == json!(["a1", "a2"]);
    let received = mine.until("a1 receives its team", SOON, right).await.unwrap();
    let got = robots[0].0.get_one("robot/a1/team").await.unwrap();
    assert_eq!(got["team"], received["team"]);
    let foreign = |(key, _): &(String, Value)| !key.starts_with("robot/a1/");
    assert!(others.all().is_empty() && !all.all().iter().any(foreign), "{others:?} {all:?}");
    assert!(robots[0].0.get("robot/b1/team", None).await.unwrap().is_empty());
    assert!(robots[0].0.get("json/teams", None).await.unwrap().is_empty());
    let start = Instant::now();
    loop {
        put_poses(&robots).await;
        let graph = operator.get_one("graph/connectivity?format=json").await.unwrap();
        if graph["edges"].as_array().is_some_and(|edges| edges.len() == 1) {
            break;
        }
        assert!(start.elapsed() < SOON, "the declared publisher is not received: {graph}");
        tokio::time::sleep(Duration::from_millis(100)).await;
    }

    // Console and viewer see everything.
    let (code, out, err) = secured.muster(&["status"]);
    assert_eq!(code, Some(0), "{err}");
    assert!(SERVICES.iter().all(|service| out.contains(service)), "{out}");
    assert!(out.contains("4 with a token") && !out.contains("does not answer"), "{out}");
    let viewer = secured.client("viewer.wall").await;
    let seen = viewer.watch("json/teams").await.unwrap();
    seen.until("the viewer sees teams", SOON, |_| true).await.unwrap();
    assert_eq!(division(&viewer.get_one("json/teams").await.unwrap()), division(&formed));

    // Only the operator can change settings.
    let settings = "service/clusterer/settings";
    for (name, client) in [("robot", &robots[0].0), ("viewer", &viewer)] {
        let answers = client.get(settings, Some(&json!({"hysteresis": 0.5}))).await.unwrap();
        assert!(answers.is_empty(), "{name}: {answers:?}");
    }
    assert_eq!(operator.get_one(settings).await.unwrap()["hysteresis"], 0.05);
    let (code, _, err) = secured.muster(&["set", "clusterer", "hysteresis=0.06"]);
    assert_eq!(code, Some(0), "{err}");
    assert_eq!(operator.get_one(settings).await.unwrap()["hysteresis"], 0.06);

    // A service that restarts without state gets its last output from its readers.
    for service in ["clusterer", "embedder", "ingest"] {
        let term = |status: &Value| status["revision"]["term"].as_u64().unwrap();
        let key = format!("service/{service}/status");
        let before = term(&operator.get_one(&key).await.unwrap());
        secured.services.retain(|(name, _)| name != service);
        secured.remove_state();
        secured.start_service(service);
        let start = Instant::now();
        loop {
            put_poses(&robots).await;
            tokio::time::sleep(Duration::from_millis(100)).await;
            let status = operator.get_one(&key).await;
            if status.as_ref().is_ok_and(|status| term(status) > before) {
                break;
            }
            assert!(start.elapsed() < SOON, "{service} takes no higher term: {status:?}");
        }
        teams.clear();
        let again = form(&robots, &teams).await;
        assert_eq!(division(&again), division(&formed), "after {service}");
    }
    // A second instance is a standby, with the same identity, and takes over.
    secured.start_service("clusterer");
    let instances = || async {
        let key = operator.key("service/clusterer/*");
        let found = operator.session().liveliness().get(key).await.unwrap();
        let mut count = 0;
        while found.recv_async().await.is_ok() {
            count += 1;
        }
        count
    };
    let start = Instant::now();
    while instances().await != 2 {
        assert!(start.elapsed() < SOON, "the second instance is not there");
        put_poses(&robots).await;
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    for _ in 0..20 {
        put_poses(&robots).await;
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    let first = secured.services.iter().position(|(name, _)| name == "clusterer").unwrap();
    secured.services.remove(first);
    teams.clear();
    let again = form(&robots, &teams).await;
    assert_eq!(division(&again), division(&formed), "after the leader died");
    for (_, event) in events.all() {
        assert_ne!(event["event"], "quarantined", "{event}");
    }
}

impl Secured {
    /// Removes the state files of the services, so that only their readers know it.
    fn remove_state(&self) {
        let _ = std::fs::remove_dir_all(self.folder.path().join("state"));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn two_secured_routers_are_one_bus_and_stand_in_for_each_other() {
    let mut secured = Secured::start(&["base", "spare"]);
    // All connect to the first router, and this operator to the second.
    let config = std::fs::read_to_string(secured.identity("operator.op")).unwrap();
    let spare = config.split("quic/").nth(2).unwrap().split('"').next().unwrap();
    let spare = format!("[\"quic/{spare}\"]");
    let changes = [("connect/endpoints", spare.as_str())];
    let operator = open(&secured.identity("operator.op"), &changes).await.unwrap();
    let teams = operator.watch("json/teams").await.unwrap();
    let robots = robots(&secured).await;
    let formed = form(&robots, &teams).await;

    secured.routers[0].kill().unwrap();
    // What was on its way does not count.
    tokio::time::sleep(Duration::from_millis(500)).await;
    teams.clear();
    let again = form(&robots, &teams).await;
    assert_eq!(division(&again), division(&formed));
    // The rules hold there as well.
    let watch = operator.watch("**").await.unwrap();
    nothing_but(&robots[0].0, &watch, &["robot/a2/pose", "teams"], "robot/a1/pose").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn strangers_are_refused_by_a_secured_fleet() {
    let secured = Secured::start(&["base"]);
    let right = secured.identity("robot.a1");
    let config = std::fs::read_to_string(&right).unwrap();
    let endpoint = config.split("quic/").nth(1).unwrap().split('"').next().unwrap();
    let port = endpoint.rsplit(':').next().unwrap();

    // Without anything.
    let plain = format!("[\"tcp/{endpoint}\"]");
    let plain = [("transport/link/protocols", "[\"tcp\"]"), ("connect/endpoints", plain.as_str())];
    assert!(open(&right, &plain).await.is_err(), "plain TCP");

    // An authority of its own, which has given out the same names.
    let other = secured.folder.path().join("other");
    let fleet = secured.folder.path().join("fleet.toml");
    deploy(&["certs", "--fleet-file", text(&fleet), "--out", text(&other)]);
    let wrong = other.join("robot.a1/zenoh.json5");
    let authority = config.split("root_ca_certificate_base64: ").nth(1).unwrap();
    let authority = authority.split(",\n").next().unwrap();

    for protocol in ["quic", "tls"] {
        let protocols = format!("[\"{protocol}\"]");
        let at = |address: &str| format!("[\"{protocol}/{address}:{port}\"]");
        let (named, renamed) = (at("127.0.0.1"), at("127.0.0.2"));
        let base = [
            ("transport/link/protocols", protocols.as_str()),
            ("connect/endpoints", named.as_str()),
        ];
        let with = |more: &[(&'static str, &str)]| {
            base.iter().chain(more).map(|(key, value)| (*key, (*value).to_owned())).collect()
        };
        let is_admitted = async |identity: &Path, changes: Vec<(&'static str, String)>| {
            let changes: Vec<_> =
                changes.iter().map(|(key, value)| (*key, value.as_str())).collect();
            open(identity, &changes).await.is_ok()
        };
        assert!(is_admitted(&right, with(&[])).await, "{protocol}: the right certificate");
        let without = [
            ("transport/link/tls/enable_mtls", "false"),
            ("transport/link/tls/connect_certificate_base64", "null"),
            ("transport/link/tls/connect_private_key_base64", "null"),
        ];
        assert!(!is_admitted(&right, with(&without)).await, "{protocol}: no certificate");
        assert!(!is_admitted(&wrong, with(&[])).await, "{protocol}: an authority of its own");
        let trusting = [("transport/link/tls/root_ca_certificate_base64", authority)];
        let trusted = is_admitted(&wrong, with(&trusting)).await;
        assert!(!trusted, "{protocol}: a certificate of another authority");
        // A router is only believed under the names of its certificate.
        let renamed = [("connect/endpoints", renamed.as_str())];
        assert!(!is_admitted(&right, with(&renamed)).await, "{protocol}: another name");
    }
    open(&right, &[]).await.expect("the right certificate is still admitted");
}

/// Puts what is forbidden and then what is allowed, in one session, whose order the bus keeps: once the latter has
/// arrived, the former never will. Repeats both, because puts are lost while a session has no router.
async fn nothing_but(client: &Client, watch: &Watch, forbidden: &[&str], allowed: &str) {
    watch.clear();
    let start = Instant::now();
    while !watch.all().iter().any(|(_, value)| value["control"] == true) {
        assert!(start.elapsed() < SOON, "{allowed} does not arrive");
        for key in forbidden {
            client.put(key, &json!({"forged": true, "x": 1.0, "y": 1.0})).await.unwrap();
            client.session().delete(client.key(key)).await.unwrap();
        }
        client.put(allowed, &json!({"control": true, "x": 1.0, "y": 1.0})).await.unwrap();
        tokio::time::sleep(Duration::from_millis(200)).await;
    }
    let forged: Vec<_> =
        watch.all().into_iter().filter(|(_, value)| value["forged"] == true).collect();
    assert!(forged.is_empty(), "{forged:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn members_cannot_exceed_their_rights() {
    let secured = Secured::start(&["base"]);
    let operator = secured.client("operator.op").await;
    let watch = operator.watch("**").await.unwrap();
    let robot = secured.client("robot.a1").await;

    // A robot puts for itself alone, also by keys with wildcards.
    let forbidden = [
        "robot/a2/pose",
        "robot/a2/links",
        "robot/a2/rank",
        "robot/*/pose",
        "robot/**",
        "robot/a$*/pose",
        "**",
        "robot/a1/team",
        "robot/a2/team",
        "robot/a1/relation/thermal",
        "roster",
        "graph/spatial",
        "embedding",
        "teams",
        "json/teams",
        "audit",
        "json/audit",
        "event",
        "json/event",
        "service/clusterer/settings",
        "service/clusterer/status",
    ];
    nothing_but(&robot, &watch, &forbidden, "robot/a1/pose").await;

    // Each service puts its own outputs alone.
    let outputs: [(&str, &[&str]); 4] = [
        ("ingest", &["roster", "graph/spatial", "graph/*"]),
        ("embedder", &["embedding"]),
        ("clusterer", &["teams", "json/teams", "robot/a1/team", "robot/*/team"]),
        ("auditor", &["audit", "json/audit"]),
    ];
    for (service, own) in outputs {
        let client = secured.client(&format!("service.{service}")).await;
        let mut forbidden = vec!["robot/a1/pose", "robot/*/pose", "**"];
        for (other, others) in outputs {
            if other != service {
                forbidden.extend(others);
            }
        }
        let other_settings = if service == "ingest" { "embedder" } else { "ingest" };
        let other_settings = format!("service/{other_settings}/settings");
        forbidden.push(&other_settings);
        for allowed in own.iter().filter(|key| !key.contains('*')) {
            nothing_but(&client, &watch, &forbidden, allowed).await;
        }
    }

    // A viewer puts nothing: the operator receives none of its messages.
    let viewer = secured.client("viewer.wall").await;
    watch.clear();
    viewer.put("robot/a1/pose", &json!({"forged": true})).await.unwrap();
    viewer.put("teams", &json!({"forged": true})).await.unwrap();
    viewer.get_one("service/ingest/status").await.expect("what it may do works in this session");
    robot.put("robot/a1/pose", &json!({"control": true})).await.unwrap();
    watch.until("the control", SOON, |value| value["control"] == true).await.unwrap();
    assert!(!watch.all().iter().any(|(_, value)| value["forged"] == true));

    // Tokens: a robot declares its own alone.
    let seen = || async {
        let found = operator.session().liveliness().get(operator.key("**")).await.unwrap();
        let mut keys = Vec::new();
        while let Ok(reply) = found.recv_async().await {
            keys.extend(reply.into_result().map(|sample| sample.key_expr().as_str().to_owned()));
        }
        keys
    };
    let _forged = [
        robot.token("robot/absent").await.unwrap(),
        robot.token("robot/*").await.unwrap(),
        robot.token("service/ingest/forged").await.unwrap(),
    ];
    let _own = robot.token("robot/a1").await.unwrap();
    let start = Instant::now();
    while !seen().await.contains(&operator.key("robot/a1")) {
        assert!(start.elapsed() < SOON, "the own token is not seen");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    let keys = seen().await;
    assert!(!keys.iter().any(|key| key.contains("absent") || key.contains("forged")), "{keys:?}");
    assert!(!keys.contains(&operator.key("robot/*")), "{keys:?}");
    let absent = secured.client("robot.absent").await;
    let _token = absent.token("robot/absent").await.unwrap();
    let start = Instant::now();
    while !seen().await.contains(&operator.key("robot/absent")) {
        assert!(start.elapsed() < SOON, "the token of its owner is not seen");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }

    // Answers: only its readers answer in place of a service.
    let forged = robot.key("service/ingest/status");
    let answer = forged.clone();
    robot
        .session()
        .declare_queryable(&forged)
        .callback(move |query| {
            let _ = zenoh::Wait::wait(query.reply(&answer, "{\"forged\": true}"));
        })
        .background()
        .await
        .unwrap();
    tokio::time::sleep(Duration::from_millis(300)).await;
    for _ in 0..5 {
        let answers = operator.get("service/ingest/status", None).await.unwrap();
        assert_eq!(answers.len(), 1, "{answers:?}");
        assert!(answers[0].1.as_ref().is_ok_and(|status| status["service"] == "ingest"));
    }
}

#[test]
fn certificates_are_kept_renewed_and_guarded() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let fleet = fleet_file(folder.path(), "\"a1\"", &["base"]);
    let out = folder.path().join("identities");
    let certs = |more: &[&str]| {
        deploy(&[&["certs", "--fleet-file", text(&fleet), "--out", text(&out)], more].concat())
    };
    assert!(certs(&[]).contains("robot.a1: made"));
    let read = |name: &str| std::fs::read_to_string(out.join(name)).unwrap();
    for name in ["authority", "router.base", "service.ingest", "robot.a1", "operator.op"] {
        let mode = |file: &str| {
            std::fs::metadata(out.join(name).join(file)).unwrap().permissions().mode() & 0o777
        };
        assert_eq!(mode("key.pem"), 0o600, "{name}");
        assert_eq!(mode(""), 0o700, "{name}");
        if name.starts_with(['s', 'o']) || name == "robot.a1" {
            assert_eq!(mode("zenoh.json5"), 0o600, "{name}");
        }
    }
    let keys =
        || ["authority", "robot.a1", "operator.op"].map(|name| read(&format!("{name}/key.pem")));
    let before = keys();
    // A robot that joins later is signed by the same authority, and nothing else changes.
    let joined = std::fs::read_to_string(&fleet).unwrap().replace("\"a1\"", "\"a1\", \"a2\"");
    std::fs::write(&fleet, joined).unwrap();
    let printed = certs(&[]);
    assert!(printed.contains("robot.a1: kept") && printed.contains("robot.a2: made"), "{printed}");
    assert_eq!(keys(), before);
    assert_eq!(read("robot.a2/authority.pem"), read("authority/certificate.pem"));
    // A router that is reached by another name needs a certificate that names it.
    let moved = std::fs::read_to_string(&fleet).unwrap().replace("\"127.0.0.1\"", "\"base.local\"");
    std::fs::write(&fleet, moved).unwrap();
    let printed = certs(&[]);
    assert!(printed.contains("router.base: replaced, because its addresses"), "{printed}");
    assert!(printed.contains("robot.a1: kept, valid for 36"), "{printed}");
    assert!(certs(&[]).contains("router.base: kept"));
    certs(&["--force", "--only", "robot.a1"]);
    let renewed = keys();
    assert_eq!((&renewed[0], &renewed[2]), (&before[0], &before[2]));
    assert_ne!(renewed[1], before[1]);

    let (fleet, out) = (text(&fleet), text(&out));
    let fails = |arguments: &[&str], word: &str| {
        let (code, _, err) = run("muster", &[&["deploy"], arguments].concat(), SOON).unwrap();
        assert_eq!(code, Some(2), "{arguments:?}: {err}");
        assert!(err.contains(word), "{arguments:?}: {err}");
    };
    fails(&["certs", "--fleet-file", fleet, "--out", out, "--only", "robot.zz"], "--only");
    fails(&["certs", "--fleet-file", "/none.toml", "--out", out], "/none.toml");
    let router = folder.path().join("router.json5");
    let acl = ["acl", "--fleet-file", fleet, "--out", text(&router)];
    deploy(&acl);
    fails(&acl, "--force");
    fails(&["acl", "--fleet-file", fleet, "--out", text(&router), "--router", "x"], "--router");
    std::fs::remove_file(folder.path().join("identities/authority/key.pem")).unwrap();
    fails(&["certs", "--fleet-file", fleet, "--out", out], "key.pem is missing");
    // With a new authority, the certificates of the old one open no link.
    std::fs::remove_dir_all(folder.path().join("identities/authority")).unwrap();
    let printed = deploy(&["certs", "--fleet-file", fleet, "--out", out]);
    assert!(printed.contains("authority: made, valid"), "{printed}");
    assert!(printed.contains("robot.a1: replaced, because the authority"), "{printed}");
    assert!(!printed.contains("kept"), "{printed}");
}

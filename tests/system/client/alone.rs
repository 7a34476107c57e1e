//! Robots by the client crate where no service runs.

use std::time::{Duration, Instant};

use muster_client::model::observation::Rank;
use muster_client::{Config, Error, Format, Pose, Report, Robot};
use muster_tests::client::Client;
use muster_tests::cluster::start_router;
use muster_tests::ports::free_endpoint;
use muster_tests::process::Process;
use serde_json::{Value, json};
use tempfile::TempDir;
use tokio::time::{sleep, timeout};

use super::RECEIVED_WITHIN;

/// A router without services.
struct RouterAlone {
    endpoint: String,
    /// Of robots that connect to it.
    config: Config,
    router: Process,
    folder: TempDir,
}

impl RouterAlone {
    fn start() -> Self {
        let endpoint = free_endpoint().unwrap();
        let folder = tempfile::tempdir().unwrap();
        let router = start_router(&endpoint, folder.path()).unwrap();
        let config = Config { routers: Some(vec![endpoint.clone()]), ..Config::default() };
        Self { endpoint, config, router, folder }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_robot_receives_is_checked() {
    let RouterAlone { endpoint, config, router: _router, folder: _folder } = RouterAlone::start();
    let robot = Robot::join(&config, "r1").await.unwrap();
    let mut team = robot.team();
    let outside = Client::connect(&endpoint, "default").await.unwrap();
    let message = |term: u64, epoch: u64, team: &str| {
        json!({
            "fleet": "default", "term": term, "epoch": epoch, "data_age_s": 0.5, "stages": [],
            "robot": "r1", "team": team, "members": ["r1"], "leader": "r1", "confidence": 1.0,
        })
    };
    let publish = async |value: &Value| outside.put("robot/r1/team", value).await.unwrap();
    let start = Instant::now();
    // The subscription may be under way when the first message is put.
    while team.latest().is_none() {
        assert!(start.elapsed() < RECEIVED_WITHIN);
        publish(&message(2, 5, "t1")).await;
        sleep(Duration::from_millis(100)).await;
    }
    assert_eq!(team.changed().await.unwrap().team.as_ref().unwrap().as_str(), "t1");
    let mut strange = vec![message(2, 4, "t9"), message(1, 99, "t9"), message(u64::MAX, 1, "t9")];
    for (field, value) in [
        ("robot", json!("r2")),
        ("fleet", json!("beta")),
        ("confidence", json!("much")),
        ("members", json!(["r2"])),
        ("epoch", json!(-1)),
    ] {
        let mut wrong = message(3, 1, "t9");
        wrong[field] = value;
        strange.push(wrong);
    }
    for value in &strange {
        publish(value).await;
    }
    outside
        .put_bytes("robot/r1/team", vec![0xB7; 1 << 20], "application/octet-stream")
        .await
        .unwrap();
    publish(&message(2, 6, "t2")).await;
    let next = timeout(RECEIVED_WITHIN, team.changed()).await.unwrap().unwrap();
    assert_eq!(next.team.as_ref().unwrap().as_str(), "t2", "only what is newer and right counts");
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_input_is_refused_by_name_before_it_goes_out() {
    let RouterAlone { endpoint, config, router: _router, folder: _folder } = RouterAlone::start();
    let outside = Client::connect(&endpoint, "default").await.unwrap();
    let received = outside.watch("robot/**").await.unwrap();
    let robot = Robot::join(&config, "r1").await.unwrap();
    let role = Some("x".repeat(65));
    let wrong: [(&str, Result<(), Error>); 8] = [
        ("x", robot.put_pose(Pose::at(f64::NAN, 0.0))),
        ("y", robot.put_pose(Pose::at(0.0, 1e9))),
        ("links.peer", robot.put_links([("R2", 0.5)])),
        ("links.quality", robot.put_links([("r2", f64::INFINITY)])),
        ("superior", robot.put_rank(Some("r1"))),
        ("role", robot.put(Report::Rank(Rank { role, ..Rank::under(None) }))),
        ("modality", robot.put_relation("spatial", [("r2", 1.0)])),
        ("edges", robot.put_relation("thermal", [("r2", -1.0)])),
    ];
    for (field, result) in wrong {
        let error = result.unwrap_err();
        assert!(error.to_string().starts_with(&format!("{field}: ")), "{error}");
    }
    for id in ["", "R1", "r/1", "r*"] {
        let error = robot.client().join(id).await.unwrap_err().to_string();
        assert!(error.starts_with("robot: "), "{error}");
    }
    robot.put_pose(Pose { heading: Some(0.5), ..Pose::at(1.0, 2.0) }).unwrap();
    let right = |value: &Value| value["x"] == 1.0 && value["seq"] == 1 && value["boot"].is_string();
    received.until("the good pose", RECEIVED_WITHIN, right).await.unwrap();
    assert_eq!(received.all().len(), 1, "nothing else went out: {:?}", received.all());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_second_robot_of_an_id_is_refused() {
    let RouterAlone { endpoint, config, router: _router, folder } = RouterAlone::start();
    let first = Robot::join(&config, "r1").await.unwrap();
    let same_session = first.client().join("r1").await.unwrap_err();
    assert!(matches!(same_session, Error::Taken { .. }), "{same_session}");
    let start = Instant::now();
    let second = Robot::join(&config, "r1").await.unwrap_err();
    assert!(matches!(second, Error::Taken { .. }), "{second}");
    assert!(second.to_string().contains("id of its own"), "{second}");
    assert!(start.elapsed() < RECEIVED_WITHIN, "{:?}", start.elapsed());
    // The first one is none the worse, and another fleet is another matter.
    first.put_pose(Pose::at(0.0, 0.0)).unwrap();
    let elsewhere = Config { fleet: "beta".to_owned(), ..config.clone() };
    Robot::join(&elsewhere, "r1").await.unwrap().leave().await;
    assert!(!first.is_contested());

    // A process that ignores tokens can put poses.
    let outside = Client::connect(&endpoint, "default").await.unwrap();
    let start = Instant::now();
    while !first.is_contested() {
        assert!(start.elapsed() < RECEIVED_WITHIN);
        outside.put("robot/r1/pose", &json!({"x": 9.0, "y": 9.0})).await.unwrap();
        sleep(Duration::from_millis(100)).await;
    }

    // A robot whose process was killed comes back as itself at once.
    first.leave().await;
    let environment = [("MUSTER_CONNECT", endpoint.as_str())];
    let mut killed =
        Process::start("examples/robot", &["r1"], &environment, folder.path()).unwrap();
    killed.until_prints("r1 has joined", RECEIVED_WITHIN).unwrap();
    killed.kill().unwrap();
    let again = Robot::join(&config, "r1").await.unwrap();
    again.put_pose(Pose::at(0.0, 0.0)).unwrap();
    assert!(!again.is_contested());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_waits_for_its_router_until_its_timeout() {
    let endpoint = free_endpoint().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let connect_timeout = Some(Duration::from_millis(500));
    let hasty =
        Config { routers: Some(vec![endpoint.clone()]), connect_timeout, ..Config::default() };
    let start = Instant::now();
    let error = Robot::join(&hasty, "r1").await.unwrap_err();
    assert!(matches!(error, Error::Unreachable { .. }), "{error}");
    assert!(error.to_string().contains(&endpoint), "{error}");
    assert!(start.elapsed() < RECEIVED_WITHIN);
    let without_timeout = Config { connect_timeout: None, format: Format::Binary, ..hasty };
    let joining = tokio::spawn(async move { Robot::join(&without_timeout, "r1").await });
    sleep(Duration::from_secs(1)).await;
    assert!(!joining.is_finished());
    let mut router = start_router(&endpoint, folder.path()).unwrap();
    let robot = timeout(RECEIVED_WITHIN, joining).await.unwrap().unwrap().unwrap();
    robot.put_pose(Pose::at(0.0, 0.0)).unwrap();
    // Nor does a robot wait for one that is gone as it leaves.
    router.kill().unwrap();
    timeout(RECEIVED_WITHIN, robot.leave()).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn what_zenoh_can_do_is_a_matter_of_its_own_configuration() {
    let endpoint = free_endpoint().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, text: String| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path
    };
    let auth = |inside: String| format!("{{transport: {{auth: {{usrpwd: {{{inside}}}}}}}}}");
    let users = file("users", "r1:secret\n".to_owned());
    let guarded = file("router.json5", auth(format!("dictionary_file: {users:?}")));
    let arguments = ["router", "--listen", &endpoint, "--zenoh-config", guarded.to_str().unwrap()];
    let mut router = Process::start("muster", &arguments, &[], folder.path()).unwrap();
    router.until_prints("router listens at", RECEIVED_WITHIN).unwrap();
    let config = |password: &str| {
        let inside = format!("user: 'r1', password: '{password}'");
        Config {
            routers: Some(vec![endpoint.clone()]),
            connect_timeout: Some(Duration::from_secs(3)),
            zenoh_config: Some(file(&format!("{password}.json5"), auth(inside))),
            ..Config::default()
        }
    };
    let stranger = Robot::join(&config("guess"), "r1").await.unwrap_err();
    assert!(matches!(stranger, Error::Unreachable { .. }), "{stranger}");
    Robot::join(&config("secret"), "r1").await.unwrap().leave().await;
    let missing =
        Config { zenoh_config: Some(folder.path().join("none.json5")), ..config("secret") };
    let error = Robot::join(&missing, "r1").await.unwrap_err().to_string();
    assert!(error.starts_with("zenoh_config: "), "{error}");
}

#[tokio::test]
async fn a_runtime_with_one_thread_gets_an_error_instead_of_a_panic() {
    let error = Robot::join(&Config::default(), "r1").await.unwrap_err();
    assert!(matches!(error, Error::Runtime) && error.to_string().contains("multi_thread"));
}

//! What a secured fleet refuses: strangers, and members that exceed their rights.

use std::path::Path;
use std::time::{Duration, Instant};

use muster_tests::client::{Client, Watch};
use serde_json::json;

use super::{SOON, Secured, deploy, open, text};

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
pub(super) async fn nothing_but(client: &Client, watch: &Watch, forbidden: &[&str], allowed: &str) {
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

    a_viewer_puts_nothing(&secured, &robot, &watch).await;
    robots_declare_their_own_tokens_alone(&secured, &operator, &robot).await;
    only_readers_answer_for_a_service(&operator, &robot).await;
}

/// The operator receives none of a viewer's messages.
async fn a_viewer_puts_nothing(secured: &Secured, robot: &Client, watch: &Watch) {
    let viewer = secured.client("viewer.wall").await;
    watch.clear();
    viewer.put("robot/a1/pose", &json!({"forged": true})).await.unwrap();
    viewer.put("teams", &json!({"forged": true})).await.unwrap();
    viewer.get_one("service/ingest/status").await.expect("what it may do works in this session");
    robot.put("robot/a1/pose", &json!({"control": true})).await.unwrap();
    watch.until("the control", SOON, |value| value["control"] == true).await.unwrap();
    assert!(!watch.all().iter().any(|(_, value)| value["forged"] == true));
}

async fn robots_declare_their_own_tokens_alone(
    secured: &Secured,
    operator: &Client,
    robot: &Client,
) {
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
}

async fn only_readers_answer_for_a_service(operator: &Client, robot: &Client) {
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

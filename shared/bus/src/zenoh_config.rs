//! Zenoh's configuration for a process, in layers, and the endpoints that Zenoh is given.

use std::path::Path;
use std::time::Duration;

use muster_wire::envelope::MAX_SERVICE_PAYLOAD;
use zenoh::config::EndPoint;

use crate::config::BusConfig;
use crate::error::{EndpointError, OpenError};

/// How soon a lost router is tried again, at first and at most.
pub(crate) const RETRY_MS: (u64, u64) = (100, 500);

/// What of Zenoh is logged only if it is an error: an absent router would be logged twice a second.
pub const QUIET_LOG: &str = "zenoh::net::runtime::orchestrator=error";

/// How long a message may wait for a busy link before it is dropped: long enough for a snapshot of
/// some megabytes to leave, short enough that newer data is not far behind.
const WAIT_BEFORE_DROP_US: u64 = 100_000;

/// The same for the fragments of one large message.
const WAIT_FOR_FRAGMENTS_US: u64 = 1_000_000;

/// Largest message that is put together from fragments: the largest between services, and its head.
const MAX_MESSAGE: usize = MAX_SERVICE_PAYLOAD + 64 * 1024;

/// How long a client may take to open a session once its link is there. Zenoh's own 10 s let a hundred silent
/// connections keep all others out for as long.
const ACCEPT_WITHIN_MS: u64 = 2000;

/// Most clients that are opening a session at once; a link beyond is closed. With the time above, strangers
/// must open 500 links a second to keep others out.
const MAX_OPENING: u64 = 1000;

/// Checks the form of an endpoint.
///
/// # Errors
/// An [`EndpointError`] that shows the right form.
pub fn check_endpoint(text: &str) -> Result<(), EndpointError> {
    let wrong =
        |problem| Err(EndpointError { endpoint: muster_wire::message::quoted(text), problem });
    let Ok(endpoint) = text.parse::<EndPoint>() else { return wrong("is no endpoint") };
    match endpoint.protocol().as_str() {
        "unixsock-stream" => Ok(()),
        "tcp" | "tls" | "quic" => {
            let port =
                endpoint.address().as_str().rsplit_once(':').map(|(_, port)| port.to_owned());
            match port.map(|port| port.parse::<u16>()) {
                Some(Ok(_)) => Ok(()),
                _ => wrong("names no port"),
            }
        }
        _ => wrong("is of no protocol that is built in (tcp, tls, quic, unixsock-stream)"),
    }
}

/// Zenoh's configuration for a process: its own defaults, then ours, then the user's file, then what
/// a flag, variable or file of ours sets of mode and endpoints.
///
/// # Errors
/// If the user's file is wrong, or Zenoh refuses a value.
pub(crate) fn zenoh_config(config: &BusConfig) -> Result<zenoh::Config, OpenError> {
    let plain = zenoh::Config::default();
    let mut zenoh = match &config.zenoh_config {
        Some(path) => read_zenoh_config(path)?,
        None => plain.clone(),
    };
    let mut values = built_in_values(config.lease);
    let endpoints = |list: &[String]| serde_json::json!(list).to_string();
    values.push(("scouting/gossip/enabled", config.gossip.to_string()));
    values.push(("mode", format!("\"{}\"", config.mode.value)));
    values.push(("connect/endpoints", endpoints(&config.connect.value)));
    values.push(("listen/endpoints", endpoints(&config.listen.value)));
    let is_chosen = |key: &str| match key {
        "mode" => config.mode.chosen,
        "connect/endpoints" => config.connect.chosen,
        "listen/endpoints" => config.listen.chosen,
        "scouting/gossip/enabled" => config.gossip,
        _ => false,
    };
    for (key, value) in values {
        // What the user's file leaves as Zenoh has it by default is ours to choose.
        let untouched = zenoh.get_json(key).ok() == plain.get_json(key).ok();
        if untouched || is_chosen(key) {
            zenoh.insert_json5(key, &value).map_err(|error| {
                OpenError::Config(format!("Zenoh refuses {key} = {value}: {error}"))
            })?;
        }
    }
    if is_client(&zenoh) {
        // Zenoh would wait at the first router of a list for as long as that is gone. It shall try
        // each one once, and be asked again.
        zenoh
            .insert_json5("connect/timeout_ms", "0")
            .map_err(|error| OpenError::Config(format!("Zenoh refuses timeout_ms: {error}")))?;
    }
    Ok(zenoh)
}

/// Whether a configuration is that of a client, which has one link: to a router.
pub(crate) fn is_client(zenoh: &zenoh::Config) -> bool {
    zenoh.get_json("mode").is_ok_and(|mode| mode == "\"client\"")
}

/// The routers that a process will look for, by a flag, a file of ours, or Zenoh's.
///
/// # Errors
/// If the file with Zenoh's own configuration is wrong.
pub fn routers(config: &BusConfig) -> Result<Vec<String>, OpenError> {
    let zenoh = zenoh_config(config)?;
    Ok(connect_endpoints(&zenoh).unwrap_or_else(|| config.connect.value.clone()))
}

/// The routers that a configuration of Zenoh names; nothing if they depend on the mode.
pub(crate) fn connect_endpoints(zenoh: &zenoh::Config) -> Option<Vec<String>> {
    serde_json::from_str(&zenoh.get_json("connect/endpoints").ok()?).ok()
}

/// The member that a file of `muster deploy certs` is for, such as `operator.kim`; nothing without a file, or if the file
/// does not say it.
///
/// # Errors
/// If the file with Zenoh's own configuration is wrong.
pub fn identity(config: &BusConfig) -> Result<Option<String>, OpenError> {
    let Some(path) = &config.zenoh_config else { return Ok(None) };
    let metadata = read_zenoh_config(path)?.get_json("metadata").unwrap_or_default();
    let metadata: serde_json::Value = serde_json::from_str(&metadata).unwrap_or_default();
    Ok(metadata.get("identity").and_then(|name| name.as_str()).map(str::to_owned))
}

fn read_zenoh_config(path: &Path) -> Result<zenoh::Config, OpenError> {
    zenoh::Config::from_file(path)
        .map_err(|error| OpenError::Config(format!("zenoh_config {}: {error}", path.display())))
}

/// Checks whether a file is a configuration of Zenoh.
///
/// # Errors
/// Names the file and what is wrong with it.
pub fn check_zenoh_config(path: &Path) -> Result<(), OpenError> {
    read_zenoh_config(path).map(drop)
}

fn built_in_values(lease: Duration) -> Vec<(&'static str, String)> {
    let (retry, retry_at_most) = RETRY_MS;
    let retries = format!(
        "{{period_init_ms: {retry}, period_max_ms: {retry_at_most}, period_increase_factor: 2}}"
    );
    const DROP: &str = "transport/link/tx/queue/congestion_control/drop";
    let drop_after = format!(
        "{{wait_before_drop: {WAIT_BEFORE_DROP_US}, max_wait_before_drop_fragments: {WAIT_FOR_FRAGMENTS_US}}}"
    );
    vec![
        ("scouting/multicast/enabled", "false".to_owned()),
        // A router waits so long for others before it opens; without scouting none comes.
        ("scouting/delay", "1".to_owned()),
        ("connect/timeout_ms", "-1".to_owned()),
        ("connect/exit_on_failure", "false".to_owned()),
        ("connect/retry", retries),
        ("listen/timeout_ms", "0".to_owned()),
        ("listen/exit_on_failure", "true".to_owned()),
        ("transport/link/tx/lease", lease.as_millis().to_string()),
        (DROP, drop_after),
        ("transport/link/rx/max_message_size", MAX_MESSAGE.to_string()),
        ("transport/unicast/max_sessions", "10000".to_owned()),
        ("transport/unicast/accept_timeout", ACCEPT_WITHIN_MS.to_string()),
        ("transport/unicast/accept_pending", MAX_OPENING.to_string()),
    ]
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test fails by panicking")]
mod tests {
    use muster_model::id::FleetId;

    use super::*;
    use crate::config::{Choice, DEFAULT_ENDPOINT, LEASE, Mode, ROBOT_LEASE};

    fn router(listen: Choice<Vec<String>>, file: Option<&str>) -> BusConfig {
        BusConfig {
            fleet: FleetId::new("alpha").unwrap(),
            mode: Choice::default(Mode::Router),
            connect: Choice::default(Vec::new()),
            listen,
            zenoh_config: file.map(Into::into),
            gossip: false,
            lease: LEASE,
        }
    }

    fn list(endpoint: &str) -> Vec<String> {
        vec![endpoint.to_owned()]
    }

    #[test]
    fn the_shipped_router_configuration_is_the_built_in_one() {
        let shipped = concat!(env!("CARGO_MANIFEST_DIR"), "/../../deploy/router/plain.json5");
        let values = |config: &BusConfig| -> serde_json::Value {
            serde_json::from_str(&zenoh_config(config).unwrap().to_string()).unwrap()
        };
        let built_in = router(Choice::chosen(list("tcp/0.0.0.0:7447")), None);
        let with_file = router(Choice::default(list(DEFAULT_ENDPOINT)), Some(shipped));
        assert_eq!(values(&with_file), values(&built_in));
        // Also by itself, as Zenoh's own router reads it.
        let alone = zenoh::Config::from_file(shipped).unwrap();
        let ours = zenoh_config(&built_in).unwrap();
        let gossip = ("scouting/gossip/enabled", String::new());
        for (key, _) in built_in_values(LEASE).into_iter().chain([gossip]) {
            assert_eq!(alone.get_json(key).unwrap(), ours.get_json(key).unwrap(), "{key}");
        }
    }

    #[test]
    fn a_router_for_ros_announces_its_peers_to_each_other_whatever_a_file_says() {
        let shipped = concat!(env!("CARGO_MANIFEST_DIR"), "/../../deploy/router/plain.json5");
        let gossips = |gossip: bool, file: Option<&str>| {
            let config =
                BusConfig { gossip, ..router(Choice::default(list(DEFAULT_ENDPOINT)), file) };
            zenoh_config(&config).unwrap().get_json("scouting/gossip/enabled").unwrap()
        };
        for file in [None, Some(shipped)] {
            assert_eq!(
                (gossips(false, file), gossips(true, file)),
                ("false".into(), "true".into())
            );
        }
    }

    #[test]
    fn a_robot_announces_a_longer_lease_unless_its_file_names_one() {
        let path = std::env::temp_dir().join(format!("muster-lease-{}.json5", std::process::id()));
        let file = path.to_str();
        std::fs::write(&path, "{transport: {link: {tx: {lease: 3000}}}}").unwrap();
        for (lease, file, wanted) in
            [(LEASE, None, "2000"), (ROBOT_LEASE, None, "6000"), (ROBOT_LEASE, file, "3000")]
        {
            let config = BusConfig { lease, ..router(Choice::default(Vec::new()), file) };
            let found = zenoh_config(&config).unwrap().get_json("transport/link/tx/lease").unwrap();
            assert_eq!(found, wanted);
        }
        std::fs::remove_file(path).unwrap();
    }

    #[test]
    fn the_routers_are_those_of_the_flag_or_the_file() {
        let path =
            std::env::temp_dir().join(format!("muster-routers-{}.json5", std::process::id()));
        std::fs::write(&path, "{connect: {endpoints: [\"tls/base:7447\"]}}").unwrap();
        let mut config = router(Choice::default(Vec::new()), path.to_str());
        config.mode = Choice::default(Mode::Client);
        config.connect = Choice::default(list(DEFAULT_ENDPOINT));
        assert_eq!(routers(&config).unwrap(), list("tls/base:7447"));
        config.connect = Choice::chosen(list("tcp/flag:7447"));
        assert_eq!(routers(&config).unwrap(), list("tcp/flag:7447"));
        std::fs::remove_file(path).unwrap();
    }
}

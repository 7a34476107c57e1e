//! The files in `deploy/` fit the programs: files are accepted, command lines are understood, and
//! service managers find nothing to complain of.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use muster_tests::SOON;
use muster_tests::ports::{free_address, free_endpoint};
use muster_tests::process::{Process, program, run};
use serde_json::Value;

/// The services that are deployed.
const SERVICES: [&str; 6] = ["ingest", "embedder", "clusterer", "auditor", "historian", "planner"];

/// Highest exposure that `systemd-analyze security` may see, in tenths: 10.0 is a process of root
/// without any restriction.
const MAX_EXPOSURE_TENTHS: &str = "20";

/// How often what a process uses in this test, a fleet without robots, must fit into its limits.
const MIN_LIMIT_FACTOR: u64 = 4;

/// How long a container may take to be alive, and to be so again.
const ALIVE_WITHIN: Duration = Duration::from_secs(20);

/// How much longer a health check may take here than its container allows: a program that starts while all other tests
/// run waits for a processor.
const BUSY_FACTOR: u32 = 4;

fn deploy() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../deploy").canonicalize().unwrap()
}

fn read(name: &str) -> String {
    std::fs::read_to_string(deploy().join(name)).unwrap()
}

/// The values that a program prints, without where they come from.
fn values(program: &str, arguments: &[&str]) -> Vec<String> {
    let (code, out, err) = run(program, arguments, SOON).unwrap();
    assert_eq!(code, Some(0), "{program} {arguments:?}: {err}");
    out.lines().map(|line| line.split("  # ").next().unwrap().to_owned()).collect()
}

#[test]
fn the_configuration_of_each_service_is_the_built_in_one() {
    for service in SERVICES {
        let name = format!("muster-{service}");
        let path = deploy().join(format!("config/{service}.toml"));
        let path = path.to_str().unwrap();
        let (code, _, err) = run(&name, &["--check-config", "--config", path], SOON).unwrap();
        assert_eq!(code, Some(0), "{service}: {err}");
        let built_in = values(&name, &["--print-config"]);
        assert_eq!(values(&name, &["--print-config", "--config", path]), built_in, "{service}");
        // Every setting of the service is in its file, with a value or commented out.
        let text = std::fs::read_to_string(path).unwrap();
        let (code, out, _) = run("muster", &["deploy", "config", service], SOON).unwrap();
        assert_eq!((code, out.as_str()), (Some(0), text.as_str()));
        for value in built_in.iter().filter(|value| !value.starts_with(['[', '#'])) {
            let name = value.split(" = ").next().unwrap();
            let last = name.rsplit('.').next().unwrap();
            assert!(text.contains(&format!("{last} = ")), "{service}: {name} is missing");
        }
    }
}

/// The units, as they would be installed: `%i` and `%d` filled in, the programs as built.
fn install(folder: &Path) -> Vec<PathBuf> {
    let programs = program("muster").unwrap().parent().unwrap().to_str().unwrap().to_owned();
    let write = |name: &str, text: String| {
        let path = folder.join(name);
        std::fs::write(&path, text.replace("/usr/local/bin", &programs)).unwrap();
        path
    };
    let alone = [
        "muster-router.service",
        "muster-console.service",
        "muster-ros2.service",
        "muster-foxglove.service",
        "muster-fleets.service",
    ];
    let mut units = alone.map(|unit| write(unit, read(&format!("systemd/{unit}")))).to_vec();
    write("muster@.service", read("systemd/muster@.service"));
    for service in SERVICES {
        let name = format!("muster@{service}.service");
        units.push(write(&name, read("systemd/muster@.service")));
        std::fs::create_dir(folder.join(format!("{name}.d"))).unwrap();
        write(&format!("{name}.d/secured.conf"), read("systemd/secured.conf"));
    }
    units
}

fn systemd_analyze(arguments: &[&str], unit: &Path) -> (bool, String) {
    let output = Command::new("systemd-analyze").args(arguments).arg(unit).output();
    let output = output.expect("systemd-analyze is needed: apt-get install systemd");
    let text = [output.stdout, output.stderr].concat();
    (output.status.success(), String::from_utf8_lossy(&text).into_owned())
}

#[test]
fn systemd_finds_nothing_to_complain_of() {
    let folder = tempfile::tempdir().unwrap();
    let units = install(folder.path());
    for unit in &units {
        let (good, text) = systemd_analyze(&["verify"], unit);
        // What systemd 254 knows, older ones name and leave out.
        let complaints: Vec<_> = text
            .lines()
            .filter(|line| !line.contains("RestartSteps") && !line.contains("RestartMaxDelaySec"))
            .collect();
        assert!(good && complaints.is_empty(), "{}: {complaints:?}", unit.display());
        let threshold = format!("--threshold={MAX_EXPOSURE_TENTHS}");
        let (good, text) = systemd_analyze(&["security", "--offline=true", &threshold], unit);
        assert!(good, "{}", text.lines().last().unwrap_or_default());
    }
    // The same look finds what is wrong.
    let text = std::fs::read_to_string(&units[0]).unwrap();
    let bad = folder.path().join("bad.service");
    std::fs::write(&bad, text.replace("/muster router", "/no-such-program router")).unwrap();
    assert!(!systemd_analyze(&["verify"], &bad).0);
    std::fs::write(&bad, text.replace("MemoryMax=2G", "MemoryMax=2Q")).unwrap();
    assert!(systemd_analyze(&["verify"], &bad).1.contains("memory limit"));
    std::fs::write(&bad, "[Service]\nExecStart=/bin/true\n").unwrap();
    let threshold = format!("--threshold={MAX_EXPOSURE_TENTHS}");
    assert!(!systemd_analyze(&["security", "--offline=true", &threshold], &bad).0);
}

/// The file of this folder that is installed at a path under `/etc/muster` or the like.
fn shipped(installed: &str) -> String {
    let name = installed.rsplit('/').next().unwrap();
    let place = match name {
        "muster.toml" => name.to_owned(),
        "router.json5" => "router/plain.json5".to_owned(),
        "ros2-topics.toml" => "ros2/topics.toml".to_owned(),
        toml => format!("config/{toml}"),
    };
    deploy().join(place).to_str().unwrap().to_owned()
}

/// A command line with the files that are shipped, to be checked and not run.
fn check_command(line: &[String]) {
    let program = line[0].rsplit('/').next().unwrap();
    let mut arguments: Vec<String> = line[1..].to_vec();
    for argument in &mut arguments {
        if argument.contains(".toml") || argument.contains(".json5") {
            *argument = shipped(argument);
        }
    }
    arguments.push("--check-config".to_owned());
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let (code, out, err) = run(program, &arguments, SOON).unwrap();
    assert_eq!(code, Some(0), "{program} {arguments:?}: {err}");
    assert!(out.contains("valid"), "{out}");
}

#[test]
fn the_units_start_what_there_is() {
    let line = |unit: &str, instance: &str| -> Vec<String> {
        let text = read(unit);
        let line = text.lines().find_map(|line| line.strip_prefix("ExecStart=")).unwrap();
        let line = line.replace("%i", instance).replace("%d", "/run/credentials");
        let line = line.replace("${FLEETS}", "*");
        line.split(' ').map(str::to_owned).collect()
    };
    check_command(&line("systemd/muster-router.service", ""));
    check_command(&line("systemd/muster-console.service", ""));
    check_command(&line("systemd/muster-ros2.service", ""));
    check_command(&line("systemd/muster-foxglove.service", ""));
    check_command(&line("systemd/muster-fleets.service", ""));
    for service in SERVICES {
        check_command(&line("systemd/muster@.service", service));
    }
    // A service without a standby that hangs stops the division until it is restarted.
    let alone = [
        "muster-router.service",
        "muster-console.service",
        "muster-ros2.service",
        "muster-foxglove.service",
        "muster-fleets.service",
    ];
    for unit in alone.into_iter().chain(["muster@.service"]) {
        let unit = &format!("systemd/{unit}");
        assert!(read(unit).lines().any(|line| line == "WatchdogSec=10"), "{unit}");
        // One with the services of many fleets may take more than one service.
        let gibibytes = if unit.contains("fleets") { 4 } else { 2 };
        assert_eq!(bytes(&limit(unit, "MemoryMax")), gibibytes << 30, "{unit}");
        assert_eq!(limit(unit, "TasksMax"), "1024", "{unit}");
    }
}

/// `compose.yaml` with its merge keys filled in.
fn compose() -> Value {
    let mut compose: serde_yaml_ng::Value = serde_yaml_ng::from_str(&read("compose.yaml")).unwrap();
    compose.apply_merge().unwrap();
    serde_json::to_value(compose).unwrap()
}

fn text(value: &Value) -> String {
    value.as_str().unwrap_or_else(|| panic!("{value} is no text")).to_owned()
}

fn texts(list: &Value) -> Vec<String> {
    list.as_array().unwrap_or_else(|| panic!("{list} is no list")).iter().map(text).collect()
}

#[test]
fn the_containers_run_what_is_built() {
    let compose = compose();
    let containers = compose["services"].as_object().unwrap();
    let names: BTreeSet<_> = containers.keys().map(String::as_str).collect();
    assert_eq!(
        names,
        SERVICES.into_iter().chain(["router", "console", "foxglove", "ros2"]).collect()
    );
    let file = read("Containerfile");
    let build = read("build");
    let (_, built) = build.split_once("programs=(").unwrap();
    let built: Vec<&str> = built.split_once(')').unwrap().0.split(' ').collect();
    for (name, own) in containers {
        let build = &own["build"];
        assert_eq!(own["image"], format!("muster:{}", env!("CARGO_PKG_VERSION")));
        assert_eq!(build["context"], "..");
        assert!(deploy().join("..").join(text(&build["dockerfile"])).exists());
        assert_eq!(own["read_only"], true);
        let command = texts(&own["command"]);
        assert!(built.contains(&command[0].as_str()), "{name} is not built");
        check_command(&command);
        for volume in texts(&own["volumes"]) {
            let (from, to) = volume.split_once(':').unwrap();
            if from.starts_with('.') {
                let to = to.strip_suffix(":ro").unwrap();
                assert!(deploy().join(from).exists(), "{from}");
                assert!(command.iter().any(|argument| argument == to), "{name}: {to} is not used");
            } else {
                assert!(compose["volumes"].as_object().unwrap().contains_key(from));
                assert!(file.contains(to), "{to} is not in the image");
            }
        }
        if name != "router" {
            let connect = text(&own["environment"]["MUSTER_CONNECT"]);
            // Those for this host alone are on its network, whose port is that of the router.
            let is_on_host = matches!(name.as_str(), "console" | "foxglove");
            let router = if is_on_host { "127.0.0.1:7447" } else { "router" };
            assert!(connect.contains(router), "{name} does not reach the router");
            let arguments = ["--check-config", "--connect", connect.as_str()];
            assert_eq!(run(&command[0], &arguments, SOON).unwrap().0, Some(0));
        }
    }
}

/// What a router listens at, as Docker names ports: `7447/udp`.
fn listens_at(router: &str) -> BTreeSet<String> {
    let file = read(router);
    let (_, listen) = file.split_once("listen: {").unwrap();
    let (_, endpoints) = listen.split_once("endpoints: ").unwrap();
    let (endpoints, _) = endpoints.split_once(",\n").unwrap();
    let endpoints: Vec<String> = serde_json::from_str(endpoints).unwrap();
    let port = |endpoint: &String| {
        let (protocol, address) = endpoint.split_once('/').unwrap();
        let transport = match protocol {
            "quic" => "udp",
            "tcp" | "tls" => "tcp",
            other => panic!("{router} listens at {other}"),
        };
        format!("{}/{transport}", address.rsplit(':').next().unwrap())
    };
    endpoints.iter().map(port).collect()
}

#[test]
fn robots_reach_plain_and_secured_routers_in_containers() {
    let published: BTreeSet<String> = texts(&compose()["services"]["router"]["ports"])
        .iter()
        .map(|port| {
            let (host, container) = port.split_once(':').unwrap();
            // Without a protocol Docker publishes TCP alone.
            let (number, protocol) = container.split_once('/').unwrap_or((container, "tcp"));
            assert_eq!(host, number, "documents name one port");
            format!("{number}/{protocol}")
        })
        .collect();
    let (plain, secured) = (listens_at("router/plain.json5"), listens_at("router/secured.json5"));
    assert!(plain.contains("7447/tcp") && secured.contains("7447/udp"), "{plain:?} {secured:?}");
    assert_eq!(published, plain.union(&secured).cloned().collect());
}

/// A limit of a unit of systemd.
fn limit(unit: &str, name: &str) -> String {
    let text = read(unit);
    let value = text.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix('='));
    value.unwrap_or_else(|| panic!("{unit} has no {name}")).to_owned()
}

/// Bytes of a limit such as `2G`.
fn bytes(limit: &str) -> u64 {
    let gibibytes = limit.to_uppercase();
    gibibytes.strip_suffix('G').unwrap().parse::<u64>().unwrap() << 30
}

/// A number of a file in `/proc` of a process: threads, or kilobytes.
fn of_status(process: &Process, name: &str) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{}/status", process.id())).unwrap();
    let value = status.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(':'));
    value.unwrap().split_whitespace().next().unwrap().parse().unwrap()
}

/// The code with which the health check of a container ends, and what it printed.
fn check_health(container: &Value, environment: &[(&str, &str)]) -> (Option<i32>, String) {
    let check = &container["healthcheck"];
    let test = texts(&check["test"]);
    assert_eq!(test[0], "CMD", "the image has no shell that is promised");
    let timeout = text(&check["timeout"]);
    let timeout = Duration::from_secs(timeout.strip_suffix('s').unwrap().parse().unwrap());
    let folder = tempfile::tempdir().unwrap();
    let arguments: Vec<&str> = test[2..].iter().map(String::as_str).collect();
    let mut process = Process::start(&test[1], &arguments, environment, folder.path()).unwrap();
    let code = process.wait(BUSY_FACTOR * timeout).unwrap().code();
    (code, process.output())
}

#[test]
fn the_health_check_of_each_container_tells_a_process_that_hangs() {
    let compose = compose();
    let containers = compose["services"].as_object().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let endpoint = free_endpoint().unwrap();
    let topics = deploy().join("ros2/topics.toml").display().to_string();
    let mut running = BTreeMap::new();
    // The services first: they are alive while they wait for their router.
    for name in SERVICES.into_iter().chain(["router", "console", "foxglove", "ros2"]) {
        let own = &containers[name];
        assert!(own["environment"]["MUSTER_HTTP"].is_string(), "{name} has no port to ask");
        let port = free_address().unwrap();
        let environment = [("MUSTER_HTTP", port.as_str())];
        let command = texts(&own["command"]);
        let arguments = match name {
            "router" => vec![command[1].as_str(), "--listen", &endpoint],
            "console" | "foxglove" => vec!["--connect", &endpoint, "--serve", "127.0.0.1:0"],
            "ros2" => vec!["--connect", &endpoint, "--topics", &topics],
            _ => vec!["--connect", &endpoint, "--state-directory", "none"],
        };
        let process = Process::start(&command[0], &arguments, &environment, folder.path()).unwrap();
        until(name, || check_health(own, &environment).0 == Some(0));
        running.insert(name, (process, port));
    }
    for (name, (process, port)) in &mut running {
        let (own, environment) = (&containers[*name], [("MUSTER_HTTP", port.as_str())]);
        let (code, output) = check_health(own, &environment);
        assert_eq!(code, Some(0), "{name}: {output}");
        let unit = match *name {
            "router" => "systemd/muster-router.service",
            "console" => "systemd/muster-console.service",
            "foxglove" => "systemd/muster-foxglove.service",
            "ros2" => "systemd/muster-ros2.service",
            _ => "systemd/muster@.service",
        };
        let (memory, tasks) = (bytes(&limit(unit, "MemoryMax")), limit(unit, "TasksMax"));
        let tasks: u64 = tasks.parse().unwrap();
        assert_eq!(bytes(&text(&own["mem_limit"])), memory, "{name}");
        assert_eq!(own["pids_limit"], tasks, "{name}");
        let resident = of_status(process, "VmHWM") << 10;
        assert!(resident * MIN_LIMIT_FACTOR <= memory, "{name} uses {resident} bytes");
        let threads = of_status(process, "Threads");
        assert!(threads * MIN_LIMIT_FACTOR <= tasks, "{name} has {threads} threads");

        process.signal("STOP").unwrap();
        let (code, output) = check_health(own, &environment);
        assert_eq!(code, Some(1), "{name} hangs: {output}");
        assert!(output.contains("no answer"), "{output}");
        process.signal("CONT").unwrap();
        until(name, || check_health(own, &environment).0 == Some(0));
        process.kill().unwrap();
        assert_eq!(check_health(own, &environment).0, Some(1), "{name} is gone");
    }
    let (code, output) = check_health(&containers["router"], &[]);
    assert_eq!(code, Some(2), "a check without a port is a wrong configuration");
    assert!(output.contains("MUSTER_HTTP"), "{output}");
}

fn until(what: &str, right: impl Fn() -> bool) {
    let start = Instant::now();
    while !right() {
        assert!(start.elapsed() < ALIVE_WITHIN, "{what} is not alive");
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// Whether the tag of a base names one release and not a series that moves on: all numbers of its version, as
/// many as its releases have, and not more; with the digest, if there is one, complete.
fn names_one_release(tag: &str, numbers: usize) -> bool {
    let (tag, digest) = tag.split_once('@').map_or((tag, None), |(tag, rest)| (tag, Some(rest)));
    let version: Vec<&str> = tag.split('-').next().unwrap_or_default().split('.').collect();
    let is_number =
        |part: &&str| !part.is_empty() && part.chars().all(|digit| digit.is_ascii_digit());
    let is_digest = |digest: &str| {
        let hex = digest.strip_prefix("sha256:").unwrap_or_default();
        hex.len() == 64 && hex.chars().all(|digit| digit.is_ascii_hexdigit())
    };
    version.len() == numbers && version.iter().all(is_number) && digest.is_none_or(is_digest)
}

#[test]
fn the_image_is_small_pinned_and_not_root_s() {
    let file = read("Containerfile");
    let lines: Vec<&str> = file.lines().map(str::trim).collect();
    let arguments: Vec<_> = lines.iter().filter_map(|line| line.strip_prefix("ARG ")).collect();
    let bases: Vec<_> = lines.iter().filter_map(|line| line.strip_prefix("FROM ")).collect();
    let bases: Vec<_> = bases.into_iter().filter(|base| !base.starts_with("scratch ")).collect();
    assert_eq!(bases.len(), 2, "one stage builds, another runs");
    // Rust releases have three numbers, those of Debian two.
    for ((base, argument), numbers) in bases.iter().zip(&arguments).zip([3, 2]) {
        let (name, version) = argument.split_once('=').unwrap();
        assert!(base.contains(&format!(":${{{name}}}")), "{base} is not pinned by {name}");
        assert!(names_one_release(version, numbers), "{version}");
    }
    let digest = format!("1.95.0-slim-bookworm@sha256:{}", "0a".repeat(32));
    assert!(names_one_release(&digest, 3));
    for moving in ["latest", "1.95-slim-bookworm", "1-slim-20260101", &digest[..40]] {
        assert!(!names_one_release(moving, 3), "{moving}");
    }
    assert!(!bases[1].contains("rust"), "the compiler stays behind");
    let build = read("build");
    assert!(file.contains("RUN deploy/build /programs\n"));
    assert!(build.contains("cargo build --profile dist --locked"));
    let user = lines.iter().find_map(|line| line.strip_prefix("USER ")).unwrap();
    assert!(user.split(':').all(|id| id.parse::<u32>().is_ok_and(|id| id > 0)), "{user}");
    for name in SERVICES.iter().map(|service| format!("muster-{service}")) {
        assert!(program(&name).is_ok());
        assert_eq!(build.matches(&format!(" {name}")).count(), 1, "{name} is built and copied");
    }
}

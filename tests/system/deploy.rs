//! The files in `deploy/` fit the programs: files are accepted, command lines are understood, and
//! service managers find nothing to complain of.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use muster_tests::cluster::SERVICES;
use muster_tests::process::{program, run};
use serde_json::Value;

const SOON: Duration = Duration::from_secs(20);

/// Highest exposure that `systemd-analyze security` may see, in tenths: 10.0 is a process of root
/// without any restriction.
const MAX_EXPOSURE_TENTHS: &str = "20";

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
    let mut units = vec![write("muster-router.service", read("systemd/muster-router.service"))];
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
    std::fs::write(&bad, "[Service]\nExecStart=/bin/true\n").unwrap();
    let threshold = format!("--threshold={MAX_EXPOSURE_TENTHS}");
    assert!(!systemd_analyze(&["security", "--offline=true", &threshold], &bad).0);
}

/// The file of this folder that is installed at a path under `/etc/muster` or the like.
fn shipped(installed: &str) -> String {
    let name = installed.rsplit('/').next().unwrap();
    let place = match name {
        "router.json5" => "router/plain.json5".to_owned(),
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
        line.split(' ').map(str::to_owned).collect()
    };
    check_command(&line("systemd/muster-router.service", ""));
    for service in SERVICES {
        check_command(&line("systemd/muster@.service", service));
    }
    // A service without a standby that hangs stops the division until it is restarted.
    for unit in ["systemd/muster-router.service", "systemd/muster@.service"] {
        assert!(read(unit).lines().any(|line| line == "WatchdogSec=10"), "{unit}");
    }
}

#[test]
fn the_containers_run_what_is_built() {
    let compose: Value = serde_yaml_ng::from_str(&read("compose.yaml")).unwrap();
    let text = |value: &Value| value.as_str().unwrap().to_owned();
    let containers = compose["services"].as_object().unwrap();
    let names: BTreeSet<_> = containers.keys().map(String::as_str).collect();
    assert_eq!(names, SERVICES.into_iter().chain(["router"]).collect());
    let file = read("Containerfile");
    let build = read("build");
    let (_, built) = build.split_once("programs=(").unwrap();
    let built: Vec<&str> = built.split_once(')').unwrap().0.split(' ').collect();
    for (name, own) in containers {
        // A YAML merge key is left as it is by the parser.
        let of = |key: &str| if own[key].is_null() { &own["<<"][key] } else { &own[key] };
        let build = of("build");
        assert_eq!(build["context"], "..");
        assert!(deploy().join("..").join(text(&build["dockerfile"])).exists());
        assert_eq!(*of("read_only"), true);
        let command: Vec<String> = own["command"].as_array().unwrap().iter().map(text).collect();
        assert!(built.contains(&command[0].as_str()), "{name} is not built");
        check_command(&command);
        for volume in own["volumes"].as_array().unwrap() {
            let volume = text(volume);
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
            assert!(connect.contains("router"), "services reach the router by its name");
            let arguments = ["--check-config", "--connect", connect.as_str()];
            assert_eq!(run(&command[0], &arguments, SOON).unwrap().0, Some(0));
        }
    }
}

#[test]
fn the_image_is_small_pinned_and_not_root_s() {
    let file = read("Containerfile");
    let lines: Vec<&str> = file.lines().map(str::trim).collect();
    let arguments: Vec<_> = lines.iter().filter_map(|line| line.strip_prefix("ARG ")).collect();
    let bases: Vec<_> = lines.iter().filter_map(|line| line.strip_prefix("FROM ")).collect();
    let bases: Vec<_> = bases.into_iter().filter(|base| !base.starts_with("scratch ")).collect();
    assert_eq!(bases.len(), 2, "one stage builds, another runs");
    for (base, argument) in bases.iter().zip(&arguments) {
        let (name, version) = argument.split_once('=').unwrap();
        assert!(base.contains(&format!(":${{{name}}}")), "{base} is not pinned by {name}");
        let numbers = version.chars().filter(char::is_ascii_digit).count();
        assert!(numbers >= 3 && !version.contains("latest"), "{version}");
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

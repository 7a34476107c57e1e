//! The rules that a compiler does not check: which crate may depend on which.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;

/// The names of all packages that a package depends on when it is built.
fn dependencies(package: &str, flags: &[&str]) -> BTreeSet<String> {
    let output = Command::new(env!("CARGO"))
        .args(["tree", "--locked", "-e", "normal", "--prefix", "none", "-f", "{p}", "-p", package])
        .args(flags)
        .current_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).unwrap();
    text.lines().filter_map(|line| line.split(' ').next()).map(str::to_owned).collect()
}

const SERVICES: [&str; 9] = [
    "muster-ingest",
    "muster-embedder",
    "muster-clusterer",
    "muster-auditor",
    "muster-historian",
    "muster-planner",
    "muster-console",
    "muster-ros2",
    "muster-foxglove",
];

#[test]
fn the_cores_are_built_without_bus_and_runtime() {
    for service in SERVICES {
        let all = dependencies(service, &["--no-default-features"]);
        for forbidden in ["zenoh", "tokio", "clap", "muster-runtime", "rusqlite"] {
            assert!(!all.contains(forbidden), "the core of {service} depends on {forbidden}");
        }
        // The same look finds them where they belong, so that it would see them.
        let all = dependencies(service, &[]);
        assert!(all.contains("zenoh") && all.contains("tokio"), "{service}");
        assert_eq!(all.contains("rusqlite"), service == "muster-historian", "{service}");
    }
}

#[test]
fn fuzzing_is_built_without_bus_and_runtime() {
    let all = dependencies("muster-fuzz", &["--features", "coverage"]);
    for forbidden in ["zenoh", "tokio", "muster-runtime"] {
        assert!(!all.contains(forbidden), "what is fuzzed depends on {forbidden}");
    }
    assert!(all.contains("libfuzzer-sys"));
}

#[test]
fn experiments_are_built_without_bus_and_shell_but_for_the_physical_case() {
    let all = dependencies("muster-experiments", &["--no-default-features"]);
    for forbidden in ["zenoh", "tokio", "muster-runtime"] {
        assert!(!all.contains(forbidden), "experiments depend on {forbidden}");
    }
    assert!(dependencies("muster-experiments", &[]).contains("zenoh"));
}

/// `cargo run --release -- demo` builds the default members alone, and what they need.
#[test]
fn the_demo_builds_neither_the_bridge_nor_the_viewers_server() {
    let manifest = include_str!("../../Cargo.toml");
    assert!(manifest.contains("default-members = [\"services/muster\"]"));
    let all = dependencies("muster", &[]);
    for forbidden in ["muster-ros2", "muster-foxglove", "foxglove", "mcap"] {
        assert!(!all.contains(forbidden), "the demo builds {forbidden}");
    }
    // The same look finds them where they belong, so that it would see them.
    let viewers = dependencies("muster-foxglove", &[]);
    assert!(["foxglove", "mcap"].iter().all(|package| viewers.contains(*package)));
}

#[test]
fn no_service_imports_another() {
    for service in SERVICES {
        let all = dependencies(service, &[]);
        for other in SERVICES.iter().filter(|other| **other != service) {
            assert!(!all.contains(*other), "{service} depends on {other}");
        }
    }
}

#[test]
fn shared_crates_know_only_what_they_may() {
    let rules: [(&str, &[&str]); 10] = [
        ("muster-model", &["muster-model"]),
        ("muster-numeric", &["muster-model", "muster-numeric"]),
        ("muster-relation", &["muster-model", "muster-relation"]),
        ("muster-wire", &["muster-model", "muster-wire"]),
        ("muster-ros", &["muster-ros"]),
        ("muster-service", &["muster-service", "muster-model", "muster-wire"]),
        ("muster-scenario", &["muster-model", "muster-scenario"]),
        ("muster-method", &["muster-method", "muster-model", "muster-numeric"]),
        (
            "muster-division",
            &["muster-division", "muster-method", "muster-model", "muster-numeric"],
        ),
        (
            "muster-solve",
            &[
                "muster-division",
                "muster-method",
                "muster-model",
                "muster-numeric",
                "muster-relation",
                "muster-solve",
            ],
        ),
    ];
    for (package, allowed) in rules {
        let all = dependencies(package, &[]);
        let ours: BTreeSet<_> =
            all.iter().filter(|name| name.starts_with("muster-")).map(String::as_str).collect();
        assert_eq!(ours, BTreeSet::from_iter(allowed.iter().copied()), "{package}");
        assert!(!all.contains("zenoh") && !all.contains("tokio"), "{package}");
    }
    let only = |crate_name: &str, owner: &str| {
        for (package, _) in rules {
            let has = dependencies(package, &["--depth", "1"]).contains(crate_name);
            assert_eq!(has, package == owner, "{package} and {crate_name}");
        }
    };
    only("bincode", "muster-wire");
    only("faer", "muster-numeric");
    only("twox-hash", "muster-ros");
    let ingest = dependencies("muster-ingest", &[]);
    assert!(!ingest.contains("faer"), "a robot that runs only ingest links no linear algebra");
}

#[test]
fn a_robot_takes_the_bus_and_nothing_of_our_programs() {
    let bus = ["muster-bus", "muster-model", "muster-wire"];
    let client = ["muster-bus", "muster-client", "muster-model", "muster-wire"];
    for (package, allowed) in [("muster-bus", &bus[..]), ("muster-client", &client[..])] {
        let all = dependencies(package, &[]);
        let ours: BTreeSet<_> =
            all.iter().filter(|name| name.starts_with("muster-")).map(String::as_str).collect();
        assert_eq!(ours, BTreeSet::from_iter(allowed.iter().copied()), "{package}");
        for forbidden in ["clap", "tempfile", "faer", "rusqlite"] {
            assert!(!all.contains(forbidden), "{package} depends on {forbidden}");
        }
        assert!(all.contains("zenoh"), "{package}");
    }
}

#[test]
fn the_console_talks_to_a_fleet_through_the_client_alone() {
    // What runs services or a router, and the probe of a router that opens no session.
    const WITH_A_BUS: [&str; 6] = [
        "/up.rs",
        "/fleets.rs",
        "/demo.rs",
        "/router.rs",
        "/doctor/mod.rs",
        "/doctor/findings/router.rs",
    ];
    const BUS: [&str; 5] = [
        "muster_bus",
        "muster_runtime::bus",
        "muster_runtime::inbox",
        "muster_runtime::outbox",
        "muster_runtime::shell",
    ];
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../services/muster/src");
    let root = root.canonicalize().unwrap();
    let mut exempt = 0;
    for (name, text) in sources(&root, "/deploy/") {
        if WITH_A_BUS.iter().any(|file| name.ends_with(file)) {
            exempt += usize::from(BUS.iter().any(|what| text.contains(what)));
            continue;
        }
        for what in BUS {
            assert!(!text.contains(what), "{name} names {what}");
        }
    }
    assert_eq!(exempt, WITH_A_BUS.len(), "each exemption is needed");
    // The page as well: its options alone read who commands from the configuration of the bus.
    let page = root.join("../../console/src").canonicalize().unwrap();
    for (name, text) in sources(&page, "/options.rs") {
        for what in BUS {
            assert!(!text.contains(what), "{name} names {what}");
        }
    }
    let probe = std::fs::read_to_string(root.join("doctor/mod.rs")).unwrap();
    assert!(!probe.contains("Bus::open"), "the doctor opens no session of its own");
}

/// Every source file outside of a folder.
fn sources(of: &Path, outside: &str) -> Vec<(String, String)> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(of).unwrap() {
        let path = entry.unwrap().path();
        let name = path.to_string_lossy().into_owned();
        if name.contains(outside) || name.ends_with("/target") || name.contains("/.") {
            continue;
        }
        if path.is_dir() {
            found.extend(sources(&path, outside));
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push((name, std::fs::read_to_string(&path).unwrap()));
        }
    }
    found
}

#[test]
fn each_foreign_crate_is_spoken_to_in_one_place() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").canonicalize().unwrap();
    for (what, place) in [
        ("zenoh::", "shared/bus"),
        ("bincode::", "shared/wire"),
        ("faer::", "shared/numeric"),
        ("rusqlite::", "services/historian"),
        ("mcap::", "services/foxglove"),
    ] {
        for folder in ["services", "shared"] {
            for (name, text) in sources(&root.join(folder), place) {
                assert!(!text.contains(what), "{name} uses {what}");
            }
        }
    }
}

/// Crates that run live, in the simulation and from a recording: `clippy.toml` says what they must not do.
const PURE: [&str; 17] = [
    "shared/service",
    "shared/division",
    "shared/method",
    "shared/model",
    "shared/numeric",
    "shared/relation",
    "shared/ros",
    "shared/scenario",
    "shared/wire",
    "services/auditor",
    "services/clusterer",
    "services/console",
    "services/embedder",
    "services/historian",
    "services/ingest",
    "services/planner",
    "services/ros2",
];

#[test]
fn pure_crates_turn_on_the_lints_against_clocks_threads_and_unordered_iteration() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    for name in PURE {
        let text = std::fs::read_to_string(root.join(name).join("src/lib.rs")).unwrap();
        let lints = "#![warn(clippy::disallowed_methods, clippy::disallowed_types, clippy::iter_over_hash_type)]";
        assert!(text.contains(lints), "{name}/src/lib.rs must have {lints}");
    }
    let config = std::fs::read_to_string(root.join("clippy.toml")).unwrap();
    for what in ["Instant", "SystemTime", "thread::spawn", "available_parallelism", "rand::rng"] {
        assert!(config.contains(what), "clippy.toml must name {what}");
    }
}

#[test]
fn no_folder_stands_at_the_top_but_those_of_the_project() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let ignored = std::fs::read_to_string(root.join(".gitignore")).unwrap();
    let is_ignored = |name: &String| ignored.lines().any(|line| line.trim_matches('/') == name);
    let entries = std::fs::read_dir(root).unwrap().map(Result::unwrap);
    let folders = entries.filter(|entry| entry.file_type().unwrap().is_dir());
    let names = folders.map(|folder| folder.file_name().into_string().unwrap());
    let folders: BTreeSet<String> =
        names.filter(|name| !name.starts_with('.') && !is_ignored(name)).collect();
    let folders: Vec<&str> = folders.iter().map(String::as_str).collect();
    assert_eq!(folders, ["deploy", "services", "shared", "tests"]);
}

#[test]
fn the_robot_of_the_readme_is_the_one_that_is_compiled() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let read = |path: &str| std::fs::read_to_string(root.join(path)).unwrap();
    let block = |text: &str, start: &str| {
        let (_, rest) = text.split_once(start).expect("the block is there");
        rest.split_once("```").unwrap().0.to_owned()
    };
    let docs: String = read("shared/client/src/lib.rs")
        .lines()
        .filter_map(|line| line.strip_prefix("//!"))
        .map(|line| format!("{}\n", line.strip_prefix(' ').unwrap_or(line)))
        .collect();
    assert_eq!(block(&read("README.md"), "```rust\n"), block(&docs, "```no_run\n"));
}

/// Whether a source file has tests of its own.
fn has_tests(path: &Path) -> bool {
    std::fs::read_to_string(path).unwrap().contains("#[test]")
}

#[test]
fn cargo_runs_every_test() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--locked", "--no-deps", "--format-version", "1"])
        .current_dir(&root)
        .output()
        .unwrap();
    let metadata: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let mut gathered = 0;
    for package in metadata["packages"].as_array().unwrap() {
        let targets = package["targets"].as_array().unwrap();
        let sources: Vec<&Path> =
            targets.iter().map(|target| Path::new(target["src_path"].as_str().unwrap())).collect();
        for (target, source) in targets.iter().zip(&sources) {
            assert!(
                target["kind"][0] != "bin" || target["test"] == true || !has_tests(source),
                "{} has tests and `test = false`",
                source.display()
            );
        }
        // Where one program holds all tests, a file that it does not name is not compiled.
        let folder = Path::new(package["manifest_path"].as_str().unwrap()).with_file_name("tests");
        let main = folder.join("main.rs");
        if !sources.contains(&main.as_path()) {
            continue;
        }
        gathered += 1;
        let modules = std::fs::read_to_string(&main).unwrap();
        for entry in std::fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_stem().unwrap().to_string_lossy().into_owned();
            assert!(
                path.extension().is_none_or(|extension| extension != "rs")
                    || sources.contains(&path.as_path())
                    || modules.contains(&format!("mod {name};")),
                "{} is a part of no program",
                path.display()
            );
        }
    }
    assert!(gathered > 0);
}

/// Where the workspace's ban of unsafe code does not hold as it stands.
const UNSAFE_ALLOWED_BY_MACROS: [&str; 1] = ["tests/peers/rust/Cargo.toml"];

#[test]
fn no_crate_of_ours_may_contain_unsafe_code() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").canonicalize().unwrap();
    let read = |path: &str| std::fs::read_to_string(root.join(path)).unwrap();
    let workspace = read("Cargo.toml");
    assert!(workspace.contains("[workspace.lints.rust]\nunsafe_code = \"forbid\"\n"));
    let (_, members) = workspace.split_once("members = [").unwrap();
    let members: Vec<&str> =
        members.split_once(']').unwrap().0.split('"').skip(1).step_by(2).collect();
    assert!(members.len() > 15, "{members:?}");
    for member in members {
        let manifest = read(&format!("{member}/Cargo.toml"));
        assert!(manifest.contains("[lints]\nworkspace = true\n"), "{member} has lints of its own");
    }
    // The ban can only be lifted where a comment says why.
    for manifest in UNSAFE_ALLOWED_BY_MACROS {
        let text = read(manifest);
        let mut lines = text.lines().rev().skip_while(|line| *line != "unsafe_code = \"deny\"");
        assert!(lines.nth(1).unwrap().starts_with("# "), "{manifest} does not say why");
    }
}

#[test]
fn each_accepted_exception_of_dependencies_has_its_reason_and_is_needed() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let read = |path: &str| std::fs::read_to_string(root.join(path)).unwrap();
    let (rules, lock) = (read("deny.toml"), read("Cargo.lock"));
    let list = |name: &str| -> Vec<String> {
        let (_, entries) = rules.split_once(&format!("\n{name} = [")).expect(name);
        let entries = entries.split_once("]\n").unwrap().0;
        let is_entry = |line: &&str| !line.is_empty() && !line.starts_with('#');
        entries.lines().map(str::trim).filter(is_entry).map(str::to_owned).collect()
    };
    let reason = |entry: &str| {
        let reason =
            entry.split_once("reason = \"").map(|(_, rest)| rest.split('"').next().unwrap());
        reason.unwrap_or_else(|| panic!("no reason: {entry}")).to_owned()
    };
    let accepted = list("ignore");
    assert!(!accepted.is_empty());
    for entry in &accepted {
        assert!(entry.starts_with("{ id = \"RUSTSEC-"), "{entry}");
        let reason = reason(entry);
        // It begins with the crate, which must still be there, and says what would end the exception.
        let name = reason.split(' ').next().unwrap();
        assert!(lock.contains(&format!("name = \"{name}\"\n")), "{name} is gone: {entry}");
        assert!(reason.contains(" Ends with "), "{entry}");
    }
    for entry in list("deny") {
        reason(&entry);
    }
    // What the reason of lz4_flex rests on.
    let output = Command::new(env!("CARGO"))
        .args(["tree", "--locked", "-e", "features", "-i", "zenoh-transport", "--workspace"])
        .current_dir(&root)
        .output()
        .unwrap();
    let features = String::from_utf8(output.stdout).unwrap();
    assert!(features.contains("feature \"transport_tcp\""), "{features}");
    assert!(!features.contains("transport_compression"), "a feature turns lz4_flex on");
}

/// A version such as `1.89` or `1.89.0` as numbers that compare.
fn version(text: &str) -> Vec<u32> {
    text.split('.').take(2).map(|number| number.parse().unwrap()).collect()
}

/// The lint `incompatible_msrv` looks at the standard library; this at the dependencies.
#[test]
fn no_dependency_needs_a_newer_rust_than_is_promised() {
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--locked", "--format-version", "1"])
        .current_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let metadata: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let promised = version(env!("CARGO_PKG_RUST_VERSION"));
    let packages = metadata["packages"].as_array().unwrap();
    for package in packages {
        let Some(needed) = package["rust_version"].as_str() else { continue };
        assert!(version(needed) <= promised, "{} needs Rust {needed}", package["name"]);
    }
    assert!(packages.len() > 300, "{}", packages.len());
}

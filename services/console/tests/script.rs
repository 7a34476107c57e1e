//! The scripts of the page without a browser: `script.mjs` calls them in Node.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

use std::path::Path;
use std::process::Command;

use muster_console::assets::Asset;

/// Runs a test of `script.mjs` with the scripts as they are in the program.
fn run(test: &str) {
    let folder = tempfile::tempdir().unwrap();
    let scripts = Asset::ALL.iter().filter(|asset| asset.kind.starts_with("text/javascript"));
    for script in scripts {
        let path = folder.path().join(script.path);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, script.bytes).unwrap();
    }
    // In a browser the page says that they are modules.
    std::fs::write(folder.path().join("package.json"), "{\"type\": \"module\"}").unwrap();
    let tests = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/script.mjs");
    let output = Command::new("node").arg(tests).arg(folder.path()).arg(test).output();
    let output = output.expect("node is there; tests/run installs it");
    let problem = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{problem}");
}

#[test]
fn what_holds_is_done_and_what_may_hold_is_unknown() {
    run("orders");
}

#[test]
fn an_accepted_proposal_is_taken_back_without_the_list_of_its_parts() {
    run("proposals");
}

#[test]
fn each_wish_has_an_id_of_its_own() {
    run("wishes");
}

#[test]
fn a_problem_goes_away_with_the_next_good_message_of_its_topic() {
    run("problems");
}

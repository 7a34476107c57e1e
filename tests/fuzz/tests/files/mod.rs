//! Configuration files, which the shell reads: without guidance by coverage, since the shell cannot
//! be built without Zenoh.

use std::path::Path;

use muster_fuzz::allocation;
use muster_fuzz::mutate::Mutator;
use muster_model::id::ServiceName;
use muster_runtime::config::{Mode, ProcessArgs, ProcessConfig};

/// Mutations that are tried.
const MUTATIONS: usize = 1500;

/// Longest file in bytes that is tried.
const LONGEST: usize = 8192;

/// Longest error in characters: it shows the line that is wrong, as a compiler does.
const MAX_ERROR: usize = 2000;

/// Bytes that reading a file may hold, for each byte of it and beyond that.
const MAX_BYTES_HELD: (usize, usize) = (256, 4 << 20);

pub(crate) fn no_configuration_file_breaks_a_promise(inputs: &[Vec<u8>], seed: u64) {
    assert!(!inputs.is_empty(), "config has no corpus");
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("muster.toml");
    for input in inputs {
        run(&path, input);
    }
    let mut mutator = Mutator::new(seed);
    for _ in 0..MUTATIONS {
        run(&path, &mutator.next(inputs, LONGEST));
    }
}

/// Reads a file as a process does that starts with it. What is accepted is printed, and accepted
/// again with the same values.
fn run(path: &Path, input: &[u8]) {
    std::fs::write(path, input).unwrap();
    let args = ProcessArgs { config: Some(path.to_owned()), ..ProcessArgs::default() };
    let resolve = || ProcessConfig::resolve(&args, Mode::Client, &|_| None);
    let limit = MAX_BYTES_HELD.0 * input.len() + MAX_BYTES_HELD.1;
    let text = String::from_utf8_lossy(input);
    match allocation::at_most(limit, "a configuration", resolve) {
        Err(error) => {
            let message = error.message;
            assert!(message.chars().count() <= MAX_ERROR, "{message:?}\n{text}");
            let controls = |c: char| c.is_control() && c != '\n';
            assert!(!message.chars().any(controls), "{message:?}\n{text}");
        }
        Ok(config) => {
            let printed = config.print(&ServiceName::ALL).unwrap();
            std::fs::write(path, &printed).unwrap();
            let again = resolve().unwrap_or_else(|error| panic!("{error}\n{printed}\n{text}"));
            let values = |text: &str| {
                text.lines().map(|line| line.split("  # ").next().unwrap().to_owned()).collect()
            };
            let (before, after): (Vec<String>, Vec<String>) =
                (values(&printed), values(&again.print(&ServiceName::ALL).unwrap()));
            assert_eq!(before, after);
        }
    }
}

//! Every input of the corpus, and seeded mutations of them, with plain `cargo test`.
//!
//! One test runs all, one after the other: memory is measured for the whole process.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

mod files;

use std::collections::BTreeSet;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use muster_fuzz::mutate::Mutator;
use muster_fuzz::{Outcome, TARGETS, Target, find, seeds};

/// The seed of all mutations.
const SEED: u64 = 20_261_121;

/// Longest that one input may take, without optimisation and on a busy machine.
const MAX_TIME: Duration = Duration::from_secs(20);

/// Most files of the corpus.
const MAX_FILES: usize = 500;

/// Most bytes of the corpus.
const MAX_BYTES: usize = 500_000;

fn corpus() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus")
}

/// The inputs of a target, in the order of their names.
fn inputs(folder: &Path) -> Vec<Vec<u8>> {
    let mut paths: Vec<_> =
        std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    paths.iter().map(|path| std::fs::read(path).unwrap()).collect()
}

/// Seeds that are to be refused; all others but random ones must be accepted.
const REFUSED_SEEDS: [&str; 5] = [
    "packet/seed-token-d",
    "packet/seed-token-c",
    "key/seed-key-8",
    "request/seed-request-7",
    "recording/seed-broken-off",
];

/// Runs one input, and keeps it if it breaks a promise.
fn run(target: &Target, input: &[u8]) -> Outcome {
    let since = Instant::now();
    let result = catch_unwind(AssertUnwindSafe(|| (target.run)(input)));
    let took = since.elapsed();
    if let Ok(outcome) = result
        && took <= MAX_TIME
    {
        return outcome;
    }
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("finds");
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join(target.name);
    std::fs::write(&path, input).unwrap();
    panic!(
        "{} breaks a promise, after {took:?}; the input is {}: once the fault is fixed, copy it to {}",
        target.name,
        path.display(),
        corpus().join(target.name).display()
    );
}

#[test]
fn no_input_breaks_a_promise() {
    for target in &TARGETS {
        let since = Instant::now();
        let inputs = inputs(&corpus().join(target.name));
        assert!(!inputs.is_empty(), "{} has no corpus", target.name);
        run(target, &[]);
        for input in &inputs {
            run(target, input);
        }
        let mut mutator = Mutator::new(SEED);
        for _ in 0..target.mutations {
            run(target, &mutator.next(&inputs, target.longest));
        }
        let took = since.elapsed();
        println!(
            "{}: {} inputs, {} mutations, {took:?}",
            target.name,
            inputs.len(),
            target.mutations
        );
    }
    files::no_configuration_file_breaks_a_promise(&inputs(&corpus().join("config")), SEED);
    seeds_are_accepted();
}

/// The committed seeds are those of `seeds`, and reach the code behind their reader.
fn seeds_are_accepted() {
    let mut refused = Vec::new();
    for seed in seeds::all() {
        let place = format!("{}/seed-{}", seed.target, seed.name);
        let bytes = std::fs::read(corpus().join(&place)).unwrap();
        // Processors may round the embeddings of a pipeline differently.
        assert!(seed.name == "pipeline" || bytes == seed.bytes, "{place}: run `fuzz-seeds` again");
        let outcome = run(&find(seed.target).unwrap(), &bytes);
        if outcome == Outcome::Refused && !seed.name.starts_with("random") {
            refused.push(place);
        }
    }
    assert_eq!(refused, REFUSED_SEEDS);
}

#[test]
fn the_corpus_is_small_and_has_one_folder_per_target() {
    let mut names: BTreeSet<_> = TARGETS.iter().map(|target| target.name).collect();
    names.insert("config");
    let mut files = 0;
    let mut bytes = 0;
    for folder in std::fs::read_dir(corpus()).unwrap() {
        let folder = folder.unwrap().path();
        let name = folder.file_name().unwrap().to_str().unwrap().to_owned();
        assert!(names.remove(name.as_str()), "{name} is the folder of no target");
        for input in inputs(&folder) {
            files += 1;
            bytes += input.len();
        }
    }
    assert!(names.is_empty(), "there is no corpus for {names:?}");
    assert!(files <= MAX_FILES && bytes <= MAX_BYTES, "{files} files of {bytes} bytes");
}

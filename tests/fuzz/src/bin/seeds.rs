//! Writes the seeds of all targets into folders of their names below the folder that is named, which must be there: a flag or a
//! wrong path is no corpus.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a failure ends it with its reason")]

use std::path::PathBuf;

fn main() {
    let corpus = std::env::args_os().nth(1).map(PathBuf::from).unwrap_or_default();
    assert!(corpus.is_dir(), "name the folder of the corpus, as in: fuzz-seeds tests/fuzz/corpus");
    for seed in muster_fuzz::seeds::all() {
        let folder = corpus.join(seed.target);
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join(format!("seed-{}", seed.name)), seed.bytes).unwrap();
    }
}

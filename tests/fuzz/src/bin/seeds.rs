//! Writes the seeds of all targets into folders of their names below the folder that is named.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a failure ends it with its reason")]

use std::path::PathBuf;

fn main() {
    let folder = std::env::args_os().nth(1).expect("name the folder of the corpus");
    for seed in muster_fuzz::seeds::all() {
        let folder = PathBuf::from(&folder).join(seed.target);
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join(format!("seed-{}", seed.name)), seed.bytes).unwrap();
    }
}

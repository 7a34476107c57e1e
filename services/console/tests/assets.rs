//! The page in the program is the folder `web`, small enough, and asks no other host for anything.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

use std::collections::BTreeSet;
use std::path::Path;

use muster_console::assets::Asset;

/// What was taken from npm, unchanged: package, file of it, our name, and SHA-256 (`sha256sum`).
const VENDORED: [(&str, &str, &str, &str); 5] = [
    (
        "preact@11.2.0",
        "dist/preact.mjs",
        "vendor/preact.js",
        "bdcbd9abdf2c77c5c45326eab42191e949222d479d0d5f69467387a77040cb55",
    ),
    (
        "preact@11.2.0",
        "LICENSE",
        "vendor/preact.LICENSE",
        "1fe6958409c8c257a70c587a18b6f7f412b179b456630790d30b2ec9a8e4b7d4",
    ),
    (
        "uplot@1.6.32",
        "dist/uPlot.iife.min.js",
        "vendor/uPlot.js",
        "19c8d4c6ad88929a79f4ae49d6f7161566dfd0ba3d15cc495e974f787eb78f1f",
    ),
    (
        "uplot@1.6.32",
        "dist/uPlot.min.css",
        "vendor/uPlot.css",
        "df630c6a8d6f8eeaff264b50f73ce5b114f646ffd9a0bb74f049b0a00135fa04",
    ),
    (
        "uplot@1.6.32",
        "LICENSE",
        "vendor/uPlot.LICENSE",
        "8f989229699b4fe2f1a0432d0e9edc338a8a911e250e2d1b01ecd770a5f5b1bd",
    ),
];

fn folder() -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("web")
}

fn files(of: &Path, below: &str, found: &mut BTreeSet<String>) {
    for entry in std::fs::read_dir(of).unwrap() {
        let path = entry.unwrap().path();
        let name = format!("{below}{}", path.file_name().unwrap().to_str().unwrap());
        if path.is_dir() {
            files(&path, &format!("{name}/"), found);
        } else if !name.ends_with(".d.ts") {
            found.insert(name);
        }
    }
}

#[test]
fn every_file_of_the_folder_is_in_the_program_and_nothing_else() {
    let mut found = BTreeSet::new();
    files(&folder(), "", &mut found);
    let table: BTreeSet<String> = Asset::ALL.iter().map(|asset| asset.path.to_owned()).collect();
    assert_eq!(table, found);
    for asset in Asset::ALL {
        assert_eq!(
            asset.bytes,
            std::fs::read(folder().join(asset.path)).unwrap(),
            "{}",
            asset.path
        );
    }
}

#[test]
fn what_is_not_ours_is_unchanged_and_has_its_licence() {
    for (package, file, path, wanted) in VENDORED {
        let output =
            std::process::Command::new("sha256sum").arg(folder().join(path)).output().unwrap();
        let text = String::from_utf8(output.stdout).unwrap();
        assert_eq!(text.split(' ').next(), Some(wanted), "{path} is not {file} of {package}");
    }
    let vendored = Asset::ALL.iter().filter(|asset| asset.path.starts_with("vendor/"));
    for asset in vendored {
        assert!(VENDORED.iter().any(|(.., path, _)| *path == asset.path), "{}", asset.path);
        if asset.path.ends_with(".LICENSE") {
            assert!(String::from_utf8_lossy(asset.bytes).contains("MIT"), "{}", asset.path);
        }
    }
}

#[test]
fn the_page_names_no_other_host_and_has_no_inline_script() {
    let own = Asset::ALL.iter().filter(|asset| !asset.path.starts_with("vendor/"));
    for asset in own {
        let text = std::str::from_utf8(asset.bytes).unwrap();
        let text = text.replace("http://www.w3.org/2000/svg", "");
        for foreign in ["http://", "https://", "//cdn", "innerHTML", "eval(", "Date.now"] {
            // Schemes of the own address are put together from the location.
            let is_scheme = foreign == "https://" && asset.path == "link.js";
            assert!(is_scheme || !text.contains(foreign), "{} contains {foreign}", asset.path);
        }
        assert!(!text.contains("<script>") && !text.contains(" style=\""), "{}", asset.path);
    }
}

#[cfg(feature = "binary")]
#[test]
fn the_page_is_small() {
    let compressed =
        Asset::ALL.iter().map(|asset| muster_console::assets::Compressed::new(asset).gzip.len());
    let bytes: usize = compressed.sum();
    assert!(bytes < 150_000, "{bytes}");
    println!("the page takes {bytes} bytes");
}

//! Situations are divided as `muster solve` divides what was observed.

#![allow(clippy::unwrap_used, reason = "a helper of tests that fails has found a fault")]

use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;

use muster_experiments::score::adjusted_rand_index;
use muster_experiments::situations::divided::{muster, muster_by_itself, paper};
use muster_experiments::situations::kinds::{Kind, List};
use muster_experiments::situations::situation::Situation;
use muster_solve::{Options, Solved};
use serde_json::{Map, Value, json};

/// The file of `muster solve` for a situation.
fn file(situation: &Situation) -> Value {
    let name = |robot: usize| format!("r{robot:06}");
    let mut file = json!({
        "robots": (0..situation.robots()).map(name).collect::<Vec<_>>(),
        "teams": situation.teams,
    });
    if let Some(positions) = &situation.positions {
        let poses = positions.iter().enumerate().filter_map(|(robot, at)| {
            let [x, y, z] = (*at)?;
            Some((name(robot), json!({"x": x, "y": y, "z": z})))
        });
        file["poses"] = Value::Object(poses.collect());
    }
    if let Some(links) = &situation.links {
        let link = |(peer, quality): &(u32, f64)| json!({"peer": name(*peer as usize), "quality": quality});
        let of = |(robot, links): (usize, &Vec<(u32, f64)>)| {
            (name(robot), links.iter().map(link).collect::<Value>())
        };
        file["links"] = Value::Object(links.iter().enumerate().map(of).collect());
    }
    if let Some(ranks) = &situation.ranks {
        let of = |(robot, superior, tie): &(u32, u32, f64)| {
            let rank = json!({"superior": name(*superior as usize), "weight": tie});
            (name(*robot as usize), rank)
        };
        file["ranks"] = Value::Object(ranks.iter().map(of).collect::<Map<_, _>>());
    }
    file
}

/// Kinds that take little time and differ in what is reported.
fn kinds() -> impl Iterator<Item = &'static Kind> {
    let names = [
        "round teams",
        "crescents",
        "radio nets only",
        "neighbours, no ranks",
        "indoors",
        "places and orders",
        "half of the ranks",
        "twelve pairs",
        "drones in layers",
        "two and two",
        "platoons on the march",
    ];
    List::ChosenOn.kinds().iter().filter(move |kind| names.contains(&kind.name))
}

#[test]
fn muster_solve_finds_the_same_teams() {
    assert_eq!(kinds().count(), 11);
    for kind in kinds() {
        let situation = kind.situation(0).unwrap();
        let text = serde_json::to_vec(&file(&situation)).unwrap();
        let solved = Solved::new(&text, Options::default()).unwrap();
        let labels = muster(&situation, situation.teams).unwrap();
        // Robots without a team share a number in what `muster solve` prints.
        let same = adjusted_rand_index(solved.labels(), &labels).unwrap();
        assert!(same > 1.0 - 1e-12, "{}: {same}", kind.name);
    }
}

#[test]
fn what_baselines_do_beyond_their_libraries_is_right() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let run = Command::new(root.join("target/peers/bin/python"))
        .arg("-B")
        .arg(root.join("tests/peers/check_division.py"))
        .output()
        .expect("tests/run installs target/peers");
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
}

#[test]
fn the_options_of_the_baselines_are_answered_before_anything_is_installed() {
    let divide = Path::new(env!("CARGO_MANIFEST_DIR")).join("../peers/divide");
    let nothing = tempfile::tempdir().unwrap();
    let run = |word: &str| {
        Command::new(&divide).arg(word).env("CARGO_TARGET_DIR", nothing.path()).output().unwrap()
    };
    assert!(run("--help").status.success());
    assert_eq!(run("--wrong").status.code(), Some(2));
    assert_eq!(std::fs::read_dir(nothing.path()).unwrap().count(), 0);
}

#[test]
fn the_program_says_which_situation_the_baselines_have_not_seen() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("labels.jsonl"), "").unwrap();
    let program = env!("CARGO_BIN_EXE_muster-experiments");
    let run = Command::new(program)
        .args(["situations", "--kinds", "chosen", "--seeds", "1", "--baselines"])
        .arg(folder.path())
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&run.stderr).into_owned();
    assert!(!run.status.success() && said.contains("the baselines have not seen it"), "{said}");
}

/// Only that there is a division: how good it is on kinds that are looked at once is not for a test to see.
#[test]
fn every_kind_can_be_divided() {
    for list in List::ALL {
        for kind in list.kinds() {
            let situation = kind.situation(list.seeds().end).unwrap();
            let robots = situation.robots();
            // Larger ones take seconds, and differ in nothing but their size.
            if robots > 200 {
                continue;
            }
            let (labels, teams) = muster_by_itself(&situation).unwrap();
            let found: BTreeSet<usize> = labels.iter().copied().flatten().collect();
            assert!(found.len() <= teams && teams <= robots, "{}", kind.name);
            for labels in
                [muster(&situation, situation.teams), paper(&situation, situation.teams, 0)]
            {
                assert_eq!(labels.unwrap().len(), robots, "{}", kind.name);
            }
        }
    }
}

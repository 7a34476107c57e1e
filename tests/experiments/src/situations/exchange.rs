//! What is exchanged with the baselines, which are Python: situations out, divisions in, as lines of JSON in one
//! folder.
//!
//! Baselines have the very graphs that Muster has, so that what is compared is the method. The truth is in the
//! file as well, for people who look into it; baselines do not read it.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufRead, BufReader, BufWriter, Write};
use std::path::Path;

use anyhow::Context as _;
use muster_numeric::matrix::SparseMatrix;
use serde::{Deserialize, Serialize};

use super::divided::Labels;
use super::run::Case;
use super::situation::Situation;

/// The file that baselines read.
pub const OBSERVATIONS: &str = "observations.jsonl";

/// The file that they write.
pub const LABELS: &str = "labels.jsonl";

/// From, to, weight.
type Edges = Vec<(usize, usize, f64)>;

/// A situation as a baseline sees it. What is not reported is null.
#[derive(Debug, Serialize)]
struct Observations<'a> {
    kind: &'a str,
    seed: u64,
    robots: usize,
    teams: usize,
    positions: &'a Option<Vec<Option<[f64; 3]>>>,
    spatial: Option<Edges>,
    connectivity: Option<Edges>,
    hierarchy: Option<Edges>,
    truth: &'a [Option<usize>],
}

/// The divisions of a situation.
#[derive(Debug, Deserialize)]
struct Divisions {
    kind: String,
    seed: u64,
    /// By the name of the method; null where it has nothing to work on.
    labels: BTreeMap<String, Option<Labels>>,
}

/// The divisions of all situations, by kind and seed.
#[derive(Debug, Default)]
pub struct Baselines(BTreeMap<(String, u64), BTreeMap<String, Option<Labels>>>);

/// Writes situations into a folder, which is made if need be.
///
/// # Errors
/// Names the file that cannot be written, or the situation that is none.
pub fn export(cases: &[Case], folder: &Path) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    let file = folder.join(OBSERVATIONS);
    let named = || file.display().to_string();
    let mut out = BufWriter::new(File::create(&file).with_context(named)?);
    for case in cases {
        let situation = case.kind.situation(case.seed)?;
        let line = line(case, &situation).with_context(|| case.to_string())?;
        writeln!(out, "{line}").with_context(named)?;
    }
    out.flush().with_context(named)
}

fn line(case: &Case, situation: &Situation) -> anyhow::Result<String> {
    let edges = |graph: Option<SparseMatrix>| graph.map(|graph| graph.triplets().collect());
    let observations = Observations {
        kind: case.kind.name,
        seed: case.seed,
        robots: situation.robots(),
        teams: situation.teams,
        positions: &situation.positions,
        spatial: edges(situation.spatial()?),
        connectivity: edges(situation.connectivity()?),
        hierarchy: edges(situation.hierarchy()?),
        truth: &situation.truth,
    };
    Ok(serde_json::to_string(&observations)?)
}

impl Baselines {
    /// What baselines have written into a folder.
    ///
    /// # Errors
    /// Names the file that cannot be read, or the line that is wrong.
    pub fn read(folder: &Path) -> anyhow::Result<Self> {
        let file = folder.join(LABELS);
        let named = || file.display().to_string();
        let lines = BufReader::new(File::open(&file).with_context(named)?).lines();
        let mut found = BTreeMap::new();
        for (number, line) in lines.enumerate() {
            let at = || format!("{}, line {}", file.display(), number + 1);
            let read: Divisions =
                serde_json::from_str(&line.with_context(named)?).with_context(at)?;
            found.insert((read.kind, read.seed), read.labels);
        }
        Ok(Self(found))
    }

    /// The divisions of a case by the names of the methods; none where the baselines did not see it.
    #[must_use]
    pub fn of(&self, case: &Case) -> Option<&BTreeMap<String, Option<Labels>>> {
        self.0.get(&(case.kind.name.to_owned(), case.seed))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::situations::kinds::List;

    #[test]
    fn situations_are_written_whole_and_divisions_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let kinds = List::ChosenOn.kinds();
        let cases: Vec<Case> =
            kinds.iter().filter(|kind| !kind.large).map(|kind| Case { kind, seed: 0 }).collect();
        export(&cases, folder.path()).unwrap();
        let text = std::fs::read_to_string(folder.path().join(OBSERVATIONS)).unwrap();
        assert_eq!(text.lines().count(), cases.len());
        for (case, line) in cases.iter().zip(text.lines()) {
            let read: serde_json::Value = serde_json::from_str(line).unwrap();
            let situation = case.kind.situation(0).unwrap();
            assert_eq!(read["robots"], situation.robots());
            assert_eq!(read["positions"].is_null(), situation.positions.is_none());
            assert_eq!(read["hierarchy"].is_null(), situation.ranks.is_none());
        }
        let line =
            r#"{"kind": "round teams", "seed": 0, "labels": {"a": [0, null, 1], "b": null}}"#;
        std::fs::write(folder.path().join(LABELS), line).unwrap();
        let baselines = Baselines::read(folder.path()).unwrap();
        let found = baselines.of(&cases[0]).unwrap();
        assert_eq!(found["a"], Some(vec![Some(0), None, Some(1)]));
        assert_eq!(found["b"], None);
        assert!(baselines.of(&cases[1]).is_none());
    }
}

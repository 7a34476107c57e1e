//! `muster solve`: the whole method once, offline, on one file.
//!
//! The input goes through [`input`], which reads it, and [`problem`], which checks it, with
//! [`observations`] for raw observations; [`path`] decides how the similarity is decomposed; [`method`]
//! applies `muster-method`, with [`division`] for the teams, [`limits`] and [`limited`] where anything is asked of them, and
//! [`output`] writes. Nothing here knows the
//! bus. [`estimate`] says beforehand how much it needs, by the tables of [`cost`], [`memory`]
//! refuses what does not fit, and [`line`] shows the step that runs.

mod cost;
mod defaults;
mod division;
mod edges;
mod error;
mod estimate;
mod file;
mod input;
mod limited;
mod limits;
mod line;
mod memory;
mod method;
mod observations;
mod options;
mod output;
mod path;
mod places;
mod problem;
mod saved;
mod speed;
#[cfg(test)]
mod tests;
mod tune;
mod why;

use std::io::{IsTerminal, Write as _};
use std::path::{Path, PathBuf};

use anyhow::Context;

pub use error::SolveError;
use error::tidy;
pub use estimate::Estimate;
use input::{parse, read};
pub use limits::LimitOptions;
pub use muster_method::step::{Progress, Step};
use muster_model::id::RobotId;
pub use options::{Options, PathChoice, Preset, SilhouetteChoice, TOLERANCES};
pub use tune::{LEAST_TUNED_ROBOTS, MAX_TUNED_ROBOTS, TuneOptions, TuneStep, Tuned, Tuning};

const AFTER_HELP: &str = r#"A minimal file (edges that are not given do not exist; [from, to, weight]):

  {"robots": ["r1", "r2", "r3", "r4"],
   "modalities": [{"name": "radio", "edges": [["r1", "r2", 1], ["r2", "r1", 1],
                                              ["r3", "r4", 1], ["r4", "r3", 1]]}],
   "teams": 2}

All keys, with what is taken where they are left out:

  robots      names out of a-z 0-9 _ -, the order of all rows; at most 1048576
  modalities  list of {"name", "weight", "matrix" or "edges"}; row i, column j of a matrix is the
              weight of the edge from robot i to robot j, 0 or more; weights sum to 1, equal if none
              is given
  reciprocity by modality, such as {"hierarchy": 0.5}: the share by which its edges also lead back,
              0 to 1; none for modalities that are given
  preset      "paper": what is left out below is as in the paper, not as in the live fleet
  normalize   "degree" (default): each edge is divided by the roots of the degrees of its two ends;
              "spectral": each matrix is divided by its largest singular value; "none"
  self_loops  0 to 4: the weight of an edge from each related robot to itself in the sum of the graphs;
              0.5, and 0 where "normalize" is "spectral" or "none"
  trusted     list of modalities, or "all": those that keep their whole weight even where they contradict
              the others; [], and "all" where "normalize" is "spectral" or "none". A file of fewer than
              three modalities or eight robots is not examined
  alpha       a number below 1/ρ, or {"fraction": 0.6} of 1/ρ (default)
  dimension   even, from 2 to twice the number of robots, or "auto" (default)
  scale       "none" (default), "sqrt-sigma" or "inverse-sqrt-sigma"
  rows        "unit" (default) or "none"
  teams       how many, {"from": 2, "to": 6}, or "auto" (default): by the modularity of the divisions; or
              instead of it:
  labels      one whole number per robot: the division to judge
  init        "kmeans++" (default) or "random"; restarts (50); seed (0)
  size        {"min": 2, "max": 6}: how many robots each team has; none by default. With limits, wishes or
              needs teams are t1, t2, …
  team_size   by team, such as {"t1": {"max": 4}}, instead of "size"
  needs       list of {"skill": "medic", "per_team": {"min": 1}}, also with "team", "max" and "soft": true
  skills      by robot, such as {"r1": ["medic"]}; those of "ranks" count as well
  wishes      list of {"kind": "pin", "robots": ["r7"], "team": "t2"}; also "ban", and without a team
              "together", "apart" and "reserve" (in no team)
  emit        any of "katz", "embedding", "diagnostics": added to the output of --json; "katz" for at
              most 16384 robots

Instead of modalities, raw observations, which become graphs as in the live fleet:

  {"robots": ["r1", "r2"], "teams": 1,
   "poses": {"r1": {"x": 0, "y": 0}, "r2": {"x": 3, "y": 4, "z": 0}},
   "links": {"r1": [{"peer": "r2", "quality": 0.9}]},
   "ranks": {"r2": {"superior": "r1"}},
   "weights": {"spatial": 0.5, "connectivity": 0.25, "hierarchy": 0.25},
   "spatial": {"width": 0.85}, "connectivity": {"unit": "quality"}}

"weights" and "reciprocity" are those of the live fleet then unless they are given; "spatial" and
"connectivity" are settings of ingest.

A live fleet, saved and divided again; the lines of its settings may be left out:

  (muster graph --json; muster set embedder --json; muster set clusterer --json;
   muster status --json; muster wish list --json) > fleet.jsonl
  muster solve fleet.jsonl

The status has the skills of robots, which needs rest on.

The similarity of the plain mathematics, S = (I - αA*)⁻¹ - I with A* = Σ w A of the graphs as they
are: "normalize": "none".

The method as printed in the paper: "preset": "paper", or --preset paper. It stands for "normalize":
"none", "self_loops": 0, "trusted": "all", "reciprocity": {}, equal weights, "alpha": {"fraction": 0.5},
"scale": "none", "rows": "none", "init": "random", "restarts": 1; keys that are given win over it.

In the output, "requested" is the number of teams, and "considered" has the evidence for each number where
it was chosen. Labels are numbered by first appearance (given ones stay as they are), and
silhouette.per_team is ordered by label. Robots without an embedding belong to no team and share a label
of their own; "diagnostics" names them as "unseen". Silhouettes are those in the embedding; "method" says how their
mean was computed, "detail_method" how those of teams and robots were. "decomposition" holds the path,
the residual of the singular triplets, the gap behind them, and how far their space may be turned against
the true one at most (angle_bound, the sine of an angle).

The "trust" of a modality is the factor of its weight. Its "agreement" is the mean share of robots that
are less similar to a robot, by all other modalities, than those that its edges lead to: 1 at best, about
0.5 by chance; null where it was not compared. A modality whose trust is below 0.5 is "in_doubt", and
"diagnostics" names the robots whose edges agree least as "disagreeing".

Within limits, wishes and needs the robots are divided as in the live fleet: "optimal" says that no other
assignment to these teams is nearer, "gap" by which share one could be, "ids" names the team of each label (null for robots
in no team, which "unassigned" lists), "prices" what a place in it costs, and "wishes" what has become of each.

A solve that takes longer than a second says on a terminal what it is doing, unless --json is given.
Exit codes: 0 done, or --estimate and it fits; 1 the results cannot be written, or the search for the
singular vectors did not converge and they are not exact; 2 the file is wrong, or what it asks for does
not fit into the memory that is available; 4 nothing satisfies the limits, wishes and needs: the error has
those that contradict each other with the numbers, and so has "conflict" of --json.

Examples:
  muster solve fleet.json
  muster solve fleet.json --estimate
  muster solve fleet.json --preset paper
  muster solve fleet.json --teams 2..6
  muster solve fleet.json --size 3..6 --needs medic=1 --wish "apart r1 r2"
  muster solve fleet.json --path inverse-free --tolerance 1e-6
  muster solve fleet.json --json | jq .teams
  muster solve fleet.json --why r7
  generate-fleet | muster solve - --json"#;

/// Arguments of `muster solve`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP)]
pub struct SolveArgs {
    /// The file to read, or - for standard input.
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Write one JSON object to standard output, numbers in full precision.
    #[arg(long)]
    json: bool,
    /// Only say how much memory and time it will take on this machine, and whether it fits.
    #[arg(long)]
    estimate: bool,
    /// Say why a robot is in its team: how much each modality pulls it to each team.
    #[arg(long, value_name = "ROBOT")]
    why: Option<RobotId>,
    #[command(flatten)]
    options: Options,
    #[command(flatten)]
    limits: LimitOptions,
}

/// Runs the command.
///
/// # Errors
/// A [`SolveError`] where the input is wrong; an input or output error where writing fails.
pub fn run(args: &SolveArgs) -> anyhow::Result<()> {
    let name = if args.file == Path::new("-") {
        "standard input".to_owned()
    } else {
        tidy(&args.file.to_string_lossy())
    };
    // With --json another program waits, which wants no line on the terminal that it shares.
    let line = line::Line::start(!args.json && std::io::stderr().is_terminal());
    let text = read(&args.file).with_context(|| name.clone())?;
    let mut problem = parse(&text, args.options).with_context(|| name.clone())?;
    problem.ask(&args.limits).with_context(|| name.clone())?;
    problem.keeps_frames = args.why.is_some();
    drop(text);
    if args.estimate {
        drop(line);
        let estimate = estimate::estimate(&problem).with_context(|| name.clone())?;
        if args.json {
            estimate.write_json()?;
        } else {
            estimate.write_summary()?;
        }
        return estimate.check().with_context(|| name);
    }
    let solved = solve(&problem, &mut |step| line.show(step));
    drop(line);
    if let (Err(SolveError::Conflict(conflict)), true) = (&solved, args.json) {
        output::write_conflict(conflict)?;
    }
    let solution = solved.with_context(|| name.clone())?;
    if let Some(robot) = &args.why {
        let reasons = why::reasons(&problem, &solution, robot).with_context(|| name.clone())?;
        let text = if args.json { reasons.to_json()? } else { reasons.text() };
        std::io::stdout().write_all(text.as_bytes())?;
        return check_converged(&solution, &name);
    }
    for warning in &solution.warnings {
        eprintln!("warning: {warning}");
    }
    if args.json {
        output::write_json(&problem, &solution)?;
    } else {
        output::write_summary(&problem, &solution)?;
    }
    check_converged(&solution, &name)
}

/// Results of a search that did not converge are written, but they are no success.
fn check_converged(solution: &method::Solution, name: &str) -> anyhow::Result<()> {
    let found = &solution.decomposition;
    anyhow::ensure!(
        found.converged,
        "{name}: the search for the singular vectors did not converge (residual {:.1e}): the results are not exact",
        found.residual
    );
    Ok(())
}

/// A file's bytes, or those of standard input for `-`; at most [`error::MAX_FILE_BYTES`].
///
/// # Errors
/// [`SolveError::Read`] and [`SolveError::Size`].
pub fn read_file(file: &Path) -> Result<Vec<u8>, SolveError> {
    read(file)
}

/// Searches for better settings of the fleet in a text, with a line on the terminal that says how far it is if that
/// is shown.
///
/// # Errors
/// As of [`Tuning::new`].
pub fn tune(text: &[u8], options: &TuneOptions, is_shown: bool) -> Result<Tuning, SolveError> {
    let line = line::Line::start(is_shown);
    Tuning::new(text, options, &mut |step| line.show(step))
}

/// A file, and what the method found for it.
#[derive(Debug)]
pub struct Solved {
    problem: problem::Problem,
    solution: method::Solution,
}

impl Solved {
    /// Runs the method once on the text of a file.
    ///
    /// # Errors
    /// Names the field that is wrong and the remedy.
    pub fn new(text: &[u8], options: Options) -> Result<Self, SolveError> {
        Self::watched(text, options, &mut |_| {})
    }

    /// The same, reporting each step when it begins, and each round of a search and each restart of k-means when
    /// it is done.
    ///
    /// # Errors
    /// As of [`Solved::new`].
    pub fn watched(
        text: &[u8],
        options: Options,
        progress: &mut Progress<'_>,
    ) -> Result<Self, SolveError> {
        Self::asked(text, options, &LimitOptions::default(), progress)
    }

    /// The same within limits, wishes and needs in addition to those of the file.
    ///
    /// # Errors
    /// As of [`Solved::new`], and [`SolveError::Conflict`] if nothing satisfies what is asked.
    pub fn asked(
        text: &[u8],
        options: Options,
        limits: &LimitOptions,
        progress: &mut Progress<'_>,
    ) -> Result<Self, SolveError> {
        let mut problem = parse(text, options)?;
        problem.ask(limits)?;
        let solution = solve(&problem, progress)?;
        Ok(Self { problem, solution })
    }

    /// The label of each robot, in the order of the file.
    #[must_use]
    pub fn labels(&self) -> &[usize] {
        &self.solution.divided.labels
    }

    /// The results as one JSON object, numbers in full precision.
    ///
    /// # Errors
    /// If they do not serialise.
    pub fn to_json(&self) -> serde_json::Result<String> {
        output::to_json(&self.problem, &self.solution)
    }

    /// The results to read.
    #[must_use]
    pub fn summary(&self) -> String {
        output::summary(&self.problem, &self.solution)
    }
}

/// Applies the method where it fits into the memory of this machine.
fn solve(
    problem: &problem::Problem,
    progress: &mut Progress<'_>,
) -> Result<method::Solution, SolveError> {
    let path = path::path_of(problem, problem.options.path)?;
    memory::admit_path(path, problem.robots.len(), &cost::Size::of(problem))?;
    method::solve(problem, path, progress)
}

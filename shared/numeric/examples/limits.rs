//! Times exact assignments and k-means under limits, for `tests/peers/limits`.
//!
//! Each line of standard input is a command, and is answered with one line: seconds and a value. Numbers of files are 8
//! bytes each, little-endian.
//!
//! | command | answer |
//! | --- | --- |
//! | `assign FILE ROBOTS TEAMS LEAST MOST` | an assignment from nothing by the costs (i64) of the file: seconds, cost |
//! | `tick FILE` | the next one, by other costs: seconds, cost |
//! | `kmeans FILE POINTS DIMENSIONS TEAMS LEAST MOST RESTARTS` | k-means of points (f64) under limits: seconds, inertia |

use std::error::Error;
use std::io::{BufRead, Write};
use std::time::Instant;

use muster_numeric::assignment::{Assigner, Bounds, CostMatrix, Rules, ValidRules};
use muster_numeric::kmeans::{Init, KMeansLimits, KMeansOptions};
use muster_numeric::matrix::DenseMatrix;

type Failure = Box<dyn Error>;

/// Iterations of one start, as in a live fleet.
const ITERATIONS: usize = 100;

fn main() -> Result<(), Failure> {
    let mut session = None;
    let mut out = std::io::stdout().lock();
    for line in std::io::stdin().lock().lines() {
        let line = line?;
        let words: Vec<&str> = line.split_whitespace().collect();
        let (seconds, value) = match words[..] {
            ["assign", file, robots, teams, least, most] => {
                let [robots, teams, least, most] = counts([robots, teams, least, most])?;
                let session = session.insert(Session::new(robots, teams, least, most)?);
                session.solve(file)?
            }
            ["tick", file] => session.as_mut().ok_or("no assignment yet")?.solve(file)?,
            ["kmeans", file, points, dims, teams, least, most, restarts] => {
                kmeans(file, counts([points, dims, teams, least, most, restarts])?)?
            }
            _ => return Err(format!("no command: {line}").into()),
        };
        writeln!(out, "{seconds:e} {value:e}")?;
        out.flush()?;
    }
    Ok(())
}

fn counts<const N: usize>(words: [&str; N]) -> Result<[usize; N], Failure> {
    let mut counts = [0; N];
    for (count, word) in counts.iter_mut().zip(words) {
        *count = word.parse()?;
    }
    Ok(counts)
}

fn numbers(file: &str) -> Result<Vec<[u8; 8]>, Failure> {
    let bytes = std::fs::read(file)?;
    Ok(bytes.as_chunks::<8>().0.to_vec())
}

/// Bounds of teams that are all alike.
fn alike(robots: usize, teams: usize, least: usize, most: usize) -> Result<ValidRules, Failure> {
    let teams = vec![Bounds::new(least, most); teams];
    Ok(Rules { robots, teams, ..Rules::default() }.check()?)
}

/// A fleet whose robots are assigned again and again.
struct Session {
    rules: ValidRules,
    assigner: Assigner,
}

impl Session {
    fn new(robots: usize, teams: usize, least: usize, most: usize) -> Result<Self, Failure> {
        Ok(Self { rules: alike(robots, teams, least, most)?, assigner: Assigner::new() })
    }

    fn solve(&mut self, file: &str) -> Result<(f64, f64), Failure> {
        let costs = numbers(file)?.into_iter().map(i64::from_le_bytes).collect();
        let rules = self.rules.get();
        let costs = CostMatrix::new(rules.robots, rules.teams.len(), costs)?;
        let begun = Instant::now();
        let found =
            self.assigner.solve(&self.rules, &costs).map_err(|error| format!("{error:?}"))?;
        let seconds = begun.elapsed().as_secs_f64();
        Ok((seconds, found.cost as f64))
    }
}

fn kmeans(file: &str, counts: [usize; 6]) -> Result<(f64, f64), Failure> {
    let [points, dims, teams, least, most, restarts] = counts;
    let values = numbers(file)?.into_iter().map(f64::from_le_bytes).collect();
    let x = DenseMatrix::new(points, dims, values)?;
    let rules = alike(points, teams, least, most)?;
    let options = KMeansOptions {
        clusters: teams,
        init: Init::PlusPlus,
        restarts,
        max_iterations: ITERATIONS,
        seed: 0,
        warm_labels: None,
        hysteresis: 0.0,
        threads: 1,
    };
    let options = options.check()?;
    let begun = Instant::now();
    let limits =
        KMeansLimits { rules: &rules, reserve_cost: 0.0, previous: None, refine_only: false };
    let found = options.divide_within(&x, &limits)?;
    Ok((begun.elapsed().as_secs_f64(), found.inertia))
}

//! Muster's side of the comparison with peers, and other programs in Rust: fleets, partial
//! decompositions, the paper's method to the letter on faer, k-means and silhouettes of Muster, k-means of
//! linfa, and what the machine can do at most.
//!
//! `tests/peers/compare` starts it. One line of standard input is one [`Command`] in JSON; each is
//! answered with one line in JSON, whose `error` says why there is no answer. Times are seconds of the
//! process and of the wall, without what it takes to read, write and prepare.

mod cells;
mod clock;
mod command;
mod files;
mod fleet;
mod graph;
mod limits;
mod literal;
mod memory;
mod points;
mod site;

use std::collections::BTreeMap;
use std::io::{BufRead, Write};

use serde_json::{Value, json};

use clock::Seconds;
use command::Command;
use points::Points;
use site::{Site, Wanted};

type Failure = Box<dyn std::error::Error>;

/// What is kept between commands.
#[derive(Default)]
struct Session {
    sites: BTreeMap<String, Site>,
    points: Option<Points>,
}

fn main() -> Result<(), Failure> {
    let mut session = Session::default();
    let mut answers = std::io::stdout().lock();
    for line in std::io::stdin().lock().lines() {
        let answer = serde_json::from_str(&line?)
            .map_err(Failure::from)
            .and_then(|command| session.answer(command));
        let answer = answer.unwrap_or_else(|error| json!({"error": error.to_string()}));
        writeln!(answers, "{answer}")?;
        answers.flush()?;
    }
    Ok(())
}

impl Session {
    fn answer(&mut self, command: Command) -> Result<Value, Failure> {
        Ok(match command {
            Command::Fleet { site, robots, graph, fraction, seed } => {
                let made = Site::new(robots.max(1), graph, fraction, seed)?;
                let answer = about(&made);
                self.sites.insert(site, made);
                answer
            }
            Command::Advance { site, spacings, all } => {
                let site = self.site(&site)?;
                site.advance(spacings, all)?;
                about(site)
            }
            Command::WriteGraph { site, to } => {
                files::write_graph(&to, &self.site(&site)?.graph)?;
                json!({})
            }
            Command::Solve { site, stream, rank, tolerance, threads, to } => {
                let wanted = Wanted { rank, tolerance, threads };
                let solved = self.site(&site)?.solve(stream.as_deref(), wanted)?;
                if let Some(to) = to {
                    files::write_triplets(&to, &solved.svd)?;
                }
                json!({
                    "seconds": solved.seconds,
                    "vectors": solved.vectors,
                    "rounds": solved.report.rounds,
                    "residual": solved.report.residual,
                    "converged": solved.report.converged,
                })
            }
            Command::Bound { site } => {
                let (seconds, bound) = self.site(&site)?.bound();
                json!({"seconds": seconds, "lower": bound.lower, "upper": bound.upper})
            }
            Command::UpdateSimilarity { site } => {
                timed_only(self.site(&site)?.update_similarity()?)
            }
            Command::Literal { site } => {
                let site = self.site(&site)?;
                let found = literal::literal(&site.graph, site.decay.alpha)?;
                json!({
                    "eigenvalues": found.eigenvalues,
                    "inverse": found.inverse,
                    "svd": found.svd,
                    "radius": found.radius,
                    "sigma": found.sigma,
                })
            }
            Command::Points { from, dims, clusters, iterations } => {
                let data = files::read_numbers(&from)?;
                self.points = Some(Points::new(data, dims, clusters, iterations)?);
                json!({})
            }
            Command::Labels => json!({"labels": self.points()?.labels()}),
            Command::Kmeans => with_value(self.points()?.kmeans()?),
            Command::Linfa => with_value(self.points()?.linfa()?),
            Command::Silhouette { form } => {
                let (seconds, value, error) = self.points()?.silhouette(form)?;
                json!({"seconds": seconds, "value": value, "standard_error": error})
            }
            Command::Triad { bytes } => json!({"value": limits::triad(bytes)}),
            Command::Gemm => json!({"value": limits::gemm()}),
            Command::SingleGemm => json!({"value": limits::single_gemm()}),
            Command::Roots => json!({"value": limits::roots()}),
            Command::TwoThreads { bytes } => json!({"value": limits::two_threads(|| {
                bytes.map_or_else(limits::gemm, limits::triad)
            })}),
            Command::HandOver => json!({"value": limits::hand_over()}),
            Command::ForgetPeak => {
                memory::forget_peak()?;
                json!({})
            }
            Command::Peak => json!({"value": memory::peak()?}),
        })
    }

    fn site(&mut self, name: &str) -> Result<&mut Site, Failure> {
        self.sites.get_mut(name).ok_or_else(|| format!("no fleet {name}").into())
    }

    fn points(&self) -> Result<&Points, Failure> {
        self.points.as_ref().ok_or_else(|| "no points".into())
    }
}

fn about(site: &Site) -> Value {
    let (lower, upper) = site.radius();
    json!({
        "robots": site.graph.nodes(),
        "edges": site.graph.edges(),
        "alpha": site.decay.alpha,
        "radius": [lower, upper],
    })
}

fn timed_only(seconds: Seconds) -> Value {
    json!({"seconds": seconds})
}

fn with_value((seconds, value): (Seconds, f64)) -> Value {
    json!({"seconds": seconds, "value": value})
}

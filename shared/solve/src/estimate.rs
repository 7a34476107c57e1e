//! What a solve will take, before it is begun.
//!
//! Each way to compute the method has a table of its steps (see [`cost`](super::cost)). Memory follows
//! from the input alone; time also from how fast this machine is, which [`Speed`] measures on a small
//! problem.

use std::fmt::Write as _;
use std::io::Write as _;

use muster_method::decomposition::Path;
use muster_model::id::Modality;
use serde::Serialize;

use super::cost::{Size, steps, whole};
use super::error::SolveError;
use super::memory::{admit, available_mib, fits};
use super::options::Options;
use super::path::{description, path_of};
use super::problem::Problem;
use super::speed::Speed;

/// What a solve will take on this machine.
#[derive(Debug, Serialize)]
pub struct Estimate {
    robots: usize,
    edges: usize,
    modalities: Vec<GraphSize>,
    path: Path,
    /// At the worst moment of all.
    peak_mib: u64,
    /// Memory that can be had now; none where the system does not report it.
    available_mib: Option<u64>,
    fits: bool,
    seconds: f64,
    steps: Vec<StepEstimate>,
}

/// The edges of one graph.
#[derive(Debug, Serialize)]
struct GraphSize {
    name: Modality,
    edges: usize,
}

/// What one step will take.
#[derive(Debug, Serialize)]
struct StepEstimate {
    step: String,
    seconds: f64,
    mib: u64,
}

/// Estimates a checked input, in about a tenth of a second.
///
/// # Errors
/// Where no path leads to what is asked for.
pub(super) fn estimate(problem: &Problem) -> Result<Estimate, SolveError> {
    let (path, size) = (path_of(problem, problem.options.path)?, Size::of(problem));
    let speed = Speed::measure();
    let steps: Vec<StepEstimate> = steps(path)
        .map(|cost| StepEstimate {
            step: cost.step.to_string(),
            seconds: (cost.seconds)(&size, &speed),
            mib: whole(size.mib(cost)),
        })
        .collect();
    let modalities: Vec<GraphSize> = problem
        .graphs
        .iter()
        .map(|graph| GraphSize { name: graph.name.clone(), edges: graph.matrix.edges() })
        .collect();
    let (peak_mib, available_mib) = (size.peak_mib(path), available_mib());
    Ok(Estimate {
        robots: problem.robots.len(),
        edges: modalities.iter().map(|graph| graph.edges).sum(),
        modalities,
        path,
        peak_mib,
        available_mib,
        fits: fits(problem.robots.len(), peak_mib, available_mib),
        seconds: steps.iter().map(|step| step.seconds).sum(),
        steps,
    })
}

impl Estimate {
    /// Estimates the text of a file, which is read and checked as for a solve.
    ///
    /// # Errors
    /// Names the field that is wrong and the remedy.
    pub fn new(text: &[u8], options: Options) -> Result<Self, SolveError> {
        estimate(&super::input::parse(text, options)?)
    }

    /// Whether it fits into the memory that is available.
    ///
    /// # Errors
    /// The error with which a solve would be refused.
    pub fn check(&self) -> Result<(), SolveError> {
        admit(self.path, self.robots, self.peak_mib, self.available_mib)
    }

    /// The estimate as one JSON object.
    ///
    /// # Errors
    /// If it does not serialise.
    pub fn to_json(&self) -> serde_json::Result<String> {
        serde_json::to_string(self)
    }

    /// The estimate to read.
    #[must_use]
    pub fn summary(&self) -> String {
        let graphs: Vec<String> =
            self.modalities.iter().map(|graph| format!("{} {}", graph.name, graph.edges)).collect();
        let available = self.available_mib.map_or_else(
            || "what is available is not known".to_owned(),
            |available| format!("{available} MiB are available"),
        );
        let fits = if self.fits { "it fits" } else { "it does not fit" };
        let mut text = format!(
            "robots            {}\n\
             edges             {} ({})\n\
             path              {}\n\
             memory            about {} MiB at the worst moment, {available}: {fits}\n\
             time              about {} on this machine\n",
            self.robots,
            self.edges,
            graphs.join(", "),
            description(self.path),
            self.peak_mib,
            duration(self.seconds),
        );
        for step in &self.steps {
            let time = duration(step.seconds);
            // Writing to a text does not fail.
            let _ = writeln!(text, "  {:30}{time:>10}{:>8} MiB", step.step, step.mib);
        }
        text
    }

    /// Writes the estimate as one JSON object and a line feed to the standard output.
    pub(super) fn write_json(&self) -> std::io::Result<()> {
        let mut out = std::io::stdout().lock();
        out.write_all(self.to_json().map_err(std::io::Error::from)?.as_bytes())?;
        out.write_all(b"\n")?;
        out.flush()
    }

    /// Writes the estimate to read to the standard output.
    pub(super) fn write_summary(&self) -> std::io::Result<()> {
        let mut out = std::io::stdout().lock();
        out.write_all(self.summary().as_bytes())?;
        out.flush()
    }
}

/// Seconds to read, in two digits at most where they are few: it is an estimate.
fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 0.0095 => format!("{:.1} ms", s * 1e3),
        s if s < 0.95 => format!("{:.0} ms", s * 1e3),
        s if s < 9.5 => format!("{s:.1} s"),
        s if s < 120.0 => format!("{s:.0} s"),
        s if s < 7200.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.1} h", s / 3600.0),
    }
}

#[cfg(test)]
mod tests {
    use muster_numeric::silhouette::Method;
    use serde_json::{Value, json};

    use super::*;
    use crate::memory::SMALL_ROBOTS;
    use crate::options::PathChoice;

    fn file(robots: usize, changes: Value) -> String {
        let names: Vec<String> = (0..robots).map(|robot| format!("r{robot}")).collect();
        let edges: Vec<Value> = names.windows(2).map(|pair| json!([pair[0], pair[1], 1])).collect();
        let mut file = json!({"robots": names, "teams": 3, "restarts": 7,
                              "modalities": [{"name": "chain", "edges": edges}]});
        for (key, value) in changes.as_object().unwrap() {
            if value.is_null() {
                file.as_object_mut().unwrap().remove(key);
            } else {
                file[key] = value.clone();
            }
        }
        file.to_string()
    }

    fn size(text: &str) -> Size {
        Size::of(&crate::parse(text.as_bytes(), Options::default()).unwrap())
    }

    fn estimated(text: &str) -> Estimate {
        Estimate::new(text.as_bytes(), Options::default()).unwrap()
    }

    #[test]
    fn the_size_is_that_of_the_file() {
        let expected = Size {
            robots: 50.0,
            edges: 49.0,
            dimension: 6.0,
            rank: 4.0,
            teams: 3.0,
            restarts: 7.0,
            threads: 1.0,
            silhouettes: Method::Exact,
            is_spectral: false,
            examined: 0.0,
            keeps_katz: false,
        };
        assert_eq!(size(&file(50, json!({}))), expected);
        let labels: Vec<usize> = (0..50).map(|robot| robot % 4).collect();
        let judged = json!({"teams": null, "labels": labels, "dimension": 20});
        let expected = Size { dimension: 20.0, rank: 11.0, teams: 4.0, restarts: 0.0, ..expected };
        assert_eq!(size(&file(50, judged)), expected);
        assert!(size(&file(50, json!({"emit": ["katz"]}))).keeps_katz);
        assert!(size(&file(50, json!({"normalize": "spectral"}))).is_spectral);
        // Three graphs, one of which may be doubted.
        let named = |name| json!({"name": name, "edges": [["r0", "r1", 1]]});
        let graphs = json!({"modalities": [named("a"), named("b"), named("c")]});
        assert_eq!(size(&file(50, graphs.clone())).examined, 50.0);
        assert_eq!(size(&file(2000, graphs.clone())).examined, 1024.0);
        assert_eq!(size(&file(7, graphs)).examined, 0.0);
    }

    #[test]
    fn a_fleet_is_refused_by_the_numbers_that_are_printed() {
        let mut estimate = estimated(&file(50, json!({})));
        assert!(estimate.fits && estimate.check().is_ok());
        let size = Size { robots: 4000.0, ..size(&file(50, json!({}))) };
        estimate.robots = 4000;
        estimate.peak_mib = size.peak_mib(Path::Dense);
        // Twelve matrices of 4000² doubles, the robots, and the program.
        assert_eq!(estimate.peak_mib, 1466 + 16);
        estimate.available_mib = Some(1482);
        assert!(estimate.check().is_ok());
        estimate.available_mib = Some(1481);
        let error = estimate.check().unwrap_err().to_string();
        assert!(error.starts_with("robots: ") && error.contains("4000 robots"), "{error}");
        assert!(error.contains("1482 MiB") && error.contains("1481 MiB"), "{error}");
        assert!(error.contains("let the path be inverse-free"), "{error}");
        // The other path takes a few vectors, and what the elimination for the spectral radius may fill in: half a matrix at
        // 24 bytes an entry.
        estimate.path = Path::InverseFree;
        estimate.peak_mib = size.peak_mib(Path::InverseFree);
        assert_eq!(estimate.peak_mib, 183 + 1 + 16);
        assert!(estimate.check().is_ok());
        estimate.available_mib = Some(estimate.peak_mib - 1);
        let error = estimate.check().unwrap_err().to_string();
        assert!(error.contains("graphs and vectors of 4000 robots"), "{error}");
        estimate.available_mib = None;
        assert!(estimate.check().is_ok());
        assert!(fits(SMALL_ROBOTS, 2, Some(1)) && !fits(SMALL_ROBOTS + 1, 2, Some(1)));
    }

    #[test]
    fn more_of_anything_takes_no_less() {
        let speed = Speed::measure();
        let base = Size {
            robots: 300.0,
            edges: 3e3,
            dimension: 8.0,
            rank: 5.0,
            teams: 4.0,
            restarts: 9.0,
            threads: 1.0,
            silhouettes: Method::Exact,
            is_spectral: false,
            examined: 0.0,
            keeps_katz: false,
        };
        for path in [Path::Dense, Path::InverseFree] {
            let total =
                |size: &Size| steps(path).map(|cost| (cost.seconds)(size, &speed)).sum::<f64>();
            for more in [
                Size { robots: 600.0, ..base.clone() },
                Size { edges: 6e3, ..base.clone() },
                Size { dimension: 16.0, ..base.clone() },
                Size { teams: 8.0, ..base.clone() },
                Size { restarts: 18.0, ..base.clone() },
            ] {
                assert!(total(&more) > total(&base), "{more:?}");
                assert!(more.peak_mib(path) >= base.peak_mib(path), "{more:?}");
            }
            let fewer = Size { silhouettes: Method::SquaredExact, ..base.clone() };
            assert!(total(&fewer) < total(&base));
            let shared = Size { threads: 4.0, ..base.clone() };
            assert!(total(&shared) < total(&base));
        }
        let more = Size { rank: 20.0, ..base.clone() };
        assert!(more.peak_mib(Path::InverseFree) > base.peak_mib(Path::InverseFree));
    }

    #[test]
    fn a_path_that_leads_nowhere_is_no_estimate() {
        let text = file(50, json!({"emit": ["katz"]}));
        let options = Options { path: PathChoice::InverseFree, ..Options::default() };
        let error = Estimate::new(text.as_bytes(), options).unwrap_err().to_string();
        assert!(error.starts_with("emit: "), "{error}");
    }

    #[test]
    fn it_is_written_as_json_and_as_text() {
        let estimate = estimated(&file(50, json!({})));
        let read: Value = serde_json::from_str(&estimate.to_json().unwrap()).unwrap();
        assert_eq!((&read["robots"], &read["edges"]), (&json!(50), &json!(49)));
        assert_eq!(read["modalities"], json!([{"name": "chain", "edges": 49}]));
        assert_eq!((&read["path"], &read["fits"]), (&json!("dense"), &json!(true)));
        let seconds: f64 =
            read["steps"].as_array().unwrap().iter().map(|s| s["seconds"].as_f64().unwrap()).sum();
        assert!((read["seconds"].as_f64().unwrap() - seconds).abs() <= 1e-12 * seconds);
        let text = estimate.summary();
        for part in ["50\n", "49 (chain 49)", "dense: ", "it fits", "Katz similarity", "MiB\n"] {
            assert!(text.contains(part), "{part:?} in\n{text}");
        }
    }

    #[test]
    fn a_duration_is_written_in_its_unit() {
        let pairs = [
            (0.0, "0.0 ms"),
            (0.0023, "2.3 ms"),
            (0.12, "120 ms"),
            (1.26, "1.3 s"),
            (47.0, "47 s"),
            (1300.0, "22 min"),
            (20_000.0, "5.6 h"),
        ];
        for (seconds, text) in pairs {
            assert_eq!(duration(seconds), text);
        }
    }
}

//! What a solve will take, before it is begun.
//!
//! Each way to compute the method has a table of its steps: what each holds in memory at its worst
//! moment, and what its time grows with. Memory follows from the input alone; time also from how fast
//! this machine is, which [`Speed`] measures on a small problem.

use std::fmt::Write as _;
use std::io::Write as _;

use muster_model::id::Modality;
use muster_model::settings::Dimension;
use serde::Serialize;

use super::method::wanted_teams;
use super::problem::{Division, Problem};
use super::speed::Speed;
use super::step::Step;
use super::{SolveError, refuse};

/// Fleets up to this size fit everywhere.
const SMALL: usize = 1000;

/// Memory of the program itself, of the names of the robots and of everything else that does not grow
/// with the pairs of robots, in MiB.
const BASE_MIB: f64 = 16.0;

/// Bytes of an edge in a graph: a column and a weight.
const EDGE_BYTES: f64 = 16.0;

/// Lloyd iterations and exchanges of one start of k-means, most of which are over before.
const KMEANS_ITERATIONS: f64 = 15.0;

/// How the method is computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
enum Path {
    /// The Katz similarity by LU, and all of its singular values and vectors.
    Dense,
}

/// What the time and the memory of a solve grow with.
#[derive(Debug, Clone, PartialEq)]
struct Size {
    robots: f64,
    /// Of all graphs together.
    edges: f64,
    /// Length of the vectors, as large as it may be chosen.
    dimension: f64,
    teams: f64,
    /// Starts of k-means; 0 where a division is judged.
    restarts: f64,
}

/// A step of a path.
struct Cost {
    step: Step,
    /// Matrices of one double per pair of robots that are held at the worst moment of the step.
    matrices: f64,
    /// Bytes that are held per edge of all graphs, beside the graphs themselves.
    bytes_per_edge: f64,
    /// Seconds on a machine of this speed.
    seconds: fn(&Size, &Speed) -> f64,
}

/// The steps of the dense path. LU and singular value decomposition take N³ operations, silhouettes
/// N² distances, k-means N for each team, restart and iteration.
const DENSE: [Cost; 6] = [
    Cost {
        // The norm of each graph is a spectral radius.
        step: Step::Fuse,
        matrices: 1.0,
        bytes_per_edge: 80.0,
        seconds: |size, speed| speed.radius_per_product * size.edges * size.robots,
    },
    Cost {
        // Its elimination fills a band of the matrix.
        step: Step::SpectralRadius,
        matrices: 1.0,
        bytes_per_edge: 80.0,
        seconds: |size, speed| speed.radius_per_product * size.edges * size.robots,
    },
    Cost {
        // Two pairs of sides, the factors, the solution and its copy.
        step: Step::Katz,
        matrices: 6.0,
        bytes_per_edge: EDGE_BYTES,
        seconds: |size, speed| speed.katz.seconds(size.robots),
    },
    Cost {
        // The similarity, its scaled copy, both sides of vectors with their copies, and what the
        // library works in.
        step: Step::Svd,
        matrices: 12.0,
        bytes_per_edge: EDGE_BYTES,
        seconds: |size, speed| speed.svd.seconds(size.robots),
    },
    Cost {
        // The similarity may be wanted in the output.
        step: Step::KMeans { done: 0, restarts: 0 },
        matrices: 1.0,
        bytes_per_edge: 0.0,
        seconds: |size, speed| {
            let distances = size.robots * size.teams * size.restarts * KMEANS_ITERATIONS;
            speed.kmeans_per_product * distances * size.dimension
        },
    },
    Cost {
        step: Step::Silhouettes,
        matrices: 1.0,
        bytes_per_edge: 0.0,
        seconds: |size, speed| {
            speed.silhouettes_per_product * size.robots * size.robots * size.dimension
        },
    },
];

impl Path {
    /// The way in which a problem is solved.
    fn of(_problem: &Problem) -> Self {
        Self::Dense
    }

    fn steps(self) -> &'static [Cost] {
        match self {
            Self::Dense => &DENSE,
        }
    }

    fn description(self) -> &'static str {
        match self {
            Self::Dense => "dense: the Katz similarity by LU, and its full decomposition",
        }
    }
}

impl Size {
    #[expect(clippy::cast_precision_loss, reason = "counts are far below 2⁵³")]
    fn of(problem: &Problem) -> Self {
        let robots = problem.robots.len();
        let teams = wanted_teams(problem);
        let dimension = match problem.dimension {
            Dimension::Fixed(dimension) => dimension as usize,
            Dimension::Auto => 2 * teams.clamp(2, robots.max(2)),
        };
        let restarts = match &problem.division {
            Division::Wanted(settings) => settings.restarts,
            Division::Given(_) => 0,
        };
        Self {
            robots: robots as f64,
            edges: problem.graphs.iter().map(|graph| graph.matrix.edges()).sum::<usize>() as f64,
            dimension: dimension as f64,
            teams: teams as f64,
            restarts: f64::from(restarts),
        }
    }

    /// Memory at the worst moment of a step in MiB.
    fn mib(&self, cost: &Cost) -> f64 {
        let pairs = self.robots * self.robots * 8.0 * cost.matrices;
        let edges = self.edges * (EDGE_BYTES + cost.bytes_per_edge);
        BASE_MIB + (pairs + edges) / f64::from(1 << 20)
    }

    /// Memory at the worst moment of all in MiB.
    fn peak_mib(&self, path: Path) -> u64 {
        let peak = path.steps().iter().map(|cost| self.mib(cost)).fold(0.0, f64::max);
        whole(peak)
    }
}

/// The next whole number.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "it is no less than 0")]
fn whole(value: f64) -> u64 {
    value.ceil() as u64
}

/// What a solve will take on this machine.
#[derive(Debug, Serialize)]
pub struct Estimate {
    robots: usize,
    edges: usize,
    modalities: Vec<GraphSize>,
    path: Path,
    /// At the worst moment of all.
    peak_mib: u64,
    /// Memory that can be had now; none where the system does not tell.
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
pub(super) fn estimate(problem: &Problem) -> Estimate {
    let (path, size) = (Path::of(problem), Size::of(problem));
    let speed = Speed::measure();
    let steps: Vec<StepEstimate> = path
        .steps()
        .iter()
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
    Estimate {
        robots: problem.robots.len(),
        edges: modalities.iter().map(|graph| graph.edges).sum(),
        modalities,
        path,
        peak_mib,
        available_mib,
        fits: fits(problem.robots.len(), peak_mib, available_mib),
        seconds: steps.iter().map(|step| step.seconds).sum(),
        steps,
    }
}

/// Refuses a problem that does not fit, instead of being killed half an hour later.
pub(super) fn check(problem: &Problem) -> Result<(), SolveError> {
    admit_now(problem.robots.len(), &Size::of(problem), Path::of(problem))
}

/// Refuses so many robots if they do not fit whatever their graphs are.
#[expect(clippy::cast_precision_loss, reason = "counts are far below 2⁵³")]
pub(super) fn check_robots(robots: usize) -> Result<(), SolveError> {
    let size =
        Size { robots: robots as f64, edges: 0.0, dimension: 2.0, teams: 1.0, restarts: 0.0 };
    admit_now(robots, &size, Path::Dense)
}

/// Refuses what does not fit now. Small fleets are not worth asking the system.
fn admit_now(robots: usize, size: &Size, path: Path) -> Result<(), SolveError> {
    if robots <= SMALL {
        return Ok(());
    }
    admit(robots, size.peak_mib(path), available_mib())
}

/// Whether a fleet fits. Where the system does not tell how much memory is available, every fleet does.
fn fits(robots: usize, peak_mib: u64, available_mib: Option<u64>) -> bool {
    robots <= SMALL || available_mib.is_none_or(|available| peak_mib <= available)
}

/// Refuses a fleet that does not fit.
fn admit(robots: usize, peak_mib: u64, available_mib: Option<u64>) -> Result<(), SolveError> {
    match available_mib {
        Some(available) if !fits(robots, peak_mib, available_mib) => refuse(
            "robots",
            format!(
                "the dense matrices of {robots} robots need about {peak_mib} MiB of memory, and \
                 {available} MiB are available; end other programs, take a larger machine, or divide \
                 parts of the fleet"
            ),
        ),
        _ => Ok(()),
    }
}

/// Memory that can be had without swapping, by Linux's own estimate.
fn available_mib() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    let kib: u64 = line.split_whitespace().next()?.parse().ok()?;
    Some(kib >> 10)
}

impl Estimate {
    /// Estimates the text of a file, which is read and checked as for a solve.
    ///
    /// # Errors
    /// Names the field that is wrong and the remedy.
    pub fn new(text: &[u8], normalize_weights: bool) -> Result<Self, SolveError> {
        Ok(estimate(&super::parse(text, normalize_weights)?))
    }

    /// Whether it fits into the memory that is available.
    ///
    /// # Errors
    /// The error with which a solve would be refused.
    pub fn check(&self) -> Result<(), SolveError> {
        admit(self.robots, self.peak_mib, self.available_mib)
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
            self.path.description(),
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
    use serde_json::{Value, json};

    use super::*;

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
        Size::of(&crate::parse(text.as_bytes(), false).unwrap())
    }

    #[test]
    fn the_size_is_that_of_the_file() {
        let expected =
            Size { robots: 50.0, edges: 49.0, dimension: 6.0, teams: 3.0, restarts: 7.0 };
        assert_eq!(size(&file(50, json!({}))), expected);
        let labels: Vec<usize> = (0..50).map(|robot| robot % 4).collect();
        let judged = json!({"teams": null, "labels": labels, "dimension": 20});
        let expected = Size { dimension: 20.0, teams: 4.0, restarts: 0.0, ..expected };
        assert_eq!(size(&file(50, judged)), expected);
    }

    #[test]
    fn a_fleet_is_refused_by_the_numbers_that_are_told() {
        let mut estimate = Estimate::new(file(50, json!({})).as_bytes(), false).unwrap();
        assert!(estimate.fits && estimate.check().is_ok());
        let size = Size { robots: 4000.0, ..size(&file(50, json!({}))) };
        estimate.robots = 4000;
        estimate.peak_mib = size.peak_mib(Path::Dense);
        // Twelve matrices of 4000² doubles, and the program.
        assert_eq!(estimate.peak_mib, 1465 + 16);
        estimate.available_mib = Some(1481);
        assert!(estimate.check().is_ok());
        estimate.available_mib = Some(1480);
        let error = estimate.check().unwrap_err().to_string();
        assert!(error.starts_with("robots: ") && error.contains("4000 robots"), "{error}");
        assert!(error.contains("1481 MiB") && error.contains("1480 MiB"), "{error}");
        estimate.available_mib = None;
        assert!(estimate.check().is_ok());
        assert!(fits(SMALL, 2, Some(1)) && !fits(SMALL + 1, 2, Some(1)));
    }

    #[test]
    fn more_of_anything_takes_no_less() {
        let speed = Speed::measure();
        let base = Size { robots: 300.0, edges: 3e3, dimension: 8.0, teams: 4.0, restarts: 9.0 };
        let total =
            |size: &Size| DENSE.iter().map(|cost| (cost.seconds)(size, &speed)).sum::<f64>();
        for more in [
            Size { robots: 600.0, ..base.clone() },
            Size { edges: 6e3, ..base.clone() },
            Size { dimension: 16.0, ..base.clone() },
            Size { teams: 8.0, ..base.clone() },
            Size { restarts: 18.0, ..base.clone() },
        ] {
            assert!(total(&more) > total(&base), "{more:?}");
            assert!(more.peak_mib(Path::Dense) >= base.peak_mib(Path::Dense), "{more:?}");
        }
    }

    #[test]
    fn it_is_told_in_json_and_to_read() {
        let estimate = Estimate::new(file(50, json!({})).as_bytes(), false).unwrap();
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
    fn a_duration_is_told_in_its_unit() {
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

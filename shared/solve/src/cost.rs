//! What each step of each path holds in memory at its worst moment, and what its time grows with.

use muster_method::decomposition::Path;
use muster_method::step::Step;
use muster_model::settings::{Dimension, Normalization};
use muster_numeric::dimension::least_rank;
use muster_numeric::katz_svd::{SearchColumns, search_columns};
use muster_numeric::silhouette::{Method, SAMPLE_POINTS};

use super::division::{kmeans_threads, silhouette_params, wanted_teams};
use super::file::Emit;
use super::problem::{Division, Graph, Problem};
use super::speed::Speed;

/// Memory of the program itself and of everything else that does not grow with the robots, in MiB.
const BASE_MIB: f64 = 16.0;

/// Bytes of a robot throughout: its name, its label, its silhouette.
const ROBOT_BYTES: f64 = 128.0;

/// Bytes of an edge in a graph: a column and a weight.
const EDGE_BYTES: f64 = 16.0;

/// Lloyd iterations and exchanges of one start of k-means, most of which are over before.
const KMEANS_ITERATIONS: f64 = 15.0;

/// Largest component whose spectral radius is found by elimination whatever that fills in, and the largest
/// one where it may fill in so many entries per robot and per edge; larger ones are swept over.
const ELIMINATED: f64 = 4096.0;
const ELIMINATED_LARGE: f64 = 20_000.0;
const LARGE_ENTRIES: (f64, f64) = (128.0, 2.0);

/// Bytes of an entry of a factor, its indices, and those of its transpose.
const ENTRY_BYTES: f64 = 24.0;

/// Sweeps over the edges for a spectral radius, as of elimination, where fleets are too large for it.
const SWEEPS: f64 = 4096.0;

/// How many robots' walks are compared at once to examine the trust in modalities, fewer where edges × robots
/// would exceed a limit, and the fewest modalities and robots that are compared: those of `muster-method`.
const EXAMINED_AT_ONCE: std::ops::RangeInclusive<usize> = 64..=1024;
const EXAMINED_EDGES: usize = 1 << 24;
const EXAMINED_MODALITIES: usize = 3;
const EXAMINED_ROBOTS: usize = 8;

/// Passes over the edges for the walks of one robot: two rounds, in each of which four steps are taken by
/// each of three modalities and by all others.
const TRUST_SWEEPS: f64 = 24.0;

/// What the time and the memory of a solve grow with.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Size {
    pub(super) robots: f64,
    /// Of all graphs together.
    pub(super) edges: f64,
    /// Length of the vectors, as large as it may be chosen.
    pub(super) dimension: f64,
    /// Singular triplets that are searched for on the inverse-free path.
    pub(super) rank: f64,
    pub(super) teams: f64,
    /// Starts of k-means; 0 where a division is judged.
    pub(super) restarts: f64,
    /// Threads that k-means is shared out over.
    pub(super) threads: f64,
    /// How the silhouettes are computed.
    pub(super) silhouettes: Method,
    /// Whether each graph is divided by its norm.
    pub(super) is_spectral: bool,
    /// Robots whose walks are compared to examine the trust in modalities; 0 where nothing is in question.
    pub(super) examined: f64,
    /// Whether the similarity is kept for the output.
    pub(super) keeps_katz: bool,
}

/// A step of a path.
pub(super) struct Cost {
    pub(super) step: Step,
    /// Bytes at the worst moment of the step, in addition to the graphs and the robots.
    bytes: fn(&Size) -> f64,
    /// Seconds on a machine of this speed.
    pub(super) seconds: fn(&Size, &Speed) -> f64,
}

/// The steps that both paths begin with.
const FUSE: Cost = Cost { step: Step::Fuse, bytes: Size::fuse_bytes, seconds: Size::fuse_seconds };
const RADIUS: Cost =
    Cost { step: Step::SpectralRadius, bytes: Size::radius_bytes, seconds: Size::radius_seconds };

/// LU and singular value decomposition take N³ operations.
const DENSE: [Cost; 4] = [
    FUSE,
    RADIUS,
    Cost {
        // Two pairs of sides, the factors, the solution and its copy.
        step: Step::Katz,
        bytes: |size| size.matrices(6.0) + EDGE_BYTES * size.edges,
        seconds: |size, speed| speed.katz.seconds(size.robots),
    },
    Cost {
        // The similarity, its scaled copy, both sides of vectors with their copies, and what the
        // library works in.
        step: Step::Svd,
        bytes: |size| size.matrices(12.0) + EDGE_BYTES * size.edges,
        seconds: |size, speed| speed.svd.seconds(size.robots),
    },
];

/// The search makes some rounds, in each of which it multiplies vectors by the graph and by each other.
const INVERSE_FREE: [Cost; 3] = [
    FUSE,
    RADIUS,
    Cost { step: Step::SEARCH, bytes: Size::search_bytes, seconds: Size::search_seconds },
];

/// k-means takes N distances for each team, restart and iteration, and exact silhouettes N².
const DIVISION: [Cost; 2] = [
    Cost {
        step: Step::KMeans { done: 0, restarts: 0 },
        bytes: Size::point_bytes,
        seconds: |size, speed| {
            let distances = size.robots * size.teams * size.restarts * KMEANS_ITERATIONS;
            speed.kmeans_per_product * distances * size.dimension / size.threads
        },
    },
    Cost {
        step: Step::Silhouettes,
        bytes: Size::point_bytes,
        seconds: |size, speed| {
            let pairs = match size.silhouettes {
                Method::Exact => size.robots * size.robots,
                Method::SquaredExact => size.robots * size.teams,
                // Each pair of two that are compared with all counts twice.
                Method::Sampled => size.robots * (size.teams + 2.0 * SAMPLE_POINTS as f64),
            };
            speed.silhouettes_per_product * pairs * size.dimension
        },
    },
];

/// What is done by a path, in order.
pub(super) fn steps(path: Path) -> impl Iterator<Item = &'static Cost> {
    let decomposed = match path {
        Path::Dense => &DENSE[..],
        Path::InverseFree => &INVERSE_FREE,
    };
    decomposed.iter().chain(&DIVISION)
}

impl Size {
    /// What a problem grows with.
    #[expect(clippy::cast_precision_loss, reason = "counts are far below 2⁵³")]
    pub(super) fn of(problem: &Problem) -> Self {
        let robots = problem.robots.len();
        // At most, where the number is chosen.
        let wanted = wanted_teams(problem);
        let teams = (*wanted.range().end() as usize).min(robots.max(1));
        let evidence = if wanted.fixed().is_some() { 0 } else { teams + 1 };
        let (dimension, rank) = match problem.settings.dimension {
            Dimension::Fixed(dimension) => {
                (dimension as usize, (dimension as usize / 2 + 1).max(evidence))
            }
            Dimension::Auto => (2 * teams.clamp(2, robots.max(2)), least_rank(robots, teams)),
        };
        let (restarts, threads) = match &problem.division {
            Division::Wanted(settings) => {
                (settings.restarts, kmeans_threads(settings, teams, robots))
            }
            Division::Given(_) => (0, 1),
        };
        Self {
            robots: robots as f64,
            edges: problem.graphs.iter().map(|graph| graph.matrix.edges()).sum::<usize>() as f64,
            dimension: dimension as f64,
            rank: rank.min(robots) as f64,
            teams: teams as f64,
            restarts: f64::from(restarts),
            threads: threads as f64,
            silhouettes: silhouette_params(problem.options.silhouette).method(robots),
            is_spectral: problem.settings.normalize == Normalization::Spectral,
            examined: examined(problem) as f64,
            keeps_katz: problem.emit.contains(&Emit::Katz),
        }
    }

    /// Memory at the worst moment of a step in MiB.
    pub(super) fn mib(&self, cost: &Cost) -> f64 {
        let all = ROBOT_BYTES * self.robots + EDGE_BYTES * self.edges + (cost.bytes)(self);
        BASE_MIB + all / f64::from(1 << 20)
    }

    /// Memory at the worst moment of all in MiB.
    pub(super) fn peak_mib(&self, path: Path) -> u64 {
        let peak = steps(path).map(|cost| self.mib(cost)).fold(0.0, f64::max);
        whole(peak)
    }

    /// How many directions the space of the search holds.
    pub(super) fn search_width(&self) -> f64 {
        (self.columns().space as f64).min(self.robots)
    }

    /// Vectors that the search carries along.
    fn carried(&self) -> f64 {
        (self.columns().carried as f64).min(self.robots)
    }

    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "both are counts")]
    fn columns(&self) -> SearchColumns {
        search_columns(self.robots as usize, self.rank as usize)
    }

    /// Bytes of so many matrices of one double per pair of robots.
    fn matrices(&self, count: f64) -> f64 {
        8.0 * count * self.robots * self.robots
    }

    /// Two rows of similarities per robot that is examined, and the graphs scaled and together. Where graphs
    /// are divided by their norms, each norm is a spectral radius.
    fn fuse_bytes(&self) -> f64 {
        let norms = if self.is_spectral { self.radius_bytes() } else { 0.0 };
        norms.max(16.0 * self.examined * self.robots + 80.0 * self.edges)
    }

    fn fuse_seconds(&self, speed: &Speed) -> f64 {
        let norms = if self.is_spectral { self.radius_seconds(speed) } else { 0.0 };
        norms + speed.radius_per_product * TRUST_SWEEPS * self.examined * self.edges
    }

    fn radius_bytes(&self) -> f64 {
        let entries = match self.robots {
            ..=ELIMINATED => 0.5 * self.robots * self.robots,
            ..=ELIMINATED_LARGE => LARGE_ENTRIES.0 * self.robots + LARGE_ENTRIES.1 * self.edges,
            _ => 0.0,
        };
        ENTRY_BYTES * entries + 80.0 * self.edges
    }

    fn radius_seconds(&self, speed: &Speed) -> f64 {
        speed.radius_per_product * self.edges * self.robots.min(SWEEPS)
    }

    /// The space and its image, six more blocks of vectors, five in single precision, and the
    /// samples that the preconditioner is fitted to; the graph in two directions and precisions, and its
    /// symmetric part.
    fn search_bytes(&self) -> f64 {
        let carried = self.carried();
        // Whether the search is long enough for its space to grow is not known before. As it grows, both are held.
        let SearchColumns { space, grown, .. } = self.columns();
        let columns = if grown > space { space + grown } else { space };
        let space = (columns as f64).min(2.0 * self.robots);
        let doubles = 2.0 * space + 6.0 * carried + 40.0;
        let singles = 5.0 * (carried / 16.0).ceil() * 16.0;
        self.robots * (8.0 * doubles + 4.0 * singles) + 96.0 * self.edges
    }

    /// Rounds of products of the graph with vectors, and of vectors with each other.
    fn search_seconds(&self, speed: &Speed) -> f64 {
        speed.search_seconds(self.robots, self.edges, self.carried(), self.search_width())
    }

    /// The vectors in four forms, what each start holds for every robot, and the similarity if it is
    /// wanted.
    fn point_bytes(&self) -> f64 {
        let kept = if self.keeps_katz { self.matrices(1.0) } else { 0.0 };
        kept + self.robots * (32.0 * self.dimension + 128.0 * self.threads)
    }
}

/// How many robots are examined for the trust in modalities.
fn examined(problem: &Problem) -> usize {
    let compared: Vec<&Graph> = problem
        .graphs
        .iter()
        .filter(|graph| graph.weight > 0.0 && !graph.matrix.is_zero())
        .collect();
    let robots = problem.robots.len();
    let is_in_question = compared.len() >= EXAMINED_MODALITIES
        && robots >= EXAMINED_ROBOTS
        && compared.iter().any(|graph| !problem.settings.trusted.contains(&graph.name));
    if !is_in_question {
        return 0;
    }
    let edges: usize = compared.iter().map(|graph| graph.matrix.edges()).sum();
    let (least, most) = (*EXAMINED_AT_ONCE.start(), *EXAMINED_AT_ONCE.end());
    robots.min((EXAMINED_EDGES / edges.max(1)).clamp(least, most))
}

/// The next whole number.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "it is no less than 0")]
pub(super) fn whole(value: f64) -> u64 {
    value.ceil() as u64
}

//! How fast this machine is at the steps of the method, by a small problem.

use std::hint::black_box;
use std::time::Instant;

use muster_numeric::katz::katz_similarity;
use muster_numeric::katz_svd::{KatzSvd, KatzSvdOptions, search_columns};
use muster_numeric::kmeans::{KMeansOptions, kmeans};
use muster_numeric::matrix::{DenseMatrix, SparseMatrix};
use muster_numeric::silhouette::silhouette;
use muster_numeric::spectral_radius::spectral_radius;
use muster_numeric::svd::full_svd;

/// Columns and rows of the grids on which the robots of the small problems stand. Two sizes show what
/// is done per pair of robots, such as copies, from what is done per pair and robot; the larger one is
/// small enough that all of it takes some hundredths of a second.
const SMALLER: (usize, usize) = (8, 12);
const LARGER: (usize, usize) = (16, 18);

/// Columns and rows of the grid of the search, which is for large fleets, and what is searched for.
const SEARCHED: (usize, usize) = (32, 32);
const SEARCH_RANK: usize = 5;
const SEARCH_TOLERANCE: f64 = 1e-11;

/// Products with the graph in each round of the search, for each vector: two, and those of the
/// preconditioner, which take half as long.
const GRAPH_PRODUCTS: f64 = 5.0;

/// Products of each vector with those of the space, in each round.
const SPACE_PRODUCTS: f64 = 6.0;

/// Points of the small problem of k-means and silhouettes.
const POINTS: usize = 256;

/// Dimension, teams and restarts of the small problem.
const DIMENSION: usize = 8;
const TEAMS: usize = 4;
const RESTARTS: usize = 4;

/// Operations per pair and robot of the full singular value decomposition for one of the Katz similarity:
/// some 20 (bidiagonal form, both sides of vectors) for 2/3 (factors) and 2 (right sides), with the first
/// of them in slower kernels. The similarity itself takes so little of it at the size of the small
/// problems that noise would hide it.
const SVD_PER_KATZ: f64 = 6.0;

/// How often each step is measured; the fastest counts, which nothing else has slowed down.
const REPEATS: usize = 3;

/// Seconds of something that does some work per pair of robots, and some per pair and robot.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Cubic {
    per_square: f64,
    per_cube: f64,
}

impl Cubic {
    /// What fits the seconds of two sizes, the smaller one first. Where the larger one is too fast for
    /// the smaller one, which is noise, all work is taken to grow with the cube: that is cautious.
    fn fit([smaller, larger]: [(f64, f64); 2]) -> Self {
        let per_square = |(robots, seconds): (f64, f64)| seconds / (robots * robots);
        let per_cube = (per_square(larger) - per_square(smaller)) / (larger.0 - smaller.0);
        let rest = per_square(smaller) - per_cube * smaller.0;
        if per_cube > 0.0 && rest >= 0.0 {
            Self { per_square: rest, per_cube }
        } else {
            Self { per_square: 0.0, per_cube: per_square(larger) / larger.0 }
        }
    }

    /// What fits the seconds of one size, with the work per pair and robot known.
    fn with_cube(per_cube: f64, (robots, seconds): (f64, f64)) -> Self {
        let per_square = seconds / (robots * robots) - per_cube * robots;
        Self { per_square: per_square.max(0.0), per_cube }
    }

    /// Seconds for so many robots.
    pub(super) fn seconds(self, robots: f64) -> f64 {
        (self.per_square + self.per_cube * robots) * robots * robots
    }
}

/// Seconds per unit of work. A speed that could not be measured is 0.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Speed {
    /// Of the spectral radius, per edge and robot: an estimate from above for larger fleets, as its
    /// elimination takes about the power 1.5 of the robots in the plane.
    pub(super) radius_per_product: f64,
    pub(super) katz: Cubic,
    pub(super) svd: Cubic,
    /// Of the search for triplets, per product of two numbers, for all rounds together.
    pub(super) search_per_product: f64,
    /// Of k-means, per robot, team, restart, iteration and dimension.
    pub(super) kmeans_per_product: f64,
    /// Of silhouettes, per squared robot and dimension.
    pub(super) silhouettes_per_product: f64,
}

impl Speed {
    /// Measures all steps on small problems.
    pub(super) fn measure() -> Self {
        let speed = Self::of_matrices().unwrap_or_default().with_search().unwrap_or_default();
        speed.with_points().unwrap_or_default()
    }

    /// Seconds of the search for so many robots and edges, by the vectors that it carries along and those
    /// that its space holds.
    pub(super) fn search_seconds(&self, robots: f64, edges: f64, carried: f64, space: f64) -> f64 {
        self.search_per_product * search_products(robots, edges, carried, space)
    }

    /// The steps from graphs to vectors. None for graphs that cannot be solved, which these can.
    #[expect(clippy::cast_precision_loss, reason = "counts are far below 2⁵³")]
    fn of_matrices() -> Option<Self> {
        let mut speed = Self::default();
        let mut of_size = |(columns, rows): (usize, usize)| {
            let robots = columns * rows;
            let graph = SparseMatrix::from_triplets(robots, grid(columns, rows)).ok()?;
            let (seconds, radius) = timed(|| spectral_radius(&graph, None));
            let robots = robots as f64;
            speed.radius_per_product = seconds / (graph.edges() as f64 * robots);
            let (katz, similarity) =
                timed(|| katz_similarity(&graph, 0.5 / radius.upper, &radius).ok());
            let similarity = similarity?;
            let (svd, _) = timed(|| full_svd(&similarity).ok());
            Some([(robots, katz), (robots, svd)])
        };
        let ([_, svd], [katz_larger, svd_larger]) = (of_size(SMALLER)?, of_size(LARGER)?);
        speed.svd = Cubic::fit([svd, svd_larger]);
        speed.katz = Cubic::with_cube(speed.svd.per_cube / SVD_PER_KATZ, katz_larger);
        Some(speed)
    }

    /// The search for triplets, added.
    #[expect(clippy::cast_precision_loss, reason = "counts are far below 2⁵³")]
    fn with_search(self) -> Option<Self> {
        let (columns, rows) = SEARCHED;
        let robots = columns * rows;
        let graph = SparseMatrix::from_triplets(robots, grid(columns, rows)).ok()?;
        let radius = spectral_radius(&graph, None);
        let alpha = 0.5 / radius.upper;
        let options = KatzSvdOptions {
            exact: None,
            rank: SEARCH_RANK,
            tolerance: SEARCH_TOLERANCE,
            seed: 0,
            threads: 1,
        };
        let (seconds, _) =
            timed(|| KatzSvd::default().solve(&graph, alpha, &radius, options, None).ok());
        let (robots, edges) = (robots as f64, graph.edges() as f64);
        let columns = search_columns(graph.nodes(), SEARCH_RANK);
        let products = search_products(robots, edges, columns.carried as f64, columns.space as f64);
        Some(Self { search_per_product: seconds / products, ..self })
    }

    /// The steps from vectors to the verdict, added.
    #[expect(clippy::cast_precision_loss, reason = "counts are far below 2⁵³")]
    fn with_points(self) -> Option<Self> {
        let entries = (0..POINTS * DIMENSION).map(|at| scattered(at / DIMENSION, at % DIMENSION));
        let x = DenseMatrix::new(POINTS, DIMENSION, entries.collect()).ok()?;
        let options = KMeansOptions { restarts: RESTARTS, ..KMeansOptions::new(TEAMS) };
        let (kmeans, found) = timed(|| kmeans(&x, &options).ok());
        let found = found?;
        let (silhouettes, _) = timed(|| silhouette(&x, &found.labels).ok());
        let per_iteration = (POINTS * TEAMS * RESTARTS * DIMENSION) as f64;
        Some(Self {
            kmeans_per_product: kmeans / (per_iteration * found.iterations as f64),
            silhouettes_per_product: silhouettes / (POINTS * POINTS * DIMENSION) as f64,
            ..self
        })
    }
}

/// Products of two numbers in one round of the search.
fn search_products(robots: f64, edges: f64, carried: f64, space: f64) -> f64 {
    carried * (GRAPH_PRODUCTS * edges + SPACE_PRODUCTS * space * robots)
}

/// Robots on a grid, each related to its neighbours, less or more.
#[expect(clippy::cast_precision_loss, reason = "counts are far below 2⁵³")]
fn grid(columns: usize, rows: usize) -> impl Iterator<Item = (usize, usize, f64)> {
    let edges = move |robot: usize| {
        let (column, row) = (robot % columns, robot / columns);
        let east = (column + 1 < columns).then_some(robot + 1);
        let north = (row + 1 < rows).then_some(robot + columns);
        let weight = 1.0 + (robot * 7 % 5) as f64;
        east.into_iter()
            .chain(north)
            .flat_map(move |other| [(robot, other, weight), (other, robot, weight)])
    };
    (0..columns * rows).flat_map(edges)
}

/// Points without a pattern that k-means would see: fractions of multiples of irrational numbers.
#[expect(clippy::cast_precision_loss, reason = "counts are far below 2⁵³")]
fn scattered(row: usize, column: usize) -> f64 {
    ((row + 1) as f64 * (column as f64 + 2.0).sqrt()).fract()
}

/// The least seconds that something takes, and what came out.
fn timed<T>(mut work: impl FnMut() -> T) -> (f64, T) {
    let mut once = || {
        let begin = Instant::now();
        let result = black_box(work());
        (begin.elapsed().as_secs_f64(), result)
    };
    let first = once();
    (1..REPEATS).fold(first, |best, _| {
        let next = once();
        if next.0 < best.0 { next } else { best }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_sizes_distinguish_squares_from_cubes() {
        let seconds = |robots: f64| 3e-8 * robots.powi(2) + 2e-10 * robots.powi(3);
        let fit = Cubic::fit([100.0, 300.0].map(|robots| (robots, seconds(robots))));
        for robots in [100.0, 1000.0, 10_000.0] {
            assert!((fit.seconds(robots) / seconds(robots) - 1.0).abs() < 1e-9);
        }
        let with_cube = Cubic::with_cube(2e-10, (300.0, seconds(300.0)));
        assert!((with_cube.seconds(1000.0) / seconds(1000.0) - 1.0).abs() < 1e-9);
        // Noise that makes no sense is taken for cubes.
        let fit = Cubic::fit([(100.0, 1.0), (300.0, 2.7)]);
        assert!((fit.seconds(3000.0) - 2700.0).abs() < 1e-6);
    }

    #[test]
    fn every_step_has_a_speed() {
        let speed = Speed::measure();
        let found = [
            speed.radius_per_product,
            speed.katz.seconds(100.0),
            speed.svd.seconds(100.0),
            speed.search_seconds(1e4, 1e5, 16.0, 48.0),
            speed.kmeans_per_product,
            speed.silhouettes_per_product,
        ];
        assert!(found.iter().all(|speed| *speed > 0.0 && speed.is_finite()), "{found:?}");
    }
}

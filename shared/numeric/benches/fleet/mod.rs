//! Fleets of clustered squads at unit density in the order of a Morton curve, related by a kernel that
//! falls smoothly to zero and by a tree of commands: about 18 weights a robot.

use muster_numeric::matrix::SparseMatrix;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Distance that each robot covers from frame to frame, in mean spacings.
pub(crate) const STEP: f64 = 0.004;

/// Reach of the kernel, in mean spacings.
const REACH: f64 = 2.0;

/// Positions and headings of clustered squads.
pub(crate) struct Fleet {
    places: Vec<[f64; 2]>,
    headings: Vec<f64>,
    side: f64,
}

impl Fleet {
    pub(crate) fn new(n: usize) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let side = (n as f64).sqrt();
        let squads: Vec<[f64; 2]> =
            (0..n.div_ceil(12)).map(|_| [(); 2].map(|()| side * rng.random::<f64>())).collect();
        let mut normal = || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
        let mut place = |i: usize| {
            squads[i % squads.len()].map(|centre| (centre + 1.6 * normal()).rem_euclid(side))
        };
        let mut places: Vec<[f64; 2]> = (0..n).map(&mut place).collect();
        places.sort_by_key(|place| morton(place.map(|x| (64.0 * x) as u32)));
        let headings = (0..n).map(|_| std::f64::consts::TAU * rng.random::<f64>()).collect();
        Self { places, headings, side }
    }

    /// Moves a robot along its heading.
    pub(crate) fn shift(&mut self, robot: usize, step: f64) {
        let heading = self.headings[robot];
        self.places[robot][0] += step * heading.cos();
        self.places[robot][1] += step * heading.sin();
    }

    /// A kernel that falls smoothly to zero, and a tree of commands.
    pub(crate) fn graph(&self) -> SparseMatrix {
        let cells = (self.side / REACH) as usize + 3;
        let cell = |x: f64| ((x / REACH + 1.0).max(0.0) as usize).min(cells - 1);
        let mut grid = vec![Vec::new(); cells * cells];
        for (i, place) in self.places.iter().enumerate() {
            grid[cell(place[1]) * cells + cell(place[0])].push(i);
        }
        let near = |i: usize| {
            let [x, y] = self.places[i].map(cell);
            let rows = y.saturating_sub(1)..(y + 2).min(cells);
            let columns = x.saturating_sub(1)..(x + 2).min(cells);
            rows.flat_map(move |row| columns.clone().map(move |column| row * cells + column))
        };
        let mut edges = Vec::new();
        for (i, p) in self.places.iter().enumerate() {
            for &j in near(i).flat_map(|cell| &grid[cell]) {
                let q = self.places[j];
                let square = ((p[0] - q[0]).powi(2) + (p[1] - q[1]).powi(2)) / REACH.powi(2);
                if i != j && square < 1.0 {
                    edges.push((i, j, (1.0 - square).powi(2)));
                }
            }
            if i > 0 {
                edges.extend([(i, (i - 1) / 8, 0.3), ((i - 1) / 8, i, 0.2)]);
            }
        }
        SparseMatrix::from_triplets(self.places.len(), edges)
            .unwrap_or_else(|error| unreachable!("{error}"))
    }
}

/// Place on the curve that takes the bits of both coordinates in turn.
fn morton(place: [u32; 2]) -> u64 {
    let spread = |v: u32| (0..32).map(|bit| u64::from(v >> bit & 1) << (2 * bit)).sum::<u64>();
    spread(place[0]) | spread(place[1]) << 1
}

//! What is to be divided: robots with what relates them.

use muster_model::settings::{SpatialKernel, SpatialScale, SpatialSettings};
use muster_numeric::matrix::{MatrixError, SparseMatrix};
use muster_relation::kernel::{MIN_WEIGHT, wendland_c2};
use muster_relation::spatial::scale_neighbour;
use muster_relation::{EdgeError, connectivity_edges, hierarchy_edges, spatial_edges};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::moving::faults::{Mask, Sense};

/// Robots at one moment. Lists have one entry per robot.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct System {
    /// Metres east and north.
    pub positions: Vec<[f64; 2]>,
    /// The incoming links of each robot: peer, and quality from 0 to 1.
    pub links: Vec<Vec<(u32, f64)>>,
    /// The superior of each robot; none at the top.
    pub superiors: Vec<Option<u32>>,
    /// Distances of all pairs in metres, in rows, where they are measured and not those of the positions.
    pub measured: Option<Vec<f64>>,
}

/// Why a system has no graphs.
#[derive(Debug, thiserror::Error)]
pub enum SystemError {
    /// A report is wrong.
    #[error(transparent)]
    Edge(#[from] EdgeError),
    /// A graph is none.
    #[error(transparent)]
    Matrix(#[from] MatrixError),
}

/// The modalities, in the order of all lists of graphs and weights.
pub const MODALITIES: [&str; 3] = ["spatial", "connectivity", "hierarchy"];

/// How distances become weights.
#[derive(Debug, Clone, PartialEq)]
pub enum Nearness {
    /// 1/d over all pairs, with d in metres: what the paper's words suggest. Robots on one spot get the
    /// weight of [`CLOSEST_M`].
    Inverse,
    /// The live system's kernels.
    Kernel(SpatialSettings),
}

/// As the live system's kernel: no robot is measured by less than this share of the fleet's median distance
/// to the nearest …
const SHORTEST_SCALE: f64 = 0.1;

/// … nor by more than so many times the distance to its own nearest …
const LONGEST_PER_NEAREST: f64 = 5.0;

/// … nor by more than so many times the lower quartile of what the others are measured by.
const LONGEST_PER_QUARTILE: f64 = 3.0;

/// Distances below this one count as this one, in metres: the size of a robot.
pub const CLOSEST_M: f64 = 0.1;

impl System {
    /// How many robots there are.
    #[must_use]
    pub fn robots(&self) -> usize {
        self.positions.len()
    }

    /// The graphs, in the order of [`MODALITIES`].
    ///
    /// # Errors
    /// [`SystemError`] for reports that contradict themselves.
    pub fn graphs(&self, nearness: &Nearness) -> Result<[SparseMatrix; 3], SystemError> {
        Ok([self.spatial(nearness)?, self.connectivity()?, self.hierarchy()?])
    }

    /// The graph of positions.
    ///
    /// # Errors
    /// [`SystemError::Matrix`] for too many pairs.
    pub fn spatial(&self, nearness: &Nearness) -> Result<SparseMatrix, SystemError> {
        let edges = match nearness {
            Nearness::Inverse => self.all_pairs(|_, _, metres| 1.0 / metres.max(CLOSEST_M)),
            Nearness::Kernel(settings) if self.measured.is_some() => {
                let scales = self.scales(settings);
                self.all_pairs(|i, j, metres| weight(settings, metres, scales[i] * scales[j]))
            }
            Nearness::Kernel(settings) => {
                let positions: Vec<_> = self.positions.iter().map(|[x, y]| [*x, *y, 0.0]).collect();
                spatial_edges(&positions, settings)
            }
        };
        self.matrix(edges)
    }

    /// The distance of two robots in metres, as it was measured.
    #[must_use]
    pub fn distance(&self, i: usize, j: usize) -> f64 {
        match &self.measured {
            Some(metres) => metres[i * self.robots() + j],
            None => {
                let (from, to) = (self.positions[i], self.positions[j]);
                (from[0] - to[0]).hypot(from[1] - to[1])
            }
        }
    }

    fn all_pairs(&self, weight: impl Fn(usize, usize, f64) -> f64) -> Vec<(u32, u32, f64)> {
        let n = self.robots();
        let pairs = (0..n).flat_map(|i| (0..n).filter(move |j| *j != i).map(move |j| (i, j)));
        let edges = pairs.map(|(i, j)| (i as u32, j as u32, weight(i, j, self.distance(i, j))));
        edges.filter(|(_, _, weight)| *weight >= MIN_WEIGHT).collect()
    }

    /// The root of what each robot is measured by, as `muster_relation::spatial_edges` does with positions.
    fn scales(&self, settings: &SpatialSettings) -> Vec<f64> {
        let n = self.robots();
        let fleet = self.median_nearest();
        if settings.scale == SpatialScale::Fleet || settings.kernel == SpatialKernel::WendlandC2 {
            return vec![fleet.sqrt(); n];
        }
        let scale = |i: usize| {
            let others = (0..n).filter(|j| *j != i);
            let mut all: Vec<f64> = others.map(|j| self.distance(i, j)).collect();
            all.sort_by(f64::total_cmp);
            let place = scale_neighbour(settings, n) - 1;
            let own = all.get(place).or(all.last()).copied().unwrap_or(fleet);
            let own = own.min(LONGEST_PER_NEAREST * all.first().copied().unwrap_or(fleet));
            own.max(SHORTEST_SCALE * fleet)
        };
        let scales: Vec<f64> = (0..n).map(scale).collect();
        let least = SHORTEST_SCALE * fleet;
        let mut apart: Vec<f64> = scales.iter().copied().filter(|own| *own > least).collect();
        apart.sort_by(f64::total_cmp);
        let quartile = apart.get(apart.len() / 4).copied().unwrap_or(f64::INFINITY);
        let most = LONGEST_PER_QUARTILE * quartile;
        scales.into_iter().map(|own| own.min(most).sqrt()).collect()
    }

    /// The median distance to the nearest other robot.
    fn median_nearest(&self) -> f64 {
        let n = self.robots();
        let nearest = |i: usize| {
            let others = (0..n).filter(|j| *j != i);
            others.map(|j| self.distance(i, j)).fold(f64::INFINITY, f64::min)
        };
        let mut all: Vec<f64> = (0..n).map(nearest).collect();
        all.sort_by(f64::total_cmp);
        match n {
            0 => 1.0,
            n if n % 2 == 1 => all[n / 2],
            n => 0.5 * (all[n / 2 - 1] + all[n / 2]),
        }
    }

    /// The same system, of which every distance is measured with an error of up to `share` of it either way.
    #[must_use]
    pub fn with_noise(&self, share: f64, seed: u64) -> Self {
        let mut chance = ChaCha8Rng::seed_from_u64(seed);
        let n = self.robots();
        let mut metres = vec![0.0; n * n];
        for i in 0..n {
            for j in i + 1..n {
                let error = share * (2.0 * chance.random::<f64>() - 1.0);
                let measured = (1.0 + error) * self.distance(i, j);
                (metres[i * n + j], metres[j * n + i]) = (measured, measured);
            }
        }
        Self { measured: Some(metres), ..self.clone() }
    }

    /// The same system, in which every robot reports one modality of another robot.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "robots are numbered by 32 bits")]
    pub fn mistaken(&self, sense: Sense, seed: u64) -> Self {
        let mask = Mask::shuffled(self.robots(), &mut ChaCha8Rng::seed_from_u64(seed));
        let named = |robot: u32| mask.named[robot as usize] as u32;
        let mut system = self.clone();
        for (robot, of) in mask.of.iter().copied().enumerate() {
            match sense {
                Sense::Spatial => system.positions[robot] = self.positions[of],
                Sense::Connectivity => {
                    let links = self.links[of].iter();
                    system.links[robot] = links.map(|(peer, q)| (named(*peer), *q)).collect();
                }
                Sense::Hierarchy => system.superiors[robot] = self.superiors[of].map(named),
            }
        }
        system
    }

    /// The graph of links, from senders to receivers.
    ///
    /// # Errors
    /// [`SystemError::Edge`] for a robot with a link from itself, or two from the same robot.
    pub fn connectivity(&self) -> Result<SparseMatrix, SystemError> {
        let reports = (0..).zip(&self.links).map(|(robot, links)| (robot, &links[..]));
        self.matrix(connectivity_edges(reports)?)
    }

    /// The graph of command, from superiors down.
    ///
    /// # Errors
    /// [`SystemError::Edge`] for a robot that answers to itself.
    pub fn hierarchy(&self) -> Result<SparseMatrix, SystemError> {
        self.command(0.0, 0.0)
    }

    /// The graph of command with `upward` times its reverse, and ties of `siblings` between those who answer to
    /// the same superior.
    ///
    /// # Errors
    /// As [`System::hierarchy`].
    pub fn command(&self, upward: f64, siblings: f64) -> Result<SparseMatrix, SystemError> {
        let ranks = (0..).zip(&self.superiors).map(|(robot, superior)| (robot, *superior, None));
        let down = self.matrix(hierarchy_edges(ranks)?)?;
        let mut edges: Vec<_> = down.with_reverse(upward)?.triplets().collect();
        if siblings > 0.0 {
            let n = self.robots();
            let pairs = (0..n).flat_map(|i| (0..n).map(move |j| (i, j)));
            let same = |&(i, j): &(usize, usize)| {
                i != j && self.superiors[i].is_some() && self.superiors[i] == self.superiors[j]
            };
            edges.extend(pairs.filter(same).map(|(i, j)| (i, j, siblings)));
        }
        Ok(SparseMatrix::from_triplets(self.robots(), edges)?)
    }

    fn matrix(&self, edges: Vec<(u32, u32, f64)>) -> Result<SparseMatrix, SystemError> {
        let edges = edges.into_iter().map(|(i, j, weight)| (i as usize, j as usize, weight));
        Ok(SparseMatrix::from_triplets(self.robots(), edges)?)
    }
}

/// What a distance is worth, where the two robots are measured by `scale_m`.
fn weight(settings: &SpatialSettings, metres: f64, scale_m: f64) -> f64 {
    let longest = settings.radius_m.unwrap_or(f64::INFINITY);
    if metres > longest {
        return 0.0;
    }
    match settings.kernel {
        SpatialKernel::Gaussian => (-0.5 * (metres / (settings.width * scale_m)).powi(2)).exp(),
        SpatialKernel::Exponential => (-metres / (settings.width * scale_m)).exp(),
        SpatialKernel::WendlandC2 => wendland_c2(metres / (settings.cutoff * scale_m).min(longest)),
    }
}

#[cfg(test)]
mod tests {
    use muster_model::settings::IngestSettings;

    use super::*;
    use crate::random_systems::planted;

    #[test]
    fn measured_distances_without_an_error_lead_to_the_graph_of_the_positions() {
        let system = planted(3, 1).0;
        for kernel in
            [SpatialKernel::Gaussian, SpatialKernel::Exponential, SpatialKernel::WendlandC2]
        {
            for scale in [SpatialScale::Fleet, SpatialScale::Robots] {
                let spatial = IngestSettings::default().spatial;
                let nearness = Nearness::Kernel(SpatialSettings { kernel, scale, ..spatial });
                let (of_positions, measured) = (
                    system.spatial(&nearness).unwrap(),
                    system.with_noise(0.0, 1).spatial(&nearness).unwrap(),
                );
                assert_eq!(of_positions.edges(), measured.edges());
                for (i, j, weight) in of_positions.triplets() {
                    assert!((measured.weight(i, j) - weight).abs() < 1e-12);
                }
            }
        }
    }

    #[test]
    fn noise_is_what_was_asked_for_and_the_same_from_both_ends() {
        let system = planted(2, 1).0;
        let noisy = system.with_noise(0.5, 7);
        for i in 0..system.robots() {
            for j in 0..i {
                let ratio = noisy.distance(i, j) / system.distance(i, j);
                assert!(
                    (0.5..=1.5).contains(&ratio) && noisy.distance(i, j) == noisy.distance(j, i)
                );
            }
        }
        assert_ne!(noisy, system.with_noise(0.5, 8));
    }
}

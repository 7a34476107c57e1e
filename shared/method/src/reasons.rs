//! Why a robot is in its team: how much each modality pulls it to each team.
//!
//! k-means puts robot r into the team whose mean row c is nearest to its own row x. As
//! ‖x − c‖² = ‖x‖² − (2 x·c − ‖c‖²) and ‖x‖² is the same for all teams, that is the team with the largest
//! *score* 2 x·c − ‖c‖². The score is split by modality without a remainder but rounding:
//!
//! S = αA*(I + S) and S V = U Σ, so that U = αA*(V + UΣ)Σ⁻¹, and likewise V = αA*ᵀ(U + VΣ)Σ⁻¹. A* is a sum
//! over the modalities and the self-loops, and so each row of \[U, V\] is a sum of one part for each of them:
//! what it would hold if its first steps were of that modality alone. Powers of the singular values and the
//! length of the row are factors of all parts alike. The *pull* of a modality to a team is 2 times the
//! product of its part with c. What the residual of the singular vectors leaves is told as `rest`.

use std::collections::BTreeMap;

use muster_model::id::Modality;
use muster_model::settings::RowScaling;
use muster_numeric::embedding::embed_powers;
use muster_numeric::matrix::{DenseMatrix, SparseMatrix};
use muster_numeric::svd::RankKSvd;

use crate::embedding::Frames;

/// How a robot is drawn to one team.
#[derive(Debug, Clone, PartialEq)]
pub struct TeamPull {
    /// The team, as the labels have it.
    pub team: usize,
    /// 2 x·c − ‖c‖²: the sum of everything below. The team with the largest one is the nearest.
    pub score: f64,
    /// The pull of each modality, by name.
    pub modalities: Vec<(Modality, f64)>,
    /// What the self-loop of the robot keeps of its row: it goes the way of the modalities.
    pub itself: f64,
    /// −‖c‖²: a team whose robots are spread out has a shorter mean row, and is dearer by less.
    pub spread: f64,
    /// What the residual of the singular vectors leaves: rounding where they are exact.
    pub rest: f64,
}

/// The parts of one row of X.
struct Parts {
    names: Vec<Modality>,
    /// Per modality, and last of the self-loop, a part of 2K entries.
    rows: Vec<Vec<f64>>,
}

/// How a robot is drawn to all teams.
#[derive(Debug, Clone, PartialEq)]
pub struct Attraction {
    /// ‖x‖²: less the score of a team, it is the squared distance to that team's mean row.
    pub length_squared: f64,
    /// How it is drawn to each team, the strongest first.
    pub pulls: Vec<TeamPull>,
}

/// The singular vectors of an embedding, and how its rows were made of them.
#[derive(Debug)]
pub struct Vectors {
    /// The leading triplets.
    pub svd: RankKSvd,
    /// The power of the singular values that columns were multiplied by.
    pub power: f64,
    /// How rows were scaled.
    pub rows: RowScaling,
}

impl Frames {
    /// How a robot is drawn to each team, the strongest first, by the graphs of the last embedding.
    ///
    /// `svd`, `power` and `rows` are those that the embedding was made of, `robot` is the place of the robot, and
    /// `labels` has the team of each robot. Empty if there was no embedding, if the robot has no row, or if the
    /// labels are not of the same robots.
    #[must_use]
    pub fn reasons(
        &self,
        svd: &RankKSvd,
        power: f64,
        rows: RowScaling,
        robot: usize,
        labels: &[Option<usize>],
    ) -> Vec<TeamPull> {
        let found = self.attractions(svd, power, rows, &[robot], labels).pop().flatten();
        found.map(|found| found.pulls).unwrap_or_default()
    }

    /// The same for several robots, none for one that has no row.
    #[must_use]
    pub fn attractions(
        &self,
        svd: &RankKSvd,
        power: f64,
        rows: RowScaling,
        robots: &[usize],
        labels: &[Option<usize>],
    ) -> Vec<Option<Attraction>> {
        let nodes = svd.u.rows();
        let last = self.last.as_ref();
        let last = last.filter(|last| last.fused.nodes() == nodes && labels.len() == nodes);
        let Some(last) = last else { return vec![None; robots.len()] };
        let embedded = embed_powers(svd, power, rows);
        let x = &embedded.x;
        let centroids = centroids(x, labels);
        let attraction = |robot: &usize| {
            let robot = *robot;
            if embedded.weak.get(robot).copied().unwrap_or(true) {
                return None;
            }
            let row = x.row(robot);
            let parts = self.parts_of(svd, last.decay.alpha, robot);
            let factors = factors(svd, power, row, robot);
            let mut pulls: Vec<TeamPull> = centroids
                .iter()
                .map(|(team, centre)| pull(*team, centre, row, &parts, &factors))
                .collect();
            pulls.sort_by(|left, right| {
                right.score.total_cmp(&left.score).then(left.team.cmp(&right.team))
            });
            Some(Attraction { length_squared: product(row, row), pulls })
        };
        robots.iter().map(attraction).collect()
    }

    /// The parts of a robot's row of \[U, V\].
    fn parts_of(&self, svd: &RankKSvd, alpha: f64, robot: usize) -> Parts {
        let mut parts = Parts { names: Vec::new(), rows: Vec::new() };
        for (name, matrix, weight) in self.fusion.parts() {
            parts.names.push(name.clone());
            parts.rows.push(part(svd, alpha * weight, edges_of(matrix, robot)));
        }
        let loops = alpha * self.fusion.self_loops();
        parts.rows.push(part(svd, loops, [(robot, 1.0, 1.0)].into_iter()));
        parts
    }
}

/// How a robot with this row is drawn to a team with this mean row.
fn pull(team: usize, centre: &[f64], row: &[f64], parts: &Parts, factors: &[f64]) -> TeamPull {
    let spread = -product(centre, centre);
    let score = 2.0 * product(row, centre) + spread;
    let pull = |part: &Vec<f64>| {
        let scaled = part.iter().zip(factors).zip(centre);
        2.0 * scaled.map(|((part, factor), centre)| part * factor * centre).sum::<f64>()
    };
    let mut pulls: Vec<f64> = parts.rows.iter().map(pull).collect();
    let itself = pulls.pop().unwrap_or(0.0);
    let rest = score - spread - itself - pulls.iter().sum::<f64>();
    let modalities = parts.names.iter().cloned().zip(pulls).collect();
    TeamPull { team, score, modalities, itself, spread, rest }
}

/// The other ends of a robot's edges, with the weight of the edge there and of the edge back.
fn edges_of(matrix: &SparseMatrix, robot: usize) -> impl Iterator<Item = (usize, f64, f64)> {
    let there = matrix.row(robot).map(|(to, weight)| (to, weight, 0.0));
    let back = matrix.triplets().filter(move |(_, to, _)| *to == robot);
    there.chain(back.map(|(from, _, weight)| (from, 0.0, weight)))
}

/// A row of αA(V + UΣ)Σ⁻¹ beside one of αAᵀ(U + VΣ)Σ⁻¹, for the edges of the row.
fn part(svd: &RankKSvd, factor: f64, edges: impl Iterator<Item = (usize, f64, f64)>) -> Vec<f64> {
    let rank = svd.rank();
    let mut part = vec![0.0; 2 * rank];
    for (other, there, back) in edges {
        let (of_u, of_v) = (svd.u.row(other), svd.v.row(other));
        for (j, sigma) in svd.sigma.iter().enumerate().filter(|(_, sigma)| **sigma > 0.0) {
            let (u, v) = (of_u[j], of_v[j]);
            part[j] += factor * there * (v / sigma + u);
            part[rank + j] += factor * back * (u / sigma + v);
        }
    }
    part
}

/// What each entry of a row of \[U, V\] was multiplied by to become that of X.
fn factors(svd: &RankKSvd, power: f64, row: &[f64], robot: usize) -> Vec<f64> {
    let rank = svd.rank();
    let of_value = |sigma: f64| {
        if power == 0.0 {
            1.0
        } else if sigma > 0.0 {
            sigma.powf(power)
        } else {
            0.0
        }
    };
    let powers: Vec<f64> = (0..2 * rank).map(|j| of_value(svd.sigma[j % rank])).collect();
    let sides = svd.u.row(robot).iter().chain(svd.v.row(robot));
    let scaled: Vec<f64> = powers.iter().zip(sides).map(|(power, side)| power * side).collect();
    let (length, wanted) = (product(&scaled, &scaled).sqrt(), product(row, row).sqrt());
    let to_length = if length > 0.0 { wanted / length } else { 0.0 };
    powers.into_iter().map(|power| power * to_length).collect()
}

/// The mean row of each team.
fn centroids(x: &DenseMatrix, labels: &[Option<usize>]) -> Vec<(usize, Vec<f64>)> {
    let mut sums: BTreeMap<usize, (f64, Vec<f64>)> = BTreeMap::new();
    for (row, label) in x.iter_rows().zip(labels) {
        let Some(team) = label else { continue };
        let (count, sum) = sums.entry(*team).or_insert_with(|| (0.0, vec![0.0; x.cols()]));
        *count += 1.0;
        sum.iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
    }
    let mean = |(team, (count, sum)): (usize, (f64, Vec<f64>))| {
        (team, sum.into_iter().map(|value| value / count).collect())
    };
    sums.into_iter().map(mean).collect()
}

fn product(left: &[f64], right: &[f64]) -> f64 {
    left.iter().zip(right).map(|(left, right)| left * right).sum()
}

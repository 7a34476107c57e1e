//! The spaces in which a division is scored.
//!
//! A silhouette in a method's own vectors rewards vectors that collapse: the division is judged where its own
//! k-means made it look best. So that methods can be compared, every division is scored in two more spaces that
//! no method has made: that of positions, and one in which every modality has the same weight.

use muster_numeric::matrix::DenseMatrix;
use muster_numeric::silhouette::silhouette;

use crate::system::System;

/// Distances of all pairs of N robots, in rows.
#[derive(Debug, Clone, PartialEq)]
pub struct Distances {
    robots: usize,
    values: Vec<f64>,
}

impl Distances {
    fn new(robots: usize, distance: impl Fn(usize, usize) -> f64) -> Self {
        let values = (0..robots * robots).map(|at| distance(at / robots, at % robots)).collect();
        Self { robots, values }
    }

    fn at(&self, i: usize, j: usize) -> f64 {
        self.values[i * self.robots + j]
    }

    /// Metres between robots.
    #[must_use]
    pub fn physical(system: &System) -> Self {
        let at = &system.positions;
        Self::new(system.robots(), |i, j| (at[i][0] - at[j][0]).hypot(at[i][1] - at[j][1]))
    }

    /// The fewest links by which a message gets from one robot to the other, whichever way; unreachable robots
    /// are as far as there are robots.
    #[must_use]
    pub fn hops(system: &System) -> Self {
        let mut near = vec![Vec::new(); system.robots()];
        for (robot, links) in system.links.iter().enumerate() {
            for &(peer, _) in links {
                near[robot].push(peer as usize);
                near[peer as usize].push(robot);
            }
        }
        Self::steps(&near)
    }

    /// The fewest orders and reports along the chain of command from one robot to the other.
    #[must_use]
    pub fn command(system: &System) -> Self {
        let mut near = vec![Vec::new(); system.robots()];
        for (robot, superior) in system.superiors.iter().enumerate() {
            if let Some(superior) = superior.map(|superior| superior as usize) {
                near[robot].push(superior);
                near[superior].push(robot);
            }
        }
        Self::steps(&near)
    }

    #[expect(clippy::cast_precision_loss, reason = "counts of robots are far below 2⁵³")]
    fn steps(near: &[Vec<usize>]) -> Self {
        let robots = near.len();
        let mut values = vec![robots as f64; robots * robots];
        for start in 0..robots {
            let row = &mut values[start * robots..(start + 1) * robots];
            row[start] = 0.0;
            let mut queue = std::collections::VecDeque::from([start]);
            while let Some(node) = queue.pop_front() {
                for &next in &near[node] {
                    if row[next] == robots as f64 && next != start {
                        row[next] = row[node] + 1.0;
                        queue.push_back(next);
                    }
                }
            }
        }
        Self { robots, values }
    }

    /// Divided by their mean over all pairs of different robots, so that units do not matter.
    #[expect(clippy::cast_precision_loss, reason = "counts of robots are far below 2⁵³")]
    fn relative(mut self) -> Self {
        let pairs = (self.robots * self.robots.saturating_sub(1)) as f64;
        let mean = self.values.iter().sum::<f64>() / pairs;
        if mean > 0.0 {
            self.values.iter_mut().for_each(|value| *value /= mean);
        }
        self
    }

    /// The common space: metres, links and steps of command, each relative to its mean, added up. Every
    /// modality has the same weight in it, and it is made of what was observed, not of any method's vectors.
    #[must_use]
    pub fn common(system: &System) -> Self {
        let parts = [Self::physical(system), Self::hops(system), Self::command(system)];
        let parts = parts.map(Self::relative);
        Self::new(system.robots(), |i, j| parts.iter().map(|part| part.at(i, j)).sum())
    }

    /// The mean silhouette of a division (Rousseeuw 1987), over those robots that have a label; a robot alone
    /// in its team counts 0. None for fewer than two teams.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "counts of robots are far below 2⁵³")]
    pub fn silhouette(&self, labels: &[Option<usize>]) -> Option<f64> {
        let teams = labels.iter().flatten().max().map_or(0, |team| team + 1);
        let mut sizes = vec![0_usize; teams];
        labels.iter().flatten().for_each(|team| sizes[*team] += 1);
        if sizes.iter().filter(|size| **size > 0).count() < 2 {
            return None;
        }
        let value = |i: usize, own: usize| {
            let mut sums = vec![0.0; teams];
            for (j, team) in labels.iter().enumerate() {
                if let Some(team) = team {
                    sums[*team] += self.at(i, j);
                }
            }
            if sizes[own] < 2 {
                return 0.0;
            }
            let a = sums[own] / (sizes[own] - 1) as f64;
            let others = (0..teams).filter(|team| *team != own && sizes[*team] > 0);
            let b =
                others.map(|team| sums[team] / sizes[team] as f64).fold(f64::INFINITY, f64::min);
            if a.max(b) > 0.0 { (b - a) / a.max(b) } else { 0.0 }
        };
        let robots = labels.iter().enumerate();
        let values: Vec<f64> = robots.filter_map(|(i, own)| Some(value(i, (*own)?))).collect();
        Some(values.iter().sum::<f64>() / values.len() as f64)
    }
}

/// Silhouettes of one division in every space; none where a space has none.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Silhouettes {
    /// In the vectors that the method has made.
    pub own: Option<f64>,
    /// Where robots stand.
    pub physical: Option<f64>,
    /// In the common space.
    pub common: Option<f64>,
}

/// The mean silhouette of a division in vectors, be they of another method; none for fewer than two teams.
#[must_use]
pub fn in_vectors(labels: &[usize], vectors: &DenseMatrix) -> Option<f64> {
    silhouette(vectors, labels).ok().map(|found| found.mean)
}

impl Silhouettes {
    /// Of a division of all robots of a system.
    #[must_use]
    pub fn of(system: &System, labels: &[usize], vectors: Option<&DenseMatrix>) -> Self {
        let all: Vec<Option<usize>> = labels.iter().map(|label| Some(*label)).collect();
        Self {
            own: vectors.and_then(|vectors| in_vectors(labels, vectors)),
            physical: Distances::physical(system).silhouette(&all),
            common: Distances::common(system).silhouette(&all),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn system() -> System {
        System {
            positions: vec![[0.0, 0.0], [1.0, 0.0], [10.0, 0.0], [11.0, 0.0]],
            links: vec![vec![(1, 1.0)], vec![], vec![(3, 0.5)], vec![]],
            superiors: vec![None, Some(0), Some(0), Some(2)],
            measured: None,
        }
    }

    #[test]
    fn distances_are_those_of_each_modality() {
        let system = system();
        assert_eq!(Distances::physical(&system).at(1, 2), 9.0);
        let hops = Distances::hops(&system);
        assert_eq!([hops.at(0, 1), hops.at(1, 0), hops.at(0, 3)], [1.0, 1.0, 4.0]);
        assert_eq!(Distances::command(&system).at(1, 3), 3.0);
    }

    #[test]
    fn the_silhouette_is_that_of_points() {
        let system = system();
        let x = DenseMatrix::from_rows(
            &system.positions.iter().map(|at| at.to_vec()).collect::<Vec<_>>(),
        );
        for labels in [[0, 0, 1, 1], [0, 1, 1, 1], [0, 1, 0, 1]] {
            let found = Silhouettes::of(&system, &labels, Some(x.as_ref().unwrap()));
            assert!((found.own.unwrap() - found.physical.unwrap()).abs() < 1e-12);
        }
        let right = Silhouettes::of(&system, &[0, 0, 1, 1], None).common.unwrap();
        assert!(
            right > 0.5 && right > Silhouettes::of(&system, &[0, 1, 0, 1], None).common.unwrap()
        );
        assert_eq!(Silhouettes::of(&system, &[0; 4], None), Silhouettes::default());
    }
}

//! The best division of a few points, by search through all of them.
//!
//! Alternating assignments and means, however often they start, may end beside the optimum where the limits of teams
//! differ; with a few robots every miss is seen. The inertia of some of the points never falls when one more comes to
//! them, so that it bounds all divisions that continue a partial one.

use super::places::Places;
use super::start::{Divided, Task};
use crate::cluster::kmeans::division::INERTIA_TIE;
use crate::linalg::matrix::DenseMatrix;

/// Most points that are searched through: beyond, the search would seldom end within its nodes.
const MAX_POINTS: usize = 10;

/// Most partial divisions that are looked at, a few milliseconds: nodes instead of time, so that a replay does the
/// same.
const MAX_NODES: usize = 1 << 15;

/// A search in depth.
struct Search<'a> {
    task: &'a Task<'a>,
    places: Places<'a>,
    /// Points in the order in which they are placed: those far from the middle first, as they decide the most.
    order: Vec<usize>,
    /// Means of the points that are placed, for each team.
    means: DenseMatrix,
    labels: Vec<u32>,
    /// Inertia that a division must be below, and the division that reached it.
    below: f64,
    best: Option<Vec<u32>>,
    nodes: usize,
    /// Prices that the missing robots of a division may have.
    shortfall: i128,
}

impl Task<'_> {
    /// `found`, or a division of less inertia in which teams keep their numbers, if the points are few and there is one.
    pub(super) fn searched(&self, found: Divided) -> Divided {
        let points = self.points.len();
        if points > MAX_POINTS {
            return found;
        }
        let mut order: Vec<usize> = (0..points).collect();
        order.sort_by(|a, b| {
            self.points.pack().squares[*b].total_cmp(&self.points.pack().squares[*a])
        });
        let mut search = Search {
            task: self,
            places: Places::empty(self.limits.rules, points),
            order,
            means: DenseMatrix::from_fn(self.teams(), self.points.x.cols(), |_, _| 0.0),
            labels: vec![0; points],
            below: found.inertia * (1.0 - INERTIA_TIE),
            best: None,
            nodes: 0,
            shortfall: found.shortfall,
        };
        search.descend(0, 0.0);
        let Some(labels) = search.best else { return found };
        let mut centroids = found.centroids;
        self.update_means(&labels, &mut centroids);
        let inertia = self.inertia(&labels, &centroids);
        let (iterations, shortfall) = (found.iterations, found.shortfall);
        Divided { labels, centroids, inertia, converged: true, iterations, shortfall }
    }
}

impl Task<'_> {
    /// Whether no exchange of the numbers of two teams would leave more points in their previous team. Where the limits of
    /// teams differ, the division of the least inertia may be one in which everybody's team has another number.
    fn keeps_numbers(&self, labels: &[u32]) -> bool {
        let teams = self.teams();
        let mut stayed = vec![0_usize; teams * teams];
        for (before, now) in self.previous.iter().zip(labels) {
            if let Some(before) = before.map(|before| before as usize)
                && before < teams
                && (*now as usize) < teams
            {
                stayed[before * teams + *now as usize] += 1;
            }
        }
        let at = |before: usize, now: usize| stayed[before * teams + now];
        (0..teams).all(|a| (0..a).all(|b| at(a, b) + at(b, a) <= at(a, a) + at(b, b)))
    }
}

impl Search<'_> {
    /// Places the points from place `depth` of the order on, after those before it have come to `inertia`.
    fn descend(&mut self, depth: usize, inertia: f64) {
        let Some(&point) = self.order.get(depth) else {
            if self.places.hold()
                && self.places.shortfall() <= self.shortfall
                && self.task.keeps_numbers(&self.labels)
            {
                self.below = inertia;
                self.best = Some(self.labels.clone());
            }
            return;
        };
        if self.places.missing() > self.order.len() - depth {
            return;
        }
        let mut children: Vec<(f64, usize)> = (0..self.places.sizes.len())
            .filter(|column| self.places.may_enter(point, *column))
            .map(|column| {
                let size = self.places.sizes[column];
                (inertia + self.task.arrival(point, column, &self.means, size), column)
            })
            .collect();
        children.sort_by(|a, b| a.0.total_cmp(&b.0));
        for (inertia, column) in children {
            if inertia >= self.below || self.nodes == MAX_NODES {
                return;
            }
            self.nodes += 1;
            let before = (column < self.means.rows()).then(|| self.means.row(column).to_vec());
            self.enter(point, column);
            self.descend(depth + 1, inertia);
            self.places.remove(point, column);
            if let Some(before) = before {
                self.means.row_mut(column).copy_from_slice(&before);
            }
        }
    }

    fn enter(&mut self, point: usize, column: usize) {
        self.labels[point] = column as u32;
        self.places.add(point, column);
        if column < self.means.rows() {
            let share = 1.0 / self.places.sizes[column] as f64;
            let row = self.task.points.x.row(point);
            for (mean, value) in self.means.row_mut(column).iter_mut().zip(row) {
                *mean += share * (value - *mean);
            }
        }
    }
}

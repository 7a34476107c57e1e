//! Moves of single points and swaps of two, as far as limits allow.
//!
//! Replacing point x by y in a team of n points with mean φ changes its inertia by
//! ‖y−φ‖² − ‖x−φ‖² − ‖x−y‖²/n. After an exact assignment the linear part of a swap is never a gain, so that only
//! points with the least loss need a look.

use super::places::Places;
use super::start::Task;
use crate::linalg::matrix::DenseMatrix;
use crate::linalg::vector::squared_distance;

/// Relative gain below which nothing moves, as rounding could make it move for ever.
const MIN_GAIN: f64 = 1e-10;

/// Points of each team that are considered for a swap with each other team.
const SWAP_CANDIDATES: usize = 8;

/// A point that could go to another column, and what that changes while centroids stay.
#[derive(Clone, Copy)]
struct Candidate {
    loss: f64,
    point: usize,
    /// What it adds to the inertia where it is.
    own: f64,
}

/// What exchanges did.
pub(super) struct Exchanged {
    pub(super) passes: usize,
    /// True if any point moved.
    pub(super) moved: bool,
    /// True when a pass without moves was reached.
    pub(super) settled: bool,
}

/// A swap and what it changes.
struct Swap {
    change: f64,
    points: [usize; 2],
}

impl Task<'_> {
    /// Moves and swaps points while that lowers the inertia by more than the share `hysteresis` of what the points add
    /// where they are.
    pub(super) fn exchange(
        &self,
        labels: &mut [u32],
        centroids: &mut DenseMatrix,
        hysteresis: f64,
    ) -> Exchanged {
        let keep = 1.0 - hysteresis.max(MIN_GAIN);
        let mut places = Places::new(self.limits.rules, labels);
        let mut any = false;
        for pass in 1..=self.options.max_iterations {
            let moved = self.move_points(labels, centroids, &mut places, keep);
            let swapped = self.swap_points(labels, centroids, &mut places, keep);
            if !moved && !swapped {
                return Exchanged { passes: pass, moved: any, settled: true };
            }
            self.update_means(labels, centroids);
            any = true;
        }
        Exchanged { passes: self.options.max_iterations, moved: any, settled: false }
    }

    /// What a point adds to the inertia when it comes.
    pub(super) fn arrival(
        &self,
        point: usize,
        column: usize,
        centroids: &DenseMatrix,
        size: usize,
    ) -> f64 {
        let cost = self.cost(point, column, centroids);
        let size = size as f64;
        if column < self.teams() { cost * size / (size + 1.0) } else { cost }
    }

    /// What a point takes away when it leaves; 0 for a single one, which stays.
    fn departure(&self, point: usize, column: usize, centroids: &DenseMatrix, size: usize) -> f64 {
        let cost = self.cost(point, column, centroids);
        match size {
            _ if column >= self.teams() => cost,
            0 | 1 => 0.0,
            size => cost * size as f64 / (size as f64 - 1.0),
        }
    }

    fn move_points(
        &self,
        labels: &mut [u32],
        centroids: &mut DenseMatrix,
        places: &mut Places<'_>,
        keep: f64,
    ) -> bool {
        let mut moved = false;
        for (point, label) in labels.iter_mut().enumerate() {
            let from = *label as usize;
            if !places.may_leave(point, from) {
                continue;
            }
            let saved = keep * self.departure(point, from, centroids, places.sizes[from]);
            let mut best = (from, saved);
            for to in (0..places.sizes.len()).filter(|to| *to != from) {
                let cost = self.arrival(point, to, centroids, places.sizes[to]);
                if cost < best.1 && places.may_enter(point, to) {
                    best = (to, cost);
                }
            }
            if best.0 != from {
                self.follow(point, from, best.0, centroids, places);
                *label = best.0 as u32;
                moved = true;
            }
        }
        moved
    }

    /// Moves the means and counts with a point.
    fn follow(
        &self,
        point: usize,
        from: usize,
        to: usize,
        centroids: &mut DenseMatrix,
        places: &mut Places<'_>,
    ) {
        places.transfer(point, from, to);
        let row = self.points.x.row(point);
        for (column, sign) in [(from, -1.0), (to, 1.0)] {
            let size = places.sizes[column];
            if column < self.teams() && size > 0 {
                let share = sign / size as f64;
                for (mean, value) in centroids.row_mut(column).iter_mut().zip(row) {
                    *mean += share * (value - *mean);
                }
            }
        }
    }

    /// The points of every column with the least loss in every other one, columns × columns; none for two columns of
    /// which neither is tight.
    fn candidates(
        &self,
        labels: &[u32],
        centroids: &DenseMatrix,
        places: &Places<'_>,
    ) -> Vec<Vec<Candidate>> {
        let columns = places.sizes.len();
        let mut lists: Vec<Vec<Candidate>> = vec![Vec::new(); columns * columns];
        let tight: Vec<bool> = (0..columns).map(|column| places.is_tight(column)).collect();
        if !tight.contains(&true) {
            return lists;
        }
        for (point, label) in labels.iter().enumerate() {
            let from = *label as usize;
            let own = self.cost(point, from, centroids);
            for to in (0..columns).filter(|to| *to != from && (tight[from] || tight[*to])) {
                let loss = self.cost(point, to, centroids) - own;
                let list = &mut lists[from * columns + to];
                let full = list.len() == SWAP_CANDIDATES;
                if full && list.last().is_some_and(|last| last.loss <= loss) {
                    continue;
                }
                if places.admits(point, to) {
                    if full {
                        list.pop();
                    }
                    let at = list.partition_point(|other| other.loss <= loss);
                    list.insert(at, Candidate { loss, point, own });
                }
            }
        }
        lists
    }

    fn swap_points(
        &self,
        labels: &mut [u32],
        centroids: &mut DenseMatrix,
        places: &mut Places<'_>,
        keep: f64,
    ) -> bool {
        let columns = places.sizes.len();
        let lists = self.candidates(labels, centroids, places);
        // Losses hold for teams that did not change in this pass only.
        let mut changed = vec![false; columns];
        for a in 0..columns {
            for b in a + 1..columns {
                if changed[a] || changed[b] {
                    continue;
                }
                let sides = [&lists[a * columns + b][..], &lists[b * columns + a][..]];
                let Some(Swap { points: [x, y], .. }) = self.best_swap(sides, [a, b], places, keep)
                else {
                    continue;
                };
                self.follow(x, a, b, centroids, places);
                self.follow(y, b, a, centroids, places);
                (labels[x], labels[y]) = (b as u32, a as u32);
                (changed[a], changed[b]) = (true, true);
            }
        }
        changed.contains(&true)
    }

    /// The swap of two columns that gains the most, if one gains.
    fn best_swap(
        &self,
        sides: [&[Candidate]; 2],
        [a, b]: [usize; 2],
        places: &Places<'_>,
        keep: f64,
    ) -> Option<Swap> {
        let share = |column: usize| {
            if column < self.teams() { 1.0 / places.sizes[column].max(1) as f64 } else { 0.0 }
        };
        let weight = share(a) + share(b);
        let mut best: Option<Swap> = None;
        for first in sides[0] {
            for second in sides[1] {
                let points = [first.point, second.point];
                let [x, y] = points.map(|point| self.points.x.row(point));
                let change = first.loss + second.loss - weight * squared_distance(x, y);
                let needed = (1.0 - keep) * (first.own + second.own);
                let better = best.as_ref().is_none_or(|swap| change < swap.change);
                if change < -needed && better && places.may_swap(points, [a, b]) {
                    best = Some(Swap { change, points });
                }
            }
        }
        best
    }
}

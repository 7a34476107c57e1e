//! The two main directions of the embedding, so that it can be drawn.
//!
//! Orthogonal iteration on the covariance, begun from the directions before: the picture neither flips nor turns from
//! frame to frame, as the axes of a decomposition made again would.

use muster_model::embedding::Embedding;
use muster_model::settings::MAX_DIMENSION;

/// Most rows that the covariance is made of; of larger fleets, every n-th. Directions of ten thousand points do not
/// change with more of them.
const MAX_ROWS: usize = 10_000;

/// Steps of the iteration. From the directions before, few are needed; from nothing, this many separate directions
/// whose spreads differ by a tenth.
const STEPS: usize = 60;

/// Two directions in the space of the vectors.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Axes {
    axes: [Vec<f64>; 2],
}

fn dot(left: &[f64], right: &[f64]) -> f64 {
    left.iter().zip(right).map(|(l, r)| l * r).sum()
}

/// Takes `from`'s part out of a vector and makes its length 1; false if nothing is left of it.
fn orthonormalize(vector: &mut [f64], from: Option<&[f64]>) -> bool {
    if let Some(from) = from {
        let part = dot(vector, from);
        vector.iter_mut().zip(from).for_each(|(value, other)| *value -= part * other);
    }
    let length = dot(vector, vector).sqrt();
    if length < 1e-12 || !length.is_finite() {
        return false;
    }
    vector.iter_mut().for_each(|value| *value /= length);
    true
}

impl Axes {
    /// Follows an embedding, and returns the place of each of its robots in the order of the embedding; none for a robot
    /// without a vector, and none for any where the vectors are longer than an embedding may have them.
    pub(super) fn project(&mut self, embedding: &Embedding) -> Vec<Option<[f64; 2]>> {
        let dimension = embedding.dimension as usize;
        let seen = |row: &usize| !embedding.without_embedding[*row];
        // The covariance grows with the square of a number that came over the bus.
        if dimension == 0 || embedding.dimension > MAX_DIMENSION {
            return vec![None; embedding.robots.len()];
        }
        let rows: Vec<usize> = (0..embedding.robots.len()).filter(seen).collect();
        let row = |number: usize| &embedding.values[number * dimension..(number + 1) * dimension];
        let stride = rows.len().div_ceil(MAX_ROWS).max(1);
        let sample: Vec<&[f64]> = rows.iter().step_by(stride).map(|number| row(*number)).collect();
        #[expect(clippy::cast_precision_loss, reason = "a fleet has far fewer robots than that")]
        let count = sample.len().max(1) as f64;
        let mut mean = vec![0.0; dimension];
        for vector in &sample {
            mean.iter_mut().zip(*vector).for_each(|(sum, value)| *sum += value / count);
        }
        let mut covariance = vec![0.0; dimension * dimension];
        for vector in &sample {
            for first in 0..dimension {
                let left = (vector[first] - mean[first]) / count;
                for second in 0..dimension {
                    covariance[first * dimension + second] +=
                        left * (vector[second] - mean[second]);
                }
            }
        }
        let is_flat = self.turn(&covariance, dimension);
        let place = |number: usize| {
            let centred: Vec<f64> = row(number).iter().zip(&mean).map(|(v, m)| v - m).collect();
            let [first, second] = [0, 1].map(|axis| dot(&centred, &self.axes[axis]));
            [first, if is_flat { 0.0 } else { second }]
        };
        (0..embedding.robots.len()).map(|number| seen(&number).then(|| place(number))).collect()
    }

    /// Turns the axes towards the two widest directions; true if there is no second one, as the vectors lie on a line.
    fn turn(&mut self, covariance: &[f64], dimension: usize) -> bool {
        // Unequal numbers, so that the start is orthogonal to no direction.
        #[expect(clippy::cast_precision_loss, reason = "dimensions are small")]
        let begin =
            |shift: usize| (0..dimension).map(|at| ((at * 2 + shift) as f64).sin()).collect();
        if self.axes[0].len() != dimension {
            self.axes = [begin(1), begin(2)];
        }
        let apply = |vector: &[f64]| -> Vec<f64> {
            covariance.chunks(dimension).map(|line| dot(line, vector)).collect()
        };
        for _ in 0..STEPS {
            let [mut first, mut second] = [apply(&self.axes[0]), apply(&self.axes[1])];
            if !orthonormalize(&mut first, None) {
                break;
            }
            let is_flat = !orthonormalize(&mut second, Some(&first));
            self.axes[0] = first;
            if is_flat {
                // Nothing grows out of zeros, nor out of the first axis: later vectors may have a second direction.
                self.axes[1] = begin(2);
                return true;
            }
            self.axes[1] = second;
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testkit;

    #[test]
    fn the_widest_direction_comes_first_and_stays_where_it_is() {
        let rows: Vec<[f64; 3]> = (0..50)
            .map(|at| {
                let at = f64::from(at);
                [0.1 * (at * 0.7).sin(), 5.0 * (at * 0.3).cos(), 1.0 * (at * 1.1).sin()]
            })
            .collect();
        let mut embedding = testkit::embedding(&rows);
        embedding.without_embedding[3] = true;
        let mut axes = Axes::default();
        let first = axes.project(&embedding);
        assert_eq!(first.len(), 50);
        assert_eq!(first[3], None);
        let spread = |axis: usize, all: &[Option<[f64; 2]>]| -> f64 {
            all.iter().flatten().map(|place| place[axis] * place[axis]).sum()
        };
        assert!(spread(0, &first) > 5.0 * spread(1, &first));
        assert!(axes.axes[0][1].abs() > 0.99, "{:?}", axes.axes);
        // The same again does not flip.
        let again = axes.project(&embedding);
        for (left, right) in first.iter().flatten().zip(again.iter().flatten()) {
            assert!((left[0] - right[0]).abs() < 1e-6 && (left[1] - right[1]).abs() < 1e-6);
        }
    }

    #[test]
    fn vectors_on_a_line_or_in_a_point_are_drawn() {
        for rows in [vec![[1.0, 0.0], [2.0, 0.0]], vec![[1.0, 1.0]], vec![]] {
            let places = Axes::default().project(&testkit::embedding(&rows));
            assert_eq!(places.len(), rows.len());
            assert!(places.iter().flatten().flatten().all(|value| value.is_finite()));
        }
    }

    #[test]
    fn vectors_that_leave_a_line_are_drawn_in_both_directions() {
        let wave = |at: u32| f64::from(at).sin();
        let line: Vec<[f64; 4]> = (0..20).map(|at| [wave(at), 0.0, 0.0, 0.0]).collect();
        let plane: Vec<[f64; 4]> =
            (0..20).map(|at| [3.0 * wave(at), wave(7 * at), 0.0, 0.0]).collect();
        let mut axes = Axes::default();
        let second = |axes: &mut Axes, rows: &[[f64; 4]]| -> f64 {
            let places = axes.project(&testkit::embedding(rows));
            places.iter().flatten().map(|place| place[1] * place[1]).sum()
        };
        assert!(second(&mut axes, &line).abs() < 1e-12);
        let expected = second(&mut Axes::default(), &plane);
        assert!(expected > 1.0 && (second(&mut axes, &plane) - expected).abs() < 1e-6);
        // A line along the second axis, which then is the first one.
        let across: Vec<[f64; 4]> =
            (0..20).map(|at| [1e-3 * wave(at), wave(at), 0.0, 0.0]).collect();
        assert!(second(&mut axes, &across).abs() < 1e-12);
        assert!((second(&mut axes, &plane) - expected).abs() < 1e-6);
    }

    #[test]
    fn vectors_longer_than_any_embedding_has_them_are_not_drawn() {
        const LONG: usize = MAX_DIMENSION as usize + 1;
        let long = testkit::embedding(&[[0.5; LONG], [1.0; LONG]]);
        assert_eq!(Axes::default().project(&long), [None, None]);
        let mut none = testkit::embedding::<2>(&[]);
        none.dimension = u32::MAX;
        assert!(Axes::default().project(&none).is_empty());
        let longest = testkit::embedding(&[[0.5; LONG - 1], [1.0; LONG - 1]]);
        assert!(Axes::default().project(&longest).iter().all(Option::is_some));
    }
}

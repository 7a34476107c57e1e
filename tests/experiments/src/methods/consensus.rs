//! Consensus: robots that many divisions put together belong together.
//!
//! The share of divisions that put two robots together is a similarity (evidence accumulation: Fred and Jain,
//! IEEE Transactions on Pattern Analysis and Machine Intelligence 27, 2005). Its rows are divided once more.

use muster_numeric::matrix::{DenseMatrix, MatrixError};

/// The share of divisions of the same robots that put each pair together, N × N.
///
/// # Errors
/// [`MatrixError`] where the divisions are not of the same robots.
#[expect(clippy::cast_precision_loss, reason = "there are a few hundred divisions")]
pub fn together(divisions: &[Vec<usize>]) -> Result<DenseMatrix, MatrixError> {
    let robots = divisions.first().map_or(0, Vec::len);
    if let Some(other) = divisions.iter().find(|labels| labels.len() != robots) {
        return Err(MatrixError::Shape { rows: robots, cols: robots, len: other.len() });
    }
    let share = |at: usize| {
        let (i, j) = (at / robots, at % robots);
        let agreeing = divisions.iter().filter(|labels| labels[i] == labels[j]).count();
        agreeing as f64 / divisions.len() as f64
    };
    DenseMatrix::new(robots, robots, (0..robots * robots).map(share).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_count_how_often_they_are_together() {
        let found = together(&[vec![0, 0, 1], vec![0, 1, 1]]).unwrap();
        assert_eq!(found.data(), [1.0, 0.5, 0.0, 0.5, 1.0, 0.5, 0.0, 0.5, 1.0]);
        assert!(together(&[vec![0, 0, 1], vec![0, 1]]).is_err());
        assert!(together(&[]).unwrap().data().is_empty());
    }
}

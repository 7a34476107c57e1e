//! Matching of new clusters to old ones, so that identities survive a new division.
//!
//! The assignment problem is solved by the Hungarian method (Kuhn 1955, Munkres 1957).

use pathfinding::matrix::Matrix;
use pathfinding::prelude::kuhn_munkres;
use thiserror::Error;

/// Largest number of clusters on either side; the method takes cubic time.
pub const MAX_CLUSTERS: usize = 1 << 12;

/// Larger overlaps count as this many nodes, so that weights fit their integer type.
const MAX_OVERLAP: u64 = 1 << 40;

/// Why clusters could not be matched.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum MatchError {
    /// The rows of the table have different lengths.
    #[error("row {row} of the overlap table has {found} columns instead of {expected}")]
    Ragged {
        /// The odd row.
        row: usize,
        /// Columns of the first row.
        expected: usize,
        /// Columns of this row.
        found: usize,
    },
    /// There are more than [`MAX_CLUSTERS`] clusters.
    #[error("{clusters} clusters are too many to match")]
    TooMany {
        /// Number of clusters on the larger side.
        clusters: usize,
    },
    /// New and old labels do not describe the same nodes.
    #[error("{new} new labels but {old} old ones")]
    Labels {
        /// Number of new labels.
        new: usize,
        /// Number of old labels.
        old: usize,
    },
    /// A label is not below the number of clusters.
    #[error("label {label} is not below {clusters}")]
    Label {
        /// The label.
        label: usize,
        /// Number of clusters on its side.
        clusters: usize,
    },
}

/// Counts of nodes per new cluster (rows) and old cluster (columns).
///
/// `new[i]` and `old[i]` are the labels of node i; `old[i]` is `None` for a node that was not
/// there, or in no cluster.
///
/// # Errors
/// [`MatchError::Labels`], [`MatchError::Label`] and [`MatchError::TooMany`].
pub fn overlap_table(
    new: &[usize],
    new_clusters: usize,
    old: &[Option<usize>],
    old_clusters: usize,
) -> Result<Vec<Vec<u64>>, MatchError> {
    if new.len() != old.len() {
        return Err(MatchError::Labels { new: new.len(), old: old.len() });
    }
    check_count(new_clusters.max(old_clusters))?;
    let mut table = vec![vec![0; old_clusters]; new_clusters];
    for (&label, &before) in new.iter().zip(old) {
        let row =
            table.get_mut(label).ok_or(MatchError::Label { label, clusters: new_clusters })?;
        if let Some(before) = before {
            let cell = row
                .get_mut(before)
                .ok_or(MatchError::Label { label: before, clusters: old_clusters })?;
            *cell += 1;
        }
    }
    Ok(table)
}

/// For each new cluster the old cluster whose identity it inherits, or `None`.
///
/// `overlap[a][b]` counts the nodes that new cluster a shares with old cluster b; the table may
/// be rectangular. Every old cluster is given at most once, only where there is overlap, and so
/// that the total overlap is largest. Among equal totals more matches win, then those that keep
/// the order of the indices.
///
/// # Errors
/// [`MatchError::Ragged`] and [`MatchError::TooMany`].
pub fn match_by_overlap(overlap: &[Vec<u64>]) -> Result<Vec<Option<usize>>, MatchError> {
    let rows = overlap.len();
    let cols = overlap.first().map_or(0, Vec::len);
    if let Some(row) = overlap.iter().position(|r| r.len() != cols) {
        return Err(MatchError::Ragged { row, expected: cols, found: overlap[row].len() });
    }
    check_count(rows.max(cols))?;
    if rows == 0 || cols == 0 {
        return Ok(vec![None; rows]);
    }
    // The method needs at least as many columns as rows.
    let flipped = rows > cols;
    let (m, n) = (rows.min(cols), rows.max(cols));
    let weights = Matrix::from_fn(m, n, |(i, j)| {
        let (a, b) = if flipped { (j, i) } else { (i, j) };
        score(overlap[a][b], a, b, n)
    });
    let (_, assigned) = kuhn_munkres(&weights);

    let mut matched = vec![None; rows];
    for (i, j) in assigned.into_iter().enumerate() {
        let (a, b) = if flipped { (j, i) } else { (i, j) };
        if overlap[a][b] > 0 {
            matched[a] = Some(b);
        }
    }
    Ok(matched)
}

/// Weight of a match: overlap first, then a bonus per match, then closeness of the indices. All of
/// a lower level together cannot outweigh one unit of the level above.
fn score(overlap: u64, a: usize, b: usize, n: usize) -> i128 {
    if overlap == 0 {
        return 0;
    }
    let n = n as i128;
    // The squared distance favours pairs in ascending order, by the rearrangement inequality.
    let near = n * n - (a.abs_diff(b) as i128).pow(2);
    let bonus = n * n * n + 1;
    i128::from(overlap.min(MAX_OVERLAP)) * bonus * (n + 2) + bonus + near
}

fn check_count(clusters: usize) -> Result<(), MatchError> {
    if clusters > MAX_CLUSTERS {
        return Err(MatchError::TooMany { clusters });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::{MatchError, match_by_overlap, overlap_table};

    #[test]
    fn total_overlap_beats_the_greedy_choice() {
        let table = [vec![5, 4], vec![4, 0]];
        assert_eq!(match_by_overlap(&table).unwrap(), [Some(1), Some(0)]);
    }

    #[test]
    fn rectangular_and_empty_tables() {
        assert_eq!(match_by_overlap(&[]).unwrap(), []);
        assert_eq!(match_by_overlap(&[vec![], vec![]]).unwrap(), [None, None]);
        let split = [vec![3], vec![4], vec![0]];
        assert_eq!(match_by_overlap(&split).unwrap(), [None, Some(0), None]);
        assert_eq!(match_by_overlap(&[vec![0, 2, 7]]).unwrap(), [Some(2)]);
        assert_eq!(match_by_overlap(&[vec![0, 0]]).unwrap(), [None]);
    }

    #[test]
    fn ties_prefer_smaller_indices() {
        assert_eq!(match_by_overlap(&[vec![2, 2], vec![2, 2]]).unwrap(), [Some(0), Some(1)]);
        assert_eq!(match_by_overlap(&[vec![2, 2, 2]]).unwrap(), [Some(0)]);
        assert_eq!(match_by_overlap(&[vec![1], vec![1]]).unwrap(), [Some(0), None]);
        // Two matches of one node each beat one match of two.
        let more = [vec![2, 1], vec![1, 0]];
        assert_eq!(match_by_overlap(&more).unwrap(), [Some(1), Some(0)]);
    }

    #[test]
    fn optimal_among_all_assignments() {
        let mut state = 7_u64;
        for _ in 0..50 {
            let mut next = || {
                state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                (state >> 33) % 6
            };
            let table: Vec<Vec<u64>> = (0..4).map(|_| (0..5).map(|_| next()).collect()).collect();
            let found = match_by_overlap(&table).unwrap();
            let total: u64 = found.iter().zip(&table).filter_map(|(m, r)| m.map(|j| r[j])).sum();
            assert_eq!(total, best(&table, &mut [false; 5]));
        }
    }

    fn best(rows: &[Vec<u64>], used: &mut [bool]) -> u64 {
        let Some((first, rest)) = rows.split_first() else { return 0 };
        let mut top = best(rest, used);
        for j in 0..used.len() {
            if !used[j] {
                used[j] = true;
                top = top.max(first[j] + best(rest, used));
                used[j] = false;
            }
        }
        top
    }

    #[test]
    fn counts_and_errors() {
        let table = overlap_table(&[0, 0, 1, 1], 2, &[Some(1), None, Some(0), Some(0)], 2).unwrap();
        assert_eq!(table, [vec![0, 1], vec![2, 0]]);
        assert!(matches!(overlap_table(&[0], 1, &[], 1), Err(MatchError::Labels { .. })));
        assert!(matches!(overlap_table(&[3], 1, &[None], 1), Err(MatchError::Label { .. })));
        assert!(matches!(overlap_table(&[0], 1, &[Some(9)], 1), Err(MatchError::Label { .. })));
        let ragged = [vec![1], vec![1, 2]];
        assert!(matches!(match_by_overlap(&ragged), Err(MatchError::Ragged { .. })));
        assert!(matches!(match_by_overlap(&[vec![0; 20_000]]), Err(MatchError::TooMany { .. })));
    }
}

//! The elimination tree of a sparse matrix: what a factorisation without exchanges fills in.

/// No node.
pub(crate) const NONE: u32 = u32::MAX;

/// The parent of each node in the elimination tree of a symmetric pattern, and the starts of the
/// columns of its factor; `None` where these have more than `most` entries together (Liu, SIAM J. Matrix
/// Anal. 11, 1990). `neighbours` gives those of a node, in any order and with repetitions.
pub(crate) fn elimination_tree<I: Iterator<Item = usize>>(
    n: usize,
    most: usize,
    neighbours: impl Fn(usize) -> I,
) -> Option<(Vec<u32>, Vec<usize>)> {
    let (mut parents, mut seen) = (vec![NONE; n], vec![NONE; n]);
    let mut starts = vec![0; n + 1];
    let mut entries = 0;
    for k in 0..n {
        seen[k] = k as u32;
        for j in neighbours(k).filter(|j| *j < k) {
            let mut j = j;
            while seen[j] != k as u32 {
                if parents[j] == NONE {
                    parents[j] = k as u32;
                }
                seen[j] = k as u32;
                starts[j + 1] += 1;
                entries += 1;
                j = parents[j] as usize;
            }
        }
        if entries > most {
            return None;
        }
    }
    for j in 0..n {
        starts[j + 1] += starts[j];
    }
    Some((parents, starts))
}

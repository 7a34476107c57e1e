//! The settings that are tried.

use std::collections::BTreeMap;

use muster_method::{Frame, Graph};
use muster_model::id::Modality;
use muster_model::settings::{Alpha, Dimension, EmbedderSettings, MAX_DIMENSION};

/// Decays that are tried, as shares of 1/ρ.
const FRACTIONS: [f64; 5] = [0.3, 0.45, 0.6, 0.75, 0.9];

/// Dimensions that are tried besides `auto`, as multiples of the number of teams.
const DIMENSIONS: [usize; 2] = [2, 4];

/// Most ways to share out the weights: with more, a search would take minutes.
const MAX_WEIGHTS: usize = 300;

/// All settings of the grid: those in force with other weights, another decay and another dimension.
pub(super) fn settings(
    present: &EmbedderSettings,
    frame: &Frame,
    teams: usize,
    parts: u32,
) -> Vec<EmbedderSettings> {
    let has_edges = |graph: &Graph| match graph {
        Graph::Matrix(matrix) => !matrix.is_zero(),
        Graph::Replica(_) => true,
    };
    let related = frame.graphs.iter().filter(|(_, graph)| has_edges(graph));
    let modalities: Vec<&Modality> = related.map(|(name, _)| name).collect();
    let robots = frame.robots.len();
    let dimensions = DIMENSIONS.map(|times| times * teams);
    let dimensions = dimensions.into_iter().filter(|length| *length <= 2 * robots);
    let dimensions = dimensions.filter_map(|length| u32::try_from(length).ok());
    let dimensions: Vec<Dimension> = std::iter::once(Dimension::Auto)
        .chain(dimensions.filter(|length| *length <= MAX_DIMENSION).map(Dimension::Fixed))
        .collect();
    let mut all = Vec::new();
    for shares in shared_out(modalities.len(), parts) {
        let weights: BTreeMap<Modality, f64> =
            modalities.iter().map(|name| (*name).clone()).zip(shares).collect();
        for fraction in FRACTIONS {
            for dimension in &dimensions {
                let (alpha, dimension) = (Alpha::Fraction { fraction }, *dimension);
                let weights = weights.clone();
                all.push(EmbedderSettings { weights, alpha, dimension, ..present.clone() });
            }
        }
    }
    all
}

/// All ways to share out 1 among so many in so many equal parts, or in fewer where these are too many. Each has a
/// part at least: a division that looks at one modality alone has fine silhouettes, and is as good as that one.
fn shared_out(among: usize, parts: u32) -> Vec<Vec<f64>> {
    let least = u32::try_from(among).unwrap_or(u32::MAX);
    let mut spare = parts.saturating_sub(least);
    while spare > 1 && ways(among, spare) > MAX_WEIGHTS {
        spare -= 1;
    }
    let mut all = vec![Vec::new()];
    for place in 0..among {
        let mut longer = Vec::new();
        for shares in all {
            let given: u32 = shares.iter().sum();
            let rest = spare - given;
            let least = if place + 1 == among { rest } else { 0 };
            longer.extend((least..=rest).map(|share| [&shares[..], &[share]].concat()));
        }
        all = longer;
    }
    let share = |part: u32| f64::from(part + 1) / f64::from(spare + least);
    all.into_iter().map(|shares| shares.into_iter().map(share).collect()).collect()
}

/// In how many ways so many parts can be shared out: the number of multisets.
fn ways(among: usize, parts: u32) -> usize {
    (1..=parts as usize)
        .fold(1_usize, |ways, part| ways.saturating_mul(among.saturating_sub(1) + part) / part)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_shared_out_in_all_ways() {
        let three = shared_out(3, 6);
        assert_eq!((three.len(), ways(3, 3)), (10, 10));
        assert!(three.iter().all(|shares| (shares.iter().sum::<f64>() - 1.0).abs() < 1e-12));
        assert!(three.iter().flatten().all(|share| *share >= 1.0 / 6.0));
        assert!(three.contains(&vec![4.0 / 6.0, 1.0 / 6.0, 1.0 / 6.0]));
        assert_eq!(shared_out(1, 6), [[1.0]]);
        assert_eq!(shared_out(2, 1), [[0.5, 0.5]]);
        assert_eq!(shared_out(2, 3).len(), 2);
        for among in [4, 10, 19] {
            let found = shared_out(among, 20).len();
            assert!((1..=MAX_WEIGHTS).contains(&found), "{found}");
        }
    }
}

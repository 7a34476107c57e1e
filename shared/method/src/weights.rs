//! The weight of each modality.

use std::collections::BTreeMap;

use muster_model::id::Modality;
use muster_model::settings::default_weight;

use crate::error::MethodError;
use crate::graph::Frame;

/// The weight of each graph of a frame, in its order.
///
/// An empty `set` means the default weights, by the share of the robots that each modality relates, divided
/// by their sum. Weights of modalities that the frame does not have, or that have no edge in it, are shared out
/// among the others, in proportion.
///
/// # Errors
/// [`MethodError::Weightless`] where no modality of the frame has a weight.
pub fn weights(set: &BTreeMap<Modality, f64>, frame: &Frame) -> Result<Vec<f64>, MethodError> {
    let robots = frame.robots.len();
    let related: Vec<f64> =
        frame.graphs.iter().map(|(_, graph)| graph.related_share(robots)).collect();
    let nothing = related.iter().all(|related| *related <= 0.0);
    // A graph without edges has no weight where others have some: self-loops are measured by the sum.
    let is_used = |related: f64| nothing || related > 0.0;
    let graphs = || frame.graphs.iter().zip(&related);
    if set.is_empty() {
        let weight = |((name, _), related): (&(Modality, crate::Graph), &f64)| {
            if is_used(*related) { default_weight(name, *related) } else { 0.0 }
        };
        let weights: Vec<f64> = graphs().map(weight).collect();
        let sum: f64 = weights.iter().sum();
        return Ok(weights.into_iter().map(|weight| weight / sum).collect());
    }
    let set_of = |name: &Modality| set.get(name).copied().unwrap_or(0.0);
    let all: Vec<f64> = graphs().map(|((name, _), _)| set_of(name)).collect();
    if all.iter().sum::<f64>() <= 0.0 && !all.is_empty() {
        // Without robots there is nothing to weigh, and the empty division is still wanted.
        if frame.robots.is_empty() {
            return Ok(all);
        }
        let names: Vec<_> = frame.graphs.iter().map(|(name, _)| name.as_str()).collect();
        return Err(MethodError::Weightless { modalities: names.join(", ") });
    }
    let used = all.iter().zip(&related);
    let used: Vec<f64> =
        used.map(|(weight, related)| if is_used(*related) { *weight } else { 0.0 }).collect();
    // Where all graphs that have a weight are empty, nothing is divided in any case.
    let weights = if used.iter().sum::<f64>() > 0.0 { used } else { all };
    // Where nothing is missing, the weights stay as the operator wrote them.
    let positive = |weights: &mut dyn Iterator<Item = f64>| weights.filter(|w| *w > 0.0).count();
    if positive(&mut weights.iter().copied()) == positive(&mut set.values().copied()) {
        return Ok(weights);
    }
    let present: f64 = weights.iter().sum();
    Ok(weights.into_iter().map(|weight| weight / present).collect())
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use muster_model::id::RobotId;
    use muster_numeric::matrix::SparseMatrix;

    use super::*;
    use crate::graph::Graph;

    /// A frame of ten robots, of which so many are related by each modality.
    fn frame(modalities: &[(&str, usize)]) -> Frame {
        let robots = (0..10).map(|i| RobotId::new(format!("r{i}")).unwrap()).collect();
        let graph = |(name, related): &(&str, usize)| {
            let edges = (1..*related).map(|i| (0, i, 1.0));
            let matrix = SparseMatrix::from_triplets(10, edges).unwrap();
            (Modality::new(*name).unwrap(), Graph::Matrix(Arc::new(matrix)))
        };
        Frame { robots, graphs: modalities.iter().map(graph).collect() }
    }

    fn weighed(set: &[(&str, f64)], fleet: &[&str]) -> Result<Vec<f64>, MethodError> {
        let set = set.iter().map(|(text, weight)| (Modality::new(*text).unwrap(), *weight));
        let fleet: Vec<_> = fleet.iter().map(|name| (*name, 10)).collect();
        weights(&set.collect(), &frame(&fleet))
    }

    #[test]
    fn modalities_that_relate_few_weigh_little() {
        // One edge relates two of ten robots, two fifths of what counts as a whole modality.
        let found =
            weights(&BTreeMap::new(), &frame(&[("hierarchy", 2), ("spatial", 10)])).unwrap();
        let hierarchy = 0.6 * 0.4;
        let sum = hierarchy + 0.35;
        assert!((found[0] - hierarchy / sum).abs() < 1e-15);
        assert!((found[1] - 0.35 / sum).abs() < 1e-15);
    }

    #[test]
    fn weights_are_the_defaults_unless_set() {
        assert_eq!(weighed(&[], &["a", "b"]), Ok(vec![0.5, 0.5]));
        assert_eq!(weighed(&[], &[]), Ok(vec![]));
        let three = weighed(&[], &["connectivity", "hierarchy", "spatial"]).unwrap();
        for (found, wanted) in three.iter().zip([0.05, 0.6, 0.35]) {
            assert!((found - wanted).abs() < 1e-15, "{three:?}");
        }
        let more = weighed(&[], &["connectivity", "hierarchy", "leash", "spatial"]).unwrap();
        assert!((more[2] - 0.25).abs() < 1e-15, "{more:?}");
        assert_eq!(weighed(&[("a", 0.3), ("b", 0.7)], &["a", "b", "c"]), Ok(vec![0.3, 0.7, 0.0]));
    }

    #[test]
    fn weights_of_modalities_that_the_fleet_lacks_are_shared_out() {
        let set = [("a", 0.25), ("b", 0.25), ("c", 0.5)];
        assert_eq!(weighed(&set, &["a", "b"]), Ok(vec![0.5, 0.5]));
        assert!(matches!(weighed(&[("c", 1.0)], &["a"]), Err(MethodError::Weightless { .. })));
    }

    #[test]
    fn no_robots_need_no_weights() {
        let empty = Frame { robots: Arc::default(), ..frame(&[("a", 0)]) };
        let set = BTreeMap::from([(Modality::new("c").unwrap(), 1.0)]);
        assert_eq!(weights(&set, &empty), Ok(vec![0.0]));
    }
}

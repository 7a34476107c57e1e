//! The scenes of links: the strongest of one modality, as lines between the robots that they join.

use std::collections::BTreeMap;
use std::sync::Arc;

use muster_model::graph::{GraphDelta, Node};
use muster_model::header::Revision;
use muster_model::id::Modality;

use super::fleet::{Fleet, frame_of};
use super::limits::{LINK_STEPS, MAX_LINKS};
use super::scene::{Color, Entity, LineKind, Lines};

/// Width of a link in pixels.
const LINK_PX: f64 = 1.5;

/// Opacity of the weakest link.
const LEAST_OPACITY: f64 = 0.15;

/// Links of one modality, as they were chosen from its graph.
#[derive(Debug)]
pub(super) struct Links {
    /// The revision of the graph, whose term says which nodes are meant.
    revision: Revision,
    /// From, to, and the step of opacity.
    edges: Vec<(Node, Node, usize)>,
}

impl Links {
    /// The strongest links of a snapshot.
    pub(super) fn of(graph: &Arc<GraphDelta>) -> Self {
        let rows = graph.rows.iter();
        let edges =
            rows.flat_map(|row| row.edges.iter().map(|(to, weight)| (row.source, *to, *weight)));
        let mut edges: Vec<(Node, Node, f64)> = edges.collect();
        if edges.len() > MAX_LINKS {
            edges.select_nth_unstable_by(MAX_LINKS, |left, right| right.2.total_cmp(&left.2));
            edges.truncate(MAX_LINKS);
        }
        let most = edges.iter().fold(0.0, |most: f64, edge| most.max(edge.2));
        let step = |weight: f64| {
            let share = if most > 0.0 { weight / most } else { 1.0 };
            // A share is at most 1; the cast of what is no number gives 0.
            ((share * LINK_STEPS as f64) as usize).min(LINK_STEPS - 1)
        };
        let edges = edges.into_iter().map(|(from, to, weight)| (from, to, step(weight)));
        Self { revision: graph.header.revision, edges: edges.collect() }
    }

    /// The entities of the links, where the robots are now. There are none while the graph is of another term than the
    /// roster, as its nodes are other robots.
    pub(super) fn entities(&self, modality: &Modality, fleet: &Fleet) -> Vec<Entity> {
        let Some(roster) = fleet.roster() else { return Vec::new() };
        if roster.header.revision.term != self.revision.term {
            return Vec::new();
        }
        let entries = roster.robots.iter();
        let places =
            entries.filter_map(|entry| Some((entry.node, (entry.position?, frame_of(entry)))));
        let mut places: Vec<(Node, ([f64; 3], &str))> = places.collect();
        places.sort_unstable_by_key(|(node, _)| *node);
        let place = |node: Node| {
            let at = places.binary_search_by_key(&node, |(node, _)| *node).ok()?;
            Some(places[at].1)
        };
        let mut frames: BTreeMap<&str, Vec<Vec<[f64; 3]>>> = BTreeMap::new();
        for (from, to, step) in &self.edges {
            let (Some((from, frame)), Some((to, other))) = (place(*from), place(*to)) else {
                continue;
            };
            // Positions of different frames are not comparable.
            if frame == other {
                let steps = frames.entry(frame).or_insert_with(|| vec![Vec::new(); LINK_STEPS]);
                steps[*step].extend([from, to]);
            }
        }
        let entity = |(frame, steps): (&str, Vec<Vec<[f64; 3]>>)| {
            let lines = steps.into_iter().enumerate().filter(|(_, points)| !points.is_empty());
            Entity {
                id: format!("links/{modality}@{frame}"),
                frame: frame.to_owned(),
                facts: vec![("modality", modality.to_string())],
                spheres: Vec::new(),
                lines: lines.map(|(step, points)| lines_of(step, points)).collect(),
                texts: Vec::new(),
            }
        };
        frames.into_iter().map(entity).collect()
    }
}

fn lines_of(step: usize, points: Vec<[f64; 3]>) -> Lines {
    let share = step as f64 / (LINK_STEPS - 1) as f64;
    let a = LEAST_OPACITY + (1.0 - LEAST_OPACITY) * share;
    let color = Color { r: 0.8, g: 0.85, b: 0.95, a };
    Lines { kind: LineKind::Pairs, points, width: LINK_PX, color }
}

//! Raw observations to one graph per modality, by the same rules as in the live fleet.

use std::collections::HashMap;

use muster_model::id::{Modality, RobotId};
use muster_model::object::Object;
use muster_model::observation::{Link, Observation, Pose, Rank};
use muster_model::settings::{ConnectivitySettings, IngestSettings, Settings, default_weight};
use muster_numeric::matrix::SparseMatrix;
use muster_relation::{Edge, connectivity_edges, hierarchy_edges, link_weight, spatial_edges};
use serde_json::{Map, Value};

use super::error::{SolveError, refuse};
use super::file::Named;
use super::places::{Places, place};

/// Graphs before their weights are checked: where the weight stands in the file, the modality, the
/// weight if it is given, and the matrix.
pub(super) type Graphs = Vec<(String, Modality, Option<f64>, SparseMatrix)>;

/// The three streams of a file, and the settings tables that go with them.
pub(super) struct Observations {
    pub(super) poses: Option<Named<RobotId, Object<Pose>>>,
    pub(super) links: Option<Named<RobotId, Vec<Object<Link>>>>,
    pub(super) ranks: Option<Named<RobotId, Object<Rank>>>,
    pub(super) weights: Option<Named<Modality, f64>>,
    /// The fields of the spatial settings that differ from the defaults.
    pub(super) spatial: Option<Map<String, Value>>,
    /// The same of the connectivity settings.
    pub(super) connectivity: Option<Map<String, Value>>,
    /// Whether weights that are not given are equal, instead of those of the live fleet.
    pub(super) weighs_equally: bool,
}

impl Observations {
    /// One graph per stream that is given.
    pub(super) fn into_graphs(self, places: &Places) -> Result<Graphs, SolveError> {
        let without = |stream: &str| format!("needs \"{stream}\", which is not given");
        if self.spatial.is_some() && self.poses.is_none() {
            return refuse("spatial", without("poses"));
        }
        if self.connectivity.is_some() && self.links.is_none() {
            return refuse("connectivity", without("links"));
        }
        let settings = settings([("spatial", self.spatial), ("connectivity", self.connectivity)])?;
        let mut streams = Vec::new();
        if let Some(poses) = &self.poses {
            streams.push((Modality::spatial(), of_poses(poses, places, &settings)?));
        }
        if let Some(links) = &self.links {
            streams
                .push((Modality::connectivity(), of_links(links, places, &settings.connectivity)?));
        }
        if let Some(ranks) = &self.ranks {
            streams.push((Modality::hierarchy(), of_ranks(ranks, places)?));
        }
        let weights = self.weights;
        if let Some(Named(weights)) = &weights
            && let Some(name) = weights.keys().find(|name| streams.iter().all(|s| s.0 != **name))
        {
            let given: Vec<_> = streams.iter().map(|stream| stream.0.as_str()).collect();
            return refuse(
                format!("weights.{name}"),
                format!("is no modality of the streams in this file: {}", given.join(", ")),
            );
        }
        let graph = |(name, edges): (Modality, Vec<Edge>)| {
            // As in the live fleet, a modality that is not named among the weights has none.
            let weight = weights.as_ref().map(|named| named.0.get(&name).copied().unwrap_or(0.0));
            let path = format!("weights.{name}");
            let edges = edges.into_iter().map(|(i, j, w)| (i as usize, j as usize, w));
            match SparseMatrix::from_triplets(places.len(), edges) {
                Ok(matrix) => Ok((path, name, weight, matrix)),
                Err(error) => refuse(name.as_str(), error.to_string()),
            }
        };
        let mut graphs: Graphs = streams.into_iter().map(graph).collect::<Result<_, _>>()?;
        if weights.is_none() && !self.weighs_equally {
            // A stream without a relation would only make self-loops heavier in relation to the others.
            let has_edges = graphs.iter().any(|(.., matrix)| !matrix.is_zero());
            let default = |(_, name, _, matrix): &(_, Modality, _, SparseMatrix)| {
                if has_edges && matrix.is_zero() {
                    0.0
                } else {
                    default_weight(name, matrix.related_share())
                }
            };
            let all: Vec<f64> = graphs.iter().map(default).collect();
            let sum: f64 = all.iter().sum();
            graphs.iter_mut().zip(all).for_each(|(graph, weight)| graph.2 = Some(weight / sum));
        }
        Ok(graphs)
    }
}

/// The live defaults with the fields of the file changed.
fn settings(tables: [(&str, Option<Map<String, Value>>); 2]) -> Result<IngestSettings, SolveError> {
    let given = tables
        .into_iter()
        .filter_map(|(name, table)| Some((name.to_owned(), Value::Object(table?))));
    IngestSettings::default()
        .patched(&Value::Object(given.collect()))
        .or_else(|error| refuse(error.field, error.problem))
}

fn of_poses(
    poses: &Named<RobotId, Object<Pose>>,
    places: &Places,
    settings: &IngestSettings,
) -> Result<Vec<Edge>, SolveError> {
    // Robots without a pose are not placed, which is what a position that is no number means.
    let mut positions = vec![[f64::NAN; 3]; places.len()];
    let mut common: Option<&str> = None;
    for (robot, Object(pose)) in &poses.0 {
        let at = place(places, robot, || format!("poses.{robot}"))?;
        if let Err(error) = pose.check() {
            return refuse(format!("poses.{robot}.{}", error.field), error.problem);
        }
        let frame = pose.frame.as_deref().unwrap_or("map");
        let first = *common.get_or_insert(frame);
        if frame != first {
            return refuse(
                format!("poses.{robot}.frame"),
                format!("{frame:?} is another frame than {first:?}: positions cannot be compared"),
            );
        }
        if let Some(position) = positions.get_mut(at) {
            *position = [pose.x, pose.y, pose.z.unwrap_or(0.0)];
        }
    }
    Ok(spatial_edges(&positions, &settings.spatial))
}

fn of_links(
    links: &Named<RobotId, Vec<Object<Link>>>,
    places: &Places,
    settings: &ConnectivitySettings,
) -> Result<Vec<Edge>, SolveError> {
    let mut reports = Vec::with_capacity(links.0.len());
    for (robot, links) in &links.0 {
        let receiver = index(place(places, robot, || format!("links.{robot}"))?);
        let mut report: Vec<(u32, f64)> = Vec::with_capacity(links.len());
        let mut peers = HashMap::with_capacity(links.len());
        for (number, Object(link)) in links.iter().enumerate() {
            let field = |part: &str| format!("links.{robot}[{number}].{part}");
            let peer = index(place(places, &link.peer, || field("peer"))?);
            if peer == receiver {
                return refuse(field("peer"), "no robot receives itself");
            }
            if let Some(first) = peers.insert(peer, number) {
                let problem = format!("{} is named twice, first as [{first}]", link.peer);
                return refuse(field("peer"), problem);
            }
            let weight = link_weight(settings, link.quality)
                .or_else(|error| refuse(field("quality"), error.problem))?;
            report.push((peer, weight));
        }
        reports.push((receiver, report));
    }
    let reports = reports.iter().map(|(receiver, report)| (*receiver, report.as_slice()));
    connectivity_edges(reports).or_else(|error| refuse("links", error.to_string()))
}

fn of_ranks(
    ranks: &Named<RobotId, Object<Rank>>,
    places: &Places,
) -> Result<Vec<Edge>, SolveError> {
    let mut reports = Vec::with_capacity(ranks.0.len());
    for (robot, Object(rank)) in &ranks.0 {
        let at = place(places, robot, || format!("ranks.{robot}"))?;
        if let Err(error) = rank.check() {
            return refuse(format!("ranks.{robot}.{}", error.field), error.problem);
        }
        let field = || format!("ranks.{robot}.superior");
        let superior = match &rank.superior {
            Some(superior) => Some(place(places, superior, field)?),
            None => None,
        };
        if superior == Some(at) {
            return refuse(field(), "no robot is its own superior");
        }
        reports.push((index(at), superior.map(index), rank.weight));
    }
    hierarchy_edges(reports).or_else(|error| refuse("ranks", error.to_string()))
}

/// The place as the relations count it; there are far fewer robots than 2³².
fn index(place: usize) -> u32 {
    u32::try_from(place).unwrap_or(u32::MAX)
}

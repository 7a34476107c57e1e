//! The job: from the rows of an embedding to named teams.

use std::collections::BTreeMap;
use std::sync::Arc;

use muster_model::embedding::Embedding;
use muster_model::id::RobotId;
use muster_model::settings::{CentroidStart, ClustererSettings};
use muster_model::teams::{Member, Team, Teams};
use muster_numeric::kmeans::{Init, KMeans, KMeansOptions, kmeans};
use muster_numeric::margins::margins;
use muster_numeric::matrix::DenseMatrix;

use crate::identity::{self, Memory};

/// Largest hysteresis that the division takes: a share of 1 would hold every robot where it is,
/// whatever happens, so that larger settings mean "just below 1".
const MAX_HYSTERESIS: f64 = 0.999;

/// One embedding to divide.
#[derive(Debug, Clone)]
pub struct Job {
    pub(crate) embedding: Arc<Embedding>,
    pub(crate) settings: ClustererSettings,
    pub(crate) previous: Option<Arc<Teams>>,
    pub(crate) memory: Arc<Memory>,
}

/// What became of a [`Job`]: a division whose head, leaders and stale robots the core fills in, or
/// what was wrong.
#[derive(Debug, Clone)]
pub struct Outcome(pub(crate) Result<Teams, String>);

/// Whether two embeddings hold the same robots with the same vectors.
pub(crate) fn same_data(left: &Embedding, right: &Embedding) -> bool {
    std::ptr::eq(left, right)
        || left.dimension == right.dimension
            && left.robots == right.robots
            && left.unseen == right.unseen
            && left.values == right.values
}

/// Robots of one cluster, as rows of the embedding, and its centroid.
struct Cluster {
    rows: Vec<usize>,
    centroid: Vec<f64>,
}

/// Divides the robots that the embedding sees.
pub(crate) fn divide(job: &Job) -> Result<Teams, String> {
    let embedding = &*job.embedding;
    embedding.check().map_err(|error| error.to_string())?;
    let seen: Vec<usize> = (0..embedding.robots.len()).filter(|&i| !embedding.unseen[i]).collect();
    let values = seen.iter().flat_map(|&i| row_of(embedding, i)).copied().collect::<Vec<f64>>();
    let x = DenseMatrix::new(seen.len(), embedding.dimension as usize, values)
        .map_err(|error| error.to_string())?;

    let mut margin_of = vec![0.0; embedding.robots.len()];
    let mut clusters = Vec::new();
    let mut inertia = 0.0;
    if !seen.is_empty() {
        let found = cluster(&x, &seen, job)?;
        let margins = margins(&x, &found.labels, &found.centroids).map_err(|e| e.to_string())?;
        for (&row, margin) in seen.iter().zip(margins) {
            margin_of[row] = margin;
        }
        inertia = found.inertia;
        clusters = gather(&found, &seen);
    }
    let unassigned: Vec<RobotId> = (0..embedding.robots.len())
        .filter(|&i| embedding.unseen[i])
        .map(|i| embedding.robots[i].clone())
        .collect();

    let members: Vec<Vec<&RobotId>> = clusters
        .iter()
        .map(|cluster| cluster.rows.iter().map(|&i| &embedding.robots[i]).collect())
        .collect();
    let named = identity::name(&members, &unassigned, job.previous.as_deref(), &job.memory)
        .map_err(|error| error.to_string())?;
    let mut teams: Vec<Team> = clusters
        .iter()
        .zip(named.ids)
        .filter_map(|(cluster, id)| {
            let leader = embedding.robots[*cluster.rows.first()?].clone();
            let member =
                |&i: &usize| Member { robot: embedding.robots[i].clone(), margin: margin_of[i] };
            let members = cluster.rows.iter().map(member).collect();
            Some(Team { id, members, leader, centroid: cluster.centroid.clone() })
        })
        .collect();
    teams.sort_by(|left, right| identity::order(&left.id).cmp(&identity::order(&right.id)));
    Ok(Teams {
        header: embedding.header.clone(),
        embedding: embedding.header.revision,
        requested: job.settings.teams,
        teams,
        unassigned,
        stale: Vec::new(),
        inertia,
        changes: named.changes,
        next_team: named.next_team,
    })
}

fn row_of(embedding: &Embedding, i: usize) -> &[f64] {
    let dimension = embedding.dimension as usize;
    &embedding.values[i * dimension..(i + 1) * dimension]
}

/// k-means, from the teams before where they were asked for in the same number.
fn cluster(x: &DenseMatrix, seen: &[usize], job: &Job) -> Result<KMeans, String> {
    let settings = &job.settings;
    let warm = job.previous.as_deref().filter(|teams| teams.requested == settings.teams);
    let warm: Option<Vec<Option<usize>>> = warm.map(|teams| {
        let team_of: BTreeMap<&RobotId, usize> = teams
            .teams
            .iter()
            .enumerate()
            .flat_map(|(number, team)| team.members.iter().map(move |m| (&m.robot, number)))
            .collect();
        seen.iter().map(|&i| team_of.get(&job.embedding.robots[i]).copied()).collect()
    });
    let options = KMeansOptions {
        clusters: (settings.teams.max(1) as usize).min(seen.len()),
        init: match settings.init {
            CentroidStart::PlusPlus => Init::PlusPlus,
            CentroidStart::Random => Init::Random,
        },
        restarts: settings.restarts as usize,
        max_iterations: settings.max_iterations as usize,
        seed: settings.seed,
        warm_labels: warm.as_deref(),
        hysteresis: settings.hysteresis.clamp(0.0, MAX_HYSTERESIS),
        threads: 1,
    };
    kmeans(x, &options).map_err(|error| error.to_string())
}

/// The clusters, ordered by their smallest member, so that nothing rests on how they were numbered.
fn gather(found: &KMeans, seen: &[usize]) -> Vec<Cluster> {
    let mut clusters: Vec<Cluster> = found
        .centroids
        .iter_rows()
        .map(|centroid| Cluster { rows: Vec::new(), centroid: centroid.to_vec() })
        .collect();
    for (&row, &label) in seen.iter().zip(&found.labels) {
        if let Some(cluster) = clusters.get_mut(label) {
            cluster.rows.push(row);
        }
    }
    clusters.retain(|cluster| !cluster.rows.is_empty());
    clusters.sort_by_key(|cluster| cluster.rows.first().copied());
    clusters
}

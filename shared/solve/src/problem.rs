//! The checks on an input, and what passes them.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use muster_model::id::{Modality, RobotId};
use muster_model::limits::MAX_WEIGHT;
use muster_model::object::Object;
use muster_model::settings::{
    Alpha, ClustererSettings, Dimension, EmbedderSettings, MAX_SELF_LOOPS, Settings, TeamCount,
    Trusted, WEIGHT_SUM_TOLERANCE, check_reciprocity,
};
use muster_numeric::matrix::{MAX_ENTRY, MIN_WEIGHT, SparseMatrix};

use super::defaults;
use super::edges::Edges;
use super::error::{SolveError, refuse};
use super::file::{Emit, File, ModalityEntry, Named};
use super::limits::{Asks, LABELS_ARE_DIVIDED, with_limits};
use super::observations::{Graphs, Observations};
use super::options::{Options, Preset};
use super::places::{Places, places};

/// A checked input.
#[derive(Debug)]
pub(super) struct Problem {
    /// The robots, in the order of all rows.
    pub(super) robots: Vec<RobotId>,
    /// One graph per modality with its weight; the weights sum to 1.
    pub(super) graphs: Vec<Graph>,
    /// From graphs to vectors; the weights are those of `graphs`, in which edges lead back already.
    pub(super) settings: EmbedderSettings,
    pub(super) division: Division,
    /// What is asked of the teams in addition to the settings of the division.
    pub(super) asks: Asks,
    pub(super) emit: BTreeSet<Emit>,
    /// What was chosen by flags.
    pub(super) options: Options,
    /// Whether what the embedding rests on is kept, to say why a robot is in its team.
    pub(super) keeps_frames: bool,
}

/// The graph of one modality.
#[derive(Debug)]
pub(super) struct Graph {
    pub(super) name: Modality,
    pub(super) weight: f64,
    pub(super) matrix: Arc<SparseMatrix>,
}

/// Where the division comes from.
#[derive(Debug)]
pub(super) enum Division {
    /// From k-means.
    Wanted(ClustererSettings),
    /// From the file: one label per robot.
    Given(Vec<u32>),
}

/// Checks a file.
pub(super) fn check(mut file: File, options: Options) -> Result<Problem, SolveError> {
    let places = places(&file.robots)?;
    let preset = file.preset.or(options.preset);
    let defaults = defaults::embedder(preset, file.normalize);
    let self_loops = file.self_loops.unwrap_or(defaults.self_loops);
    check_self_loops(self_loops)?;
    let trusted = file.trusted.take().unwrap_or(defaults.trusted);
    let is_observed = file.modalities.is_none();
    let asks = Asks::of_file(&mut file, &places)?;
    let graphs = graphs(&mut file, &places, preset, options.normalize_weights)?;
    if let Trusted::Only(named) = &trusted {
        check_known("trusted", named, &graphs, is_observed)?;
    }
    let division = division(&mut file, preset, options.teams)?;
    if let (Division::Given(_), false) = (&division, asks.wishes.is_empty()) {
        return refuse("wishes", LABELS_ARE_DIVIDED);
    }
    let alpha = file.alpha.map_or(defaults.alpha, |decay| decay.0);
    check_alpha(alpha)?;
    let dimension = file.dimension.unwrap_or(defaults.dimension);
    check_dimension(dimension, file.robots.len())?;
    let settings = EmbedderSettings {
        normalize: file.normalize.unwrap_or(defaults.normalize),
        self_loops,
        trusted,
        alpha,
        dimension,
        scale: file.scale.unwrap_or(defaults.scale),
        rows: file.rows.unwrap_or(defaults.rows),
        ..defaults
    };
    let emit = file.emit.unwrap_or_default().into_iter().collect();
    Ok(Problem { asks, ..Problem::new(file.robots, graphs, settings, division, emit, options) })
}

impl Problem {
    /// A problem of checked parts. Weights and reciprocity of the settings give way to those of the graphs.
    pub(super) fn new(
        robots: Vec<RobotId>,
        graphs: Vec<Graph>,
        settings: EmbedderSettings,
        division: Division,
        emit: BTreeSet<Emit>,
        options: Options,
    ) -> Self {
        let weights = graphs.iter().map(|graph| (graph.name.clone(), graph.weight)).collect();
        let settings = EmbedderSettings { weights, reciprocity: BTreeMap::new(), ..settings };
        let asks = Asks::default();
        Self { robots, graphs, settings, division, asks, emit, options, keeps_frames: false }
    }
}

/// The graphs of a file, with what leads back in them.
fn graphs(
    file: &mut File,
    places: &Places,
    preset: Option<Preset>,
    normalize_weights: bool,
) -> Result<Vec<Graph>, SolveError> {
    // Graphs that are given are taken as they are, observations as in the live fleet.
    let reciprocity = match file.reciprocity.take() {
        Some(Named(shares)) => shares,
        None if file.modalities.is_some() => BTreeMap::new(),
        None => defaults::embedder(preset, None).reciprocity,
    };
    let is_observed = file.modalities.is_none();
    check_reciprocity(&reciprocity).or_else(|error| refuse(error.field, error.problem))?;
    let mut graphs = reported(file, places, preset, normalize_weights)?;
    check_known("reciprocity", reciprocity.keys(), &graphs, is_observed)?;
    for graph in &mut graphs {
        let share = reciprocity.get(&graph.name).copied().unwrap_or(0.0);
        if share > 0.0 {
            let both = graph.matrix.with_reverse(share);
            let field = || format!("reciprocity.{}", graph.name);
            let both = both.or_else(|error| refuse(field(), error.to_string()))?;
            graph.matrix = Arc::new(both);
        }
    }
    Ok(graphs)
}

/// The graphs of a file, which gives either them or observations.
fn reported(
    file: &mut File,
    places: &Places,
    preset: Option<Preset>,
    normalize_weights: bool,
) -> Result<Vec<Graph>, SolveError> {
    let observed = [
        ("poses", file.poses.is_some()),
        ("links", file.links.is_some()),
        ("ranks", file.ranks.is_some()),
        ("weights", file.weights.is_some()),
        ("spatial", file.spatial.is_some()),
        ("connectivity", file.connectivity.is_some()),
    ];
    let observed = observed.into_iter().find(|(_, given)| *given).map(|(field, _)| field);
    if let Some(modalities) = file.modalities.take() {
        if let Some(field) = observed {
            let problem = "must not be given with \"modalities\", which are graphs with weights; \
                           give either them or \"poses\", \"links\" and \"ranks\"";
            return refuse(field, problem);
        }
        return weighted(modality_graphs(modalities, places)?, "modalities", normalize_weights);
    }
    if file.poses.is_none() && file.links.is_none() && file.ranks.is_none() {
        let problem = "is missing; give it, or at least one of \"poses\", \"links\", \"ranks\"";
        return refuse("modalities", problem);
    }
    let observations = Observations {
        poses: file.poses.take(),
        links: file.links.take(),
        ranks: file.ranks.take(),
        weights: file.weights.take(),
        spatial: file.spatial.take(),
        connectivity: file.connectivity.take(),
        weighs_equally: preset == Some(Preset::Paper),
    };
    weighted(observations.into_graphs(places)?, "weights", normalize_weights)
}

/// Checks that names are those of modalities of the file. A file of observations may name each of the three that
/// it might have.
fn check_known<'a>(
    field: &str,
    names: impl IntoIterator<Item = &'a Modality>,
    graphs: &[Graph],
    is_observed: bool,
) -> Result<(), SolveError> {
    let mut names = names.into_iter();
    let unknown = names.find(|name| {
        !(is_observed && name.is_built_in()) && graphs.iter().all(|graph| graph.name != **name)
    });
    let Some(name) = unknown else { return Ok(()) };
    let known: Vec<_> = graphs.iter().map(|graph| graph.name.as_str()).collect();
    let problem = format!("is no modality of this file: {}", known.join(", "));
    refuse(format!("{field}.{name}"), problem)
}

/// How the division of a file comes about; `asked` is the number of teams that was asked for with the command.
fn division(
    file: &mut File,
    preset: Option<Preset>,
    asked: Option<TeamCount>,
) -> Result<Division, SolveError> {
    let robots = file.robots.len();
    let defaults = defaults::clusterer(preset);
    let wanted = asked.or(file.teams);
    let settings = ClustererSettings {
        teams: wanted.unwrap_or(defaults.teams),
        init: file.init.unwrap_or(defaults.init),
        restarts: file.restarts.unwrap_or(defaults.restarts),
        seed: file.seed.unwrap_or(defaults.seed),
        ..defaults
    };
    let limits = [
        ("size", file.size.is_some()),
        ("team_size", file.team_size.is_some()),
        ("needs", file.needs.is_some()),
    ];
    if let (Some((field, _)), true) =
        (limits.iter().find(|(_, is_given)| *is_given), file.labels.is_some())
    {
        return refuse(*field, LABELS_ARE_DIVIDED);
    }
    let settings = with_limits(file, settings);
    settings.check().or_else(|error| refuse(error.field, error.problem))?;
    let least = *settings.teams.range().start();
    match (wanted, file.labels.take()) {
        (_, None) if robots > 0 && least as usize > robots => {
            refuse("teams", format!("{least} teams cannot be made of {robots} robots"))
        }
        (_, None) => Ok(Division::Wanted(settings)),
        (None, Some(labels)) if labels.len() != robots => refuse(
            "labels",
            format!("must be one per robot: {} labels for {robots} robots", labels.len()),
        ),
        (None, Some(labels)) => Ok(Division::Given(labels)),
        (Some(_), Some(_)) => {
            refuse("teams", "must not be given with \"labels\": give one of the two")
        }
    }
}

fn modality_graphs(
    modalities: Vec<Object<ModalityEntry>>,
    places: &Places,
) -> Result<Graphs, SolveError> {
    if modalities.is_empty() {
        return refuse("modalities", "must hold at least one graph");
    }
    let mut graphs = Graphs::new();
    for (index, Object(entry)) in modalities.into_iter().enumerate() {
        let path = format!("modalities[{index}]");
        if graphs.iter().any(|(_, name, ..)| *name == entry.name) {
            let name = entry.name;
            return refuse(format!("{path}.name"), format!("there are two modalities {name}"));
        }
        let triplets = match (entry.matrix, entry.edges) {
            (Some(matrix), None) => matrix_triplets(&matrix, places.len(), &path)?,
            (None, Some(edges)) => edge_triplets(&edges, places, &path)?,
            (None, None) => return refuse(path, "lacks its graph; give \"matrix\" or \"edges\""),
            (Some(_), Some(_)) => {
                return refuse(path, "has both \"matrix\" and \"edges\"; give one of the two");
            }
        };
        let matrix = SparseMatrix::from_triplets(places.len(), triplets)
            .or_else(|error| refuse(&path, error.to_string()))?;
        graphs.push((format!("{path}.weight"), entry.name, entry.weight, matrix));
    }
    Ok(graphs)
}

fn matrix_triplets(
    matrix: &[Vec<f64>],
    robots: usize,
    path: &str,
) -> Result<Vec<(usize, usize, f64)>, SolveError> {
    if matrix.len() != robots {
        let found = matrix.len();
        return refuse(
            format!("{path}.matrix"),
            format!("must have one row per robot: {found} rows for {robots} robots"),
        );
    }
    let mut triplets = Vec::new();
    for (i, row) in matrix.iter().enumerate() {
        if row.len() != robots {
            let found = row.len();
            return refuse(
                format!("{path}.matrix[{i}]"),
                format!("must have one entry per robot: {found} entries for {robots} robots"),
            );
        }
        for (j, &weight) in row.iter().enumerate() {
            check_edge(weight, || format!("{path}.matrix[{i}][{j}]"))?;
            if weight > 0.0 {
                triplets.push((i, j, weight));
            }
        }
    }
    Ok(triplets)
}

pub(super) fn edge_triplets(
    edges: &Edges,
    places: &Places,
    path: &str,
) -> Result<Vec<(usize, usize, f64)>, SolveError> {
    let named: Vec<Option<usize>> =
        edges.names.iter().map(|name| places.get(name).copied()).collect();
    let mut triplets = Vec::with_capacity(edges.list.len());
    for (index, &(from, to, weight)) in edges.list.iter().enumerate() {
        let field = |part: &str| format!("{path}.edges[{index}]{part}");
        let place = |name: u32, part: &str| match named.get(name as usize) {
            Some(Some(place)) => Ok(*place),
            _ => {
                let name = edges.names.get(name as usize).map_or("?", RobotId::as_str);
                refuse(field(part), format!("{name} is not among \"robots\""))
            }
        };
        let (i, j) = (place(from, "[0]")?, place(to, "[1]")?);
        check_edge(weight, || field("[2]"))?;
        triplets.push((i, j, weight));
    }
    if let Some((first, second)) = repeated(&triplets) {
        let (from, to, _) = edges.list[second];
        let name = |name: u32| &edges.names[name as usize];
        return refuse(
            format!("{path}.edges[{second}]"),
            format!(
                "the edge from {} to {} is given twice, first as edges[{first}]",
                name(from),
                name(to)
            ),
        );
    }
    Ok(triplets)
}

/// The first edge that is given again, by the place where it is, and the first one that it repeats.
fn repeated(triplets: &[(usize, usize, f64)]) -> Option<(usize, usize)> {
    let ends = |place: &u32| triplets.get(*place as usize).map(|edge| (edge.0, edge.1));
    // Places take less memory than a table of all edges, and most files are in order.
    let mut places: Vec<u32> = (0..).take(triplets.len()).collect();
    places.sort_by_key(ends);
    let runs = places.chunk_by(|left, right| ends(left) == ends(right));
    let pairs = runs.filter_map(|run| Some((*run.first()? as usize, *run.get(1)? as usize)));
    pairs.min_by_key(|(_, second)| *second)
}

fn check_edge(weight: f64, field: impl FnOnce() -> String) -> Result<(), SolveError> {
    if weight == 0.0 || (MIN_WEIGHT..=MAX_ENTRY).contains(&weight) {
        return Ok(());
    }
    refuse(
        field(),
        format!("must be 0, or a number from {MIN_WEIGHT:e} to {MAX_ENTRY:e}, not {weight:?}"),
    )
}

/// Graphs with weights that sum to 1. `field` is where the weights stand.
fn weighted(graphs: Graphs, field: &str, normalize: bool) -> Result<Vec<Graph>, SolveError> {
    let given = graphs.iter().filter(|graph| graph.2.is_some()).count();
    #[expect(clippy::cast_precision_loss, reason = "there are a few modalities")]
    let equal = 1.0 / graphs.len() as f64;
    let mut weights = Vec::with_capacity(graphs.len());
    for (path, _, weight, _) in &graphs {
        match weight {
            None if given == 0 => weights.push(equal),
            None => return refuse(path, "is missing; give the weights of all or of none"),
            Some(weight) if (0.0..=MAX_WEIGHT).contains(weight) => weights.push(*weight),
            Some(weight) => {
                let problem = format!("must be a number from 0 to {MAX_WEIGHT:e}, not {weight:?}");
                return refuse(path, problem);
            }
        }
    }
    let sum: f64 = weights.iter().sum();
    if normalize && given > 0 {
        if sum < MIN_WEIGHT {
            return refuse(field, "at least one weight must be above 0");
        }
        for weight in &mut weights {
            *weight /= sum;
        }
    } else if (sum - 1.0).abs() > WEIGHT_SUM_TOLERANCE {
        return refuse(
            field,
            format!(
                "the weights sum to {sum} instead of 1; change them, or pass --normalize-weights \
                 to have them divided by their sum"
            ),
        );
    }
    let graphs = graphs.into_iter().zip(weights);
    let graph = |((_, name, _, matrix), weight)| Graph { name, weight, matrix: Arc::new(matrix) };
    Ok(graphs.map(graph).collect())
}

fn check_self_loops(weight: f64) -> Result<(), SolveError> {
    if (0.0..=MAX_SELF_LOOPS).contains(&weight) {
        return Ok(());
    }
    refuse("self_loops", format!("must be a number from 0 to {MAX_SELF_LOOPS}, not {weight:?}"))
}

fn check_alpha(alpha: Alpha) -> Result<(), SolveError> {
    match alpha {
        Alpha::Value(value) if !(value.is_finite() && value > 0.0) => {
            refuse("alpha", format!("must be above 0, not {value:?}"))
        }
        Alpha::Fraction { fraction } if !(fraction > 0.0 && fraction < 1.0) => {
            let problem = format!("must be above 0 and below 1, not {fraction:?}");
            refuse("alpha.fraction", problem)
        }
        _ => Ok(()),
    }
}

fn check_dimension(dimension: Dimension, robots: usize) -> Result<(), SolveError> {
    match dimension {
        Dimension::Fixed(value) if value % 2 != 0 || value < 2 || value as usize > 2 * robots => {
            refuse(
                "dimension",
                format!(
                    "must be \"auto\" or an even number from 2 to {} (twice the number of \
                     robots), not {value}",
                    2 * robots
                ),
            )
        }
        _ => Ok(()),
    }
}

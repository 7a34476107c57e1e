//! A saved fleet: the lines of `muster graph --json`, and the settings of the services if they are there.
//!
//! Each line is one JSON object: a graph as it is printed, or the settings of `embedder` or `clusterer` as
//! `muster set embedder --json` and `muster set clusterer --json` print them, the status with the skills of robots, or a
//! wish of `muster wish list --json`. Settings that are not there
//! are the defaults. A saved fleet is divided as the live fleet would divide these graphs first.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;

use muster_division::rules::Asked;
use muster_method::weights::weights;
use muster_method::{Frame, Graph as FrameGraph};
use muster_model::id::{FleetId, Modality, RobotId, SkillId};
use muster_model::object::Object;
use muster_model::roster::Presence;
use muster_model::settings::{ClustererSettings, EmbedderSettings, Settings};
use muster_model::wish::StandingWish;
use muster_numeric::matrix::SparseMatrix;
use serde::Deserialize;
use serde::de::IgnoredAny;

use super::defaults;
use super::edges::Edges;
use super::error::{SolveError, refuse, tidy};
use super::file::explained;
use super::limits::Asks;
use super::options::{Options, Preset};
use super::places::MAX_SOLVE_ROBOTS;
use super::problem::{Division, Graph, Problem, edge_triplets};

/// One graph as `muster graph --json` prints it.
#[derive(Deserialize)]
struct SavedGraph {
    fleet: Option<FleetId>,
    modality: Modality,
    robots: Vec<RobotId>,
    edges: Edges,
}

/// Fields that distinguish the lines of a saved fleet from each other and from other files.
#[derive(Deserialize)]
struct Probe {
    modality: Option<IgnoredAny>,
    residual_tolerance: Option<IgnoredAny>,
    heartbeat_s: Option<IgnoredAny>,
    robot_tokens: Option<IgnoredAny>,
    operator: Option<IgnoredAny>,
}

/// What a line holds.
enum Kind {
    Graph,
    Embedder,
    Clusterer,
    Status,
    Wish,
}

/// What `muster status --json` says of the robots.
#[derive(Deserialize)]
struct SavedStatus {
    robots: Vec<SavedRobot>,
}

#[derive(Deserialize)]
struct SavedRobot {
    robot: RobotId,
    presence: Presence,
    #[serde(default)]
    skills: Vec<SkillId>,
}

impl Probe {
    fn kind(&self) -> Option<Kind> {
        match self {
            Self { modality: Some(_), .. } => Some(Kind::Graph),
            Self { residual_tolerance: Some(_), .. } => Some(Kind::Embedder),
            Self { heartbeat_s: Some(_), .. } => Some(Kind::Clusterer),
            Self { robot_tokens: Some(_), .. } => Some(Kind::Status),
            Self { operator: Some(_), .. } => Some(Kind::Wish),
            _ => None,
        }
    }
}

/// The lines of a saved fleet.
#[derive(Default)]
pub(super) struct SavedFleet {
    fleet: Option<FleetId>,
    /// The last graph of each modality.
    graphs: BTreeMap<Modality, SavedGraph>,
    embedder: EmbedderSettings,
    clusterer: ClustererSettings,
    /// The robots with their skills; none if the status was not saved.
    status: Option<SavedStatus>,
    wishes: Vec<StandingWish>,
}

impl SavedFleet {
    /// Reads a saved fleet; none if the text begins with anything else.
    ///
    /// # Errors
    /// Names the line and the field that is wrong; lines are counted from 0.
    pub(super) fn read(text: &[u8]) -> Result<Option<Self>, SolveError> {
        let mut saved = Self::default();
        let mut values = serde_json::Deserializer::from_slice(text).into_iter::<Probe>();
        let mut number = 0;
        loop {
            let start = values.byte_offset();
            let kind = match values.next() {
                Some(Ok(probe)) => probe.kind(),
                Some(Err(error)) if number > 0 => {
                    return refuse(line(number, ""), explained(&error, text));
                }
                Some(Err(_)) => return Ok(None),
                None => break,
            };
            let value = &text[start..values.byte_offset()];
            match kind {
                Some(Kind::Graph) => saved.add(number, parsed(number, value)?)?,
                Some(Kind::Embedder) => saved.embedder = settings(number, value)?,
                Some(Kind::Clusterer) => saved.clusterer = settings(number, value)?,
                Some(Kind::Status) => saved.status = Some(parsed(number, value)?),
                Some(Kind::Wish) => saved.wishes.push(wish(number, value)?),
                None if number == 0 => return Ok(None),
                None => {
                    let problem = "is no graph of `muster graph --json`, no settings of embedder \
                                   or clusterer, no status and no wish";
                    return refuse(line(number, ""), problem);
                }
            }
            number += 1;
        }
        Ok((number > 0).then_some(saved))
    }

    fn add(&mut self, number: usize, graph: SavedGraph) -> Result<(), SolveError> {
        match (&self.fleet, &graph.fleet) {
            (Some(first), Some(other)) if first != other => {
                let problem =
                    format!("{other} is another fleet than {first}, which is named first");
                return refuse(line(number, ".fleet"), problem);
            }
            (None, Some(_)) => self.fleet.clone_from(&graph.fleet),
            _ => {}
        }
        self.graphs.insert(graph.modality.clone(), graph);
        Ok(())
    }

    /// The problem that the fleet is.
    ///
    /// # Errors
    /// Names the graph and the field that is wrong.
    pub(super) fn into_problem(self, options: Options) -> Result<Problem, SolveError> {
        let asks = self.asks()?;
        let Self { graphs, mut embedder, mut clusterer, .. } = self;
        if let Some(preset) = options.preset {
            let ClustererSettings { init, restarts, .. } = defaults::clusterer(Some(preset));
            clusterer = ClustererSettings { init, restarts, ..clusterer };
            embedder = defaults::embedder(Some(preset), None);
        }
        if graphs.is_empty() {
            return refuse("modality", "there are settings, but no graph");
        }
        let robots: BTreeSet<&RobotId> = graphs.values().flat_map(|graph| &graph.robots).collect();
        let robots: Vec<RobotId> = robots.into_iter().cloned().collect();
        if robots.is_empty() || robots.len() > MAX_SOLVE_ROBOTS {
            let problem = format!("must name 1 to {MAX_SOLVE_ROBOTS} robots, not {}", robots.len());
            return refuse("robots", problem);
        }
        let places: HashMap<RobotId, usize> = robots.iter().cloned().zip(0..).collect();
        let mut frame = Frame { robots: robots.as_slice().into(), graphs: Vec::new() };
        for (name, graph) in graphs {
            let triplets = edge_triplets(&graph.edges, &places, name.as_str())?;
            let matrix = SparseMatrix::from_triplets(robots.len(), triplets)
                .or_else(|error| refuse(name.as_str(), error.to_string()))?;
            frame.graphs.push((name, FrameGraph::Matrix(Arc::new(matrix))));
        }
        if options.preset == Some(Preset::Paper) {
            #[expect(clippy::cast_precision_loss, reason = "there are a few modalities")]
            let equal = 1.0 / frame.graphs.len() as f64;
            embedder.weights = frame.graphs.iter().map(|(name, _)| (name.clone(), equal)).collect();
        }
        let weights = weights(&embedder.weights, &frame)
            .or_else(|error| refuse("weights", error.to_string()))?;
        let mut reported = Vec::with_capacity(frame.graphs.len());
        for ((name, graph), weight) in frame.graphs.into_iter().zip(weights) {
            let share = embedder.reciprocity.get(&name).copied().unwrap_or(0.0);
            let matrix = graph
                .matrix(&robots, share)
                .or_else(|error| refuse(format!("reciprocity.{name}"), error.to_string()))?;
            reported.push(Graph { name, weight, matrix });
        }
        let teams = options.teams.unwrap_or(clusterer.teams);
        let division = Division::Wanted(ClustererSettings { teams, ..clusterer });
        let problem = Problem::new(robots, reported, embedder, division, BTreeSet::new(), options);
        Ok(Problem { asks, ..problem })
    }

    /// The wishes that count, and who can fill needs.
    fn asks(&self) -> Result<Asks, SolveError> {
        let mut asks = Asks::default();
        for asked in Asked::of(self.wishes.iter()) {
            asks.add_asked(asked)?;
        }
        if self.status.is_none() && !self.clusterer.needs.is_empty() {
            let problem = "rest on the skills of robots, which `muster status --json` prints: save \
                           that as well";
            return refuse("needs", problem);
        }
        let robots = self.status.iter().flat_map(|status| &status.robots);
        // A stale robot can do nothing for its team.
        for robot in robots.filter(|robot| robot.presence == Presence::Active) {
            asks.add_skills(&robot.robot, &robot.skills);
        }
        Ok(asks)
    }
}

/// The path of a field of a line.
fn line(number: usize, field: &str) -> String {
    format!("[{number}]{field}")
}

fn parsed<'de, T: Deserialize<'de>>(number: usize, value: &'de [u8]) -> Result<T, SolveError> {
    let mut json = serde_json::Deserializer::from_slice(value);
    let read = serde_path_to_error::deserialize::<_, Object<T>>(&mut json);
    read.map(|object| object.0).map_err(|error| {
        let path = error.path().to_string();
        let path = if path == "." { String::new() } else { format!(".{path}") };
        let problem = explained(&error.into_inner(), value);
        SolveError::Field { field: tidy(&line(number, &path)), problem: tidy(&problem) }
    })
}

fn wish(number: usize, value: &[u8]) -> Result<StandingWish, SolveError> {
    let standing: StandingWish = parsed(number, value)?;
    let wish = standing.wish.checked();
    let wish = wish
        .or_else(|error| refuse(line(number, &format!(".wish.{}", error.field)), error.problem))?;
    Ok(StandingWish { wish, ..standing })
}

fn settings<T: Settings>(number: usize, value: &[u8]) -> Result<T, SolveError> {
    let settings: T = parsed(number, value)?;
    settings
        .check()
        .or_else(|error| refuse(line(number, &format!(".{}", error.field)), error.problem))?;
    Ok(settings)
}

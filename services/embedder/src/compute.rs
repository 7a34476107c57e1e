//! The job: from one consistent frame to one vector per robot, to the similarity of pairs, or to reasons.
//!
//! A job owns or shares everything that it needs, and its result depends on nothing else but the
//! times that its stopwatch measures ([`EmbeddingQuality::stage_us`]). The method itself is
//! `muster-method`.

use std::collections::BTreeMap;
use std::sync::Arc;

use muster_method::embedding::{Embedded, Frames};
use muster_method::pairs::{Pair, PairError};
use muster_method::params::{EmbeddingParams, Pace, ValidEmbeddingParams};
use muster_method::reasons::Vectors;
use muster_method::step::Step;
use muster_method::{Graph, MethodError};
use muster_model::content::Checked;
use muster_model::embedding::{Embedding, EmbeddingGraph, EmbeddingQuality};
use muster_model::header::Revision;
use muster_model::id::{Modality, RobotId};
use muster_model::settings::{EmbedderSettings, TeamCount};
use muster_model::why::Why;
use muster_service::Stopwatch;
use muster_service::following::Frame;
use muster_wire::kept::KeptShape;

use crate::reasons::{self, Unexplained, explain};

/// What an embedding rests on. As long as it stays the same, so does the embedding.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Basis {
    /// The robots, ordered by name.
    pub(crate) robots: Arc<[RobotId]>,
    /// The graphs with their revisions.
    pub(crate) graphs: Vec<(Modality, Revision)>,
    /// The settings.
    pub(crate) settings: EmbedderSettings,
    /// How many teams are wanted; none if neither the dimension nor the evidence depends on it.
    pub(crate) teams: Option<TeamCount>,
    /// The robots that have new orders, ordered by name.
    pub(crate) new_orders: Vec<RobotId>,
    /// Whether the fleet is at rest, so that there is time for the scales and the decay of exactly these
    /// graphs, and for more digits.
    pub(crate) at_rest: bool,
}

impl Basis {
    /// Whether robots, graphs, settings and teams are the same, at rest or not.
    pub(crate) fn is_of(&self, other: &Self) -> bool {
        (&self.robots, &self.graphs, &self.settings, self.teams, &self.new_orders)
            == (&other.robots, &other.graphs, &other.settings, other.teams, &other.new_orders)
    }
}

/// Long work.
#[derive(Debug)]
pub struct Job {
    pub(crate) task: Task,
    /// It comes back with the result.
    pub(crate) memory: Box<Memory>,
}

/// What a job is to do.
#[derive(Debug)]
pub(crate) enum Task {
    /// An embedding.
    Embed {
        frame: Arc<Frame>,
        basis: Box<Basis>,
        /// The embedding that the new one is aligned with.
        previous: Option<Checked<Embedding>>,
        /// What the new one goes on from where there is none.
        shape: Option<KeptShape>,
    },
    /// The similarity of pairs of robots, by the graphs of the last embedding.
    Compare(Vec<[RobotId; 2]>),
    /// Why robots are in their teams, by the last embedding.
    Explain(Box<reasons::Task>),
}

/// The end of a job.
#[derive(Debug)]
pub struct Done {
    pub(crate) memory: Box<Memory>,
    pub(crate) result: Outcome,
}

/// What a job has led to.
#[derive(Debug)]
pub(crate) enum Outcome {
    Embedded { frame: Arc<Frame>, basis: Box<Basis>, result: Result<Box<Computed>, MethodError> },
    Compared(Vec<Result<Pair, PairError>>),
    Explained(Vec<Result<Why, Unexplained>>),
}

/// What is kept from job to job.
#[derive(Debug, Default)]
pub(crate) struct Memory {
    frames: Frames,
    /// The singular vectors of the last embedding.
    vectors: Option<Vectors>,
}

/// An embedding without its header.
#[derive(Debug)]
pub(crate) struct Computed {
    pub(crate) graphs: Vec<EmbeddingGraph>,
    /// The robots that disagree most with the other modalities, by modality, the worst first.
    pub(crate) disagreeing: BTreeMap<Modality, Vec<RobotId>>,
    pub(crate) dimension: u32,
    pub(crate) values: Vec<f64>,
    pub(crate) without_embedding: Vec<bool>,
    pub(crate) provisional: Vec<bool>,
    pub(crate) centrality: Vec<f64>,
    pub(crate) quality: EmbeddingQuality,
}

/// Does a job.
pub(crate) fn run(job: Job, stopwatch: &mut Stopwatch) -> Done {
    let Job { task, mut memory } = job;
    let result = match task {
        Task::Embed { frame, basis, previous, shape } => {
            if let Some(shape) = shape {
                let teams = (shape.teams > 0).then_some(shape.teams);
                memory.frames.resume(teams, shape.rank as usize);
            }
            let result = compute(&frame, &basis, previous.as_deref(), &mut memory, stopwatch);
            Outcome::Embedded { frame, basis, result: result.map(Box::new) }
        }
        Task::Compare(pairs) => Outcome::Compared(memory.frames.compare(&pairs)),
        Task::Explain(task) => {
            Outcome::Explained(explain(&memory.frames, memory.vectors.as_ref(), &task))
        }
    };
    Done { memory, result }
}

fn compute(
    frame: &Frame,
    basis: &Basis,
    previous: Option<&Embedding>,
    memory: &mut Memory,
    stopwatch: &mut Stopwatch,
) -> Result<Computed, MethodError> {
    memory.vectors = None;
    let frames = &mut memory.frames;
    let pace = if basis.at_rest { Pace::AtRest } else { Pace::Moving };
    // A fixed dimension and a fixed number of teams do not need each other.
    let teams = basis.teams.unwrap_or(TeamCount::Fixed(2));
    let params = EmbeddingParams {
        seed: frame.roster.header.revision.epoch,
        ..EmbeddingParams::new(&basis.settings, teams, pace)
    };
    let graphs = frame.graphs.iter();
    let graphs = graphs.map(|(name, graph)| (name.clone(), Graph::Replica(Arc::clone(graph))));
    let input =
        muster_method::Frame { robots: Arc::clone(&frame.robots), graphs: graphs.collect() };

    frames.set_new_orders(basis.new_orders.clone());
    let mut stages = Stages { us: [0; 3], current: FUSION };
    let params = params.check()?;
    let embedded = frames.embed(&input, &params, previous, &mut |step| {
        stages.enter(step, stopwatch);
    })?;
    stages.leave(stopwatch);
    let centrality = frames.centralities()?.to_vec();
    stages.current = FUSION;
    stages.leave(stopwatch);
    let (computed, vectors) = computed(embedded, basis, &params, centrality, stages.us);
    memory.vectors = Some(vectors);
    Ok(computed)
}

fn computed(
    embedded: Embedded,
    basis: &Basis,
    params: &ValidEmbeddingParams,
    centrality: Vec<f64>,
    stage_us: [u64; 3],
) -> (Computed, Vectors) {
    let Embedded { weights, trust, decay, decomposition, x, without_embedding, provisional } =
        embedded;
    let svd = decomposition.svd;
    let mut disagreeing = BTreeMap::new();
    let named = basis.graphs.iter().zip(weights).zip(trust);
    let graphs = named.map(|(((modality, revision), weight), trust)| {
        if !trust.disagreeing.is_empty() {
            disagreeing.insert(modality.clone(), trust.disagreeing);
        }
        EmbeddingGraph {
            modality: modality.clone(),
            revision: *revision,
            weight,
            trust: trust.factor,
        }
    });
    let computed = Computed {
        graphs: graphs.collect(),
        disagreeing,
        dimension: u32::try_from(x.cols()).unwrap_or(u32::MAX),
        without_embedding,
        provisional,
        centrality,
        quality: EmbeddingQuality {
            spectral_radius: (decay.radius.lower, decay.radius.upper),
            alpha: decay.alpha,
            next_singular_value: svd.sigma_next.unwrap_or(0.0),
            residual: decomposition.residual,
            katz_residual: decomposition.probe.unwrap_or(0.0),
            gap: svd.gap(),
            ambiguous: svd.ambiguous(),
            mode: decomposition.mode,
            teams_shown: (!decomposition.teams.scores.is_empty())
                .then_some(decomposition.teams.teams),
            team_scores: decomposition.teams.scores,
            stage_us,
            singular_values: svd.sigma.clone(),
        },
        values: x.into_data(),
    };
    (computed, Vectors { svd, power: params.power, rows: params.rows })
}

/// Places of [`EmbeddingQuality::stage_us`].
const FUSION: usize = 0;
const SIMILARITY: usize = 1;
const DECOMPOSITION: usize = 2;

/// Microseconds of each stage of a job.
struct Stages {
    us: [u64; 3],
    /// The stage that the job is in.
    current: usize,
}

impl Stages {
    /// A step begins.
    fn enter(&mut self, step: Step, stopwatch: &mut Stopwatch) {
        let next = match step {
            Step::Fuse | Step::SpectralRadius => FUSION,
            Step::Katz => SIMILARITY,
            _ => DECOMPOSITION,
        };
        if next != self.current {
            self.leave(stopwatch);
            self.current = next;
        }
    }

    /// The current stage ends, for now.
    fn leave(&mut self, stopwatch: &mut Stopwatch) {
        let stage = &mut self.us[self.current];
        *stage = stage.saturating_add(stopwatch.lap());
    }
}

//! All methods that are compared, by the names of the paper's tables.
//!
//! The paper leaves open how long vectors are and how graphs are weighted. Baselines and the paper's own
//! method take what brings its tables nearest: [`PAPER_RANK`] triplets, α of half of what is admissible,
//! equal weights.

pub mod consensus;
pub mod embedding;
pub mod girvan_newman;
pub mod lle;

use muster_model::id::Modality;
use muster_model::settings::{
    Alpha, CentroidStart, ClustererSettings, Dimension, EmbedderSettings, IngestSettings,
    Normalization, RowScaling, Trusted, coverage, default_weight,
};
use muster_numeric::matrix::{DenseMatrix, SparseMatrix};

use crate::system::{Nearness, System, SystemError};
use consensus::together;
use embedding::{Clustering, Form, MethodError, Rank, Vectors, concatenated};
use girvan_newman::girvan_newman;
use lle::{LleError, locally_linear_embedding};

/// K of the paper's method and of HOPE.
pub const PAPER_RANK: usize = 3;

/// α of both as a share of what is admissible.
pub const PAPER_FRACTION: f64 = 0.5;

/// Neighbours and coordinates of locally linear embedding: scikit-learn's defaults.
pub const LLE_NEIGHBOURS: usize = 5;
/// See [`LLE_NEIGHBOURS`].
pub const LLE_DIMENSION: usize = 2;

/// Starts of k-means for the baselines: scikit-learn's number in its years.
pub const BASELINE_STARTS: usize = 10;

/// One of the three modalities, by its place in [`crate::system::MODALITIES`].
pub type ModalityIndex = usize;

/// Our method with everything that can be chosen.
#[derive(Debug, Clone, PartialEq)]
pub struct Recipe {
    /// How distances become weights.
    pub nearness: Nearness,
    /// Weight of reports up the chain of command, relative to orders down.
    pub upward: f64,
    /// Weight of ties between robots with the same superior.
    pub siblings: f64,
    /// The weight of each modality.
    pub weights: [f64; 3],
    /// Whether a modality that relates less than half of the robots counts less.
    pub by_coverage: bool,
    /// From graphs to vectors.
    pub form: Form,
    /// From vectors to teams.
    pub clustering: Clustering,
    /// Which divisions are brought together into one.
    pub consensus: Consensus,
}

/// Which divisions are brought together into one: see [`consensus::together`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Consensus {
    /// None: the best division of all starts is it.
    Best,
    /// Those of so many single starts of k-means.
    Starts(usize),
    /// The best ones of every K from 2 to the number of teams.
    Ranks,
}

impl Recipe {
    /// The paper's method: 1/d, graphs as they are, singular vectors as they come, k-means from one random
    /// start.
    #[must_use]
    pub fn plain() -> Self {
        Self {
            nearness: Nearness::Inverse,
            upward: 0.0,
            siblings: 0.0,
            weights: [1.0 / 3.0; 3],
            by_coverage: false,
            form: Form {
                normalization: Normalization::None,
                self_loops: 0.0,
                doubts: false,
                fraction: PAPER_FRACTION,
                rank: Rank::Fixed(PAPER_RANK),
                power: 0.0,
                rows: RowScaling::None,
            },
            clustering: Clustering { init: CentroidStart::Random, starts: 1 },
            consensus: Consensus::Best,
        }
    }

    /// The weight of each graph in the order of [`crate::system::MODALITIES`]: those of the live system's
    /// rule for default weights, divided by their sum, of which a graph without an edge has no part.
    fn weights(&self, graphs: &[SparseMatrix; 3]) -> Vec<f64> {
        let weight = |(graph, weight): (&SparseMatrix, f64)| match graph {
            graph if graph.is_zero() => 0.0,
            graph if self.by_coverage => weight * coverage(graph.related_share()),
            _ => weight,
        };
        let weights: Vec<f64> = graphs.iter().zip(self.weights).map(weight).collect();
        let sum: f64 = weights.iter().sum();
        if sum > 0.0 {
            weights.iter().map(|weight| weight / sum).collect()
        } else {
            self.weights.to_vec()
        }
    }

    /// What the live system does by default: the defaults of its services.
    #[must_use]
    pub fn live() -> Self {
        let (ingest, embedder) = (IngestSettings::default(), EmbedderSettings::default());
        let clusterer = ClustererSettings::default();
        let weight = |name: &str| -> f64 {
            let modality = Modality::new(name).ok();
            let set = |modality: &Modality| match embedder.weights.len() {
                0 => default_weight(modality, 1.0),
                _ => embedder.weights.get(modality).copied().unwrap_or(0.0),
            };
            modality.as_ref().map_or(0.0, set)
        };
        Self {
            nearness: Nearness::Kernel(ingest.spatial),
            upward: embedder.reciprocity.get(&Modality::hierarchy()).copied().unwrap_or(0.0),
            siblings: 0.0,
            weights: crate::system::MODALITIES.map(weight),
            by_coverage: embedder.weights.is_empty(),
            form: Form {
                normalization: embedder.normalize,
                self_loops: embedder.self_loops,
                doubts: embedder.trusted != Trusted::All,
                fraction: match embedder.alpha {
                    Alpha::Fraction { fraction } => fraction,
                    // A decay that fits one graph fits no other.
                    Alpha::Value(_) => PAPER_FRACTION,
                },
                rank: match embedder.dimension {
                    Dimension::Auto => Rank::Ratio,
                    Dimension::Fixed(dimension) => Rank::Fixed(dimension as usize / 2),
                },
                power: embedder.scale.power(),
                rows: embedder.rows,
            },
            clustering: Clustering { init: clusterer.init, starts: clusterer.restarts as usize },
            consensus: Consensus::Best,
        }
    }

    /// Divides the robots of graphs in the order of [`crate::system::MODALITIES`], of which that of command
    /// leads back already.
    ///
    /// # Errors
    /// [`MethodError`]
    pub fn divide(
        &self,
        graphs: &[SparseMatrix; 3],
        teams: usize,
        seed: u64,
    ) -> Result<Division, MethodError> {
        let vectors = self.vectors(graphs, teams, seed)?;
        let labels = self.clustering.divide(&vectors, teams, seed)?;
        Ok(Division { labels, vectors: Some(vectors.x) })
    }

    /// What k-means sees of graphs in the order of [`crate::system::MODALITIES`].
    fn vectors(
        &self,
        graphs: &[SparseMatrix; 3],
        teams: usize,
        seed: u64,
    ) -> Result<Vectors, MethodError> {
        let weights = self.weights(graphs);
        let weighted: Vec<(&SparseMatrix, f64)> = graphs.iter().zip(weights).collect();
        let divisions = match self.consensus {
            Consensus::Best => return self.form.vectors(&weighted, teams),
            Consensus::Starts(count) => {
                let vectors = self.form.vectors(&weighted, teams)?;
                let once = Clustering { starts: 1, ..self.clustering };
                let seeds = (0..count as u64).map(|start| seed.wrapping_add(start << 32));
                seeds
                    .map(|seed| once.divide(&vectors, teams, seed))
                    .collect::<Result<Vec<_>, _>>()?
            }
            Consensus::Ranks => {
                let of_rank = |rank: usize| {
                    let form = Form { rank: Rank::Fixed(rank), ..self.form };
                    self.clustering.divide(&form.vectors(&weighted, teams)?, teams, seed)
                };
                (2..=teams.max(2)).map(of_rank).collect::<Result<Vec<_>, _>>()?
            }
        };
        Ok(Vectors::of_all(together(&divisions)?))
    }
}

/// A method.
#[derive(Debug, Clone, PartialEq)]
pub enum Method {
    /// Division by edge betweenness of one modality.
    GirvanNewman(ModalityIndex),
    /// Locally linear embedding of the rows of one graph, and k-means.
    Lle(ModalityIndex),
    /// The Katz similarity of one modality (Ou et al., KDD 2016), and k-means.
    Hope(ModalityIndex),
    /// HOPE of each modality, one vector behind the other, and k-means.
    HopeConcatenated,
    /// One modality with the scaling, rows and weights of our recipe: the strongest form of a baseline.
    Single(ModalityIndex, Box<Recipe>),
    /// All modalities fused.
    Multimodal(&'static str, Box<Recipe>),
}

/// Why a method has no division.
#[derive(Debug, thiserror::Error)]
pub enum DivisionError {
    /// The system has no graphs.
    #[error(transparent)]
    System(#[from] SystemError),
    /// The method fails.
    #[error(transparent)]
    Method(#[from] MethodError),
    /// Locally linear embedding fails.
    #[error(transparent)]
    Lle(#[from] LleError),
}

/// A division, with the vectors that were divided where there are some.
#[derive(Debug, Clone, PartialEq)]
pub struct Division {
    /// The team of each robot.
    pub labels: Vec<usize>,
    /// What k-means has seen.
    pub vectors: Option<DenseMatrix>,
}

impl Method {
    /// The methods of the paper's tables, in their order, and ours.
    #[must_use]
    pub fn all() -> Vec<Self> {
        let each = |method: fn(ModalityIndex) -> Self| (0..3).map(method);
        let live = || Box::new(Recipe::live());
        let mut all: Vec<Self> = each(Self::GirvanNewman).chain(each(Self::Lle)).collect();
        all.extend(each(Self::Hope));
        all.push(Self::HopeConcatenated);
        all.extend((0..3).map(|modality| Self::Single(modality, live())));
        all.push(Self::Multimodal("multimodal, plain", Box::new(Recipe::plain())));
        all.push(Self::Multimodal("muster", live()));
        all
    }

    /// What it is called in tables.
    #[must_use]
    pub fn name(&self) -> String {
        let of = |name: &str, modality: &ModalityIndex| {
            format!("{name} ({})", crate::system::MODALITIES[*modality])
        };
        match self {
            Self::GirvanNewman(modality) => of("GN", modality),
            Self::Lle(modality) => of("LLE", modality),
            Self::Hope(modality) => of("HOPE", modality),
            Self::HopeConcatenated => "HOPE (concatenated)".to_owned(),
            Self::Single(modality, _) => of("muster", modality),
            Self::Multimodal(name, _) => (*name).to_owned(),
        }
    }

    /// Divides a system into `teams`.
    ///
    /// # Errors
    /// [`DivisionError`]
    pub fn divide(
        &self,
        system: &System,
        teams: usize,
        seed: u64,
    ) -> Result<Division, DivisionError> {
        let kmeans = Clustering { init: CentroidStart::PlusPlus, starts: BASELINE_STARTS };
        let (vectors, kmeans) = match self {
            Self::GirvanNewman(modality) => {
                let graph = &system.graphs(&Nearness::Inverse)?[*modality];
                let edges: Vec<_> = graph.triplets().map(|(i, j, _)| (i, j)).collect();
                let labels = girvan_newman(graph.nodes(), &edges, teams);
                return Ok(Division { labels, vectors: None });
            }
            Self::Lle(modality) => {
                let graph = &system.graphs(&Nearness::Inverse)?[*modality];
                let rows = graph.to_dense().map_err(SystemError::from)?;
                let x = locally_linear_embedding(&rows, LLE_NEIGHBOURS, LLE_DIMENSION)?;
                (Vectors::of_all(x), kmeans)
            }
            Self::Hope(modality) => {
                let x = hope(&system.graphs(&Nearness::Inverse)?[*modality], teams)?;
                (Vectors::of_all(x), kmeans)
            }
            Self::HopeConcatenated => {
                let graphs = system.graphs(&Nearness::Inverse)?;
                let parts = graphs.iter().map(|graph| hope(graph, teams));
                let x = concatenated(&parts.collect::<Result<Vec<_>, _>>()?)?;
                (Vectors::of_all(x), kmeans)
            }
            Self::Single(modality, recipe) => {
                let mut graphs = system.graphs(&recipe.nearness)?;
                graphs[2] = system.command(recipe.upward, recipe.siblings)?;
                let graph = &graphs[*modality];
                (recipe.form.vectors(&[(graph, 1.0)], teams)?, recipe.clustering)
            }
            Self::Multimodal(_, recipe) => {
                let mut graphs = system.graphs(&recipe.nearness)?;
                graphs[2] = system.command(recipe.upward, recipe.siblings)?;
                return Ok(recipe.divide(&graphs, teams, seed)?);
            }
        };
        Ok(Division { labels: kmeans.divide(&vectors, teams, seed)?, vectors: Some(vectors.x) })
    }
}

/// High-order proximity preserved embedding: singular vectors of the Katz similarity of one graph, scaled by
/// the roots of their values.
fn hope(graph: &SparseMatrix, teams: usize) -> Result<DenseMatrix, MethodError> {
    let form = Form { power: 0.5, ..Recipe::plain().form };
    Ok(form.vectors(&[(graph, 1.0)], teams)?.x)
}

//! What can be asked for: one JSON object per line, `do` names the command.

use std::path::PathBuf;

use serde::Deserialize;

use crate::graph::Kind;
use crate::points::Form;

/// A fleet that moves by itself.
type Name = String;

#[derive(Debug, Deserialize)]
#[serde(tag = "do", rename_all = "snake_case")]
pub(crate) enum Command {
    /// Makes a fleet, its graph, and α with αρ = `fraction`. Takes the place of one of that name.
    Fleet {
        site: Name,
        robots: usize,
        graph: Kind,
        fraction: f64,
        seed: u64,
    },
    /// Moves all robots, or any one, by so many mean spacings.
    Advance {
        site: Name,
        spacings: f64,
        all: bool,
    },
    /// Writes the graph into the files `to`.starts, .columns and .weights.
    WriteGraph {
        site: Name,
        to: PathBuf,
    },
    /// Finds leading triplets, cold without a `stream`, and writes them into `to`.sigma, .u and .v.
    Solve {
        site: Name,
        stream: Option<String>,
        rank: usize,
        tolerance: f64,
        threads: usize,
        to: Option<PathBuf>,
    },
    /// Bounds the spectral radius, from the bound of the frame before.
    Bound {
        site: Name,
    },
    /// Brings the similarity of all pairs up to date.
    UpdateSimilarity {
        site: Name,
    },
    /// The paper's method to the letter, on faer.
    Literal {
        site: Name,
    },
    /// Reads points of `dims` numbers each.
    Points {
        from: PathBuf,
        dims: usize,
        clusters: usize,
        iterations: usize,
    },
    /// The labels that Muster's k-means finds.
    Labels,
    Kmeans,
    Linfa,
    Silhouette {
        form: Form,
    },
    /// Bytes per second for arrays of so many bytes together.
    Triad {
        bytes: usize,
    },
    /// Operations per second of products of dense matrices.
    Gemm,
    /// The same in single precision.
    SingleGemm,
    /// Square roots per second.
    Roots,
    /// How many times as much of either two threads do as one.
    TwoThreads {
        bytes: Option<usize>,
    },
    /// Seconds that handing work over to a thread that sleeps takes, there and back.
    HandOver,
    /// Forgets the peak of memory.
    ForgetPeak,
    /// Most resident bytes since then.
    Peak,
}

//! A fleet with its graph, and Muster's decompositions of it from frame to frame.

use std::collections::BTreeMap;

use muster_numeric::alpha_band::AlphaBand;
use muster_numeric::cached_katz::CachedKatz;
use muster_numeric::katz_svd::{KatzSvd, KatzSvdOptions, KatzSvdReport};
use muster_numeric::matrix::SparseMatrix;
use muster_numeric::radius_bound::{RadiusBound, RadiusTracker};
use muster_numeric::spectral_radius::SpectralRadius;
use muster_numeric::svd::RankKSvd;

use crate::Failure;
use crate::clock::{Seconds, timed};
use crate::fleet::Fleet;
use crate::graph::{Kind, graph};

/// Relative width of the bounds of the spectral radius: αρ is meant to be what is asked for.
const WIDTH: f64 = 1e-3;

/// By how much αρ may wander before α changes, as a share of what is asked for.
const HYSTERESIS: f64 = 0.05;

/// Seed of random directions.
const SEED: u64 = 1;

/// What is asked of a decomposition.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Wanted {
    pub(crate) rank: usize,
    pub(crate) tolerance: f64,
    pub(crate) threads: usize,
}

impl Wanted {
    fn options(self) -> KatzSvdOptions {
        let Self { rank, tolerance, threads } = self;
        KatzSvdOptions { rank, tolerance, seed: SEED, threads }
    }
}

/// A decomposition, and what it took.
pub(crate) struct Solved {
    /// Until singular values and residuals are known.
    pub(crate) seconds: Seconds,
    /// From there to U and V.
    pub(crate) vectors: Seconds,
    pub(crate) report: KatzSvdReport,
    pub(crate) svd: RankKSvd,
}

/// A fleet, its graph of the moment, and what is kept between frames.
pub(crate) struct Site {
    fleet: Fleet,
    kind: Kind,
    pub(crate) graph: SparseMatrix,
    band: AlphaBand,
    pub(crate) alpha: f64,
    radius: SpectralRadius,
    bounds: RadiusTracker,
    /// Number of the frame, and which rows of the graph differ from the last one, where few do: who makes
    /// the graph knows them.
    frame: u64,
    changed: Option<Vec<usize>>,
    /// Searches, and the frame that each has seen last.
    streams: BTreeMap<String, (KatzSvd, u64)>,
    tracker: RadiusTracker,
    similarity: CachedKatz,
}

impl Site {
    /// A fleet of `robots`, 1 or more, with αρ = `fraction`.
    pub(crate) fn new(
        robots: usize,
        kind: Kind,
        fraction: f64,
        seed: u64,
    ) -> Result<Self, Failure> {
        let fleet = Fleet::new(robots, seed);
        let graph = graph(&fleet, kind)?;
        let mut bounds = RadiusTracker::default();
        let bound = bounds.refine(&graph, WIDTH)?;
        let mut band = AlphaBand::new(fraction, HYSTERESIS)?;
        let alpha = band.choose(&graph, &bound).alpha;
        Ok(Self {
            radius: bounds.spectral_radius(&bound),
            fleet,
            kind,
            graph,
            band,
            alpha,
            bounds,
            frame: 0,
            changed: None,
            streams: BTreeMap::new(),
            tracker: RadiusTracker::default(),
            similarity: CachedKatz::default(),
        })
    }

    /// All robots move so many mean spacings, or any one does.
    pub(crate) fn advance(&mut self, spacings: f64, all: bool) -> Result<(), Failure> {
        if all {
            self.fleet.all_move(spacings);
        } else {
            self.fleet.one_moves(spacings);
        }
        let before = std::mem::replace(&mut self.graph, graph(&self.fleet, self.kind)?);
        self.frame += 1;
        self.changed = (!all).then(|| {
            let mut rows = Vec::new();
            before.differing_rows(&self.graph, self.graph.nodes(), &mut rows);
            rows
        });
        let bound = self.bounds.refine(&self.graph, WIDTH)?;
        self.alpha = self.band.choose(&self.graph, &bound).alpha;
        self.radius = self.bounds.spectral_radius(&bound);
        Ok(())
    }

    /// The bounds of the spectral radius that α rests on.
    pub(crate) fn radius(&self) -> (f64, f64) {
        (self.radius.lower, self.radius.upper)
    }

    /// Leading triplets: from nothing but the graph and α, memory and all, or from where the last frame of
    /// the stream ended. Streams do not know of each other.
    pub(crate) fn solve(
        &mut self,
        stream: Option<&str>,
        wanted: Wanted,
    ) -> Result<Solved, Failure> {
        let kept = stream.and_then(|stream| self.streams.remove(stream));
        let told = kept.as_ref().is_some_and(|(_, frame)| *frame + 1 == self.frame);
        let (graph, alpha, radius, options) =
            (&self.graph, self.alpha, &self.radius, wanted.options());
        let (seconds, (search, report)) = timed(|| {
            let mut search = kept.map_or_else(KatzSvd::default, |(search, _)| search);
            let report = match &self.changed {
                Some(rows) if told => search.solve_changed(graph, alpha, radius, options, rows),
                _ => search.solve(graph, alpha, radius, options, None),
            };
            (search, report)
        });
        let (vectors, svd) = timed(|| search.truncate(wanted.rank));
        if let Some(stream) = stream {
            self.streams.insert(stream.to_owned(), (search, self.frame));
        }
        Ok(Solved { seconds, vectors, report: report?, svd: svd? })
    }

    /// A bound of the spectral radius for the next frame of a fleet, from that of the last one.
    pub(crate) fn bound(&mut self) -> (Seconds, RadiusBound) {
        timed(|| self.tracker.bound(&self.graph))
    }

    /// The similarity of all pairs, brought up to date.
    pub(crate) fn update_similarity(&mut self) -> Result<Seconds, Failure> {
        let (seconds, update) =
            timed(|| self.similarity.update(&self.graph, self.alpha, &self.radius, None));
        update?;
        Ok(seconds)
    }
}

//! A fleet with its graph, and Muster's decompositions of it from frame to frame.

use std::collections::BTreeMap;
use std::sync::Arc;

use muster_method::Decay;
use muster_method::decomposition::LeadingTriplets;
use muster_model::id::RobotId;
use muster_numeric::alpha_band::AlphaBand;
use muster_numeric::cached_katz::CachedKatz;
use muster_numeric::katz_svd::{KatzSvdOptions, KatzSvdReport};
use muster_numeric::matrix::SparseMatrix;
use muster_numeric::radius_bound::{RadiusBound, RadiusTracker};
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
        KatzSvdOptions { exact: None, rank, tolerance, seed: SEED, threads }
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
    pub(crate) graph: Arc<SparseMatrix>,
    robots: Arc<[RobotId]>,
    band: AlphaBand,
    pub(crate) decay: Decay,
    bounds: RadiusTracker,
    /// What the services keep from frame to frame, one for each stream.
    streams: BTreeMap<String, LeadingTriplets>,
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
        let graph = Arc::new(graph(&fleet, kind)?);
        let names = (0..graph.nodes()).map(|robot| RobotId::new(format!("r{robot:09}")));
        let mut bounds = RadiusTracker::default();
        let bound = bounds.refine(&graph, WIDTH)?;
        let mut band = AlphaBand::new(fraction, HYSTERESIS)?;
        let alpha = band.choose(&graph, &bound).alpha;
        Ok(Self {
            decay: Decay { alpha, radius: bounds.spectral_radius(&bound) },
            robots: names.collect::<Result<Vec<_>, _>>()?.into(),
            fleet,
            kind,
            graph,
            band,
            bounds,
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
        self.graph = Arc::new(graph(&self.fleet, self.kind)?);
        let bound = self.bounds.refine(&self.graph, WIDTH)?;
        let alpha = self.band.choose(&self.graph, &bound).alpha;
        self.decay = Decay { alpha, radius: self.bounds.spectral_radius(&bound) };
        Ok(())
    }

    /// The bounds of the spectral radius that α rests on.
    pub(crate) fn radius(&self) -> (f64, f64) {
        (self.decay.radius.lower, self.decay.radius.upper)
    }

    /// Leading triplets by the function that the services call: from nothing but the graph and α, memory and
    /// all, or from where the last frame of the stream ended. Streams do not know of each other.
    pub(crate) fn solve(
        &mut self,
        stream: Option<&str>,
        wanted: Wanted,
    ) -> Result<Solved, Failure> {
        let kept = stream.and_then(|stream| self.streams.remove(stream));
        let (graph, decay, robots) = (&self.graph, &self.decay, &self.robots);
        let options = wanted.options();
        let (seconds, (leading, report)) = timed(|| {
            let mut leading = kept.unwrap_or_default();
            let report = leading.advance(graph, decay, robots, options, &mut |_| {});
            (leading, report)
        });
        let (vectors, svd) = timed(|| leading.truncate(wanted.rank));
        if let Some(stream) = stream {
            self.streams.insert(stream.to_owned(), leading);
        }
        Ok(Solved { seconds, vectors, report: report?, svd: svd? })
    }

    /// A bound of the spectral radius for the next frame of a fleet, from that of the last one.
    pub(crate) fn bound(&mut self) -> (Seconds, RadiusBound) {
        timed(|| self.tracker.bound(&self.graph))
    }

    /// The similarity of all pairs, brought up to date.
    pub(crate) fn update_similarity(&mut self) -> Result<Seconds, Failure> {
        let Decay { alpha, radius } = &self.decay;
        let alpha = *alpha;
        let (seconds, update) = timed(|| self.similarity.update(&self.graph, alpha, radius, None));
        update?;
        Ok(seconds)
    }
}

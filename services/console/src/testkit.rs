//! Messages for the tests of this crate.

use muster_model::embedding::{Embedding, EmbeddingMode, EmbeddingQuality};
use muster_model::header::{Header, Revision};
use muster_model::id::{FleetId, RobotId};
use muster_model::time::Tick;

fn header(epoch: u64) -> Header {
    Header {
        fleet: FleetId::new("alpha").unwrap(),
        revision: Revision { term: 1, epoch },
        oldest: Some(Tick(1_000_000)),
        newest: Some(Tick(1_000_000 * epoch)),
        stages: Vec::new(),
    }
}

fn robot(name: &str) -> RobotId {
    RobotId::new(name).unwrap()
}

/// An embedding with these rows, of robots that are named by their number.
pub(crate) fn embedding<const D: usize>(rows: &[[f64; D]]) -> Embedding {
    Embedding {
        header: header(1),
        roster: Revision::default(),
        graphs: Vec::new(),
        robots: (0..rows.len()).map(|number| robot(&format!("r{number:05}"))).collect(),
        dimension: u32::try_from(D).unwrap(),
        values: rows.iter().flatten().copied().collect(),
        without_embedding: vec![false; rows.len()],
        provisional: vec![false; rows.len()],
        centrality: vec![1.0; rows.len()],
        quality: EmbeddingQuality {
            spectral_radius: (1.0, 1.0),
            alpha: 0.5,
            singular_values: Vec::new(),
            next_singular_value: 0.0,
            residual: 0.0,
            katz_residual: 0.0,
            gap: 1.0,
            ambiguous: false,
            mode: EmbeddingMode::Dense,
            teams_shown: None,
            team_scores: Vec::new(),
            stage_us: [0; 3],
        },
    }
}

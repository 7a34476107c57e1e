//! Vectors that a test or a benchmark has made up, as the embedder would publish them.

use muster_model::embedding::{Embedding, EmbeddingMode, EmbeddingQuality};
use muster_model::header::{Header, Revision};
use muster_model::id::{FleetId, RobotId};

/// A number from 0 to 1 for each pair of numbers.
pub(crate) fn noise(a: usize, b: usize) -> f64 {
    let mixed = (a as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15)
        ^ (b as u64).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    (mixed.wrapping_mul(0x94d0_49bb_1331_11eb) >> 11) as f64 / (1_u64 << 53) as f64
}

/// Robots `r000000` and so on with these vectors, of which each has so many values.
pub(crate) fn embedding(dimension: usize, values: Vec<f64>) -> Embedding {
    let robots = values.len() / dimension;
    Embedding {
        header: Header {
            fleet: FleetId::new("bench").unwrap(),
            revision: Revision::default(),
            oldest: None,
            newest: None,
            stages: Vec::new(),
        },
        roster: Revision::default(),
        graphs: Vec::new(),
        robots: (0..robots).map(|robot| RobotId::new(format!("r{robot:06}")).unwrap()).collect(),
        dimension: dimension as u32,
        values,
        without_embedding: vec![false; robots],
        provisional: vec![false; robots],
        centrality: Vec::new(),
        quality: EmbeddingQuality {
            spectral_radius: (1.0, 1.0),
            alpha: 0.9,
            singular_values: vec![1.0; dimension / 2],
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

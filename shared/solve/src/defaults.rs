//! The settings of what a file leaves out.

use muster_model::settings::{
    CentroidStart, ClustererSettings, EmbedderSettings, Normalization, Trusted,
};

use super::options::Preset;

/// From graphs to vectors: the settings of the preset, or else of the live fleet. A file that asks for another
/// scale of its graphs than the live fleet's asks for the plain mathematics: A* is the weighted sum of the
/// graphs then, without self-loops and with all modalities trusted.
pub(super) fn embedder(
    preset: Option<Preset>,
    normalize: Option<Normalization>,
) -> EmbedderSettings {
    let live = EmbedderSettings::default();
    match (preset, normalize) {
        (Some(Preset::Paper), _) => EmbedderSettings::paper(),
        (None, Some(Normalization::None | Normalization::Spectral)) => {
            EmbedderSettings { self_loops: 0.0, trusted: Trusted::All, ..live }
        }
        (None, Some(Normalization::Degree) | None) => live,
    }
}

/// From vectors to teams: k-means as the live fleet does it, or once from a random start as in the paper.
pub(super) fn clusterer(preset: Option<Preset>) -> ClustererSettings {
    let live = ClustererSettings::default();
    match preset {
        Some(Preset::Paper) => {
            ClustererSettings { init: CentroidStart::Random, restarts: 1, ..live }
        }
        None => live,
    }
}

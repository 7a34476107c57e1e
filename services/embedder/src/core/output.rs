//! What is published of an embedding, and when it is published again.

use std::sync::Arc;
use std::time::Duration;

use muster_model::content::Checked;
use muster_model::embedding::{Embedding, EmbeddingGraph, EmbeddingMode};
use muster_model::settings::EmbedderSettings;
use muster_service::following::Frame;
use muster_wire::Message;

use super::{Context, Embedder};
use crate::compute::{Basis, Computed};
use crate::doubt::ModalityTrust;

/// How often an embedding is republished while rosters arrive and its basis does not change, so that its
/// readers see that the data behind it is fresh.
const HEARTBEAT: Duration = Duration::from_secs(1);

/// Difference of two coordinates of the same vector that is rounding.
const ROUNDING: f64 = 1e-10;

impl Embedder {
    pub(super) fn accept_embedding(
        &mut self,
        context: &mut Context<'_>,
        frame: Arc<Frame>,
        basis: Basis,
        computed: Computed,
    ) {
        let now = context.now();
        context.count("jobs_done");
        self.computed = Some((basis.clone(), now));
        let frame = if basis.at_rest { self.newest_of(context, &basis, frame) } else { frame };
        let roster = &frame.roster;
        let last = self.embedding.as_ref().map(|last| last.roster);
        let newest = self.follow.frame().map(|newest| newest.roster.header.revision);
        // A roster above the newest frame is no longer followed: it was forged, or its sender has begun without its state.
        if last > Some(roster.header.revision) && last <= newest {
            // The last one was republished for a later frame meanwhile: other settings were undone, for example. The next
            // job is for the newest frame; until then its vectors are not those that were published.
            if !basis.at_rest {
                self.vectors_since = None;
            }
            return;
        }
        // What the leader before has published is no output of this one.
        let has_published = self.published.is_some();
        if has_published && basis.at_rest && self.is_published(context.settings(), &computed) {
            // Readers need not receive the same digits again.
            context.count("embeddings_confirmed");
            return;
        }
        self.disagreeing = computed.disagreeing;
        let stage = context.stage(frame.received);
        let embedding = Embedding {
            header: roster.header.next_stage(context.next_revision(), stage),
            roster: roster.header.revision,
            graphs: computed.graphs,
            robots: basis.robots.to_vec(),
            dimension: computed.dimension,
            values: computed.values,
            without_embedding: computed.without_embedding,
            provisional: computed.provisional,
            centrality: computed.centrality,
            quality: computed.quality,
        };
        self.published = Some((basis, now));
        self.vectors_since = Some(embedding.header.revision);
        self.publish(context, embedding);
    }

    /// The newest frame if it has the same basis as the frame of the job: while the job ran, the embedding
    /// may have been republished with the header of a later roster.
    fn newest_of(&mut self, context: &Context<'_>, basis: &Basis, frame: Arc<Frame>) -> Arc<Frame> {
        let newest = self.follow.frame().cloned();
        newest.filter(|newest| self.basis(context, newest).is_of(basis)).unwrap_or(frame)
    }

    /// Whether what was computed for a fleet at rest equals what was published, within the tolerance.
    fn is_published(&self, settings: &EmbedderSettings, computed: &Computed) -> bool {
        let Some(last) = &self.embedding else { return false };
        let near = |(new, old): (&f64, &f64)| (new - old).abs() <= ROUNDING;
        last.quality.residual <= settings.idle_tolerance
            && last.dimension == computed.dimension
            && last.values.len() == computed.values.len()
            && computed.values.iter().zip(&last.values).all(near)
    }

    fn publish(&mut self, context: &mut Context<'_>, embedding: Embedding) {
        context.count("embeddings_published");
        self.was_suppressed = !context.is_leading();
        let embedding = Checked::new_unchecked(embedding);
        self.shape.note(context.now(), &embedding);
        self.embedding = Some(embedding.clone());
        context.publish(Message::Embedding(embedding.clone()));
        self.report_doubts(context, &embedding);
    }

    /// Reports modalities that are in doubt, or trusted again, with every embedding: one that is
    /// republished shows that the trust has stayed. A suspect does not: its output would be lost.
    fn report_doubts(&mut self, context: &mut Context<'_>, embedding: &Embedding) {
        if !context.is_leading() {
            return;
        }
        let trust = |graph: &EmbeddingGraph| ModalityTrust {
            modality: graph.modality.clone(),
            trust: graph.trust,
            robots: self.disagreeing.get(&graph.modality).cloned().unwrap_or_default(),
        };
        let all = embedding.graphs.iter().map(trust).collect();
        for event in self.doubts.observe(context.now(), all) {
            context.publish_event(event.severity, event.kind);
        }
    }

    /// Republishes the last good embedding as it is, with the next revision.
    pub(super) fn republish(&mut self, context: &mut Context<'_>) {
        let Some(embedding) = &self.embedding else { return };
        let mut republished = unchanged(embedding);
        republished.header.revision = context.next_revision();
        if let Some(stage) = republished.header.stages.last_mut() {
            stage.published = context.now();
        }
        if let Some((_, at)) = &mut self.published {
            *at = context.now();
        }
        self.publish(context, republished);
    }

    /// Republishes the embedding with the header of the newest roster, if its basis is that of the newest
    /// frame and the heartbeat is due; or notes when that will be due.
    pub(super) fn republish_when_due(
        &mut self,
        context: &mut Context<'_>,
        frame: &Frame,
        basis: &Basis,
    ) {
        let (Some((of, at)), Some(embedding)) = (&self.published, &self.embedding) else { return };
        let roster = &frame.roster.header;
        if !of.is_of(basis) || roster.revision == embedding.roster {
            return;
        }
        let due = at.after(HEARTBEAT);
        if context.now() < due {
            self.heartbeat = Some(due);
            return;
        }
        let mut republished = unchanged(embedding);
        let stage = context.stage(frame.received);
        republished.header = roster.next_stage(context.next_revision(), stage);
        republished.roster = roster.revision;
        self.published = Some((basis.clone(), context.now()));
        self.publish(context, republished);
    }
}

/// An embedding as it is republished: nothing was computed for it.
fn unchanged(embedding: &Embedding) -> Embedding {
    let mut republished = embedding.clone();
    republished.quality.mode = EmbeddingMode::Cached;
    republished.quality.stage_us = [0; 3];
    republished
}

//! Which scores of divisions are worth a record: in a fleet that moves they change with every frame.

use std::sync::Arc;
use std::time::Duration;

use muster_model::audit::Audit;
use muster_model::history::AuditRecord;
use muster_model::time::Tick;
use muster_service::{Newest, Recency};

/// The scores as they are recorded.
#[derive(Debug, Default)]
pub(crate) struct Audits {
    /// The newest that was received.
    newest: Option<Arc<Audit>>,
    newest_revision: Newest,
    /// What was recorded last, and when.
    recorded: Option<(Arc<Audit>, Tick)>,
}

impl Audits {
    /// Receives scores; those that are older than the newest are left out.
    pub(crate) fn receive(&mut self, now: Tick, audit: Arc<Audit>) {
        if self.newest_revision.receive(now, audit.header.revision) != Recency::Old {
            self.newest = Some(audit);
        }
    }

    /// When the newest scores are to be recorded; none if they say the same as those that are.
    pub(crate) fn due(&self, interval: Duration) -> Option<Tick> {
        let newest = self.newest.as_ref()?;
        let Some((recorded, at)) = &self.recorded else { return Some(Tick(0)) };
        if newest.quality != recorded.quality {
            return Some(Tick(0));
        }
        let same = newest.in_embedding.mean == recorded.in_embedding.mean
            && newest.in_embedding.per_team == recorded.in_embedding.per_team
            && newest.in_physical.mean == recorded.in_physical.mean;
        (!same).then(|| at.after(interval))
    }

    /// What was recorded may be lost: the newest scores are recorded again.
    pub(crate) fn forget(&mut self) {
        self.recorded = None;
    }

    /// The newest scores, if they are to be recorded now.
    pub(crate) fn take(&mut self, now: Tick, interval: Duration) -> Option<AuditRecord> {
        let newest = self.newest.clone().filter(|_| self.due(interval).is_some_and(|at| at <= now));
        let audit = newest?;
        self.recorded = Some((Arc::clone(&audit), now));
        Some(AuditRecord {
            revision: audit.header.revision,
            division: audit.teams,
            mean: audit.in_embedding.mean,
            physical_mean: audit.in_physical.mean,
            verdict: audit.quality,
            per_team: audit.in_embedding.per_team.clone(),
        })
    }
}

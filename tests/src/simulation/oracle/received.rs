//! What can be judged of a real bus, by an observer who may have missed what a message names: its link was
//! lost, or two publishers were carried in another order.

use muster_model::header::Revision;
use muster_wire::Message;

use super::{Breach, Oracle, Published, Verified, division, finite, silhouettes};

/// Whether what a message names was there to judge it by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Judged {
    /// The message was judged with what it names.
    Whole,
    /// What it names was not received: it was judged alone.
    Alone,
}

impl<T: Clone + PartialEq> Published<T> {
    /// Remembers what was received, once: services repeat themselves.
    fn receive(&mut self, revision: Revision, content: &T) {
        if !self.named(revision).contains(content) {
            self.add(revision, content);
        }
    }
}

impl Oracle {
    /// Judges what an observer receives from a service: alone, and by what it names where that was received.
    pub(crate) fn received(&mut self, message: &Message) -> Result<Judged, Breach> {
        finite::check(message)?;
        let judged = match message {
            Message::Roster(roster) => {
                division::check_roster(roster)?;
                self.rosters.receive(roster.header.revision, roster);
                Judged::Whole
            }
            Message::Embedding(embedding) => {
                let has_roster = !self.rosters.named(embedding.roster).is_empty();
                let judged =
                    of(has_roster, || division::check_embedding(embedding, &self.rosters))?;
                self.embeddings.receive(embedding.header.revision, embedding);
                judged
            }
            Message::Teams { teams, .. } => {
                division::check_teams(teams)?;
                let has_embedding = !self.embeddings.named(teams.embedding).is_empty();
                let judged =
                    of(has_embedding, || division::check_division(teams, &self.embeddings))?;
                self.divisions.receive(teams.header.revision, teams);
                judged
            }
            Message::RobotTeam(team) => {
                let has_division = !self.divisions.named(team.header.revision).is_empty();
                of(has_division, || division::check_robot_team(team, &self.divisions))?
            }
            Message::Audit(audit) => {
                let embedding = self.embeddings.named(audit.embedding).first();
                let has_all = embedding.is_some_and(|embedding| {
                    let divisions = self.divisions.named(audit.teams);
                    divisions.iter().any(|teams| teams.embedding == audit.embedding)
                        && !self.rosters.named(embedding.roster).is_empty()
                });
                of(has_all, || silhouettes::check(audit, self))?
            }
            _ => Judged::Whole,
        };
        Ok(judged)
    }
}

fn of(is_there: bool, check: impl FnOnce() -> Verified) -> Result<Judged, Breach> {
    if !is_there {
        return Ok(Judged::Alone);
    }
    check().map(|()| Judged::Whole)
}

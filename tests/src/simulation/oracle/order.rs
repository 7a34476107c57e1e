//! Revisions go forward: those that a service gives, and those that it goes by.

use std::collections::BTreeMap;

use muster_model::header::Revision;
use muster_model::id::ServiceName;
use muster_wire::Message;

use super::{Verdict, breach};

/// The newest revisions of each instance of each service.
#[derive(Debug, Default)]
pub(crate) struct Order {
    /// The last that an instance gave on each key, over all its processes: its terms are kept on disk.
    given: BTreeMap<(ServiceName, usize, String), Revision>,
    /// The last of another service's that a process went by.
    taken: BTreeMap<(ServiceName, usize, u32, &'static str), Revision>,
}

impl Order {
    /// An instance has lost its disk, and with it its terms.
    pub(crate) fn forget(&mut self, service: ServiceName, instance: usize) {
        self.given.retain(|(of, number, _), _| (*of, *number) != (service, instance));
    }

    /// Takes in what a service publishes.
    pub(crate) fn check(
        &mut self,
        service: ServiceName,
        instance: usize,
        process: u32,
        message: &Message,
    ) -> Verdict {
        let Some(header) = message.header() else { return Ok(()) };
        let revision = header.revision;
        let (key, _) = message.keys();
        // What robots are told is the division of that revision, and what a holder claims is its last
        // output; settings may change between two outputs, and events have a count of their own.
        let repeats =
            matches!(message, Message::RobotTeam(_) | Message::Settings(_) | Message::Claim(_));
        let counts = !repeats;
        let place = (service, instance, key.to_string());
        let last = self.given.get(&place).copied();
        if last.is_some_and(|last| revision < last || counts && revision == last) {
            return breach(
                "epochs grow within a term, and terms never go back",
                format!("{service}/{instance} publishes {key} {revision:?} after {last:?}"),
            );
        }
        self.given.insert(place, revision);
        let named = match message {
            Message::Embedding(embedding) => vec![("roster", embedding.roster)],
            Message::Teams { teams, .. } => vec![("embedding", teams.embedding)],
            Message::Audit(audit) => vec![("teams", audit.teams)],
            _ => Vec::new(),
        };
        for (what, revision) in named {
            let place = (service, instance, process, what);
            let last = self.taken.get(&place).copied();
            if last.is_some_and(|last| revision < last) {
                return breach(
                    "a reader never goes back to a lower term or epoch",
                    format!(
                        "{key} of {service}/{instance} names {what} {revision:?} after {last:?}"
                    ),
                );
            }
            self.taken.insert(place, revision);
        }
        Ok(())
    }
}

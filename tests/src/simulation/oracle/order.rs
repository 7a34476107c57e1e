//! Revisions go forward: those that a service gives, those that it goes by, and those that a new
//! holder of its role begins with.

use std::collections::BTreeMap;

use muster_model::header::Revision;
use muster_model::id::ServiceName;
use muster_wire::Message;

use super::super::clock::{MS, Micros};
use super::{Speaker, Verdict, breach};

/// How long after a claim an instance that begins its term may not have heard of it: links take a
/// millisecond, events some, and what was put before them in the queue as long.
const CLAIM_HEARD: Micros = 100 * MS;

/// The newest revisions of each instance of each service.
#[derive(Debug, Default)]
pub(crate) struct Order {
    /// The last that an instance gave on each key, over all its processes: its terms are kept on disk.
    given: BTreeMap<(ServiceName, usize, String), Revision>,
    /// The last of another service's that a process went by.
    taken: BTreeMap<(Speaker, &'static str), Revision>,
    /// Who published last on each key, and the highest term on it.
    holders: BTreeMap<String, (Speaker, u64)>,
    /// When each process last claimed its role.
    claims: BTreeMap<Speaker, Micros>,
    /// Until when something may keep an instance of a service from hearing a claim.
    disturbed_until: BTreeMap<ServiceName, Micros>,
    /// How many takeovers were judged.
    pub(crate) takeovers: u64,
}

impl Order {
    /// An instance has lost its disk, and with it its terms.
    pub(crate) fn forget(&mut self, service: ServiceName, instance: usize) {
        self.given.retain(|(of, number, _), _| (*of, *number) != (service, instance));
    }

    /// Until a moment, an instance of a service, or of any if none is named, may not hear what another
    /// one claims, or hears what is not so.
    pub(crate) fn disturbed(&mut self, service: Option<ServiceName>, until: Micros) {
        for other in ServiceName::ALL {
            if service.is_none_or(|service| service == other) {
                let before = self.disturbed_until.entry(other).or_default();
                *before = until.max(*before);
            }
        }
    }

    /// Takes in what a service publishes.
    pub(crate) fn check(&mut self, now: Micros, speaker: Speaker, message: &Message) -> Verdict {
        let Some(header) = message.header() else { return Ok(()) };
        let revision = header.revision;
        let key = message.keys().0.to_string();
        self.check_takeover(now, speaker, &key, message, revision)?;
        // What robots are told is the division of that revision, and what a holder claims is its last
        // output; settings may change between two outputs, and events have a count of their own.
        let repeats =
            matches!(message, Message::RobotTeam(_) | Message::Settings(_) | Message::Claim(_));
        let counts = !repeats;
        let Speaker { service, instance, .. } = speaker;
        // A process that is killed before its term is on the disk begins it again. Readers tell it what
        // it gave, but for events, which nobody keeps.
        let of_process = matches!(message, Message::Event(_));
        let key = if of_process { format!("{key} of process {}", speaker.process) } else { key };
        let place = (service, instance, key);
        let last = self.given.get(&place).copied();
        let key = &place.2;
        if last.is_some_and(|last| revision < last || counts && revision == last) {
            return breach(
                "epochs grow within a term, and terms never go back",
                format!("{service}/{instance} publishes {key} {revision:?} after {last:?}"),
            );
        }
        let named = match message {
            Message::Embedding(embedding) => vec![("roster", embedding.roster)],
            Message::Teams { teams, .. } => vec![("embedding", teams.embedding)],
            Message::Audit(audit) => vec![("teams", audit.teams)],
            _ => Vec::new(),
        };
        for (what, revision) in named {
            let last = self.taken.insert((speaker, what), revision);
            if last.is_some_and(|last| revision < last) {
                return breach(
                    "a reader never goes back to a lower term or epoch",
                    format!(
                        "{key} of {service}/{instance} names {what} {revision:?} after {last:?}"
                    ),
                );
            }
        }
        self.given.insert(place, revision);
        Ok(())
    }

    /// Whoever publishes on a key after another process was told of its term, by a claim or by those
    /// who read it, unless something has kept that from it since the other's last claim.
    fn check_takeover(
        &mut self,
        now: Micros,
        speaker: Speaker,
        key: &str,
        message: &Message,
        revision: Revision,
    ) -> Verdict {
        match message {
            Message::Claim(_) => {
                self.claims.insert(speaker, now);
                return Ok(());
            }
            Message::Graph(_)
            | Message::Roster(_)
            | Message::Embedding(_)
            | Message::Teams { .. }
            | Message::Audit(_) => {}
            _ => return Ok(()),
        }
        let before = self.holders.get(key).copied();
        let highest = before.map_or(0, |(_, highest)| highest);
        self.holders.insert(key.to_owned(), (speaker, highest.max(revision.term)));
        let Some((holder, highest)) = before.filter(|(holder, _)| *holder != speaker) else {
            return Ok(());
        };
        let Some(claimed) = self.claims.get(&holder) else { return Ok(()) };
        let disturbed_until = self.disturbed_until.get(&speaker.service).copied();
        if *claimed < disturbed_until.unwrap_or_default() || now < claimed + CLAIM_HEARD {
            return Ok(());
        }
        self.takeovers += 1;
        if revision.term > highest {
            return Ok(());
        }
        breach(
            "who takes a role over begins above every term of it",
            format!("{speaker:?} publishes {key} {revision:?} after term {highest} of {holder:?}"),
        )
    }
}

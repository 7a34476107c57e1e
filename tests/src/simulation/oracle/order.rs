//! Revisions go forward: those that a service gives, those that it goes by, and those that a new leader
//! begins with.

use std::collections::BTreeMap;
use std::sync::Arc;

use muster_model::command::CommandOutcome;
use muster_model::header::Revision;
use muster_model::id::ServiceName;
use muster_wire::Message;

use super::super::clock::{BEGINNING, MS, Micros, SECOND};
use super::{Publisher, Verified, breach};

/// How long after a lease renewal an instance that begins its term may not have handled it: links take a
/// millisecond, inputs some, and those that wait before it as long.
const RENEWAL_DELAY: Micros = 100 * MS;

/// The highest term that anybody may begin, by a clock that is right: 68 years ahead, and a minute for
/// clocks that differ and leaders that follow each other.
pub(super) fn highest_term(now: Micros) -> u64 {
    (BEGINNING + now) / SECOND + 2_147_483_648 + 60
}

/// How far clocks that are right to some seconds may be behind.
const CLOCKS_BEHIND: Micros = 5 * SECOND;

/// The highest term that every service believes, by clocks that are right to some seconds. A term above one that was forged
/// at the bound is believed by the last of them once the bound has risen so far.
fn term_believed_by_all(now: Micros) -> u64 {
    (BEGINNING + now).saturating_sub(CLOCKS_BEHIND) / SECOND + 2_147_483_648
}

/// The newest revisions of each instance of each service.
#[derive(Debug, Default)]
pub(crate) struct Order {
    /// The last that an instance gave on each key, over all its processes: its terms are kept on disk.
    given: BTreeMap<(ServiceName, usize, String), Revision>,
    /// The last of another service's that a process went by.
    taken: BTreeMap<(ServiceName, &'static str), (Publisher, Revision)>,
    /// The last publisher of each key, and the highest term of each that has published on it.
    publishers: BTreeMap<String, (Publisher, BTreeMap<Publisher, u64>)>,
    /// What each instance said that came of each command, by its key.
    outcomes: BTreeMap<String, BTreeMap<usize, Arc<CommandOutcome>>>,
    /// When each process last renewed its lease.
    renewals: BTreeMap<Publisher, Micros>,
    /// Until when something may keep an instance of a service from receiving a lease renewal.
    disturbed_until: BTreeMap<ServiceName, Micros>,
    /// How many takeovers were checked.
    pub(crate) takeovers: u64,
}

impl Order {
    /// An instance has lost its disk, and with it its terms.
    pub(crate) fn forget(&mut self, service: ServiceName, instance: usize) {
        self.given.retain(|(of, number, _), _| (*of, *number) != (service, instance));
    }

    /// The highest term of which an instance of a service has published anything.
    pub(crate) fn highest_given(&self, service: ServiceName) -> u64 {
        let of_service = self.given.iter().filter(|((of, ..), _)| *of == service);
        of_service.map(|(_, revision)| revision.term).max().unwrap_or_default()
    }

    /// Until a moment, an instance of a service, or of any if none is named, may not receive the lease
    /// renewals of another one, or receives forged messages.
    pub(crate) fn disturbed(&mut self, service: Option<ServiceName>, until: Micros) {
        for other in ServiceName::PIPELINE {
            if service.is_none_or(|service| service == other) {
                let before = self.disturbed_until.entry(other).or_default();
                *before = until.max(*before);
            }
        }
    }

    /// Whether what came of a command was published before: an instance that led says it again to whoever leads now. After a
    /// restart it says what it has on its disk, of another leader of the same term as well.
    fn is_repeated(
        &mut self,
        publisher: Publisher,
        key: &str,
        outcome: &Arc<CommandOutcome>,
    ) -> bool {
        let said = self.outcomes.entry(key.to_owned()).or_default();
        let is_repeated = said.values().any(|before| before == outcome);
        said.insert(publisher.instance, Arc::clone(outcome));
        is_repeated
    }

    /// Checks what a service publishes.
    pub(crate) fn check(
        &mut self,
        now: Micros,
        publisher: Publisher,
        message: &Message,
    ) -> Verified {
        let Some(header) = message.header() else { return Ok(()) };
        let revision = header.revision;
        if revision.term > highest_term(now) {
            return breach(
                "no service begins a term that others do not believe",
                format!("{publisher:?} publishes {revision:?}"),
            );
        }
        let key = message.keys().0.to_string();
        if let Message::Outcome(outcome) = message
            && self.is_repeated(publisher, &key, outcome)
        {
            return Ok(());
        }
        self.check_takeover(now, publisher, &key, message, revision)?;
        // Robots receive the division of that revision, and a lease renewal names the last output;
        // settings may change between two outputs, and events have a count of their own.
        let repeats = matches!(
            message,
            Message::RobotTeam(_) | Message::Settings(_) | Message::LeaseRenewal(_)
        );
        let counts = !repeats;
        let Publisher { service, instance, .. } = publisher;
        // A process that is killed before its term is on the disk begins it again. Readers answer with
        // what it gave, except events, refusals and wishes, which no reader keeps.
        let of_process =
            matches!(message, Message::Event(_) | Message::Refused(_) | Message::Wishes(_));
        let key = if of_process { format!("{key} of process {}", publisher.process) } else { key };
        let place = (service, instance, key);
        if matches!(message, Message::Settings(_)) && revision.term == 0 {
            // A leader that has lost its state does not say that these are the settings of the fleet.
            return Ok(());
        }
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
            let last = self.taken.insert((service, what), (publisher, revision));
            // One that leads again after another one goes on from what that has published.
            let last = last.filter(|(of, _)| *of == publisher).map(|(_, last)| last);
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

    /// A process that publishes on a key after another one knows its term, by a lease renewal or from its
    /// readers, unless something has kept that from it since the other's last renewal.
    fn check_takeover(
        &mut self,
        now: Micros,
        publisher: Publisher,
        key: &str,
        message: &Message,
        revision: Revision,
    ) -> Verified {
        match message {
            Message::LeaseRenewal(_) => {
                self.renewals.insert(publisher, now);
                return Ok(());
            }
            Message::Graph(_)
            | Message::Roster(_)
            | Message::Embedding(_)
            | Message::Teams { .. }
            | Message::Audit(_) => {}
            _ => return Ok(()),
        }
        let (last, terms) =
            self.publishers.entry(key.to_owned()).or_insert_with(|| (publisher, BTreeMap::new()));
        let former = std::mem::replace(last, publisher);
        let own = terms.entry(publisher).or_default();
        *own = revision.term.max(*own);
        if former == publisher {
            return Ok(());
        }
        // Two that began at once: the one of the higher term goes on, in its own term.
        let of_others = terms.iter().filter(|(of, _)| **of != publisher).map(|(_, term)| *term);
        let believed = term_believed_by_all(now);
        let highest = of_others.filter(|term| *term <= believed).max().unwrap_or(0);
        let Some(renewed) = self.renewals.get(&former) else { return Ok(()) };
        let disturbed_until = self.disturbed_until.get(&publisher.service).copied();
        if *renewed < disturbed_until.unwrap_or_default() {
            // All that is known of earlier terms may be lost: later leaders begin above those of this one.
            terms.retain(|of, _| *of == publisher);
            return Ok(());
        }
        if now < renewed + RENEWAL_DELAY {
            return Ok(());
        }
        self.takeovers += 1;
        if revision.term > highest {
            return Ok(());
        }
        breach(
            "a new leader begins above every term of its service",
            format!(
                "{publisher:?} publishes {key} {revision:?} after term {highest} of {former:?}"
            ),
        )
    }
}

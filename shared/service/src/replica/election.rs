//! Which of several instances of a service leads.
//!
//! Leases give liveness: the leader renews its lease several times a second ([`LeaseRenewal`]). When
//! its token is lost or it falls silent, the lowest standby takes over. Terms give safety: a new
//! leader begins a higher term, and a leader that receives a higher one stands down. A leader that
//! lost its link or was paused becomes *suspect*: its output is suppressed until a query for the
//! current leader goes unanswered. One whose term nobody can have learnt of stands down for a leader that
//! works, whatever its term. No instance replaces a leader that lives, unless
//! its term is outdated: one that another instance began before, unknown to the leader.

use std::collections::BTreeSet;
use std::time::Duration;

use muster_model::header::Revision;
use muster_model::id::InstanceId;
use muster_model::role::{LeaseRenewal, ReplicaState};
use muster_model::time::Tick;

use crate::replica::lease::{Lease, RENEWAL_INTERVAL};
use crate::replica::peers::{MAX_PEERS, Peers};
use crate::wiring::Replication;

/// How long a leader may be silent before another instance takes over: the lease of the bus, so that
/// a process that hangs with its link up is replaced as soon as one whose link is dead.
pub const LEASE: Duration = Duration::from_secs(2);

/// A leader that did not run for so long may have been replaced. It is less than [`LEASE`], so that
/// the suspicion comes first.
const PAUSE: Duration = Duration::from_millis(1500);

/// Time after a reconnect or pause during which an unanswered query proves nothing: a query sent over
/// a dead or brand-new link is never answered. By then the link's loss is noticed, or a renewal of
/// whoever took over was received.
const LINK_PROOF: Duration = RENEWAL_INTERVAL.saturating_add(Duration::from_millis(200));

/// Grace period for a lost token: a lost link takes all tokens away a moment before it is noticed
/// itself, and then proves nothing about any instance.
const TOKEN_GRACE: Duration = Duration::from_millis(200);

/// Renewals of an outdated term after which an instance that began that term, or a higher one, takes over.
/// Where two instances begin the same term at once, one of them raises its own within fewer renewals.
const OUTDATED_RENEWALS: u32 = 3;

/// Another instance that leads.
#[derive(Debug, Clone)]
struct Leader {
    instance: InstanceId,
    revision: Revision,
    renewed: Tick,
}

/// What an instance that does not lead knows and waits for.
#[derive(Debug, Clone)]
struct Candidate {
    leader: Option<Leader>,
    /// When it takes over as a standby, unless the leader renews before.
    take_over_at: Tick,
    /// Whether it has asked the bus and waits for the answers.
    asking: bool,
    /// Whether the standbys before it had time to take over.
    waited: bool,
    /// Other instances that have appeared since the inquiry began, and are still there: they may not have been asked.
    appeared: BTreeSet<InstanceId>,
    /// Whether more have appeared than are noted.
    is_crowded: bool,
    /// Whether the token of another instance was lost since the inquiry began.
    has_lost: bool,
    /// Whether it has asked once more because of one of these.
    asked_again: bool,
    /// How many renewals in a row were of a term that this instance began itself, or of a lower one.
    outdated_renewals: u32,
    /// The term of a leader that this instance takes over from, though that lives.
    replaces: Option<u64>,
}

/// What a leader that was cut off or paused waits for.
#[derive(Debug, Clone, Default)]
struct Suspicion {
    /// The query for the current leader that was sent after the newest cause of the suspicion. One
    /// that was sent before proves nothing.
    query: Option<u64>,
    /// Whether that query went unanswered.
    unopposed: bool,
}

#[derive(Debug, Clone)]
enum State {
    Starting(Candidate),
    Standby(Candidate),
    Suspect(Suspicion),
    Leading(Lease),
}

/// Where an instance stands, and what it knows of the others.
#[derive(Debug, Clone)]
pub(crate) struct Election {
    instance: InstanceId,
    replication: Replication,
    state: State,
    peers: Peers,
    /// The highest term that another instance has claimed.
    highest_term: u64,
    linked: bool,
    /// From when on an unanswered query means that there is no other instance.
    silence_proves_from: Tick,
    /// When this instance last ran.
    last_run: Tick,
    /// Whether anything was received of others while this instance led in its present term. If nothing was,
    /// the link may have been dead when the term began.
    has_heard_others: bool,
}

/// What a lease renewal of another instance means for this one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Rivalry {
    /// Nothing changes.
    None,
    /// The other one leads: this one stands down.
    StandDown,
    /// Both began the same term and this one stays: it begins a term above that revision.
    RaiseTerm(Revision),
}

/// What an instance does when the bus has answered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Decision {
    /// It leads.
    Lead,
    /// Another one leads, or has the right to begin.
    StandBy,
    /// There is no link; it asks again once there is one.
    Wait,
}

/// What follows from a link that is back.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Reconnection {
    /// The instance goes on.
    Resume,
    /// It goes on, and asks the bus what there is.
    Inquire,
    /// A suspect asks who leads; its output stays suppressed until it knows.
    AskForLeader,
}

impl Election {
    pub(crate) fn new(instance: InstanceId, now: Tick, replication: Replication) -> Self {
        Self {
            instance,
            replication,
            state: State::Starting(Candidate::new(now)),
            peers: Peers::default(),
            highest_term: 0,
            linked: true,
            silence_proves_from: now,
            last_run: now,
            has_heard_others: false,
        }
    }

    pub(crate) fn instance(&self) -> &InstanceId {
        &self.instance
    }

    /// Where the instance stands.
    pub(crate) fn state(&self) -> ReplicaState {
        match self.state {
            State::Starting(_) => ReplicaState::Starting,
            State::Standby(_) => ReplicaState::Standby,
            State::Suspect(_) => ReplicaState::Suspect,
            State::Leading(_) => ReplicaState::Leading,
        }
    }

    pub(crate) fn is_leading(&self) -> bool {
        matches!(self.state, State::Leading(_))
    }

    /// Whether the instance has begun a term and not stood down since.
    pub(crate) fn has_term(&self) -> bool {
        matches!(self.state, State::Leading(_) | State::Suspect(_))
    }

    /// The last output of the leader that this instance follows.
    pub(crate) fn followed(&self) -> Option<Revision> {
        Some(self.candidate()?.leader.as_ref()?.revision)
    }

    /// The highest term that another instance has claimed.
    pub(crate) fn highest_term(&self) -> u64 {
        self.highest_term
    }

    pub(crate) fn is_linked(&self) -> bool {
        self.linked
    }

    fn candidate(&self) -> Option<&Candidate> {
        match &self.state {
            State::Starting(candidate) | State::Standby(candidate) => Some(candidate),
            State::Suspect(_) | State::Leading(_) => None,
        }
    }

    fn candidate_mut(&mut self) -> Option<&mut Candidate> {
        match &mut self.state {
            State::Starting(candidate) | State::Standby(candidate) => Some(candidate),
            State::Suspect(_) | State::Leading(_) => None,
        }
    }

    /// The instance runs now. Whether it was paused for so long that another one may lead; then a leader is suspect
    /// from now on, and has to ask. A standby gives its leader the whole lease again.
    pub(crate) fn notice_pause(&mut self, now: Tick) -> bool {
        let paused = now.since(self.last_run) >= PAUSE;
        self.last_run = now;
        if paused {
            self.extend_grace(now);
            self.distrust_silence(now);
            self.become_suspect();
        }
        paused
    }

    /// A leader becomes suspect, and what a suspect has asked proves nothing any more.
    fn become_suspect(&mut self) {
        if self.replication == Replication::OneLeads && self.has_term() {
            self.state = State::Suspect(Suspicion::default());
        }
    }

    /// A query for the current leader goes out.
    pub(crate) fn leader_query_sent(&mut self, query: u64) {
        if let State::Suspect(suspicion) = &mut self.state {
            suspicion.query = Some(query);
        }
    }

    /// A query for the current leader has found no other instance.
    pub(crate) fn leader_query_unanswered(&mut self, query: u64) {
        let linked = self.linked;
        if let State::Suspect(suspicion) = &mut self.state
            && suspicion.query == Some(query)
        {
            suspicion.unopposed = linked;
        }
    }

    /// Whether a suspect leads again from now on: no other instance has taken over.
    pub(crate) fn confirm(&mut self, now: Tick) -> bool {
        let State::Suspect(suspicion) = &self.state else { return false };
        let confirmed = suspicion.unopposed && self.silence_proves_from <= now;
        if confirmed {
            self.state = State::Leading(Lease::confirmed(now));
        }
        confirmed
    }

    /// The instance asks the bus what there is. True if it does so to take over, as a standby.
    pub(crate) fn inquire(&mut self) -> bool {
        let Some(candidate) = self.candidate_mut() else { return false };
        candidate.asking = true;
        candidate.appeared.clear();
        (candidate.is_crowded, candidate.has_lost) = (false, false);
        candidate.waited
    }

    /// Whether an instance that is about to lead asks once more: another one has appeared meanwhile, and is still there; or one has
    /// answered, and is gone. A leader that was cut off for a moment has settings that no other instance may have received. One that
    /// was killed answers nothing. Once for each link is enough, so that tokens that come and go keep no instance from leading.
    pub(crate) fn asks_again(&mut self, has_answered: bool) -> bool {
        let Some(candidate) = self.candidate_mut() else { return false };
        let has_appeared = !candidate.appeared.is_empty() || candidate.is_crowded;
        (has_appeared || has_answered && candidate.has_lost)
            && !std::mem::replace(&mut candidate.asked_again, true)
    }

    /// Whether the answers of an inquiry are still wanted; they are taken once.
    pub(crate) fn inquiry_answered(&mut self) -> bool {
        self.candidate_mut().is_some_and(|candidate| std::mem::take(&mut candidate.asking))
    }

    /// What the instance does with the answers of its inquiry.
    pub(crate) fn decide(&mut self, now: Tick) -> Decision {
        if !self.linked {
            return Decision::Wait;
        }
        if self.replication == Replication::EveryInstance {
            return Decision::Lead;
        }
        let delay = self.stagger();
        let Some(candidate) = self.candidate_mut() else { return Decision::Wait };
        let is_renewed =
            |leader: &Leader| now.since(leader.renewed) < LEASE && candidate.take_over_at > now;
        let is_led = candidate.leader.as_ref().is_some_and(is_renewed);
        if !is_led {
            candidate.leader = None;
        }
        if is_led || (!candidate.waited && delay > Duration::ZERO) {
            if !is_led {
                candidate.take_over_at = now.after(TOKEN_GRACE + delay);
            }
            self.become_standby();
            return Decision::StandBy;
        }
        Decision::Lead
    }

    fn become_standby(&mut self) {
        if let State::Starting(candidate) = &self.state {
            self.state = State::Standby(candidate.clone());
        }
    }

    /// The instance has begun a term.
    pub(crate) fn lead(&mut self, now: Tick) {
        self.has_heard_others = false;
        self.state = State::Leading(Lease::new_term(now));
    }

    /// Something was received that this instance did not send itself.
    pub(crate) fn others_heard(&mut self) {
        self.has_heard_others |= self.is_leading();
    }

    /// Whether a suspect has begun its term on a link that was dead already: it has published nothing that
    /// counts, and whoever leads knows what operators have changed since.
    fn began_unheard(&self) -> bool {
        matches!(self.state, State::Suspect(_)) && !self.has_heard_others
    }

    /// The link is lost.
    pub(crate) fn link_lost(&mut self) {
        self.linked = false;
        self.become_suspect();
    }

    /// The link is back.
    pub(crate) fn link_restored(&mut self, now: Tick) -> Reconnection {
        self.linked = true;
        self.distrust_silence(now);
        self.extend_grace(now);
        if let Some(candidate) = self.candidate_mut() {
            // What was asked over the link that was lost says nothing of who is at the other end now.
            candidate.asked_again = false;
        }
        match &mut self.state {
            State::Suspect(_) => Reconnection::AskForLeader,
            State::Starting(candidate) if !candidate.asking && candidate.waited => {
                // It was about to take over; the leader may come back as it did.
                self.become_standby();
                Reconnection::Resume
            }
            // What it has asked over the link that was lost says nothing of what others have published since.
            State::Starting(candidate) if !candidate.waited => Reconnection::Inquire,
            State::Leading(lease) => {
                lease.check_soon(now);
                Reconnection::Resume
            }
            State::Starting(_) | State::Standby(_) => Reconnection::Resume,
        }
    }

    /// An instance that never had peers need not wait for others to answer.
    fn distrust_silence(&mut self, now: Tick) {
        self.silence_proves_from = if self.peers.had_any() { now.after(LINK_PROOF) } else { now };
    }

    /// The leader could not be received until now.
    fn extend_grace(&mut self, now: Tick) {
        let take_over_at = now.after(LEASE + self.stagger());
        if let Some(candidate) = self.candidate_mut() {
            if let Some(leader) = &mut candidate.leader {
                leader.renewed = now;
            }
            candidate.take_over_at = take_over_at;
        }
    }

    /// How long this instance lets those before it go first.
    fn stagger(&self) -> Duration {
        let leader = self.candidate().and_then(|candidate| candidate.leader.as_ref());
        self.peers.stagger(&self.instance, leader.map(|leader| &leader.instance))
    }

    /// A token of an instance appeared or was lost.
    pub(crate) fn token(&mut self, now: Tick, instance: InstanceId, alive: bool) {
        if instance == self.instance {
            return;
        }
        if alive {
            if let Some(candidate) = self.candidate_mut() {
                let has_room = candidate.appeared.len() < MAX_PEERS;
                candidate.is_crowded |= !has_room;
                if has_room {
                    candidate.appeared.insert(instance.clone());
                }
            }
            return self.peers.appeared(instance);
        }
        self.peers.lost(&instance);
        let take_over_at = now.after(TOKEN_GRACE + self.stagger());
        let Some(candidate) = self.candidate_mut() else { return };
        // A process that was killed has a token until its lease on the bus ends, and answers nothing.
        candidate.appeared.remove(&instance);
        candidate.has_lost = true;
        if candidate.leader.as_ref().is_some_and(|leader| leader.instance == instance) {
            candidate.take_over_at = candidate.take_over_at.min(take_over_at);
        }
    }

    /// Receives a lease renewal: published, or as an answer to a get. `term` is the own one.
    pub(crate) fn renewal(
        &mut self,
        now: Tick,
        renewal: &LeaseRenewal,
        source: RenewalSource,
        term: u64,
    ) -> Rivalry {
        if renewal.instance == self.instance || self.replication == Replication::EveryInstance {
            return Rivalry::None;
        }
        let revision = renewal.header.revision;
        // A renewal counts if an instance runs that sent it. An answer to a get proves that; otherwise
        // there must be a token, and the next renewal comes soon if that is still on its way.
        if source == RenewalSource::Published && !self.peers.may_have_token(&renewal.instance) {
            return Rivalry::None;
        }
        self.peers.proved();
        self.highest_term = self.highest_term.max(revision.term);
        if self.has_term() {
            if revision.term < term && !self.began_unheard() {
                return Rivalry::None;
            }
            if revision.term == term && self.instance < renewal.instance {
                // A renewal that arrived before the link was lost. Once it is back, a suspect asks.
                return if self.linked { Rivalry::RaiseTerm(revision) } else { Rivalry::None };
            }
            self.state = State::Starting(Candidate::new(now));
            self.set_leader(now, renewal);
            return Rivalry::StandDown;
        }
        if self.supersedes(now, revision, term) {
            return Rivalry::None;
        }
        let known = self.candidate().and_then(|candidate| candidate.leader.as_ref());
        let is_better = known.is_none_or(|leader| {
            renewal.instance == leader.instance
                || revision.term > leader.revision.term
                || now.since(leader.renewed) >= LEASE
        });
        if is_better {
            self.set_leader(now, renewal);
            if self.linked {
                // It was about to take over.
                self.become_standby();
            }
        }
        Rivalry::None
    }

    /// Whether this instance takes over from a leader of that revision, though it lives: whoever received
    /// what this instance published in its own `term` drops all that such a leader publishes. A leader
    /// begins an outdated term if it could not reach this instance, nor any reader of it.
    fn supersedes(&mut self, now: Tick, revision: Revision, term: u64) -> bool {
        let Some(candidate) = self.candidate_mut() else { return false };
        if candidate.replaces == Some(revision.term) {
            return true;
        }
        if revision.term > term {
            candidate.outdated_renewals = 0;
            return false;
        }
        candidate.outdated_renewals = candidate.outdated_renewals.saturating_add(1);
        let supersedes = candidate.outdated_renewals >= OUTDATED_RENEWALS;
        if supersedes {
            self.replace_leader(now);
        }
        supersedes
    }

    /// This instance takes over from the leader that it follows, though that lives.
    pub(crate) fn replace_leader(&mut self, now: Tick) {
        if let Some(candidate) = self.candidate_mut() {
            let leader = candidate.leader.take();
            candidate.replaces = leader.map(|leader| leader.revision.term);
            candidate.take_over_at = candidate.take_over_at.min(now);
        }
    }

    fn set_leader(&mut self, now: Tick, renewal: &LeaseRenewal) {
        let (instance, revision) = (renewal.instance.clone(), renewal.header.revision);
        if let Some(candidate) = self.candidate_mut() {
            candidate.leader = Some(Leader { instance, revision, renewed: now });
        }
        let take_over_at = now.after(LEASE + self.stagger());
        if let Some(candidate) = self.candidate_mut() {
            candidate.take_over_at = take_over_at;
        }
    }

    /// Whether a standby takes over now.
    pub(crate) fn takes_over(&mut self, now: Tick) -> bool {
        let State::Standby(candidate) = &self.state else { return false };
        if !self.linked || candidate.take_over_at > now {
            return false;
        }
        self.state = State::Starting(Candidate { waited: true, ..candidate.clone() });
        true
    }

    /// The lease of an elected leader; none while the instance does not lead.
    pub(crate) fn lease(&mut self) -> Option<&mut Lease> {
        match &mut self.state {
            State::Leading(lease) if self.replication == Replication::OneLeads => Some(lease),
            _ => None,
        }
    }

    /// When the instance has something to do.
    pub(crate) fn deadline(&self) -> Option<Tick> {
        let next_look = self.last_run.after(RENEWAL_INTERVAL);
        match &self.state {
            State::Starting(_) => None,
            State::Suspect(suspicion) => suspicion.unopposed.then_some(self.silence_proves_from),
            State::Leading(_) if self.replication == Replication::EveryInstance => None,
            State::Leading(lease) => Some(lease.deadline()),
            // It runs as often as a leader renews, so that it notices its own pauses.
            State::Standby(candidate) if self.linked => Some(candidate.take_over_at.min(next_look)),
            State::Standby(_) => Some(next_look),
        }
    }
}

impl Candidate {
    fn new(now: Tick) -> Self {
        Self {
            leader: None,
            take_over_at: now,
            asking: false,
            waited: false,
            appeared: BTreeSet::new(),
            is_crowded: false,
            has_lost: false,
            asked_again: false,
            outdated_renewals: 0,
            replaces: None,
        }
    }
}

/// How a lease renewal came.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum RenewalSource {
    /// Published to everyone.
    Published,
    /// As an answer to a get.
    Answered,
}

#[cfg(test)]
mod tests;

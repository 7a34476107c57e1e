//! Which of several instances of a service leads.
//!
//! Leases give liveness: the leader renews its lease several times a second ([`LeaseRenewal`]). When
//! its token is lost or it falls silent, the lowest standby takes over. Terms give safety: a new
//! leader begins a higher term, and a leader that receives a higher one stands down. A leader that
//! lost its link or was paused becomes *suspect*: its output is suppressed until a query for the
//! current leader goes unanswered. Nobody replaces a leader that lives.

use std::collections::BTreeSet;
use std::time::Duration;

use muster_model::header::Revision;
use muster_model::id::InstanceId;
use muster_model::role::{LeaseRenewal, ReplicaState};
use muster_model::time::Tick;

use crate::core::Replication;

/// How often a leader renews its lease. Several renewals fit into [`LEASE`], so that one lost message
/// changes nothing.
pub const RENEWAL_INTERVAL: Duration = Duration::from_millis(500);

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

/// How much longer each further standby waits, so that one takes over and the others see it.
const STAGGER: Duration = Duration::from_millis(300);

/// Grace period for a lost token: a lost link takes all tokens away a moment before it is noticed
/// itself, and then says nothing about anybody.
const TOKEN_GRACE: Duration = Duration::from_millis(200);

/// Most other instances that are told apart; two or three make sense.
const MAX_PEERS: usize = 16;

/// How often a leader asks its readers whether they have seen a higher revision than its own, which
/// happens if its start could not reach them: they would drop all that it publishes. As often it
/// announces its settings again: a standby that missed a change would bring the old ones back.
const TERM_CHECK_INTERVAL: Duration = Duration::from_secs(5);

/// How soon it asks again when they have. Another leader that lives goes on meanwhile, and is left
/// alone.
const TERM_RECHECK_DELAY: Duration = Duration::from_secs(1);

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
    /// Whether the standbys before it have had their turn.
    waited: bool,
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

/// What a leader does next.
#[derive(Debug, Clone)]
struct Lease {
    renew_at: Tick,
    check_at: Tick,
    /// A higher revision that readers had seen at the last check.
    higher: Option<Revision>,
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
    /// The other instances whose tokens are there.
    peers: BTreeSet<InstanceId>,
    /// Whether there ever was another instance.
    had_peers: bool,
    /// Whether there ever were more tokens than are told apart.
    crowded: bool,
    /// The highest term that another instance has claimed.
    highest_term: u64,
    linked: bool,
    /// From when on silence of the bus means that there is nobody.
    silence_proves_from: Tick,
    /// When this instance last ran.
    last_run: Tick,
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
    /// A suspect asks who leads, and says nothing until it knows.
    AskForLeader,
}

/// What readers know of this leader's output.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum TermCheck {
    /// Nothing above its own.
    Sound,
    /// A higher revision, for the second time and from nobody who goes on.
    Outrun(Revision),
}

impl Election {
    pub(crate) fn new(instance: InstanceId, now: Tick, replication: Replication) -> Self {
        Self {
            instance,
            replication,
            state: State::Starting(Candidate::new(now)),
            peers: BTreeSet::new(),
            had_peers: false,
            crowded: false,
            highest_term: 0,
            linked: true,
            silence_proves_from: now,
            last_run: now,
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

    /// The instance runs now. True if it was paused for so long that it stopped being a leader: it is
    /// suspect from now on. A standby gives its leader the whole lease again.
    pub(crate) fn notice_pause(&mut self, now: Tick) -> bool {
        let paused = now.since(self.last_run) >= PAUSE;
        self.last_run = now;
        if paused {
            self.extend_grace(now);
            self.distrust_silence(now);
        }
        paused && self.become_suspect()
    }

    /// A leader becomes suspect; whether it was one.
    fn become_suspect(&mut self) -> bool {
        if self.replication == Replication::EveryInstance {
            return false;
        }
        if let State::Suspect(suspicion) = &mut self.state {
            *suspicion = Suspicion::default();
        }
        let led = self.is_leading();
        if led {
            self.state = State::Suspect(Suspicion::default());
        }
        led
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

    /// Whether a suspect leads again from now on: nobody has taken over.
    pub(crate) fn confirm(&mut self, now: Tick) -> bool {
        let State::Suspect(suspicion) = &self.state else { return false };
        let confirmed = suspicion.unopposed && self.silence_proves_from <= now;
        if confirmed {
            self.state = State::Leading(Lease { renew_at: now, check_at: now, higher: None });
        }
        confirmed
    }

    /// The instance asks the bus what there is. True if it does so to take over, as a standby whose
    /// turn has come.
    pub(crate) fn inquire(&mut self) -> bool {
        let Some(candidate) = self.candidate_mut() else { return false };
        candidate.asking = true;
        candidate.waited
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
        let check_at = now.after(TERM_CHECK_INTERVAL);
        self.state = State::Leading(Lease { renew_at: now, check_at, higher: None });
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
        match &mut self.state {
            State::Suspect(_) => Reconnection::AskForLeader,
            State::Starting(candidate) if !candidate.asking && candidate.waited => {
                // It was about to take over; the leader may come back as it did.
                self.become_standby();
                Reconnection::Resume
            }
            State::Starting(candidate) if !candidate.asking => Reconnection::Inquire,
            State::Leading(lease) => {
                lease.check_at = now;
                Reconnection::Resume
            }
            State::Starting(_) | State::Standby(_) => Reconnection::Resume,
        }
    }

    /// An instance that never had peers need not wait for anybody to speak.
    fn distrust_silence(&mut self, now: Tick) {
        self.silence_proves_from = if self.had_peers { now.after(LINK_PROOF) } else { now };
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
        let leader = leader.map(|leader| &leader.instance);
        let before = self.peers.range(..&self.instance).filter(|peer| Some(*peer) != leader);
        STAGGER * u32::try_from(before.count()).unwrap_or(u32::MAX).min(MAX_PEERS as u32)
    }

    /// A token of an instance appeared or was lost.
    pub(crate) fn token(&mut self, now: Tick, instance: InstanceId, alive: bool) {
        if instance == self.instance {
            return;
        }
        self.had_peers |= alive;
        if alive {
            if self.peers.len() < MAX_PEERS {
                self.peers.insert(instance);
            } else {
                self.crowded |= !self.peers.contains(&instance);
            }
            return;
        }
        self.peers.remove(&instance);
        let take_over_at = now.after(TOKEN_GRACE + self.stagger());
        if let Some(candidate) = self.candidate_mut()
            && candidate.leader.as_ref().is_some_and(|leader| leader.instance == instance)
        {
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
        // A renewal counts if an instance stands behind it. An answer to a get proves that; otherwise
        // there must be a token, and the next renewal comes soon if that is still on its way. Once there
        // were more tokens than are told apart it is not known who has one, and they must not shut a
        // leader out.
        if source == RenewalSource::Published
            && !self.crowded
            && !self.peers.contains(&renewal.instance)
        {
            return Rivalry::None;
        }
        self.had_peers = true;
        self.highest_term = self.highest_term.max(revision.term);
        if self.has_term() {
            if revision.term < term {
                return Rivalry::None;
            }
            if revision.term == term && self.instance < renewal.instance {
                return Rivalry::RaiseTerm(revision);
            }
            self.state = State::Starting(Candidate::new(now));
            self.set_leader(now, renewal);
            return Rivalry::StandDown;
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

    /// The lease of an elected leader.
    fn lease_mut(&mut self) -> Option<&mut Lease> {
        match &mut self.state {
            State::Leading(lease) if self.replication == Replication::OneLeads => Some(lease),
            _ => None,
        }
    }

    /// Whether the lease is to be renewed now.
    pub(crate) fn renews(&mut self, now: Tick) -> bool {
        let Some(lease) = self.lease_mut() else { return false };
        let due = lease.renew_at <= now;
        if due {
            lease.renew_at = now.after(RENEWAL_INTERVAL);
        }
        due
    }

    /// Whether the readers are to be asked now what they have seen.
    pub(crate) fn checks_term(&mut self, now: Tick) -> bool {
        let Some(lease) = self.lease_mut() else { return false };
        let due = lease.check_at <= now;
        if due {
            lease.check_at = now.after(TERM_CHECK_INTERVAL);
        }
        due
    }

    /// Takes what readers have seen at most. `own` is the revision of the last output.
    pub(crate) fn term_checked(
        &mut self,
        now: Tick,
        seen: Option<Revision>,
        own: Revision,
    ) -> TermCheck {
        let State::Leading(lease) = &mut self.state else { return TermCheck::Sound };
        let higher = seen.filter(|seen| *seen > own);
        if let Some(seen) = higher {
            if lease.higher == higher {
                return TermCheck::Outrun(seen);
            }
            lease.check_at = now.after(TERM_RECHECK_DELAY);
        }
        lease.higher = higher;
        TermCheck::Sound
    }

    /// When the instance has something to do.
    pub(crate) fn deadline(&self) -> Option<Tick> {
        let next_look = self.last_run.after(RENEWAL_INTERVAL);
        match &self.state {
            State::Starting(_) => None,
            State::Suspect(suspicion) => suspicion.unopposed.then_some(self.silence_proves_from),
            State::Leading(_) if self.replication == Replication::EveryInstance => None,
            State::Leading(lease) => Some(lease.renew_at.min(lease.check_at)),
            // It runs as often as a leader renews, so that it notices its own pauses.
            State::Standby(candidate) if self.linked => Some(candidate.take_over_at.min(next_look)),
            State::Standby(_) => Some(next_look),
        }
    }
}

impl Candidate {
    fn new(now: Tick) -> Self {
        Self { leader: None, take_over_at: now, asking: false, waited: false }
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
mod tests {
    use muster_model::header::Header;
    use muster_model::id::{FleetId, ServiceName};

    use super::RenewalSource::{Answered, Published};
    use super::*;

    const START: Tick = Tick(1_000_000_000);

    fn at(seconds: f64) -> Tick {
        START.after(Duration::from_secs_f64(seconds))
    }

    fn name(host: &str) -> InstanceId {
        InstanceId::of_process(host, 1, 1)
    }

    fn renewal(host: &str, term: u64) -> LeaseRenewal {
        LeaseRenewal {
            header: Header {
                fleet: FleetId::new("f").unwrap(),
                revision: Revision { term, epoch: 5 },
                oldest: None,
                newest: None,
                stages: Vec::new(),
            },
            service: ServiceName::Ingest,
            instance: name(host),
        }
    }

    /// An instance on host `b` that knows of hosts `a` and `c`.
    fn between() -> Election {
        let mut election = Election::new(name("b"), START, Replication::OneLeads);
        election.token(START, name("a"), true);
        election.token(START, name("c"), true);
        election
    }

    /// The same as the leader.
    fn leading() -> Election {
        let mut election = between();
        election.lead(START);
        election
    }

    /// The same as a standby of a leader on a host.
    fn standby_of(host: &str) -> Election {
        let mut election = between();
        assert_eq!(election.renewal(START, &renewal(host, 3), Answered, 0), Rivalry::None);
        assert_eq!(election.decide(START), Decision::StandBy);
        election
    }

    /// The instance asks who leads, and nobody else answers.
    fn unanswered(election: &mut Election, query: u64) {
        election.leader_query_sent(query);
        election.leader_query_unanswered(query);
    }

    /// Lets an instance run until it takes over; when that is.
    fn takes_over(election: &mut Election, from: f64, until: f64) -> Option<f64> {
        let mut now = at(from);
        while now <= at(until) {
            assert!(!election.notice_pause(now));
            if election.takes_over(now) {
                return Some(now.since(START).as_secs_f64());
            }
            now = election.deadline().unwrap().max(now.after(Duration::from_millis(1)));
        }
        None
    }

    #[test]
    fn the_first_leads_and_those_after_it_wait_for_their_turn() {
        let mut alone = Election::new(name("b"), START, Replication::OneLeads);
        assert_eq!(alone.decide(START), Decision::Lead);
        let mut second = between();
        assert_eq!(second.decide(START), Decision::StandBy);
        let turn = takes_over(&mut second, 0.0, 10.0).unwrap();
        assert!((0.5..0.6).contains(&turn), "{turn}");
        assert_eq!(second.decide(at(turn)), Decision::Lead);
        // The first leads meanwhile.
        let mut second = between();
        second.decide(START);
        second.renewal(at(0.1), &renewal("a", 1), Published, 0);
        assert_eq!(takes_over(&mut second, 0.0, 2.0), None);
    }

    #[test]
    fn a_standby_takes_over_at_once_after_a_lost_token_and_after_the_lease_when_there_is_silence() {
        let mut election = standby_of("a");
        election.token(at(1.0), name("a"), false);
        let taken = takes_over(&mut election, 0.9, 9.0).unwrap();
        assert!((1.2..1.3).contains(&taken), "{taken}");

        let taken = takes_over(&mut standby_of("a"), 0.0, 9.0).unwrap();
        assert!((2.0..2.1).contains(&taken), "{taken}");
        // One with a lower name has its turn first.
        let taken = takes_over(&mut standby_of("c"), 0.0, 9.0).unwrap();
        assert!((2.3..2.4).contains(&taken), "{taken}");
    }

    #[test]
    fn nobody_replaces_a_leader_that_renews_its_lease() {
        let mut election = standby_of("c");
        for half in 1..40 {
            let now = f64::from(half) * 0.5;
            assert_eq!(takes_over(&mut election, now - 0.5, now - 0.1), None);
            election.renewal(at(now), &renewal("c", 3), Published, 0);
        }
    }

    #[test]
    fn a_lost_link_says_nothing_about_the_leader() {
        let mut election = standby_of("a");
        election.token(at(0.5), name("a"), false);
        election.link_lost();
        assert_eq!(takes_over(&mut election, 0.5, 60.0), None);
        election.link_restored(at(60.1));
        let taken = takes_over(&mut election, 60.1, 70.0).unwrap();
        assert!((62.1..62.2).contains(&taken), "{taken}");
    }

    #[test]
    fn a_standby_that_was_paused_gives_its_leader_the_whole_lease_again() {
        let mut election = standby_of("a");
        assert!(!election.notice_pause(at(30.0)), "only a leader becomes suspect");
        assert!(!election.takes_over(at(30.0)));
        assert_eq!(takes_over(&mut election, 30.0, 31.9), None);
        assert!(takes_over(&mut election, 31.9, 32.1).is_some());
    }

    #[test]
    fn a_leader_that_was_paused_or_cut_off_is_suspect() {
        let mut election = leading();
        assert!(!election.notice_pause(at(1.0)));
        assert!(election.notice_pause(at(3.0)));
        assert_eq!(election.state(), ReplicaState::Suspect);
        assert!(!election.renews(at(3.0)));
        assert!(!election.confirm(at(4.0)), "nobody was asked");
        unanswered(&mut election, 1);
        assert!(!election.confirm(at(3.1)), "the link may be given up at its other end");
        assert_eq!(election.deadline(), Some(at(3.0).after(LINK_PROOF)));
        assert!(election.confirm(at(3.0).after(LINK_PROOF)));
        assert!(election.renews(at(3.7)));
        election.link_lost();
        assert_eq!(election.state(), ReplicaState::Suspect);
    }

    #[test]
    fn an_unanswered_query_on_a_link_that_turns_out_to_be_lost_proves_nothing() {
        let mut election = leading();
        assert!(election.notice_pause(at(3.0)));
        unanswered(&mut election, 1);
        election.link_lost();
        assert!(!election.confirm(at(9.0)));
        assert_eq!(election.deadline(), None);
        unanswered(&mut election, 1);
        assert!(!election.confirm(at(9.0)), "it was asked on the lost link");
        // On a new link, a renewal of whoever has taken over arrives.
        election.link_restored(at(9.0));
        unanswered(&mut election, 1);
        assert!(!election.confirm(at(9.1)), "it may be too new to carry a question");
        assert!(election.confirm(at(9.0).after(LINK_PROOF)));
    }

    #[test]
    fn an_instance_that_never_had_peers_waits_for_nobody() {
        let mut election = Election::new(name("b"), START, Replication::OneLeads);
        election.lead(START);
        assert!(election.notice_pause(at(3.0)));
        unanswered(&mut election, 1);
        assert!(election.confirm(at(3.0)));
    }

    #[test]
    fn the_higher_term_wins_and_in_the_same_the_lower_name() {
        assert_eq!(leading().renewal(START, &renewal("a", 4), Published, 5), Rivalry::None);
        assert_eq!(leading().renewal(START, &renewal("c", 6), Published, 5), Rivalry::StandDown);
        assert_eq!(leading().renewal(START, &renewal("a", 5), Published, 5), Rivalry::StandDown);
        let raise = Rivalry::RaiseTerm(Revision { term: 5, epoch: 5 });
        assert_eq!(leading().renewal(START, &renewal("c", 5), Published, 5), raise);
        assert_eq!(
            leading().renewal(START, &renewal("b", 9), Published, 5),
            Rivalry::None,
            "its own"
        );
    }

    #[test]
    fn a_published_renewal_without_a_token_is_ignored() {
        assert_eq!(leading().renewal(START, &renewal("nobody", 900), Published, 5), Rivalry::None);
        assert_eq!(
            leading().renewal(START, &renewal("nobody", 900), Answered, 5),
            Rivalry::StandDown
        );
    }

    #[test]
    fn without_a_link_nobody_leads() {
        let mut election = Election::new(name("b"), START, Replication::OneLeads);
        election.link_lost();
        assert_eq!(election.decide(START), Decision::Wait);
        election.link_restored(START);
        assert_eq!(election.decide(START), Decision::Lead);
    }

    #[test]
    fn the_instances_that_are_told_apart_are_bounded() {
        let mut election = Election::new(name("b"), START, Replication::OneLeads);
        for other in 0..1000 {
            election.token(START, InstanceId::of_process("z", other, 1), true);
        }
        assert_eq!(election.peers.len(), MAX_PEERS);
    }

    #[test]
    fn a_crowd_of_tokens_does_not_shut_the_leader_out() {
        let mut election = Election::new(name("b"), START, Replication::OneLeads);
        for other in 0..1000 {
            election.token(START, InstanceId::of_process("z", other, 1), true);
        }
        election.token(START, name("a"), true);
        election.token(START, InstanceId::of_process("z", 0, 1), false);
        election.renewal(START, &renewal("a", 3), Published, 0);
        assert_eq!(election.decide(START), Decision::StandBy);
        assert_eq!(election.followed(), Some(Revision { term: 3, epoch: 5 }));
    }
}

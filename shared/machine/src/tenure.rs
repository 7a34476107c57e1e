//! Which of several instances of a service holds its role.
//!
//! Leases give liveness: who holds says so several times a second ([`Claim`]), and when its token is
//! lost or it falls silent, the lowest of those who stand by takes over. Terms give safety: whoever
//! takes over begins a higher term, and a holder that hears of a higher one stands down. A holder that
//! was cut off, or did not run for a while, is in doubt and says nothing until it knows that nobody
//! has taken over. Nobody takes a role from a holder that lives.

use std::collections::BTreeSet;
use std::time::Duration;

use muster_model::header::Revision;
use muster_model::id::InstanceId;
use muster_model::role::{Claim, Standing};
use muster_model::time::Tick;

/// How often a holder says that it holds. Several fit into [`HOLDER_SILENT`], so that one lost message
/// changes nothing.
pub const CLAIM_EVERY: Duration = Duration::from_millis(500);

/// How long a holder may be silent before another takes over: the lease of the bus, so that a process
/// that hangs with its link up is replaced as soon as one whose link is dead.
pub const HOLDER_SILENT: Duration = Duration::from_secs(2);

/// A holder that was not run for so long may have been replaced. It is less than [`HOLDER_SILENT`], so
/// that the doubt comes first.
const DOUBT_AFTER: Duration = Duration::from_millis(1500);

/// How long silence may say nothing about a link: a process that goes on after a pause takes one for sound
/// that the other end has given up, and a link that has just come carries no question for a moment.
/// What is asked meanwhile is answered by nobody. By then the loss is noticed, or a claim was heard of
/// whoever took over.
const LINK_PROVEN: Duration = CLAIM_EVERY.saturating_add(Duration::from_millis(200));

/// How much longer each further instance waits, so that one takes over and the others hear of it.
const STAGGER: Duration = Duration::from_millis(300);

/// How long a lost token is waited for: a lost link takes all tokens away a moment before it is
/// noticed itself, and then says nothing about anybody.
const TOKEN_GRACE: Duration = Duration::from_millis(200);

/// Most other instances that are told apart; two or three make sense.
const MAX_PEERS: usize = 16;

/// Another instance that holds the role.
#[derive(Debug, Clone)]
struct Holder {
    instance: InstanceId,
    revision: Revision,
    heard: Tick,
}

/// Where an instance stands, and what it knows of the others.
#[derive(Debug, Clone)]
pub(crate) struct Tenure {
    instance: InstanceId,
    standing: Standing,
    /// The other instances whose tokens are there.
    peers: BTreeSet<InstanceId>,
    /// Whether there ever was another instance.
    accompanied: bool,
    /// Whether there ever were more tokens than are told apart.
    crowded: bool,
    holder: Option<Holder>,
    /// The highest term that anybody claimed.
    highest: u64,
    linked: bool,
    /// From when on silence of the bus means that there is nobody.
    proven: Tick,
    /// Whether the bus was asked who holds, and nobody has answered.
    unopposed: bool,
    /// When this instance last did anything.
    attended: Tick,
    /// When an instance that stands by takes over, unless the holder is heard before.
    take_over: Tick,
    /// When the holder claims again.
    claim: Tick,
}

/// What a claim of another instance means for this one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Heard {
    /// Nothing is to be done.
    Noted,
    /// The other one is right: this one stands down.
    StandDown,
    /// Both began the same term and this one stays: it begins a higher one.
    Raise(Revision),
}

/// What an instance that has asked the bus does next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Decision {
    /// It takes the role.
    Begin,
    /// Another one holds it, or has the right to begin.
    StandBy,
    /// There is no link; it asks again once there is one.
    Wait,
}

impl Tenure {
    pub(crate) fn new(instance: InstanceId, now: Tick) -> Self {
        Self {
            instance,
            standing: Standing::Starting,
            peers: BTreeSet::new(),
            accompanied: false,
            crowded: false,
            holder: None,
            highest: 0,
            linked: true,
            proven: now,
            unopposed: false,
            attended: now,
            take_over: now,
            claim: now,
        }
    }

    pub(crate) fn instance(&self) -> &InstanceId {
        &self.instance
    }

    pub(crate) fn standing(&self) -> Standing {
        self.standing
    }

    /// The last output of the holder that this instance stands by for.
    pub(crate) fn followed(&self) -> Option<Revision> {
        self.holder.as_ref().map(|holder| holder.revision)
    }

    /// The highest term that anybody claimed.
    pub(crate) fn highest_claimed(&self) -> u64 {
        self.highest
    }

    /// Something happens to this instance. True if it did not run for so long that a holder is in
    /// doubt; one that stands by gives its holder the whole patience anew.
    pub(crate) fn attend(&mut self, now: Tick) -> bool {
        let slept = now.since(self.attended) >= DOUBT_AFTER;
        self.attended = now;
        if slept {
            self.spare_holder(now);
            self.distrust_silence(now);
        }
        slept && self.standing == Standing::Holding
    }

    /// The instance has begun a term.
    pub(crate) fn begun(&mut self, now: Tick) {
        self.standing = Standing::Holding;
        self.holder = None;
        self.claim = now;
    }

    /// The holder cannot know whether it still is one.
    pub(crate) fn doubt(&mut self) {
        self.unopposed = false;
        if self.standing == Standing::Holding {
            self.standing = Standing::Doubtful;
        }
    }

    /// The bus was asked who holds, and nobody has answered.
    pub(crate) fn unopposed(&mut self) {
        self.unopposed = self.linked && self.standing == Standing::Doubtful;
    }

    /// Whether the doubt is over: nobody has taken over.
    pub(crate) fn confirms(&mut self, now: Tick) -> bool {
        let due = self.standing == Standing::Doubtful && self.unopposed && self.proven <= now;
        if due {
            self.standing = Standing::Holding;
            self.claim = now;
        }
        due
    }

    /// The role is another one's, or may be: everything begins with asking the bus.
    pub(crate) fn restart(&mut self) {
        self.standing = Standing::Starting;
    }

    /// It was about to take over when its link was lost: the holder may find back as it does.
    pub(crate) fn stand_by(&mut self) {
        self.standing = Standing::Standby;
    }

    pub(crate) fn link_lost(&mut self) {
        self.linked = false;
        self.doubt();
    }

    pub(crate) fn link_restored(&mut self, now: Tick) {
        self.linked = true;
        self.distrust_silence(now);
        self.spare_holder(now);
    }

    /// An instance that never had company need not wait for anybody to speak.
    fn distrust_silence(&mut self, now: Tick) {
        self.proven = if self.accompanied { now.after(LINK_PROVEN) } else { now };
    }

    pub(crate) fn is_linked(&self) -> bool {
        self.linked
    }

    /// The holder could not be heard until now.
    fn spare_holder(&mut self, now: Tick) {
        if let Some(holder) = &mut self.holder {
            holder.heard = now;
        }
        self.take_over = now.after(HOLDER_SILENT + self.turn());
    }

    /// How long this instance lets those before it go first.
    fn turn(&self) -> Duration {
        let holder = self.holder.as_ref().map(|holder| &holder.instance);
        let before = self.peers.range(..&self.instance).filter(|peer| Some(*peer) != holder);
        STAGGER * u32::try_from(before.count()).unwrap_or(u32::MAX).min(MAX_PEERS as u32)
    }

    pub(crate) fn token(&mut self, now: Tick, instance: InstanceId, alive: bool) {
        if instance == self.instance {
            return;
        }
        self.accompanied |= alive;
        if alive {
            if self.peers.len() < MAX_PEERS {
                self.peers.insert(instance);
            } else {
                self.crowded |= !self.peers.contains(&instance);
            }
            return;
        }
        self.peers.remove(&instance);
        if self.holder.as_ref().is_some_and(|holder| holder.instance == instance) {
            self.take_over = self.take_over.min(now.after(TOKEN_GRACE + self.turn()));
        }
    }

    /// Hears a claim, said to everybody or in answer to a get. `term` is the own one.
    pub(crate) fn hear(&mut self, now: Tick, claim: &Claim, answered: bool, term: u64) -> Heard {
        if claim.instance == self.instance {
            return Heard::Noted;
        }
        let revision = claim.header.revision;
        // A claim counts if somebody stands behind it. Who answers a get does; otherwise there must be
        // a token, and the next claim comes soon if that is still on its way. Once there were more
        // tokens than are told apart it is not known who has one, and they must not shut a holder out.
        if !answered && !self.crowded && !self.peers.contains(&claim.instance) {
            return Heard::Noted;
        }
        self.accompanied = true;
        self.highest = self.highest.max(revision.term);
        match self.standing {
            Standing::Holding | Standing::Doubtful if revision.term < term => Heard::Noted,
            Standing::Holding | Standing::Doubtful => {
                if revision.term == term && self.instance < claim.instance {
                    return Heard::Raise(revision);
                }
                self.follow(now, claim);
                Heard::StandDown
            }
            Standing::Starting | Standing::Standby => {
                let better = self.holder.as_ref().is_none_or(|holder| {
                    claim.instance == holder.instance
                        || revision.term > holder.revision.term
                        || now.since(holder.heard) >= HOLDER_SILENT
                });
                if better {
                    self.follow(now, claim);
                }
                Heard::Noted
            }
        }
    }

    fn follow(&mut self, now: Tick, claim: &Claim) {
        let (instance, revision) = (claim.instance.clone(), claim.header.revision);
        self.holder = Some(Holder { instance, revision, heard: now });
        self.take_over = now.after(HOLDER_SILENT + self.turn());
        if self.standing == Standing::Starting && self.linked {
            // It was about to take over.
            self.standing = Standing::Standby;
        }
    }

    /// The bus has answered what there is. `waited` says that those before this instance had their
    /// turn already.
    pub(crate) fn decide(&mut self, now: Tick, waited: bool) -> Decision {
        if !self.linked {
            return Decision::Wait;
        }
        let held = self
            .holder
            .as_ref()
            .is_some_and(|holder| now.since(holder.heard) < HOLDER_SILENT && self.take_over > now);
        let turn = self.turn();
        if held || (!waited && turn > Duration::ZERO) {
            self.standing = Standing::Standby;
            if !held {
                self.holder = None;
                self.take_over = now.after(TOKEN_GRACE + turn);
            }
            return Decision::StandBy;
        }
        self.holder = None;
        Decision::Begin
    }

    /// Whether it is time to take over.
    pub(crate) fn takes_over(&mut self, now: Tick) -> bool {
        let due = self.standing == Standing::Standby && self.linked && self.take_over <= now;
        if due {
            self.standing = Standing::Starting;
        }
        due
    }

    /// Whether it is time to claim.
    pub(crate) fn claims(&mut self, now: Tick) -> bool {
        let due = self.standing == Standing::Holding && self.claim <= now;
        if due {
            self.claim = now.after(CLAIM_EVERY);
        }
        due
    }

    pub(crate) fn deadline(&self) -> Option<Tick> {
        match self.standing {
            Standing::Starting => None,
            Standing::Doubtful => self.unopposed.then_some(self.proven),
            Standing::Holding => Some(self.claim),
            // It looks around as often as a holder claims, so that it knows when it did not run itself.
            Standing::Standby if self.linked => {
                Some(self.take_over.min(self.attended.after(CLAIM_EVERY)))
            }
            Standing::Standby => Some(self.attended.after(CLAIM_EVERY)),
        }
    }
}

#[cfg(test)]
mod tests {
    use muster_model::header::Header;
    use muster_model::id::{FleetId, ServiceName};

    use super::*;

    const START: Tick = Tick(1_000_000_000);

    fn at(seconds: f64) -> Tick {
        START.after(Duration::from_secs_f64(seconds))
    }

    fn name(host: &str) -> InstanceId {
        InstanceId::of_process(host, 1, 1)
    }

    fn claim(host: &str, term: u64) -> Claim {
        Claim {
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
    fn between() -> Tenure {
        let mut tenure = Tenure::new(name("b"), START);
        tenure.token(START, name("a"), true);
        tenure.token(START, name("c"), true);
        tenure
    }

    /// The same as the holder, and standing by for a holder on a host.
    fn holding() -> Tenure {
        let mut tenure = between();
        tenure.begun(START);
        tenure
    }

    fn standing_by(host: &str) -> Tenure {
        let mut tenure = between();
        assert_eq!(tenure.hear(START, &claim(host, 3), true, 0), Heard::Noted);
        assert_eq!(tenure.decide(START, false), Decision::StandBy);
        tenure
    }

    /// Lets an instance look around until it takes over; when that is.
    fn takes_over(tenure: &mut Tenure, from: f64, until: f64) -> Option<f64> {
        let mut now = at(from);
        while now <= at(until) {
            assert!(!tenure.attend(now));
            if tenure.takes_over(now) {
                return Some(now.since(START).as_secs_f64());
            }
            now = tenure.deadline().unwrap().max(now.after(Duration::from_millis(1)));
        }
        None
    }

    #[test]
    fn the_first_begins_and_those_after_it_wait_for_their_turn() {
        let mut alone = Tenure::new(name("b"), START);
        assert_eq!(alone.decide(START, false), Decision::Begin);
        let mut second = between();
        assert_eq!(second.decide(START, false), Decision::StandBy);
        let turn = takes_over(&mut second, 0.0, 10.0).unwrap();
        assert!((0.5..0.6).contains(&turn), "{turn}");
        assert_eq!(second.decide(at(turn), true), Decision::Begin);
        // The first has begun meanwhile.
        let mut second = between();
        second.decide(START, false);
        second.hear(at(0.1), &claim("a", 1), false, 0);
        assert_eq!(takes_over(&mut second, 0.0, 2.0), None);
    }

    #[test]
    fn a_lost_token_hands_the_role_on_at_once_and_silence_after_the_lease() {
        let mut tenure = standing_by("a");
        tenure.token(at(1.0), name("a"), false);
        let taken = takes_over(&mut tenure, 0.9, 9.0).unwrap();
        assert!((1.2..1.3).contains(&taken), "{taken}");

        let taken = takes_over(&mut standing_by("a"), 0.0, 9.0).unwrap();
        assert!((2.0..2.1).contains(&taken), "{taken}");
        // One with a lower name has its turn first.
        let taken = takes_over(&mut standing_by("c"), 0.0, 9.0).unwrap();
        assert!((2.3..2.4).contains(&taken), "{taken}");
    }

    #[test]
    fn nobody_takes_a_role_from_a_holder_that_lives() {
        let mut tenure = standing_by("c");
        for half in 1..40 {
            let now = f64::from(half) * 0.5;
            assert_eq!(takes_over(&mut tenure, now - 0.5, now - 0.1), None);
            tenure.hear(at(now), &claim("c", 3), false, 0);
        }
    }

    #[test]
    fn a_lost_link_says_nothing_about_the_holder() {
        let mut tenure = standing_by("a");
        tenure.token(at(0.5), name("a"), false);
        tenure.link_lost();
        assert_eq!(takes_over(&mut tenure, 0.5, 60.0), None);
        tenure.link_restored(at(60.1));
        let taken = takes_over(&mut tenure, 60.1, 70.0).unwrap();
        assert!((62.1..62.2).contains(&taken), "{taken}");
    }

    #[test]
    fn who_did_not_run_gives_the_holder_the_whole_patience_anew() {
        let mut tenure = standing_by("a");
        assert!(!tenure.attend(at(30.0)), "it holds nothing that could be in doubt");
        assert!(!tenure.takes_over(at(30.0)));
        assert_eq!(takes_over(&mut tenure, 30.0, 31.9), None);
        assert!(takes_over(&mut tenure, 31.9, 32.1).is_some());
    }

    #[test]
    fn a_holder_that_did_not_run_or_was_cut_off_is_in_doubt() {
        let mut tenure = holding();
        assert!(!tenure.attend(at(1.0)));
        assert!(tenure.attend(at(3.0)));
        tenure.doubt();
        assert_eq!(tenure.standing(), Standing::Doubtful);
        assert!(!tenure.claims(at(3.0)));
        assert!(!tenure.confirms(at(4.0)), "nobody was asked");
        tenure.unopposed();
        assert!(!tenure.confirms(at(3.1)), "the link may be given up at its other end");
        assert_eq!(tenure.deadline(), Some(at(3.0).after(LINK_PROVEN)));
        assert!(tenure.confirms(at(3.0).after(LINK_PROVEN)));
        assert!(tenure.claims(at(3.7)));
        tenure.link_lost();
        assert_eq!(tenure.standing(), Standing::Doubtful);
    }

    #[test]
    fn silence_on_a_link_that_turns_out_to_be_lost_says_nothing() {
        let mut tenure = holding();
        assert!(tenure.attend(at(3.0)));
        tenure.doubt();
        tenure.unopposed();
        tenure.link_lost();
        assert!(!tenure.confirms(at(9.0)));
        assert_eq!(tenure.deadline(), None);
        tenure.unopposed();
        assert!(!tenure.confirms(at(9.0)), "it was asked on the lost link");
        // Whoever has taken over is heard on a new one.
        tenure.link_restored(at(9.0));
        tenure.unopposed();
        assert!(!tenure.confirms(at(9.1)), "it may be too new to carry a question");
        assert!(tenure.confirms(at(9.0).after(LINK_PROVEN)));
    }

    #[test]
    fn who_never_had_company_waits_for_nobody() {
        let mut tenure = Tenure::new(name("b"), START);
        tenure.begun(START);
        assert!(tenure.attend(at(3.0)));
        tenure.doubt();
        tenure.unopposed();
        assert!(tenure.confirms(at(3.0)));
    }

    #[test]
    fn the_higher_term_wins_and_in_the_same_the_lower_name() {
        assert_eq!(holding().hear(START, &claim("a", 4), false, 5), Heard::Noted);
        assert_eq!(holding().hear(START, &claim("c", 6), false, 5), Heard::StandDown);
        assert_eq!(holding().hear(START, &claim("a", 5), false, 5), Heard::StandDown);
        let raise = Heard::Raise(Revision { term: 5, epoch: 5 });
        assert_eq!(holding().hear(START, &claim("c", 5), false, 5), raise);
        assert_eq!(holding().hear(START, &claim("b", 9), false, 5), Heard::Noted, "its own");
    }

    #[test]
    fn a_claim_behind_which_nobody_stands_is_not_believed() {
        assert_eq!(holding().hear(START, &claim("nobody", 900), false, 5), Heard::Noted);
        assert_eq!(holding().hear(START, &claim("nobody", 900), true, 5), Heard::StandDown);
    }

    #[test]
    fn without_a_link_nobody_begins() {
        let mut tenure = Tenure::new(name("b"), START);
        tenure.link_lost();
        assert_eq!(tenure.decide(START, true), Decision::Wait);
        tenure.link_restored(START);
        assert_eq!(tenure.decide(START, true), Decision::Begin);
    }

    #[test]
    fn the_instances_that_are_told_apart_are_bounded() {
        let mut tenure = Tenure::new(name("b"), START);
        for other in 0..1000 {
            tenure.token(START, InstanceId::of_process("z", other, 1), true);
        }
        assert_eq!(tenure.peers.len(), MAX_PEERS);
    }

    #[test]
    fn a_crowd_of_tokens_does_not_shut_the_holder_out() {
        let mut tenure = Tenure::new(name("b"), START);
        for other in 0..1000 {
            tenure.token(START, InstanceId::of_process("z", other, 1), true);
        }
        tenure.token(START, name("a"), true);
        tenure.token(START, InstanceId::of_process("z", 0, 1), false);
        tenure.hear(START, &claim("a", 3), false, 0);
        assert_eq!(tenure.decide(START, false), Decision::StandBy);
        assert_eq!(tenure.followed(), Some(Revision { term: 3, epoch: 5 }));
    }
}

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
    holder: Option<Holder>,
    /// The highest term that anybody claimed.
    highest: u64,
    linked: bool,
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
            holder: None,
            highest: 0,
            linked: true,
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
        if self.standing == Standing::Holding {
            self.standing = Standing::Doubtful;
        }
    }

    /// Nobody has taken over.
    pub(crate) fn confirmed(&mut self, now: Tick) {
        if self.standing == Standing::Doubtful {
            self.standing = Standing::Holding;
            self.claim = now;
        }
    }

    /// The role is another one's, or may be: everything begins with asking the bus.
    pub(crate) fn restart(&mut self) {
        self.standing = Standing::Starting;
    }

    pub(crate) fn link_lost(&mut self) {
        self.linked = false;
        self.doubt();
    }

    pub(crate) fn link_restored(&mut self, now: Tick) {
        self.linked = true;
        self.spare_holder(now);
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
        if alive {
            if self.peers.len() < MAX_PEERS {
                self.peers.insert(instance);
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
        // a token, and the next claim comes soon if that is still on its way.
        if !answered && !self.peers.contains(&claim.instance) {
            return Heard::Noted;
        }
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
            Standing::Starting | Standing::Doubtful => None,
            Standing::Holding => Some(self.claim),
            // It looks around as often as a holder claims, so that it knows when it did not run itself.
            Standing::Standby if self.linked => {
                Some(self.take_over.min(self.attended.after(CLAIM_EVERY)))
            }
            Standing::Standby => Some(self.attended.after(CLAIM_EVERY)),
        }
    }
}

//! The other instances of a service, by their liveliness tokens.

use std::collections::BTreeSet;
use std::time::Duration;

use muster_model::id::InstanceId;

/// How much longer each further standby waits, so that one takes over and the others see it.
const STAGGER: Duration = Duration::from_millis(300);

/// Most other instances that are known by name; two or three make sense.
pub(crate) const MAX_PEERS: usize = 16;

/// The other instances whose tokens are there.
#[derive(Debug, Clone, Default)]
pub(crate) struct Peers {
    known: BTreeSet<InstanceId>,
    had_any: bool,
    /// Whether there ever were more tokens than are known by name.
    crowded: bool,
}

impl Peers {
    /// Whether there ever was another instance.
    pub(crate) fn had_any(&self) -> bool {
        self.had_any
    }

    /// A token appeared.
    pub(crate) fn appeared(&mut self, instance: InstanceId) {
        self.had_any = true;
        if self.known.len() < MAX_PEERS {
            self.known.insert(instance);
        } else {
            self.crowded |= !self.known.contains(&instance);
        }
    }

    /// A token was lost.
    pub(crate) fn lost(&mut self, instance: &InstanceId) {
        self.known.remove(instance);
    }

    /// An instance without a token has proved that it runs.
    pub(crate) fn proved(&mut self) {
        self.had_any = true;
    }

    /// Whether an instance may have a token. Once there were more tokens than are known by name, every
    /// instance may: they must not shut a leader out.
    pub(crate) fn may_have_token(&self, instance: &InstanceId) -> bool {
        self.crowded || self.known.contains(instance)
    }

    /// How long an instance lets those before it go first, the leader not counted.
    pub(crate) fn stagger(&self, own: &InstanceId, leader: Option<&InstanceId>) -> Duration {
        let before = self.known.range(..own).filter(|peer| Some(*peer) != leader);
        STAGGER * u32::try_from(before.count()).unwrap_or(u32::MAX).min(MAX_PEERS as u32)
    }

    #[cfg(test)]
    pub(crate) fn count(&self) -> usize {
        self.known.len()
    }
}

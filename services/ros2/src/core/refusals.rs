//! What is not taken, and why: said at a bounded rate, and kept for those who look.

use std::collections::BTreeMap;
use std::time::Duration;

use muster_model::bridge::TopicFault;
use muster_model::time::Tick;
use muster_wire::message::quoted;

use super::extract::Problem;
use super::intake::Refused;

/// How often the same topic is complained of.
const SAY_EVERY: Duration = Duration::from_secs(10);

/// How long a reason is kept after it last applied.
const KEEP: Duration = Duration::from_secs(30);

/// Most topics whose reasons are kept.
const MAX_TOPICS: usize = 1024;

/// Why samples of a topic are not taken.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Refusal {
    /// The key of the topic, cut short, without control characters.
    pub key: String,
    /// What is wrong, for programs.
    pub fault: TopicFault,
    /// What is wrong, and what would be right.
    pub reason: String,
    /// How many samples were not taken since this was last said.
    pub count: u64,
}

#[derive(Debug)]
struct Kept {
    fault: TopicFault,
    reason: String,
    last: Tick,
    said: Tick,
    count: u64,
}

/// The reasons that apply now.
#[derive(Debug, Default)]
pub(super) struct Refusals {
    topics: BTreeMap<String, Kept>,
}

impl Refusals {
    /// Notes a refusal; it is returned if it is to be said.
    pub(super) fn add(&mut self, now: Tick, refused: Refused) -> Option<Refusal> {
        let Refused { key, problem: Problem { fault, reason } } = refused;
        let key = quoted(&key);
        if let Some(kept) = self.topics.get_mut(&key) {
            kept.count += 1;
            kept.last = now;
            (kept.fault, kept.reason) = (fault, reason);
            if now.since(kept.said) < SAY_EVERY {
                return None;
            }
            kept.said = now;
            let (count, reason) = (std::mem::take(&mut kept.count), kept.reason.clone());
            return Some(Refusal { key, fault, reason, count });
        }
        if self.topics.len() >= MAX_TOPICS {
            return None;
        }
        let kept = Kept { fault, reason: reason.clone(), last: now, said: now, count: 0 };
        self.topics.insert(key.clone(), kept);
        Some(Refusal { key, fault, reason, count: 1 })
    }

    /// Drops what has not applied for a while.
    pub(super) fn forget(&mut self, now: Tick) {
        self.topics.retain(|_, kept| now.since(kept.last) <= KEEP);
    }

    /// How many topics have a reason that applies now.
    pub(super) fn len(&self) -> usize {
        self.topics.len()
    }

    /// Topics and what is wrong with them now, by the order of the topics.
    pub(super) fn iter(&self) -> impl Iterator<Item = (&str, TopicFault, &str)> {
        self.topics.iter().map(|(key, kept)| (key.as_str(), kept.fault, kept.reason.as_str()))
    }
}

//! What is asked for again and again.

use std::collections::BTreeMap;
use std::time::Duration;

use muster_model::id::{Modality, ServiceName};
use muster_model::time::Tick;

use super::limits::{FETCH_TIMEOUT, GRAPH_PERIOD, SETTINGS_PERIOD};

/// What no service publishes by itself.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub enum Fetch {
    /// The settings of a service.
    Settings(ServiceName),
    /// The graph of a modality.
    Graph(Modality),
}

impl Fetch {
    const fn period(&self) -> Duration {
        match self {
            Self::Settings(_) => SETTINGS_PERIOD,
            Self::Graph(_) => GRAPH_PERIOD,
        }
    }
}

#[derive(Debug)]
struct Asked {
    at: Tick,
    is_open: bool,
    /// It is asked for again as soon as it is answered.
    soon: bool,
}

/// When what was asked for.
#[derive(Debug, Default)]
pub(super) struct Fetches(BTreeMap<Fetch, Asked>);

impl Fetches {
    /// What of the wanted is due now; it counts as asked for. What no one wants is forgotten.
    pub(super) fn due(&mut self, now: Tick, wanted: Vec<Fetch>) -> Vec<Fetch> {
        self.0.retain(|fetch, _| wanted.contains(fetch));
        let is_due = |asked: &Asked, period: Duration| {
            let since = now.since(asked.at);
            if asked.is_open { since >= FETCH_TIMEOUT } else { asked.soon || since >= period }
        };
        let mut due = Vec::new();
        for fetch in wanted {
            if self.0.get(&fetch).is_none_or(|asked| is_due(asked, fetch.period())) {
                self.0.insert(fetch.clone(), Asked { at: now, is_open: true, soon: false });
                due.push(fetch);
            }
        }
        due
    }

    /// Something was answered, or will not be.
    pub(super) fn answered(&mut self, fetch: &Fetch) {
        if let Some(asked) = self.0.get_mut(fetch) {
            asked.is_open = false;
        }
    }

    /// The settings have probably changed: they are asked for once no question for them is open.
    pub(super) fn settings_soon(&mut self) {
        for (fetch, asked) in &mut self.0 {
            asked.soon |= matches!(fetch, Fetch::Settings(_));
        }
    }

    /// All are asked for at once.
    pub(super) fn again(&mut self) {
        self.0.clear();
    }
}

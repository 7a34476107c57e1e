//! What is asked for again and again while somebody looks.

use std::collections::BTreeMap;
use std::time::Duration;

use muster_model::id::Modality;
use muster_model::time::Tick;

use super::limits::{
    FETCH_TIMEOUT, PICTURE_PERIOD, SETTINGS_PERIOD, STATUS_PERIOD, WEIGHTS_PERIOD, WISHES_PERIOD,
};

/// What all browsers are shown, and no one publishes by itself.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub enum Fetch {
    /// The states of all instances of services.
    Statuses,
    /// The settings of all services.
    Settings,
    /// All wishes.
    Wishes,
    /// The embedding, while a browser shows it.
    Embedding,
    /// The same for the weights of the modalities that it was made with.
    Weights,
    /// The graph of a modality.
    Graph(Modality),
}

impl Fetch {
    const fn period(&self) -> Duration {
        match self {
            Self::Statuses => STATUS_PERIOD,
            Self::Settings => SETTINGS_PERIOD,
            Self::Wishes => WISHES_PERIOD,
            Self::Embedding | Self::Graph(_) => PICTURE_PERIOD,
            Self::Weights => WEIGHTS_PERIOD,
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

    /// These have probably changed: they are asked for once no question for them is open.
    pub(super) fn soon(&mut self, fetches: &[Fetch]) {
        for fetch in fetches {
            if let Some(asked) = self.0.get_mut(fetch) {
                asked.soon = true;
            }
        }
    }

    /// All are asked for at once.
    pub(super) fn again(&mut self) {
        self.0.clear();
    }
}

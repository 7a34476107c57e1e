//! The open alerts: what raises and ends them, their numbers, who has seen them, and how many events of them
//! are published.
//!
//! Each kind and subject has at most one open alert. What is observed may ask for an alert, may ask for its end, or
//! lie in between, where all stays as it is; either must last before something happens. The list is whole at all
//! times; of its changes at most [`MAX_ALERT_EVENTS_PER_MINUTE`] become events within any minute.

pub(crate) mod conditions;
pub(crate) mod fleet;

use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

use muster_model::alert::{
    AcknowledgeAlert, Acknowledgement, Alert, AlertKind, AlertSubject, Alerts,
};
use muster_model::event::{EventKind, Severity};
use muster_model::header::Header;
use muster_model::id::RobotId;
use muster_model::limits::{MAX_ALERT_EVENTS_PER_MINUTE, MAX_ALERT_ROBOTS, MAX_OPEN_ALERTS};
use muster_model::time::Tick;

/// The time within which events are counted.
const EVENT_WINDOW: Duration = Duration::from_secs(60);

/// How long events that were not published wait for others of their kind, so that one event names many.
const FOLDING_TIME: Duration = Duration::from_secs(5);

/// What an observation asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Wanted {
    /// An alert.
    Raise,
    /// Neither: an open alert stays open, and none is raised.
    Neither,
    /// The end of an alert.
    Clear,
}

impl Wanted {
    /// By a value that is bad when it is large: above one threshold, or not above another.
    pub(crate) fn above(value: f64, raise: f64, clear: f64) -> Self {
        match value {
            _ if value > raise => Self::Raise,
            _ if value <= clear => Self::Clear,
            _ => Self::Neither,
        }
    }

    /// By a value that is bad when it is small.
    pub(crate) fn below(value: f64, raise: f64, clear: f64) -> Self {
        match value {
            _ if value < raise => Self::Raise,
            _ if value > clear => Self::Clear,
            _ => Self::Neither,
        }
    }

    /// Whether something is wrong or not, without anything in between.
    pub(crate) fn of(is_wrong: bool) -> Self {
        if is_wrong { Self::Raise } else { Self::Clear }
    }
}

/// What is observed of one subject.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Condition {
    pub(crate) subject: AlertSubject,
    pub(crate) wanted: Wanted,
    /// What was measured, and the threshold that it is compared with.
    pub(crate) value: f64,
    pub(crate) threshold: f64,
    /// What is wrong, in words.
    pub(crate) reason: String,
    /// The robots that it is about, those that matter most first.
    pub(crate) robots: Vec<RobotId>,
}

/// How long something must last.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Delays {
    pub(crate) raise: Duration,
    pub(crate) clear: Duration,
}

/// Why an alert is not acknowledged.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("alert: there is no open alert {0}; get the list of open alerts, it may have ended")]
pub(crate) struct NoSuchAlert(pub(crate) u64);

/// One kind of one subject.
#[derive(Debug, Default)]
struct Entry {
    /// What was observed last; none of an alert that an earlier leader had raised, before the first observation.
    condition: Option<Condition>,
    /// Since when that has asked for a change.
    since: Option<Tick>,
    open: Option<Alert>,
}

impl Entry {
    /// When the change that is asked for is due.
    fn due(&self, delays: Delays) -> Option<Tick> {
        let delay = if self.open.is_some() { delays.clear } else { delays.raise };
        self.since.map(|since| since.after(delay))
    }

    /// Accepts what is observed.
    fn observe(&mut self, now: Tick, condition: Option<Condition>) {
        // A subject that is gone asks for the end of its alert.
        let wanted = condition.as_ref().map_or(Wanted::Clear, |condition| condition.wanted);
        let asks = match wanted {
            Wanted::Raise => self.open.is_none(),
            Wanted::Neither => false,
            Wanted::Clear => self.open.is_some(),
        };
        self.since = asks.then(|| self.since.unwrap_or(now));
        self.condition = condition;
    }
}

/// An event to publish.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct AlertEvent {
    pub(crate) severity: Severity,
    pub(crate) kind: EventKind,
}

/// The open alerts, and what may become one.
#[derive(Debug)]
pub(crate) struct AlertBook {
    entries: BTreeMap<(AlertKind, AlertSubject), Entry>,
    open: usize,
    next_id: u64,
    /// When events were published within the window.
    published: VecDeque<Tick>,
    /// How many were not since the last event that named their number, and since when.
    folded: u32,
    folded_since: Option<Tick>,
    folded_in_term: u64,
    changed: bool,
}

impl Default for AlertBook {
    fn default() -> Self {
        Self {
            entries: BTreeMap::new(),
            open: 0,
            next_id: 1,
            published: VecDeque::new(),
            folded: 0,
            folded_since: None,
            folded_in_term: 0,
            changed: false,
        }
    }
}

impl AlertBook {
    /// Takes over the alerts of an earlier leader, unless this one knows later ones.
    pub(crate) fn inherit(&mut self, alerts: &Alerts) {
        if alerts.next_id < self.next_id {
            return;
        }
        self.next_id = alerts.next_id;
        for alert in &alerts.open {
            let entry = self.entries.entry((alert.kind, alert.subject.clone())).or_default();
            self.open += usize::from(entry.open.is_none());
            entry.open = Some(alert.clone());
        }
    }

    /// Accepts what is observed of all subjects of a kind. One that is not among them is gone.
    pub(crate) fn observe(&mut self, now: Tick, kind: AlertKind, conditions: Vec<Condition>) {
        let mut conditions: BTreeMap<_, _> =
            conditions.into_iter().map(|of| (of.subject.clone(), of)).collect();
        for ((of, subject), entry) in &mut self.entries {
            if *of != kind {
                continue;
            }
            let condition = conditions.remove(subject);
            // The fleet is never gone: what concerns all of it is observed by itself.
            if condition.is_some() || *subject != AlertSubject::Fleet {
                entry.observe(now, condition);
            }
        }
        for (subject, condition) in conditions {
            if condition.wanted == Wanted::Raise {
                self.entries.entry((kind, subject)).or_default().observe(now, Some(condition));
            }
        }
    }

    /// Raises and ends what has lasted for long enough. Returns the events of that, as many as may be published.
    pub(crate) fn advance(&mut self, now: Tick, delays: Delays) -> Vec<AlertEvent> {
        let is_due = |entry: &Entry| entry.due(delays).is_some_and(|due| due <= now);
        let due = self.entries.iter().filter(|(_, entry)| is_due(entry));
        let due: Vec<_> = due.map(|(key, _)| key.clone()).collect();
        let mut events = self.change(now, due);
        events.extend(self.folding_event(now));
        events
    }

    /// Raises an alert at once, if none of its kind and subject is open. Returns the event of it, if it may be
    /// published.
    pub(crate) fn raise_now(
        &mut self,
        now: Tick,
        kind: AlertKind,
        condition: Condition,
    ) -> Vec<AlertEvent> {
        let key = (kind, condition.subject.clone());
        self.entries.entry(key.clone()).or_default().observe(now, Some(condition));
        self.change(now, vec![key])
    }

    /// Ends the alert of a kind and subject at once, if one is open. Returns the event of it, if it may be
    /// published.
    pub(crate) fn clear_now(
        &mut self,
        now: Tick,
        kind: AlertKind,
        subject: AlertSubject,
    ) -> Vec<AlertEvent> {
        let key = (kind, subject);
        if let Some(entry) = self.entries.get_mut(&key) {
            entry.observe(now, None);
        }
        self.change(now, vec![key])
    }

    /// Does what is asked for.
    fn change(&mut self, now: Tick, due: Vec<(AlertKind, AlertSubject)>) -> Vec<AlertEvent> {
        let mut events = Vec::new();
        for key in due {
            let Some(entry) = self.entries.get_mut(&key) else { continue };
            if entry.since.take().is_none() {
                continue;
            }
            if let Some(alert) = entry.open.take() {
                self.open -= 1;
                self.changed = true;
                events.push(cleared(now, &alert));
            } else if let Some(condition) = entry.condition.clone() {
                if self.open >= MAX_OPEN_ALERTS {
                    self.fold(now);
                    continue;
                }
                let alert = raise(now, self.next_id, key.0, condition);
                self.next_id += 1;
                self.open += 1;
                self.changed = true;
                events.push(raised(&alert));
                entry.open = Some(alert);
            }
        }
        self.entries.retain(|_, entry| entry.open.is_some() || entry.since.is_some());
        events.retain(|_| self.may_publish(now));
        events
    }

    /// Notes that an operator has seen an alert. The event of it, if it may be published; none either where the operator had seen
    /// it before.
    ///
    /// # Errors
    /// If no such alert is open.
    pub(crate) fn acknowledge(
        &mut self,
        now: Tick,
        request: AcknowledgeAlert,
    ) -> Result<Option<AlertEvent>, NoSuchAlert> {
        let AcknowledgeAlert { operator, alert: id } = request;
        let mut open = self.entries.values_mut().filter_map(|entry| entry.open.as_mut());
        let alert = open.find(|alert| alert.id == id).ok_or(NoSuchAlert(id))?;
        if alert.acknowledged.as_ref().is_some_and(|by| by.operator == operator) {
            return Ok(None);
        }
        alert.acknowledged = Some(Acknowledgement { operator: operator.clone(), at: now });
        self.changed = true;
        let kind = EventKind::AlertAcknowledged { alert: id, operator };
        Ok(self.may_publish(now).then_some(AlertEvent { severity: Severity::Info, kind }))
    }

    /// Whether an alert of a kind and subject is open.
    pub(crate) fn is_open(&self, kind: AlertKind, subject: &AlertSubject) -> bool {
        let entry = self.entries.get(&(kind, subject.clone()));
        entry.is_some_and(|entry| entry.open.is_some())
    }

    /// The list.
    pub(crate) fn list(&self, header: Header) -> Alerts {
        let mut open: Vec<_> =
            self.entries.values().filter_map(|entry| entry.open.clone()).collect();
        open.sort_unstable_by_key(|alert| alert.id);
        Alerts { header, next_id: self.next_id, folded: self.folded_in_term, open }
    }

    /// Whether the list has changed since the last call.
    pub(crate) fn take_changed(&mut self) -> bool {
        std::mem::take(&mut self.changed)
    }

    /// When [`AlertBook::advance`] has something to do.
    pub(crate) fn due(&self, delays: Delays) -> Option<Tick> {
        let entries = self.entries.values().filter_map(|entry| entry.due(delays)).min();
        let folding = self.folded_since.map(|since| {
            let oldest = self.published.front().filter(|_| self.is_full());
            since.after(FOLDING_TIME).max(oldest.map_or(Tick(0), |at| at.after(EVENT_WINDOW)))
        });
        entries.into_iter().chain(folding).min()
    }

    fn is_full(&self) -> bool {
        self.published.len() >= MAX_ALERT_EVENTS_PER_MINUTE
    }

    /// Takes a place for an event, but for the last one: it is for the event that names how many were not published.
    fn may_publish(&mut self, now: Tick) -> bool {
        self.forget(now);
        if self.published.len() + 1 >= MAX_ALERT_EVENTS_PER_MINUTE {
            self.fold(now);
            return false;
        }
        self.published.push_back(now);
        true
    }

    fn fold(&mut self, now: Tick) {
        self.folded = self.folded.saturating_add(1);
        self.folded_in_term = self.folded_in_term.saturating_add(1);
        self.folded_since.get_or_insert(now);
    }

    /// The event that says how many were not published.
    fn folding_event(&mut self, now: Tick) -> Option<AlertEvent> {
        self.forget(now);
        let since = self.folded_since?;
        if now < since.after(FOLDING_TIME) || self.is_full() {
            return None;
        }
        self.published.push_back(now);
        self.folded_since = None;
        let count = std::mem::take(&mut self.folded);
        let kind = EventKind::AlertsFolded { count };
        Some(AlertEvent { severity: Severity::Warning, kind })
    }

    fn forget(&mut self, now: Tick) {
        while self.published.front().is_some_and(|at| at.after(EVENT_WINDOW) <= now) {
            self.published.pop_front();
        }
    }
}

fn raise(now: Tick, id: u64, kind: AlertKind, condition: Condition) -> Alert {
    let Condition { subject, value, threshold, reason, mut robots, .. } = condition;
    robots.truncate(MAX_ALERT_ROBOTS);
    Alert { id, kind, subject, raised: now, value, threshold, reason, robots, acknowledged: None }
}

fn raised(alert: &Alert) -> AlertEvent {
    let kind = EventKind::AlertRaised {
        alert: alert.id,
        kind: alert.kind,
        team: alert.subject.team().cloned(),
        modality: alert.subject.modality().cloned(),
        value: alert.value,
        threshold: alert.threshold,
        reason: alert.reason.clone(),
        robots: alert.robots.clone(),
    };
    AlertEvent { severity: alert.kind.severity(), kind }
}

fn cleared(now: Tick, alert: &Alert) -> AlertEvent {
    let kind = EventKind::AlertCleared {
        alert: alert.id,
        kind: alert.kind,
        team: alert.subject.team().cloned(),
        modality: alert.subject.modality().cloned(),
        open_s: now.since(alert.raised).as_secs_f64(),
    };
    AlertEvent { severity: Severity::Info, kind }
}

#[cfg(test)]
mod tests;

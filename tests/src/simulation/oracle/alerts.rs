//! Alerts: one for each kind and subject, numbers that stand for one alert, and no end without a beginning.

use std::collections::{BTreeMap, BTreeSet};

use muster_model::alert::{AlertKind, AlertSubject, Alerts};
use muster_model::event::{Event, EventKind};
use muster_model::teams::Teams;

use super::super::clock::{Micros, SECOND};
use super::{Publisher, Verified, breach};

/// What one leader has published in one term.
#[derive(Debug, Default)]
struct Term {
    /// What each number stands for.
    given: BTreeMap<u64, (AlertKind, AlertSubject)>,
    /// The numbers of the last list.
    open: BTreeSet<u64>,
    /// The numbers that were on a list, and are no more.
    ended: BTreeSet<u64>,
    raised: BTreeSet<u64>,
    cleared: BTreeSet<u64>,
}

/// What was published of alerts.
#[derive(Debug, Default)]
pub(crate) struct AlertLog {
    terms: BTreeMap<(Publisher, u64), Term>,
    /// Since when divisions say that nothing satisfies the limits.
    conflict_since: Option<Micros>,
    /// Whether the last list says so.
    says_infeasible: bool,
}

/// How long all must have agreed until the list of alerts says why limits do not hold: longer than what raises an alert
/// must last.
pub(crate) const ALERTED_WITHIN: Micros = 5 * SECOND;

impl AlertLog {
    /// Checks a list.
    pub(crate) fn check_list(&mut self, publisher: Publisher, alerts: &Alerts) -> Verified {
        let term = self.terms.entry((publisher, alerts.header.revision.term)).or_default();
        self.says_infeasible = alerts.open.iter().any(|of| of.kind == AlertKind::Infeasible);
        let mut subjects = BTreeSet::new();
        let mut open = BTreeSet::new();
        for alert in &alerts.open {
            let what = (alert.kind, alert.subject.clone());
            if !subjects.insert(what.clone()) {
                return breach(
                    "one open alert for each kind and subject",
                    format!("{} of {} is open twice", alert.kind, alert.subject),
                );
            }
            let known = term.given.entry(alert.id).or_insert_with(|| what.clone());
            let is_other = *known != what || term.ended.contains(&alert.id);
            if is_other || !open.insert(alert.id) || alert.id >= alerts.next_id {
                return breach(
                    "the number of an alert is used once in a term",
                    format!("{} was {known:?}, and is {what:?}", alert.id),
                );
            }
        }
        term.ended.extend(term.open.difference(&open));
        term.open = open;
        Ok(())
    }

    /// A division was published.
    pub(crate) fn divided(&mut self, now: Micros, teams: &Teams) {
        let conflict = teams.limited.as_ref().and_then(|limited| limited.conflict.as_ref());
        self.conflict_since = conflict.map(|_| self.conflict_since.unwrap_or(now));
    }

    /// All services have ended: no division stands until one is published again.
    pub(crate) fn all_ended(&mut self) {
        self.conflict_since = None;
    }

    /// Checks, once all have agreed for a while, that an alert says why limits or needs do not hold.
    pub(crate) fn check_conflict(&self, now: Micros) -> Verified {
        if self.says_infeasible || self.conflict_since.is_none_or(|at| now < at + ALERTED_WITHIN) {
            return Ok(());
        }
        breach(
            "an alert is open while nothing satisfies the limits",
            format!("there is none, since {:?}", self.conflict_since),
        )
    }

    /// Checks an event.
    pub(crate) fn check_event(&mut self, publisher: Publisher, event: &Event) -> Verified {
        let (EventKind::AlertRaised { alert, .. } | EventKind::AlertCleared { alert, .. }) =
            event.kind
        else {
            return Ok(());
        };
        let term = self.terms.entry((publisher, event.header.revision.term)).or_default();
        let is_raised = matches!(event.kind, EventKind::AlertRaised { .. });
        let all = if is_raised { &mut term.raised } else { &mut term.cleared };
        if !all.insert(alert) || (is_raised && term.cleared.contains(&alert)) {
            return breach(
                "an alert is raised once and ends once",
                format!("{:?} comes again for {alert}", event.kind),
            );
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use muster_model::id::ServiceName;

    use super::super::super::mutants::messages::alert;
    use super::super::samples::{oracle_of_a_divided_fleet, promise};
    use super::*;

    #[test]
    fn two_open_alerts_of_one_kind_and_subject_are_seen() {
        let header = oracle_of_a_divided_fleet().divisions.last().unwrap().header.clone();
        let list = |open: &[u64]| Alerts {
            header: header.clone(),
            next_id: 9,
            folded: 0,
            open: open.iter().map(|id| alert(*id, AlertKind::Churn)).collect(),
        };
        let publisher = Publisher { service: ServiceName::Auditor, instance: 0, process: 0 };
        let mut log = AlertLog::default();
        assert_eq!(log.check_list(publisher, &list(&[1])), Ok(()));
        let twice = log.check_list(publisher, &list(&[1, 2]));
        assert_eq!(promise(twice), "one open alert for each kind and subject");
    }

    /// Few runs end while nothing satisfies the limits, so that no mutant would be found.
    #[test]
    fn a_conflict_without_an_alert_is_seen() {
        let mut log = AlertLog { conflict_since: Some(7), ..AlertLog::default() };
        assert_eq!(log.check_conflict(6 + ALERTED_WITHIN), Ok(()));
        assert_eq!(
            promise(log.check_conflict(7 + ALERTED_WITHIN)),
            "an alert is open while nothing satisfies the limits"
        );
        log.says_infeasible = true;
        assert_eq!(log.check_conflict(7 + ALERTED_WITHIN), Ok(()));
        log.says_infeasible = false;
        log.all_ended();
        assert_eq!(log.check_conflict(7 + ALERTED_WITHIN), Ok(()));
        log = AlertLog::default();
        assert_eq!(log.check_conflict(7 + ALERTED_WITHIN), Ok(()));
    }
}

//! What operators should look at: alerts that are open, and who has seen them.

use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::content::{Content, ContentError, refuse};
use crate::event::Severity;
use crate::header::Header;
use crate::id::{Modality, OperatorId, RobotId, TeamId};
use crate::limits::{MAX_ALERT_ROBOTS, MAX_OPEN_ALERTS};
use crate::time::Tick;

/// What an alert is about.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum AlertKind {
    /// The silhouettes of a division, or of one team, are low.
    Poor,
    /// No link joins the parts of a team.
    CutOff,
    /// The leader of a team is stale.
    Leaderless,
    /// A team has too few robots to be one.
    Singleton,
    /// Many robots of a team are stale.
    Stale,
    /// Many robots change teams.
    Churn,
    /// The loss of one robot would cut off much of its team.
    Fragile,
    /// Robots change their team and change back.
    Flapping,
    /// A modality contradicts the others.
    ModalityDoubted,
    /// A team lacks what it needs.
    Lacking,
    /// Limits or wishes cannot hold together.
    Infeasible,
    /// The history has gaps, or cannot be written.
    HistoryDegraded,
}

impl AlertKind {
    /// All kinds.
    pub const ALL: [Self; 12] = [
        Self::Poor,
        Self::CutOff,
        Self::Leaderless,
        Self::Singleton,
        Self::Stale,
        Self::Churn,
        Self::Fragile,
        Self::Flapping,
        Self::ModalityDoubted,
        Self::Lacking,
        Self::Infeasible,
        Self::HistoryDegraded,
    ];

    /// Its name as in JSON.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Poor => "poor",
            Self::CutOff => "cut_off",
            Self::Leaderless => "leaderless",
            Self::Singleton => "singleton",
            Self::Stale => "stale",
            Self::Churn => "churn",
            Self::Fragile => "fragile",
            Self::Flapping => "flapping",
            Self::ModalityDoubted => "modality_doubted",
            Self::Lacking => "lacking",
            Self::Infeasible => "infeasible",
            Self::HistoryDegraded => "history_degraded",
        }
    }

    /// How much it matters: what needs an operator is a warning.
    #[must_use]
    pub const fn severity(self) -> Severity {
        match self {
            Self::Singleton | Self::Churn | Self::Fragile => Severity::Info,
            _ => Severity::Warning,
        }
    }
}

impl fmt::Display for AlertKind {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.as_str())
    }
}

/// Whom an alert concerns.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum AlertSubject {
    /// The whole fleet.
    Fleet,
    /// One team.
    Team(TeamId),
    /// One modality.
    Modality(Modality),
}

impl AlertSubject {
    /// The team, if it is one.
    #[must_use]
    pub fn team(&self) -> Option<&TeamId> {
        match self {
            Self::Team(team) => Some(team),
            Self::Fleet | Self::Modality(_) => None,
        }
    }

    /// The modality, if it is one.
    #[must_use]
    pub fn modality(&self) -> Option<&Modality> {
        match self {
            Self::Modality(modality) => Some(modality),
            Self::Fleet | Self::Team(_) => None,
        }
    }
}

impl fmt::Display for AlertSubject {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Fleet => formatter.write_str("fleet"),
            Self::Team(team) => team.fmt(formatter),
            Self::Modality(modality) => modality.fmt(formatter),
        }
    }
}

/// Who has seen an alert, and when.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Acknowledgement {
    /// The operator.
    pub operator: OperatorId,
    /// By the clock of the auditor's host.
    pub at: Tick,
}

/// One open alert. There is at most one for each kind and subject.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Alert {
    /// Its number. Numbers are not used twice as long as the list of alerts is known to any instance of the
    /// auditor or to the clusterer.
    pub id: u64,
    /// What it is about.
    pub kind: AlertKind,
    /// Whom it concerns.
    pub subject: AlertSubject,
    /// When it was raised, by the clock of the auditor's host.
    pub raised: Tick,
    /// What was measured when it was raised.
    pub value: f64,
    /// The threshold that was passed.
    pub threshold: f64,
    /// What is wrong, in words.
    pub reason: String,
    /// The robots that it is about, those that matter most first.
    pub robots: Vec<RobotId>,
    /// Who has seen it.
    pub acknowledged: Option<Acknowledgement>,
}

/// All open alerts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Alerts {
    /// The head of the message.
    pub header: Header,
    /// The number that the next alert will get.
    pub next_id: u64,
    /// How many events of alerts were not published in this term, because there were too many in a minute.
    pub folded: u64,
    /// The open alerts, ordered by number.
    pub open: Vec<Alert>,
}

impl Content for Alerts {
    /// Alerts are ordered by number, each kind and subject stands once, numbers are finite, and no more
    /// are listed than may be.
    fn check(&self) -> Result<(), ContentError> {
        if self.open.len() > MAX_OPEN_ALERTS {
            return refuse("open", "are more alerts than may be open");
        }
        if !self.open.is_sorted_by(|left, right| left.id < right.id) {
            return refuse("open.id", "must be ordered by number without repetition");
        }
        if self.open.last().is_some_and(|last| last.id >= self.next_id) {
            return refuse("next_id", "must be above the number of every alert");
        }
        let mut subjects: Vec<_> = self.open.iter().map(|of| (of.kind, &of.subject)).collect();
        subjects.sort_unstable();
        if !subjects.is_sorted_by(|left, right| left < right) {
            return refuse("open.kind", "stands twice for one subject");
        }
        if !self.open.iter().all(|of| of.value.is_finite() && of.threshold.is_finite()) {
            return refuse("open.value", "must be finite");
        }
        if self.open.iter().any(|of| of.robots.len() > MAX_ALERT_ROBOTS) {
            return refuse("open.robots", "are more than may be listed");
        }
        Ok(())
    }
}

/// What an operator sends to acknowledge an alert.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AcknowledgeAlert {
    /// Who has seen it.
    pub operator: OperatorId,
    /// The number of the alert.
    pub alert: u64,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::header::Revision;
    use crate::id::FleetId;

    fn alerts(open: &[(u64, AlertKind, AlertSubject)]) -> Alerts {
        let alert = |(id, kind, subject): &(u64, AlertKind, AlertSubject)| Alert {
            id: *id,
            kind: *kind,
            subject: subject.clone(),
            raised: Tick(1),
            value: 2.0,
            threshold: 1.0,
            reason: String::new(),
            robots: Vec::new(),
            acknowledged: None,
        };
        Alerts {
            header: Header {
                fleet: FleetId::new("f").unwrap(),
                revision: Revision::default(),
                oldest: None,
                newest: None,
                stages: Vec::new(),
            },
            next_id: 5,
            folded: 0,
            open: open.iter().map(alert).collect(),
        }
    }

    #[test]
    fn a_list_has_each_number_and_each_kind_of_a_subject_once() {
        let t1 = || AlertSubject::Team(TeamId::numbered(1));
        let sound = [
            (1, AlertKind::CutOff, t1()),
            (2, AlertKind::Stale, t1()),
            (4, AlertKind::CutOff, AlertSubject::Fleet),
        ];
        assert_eq!(alerts(&sound).check(), Ok(()));
        let field = |open: &[_]| alerts(open).check().unwrap_err().field;
        assert_eq!(field(&[(2, AlertKind::Stale, t1()), (1, AlertKind::Poor, t1())]), "open.id");
        assert_eq!(field(&[(5, AlertKind::Stale, t1())]), "next_id");
        assert_eq!(field(&[(1, AlertKind::Stale, t1()), (2, AlertKind::Stale, t1())]), "open.kind");
        let mut wrong = alerts(&sound);
        wrong.open[1].value = f64::NAN;
        assert_eq!(wrong.check().unwrap_err().field, "open.value");
        wrong = alerts(&sound);
        wrong.open[0].robots = vec![RobotId::new("r").unwrap(); MAX_ALERT_ROBOTS + 1];
        assert_eq!(wrong.check().unwrap_err().field, "open.robots");
    }

    #[test]
    fn every_kind_has_the_name_that_json_has() {
        for kind in AlertKind::ALL {
            assert_eq!(serde_json::to_value(kind).unwrap(), kind.as_str());
        }
    }
}

//! What is wrong with a division that has been made: robots that go to and fro, and modalities that
//! contradict the others.

use std::collections::BTreeMap;

use muster_model::alert::{AlertKind, Alerts};
use muster_model::audit::Flapping;
use muster_model::embedding::EmbeddingGraph;
use muster_model::event::{Event, EventKind, Severity};
use muster_model::id::{Modality, RobotId};
use muster_model::settings::AuditorSettings;

use muster_wire::message::plain_reason;

use super::{Finding, warning};
use crate::doctor::look::Look;
use crate::show::page::names;

pub(super) fn division(look: &Look) -> Vec<Finding> {
    let flapping = look
        .audit
        .as_ref()
        .and_then(|audit| flapping(&audit.flapping, &look.auditor.clone().unwrap_or_default()));
    let graphs = look.embedding.as_ref().map_or(&[][..], |embedding| &embedding.graphs);
    let open = look.alerts.as_deref().and_then(alerts);
    flapping.into_iter().chain(doubted(graphs, &look.events)).chain(open).collect()
}

/// Robots that change their team and change back.
fn flapping(flapping: &Flapping, settings: &AuditorSettings) -> Option<Finding> {
    if !flapping.is_above(settings.flapping) {
        return None;
    }
    let robots = flapping.robots.iter().map(|entry| &entry.robot);
    let seen = format!(
        "robots change teams to and fro: {:.2} times per robot and minute, most often {}",
        flapping.returns_per_robot_minute,
        names(robots.clone())
    );
    let remedy = "the number of teams may not fit the groups that the robots form: let it follow them, `muster \
                  set clusterer teams=auto`. If it fits, let robots stay longer: raise dwell_s or \
                  hysteresis of clusterer. `flapping` of auditor is the rate from which on this is reported";
    Some(warning("teams_flapping", seen, remedy).about(robots))
}

/// Alerts that are open, and that no operator has seen. What has a finding of its own is left to that.
fn alerts(alerts: &Alerts) -> Option<Finding> {
    let has_finding = |kind| matches!(kind, AlertKind::Flapping | AlertKind::ModalityDoubted);
    let unseen = alerts.open.iter().filter(|alert| {
        alert.acknowledged.is_none()
            && alert.kind.severity() > Severity::Info
            && !has_finding(alert.kind)
    });
    let unseen: Vec<_> = unseen.collect();
    let first = unseen.first()?;
    let named = unseen.iter().map(|alert| format!("{} of {}", alert.kind, alert.subject));
    let seen = format!("alerts are open: {}; {}", names(named), plain_reason(&first.reason));
    let remedy = format!(
        "`muster alerts` shows them, and `muster alerts ack {}` says that one has been seen; \
         the thresholds are settings of auditor",
        first.id
    );
    let subjects = unseen.iter().map(|alert| &alert.subject);
    Some(warning("alerts_open", seen, remedy).about(subjects))
}

/// Modalities that contradict the others.
fn doubted(graphs: &[EmbeddingGraph], events: &[Event]) -> Vec<Finding> {
    // The last event of each modality names the robots.
    let mut robots: BTreeMap<&Modality, &[RobotId]> = BTreeMap::new();
    for event in events {
        if let EventKind::ModalityDoubted { modality, robots: worst, .. } = &event.kind {
            robots.insert(modality, worst);
        }
    }
    let finding = |graph: &EmbeddingGraph| {
        let EmbeddingGraph { modality, trust, .. } = graph;
        let worst = robots.get(modality).copied().unwrap_or_default();
        let named = if worst.is_empty() {
            String::new()
        } else {
            format!("; most of all for {}", names(worst.iter()))
        };
        let finding = warning(
            "modality_doubted",
            format!(
                "modality {modality} is in doubt: {:.0} % of its weight is used, since it ties robots that \
                 the other modalities hold apart{named}",
                trust * 100.0
            ),
            format!(
                "check where the {modality} reports of these robots come from. If they are right, hold \
                 the trust in them at 1: `muster set embedder 'trusted=[\"{modality}\"]'`, or \
                 trusted=all"
            ),
        );
        if worst.is_empty() { finding.about([modality]) } else { finding.about(worst) }
    };
    graphs.iter().filter(|graph| graph.is_doubted()).map(finding).collect()
}

#[cfg(test)]
mod tests {
    use muster_model::alert::{Acknowledgement, Alert, AlertSubject};
    use muster_model::audit::RobotReturns;
    use muster_model::header::{Header, Revision};
    use muster_model::id::{FleetId, OperatorId, ServiceName, TeamId};
    use muster_model::time::Tick;

    use super::*;

    fn robot(name: &str) -> RobotId {
        RobotId::new(name).unwrap()
    }

    #[test]
    fn robots_that_go_to_and_fro_are_found_by_the_threshold_of_the_auditor() {
        let of = |rate, returns| Flapping {
            returns_per_robot_minute: rate,
            robots: vec![RobotReturns { robot: robot("r1"), returns }],
        };
        let settings = AuditorSettings::default();
        assert!(flapping(&Flapping::default(), &settings).is_none());
        assert!(flapping(&of(0.9, 1), &settings).is_none(), "it walked back once");
        let found = flapping(&of(0.9, 2), &settings).unwrap();
        assert_eq!((found.id, &found.subjects[..]), ("teams_flapping", &["r1".to_owned()][..]));
        assert!(found.seen.contains("0.90") && found.remedy.contains("teams=auto"), "{found:?}");
        assert!(flapping(&of(0.9, 2), &AuditorSettings { flapping: 1.0, ..settings }).is_none());
    }

    #[test]
    fn open_alerts_that_nobody_has_seen_are_found() {
        let alert = |id, kind, acknowledged| Alert {
            id,
            kind,
            subject: AlertSubject::Team(TeamId::numbered(id)),
            raised: Tick(1),
            value: 2.0,
            threshold: 2.0,
            reason: "no link joins its parts".to_owned(),
            robots: vec![],
            acknowledged,
        };
        let by = Acknowledgement { operator: OperatorId::new("kim").unwrap(), at: Tick(2) };
        let list = |open| Alerts {
            header: Header {
                fleet: FleetId::new("f").unwrap(),
                revision: Revision::default(),
                oldest: None,
                newest: None,
                stages: vec![],
            },
            next_id: 9,
            folded: 0,
            open,
        };
        let quiet = vec![
            alert(1, AlertKind::CutOff, Some(by)),
            alert(2, AlertKind::Fragile, None),
            alert(3, AlertKind::Flapping, None),
        ];
        assert!(alerts(&list(quiet.clone())).is_none());
        let open = [quiet, vec![alert(4, AlertKind::CutOff, None)]].concat();
        let found = alerts(&list(open)).unwrap();
        assert_eq!((found.id, &found.subjects[..]), ("alerts_open", &["t4".to_owned()][..]));
        assert!(
            found.seen.contains("cut_off of t4") && found.remedy.contains("ack 4"),
            "{found:?}"
        );
    }

    #[test]
    fn a_modality_in_doubt_is_found_with_the_robots_of_its_last_event() {
        let graph = |modality, trust| EmbeddingGraph {
            modality,
            revision: Revision::default(),
            weight: 0.5 * trust,
            trust,
        };
        let event = |modality, names: &[&str]| Event {
            header: Header {
                fleet: FleetId::new("f").unwrap(),
                revision: Revision::default(),
                oldest: None,
                newest: None,
                stages: vec![],
            },
            source: ServiceName::Embedder,
            severity: Severity::Warning,
            kind: EventKind::ModalityDoubted {
                modality,
                trust: 0.2,
                robots: names.iter().map(|name| robot(name)).collect(),
            },
        };
        let graphs = [graph(Modality::spatial(), 1.0), graph(Modality::hierarchy(), 0.2)];
        assert!(doubted(&graphs[..1], &[event(Modality::spatial(), &["r1"])]).is_empty());
        let found = doubted(&graphs, &[event(Modality::spatial(), &["r1"])]);
        assert_eq!((found.len(), &found[0].subjects[..]), (1, &["hierarchy".to_owned()][..]));
        assert!(found[0].seen.contains("20 %") && found[0].remedy.contains("trusted=all"));
        let events =
            [event(Modality::hierarchy(), &["r1"]), event(Modality::hierarchy(), &["r2", "r3"])];
        let found = doubted(&graphs, &events);
        assert_eq!(
            (found[0].id, &found[0].subjects[..]),
            ("modality_doubted", &["r2", "r3"].map(str::to_owned)[..])
        );
    }
}

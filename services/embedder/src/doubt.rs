//! When it is reported that a modality is in doubt, and that it is trusted again.

use std::collections::BTreeMap;
use std::time::Duration;

use muster_model::embedding::EmbeddingGraph;
use muster_model::event::{EventKind, Severity};
use muster_model::id::{Modality, RobotId};
use muster_model::limits::MAX_DOUBTED_ROBOTS;
use muster_model::time::Tick;

/// How long the trust must be low, or high again, before it is reported: one frame in which few robots
/// report is no fault of a source.
const DOUBT_AFTER: Duration = Duration::from_secs(1);

/// Trust above which a modality that was in doubt is trusted again: clearly more than
/// [`EmbeddingGraph::DOUBTED_BELOW`], so that trust near that limit raises one event.
const TRUSTED_ABOVE: f64 = 0.8;

/// What an embedding says of one modality.
#[derive(Debug, Clone)]
pub(crate) struct ModalityTrust {
    pub(crate) modality: Modality,
    /// By how much its weight is multiplied, from 0 to 1.
    pub(crate) trust: f64,
    /// The robots that disagree most with the other modalities, the worst first.
    pub(crate) robots: Vec<RobotId>,
}

/// An event to publish.
#[derive(Debug, PartialEq)]
pub(crate) struct DoubtEvent {
    pub(crate) severity: Severity,
    pub(crate) kind: EventKind,
}

/// What is known of one modality.
#[derive(Debug, Clone, Copy, Default)]
struct State {
    doubted: bool,
    /// Since when the trust asks for the other state.
    otherwise_since: Option<Tick>,
}

/// Watches the trust in each modality.
#[derive(Debug, Default)]
pub(crate) struct Doubts(BTreeMap<Modality, State>);

impl Doubts {
    /// Accepts the trust of an embedding, and gives what is to be reported. A modality that is not among
    /// them is forgotten: a source that comes again begins trusted.
    pub(crate) fn observe(&mut self, now: Tick, all: Vec<ModalityTrust>) -> Vec<DoubtEvent> {
        self.0.retain(|modality, _| all.iter().any(|of| of.modality == *modality));
        let mut events = Vec::new();
        for of in all {
            let state = self.0.entry(of.modality.clone()).or_default();
            let is_otherwise = if state.doubted {
                of.trust > TRUSTED_ABOVE
            } else {
                of.trust < EmbeddingGraph::DOUBTED_BELOW
            };
            if !is_otherwise {
                state.otherwise_since = None;
                continue;
            }
            let since = *state.otherwise_since.get_or_insert(now);
            if now.since(since) >= DOUBT_AFTER {
                *state = State { doubted: !state.doubted, otherwise_since: None };
                events.push(event(of, state.doubted));
            }
        }
        events
    }
}

fn event(of: ModalityTrust, doubted: bool) -> DoubtEvent {
    let ModalityTrust { modality, trust, mut robots } = of;
    if doubted {
        robots.truncate(MAX_DOUBTED_ROBOTS);
        let kind = EventKind::ModalityDoubted { modality, trust, robots };
        DoubtEvent { severity: Severity::Warning, kind }
    } else {
        DoubtEvent {
            severity: Severity::Info,
            kind: EventKind::ModalityTrusted { modality, trust },
        }
    }
}

#[cfg(test)]
mod tests {
    use muster_model::time::seconds;

    use super::*;

    fn of(modality: Modality, trust: f64) -> ModalityTrust {
        let robot = |number| RobotId::new(format!("r{number}")).unwrap();
        ModalityTrust { modality, trust, robots: (0..20).map(robot).collect() }
    }

    /// What is reported of one modality for a series of trusts, one every half second; none where the
    /// modality is missing.
    fn reported(trusts: &[Option<f64>]) -> String {
        let mut doubts = Doubts::default();
        let mut at = Tick(0);
        let mut reported = String::new();
        for trust in trusts {
            let all = trust.map(|trust| of(Modality::spatial(), trust));
            let events = doubts.observe(at, all.into_iter().collect());
            reported.push(match events.first() {
                Some(DoubtEvent {
                    severity: Severity::Warning,
                    kind: EventKind::ModalityDoubted { trust, robots, .. },
                }) if *trust < 0.5 && robots.len() == MAX_DOUBTED_ROBOTS => '!',
                Some(DoubtEvent {
                    severity: Severity::Info,
                    kind: EventKind::ModalityTrusted { .. },
                }) => 'o',
                Some(_) => '?',
                None => '.',
            });
            at = at.after(seconds(0.5));
        }
        reported
    }

    #[test]
    fn doubt_needs_trust_that_stays_low() {
        let (low, half, high) = (Some(0.4), Some(0.5), Some(1.0));
        assert_eq!(reported(&[low, low, low, low]), "..!.");
        assert_eq!(reported(&[low, low, half, low, low, low]), ".....!");
        assert_eq!(reported(&[half; 5]), ".....");
        assert_eq!(reported(&[high; 5]), ".....");
    }

    #[test]
    fn it_ends_once_trust_stays_high() {
        let (low, between, high) = (Some(0.1), Some(0.8), Some(0.9));
        assert_eq!(reported(&[low, low, low, between, between, between]), "..!...");
        assert_eq!(reported(&[low, low, low, high, high, high, high]), "..!..o.");
        assert_eq!(reported(&[low, low, low, high, high, between, high, high, high]), "..!.....o");
        assert_eq!(reported(&[low, low, low, high, high, high, low, low, low]), "..!..o..!");
    }

    #[test]
    fn a_modality_that_is_gone_is_forgotten() {
        let low = Some(0.1);
        assert_eq!(reported(&[low, low, None, low, low, low]), ".....!");
        assert_eq!(reported(&[low, low, low, None, low, low, low]), "..!...!");
    }

    #[test]
    fn each_modality_is_watched_by_itself() {
        let mut doubts = Doubts::default();
        let at = |second| Tick(0).after(seconds(second));
        let all = |spatial, links| {
            vec![of(Modality::spatial(), spatial), of(Modality::connectivity(), links)]
        };
        assert_eq!(doubts.observe(at(0.0), all(0.1, 1.0)), []);
        assert_eq!(doubts.observe(at(0.6), all(0.1, 0.1)), []);
        let named = |events: Vec<DoubtEvent>| -> Vec<String> {
            let name = |event: DoubtEvent| match event.kind {
                EventKind::ModalityDoubted { modality, .. } => format!("{modality} doubted"),
                EventKind::ModalityTrusted { modality, .. } => format!("{modality} trusted"),
                other => format!("{other:?}"),
            };
            events.into_iter().map(name).collect()
        };
        assert_eq!(named(doubts.observe(at(1.0), all(0.1, 0.1))), ["spatial doubted"]);
        assert_eq!(named(doubts.observe(at(1.6), all(1.0, 0.1))), ["connectivity doubted"]);
        assert_eq!(named(doubts.observe(at(2.6), all(1.0, 0.1))), ["spatial trusted"]);
    }
}

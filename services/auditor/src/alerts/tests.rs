//! The list of alerts by itself.

use muster_model::header::Revision;
use muster_model::id::{FleetId, OperatorId, TeamId};
use muster_model::time::seconds;
use proptest::prelude::*;

use super::*;

const DELAYS: Delays = Delays { raise: Duration::from_secs(3), clear: Duration::from_secs(2) };

fn at(second: f64) -> Tick {
    Tick(1_000_000_000).after(seconds(second))
}

fn condition(team: u64, wanted: Wanted) -> Condition {
    Condition {
        subject: AlertSubject::Team(TeamId::numbered(team)),
        wanted,
        value: 2.0,
        threshold: 1.0,
        reason: "it is".to_owned(),
        robots: Vec::new(),
    }
}

fn list(book: &AlertBook) -> Alerts {
    book.list(Header {
        fleet: FleetId::new("f").unwrap(),
        revision: Revision::default(),
        oldest: None,
        newest: None,
        stages: Vec::new(),
    })
}

fn open(book: &AlertBook) -> Vec<String> {
    let name = |alert: &Alert| format!("{} {} {}", alert.id, alert.kind, alert.subject);
    list(book).open.iter().map(name).collect()
}

fn short(events: &[AlertEvent]) -> Vec<String> {
    let name = |event: &AlertEvent| match &event.kind {
        EventKind::AlertRaised { alert, .. } => format!("+{alert}"),
        EventKind::AlertCleared { alert, .. } => format!("-{alert}"),
        EventKind::AlertAcknowledged { alert, .. } => format!("seen {alert}"),
        EventKind::AlertsFolded { count } => format!("folded {count}"),
        other => format!("{other:?}"),
    };
    events.iter().map(name).collect()
}

/// What happens of one team that is observed every second.
fn observed(wanted: &str) -> String {
    let mut book = AlertBook::default();
    let mut found = String::new();
    for (second, wanted) in (0_u32..).zip(wanted.chars()) {
        let now = at(f64::from(second));
        let conditions = match wanted {
            '!' => vec![condition(1, Wanted::Raise)],
            '~' => vec![condition(1, Wanted::Neither)],
            'o' => vec![condition(1, Wanted::Clear)],
            _ => vec![],
        };
        book.observe(now, AlertKind::CutOff, conditions);
        let events = book.advance(now, DELAYS);
        found.push(match short(&events).first() {
            Some(event) if event.starts_with('+') => '+',
            Some(event) if event.starts_with('-') => '-',
            Some(_) => '?',
            None => '.',
        });
    }
    found
}

#[test]
fn what_is_wrong_must_last_and_so_must_its_end() {
    assert_eq!(observed("!!!!!!"), "...+..");
    assert_eq!(observed("!!!~!!!!"), ".......+");
    assert_eq!(observed("!!!o!!!!"), ".......+");
    assert_eq!(observed("!!!!ooo!"), "...+..-.");
    assert_eq!(observed("!!!!oo~ooo"), "...+.....-");
    assert_eq!(observed("!!!!~~~~"), "...+....");
    // The team is gone.
    assert_eq!(observed("!!!!    !"), "...+..-..");
    assert_eq!(observed("oooo"), "....");
}

#[test]
fn thresholds_leave_room_between_them() {
    assert_eq!(Wanted::above(0.3, 0.25, 0.125), Wanted::Raise);
    assert_eq!(Wanted::above(0.25, 0.25, 0.125), Wanted::Neither);
    assert_eq!(Wanted::above(0.125, 0.25, 0.125), Wanted::Clear);
    assert_eq!(Wanted::below(-0.1, 0.0, 0.05), Wanted::Raise);
    assert_eq!(Wanted::below(0.05, 0.0, 0.05), Wanted::Neither);
    assert_eq!(Wanted::below(0.06, 0.0, 0.05), Wanted::Clear);
}

#[test]
fn the_time_of_a_change_is_known() {
    let mut book = AlertBook::default();
    assert_eq!(book.due(DELAYS), None);
    book.observe(at(0.0), AlertKind::Stale, vec![condition(1, Wanted::Raise)]);
    assert_eq!(book.due(DELAYS), Some(at(3.0)));
    assert_eq!(short(&book.advance(at(3.0), DELAYS)), ["+1"]);
    assert_eq!(book.due(DELAYS), None);
    book.observe(at(4.0), AlertKind::Stale, vec![]);
    assert_eq!(book.due(DELAYS), Some(at(6.0)));
    // Another kind says nothing of this one.
    book.observe(at(5.0), AlertKind::CutOff, vec![]);
    assert_eq!(open(&book), ["1 stale t1"]);
}

#[test]
fn an_alert_of_the_fleet_is_raised_and_ends_at_once_and_leaves_the_others_alone() {
    let mut book = AlertBook::default();
    let fleet = || Condition { subject: AlertSubject::Fleet, ..condition(0, Wanted::Raise) };
    book.observe(at(0.0), AlertKind::Poor, vec![condition(1, Wanted::Raise)]);
    assert_eq!(short(&book.raise_now(at(0.0), AlertKind::Poor, fleet())), ["+1"]);
    assert!(book.raise_now(at(1.0), AlertKind::Poor, fleet()).is_empty(), "it is open");
    assert_eq!(short(&book.advance(at(3.0), DELAYS)), ["+2"]);
    // Observing teams says nothing of the fleet.
    book.observe(at(4.0), AlertKind::Poor, vec![]);
    assert_eq!(short(&book.advance(at(9.0), DELAYS)), ["-2"]);
    assert_eq!(open(&book), ["1 poor fleet"]);
    let ended = book.clear_now(at(9.0), AlertKind::Poor, AlertSubject::Fleet);
    assert_eq!(short(&ended), ["-1"]);
    assert!(book.clear_now(at(9.0), AlertKind::Poor, AlertSubject::Fleet).is_empty());
}

#[test]
fn an_acknowledgement_is_noted_once_and_lost_with_its_alert() {
    let mut book = AlertBook::default();
    let by = |operator: &str, alert| AcknowledgeAlert {
        operator: OperatorId::new(operator).unwrap(),
        alert,
    };
    assert_eq!(book.acknowledge(at(0.0), by("kim", 1)), Err(NoSuchAlert(1)));
    book.observe(at(0.0), AlertKind::CutOff, vec![condition(1, Wanted::Raise)]);
    book.advance(at(3.0), DELAYS);
    assert!(book.take_changed() && !book.take_changed());
    let seen = book.acknowledge(at(4.0), by("kim", 1)).unwrap();
    assert_eq!(short(&seen.into_iter().collect::<Vec<_>>()), ["seen 1"]);
    assert!(book.take_changed());
    assert_eq!(book.acknowledge(at(5.0), by("kim", 1)), Ok(None));
    assert!(book.acknowledge(at(5.0), by("lee", 1)).unwrap().is_some());
    let acknowledged = list(&book).open[0].acknowledged.clone().unwrap();
    assert_eq!((acknowledged.operator.as_str(), acknowledged.at), ("lee", at(5.0)));
    book.observe(at(6.0), AlertKind::CutOff, vec![]);
    book.advance(at(8.0), DELAYS);
    assert_eq!(book.acknowledge(at(9.0), by("kim", 1)), Err(NoSuchAlert(1)));
}

#[test]
fn a_standby_goes_on_with_numbers_and_acknowledgements() {
    let mut book = AlertBook::default();
    let teams = |wanted| (1..4).map(|team| condition(team, wanted)).collect::<Vec<_>>();
    book.observe(at(0.0), AlertKind::CutOff, teams(Wanted::Raise));
    book.advance(at(3.0), DELAYS);
    let operator = OperatorId::new("kim").unwrap();
    book.acknowledge(at(3.0), AcknowledgeAlert { operator, alert: 2 }).unwrap();
    let mut other = AlertBook::default();
    other.inherit(&list(&book));
    assert_eq!(list(&other).open, list(&book).open);
    // What goes on is not raised again, what is over ends, and what is new has a new number.
    other.observe(
        at(9.0),
        AlertKind::CutOff,
        vec![condition(2, Wanted::Raise), condition(7, Wanted::Raise)],
    );
    assert_eq!(short(&other.advance(at(13.0), DELAYS)), ["-1", "-3", "+4"]);
    assert_eq!(open(&other), ["2 cut_off t2", "4 cut_off t7"]);
    assert!(list(&other).open[0].acknowledged.is_some());
}

#[test]
fn of_many_events_few_are_published_and_the_others_are_counted() {
    let mut book = AlertBook::default();
    let teams = |wanted| (1..=50).map(|team| condition(team, wanted)).collect::<Vec<_>>();
    book.observe(at(0.0), AlertKind::CutOff, teams(Wanted::Raise));
    assert_eq!(book.advance(at(3.0), DELAYS).len(), 19);
    assert_eq!(open(&book).len(), 50, "the list is whole");
    assert_eq!(book.due(DELAYS), Some(at(8.0)));
    assert_eq!(short(&book.advance(at(8.0), DELAYS)), ["folded 31"]);
    assert_eq!(book.due(DELAYS), None);
    book.observe(at(9.0), AlertKind::CutOff, vec![]);
    assert!(book.advance(at(11.0), DELAYS).is_empty());
    // There is no place for the number either before the first event is a minute old.
    assert_eq!(book.due(DELAYS), Some(at(63.0)));
    assert_eq!(short(&book.advance(at(63.0), DELAYS)), ["folded 50"]);
    assert_eq!(list(&book).folded, 81);
}

proptest! {
    #[test]
    fn whatever_is_observed_alerts_are_one_for_each_subject_and_end_once(
        steps in prop::collection::vec((0_u32..2000, 0_usize..3, prop::collection::vec(0_u8..4, 12)), 1..60)
    ) {
        let kinds = [AlertKind::CutOff, AlertKind::Stale, AlertKind::Fragile];
        let mut book = AlertBook::default();
        let (mut second, mut times) = (0.0, Vec::new());
        let (mut raised, mut ended) = (Vec::new(), Vec::new());
        for (wait, kind, wanted) in steps {
            second += f64::from(wait) / 1000.0;
            let conditions = (1..).zip(&wanted).filter_map(|(team, wanted)| {
                let wanted = [Wanted::Raise, Wanted::Neither, Wanted::Clear].get(usize::from(*wanted));
                wanted.map(|wanted| condition(team, *wanted))
            });
            book.observe(at(second), kinds[kind], conditions.collect());
            let before = list(&book).open;
            let events = book.advance(at(second), DELAYS);
            let after = list(&book);
            prop_assert_eq!(muster_model::content::Content::check(&after), Ok(()));
            let is_in = |all: &[Alert], id| all.iter().any(|alert| alert.id == id);
            raised.extend(after.open.iter().map(|of| of.id).filter(|id| !is_in(&before, *id)));
            ended.extend(before.iter().map(|of| of.id).filter(|id| !is_in(&after.open, *id)));
            times.extend(events.iter().map(|_| second));
        }
        for ids in [&mut raised, &mut ended] {
            ids.sort_unstable();
            prop_assert!(ids.is_sorted_by(|left, right| left < right), "{:?}", ids);
        }
        prop_assert!(ended.iter().all(|id| raised.contains(id)));
        for (place, start) in times.iter().enumerate() {
            let within = times[place..].iter().filter(|time| **time < start + 60.0).count();
            prop_assert!(within <= MAX_ALERT_EVENTS_PER_MINUTE, "{}", within);
        }
    }
}

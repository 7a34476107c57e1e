//! What an instance does when leases, tokens and links come and go.

use muster_model::header::Header;
use muster_model::id::{FleetId, ServiceName};

use super::RenewalSource::{Answered, Published};
use super::*;
use crate::replica::peers::MAX_PEERS;

const START: Tick = Tick(1_000_000_000);

fn at(seconds: f64) -> Tick {
    START.after(Duration::from_secs_f64(seconds))
}

fn name(host: &str) -> InstanceId {
    InstanceId::of_process(host, 1, 1)
}

fn renewal(host: &str, term: u64) -> LeaseRenewal {
    LeaseRenewal {
        header: Header {
            fleet: FleetId::new("f").unwrap(),
            revision: Revision { term, epoch: 5 },
            oldest: None,
            newest: None,
            stages: Vec::new(),
        },
        service: ServiceName::Ingest,
        instance: name(host),
    }
}

/// An instance on host `b` that knows of no other one and asks the bus.
fn asking() -> Election {
    let mut election = Election::new(name("b"), START, Replication::OneLeads);
    election.inquire();
    election
}

/// An instance on host `b` that knows of hosts `a` and `c`.
fn between() -> Election {
    let mut election = Election::new(name("b"), START, Replication::OneLeads);
    election.token(START, name("a"), true);
    election.token(START, name("c"), true);
    election
}

/// The same as the leader.
fn leading() -> Election {
    let mut election = between();
    election.lead(START);
    election
}

/// The same as a standby of a leader on a host.
fn standby_of(host: &str) -> Election {
    let mut election = between();
    assert_eq!(election.renewal(START, &renewal(host, 3), Answered, 0), Rivalry::None);
    assert_eq!(election.decide(START), Decision::StandBy);
    election
}

/// The instance asks who leads, and no other one answers.
fn unanswered(election: &mut Election, query: u64) {
    election.leader_query_sent(query);
    election.leader_query_unanswered(query);
}

/// Lets an instance run until it takes over; when that is.
fn takes_over(election: &mut Election, from: f64, until: f64) -> Option<f64> {
    let mut now = at(from);
    while now <= at(until) {
        assert!(!election.notice_pause(now));
        if election.takes_over(now) {
            return Some(now.since(START).as_secs_f64());
        }
        now = election.deadline().unwrap().max(now.after(Duration::from_millis(1)));
    }
    None
}

#[test]
fn the_first_leads_and_the_others_wait_before_they_take_over() {
    let mut alone = Election::new(name("b"), START, Replication::OneLeads);
    assert_eq!(alone.decide(START), Decision::Lead);
    let mut second = between();
    assert_eq!(second.decide(START), Decision::StandBy);
    let taken = takes_over(&mut second, 0.0, 10.0).unwrap();
    assert!((0.5..0.6).contains(&taken), "{taken}");
    assert_eq!(second.decide(at(taken)), Decision::Lead);
    // The first leads meanwhile.
    let mut second = between();
    second.decide(START);
    second.renewal(at(0.1), &renewal("a", 1), Published, 0);
    assert_eq!(takes_over(&mut second, 0.0, 2.0), None);
}

#[test]
fn a_standby_takes_over_at_once_after_a_lost_token_and_after_the_lease_when_there_is_silence() {
    let mut election = standby_of("a");
    election.token(at(1.0), name("a"), false);
    let taken = takes_over(&mut election, 0.9, 9.0).unwrap();
    assert!((1.2..1.3).contains(&taken), "{taken}");

    let taken = takes_over(&mut standby_of("a"), 0.0, 9.0).unwrap();
    assert!((2.0..2.1).contains(&taken), "{taken}");
    // One with a lower name goes first.
    let taken = takes_over(&mut standby_of("c"), 0.0, 9.0).unwrap();
    assert!((2.3..2.4).contains(&taken), "{taken}");
}

#[test]
fn a_leader_that_renews_its_lease_is_not_replaced() {
    let mut election = standby_of("c");
    for half in 1..40 {
        let now = f64::from(half) * 0.5;
        assert_eq!(takes_over(&mut election, now - 0.5, now - 0.1), None);
        election.renewal(at(now), &renewal("c", 3), Published, 0);
    }
}

#[test]
fn a_lost_link_proves_nothing_about_the_leader() {
    let mut election = standby_of("a");
    election.token(at(0.5), name("a"), false);
    election.link_lost();
    assert_eq!(takes_over(&mut election, 0.5, 60.0), None);
    election.link_restored(at(60.1));
    let taken = takes_over(&mut election, 60.1, 70.0).unwrap();
    assert!((62.1..62.2).contains(&taken), "{taken}");
}

#[test]
fn a_standby_that_was_paused_gives_its_leader_the_whole_lease_again() {
    let mut election = standby_of("a");
    assert!(election.notice_pause(at(30.0)));
    assert_eq!(election.state(), ReplicaState::Standby, "only a leader becomes suspect");
    assert!(!election.takes_over(at(30.0)));
    assert_eq!(takes_over(&mut election, 30.0, 31.9), None);
    assert!(takes_over(&mut election, 31.9, 32.1).is_some());
}

#[test]
fn a_leader_that_was_paused_or_cut_off_is_suspect() {
    let mut election = leading();
    assert!(!election.notice_pause(at(1.0)));
    assert!(election.notice_pause(at(3.0)));
    assert_eq!(election.state(), ReplicaState::Suspect);
    assert!(election.lease().is_none());
    assert!(!election.confirm(at(4.0)), "no query was sent");
    unanswered(&mut election, 1);
    assert!(!election.confirm(at(3.1)), "the link may be given up at its other end");
    assert_eq!(election.deadline(), Some(at(3.0).after(LINK_PROOF)));
    assert!(election.confirm(at(3.0).after(LINK_PROOF)));
    assert!(election.lease().unwrap().renews(at(3.7)));
    election.link_lost();
    assert_eq!(election.state(), ReplicaState::Suspect);
}

#[test]
fn an_unanswered_query_on_a_link_that_turns_out_to_be_lost_proves_nothing() {
    let mut election = leading();
    assert!(election.notice_pause(at(3.0)));
    unanswered(&mut election, 1);
    election.link_lost();
    assert!(!election.confirm(at(9.0)));
    assert_eq!(election.deadline(), None);
    unanswered(&mut election, 1);
    assert!(!election.confirm(at(9.0)), "it was asked on the lost link");
    // On a new link, a renewal of whoever has taken over arrives.
    election.link_restored(at(9.0));
    unanswered(&mut election, 1);
    assert!(!election.confirm(at(9.1)), "it may be too new to carry a question");
    assert!(election.confirm(at(9.0).after(LINK_PROOF)));
}

#[test]
fn a_suspect_that_is_paused_before_its_query_is_answered_asks_again() {
    let mut election = leading();
    election.link_lost();
    election.link_restored(at(1.0));
    election.leader_query_sent(1);
    assert!(election.notice_pause(at(4.0)), "it is to ask again");
    election.leader_query_unanswered(1);
    assert!(!election.confirm(at(9.0)), "whoever took over during the pause was not asked");
    unanswered(&mut election, 2);
    assert!(election.confirm(at(4.0).after(LINK_PROOF)));
}

#[test]
fn an_instance_that_never_had_peers_does_not_wait() {
    let mut election = Election::new(name("b"), START, Replication::OneLeads);
    election.lead(START);
    assert!(election.notice_pause(at(3.0)));
    unanswered(&mut election, 1);
    assert!(election.confirm(at(3.0)));
}

/// It began its term on a dead link: whoever leads knows what happened since.
#[test]
fn a_suspect_that_led_unheard_stands_down_for_a_leader_of_any_term() {
    let lower = renewal("a", 4);
    for source in [Published, Answered] {
        let mut election = leading();
        assert_eq!(election.renewal(at(0.1), &lower, source, 9), Rivalry::None, "it leads");
        election.link_lost();
        election.link_restored(at(2.0));
        assert_eq!(election.renewal(at(2.1), &lower, source, 9), Rivalry::StandDown);
        assert_eq!(election.followed(), Some(lower.header.revision));

        let mut known = leading();
        known.others_heard();
        known.link_lost();
        known.link_restored(at(2.0));
        assert_eq!(known.renewal(at(2.1), &lower, source, 9), Rivalry::None);
        // What is received once it is suspect proves nothing about its term.
        let mut late = leading();
        late.link_lost();
        late.others_heard();
        assert_eq!(late.renewal(at(2.1), &lower, source, 9), Rivalry::StandDown);
    }
}

#[test]
fn the_higher_term_wins_and_in_the_same_the_lower_name() {
    assert_eq!(leading().renewal(START, &renewal("a", 4), Published, 5), Rivalry::None);
    assert_eq!(leading().renewal(START, &renewal("c", 6), Published, 5), Rivalry::StandDown);
    assert_eq!(leading().renewal(START, &renewal("a", 5), Published, 5), Rivalry::StandDown);
    let raise = Rivalry::RaiseTerm(Revision { term: 5, epoch: 5 });
    assert_eq!(leading().renewal(START, &renewal("c", 5), Published, 5), raise);
    assert_eq!(leading().renewal(START, &renewal("b", 9), Published, 5), Rivalry::None, "its own");
    // Without a link it must not lead: it would take silence for proof.
    let mut cut_off = leading();
    cut_off.link_lost();
    assert_eq!(cut_off.renewal(START, &renewal("c", 5), Published, 5), Rivalry::None);
    cut_off.link_restored(START);
    assert_eq!(cut_off.renewal(START, &renewal("c", 5), Published, 5), raise);
}

#[test]
fn a_published_renewal_without_a_token_is_ignored() {
    assert_eq!(leading().renewal(START, &renewal("ghost", 900), Published, 5), Rivalry::None);
    assert_eq!(leading().renewal(START, &renewal("ghost", 900), Answered, 5), Rivalry::StandDown);
}

#[test]
fn without_a_link_no_instance_leads() {
    let mut election = Election::new(name("b"), START, Replication::OneLeads);
    election.link_lost();
    assert_eq!(election.decide(START), Decision::Wait);
    election.link_restored(START);
    assert_eq!(election.decide(START), Decision::Lead);
}

#[test]
fn the_peers_that_are_known_by_name_are_bounded() {
    let mut election = Election::new(name("b"), START, Replication::OneLeads);
    for other in 0..1000 {
        election.token(START, InstanceId::of_process("z", other, 1), true);
    }
    assert_eq!(election.peers.count(), MAX_PEERS);
}

#[test]
fn a_crowd_of_tokens_does_not_shut_the_leader_out() {
    let mut election = Election::new(name("b"), START, Replication::OneLeads);
    for other in 0..1000 {
        election.token(START, InstanceId::of_process("z", other, 1), true);
    }
    election.token(START, name("a"), true);
    election.token(START, InstanceId::of_process("z", 0, 1), false);
    election.renewal(START, &renewal("a", 3), Published, 0);
    assert_eq!(election.decide(START), Decision::StandBy);
    assert_eq!(election.followed(), Some(Revision { term: 3, epoch: 5 }));
}

#[test]
fn who_began_a_term_as_high_takes_over_from_a_leader_that_never_learned_of_it() {
    let mut election = standby_of("a");
    let renew = |election: &mut Election, seconds: f64, term: u64| {
        election.renewal(at(seconds), &renewal("a", term), Published, 7)
    };
    // A renewal that came late, and two of a leader that is about to raise its term.
    for (seconds, term) in [(0.5, 7), (1.0, 7), (1.5, 8), (2.0, 6), (2.5, 7)] {
        assert_eq!(renew(&mut election, seconds, term), Rivalry::None);
        assert!(!election.takes_over(at(seconds)), "{seconds}");
    }
    renew(&mut election, 3.0, 7);
    assert!(election.takes_over(at(3.0)));
    assert!(election.inquire());
    // What the leader publishes meanwhile changes nothing.
    renew(&mut election, 3.1, 7);
    assert_eq!(election.decide(at(3.2)), Decision::Lead);
}

#[test]
fn an_instance_asks_once_more_over_each_link_where_another_one_has_appeared() {
    let mut election = Election::new(name("b"), START, Replication::OneLeads);
    let begins = |election: &mut Election, seconds: f64| {
        election.inquire();
        election.token(at(seconds), name("c"), false);
        election.token(at(seconds), name("c"), true);
        assert!(election.inquiry_answered());
        assert_eq!(election.decide(at(seconds)), Decision::Lead);
        election.asks_again(false)
    };
    assert!(begins(&mut election, 0.1));
    assert!(!begins(&mut election, 1.0));
    election.link_lost();
    assert_eq!(election.link_restored(at(5.0)), Reconnection::Inquire);
    assert!(begins(&mut election, 5.1));
    assert!(!begins(&mut election, 6.0));
}

#[test]
fn an_instance_that_appeared_and_is_gone_again_is_not_asked() {
    let mut election = asking();
    // Its former process was killed a moment ago, and its lease on the bus ends now.
    election.token(at(0.1), name("a"), true);
    election.token(at(1.5), name("a"), false);
    assert!(election.inquiry_answered());
    assert_eq!(election.decide(at(2.0)), Decision::Lead);
    assert!(!election.asks_again(false));
    election.inquire();
    election.token(at(2.1), name("a"), true);
    election.token(at(2.2), name("c"), true);
    election.token(at(2.3), name("a"), false);
    assert!(election.inquiry_answered());
    assert!(election.asks_again(false), "c is there");
}

#[test]
fn an_instance_that_has_answered_and_is_gone_is_asked_again_over_the_same_link() {
    let mut election = Election::new(name("b"), START, Replication::OneLeads);
    election.token(at(0.0), name("a"), true);
    election.inquire();
    election.token(at(0.5), name("a"), false);
    assert!(election.inquiry_answered());
    assert_eq!(election.decide(at(2.0)), Decision::Lead);
    assert!(election.asks_again(true), "its link may be cut for a moment");
    election.inquire();
    assert!(election.inquiry_answered());
    assert!(!election.asks_again(true));
}

#[test]
fn what_was_asked_over_a_link_that_was_lost_is_asked_again() {
    let mut election = asking();
    election.token(at(0.1), name("a"), true);
    election.token(at(0.3), name("a"), false);
    election.link_lost();
    assert_eq!(election.link_restored(at(1.6)), Reconnection::Inquire);
}

#[test]
fn more_instances_than_are_noted_are_asked_again() {
    let mut election = asking();
    let crowd: Vec<_> = (0..=MAX_PEERS).map(|number| name(&format!("c{number}"))).collect();
    crowd.iter().for_each(|other| election.token(at(0.1), other.clone(), true));
    crowd.iter().for_each(|other| election.token(at(0.2), other.clone(), false));
    assert!(election.inquiry_answered());
    assert!(election.asks_again(false));
}

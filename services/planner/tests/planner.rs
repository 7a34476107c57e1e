//! What the planner answers, and when. The live fleet is made by the method itself: no other service is needed.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

mod fleet;

use fleet::{Fleet, NOW, robot};
use muster_model::content::{Checked, Content as _};
use muster_model::embedding::Embedding;
use muster_model::header::Revision;
use muster_model::id::{FleetId, InstanceId, ServiceName};
use muster_model::limits::MAX_WISH_ROBOTS;
use muster_model::proposal::{
    MAX_OPEN_PROPOSALS, MAX_OPEN_PROPOSALS_OF_OPERATOR, PROPOSAL_LIFETIME, Proposal, ProposalState,
};
use muster_model::role::LeaseRenewal;
use muster_model::roster::Roster;
use muster_model::settings::PlannerSettings;
use muster_model::teams::Teams;
use muster_planner::{ANSWER_TIME, Planner};
use muster_service::testkit::Bench;
use muster_service::{GetId, IncomingGet, Input};
use muster_wire::{Key, Message, Pattern};
use serde_json::{Value, json};

/// A planner that leads, beside a fleet.
struct Rig {
    bench: Bench<Planner>,
    fleet: Fleet,
    gets: u64,
}

impl Rig {
    fn new(fleet: Fleet) -> Self {
        Self::with_settings(fleet, PlannerSettings::default())
    }

    fn with_settings(fleet: Fleet, settings: PlannerSettings) -> Self {
        let name = FleetId::new("f").unwrap();
        let instance = InstanceId::new("i").unwrap();
        let bench = Bench::leading(name, instance, NOW, settings, fleet.messages());
        Self { bench, fleet, gets: 0 }
    }

    /// A get, whose answer may come later.
    fn get(&mut self, selector: &str, payload: Option<&str>) -> GetId {
        self.gets += 1;
        let get = GetId(self.gets);
        self.bench.input(Input::Get(IncomingGet {
            get,
            selector: format!("muster/v1/f/{selector}"),
            narrowed: None,
            parameters: "format=json".to_owned(),
            payload: payload.map(|text| text.as_bytes().to_vec()),
        }));
        get
    }

    /// Answers the fetch of settings and wishes, if one waits.
    fn answer_fetch(&mut self) {
        let fetches = self.bench.take_fetches();
        for fetch in fetches {
            let asked: Vec<Pattern> = fetch.iter().map(|ask| ask.pattern.clone()).collect();
            let of_settings = asked.contains(&Pattern::One(Key::Wishes));
            let answers = if of_settings { self.fleet.settings() } else { Vec::new() };
            self.bench.answer_fetch(fetch, answers);
        }
    }

    /// The reply to a get that has been answered.
    fn reply(&mut self, get: GetId) -> Option<Result<Vec<Message>, String>> {
        let at = self.bench.replies.iter().position(|reply| reply.get == get)?;
        let reply = self.bench.replies.remove(at);
        assert!(self.bench.replies.iter().all(|reply| reply.get != get), "answered once");
        Some(reply.answer.map(|_| reply.messages))
    }

    fn proposal(&mut self, get: GetId) -> Result<Proposal, String> {
        let mut messages = self.reply(get).unwrap()?;
        assert_eq!(messages.len(), 1);
        match messages.remove(0) {
            Message::Proposal(report) => {
                assert_eq!(report.check(), Ok(()));
                Ok(report.proposal)
            }
            other => panic!("{other:?}"),
        }
    }

    /// Asks for a proposal and lets it be computed.
    fn ask(&mut self, id: &str, asked: Value) -> Result<Proposal, String> {
        let get = self.get(&format!("propose/alice/{id}"), Some(&asked.to_string()));
        self.answer_fetch();
        self.proposal(get)
    }
}

fn moved(proposal: &Proposal) -> Vec<(String, Option<String>, Option<String>)> {
    let text = |team: &Option<muster_model::id::TeamId>| team.as_ref().map(ToString::to_string);
    let moves = &proposal.division.as_ref().unwrap().moves;
    moves.iter().map(|one| (one.robot.to_string(), text(&one.from), text(&one.to))).collect()
}

/// The teams as `t1: a0 a1`.
fn teams(proposal: &Proposal) -> Vec<String> {
    let teams = &proposal.division.as_ref().unwrap().teams;
    teams.iter().map(|team| format!("{}: {}", team.id, fleet::names(&team.members))).collect()
}

#[test]
fn a_proposal_that_changes_nothing_is_the_live_division() {
    for teams in [json!(2), json!(3), json!("auto")] {
        let mut rig = Rig::new(Fleet::of_groups().with_teams(&teams));
        let live = rig.fleet.live();
        for asked in [json!({}), json!({"teams": teams}), json!({"weights": null})] {
            let proposal = rig.ask("p1", asked.clone()).unwrap();
            let division = proposal.division.as_ref().unwrap();
            assert_eq!(moved(&proposal), [], "{asked}");
            assert_eq!(self::teams(&proposal), fleet::teams(&live));
            assert!(!division.embedded);
            assert_eq!(division.proposed, division.live);
            assert_eq!(division.change.mean, Some(0.0));
            assert_eq!(division.based_on, live.header.revision);
        }
    }
}

#[test]
fn another_number_of_teams_says_who_moves_and_how_good_that_is() {
    let mut rig = Rig::new(Fleet::of_groups().with_teams(&json!(2)));
    assert_eq!(fleet::teams(&rig.fleet.live()), ["t1: a0 a1 a2 b0 b1 b2", "t2: c0 c1 c2 d0 d1 d2"]);
    let proposal = rig.ask("p1", json!({"teams": 4})).unwrap();
    assert_eq!(proposal.state, ProposalState::Ready);
    let division = proposal.division.as_ref().unwrap();
    assert!(division.embedded, "the dimension follows the number of teams");
    let found = teams(&proposal);
    assert_eq!(found.len(), 4, "{found:?}");
    for group in ["a0 a1 a2", "b0 b1 b2", "c0 c1 c2", "d0 d1 d2"] {
        assert!(found.iter().any(|team| team.ends_with(group)), "{found:?}");
    }
    // Two teams live on, two get the next numbers, and who is in those moves.
    let ids: Vec<&str> = division.teams.iter().map(|team| team.id.as_str()).collect();
    assert_eq!(ids, ["t1", "t2", "t3", "t4"]);
    assert_eq!(moved(&proposal).len(), 6);
    let replaces = &division.replaces[&ServiceName::Clusterer];
    assert_eq!(Value::Object(replaces.clone()), json!({"teams": 2}));
    // Four cliques are four teams, and better so among these vectors.
    assert!(division.change.mean.unwrap() > 0.1, "{:?}", division.change);
    let least = division.teams.iter().filter_map(|team| team.mean).reduce(f64::min);
    assert_eq!(division.proposed.least_team, least);
    assert!(division.teams.iter().all(|team| team.least <= team.mean));
    assert_eq!(division.live_teams.len(), 2);
    // The positions are those of the roster.
    assert!(division.proposed.physical_mean.is_some());
    assert_eq!(proposal.forgotten_in_s, Some(PROPOSAL_LIFETIME.as_secs_f64()));
}

#[test]
fn robots_that_are_left_out_are_in_no_team() {
    let mut rig = Rig::new(Fleet::of_groups().with_teams(&json!(2)));
    let proposal = rig.ask("p1", json!({"without": ["d2", "a0"]})).unwrap();
    let some = |team: &str| Some(team.to_owned());
    assert_eq!(
        moved(&proposal),
        [("a0".to_owned(), some("t1"), None), ("d2".to_owned(), some("t2"), None)]
    );
    let division = proposal.division.as_ref().unwrap();
    assert_eq!(division.unassigned, [robot("a0"), robot("d2")]);
    assert!(!division.embedded, "they stay among the robots that relate the others");
    // The live division is scored without them as well.
    assert_eq!(division.live_teams.iter().map(|team| team.robots).collect::<Vec<_>>(), [5, 5]);
    assert_eq!(division.proposed, division.live);
    assert_eq!(division.replaces.len(), 0);
}

/// Nobody asks a planner what it has seen, so that no leader goes above a forged revision for it.
#[test]
fn a_forged_revision_is_followed_for_no_longer_than_its_publishers_contradict_it() {
    let mut rig = Rig::new(Fleet::of_groups().with_teams(&json!(2)));
    let live = rig.fleet.live();
    let (mut roster, mut embedding, mut teams) = (None, None, None);
    for message in rig.fleet.messages() {
        match message {
            Message::Roster(found) => roster = Some(found),
            Message::Embedding(found) => embedding = Some(found),
            Message::Teams { teams: found, .. } => teams = Some(found),
            _ => {}
        }
    }
    let all = (roster.unwrap(), embedding.unwrap(), teams.unwrap());
    // All that is published of the fleet at one moment; a forged one names robots that do not exist.
    let messages = |term: u64, epoch: u64, is_forged: bool| {
        let (mut roster, mut embedding, mut teams) =
            (Roster::clone(&all.0), Embedding::clone(&all.1), Teams::clone(&all.2));
        for header in [&mut roster.header, &mut embedding.header, &mut teams.header] {
            header.revision = Revision { term, epoch };
        }
        if is_forged {
            roster.robots.clear();
            // Every second robot is elsewhere.
            let dimension = embedding.dimension as usize;
            for (place, value) in embedding.values.iter_mut().enumerate() {
                *value = if (place / dimension).is_multiple_of(2) { 1.0 } else { -1.0 };
            }
            teams.teams.pop();
        }
        [
            Message::Embedding(Checked::new_unchecked(embedding)),
            Message::Teams { teams: Checked::new_unchecked(teams), mirror: false },
            Message::Roster(Checked::new_unchecked(roster)),
        ]
    };
    messages(1_000_000, 1, true).into_iter().for_each(|message| rig.bench.receive(message));
    for epoch in 10..22 {
        messages(7, epoch, false).into_iter().for_each(|message| rig.bench.receive(message));
        rig.bench.wait(0.5);
    }
    for fetch in rig.bench.take_fetches() {
        rig.bench.answer_fetch(fetch, rig.fleet.messages());
    }
    let proposal = rig.ask("p1", json!({"teams": 2})).unwrap();
    assert_eq!(self::teams(&proposal), fleet::teams(&live));
    let based_on = proposal.division.unwrap().based_on;
    assert_eq!(based_on.term, 7);
}

#[test]
fn other_weights_are_other_vectors() {
    // By their links the robots are other teams than by their places.
    let mut rig = Rig::new(Fleet::of_rows_and_columns().with_teams(&json!(2)));
    let live = fleet::teams(&rig.fleet.live());
    assert_eq!(live, ["t1: r0c0 r0c1 r0c2 r0c3", "t2: r1c0 r1c1 r1c2 r1c3"]);
    let asked = json!({"weights": {"spatial": 0.0, "connectivity": 1.0}});
    let proposal = rig.ask("p1", asked).unwrap();
    let division = proposal.division.as_ref().unwrap();
    assert!(division.embedded);
    assert_eq!(teams(&proposal), ["t1: r0c0 r0c1 r1c0 r1c1", "t2: r0c2 r0c3 r1c2 r1c3"]);
    assert_eq!(moved(&proposal).len(), 4);
    assert!(division.change.mean.unwrap() > 0.5, "{:?}", division.change);
    assert_eq!(
        Value::Object(division.replaces[&ServiceName::Embedder].clone()),
        json!({"weights": {"spatial": 1.0, "connectivity": 0.0}})
    );
}

#[test]
fn limits_needs_and_wishes_in_force_are_respected() {
    let fleet = Fleet::of_groups()
        .with_teams(&json!(2))
        .with_wish("pin", &["a0"], Some("t2"))
        .with_skill("a1", "medic")
        .with_skill("a2", "medic");
    let mut rig = Rig::new(fleet);
    let team_of = |proposal: &Proposal, name: &str| {
        let teams = &proposal.division.as_ref().unwrap().teams;
        let team = teams.iter().find(|team| team.members.contains(&robot(name)));
        team.map(|team| team.id.to_string())
    };
    let proposal = rig.ask("p1", json!({"size": {"min": 5, "max": 7}})).unwrap();
    assert_eq!(team_of(&proposal, "a0").as_deref(), Some("t2"), "the wish holds");
    let needs = json!([{"skill": "medic", "per_team": {"min": 1}}]);
    let proposal = rig.ask("p2", json!({"needs": needs})).unwrap();
    assert_ne!(team_of(&proposal, "a1"), team_of(&proposal, "a2"), "{:?}", teams(&proposal));
    let proposal = rig.ask("p3", json!({"team_size": {"t1": {"max": 2}}})).unwrap();
    let division = proposal.division.as_ref().unwrap();
    assert!(division.teams[0].members.len() <= 2, "{:?}", teams(&proposal));
}

#[test]
fn what_does_not_work_is_refused_with_field_and_remedy() {
    let mut rig =
        Rig::new(Fleet::of_groups().with_teams(&json!(2)).with_wish("pin", &["a0"], Some("t1")));
    let crowd: Vec<String> = (0..=MAX_WISH_ROBOTS).map(|at| format!("x{at}")).collect();
    for (asked, start) in [
        (json!({"teams": 0}), "teams: must be"),
        (json!({"team": 3}), "team: unknown field"),
        (json!([3]), "(proposal): must be an object"),
        (json!({"without": ["zebra"]}), "without: zebra is not in the fleet"),
        (json!({"without": crowd}), "without: may name at most"),
        (json!({"without": ["a0"]}), "without: a0 cannot be in a team (wish alice/w0) and in none"),
        (json!({"weights": {"spatial": 0.5, "connectivity": 0.2}}), "weights"),
        (json!({"size": {"min": 9}}), "size: "),
        (json!({"teams": 3, "size": {"max": 3}}), "size: "),
        (json!({"needs": [{"skill": "medic", "per_team": {"min": 1}}]}), "needs: "),
        (json!({"size": {"min": 4, "max": 3}}), "size.max"),
    ] {
        let problem = rig.ask("p1", asked.clone()).unwrap_err();
        let value: Value = serde_json::from_str(&problem).unwrap();
        let text = value["error"].as_str().unwrap();
        assert!(text.starts_with(start), "{asked}: {text}");
        let field = value["field"].as_str().unwrap();
        assert!(text.starts_with(field), "{asked}: {problem}");
    }
    assert_eq!(rig.bench.status().state, "no proposals", "what is refused is not kept");
    let get = rig.get("propose/alice/p1", None);
    assert!(rig.proposal(get).unwrap_err().contains("alice/p1 is not there"));
    let get = rig.get("propose/alice/*", Some("{}"));
    assert!(rig.proposal(get).unwrap_err().contains("exactly one key"));
}

#[test]
fn a_fleet_that_is_too_large_or_not_divided_has_no_proposal() {
    let mut rig = Rig::with_settings(Fleet::of_groups(), PlannerSettings { max_robots: 11 });
    let problem = rig.ask("p1", json!({"teams": 3})).unwrap_err();
    assert!(problem.contains("max_robots of planner is 11"), "{problem}");
    let mut rig = Rig::new(Fleet::of_groups().without_division());
    let problem = rig.ask("p1", json!({"teams": 3})).unwrap_err();
    assert!(problem.contains("no division to begin with"), "{problem}");
    // Who divides does not answer.
    let mut rig = Rig::new(Fleet::of_groups());
    rig.fleet.forget_settings();
    let problem = rig.ask("p1", json!({"teams": 3})).unwrap_err();
    assert!(problem.contains("clusterer has not answered"), "{problem}");
}

#[test]
fn a_get_waits_and_then_says_how_far_it_is() {
    let mut rig = Rig::new(Fleet::of_groups().with_teams(&json!(2)));
    rig.bench.hold_jobs = true;
    let first = rig.get("propose/alice/p1", Some("{\"teams\": 3}"));
    rig.answer_fetch();
    let second = rig.get("propose/bob/p1", Some("{\"teams\": 4}"));
    rig.answer_fetch();
    assert!(rig.reply(first).is_none() && rig.reply(second).is_none());
    rig.bench.wait(ANSWER_TIME.as_secs_f64());
    let state = |proposal: &Proposal| (proposal.state, proposal.ahead, proposal.age_s.round());
    let proposal = rig.proposal(first).unwrap();
    assert_eq!(state(&proposal), (ProposalState::Computing, 0, 3.0));
    assert_eq!((proposal.forgotten_in_s, proposal.division), (None, None));
    assert_eq!(state(&rig.proposal(second).unwrap()), (ProposalState::Computing, 1, 3.0));
    assert_eq!(rig.bench.status().state, "2 proposals, computing alice/p1");
    // Who asks again waits again, and is answered at once when it is there.
    let again = rig.get("propose/alice/p1", None);
    assert!(rig.reply(again).is_none());
    rig.bench.run_job();
    assert_eq!(rig.proposal(again).unwrap().state, ProposalState::Ready);
    // The next one is computed with the settings of that moment.
    rig.answer_fetch();
    let again = rig.get("propose/bob/p1", None);
    rig.bench.run_job();
    assert_eq!(rig.proposal(again).unwrap().division.unwrap().teams.len(), 4);
    assert_eq!(rig.bench.jobs_run, 2);
    // A list does not wait.
    rig.get("propose/carol/p1", Some("{\"teams\": 3}"));
    let list = rig.get("propose/*/*", None);
    assert_eq!(rig.reply(list).unwrap().unwrap().len(), 3);
    let list = rig.get("propose/bob/*", None);
    assert_eq!(rig.reply(list).unwrap().unwrap().len(), 1);
}

#[test]
fn the_same_request_is_computed_once_and_another_takes_its_place() {
    let mut rig = Rig::new(Fleet::of_groups().with_teams(&json!(2)));
    let first = rig.ask("p1", json!({"teams": 3})).unwrap();
    let again = rig.get("propose/alice/p1", Some("{\"teams\": 3}"));
    assert_eq!(rig.proposal(again).unwrap(), first);
    assert_eq!(rig.bench.jobs_run, 1);
    let other = rig.ask("p1", json!({"teams": 4})).unwrap();
    assert_eq!(other.division.unwrap().teams.len(), 4);
    // Also while one is being computed: whoever waits for that is told.
    rig.bench.hold_jobs = true;
    let waiting = rig.get("propose/alice/p1", Some("{\"teams\": 3}"));
    rig.answer_fetch();
    let newer = rig.get("propose/alice/p1", Some("{\"without\": [\"a0\"]}"));
    assert!(rig.proposal(waiting).unwrap_err().contains("under this id"));
    rig.bench.run_job();
    assert!(rig.reply(newer).is_none(), "the result of the other request is for nobody");
    rig.answer_fetch();
    rig.bench.run_job();
    assert_eq!(rig.proposal(newer).unwrap().division.unwrap().unassigned, [robot("a0")]);
}

#[test]
fn a_proposal_is_forgotten_a_minute_after_it_was_computed() {
    let mut rig = Rig::new(Fleet::of_groups().with_teams(&json!(2)));
    rig.bench.hold_jobs = true;
    let get = rig.get("propose/alice/p1", Some("{\"teams\": 3}"));
    rig.answer_fetch();
    // However long it takes.
    rig.bench.wait(600.0);
    assert_eq!(rig.proposal(get).unwrap().state, ProposalState::Computing);
    rig.bench.run_job();
    let left = |rig: &mut Rig| {
        let get = rig.get("propose/alice/p1", None);
        rig.proposal(get).map(|proposal| proposal.forgotten_in_s.unwrap())
    };
    assert_eq!(left(&mut rig), Ok(60.0));
    rig.bench.wait(59.0);
    assert_eq!(left(&mut rig), Ok(1.0));
    rig.bench.wait(1.0);
    assert!(left(&mut rig).unwrap_err().contains("forgotten 60 s after"));
    assert_eq!(rig.bench.counter("proposals_forgotten"), 1);
    assert_eq!(rig.bench.host.memory_use().messages, 4, "roster twice, vectors and division");
}

#[test]
fn a_proposal_is_dropped_also_while_it_is_computed() {
    let mut rig = Rig::new(Fleet::of_groups().with_teams(&json!(2)));
    rig.ask("p1", json!({"teams": 3})).unwrap();
    let get = rig.get("propose/alice/p1", Some("null"));
    let last = rig.proposal(get).unwrap();
    assert_eq!((last.state, last.division), (ProposalState::Dropped, None));
    let get = rig.get("propose/alice/p1", Some("null"));
    assert!(rig.proposal(get).unwrap_err().contains("is not there"));
    rig.bench.hold_jobs = true;
    let waiting = rig.get("propose/alice/p2", Some("{\"teams\": 3}"));
    rig.answer_fetch();
    let next = rig.get("propose/alice/p3", Some("{\"teams\": 4}"));
    rig.get("propose/alice/p2", Some("null"));
    assert!(rig.proposal(waiting).unwrap_err().contains("it was dropped"));
    rig.bench.run_job();
    rig.answer_fetch();
    rig.bench.run_job();
    assert_eq!(rig.proposal(next).unwrap().division.unwrap().teams.len(), 4);
}

#[test]
fn open_proposals_are_bounded() {
    let mut rig = Rig::new(Fleet::of_groups().with_teams(&json!(2)));
    let ask = |rig: &mut Rig, operator: &str, number: usize| {
        let key = format!("propose/{operator}/p{number}");
        let get = rig.get(&key, Some("{\"without\": [\"a0\"]}"));
        rig.answer_fetch();
        rig.proposal(get)
    };
    for number in 0..MAX_OPEN_PROPOSALS_OF_OPERATOR {
        ask(&mut rig, "alice", number).unwrap();
    }
    let problem = ask(&mut rig, "alice", 99).unwrap_err();
    assert!(problem.contains("alice may have 8 at most"), "{problem}");
    ask(&mut rig, "alice", 3).unwrap();
    for number in MAX_OPEN_PROPOSALS_OF_OPERATOR..MAX_OPEN_PROPOSALS {
        ask(&mut rig, &format!("o{number}"), 1).unwrap();
    }
    let problem = ask(&mut rig, "bob", 1).unwrap_err();
    assert!(problem.contains("there may be 16 at most"), "{problem}");
    // Gets that wait are bounded as well: one more is answered at once.
    rig.bench.wait(PROPOSAL_LIFETIME.as_secs_f64());
    rig.bench.hold_jobs = true;
    rig.get("propose/alice/p1", Some("{\"teams\": 3}"));
    rig.answer_fetch();
    let gets: Vec<GetId> = (0..64).map(|_| rig.get("propose/alice/p1", None)).collect();
    let last = *gets.last().unwrap();
    assert_eq!(rig.proposal(last).unwrap().state, ProposalState::Computing);
    assert!(rig.reply(gets[0]).is_none());
}

#[test]
fn a_job_that_panics_is_said_to_have_failed() {
    let mut rig = Rig::new(Fleet::of_groups().with_teams(&json!(2)));
    rig.bench.hold_jobs = true;
    let get = rig.get("propose/alice/p1", Some("{\"teams\": 3}"));
    rig.answer_fetch();
    rig.bench.panic_job("out of luck");
    assert!(rig.proposal(get).unwrap_err().contains("could not be computed"));
    rig.bench.hold_jobs = false;
    rig.ask("p1", json!({"teams": 3})).unwrap();
}

#[test]
fn one_leader_answers_and_what_it_had_is_lost_with_it() {
    let mut rig = Rig::new(Fleet::of_groups().with_teams(&json!(2)));
    rig.ask("p1", json!({"teams": 3})).unwrap();
    rig.bench.hold_jobs = true;
    let waiting = rig.get("propose/alice/p2", Some("{\"teams\": 4}"));
    rig.answer_fetch();
    // Another instance leads in a later term.
    let mut header = rig.fleet.live().header.clone();
    header.revision.term = rig.bench.status().revision.term + 1;
    let service = ServiceName::Planner;
    let instance = InstanceId::new("other").unwrap();
    let token = Message::ServiceToken { service, instance: instance.clone(), alive: true };
    rig.bench.receive(token);
    let renewal = LeaseRenewal { header, service, instance };
    rig.bench.receive(Message::LeaseRenewal(Box::new(renewal)));
    assert!(rig.proposal(waiting).unwrap_err().contains("another instance leads now"));
    rig.bench.run_job();
    rig.answer_fetch();
    // It has nothing of them, whether it is a standby by now or not.
    let get = rig.get("propose/*/*", None);
    assert_eq!(rig.reply(get), Some(Ok(vec![])));
}

#[test]
fn the_planner_publishes_nothing_that_anybody_acts_on() {
    let mut rig = Rig::new(Fleet::of_groups().with_teams(&json!(2)));
    let before = rig.bench.published.len();
    rig.ask("p1", json!({"teams": 3})).unwrap();
    rig.bench.wait(5.0);
    let is_own = |message: &Message| match message {
        Message::LeaseRenewal(renewal) => renewal.service == ServiceName::Planner,
        Message::Settings(announced) => announced.service == ServiceName::Planner,
        _ => false,
    };
    let others: Vec<&Message> =
        rig.bench.published[before..].iter().filter(|message| !is_own(message)).collect();
    assert!(others.is_empty(), "{others:?}");
}

//! The core without sockets: slow browsers, floods, roles, and what is kept of robots that are lost.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test fails by panicking"
)]

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use muster_console::limits::{
    LOST_FOR, MAX_BROWSERS, MAX_COMMANDS_PER_MINUTE, MAX_LINKS_SHOWN, MAX_MESSAGE_BYTES,
    MAX_MESSAGES_PER_SECOND, MAX_PENDING, MAX_QUESTIONS_PER_MINUTE, MAX_REPLY_BYTES,
    MAX_TURN_BYTES, MAX_WAITING_BYTES, STALLED_AFTER,
};
use muster_console::{
    BrowserId, Command, Console, Fetch, Input, Output, Problem, ProblemKind, ProposalOrder,
    ProposalStep, Role, frame,
};
use muster_model::command::Action;
use muster_model::graph::{GraphDelta, GraphRow};
use muster_model::header::{Header, Revision};
use muster_model::id::{FleetId, Modality, OperatorId, RobotId, ServiceName, TeamId, WishId};
use muster_model::remembered::RememberedTeams;
use muster_model::roster::{Presence, Roster, RosterEntry};
use muster_model::teams::{Member, Team, Teams};
use muster_model::time::Tick;
use muster_model::wish::{StandingWish, Wish, WishKind, WishState};
use proptest::prelude::*;
use serde_json::{Value, json};

const START: Tick = Tick(1_800_000_000_000_000);

fn header(epoch: u64) -> Header {
    Header {
        fleet: FleetId::new("alpha").unwrap(),
        revision: Revision { term: 1, epoch },
        oldest: Some(START),
        newest: Some(START),
        stages: Vec::new(),
    }
}

fn robot(name: &str) -> RobotId {
    RobotId::new(name).unwrap()
}

fn roster(names: &[String]) -> Roster {
    let entry = |(node, name): (usize, &String)| RosterEntry {
        node: u32::try_from(node).unwrap(),
        robot: robot(name),
        presence: Presence::Active,
        position: Some([f64::from(u32::try_from(node).unwrap()), 1.0, 0.0]),
        heading: Some(0.0),
        frame: None,
        superior: None,
        role: None,
        skills: Vec::new(),
        last_seen: START,
    };
    let graphs = vec![(Modality::spatial(), Revision { term: 1, epoch: 1 })];
    Roster { header: header(1), robots: names.iter().enumerate().map(entry).collect(), graphs }
}

fn names(count: usize) -> Vec<String> {
    (0..count).map(|number| format!("r{number:05}")).collect()
}

fn teams(epoch: u64, teams: &[(&str, &[String])]) -> Teams {
    let member = |name: &String| Member { robot: robot(name), margin: 0.5 };
    let team = |(id, names): &(&str, &[String])| Team {
        id: TeamId::new(id).unwrap(),
        members: names.iter().map(member).collect(),
        leader: robot(&names[0]),
        centroid: Vec::new(),
    };
    Teams {
        header: header(epoch),
        embedding: Revision::default(),
        requested: 2,
        considered: Vec::new(),
        teams: teams.iter().map(team).collect(),
        unassigned: Vec::new(),
        stale: Vec::new(),
        inertia: 0.0,
        changes: Vec::new(),
        next_team: 9,
        limited: None,
        needs: Vec::new(),
        provisional: Vec::new(),
        held: Vec::new(),
        remembered: RememberedTeams::default(),
    }
}

fn kim() -> Role {
    Role::Operator(OperatorId::new("kim").unwrap())
}

/// A console, and what each browser has received.
struct Bench {
    console: Console,
    now: Tick,
    outputs: Vec<Output>,
}

impl Bench {
    fn new() -> Self {
        let console = Console::new(FleetId::new("alpha").unwrap(), "1");
        let mut bench = Self { console, now: START, outputs: Vec::new() };
        bench.give(Input::Link(true));
        bench
    }

    fn give(&mut self, input: Input) -> Vec<Output> {
        let outputs = self.console.handle(self.now, input);
        self.outputs.extend(outputs.iter().cloned());
        outputs
    }

    fn text(&mut self, browser: BrowserId, value: &Value) -> Vec<Output> {
        self.give(Input::Text(browser, value.to_string()))
    }

    fn pass(&mut self, time: Duration) -> Vec<Output> {
        self.now = self.now.after(time);
        self.give(Input::Tick)
    }

    /// Draws until nothing more comes, and returns the texts and frames of it.
    fn draw(
        &mut self,
        browser: BrowserId,
        mut outputs: Vec<Output>,
    ) -> (Vec<Value>, Vec<Arc<[u8]>>) {
        let (mut texts, mut frames) = (Vec::new(), Vec::new());
        loop {
            let mut turn = None;
            for output in outputs {
                match output {
                    Output::Text(to, text) if to == browser => {
                        let text: Value = serde_json::from_str(&text).unwrap();
                        if text["topic"] == "end" {
                            turn = Some(text["data"]["turn"].clone());
                        }
                        texts.push(text);
                    }
                    Output::Frame(to, frame) if to == browser => frames.push(frame),
                    _ => {}
                }
            }
            match turn {
                Some(turn) => outputs = self.text(browser, &json!({"credit": turn})),
                None => return (texts, frames),
            }
        }
    }
}

fn bytes_to(browser: BrowserId, outputs: &[Output]) -> usize {
    let bytes = |output: &Output| match output {
        Output::Text(to, text) if *to == browser => text.len(),
        Output::Frame(to, frame) if *to == browser => frame.len(),
        _ => 0,
    };
    outputs.iter().map(bytes).sum()
}

fn topic<'a>(texts: &'a [Value], name: &str) -> Vec<&'a Value> {
    texts.iter().filter(|text| text["topic"] == name).map(|text| &text["data"]).collect()
}

fn flags(frame: &[u8], index: usize) -> u8 {
    frame[frame::HEAD + frame::RECORD * index + 7]
}

fn slot(frame: &[u8], index: usize) -> u16 {
    let at = frame::HEAD + frame::RECORD * index + 4;
    u16::from_le_bytes([frame[at], frame[at + 1]])
}

fn is_closed(outputs: &[Output], browser: BrowserId) -> bool {
    outputs.iter().any(|output| matches!(output, Output::Close(id, _) if *id == browser))
}

#[test]
fn a_browser_gets_names_before_the_frames_that_refer_to_them() {
    let mut bench = Bench::new();
    let all = names(3000);
    bench.give(Input::Roster(Arc::new(roster(&all)), None));
    bench.give(Input::Teams(Arc::new(teams(1, &[("t1", &all[..2]), ("t4", &all[2..5])])), None));
    let outputs = bench.give(Input::Opened(1, kim()));
    let (texts, frames) = bench.draw(1, outputs);
    assert_eq!(topic(&texts, "hello")[0]["operator"], "kim");
    let pieces = topic(&texts, "names");
    let listed: usize = pieces.iter().map(|piece| piece["robots"].as_array().unwrap().len()).sum();
    assert_eq!((listed, pieces[0]["robots"][4][0].as_str()), (3000, Some("r00004")));
    assert_eq!(frames.len(), 1);
    let frame = &frames[0];
    assert_eq!(frame.len(), frame::HEAD + 8 * 3000, "eight bytes for each robot");
    assert_eq!(u32::from_le_bytes(frame[4..8].try_into().unwrap()), pieces[0]["names"]);
    assert_eq!([slot(frame, 1), slot(frame, 4), slot(frame, 5)], [0, 1, frame::NONE]);
    assert_eq!([flags(frame, 0), flags(frame, 1)], [frame::LEADER, 0]);
    let division = topic(&texts, "teams")[0];
    assert_eq!(
        (&division["teams"][1]["id"], &division["teams"][1]["members"]),
        (&json!("t4"), &json!(3))
    );
    // The same names are not sent again.
    let outputs = bench.give(Input::Roster(Arc::new(roster(&all)), None));
    let (texts, frames) = bench.draw(1, outputs);
    assert_eq!((topic(&texts, "names").len(), frames.len()), (0, 1));
}

#[test]
fn without_a_credit_only_the_newest_state_waits() {
    let mut bench = Bench::new();
    let all = names(1000);
    let first = bench.give(Input::Opened(1, kim()));
    assert!(bytes_to(1, &first) > 0);
    for epoch in 0..500 {
        bench.now = bench.now.after(Duration::from_millis(100));
        let outputs = [
            bench.give(Input::Roster(Arc::new(roster(&all)), None)),
            bench.give(Input::Teams(Arc::new(teams(epoch, &[("t1", &all)])), None)),
        ]
        .concat();
        assert_eq!(bytes_to(1, &outputs), 0, "nothing was drawn, so nothing is sent");
        assert_eq!(bench.console.waiting_bytes(1), 0);
    }
    let (texts, frames) = bench.draw(1, first);
    assert_eq!((frames.len(), topic(&texts, "teams").len()), (1, 1));
    assert_eq!(topic(&texts, "teams")[0]["epoch"], 499);
}

#[test]
fn credits_of_old_turns_and_floods_of_credits_bring_nothing() {
    let mut bench = Bench::new();
    bench.give(Input::Roster(Arc::new(roster(&names(10))), None));
    bench.give(Input::Opened(1, kim()));
    let mut sent = 0;
    for _ in 0..50 {
        sent += bytes_to(1, &bench.text(1, &json!({"credit": 99})));
        sent += bytes_to(1, &bench.text(1, &json!({"credit": 0})));
    }
    assert_eq!(sent, 0);
}

#[test]
fn a_browser_that_never_draws_costs_little_and_is_closed() {
    let mut bench = Bench::new();
    let all = names(100_000);
    bench.give(Input::Roster(Arc::new(roster(&all)), None));
    bench.give(Input::Teams(Arc::new(teams(1, &[("t1", &all)])), None));
    let first = bench.give(Input::Opened(1, kim()));
    assert!(bytes_to(1, &first) <= MAX_TURN_BYTES, "{}", bytes_to(1, &first));
    let long: String = "x".repeat(300_000);
    for id in 0..40_u64 {
        bench.text(1, &json!({"ask": {"id": id, "why": "r00001"}}));
        let ticket = bench.outputs.iter().rev().find_map(|output| match output {
            Output::Ask(ticket, _) => Some(*ticket),
            _ => None,
        });
        bench.give(Input::Answer(ticket.unwrap(), Ok(json!(long))));
        assert!(bench.console.waiting_bytes(1) <= MAX_REPLY_BYTES);
    }
    const { assert!(MAX_WAITING_BYTES <= 4 * 1024 * 1024) };
    assert!(!is_closed(&bench.pass(STALLED_AFTER - Duration::from_secs(1)), 1));
    assert!(is_closed(&bench.pass(Duration::from_secs(1)), 1));
    assert_eq!(bench.console.browsers(), 0);
}

#[test]
fn a_whole_large_fleet_comes_in_turns_none_of_which_is_too_large() {
    let mut bench = Bench::new();
    let long: Vec<String> = (0..100_000).map(|n| format!("{n:0>64}")).collect();
    bench.give(Input::Roster(Arc::new(roster(&long)), None));
    let mut outputs = bench.give(Input::Opened(1, kim()));
    let (mut turns, mut robots, mut frames) = (0, 0, 0);
    while bytes_to(1, &outputs) > 0 {
        assert!(bytes_to(1, &outputs) <= MAX_TURN_BYTES + 200);
        let mut credit = json!(0);
        for output in &outputs {
            match output {
                Output::Text(1, text) => {
                    let text: Value = serde_json::from_str(text).unwrap();
                    robots += text["data"]["robots"].as_array().map_or(0, Vec::len);
                    if text["topic"] == "end" {
                        credit = text["data"]["turn"].clone();
                    }
                }
                Output::Frame(1, _) => frames += 1,
                _ => {}
            }
        }
        turns += 1;
        outputs = bench.text(1, &json!({"credit": credit}));
    }
    assert!(turns > 2, "{turns}");
    assert_eq!((robots, frames), (100_000, 1));
}

#[test]
fn floods_close_the_browser_that_sends_them_and_no_other() {
    let mut bench = Bench::new();
    bench.give(Input::Opened(1, kim()));
    bench.give(Input::Opened(2, kim()));
    let mut closed = false;
    for _ in 0..=MAX_MESSAGES_PER_SECOND {
        closed |= is_closed(&bench.text(1, &json!({"credit": 0})), 1);
    }
    assert!(closed);
    let long = format!("{{\"credit\": 1{}}}", " ".repeat(MAX_MESSAGE_BYTES));
    assert!(is_closed(&bench.give(Input::Text(2, long)), 2));
    assert_eq!(bench.console.browsers(), 0);
    // What a closed browser still sends is nothing.
    assert!(bench.text(1, &json!({"view": {}})).is_empty());
    for id in 0..MAX_BROWSERS as u64 {
        assert!(!is_closed(&bench.give(Input::Opened(10 + id, Role::Viewer)), 10 + id));
    }
    assert!(is_closed(&bench.give(Input::Opened(99, kim())), 99));
    assert_eq!(bench.console.browsers(), MAX_BROWSERS);
}

fn commands(outputs: &[Output]) -> Vec<(u64, Command)> {
    let command = |output: &Output| match output {
        Output::Command(ticket, command) => Some((*ticket, command.clone())),
        _ => None,
    };
    outputs.iter().filter_map(command).collect()
}

fn set_teams(id: u64) -> Value {
    json!({"command": {"id": id, "service": "clusterer", "action": {"set": {"teams": 3}}}})
}

#[test]
fn an_operator_commands_under_the_own_name_and_hears_what_came_of_it() {
    let mut bench = Bench::new();
    let outputs = bench.give(Input::Opened(1, kim()));
    bench.draw(1, outputs);
    let outputs = bench.text(1, &set_teams(7));
    let [(ticket, command)] = &commands(&outputs)[..] else { panic!("{outputs:?}") };
    assert_eq!(command.operator.as_str(), "kim");
    assert!(matches!(&command.action, Action::Set(patch) if patch["teams"] == 3));
    let outputs =
        bench.give(Input::Answer(*ticket, Err(Problem::refused("teams: must be 1 to 9"))));
    let (texts, _) = bench.draw(1, outputs);
    assert_eq!(topic(&texts, "reply"), [&json!({"id": 7, "refused": "teams: must be 1 to 9"})]);
    // After a command, what it may have changed is asked for at once.
    assert!(bench.outputs.contains(&Output::Fetch(Fetch::Settings)));
    // The answer comes once.
    assert!(bench.give(Input::Answer(*ticket, Ok(json!({})))).is_empty());
}

#[test]
fn a_browser_learns_what_may_have_come_of_a_command() {
    let mut bench = Bench::new();
    let outputs = bench.give(Input::Opened(1, kim()));
    bench.draw(1, outputs);
    for (id, kind, field) in [
        (1, ProblemKind::Refused, "refused"),
        (2, ProblemKind::Unavailable, "unavailable"),
        (3, ProblemKind::Unstored, "unstored"),
        (4, ProblemKind::Unknown, "unknown"),
    ] {
        let sent = bench.text(1, &set_teams(id));
        let (ticket, _) = commands(&sent).remove(0);
        let problem = Problem { kind, reason: "the disk\u{1b} is full".to_owned() };
        let outputs = bench.give(Input::Answer(ticket, Err(problem)));
        let (texts, _) = bench.draw(1, [sent, outputs].concat());
        let wanted = json!({"id": id, (field): "the disk\u{fffd} is full"});
        assert_eq!(topic(&texts, "reply"), [&wanted]);
    }
    // What was done is not refused because there is no room for its answer.
    let long = json!("x".repeat(MAX_REPLY_BYTES));
    let sent = bench.text(1, &set_teams(5));
    let (ticket, _) = commands(&sent).remove(0);
    let outputs = bench.give(Input::Answer(ticket, Ok(long)));
    let (texts, _) = bench.draw(1, [sent, outputs].concat());
    assert_eq!(topic(&texts, "reply"), [&json!({"id": 5, "answer": null})]);
}

#[test]
fn a_viewer_commands_nothing_whatever_the_page_sends() {
    let mut bench = Bench::new();
    let outputs = bench.give(Input::Opened(1, Role::Viewer));
    bench.draw(1, outputs);
    for sent in [
        set_teams(1),
        json!({"command": {"id": 2, "service": "clusterer", "action": {"withdraw": {"id": "p1"}}}}),
        json!({"command": {"id": 3, "service": "auditor", "action": {"acknowledge": {"alert": 1}}}}),
        json!({"command": {"id": 4, "service": "clusterer", "operator": "kim", "action": {"set": {}}}}),
    ] {
        let outputs = bench.text(1, &sent);
        assert!(commands(&outputs).is_empty(), "{sent}");
        bench.draw(1, outputs);
    }
    // It may ask.
    let outputs = bench.text(1, &json!({"ask": {"id": 9, "why": "r00001"}}));
    assert!(outputs.iter().any(|output| matches!(output, Output::Ask(..))), "{outputs:?}");
}

fn orders(outputs: &[Output]) -> Vec<(u64, ProposalOrder)> {
    let order = |output: &Output| match output {
        Output::Propose(ticket, order) => Some((*ticket, order.clone())),
        _ => None,
    };
    outputs.iter().filter_map(order).collect()
}

#[test]
fn a_proposal_is_asked_for_and_decided_on_under_the_name_of_the_operator() {
    let step = |id: u64, step: Value| json!({"propose": {"id": id, "name": "p1", "step": step}});
    let mut bench = Bench::new();
    let outputs = bench.give(Input::Opened(1, kim()));
    bench.draw(1, outputs);
    let sent = bench.text(1, &step(1, json!({"ask": {"teams": 3, "without": ["r9", "r7"]}})));
    let (ticket, order) = orders(&sent).remove(0);
    assert_eq!((order.operator.as_str(), order.id.as_str()), ("kim", "p1"));
    let ProposalStep::Ask(asked) = order.step else { panic!("{order:?}") };
    assert_eq!(asked.without, [robot("r7"), robot("r9")]);
    let outputs = bench.give(Input::Answer(ticket, Ok(json!({"state": "computing"}))));
    let (texts, _) = bench.draw(1, outputs);
    assert_eq!(topic(&texts, "reply")[0]["answer"]["state"], "computing");
    for (id, name) in [(2, "show"), (3, "accept"), (4, "drop")] {
        let sent = bench.text(1, &step(id, json!(name)));
        assert_eq!(orders(&sent).len(), 1, "{name}");
    }
    // What an acceptance may have changed is asked for at once.
    let (ticket, _) = orders(&bench.outputs)
        .into_iter()
        .find(|(_, order)| order.step == ProposalStep::Accept)
        .unwrap();
    let outputs = bench.give(Input::Settings(BTreeMap::new()));
    bench.draw(1, outputs);
    let outputs = bench.give(Input::Answer(ticket, Ok(json!([]))));
    assert!(outputs.contains(&Output::Fetch(Fetch::Settings)));
    // What makes no sense is refused here, with the field.
    let sent = bench.text(1, &step(5, json!({"ask": {"teams": 0}})));
    assert!(orders(&sent).is_empty());
    let (texts, _) = bench.draw(1, [outputs, sent].concat());
    let refused = topic(&texts, "reply").into_iter().find(|reply| reply["id"] == 5).unwrap();
    assert!(refused["refused"].as_str().unwrap().contains("teams"), "{refused}");

    let outputs = bench.give(Input::Opened(2, Role::Viewer));
    bench.draw(2, outputs);
    for (id, one) in
        [json!({"ask": {"teams": 3}}), json!("accept"), json!("drop")].into_iter().enumerate()
    {
        let sent = bench.text(2, &step(id as u64, one));
        assert!(orders(&sent).is_empty());
        let (texts, _) = bench.draw(2, sent);
        assert!(topic(&texts, "reply")[0]["refused"].as_str().unwrap().contains("viewer"));
    }
    // Nothing is sent over a lost link.
    bench.give(Input::Link(false));
    assert!(orders(&bench.text(1, &step(9, json!("accept")))).is_empty());
}

#[test]
fn commands_are_bounded_and_need_a_link() {
    let mut bench = Bench::new();
    bench.give(Input::Opened(1, kim()));
    let sent: usize = (0..40).map(|id| commands(&bench.text(1, &set_teams(id))).len()).sum();
    assert_eq!(sent, MAX_PENDING);
    for (ticket, _) in commands(&bench.outputs.clone()) {
        bench.give(Input::Answer(ticket, Ok(Value::Null)));
    }
    let mut sent = MAX_PENDING;
    for id in 100..200 {
        for (ticket, _) in commands(&bench.text(1, &set_teams(id))) {
            sent += 1;
            bench.give(Input::Answer(ticket, Ok(Value::Null)));
        }
    }
    assert!(sent <= MAX_COMMANDS_PER_MINUTE as usize, "{sent}");
    bench.pass(Duration::from_secs(60));
    bench.give(Input::Link(false));
    assert!(commands(&bench.text(1, &set_teams(300))).is_empty());
}

#[test]
fn who_looks_at_many_robots_can_still_command() {
    let why = |id: u32| json!({"ask": {"id": id, "why": "r00001"}});
    let asked = |outputs: &[Output]| -> Vec<u64> {
        let ticket = |output: &Output| match output {
            Output::Ask(ticket, _) => Some(*ticket),
            _ => None,
        };
        outputs.iter().filter_map(ticket).collect()
    };
    let mut bench = Bench::new();
    bench.give(Input::Opened(1, kim()));
    let mut sent = 0;
    for id in 0..2 * MAX_QUESTIONS_PER_MINUTE {
        // The messages of a browser have a limit of their own.
        if id % 100 == 0 {
            bench.pass(Duration::from_millis(500));
        }
        for ticket in asked(&bench.text(1, &why(id))) {
            sent += 1;
            bench.give(Input::Answer(ticket, Ok(Value::Null)));
        }
    }
    assert!((MAX_QUESTIONS_PER_MINUTE..MAX_QUESTIONS_PER_MINUTE + 10).contains(&sent), "{sent}");
    let outputs = bench.text(1, &set_teams(1000));
    let [(ticket, _)] = commands(&outputs)[..] else { panic!("{outputs:?}") };
    bench.give(Input::Answer(ticket, Ok(Value::Null)));
    // Nor do questions without an answer hold a command up, or the other way round.
    bench.pass(Duration::from_secs(60));
    let waiting: usize = (0..40).map(|id| asked(&bench.text(1, &why(2000 + id))).len()).sum();
    assert_eq!(waiting, MAX_PENDING);
    let sent: usize = (0..40).map(|id| commands(&bench.text(1, &set_teams(3000 + id))).len()).sum();
    assert_eq!(sent, MAX_PENDING);
}

#[test]
fn an_answer_for_a_browser_that_is_gone_finds_nobody() {
    let mut bench = Bench::new();
    bench.give(Input::Opened(1, kim()));
    let sent = bench.text(1, &set_teams(1));
    let (ticket, _) = commands(&sent).remove(0);
    bench.give(Input::Closed(1));
    let outputs = bench.give(Input::Answer(ticket, Ok(json!({}))));
    assert!(outputs.is_empty(), "{outputs:?}");
}

#[test]
fn a_robot_that_left_stays_as_lost_with_its_place_until_it_is_back() {
    let mut bench = Bench::new();
    let all = names(3);
    bench.give(Input::Roster(Arc::new(roster(&all)), None));
    bench.give(Input::Teams(Arc::new(teams(1, &[("t1", &all)])), None));
    let outputs = bench.give(Input::Opened(1, kim()));
    bench.draw(1, outputs);
    let mut silent = roster(&all);
    silent.robots[1].presence = Presence::Stale;
    let outputs = bench.give(Input::Roster(Arc::new(silent), None));
    let (texts, frames) = bench.draw(1, outputs);
    assert_eq!(flags(&frames[0], 1), frame::STALE);
    assert_eq!(topic(&texts, "lost")[0]["robots"][0]["state"], "stale");
    let left = roster(&[all[0].clone(), all[2].clone()]);
    let outputs = bench.give(Input::Roster(Arc::new(left), None));
    let (texts, frames) = bench.draw(1, outputs);
    assert_eq!((frames[0].len() - frame::HEAD) / 8, 3);
    assert_eq!(flags(&frames[0], 1), frame::LOST);
    let lost = &topic(&texts, "lost")[0]["robots"][0];
    assert_eq!(
        (&lost["robot"], &lost["state"], &lost["team"]),
        (&json!(all[1]), &json!("lost"), &json!("t1"))
    );
    let outputs = bench.give(Input::Roster(Arc::new(roster(&all)), None));
    let (texts, frames) = bench.draw(1, outputs);
    assert_eq!((flags(&frames[0], 1), &topic(&texts, "lost")[0]["count"]), (0, &json!(0)));
    // One that does not come back is forgotten after an hour.
    let outputs = bench.give(Input::Roster(Arc::new(roster(&all[..2])), None));
    bench.draw(1, outputs);
    let outputs = bench.pass(LOST_FOR);
    let (texts, frames) = bench.draw(1, outputs);
    assert_eq!((frames.last().unwrap().len() - frame::HEAD) / 8, 2, "{texts:?}");
}

#[test]
fn what_a_wish_binds_is_marked() {
    let mut bench = Bench::new();
    let all = names(4);
    bench.give(Input::Roster(Arc::new(roster(&all)), None));
    bench.give(Input::Teams(Arc::new(teams(1, &[("t1", &all[..2]), ("t2", &all[2..])])), None));
    let wish = |kind, robots: &[String], team: Option<&str>, state| StandingWish {
        operator: OperatorId::new("kim").unwrap(),
        id: WishId::new("w").unwrap(),
        wish: Wish {
            kind,
            robots: robots.iter().map(|name| robot(name)).collect(),
            team: team.map(|team| TeamId::new(team).unwrap()),
            expires: None,
            note: None,
        },
        state,
        reason: None,
    };
    bench.give(Input::Wishes(vec![
        wish(WishKind::Lock, &[], Some("t2"), WishState::Active),
        wish(WishKind::Pin, &all[..1], Some("t1"), WishState::Waiting),
        wish(WishKind::Pin, &all[1..2], Some("t1"), WishState::Expired),
    ]));
    let outputs = bench.give(Input::Opened(1, kim()));
    let (texts, frames) = bench.draw(1, outputs);
    let pinned: Vec<bool> = (0..4).map(|at| flags(&frames[0], at) & frame::PINNED != 0).collect();
    assert_eq!(pinned, [true, false, true, true]);
    assert_eq!(topic(&texts, "wishes")[0].as_array().unwrap().len(), 3);
}

#[test]
fn links_come_for_what_a_browser_asked_for_and_the_strongest_of_too_many() {
    let mut bench = Bench::new();
    let all = names(200);
    bench.give(Input::Roster(Arc::new(roster(&all)), None));
    let outputs = bench.give(Input::Opened(1, kim()));
    bench.draw(1, outputs);
    let outputs = bench.text(1, &json!({"view": {"links": {"modality": "spatial"}}}));
    assert!(outputs.contains(&Output::Fetch(Fetch::Graph(Modality::spatial()))));
    bench.draw(1, outputs);
    // A modality that the fleet does not have is asked for no one.
    let outputs = bench.text(1, &json!({"view": {"links": {"modality": "gossip"}}}));
    assert!(!outputs.iter().any(|output| matches!(output, Output::Fetch(Fetch::Graph(_)))));
    bench.draw(1, outputs);
    let row = |source: u32| GraphRow {
        source,
        edges: (0..200)
            .filter(|to| *to != source)
            .map(|to| (to, f64::from(source + to + 1)))
            .collect(),
    };
    let graph = GraphDelta {
        header: header(1),
        modality: Modality::spatial(),
        base: None,
        nodes_added: all
            .iter()
            .enumerate()
            .map(|(node, name)| (u32::try_from(node).unwrap(), robot(name)))
            .collect(),
        nodes_removed: Vec::new(),
        rows: (0..200).map(row).collect(),
    };
    bench.give(Input::Graph(Arc::new(graph)));
    let links = |frames: &[Arc<[u8]>]| {
        let frame = frames.iter().find(|frame| frame[0] == 3).unwrap();
        (frame.len() - frame::HEAD) / 8
    };
    let outputs = bench.text(1, &json!({"view": {"links": {"modality": "spatial"}}}));
    let (_, frames) = bench.draw(1, outputs);
    assert_eq!(links(&frames), MAX_LINKS_SHOWN);
    let one = json!({"view": {"links": {"modality": "spatial", "robots": ["r00007"]}}});
    let outputs = bench.text(1, &one);
    let (_, frames) = bench.draw(1, outputs);
    assert_eq!(links(&frames), 2 * 199);
}

#[test]
fn settings_of_a_service_that_does_not_answer_stay_known() {
    let mut bench = Bench::new();
    let of = |service, teams: u32| BTreeMap::from([(service, json!({ "teams": teams }))]);
    bench.give(Input::Settings(of(ServiceName::Clusterer, 3)));
    bench.give(Input::Settings(of(ServiceName::Ingest, 1)));
    let outputs = bench.give(Input::Opened(1, kim()));
    let (texts, _) = bench.draw(1, outputs);
    let settings = topic(&texts, "settings")[0];
    assert_eq!(
        (&settings["clusterer"]["teams"], &settings["ingest"]["teams"]),
        (&json!(3), &json!(1))
    );
}

#[test]
fn nothing_is_asked_for_while_nobody_looks() {
    let mut bench = Bench::new();
    assert!(bench.pass(Duration::from_secs(60)).is_empty());
    let outputs = bench.give(Input::Opened(1, kim()));
    for fetch in [Fetch::Statuses, Fetch::Settings, Fetch::Wishes] {
        assert!(outputs.contains(&Output::Fetch(fetch.clone())), "{fetch:?}");
    }
    // One question of each kind at a time.
    let asked =
        |outputs: &[Output]| outputs.iter().filter(|o| matches!(o, Output::Fetch(_))).count();
    assert_eq!(asked(&bench.pass(Duration::from_secs(3))), 0);
    assert_eq!(asked(&bench.give(Input::Statuses(Vec::new()))), 1, "it is due again");
    bench.give(Input::Closed(1));
    assert_eq!(asked(&bench.pass(Duration::from_secs(60))), 0);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Whatever browsers send and in whatever order: no one waits with more than is allowed, and a viewer commands nothing.
    #[test]
    fn no_text_breaks_the_core(texts in prop::collection::vec(".{0,80}|\\{\"(credit|view|ask|command)\": [0-9a-z\"{}:, ]{0,60}\\}", 1..60)) {
        let mut bench = Bench::new();
        bench.give(Input::Roster(Arc::new(roster(&names(5))), None));
        bench.give(Input::Opened(1, Role::Viewer));
        for text in texts {
            let outputs = bench.give(Input::Text(1, text));
            prop_assert!(commands(&outputs).is_empty());
            prop_assert!(bench.console.waiting_bytes(1) <= MAX_REPLY_BYTES);
        }
    }
}

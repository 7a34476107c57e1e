//! Gets that ask why a robot is in its team.

use crate::common::{Bench, Ingest, announced, patterns, robot};
use muster_method::division::divide;
use muster_method::params::DivisionParams;
use muster_model::content::{Checked, Content};
use muster_model::embedding::Embedding;
use muster_model::header::{Header, Revision, StageTime};
use muster_model::id::{FleetId, OperatorId, RobotId, ServiceName, SkillId, TeamId, WishId};
use muster_model::limits::MAX_REASON_TEAMS;
use muster_model::remembered::RememberedTeams;
use muster_model::settings::{ClustererSettings, EmbedderSettings, TeamSize};
use muster_model::teams::{HeldRobot, Limited, Member, SkillPrices, Team, Teams};
use muster_model::why::{DecidedBy, Reason, Why};
use muster_model::wish::{StandingWish, Wish, WishKind, WishList, WishState};
use muster_numeric::matrix::DenseMatrix;
use muster_service::{GetId, IncomingGet, Input};
use muster_wire::{Key, Message, Pattern};
use proptest::prelude::*;

/// Two cliques, of which `m` stands with the second and hears the first.
fn fleet() -> Ingest {
    let mut ingest = Ingest::two_cliques(&["connectivity", "spatial"], 4);
    ingest.join("m");
    ingest.join("alone");
    for (name, prefix, weight) in [("connectivity", "a", 1.0), ("spatial", "b", 0.4)] {
        for i in 0..4 {
            ingest.edge(name, "m", &format!("{prefix}{i}"), weight);
            ingest.edge(name, &format!("{prefix}{i}"), "m", weight);
        }
    }
    ingest
}

/// A division of an embedding by labels; robots without one have no team.
fn division(embedding: &Embedding, label: impl Fn(usize, &RobotId) -> Option<usize>) -> Teams {
    let labels: Vec<_> =
        embedding.robots.iter().enumerate().map(|(row, robot)| label(row, robot)).collect();
    let count = labels.iter().flatten().max().map_or(0, |most| most + 1);
    let of = |team: Option<usize>| {
        let robots = embedding.robots.iter().zip(&labels);
        robots.filter(move |(_, label)| **label == team).map(|(robot, _)| robot.clone())
    };
    let team = |number: usize| Team {
        id: TeamId::numbered(number as u64 + 1),
        members: of(Some(number)).map(|robot| Member { robot, margin: 0.5 }).collect(),
        leader: of(Some(number)).next().unwrap(),
        centroid: vec![],
    };
    let head = &embedding.header;
    Teams {
        header: head.next_stage(
            Revision { term: 3, epoch: 7 },
            StageTime {
                stage: ServiceName::Clusterer,
                received: muster_model::time::Tick(5),
                published: muster_model::time::Tick(6),
            },
        ),
        embedding: head.revision,
        requested: 2,
        considered: vec![],
        teams: (0..count).map(team).collect(),
        unassigned: of(None).collect(),
        stale: vec![],
        inertia: 1.0,
        changes: vec![],
        next_team: 9,
        limited: None,
        needs: vec![],
        provisional: vec![],
        held: vec![],
        remembered: RememberedTeams::default(),
    }
}

/// `a*` in the first team, `b*` in the second, `m` as told, others in none.
fn split(embedding: &Embedding, m: usize) -> Teams {
    division(embedding, |_, robot| match robot.as_str().chars().next() {
        Some('m') => Some(m),
        Some('a') if robot.as_str() != "alone" => Some(0),
        Some('b') => Some(1),
        _ => None,
    })
}

fn message(teams: &Teams) -> Message {
    Message::Teams { teams: Checked::new_unchecked(teams.clone()), mirror: false }
}

fn wishes(list: &[(WishKind, &str, Option<&str>)]) -> Message {
    let wish = |(number, (kind, name, team)): (usize, &(WishKind, &str, Option<&str>))| {
        let robots = if name.is_empty() { vec![] } else { vec![robot(name)] };
        let team = team.map(|team| TeamId::new(team).unwrap());
        StandingWish {
            operator: OperatorId::new("alice").unwrap(),
            id: WishId::new(format!("p{number}")).unwrap(),
            wish: Wish { kind: *kind, robots, team, expires: None, note: None },
            state: WishState::Active,
            reason: None,
        }
    };
    let header = Header {
        fleet: FleetId::new("f").unwrap(),
        revision: Revision { term: 3, epoch: 8 },
        oldest: None,
        newest: None,
        stages: vec![],
    };
    let wishes = list.iter().enumerate().map(wish).collect();
    Message::Wishes(Checked::new_unchecked(WishList { header, wishes }))
}

impl Bench {
    /// Asks, and lets the get wait.
    fn ask(&mut self, get: u64, parameters: &str) {
        self.input(Input::Get(IncomingGet {
            get: GetId(get),
            selector: "muster/v1/f/why".to_owned(),
            narrowed: None,
            parameters: parameters.to_owned(),
            payload: None,
        }));
    }

    /// The fetches of divisions that wait.
    fn take_division_fetch(&mut self) -> Option<Vec<muster_service::Ask>> {
        let is = |fetch: &Vec<_>| patterns(fetch).contains(&Pattern::One(Key::Teams));
        let at = self.fetches.iter().position(is)?;
        self.fetches.remove(at)
    }

    fn answered(&mut self) -> Result<Why, String> {
        let mut reply = self.replies.pop().unwrap();
        reply.answer.map(|_| match reply.messages.pop() {
            Some(Message::Why(why)) => *why,
            other => panic!("{other:?}"),
        })
    }

    fn why(&mut self, name: &str, bus: Vec<Message>) -> Result<Reason, String> {
        self.ask(9000, &format!("robot={name}"));
        let fetch = self.take_division_fetch().unwrap();
        self.answer_fetch(fetch, bus);
        let why = self.answered()?;
        assert_eq!(why.check(), Ok(()));
        assert_eq!(why.header, self.last().header);
        Ok(why.reason)
    }
}

fn bench(ingest: &mut Ingest) -> Bench {
    let mut bench = Bench::fresh();
    bench.frame(ingest);
    bench
}

#[test]
fn a_robot_learns_what_draws_it_where() {
    let mut bench = bench(&mut fleet());
    let teams = split(bench.last(), 1);
    let reason = bench.why("m", vec![message(&teams)]).unwrap();
    assert_eq!((reason.team.as_str(), reason.decided_by), ("t2", DecidedBy::Relations));
    assert_eq!((reason.teams.len(), reason.older_s, reason.division.epoch), (2, None, 7));
    let pull = |team: usize, name: &str| {
        let pulls = &reason.teams[team].modalities;
        pulls.iter().find(|pull| pull.modality.as_str() == name).unwrap().pull
    };
    assert!(pull(0, "connectivity") < pull(1, "connectivity"), "{reason:?}");
    assert!(pull(0, "spatial") > pull(1, "spatial"), "{reason:?}");
    assert!(
        reason.text.starts_with("m is in t2, which draws it more than t1 by "),
        "{}",
        reason.text
    );
    let own = &reason.teams[0];
    assert!(own.hysteresis > 0.0 && own.price == 0.0 && (own.robots, own.max) == (5, None));
    assert!(reason.teams.iter().all(|team| team.rest.abs() < 1e-9));
    // Nobody has asked for a second fetch.
    assert!(bench.take_division_fetch().is_none());
}

#[test]
fn limits_wishes_and_dwell_are_told() {
    let mut bench = bench(&mut fleet());
    let teams = split(bench.last(), 0);
    let away = bench.why("m", vec![message(&teams)]).unwrap();
    assert_eq!(away.decided_by, DecidedBy::WholeDivision, "{}", away.text);
    let gain = away.teams[1].score - away.teams[0].score;
    assert!(gain > 0.0);

    let limited = Teams {
        limited: Some(Limited {
            optimal: true,
            gap: 0.0,
            conflict: None,
            prices: vec![0.0, gain + 0.25],
            ..Limited::open()
        }),
        ..teams.clone()
    };
    let size = TeamSize { min: Some(1), max: Some(4) };
    let settings = ClustererSettings { size, ..ClustererSettings::default() };
    let settings = announced(&serde_json::to_string(&settings).unwrap());
    let reason = bench.why("m", vec![message(&limited), settings]).unwrap();
    assert_eq!(reason.decided_by, DecidedBy::Limits);
    assert_eq!((reason.teams[1].max, reason.teams[1].price), (Some(4), gain + 0.25));
    let text = "t2 is full (4 robots): its place costs 0.250 more than m gains.";
    assert!(reason.text.contains(text), "{}", reason.text);

    assert!(!reason.settings_assumed && !reason.text.contains("defaults are assumed"));
    let reason = bench.why("m", vec![message(&limited)]).unwrap();
    assert!(reason.settings_assumed && reason.text.contains("defaults are assumed"), "{reason:?}");

    // The same by a needed skill, and where no price stands for the place.
    let by_skill = |jointly: Vec<RobotId>| Teams {
        limited: Some(Limited {
            skill_prices: vec![SkillPrices {
                skill: SkillId::new("medic").unwrap(),
                robots: vec![robot("m")],
                prices: vec![-gain, 0.25],
            }],
            prices: vec![0.0; 2],
            jointly,
            ..Limited::open()
        }),
        ..teams.clone()
    };
    let reason = bench.why("m", vec![message(&by_skill(vec![]))]).unwrap();
    assert_eq!(reason.decided_by, DecidedBy::Limits);
    assert_eq!((reason.teams[0].skill_price, reason.teams[1].skill_price), (-gain, 0.25));
    assert!(reason.text.contains("t1 needs robots with medic"), "{}", reason.text);
    assert!(reason.text.contains("t2 may have no more robots with medic"), "{}", reason.text);
    let other = bench.why("a1", vec![message(&by_skill(vec![]))]).unwrap();
    assert_eq!((other.skill, other.teams[0].skill_price), (None, 0.0));
    let reason = bench.why("m", vec![message(&by_skill(vec![robot("m")]))]).unwrap();
    assert_eq!((reason.decided_by, reason.jointly), (DecidedBy::Jointly, true));
    assert_eq!((reason.skill.as_ref(), reason.teams[0].skill_price), (None, 0.0));
    assert!(reason.text.contains("no price stands for its place"), "{}", reason.text);

    let pinned = wishes(&[(WishKind::Pin, "m", Some("t1")), (WishKind::Ban, "a1", Some("t2"))]);
    let reason = bench.why("m", vec![message(&teams), pinned.clone()]).unwrap();
    assert_eq!((reason.decided_by, reason.wishes.len()), (DecidedBy::Wishes, 1));
    assert!(reason.text.contains("The wish alice/p0 holds it in t1."), "{}", reason.text);
    let reason = bench.why("a1", vec![message(&teams), pinned]).unwrap();
    assert_eq!(reason.decided_by, DecidedBy::Relations);
    assert!(reason.teams[1].barred && reason.text.contains("alice/p1 keeps it out of t2"));
    let locked = wishes(&[(WishKind::Lock, "", Some("t1"))]);
    let reason = bench.why("m", vec![message(&teams), locked]).unwrap();
    assert!(reason.teams[1].barred && reason.decided_by == DecidedBy::Wishes, "{}", reason.text);

    let held = vec![HeldRobot { robot: robot("m"), team: TeamId::numbered(2) }];
    let held = Teams { held, provisional: vec![robot("m")], ..teams };
    let reason = bench.why("m", vec![message(&held)]).unwrap();
    assert_eq!(reason.decided_by, DecidedBy::Dwell);
    assert!(reason.provisional && reason.text.contains("provisional"), "{}", reason.text);
}

#[test]
fn an_older_division_is_told_to_be_one() {
    let mut ingest = fleet();
    let mut bench = bench(&mut ingest);
    let teams = split(bench.last(), 0);
    bench.wait(2.0);
    bench.frame(&mut ingest);
    assert!(bench.last().header.revision > teams.embedding, "republished as it was");
    assert_eq!(bench.why("m", vec![message(&teams)]).unwrap().older_s, None);
    ingest.edge("spatial", "m", "b0", 3.0);
    bench.frame(&mut ingest);
    let reason = bench.why("m", vec![message(&teams)]).unwrap();
    assert!(reason.older_s.is_some_and(|older| older > 1.0), "{reason:?}");
    assert!(reason.text.contains("s older than the graphs"), "{}", reason.text);
    // Two divisions answer: the newer one counts.
    let newer = Teams {
        header: Header { revision: Revision { term: 3, epoch: 8 }, ..teams.header.clone() },
        ..split(bench.last(), 1)
    };
    let reason = bench.why("m", vec![message(&newer), message(&teams)]).unwrap();
    assert_eq!((reason.team.as_str(), reason.older_s), ("t2", None));
}

#[test]
fn what_has_no_reason_is_refused_with_one() {
    let mut bench = Bench::fresh();
    let teams_of = |bench: &Bench| message(&split(bench.last(), 0));
    let none = bench.why("m", vec![]).unwrap_err();
    assert!(none.contains("there is no division yet"), "{none}");
    let mut ingest = fleet();
    bench.frame(&mut ingest);
    let teams = teams_of(&bench);
    let alone = bench.why("alone", vec![teams.clone()]).unwrap_err();
    assert!(alone.contains("alone is in no team: nothing relates it"), "{alone}");
    let reserve = wishes(&[(WishKind::Reserve, "alone", None)]);
    let alone = bench.why("alone", vec![teams.clone(), reserve]).unwrap_err();
    assert!(alone.contains("the wish alice/p0 keeps it in reserve"), "{alone}");
    let unknown = bench.why("nobody", vec![teams.clone()]).unwrap_err();
    assert!(unknown.contains("nobody is not a robot of the fleet"), "{unknown}");
    let mut conflict = split(bench.last(), 0);
    conflict.teams[0].members.retain(|member| member.robot != robot("m"));
    conflict.unassigned = vec![robot("alone"), robot("m")];
    conflict.limited = Some(Limited::standing("9 robots, 8 places".to_owned()));
    let without = bench.why("m", vec![message(&conflict)]).unwrap_err();
    assert!(without.contains("the limits leave no place: 9 robots, 8 places"), "{without}");
    for i in 0..4 {
        for (name, prefix) in [("connectivity", "a"), ("spatial", "b")] {
            ingest.edge(name, "m", &format!("{prefix}{i}"), 0.0);
            ingest.edge(name, &format!("{prefix}{i}"), "m", 0.0);
        }
    }
    bench.frame(&mut ingest);
    let lost = bench.why("m", vec![teams]).unwrap_err();
    assert!(lost.contains("its team t1 rests on older ones"), "{lost}");
    ingest.join("new");
    ingest.edge("spatial", "new", "a0", 1.0);
    let before = message(&split(bench.last(), 0));
    bench.frame(&mut ingest);
    let new = bench.why("new", vec![before]).unwrap_err();
    assert!(new.contains("new is not in the last division yet"), "{new}");
    let questions = [
        "",
        "robot",
        "robot=",
        "robot=R",
        "robot=\u{1b}[2J",
        "x=1",
        "robot=a;robot=b",
        "robot=%00",
    ];
    for wrong in questions {
        bench.ask(1, wrong);
        let error = bench.answered().unwrap_err();
        assert!(error.contains(r#""error":""#) && !error.contains('\u{1b}'), "{wrong:?}: {error}");
    }
    assert!(bench.take_division_fetch().is_none(), "nothing is fetched for nonsense");
    // A get of everything asks for nothing.
    assert!(bench.get("**", None).unwrap().iter().all(|one| !matches!(one, Message::Why(_))));
}

#[test]
fn questions_wait_for_one_fetch_and_take_turns_with_embeddings() {
    let mut ingest = fleet();
    let mut bench = bench(&mut ingest);
    let teams = message(&split(bench.last(), 0));
    for get in 0..70 {
        bench.ask(get, "robot=m");
    }
    let refused = std::mem::take(&mut bench.replies);
    assert_eq!(refused.len(), 6, "64 wait");
    let text = refused[0].answer.as_ref().unwrap_err();
    assert!(text.contains("64 questions wait already"), "{text}");
    bench.hold_jobs = true;
    let fetch = bench.take_division_fetch().unwrap();
    assert!(bench.take_division_fetch().is_none(), "one fetch for all");
    bench.answer_fetch(fetch, vec![teams]);
    assert!(bench.job.is_some() && bench.replies.is_empty());
    ingest.edge("spatial", "m", "b0", 0.7);
    let published = bench.published.len();
    bench.frame(&mut ingest);
    bench.run_job();
    assert_eq!(bench.replies.len(), 4, "the first job answers four");
    bench.run_job();
    assert_eq!((bench.replies.len(), bench.published.len()), (4, published + 1), "then the frame");
    while bench.job.is_some() {
        bench.run_job();
    }
    assert_eq!(bench.replies.len(), 64);
    assert!(bench.replies.iter().all(|reply| reply.answer.is_ok()));
    assert_eq!(bench.counter("explanations_started"), 16);
}

#[test]
fn an_explanation_that_panics_is_answered_and_does_no_harm() {
    let mut ingest = fleet();
    let mut bench = bench(&mut ingest);
    let teams = message(&split(bench.last(), 0));
    bench.hold_jobs = true;
    bench.ask(1, "robot=m");
    let fetch = bench.take_division_fetch().unwrap();
    bench.answer_fetch(fetch, vec![teams.clone()]);
    bench.panic_job("no");
    let error = bench.answered().unwrap_err();
    assert!(error.contains("the explanation has failed"), "{error}");
    bench.hold_jobs = false;
    ingest.edge("spatial", "m", "b0", 0.7);
    bench.frame(&mut ingest);
    assert!(bench.why("m", vec![teams]).is_ok());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// For fleets that are divided as the clusterer divides, all parts add up to the total, and no team that draws a
    /// robot by more than its own is missing.
    #[test]
    fn the_parts_add_up_and_the_total_decides(
        edges in prop::collection::vec((0_usize..12, 0_usize..12, 0.05_f64..2.0, any::<bool>()), 24..80),
        teams in 2_usize..4,
    ) {
        let mut ingest = Ingest::new(&["connectivity", "spatial"]);
        (0..12).for_each(|i| ingest.join(&format!("r{i:02}")));
        for (from, to, weight, is_link) in edges {
            if from != to {
                let name = if is_link { "connectivity" } else { "spatial" };
                ingest.edge(name, &format!("r{from:02}"), &format!("r{to:02}"), weight);
            }
        }
        let mut bench = Bench::started(EmbedderSettings::default(), vec![]);
        bench.frame(&mut ingest);
        let embedding = bench.last().clone();
        let x = DenseMatrix::new(12, embedding.dimension as usize, embedding.values.clone()).unwrap();
        let params = DivisionParams { teams, ..DivisionParams::default() }.check().unwrap();
        let found = divide(&x, &embedding.without_embedding, &params, None, &mut |_| {}).unwrap();
        let division = division(&embedding, |row, _| found.labels[row]);
        for (robot, label) in embedding.robots.iter().zip(&found.labels) {
            let answer = bench.why(robot.as_str(), vec![message(&division)]);
            let Some(label) = label else {
                prop_assert!(answer.is_err());
                continue;
            };
            // `Bench::why` checks that the parts add up to 1e-9.
            let reason = answer.unwrap();
            prop_assert_eq!(&reason.team, &division.teams[*label].id);
            prop_assert!(reason.teams.len() <= MAX_REASON_TEAMS);
            let own = &reason.teams[0];
            if found.converged {
                prop_assert!(reason.teams.iter().all(|team| team.total <= own.total + 1e-9), "{:?}", reason);
            }
            // ‖x‖² less the score is the squared distance to the mean of the team.
            let row = x.row(embedding.robots.binary_search(robot).unwrap());
            let far: f64 = row.iter().zip(found.centroids.row(*label)).map(|(x, c)| (x - c).powi(2)).sum();
            prop_assert!((reason.length_squared - own.score - far).abs() <= 1e-9);
        }
    }
}

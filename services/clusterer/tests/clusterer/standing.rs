//! What all have agreed on stands when the power is cut or a team is lost, whatever led to it.

use std::time::Duration;

use serde_json::{Value, json};

use super::*;

/// How long nothing changes before something is lost: what is held back for a while has followed.
const REST_SECONDS: usize = 14;

/// How long all have agreed by then: what they have agreed on is on the disk.
const WRITTEN_SECONDS: usize = 5;

/// How long after the restart all robots have their teams: they are awaited for some seconds.
const RESTART_SECONDS: usize = 20;

/// Robots of the fleet, as `r0` to `r5`.
const ROBOTS: u8 = 6;

/// What may happen before.
#[derive(Debug, Clone)]
enum Act {
    /// Robots that are there, and how many teams they show.
    Embedding(Vec<Option<(i8, i8)>>, u32),
    /// A wish of this name, or that it is withdrawn.
    Wish(u8, Option<Value>),
    /// Settings change.
    Settings(Value),
    /// Time passes.
    Wait(f64),
}

fn place() -> impl Strategy<Value = Option<(i8, i8)>> {
    prop::option::weighted(0.8, (-2_i8..3, -2_i8..3))
}

fn wish() -> impl Strategy<Value = Value> {
    let (robot, team) = (0..ROBOTS, 1_u8..6);
    (0..6, robot.clone(), robot, team).prop_map(|(kind, one, other, team)| {
        let (one, other, team) = (format!("r{one}"), format!("r{other}"), format!("t{team}"));
        match kind {
            0 => json!({"kind": "pin", "robots": [one], "team": team}),
            1 => json!({"kind": "ban", "robots": [one], "team": team}),
            2 => json!({"kind": "lock", "team": team}),
            4 if one != other => json!({"kind": "together", "robots": [one, other]}),
            5 if one != other => json!({"kind": "apart", "robots": [one, other]}),
            _ => json!({"kind": "reserve", "robots": [one]}),
        }
    })
}

fn patch() -> impl Strategy<Value = Value> {
    prop_oneof![
        (1_u8..6).prop_map(|teams| json!({ "teams": teams })),
        (1_u8..4, 0_u8..3)
            .prop_map(|(from, more)| json!({"teams": {"from": from, "to": from + more}})),
        Just(json!({"teams": "auto"})),
        (0_u8..3).prop_map(|dwell| json!({ "dwell_s": dwell })),
        (1_u8..3, 3_u8..6).prop_map(|(min, max)| json!({"size": {"min": min, "max": max}})),
        Just(json!({"size": null})),
        (1_u8..5, 1_u8..5).prop_map(|(team, max)| json!({"team_size": {format!("t{team}"): {"max": max}}})),
        Just(json!({"team_size": null})),
        (1_u8..3, any::<bool>())
            .prop_map(|(min, soft)| json!({"needs": [{"skill": "medic", "per_team": {"min": min}, "soft": soft}]})),
        Just(json!({"needs": null})),
    ]
}

fn act() -> impl Strategy<Value = Act> {
    let places = || prop::collection::vec(place(), usize::from(ROBOTS));
    prop_oneof![
        6 => (places(), 1_u32..5).prop_map(|(places, shown)| Act::Embedding(places, shown)),
        6 => (0_u8..3, prop::option::weighted(0.7, wish())).prop_map(|(name, wish)| Act::Wish(name, wish)),
        1 => patch().prop_map(Act::Settings),
        4 => (0.0..3.0).prop_map(Act::Wait),
        1 => (0.0..70.0).prop_map(Act::Wait),
    ]
}

/// Robots at places of a grid.
fn rows(places: &[Option<(i8, i8)>], shown: u32) -> Checked<Embedding> {
    let rows = places.iter().enumerate().filter_map(|(i, place)| {
        let (x, y) = (*place)?;
        // No two robots are at the same place, and no two distances are the same.
        let apart = 0.01 * f64::from(u32::try_from(i).unwrap() + 1).sqrt();
        let place = vec![f64::from(x) + apart, f64::from(y) - apart * apart];
        Some((robot(&format!("r{i}")), place, false))
    });
    let mut embedding = Embedding::clone(&from_rows(1, 1, rows.collect()));
    embedding.quality.teams_shown = Some(shown);
    Checked::new_unchecked(embedding)
}

/// A clusterer, and what it has published last.
struct Run {
    bench: Bench,
    term: u64,
    epoch: u64,
    newest: Checked<Embedding>,
    last: Option<Checked<Teams>>,
}

impl Run {
    fn new(bench: Bench, term: u64, newest: Checked<Embedding>) -> Self {
        Self { bench, term, epoch: 0, newest, last: None }
    }

    fn read(&mut self) {
        if let Some((teams, _)) = self.bench.take().teams.pop() {
            self.last = Some(teams);
        }
    }

    /// The newest embedding is received with its roster, and a second passes.
    fn second(&mut self) {
        let newest = self.newest.clone();
        self.receive(&newest);
        self.bench.wait(1.0);
        self.read();
    }

    fn receive(&mut self, embedding: &Embedding) {
        self.epoch += 1;
        let names = embedding.robots.iter().map(|robot| match robot.as_str() {
            name @ ("r0" | "r3" | "r5") => format!("{name}:medic"),
            name => name.to_owned(),
        });
        let names = names.collect::<Vec<_>>().join(" ");
        let mut roster = roster(self.epoch, &names);
        roster.header = header(self.term, self.epoch);
        self.bench.receive_roster(roster);
        self.bench.receive_embedding(&again(embedding, self.term, self.epoch));
    }

    fn act(&mut self, act: Act) {
        match act {
            Act::Embedding(places, shown) => {
                self.newest = rows(&places, shown);
                let newest = self.newest.clone();
                self.receive(&newest);
            }
            Act::Wish(name, wish) => {
                let payload = wish.unwrap_or(Value::Null).to_string();
                // Some are refused, as nothing could satisfy them.
                let _ = self.bench.get(&format!("wish/alice/w{name}"), Some(&payload));
            }
            Act::Settings(patch) => {
                let _ = self.bench.get("service/clusterer/settings", Some(&patch.to_string()));
            }
            Act::Wait(seconds) => self.bench.wait(seconds),
        }
        self.read();
    }

    /// Nothing changes until all have agreed for a while.
    fn rest(&mut self) {
        let mut unchanged = 0;
        for second in 0.. {
            let before = self.last.as_deref().map(short);
            self.second();
            unchanged = if self.last.as_deref().map(short) == before { unchanged + 1 } else { 0 };
            if second >= REST_SECONDS && unchanged >= WRITTEN_SECONDS {
                break;
            }
        }
    }

    /// The robots for which `is_there` holds are received.
    fn receive_some(&mut self, is_there: impl Fn(&RobotId) -> bool) {
        let newest = self.newest.clone();
        let rows = newest.robots.iter().zip(newest.values.chunks(2));
        let rows = rows.filter(|(robot, _)| is_there(robot));
        let rows = rows.map(|(robot, place)| (robot.clone(), place.to_vec(), false));
        let mut embedding = Embedding::clone(&from_rows(1, 1, rows.collect()));
        embedding.quality.teams_shown = newest.quality.teams_shown;
        self.receive(&embedding);
    }

    /// The settings that it answers with.
    fn settings(&mut self) -> ClustererSettings {
        let answer = self.bench.get("service/clusterer/settings", None).unwrap();
        let Some(Message::Settings(announced)) = answer.first() else { panic!("{answer:?}") };
        serde_json::from_str(&announced.settings).unwrap()
    }

    /// Whether a wish names a team that there may be only later: numbers go on higher after a restart.
    fn names_team_to_come(&mut self) -> bool {
        let next = self.last.as_ref().map_or(0, |teams| teams.next_team);
        let answer = self.bench.get("wishes", None).unwrap();
        let Some(Message::Wishes(list)) = answer.first() else { return false };
        let named = list.wishes.iter().filter_map(|one| one.wish.team.as_ref());
        named.map(|team| team.as_str()[1..].parse::<u64>().unwrap()).any(|number| number >= next)
    }

    /// The next process, which has what is on the disk of this one.
    fn restarted(&mut self) -> Self {
        let settings = self.settings();
        let kept = self.bench.kept.clone();
        let mut bench = Bench::begun(self.bench.now.after(Duration::from_secs(3)), settings);
        if let Some(kept) = kept {
            bench.input(Input::Restored(kept));
        }
        bench.start(vec![]);
        Self::new(bench, self.term + 1, self.newest.clone())
    }
}

/// The number of a robot.
fn number(robot: &RobotId) -> usize {
    usize::from(robot.as_str().as_bytes()[1] - b'0')
}

proptest! {
    #[test]
    fn a_team_that_is_lost_moves_no_other_robot_and_comes_back(
        acts in prop::collection::vec(act(), 1..12),
        lost in 0_usize..4,
        order in prop::collection::vec((0_u8..8, 0_u8..6), usize::from(ROBOTS)),
        lasts in 3_u8..50,
    ) {
        let bench = Bench::leading(ClustererSettings { dwell_s: 0.5, ..teams(2) });
        let mut run = Run::new(bench, 1, rows(&[], 1));
        let has_rules = |act: &Act| match act {
            Act::Wish(..) => true,
            Act::Settings(patch) => patch.get("teams").is_none() && patch.get("dwell_s").is_none(),
            _ => false,
        };
        for act in acts.into_iter().filter(|act| !has_rules(act)) {
            run.act(act);
        }
        // No other team is absent by then.
        run.rest();
        run.bench.wait(60.0);
        run.rest();
        let Some(before) = run.last.clone() else { return Ok(()) };
        let is_full = before.requested as usize == before.teams.len() && before.held.is_empty();
        if before.teams.len() < 2 || !is_full {
            return Ok(());
        }
        let team = &before.teams[lost % before.teams.len()];
        let is_lost = |robot: &RobotId| team.members.iter().any(|member| member.robot == *robot);
        let moved = |now: Option<&Teams>| {
            let now: BTreeMap<&RobotId, &TeamId> = now.into_iter().flat_map(Teams::assignments).collect();
            let before = before.assignments();
            before.filter(|(robot, team)| now.get(robot).is_some_and(|now| now != team)).count()
        };
        // They leave one after the other, and come back one after the other.
        for step in 0..8 {
            run.receive_some(|robot| !is_lost(robot) || order[number(robot)].0 > step);
            run.bench.wait(0.25);
            run.read();
            prop_assert_eq!(moved(run.last.as_deref()), 0, "as they leave");
        }
        for _ in 0..lasts {
            run.receive_some(|robot| !is_lost(robot));
            run.bench.wait(1.0);
            run.read();
            prop_assert_eq!(moved(run.last.as_deref()), 0, "while they are away");
        }
        for step in 0..6 {
            run.receive_some(|robot| !is_lost(robot) || order[number(robot)].1 <= step);
            run.bench.wait(0.25);
            run.read();
            prop_assert_eq!(moved(run.last.as_deref()), 0, "as they return");
        }
        run.rest();
        prop_assert_eq!(run.last.as_deref().map(short), Some(short(&before)));
    }

    #[test]
    fn a_restart_at_rest_changes_no_team(
        acts in prop::collection::vec(act(), 1..20),
        first in prop::collection::vec(any::<bool>(), usize::from(ROBOTS)),
    ) {
        let bench = Bench::leading(ClustererSettings { dwell_s: 0.5, ..teams(4) });
        let mut run = Run::new(bench, 1, rows(&[], 1));
        for act in acts {
            run.act(act);
        }
        run.rest();
        if run.last.is_none() || run.newest.robots.is_empty() || run.names_team_to_come() {
            return Ok(());
        }
        let mut next = run.restarted();
        // Some robots are there a moment before the others.
        next.receive_some(|robot| first[number(robot)]);
        next.bench.wait(0.4);
        for _ in 0..RESTART_SECONDS {
            next.second();
        }
        let [before, after] = [&run, &next].map(|run| run.last.as_ref().map(|teams| short(teams)));
        prop_assert_eq!(before, after);
    }
}

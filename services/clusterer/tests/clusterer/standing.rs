//! What all have agreed on stands when the power is cut, whatever led to it.

use std::time::Duration;

use serde_json::{Value, json};

use super::*;

/// How long nothing changes before the restart: what is held back for a while has followed.
const REST_SECONDS: usize = 14;

/// How long all have agreed by then: it is on the disk.
const WRITTEN_SECONDS: usize = 5;

/// How long after it all robots have their teams: they are awaited for some seconds.
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

    /// What of it is lost, and begun again by the disk.
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

proptest! {
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
        let mut unchanged = 0;
        for second in 0.. {
            let before = run.last.as_deref().map(short);
            run.second();
            unchanged = if run.last.as_deref().map(short) == before { unchanged + 1 } else { 0 };
            if second >= REST_SECONDS && unchanged >= WRITTEN_SECONDS {
                break;
            }
        }
        if run.last.is_none() || run.newest.robots.is_empty() || run.names_team_to_come() {
            return Ok(());
        }
        let mut next = run.restarted();
        // Some robots are there a moment before the others.
        let embedding = next.newest.clone();
        let early = |robot: &RobotId| first[usize::from(robot.as_str().as_bytes()[1] - b'0')];
        let rows = embedding.robots.iter().zip(embedding.values.chunks(2));
        let rows = rows.filter(|(robot, _)| early(robot));
        let rows = rows.map(|(robot, place)| (robot.clone(), place.to_vec(), false));
        next.receive(&from_rows(1, 1, rows.collect()));
        next.bench.wait(0.4);
        for _ in 0..RESTART_SECONDS {
            next.second();
        }
        let [before, after] = [&run, &next].map(|run| run.last.as_ref().map(|teams| short(teams)));
        prop_assert_eq!(before, after);
    }
}

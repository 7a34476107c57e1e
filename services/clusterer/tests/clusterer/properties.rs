//! What holds whatever happens.

use super::*;

/// What may happen to a clusterer.
#[derive(Debug, Clone)]
enum Act {
    /// An embedding: per robot absent, or a place on a small grid and whether it has no embedding.
    Embedding(Vec<Option<(i8, i8, bool)>>),
    /// Another number of teams.
    Teams(u32),
    /// The process dies; the division survives elsewhere.
    Restart,
    /// Time passes.
    Wait(f64),
}

fn act() -> impl Strategy<Value = Act> {
    let place = prop::option::weighted(0.8, (-2_i8..3, -2_i8..3, prop::bool::weighted(0.1)));
    prop_oneof![
        8 => prop::collection::vec(place, 12).prop_map(Act::Embedding),
        1 => (1_u32..6).prop_map(Act::Teams),
        1 => Just(Act::Restart),
        1 => (0.0..2.0).prop_map(Act::Wait),
    ]
}

/// What each robot is informed of.
fn robot_teams(teams: &Teams) -> impl Iterator<Item = RobotTeam> {
    let members = teams.teams.iter().flat_map(|team| &team.members).map(|member| &member.robot);
    members.chain(&teams.unassigned).filter_map(|robot| teams.robot_team(robot))
}

/// Team, members and leader, as a robot knows them.
type Place = (Option<TeamId>, Option<Vec<RobotId>>, Option<RobotId>);

/// What robots and readers of the bus know.
#[derive(Default)]
struct World {
    teams: Option<Checked<Teams>>,
    /// Teams that ended, with the robots that were in them when they did or left them before.
    gone: BTreeMap<TeamId, BTreeSet<RobotId>>,
    members: BTreeMap<TeamId, BTreeSet<RobotId>>,
    known: BTreeMap<RobotId, Place>,
}

impl World {
    fn read(&mut self, sent: &common::Published) {
        for (teams, _) in &sent.teams {
            if let Some(before) = &self.teams {
                assert!(teams.header.revision > before.header.revision);
                let ids: BTreeSet<_> = teams.teams.iter().map(|team| team.id.clone()).collect();
                for team in &before.teams {
                    if !ids.contains(&team.id) {
                        let all = self.members.get(&team.id).cloned().unwrap_or_default();
                        self.gone.insert(team.id.clone(), all);
                    }
                }
                for team in &teams.teams {
                    let Some(old) = self.gone.remove(&team.id) else { continue };
                    let same = team.members.iter().filter(|m| old.contains(&m.robot)).count();
                    assert!(same * 2 > team.members.len(), "{} is another team", team.id);
                }
                self.check_changes(before, teams);
            }
            for team in &teams.teams {
                let all = self.members.entry(team.id.clone()).or_default();
                all.extend(team.members.iter().map(|member| member.robot.clone()));
            }
            self.teams = Some(teams.clone());
        }
        for team in &sent.robots {
            let content = (team.team.clone(), team.members.clone(), team.leader.clone());
            self.known.insert(team.robot.clone(), content);
        }
        for now in self.teams.iter().flat_map(|teams| robot_teams(teams)) {
            let content = (now.team, now.members, now.leader);
            assert_eq!(self.known.get(&now.robot), Some(&content), "{} knows its team", now.robot);
        }
    }

    fn check_changes(&self, before: &Teams, now: &Teams) {
        let place = |teams: &Teams| -> BTreeMap<RobotId, String> {
            let all = robot_teams(teams).map(|team| {
                (team.robot, team.team.map_or("-".to_owned(), |team| team.to_string()))
            });
            all.collect()
        };
        let (old, new) = (place(before), place(now));
        let moved: Vec<String> = old
            .iter()
            .filter_map(|(robot, from)| {
                let to = new.get(robot)?;
                (from != to).then(|| format!("moved {robot} {from} {to}"))
            })
            .collect();
        let all = changes_in_short(&now.changes);
        let said: Vec<_> = all.iter().filter(|text| text.starts_with("moved")).cloned().collect();
        assert_eq!(said, moved);
        let has = |teams: &Teams, id: &TeamId| teams.teams.iter().any(|team| team.id == *id);
        let starts = now.teams.iter().filter(|team| !has(before, &team.id)).count();
        let ends = before.teams.iter().filter(|team| !has(now, &team.id)).count();
        let count = |words: [&str; 2]| {
            all.iter().filter(|text| words.iter().any(|word| text.starts_with(word))).count()
        };
        assert_eq!((count(["born", "split"]), count(["died", "merged"])), (starts, ends));
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    #[test]
    fn every_robot_has_one_place_and_no_id_is_used_twice(
        acts in prop::collection::vec(act(), 1..25)
    ) {
        let mut settings = ClustererSettings { restarts: 3, dwell_s: 0.5, ..teams(3) };
        let mut bench = Bench::leading(settings.clone());
        let mut world = World::default();
        let mut newest: Option<Checked<Embedding>> = None;
        for (epoch, act) in (1..).zip(acts) {
            match act {
                Act::Embedding(places) => {
                    let rows = places.into_iter().enumerate().filter_map(|(i, place)| {
                        let (x, y, without) = place?;
                        Some((robot(&format!("r{i}")), vec![f64::from(x), f64::from(y)], without))
                    });
                    let next = from_rows(1, epoch, rows.collect());
                    bench.receive_embedding(&next);
                    newest = Some(next);
                }
                Act::Teams(many) => {
                    settings.teams = TeamCount::Fixed(many);
                    let patch = format!("{{\"teams\":{many}}}");
                    bench.get("service/clusterer/settings", Some(&patch)).unwrap();
                }
                Act::Restart => {
                    world.read(&bench.take());
                    let teams = world.teams.iter().map(mirrored);
                    let embedding = newest.iter().map(|e| Message::Embedding(e.clone()));
                    let now = bench.now;
                    bench = Bench::restored(settings.clone(), teams.chain(embedding).collect());
                    bench.now = now;
                }
                Act::Wait(seconds) => bench.wait(seconds),
            }
            if let Some(embedding) = &newest {
                // Those who return without relations are awaited for a second.
                let divided = world.teams.iter().flat_map(|teams| robot_teams(teams));
                let divided: BTreeSet<RobotId> = divided.map(|team| team.robot).collect();
                if embedding.robots.iter().any(|robot| !divided.contains(robot)) {
                    bench.wait(1.01);
                }
            }
            world.read(&bench.take());
            let (Some(teams), Some(embedding)) = (&world.teams, &newest) else { continue };
            let mut robots: Vec<RobotId> =
                robot_teams(teams).map(|team| team.robot).collect();
            robots.sort_unstable();
            prop_assert_eq!(&robots, &embedding.robots);
            let without = embedding.robots.iter().zip(&embedding.without_embedding).filter(|(_, u)| **u);
            prop_assert!(without.map(|(robot, _)| robot).eq(&teams.unassigned));
            prop_assert!(teams.teams.len() <= *settings.teams.range().end() as usize);
            prop_assert!(teams.teams.iter().all(|team| !team.members.is_empty()));
            let number = |id: &TeamId| id.as_str()[1..].parse::<u64>().unwrap();
            let numbers: Vec<u64> = teams.teams.iter().map(|team| number(&team.id)).collect();
            prop_assert!(numbers.is_sorted_by(|l, r| l < r));
            prop_assert!(numbers.iter().all(|number| *number < teams.next_team));
        }
    }
}

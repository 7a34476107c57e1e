//! How large a day of history is, and how long a moment of it takes to find:
//! `cargo run --release -p muster-historian --no-default-features --features store --example sizes`.
//!
//! Two fleets are recorded for a simulated day, with 1 % of the robots in another team each minute, scores every ten
//! seconds, an event for each move, a whole division every ten minutes, and positions of all robots, which march, twice a
//! minute. With `--quick` it is an hour of 500 robots, and
//! the size is that of a day in proportion.

#![expect(clippy::expect_used, reason = "a program that measures ends where it cannot")]

use std::time::Instant;

use muster_historian::FileRecords;
use muster_model::audit::Quality;
use muster_model::event::Severity;
use muster_model::header::Revision;
use muster_model::history::{
    AuditRecord, DivisionRecord, Entry, EventRecord, Place, PositionsRecord, Query, Record, Rows,
    SnapshotCause, Subject, TeamLine,
};
use muster_model::id::{FleetId, InstanceId, RobotId, ServiceName, TeamId};
use muster_model::time::Tick;
use muster_service::records::Records as _;

const START: u64 = 1_795_208_980_000_000;
const MINUTE_US: u64 = 60_000_000;
const MINUTES: u64 = 24 * 60;
const ASKED: u64 = 200;

/// A fleet whose robots move among its teams.
struct Fleet {
    robots: Vec<RobotId>,
    teams: Vec<TeamId>,
    team_of: Vec<usize>,
    epoch: u64,
    entries: Vec<Entry>,
}

impl Fleet {
    fn new(robots: usize, teams: usize) -> Self {
        let robot = |number: usize| RobotId::new(format!("robot-{number:05}"));
        Self {
            robots: (0..robots).map(|number| robot(number).expect("an id")).collect(),
            teams: (1..=teams as u64).map(TeamId::numbered).collect(),
            team_of: (0..robots).map(|number| number % teams).collect(),
            epoch: 0,
            entries: Vec::new(),
        }
    }

    fn add(&mut self, at: u64, record: Record) {
        self.entries.push(Entry { at: Tick(at), record });
    }

    fn line(&self, team: usize) -> TeamLine {
        let members = self.team_of.iter().filter(|of| **of == team).count();
        let leader = self.team_of.iter().position(|of| *of == team);
        TeamLine {
            team: self.teams[team].clone(),
            leader: leader.map(|leader| self.robots[leader].clone()),
            members: u32::try_from(members).expect("a small fleet"),
        }
    }

    fn division(
        &mut self,
        at: u64,
        snapshot: Option<SnapshotCause>,
        places: Vec<Place>,
        teams: &[usize],
    ) {
        self.epoch += 1;
        let lines = teams.iter().map(|team| self.line(*team)).collect();
        let count = |number: usize| u32::try_from(number).expect("a small fleet");
        let record = DivisionRecord {
            revision: Revision { term: 1_795_208_000, epoch: self.epoch },
            requested: count(self.teams.len()),
            teams: count(self.teams.len()),
            robots: count(self.robots.len()),
            snapshot,
            places,
            lines,
        };
        self.add(at, Record::Division(record));
    }

    fn whole(&mut self, at: u64, cause: SnapshotCause) {
        let place = |(robot, team): (&RobotId, &usize)| Place {
            robot: robot.clone(),
            present: true,
            team: Some(self.teams[*team].clone()),
            stale: false,
            was: None,
        };
        let places = self.robots.iter().zip(&self.team_of).map(place).collect();
        let teams: Vec<usize> = (0..self.teams.len()).collect();
        self.division(at, Some(cause), places, &teams);
    }

    fn move_one(&mut self, at: u64, number: u64) {
        let robot = (number.wrapping_mul(2_654_435_761) % self.robots.len() as u64) as usize;
        let from = self.team_of[robot];
        let to = (from + 1 + (number % (self.teams.len() as u64 - 1)) as usize) % self.teams.len();
        self.team_of[robot] = to;
        let place = Place {
            robot: self.robots[robot].clone(),
            present: true,
            team: Some(self.teams[to].clone()),
            stale: false,
            was: Some(self.teams[from].clone()),
        };
        let detail = format!(
            "{{\"change\":\"moved\",\"from\":\"{}\",\"robot\":\"{}\",\"to\":\"{}\"}}",
            self.teams[from], self.robots[robot], self.teams[to]
        );
        self.division(at, None, vec![place], &[from, to]);
        let event = EventRecord {
            source: ServiceName::Clusterer,
            revision: Revision { term: 1_795_208_000, epoch: self.epoch },
            severity: Severity::Info,
            kind: "team_changed".to_owned(),
            detail,
        };
        self.add(at, Record::Event(event));
    }

    fn audit(&mut self, at: u64) {
        let mean = (self.epoch % 100) as f64 / 100.0;
        let per_team = self.teams.iter().map(|team| (team.clone(), mean)).collect();
        let revision = Revision { term: 1_795_208_000, epoch: self.epoch };
        let record = AuditRecord {
            revision,
            division: revision,
            mean: Some(mean),
            physical_mean: Some(mean),
            verdict: Quality::Good,
            per_team,
        };
        self.add(at, Record::Audit(record));
    }

    /// All robots, a kilometre further than an hour before.
    fn positions(&mut self, at: u64) {
        let east = (at / 3_600) as i64 / 10;
        let place = |(number, robot): (usize, &RobotId)| {
            (robot.clone(), [east + 300 * (number as i64 % 100), 300 * (number as i64 / 100)])
        };
        let robots = self.robots.iter().enumerate().map(place).collect();
        self.add(at, Record::Positions(PositionsRecord { is_whole: true, robots }));
    }
}

fn measure(robots: usize, teams: usize, minutes: u64) {
    let folder = tempfile::tempdir().expect("a folder");
    let fleet = FleetId::new("f").expect("an id");
    let instance = InstanceId::new("i-1").expect("an id");
    let mut store = FileRecords::open(Some(folder.path()), &fleet, &instance).expect("a store");
    let mut fleet = Fleet::new(robots, teams);
    fleet.whole(START, SnapshotCause::Start);
    let moves = (robots / 100) as u64;
    let begun = Instant::now();
    for minute in 0..minutes {
        let at = START + minute * MINUTE_US;
        if minute > 0 && minute.is_multiple_of(10) {
            fleet.whole(at, SnapshotCause::Periodic);
        }
        for second in 0..6 {
            fleet.audit(at + second * 10_000_000);
        }
        fleet.positions(at);
        fleet.positions(at + MINUTE_US / 2);
        for number in 0..moves {
            fleet.move_one(at + number * (MINUTE_US / moves), minute * moves + number);
        }
        fleet.entries.sort_by_key(|entry| entry.at);
        store.write(&std::mem::take(&mut fleet.entries)).expect("it is written");
    }
    let took = begun.elapsed();
    let size = store.coverage().bytes as f64 / 1e6 * MINUTES as f64 / minutes as f64;
    println!(
        "{robots} robots, {teams} teams: {size:.1} MB a day, written in {:.0} s",
        took.as_secs_f64()
    );
    let mut times: Vec<f64> = (0..ASKED)
        .map(|number| {
            let moment = Tick(START + number * (minutes * MINUTE_US / ASKED) + 599_000_000);
            let begun = Instant::now();
            let page = store.answer(&Query::of(Subject::AsOf(moment))).expect("an answer");
            let took = begun.elapsed().as_secs_f64() * 1e3;
            assert!(
                matches!(page.rows, Rows::AsOf(Some(division)) if division.teams.len() == teams
                    && division.positions.len() == robots)
            );
            took
        })
        .collect();
    times.sort_by(f64::total_cmp);
    let (middle, last) = (times[times.len() / 2], times[times.len() - 1]);
    println!("  as of a moment: median {middle:.1} ms, at most {last:.1} ms, of {ASKED}");
}

fn main() {
    if std::env::args().any(|argument| argument == "--quick") {
        return measure(500, 8, 60);
    }
    measure(500, 8, MINUTES);
    measure(10_000, 50, MINUTES);
}

//! How long an audit with the ten worst losses takes:
//! `cargo run --release -p muster-auditor --no-default-features --example losses`.
//!
//! A fleet of 10,000 robots in 50 teams is audited twice: without a graph of radio, and with one in which each robot
//! receives the eight next ones along a line, so that there are many robots whose loss cuts others off. What the second
//! takes longer is what radio and losses cost. With `--quick` it is 1,000 robots in 5 teams.

#![expect(
    clippy::expect_used,
    clippy::cast_precision_loss,
    reason = "a program that measures ends where it cannot, and there are few robots"
)]

use std::sync::Arc;
use std::time::Instant;

use muster_auditor::Auditor;
use muster_model::content::Checked;
use muster_model::embedding::{Embedding, EmbeddingMode, EmbeddingQuality};
use muster_model::graph::{GraphDelta, GraphRow};
use muster_model::header::{Header, Revision};
use muster_model::id::{FleetId, InstanceId, Modality, RobotId, TeamId};
use muster_model::remembered::RememberedTeams;
use muster_model::roster::{Presence, Roster, RosterEntry};
use muster_model::settings::AuditorSettings;
use muster_model::teams::{Member, Team, Teams};
use muster_model::time::Tick;
use muster_service::testkit::Bench;
use muster_wire::Message;

const START: Tick = Tick(1_795_208_980_000_000);
const DIMENSION: u32 = 8;

/// Robots that each robot receives.
const LINKS_EACH: usize = 8;

/// In how many places along the line the robots of a team are that far apart that one of them alone joins two parts.
const NARROW_EVERY: usize = 40;

struct Fleet {
    robots: Vec<RobotId>,
    teams: usize,
}

impl Fleet {
    fn new(robots: usize, teams: usize) -> Self {
        let robot = |number: usize| RobotId::new(format!("r{number:05}")).expect("an id");
        Self { robots: (0..robots).map(robot).collect(), teams }
    }

    fn team(&self, robot: usize) -> usize {
        robot * self.teams / self.robots.len()
    }

    /// Links to the next robots of the same team, but across a narrow place only from one to the next.
    fn graph(&self, epoch: u64) -> Message {
        let row = |from: usize| {
            let to = (from + 1..self.robots.len().min(from + 1 + LINKS_EACH)).filter(|to| {
                let is_narrow = from / NARROW_EVERY != to / NARROW_EVERY;
                self.team(from) == self.team(*to) && (!is_narrow || *to == from + 1)
            });
            let edges = to.map(|to| (u32::try_from(to).expect("few robots"), 1.0)).collect();
            GraphRow { source: u32::try_from(from).expect("few robots"), edges }
        };
        Message::Graph(Arc::new(GraphDelta {
            header: header(epoch),
            modality: Modality::connectivity(),
            base: None,
            nodes_added: (0..).zip(self.robots.iter().cloned()).collect(),
            nodes_removed: vec![],
            rows: (0..self.robots.len()).map(row).collect(),
        }))
    }

    fn roster(&self, epoch: u64, has_graph: bool) -> Message {
        let entry = |(node, robot): (u32, &RobotId)| RosterEntry {
            node,
            robot: robot.clone(),
            presence: Presence::Active,
            position: Some([f64::from(node), 0.0, 0.0]),
            heading: None,
            frame: None,
            superior: None,
            role: None,
            skills: vec![],
            last_seen: START,
        };
        let graph = (Modality::connectivity(), header(epoch).revision);
        let roster = Roster {
            header: header(epoch),
            robots: (0..).zip(&self.robots).map(entry).collect(),
            graphs: has_graph.then_some(graph).into_iter().collect(),
        };
        Message::Roster(Checked::new(roster).expect("a roster"))
    }

    fn embedding(&self, epoch: u64) -> Message {
        let value = |robot: usize, at: u32| {
            let near = if self.team(robot) as u32 % DIMENSION == at { 1.0 } else { 0.0 };
            near + 0.1 * ((robot * 31 + at as usize * 17) % 97) as f64 / 97.0
        };
        let robots = self.robots.len();
        Message::Embedding(Checked::new_unchecked(Embedding {
            header: header(epoch),
            roster: header(epoch).revision,
            graphs: vec![],
            robots: self.robots.clone(),
            dimension: DIMENSION,
            values: (0..robots)
                .flat_map(|robot| (0..DIMENSION).map(move |at| value(robot, at)))
                .collect(),
            without_embedding: vec![false; robots],
            provisional: vec![false; robots],
            centrality: vec![1.0; robots],
            quality: EmbeddingQuality {
                spectral_radius: (1.0, 1.0),
                alpha: 0.5,
                singular_values: vec![1.0],
                next_singular_value: 0.1,
                residual: 0.0,
                katz_residual: 0.0,
                gap: 0.9,
                ambiguous: false,
                mode: EmbeddingMode::InverseFree,
                teams_shown: None,
                team_scores: vec![],
                stage_us: [0; 3],
            },
        }))
    }

    fn division(&self, epoch: u64) -> Message {
        let team = |number: usize| {
            let rows = (0..self.robots.len()).filter(|robot| self.team(*robot) == number);
            let member = |row: usize| Member { robot: self.robots[row].clone(), margin: 0.5 };
            let members: Vec<Member> = rows.map(member).collect();
            let leader = members.first().expect("a robot in each team").robot.clone();
            let id = TeamId::numbered(number as u64 + 1);
            Team { id, members, leader, centroid: vec![0.0; DIMENSION as usize] }
        };
        let teams = Teams {
            header: header(epoch),
            embedding: header(epoch).revision,
            requested: u32::try_from(self.teams).expect("few teams"),
            considered: vec![],
            teams: (0..self.teams).map(team).collect(),
            unassigned: vec![],
            stale: vec![],
            inertia: 0.0,
            changes: vec![],
            next_team: self.teams as u64 + 1,
            limited: None,
            needs: vec![],
            provisional: vec![],
            held: vec![],
            remembered: RememberedTeams::default(),
        };
        Message::Teams { teams: Checked::new(teams).expect("a division"), mirror: false }
    }
}

fn header(epoch: u64) -> Header {
    Header {
        fleet: FleetId::new("f").expect("an id"),
        revision: Revision { term: 1_795_208_000, epoch },
        oldest: Some(START),
        newest: Some(START),
        stages: vec![],
    }
}

/// Seconds from a division to its audit, and how many losses that lists.
fn measure(fleet: &Fleet, has_graph: bool) -> (f64, usize) {
    let instance = InstanceId::new("i-1").expect("an id");
    let name = FleetId::new("f").expect("an id");
    let settings = AuditorSettings::default();
    let mut bench = Bench::<Auditor>::leading(name, instance, START, settings, vec![]);
    if has_graph {
        bench.receive(fleet.graph(1));
    }
    bench.receive(fleet.roster(1, has_graph));
    bench.receive(fleet.embedding(1));
    let division = fleet.division(1);
    let begun = Instant::now();
    bench.receive(division);
    let seconds = begun.elapsed().as_secs_f64();
    let mut audits = bench.published.iter().filter_map(|message| match message {
        Message::Audit(audit) => Some(audit.losses.len()),
        _ => None,
    });
    (seconds, audits.next_back().expect("an audit is published"))
}

fn main() {
    let is_quick = std::env::args().any(|argument| argument == "--quick");
    let (robots, teams) = if is_quick { (1_000, 5) } else { (10_000, 50) };
    let fleet = Fleet::new(robots, teams);
    let (without, _) = measure(&fleet, false);
    let (with, losses) = measure(&fleet, true);
    println!(
        "audit of {robots} robots in {teams} teams: {with:.3} s with the {losses} worst losses, \
         {without:.3} s without radio (goal of the losses: 1 s)"
    );
}

//! An operator who changes settings, asks again until the service has answered, and remembers what
//! was confirmed.

use std::collections::{BTreeMap, VecDeque};

use muster_model::id::ServiceName;
use muster_model::role::ReplicaState;
use muster_model::time::Tick;
use serde_json::Value;

use super::node::Node;
use super::oracle::{GroundTruth, RobotTruth};
use super::robots::Robots;
use super::router::{Answer, LinkId};

/// The field of refusals after which the same command is given again: the service starts.
const TRIED_AGAIN: &str = r#""field":"(command)""#;

/// The field of refusals after which it is given under another id: the clock of the service was set meanwhile.
const GIVEN_ANEW: &str = r#""field":"sent""#;

/// A command that is not answered yet.
#[derive(Debug)]
struct Wanted {
    number: u64,
    /// What it asks for: a patch of settings, or the key and the content of a wish.
    patch: String,
    /// When it was first sent, by the clock that was asked.
    sent: Option<Tick>,
}

/// What an operator wants and knows.
#[derive(Debug)]
pub(crate) struct Operator {
    pub(crate) link: LinkId,
    /// What it commands next.
    wanted: BTreeMap<ServiceName, VecDeque<Wanted>>,
    /// How many commands it has had.
    count: u64,
    /// How many teams the clusterer has confirmed, or has in its file.
    teams: Option<u32>,
    /// When the last change of that was sent. A later one by a clock that is behind may count as earlier: hosts whose clocks differ
    /// may lead one after the other, and know nothing of each other.
    teams_sent: Tick,
    /// How often a service has lost its disk.
    losses: BTreeMap<ServiceName, u32>,
    /// How often a service has refused, confirmed, or not answered.
    pub(crate) refused: u64,
    pub(crate) confirmed: u64,
}

impl Operator {
    pub(crate) fn new(link: LinkId, teams: Option<u64>) -> Self {
        let teams = teams.and_then(|teams| u32::try_from(teams).ok());
        let (wanted, losses) = (BTreeMap::new(), BTreeMap::new());
        let teams_sent = Tick::default();
        Self { link, wanted, count: 0, teams, teams_sent, losses, refused: 0, confirmed: 0 }
    }

    /// It wants to change settings by a patch, or a wish by its key and its content.
    pub(crate) fn wants(&mut self, service: ServiceName, patch: String) {
        self.count += 1;
        let wanted = Wanted { number: self.count, patch, sent: None };
        self.wanted.entry(service).or_default().push_back(wanted);
    }

    /// A service has lost its disk, and with it what was confirmed.
    pub(crate) fn forgets(&mut self, service: ServiceName) {
        *self.losses.entry(service).or_default() += 1;
        if service == ServiceName::Clusterer {
            self.teams = None;
        }
    }

    /// How often a service has lost its disk: what it confirmed to a get of before that may be lost as well.
    pub(crate) fn losses(&self, service: ServiceName) -> u32 {
        self.losses.get(&service).copied().unwrap_or_default()
    }

    /// The next command for each service: its number, and the patch. Until it is answered, it is the same one.
    pub(crate) fn next(&self) -> Vec<(ServiceName, u64, String)> {
        let first = |(service, wanted): (&ServiceName, &VecDeque<Wanted>)| {
            let first = wanted.front()?;
            Some((*service, first.number, first.patch.clone()))
        };
        self.wanted.iter().filter_map(first).collect()
    }

    /// The next command for a service is sent at a moment of the clock that it goes by.
    pub(crate) fn sends(&mut self, service: ServiceName, at: Tick) {
        let first = self.wanted.get_mut(&service).and_then(VecDeque::front_mut);
        first
            .into_iter()
            .for_each(|first| first.sent = Some(first.sent.map_or(at, |sent| sent.min(at))));
    }

    /// Whether something it wants is not answered yet.
    pub(crate) fn is_busy(&self) -> bool {
        self.wanted.values().any(|wanted| !wanted.is_empty())
    }

    /// A service has answered a get that was sent when it had lost its disk so often.
    pub(crate) fn answered(&mut self, service: ServiceName, losses: u32, answer: &Answer) {
        match answer {
            Answer::Error(error) if error.contains(TRIED_AGAIN) => return,
            Answer::Error(error) if error.contains(GIVEN_ANEW) => {
                self.count += 1;
                let first = self.wanted.get_mut(&service).and_then(VecDeque::front_mut);
                first.into_iter().for_each(|first| (first.number, first.sent) = (self.count, None));
                return;
            }
            Answer::Error(_) | Answer::Packets(_) => {}
        }
        let Some(done) = self.wanted.get_mut(&service).and_then(VecDeque::pop_front) else {
            return;
        };
        if matches!(answer, Answer::Error(_)) {
            self.refused += 1;
            return;
        }
        self.confirmed += 1;
        let patch: Option<Value> = serde_json::from_str(&done.patch).ok();
        let teams = patch.as_ref().and_then(|patch| patch.get("teams"));
        if service == ServiceName::Clusterer
            && let Some(teams) = teams
        {
            // A number that the clusterer chooses is not known, nor whether it was confirmed before the loss.
            let sent = done.sent.unwrap_or_default();
            let is_known = self.losses(service) == losses && sent >= self.teams_sent;
            self.teams_sent = self.teams_sent.max(sent);
            let teams = teams.as_u64().filter(|_| is_known);
            self.teams = teams.and_then(|teams| u32::try_from(teams).ok());
        }
    }

    /// What is true, and known without the bus.
    pub(crate) fn ground_truth<'a>(&self, robots: &'a Robots, nodes: &[Node]) -> GroundTruth<'a> {
        let runs = nodes.iter().filter(|node| node.process.is_some());
        let leads = |node: &&Node| {
            let process = node.process.as_ref();
            process.is_some_and(|process| process.host.replica_state() == ReplicaState::Leading)
        };
        let alive = robots.alive();
        let truth = |robot: usize| RobotTruth {
            position: robots.position(robot).unwrap_or_default(),
            superior: robots.superior(robot),
            within: 0.0,
        };
        GroundTruth {
            fleet: alive.iter().map(|(name, robot)| (*name, truth(*robot))).collect(),
            reports: alive
                .iter()
                .filter_map(|(name, robot)| {
                    Some((*name, robots.all.get(*robot)?.team_report.as_ref()))
                })
                .collect(),
            leading: runs.clone().filter(leads).map(Node::publisher).collect(),
            running: runs.map(Node::publisher).collect(),
            teams: self.teams,
        }
    }
}

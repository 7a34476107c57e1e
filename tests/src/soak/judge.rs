//! The promises, judged by what two observers receive: a console next to the router, and one behind the link of
//! some robots, who receives what they do.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use muster_model::header::{Header, Revision};
use muster_model::id::{FleetId, RobotId, ServiceName, TeamId};
use muster_model::teams::Teams;
use muster_model::time::Tick;
use muster_wire::{Key, KeySpace, Message, Packet, Source, robot_team};

use super::flood::is_garbage;
use crate::client::{Client, now};
use crate::simulation::oracle::{Ids, Judged, Oracle};

/// Most broken promises that are written down in one step: a wrong division is wrong ten times a second.
const MAX_BROKEN_PER_STEP: usize = 8;

/// Single messages under the key of another that a router may deliver after it hung, in one run. It is a fault of
/// Zenoh that services and the documents know.
const MAX_MISPLACED: u64 = 3;

/// The services whose work a division is.
const MADE_BY: [ServiceName; 3] =
    [ServiceName::Ingest, ServiceName::Embedder, ServiceName::Clusterer];

/// Why messages are wrong that contradict the division from before the faults.
const WRONG_TEAM: &str = "a robot is never told a wrong team";

/// Who receives.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Observer {
    /// A console next to the router.
    Console,
    /// A console behind the link of a group of robots.
    OnBoard,
}

/// What is asked of a division after a fault.
#[derive(Debug, Clone, Copy)]
struct Awaited {
    since: f64,
    division: Option<f64>,
    audit: Option<f64>,
}

/// Counts of messages.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Counts {
    /// Judged together with what they name.
    pub(super) whole: u64,
    /// Judged alone.
    pub(super) alone: u64,
    /// Below what was received before, so that readers drop them.
    pub(super) outdated: u64,
    /// A stranger's.
    pub(super) garbage: u64,
    /// Under the key of another.
    pub(super) misplaced: u64,
    /// Divisions.
    pub(super) divisions: u64,
}

/// The division that the console has.
#[derive(Debug, Clone, Default)]
pub(super) struct Division {
    /// The team of each robot, none for those without.
    pub(super) teams: BTreeMap<RobotId, Option<TeamId>>,
    /// When it arrived.
    pub(super) at: f64,
}

#[derive(Debug)]
struct State {
    space: KeySpace,
    oracle: Oracle,
    ids: Ids,
    known_ids: BTreeSet<TeamId>,
    next_team: u64,
    /// The robots of the fleet; others are strangers.
    robots: BTreeSet<RobotId>,
    /// Their teams, as soon as they are agreed on.
    wanted: Option<BTreeMap<RobotId, TeamId>>,
    accepted: Option<Revision>,
    division: Division,
    /// The robots that it says are stale, and when each stage published it.
    stale: Vec<String>,
    made: [f64; 3],
    longest_pause: f64,
    told: BTreeMap<(Observer, RobotId), (Revision, Option<TeamId>)>,
    awaited: Option<Awaited>,
    may_misplace: bool,
    broken: Vec<String>,
    counts: Counts,
}

/// Judges all that arrives.
#[derive(Debug, Clone)]
pub(super) struct Judge(Arc<Mutex<State>>);

/// When a service published the data of a message; 0 if it did not.
fn published(header: &Header, service: ServiceName) -> f64 {
    let stage = header.stages.iter().find(|stage| stage.stage == service);
    stage.map_or(0.0, |stage| stage.published.as_seconds())
}

/// Whether all of these services published it after a moment.
fn is_since(header: &Header, services: &[ServiceName], since: f64) -> bool {
    services.iter().all(|service| published(header, *service) > since)
}

impl Judge {
    /// A judge of a fleet with these robots.
    ///
    /// # Errors
    /// If the fleet's or a robot's name is none.
    pub(super) fn new(fleet: &str, robots: &[String]) -> anyhow::Result<Self> {
        let robots = robots.iter().map(RobotId::new).collect::<Result<_, _>>()?;
        Ok(Self(Arc::new(Mutex::new(State {
            space: KeySpace::new(FleetId::new(fleet)?),
            oracle: Oracle::default(),
            ids: Ids::default(),
            known_ids: BTreeSet::new(),
            next_team: 0,
            robots,
            wanted: None,
            accepted: None,
            division: Division::default(),
            stale: Vec::new(),
            made: [0.0; 3],
            longest_pause: 0.0,
            told: BTreeMap::new(),
            awaited: None,
            may_misplace: false,
            broken: Vec::new(),
            counts: Counts::default(),
        }))))
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Judges what a client receives from now on.
    ///
    /// # Errors
    /// If its session is closed.
    pub(super) async fn listen(&self, client: &Client, observer: Observer) -> anyhow::Result<()> {
        let tails: &[&str] = match observer {
            Observer::Console => &["**"],
            Observer::OnBoard => &["robot/*/team"],
        };
        for tail in tails {
            let judge = self.clone();
            client
                .listen_to_packets(tail, move |packet| judge.state().received(observer, &packet))
                .await?;
        }
        Ok(())
    }

    /// From now on, robots are to stay in the teams that they are in.
    pub(super) fn hold(&self) {
        let mut state = self.state();
        let teams = state.division.teams.clone();
        let own = teams.into_iter().filter(|(robot, _)| state.robots.contains(robot));
        state.wanted = Some(own.filter_map(|(robot, team)| Some((robot, team?))).collect());
    }

    /// No robot is to stay anywhere, until [`Judge::hold`].
    pub(super) fn release(&self) {
        self.state().wanted = None;
    }

    /// The division that the console has.
    pub(super) fn division(&self) -> Division {
        self.state().division.clone()
    }

    /// Where a robot was last.
    pub(super) fn place(&self, robot: &RobotId) -> [f64; 3] {
        let state = self.state();
        let roster = state.oracle.rosters.last();
        let entry = roster.and_then(|roster| {
            roster.robots.iter().find(|entry| entry.robot == *robot).and_then(|e| e.position)
        });
        entry.unwrap_or_default()
    }

    /// A step begins: pauses count from now. A router may hang in it, or not.
    pub(super) fn step_begins(&self, may_misplace: bool) {
        let mut state = self.state();
        state.longest_pause = 0.0;
        state.may_misplace |= may_misplace;
        state.awaited = None;
        state.division.at = now();
    }

    /// Fresh data are awaited: the division of all robots, and its audit, made of what was published after a moment.
    pub(super) fn await_fresh(&self, since: f64) {
        self.state().awaited = Some(Awaited { since, division: None, audit: None });
    }

    /// How long after that moment both had arrived, in seconds; none as long as they have not.
    pub(super) fn fresh_after_s(&self) -> Option<f64> {
        let awaited = self.state().awaited?;
        Some(awaited.division?.max(awaited.audit?) - awaited.since)
    }

    /// What of the awaited has not arrived, in words.
    pub(super) fn missing(&self) -> String {
        let state = self.state();
        let Some(awaited) = state.awaited else { return String::new() };
        let mut missing = Vec::new();
        if awaited.division.is_none() {
            let away =
                |robot: &&RobotId| !matches!(state.division.teams.get(*robot), Some(Some(_)));
            let away: Vec<String> =
                state.robots.iter().filter(away).map(ToString::to_string).collect();
            missing.push(format!(
                "no fresh division of all; without a team are [{}], stale are [{}], data were published {:?} s \
                 after the fault by ingest, embedder and clusterer",
                away.join(" "),
                state.stale.join(" "),
                state.made.map(|made| ((made - awaited.since) * 10.0).round() / 10.0),
            ));
        }
        if awaited.audit.is_none() {
            missing.push("no fresh audit".to_owned());
        }
        missing.join("; ")
    }

    /// The longest time without a division since the step began, in seconds.
    pub(super) fn longest_pause_s(&self) -> f64 {
        let state = self.state();
        state.longest_pause.max(now() - state.division.at)
    }

    /// The robots that an observer was told of last that they have no team or another one, and those that it was told
    /// nothing of.
    pub(super) fn told_wrong(&self) -> Vec<String> {
        let state = self.state();
        let mut wrong = Vec::new();
        for (robot, team) in state.wanted.iter().flatten() {
            for observer in [Observer::Console, Observer::OnBoard] {
                let told = state.told.get(&(observer, robot.clone())).map(|(_, team)| team);
                if told != Some(&Some(team.clone())) {
                    wrong.push(format!("{observer:?}: {robot} of {team} was told {told:?}"));
                }
            }
        }
        wrong
    }

    /// Hands over the broken promises.
    pub(super) fn take_broken(&self) -> Vec<String> {
        let mut state = self.state();
        let counts = state.counts;
        let mut broken = std::mem::take(&mut state.broken);
        if counts.misplaced > MAX_MISPLACED {
            broken.push(format!("{} messages came by the key of another", counts.misplaced));
        }
        let more = broken.len().saturating_sub(MAX_BROKEN_PER_STEP);
        broken.truncate(MAX_BROKEN_PER_STEP);
        if more > 0 {
            broken.push(format!("and {more} more"));
        }
        broken
    }

    /// How many messages there were.
    pub(super) fn counts(&self) -> Counts {
        self.state().counts
    }
}

impl State {
    fn breaks(&mut self, promise: &str, seen: impl std::fmt::Display) {
        self.broken.push(format!("{promise}: {seen}"));
    }

    fn received(&mut self, observer: Observer, packet: &Packet) {
        if packet.source != Source::Put {
            return;
        }
        if packet.payload.as_ref().is_ok_and(|payload| is_garbage(payload)) {
            self.counts.garbage += 1;
            return;
        }
        let moment = Tick(0).after(muster_model::time::seconds(now()));
        let message = match self.space.parse(&packet.key) {
            Ok(Key::RobotTeam(_)) => {
                robot_team::decode(&self.space, packet, moment).map(Message::RobotTeam)
            }
            Ok(
                Key::Graph(_)
                | Key::Roster
                | Key::Embedding
                | Key::Teams
                | Key::Audit
                | Key::Event
                | Key::Lease(_),
            ) => Message::decode(&self.space, packet),
            // Reports of robots, and the same in JSON.
            _ => return,
        };
        let message = match message {
            Ok(message) => message,
            Err(_) if self.may_misplace => {
                self.counts.misplaced += 1;
                return;
            }
            Err(rejection) => {
                let seen = format!("{observer:?} cannot read {}: {}", packet.key, rejection.reason);
                return self.breaks("what a service publishes, others understand", seen);
            }
        };
        match self.oracle.received(&message) {
            Ok(Judged::Whole) => self.counts.whole += 1,
            Ok(Judged::Alone) => self.counts.alone += 1,
            Err(breach) => self.breaks(breach.promise, breach.seen),
        }
        match &message {
            Message::Teams { teams, .. } => self.divided(teams),
            Message::RobotTeam(team) => {
                let key = (observer, team.robot.clone());
                let revision = team.header.revision;
                if self.told.get(&key).is_some_and(|(last, _)| revision < *last) {
                    self.counts.outdated += 1;
                    return;
                }
                self.told.insert(key, (revision, team.team.clone()));
                let wanted = self.wanted.as_ref().and_then(|all| all.get(&team.robot));
                if wanted.is_some_and(|wanted| team.team.as_ref() != Some(wanted)) {
                    let seen = format!(
                        "{observer:?}: {} of {wanted:?} is told {:?} at {revision:?}",
                        team.robot, team.team
                    );
                    self.breaks(WRONG_TEAM, seen);
                }
            }
            Message::Audit(audit) => {
                if let Some(awaited) = &mut self.awaited
                    && awaited.audit.is_none()
                    && is_since(&audit.header, &ServiceName::PIPELINE, awaited.since)
                {
                    awaited.audit = Some(now());
                }
            }
            _ => {}
        }
    }

    fn divided(&mut self, teams: &Teams) {
        let (revision, at) = (teams.header.revision, now());
        if self.accepted.is_some_and(|last| revision < last) {
            self.counts.outdated += 1;
            return;
        }
        self.accepted = Some(revision);
        self.counts.divisions += 1;
        self.longest_pause = self.longest_pause.max(at - self.division.at);
        let placed = teams.assignments().map(|(robot, team)| (robot.clone(), Some(team.clone())));
        let loose = teams.unassigned.iter().map(|robot| (robot.clone(), None));
        self.division = Division { teams: placed.chain(loose).collect(), at };
        self.check_ids(teams);
        if let Some(wanted) = &self.wanted {
            let is_moved = |(robot, team): &(&RobotId, &Option<TeamId>)| {
                wanted.get(*robot).is_some_and(|wanted| team.as_ref() != Some(wanted))
            };
            let moved: Vec<String> = self
                .division
                .teams
                .iter()
                .filter(is_moved)
                .map(|(robot, team)| format!("{robot} of {:?} in {team:?}", wanted.get(robot)))
                .collect();
            if !moved.is_empty() {
                let seen = format!("division {revision:?}: {}", moved.join(", "));
                self.breaks(WRONG_TEAM, seen);
            }
        }
        let is_whole = self.robots.iter().all(|robot| {
            matches!(self.division.teams.get(robot), Some(Some(_))) && !teams.stale.contains(robot)
        });
        self.stale = teams.stale.iter().map(ToString::to_string).collect();
        self.made = MADE_BY.map(|service| published(&teams.header, service));
        if let Some(awaited) = &mut self.awaited
            && awaited.division.is_none()
            && is_whole
            && is_since(&teams.header, &MADE_BY, awaited.since)
        {
            awaited.division = Some(at);
        }
    }

    /// No id is given to another team, and none that was used before is new again.
    fn check_ids(&mut self, teams: &Teams) {
        if let Err(breach) = self.ids.check(teams) {
            self.breaks(breach.promise, breach.seen);
        }
        for team in &teams.teams {
            let number = team.id.as_str().strip_prefix('t').and_then(|n| n.parse::<u64>().ok());
            let is_new = self.known_ids.insert(team.id.clone());
            if is_new && number.is_some_and(|number| number < self.next_team) {
                let seen = format!("{} is new, though {} was next", team.id, self.next_team);
                self.breaks("ids of teams are never used again", seen);
            }
        }
        self.next_team = self.next_team.max(teams.next_team);
    }
}

#[cfg(test)]
mod tests {
    use muster_model::content::Checked;
    use muster_model::header::StageTime;
    use muster_model::remembered::RememberedTeams;
    use muster_model::teams::{Member, Team};
    use muster_wire::packet::JSON;

    use super::*;

    fn robot(name: &str) -> RobotId {
        RobotId::new(name).unwrap()
    }

    /// A division that was made at a moment: each team with its number and its robots.
    fn divided(at: f64, epoch: u64, teams: &[(u64, &[&str])], next_team: u64) -> Teams {
        let moment = Tick(0).after(muster_model::time::seconds(at));
        let stage = |stage| StageTime { stage, received: moment, published: moment };
        let team = |(number, robots): &(u64, &[&str])| Team {
            id: TeamId::numbered(*number),
            members: robots.iter().map(|r| Member { robot: robot(r), margin: 0.5 }).collect(),
            leader: robot(robots[0]),
            centroid: vec![0.0],
        };
        Teams {
            header: Header {
                fleet: FleetId::new("soak").unwrap(),
                revision: Revision { term: 1, epoch },
                oldest: Some(moment),
                newest: Some(moment),
                stages: MADE_BY.map(stage).to_vec(),
            },
            embedding: Revision { term: 1, epoch },
            requested: 2,
            considered: Vec::new(),
            teams: teams.iter().map(team).collect(),
            unassigned: Vec::new(),
            stale: Vec::new(),
            inertia: 0.0,
            changes: Vec::new(),
            next_team,
            limited: None,
            needs: vec![],
            provisional: vec![],
            held: vec![],
            remembered: RememberedTeams::default(),
        }
    }

    fn receive(judge: &Judge, message: &Message) -> Vec<String> {
        let space = KeySpace::new(FleetId::new("soak").unwrap());
        for outbound in message.publish(Tick(0)).unwrap() {
            judge.state().received(Observer::Console, &outbound.into_packet(&space));
        }
        judge.take_broken()
    }

    fn publish(judge: &Judge, teams: Teams) -> Vec<String> {
        let teams = Checked::new(teams).unwrap();
        receive(judge, &Message::Teams { teams, mirror: true })
    }

    /// A judge of four robots in two teams, who has received one division.
    fn judge() -> Judge {
        let judge = Judge::new("soak", &["a", "b", "c", "d"].map(str::to_owned)).unwrap();
        let first = divided(10.0, 1, &[(1, &["a", "b"]), (2, &["c", "d"])], 3);
        assert_eq!(publish(&judge, first), [""; 0]);
        judge.hold();
        judge
    }

    fn only(broken: &[String], promise: &str) {
        assert!(
            broken.iter().all(|text| text.contains(promise)) && !broken.is_empty(),
            "{broken:?}"
        );
    }

    #[test]
    fn a_division_with_a_robot_in_another_team_is_wrong_unless_readers_drop_it() {
        let judge = judge();
        let wrong = |epoch| divided(11.0, epoch, &[(1, &["a"]), (2, &["b", "c", "d"])], 3);
        assert_eq!(publish(&judge, wrong(0)), [""; 0], "an outdated one");
        assert_eq!(judge.counts().outdated, 1);
        only(&publish(&judge, wrong(2)), WRONG_TEAM);
        // A stranger may be anywhere, and a robot may be missing for a while.
        let away = divided(12.0, 3, &[(1, &["a", "stranger-1"]), (2, &["c", "d"])], 3);
        assert_eq!(publish(&judge, away), [""; 0]);
    }

    #[test]
    fn a_robot_is_told_the_team_of_the_division_and_of_before() {
        let judge = judge();
        let division = divided(11.0, 2, &[(1, &["a", "b"]), (2, &["c", "d"])], 3);
        assert_eq!(publish(&judge, division.clone()), [""; 0]);
        let right = division.robot_team(&robot("a")).unwrap();
        assert_eq!(receive(&judge, &Message::RobotTeam(right.clone())), [""; 0]);
        let mut wrong = division.robot_team(&robot("c")).unwrap();
        (wrong.robot, wrong.members) = (robot("b"), Some(vec![robot("b"), robot("c")]));
        let broken = receive(&judge, &Message::RobotTeam(wrong));
        assert!(broken.iter().any(|text| text.contains(WRONG_TEAM)), "{broken:?}");
        assert!(broken.iter().any(|text| text.contains("team of the division")), "{broken:?}");
        // The other observer was told nothing.
        assert!(judge.told_wrong().iter().any(|text| text.starts_with("OnBoard: a")));
        assert!(!judge.told_wrong().iter().any(|text| text.starts_with("Console: a")));
    }

    #[test]
    fn ids_are_neither_given_to_others_nor_used_again() {
        let judge = judge();
        judge.release();
        let without = divided(11.0, 2, &[(1, &["a", "b"])], 7);
        assert_eq!(publish(&judge, without), [""; 0]);
        let other = divided(12.0, 3, &[(1, &["a", "b"]), (2, &["x", "y"])], 7);
        only(&publish(&judge, other), "no id of a team is given to another team");
        let again = divided(13.0, 4, &[(1, &["a", "b"]), (5, &["p", "q"])], 7);
        only(&publish(&judge, again), "ids of teams are never used again");
        let new = divided(14.0, 5, &[(1, &["a", "b"]), (7, &["p", "q"])], 8);
        assert_eq!(publish(&judge, new), [""; 0]);
    }

    #[test]
    fn fresh_is_what_is_whole_and_was_made_since() {
        let judge = judge();
        let since = now() - 1.0;
        judge.step_begins(false);
        judge.await_fresh(since);
        let both: [(u64, &[&str]); 2] = [(1, &["a", "b"]), (2, &["c", "d"])];
        publish(&judge, divided(since - 1.0, 2, &both, 3));
        publish(&judge, divided(since + 0.5, 3, &[(1, &["a", "b"]), (2, &["c"])], 3));
        assert!(judge.state().awaited.unwrap().division.is_none());
        publish(&judge, divided(since + 0.5, 4, &both, 3));
        assert!(judge.state().awaited.unwrap().division.is_some());
        // Its audit is still missing.
        assert_eq!(judge.fresh_after_s(), None);
    }

    #[test]
    fn garbage_is_ignored_and_what_cannot_be_read_is_not() {
        let judge = judge();
        let put = |payload: &[u8]| {
            let packet = Packet::put("muster/v1/soak/teams", JSON, payload);
            judge.state().received(Observer::Console, &packet);
            judge.take_broken()
        };
        assert_eq!(put(b"{}~garbage~"), [""; 0]);
        only(&put(b"{}"), "others understand");
        judge.step_begins(true);
        assert_eq!(put(b"{}"), [""; 0], "after a router hung");
        assert_eq!((judge.counts().garbage, judge.counts().misplaced), (1, 1));
    }
}

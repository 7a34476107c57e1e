//! What must hold at every moment, checked from outside by what crosses the bus.
//!
//! The oracle sees every message that a service publishes, as it decodes from its bytes, and knows the
//! truth about the fleet. Its rules are written a second time from the promises of the README, plainly and
//! slowly, and share no code with what they check but the types of the messages.

mod agreement;
mod alerts;
pub(crate) mod bridged;
mod changes;
mod division;
mod finite;
mod ids;
mod limits;
mod memory;
mod needs;
mod order;
mod proposals;
mod received;
mod recorded;
#[cfg(test)]
mod samples;
mod silhouettes;
pub(crate) mod viewed;

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

use muster_model::audit::Audit;
use muster_model::command::CommandOutcome;
use muster_model::content::Checked;
use muster_model::embedding::Embedding;
use muster_model::graph::GraphDelta;
use muster_model::header::Revision;
use muster_model::id::{CommandId, OperatorId, RobotId, ServiceName, SkillId, TeamId};
use muster_model::roster::Roster;
use muster_model::teams::{Member, Teams};
use muster_wire::Message;
use muster_wire::envelope::AnnouncedSettings;

use super::clock::Micros;
use super::plan::OutputKind;

pub(crate) use agreement::{Agreed, GroundTruth, RobotTruth};
pub(crate) use alerts::ALERTED_WITHIN;
pub(crate) use ids::Ids;
pub(crate) use memory::{Bounds, MEMORY, check_memory_use};
pub(crate) use received::Judged;

/// How many messages of each kind the oracle remembers: more than a minute of frames, longer than
/// anything that names an older one is under way.
const MAX_REMEMBERED_MESSAGES: usize = 2048;

/// The result of a rule: nothing, or what is wrong.
pub(crate) type Verified = Result<(), Breach>;

/// A broken promise.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Breach {
    /// Which promise.
    pub(crate) promise: &'static str,
    /// What was seen.
    pub(crate) seen: String,
}

/// A breach of a promise.
pub(crate) fn breach<T>(promise: &'static str, seen: impl Into<String>) -> Result<T, Breach> {
    Err(Breach { promise, seen: seen.into() })
}

/// One process of one instance of a service.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Publisher {
    /// Its service.
    pub(crate) service: ServiceName,
    /// Its instance.
    pub(crate) instance: usize,
    /// Counts the processes of that instance.
    pub(crate) process: u32,
}

/// The division that was published last, and what it was made of.
#[derive(Debug)]
struct Divided {
    publisher: Publisher,
    settings: u32,
    teams: Checked<Teams>,
    /// The robots that have changed teams since the vectors, the settings and the number of teams did.
    moved: BTreeSet<RobotId>,
    /// Whether there have been other teams since the vectors and the settings changed.
    renamed: bool,
    /// The teams of the division before of which all robots were stale: no robot fills their needs.
    silent: BTreeSet<TeamId>,
    /// When it was published.
    published: Micros,
}

impl Divided {
    /// What goes on from its own last division: a process in one term, under unchanged settings.
    fn leadership(&self) -> (Publisher, u64, u32) {
        (self.publisher, self.teams.header.revision.term, self.settings)
    }
}

/// The teams of which all robots are stale.
fn silent(teams: &Teams) -> BTreeSet<TeamId> {
    let is_stale = |member: &Member| teams.stale.contains(&member.robot);
    let silent = teams.teams.iter().filter(|team| team.members.iter().all(is_stale));
    silent.map(|team| team.id.clone()).collect()
}

/// What has been published, by revision. Two leaders may give the same one.
#[derive(Debug)]
pub(crate) struct Published<T> {
    all: BTreeMap<Revision, Vec<T>>,
    order: VecDeque<Revision>,
}

impl<T> Default for Published<T> {
    fn default() -> Self {
        Self { all: BTreeMap::new(), order: VecDeque::new() }
    }
}

impl<T: Clone> Published<T> {
    fn add(&mut self, revision: Revision, content: &T) {
        self.all.entry(revision).or_default().push(content.clone());
        self.order.push_back(revision);
        if self.order.len() > MAX_REMEMBERED_MESSAGES
            && let Some(oldest) = self.order.pop_front()
        {
            self.all.remove(&oldest);
        }
    }

    /// Remembers what a get was answered with: a suspect answers, and publishes nothing.
    fn know(&mut self, revision: Revision, content: &T) {
        self.all.entry(revision).or_insert_with(|| vec![content.clone()]);
    }

    /// Everything that was published under a revision.
    pub(crate) fn named(&self, revision: Revision) -> &[T] {
        self.all.get(&revision).map_or(&[], Vec::as_slice)
    }

    /// Whether something that was published under a revision may be forgotten by now.
    fn has_forgotten(&self, revision: Revision) -> bool {
        self.order.len() >= MAX_REMEMBERED_MESSAGES
            && self.order.front().is_some_and(|oldest| revision <= *oldest)
    }

    /// Everything, the newest first.
    fn newest_first(&self) -> impl Iterator<Item = &T> {
        self.order.iter().rev().filter_map(|revision| self.all.get(revision)).flatten()
    }

    /// What was published last.
    pub(crate) fn last(&self) -> Option<&T> {
        self.all.get(self.order.back()?)?.last()
    }
}

/// What the oracle knows.
#[derive(Debug, Default)]
pub(crate) struct Oracle {
    pub(crate) rosters: Published<Checked<Roster>>,
    pub(crate) embeddings: Published<Checked<Embedding>>,
    pub(crate) divisions: Published<Checked<Teams>>,
    pub(crate) audits: Published<Arc<Audit>>,
    pub(crate) order: order::Order,
    /// Which process of a service last published its output.
    last_by: BTreeMap<ServiceName, Publisher>,
    divided: Option<Divided>,
    /// The ids of teams, where one instance of the clusterer gives them all. Of two, the one that is cut off
    /// may give some that nobody hears of.
    ids: Option<Ids>,
    pub(crate) alerts: alerts::AlertLog,
    changes: changes::Changes,
    /// The commands that each process has carried out.
    carried_out: BTreeMap<(Publisher, OperatorId, CommandId), CommandOutcome>,
    /// Whether limits of teams hold.
    limits: limits::Limits,
    /// Whether their needs are filled.
    needs: needs::NeedLog,
    /// What historians have recorded.
    pub(crate) recorded: recorded::Recorded,
    /// What planners have answered.
    proposals: proposals::ProposalLog,
    graph: Option<Arc<GraphDelta>>,
    settings: Option<Box<AnnouncedSettings>>,
    had_forged_terms: bool,
    /// When a team last ended.
    team_ended: Option<Micros>,
    /// When a roster last said otherwise than the one before which robot has which skills.
    skills_changed: Option<Micros>,
}

impl Oracle {
    /// An instance has lost its disk: it cannot know the terms that it held.
    pub(crate) fn forget_order(&mut self, service: ServiceName, instance: usize) {
        self.order.forget(service, instance);
        if service == ServiceName::Clusterer {
            self.forget_ids();
        }
    }

    /// All services have ended at once.
    pub(crate) fn all_ended(&mut self) {
        self.alerts.all_ended();
    }

    /// All instances have lost their disks at once: nobody can know which ids were given, whatever their clocks
    /// say.
    pub(crate) fn forget_ids(&mut self) {
        if let Some(ids) = &mut self.ids {
            ids.forget();
        }
    }

    /// Every id of a team comes from one instance of the clusterer.
    pub(crate) fn one_gives_ids(&mut self) {
        self.ids = Some(Ids::default());
    }

    /// An attacker has forged a term: terms no longer follow from clocks and restarts.
    pub(crate) fn terms_forged(&mut self) {
        self.had_forged_terms = true;
    }

    /// Whether an attacker has forged a term.
    pub(crate) fn had_forged_terms(&self) -> bool {
        self.had_forged_terms
    }

    /// The last message of a kind.
    pub(crate) fn last_on(&self, what: OutputKind) -> Option<Message> {
        match what {
            OutputKind::Roster => self.rosters.last().cloned().map(Message::Roster),
            OutputKind::Graph => self.graph.clone().map(Message::Graph),
            OutputKind::Embedding => self.embeddings.last().cloned().map(Message::Embedding),
            OutputKind::Teams => {
                let teams = self.divisions.last().cloned()?;
                Some(Message::Teams { teams, mirror: false })
            }
            OutputKind::Audit => self.audits.last().cloned().map(Message::Audit),
            OutputKind::Settings => self.settings.clone().map(Message::Settings),
        }
    }

    /// An attacker puts a whole message of a service. It is there for others to name, like any other, unless its term is one
    /// that no reader believes.
    pub(crate) fn forged(&mut self, message: &Message, now: Micros) {
        if message.header().is_some_and(|header| header.revision.term > order::highest_term(now)) {
            return;
        }
        match message {
            Message::Roster(roster) => self.rosters.add(roster.header.revision, roster),
            Message::Embedding(embedding) => {
                self.embeddings.add(embedding.header.revision, embedding);
            }
            Message::Teams { teams, .. } => self.divisions.add(teams.header.revision, teams),
            Message::Audit(audit) => self.audits.know(audit.header.revision, audit),
            _ => {}
        }
    }

    /// Judges what a service answers a get with, which must be as right as what is published.
    pub(crate) fn answered(&mut self, message: &Message) -> Verified {
        finite::check(message)?;
        match message {
            Message::Roster(roster) => {
                division::check_roster(roster)?;
                self.rosters.know(roster.header.revision, roster);
            }
            Message::Embedding(embedding) => {
                self.embeddings.know(embedding.header.revision, embedding);
            }
            Message::Teams { teams, .. } => {
                division::check_division(teams, &self.embeddings)?;
                self.divisions.know(teams.header.revision, teams);
            }
            Message::Audit(audit) => {
                silhouettes::check(audit, self)?;
                self.audits.know(audit.header.revision, audit);
            }
            _ => {}
        }
        Ok(())
    }

    /// Judges one answer of a planner.
    pub(crate) fn proposed(
        &mut self,
        now: Micros,
        publisher: Publisher,
        messages: &[Message],
    ) -> Verified {
        self.proposals.check(now, publisher, messages, &self.divisions)
    }

    /// A process carries a command out once, however often it arrives.
    fn check_outcome(&mut self, publisher: Publisher, outcome: &CommandOutcome) -> Verified {
        let is_known = |((_, operator, id), known): (&(Publisher, _, _), &CommandOutcome)| {
            (operator, id) == (&outcome.operator, &outcome.id) && known == outcome
        };
        // Said again, by whichever process, it is the same to the time at which it was carried out.
        if self.carried_out.iter().any(is_known) {
            return Ok(());
        }
        let name = (publisher, outcome.operator.clone(), outcome.id.clone());
        if self.carried_out.insert(name, outcome.clone()).is_none() {
            return Ok(());
        }
        breach(
            "a command is carried out once",
            format!("{publisher:?} has carried out {}/{} twice", outcome.operator, outcome.id),
        )
    }

    /// Judges what a service publishes. `settings` counts the changes of its settings that the
    /// process had announced before it began what it publishes.
    pub(crate) fn published(
        &mut self,
        now: Micros,
        publisher: Publisher,
        settings: u32,
        message: &Message,
    ) -> Verified {
        let service = publisher.service;
        finite::check(message)?;
        proposals::check_published(publisher, message)?;
        self.order.check(now, publisher, message)?;
        // A new leader publishes the lists of wishes and of alerts that it goes on with before anything of its own.
        if matches!(
            message,
            Message::Roster(_)
                | Message::Graph(_)
                | Message::Embedding(_)
                | Message::Teams { .. }
                | Message::Audit(_)
        ) {
            self.last_by.insert(service, publisher);
        }
        match message {
            Message::Roster(roster) => {
                division::check_roster(roster)?;
                let skills = |roster: &Checked<Roster>| -> BTreeSet<(RobotId, Vec<SkillId>)> {
                    let able = roster.robots.iter().filter(|entry| !entry.skills.is_empty());
                    able.map(|entry| (entry.robot.clone(), entry.skills.clone())).collect()
                };
                if self.rosters.last().is_none_or(|last| skills(last) != skills(roster)) {
                    self.skills_changed = Some(now);
                }
                self.rosters.add(roster.header.revision, roster);
            }
            Message::Embedding(embedding) => {
                division::check_embedding(embedding, &self.rosters)?;
                self.embeddings.add(embedding.header.revision, embedding);
            }
            Message::Teams { teams, .. } => {
                division::check_division(teams, &self.embeddings)?;
                if let Some(ids) = &mut self.ids {
                    ids.check(teams)?;
                }
                let (moved, renamed) = (BTreeSet::new(), false);
                let teams_now = teams.clone();
                let before = self.divisions.last();
                let has = |id: &TeamId| teams.teams.iter().any(|team| team.id == *id);
                if before.is_some_and(|before| before.teams.iter().any(|team| !has(&team.id))) {
                    self.team_ended = Some(now);
                }
                let silent = before.map(|before| silent(before)).unwrap_or_default();
                let published = now;
                let divided = Divided {
                    publisher,
                    settings,
                    teams: teams_now,
                    moved,
                    renamed,
                    silent,
                    published,
                };
                if let Some(before) = self.divided.replace(divided) {
                    self.check_same_again(before)?;
                }
                // The next division grants a wish that this one could not.
                let last = self.divisions.last();
                if last.is_some_and(|last| self.limits.wish_begins_to_count(last, teams)) {
                    self.divided = None;
                }
                self.changes.divided(publisher, teams);
                self.alerts.divided(now, teams);
                self.limits.check(publisher, teams)?;
                self.needs.check(now, publisher, teams, &self.rosters)?;
                self.divisions.add(teams.header.revision, teams);
            }
            Message::Graph(delta) => self.graph = Some(Arc::clone(delta)),
            Message::Wishes(list) => {
                let are_others = self.limits.wished(publisher, list);
                // The next division is one under other wishes.
                self.divided.take_if(|_| are_others);
            }
            Message::Outcome(outcome) => self.check_outcome(publisher, outcome)?,
            Message::Event(event) if service == ServiceName::Clusterer => {
                self.limits.reported(publisher, &event.kind);
                self.changes.reported(publisher, &event.kind, &self.divisions)?;
            }
            Message::Settings(announced) if service == ServiceName::Clusterer => {
                self.limits.announced(publisher, announced);
                self.settings = Some(announced.clone());
            }
            Message::RobotTeam(team) => division::check_robot_team(team, &self.divisions)?,
            Message::Audit(audit) => {
                silhouettes::check(audit, self)?;
                self.audits.add(audit.header.revision, audit);
            }
            Message::Alerts(alerts) => self.alerts.check_list(publisher, alerts)?,
            Message::Event(event) => self.alerts.check_event(publisher, event)?,
            _ => {}
        }
        Ok(())
    }
}

//! After the last fault, all agree with the truth and with each other in the end; and what was agreed on
//! does not change while nothing changes.

use std::collections::{BTreeMap, BTreeSet};

use muster_model::content::Checked;
use muster_model::embedding::Embedding;
use muster_model::header::Revision;
use muster_model::id::{RobotId, ServiceName, TeamId};
use muster_model::roster::Presence;
use muster_model::teams::Teams;
use muster_wire::Message;

use super::super::clock::{Micros, SECOND};
use super::super::robots::TeamReport;
use super::Publisher;
use super::{Divided, Oracle, Published, Verified, breach, silhouettes};

/// What is promised of a fleet in which nothing changes.
const UNCHANGED: &str = "unchanged input leaves the teams unchanged";

/// How long a roster may be on its way into a division: over slow links, while a slow job runs.
const ROSTER_TIME: Micros = 4 * SECOND;

/// What is true of one robot.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct RobotTruth {
    pub(crate) position: [f64; 3],
    pub(crate) superior: Option<RobotId>,
    /// How far off its position may be, in metres, along each axis: what is moved from frame to frame is rounded.
    pub(crate) within: f64,
}

impl RobotTruth {
    fn is_at(&self, position: Option<[f64; 3]>) -> bool {
        let is_near = |(own, other): (&f64, &f64)| (own - other).abs() <= self.within;
        position.is_some_and(|position| self.position.iter().zip(&position).all(is_near))
    }
}

/// What is known of the world without the bus.
#[derive(Debug)]
pub(crate) struct GroundTruth<'a> {
    /// The robots that live.
    pub(crate) fleet: BTreeMap<&'a RobotId, RobotTruth>,
    /// What each of them has received of its team.
    pub(crate) reports: BTreeMap<&'a RobotId, Option<&'a TeamReport>>,
    /// The processes of services that run.
    pub(crate) running: BTreeSet<Publisher>,
    /// Those of them that lead.
    pub(crate) leading: BTreeSet<Publisher>,
    /// How many teams an operator was last confirmed to have asked for, if that is known.
    pub(crate) teams: Option<u32>,
}

/// What all have agreed on.
#[derive(Debug, Clone)]
pub(crate) struct Agreed {
    /// None if the fleet never had a robot.
    division: Option<Checked<Teams>>,
}

impl Agreed {
    /// Whether there were robots to divide.
    pub(crate) fn has_robots(&self) -> bool {
        self.division.is_some()
    }

    /// Whether there are fewer teams than were asked for, so that seats may be kept for teams that are absent: they end.
    pub(crate) fn has_free_seats(&self) -> bool {
        self.division.as_ref().is_some_and(|teams| teams.requested as usize > teams.teams.len())
    }

    /// Whether a team that ended as its robots left is still awaited: it may be forgotten while another one is away, and the others
    /// are divided by the evidence then.
    fn awaits_team(&self) -> bool {
        let Some(Teams { remembered, .. }) = self.division.as_deref() else { return false };
        remembered.ended.iter().any(|(team, members)| {
            let left = remembered.last.iter().filter(|(_, last)| last == team).count();
            left * 2 > members.len()
        })
    }

    /// Whether robots stay in their teams only for as long as a team is absent, as the division says.
    pub(crate) fn holds_moves(&self) -> bool {
        self.division.as_ref().is_some_and(|teams| !teams.held.is_empty())
    }

    /// Whether robots are about to move: other teams are shown for them, and none is away that they could wait for.
    pub(crate) fn has_moves_under_way(&self) -> bool {
        let is_none_away = |teams: &Checked<Teams>| teams.remembered.last.is_empty();
        self.holds_moves() && self.division.as_ref().is_some_and(is_none_away)
    }

    /// Whether another division differs only in moves that this one says are held back.
    fn announces(&self, now: &Teams) -> bool {
        let Some(before) = &self.division else { return false };
        let held = |robot: &RobotId| before.held.iter().find(|held| held.robot == *robot);
        let now_in: BTreeMap<&RobotId, &TeamId> = now.assignments().collect();
        now_in.len() == before.assignments().count()
            && before.unassigned == now.unassigned
            && before.assignments().all(|(robot, team)| {
                let now = now_in.get(robot).copied();
                now == Some(team) || now.is_some() && now == held(robot).map(|held| &held.team)
            })
    }

    /// The teams, if there were robots.
    pub(crate) fn division(&self) -> Option<&Teams> {
        self.division.as_deref()
    }

    /// No robot of a division is in another team than it was, as is promised; of those that may be in none, as `may_be_loose`
    /// says, none is in another.
    pub(crate) fn stands(
        &self,
        now: &Teams,
        may_be_loose: impl Fn(&RobotId) -> bool,
        promise: &'static str,
    ) -> Verified {
        let Some(before) = &self.division else { return Ok(()) };
        let teams: BTreeMap<&RobotId, &TeamId> = before.assignments().collect();
        let mut loose = now.unassigned.iter().filter(|robot| !may_be_loose(robot));
        let loose = loose.find(|robot| teams.contains_key(robot));
        let elsewhere = now
            .assignments()
            .find(|(robot, team)| teams.get(robot).is_some_and(|before| before != team))
            .map(|(robot, _)| robot);
        match loose.or(elsewhere) {
            None => Ok(()),
            Some(robot) => breach(
                promise,
                format!("{robot} was elsewhere in {:?}, now {:?}", short(before), short(now)),
            ),
        }
    }
}

impl Oracle {
    /// Whether all agree now; if not, on what they differ.
    pub(crate) fn agreement(&self, ground_truth: &GroundTruth<'_>) -> Result<Agreed, String> {
        let roster = self.rosters.last().ok_or("there is no roster")?;
        let known = roster.robots.iter().map(|entry| &entry.robot);
        if !known.clone().eq(ground_truth.fleet.keys().copied()) {
            let (known, living) = (known.collect::<Vec<_>>(), ground_truth.fleet.keys());
            return Err(format!("the roster has {known:?}, alive are {living:?}"));
        }
        for (entry, truth) in roster.robots.iter().zip(ground_truth.fleet.values()) {
            if entry.presence != Presence::Active {
                return Err(format!("{} lives and is stale in the roster", entry.robot));
            }
            if !truth.is_at(entry.position) || entry.superior != truth.superior {
                return Err(format!(
                    "{} is at {:?} under {:?}, in the roster at {:?} under {:?}",
                    entry.robot, truth.position, truth.superior, entry.position, entry.superior
                ));
            }
        }
        if roster.robots.is_empty() {
            return self.without_robots(ground_truth);
        }
        // What was right when a leader died may be right still, and is not known to the next one.
        for service in ServiceName::PIPELINE {
            let last = self.last_by.get(&service);
            if !last.is_some_and(|publisher| ground_truth.leading.contains(publisher)) {
                return Err(format!("the leader of {service} has published nothing yet"));
            }
        }
        let embedding = self.embeddings.last().ok_or("there is no embedding")?;
        let graphs = embedding.graphs.iter().map(|graph| (&graph.modality, &graph.revision));
        if !known.eq(&embedding.robots) || !graphs.eq(roster.graphs.iter().map(|(n, at)| (n, at))) {
            return Err(format!("the embedding is not that of the roster: {:?}", embedding.graphs));
        }
        let teams = self.divisions.last().ok_or("there is no division")?;
        let divided = self.embeddings.named(teams.embedding);
        if !divided.iter().any(|other| same_vectors(other, embedding)) {
            return Err("the division is not that of the last embedding".to_owned());
        }
        if let Some(wanted) = ground_truth.teams.filter(|wanted| *wanted != teams.requested) {
            return Err(format!(
                "{wanted} teams were confirmed, {} are asked for",
                teams.requested
            ));
        }
        if let Some(need) = super::needs::lacking(teams).first() {
            return Err(format!("{need:?} is not filled, and the division says nothing of it"));
        }
        if !teams.stale.is_empty() {
            return Err(format!("the division lists {:?} as stale", teams.stale));
        }
        let audit = self.audits.last().ok_or("there is no audit")?;
        let audited = self.divisions.named(audit.teams);
        if !audited.iter().any(|other| same_division(other, teams))
            || !self.embeddings.named(audit.embedding).iter().any(|e| same_vectors(e, embedding))
        {
            return Err("the audit is not that of the division".to_owned());
        }
        if !silhouettes::is_of_positions(audit, teams, roster) {
            return Err("the audit is not that of the positions in the roster".to_owned());
        }
        self.check_reports(teams, ground_truth)?;
        Ok(Agreed { division: Some(teams.clone()) })
    }

    /// A console that joins late receives what was published last when it asked, or something newer, and
    /// nothing that was never published.
    pub(crate) fn joined_late(&self, last: &Message, received: &[Message]) -> Verified {
        let revision = |message: &Message| message.header().map(|header| header.revision);
        let newest = received.iter().max_by_key(|message| revision(message));
        let right = newest.is_some_and(|newest| revision(newest) >= revision(last))
            && received.iter().all(|message| self.was_published(message));
        if right {
            return Ok(());
        }
        breach(
            "a console that joins late receives what was published last",
            format!("{:?} was published last, and received {received:?}", last.header()),
        )
    }

    fn was_published(&self, message: &Message) -> bool {
        fn among<T: Clone + PartialEq>(
            published: &Published<T>,
            revision: Revision,
            other: &T,
        ) -> bool {
            published.named(revision).iter().any(|published| published == other)
        }
        match message {
            Message::Roster(roster) => among(&self.rosters, roster.header.revision, roster),
            Message::Teams { teams, .. } => among(&self.divisions, teams.header.revision, teams),
            Message::Audit(audit) => among(&self.audits, audit.header.revision, audit),
            _ => false,
        }
    }

    /// Where no robot lives, no service that runs may still publish robots. If it was killed together with
    /// all that remembered its output, it need not publish an empty one.
    /// Whether the instance of a service that published last runs still, and answers for it.
    pub(crate) fn last_runs(&self, service: ServiceName, ground_truth: &GroundTruth<'_>) -> bool {
        let last = self.last_by.get(&service);
        last.is_some_and(|publisher| ground_truth.running.contains(publisher))
    }

    fn without_robots(&self, ground_truth: &GroundTruth<'_>) -> Result<Agreed, String> {
        let runs = |service: ServiceName| self.last_runs(service, ground_truth);
        let embedded = self.embeddings.last().is_some_and(|last| !last.robots.is_empty());
        let divided = self.divisions.last();
        let divided =
            divided.is_some_and(|last| !last.teams.is_empty() || !last.unassigned.is_empty());
        if runs(ServiceName::Embedder) && embedded || runs(ServiceName::Clusterer) && divided {
            return Err("robots that have left are still embedded or divided".to_owned());
        }
        Ok(Agreed { division: None })
    }

    fn check_reports(&self, teams: &Teams, ground_truth: &GroundTruth<'_>) -> Result<(), String> {
        for (robot, report) in &ground_truth.reports {
            let team = teams
                .teams
                .iter()
                .find(|team| team.members.iter().any(|member| member.robot == **robot));
            let report = report.ok_or_else(|| format!("{robot} has received no team"))?;
            let right = match team {
                None => report.team.is_none(),
                Some(team) => {
                    let names: Vec<_> = team.members.iter().map(|m| m.robot.as_str()).collect();
                    report.team.as_deref() == Some(team.id.as_str())
                        && report.leader.as_deref() == Some(team.leader.as_str())
                        && report.members.as_ref().is_some_and(|members| members.iter().eq(&names))
                }
            };
            if !right {
                return Err(format!(
                    "{robot} has received {report:?}, in the division it is in {team:?}"
                ));
            }
        }
        Ok(())
    }

    /// The same leader divides the same vectors under the same settings as it did just before: what it held back for a
    /// while may follow, and nothing else: another number of teams, and the division of robots that stayed in their last team
    /// because a team had returned. So there are other teams once at most, and between the same teams each robot moves once at
    /// most; and once more each time that an absent team is forgotten, which makes room. Robots without a team keep to that.
    pub(super) fn check_same_again(&mut self, mut before: Divided) -> Verified {
        let Some(now) = &self.divided else { return Ok(()) };
        let same_vectors = || {
            let (old, new) = (before.teams.embedding, now.teams.embedding);
            let (old, new) = (self.embeddings.named(old), self.embeddings.named(new));
            // Where two leaders gave one revision, it is not known which of the two was divided.
            matches!((old, new), ([old], [new]) if same_vectors(old, new))
        };
        if before.leadership() != now.leadership() || !same_vectors() {
            return Ok(());
        }
        // Who can fill needs depends on the roster as well.
        let able = |teams: &Teams| (teams.stale.clone(), teams.needs.clone());
        let has_needs = !before.teams.needs.is_empty() || !now.teams.needs.is_empty();
        let skills_from = before.published.saturating_sub(ROSTER_TIME);
        let has_new_skills = self.skills_changed.is_some_and(|at| at >= skills_from);
        let may_fill_others = has_new_skills
            || able(&before.teams) != able(&now.teams)
            || before.silent != now.silent;
        if has_needs && may_fill_others {
            return Ok(());
        }
        if has_forgotten_team(&before.teams, &now.teams) {
            before.moved.clear();
            before.renamed = false;
        }
        let moved = moved(&before.teams, &now.teams);
        let ids =
            |teams: &Teams| teams.teams.iter().map(|team| team.id.clone()).collect::<Vec<_>>();
        let same_ids = ids(&before.teams) == ids(&now.teams);
        let follows = if same_ids { moved.is_disjoint(&before.moved) } else { !before.renamed };
        if !follows || before.teams.unassigned != now.teams.unassigned {
            return breach(
                UNCHANGED,
                format!("{:?}, and from the same {:?}", short(&before.teams), short(&now.teams)),
            );
        }
        if let Some(now) = &mut self.divided {
            now.renamed = before.renamed || !same_ids;
            if same_ids {
                now.moved = &before.moved | &moved;
            }
        }
        Ok(())
    }

    /// Whether an outage leaves the division as all have agreed on it. Where something is asked of a team that there
    /// may be only later, the number of that team may be another one after it.
    pub(crate) fn is_to_stand(&self, agreed: &Agreed) -> bool {
        agreed.division.as_ref().is_some_and(|teams| !self.limits.name_team_to_come(teams))
    }

    /// Whether the loss of a team is to move no other robot: nothing is asked of teams, and no other one is absent.
    pub(crate) fn loss_moves_no_other(&self, agreed: &Agreed) -> bool {
        self.limits.are_none()
            && !agreed.has_free_seats()
            && !agreed.awaits_team()
            && !agreed.holds_moves()
    }

    /// Whether the last division differs from the one that all had agreed on only in moves that waited for an absent team.
    pub(crate) fn has_only_released(&self, agreed: &Agreed) -> bool {
        self.divisions.last().is_some_and(|last| agreed.announces(last))
    }

    /// Whether nothing relates a robot to others in the embedding that a division names.
    pub(crate) fn is_unrelated(&self, teams: &Teams, robot: &RobotId) -> bool {
        self.embeddings.named(teams.embedding).iter().any(|embedding| {
            let row = embedding.robots.binary_search(robot).ok();
            row.is_some_and(|row| embedding.without_embedding.get(row) == Some(&true))
        })
    }

    /// Whether the place of a team may have been filled since it ended, which is that long ago at most.
    pub(crate) fn has_team_ended_within(&self, now: Micros, time: Micros) -> bool {
        self.team_ended.is_some_and(|at| now <= at + time)
    }

    /// A restart of everything leaves the division as all had agreed on it, as is promised.
    pub(crate) fn stood(&self, before: &Agreed, promise: &'static str) -> Verified {
        self.unchanged(before).or_else(|broken| breach(promise, broken.seen))
    }

    /// The loss of a team leaves the robots in their teams, as is promised. Of robots that command as many others the first one
    /// that returned leads.
    pub(crate) fn came_back(&self, before: &Agreed, promise: &'static str) -> Verified {
        let Some(last) = self.divisions.last() else { return Ok(()) };
        // What relates a robot to those of the team may be repeated later.
        before.stands(last, |robot| self.is_unrelated(last, robot), promise)
    }

    /// Unchanged input leaves the division as all had agreed on it.
    pub(crate) fn unchanged(&self, agreed: &Agreed) -> Verified {
        let (Some(last), Some(agreed)) = (self.divisions.last(), &agreed.division) else {
            return Ok(());
        };
        if same_division(last, agreed) && last.stale.is_empty() {
            return Ok(());
        }
        breach(UNCHANGED, format!("agreed on {:?}, now {:?}", short(agreed), short(last)))
    }
}

/// Whether a team is remembered no longer that was absent before.
fn has_forgotten_team(before: &Teams, now: &Teams) -> bool {
    let absent = |teams: &Teams| -> BTreeSet<TeamId> {
        teams.remembered.last.iter().map(|(_, team)| team.clone()).collect()
    };
    !absent(before).is_subset(&absent(now))
}

/// The robots that are in another team than before.
fn moved(before: &Teams, now: &Teams) -> BTreeSet<RobotId> {
    let places = |teams: &Teams| -> BTreeMap<RobotId, String> {
        let place = |(robot, team): (&RobotId, &TeamId)| (robot.clone(), team.to_string());
        teams.assignments().map(place).collect()
    };
    let (before, now) = (places(before), places(now));
    let is_elsewhere = |(robot, team): &(RobotId, String)| before.get(robot) != Some(team);
    now.into_iter().filter(is_elsewhere).map(|(robot, _)| robot).collect()
}

/// The teams in few words.
fn short(teams: &Teams) -> Vec<(String, Vec<String>)> {
    let names = teams.teams.iter().map(|team| {
        (team.id.to_string(), team.members.iter().map(|m| m.robot.to_string()).collect())
    });
    names.collect()
}

fn same_vectors(left: &Embedding, right: &Embedding) -> bool {
    left.dimension == right.dimension
        && left.robots == right.robots
        && left.values == right.values
        && left.without_embedding == right.without_embedding
}

/// The same teams by name, with the same members and leaders.
fn same_division(left: &Teams, right: &Teams) -> bool {
    same_members(left, right)
        && left.teams.iter().zip(&right.teams).all(|(l, r)| l.leader == r.leader)
}

/// The same teams by name, with the same members: their leaders depend on the roster too.
fn same_members(left: &Teams, right: &Teams) -> bool {
    short(left) == short(right) && left.unassigned == right.unassigned
}

//! After the last fault, everybody comes to agree with the truth and with each other; and who has
//! agreed does not change while nothing changes.

use std::collections::{BTreeMap, BTreeSet};

use muster_model::embedding::Embedding;
use muster_model::id::{RobotId, ServiceName};
use muster_model::roster::Presence;
use muster_model::teams::Teams;

use super::super::robots::Told;
use super::{Judge, Verdict, breach};

/// How many epochs after its own a robot that held a lost revision has been told again: its turn comes
/// with every heartbeat, in which a quiet fleet has one epoch or two.
const JUST_PASSED: u64 = 5;

/// What is true of one robot.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Truth {
    pub(crate) position: [f64; 3],
    pub(crate) superior: Option<RobotId>,
}

/// What is known of the world beside the bus.
#[derive(Debug)]
pub(crate) struct Witness<'a> {
    /// The robots that live.
    pub(crate) fleet: BTreeMap<&'a RobotId, Truth>,
    /// What each of them believes.
    pub(crate) told: BTreeMap<&'a RobotId, Option<&'a Told>>,
    /// The processes of services that run: service, instance, number of the process.
    pub(crate) running: BTreeSet<(ServiceName, usize, u32)>,
    /// Whether the clusterer has lost its disk. If nobody then remembers its last division but the
    /// robots, who answer no gets, it cannot know which term is above all that were heard of; a robot
    /// that holds a higher revision than the last keeps its team until the epochs have passed that.
    pub(crate) terms_lost: bool,
    /// How many teams an operator was last confirmed to have asked for, if that is known.
    pub(crate) teams: Option<u32>,
}

/// The division that everybody has agreed on.
#[derive(Debug, Clone)]
pub(crate) struct Settled {
    /// None where there never was anybody to divide.
    division: Option<std::sync::Arc<Teams>>,
}

impl Judge {
    /// Whether everybody agrees now; if not, on what they differ.
    pub(crate) fn agreement(&self, witness: &Witness<'_>) -> Result<Settled, String> {
        let roster = self.rosters.last().ok_or("there is no roster")?;
        let known = roster.robots.iter().map(|entry| &entry.robot);
        if !known.clone().eq(witness.fleet.keys().copied()) {
            let (known, living) = (known.collect::<Vec<_>>(), witness.fleet.keys());
            return Err(format!("the roster has {known:?}, alive are {living:?}"));
        }
        for (entry, truth) in roster.robots.iter().zip(witness.fleet.values()) {
            if entry.presence != Presence::Active {
                return Err(format!("{} lives and is stale in the roster", entry.robot));
            }
            if entry.position != Some(truth.position) || entry.superior != truth.superior {
                return Err(format!(
                    "{} is at {:?} under {:?}, in the roster at {:?} under {:?}",
                    entry.robot, truth.position, truth.superior, entry.position, entry.superior
                ));
            }
        }
        if roster.robots.is_empty() {
            return self.nobody(witness);
        }
        let embedding = self.embeddings.last().ok_or("there is no embedding")?;
        let graphs = embedding.graphs.iter().map(|(name, at, _)| (name, at));
        if !known.eq(&embedding.robots) || !graphs.eq(roster.graphs.iter().map(|(n, at)| (n, at))) {
            return Err(format!("the embedding is not that of the roster: {:?}", embedding.graphs));
        }
        let teams = self.divisions.last().ok_or("there is no division")?;
        let divided = self.embeddings.named(teams.embedding);
        if !divided.iter().any(|other| same_vectors(other, embedding)) {
            return Err("the division is not that of the last embedding".to_owned());
        }
        if let Some(wanted) = witness.teams.filter(|wanted| *wanted != teams.requested) {
            return Err(format!(
                "{wanted} teams were confirmed, {} are asked for",
                teams.requested
            ));
        }
        if !teams.stale.is_empty() {
            return Err(format!("the division says that {:?} are stale", teams.stale));
        }
        let audit = self.audits.last().ok_or("there is no audit")?;
        let judged = self.divisions.named(audit.teams);
        if !judged.iter().any(|other| same_division(other, teams))
            || !self.embeddings.named(audit.embedding).iter().any(|e| same_vectors(e, embedding))
        {
            return Err("the audit is not that of the division".to_owned());
        }
        self.told(teams, witness)?;
        Ok(Settled { division: Some(std::sync::Arc::clone(teams)) })
    }

    /// Where nobody lives, no service that runs may still say anything of robots. One that was killed
    /// with everybody who remembered need not say again that there is nobody.
    fn nobody(&self, witness: &Witness<'_>) -> Result<Settled, String> {
        let runs = |service: ServiceName| {
            let last = self.last_by.get(&service);
            last.is_some_and(|(instance, process)| {
                witness.running.contains(&(service, *instance, *process))
            })
        };
        let embedded = self.embeddings.last().is_some_and(|last| !last.robots.is_empty());
        let divided = self.divisions.last();
        let divided =
            divided.is_some_and(|last| !last.teams.is_empty() || !last.unassigned.is_empty());
        if runs(ServiceName::Embedder) && embedded || runs(ServiceName::Clusterer) && divided {
            return Err("robots that have left are still embedded or divided".to_owned());
        }
        Ok(Settled { division: None })
    }

    fn told(&self, teams: &Teams, witness: &Witness<'_>) -> Result<(), String> {
        for (robot, told) in &witness.told {
            let team = teams
                .teams
                .iter()
                .find(|team| team.members.iter().any(|member| member.robot == **robot));
            let told = told.ok_or_else(|| format!("{robot} was told nothing"))?;
            let now = teams.header.revision;
            let held = told.revision;
            if witness.terms_lost && (held > now || now.epoch < held.epoch + JUST_PASSED) {
                continue;
            }
            let right = match team {
                None => told.team.is_none(),
                Some(team) => {
                    let names: Vec<_> = team.members.iter().map(|m| m.robot.as_str()).collect();
                    told.team.as_deref() == Some(team.id.as_str())
                        && told.leader.as_deref() == Some(team.leader.as_str())
                        && told.members.as_ref().is_some_and(|told| told.iter().eq(&names))
                }
            };
            if !right {
                return Err(format!("{robot} believes {told:?}, the division says {team:?}"));
            }
        }
        Ok(())
    }

    /// Unchanged input leaves the division as everybody had agreed on it.
    pub(crate) fn unchanged(&self, agreed: &Settled) -> Verdict {
        let (Some(last), Some(agreed)) = (self.divisions.last(), &agreed.division) else {
            return Ok(());
        };
        if same_division(last, agreed) && last.stale.is_empty() {
            return Ok(());
        }
        breach(
            "unchanged input leaves the teams unchanged",
            format!("agreed on {:?}, now {:?}", short(agreed), short(last)),
        )
    }
}

/// The teams in few words.
fn short(teams: &Teams) -> Vec<(String, Vec<String>)> {
    let names = teams.teams.iter().map(|team| {
        (team.id.to_string(), team.members.iter().map(|m| m.robot.to_string()).collect())
    });
    names.collect()
}

fn same_vectors(left: &Embedding, right: &Embedding) -> bool {
    left.robots == right.robots && left.values == right.values && left.unseen == right.unseen
}

/// The same teams by name, with the same members and leaders.
fn same_division(left: &Teams, right: &Teams) -> bool {
    let same = |(l, r): (&muster_model::teams::Team, &muster_model::teams::Team)| {
        let names = |team: &muster_model::teams::Team| {
            team.members.iter().map(|member| member.robot.clone()).collect::<Vec<_>>()
        };
        l.id == r.id && l.leader == r.leader && names(l) == names(r)
    };
    left.teams.len() == right.teams.len()
        && left.teams.iter().zip(&right.teams).all(same)
        && left.unassigned == right.unassigned
}

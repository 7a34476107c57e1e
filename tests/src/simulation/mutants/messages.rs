//! What mutants make of messages.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use muster_model::alert::{Alert, AlertKind, AlertSubject};
use muster_model::content::Checked;
use muster_model::event::EventKind;
use muster_model::header::Revision;
use muster_model::id::{RobotId, ServiceName, TeamId};
use muster_model::teams::{TeamChange, Teams};
use muster_model::time::Tick;
use muster_model::wish::{WishKind, WishList, WishState};
use muster_wire::Message;
use muster_wire::envelope::MAX_SMALL_PAYLOAD;

use super::{CLOCK_TERMS, CONTINUED_EPOCHS, Mutant, Mutator, UNBELIEVED_TERMS, revision_of};

/// An alert that nothing has caused.
pub(in super::super) fn alert(id: u64, kind: AlertKind) -> Alert {
    Alert {
        id,
        kind,
        subject: AlertSubject::Fleet,
        raised: Tick(0),
        value: 1.0,
        threshold: 1.0,
        reason: String::new(),
        robots: Vec::new(),
        acknowledged: None,
    }
}

impl Mutator {
    pub(super) fn mutated(&mut self, mutant: Mutant, message: Message) -> Message {
        match (mutant, message) {
            (Mutant::RobotTwice, Message::Teams { teams, mirror }) => {
                let mut teams = Teams::clone(&teams);
                if let Some(robot) = teams.teams.first().and_then(|team| team.members.first()) {
                    teams.unassigned = vec![robot.robot.clone()];
                }
                Message::Teams { teams: Checked::new_unchecked(teams), mirror }
            }
            (Mutant::RobotForgotten, Message::Teams { teams, mirror }) => {
                let mut teams = Teams::clone(&teams);
                for team in &mut teams.teams {
                    // A team without its leader would not even be decoded.
                    team.members.retain(|member| member.robot == team.leader);
                }
                Message::Teams { teams: Checked::new_unchecked(teams), mirror }
            }
            (Mutant::Restless, Message::Teams { teams, mirror }) => {
                self.published += 1;
                self.leaders.clear();
                let mut teams = Teams::clone(&teams);
                for team in &mut teams.teams {
                    let other = team.members.iter().map(|member| &member.robot);
                    let other = other.filter(|robot| **robot != team.leader).max().cloned();
                    if let Some(other) = other.filter(|_| self.published.is_multiple_of(2)) {
                        team.leader = other.clone();
                        self.leaders.insert(team.id.clone(), other);
                    }
                }
                Message::Teams { teams: Checked::new_unchecked(teams), mirror }
            }
            (Mutant::Restless, Message::RobotTeam(mut report)) => {
                let leader = report.team.as_ref().and_then(|team| self.leaders.get(team));
                report.leader = leader.cloned().or(report.leader);
                Message::RobotTeam(report)
            }
            (Mutant::Fickle, Message::Teams { teams, mirror }) => {
                // Only where the same vectors were divided again: otherwise others may find it first.
                let inertia = Some(teams.inertia.to_bits());
                let again = std::mem::replace(&mut self.inertia, inertia) == inertia;
                let mut teams = Teams::clone(&teams);
                self.take_out(&mut teams, again);
                Message::Teams { teams: Checked::new_unchecked(teams), mirror }
            }
            (Mutant::Rearranging, Message::Teams { teams, mirror }) => {
                let now: BTreeSet<TeamId> =
                    teams.teams.iter().map(|team| team.id.clone()).collect();
                let before = std::mem::replace(&mut self.living, now);
                let mut teams = Teams::clone(&teams);
                let has_ended = !before.is_subset(&self.living);
                self.take_out(&mut teams, has_ended);
                Message::Teams { teams: Checked::new_unchecked(teams), mirror }
            }
            (Mutant::Fickle | Mutant::Rearranging, Message::RobotTeam(mut report)) => {
                if let Some(robot) = &self.taken_out {
                    if report.robot == *robot {
                        (report.team, report.leader, report.members) = (None, None, None);
                    } else if let Some(members) = &mut report.members {
                        members.retain(|member| member != robot);
                    }
                }
                Message::RobotTeam(report)
            }
            (Mutant::Overfull, Message::Teams { teams, mirror }) if teams.limited.is_some() => {
                let mut teams = Teams::clone(&teams);
                // Readers would refuse prices of teams that are not there.
                teams.limited.iter_mut().for_each(|limited| limited.prices.clear());
                let others = teams.teams.split_off(teams.teams.len().min(1));
                if let Some(first) = teams.teams.first_mut() {
                    first.members.extend(others.into_iter().flat_map(|team| team.members));
                    first.members.sort_by(|left, right| left.robot.cmp(&right.robot));
                }
                Message::Teams { teams: Checked::new_unchecked(teams), mirror }
            }
            (Mutant::Repetitive, Message::Outcome(mut outcome)) => {
                let own = outcome.id.clone();
                let first = self.first_commands.entry(outcome.service).or_insert(own);
                Arc::make_mut(&mut outcome).id.clone_from(first);
                Message::Outcome(outcome)
            }
            (Mutant::Boastful, Message::Teams { teams, mirror }) => {
                let mut teams = Teams::clone(&teams);
                teams.needs.iter_mut().for_each(|need| need.have += 1);
                Message::Teams { teams: Checked::new_unchecked(teams), mirror }
            }
            (Mutant::Negligent, Message::Teams { teams, mirror }) => {
                let mut teams = Teams::clone(&teams);
                for need in &mut teams.needs {
                    (need.min, need.max, need.soft) = (need.have + 1, None, false);
                }
                teams.limited.iter_mut().for_each(|limited| limited.conflict = None);
                Message::Teams { teams: Checked::new_unchecked(teams), mirror }
            }
            (Mutant::Disobedient, Message::Wishes(list)) => {
                let mut list = WishList::clone(&list);
                for one in &mut list.wishes {
                    if one.wish.kind == WishKind::Pin && one.state == WishState::Active {
                        one.wish.kind = WishKind::Ban;
                    }
                }
                Message::Wishes(Checked::new_unchecked(list))
            }
            (Mutant::Silent, Message::Event(mut event)) => {
                if matches!(event.kind, EventKind::Infeasible { .. }) {
                    event.kind = EventKind::FeasibleAgain { after_s: 0.0 };
                }
                Message::Event(event)
            }
            (Mutant::Voluble, Message::Event(mut event)) => {
                event.kind = EventKind::StateLost { reason: "x".repeat(MAX_SMALL_PAYLOAD) };
                Message::Event(event)
            }
            (Mutant::Reversed, Message::Event(mut event)) => {
                if let EventKind::TeamChanged(TeamChange::Moved { from, to, .. }) = &mut event.kind
                {
                    std::mem::swap(from, to);
                }
                Message::Event(event)
            }
            (Mutant::Renumbered, Message::Alerts(mut alerts)) => {
                self.published += 1;
                let list = Arc::make_mut(&mut alerts);
                let kinds = [AlertKind::Churn, AlertKind::Flapping];
                let kind = kinds[usize::from(self.published.is_multiple_of(2))];
                if !list.open.iter().any(|of| of.kind == kind) {
                    list.open.push(alert(list.next_id, kind));
                    list.next_id += 1;
                }
                Message::Alerts(alerts)
            }
            (Mutant::Doubled, Message::Alerts(mut alerts)) => {
                let list = Arc::make_mut(&mut alerts);
                if let Some(first) = list.open.first().cloned() {
                    list.open.push(Alert { id: list.next_id, ..first });
                    list.next_id += 1;
                }
                Message::Alerts(alerts)
            }
            (Mutant::Meddling, Message::Settings(mut announced)) => {
                if announced.service == ServiceName::Planner {
                    announced.service = ServiceName::Clusterer;
                }
                Message::Settings(announced)
            }
            (Mutant::Insistent, Message::Event(mut event)) => {
                let is_of_alert = matches!(
                    event.kind,
                    EventKind::AlertRaised { .. } | EventKind::AlertCleared { .. }
                );
                match &self.first_alert {
                    Some(first) if is_of_alert => event.kind = first.clone(),
                    _ => self.note_alert(&event.kind),
                }
                Message::Event(event)
            }
            (Mutant::Reused, Message::Teams { teams, mirror }) => {
                let mut teams = Teams::clone(&teams);
                self.reuse_ids(&mut teams);
                Message::Teams { teams: Checked::new_unchecked(teams), mirror }
            }
            (Mutant::Reused, Message::RobotTeam(mut report)) => {
                let other = report.team.as_ref().and_then(|team| self.renamed.get(team));
                report.team = other.cloned().or(report.team);
                Message::RobotTeam(report)
            }
            (Mutant::RevisionTwice, Message::Roster(mut roster)) => {
                let header = &mut roster.make_mut_unchecked().header;
                match self.old.take() {
                    Some(old) => header.revision = old,
                    None => self.old = Some(header.revision),
                }
                Message::Roster(roster)
            }
            (Mutant::TermTwice, mut message) => {
                let key = message.keys().0.to_string();
                if let Some(revision) = revision_of(&mut message)
                    && let Some(kept) = self.kept.get_mut(&key)
                    && revision.term >= kept.given.term
                {
                    if revision.term > kept.given.term {
                        kept.epochs += CONTINUED_EPOCHS;
                        kept.given = *revision;
                    }
                    revision.term = kept.term;
                    revision.epoch += kept.epochs;
                }
                message
            }
            (Mutant::TermsFromOne, mut message) => {
                if let Some(Revision { term, .. }) = revision_of(&mut message) {
                    *term = term.saturating_sub(CLOCK_TERMS).max(1);
                }
                message
            }
            (Mutant::UnbelievedTerm, mut message) => {
                if let Some(Revision { term, .. }) = revision_of(&mut message) {
                    *term += UNBELIEVED_TERMS;
                }
                message
            }
            (Mutant::OlderRoster, Message::Embedding(mut embedding)) => {
                self.published += 1;
                let old = *self.old.get_or_insert(embedding.roster);
                if self.published.is_multiple_of(3) {
                    embedding.make_mut_unchecked().roster = old;
                }
                Message::Embedding(embedding)
            }
            (Mutant::NoPositions, Message::Audit(mut audit)) => {
                let report = &mut Arc::make_mut(&mut audit).in_physical;
                (report.mean, report.per_team, report.per_robot) = (None, Vec::new(), Vec::new());
                Message::Audit(audit)
            }
            (Mutant::WrongSilhouette, Message::Audit(audit)) => {
                let mut audit = audit.as_ref().clone();
                if let Some((_, score)) = audit.in_embedding.per_robot.first_mut() {
                    *score = (*score - 1e-6).max(-1.0);
                }
                Message::Audit(audit.into())
            }
            (Mutant::NotANumber, Message::Audit(audit)) => {
                let mut audit = audit.as_ref().clone();
                audit.in_embedding.mean = audit.in_embedding.mean.map(|_| f64::NAN);
                Message::Audit(audit.into())
            }
            (_, message) => message,
        }
    }

    /// Takes a robot that leads no team out of its team, if it is time to.
    fn take_out(&mut self, teams: &mut Teams, is_time: bool) {
        self.taken_out = teams.teams.iter_mut().filter(|_| is_time).find_map(|team| {
            let at = team.members.iter().position(|member| member.robot != team.leader)?;
            Some(team.members.remove(at).robot)
        });
        teams.unassigned.extend(self.taken_out.clone());
        teams.unassigned.sort();
    }

    /// Gives a team the id of one that has ended and had none of its robots, and keeps to that.
    fn reuse_ids(&mut self, teams: &mut Teams) {
        let name =
            |renamed: &BTreeMap<TeamId, TeamId>, id: &TeamId| renamed.get(id).unwrap_or(id).clone();
        let living: BTreeSet<TeamId> =
            teams.teams.iter().map(|team| name(&self.renamed, &team.id)).collect();
        let ended = self.seen.iter().filter(|(id, _)| !living.contains(*id));
        // It must not be in the division before either.
        let ended: Vec<_> = ended.filter(|(id, _)| !self.living.contains(*id)).collect();
        let other = teams.teams.iter().find_map(|team| {
            let is_other = |known: &BTreeSet<RobotId>| {
                team.members.iter().all(|member| !known.contains(&member.robot))
            };
            let (id, _) = ended.iter().find(|(_, known)| is_other(known))?;
            Some((team.id.clone(), (*id).clone()))
        });
        if self.renamed.is_empty() {
            self.renamed.extend(other);
        }
        self.living = teams.teams.iter().map(|team| name(&self.renamed, &team.id)).collect();
        for team in &teams.teams {
            let known = self.seen.entry(name(&self.renamed, &team.id)).or_default();
            known.extend(team.members.iter().map(|member| member.robot.clone()));
        }
        for team in &mut teams.teams {
            team.id = name(&self.renamed, &team.id);
        }
        for need in &mut teams.needs {
            need.team = name(&self.renamed, &need.team);
        }
        // Readers would refuse prices in another order of teams.
        teams.limited.iter_mut().for_each(|limited| limited.prices.clear());
    }
}

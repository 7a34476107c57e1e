//! What becomes of messages and of the answers of fetches.

use std::sync::Arc;

use muster_division::identity::is_believable;
use muster_division::memory::Memory;
use muster_model::alert::Alerts;
use muster_model::audit::Audit;
use muster_model::content::Checked;
use muster_model::embedding::Embedding;
use muster_model::id::RobotId;
use muster_model::roster::{Presence, Roster};
use muster_model::teams::{Team, Teams};
use muster_model::time::Tick;
use muster_wire::Message;

use super::awaiting::Reunion;
use super::{Clusterer, Context, Received};
use crate::dwell::MoveDwell;
use crate::wishes::WishBook;

impl Clusterer {
    pub(super) fn accept_message(&mut self, context: &mut Context<'_>, message: Message) {
        match message {
            Message::Embedding(embedding) => self.accept_embedding(context, embedding),
            Message::Roster(roster) => self.accept_roster(context, roster),
            Message::Audit(audit) => self.accept_audit(audit),
            Message::Alerts(alerts) => self.accept_alerts(alerts),
            Message::Teams { teams, .. } => self.accept_teams(context, &teams),
            Message::Wishes(wishes) if !context.has_term() => self.keeping.note_wishes(wishes),
            _ => {}
        }
    }

    /// Accepts answers, the newest first, so that no older embedding is divided before it.
    pub(super) fn accept_all(&mut self, context: &mut Context<'_>, mut messages: Vec<Message>) {
        let revision = |message: &Message| message.header().map(|header| header.revision);
        messages.sort_by_key(|message| std::cmp::Reverse(revision(message)));
        for message in messages {
            self.accept_message(context, message);
        }
    }

    /// A division that was published. A standby keeps it, a leader gives none of its numbers.
    fn accept_teams(&mut self, context: &Context<'_>, teams: &Checked<Teams>) {
        if !context.has_term() {
            self.keeping.hear(teams);
        } else if is_believable(teams) && teams.next_team > self.memory.next_team {
            Arc::make_mut(&mut self.memory).next_team = teams.next_team;
        }
    }

    fn accept_audit(&mut self, audit: Arc<Audit>) {
        let last = self.audit.as_ref().map(|audit| audit.header.revision);
        if last.is_none_or(|last| audit.header.revision > last) {
            self.audit = Some(audit);
        }
    }

    fn accept_alerts(&mut self, alerts: Arc<Alerts>) {
        let last = self.alerts.as_ref().map(|alerts| alerts.header.revision);
        if last.is_none_or(|last| alerts.header.revision > last) {
            self.alerts = Some(alerts);
        }
    }

    fn accept_embedding(&mut self, context: &mut Context<'_>, embedding: Checked<Embedding>) {
        let revision = embedding.header.revision;
        let last = self.newest.as_ref().map(|newest| newest.embedding.header.revision);
        if last.is_some_and(|last| revision <= last) {
            // The same one may come twice: by subscription and by fetch.
            if last != Some(revision) {
                context.count("messages_old");
            }
            return;
        }
        context.count("embeddings_received");
        self.newest = Some(Received { embedding, at: context.now() });
        self.consider(context);
    }

    fn accept_roster(&mut self, context: &mut Context<'_>, roster: Checked<Roster>) {
        let revision = roster.header.revision;
        let last = self.roster.as_ref().map(|roster| roster.header.revision);
        if last.is_some_and(|last| revision <= last) {
            if last != Some(revision) {
                context.count("messages_old");
            }
            return;
        }
        if self.orders.follow(context.now(), self.roster.as_deref(), &roster) {
            self.arrivals.note_loss(context.now());
        }
        if self.are_reporting_again(&roster) {
            self.arrivals.note_reporting_again(context.now());
        }
        self.roster = Some(roster);
        // Robots became stale, left, or have other superiors: the same labels are republished.
        if let (Some(published), Some(division)) = (&self.published, &self.division) {
            let (leaders, stale) = self.roster_view(division, &published.source.embedding);
            let led = division.teams.iter().zip(leaders);
            if stale != division.stale
                || led.into_iter().any(|(team, leader)| leader.is_some_and(|l| l != team.leader))
            {
                let source = published.source.clone();
                self.republish_from(context, source);
            }
        }
        if !context.settings().needs.is_empty() {
            // Others may be able to fill needs than before.
            self.consider(context);
        }
    }

    /// Whether a robot reports again that had left, or whose whole team was silent: its link is back.
    fn are_reporting_again(&self, next: &Roster) -> bool {
        let (Some(last), Some(division)) = (self.roster.as_deref(), &self.division) else {
            return false;
        };
        let presence = |roster: &Roster, robot: &RobotId| {
            let place = roster.robots.binary_search_by(|entry| entry.robot.cmp(robot));
            place.ok().map(|place| roster.robots[place].presence)
        };
        let is_active = |robot| presence(next, robot) == Some(Presence::Active);
        let is_silent = |team: &&Team| {
            let mut members = team.members.iter();
            members.all(|member| presence(last, &member.robot) == Some(Presence::Stale))
        };
        let silent = division.teams.iter().filter(is_silent).flat_map(|team| &team.members);
        let mut back = self.memory.robots().filter(|robot| presence(last, robot).is_none());
        back.any(is_active) || silent.map(|member| &member.robot).any(is_active)
    }

    /// Takes over the newest division of an earlier leader among messages, and the embedding that it
    /// names.
    pub(super) fn inherit(&mut self, now: Tick, messages: &[Message]) {
        for message in messages {
            let Message::Teams { teams, .. } = message else { continue };
            if !is_believable(teams) {
                continue;
            }
            self.keeping.inherit_numbers(teams.next_team);
            let last = self.division.as_ref().map(|division| division.header.revision);
            if last.is_none_or(|last| teams.header.revision > last) {
                self.division = Some(teams.clone());
            }
        }
        for message in messages {
            if let Message::Wishes(wishes) = message {
                self.keeping.note_wishes(wishes.clone());
            }
        }
        if let Some(wishes) = self.keeping.wishes() {
            self.wishes = WishBook::of(&wishes.wishes);
        }
        self.inherit_kept(now);
        Arc::make_mut(&mut self.memory).next_team = self.keeping.next_team;
        let named = self.division.as_ref().map(|division| division.embedding);
        for message in messages {
            if let Message::Embedding(embedding) = message
                && named == Some(embedding.header.revision)
            {
                self.divided = Some(embedding.clone());
            }
        }
        let limited = self.division.as_ref().and_then(|division| division.limited.as_ref());
        if limited.is_some_and(|limited| limited.conflict.is_some()) {
            // Its event has been published.
            self.infeasible_since = Some(now);
        }
        self.wishes.check_granted(self.division.as_deref(), self.divided.as_deref());
        self.received_by_others = self.division.clone();
    }

    /// Takes over the division on disk, if no service holds one that is as new, and what a division says besides its
    /// teams: those that robots had before it, which robots there were, and which moves wait.
    fn inherit_kept(&mut self, now: Tick) {
        let last = self.division.as_ref().map(|division| division.header.revision);
        if let Some(kept) = self.keeping.division()
            && last.is_none_or(|last| kept.header.revision >= last)
        {
            self.division = Some(kept.clone());
        }
        if let Some(division) = &self.division {
            self.memory = Arc::new(Memory::of(&division.remembered, now));
            if self.memory.robots().next().is_some() {
                self.moves = MoveDwell::resumed(now, &division.held);
                // How long ago they left is not known: others may follow.
                self.arrivals.note_loss(now);
            }
            // Whoever remembers it may have it from a disk as well: then all services were restarted, and receive one robot
            // after the other.
            self.reunion = Some(Reunion::default());
        }
    }
}

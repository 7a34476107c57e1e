//! What is published of a division, and when it is published again.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use muster_division::division::{Staying, changes, with_held};
use muster_division::rules::{TeamRules, asks_alike};
use muster_division::seats::{Seats, reseated};
use muster_model::content::Checked;
use muster_model::embedding::Embedding;
use muster_model::event::{EventKind, Severity};
use muster_model::id::RobotId;
use muster_model::roster::Presence;
use muster_model::settings::ClustererSettings;
use muster_model::teams::{HeldRobot, Limited, Teams};
use muster_model::time::{Tick, seconds};
use muster_wire::Message;

use super::{Clusterer, Context, Published, Received, Undecided, View};
use crate::dwell::Losses;
use crate::leader::leaders;
use crate::publishing::{robots_to_inform, shortage};
use crate::replacement::filled;

/// Most changes of one division that are published as events; the others are only counted. When a whole fleet
/// changes teams, the division itself is the better report.
const MAX_CHANGE_EVENTS: usize = 64;

impl Clusterer {
    /// Publishes a division, but for the robots that have not been in another team for as long as the dwell time; or
    /// notes when that is to be looked at again.
    pub(super) fn settle(
        &mut self,
        context: &mut Context<'_>,
        new: Teams,
        source: Received,
        dwell: Duration,
    ) {
        let now = context.now();
        let before = self.division.clone();
        let renewed = self.orders.renewed(now, self.roster.as_deref());
        let seated = before.as_deref().and_then(|before| reseated(before, &new));
        let seated = seated.as_ref().or(before.as_deref());
        let asked = self.rules(context.settings());
        let rules = asked
            .clone()
            .map(|rules| rules.resolved(before.as_deref(), &self.memory, &source.embedding));
        let stands = new.limited.as_ref().is_some_and(Limited::stands);
        // A division that stands because nothing satisfies the rules has no noise to wait out.
        let dwell = if stands { Duration::ZERO } else { dwell };
        // Limits and wishes count at once.
        let losses = match rules {
            Some(_) => Losses::default(),
            None => self.losses(&source.embedding),
        };
        let mut held = self.moves.hold(now, dwell, &new, seated, &renewed, losses);
        if let Some(rules) = &rules
            && !held.is_empty()
        {
            held = rules.keep(&new, held);
            self.moves.keep(&held);
        }
        let mut teams = new.clone();
        let elsewhere = new.assignments().filter(|(robot, _)| held.contains_key(*robot));
        let mut kept: Vec<HeldRobot> = elsewhere
            .map(|(robot, team)| HeldRobot { robot: robot.clone(), team: team.clone() })
            .collect();
        kept.sort_unstable_by(|left, right| left.robot.cmp(&right.robot));
        if !held.is_empty() {
            match with_held(&new, &held, rules.as_ref(), &source.embedding) {
                Ok(with_held) => {
                    context.add("moves_held", held.len() as u64);
                    teams = with_held;
                }
                // The division itself has passed the same computation.
                Err(error) => context.report_job_failure("dwell", &error.to_string()),
            }
        }
        teams.changes = changes(&teams, before.as_deref());
        teams.held = kept;
        // What happened to the teams is published with this one.
        let teams_found = Teams { changes: vec![], ..new };
        let undecided = Undecided { teams: teams_found, rules: asked };
        self.undecided = (!held.is_empty()).then(|| Box::new(undecided));
        Arc::make_mut(&mut self.memory).follow(now, before.as_deref(), &teams);
        self.publish(context, teams, source);
    }

    /// What has become of the robots of the last division, by the robots that are embedded now.
    fn losses(&self, embedding: &Embedding) -> Losses {
        let before = self.division.as_deref();
        let seats = Seats::of(before, &self.memory, &BTreeSet::new(), embedding);
        Losses {
            show_until: self.arrivals.losses_show_until(),
            is_team_absent: seats.absent > 0,
            all_stay: self.flight.completed().is_some_and(|made| made.staying == Staying::All),
        }
    }

    /// When robots that were kept in their team may be published elsewhere.
    pub(super) fn settle_at(&self, view: &View<'_>) -> Option<Tick> {
        self.undecided.as_ref()?;
        self.moves.due(dwell(view.settings()))
    }

    /// Looks again at the robots that were kept in their team.
    pub(super) fn settle_again(&mut self, context: &mut Context<'_>) {
        if let Some(published) = &self.published
            && let Some(undecided) = self.undecided.take()
            // What was to follow may break rules that hold since; another division comes then.
            && asks_alike(undecided.rules.as_ref(), self.rules(context.settings()).as_ref())
        {
            let source = published.source.clone();
            self.settle(context, undecided.teams, source, dwell(context.settings()));
        }
    }

    pub(super) fn publish(&mut self, context: &mut Context<'_>, teams: Teams, source: Received) {
        let now = context.now();
        let (leaders, stale) = self.roster_view(&teams, &source.embedding);
        let provisional = provisional(&teams, &source.embedding);
        let mut teams = Teams { stale, provisional, ..teams };
        for (team, leader) in teams.teams.iter_mut().zip(leaders) {
            if let Some(leader) = leader {
                team.leader = leader;
            }
        }
        let revision = context.next_revision();
        let stage = context.stage(source.at);
        let needs = self.needs(context.settings());
        teams.needs = needs.published(&teams);
        teams.embedding = source.embedding.header.revision;
        if self.memory.is_overdue(now) {
            Arc::make_mut(&mut self.memory).forget(now);
        }
        teams.remembered = self.memory.remembered();
        // After a restart only the division says which numbers were given.
        teams.next_team = teams.next_team.max(self.memory.next_team);
        teams.header = source.embedding.header.next_stage(revision, stage);

        let heartbeat = seconds(context.settings().heartbeat_s);
        let before = self.received_by_others.as_deref();
        let mirrored = self.published.as_ref().map(|published| published.mirrored);
        let mirror = mirrored.is_none_or(|last| now.since(last) >= heartbeat)
            || before.is_none_or(|before| !before.same_division(&teams));
        let teams = Checked::new_unchecked(teams);
        context.publish(Message::Teams { teams: teams.clone(), mirror });
        context.count("divisions_published");

        let changed = robots_to_inform(&teams, before);
        for robot in &changed {
            if let Some(team) = teams.robot_team(robot) {
                context.publish(Message::RobotTeam(team));
            }
        }
        let changed: BTreeSet<&RobotId> = changed.into_iter().collect();
        let mirrored = if mirror { now } else { mirrored.unwrap_or(now) };
        let rules = self.rules(context.settings());
        let reserved = rules.as_ref().map(TeamRules::reserved).unwrap_or_default();
        let embedding = &source.embedding;
        let absent = Seats::of(Some(&teams), &self.memory, &reserved, embedding).absent;
        self.divided = Some(source.embedding.clone());
        self.published = Some(Published { source, at: now, mirrored });
        self.division = Some(teams.clone());
        self.inform_in_rotation(context, &changed);
        if context.is_leading() {
            self.keeping.note(&teams);
            self.report_changes(context, &teams, absent);
            let before = self.received_by_others.as_deref();
            let filled = filled(before, &teams, &needs, self.roster.as_deref());
            for kind in filled.into_iter().take(MAX_CHANGE_EVENTS) {
                context.publish_event(Severity::Info, kind);
            }
            self.assess_wishes(context, &teams);
            self.received_by_others = Some(teams);
        }
    }

    /// The leader of each team of a division, and the stale robots of its embedding, by the newest roster. A
    /// robot that is missing from a roster no older than the embedding's counts as stale: it is about to leave.
    pub(super) fn roster_view(
        &self,
        teams: &Teams,
        embedding: &Embedding,
    ) -> (Vec<Option<RobotId>>, Vec<RobotId>) {
        let mut stale = Vec::new();
        if let Some(roster) = self.roster.as_deref() {
            let is_new = roster.header.revision >= embedding.roster;
            let mut entries = roster.robots.iter().peekable();
            for robot in &embedding.robots {
                while entries.next_if(|entry| entry.robot < *robot).is_some() {}
                let is_stale = match entries.peek().filter(|entry| entry.robot == *robot) {
                    Some(entry) => entry.presence == Presence::Stale,
                    None => is_new,
                };
                if is_stale {
                    stale.push(robot.clone());
                }
            }
        } else if let Some(division) = &self.division {
            let known = |robot: &&RobotId| embedding.robots.binary_search(robot).is_ok();
            stale.extend(division.stale.iter().filter(known).cloned());
        }
        let roster = self.roster.as_deref();
        (leaders(&teams.teams, roster, self.division.as_deref(), &stale), stale)
    }

    /// Publishes what a division has changed.
    fn report_changes(&mut self, context: &mut Context<'_>, teams: &Teams, absent: u32) {
        let changes = teams.changes.clone();
        let count = changes.len();
        context.add("team_changes", count as u64);
        for change in changes.into_iter().take(MAX_CHANGE_EVENTS) {
            context.publish_event(Severity::Info, EventKind::TeamChanged(change));
        }
        let unreported = count.saturating_sub(MAX_CHANGE_EVENTS);
        if unreported > 0 {
            context.add("team_changes_untold", unreported as u64);
        }
        match shortage(teams, context.settings().teams, absent) {
            Some((requested, formed, reason)) if self.fewer != Some((requested, formed)) => {
                self.fewer = Some((requested, formed));
                let kind = EventKind::FewerTeams { requested, formed, reason };
                context.publish_event(Severity::Warning, kind);
            }
            Some(_) => {}
            None => self.fewer = None,
        }
        self.report_feasibility(context, teams);
    }

    /// Publishes that nothing satisfies the rules any more, and that something does again.
    fn report_feasibility(&mut self, context: &mut Context<'_>, teams: &Teams) {
        let now = context.now();
        match teams.limited.as_ref().and_then(|limited| limited.conflict.clone()) {
            Some(reason) => {
                if self.infeasible_since.is_none() {
                    self.infeasible_since = Some(now);
                    context.publish_event(Severity::Warning, EventKind::Infeasible { reason });
                }
            }
            None => {
                if let Some(since) = self.infeasible_since.take() {
                    let after_s = now.since(since).as_secs_f64();
                    context.publish_event(Severity::Info, EventKind::FeasibleAgain { after_s });
                }
            }
        }
    }

    /// Republishes the last division of this leader, if there is one.
    pub(super) fn republish(&mut self, context: &mut Context<'_>) {
        if let Some(published) = &self.published {
            let source = published.source.clone();
            self.republish_from(context, source);
        }
    }

    /// Republishes the last division with the leaders and stale robots of the newest roster.
    pub(super) fn republish_from(&mut self, context: &mut Context<'_>, source: Received) {
        let Some(division) = &self.division else { return };
        let mut teams = Teams::clone(division);
        if self.received_by_others.as_ref().is_some_and(|last| last.ptr_eq(division)) {
            teams.changes.clear();
        }
        self.publish(context, teams, source);
    }

    /// When the rotation is due.
    pub(super) fn rotation_at(&self, view: &View<'_>) -> Option<Tick> {
        self.published.as_ref().filter(|_| view.is_leading())?;
        Some(self.rotation.due(seconds(view.settings().heartbeat_s)))
    }

    /// Republishes the teams of the next robots in rotation when that is due, except those that were just
    /// informed.
    pub(super) fn inform_in_rotation(
        &mut self,
        context: &mut Context<'_>,
        informed: &BTreeSet<&RobotId>,
    ) {
        let now = context.now();
        if self.rotation_at(&context.view()).is_none_or(|due| now < due) {
            return;
        }
        let (Some(published), Some(teams)) = (&self.published, &self.division) else { return };
        // The embedding has the robots of the division, ordered by name.
        for robot in self.rotation.next(now, &published.source.embedding.robots) {
            if !informed.contains(&robot)
                && let Some(team) = teams.robot_team(&robot)
            {
                context.publish(Message::RobotTeam(team));
            }
        }
    }

    pub(super) fn heartbeat_at(&self, view: &View<'_>) -> Option<Tick> {
        let published = self.published.as_ref()?;
        Some(published.at.after(seconds(view.settings().heartbeat_s)))
    }
}

/// How long another team of a robot must last where operators have asked for nothing else meanwhile.
pub(super) fn dwell(settings: &ClustererSettings) -> Duration {
    seconds(settings.dwell_s)
}

/// The robots with a team whose place nothing confirms, ordered by name.
fn provisional(teams: &Teams, embedding: &Embedding) -> Vec<RobotId> {
    let marked = embedding.robots.iter().zip(&embedding.provisional);
    let marked =
        marked.filter(|(robot, marked)| **marked && teams.unassigned.binary_search(robot).is_err());
    marked.map(|(robot, _)| robot.clone()).collect()
}

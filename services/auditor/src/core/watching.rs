//! What is watched for alerts, and how the list of open alerts is published, inherited and acknowledged.

use std::sync::Arc;

use muster_model::alert::{AlertKind, AlertSubject, Alerts};
use muster_model::event::{EventKind, Severity};
use muster_model::header::Header;
use muster_model::settings::AuditorSettings;
use muster_model::time::{Tick, seconds};
use muster_service::Get;
use muster_wire::Message;

use super::{Auditor, Context, View};
use crate::alerts::conditions::{infeasible, of_churn, of_modalities, of_teams};
use crate::alerts::{AlertEvent, Condition, Delays, Wanted};

fn delays(settings: &AuditorSettings) -> Delays {
    Delays { raise: seconds(settings.alert_after_s), clear: seconds(settings.alert_clear_s) }
}

impl Auditor {
    /// Raises or ends the alert of low quality, once that is published: the output of a suspect would be lost.
    pub(super) fn watch(&mut self, context: &mut Context<'_>) {
        let Some(scored) = self.scored.as_ref().filter(|_| context.is_leading()) else { return };
        let mean = scored.scores.in_embedding.mean;
        let (now, settings) = (context.now(), context.settings());
        let Some(kind) = self.alert.observe(now, mean, settings) else { return };
        let (value, threshold) = (mean.unwrap_or_default(), settings.poor);
        let reason = format!("the mean silhouette of the division is {value:.2}");
        let condition = fleet_condition(value, threshold, reason);
        let is_raised = matches!(kind, EventKind::QualityLow { .. });
        self.report(context, AlertKind::Poor, is_raised, condition, kind);
    }

    /// Raises or ends the alert of robots that change teams to and fro. A suspect does not: its output
    /// would be lost.
    pub(super) fn watch_flapping(&mut self, context: &mut Context<'_>) {
        if !context.is_leading() {
            return;
        }
        let is_partial = self.flapping.is_partial(context.now());
        let flapping = self.flapping.flapping(context.now());
        let value = flapping.returns_per_robot_minute;
        let robots: Vec<_> = flapping.robots.iter().map(|entry| entry.robot.clone()).collect();
        let settings = context.settings();
        let threshold = settings.flapping;
        let observed = self.flapping_alert.observe(flapping, is_partial, settings);
        let Some(kind) = observed else { return };
        let reason =
            format!("robots change back into a team {value:.2} times per robot and minute");
        let condition = Condition { robots, ..fleet_condition(value, threshold, reason) };
        let is_raised = matches!(kind, EventKind::Flapping { .. });
        self.report(context, AlertKind::Flapping, is_raised, condition, kind);
    }

    /// Raises or ends an alert of the fleet at once. `event` is the event of its own that it has had before
    /// there were lists of alerts; readers of either learn of it.
    fn report(
        &mut self,
        context: &mut Context<'_>,
        kind: AlertKind,
        is_raised: bool,
        condition: Condition,
        event: EventKind,
    ) {
        let now = context.now();
        let severity = if is_raised { Severity::Warning } else { Severity::Info };
        let events = if is_raised {
            self.book.raise_now(now, kind, condition)
        } else {
            self.book.clear_now(now, kind, AlertSubject::Fleet)
        };
        context.publish_event(severity, event);
        self.publish_changes(context, events);
    }

    /// Watches the teams, the modalities and the changes of teams. A suspect does not.
    pub(super) fn watch_teams(&mut self, context: &mut Context<'_>) {
        if !context.is_leading() {
            return;
        }
        let now = context.now();
        let settings = context.settings().clone();
        let mut observed = Vec::new();
        if let Some(scored) = &self.scored {
            let audits = &scored.scores.teams.teams;
            observed.extend(of_teams(audits, &scored.source.teams, &settings));
        }
        observed.extend(self.embeddings.newest().map(|embedding| of_modalities(&embedding.graphs)));
        for of in observed {
            self.book.observe(now, of.kind, of.conditions);
        }
        let mut churn = of_churn(self.flapping.changes(now), &settings);
        if churn.wanted == Wanted::Clear && self.flapping.is_partial(now) {
            churn.wanted = Wanted::Neither;
        }
        self.book.observe(now, AlertKind::Churn, vec![churn]);
        self.advance_alerts(context);
    }

    /// Watches what concerns the fleet as a whole: whether limits can hold, and whether its history is whole. A suspect
    /// does not.
    pub(super) fn watch_fleet(&mut self, context: &mut Context<'_>) {
        if !context.is_leading() {
            return;
        }
        let now = context.now();
        let teams = self.newest.as_ref().map(|newest| &*newest.teams);
        if let Some(teams) = teams {
            self.book.observe(now, AlertKind::Infeasible, vec![infeasible(teams)]);
        }
        let condition = self.recordings.condition(now);
        self.book.observe(now, AlertKind::HistoryDegraded, vec![condition]);
        self.advance_alerts(context);
    }

    /// Raises and ends alerts that have become due.
    pub(super) fn advance_alerts(&mut self, context: &mut Context<'_>) {
        if context.is_leading() {
            let events = self.book.advance(context.now(), delays(context.settings()));
            self.publish_changes(context, events);
        }
    }

    /// Publishes events of alerts, and the list if it has changed.
    fn publish_changes(&mut self, context: &mut Context<'_>, events: Vec<AlertEvent>) {
        for AlertEvent { severity, kind } in events {
            if matches!(kind, EventKind::AlertRaised { .. }) {
                context.count("alerts");
            }
            context.publish_event(severity, kind);
        }
        if self.book.take_changed() {
            self.publish_alerts(context);
        }
    }

    /// Publishes the list of open alerts.
    pub(super) fn publish_alerts(&mut self, context: &mut Context<'_>) {
        if !context.is_leading() {
            return;
        }
        let now = context.now();
        let header = Header {
            fleet: context.fleet().clone(),
            revision: context.next_revision(),
            oldest: None,
            newest: None,
            stages: vec![context.stage(now)],
        };
        let alerts = Arc::new(self.book.list(header));
        self.alerts = Some(Arc::clone(&alerts));
        self.alerts_published = Some(now);
        context.publish(Message::Alerts(alerts));
    }

    /// When an alert is to be raised or ended.
    pub(super) fn alerts_at(&self, view: &View<'_>) -> Option<Tick> {
        self.book.due(delays(view.settings())).filter(|_| view.is_leading())
    }

    /// Accepts the list of another leader. A leader has its own.
    pub(super) fn accept_alerts(&mut self, context: &Context<'_>, alerts: Arc<Alerts>) {
        if !context.has_term() {
            self.keep_alerts(&Message::Alerts(alerts));
        }
    }

    /// Keeps the newest list.
    pub(super) fn keep_alerts(&mut self, message: &Message) {
        let Message::Alerts(alerts) = message else { return };
        let last = self.alerts.as_ref().map(|alerts| alerts.header.revision);
        if last.is_none_or(|last| alerts.header.revision > last) {
            self.alerts = Some(Arc::clone(alerts));
        }
    }

    /// Goes on with the alerts of the leader before: with their numbers, and with who has seen them.
    pub(super) fn inherit_alerts(&mut self, context: &mut Context<'_>) {
        if let Some(alerts) = self.alerts.clone() {
            self.book.inherit(&alerts);
        }
        let is_open = |kind| self.book.is_open(kind, &AlertSubject::Fleet);
        let (poor, flapping) = (is_open(AlertKind::Poor), is_open(AlertKind::Flapping));
        if flapping || is_open(AlertKind::Churn) {
            self.flapping.take_over(context.now());
        }
        self.alert.inherit(poor);
        self.flapping_alert.inherit(flapping);
        self.publish_alerts(context);
    }

    /// Answers a get that acknowledges an alert with the list. An instance that does not lead leaves that to the leader.
    pub(super) fn acknowledge(&mut self, context: &mut Context<'_>, get: Get, payload: &[u8]) {
        if !context.is_leading() {
            return context.reply(get, Vec::new());
        }
        let request = match muster_wire::alerts::read_acknowledgement(payload) {
            Ok(request) => request,
            Err(problem) => return context.reply_error(get, problem.to_string()),
        };
        match self.book.acknowledge(context.now(), request) {
            Ok(event) => {
                self.publish_changes(context, event.into_iter().collect());
                let answer = self.alerts.iter().cloned().map(Message::Alerts).collect();
                context.reply(get, answer);
            }
            Err(problem) => context.reply_error(get, problem.to_string()),
        }
    }
}

/// What is observed of the whole fleet.
fn fleet_condition(value: f64, threshold: f64, reason: String) -> Condition {
    Condition {
        subject: AlertSubject::Fleet,
        wanted: Wanted::Raise,
        value,
        threshold,
        reason,
        robots: Vec::new(),
    }
}

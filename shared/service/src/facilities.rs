//! What the host keeps and does for a core.

use std::collections::VecDeque;
use std::sync::Arc;

use muster_model::command::{CommandOutcome, MAX_REMEMBERED_COMMANDS};
use muster_model::event::{EventKind, Severity};
use muster_model::settings::Settings;
use muster_model::time::Tick;
use muster_wire::{Key, Message, Pattern, Rejection};

use crate::commands::Commands;
use crate::failures::{Failures, JobOutcomes};
use crate::fetches::{AnswerTime, Fetched, Fetches, Purpose};
use crate::gets::{Gets, encode_answer};
use crate::io::{Command, GetId, Publication, Reply};
use crate::replica::Replica;
use crate::start::Stored;
use crate::unstored::UnstoredTerm;

/// Most messages of commands that wait until an instance leads again: of each there are the outcome and an event, and
/// an event of the settings that it changed.
const MAX_UNSAID: usize = 3 * MAX_REMEMBERED_COMMANDS;

/// The one job of a service.
pub(crate) enum JobSlot<Job> {
    /// None runs.
    Free,
    /// One is handed out next.
    Ready(Job),
    /// One runs.
    Running,
    /// One runs whose result is dropped.
    Abandoned,
}

/// What the host does for a core, over the types of its settings, fetches and jobs.
pub(crate) struct Facilities<S, F, J> {
    pub(crate) now: Tick,
    pub(crate) replica: Replica<S>,
    pub(crate) fetches: Fetches<F>,
    /// Fetches that have ended within the current input.
    pub(crate) fetched: VecDeque<Fetched<F>>,
    pub(crate) gets: Gets,
    /// What operators have commanded.
    pub(crate) operator_commands: Commands,
    /// What came of commands while this instance was suspect, and the events of that, which others learn once it
    /// leads again. At most [`MAX_UNSAID`].
    pub(crate) unsaid: VecDeque<Message>,
    pub(crate) job: JobSlot<J>,
    pub(crate) failures: Failures,
    /// Whether the last jobs have all failed.
    pub(crate) jobs: JobOutcomes,
    pub(crate) commands: Vec<Command>,
    /// When state that could not be written is written again.
    pub(crate) store_again_at: Option<Tick>,
    /// Whether an event has said that state cannot be written.
    pub(crate) is_loss_reported: bool,
    /// What is not published before the term is on the disk.
    pub(crate) unstored_term: UnstoredTerm,
}

/// Whether an answer confirms stored state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ReplyKind {
    /// It does not.
    Plain,
    /// It does, so that it is an error if storing fails.
    ConfirmsStore,
}

impl<S: Settings, F: Copy + Eq, J> Facilities<S, F, J> {
    /// Publishes a message, if this instance leads.
    pub(crate) fn publish_as_leader(&mut self, message: Message) {
        if self.replica.election.is_leading() {
            self.publish(message);
        }
    }

    /// Publishes what came of a command, now or once this instance leads again.
    pub(crate) fn publish_outcome(&mut self, outcome: &Arc<CommandOutcome>) {
        self.publish_or_keep(Message::Outcome(Arc::clone(outcome)));
    }

    /// Publishes an event of what operators do, now or once this instance leads again: the history has it from that.
    pub(crate) fn publish_operator_event(&mut self, severity: Severity, kind: EventKind) {
        if self.replica.election.has_term() {
            let event = self.replica.event(self.now, severity, kind);
            self.publish_or_keep(event);
        }
    }

    fn publish_or_keep(&mut self, message: Message) {
        if self.replica.election.is_leading() {
            return self.publish(message);
        }
        if self.unsaid.len() >= MAX_UNSAID {
            self.unsaid.pop_front();
        }
        self.unsaid.push_back(message);
    }

    /// Publishes what came of commands while this instance was suspect.
    pub(crate) fn publish_unsaid(&mut self) {
        for message in std::mem::take(&mut self.unsaid) {
            self.publish(message);
        }
    }

    /// Publishes an event of the service, if this instance leads.
    pub(crate) fn publish_event(&mut self, severity: Severity, kind: EventKind) {
        if self.replica.election.has_term() {
            let event = self.replica.event(self.now, severity, kind);
            self.publish_as_leader(event);
        }
    }

    /// Publishes a message, whatever state the instance is in.
    pub(crate) fn publish(&mut self, message: Message) {
        match message.publish(self.now) {
            Ok(outbound) => {
                let space = &self.replica.space;
                let packets = outbound.into_iter().map(|outbound| outbound.into_packet(space));
                self.commands.push(Command::Publish(Publication {
                    packets: packets.collect(),
                    is_lease_renewal: matches!(message, Message::LeaseRenewal(_)),
                    message: Some(message),
                }));
            }
            Err(error) => {
                let problem = format!("{} is not published: {error}", message.keys().0);
                self.commands.push(Command::Unencodable(problem));
            }
        }
    }

    /// Counts a refused message and reports it to operators, and to the robot whose key it stands on, unless
    /// the term has not begun or the like has just been reported.
    pub(crate) fn refuse(&mut self, rejection: Rejection) {
        self.replica.add("messages_refused", 1);
        if !self.replica.election.has_term() {
            return;
        }
        let Some(count) = self.replica.refusals.add(self.now, &rejection) else { return };
        let Rejection { robot, key, reason } = rejection;
        if let Some(robot) = &robot {
            let (robot, key, reason) = (robot.clone(), key.clone(), reason.clone());
            let refused = self.replica.refused(self.now, robot, key, reason, count);
            self.publish_as_leader(refused);
        }
        let kind = EventKind::Quarantined { robot, key, reason, count };
        self.publish_event(Severity::Warning, kind);
    }

    pub(crate) fn fetch(&mut self, purpose: Purpose<F>, patterns: Vec<Pattern>) {
        self.fetch_in(purpose, patterns, AnswerTime::COMPLETE);
    }

    /// A fetch whose questions wait so long for answers.
    pub(crate) fn fetch_in(
        &mut self,
        purpose: Purpose<F>,
        patterns: Vec<Pattern>,
        time: AnswerTime,
    ) {
        let service = self.replica.service;
        let of_leader = [Key::Lease(service), Key::Settings(service), Key::Wishes];
        let of_leader = of_leader.map(Pattern::One).into_iter().chain([Pattern::Commands(service)]);
        let of_leader: Vec<Pattern> = of_leader.collect();
        // After a failure of the router, those who know the last output may need a moment to reconnect. A
        // leader answers at once, or there is none; wishes are on disk as well, and mostly there are none.
        let retries = |pattern: &Pattern| purpose == Purpose::Start && !of_leader.contains(pattern);
        let mut asks = Vec::new();
        let ended = self.fetches.begin(self.now, purpose, patterns, time, retries, &mut asks);
        self.fetched.extend(ended);
        self.commands.extend(asks.into_iter().map(Command::Ask));
    }

    pub(crate) fn abandon_job(&mut self) {
        match self.job {
            JobSlot::Running => self.job = JobSlot::Abandoned,
            JobSlot::Ready(_) => {
                self.job = JobSlot::Free;
                self.commands.retain(|command| *command != Command::RunJob);
            }
            JobSlot::Free | JobSlot::Abandoned => {}
        }
    }

    pub(crate) fn store(&mut self) {
        self.store_again_at = None;
        self.gets.store_started();
        let commands = self.operator_commands.outcomes().map(|outcome| (**outcome).clone());
        let stored = Stored { commands: commands.collect(), ..self.replica.stored() };
        self.commands.push(Command::Store(stored));
    }

    pub(crate) fn reply(
        &mut self,
        get: GetId,
        answer: Result<Vec<Message>, String>,
        kind: ReplyKind,
    ) {
        let Some(request) = self.gets.close(get) else { return };
        let (answer, messages) = match answer {
            Ok(messages) => {
                let packets = encode_answer(&self.replica.space, &request, &messages, self.now);
                (packets, messages)
            }
            Err(error) => (Err(error), Vec::new()),
        };
        let answer = match self.operator_commands.end(get) {
            Some(command) => self.end_command(command, answer),
            None => answer,
        };
        let reply = Reply { get, answer, messages };
        let reply = self.gets.pass(reply, kind == ReplyKind::ConfirmsStore);
        self.commands.extend(reply.map(Command::Reply));
    }

    /// Publishes the settings, so that standbys and other services follow them.
    pub(crate) fn announce_settings(&mut self) {
        let message = self.replica.settings_message(self.now);
        self.publish_as_leader(message);
    }
}

//! One step of a service: one input for its host, and everything that the host wants done.

use std::sync::Arc;

use muster_model::id::{ServiceName, TeamId};
use muster_model::time::Tick;
use muster_model::wish::{StandingWish, WishState};
use muster_service::{Command, GetId, Input, Publication, Reply, Stored};
use muster_wire::{Message, Packet};

use super::clock::{MS, Micros};
use super::link::Way;
use super::oracle::{Verified, breach, check_memory_use};
use super::robots::{TeamReport, read_team_report};
use super::router::{Answer, Carried};
use super::world::{Event, World};

/// How long a host takes over one input, if it is not slow: what the real ones take for a small fleet.
const INPUT_TIME: (Micros, Micros) = (20, 200);

/// How long a job takes, if it is not slow: less than a frame, as for a small fleet.
const JOB_TIME: (Micros, Micros) = (MS, 20 * MS);

/// How long a disk takes to write state: a file, its folder, and two syncs.
const WRITE_TIME: (Micros, Micros) = (MS, 8 * MS);

/// How many timers in a row may lead to nothing before that counts as turning in circles.
const MAX_IDLE_TIMERS: u32 = 200;

/// What is promised of a host by itself.
const CONTRACT: &str = "no core and no job panics or breaks its contract";

/// What is promised of gets.
const ANSWERED_ONCE: &str = "every get is answered once";

impl World {
    /// A service takes one input.
    pub(super) fn step(&mut self, index: usize) {
        let node = &mut self.nodes[index];
        if node.step_at != Some(self.now) {
            return;
        }
        node.step_at = None;
        if self.now < node.busy_until {
            self.schedule_step(index);
            return;
        }
        let Some(input) = node.take_input(self.now) else {
            self.schedule_step(index);
            return;
        };
        if self.log.is_kept() {
            let input = describe(&self.space, &input);
            self.log.line(self.now, format_args!("{} takes {input}", node.name()));
        }
        self.note_received(index, &input);
        let node = &mut self.nodes[index];
        let Some(process) = node.process.as_mut() else { return };
        let now = process.clock.tick(self.now);
        let is_timer = matches!(input, Input::Timer);
        let taken_get = match &input {
            Input::Get(incoming) => Some(incoming.get),
            _ => None,
        };
        match &input {
            Input::JobEnded { panic: None, .. } => {
                process.changes_before_result = process.changes_before_job;
            }
            Input::Stored { .. } => {
                process.stores_ended += u64::from(!self.mutator.is_hasty());
            }
            Input::Kept { .. } => {
                process.keeps_ended += 1;
            }
            _ => {}
        }
        let handled = process.host.handle(now, input);
        let is_idle = is_timer && handled.as_ref().is_ok_and(Vec::is_empty);
        process.idle_timers = if is_idle { process.idle_timers + 1 } else { 0 };
        let circles = process.idle_timers > MAX_IDLE_TIMERS;
        let (held, service) = (process.host.memory_use(), node.service);
        if service == ServiceName::Clusterer {
            self.stats.remembered = self.stats.remembered.max(held.robots);
        }
        let (until, each) = node.slow;
        let time = node.chance.between(INPUT_TIME.0, INPUT_TIME.1);
        node.busy_until = self.now + if until > self.now { each } else { time };
        match handled {
            Ok(commands) => {
                let begins_job = commands.iter().any(|command| matches!(command, Command::RunJob));
                for command in commands {
                    self.carry_out(index, now, command);
                }
                // A leader that is sure again announces the settings that it has after what it has published already.
                if begins_job && let Some(process) = &mut self.nodes[index].process {
                    process.changes_before_job = process.settings_changes;
                }
            }
            Err(misbehaviour) => self.require(breach(CONTRACT, misbehaviour.seen)),
        }
        self.require(check_memory_use(service, held, self.bounds()));
        if circles {
            let seen = format!("{service} is woken again and again and does nothing");
            self.require(breach("a core that waits names a moment to come", seen));
        }
        let checked = self.check_process(index, taken_get);
        self.require(checked);
        self.schedule_step(index);
    }

    /// What must hold of a process after each input.
    fn check_process(&mut self, index: usize, taken_get: Option<GetId>) -> Verified {
        let node = &mut self.nodes[index];
        let (service, process) = (node.service, &mut node.process);
        let Some(process) = process else { return Ok(()) };
        let taken = taken_get.and_then(|get| process.unanswered.get_mut(&get));
        if let Some(taken) = taken {
            taken.stores_before = Some(process.stores_begun);
            taken.keeps_before = process.keeps_begun;
        }
        // Answers wait for the disk, and for nothing else that is asked for here.
        // A planner keeps those who ask for a proposal waiting until it is computed.
        if service != ServiceName::Planner && process.overdue_answers() > 0 {
            return breach(ANSWERED_ONCE, format!("{service} leaves a get unanswered"));
        }
        let (announced, state) = (process.announced_state, process.host.replica_state());
        if announced != state {
            let seen = format!("{service} is {state:?}, and has announced {announced:?}");
            return breach("a host announces where its instance stands", seen);
        }
        Ok(())
    }

    fn carry_out(&mut self, index: usize, now: Tick, command: Command) {
        match command {
            Command::Publish(publication) => self.publish(index, now, publication),
            Command::Reply(reply) => {
                if self.mutator.answers_twice() {
                    self.reply(index, reply.clone());
                }
                self.reply(index, reply);
            }
            Command::RunJob => self.run_job(index),
            Command::Ask(ask) => self.ask_for_host(index, &ask),
            Command::Store(stored) => self.store(index, stored),
            Command::Keep(content) => self.keep(index, content),
            Command::KeptIsUnusable(seen) => {
                self.require(breach("what is kept can be read again", seen));
            }
            Command::ReplicaState(state) => {
                let name = self.nodes[index].name();
                self.log.line(self.now, format_args!("{name} is {state:?}"));
                if let Some(process) = &mut self.nodes[index].process
                    && !self.mutator.is_reticent()
                {
                    process.announced_state = state;
                }
            }
            Command::Unencodable(seen) => {
                self.require(breach("what is published fits its key", seen));
            }
            Command::Append(entry) => {
                if !self.mutator.omits(&entry) {
                    let entry = self.mutator.recorded(*entry);
                    self.with_recorder(index, |recorder| recorder.append(entry));
                }
            }
            Command::LookUp { lookup, query } => {
                let mut page = Err("there are no records".to_owned());
                self.with_recorder(index, |recorder| page = recorder.answer(&query));
                self.nodes[index].complete(Input::Found { lookup, page });
            }
            Command::Retain(retention) => {
                self.with_recorder(index, |recorder| recorder.retain(retention));
            }
            other @ (Command::DeclareToken(_) | Command::WithdrawToken(_)) => {
                // None of the services has tokens of its own.
                let seen = format!("{} wants {other:?}", self.nodes[index].name());
                self.require(breach(CONTRACT, seen));
            }
        }
    }

    fn run_job(&mut self, index: usize) {
        let node = &mut self.nodes[index];
        let Some(process) = &mut node.process else { return };
        let once_more = if self.mutator.is_eager() { process.host.run_job() } else { Ok(()) };
        if let Err(misbehaviour) = once_more.and_then(|()| process.host.run_job()) {
            return self.require(breach(CONTRACT, misbehaviour.seen));
        }
        let (until, each) = node.slow_jobs;
        let time = node.chance.between(JOB_TIME.0, JOB_TIME.1);
        let time = if until > self.now { each } else { time };
        let life = node.life;
        self.schedule(self.now + time, Event::JobEnded { node: index, life });
    }

    /// The disk of a process writes one state after the other.
    fn store(&mut self, index: usize, stored: Stored) {
        let node = &mut self.nodes[index];
        let (name, life) = (node.name(), node.life);
        let Some(process) = &mut node.process else { return };
        self.log.line(self.now, format_args!("{name} stores term {}", stored.term));
        let time = node.chance.between(WRITE_TIME.0, WRITE_TIME.1);
        process.stores_begun += 1;
        process.disk_free_at = process.disk_free_at.max(self.now) + time;
        let at = process.disk_free_at;
        self.schedule(at, Event::Stored { node: index, life, stored });
    }

    /// State is on the disk.
    pub(super) fn stored(&mut self, index: usize, life: u32, stored: Stored) {
        let node = &mut self.nodes[index];
        if node.life == life {
            node.stored = stored;
            node.complete(Input::Stored { error: None });
            self.schedule_step(index);
        }
    }

    /// The disk writes what a core keeps after everything before it.
    fn keep(&mut self, index: usize, content: Vec<u8>) {
        let node = &mut self.nodes[index];
        let Some(process) = &mut node.process else { return };
        let time = node.chance.between(WRITE_TIME.0, WRITE_TIME.1);
        process.keeps_begun += 1;
        process.disk_free_at = process.disk_free_at.max(self.now) + time;
        let (at, life) = (process.disk_free_at, node.life);
        self.schedule(at, Event::Kept { node: index, life, content });
    }

    /// What a core keeps is on the disk.
    pub(super) fn kept(&mut self, index: usize, life: u32, content: Vec<u8>) {
        let node = &mut self.nodes[index];
        if node.life == life {
            node.kept = Some(self.mutator.kept(content));
            node.complete(Input::Kept { error: None });
            self.schedule_step(index);
        }
    }

    fn reply(&mut self, index: usize, reply: Reply) {
        let Reply { get, answer, messages } = reply;
        let (name, publisher) = (self.nodes[index].name(), self.nodes[index].publisher());
        let Some(process) = &mut self.nodes[index].process else { return };
        let now = process.clock.tick(self.now);
        let Some(unanswered) = process.unanswered.remove(&get) else {
            let seen = format!("{name} answers a get twice");
            return self.require(breach(ANSWERED_ONCE, seen));
        };
        let stores_before = unanswered.stores_before.unwrap_or(process.stores_begun);
        if answer.is_ok() && process.stores_ended < stores_before {
            let seen = format!("{name} answers while state is being written");
            self.require(breach("an answer waits for what was stored before", seen));
        }
        let (answer, messages) = if publisher.service == ServiceName::Planner {
            self.mutator.proposed(&self.space, answer, messages, now)
        } else {
            (answer, messages)
        };
        for message in &messages {
            let checked = self.oracle.answered(message);
            self.require(checked);
        }
        let checked = self.oracle.proposed(self.now, publisher, &messages);
        self.require(checked);
        let answer = Arc::new(answer.map_or_else(Answer::Error, Answer::Packets));
        self.send(
            self.nodes[index].link,
            Way::Up,
            &Carried::Answer { get: unanswered.bus_get, answer },
        );
    }

    fn publish(&mut self, index: usize, now: Tick, publication: Publication) {
        let Publication { packets, message, .. } = publication;
        let (name, link) = (self.nodes[index].name(), self.nodes[index].link);
        let Some(message) = message else {
            return self.require(breach(CONTRACT, format!("{name} publishes no message")));
        };
        let (message, packets) = match self.mutator.published(&self.space, message, packets, now) {
            Ok(mutated) => mutated,
            Err(error) => {
                let seen = format!("{name}: {error}");
                return self.require(breach("what is published fits its key", seen));
            }
        };
        match (&message, &mut self.nodes[index].process) {
            (Message::Embedding(embedding), _) => self.log.line(
                self.now,
                format_args!(
                    "{name} embeds {} robots in {} dimensions, which show {:?} teams",
                    embedding.robots.len(),
                    embedding.dimension,
                    embedding.quality.teams_shown,
                ),
            ),
            (Message::Teams { .. }, _) => {
                self.stats.divisions += 1;
                self.division_at = self.now;
            }
            (Message::Settings(new), Some(process)) if new.settings != process.settings => {
                process.settings.clone_from(&new.settings);
                process.settings_changes += 1;
            }
            (Message::Wishes(list), Some(process)) => {
                let counts = list.wishes.iter().filter(|one| one.state != WishState::Expired);
                // A wish for a team that is there at last counts from then on, as if it had just been put.
                let named = |one: &StandingWish| {
                    let waits = one.state == WishState::Waiting;
                    (format!("{}/{} {waits}", one.operator, one.id), one.wish.clone())
                };
                let wishes: Vec<_> = counts.map(named).collect();
                if wishes != process.wishes {
                    process.wishes = wishes;
                    process.settings_changes += 1;
                }
            }
            _ => {}
        }
        if let (Message::Teams { teams, .. }, Some(before)) = (&message, &self.stands) {
            let checked = before.check(teams, &self.oracle);
            self.require(checked);
        }
        if let Message::Event(event) = &message {
            let mirror = packets.iter().find(|packet| packet.key.ends_with("/json/event"));
            let bytes = mirror.and_then(|packet| packet.payload.as_ref().ok());
            let json = bytes.and_then(|bytes| serde_json::from_slice(bytes).ok());
            self.oracle.recorded.published(event, json.unwrap_or_default());
        }
        self.stats.published += 1;
        let checked = self.check_published(index, &message, &packets);
        self.require(checked);
        self.check_promised(index, &message);
        match &message {
            Message::Roster(roster) => self.freshness.roster(self.now, roster.header.revision),
            Message::Teams { teams, .. } => {
                let divided = self.oracle.embeddings.named(teams.embedding).last();
                if let Some(roster) = divided.map(|embedding| embedding.roster) {
                    self.freshness.division(roster);
                }
            }
            _ => {}
        }
        for packet in packets {
            let packet = self.mutator.carried(&self.space, packet, now);
            self.send(link, Way::Up, &Carried::Put(Arc::new(packet)));
        }
    }

    /// What a service publishes is checked as others decode it from its bytes.
    fn check_published(&mut self, index: usize, message: &Message, packets: &[Packet]) -> Verified {
        let node = &self.nodes[index];
        let packet = match message {
            Message::RobotTeam(report) => {
                let bytes = packets.first().and_then(|packet| packet.payload.as_ref().ok());
                let read = bytes.and_then(|bytes| read_team_report(bytes));
                let is_same = |read: &TeamReport| {
                    read.revision == report.header.revision
                        && read.team.as_deref() == report.team.as_ref().map(TeamId::as_str)
                };
                if !read.as_ref().is_some_and(is_same) {
                    let seen = format!("{} is sent {read:?} for {report:?}", report.robot);
                    return breach("a robot can read the team that it is sent", seen);
                }
                // It is JSON for robots; services read it in binary.
                Some(message.to_packet(&self.space))
            }
            _ => packets.first().cloned(),
        };
        let now = Tick(self.now);
        let decoded = packet.map(|packet| match message {
            // Robots read it, and no service does.
            Message::Refused(_) => muster_wire::refused::decode(&self.space, &packet, now)
                .map(|refused| Message::Refused(Box::new(refused))),
            _ => Message::decode(&self.space, &packet),
        });
        let Some(Ok(decoded)) = decoded else {
            let seen = format!("{}: {decoded:?}", node.name());
            return breach("what a service publishes, others understand", seen);
        };
        let process = node.process.as_ref();
        let settings = process.map_or(0, |process| process.changes_before_result);
        self.oracle.published(self.now, node.publisher(), settings, &decoded)
    }

    /// The time of a job is over.
    pub(super) fn job_ended(&mut self, index: usize, life: u32) {
        let node = &mut self.nodes[index];
        if node.life == life {
            let panics = self.now < node.panics_until;
            self.stats.panics += u64::from(panics);
            let panic = panics.then(|| "a panic that the simulation wants".to_owned());
            node.complete(Input::JobEnded { laps: Vec::new(), panic });
            self.schedule_step(index);
        }
    }
}

/// An input in a few words, for the log.
fn describe(space: &muster_wire::KeySpace, input: &Input) -> String {
    match input {
        Input::Arrived(arrival) => match arrival.clone().into_message(space) {
            Ok(message) => match message.header() {
                Some(header) => {
                    let revision = header.revision;
                    format!("{} {}.{}", message.keys().0, revision.term, revision.epoch)
                }
                None => match message {
                    Message::RobotToken { robot, alive } => format!("token of {robot}: {alive}"),
                    _ => message.keys().0.to_string(),
                },
            },
            Err(refused) => format!("a refused packet on {}: {}", refused.key, refused.reason),
        },
        Input::Answered { ask, answers } => {
            let keys = answers.iter().map(|answer| answer.packet().key.as_str());
            format!("the answers to question {}: {}", ask.0, keys.collect::<Vec<_>>().join(", "))
        }
        Input::Get(get) => format!("a get of {get:?}"),
        Input::Started { .. } => "its start".to_owned(),
        Input::Timer => "its timer".to_owned(),
        Input::JobEnded { panic: Some(_), .. } => "the panic of its job".to_owned(),
        Input::JobEnded { panic: None, .. } => "the end of its job".to_owned(),
        Input::LinkLost => "the loss of its link".to_owned(),
        Input::LinkRestored => "the return of its link".to_owned(),
        Input::Stored { .. } => "that its state is on the disk".to_owned(),
        Input::Restored(_) => "what it has kept".to_owned(),
        Input::Kept { .. } => "that what it keeps is on the disk".to_owned(),
        Input::Found { .. }
        | Input::Recorded(_)
        | Input::ProcessCounters(_)
        | Input::StateLost { .. } => input.kind().to_owned(),
    }
}

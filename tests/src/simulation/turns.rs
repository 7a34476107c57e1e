//! What a service does in its turn: one event in, everything that follows out.

use std::sync::Arc;

use muster_model::id::{ServiceName, TeamId};
use muster_model::time::Tick;
use muster_wire::Message;

use super::clock::{MS, Micros};
use super::link::Way;
use super::machine::{Input, Output};
use super::oracle::{Verdict, breach, check_footprint};
use super::robots::{Told, read_told};
use super::router::{Answer, Carried};
use super::world::{Event, World};

/// How long a service takes over one event, if it is not slow.
const EVENT: (Micros, Micros) = (20, 200);

/// How long a job takes, if it is not slow.
const JOB: (Micros, Micros) = (MS, 20 * MS);

/// How long keeping state takes.
const DISK: (Micros, Micros) = (MS, 8 * MS);

/// How often in a row a core may be woken by its own deadline and want nothing, before that counts as
/// turning in circles.
const IDLE_TIMEOUTS: u32 = 200;

impl World {
    /// A service takes one piece of work.
    pub(super) fn turn(&mut self, index: usize) {
        let node = &mut self.nodes[index];
        if node.turn_at != Some(self.now) {
            return;
        }
        node.turn_at = None;
        if self.now < node.busy_until {
            self.kick(index);
            return;
        }
        let Some(input) = node.take_work(self.now, &self.space) else {
            self.kick(index);
            return;
        };
        if self.log.is_kept() {
            self.log.line(self.now, format_args!("{} takes {}", node.name(), text(&input)));
        }
        let Some(process) = node.process.as_mut() else { return };
        let tick = process.clock.tick(self.now);
        let is_timeout = matches!(input, Input::Timeout);
        if matches!(input, Input::JobEnded { panicked: false }) {
            process.announced_before_result = process.announced_before_job;
        }
        let query = match &input {
            Input::Query { query, .. } => Some(*query),
            _ => None,
        };
        let outputs = process.machine.step(tick, input);
        process.idle = if is_timeout && outputs.is_empty() { process.idle + 1 } else { 0 };
        let circles = process.idle > IDLE_TIMEOUTS;
        let (held, service) = (process.machine.footprint(), node.service);
        if service == ServiceName::Clusterer {
            self.stats.remembered = self.stats.remembered.max(held.robots);
        }
        let (until, each) = node.slow;
        let cost = if until > self.now { each } else { node.chance.between(EVENT.0, EVENT.1) };
        node.busy_until = self.now + cost;
        for output in outputs {
            self.carry_out(index, tick, output);
        }
        self.judged(check_footprint(service, held, self.bounds()));
        if circles {
            let seen = format!("{service} is woken again and again and does nothing");
            self.judged(breach("a core that waits names a moment to come", seen));
        }
        let owes =
            |query| self.nodes[index].process.as_ref().is_some_and(|p| p.owed.contains_key(&query));
        if query.is_some_and(owes) {
            let seen = format!("{service} leaves a get unanswered");
            self.judged(breach("every get is answered once", seen));
        }
        self.kick(index);
    }

    fn carry_out(&mut self, index: usize, now: Tick, output: Output) {
        let name = self.nodes[index].name();
        match output {
            Output::Publish(message) => self.publish(index, now, message),
            Output::Reply { query, request, answer } => {
                let owed = self.nodes[index]
                    .process
                    .as_mut()
                    .and_then(|process| process.owed.remove(&query));
                let Some(get) = owed else {
                    let seen = format!("{name} answers a get twice");
                    self.judged(breach("every get is answered once", seen));
                    return;
                };
                for message in answer.iter().flatten() {
                    let verdict = self.judge.answered(message);
                    self.judged(verdict);
                }
                let answer = answer.and_then(|messages| {
                    let mut packets = Vec::new();
                    for message in messages {
                        let outbound = message.answer(&self.space, &request, now);
                        let outbound = outbound.map_err(|error| error.to_string())?;
                        packets.extend(
                            outbound.into_iter().map(|outbound| outbound.into_packet(&self.space)),
                        );
                    }
                    Ok(packets)
                });
                let answer = Arc::new(answer.map_or_else(Answer::Error, Answer::Packets));
                let life = self.nodes[index].life;
                let at = self.errand(index, 0);
                self.schedule(at, Event::Reply { node: index, life, get, answer });
            }
            Output::Started => {
                let node = &mut self.nodes[index];
                if let Some(process) = &mut node.process {
                    process.announced_before_job = process.announced;
                }
                let (until, each) = node.slow_jobs;
                let lasts = if until > self.now { each } else { node.chance.between(JOB.0, JOB.1) };
                let life = node.life;
                self.schedule(self.now + lasts, Event::JobEnded { node: index, life });
            }
            Output::Fetch { fetch, patterns } => self.begin_fetch(index, fetch, &patterns),
            Output::Store(stored) => {
                self.log.line(self.now, format_args!("{name} keeps term {}", stored.term));
                let life = self.nodes[index].life;
                let lasts = self.nodes[index].chance.between(DISK.0, DISK.1);
                let at = self.errand(index, lasts);
                self.schedule(at, Event::Store { node: index, life, stored });
            }
            Output::Broken(seen) => {
                self.judged(breach("no core and no job panics or breaks its contract", seen));
            }
        }
    }

    /// When the errands thread of a process has done one more thing.
    fn errand(&mut self, index: usize, lasts: Micros) -> Micros {
        let Some(process) = self.nodes[index].process.as_mut() else { return self.now };
        process.errands_free = process.errands_free.max(self.now) + lasts;
        process.errands_free
    }

    fn publish(&mut self, index: usize, now: Tick, message: Message) {
        let message = self.saboteur.core(message);
        let (name, link) = (self.nodes[index].name(), self.nodes[index].link);
        let outbound = match message.publish(now) {
            Ok(outbound) => outbound,
            Err(error) => {
                let seen = format!("{name}: {}: {error}", message.keys().0);
                self.judged(breach("what is published fits its key", seen));
                return;
            }
        };
        match (&message, &mut self.nodes[index].process) {
            (Message::Teams { .. }, _) => self.stats.divisions += 1,
            (Message::Settings(told), Some(process)) if told.settings != process.settings => {
                process.settings.clone_from(&told.settings);
                process.announced += 1;
            }
            _ => {}
        }
        self.stats.published += 1;
        let verdict = self.judge_published(index, &message);
        self.judged(verdict);
        for outbound in outbound {
            if let Message::RobotTeam(told) = &message {
                let read = read_told(&outbound.payload);
                let same = |read: &Told| {
                    read.revision == told.header.revision
                        && read.team.as_deref() == told.team.as_ref().map(TeamId::as_str)
                };
                if !read.as_ref().is_some_and(same) {
                    let seen = format!("{} is told {read:?} for {told:?}", told.robot);
                    self.judged(breach("a robot can read what it is told", seen));
                }
            }
            let packet = outbound.into_packet(&self.space);
            let packet = self.saboteur.bus(&self.space, packet, now);
            self.send(link, Way::Up, &Carried::Put(Arc::new(packet)));
        }
    }

    /// What a service publishes is judged as it decodes from its bytes, where others can decode it.
    fn judge_published(&mut self, index: usize, message: &Message) -> Verdict {
        let node = &self.nodes[index];
        let (key, _) = message.keys();
        let bytes = message.encode(key, muster_wire::Format::Binary, Tick(0));
        let decoded = match bytes {
            Ok(outbound) => {
                let packet = outbound.into_packet(&self.space);
                match Message::decode(&self.space, &packet) {
                    Ok(decoded) => decoded,
                    Err(refused) => {
                        return breach(
                            "what a service publishes, others understand",
                            format!("{}: {refused:?}", node.name()),
                        );
                    }
                }
            }
            Err(error) => {
                return breach("what is published has a binary form", format!("{error}"));
            }
        };
        let process = node.process.as_ref();
        let settings = process.map_or(0, |process| process.announced_before_result);
        self.judge.published(self.now, node.speaker(), settings, &decoded)
    }

    /// A job has ended, as far as the world is concerned.
    pub(super) fn job_ended(&mut self, index: usize, life: u32) {
        let node = &mut self.nodes[index];
        if node.life == life {
            let panicked = self.now < node.panics_until;
            self.stats.panics += u64::from(panicked);
            node.end(Input::JobEnded { panicked });
            self.kick(index);
        }
    }
}

fn text(input: &Input) -> String {
    match input {
        Input::Received(Ok(message)) => match message.header() {
            Some(header) => {
                format!("{} {}.{}", message.keys().0, header.revision.term, header.revision.epoch)
            }
            None => match message {
                Message::RobotToken { robot, alive } => format!("token of {robot}: {alive}"),
                _ => message.keys().0.to_string(),
            },
        },
        Input::Received(Err(refused)) => {
            format!("a refused packet on {}: {}", refused.key, refused.reason)
        }
        Input::Fetched { fetch, messages } => {
            let found: Vec<_> =
                messages.iter().map(|message| message.keys().0.to_string()).collect();
            format!("fetch {fetch}: {}", found.join(", "))
        }
        Input::Query { request, .. } => {
            format!("a get of {request:?}")
        }
        Input::Started => "its start".to_owned(),
        Input::Timeout => "its deadline".to_owned(),
        Input::JobEnded { panicked: true } => "the panic of its job".to_owned(),
        Input::JobEnded { panicked: false } => "the end of its job".to_owned(),
        Input::LinkLost => "that its link is lost".to_owned(),
        Input::LinkRestored => "that its link is back".to_owned(),
    }
}

//! Events in, effects out: what is let in, what is judged when, and what is told.

use std::time::Duration;

use muster_machine::{
    Answered, Core, Delivery, Effect, Effects, Event, Footprint, QueryId, Role, START_FETCH, Start,
    Stopwatch, Subscription, TERM_FETCH, Turn, Wiring,
};
use muster_model::event::{EventKind, Severity};
use muster_model::id::{RobotId, ServiceName};
use muster_model::observation::CheckedReport;
use muster_model::role::Standing;
use muster_model::settings::IngestSettings;
use muster_model::status::ServiceStatus;
use muster_model::time::Tick;
use muster_wire::{Key, Message, Pattern, Request};

use crate::admission::{self, Observed, Refusal};
use crate::frames::Frames;
use crate::restore;
use crate::robot::{Change, Patience, Transition};
use crate::roster::Fleet;

/// How long after the first robot of a start from nothing the first frame waits for the others. The
/// robots of a fleet join within a moment; a first division of half a fleet would number the teams by
/// whoever happened to be heard first.
const GATHERING: Duration = Duration::from_secs(1);

/// From the streams of the robots to one weighted directed graph per modality.
///
/// Messages only mark what they change; presence is judged and frames are made when a deadline
/// passes, so that one frame holds everything that came together. Until the term has begun messages
/// are taken in and nothing is told; while the link is lost nobody is judged and no frame is made.
#[derive(Debug)]
pub struct Ingest {
    role: Role<IngestSettings>,
    fleet: Fleet,
    frames: Frames,
    link_lost: Option<Tick>,
    /// Whether nobody was known in this run so far.
    unpeopled: bool,
    /// No frame is made before this.
    gathered: Tick,
}

impl Ingest {
    fn receive(&mut self, now: Tick, message: Message, effects: &mut Effects<()>) {
        match message {
            Message::Report(report) => self.report(now, report, effects),
            Message::RobotToken { robot, alive } => {
                match self.fleet.token(now, &robot, alive, self.role.settings()) {
                    Ok(change) => self.changed(now, &robot, change, effects),
                    Err(refusal) => self.refuse(now, &Key::RobotToken(robot), refusal, effects),
                }
            }
            // Nothing else is subscribed to.
            _ => {}
        }
    }

    fn report(&mut self, now: Tick, report: CheckedReport, effects: &mut Effects<()>) {
        let (robot, report) = report.into_parts();
        let stream = report.stream();
        match admission::observed(self.role.settings(), report) {
            Ok(observed) => self.observe(now, &robot, observed, effects),
            Err(reason) => self.refuse(now, &Key::Stream(robot, stream), reason.into(), effects),
        }
    }

    fn observe(
        &mut self,
        now: Tick,
        robot: &RobotId,
        observed: Observed,
        effects: &mut Effects<()>,
    ) {
        let stream = observed.stream.clone();
        let absurd = admission::has_absurd_stamp(now, &observed.provenance);
        match self.fleet.observe(now, robot, observed, self.role.settings()) {
            Ok(change) => {
                self.role.count(admission::accepted(&stream));
                self.role.count_many("stamps_absurd", u64::from(absurd));
                if change.graph {
                    self.frames.touch(now, &stream);
                }
                self.changed(now, robot, change, effects);
            }
            Err(refusal) => {
                self.refuse(now, &Key::Stream(robot.clone(), stream), refusal, effects);
            }
        }
    }

    fn changed(&mut self, now: Tick, robot: &RobotId, change: Change, effects: &mut Effects<()>) {
        if change.joined {
            if std::mem::take(&mut self.unpeopled) {
                self.gathered = now.after(GATHERING);
            }
            self.frames.touch_members(now);
            self.tell_joined(now, robot.clone(), effects);
        }
        if change.roster {
            self.frames.touch_roster(now);
        }
        if self.is_judging() {
            let patience = Patience::from(self.role.settings());
            if self.fleet.has_recovered(now, robot, patience) {
                self.tell_transition(now, robot.clone(), Transition::Recovered, effects);
            }
        }
    }

    fn refuse(&mut self, now: Tick, key: &Key, refusal: Refusal, effects: &mut Effects<()>) {
        let reason = match refusal {
            Refusal::Late(reason) | Refusal::Doubtful(reason) => {
                self.role.count("messages_late");
                reason
            }
            Refusal::Wrong(reason) => reason,
        };
        self.role.refuse(now, key, &reason, effects);
    }

    /// Counts and tells that a robot joined. Who did before the term began is told of as it begins.
    fn tell_joined(&mut self, now: Tick, robot: RobotId, effects: &mut Effects<()>) {
        if self.role.has_term() {
            self.role.count("robots_joined");
            self.role.tell(now, Severity::Info, EventKind::RobotJoined { robot }, effects);
        }
    }

    fn tell_transition(
        &mut self,
        now: Tick,
        robot: RobotId,
        transition: Transition,
        effects: &mut Effects<()>,
    ) {
        let (severity, kind) = match transition {
            Transition::Stale => (Severity::Warning, EventKind::RobotStale { robot }),
            Transition::Recovered => (Severity::Info, EventKind::RobotRecovered { robot }),
            Transition::Left => (Severity::Warning, EventKind::RobotLeft { robot }),
        };
        if transition == Transition::Left {
            self.role.count("robots_left");
            self.frames.touch_members(now);
        }
        self.frames.touch_roster(now);
        self.role.tell(now, severity, kind, effects);
    }

    /// Whether silence says something about the robots, and somebody may be told of it.
    fn is_judging(&self) -> bool {
        self.role.is_holding() && self.link_lost.is_none()
    }

    fn take_event(&mut self, now: Tick, event: Event<()>, effects: &mut Effects<()>) {
        match event {
            Event::Started => {
                self.role.ask(vec![Pattern::One(Key::Roster), Pattern::Graphs], effects);
            }
            Event::Received(message) => self.receive(now, message, effects),
            Event::Rejected(rejection) => self.role.quarantine(now, rejection, effects),
            Event::Timeout => self.advance(now, effects),
            Event::Fetched { fetch: START_FETCH, messages } if self.role.is_beginning() => {
                self.begin(now, &messages, effects);
            }
            Event::Fetched { fetch: TERM_FETCH, messages } => {
                self.check_term(now, &messages, effects);
            }
            Event::Query { query, request } => self.answer(now, query, request, effects),
            Event::LinkLost => {
                self.link_lost.get_or_insert(now);
            }
            Event::LinkRestored => self.restore_link(now, effects),
            // There are no jobs and no further fetches.
            Event::Fetched { .. } | Event::Done(()) | Event::JobFailed(_) => {}
        }
    }

    /// Goes back to before the first frame. What robots have said stays: some of it they say once.
    fn stand_down(&mut self, now: Tick) {
        self.frames = Frames::default();
        self.link_lost = None;
        self.fleet.spare_all(now);
    }

    /// Whether another instance judges the robots, and this one only keeps up.
    fn is_following(&self) -> bool {
        self.role.standing() == Standing::Standby && self.link_lost.is_none()
    }

    fn begin(&mut self, now: Tick, messages: &[Message], effects: &mut Effects<()>) {
        // They may be those of another holder, taken over.
        self.apply_settings(now);
        let settings = self.role.settings();
        let restored = restore::restore(now, messages, settings, &mut self.fleet);
        self.role.count_many("robots_restored", restored.len() as u64);
        self.role.begin_term(now, restore::highest_revision(messages), effects);
        let joined = self.fleet.robots().keys().filter(|robot| !restored.contains(*robot));
        for robot in joined.cloned().collect::<Vec<_>>() {
            self.tell_joined(now, robot, effects);
        }
        self.unpeopled = self.fleet.robots().is_empty();
        if !restored.is_empty() {
            self.gathered = now;
        } else if self.unpeopled {
            // Readers may still hold a roster: they are told that nobody is there, but not before
            // those who are had a moment to say so.
            self.gathered = now.after(GATHERING);
        }
        self.frames.touch_members(now);
    }

    /// Takes in what readers have seen of the role, and publishes everything anew if that began a new
    /// term.
    fn check_term(&mut self, now: Tick, found: &[Message], effects: &mut Effects<()>) {
        if !self.role.checked(now, found, effects) {
            return;
        }
        self.fleet.renumber();
        self.frames = Frames::default();
        self.frames.declare(now, &self.role.settings().modalities);
        self.frames.touch_members(now);
    }

    fn advance(&mut self, now: Tick, effects: &mut Effects<()>) {
        if self.is_following() && self.fleet.next_judgement().is_some_and(|at| at <= now) {
            // The holder tells of it.
            self.fleet.judge(now, self.role.settings());
        }
        if !self.is_judging() {
            return;
        }
        if self.fleet.next_judgement().is_some_and(|at| at <= now) {
            for (robot, transition) in self.fleet.judge(now, self.role.settings()) {
                self.tell_transition(now, robot, transition, effects);
            }
        }
        if self.next_frame().is_some_and(|at| at <= now) {
            for message in self.frames.make(now, &self.fleet, &mut self.role) {
                effects.publish(message);
            }
        }
    }

    fn next_frame(&self) -> Option<Tick> {
        self.frames.due(self.role.settings()).map(|due| due.max(self.gathered))
    }

    fn restore_link(&mut self, now: Tick, effects: &mut Effects<()>) {
        self.role.link_restored(now);
        let Some(lost) = self.link_lost.take() else { return };
        self.fleet.spare_all(now);
        let outage_s = now.since(lost).as_secs_f64();
        self.role.tell(now, Severity::Warning, EventKind::LinkRestored { outage_s }, effects);
    }

    fn answer(&mut self, now: Tick, query: QueryId, request: Request, effects: &mut Effects<()>) {
        let state = self.state();
        match self.role.answer(now, query, request, &state, effects) {
            Answered::Done => {}
            Answered::SettingsChanged => self.apply_settings(now),
            Answered::NotOurs(query, request) => {
                let answer = Ok(self.frames.answer(self.role.space(), &request));
                effects.push(Effect::Reply { query, request, answer });
            }
        }
    }

    fn apply_settings(&mut self, now: Tick) {
        let modalities = &self.role.settings().modalities;
        self.fleet.keep_modalities(modalities);
        self.fleet.judge_soon(now);
        self.frames.declare(now, modalities);
    }

    fn state(&self) -> String {
        if !self.role.has_term() {
            return "waiting for the bus".to_owned();
        }
        let robots = self.fleet.robots().len();
        let plural = if robots == 1 { "" } else { "s" };
        let stale = self.fleet.stale_count();
        let link = if self.link_lost.is_some() { ", the link to the router is lost" } else { "" };
        format!("{robots} robot{plural}, {stale} stale{link}")
    }
}

impl Core for Ingest {
    type Settings = IngestSettings;
    type Job = ();
    type Done = ();
    const SERVICE: ServiceName = ServiceName::Ingest;

    fn wiring() -> Wiring {
        let subscription = |pattern| Subscription { pattern, delivery: Delivery::Latest };
        Wiring {
            subscriptions: Pattern::streams().map(subscription).into(),
            tokens: vec![Pattern::RobotTokens],
            served: vec![(Pattern::Graphs, true), (Pattern::One(Key::Roster), true)],
        }
    }

    fn new(start: Start<IngestSettings>) -> Self {
        let now = start.now;
        let role = Role::new(Self::SERVICE, start);
        let mut frames = Frames::default();
        frames.declare(now, &role.settings().modalities);
        let fleet = Fleet::default();
        Self { role, fleet, frames, link_lost: None, unpeopled: true, gathered: now }
    }

    fn handle(&mut self, now: Tick, event: Event<()>, effects: &mut Effects<()>) {
        self.frames.told(now);
        match self.role.attend(now, event, effects) {
            Turn::Events(events) => {
                events.into_iter().for_each(|event| self.take_event(now, event, effects));
            }
            Turn::StandDown => {
                self.stand_down(now);
                self.take_event(now, Event::Started, effects);
            }
        }
        self.role.advance(now, Pattern::One(Key::Roster), effects);
    }

    fn deadline(&self) -> Option<Tick> {
        let (judging, following) = (self.is_judging(), self.is_following());
        let judgement = self.fleet.next_judgement().filter(|_| judging || following);
        let frame = self.next_frame().filter(|_| judging);
        let telling = self.frames.telling().filter(|_| judging);
        [judgement, frame, telling, self.role.deadline()].into_iter().flatten().min()
    }

    fn standing(&self) -> Standing {
        self.role.standing()
    }

    fn status(&self, now: Tick) -> ServiceStatus {
        self.role.status(now, &self.state())
    }

    fn footprint(&self) -> Footprint {
        Footprint {
            robots: self.fleet.record_count(),
            edges: self.fleet.reported_edge_count() + self.frames.edge_count(),
            messages: self.frames.roster_count(),
            offenders: self.role.offender_count(),
        }
    }

    fn run((): (), _: &mut Stopwatch) {}
}

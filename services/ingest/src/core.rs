//! Events in, effects out: what is let in, what is judged when, and what is told.

use muster_machine::{
    Answered, Core, Delivery, Effect, Effects, Event, QueryId, Role, START_FETCH, Start,
    Subscription, Wiring,
};
use muster_model::event::{EventKind, Severity};
use muster_model::id::{RobotId, ServiceName};
use muster_model::limits::MAX_ROBOT_PAYLOAD;
use muster_model::settings::IngestSettings;
use muster_model::time::Tick;
use muster_wire::{Key, Message, Pattern, Rejection, Request};

use crate::admission::{self, Observed, Refusal};
use crate::frames::Frames;
use crate::restore;
use crate::robot::{Change, Patience, Transition};
use crate::roster::Fleet;

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
}

impl Ingest {
    fn receive(&mut self, now: Tick, message: Message, effects: &mut Effects<()>) {
        let settings = self.role.settings();
        let (robot, key, observed) = match message {
            Message::Pose(robot, pose) => {
                let observed = admission::pose(settings, pose);
                (robot.clone(), Key::Pose(robot), observed)
            }
            Message::Links(robot, links) => {
                let observed = admission::links(settings, &robot, links);
                (robot.clone(), Key::Links(robot), observed)
            }
            Message::Rank(robot, rank) => {
                let observed = admission::rank(&robot, rank);
                (robot.clone(), Key::Rank(robot), observed)
            }
            Message::Relation(robot, modality, relation) => {
                let observed = admission::relation(settings, &robot, &modality, relation);
                (robot.clone(), Key::Relation(robot, modality), observed)
            }
            Message::RobotToken { robot, alive } => {
                let outcome = self.fleet.token(now, &robot, alive, settings);
                match outcome {
                    Ok(change) => self.changed(now, &robot, change, effects),
                    Err(refusal) => self.refuse(now, &Key::RobotToken(robot), refusal, effects),
                }
                return;
            }
            // Nothing else is subscribed to.
            _ => return,
        };
        match observed {
            Ok(observed) => self.observe(now, &robot, observed, effects),
            Err(reason) => self.refuse(now, &key, reason.into(), effects),
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
                self.role.count(stream.accepted());
                self.role.count_many("stamps_absurd", u64::from(absurd));
                if change.graph {
                    self.frames.touch(now, &stream);
                }
                self.changed(now, robot, change, effects);
            }
            Err(refusal) => self.refuse(now, &stream.key(robot), refusal, effects),
        }
    }

    fn changed(&mut self, now: Tick, robot: &RobotId, change: Change, effects: &mut Effects<()>) {
        if change.joined {
            self.role.count("robots_joined");
            self.frames.touch_members(now);
            self.tell(
                now,
                Severity::Info,
                EventKind::RobotJoined { robot: robot.clone() },
                effects,
            );
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
            Refusal::Late(reason) => {
                self.role.count("messages_late");
                reason
            }
            Refusal::Wrong(reason) => reason,
        };
        let space = self.role.space();
        let rejection = Rejection::new(space, &space.format(key), reason);
        self.quarantine(now, rejection, effects);
    }

    fn quarantine(&mut self, now: Tick, rejection: Rejection, effects: &mut Effects<()>) {
        if self.role.is_holding() {
            self.role.quarantine(now, rejection, effects);
        } else {
            self.role.count("messages_refused");
        }
    }

    /// Tells an event, once the term has begun.
    fn tell(&mut self, now: Tick, severity: Severity, kind: EventKind, effects: &mut Effects<()>) {
        if self.role.is_holding() {
            self.role.tell(now, severity, kind, effects);
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
        self.tell(now, severity, kind, effects);
    }

    /// Whether silence says something about the robots, and somebody may be told of it.
    fn is_judging(&self) -> bool {
        self.role.is_holding() && self.link_lost.is_none()
    }

    fn begin(&mut self, now: Tick, messages: &[Message], effects: &mut Effects<()>) {
        let settings = self.role.settings();
        let restored = restore::restore(now, messages, settings, &mut self.fleet);
        self.role.count_many("robots_restored", restored.len() as u64);
        self.role.begin_term(now, restore::highest_revision(messages), effects);
        let joined = self.fleet.robots().keys().filter(|robot| !restored.contains(*robot));
        for robot in joined.cloned().collect::<Vec<_>>() {
            self.tell(now, Severity::Info, EventKind::RobotJoined { robot }, effects);
        }
        self.frames.touch_members(now);
    }

    fn advance(&mut self, now: Tick, effects: &mut Effects<()>) {
        if !self.is_judging() {
            return;
        }
        if self.fleet.next_judgement().is_some_and(|at| at <= now) {
            for (robot, transition) in self.fleet.judge(now, self.role.settings()) {
                self.tell_transition(now, robot, transition, effects);
            }
        }
        if self.frames.due(&self.fleet, self.role.settings()).is_some_and(|at| at <= now) {
            for message in self.frames.make(now, &self.fleet, &mut self.role) {
                effects.publish(message);
            }
        }
    }

    fn restore_link(&mut self, now: Tick, effects: &mut Effects<()>) {
        let Some(lost) = self.link_lost.take() else { return };
        self.fleet.forgive_outage(lost, now);
        let outage_s = now.since(lost).as_secs_f64();
        self.tell(now, Severity::Warning, EventKind::LinkRestored { outage_s }, effects);
    }

    fn answer(&mut self, now: Tick, query: QueryId, request: Request, effects: &mut Effects<()>) {
        let state = self.state();
        match self.role.answer(now, query, request, &state, effects) {
            Answered::Done => {}
            Answered::SettingsChanged => {
                let modalities = &self.role.settings().modalities;
                self.fleet.keep_modalities(modalities);
                self.fleet.judge_soon(now);
                self.frames.declare(now, modalities);
            }
            Answered::NotOurs(query, request) => {
                let answer = Ok(self.frames.answer(self.role.space(), &request));
                effects.push(Effect::Reply { query, request, answer });
            }
        }
    }

    fn state(&self) -> String {
        if !self.role.is_holding() {
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
        let streams = [Pattern::Poses, Pattern::Links, Pattern::Ranks, Pattern::Relations];
        let subscription = |pattern| Subscription {
            pattern,
            delivery: Delivery::Latest,
            max_payload: MAX_ROBOT_PAYLOAD,
        };
        Wiring {
            subscriptions: streams.map(subscription).into(),
            tokens: vec![Pattern::RobotTokens],
            served: vec![(Pattern::Graphs, true), (Pattern::One(Key::Roster), true)],
        }
    }

    fn new(start: Start<IngestSettings>) -> Self {
        let now = start.now;
        let role = Role::new(Self::SERVICE, start);
        let mut frames = Frames::default();
        frames.declare(now, &role.settings().modalities);
        Self { role, fleet: Fleet::default(), frames, link_lost: None }
    }

    fn handle(&mut self, now: Tick, event: Event<()>, effects: &mut Effects<()>) {
        match event {
            Event::Started => effects.push(Effect::Fetch {
                fetch: START_FETCH,
                patterns: vec![Pattern::One(Key::Roster), Pattern::Graphs],
            }),
            Event::Received(message) => self.receive(now, message, effects),
            Event::Rejected(rejection) => self.quarantine(now, rejection, effects),
            Event::Timeout => self.advance(now, effects),
            Event::Fetched { fetch: START_FETCH, messages } if !self.role.is_holding() => {
                self.begin(now, &messages, effects);
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

    fn deadline(&self) -> Option<Tick> {
        if !self.is_judging() {
            return None;
        }
        let frame = self.frames.due(&self.fleet, self.role.settings());
        self.fleet.next_judgement().into_iter().chain(frame).min()
    }

    fn run((): ()) {}
}

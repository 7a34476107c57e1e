//! What is accepted, when presence changes, and what is published.

use std::time::Duration;

use muster_model::event::{EventKind, Severity};
use muster_model::id::{RobotId, ServiceName};
use muster_model::observation::CheckedReport;
use muster_model::role::ReplicaState;
use muster_model::settings::IngestSettings;
use muster_model::status::Departure;
use muster_model::time::Tick;
use muster_service::{
    Connectivity, Core, Delivery, Get, MemoryUse, ServedKey, Stopwatch, Subscription, Wiring,
};
use muster_wire::{Key, Message, Pattern};

use crate::admission::{self, Observed, Refusal};
use crate::frames::Frames;
use crate::presence::{Departures, GATHERING_WINDOW, PresenceEvents};
use crate::restore;
use crate::robot::{Change, GracePeriods, Transition};
use crate::roster::Fleet;

type Context<'a> = muster_service::Context<'a, Ingest>;
type View<'a> = muster_service::View<'a, Ingest>;

/// How long after the first robot of a start from nothing the first frame waits for the others. The
/// robots of a fleet join within a moment; a first division of half a fleet would number the teams by
/// which robots happened to come first.
const GATHERING_TIME: Duration = Duration::from_secs(1);

/// Whether the silence of a robot proves anything.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Reception {
    /// Robots can be received.
    Online,
    /// This process was paused, and nothing was received meanwhile.
    Paused,
    /// The link to the router is lost.
    Offline {
        /// Since when.
        since: Tick,
    },
}

/// From the streams of the robots to one weighted directed graph per modality.
///
/// Messages only mark what they change; presence is updated and frames are made when a deadline
/// passes, so that one frame holds everything that came together. An instance that does not lead
/// accepts messages and publishes nothing. While the link is lost no presence changes and no frame is
/// made.
#[derive(Debug)]
pub struct Ingest {
    fleet: Fleet,
    frames: Frames,
    presence_events: PresenceEvents,
    departures: Departures,
    reception: Reception,
    /// Whether no robot was known in this run so far.
    is_without_robots: bool,
    /// No frame is made before this.
    gathered: Tick,
}

impl Ingest {
    fn accept_report(&mut self, context: &mut Context<'_>, report: CheckedReport) {
        let (robot, report) = report.into_parts();
        let stream = report.stream();
        match admission::observed(context.settings(), report) {
            Ok(observed) => self.observe(context, &robot, observed),
            Err(refusal) => refuse(context, &Key::Stream(robot, stream), &refusal),
        }
    }

    fn observe(&mut self, context: &mut Context<'_>, robot: &RobotId, observed: Observed) {
        let now = context.now();
        let stream = observed.stream.clone();
        let absurd = admission::has_absurd_stamp(now, &observed.provenance);
        match self.fleet.observe(now, robot, observed, context.settings()) {
            Ok(change) => {
                context.count(admission::accepted(&stream));
                context.add("stamps_absurd", u64::from(absurd));
                if change.graph {
                    self.frames.touch(now, &stream);
                }
                self.changed(context, robot, change);
            }
            Err(refusal) => refuse(context, &Key::Stream(robot.clone(), stream), &refusal),
        }
    }

    fn changed(&mut self, context: &mut Context<'_>, robot: &RobotId, change: Change) {
        let now = context.now();
        if change.joined {
            if std::mem::take(&mut self.is_without_robots) {
                self.gathered = now.after(GATHERING_TIME);
            }
            self.frames.touch_members(now);
            self.departures.returned(robot);
            self.presence_events.hasten(now, robot);
            self.report_presence(context);
            report_joined(context, robot.clone());
        }
        if change.roster {
            self.frames.touch_roster(now);
        }
        if self.is_publishing(&context.view()) {
            let grace = GracePeriods::from(context.settings());
            if self.fleet.has_recovered(now, robot, grace) {
                // Others that were lost with it may be back as well.
                let more = self.fleet.has_stale();
                self.changed_presence(context, robot.clone(), Transition::Recovered, more);
                self.report_presence(context);
            }
        }
    }

    /// The presence of a robot has changed. With `more`, that of others may follow within a moment.
    fn changed_presence(
        &mut self,
        context: &mut Context<'_>,
        robot: RobotId,
        transition: Transition,
        more: bool,
    ) {
        let now = context.now();
        if transition == Transition::Left {
            context.count("robots_left");
            self.frames.touch_members(now);
            self.departures.left(now, robot.clone());
        }
        self.frames.touch_roster(now);
        self.presence_events.add(now, robot, transition, more);
    }

    /// Publishes the events of changed presence that are due.
    fn report_presence(&mut self, context: &mut Context<'_>) {
        for (severity, kind) in self.presence_events.take(context.now()) {
            context.publish_event(severity, kind);
        }
    }

    /// Brings the presence of all robots up to date, and reports it.
    fn update_presence(&mut self, context: &mut Context<'_>) {
        let now = context.now();
        let transitions = self.fleet.update_presence(now, context.settings());
        let grace = GracePeriods::from(context.settings());
        let more =
            !transitions.is_empty() && self.fleet.changes_within(now, GATHERING_WINDOW, grace);
        for (robot, transition) in transitions {
            self.changed_presence(context, robot, transition, more);
        }
    }

    /// The link to the router is lost. That is noticed about as long after the last message as robots are
    /// marked stale, so a robot whose silence was not reported yet was silent because of the link.
    fn go_offline(&mut self, now: Tick) {
        self.reception = Reception::Offline { since: now };
        let fleet = &mut self.fleet;
        self.presence_events.take_stale_back(|robot| fleet.take_stale_back(robot));
        self.frames.touch_roster(now);
    }

    /// Brings the presence of all robots up to date while the leader reports it.
    fn follow_presence(&mut self, context: &Context<'_>) {
        let now = context.now();
        for (robot, transition) in self.fleet.update_presence(now, context.settings()) {
            if transition == Transition::Left {
                self.departures.left(now, robot);
            }
        }
    }

    /// Whether this instance leads and can receive robots, so that it publishes their presence and frames.
    fn is_publishing(&self, view: &View<'_>) -> bool {
        view.is_leading() && self.reception == Reception::Online
    }

    /// Whether another instance publishes, and this one only follows.
    fn is_following(&self, view: &View<'_>) -> bool {
        view.replica_state() == ReplicaState::Standby && self.reception == Reception::Online
    }

    fn next_frame(&self, settings: &IngestSettings) -> Option<Tick> {
        self.frames.due(settings).map(|due| due.max(self.gathered))
    }

    fn apply_settings(&mut self, context: &Context<'_>) {
        let modalities = &context.settings().modalities;
        self.fleet.keep_modalities(modalities);
        self.fleet.update_presence_soon(context.now());
        self.frames.declare(context.now(), modalities);
    }
}

fn refuse(context: &mut Context<'_>, key: &Key, refusal: &Refusal) {
    let is_late = |refusal: &Refusal| {
        matches!(refusal, Refusal::Late(_) | Refusal::Ambiguous(_) | Refusal::TwoPrograms { .. })
    };
    if is_late(refusal) {
        context.count("messages_late");
    }
    context.refuse(key, refusal.to_string());
}

/// Counts and reports that a robot joined. One that did before the term began is reported then.
fn report_joined(context: &mut Context<'_>, robot: RobotId) {
    if context.has_term() {
        context.count("robots_joined");
        context.publish_event(Severity::Info, EventKind::RobotJoined { robot });
    }
}

impl Core for Ingest {
    type Settings = IngestSettings;
    type Fetch = std::convert::Infallible;
    type Job = std::convert::Infallible;
    type Done = std::convert::Infallible;
    const SERVICE: ServiceName = ServiceName::Ingest;

    fn wiring() -> Wiring {
        let subscription = |pattern| Subscription { pattern, delivery: Delivery::Latest };
        Wiring {
            subscriptions: Pattern::streams().map(subscription).into(),
            tokens: vec![Pattern::RobotTokens],
            fetched: vec![],
            served: vec![
                ServedKey::own(Pattern::Graphs),
                ServedKey::own(Pattern::One(Key::Roster)),
            ],
        }
    }

    fn initial() -> Vec<Pattern> {
        vec![Pattern::One(Key::Roster), Pattern::Graphs]
    }

    fn output() -> Key {
        Key::Roster
    }

    fn is_output(message: &Message) -> bool {
        matches!(message, Message::Roster(_) | Message::Graph(_))
    }

    fn new(now: Tick, settings: &IngestSettings) -> Self {
        let mut frames = Frames::default();
        frames.declare(now, &settings.modalities);
        Self {
            fleet: Fleet::default(),
            frames,
            presence_events: PresenceEvents::default(),
            departures: Departures::default(),
            reception: Reception::Online,
            is_without_robots: true,
            gathered: now,
        }
    }

    fn on_lead(&mut self, context: &mut Context<'_>, answers: Vec<Message>) {
        let now = context.now();
        // The settings may be those of another leader, taken over.
        self.apply_settings(context);
        let restored = restore::restore(now, &answers, context.settings(), &mut self.fleet);
        context.add("robots_restored", restored.len() as u64);
        let joined = self.fleet.robots().keys().filter(|robot| !restored.contains(*robot));
        for robot in joined.cloned().collect::<Vec<_>>() {
            report_joined(context, robot);
        }
        self.is_without_robots = self.fleet.robots().is_empty();
        if !restored.is_empty() {
            self.gathered = now;
        } else if self.is_without_robots {
            // Readers may still hold a roster: they receive the empty one once robots had time to join.
            self.gathered = now.after(GATHERING_TIME);
        }
        self.frames.touch_members(now);
    }

    fn on_follow(&mut self, _context: &mut Context<'_>, _answers: Vec<Message>) {}

    /// Goes back to before the first frame. What robots have reported stays: some of it they report
    /// once.
    fn on_stand_down(&mut self, context: &mut Context<'_>) {
        self.frames = Frames::default();
        // The next leader reports its own.
        self.presence_events = PresenceEvents::default();
        self.reception = Reception::Online;
        self.fleet.extend_all_grace(context.now());
    }

    fn on_new_term(&mut self, context: &mut Context<'_>, _found: Vec<Message>) {
        let now = context.now();
        self.fleet.renumber();
        self.frames = Frames::default();
        self.frames.declare(now, &context.settings().modalities);
        self.frames.touch_members(now);
    }

    fn on_message(&mut self, context: &mut Context<'_>, message: Message) {
        match message {
            Message::Report(report) => self.accept_report(context, report),
            Message::RobotToken { robot, alive } => {
                match self.fleet.token(context.now(), &robot, alive, context.settings()) {
                    Ok(change) => self.changed(context, &robot, change),
                    Err(refusal) => refuse(context, &Key::RobotToken(robot), &refusal),
                }
            }
            // Nothing else is subscribed to.
            _ => {}
        }
    }

    fn on_get(&mut self, context: &mut Context<'_>, get: Get) {
        let answer = self.frames.answer(context.space(), &get.request);
        context.reply(get, answer);
    }

    fn on_timer(&mut self, context: &mut Context<'_>) {
        let now = context.now();
        let is_due = self.fleet.presence_deadline().is_some_and(|at| at <= now);
        if is_due && self.is_following(&context.view()) {
            self.follow_presence(context);
        }
        if !self.is_publishing(&context.view()) {
            return;
        }
        if is_due {
            self.update_presence(context);
        }
        self.report_presence(context);
        if self.next_frame(context.settings()).is_some_and(|at| at <= now) {
            for message in self.frames.make(context, &self.fleet) {
                context.publish(message);
            }
        }
    }

    fn on_settings(&mut self, context: &mut Context<'_>) {
        self.apply_settings(context);
    }

    fn on_connectivity(&mut self, context: &mut Context<'_>, connectivity: Connectivity) {
        let now = context.now();
        match (connectivity, self.reception) {
            (Connectivity::Offline, Reception::Online | Reception::Paused) => {
                self.go_offline(now);
            }
            (Connectivity::Paused, Reception::Online) => self.reception = Reception::Paused,
            (Connectivity::Online, Reception::Paused) => {
                self.reception = Reception::Online;
                self.fleet.extend_all_grace(now);
            }
            (Connectivity::Online, Reception::Offline { since }) => {
                self.reception = Reception::Online;
                self.fleet.extend_all_grace(now);
                let outage_s = now.since(since).as_secs_f64();
                context.publish_event(Severity::Warning, EventKind::LinkRestored { outage_s });
            }
            (Connectivity::Online, Reception::Online)
            | (Connectivity::Paused, Reception::Paused)
            | (Connectivity::Offline | Connectivity::Paused, Reception::Offline { .. }) => {}
        }
    }

    fn before_input(&mut self, now: Tick) {
        self.frames.published(now);
    }

    fn deadline(&self, view: &View<'_>) -> Option<Tick> {
        let (publishing, following) = (self.is_publishing(view), self.is_following(view));
        let presence = self.fleet.presence_deadline().filter(|_| publishing || following);
        let frame = self.next_frame(view.settings()).filter(|_| publishing);
        let made = self.frames.publishing().filter(|_| publishing);
        let events = self.presence_events.due().filter(|_| publishing);
        [presence, frame, made, events].into_iter().flatten().min()
    }

    fn state(&self, view: &View<'_>) -> String {
        if !view.has_term() {
            return "waiting for the bus".to_owned();
        }
        let robots = self.fleet.robots().len();
        let plural = if robots == 1 { "" } else { "s" };
        let stale = self.fleet.stale_count();
        let link = match self.reception {
            Reception::Offline { .. } => ", the link to the router is lost",
            Reception::Paused => ", the process was paused",
            Reception::Online => "",
        };
        format!("{robots} robot{plural}, {stale} stale{link}")
    }

    fn departed(&self, now: Tick) -> Vec<Departure> {
        self.departures.recent(now)
    }

    fn memory_use(&self) -> MemoryUse {
        MemoryUse {
            robots: self.fleet.record_count() + self.departures.len(),
            edges: self.fleet.reported_edge_count() + self.frames.edge_count(),
            messages: self.frames.roster_count(),
            offenders: 0,
        }
    }

    fn run(job: Self::Job, _stopwatch: &mut Stopwatch) -> Self::Done {
        job
    }
}

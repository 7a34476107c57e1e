//! What an instance does with the settings of its role, and when a doubt is over.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use std::time::Duration;

use muster_machine::{
    Answered, Effect, Effects, Event, QueryId, Role, START_FETCH, Start, Stored, TERM_FETCH, Turn,
};
use muster_model::header::{Header, Revision};
use muster_model::id::{FleetId, InstanceId, ServiceName};
use muster_model::role::{Claim, Standing};
use muster_model::settings::ClustererSettings;
use muster_model::time::Tick;
use muster_wire::envelope::AnnouncedSettings;
use muster_wire::{Key, Message, Pattern, Request};

const START: Tick = Tick(1_000_000_000);
const OWN: Pattern = Pattern::One(Key::Teams);

struct Bench {
    role: Role<ClustererSettings>,
    now: Tick,
    effects: Effects<()>,
}

/// What an instance wanted done, as far as it is looked at here.
#[derive(Default)]
struct Wanted {
    /// The numbers of teams in the settings that it has announced.
    announced: Vec<u32>,
    doubts: Vec<u32>,
    answers: Vec<Message>,
}

impl Bench {
    fn new() -> Self {
        let start = Start {
            fleet: FleetId::new("f").unwrap(),
            instance: InstanceId::of_process("b", 1, 1),
            now: START,
            settings: ClustererSettings::default(),
            stored: Stored::default(),
        };
        let role = Role::new(ServiceName::Clusterer, start);
        Self { role, now: START, effects: Effects::default() }
    }

    /// One that has asked the bus and was answered.
    fn answered(messages: Vec<Message>) -> Self {
        let mut bench = Self::new();
        bench.role.ask(Vec::new(), &mut bench.effects);
        bench.attend(Event::Fetched { fetch: START_FETCH, messages });
        bench
    }

    fn holding() -> Self {
        let mut bench = Self::answered(Vec::new());
        bench.role.begin_term(bench.now, None, &mut bench.effects);
        bench.wanted();
        bench
    }

    /// What is left of an event for the core.
    fn events(&mut self, event: Event<()>) -> Vec<Event<()>> {
        match self.role.attend(self.now, event, &mut self.effects) {
            Turn::Events(events) => events,
            Turn::StandDown => Vec::new(),
        }
    }

    /// Does what every core does with an event.
    fn attend(&mut self, event: Event<()>) {
        for event in self.events(event) {
            if matches!(event, Event::LinkRestored) {
                self.role.link_restored(self.now);
            }
        }
        self.role.advance(self.now, OWN, &mut self.effects);
    }

    fn wait(&mut self, seconds: f64) {
        let end = self.now.after(Duration::from_secs_f64(seconds));
        while self.now < end {
            self.now = self.now.after(Duration::from_millis(500)).min(end);
            self.attend(Event::Timeout);
        }
    }

    fn get_settings(&mut self, patch: Option<&str>) -> Answered {
        let key = self.role.space().format(&Key::Settings(ServiceName::Clusterer));
        let request = Request::new(key, "", patch.map(|patch| patch.as_bytes().to_vec())).unwrap();
        self.role.answer(self.now, QueryId(1), request, "", &mut self.effects)
    }

    fn hear_settings(&mut self, term: u64, epoch: u64, teams: u32) -> u32 {
        self.attend(Event::Received(settings(term, epoch, teams)));
        self.role.settings().teams
    }

    fn wanted(&mut self) -> Wanted {
        let mut wanted = Wanted::default();
        for effect in self.effects.drain() {
            match effect {
                Effect::Publish(Message::Settings(announced)) => {
                    let settings: ClustererSettings =
                        serde_json::from_str(&announced.settings).unwrap();
                    wanted.announced.push(settings.teams);
                }
                Effect::Fetch { fetch, patterns }
                    if patterns == [Pattern::One(Key::Holder(ServiceName::Clusterer))] =>
                {
                    wanted.doubts.push(fetch);
                }
                Effect::Reply { answer, .. } => wanted.answers.extend(answer.unwrap()),
                _ => {}
            }
        }
        wanted
    }
}

fn header(term: u64, epoch: u64) -> Header {
    Header {
        fleet: FleetId::new("f").unwrap(),
        revision: Revision { term, epoch },
        oldest: None,
        newest: None,
        stages: Vec::new(),
    }
}

fn settings(term: u64, epoch: u64, teams: u32) -> Message {
    let settings = ClustererSettings { teams, ..ClustererSettings::default() };
    Message::Settings(Box::new(AnnouncedSettings {
        header: header(term, epoch),
        service: ServiceName::Clusterer,
        settings: serde_json::to_string(&settings).unwrap(),
    }))
}

fn claim(host: &str, term: u64, epoch: u64) -> Message {
    Message::Claim(Box::new(Claim {
        header: header(term, epoch),
        service: ServiceName::Clusterer,
        instance: InstanceId::of_process(host, 1, 1),
    }))
}

#[test]
fn a_holder_announces_its_settings_again_and_again() {
    let mut bench = Bench::holding();
    bench.wait(4.5);
    assert!(bench.wanted().announced.is_empty());
    bench.wait(0.5);
    assert_eq!(bench.wanted().announced, [ClustererSettings::default().teams]);
    bench.wait(10.0);
    assert_eq!(bench.wanted().announced.len(), 2);
}

#[test]
fn what_was_changed_in_doubt_is_announced_once_the_doubt_is_over() {
    let mut bench = Bench::holding();
    bench.attend(Event::LinkLost);
    assert!(matches!(bench.get_settings(Some(r#"{"teams":7}"#)), Answered::SettingsChanged));
    bench.attend(Event::LinkRestored);
    let fetch = bench.wanted().doubts[0];
    bench.attend(Event::Fetched { fetch, messages: Vec::new() });
    assert_eq!(bench.role.standing(), Standing::Holding);
    assert_eq!(bench.wanted().announced, [7]);
}

#[test]
fn who_stands_by_goes_by_the_newest_settings() {
    let mut bench = Bench::answered(vec![claim("a", 7, 5), settings(7, 5, 5)]);
    assert_eq!((bench.role.standing(), bench.role.settings().teams), (Standing::Standby, 5));
    assert_eq!(bench.hear_settings(6, 9, 3), 5, "a holder before");
    assert_eq!(bench.hear_settings(7, 4, 3), 5, "overtaken on the way");
    assert_eq!(bench.hear_settings(7, 5, 6), 6, "changed between two outputs");
    // Nobody stands behind these, and they must not shut out the holder's for good.
    assert_eq!(bench.hear_settings(9, 1, 9), 9);
    assert_eq!(bench.hear_settings(6, 9, 3), 9);
    assert_eq!(bench.hear_settings(7, 5, 6), 6);
}

#[test]
fn who_held_the_role_goes_by_the_settings_of_whoever_holds_it_now() {
    let mut bench = Bench::holding();
    bench.role.next_revision();
    bench.get_settings(Some(r#"{"teams":7}"#));
    bench.attend(Event::LinkLost);
    bench.attend(Event::LinkRestored);
    let fetch = bench.wanted().doubts[0];
    bench.attend(Event::Fetched { fetch, messages: vec![claim("a", 2, 5)] });
    assert!(!bench.role.has_term());
    assert_eq!(bench.hear_settings(1, 0, 3), 7, "of before its own");
    assert_eq!(bench.hear_settings(2, 5, 5), 5);
}

#[test]
fn who_begins_takes_over_what_a_holder_in_doubt_could_not_announce() {
    let bench = Bench::answered(vec![settings(7, 5, 5)]);
    assert!(bench.role.is_beginning());
    assert_eq!(bench.role.settings().teams, 5);
}

#[test]
fn who_starts_tells_its_settings_and_nobody_takes_them_over() {
    let mut bench = Bench::new();
    assert!(matches!(bench.get_settings(None), Answered::Done));
    let told = bench.wanted().answers;
    assert_eq!(told[0].header().unwrap().revision, Revision::default());
    let mut other = Bench::answered(vec![settings(0, 0, 9)]);
    assert_eq!(other.role.settings().teams, ClustererSettings::default().teams);
    assert_eq!(other.hear_settings(0, 0, 9), ClustererSettings::default().teams);
}

/// What is asked on a link that the other end has given up is answered by nobody.
#[test]
fn a_holder_that_goes_on_is_silent_until_its_link_has_proved_sound() {
    let goes_on = || {
        let mut bench = Bench::holding();
        let (service, instance) = (ServiceName::Clusterer, InstanceId::of_process("a", 1, 1));
        bench.attend(Event::Received(Message::ServiceToken { service, instance, alive: true }));
        bench.now = bench.now.after(Duration::from_secs(3));
        bench.attend(Event::Timeout);
        let fetch = bench.wanted().doubts[0];
        bench.attend(Event::Fetched { fetch, messages: Vec::new() });
        assert_eq!(bench.role.standing(), Standing::Doubtful);
        bench
    };
    let mut linked = goes_on();
    linked.wait(1.0);
    assert_eq!(linked.role.standing(), Standing::Holding);

    let mut cut_off = goes_on();
    cut_off.attend(Event::LinkLost);
    cut_off.wait(60.0);
    assert_eq!(cut_off.role.standing(), Standing::Doubtful);
    cut_off.attend(Event::LinkRestored);
    let fetch = cut_off.wanted().doubts[0];
    cut_off.attend(Event::Fetched { fetch, messages: vec![claim("a", 2, 1)] });
    assert_eq!(cut_off.role.standing(), Standing::Starting);
}

/// Both have begun the same term while they could not hear each other.
#[test]
fn who_raises_its_term_in_doubt_has_its_link_back() {
    let mut bench = Bench::holding();
    let (service, instance) = (ServiceName::Clusterer, InstanceId::of_process("c", 1, 1));
    bench.attend(Event::LinkLost);
    bench.attend(Event::LinkRestored);
    bench.attend(Event::Received(Message::ServiceToken { service, instance, alive: true }));
    let events = bench.events(Event::Received(claim("c", 1, 0)));
    assert!(matches!(events[..], [Event::LinkRestored, Event::Fetched { fetch: TERM_FETCH, .. }]));
}

#[test]
fn a_question_from_before_a_doubt_does_not_end_it() {
    let mut bench = Bench::holding();
    for event in [Event::LinkLost, Event::LinkRestored, Event::LinkLost, Event::LinkRestored] {
        bench.attend(event);
    }
    let doubts = bench.wanted().doubts;
    assert_eq!(doubts.len(), 2);
    bench.attend(Event::Fetched { fetch: doubts[0], messages: Vec::new() });
    assert_eq!(bench.role.standing(), Standing::Doubtful);
    bench.attend(Event::Fetched { fetch: doubts[1], messages: vec![claim("a", 2, 1)] });
    assert_eq!(bench.role.standing(), Standing::Starting);
}

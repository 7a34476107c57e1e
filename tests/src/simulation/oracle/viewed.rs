//! What viewers of Foxglove see and are answered, judged from outside.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use muster_foxglove::scene::{Color, Entity, Message};
use muster_foxglove::{Input, Parameter, RequestId, TEAMS, Topic, WEIGHTS};
use muster_model::id::{RobotId, ServiceName};
use muster_model::roster::Roster;
use muster_model::teams::Teams;
use serde_json::Value;

use super::super::clock::{Micros, SECOND};
use super::super::page::Pace;
use super::super::viewers::Waiting;
use super::{Verified, breach};

/// What is promised of scenes.
const SHOWN: &str = "viewers that read show the division that all agree on, and lost robots grey";

/// What is promised of parameters.
const CONFIRMED: &str = "parameters are shown as services confirmed them";

/// What is promised of changes.
const REASONED: &str = "a change that is refused is reported with its reason";

/// How long a scene stays with a viewer that receives no other one.
pub(crate) const SCENE_LIFETIME: Micros = 4 * SECOND;

/// How long a viewer must have watched before what it shows is compared: twice the longest time between two looks.
const WATCHED_FOR: Micros = 4 * SECOND;

/// Most scenes of one topic in a second.
const SCENES_A_SECOND: usize = 10;

/// A viewer as it is known from outside.
#[derive(Debug)]
pub(crate) struct Viewer {
    pub(crate) pace: Pace,
    /// What it watches, and since when.
    pub(crate) watches: BTreeMap<Topic, Micros>,
    waiting: Waiting,
    /// What it draws of the teams, and when each was last there.
    scene: BTreeMap<String, (Entity, Micros)>,
    frames: BTreeMap<String, [f64; 3]>,
    parameters: BTreeMap<String, Value>,
}

impl Viewer {
    pub(crate) fn new(pace: Pace) -> Self {
        Self {
            pace,
            watches: BTreeMap::new(),
            waiting: Waiting::new(),
            scene: BTreeMap::new(),
            frames: BTreeMap::new(),
            parameters: BTreeMap::new(),
        }
    }

    /// Whether it reads what it is sent.
    pub(crate) fn reads(&self) -> bool {
        self.pace != Pace::Never
    }

    /// It watches a topic no longer.
    pub(crate) fn unwatch(&mut self, topic: &Topic) {
        self.watches.remove(topic);
        self.waiting.retain(|(other, _)| other != topic);
        if *topic == Topic::Teams {
            self.scene.clear();
        }
    }

    /// A message waits for it; true if another one made room.
    pub(crate) fn queue(&mut self, topic: &Topic, message: &Arc<Message>, most: usize) -> bool {
        self.waiting.push_back((topic.clone(), Arc::clone(message)));
        self.waiting.len() > most && self.waiting.pop_front().is_some()
    }

    /// It reads everything that waits.
    pub(crate) fn read(&mut self, now: Micros) {
        for (topic, message) in std::mem::take(&mut self.waiting) {
            match message.as_ref() {
                Message::Scene(scene) if topic == Topic::Teams => {
                    for entity in &scene.entities {
                        self.scene.insert(entity.id.clone(), (entity.clone(), now));
                    }
                    for id in &scene.removed {
                        self.scene.remove(id);
                    }
                }
                Message::Transforms(all) => {
                    let places = all.iter().map(|one| (one.child.clone(), one.position));
                    self.frames.extend(places);
                }
                _ => {}
            }
        }
        self.scene.retain(|_, (_, at)| now < *at + SCENE_LIFETIME);
    }

    /// It is sent parameters.
    pub(crate) fn show(&mut self, parameters: &[Parameter]) {
        for Parameter { name, value } in parameters {
            self.parameters.insert(name.clone(), value.clone().unwrap_or_default());
        }
    }

    /// What it shows of settings is what services have.
    pub(crate) fn check_parameters(
        &self,
        number: usize,
        settings: &BTreeMap<ServiceName, Value>,
    ) -> Verified {
        for (name, service, field) in NAMES {
            let holds = settings.get(&service).map(|settings| &settings[field]);
            if self.parameters.get(name) != holds {
                let shown = self.parameters.get(name);
                let seen =
                    format!("viewer {number} shows {name} as {shown:?}, and it is {holds:?}");
                return breach(CONFIRMED, seen);
            }
        }
        Ok(())
    }

    /// The entities of a name, in all frames.
    fn entities(&self, name: &str) -> impl Iterator<Item = &Entity> {
        let is_named = move |id: &str| id.split('@').next() == Some(name);
        self.scene.values().map(|(entity, _)| entity).filter(move |entity| is_named(&entity.id))
    }

    fn balls(&self, name: &str) -> Vec<[f64; 3]> {
        let mut all: Vec<[f64; 3]> = self
            .entities(name)
            .flat_map(|entity| entity.spheres.iter().map(|ball| ball.at))
            .collect();
        all.sort_by(|left, right| left.partial_cmp(right).unwrap_or(std::cmp::Ordering::Equal));
        all
    }
}

/// The parameters, and where each stands among the settings.
const NAMES: [(&str, ServiceName, &str); 2] =
    [(TEAMS, ServiceName::Clusterer, "teams"), (WEIGHTS, ServiceName::Embedder, "weights")];

/// A question or a change of a viewer.
#[derive(Debug)]
struct Open {
    at: Micros,
    viewer: usize,
    /// Why services refused it.
    refused: Vec<String>,
    is_reported: bool,
}

/// What is remembered of the process that runs.
#[derive(Debug, Default)]
pub(crate) struct Viewed {
    /// Where each robot was last that this process knows.
    seen: BTreeMap<RobotId, Option<[f64; 3]>>,
    confirmed: BTreeMap<ServiceName, Value>,
    open: BTreeMap<RequestId, Open>,
    /// The change that is being handled, and that of each command.
    handled: Option<RequestId>,
    tickets: BTreeMap<u64, (RequestId, ServiceName)>,
    /// How many scenes each topic had in the second that goes on.
    sent: BTreeMap<Topic, (Micros, usize)>,
}

impl Viewed {
    /// The core takes an input.
    pub(crate) fn takes(&mut self, input: &Input) {
        self.handled = None;
        match input {
            Input::Roster(roster, _) => {
                let seen = roster.robots.iter().map(|entry| (entry.robot.clone(), entry.position));
                self.seen.extend(seen);
            }
            Input::Settings(service, settings) => {
                self.confirmed.insert(*service, settings.clone());
            }
            Input::Set(request, _) => self.handled = Some(*request),
            _ => {}
        }
    }

    fn opens(&mut self, request: RequestId, at: Micros, viewer: usize) {
        let open = Open { at, viewer, refused: Vec::new(), is_reported: false };
        self.open.insert(request, open);
    }

    /// A viewer asks for parameters, or wants others.
    pub(crate) fn asked(&mut self, request: RequestId, now: Micros, viewer: usize) {
        self.opens(request, now, viewer);
    }

    /// The core commands a service.
    pub(crate) fn commands(
        &mut self,
        ticket: u64,
        service: ServiceName,
        may_change: bool,
    ) -> Verified {
        let Some(request) = self.handled.filter(|_| may_change) else {
            return breach(
                "viewers of a program that is read-only change nothing",
                format!("{ticket}"),
            );
        };
        self.tickets.insert(ticket, (request, service));
        Ok(())
    }

    /// A service has answered a command.
    pub(crate) fn answered(&mut self, ticket: u64, answer: &Result<Value, String>) {
        let Some((request, service)) = self.tickets.remove(&ticket) else { return };
        match answer {
            Ok(settings) => {
                self.confirmed.insert(service, settings.clone());
            }
            Err(reason) => {
                let open = self.open.get_mut(&request);
                open.into_iter().for_each(|open| open.refused.push(reason.clone()));
            }
        }
    }

    /// Parameters are shown to viewers.
    pub(crate) fn shows(&self, parameters: &[Parameter]) -> Verified {
        for Parameter { name, value } in parameters {
            let place = NAMES.iter().find(|(known, ..)| known == name);
            let holds =
                place.and_then(|(_, service, field)| self.confirmed.get(service)?.get(*field));
            if holds != value.as_ref() {
                let seen = format!("{name} is shown as {value:?}, and {holds:?} was confirmed");
                return breach(CONFIRMED, seen);
            }
        }
        Ok(())
    }

    /// A question or a change is answered; whose it was.
    pub(crate) fn responds(
        &mut self,
        request: RequestId,
        parameters: &[Parameter],
    ) -> Result<usize, super::Breach> {
        let Some(open) = self.open.remove(&request) else {
            return breach("whatever a viewer asks for is answered once", format!("{request}"));
        };
        if !open.refused.is_empty() && !open.is_reported {
            return breach(REASONED, format!("{request} was refused for {:?}", open.refused));
        }
        self.shows(parameters)?;
        Ok(open.viewer)
    }

    /// A change is refused.
    pub(crate) fn refuses(&mut self, request: RequestId, reason: &str) -> Verified {
        let Some(open) = self.open.get_mut(&request) else {
            return breach(REASONED, format!("{request} is refused, and no one waits for it"));
        };
        open.is_reported = true;
        let missing = open.refused.iter().find(|refused| !reason.contains(refused.as_str()));
        match missing {
            Some(missing) => breach(REASONED, format!("{missing} is not in {reason:?}")),
            None if reason.is_empty() => breach(REASONED, "the reason is empty"),
            None => Ok(()),
        }
    }

    /// Whatever was asked is answered in time.
    pub(crate) fn check_answered(&self, now: Micros, within: Micros) -> Verified {
        match self.open.iter().find(|(_, open)| open.at + within < now) {
            Some((request, open)) => {
                let seen = format!("{request} of viewer {} waits since {}", open.viewer, open.at);
                breach("whatever a viewer asks for is answered once", seen)
            }
            None => Ok(()),
        }
    }

    /// A scene is sent.
    pub(crate) fn sends(&mut self, now: Micros, topic: &Topic) -> Verified {
        let second = now / SECOND;
        let (at, count) = self.sent.entry(topic.clone()).or_insert((second, 0));
        if *at != second {
            (*at, *count) = (second, 0);
        }
        *count += 1;
        // Several events may be sent at once.
        if *topic != Topic::Events && *count > SCENES_A_SECOND {
            return breach(
                "a topic has at most ten scenes a second",
                format!("{topic:?}: {count}"),
            );
        }
        Ok(())
    }

    /// What a viewer draws is the fleet as it is.
    pub(crate) fn check_scene(
        &self,
        now: Micros,
        number: usize,
        viewer: &Viewer,
        roster: &Roster,
        teams: &Teams,
    ) -> Verified {
        if viewer.watches.get(&Topic::Teams).is_none_or(|since| now < since + WATCHED_FOR) {
            return Ok(());
        }
        let places: BTreeMap<&RobotId, [f64; 3]> = roster
            .robots
            .iter()
            .filter_map(|entry| Some((&entry.robot, entry.position?)))
            .collect();
        let sorted = |mut all: Vec<[f64; 3]>| {
            all.sort_by(|left, right| left.partial_cmp(right).unwrap_or(std::cmp::Ordering::Equal));
            all
        };
        let wrong = |what: &str, shown: &[[f64; 3]], expected: &[[f64; 3]]| {
            let seen =
                format!("viewer {number} shows {what} at {shown:?}, and not at {expected:?}");
            breach(SHOWN, seen)
        };
        for team in &teams.teams {
            let name = format!("team/{}", team.id);
            let members =
                team.members.iter().filter_map(|member| places.get(&member.robot).copied());
            let (shown, expected) = (viewer.balls(&name), sorted(members.collect()));
            if shown != expected {
                return wrong(&name, &shown, &expected);
            }
            let leader = ("leader", team.leader.to_string());
            if viewer.entities(&name).any(|entity| !entity.facts.contains(&leader)) {
                return breach(SHOWN, format!("viewer {number} shows another leader of {name}"));
            }
            let of_team = viewer.entities(&name).flat_map(|entity| &entity.spheres);
            let of_team: BTreeSet<[u64; 3]> = of_team.map(|ball| bits(ball.color)).collect();
            if of_team.len() > 1 {
                return breach(SHOWN, format!("viewer {number} shows {name} in several colours"));
            }
        }
        let others = viewer.scene.keys().filter_map(|id| id.strip_prefix("team/"));
        let mut others = others.filter_map(|id| id.split('@').next());
        if let Some(other) =
            others.find(|id| teams.teams.iter().all(|team| team.id.as_str() != *id))
        {
            return breach(SHOWN, format!("viewer {number} shows a team {other} that has ended"));
        }
        let lost = self
            .seen
            .iter()
            .filter(|(robot, _)| roster.robots.iter().all(|entry| entry.robot != **robot));
        let expected = sorted(lost.filter_map(|(_, place)| *place).collect());
        let shown = viewer.balls("missing");
        if shown != expected {
            return wrong("lost robots", &shown, &expected);
        }
        let mut balls = viewer.entities("missing").flat_map(|entity| &entity.spheres);
        let is_grey = |color: Color| color.r == color.g && color.g == color.b;
        if balls.any(|ball| !is_grey(ball.color)) {
            return breach(SHOWN, format!("viewer {number} shows lost robots in colours"));
        }
        Ok(())
    }
}

fn bits(color: Color) -> [u64; 3] {
    [color.r, color.g, color.b].map(f64::to_bits)
}

#[cfg(test)]
mod tests {
    use super::super::samples::promise;
    use super::*;

    #[test]
    fn a_change_by_a_viewer_of_a_program_that_is_read_only_is_seen() {
        let mut viewed = Viewed::default();
        viewed.takes(&Input::Set(1, Vec::new()));
        assert_eq!(viewed.commands(1, ServiceName::Clusterer, true), Ok(()));
        assert_eq!(
            promise(viewed.commands(2, ServiceName::Clusterer, false)),
            "viewers of a program that is read-only change nothing"
        );
    }

    #[test]
    fn a_second_answer_and_a_missing_one_are_seen() {
        let mut viewed = Viewed::default();
        viewed.asked(1, 0, 3);
        assert_eq!(viewed.check_answered(10, 10), Ok(()));
        let once = "whatever a viewer asks for is answered once";
        assert_eq!(promise(viewed.check_answered(11, 10)), once);
        assert_eq!(viewed.responds(1, &[]), Ok(3));
        assert_eq!(promise(viewed.responds(1, &[]).map(|_| ())), once);
    }
}

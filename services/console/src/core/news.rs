//! What is new of the fleet: it is kept, asked for again in time, and turned into the texts of the topics.

use std::sync::Arc;

use muster_model::embedding::EmbeddingGraph;
use muster_model::event::Event;
use muster_model::id::Modality;
use muster_model::roster::Roster;
use muster_model::time::Tick;
use muster_wire::{Format, Key, Message};
use serde_json::{Map, Value, json};

use super::limits::MAX_EVENTS;
use super::topics::Topic;
use super::{Console, Fetch, Input, Output, Stale};

/// A message as it stands on the bus, in JSON; null if it cannot be written.
fn bus_json(message: &Message, key: Key, now: Tick) -> Value {
    let encoded = message.encode(key, Format::Json, now).ok();
    encoded.and_then(|encoded| serde_json::from_slice(&encoded.payload).ok()).unwrap_or_default()
}

impl Console {
    /// Takes what is new of the fleet.
    pub(super) fn learn(&mut self, now: Tick, input: Input) {
        match input {
            Input::Roster(roster, stale) => {
                self.fresh("roster", stale);
                let modalities = |roster: &Roster| roster.graphs.len();
                if self
                    .fleet
                    .roster()
                    .is_none_or(|before| modalities(before) != modalities(&roster))
                {
                    self.topics.change(Topic::Fleet);
                }
                self.fleet.follow_roster(now, roster);
                self.list_missing();
                self.frames.change_robots();
            }
            Input::Teams(teams, stale) => {
                self.fresh("teams", stale);
                self.fleet.follow_teams(teams);
                self.topics.change(Topic::Teams);
                self.frames.change_robots();
            }
            Input::Audit(audit, stale) => {
                self.fresh("audit", stale);
                self.audit = Some(audit);
                self.topics.change(Topic::Audit);
            }
            Input::Alerts(alerts, stale) => {
                self.fresh("alerts", stale);
                if self.alerts.as_ref().is_none_or(|before| before.open != alerts.open) {
                    self.topics.change(Topic::Alerts);
                }
                self.alerts = Some(alerts);
            }
            Input::Event(event) => self.note(now, *event),
            Input::Statuses(statuses) => {
                self.fetches.answered(&Fetch::Statuses);
                self.statuses = statuses;
                self.topics.change(Topic::Services);
            }
            Input::Settings(settings) => {
                self.fetches.answered(&Fetch::Settings);
                // A service that does not answer has those that it had; that it does not lead is shown apart.
                let mut all = self.settings.clone();
                all.extend(settings);
                if self.settings != all || self.topics.version(Topic::Settings) == 0 {
                    self.settings = all;
                    self.topics.change(Topic::Settings);
                }
            }
            Input::Wishes(wishes) => {
                self.fetches.answered(&Fetch::Wishes);
                if self.fleet.follow_wishes(&wishes) {
                    self.frames.change_robots();
                }
                if self.wishes != wishes || self.topics.version(Topic::Wishes) == 0 {
                    self.wishes = wishes;
                    self.topics.change(Topic::Wishes);
                }
            }
            Input::Embedding(embedding) => {
                self.fetches.answered(&Fetch::Embedding);
                self.fetches.answered(&Fetch::Weights);
                if self.weights != embedding.graphs {
                    self.weights.clone_from(&embedding.graphs);
                    self.topics.change(Topic::Fleet);
                }
                let places = self.axes.project(&embedding);
                self.embedding = embedding.robots.iter().cloned().zip(places).collect();
                self.frames.change_robots();
            }
            Input::Graph(graph) => {
                self.fetches.answered(&Fetch::Graph(graph.modality.clone()));
                self.graphs.insert(graph.modality.clone(), graph);
                self.frames.change_links();
            }
            _ => {}
        }
    }

    pub(super) fn list_missing(&mut self) {
        let missing = self.fleet.missing();
        if missing != self.missing {
            self.missing = missing;
            self.topics.change(Topic::Lost);
        }
    }

    fn fresh(&mut self, what: &'static str, stale: Stale) {
        if self.stale.insert(what, stale) != Some(stale) {
            self.topics.change(Topic::Fleet);
        }
    }

    /// Keeps an event, and asks at once for what it says has changed.
    fn note(&mut self, now: Tick, event: Event) {
        let value = bus_json(&Message::Event(event), Key::JsonEvent, now);
        let kind = value.get("event").and_then(Value::as_str).unwrap_or_default();
        if matches!(kind, "commanded" | "settings_changed" | "wish_changed") {
            self.fetches.soon(&[Fetch::Settings, Fetch::Wishes]);
        }
        let number = self.events.back().map_or(1, |(number, _)| number + 1);
        self.events.push_back((number, Arc::new(json!({"at": now.as_seconds(), "event": value}))));
        while self.events.len() > MAX_EVENTS {
            self.events.pop_front();
        }
    }

    pub(super) fn fetch(&mut self, now: Tick, outputs: &mut Vec<Output>) {
        if !self.link || self.browsers.is_empty() {
            return;
        }
        let mut wanted = vec![Fetch::Statuses, Fetch::Settings, Fetch::Wishes];
        let is_shown = self.browsers.values().any(|browser| browser.view.embedding);
        wanted.push(if is_shown { Fetch::Embedding } else { Fetch::Weights });
        let shown = self.browsers.values().filter_map(|browser| browser.view.links.as_ref());
        let mut modalities: Vec<&Modality> = shown.map(|links| &links.modality).collect();
        modalities.sort_unstable();
        modalities.dedup();
        // A modality that the fleet does not have is not asked for.
        let known = self.fleet.roster().map(|roster| &roster.graphs);
        let is_known = |modality: &&Modality| {
            known.is_some_and(|graphs| graphs.iter().any(|(known, _)| known == *modality))
        };
        wanted.extend(modalities.into_iter().filter(is_known).cloned().map(Fetch::Graph));
        outputs.extend(self.fetches.due(now, wanted).into_iter().map(Output::Fetch));
    }

    /// The text of a topic.
    pub(super) fn topic(&mut self, topic: Topic, now: Tick) -> Arc<str> {
        let (fleet, name, link, stale) = (&self.fleet, &self.name, self.link, &self.stale);
        let weight = |graph: &EmbeddingGraph| json!({"modality": graph.modality, "weight": graph.weight, "trust": graph.trust});
        let weights: Vec<Value> = self.weights.iter().map(weight).collect();
        let (audit, alerts, missing) = (&self.audit, &self.alerts, &self.missing);
        let (statuses, settings, wishes) = (&self.statuses, &self.settings, &self.wishes);
        self.topics.text(topic, || match topic {
            Topic::Fleet => {
                let graphs = fleet.roster().map(|roster| roster.graphs.as_slice());
                let modalities = graphs.unwrap_or_default().iter().map(|(modality, _)| modality);
                json!({
                    "fleet": name, "link": link, "stale": stale,
                    "modalities": modalities.collect::<Vec<_>>(), "weights": weights,
                })
            }
            Topic::Teams => fleet.division().unwrap_or_default(),
            Topic::Audit => audit.as_ref().map_or(Value::Null, |audit| {
                let mut brief = (**audit).clone();
                brief.in_embedding.per_robot.clear();
                brief.in_physical.per_robot.clear();
                bus_json(&Message::Audit(Arc::new(brief)), Key::JsonAudit, now)
            }),
            Topic::Alerts => alerts.as_ref().map_or(Value::Null, |alerts| {
                bus_json(&Message::Alerts(Arc::clone(alerts)), Key::JsonAlerts, now)
            }),
            Topic::Wishes => json!(wishes),
            Topic::Services => json!({"at": now.as_seconds(), "instances": statuses}),
            Topic::Settings => {
                let named = settings.iter();
                let named = named.map(|(service, value)| (service.to_string(), value.clone()));
                Value::Object(Map::from_iter(named))
            }
            Topic::Lost => missing.clone(),
        })
    }
}

//! Gets: what a console asks for once. Messages that cannot be decoded are logged and left out.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use muster_bus::{Answer, Ask, Target};
use muster_model::alert::{AcknowledgeAlert, Alert, Alerts};
use muster_model::audit::Audit;
use muster_model::embedding::Embedding;
use muster_model::graph::GraphDelta;
use muster_model::header::Revision;
use muster_model::id::{FleetId, InstanceId, Modality, RobotId, ServiceName};
use muster_model::katz::PairSimilarity;
use muster_model::role::ReplicaState;
use muster_model::roster::Roster;
use muster_model::status::ServiceStatus;
use muster_model::teams::Teams;
use muster_model::why::Why;
use muster_model::wish::StandingWish;
use muster_wire::message::quoted;
use muster_wire::{Key, Message, Packet, Pattern};
use serde_json::Value;

use crate::client::Client;
use crate::error::Error;
use crate::reporter::wall_clock;

/// How long replies to a get are waited for: a service that runs answers within milliseconds, and one
/// on a slow link within seconds.
pub(crate) const REPLY_TIMEOUT: Duration = Duration::from_secs(3);

/// The same for the similarity of a pair: the first one computes that of all pairs of the fleet.
const SIMILARITY_TIMEOUT: Duration = Duration::from_secs(30);

/// The same for a reason, which waits until the embedder has fetched the division and ended its running job.
const REASON_TIMEOUT: Duration = Duration::from_secs(10);

/// A running instance of a service, by its liveliness token.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct ServiceInstance {
    /// The service.
    pub service: ServiceName,
    /// The instance.
    pub instance: InstanceId,
}

/// A fleet on the bus, by its liveliness tokens.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FleetPresence {
    /// The fleet.
    pub fleet: FleetId,
    /// How many instances of services it has.
    pub services: usize,
    /// How many robots it has.
    pub robots: usize,
}

fn revision(message: &Message) -> Revision {
    message.header().map_or_else(Revision::default, |header| header.revision)
}

impl Client {
    /// The newest division that anybody knows.
    ///
    /// # Errors
    /// [`Error::Unanswered`] without a reply, [`Error::Bus`] if the bus fails.
    pub async fn get_teams(&self) -> Result<Arc<Teams>, Error> {
        self.newest(Key::Teams, |message| match message {
            Message::Teams { teams, .. } => Some(teams.into_arc()),
            _ => None,
        })
        .await
    }

    /// The newest audit that anybody knows.
    ///
    /// # Errors
    /// [`Error::Unanswered`] without a reply, [`Error::Bus`] if the bus fails.
    pub async fn get_audit(&self) -> Result<Arc<Audit>, Error> {
        self.newest(Key::Audit, |message| match message {
            Message::Audit(audit) => Some(audit),
            _ => None,
        })
        .await
    }

    /// The newest list of open alerts that anybody knows.
    ///
    /// # Errors
    /// [`Error::Unanswered`] without a reply, [`Error::Bus`] if the bus fails.
    pub async fn get_alerts(&self) -> Result<Arc<Alerts>, Error> {
        self.newest(Key::Alerts, |message| match message {
            Message::Alerts(alerts) => Some(alerts),
            _ => None,
        })
        .await
    }

    /// The newest roster that anybody knows.
    ///
    /// # Errors
    /// [`Error::Unanswered`] without a reply, [`Error::Bus`] if the bus fails.
    pub async fn get_roster(&self) -> Result<Arc<Roster>, Error> {
        self.newest(Key::Roster, |message| match message {
            Message::Roster(roster) => Some(roster.into_arc()),
            _ => None,
        })
        .await
    }

    /// The newest embedding that anybody knows.
    ///
    /// # Errors
    /// [`Error::Unanswered`] without a reply, [`Error::Bus`] if the bus fails.
    pub async fn get_embedding(&self) -> Result<Arc<Embedding>, Error> {
        self.newest(Key::Embedding, |message| match message {
            Message::Embedding(embedding) => Some(embedding.into_arc()),
            _ => None,
        })
        .await
    }

    /// The newest snapshot of one graph, or of each, by name.
    ///
    /// # Errors
    /// [`Error::Unanswered`] without a reply, [`Error::Bus`] if the bus fails.
    pub async fn get_graphs(
        &self,
        modality: Option<&Modality>,
    ) -> Result<Vec<Arc<GraphDelta>>, Error> {
        let pattern =
            modality.map_or(Pattern::Graphs, |modality| Pattern::One(Key::Graph(modality.clone())));
        let mut newest: BTreeMap<Modality, Arc<GraphDelta>> = BTreeMap::new();
        for message in self.messages(&pattern).await? {
            if let Message::Graph(graph) = message {
                let entry = newest.entry(graph.modality.clone()).or_insert_with(|| graph.clone());
                if entry.header.revision < graph.header.revision {
                    *entry = graph;
                }
            }
        }
        if newest.is_empty() {
            return Err(self.unanswered(match modality {
                Some(modality) => format!("the graph {modality}"),
                None => "graphs".to_owned(),
            }));
        }
        Ok(newest.into_values().collect())
    }

    /// The Katz similarity of two robots: the weight of all walks from one to the other. The first call
    /// may take seconds in a large fleet.
    ///
    /// # Errors
    /// [`Error::Refused`] if `embedder` does not know a robot, [`Error::Unavailable`] if there is no embedding yet,
    /// [`Error::Unanswered`] if it does not run, [`Error::Bus`] if the bus fails or the reply is not of this form.
    pub async fn get_similarity(
        &self,
        from: &RobotId,
        to: &RobotId,
    ) -> Result<PairSimilarity, Error> {
        let ask = Ask {
            parameters: &format!("format=json;katz={from},{to}"),
            payload: None,
            within: SIMILARITY_TIMEOUT,
            further_within: None,
            target: Target::Complete,
        };
        match self.get(&Pattern::One(Key::Embedding), ask).await?.into_iter().next() {
            Some(Answer::Packet(packet)) => {
                let pair = muster_wire::katz::decode(self.bus().space(), &packet, wall_clock());
                pair.map_err(|refused| Error::bus(refused.reason))
            }
            Some(Answer::Error(error)) => Err(Error::reply(ServiceName::Embedder, &error)),
            None => Err(self.unanswered("similarities")),
        }
    }

    /// Why a robot is in its team.
    ///
    /// # Errors
    /// [`Error::Refused`] if the robot is unknown or in no team, [`Error::Unavailable`] if there is no division yet,
    /// [`Error::Unanswered`] if `embedder` does not run, [`Error::Bus`] if the bus fails or the reply is not of this form.
    pub async fn get_reason(&self, robot: &RobotId) -> Result<Why, Error> {
        let ask = Ask {
            parameters: &format!("format=json;robot={robot}"),
            payload: None,
            within: REASON_TIMEOUT,
            further_within: None,
            target: Target::Complete,
        };
        match self.get(&Pattern::One(Key::Why), ask).await?.into_iter().next() {
            Some(Answer::Packet(packet)) => {
                let why = muster_wire::why::decode(self.bus().space(), &packet, wall_clock());
                why.map_err(|refused| Error::bus(refused.reason))
            }
            Some(Answer::Error(error)) => Err(Error::reply(ServiceName::Embedder, &error)),
            None => Err(self.unanswered("reasons")),
        }
    }

    /// The status of each running instance of one service, or of all, ordered by service and instance.
    /// Empty if none replies. Anybody may reply: texts of it may hold any character.
    ///
    /// # Errors
    /// [`Error::Bus`] if the bus fails.
    pub async fn get_statuses(
        &self,
        service: Option<ServiceName>,
    ) -> Result<Vec<ServiceStatus>, Error> {
        let pattern = service.map_or(Pattern::Statuses, |name| Pattern::One(Key::Status(name)));
        let answers = self.get(&pattern, ask_for("format=json", Target::All)).await?;
        let read = |answer| match answer {
            Answer::Packet(packet) => {
                serde_json::from_slice::<ServiceStatus>(&packet.payload.ok()?).ok()
            }
            Answer::Error(_) => None,
        };
        let wanted = |status: &ServiceStatus| service.is_none_or(|name| status.service == name);
        let mut statuses: Vec<_> = answers.into_iter().filter_map(read).filter(wanted).collect();
        statuses.sort_by(|left, right| {
            (left.service, &left.instance).cmp(&(right.service, &right.instance))
        });
        Ok(statuses)
    }

    /// The settings of a service, as the JSON object that `muster set SERVICE` shows.
    ///
    /// # Errors
    /// [`Error::Unanswered`] if the service does not run, [`Error::Unavailable`] if no instance of it leads yet,
    /// [`Error::Denied`] if the rules of the router drop the get, [`Error::Bus`] if the bus fails or the reply is no JSON.
    pub async fn get_settings(&self, service: ServiceName) -> Result<Value, Error> {
        let ask = ask_for("format=json", Target::Complete);
        self.json_of_leader(service, &Key::Settings(service), ask).await
    }

    /// All wishes of operators; empty if none was put.
    ///
    /// # Errors
    /// [`Error::Unanswered`] if no one has a list and the clusterer does not run, [`Error::Bus`] if the bus fails.
    pub async fn get_wishes(&self) -> Result<Vec<StandingWish>, Error> {
        let all = self.messages(&Pattern::One(Key::Wishes)).await?;
        match all.into_iter().max_by_key(revision) {
            Some(Message::Wishes(list)) => Ok(list.wishes.clone()),
            _ => self.none_of(ServiceName::Clusterer, Key::Wishes).await,
        }
    }

    /// Nothing, if a service that would have more runs.
    pub(crate) async fn none_of<T>(
        &self,
        service: ServiceName,
        key: impl ToString,
    ) -> Result<Vec<T>, Error> {
        let statuses = self.get_statuses(Some(service)).await?;
        if statuses.is_empty() { Err(self.unanswered(key)) } else { Ok(Vec::new()) }
    }

    /// The running instances of services, by their liveliness tokens.
    ///
    /// # Errors
    /// [`Error::Bus`] if the bus fails.
    pub async fn get_instances(&self) -> Result<BTreeSet<ServiceInstance>, Error> {
        let tokens = self.bus().tokens(&Pattern::ServiceTokens, REPLY_TIMEOUT).await;
        let instance = |key| match key {
            Key::ServiceToken(service, instance) => Some(ServiceInstance { service, instance }),
            _ => None,
        };
        Ok(tokens.map_err(Error::bus)?.into_iter().filter_map(instance).collect())
    }

    /// The robots that have joined, by their liveliness tokens.
    ///
    /// # Errors
    /// [`Error::Bus`] if the bus fails.
    pub async fn get_joined_robots(&self) -> Result<BTreeSet<RobotId>, Error> {
        let tokens = self.bus().tokens(&Pattern::RobotTokens, REPLY_TIMEOUT).await;
        Ok(tokens.map_err(Error::bus)?.iter().filter_map(|key| key.robot().cloned()).collect())
    }

    /// All fleets of the bus, by their liveliness tokens, ordered by name.
    ///
    /// # Errors
    /// [`Error::Bus`] if the bus fails.
    pub async fn get_fleets(&self) -> Result<Vec<FleetPresence>, Error> {
        let tokens = self.bus().tokens_of_all_fleets(REPLY_TIMEOUT).await.map_err(Error::bus)?;
        let mut fleets: BTreeMap<FleetId, FleetPresence> = BTreeMap::new();
        for (fleet, key) in tokens {
            let presence = fleets.entry(fleet.clone());
            let presence =
                presence.or_insert_with(|| FleetPresence { fleet, services: 0, robots: 0 });
            match key {
                Key::ServiceToken(..) => presence.services += 1,
                Key::RobotToken(_) => presence.robots += 1,
                _ => {}
            }
        }
        Ok(fleets.into_values().collect())
    }

    /// All answers to a get that only the leader of a service answers, one at least. It is sent once more if there was none
    /// and the service answers for its status: a slow disk may have held the answer up until then. A router drops what its
    /// rules deny without a word, also that.
    ///
    /// # Errors
    /// [`Error::Unanswered`] if the service does not run, [`Error::Unavailable`] if it does and no instance leads,
    /// [`Error::Denied`] if the leader answers other gets alone, [`Error::Bus`] if the bus fails.
    pub(crate) async fn get_of_leader(
        &self,
        service: ServiceName,
        key: &Key,
        ask: Ask<'_>,
    ) -> Result<Vec<Answer>, Error> {
        let pattern = Pattern::One(key.clone());
        let answers = self.get(&pattern, ask).await?;
        if !answers.is_empty() {
            return Ok(answers);
        }
        let statuses = self.get_statuses(Some(service)).await?;
        if statuses.is_empty() {
            return Err(self.unanswered(key));
        }
        let answers = self.get(&pattern, ask).await?;
        if !answers.is_empty() {
            return Ok(answers);
        }
        if statuses.iter().any(|status| status.standing == ReplicaState::Leading) {
            let fleet = self.bus().space().fleet().clone();
            return Err(Error::Denied { service, key: key.to_string(), fleet });
        }
        let reason = "no instance of it leads yet; ask again in a moment".to_owned();
        Err(Error::Unavailable { service, reason })
    }

    /// The JSON answer to such a get.
    ///
    /// # Errors
    /// As [`Client::get_of_leader`]; that of the error reply if there is one, [`Error::Bus`] if the answer is no JSON.
    pub(crate) async fn json_of_leader(
        &self,
        service: ServiceName,
        key: &Key,
        ask: Ask<'_>,
    ) -> Result<Value, Error> {
        let mut refused = None;
        for answer in self.get_of_leader(service, key, ask).await? {
            match answer {
                Answer::Packet(Packet { payload: Ok(payload), .. }) => {
                    return serde_json::from_slice(&payload).map_err(Error::bus);
                }
                Answer::Packet(_) => {}
                Answer::Error(error) => refused = Some(Error::reply(service, &error)),
            }
        }
        Err(refused.unwrap_or_else(|| self.unanswered(key)))
    }

    async fn newest<T>(&self, key: Key, read: fn(Message) -> Option<T>) -> Result<T, Error> {
        let all = self.messages(&Pattern::One(key.clone())).await?;
        let newest = all.into_iter().max_by_key(revision).and_then(read);
        newest.ok_or_else(|| self.unanswered(key))
    }

    /// All replies to a get that can be decoded.
    async fn messages(&self, pattern: &Pattern) -> Result<Vec<Message>, Error> {
        let mut messages = Vec::new();
        for answer in self.get(pattern, ask_for("format=bincode", Target::All)).await? {
            match answer {
                Answer::Packet(packet) => match Message::decode(self.bus().space(), &packet) {
                    Ok(message) => messages.push(message),
                    Err(refused) => {
                        tracing::warn!("refused on {}: {}", refused.key, refused.reason);
                    }
                },
                Answer::Error(error) => tracing::warn!("answered with {}", quoted(&error)),
            }
        }
        Ok(messages)
    }

    pub(crate) async fn get(&self, pattern: &Pattern, ask: Ask<'_>) -> Result<Vec<Answer>, Error> {
        self.bus().get(pattern, ask).await.map_err(Error::bus)
    }

    pub(crate) fn unanswered(&self, key: impl ToString) -> Error {
        Error::Unanswered { key: key.to_string(), fleet: self.bus().space().fleet().clone() }
    }
}

pub(crate) fn is_acknowledged(alerts: &Alerts, request: &AcknowledgeAlert) -> bool {
    let by = |alert: &Alert| alert.acknowledged.as_ref().map(|by| by.operator.clone());
    let mut open = alerts.open.iter();
    open.any(|alert| alert.id == request.alert && by(alert).as_ref() == Some(&request.operator))
}

pub(crate) fn ask_for(parameters: &str, target: Target) -> Ask<'_> {
    Ask { parameters, payload: None, within: REPLY_TIMEOUT, further_within: None, target }
}

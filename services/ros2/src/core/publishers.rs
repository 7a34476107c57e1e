//! The node of the bridge in the graph of ROS: publishers with their keys, tokens and numbers, and subscriptions.

use std::collections::BTreeMap;

use muster_model::time::Tick;
use muster_ros::key::dds_key;
use muster_ros::{
    Attachment, Dialect, Endpoint, EndpointKind, Gid, Message, Node, Qos, Token, TopicKey,
    TopicName, TypeHash,
};

use super::Output;
use super::intake::Reading;
use crate::config::Setup;

/// How many messages a publisher of a ROS program keeps by default.
const DEPTH: u64 = 10;

/// The name of the node.
const NODE: &str = "muster";

/// One topic in one domain.
#[derive(Debug)]
struct Publisher {
    key: String,
    token: String,
    gid: Gid,
    /// The number of its last message.
    sequence: i64,
}

/// The node `/muster` in each domain, and its publishers.
#[derive(Debug)]
pub(super) struct Publishers {
    session: String,
    domains: Vec<u32>,
    /// None where nothing has tokens or numbers.
    numbered: bool,
    has_hashes: bool,
    namespace: Option<TopicName>,
    by_topic: BTreeMap<(u32, TopicName), Publisher>,
    /// The tokens of the subscriptions by their keys.
    subscriptions: BTreeMap<TopicKey, String>,
    next_number: u64,
}

impl Publishers {
    pub(super) fn new(setup: &Setup, session: &str) -> Self {
        Self {
            session: session.to_owned(),
            domains: setup.domains.clone(),
            numbered: setup.dialect == Dialect::RmwZenoh,
            has_hashes: setup.type_hashes,
            namespace: setup.namespace.clone(),
            by_topic: BTreeMap::new(),
            subscriptions: BTreeMap::new(),
            next_number: 1,
        }
    }

    fn node(&self, domain: u32) -> Node {
        Node {
            domain,
            session: self.session.clone(),
            number: 0,
            enclave: "/".to_owned(),
            namespace: "/".to_owned(),
            name: NODE.to_owned(),
        }
    }

    /// The tokens of the node.
    pub(super) fn start(&self) -> Vec<Output> {
        if !self.numbered {
            return Vec::new();
        }
        let nodes = self.domains.iter().map(|domain| Token::of_node(self.node(*domain)));
        nodes.map(|token| Output::Declare(token.to_string())).collect()
    }

    /// A message on a topic, in each domain, with the token of the publisher before its first one.
    pub(super) fn publish(
        &mut self,
        now: Tick,
        topic: &TopicName,
        message: &Message,
    ) -> Result<Vec<Output>, String> {
        let payload = message.encode().map_err(|error| format!("{topic}: {error}"))?;
        let mut outputs = Vec::new();
        for domain in self.domains.clone() {
            let place = (domain, topic.clone());
            if !self.by_topic.contains_key(&place) {
                let publisher = self.open(domain, topic, message);
                if self.numbered {
                    outputs.push(Output::Declare(publisher.token.clone()));
                }
                self.by_topic.insert(place.clone(), publisher);
            }
            let Some(publisher) = self.by_topic.get_mut(&place) else { continue };
            publisher.sequence += 1;
            let attachment = Attachment {
                sequence: publisher.sequence,
                stamp_ns: i64::try_from(now.0).unwrap_or(i64::MAX).saturating_mul(1000),
                gid: publisher.gid,
            };
            let attachment = muster_wire::Attachment::new(attachment.to_bytes());
            outputs.push(Output::Publish {
                key: publisher.key.clone(),
                payload: payload.clone(),
                attachment: attachment.ok().filter(|_| self.numbered),
            });
        }
        Ok(outputs)
    }

    fn open(&mut self, domain: u32, topic: &TopicName, message: &Message) -> Publisher {
        let layout = message.layout();
        let hash = if self.has_hashes { TypeHash::of(layout) } else { TypeHash::NotSupported };
        let (name, type_name) = (topic.clone(), layout.name().clone());
        let key = TopicKey { domain, topic: name, type_name, hash };
        let token = self.token(EndpointKind::Publisher, &key);
        let key =
            if self.numbered { key.to_string() } else { dds_key(self.namespace.as_ref(), topic) };
        Publisher { key, gid: token.gid(), token: token.to_string(), sequence: 0 }
    }

    /// The token of a further endpoint of the node.
    fn token(&mut self, kind: EndpointKind, key: &TopicKey) -> Token {
        let number = self.next_number;
        self.next_number += 1;
        let endpoint = Endpoint {
            number,
            kind,
            topic: key.topic.to_string(),
            type_name: key.type_name.to_dds(),
            hash: key.hash.to_string(),
            qos: Qos { depth: DEPTH, ..Qos::default() },
            further: Vec::new(),
        };
        Token { node: self.node(key.domain), endpoint: Some(endpoint) }
    }

    /// Shows that a topic is read, or no longer.
    pub(super) fn show(&mut self, reading: Reading) -> Option<Output> {
        match reading {
            Reading::Begins(key) if self.subscriptions.contains_key(&key) => None,
            Reading::Begins(key) => {
                let token = self.token(EndpointKind::Subscription, &key).to_string();
                self.subscriptions.insert(key, token.clone());
                Some(Output::Declare(token))
            }
            Reading::Ends(key) => self.subscriptions.remove(&key).map(Output::Withdraw),
        }
    }

    /// Withdraws a topic, as that of a robot which is gone.
    pub(super) fn withdraw(&mut self, topic: &TopicName) -> Vec<Output> {
        let places = self.domains.iter().map(|domain| (*domain, topic.clone()));
        let places: Vec<_> = places.collect();
        let gone = places.into_iter().filter_map(|place| self.by_topic.remove(&place));
        let numbered = self.numbered;
        gone.filter(|_| numbered).map(|publisher| Output::Withdraw(publisher.token)).collect()
    }
}

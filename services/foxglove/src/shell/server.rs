//! The server of the Foxglove protocol: topics are its channels, viewers its clients.

use std::collections::{BTreeMap, BTreeSet};
use std::net::SocketAddr;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use foxglove::websocket::{
    AnyClient, ChannelView, Client, GetParametersResponder, ParameterHandler, ParameterValue,
    ServerListener, SetParametersResponder, Status, StatusLevel,
};
use foxglove::{
    ChannelBuilder, Context, FoxgloveError, PartialMetadata, RawChannel, WebSocketServer,
    WebSocketServerHandle,
};
use muster_model::id::FleetId;
use muster_model::time::Tick;
use serde_json::{Value, json};
use tokio::sync::mpsc;

use crate::limits::MAX_WAITING_MESSAGES;
use crate::messages::{bytes, form, nanoseconds};
use crate::scene::{Level, Message};
use crate::{Input, Parameter, RequestId, Topic, are_bounded};

/// Most requests that wait for their answer; the crate lets each viewer have 32.
const MAX_REQUESTS: usize = 256;

/// How a viewer is answered.
#[derive(Debug)]
enum Responder {
    Get(GetParametersResponder),
    Set(AnyClient, SetParametersResponder),
}

/// What viewers do: it becomes inputs of the core.
#[derive(Debug)]
struct Viewers {
    inputs: mpsc::Sender<Input>,
    topics: Mutex<BTreeMap<String, Topic>>,
    /// Who waits for an answer. A lock is held for a moment only.
    waiting: Mutex<BTreeMap<RequestId, Responder>>,
    requests: AtomicU64,
}

impl Viewers {
    /// Passes on an input. The callbacks of the crate must not wait: while the core is busy, a viewer is refused, and what
    /// it subscribes to comes with the next turn anyway.
    fn pass_on(&self, input: Input) -> bool {
        self.inputs.try_send(input).is_ok()
    }

    /// Lets a viewer wait for its answer. Dropping the responder says to the viewer that it failed.
    fn wait(&self, responder: Responder) -> Option<RequestId> {
        let mut waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        if waiting.len() >= MAX_REQUESTS {
            return None;
        }
        let id = self.requests.fetch_add(1, Ordering::Relaxed);
        waiting.insert(id, responder);
        Some(id)
    }

    fn take(&self, id: RequestId) -> Option<Responder> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner).remove(&id)
    }
}

/// The same, as the crate calls it.
#[derive(Debug, Clone)]
struct Callbacks(Arc<Viewers>);

impl ServerListener for Callbacks {
    fn on_subscribe(&self, _: Client, channel: ChannelView<'_>) {
        let topics = self.0.topics.lock().unwrap_or_else(PoisonError::into_inner);
        let topic = topics.get(channel.topic()).cloned();
        drop(topics);
        if let Some(topic) = topic {
            self.0.pass_on(Input::Subscribed(topic));
        }
    }

    fn on_client_connect(&self) {
        self.0.pass_on(Input::Joined);
    }
}

impl ParameterHandler for Callbacks {
    fn get(
        &self,
        _: AnyClient,
        names: Vec<String>,
        _: Option<String>,
        responder: GetParametersResponder,
    ) {
        // Dropping the responder says to the viewer that it failed.
        if !are_bounded(names.iter().map(String::as_str)) {
            return;
        }
        if let Some(id) = self.0.wait(Responder::Get(responder))
            && !self.0.pass_on(Input::Get(id, names))
        {
            self.0.take(id);
        }
    }

    fn set(
        &self,
        client: AnyClient,
        parameters: Vec<foxglove::websocket::Parameter>,
        _: Option<String>,
        responder: SetParametersResponder,
    ) {
        if !are_bounded(parameters.iter().map(|parameter| parameter.name.as_str())) {
            return client
                .send_error("nothing was changed: too many names, or too long ones".to_owned());
        }
        let read = |parameter: foxglove::websocket::Parameter| Parameter {
            name: parameter.name,
            value: parameter.value.map(value),
        };
        let parameters = parameters.into_iter().map(read).collect();
        if let Some(id) = self.0.wait(Responder::Set(client, responder))
            && !self.0.pass_on(Input::Set(id, parameters))
        {
            self.0.take(id);
        }
    }
}

fn value(sent: ParameterValue) -> Value {
    match sent {
        ParameterValue::Integer(number) => json!(number),
        ParameterValue::Float64(number) => json!(number),
        ParameterValue::Bool(flag) => json!(flag),
        ParameterValue::String(text) => json!(text),
        ParameterValue::Array(all) => all.into_iter().map(value).collect(),
        ParameterValue::Dict(all) => {
            Value::Object(all.into_iter().map(|(name, one)| (name, value(one))).collect())
        }
    }
}

/// A value as viewers read it; none for what they have no form for.
fn shown(value: Value) -> Option<ParameterValue> {
    Some(match value {
        Value::Null => return None,
        Value::Bool(flag) => ParameterValue::Bool(flag),
        Value::Number(number) => match number.as_i64() {
            Some(whole) => ParameterValue::Integer(whole),
            None => ParameterValue::Float64(number.as_f64()?),
        },
        Value::String(text) => ParameterValue::String(text),
        Value::Array(all) => ParameterValue::Array(all.into_iter().filter_map(shown).collect()),
        Value::Object(all) => {
            let all = all.into_iter().filter_map(|(name, one)| Some((name, shown(one)?)));
            ParameterValue::Dict(all.collect())
        }
    })
}

fn parameter(parameter: Parameter) -> foxglove::websocket::Parameter {
    let Parameter { name, value } = parameter;
    foxglove::websocket::Parameter {
        value: value.and_then(shown),
        ..foxglove::websocket::Parameter::empty(name)
    }
}

fn parameters(all: Vec<Parameter>) -> Vec<foxglove::websocket::Parameter> {
    all.into_iter().map(parameter).collect()
}

/// The server, with the channels that it offers.
#[derive(Debug)]
pub(super) struct Server {
    context: Arc<Context>,
    handle: WebSocketServerHandle,
    channels: BTreeMap<Topic, Arc<RawChannel>>,
    viewers: Arc<Viewers>,
}

impl Server {
    /// Listens for viewers of a fleet.
    ///
    /// # Errors
    /// If the address cannot be listened at.
    pub(super) async fn start(
        fleet: &FleetId,
        address: SocketAddr,
        inputs: mpsc::Sender<Input>,
    ) -> Result<Self, FoxgloveError> {
        let viewers = Arc::new(Viewers {
            inputs,
            topics: Mutex::default(),
            waiting: Mutex::default(),
            requests: AtomicU64::new(0),
        });
        let callbacks = Arc::new(Callbacks(Arc::clone(&viewers)));
        let context = Context::new();
        let handle = WebSocketServer::new()
            .name(format!("muster {fleet}"))
            .bind(host(address), address.port())
            .message_backlog_size(MAX_WAITING_MESSAGES)
            .context(&context)
            .listener(Arc::clone(&callbacks) as Arc<dyn ServerListener>)
            .parameter_handler(callbacks)
            .start()
            .await?;
        Ok(Self { context, handle, channels: BTreeMap::new(), viewers })
    }

    pub(super) fn port(&self) -> u16 {
        self.handle.port()
    }

    /// The topics that somebody watches.
    pub(super) fn watched(&self) -> BTreeSet<Topic> {
        let watched = self.channels.iter().filter(|(_, channel)| channel.has_sinks());
        watched.map(|(topic, _)| topic.clone()).collect()
    }

    pub(super) fn offer(&mut self, topic: Topic) {
        let (name, form) = (topic.name(), form(&topic));
        let builder = ChannelBuilder::new(&name).context(&self.context).schema(form.schema);
        match builder.message_encoding(form.encoding).build_raw() {
            Ok(channel) => {
                let mut topics = self.viewers.topics.lock().unwrap_or_else(PoisonError::into_inner);
                topics.insert(name, topic.clone());
                drop(topics);
                self.channels.insert(topic, channel);
            }
            Err(error) => tracing::error!("{name} is not offered: {error}"),
        }
    }

    pub(super) fn send(&self, now: Tick, topic: &Topic, message: Message) {
        if let Some(channel) = self.channels.get(topic)
            && let Some(bytes) = bytes(message, now)
        {
            channel.log_with_meta(&bytes, PartialMetadata::with_log_time(nanoseconds(now)));
        }
    }

    pub(super) fn say(&self, name: &str, level: Level, text: String) {
        let level = match level {
            Level::Info => StatusLevel::Info,
            Level::Warning => StatusLevel::Warning,
            Level::Error => StatusLevel::Error,
        };
        self.handle.publish_status(Status::new(level, text).with_id(name));
    }

    pub(super) fn unsay(&self, name: &str) {
        self.handle.remove_status(vec![name.to_owned()]);
    }

    pub(super) fn publish(&self, all: Vec<Parameter>) {
        self.handle.publish_parameter_values(parameters(all));
    }

    pub(super) fn respond(&self, id: RequestId, all: Vec<Parameter>) {
        match self.viewers.take(id) {
            Some(Responder::Get(responder)) => responder.respond(parameters(all)),
            Some(Responder::Set(_, responder)) => responder.respond(parameters(all)),
            None => {}
        }
    }

    pub(super) fn refuse(&self, id: RequestId, problem: String) {
        let waiting = self.viewers.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        let client = match waiting.get(&id) {
            Some(Responder::Set(client, _)) => Some(client.clone()),
            _ => None,
        };
        drop(waiting);
        if let Some(client) = client {
            client.send_error(problem);
        }
    }

    /// Says good-bye to all viewers.
    pub(super) async fn stop(self) {
        self.handle.stop().wait().await;
    }
}

/// The host of an address as the crate joins it with a port.
fn host(address: SocketAddr) -> String {
    match address {
        SocketAddr::V4(address) => address.ip().to_string(),
        SocketAddr::V6(address) => format!("[{}]", address.ip()),
    }
}

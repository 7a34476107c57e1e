//! The JSON Schema (draft 2020-12) of everything that stands at the edge in JSON.
//!
//! It is generated from the types that read and write the messages. One document has all messages under
//! `$defs`, each by a name in small letters, and the parts that they share. Messages of robots and
//! operators are described as they are read, messages of services as they are written: complete and
//! closed, so that an undescribed field is noticed.

use std::collections::BTreeSet;
use std::sync::LazyLock;

use muster_model::bridge::BridgeState;
use muster_model::command::OperatorCommand;
use muster_model::history::{HistoryAnswer, RecordingState};
use muster_model::id::{Modality, ServiceName};
use muster_model::limits::MAX_ROBOT_PAYLOAD;
use muster_model::observation::Stream;
use muster_model::proposal::ProposalRequest;
use muster_model::role::LeaseRenewal;
use muster_model::settings::{
    AuditorSettings, ClustererSettings, EmbedderSettings, HistorianSettings, IngestSettings,
    PlannerSettings, Settings,
};
use muster_model::status::ServiceStatus;
use muster_model::wish::Wish;
use schemars::generate::SchemaSettings;
use schemars::transform::{Transform, transform_subschemas};
use schemars::{JsonSchema, Schema, SchemaGenerator};
use serde_json::{Map, Value, json};

use crate::command::{MAX_COMMAND_BYTES, OutcomeForm};
use crate::json::{
    AlertsForm, AuditForm, EmbeddingForm, EventForm, GraphForm, KatzForm, Problem, RefusedForm,
    RobotTeamForm, RosterForm, TeamsForm, WhyForm, WishReportForm, WishesForm,
};
use crate::proposal::ProposalForm;
use crate::report;

/// The version of JSON Schema.
const DIALECT: &str = "https://json-schema.org/draft/2020-12/schema";

/// Where the parts of the document stand.
const PARTS: &str = "#/$defs/";

/// The description of the document.
const ABOUT: &str = "\
Every message of Muster in JSON, by name under $defs. Validate against one of them, such as \
{\"$ref\": \"#/$defs/pose\"} next to this $defs. x-keys says on which keys below muster/v1/{fleet}/ a \
message stands. Every name, number and text satisfies the rules of its schema; beyond them a service \
refuses what JSON Schema cannot say, and the description of a message says what that is. For all \
messages to a service: numbers are finite and within double precision (NaN and Infinity are no JSON), \
whole numbers are written without a fraction (17, not 17.0), and no key stands twice in an object of \
a robot. What services write has exactly these fields in this version; a later one may have more.";

/// Everything that is described so far.
#[derive(Debug)]
pub struct Schemas {
    read: SchemaGenerator,
    written: SchemaGenerator,
    messages: Map<String, Value>,
}

impl Default for Schemas {
    fn default() -> Self {
        let settings = SchemaSettings::draft2020_12;
        Self {
            read: settings().for_deserialize().with_transform(Unbreak).into_generator(),
            written: settings()
                .for_serialize()
                .with_transform(Unbreak)
                .with_transform(Close)
                .into_generator(),
            messages: Map::new(),
        }
    }
}

/// Makes one line of each paragraph of a description, whatever the width of the source.
#[derive(Debug, Clone)]
struct Unbreak;

impl Transform for Unbreak {
    fn transform(&mut self, schema: &mut Schema) {
        if let Some(Value::String(text)) = schema.get_mut("description") {
            let paragraphs = text.split("\n\n").map(|paragraph| paragraph.replace('\n', " "));
            *text = paragraphs.collect::<Vec<_>>().join("\n\n");
        }
        transform_subschemas(self, schema);
    }
}

/// Allows no other fields than those that are described: what is written has no others.
#[derive(Debug, Clone)]
struct Close;

impl Transform for Close {
    fn transform(&mut self, schema: &mut Schema) {
        let Some(object) = schema.as_object_mut() else { return };
        if object.contains_key("properties") {
            // The fields of a choice are known only to the whole object.
            let choice = object.contains_key("oneOf");
            let rest = if choice { "unevaluatedProperties" } else { "additionalProperties" };
            object.insert(rest.to_owned(), Value::Bool(false));
            if choice {
                return;
            }
        }
        transform_subschemas(self, schema);
    }
}

fn describe(schema: &mut Schema, name: &str, keys: &[&str], beyond: &str) {
    let object = schema.ensure_object();
    object.insert("title".to_owned(), json!(name));
    if !keys.is_empty() {
        object.insert("x-keys".to_owned(), json!(keys));
    }
    if !beyond.is_empty() {
        let about = object.get("description").and_then(Value::as_str).unwrap_or_default();
        let about = format!("{about} Refused as well: {beyond}");
        object.insert("description".to_owned(), json!(about.trim_start()));
    }
}

impl Schemas {
    /// All messages at the edge of the bus.
    #[must_use]
    pub fn edge() -> Self {
        let mut all = Self::default();
        all.streams();
        all.written::<RobotTeamForm<'_>>("robot_team", &["robot/{robot}/team"]);
        all.written::<RefusedForm<'_>>("refused", &["robot/{robot}/refused"]);
        all.written::<TeamsForm<'_>>("teams", &["json/teams", "teams?format=json"]);
        all.written::<AuditForm<'_>>("audit", &["json/audit", "audit?format=json"]);
        all.written::<EventForm<'_>>("event", &["json/event"]);
        all.written::<AlertsForm<'_>>("alerts", &["json/alerts", "alerts?format=json"]);
        all.written::<GraphForm<'_>>("graph", &["graph/{modality}?format=json"]);
        all.written::<RosterForm<'_>>("roster", &["roster?format=json"]);
        all.written::<EmbeddingForm<'_>>("embedding", &["embedding?format=json"]);
        all.written::<KatzForm<'_>>("katz", &["embedding?katz={from},{to}"]);
        all.written::<ServiceStatus>("status", &["service/{service}/status"]);
        all.written::<LeaseRenewal>("claim", &["service/{service}/holder?format=json"]);
        all.settings::<IngestSettings>(
            ServiceName::Ingest,
            "gone_after_s that is not above stale_after_s, spatial.neighbours times max_robots that \
             make a larger graph than fits a message, connectivity.rssi_ceiling_dbm less than 1 dB \
             above connectivity.rssi_floor_dbm",
        );
        all.settings::<EmbedderSettings>(
            ServiceName::Embedder,
            "weights that do not sum to 1 (none at all means equal ones)",
        );
        all.settings::<ClustererSettings>(
            ServiceName::Clusterer,
            "a size, team_size or need whose max is below its min, a need that stands twice for a skill and a \
             team, more than 16 different skills, and limits and needs that nothing satisfies for the robots of \
             the fleet",
        );
        all.settings::<AuditorSettings>(ServiceName::Auditor, "good that is less than poor");
        all.settings::<HistorianSettings>(ServiceName::Historian, "");
        all.written::<HistoryAnswer>("history", &["history/{instance}"]);
        all.written::<RecordingState>("history_state", &["history/{instance}/state"]);
        all.written::<WishesForm<'_>>("wishes", &["json/wishes", "wishes?format=json"]);
        all.written::<WishReportForm<'_>>("wish_report", &["wish/{operator}/{id}"]);
        all.read::<Wish>(
            "wish",
            &["command/clusterer/{operator}/{id} (the wish of a command)"],
            "robots or a team that the kind does not take, fewer than two robots of together and apart, a robot \
             that is named twice, a wish that contradicts the limits and the other wishes for the robots of the \
             fleet, and more than 256 wishes.",
        );
        all.written::<OutcomeForm<'_>>("command_outcome", &["command/{service}/{operator}/{id}"]);
        all.read::<OperatorCommand>(
            "command",
            &["command/{service}/{operator}/{id} (payload of a get)"],
            "a clock that is more than 30 s off, an expiry more than 600 s after sent or before now, a division of a later \
             term, actions of another service, more than 256 commands within ten minutes, and whatever the action itself \
             may not be",
        );
        all.written::<WhyForm<'_>>("why", &["why?robot={robot}"]);
        all.settings::<PlannerSettings>(ServiceName::Planner, "");
        all.written::<ProposalForm<'_>>("proposal", &["propose/{operator}/{id}"]);
        all.read::<ProposalRequest>(
            "proposal_request",
            &["propose/{operator}/{id} (payload of a get)"],
            "weights that do not sum to 1, limits, needs and robots that nothing satisfies for the fleet, robots that are \
             not in it, a robot that is named twice, and more than 8 open proposals of one operator, or 16 of all.",
        );
        all.written::<BridgeState>("bridge", &["bridge/{instance}"]);
        all.written::<Problem<'_>>("error", &[]);
        all
    }

    /// Adds the reports of robots, with what `ingest` refuses of every stream.
    fn streams(&mut self) {
        let declared = Modality::new("declared").map(Stream::Relation);
        let also = format!(
            "more than {MAX_ROBOT_PAYLOAD} bytes, messages that are older than one before by boot and \
             seq, more of them per second than max_rate_hz, and robots beyond max_robots."
        );
        for stream in Stream::BUILT_IN.iter().chain(&declared) {
            let key = match stream {
                Stream::Relation(_) => "robot/{robot}/relation/{modality}".to_owned(),
                built_in => format!("robot/{{robot}}/{built_in}"),
            };
            let schema = report::json_schema(stream, &mut self.read);
            let beyond = format!("{}, {also}", report::beyond_schema(stream));
            self.add_read(schema, stream.name(), &[&key], &beyond);
        }
    }

    /// Adds a message that is read, with the keys that it stands on and what is refused beyond its
    /// schema, as a list that ends a sentence; either may be empty.
    pub fn read<T: JsonSchema>(&mut self, name: &str, keys: &[&str], beyond: &str) {
        let schema = T::json_schema(&mut self.read);
        self.add_read(schema, name, keys, beyond);
    }

    fn add_read(&mut self, mut schema: Schema, name: &str, keys: &[&str], beyond: &str) {
        for transform in self.read.transforms_mut() {
            transform.transform(&mut schema);
        }
        describe(&mut schema, name, keys, beyond);
        self.messages.insert(name.to_owned(), schema.to_value());
    }

    /// Adds a message that is written.
    pub fn written<T: JsonSchema>(&mut self, name: &str, keys: &[&str]) {
        let mut schema = T::json_schema(&mut self.written);
        for transform in self.written.transforms_mut() {
            transform.transform(&mut schema);
        }
        describe(&mut schema, name, keys, "");
        self.messages.insert(name.to_owned(), schema.to_value());
    }

    /// Adds the settings of a service, and the patches of them.
    fn settings<T: Settings + JsonSchema>(&mut self, service: ServiceName, beyond: &str) {
        let key = format!("service/{service}/settings");
        self.written::<T>(&format!("{service}_settings"), &[&key]);
        let whole = T::json_schema(&mut self.read);
        let mut patch = Schema::from(patch(whole.as_value(), self.read.definitions()));
        for transform in self.read.transforms_mut() {
            transform.transform(&mut patch);
        }
        let about = format!(
            "The settings of {service} to change: what a command sets. Fields that are \
             left out stay, null puts a field back to its default, and a table may hold some of its \
             fields. It holds as a whole or not at all."
        );
        patch.insert("description".to_owned(), json!(about));
        let size = format!("more than {MAX_COMMAND_BYTES} bytes.");
        let beyond = [beyond, &size];
        let beyond = beyond.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>();
        let name = format!("{service}_settings_patch");
        let set = format!("command/{service}/{{operator}}/{{id}} (the set of a command)");
        describe(&mut patch, &name, &[&set], &beyond.join(", "));
        self.messages.insert(name, patch.to_value());
    }

    /// The document.
    #[must_use]
    pub fn document(mut self) -> Value {
        // Where a part is read otherwise than written, as the tables of settings are, only what is
        // written refers to it: patches hold their tables themselves.
        let mut parts = self.read.take_definitions(true);
        parts.append(&mut self.written.take_definitions(true));
        parts.append(&mut self.messages);
        let all = json!({ "$defs": parts });
        let used = reachable(&all, parts.keys().filter(|name| is_message(name)).cloned());
        parts.retain(|name, _| used.contains(name));
        json!({
            "$schema": DIALECT,
            "$id": "urn:muster:messages:v1",
            "title": "Messages of Muster",
            "description": ABOUT,
            "$defs": parts,
        })
    }
}

/// Messages have names in small letters, and the parts that they share those of their types.
fn is_message(name: &str) -> bool {
    name.starts_with(|first: char| first.is_ascii_lowercase())
}

/// The schema of an object whose fields may all be left out or null, and whose tables may hold some of
/// their fields.
fn patch(table: &Value, parts: &Map<String, Value>) -> Map<String, Value> {
    let fields = table.get("properties").and_then(Value::as_object);
    let fields = fields.into_iter().flatten().map(|(name, field)| {
        let target = field.get("$ref").and_then(Value::as_str);
        let inner = target.and_then(|target| parts.get(target.strip_prefix(PARTS)?));
        let inner = inner.filter(|inner| inner.get("properties").is_some());
        let mut field = match inner {
            Some(inner) => {
                let mut inner = patch(inner, parts);
                inner.insert("description".to_owned(), field["description"].clone());
                Value::Object(inner)
            }
            None => with_parts_of_maps(field.clone(), parts),
        };
        (name.clone(), or_null(&mut field))
    });
    let fields: Map<String, Value> = fields.collect();
    Map::from_iter([
        ("type".to_owned(), json!("object")),
        ("properties".to_owned(), Value::Object(fields)),
        ("additionalProperties".to_owned(), Value::Bool(false)),
    ])
}

/// A map whose values are tables holds these itself: a reference means the table as it is written, with all fields.
fn with_parts_of_maps(mut field: Value, parts: &Map<String, Value>) -> Value {
    let patterns = field.get_mut("patternProperties").and_then(Value::as_object_mut);
    for value in patterns.into_iter().flat_map(Map::values_mut) {
        let target = value.get("$ref").and_then(Value::as_str);
        let part = target.and_then(|target| parts.get(target.strip_prefix(PARTS)?));
        if let Some(part) = part.filter(|part| part.get("properties").is_some()) {
            *value = part.clone();
        }
    }
    field
}

/// Allows null for a field.
fn or_null(field: &mut Value) -> Value {
    match field.get("type") {
        Some(Value::String(plain)) => field["type"] = json!([plain, "null"]),
        Some(_) => {}
        None => {
            let about = field.as_object_mut().and_then(|field| field.remove("description"));
            let mut either = json!({ "anyOf": [field.take(), { "type": "null" }] });
            if let Some(about) = about {
                either["description"] = about;
            }
            return either;
        }
    }
    field.take()
}

/// The names of the parts that some of them need, themselves among them.
fn reachable(document: &Value, from: impl IntoIterator<Item = String>) -> BTreeSet<String> {
    fn targets(value: &Value, found: &mut Vec<String>) {
        match value {
            Value::Object(object) => {
                if let Some(Value::String(target)) = object.get("$ref") {
                    found.extend(target.strip_prefix(PARTS).map(str::to_owned));
                }
                object.values().for_each(|value| targets(value, found));
            }
            Value::Array(values) => values.iter().for_each(|value| targets(value, found)),
            _ => {}
        }
    }
    let mut names = BTreeSet::new();
    let mut open: Vec<String> = from.into_iter().collect();
    while let Some(name) = open.pop() {
        if let Some(part) = document["$defs"].get(&name)
            && names.insert(name)
        {
            targets(part, &mut open);
        }
    }
    names
}

/// The names of the messages of a document, in order.
pub fn names(document: &Value) -> impl Iterator<Item = &str> {
    let parts = document["$defs"].as_object();
    parts.into_iter().flatten().map(|(name, _)| name.as_str()).filter(|name| is_message(name))
}

/// The schema of one message of a document, by itself; none if there is no such name.
#[must_use]
pub fn one(document: &Value, name: &str) -> Option<Value> {
    let name = names(document).find(|known| *known == name)?;
    let mut schema = document["$defs"].get(name)?.clone();
    let mut needed = reachable(document, [name.to_owned()]);
    needed.remove(name);
    schema["$schema"] = document["$schema"].clone();
    if !needed.is_empty() {
        let parts = needed
            .into_iter()
            .filter_map(|part| Some((part.clone(), document["$defs"].get(&part)?.clone())));
        schema["$defs"] = Value::Object(parts.collect());
    }
    Some(schema)
}

/// The document of all messages at the edge of the bus, as a get on `schema` is answered.
#[must_use]
pub fn text() -> &'static [u8] {
    static TEXT: LazyLock<Vec<u8>> =
        LazyLock::new(|| Schemas::edge().document().to_string().into_bytes());
    &TEXT
}

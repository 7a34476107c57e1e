//! Topics: the newest JSON of each kind, made once for all browsers, when one of them needs it.

use std::sync::Arc;

use serde_json::{Value, json};

use super::limits::MAX_TOPIC_BYTES;

/// What is sent when it has changed, and then only the newest.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(usize)]
pub(super) enum Topic {
    /// The link to the router, how fresh each message is, and the modalities.
    Fleet,
    /// The division, as `json/teams` without the members.
    Teams,
    /// As `json/audit` without single robots.
    Audit,
    /// As `json/alerts`.
    Alerts,
    /// As `json/wishes`.
    Wishes,
    /// The status of each instance.
    Services,
    /// The settings of each service.
    Settings,
    /// Who is silent or has left.
    Lost,
}

/// How many topics there are.
pub(super) const TOPICS: usize = 8;

impl Topic {
    /// All topics, in the order in which they are sent.
    pub(super) const ALL: [Self; TOPICS] = [
        Self::Fleet,
        Self::Teams,
        Self::Audit,
        Self::Alerts,
        Self::Wishes,
        Self::Services,
        Self::Settings,
        Self::Lost,
    ];

    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Fleet => "fleet",
            Self::Teams => "teams",
            Self::Audit => "audit",
            Self::Alerts => "alerts",
            Self::Wishes => "wishes",
            Self::Services => "services",
            Self::Settings => "settings",
            Self::Lost => "lost",
        }
    }
}

/// The versions of the topics, and the texts that were made of them.
#[derive(Debug, Default)]
pub(super) struct Topics {
    versions: [u64; TOPICS],
    texts: [Option<(u64, Arc<str>)>; TOPICS],
}

impl Topics {
    /// Says that a topic is another than before.
    pub(super) fn change(&mut self, topic: Topic) {
        self.versions[topic as usize] += 1;
    }

    /// The version of a topic; 0 until there is one.
    pub(super) fn version(&self, topic: Topic) -> u64 {
        self.versions[topic as usize]
    }

    /// The text of a topic, which is made if no one has needed it yet.
    pub(super) fn text(&mut self, topic: Topic, make: impl FnOnce() -> Value) -> Arc<str> {
        let version = self.version(topic);
        let place = &mut self.texts[topic as usize];
        match place {
            Some((made, text)) if *made == version => Arc::clone(text),
            _ => {
                let text = text(topic.name(), &make());
                *place = Some((version, Arc::clone(&text)));
                text
            }
        }
    }
}

/// A message about something; one that is too long is replaced by a sentence.
pub(super) fn text(topic: &str, data: &Value) -> Arc<str> {
    let text = json!({"topic": topic, "data": data}).to_string();
    if text.len() <= MAX_TOPIC_BYTES {
        return text.into();
    }
    let problem = format!("{topic} is longer than {MAX_TOPIC_BYTES} bytes and is not shown");
    json!({"topic": topic, "problem": problem}).to_string().into()
}

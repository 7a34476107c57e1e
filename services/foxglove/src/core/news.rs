//! Events as lines of a log, in order and at a bounded rate.

use std::collections::VecDeque;

use muster_model::event::{Event, EventKind, Severity};
use serde_json::Value;

use super::limits::{MAX_EVENTS_SENT, MAX_WAITING_EVENTS};
use super::scene::{Level, Message};

/// Longest line in bytes: events with the reasons of refusals fit.
const MAX_LINE_BYTES: usize = 2048;

/// Events that wait for their turn.
#[derive(Debug, Default)]
pub(super) struct News {
    waiting: VecDeque<Message>,
    /// How many found no room since the last one that was sent.
    left_out: u64,
}

impl News {
    /// Whether settings are probably others from now on.
    pub(super) fn is_change_of_settings(&self, event: &Event) -> bool {
        matches!(event.kind, EventKind::SettingsChanged { .. } | EventKind::Commanded { .. })
    }

    /// Takes an event.
    pub(super) fn note(&mut self, event: &Event) {
        if self.waiting.len() >= MAX_WAITING_EVENTS {
            self.left_out += 1;
            return;
        }
        self.waiting.push_back(message(event));
    }

    /// The next lines; when all that had room are sent, how many had none.
    pub(super) fn next(&mut self) -> Vec<Message> {
        let count = self.waiting.len().min(MAX_EVENTS_SENT);
        let mut lines: Vec<Message> = self.waiting.drain(..count).collect();
        if self.waiting.is_empty() && self.left_out > 0 && lines.len() < MAX_EVENTS_SENT {
            let text = format!("{} events are left out, as too many came at once", self.left_out);
            self.left_out = 0;
            lines.push(Message::Log {
                level: Level::Warning,
                name: "muster-foxglove".to_owned(),
                text,
            });
        }
        lines
    }

    /// No one watches: what waits would be old when somebody does.
    pub(super) fn forget(&mut self) {
        self.waiting.clear();
        self.left_out = 0;
    }
}

/// An event as a line.
pub(super) fn message(event: &Event) -> Message {
    let level = match event.severity {
        Severity::Info => Level::Info,
        Severity::Warning => Level::Warning,
        Severity::Error => Level::Error,
    };
    let kind = serde_json::to_value(&event.kind).unwrap_or_default();
    let mut text = line(&kind);
    if text.len() > MAX_LINE_BYTES {
        let end = (0..=MAX_LINE_BYTES).rev().find(|at| text.is_char_boundary(*at));
        text.truncate(end.unwrap_or_default());
        text.push('…');
    }
    Message::Log { level, name: event.source.to_string(), text }
}

/// The name of what happened, then its fields without the signs of JSON.
fn line(kind: &Value) -> String {
    match kind {
        Value::Object(one) if one.len() == 1 => {
            let (name, fields) = one.iter().next().map_or(("", &Value::Null), |(n, f)| (n, f));
            format!("{name}: {}", plain(fields))
        }
        other => plain(other),
    }
}

fn plain(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Null => "none".to_owned(),
        Value::Array(all) => all.iter().map(plain).collect::<Vec<_>>().join(" "),
        Value::Object(fields) => {
            let fields = fields.iter().map(|(name, value)| format!("{name} {}", plain(value)));
            fields.collect::<Vec<_>>().join(", ")
        }
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use muster_model::header::{Header, Revision};
    use muster_model::id::{FleetId, RobotId, ServiceName};

    use super::*;

    fn event(robot: &str) -> Event {
        Event {
            header: Header {
                fleet: FleetId::new("f").unwrap(),
                revision: Revision { term: 1, epoch: 1 },
                oldest: None,
                newest: None,
                stages: Vec::new(),
            },
            source: ServiceName::Ingest,
            severity: Severity::Info,
            kind: EventKind::RobotJoined { robot: RobotId::new(robot).unwrap() },
        }
    }

    #[test]
    fn an_event_is_a_line_and_a_flood_is_counted() {
        let mut news = News::default();
        for at in 0..MAX_WAITING_EVENTS + 5 {
            news.note(&event(&format!("r{at}")));
        }
        let Message::Log { text, name, level } = &news.next()[0] else { panic!() };
        assert_eq!(
            (text.as_str(), name.as_str(), *level),
            ("robot_joined: robot r0", "ingest", Level::Info)
        );
        let mut rest = Vec::new();
        loop {
            let lines = news.next();
            assert!(lines.len() <= MAX_EVENTS_SENT);
            if lines.is_empty() {
                break;
            }
            rest.extend(lines);
        }
        let Some(Message::Log { text, .. }) = rest.last() else { panic!() };
        assert!(text.starts_with("5 events are left out"), "{text}");
        assert_eq!(rest.len(), MAX_WAITING_EVENTS - MAX_EVENTS_SENT + 1);
    }

    #[test]
    fn a_long_line_is_cut_between_letters() {
        let reason = "ä".repeat(MAX_LINE_BYTES);
        let event = Event { kind: EventKind::JobFailed { reason }, ..event("r") };
        let Message::Log { text, .. } = message(&event) else { panic!() };
        assert!(text.len() <= MAX_LINE_BYTES + '…'.len_utf8() && text.ends_with('…'));
    }
}

//! Rows of a history as text for people, the newest last.

use muster_model::event::Severity;
use muster_model::history::{
    HistoryAnswer, LeaveReason, PastDivision, Rows, SnapshotCause, StayRow,
};
use muster_model::id::TeamId;
use muster_wire::message::quoted;
use serde_json::Value;

use super::moment::shown;
use crate::show::page::{Column, Page, names};

fn team(team: Option<&TeamId>) -> String {
    team.map_or_else(|| "–".to_owned(), ToString::to_string)
}

fn cause(snapshot: Option<SnapshotCause>) -> &'static str {
    match snapshot {
        Some(SnapshotCause::Start) => "recording begins",
        Some(SnapshotCause::Gap) => "after a gap",
        Some(SnapshotCause::Periodic) | None => "",
    }
}

fn reason(stay: &StayRow) -> &'static str {
    match stay.reason {
        Some(LeaveReason::Disconnected) => "disconnected",
        Some(LeaveReason::Silent) => "silent",
        Some(LeaveReason::Unrecorded) => "unrecorded",
        None => "",
    }
}

/// The fields of an event on one line: names and values without the signs of JSON.
fn detail(text: &str) -> String {
    let plain = |value: &Value| match value {
        Value::String(text) => text.clone(),
        Value::Array(all) => {
            let all =
                all.iter().map(|one| one.as_str().map_or_else(|| one.to_string(), str::to_owned));
            all.collect::<Vec<_>>().join(" ")
        }
        Value::Null => "none".to_owned(),
        other => other.to_string(),
    };
    match serde_json::from_str(text) {
        Ok(Value::Object(fields)) => {
            let fields = fields.iter().map(|(name, value)| format!("{name} {}", plain(value)));
            fields.collect::<Vec<_>>().join(", ")
        }
        _ => quoted(text),
    }
}

/// The lines, with how far the recording goes.
pub(super) fn lines(answer: &HistoryAnswer, page: &Page) -> Vec<String> {
    let from = answer.recorded_from.map_or_else(|| "nothing".to_owned(), shown);
    let through = answer.recorded_through.map_or_else(|| "nothing".to_owned(), shown);
    let mut lines = vec![format!(
        "fleet {}  recorded from {from} to {through} UTC by {}",
        answer.fleet, answer.instance
    )];
    lines.extend(rows(&answer.rows, page));
    if answer.before.is_some() && !matches!(answer.rows, Rows::AsOf(_)) {
        lines.push("there are older rows: see --limit, --since and --until".to_owned());
    }
    lines
}

fn rows(rows: &Rows, page: &Page) -> Vec<String> {
    let is_empty = match rows {
        Rows::AsOf(Some(division)) => return as_of(division, page),
        Rows::AsOf(None) => return vec!["no division is recorded until then".to_owned()],
        Rows::Divisions(rows) => rows.is_empty(),
        Rows::Robot(rows) => rows.is_empty(),
        Rows::Team(rows) => rows.is_empty(),
        Rows::Events(rows) => rows.is_empty(),
        Rows::Robots(rows) => rows.is_empty(),
    };
    if is_empty { vec!["nothing is recorded of that".to_owned()] } else { table(rows, page) }
}

fn table(rows: &Rows, page: &Page) -> Vec<String> {
    match rows {
        Rows::AsOf(_) => Vec::new(),
        Rows::Divisions(rows) => page.table(
            &[
                Column::kept("time (UTC)"),
                Column::kept("teams"),
                Column::kept("robots"),
                Column::kept("changed"),
                Column::dropped("note", 1),
            ],
            rows.iter().rev().map(|row| {
                let counts = [row.teams, row.robots, row.changed].map(|count| count.to_string());
                [vec![shown(row.at)], counts.to_vec(), vec![cause(row.snapshot).to_owned()]]
                    .concat()
            }),
        ),
        Rows::Robot(rows) => page.table(
            &["time (UTC)", "team", "before", "note"].map(Column::kept),
            rows.iter().rev().map(|row| {
                let mut notes = vec![cause(row.snapshot)];
                notes.extend((!row.present).then_some("not in the division"));
                notes.extend(row.stale.then_some("stale"));
                notes.retain(|note| !note.is_empty());
                let (is, was) = (team(row.team.as_ref()), team(row.was.as_ref()));
                vec![shown(row.at), is, was, notes.join(", ")]
            }),
        ),
        Rows::Team(rows) => page.table(
            &["time (UTC)", "members", "leader", "came", "went"].map(Column::kept),
            rows.iter().rev().map(|row| {
                let leader =
                    row.leader.as_ref().map_or_else(|| "ended".to_owned(), ToString::to_string);
                let (came, went) = (names(row.came.iter()), names(row.went.iter()));
                vec![shown(row.at), row.members.to_string(), leader, came, went]
            }),
        ),
        Rows::Events(rows) => page.table(
            &[
                Column::kept("time (UTC)"),
                Column::dropped("service", 1),
                Column::dropped("severity", 2),
                Column::kept("event"),
                Column::kept("detail"),
            ],
            rows.iter().rev().map(|row| {
                let severity = match row.severity {
                    Severity::Info => "info",
                    Severity::Warning => "warning",
                    Severity::Error => "error",
                };
                let (source, detail) = (row.source.to_string(), detail(&row.detail));
                vec![shown(row.at), source, severity.to_owned(), quoted(&row.event), detail]
            }),
        ),
        Rows::Robots(rows) => page.table(
            &[
                Column::kept("robot"),
                Column::kept("joined (UTC)"),
                Column::kept("left"),
                Column::kept("why"),
                Column::dropped("last seen", 1),
            ],
            rows.iter().rev().map(|row| {
                let joined = match row.joined {
                    Some(joined) => shown(joined),
                    None => format!("before {}", shown(row.recorded)),
                };
                let left = row.left.map_or_else(String::new, shown);
                let seen = row.last_seen.map_or_else(String::new, shown);
                vec![row.robot.to_string(), joined, left, reason(row).to_owned(), seen]
            }),
        ),
    }
}

fn as_of(division: &PastDivision, page: &Page) -> Vec<String> {
    let mut lines = vec![format!(
        "division of {} UTC, term {} epoch {}",
        shown(division.at),
        division.revision.term,
        division.revision.epoch
    )];
    if let Some(audit) = &division.audit {
        let mean = audit.mean.map_or_else(|| "undefined".to_owned(), |mean| format!("{mean:+.3}"));
        lines.push(format!(
            "silhouette {mean}, verdict {:?}, of {} UTC",
            audit.verdict,
            shown(audit.at)
        ));
    }
    let rows = division.teams.iter().map(|team| {
        let leader = team.leader.as_ref().map_or_else(|| "–".to_owned(), ToString::to_string);
        let count = team.members.len().to_string();
        vec![team.id.to_string(), count, leader, names(team.members.iter())]
    });
    lines.extend(page.table(&["team", "robots", "leader", "members"].map(Column::kept), rows));
    for (what, robots) in [("without a team", &division.unassigned), ("stale", &division.stale)] {
        if !robots.is_empty() {
            lines.push(format!("{what}: {}", names(robots.iter())));
        }
    }
    lines
}

//! Rows of a history as comma-separated values (RFC 4180).

use muster_model::history::Rows;
use muster_model::id::RobotId;
use muster_model::time::Tick;

use super::moment::exact;

/// A value, quoted where it must be.
fn value(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}

fn line<T: AsRef<str>>(values: impl IntoIterator<Item = T>) -> String {
    values.into_iter().map(|text| value(text.as_ref())).collect::<Vec<_>>().join(",")
}

fn some<T: ToString>(value: Option<T>) -> String {
    value.map_or_else(String::new, |value| value.to_string())
}

fn moment(at: Option<Tick>) -> String {
    at.map_or_else(String::new, exact)
}

/// The word that a value is in JSON.
fn word<T: serde::Serialize>(value: T) -> String {
    match serde_json::to_value(value) {
        Ok(serde_json::Value::String(word)) => word,
        _ => String::new(),
    }
}

fn names(robots: &[RobotId]) -> String {
    robots.iter().map(RobotId::as_str).collect::<Vec<_>>().join(" ")
}

/// The lines: names first, then the rows, newest first.
pub(super) fn csv(rows: &Rows) -> Vec<String> {
    match rows {
        Rows::AsOf(division) => {
            let mut lines =
                vec![line(["robot", "team", "leader", "stale", "at", "east_m", "north_m"])];
            let Some(division) = division else { return lines };
            let at = exact(division.at);
            let mut robots: Vec<(&RobotId, String, bool)> = Vec::new();
            for team in &division.teams {
                let is_leader = |robot: &RobotId| team.leader.as_ref() == Some(robot);
                robots.extend(team.members.iter().map(|r| (r, team.id.to_string(), is_leader(r))));
            }
            robots.extend(division.unassigned.iter().map(|robot| (robot, String::new(), false)));
            robots.sort();
            lines.extend(robots.into_iter().map(|(robot, team, leads)| {
                let stale = division.stale.binary_search(robot).is_ok();
                let place =
                    division.positions.get(robot).map(|at| at.map(|metres| metres.to_string()));
                let [east, north] = place.unwrap_or_default();
                let (leads, stale) = (leads.to_string(), stale.to_string());
                line([robot.as_str(), &team, &leads, &stale, &at, &east, &north])
            }));
            lines
        }
        Rows::Divisions(rows) => {
            let names = [
                "at",
                "sequence",
                "term",
                "epoch",
                "requested",
                "teams",
                "robots",
                "changed",
                "snapshot",
            ];
            let rows = rows.iter().map(|row| {
                line([
                    exact(row.at),
                    row.sequence.to_string(),
                    row.revision.term.to_string(),
                    row.revision.epoch.to_string(),
                    row.requested.to_string(),
                    row.teams.to_string(),
                    row.robots.to_string(),
                    row.changed.to_string(),
                    row.snapshot.map_or_else(String::new, word),
                ])
            });
            [line(names)].into_iter().chain(rows).collect()
        }
        Rows::Robot(rows) => {
            let names = ["at", "sequence", "team", "was", "present", "stale", "snapshot"];
            let rows = rows.iter().map(|row| {
                line([
                    exact(row.at),
                    row.sequence.to_string(),
                    some(row.team.as_ref()),
                    some(row.was.as_ref()),
                    row.present.to_string(),
                    row.stale.to_string(),
                    row.snapshot.map_or_else(String::new, word),
                ])
            });
            [line(names)].into_iter().chain(rows).collect()
        }
        Rows::Team(rows) => {
            let columns = ["at", "sequence", "members", "leader", "came", "went"];
            let rows = rows.iter().map(|row| {
                line([
                    exact(row.at),
                    row.sequence.to_string(),
                    row.members.to_string(),
                    some(row.leader.as_ref()),
                    names(&row.came),
                    names(&row.went),
                ])
            });
            [line(columns)].into_iter().chain(rows).collect()
        }
        Rows::Events(rows) => {
            let names = ["at", "sequence", "source", "severity", "event", "detail"];
            let rows = rows.iter().map(|row| {
                line([
                    exact(row.at),
                    row.sequence.to_string(),
                    row.source.to_string(),
                    word(row.severity),
                    row.event.clone(),
                    row.detail.clone(),
                ])
            });
            [line(names)].into_iter().chain(rows).collect()
        }
        Rows::Robots(rows) => {
            let names = ["robot", "joined", "recorded", "left", "last_seen", "reason"];
            let rows = rows.iter().map(|row| {
                line([
                    row.robot.to_string(),
                    moment(row.joined),
                    exact(row.recorded),
                    moment(row.left),
                    moment(row.last_seen),
                    row.reason.map_or_else(String::new, word),
                ])
            });
            [line(names)].into_iter().chain(rows).collect()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_with_commas_and_quotes_are_quoted() {
        assert_eq!(line(["a", "b,c", "d\"e"]), "a,\"b,c\",\"d\"\"e\"");
    }
}

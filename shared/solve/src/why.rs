//! `muster solve --why`: why a robot is in its team.

use std::fmt::Write as _;

use comfy_table::presets::UTF8_BORDERS_ONLY;
use comfy_table::{Cell, CellAlignment, Table};
use muster_method::reasons::TeamPull;
use muster_model::id::{Modality, RobotId};
use serde::Serialize;

use super::error::{SolveError, refuse};
use super::method::Solution;
use super::problem::Problem;

/// Why a robot is in its team.
#[derive(Debug, Serialize)]
pub(super) struct Reasons {
    robot: RobotId,
    /// The label of its team; none where it has no row.
    team: Option<usize>,
    /// The teams, that with the largest score first.
    teams: Vec<TeamReason>,
}

/// What draws the robot to one team; all but the score add up to the score.
#[derive(Debug, Serialize)]
struct TeamReason {
    team: usize,
    score: f64,
    modalities: Vec<ModalityPull>,
    itself: f64,
    spread: f64,
    rest: f64,
    /// What a place in it costs under limits, which counts against the score.
    #[serde(skip_serializing_if = "Option::is_none")]
    price: Option<f64>,
}

#[derive(Debug, Serialize)]
struct ModalityPull {
    name: Modality,
    pull: f64,
}

/// Why a robot of a solved problem is in its team.
///
/// # Errors
/// If the file does not have the robot.
pub(super) fn reasons(
    problem: &Problem,
    solution: &Solution,
    robot: &RobotId,
) -> Result<Reasons, SolveError> {
    let Some(place) = problem.robots.iter().position(|other| other == robot) else {
        return refuse("--why", format!("{robot} is not among \"robots\""));
    };
    let unassigned = solution.divided.unassigned;
    let labels = solution.divided.labels.iter();
    let labels: Vec<Option<usize>> =
        labels.map(|label| Some(*label).filter(|label| unassigned != Some(*label))).collect();
    let settings = &problem.settings;
    let (svd, power) = (&solution.decomposition.svd, settings.scale.power());
    let frames = solution.frames.iter();
    let pulls = frames.flat_map(|frames| frames.reasons(svd, power, settings.rows, place, &labels));
    let prices = solution.divided.within.as_ref().map(|within| &within.prices);
    let reason = |pull: TeamPull| TeamReason {
        team: pull.team,
        score: pull.score,
        modalities: (pull.modalities.into_iter())
            .map(|(name, pull)| ModalityPull { name, pull })
            .collect(),
        itself: pull.itself,
        spread: pull.spread,
        rest: pull.rest,
        price: prices.and_then(|prices| prices.get(pull.team).copied().flatten()),
    };
    let teams = pulls.map(reason).collect();
    Ok(Reasons { robot: robot.clone(), team: labels[place], teams })
}

impl Reasons {
    /// One JSON object and a line break.
    ///
    /// # Errors
    /// If it does not serialise.
    pub(super) fn to_json(&self) -> serde_json::Result<String> {
        serde_json::to_string(self).map(|text| format!("{text}\n"))
    }

    /// A sentence and a table.
    pub(super) fn text(&self) -> String {
        let robot = &self.robot;
        let Some(team) = self.team else {
            return format!(
                "{robot} is in no team: it has no edges, or only such to robots that the leading \
                 singular vectors do not see\n"
            );
        };
        let mut text = format!("{robot} is in team {team}");
        let own = self.teams.iter().find(|reason| reason.team == team);
        match (own, self.teams.iter().find(|reason| reason.team != team)) {
            (Some(own), Some(next)) => {
                let apart = own.score - next.score;
                let mut gains: Vec<(&Modality, f64)> = own
                    .modalities
                    .iter()
                    .zip(&next.modalities)
                    .map(|(own, next)| (&own.name, own.pull - next.pull))
                    .collect();
                gains.sort_by(|left, right| right.1.total_cmp(&left.1));
                let _ = write!(text, ", {apart:.3} ahead of team {}: ", next.team);
                let gains: Vec<_> =
                    gains.iter().map(|(name, gain)| format!("{name} {gain:+.3}")).collect();
                let others =
                    own.itself + own.spread + own.rest - next.itself - next.spread - next.rest;
                let _ = write!(text, "{}, all else {others:+.3}", gains.join(", "));
                if let (Some(own), Some(next)) = (own.price, next.price) {
                    let _ = write!(text, "; by the limits its place costs {:+.3}", own - next);
                }
                text.push('\n');
            }
            _ => text.push_str(", and there is no other\n"),
        }
        let mut table = Table::new();
        table.load_style(UTF8_BORDERS_ONLY);
        let first = self.teams.first();
        let names = first.iter().flat_map(|reason| &reason.modalities);
        let names: Vec<String> = names.map(|pull| pull.name.to_string()).collect();
        let head = |name: &str| name.to_owned();
        let columns = [head("team"), head("score")].into_iter().chain(names);
        let is_limited = self.teams.iter().any(|reason| reason.price.is_some());
        let last = ["itself", "spread", "rest"].into_iter().chain(is_limited.then_some("price"));
        table.set_header(columns.chain(last.map(head)));
        for reason in &self.teams {
            let numbers = std::iter::once(reason.score)
                .chain(reason.modalities.iter().map(|pull| pull.pull))
                .chain([reason.itself, reason.spread, reason.rest])
                .chain(is_limited.then_some(reason.price.unwrap_or(0.0)));
            let right = |text: String| Cell::new(text).set_alignment(CellAlignment::Right);
            let cells = numbers.map(|number| right(format!("{number:.4}")));
            table.add_row(std::iter::once(right(reason.team.to_string())).chain(cells));
        }
        format!("{text}{table}\n")
    }
}

#[cfg(test)]
mod tests {
    use super::super::options::Options;
    use super::super::{parse, solve};
    use super::*;

    const FLEET: &str = r#"{"robots": ["a", "b", "c", "d", "e", "f", "x"], "teams": 2,
        "modalities": [
            {"name": "radio", "weight": 0.5, "edges": [["a","b",1],["b","a",1],["b","c",1],["c","b",1],["a","c",1],
             ["c","a",1],["d","e",1],["e","d",1],["e","f",1],["f","e",1],["d","f",1],["f","d",1]]},
            {"name": "places", "weight": 0.5, "edges": [["a","b",1],["b","a",1],["d","e",1],["e","d",1],
             ["c","d",0.3],["d","c",0.3]]}]}"#;

    fn of(robot: &str) -> Result<Reasons, SolveError> {
        let mut problem = parse(FLEET.as_bytes(), Options::default()).unwrap();
        problem.keeps_frames = true;
        let solution = solve(&problem, &mut |_| {}).unwrap();
        reasons(&problem, &solution, &RobotId::new(robot).unwrap())
    }

    #[test]
    fn the_parts_add_up_and_are_shown() {
        let found = of("c").unwrap();
        assert_eq!((found.team, found.teams.len()), (Some(0), 2));
        assert_eq!(found.teams[0].team, 0, "the nearest team is its own");
        for reason in &found.teams {
            let pulls: f64 = reason.modalities.iter().map(|pull| pull.pull).sum();
            let sum = pulls + reason.itself + reason.spread + reason.rest;
            assert!((sum - reason.score).abs() < 1e-9 && reason.rest.abs() < 1e-9, "{reason:?}");
        }
        // Its place draws it to the others, its radio to its own.
        let pull = |team: usize, place: usize| found.teams[team].modalities[place].pull;
        assert_eq!(found.teams[0].modalities[0].name.as_str(), "places");
        assert!(pull(1, 0) > pull(0, 0) && pull(0, 1) > pull(1, 1), "{found:?}");
        let text = found.text();
        assert!(text.starts_with("c is in team 0, ") && text.contains("radio +"), "{text}");
        let json: serde_json::Value = serde_json::from_str(&found.to_json().unwrap()).unwrap();
        assert_eq!(json["teams"][0]["modalities"][1]["name"], "radio");
    }

    #[test]
    fn a_robot_without_a_team_or_without_a_place_in_the_file_is_told_so() {
        let alone = of("x").unwrap();
        assert!(alone.teams.is_empty() && alone.text().contains("no team"), "{}", alone.text());
        assert!(of("nobody").unwrap_err().to_string().starts_with("--why: nobody is not among"));
    }
}

//! Proposals as lines of text.

use muster_model::id::TeamId;
use muster_model::proposal::{
    Proposal, ProposalState, ProposedDivision, ProposedMove, ProposedTeam,
};

use crate::show::page::{Column, Page};

/// Most moves that are shown; all are in `--json`.
const MAX_MOVES: usize = 64;

/// A silhouette as the table has it; rounding has no sign.
fn shown(value: Option<f64>) -> String {
    let text = value.map_or_else(|| "–".to_owned(), |value| format!("{value:.3}"));
    if text == "-0.000" { "0.000".to_owned() } else { text }
}

/// A difference with its sign.
fn signed(value: Option<f64>) -> String {
    let text = value.map_or_else(|| "–".to_owned(), |value| format!("{value:+.3}"));
    if text == "-0.000" { "+0.000".to_owned() } else { text }
}

/// What was asked, as one line of JSON.
fn asked(proposal: &Proposal) -> String {
    serde_json::to_string(&proposal.asked).unwrap_or_default()
}

fn count(number: usize, noun: &str) -> String {
    if number == 1 { format!("1 {noun}") } else { format!("{number} {noun}s") }
}

/// A proposal: what was asked, the quality before and after, the teams, and who would move.
pub(super) fn lines(proposal: &Proposal, page: &Page) -> Vec<String> {
    let name = format!("{}/{}", proposal.operator, proposal.id);
    let Some(division) = &proposal.division else {
        return vec![match proposal.state {
            ProposalState::Dropped => format!("{name} is dropped"),
            _ => format!(
                "{name} is still being computed, after {:.0} s, behind {}; muster propose show {}",
                proposal.age_s,
                count(proposal.ahead as usize, "other"),
                proposal.id
            ),
        }];
    };
    let forgotten = proposal.forgotten_in_s.unwrap_or(0.0);
    let mut lines = vec![format!(
        "{name}  {} instead of {} for {}  forgotten in {forgotten:.0} s",
        count(division.teams.len(), "team"),
        division.live_teams.len(),
        asked(proposal)
    )];
    if let Some(conflict) = &division.conflict {
        lines.push(format!("not all needs can be filled: {conflict}"));
    }
    lines.extend(quality(division, page));
    lines.extend(teams(division, page));
    lines.extend(moves(division, page));
    lines.push(format!("apply it with `muster propose accept {}`", proposal.id));
    lines
}

fn quality(division: &ProposedDivision, page: &Page) -> Vec<String> {
    let columns = ["silhouette", "now", "proposed", "change"].map(Column::kept);
    let ProposedDivision { live, proposed, change, .. } = division;
    let row = |name: &str, now, then, change| {
        vec![name.to_owned(), shown(now), shown(then), signed(change)]
    };
    let rows = [
        row("mean", live.mean, proposed.mean, change.mean),
        row("least team", live.least_team, proposed.least_team, change.least_team),
        row("among positions", live.physical_mean, proposed.physical_mean, change.physical_mean),
    ];
    page.table(&columns, rows.into_iter())
}

fn teams(division: &ProposedDivision, page: &Page) -> Vec<String> {
    let columns = ["team", "robots", "before", "mean", "before", "least"].map(Column::kept);
    let row = |team: &ProposedTeam| {
        let before = division.live_teams.iter().find(|live| live.id == team.id);
        vec![
            team.id.to_string(),
            team.members.len().to_string(),
            before.map_or_else(|| "new".to_owned(), |live| live.robots.to_string()),
            shown(team.mean),
            shown(before.and_then(|live| live.mean)),
            shown(team.least),
        ]
    };
    let ended = division.live_teams.iter();
    let ended = ended.filter(|live| division.teams.iter().all(|team| team.id != live.id));
    let ended = ended.map(|live| {
        let robots = live.robots.to_string();
        vec![
            live.id.to_string(),
            "0".to_owned(),
            robots,
            shown(None),
            shown(live.mean),
            shown(None),
        ]
    });
    page.table(&columns, division.teams.iter().map(row).chain(ended))
}

fn moves(division: &ProposedDivision, page: &Page) -> Vec<String> {
    let all = &division.moves;
    if all.is_empty() {
        return vec!["no robot would move".to_owned()];
    }
    let mut lines = vec![format!("{} would move", count(all.len(), "robot"))];
    let columns = ["robot", "from", "to"].map(Column::kept);
    let team = |team: &Option<TeamId>| {
        team.as_ref().map_or_else(|| "none".to_owned(), ToString::to_string)
    };
    let row =
        |moved: &ProposedMove| vec![moved.robot.to_string(), team(&moved.from), team(&moved.to)];
    lines.extend(page.table(&columns, all.iter().take(MAX_MOVES).map(row)));
    if all.len() > MAX_MOVES {
        lines.push(format!("… and {} more; --json has all", all.len() - MAX_MOVES));
    }
    lines
}

/// Open proposals, one in each row.
pub(super) fn list(proposals: &[Proposal], page: &Page) -> Vec<String> {
    if proposals.is_empty() {
        return Vec::new();
    }
    let columns = [
        Column::kept("id"),
        Column::kept("asked"),
        Column::kept("state"),
        Column::kept("moves"),
        Column::kept("mean"),
        Column::kept("change"),
        Column::dropped("forgotten in", 1),
    ];
    let row = |proposal: &Proposal| {
        let division = proposal.division.as_ref();
        let state = match proposal.state {
            ProposalState::Computing => "computing",
            ProposalState::Ready => "ready",
            ProposalState::Dropped => "dropped",
        };
        let forgotten = proposal.forgotten_in_s;
        vec![
            proposal.id.to_string(),
            asked(proposal),
            state.to_owned(),
            division.map_or_else(String::new, |division| division.moves.len().to_string()),
            division.map_or_else(String::new, |division| shown(division.proposed.mean)),
            division.map_or_else(String::new, |division| signed(division.change.mean)),
            forgotten.map_or_else(String::new, |seconds| format!("{seconds:.0} s")),
        ]
    };
    page.table(&columns, proposals.iter().map(row))
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn proposal(state: &str, division: serde_json::Value) -> Proposal {
        serde_json::from_value(json!({
            "operator": "alice", "id": "p1", "state": state, "asked": {"teams": 3}, "ahead": 1,
            "age_s": 4.2, "forgotten_in_s": 58.0, "division": division,
        }))
        .unwrap()
    }

    #[test]
    fn a_proposal_shows_quality_teams_and_moves() {
        let quality = |mean: f64| json!({"mean": mean, "least_team": 0.25, "physical_mean": null});
        let ready = proposal(
            "ready",
            json!({
                "based_on": {"term": 1, "epoch": 2}, "replaces": {}, "embedded": true,
                "teams": [{"id": "t1", "members": ["r1"], "mean": 0.5, "least": 0.5},
                          {"id": "t3", "members": ["r2"], "mean": 0.5, "least": 0.4}],
                "unassigned": ["r3"],
                "moves": [{"robot": "r2", "from": "t2", "to": "t3"},
                          {"robot": "r3", "from": "t2", "to": null}],
                "proposed": quality(0.5), "live": quality(0.375), "change": quality(0.125),
                "live_teams": [{"id": "t1", "robots": 1, "mean": 0.5, "least": 0.5},
                               {"id": "t2", "robots": 2, "mean": 0.25, "least": 0.1}],
                "conflict": null,
            }),
        );
        let text = lines(&ready, &Page::default()).join("\n");
        for part in [
            "alice/p1  2 teams instead of 2 for {\"teams\":3}  forgotten in 58 s",
            "0.375 ┆ 0.500    ┆ +0.125",
            "t3   ┆ 1      ┆ new",
            "t2   ┆ 0      ┆ 2",
            "2 robots would move",
            "r2    ┆ t2   ┆ t3",
            "r3    ┆ t2   ┆ none",
            "muster propose accept p1",
        ] {
            assert!(text.contains(part), "{part}\n{text}");
        }
        let computing = proposal("computing", json!(null));
        assert!(lines(&computing, &Page::default())[0].contains("behind 1 other"));
        let text = list(&[ready, computing], &Page::default()).join("\n");
        assert!(text.contains("computing") && text.contains("58 s"), "{text}");
    }
}

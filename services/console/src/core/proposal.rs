//! A proposal as browsers see it: teams are counted, since a browser draws each robot from the live division and from who
//! would move.

use muster_model::proposal::{Proposal, ProposedDivision};
use serde_json::{Value, json};

use super::limits::MAX_MOVES_LISTED;

/// The proposal in JSON: as it stands on the bus, with the robots of each team counted, and no more than
/// [`MAX_MOVES_LISTED`] robots that would move. `moved` says how many would.
#[must_use]
pub fn brief(proposal: &Proposal) -> Value {
    json!({
        "id": proposal.id,
        "state": proposal.state,
        "asked": proposal.asked,
        "ahead": proposal.ahead,
        "age_s": proposal.age_s,
        "forgotten_in_s": proposal.forgotten_in_s,
        "division": proposal.division.as_ref().map(division),
    })
}

fn division(division: &ProposedDivision) -> Value {
    let teams = division.teams.iter().map(|team| {
        json!({"id": team.id, "robots": team.members.len(), "mean": team.mean, "least": team.least})
    });
    let listed = division.moves.len().min(MAX_MOVES_LISTED);
    json!({
        "replaces": division.replaces,
        "embedded": division.embedded,
        "teams": teams.collect::<Vec<_>>(),
        "live_teams": division.live_teams,
        "unassigned": division.unassigned.len(),
        "moved": division.moves.len(),
        "moves": division.moves[..listed],
        "proposed": division.proposed,
        "live": division.live,
        "change": division.change,
        "conflict": division.conflict,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::limits::MAX_REPLY_BYTES;

    #[test]
    fn a_proposal_for_the_largest_fleet_fits_into_a_reply() {
        let name = |number: usize| format!("{number:05}{}", "r".repeat(59));
        let robots: Vec<String> = (0..100_000).map(name).collect();
        let (from, to) = ("a".repeat(64), "b".repeat(64));
        let moves = robots.iter().map(|robot| json!({"robot": robot, "from": from, "to": to}));
        let quality = json!({"mean": 0.5, "least_team": 0.25, "physical_mean": null});
        let proposal = json!({
            "operator": "kim", "id": "c1", "state": "ready", "asked": {"teams": 3}, "ahead": 0, "age_s": 1.0,
            "forgotten_in_s": 59.0,
            "division": {
                "based_on": {"term": 1, "epoch": 7}, "replaces": {"clusterer": {"teams": 2}}, "embedded": false,
                "teams": [{"id": to, "members": robots, "mean": 0.5, "least": -0.25}], "unassigned": [],
                "moves": moves.collect::<Vec<_>>(), "proposed": quality, "live": quality, "change": quality,
                "live_teams": [{"id": from, "robots": 100_000, "mean": 0.5, "least": 0.25}], "conflict": null,
            },
        });
        let proposal: Proposal = serde_json::from_value(proposal).unwrap();
        let brief = brief(&proposal);
        assert!(brief.to_string().len() < MAX_REPLY_BYTES / 2);
        let division = &brief["division"];
        assert_eq!(
            (&division["moved"], &division["teams"][0]["robots"]),
            (&json!(100_000), &json!(100_000))
        );
        assert_eq!(division["moves"].as_array().unwrap().len(), MAX_MOVES_LISTED);
        assert_eq!(brief["asked"], json!({"teams": 3}));
    }
}

//! `muster teams`: the division of the live fleet.

use muster_model::id::TeamId;
use muster_model::teams::{TeamChange, Teams};
use muster_model::time::Tick;
use muster_runtime::config::ProcessConfig;
use muster_wire::json::EdgeJson;

use super::ShowArgs;
use super::page::{Column, Page, names};
use super::watch::{Shown, follow, print};
use crate::console::{self, exit_error};

/// Shows the teams, or every change of them.
///
/// # Errors
/// If no router or no service answers.
pub(crate) async fn run(args: &ShowArgs, config: &ProcessConfig) -> anyhow::Result<()> {
    let client = console::open(config).await?;
    if args.watch {
        let teams = client.teams().await.map_err(exit_error)?;
        return follow(&client, teams, args.json).await;
    }
    let teams = client.get_teams().await;
    client.close().await;
    print(&*teams.map_err(exit_error)?, args.json)
}

impl Shown for Teams {
    const PUBLISHER: &'static str = "clusterer";

    fn lines(&self, page: &Page, now: Tick) -> Vec<String> {
        let header = &self.header;
        let age = header.data_age_s(now);
        let mut lines = vec![format!(
            "fleet {}  term {}  epoch {}  {}",
            header.fleet,
            header.revision.term,
            header.revision.epoch,
            age.map_or("no poses".to_owned(), |age| format!("data {age:.2} s old"))
        )];
        let mut rows: Vec<Vec<String>> = Vec::new();
        for team in &self.teams {
            rows.push(vec![
                team.id.to_string(),
                team.members.len().to_string(),
                team.leader.to_string(),
                names(team.members.iter().map(|member| &member.robot)),
            ]);
        }
        if !self.unassigned.is_empty() {
            let count = self.unassigned.len().to_string();
            let robots = names(self.unassigned.iter());
            rows.push(vec!["none".to_owned(), count, String::new(), robots]);
        }
        let columns = ["team", "robots", "leader", "members"].map(Column::kept);
        lines.extend(page.table(&columns, rows.into_iter()));
        if !self.stale.is_empty() {
            lines.push(format!("stale: {}", names(self.stale.iter())));
        }
        if !self.provisional.is_empty() {
            let robots = names(self.provisional.iter());
            lines.push(format!("provisional, as one modality alone relates them: {robots}"));
        }
        if let Some(conflict) = self.limited.as_ref().and_then(|limited| limited.conflict.as_ref())
        {
            lines.push(format!("limits do not hold: {conflict}"));
        }
        let lacking = self.needs.iter().filter(|need| need.lacks() > 0);
        lines.extend(lacking.map(|need| {
            format!("{} has {} of {} with {}", need.team, need.have, need.min, need.skill)
        }));
        lines.extend(self.changes.iter().map(|change| format!("  {}", describe(change))));
        lines
    }

    fn json(&self, now: Tick) -> Result<Vec<u8>, serde_json::Error> {
        Ok([self.to_json(now)?, b"\n".to_vec()].concat())
    }

    fn same(&self, other: &Self) -> bool {
        self.same_division(other)
    }
}

/// One change in words.
fn describe(change: &TeamChange) -> String {
    use TeamChange::{Born, Died, Merged, Moved, Split};
    let place = |team: &Option<TeamId>| {
        team.as_ref().map_or_else(|| "no team".to_owned(), ToString::to_string)
    };
    match change {
        Born { team } => format!("{team} is new"),
        Died { team } => format!("{team} is gone"),
        Split { from, into } => format!("{into} split off {from}"),
        Merged { from, into } => format!("{from} merged into {into}"),
        Moved { robot, from, to } => format!("{robot} moved from {} to {}", place(from), place(to)),
    }
}

#[cfg(test)]
mod tests {
    use muster_model::header::{Header, Revision};
    use muster_model::id::{FleetId, RobotId};
    use muster_model::remembered::RememberedTeams;
    use muster_model::teams::{Member, Team};

    use super::super::page::tests::{WIDTHS, assert_fits, page};
    use super::*;

    fn robot(name: String) -> RobotId {
        RobotId::new(name).unwrap()
    }

    fn division() -> Teams {
        let team = |number: u64| Team {
            id: TeamId::numbered(number),
            members: (0..30)
                .map(|i| Member { robot: robot(format!("t{number}-robot-{i}")), margin: 0.5 })
                .collect(),
            leader: robot("x".repeat(64)),
            centroid: vec![],
        };
        Teams {
            header: Header {
                fleet: FleetId::new("alpha").unwrap(),
                revision: Revision { term: 3, epoch: 44 },
                oldest: Some(Tick(9_000_000)),
                newest: None,
                stages: vec![],
            },
            teams: vec![team(1), team(2)],
            requested: 2,
            considered: vec![],
            next_team: 3,
            limited: None,
            needs: vec![],
            provisional: vec![],
            held: vec![],
            remembered: RememberedTeams::default(),
            inertia: 0.0,
            unassigned: vec![robot("loose".to_owned())],
            stale: vec![],
            changes: vec![TeamChange::Born { team: TeamId::numbered(2) }],
            embedding: Revision::default(),
        }
    }

    #[test]
    fn the_table_fits_the_terminal_and_names_every_team() {
        for width in WIDTHS {
            let lines = division().lines(&page(width), Tick(9_250_000));
            assert_eq!(lines[0], "fleet alpha  term 3  epoch 44  data 0.25 s old");
            assert_fits(&lines, width);
            let text = lines.join("\n");
            for name in ["t1", "t2", "none", "loose", "t2-robot-3", "more", "t2 is new"] {
                assert!(text.contains(name), "{width}: {name} is missing\n{text}");
            }
        }
    }
}

//! `muster audit`: the silhouettes of the live division.

use muster_model::audit::{Audit, Flapping, SilhouetteMethod, SilhouetteReport};
use muster_model::id::TeamId;
use muster_model::team_audit::{Conductance, LeastFitting, Radio, SkillCover, Spread, TeamAudit};
use muster_model::time::Tick;
use muster_runtime::config::ProcessConfig;
use muster_wire::json::EdgeJson;

use super::ShowArgs;
use super::page::{Column, Page, names};
use super::watch::{Shown, follow, print};
use crate::console::{self, exit_error};

/// How many robots with the lowest silhouettes are named.
const LOWEST_ROBOTS: usize = 5;

/// Shows the silhouettes, or every change of them.
///
/// # Errors
/// If no router or no service answers.
pub(crate) async fn run(args: &ShowArgs, config: &ProcessConfig) -> anyhow::Result<()> {
    let client = console::open(config).await?;
    if args.watch {
        let audits = client.audits().await.map_err(exit_error)?;
        return follow(&client, audits, args.json).await;
    }
    let audit = client.get_audit().await;
    client.close().await;
    print(&*audit.map_err(exit_error)?, args.json)
}

fn score(value: Option<f64>) -> String {
    value.map_or_else(|| "undefined".to_owned(), |value| format!("{value:+.3}"))
}

impl Shown for Audit {
    const PUBLISHER: &'static str = "auditor";

    fn lines(&self, page: &Page, _: Tick) -> Vec<String> {
        let mut lines = vec![
            format!(
                "fleet {}  epoch {}  verdict {:?}",
                self.header.fleet, self.header.revision.epoch, self.quality
            ),
            format!(
                "silhouette {} in the embedding, {} in physical space",
                mean(&self.in_embedding),
                mean(&self.in_physical)
            ),
            flapping(&self.flapping),
        ];
        lines.extend(teams(self, page));
        if self.in_embedding.detail_method == SilhouetteMethod::SquaredExact {
            lines.push("those of teams and robots are of squared distances".to_owned());
        }
        let mut lowest: Vec<_> = self.in_embedding.per_robot.iter().collect();
        lowest.sort_by(|left, right| left.1.total_cmp(&right.1));
        lowest.truncate(LOWEST_ROBOTS);
        let lowest = lowest.iter().map(|(robot, value)| format!("{robot} {value:+.3}"));
        lines.push(format!("lowest: {}", names(lowest)));
        if !self.losses.is_empty() {
            lines.push("the worst losses:".to_owned());
        }
        lines.extend(self.losses.iter().map(|loss| format!("  {}", loss.describe())));
        lines
    }

    fn json(&self, now: Tick) -> Result<Vec<u8>, serde_json::Error> {
        Ok([self.to_json(now)?, b"\n".to_vec()].concat())
    }

    fn same(&self, other: &Self) -> bool {
        self.in_embedding == other.in_embedding
            && self.in_physical == other.in_physical
            && self.flapping == other.flapping
            && self.per_team == other.per_team
            && self.losses == other.losses
    }
}

/// One line for each team.
fn teams(audit: &Audit, page: &Page) -> Vec<String> {
    let columns = [
        Column::kept("team"),
        Column::kept("robots"),
        Column::dropped("stale", 4),
        Column::kept("embedding"),
        Column::dropped("physical", 5),
        Column::dropped("least", 6),
        Column::dropped("conductance", 7),
        Column::dropped("radio", 1),
        Column::dropped("falls apart without", 2),
        Column::dropped("heads", 8),
        Column::dropped("spread", 3),
        Column::dropped("skills", 9),
    ];
    let physical = |team: &TeamId| {
        let all = &audit.in_physical.per_team;
        all.iter().find(|(id, _)| id == team).map(|(_, value)| *value)
    };
    let row = |of: &TeamAudit| {
        let least = |least: &LeastFitting| format!("{} {:+.3}", least.robot, least.silhouette);
        let conductance =
            |of: &Conductance| format!("{} {:.2}", of.modality.as_str(), of.conductance);
        let spread = |of: Spread| format!("{:.1} m, at most {:.1} m", of.rms_m, of.largest_m);
        let head = of.only_head.as_ref().map(|head| format!(": {head}")).unwrap_or_default();
        vec![
            of.team.to_string(),
            of.robots.to_string(),
            of.stale.to_string(),
            score(of.silhouette),
            score(physical(&of.team)),
            of.least.as_ref().map(least).unwrap_or_default(),
            of.conductance.iter().map(conductance).collect::<Vec<_>>().join(", "),
            of.radio.as_ref().map_or("no links".to_owned(), |radio| heard(radio, of)),
            of.radio.as_ref().map(cut_robots).unwrap_or_default(),
            format!("{}{head}", of.heads),
            of.spread.map(spread).unwrap_or_default(),
            of.skills.iter().map(skill).collect::<Vec<_>>().join(", "),
        ]
    };
    page.table(&columns, audit.per_team.iter().map(row))
}

/// How many robots of a team have a skill, and how many of them it could spare or lacks.
fn skill(of: &SkillCover) -> String {
    let SkillCover { skill, robots, needed, spare, lacking } = of;
    match (*needed, *lacking) {
        (0, _) => format!("{skill} {robots}"),
        (_, 0) => format!("{skill} {robots} ({spare} spare)"),
        (_, lacking) => format!("{skill} {robots} ({lacking} LACKING)"),
    }
}

/// In how many parts a team is, and how many robots its leader reaches if that is not all.
fn heard(radio: &Radio, team: &TeamAudit) -> String {
    let parts = match radio.parts {
        1 => "1 part".to_owned(),
        parts => format!("{parts} PARTS"),
    };
    let there = team.robots.saturating_sub(team.stale);
    if radio.reached_by_leader >= there {
        return parts;
    }
    format!("{parts}, leader reaches {} of {there}", radio.reached_by_leader)
}

/// The robots without which a team falls apart.
fn cut_robots(radio: &Radio) -> String {
    let unnamed = (radio.cut_robot_count as usize).saturating_sub(radio.cut_robots.len());
    match (radio.cut_robots.is_empty(), unnamed) {
        (true, _) => String::new(),
        (false, 0) => names(radio.cut_robots.iter()),
        (false, more) => format!("{} and {more} more", names(radio.cut_robots.iter())),
    }
}

/// How often robots change their team and change back, and which.
pub(super) fn flapping(flapping: &Flapping) -> String {
    let rate = flapping.returns_per_robot_minute;
    let robots = flapping.robots.iter().map(|entry| format!("{} {}×", entry.robot, entry.returns));
    let robots =
        if flapping.robots.is_empty() { String::new() } else { format!(": {}", names(robots)) };
    format!("changes back into a team: {rate:.2} per robot and minute{robots}")
}

/// The mean, with its standard error where it is an estimate.
fn mean(report: &SilhouetteReport) -> String {
    match report.method {
        SilhouetteMethod::Sampled => {
            format!("{} ± {:.3} (sampled)", score(report.mean), report.standard_error)
        }
        SilhouetteMethod::Exact | SilhouetteMethod::SquaredExact => score(report.mean),
    }
}

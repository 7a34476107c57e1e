//! `muster audit`: the silhouettes of the live division.

use muster_model::audit::{Audit, Flapping, SilhouetteMethod, SilhouetteReport};
use muster_model::id::TeamId;
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
        let of = |report: &SilhouetteReport, team: &TeamId| {
            report.per_team.iter().find(|(id, _)| id == team).map(|(_, value)| *value)
        };
        let rows = self.in_embedding.per_team.iter().map(|(team, value)| {
            vec![team.to_string(), score(Some(*value)), score(of(&self.in_physical, team))]
        });
        let columns = ["team", "embedding", "physical"].map(Column::kept);
        lines.extend(page.table(&columns, rows));
        if self.in_embedding.detail_method == SilhouetteMethod::SquaredExact {
            lines.push("those of teams and robots are of squared distances".to_owned());
        }
        let mut lowest: Vec<_> = self.in_embedding.per_robot.iter().collect();
        lowest.sort_by(|left, right| left.1.total_cmp(&right.1));
        lowest.truncate(LOWEST_ROBOTS);
        let lowest = lowest.iter().map(|(robot, value)| format!("{robot} {value:+.3}"));
        lines.push(format!("lowest: {}", names(lowest)));
        lines
    }

    fn json(&self, now: Tick) -> Result<Vec<u8>, serde_json::Error> {
        Ok([self.to_json(now)?, b"\n".to_vec()].concat())
    }

    fn same(&self, other: &Self) -> bool {
        self.in_embedding == other.in_embedding
            && self.in_physical == other.in_physical
            && self.flapping == other.flapping
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

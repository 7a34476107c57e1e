//! `muster audit`: the silhouettes of the live division.

use std::io::Write as _;

use muster_model::audit::{Audit, SilhouetteMethod, SilhouetteReport};
use muster_model::time::Tick;
use muster_runtime::clock::Clock;
use muster_runtime::config::ProcessConfig;
use muster_wire::json::EdgeJson;
use muster_wire::{Key, Message};

use super::{ShowArgs, names, table};
use crate::ask;

/// How many of the worst placed robots are named.
const WORST: usize = 5;

/// Shows the judgement, or every change of it.
///
/// # Errors
/// If no router answers, or nobody knows the judgement.
pub(crate) async fn run(args: &ShowArgs, config: &ProcessConfig) -> anyhow::Result<()> {
    let clock = Clock::start();
    let bus = ask::open(config).await?;
    if !args.watch {
        let newest = ask::newest(&bus, Key::Audit).await;
        bus.close().await;
        if let Message::Audit(audit) = newest? {
            print(&audit, args.json, clock.now())?;
        }
        return Ok(());
    }
    let mut follow = ask::follow(&bus, Key::Audit).await?;
    let mut shown: Option<std::sync::Arc<Audit>> = None;
    loop {
        let message = follow.next().await;
        let Message::Audit(audit) = message else { continue };
        let same = shown.as_ref().is_some_and(|shown| {
            shown.in_embedding == audit.in_embedding && shown.in_physical == audit.in_physical
        });
        if !same {
            print(&audit, args.json, clock.now())?;
            shown = Some(audit);
        }
    }
}

fn score(value: Option<f64>) -> String {
    value.map_or_else(|| "undefined".to_owned(), |value| format!("{value:+.3}"))
}

fn print(audit: &Audit, json: bool, now: Tick) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    if json {
        out.write_all(&audit.to_json(now)?)?;
        writeln!(out)?;
        return Ok(out.flush()?);
    }
    writeln!(
        out,
        "fleet {}  epoch {}  verdict {:?}  silhouette {} in the embedding, {} in physical space",
        audit.header.fleet,
        audit.header.revision.epoch,
        audit.verdict,
        mean(&audit.in_embedding),
        mean(&audit.in_physical),
    )?;
    let of = |report: &SilhouetteReport, team: &muster_model::id::TeamId| {
        report.per_team.iter().find(|(id, _)| id == team).map(|(_, value)| *value)
    };
    let mut table = table(&["team", "embedding", "physical"]);
    for (team, value) in &audit.in_embedding.per_team {
        table.add_row([team.to_string(), score(Some(*value)), score(of(&audit.in_physical, team))]);
    }
    writeln!(out, "{table}")?;
    if audit.in_embedding.detail_method == SilhouetteMethod::SquaredExact {
        writeln!(out, "those of teams and robots are of squared distances")?;
    }
    let mut worst: Vec<_> = audit.in_embedding.per_robot.iter().collect();
    worst.sort_by(|left, right| left.1.total_cmp(&right.1));
    worst.truncate(WORST);
    let worst = worst.iter().map(|(robot, value)| format!("{robot} {value:+.3}"));
    writeln!(out, "least at home: {}", names(worst))?;
    Ok(out.flush()?)
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

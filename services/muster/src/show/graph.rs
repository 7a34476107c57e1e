//! `muster graph`: the graphs of the live fleet, each or fused.

use std::io::Write as _;
use std::time::Duration;

use muster_model::graph::GraphDelta;
use muster_model::header::Revision;
use muster_model::id::{Modality, RobotId};
use muster_model::time::Tick;
use muster_runtime::bus::Bus;
use muster_runtime::clock::Clock;
use muster_runtime::config::ProcessConfig;
use muster_runtime::exit::ExitError;
use muster_wire::json::EdgeJson;
use muster_wire::{Key, Message, Pattern};

use super::{ShowArgs, katz, table};
use crate::ask;

/// How often `--watch` looks: a graph of a fleet that moves changes in every frame.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// Most edges that are printed as a table; all are in `--json`.
const MAX_EDGES: usize = 200;

/// Arguments of `muster graph`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  muster graph\n  muster graph hierarchy\n  muster graph spatial --json\n  \
                  muster graph --katz r1 r2"
)]
pub(crate) struct GraphArgs {
    /// One modality, edge by edge; all, in numbers, if none is named
    modality: Option<Modality>,
    /// How near two robots are to one another in the fused graph, and the share of each modality
    #[arg(long, num_args = 2, value_names = ["FROM", "TO"], conflicts_with_all = ["modality", "watch"])]
    katz: Option<Vec<RobotId>>,
    #[command(flatten)]
    show: ShowArgs,
}

/// Shows the graphs, or every change of them.
///
/// # Errors
/// If no router answers, or nobody knows the graphs.
pub(crate) async fn run(args: &GraphArgs, config: &ProcessConfig) -> anyhow::Result<()> {
    let clock = Clock::start();
    let bus = ask::open(config).await?;
    if let Some([from, to]) = args.katz.as_deref() {
        katz::run(&bus, [from, to], args.show.json).await?;
        bus.close().await;
        return Ok(());
    }
    let mut shown = Vec::new();
    loop {
        let graphs = graphs(&bus, args.modality.as_ref()).await?;
        let seen: Vec<_> = graphs.iter().map(|graph| graph.header.revision).collect();
        match is_news(&shown, &seen) {
            Some(true) => {
                print(&graphs, args, clock.now())?;
                shown = seen;
            }
            Some(false) => {}
            None => return Err(nobody(&bus, args.modality.as_ref()).into()),
        }
        if !args.show.watch {
            break;
        }
        tokio::time::sleep(LOOK_EVERY).await;
    }
    bus.close().await;
    Ok(())
}

/// Whether what is seen is to be shown after what was shown last; none if nobody has ever answered.
/// Where nobody answers any more, a service starts anew or a link is lost, which ends no watch.
fn is_news(shown: &[Revision], seen: &[Revision]) -> Option<bool> {
    match (shown, seen) {
        ([], []) => None,
        (_, []) => Some(false),
        _ => Some(shown != seen),
    }
}

fn nobody(bus: &Bus, modality: Option<&Modality>) -> ExitError {
    ExitError::unreachable(format!(
        "nobody answers for {} of fleet {}; see `muster status` for what runs",
        modality.map_or_else(|| "graphs".to_owned(), |name| format!("the graph {name}")),
        bus.space().fleet()
    ))
}

/// The newest snapshot of each graph, by name.
async fn graphs(
    bus: &Bus,
    modality: Option<&Modality>,
) -> anyhow::Result<Vec<std::sync::Arc<GraphDelta>>> {
    let pattern =
        modality.map_or(Pattern::Graphs, |modality| Pattern::One(Key::Graph(modality.clone())));
    let mut newest = std::collections::BTreeMap::new();
    for message in ask::messages(bus, &pattern).await? {
        if let Message::Graph(graph) = message {
            let entry = newest.entry(graph.modality.clone()).or_insert_with(|| graph.clone());
            if entry.header.revision < graph.header.revision {
                *entry = graph;
            }
        }
    }
    Ok(newest.into_values().collect())
}

fn print(graphs: &[std::sync::Arc<GraphDelta>], args: &GraphArgs, now: Tick) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    if args.show.json {
        for graph in graphs {
            out.write_all(&graph.to_json(now)?)?;
            writeln!(out)?;
        }
        return Ok(out.flush()?);
    }
    if args.modality.is_some() {
        for graph in graphs {
            print_edges(&mut out, graph)?;
        }
        return Ok(out.flush()?);
    }
    let mut table = table(&["modality", "robots", "edges", "mean weight", "epoch"]);
    for graph in graphs {
        let weights = graph.rows.iter().flat_map(|row| row.edges.iter().map(|(_, weight)| *weight));
        let (count, sum) = weights.fold((0_u32, 0.0), |(count, sum), w| (count + 1, sum + w));
        table.add_row([
            graph.modality.to_string(),
            graph.nodes_added.len().to_string(),
            count.to_string(),
            if count == 0 { String::new() } else { format!("{:.3}", sum / f64::from(count)) },
            graph.header.revision.epoch.to_string(),
        ]);
    }
    writeln!(out, "{table}")?;
    Ok(out.flush()?)
}

fn print_edges(out: &mut impl std::io::Write, graph: &GraphDelta) -> anyhow::Result<()> {
    let name = |node| {
        let found = graph.nodes_added.iter().find(|(other, _)| *other == node);
        found.map_or_else(String::new, |(_, robot)| robot.to_string())
    };
    let mut table = table(&["from", "to", "weight"]);
    let edges = graph.rows.iter().flat_map(|row| row.edges.iter().map(|edge| (row.source, *edge)));
    let mut left_out = 0_usize;
    for (index, (source, (target, weight))) in edges.enumerate() {
        if index < MAX_EDGES {
            table.add_row([name(source), name(target), format!("{weight:.4}")]);
        } else {
            left_out += 1;
        }
    }
    writeln!(out, "{} of {} robots", graph.modality, graph.nodes_added.len())?;
    writeln!(out, "{table}")?;
    if left_out > 0 {
        writeln!(out, "… and {left_out} more edges; --json prints all")?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_watch_ends_by_an_empty_look_only_before_the_first_answer() {
        let [first, second] = [1, 2].map(|epoch| [Revision { term: 1, epoch }]);
        assert_eq!(is_news(&[], &[]), None);
        assert_eq!(is_news(&[], &first), Some(true));
        assert_eq!(is_news(&first, &first), Some(false));
        assert_eq!(is_news(&first, &[]), Some(false));
        assert_eq!(is_news(&first, &second), Some(true));
    }
}

//! `muster alerts`: the open alerts of the live fleet, and who has seen them.

use muster_model::alert::{Alert, Alerts};
use muster_model::time::Tick;
use muster_runtime::config::ProcessConfig;
use muster_wire::json::EdgeJson;
use muster_wire::message::plain_reason;

use crate::console::{self, exit_error};
use crate::operator::OperatorArgs;
use crate::show::page::{Column, Page, names};
use crate::show::watch::{Shown, follow, print};

/// Arguments of `muster alerts`.
#[derive(Debug, clap::Args)]
#[command(
    args_conflicts_with_subcommands = true,
    after_help = "An alert is open from when something has been wrong for long enough until it is over. \
The thresholds are settings of auditor.\n\n\
Examples:\n  muster alerts                        once\n  \
muster alerts --watch                every change, until Ctrl-C\n  \
muster alerts ack 7 --operator kim   alert 7 has been seen"
)]
pub(crate) struct AlertsArgs {
    #[command(subcommand)]
    command: Option<AlertsCommand>,
    /// Continue and show every change
    #[arg(long)]
    watch: bool,
    /// Print JSON: one line each time
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Subcommand)]
enum AlertsCommand {
    /// Say that an operator has seen an alert; it stays open until what it is about is over
    Ack(AckArgs),
}

/// Arguments of `muster alerts ack`.
#[derive(Debug, clap::Args)]
struct AckArgs {
    /// The number of the alert
    id: u64,
    #[command(flatten)]
    operator: OperatorArgs,
    /// Print the open alerts as one line of JSON
    #[arg(long)]
    json: bool,
}

impl AlertsArgs {
    /// The command that shows what this one changes; none if it changes nothing.
    pub(crate) fn shown_by(&self) -> Option<&'static str> {
        self.command.is_some().then_some("`muster alerts`")
    }
}

/// Shows the open alerts, or acknowledges one.
///
/// # Errors
/// If no router or no service answers, or there is no such alert.
pub(crate) async fn run(args: &AlertsArgs, config: &ProcessConfig) -> anyhow::Result<()> {
    let client = console::open(config).await?;
    let (alerts, json) = match &args.command {
        Some(AlertsCommand::Ack(ack)) => {
            (client.acknowledge_alert(&ack.operator.name(config)?, ack.id).await, ack.json)
        }
        None if args.watch => {
            let alerts = client.alerts().await.map_err(exit_error)?;
            return follow(&client, alerts, args.json).await;
        }
        None => (client.get_alerts().await, args.json),
    };
    client.close().await;
    print(&*alerts.map_err(exit_error)?, json)
}

impl Shown for Alerts {
    const PUBLISHER: &'static str = "auditor";

    fn lines(&self, page: &Page, now: Tick) -> Vec<String> {
        let mut lines =
            vec![format!("fleet {}  {} open alerts", self.header.fleet, self.open.len())];
        if self.folded > 0 {
            lines.push(format!(
                "{} events of alerts were not published: there were too many in a minute",
                self.folded
            ));
        }
        if self.open.is_empty() {
            return lines;
        }
        let columns = [
            Column::kept("id"),
            Column::kept("alert"),
            Column::kept("of"),
            Column::dropped("open", 2),
            Column::kept("what"),
            Column::dropped("robots", 1),
            Column::dropped("seen by", 3),
        ];
        let row = |alert: &Alert| {
            let seen = alert.acknowledged.as_ref().map(|by| by.operator.to_string());
            vec![
                alert.id.to_string(),
                alert.kind.to_string(),
                alert.subject.to_string(),
                open_for(now, alert.raised),
                plain_reason(&alert.reason),
                names(alert.robots.iter()),
                seen.unwrap_or_default(),
            ]
        };
        lines.extend(page.table(&columns, self.open.iter().map(row)));
        lines
    }

    fn json(&self, now: Tick) -> Result<Vec<u8>, serde_json::Error> {
        Ok([self.to_json(now)?, b"\n".to_vec()].concat())
    }

    fn same(&self, other: &Self) -> bool {
        self.open == other.open && self.folded == other.folded
    }
}

/// How long an alert has been open.
fn open_for(now: Tick, raised: Tick) -> String {
    match now.since(raised).as_secs() {
        seconds @ 0..60 => format!("{seconds} s"),
        seconds @ 60..3600 => format!("{} min", seconds / 60),
        seconds => format!("{} h", seconds / 3600),
    }
}

#[cfg(test)]
mod tests {
    use muster_model::alert::{Acknowledgement, AlertKind, AlertSubject};
    use muster_model::header::{Header, Revision};
    use muster_model::id::{FleetId, OperatorId, RobotId, TeamId};

    use super::*;
    use crate::show::page::tests::{WIDTHS, assert_fits, page};

    fn alerts() -> Alerts {
        let alert = Alert {
            id: 7,
            kind: AlertKind::CutOff,
            subject: AlertSubject::Team(TeamId::numbered(2)),
            raised: Tick(5_000_000),
            value: 2.0,
            threshold: 2.0,
            reason: "no link joins the 2 parts of t2; its leader reaches 5 of 9 robots".to_owned(),
            robots: vec![RobotId::new("r7").unwrap()],
            acknowledged: None,
        };
        let by = Acknowledgement { operator: OperatorId::new("kim").unwrap(), at: Tick(0) };
        let stale =
            Alert { id: 8, kind: AlertKind::Stale, acknowledged: Some(by), ..alert.clone() };
        Alerts {
            header: Header {
                fleet: FleetId::new("alpha").unwrap(),
                revision: Revision { term: 3, epoch: 44 },
                oldest: None,
                newest: None,
                stages: vec![],
            },
            next_id: 9,
            folded: 3,
            open: vec![alert, stale],
        }
    }

    #[test]
    fn the_table_fits_the_terminal_and_names_every_alert() {
        for width in WIDTHS {
            let lines = alerts().lines(&page(width), Tick(95_000_000));
            assert_eq!(lines[0], "fleet alpha  2 open alerts");
            assert_fits(&lines[2..], width);
            let text = lines.join("\n");
            for name in ["cut_off", "stale", "t2"] {
                assert!(text.contains(name), "{width}: {name} is missing\n{text}");
            }
        }
    }

    #[test]
    fn the_json_is_stable() {
        let mut one = alerts();
        one.open.truncate(2);
        let text = String::from_utf8(one.json(Tick(95_000_000)).unwrap()).unwrap();
        let expected = concat!(
            r#"{"fleet":"alpha","term":3,"epoch":44,"data_age_s":null,"stages":[],"next_id":9,"folded":3,"#,
            r#""open":[{"id":7,"kind":"cut_off","severity":"warning","team":"t2","modality":null,"#,
            r#""raised":5.0,"value":2.0,"threshold":2.0,"#,
            r#""reason":"no link joins the 2 parts of t2; its leader reaches 5 of 9 robots","#,
            r#""robots":["r7"],"acknowledged":null},"#,
            r#"{"id":8,"kind":"stale","severity":"warning","team":"t2","modality":null,"#,
            r#""raised":5.0,"value":2.0,"threshold":2.0,"#,
            r#""reason":"no link joins the 2 parts of t2; its leader reaches 5 of 9 robots","#,
            r#""robots":["r7"],"acknowledged":{"operator":"kim","at":0.0}}]}"#,
            "\n"
        );
        assert_eq!(text, expected);
    }
}

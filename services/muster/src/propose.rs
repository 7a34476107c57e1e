//! `muster propose`: what the teams would be with other settings or without some robots.

mod table;

use std::collections::BTreeMap;
use std::io::Write as _;
use std::time::Duration;

use clap::{Args, Subcommand};
use muster_client::{AppliedPart, Client};
use muster_model::id::{Modality, OperatorId, ProposalId, RobotId, TeamId};
use muster_model::proposal::{Proposal, ProposalRequest};
use muster_model::settings::{Need, TeamCount, TeamSize, written};
use muster_runtime::config::ProcessConfig;
use muster_runtime::exit::ExitError;
use serde_json::{Value, json};

use crate::console::{self, exit_error};
use crate::operator::CommandArgs;
use crate::show::page::Page;

/// What stands before the number in ids that are given by themselves.
const NUMBERED: &str = "p";

/// Arguments of `muster propose`.
#[derive(Debug, Args)]
#[command(
    args_conflicts_with_subcommands = true,
    after_help = "A proposal is what the fleet would be divided into, with who would move, and how good that would be beside \
the live division among the same vectors. Nothing of the fleet changes until it is accepted, and it is forgotten a minute \
after it was computed. What is accepted becomes changes of settings and a wish, which `muster set` and `muster wish` show \
and take back.\n\nExamples:\n  \
muster propose --teams 3\n  muster propose --teams 2..4 --size 3..6\n  \
muster propose --weights spatial=0.7,connectivity=0.3\n  muster propose --without r7,r9 --needs medic=1\n  \
muster propose accept p1\n  muster propose drop p1\n  muster propose list"
)]
pub(crate) struct ProposeArgs {
    #[command(subcommand)]
    action: Option<Action>,
    #[command(flatten)]
    asked: Asked,
    #[command(flatten)]
    who: CommandArgs,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Make the fleet what a proposal says
    Accept(Named),
    /// Forget a proposal
    Drop(Named),
    /// Show a proposal again
    Show(Named),
    /// Show all open proposals of the operator
    List(CommandArgs),
}

#[derive(Debug, Args)]
struct Asked {
    /// How many teams: a number, a range such as 2..4, or auto
    #[arg(long, value_name = "TEAMS", value_parser = teams)]
    teams: Option<TeamCount>,
    /// The weight of each modality, all of them
    #[arg(long, value_name = "MODALITY=WEIGHT,…", value_delimiter = ',', value_parser = weight)]
    weights: Vec<(Modality, f64)>,
    /// How many robots each team has: 3..6, 3.., ..6 or a number
    #[arg(long, value_name = "RANGE", value_parser = written::size)]
    size: Option<TeamSize>,
    /// How many robots single teams have, all of them
    #[arg(long, value_name = "TEAM=RANGE,…", value_delimiter = ',', value_parser = written::team_size)]
    team_size: Vec<(TeamId, TeamSize)>,
    /// How many robots with a skill each team needs at least, or a range, all of them: medic=1, medic=1..2
    #[arg(long, value_name = "SKILL=COUNT,…", value_delimiter = ',', value_parser = written::need)]
    needs: Vec<Need>,
    /// Robots that are in no team
    #[arg(long, value_name = "ROBOT,…", value_delimiter = ',')]
    without: Vec<RobotId>,
    /// Name of the proposal; by default the next of p1, p2, …
    #[arg(long)]
    id: Option<ProposalId>,
    /// Seconds to wait for it
    #[arg(long, value_name = "SECONDS", default_value_t = 120)]
    wait: u32,
}

#[derive(Debug, Args)]
struct Named {
    /// The proposal
    id: ProposalId,
    #[command(flatten)]
    who: CommandArgs,
}

impl Asked {
    /// What is asked for.
    ///
    /// # Errors
    /// Names what makes no sense, or says that nothing is asked for.
    fn request(&self) -> Result<ProposalRequest, ExitError> {
        let usage = |error: &dyn std::fmt::Display| ExitError::usage(error.to_string());
        let some = |is_empty: bool| (!is_empty).then_some(());
        let request = ProposalRequest {
            teams: self.teams,
            weights: some(self.weights.is_empty())
                .map(|()| self.weights.iter().cloned().collect::<BTreeMap<_, _>>()),
            size: self.size,
            team_size: some(self.team_size.is_empty())
                .map(|()| self.team_size.iter().cloned().collect()),
            needs: some(self.needs.is_empty()).map(|()| self.needs.clone()),
            without: self.without.clone(),
        };
        if request == ProposalRequest::default() {
            let problem = "say what is to be different, such as --teams 3 or --without r7; \
                           see muster propose --help";
            return Err(ExitError::usage(problem));
        }
        let value = serde_json::to_value(&request).map_err(|error| usage(&error))?;
        ProposalRequest::from_json(value).map_err(|error| usage(&error))
    }
}

fn teams(text: &str) -> Result<TeamCount, String> {
    if text == "auto" {
        return Ok(TeamCount::Auto);
    }
    let count = match written::range(text)? {
        (Some(from), Some(to)) if from == to => TeamCount::Fixed(from),
        (Some(from), Some(to)) => TeamCount::Between { from, to },
        _ => return Err("a range of teams must have both ends, as in 2..4".to_owned()),
    };
    count.check().map_err(|error| error.to_string())?;
    Ok(count)
}

fn weight(text: &str) -> Result<(Modality, f64), String> {
    let (name, weight) = written::pair(text, "MODALITY=WEIGHT")?;
    let name = Modality::new(name).map_err(|error| error.to_string())?;
    let number = weight.parse().map_err(|_| format!("{weight:?} is no number"))?;
    Ok((name, number))
}

impl ProposeArgs {
    /// The command that shows what this one changes; none if it changes nothing of the fleet.
    pub(crate) fn shown_by(&self) -> Option<&'static str> {
        matches!(self.action, Some(Action::Accept(_)))
            .then_some("`muster set SERVICE` and `muster wish list`")
    }
}

/// Asks for a proposal, shows, accepts or drops it.
///
/// # Errors
/// If the planner does not answer, or refuses what is asked for.
pub(crate) async fn run(args: &ProposeArgs, config: &ProcessConfig) -> anyhow::Result<()> {
    match &args.action {
        None => ask(args, config).await,
        Some(Action::Accept(named)) => accept(named, config).await,
        Some(Action::Drop(named)) => {
            let operator = named.who.operator.name(config)?;
            let client = console::open(config).await?;
            let dropped = client.drop_proposal(&operator, &named.id).await;
            client.close().await;
            print(&[dropped.map_err(exit_error)?], named.who.json)
        }
        Some(Action::Show(named)) => {
            let operator = named.who.operator.name(config)?;
            let client = console::open(config).await?;
            let found = client.get_proposal(&operator, &named.id).await;
            client.close().await;
            print(&[found.map_err(exit_error)?], named.who.json)
        }
        Some(Action::List(who)) => {
            let operator = who.operator.name(config)?;
            let client = console::open(config).await?;
            let all = client.get_proposals(&operator).await;
            client.close().await;
            list(&operator, &all.map_err(exit_error)?, who.json)
        }
    }
}

async fn ask(args: &ProposeArgs, config: &ProcessConfig) -> anyhow::Result<()> {
    let request = args.asked.request()?;
    let operator = args.who.operator.name(config)?;
    let client = console::open(config).await?;
    let found = ask_with(&client, args, &operator, &request).await;
    client.close().await;
    print(&[found?], args.who.json)
}

async fn ask_with(
    client: &Client,
    args: &ProposeArgs,
    operator: &OperatorId,
    request: &ProposalRequest,
) -> anyhow::Result<Proposal> {
    let id = match &args.asked.id {
        Some(id) => id.clone(),
        None => free_id(&client.get_proposals(operator).await.map_err(exit_error)?)?,
    };
    let within = Duration::from_secs(args.asked.wait.into());
    Ok(client.propose(operator, &id, request, within).await.map_err(exit_error)?)
}

/// The first of p1, p2, … that is free.
fn free_id(taken: &[Proposal]) -> Result<ProposalId, ExitError> {
    let is_free = |id: &String| taken.iter().all(|proposal| proposal.id.as_str() != id);
    let id = (1..=taken.len() + 1).map(|number| format!("{NUMBERED}{number}")).find(is_free);
    ProposalId::new(id.unwrap_or_default()).map_err(|error| ExitError::usage(error.to_string()))
}

async fn accept(named: &Named, config: &ProcessConfig) -> anyhow::Result<()> {
    let operator = named.who.operator.name(config)?;
    let client = console::open(config).await?;
    let accepted = client.accept_proposal(&operator, &named.id).await;
    client.close().await;
    let parts = accepted.map_err(exit_error)?;
    let mut out = std::io::stdout().lock();
    if named.who.json {
        let applied: Vec<Value> = parts.iter().map(AppliedPart::to_json).collect();
        let all = json!({"operator": operator, "id": named.id, "applied": applied});
        writeln!(out, "{all}")?;
    } else {
        writeln!(out, "{operator}/{} is applied:", named.id)?;
        for part in &parts {
            writeln!(out, "  {part}")?;
        }
    }
    Ok(out.flush()?)
}

fn print(proposals: &[Proposal], json: bool) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    for proposal in proposals {
        if json {
            writeln!(out, "{}", serde_json::to_string(proposal)?)?;
        } else {
            for line in table::lines(proposal, &Page::of_stdout()) {
                writeln!(out, "{line}")?;
            }
        }
    }
    Ok(out.flush()?)
}

fn list(operator: &OperatorId, proposals: &[Proposal], json: bool) -> anyhow::Result<()> {
    if json {
        return print(proposals, true);
    }
    let mut out = std::io::stdout().lock();
    if proposals.is_empty() {
        writeln!(out, "{operator} has no open proposals")?;
    }
    for line in table::list(proposals, &Page::of_stdout()) {
        writeln!(out, "{line}")?;
    }
    Ok(out.flush()?)
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Arguments {
        #[command(flatten)]
        propose: ProposeArgs,
    }

    fn request(flags: &str) -> Result<Value, String> {
        let words = std::iter::once("propose").chain(flags.split_whitespace());
        let parsed = Arguments::try_parse_from(words).map_err(|error| error.to_string())?;
        let request = parsed.propose.asked.request().map_err(|error| error.message)?;
        Ok(serde_json::to_value(request).unwrap())
    }

    #[test]
    fn flags_say_what_is_to_be_different() {
        for (flags, expected) in [
            ("--teams 3", json!({"teams": 3})),
            ("--teams 2..4", json!({"teams": {"from": 2, "to": 4}})),
            ("--teams auto", json!({"teams": "auto"})),
            (
                "--weights spatial=0.7,connectivity=0.3",
                json!({"weights": {"connectivity": 0.3, "spatial": 0.7}}),
            ),
            ("--size 3..6", json!({"size": {"min": 3, "max": 6}})),
            ("--size ..6", json!({"size": {"min": null, "max": 6}})),
            ("--size 4", json!({"size": {"min": 4, "max": 4}})),
            ("--team-size t1=2..", json!({"team_size": {"t1": {"min": 2, "max": null}}})),
            ("--without r9,r7", json!({"without": ["r7", "r9"]})),
        ] {
            assert_eq!(request(flags), Ok(expected), "{flags}");
        }
        let needs = request("--needs medic=1,relay=0..2").unwrap();
        let per_team: Vec<&Value> =
            needs["needs"].as_array().unwrap().iter().map(|need| &need["per_team"]).collect();
        assert_eq!(per_team, [&json!({"min": 1, "max": null}), &json!({"min": 0, "max": 2})]);
        for wrong in [
            "",
            "--teams 0",
            "--teams 2..",
            "--teams 4..2",
            "--size ..",
            "--size x",
            "--weights spatial",
            "--weights spatial=x",
            "--without R7",
            "--without r7,r7",
            "--needs medic",
        ] {
            assert!(request(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn an_operator_gets_the_first_free_name() {
        assert_eq!(free_id(&[]).unwrap().as_str(), "p1");
        let one = |id: &str| Proposal {
            operator: OperatorId::new("alice").unwrap(),
            id: ProposalId::new(id).unwrap(),
            state: muster_model::proposal::ProposalState::Computing,
            asked: ProposalRequest::default(),
            ahead: 0,
            age_s: 0.0,
            forgotten_in_s: None,
            division: None,
        };
        assert_eq!(free_id(&[one("p1"), one("p3")]).unwrap().as_str(), "p2");
        assert_eq!(free_id(&[one("a"), one("p1")]).unwrap().as_str(), "p2");
    }
}

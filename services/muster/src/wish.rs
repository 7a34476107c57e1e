//! `muster wish`: puts, withdraws and lists wishes of operators.

use std::io::Write as _;
use std::time::Duration;

use clap::{Args, Subcommand};
use muster_model::id::{RobotId, TeamId, WishId};
use muster_model::wish::{StandingWish, Wish, WishKind, WishState};
use muster_runtime::clock::Clock;
use muster_runtime::config::ProcessConfig;
use muster_runtime::exit::ExitError;

use crate::console;
use crate::operator::CommandArgs;

/// Longest id of a wish that is made of names; longer ones end with a checksum.
const MAX_NAMED_ID: usize = 48;

/// Arguments of `muster wish`.
#[derive(Debug, Args)]
#[command(
    after_help = "A wish counts until it is withdrawn or expires, over restarts of every service. One that nothing grants \
within the limits and the other wishes is refused with the reason; one for a robot or team that is not there waits. The same \
wish put twice is one wish, as its id is made of its names.\n\nExamples:\n  \
muster wish pin r7 t2 --note \"carries the relay\"\n  muster wish apart r1 r2 r3\n  \
muster wish reserve r9 --expires 600\n  muster wish list\n  muster wish withdraw pin-r7-t2"
)]
pub(crate) struct WishArgs {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Robots are in a team
    Pin(OfTeam),
    /// Robots are not in a team
    Ban(OfTeam),
    /// Robots are in one team
    Together(OfRobots),
    /// No two of the robots are in one team
    Apart(OfRobots),
    /// The robots of a team stay in it
    Lock(Lock),
    /// Robots are in no team
    Reserve(OfRobots),
    /// Show all wishes
    List(List),
    /// Take a wish away
    Withdraw(Withdraw),
}

#[derive(Debug, Args)]
struct OfTeam {
    /// The robots, then the team
    #[arg(value_name = "ROBOT… TEAM", num_args = 2.., required = true)]
    names: Vec<String>,
    #[command(flatten)]
    options: Options,
}

#[derive(Debug, Args)]
struct OfRobots {
    /// The robots
    #[arg(value_name = "ROBOT", required = true)]
    robots: Vec<RobotId>,
    #[command(flatten)]
    options: Options,
}

#[derive(Debug, Args)]
struct Lock {
    /// The team
    team: TeamId,
    #[command(flatten)]
    options: Options,
}

#[derive(Debug, Args)]
struct Options {
    /// Why, for people
    #[arg(long)]
    note: Option<String>,
    /// Seconds until the wish no longer counts
    #[arg(long, value_name = "SECONDS")]
    expires: Option<u32>,
    /// Name of the wish; by default made of its names
    #[arg(long)]
    id: Option<WishId>,
    #[command(flatten)]
    who: CommandArgs,
}

#[derive(Debug, Args)]
struct List {
    /// Print one line of JSON for each
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Args)]
struct Withdraw {
    /// The wish
    id: WishId,
    #[command(flatten)]
    who: CommandArgs,
}

impl WishArgs {
    /// The command that shows what this one changes; none if it changes nothing.
    pub(crate) fn shown_by(&self) -> Option<&'static str> {
        (!matches!(self.action, Action::List(_))).then_some("`muster wish list`")
    }
}

/// Puts, withdraws or lists wishes.
///
/// # Errors
/// If the clusterer does not answer, or refuses the wish.
pub(crate) async fn run(args: &WishArgs, config: &ProcessConfig) -> anyhow::Result<()> {
    let (kind, robots, team, options) = match &args.action {
        Action::Pin(of) => of_team(WishKind::Pin, of)?,
        Action::Ban(of) => of_team(WishKind::Ban, of)?,
        Action::Together(of) => (WishKind::Together, of.robots.clone(), None, &of.options),
        Action::Apart(of) => (WishKind::Apart, of.robots.clone(), None, &of.options),
        Action::Reserve(of) => (WishKind::Reserve, of.robots.clone(), None, &of.options),
        Action::Lock(of) => (WishKind::Lock, Vec::new(), Some(of.team.clone()), &of.options),
        Action::List(list) => return show(list, config).await,
        Action::Withdraw(withdraw) => return take_away(withdraw, config).await,
    };
    let expires = options.expires.map(|seconds| {
        let at = Clock::start().now().after(Duration::from_secs(seconds.into()));
        at.as_seconds()
    });
    let wish = Wish { kind, robots, team, expires, note: options.note.clone() };
    let wish = wish.checked().map_err(|error| ExitError::usage(error.to_string()))?;
    let id = match &options.id {
        Some(id) => id.clone(),
        None => named(&wish)?,
    };
    let operator = options.who.operator.name(config)?;
    let client = console::open(config).await?;
    let put = client.put_wish(&operator, &id, &wish).await;
    client.close().await;
    print(&put.map_err(console::exit_error)?, options.who.json)
}

/// What a command about robots and a team names.
type Named<'a> = (WishKind, Vec<RobotId>, Option<TeamId>, &'a Options);

fn of_team(kind: WishKind, of: &OfTeam) -> Result<Named<'_>, ExitError> {
    let usage = |error: muster_model::id::IdError| ExitError::usage(error.to_string());
    let Some((team, robots)) = of.names.split_last() else {
        return Err(ExitError::usage("name robots and a team".to_owned()));
    };
    let robots = robots.iter().map(|robot| RobotId::new(robot).map_err(usage));
    let team = TeamId::new(team).map_err(usage)?;
    Ok((kind, robots.collect::<Result<_, _>>()?, Some(team), &of.options))
}

/// The id of a wish out of its names, so that the same wish is put once.
fn named(wish: &Wish) -> Result<WishId, ExitError> {
    let kind = wish.kind.name().to_owned();
    let robots = wish.robots.iter().map(ToString::to_string);
    let names = robots.chain(wish.team.iter().map(ToString::to_string));
    let text = std::iter::once(kind).chain(names).collect::<Vec<_>>().join("-");
    let id = if text.len() <= MAX_NAMED_ID {
        text
    } else {
        // FNV-1a.
        let hash = text.bytes().fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
            (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
        });
        format!("{}-{:08x}", &text[..MAX_NAMED_ID], hash >> 32)
    };
    WishId::new(id).map_err(|error| ExitError::usage(error.to_string()))
}

async fn show(list: &List, config: &ProcessConfig) -> anyhow::Result<()> {
    let client = console::open(config).await?;
    let wishes = client.get_wishes().await;
    client.close().await;
    let wishes = wishes.map_err(console::exit_error)?;
    if wishes.is_empty() && !list.json {
        writeln!(std::io::stdout(), "there are no wishes")?;
    }
    wishes.iter().try_for_each(|one| print(one, list.json))
}

async fn take_away(withdraw: &Withdraw, config: &ProcessConfig) -> anyhow::Result<()> {
    let operator = withdraw.who.operator.name(config)?;
    let client = console::open(config).await?;
    let withdrawn = client.withdraw_wish(&operator, &withdraw.id).await;
    client.close().await;
    print(&withdrawn.map_err(console::exit_error)?, withdraw.who.json)
}

fn print(one: &StandingWish, json: bool) -> anyhow::Result<()> {
    let line = if json { serde_json::to_string(one)? } else { line(one) };
    writeln!(std::io::stdout(), "{line}")?;
    Ok(())
}

/// A wish in one line.
fn line(one: &StandingWish) -> String {
    let names: Vec<String> = one.wish.robots.iter().map(ToString::to_string).collect();
    let team = one.wish.team.as_ref().map_or_else(String::new, |team| format!(" {team}"));
    let robots = if names.is_empty() { String::new() } else { format!(" {}", names.join(" ")) };
    let state = match one.state {
        WishState::Waiting => "waiting",
        WishState::Active => "active",
        WishState::Expired => "expired",
        WishState::Conflicting => "conflicting",
        WishState::Withdrawn => "withdrawn",
    };
    let reason = one.reason.as_ref().map_or_else(String::new, |reason| format!(": {reason}"));
    let note = one.wish.note.as_ref().map_or_else(String::new, |note| format!(" ({note})"));
    format!(
        "{}/{}  {}{robots}{team}{note}  {state}{reason}",
        one.operator,
        one.id,
        one.wish.kind.name()
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wish(robots: &[&str]) -> Wish {
        Wish {
            kind: WishKind::Apart,
            robots: robots.iter().map(|robot| RobotId::new(robot).unwrap()).collect(),
            team: None,
            expires: None,
            note: None,
        }
    }

    #[test]
    fn the_id_is_made_of_the_names_and_fits() {
        assert_eq!(named(&wish(&["r1", "r2"])).unwrap().as_str(), "apart-r1-r2");
        let long = "x".repeat(64);
        let [one, other] =
            [["r1", &long], ["r2", &long]].map(|robots| named(&wish(&robots)).unwrap());
        assert!(one != other && one.as_str().len() <= 64, "{one} {other}");
        let tail = |end: &str| named(&wish(&["r", &format!("{}{end}", "x".repeat(60))])).unwrap();
        assert_ne!(tail("a"), tail("b"));
    }
}

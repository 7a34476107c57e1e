//! Flags and environment.

use std::io::Write as _;
use std::net::SocketAddr;
use std::process::ExitCode;

use clap::Parser;
use muster_model::id::OperatorId;
use muster_runtime::bus::{self, BusConfig};
use muster_runtime::config::{Environment, Mode, ProcessArgs, ProcessConfig, process_environment};
use muster_runtime::exit::{self, ExitError};
use muster_runtime::service;

use super::run;
use crate::Access;

/// Where viewers connect if nothing else is said: the port that Foxglove proposes, for this host only.
const DEFAULT_ADDRESS: &str = "127.0.0.1:8765";

/// Who commands, where nothing says another name.
const DEFAULT_OPERATOR: &str = "operator";

/// How the file of an operator's identity names it.
const IDENTITY: &str = "operator.";

/// The flags.
#[derive(Debug, Parser)]
#[command(
    name = "muster-foxglove",
    version,
    about = "The live fleet for Foxglove and Lichtblick",
    after_help = format!(
        "Examples:\n  muster-foxglove                        ws://{DEFAULT_ADDRESS} for this host\n  \
         muster-foxglove --fleet alpha --connect tcp/192.168.1.10:7447\n  \
         muster-foxglove --allow-changes        viewers may change the number of teams and weights\n\n\
         Health: with --http, as of every program.\n\n{}",
        exit::HELP
    )
)]
struct FoxgloveArgs {
    /// Where viewers connect; other hosts may look and never change anything [MUSTER_FOXGLOVE_SERVE]
    /// [default: 127.0.0.1:8765]
    #[arg(long, value_name = "ADDRESS:PORT")]
    serve: Option<String>,
    /// Let viewers on this host change the number of teams and weights [MUSTER_FOXGLOVE_ALLOW_CHANGES=true]
    #[arg(long)]
    allow_changes: bool,
    /// Under which name viewers change them, in a-z 0-9 _ - [MUSTER_OPERATOR] [default: the operator whose identity
    /// --zenoh-config is, else operator]
    #[arg(long, value_name = "NAME")]
    operator: Option<OperatorId>,
    #[command(flatten)]
    process: ProcessArgs,
}

/// Where viewers connect, and what they may do.
#[derive(Debug)]
pub(super) struct FoxgloveOptions {
    pub(super) address: SocketAddr,
    pub(super) access: Access,
}

/// The whole `main` of the program.
#[must_use]
pub fn main() -> ExitCode {
    exit::finish(start(&FoxgloveArgs::parse()))
}

fn start(args: &FoxgloveArgs) -> anyhow::Result<()> {
    let environment: Environment<'_> = &process_environment;
    let config = ProcessConfig::resolve(&args.process, Mode::Client, environment)?;
    if config.mode.value == Mode::Router {
        return Err(
            ExitError::usage("mode: viewers are served by no router; use client or peer").into()
        );
    }
    let options = resolve(args, &config, environment)?;
    if service::report(&args.process, &config, &[])? {
        if args.process.print_config {
            let who = match &options.access {
                Access::ReadOnly => "who may only look".to_owned(),
                Access::Changes(operator) => format!("who change parameters as {operator}"),
            };
            writeln!(std::io::stdout(), "# serves {} for viewers {who}", options.address)?;
        }
        return Ok(());
    }
    service::block_on(&config, async |config, stop| run::run(config, options, stop).await)
}

fn resolve(
    args: &FoxgloveArgs,
    config: &ProcessConfig,
    environment: Environment<'_>,
) -> Result<FoxgloveOptions, ExitError> {
    let text = args.serve.clone().or_else(|| environment("MUSTER_FOXGLOVE_SERVE"));
    let text = text.unwrap_or_else(|| DEFAULT_ADDRESS.to_owned());
    let address: SocketAddr = text.parse().map_err(|_| {
        let text = muster_wire::message::quoted(&text);
        ExitError::usage(format!(
            "serve: {text:?} is no address with a port; write one like {DEFAULT_ADDRESS}"
        ))
    })?;
    let variable = "MUSTER_FOXGLOVE_ALLOW_CHANGES";
    let allowed = match environment(variable).as_deref() {
        None => args.allow_changes,
        Some("true") => true,
        Some("false") => args.allow_changes,
        Some(_) => return Err(ExitError::usage(format!("{variable}: must be true or false"))),
    };
    if !allowed {
        return Ok(FoxgloveOptions { address, access: Access::ReadOnly });
    }
    // The protocol asks no one who he is.
    if !address.ip().is_loopback() {
        return Err(ExitError::usage(format!(
            "allow_changes: everyone who reaches {address} could change settings; serve {DEFAULT_ADDRESS}, and let \
             others come through ssh -L"
        )));
    }
    let access = Access::Changes(operator(args, config, environment)?);
    Ok(FoxgloveOptions { address, access })
}

/// Under which name viewers change settings.
fn operator(
    args: &FoxgloveArgs,
    config: &ProcessConfig,
    environment: Environment<'_>,
) -> Result<OperatorId, ExitError> {
    if let Some(name) = &args.operator {
        return Ok(name.clone());
    }
    if let Some(name) = environment("MUSTER_OPERATOR") {
        return OperatorId::new(&name)
            .map_err(|error| ExitError::usage(format!("MUSTER_OPERATOR: {error}")));
    }
    let identity = bus::identity(&BusConfig::from(config));
    let identity = identity.map_err(|error| ExitError::usage(error.to_string()))?;
    let name = identity.as_deref().and_then(|identity| identity.strip_prefix(IDENTITY));
    OperatorId::new(name.unwrap_or(DEFAULT_OPERATOR))
        .map_err(|error| ExitError::usage(error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn options(flags: &[&str], allow: Option<&str>) -> Result<FoxgloveOptions, String> {
        let flags = ["muster-foxglove"].iter().chain(flags);
        let args = FoxgloveArgs::try_parse_from(flags).map_err(|error| error.to_string())?;
        let environment = |name: &str| {
            allow.filter(|_| name == "MUSTER_FOXGLOVE_ALLOW_CHANGES").map(str::to_owned)
        };
        let config = ProcessConfig::resolve(&args.process, Mode::Client, &environment)
            .map_err(|error| error.message)?;
        resolve(&args, &config, &environment).map_err(|error| error.message)
    }

    #[test]
    fn viewers_may_look_and_change_nothing_unless_a_flag_says_so() {
        let plain = options(&[], None).unwrap();
        assert_eq!(
            (plain.address.to_string().as_str(), plain.access),
            (DEFAULT_ADDRESS, Access::ReadOnly)
        );
        let open = options(&["--serve", "0.0.0.0:8765"], None).unwrap();
        assert_eq!(open.access, Access::ReadOnly);
        let name = |access: Access| match access {
            Access::Changes(operator) => operator.to_string(),
            Access::ReadOnly => String::new(),
        };
        assert_eq!(name(options(&["--allow-changes"], None).unwrap().access), "operator");
        let kim = options(&["--operator", "kim"], Some("true")).unwrap();
        assert_eq!(name(kim.access), "kim");
        assert_eq!(name(options(&["--allow-changes"], Some("false")).unwrap().access), "operator");
        let problem = options(&["--allow-changes", "--serve", "0.0.0.0:8765"], None).unwrap_err();
        assert!(problem.starts_with("allow_changes: ") && problem.contains("ssh -L"), "{problem}");
        assert!(options(&["--serve", "here"], None).unwrap_err().starts_with("serve: "));
        assert!(options(&[], Some("perhaps")).unwrap_err().contains("true or false"));
    }
}

//! Flags, environment and the file of access.

use std::io::Write as _;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Parser;
use hyper::body::Bytes;
use muster_model::id::OperatorId;
use muster_runtime::bus::{self, BusConfig};
use muster_runtime::config::{Environment, Mode, ProcessArgs, ProcessConfig, process_environment};
use muster_runtime::exit::{self, ExitError};
use muster_runtime::service;
use muster_runtime::store::read_at_most;

use super::run;
use crate::access::{AccessFile, Door, Hosts};
use crate::image::{Edges, MAX_IMAGE_BYTES, kind};

/// Where the page is served if nothing else is said: only this host reaches it.
pub(super) const DEFAULT_ADDRESS: &str = "127.0.0.1:7480";

/// Largest file of access in bytes.
const MAX_FILE: u64 = 256 * 1024;

/// Who commands from a console that asks no one for a token, where nothing says another name.
const DEFAULT_OPERATOR: &str = "operator";

/// How the file of an operator's identity names it.
const IDENTITY: &str = "operator.";

/// The flags.
#[derive(Debug, Parser)]
#[command(
    name = "muster-console",
    version,
    about = "The page on which operators see and command a fleet",
    after_help = format!(
        "Examples:\n  muster-console                         http://127.0.0.1:7480 for this host\n  \
         muster-console --fleet alpha --connect tcp/192.168.1.10:7447\n  \
         muster-console --serve 192.168.1.10:7480 --access /etc/muster/console-access.toml\n\n\
         Health: http://ADDRESS/healthz and /readyz of the same port.\n\n{}",
        exit::HELP
    )
)]
struct ConsoleArgs {
    /// Where the page is served; anything but loopback needs --access [MUSTER_CONSOLE_SERVE]
    /// [default: 127.0.0.1:7480]
    #[arg(long, value_name = "ADDRESS:PORT")]
    serve: Option<String>,
    /// File in TOML with the tokens of operators and viewers [MUSTER_CONSOLE_ACCESS]
    #[arg(long, value_name = "FILE")]
    access: Option<PathBuf>,
    /// Who commands from a console without --access, in a-z 0-9 _ - [MUSTER_OPERATOR] [default: the operator
    /// whose identity --zenoh-config is, else operator]
    #[arg(long, value_name = "NAME")]
    operator: Option<OperatorId>,
    /// Image of the ground below the map: PNG, JPEG or WebP [MUSTER_CONSOLE_IMAGE]
    #[arg(long, value_name = "FILE")]
    image: Option<PathBuf>,
    /// Where the edges of the image lie, in metres east and north [MUSTER_CONSOLE_IMAGE_AT]
    #[arg(long, value_name = "WEST,SOUTH,EAST,NORTH", allow_hyphen_values = true)]
    image_at: Option<String>,
    #[command(flatten)]
    process: ProcessArgs,
}

/// An image below the map.
#[derive(Debug, Clone)]
pub(super) struct GroundImage {
    pub(super) edges: Edges,
    /// Its media type.
    pub(super) kind: &'static str,
    pub(super) bytes: Bytes,
}

/// Where the page is served, and for whom.
#[derive(Debug)]
pub(super) struct ConsoleOptions {
    pub(super) address: SocketAddr,
    pub(super) further_hosts: Vec<String>,
    pub(super) door: Door,
    pub(super) image: Option<GroundImage>,
}

impl ConsoleOptions {
    pub(super) fn hosts(&self, address: SocketAddr) -> Hosts {
        Hosts::new(address, &self.further_hosts)
    }
}

/// The whole `main` of the console.
#[must_use]
pub fn main() -> ExitCode {
    exit::finish(start(&ConsoleArgs::parse()))
}

fn start(args: &ConsoleArgs) -> anyhow::Result<()> {
    let environment: Environment<'_> = &process_environment;
    let config = ProcessConfig::resolve(&args.process, Mode::Client, environment)?;
    if config.mode.value == Mode::Router {
        return Err(ExitError::usage("mode: a console is no router; use client or peer").into());
    }
    let options = resolve(args, &config, environment)?;
    if service::report(&args.process, &config, &[])? {
        if args.process.print_config {
            let who = match &options.door {
                Door::Open(operator) => format!("everyone on this host, as {operator}"),
                Door::Tokens(tokens) => format!("{} tokens", tokens.len()),
            };
            writeln!(std::io::stdout(), "# serves {} for {who}", options.address)?;
        }
        return Ok(());
    }
    service::block_on(&config, async |config, stop| run::run(config, options, stop).await)
}

fn resolve(
    args: &ConsoleArgs,
    config: &ProcessConfig,
    environment: Environment<'_>,
) -> Result<ConsoleOptions, ExitError> {
    let text = args.serve.clone().or_else(|| environment("MUSTER_CONSOLE_SERVE"));
    let text = text.unwrap_or_else(|| DEFAULT_ADDRESS.to_owned());
    let address: SocketAddr = text.parse().map_err(|_| {
        let text = muster_wire::message::quoted(&text);
        ExitError::usage(format!(
            "serve: {text:?} is no address with a port; write one like {DEFAULT_ADDRESS}"
        ))
    })?;
    let image = image(args, environment)?;
    let path =
        args.access.clone().or_else(|| environment("MUSTER_CONSOLE_ACCESS").map(PathBuf::from));
    let Some(path) = path else {
        if !address.ip().is_loopback() {
            return Err(ExitError::usage(format!(
                "serve: {address} is reached from other hosts; name a file with tokens (--access), or serve \
                 {DEFAULT_ADDRESS}"
            )));
        }
        let door = Door::Open(operator(args, config, environment)?);
        return Ok(ConsoleOptions { address, further_hosts: Vec::new(), door, image });
    };
    let file = read(&path)?;
    let door = file.door();
    let door = door.map_err(|problem| wrong_file(&path, &problem))?;
    if address.ip().is_unspecified() && file.hosts.is_empty() {
        let problem =
            "hosts: name the hosts with ports that browsers ask for, as base.example:7480";
        return Err(wrong_file(&path, problem));
    }
    Ok(ConsoleOptions { address, further_hosts: file.hosts, door, image })
}

/// The image below the map, if there is one.
fn image(
    args: &ConsoleArgs,
    environment: Environment<'_>,
) -> Result<Option<GroundImage>, ExitError> {
    let path =
        args.image.clone().or_else(|| environment("MUSTER_CONSOLE_IMAGE").map(PathBuf::from));
    let at = args.image_at.clone().or_else(|| environment("MUSTER_CONSOLE_IMAGE_AT"));
    let (path, at) = match (path, at) {
        (None, None) => return Ok(None),
        (Some(path), Some(at)) => (path, at),
        (Some(_), None) => {
            let problem = "image: say where its edges lie with --image-at WEST,SOUTH,EAST,NORTH";
            return Err(ExitError::usage(problem));
        }
        (None, Some(_)) => return Err(ExitError::usage("image_at: name the file with --image")),
    };
    let edges =
        Edges::parse(&at).map_err(|problem| ExitError::usage(format!("image_at: {problem}")))?;
    let fail = |problem: String| ExitError::usage(format!("image {}: {problem}", path.display()));
    let bytes = read_at_most(&path, MAX_IMAGE_BYTES).map_err(|error| fail(error.to_string()))?;
    let Some(kind) = kind(&bytes) else {
        return Err(fail("is neither PNG nor JPEG nor WebP".to_owned()));
    };
    Ok(Some(GroundImage { edges, kind, bytes: bytes.into() }))
}

fn wrong_file(path: &Path, problem: &str) -> ExitError {
    ExitError::usage(format!("access {}: {problem}", path.display()))
}

fn read(path: &Path) -> Result<AccessFile, ExitError> {
    let fail = |problem: String| wrong_file(path, &problem);
    let bytes = read_at_most(path, MAX_FILE).map_err(|error| fail(error.to_string()))?;
    let text = String::from_utf8(bytes).map_err(|_| fail("must be UTF-8".to_owned()))?;
    // The whole text of the error quotes the line, which may hold a token.
    toml::from_str(&text).map_err(|error: toml::de::Error| fail(error.message().to_owned()))
}

/// Who commands where no one is asked for a token.
fn operator(
    args: &ConsoleArgs,
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
#[expect(clippy::disallowed_methods, reason = "a test writes the files that are read")]
mod tests {
    use super::*;

    fn options(flags: &[&str]) -> Result<ConsoleOptions, String> {
        let flags = ["muster-console"].iter().chain(flags);
        let args = ConsoleArgs::try_parse_from(flags).map_err(|error| error.to_string())?;
        let environment = |_: &str| None;
        let config = ProcessConfig::resolve(&args.process, Mode::Client, &environment)
            .map_err(|error| error.message)?;
        resolve(&args, &config, &environment).map_err(|error| error.message)
    }

    #[test]
    fn loopback_is_open_and_anything_else_needs_tokens() {
        let plain = options(&[]).unwrap();
        assert_eq!(plain.address.to_string(), DEFAULT_ADDRESS);
        let is_kim = |door: &Door| matches!(door, Door::Open(name) if name.as_str() == "kim");
        assert!(is_kim(&options(&["--operator", "kim"]).unwrap().door));
        let problem = options(&["--serve", "0.0.0.0:7480"]).unwrap_err();
        assert!(problem.starts_with("serve: ") && problem.contains("--access"), "{problem}");
        assert!(options(&["--serve", "here"]).unwrap_err().starts_with("serve: "));

        let folder = tempfile::tempdir().unwrap();
        let ground = folder.path().join("ground.png");
        let image = ["--image", ground.to_str().unwrap(), "--image-at"];
        let with = |at: &'static str| [&image[..], &[at]].concat();
        assert!(options(&image[..2]).unwrap_err().contains("--image-at"));
        assert!(options(&["--image-at", "0,0,1,1"]).unwrap_err().contains("--image"));
        assert!(options(&with("1,1,0,0")).unwrap_err().starts_with("image_at: "));
        assert!(options(&with("0,0,1,1")).unwrap_err().starts_with("image "));
        std::fs::write(&ground, "<svg/>").unwrap();
        assert!(options(&with("0,0,1,1")).unwrap_err().contains("neither PNG"));
        std::fs::write(&ground, b"\x89PNG\r\n\x1a\n").unwrap();
        let options_with_image = options(&with("-9,-9,9,9")).unwrap();
        assert!(options_with_image.image.is_some_and(|image| image.edges.west < -8.0));

        let path = folder.path().join("access.toml");
        let flags = ["--serve", "0.0.0.0:7480", "--access", path.to_str().unwrap()];
        assert!(options(&flags).unwrap_err().starts_with("access "));
        let token = "wall-wall-wall-wall-wall-wall";
        std::fs::write(&path, format!("[[viewer]]\ntoken = \"{token}\"\n")).unwrap();
        assert!(options(&flags).unwrap_err().contains("hosts: name"));
        let text = format!("hosts = [\"base:7480\"]\n[[viewer]]\ntoken = \"{token}\"\n");
        std::fs::write(&path, text).unwrap();
        assert!(matches!(options(&flags).unwrap().door, Door::Tokens(tokens) if tokens.len() == 1));
        std::fs::write(&path, "[[viewer]]\ntoken = secret-secret-secret-secret\n").unwrap();
        let problem = options(&flags).unwrap_err();
        assert!(!problem.contains("secret-secret"), "{problem}");
    }
}

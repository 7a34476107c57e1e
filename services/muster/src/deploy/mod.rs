//! `muster deploy`: configurations, certificates and router rules for fleets on several hosts.
//!
//! [`fleet`] reads the members of a fleet; [`certs`] certifies them, [`rights`] lists what each may do, and
//! [`acl`] writes that as the rules of a router; [`config`] prints the commented defaults of one service.
//! Nothing here touches the bus.

mod acl;
mod certs;
mod config;
mod fleet;
mod rights;

use clap::Subcommand;

/// Arguments of `muster deploy`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  muster deploy config ingest > /etc/muster/ingest.toml\n  \
muster deploy certs --fleet-file fleet.toml --out identities\n  \
muster deploy acl --fleet-file fleet.toml --identity identities/router.base --out router.json5")]
pub(crate) struct DeployArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Print the commented default configuration of a service
    Config(config::ConfigArgs),
    /// Make certificates for routers, services, robots and operators
    Certs(certs::CertsArgs),
    /// Make the configuration of a secured router
    Acl(acl::AclArgs),
}

/// Runs a subcommand.
///
/// # Errors
/// Names the file that is invalid or cannot be written.
pub(crate) fn run(args: &DeployArgs) -> anyhow::Result<()> {
    match &args.what {
        What::Config(args) => config::run(args),
        What::Certs(args) => certs::run(args),
        What::Acl(args) => acl::run(args),
    }
}

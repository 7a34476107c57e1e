//! The session of a console, and how its errors end the program.

use std::time::Duration;

use muster_client::{Client, Config, Error, Mode};
use muster_runtime::config::{self, Origin, ProcessConfig};
use muster_runtime::exit::{Exit, ExitError};

/// How long a console waits for a router.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);

/// Opens a session for a console, which waits for a router for a few seconds only.
///
/// # Errors
/// If no router answers; the text names the remedy.
pub(crate) async fn open(config: &ProcessConfig) -> anyhow::Result<Client> {
    let config = Config { connect_timeout: Some(CONNECT_TIMEOUT), ..client_config(config)? };
    Ok(Client::open(&config).await.map_err(exit_error)?)
}

/// The process options as a client takes them. It waits for a router without a limit.
///
/// # Errors
/// If the process is to be a router, which is no client.
pub(crate) fn client_config(config: &ProcessConfig) -> Result<Config, ExitError> {
    let mode = match config.mode.value {
        config::Mode::Client => Mode::Client,
        config::Mode::Peer => Mode::Peer,
        config::Mode::Router => {
            return Err(ExitError::usage("mode: this command is no router; use client or peer"));
        }
    };
    Ok(Config {
        fleet: config.fleet.value.to_string(),
        // An address that the user gave overrides Zenoh's configuration, also if it is the default.
        routers: (config.connect.origin != Origin::Default).then(|| config.connect.value.clone()),
        zenoh_config: config.zenoh_config.value.clone(),
        mode,
        listen: config.listen.value.clone(),
        ..Config::default()
    })
}

/// The error of a client with the exit code of a program.
pub(crate) fn exit_error(error: Error) -> ExitError {
    match error {
        Error::Input { .. } | Error::Refused { .. } => ExitError::usage(error.to_string()),
        Error::Unreachable { routers } => ExitError::unreachable(format!(
            "no router answers at {}; start one with `muster router`, or name another with \
             --connect; `--log warn` shows what is wrong with a link",
            routers.join(", ")
        )),
        // `Error::Denied` is a failure: the service is there.
        Error::Unanswered { .. } | Error::Unavailable { .. } => {
            ExitError::unreachable(error.to_string())
        }
        other => ExitError { exit: Exit::Failure, message: other.to_string() },
    }
}

/// The reply to a get; none if there was none.
///
/// # Errors
/// Every other error of the client.
pub(crate) fn reply<T>(result: Result<T, Error>) -> Result<Option<T>, Error> {
    match result {
        Ok(reply) => Ok(Some(reply)),
        Err(Error::Unanswered { .. }) => Ok(None),
        Err(error) => Err(error),
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use muster_model::id::ServiceName;
    use muster_runtime::config::ProcessArgs;

    use super::*;

    #[derive(Parser)]
    struct Arguments {
        #[command(flatten)]
        process: ProcessArgs,
    }

    #[test]
    fn what_passes_is_no_wrong_flag() {
        let service = ServiceName::Clusterer;
        let reason = String::new;
        for (error, exit) in [
            (Error::Refused { service, reason: reason() }, Exit::Usage),
            (Error::Unavailable { service, reason: reason() }, Exit::Unreachable),
            (Error::Unstored { service, reason: reason() }, Exit::Failure),
        ] {
            assert_eq!(exit_error(error).exit, exit);
        }
    }

    #[test]
    fn the_routers_are_those_that_the_user_named() {
        let routers = |flags: &[&str], variable: Option<&str>| {
            let flags = ["muster"].iter().chain(flags);
            let arguments = Arguments::try_parse_from(flags).unwrap();
            let environment =
                |name: &str| variable.filter(|_| name == "MUSTER_CONNECT").map(str::to_owned);
            let config =
                ProcessConfig::resolve(&arguments.process, config::Mode::Client, &environment);
            client_config(&config.unwrap()).unwrap().routers
        };
        let default = "tcp/127.0.0.1:7447";
        let named = |name: &str| Some(vec![name.to_owned()]);
        assert_eq!(routers(&[], None), None);
        assert_eq!(routers(&["--connect", default], None), named(default));
        assert_eq!(routers(&[], Some(default)), named(default));
        assert_eq!(routers(&["--connect", "tcp/b:1"], Some(default)), named("tcp/b:1"));
    }
}

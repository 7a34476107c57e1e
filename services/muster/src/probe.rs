//! `muster probe`: asks a process for `/healthz`, for container managers. An image needs neither a shell nor curl
//! for its health check, and the check reads the same `MUSTER_HTTP` as the process.

use std::io::{Read as _, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

use muster_runtime::config::ProcessConfig;
use muster_runtime::exit::{Exit, ExitError};
use muster_wire::message::plain_reason;

/// Longest wait for each step in seconds, the connection and the answer: the port answers on a thread of its own,
/// within milliseconds. A process that is stopped takes the connection and does not answer.
const STEP_TIMEOUT: Duration = Duration::from_secs(2);

/// Most bytes of the answer that are read: the states of all services are less than one KiB.
const MAX_ANSWER_BYTES: u64 = 16 * 1024;

/// Arguments of `muster probe`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "The exit code is 0 if the process is alive, and 1 if it hangs or does not answer. A process that \
waits for its router is alive.\n\nExamples:\n  muster probe --http 127.0.0.1:9464\n  \
MUSTER_HTTP=127.0.0.1:9464 muster probe"
)]
pub(crate) struct ProbeArgs {}

/// Asks whether a process is alive.
///
/// # Errors
/// If it is not, does not answer, or no port is configured.
pub(crate) fn run(_: &ProbeArgs, config: &ProcessConfig) -> anyhow::Result<()> {
    let Some(address) = config.http.value else {
        let problem = "http: no port to ask; set --http or MUSTER_HTTP to that of the process";
        return Err(ExitError::usage(problem).into());
    };
    // As a text: a port that closes at once breaks a pipe, and that must not be taken for a reader that has gone away.
    let answer = get(address).map_err(|error| {
        let message = format!(
            "http: no answer from {address}; does the process run, with this port as its --http?: {error}"
        );
        ExitError { exit: Exit::Failure, message }
    })?;
    let (head, body) = answer.split_once("\r\n\r\n").unwrap_or((&answer, ""));
    let code = head.split(' ').nth(1).unwrap_or_default();
    let body = plain_reason(body.trim_end());
    match code {
        "200" => Ok(writeln!(std::io::stdout(), "{body}")?),
        "503" => {
            Err(ExitError { exit: Exit::Failure, message: format!("it hangs: {body}") }.into())
        }
        _ => {
            let message = format!(
                "http: what answers at {address} is no program of Muster; set --http or MUSTER_HTTP to \
                 that of the process"
            );
            Err(ExitError { exit: Exit::Failure, message }.into())
        }
    }
}

/// The whole answer of the port to a get of `/healthz`.
fn get(address: SocketAddr) -> std::io::Result<String> {
    let mut stream = TcpStream::connect_timeout(&address, STEP_TIMEOUT)?;
    stream.set_read_timeout(Some(STEP_TIMEOUT))?;
    stream.set_write_timeout(Some(STEP_TIMEOUT))?;
    let request = format!("GET /healthz HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n");
    stream.write_all(request.as_bytes())?;
    let mut answer = Vec::new();
    stream.take(MAX_ANSWER_BYTES).read_to_end(&mut answer)?;
    Ok(String::from_utf8_lossy(&answer).into_owned())
}

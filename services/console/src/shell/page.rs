//! The page as a part of another program, for the host that it runs on.

use std::net::SocketAddr;

use muster_model::id::OperatorId;
use muster_runtime::config::ProcessConfig;
use muster_runtime::exit::ExitError;
use muster_runtime::stop::Stop;
use tokio::net::TcpListener;

use super::options::{ConsoleOptions, DEFAULT_ADDRESS};
use super::run;
use crate::access::Door;

/// A port at which the page will be served to whoever is on this host.
#[derive(Debug)]
pub struct LocalPage {
    listener: TcpListener,
    address: SocketAddr,
}

impl LocalPage {
    /// The address that a text names, or the usual one.
    ///
    /// # Errors
    /// If it is none, or other hosts reach it.
    pub fn parse(text: Option<&str>) -> Result<SocketAddr, ExitError> {
        let text = text.unwrap_or(DEFAULT_ADDRESS);
        let address: Option<SocketAddr> = text.parse().ok();
        address.filter(|address| address.ip().is_loopback()).ok_or_else(|| {
            ExitError::usage(format!(
                "console: {:?} is no address of this host alone with a port; write one like {DEFAULT_ADDRESS}, or \
                 run muster-console with --access, which asks for tokens",
                muster_wire::message::quoted(text)
            ))
        })
    }

    /// Listens at an address.
    ///
    /// # Errors
    /// If no one can, as another program does.
    pub async fn listen(address: SocketAddr) -> std::io::Result<Self> {
        let listener = TcpListener::bind(address).await?;
        let address = listener.local_addr()?;
        Ok(Self { listener, address })
    }

    /// Where browsers find the page.
    #[must_use]
    pub fn url(&self) -> String {
        format!("http://{}", self.address)
    }

    /// Serves the page until it is time to stop. Whoever reaches it commands under this name.
    pub async fn serve(self, config: ProcessConfig, operator: OperatorId, stop: Stop) {
        let Self { listener, address } = self;
        let door = Door::Open(operator);
        let options = ConsoleOptions { address, further_hosts: Vec::new(), door, image: None };
        run::serve(&config, listener, address, options, stop).await;
    }
}

//! A listener: handshakes side by side, each for a limited time, and a limited number of them.

use std::future::Future;
use std::net::SocketAddr;
use std::time::Duration;

use quinn::{Endpoint, Incoming};
use tokio::task::JoinSet;
use tokio::time::timeout;
use zenoh_link_commons::LinkUnicast;
use zenoh_protocol::core::Locator;
use zenoh_result::ZResult;

use crate::QUIC_LOCATOR_PREFIX;
use crate::link::QuicLink;

/// How long a handshake may take, the client's stream included: a dozen round trips of a slow link.
pub(crate) const HANDSHAKE_TIMEOUT: Duration = Duration::from_secs(2);

/// Most handshakes at once; further clients wait in the queue of the socket. To keep others out, silent
/// clients must begin 512 handshakes a second, each from an address at which it receives.
pub(crate) const MAX_HANDSHAKES: usize = 1024;

/// Most handshakes at once before clients must show that they receive at their address. That costs them a
/// round trip and the router no memory; small fleets that come back at once are spared it.
pub(crate) const MAX_UNPROVEN: usize = 64;

/// Accepts links until the endpoint is closed, and hands them over in the order in which their handshakes end.
pub(crate) async fn accept_all<N, H>(endpoint: &Endpoint, ends_with_certificate: bool, new_link: N)
where
    N: Fn(LinkUnicast) -> H + Clone + Send + 'static,
    H: Future<Output = ()> + Send,
{
    let Ok(here) = endpoint.local_addr() else { return };
    let mut handshakes = JoinSet::new();
    loop {
        tokio::select! {
            _ = handshakes.join_next(), if !handshakes.is_empty() => {}
            incoming = endpoint.accept(), if handshakes.len() < MAX_HANDSHAKES => {
                let Some(incoming) = incoming else { return };
                if handshakes.len() >= MAX_UNPROVEN && !incoming.remote_address_validated() {
                    // An address that is not validated may be asked to retry.
                    let _ = incoming.retry();
                    continue;
                }
                let new_link = new_link.clone();
                handshakes.spawn(async move {
                    let from = incoming.remote_address();
                    let shaking = shake_hands(incoming, here, ends_with_certificate);
                    match timeout(HANDSHAKE_TIMEOUT, shaking).await {
                        Ok(Ok(link)) => new_link(link).await,
                        Ok(Err(error)) => tracing::debug!("no QUIC link from {from}: {error}"),
                        Err(_) => tracing::debug!("no QUIC link from {from}: its handshake takes too long"),
                    }
                });
            }
        }
    }
}

/// One handshake, up to the stream that the client opens.
async fn shake_hands(
    incoming: Incoming,
    here: SocketAddr,
    ends_with_certificate: bool,
) -> ZResult<LinkUnicast> {
    let connection = incoming.await?;
    let streams = connection.accept_bi().await?;
    // A listener at all addresses: the one that the client has chosen.
    let ip = connection.local_ip().unwrap_or(here.ip());
    let there = Locator::new(QUIC_LOCATOR_PREFIX, connection.remote_address().to_string(), "")?;
    QuicLink::start(
        connection,
        streams,
        SocketAddr::new(ip, here.port()),
        there,
        ends_with_certificate,
    )
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use quinn::rustls::RootCertStore;
    use quinn::rustls::pki_types::{CertificateDer, PrivatePkcs8KeyDer};
    use quinn::{ClientConfig, Connection, ServerConfig};
    use tokio::net::UdpSocket;
    use tokio::sync::mpsc;
    use tokio::task::JoinHandle;

    use super::*;

    const NAME: &str = "localhost";

    /// A listener, and a client that trusts it.
    struct Both {
        address: SocketAddr,
        links: mpsc::UnboundedReceiver<LinkUnicast>,
        client: Endpoint,
        listening: JoinHandle<()>,
    }

    impl Both {
        fn start() -> Self {
            let key = rcgen::generate_simple_self_signed([NAME.to_owned()]).unwrap();
            let certificate = CertificateDer::from(key.cert.der().to_vec());
            let private = PrivatePkcs8KeyDer::from(key.signing_key.serialize_der());
            let config =
                ServerConfig::with_single_cert(vec![certificate.clone()], private.into()).unwrap();
            let any = SocketAddr::from(([127, 0, 0, 1], 0));
            let endpoint = Endpoint::server(config, any).unwrap();
            let address = endpoint.local_addr().unwrap();
            let (sender, links) = mpsc::unbounded_channel();
            let listening = tokio::spawn(async move {
                let new_link = move |link| {
                    let _ = sender.send(link);
                    std::future::ready(())
                };
                accept_all(&endpoint, false, new_link).await;
            });
            let mut roots = RootCertStore::empty();
            roots.add(certificate).unwrap();
            let mut client = Endpoint::client(any).unwrap();
            let config = ClientConfig::with_root_certificates(Arc::new(roots)).unwrap();
            client.set_default_client_config(config);
            Self { address, links, client, listening }
        }

        async fn connect(&self) -> Connection {
            self.client.connect(self.address, NAME).unwrap().await.unwrap()
        }

        /// Sends the first datagram of each of some clients, which fall silent then.
        async fn fall_silent(&self, count: usize) -> Vec<UdpSocket> {
            let nowhere = UdpSocket::bind("127.0.0.1:0").await.unwrap();
            let mut silent = Vec::new();
            for _ in 0..count {
                let connecting = self.client.connect(nowhere.local_addr().unwrap(), NAME).unwrap();
                let mut hello = [0; 1500];
                let length = nowhere.recv(&mut hello).await.unwrap();
                drop(connecting);
                let socket = UdpSocket::bind("127.0.0.1:0").await.unwrap();
                socket.send_to(&hello[..length], self.address).await.unwrap();
                silent.push(socket);
            }
            silent
        }

        /// Whether a client gets a link, before those that are silent are given up.
        async fn is_let_in(&mut self) -> bool {
            let joining = async {
                let connection = self.connect().await;
                let (mut sending, _receiving) = connection.open_bi().await.unwrap();
                sending.write_all(b"x").await.unwrap();
                let link = self.links.recv().await.unwrap();
                let mut byte = [0];
                link.read_exact(&mut byte, None).await.unwrap();
                assert_eq!(byte, *b"x");
                assert_eq!(link.get_src().address().as_str(), self.address.to_string());
            };
            timeout(HANDSHAKE_TIMEOUT / 2, joining).await.is_ok()
        }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn clients_that_fall_silent_keep_nobody_out() {
        let mut both = Both::start();
        assert!(both.is_let_in().await);
        let _silent = both.fall_silent(8).await;
        assert!(both.is_let_in().await, "some are silent");
        let _idle = both.connect().await;
        assert!(both.is_let_in().await, "one opens no stream");
        let _silent = both.fall_silent(2 * MAX_UNPROVEN).await;
        assert!(both.is_let_in().await, "so many are silent that clients must show their address");
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_client_that_opens_no_stream_is_let_go_of() {
        let both = Both::start();
        let idle = both.connect().await;
        let closed = timeout(2 * HANDSHAKE_TIMEOUT, idle.closed()).await;
        assert!(closed.is_ok(), "it is still connected");
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_listener_that_ends_gives_its_address_back() {
        let both = Both::start();
        let _silent = both.fall_silent(1).await;
        both.listening.abort();
        let freed = async {
            while std::net::UdpSocket::bind(both.address).is_err() {
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
        };
        // A handshake that is given up drains for three of its round trip estimates.
        assert!(timeout(5 * HANDSHAKE_TIMEOUT, freed).await.is_ok(), "the address is still taken");
    }
}

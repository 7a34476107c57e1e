//! What Zenoh asks for: links to endpoints, and listeners.

use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr};
use std::str::FromStr;
use std::sync::Arc;

use async_trait::async_trait;
use quinn::crypto::rustls::{QuicClientConfig, QuicServerConfig};
use quinn::{ClientConfig, Endpoint, ServerConfig, TransportConfig};
use zenoh_link_commons::quic::{
    PROTOCOL_LEGACY, PROTOCOL_SINGLE_STREAM, TlsClientConfig, TlsServerConfig, get_quic_addr,
    get_quic_host,
};
use zenoh_link_commons::{
    LinkManagerUnicastTrait, LinkUnicast, ListenersUnicastIP, LocatorInspector,
    NewLinkChannelSender,
};
use zenoh_protocol::core::{EndPoint, Locator, Metadata, Reliability};
use zenoh_result::ZResult;

use crate::QUIC_LOCATOR_PREFIX;
use crate::link::QuicLink;
use crate::listener::accept_all;

/// Options of an endpoint that Zenoh's own link has and this one has not.
const OTHER_OPTIONS: [&str; 6] =
    ["bind", "iface", "dscp", "initial_mtu", "mtu_discovery_interval_secs", "segmentation_offload"];

/// Variants that an endpoint may ask for with `1` and that are not here.
const OTHER_VARIANTS: [&str; 2] = [Metadata::MULTISTREAM, Metadata::MIXED_RELIABILITY];

/// Says of an endpoint whether its link is reliable or multicast.
#[derive(Debug, Default, Clone, Copy)]
pub struct QuicLocatorInspector;

#[async_trait]
impl LocatorInspector for QuicLocatorInspector {
    fn protocol(&self) -> &str {
        QUIC_LOCATOR_PREFIX
    }

    async fn is_multicast(&self, _locator: &Locator) -> ZResult<bool> {
        Ok(false)
    }

    fn is_reliable(&self, locator: &Locator) -> ZResult<bool> {
        match locator.metadata().get(Metadata::RELIABILITY) {
            Some(text) => Ok(Reliability::from_str(text)? == Reliability::Reliable),
            None => Ok(true),
        }
    }
}

/// Opens links over QUIC, and listens for them.
#[derive(Debug)]
pub struct LinkManagerUnicastQuic {
    new_links: NewLinkChannelSender,
    listeners: ListenersUnicastIP,
}

impl LinkManagerUnicastQuic {
    /// A manager that sends links of its listeners to Zenoh.
    #[must_use]
    pub fn new(new_links: NewLinkChannelSender) -> Self {
        Self { new_links, listeners: ListenersUnicastIP::new() }
    }
}

/// One stream of both directions for a link, which the client opens.
fn transport_config() -> Arc<TransportConfig> {
    let mut config = TransportConfig::default();
    config.max_concurrent_bidi_streams(1u8.into()).max_concurrent_uni_streams(0u8.into());
    Arc::new(config)
}

fn protocols() -> Vec<Vec<u8>> {
    vec![PROTOCOL_SINGLE_STREAM.to_vec(), PROTOCOL_LEGACY.to_vec()]
}

/// Refuses an endpoint that asks for what is not here.
fn check(endpoint: &EndPoint) -> ZResult<()> {
    let (config, metadata) = (endpoint.config(), endpoint.metadata());
    let option = OTHER_OPTIONS.into_iter().find(|name| config.get(name).is_some());
    let variant = OTHER_VARIANTS.into_iter().find(|name| metadata.get(name) == Some("1"));
    match option.or(variant) {
        Some(name) => {
            Err(format!("{endpoint}: {name} is not supported over QUIC here; leave it out").into())
        }
        None => Ok(()),
    }
}

#[async_trait]
impl LinkManagerUnicastTrait for LinkManagerUnicastQuic {
    async fn new_link(&self, endpoint: EndPoint) -> ZResult<LinkUnicast> {
        check(&endpoint)?;
        let address = get_quic_addr(&endpoint.address()).await?;
        // Addresses of IPv6 stand in brackets in an endpoint, and without them in a certificate.
        let host = endpoint.address();
        let host = get_quic_host(&host)?.trim_start_matches('[').trim_end_matches(']');
        let mut tls = TlsClientConfig::new(&endpoint.config(), true).await?;
        tls.client_config.alpn_protocols = protocols();
        let mut config =
            ClientConfig::new(Arc::new(QuicClientConfig::try_from(tls.client_config)?));
        config.transport_config(transport_config());
        let any = match address {
            SocketAddr::V4(_) => SocketAddr::from((Ipv4Addr::UNSPECIFIED, 0)),
            SocketAddr::V6(_) => SocketAddr::from((Ipv6Addr::UNSPECIFIED, 0)),
        };
        let socket = Endpoint::client(any)?;
        let connection = socket.connect_with(config, address, host)?.await?;
        let streams = connection.open_bi().await?;
        let here = socket.local_addr()?;
        QuicLink::start(
            connection,
            streams,
            here,
            endpoint.to_locator(),
            tls.tls_close_link_on_expiration,
        )
    }

    async fn new_listener(&self, endpoint: EndPoint) -> ZResult<Locator> {
        check(&endpoint)?;
        let address = get_quic_addr(&endpoint.address()).await?;
        let text = endpoint.address();
        let host = get_quic_host(&text)?;
        let mut tls = TlsServerConfig::new(&endpoint.config(), true).await?;
        tls.server_config.alpn_protocols = protocols();
        let mut config =
            ServerConfig::with_crypto(Arc::new(QuicServerConfig::try_from(tls.server_config)?));
        config.transport_config(transport_config());
        let socket = Endpoint::server(config, address)
            .map_err(|error| format!("cannot listen at {endpoint}: {error}"))?;
        let here = socket.local_addr()?;
        let locator = Locator::new(
            endpoint.protocol(),
            format!("{host}:{}", here.port()),
            endpoint.metadata(),
        )?;
        let listening = EndPoint::new(
            locator.protocol(),
            locator.address(),
            locator.metadata(),
            endpoint.config(),
        )?;
        let token = self.listeners.token.child_token();
        let (stopped, new_links) = (token.clone(), self.new_links.clone());
        let ends_with_certificate = tls.tls_close_link_on_expiration;
        let listen = async move {
            let new_link = move |link| {
                let new_links = new_links.clone();
                async move { drop(new_links.send_async(link).await) }
            };
            tokio::select! {
                () = stopped.cancelled() => {}
                () = accept_all(&socket, ends_with_certificate, new_link) => {}
            }
            Ok(())
        };
        self.listeners.add_listener(listening, here, listen, token).await?;
        Ok(locator)
    }

    async fn del_listener(&self, endpoint: &EndPoint) -> ZResult<()> {
        self.listeners.del_listener(get_quic_addr(&endpoint.address()).await?).await
    }

    async fn get_listeners(&self) -> Vec<EndPoint> {
        self.listeners.get_endpoints()
    }

    async fn get_locators(&self) -> Vec<Locator> {
        self.listeners.get_locators()
    }

    async fn get_locators_noloopback(&self) -> Vec<Locator> {
        self.listeners.get_locators_noloopback()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_endpoint_that_asks_for_what_is_not_here_is_refused() {
        let check = |text: &str| check(&text.parse().unwrap()).map_err(|error| error.to_string());
        for good in ["quic/base:7447", "quic/base:7447?multistream=auto", "quic/base:7447?rel=1"] {
            assert_eq!(check(good), Ok(()), "{good}");
        }
        for (bad, name) in [
            ("quic/base:7447#iface=eth0", "iface"),
            ("quic/base:7447?multistream=1", "multistream"),
            ("quic/base:7447?mixed_rel=1", "mixed_rel"),
        ] {
            assert!(check(bad).unwrap_err().contains(name), "{bad}");
        }
    }

    #[test]
    fn a_link_is_reliable_unless_its_endpoint_says_otherwise() {
        let is_reliable = |text: &str| QuicLocatorInspector.is_reliable(&text.parse().unwrap());
        assert!(is_reliable("quic/base:7447").unwrap());
        assert!(!is_reliable("quic/base:7447?rel=0").unwrap());
        assert!(is_reliable("quic/base:7447?rel=x").is_err());
    }
}

//! Zenoh's link over QUIC, with handshakes that do not wait for one another.
//!
//! The listener of Zenoh 1.10.2 takes a connection, awaits its handshake, and only then takes the next one
//! (github.com/eclipse-zenoh/zenoh/issues/2719): a client that sends one datagram and falls silent keeps all
//! others out for 30 s. Cargo puts this crate in place of Zenoh's of the same name. Here handshakes run side
//! by side, each for a limited time, and their number is limited ([`Handshakes`](listener) has the limits).
//!
//! On the wire it is one of the variants that Zenoh speaks: a stream for each direction, for all priorities
//! (ALPN `zenoh`, or `hq-29` of older versions). Zenoh's own links agree to it. A stream per priority and
//! datagrams, which Zenoh can do as well, are left out, and so are options of endpoints other than those of
//! TLS. An endpoint that asks for one of them is refused.
//!
//! A Zenoh whose listener runs each handshake in a task of its own ends the need for this crate.

mod link;
mod listener;
mod manager;

pub use manager::{LinkManagerUnicastQuic, QuicLocatorInspector};
/// What turns Zenoh's configuration of TLS into options of an endpoint.
pub use zenoh_link_commons::quic::TlsConfigurator as QuicConfigurator;

/// The protocol of endpoints of this link.
pub const QUIC_LOCATOR_PREFIX: &str = "quic";

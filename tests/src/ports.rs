//! Free ports for the programs of tests.
//!
//! A port that the system chooses for a socket that is closed at once is free only until the system chooses it for
//! another: of a program that is asked for any port, or of a connection. Ports given out here lie below the range that
//! systems choose from (32768 on Linux, 49152 elsewhere), and no process gives out one twice before all were used.

use std::net::{TcpListener, UdpSocket};
use std::ops::Range;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, Ordering};

use anyhow::Context;

/// The ports that are given out: below what systems choose from, above those of most known services.
const PORTS: Range<u16> = 20_000..32_000;

/// An address on loopback whose port is free for TCP and UDP, such as `127.0.0.1:20123`.
///
/// # Errors
/// If no port is free.
pub fn free_address() -> anyhow::Result<String> {
    static NEXT: OnceLock<AtomicU32> = OnceLock::new();
    // Processes that run at the same time begin at different ports.
    let next = NEXT.get_or_init(|| AtomicU32::new(std::process::id().wrapping_mul(61)));
    next_free(next)
        .with_context(|| format!("no port of {PORTS:?} is free: end programs of earlier tests"))
}

/// The next address whose port is free; none if no port is.
fn next_free(next: &AtomicU32) -> Option<String> {
    let addresses = PORTS.map(|_| {
        let offset = next.fetch_add(1, Ordering::Relaxed) % u32::from(PORTS.end - PORTS.start);
        format!("127.0.0.1:{}", u32::from(PORTS.start) + offset)
    });
    let is_free =
        |address: &String| TcpListener::bind(address).is_ok() && UdpSocket::bind(address).is_ok();
    addresses.into_iter().find(is_free)
}

/// An endpoint of Zenoh on loopback whose port is free, such as `tcp/127.0.0.1:20123`.
///
/// # Errors
/// If no port is free.
pub fn free_endpoint() -> anyhow::Result<String> {
    Ok(format!("tcp/{}", free_address()?))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn no_port_is_given_out_twice_or_is_one_that_the_system_may_choose() {
        let next = AtomicU32::new(u32::MAX - 100);
        let addresses: BTreeSet<_> = (0..200).map(|_| next_free(&next).unwrap()).collect();
        assert_eq!(addresses.len(), 200);
        for address in addresses {
            let port: u16 = address.rsplit(':').next().unwrap().parse().unwrap();
            assert!(PORTS.contains(&port), "{address}");
        }
    }

    #[test]
    fn a_port_that_is_taken_for_tcp_or_udp_is_passed_over() {
        let next = AtomicU32::new(7_000);
        let listener = TcpListener::bind(next_free(&next).unwrap()).unwrap();
        let socket = UdpSocket::bind(next_free(&next).unwrap()).unwrap();
        let taken = [listener.local_addr().unwrap(), socket.local_addr().unwrap()];
        next.store(7_000, Ordering::Relaxed);
        let free = next_free(&next).unwrap();
        assert!(taken.iter().all(|taken| taken.to_string() != free), "{free}");
    }
}

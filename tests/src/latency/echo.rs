//! The round trip of one message through the router alone.

use std::sync::mpsc;
use std::time::{Duration, Instant};

use zenoh::Wait;

use crate::client::Client;

/// Where pings are put.
const PING: &str = "echo/ping";

/// Where they come back.
const PONG: &str = "echo/pong";

/// How long a ping is waited for.
const PING_TIMEOUT: Duration = Duration::from_secs(2);

/// Between two pings: often enough for a percentile, too seldom to weigh.
const PING_INTERVAL: Duration = Duration::from_millis(20);

/// Puts everything back that is put, until it is killed.
///
/// # Errors
/// If the router does not answer.
pub async fn run(endpoint: &str, fleet: &str) -> anyhow::Result<()> {
    let client = Client::connect(endpoint, fleet).await?;
    let (session, pong) = (client.session().clone(), client.key(PONG));
    let subscriber = client
        .session()
        .declare_subscriber(client.key(PING))
        .callback(move |sample| {
            let _ = session.put(&pong, sample.payload().clone()).wait();
        })
        .await;
    let _subscriber = subscriber.map_err(|error| anyhow::anyhow!("{error}"))?;
    std::future::pending::<()>().await;
    Ok(())
}

/// Pings an echo for a time with payloads of a size, one after the other; the round trips in
/// milliseconds, in order, and how many pings did not come back in time.
///
/// # Errors
/// If the session is closed.
pub async fn ping(
    client: &Client,
    size: usize,
    lasts: Duration,
) -> anyhow::Result<(Vec<f64>, usize)> {
    let fail = |error: zenoh::Error| anyhow::anyhow!("{error}");
    let (sender, receiver) = mpsc::channel();
    let subscriber = client
        .session()
        .declare_subscriber(client.key(PONG))
        .callback(move |sample| {
            let _ = sender.send((Instant::now(), sample.payload().to_bytes().into_owned()));
        })
        .await
        .map_err(fail)?;
    let (session, ping) = (client.session().clone(), client.key(PING));
    let pinging = tokio::task::spawn_blocking(move || {
        let (begin, mut trips, mut missing) = (Instant::now(), Vec::new(), 0);
        for number in 0_u64.. {
            if begin.elapsed() >= lasts {
                break;
            }
            let mut payload = number.to_le_bytes().to_vec();
            payload.resize(size.max(payload.len()), b' ');
            let put = Instant::now();
            session.put(&ping, payload.clone()).wait().map_err(fail)?;
            let back = loop {
                match receiver.recv_timeout(PING_TIMEOUT.saturating_sub(put.elapsed())) {
                    Ok((at, same)) if same == payload => break Some(at),
                    // One that was given up comes after all.
                    Ok(_) => {}
                    Err(_) => break None,
                }
            };
            match back {
                Some(at) => trips.push(at.duration_since(put).as_secs_f64() * 1e3),
                None => missing += 1,
            }
            std::thread::sleep(PING_INTERVAL);
        }
        anyhow::Ok((trips, missing))
    });
    let measured = pinging.await?;
    drop(subscriber);
    measured
}

//! Robots with a session each that all join at once.

use std::sync::Arc;
use std::time::{Duration, Instant};

use muster_client::Config;
use muster_tests::client::{Client, division};
use muster_tests::cluster::Cluster;
use muster_tests::joining::{Progress, join_all};
use tokio::time::sleep;

/// How many robots join: more than a router has threads, and few enough for a busy machine.
const ROBOTS: usize = 60;

/// How long that may take on a busy machine; it takes a second on an idle one.
const DIVIDED_WITHIN: Duration = Duration::from_secs(30);

#[tokio::test(flavor = "multi_thread")]
async fn robots_that_join_at_once_are_all_divided() {
    let cluster = Cluster::start("alpha", &[("clusterer", "teams=4")]).unwrap();
    let client = Client::connect(&cluster.endpoint, "alpha").await.unwrap();
    let watch = client.watch("json/teams").await.unwrap();
    let config = Config {
        fleet: "alpha".to_owned(),
        routers: Some(vec![cluster.endpoint.clone()]),
        ..Config::default()
    };
    let progress = Arc::new(Progress::default());
    let _robots = join_all(&config, ROBOTS, &progress);
    let (start, mut divided) = (Instant::now(), 0);
    while divided < ROBOTS {
        assert_eq!(progress.failed(), None);
        let joined = progress.joined();
        assert!(start.elapsed() < DIVIDED_WITHIN, "{joined} have joined, {divided} are divided");
        sleep(Duration::from_millis(50)).await;
        if let Some((_, teams)) = watch.take().last() {
            divided = division(teams).values().filter(|team| team.is_some()).count();
        }
    }
    assert_eq!(progress.joined(), ROBOTS);
}

//! A minute of the soak: faults of real processes on a real bus, by a seed that is fixed and by a fresh one.

use std::io::Write as _;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use muster_tests::soak::{RunOptions, plan, run};

/// How long faults happen, in minutes; each run takes some seconds more to form its teams.
const MINUTES: f64 = 0.42;

/// Other tests run at the same time.
const PATIENCE: f64 = 2.0;

/// Prints past the test harness, which keeps back what a good test prints.
#[expect(clippy::explicit_write, reason = "what eprintln prints is kept back")]
fn say(text: &str) {
    writeln!(std::io::stderr(), "soak: {text}").unwrap();
}

async fn soak(seed: u64) {
    let plan = plan(seed, Duration::from_secs_f64(MINUTES * 60.0), None);
    let mut log = plan.to_string();
    let outcome = run(&plan, &RunOptions { logs: None, patience: PATIENCE }, |line| {
        log += line;
        log.push('\n');
    });
    let outcome = outcome.await.unwrap();
    assert!(outcome.broken.is_empty(), "{log}\n{}\n{:#?}", outcome.report, outcome.broken);
    say(&format!("seed {seed}: {} faults, every promise held", outcome.faults));
}

#[tokio::test(flavor = "multi_thread")]
async fn every_promise_holds_through_the_faults_of_a_fixed_seed() {
    soak(1).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn every_promise_holds_through_the_faults_of_a_fresh_seed() {
    let seed = SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs();
    // Before the run: it is to be known whatever happens.
    say(&format!("fresh seed; again: target/debug/soak --seed {seed} --minutes {MINUTES}"));
    soak(seed).await;
}

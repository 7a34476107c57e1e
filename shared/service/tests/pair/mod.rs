//! Two instances of one service on a bus that loses, delays and mixes, with processes that die, hang and are cut off:
//! in the end one leads, and both have what was last confirmed to an operator.
//!
//! The simulation does the same with all services. This one does nothing else, so that it tries twenty times as many courses of
//! events in the same time.

mod world;

use proptest::prelude::*;
use proptest::test_runner::RngSeed;

use self::world::{FAULTS_UNTIL, HOSTS, LONGEST_FAULT, MS, Micros, SECOND, World};

/// What goes wrong on one host.
#[derive(Debug, Clone)]
pub(super) enum Fault {
    /// The process dies, and is started again.
    Kill,
    /// It does not run for a while.
    Hang,
    /// Its session ends at once.
    CleanCut,
    /// Nothing arrives, which is noticed when the lease is over.
    SilentCut,
    /// Messages are lost and late: so many of a hundred, and up to so many milliseconds.
    Storm { lost: u64, late_ms: u64, mixes: bool },
    /// The service publishes something, so that it has a new revision.
    Output,
    /// An operator changes settings.
    Set,
}

/// A fault of a course of events.
#[derive(Debug, Clone)]
pub(super) struct Planned {
    pub(super) at: Micros,
    pub(super) lasts: Micros,
    pub(super) host: usize,
    pub(super) fault: Fault,
}

fn fault() -> impl Strategy<Value = Fault> {
    let storm = (0_u64..40, 1_u64..600, any::<bool>());
    prop_oneof![
        3 => Just(Fault::Kill),
        1 => Just(Fault::Hang),
        2 => Just(Fault::CleanCut),
        3 => Just(Fault::SilentCut),
        3 => storm.prop_map(|(lost, late_ms, mixes)| Fault::Storm { lost, late_ms, mixes }),
        1 => Just(Fault::Output),
        3 => Just(Fault::Set),
    ]
}

fn planned() -> impl Strategy<Value = Planned> {
    let all = (0..FAULTS_UNTIL / MS, 0..LONGEST_FAULT / MS, 0..HOSTS.len(), fault());
    all.prop_map(|(at, lasts, host, fault)| Planned { at: at * MS, lasts: lasts * MS, host, fault })
}

/// Each run tries the same courses: rare ones may break the promise still, and no run is to fail for what no change has
/// caused. `PROPTEST_RNG_SEED` and `PROPTEST_CASES` try others, and `PAIR_LOG` names a file for what happened in a course that
/// broke it.
fn config() -> ProptestConfig {
    let mut config = ProptestConfig::default();
    if matches!(config.rng_seed, RngSeed::Random) {
        config.rng_seed = RngSeed::Fixed(1);
        config.cases = config.cases.max(1000);
    }
    config
}

proptest! {
    #![proptest_config(config())]

    #[test]
    fn one_leads_in_the_end_and_what_was_confirmed_last_holds(
        seed in any::<u64>(),
        plan in prop::collection::vec(planned(), 1..14),
        ahead in [0..2 * SECOND, 0..2 * SECOND],
    ) {
        let mut world = World::new(seed, plan.clone(), ahead, false);
        world.run();
        let judged = world.judge();
        if let (Err(_), Some(file)) = (&judged, std::env::var_os("PAIR_LOG")) {
            let mut again = World::new(seed, plan, ahead, true);
            again.run();
            std::fs::write(file, again.log.unwrap().join("\n")).unwrap();
        }
        prop_assert_eq!(judged, Ok(()));
    }
}

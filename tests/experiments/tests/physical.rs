//! Ten robots on a real bus receive their teams from the real services.

#![cfg(feature = "bus")]
#![allow(clippy::unwrap_used, reason = "a helper of tests that fails has found a fault")]

use std::collections::BTreeMap;

use muster_experiments::live::play;
use muster_experiments::physical::Case;

/// Long enough for services to find each other on a machine that does other things as well.
const SECONDS: f64 = 8.0;

#[test]
fn robots_in_three_corners_receive_three_teams() {
    let cases = Case::all().unwrap();
    let case = cases.iter().find(|case| case.layout.name == "corners").unwrap();
    let received = play(case, &case.recording().unwrap(), 3, SECONDS).unwrap();
    let truth = &case.layout.divisions[0];
    let mut pairs: BTreeMap<_, _> = BTreeMap::new();
    for (found, wanted) in received.teams.iter().zip(truth) {
        assert_eq!(pairs.entry(wanted).or_insert(found), &found, "{received:?}");
    }
    assert_eq!((received.teams.len(), pairs.len()), (10, 3));
    assert!(received.whole_s.is_some() && !received.newest_ms.is_empty(), "{received:?}");
    let mut ages = received.newest_ms.iter().zip(&received.oldest_ms);
    assert!(ages.all(|(newest, oldest)| newest <= oldest), "{received:?}");
}

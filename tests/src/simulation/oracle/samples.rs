//! What a fleet publishes without a fault, for tests that break it.

use super::super::clock::SECOND;
use super::super::world::World;
use super::super::{Options, Scale};
use super::{Breach, Oracle, Verified};

/// The oracle of a fleet of several teams that has been divided and audited.
pub(super) fn oracle_of_a_divided_fleet() -> Oracle {
    let options = Options { robots: Some(8), ..Options::default() };
    let several = (0..100).find_map(|seed| {
        let scale = Scale { instances: 1, ros: 0, ..options.scale(seed) };
        let mut world = World::new(seed, &scale, Vec::new(), None, false);
        world.run_until(10 * SECOND);
        let audit = world.oracle.audits.last()?;
        let is_whole = !audit.in_physical.per_robot.is_empty();
        is_whole.then_some(world.oracle)
    });
    several.unwrap()
}

/// The promise that is broken.
pub(super) fn promise(checked: Verified) -> &'static str {
    let Breach { promise, .. } = checked.unwrap_err();
    promise
}

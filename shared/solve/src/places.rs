//! The place of each robot in the order of all rows.

use std::collections::HashMap;

use muster_model::id::RobotId;

use super::error::{SolveError, refuse};

/// Most robots: the largest file holds a dozen edges for each of so many, and hardly more.
pub(super) const MAX_SOLVE_ROBOTS: usize = 1 << 20;

/// The index of each robot.
pub(super) type Places = HashMap<RobotId, usize>;

/// Checks the names of the robots.
pub(super) fn places(robots: &[RobotId]) -> Result<Places, SolveError> {
    if robots.is_empty() {
        return refuse("robots", "must name at least one robot");
    }
    if robots.len() > MAX_SOLVE_ROBOTS {
        let count = robots.len();
        return refuse(
            "robots",
            format!("{count} are too many: there may be {MAX_SOLVE_ROBOTS} at most"),
        );
    }
    let mut places = HashMap::with_capacity(robots.len());
    for (place, robot) in robots.iter().enumerate() {
        if let Some(first) = places.insert(robot.clone(), place) {
            return refuse(
                format!("robots[{place}]"),
                format!("{robot} is named twice, first as robots[{first}]"),
            );
        }
    }
    Ok(places)
}

/// The place of a robot that a field names.
pub(super) fn place(
    places: &Places,
    robot: &RobotId,
    field: impl FnOnce() -> String,
) -> Result<usize, SolveError> {
    match places.get(robot) {
        Some(place) => Ok(*place),
        None => refuse(field(), format!("{robot} is not among \"robots\"")),
    }
}

//! Robots that have new orders: whose superior is another than a moment ago.
//!
//! What robots report of places and links is then still that of the old orders. Embedder and clusterer both
//! follow the rosters for it.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use crate::id::RobotId;
use crate::roster::{Presence, Roster, RosterEntry};
use crate::time::Tick;

/// How long orders are new: a squad that is handed over reaches its new neighbours within it.
pub const NEW_ORDERS_TIME: Duration = Duration::from_secs(10);

/// For so long after a robot was first seen, its first superior is no new order: its messages come one by one, and
/// after a restart of everything the rank is the last one.
const JOINING_TIME: Duration = Duration::from_secs(5);

fn is_past(now: Tick, at: Tick) -> bool {
    now >= at.after(NEW_ORDERS_TIME)
}

/// Whether a robot has left and come back between two rosters: nothing that it reported before is known. Its messages come one by
/// one. A robot that was silent, and of which no superior is known any more, has not said so first of all.
fn has_rejoined(before: &RosterEntry, after: &RosterEntry) -> bool {
    before.position.is_some() && after.position.is_none()
        || before.presence == Presence::Stale
            && before.superior.is_some()
            && after.superior.is_none()
}

/// Robots whose superior has changed lately.
#[derive(Debug, Default)]
pub struct NewOrders {
    changed: BTreeMap<RobotId, Tick>,
    /// When each robot was first seen, for a while.
    joined: BTreeMap<RobotId, Tick>,
}

impl NewOrders {
    /// One roster follows another. Returns whether a robot has left and come back between the two.
    pub fn follow(&mut self, now: Tick, before: Option<&Roster>, after: &Roster) -> bool {
        let mut have_rejoined = false;
        let place = |robot: &RobotId| after.robots.binary_search_by(|entry| entry.robot.cmp(robot));
        self.changed.retain(|robot, at| !is_past(now, *at) && place(robot).is_ok());
        self.joined.retain(|robot, at| now < at.after(JOINING_TIME) && place(robot).is_ok());
        let mut old = before.into_iter().flat_map(|before| &before.robots).peekable();
        for entry in &after.robots {
            let RosterEntry { robot, superior, .. } = entry;
            while old.next_if(|entry| entry.robot < *robot).is_some() {}
            let known = old.peek().filter(|entry| entry.robot == *robot);
            match known {
                None => {
                    self.joined.insert(robot.clone(), now);
                }
                Some(last) if has_rejoined(last, entry) => {
                    have_rejoined = true;
                    self.joined.insert(robot.clone(), now);
                }
                Some(entry) if entry.superior == *superior => {}
                Some(entry) if entry.superior.is_none() && self.joined.contains_key(robot) => {}
                Some(_) => {
                    self.changed.insert(robot.clone(), now);
                }
            }
        }
        have_rejoined
    }

    /// The robots whose own superior has changed lately, ordered by name.
    pub fn changed(&self, now: Tick) -> impl Iterator<Item = &RobotId> {
        self.changed.iter().filter(move |(_, at)| !is_past(now, **at)).map(|(robot, _)| robot)
    }

    /// When the first of them will have had its orders for long enough.
    #[must_use]
    pub fn due(&self, now: Tick) -> Option<Tick> {
        let due = self.changed.values().map(|at| at.after(NEW_ORDERS_TIME));
        due.filter(|due| *due > now).min()
    }

    /// The robots that have new orders, and all that stand below them.
    pub fn renewed<'a>(&'a self, now: Tick, roster: Option<&'a Roster>) -> BTreeSet<&'a RobotId> {
        let mut open: Vec<&RobotId> = self.changed(now).collect();
        let mut renewed: BTreeSet<&RobotId> = open.iter().copied().collect();
        if open.is_empty() {
            return renewed;
        }
        let mut below: BTreeMap<&RobotId, Vec<&RobotId>> = BTreeMap::new();
        for entry in roster.into_iter().flat_map(|roster| &roster.robots) {
            if let Some(superior) = &entry.superior {
                below.entry(superior).or_default().push(&entry.robot);
            }
        }
        while let Some(robot) = open.pop() {
            let next = below.get(robot).into_iter().flatten();
            open.extend(next.copied().filter(|robot| renewed.insert(robot)));
        }
        renewed
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::header::Header;
    use crate::header::Revision;
    use crate::id::FleetId;

    fn robot(name: &str) -> RobotId {
        RobotId::new(name).unwrap()
    }

    fn at(ms: u64) -> Tick {
        Tick(1_000_000 + 1000 * ms)
    }

    /// A roster: `"a<b"` answers to b.
    fn roster(robots: &str) -> Roster {
        let entries = robots.split_whitespace().map(|text| {
            let (name, superior) = match text.split_once('<') {
                Some((name, superior)) => (name, Some(robot(superior))),
                None => (text, None),
            };
            RosterEntry {
                node: 0,
                robot: robot(name),
                presence: Presence::Active,
                position: None,
                heading: None,
                frame: None,
                superior,
                role: None,
                skills: vec![],
                last_seen: Tick::default(),
            }
        });
        let header = Header {
            fleet: FleetId::new("f").unwrap(),
            revision: Revision::default(),
            oldest: None,
            newest: None,
            stages: Vec::new(),
        };
        Roster { header, robots: entries.collect(), graphs: vec![] }
    }

    #[test]
    fn orders_reach_all_below_and_are_new_for_a_while() {
        let mut orders = NewOrders::default();
        let names = |orders: &NewOrders, ms: u64, roster: &Roster| {
            let renewed = orders.renewed(at(ms), Some(roster));
            renewed.into_iter().map(RobotId::as_str).collect::<Vec<_>>().join(" ")
        };
        let first = roster("a b<a c<b d<c x");
        orders.follow(at(0), None, &first);
        assert_eq!(names(&orders, 0, &first), "", "the first roster is no change");
        let second = roster("a b<x c<b d<c e<a x");
        orders.follow(at(100), Some(&first), &second);
        assert_eq!(names(&orders, 100, &second), "b c d");
        orders.follow(at(200), Some(&second), &second);
        assert_eq!(names(&orders, 10_099, &second), "b c d");
        assert_eq!(names(&orders, 10_100, &second), "");
        // A circle of superiors ends, and who has left is forgotten.
        let circle = roster("a<b b<a c<b x");
        orders.follow(at(20_000), Some(&second), &circle);
        assert_eq!(names(&orders, 20_000, &circle), "a b c");
        orders.follow(at(20_100), Some(&circle), &roster("x"));
        assert_eq!(names(&orders, 20_100, &circle), "");
        assert!(orders.changed.is_empty() && orders.joined.is_empty());
    }

    #[test]
    fn a_silent_robot_that_is_back_without_its_superior_has_no_new_orders() {
        let [mut before, without, again] = ["a b<a", "a b", "a b<a"].map(roster);
        for (presence, names) in [(Presence::Stale, ""), (Presence::Active, "b")] {
            before.robots[1].presence = presence;
            let mut orders = NewOrders::default();
            orders.follow(at(0), None, &before);
            assert_eq!(orders.follow(at(100), Some(&before), &without), names.is_empty());
            orders.follow(at(200), Some(&without), &again);
            let renewed = orders.renewed(at(200), Some(&again));
            let renewed: Vec<&str> = renewed.into_iter().map(RobotId::as_str).collect();
            assert_eq!(renewed.join(" "), names);
        }
    }

    #[test]
    fn the_first_rank_of_a_robot_that_has_just_joined_is_no_new_order() {
        let mut orders = NewOrders::default();
        let [posed, ranked, top] = ["a b c", "a b<a c", "a b<a c<a"].map(roster);
        orders.follow(at(0), None, &posed);
        orders.follow(at(1000), Some(&posed), &ranked);
        assert_eq!(orders.changed(at(1000)).count(), 0);
        // Later it is one, for a robot at the top as well.
        orders.follow(at(6000), Some(&ranked), &top);
        assert_eq!(orders.changed(at(6000)).collect::<Vec<_>>(), [&robot("c")]);
        // Nor is the rank of one that has left and come back between two rosters.
        let mut placed = ranked.clone();
        placed.robots[1].position = Some([0.0; 3]);
        assert!(!orders.follow(at(20_000), Some(&top), &placed));
        assert!(orders.follow(at(20_100), Some(&placed), &roster("a b c")));
        orders.follow(at(21_000), Some(&roster("a b c")), &placed);
        assert_eq!(orders.changed(at(21_000)).collect::<Vec<_>>(), [&robot("c")]);
        // And so is another rank at any time.
        let mut orders = NewOrders::default();
        orders.follow(at(0), None, &ranked);
        orders.follow(at(100), Some(&ranked), &roster("a b<c c"));
        assert_eq!(orders.changed(at(100)).collect::<Vec<_>>(), [&robot("b")]);
    }
}

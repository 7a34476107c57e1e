//! From rules that cannot be satisfied to an irreducible set of them.
//!
//! The deletion filter (Chinneck and Dravnieks, ORSA Journal on Computing 3, 1991) drops each rule without which
//! the others still contradict each other. Robots of the same class with the same pairs are interchangeable,
//! so that the number of them that can be dropped is found by halving.

use std::collections::BTreeMap;

use super::conflict::Rule;
use super::cut::Fleet;
use super::rules::Pair;

/// Pairs of a robot, without the robot.
type Shape = Vec<Pair>;

/// Interchangeable robots, their pairs, and the place of the first pair that was not tried.
struct Alike {
    robots: Vec<usize>,
    shape: Shape,
    next: usize,
}

/// The rules that were not dropped, as limits and interchangeable robots.
struct Kept {
    limits: Vec<Rule>,
    robots: BTreeMap<usize, Shape>,
}

impl Kept {
    fn rules(&self) -> Vec<Rule> {
        let pairs = self.robots.iter().flat_map(|(robot, shape)| {
            shape.iter().map(|pair| Rule::Pair(with_robot(*pair, *robot)))
        });
        self.limits.iter().copied().chain(pairs).collect()
    }
}

fn with_robot(pair: Pair, robot: usize) -> Pair {
    match pair {
        Pair::Forced { column, .. } => Pair::Forced { robot, column },
        Pair::Forbidden { column, .. } => Pair::Forbidden { robot, column },
    }
}

/// An irreducible subset of `start`, which cannot be satisfied. Sorted.
pub(super) fn irreducible(fleet: &Fleet<'_>, start: Vec<Rule>) -> Vec<Rule> {
    let mut kept = Kept { limits: Vec::new(), robots: BTreeMap::new() };
    for rule in start {
        match rule {
            Rule::Pair(pair) => {
                kept.robots.entry(pair.robot()).or_default().push(with_robot(pair, 0));
            }
            limit => kept.limits.push(limit),
        }
    }
    drop_robots(fleet, &mut kept);
    drop_pairs(fleet, &mut kept);
    let mut at = 0;
    while at < kept.limits.len() {
        let limit = kept.limits.remove(at);
        if fleet.cut(&kept.rules()).is_none() {
            kept.limits.insert(at, limit);
            at += 1;
        }
    }
    let mut rules = kept.rules();
    rules.sort_unstable();
    rules
}

/// Interchangeable robots.
fn alike(fleet: &Fleet<'_>, kept: &Kept) -> Vec<Alike> {
    let mut groups: BTreeMap<(Option<usize>, &Shape), Vec<usize>> = BTreeMap::new();
    for (robot, shape) in &kept.robots {
        groups.entry((fleet.rules.class_of(*robot), shape)).or_default().push(*robot);
    }
    let group = |((_, shape), robots): ((Option<usize>, &Shape), Vec<usize>)| Alike {
        robots,
        shape: shape.clone(),
        next: 0,
    };
    groups.into_iter().map(group).collect()
}

/// Gives up all pairs of robots where the conflict does not need them.
fn drop_robots(fleet: &Fleet<'_>, kept: &mut Kept) {
    for Alike { robots, .. } in alike(fleet, kept) {
        let shapes: Vec<Shape> =
            robots.iter().filter_map(|robot| kept.robots.remove(robot)).collect();
        let without = |count: usize, kept: &mut Kept| {
            for (robot, shape) in robots.iter().zip(&shapes).skip(count) {
                kept.robots.insert(*robot, shape.clone());
            }
            let conflict = fleet.cut(&kept.rules()).is_some();
            for robot in &robots {
                kept.robots.remove(robot);
            }
            conflict
        };
        let count = most_dropped(robots.len(), |count| without(count, kept));
        for (robot, shape) in robots.iter().zip(&shapes).skip(count) {
            kept.robots.insert(*robot, shape.clone());
        }
    }
}

/// Gives up single pairs of robots where the conflict does not need them.
fn drop_pairs(fleet: &Fleet<'_>, kept: &mut Kept) {
    let mut open = alike(fleet, kept);
    while let Some(Alike { robots, shape, next }) = open.pop() {
        if next == shape.len() {
            continue;
        }
        let mut fewer = shape.clone();
        fewer.remove(next);
        let set = |count: usize, kept: &mut Kept| {
            for (place, robot) in robots.iter().enumerate() {
                let shape = if place < count { &fewer } else { &shape };
                kept.robots.insert(*robot, shape.clone());
            }
        };
        let count = most_dropped(robots.len(), |count| {
            set(count, kept);
            fleet.cut(&kept.rules()).is_some()
        });
        set(count, kept);
        let (first, rest) = robots.split_at(count);
        for (robots, shape, next) in [(first, fewer, next), (rest, shape, next + 1)] {
            if !robots.is_empty() {
                open.push(Alike { robots: robots.to_vec(), shape, next });
            }
        }
    }
    kept.robots.retain(|_, shape| !shape.is_empty());
}

/// Largest count, at most `all`, that still leaves a conflict; none leaves one.
fn most_dropped(all: usize, mut conflict: impl FnMut(usize) -> bool) -> usize {
    if conflict(all) {
        return all;
    }
    let (mut low, mut high) = (0, all);
    while high - low > 1 {
        let middle = low + (high - low) / 2;
        if conflict(middle) {
            low = middle;
        } else {
            high = middle;
        }
    }
    low
}

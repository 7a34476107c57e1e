//! Fleets of a few robots, whose teams anyone would tell.

use serde_json::{Map, Value, json};

use super::hostile::Dice;
use super::*;

/// Sizes of groups that stand apart, and how many of the draws are divided otherwise at most: where robots stand
/// alone, the rule for K or their scale may bring two of them together.
const GROUPS: [(&[usize], usize); 10] = [
    (&[1, 2], 2),
    (&[2, 2], 0),
    (&[2, 3], 0),
    (&[2, 4], 0),
    (&[3, 3], 0),
    (&[1, 1, 2], 28),
    (&[1, 2, 2], 12),
    (&[1, 2, 3], 12),
    (&[2, 2, 2], 0),
    (&[1, 1, 4], 38),
];

/// Distance of the middles of neighbouring groups, and of each robot from its middle at most.
const APART_M: f64 = 30.0;
const WITHIN_M: f64 = 2.0;

/// Draws of each fleet.
const SEEDS: u64 = 12;

/// What robots report besides their poses.
#[derive(Debug, Clone, Copy)]
struct Reports {
    ranks: bool,
    links: bool,
}

/// From 0 to below 1.
fn fraction(dice: &mut Dice) -> f64 {
    dice.below(1 << 20) as f64 / (1 << 20) as f64
}

/// Groups of robots in random order: the group and the place of each.
fn places(sizes: &[usize], dice: &mut Dice) -> Vec<(usize, [f64; 2])> {
    // In a row, or the third off the row.
    let third = if dice.below(2) == 0 { [2.0 * APART_M, 0.0] } else { [0.5 * APART_M, APART_M] };
    let middles = [[0.0, 0.0], [APART_M, 0.0], third];
    let mut robots = Vec::new();
    for (group, (size, middle)) in sizes.iter().zip(middles).enumerate() {
        for _ in 0..*size {
            let angle = std::f64::consts::TAU * fraction(dice);
            let away = WITHIN_M * fraction(dice).sqrt();
            robots.push((group, [middle[0] + away * angle.cos(), middle[1] + away * angle.sin()]));
        }
    }
    for last in (1..robots.len()).rev() {
        robots.swap(last, dice.below(last + 1));
    }
    robots
}

/// The file of such a fleet. The first of each group leads the others; all receive all, the farther the worse.
fn file(robots: &[(usize, [f64; 2])], teams: usize, reports: Reports) -> Value {
    let name = |robot: usize| format!("r{robot}");
    let poses = robots.iter().enumerate();
    let poses: Map<String, Value> =
        poses.map(|(robot, (_, [x, y]))| (name(robot), json!({"x": x, "y": y}))).collect();
    let mut file = json!({"robots": names(robots.len()), "teams": teams, "poses": poses});
    if reports.ranks {
        let leader = |group| robots.iter().position(|(other, _)| *other == group);
        let rank = |(robot, (group, _)): (usize, &(usize, _))| {
            let superior = leader(*group).filter(|leader| *leader != robot).map(name);
            (name(robot), json!({"superior": superior}))
        };
        file["ranks"] = robots.iter().enumerate().map(rank).collect::<Map<_, _>>().into();
    }
    if reports.links {
        let link = |[x, y]: [f64; 2], (peer, (_, [px, py])): (usize, &(usize, [f64; 2]))| {
            let distance = (x - px).hypot(y - py);
            json!({"peer": name(peer), "quality": 1.0 / (1.0 + (distance / 10.0).powi(2))})
        };
        let links = |(robot, (_, place)): (usize, &(usize, [f64; 2]))| {
            let others = robots.iter().enumerate().filter(|(peer, _)| *peer != robot);
            (name(robot), others.map(|peer| link(*place, peer)).collect::<Vec<_>>().into())
        };
        file["links"] = robots.iter().enumerate().map(links).collect::<Map<_, _>>().into();
    }
    file
}

/// Whether robots are together in one exactly where they are together in the other.
fn is_same_division(one: &[usize], other: &[usize]) -> bool {
    let pairs = (0..one.len()).flat_map(|i| (0..i).map(move |j| (i, j)));
    one.len() == other.len()
        && pairs.into_iter().all(|(i, j)| (one[i] == one[j]) == (other[i] == other[j]))
}

#[test]
fn four_robots_in_a_row_are_two_pairs() {
    let pose = |x: f64| json!({"x": x, "y": 0});
    let row = json!({"robots": ["r1", "r2", "r3", "r4"], "teams": 2,
                     "poses": {"r1": pose(0.0), "r2": pose(1.0), "r3": pose(2.0), "r4": pose(3.0)}});
    assert_eq!(solved(&row).divided.labels, [0, 0, 1, 1]);
}

#[test]
fn the_ends_of_a_chain_of_command_are_not_a_team_without_its_middle() {
    let chain = json!({"robots": ["r1", "r2", "r3"], "teams": 2,
        "poses": {"r1": {"x": 0, "y": 0}, "r2": {"x": 1, "y": 0}, "r3": {"x": 2, "y": 0}},
        "ranks": {"r1": {}, "r2": {"superior": "r1"}, "r3": {"superior": "r2"}}});
    for changes in [json!({}), json!({"poses": null}), json!({"ranks": null})] {
        let file = with(chain.clone(), changes);
        let labels = solved(&file).divided.labels;
        assert!(labels[0] != labels[2] || labels[0] == labels[1], "{labels:?} of {file}");
    }
}

#[test]
fn groups_that_stand_apart_are_the_teams() {
    let mut too_many = Vec::new();
    for (sizes, most_wrong) in GROUPS {
        let mut wrong = Vec::new();
        for (ranks, links) in [(false, false), (true, false), (false, true), (true, true)] {
            for seed in 0..SEEDS {
                let robots = places(sizes, &mut Dice(seed));
                let file = file(&robots, sizes.len(), Reports { ranks, links });
                let planted: Vec<usize> = robots.iter().map(|(group, _)| *group).collect();
                let found = solved(&file);
                let labels = &found.divided.labels;
                if !is_same_division(labels, &planted) {
                    let rank = found.decomposition.svd.rank();
                    let unassigned = found.divided.unassigned;
                    wrong.push(format!(
                        "{sizes:?} ranks {ranks} links {links} seed {seed}: {labels:?} instead of \
                         {planted:?}, K {rank}, unassigned {unassigned:?}"
                    ));
                }
            }
        }
        if wrong.len() > most_wrong {
            too_many.push(format!("{sizes:?}: {} wrong:\n{}", wrong.len(), wrong.join("\n")));
        }
    }
    assert!(too_many.is_empty(), "{}", too_many.join("\n"));
}

//! Together, apart and overlapping needs, against brute force.
use crate::common::teams::{
    Shape, column_at, holds, labellings, least_cost, random_costs, random_rules, single_rules,
};
use muster_numeric::assignment::{
    Assigner, Bounds, Column, CostMatrix, DivisionError, Need, Relation, Rules, Wish, Wishes,
    WishesError, assign_with_wishes,
};
use proptest::prelude::*;
use rand::seq::IteratorRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Enough for every instance that brute force can look at.
const BUDGET: usize = 100_000;

fn some_robots(rng: &mut ChaCha8Rng, robots: usize, least: usize) -> Vec<usize> {
    let count = rng.random_range(least..=robots.min(4).max(least));
    (0..robots).sample(rng, count)
}

fn random_wishes(rules: &Rules, largest: i64, seed: u64) -> Wishes {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0xdead);
    let mut wishes = Wishes::default();
    let price = |rng: &mut ChaCha8Rng| rng.random_bool(0.4).then(|| rng.random_range(0..=largest));
    for _ in 0..rng.random_range(0..3) {
        let relation = if rng.random_bool(0.5) { Relation::Together } else { Relation::Apart };
        let robots = some_robots(&mut rng, rules.robots, 2);
        wishes.wishes.push(Wish { relation, robots, price: price(&mut rng) });
    }
    for _ in 0..rng.random_range(0..3) {
        let robots = some_robots(&mut rng, rules.robots, 1);
        for _ in 0..rng.random_range(1..3) {
            let column = column_at(rules, rng.random_range(0..rules.columns()));
            let at_least = rng.random_range(0..3);
            let room = rng.random_range(0..3);
            let at_most = if rng.random_bool(0.4) { at_least + room } else { usize::MAX };
            let robots = robots.clone();
            let price = price(&mut rng);
            wishes.needs.push(Need { robots, column, at_least, at_most, price });
        }
    }
    wishes
}

/// Prices of what `labels` do not grant; `None` if something hard is among it.
fn extra(rules: &Rules, wishes: &Wishes, labels: &[usize]) -> Option<i128> {
    let mut cost = 0;
    for wish in &wishes.wishes {
        let mut offended = false;
        for &a in &wish.robots {
            for &b in wish.robots.iter().filter(|b| **b != a) {
                offended |= match wish.relation {
                    Relation::Together => labels[a] != labels[b],
                    Relation::Apart => labels[a] == labels[b] && labels[a] < rules.teams.len(),
                };
            }
        }
        if offended {
            cost += i128::from(wish.price?);
        }
    }
    for need in &wishes.needs {
        let column = rules.index_of(need.column).unwrap();
        let there = need.robots.iter().filter(|robot| labels[**robot] == column).count();
        if there > need.at_most {
            return None;
        }
        if there < need.at_least {
            cost += i128::from(need.price?) * (need.at_least - there) as i128;
        }
    }
    Some(cost)
}

/// True if any labelling satisfies the rules and the wishes and needs at these places.
fn grantable(rules: &Rules, wishes: &Wishes, kept: &[usize], kept_needs: &[usize]) -> bool {
    let some = Wishes {
        wishes: kept.iter().map(|at| wishes.wishes[*at].clone()).collect(),
        needs: kept_needs.iter().map(|at| wishes.needs[*at].clone()).collect(),
    };
    let all = single_rules(rules);
    labellings(rules).any(|labels| {
        all.iter().all(|rule| holds(rules, rule, &labels)) && extra(rules, &some, &labels).is_some()
    })
}

fn without(places: &[usize], dropped: usize) -> Vec<usize> {
    places.iter().copied().filter(|place| *place != dropped).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1500))]

    #[test]
    fn costs_as_little_as_brute_force_finds(
        robots in 4_usize..=6,
        teams in 1_usize..4,
        classes in 0_usize..2,
        coarse: bool,
        seed: u64,
    ) {
        let largest = if coarse { 2 } else { 1000 };
        let rules = random_rules(Shape { robots, teams, classes, largest, room: 2 }, seed);
        let costs = random_costs(&rules, largest, seed);
        let wishes = random_wishes(&rules, largest, seed);
        let valid = rules.clone().check().unwrap();
        let checked = wishes.clone().check(&valid).unwrap();
        let wishes = checked.get();
        let best = least_cost(&rules, &costs, |labels| extra(&rules, wishes, labels));
        match assign_with_wishes(&mut Assigner::new(), &valid, &checked, &costs, BUDGET) {
            Ok(found) => {
                prop_assert!(found.optimal && found.gap == 0);
                prop_assert_eq!(Some(found.cost), best);
                let labels: Vec<usize> =
                    found.columns.iter().map(|column| rules.index_of(*column).unwrap()).collect();
                prop_assert!(single_rules(&rules).iter().all(|rule| holds(&rules, rule, &labels)));
                let cost = crate::common::teams::cost(&rules, &costs, &labels)
                    + extra(&rules, wishes, &labels).unwrap();
                prop_assert_eq!(cost, found.cost);
            }
            Err(DivisionError::Infeasible { wishes: kept, needs, irreducible }) => {
                prop_assert!(best.is_none() && irreducible);
                prop_assert!(!grantable(&rules, wishes, &kept, &needs));
                for dropped in &kept {
                    prop_assert!(grantable(&rules, wishes, &without(&kept, *dropped), &needs));
                }
                for dropped in &needs {
                    prop_assert!(grantable(&rules, wishes, &kept, &without(&needs, *dropped)));
                }
            }
            Err(DivisionError::Assignment(_)) => {
                prop_assert!(!grantable(&rules, wishes, &[], &[]));
            }
            Err(error) => prop_assert!(false, "{}", error),
        }
    }

    #[test]
    fn a_small_budget_gives_an_honest_gap(seed: u64, budget in 0_usize..6) {
        let shape = Shape { robots: 6, teams: 3, classes: 0, largest: 100, room: 3 };
        let rules = random_rules(shape, seed);
        let costs = random_costs(&rules, 100, seed);
        let valid = rules.clone().check().unwrap();
        let wishes = random_wishes(&rules, 100, seed).check(&valid).unwrap();
        let best = least_cost(&rules, &costs, |labels| extra(&rules, wishes.get(), labels));
        match assign_with_wishes(&mut Assigner::new(), &valid, &wishes, &costs, budget) {
            Ok(found) => {
                let best = best.unwrap();
                prop_assert!(found.bound <= best && best <= found.cost);
                prop_assert_eq!(found.gap, found.cost - found.bound);
                prop_assert_eq!(found.optimal, found.gap == 0);
                prop_assert!(found.nodes <= budget.max(1));
            }
            Err(DivisionError::Undecided { .. }) => {}
            Err(_) => prop_assert_eq!(best, None),
        }
    }
}

/// A fleet in two teams of at most six with robots that like the first one.
fn pair_of_teams() -> (Rules, CostMatrix) {
    let rules = Rules { teams: vec![Bounds::at_most(6); 2], ..Rules::new(12, 2) };
    let values = (0..24).map(|at| if at % 2 == 0 { 0 } else { 10 + at }).collect();
    (rules, CostMatrix::new(12, 2, values).unwrap())
}

#[test]
fn disjoint_needs_and_apart_groups_take_one_node() {
    let (rules, costs) = pair_of_teams();
    let valid = rules.check().unwrap();
    let apart = Wish { relation: Relation::Apart, robots: vec![1, 0], price: None };
    let need = |robots: &[usize], team| Need {
        robots: robots.to_vec(),
        column: Column::Team(team),
        at_least: 1,
        at_most: usize::MAX,
        price: None,
    };
    let needs = vec![need(&[2, 3], 0), need(&[2, 3], 1), need(&[4, 5, 6], 1)];
    let wishes = Wishes { wishes: vec![apart], needs }.check(&valid).unwrap();
    let found = assign_with_wishes(&mut Assigner::new(), &valid, &wishes, &costs, 1).unwrap();
    assert!(found.optimal);
    assert_eq!(found.nodes, 1);
    assert_ne!(found.columns[0], found.columns[1]);
    assert_ne!(found.columns[2], found.columns[3]);
}

#[test]
fn wishes_that_contradict_each_other_are_named() {
    let (rules, costs) = pair_of_teams();
    let valid = rules.check().unwrap();
    let wish = |relation, robots: &[usize]| Wish { relation, robots: robots.to_vec(), price: None };
    let wishes = vec![
        wish(Relation::Together, &[8, 9]),
        wish(Relation::Together, &[0, 1]),
        wish(Relation::Apart, &[2, 5]),
        wish(Relation::Apart, &[1, 0]),
    ];
    let wishes = Wishes { wishes, needs: Vec::new() }.check(&valid).unwrap();
    let refused = assign_with_wishes(&mut Assigner::new(), &valid, &wishes, &costs, BUDGET);
    let expected =
        DivisionError::Infeasible { wishes: vec![1, 3], needs: Vec::new(), irreducible: true };
    assert_eq!(refused, Err(expected));
}

#[test]
fn overlapping_skills_of_a_fleet_come_with_a_gap() {
    let (robots, teams) = (200, 8);
    let mut rules = Rules::new(robots, teams);
    rules.teams = vec![Bounds::new(20, 30); teams];
    let costs = random_costs(&rules, 10_000, 5);
    let valid = rules.check().unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let mut needs = Vec::new();
    for _ in 0..3 {
        let robots: Vec<usize> = (0..robots).filter(|_| rng.random_bool(0.15)).collect();
        needs.extend((0..teams).map(|team| Need {
            robots: robots.clone(),
            column: Column::Team(team),
            at_least: 3,
            at_most: usize::MAX,
            price: None,
        }));
    }
    let wishes = Wishes { wishes: Vec::new(), needs }.check(&valid).unwrap();
    let solve = || assign_with_wishes(&mut Assigner::new(), &valid, &wishes, &costs, 3_000);
    let found = solve().unwrap();
    assert_eq!(found.optimal, found.bound == found.cost);
    assert!(found.gap * 100 <= found.cost.abs(), "{} of {}", found.gap, found.cost);
    println!("gap {} of {} after {} nodes", found.gap, found.cost, found.nodes);
    let places = found.columns.iter().enumerate();
    for need in &wishes.get().needs {
        let there = |(robot, column): &(usize, &Column)| {
            **column == need.column && need.robots.binary_search(robot).is_ok()
        };
        assert!(places.clone().filter(there).count() >= 3);
    }
    assert_eq!(solve().unwrap(), found);
}

#[test]
fn what_makes_no_sense_is_named() {
    let valid = Rules::new(3, 2).check().unwrap();
    let wish = |robots: &[usize], price| Wishes {
        wishes: vec![Wish { relation: Relation::Apart, robots: robots.to_vec(), price }],
        needs: Vec::new(),
    };
    let need = |robot, column| Wishes {
        wishes: Vec::new(),
        needs: vec![Need {
            robots: vec![robot],
            column,
            at_least: 1,
            at_most: usize::MAX,
            price: None,
        }],
    };
    let refused = |wishes: Wishes| wishes.check(&valid).unwrap_err();
    assert_eq!(refused(wish(&[1, 1], None)), WishesError::Group { wish: 0 });
    let expected = WishesError::WishRobot { wish: 0, robot: 3, robots: 3 };
    assert_eq!(refused(wish(&[1, 3], None)), expected);
    assert_eq!(refused(wish(&[1, 2], Some(-1))), WishesError::Price { price: -1 });
    let expected = WishesError::NeedRobot { need: 0, robot: 9, robots: 3 };
    assert_eq!(refused(need(9, Column::Team(0))), expected);
    assert!(matches!(refused(need(0, Column::Reserve)), WishesError::Column { need: 0, .. }));
    let many =
        Wishes { wishes: vec![wish(&[0, 1], None).wishes[0].clone(); 65], ..Wishes::default() };
    assert_eq!(refused(many), WishesError::TooMany { wishes: 65, needs: 0 });
}

//! Cheapest assignments against brute force, and their certificates.
use crate::common::teams::{
    Shape, column_at, cost, holds, least_cost, random_costs, random_rules, satisfiable,
    single_rules,
};
use muster_numeric::assignment::{
    Assigner, Assignment, AssignmentError, Bounds, ClassLimit, Column, Conflict, CostError,
    CostMatrix, Imbalance, MAX_COST, Pair, Rule, Rules, RulesError, Wanted,
};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn places(rules: &Rules, found: &Assignment) -> Vec<usize> {
    found.columns.iter().map(|column| rules.index_of(*column).unwrap()).collect()
}

/// The rules hold, the cost is that of the columns, and the gap is zero.
fn check(rules: &Rules, costs: &CostMatrix, assigner: &Assigner, found: &Assignment) {
    let labels = places(rules, found);
    for rule in single_rules(rules) {
        assert!(holds(rules, &rule, &labels), "{rule}");
    }
    assert_eq!(found.cost, cost(rules, costs, &labels));
    let proof = assigner.certificate(&rules.clone().check().unwrap(), costs).unwrap();
    assert_eq!((proof.cost, proof.gap()), (found.cost, 0));
}

/// The rules of a conflict contradict each other, and no others do without any of them.
fn check_conflict(rules: &Rules, conflict: &Conflict) {
    let all = single_rules(rules);
    for rule in &conflict.rules {
        assert!(all.contains(rule), "{rule}");
    }
    assert!(!satisfiable(rules, &conflict.rules), "{conflict}");
    for dropped in 0..conflict.rules.len() {
        let mut fewer = conflict.rules.clone();
        let rule = fewer.remove(dropped);
        assert!(satisfiable(rules, &fewer), "{conflict} without {rule}");
    }
    let imbalance = &conflict.imbalance;
    assert!(imbalance.demand() > imbalance.supply(), "{conflict}");
    let (Imbalance::Crowded { least, most, .. } | Imbalance::Lacking { least, most, .. }) =
        imbalance;
    let limits = conflict.rules.iter().filter(|rule| !matches!(rule, Rule::Pair(_)));
    assert_eq!(limits.count(), least.len() + most.len(), "{conflict}");
}

fn shapes(max_robots: usize) -> impl Strategy<Value = Shape> {
    (0..=max_robots, 1_usize..4, 0_usize..3, 0_i64..2, prop::bool::ANY).prop_map(
        |(robots, teams, classes, room, coarse)| {
            let largest = if coarse { 2 } else { 1000 };
            Shape { robots, teams, classes, largest, room }
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1500))]

    #[test]
    fn costs_as_little_as_brute_force_finds(shape in shapes(7), seed: u64) {
        let rules = random_rules(shape, seed);
        let costs = random_costs(&rules, shape.largest, seed);
        let mut assigner = Assigner::new();
        let best = least_cost(&rules, &costs, |_| Some(0));
        match assigner.solve(&rules.clone().check().unwrap(), &costs) {
            Ok(found) => {
                prop_assert_eq!(Some(found.cost), best);
                check(&rules, &costs, &assigner, &found);
            }
            Err(AssignmentError::Infeasible(conflict)) => {
                prop_assert_eq!(best, None);
                check_conflict(&rules, &conflict);
            }
            Err(error) => prop_assert!(false, "{}", error),
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn certificates_of_larger_fleets_have_no_gap(
        robots in 20_usize..300,
        teams in 1_usize..20,
        classes in 0_usize..4,
        seed: u64,
    ) {
        let shape = Shape { robots, teams, classes, largest: 1 << 30, room: 2 };
        let rules = random_rules(shape, seed);
        let costs = random_costs(&rules, shape.largest, seed);
        let mut assigner = Assigner::new();
        if let Ok(found) = assigner.solve(&rules.clone().check().unwrap(), &costs) {
            check(&rules, &costs, &assigner, &found);
        }
    }

    #[test]
    fn a_kept_assigner_costs_the_same_from_tick_to_tick(
        robots in 10_usize..150,
        teams in 2_usize..10,
        classes in 0_usize..3,
        seed: u64,
    ) {
        let shape = Shape { robots, teams, classes, largest: 1000, room: 2 };
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut rules = random_rules(shape, seed);
        let columns = rules.columns();
        let mut values: Vec<i64> =
            (0..robots * columns).map(|_| rng.random_range(0..1000)).collect();
        let mut kept = Assigner::new();
        for tick in 0..12 {
            for value in &mut values {
                *value += rng.random_range(-20..=20);
            }
            if tick % 3 == 2 {
                // Other limits of the same columns.
                let reserve = rules.reserve;
                rules = random_rules(shape, seed.wrapping_add(tick));
                rules.reserve = reserve;
                rules.class_limits.retain(|limit| limit.column != Column::Reserve);
                rules.pairs.retain(|pair| pair.column() != Column::Reserve);
            }
            let valid = rules.clone().check().unwrap();
            let costs = CostMatrix::new(robots, columns, values.clone()).unwrap();
            match (kept.solve(&valid, &costs), Assigner::new().solve(&valid, &costs)) {
                (Ok(warm), Ok(cold)) => {
                    prop_assert_eq!(warm.cost, cold.cost);
                    check(&rules, &costs, &kept, &warm);
                    let again = kept.solve(&valid, &costs).unwrap();
                    prop_assert_eq!((again.columns, again.repairs), (warm.columns, 0));
                }
                (warm, cold) => prop_assert_eq!(warm, cold),
            }
        }
    }

    #[test]
    fn the_same_calls_give_the_same_answers(seed: u64) {
        let shape = Shape { robots: 120, teams: 7, classes: 2, largest: 3, room: 2 };
        let rules = random_rules(shape, seed);
        let costs = random_costs(&rules, shape.largest, seed);
        let valid = rules.check().unwrap();
        let solve = || {
            let mut assigner = Assigner::new();
            [assigner.solve(&valid, &costs), assigner.solve(&valid, &costs)]
        };
        prop_assert_eq!(solve(), solve());
    }
}

/// Costs of robots that all like the first team best, by different degrees.
fn crowding_costs(robots: usize, columns: usize) -> CostMatrix {
    let value = |at: usize| ((at % columns) * (at / columns + 3) * 7) as i64 % 1009;
    CostMatrix::new(robots, columns, (0..robots * columns).map(value).collect()).unwrap()
}

/// Even teams of robots that all like the first one best; returns the repairs.
fn repairs_of_a_crowd(robots: usize, teams: usize) -> usize {
    let mut rules = Rules::new(robots, teams);
    rules.teams = vec![Bounds::new(robots / teams, robots / teams); teams];
    let costs = crowding_costs(robots, teams);
    let mut assigner = Assigner::new();
    let found = assigner.solve(&rules.clone().check().unwrap(), &costs).unwrap();
    check(&rules, &costs, &assigner, &found);
    found.repairs
}

#[test]
fn hundreds_out_of_place_go_through_heaps() {
    assert!(repairs_of_a_crowd(990, 10) >= 800);
}

#[test]
fn prices_of_a_sample_leave_few_repairs() {
    assert!(repairs_of_a_crowd(3_000, 10) < 1_000);
}

#[test]
fn ties_keep_robots_where_they_are() {
    let rules = Rules { teams: vec![Bounds::at_most(2); 2], ..Rules::new(4, 2) };
    let valid = rules.check().unwrap();
    let costs = CostMatrix::new(4, 2, vec![5; 8]).unwrap();
    let wanted = [1, 0, 1, 0].map(Column::Team);
    let mut assigner = Assigner::new();
    assigner.set_previous(&valid, &wanted.map(Some));
    let found = assigner.solve(&valid, &costs).unwrap();
    assert_eq!((&found.columns[..], found.repairs), (&wanted[..], 0));
}

#[test]
fn wanted_robots_come_if_they_are_worth_it() {
    let mut rules = Rules { classes: vec![Some(7); 3], ..Rules::new(3, 2) };
    let wanted = Some(Wanted { count: 2, price: 10 });
    let limit = ClassLimit { column: Column::Team(1), class: 7, bounds: Bounds::ANY, wanted };
    rules.class_limits = vec![limit];
    let costs = CostMatrix::new(3, 2, vec![0, 4, 0, 14, 0, 15]).unwrap();
    let found = Assigner::new().solve(&rules.check().unwrap(), &costs).unwrap();
    assert_eq!(found.columns, [1, 0, 0].map(Column::Team));
    assert_eq!(found.cost, 14);
}

fn conflict(rules: Rules) -> Conflict {
    let costs =
        CostMatrix::new(rules.robots, rules.columns(), vec![0; rules.robots * rules.columns()]);
    match Assigner::new().solve(&rules.check().unwrap(), &costs.unwrap()) {
        Err(AssignmentError::Infeasible(conflict)) => *conflict,
        other => panic!("{other:?}"),
    }
}

#[test]
fn conflicts_are_told_with_their_arithmetic() {
    let mut rules = Rules::new(20, 4);
    rules.teams[1] = Bounds::at_most(3);
    rules.teams[2] = Bounds::at_most(5);
    for robot in 0..12 {
        for column in [0, 3].map(Column::Team) {
            rules.pairs.push(Pair::Forbidden { robot, column });
        }
    }
    let found = conflict(rules);
    assert_eq!(found.to_string(), "9 robots may only be in t1 and t2, which hold 8");
    assert_eq!(found.rules.len(), 9 * 2 + 2);

    let rules = Rules { teams: vec![Bounds::at_least(6); 2], ..Rules::new(9, 2) };
    assert_eq!(conflict(rules).to_string(), "t0 and t1 need 12 robots, and 9 may be there");

    let rules = Rules { teams: vec![Bounds::at_most(4); 2], ..Rules::new(9, 2) };
    assert_eq!(conflict(rules).to_string(), "9 robots may only be in t0 and t1, which hold 8");

    let mut rules = Rules { classes: vec![None, Some(2), None], ..Rules::new(3, 2) };
    for column in [0, 1].map(Column::Team) {
        let bounds = Bounds::at_least(1);
        rules.class_limits.push(ClassLimit { column, class: 2, bounds, wanted: None });
    }
    let text = conflict(rules).to_string();
    assert_eq!(text, "t0 and t1 need 2 robots of class 2, and 1 may be there");

    let mut rules = Rules::new(3, 2);
    rules.pairs = [0, 1].map(|team| Pair::Forced { robot: 2, column: Column::Team(team) }).to_vec();
    assert_eq!(conflict(rules).to_string(), "r2 may be nowhere");

    let mut rules =
        Rules { classes: (0..9).map(|robot| Some(robot % 2)).collect(), ..Rules::new(9, 2) };
    rules.teams[0] = Bounds::at_most(5);
    for class in 0..2 {
        let bounds = Bounds::at_least(3);
        let column = Column::Team(0);
        rules.class_limits.push(ClassLimit { column, class, bounds, wanted: None });
    }
    assert_eq!(
        conflict(rules).to_string(),
        "at least 3 robots of class 0 in t0 and at least 3 robots of class 1 in t0 make 6, \
         but there can only be 5: at most 5 robots in t0"
    );
}

#[test]
fn large_conflicts_are_reduced_by_halving() {
    let mut rules = Rules::new(5_000, 3);
    rules.teams[1] = Bounds::at_most(2_000);
    rules.pairs = (0..4_000).map(|robot| Pair::Forced { robot, column: Column::Team(1) }).collect();
    let found = conflict(rules);
    assert_eq!(found.to_string(), "2001 robots may only be in t1, which holds 2000");
    assert_eq!(found.rules.len(), 2_002);
}

#[test]
fn what_makes_no_sense_is_named() {
    let valid = Rules::new(4, 2);
    let limit = |column, class, bounds| ClassLimit { column, class, bounds, wanted: None };
    let team = Column::Team;
    let cases = [
        (Rules::new(4, 0), RulesError::Teams { teams: 0 }),
        (Rules::new(4, 5_000), RulesError::Teams { teams: 5_000 }),
        (Rules::new(1 << 30, 2), RulesError::Robots { robots: 1 << 30 }),
        (
            Rules { teams: vec![Bounds::new(3, 2)], ..valid.clone() },
            RulesError::Bounds { column: team(0), lower: 3, upper: 2 },
        ),
        (
            Rules { classes: vec![None], ..valid.clone() },
            RulesError::Classes { classes: 1, robots: 4 },
        ),
        (
            Rules { classes: vec![Some(1 << 20); 4], ..valid.clone() },
            RulesError::Class { class: 1 << 20 },
        ),
        (
            Rules { class_limits: vec![limit(team(1), 0, Bounds::new(2, 1))], ..valid.clone() },
            RulesError::ClassBounds { column: team(1), class: 0, lower: 2, upper: 1 },
        ),
        (
            Rules { class_limits: vec![limit(team(1), 0, Bounds::ANY); 2], ..valid.clone() },
            RulesError::Twice { column: team(1), class: 0 },
        ),
        (
            Rules { class_limits: vec![limit(Column::Reserve, 0, Bounds::ANY)], ..valid.clone() },
            RulesError::Column { column: Column::Reserve, teams: 2 },
        ),
        (
            Rules { pairs: vec![Pair::Forced { robot: 4, column: team(0) }], ..valid.clone() },
            RulesError::Robot { robot: 4, robots: 4 },
        ),
        (
            Rules { pairs: vec![Pair::Forbidden { robot: 0, column: team(2) }], ..valid.clone() },
            RulesError::Column { column: team(2), teams: 2 },
        ),
    ];
    for (rules, expected) in cases {
        assert_eq!(rules.check().unwrap_err(), expected);
    }
    let mut soft = limit(team(0), 0, Bounds::ANY);
    soft.wanted = Some(Wanted { count: 1, price: -1 });
    let rules = Rules { class_limits: vec![soft], ..valid.clone() };
    let expected = RulesError::Price { column: team(0), class: 0, price: -1 };
    assert_eq!(rules.check().unwrap_err(), expected);
    let costs = CostMatrix::new(4, 3, vec![0; 12]).unwrap();
    let refused = Assigner::new().solve(&valid.check().unwrap(), &costs);
    assert!(matches!(refused, Err(AssignmentError::Shape { columns: 3, wanted_columns: 2, .. })));
}

#[test]
fn costs_are_checked_and_scaled() {
    assert!(matches!(CostMatrix::new(2, 2, vec![0; 3]), Err(CostError::Shape { len: 3, .. })));
    let large = CostMatrix::new(1, 2, vec![0, MAX_COST + 1]);
    assert!(matches!(large, Err(CostError::Cost { robot: 0, column: 1, .. })));
    let scaled = CostMatrix::from_floats(1, 3, &[0.24, -0.26, 1.0], 0.5).unwrap();
    assert_eq!(scaled.row(0), [0, -1, 2]);
    for bad in [f64::NAN, f64::INFINITY, 1e300] {
        let found = CostMatrix::from_floats(1, 1, &[bad], 1.0);
        assert!(matches!(found, Err(CostError::Cost { robot: 0, column: 0, .. })));
    }
    assert_eq!(CostMatrix::from_floats(0, 1, &[], 0.0), Err(CostError::Unit(0.0)));
    let unit = CostMatrix::unit_for(1e90);
    assert!(CostMatrix::from_floats(1, 2, &[1e90, -1e90], unit).is_ok());
    assert_eq!(CostMatrix::unit_for(0.0), 1.0);
}

#[test]
fn the_largest_costs_do_not_overflow() {
    let mut rules = Rules::new(60, 30);
    rules.teams = vec![Bounds::new(2, 2); 30];
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let values = (0..1800).map(|_| if rng.random_bool(0.5) { MAX_COST } else { -MAX_COST });
    let costs = CostMatrix::new(60, 30, values.collect()).unwrap();
    let mut assigner = Assigner::new();
    for _ in 0..3 {
        let found = assigner.solve(&rules.clone().check().unwrap(), &costs).unwrap();
        check(&rules, &costs, &assigner, &found);
    }
    assert_eq!(column_at(&rules, 30), Column::Reserve);
}

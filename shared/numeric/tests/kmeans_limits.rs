//! k-means under limits.
use crate::common::teams::{Shape, holds, labellings, random_rules, single_rules};
use crate::common::{blobs, distance};
use muster_numeric::assignment::{
    AssignmentError, Bounds, ClassLimit, Column, Pair, Rules, ValidRules, Wanted,
};
use muster_numeric::kmeans::{
    Init, KMeansError, KMeansLimits, KMeansOptions, LimitedKMeans, LimitedKMeansError, kmeans,
};
use muster_numeric::matrix::DenseMatrix;
use proptest::prelude::*;

const CORNERS: [&[f64]; 4] = [&[0.0, 0.0], &[4.0, 0.0], &[0.0, 4.0], &[4.0, 4.0]];

fn divide(
    x: &DenseMatrix,
    rules: &ValidRules,
    options: &KMeansOptions<'_>,
) -> Result<LimitedKMeans, LimitedKMeansError> {
    within(
        x,
        &KMeansLimits { rules, reserve_cost: 0.0, previous: None, refine_only: false },
        options,
    )
}

fn within(
    x: &DenseMatrix,
    limits: &KMeansLimits<'_>,
    options: &KMeansOptions<'_>,
) -> Result<LimitedKMeans, LimitedKMeansError> {
    options.check().unwrap().divide_within(x, limits)
}

fn places(rules: &Rules, found: &LimitedKMeans) -> Vec<usize> {
    found.columns.iter().map(|column| rules.index_of(*column).unwrap()).collect()
}

fn inertia(x: &DenseMatrix, labels: &[usize], teams: usize, reserve_cost: f64) -> f64 {
    let mut sum = 0.0;
    for team in 0..teams {
        let rows: Vec<&[f64]> =
            (0..x.rows()).filter(|&i| labels[i] == team).map(|i| x.row(i)).collect();
        let mean: Vec<f64> = (0..x.cols())
            .map(|j| rows.iter().map(|r| r[j]).sum::<f64>() / rows.len().max(1) as f64)
            .collect();
        sum += rows.iter().map(|r| distance(r, &mean).powi(2)).sum::<f64>();
    }
    sum + reserve_cost * labels.iter().filter(|label| **label == teams).count() as f64
}

fn even(points: usize, teams: usize, bounds: Bounds) -> ValidRules {
    Rules { teams: vec![bounds; teams], ..Rules::new(points, teams) }.check().unwrap()
}

#[test]
fn limits_of_size_divide_what_is_uneven() {
    let x = blobs(&[CORNERS[0], CORNERS[0], CORNERS[0], CORNERS[1]], 10, 0.5, 3);
    let rules = even(40, 2, Bounds::new(20, 20));
    for init in [Init::PlusPlus, Init::Random] {
        let options = KMeansOptions { init, ..KMeansOptions::new(2) };
        let found = divide(&x, &rules, &options).unwrap();
        let labels = places(rules.get(), &found);
        assert_eq!(labels.iter().filter(|label| **label == 0).count(), 20);
        // The far ones stay together.
        assert!(labels[30..].iter().all(|label| *label == labels[30]));
        assert!((found.inertia - inertia(&x, &labels, 2, 0.0)).abs() < 1e-9);
        assert!(found.converged && !found.warm);
    }
}

#[test]
fn without_a_binding_limit_it_is_as_good_as_free() {
    let x = blobs(&CORNERS, 20, 1.8, 3);
    let rules = even(80, 4, Bounds::ANY);
    let free = kmeans(&x, &KMeansOptions::new(4)).unwrap();
    let found = divide(&x, &rules, &KMeansOptions::new(4)).unwrap();
    assert!((found.inertia - free.inertia).abs() <= 1e-9 * free.inertia);
}

#[test]
fn no_team_stays_empty_that_may_have_somebody() {
    let x = blobs(&CORNERS, 3, 0.2, 3);
    let found = divide(&x, &even(12, 6, Bounds::ANY), &KMeansOptions::new(6)).unwrap();
    for team in 0..6 {
        assert!(found.columns.contains(&Column::Team(team)));
    }
}

#[test]
fn pins_name_the_team() {
    let x = blobs(&CORNERS, 10, 0.5, 3);
    let mut rules = Rules::new(40, 4);
    for (robot, team) in [(0, 3), (10, 1), (20, 2), (30, 0)] {
        rules.pairs.push(Pair::Forced { robot, column: Column::Team(team) });
    }
    let found = divide(&x, &rules.check().unwrap(), &KMeansOptions::new(4)).unwrap();
    let expected: Vec<Column> = (0..40).map(|i| Column::Team([3, 1, 2, 0][i / 10])).collect();
    assert_eq!(found.columns, expected);
}

#[test]
fn outliers_go_to_the_reserve() {
    let mut rows: Vec<Vec<f64>> =
        blobs(&CORNERS, 10, 0.5, 3).iter_rows().map(<[f64]>::to_vec).collect();
    rows.extend([vec![50.0, 0.0], vec![0.0, -60.0], vec![70.0, 70.0]]);
    let x = DenseMatrix::from_rows(&rows).unwrap();
    let rules = Rules { reserve: Some(Bounds::at_most(3)), ..Rules::new(43, 4) }.check().unwrap();
    let limits =
        KMeansLimits { rules: &rules, reserve_cost: 4.0, previous: None, refine_only: false };
    let found = within(&x, &limits, &KMeansOptions::new(4)).unwrap();
    let reserve: Vec<usize> =
        (0..43).filter(|point| found.columns[*point] == Column::Reserve).collect();
    assert_eq!(reserve, [40, 41, 42]);
    assert!((found.inertia - inertia(&x, &places(rules.get(), &found), 4, 4.0)).abs() < 1e-9);
}

#[test]
fn the_previous_division_keeps_its_numbers() {
    let x = blobs(&CORNERS, 10, 0.5, 3);
    let rules = even(40, 4, Bounds::new(8, 12));
    let mut previous: Vec<Option<Column>> =
        (0..40).map(|i| Some(Column::Team([2, 0, 3, 1][i / 10]))).collect();
    let expected: Vec<Column> = previous.iter().copied().flatten().collect();
    // A new point, one that left its team, and one of a team that is gone.
    (previous[4], previous[14], previous[33]) =
        (None, Some(Column::Team(1)), Some(Column::Team(9)));
    let limits = KMeansLimits {
        rules: &rules,
        reserve_cost: 0.0,
        previous: Some(&previous),
        refine_only: false,
    };
    let options = KMeansOptions { hysteresis: 0.1, ..KMeansOptions::new(4) };
    let found = within(&x, &limits, &options).unwrap();
    assert!(found.warm);
    assert_eq!(found.columns, expected);
    let columns: Vec<_> = found.columns.iter().copied().map(Some).collect();
    let limits = KMeansLimits { previous: Some(&columns), ..limits };
    assert_eq!(within(&x, &limits, &options).unwrap().columns, expected);
}

#[test]
fn a_previous_division_outside_of_the_limits_is_brought_within() {
    let x = blobs(&CORNERS, 10, 1.5, 3);
    let previous = vec![Some(Column::Team(0)); 40];
    let rules = even(40, 4, Bounds::new(7, 11));
    let limits = KMeansLimits {
        rules: &rules,
        reserve_cost: 0.0,
        previous: Some(&previous),
        refine_only: false,
    };
    let options = KMeansOptions { hysteresis: 0.9, restarts: 1, ..KMeansOptions::new(4) };
    let found = within(&x, &limits, &options).unwrap();
    let labels = places(rules.get(), &found);
    assert!(single_rules(rules.get()).iter().all(|rule| holds(rules.get(), rule, &labels)));
}

#[test]
fn noise_moves_nobody_across_a_border() {
    let mut rows: Vec<Vec<f64>> =
        blobs(&[&[-1.0], &[1.0]], 10, 0.1, 1).iter_rows().map(<[f64]>::to_vec).collect();
    rows.push(vec![0.0]);
    let rules = even(21, 2, Bounds::new(8, 13));
    let previous: Vec<Option<Column>> =
        (0..21).map(|i| Some(Column::Team(usize::from(i / 10 == 1)))).collect();
    let limits = KMeansLimits {
        rules: &rules,
        reserve_cost: 0.0,
        previous: Some(&previous),
        refine_only: false,
    };
    let options = KMeansOptions { hysteresis: 0.2, ..KMeansOptions::new(2) };
    for (at, team) in [(0.04, 0), (-0.04, 0), (0.5, 1)] {
        rows[20] = vec![at];
        let x = DenseMatrix::from_rows(&rows).unwrap();
        let found = within(&x, &limits, &options).unwrap();
        assert_eq!(found.columns[20], Column::Team(team), "at {at}");
    }
}

#[test]
fn the_result_does_not_depend_on_threads() {
    let x = blobs(&CORNERS, 25, 2.5, 8);
    let rules = even(100, 4, Bounds::new(24, 26));
    let divided = |threads| {
        let options = KMeansOptions { threads, restarts: 9, seed: 4, ..KMeansOptions::new(4) };
        divide(&x, &rules, &options).unwrap()
    };
    assert_eq!(divided(1), divided(1));
    assert_eq!(divided(1), divided(3));
}

#[test]
fn what_does_not_fit_is_named() {
    let x = blobs(&CORNERS, 2, 0.5, 3);
    let refused = |rules: Rules, clusters| {
        divide(&x, &rules.check().unwrap(), &KMeansOptions::new(clusters)).unwrap_err()
    };
    let expected = LimitedKMeansError::Teams { clusters: 3, teams: 2 };
    assert_eq!(refused(Rules::new(8, 2), 3), expected);
    let expected = LimitedKMeansError::Robots { points: 8, robots: 7 };
    assert_eq!(refused(Rules::new(7, 2), 2), expected);
    let expected = KMeansError::Clusters { clusters: 9, points: 8 }.into();
    assert_eq!(refused(Rules::new(8, 9), 9), expected);
    let tight = Rules { teams: vec![Bounds::at_most(3); 2], ..Rules::new(8, 2) };
    let conflict = refused(tight, 2);
    assert!(matches!(conflict, LimitedKMeansError::Assignment(AssignmentError::Infeasible(_))));
    assert_eq!(conflict.to_string(), "8 robots may only be in t0 and t1, which hold 6");
    let rules = Rules::new(8, 2).check().unwrap();
    let limits =
        KMeansLimits { rules: &rules, reserve_cost: f64::NAN, previous: None, refine_only: false };
    let found = within(&x, &limits, &KMeansOptions::new(2));
    assert!(matches!(found, Err(LimitedKMeansError::ReserveCost(_))));
    let limits = KMeansLimits { reserve_cost: 0.0, previous: Some(&[None]), ..limits };
    let found = within(&x, &limits, &KMeansOptions::new(2));
    assert_eq!(found, Err(LimitedKMeansError::Previous { columns: 1, points: 8 }));
}

/// How many robots soft minima lack.
fn missing(rules: &Rules, labels: &[usize]) -> usize {
    let lacks = |limit: &ClassLimit| {
        let column = rules.index_of(limit.column).unwrap();
        let there = labels.iter().zip(&rules.classes);
        let there =
            there.filter(|(label, class)| **label == column && **class == Some(limit.class));
        limit.wanted.map_or(0, |wanted| wanted.count.saturating_sub(there.count()))
    };
    rules.class_limits.iter().map(lacks).sum()
}

/// More than all distances of a few points together.
const SOFT_PRICE: i64 = 1 << 36;

#[test]
fn soft_minima_are_filled_as_far_as_can_be() {
    let x = blobs(&CORNERS, 10, 0.5, 3);
    let limit = |team| ClassLimit {
        column: Column::Team(team),
        class: 0,
        bounds: Bounds::ANY,
        wanted: Some(Wanted { count: 1, price: SOFT_PRICE }),
    };
    let class_limits: Vec<ClassLimit> = (0..4).map(limit).collect();
    // Three robots of one corner have the class, and four teams want one each.
    let classes = (0..40).map(|robot| (robot < 3).then_some(0)).collect();
    let rules = Rules { classes, class_limits, ..Rules::new(40, 4) };
    let found = divide(&x, &rules.clone().check().unwrap(), &KMeansOptions::new(4)).unwrap();
    let labels = places(&rules, &found);
    assert!(labels[0] != labels[1] && labels[1] != labels[2] && labels[0] != labels[2]);
    // The others are where they would be anyway.
    assert!((1..4).all(|corner| {
        labels[10 * corner + 1..10 * corner + 10].iter().all(|label| *label == labels[10 * corner])
    }));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1000))]

    #[test]
    fn the_optimum_of_tiny_instances(
        n in 3_usize..8,
        teams in 1_usize..4,
        classes in 0_usize..2,
        seed: u64,
    ) {
        let teams = teams.min(n);
        let x = blobs(&[&[0.0, 0.0]], n, 1.0, seed);
        let shape = Shape { robots: n, teams, classes, largest: 0, room: 1 };
        let mut rules = random_rules(shape, seed);
        let wanted = rules.class_limits.iter_mut().filter_map(|limit| limit.wanted.as_mut());
        wanted.for_each(|wanted| wanted.price = SOFT_PRICE);
        let lacks = |labels: &[usize]| missing(&rules, labels);
        let all = single_rules(&rules);
        let best = labellings(&rules)
            .filter(|labels| all.iter().all(|rule| holds(&rules, rule, labels)))
            .map(|labels| (lacks(&labels), inertia(&x, &labels, teams, 0.3)))
            .min_by(|left, right| left.0.cmp(&right.0).then(left.1.total_cmp(&right.1)));
        let valid = rules.clone().check().unwrap();
        let limits = KMeansLimits { rules: &valid, reserve_cost: 0.3, previous: None, refine_only: false };
        let options = KMeansOptions { seed, ..KMeansOptions::new(teams) };
        match (within(&x, &limits, &options), best) {
            (Ok(found), Some((least, best))) => {
                let labels = places(&rules, &found);
                prop_assert_eq!(lacks(&labels), least);
                prop_assert!(all.iter().all(|rule| holds(&rules, rule, &labels)));
                let own = inertia(&x, &labels, teams, 0.3);
                prop_assert!((found.inertia - own).abs() < 1e-9);
                prop_assert!(own >= best - 1e-9);
                prop_assert!(own <= best + 1e-9, "{} above {}", own, best);
            }
            (Err(LimitedKMeansError::Assignment(_)), None) => {}
            (found, best) => prop_assert!(false, "{:?} {:?}", found, best),
        }
    }
}

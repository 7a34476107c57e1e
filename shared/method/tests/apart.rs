//! Prices under wishes that robots be apart.

use muster_method::limited::{Limits, divide_within, optimality};
use muster_method::params::DivisionParams;
use muster_numeric::assignment::{Bounds, Relation, Rules, Wish, Wishes};
use muster_numeric::matrix::DenseMatrix;

fn square(row: &[f64], centroid: &[f64]) -> f64 {
    row.iter().zip(centroid).map(|(x, c)| (x - c).powi(2)).sum()
}

/// Robots that are apart anyway pay what all others pay; those that are kept from a team together by no more than
/// the wish are placed jointly.
#[test]
fn robots_that_are_apart_have_a_price_where_that_costs_nothing() {
    let mut seed = 3_u64;
    let mut draw = || {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (seed >> 33) as f64 / (1_u64 << 31) as f64
    };
    let (mut free, mut hindered) = (0, 0);
    for _ in 0..200 {
        let robots = 6 + (8.0 * draw()) as usize;
        let points: Vec<f64> = (0..2 * robots).map(|_| draw()).collect();
        let x = DenseMatrix::new(robots, 2, points).unwrap();
        let most = robots.div_ceil(3) + (2.0 * draw()) as usize;
        let rules = Rules { robots, teams: vec![Bounds::new(1, most); 3], ..Rules::default() };
        let rules = rules.check().unwrap();
        let wish = Wish { relation: Relation::Apart, robots: vec![0, 1], price: None };
        let groups = Wishes { wishes: vec![wish], ..Wishes::default() }.check(&rules).unwrap();
        let params = DivisionParams { teams: 3, hysteresis: 0.0, ..DivisionParams::default() };
        let previous = vec![None; robots];
        let limits =
            Limits { rules: &rules, groups: &groups, previous: &previous, refine_only: false };
        let found = divide_within(&x, &params.check().unwrap(), &limits).unwrap();
        let labels: Vec<usize> = found.labels.iter().flatten().copied().collect();
        let judged = optimality(&x, &labels, &found.centroids, &rules, &groups).unwrap();
        if !judged.optimal {
            continue;
        }
        assert!(judged.jointly.is_empty() || judged.jointly == [0, 1], "{judged:?}");
        assert!(judged.class_prices.is_empty(), "{judged:?}");
        for (robot, own) in labels.iter().enumerate() {
            let pay =
                |team: usize| square(x.row(robot), found.centroids.row(team)) + judged.prices[team];
            let is_cheapest = (0..3).all(|team| pay(*own) <= pay(team) + 1e-6);
            assert!(is_cheapest || judged.jointly.contains(&robot), "{robot}: {judged:?}");
        }
        free += usize::from(judged.jointly.is_empty());
        hindered += usize::from(!judged.jointly.is_empty());
    }
    assert!(free > 40 && hindered > 20, "{free} {hindered}");
}

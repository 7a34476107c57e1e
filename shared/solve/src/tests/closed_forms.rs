//! Graphs whose similarity, singular values and division are known.

use serde_json::json;

use super::*;

#[test]
fn a_directed_path_has_no_radius_and_powers_of_alpha() {
    let path: Vec<_> = (0..5).map(|i| (i, i + 1)).collect();
    let solution = solved(&plain(6, &path, 2.0));
    assert_eq!((solution.radius.value, solution.radius.acyclic), (0.0, true));
    assert_katz(&solution, |i, j| if j > i { 2f64.powi((j - i) as i32) } else { 0.0 });
    // 1/ρ does not exist; the fraction is taken of 1/‖A‖₂ = 1.
    let fraction = with(plain(6, &path, 2.0), json!({"alpha": {"fraction": 0.25}}));
    assert_near(solved(&fraction).alpha, 0.25, "α");
}

#[test]
fn a_directed_ring_is_circulant() {
    let (n, a) = (7, 0.6_f64);
    let solution = solved(&plain(n, &ring(n), a));
    assert_near(solution.radius.value, 1.0, "ρ");
    let around = 1.0 - a.powi(n as i32);
    assert_katz(&solution, |i, j| {
        let steps = if j > i { j - i } else { n + j - i };
        a.powi(steps as i32) / around
    });
    // The eigenvalues of S are αω/(1 − αω) for the n-th roots of unity ω, and S is normal.
    let angle = |k: usize| 2.0 * std::f64::consts::PI * k as f64 / n as f64;
    let modulus = |k| a / (1.0 - 2.0 * a * f64::cos(angle(k)) + a * a).sqrt();
    let mut expected: Vec<f64> = (0..n).map(modulus).collect();
    expected.sort_by(|l, r| r.total_cmp(l));
    assert_values(&solution, &expected);
}

#[test]
fn a_star_has_two_singular_values() {
    let (leaves, a) = (9, 0.25_f64);
    let edges: Vec<_> = (1..=leaves).flat_map(|leaf| [(0, leaf), (leaf, 0)]).collect();
    let file = plain(leaves + 1, &edges, a);
    let solution = solved(&file);
    let n = leaves as f64;
    assert_near(solution.radius.value, n.sqrt(), "ρ");
    let damped = 1.0 - a * a * n;
    assert_katz(&solution, |i, j| match (i, j) {
        (0, 0) => a * a * n / damped,
        (0, _) | (_, 0) => a / damped,
        _ => a * a / damped,
    });
    let walk = a * n.sqrt();
    let mut expected = vec![walk / (1.0 - walk), walk / (1.0 + walk)];
    assert_values(&solved(&with(file.clone(), json!({"dimension": 4}))), &expected);
    expected.resize(leaves + 1, 0.0);
    assert_values(&solution, &expected);
    // The rule stops where the rank ends.
    assert_eq!(solved(&with(file, json!({"dimension": "auto"}))).decomposition.svd.rank(), 2);
}

#[test]
fn a_complete_graph_is_ambiguous_behind_its_first_value() {
    let (n, a) = (6, 0.1_f64);
    let file = plain(n, &cliques(&[n]), a);
    let solution = solved(&file);
    let rho = (n - 1) as f64;
    assert_near(solution.radius.value, rho, "ρ");
    let first = a * rho / (1.0 - a * rho);
    let other = a / (1.0 + a);
    assert_katz(&solution, |i, j| {
        let own = if i == j { -other } else { 0.0 };
        (first + other) / n as f64 + own
    });
    let mut expected = vec![other; n];
    expected[0] = first;
    assert_values(&solution, &expected);
    let cut = solved(&with(file.clone(), json!({"dimension": 4})));
    let found = &cut.decomposition;
    assert!(found.svd.ambiguous() && found.svd.gap().abs() < 1e-12);
    assert_eq!(cut.angle_bound(), 1.0);
    assert!(cut.warnings[0].contains("coincide"), "{:?}", cut.warnings);
    let first = solved(&with(file, json!({"dimension": 2})));
    assert!(!first.decomposition.svd.ambiguous() && first.warnings.is_empty());
    assert!(first.angle_bound() < 1e-13);
}

#[test]
fn two_cliques_are_two_teams_and_their_silhouettes_are_known() {
    let file = with(
        plain(6, &cliques(&[3, 3]), 0.25),
        json!({"scale": "sqrt-sigma", "rows": "unit", "dimension": "auto", "teams": 2}),
    );
    let solution = solved(&file);
    // Per clique σ₁ = αρ/(1 − αρ) with ρ = 2.
    assert_values(&solution, &[1.0, 1.0]);
    assert_eq!(solution.divided.labels, [0, 0, 0, 1, 1, 1]);
    assert!(solution.divided.inertia < 1e-24);
    let silhouette = solution.divided.silhouette.unwrap();
    assert_near(silhouette.mean, 1.0, "mean");

    // Two points, at a distance of √2: rows of length 1 at right angles.
    let wrong = json!({"teams": null, "labels": [7, 7, 7, 7, 2, 2]});
    let solution = solved(&with(file.clone(), wrong));
    assert_eq!(solution.divided.labels, [7, 7, 7, 7, 2, 2]);
    assert_near(solution.divided.inertia, 1.5, "inertia");
    let silhouette = solution.divided.silhouette.unwrap();
    let expected = [2.0 / 3.0, 2.0 / 3.0, 2.0 / 3.0, -1.0, 1.0, 1.0];
    for (found, expected) in silhouette.details.per_point.iter().zip(expected) {
        assert_near(*found, expected, "silhouette");
    }
    assert_near(silhouette.mean, 0.5, "mean");
    assert_eq!(silhouette.details.per_cluster.iter().map(|c| c.0).collect::<Vec<_>>(), [2, 7]);
    assert_near(silhouette.details.per_cluster[1].1, 0.25, "label 7");

    // Equal rows cannot be separated: three teams cannot be made of two points.
    let three = solved(&with(file, json!({"teams": 3, "dimension": 4})));
    assert_eq!(three.divided.labels, [0, 0, 0, 1, 1, 1]);
    assert!(three.warnings[0].contains("only 2"), "{:?}", three.warnings);
}

#[test]
fn robots_without_an_embedding_are_named_and_share_a_label() {
    let file = with(
        plain(8, &cliques(&[3, 3]), 0.1),
        json!({"dimension": 4, "rows": "unit", "scale": "sqrt-sigma", "teams": 3}),
    );
    let solution = solved(&file);
    assert_eq!(solution.divided.labels, [0, 0, 0, 1, 1, 1, 2, 2]);
    assert_eq!(solution.without_embedding, [false, false, false, false, false, false, true, true]);
    assert!(solution.warnings[0].contains("r6, r7"), "{:?}", solution.warnings);
    assert_near(
        solution.divided.silhouette.unwrap().details.per_point[7],
        1.0,
        "of two equal rows",
    );

    let nothing = solved(&with(plain(3, &[], 0.5), json!({"teams": 2})));
    assert_eq!(nothing.divided.labels, [0, 0, 0]);
    assert!(nothing.divided.silhouette.is_none());
    assert_eq!(nothing.warnings.len(), 2);
}

#[test]
fn one_robot_is_one_team() {
    let alone = solved(&json!({"robots": ["r1"], "teams": 1,
        "modalities": [{"name": "m", "matrix": [[0.0]]}]}));
    assert_eq!((alone.divided.labels.as_slice(), alone.divided.inertia), ([0].as_slice(), 0.0));
    let of_itself = solved(&json!({"robots": ["r1"], "teams": 1, "emit": ["katz"], "alpha": 0.25,
        "modalities": [{"name": "m", "matrix": [[2.0]]}], "normalize": "none"}));
    assert_near(of_itself.radius.value, 2.0, "ρ");
    assert_katz(&of_itself, |_, _| 1.0);
}

//! Both paths to the singular vectors, which of them is taken, and how silhouettes are computed.

use muster_numeric::silhouette::Method;
use serde_json::{Value, json};

use super::hostile::Dice;
use super::*;
use crate::options::{PathChoice, SilhouetteChoice};
use crate::output;
use crate::path::{DENSE_ROBOTS, MAX_DENSE_ROBOTS};
use muster_method::decomposition::Path;

fn by(path: PathChoice) -> Options {
    Options { path, ..Options::default() }
}

/// Some edges of some weights among so many robots, which fall into groups.
fn groups(robots: usize, dice: &mut Dice) -> Vec<(usize, usize, f64)> {
    let mut edges = std::collections::BTreeMap::new();
    for i in 0..robots {
        for _ in 0..6 {
            let group = i % 5;
            let j = if dice.below(20) == 0 {
                dice.below(robots)
            } else {
                5 * dice.below(robots / 5) + group
            };
            if i != j && j < robots {
                edges.insert((i, j), (1 + dice.below(1000)) as f64 / 1000.0);
            }
        }
    }
    edges.into_iter().map(|((i, j), weight)| (i, j, weight)).collect()
}

fn file(robots: usize, edges: &[(usize, usize, f64)]) -> Value {
    let edges: Vec<_> =
        edges.iter().map(|(i, j, w)| json!([format!("r{i}"), format!("r{j}"), w])).collect();
    json!({"robots": names(robots), "modalities": [{"name": "m", "edges": edges}], "teams": 5,
           "restarts": 10})
}

/// The largest difference between entries of U Uᵀ or V Vᵀ.
fn projectors_apart(left: &Solution, right: &Solution) -> f64 {
    let [l, r] = [left, right].map(|solution| &solution.decomposition.svd);
    let mut worst = 0.0_f64;
    for (l, r) in [(&l.u, &r.u), (&l.v, &r.v)] {
        let dot = |m: &DenseMatrix, i: usize, j: usize| {
            m.row(i).iter().zip(m.row(j)).map(|(x, y)| x * y).sum::<f64>()
        };
        for i in 0..l.rows() {
            for j in 0..l.rows() {
                worst = worst.max((dot(l, i, j) - dot(r, i, j)).abs());
            }
        }
    }
    worst
}

#[test]
fn both_paths_lead_to_the_same_division() {
    let mut dice = Dice(5);
    for robots in [30, 90, 200] {
        let edges = groups(robots, &mut dice);
        for changes in [
            json!({}),
            json!({"dimension": 8, "alpha": {"fraction": 0.9}}),
            json!({"normalize": "none", "scale": "none", "rows": "none"}),
            json!({"teams": null, "labels": (0..robots).map(|i| i % 3).collect::<Vec<_>>()}),
        ] {
            let text = with(file(robots, &edges), changes).to_string();
            let (_, dense) = solve_with(&text, by(PathChoice::Dense)).unwrap();
            let (_, free) = solve_with(&text, by(PathChoice::InverseFree)).unwrap();
            assert_eq!(free.decomposition.path, Path::InverseFree);
            let [left, right] = [&dense, &free].map(|found| &found.decomposition);
            assert_eq!(left.svd.rank(), right.svd.rank());
            for (l, r) in left.svd.sigma.iter().zip(&right.svd.sigma) {
                assert!((l - r).abs() <= 1e-12 * left.svd.sigma[0], "{l} {r}");
            }
            assert!((left.svd.gap() - right.svd.gap()).abs() < 1e-9);
            let most = (1.0 + right.svd.sigma[0]) * Options::default().tolerance;
            assert!(
                right.converged && free.decomposition.residual <= most,
                "{}",
                free.decomposition.residual
            );
            let (apart, bound) = (projectors_apart(&dense, &free), free.angle_bound());
            assert!(apart <= 2e-7 && apart <= bound + dense.angle_bound(), "{apart:e} {bound:e}");
            assert_eq!(dense.divided.labels, free.divided.labels);
            let silhouettes =
                [&dense, &free].map(|found| found.divided.silhouette.as_ref().unwrap());
            assert!((silhouettes[0].mean - silhouettes[1].mean).abs() < 1e-6);
        }
    }
}

#[test]
fn the_residual_that_is_asked_for_is_kept() {
    let mut dice = Dice(6);
    let text = file(150, &groups(150, &mut dice)).to_string();
    let mut rank = None;
    for tolerance in [1e-3, 1e-6, 1e-9] {
        let options = Options { tolerance, ..by(PathChoice::InverseFree) };
        let (problem, found) = solve_with(&text, options).unwrap();
        let residual = found.decomposition.residual;
        let most = (1.0 + found.decomposition.svd.sigma[0]) * tolerance;
        assert!(found.decomposition.converged && residual <= most, "{residual:e}");
        // The same bound holds for the similarity itself.
        let (_, dense) = solve_with(
            &with(file_of(&text), json!({"emit": ["katz"]})).to_string(),
            Options::default(),
        )
        .unwrap();
        let katz = dense.decomposition.similarity.unwrap();
        let measured = found.decomposition.svd.residual(&katz).unwrap();
        assert!(measured <= residual * (1.0 + 1e-6) + 1e-13, "{measured:e} {residual:e}");
        assert_eq!(*rank.get_or_insert(found.embedding.cols()), found.embedding.cols());
        let summary = output::summary(&problem, &found);
        assert!(summary.contains("path              inverse-free: "), "{summary}");
        let json: Value =
            serde_json::from_str(&output::to_json(&problem, &found).unwrap()).unwrap();
        assert_eq!(json["decomposition"]["path"], "inverse-free");
        assert_eq!(json["decomposition"]["residual"].as_f64(), Some(residual));
    }
}

fn file_of(text: &str) -> Value {
    serde_json::from_str(text).unwrap()
}

/// Which path is taken for a fleet of a chain and these changes.
fn chosen_path(robots: usize, changes: Value, choice: PathChoice) -> Result<Path, String> {
    let edges: Vec<_> = (1..robots).map(|i| (i - 1, i, 1.0)).collect();
    let text = with(file(robots, &edges), changes).to_string();
    let problem = parse(text.as_bytes(), by(choice)).unwrap();
    path_of(&problem, choice).map_err(|error| error.to_string())
}

#[test]
fn the_path_follows_from_the_size_and_from_what_is_wanted() {
    use PathChoice::{Auto, Dense, InverseFree};
    let katz = || json!({"emit": ["katz"]});
    assert_eq!(chosen_path(DENSE_ROBOTS, json!({}), Auto), Ok(Path::Dense));
    assert_eq!(chosen_path(DENSE_ROBOTS + 1, json!({}), Auto), Ok(Path::InverseFree));
    assert_eq!(chosen_path(DENSE_ROBOTS + 1, json!({}), Dense), Ok(Path::Dense));
    assert_eq!(chosen_path(40, json!({}), InverseFree), Ok(Path::InverseFree));
    // Most triplets are no leading ones.
    let many = json!({"dimension": 1600});
    assert_eq!(chosen_path(DENSE_ROBOTS + 1, many, Auto), Ok(Path::Dense));
    // The similarity is wanted.
    assert_eq!(chosen_path(DENSE_ROBOTS + 1, katz(), Auto), Ok(Path::Dense));
    let error = chosen_path(40, katz(), InverseFree).unwrap_err();
    assert!(error.starts_with("emit: \"katz\" is the similarity itself"), "{error}");
    let error = chosen_path(MAX_DENSE_ROBOTS + 1, katz(), Auto).unwrap_err();
    assert!(error.starts_with("emit: ") && error.contains("16384 at most, not 16385"), "{error}");
    let error = chosen_path(MAX_DENSE_ROBOTS + 1, json!({}), Dense).unwrap_err();
    assert!(error.starts_with("robots: 16385 are too many for the dense path"), "{error}");
}

#[test]
fn degenerate_fleets_are_solved_without_the_similarity() {
    for (file, rank) in [
        (json!({"robots": ["r0"], "teams": 1, "modalities": [{"name": "m", "edges": []}]}), 1),
        (with(plain(3, &[], 0.5), json!({"teams": 2, "emit": [], "dimension": "auto"})), 1),
        (with(plain(8, &cliques(&[3, 3]), 0.1), json!({"emit": [], "dimension": "auto"})), 2),
        (with(plain(2, &[(0, 1)], 0.5), json!({"emit": [], "dimension": 4})), 2),
    ] {
        let (_, found) = solve_with(&file.to_string(), by(PathChoice::InverseFree)).unwrap();
        let (_, dense) = solve(&file.to_string()).unwrap();
        let [found, dense] = [found, dense].map(|solution| solution.decomposition);
        assert_eq!((found.svd.rank(), dense.svd.rank()), (rank, rank), "{file}");
        for (l, r) in found.svd.sigma.iter().zip(&dense.svd.sigma) {
            assert_near(*l, *r, "σ");
        }
        assert_eq!(found.svd.ambiguous(), dense.svd.ambiguous(), "{file}");
    }
}

#[test]
fn silhouettes_are_computed_as_they_are_asked_for() {
    let robots = 2100;
    let edges = groups(robots, &mut Dice(3));
    let labels: Vec<usize> = (0..robots).map(|i| i / 600).collect();
    let text = with(file(robots, &edges), json!({"teams": null, "labels": labels, "dimension": 8}));
    let found = |silhouette| {
        let options = Options { silhouette, tolerance: 0.1, ..by(PathChoice::InverseFree) };
        let (problem, found) = solve_with(&text.to_string(), options).unwrap();
        let json = output::to_json(&problem, &found).unwrap();
        let json: Value = serde_json::from_str(&json).unwrap();
        let summary = output::summary(&problem, &found);
        (found.divided.silhouette.unwrap(), json["silhouette"].clone(), summary)
    };
    let (exact, json, _) = found(SilhouetteChoice::Auto);
    assert_eq!((&json["method"], &json["detail_method"]), (&json!("exact"), &json!("exact")));
    assert_eq!((&json["standard_error"], exact.method), (&json!(0.0), Method::Exact));
    assert_eq!(found(SilhouetteChoice::Exact).0, exact);
    let (squared, json, summary) = found(SilhouetteChoice::Squared);
    assert_eq!((&json["method"], squared.method), (&json!("squared-exact"), Method::SquaredExact));
    assert!(summary.contains("(of squared distances)"), "{summary}");
    let (sampled, json, summary) = found(SilhouetteChoice::Sampled);
    assert_eq!(json["method"], "sampled");
    assert_eq!(json["detail_method"], "squared-exact");
    assert_eq!(json["standard_error"].as_f64(), Some(sampled.standard_error));
    assert_eq!(sampled.details, squared.details);
    assert!((sampled.mean - exact.mean).abs() <= 5.0 * sampled.standard_error);
    assert!(summary.contains(" ± ") && summary.contains("sampled"), "{summary}");
}

#[test]
fn the_order_of_the_robots_does_not_matter() {
    let mut dice = Dice(9);
    let robots = 60;
    let edges = groups(robots, &mut dice);
    let text = file(robots, &edges);
    // The same fleet, its robots listed from the last to the first.
    let mut turned = names(robots);
    turned.reverse();
    let turned = with(text.clone(), json!({"robots": turned}));
    for path in [PathChoice::Dense, PathChoice::InverseFree] {
        let (_, left) = solve_with(&text.to_string(), by(path)).unwrap();
        let (_, right) = solve_with(&turned.to_string(), by(path)).unwrap();
        // The search leaves as much as the angle bound allows.
        let inertia = left.divided.inertia;
        assert!((inertia - right.divided.inertia).abs() <= 1e-6 * inertia);
        for (l, r) in left.decomposition.svd.sigma.iter().zip(&right.decomposition.svd.sigma) {
            assert_near(*l, *r, "σ");
        }
        let [left, right] = [&left, &right].map(|found| &found.divided);
        for i in 0..robots {
            let there = robots - 1 - i;
            for j in 0..robots {
                let together = left.labels[i] == left.labels[j];
                assert_eq!(together, right.labels[there] == right.labels[robots - 1 - j]);
            }
            let of = |divided: &crate::division::Divided, at: usize| {
                divided.silhouette.as_ref().unwrap().details.per_point[at]
            };
            assert!((of(left, i) - of(right, there)).abs() < 1e-6);
        }
    }
}

#[test]
fn a_weight_of_one_for_one_graph_is_that_graph_alone() {
    let mut dice = Dice(11);
    let [one, other] = [0, 1].map(|_| groups(40, &mut dice));
    let entry = |name: &str, weight: f64, edges: &[(usize, usize, f64)]| {
        let mut entry = file(40, edges)["modalities"][0].clone();
        entry["name"] = json!(name);
        entry["weight"] = json!(weight);
        entry
    };
    let alone = with(file(40, &one), json!({"modalities": [entry("a", 1.0, &one)]}));
    let both = json!({"modalities": [entry("b", 0.0, &other), entry("a", 1.0, &one)]});
    let both = with(file(40, &one), both);
    for path in [PathChoice::Dense, PathChoice::InverseFree] {
        let (_, alone) = solve_with(&alone.to_string(), by(path)).unwrap();
        let (_, both) = solve_with(&both.to_string(), by(path)).unwrap();
        assert_eq!(alone.embedding, both.embedding, "bit by bit");
        assert_eq!(alone.divided.labels, both.divided.labels);
    }
}

#[test]
fn threads_do_not_change_a_division() {
    // Enough work for all cores, against one start after the other.
    let mut dice = Dice(13);
    let text = with(file(300, &groups(300, &mut dice)), json!({"restarts": 200})).to_string();
    let (problem, shared) = solve(&text).unwrap();
    let crate::problem::Division::Wanted(settings) = &problem.division else { panic!("teams") };
    let options = muster_numeric::kmeans::KMeansOptions {
        restarts: 200,
        max_iterations: settings.max_iterations as usize,
        seed: settings.seed,
        ..muster_numeric::kmeans::KMeansOptions::new(5)
    };
    let alone = muster_numeric::kmeans::kmeans(&shared.embedding, &options).unwrap();
    assert_eq!((alone.labels, alone.inertia), (shared.divided.labels, shared.divided.inertia));
}

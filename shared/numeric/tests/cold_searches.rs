//! Searches that begin with nothing, against the whole decomposition: what the symmetric part of a graph
//! shows, and what it does not.
use crate::common::*;
use muster_numeric::katz::katz_similarity;
use muster_numeric::katz_svd::{KatzSvd, KatzSvdOptions};
use muster_numeric::matrix::SparseMatrix;
use muster_numeric::spectral_radius::{SpectralRadius, spectral_radius};
use muster_numeric::svd::full_svd;

const NODES: usize = 1000;

const RANK: usize = 12;

fn options(threads: usize) -> KatzSvdOptions {
    KatzSvdOptions { exact: None, rank: RANK, tolerance: 1e-7, seed: 3, threads }
}

/// Squads of ten with links both ways, which become weaker from the first to the last, in a ring.
fn squads(n: usize) -> Vec<(usize, usize, f64)> {
    let mut random = numbers(n as u64);
    let mut edges = Vec::new();
    for i in 0..n {
        let first = i / 10 * 10;
        let strength = 1.0 - 0.8 * first as f64 / n as f64;
        for j in (first..first + 10).filter(|j| *j > i) {
            let weight = strength * (0.8 + 0.4 * random());
            edges.extend([(i, j, weight), (j, i, weight)]);
        }
        let next = (i + 10) % n;
        edges.extend([(i, next, 0.05), (next, i, 0.05)]);
    }
    edges
}

/// The values of a search with αρ = `fraction` must be those of S as a whole.
fn check(a: &SparseMatrix, fraction: f64, name: &str) {
    let radius = spectral_radius(a, None);
    let alpha = fraction / radius.upper;
    let all = full_svd(&katz_similarity(a, alpha, &radius).unwrap()).unwrap();
    let wanted = all.singular_values();
    let mut search = KatzSvd::default();
    let report = search.solve(a, alpha, &radius, options(1), None).unwrap();
    assert!(report.converged && report.complete, "{name} {fraction}: {report:?}");
    for (found, wanted) in search.all_singular_values().iter().zip(wanted).take(RANK) {
        let off = (found - wanted).abs();
        assert!(off < 1e-10 * all.singular_values()[0], "{name} {fraction}: {found} {wanted}");
    }
}

#[test]
fn links_both_ways_and_a_chain_of_command() {
    for fraction in [0.5, 0.9] {
        let mut edges = squads(NODES);
        check(&graph(NODES, &edges), fraction, "undirected");
        edges.extend((1..NODES).map(|i| ((i - 1) / 8, i, 0.5)));
        check(&graph(NODES, &edges), fraction, "with commands");
    }
}

#[test]
fn few_robots_with_links_both_ways_take_few_rounds() {
    for n in [130, 200, 500] {
        let a = graph(n, &squads(n));
        for fraction in [0.5, 0.9] {
            check(&a, fraction, "few");
            let radius = spectral_radius(&a, None);
            let mut search = KatzSvd::default();
            let alpha = fraction / radius.upper;
            let report = search.solve(&a, alpha, &radius, options(1), None).unwrap();
            assert!(report.rounds <= 5, "{n} {fraction}: {report:?}");
        }
    }
}

#[test]
fn what_the_symmetric_part_does_not_show_is_not_missed() {
    // The weakest squads, whose robots are at the end, also hear what others say without an answer.
    for fraction in [0.9] {
        for strength in [0.5, 4.0] {
            let mut hub = squads(NODES);
            hub.extend((NODES - 40..NODES).map(|i| (NODES - 50, i, strength)));
            check(&graph(NODES, &hub), fraction, "hub");
            let mut chain = squads(NODES);
            chain.extend((NODES - 40..NODES).map(|i| (i - 1, i, 3.0 * strength)));
            check(&graph(NODES, &chain), fraction, "chain");
            let mut source = squads(NODES);
            source.extend((NODES - 40..NODES).map(|i| (i, NODES - 50, strength)));
            check(&graph(NODES, &source), fraction, "source");
        }
    }
}

#[test]
fn negative_eigenvalues_count_as_well() {
    // Complete bipartite groups have eigenvalues of both signs; one group has strong self-links.
    let mut edges = Vec::new();
    for group in 0..NODES / 20 {
        let strength = 1.0 - 0.015 * group as f64;
        for (i, j) in (0..10).flat_map(|i| (10..20).map(move |j| (20 * group + i, 20 * group + j)))
        {
            let weight = strength * (1.0 + 0.01 * ((i * 7 + j * 3) % 11) as f64);
            edges.extend([(i, j, weight), (j, i, weight)]);
        }
    }
    for fraction in [0.1, 0.9] {
        check(&graph(NODES, &edges), fraction, "bipartite");
    }
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let n = 4000;
    let mut edges = squads(n);
    edges.extend((1..n).map(|i| ((i - 1) / 8, i, 0.3)));
    let a = graph(n, &edges);
    let radius = spectral_radius(&a, None);
    let radius = SpectralRadius { upper: 1.1 * radius.upper, ..radius };
    let alpha = 0.7 / radius.upper;
    let solve = |threads| {
        let mut search = KatzSvd::default();
        search.solve(&a, alpha, &radius, options(threads), None).unwrap();
        search.truncate(RANK).unwrap()
    };
    let (one, three) = (solve(1), solve(3));
    assert!(one.sigma.iter().zip(&three.sigma).all(|(l, r)| l.to_bits() == r.to_bits()));
    assert!(one.v.data().iter().zip(three.v.data()).all(|(l, r)| l.to_bits() == r.to_bits()));
}

//! Fleets as `muster graph --json` prints them.

use muster_model::id::Modality;
use muster_model::settings::{
    CentroidStart, ClustererSettings, Dimension, EmbedderSettings, Normalization, TeamCount,
    Trusted,
};
use serde_json::json;

use super::*;
use crate::options::Preset;
use crate::problem::Division;

fn line(modality: &str, edges: &[(&str, &str, f64)]) -> String {
    let mut robots: Vec<&str> = edges.iter().flat_map(|(from, to, _)| [*from, *to]).collect();
    robots.push("r9");
    json!({"fleet": "f", "term": 1, "epoch": 3, "data_age_s": null, "stages": [],
           "modality": modality, "robots": robots, "edges": edges})
    .to_string()
}

/// Two pairs of robots, and r9 without an edge.
fn two_pairs() -> String {
    line("spatial", &[("r2", "r1", 1.0), ("r1", "r2", 1.0), ("r4", "r3", 0.9), ("r3", "r4", 0.9)])
}

#[test]
fn lines_of_graphs_are_a_fleet_with_the_default_settings() {
    let text = format!("{}\n{}\n", two_pairs(), line("hierarchy", &[("r1", "r2", 2.0)]));
    let (problem, _) = solve(&text).unwrap();
    let robots: Vec<&str> = problem.robots.iter().map(|robot| robot.as_str()).collect();
    assert_eq!(robots, ["r1", "r2", "r3", "r4", "r9"]);
    let [hierarchy, spatial] = [&problem.graphs[0], &problem.graphs[1]];
    let back: Vec<_> = hierarchy.matrix.triplets().collect();
    assert_eq!(back, [(0, 1, 2.0), (1, 0, 1.0)], "half as much back, as in the live fleet");
    // Two of five robots, four fifths of what counts as a whole modality.
    let weight = 0.6 * 0.8;
    assert_near(hierarchy.weight, weight / (weight + 0.35), "weight");
    assert_near(spatial.weight, 0.35 / (weight + 0.35), "weight");
    let two = Options { teams: Some(2.into()), ..Options::default() };
    let (_, solution) = solve_with(&two_pairs(), two).unwrap();
    assert_eq!(solution.divided.labels, [0, 0, 1, 1, 2]);
    assert_eq!(solution.divided.unassigned, Some(2));
}

#[test]
fn settings_of_the_services_may_stand_among_the_graphs() {
    let embedder = EmbedderSettings {
        dimension: Dimension::Fixed(2),
        self_loops: 2.0,
        trusted: Trusted::Only([Modality::spatial()].into()),
        ..EmbedderSettings::default()
    };
    let clusterer = ClustererSettings { teams: 1.into(), ..ClustererSettings::default() };
    let settings = [json!(embedder).to_string(), json!(clusterer).to_string()];
    let [embedder, clusterer] = &settings;
    for text in [
        [embedder, &two_pairs(), clusterer].map(String::as_str).join("\n"),
        [clusterer, embedder, &two_pairs()].map(String::as_str).concat(),
    ] {
        let (problem, solution) = solve(&text).unwrap();
        assert_eq!(problem.settings.self_loops, 2.0);
        assert_eq!(problem.settings.trusted, Trusted::Only([Modality::spatial()].into()));
        assert_eq!(solution.embedding.cols(), 2);
        let teams = solution.divided.labels.iter().max().unwrap() + 1;
        assert_eq!(teams - usize::from(solution.divided.unassigned.is_some()), 1);
    }
}

#[test]
fn the_preset_replaces_the_settings_of_a_saved_fleet_but_for_teams_and_seed() {
    let clusterer =
        ClustererSettings { teams: TeamCount::Fixed(1), seed: 7, ..ClustererSettings::default() };
    let lines = [json!(EmbedderSettings::default()), json!(clusterer)].map(|line| line.to_string());
    let hierarchy = line("hierarchy", &[("r1", "r2", 2.0)]);
    let text = [lines.concat(), two_pairs(), hierarchy].concat();
    let options = Options { preset: Some(Preset::Paper), ..Options::default() };
    let (problem, _) = solve_with(&text, options).unwrap();
    let settings = &problem.settings;
    assert_eq!((settings.normalize, settings.self_loops), (Normalization::None, 0.0));
    let [hierarchy, spatial] = [&problem.graphs[0], &problem.graphs[1]];
    assert_eq!((hierarchy.weight, spatial.weight), (0.5, 0.5));
    assert_eq!(hierarchy.matrix.triplets().collect::<Vec<_>>(), [(0, 1, 2.0)], "nothing back");
    let Division::Wanted(settings) = &problem.division else { panic!("teams") };
    assert_eq!((settings.init, settings.restarts), (CentroidStart::Random, 1));
    assert_eq!((settings.teams, settings.seed), (TeamCount::Fixed(1), 7));
}

#[test]
fn each_wrong_line_is_named() {
    let pairs = two_pairs();
    let wrong = [
        (format!("{pairs}{{}}"), "[1]: is no graph of `muster graph --json`"),
        (format!("{pairs}["), "[1]: "),
        (format!("{pairs}{}", pairs.replace("\"f\"", "\"g\"")), "[1].fleet: g is another fleet"),
        (pairs.replace("1.0", "-1.0"), "spatial.edges["),
        (pairs.replace("\"r4\",\"r3\"", "\"r4\",\"R3\""), "[0].edges["),
        (pairs.replace("\"robots\"", "\"robot\""), "[0]: missing field `robots`"),
        (json!(ClustererSettings::default()).to_string(), "modality: "),
        (format!("{pairs}{}", json!({"heartbeat_s": 1.0})), "[1]: missing field"),
    ];
    for (text, start) in wrong {
        let message = refused(&text);
        assert!(message.starts_with(start), "{start:?} but {message}");
    }
    let settings = ClustererSettings { restarts: 0, ..ClustererSettings::default() };
    let message = refused(&format!("{pairs}\n{}", json!(settings)));
    assert!(message.starts_with("[1].restarts: "), "{message}");
}

//! The results: one JSON object, or a summary to read.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::{BufWriter, Write};

use comfy_table::presets::UTF8_BORDERS_ONLY;
use comfy_table::{Cell, CellAlignment, ContentArrangement, Table};
use muster_method::decomposition::Path;
use muster_model::audit::SilhouetteMethod;
use muster_model::id::{Modality, RobotId, TeamId};
use muster_model::settings::{Alpha, Dimension};
use muster_model::teams::{Limited, SkillPrices, TeamCountScore, TeamNeed};
use muster_numeric::matrix::DenseMatrix;
use muster_numeric::silhouette::Scores;
use serde::ser::SerializeMap;
use serde::{Serialize, Serializer};

use super::division::{Divided, wanted_teams};
use super::file::Emit;
use super::limited::{WishOutcome, Within};
use super::method::{Solution, is_doubted};
use super::path::description;
use super::problem::{Division, Problem};

/// Columns of the table; the standard output may be no terminal.
const WIDTH: u16 = 100;

/// Singular values that the summary shows.
const MOST_VALUES: usize = 8;

/// Members of a team that the summary names.
const MOST_MEMBERS: usize = 256;

/// The results as JSON.
#[derive(Serialize)]
struct Report<'a> {
    robots: &'a [RobotId],
    self_loops: f64,
    modalities: Vec<ModalityReport<'a>>,
    rho: f64,
    alpha: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    katz: Option<Matrix<'a>>,
    singular_values: &'a [f64],
    decomposition: DecompositionReport,
    #[serde(skip_serializing_if = "Option::is_none")]
    embedding: Option<Matrix<'a>>,
    labels: &'a [usize],
    teams: Teams<'a>,
    #[serde(flatten)]
    within: Option<WithinReport<'a>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    requested: Option<u32>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    considered: Vec<TeamCountScore>,
    inertia: f64,
    silhouette: SilhouetteReport,
    #[serde(skip_serializing_if = "Option::is_none")]
    diagnostics: Option<DiagnosticsReport<'a>>,
}

/// How the division stands to limits, wishes and needs.
#[derive(Serialize)]
struct WithinReport<'a> {
    optimal: bool,
    gap: f64,
    ids: &'a [Option<TeamId>],
    prices: &'a [Option<f64>],
    skill_prices: &'a [SkillPrices],
    jointly: &'a [RobotId],
    needs: &'a [TeamNeed],
    wishes: &'a [WishOutcome],
    unassigned: &'a [RobotId],
}

impl<'a> WithinReport<'a> {
    fn of(within: &'a Within) -> Self {
        Self {
            optimal: within.limited.optimal,
            gap: within.limited.gap,
            ids: &within.ids,
            prices: &within.prices,
            skill_prices: within.skill_prices(),
            jointly: &within.limited.jointly,
            needs: &within.needs,
            wishes: &within.wishes,
            unassigned: &within.unassigned,
        }
    }
}

/// How much a modality counts.
#[derive(Serialize)]
struct ModalityReport<'a> {
    name: &'a Modality,
    /// With the trust in it.
    weight: f64,
    trust: f64,
    /// None where trust was not examined.
    agreement: Option<f64>,
    in_doubt: bool,
}

/// Which way the similarity was decomposed, and how exactly.
#[derive(Serialize)]
struct DecompositionReport {
    path: Path,
    residual: f64,
    gap: f64,
    angle_bound: f64,
    ambiguous: bool,
    converged: bool,
}

/// Silhouettes; how they were computed is left out where they are not defined.
#[derive(Serialize)]
struct SilhouetteReport {
    mean: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    standard_error: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    method: Option<SilhouetteMethod>,
    per_team: Vec<f64>,
    /// None for a robot without a team.
    per_robot: Vec<Option<f64>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    detail_method: Option<SilhouetteMethod>,
}

#[derive(Serialize)]
struct DiagnosticsReport<'a> {
    spectral_radius: [f64; 2],
    dimension: usize,
    next_singular_value: Option<f64>,
    gap: f64,
    ambiguous: bool,
    residual: f64,
    katz_residual: Option<f64>,
    unseen: Vec<&'a RobotId>,
    /// The robots whose edges agree least, of each modality that has not its whole weight.
    disagreeing: BTreeMap<&'a Modality, &'a [RobotId]>,
}

/// A matrix as an array of its rows.
struct Matrix<'a>(&'a DenseMatrix);

impl Serialize for Matrix<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.0.iter_rows())
    }
}

/// The label of each robot by name, in the order of the file.
struct Teams<'a>(&'a [RobotId], &'a [usize]);

impl Serialize for Teams<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(self.0.len()))?;
        for (robot, label) in self.0.iter().zip(self.1) {
            map.serialize_entry(robot, label)?;
        }
        map.end()
    }
}

/// Writes the results as one JSON object and a line feed to the standard output.
pub(super) fn write_json(problem: &Problem, solution: &Solution) -> std::io::Result<()> {
    let mut out = BufWriter::new(std::io::stdout().lock());
    // Through the io::Error, by which a reader that has gone away is known.
    serde_json::to_writer(&mut out, &report(problem, solution)).map_err(std::io::Error::from)?;
    out.write_all(b"\n")?;
    out.flush()
}

/// Writes why nothing satisfies what is asked of the teams as one JSON object.
pub(super) fn write_conflict(conflict: &str) -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    writeln!(out, "{}", serde_json::json!({ "conflict": conflict }))?;
    out.flush()
}

/// The results as one JSON object.
pub(super) fn to_json(problem: &Problem, solution: &Solution) -> serde_json::Result<String> {
    serde_json::to_string(&report(problem, solution))
}

/// Writes a summary to the standard output.
pub(super) fn write_summary(problem: &Problem, solution: &Solution) -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    out.write_all(summary(problem, solution).as_bytes())?;
    out.flush()
}

/// The results as they are serialised.
fn report<'a>(problem: &'a Problem, solution: &'a Solution) -> Report<'a> {
    let robots = problem.robots.iter().zip(&solution.without_embedding);
    let found = &solution.decomposition;
    let labels = &solution.divided.labels;
    let wants = |emit| problem.emit.contains(&emit);
    let names = || problem.graphs.iter().map(|graph| &graph.name);
    let disagreeing = names().zip(&solution.trust).filter(|(_, trust)| trust.factor < 1.0);
    Report {
        robots: &problem.robots,
        self_loops: problem.settings.self_loops,
        modalities: names()
            .zip(solution.weights.iter().zip(&solution.trust))
            .map(|(name, (weight, trust))| ModalityReport {
                name,
                weight: *weight,
                trust: trust.factor,
                agreement: trust.agreement,
                in_doubt: is_doubted(trust),
            })
            .collect(),
        rho: solution.radius.value,
        alpha: solution.alpha,
        katz: found.similarity.as_ref().filter(|_| wants(Emit::Katz)).map(Matrix),
        singular_values: &found.svd.sigma,
        decomposition: DecompositionReport {
            path: found.path,
            residual: solution.decomposition.residual,
            gap: found.svd.gap(),
            angle_bound: solution.angle_bound(),
            ambiguous: found.svd.ambiguous(),
            converged: found.converged,
        },
        embedding: wants(Emit::Embedding).then_some(Matrix(&solution.embedding)),
        labels,
        teams: Teams(&problem.robots, labels),
        requested: match problem.division {
            Division::Wanted(_) => Some(requested(solution)),
            Division::Given(_) => None,
        },
        within: solution.divided.within.as_ref().map(WithinReport::of),
        considered: considered(problem, solution),
        inertia: solution.divided.inertia,
        silhouette: silhouette_report(&solution.divided),
        diagnostics: wants(Emit::Diagnostics).then(|| DiagnosticsReport {
            spectral_radius: [solution.radius.lower, solution.radius.upper],
            dimension: solution.embedding.cols(),
            next_singular_value: found.svd.sigma_next,
            gap: found.svd.gap(),
            ambiguous: found.svd.ambiguous(),
            residual: solution.decomposition.residual,
            katz_residual: found.probe,
            unseen: robots.filter(|(_, without)| **without).map(|(robot, _)| robot).collect(),
            disagreeing: disagreeing
                .map(|(name, trust)| (name, trust.disagreeing.as_slice()))
                .collect(),
        }),
    }
}

/// The numbers of teams that could be chosen, with the evidence for each.
fn considered(problem: &Problem, solution: &Solution) -> Vec<TeamCountScore> {
    let range = wanted_teams(problem).range();
    let scores = (1..).zip(&solution.decomposition.teams.scores);
    let possible = scores.filter(|(teams, _)| range.contains(teams));
    possible.map(|(teams, score)| TeamCountScore { teams, score: *score }).collect()
}

/// How many teams were chosen, with the best of the numbers that were considered.
fn team_count(problem: &Problem, solution: &Solution) -> String {
    let mut considered = considered(problem, solution);
    let teams = requested(solution);
    if wanted_teams(problem).fixed().is_some() {
        return teams.to_string();
    }
    considered.sort_by(|left, right| right.score.total_cmp(&left.score));
    let best = considered.iter().take(MOST_VALUES);
    let best: Vec<String> = best.map(|one| format!("{} {:.3}", one.teams, one.score)).collect();
    match best.is_empty() {
        true => format!("{teams} (nothing to choose by)"),
        false => format!("{teams} (chosen by modularity; scores: {})", best.join(", ")),
    }
}

/// How many teams were asked for, or chosen.
fn requested(solution: &Solution) -> u32 {
    let within = solution.divided.within.as_ref();
    within.map_or(solution.decomposition.teams.teams, |within| within.requested)
}

fn silhouette_report(divided: &Divided) -> SilhouetteReport {
    let scores = divided.silhouette.as_ref();
    let details = scores.map(|scores| &scores.details);
    let per_cluster = details.map(|details| details.per_cluster.as_slice()).unwrap_or_default();
    SilhouetteReport {
        mean: scores.map(|scores| scores.mean),
        standard_error: scores.map(|scores| scores.standard_error),
        method: scores.map(|scores| scores.method),
        per_team: per_cluster.iter().map(|cluster| cluster.1).collect(),
        per_robot: details.map_or_else(Vec::new, |details| per_robot(divided, &details.per_point)),
        detail_method: details.map(|details| details.method),
    }
}

/// The silhouette of each robot, in the order of the file; under limits only robots with a team have one.
fn per_robot(divided: &Divided, scored: &[f64]) -> Vec<Option<f64>> {
    let left_out = divided.unassigned.filter(|_| divided.within.is_some());
    let mut scored = scored.iter().copied();
    let value = |label: &usize| if left_out == Some(*label) { None } else { scored.next() };
    divided.labels.iter().map(value).collect()
}

/// The results to read.
pub(super) fn summary(problem: &Problem, solution: &Solution) -> String {
    let modalities: Vec<String> = problem
        .graphs
        .iter()
        .zip(&solution.weights)
        .map(|(graph, weight)| format!("{} {}", graph.name, rounded(*weight)))
        .collect();
    let alpha = match problem.settings.alpha {
        Alpha::Value(_) => String::new(),
        Alpha::Fraction { fraction } if solution.radius.upper > 0.0 => {
            format!(" (fraction {fraction} of 1/ρ)")
        }
        Alpha::Fraction { fraction } => format!(" (fraction {fraction}; ρ is 0 without cycles)"),
    };
    let chosen = match problem.settings.dimension {
        Dimension::Auto => " (chosen by the last large drop of the singular values)",
        Dimension::Fixed(_) => "",
    };
    let found = &solution.decomposition;
    let values = found.svd.sigma.iter().take(MOST_VALUES);
    let values: Vec<String> = values.map(|value| rounded(*value)).collect();
    let more = match found.svd.rank().saturating_sub(MOST_VALUES) {
        0 => String::new(),
        more => format!(", {more} more"),
    };
    let next = found
        .svd
        .sigma_next
        .map_or_else(|| "none is left".to_owned(), |next| format!("{} is next", rounded(next)));
    let ambiguous = if found.svd.ambiguous() { ", ambiguous" } else { "" };
    let mean = solution
        .divided
        .silhouette
        .as_ref()
        .map_or_else(|| "undefined for one team".to_owned(), mean_silhouette);
    format!(
        "robots            {robots}\n\
         modalities        {modalities}\n\
         trust             {trust}\n\
         self-loops        {self_loops}\n\
         spectral radius ρ {rho}\n\
         decay α           {decay}{alpha}\n\
         dimension         {dimension}{chosen}\n\
         singular values σ {values}{more}; {next}\n\
         gap               {gap}{ambiguous}\n\
         path              {path}\n\
         residual          {residual:.1e}, space turned by a sine of at most {angle:.1e}\n\
         inertia           {inertia}\n\
         mean silhouette   {mean}\n\
         teams             {teams}\n{limits}\
         {table}\n",
        robots = problem.robots.len(),
        modalities = modalities.join(", "),
        trust = trust(problem, solution),
        self_loops = rounded(problem.settings.self_loops),
        rho = rounded(solution.radius.value),
        decay = rounded(solution.alpha),
        dimension = solution.embedding.cols(),
        values = values.join(", "),
        gap = rounded(found.svd.gap()),
        path = description(found.path),
        residual = solution.decomposition.residual,
        angle = solution.angle_bound(),
        inertia = rounded(solution.divided.inertia),
        teams = team_count(problem, solution),
        limits = limits(solution),
        table = table(problem, solution),
    )
}

/// How the division stands to limits, wishes and needs; empty if nothing is asked.
fn limits(solution: &Solution) -> String {
    let Some(within) = &solution.divided.within else { return String::new() };
    let nearest = match within.limited {
        Limited { optimal: true, .. } => "no other assignment to these teams is nearer".to_owned(),
        Limited { gap, .. } => {
            format!("another assignment could be nearer by {:.2} %", 100.0 * gap)
        }
    };
    let mut text = format!("limits            {nearest}\n");
    let needs: Vec<String> = within
        .needs
        .iter()
        .map(|need| format!("{} {} of {}", need.team, need.skill, need.have))
        .collect();
    if !needs.is_empty() {
        let _ = writeln!(text, "needs             {}", needs.join(", "));
    }
    text
}

/// The trust in each modality and its agreement with the others; one in doubt stands out.
fn trust(problem: &Problem, solution: &Solution) -> String {
    if solution.trust.iter().all(|trust| trust.agreement.is_none()) {
        return "1 for all, which were not compared".to_owned();
    }
    let all = problem.graphs.iter().zip(&solution.trust).map(|(graph, trust)| {
        let agreement = trust.agreement.map_or_else(|| "none".to_owned(), |a| format!("{a:.2}"));
        let doubt = if is_doubted(trust) { " IN DOUBT" } else { "" };
        format!("{} {:.2}{doubt} (agreement {agreement})", graph.name, trust.factor)
    });
    all.collect::<Vec<_>>().join(", ")
}

/// The mean, and how it was come by where it is not the exact one.
fn mean_silhouette(scores: &Scores) -> String {
    let mean = rounded(scores.mean);
    match scores.method {
        SilhouetteMethod::Exact => mean,
        SilhouetteMethod::SquaredExact => format!("{mean} (of squared distances)"),
        SilhouetteMethod::Sampled => format!(
            "{mean} ± {} (sampled; those of the teams are of squared distances)",
            rounded(scores.standard_error)
        ),
    }
}

fn table(problem: &Problem, solution: &Solution) -> Table {
    let mut teams: BTreeMap<usize, Vec<&str>> = BTreeMap::new();
    for (robot, label) in problem.robots.iter().zip(&solution.divided.labels) {
        teams.entry(*label).or_default().push(robot.as_str());
    }
    let silhouettes: BTreeMap<usize, f64> = solution
        .divided
        .silhouette
        .iter()
        .flat_map(|scores| scores.details.per_cluster.iter().copied())
        .collect();
    let unassigned = solution.divided.unassigned;
    let ids = solution.divided.within.as_ref().map(|within| &within.ids);
    let label = match problem.division {
        Division::Wanted(_) => "team",
        Division::Given(_) => "label",
    };
    let mut table = Table::new();
    table.load_style(UTF8_BORDERS_ONLY);
    table.set_content_arrangement(ContentArrangement::Dynamic).set_width(WIDTH);
    table.set_header([label, "robots", "silhouette", "members"]);
    for (label, members) in teams {
        let silhouette =
            silhouettes.get(&label).map_or_else(|| "-".to_owned(), |s| format!("{s:.3}"));
        let right = |text: String| Cell::new(text).set_alignment(CellAlignment::Right);
        table.add_row([
            right(match ids.map(|ids| ids.get(label).cloned().flatten()) {
                _ if unassigned == Some(label) => "-".to_owned(),
                Some(Some(id)) => format!("{id} ({label})"),
                _ => label.to_string(),
            }),
            right(members.len().to_string()),
            right(silhouette),
            Cell::new(named(&members)),
        ]);
    }
    table
}

/// The first members, and how many more there are.
fn named(members: &[&str]) -> String {
    let (first, more) = members.split_at(members.len().min(MOST_MEMBERS));
    match more.len() {
        0 => first.join(" "),
        more => format!("{} and {more} more", first.join(" ")),
    }
}

/// Six significant digits, which is what a person reads.
pub(super) fn rounded(value: f64) -> String {
    if value == 0.0 || (1e-3..1e6).contains(&value.abs()) {
        let digits = 5 - value.abs().max(1e-3).log10().floor().clamp(-3.0, 5.0) as i32;
        let text = format!("{value:.*}", usize::try_from(digits).unwrap_or(0));
        if text.contains('.') {
            return text.trim_end_matches('0').trim_end_matches('.').to_owned();
        }
        return text;
    }
    format!("{value:.3e}")
}

//! The teams of a problem under limits, wishes and needs, by the code of the live division.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use muster_division::division::{self, Job, Staying};
use muster_division::memory::Memory;
use muster_division::needs::Needs;
use muster_division::number::Situation;
use muster_division::rules::{Asked, TeamRules};
use muster_division::seats::Arrivals;
use muster_division::wishes::Assessment;
use muster_method::embedding::Embedded;
use muster_model::content::Checked;
use muster_model::embedding::{Embedding, EmbeddingMode, EmbeddingQuality};
use muster_model::header::{Header, Revision};
use muster_model::id::{FleetId, RobotId, TeamId};
use muster_model::roster::{Roster, RosterEntry};
use muster_model::settings::ClustererSettings;
use muster_model::teams::{Limited, SkillPrices, TeamNeed, Teams};
use muster_model::time::Tick;
use muster_model::wish::{WishKind, WishState};
use serde::Serialize;

use super::error::{SolveError, refuse};
use super::problem::Problem;

/// The moment of a solve; nothing of it rests on time.
const MOMENT: Tick = Tick(0);

/// What keeps the robots of a locked team from staying in it.
const NO_LAST_DIVISION: &str = "a last division, which a saved fleet does not have";

/// A division that respects what is asked of it.
#[derive(Debug)]
pub(super) struct Within {
    /// How many teams were asked for, or chosen.
    pub(super) requested: u32,
    /// The label of each robot, in the order of the file, by first appearance.
    pub(super) labels: Vec<usize>,
    /// The id of the team of each label; none for the label of the robots without a team.
    pub(super) ids: Vec<Option<TeamId>>,
    /// What a place in the team of each label costs; none for robots without a team.
    pub(super) prices: Vec<Option<f64>>,
    /// How it stands to the limits; its prices are those of `teams`.
    pub(super) limited: Limited,
    /// The inertia of the robots that have a team.
    pub(super) inertia: f64,
    /// What the teams need and have.
    pub(super) needs: Vec<TeamNeed>,
    /// What has become of each wish.
    pub(super) wishes: Vec<WishOutcome>,
    /// Robots in no team, ordered by name.
    pub(super) unassigned: Vec<RobotId>,
}

/// What has become of a wish.
#[derive(Debug, Serialize)]
pub(super) struct WishOutcome {
    /// Its name: that of its operator and id, or its kind and its names.
    wish: String,
    state: WishState,
    /// What it waits for.
    #[serde(skip_serializing_if = "Option::is_none")]
    reason: Option<String>,
}

impl WishOutcome {
    /// What a reader should know of a wish that is not granted.
    pub(super) fn warning(&self) -> Option<String> {
        let reason = self.reason.as_ref()?;
        Some(format!("wish {} counts for nothing: {reason}", self.wish))
    }
}

impl Within {
    /// What a place costs robots with a needed skill besides, in the order of the labels.
    pub(super) fn skill_prices(&self) -> &[SkillPrices] {
        &self.limited.skill_prices
    }
}

/// Divides the robots of a problem as a live fleet without a last division would be.
///
/// # Errors
/// [`SolveError::Conflict`] if nothing satisfies what is asked.
pub(super) fn divide(
    problem: &Problem,
    settings: &ClustererSettings,
    embedded: &Embedded,
    rules: TeamRules,
) -> Result<Within, SolveError> {
    let order = by_name(&problem.robots);
    let embedding = embedding(problem, embedded, &order)?;
    let memory = Memory::default();
    let mut situation = Situation {
        now: MOMENT,
        division: None,
        divided_into: None,
        memory: &memory,
        arrivals: Arrivals::default(),
        embedding: &embedding,
    };
    if let Some(conflict) = situation.conflict(settings.teams, &rules) {
        return Err(SolveError::Conflict(conflict));
    }
    let number = situation.evidence(settings.teams, Some(&rules)).best();
    let job = Job {
        embedding: Checked::new_unchecked(embedding.clone()),
        settings: settings.clone(),
        rules: Some(Arc::new(rules.resolved(None, &memory, &embedding))),
        teams: number,
        requested: number.max(*settings.teams.range().start()),
        same_number: false,
        staying: Staying::None,
        renewed: BTreeSet::new(),
        previous: None,
        memory: Arc::new(memory.clone()),
    };
    let mut teams = division::divide(&job).or_else(|error| refuse("teams", error.to_string()))?;
    let limited = teams.limited.take().unwrap_or_else(Limited::open);
    if let Some(conflict) = &limited.conflict {
        // The search ended before it found anything.
        return Err(SolveError::Conflict(conflict.clone()));
    }
    let needs = needs(problem, settings)?.published(&teams);
    let assessment = Assessment::of(&teams, &embedding);
    let outcome = |asked: &Asked| {
        let (state, reason) = match asked.wish.kind {
            WishKind::Lock => (WishState::Waiting, Some(NO_LAST_DIVISION.to_owned())),
            _ => assessment.state(&asked.wish),
        };
        WishOutcome { wish: asked.name.clone(), state, reason }
    };
    let wishes = problem.asks.wishes.iter().map(outcome).collect();
    Ok(labelled(problem, teams, limited, needs, wishes))
}

/// What is asked of the teams of a problem; none if nothing is.
///
/// # Errors
/// Never for a checked problem.
pub(super) fn rules(
    problem: &Problem,
    settings: &ClustererSettings,
) -> Result<Option<TeamRules>, SolveError> {
    Ok(TeamRules::of(settings, problem.asks.wishes.clone(), needs(problem, settings)?))
}

fn needs(problem: &Problem, settings: &ClustererSettings) -> Result<Needs, SolveError> {
    if settings.needs.is_empty() {
        return Ok(Needs::default());
    }
    Ok(Needs::of(settings, Some(&roster(problem)?), None))
}

/// The robots with their skills.
fn roster(problem: &Problem) -> Result<Roster, SolveError> {
    let entry = |(robot, node): (&RobotId, u32)| RosterEntry {
        skills: problem.asks.skills.get(robot).cloned().unwrap_or_default(),
        ..RosterEntry::active(node, robot.clone(), MOMENT)
    };
    let robots = problem.robots.iter().zip(0..).map(entry).collect();
    Ok(Roster { header: header()?, robots, graphs: Vec::new() })
}

/// The places of the robots, ordered by name.
fn by_name(robots: &[RobotId]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..robots.len()).collect();
    order.sort_by_key(|place| &robots[*place]);
    order
}

/// Nothing of a division rests on it.
fn header() -> Result<Header, SolveError> {
    Ok(Header {
        fleet: FleetId::new("solve").or_else(|error| refuse("robots", error.to_string()))?,
        revision: Revision::default(),
        oldest: None,
        newest: None,
        stages: Vec::new(),
    })
}

/// The vectors as a live fleet has them: with the robots in the order of their names.
fn embedding(
    problem: &Problem,
    embedded: &Embedded,
    order: &[usize],
) -> Result<Embedding, SolveError> {
    let x = embedded.x.select_rows(order);
    let found = &embedded.decomposition;
    let shown = &found.teams;
    Ok(Embedding {
        header: header()?,
        roster: Revision::default(),
        graphs: Vec::new(),
        robots: order.iter().map(|place| problem.robots[*place].clone()).collect(),
        dimension: u32::try_from(x.cols()).unwrap_or(u32::MAX),
        values: x.into_data(),
        without_embedding: order.iter().map(|place| embedded.without_embedding[*place]).collect(),
        provisional: vec![false; order.len()],
        // Nothing of a division rests on it.
        centrality: Vec::new(),
        quality: EmbeddingQuality {
            spectral_radius: (embedded.decay.radius.lower, embedded.decay.radius.upper),
            alpha: embedded.decay.alpha,
            singular_values: found.svd.sigma.clone(),
            next_singular_value: found.svd.sigma_next.unwrap_or(0.0),
            residual: found.residual,
            katz_residual: 0.0,
            gap: found.svd.gap(),
            ambiguous: found.svd.ambiguous(),
            mode: EmbeddingMode::Dense,
            teams_shown: (!shown.scores.is_empty()).then_some(shown.teams),
            team_scores: shown.scores.clone(),
            stage_us: [0; 3],
        },
    })
}

/// The division by labels in the order of the file.
fn labelled(
    problem: &Problem,
    teams: Teams,
    mut limited: Limited,
    needs: Vec<TeamNeed>,
    wishes: Vec<WishOutcome>,
) -> Within {
    let place_of: BTreeMap<&TeamId, usize> =
        teams.teams.iter().map(|team| &team.id).zip(0..).collect();
    let team_of: BTreeMap<&RobotId, &TeamId> = teams.assignments().collect();
    let (mut numbers, mut ids) = (BTreeMap::new(), Vec::new());
    let mut labels = Vec::with_capacity(problem.robots.len());
    for robot in &problem.robots {
        let team = team_of.get(robot).copied();
        let label = *numbers.entry(team).or_insert_with(|| {
            ids.push(team.cloned());
            ids.len() - 1
        });
        labels.push(label);
    }
    let place = |id: &Option<TeamId>| place_of.get(id.as_ref()?).copied();
    let places: Vec<Option<usize>> = ids.iter().map(place).collect();
    let price = |place: &Option<usize>| limited.prices.get((*place)?).copied();
    let prices = places.iter().map(price).collect();
    for of in &mut limited.skill_prices {
        let price = |place: &Option<usize>| place.and_then(|at| of.prices.get(at)).copied();
        of.prices = places.iter().map(|at| price(at).unwrap_or(0.0)).collect();
    }
    Within {
        requested: teams.requested,
        labels,
        ids,
        prices,
        limited,
        inertia: teams.inertia,
        needs,
        wishes,
        unassigned: teams.unassigned,
    }
}

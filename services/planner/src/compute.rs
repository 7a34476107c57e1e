//! The job: what the fleet would be divided into, and how good that would be.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use muster_division::division::{self, Staying, divide};
use muster_division::identity::moved;
use muster_division::memory::Memory;
use muster_division::needs::Needs;
use muster_division::number::{Asking, Situation};
use muster_division::rules::{Asked, TeamRules, asks_alike};
use muster_division::scores::{positions, silhouettes_of};
use muster_division::seats::Arrivals;
use muster_method::Graph;
use muster_method::embedding::Frames;
use muster_method::params::{EmbeddingParams, Pace};
use muster_model::audit::SilhouetteReport;
use muster_model::content::Checked;
use muster_model::embedding::{Embedding, EmbeddingQuality};
use muster_model::id::{RobotId, ServiceName, TeamId, WishId};
use muster_model::proposal::{
    DivisionQuality, LiveTeam, ProposalRequest, ProposedDivision, ProposedMove, ProposedTeam,
};
use muster_model::settings::{
    ClustererSettings, Dimension, EmbedderSettings, Settings, SettingsError, TeamCount,
};
use muster_model::teams::{TeamChange, Teams};
use muster_model::time::Tick;
use muster_model::wish::{StandingWish, Wish, WishKind};
use muster_service::following::Frame;
use serde_json::{Map, Value};

use crate::proposals::Name;

/// What to do about limits that nothing satisfies.
const REMEDY: &str = "ask with other limits, another number of teams or fewer robots left out";

/// One proposal to compute.
#[derive(Debug)]
pub struct Job {
    pub(crate) name: Name,
    pub(crate) asked: ProposalRequest,
    pub(crate) basis: Basis,
}

/// What a division is made of now.
#[derive(Debug, Clone)]
pub(crate) struct Basis {
    pub(crate) now: Tick,
    /// The newest roster and its graphs.
    pub(crate) frame: Arc<Frame>,
    /// The live vectors.
    pub(crate) embedding: Checked<Embedding>,
    /// The live division.
    pub(crate) teams: Checked<Teams>,
    /// Teams that robots had before.
    pub(crate) memory: Arc<Memory>,
    pub(crate) clusterer: ClustererSettings,
    pub(crate) embedder: EmbedderSettings,
    pub(crate) wishes: Vec<StandingWish>,
}

fn wrong(field: &str, problem: impl ToString) -> SettingsError {
    SettingsError::new(field, problem.to_string())
}

/// Computes a proposal.
///
/// # Errors
/// Names the field of the request that does not work, and what would.
pub(crate) fn propose(job: &Job) -> Result<ProposedDivision, SettingsError> {
    let Job { asked, basis, .. } = job;
    let patch = |service| asked.patch(service);
    let changed = |service| Value::Object(patch(service));
    let clusterer = basis.clusterer.patched(&changed(ServiceName::Clusterer))?;
    let embedder = basis.embedder.patched(&changed(ServiceName::Embedder))?;
    let known = |robot: &&RobotId| basis.frame.robots.binary_search(robot).is_err();
    if let Some(stranger) = asked.without.iter().find(known) {
        return Err(wrong("without", format!("{stranger} is not in the fleet; see muster robots")));
    }
    let rules = rules(job, &clusterer);
    refuse_conflict(job, &clusterer, rules.as_ref())?;

    let of_live = Vectors::of(&basis.embedder, &basis.clusterer);
    let wanted = Vectors::of(&embedder, &clusterer);
    let embedded = of_live != wanted;
    let embedding = if embedded { embed(basis, wanted)? } else { basis.embedding.clone() };
    let is_asked_already = !embedded && asks_as_live(basis, &clusterer, rules.as_ref());
    let proposed = if is_asked_already && has_same_robots(&basis.teams, &embedding) {
        // The clusterer divides nothing again for it.
        Teams::clone(&basis.teams)
    } else {
        divided(basis, &clusterer, rules.as_ref(), &embedding)?
    };

    let live = restricted(&basis.teams, &embedding, &asked.without);
    let roster = &*basis.frame.roster;
    let scored = |teams: &Teams| {
        silhouettes_of(teams, &embedding, &positions(teams, roster))
            .map_err(|error| wrong("(proposal)", error))
    };
    let [new, new_physical] = scored(&proposed)?;
    let [old, old_physical] = scored(&live)?;
    let (better, before) = (quality(&new, &new_physical), quality(&old, &old_physical));
    Ok(ProposedDivision {
        based_on: basis.teams.header.revision,
        replaces: replaced(asked, basis),
        embedded,
        teams: proposed_teams(&proposed, &new),
        unassigned: proposed.unassigned.clone(),
        moves: moves(&proposed, &basis.teams),
        proposed: better,
        live: before,
        change: better.beyond(&before),
        live_teams: live_teams(&live, &old),
        conflict: proposed.limited.as_ref().and_then(|limited| limited.conflict.clone()),
    })
}

/// What the division has to respect, with the robots that are left out kept in reserve.
fn rules(job: &Job, settings: &ClustererSettings) -> Option<TeamRules> {
    let Job { name, asked, basis } = job;
    let own = name.reserve_wish();
    let is_other =
        |one: &&StandingWish| (&one.operator, Some(&one.id)) != (&name.operator, own.as_ref());
    // Accepted, the wish takes the place of the one with its name.
    let others = basis.wishes.iter().filter(|one| asked.without.is_empty() || is_other(one));
    let mut wishes = Asked::of(others);
    if !asked.without.is_empty() {
        let id = own.as_ref().map_or(name.id.as_str(), WishId::as_str);
        let robots = asked.without.clone();
        let kind = WishKind::Reserve;
        let wish = Wish { kind, robots, team: None, expires: None, note: None };
        wishes.push(Asked { name: format!("{}/{id}", name.operator), wish });
    }
    let needs = Needs::of(settings, Some(&basis.frame.roster), Some(&basis.teams));
    TeamRules::of(settings, wishes, needs)
}

/// What divisions have to respect now.
fn live_rules(basis: &Basis) -> Option<TeamRules> {
    let needs = Needs::of(&basis.clusterer, Some(&basis.frame.roster), Some(&basis.teams));
    TeamRules::of(&basis.clusterer, Asked::of(basis.wishes.iter()), needs)
}

/// Whether the live division is asked for the same already.
fn asks_as_live(basis: &Basis, settings: &ClustererSettings, rules: Option<&TeamRules>) -> bool {
    let live = &basis.clusterer;
    let of_live = ClustererSettings {
        dwell_s: live.dwell_s,
        heartbeat_s: live.heartbeat_s,
        ..settings.clone()
    };
    of_live == *live && asks_alike(live_rules(basis).as_ref(), rules)
}

/// Whether a division is of all robots of an embedding, and of no others.
fn has_same_robots(teams: &Teams, embedding: &Embedding) -> bool {
    let mut robots: Vec<&RobotId> = teams.assignments().map(|(robot, _)| robot).collect();
    robots.extend(&teams.unassigned);
    robots.sort_unstable();
    robots.into_iter().eq(&embedding.robots)
}

fn situation<'a>(basis: &'a Basis, embedding: &'a Embedding) -> Situation<'a> {
    Situation {
        now: basis.now,
        division: Some(&basis.teams),
        divided_into: None,
        memory: &basis.memory,
        arrivals: Arrivals::default(),
        embedding,
    }
}

/// Refuses what the clusterer would refuse as well: limits, needs and robots left out that nothing satisfies.
fn refuse_conflict(
    job: &Job,
    settings: &ClustererSettings,
    rules: Option<&TeamRules>,
) -> Result<(), SettingsError> {
    let Job { asked, basis, .. } = job;
    let field = if asked.size.is_some() {
        "size"
    } else if asked.team_size.is_some() {
        "team_size"
    } else if asked.needs.is_some() {
        "needs"
    } else if asked.teams.is_some() {
        "teams"
    } else if !asked.without.is_empty() {
        "without"
    } else {
        return Ok(());
    };
    let Some(rules) = rules else { return Ok(()) };
    let last = live_rules(basis);
    let last = last.as_ref().map(|rules| Asking { teams: basis.clusterer.teams, rules });
    let situation = situation(basis, &basis.embedding);
    match situation.new_conflict(Asking { teams: settings.teams, rules }, last) {
        Some(conflict) => Err(wrong(field, format!("{conflict}; {REMEDY}"))),
        None => Ok(()),
    }
}

/// What vectors depend on beside the graphs.
#[derive(Debug, Clone, PartialEq)]
struct Vectors {
    settings: EmbedderSettings,
    /// How many teams are wanted; none if neither the dimension nor the evidence depends on it.
    teams: Option<TeamCount>,
}

impl Vectors {
    fn of(settings: &EmbedderSettings, clusterer: &ClustererSettings) -> Self {
        let teams = clusterer.teams;
        let is_needed = settings.dimension == Dimension::Auto || teams.fixed().is_none();
        Self { settings: settings.clone(), teams: is_needed.then_some(teams) }
    }
}

/// The vectors of the fleet at rest, as the embedder would find them from those that there are.
fn embed(basis: &Basis, wanted: Vectors) -> Result<Checked<Embedding>, SettingsError> {
    let Basis { frame, embedding: live, .. } = basis;
    let teams = wanted.teams.unwrap_or(TeamCount::Fixed(2));
    let params = EmbeddingParams {
        seed: frame.roster.header.revision.epoch,
        ..EmbeddingParams::new(&wanted.settings, teams, Pace::AtRest)
    };
    let failed = |error: &dyn std::fmt::Display| wrong("weights", error);
    let params = params.check().map_err(|error| failed(&error))?;
    let graphs = frame.graphs.iter();
    let graphs = graphs.map(|(name, graph)| (name.clone(), Graph::Replica(Arc::clone(graph))));
    let input =
        muster_method::Frame { robots: Arc::clone(&frame.robots), graphs: graphs.collect() };
    let mut frames = Frames::default();
    frames.set_teams_shown(live.quality.teams_shown.or_else(|| basis.clusterer.teams.fixed()));
    let found = frames.embed(&input, &params, Some(live), &mut |_| {});
    let found = found.map_err(|error| failed(&error))?;
    let shown = &found.decomposition.teams;
    let quality = EmbeddingQuality {
        teams_shown: (!shown.scores.is_empty()).then_some(shown.teams),
        team_scores: shown.scores.clone(),
        ..live.quality.clone()
    };
    Ok(Checked::new_unchecked(Embedding {
        header: live.header.clone(),
        roster: frame.roster.header.revision,
        graphs: live.graphs.clone(),
        robots: frame.robots.to_vec(),
        dimension: u32::try_from(found.x.cols()).unwrap_or(u32::MAX),
        values: found.x.into_data(),
        without_embedding: found.without_embedding,
        provisional: found.provisional,
        // Nothing of a division rests on it.
        centrality: Vec::new(),
        quality,
    }))
}

/// The division, as the clusterer would make it from the live one: another number of teams counts at once where operators ask.
fn divided(
    basis: &Basis,
    settings: &ClustererSettings,
    rules: Option<&TeamRules>,
    embedding: &Checked<Embedding>,
) -> Result<Teams, SettingsError> {
    let evidence = situation(basis, embedding).evidence(settings.teams, rules);
    let (demand, teams) = (evidence.demand, evidence.best());
    let resolved = |rules: &TeamRules| {
        Arc::new(rules.clone().resolved(Some(&basis.teams), &basis.memory, embedding))
    };
    let job = division::Job {
        embedding: embedding.clone(),
        teams,
        requested: teams.max(*settings.teams.range().start()),
        same_number: demand.current == Some(teams),
        // A proposal is what the fleet would be once it has settled.
        staying: Staying::None,
        renewed: BTreeSet::new(),
        settings: settings.clone(),
        rules: rules.map(resolved),
        previous: Some(basis.teams.clone()),
        memory: Arc::clone(&basis.memory),
    };
    divide(&job).map_err(|error| wrong("(proposal)", error))
}

/// The live division among the robots that both divisions have and that may be in a team.
fn restricted(live: &Teams, embedding: &Embedding, without: &[RobotId]) -> Teams {
    let mut teams = live.clone();
    let is_there = |robot: &RobotId| {
        embedding.robots.binary_search(robot).is_ok() && without.binary_search(robot).is_err()
    };
    for team in &mut teams.teams {
        team.members.retain(|member| is_there(&member.robot));
    }
    teams.teams.retain(|team| !team.members.is_empty());
    teams
}

fn quality(vectors: &SilhouetteReport, physical: &SilhouetteReport) -> DivisionQuality {
    let least = vectors.per_team.iter().map(|(_, mean)| *mean).reduce(f64::min);
    DivisionQuality {
        mean: vectors.mean,
        least_team: least.filter(|_| vectors.mean.is_some()),
        physical_mean: physical.mean,
    }
}

/// The mean and the least silhouette of each team.
fn by_team(
    teams: &Teams,
    report: &SilhouetteReport,
) -> BTreeMap<TeamId, (Option<f64>, Option<f64>)> {
    let mut found: BTreeMap<TeamId, (Option<f64>, Option<f64>)> = BTreeMap::new();
    for (team, mean) in &report.per_team {
        found.entry(team.clone()).or_default().0 = Some(*mean);
    }
    let team_of: BTreeMap<&RobotId, &TeamId> = teams.assignments().collect();
    for (robot, value) in &report.per_robot {
        if let Some(team) = team_of.get(robot) {
            let least = &mut found.entry((*team).clone()).or_default().1;
            *least = Some(least.map_or(*value, |known| known.min(*value)));
        }
    }
    found
}

fn proposed_teams(teams: &Teams, report: &SilhouetteReport) -> Vec<ProposedTeam> {
    let scores = by_team(teams, report);
    let team = |team: &muster_model::teams::Team| {
        let (mean, least) = scores.get(&team.id).copied().unwrap_or_default();
        let members = team.members.iter().map(|member| member.robot.clone()).collect();
        ProposedTeam { id: team.id.clone(), members, mean, least }
    };
    teams.teams.iter().map(team).collect()
}

fn live_teams(teams: &Teams, report: &SilhouetteReport) -> Vec<LiveTeam> {
    let scores = by_team(teams, report);
    let team = |team: &muster_model::teams::Team| {
        let (mean, least) = scores.get(&team.id).copied().unwrap_or_default();
        let robots = u32::try_from(team.members.len()).unwrap_or(u32::MAX);
        LiveTeam { id: team.id.clone(), robots, mean, least }
    };
    teams.teams.iter().map(team).collect()
}

/// Who would be elsewhere.
fn moves(proposed: &Teams, live: &Teams) -> Vec<ProposedMove> {
    let changes = moved(proposed, live).into_iter();
    let changes = changes.filter_map(|change| match change {
        TeamChange::Moved { robot, from, to } => Some(ProposedMove { robot, from, to }),
        _ => None,
    });
    changes.collect()
}

/// The values of the settings that a request changes.
fn replaced(asked: &ProposalRequest, basis: &Basis) -> BTreeMap<ServiceName, Map<String, Value>> {
    let mut replaced = BTreeMap::new();
    for service in ProposalRequest::SERVICES {
        let fields: BTreeSet<String> =
            asked.patch(service).into_iter().map(|(name, _)| name).collect();
        let all = match service {
            ServiceName::Embedder => serde_json::to_value(&basis.embedder),
            _ => serde_json::to_value(&basis.clusterer),
        };
        if let Ok(Value::Object(all)) = all
            && !fields.is_empty()
        {
            let changed = all.into_iter().filter(|(name, _)| fields.contains(name));
            replaced.insert(service, changed.collect());
        }
    }
    replaced
}

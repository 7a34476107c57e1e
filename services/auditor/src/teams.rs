//! What the audit says of each team, and which losses would hurt most.
//!
//! Everything is linear in robots and edges but for look-ups, so that ten thousand robots take a fraction of a
//! second of the job's thread.

use std::collections::{BTreeMap, HashMap};

use muster_division::scores::Positions;
use muster_model::audit::SilhouetteReport;
use muster_model::graph::GraphReplica;
use muster_model::header::Revision;
use muster_model::id::{Modality, RobotId, SkillId};
use muster_model::limits::{MAX_AUDITED_SKILLS, MAX_CUT_ROBOTS, MAX_LOSS_PARTS, MAX_LOSSES};
use muster_model::roster::{Roster, RosterEntry};
use muster_model::team_audit::{
    Conductance, LeastFitting, Loss, Radio, SkillCover, Spread, TeamAudit,
};
use muster_model::teams::{Team, Teams};
use muster_numeric::conductance::conductances;
use muster_numeric::cuts::{Cuts, cuts};

/// The entry of each robot of a roster.
type Entries<'a> = HashMap<&'a RobotId, &'a RosterEntry>;

/// A followed graph, with its modality.
pub(crate) type Graph = (Modality, std::sync::Arc<GraphReplica>);

/// What is said of the teams of one division.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TeamScores {
    /// The roster with whose graphs they were scored; none before the first frame.
    pub graphs: Option<Revision>,
    /// Each team, in the order of the division.
    pub teams: Vec<TeamAudit>,
    /// The losses that would hurt most, the worst first.
    pub losses: Vec<Loss>,
}

/// The members of a division, each with the number of its team.
struct Members<'a>(HashMap<&'a RobotId, usize>);

impl<'a> Members<'a> {
    fn new(teams: &'a Teams) -> Self {
        let members = teams.teams.iter().enumerate().flat_map(|(number, team)| {
            team.members.iter().map(move |member| (&member.robot, number))
        });
        Self(members.collect())
    }

    fn team(&self, robot: &RobotId) -> Option<usize> {
        self.0.get(robot).copied()
    }
}

/// A graph whose nodes are numbered in their order.
struct Numbered<'a> {
    graph: &'a GraphReplica,
    /// The team of each node; none for a robot without one.
    labels: Vec<Option<usize>>,
    names: Vec<&'a RobotId>,
    nodes: Vec<u32>,
}

impl<'a> Numbered<'a> {
    fn new(graph: &'a GraphReplica, members: &Members<'_>) -> Self {
        let nodes = graph.nodes().keys().copied().collect();
        let names: Vec<_> = graph.nodes().values().collect();
        let labels = names.iter().map(|name| members.team(name)).collect();
        Self { graph, labels, names, nodes }
    }

    fn edges(&self) -> impl Iterator<Item = (usize, usize, f64)> {
        // Until robots have left, the nodes of a graph are numbered without gaps.
        let place = |node: &u32| match *node as usize {
            at if self.nodes.get(at) == Some(node) => Some(at),
            _ => self.nodes.binary_search(node).ok(),
        };
        self.graph.rows().iter().flat_map(move |(source, edges)| {
            let from = place(source);
            edges.iter().filter_map(move |(target, weight)| Some((from?, place(target)?, *weight)))
        })
    }
}

/// Scores the teams of a division: by the graphs and the roster that are there, and the silhouettes of its
/// robots.
pub(crate) fn score_teams(
    teams: &Teams,
    roster: Option<&Roster>,
    positions: &Positions,
    graphs: &[Graph],
    silhouettes: &SilhouetteReport,
) -> TeamScores {
    let members = Members::new(teams);
    let entries = roster.map_or(&[][..], |roster| &roster.robots);
    let entries: Entries<'_> = entries.iter().map(|entry| (&entry.robot, entry)).collect();
    let mut all: Vec<TeamAudit> = teams
        .teams
        .iter()
        .enumerate()
        .map(|(number, team)| plain(teams, team, number, &entries, &members, positions))
        .collect();
    for (modality, graph) in graphs {
        let graph = Numbered::new(graph, &members);
        let found = conductances(graph.edges(), &graph.labels, all.len());
        for (team, conductance) in all.iter_mut().zip(found) {
            let modality = modality.clone();
            team.conductance
                .extend(conductance.map(|conductance| Conductance { modality, conductance }));
        }
    }
    let connectivity = Modality::connectivity();
    let radio = graphs.iter().find(|(name, _)| *name == connectivity).map(|(_, graph)| graph);
    let mut losses = Losses::default();
    if let Some(graph) = radio.filter(|graph| graph.edge_count() > 0) {
        hear(teams, &Numbered::new(graph, &members), &mut all, &mut losses);
    }
    losses.add_heads(teams, &all);
    refresh_silhouettes(&mut all, teams, silhouettes);
    TeamScores { graphs: None, losses: losses.worst(teams), teams: all }
}

/// What is said of a team without any graph.
fn plain(
    teams: &Teams,
    team: &Team,
    number: usize,
    entries: &Entries<'_>,
    members: &Members<'_>,
    positions: &Positions,
) -> TeamAudit {
    let is_stale = |robot: &RobotId| teams.stale.binary_search(robot).is_ok();
    let robots = || team.members.iter().map(|member| &member.robot);
    let superior = |robot: &RobotId| entries.get(robot)?.superior.as_ref();
    let is_head = |robot: &&RobotId| {
        superior(robot)
            .is_none_or(|superior| superior == *robot || members.team(superior) != Some(number))
    };
    let heads: Vec<_> = robots().filter(is_head).collect();
    let only_head = match heads[..] {
        [only] if team.members.len() > 1 => Some(only.clone()),
        _ => None,
    };
    TeamAudit {
        team: team.id.clone(),
        robots: count(team.members.len()),
        stale: count(robots().filter(|robot| is_stale(robot)).count()),
        leader_stale: is_stale(&team.leader),
        silhouette: None,
        least: None,
        conductance: Vec::new(),
        radio: None,
        heads: count(heads.len()),
        only_head,
        spread: spread(robots().filter_map(|robot| positions.get(robot))),
        skills: skills(teams, team, entries),
    }
}

/// How many robots of a team have each skill, as far as they are there; what the division counts for a need comes first.
fn skills(teams: &Teams, team: &Team, entries: &Entries<'_>) -> Vec<SkillCover> {
    let needs = teams.needs.iter().filter(|need| need.team == team.id);
    let mut covers: Vec<SkillCover> = needs
        .map(|need| SkillCover {
            skill: need.skill.clone(),
            robots: need.have,
            needed: need.min,
            spare: need.have.saturating_sub(need.min),
            lacking: need.lacks(),
        })
        .collect();
    let mut others: BTreeMap<&SkillId, u32> = BTreeMap::new();
    for member in &team.members {
        let robot = &member.robot;
        if teams.stale.binary_search(robot).is_ok() {
            continue;
        }
        for skill in entries.get(robot).map_or(&[][..], |entry| &entry.skills) {
            *others.entry(skill).or_default() += 1;
        }
    }
    others.retain(|skill, _| !covers.iter().any(|cover| cover.skill == **skill));
    covers.extend(others.into_iter().map(|(skill, robots)| SkillCover {
        skill: skill.clone(),
        robots,
        needed: 0,
        spare: robots,
        lacking: 0,
    }));
    covers.truncate(MAX_AUDITED_SKILLS);
    covers
}

/// The distances of places to their mean.
fn spread<'a>(places: impl Iterator<Item = &'a [f64; 3]> + Clone) -> Option<Spread> {
    let number = places.clone().count();
    if number == 0 {
        return None;
    }
    #[expect(clippy::cast_precision_loss, reason = "there are fewer robots than 2⁵³")]
    let number = number as f64;
    let mut mean = [0.0; 3];
    for place in places.clone() {
        for (sum, x) in mean.iter_mut().zip(place) {
            *sum += x / number;
        }
    }
    let (mut squares, mut largest) = (0.0, 0.0_f64);
    for place in places {
        let square: f64 = place.iter().zip(&mean).map(|(x, mean)| (x - mean).powi(2)).sum();
        squares += square;
        largest = largest.max(square);
    }
    Some(Spread { rms_m: (squares / number).sqrt(), largest_m: largest.sqrt() })
}

/// Puts the silhouettes of a report into what is said of the teams.
pub(crate) fn refresh_silhouettes(
    all: &mut [TeamAudit],
    teams: &Teams,
    silhouettes: &SilhouetteReport,
) {
    let of_team: BTreeMap<_, _> =
        silhouettes.per_team.iter().map(|(id, mean)| (id, *mean)).collect();
    let of_robot = |robot: &RobotId| {
        let at = silhouettes.per_robot.binary_search_by(|(name, _)| name.cmp(robot)).ok()?;
        silhouettes.per_robot.get(at).map(|(_, silhouette)| *silhouette)
    };
    for (audit, team) in all.iter_mut().zip(&teams.teams) {
        audit.silhouette = of_team.get(&team.id).copied();
        let members = team.members.iter().filter_map(|member| {
            Some(LeastFitting { robot: member.robot.clone(), silhouette: of_robot(&member.robot)? })
        });
        audit.least = members.min_by(|left, right| left.silhouette.total_cmp(&right.silhouette));
    }
}

/// How the members of each team hear each other. Robots that are stale do not count, and neither do those that
/// the graph does not have any more.
fn hear(teams: &Teams, graph: &Numbered<'_>, all: &mut [TeamAudit], losses: &mut Losses) {
    let labels: Vec<Option<usize>> = graph
        .names
        .iter()
        .zip(&graph.labels)
        .map(|(name, label)| label.filter(|_| teams.stale.binary_search(name).is_err()))
        .collect();
    let within = graph.edges().filter(|(from, to, _)| {
        let (from, to) = (labels.get(*from).copied().flatten(), labels.get(*to).copied().flatten());
        from.is_some() && from == to
    });
    let found = cuts(labels.len(), within.map(|(from, to, _)| (from, to)));
    let mut radios = vec![
        Radio {
            parts: 0,
            reached_by_leader: 0,
            cut_robot_count: 0,
            cut_robots: Vec::new(),
            bridges: 0,
            worst_cut: 0.0,
        };
        all.len()
    ];
    let mut hearing = vec![0_u32; all.len()];
    for (node, name) in graph.names.iter().enumerate() {
        let Some(number) = labels[node] else { continue };
        hearing[number] += 1;
        if teams.teams.get(number).is_some_and(|team| team.leader == **name) {
            radios[number].reached_by_leader = count(found.sizes[found.component[node]]);
        }
    }
    // A component lies within one team, or is a single robot that belongs to none.
    let mut counted = vec![false; found.sizes.len()];
    for (node, label) in labels.iter().enumerate() {
        let first = !std::mem::replace(&mut counted[found.component[node]], true);
        if let Some(number) = label.filter(|_| first) {
            radios[number].parts += 1;
        }
    }
    for bridge in &found.bridges {
        if let Some(number) = labels[bridge.ends[0]] {
            radios[number].bridges += 1;
        }
    }
    cut_robots(teams, graph, &labels, &found, &hearing, &mut radios, losses);
    for (audit, radio) in all.iter_mut().zip(radios) {
        audit.radio = Some(radio);
    }
}

/// The robots without which parts of their teams fall apart.
fn cut_robots(
    teams: &Teams,
    graph: &Numbered<'_>,
    labels: &[Option<usize>],
    found: &Cuts,
    hearing: &[u32],
    radios: &mut [Radio],
    losses: &mut Losses,
) {
    let mut cut =
        found.nodes.iter().filter_map(|cut| Some((labels[cut.node]?, cut))).collect::<Vec<_>>();
    let cut_off = |parts: &[usize]| count(parts.iter().skip(1).sum());
    cut.sort_by_key(|(_, cut)| (std::cmp::Reverse(cut_off(&cut.parts)), graph.names[cut.node]));
    for (number, cut) in cut {
        let (name, radio) = (graph.names[cut.node], &mut radios[number]);
        radio.cut_robot_count += 1;
        if radio.cut_robots.len() < MAX_CUT_ROBOTS {
            radio.cut_robots.push(name.clone());
        }
        let cut_off = cut_off(&cut.parts);
        let others = f64::from(hearing[number].saturating_sub(1).max(1));
        radio.worst_cut = radio.worst_cut.max((f64::from(cut_off) / others).min(1.0));
        let loss = losses.of(teams, number, name);
        loss.part_count = count(cut.parts.len());
        loss.parts = cut.parts.iter().take(MAX_LOSS_PARTS).map(|part| count(*part)).collect();
        loss.cut_off = cut_off;
    }
}

/// What the loss of each robot would do, of those where that is something; with the number of the team.
#[derive(Default)]
struct Losses(BTreeMap<RobotId, (usize, Loss)>);

impl Losses {
    fn of(&mut self, teams: &Teams, number: usize, robot: &RobotId) -> &mut Loss {
        let loss = || Loss {
            robot: robot.clone(),
            team: teams.teams[number].id.clone(),
            part_count: 1,
            parts: Vec::new(),
            cut_off: 0,
            is_leader: teams.teams[number].leader == *robot,
            is_only_head: false,
        };
        &mut self.0.entry(robot.clone()).or_insert_with(|| (number, loss())).1
    }

    /// Adds the leaders and the only heads of teams in which others would be left. Those that are stale are lost already.
    fn add_heads(&mut self, teams: &Teams, all: &[TeamAudit]) {
        let is_there = |robot: &RobotId| teams.stale.binary_search(robot).is_err();
        for (number, (team, audit)) in teams.teams.iter().zip(all).enumerate() {
            if team.members.len() < 2 {
                continue;
            }
            if is_there(&team.leader) {
                self.of(teams, number, &team.leader);
            }
            if let Some(head) = audit.only_head.as_ref().filter(|head| is_there(head)) {
                self.of(teams, number, head).is_only_head = true;
            }
        }
    }

    /// The worst: those that cut off most robots, then those that lead, in larger teams first.
    fn worst(self, teams: &Teams) -> Vec<Loss> {
        let mut all: Vec<_> = self.0.into_values().collect();
        let harm = |(number, loss): &(usize, Loss)| {
            let leads = u8::from(loss.is_leader) + u8::from(loss.is_only_head);
            let size = teams.teams.get(*number).map_or(0, |team| team.members.len());
            (loss.cut_off, leads, size)
        };
        // A stable sort: among equals the first by name.
        all.sort_by_key(|loss| std::cmp::Reverse(harm(loss)));
        all.truncate(MAX_LOSSES);
        all.into_iter().map(|(_, loss)| loss).collect()
    }
}

fn count(number: usize) -> u32 {
    u32::try_from(number).unwrap_or(u32::MAX)
}

//! Messages for the tests of this crate.

use muster_model::embedding::{Embedding, EmbeddingMode, EmbeddingQuality};
use muster_model::header::Header;
use muster_model::header::Revision;
use muster_model::id::{FleetId, RobotId, TeamId};
use muster_model::roster::{Presence, Roster, RosterEntry};
use muster_model::teams::{Member, Team, Teams};
use muster_model::time::Tick;

pub(crate) fn header(epoch: u64) -> Header {
    Header {
        fleet: FleetId::new("alpha").unwrap(),
        revision: Revision { term: 1, epoch },
        oldest: Some(Tick(1_000_000)),
        newest: Some(Tick(1_000_000 * epoch)),
        stages: Vec::new(),
    }
}

pub(crate) fn robot(name: &str) -> RobotId {
    RobotId::new(name).unwrap()
}

/// A roster of robots on a line, ordered by name.
pub(crate) fn roster(epoch: u64, names: &[&str]) -> Roster {
    let entry = |(node, name): (usize, &&str)| RosterEntry {
        node: u32::try_from(node).unwrap(),
        robot: robot(name),
        presence: Presence::Active,
        position: Some([f64::from(u32::try_from(node).unwrap()), 0.0, 0.0]),
        heading: None,
        frame: None,
        superior: None,
        role: None,
        skills: Vec::new(),
        last_seen: Tick(1_000_000 * epoch),
    };
    Roster {
        header: header(epoch),
        robots: names.iter().enumerate().map(entry).collect(),
        graphs: Vec::new(),
    }
}

/// A division: each team with its robots, the first of which leads.
pub(crate) fn teams(epoch: u64, teams: &[(&str, &[&str])]) -> Teams {
    let member = |name: &&str| Member { robot: robot(name), margin: 0.5 };
    let team = |(id, names): &(&str, &[&str])| Team {
        id: TeamId::new(id).unwrap(),
        members: names.iter().map(member).collect(),
        leader: robot(names[0]),
        centroid: Vec::new(),
    };
    Teams {
        header: header(epoch),
        embedding: Revision::default(),
        requested: u32::try_from(teams.len()).unwrap(),
        considered: Vec::new(),
        teams: teams.iter().map(team).collect(),
        unassigned: Vec::new(),
        stale: Vec::new(),
        inertia: 0.0,
        changes: Vec::new(),
        next_team: 9,
        limited: None,
        needs: Vec::new(),
        provisional: Vec::new(),
        held: Vec::new(),
    }
}

/// An embedding with these rows, of robots that are named by their number.
pub(crate) fn embedding<const D: usize>(rows: &[[f64; D]]) -> Embedding {
    Embedding {
        header: header(1),
        roster: Revision::default(),
        graphs: Vec::new(),
        robots: (0..rows.len()).map(|number| robot(&format!("r{number:05}"))).collect(),
        dimension: u32::try_from(D).unwrap(),
        values: rows.iter().flatten().copied().collect(),
        without_embedding: vec![false; rows.len()],
        provisional: vec![false; rows.len()],
        centrality: vec![1.0; rows.len()],
        quality: EmbeddingQuality {
            spectral_radius: (1.0, 1.0),
            alpha: 0.5,
            singular_values: Vec::new(),
            next_singular_value: 0.0,
            residual: 0.0,
            katz_residual: 0.0,
            gap: 1.0,
            ambiguous: false,
            mode: EmbeddingMode::Dense,
            teams_shown: None,
            team_scores: Vec::new(),
            stage_us: [0; 3],
        },
    }
}

//! Which robots every team needs.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{SettingsError, check_range};
use crate::id::{SkillId, TeamId};
use crate::limits::{MAX_NEEDED_SKILLS, MAX_NEEDS, MAX_TEAM_SIZE};

/// How many robots with a skill a team has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
// A part of its own would be described as it is written alone: with every field.
#[schemars(inline)]
pub struct SkillCount {
    /// Least number of robots. Stale ones do not count.
    #[schemars(range(min = 0, max = MAX_TEAM_SIZE))]
    pub min: u32,
    /// Most robots; no limit if left out.
    #[serde(default)]
    #[schemars(range(min = 0, max = MAX_TEAM_SIZE))]
    pub max: Option<u32>,
}

/// A skill that teams need.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(inline)]
pub struct Need {
    /// The skill, as robots name it in their rank.
    pub skill: SkillId,
    /// The only team that it is about, by its id. Without it the need is that of every team that no other need names
    /// for the skill.
    #[serde(default)]
    pub team: Option<TeamId>,
    /// How many robots with the skill each team has.
    #[serde(deserialize_with = "crate::object::one")]
    #[schemars(with = "SkillCount")]
    pub per_team: SkillCount,
    /// Whether a team may have fewer than `min` where there is no other way; `max` holds anyway.
    #[serde(default)]
    pub soft: bool,
}

/// Checks all needs of a fleet.
///
/// # Errors
/// Names the field of the first need that is wrong.
pub(super) fn check(needs: &[Need]) -> Result<(), SettingsError> {
    if needs.len() > MAX_NEEDS {
        let problem =
            format!("may be at most {MAX_NEEDS}, not {}: leave out `team` for most", needs.len());
        return Err(SettingsError::new("needs", problem));
    }
    let mut skills: Vec<&SkillId> = needs.iter().map(|need| &need.skill).collect();
    skills.sort_unstable();
    skills.dedup();
    if skills.len() > MAX_NEEDED_SKILLS {
        let problem =
            format!("may name at most {MAX_NEEDED_SKILLS} different skills, not {}", skills.len());
        return Err(SettingsError::new("needs", problem));
    }
    for (place, need) in needs.iter().enumerate() {
        let field = format!("needs[{place}]");
        let SkillCount { min, max } = need.per_team;
        let most = f64::from(MAX_TEAM_SIZE);
        check_range(&format!("{field}.per_team.min"), f64::from(min), 0.0..=most)?;
        if let Some(max) = max {
            check_range(&format!("{field}.per_team.max"), f64::from(max), 0.0..=most)?;
            if max < min {
                let problem = format!("must be at least min, {min}, not {max}");
                return Err(SettingsError::new(format!("{field}.per_team.max"), problem));
            }
        }
        let is_same = |other: &Need| other.skill == need.skill && other.team == need.team;
        if needs[..place].iter().any(is_same) {
            let whose =
                need.team.as_ref().map_or("all teams".to_owned(), |team| format!("team {team}"));
            let problem = format!("{} of {whose} is needed twice: join the two", need.skill);
            return Err(SettingsError::new(format!("{field}.skill"), problem));
        }
    }
    Ok(())
}

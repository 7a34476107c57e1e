//! Limits as people write them on a command line: `3..6`, `t1=2..`, `medic=1`.

use super::{Need, SkillCount, TeamSize};
use crate::id::{SkillId, TeamId};

/// Both ends of a range such as `2..4`, `2..` or `..4`, or one number for both.
///
/// # Errors
/// Says what is no number, or that both ends are missing.
pub fn range(text: &str) -> Result<(Option<u32>, Option<u32>), String> {
    let number = |text: &str| -> Result<Option<u32>, String> {
        if text.is_empty() {
            return Ok(None);
        }
        let wrong = |_| format!("{text:?} is no whole number");
        text.parse().map(Some).map_err(wrong)
    };
    match text.split_once("..") {
        Some(("", "")) => Err("a range must have an end".to_owned()),
        Some((from, to)) => Ok((number(from)?, number(to.strip_prefix('=').unwrap_or(to))?)),
        None if text.is_empty() => Err("must be a number or a range such as 3..6".to_owned()),
        None => Ok((number(text)?, number(text)?)),
    }
}

/// The two sides of `NAME=VALUE`; `form` describes it.
///
/// # Errors
/// If there is no `=`.
pub fn pair<'a>(text: &'a str, form: &str) -> Result<(&'a str, &'a str), String> {
    text.split_once('=').ok_or_else(|| format!("{text:?} must be {form}"))
}

/// How many robots a team has: a [`range`].
///
/// # Errors
/// As of [`range`].
pub fn size(text: &str) -> Result<TeamSize, String> {
    let (min, max) = range(text)?;
    Ok(TeamSize { min, max })
}

/// How many robots one team has: `TEAM=RANGE`.
///
/// # Errors
/// Says what is no team or no range.
pub fn team_size(text: &str) -> Result<(TeamId, TeamSize), String> {
    let (team, range) = pair(text, "TEAM=RANGE")?;
    Ok((TeamId::new(team).map_err(|error| error.to_string())?, size(range)?))
}

/// How many robots with a skill each team needs: `SKILL=COUNT`, at least so many, or `SKILL=RANGE`.
///
/// # Errors
/// Says what is no skill or no range.
pub fn need(text: &str) -> Result<Need, String> {
    let (skill, count) = pair(text, "SKILL=COUNT")?;
    let skill = SkillId::new(skill).map_err(|error| error.to_string())?;
    let (min, max) = range(count)?;
    // One number is the least: a medic more does no harm.
    let max = max.filter(|_| count.contains(".."));
    Ok(Need { skill, team: None, per_team: SkillCount { min: min.unwrap_or(0), max }, soft: false })
}

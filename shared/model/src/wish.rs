//! What operators wish of divisions: that robots be in a team or not, together or apart, or in none.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::content::{Content, ContentError, refuse};
use crate::header::Header;
use crate::id::{OperatorId, RobotId, TeamId, WishId};
use crate::limits::{
    MAX_CONFLICT_LENGTH, MAX_GROUP_WISHES, MAX_NOTE_LENGTH, MAX_WISH_ROBOTS, MAX_WISHES,
};
use crate::settings::SettingsError;

/// What is wished.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema,
)]
#[serde(rename_all = "snake_case")]
pub enum WishKind {
    /// The robots are in the team.
    Pin,
    /// The robots are not in the team.
    Ban,
    /// The robots are in one team.
    Together,
    /// No two of the robots are in one team.
    Apart,
    /// The robots of the team stay in it.
    Lock,
    /// The robots are in no team.
    Reserve,
}

impl WishKind {
    /// Its name in JSON and in commands.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Pin => "pin",
            Self::Ban => "ban",
            Self::Together => "together",
            Self::Apart => "apart",
            Self::Lock => "lock",
            Self::Reserve => "reserve",
        }
    }

    /// Whether it names a team.
    const fn has_team(self) -> bool {
        matches!(self, Self::Pin | Self::Ban | Self::Lock)
    }

    /// Least number of robots that it names; none where it names none at all.
    const fn least_robots(self) -> Option<usize> {
        match self {
            Self::Pin | Self::Ban | Self::Reserve => Some(1),
            Self::Together | Self::Apart => Some(2),
            Self::Lock => None,
        }
    }

    /// Whether it is about how robots of any team stand to each other.
    #[must_use]
    pub const fn is_of_group(self) -> bool {
        matches!(self, Self::Together | Self::Apart)
    }
}

/// A wish of an operator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Wish {
    /// What is wished.
    pub kind: WishKind,
    /// The robots, each once; none for `lock`.
    #[serde(default)]
    #[schemars(length(max = MAX_WISH_ROBOTS))]
    pub robots: Vec<RobotId>,
    /// The team of `pin`, `ban` and `lock`.
    #[serde(default)]
    pub team: Option<TeamId>,
    /// Seconds since the Unix epoch from which on it no longer counts; none for ever.
    #[serde(default)]
    #[schemars(range(min = 0, max = MAX_EXPIRY_S))]
    pub expires: Option<f64>,
    /// Why, for people.
    #[serde(default)]
    #[schemars(length(max = MAX_NOTE_LENGTH))]
    pub note: Option<String>,
}

/// The last moment at which a wish may expire, in seconds since the Unix epoch: the year 5138, as a typed number that
/// is larger is one of milliseconds.
pub const MAX_EXPIRY_S: f64 = 1.0e11;

impl Wish {
    /// The wish with its robots in order, if it makes sense by itself.
    ///
    /// # Errors
    /// Names the field that is wrong, and what would be right.
    pub fn checked(mut self) -> Result<Self, SettingsError> {
        let kind = self.kind.name();
        let wrong = |field: &str, problem: String| Err(SettingsError::new(field, problem));
        self.robots.sort_unstable();
        if self.robots.windows(2).any(|pair| pair[0] == pair[1]) {
            return wrong("robots", "must name each robot once".to_owned());
        }
        let named = self.robots.len();
        match self.kind.least_robots() {
            None if named > 0 => return wrong("robots", format!("must be left out for {kind}")),
            Some(least) if named < least || named > MAX_WISH_ROBOTS => {
                let robots = if least == 1 { "robot" } else { "robots" };
                let problem = format!(
                    "must name {least} {robots} to {MAX_WISH_ROBOTS} for {kind}, not {named}"
                );
                return wrong("robots", problem);
            }
            _ => {}
        }
        if self.kind.has_team() != self.team.is_some() {
            let problem =
                if self.kind.has_team() { "must name a team" } else { "must be left out" };
            return wrong("team", format!("{problem} for {kind}"));
        }
        if let Some(expires) = self.expires
            && !(0.0..=MAX_EXPIRY_S).contains(&expires)
        {
            let problem =
                format!("must be seconds since 1970, up to {MAX_EXPIRY_S}, not {expires}");
            return wrong("expires", problem);
        }
        if let Some(note) = &self.note
            && (note.chars().count() > MAX_NOTE_LENGTH || note.chars().any(char::is_control))
        {
            let problem =
                format!("may have at most {MAX_NOTE_LENGTH} characters, and none of control");
            return wrong("note", problem);
        }
        Ok(self)
    }
}

/// What has become of a wish.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum WishState {
    /// It waits for its robots, its team or the next division.
    Waiting,
    /// The division grants it.
    Active,
    /// Its time is over.
    Expired,
    /// The division does not grant it, as nothing grants all wishes within the limits any more.
    Conflicting,
    /// It was withdrawn: the last that is heard of it.
    Withdrawn,
}

/// A wish that a service keeps.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StandingWish {
    /// Whose wish it is.
    pub operator: OperatorId,
    /// Its name among those of the operator.
    pub id: WishId,
    /// What is wished.
    pub wish: Wish,
    /// What has become of it.
    pub state: WishState,
    /// What it waits for, or what it contradicts; none where it is granted.
    #[schemars(length(max = MAX_CONFLICT_LENGTH))]
    pub reason: Option<String>,
}

/// All wishes of a fleet.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WishList {
    /// The head of the message.
    pub header: Header,
    /// The wishes, ordered by operator and id.
    pub wishes: Vec<StandingWish>,
}

impl Content for WishList {
    /// The wishes are ordered without repetition, no more than there may be, and each makes sense.
    fn check(&self) -> Result<(), ContentError> {
        if self.wishes.len() > MAX_WISHES {
            return refuse("wishes", "are more than there may be");
        }
        if self.wishes.iter().filter(|one| one.wish.kind.is_of_group()).count() > MAX_GROUP_WISHES {
            return refuse("wishes", "of groups are more than there may be");
        }
        let name = |one: &StandingWish| (one.operator.clone(), one.id.clone());
        if !self.wishes.is_sorted_by(|left, right| name(left) < name(right)) {
            return refuse("wishes", "must be ordered by operator and id, each once");
        }
        for one in &self.wishes {
            if one.wish.clone().checked().as_ref() != Ok(&one.wish) {
                return refuse("wish", "makes no sense");
            }
            let is_long = |text: &String| text.chars().count() > MAX_CONFLICT_LENGTH;
            if one.reason.as_ref().is_some_and(is_long) {
                return refuse("reason", "is longer than it may be");
            }
        }
        Ok(())
    }
}

/// One wish, as a get of its key is answered.
#[derive(Debug, Clone, PartialEq)]
pub struct WishReport {
    /// The head of the message.
    pub header: Header,
    /// The wish.
    pub wish: StandingWish,
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use super::*;

    fn checked(value: Value) -> Result<Wish, String> {
        let wish: Wish = serde_json::from_value(value).map_err(|error| error.to_string())?;
        wish.checked().map_err(|error| error.to_string())
    }

    #[test]
    fn a_wish_names_what_its_kind_needs() {
        for right in [
            json!({"kind": "pin", "robots": ["r7"], "team": "t2"}),
            json!({"kind": "ban", "robots": ["r7", "r8"], "team": "t2", "note": "no radio"}),
            json!({"kind": "together", "robots": ["r2", "r1"], "expires": 1.9e9}),
            json!({"kind": "apart", "robots": ["r2", "r1"], "team": null}),
            json!({"kind": "lock", "team": "t2"}),
            json!({"kind": "reserve", "robots": ["r9"]}),
        ] {
            assert!(checked(right.clone()).is_ok(), "{right}: {:?}", checked(right.clone()));
        }
        let many: Vec<String> = (0..=MAX_WISH_ROBOTS).map(|at| format!("r{at}")).collect();
        for (wrong, named) in [
            (json!({"kind": "pin", "robots": ["r7"]}), "team: must name"),
            (json!({"kind": "pin", "team": "t2"}), "robots: must name 1 robot"),
            (json!({"kind": "reserve", "robots": ["r7"], "team": "t2"}), "team: must be left out"),
            (json!({"kind": "together", "robots": ["r7"]}), "robots: must name 2 robots"),
            (json!({"kind": "apart", "robots": ["r7", "r7"]}), "robots: must name each robot once"),
            (json!({"kind": "lock", "team": "t2", "robots": ["r7"]}), "robots: must be left out"),
            (json!({"kind": "reserve", "robots": many}), "robots: must name 1"),
            (json!({"kind": "reserve", "robots": ["r7"], "expires": -1.0}), "expires"),
            (json!({"kind": "reserve", "robots": ["r7"], "note": "a\u{7}"}), "note"),
            (json!({"kind": "reserve", "robots": ["r7"], "why": "x"}), "why"),
            (json!({"kind": "keep", "robots": ["r7"]}), "keep"),
            (json!({"kind": "reserve", "robots": ["R 7"]}), "id"),
        ] {
            let problem = checked(wrong.clone()).unwrap_err();
            assert!(problem.contains(named), "{wrong}: {problem}");
        }
        let sorted = checked(json!({"kind": "together", "robots": ["r2", "r1"]})).unwrap();
        assert_eq!(sorted.robots[0].as_str(), "r1");
    }
}

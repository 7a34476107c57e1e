//! Why a robot is in its team: what draws it to each team, what a place there costs, and what holds it.
//!
//! k-means puts a robot with the vector x into the team whose mean c is nearest, which is the team with the largest
//! *score* 2 x·c − ‖c‖². The score is a sum of one pull per modality, what the robot's self-loop keeps, the spread of the
//! team, and what rounding leaves. What decides is the *total*: the score, less the price of a place where teams have
//! limits and that of a needed skill, and for the robot's own team the credit that the hysteresis gives it. All parts of a
//! total add up to it. A robot that is placed together with others has no price, and its reason says so.

use std::fmt::Write as _;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::content::{Content, ContentError, refuse};
use crate::header::{Header, Revision};
use crate::id::{Modality, OperatorId, RobotId, SkillId, TeamId, WishId};
use crate::limits::{MAX_REASON_TEAMS, MAX_WISHES};
use crate::wish::WishKind;

/// Difference of two sums that is rounding, as a share of them.
const ROUNDING: f64 = 1e-9;

/// Most wishes that the text names; the list has all.
const WISHES_IN_TEXT: usize = 3;

/// What decided that a robot is in its team.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum DecidedBy {
    /// Its relations: no team has a larger score.
    Relations,
    /// A team with a larger score is full, or its own needs its robots.
    Limits,
    /// Wishes of operators.
    Wishes,
    /// The last division is kept while no other is clearly better.
    Hysteresis,
    /// Another team has not been its own for long enough.
    Dwell,
    /// Nothing satisfies limits and wishes, so that the last division stands.
    Conflict,
    /// The division is older than the graphs.
    OlderDivision,
    /// Another team is nearer, and yet the division as a whole is the best that was found.
    WholeDivision,
    /// It is placed together with others, for needs of skills that robots have several of.
    Jointly,
}

/// How much one modality draws a robot to a team.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModalityPull {
    /// The modality.
    pub modality: Modality,
    /// Its part of the score.
    pub pull: f64,
}

/// What draws a robot to one team, and what keeps it out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TeamReason {
    /// The team.
    pub team: TeamId,
    /// How many robots it has.
    pub robots: u32,
    /// How many it may have; none without a limit.
    pub max: Option<u32>,
    /// How many it has to have, at least 1.
    pub min: u32,
    /// Whether a wish keeps the robot out of it.
    pub barred: bool,
    /// The sum of the pulls, `itself`, `spread` and `rest`: the nearest team has the largest.
    pub score: f64,
    /// The pull of each modality.
    pub modalities: Vec<ModalityPull>,
    /// What the self-loop of the robot keeps of its vector: it goes the way of the modalities.
    pub itself: f64,
    /// A team whose robots are spread out is dearer by less.
    pub spread: f64,
    /// What the residual of the singular vectors leaves.
    pub rest: f64,
    /// What a place in the team costs: above zero where the team is full, below where it needs its robots.
    pub price: f64,
    /// By how much the hysteresis favours the team that the robot is in; zero for others.
    pub hysteresis: f64,
    /// `score` − `price` − `skill_price` + `hysteresis`.
    pub total: f64,
    /// What a place in the team costs beside that for the needed skill of the robot: above zero where no more robots with it
    /// may be, below where the team needs them.
    #[serde(default)]
    pub skill_price: f64,
}

/// A wish that concerns the robot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ReasonWish {
    /// Whose wish it is.
    pub operator: OperatorId,
    /// Its name among those of the operator.
    pub id: WishId,
    /// What is wished.
    pub kind: WishKind,
    /// The team that it names.
    pub team: Option<TeamId>,
    /// Whether the division grants it.
    pub granted: bool,
}

/// Why a robot is in its team.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Reason {
    /// The robot.
    pub robot: RobotId,
    /// Its team.
    pub team: TeamId,
    /// What decided.
    pub decided_by: DecidedBy,
    /// The same in a paragraph for people.
    pub text: String,
    /// The division that is explained.
    pub division: Revision,
    /// By how many seconds that is older than the graphs by which the scores are computed; none where it rests on
    /// exactly these.
    #[schemars(range(min = 0))]
    pub older_s: Option<f64>,
    /// Whether one modality alone relates the robot to others, where several relate robots of the fleet: nothing
    /// confirms its place.
    pub provisional: bool,
    /// The team that the newest vectors put it into; none where that is its own. It changes once that has lasted.
    pub held_from: Option<TeamId>,
    /// The squared length of its vector: less a score, it is the squared distance to the mean of that team.
    pub length_squared: f64,
    /// Its own team, then the others, those with the largest total first.
    #[schemars(length(min = 1, max = MAX_REASON_TEAMS))]
    pub teams: Vec<TeamReason>,
    /// The wishes that concern it, ordered by operator and id.
    #[schemars(length(max = MAX_WISHES))]
    pub wishes: Vec<ReasonWish>,
    /// By which share another division must be better before it replaces the last one.
    #[schemars(range(min = 0, max = 1))]
    pub hysteresis: f64,
    /// For how many seconds another team must have been its own before it changes.
    #[schemars(range(min = 0))]
    pub dwell_s: f64,
    /// Why nothing satisfies limits and wishes; none where something does.
    pub conflict: Option<String>,
    /// The needed skill by which limits price its place; none without one.
    #[serde(default)]
    pub skill: Option<SkillId>,
    /// Whether it is placed together with others, by wishes of groups or for skills of which robots have several. Such a
    /// place was searched for: no price stands for it, and the totals leave out what decided.
    #[serde(default)]
    pub jointly: bool,
    /// Whether `clusterer` did not answer with its settings, so that `hysteresis`, `dwell_s` and the limits of the teams are
    /// the defaults, and may be others.
    #[serde(default)]
    pub settings_assumed: bool,
}

/// A reason as a get is answered with it.
#[derive(Debug, Clone, PartialEq)]
pub struct Why {
    /// The head of the embedding by which the scores are computed.
    pub header: Header,
    /// The reason.
    pub reason: Reason,
}

impl TeamReason {
    /// Sets the total from the parts.
    #[must_use]
    pub fn summed(self) -> Self {
        let total = self.score - self.price - self.skill_price + self.hysteresis;
        Self { total, ..self }
    }

    /// The sum of the parts of the total.
    fn parts(&self) -> f64 {
        let pulls: f64 = self.modalities.iter().map(|pull| pull.pull).sum();
        let costs = self.price + self.skill_price;
        pulls + self.itself + self.spread + self.rest - costs + self.hysteresis
    }

    fn numbers(&self) -> impl Iterator<Item = f64> {
        let others = [self.score, self.itself, self.spread, self.rest, self.price];
        let others = others.into_iter().chain([self.hysteresis, self.total, self.skill_price]);
        self.modalities.iter().map(|pull| pull.pull).chain(others)
    }
}

impl Content for Why {
    /// Numbers are finite, the parts of each total add up to it, and the first team is the robot's own.
    fn check(&self) -> Result<(), ContentError> {
        let Reason { teams, .. } = &self.reason;
        if teams.first().is_none_or(|first| first.team != self.reason.team) {
            return refuse("teams", "must begin with the team of the robot");
        }
        if teams.len() > MAX_REASON_TEAMS {
            return refuse("teams", "are more than a reason may list");
        }
        if self.reason.wishes.len() > MAX_WISHES {
            return refuse("wishes", "are more than there may be");
        }
        if !teams.iter().flat_map(TeamReason::numbers).all(f64::is_finite)
            || !self.reason.length_squared.is_finite()
        {
            return refuse("teams", "a number is not finite");
        }
        let adds_up = |team: &TeamReason| {
            let size = team.numbers().fold(1.0, |sum, number| sum + number.abs());
            (team.parts() - team.total).abs() <= ROUNDING * size
        };
        if !teams.iter().all(adds_up) {
            return refuse("teams.total", "must be the sum of its parts");
        }
        Ok(())
    }
}

impl Reason {
    /// The same with what decided, and the text that says it.
    #[must_use]
    pub fn decided(mut self) -> Self {
        self.decided_by = self.decision();
        self.text = self.paragraph();
        self
    }

    /// The robot's own team and the other one that draws it most.
    fn own_and_next(&self) -> (Option<&TeamReason>, Option<&TeamReason>) {
        let others = self.teams.iter().skip(1);
        (self.teams.first(), others.max_by(|left, right| left.score.total_cmp(&right.score)))
    }

    /// What decided.
    fn decision(&self) -> DecidedBy {
        let Some(own) = self.teams.first() else { return DecidedBy::OlderDivision };
        let is_best = |value: fn(&TeamReason) -> f64, with_barred: bool| {
            let rivals = self.teams.iter().filter(|team| with_barred || !team.barred);
            let near = |other: f64| ROUNDING * (1.0 + other.abs());
            rivals.into_iter().all(|other| value(own) >= value(other) - near(value(other)))
        };
        let is_grouped = || self.wishes.iter().any(|wish| wish.granted && wish.kind.is_of_group());
        if is_best(|team| team.score, true) {
            DecidedBy::Relations
        } else if self.conflict.is_some() {
            DecidedBy::Conflict
        } else if self.held_from.is_some() {
            DecidedBy::Dwell
        } else if is_best(|team| team.score, false) || self.jointly && is_grouped() {
            DecidedBy::Wishes
        } else if self.jointly {
            DecidedBy::Jointly
        } else if is_best(|team| team.score - team.price - team.skill_price, false) {
            DecidedBy::Limits
        } else if is_best(|team| team.total, false) {
            DecidedBy::Hysteresis
        } else if is_grouped() {
            DecidedBy::Wishes
        } else if self.older_s.is_some() {
            DecidedBy::OlderDivision
        } else {
            DecidedBy::WholeDivision
        }
    }

    /// The reason in words.
    fn paragraph(&self) -> String {
        let mut text = format!("{} is in {}", self.robot, self.team);
        match self.own_and_next() {
            (Some(own), Some(next)) => {
                self.compare(&mut text, own, next);
                self.explain(&mut text, own, next);
            }
            _ => text.push_str(", and there is no other team."),
        }
        self.name_wishes(&mut text);
        if self.jointly && self.decided_by != DecidedBy::Jointly {
            text.push_str(
                " It is placed together with others, by a search: no price of limits stands for its place.",
            );
        }
        if self.settings_assumed {
            text.push_str(
                " clusterer has not answered with its settings: the defaults are assumed for the limits, for the \
                 hysteresis and for dwell_s.",
            );
        }
        if let Some(team) = self.held_from.as_ref().filter(|_| self.decided_by != DecidedBy::Dwell)
        {
            let _ =
                write!(text, " The newest division has it in {team}, which has not lasted yet.");
        }
        if self.provisional {
            text.push_str(
                " Its place is provisional: one modality alone relates it to others, and nothing confirms that.",
            );
        }
        if let Some(older) = self.older_s.filter(|_| self.decided_by != DecidedBy::OlderDivision) {
            let _ = write!(
                text,
                " The division is {older:.2} s older than the graphs by which this is computed."
            );
        }
        text
    }

    /// Which of the two draws it more, and by which modalities.
    fn compare(&self, text: &mut String, own: &TeamReason, next: &TeamReason) {
        let apart = own.score - next.score;
        let word = if apart >= 0.0 { "more" } else { "less" };
        let _ = write!(text, ", which draws it {word} than {} by {:.3}: ", next.team, apart.abs());
        let of_next = |modality: &Modality| {
            let pull = next.modalities.iter().find(|pull| pull.modality == *modality);
            pull.map_or(0.0, |pull| pull.pull)
        };
        let pulls = own.modalities.iter();
        let mut gains: Vec<(&Modality, f64)> =
            pulls.map(|pull| (&pull.modality, pull.pull - of_next(&pull.modality))).collect();
        gains.sort_by(|left, right| right.1.total_cmp(&left.1));
        let known: f64 = gains.iter().map(|(_, gain)| gain).sum();
        for (modality, gain) in gains {
            let _ = write!(text, "{modality} {gain:+.3}, ");
        }
        let _ = write!(text, "all else {:+.3}.", apart - known);
    }

    /// Why the team that draws it most is not its own, if so.
    fn explain(&self, text: &mut String, own: &TeamReason, next: &TeamReason) {
        let (robot, gain) = (&self.robot, next.score - own.score);
        match self.decided_by {
            DecidedBy::Relations => text.push_str(" No team draws it more."),
            DecidedBy::Limits => {
                let price = |team: &TeamReason| team.price + team.skill_price;
                let more = price(next) - price(own) - gain;
                if let Some(skill) = &self.skill {
                    if next.skill_price > 0.0 {
                        let _ = write!(
                            text,
                            " {} may have no more robots with {skill}: its place costs {more:.3} more than {robot} \
                             gains.",
                            next.team
                        );
                    }
                    if own.skill_price < 0.0 {
                        let _ = write!(
                            text,
                            " {} needs robots with {skill}: without {robot} another one would have to come, which costs \
                             {more:.3} more than {robot} gains.",
                            own.team
                        );
                    }
                }
                if next.price > 0.0 {
                    let _ = write!(
                        text,
                        " {} is full ({} robots): its place costs {more:.3} more than {robot} gains.",
                        next.team, next.robots
                    );
                }
                if own.price < 0.0 {
                    let _ = write!(
                        text,
                        " {} needs its robots (at least {}): without {robot} another one would have to \
                         come, which costs {more:.3} more than {robot} gains.",
                        own.team, own.min
                    );
                }
            }
            DecidedBy::Hysteresis => {
                let _ = write!(
                    text,
                    " That is less than {:.3}: the last division is kept while no other is better by {:.0} %.",
                    own.hysteresis,
                    100.0 * self.hysteresis
                );
            }
            DecidedBy::Dwell => {
                if let Some(team) = &self.held_from {
                    let _ = write!(
                        text,
                        " The newest division has it in {team}; it changes once every division has said so for {} s.",
                        self.dwell_s
                    );
                }
            }
            DecidedBy::Conflict => {
                let conflict = self.conflict.as_deref().unwrap_or_default();
                let _ = write!(
                    text,
                    " Nothing satisfies limits and wishes, so that the last division stands: {conflict}."
                );
            }
            DecidedBy::Wishes => text.push_str(" A wish decides."),
            DecidedBy::OlderDivision => {
                let older = self.older_s.unwrap_or_default();
                let _ = write!(
                    text,
                    " The division is {older:.2} s older than the graphs by which this is computed, and the next one \
                     may move it."
                );
            }
            DecidedBy::Jointly => text.push_str(
                " It is placed together with others, for needs of skills that robots have several of: that was found by \
                 a search, and no price stands for its place.",
            ),
            DecidedBy::WholeDivision => text.push_str(
                " Yet the division as a whole is the best that was found: teams change with their robots.",
            ),
        }
    }

    fn name_wishes(&self, text: &mut String) {
        let granted: Vec<_> = self.wishes.iter().filter(|wish| wish.granted).collect();
        for wish in granted.iter().take(WISHES_IN_TEXT) {
            let (operator, id) = (&wish.operator, &wish.id);
            let team = wish.team.as_ref().unwrap_or(&self.team);
            let effect = match wish.kind {
                WishKind::Pin => format!("holds it in {team}"),
                WishKind::Ban => format!("keeps it out of {team}"),
                WishKind::Lock => format!("keeps the robots of {team} there"),
                WishKind::Together => "keeps it together with others".to_owned(),
                WishKind::Apart => "keeps it apart from others".to_owned(),
                WishKind::Reserve => "keeps it in no team".to_owned(),
            };
            let _ = write!(text, " The wish {operator}/{id} {effect}.");
        }
        let more = granted.len().saturating_sub(WISHES_IN_TEXT);
        if more > 0 {
            let _ = write!(text, " {more} more wishes concern it.");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::id::FleetId;

    fn team(name: &str, pulls: [f64; 2], price: f64, hysteresis: f64) -> TeamReason {
        let names = [Modality::hierarchy(), Modality::spatial()];
        let pull = |(modality, pull)| ModalityPull { modality, pull };
        TeamReason {
            team: TeamId::new(name).unwrap(),
            robots: 3,
            max: Some(3),
            min: 1,
            barred: false,
            score: pulls.iter().sum::<f64>() - 0.25,
            modalities: names.into_iter().zip(pulls).map(pull).collect(),
            itself: 0.0,
            spread: -0.25,
            rest: 0.0,
            price,
            hysteresis,
            total: 0.0,
            skill_price: 0.0,
        }
        .summed()
    }

    fn reason(teams: Vec<TeamReason>) -> Reason {
        Reason {
            robot: RobotId::new("r7").unwrap(),
            team: teams[0].team.clone(),
            decided_by: DecidedBy::Relations,
            text: String::new(),
            division: Revision { term: 2, epoch: 5 },
            older_s: None,
            provisional: false,
            held_from: None,
            length_squared: 1.0,
            teams,
            wishes: vec![],
            hysteresis: 0.05,
            dwell_s: 0.5,
            conflict: None,
            skill: None,
            jointly: false,
            settings_assumed: false,
        }
    }

    fn wish(kind: WishKind, team: Option<&str>) -> ReasonWish {
        ReasonWish {
            operator: OperatorId::new("alice").unwrap(),
            id: WishId::new("p1").unwrap(),
            kind,
            team: team.map(|team| TeamId::new(team).unwrap()),
            granted: true,
        }
    }

    fn check(reason: &Reason) -> Result<(), ContentError> {
        let header = Header {
            fleet: FleetId::new("alpha").unwrap(),
            revision: Revision::default(),
            oldest: None,
            newest: None,
            stages: vec![],
        };
        Why { header, reason: reason.clone() }.check()
    }

    #[test]
    fn what_decides_is_named() {
        let own = || team("t1", [0.5, 0.3], 0.0, 0.0);
        let cases: Vec<(Reason, DecidedBy, &str)> = vec![
            (
                reason(vec![own(), team("t2", [0.1, 0.4], 0.0, 0.0)]),
                DecidedBy::Relations,
                "r7 is in t1, which draws it more than t2 by 0.300: hierarchy +0.400, spatial -0.100, all else \
                 +0.000. No team draws it more.",
            ),
            (reason(vec![own()]), DecidedBy::Relations, "r7 is in t1, and there is no other team."),
            (
                reason(vec![own(), team("t2", [0.6, 0.4], 1.0, 0.0)]),
                DecidedBy::Limits,
                "t2 is full (3 robots): its place costs 0.800 more than r7 gains.",
            ),
            (
                reason(vec![team("t1", [0.5, 0.3], -0.5, 0.0), team("t2", [0.6, 0.4], 0.0, 0.0)]),
                DecidedBy::Limits,
                "t1 needs its robots (at least 1)",
            ),
            (
                reason(vec![team("t1", [0.5, 0.3], 0.0, 0.1), team("t2", [0.5, 0.35], 0.0, 0.0)]),
                DecidedBy::Hysteresis,
                "That is less than 0.100: the last division is kept while no other is better by 5 %.",
            ),
            (
                Reason {
                    held_from: Some(TeamId::new("t2").unwrap()),
                    ..reason(vec![own(), team("t2", [0.9, 0.3], 0.0, 0.0)])
                },
                DecidedBy::Dwell,
                "The newest division has it in t2; it changes once every division has said so for 0.5 s.",
            ),
            (
                Reason {
                    wishes: vec![wish(WishKind::Pin, Some("t1"))],
                    ..reason(vec![
                        own(),
                        TeamReason { barred: true, ..team("t2", [0.9, 0.3], 0.0, 0.0) },
                    ])
                },
                DecidedBy::Wishes,
                "The wish alice/p1 holds it in t1.",
            ),
            (
                Reason {
                    wishes: vec![wish(WishKind::Together, None)],
                    ..reason(vec![own(), team("t2", [0.9, 0.3], 0.0, 0.0)])
                },
                DecidedBy::Wishes,
                "The wish alice/p1 keeps it together with others.",
            ),
            (
                Reason {
                    conflict: Some("9 robots, 8 places".to_owned()),
                    ..reason(vec![own(), team("t2", [0.9, 0.3], 0.0, 0.0)])
                },
                DecidedBy::Conflict,
                "the last division stands: 9 robots, 8 places.",
            ),
            (
                Reason {
                    older_s: Some(0.25),
                    provisional: true,
                    ..reason(vec![own(), team("t2", [0.9, 0.3], 0.0, 0.0)])
                },
                DecidedBy::OlderDivision,
                "The division is 0.25 s older than the graphs by which this is computed, and the next one may move \
                 it. Its place is provisional",
            ),
            (
                reason(vec![own(), team("t2", [0.9, 0.3], 0.0, 0.0)]),
                DecidedBy::WholeDivision,
                "the division as a whole is the best that was found",
            ),
            (
                Reason {
                    skill: Some(SkillId::new("medic").unwrap()),
                    ..reason(vec![
                        TeamReason { skill_price: -1.0, ..team("t1", [0.5, 0.3], 0.0, 0.0) }
                            .summed(),
                        team("t2", [0.9, 0.3], 0.0, 0.0),
                    ])
                },
                DecidedBy::Limits,
                "t1 needs robots with medic: without r7 another one would have to come, which costs 0.600 more",
            ),
            (
                Reason {
                    skill: Some(SkillId::new("medic").unwrap()),
                    ..reason(vec![
                        own(),
                        TeamReason { skill_price: 1.0, ..team("t2", [0.9, 0.3], 0.0, 0.0) }
                            .summed(),
                    ])
                },
                DecidedBy::Limits,
                "t2 may have no more robots with medic: its place costs 0.600 more than r7 gains.",
            ),
            (
                Reason { jointly: true, ..reason(vec![own(), team("t2", [0.9, 0.3], 0.0, 0.0)]) },
                DecidedBy::Jointly,
                "found by a search, and no price stands for its place.",
            ),
            (
                Reason {
                    jointly: true,
                    wishes: vec![wish(WishKind::Apart, None)],
                    ..reason(vec![own(), team("t2", [0.9, 0.3], 0.0, 0.0)])
                },
                DecidedBy::Wishes,
                "by a search: no price of limits stands for its place.",
            ),
            (
                Reason {
                    settings_assumed: true,
                    ..reason(vec![own(), team("t2", [0.1, 0.4], 0.0, 0.0)])
                },
                DecidedBy::Relations,
                "clusterer has not answered with its settings: the defaults are assumed",
            ),
        ];
        for (reason, decided_by, text) in cases {
            let decided = reason.decided();
            assert_eq!(decided.decided_by, decided_by, "{}", decided.text);
            assert!(decided.text.contains(text), "{}", decided.text);
            check(&decided).unwrap();
        }
    }

    #[test]
    fn a_reason_whose_parts_do_not_add_up_is_refused() {
        let whole = reason(vec![team("t1", [0.5, 0.3], 0.1, 0.2)]);
        assert!(check(&whole).is_ok());
        let spoil = |spoil: fn(&mut Reason)| {
            let mut spoilt = whole.clone();
            spoil(&mut spoilt);
            check(&spoilt).unwrap_err().field
        };
        assert_eq!(spoil(|reason| reason.teams[0].rest += 1e-6), "teams.total");
        assert_eq!(spoil(|reason| reason.teams[0].price = f64::NAN), "teams");
        assert_eq!(spoil(|reason| reason.length_squared = f64::INFINITY), "teams");
        assert_eq!(spoil(|reason| reason.teams.clear()), "teams");
        assert_eq!(spoil(|reason| reason.team = TeamId::new("t9").unwrap()), "teams");
    }
}

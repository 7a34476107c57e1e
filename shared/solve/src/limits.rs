//! What is asked of the teams: limits, wishes and needs, in a file, of a saved fleet, or with the command.

use std::collections::BTreeMap;

use muster_division::rules::Asked;
use muster_model::id::{RobotId, SkillId, TeamId};
use muster_model::limits::{MAX_GROUP_WISHES, MAX_SKILLS, MAX_WISHES};
use muster_model::settings::{ClustererSettings, Need, Settings, TeamSize, written};
use muster_model::wish::{Wish, WishKind};
use serde_json::Value;

use super::error::{SolveError, refuse};
use super::file::{File, Named};
use super::places::{Places, place};
use super::problem::{Division, Problem};

/// Longest name of a wish in characters; more of it says no more to a reader.
const MAX_WISH_NAME: usize = 48;

/// Why a file with labels asks nothing of its teams.
pub(super) const LABELS_ARE_DIVIDED: &str =
    "must not be given with \"labels\", which are a division already";

/// Limits, wishes and needs that are given with the command.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct LimitOptions {
    /// How many robots each team has: 3..6, 3.., ..6 or a number; instead of what the file says.
    #[arg(long, value_name = "RANGE", value_parser = written::size)]
    pub size: Option<TeamSize>,
    /// How many robots single teams have, all of them; instead of what the file says.
    #[arg(long, value_name = "TEAM=RANGE,…", value_delimiter = ',', value_parser = written::team_size)]
    pub team_size: Vec<(TeamId, TeamSize)>,
    /// How many robots with a skill each team needs at least, or a range, all of them: medic=1, medic=1..2; instead
    /// of what the file says.
    #[arg(long, value_name = "SKILL=COUNT,…", value_delimiter = ',', value_parser = written::need)]
    pub needs: Vec<Need>,
    /// A wish in addition to those of the file: "pin r7 t2", "ban r7 t2", "together r1 r2", "apart r1 r2" or "reserve r9".
    /// May be repeated.
    #[arg(long, value_name = "WISH", value_parser = wish)]
    pub wish: Vec<Wish>,
    /// Robots that are in no team.
    #[arg(long, value_name = "ROBOT,…", value_delimiter = ',')]
    pub without: Vec<RobotId>,
}

impl LimitOptions {
    /// The first that is given, and whether any is.
    fn first(&self) -> Option<&'static str> {
        let all = [
            ("--size", self.size.is_some()),
            ("--team-size", !self.team_size.is_empty()),
            ("--needs", !self.needs.is_empty()),
            ("--wish", !self.wish.is_empty()),
            ("--without", !self.without.is_empty()),
        ];
        all.into_iter().find(|(_, is_given)| *is_given).map(|(flag, _)| flag)
    }
}

/// A wish as it is written on a command line: its kind, then its robots, then its team.
fn wish(text: &str) -> Result<Wish, String> {
    let mut words = text.split_whitespace();
    let kind = words.next().unwrap_or_default();
    let kind: WishKind = serde_json::from_value(Value::from(kind))
        .map_err(|_| "must begin with pin, ban, together, apart or reserve".to_owned())?;
    let mut names: Vec<&str> = words.collect();
    let has_team = matches!(kind, WishKind::Pin | WishKind::Ban | WishKind::Lock);
    let team = if has_team { names.pop() } else { None };
    let team = team.map(TeamId::new).transpose().map_err(|error| error.to_string())?;
    let robots = names.into_iter().map(RobotId::new).collect::<Result<_, _>>();
    let robots = robots.map_err(|error| error.to_string())?;
    let wish = Wish { kind, robots, team, expires: None, note: None };
    let wish = wish.checked().map_err(|error| error.to_string())?;
    refuse_lock(&wish).map_or(Ok(wish), Err)
}

/// Why a wish makes no sense without a last division; none if it does.
fn refuse_lock(wish: &Wish) -> Option<String> {
    let problem =
        "lock keeps the robots that a team has, and here it has none yet: pin them instead";
    (wish.kind == WishKind::Lock).then(|| problem.to_owned())
}

/// What is asked in addition to the settings of the clusterer.
#[derive(Debug, Clone, Default)]
pub(super) struct Asks {
    /// The wishes that count.
    pub(super) wishes: Vec<Asked>,
    /// The skills of robots that are not stale, ordered by name.
    pub(super) skills: BTreeMap<RobotId, Vec<SkillId>>,
}

impl Asks {
    /// The wishes and skills of a file.
    ///
    /// # Errors
    /// Names the wish or the robot that is wrong.
    pub(super) fn of_file(file: &mut File, places: &Places) -> Result<Self, SolveError> {
        let mut asks = Self::default();
        for (robot, rank) in file.ranks.iter().flat_map(|ranks| &ranks.0) {
            asks.add_skills(robot, rank.0.skills.as_deref().unwrap_or_default());
        }
        for (robot, skills) in file.skills.take().map(|skills| skills.0).unwrap_or_default() {
            let field = || format!("skills.{robot}");
            place(places, &robot, field)?;
            asks.add_skills(&robot, &skills);
            let count = asks.skills.get(&robot).map_or(0, Vec::len);
            if count > MAX_SKILLS {
                let problem =
                    format!("may be at most {MAX_SKILLS} with those of its rank, not {count}");
                return refuse(field(), problem);
            }
        }
        for (at, wish) in file.wishes.take().unwrap_or_default().into_iter().enumerate() {
            asks.add_wish(&format!("wishes[{at}]"), wish.0, places)?;
        }
        Ok(asks)
    }

    /// Adds skills of a robot.
    pub(super) fn add_skills(&mut self, robot: &RobotId, skills: &[SkillId]) {
        if skills.is_empty() {
            return;
        }
        let own = self.skills.entry(robot.clone()).or_default();
        own.extend(skills.iter().cloned());
        own.sort_unstable();
        own.dedup();
    }

    /// Adds a wish about robots of the file; `field` is where it stands.
    ///
    /// # Errors
    /// Says what makes no sense.
    fn add_wish(&mut self, field: &str, wish: Wish, places: &Places) -> Result<(), SolveError> {
        let wish = wish
            .checked()
            .or_else(|error| refuse(format!("{field}.{}", error.field), error.problem))?;
        if let Some(problem) = refuse_lock(&wish) {
            return refuse(format!("{field}.kind"), problem);
        }
        for robot in &wish.robots {
            place(places, robot, || format!("{field}.robots"))?;
        }
        let name = name(&wish);
        self.add_asked(Asked { name, wish: Wish { expires: None, note: None, ..wish } })
    }

    /// Adds a wish that is known to make sense.
    ///
    /// # Errors
    /// If there are too many.
    pub(super) fn add_asked(&mut self, asked: Asked) -> Result<(), SolveError> {
        let groups = self.wishes.iter().filter(|asked| asked.wish.kind.is_of_group()).count();
        if self.wishes.len() >= MAX_WISHES {
            return refuse("wishes", format!("there may be {MAX_WISHES} at most"));
        }
        if asked.wish.kind.is_of_group() && groups >= MAX_GROUP_WISHES {
            let problem = format!("there may be {MAX_GROUP_WISHES} of together and apart at most");
            return refuse("wishes", problem);
        }
        self.wishes.push(asked);
        Ok(())
    }
}

/// What readers know a wish by that no one has named: its kind and its names.
fn name(wish: &Wish) -> String {
    let kind = std::iter::once(wish.kind.name().to_owned());
    let robots = wish.robots.iter().map(ToString::to_string);
    let all: Vec<String> =
        kind.chain(robots).chain(wish.team.iter().map(ToString::to_string)).collect();
    let text = all.join("-");
    if text.chars().count() <= MAX_WISH_NAME {
        return text;
    }
    text.chars().take(MAX_WISH_NAME).chain(std::iter::once('…')).collect()
}

/// The settings of the clusterer with the limits and needs of a file.
pub(super) fn with_limits(file: &mut File, settings: ClustererSettings) -> ClustererSettings {
    ClustererSettings {
        size: file.size.take().map_or(settings.size, |size| size.0),
        team_size: file.team_size.take().map_or(settings.team_size, |Named(sizes)| {
            sizes.into_iter().map(|(team, size)| (team, size.0)).collect()
        }),
        needs: file
            .needs
            .take()
            .map_or(settings.needs, |needs| needs.into_iter().map(|need| need.0).collect()),
        ..settings
    }
}

impl Problem {
    /// Asks for what is given with the command, in addition to what the file asks for, or instead of it.
    ///
    /// # Errors
    /// Names the flag that is wrong.
    pub(super) fn ask(&mut self, options: &LimitOptions) -> Result<(), SolveError> {
        let Some(first) = options.first() else { return Ok(()) };
        let Division::Wanted(settings) = &mut self.division else {
            return refuse(first, LABELS_ARE_DIVIDED);
        };
        if let Some(size) = options.size {
            settings.size = size;
        }
        if !options.team_size.is_empty() {
            settings.team_size = options.team_size.iter().cloned().collect();
        }
        if !options.needs.is_empty() {
            settings.needs.clone_from(&options.needs);
        }
        let flag = |field: &str| format!("--{}", field.replacen("team_size", "team-size", 1));
        settings.check().or_else(|error| refuse(flag(&error.field), error.problem))?;
        let places: Places = self.robots.iter().cloned().zip(0..).collect();
        for wish in &options.wish {
            self.asks.add_wish("--wish", wish.clone(), &places)?;
        }
        if !options.without.is_empty() {
            let (kind, robots) = (WishKind::Reserve, options.without.clone());
            let wish = Wish { kind, robots, team: None, expires: None, note: None };
            self.asks.add_wish("--without", wish, &places)?;
        }
        Ok(())
    }
}

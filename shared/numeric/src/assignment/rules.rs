//! Rules of an assignment: unchecked, checked, and what may be wrong with them.

use std::collections::BTreeSet;
use std::fmt;

use thiserror::Error;

use super::costs::MAX_COST;
use super::network::Network;
use super::restrictions::Restrictions;

/// Most columns: the teams that a fleet may have, and the reserve.
pub const MAX_COLUMNS: usize = 1025;

/// Most robots; ten times as many as a fleet may have, and robots × columns still count within 32 bits.
pub const MAX_ROBOTS: usize = 1 << 20;

/// Most exclusive classes: the roles of a fleet are named by people.
pub const MAX_CLASSES: usize = 1024;

/// Most pairs of a column and a class that have limits: each is a node of the flow graph.
pub const MAX_LIMITED_CELLS: usize = 1 << 13;

/// Most entries of the table of best movers, one for each limited class and pair of columns: 2²³ of them take
/// about 100 MB.
const MAX_MOVER_ENTRIES: usize = 1 << 23;

/// Where a robot goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Column {
    /// A team, by its index.
    Team(usize),
    /// No team.
    Reserve,
}

impl fmt::Display for Column {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Team(team) => write!(f, "t{team}"),
            Self::Reserve => write!(f, "the reserve"),
        }
    }
}

/// Least and largest number of robots.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Bounds {
    /// Least number; 0 asks for nothing.
    pub lower: usize,
    /// Largest number; `usize::MAX` for no limit.
    pub upper: usize,
}

impl Bounds {
    /// No limit.
    pub const ANY: Self = Self { lower: 0, upper: usize::MAX };

    /// From `lower` to `upper` robots.
    #[must_use]
    pub const fn new(lower: usize, upper: usize) -> Self {
        Self { lower, upper }
    }

    /// `lower` robots or more.
    #[must_use]
    pub const fn at_least(lower: usize) -> Self {
        Self { lower, upper: usize::MAX }
    }

    /// `upper` robots or fewer.
    #[must_use]
    pub const fn at_most(upper: usize) -> Self {
        Self { lower: 0, upper }
    }
}

impl Default for Bounds {
    fn default() -> Self {
        Self::ANY
    }
}

/// A number of robots that is worth paying for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Wanted {
    /// Number of robots.
    pub count: usize,
    /// Cost of each robot that is missing, from 0 to [`MAX_COST`].
    pub price: i64,
}

/// Limits of one exclusive class in one column. The same column and class may have one only.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ClassLimit {
    /// The column.
    pub column: Column,
    /// The class.
    pub class: usize,
    /// Number of robots of this class there.
    pub bounds: Bounds,
    /// A soft minimum, if there is one.
    pub wanted: Option<Wanted>,
}

/// A rule on one robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Pair {
    /// The robot must be in the column.
    Forced {
        /// The robot.
        robot: usize,
        /// The column.
        column: Column,
    },
    /// The robot must not be in the column.
    Forbidden {
        /// The robot.
        robot: usize,
        /// The column.
        column: Column,
    },
}

impl Pair {
    /// The robot that the rule is on.
    #[must_use]
    pub fn robot(self) -> usize {
        let (Self::Forced { robot, .. } | Self::Forbidden { robot, .. }) = self;
        robot
    }

    /// The column that the rule names.
    #[must_use]
    pub fn column(self) -> Column {
        let (Self::Forced { column, .. } | Self::Forbidden { column, .. }) = self;
        column
    }
}

/// Unchecked rules of an assignment; [`Rules::check`] makes them valid.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Rules {
    /// Number of robots.
    pub robots: usize,
    /// Number of robots in each team, at least one team.
    pub teams: Vec<Bounds>,
    /// Number of robots in the reserve; `None` if every robot has to be in a team.
    pub reserve: Option<Bounds>,
    /// Exclusive class of every robot, for example its role; or empty if no robot has one.
    pub classes: Vec<Option<usize>>,
    /// Limits of classes in columns.
    pub class_limits: Vec<ClassLimit>,
    /// Forced and forbidden pairs. That pairs contradict each other is found when they are solved, as any
    /// other conflict.
    pub pairs: Vec<Pair>,
}

/// The rule that makes no sense.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum RulesError {
    /// There are too many robots.
    #[error("{robots} robots are more than {MAX_ROBOTS}")]
    Robots {
        /// Robots given.
        robots: usize,
    },
    /// There is no team, or there are too many.
    #[error(
        "{teams} teams: there must be at least 1, and with the reserve at most {MAX_COLUMNS} columns"
    )]
    Teams {
        /// Teams given.
        teams: usize,
    },
    /// A least number is above the largest one.
    #[error(
        "{column} must hold at least {lower} and at most {upper} robots: lower the first or raise the second"
    )]
    Bounds {
        /// The column.
        column: Column,
        /// Least number.
        lower: usize,
        /// Largest number.
        upper: usize,
    },
    /// A least number of a class is above the largest one.
    #[error(
        "{column} must hold at least {lower} and at most {upper} robots of class {class}: lower the first or raise the second"
    )]
    ClassBounds {
        /// The column.
        column: Column,
        /// The class.
        class: usize,
        /// Least number.
        lower: usize,
        /// Largest number.
        upper: usize,
    },
    /// Classes are given for another number of robots.
    #[error("{classes} classes for {robots} robots: give one for each, or none at all")]
    Classes {
        /// Classes given.
        classes: usize,
        /// Number of robots.
        robots: usize,
    },
    /// The number of a class is not below [`MAX_CLASSES`].
    #[error("class {class} is not below {MAX_CLASSES}")]
    Class {
        /// The class.
        class: usize,
    },
    /// A column is not there.
    #[error(
        "{column} is not among the columns: there are {teams} teams, and a reserve only where it has bounds"
    )]
    Column {
        /// The column.
        column: Column,
        /// Number of teams.
        teams: usize,
    },
    /// A robot is not there.
    #[error("robot {robot} is not below {robots}")]
    Robot {
        /// The robot.
        robot: usize,
        /// Number of robots.
        robots: usize,
    },
    /// A class has two limits in one column.
    #[error("class {class} has two limits in {column}: join them")]
    Twice {
        /// The column.
        column: Column,
        /// The class.
        class: usize,
    },
    /// The price of a missing robot is negative or too large.
    #[error(
        "the price of a missing robot of class {class} in {column} is {price}: it must be from 0 to {MAX_COST}"
    )]
    Price {
        /// The column.
        column: Column,
        /// The class.
        class: usize,
        /// The price.
        price: i64,
    },
    /// There are too many limits on classes.
    #[error("{limits} limits of {classes} classes are too many for {columns} columns")]
    TooManyLimits {
        /// Limits given.
        limits: usize,
        /// Classes with a limit.
        classes: usize,
        /// Number of columns.
        columns: usize,
    },
}

impl Rules {
    /// Rules for `robots` robots and `teams` teams without any limit and without a reserve.
    #[must_use]
    pub fn new(robots: usize, teams: usize) -> Self {
        Self { robots, teams: vec![Bounds::ANY; teams], ..Self::default() }
    }

    /// Number of columns, with the reserve.
    #[must_use]
    pub fn columns(&self) -> usize {
        self.teams.len() + usize::from(self.reserve.is_some())
    }

    /// Place of a column among all columns: teams in order, then the reserve.
    ///
    /// # Errors
    /// [`RulesError::Column`] if it is not there.
    pub fn index_of(&self, column: Column) -> Result<usize, RulesError> {
        let teams = self.teams.len();
        match column {
            Column::Team(team) if team < teams => Ok(team),
            Column::Reserve if self.reserve.is_some() => Ok(teams),
            _ => Err(RulesError::Column { column, teams }),
        }
    }

    /// The column at a place.
    pub(super) fn column_at(&self, place: usize) -> Column {
        if place < self.teams.len() { Column::Team(place) } else { Column::Reserve }
    }

    /// Bounds of the column at a place.
    pub(super) fn bounds_at(&self, place: usize) -> Bounds {
        self.teams.get(place).copied().or(self.reserve).unwrap_or_default()
    }

    /// Exclusive class of a robot.
    pub(super) fn class_of(&self, robot: usize) -> Option<usize> {
        self.classes.get(robot).copied().flatten()
    }

    /// The rules with the guarantee that each makes sense by itself. Whether all can be satisfied together is
    /// another question, which [`Assigner`](super::Assigner) answers.
    ///
    /// # Errors
    /// The first rule that makes none, as [`RulesError`].
    pub fn check(self) -> Result<ValidRules, RulesError> {
        let (robots, teams) = (self.robots, self.teams.len());
        if robots > MAX_ROBOTS {
            return Err(RulesError::Robots { robots });
        }
        if teams == 0 || self.columns() > MAX_COLUMNS {
            return Err(RulesError::Teams { teams });
        }
        for place in 0..self.columns() {
            let Bounds { lower, upper } = self.bounds_at(place);
            if lower > upper {
                return Err(RulesError::Bounds { column: self.column_at(place), lower, upper });
            }
        }
        if !self.classes.is_empty() && self.classes.len() != robots {
            return Err(RulesError::Classes { classes: self.classes.len(), robots });
        }
        if let Some(&class) = self.classes.iter().flatten().find(|class| **class >= MAX_CLASSES) {
            return Err(RulesError::Class { class });
        }
        self.check_class_limits()?;
        for pair in &self.pairs {
            self.index_of(pair.column())?;
            if pair.robot() >= robots {
                return Err(RulesError::Robot { robot: pair.robot(), robots });
            }
        }
        let network = Network::new(&self);
        let restrictions = Restrictions::of_pairs(&self, &self.pairs);
        Ok(ValidRules { rules: self, network, restrictions })
    }

    fn check_class_limits(&self) -> Result<(), RulesError> {
        let mut seen = BTreeSet::new();
        let mut limited = BTreeSet::new();
        for &ClassLimit { column, class, bounds: Bounds { lower, upper }, wanted } in
            &self.class_limits
        {
            self.index_of(column)?;
            if class >= MAX_CLASSES {
                return Err(RulesError::Class { class });
            }
            if lower > upper {
                return Err(RulesError::ClassBounds { column, class, lower, upper });
            }
            if !seen.insert((class, column)) {
                return Err(RulesError::Twice { column, class });
            }
            if let Some(Wanted { price, .. }) = wanted
                && !(0..=MAX_COST).contains(&price)
            {
                return Err(RulesError::Price { column, class, price });
            }
            limited.insert(class);
        }
        let (limits, classes, columns) = (seen.len(), limited.len(), self.columns());
        if limits > MAX_LIMITED_CELLS || (classes + 1) * columns * columns > MAX_MOVER_ENTRIES {
            return Err(RulesError::TooManyLimits { limits, classes, columns });
        }
        Ok(())
    }
}

/// Rules that [`Rules::check`] found to make sense, each by itself.
#[derive(Debug, Clone)]
pub struct ValidRules {
    rules: Rules,
    pub(super) network: Network,
    pub(crate) restrictions: Restrictions,
}

impl ValidRules {
    /// The rules.
    #[must_use]
    pub fn get(&self) -> &Rules {
        &self.rules
    }

    /// True if the robot may be in the column by its forced and forbidden pairs; false for a robot or a column
    /// that is not there.
    #[must_use]
    pub fn allows(&self, robot: usize, column: Column) -> bool {
        let place = self.rules.index_of(column);
        robot < self.rules.robots && place.is_ok_and(|at| self.restrictions.allows(robot, at))
    }
}

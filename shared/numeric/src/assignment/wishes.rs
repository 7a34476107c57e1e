//! Wishes and needs that no flow expresses in general: unchecked, checked, and what may be wrong.

use thiserror::Error;

use super::costs::MAX_COST;
use super::rules::{Column, RulesError, ValidRules};

/// Most wishes that robots be together or apart: the search may have to look at every combination.
pub const MAX_WISHES: usize = 64;

/// Most needs: sixteen skills in each of 64 teams.
pub const MAX_NEEDS: usize = 1024;

/// What some robots should be to each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Relation {
    /// All in the same column; the reserve is one, too.
    Together,
    /// No two in the same team. In the reserve they are in no team, and so never too near.
    Apart,
}

/// A wish about a group of robots.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Wish {
    /// What the robots should be to each other.
    pub relation: Relation,
    /// The robots, at least two different ones.
    pub robots: Vec<usize>,
    /// Cost of not granting the wish, from 0 to [`MAX_COST`]; `None` if it must be granted.
    pub price: Option<i64>,
}

/// How many robots with some skill a column needs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Need {
    /// All robots with the skill. Needs of the same skill list the same robots.
    pub robots: Vec<usize>,
    /// Where they are needed.
    pub column: Column,
    /// How many are needed.
    pub at_least: usize,
    /// How many there may be; `usize::MAX` for no limit. It holds whatever the price is.
    pub at_most: usize,
    /// Cost of each that is missing, from 0 to [`MAX_COST`]; `None` if none may be missing.
    pub price: Option<i64>,
}

/// Unchecked wishes and needs; [`Wishes::check`] makes them valid.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Wishes {
    /// Groups that should be together or apart, at most [`MAX_WISHES`].
    pub wishes: Vec<Wish>,
    /// Skills that columns need, at most [`MAX_NEEDS`].
    pub needs: Vec<Need>,
}

/// The wish or need that makes no sense.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum WishesError {
    /// There are too many.
    #[error("{wishes} wishes and {needs} needs: there may be {MAX_WISHES} and {MAX_NEEDS}")]
    TooMany {
        /// Wishes given.
        wishes: usize,
        /// Needs given.
        needs: usize,
    },
    /// A wish names fewer than two different robots.
    #[error("wish {wish} needs at least two different robots")]
    Group {
        /// The wish.
        wish: usize,
    },
    /// A robot of a wish is not there.
    #[error("wish {wish} names robot {robot}, which is not below {robots}")]
    WishRobot {
        /// The wish.
        wish: usize,
        /// The robot.
        robot: usize,
        /// Number of robots.
        robots: usize,
    },
    /// A robot of a need is not there.
    #[error("need {need} names robot {robot}, which is not below {robots}")]
    NeedRobot {
        /// The need.
        need: usize,
        /// The robot.
        robot: usize,
        /// Number of robots.
        robots: usize,
    },
    /// The column of a need is not there.
    #[error("need {need}: {error}")]
    Column {
        /// The need.
        need: usize,
        /// What is wrong with the column.
        error: RulesError,
    },
    /// A need asks for more robots than it allows.
    #[error(
        "need {need} is at least {at_least} and at most {at_most}: lower the first or raise the second"
    )]
    Bounds {
        /// The need.
        need: usize,
        /// Least number.
        at_least: usize,
        /// Largest number.
        at_most: usize,
    },
    /// A price is negative or too large.
    #[error("a price of {price} is not from 0 to {MAX_COST}")]
    Price {
        /// The price.
        price: i64,
    },
}

impl Wishes {
    /// The wishes with the guarantee that each makes sense by itself for the robots and columns of `rules`.
    ///
    /// # Errors
    /// The first that makes none, as [`WishesError`].
    pub fn check(mut self, rules: &ValidRules) -> Result<ValidWishes, WishesError> {
        let (wishes, needs) = (self.wishes.len(), self.needs.len());
        if wishes > MAX_WISHES || needs > MAX_NEEDS {
            return Err(WishesError::TooMany { wishes, needs });
        }
        let robots = rules.get().robots;
        let prices = self.wishes.iter().map(|wish| wish.price);
        for price in prices.chain(self.needs.iter().map(|need| need.price)).flatten() {
            if !(0..=MAX_COST).contains(&price) {
                return Err(WishesError::Price { price });
            }
        }
        for (number, wish) in self.wishes.iter_mut().enumerate() {
            wish.robots.sort_unstable();
            wish.robots.dedup();
            if let Some(&robot) = wish.robots.last().filter(|robot| **robot >= robots) {
                return Err(WishesError::WishRobot { wish: number, robot, robots });
            }
            if wish.robots.len() < 2 {
                return Err(WishesError::Group { wish: number });
            }
        }
        for (number, need) in self.needs.iter_mut().enumerate() {
            need.robots.sort_unstable();
            need.robots.dedup();
            if let Some(&robot) = need.robots.last().filter(|robot| **robot >= robots) {
                return Err(WishesError::NeedRobot { need: number, robot, robots });
            }
            let Need { at_least, at_most, .. } = *need;
            if at_least > at_most {
                return Err(WishesError::Bounds { need: number, at_least, at_most });
            }
            if let Err(error) = rules.get().index_of(need.column) {
                return Err(WishesError::Column { need: number, error });
            }
        }
        Ok(ValidWishes(self))
    }
}

/// Wishes that [`Wishes::check`] found to make sense, each by itself. Their robots are sorted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ValidWishes(Wishes);

impl ValidWishes {
    /// The wishes.
    #[must_use]
    pub fn get(&self) -> &Wishes {
        &self.0
    }
}

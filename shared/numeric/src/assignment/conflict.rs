//! Rules that cannot all be satisfied, and the count that shows it.

use std::fmt;

use super::rules::{Column, Pair};

/// One rule of a conflict.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Rule {
    /// A column must hold at least this many robots, of one class if one is named.
    Least {
        /// The column.
        column: Column,
        /// The class that counts; `None` for all robots.
        class: Option<usize>,
        /// Least number of robots.
        count: usize,
    },
    /// A column must hold at most this many robots, of one class if one is named.
    Most {
        /// The column.
        column: Column,
        /// The class that counts; `None` for all robots.
        class: Option<usize>,
        /// Largest number of robots.
        count: usize,
    },
    /// A forced or forbidden pair.
    Pair(Pair),
}

/// The count that shows that rules contradict each other: the cut of the flow graph (Hoffman's condition; of
/// upper bounds alone, that of Hall, Journal of the London Mathematical Society 10, 1935).
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Imbalance {
    /// Robots, and others that the least numbers ask for, have to share places that are too few:
    /// robots + Σ least > Σ most.
    Crowded {
        /// Robots that may only be within these places.
        robots: Vec<usize>,
        /// Least numbers of other robots within these places.
        least: Vec<Rule>,
        /// Largest numbers, which bound the places.
        most: Vec<Rule>,
    },
    /// Least numbers ask for more robots than may be there: Σ least > robots + Σ most.
    Lacking {
        /// Robots that may be there.
        robots: Vec<usize>,
        /// Least numbers.
        least: Vec<Rule>,
        /// Largest numbers of other robots that may come to help.
        most: Vec<Rule>,
    },
}

/// An irreducible conflict: its rules cannot all be satisfied, and would be without any one of them.
///
/// The text numbers robots as `r0`, teams as `t0` and classes as `class 0`, each from zero.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Conflict {
    /// The rules, sorted.
    pub rules: Vec<Rule>,
    /// Why they contradict each other.
    pub imbalance: Imbalance,
}

impl Rule {
    /// The number of a limit; 0 for a pair.
    fn count(&self) -> usize {
        match self {
            Self::Least { count, .. } | Self::Most { count, .. } => *count,
            Self::Pair(_) => 0,
        }
    }

    /// Column and class of a limit.
    fn place(&self) -> Option<(Column, Option<usize>)> {
        match *self {
            Self::Least { column, class, .. } | Self::Most { column, class, .. } => {
                Some((column, class))
            }
            Self::Pair(_) => None,
        }
    }
}

impl Imbalance {
    /// Robots that are asked for or have to be placed; always more than [`Imbalance::supply`].
    #[must_use]
    pub fn demand(&self) -> usize {
        match self {
            Self::Crowded { robots, least, .. } => robots.len() + total(least),
            Self::Lacking { least, .. } => total(least),
        }
    }

    /// Places or robots that are there.
    #[must_use]
    pub fn supply(&self) -> usize {
        match self {
            Self::Crowded { most, .. } => total(most),
            Self::Lacking { robots, most, .. } => robots.len() + total(most),
        }
    }
}

fn total(rules: &[Rule]) -> usize {
    rules.iter().map(Rule::count).fold(0, usize::saturating_add)
}

/// The class that all limits name alike; `None` if they differ or there are none.
fn common_class(rules: &[Rule]) -> Option<Option<usize>> {
    let class = rules.first()?.place()?.1;
    rules.iter().all(|rule| rule.place().is_some_and(|at| at.1 == class)).then_some(class)
}

/// "a", "a and b", "a, b and c".
fn list(names: &[String]) -> String {
    match names {
        [] => "nowhere".to_owned(),
        [one] => one.clone(),
        [rest @ .., last] => format!("{} and {last}", rest.join(", ")),
    }
}

fn columns_of(rules: &[Rule]) -> String {
    let names: Vec<String> =
        rules.iter().filter_map(|rule| Some(rule.place()?.0.to_string())).collect();
    list(&names)
}

/// "9 robots", "1 robot of class 2".
fn robots_text(count: usize, class: Option<usize>) -> String {
    let noun = if count == 1 { "robot" } else { "robots" };
    class.map_or(format!("{count} {noun}"), |class| format!("{count} {noun} of class {class}"))
}

impl fmt::Display for Rule {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Least { column, class, count } => {
                write!(f, "at least {} in {column}", robots_text(count, class))
            }
            Self::Most { column, class, count } => {
                write!(f, "at most {} in {column}", robots_text(count, class))
            }
            Self::Pair(Pair::Forced { robot, column }) => write!(f, "r{robot} in {column}"),
            Self::Pair(Pair::Forbidden { robot, column }) => write!(f, "r{robot} not in {column}"),
        }
    }
}

impl fmt::Display for Imbalance {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (demand, supply) = (self.demand(), self.supply());
        match self {
            Self::Crowded { robots, least, most } if least.is_empty() => {
                if let ([robot], []) = (&robots[..], &most[..]) {
                    return write!(f, "r{robot} may be nowhere");
                }
                if let Some(class) = common_class(most) {
                    let who = robots_text(robots.len(), class);
                    let verb = if most.len() == 1 { "holds" } else { "hold" };
                    return write!(
                        f,
                        "{who} may only be in {}, which {verb} {supply}",
                        columns_of(most)
                    );
                }
            }
            Self::Lacking { least, most, .. } if most.is_empty() => {
                if let Some(class) = common_class(least) {
                    let who = robots_text(demand, class);
                    let verb = if least.len() == 1 { "needs" } else { "need" };
                    return write!(
                        f,
                        "{} {verb} {who}, and {supply} may be there",
                        columns_of(least)
                    );
                }
            }
            _ => {}
        }
        let (Self::Crowded { robots, least, most } | Self::Lacking { robots, least, most }) = self;
        let asked = least.iter().map(ToString::to_string);
        let given = most.iter().map(ToString::to_string);
        let own = (!robots.is_empty()).then(|| robots_text(robots.len(), None));
        let (demands, supplies): (Vec<String>, Vec<String>) = match self {
            Self::Crowded { .. } => (own.into_iter().chain(asked).collect(), given.collect()),
            Self::Lacking { .. } => (asked.collect(), own.into_iter().chain(given).collect()),
        };
        write!(f, "{} make {demand}, but there can only be ", list(&demands))?;
        write!(f, "{supply}: {}", list(&supplies))
    }
}

impl fmt::Display for Conflict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.imbalance.fmt(f)
    }
}

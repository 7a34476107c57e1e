//! Solves assignments that are read from standard input, for `tests/peers/check_assignment.py`.
//!
//! Everything is an integer, one after the other; −1 stands for none. A case is: robots, teams, 1 with a reserve or 0;
//! lower and upper bound of every column; class of every robot; the number of class limits, each as column, class,
//! lower, upper, wanted, price; the number of pairs, each as 0 (forced) or 1 (forbidden), robot, column; the number of
//! wishes, each as 0 (together) or 1 (apart), price, robots; the number of needs, each as column, at least, price,
//! robots; the budget of nodes; and the costs by rows. A list of robots begins with its length. The answer is one line:
//! `found COST BOUND COLUMNS`, `conflict RULES`, or `refused WISHES | NEEDS | IRREDUCIBLE`.

use std::error::Error;
use std::io::{Read, Write};

use muster_numeric::assignment::{
    Assigner, AssignmentError, Bounds, ClassLimit, Column, CostMatrix, DivisionError, Need, Pair,
    Relation, Rule, Rules, Wanted, Wish, Wishes, assign_with_wishes,
};

type Failure = Box<dyn Error>;

fn main() -> Result<(), Failure> {
    let mut text = String::new();
    std::io::stdin().read_to_string(&mut text)?;
    let mut input = Input { tokens: text.split_ascii_whitespace() };
    let mut out = std::io::stdout().lock();
    while let Some(robots) = input.next() {
        writeln!(out, "{}", solve(robots.parse()?, &mut input)?)?;
    }
    Ok(())
}

struct Input<'a> {
    tokens: std::str::SplitAsciiWhitespace<'a>,
}

impl<'a> Input<'a> {
    fn next(&mut self) -> Option<&'a str> {
        self.tokens.next()
    }

    fn number(&mut self) -> Result<i64, Failure> {
        Ok(self.next().ok_or("the input ends within a case")?.parse()?)
    }

    fn count(&mut self) -> Result<usize, Failure> {
        Ok(usize::try_from(self.number()?)?)
    }

    fn optional(&mut self) -> Result<Option<i64>, Failure> {
        Ok(Some(self.number()?).filter(|number| *number >= 0))
    }

    fn bounds(&mut self) -> Result<Bounds, Failure> {
        let lower = self.count()?;
        let upper = self.optional()?.map_or(Ok(usize::MAX), usize::try_from)?;
        Ok(Bounds { lower, upper })
    }

    fn robots(&mut self) -> Result<Vec<usize>, Failure> {
        (0..self.count()?).map(|_| self.count()).collect()
    }
}

fn solve(robots: usize, input: &mut Input<'_>) -> Result<String, Failure> {
    let mut rules = Rules::new(robots, input.count()?);
    let teams = rules.teams.len();
    let column = |at: usize| if at < teams { Column::Team(at) } else { Column::Reserve };
    let reserve = input.count()? == 1;
    for team in 0..teams {
        rules.teams[team] = input.bounds()?;
    }
    rules.reserve = if reserve { Some(input.bounds()?) } else { None };
    for _ in 0..robots {
        rules.classes.push(input.optional()?.map(usize::try_from).transpose()?);
    }
    for _ in 0..input.count()? {
        let (column, class) = (column(input.count()?), input.count()?);
        let bounds = input.bounds()?;
        let (count, price) = (input.optional()?, input.number()?);
        let count = count.map(usize::try_from).transpose()?;
        let wanted = count.map(|count| Wanted { count, price });
        rules.class_limits.push(ClassLimit { column, class, bounds, wanted });
    }
    for _ in 0..input.count()? {
        let forced = input.count()? == 0;
        let (robot, column) = (input.count()?, column(input.count()?));
        let pair =
            if forced { Pair::Forced { robot, column } } else { Pair::Forbidden { robot, column } };
        rules.pairs.push(pair);
    }
    let mut wishes = Wishes::default();
    for _ in 0..input.count()? {
        let relation = if input.count()? == 0 { Relation::Together } else { Relation::Apart };
        let price = input.optional()?;
        wishes.wishes.push(Wish { relation, price, robots: input.robots()? });
    }
    for _ in 0..input.count()? {
        let (column, at_least) = (column(input.count()?), input.count()?);
        let price = input.optional()?;
        let at_most = usize::MAX;
        wishes.needs.push(Need { column, at_least, at_most, price, robots: input.robots()? });
    }
    let budget = input.count()?;
    let columns = rules.columns();
    let costs: Result<Vec<i64>, Failure> = (0..robots * columns).map(|_| input.number()).collect();
    let costs = CostMatrix::new(robots, columns, costs?)?;
    let plain = wishes.wishes.is_empty() && wishes.needs.is_empty();
    let valid = rules.check()?;
    let mut assigner = Assigner::new();
    let found = if plain {
        assigner.solve(&valid, &costs).map_err(DivisionError::from).and_then(|found| {
            let bound = assigner.certificate(&valid, &costs)?.bound;
            Ok((found.cost, bound, found.columns))
        })
    } else {
        let wishes = wishes.check(&valid)?;
        let found = assign_with_wishes(&mut assigner, &valid, &wishes, &costs, budget);
        found.map(|found| (found.cost, found.bound, found.columns))
    };
    let place = |column| valid.get().index_of(column);
    Ok(match found {
        Ok((cost, bound, columns)) => {
            let places: Result<Vec<usize>, _> = columns.into_iter().map(place).collect();
            format!("found {cost} {bound} {}", joined(&places?))
        }
        Err(DivisionError::Assignment(AssignmentError::Infeasible(conflict))) => {
            let rules: Result<Vec<String>, Failure> =
                conflict.rules.iter().map(|rule| written(rule, teams)).collect();
            format!("conflict {}", rules?.join(" ; "))
        }
        Err(DivisionError::Infeasible { wishes, needs, irreducible }) => {
            format!("refused {} | {} | {irreducible}", joined(&wishes), joined(&needs))
        }
        Err(error) => return Err(error.into()),
    })
}

fn joined(numbers: &[usize]) -> String {
    numbers.iter().map(ToString::to_string).collect::<Vec<_>>().join(" ")
}

/// A rule as a word and numbers.
fn written(rule: &Rule, teams: usize) -> Result<String, Failure> {
    let place = |column: &Column| match column {
        Column::Team(team) => *team,
        Column::Reserve => teams,
    };
    let class = |class: &Option<usize>| class.map_or(-1, |class| class as i64);
    Ok(match rule {
        Rule::Least { column, class: of, count } => {
            format!("least {} {} {count}", place(column), class(of))
        }
        Rule::Most { column, class: of, count } => {
            format!("most {} {} {count}", place(column), class(of))
        }
        Rule::Pair(Pair::Forced { robot, column }) => format!("forced {robot} {}", place(column)),
        Rule::Pair(Pair::Forbidden { robot, column }) => {
            format!("forbidden {robot} {}", place(column))
        }
    })
}

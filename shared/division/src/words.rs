//! Conflicts of rules in the words of operators: with the names of robots and teams, and the numbers that do not fit.

use muster_model::id::{RobotId, SkillId, TeamId};
use muster_model::limits::MAX_CONFLICT_LENGTH;
use muster_numeric::assignment::{Column, Conflict, Imbalance, Pair, Rule};

/// Most names in one list of a text: more are counted.
const MAX_NAMES: usize = 8;

/// Why rules contradict each other. `columns`, `robots` and the `skills` of the classes are those of the rules.
pub(crate) fn conflict(
    conflict: &Conflict,
    columns: &[TeamId],
    robots: &[&RobotId],
    skills: &[&SkillId],
) -> String {
    let names = Names { columns, robots, skills };
    let text = names.imbalance(&conflict.imbalance);
    text.chars().take(MAX_CONFLICT_LENGTH).collect()
}

/// The names of a conflict.
struct Names<'a> {
    columns: &'a [TeamId],
    robots: &'a [&'a RobotId],
    skills: &'a [&'a SkillId],
}

impl Names<'_> {
    fn column(&self, column: Column) -> String {
        match column {
            Column::Team(at) => self.columns.get(at).map_or_else(String::new, ToString::to_string),
            Column::Reserve => "the reserve".to_owned(),
        }
    }

    fn robot(&self, robot: usize) -> &str {
        self.robots.get(robot).map_or("a robot", |robot| robot.as_str())
    }

    /// The teams of limits.
    fn columns(&self, rules: &[Rule]) -> String {
        let column = |rule: &Rule| match *rule {
            Rule::Least { column, .. } | Rule::Most { column, .. } => self.column(column),
            Rule::Pair(pair) => self.column(pair.column()),
        };
        list(&rules.iter().map(column).collect::<Vec<_>>())
    }

    fn rule(&self, rule: &Rule) -> String {
        match *rule {
            Rule::Least { column, class, count } => {
                format!("at least {} in {}", self.robots(count, class), self.column(column))
            }
            Rule::Most { column, class, count } => {
                format!("at most {} in {}", self.robots(count, class), self.column(column))
            }
            Rule::Pair(Pair::Forced { robot, column }) => {
                format!("{} in {}", self.robot(robot), self.column(column))
            }
            Rule::Pair(Pair::Forbidden { robot, column }) => {
                format!("{} not in {}", self.robot(robot), self.column(column))
            }
        }
    }

    fn imbalance(&self, imbalance: &Imbalance) -> String {
        let (demand, supply) = (imbalance.demand(), imbalance.supply());
        match imbalance {
            Imbalance::Crowded { robots, least, most }
                if least.is_empty() && common_class(most).is_some() =>
            {
                let who = self.robots(robots.len(), common_class(most).flatten());
                if most.is_empty() {
                    return format!("{who} may be in no team");
                }
                let verb = if most.len() == 1 { "holds" } else { "hold" };
                format!("{who} may only be in {}, which {verb} {supply}", self.columns(most))
            }
            Imbalance::Lacking { least, most, .. }
                if most.is_empty() && common_class(least).is_some() =>
            {
                let verb = if least.len() == 1 { "needs" } else { "need" };
                let who = self.robots(demand, common_class(least).flatten());
                format!("{} {verb} {who}, and {supply} may be there", self.columns(least))
            }
            Imbalance::Crowded { robots, least, most } => {
                let asked = self.sum(robots.len(), least);
                format!(
                    "{asked} make {demand}, but there can only be {supply}: {}",
                    self.sum(0, most)
                )
            }
            Imbalance::Lacking { robots, least, most } => {
                let given = self.sum(robots.len(), most);
                format!(
                    "{} make {demand}, but there can only be {supply}: {given}",
                    self.sum(0, least)
                )
            }
        }
    }

    /// "9 robots", "1 robot with medic".
    fn robots(&self, count: usize, class: Option<usize>) -> String {
        let skill = class.and_then(|class| self.skills.get(class));
        let who = robots_text(count);
        skill.map_or(who.clone(), |skill| format!("{who} with {skill}"))
    }

    /// So many robots and some rules, as a list.
    fn sum(&self, robots: usize, rules: &[Rule]) -> String {
        let own = (robots > 0).then(|| robots_text(robots));
        list(&own.into_iter().chain(rules.iter().map(|rule| self.rule(rule))).collect::<Vec<_>>())
    }
}

/// The class that all rules name alike, none for all robots; none if they differ.
fn common_class(rules: &[Rule]) -> Option<Option<usize>> {
    let class = |rule: &Rule| match *rule {
        Rule::Least { class, .. } | Rule::Most { class, .. } => class,
        Rule::Pair(_) => None,
    };
    let first = rules.first().and_then(class);
    rules.iter().all(|rule| class(rule) == first).then_some(first)
}

/// "9 robots", "1 robot".
fn robots_text(count: usize) -> String {
    plural(count, "robot")
}

/// A count with its noun: "1 robot", "9 robots".
pub fn plural(count: usize, what: &str) -> String {
    if count == 1 { format!("1 {what}") } else { format!("{count} {what}s") }
}

/// "a", "a and b", "a, b and c", "a, b, … and 5 more".
pub fn list(names: &[String]) -> String {
    if names.len() > MAX_NAMES {
        let more = names.len() - MAX_NAMES;
        return format!("{} and {more} more", names[..MAX_NAMES].join(", "));
    }
    match names {
        [] => "nowhere".to_owned(),
        [one] => one.clone(),
        [rest @ .., last] => format!("{} and {last}", rest.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use muster_numeric::assignment::{Assigner, AssignmentError, Bounds, CostMatrix, Rules};

    use super::*;

    /// The text for so many robots in teams with bounds.
    fn text(robots: usize, bounds: &[Bounds]) -> String {
        let rules = Rules { robots, teams: bounds.to_vec(), ..Rules::default() }.check().unwrap();
        let costs = CostMatrix::new(robots, bounds.len(), vec![0; robots * bounds.len()]).unwrap();
        let columns: Vec<TeamId> = (1..).map(TeamId::numbered).take(bounds.len()).collect();
        let names: Vec<RobotId> =
            (0..robots).map(|at| RobotId::new(format!("r{at}")).unwrap()).collect();
        let Err(AssignmentError::Infeasible(found)) = Assigner::new().solve(&rules, &costs) else {
            panic!("something satisfies the rules");
        };
        conflict(&found, &columns, &names.iter().collect::<Vec<_>>(), &[])
    }

    #[test]
    fn the_arithmetic_stands_in_plain_words() {
        let most = |most: usize| Bounds::at_most(most);
        assert_eq!(text(9, &[most(4), most(4)]), "9 robots may only be in t1 and t2, which hold 8");
        assert_eq!(text(1, &[most(0)]), "1 robot may only be in t1, which holds 0");
        let least = |least: usize| Bounds::at_least(least);
        assert_eq!(
            text(5, &[least(2), least(2), least(2)]),
            "t1, t2 and t3 need 6 robots, and 5 may be there"
        );
        let many = text(40, &[most(2); 12]);
        assert!(many.contains("t8 and 4 more, which hold 24"), "{many}");
    }

    #[test]
    fn a_long_text_is_cut() {
        assert!(text(4000, &[Bounds::at_most(1); 1000]).chars().count() <= MAX_CONFLICT_LENGTH);
    }
}

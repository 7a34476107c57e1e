//! Wishes and needs that become limits of classes, and so need no search.
//!
//! Robots that must be apart are a class of which each team holds at most one; robots with a skill are a class
//! of which a team holds at least as many as it needs. Both are exact as long as no robot would be in two classes.

use super::rules::{Bounds, ClassLimit, Column, Rules, RulesError, ValidRules, Wanted};
use super::wishes::{Need, Relation, ValidWishes, Wish, Wishes};

/// Rules with what became limits, and the wishes and needs that are left.
pub(super) struct Split<'a> {
    pub(super) rules: ValidRules,
    pub(super) wishes: Vec<&'a Wish>,
    pub(super) needs: Vec<&'a Need>,
}

/// Makes limits of those wishes and needs for which `chosen_wishes` and `chosen_needs` are true, as far as
/// robots are in no two classes, in their order.
pub(super) fn split<'a>(
    rules: &ValidRules,
    wishes: &'a Wishes,
    chosen_wishes: &[bool],
    chosen_needs: &[bool],
) -> Result<Split<'a>, RulesError> {
    let mut current = rules.clone();
    let mut left = Vec::new();
    for (wish, _) in wishes.wishes.iter().zip(chosen_wishes).filter(|(_, chosen)| **chosen) {
        let apart = wish.relation == Relation::Apart && wish.price.is_none();
        let limits = one_per_team(rules);
        match with_class(&current, &wish.robots, limits).filter(|_| apart) {
            Some(next) => current = next,
            None => left.push(wish),
        }
    }
    let mut open: Vec<&Need> = wishes
        .needs
        .iter()
        .zip(chosen_needs)
        .filter(|(_, chosen)| **chosen)
        .map(|(n, _)| n)
        .collect();
    let mut left_needs = Vec::new();
    while let Some(first) = open.first() {
        let robots = &first.robots;
        let (same, other): (Vec<&Need>, Vec<&Need>) =
            open.iter().partition(|need| need.robots == *robots);
        match class_limits(&same).and_then(|limits| with_class(&current, robots, limits)) {
            Some(next) => current = next,
            None => left_needs.extend(same),
        }
        open = other;
    }
    Ok(Split { rules: current, wishes: left, needs: left_needs })
}

/// Rules in which groups that are to be apart are limits of classes.
#[derive(Debug, Clone)]
pub struct ApartClasses {
    /// The rules with those limits.
    pub rules: ValidRules,
    /// The place of each wish that became one, and its class.
    pub classes: Vec<(usize, usize)>,
}

/// Makes limits of classes of the groups that are to be apart at any price, as far as no robot is in two classes.
#[must_use]
pub fn apart_as_classes(rules: &ValidRules, wishes: &ValidWishes) -> ApartClasses {
    let mut all = ApartClasses { rules: rules.clone(), classes: Vec::new() };
    for (place, wish) in wishes.get().wishes.iter().enumerate() {
        if wish.relation != Relation::Apart || wish.price.is_some() {
            continue;
        }
        let limits = one_per_team(&all.rules);
        let next = with_class(&all.rules, &wish.robots, limits);
        let class = |next: &ValidRules| next.get().class_of(*wish.robots.first()?);
        if let Some(next) = next
            && let Some(class) = class(&next)
        {
            all.rules = next;
            all.classes.push((place, class));
        }
    }
    all
}

/// At most one robot of a class in each team.
fn one_per_team(rules: &ValidRules) -> Vec<ClassLimit> {
    let limit = |team| ClassLimit {
        column: Column::Team(team),
        class: 0,
        bounds: Bounds::at_most(1),
        wanted: None,
    };
    (0..rules.get().teams.len()).map(limit).collect()
}

/// Limits that stand for needs of one skill; `None` if two soft needs are for one column, or two contradict each other.
fn class_limits(needs: &[&Need]) -> Option<Vec<ClassLimit>> {
    let mut limits: Vec<ClassLimit> = Vec::new();
    for need in needs {
        let at = limits.iter().position(|limit| limit.column == need.column);
        let at = at.unwrap_or_else(|| {
            let column = need.column;
            limits.push(ClassLimit { column, class: 0, bounds: Bounds::ANY, wanted: None });
            limits.len() - 1
        });
        let limit = &mut limits[at];
        limit.bounds.upper = limit.bounds.upper.min(need.at_most);
        match need.price {
            None => limit.bounds.lower = limit.bounds.lower.max(need.at_least),
            Some(_) if limit.wanted.is_some() => return None,
            Some(price) => limit.wanted = Some(Wanted { count: need.at_least, price }),
        }
    }
    limits.iter().all(|limit| limit.bounds.lower <= limit.bounds.upper).then_some(limits)
}

/// The rules with `robots` as a further class; `None` if one of them has a class, or limits become too many.
fn with_class(rules: &ValidRules, robots: &[usize], limits: Vec<ClassLimit>) -> Option<ValidRules> {
    let before = rules.get();
    if robots.iter().any(|robot| before.class_of(*robot).is_some()) {
        return None;
    }
    let named = before.classes.iter().flatten().copied();
    let limited = before.class_limits.iter().map(|limit| limit.class);
    let class = named.chain(limited).max().map_or(0, |class| class + 1);
    let mut next: Rules = before.clone();
    next.classes.resize(next.robots, None);
    for &robot in robots {
        next.classes[robot] = Some(class);
    }
    next.class_limits.extend(limits.into_iter().map(|limit| ClassLimit { class, ..limit }));
    next.check().ok()
}

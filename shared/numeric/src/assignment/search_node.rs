//! One node of the search: its restrictions, its bound, and how to branch.
//!
//! The relaxation of a node drops the wishes, and moves each need into the costs by a multiplier λ ≥ 0
//! (Fisher, Management Science 27, 1981): a robot with the skill costs λ less where it is needed, and the bound
//! gains λ for each robot that is needed. A multiplier above the price of a missing robot would be no bound.

use super::assigner::Assigner;
use super::costs::{CostMatrix, MAX_COST};
use super::exact_wishes::Split;
use super::restrictions::Restrictions;
use super::rules::ValidRules;
use super::wishes::{Need, Relation, Wish};

/// A choice on the way to a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Choice {
    /// The robot is in the column.
    In { robot: usize, column: usize },
    /// The robot is not in the column.
    Out { robot: usize, column: usize },
    /// The wish is not granted, and paid for.
    Broken { wish: usize },
}

/// The problem that is searched, with its multipliers.
pub(super) struct Problem<'a> {
    pub(super) rules: ValidRules,
    wishes: Vec<&'a Wish>,
    needs: Vec<&'a Need>,
    /// Place of the column of each need.
    places: Vec<usize>,
    /// Largest multiplier of each need.
    caps: Vec<i64>,
    pub(super) multipliers: Vec<i64>,
    costs: CostMatrix,
}

/// What a node says.
pub(super) struct Outcome {
    /// No division of the node costs less.
    pub(super) bound: i128,
    /// Column of every robot in the relaxation.
    pub(super) labels: Vec<u32>,
    /// What `labels` cost, if they satisfy everything that is hard.
    pub(super) cost: Option<i128>,
    /// Robots that each need misses, negative for those beyond it.
    pub(super) missing: Vec<i64>,
    /// The nodes to go on with, the most promising last; none if the bound is the best cost of the node.
    pub(super) children: Vec<Vec<Choice>>,
}

impl<'a> Problem<'a> {
    /// The problem of what is left of wishes and needs.
    pub(super) fn new(split: Split<'a>, costs: &CostMatrix) -> Self {
        let Split { rules, wishes, needs } = split;
        let place = |need: &&Need| rules.get().index_of(need.column).unwrap_or(0);
        let places: Vec<usize> = needs.iter().map(place).collect();
        // Costs less all multipliers stay within a small multiple of the largest cost.
        let cap = MAX_COST / needs.len().max(1) as i64;
        let caps =
            needs.iter().map(|need| need.price.map_or(cap, |price| price.min(cap))).collect();
        let multipliers = vec![0; needs.len()];
        Self { rules, wishes, needs, places, caps, multipliers, costs: costs.clone() }
    }

    /// True if multipliers can help.
    pub(super) fn has_needs(&self) -> bool {
        !self.needs.is_empty()
    }

    /// Moves the multipliers by `step` for each robot that a need misses.
    pub(super) fn climb(&mut self, missing: &[i64], step: i64) {
        for ((value, cap), missing) in self.multipliers.iter_mut().zip(&self.caps).zip(missing) {
            *value = value.saturating_add(step.saturating_mul(*missing)).clamp(0, *cap);
        }
    }

    /// Largest extra cost of a robot in a column that needs it.
    pub(super) fn largest_detour(&self) -> i64 {
        let detours = self.needs.iter().zip(&self.places).flat_map(|(need, place)| {
            need.robots.iter().filter_map(|robot| {
                let row = self.costs.row(*robot);
                Some(row[*place] - row.iter().min()?)
            })
        });
        detours.max().unwrap_or(0)
    }

    /// Solves the relaxation of a node; `None` if the node holds no division.
    pub(super) fn evaluate(
        &mut self,
        choices: &[Choice],
        assigner: &mut Assigner,
    ) -> Option<Outcome> {
        let (restrictions, broken) = self.restrict(choices)?;
        let multipliers: Vec<i64> =
            (0..self.needs.len()).map(|need| self.multiplier(need, &restrictions)).collect();
        self.charge(&multipliers, -1);
        let solved = assigner.solve_restricted(&self.rules.network, &restrictions, &self.costs);
        self.charge(&multipliers, 1);
        let relaxed = solved.ok()?.cost;
        let labels = assigner.labels().to_vec();
        let mut missing = Vec::new();
        let (mut bound, mut plain) = (relaxed, relaxed);
        for ((need, place), multiplier) in self.needs.iter().zip(&self.places).zip(&multipliers) {
            let there = need.robots.iter().filter(|robot| labels[**robot] == *place as u32).count();
            bound += i128::from(*multiplier) * need.at_least as i128;
            plain += i128::from(*multiplier) * there as i128;
            missing.push(need.at_least as i64 - there as i64);
        }
        bound += self.price_of(|wish| broken[wish]);
        let children = self.branch(&restrictions, &broken, &labels, &missing, &multipliers);
        let cost = self.full_cost(plain, &labels, &missing);
        Some(Outcome { bound, labels, cost, missing, children })
    }

    /// Changes costs by the multipliers.
    fn charge(&mut self, multipliers: &[i64], sign: i64) {
        for ((need, place), multiplier) in self.needs.iter().zip(&self.places).zip(multipliers) {
            for robot in need.robots.iter().filter(|_| *multiplier != 0) {
                self.costs.add(*robot, *place, sign * multiplier);
            }
        }
    }

    /// The multiplier of a need at a node: none once it is met for sure, and the whole price once every further
    /// robot counts for sure.
    fn multiplier(&self, need: usize, restrictions: &Restrictions) -> i64 {
        let [fixed, possible] = self.range(need, restrictions);
        let wanted = self.needs[need].at_least;
        if fixed >= wanted {
            0
        } else if possible <= wanted && self.needs[need].price.is_some() {
            self.caps[need]
        } else {
            self.multipliers[need]
        }
    }

    /// Robots of a need that are in its column for sure, and those that may be.
    fn range(&self, need: usize, restrictions: &Restrictions) -> [usize; 2] {
        let place = self.places[need];
        let robots = &self.needs[need].robots;
        let fixed = robots.iter().filter(|robot| restrictions.only(**robot) == Some(place)).count();
        let possible = robots.iter().filter(|robot| restrictions.allows(**robot, place)).count();
        [fixed, possible]
    }

    /// Sum of the prices of some wishes.
    fn price_of(&self, paid: impl Fn(usize) -> bool) -> i128 {
        let prices = self.wishes.iter().enumerate().filter(|(number, _)| paid(*number));
        prices.map(|(_, wish)| i128::from(wish.price.unwrap_or(0))).sum()
    }

    /// Cost with all that is missing; `None` if something hard is.
    fn full_cost(&self, plain: i128, labels: &[u32], missing: &[i64]) -> Option<i128> {
        let refused = |number: usize| self.offender(self.wishes[number], labels).is_some();
        if (0..self.wishes.len()).any(|n| self.wishes[n].price.is_none() && refused(n)) {
            return None;
        }
        let mut cost = plain + self.price_of(refused);
        for (need, missing) in self.needs.iter().zip(missing) {
            if excess(need, *missing) > 0 {
                return None;
            }
            cost += match need.price {
                _ if *missing <= 0 => 0,
                Some(price) => i128::from(price) * i128::from(*missing),
                None => return None,
            };
        }
        Some(cost)
    }

    /// A robot and a column by which `labels` offend a wish.
    fn offender(&self, wish: &Wish, labels: &[u32]) -> Option<(usize, usize)> {
        let teams = self.rules.get().teams.len();
        let mut counts: Vec<(u32, usize, usize)> = Vec::new();
        for &robot in &wish.robots {
            let label = labels[robot];
            match counts.iter_mut().find(|entry| entry.0 == label) {
                Some(entry) => entry.1 += 1,
                None => counts.push((label, 1, robot)),
            }
        }
        let found = match wish.relation {
            Relation::Together if counts.len() > 1 => {
                counts.iter().max_by_key(|(label, count, _)| (*count, std::cmp::Reverse(*label)))
            }
            Relation::Apart => {
                counts.iter().find(|(label, count, _)| *count > 1 && (*label as usize) < teams)
            }
            Relation::Together => None,
        };
        found.map(|(label, _, robot)| (*robot, *label as usize))
    }

    /// Nodes that together hold every division of this one that may cost more than its bound.
    fn branch(
        &self,
        restrictions: &Restrictions,
        broken: &[bool],
        labels: &[u32],
        missing: &[i64],
        multipliers: &[i64],
    ) -> Vec<Vec<Choice>> {
        for (number, wish) in self.wishes.iter().enumerate().filter(|(number, _)| !broken[*number])
        {
            let Some((robot, column)) = self.offender(wish, labels) else { continue };
            let mut children = Vec::new();
            if wish.price.is_some() {
                children.push(vec![Choice::Broken { wish: number }]);
            }
            let all = |make: fn(usize, usize) -> Choice| {
                wish.robots.iter().map(|robot| make(*robot, column)).collect::<Vec<_>>()
            };
            let out = |robot, column| Choice::Out { robot, column };
            match wish.relation {
                Relation::Together => {
                    children.push(all(out));
                    children.push(all(|robot, column| Choice::In { robot, column }));
                }
                Relation::Apart => {
                    children.push(vec![out(robot, column)]);
                    let mut others = all(out);
                    others.retain(|choice| *choice != out(robot, column));
                    others.push(Choice::In { robot, column });
                    children.push(others);
                }
            }
            return children;
        }
        let crowded = self.branch_on_crowd(restrictions, labels, missing);
        if crowded.is_empty() {
            return self.branch_on_need(restrictions, labels, missing, multipliers);
        }
        crowded
    }

    /// Branches on a robot of a column that holds more with a skill than it may: the one that costs least elsewhere.
    fn branch_on_crowd(
        &self,
        restrictions: &Restrictions,
        labels: &[u32],
        missing: &[i64],
    ) -> Vec<Vec<Choice>> {
        let crowded = (0..self.needs.len())
            .filter(|number| excess(self.needs[*number], missing[*number]) > 0)
            .max_by_key(|number| {
                (excess(self.needs[*number], missing[*number]), std::cmp::Reverse(*number))
            });
        let Some(number) = crowded else { return Vec::new() };
        let column = self.places[number];
        let open = self.needs[number].robots.iter().copied().filter(|robot| {
            labels[*robot] == column as u32 && restrictions.only(*robot) != Some(column)
        });
        let detour = |robot: &usize| {
            let row = self.costs.row(*robot);
            let others = (0..row.len())
                .filter(|place| *place != column && restrictions.allows(*robot, *place));
            let next = others.map(|place| row[place]).min().unwrap_or(i64::MAX);
            (next.saturating_sub(row[column]), *robot)
        };
        let Some(robot) = open.min_by_key(detour) else { return Vec::new() };
        vec![vec![Choice::In { robot, column }], vec![Choice::Out { robot, column }]]
    }

    /// Branches on a robot of the need that is furthest from its bound.
    fn branch_on_need(
        &self,
        restrictions: &Restrictions,
        labels: &[u32],
        missing: &[i64],
        multipliers: &[i64],
    ) -> Vec<Vec<Choice>> {
        let mut worst = None;
        let mut largest = 0;
        for (number, need) in self.needs.iter().enumerate() {
            let [fixed, possible] = self.range(number, restrictions);
            let settled = fixed >= need.at_least
                || (need.price.is_some() && possible <= need.at_least)
                || fixed == possible;
            let off = match (missing[number], need.price) {
                (0, _) => 0,
                (more, _) if more < 0 => i128::from(multipliers[number]) * i128::from(-more),
                (less, Some(price)) => i128::from(price - multipliers[number]) * i128::from(less),
                (less, None) => i128::from(MAX_COST) * i128::from(less),
            };
            if !settled && off > largest {
                (worst, largest) = (Some(number), off);
            }
        }
        let Some(number) = worst else { return Vec::new() };
        let (need, place) = (self.needs[number], self.places[number]);
        let lacking = missing[number] > 0;
        let open = need.robots.iter().copied().filter(|robot| {
            restrictions.allows(*robot, place)
                && restrictions.only(*robot) != Some(place)
                && (labels[*robot] == place as u32) != lacking
        });
        let detour = |robot: &usize| {
            let row = self.costs.row(*robot);
            (row[place] - row[labels[*robot] as usize], *robot)
        };
        let Some(robot) = open.min_by_key(detour) else { return Vec::new() };
        let (inside, outside) =
            (vec![Choice::In { robot, column: place }], vec![Choice::Out { robot, column: place }]);
        if lacking { vec![outside, inside] } else { vec![inside, outside] }
    }

    /// Restrictions by the choices and by what follows from them, and the broken wishes; `None` for a node that
    /// cannot hold a division.
    fn restrict(&self, choices: &[Choice]) -> Option<(Restrictions, Vec<bool>)> {
        let mut restrictions = self.rules.restrictions.clone();
        let mut broken = vec![false; self.wishes.len()];
        for &choice in choices {
            match choice {
                Choice::In { robot, column } => {
                    restrictions.force(robot, column);
                }
                Choice::Out { robot, column } => {
                    restrictions.forbid(robot, column);
                }
                Choice::Broken { wish } => broken[wish] = true,
            }
        }
        while self.propagate(&mut restrictions)? {}
        Some((restrictions, broken))
    }

    /// One round of what hard wishes and needs imply. True if anything changed; `None` for a contradiction.
    fn propagate(&self, restrictions: &mut Restrictions) -> Option<bool> {
        let mut changed = false;
        let teams = self.rules.get().teams.len();
        for wish in self.wishes.iter().filter(|wish| wish.price.is_none()) {
            for &robot in &wish.robots {
                if restrictions.excludes(robot) {
                    return None;
                }
                let only = restrictions.only(robot);
                for &other in wish.robots.iter().filter(|other| **other != robot) {
                    match (wish.relation, only) {
                        (Relation::Apart, Some(team)) if team < teams => {
                            changed |= restrictions.forbid(other, team);
                        }
                        (Relation::Together, _) if !restrictions.is_free(robot) => {
                            for column in 0..self.rules.get().columns() {
                                changed |= !restrictions.allows(robot, column)
                                    && restrictions.forbid(other, column);
                            }
                        }
                        _ => {}
                    }
                }
            }
        }
        for (number, need) in self.needs.iter().enumerate().filter(|(_, need)| need.price.is_none())
        {
            let [fixed, possible] = self.range(number, restrictions);
            if possible < need.at_least {
                return None;
            }
            if possible == need.at_least && fixed < possible {
                let place = self.places[number];
                for &robot in &need.robots {
                    if restrictions.allows(robot, place) {
                        changed |= restrictions.force(robot, place);
                    }
                }
            }
        }
        for (number, need) in self.needs.iter().enumerate() {
            let [fixed, possible] = self.range(number, restrictions);
            if fixed > need.at_most {
                return None;
            }
            if fixed == need.at_most && possible > fixed {
                let place = self.places[number];
                for &robot in &need.robots {
                    if restrictions.only(robot) != Some(place) {
                        changed |= restrictions.forbid(robot, place);
                    }
                }
            }
        }
        Some(changed)
    }
}

/// Robots beyond those that a need allows, where so many are missing.
fn excess(need: &Need, missing: i64) -> i64 {
    let there = need.at_least as i64 - missing;
    there - i64::try_from(need.at_most).unwrap_or(i64::MAX)
}

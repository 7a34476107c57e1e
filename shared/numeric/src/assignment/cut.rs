//! Whether rules can be satisfied, by a largest flow, and the cut that shows that they cannot.
//!
//! Robots that may be in the same columns and count for the same limits are one node. Bounds
//! become capacities in the usual way (Ahuja, Magnanti and Orlin, section 6.7). The code shares
//! nothing with the search for cheapest assignments.

use std::collections::BTreeMap;

use super::conflict::{Conflict, Imbalance, Rule};
use super::filter::irreducible;
use super::max_flow::MaxFlow;
use super::restrictions::Restrictions;
use super::rules::{Bounds, Column, Pair, Rules, ValidRules};

/// Capacity of arcs that nothing bounds: far above any number of robots, and sums of it fit.
const UNBOUNDED: i64 = 1 << 40;

/// Robots, columns and classes, and how many robots each class has.
pub(super) struct Fleet<'a> {
    pub(super) rules: &'a Rules,
    /// Robots of each class.
    sizes: BTreeMap<Option<usize>, usize>,
}

/// A column, and a class with limits in it or none.
type Place = (usize, Option<usize>);

/// Limits of places.
type Limits = BTreeMap<Place, Bounds>;

/// Node of every column and limited cell.
type Cells = BTreeMap<Place, usize>;

/// A bounded arc of the flow graph.
struct BoundedArc {
    from: usize,
    to: usize,
    column: usize,
    class: Option<usize>,
    bounds: Bounds,
}

/// Robots that the rules treat alike.
struct Kind {
    /// Class, where it has limits.
    class: Option<usize>,
    /// Columns that they may be in; `None` for all.
    allowed: Option<Vec<usize>>,
    /// Restricted robots.
    robots: Vec<usize>,
    count: usize,
}

/// The flow graph of some rules with a side of a cut that demands more than it can get.
pub(super) struct Cut {
    kinds: Vec<Kind>,
    arcs: Vec<BoundedArc>,
    /// Node of every column and limited cell, by column and class.
    cells: Cells,
    /// Whether each node is on the side that has too much: kinds, cells, columns, sink.
    side: Vec<bool>,
}

/// Every rule, each by itself.
pub(super) fn all_rules(rules: &Rules) -> Vec<Rule> {
    let mut all = Vec::new();
    let mut add = |column, class, bounds: Bounds| {
        if bounds.lower > 0 {
            all.push(Rule::Least { column, class, count: bounds.lower });
        }
        if bounds.upper < rules.robots {
            all.push(Rule::Most { column, class, count: bounds.upper });
        }
    };
    for place in 0..rules.columns() {
        add(rules.column_at(place), None, rules.bounds_at(place));
    }
    for limit in &rules.class_limits {
        add(limit.column, Some(limit.class), limit.bounds);
    }
    all.extend(rules.pairs.iter().copied().map(Rule::Pair));
    all.sort_unstable();
    all.dedup();
    all
}

/// An irreducible conflict of rules that cannot be satisfied.
pub(super) fn find_conflict(rules: &Rules) -> Conflict {
    let fleet = Fleet::new(rules);
    let all = all_rules(rules);
    let start = fleet.cut(&all).map_or_else(|| all.clone(), |cut| cut.involved(&fleet, &all));
    let rules = irreducible(&fleet, start);
    let imbalance = fleet.cut(&rules).map_or(
        Imbalance::Crowded { robots: Vec::new(), least: Vec::new(), most: Vec::new() },
        |cut| cut.imbalance(&fleet, &rules),
    );
    Conflict { rules, imbalance }
}

impl ValidRules {
    /// An irreducible conflict of the rules; `None` if something satisfies them. A flow over robots that the rules treat
    /// alike finds it, which takes no more time for many robots.
    #[must_use]
    pub fn conflict(&self) -> Option<Conflict> {
        let rules = self.get();
        Fleet::new(rules).cut(&all_rules(rules)).map(|_| find_conflict(rules))
    }
}

impl<'a> Fleet<'a> {
    /// The fleet of `rules`.
    pub(super) fn new(rules: &'a Rules) -> Self {
        let mut sizes = BTreeMap::new();
        for robot in 0..rules.robots {
            *sizes.entry(rules.class_of(robot)).or_insert(0) += 1;
        }
        Self { rules, sizes }
    }

    /// Place of a column.
    fn place(&self, column: Column) -> usize {
        self.rules.index_of(column).unwrap_or(usize::MAX)
    }

    /// The proof that `active` rules cannot all be satisfied; `None` if they can.
    pub(super) fn cut(&self, active: &[Rule]) -> Option<Cut> {
        let mut limits = Limits::new();
        let mut pairs = Vec::new();
        for rule in active {
            match *rule {
                Rule::Least { column, class, count } => {
                    limits.entry((self.place(column), class)).or_default().lower = count;
                }
                Rule::Most { column, class, count } => {
                    limits.entry((self.place(column), class)).or_default().upper = count;
                }
                Rule::Pair(pair) => pairs.push(pair),
            }
        }
        let kinds = self.kinds(&limits, &pairs);
        let cells = self.cells(kinds.len(), &limits);
        let arcs = bounded_arcs(&cells, &limits, kinds.len());
        let sink = kinds.len() + cells.len();
        let (source, end) = (sink + 1, sink + 2);
        let mut flow = MaxFlow::new(sink + 3);
        let mut demand = 0;
        for (node, kind) in kinds.iter().enumerate() {
            flow.add(source, node, kind.count as i64);
            demand += kind.count as i64;
            let all = || (0..self.rules.columns()).collect();
            for column in kind.allowed.clone().unwrap_or_else(all) {
                flow.add(node, cell_of(&cells, column, kind.class), UNBOUNDED);
            }
        }
        for arc in &arcs {
            let lower = arc.bounds.lower.min(UNBOUNDED as usize / 2) as i64;
            let upper = arc.bounds.upper.min(UNBOUNDED as usize) as i64;
            flow.add(arc.from, arc.to, upper - lower);
            flow.add(source, arc.to, lower);
            flow.add(arc.from, end, lower);
            demand += lower;
        }
        flow.add(sink, end, self.rules.robots as i64);
        if flow.run(source, end) == demand {
            return None;
        }
        let side = flow.reach(source);
        Some(Cut { kinds, arcs, cells, side })
    }

    /// Robots that `limits` and `pairs` treat alike.
    fn kinds(&self, limits: &Limits, pairs: &[Pair]) -> Vec<Kind> {
        let limited = |class: Option<usize>| {
            class.filter(|class| limits.keys().any(|(_, other)| *other == Some(*class)))
        };
        let mut free: BTreeMap<Option<usize>, usize> = BTreeMap::new();
        for (class, count) in &self.sizes {
            *free.entry(limited(*class)).or_insert(0) += count;
        }
        let restrictions = Restrictions::of_pairs(self.rules, pairs);
        let mut robots: Vec<usize> = pairs.iter().map(|pair| pair.robot()).collect();
        robots.sort_unstable();
        robots.dedup();
        let mut restricted: BTreeMap<(Option<usize>, Vec<usize>), Vec<usize>> = BTreeMap::new();
        for robot in robots {
            let class = limited(self.rules.class_of(robot));
            free.entry(class).and_modify(|count| *count -= 1);
            let allowed = restrictions.allowed(robot).collect();
            restricted.entry((class, allowed)).or_default().push(robot);
        }
        let mut kinds: Vec<Kind> = free
            .into_iter()
            .filter(|(_, count)| *count > 0)
            .map(|(class, count)| Kind { class, allowed: None, robots: Vec::new(), count })
            .collect();
        kinds.extend(restricted.into_iter().map(|((class, allowed), robots)| {
            let count = robots.len();
            Kind { class, allowed: Some(allowed), robots, count }
        }));
        kinds
    }

    /// Nodes of columns and limited cells from `first` on.
    fn cells(&self, first: usize, limits: &Limits) -> Cells {
        let columns = (0..self.rules.columns()).map(|column| (column, None));
        let limited = limits.keys().copied().filter(|(_, class)| class.is_some());
        columns.chain(limited).enumerate().map(|(at, place)| (place, first + at)).collect()
    }
}

/// Arcs from cells to columns, and from those to the sink, which is the node behind all cells.
fn bounded_arcs(cells: &Cells, limits: &Limits, first: usize) -> Vec<BoundedArc> {
    let arc = |(&(column, class), &from): (&Place, &usize)| {
        let to = if class.is_some() { cell_of(cells, column, None) } else { first + cells.len() };
        let bounds = limits.get(&(column, class)).copied().unwrap_or_default();
        BoundedArc { from, to, column, class, bounds }
    };
    cells.iter().map(arc).collect()
}

/// Node that robots of a class flow into.
fn cell_of(cells: &Cells, column: usize, class: Option<usize>) -> usize {
    let own = cells.get(&(column, class));
    own.or_else(|| cells.get(&(column, None))).copied().unwrap_or(0)
}

impl Cut {
    /// Limits that cross the cut: least numbers into the side, and largest numbers out of it.
    fn limits(&self, fleet: &Fleet<'_>) -> [Vec<Rule>; 2] {
        let (mut least, mut most) = (Vec::new(), Vec::new());
        for arc in &self.arcs {
            let (column, class) = (fleet.rules.column_at(arc.column), arc.class);
            let Bounds { lower, upper } = arc.bounds;
            match (self.side[arc.from], self.side[arc.to]) {
                (false, true) if lower > 0 => {
                    least.push(Rule::Least { column, class, count: lower });
                }
                (true, false) => most.push(Rule::Most { column, class, count: upper }),
                _ => {}
            }
        }
        [least, most]
    }

    /// Those of `active` rules that the cut rests on: they cannot be satisfied either.
    fn involved(&self, fleet: &Fleet<'_>, active: &[Rule]) -> Vec<Rule> {
        let [least, most] = self.limits(fleet);
        let mut inside = BTreeMap::new();
        for (kind, on_side) in self.kinds.iter().zip(&self.side) {
            for robot in kind.robots.iter().filter(|_| *on_side) {
                inside.insert(*robot, kind);
            }
        }
        let crosses = |rule: &&Rule| match rule {
            Rule::Least { .. } => least.contains(rule),
            Rule::Most { .. } => most.contains(rule),
            Rule::Pair(pair) => inside.get(&pair.robot()).is_some_and(|kind| {
                let named = fleet.place(pair.column());
                let beyond = |at| !self.side[cell_of(&self.cells, at, kind.class)];
                match pair {
                    Pair::Forbidden { .. } => beyond(named),
                    Pair::Forced { .. } => {
                        (0..fleet.rules.columns()).any(|at| at != named && beyond(at))
                    }
                }
            }),
        };
        active.iter().filter(crosses).copied().collect()
    }

    /// The count of the cut, under the rules that it was found for.
    fn imbalance(&self, fleet: &Fleet<'_>, active: &[Rule]) -> Imbalance {
        let [least, most] = self.limits(fleet);
        let sink = self.kinds.len() + self.cells.len();
        let crowded = !self.side[sink];
        let mut restricted: Vec<usize> = active
            .iter()
            .filter_map(|rule| if let Rule::Pair(pair) = rule { Some(pair.robot()) } else { None })
            .collect();
        restricted.sort_unstable();
        let limited = |class: Option<usize>| {
            class.filter(|class| self.arcs.iter().any(|arc| arc.class == Some(*class)))
        };
        let mut robots = Vec::new();
        for (kind, on_side) in self.kinds.iter().zip(&self.side) {
            if *on_side != crowded {
                continue;
            }
            if kind.allowed.is_some() {
                robots.extend_from_slice(&kind.robots);
                continue;
            }
            robots.extend((0..fleet.rules.robots).filter(|robot| {
                limited(fleet.rules.class_of(*robot)) == kind.class
                    && restricted.binary_search(robot).is_err()
            }));
        }
        robots.sort_unstable();
        if crowded {
            Imbalance::Crowded { robots, least, most }
        } else {
            Imbalance::Lacking { robots, least, most }
        }
    }
}

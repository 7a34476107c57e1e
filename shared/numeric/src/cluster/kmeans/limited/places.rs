//! How many points are in each team, and which moves the limits allow.

use crate::assignment::{Bounds, ValidRules, Wanted};

/// No class with limits.
const PLAIN: u32 = u32::MAX;

/// Counts of points in columns, and of those of each limited class.
pub(super) struct Places<'a> {
    rules: &'a ValidRules,
    columns: usize,
    bounds: Vec<Bounds>,
    pub(super) sizes: Vec<usize>,
    /// Limited class of every point, renumbered.
    classes: Vec<u32>,
    /// Limits and counts of classes, classes × columns.
    class_bounds: Vec<Bounds>,
    class_sizes: Vec<usize>,
    /// Soft minima of classes, as the limits.
    class_wanted: Vec<Option<Wanted>>,
}

impl<'a> Places<'a> {
    /// Counts of `labels`.
    pub(super) fn new(rules: &'a ValidRules, labels: &[u32]) -> Self {
        let mut places = Self::empty(rules, labels.len());
        for (point, label) in labels.iter().enumerate() {
            places.add(point, *label as usize);
        }
        places
    }

    /// Counts of nothing yet, for this many points.
    pub(super) fn empty(rules: &'a ValidRules, points: usize) -> Self {
        let all = rules.get();
        let columns = all.columns();
        let bounds: Vec<Bounds> = all.teams.iter().copied().chain(all.reserve).collect();
        let mut numbers: Vec<usize> = all.class_limits.iter().map(|limit| limit.class).collect();
        numbers.sort_unstable();
        numbers.dedup();
        let mut class_bounds = vec![Bounds::ANY; numbers.len() * columns];
        let mut class_wanted = vec![None; class_bounds.len()];
        for limit in &all.class_limits {
            if let (Ok(class), Ok(column)) =
                (numbers.binary_search(&limit.class), all.index_of(limit.column))
            {
                class_bounds[class * columns + column] = limit.bounds;
                class_wanted[class * columns + column] = limit.wanted;
            }
        }
        let number = |class: &Option<usize>| {
            let place = class.and_then(|class| numbers.binary_search(&class).ok());
            place.map_or(PLAIN, |place| place as u32)
        };
        let classes = if numbers.is_empty() {
            vec![PLAIN; points]
        } else {
            let mut classes: Vec<u32> = all.classes.iter().map(number).collect();
            classes.resize(points, PLAIN);
            classes
        };
        let class_sizes = vec![0; class_bounds.len()];
        let sizes = vec![0; columns];
        Self { rules, columns, bounds, sizes, classes, class_bounds, class_sizes, class_wanted }
    }

    /// Entry of the class of a point in a column.
    fn cell(&self, point: usize, column: usize) -> Option<usize> {
        let class = self.classes[point];
        (class != PLAIN).then(|| class as usize * self.columns + column)
    }

    /// Counts a point in a column.
    pub(super) fn add(&mut self, point: usize, column: usize) {
        self.sizes[column] += 1;
        if let Some(cell) = self.cell(point, column) {
            self.class_sizes[cell] += 1;
        }
    }

    /// Counts a point no more.
    pub(super) fn remove(&mut self, point: usize, column: usize) {
        self.sizes[column] -= 1;
        if let Some(cell) = self.cell(point, column) {
            self.class_sizes[cell] -= 1;
        }
    }

    /// Counts a point elsewhere.
    pub(super) fn transfer(&mut self, point: usize, from: usize, to: usize) {
        self.remove(point, from);
        self.add(point, to);
    }

    /// How many points the columns lack of their least numbers.
    pub(super) fn missing(&self) -> usize {
        let lacks = |(bounds, size): (&Bounds, &usize)| bounds.lower.saturating_sub(*size);
        self.bounds.iter().zip(&self.sizes).map(lacks).sum()
    }

    /// True if no column lacks points, of any class.
    pub(super) fn hold(&self) -> bool {
        let mut classes = self.class_bounds.iter().zip(&self.class_sizes);
        self.missing() == 0 && classes.all(|(bounds, size)| *size >= bounds.lower)
    }

    /// True if the pairs let the point be there.
    pub(super) fn admits(&self, point: usize, column: usize) -> bool {
        self.rules.restrictions.allows(point, column)
    }

    /// True if limits may keep a point from leaving the column, or another from coming, so that two may have to change
    /// places.
    pub(super) fn is_tight(&self, column: usize) -> bool {
        let (bounds, size) = (self.bounds[column], self.sizes[column]);
        size <= bounds.lower || size >= bounds.upper || !self.class_bounds.is_empty()
    }

    /// Prices of the robots that soft minima lack.
    pub(super) fn shortfall(&self) -> i128 {
        let cells = self.class_wanted.iter().zip(&self.class_sizes);
        let price = |(wanted, size): (&Option<Wanted>, &usize)| {
            let Wanted { count, price } = (*wanted)?;
            Some(i128::from(price) * count.saturating_sub(*size) as i128)
        };
        cells.filter_map(price).sum()
    }

    /// True if one less of the class of the point may be in the column. What a soft minimum wants stays, too.
    fn class_may_leave(&self, point: usize, column: usize) -> bool {
        let wanted = |cell: usize| self.class_wanted[cell].map_or(0, |wanted| wanted.count);
        let spare =
            |cell: usize| self.class_sizes[cell] > self.class_bounds[cell].lower.max(wanted(cell));
        self.cell(point, column).is_none_or(spare)
    }

    /// True if one more of the class of the point may be in the column.
    fn class_may_enter(&self, point: usize, column: usize) -> bool {
        let room = |cell: usize| self.class_sizes[cell] < self.class_bounds[cell].upper;
        self.cell(point, column).is_none_or(room)
    }

    /// True if the limits let the point leave the column.
    pub(super) fn may_leave(&self, point: usize, column: usize) -> bool {
        self.sizes[column] > self.bounds[column].lower && self.class_may_leave(point, column)
    }

    /// True if pairs and limits let the point come.
    pub(super) fn may_enter(&self, point: usize, column: usize) -> bool {
        self.sizes[column] < self.bounds[column].upper
            && self.class_may_enter(point, column)
            && self.admits(point, column)
    }

    /// True if the limits of classes let two points, which the pairs admit, change places.
    pub(super) fn may_swap(&self, [a, b]: [usize; 2], [of_a, of_b]: [usize; 2]) -> bool {
        self.classes[a] == self.classes[b]
            || (self.class_may_leave(a, of_a)
                && self.class_may_enter(a, of_b)
                && self.class_may_leave(b, of_b)
                && self.class_may_enter(b, of_a))
    }
}

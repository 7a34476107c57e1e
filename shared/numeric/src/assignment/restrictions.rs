//! Which columns a robot may be in.

use super::rules::{Pair, Rules};

/// Slot of a robot that may be anywhere.
const FREE: u32 = u32::MAX;

const BITS: usize = u64::BITS as usize;

/// Columns that robots may be in. Only robots that may not be everywhere take memory for theirs.
#[derive(Debug, Clone, Default)]
pub(crate) struct Restrictions {
    columns: usize,
    robots: usize,
    /// For every robot the number of its set, or [`FREE`]; empty while all are free.
    slots: Vec<u32>,
    /// Sets of columns, one after the other.
    bits: Vec<u64>,
}

impl Restrictions {
    /// No restriction.
    pub(super) fn none(robots: usize, columns: usize) -> Self {
        Self { columns, robots, slots: Vec::new(), bits: Vec::new() }
    }

    /// What `pairs` leave of the columns of `rules`.
    pub(super) fn of_pairs(rules: &Rules, pairs: &[Pair]) -> Self {
        let mut restrictions = Self::none(rules.robots, rules.columns());
        for &pair in pairs {
            let Ok(place) = rules.index_of(pair.column()) else { continue };
            match pair {
                Pair::Forced { robot, .. } => restrictions.force(robot, place),
                Pair::Forbidden { robot, .. } => restrictions.forbid(robot, place),
            };
        }
        restrictions
    }

    /// Those of some robots, renumbered in their order.
    pub(super) fn selected(&self, robots: &[usize]) -> Self {
        let mut selected = self.clone();
        selected.robots = robots.len();
        if !self.is_empty() {
            selected.slots = robots.iter().map(|robot| self.slots[*robot]).collect();
        }
        selected
    }

    /// Number of words of a set.
    fn words(&self) -> usize {
        self.columns.div_ceil(BITS)
    }

    /// True if no robot is restricted.
    pub(super) fn is_empty(&self) -> bool {
        self.slots.is_empty()
    }

    /// True if this robot may be everywhere.
    #[inline]
    pub(super) fn is_free(&self, robot: usize) -> bool {
        self.slots.get(robot).is_none_or(|slot| *slot == FREE)
    }

    /// The set of a restricted robot.
    fn set(&self, robot: usize) -> Option<&[u64]> {
        let slot = *self.slots.get(robot)?;
        (slot != FREE).then(|| &self.bits[slot as usize * self.words()..][..self.words()])
    }

    /// The set of a robot, which is restricted from here on.
    fn set_mut(&mut self, robot: usize) -> &mut [u64] {
        let words = self.words();
        if self.slots.is_empty() {
            self.slots = vec![FREE; self.robots];
        }
        if self.slots[robot] == FREE {
            self.slots[robot] = (self.bits.len() / words) as u32;
            for word in 0..words {
                let left = self.columns - word * BITS;
                self.bits.push(if left >= BITS { u64::MAX } else { (1 << left) - 1 });
            }
        }
        &mut self.bits[self.slots[robot] as usize * words..][..words]
    }

    /// True if `robot` may be in the column at `place`.
    #[inline]
    pub(crate) fn allows(&self, robot: usize, place: usize) -> bool {
        self.set(robot).is_none_or(|set| set[place / BITS] >> (place % BITS) & 1 == 1)
    }

    /// Keeps `robot` out of a column. True if that changes anything.
    pub(super) fn forbid(&mut self, robot: usize, place: usize) -> bool {
        let changes = self.allows(robot, place);
        if changes {
            self.set_mut(robot)[place / BITS] &= !(1 << (place % BITS));
        }
        changes
    }

    /// Keeps `robot` out of every other column. True if that changes anything.
    pub(super) fn force(&mut self, robot: usize, place: usize) -> bool {
        let mut changes = false;
        for (word, bits) in self.set_mut(robot).iter_mut().enumerate() {
            let kept = if word == place / BITS { 1 << (place % BITS) } else { 0 };
            changes |= *bits & !kept != 0;
            *bits &= kept;
        }
        changes
    }

    /// The columns that `robot` may be in, in order.
    pub(super) fn allowed(&self, robot: usize) -> impl Iterator<Item = usize> {
        (0..self.columns).filter(move |place| self.allows(robot, *place))
    }

    /// The only column that `robot` may be in, if there is just one.
    pub(crate) fn only(&self, robot: usize) -> Option<usize> {
        let set = self.set(robot)?;
        let count: u32 = set.iter().map(|bits| bits.count_ones()).sum();
        if count != 1 {
            return None;
        }
        self.allowed(robot).next()
    }

    /// True if `robot` may be nowhere.
    pub(super) fn excludes(&self, robot: usize) -> bool {
        self.set(robot).is_some_and(|set| set.iter().all(|bits| *bits == 0))
    }
}

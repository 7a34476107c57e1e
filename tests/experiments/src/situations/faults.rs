//! What is missing from the reports of a fleet, or wrong in them. All faults happen to a fleet that is complete.

use super::draw::Draw;
use super::fleet::Fleet;
use crate::moving::faults::Mask;

impl Fleet {
    /// Every robot is wrong about its position, with a standard deviation along each axis.
    pub(super) fn positions_off(&mut self, draw: &mut Draw, deviation_m: f64) {
        for at in self.positions.iter_mut().flatten() {
            at[0] += deviation_m * draw.normal();
            at[1] += deviation_m * draw.normal();
        }
    }

    /// Every robot reports a position that is random within the area of the fleet.
    pub(super) fn positions_at_random(&mut self, draw: &mut Draw) {
        let ends = [0, 1].map(|axis| {
            let all = self.places.iter().map(|at| at[axis]);
            (all.clone().fold(f64::INFINITY, f64::min), all.fold(f64::NEG_INFINITY, f64::max))
        });
        for at in self.positions.iter_mut().flatten() {
            *at = [draw.within(ends[0].0, ends[0].1), draw.within(ends[1].0, ends[1].1), 0.0];
        }
    }

    /// Every robot reports the position of another.
    pub(super) fn positions_of_others(&mut self, draw: &mut Draw) {
        let of = Mask::shuffled(self.robots(), &mut draw.0).of;
        self.positions = of.into_iter().map(|robot| self.positions[robot]).collect();
    }

    /// A share of the robots does not know its position.
    pub(super) fn positions_lost(&mut self, draw: &mut Draw, share: f64) {
        for at in &mut self.positions {
            *at = at.filter(|_| !draw.chance(share));
        }
    }

    /// A share of the robots reports the origin, as receivers do before they know where they are.
    pub(super) fn positions_at_origin(&mut self, draw: &mut Draw, share: f64) {
        for at in self.positions.iter_mut().flatten() {
            if draw.chance(share) {
                *at = [0.0; 3];
            }
        }
    }

    /// Every robot reports the links of another, and all names fit: the graph has its form and belongs to others.
    pub(super) fn links_of_others(&mut self, draw: &mut Draw) {
        let Mask { of, named } = Mask::shuffled(self.robots(), &mut draw.0);
        let links = |robot: usize| {
            let links = self.links[robot].iter();
            links.map(|(peer, quality)| (named[*peer as usize] as u32, *quality)).collect()
        };
        self.links = of.into_iter().map(links).collect();
    }

    /// Every robot reports the rank of another, in the same way.
    pub(super) fn ranks_of_others(&mut self, draw: &mut Draw) {
        let Mask { of, named } = Mask::shuffled(self.robots(), &mut draw.0);
        let superior =
            |robot: usize| self.superiors[robot].map(|superior| named[superior as usize] as u32);
        self.superiors = of.into_iter().map(superior).collect();
    }

    /// A share of the ranks names a random robot as the superior.
    pub(super) fn ranks_wrong(&mut self, draw: &mut Draw, share: f64) {
        let robots = self.robots();
        for (robot, superior) in self.superiors.iter_mut().enumerate() {
            if superior.is_some() && draw.chance(share) {
                let other = draw.index(robots - 1);
                // Every robot but this one.
                *superior = Some((other + usize::from(other >= robot)) as u32);
            }
        }
    }

    /// A share of the robots reports no rank.
    pub(super) fn ranks_unknown(&mut self, draw: &mut Draw, share: f64) {
        for superior in &mut self.superiors {
            *superior = superior.filter(|_| !draw.chance(share));
        }
    }
}

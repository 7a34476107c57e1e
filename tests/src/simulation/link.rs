//! One host's link to the router: what it does to what it carries, and when it is cut.
//!
//! Messages may be lost, repeated, delayed and mixed; declarations (liveliness tokens) go over the
//! same link as a reliable stream, as Zenoh sends them over tcp. A silent cut shorter than the lease
//! delivers late what was sent meanwhile; a longer one, or a clean one, ends the session.

use super::chance::Chance;
use super::clock::{MS, Micros};
use super::router::Carried;

/// How much a silent link holds back for later, in messages: what fits the buffers of a socket.
const MAX_HELD: usize = 256;

/// The way that something takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Way {
    Up = 0,
    Down = 1,
}

/// Bad weather on a link.
#[derive(Debug, Clone)]
pub(crate) struct Storm {
    pub(crate) until: Micros,
    pub(crate) loss: u64,
    /// Whether gets are lost as well. A bus that is only busy drops what is put, and lets gets and answers wait.
    pub(crate) loses_gets: bool,
    pub(crate) copies: u64,
    pub(crate) delay: Micros,
    pub(crate) reorders: bool,
}

/// Whether a link carries anything.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum State {
    /// It does.
    Up,
    /// It does not, and neither end has noticed.
    Silent,
    /// It does not, and both ends know.
    Down,
}

/// One link.
#[derive(Debug)]
pub(crate) struct Link {
    pub(crate) state: State,
    /// Counts the sessions; what belongs to an ended one is lost.
    pub(crate) session: u32,
    /// Until when the link is cut.
    pub(crate) cut_until: Micros,
    storms: Vec<Storm>,
    /// Until when answers of gets come later than other messages, and by how much.
    answers_late: (Micros, Micros),
    /// The same as `free`, for those answers.
    answers_free: [Micros; 2],
    /// Before this, nothing that is sent now arrives: a calm link keeps the order.
    free: [Micros; 2],
    held: Vec<(Way, Carried)>,
    chance: Chance,
}

/// What a link did, for the summary.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Damage {
    pub(crate) lost: u64,
    pub(crate) repeated: u64,
    pub(crate) mixed: u64,
}

impl Link {
    pub(crate) fn new(chance: Chance) -> Self {
        Self {
            state: State::Up,
            session: 0,
            cut_until: 0,
            storms: Vec::new(),
            answers_late: (0, 0),
            answers_free: [0; 2],
            free: [0; 2],
            held: Vec::new(),
            chance,
        }
    }

    /// Bad weather begins.
    pub(crate) fn storm(&mut self, storm: Storm) {
        self.storms.push(storm);
    }

    /// Answers of gets wait behind everything else until a moment.
    pub(crate) fn delay_answers(&mut self, until: Micros, late: Micros) {
        self.answers_late = (until, late);
    }

    /// When copies of something that is sent now arrive; none if it is lost or held back.
    pub(crate) fn send(
        &mut self,
        now: Micros,
        way: Way,
        carried: &Carried,
        damage: &mut Damage,
    ) -> Vec<Micros> {
        match self.state {
            State::Up => {}
            State::Silent => {
                if self.held.len() < MAX_HELD {
                    self.held.push((way, carried.clone()));
                }
                return Vec::new();
            }
            State::Down => return Vec::new(),
        }
        self.storms.retain(|storm| storm.until > now);
        let base = self.chance.between(100, MS);
        let (late_until, late) = self.answers_late;
        if carried.is_answer() && now < late_until {
            let free = &mut self.answers_free[way as usize];
            *free = (now + base + late).max(*free + 1);
            return vec![*free];
        }
        let free = &mut self.free[way as usize];
        let Some(storm) = self.storms.last() else {
            *free = (now + base).max(*free + 1);
            return vec![*free];
        };
        let at = now + base + self.chance.between(0, storm.delay);
        if carried.is_declaration() {
            *free = at.max(*free + 1);
            return vec![*free];
        }
        let may_be_lost = storm.loses_gets || matches!(carried, Carried::Put(_));
        if may_be_lost && self.chance.percent(storm.loss) {
            damage.lost += 1;
            return Vec::new();
        }
        let mut arrivals = Vec::new();
        if storm.reorders {
            damage.mixed += u64::from(at < *free);
            *free = (*free).max(at);
            arrivals.push(at);
        } else {
            *free = at.max(*free + 1);
            arrivals.push(*free);
        }
        if carried.may_be_repeated() && self.chance.percent(storm.copies) {
            damage.repeated += 1;
            arrivals.push(at + self.chance.between(0, storm.delay + MS));
        }
        arrivals
    }

    /// When everything that was sent by now has arrived.
    pub(crate) fn arrived_at(&self, way: Way) -> Micros {
        self.free[way as usize]
    }

    /// Ends the session: what is under way is lost.
    pub(crate) fn end_session(&mut self) {
        self.session += 1;
        self.held.clear();
        self.free = [0; 2];
        self.answers_free = [0; 2];
        self.state = State::Down;
    }

    /// What was held back while nothing came through.
    pub(crate) fn take_held(&mut self) -> Vec<(Way, Carried)> {
        std::mem::take(&mut self.held)
    }

    /// Ends all bad weather.
    pub(crate) fn calm(&mut self) {
        self.storms.clear();
        self.answers_late = (0, 0);
    }

    /// How long until both ends notice that nothing comes any more, or have found back.
    pub(crate) fn drawn(&mut self, low: Micros, high: Micros) -> Micros {
        self.chance.between(low, high)
    }
}

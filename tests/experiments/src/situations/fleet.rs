//! A fleet while it is drawn: teams, places, radio and command, all true. Faults come after
//! (`super::faults`), and at last the fleet becomes a [`Situation`].

use super::draw::Draw;
use super::shapes::{Place, blob};
use super::situation::Situation;

/// Most links that a robot reports: the neighbour table of a small radio.
const MOST_LINKS: usize = 32;

/// Standard deviation of the quality of a link about what the distance says: walls and trees.
const SHADOWING: f64 = 0.1;

/// Links of less quality are not reported.
const LEAST_QUALITY: f64 = 0.05;

/// Quality of links within a radio net.
const NET_QUALITY: (f64, f64) = (0.6, 1.0);

/// Quality of a link that is overheard from another net.
const OVERHEARD_QUALITY: (f64, f64) = (0.1, 0.6);

/// How far from each other a few groups are that are plain to see, and their spread along each axis.
const GROUPS_APART_M: f64 = 30.0;
const GROUP_SPREAD_M: f64 = 2.0;

/// Which modalities the robots report.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Reports {
    pub(super) positions: bool,
    pub(super) links: bool,
    pub(super) ranks: bool,
}

impl Reports {
    pub(super) const ALL: Self = Self { positions: true, links: true, ranks: true };
    pub(super) const NO_POSITIONS: Self = Self { positions: false, ..Self::ALL };
    pub(super) const NO_LINKS: Self = Self { links: false, ..Self::ALL };
    pub(super) const NO_RANKS: Self = Self { ranks: false, ..Self::ALL };
    pub(super) const POSITIONS: Self = Self { positions: true, links: false, ranks: false };
    pub(super) const LINKS: Self = Self { positions: false, links: true, ranks: false };
    pub(super) const RANKS: Self = Self { positions: false, links: false, ranks: true };
}

/// Who commands within a team.
#[derive(Debug, Clone, Copy)]
pub(super) enum Command {
    /// The first robot commands all others.
    Star,
    /// Each robot commands the next one.
    Chain,
    /// Each robot commands so many, level by level.
    Tree(usize),
}

/// Whom the first robots of the teams answer to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Top {
    /// Nobody.
    Nobody,
    /// The first robot of the first team.
    First,
}

/// The fleet. Robots of a team are neighbours in all lists until the very end.
#[derive(Debug, Clone)]
pub(super) struct Fleet {
    /// The robots of each team.
    pub(super) members: Vec<Vec<usize>>,
    /// Where robots are, in metres.
    pub(super) places: Vec<[f64; 3]>,
    /// Where they say they are.
    pub(super) positions: Vec<Option<[f64; 3]>>,
    /// Whom each robot receives, and how well.
    pub(super) links: Vec<Vec<(u32, f64)>>,
    /// Whom each robot answers to.
    pub(super) superiors: Vec<Option<u32>>,
}

impl Fleet {
    /// Teams of so many robots each, in one place.
    pub(super) fn of(sizes: &[usize]) -> Self {
        let mut next = 0;
        let members: Vec<Vec<usize>> = sizes
            .iter()
            .map(|size| {
                next += size;
                (next - size..next).collect()
            })
            .collect();
        Self {
            members,
            places: vec![[0.0; 3]; next],
            positions: vec![Some([0.0; 3]); next],
            links: vec![Vec::new(); next],
            superiors: vec![None; next],
        }
    }

    /// Round teams of one spread, with middles at least so far apart.
    pub(super) fn blobs(draw: &mut Draw, sizes: &[usize], least_m: f64, spread_m: f64) -> Self {
        let mut fleet = Self::of(sizes);
        let middles = draw.middles(sizes.len(), least_m);
        fleet.place(|team, robots| blob(draw, middles[team], spread_m, robots));
        fleet
    }

    /// Groups of a few robots that keep close, in a row, plain to see.
    #[expect(clippy::cast_precision_loss, reason = "there are a few teams")]
    pub(super) fn few(draw: &mut Draw, sizes: &[usize]) -> Self {
        let mut fleet = Self::of(sizes);
        let (sin, cos) = draw.angle().sin_cos();
        fleet.place(|team, robots| {
            let along_m = GROUPS_APART_M * team as f64;
            blob(draw, [along_m * cos, along_m * sin], GROUP_SPREAD_M, robots)
        });
        fleet
    }

    pub(super) fn robots(&self) -> usize {
        self.places.len()
    }

    /// The team of each robot.
    pub(super) fn teams(&self) -> Vec<usize> {
        let teams = self.members.iter().enumerate();
        teams.flat_map(|(team, members)| members.iter().map(move |_| team)).collect()
    }

    /// The first robot of each team.
    pub(super) fn leaders(&self) -> Vec<usize> {
        self.members.iter().filter_map(|members| members.first().copied()).collect()
    }

    /// Puts each team in its places, which it is given by its number and size.
    pub(super) fn place(&mut self, mut places: impl FnMut(usize, usize) -> Vec<Place>) {
        for (team, members) in self.members.iter().enumerate() {
            for (robot, [x, y]) in members.iter().zip(places(team, members.len())) {
                self.places[*robot] = [x, y, 0.0];
            }
        }
        self.report_places();
    }

    /// Puts each team at a height of its own, every robot a little off it.
    pub(super) fn raise(&mut self, draw: &mut Draw, heights_m: &[f64], off_m: f64) {
        for (members, height) in self.members.iter().zip(heights_m) {
            members
                .iter()
                .for_each(|robot| self.places[*robot][2] = height + off_m * draw.normal());
        }
        self.report_places();
    }

    fn report_places(&mut self) {
        self.positions = self.places.iter().copied().map(Some).collect();
    }

    fn distance(&self, i: usize, j: usize) -> f64 {
        let pairs = self.places[i].iter().zip(self.places[j]);
        pairs.map(|(from, to)| (from - to).powi(2)).sum::<f64>().sqrt()
    }

    /// Robots receive all others within range, the better the nearer, whatever their team; a share of the links
    /// is lost, each direction by itself.
    pub(super) fn radio_by_range(&mut self, draw: &mut Draw, range_m: f64, loss: f64) {
        for receiver in 0..self.robots() {
            let mut links = Vec::new();
            for sender in 0..self.robots() {
                let share = self.distance(receiver, sender) / range_m;
                if sender == receiver || share >= 1.0 || draw.chance(loss) {
                    continue;
                }
                let quality = 1.0 - share * share + SHADOWING * draw.normal();
                links.push((sender as u32, quality.clamp(LEAST_QUALITY, 1.0)));
            }
            links.sort_by(|left, right| right.1.total_cmp(&left.1).then(left.0.cmp(&right.0)));
            links.truncate(MOST_LINKS);
            self.links[receiver] = links;
        }
    }

    /// Each team has a radio net, in which robots receive each other wherever they are. A share of these links
    /// is lost, and each robot overhears a number of robots of other teams that is `overheard` times the size of
    /// its own on average.
    #[expect(clippy::cast_precision_loss, reason = "counts of robots are far below 2⁵³")]
    pub(super) fn radio_nets(&mut self, draw: &mut Draw, overheard: f64, loss: f64) {
        let (robots, teams) = (self.robots(), self.teams());
        for members in &self.members {
            for &receiver in members {
                let mut own: Vec<usize> =
                    members.iter().copied().filter(|peer| *peer != receiver).collect();
                if own.len() > MOST_LINKS / 2 {
                    let order = draw.order(own.len());
                    own = order[..MOST_LINKS / 2].iter().map(|at| own[*at]).collect();
                }
                let expected = overheard * own.len().max(1) as f64;
                own.retain(|_| !draw.chance(loss));
                let mut links: Vec<(u32, f64)> = own
                    .into_iter()
                    .map(|peer| (peer as u32, draw.within(NET_QUALITY.0, NET_QUALITY.1)))
                    .collect();
                let share = expected / (robots - members.len()).max(1) as f64;
                for other in (0..robots).filter(|other| teams[*other] != teams[receiver]) {
                    if draw.chance(share) {
                        let (least, most) = OVERHEARD_QUALITY;
                        links.push((other as u32, draw.within(least, most)));
                    }
                }
                self.links[receiver] = links;
            }
        }
    }

    /// Sets up the command of all teams.
    pub(super) fn command(&mut self, command: Command, top: Top) {
        for members in &self.members {
            for (place, robot) in members.iter().enumerate().skip(1) {
                let above = match command {
                    Command::Star => 0,
                    Command::Chain => place - 1,
                    Command::Tree(branches) => (place - 1) / branches.max(1),
                };
                self.superiors[*robot] = Some(members[above] as u32);
            }
        }
        if top == Top::First {
            let leaders = self.leaders();
            for leader in leaders.iter().skip(1) {
                self.superiors[*leader] = Some(leaders[0] as u32);
            }
        }
    }

    /// What is reported, with the robots in random order, so that no method gains by their numbers.
    pub(super) fn situation(self, draw: &mut Draw, reports: Reports) -> Situation {
        // `order[new] = old`
        let order = draw.order(self.robots());
        let mut new = vec![0_u32; order.len()];
        for (number, robot) in (0..).zip(&order) {
            new[*robot] = number;
        }
        let teams = self.teams();
        let links = |robot: &usize| {
            let links = self.links[*robot].iter();
            links.map(|(peer, quality)| (new[*peer as usize], *quality)).collect()
        };
        let rank = |(number, robot): (u32, &usize)| {
            self.superiors[*robot].map(|superior| (number, new[superior as usize], 1.0))
        };
        Situation {
            teams: self.members.len(),
            truth: order.iter().map(|robot| Some(teams[*robot])).collect(),
            positions: reports
                .positions
                .then(|| order.iter().map(|robot| self.positions[*robot]).collect()),
            links: reports.links.then(|| order.iter().map(links).collect()),
            ranks: reports.ranks.then(|| (0..).zip(&order).filter_map(rank).collect()),
        }
    }
}

//! What is lost once all agree, and is to change no team: the power of all services, or the links of a whole team.

use muster_model::id::RobotId;
use muster_model::teams::Teams;

use super::chance::{Chance, Purpose};
use super::clock::Micros;
use super::faults::RECOVERY_TIME;
use super::oracle::{Agreed, Oracle, Verified};
use super::world::World;

/// What is promised of a restart of everything, as long as the disks are there.
const POWER: &str = "a restart of everything changes no team";

/// What is promised of a team that is cut off.
const TEAM: &str = "a team that is cut off moves no other robot, and comes back as what it was";

/// What is to be lost, each once.
#[derive(Debug, Default)]
pub(super) struct Outages {
    /// The power, for how long.
    pub(super) power: Option<Micros>,
    /// A team, for how long, and whether both ends of its links notice at once.
    pub(super) team: Option<(Micros, bool)>,
    /// Until when a team is cut off.
    until: Micros,
}

impl Outages {
    /// Whether nothing more is to be lost.
    pub(super) fn are_over(&self) -> bool {
        self.power.is_none() && self.team.is_none()
    }

    /// Whether a team is cut off.
    pub(super) fn goes_on(&self, now: Micros) -> bool {
        now < self.until
    }
}

/// What all had agreed on, and what is promised of it.
#[derive(Debug)]
pub(super) struct Standing {
    agreed: Agreed,
    promise: &'static str,
}

impl Standing {
    /// No robot of a division is in another team than it was. One that was related to the robots of the lost team alone is in
    /// none.
    pub(super) fn check(&self, teams: &Teams, oracle: &Oracle) -> Verified {
        let is_lone = |robot: &RobotId| self.promise == TEAM && oracle.is_unrelated(teams, robot);
        self.agreed.stands(teams, is_lone, self.promise)
    }
}

impl World {
    /// All have agreed again for a while: on the same as before.
    pub(super) fn check_standing(&mut self) {
        if let Some(Standing { agreed, promise }) = self.stands.take() {
            let stood = match promise {
                TEAM => self.oracle.came_back(&agreed, promise),
                _ => self.oracle.stood(&agreed, promise),
            };
            self.require(stood);
        }
    }

    /// Loses what is next, and returns for how long; none if there is nothing to lose.
    pub(super) fn lose(&mut self, agreed: Agreed) -> Option<Micros> {
        let (lasts, promise, may_stand) = if let Some(lasts) = self.outages.power.take() {
            self.cut_power(lasts);
            (lasts, POWER, self.oracle.is_to_stand(&agreed))
        } else {
            let (lasts, clean) = self.outages.team.take()?;
            let may_stand = self.oracle.loss_moves_no_other(&agreed);
            self.cut_off_team(agreed.division()?, lasts, clean)?;
            (lasts, TEAM, may_stand)
        };
        self.stands = may_stand.then_some(Standing { agreed, promise });
        Some(lasts)
    }

    /// All services are killed while all agree. What was agreed on stands from now on: the disks have it.
    fn cut_power(&mut self, lasts: Micros) {
        self.log.line(self.now, format_args!("the power is cut"));
        self.oracle.order.disturbed(None, self.now + lasts + RECOVERY_TIME);
        let mut chance = Chance::new(self.seed, Purpose::Fault, self.injections.len());
        for index in 0..self.nodes.len() {
            let lasts = chance.between(lasts / 2, lasts);
            self.kill(index, lasts, &mut chance);
            if self.mutator.forgets() {
                self.nodes[index].kept = None;
            }
        }
        self.oracle.all_ended();
    }

    /// The links of all robots of a team are cut. Others are to be there, and robots behind a bridge have no link.
    fn cut_off_team(&mut self, teams: &Teams, lasts: Micros, clean: bool) -> Option<()> {
        if teams.teams.len() < 2 {
            return None;
        }
        let link_of = |robot: &RobotId| {
            let known = self.robots.all.iter().find(|known| known.name == *robot);
            known.filter(|known| known.runs).map(|known| known.link)
        };
        let links_of = |team: &muster_model::teams::Team| -> Option<Vec<usize>> {
            team.members.iter().map(|member| link_of(&member.robot)).collect()
        };
        let all: Vec<_> =
            teams.teams.iter().filter_map(|team| Some((&team.id, links_of(team)?))).collect();
        let mut chance = Chance::new(self.seed, Purpose::Fault, self.injections.len() + 1);
        let (id, links) = chance.pick(&all)?;
        self.log.line(self.now, format_args!("team {id} is cut off"));
        self.mutator.fault("team cut off");
        self.outages.until = self.now + lasts;
        for link in links {
            self.cut(*link, self.now + lasts, clean);
        }
        Some(())
    }
}

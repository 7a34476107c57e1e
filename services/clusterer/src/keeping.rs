//! What is kept on disk, so that ids and members stand after a restart of everything.
//!
//! The last division is written when its teams have changed, not with every frame. Numbers of new teams are
//! reserved on disk in blocks, before a division can give them: whatever was lost since, no number is given
//! again. A division says itself which teams robots had before it: those that are absent keep their place and their id over a
//! restart. A standby keeps the divisions that it receives.

use std::collections::VecDeque;
use std::time::Duration;

use muster_model::content::Checked;
use muster_model::id::RobotId;
use muster_model::teams::{Limited, Team, Teams};
use muster_model::time::Tick;
use muster_model::wish::WishList;
use muster_wire::kept::KeptTeams;

use muster_division::identity::{MAX_KEPT_NUMBER, is_believable};

/// Shortest time between two writes of divisions: a fleet that changes in every frame must not wear out its
/// disk, and what a power cut may lose is less than half a second of changes.
const WRITE_INTERVAL: Duration = Duration::from_millis(500);

/// How long after a failed write the next is tried.
const RETRY_TIME: Duration = Duration::from_secs(10);

/// How many numbers are reserved beyond those that the next division may give: a fleet that forms a new team
/// every few seconds writes every few minutes.
const NUMBER_BLOCK: u64 = 100;

/// How long a division waits for its numbers to be on disk. A disk that hangs must not stop a fleet.
const RESERVATION_TIMEOUT: Duration = Duration::from_secs(2);

/// What is on disk, or on its way.
#[derive(Debug, Default)]
pub(crate) struct Keeping {
    /// The newest division to be kept.
    newest: Option<Checked<Teams>>,
    /// Whether that was published in the life of this process, and not only found on disk.
    was_received: bool,
    /// The division of the last write.
    written: Option<Checked<Teams>>,
    /// Whether those two differ in what matters after a restart.
    is_changed: bool,
    /// When a division was last written.
    written_at: Option<Tick>,
    /// When the last write failed.
    failed_at: Option<Tick>,
    /// The end of the numbers that each write that is under way reserves.
    under_way: VecDeque<u64>,
    /// All wishes, as they were published last.
    wishes: Option<Checked<WishList>>,
    /// The wishes of the last write.
    written_wishes: Option<Checked<WishList>>,
    /// How many writes were begun, and how many have ended.
    begun: u64,
    ended: u64,
    /// All numbers below this one are reserved on disk, or were not in time.
    reserved: u64,
    /// The same, once all writes have ended.
    requested: u64,
    /// When more numbers were requested.
    requested_at: Option<Tick>,
    /// No number below this one may be given: it may have been given.
    pub(crate) next_team: u64,
}

impl Keeping {
    /// Takes over what was kept.
    ///
    /// # Errors
    /// What is wrong with the bytes.
    pub(crate) fn restore(&mut self, content: &[u8]) -> Result<(), String> {
        let kept = KeptTeams::decode(content).map_err(|error| error.to_string())?;
        let next_team = kept.teams.as_ref().map_or(0, |teams| teams.next_team);
        if kept.reserved.max(next_team) > MAX_KEPT_NUMBER {
            return Err(format!("it reserves numbers of teams beyond {MAX_KEPT_NUMBER}"));
        }
        self.next_team = kept.reserved;
        (self.reserved, self.requested) = (kept.reserved, kept.reserved);
        self.written.clone_from(&kept.teams);
        self.newest = kept.teams;
        self.written_wishes.clone_from(&kept.wishes);
        self.wishes = kept.wishes;
        Ok(())
    }

    /// The wishes to be kept.
    pub(crate) fn wishes(&self) -> Option<&Checked<WishList>> {
        self.wishes.as_ref()
    }

    /// Wishes were published, by this instance or another one.
    pub(crate) fn note_wishes(&mut self, wishes: Checked<WishList>) {
        let revision = |list: &Checked<WishList>| list.header.revision;
        if self.wishes.as_ref().is_none_or(|last| revision(last) <= revision(&wishes)) {
            self.wishes = Some(wishes);
        }
    }

    /// This instance has published wishes.
    pub(crate) fn keep_wishes(&mut self, wishes: Checked<WishList>) {
        self.wishes = Some(wishes);
    }

    /// How many writes were begun; what was noted before the last of them is on disk once as many have ended.
    pub(crate) fn writes_begun(&self) -> u64 {
        self.begun
    }

    /// How many writes have ended.
    pub(crate) fn writes_ended(&self) -> u64 {
        self.ended
    }

    /// Whether the last write could not be made.
    pub(crate) fn has_failed(&self) -> bool {
        self.failed_at.is_some()
    }

    /// Whether operators wait for wishes to be written.
    fn has_new_wishes(&self) -> bool {
        match (&self.wishes, &self.written_wishes) {
            (Some(wishes), Some(written)) => !same_wishes(wishes, written),
            (wishes, _) => wishes.as_ref().is_some_and(|list| !list.wishes.is_empty()),
        }
    }

    /// The division to be kept.
    pub(crate) fn division(&self) -> Option<&Checked<Teams>> {
        self.newest.as_ref()
    }

    /// The same, if it was published since this process began. One from the disk must not be given to others as
    /// if somebody remembered it: they have a disk of their own, and await the robots of what they find there.
    pub(crate) fn received_division(&self) -> Option<&Checked<Teams>> {
        self.division().filter(|_| self.was_received)
    }

    /// A division was published, by this instance or another one.
    pub(crate) fn note(&mut self, teams: &Checked<Teams>) {
        self.next_team = self.next_team.max(teams.next_team);
        self.newest = Some(teams.clone());
        self.was_received = true;
        self.is_changed = self.has_other_teams();
    }

    /// Another service remembers a division after which `next_team` was the next number. If nothing is on disk here, what
    /// it remembers may be older than what this host has published: some numbers are left out.
    pub(crate) fn inherit_numbers(&mut self, next_team: u64) {
        let is_without_state = self.reserved == 0 && self.newest.is_none();
        let unknown = if is_without_state { NUMBER_BLOCK / 2 } else { 0 };
        self.next_team = self.next_team.max(next_team.saturating_add(unknown));
    }

    /// A division was received while another instance leads.
    pub(crate) fn hear(&mut self, teams: &Checked<Teams>) {
        if is_believable(teams) {
            self.note(teams);
            // The leader may give some more that this instance does not receive.
            let given = teams.next_team.saturating_add(NUMBER_BLOCK / 2);
            if given > self.requested {
                self.requested = given.saturating_add(NUMBER_BLOCK / 2);
            }
        }
    }

    /// Whether the numbers up to `need` may be given; if not, they are being reserved.
    pub(crate) fn may_give(&mut self, now: Tick, need: u64) -> bool {
        if need > self.requested {
            self.requested = need.saturating_add(NUMBER_BLOCK);
            self.requested_at = Some(now);
        }
        let waited = self.requested_at.is_none_or(|at| now.since(at) >= RESERVATION_TIMEOUT);
        need <= self.reserved || waited
    }

    /// When a division that waits for its numbers waits no longer.
    pub(crate) fn gives_at(&self) -> Option<Tick> {
        let at = self.requested_at.filter(|_| self.reserved < self.requested)?;
        Some(at.after(RESERVATION_TIMEOUT))
    }

    /// When something is to be written: at once if numbers are to be reserved.
    pub(crate) fn due(&self) -> Option<Tick> {
        let begun = self.under_way.iter().max().copied().unwrap_or(self.reserved);
        if self.has_new_wishes() {
            return Some(Tick(0));
        }
        if let Some(failed_at) = self.failed_at {
            return Some(failed_at.after(RETRY_TIME));
        }
        if self.requested > begun {
            return Some(Tick(0));
        }
        if !self.is_changed || !self.under_way.is_empty() {
            return None;
        }
        Some(self.written_at.map_or(Tick(0), |at| at.after(WRITE_INTERVAL)))
    }

    fn has_other_teams(&self) -> bool {
        match (&self.newest, &self.written) {
            (Some(newest), Some(written)) => {
                // After a restart the term tells whether the embedder has lived on.
                newest.embedding.term != written.embedding.term
                    || !same_teams(newest, written)
                    || newest.remembered != written.remembered
                    // Only where robots are away may the next process hold moves back for them as well.
                    || !newest.remembered.last.is_empty() && newest.held != written.held
                    || newest.limited.as_ref().is_some_and(Limited::stands)
                        != written.limited.as_ref().is_some_and(Limited::stands)
            }
            (newest, _) => newest.is_some(),
        }
    }

    /// The bytes to be written now; none if they have no form.
    pub(crate) fn write(&mut self, now: Tick) -> Option<Vec<u8>> {
        if std::mem::take(&mut self.is_changed) {
            self.written_at = Some(now);
        }
        self.written.clone_from(&self.newest);
        self.written_wishes.clone_from(&self.wishes);
        self.failed_at = None;
        let kept = KeptTeams {
            reserved: self.requested,
            teams: self.newest.clone(),
            wishes: self.wishes.clone(),
        };
        let bytes = kept.encode().ok();
        self.begun += 1;
        if bytes.is_none() {
            self.ended += 1;
        }
        if bytes.is_some() {
            self.under_way.push_back(self.requested);
        } else {
            self.reserved = self.requested;
        }
        bytes
    }

    /// A write has ended. One that failed reserves numbers until the end of the process: the fleet goes on.
    pub(crate) fn ended(&mut self, now: Tick, is_on_disk: bool) {
        self.ended += 1;
        if let Some(reserved) = self.under_way.pop_front() {
            self.reserved = self.reserved.max(reserved);
            self.failed_at = if is_on_disk { self.failed_at } else { Some(now) };
        }
        if self.reserved >= self.requested {
            self.requested_at = None;
        }
    }

    /// How many whole messages it holds.
    pub(crate) fn message_count(&self) -> usize {
        let held = [self.newest.is_some(), self.written.is_some(), self.wishes.is_some()];
        held.into_iter().filter(|held| *held).count()
    }
}

/// Whether two lists have the same wishes, whatever has become of them.
fn same_wishes(left: &WishList, right: &WishList) -> bool {
    left.wishes.len() == right.wishes.len()
        && left.wishes.iter().zip(&right.wishes).all(|(left, right)| {
            (&left.operator, &left.id, &left.wish) == (&right.operator, &right.id, &right.wish)
        })
}

fn robots(team: &Team) -> impl Iterator<Item = &RobotId> {
    team.members.iter().map(|member| &member.robot)
}

/// Whether two divisions have the same teams with the same members and leaders.
fn same_teams(left: &Teams, right: &Teams) -> bool {
    left.requested == right.requested
        && left.teams.len() == right.teams.len()
        && left.teams.iter().zip(&right.teams).all(|(left, right)| {
            left.id == right.id && left.leader == right.leader && robots(left).eq(robots(right))
        })
}

#[cfg(test)]
mod tests {
    use muster_model::id::{RobotId, TeamId};
    use muster_model::remembered::RememberedTeams;
    use muster_model::teams::HeldRobot;

    use super::*;
    use crate::dwell::tests::division;

    fn at(ms: u64) -> Tick {
        Tick(1_000_000).after(Duration::from_millis(ms))
    }

    #[test]
    fn numbers_are_reserved_before_they_are_given_and_in_blocks() {
        let mut keeping = Keeping::default();
        assert!(!keeping.may_give(at(0), 4));
        assert_eq!(keeping.due(), Some(Tick(0)));
        let bytes = keeping.write(at(0)).unwrap();
        assert_eq!(KeptTeams::decode(&bytes).unwrap().reserved, 104);
        assert_eq!(keeping.due(), None);
        assert!(!keeping.may_give(at(10), 4), "it is not on disk yet");
        keeping.ended(at(10), true);
        assert!(keeping.may_give(at(11), 104) && !keeping.may_give(at(11), 105));
        let mut next = Keeping::default();
        next.restore(&bytes).unwrap();
        assert_eq!(next.next_team, 104, "whatever was given of them");
        assert!(!next.may_give(at(0), 107));
    }

    #[test]
    fn numbers_are_left_out_where_a_disk_was_lost() {
        let mut without = Keeping::default();
        without.inherit_numbers(7);
        assert_eq!(without.next_team, 57);
        let mut keeping = Keeping::default();
        assert!(!keeping.may_give(at(0), 4));
        let mut restored = Keeping::default();
        restored.restore(&keeping.write(at(0)).unwrap()).unwrap();
        restored.inherit_numbers(7);
        assert_eq!(restored.next_team, 104, "the disk knows what was reserved");
    }

    #[test]
    fn a_disk_that_hangs_or_fails_stops_nobody() {
        let mut keeping = Keeping::default();
        assert!(!keeping.may_give(at(0), 4));
        assert_eq!(keeping.gives_at(), Some(at(2000)));
        assert!(keeping.write(at(0)).is_some());
        assert!(keeping.may_give(at(2000), 4));
        keeping.ended(at(2000), false);
        assert!(keeping.may_give(at(2001), 4));
        assert_eq!(keeping.due(), Some(at(12_000)), "it is tried again");
        assert!(keeping.write(at(12_000)).is_some());
        keeping.ended(at(12_000), true);
        assert_eq!((keeping.due(), keeping.gives_at()), (None, None));
    }

    /// Whether a division is written after another one.
    fn is_written(before: &Teams, after: Teams) -> bool {
        let mut keeping = Keeping::default();
        keeping.note(&Checked::new_unchecked(before.clone()));
        assert!(keeping.write(at(0)).is_some());
        keeping.ended(at(0), true);
        keeping.note(&Checked::new_unchecked(after));
        keeping.due().is_some()
    }

    #[test]
    fn what_the_next_process_needs_is_written_and_no_more() {
        let before = division(&[("t1", "a b")]);
        assert!(!is_written(&before, before.clone()));
        assert!(is_written(&before, division(&[("t1", "a"), ("t2", "b")])));
        let away = vec![(RobotId::new("c").unwrap(), TeamId::numbered(2))];
        let remembered = RememberedTeams { last: away, ..RememberedTeams::default() };
        let absent = Teams { remembered, ..before.clone() };
        assert!(is_written(&before, absent.clone()));
        // A move that is held back counts only where the loss of others holds it.
        let held = HeldRobot { robot: RobotId::new("a").unwrap(), team: TeamId::numbered(2) };
        let held = |teams: &Teams| Teams { held: vec![held.clone()], ..teams.clone() };
        assert!(!is_written(&before, held(&before)));
        assert!(is_written(&absent, held(&absent)));
        let limited = Some(Limited::standing("full".to_owned()));
        let standing = Teams { limited, ..before.clone() };
        assert!(is_written(&before, standing.clone()));
        assert!(!is_written(&standing, standing.clone()));
    }

    #[test]
    fn what_cannot_be_read_is_refused() {
        let mut keeping = Keeping::default();
        assert!(keeping.restore(b"{}").unwrap_err().contains("no file that this service has kept"));
        let nothing = KeptTeams { reserved: 0, teams: None, wishes: None };
        let used_up = |reserved| KeptTeams { reserved, ..nothing.clone() }.encode().unwrap();
        for reserved in [MAX_KEPT_NUMBER + 1, u64::MAX] {
            let problem = keeping.restore(&used_up(reserved)).unwrap_err();
            assert!(problem.contains("numbers of teams"), "{problem}");
            assert_eq!(keeping.next_team, 0);
        }
        assert!(Keeping::default().restore(&used_up(MAX_KEPT_NUMBER)).is_ok());
        assert!(keeping.division().is_none());
    }
}

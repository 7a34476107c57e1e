//! How an instance begins, leads, becomes suspect, stands down and takes over.

use muster_model::event::{EventKind, Severity};
use muster_model::header::Revision;
use muster_model::role::{LeaseRenewal, ReplicaState};
use muster_wire::envelope::AnnouncedSettings;
use muster_wire::{Key, Message, Pattern};

use super::Host;
use crate::core::{Connectivity, Context, Core};
use crate::fetches::Purpose;
use crate::replica::Replica;
use crate::replica::election::{Decision, Reconnection, RenewalSource, Rivalry};
use crate::replica::lease::TermCheck;
use crate::replica::settings::{Adoption, Merging};
use crate::wiring::Replication;

/// Why an instance asks the bus what there is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Occasion {
    /// It has started, or stood down.
    Start,
    /// Its leader is gone.
    TakeOver,
}

impl<C: Core> Host<C> {
    /// Asks the bus for what an instance begins with: what the core wants, who leads, and with which
    /// settings.
    pub(super) fn inquire(&mut self) {
        let takes_over = self.facilities.replica.election.inquire();
        let purpose = if takes_over { Purpose::TakeOver } else { Purpose::Start };
        let mut patterns = C::initial();
        if C::REPLICATION == Replication::OneLeads {
            let of_leader = [Key::Lease(C::SERVICE), Key::Settings(C::SERVICE)];
            patterns.extend(of_leader.map(Pattern::One));
            patterns.push(Pattern::Commands(C::SERVICE));
        }
        self.core.on_inquiry(&mut Context(&mut self.facilities));
        self.facilities.fetch(purpose, patterns);
    }

    pub(super) fn ask_for_leader(&mut self) {
        self.next_query += 1;
        let query = self.next_query;
        self.facilities.replica.election.leader_query_sent(query);
        let patterns = vec![Pattern::One(Key::Lease(C::SERVICE))];
        self.facilities.fetch(Purpose::Leader(query), patterns);
    }

    /// The process did not run for a while. What was received meanwhile is handled only now, so that silence proves
    /// nothing: neither to a leader, which asks whether it leads still, nor to a standby.
    pub(super) fn paused(&mut self, was_leading: bool) {
        let election = &self.facilities.replica.election;
        let (state, is_linked) = (election.state(), election.is_linked());
        match state {
            ReplicaState::Suspect => {
                if is_linked {
                    self.ask_for_leader();
                }
                if was_leading {
                    self.report_connectivity(Connectivity::Paused);
                }
            }
            ReplicaState::Standby if is_linked => {
                self.report_connectivity(Connectivity::Paused);
                self.report_connectivity(Connectivity::Online);
            }
            ReplicaState::Starting | ReplicaState::Standby | ReplicaState::Leading => {}
        }
    }

    /// A suspect leads again once it knows that no other instance has taken over. The core's hook comes before the
    /// rest of the input, so that its output of that hook is published.
    pub(super) fn confirm_leadership(&mut self) {
        if self.facilities.replica.election.confirm(self.facilities.now) {
            self.facilities.publish_unsaid();
            self.report_connectivity(Connectivity::Online);
        }
    }

    pub(super) fn link_restored(&mut self) {
        match self.facilities.replica.election.link_restored(self.facilities.now) {
            Reconnection::Resume => self.report_connectivity(Connectivity::Online),
            Reconnection::Inquire => {
                self.report_connectivity(Connectivity::Online);
                self.inquire();
            }
            Reconnection::AskForLeader => self.ask_for_leader(),
        }
    }

    pub(super) fn renewal(&mut self, renewal: &LeaseRenewal, source: RenewalSource) -> Rivalry {
        let replica = &mut self.facilities.replica;
        let term = replica.revision().term;
        replica.election.renewal(self.facilities.now, renewal, source, term)
    }

    /// Settles which of two leaders goes on.
    pub(super) fn resolve(&mut self, rivalry: Rivalry) {
        match rivalry {
            Rivalry::None => {}
            Rivalry::StandDown => self.stand_down(),
            Rivalry::RaiseTerm(revision) => {
                let was_suspect = !self.facilities.replica.election.is_leading();
                if was_suspect {
                    self.facilities.publish_unsaid();
                }
                self.begin_term(Some(revision));
                if was_suspect {
                    self.report_connectivity(Connectivity::Online);
                }
                self.core.on_new_term(&mut Context(&mut self.facilities), Vec::new());
            }
        }
    }

    pub(super) fn stand_down(&mut self) {
        let replica = &mut self.facilities.replica;
        replica.settings.stood_down(replica.revision().term);
        self.facilities.unsaid.clear();
        self.facilities.fetches.forget();
        self.facilities.fetched.clear();
        self.facilities.abandon_job();
        self.facilities.jobs.succeeded();
        self.core.on_stand_down(&mut Context(&mut self.facilities));
        if !self.facilities.replica.election.is_linked() {
            self.report_connectivity(Connectivity::Offline);
        }
        self.inquire();
    }

    /// Another instance has announced settings, or answered with them.
    pub(super) fn adopt(&mut self, announced: &AnnouncedSettings) {
        let replica = &mut self.facilities.replica;
        if replica.election.has_term() {
            if C::REPLICATION == Replication::OneLeads {
                let merging = replica.settings.merge_announced(announced);
                if merging != Merging::Known {
                    self.settings_merged(merging);
                }
            }
            return;
        }
        let followed = replica.election.followed();
        match replica.settings.adopt(announced, followed) {
            Adoption::Changed => self.facilities.store(),
            Adoption::Unchanged | Adoption::WithoutTerm | Adoption::NotLeaders => {}
            Adoption::Old => replica.add("settings_old", 1),
            Adoption::Misfit => replica.add("settings_not_adopted", 1),
        }
        if followed.is_some_and(|leader| leader.term == announced.header.revision.term) {
            self.say_changes_since(announced);
        }
    }

    /// A leader that announces settings without a term leads without state: it has lost what operators
    /// changed. An instance that has kept it, and nothing of this leader, takes over.
    pub(super) fn replace_leader_without_state(&mut self, announced: &AnnouncedSettings) {
        let replica = &mut self.facilities.replica;
        if announced.header.revision.term > 0 || replica.election.has_term() {
            return;
        }
        replica.settings.note_loss();
        let Some(leader) = replica.election.followed() else { return };
        if replica.settings.are_known() && replica.settings.adopted() < leader.term {
            replica.election.replace_leader(self.facilities.now);
        }
    }

    /// A standby that has not received the settings of its leader asks for them.
    pub(super) fn ask_for_settings(&mut self) {
        let facilities = &mut self.facilities;
        let Replica { election, settings, .. } = &mut facilities.replica;
        if election.state() == ReplicaState::Standby
            && let Some(leader) = election.followed()
            && settings.are_asked_for(facilities.now, leader)
        {
            facilities.fetch(Purpose::Settings, vec![Pattern::One(Key::Settings(C::SERVICE))]);
        }
    }

    /// Adopts the settings among answers.
    pub(super) fn adopt_all(&mut self, answers: &[Message]) {
        for answer in answers {
            if let Message::Settings(announced) = answer
                && announced.service == C::SERVICE
            {
                self.adopt(announced);
            }
        }
    }

    /// The leader that this instance follows has renewed its lease.
    pub(super) fn leader_renewed(&mut self) {
        let replica = &mut self.facilities.replica;
        let Some(leader) = replica.election.followed() else { return };
        if let Some(announced) = replica.settings.renewed(leader) {
            self.adopt(&announced);
        }
    }

    /// Receives the lease renewals among answers to a get. Terms are raised for published ones alone:
    /// the sender publishes the next one soon.
    pub(super) fn renewals_among(&mut self, answers: &[Message]) -> Rivalry {
        let mut rivalry = Rivalry::None;
        for answer in answers {
            if let Message::LeaseRenewal(renewal) = answer
                && renewal.service == C::SERVICE
                && self.renewal(renewal, RenewalSource::Answered) == Rivalry::StandDown
            {
                rivalry = Rivalry::StandDown;
            }
        }
        rivalry
    }

    pub(super) fn inquiry_answered(&mut self, answers: Vec<Message>, occasion: Occasion) {
        if !self.facilities.replica.election.inquiry_answered() {
            return;
        }
        self.renewals_among(&answers);
        let outputs = answers.iter().filter(|answer| C::is_output(answer));
        let revisions = outputs.filter_map(|output| Some(output.header()?.revision));
        let seen = self.facilities.replica.note_seen(revisions);
        let decision = self.facilities.replica.election.decide(self.facilities.now);
        if decision == Decision::Wait {
            return;
        }
        let is_by_instance = |answer: &Message| match answer {
            Message::Settings(announced) => announced.service == C::SERVICE,
            Message::Outcome(outcome) => outcome.service == C::SERVICE,
            _ => false,
        };
        let has_answered = answers.iter().any(is_by_instance);
        let mut wanted = Vec::new();
        for answer in answers {
            match answer {
                Message::LeaseRenewal(_) => {}
                // A suspect answers as well, with what it could not announce.
                Message::Settings(announced) if announced.service == C::SERVICE => {
                    let now = self.facilities.now;
                    self.facilities.replica.note_term_of_other(now, &announced);
                    self.adopt(&announced);
                }
                Message::Outcome(outcome) if outcome.service == C::SERVICE => {
                    self.learn_outcome(outcome);
                }
                answer => wanted.push(answer),
            }
        }
        if decision == Decision::Lead && self.facilities.replica.election.asks_again(has_answered) {
            self.facilities.fetches.carry(wanted);
            return self.inquire();
        }
        match decision {
            Decision::Lead => self.lead(wanted, seen, occasion),
            Decision::StandBy | Decision::Wait => {
                self.core.on_follow(&mut Context(&mut self.facilities), wanted);
            }
        }
    }

    fn lead(&mut self, answers: Vec<Message>, seen: Option<Revision>, occasion: Occasion) {
        // A standby that takes over may never have led on this host.
        if occasion == Occasion::Start {
            self.facilities.notice_state_loss(seen);
        }
        self.begin_term(seen);
        self.core.on_lead(&mut Context(&mut self.facilities), answers);
    }

    fn begin_term(&mut self, seen: Option<Revision>) {
        let facilities = &mut self.facilities;
        facilities.replica.begin_term(facilities.now, seen);
        facilities.store();
        facilities.unstored_term.begin(facilities.now, facilities.gets.pending_stores());
        let term = facilities.replica.revision().term;
        facilities.publish_event(Severity::Info, EventKind::ServiceStarted { term });
        facilities.report_state_loss();
        facilities.announce_settings();
        facilities.replica.settings.repeat_announcement();
        for field in facilities.replica.settings.take_dropped() {
            let kind = EventKind::SettingDropped { field };
            facilities.publish_event(Severity::Warning, kind);
        }
    }

    pub(super) fn term_checked(&mut self, found: Vec<Message>) {
        let replica = &mut self.facilities.replica;
        let seen = found.iter().filter_map(|message| Some(message.header()?.revision)).max();
        let own = replica.revision();
        let Some(lease) = replica.election.lease() else { return };
        match lease.term_checked(self.facilities.now, seen, own) {
            TermCheck::Outrun(revision) => {
                self.begin_term(Some(revision));
                self.core.on_new_term(&mut Context(&mut self.facilities), found);
            }
            TermCheck::Sound => self.core.on_term_sound(&mut Context(&mut self.facilities), found),
        }
    }

    /// Renews the lease, asks the readers what they have seen and announces the settings, each when it
    /// is due.
    pub(super) fn renew(&mut self) {
        let facilities = &mut self.facilities;
        let now = facilities.now;
        let Some(lease) = facilities.replica.election.lease() else { return };
        let (renews, checks) = (lease.renews(now), lease.checks_term(now));
        let announces = checks || (renews && facilities.replica.settings.are_announced_again());
        if renews {
            let renewal = facilities.replica.renewal(now);
            facilities.publish(renewal);
        }
        if checks {
            facilities.fetch(Purpose::TermCheck, vec![Pattern::One(C::output())]);
        }
        if announces {
            facilities.announce_settings();
        }
    }
}

//! What mutants make of the answers of planners.

use muster_model::id::ProposalId;
use muster_model::proposal::{ProposalReport, ProposalState, ProposedDivision, ProposedMove};
use muster_model::time::Tick;
use muster_wire::{Format, KeySpace, Message, Packet};

use super::{Mutant, Mutator};

/// More proposals than there may be.
const TOO_MANY: usize = 20;

impl Mutator {
    /// What a planner answers, as a mutant would.
    pub(crate) fn proposed(
        &mut self,
        space: &KeySpace,
        answer: Result<Vec<Packet>, String>,
        mut messages: Vec<Message>,
        now: Tick,
    ) -> (Result<Vec<Packet>, String>, Vec<Message>) {
        let Some(mutant) = self.mutant.filter(|_| self.active) else { return (answer, messages) };
        match mutant {
            Mutant::Hoarding => hoard(&mut messages),
            Mutant::Nostalgic => {
                let is_gone = answer.as_ref().is_err_and(|error| error.contains("is not there"));
                if let (true, Some((last, at))) = (is_gone, &self.proposal) {
                    messages = vec![aged(last.clone(), now.since(*at).as_secs_f64())];
                }
            }
            Mutant::Chorus => {
                let is_silent = answer.as_ref().is_ok_and(Vec::is_empty);
                let last = self.proposal.as_ref().filter(|_| is_silent);
                messages.extend(last.map(|(last, _)| last.clone()));
            }
            Mutant::Discreet => messages.iter_mut().filter_map(division).for_each(|division| {
                division.moves.pop();
            }),
            Mutant::Misleading => messages.iter_mut().filter_map(division).for_each(mislead),
            _ => return (answer, messages),
        }
        for message in &messages {
            if matches!(message, Message::Proposal(report) if report.proposal.state == ProposalState::Ready)
            {
                self.proposal = Some((message.clone(), now));
            }
        }
        if messages.is_empty() {
            return (answer, messages);
        }
        let packets = messages.iter().filter_map(|message| {
            let (key, _) = message.keys();
            Some(message.encode(key, Format::Json, now).ok()?.into_packet(space))
        });
        (Ok(packets.collect()), messages)
    }
}

fn division(message: &mut Message) -> Option<&mut ProposedDivision> {
    match message {
        Message::Proposal(report) => report.proposal.division.as_mut(),
        _ => None,
    }
}

/// A list with more proposals than there may be.
fn hoard(messages: &mut Vec<Message>) {
    let Some(Message::Proposal(first)) = messages.first().cloned() else { return };
    for number in 0..TOO_MANY.saturating_sub(messages.len()) {
        let mut copy = ProposalReport::clone(&first);
        if let Ok(id) = ProposalId::new(format!("copy{number}")) {
            copy.proposal.id = id;
        }
        messages.push(Message::Proposal(Box::new(copy)));
    }
}

/// A proposal that was read so many seconds ago, and is still there.
fn aged(message: Message, by_s: f64) -> Message {
    match message {
        Message::Proposal(mut report) => {
            report.proposal.age_s += by_s;
            Message::Proposal(report)
        }
        other => other,
    }
}

/// Puts a robot into another team, and says that it would move there.
fn mislead(division: &mut ProposedDivision) {
    let Some(at) = division.teams.iter().position(|team| team.members.len() > 1) else { return };
    let other = usize::from(at == 0);
    let Some(to) = division.teams.get(other).map(|team| team.id.clone()) else { return };
    let own = division.teams[at].id.clone();
    let Some(robot) = division.teams[at].members.pop() else { return };
    division.teams[other].members.push(robot.clone());
    division.teams[other].members.sort();
    let known = division.moves.iter().position(|one| one.robot == robot);
    let from = match known {
        Some(place) => division.moves.remove(place).from,
        None => Some(own),
    };
    if from.as_ref() != Some(&to) {
        division.moves.push(ProposedMove { robot, from, to: Some(to) });
        division.moves.sort_by(|left, right| left.robot.cmp(&right.robot));
    }
}

//! One browser: what it may do, what it has, and what waits for it.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use muster_model::id::OperatorId;
use muster_model::time::Tick;

use super::limits::{
    MAX_COMMANDS_PER_MINUTE, MAX_MESSAGES_PER_SECOND, MAX_PENDING, MAX_QUESTIONS_PER_MINUTE,
    MAX_REPLY_BYTES, STALLED_AFTER,
};
use super::request::ViewRequest;
use super::topics::TOPICS;

/// What a browser may do.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Role {
    /// See.
    Viewer,
    /// See and command, under this name.
    Operator(OperatorId),
}

/// How much may happen within a time: a bucket that fills steadily.
#[derive(Debug)]
struct Allowance {
    most: u32,
    within: Duration,
    left: f64,
    at: Tick,
}

impl Allowance {
    fn new(most: u32, within: Duration, now: Tick) -> Self {
        Self { most, within, left: f64::from(most), at: now }
    }

    fn take(&mut self, now: Tick) -> bool {
        let filled = now.since(self.at).as_secs_f64() / self.within.as_secs_f64();
        self.left = (self.left + filled * f64::from(self.most)).min(f64::from(self.most));
        self.at = self.at.max(now);
        let is_left = self.left >= 1.0;
        if is_left {
            self.left -= 1.0;
        }
        is_left
    }
}

/// What a browser asks for. Each sort has a quota of its own, so that who looks at robots can still command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Sort {
    /// A command, or something about a proposal.
    Order,
    /// A question.
    Question,
}

/// How much of one sort a browser may ask for: within a minute, and without an answer.
#[derive(Debug)]
pub(super) struct Quota {
    allowance: Allowance,
    pending: usize,
}

impl Quota {
    fn new(per_minute: u32, now: Tick) -> Self {
        Self { allowance: Allowance::new(per_minute, Duration::from_secs(60), now), pending: 0 }
    }

    /// Whether so many wait for their answer that one more must not.
    pub(super) fn is_full(&self) -> bool {
        self.pending >= MAX_PENDING
    }

    /// Whether one more may be asked for now.
    pub(super) fn take(&mut self, now: Tick) -> bool {
        self.allowance.take(now)
    }

    /// One waits for its answer.
    pub(super) fn begin(&mut self) {
        self.pending += 1;
    }

    /// One has its answer.
    pub(super) fn end(&mut self) {
        self.pending = self.pending.saturating_sub(1);
    }
}

/// One browser.
#[derive(Debug)]
pub(super) struct Browser {
    pub(super) role: Role,
    pub(super) view: ViewRequest,
    /// The version of each topic that it has.
    pub(super) topics: [u64; TOPICS],
    /// The list of names that it has, or gets, and the next piece of it.
    pub(super) names: (u32, usize),
    /// The versions of the frames that it has: robots, links.
    pub(super) frames: (u64, u64),
    /// Events up to this number are sent.
    pub(super) events: u64,
    replies: VecDeque<Arc<str>>,
    reply_bytes: usize,
    /// The number of the last turn, and when it was sent.
    turn: (u64, Tick),
    /// Whether the last turn was drawn.
    has_credit: bool,
    messages: Allowance,
    orders: Quota,
    questions: Quota,
}

impl Browser {
    pub(super) fn new(role: Role, now: Tick) -> Self {
        Self {
            role,
            view: ViewRequest::default(),
            topics: [0; TOPICS],
            names: (0, 0),
            frames: (0, 0),
            events: 0,
            replies: VecDeque::new(),
            reply_bytes: 0,
            turn: (0, now),
            has_credit: true,
            messages: Allowance::new(MAX_MESSAGES_PER_SECOND, Duration::from_secs(1), now),
            orders: Quota::new(MAX_COMMANDS_PER_MINUTE, now),
            questions: Quota::new(MAX_QUESTIONS_PER_MINUTE, now),
        }
    }

    pub(super) fn may_send(&mut self, now: Tick) -> bool {
        self.messages.take(now)
    }

    /// How much of a sort it may ask for.
    pub(super) fn quota(&mut self, sort: Sort) -> &mut Quota {
        match sort {
            Sort::Order => &mut self.orders,
            Sort::Question => &mut self.questions,
        }
    }

    pub(super) fn has_credit(&self) -> bool {
        self.has_credit
    }

    /// The browser has drawn a turn. Only the last one counts, so that nothing is gained by more credits.
    pub(super) fn credit(&mut self, turn: u64) {
        self.has_credit |= turn == self.turn.0;
    }

    /// Begins the next turn, and returns its number.
    pub(super) fn begin_turn(&mut self, now: Tick) -> u64 {
        self.turn = (self.turn.0 + 1, now);
        self.has_credit = false;
        self.turn.0
    }

    pub(super) fn is_stalled(&self, now: Tick) -> bool {
        !self.has_credit && now.since(self.turn.1) >= STALLED_AFTER
    }

    /// Lets a reply wait; false if the browser has no room for it.
    pub(super) fn reply(&mut self, text: Arc<str>) -> bool {
        let fits = self.reply_bytes + text.len() <= MAX_REPLY_BYTES;
        if fits {
            self.reply_bytes += text.len();
            self.replies.push_back(text);
        }
        fits
    }

    pub(super) fn has_replies(&self) -> bool {
        !self.replies.is_empty()
    }

    /// All replies that wait.
    pub(super) fn take_replies(&mut self) -> VecDeque<Arc<str>> {
        self.reply_bytes = 0;
        std::mem::take(&mut self.replies)
    }

    /// What waits here, in bytes.
    pub(super) fn waiting_bytes(&self) -> usize {
        self.reply_bytes
    }
}

//! Fetches: questions to the bus for several key expressions, asked again while a service starts.

use std::collections::BTreeMap;
use std::time::Duration;

use muster_model::time::Tick;
use muster_wire::{Message, Pattern};

use crate::io::{Ask, AskId};

/// How long a question waits for answers: a service that hangs must not hold up one that starts.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(1);

/// Longest time that a core may have its questions wait, so that it learns of their end before it is of no use.
const MAX_ANSWER_TIMEOUT: Duration = Duration::from_secs(10);

/// How long a question that waits longer than [`ANSWER_TIMEOUT`] waits for one more answer. On a busy bus some of
/// those who are asked never receive the question, or their answer is lost; what the others have told by then
/// grows old while it waits for them.
const FURTHER_ANSWER_TIMEOUT: Duration = Duration::from_millis(300);

/// How long a service that starts repeats unanswered questions. After a failure of the router those who
/// know its last output need a moment to reconnect, and an instance that begins without them begins from
/// nothing. It is more than twice the slowest reconnection.
const START_RETRY_TIME: Duration = Duration::from_secs(2);

/// How soon it repeats them.
const START_RETRY_INTERVAL: Duration = Duration::from_millis(200);

/// Most questions under way. Each is answered within [`MAX_ANSWER_TIMEOUT`], and cores ask a few at a
/// time; beyond it a fetch ends at once without answers.
const MAX_OPEN_ASKS: usize = 256;

/// How long the questions of a fetch wait for answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct AnswerTime {
    /// For all of them.
    pub(crate) within: Duration,
    /// For one more after each; none: as long as for all.
    pub(crate) further_within: Option<Duration>,
}

impl AnswerTime {
    /// For what everybody who is asked has to tell.
    pub(crate) const COMPLETE: Self = Self { within: ANSWER_TIMEOUT, further_within: None };

    /// For what is of use at once, and may take so long on a busy bus.
    pub(crate) fn newest(within: Duration) -> Self {
        let within = within.min(MAX_ANSWER_TIMEOUT);
        Self { within, further_within: Some(FURTHER_ANSWER_TIMEOUT) }
    }
}

/// What a fetch is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Purpose<F> {
    /// An instance asks what there is before it leads.
    Start,
    /// A standby asks the same to take over, and does not wait for absent readers.
    TakeOver,
    /// A suspect asks who leads. The number names the query.
    Leader(u64),
    /// A standby asks for the settings of its leader.
    Settings,
    /// A leader asks what readers have seen of its output.
    TermCheck,
    /// The core's own.
    Core(F),
}

impl<F> Purpose<F> {
    /// Whether an instance asks what there is.
    fn is_inquiry(&self) -> bool {
        matches!(self, Self::Start | Self::TakeOver)
    }
}

/// A fetch that has ended.
#[derive(Debug)]
pub(crate) struct Fetched<F> {
    pub(crate) purpose: Purpose<F>,
    pub(crate) answers: Vec<Message>,
}

#[derive(Debug)]
struct Fetch<F> {
    purpose: Purpose<F>,
    time: AnswerTime,
    /// How many key expressions have no final answer yet.
    open: usize,
    /// Until when unanswered questions are repeated.
    retry_until: Tick,
    answers: Vec<Message>,
}

#[derive(Debug)]
struct Question {
    fetch: u64,
    pattern: Pattern,
    /// Whether it is repeated while it is unanswered.
    retries: bool,
}

/// The fetches of a service.
#[derive(Debug)]
pub(crate) struct Fetches<F> {
    next: u64,
    fetches: BTreeMap<u64, Fetch<F>>,
    /// Questions that the bus has not answered yet.
    asked: BTreeMap<AskId, Question>,
    /// Questions that are asked again, and when.
    waiting: Vec<(Tick, Question)>,
    /// What was answered to an inquiry that has ended, for the next one.
    carried: Vec<Message>,
}

impl<F> Default for Fetches<F> {
    fn default() -> Self {
        let (fetches, asked) = (BTreeMap::new(), BTreeMap::new());
        Self { next: 0, fetches, asked, waiting: Vec::new(), carried: Vec::new() }
    }
}

impl<F: Copy> Fetches<F> {
    /// Begins a fetch whose questions wait so long for answers. An inquiry that follows another one has its answers too. `retries` says which key expressions are asked for
    /// again while they are unanswered. What is to be asked is added to `asks`; a fetch that asks for nothing has ended already.
    pub(crate) fn begin(
        &mut self,
        now: Tick,
        purpose: Purpose<F>,
        patterns: Vec<Pattern>,
        time: AnswerTime,
        retries: impl Fn(&Pattern) -> bool,
        asks: &mut Vec<Ask>,
    ) -> Option<Fetched<F>> {
        if patterns.is_empty() || self.asked.len() + self.waiting.len() >= MAX_OPEN_ASKS {
            return Some(Fetched { purpose, answers: Vec::new() });
        }
        let fetch = self.number();
        let retry_until = now.after(START_RETRY_TIME);
        let open = patterns.len();
        let answers = if purpose.is_inquiry() { self.end_inquiries() } else { Vec::new() };
        self.fetches.insert(fetch, Fetch { purpose, time, open, retry_until, answers });
        for pattern in patterns {
            let retries = retries(&pattern);
            asks.push(self.ask(Question { fetch, pattern, retries }));
        }
        None
    }

    /// The next inquiry has these answers too.
    pub(crate) fn carry(&mut self, answers: Vec<Message>) {
        self.carried = answers;
    }

    /// Ends the inquiries under way, and returns what was answered to them, or to the one before: a standby may take over before it has all answers, and
    /// those who gave them may be gone. Who led then does not count any more.
    fn end_inquiries(&mut self) -> Vec<Message> {
        let mut answers = std::mem::take(&mut self.carried);
        self.fetches.retain(|_, fetch| {
            let is_inquiry = fetch.purpose.is_inquiry();
            if is_inquiry {
                answers.append(&mut fetch.answers);
            }
            !is_inquiry
        });
        let fetches = &self.fetches;
        self.asked.retain(|_, question| fetches.contains_key(&question.fetch));
        self.waiting.retain(|(_, question)| fetches.contains_key(&question.fetch));
        answers.into_iter().filter(|answer| !matches!(answer, Message::LeaseRenewal(_))).collect()
    }

    fn number(&mut self) -> u64 {
        self.next += 1;
        self.next
    }

    fn ask(&mut self, question: Question) -> Ask {
        let ask = AskId(self.number());
        let pattern = question.pattern.clone();
        let fetch = self.fetches.get(&question.fetch);
        let AnswerTime { within, further_within } =
            fetch.map_or(AnswerTime::COMPLETE, |fetch| fetch.time);
        self.asked.insert(ask, question);
        Ask { ask, pattern, within, further_within }
    }

    /// A question has its answers; the fetch, if it has ended with them.
    pub(crate) fn answered(
        &mut self,
        now: Tick,
        ask: AskId,
        answers: Vec<Message>,
    ) -> Option<Fetched<F>> {
        let question = self.asked.remove(&ask)?;
        let fetch = self.fetches.get_mut(&question.fetch)?;
        if answers.is_empty() && question.retries && now < fetch.retry_until {
            self.waiting.push((now.after(START_RETRY_INTERVAL), question));
            return None;
        }
        fetch.answers.extend(answers);
        fetch.open -= 1;
        if fetch.open > 0 {
            return None;
        }
        let Fetch { purpose, answers, .. } = self.fetches.remove(&question.fetch)?;
        Some(Fetched { purpose, answers })
    }

    /// The questions whose time to be asked again has come.
    pub(crate) fn due(&mut self, now: Tick) -> Vec<Ask> {
        let waiting = std::mem::take(&mut self.waiting);
        let (due, later): (Vec<_>, Vec<_>) = waiting.into_iter().partition(|(at, _)| *at <= now);
        self.waiting = later;
        due.into_iter().map(|(_, question)| self.ask(question)).collect()
    }

    /// When the next question is to be asked again.
    pub(crate) fn deadline(&self) -> Option<Tick> {
        self.waiting.iter().map(|(at, _)| *at).min()
    }

    /// Forgets everything that was asked before; answers to it are dropped.
    pub(crate) fn forget(&mut self) {
        self.fetches.clear();
        self.asked.clear();
        self.waiting.clear();
        self.carried.clear();
    }
}

#[cfg(test)]
mod tests {
    use muster_model::id::RobotId;
    use muster_wire::Key;

    use super::*;

    const NOW: Tick = Tick(1_000_000_000);

    fn begin(fetches: &mut Fetches<u8>, patterns: Vec<Pattern>) -> Vec<Ask> {
        let mut asks = Vec::new();
        let only_teams = |pattern: &Pattern| *pattern == Pattern::One(Key::Teams);
        let ended = fetches.begin(
            NOW,
            Purpose::Core(7),
            patterns,
            AnswerTime::COMPLETE,
            only_teams,
            &mut asks,
        );
        assert!(ended.is_none());
        asks
    }

    #[test]
    fn a_fetch_ends_with_its_last_answer() {
        let mut fetches = Fetches::default();
        let asks = begin(&mut fetches, vec![Pattern::One(Key::Roster), Pattern::Graphs]);
        assert!(fetches.answered(NOW, asks[0].ask, Vec::new()).is_none());
        assert!(fetches.answered(NOW, asks[0].ask, Vec::new()).is_none(), "answered twice");
        let ended = fetches.answered(NOW, asks[1].ask, Vec::new()).unwrap();
        assert_eq!(ended.purpose, Purpose::Core(7));
        assert!(fetches.answered(NOW, asks[1].ask, Vec::new()).is_none());
    }

    #[test]
    fn a_core_may_give_its_questions_more_time_but_not_for_ever() {
        let mut fetches: Fetches<u8> = Fetches::default();
        for (wanted, given) in [(4, 4), (60, 10)] {
            let (patterns, mut asks) = (vec![Pattern::Graphs], Vec::new());
            let time = AnswerTime::newest(Duration::from_secs(wanted));
            fetches.begin(NOW, Purpose::Core(1), patterns, time, |_| false, &mut asks);
            assert_eq!(asks[0].within, Duration::from_secs(given));
            assert_eq!(asks[0].further_within, Some(FURTHER_ANSWER_TIMEOUT));
        }
    }

    #[test]
    fn an_unanswered_question_is_asked_again_for_two_seconds() {
        let mut fetches = Fetches::default();
        let mut asks = begin(&mut fetches, vec![Pattern::One(Key::Teams)]);
        let mut now = NOW;
        let mut questions = 1;
        while fetches.answered(now, asks[0].ask, Vec::new()).is_none() {
            let due = fetches.deadline().unwrap();
            assert!(fetches.due(Tick(due.0 - 1)).is_empty());
            now = due;
            asks = fetches.due(now);
            questions += 1;
        }
        assert_eq!((questions, now), (11, NOW.after(START_RETRY_TIME)));
    }

    #[test]
    fn a_fetch_of_nothing_ends_at_once_and_a_forgotten_one_never() {
        let mut fetches: Fetches<u8> = Fetches::default();
        let mut asks = Vec::new();
        let nothing = fetches
            .begin(NOW, Purpose::TermCheck, Vec::new(), AnswerTime::COMPLETE, |_| true, &mut asks)
            .unwrap();
        assert!(nothing.answers.is_empty() && asks.is_empty());
        let asks = begin(&mut fetches, vec![Pattern::One(Key::Teams)]);
        fetches.forget();
        assert!(fetches.answered(NOW, asks[0].ask, Vec::new()).is_none());
        assert_eq!(fetches.deadline(), None);
    }

    #[test]
    fn an_inquiry_has_the_answers_to_the_one_before_that_did_not_end() {
        let mut fetches: Fetches<u8> = Fetches::default();
        let begin = |fetches: &mut Fetches<u8>, purpose| {
            let (patterns, mut asks) = (vec![Pattern::Graphs, Pattern::One(Key::Roster)], vec![]);
            let time = AnswerTime::COMPLETE;
            assert!(fetches.begin(NOW, purpose, patterns, time, |_| true, &mut asks).is_none());
            asks
        };
        let answer = || Message::RobotToken { robot: RobotId::new("r1").unwrap(), alive: true };
        let first = begin(&mut fetches, Purpose::Start);
        assert!(fetches.answered(NOW, first[0].ask, vec![answer()]).is_none());
        assert!(fetches.answered(NOW, first[1].ask, vec![]).is_none(), "it is asked again");
        let second = begin(&mut fetches, Purpose::TakeOver);
        assert!(fetches.due(NOW.after(START_RETRY_TIME)).is_empty());
        assert!(fetches.answered(NOW, first[1].ask, vec![answer()]).is_none(), "too late");
        assert!(fetches.answered(NOW, second[0].ask, vec![answer()]).is_none());
        let ended = fetches.answered(NOW, second[1].ask, vec![answer()]).unwrap();
        assert_eq!((ended.purpose, ended.answers.len()), (Purpose::TakeOver, 3));
    }

    #[test]
    fn questions_under_way_are_bounded() {
        let mut fetches: Fetches<u8> = Fetches::default();
        let mut ended = 0;
        for _ in 0..1000 {
            let patterns = vec![Pattern::One(Key::Teams)];
            let mut asks = Vec::new();
            let fetched = fetches.begin(
                NOW,
                Purpose::Core(1),
                patterns,
                AnswerTime::COMPLETE,
                |_| false,
                &mut asks,
            );
            ended += usize::from(fetched.is_some());
        }
        assert_eq!(ended, 1000 - MAX_OPEN_ASKS);
    }
}

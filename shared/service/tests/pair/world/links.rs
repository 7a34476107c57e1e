//! What links and the router between them do: sessions, tokens, what is lost and late, questions.

use super::*;

impl World {
    /// Both learn of each other.
    pub(super) fn tokens_appear(&mut self, host: usize) {
        let other = 1 - host;
        let is_there = |node: &Node| node.bench.is_some() && node.link.is_up;
        if !is_there(&self.nodes[other]) {
            return;
        }
        for (of, to) in [(host, other), (other, host)] {
            self.token((of, self.nodes[of].process), to, true);
        }
    }

    /// A host learns that another one has come or gone. That is never lost while the session lasts.
    pub(super) fn token(&mut self, (of, run): (usize, u32), to: usize, alive: bool) {
        let process = self.nodes[to].process;
        let at = self.now + self.chance.within(TOKEN);
        let at =
            if self.nodes[to].link.is_silent { at.max(self.nodes[to].link.cut_until) } else { at };
        let service = ServiceName::Clusterer;
        let token = Message::ServiceToken { service, instance: instance_of(of, run), alive };
        let input = muster_service::Arrival::of_message(&space(), token);
        // They come in order.
        let at = at.max(self.nodes[to].link.tokens_free + 1);
        self.nodes[to].link.tokens_free = at;
        self.at(at, Event::Input(to, process, Input::Arrived(input)));
    }

    /// The session of a process that has ended ends with it.
    pub(super) fn end_session_of_process(&mut self, host: usize) {
        let link = &mut self.nodes[host].link;
        link.session += 1;
        link.held.clear();
        let other = 1 - host;
        if self.nodes[other].bench.is_some() && self.nodes[other].link.is_up {
            self.token((host, self.nodes[host].process), other, false);
        }
    }

    pub(super) fn end_session(&mut self, host: usize) {
        let link = &mut self.nodes[host].link;
        (link.is_up, link.is_silent) = (false, false);
        self.end_session_of_process(host);
        self.say(|| format!("the session of {} ends", HOSTS[host]));
        let process = self.nodes[host].process;
        if self.nodes[host].bench.is_some() {
            self.after(TOKEN, Event::Input(host, process, Input::LinkLost));
        }
        self.at(self.nodes[host].link.cut_until, Event::Heal(host));
    }

    pub(super) fn heal(&mut self, host: usize) {
        let link = &mut self.nodes[host].link;
        if self.now < link.cut_until {
            return;
        }
        if link.is_silent {
            link.is_silent = false;
            for (to, from, what) in std::mem::take(&mut link.held) {
                self.send(from, to, what);
            }
        } else if !link.is_up {
            link.is_up = true;
            self.say(|| format!("{} is linked again", HOSTS[host]));
            let process = self.nodes[host].process;
            if self.nodes[host].bench.is_some() {
                // The loss of the link comes first, however short it was.
                let at = self.now + TOKEN.end;
                self.at(at, Event::Input(host, process, Input::LinkRestored));
                self.tokens_appear(host);
            }
        }
    }

    /// Something goes from a host, or the operator, to a host. It takes the links of both.
    pub(super) fn send(&mut self, from: Option<usize>, to: usize, what: Carried) {
        let mut late = self.chance.within(CALM);
        let mut mixes = false;
        for host in from.into_iter().chain([to]) {
            let link = &mut self.nodes[host].link;
            if !link.is_up {
                return;
            }
            if link.is_silent {
                link.held.push((to, from, what));
                return;
            }
            if let Some((until, lost, most, mixed)) = link.storm
                && until > self.now
            {
                if self.chance.within(0..100) < lost {
                    return;
                }
                late += self.chance.within(0..most.max(1));
                mixes |= mixed;
            }
        }
        let mut at = self.now + late;
        if !mixes {
            at = at.max(self.nodes[to].link.free + 1);
            self.nodes[to].link.free = at;
        }
        let session = self.nodes[to].link.session;
        self.at(at, Event::Arrives { to, from, session, what });
    }

    pub(super) fn arrives(&mut self, to: usize, from: Option<usize>, session: u32, what: Carried) {
        if session != self.nodes[to].link.session {
            return;
        }
        if self.nodes[to].link.is_silent {
            self.nodes[to].link.held.push((to, from, what));
            return;
        }
        let process = self.nodes[to].process;
        match what {
            Carried::Message(message) => {
                let arrival = muster_service::Arrival::of_message(&space(), *message);
                self.input(to, process, Input::Arrived(arrival));
            }
            Carried::Get(waiting, get) => {
                self.nodes[to].gets.insert(get.get.0, waiting);
                self.input(to, process, Input::Get(get));
            }
            Carried::Answer(process, question, messages) => {
                if self.nodes[to].process != process {
                    return;
                }
                let Some((_, missing, found)) = self.nodes[to].questions.get_mut(&question) else {
                    return;
                };
                *missing -= 1;
                found.extend(messages);
                if *missing == 0 {
                    self.end_question(to, question);
                }
            }
        }
    }

    pub(super) fn ask(&mut self, host: usize, ask: Ask) {
        let (process, question) = (self.nodes[host].process, ask.ask.0);
        let other = 1 - host;
        let reaches = self.nodes[host].link.is_up
            && self.nodes[other].bench.is_some()
            && self.nodes[other].link.is_up;
        let expression = space().pattern(&ask.pattern);
        let within = u64::try_from(ask.within.as_micros()).unwrap();
        self.nodes[host].questions.insert(question, (ask, 1, Vec::new()));
        let until =
            if self.nodes[host].link.is_up && !reaches { self.now + MS } else { self.now + within };
        self.at(until, Event::EndOfQuestion(host, process, question));
        if reaches {
            self.next_get += 1;
            let get = IncomingGet {
                get: GetId(self.next_get),
                selector: expression.clone(),
                narrowed: Some(expression),
                parameters: "format=bincode".to_owned(),
                payload: None,
            };
            self.send(Some(host), other, Carried::Get(Waiting::Host(host, process, question), get));
        }
    }

    pub(super) fn end_question(&mut self, host: usize, question: u64) {
        let Some((ask, _, found)) = self.nodes[host].questions.remove(&question) else { return };
        let of = |message| muster_service::Arrival::of_message(&space(), message);
        let answers = found.into_iter().map(of).collect();
        let process = self.nodes[host].process;
        self.input(host, process, Input::Answered { ask: ask.ask, answers });
    }
}

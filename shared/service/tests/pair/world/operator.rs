//! An operator who repeats each command until it is answered, and what is to hold in the end.

use super::*;

impl World {
    /// The operator sends its next command to both.
    pub(super) fn command(&mut self) {
        self.at(self.now + COMMAND_INTERVAL, Event::Command);
        if self.next >= self.wanted {
            return;
        }
        let number = self.next;
        let sent = Tick(START + self.now).as_seconds();
        let action = json!({"set": patch_of(number).into_iter().collect::<BTreeMap<_, _>>()});
        let content: Value = json!({"sent": sent, "expires": sent + 60.0, "action": action});
        for to in 0..HOSTS.len() {
            self.next_get += 1;
            let get = IncomingGet {
                get: GetId(self.next_get),
                selector: format!("muster/v1/alpha/command/clusterer/kim/c{number}"),
                narrowed: None,
                parameters: String::new(),
                payload: Some(content.to_string().into_bytes()),
            };
            self.send(None, to, Carried::Get(Waiting::Operator(number), get));
        }
    }

    /// A host has answered a command, and has carried it out or not. Its answer may be lost.
    pub(super) fn answered(&mut self, host: usize, command: usize, answer: Result<bool, String>) {
        let link = &self.nodes[host].link;
        let is_lost = match link.storm {
            Some((until, lost, ..)) if until > self.now => self.chance.within(0..100) < lost,
            _ => false,
        };
        if !link.is_up || link.is_silent || is_lost || command != self.next {
            return;
        }
        self.say(|| format!("the operator has {answer:?} to c{command}"));
        match answer {
            Ok(true) => {
                self.confirmed.extend(patch_of(command));
                self.next += 1;
            }
            // A standby leaves it to the leader; one that starts is asked again.
            Ok(false) => {}
            Err(problem) if problem.contains("\"field\":\"(command)\"") => {}
            Err(problem) => panic!("{problem}"),
        }
    }

    /// What is wrong in the end.
    pub(in crate::pair) fn judge(&self) -> Result<(), String> {
        let benches: Vec<_> = self.nodes.iter().map(|node| node.bench.as_ref().unwrap()).collect();
        let states: Vec<_> = benches.iter().map(|bench| bench.host.replica_state()).collect();
        let leading = states.iter().filter(|state| **state == ReplicaState::Leading).count();
        if leading != 1 || !states.contains(&ReplicaState::Standby) {
            return Err(format!("they are {states:?}"));
        }
        if self.next < self.wanted {
            return Err(format!("command {} of {} is not answered", self.next, self.wanted));
        }
        for field in FIELDS {
            let has = |host: usize| {
                let core = benches[host].host.core();
                if field == "teams" { core.teams } else { core.restarts }
            };
            let values = [has(0), has(1)];
            match self.confirmed.get(field) {
                _ if values[0] != values[1] => {
                    return Err(format!("{field}: they have {values:?}"));
                }
                Some(confirmed) if values[0] != *confirmed => {
                    let text =
                        format!("{field} {confirmed} was confirmed, and they have {values:?}");
                    return Err(text);
                }
                _ => {}
            }
        }
        Ok(())
    }
}

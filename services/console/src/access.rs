//! Who may come in: hosts and origins, tokens and sessions. Pure; the shell brings randomness and time.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::time::Duration;

use muster_model::id::OperatorId;
use muster_model::time::Tick;
use serde::Deserialize;

use crate::Role;

/// Least length of a token: 24 characters of 64 cannot be guessed.
pub const MIN_TOKEN_LENGTH: usize = 24;

/// Most tokens of a console: one for each person of an operations room, and some for screens.
pub const MAX_TOKENS: usize = 256;

/// Most names of hosts under which a console is reached.
pub const MAX_HOSTS: usize = 32;

/// Most sessions at once; for one more, the oldest one of the same person ends, or of all who only see.
pub const MAX_SESSIONS: usize = 256;

/// How long a session lasts: a shift.
pub const SESSION_TIME: Duration = Duration::from_secs(12 * 3600);

/// Most unknown tokens within a minute that are answered as such, of all callers together: a person mistypes a few. A known
/// token is not counted and opens at any time, so that no stranger locks operators out; its length keeps it from being
/// guessed.
pub const MAX_WRONG_TOKENS_PER_MINUTE: u32 = 30;

/// The name of the cookie.
pub const COOKIE: &str = "muster_console";

/// The file of those who may come in.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AccessFile {
    /// Names of hosts with ports under which browsers reach the console, as `base.example:7480`.
    #[serde(default)]
    pub hosts: Vec<String>,
    /// Who may see and command.
    #[serde(default)]
    pub operator: Vec<OperatorEntry>,
    /// Who may see.
    #[serde(default)]
    pub viewer: Vec<ViewerEntry>,
}

/// Who may see and command.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OperatorEntry {
    /// The name in the keys of the commands.
    pub name: OperatorId,
    /// What the person signs in with.
    pub token: String,
}

/// Who may see.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ViewerEntry {
    /// What the person signs in with.
    pub token: String,
}

/// Who may come in without a token, or with which.
#[derive(Debug)]
pub enum Door {
    /// Whoever reaches the port is this operator: for loopback alone.
    Open(OperatorId),
    /// Only who has one of these tokens.
    Tokens(Vec<(String, Role)>),
}

impl AccessFile {
    /// Checks the file, and makes a door of it.
    ///
    /// # Errors
    /// Names the field that is wrong, and the remedy. A token is never quoted.
    pub fn door(&self) -> Result<Door, String> {
        let operators = self.operator.iter();
        let operators = operators.map(|one| (one.token.clone(), Role::Operator(one.name.clone())));
        let viewers = self.viewer.iter().map(|one| (one.token.clone(), Role::Viewer));
        let tokens: Vec<(String, Role)> = operators.chain(viewers).collect();
        if tokens.is_empty() {
            return Err("operator: there is neither [[operator]] nor [[viewer]]".to_owned());
        }
        if tokens.len() > MAX_TOKENS {
            return Err(format!("operator: there may be at most {MAX_TOKENS} tokens"));
        }
        if self.hosts.len() > MAX_HOSTS {
            return Err(format!("hosts: there may be at most {MAX_HOSTS}"));
        }
        for host in &self.hosts {
            let is_plain =
                |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || "-.:[]".contains(c);
            if host.is_empty() || !host.chars().all(is_plain) {
                return Err(
                    "hosts: must be names in lower case, such as base.example:7480".to_owned()
                );
            }
        }
        for (number, (token, _)) in tokens.iter().enumerate() {
            if token.len() < MIN_TOKEN_LENGTH || !token.chars().all(|c| c.is_ascii_graphic()) {
                return Err(format!(
                    "token: each must have at least {MIN_TOKEN_LENGTH} visible ASCII characters; \
                     `openssl rand -base64 24` makes one"
                ));
            }
            if tokens[..number].iter().any(|(other, _)| other == token) {
                return Err("token: two are the same; give each person one of their own".to_owned());
            }
        }
        Ok(Door::Tokens(tokens))
    }
}

/// Whether two texts are the same, in a time that does not depend on where they differ.
fn same(left: &str, right: &str) -> bool {
    let difference = left.bytes().zip(right.bytes()).fold(0, |sum, (l, r)| sum | (l ^ r));
    left.len() == right.len() && difference == 0
}

/// Under which names browsers may reach the console. Any other name in `Host` is that of a page elsewhere whose name
/// was pointed at this host.
#[derive(Debug, Clone)]
pub struct Hosts(Vec<String>);

impl Hosts {
    /// The names of an address, and further ones.
    #[must_use]
    pub fn new(address: SocketAddr, further: &[String]) -> Self {
        let mut names = further.to_vec();
        let port = address.port();
        if address.ip().is_loopback() {
            names.extend(["127.0.0.1", "[::1]", "localhost"].map(|name| format!("{name}:{port}")));
        }
        if !address.ip().is_unspecified() {
            names.push(address.to_string());
        }
        // Browsers leave out the port that every site has.
        let plain = names.iter().filter_map(|name| name.strip_suffix(":80").map(str::to_owned));
        let plain: Vec<String> = plain.collect();
        names.extend(plain);
        Self(names)
    }

    /// Whether a request for this host is meant for the console.
    #[must_use]
    pub fn knows(&self, host: Option<&str>) -> bool {
        host.is_some_and(|host| self.0.iter().any(|name| name.eq_ignore_ascii_case(host)))
    }

    /// Whether a page of this origin is the console's own.
    #[must_use]
    pub fn knows_origin(&self, origin: Option<&str>) -> bool {
        let host = origin.and_then(|text| {
            text.strip_prefix("http://").or_else(|| text.strip_prefix("https://"))
        });
        self.knows(host)
    }
}

/// Who is signed in.
#[derive(Debug)]
pub struct Sessions {
    door: Door,
    open: BTreeMap<String, (Role, Tick)>,
    /// Since when unknown tokens are counted, and how many there were.
    wrong: (Tick, u32),
}

/// Why somebody is not signed in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SignInError {
    /// There is no such token.
    Unknown,
    /// There is no such token, and too many others were tried within the last minute.
    TooMany,
}

impl Sessions {
    /// No one is signed in.
    #[must_use]
    pub fn new(door: Door) -> Self {
        Self { door, open: BTreeMap::new(), wrong: (Tick(0), 0) }
    }

    /// Whether anybody is asked for a token.
    #[must_use]
    pub fn asks(&self) -> bool {
        matches!(self.door, Door::Tokens(_))
    }

    /// Signs in by a token, under a session that no one can guess.
    ///
    /// # Errors
    /// [`SignInError`].
    pub fn sign_in(&mut self, now: Tick, token: &str, session: String) -> Result<(), SignInError> {
        let Some(role) = self.role_of(token) else { return Err(self.wrong(now)) };
        self.open.retain(|_, (_, since)| now.since(*since) < SESSION_TIME);
        if self.open.len() >= MAX_SESSIONS {
            // Whoever signs in again and again ends no session of others.
            let oldest =
                self.open.iter().min_by_key(|(_, (other, since))| (*other != role, *since));
            if let Some(oldest) = oldest.map(|(name, _)| name.clone()) {
                self.open.remove(&oldest);
            }
        }
        self.open.insert(session, (role, now));
        Ok(())
    }

    /// The role that a token opens.
    fn role_of(&self, token: &str) -> Option<Role> {
        let Door::Tokens(tokens) = &self.door else { return None };
        // All are compared, so that the time says nothing of their order.
        let found = tokens.iter().filter(|(known, _)| same(known, token)).map(|(_, role)| role);
        found.fold(None, |_, role| Some(role.clone()))
    }

    /// Counts an unknown token, and returns how it is answered.
    fn wrong(&mut self, now: Tick) -> SignInError {
        if now.since(self.wrong.0) >= Duration::from_secs(60) {
            self.wrong = (now, 0);
        }
        self.wrong.1 = self.wrong.1.saturating_add(1);
        if self.wrong.1 > MAX_WRONG_TOKENS_PER_MINUTE {
            SignInError::TooMany
        } else {
            SignInError::Unknown
        }
    }

    /// Ends a session.
    pub fn sign_out(&mut self, session: Option<&str>) {
        if let Some(session) = session {
            self.open.remove(session);
        }
    }

    /// What the bearer of a session may do; none if no one is signed in.
    #[must_use]
    pub fn role(&self, now: Tick, session: Option<&str>) -> Option<Role> {
        if let Door::Open(operator) = &self.door {
            return Some(Role::Operator(operator.clone()));
        }
        let (role, since) = self.open.get(session?)?;
        (now.since(*since) < SESSION_TIME).then(|| role.clone())
    }
}

/// The session in the cookies of a request.
#[must_use]
pub fn session_of(cookies: &str) -> Option<&str> {
    let named = cookies.split(';').filter_map(|cookie| cookie.trim().split_once('='));
    named.filter(|(name, _)| *name == COOKIE).map(|(_, value)| value).next_back()
}

#[cfg(test)]
mod tests {
    use super::*;

    const KIM: &str = "kim-kim-kim-kim-kim-kim-kim";
    const WALL: &str = "wall-wall-wall-wall-wall-wall";

    fn file(text: &str) -> Result<Door, String> {
        let file: AccessFile = serde_json::from_str(text).map_err(|error| error.to_string())?;
        file.door()
    }

    fn both() -> Sessions {
        let text = format!(
            r#"{{"operator": [{{"name": "kim", "token": "{KIM}"}}], "viewer": [{{"token": "{WALL}"}}]}}"#
        );
        Sessions::new(file(&text).unwrap())
    }

    #[test]
    fn a_token_opens_the_role_that_it_was_made_for() {
        let (mut sessions, now) = (both(), Tick(1_000_000_000));
        assert_eq!(sessions.role(now, None), None);
        assert_eq!(sessions.sign_in(now, "kim", "a".to_owned()), Err(SignInError::Unknown));
        assert_eq!(sessions.sign_in(now, KIM, "s1".to_owned()), Ok(()));
        assert_eq!(sessions.sign_in(now, WALL, "s2".to_owned()), Ok(()));
        let kim = Role::Operator(OperatorId::new("kim").unwrap());
        assert_eq!(sessions.role(now, session_of("x=1; muster_console=s1")), Some(kim));
        assert_eq!(sessions.role(now, Some("s2")), Some(Role::Viewer));
        assert_eq!(sessions.role(now.after(SESSION_TIME), Some("s1")), None);
        sessions.sign_out(Some("s1"));
        assert_eq!(sessions.role(now, Some("s1")), None);
    }

    #[test]
    fn no_stranger_locks_out_who_has_a_token() {
        let (mut sessions, now) = (both(), Tick(1_000_000_000));
        // Those who sign in use up nothing.
        for number in 0..=MAX_WRONG_TOKENS_PER_MINUTE {
            assert_eq!(sessions.sign_in(now, WALL, format!("w{number}")), Ok(()));
        }
        let mut wrong = |now| sessions.sign_in(now, "x", "a".to_owned());
        for _ in 0..MAX_WRONG_TOKENS_PER_MINUTE {
            assert_eq!(wrong(now), Err(SignInError::Unknown));
        }
        assert_eq!(wrong(now), Err(SignInError::TooMany));
        assert_eq!(wrong(now.after(Duration::from_secs(60))), Err(SignInError::Unknown));
        for _ in 0..=MAX_WRONG_TOKENS_PER_MINUTE {
            let _ = wrong(now.after(Duration::from_secs(60)));
        }
        assert_eq!(sessions.sign_in(now, KIM, "s1".to_owned()), Ok(()));
    }

    #[test]
    fn sessions_are_bounded_and_end_for_those_of_the_same_role() {
        let (mut sessions, now) = (both(), Tick(1_000_000_000));
        assert_eq!(sessions.sign_in(now, KIM, "kim".to_owned()), Ok(()));
        let later = now.after(Duration::from_secs(1));
        for number in 0..2 * MAX_SESSIONS {
            assert_eq!(sessions.sign_in(later, WALL, format!("s{number:03}")), Ok(()));
        }
        assert_eq!(sessions.open.len(), MAX_SESSIONS);
        assert!(sessions.role(later, Some(&format!("s{}", 2 * MAX_SESSIONS - 1))).is_some());
        assert_eq!(sessions.role(later, Some("s000")), None);
        assert!(sessions.role(later, Some("kim")).is_some(), "no viewer ends it");
    }

    #[test]
    fn a_wrong_file_is_refused_with_the_field_and_without_the_token() {
        for (wrong, named) in [
            ("{}", "operator"),
            (r#"{"viewer": [{"token": "short-secret"}]}"#, "at least 24"),
            (r#"{"viewer": [{"token": "short-secret", "name": "kim"}]}"#, "name"),
            (r#"{"operator": [{"token": "x"}]}"#, "name"),
            (
                r#"{"hosts": ["http://x/"], "viewer": [{"token": "wall-wall-wall-wall-wall-wall"}]}"#,
                "hosts",
            ),
        ] {
            let problem = file(wrong).unwrap_err();
            assert!(problem.contains(named) && !problem.contains("short-secret"), "{problem}");
        }
    }

    #[test]
    fn only_the_names_of_the_console_are_known() {
        let hosts = Hosts::new("127.0.0.1:7480".parse().unwrap(), &[]);
        for own in ["127.0.0.1:7480", "localhost:7480", "LOCALHOST:7480", "[::1]:7480"] {
            assert!(hosts.knows(Some(own)), "{own}");
            assert!(hosts.knows_origin(Some(&format!("http://{own}"))), "{own}");
        }
        for other in
            ["evil.example:7480", "127.0.0.1", "localhost:80", "", "localhost:7480.evil.example"]
        {
            assert!(!hosts.knows(Some(other)), "{other}");
            assert!(!hosts.knows_origin(Some(&format!("http://{other}"))), "{other}");
        }
        assert!(!hosts.knows(None) && !hosts.knows_origin(None));
        assert!(!hosts.knows_origin(Some("null")));
        let all = Hosts::new("0.0.0.0:80".parse().unwrap(), &["base.example:80".to_owned()]);
        assert!(all.knows(Some("base.example")) && !all.knows(Some("0.0.0.0:80")));
    }
}

//! Liveliness tokens of `rmw_zenoh`, which describe the graph of nodes, publishers and subscriptions.
//!
//! Data alone is received by whoever subscribes, but `ros2 node list` and `ros2 topic list` show only what has a token.
//! A node has nine parts, all else thirteen; a later version may append more, which are kept, since the [`Gid`] of a
//! publisher is a hash of the whole text.

use std::fmt;

use crate::attachment::Gid;
use crate::key::parse_domain;
use crate::qos::{Qos, QosError};

/// The first part of each token. The bus matches it with no wildcard.
pub const ROOT: &str = "@ros2_lv";

/// Parts of the token of a node.
const NODE_PARTS: usize = 9;

/// Parts of every other token.
const ENDPOINT_PARTS: usize = 13;

/// Most parts beyond these that are kept: Lyrical has one, and a token with many is none.
const MAX_FURTHER_PARTS: usize = 3;

/// A node of ROS, within one session.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Node {
    /// The domain, `ROS_DOMAIN_ID`.
    pub domain: u32,
    /// The id of its session: up to 32 hexadecimal digits.
    pub session: String,
    /// Its number within the session.
    pub number: u64,
    /// Its enclave, `/` if it has none.
    pub enclave: String,
    /// Its namespace, `/` if it has none.
    pub namespace: String,
    /// Its name.
    pub name: String,
}

/// What an endpoint does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum EndpointKind {
    /// It publishes messages.
    Publisher,
    /// It receives messages.
    Subscription,
    /// It answers requests.
    Server,
    /// It sends requests.
    Client,
}

impl EndpointKind {
    const fn code(self) -> &'static str {
        match self {
            Self::Publisher => "MP",
            Self::Subscription => "MS",
            Self::Server => "SS",
            Self::Client => "SC",
        }
    }

    fn of_code(code: &str) -> Option<Self> {
        let all = [Self::Publisher, Self::Subscription, Self::Server, Self::Client];
        all.into_iter().find(|kind| kind.code() == code)
    }
}

/// What a node publishes, receives, answers or asks.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Endpoint {
    /// Its number within the session.
    pub number: u64,
    /// What it does.
    pub kind: EndpointKind,
    /// The name of the topic or service with the slash at its begin.
    pub topic: String,
    /// The type as it stands in keys. That of a service is no message's.
    pub type_name: String,
    /// The hash of the type as it stands in keys.
    pub hash: String,
    /// Its quality of service.
    pub qos: Qos,
    /// Parts that a later version appends.
    pub further: Vec<String>,
}

/// A liveliness token.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Token {
    /// The node that has it.
    pub node: Node,
    /// What the token is for; none for the node itself.
    pub endpoint: Option<Endpoint>,
}

/// Why a text is no token.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum TokenError {
    /// It has too few parts, too many, or an empty one.
    #[error(
        "a token has {NODE_PARTS} parts for a node, and {ENDPOINT_PARTS} or a few more otherwise; none is empty"
    )]
    Parts,
    /// It begins with something else.
    #[error("a token begins with {ROOT}")]
    Root,
    /// The domain, or the number of the node or endpoint, is none.
    #[error("the domain and the ids of node and endpoint are whole numbers")]
    Number,
    /// It is for nothing that is known.
    #[error("a token is for NN, MP, MS, SS or SC")]
    Kind,
    /// The quality of service is not in the short form.
    #[error(transparent)]
    Qos(#[from] QosError),
}

/// A name as one part of a key.
fn mangle(name: &str) -> String {
    if name.is_empty() { "%".to_owned() } else { name.replace('/', "%") }
}

fn demangle(part: &str) -> String {
    part.replace('%', "/")
}

impl Token {
    /// The token of a node itself.
    #[must_use]
    pub fn of_node(node: Node) -> Self {
        Self { node, endpoint: None }
    }

    /// The publisher, as its attachments name it.
    #[must_use]
    pub fn gid(&self) -> Gid {
        Gid::of_token(&self.to_string())
    }

    /// What matches all tokens of a domain.
    #[must_use]
    pub fn pattern(domain: u32) -> String {
        format!("{ROOT}/{domain}/**")
    }

    /// Reads the text of a token.
    ///
    /// # Errors
    /// Says what is wrong with it.
    pub fn parse(text: &str) -> Result<Self, TokenError> {
        let parts: Vec<&str> =
            text.split('/').take(ENDPOINT_PARTS + MAX_FURTHER_PARTS + 1).collect();
        if parts.iter().any(|part| part.is_empty()) {
            return Err(TokenError::Parts);
        }
        let ([root, domain, session, node, number, kind, enclave, namespace, name], endpoint) =
            parts.split_first_chunk::<NODE_PARTS>().ok_or(TokenError::Parts)?;
        if *root != ROOT {
            return Err(TokenError::Root);
        }
        let node = Node {
            domain: parse_domain(domain).ok_or(TokenError::Number)?,
            session: (*session).to_owned(),
            number: parse_number(node)?,
            enclave: demangle(enclave),
            namespace: demangle(namespace),
            name: demangle(name),
        };
        let number = parse_number(number)?;
        if *kind == "NN" {
            let is_whole = endpoint.is_empty() && number == node.number;
            return if is_whole { Ok(Self::of_node(node)) } else { Err(TokenError::Parts) };
        }
        let kind = EndpointKind::of_code(kind).ok_or(TokenError::Kind)?;
        let [topic, type_name, hash, qos, further @ ..] = endpoint else {
            return Err(TokenError::Parts);
        };
        if further.len() > MAX_FURTHER_PARTS {
            return Err(TokenError::Parts);
        }
        let endpoint = Endpoint {
            number,
            kind,
            topic: demangle(topic),
            type_name: demangle(type_name),
            hash: demangle(hash),
            qos: qos.parse()?,
            further: further.iter().map(|part| (*part).to_owned()).collect(),
        };
        Ok(Self { node, endpoint: Some(endpoint) })
    }
}

fn parse_number(text: &str) -> Result<u64, TokenError> {
    let number: u64 = text.parse().map_err(|_| TokenError::Number)?;
    if number.to_string() == text { Ok(number) } else { Err(TokenError::Number) }
}

/// The key of the token.
impl fmt::Display for Token {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Node { domain, session, number, enclave, namespace, name } = &self.node;
        let (own, kind) = match &self.endpoint {
            Some(endpoint) => (endpoint.number, endpoint.kind.code()),
            None => (*number, "NN"),
        };
        let (enclave, namespace, name) = (mangle(enclave), mangle(namespace), mangle(name));
        write!(
            formatter,
            "{ROOT}/{domain}/{session}/{number}/{own}/{kind}/{enclave}/{namespace}/{name}"
        )?;
        let Some(endpoint) = &self.endpoint else { return Ok(()) };
        let Endpoint { topic, type_name, hash, qos, further, .. } = endpoint;
        let (topic, type_name, hash) = (mangle(topic), mangle(type_name), mangle(hash));
        write!(formatter, "/{topic}/{type_name}/{hash}/{qos}")?;
        further.iter().try_for_each(|part| write!(formatter, "/{part}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NODE: &str = "@ros2_lv/7/6977b59f87229328a8d406ad77b301a6/0/0/NN/%/%cell4/gw";
    const PUBLISHER: &str = "@ros2_lv/7/6977b59f87229328a8d406ad77b301a6/0/11/MP/%/%cell4/gw/%cell4%chatter/\
         std_msgs::msg::dds_::String_/\
         RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18/::,7:,:,:,,";

    fn node() -> Node {
        Node {
            domain: 7,
            session: "6977b59f87229328a8d406ad77b301a6".to_owned(),
            number: 0,
            enclave: "/".to_owned(),
            namespace: "/cell4".to_owned(),
            name: "gw".to_owned(),
        }
    }

    #[test]
    fn captured_tokens_are_read_and_written_alike() {
        assert_eq!(Token::parse(NODE), Ok(Token::of_node(node())));
        assert_eq!(Token::of_node(node()).to_string(), NODE);
        let token = Token::parse(PUBLISHER).unwrap();
        assert_eq!(token.to_string(), PUBLISHER);
        assert_eq!(token.node, node());
        let endpoint = token.endpoint.unwrap();
        assert_eq!((endpoint.number, endpoint.kind), (11, EndpointKind::Publisher));
        assert_eq!(endpoint.topic, "/cell4/chatter");
        assert_eq!(endpoint.type_name, "std_msgs::msg::dds_::String_");
        assert_eq!(endpoint.qos.depth, 7);
        for kind in ["MS", "SS", "SC"] {
            let text = PUBLISHER.replace("/MP/", &format!("/{kind}/"));
            assert_eq!(Token::parse(&text).unwrap().to_string(), text);
        }
    }

    #[test]
    fn what_a_later_version_appends_is_kept_for_the_gid() {
        let text = format!("{PUBLISHER}/cdr");
        let token = Token::parse(&text).unwrap();
        assert_eq!(token.to_string(), text);
        assert_eq!(token.gid(), Gid::of_token(&text));
        assert_ne!(token.gid(), Gid::of_token(PUBLISHER));
    }

    #[test]
    fn what_is_no_token_is_refused() {
        for (at, part) in PUBLISHER.split('/').enumerate() {
            // Without a part, and with an empty one in its place.
            let replaced = |with: Option<&str>| {
                let parts = PUBLISHER.split('/').enumerate();
                let parts = parts.filter_map(|(i, part)| if i == at { with } else { Some(part) });
                parts.collect::<Vec<_>>().join("/")
            };
            assert!(Token::parse(&replaced(None)).is_err(), "without {part}");
            assert!(Token::parse(&replaced(Some(""))).is_err(), "with an empty {part}");
        }
        for (part, wrong) in [
            ("@ros2_lv", "@ros2"),
            ("/7/", "/-7/"),
            ("/0/11/", "/0/x/"),
            ("/MP/", "/XX/"),
            ("/::,7:", "/7:"),
        ] {
            assert!(Token::parse(&PUBLISHER.replacen(part, wrong, 1)).is_err(), "{wrong}");
        }
        assert!(Token::parse(&format!("{PUBLISHER}/1/2/3/4")).is_err());
        assert!(Token::parse(&format!("{NODE}/more")).is_err());
        assert!(Token::parse(&NODE.replace("/0/0/", "/0/1/")).is_err(), "a node is its own entity");
        assert!(Token::parse("").is_err());
    }
}

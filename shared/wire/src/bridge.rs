//! What a bridge says of itself in JSON, in answer to a get of `bridge/{instance}`.

use muster_model::bridge::{BridgeState, MAX_REFUSED_TOPICS};

use crate::decode::{self, DecodeError};
use crate::envelope::MAX_SMALL_PAYLOAD;
use crate::key::{Key, KeySpace};
use crate::packet::{JSON, Packet, Rejection, plain_reason, quoted};

/// The answer of a bridge. Of many refused topics it names as many as fit.
#[must_use]
pub fn encode(space: &KeySpace, mut state: BridgeState) -> Packet {
    let key = space.format(&Key::Bridge(state.instance.clone()));
    state.refused.truncate(MAX_REFUSED_TOPICS);
    loop {
        // Texts and numbers alone always have a form in JSON.
        let payload = serde_json::to_vec(&state).unwrap_or_default();
        if payload.len() <= MAX_SMALL_PAYLOAD || state.refused.pop().is_none() {
            return Packet::put(key, JSON, payload);
        }
    }
}

/// Reads the answer of a bridge. Anybody may answer a get: its texts are cut short and have no control characters.
///
/// # Errors
/// A [`Rejection`] if the key is not that of the bridge, or the content is not of this form.
pub fn decode(space: &KeySpace, packet: &Packet) -> Result<BridgeState, Rejection> {
    read(space, packet).map_err(|error| Rejection::new(space, &packet.key, error.to_string()))
}

fn read(space: &KeySpace, packet: &Packet) -> Result<BridgeState, DecodeError> {
    let key = space.parse(&packet.key)?;
    let bytes = decode::payload(packet, &key)?;
    let mut state: BridgeState = serde_json::from_slice(bytes)?;
    if key != Key::Bridge(state.instance.clone()) {
        return Err(DecodeError::NotRead);
    }
    state.version = quoted(&state.version);
    state.refused.truncate(MAX_REFUSED_TOPICS);
    for refused in &mut state.refused {
        refused.topic = quoted(&refused.topic);
        refused.reason = plain_reason(&refused.reason);
    }
    Ok(state)
}

#[cfg(test)]
mod tests {
    use muster_model::bridge::{RefusedTopic, TopicFault};
    use muster_model::id::{FleetId, InstanceId};

    use super::*;

    fn state(refused: usize, reason: &str) -> BridgeState {
        let topic = |number: usize| RefusedTopic {
            topic: format!("0/r{number}/odom"),
            fault: TopicFault::NoChain,
            reason: reason.to_owned(),
        };
        BridgeState {
            instance: InstanceId::new("host-1").unwrap(),
            version: "1.0".to_owned(),
            robots: 3,
            received: 20,
            reported: 10,
            refused_topics: refused as u64,
            refused: (0..refused).map(topic).collect(),
        }
    }

    #[test]
    fn what_a_bridge_says_is_read_as_it_was_written_and_never_too_large() {
        let space = KeySpace::new(FleetId::new("alpha").unwrap());
        let few = state(2, "no transforms");
        let packet = encode(&space, few.clone());
        assert_eq!(packet.key, "muster/v1/alpha/bridge/host-1");
        assert_eq!(decode(&space, &packet).unwrap(), few);
        let many = encode(&space, state(500, &"x".repeat(1000)));
        assert!(many.payload.as_ref().unwrap().len() <= MAX_SMALL_PAYLOAD);
        let read = decode(&space, &many).unwrap();
        assert_eq!(read.refused_topics, 500);
        assert!(!read.refused.is_empty() && read.refused.len() <= MAX_REFUSED_TOPICS);
    }

    #[test]
    fn another_s_answer_is_refused_and_texts_are_made_plain() {
        let space = KeySpace::new(FleetId::new("alpha").unwrap());
        let good = encode(&space, state(1, "\u{1b}[2J"));
        assert_eq!(decode(&space, &good).unwrap().refused[0].reason, "\u{FFFD}[2J");
        let other = Packet { key: "muster/v1/alpha/bridge/host-2".to_owned(), ..good.clone() };
        assert!(decode(&space, &other).is_err());
        assert!(decode(&space, &Packet { payload: Ok(b"{".to_vec()), ..good.clone() }).is_err());
        // A later version may know more faults.
        let text = String::from_utf8(good.payload.clone().unwrap()).unwrap();
        let later = text.replace("no_chain", "out_of_paint").into_bytes();
        let later = decode(&space, &Packet { payload: Ok(later), ..good }).unwrap();
        assert_eq!(later.refused[0].fault, TopicFault::Other);
    }
}

//! Proposals: the payload of a get that asks for one, and the JSON reply as consoles read it.

use muster_model::content::Content;
use muster_model::proposal::{Proposal, ProposalReport, ProposalRequest};
use muster_model::settings::SettingsError;
use muster_model::time::Tick;
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value;

use crate::decode::{self, DecodeError};
use crate::envelope::MAX_SMALL_PAYLOAD;
use crate::json::{EdgeJson, Head, head};
use crate::key::{Key, KeySpace};
use crate::packet::{Packet, Rejection};

/// Largest payload in bytes: settings as large as a command may hold them, and any robots.
pub const MAX_PROPOSAL_REQUEST_BYTES: usize = MAX_SMALL_PAYLOAD;

/// What a get with a payload asks for.
#[derive(Debug, Clone, PartialEq)]
pub enum ProposalChange {
    /// A proposal, in place of the one with its name.
    Ask(Box<ProposalRequest>),
    /// The proposal is dropped.
    Drop,
}

/// Reads and checks a payload.
///
/// # Errors
/// Names the field that is wrong, and what would be right.
pub fn decode_request(payload: &[u8]) -> Result<ProposalChange, SettingsError> {
    let refused = |problem: String| SettingsError::new("(proposal)", problem);
    if payload.len() > MAX_PROPOSAL_REQUEST_BYTES {
        return Err(refused(format!("may have at most {MAX_PROPOSAL_REQUEST_BYTES} bytes")));
    }
    let value: Value =
        serde_json::from_slice(payload).map_err(|error| refused(format!("is no JSON: {error}")))?;
    match value {
        Value::Null => Ok(ProposalChange::Drop),
        Value::Object(_) => Ok(ProposalChange::Ask(Box::new(ProposalRequest::from_json(value)?))),
        _ => Err(refused(
            "must be an object such as {\"teams\": 3, \"without\": [\"r7\"]}, or null to drop it"
                .to_owned(),
        )),
    }
}

/// A proposal: what a get of its key is answered with.
#[derive(Serialize, JsonSchema)]
pub(crate) struct ProposalForm<'a> {
    #[serde(flatten)]
    head: Head<'a>,
    #[serde(flatten)]
    proposal: &'a Proposal,
}

impl EdgeJson for ProposalReport {
    fn to_json(&self, now: Tick) -> Result<Vec<u8>, serde_json::Error> {
        let head = head(&self.header, now);
        serde_json::to_vec(&ProposalForm { head, proposal: &self.proposal })
    }
}

/// Decodes the reply to a get of a proposal. The age of the data that JSON names counts from `now`, the moment of
/// arrival. Unknown fields are ignored, so that a console reads what newer services send.
///
/// # Errors
/// A [`Rejection`] if the key is not of a proposal of this fleet, the content is not of this form, or contradicts itself
/// or its key.
pub fn decode(space: &KeySpace, packet: &Packet, now: Tick) -> Result<ProposalReport, Rejection> {
    read(space, packet, now).map_err(|error| Rejection::new(space, &packet.key, error.to_string()))
}

fn read(space: &KeySpace, packet: &Packet, now: Tick) -> Result<ProposalReport, DecodeError> {
    let key = space.parse(&packet.key)?;
    let bytes = decode::payload(packet, &key)?;
    let Key::Proposal(operator, id) = key else { return Err(DecodeError::NotRead) };
    let proposal: Proposal = serde_json::from_slice(bytes)?;
    if (&operator, &id) != (&proposal.operator, &proposal.id) {
        return Err(DecodeError::Mismatch("proposals"));
    }
    let report = ProposalReport { header: decode::header_from_json(bytes, now)?, proposal };
    decode::check_header(space, &report.header)?;
    report.check()?;
    Ok(report)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_payload_is_a_request_or_null() {
        assert_eq!(decode_request(b"null"), Ok(ProposalChange::Drop));
        let asked = decode_request(br#"{"teams": 3}"#);
        assert!(matches!(asked, Ok(ProposalChange::Ask(_))), "{asked:?}");
        for (wrong, field) in [
            (&b"[1]"[..], "(proposal)"),
            (b"{", "(proposal)"),
            (&[b' '; MAX_PROPOSAL_REQUEST_BYTES + 1], "(proposal)"),
            (br#"{"teams": 0}"#, "teams"),
            (br#"{"without": "r1"}"#, "without"),
        ] {
            assert_eq!(decode_request(wrong).unwrap_err().field, field);
        }
    }
}

//! The Katz similarity of two robots as consoles read it: the JSON reply to `embedding?katz=from,to`.

use std::collections::BTreeMap;

use muster_model::content::Content;
use muster_model::id::{Modality, RobotId};
use muster_model::katz::{PairMethod, PairSimilarity};
use muster_model::time::Tick;
use serde::Deserialize;

use crate::decode::{self, DecodeError};
use crate::key::{Key, KeySpace};
use crate::packet::{Packet, Rejection};

/// The JSON form after its head. Unknown fields are ignored, so that a console reads what newer services send.
#[derive(Deserialize)]
struct Form {
    from: RobotId,
    to: RobotId,
    similarity: f64,
    shares: BTreeMap<Modality, f64>,
    alpha: f64,
    method: PairMethod,
    residual: f64,
}

/// Decodes the reply to a get of `embedding?katz=from,to`. The age of the data that JSON names counts
/// from `now`, the moment of arrival.
///
/// # Errors
/// A [`Rejection`] if the key is not the embedding of this fleet, the content is not of this form, or a
/// number is not finite or negative.
pub fn decode(space: &KeySpace, packet: &Packet, now: Tick) -> Result<PairSimilarity, Rejection> {
    read(space, packet, now).map_err(|error| Rejection::new(space, &packet.key, error.to_string()))
}

fn read(space: &KeySpace, packet: &Packet, now: Tick) -> Result<PairSimilarity, DecodeError> {
    let key = space.parse(&packet.key)?;
    let bytes = decode::payload(packet, &key)?;
    if key != Key::Embedding {
        return Err(DecodeError::NotRead);
    }
    let pair = from_json(bytes, now)?;
    decode::check_header(space, &pair.header)?;
    pair.check()?;
    Ok(pair)
}

fn from_json(bytes: &[u8], now: Tick) -> Result<PairSimilarity, DecodeError> {
    let form: Form = serde_json::from_slice(bytes)?;
    Ok(PairSimilarity {
        header: decode::header_from_json(bytes, now)?,
        from: form.from,
        to: form.to,
        similarity: form.similarity,
        shares: form.shares.into_iter().collect(),
        alpha: form.alpha,
        method: form.method,
        residual: form.residual,
    })
}

#[cfg(test)]
mod tests {
    use muster_model::header::{Header, Revision, StageTime};
    use muster_model::id::{FleetId, ServiceName};
    use serde_json::{Value, json};

    use super::*;
    use crate::json::EdgeJson;
    use crate::packet::JSON;

    fn space() -> KeySpace {
        KeySpace::new(FleetId::new("alpha").unwrap())
    }

    fn sample() -> PairSimilarity {
        PairSimilarity {
            header: Header {
                fleet: FleetId::new("alpha").unwrap(),
                revision: Revision { term: 3, epoch: 44 },
                oldest: Some(Tick(9_000_000)),
                newest: None,
                stages: vec![StageTime {
                    stage: ServiceName::Ingest,
                    received: Tick(9_500_000),
                    published: Tick(9_600_000),
                }],
            },
            from: RobotId::new("r1").unwrap(),
            to: RobotId::new("r2").unwrap(),
            similarity: 0.1 + 0.2,
            shares: vec![(Modality::hierarchy(), 0.1), (Modality::spatial(), 0.2)],
            alpha: 1.0 / 3.0,
            method: PairMethod::Cached,
            residual: 1e-17,
        }
    }

    fn decoded(change: impl Fn(&mut Value)) -> Result<PairSimilarity, String> {
        let now = Tick(10_000_000);
        let mut value: Value = serde_json::from_slice(&sample().to_json(now).unwrap()).unwrap();
        change(&mut value);
        let packet = Packet::put("muster/v1/alpha/embedding", JSON, value.to_string());
        decode(&space(), &packet, now).map_err(|refused| refused.reason)
    }

    #[test]
    fn a_console_reads_what_the_embedder_writes_bit_by_bit() {
        assert_eq!(decoded(|_| {}).unwrap(), sample());
        assert_eq!(decoded(|value| value["new"] = json!(1)).unwrap(), sample());
    }

    #[test]
    fn nonsense_is_refused_by_name() {
        for (field, value, named) in [
            ("fleet", json!("beta"), "fleet"),
            ("from", json!("R 1"), "JSON"),
            ("similarity", json!(-1.0), "similarity"),
            ("shares", json!({"spatial": -1.0}), "shares"),
            ("term", json!(u64::MAX), "term"),
            ("method", json!("guess"), "JSON"),
        ] {
            let reason = decoded(|whole| whole[field] = value.clone()).unwrap_err();
            assert!(reason.contains(named), "{field} {value}: {reason}");
        }
        for (key, payload) in [
            ("muster/v1/alpha/teams", Ok(Vec::new())),
            ("muster/v1/beta/embedding", Ok(Vec::new())),
            ("muster/v1/alpha/embedding", Ok(b"{}".to_vec())),
            ("muster/v1/alpha/embedding", Err(1 << 30)),
        ] {
            let packet = Packet { payload, ..Packet::put(key, "", []) };
            assert!(decode(&space(), &packet, Tick(0)).is_err());
        }
    }
}

//! What Zenoh brings, as packets.

use muster_wire::foreign::MAX_ATTACHMENT_BYTES;
use muster_wire::{Attachment, Packet, Source};
use zenoh::sample::{Sample, SampleKind};

/// A sample as a packet. A payload of more than `limit` bytes is left out.
pub(crate) fn packet(sample: &Sample, limit: usize) -> Packet {
    let payload = sample.payload();
    Packet {
        key: sample.key_expr().as_str().to_owned(),
        encoding: sample.encoding().to_string(),
        source: match sample.kind() {
            SampleKind::Put => Source::Put,
            SampleKind::Delete => Source::Delete,
        },
        payload: if payload.len() > limit {
            Err(payload.len())
        } else {
            Ok(payload.to_bytes().into_owned())
        },
        attachment: sample.attachment().and_then(attachment),
    }
}

/// A small attachment; one that is too large belongs to no program that Muster speaks to.
fn attachment(bytes: &zenoh::bytes::ZBytes) -> Option<Attachment> {
    if bytes.len() > MAX_ATTACHMENT_BYTES {
        return None;
    }
    Attachment::new(bytes.to_bytes()).ok()
}

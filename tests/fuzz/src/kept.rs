//! What clusterer and embedder keep over a restart.

use muster_wire::kept::{KeptShape, KeptTeams, MAGIC, SHAPE_MAGIC, SHAPE_VERSION, VERSION};

use crate::packets::may_hold;
use crate::{Outcome, allocation, text};

/// Longest reason for not using a file, in characters.
const MAX_PROBLEM: usize = 400;

/// The content of a file. Its length and checksum are made right: they would keep back almost all that is drawn.
pub(crate) fn kept(data: &[u8]) -> Outcome {
    let shape = KeptShape::decode(&file(SHAPE_MAGIC, SHAPE_VERSION, data));
    assert_eq!(shape.is_ok(), data.len() == 8);
    if let Ok(shape) = shape {
        assert_eq!(KeptShape::decode(&shape.encode().unwrap()), Ok(shape));
    }
    let file = file(MAGIC, VERSION, data);
    let size = may_hold(file.len());
    match allocation::at_most(size, "reading what is kept", || KeptTeams::decode(&file)) {
        Ok(kept) => {
            let again = kept.encode().unwrap();
            assert_eq!(KeptTeams::decode(&again), Ok(kept));
            Outcome::Accepted
        }
        Err(error) => {
            text::check(&error.to_string(), MAX_PROBLEM);
            Outcome::Refused
        }
    }
}

/// The file of a content.
fn file(magic: [u8; 8], version: u8, data: &[u8]) -> Vec<u8> {
    let length = u32::try_from(data.len()).unwrap().to_le_bytes();
    let mut file = [&magic[..], &[version], &length, &checksum(data)].concat();
    file.extend(data);
    file
}

/// FNV-1a, folded to four bytes.
fn checksum(bytes: &[u8]) -> [u8; 4] {
    let mut sum = 0xcbf2_9ce4_8422_2325_u64;
    for byte in bytes {
        sum = (sum ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3);
    }
    let [a, b, c, d, e, f, g, h] = sum.to_le_bytes();
    [a ^ e, b ^ f, c ^ g, d ^ h]
}

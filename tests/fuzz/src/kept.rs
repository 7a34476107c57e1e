//! The division that is kept over a restart.

use muster_wire::kept::{KeptTeams, MAGIC, VERSION};

use crate::packets::may_hold;
use crate::{Outcome, allocation, text};

/// Longest reason for not using a file, in characters.
const MAX_PROBLEM: usize = 400;

/// The content of a file. Its length and checksum are made right: they would keep back almost all that is drawn.
pub(crate) fn kept(data: &[u8]) -> Outcome {
    let length = u32::try_from(data.len()).unwrap().to_le_bytes();
    let mut file = [&MAGIC[..], &[VERSION], &length, &checksum(data)].concat();
    file.extend(data);
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

/// FNV-1a, folded to four bytes.
fn checksum(bytes: &[u8]) -> [u8; 4] {
    let mut sum = 0xcbf2_9ce4_8422_2325_u64;
    for byte in bytes {
        sum = (sum ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3);
    }
    let [a, b, c, d, e, f, g, h] = sum.to_le_bytes();
    [a ^ e, b ^ f, c ^ g, d ^ h]
}

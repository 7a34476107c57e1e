//! What a service keeps over a restart in addition to its settings, as bytes of a file.
//!
//! A file is eight magic bytes, the version of the content, and one frame: length, checksum, and the content. A file
//! that breaks off or was damaged is recognised, and is not used.
//!
//! Of the clusterer ([`KeptTeams`], [`MAGIC`], [`VERSION`]) the content is the end of the reserved numbers in eight
//! bytes with the lowest first; the wishes as they are on the bus, after their length in four; and the division as it
//! is on the bus. What there was not is empty. Of the embedder ([`KeptShape`], [`SHAPE_MAGIC`], [`SHAPE_VERSION`]) it
//! is the number of teams and K, in four bytes each.

use muster_model::content::Checked;
use muster_model::teams::Teams;
use muster_model::wish::WishList;

use crate::envelope::{self, EnvelopeError, MAX_SERVICE_PAYLOAD};
use crate::recording::{framed, unframed};

/// The first bytes of the file of the clusterer.
pub const MAGIC: [u8; 8] = *b"\xB7mustkpt";

/// Version of its content. Any change of its types is a new version.
pub const VERSION: u8 = 6;

/// The first bytes of the file of the embedder.
pub const SHAPE_MAGIC: [u8; 8] = *b"\xB7mustshp";

/// Version of its content.
pub const SHAPE_VERSION: u8 = 1;

/// Magic bytes and version.
const HEAD: usize = MAGIC.len() + 1;

/// Largest file in bytes: a division as large as a message may be, and what stands around it.
pub const MAX_KEPT: usize = MAX_SERVICE_PAYLOAD + (1 << 20);

/// Why a file is not used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum KeptError {
    /// The first bytes are others, or too few.
    #[error("this is no file that this service has kept")]
    NotKept,
    /// The content has another form.
    #[error("the kept file has version {found}, and this program reads version {read}")]
    Version {
        /// That of the file.
        found: u8,
        /// The one that can be read.
        read: u8,
    },
    /// The bytes are not those that were written.
    #[error("the kept file is damaged: {0}")]
    Damaged(String),
}

/// A file of this content.
fn file(magic: [u8; 8], version: u8, content: &[u8]) -> Result<Vec<u8>, EnvelopeError> {
    let mut bytes = magic.to_vec();
    bytes.push(version);
    bytes.extend(framed(content, MAX_KEPT - 2 * HEAD)?);
    Ok(bytes)
}

/// The content of a file, which must have this version.
fn content(magic: [u8; 8], read: u8, file: &[u8]) -> Result<&[u8], KeptError> {
    let (Some(head), Some(rest)) = (file.get(..HEAD), file.get(HEAD..)) else {
        return Err(KeptError::NotKept);
    };
    let version = match head.split_last() {
        Some((found, of)) if of == magic => *found,
        _ => return Err(KeptError::NotKept),
    };
    if version != read {
        return Err(KeptError::Version { found: version, read });
    }
    unframed(rest, MAX_KEPT).map_err(KeptError::Damaged)
}

/// Bytes after their length, and the rest; none if they break off.
fn part(content: &[u8]) -> Option<(&[u8], &[u8])> {
    let (length, rest) = content.split_first_chunk()?;
    rest.split_at_checked(u32::from_le_bytes(*length) as usize)
}

/// Appends bytes and, before them, their length.
fn append(content: &mut Vec<u8>, part: &[u8]) -> Result<(), EnvelopeError> {
    let size = part.len();
    let length = u32::try_from(size);
    let length = length.map_err(|_| EnvelopeError::TooLarge { size, limit: MAX_KEPT })?;
    content.extend(length.to_le_bytes());
    content.extend(part);
    Ok(())
}

/// What the embedder keeps: what the next embedding would be without any before it may be other than what all have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct KeptShape {
    /// How many teams the last embedding showed; 0 where the number is given.
    pub teams: u32,
    /// K of it: how many triplets it had.
    pub rank: u32,
}

impl KeptShape {
    /// The bytes of the file.
    ///
    /// # Errors
    /// None that can happen: the content is small.
    pub fn encode(&self) -> Result<Vec<u8>, EnvelopeError> {
        let content = [self.teams.to_le_bytes(), self.rank.to_le_bytes()].concat();
        file(SHAPE_MAGIC, SHAPE_VERSION, &content)
    }

    /// Reads the bytes of a file.
    ///
    /// # Errors
    /// [`KeptError`] names what is wrong with them.
    pub fn decode(bytes: &[u8]) -> Result<Self, KeptError> {
        let content = content(SHAPE_MAGIC, SHAPE_VERSION, bytes)?;
        let &[a, b, c, d, e, f, g, h] = content else {
            return Err(KeptError::Damaged(format!("it has {} bytes and not 8", content.len())));
        };
        let (teams, rank) = (u32::from_le_bytes([a, b, c, d]), u32::from_le_bytes([e, f, g, h]));
        Ok(Self { teams, rank })
    }
}

/// What the clusterer keeps.
#[derive(Debug, Clone, PartialEq)]
pub struct KeptTeams {
    /// All numbers of teams below this one may have been given; they are never given again.
    pub reserved: u64,
    /// The last division, if there was one.
    pub teams: Option<Checked<Teams>>,
    /// The wishes of operators, if there were any.
    pub wishes: Option<Checked<WishList>>,
}

impl KeptTeams {
    /// The bytes of the file.
    ///
    /// # Errors
    /// [`EnvelopeError`] if the division is larger than [`MAX_KEPT`] bytes.
    pub fn encode(&self) -> Result<Vec<u8>, EnvelopeError> {
        let mut content = self.reserved.to_le_bytes().to_vec();
        let wishes =
            self.wishes.as_ref().map_or(Ok(Vec::new()), |list| envelope::encode(&**list))?;
        append(&mut content, &wishes)?;
        if let Some(teams) = &self.teams {
            content.extend(envelope::encode(&**teams)?);
        }
        file(MAGIC, VERSION, &content)
    }

    /// Reads the bytes of a file.
    ///
    /// # Errors
    /// [`KeptError`] names what is wrong with them.
    pub fn decode(bytes: &[u8]) -> Result<Self, KeptError> {
        let damaged = |problem: &dyn std::fmt::Display| KeptError::Damaged(problem.to_string());
        let content = content(MAGIC, VERSION, bytes)?;
        let broken = || damaged(&"it breaks off");
        let (reserved, rest) = content.split_first_chunk().ok_or_else(broken)?;
        let reserved = u64::from_le_bytes(*reserved);
        let (wishes, division) = part(rest).ok_or_else(broken)?;
        let mut kept = Self { reserved, teams: None, wishes: None };
        if !wishes.is_empty() {
            let list: WishList = envelope::decode(wishes).map_err(|error| damaged(&error))?;
            kept.wishes = Some(Checked::new(list).map_err(|error| damaged(&error))?);
        }
        if !division.is_empty() {
            let teams: Teams = envelope::decode(division).map_err(|error| damaged(&error))?;
            kept.teams = Some(Checked::new(teams).map_err(|error| damaged(&error))?);
        }
        Ok(kept)
    }
}

#[cfg(test)]
mod tests {
    use muster_model::header::{Header, Revision};
    use muster_model::id::{FleetId, OperatorId, RobotId, TeamId, WishId};
    use muster_model::remembered::RememberedTeams;
    use muster_model::teams::{Member, Team};
    use muster_model::wish::{StandingWish, Wish, WishKind, WishState};

    use super::*;

    fn kept() -> KeptTeams {
        let robot = RobotId::new("r1").unwrap();
        let member = Member { robot: robot.clone(), margin: 0.5 };
        let team = Team {
            id: TeamId::numbered(7),
            members: vec![member],
            leader: robot,
            centroid: vec![0.25],
        };
        let header = Header {
            fleet: FleetId::new("f").unwrap(),
            revision: Revision { term: 3, epoch: 9 },
            oldest: None,
            newest: None,
            stages: vec![],
        };
        let teams = Teams {
            header,
            embedding: Revision::default(),
            requested: 1,
            considered: vec![],
            teams: vec![team],
            unassigned: vec![],
            stale: vec![],
            inertia: 0.0,
            changes: vec![],
            next_team: 8,
            limited: None,
            needs: vec![],
            provisional: vec![],
            held: vec![],
            remembered: RememberedTeams {
                last: vec![(RobotId::new("r2").unwrap(), TeamId::numbered(6))],
                ended: vec![(TeamId::numbered(6), vec![RobotId::new("r2").unwrap()])],
                newcomers_from: 5,
            },
        };
        let wish = Wish {
            kind: WishKind::Reserve,
            robots: vec![RobotId::new("r1").unwrap()],
            team: None,
            expires: Some(2e9),
            note: None,
        };
        let wish = StandingWish {
            operator: OperatorId::new("alice").unwrap(),
            id: WishId::new("w1").unwrap(),
            wish,
            state: WishState::Active,
            reason: None,
        };
        let wishes = WishList { header: teams.header.clone(), wishes: vec![wish] };
        KeptTeams {
            reserved: 108,
            teams: Some(Checked::new(teams).unwrap()),
            wishes: Some(Checked::new(wishes).unwrap()),
        }
    }

    #[test]
    fn what_is_kept_is_read_back() {
        let alone = KeptTeams { teams: None, ..kept() };
        let numbers = KeptTeams { reserved: 5, teams: None, wishes: None };
        for kept in [kept(), alone, numbers] {
            assert_eq!(KeptTeams::decode(&kept.encode().unwrap()), Ok(kept));
        }
    }

    #[test]
    fn the_bytes_are_those_of_the_version() {
        let kept = KeptTeams { reserved: 300, teams: None, wishes: None };
        let hex = |bytes: &[u8]| bytes.iter().map(|byte| format!("{byte:02x}")).collect::<String>();
        let bytes = kept.encode().unwrap();
        assert_eq!(hex(&bytes), "b76d7573746b7074060c00000076061c5d2c0100000000000000000000");
    }

    #[test]
    fn every_damage_is_found() {
        let good = kept().encode().unwrap();
        for at in 0..good.len() {
            let mut bad = good.clone();
            bad[at] ^= 1;
            assert!(KeptTeams::decode(&bad).is_err(), "byte {at}");
            assert!(KeptTeams::decode(&good[..at]).is_err(), "{at} bytes");
        }
        assert!(KeptTeams::decode(&[&good[..], &[0]].concat()).is_err());
        let mut newer = good;
        newer[MAGIC.len()] = 9;
        assert_eq!(KeptTeams::decode(&newer), Err(KeptError::Version { found: 9, read: VERSION }));
    }

    #[test]
    fn the_shape_of_an_embedding_is_read_back_and_every_damage_is_found() {
        let shape = KeptShape { teams: 6, rank: 300 };
        let good = shape.encode().unwrap();
        assert_eq!(KeptShape::decode(&good), Ok(shape));
        let hex: String = good.iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(&hex[..18], "b76d75737473687001");
        for at in 0..good.len() {
            let mut bad = good.clone();
            bad[at] ^= 1;
            assert!(KeptShape::decode(&bad).is_err(), "byte {at}");
            assert!(KeptShape::decode(&good[..at]).is_err(), "{at} bytes");
        }
        assert_eq!(KeptShape::decode(&kept().encode().unwrap()), Err(KeptError::NotKept));
    }
}

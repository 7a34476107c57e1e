//! What viewers can watch.

use muster_model::id::Modality;

/// Something that viewers can watch.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub enum Topic {
    /// The frame of each robot.
    Transforms,
    /// Teams, and who is silent or lost.
    Teams,
    /// The links of a modality.
    Links(Modality),
    /// How good the division is, as JSON.
    Quality,
    /// Events, as lines of a log.
    Events,
}

impl Topic {
    /// What there is in every fleet.
    pub const ALWAYS: [Self; 4] = [Self::Transforms, Self::Teams, Self::Quality, Self::Events];

    /// How viewers name it. Topics of transforms may have any name; `/tf` is the usual one.
    #[must_use]
    pub fn name(&self) -> String {
        match self {
            Self::Transforms => "/tf".to_owned(),
            Self::Teams => "/teams".to_owned(),
            Self::Links(modality) => format!("/links/{modality}"),
            Self::Quality => "/quality".to_owned(),
            Self::Events => "/events".to_owned(),
        }
    }
}

//! What can be broken on purpose.

/// What is broken on purpose. Each only shows after a fault of some kind, so that there is something
/// to find when a failing run is shrunk.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mutant {
    /// The clusterer puts a robot into two places once a service was killed.
    RobotTwice,
    /// The clusterer forgets a robot once a service was killed.
    RobotForgotten,
    /// The auditor's silhouettes are off by a millionth once a link was in bad weather.
    WrongSilhouette,
    /// The auditor publishes a mean that is no number once a robot has left.
    NotANumber,
    /// The bus delivers an embedding of a lower term as the newest once a service was killed.
    OldTermAsNewest,
    /// The auditor receives no messages any more once a link was cut.
    IsolatedAuditor,
    /// The clusterer changes the leaders with every heartbeat, once settings were changed.
    Restless,
    /// The clusterer takes a robot out of its team with every heartbeat, once settings were changed.
    Fickle,
    /// Ingest gives every other roster the revision of the one before, once a service was killed.
    RevisionTwice,
    /// Every new leader except the clusterer keeps the term of the former leader, once a service
    /// was killed.
    TermTwice,
    /// The embedder names an older roster than before, once a service was killed.
    OlderRoster,
    /// The auditor sees no positions any more once a link was cut.
    NoPositions,
    /// Every service except the clusterer counts its terms from one again once all had lost their disks.
    TermsFromOne,
    /// Robots are sent terms as if they had been counted from one again.
    DeafRobots,
    /// Every leader except the clusterer goes above any term that an attacker forged.
    UnbelievedTerm,
    /// What the clusterer keeps on disk is not there once the power was cut.
    Forgetful,
    /// The clusterer takes a robot out of its team when another team has ended, once a team was cut off.
    Rearranging,
    /// The embedder receives nothing that is published any more once the hosts were busy.
    StarvedEmbedder,
    /// The clusterer puts all robots into the first team, whatever the limits are, once settings were changed.
    Overfull,
    /// A service carries its first command out again in place of the next ones, once settings were changed.
    Repetitive,
    /// The clusterer says of every team that it has one robot more with a needed skill, once settings were changed.
    Boastful,
    /// The last transaction of a historian is not on its disk once it was killed.
    LostRecords,
    /// The historian records every other event, once a service was killed.
    Forgotten,
    /// The historian takes for written what found its disk full.
    Careless,
    /// The historian does not try again once its disk was full.
    Resigned,
    /// Nothing reaches the clusterer any more once the disk of a historian was full.
    Dependent,
    /// The auditor lists two alerts in turn under one number, once settings were changed.
    Renumbered,
    /// The auditor reports its first alert again in place of whatever happens to alerts, once settings were changed.
    Insistent,
    /// The clusterer does not fill needs, and says nothing of it, once settings were changed.
    Negligent,
    /// The clusterer takes granted pins for bans, once an operator had a wish.
    Disobedient,
    /// The clusterer reports nothing when limits can hold no longer, once settings were changed.
    Silent,
    /// The clusterer gives the id of a team that has ended to another one, once settings were changed.
    Reused,
    /// The clusterer reports moves of robots the wrong way round, once settings were changed.
    Reversed,
    /// The auditor lists an alert under two numbers, once settings were changed.
    Doubled,
    /// The planner announces its settings as those of the clusterer, once a proposal was asked for.
    Meddling,
    /// The planner lists more proposals than there may be, once many were asked for.
    Hoarding,
    /// The planner does not forget proposals, once one was asked for.
    Nostalgic,
    /// Planners that stand by answer as well, once a proposal was asked for.
    Chorus,
    /// The planner leaves out a robot that would move, once a proposal was asked for.
    Discreet,
    /// The planner says another division than would come of it, once one was asked for while nothing else changes.
    Misleading,
    /// The console receives divisions in which a robot is in no team, once a service was killed.
    Misled,
    /// The bridge to ROS puts robots a little away from their place, once it was killed.
    Unmoved,
    /// The bridge to ROS gives all poses the number of the first one, once it was killed.
    Inert,
    /// The bridge to ROS shows an old team now and then, once it was killed.
    Nostalgia,
    /// The bridge to ROS does nothing, once it was killed.
    Absent,
    /// The bridge to ROS remembers topics that are gone, once a robot has restarted.
    Retentive,
    /// The bridge to ROS names nothing that it refuses, once a robot has restarted.
    Secretive,
    /// The program for viewers makes scenes that no viewer watches, once a service was killed.
    Wasteful,
    /// The program for viewers receives divisions in which a robot is in no team, once a service was killed.
    Blinded,
    /// The program for viewers shows a number of teams that no service confirmed, once settings were changed.
    Wishful,
    /// The program for viewers refuses without a reason, once settings were changed.
    Curt,
    /// The program for viewers draws lost robots in red, once a robot has left.
    Garish,
    /// The program for viewers sends each scene many times, once a service was killed.
    Wordy,
    /// A host does not announce where its instance stands, once a service was killed.
    Reticent,
    /// Every get is answered twice, once a service was killed.
    Twofold,
    /// Services answer before their state is on the disk, once settings were changed.
    Hasty,
    /// Events are too large for their key, once a service was killed.
    Voluble,
    /// Robots are sent half of what they should be, once a service was killed.
    Garbled,
    /// What cores keep is damaged on the disk, once a service was killed.
    Corrupting,
    /// Jobs are begun that no core has ordered, once a service was killed.
    Eager,
    /// The historian records another event than it received, once a service was killed.
    Falsifying,
    /// The bridge to ROS shows divisions that are still to come, once it was killed.
    Prophetic,
    /// The bridge to ROS puts what no fleet takes, once it was killed.
    Unmannerly,
}

impl Mutant {
    /// All of them.
    pub const ALL: [Self; 63] = [
        Self::RobotTwice,
        Self::RobotForgotten,
        Self::WrongSilhouette,
        Self::NotANumber,
        Self::OldTermAsNewest,
        Self::IsolatedAuditor,
        Self::Restless,
        Self::Fickle,
        Self::RevisionTwice,
        Self::TermTwice,
        Self::OlderRoster,
        Self::NoPositions,
        Self::TermsFromOne,
        Self::DeafRobots,
        Self::UnbelievedTerm,
        Self::Forgetful,
        Self::Rearranging,
        Self::StarvedEmbedder,
        Self::Overfull,
        Self::Repetitive,
        Self::Boastful,
        Self::LostRecords,
        Self::Forgotten,
        Self::Careless,
        Self::Resigned,
        Self::Dependent,
        Self::Renumbered,
        Self::Insistent,
        Self::Negligent,
        Self::Disobedient,
        Self::Silent,
        Self::Reused,
        Self::Reversed,
        Self::Doubled,
        Self::Meddling,
        Self::Hoarding,
        Self::Nostalgic,
        Self::Chorus,
        Self::Discreet,
        Self::Misleading,
        Self::Misled,
        Self::Unmoved,
        Self::Inert,
        Self::Nostalgia,
        Self::Absent,
        Self::Retentive,
        Self::Secretive,
        Self::Wasteful,
        Self::Blinded,
        Self::Wishful,
        Self::Curt,
        Self::Garish,
        Self::Wordy,
        Self::Reticent,
        Self::Twofold,
        Self::Hasty,
        Self::Voluble,
        Self::Garbled,
        Self::Corrupting,
        Self::Eager,
        Self::Falsifying,
        Self::Prophetic,
        Self::Unmannerly,
    ];

    /// The kinds of faults after which it shows.
    #[must_use]
    pub const fn after(self) -> &'static [&'static str] {
        match self {
            Self::RobotTwice
            | Self::RobotForgotten
            | Self::OldTermAsNewest
            | Self::RevisionTwice
            | Self::TermTwice
            | Self::OlderRoster
            | Self::LostRecords
            | Self::Forgotten
            | Self::Misled
            | Self::Wasteful
            | Self::Blinded
            | Self::Wordy
            | Self::Reticent
            | Self::Twofold
            | Self::Voluble
            | Self::Garbled
            | Self::Corrupting
            | Self::Eager
            | Self::Falsifying => &["kill"],
            Self::Unmoved
            | Self::Inert
            | Self::Nostalgia
            | Self::Absent
            | Self::Prophetic
            | Self::Unmannerly => &["bridge killed"],
            Self::Retentive | Self::Secretive => &["ROS robot restarts"],
            Self::WrongSilhouette => &["storm"],
            Self::NotANumber | Self::Garish => {
                &["robot leaves", "robot leaves and returns", "robot reboots"]
            }
            Self::IsolatedAuditor | Self::NoPositions => &["clean cut", "silent cut"],
            Self::Restless
            | Self::Fickle
            | Self::Overfull
            | Self::Repetitive
            | Self::Boastful
            | Self::Renumbered
            | Self::Insistent
            | Self::Negligent
            | Self::Silent
            | Self::Reused
            | Self::Reversed
            | Self::Doubled
            | Self::Hasty
            | Self::Wishful
            | Self::Curt => &["settings"],
            Self::Meddling | Self::Nostalgic | Self::Chorus | Self::Discreet => &["proposal"],
            Self::Hoarding => &["many proposals"],
            Self::Misleading => &["proposal at rest"],
            Self::Disobedient => &["wish"],
            Self::TermsFromOne | Self::DeafRobots => &["blackout without disks"],
            Self::UnbelievedTerm => &["forged term"],
            Self::Forgetful => &["power cut"],
            Self::Rearranging => &["team cut off"],
            Self::StarvedEmbedder => &["busy hosts"],
            Self::Careless | Self::Resigned | Self::Dependent => &["full disk"],
        }
    }
}

//! Every limit on the size of messages and fleets, each with its reason.

use crate::settings::MAX_DIMENSION;

/// Longest id in characters: long enough for a serial number with a prefix, short enough that a key
/// expression with three ids stays readable in a log.
pub const MAX_ID_LENGTH: usize = 64;

/// Longest free text (frame, role, boot id) in bytes: these are names, not documents, and they are
/// repeated in every roster.
pub const MAX_TEXT_LENGTH: usize = 64;

/// Most links that one robot may report at once: a radio receives far fewer neighbours, and a report of
/// this size still fits [`MAX_ROBOT_PAYLOAD`].
pub const MAX_LINKS: usize = 1024;

/// Most edges that one robot may report of one further modality, for the same reason.
pub const MAX_RELATION_EDGES: usize = 1024;

/// Most modalities that a fleet may declare in addition to the three built-in ones: each is a graph that is
/// fused in every frame.
pub const MAX_DECLARED_MODALITIES: usize = 16;

/// Most graphs of a fleet: one for each declared modality and the three built-in ones.
pub const MAX_GRAPHS: usize = MAX_DECLARED_MODALITIES + 3;

/// Most robots that a fleet may have, whatever its settings are: the dense similarity matrix of a
/// larger fleet does not fit the machines that Muster is made for.
pub const MAX_ROBOTS: usize = 100_000;

/// Most robots that belong to a fleet by their token alone. A token is cheap, and each robot costs a row of every
/// embedding and an event: whoever declares tokens under names at random must not fill the fleet. A robot
/// beyond them belongs to it from its first report on; without one it would have no team anyway.
pub const MAX_SILENT_ROBOTS: usize = 100;

/// Most teams that may be asked for: the division is read by people, and k-means is linear in it.
pub const MAX_TEAMS: u32 = 1024;

/// Most teams that are considered where neither a number nor a range is set: each further number needs one
/// more singular triplet and one more division of every frame. A range goes beyond.
pub const MAX_AUTO_TEAMS: u32 = 16;

/// Most teams that a range may end with: as many singular triplets as the largest embedding has.
pub const MAX_RANGE_TEAMS: u32 = MAX_DIMENSION / 2;

/// Largest payload of a robot in bytes: [`MAX_LINKS`] links in JSON with the longest ids fit.
pub const MAX_ROBOT_PAYLOAD: usize = 192 * 1024;

/// Largest coordinate in metres: a tenth of the distance to the moon. Squares of it stay far from
/// overflow, and a larger value is a broken sensor.
pub const MAX_COORDINATE_M: f64 = 4.0e7;

/// Largest weight of an edge: products of weights stay finite over the longest sums that are formed.
pub const MAX_WEIGHT: f64 = 1.0e6;

/// No term or epoch from here on is decoded, so that no sum of them overflows. Terms have a lower bound
/// that follows the clock ([`term`](crate::term)); epochs count frames and never come near this one.
pub const MAX_REVISION: u64 = 1 << 48;

/// Largest team whose members are all listed to each of its robots: beyond it, these lists would be
/// more bytes than all other traffic together.
pub const MAX_MEMBERS_PUBLISHED: usize = 256;

/// Most edges of one graph: at 13 bytes each and with the names of [`MAX_ROBOTS`] robots, as many as fit
/// a message between services.
pub const MAX_GRAPH_EDGES: u64 = 4_500_000;

/// Most robots that an audit and its alert list as changing teams to and fro: enough to see where in the
/// fleet it happens, and few enough to read in one line of a log.
pub const MAX_FLAPPING_ROBOTS: usize = 16;

/// Most robots that an event lists as disagreeing with a modality: some names tell an operator which source
/// to look at.
pub const MAX_DOUBTED_ROBOTS: usize = 8;

/// Most robots that an event of many robots lists; its count is that of all. With the longest names they are
/// a twelfth of what an event may hold, and a log line of usual names stays readable.
pub const MAX_ROBOTS_OF_EVENT: usize = 64;

/// Most rows of one answer of a history: what a console shows, many times over. Further rows are asked for
/// behind them.
pub const MAX_HISTORY_ROWS: u32 = 10_000;

/// Most robots that a status lists as having left, the last ones: with the longest names they and their times
/// are less than half of what a status may hold.
pub const MAX_DEPARTED_ROBOTS: usize = 256;

/// Most robots of a team that an audit lists because the team falls apart without them: those that matter most.
pub const MAX_CUT_ROBOTS: usize = 16;

/// Most losses that an audit lists: as many as an operator reads, and prepares for.
pub const MAX_LOSSES: usize = 10;

/// Most parts of a team whose sizes an audit lists for a loss. Without the centre of a star there are as many as
/// robots.
pub const MAX_LOSS_PARTS: usize = 8;

/// Most alerts that are open at once: more than one of each kind for hundreds of teams. Beyond them none is raised
/// until others end, which is counted.
pub const MAX_OPEN_ALERTS: usize = 4096;

/// Most robots that an alert lists: as many as fit a line.
pub const MAX_ALERT_ROBOTS: usize = 16;

/// Most events of alerts that an auditor publishes within any minute: what an operator can follow. The list of open alerts
/// is whole whatever happens.
pub const MAX_ALERT_EVENTS_PER_MINUTE: usize = 20;

/// Most teams whose size is set one by one: a table that people write and read.
pub const MAX_TEAM_SIZES: usize = 256;

/// Largest limit on the robots of a team: as many as a fleet may have.
pub const MAX_TEAM_SIZE: u32 = 100_000;

/// Longest text that says why limits contradict each other, in characters: some names and numbers. It stands in every
/// division for as long as that is so.
pub const MAX_CONFLICT_LENGTH: usize = 512;

/// Most wishes of a fleet: each is a decision of a person.
pub const MAX_WISHES: usize = 256;

/// Most wishes that robots be together or apart: the search may have to look at every combination.
pub const MAX_GROUP_WISHES: usize = 64;

/// Most robots that one wish names: a list that a person writes.
pub const MAX_WISH_ROBOTS: usize = 64;

/// Longest note of a wish in characters: a sentence or two.
pub const MAX_NOTE_LENGTH: usize = 256;

/// Most skills of one robot: people name them, and they are repeated in every roster.
pub const MAX_SKILLS: usize = 16;

/// Most needs of a fleet: a list that people write and read.
pub const MAX_NEEDS: usize = 64;

/// Most different skills that teams need: each is a class of robots in the flow that divides them.
pub const MAX_NEEDED_SKILLS: usize = 16;

/// Most skills of a team that an audit lists, those that it needs before others: as many as fit a line or two.
pub const MAX_AUDITED_SKILLS: usize = 32;
/// Most teams that a reason lists: a robot's own and those that draw it most, as many as fit a screen.
pub const MAX_REASON_TEAMS: usize = 16;

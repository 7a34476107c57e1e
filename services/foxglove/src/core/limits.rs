//! How often something is sent, and how much of it at most.

use std::time::Duration;

/// Scenes of one topic come at most ten times a second: the eye needs no more, and `ingest` makes no more by default.
pub const SCENE_INTERVAL: Duration = Duration::from_millis(100);

/// A scene that has not changed is sent again after this time, for viewers that missed it.
pub const REPEAT_INTERVAL: Duration = Duration::from_secs(1);

/// How long a viewer keeps a scene that is not sent again: three that were lost, and then it shows nothing rather than
/// something that is old.
pub const SCENE_LIFETIME: Duration = Duration::from_secs(4);

/// Scenes of links in one turn. Of more modalities that are watched each has its turn.
pub const MAX_LINK_SCENES: usize = 2;

/// Events in one turn.
pub const MAX_EVENTS_SENT: usize = 3;

/// Most messages in one turn: transforms, teams and quality, links, and events.
pub const MAX_TURN_MESSAGES: usize = 3 + MAX_LINK_SCENES + MAX_EVENTS_SENT;

/// Messages that wait for one viewer, of all topics together; the oldest makes room. They are three turns at least, and more where
/// less is sent in each: with few, a viewer that reads slowly loses scenes that are sent once a second. The largest message of 10,000
/// robots has about a megabyte, so that a viewer that reads nothing costs less than 32 MiB.
pub const MAX_WAITING_MESSAGES: usize = 3 * MAX_TURN_MESSAGES;

/// Most events that wait for their turn; when a whole fleet joins, more are counted and left out.
pub const MAX_WAITING_EVENTS: usize = 256;

/// Most links of a modality that are drawn; of more, those with the largest weights are.
pub const MAX_LINKS: usize = 10_000;

/// In how many steps of opacity links are drawn. Each step is one set of lines.
pub const LINK_STEPS: usize = 8;

/// Most robots that have left and are still shown.
pub const MAX_LOST: usize = 1024;

/// How long they are: as long as the console shows them.
pub const LOST_FOR: Duration = Duration::from_secs(3600);

/// Most silent or lost robots that have a text with their age, those that were received last first.
pub const MAX_AGES: usize = 100;

/// How often the graph of a modality is asked for while it is watched.
pub const GRAPH_PERIOD: Duration = Duration::from_secs(1);

/// How often settings are asked for; after a command they are asked for at once.
pub const SETTINGS_PERIOD: Duration = Duration::from_secs(5);

/// When a question that was not answered is asked again: longer than any answer is waited for.
pub const FETCH_TIMEOUT: Duration = Duration::from_secs(15);

/// How long a question for parameters waits for the first settings.
pub const PARAMETERS_WITHIN: Duration = Duration::from_secs(3);

/// Most changes of parameters that wait for their answer.
pub const MAX_PENDING_CHANGES: usize = 16;

/// Most questions for parameters that wait for the first settings.
pub const MAX_PENDING_QUESTIONS: usize = 64;

/// Most parameters in one change: more than there are.
pub const MAX_PARAMETERS: usize = 16;

/// Longest name of a parameter in bytes: longer than any there is.
pub const MAX_PARAMETER_NAME_BYTES: usize = 128;

/// Longest value of a parameter in JSON, in bytes: weights of a hundred modalities fit.
pub const MAX_PARAMETER_BYTES: usize = 16 * 1024;

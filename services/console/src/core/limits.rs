//! How much a browser may cost, and how much it may ask for.

use std::time::Duration;

/// Most browsers at once: an operations room has a dozen screens, and each costs up to [`MAX_WAITING_BYTES`].
pub const MAX_BROWSERS: usize = 32;

/// What a browser that reads nothing costs at most, in bytes: one turn, and the replies that wait for the next.
pub const MAX_WAITING_BYTES: usize = MAX_TURN_BYTES + MAX_REPLY_BYTES;

/// Most bytes of one turn. The frame of the largest fleet (800,048 bytes) and a large topic fit.
pub const MAX_TURN_BYTES: usize = 3 * 1024 * 1024;

/// Longest topic or piece of names in bytes. What is longer is replaced by a sentence that says so: 4,096 alerts or 256
/// wishes with the longest texts fit.
pub const MAX_TOPIC_BYTES: usize = 2 * 1024 * 1024;

/// Most bytes of the replies that wait for one browser. A division of 10,000 robots as of a moment fits.
pub const MAX_REPLY_BYTES: usize = 1024 * 1024;

/// Longest message of a browser in bytes: a wish of 64 robots with the longest names, and a selection of 400 robots.
pub const MAX_MESSAGE_BYTES: usize = 32 * 1024;

/// Most messages of a browser in a second: a credit for each drawn frame on a fast screen, and what a hand can click.
pub const MAX_MESSAGES_PER_SECOND: u32 = 250;

/// Most commands and steps of proposals of a browser in a minute: a person gives one in some seconds.
pub const MAX_COMMANDS_PER_MINUTE: u32 = 60;

/// Most questions of a browser in a minute: a person who looks at one robot after the other asks two questions for each, at
/// one robot a second, and the reason of the last one is asked for again every three seconds.
pub const MAX_QUESTIONS_PER_MINUTE: u32 = 150;

/// Most commands of a browser that wait for their answer, and most questions.
pub const MAX_PENDING: usize = 16;

/// Most robots whose links a browser may choose.
pub const MAX_LINK_ROBOTS: usize = 400;

/// Most links of a frame; of more, those with the largest weights are shown.
pub const MAX_LINKS_SHOWN: usize = 10_000;

/// Most robots in a piece of names: with the longest names, roles and skills it stays below [`MAX_TOPIC_BYTES`].
pub const NAMES_PER_PIECE: usize = 1024;

/// Most robots that have left and are still shown.
pub const MAX_LOST: usize = 1024;

/// How long they are: as long as `ingest` lists those that have left.
pub const LOST_FOR: Duration = Duration::from_secs(3600);

/// Most silent or lost robots that the topic `lost` lists, the ones that were received last first.
pub const MAX_LOST_LISTED: usize = 512;

/// How many events are kept for browsers that open later.
pub const MAX_EVENTS: usize = 200;

/// When a browser that has not drawn its last turn is closed. Browsers call hidden pages once a minute.
pub const STALLED_AFTER: Duration = Duration::from_secs(150);

/// How often the states of services are asked for, while a browser is open.
pub const STATUS_PERIOD: Duration = Duration::from_secs(2);

/// How often settings are; after a command they are asked for at once.
pub const SETTINGS_PERIOD: Duration = Duration::from_secs(5);

/// How often wishes are; after a command they are asked for at once.
pub const WISHES_PERIOD: Duration = Duration::from_secs(2);

/// How often the embedding and graphs are, while a browser shows them.
pub const PICTURE_PERIOD: Duration = Duration::from_secs(1);

/// How often the embedding is asked for while no one shows it, for the weights that it was made with: seldom, as that of a
/// large fleet is a megabyte.
pub const WEIGHTS_PERIOD: Duration = Duration::from_secs(10);

/// When a question that was not answered is asked again: longer than any answer is waited for.
pub const FETCH_TIMEOUT: Duration = Duration::from_secs(15);

/// Most robots that would move which a proposal names in a browser: with the longest names they take less than half of
/// [`MAX_REPLY_BYTES`].
pub const MAX_MOVES_LISTED: usize = 2048;

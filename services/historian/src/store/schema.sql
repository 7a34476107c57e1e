-- The history of a fleet. Times are microseconds since the Unix epoch, by the clock of the recording host.
-- Numbers (seq) grow with every record of all tables, whatever the clock does, and are never given twice.

CREATE TABLE meta (key TEXT PRIMARY KEY, value NOT NULL) WITHOUT ROWID;

-- Spans in which the clock did not go back. One begins with each start of the recording process as well.
CREATE TABLE eras (
    era INTEGER PRIMARY KEY,
    first_seq INTEGER NOT NULL,
    first_us INTEGER NOT NULL,
    cause TEXT NOT NULL,             -- start or clock
    instance TEXT NOT NULL
);

-- The first record of each minute: what is forgotten is forgotten in whole minutes.
CREATE TABLE minutes (first_seq INTEGER PRIMARY KEY, at_us INTEGER NOT NULL);

-- Divisions that differ from the one before, and whole ones.
CREATE TABLE divisions (
    seq INTEGER PRIMARY KEY,
    era INTEGER NOT NULL,
    at_us INTEGER NOT NULL,
    term INTEGER NOT NULL,
    epoch INTEGER NOT NULL,
    requested INTEGER NOT NULL,
    teams INTEGER NOT NULL,
    robots INTEGER NOT NULL,
    snapshot TEXT                    -- start, gap or periodic where all places are recorded; null for changes
);
CREATE INDEX divisions_at ON divisions (era, at_us);
CREATE INDEX divisions_whole ON divisions (seq) WHERE snapshot IS NOT NULL;

-- Where every robot was in a whole division.
CREATE TABLE places (
    division INTEGER NOT NULL,
    robot TEXT NOT NULL,
    present INTEGER NOT NULL,        -- 0: the division does not contain it
    team TEXT,
    stale INTEGER NOT NULL,
    PRIMARY KEY (division, robot)
) WITHOUT ROWID;

-- Where robots were from another division on, if that was elsewhere than before.
CREATE TABLE moves (
    division INTEGER NOT NULL,
    robot TEXT NOT NULL,
    present INTEGER NOT NULL,
    team TEXT,
    stale INTEGER NOT NULL,
    was TEXT,                        -- the team before
    PRIMARY KEY (division, robot)
) WITHOUT ROWID;
CREATE INDEX moves_of ON moves (robot, division);

-- Teams from a division on: all of a whole one, otherwise those whose leader or members are others.
CREATE TABLE division_teams (
    division INTEGER NOT NULL,
    team TEXT NOT NULL,
    leader TEXT,                     -- null once it has ended
    members INTEGER NOT NULL,
    PRIMARY KEY (division, team)
) WITHOUT ROWID;
CREATE INDEX division_teams_of ON division_teams (team, division);

CREATE TABLE audits (
    seq INTEGER PRIMARY KEY,
    era INTEGER NOT NULL,
    at_us INTEGER NOT NULL,
    term INTEGER NOT NULL,
    epoch INTEGER NOT NULL,
    division_term INTEGER NOT NULL,
    division_epoch INTEGER NOT NULL,
    mean REAL,
    physical_mean REAL,
    verdict TEXT NOT NULL            -- good, fair, poor or undefined
);
CREATE INDEX audits_at ON audits (era, at_us);

CREATE TABLE audit_teams (
    audit INTEGER NOT NULL,
    team TEXT NOT NULL,
    mean REAL,
    PRIMARY KEY (audit, team)
) WITHOUT ROWID;

CREATE TABLE events (
    seq INTEGER PRIMARY KEY,
    at_us INTEGER NOT NULL,
    source TEXT NOT NULL,
    term INTEGER NOT NULL,
    epoch INTEGER NOT NULL,
    severity TEXT NOT NULL,          -- info, warning or error
    kind TEXT NOT NULL,
    detail TEXT NOT NULL             -- the fields of the kind, as a JSON object
);
CREATE INDEX events_of ON events (kind);

-- Stays of robots in the fleet.
CREATE TABLE stays (
    stay INTEGER PRIMARY KEY AUTOINCREMENT,
    robot TEXT NOT NULL,
    joined_us INTEGER,               -- null: it was there when the recording began
    recorded_us INTEGER NOT NULL,
    left_us INTEGER,                 -- null: it is there
    last_seen_us INTEGER,
    reason TEXT                      -- disconnected, silent or unrecorded
);
CREATE INDEX stays_of ON stays (robot);
CREATE UNIQUE INDEX stays_open ON stays (robot) WHERE left_us IS NULL;

CREATE TABLE settings (
    seq INTEGER PRIMARY KEY,
    at_us INTEGER NOT NULL,
    service TEXT NOT NULL,
    term INTEGER NOT NULL,
    epoch INTEGER NOT NULL,
    settings TEXT NOT NULL           -- all of them, as a JSON object
);

-- Where records were lost.
CREATE TABLE gaps (
    seq INTEGER PRIMARY KEY,
    at_us INTEGER NOT NULL,
    from_us INTEGER NOT NULL,
    until_us INTEGER NOT NULL,
    records INTEGER NOT NULL
);

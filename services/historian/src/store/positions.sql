-- Where robots were. It may be made in a file that is older than these tables.
-- A survey has the robots that were elsewhere than in the last whole one before it, or all.
CREATE TABLE IF NOT EXISTS surveys (
    seq INTEGER PRIMARY KEY,
    era INTEGER NOT NULL,
    at_us INTEGER NOT NULL,
    is_whole INTEGER NOT NULL
);
CREATE INDEX IF NOT EXISTS surveys_at ON surveys (era, at_us);
CREATE INDEX IF NOT EXISTS surveys_whole ON surveys (seq) WHERE is_whole;
CREATE TABLE IF NOT EXISTS positions (
    survey INTEGER NOT NULL,
    robot TEXT NOT NULL,
    east_cm INTEGER NOT NULL,
    north_cm INTEGER NOT NULL,
    PRIMARY KEY (survey, robot)
) WITHOUT ROWID;

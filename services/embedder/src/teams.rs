//! How many teams `clusterer` divides the fleet into, by the settings that it announces.

use std::time::Duration;

use muster_model::header::Revision;
use muster_model::settings::{ClustererSettings, Settings, SettingsError, TeamCount, from_value};
use muster_model::time::Tick;
use muster_service::following::Acceptance;
use muster_wire::envelope::AnnouncedSettings;

/// How often the settings are asked for. `clusterer` announces them repeatedly, but a forged announcement
/// of a later revision would shut those out, and only answers can contradict it. Seldom is enough: the
/// settings seldom change, and only guide the choice of the dimension and what is published as evidence.
const ASK_INTERVAL: Duration = Duration::from_secs(10);

/// The same once an announcement was older than the newest one: either it was overtaken, or the newest one was forged.
const DOUBT_INTERVAL: Duration = Duration::from_secs(1);

/// The newest announcement.
#[derive(Debug)]
pub(crate) struct TeamsWanted {
    teams: TeamCount,
    /// The revision of the announcement; none before the first.
    at: Option<Revision>,
    /// Whether the last answer to a question was older than the announcement.
    contradicted: bool,
    /// Whether an announcement since the newest one was older.
    is_doubtful: bool,
    asked: Tick,
}

impl Default for TeamsWanted {
    fn default() -> Self {
        Self {
            teams: ClustererSettings::default().teams,
            at: None,
            contradicted: false,
            is_doubtful: false,
            asked: Tick::default(),
        }
    }
}

impl TeamsWanted {
    /// How many teams the fleet is divided into.
    pub(crate) fn teams(&self) -> TeamCount {
        self.teams
    }

    /// Accepts an announcement, unless it is older than what is known: it was overtaken. The same revision
    /// counts, because settings change between two outputs.
    ///
    /// # Errors
    /// Why the settings are refused; those before stay.
    pub(crate) fn accept(
        &mut self,
        announced: &AnnouncedSettings,
    ) -> Result<Acceptance, SettingsError> {
        // A leader without state announces its settings without a term. They hold, whatever was before.
        let revision = announced.header.revision;
        if revision.term > 0 && self.is_old(announced) {
            self.is_doubtful = true;
            return Ok(Acceptance::Old);
        }
        self.apply(announced)?;
        Ok(Acceptance::Applied)
    }

    fn is_old(&self, announced: &AnnouncedSettings) -> bool {
        self.at.is_some_and(|at| announced.header.revision < at)
    }

    /// Accepts an answer. When two answers in a row are older than the announcement, that one is void (it
    /// was forged, or its sender has lost its term), and the answer counts.
    ///
    /// # Errors
    /// As [`TeamsWanted::accept`].
    pub(crate) fn accept_answer(
        &mut self,
        answer: &AnnouncedSettings,
    ) -> Result<(), SettingsError> {
        if self.is_old(answer) && !self.contradicted {
            self.contradicted = true;
            return Ok(());
        }
        self.apply(answer)
    }

    fn apply(&mut self, announced: &AnnouncedSettings) -> Result<(), SettingsError> {
        self.teams = teams_of(&announced.settings)?;
        self.at = Some(announced.header.revision);
        (self.contradicted, self.is_doubtful) = (false, false);
        Ok(())
    }

    /// They have been asked for.
    pub(crate) fn asked(&mut self, now: Tick) {
        self.asked = now;
    }

    /// When they are to be asked for again.
    pub(crate) fn due(&self) -> Tick {
        self.asked.after(if self.is_doubtful { DOUBT_INTERVAL } else { ASK_INTERVAL })
    }
}

/// The number of teams in settings of `clusterer`.
fn teams_of(text: &str) -> Result<TeamCount, SettingsError> {
    let value = serde_json::from_str(text)
        .map_err(|error| SettingsError::new("(settings)", format!("is no JSON: {error}")))?;
    let settings: ClustererSettings = from_value(value)?;
    settings.check()?;
    Ok(settings.teams)
}

//! What a console asks the recordings of a fleet.

use muster_bus::{Answer, Ask, Target};
use muster_model::history::{HistoryAnswer, Query, RecordingState, Rows};
use muster_model::id::{InstanceId, ServiceName};
use muster_wire::{Key, Pattern, history};

use crate::client::Client;
use crate::error::Error;
use crate::get::REPLY_TIMEOUT;

impl Client {
    /// What the fleet was. Of several recordings, the one that begins first answers; as of a moment, the one
    /// whose division is the last until then.
    ///
    /// # Errors
    /// [`Error::Refused`] if the history cannot answer, [`Error::Unanswered`] if no `historian` runs,
    /// [`Error::Bus`] if the bus fails.
    pub async fn get_history(&self, query: &Query) -> Result<HistoryAnswer, Error> {
        let answers = self.histories(&Pattern::Histories, query).await?;
        let best = answers.into_iter().min_by_key(|answer| {
            let division = match &answer.rows {
                Rows::AsOf(division) => division.as_ref().map(|division| division.at),
                _ => None,
            };
            let from = answer.recorded_from.map_or(u64::MAX, |from| from.0);
            (u64::MAX - division.map_or(0, |at| at.0), from)
        });
        best.ok_or_else(|| self.unanswered("history"))
    }

    /// The same of one recording: the rows behind those that it has answered, by [`Query::before`].
    ///
    /// # Errors
    /// As [`Client::get_history`].
    pub async fn get_history_of(
        &self,
        instance: &InstanceId,
        query: &Query,
    ) -> Result<HistoryAnswer, Error> {
        let pattern = Pattern::One(Key::History(instance.clone()));
        let answers = self.histories(&pattern, query).await?;
        let answer = answers.into_iter().find(|answer| answer.instance == *instance);
        answer.ok_or_else(|| self.unanswered(format!("history/{instance}")))
    }

    /// How far each recording goes, ordered by instance. Empty if no `historian` runs.
    ///
    /// # Errors
    /// [`Error::Bus`] if the bus fails.
    pub async fn get_history_states(&self) -> Result<Vec<RecordingState>, Error> {
        let ask = Ask {
            parameters: "",
            payload: None,
            within: REPLY_TIMEOUT,
            further_within: None,
            target: Target::All,
        };
        let mut states = Vec::new();
        for answer in self.get(&Pattern::HistoryStates, ask).await? {
            let Answer::Packet(packet) = answer else { continue };
            match history::state(self.bus().space(), &packet) {
                Ok(state) => states.push(state),
                Err(refused) => tracing::warn!("refused on {}: {}", refused.key, refused.reason),
            }
        }
        states.sort_by(|left, right| left.instance.cmp(&right.instance));
        Ok(states)
    }

    async fn histories(
        &self,
        pattern: &Pattern,
        query: &Query,
    ) -> Result<Vec<HistoryAnswer>, Error> {
        let parameters = history::parameters(query);
        let ask = Ask {
            parameters: &parameters,
            payload: None,
            within: REPLY_TIMEOUT,
            further_within: None,
            target: Target::All,
        };
        let (mut answers, mut refused) = (Vec::new(), None);
        for answer in self.get(pattern, ask).await? {
            match answer {
                Answer::Packet(packet) => match history::answer(self.bus().space(), &packet) {
                    Ok(answer) => answers.push(answer),
                    Err(refused) => {
                        tracing::warn!("refused on {}: {}", refused.key, refused.reason);
                    }
                },
                Answer::Error(error) => {
                    let service = ServiceName::Historian;
                    refused = Some(Error::reply(service, &error));
                }
            }
        }
        match refused {
            Some(refused) if answers.is_empty() => Err(refused),
            _ => Ok(answers),
        }
    }
}

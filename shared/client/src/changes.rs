//! Everything that a console shows of a fleet, in one stream.

use futures_util::stream::BoxStream;
use futures_util::{Stream, StreamExt as _, stream};
use muster_model::audit::Audit;
use muster_model::event::Event;
use muster_model::teams::Teams;

use crate::client::Client;
use crate::error::Error;
use crate::freshness::Latest;

/// A change of what a console shows.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub enum Change {
    /// The division changed, or whether it is stale.
    Teams(Latest<Teams>),
    /// The silhouettes changed, or whether they are stale.
    Audit(Latest<Audit>),
    /// An event of a service.
    Event(Event),
    /// The link to the router was restored.
    LinkRestored,
    /// The link to the router was lost.
    LinkLost,
}

impl Client {
    /// Every change of the division, the audit and the link, and all events, until the client is closed.
    /// The newest division and audit come first. Positions of robots are in [`Client::rosters`].
    ///
    /// # Errors
    /// [`Error::Bus`] if the bus fails.
    pub async fn changes(
        &self,
    ) -> Result<impl Stream<Item = Change> + Send + Unpin + 'static, Error> {
        let link = stream::unfold(self.link(), async |mut link| {
            link.changed().await.ok()?;
            let linked = *link.borrow_and_update();
            Some((if linked { Change::LinkRestored } else { Change::LinkLost }, link))
        });
        let all: [BoxStream<'static, Change>; 4] = [
            self.teams().await?.into_stream().map(Change::Teams).boxed(),
            self.audits().await?.into_stream().map(Change::Audit).boxed(),
            self.events().await?.into_stream().map(Change::Event).boxed(),
            link.boxed(),
        ];
        Ok(stream::select_all(all))
    }
}

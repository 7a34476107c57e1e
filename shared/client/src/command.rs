//! What operators command: settings, wishes, and alerts that they have seen.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use muster_bus::{Ask, Target};
use muster_model::alert::{AcknowledgeAlert, Alerts};
use muster_model::command::{Action, OperatorCommand};
use muster_model::header::Revision;
use muster_model::id::{CommandId, OperatorId, ServiceName, WishId};
use muster_model::wish::{StandingWish, Wish};
use muster_wire::Key;
use serde_json::{Map, Value};

use crate::client::Client;
use crate::error::Error;
use crate::get::{ask_for, is_acknowledged};
use crate::reporter::wall_clock;

/// How long a command may be carried out: longer than its answer is waited for, and shorter than anybody forgets what he
/// has commanded.
const VALID_TIME: Duration = Duration::from_secs(30);

/// How long a command is sent again that a service cannot carry out now: one that starts, or hung, knows within about two
/// seconds whether it leads, and a disk that is slow has stored what is being carried out.
const UNAVAILABLE_TIME: Duration = Duration::from_secs(5);

/// Time between two of these.
const UNAVAILABLE_PAUSE: Duration = Duration::from_millis(200);

impl Client {
    /// Commands a service, and returns what came of it, with the fields of the schema `command_outcome`. The command has an
    /// id of its own; however often the bus repeats it, it is carried out once. It is on the disk of the service then.
    ///
    /// # Errors
    /// [`Error::Refused`] if the service refuses the command; the reason names the field. [`Error::Unavailable`] if it
    /// cannot carry it out now, [`Error::Unstored`] if it has, and could not store it. [`Error::Unanswered`] if it does not
    /// run, [`Error::Denied`] if the rules of the router drop the command, [`Error::Bus`] if the bus fails.
    pub async fn command(
        &self,
        operator: &OperatorId,
        service: ServiceName,
        action: Action,
        based_on: Option<Revision>,
    ) -> Result<Value, Error> {
        let now = wall_clock();
        let (sent, expires) = (now.as_seconds(), now.after(VALID_TIME).as_seconds());
        let command = OperatorCommand { sent, expires, based_on, action };
        let payload = serde_json::to_vec(&command).map_err(Error::bus)?;
        let key = Key::Command(service, operator.clone(), command_id(now.0)?);
        let mut unavailable = None;
        loop {
            let ask = Ask { payload: Some(&payload), ..ask_for("format=json", Target::Complete) };
            let answered = self.json_of_leader(service, &key, ask).await;
            let since: Instant = *unavailable.get_or_insert_with(Instant::now);
            if !matches!(answered, Err(Error::Unavailable { .. }))
                || since.elapsed() >= UNAVAILABLE_TIME
            {
                return answered;
            }
            // The same command again is carried out once.
            tokio::time::sleep(UNAVAILABLE_PAUSE).await;
        }
    }

    /// Changes settings of a service, and returns all of them. The patch is a JSON object with the fields to change; it is
    /// checked as a whole, applied at once and kept over a restart of the service. `null` resets a field to its default.
    ///
    /// # Errors
    /// As [`Client::command`]; [`Error::Refused`] if a field is unknown or a value is wrong.
    pub async fn change_settings(
        &self,
        operator: &OperatorId,
        service: ServiceName,
        patch: &Value,
    ) -> Result<Value, Error> {
        let Value::Object(patch) = patch else {
            let reason = "the patch must be an object such as {\"teams\": 3}".to_owned();
            return Err(Error::Refused { service, reason });
        };
        let outcome = self.command(operator, service, Action::Set(patch.clone()), None).await?;
        match outcome.get("answer") {
            Some(settings @ Value::Object(_)) => Ok(settings.clone()),
            _ => self.get_settings(service).await,
        }
    }

    /// Puts a wish of an operator, in place of the one with this id, and returns it with what has become of it.
    ///
    /// # Errors
    /// As [`Client::command`]; [`Error::Refused`] if a field is wrong, or the wish contradicts limits or other wishes; the
    /// reason says how.
    pub async fn put_wish(
        &self,
        operator: &OperatorId,
        id: &WishId,
        wish: &Wish,
    ) -> Result<StandingWish, Error> {
        let wish: Map<String, Value> = match serde_json::to_value(wish).map_err(Error::bus)? {
            Value::Object(wish) => wish,
            _ => Map::new(),
        };
        self.change_wish(operator, id, Action::Wish { id: id.clone(), wish }).await
    }

    /// Withdraws a wish of an operator, and returns it as it was.
    ///
    /// # Errors
    /// As [`Client::put_wish`]; [`Error::Refused`] if it is not there.
    pub async fn withdraw_wish(
        &self,
        operator: &OperatorId,
        id: &WishId,
    ) -> Result<StandingWish, Error> {
        self.change_wish(operator, id, Action::Withdraw { id: id.clone() }).await
    }

    async fn change_wish(
        &self,
        operator: &OperatorId,
        id: &WishId,
        action: Action,
    ) -> Result<StandingWish, Error> {
        let outcome = self.command(operator, ServiceName::Clusterer, action, None).await?;
        match outcome.get("answer") {
            Some(wish @ Value::Object(_)) => {
                serde_json::from_value(wish.clone()).map_err(Error::bus)
            }
            _ => {
                let is_it = |one: &StandingWish| one.operator == *operator && one.id == *id;
                let one = self.get_wishes().await?.into_iter().find(is_it);
                one.ok_or_else(|| self.unanswered(Key::Wishes))
            }
        }
    }

    /// Says that an operator has seen an alert, and returns the list of open alerts.
    ///
    /// # Errors
    /// As [`Client::command`]; [`Error::Refused`] if no such alert is open.
    pub async fn acknowledge_alert(
        &self,
        operator: &OperatorId,
        alert: u64,
    ) -> Result<Arc<Alerts>, Error> {
        let action = Action::Acknowledge { alert };
        self.command(operator, ServiceName::Auditor, action, None).await?;
        let alerts = self.get_alerts().await?;
        let wanted = AcknowledgeAlert { operator: operator.clone(), alert };
        let is_open = alerts.open.iter().any(|open| open.id == alert);
        if is_open && !is_acknowledged(&alerts, &wanted) {
            return Err(self.unanswered(Key::Alerts));
        }
        Ok(alerts)
    }
}

/// An id that no other command of this operator has: the moment, the process, and how many it has sent.
fn command_id(micros: u64) -> Result<CommandId, Error> {
    static SENT: AtomicU64 = AtomicU64::new(0);
    let number = SENT.fetch_add(1, Ordering::Relaxed);
    let process = std::process::id();
    CommandId::new(format!("{micros:x}-{process:x}-{number:x}")).map_err(Error::bus)
}

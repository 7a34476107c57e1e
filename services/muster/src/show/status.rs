//! `muster status`: services and robots of the live fleet.

use std::io::Write as _;
use std::time::Duration;

use muster_model::id::ServiceName;
use muster_model::role::Standing;
use muster_model::roster::{Presence, Roster};
use muster_model::status::ServiceStatus;
use muster_runtime::bus::{Answer, Ask, Bus};
use muster_runtime::clock::Clock;
use muster_runtime::config::ProcessConfig;
use muster_runtime::exit::ExitError;
use muster_wire::{Key, Message, Pattern};
use serde_json::json;

use super::{ShowArgs, table};
use crate::ask;

/// How often `--watch` looks.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// What is known of a fleet at one look.
struct Look {
    services: Vec<ServiceStatus>,
    silent: Vec<String>,
    tokens: usize,
    roster: Option<std::sync::Arc<Roster>>,
}

/// Shows services and robots, once or every second.
///
/// # Errors
/// If no router answers.
pub(crate) async fn run(args: &ShowArgs, config: &ProcessConfig) -> anyhow::Result<()> {
    let clock = Clock::start();
    let bus = ask::open(config).await?;
    loop {
        let mut look = look(&bus).await?;
        if !look.silent.is_empty() {
            // A get may be lost where links or roles are about to change; nobody is told of as silent
            // who was asked but once.
            look = self::look(&bus).await?;
        }
        print(&look, config, args.json, &clock)?;
        if !args.watch {
            if look.services.is_empty() && look.tokens == 0 {
                let fleet = &config.fleet.value;
                let problem = format!("nobody answers for fleet {fleet}; is --fleet right?");
                return Err(ExitError::unreachable(problem).into());
            }
            break;
        }
        tokio::time::sleep(LOOK_EVERY).await;
    }
    bus.close().await;
    Ok(())
}

async fn look(bus: &Bus) -> anyhow::Result<Look> {
    let ask = Ask {
        parameters: "format=json",
        payload: None,
        within: ask::ANSWER_WITHIN,
        everybody: true,
    };
    let (statuses, running, robots, rosters) = tokio::try_join!(
        bus.get(&Pattern::Statuses, ask),
        bus.tokens(&Pattern::ServiceTokens, ask::ANSWER_WITHIN),
        bus.tokens(&Pattern::RobotTokens, ask::ANSWER_WITHIN),
        ask::messages(bus, &Pattern::One(Key::Roster)),
    )?;
    let mut services: Vec<ServiceStatus> = statuses
        .into_iter()
        .filter_map(|answer| match answer {
            Answer::Packet(packet) => serde_json::from_slice(&packet.payload.ok()?).ok(),
            Answer::Error(_) => None,
        })
        .collect();
    services.sort_by(|left, right| {
        (left.service, &left.instance).cmp(&(right.service, &right.instance))
    });
    let silent = running
        .iter()
        .filter_map(|key| match key {
            Key::ServiceToken(service, instance) => {
                let answered = services.iter().any(|status| status.instance == *instance);
                (!answered).then(|| format!("{service} {instance}"))
            }
            _ => None,
        })
        .collect();
    let roster = rosters
        .into_iter()
        .filter_map(|message| match message {
            Message::Roster(roster) => Some(roster),
            _ => None,
        })
        .max_by_key(|roster| roster.header.revision);
    Ok(Look { services, silent, tokens: robots.len(), roster })
}

/// What an instance does about the role of its service, in a word.
fn standing(standing: Standing) -> &'static str {
    match standing {
        Standing::Starting => "starting",
        Standing::Standby => "stands by",
        Standing::Doubtful => "in doubt",
        Standing::Holding => "holds",
    }
}

fn print(look: &Look, config: &ProcessConfig, json: bool, clock: &Clock) -> anyhow::Result<()> {
    let now = clock.now();
    let mut out = std::io::stdout().lock();
    let absent: Vec<ServiceName> = ServiceName::ALL
        .into_iter()
        .filter(|name| !look.services.iter().any(|status| status.service == *name))
        .collect();
    if json {
        let robots = look.roster.iter().flat_map(|roster| &roster.robots).map(|entry| {
            json!({
                "robot": entry.robot, "presence": entry.presence, "position": entry.position,
                "frame": entry.frame, "superior": entry.superior, "role": entry.role,
                "silent_s": now.since(entry.last_seen).as_secs_f64(),
            })
        });
        let line = json!({
            "fleet": config.fleet.value, "services": look.services, "absent": absent,
            "silent": look.silent, "robot_tokens": look.tokens,
            "robots": robots.collect::<Vec<_>>(),
        });
        writeln!(out, "{line}")?;
        return Ok(out.flush()?);
    }
    let mut services =
        table(&["service", "instance", "standing", "term", "epoch", "up", "refused", "state"]);
    for status in &look.services {
        let refused = status.counters.get("messages_refused").copied().unwrap_or_default();
        services.add_row([
            status.service.to_string(),
            status.instance.to_string(),
            standing(status.standing).to_owned(),
            status.revision.term.to_string(),
            status.revision.epoch.to_string(),
            format!("{} s", status.now.since(status.started).as_secs()),
            refused.to_string(),
            // Anybody may answer a get: what is printed is made harmless.
            muster_wire::message::quoted(&status.state),
        ]);
    }
    writeln!(out, "fleet {}", config.fleet.value)?;
    writeln!(out, "{services}")?;
    for name in absent {
        writeln!(out, "{name} does not answer; start it with `muster up {name}`")?;
    }
    for name in &look.silent {
        writeln!(out, "{name} is on the bus and does not answer")?;
    }
    match &look.roster {
        Some(roster) => {
            let count =
                |presence| roster.robots.iter().filter(|entry| entry.presence == presence).count();
            let unplaced = roster.robots.iter().filter(|entry| entry.position.is_none()).count();
            writeln!(
                out,
                "{} robots: {} active, {} stale; {unplaced} without a position; {} with a token",
                roster.robots.len(),
                count(Presence::Active),
                count(Presence::Stale),
                look.tokens,
            )?;
        }
        None => writeln!(out, "no roster: ingest has not published one")?,
    }
    Ok(out.flush()?)
}

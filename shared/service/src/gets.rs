//! Gets: who waits for an answer, and answers that wait for stored state.

use std::collections::{BTreeMap, VecDeque};

use muster_wire::json::Problem;
use muster_wire::{KeySpace, Message, Request};

use crate::io::{GetId, Reply};
use crate::replica::settings::problem_json;

/// Most gets that wait for an answer at once: twice what a core may keep waiting by itself.
const MAX_OPEN_GETS: usize = 512;

/// Most answers that wait for stored state. A disk that hangs must not take memory.
const MAX_HELD_REPLIES: usize = 512;

/// A get of a key that the core serves. It cannot be copied: the core answers it exactly once, by
/// `Context::reply`.
#[derive(Debug)]
#[must_use = "every get is answered exactly once"]
pub struct Get {
    pub(crate) id: GetId,
    /// What is asked for.
    pub request: Request,
}

/// The gets that wait.
#[derive(Debug, Default)]
pub(crate) struct Gets {
    open: BTreeMap<GetId, Request>,
    /// Answers that wait until everything stored before them is on disk, in order.
    held: VecDeque<HeldReply>,
    /// State that is being written: how many times it was handed out and not confirmed.
    pending_stores: u32,
}

#[derive(Debug)]
struct HeldReply {
    reply: Reply,
    /// How many stores must be confirmed before.
    stores_before: u32,
    /// Whether the answer confirms what is being stored, so that it is wrong if that fails.
    confirms_store: bool,
}

impl Gets {
    /// A get waits from now on.
    ///
    /// # Errors
    /// The text of an error if too many wait.
    pub(crate) fn open(&mut self, id: GetId, request: Request) -> Result<Get, String> {
        if self.open.len() >= MAX_OPEN_GETS || self.held.len() >= MAX_HELD_REPLIES {
            let problem = "too many gets wait for an answer; ask again later";
            return Err(Problem::unavailable("(get)", problem).to_json());
        }
        self.open.insert(id, request.clone());
        Ok(Get { id, request })
    }

    /// A get goes on as another request, and is answered in its form.
    pub(crate) fn exchange(&mut self, id: GetId, request: Request) {
        self.open.insert(id, request);
    }

    /// The request of a get that waits; it does not wait any more.
    pub(crate) fn close(&mut self, id: GetId) -> Option<Request> {
        self.open.remove(&id)
    }

    /// State is being written from now on.
    pub(crate) fn store_started(&mut self) {
        self.pending_stores = self.pending_stores.saturating_add(1);
    }

    /// How many states are being written.
    pub(crate) fn pending_stores(&self) -> u32 {
        self.pending_stores
    }

    /// An answer goes out, once all that is being written is on disk. What is returned goes out now.
    pub(crate) fn pass(&mut self, reply: Reply, confirms_store: bool) -> Option<Reply> {
        if self.pending_stores == 0 {
            return Some(reply);
        }
        let stores_before = self.pending_stores;
        self.held.push_back(HeldReply { reply, stores_before, confirms_store });
        None
    }

    /// State was written, or could not be. The answers that waited for it go out.
    pub(crate) fn stored(&mut self, error: Option<&str>) -> Vec<Reply> {
        self.pending_stores = self.pending_stores.saturating_sub(1);
        for held in &mut self.held {
            held.stores_before = held.stores_before.saturating_sub(1);
            if let Some(error) = error.filter(|_| held.confirms_store && held.stores_before == 0) {
                let problem = format!("hold now, but will not survive a restart: {error}");
                held.reply.answer = Err(Problem::unstored("(settings)", &problem).to_json());
                held.reply.messages.clear();
            }
        }
        let ready = self.held.iter().take_while(|held| held.stores_before == 0).count();
        self.held.drain(..ready).map(|held| held.reply).collect()
    }
}

/// An answer as packets in the form that the get asks for.
pub(crate) fn encode_answer(
    space: &KeySpace,
    request: &Request,
    messages: &[Message],
    now: muster_model::time::Tick,
) -> Result<Vec<muster_wire::Packet>, String> {
    let mut packets = Vec::new();
    for message in messages {
        let outbound = message
            .answer(space, request, now)
            .map_err(|error| problem_json("(answer)", &error.to_string()))?;
        packets.extend(outbound.into_iter().map(|outbound| outbound.into_packet(space)));
    }
    Ok(packets)
}

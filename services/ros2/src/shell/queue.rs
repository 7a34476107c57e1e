//! What waits to be put into ROS: the newest message of each topic.

use std::collections::{BTreeMap, VecDeque};

use muster_runtime::bus::send_queue::Waiting;
use muster_wire::Packet;

/// The send queue into ROS. It holds one message per topic at most.
pub(super) type SendQueue = muster_runtime::bus::send_queue::SendQueue<NewestOfEachKey>;

/// The newest message of each key, in the order of the first of each.
#[derive(Debug, Default)]
pub(super) struct NewestOfEachKey {
    order: VecDeque<String>,
    waiting: BTreeMap<String, Packet>,
}

impl Waiting for NewestOfEachKey {
    type Message = Packet;

    fn push(&mut self, packet: Packet) -> u64 {
        let key = packet.key.clone();
        let is_superseding = self.waiting.insert(key.clone(), packet).is_some();
        if !is_superseding {
            self.order.push_back(key);
        }
        u64::from(is_superseding)
    }

    fn pop(&mut self) -> Option<Packet> {
        self.waiting.remove(&self.order.pop_front()?)
    }

    fn is_empty(&self) -> bool {
        self.order.is_empty()
    }
}

//! What waits to be sent by a client: the newest message of each key.

use std::collections::{HashMap, VecDeque};

use muster_bus::send_queue::Waiting;
use muster_wire::{Key, Outbound};

/// The send queue of a client. It holds one message per robot and stream at most.
pub(crate) type SendQueue = muster_bus::send_queue::SendQueue<NewestOfEachKey>;

/// The newest message of each key, in the order of the first of each.
#[derive(Debug, Default)]
pub(crate) struct NewestOfEachKey {
    order: VecDeque<Key>,
    waiting: HashMap<Key, Outbound>,
}

impl Waiting for NewestOfEachKey {
    type Message = Outbound;

    fn push(&mut self, message: Outbound) -> u64 {
        let key = message.key.clone();
        let is_superseding = self.waiting.insert(key.clone(), message).is_some();
        if !is_superseding {
            self.order.push_back(key);
        }
        u64::from(is_superseding)
    }

    fn pop(&mut self) -> Option<Outbound> {
        self.waiting.remove(&self.order.pop_front()?)
    }

    fn is_empty(&self) -> bool {
        self.order.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use std::borrow::Cow;
    use std::sync::mpsc;
    use std::time::Duration;

    use muster_model::id::RobotId;
    use muster_model::observation::Stream;

    use super::*;

    fn pose(robot: usize, byte: u8) -> Outbound {
        let robot = RobotId::new(format!("r{robot}")).unwrap();
        Outbound {
            key: Key::Stream(robot, Stream::Pose),
            encoding: Cow::Borrowed(""),
            payload: vec![byte],
            attachment: None,
        }
    }

    #[test]
    fn the_newest_of_each_key_leaves_in_the_order_of_the_first() {
        let queue = SendQueue::default();
        for (robot, byte) in [(1, 1), (2, 2), (1, 3)] {
            queue.push(pose(robot, byte)).unwrap();
        }
        let (sender, receiver) = mpsc::channel();
        queue.start("test", move |message| sender.send(message.payload[0]).unwrap()).unwrap();
        queue.flush(Duration::from_secs(10));
        assert_eq!(receiver.try_iter().collect::<Vec<_>>(), [3, 2]);
        assert_eq!(queue.counts().dropped, 1);
        queue.abandon();
        assert!(queue.push(pose(1, 4)).is_err());
        assert_eq!(receiver.recv(), Err(mpsc::RecvError), "the thread has ended");
    }

    #[test]
    fn a_bus_that_hangs_costs_no_caller_its_time_and_no_memory() {
        let queue = SendQueue::default();
        let (release, held) = mpsc::channel::<()>();
        let send = move |_| {
            let _ = held.recv();
        };
        queue.start("test", send).unwrap();
        for number in 0..100_000 {
            queue.push(pose(number % 4, 0)).unwrap();
        }
        assert!(queue.inspect(|newest| newest.waiting.len() <= 4 && newest.order.len() <= 4));
        drop(release);
        queue.abandon();
    }
}

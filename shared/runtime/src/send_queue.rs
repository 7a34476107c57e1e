//! What waits to be sent by a service: threads of their own send it, so that no loop waits for the bus.
//!
//! Lease renewals have a queue of their own with one place. The bus may take longer for a large message
//! than a leader may be silent, and a renewal that waits behind it would cost a living leader its lease.

use std::collections::VecDeque;
use std::thread::JoinHandle;
use std::time::Duration;

use muster_service::Publication;
use muster_wire::Packet;

use crate::bus::Urgency;
use crate::bus::send_queue::{self, SendCounts, Waiting};
use crate::pool::Pool;

/// Most messages that wait to be sent: the per-robot messages of a division of 10,000 robots.
const MAX_WAITING: usize = 16_384;

/// Most bytes that wait to be sent: a few of the largest messages.
const MAX_WAITING_BYTES: usize = 256 * 1024 * 1024;

/// How long a closing queue goes on sending what waits.
const FLUSH_TIMEOUT: Duration = Duration::from_millis(500);

/// The send queue of a service.
#[derive(Debug, Clone, Default)]
pub struct SendQueue {
    packets: send_queue::SendQueue<Packets>,
    renewal: send_queue::SendQueue<Option<Packet>>,
}

/// How much waits.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Backlog {
    /// Messages.
    pub messages: usize,
    /// Their bytes.
    pub bytes: usize,
}

/// Packets in order. When there are too many, the oldest is dropped: newer ones matter more.
#[derive(Debug, Default)]
struct Packets {
    waiting: VecDeque<Packet>,
    bytes: usize,
}

impl Waiting for Packets {
    type Message = Packet;

    fn push(&mut self, packet: Packet) -> u64 {
        self.bytes += packet.size();
        self.waiting.push_back(packet);
        let mut dropped = 0;
        while self.waiting.len() > MAX_WAITING
            || (self.bytes > MAX_WAITING_BYTES && self.waiting.len() > 1)
        {
            self.pop();
            dropped += 1;
        }
        dropped
    }

    fn pop(&mut self) -> Option<Packet> {
        let packet = self.waiting.pop_front()?;
        self.bytes -= packet.size();
        Some(packet)
    }

    fn is_empty(&self) -> bool {
        self.waiting.is_empty()
    }
}

impl SendQueue {
    /// Queues the packets of a publication; a closed queue drops them. Never waits.
    pub fn push(&self, publication: Publication) {
        for packet in publication.packets {
            let _ = if publication.is_lease_renewal {
                self.renewal.push(packet)
            } else {
                self.packets.push(packet)
            };
        }
    }

    /// How many messages were sent, and how many were dropped.
    #[must_use]
    pub fn counts(&self) -> SendCounts {
        let (packets, renewals) = (self.packets.counts(), self.renewal.counts());
        SendCounts {
            sent: packets.sent + renewals.sent,
            dropped: packets.dropped + renewals.dropped,
        }
    }

    /// How much waits to be sent.
    #[must_use]
    pub fn backlog(&self) -> Backlog {
        self.packets
            .inspect(|packets| Backlog { messages: packets.waiting.len(), bytes: packets.bytes })
    }

    /// Starts the threads that send; they end when the queue is closed. The returned one sends everything
    /// but lease renewals.
    ///
    /// # Errors
    /// If no thread can be started.
    pub fn start(
        &self,
        mut send: impl FnMut(Packet, Urgency) + Clone + Send + 'static,
    ) -> std::io::Result<JoinHandle<()>> {
        let mut renew = send.clone();
        self.renewal
            .start("muster-renewals", move |packet| renew(packet, Urgency::LeaseRenewal))?;
        self.packets.start("muster-sender", move |packet| send(packet, Urgency::Normal))
    }

    /// Has threads send that other queues share, lease renewals by one of their own.
    pub fn share(
        &self,
        pool: &Pool,
        mut send: impl FnMut(Packet, Urgency) + Clone + Send + 'static,
    ) {
        let mut renew = send.clone();
        self.renewal.share(&pool.renewals, move |packet| renew(packet, Urgency::LeaseRenewal));
        self.packets.share(&pool.packets, move |packet| send(packet, Urgency::Normal));
    }

    /// Accepts nothing more, and waits a moment until what waits is sent. Blocks.
    pub fn close(&self) {
        self.renewal.close();
        self.packets.close();
        self.packets.flush(FLUSH_TIMEOUT);
        self.packets.abandon();
    }
}

#[cfg(test)]
mod tests {
    use std::sync::{Arc, Mutex, mpsc};

    use super::*;

    fn message(bytes: Vec<u8>, is_lease_renewal: bool) -> Publication {
        let packets = vec![Packet::put(String::new(), String::new(), bytes)];
        Publication { packets, is_lease_renewal, message: None }
    }

    fn first_byte(packet: &Packet) -> u8 {
        packet.payload.as_ref().unwrap()[0]
    }

    #[test]
    fn messages_leave_in_order_and_closing_flushes() {
        let queue = SendQueue::default();
        let (sender, receiver) = mpsc::channel();
        let thread =
            queue.start(move |packet, _| sender.send(first_byte(&packet)).unwrap()).unwrap();
        for byte in 0..100 {
            queue.push(message(vec![byte], false));
        }
        queue.close();
        thread.join().unwrap();
        assert!(receiver.iter().eq(0..100));
        assert_eq!(queue.counts(), SendCounts { sent: 100, dropped: 0 });
    }

    #[test]
    fn a_sender_that_hangs_costs_the_oldest_messages_and_never_blocks() {
        let queue = SendQueue::default();
        for _ in 0..MAX_WAITING + 7 {
            queue.push(message(vec![0], false));
        }
        assert_eq!(queue.counts(), SendCounts { sent: 0, dropped: 7 });
    }

    #[test]
    fn a_renewal_passes_a_message_that_takes_long_and_only_the_newest_waits() {
        let queue = SendQueue::default();
        let renewal = |byte| message(vec![byte], true);
        queue.push(renewal(1));
        queue.push(renewal(2));
        queue.push(message(vec![9], false));
        let (sender, receiver) = mpsc::channel();
        let (release, held) = mpsc::channel::<()>();
        let held = Arc::new(Mutex::new(held));
        let send = move |packet: Packet, _| {
            let byte = first_byte(&packet);
            if byte == 9 {
                let _ = held.lock().unwrap().recv();
            }
            sender.send(byte).unwrap();
        };
        let thread = queue.start(send).unwrap();
        let within = Duration::from_secs(10);
        assert_eq!(receiver.recv_timeout(within), Ok(2));
        queue.push(renewal(3));
        assert_eq!(receiver.recv_timeout(within), Ok(3), "the large one is not through yet");
        drop(release);
        assert_eq!(receiver.recv_timeout(within), Ok(9));
        queue.close();
        thread.join().unwrap();
        assert_eq!(queue.counts().dropped, 1);
    }

    #[test]
    fn large_messages_are_bounded_by_their_bytes() {
        let queue = SendQueue::default();
        for _ in 0..40 {
            queue.push(message(vec![0; 8 << 20], false));
        }
        assert_eq!(queue.counts(), SendCounts { sent: 0, dropped: 8 });
        assert!(queue.backlog().bytes <= MAX_WAITING_BYTES);
    }
}

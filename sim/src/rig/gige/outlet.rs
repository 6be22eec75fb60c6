//! Packets on their way out: paced, spoiled as the faults have it, and sent again on request.
//!
//! Knows blocks and where they go, but neither cameras nor registers. Sends are plain: what the system does not take
//! is counted and not tried again.

use super::fault::{Faults, PacketFate, PacketKey};
use super::gvcp::ResendRange;
use super::gvsp::{Block, IdMode, unavailable};
use super::stats::{GigeStats, Shared};
use std::collections::VecDeque;
use std::net::{SocketAddr, SocketAddrV4};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::net::UdpSocket;
use tokio::sync::Semaphore;
use tokio::time::{Instant, sleep, sleep_until};

/// Payload bytes kept for resend requests: 25 frames of 640 × 512 pixels of two bytes. Beyond, the oldest frame goes,
/// and requests for it are answered with PACKET_UNAVAILABLE.
pub const RESEND_BYTES_MAX: usize = 16 << 20;

/// Datagrams on their way late at the same time; beyond, they are lost.
const LATE_MAX: usize = 4096;

/// Packets that one resend request can ask for; the rest of it is ignored.
const RESEND_PACKETS_MAX: u32 = 8192;

/// Grain of the clock: shorter pauses between packets are made up for by sending several at once.
const PAUSE_GRAIN: Duration = Duration::from_millis(1);

/// Sends packets, whole or as the faults have it.
#[derive(Clone)]
pub(super) struct Outlet {
    pub(super) socket: Arc<UdpSocket>,
    pub(super) faults: Arc<Faults>,
    pub(super) stats: Shared,
    pub(super) late: Late,
}

/// Datagrams on their way late.
#[derive(Clone)]
pub(super) struct Late(Arc<Semaphore>);

impl Late {
    pub(super) fn new() -> Self {
        Self(Arc::new(Semaphore::new(LATE_MAX)))
    }

    /// Sends a datagram after `delay`; false when too many wait already, and it is lost.
    pub(super) fn send(
        &self,
        socket: &Arc<UdpSocket>,
        bytes: Vec<u8>,
        to: SocketAddr,
        delay: Duration,
    ) -> bool {
        let Ok(permit) = Arc::clone(&self.0).try_acquire_owned() else { return false };
        let socket = Arc::clone(socket);
        tokio::spawn(async move {
            sleep(delay).await;
            // A client that has gone does not matter any more.
            let _ = socket.send_to(&bytes, to).await;
            drop(permit);
        });
        true
    }
}

impl Outlet {
    async fn send(&self, bytes: &[u8], to: SocketAddrV4, tally: &mut GigeStats) {
        match self.socket.send_to(bytes, to).await {
            Ok(_) => tally.packets_sent += 1,
            Err(_) => tally.packets_failed += 1,
        }
    }

    /// Sends one packet that lies in `bytes`; false when it is to come behind the next one.
    async fn send_packet(
        &self,
        fate: PacketFate,
        bytes: &mut Vec<u8>,
        to: SocketAddrV4,
        tally: &mut GigeStats,
    ) -> bool {
        if fate.lost {
            tally.packets_dropped += 1;
            return true;
        }
        if fate.cut {
            tally.packets_cut += 1;
            bytes.truncate(bytes.len() / 2);
        }
        if let Some(delay) = fate.late {
            if self.late.send(&self.socket, bytes.clone(), to.into(), delay) {
                tally.packets_late += 1;
            } else {
                tally.packets_failed += 1;
            }
            return true;
        }
        if fate.swapped {
            tally.packets_swapped += 1;
            return false;
        }
        self.send(bytes, to, tally).await;
        if fate.doubled {
            tally.packets_doubled += 1;
            self.send(bytes, to, tally).await;
        }
        true
    }

    /// Sends a block, at least `delay_ns` from packet to packet on average.
    pub(super) async fn send_block(&self, block: &Block, frame: u64, to: SocketAddrV4, delay_ns: u64) {
        let mut tally = GigeStats::default();
        let packets = block.packets();
        let mut bytes = Vec::with_capacity(block.packet_bytes);
        let mut held: Option<Vec<u8>> = None;
        let start = Instant::now();
        for packet in 0..packets {
            if delay_ns > 0 {
                let due = start + Duration::from_nanos(delay_ns.saturating_mul(u64::from(packet)));
                if due.duration_since(Instant::now()) > PAUSE_GRAIN {
                    sleep_until(due).await;
                }
            }
            if !block.write_packet(packet, &mut bytes) {
                continue;
            }
            let mut fate = self.faults.packet(PacketKey { frame, packet, packets, attempt: 0 });
            // It takes two to change places: the one behind goes ahead.
            fate.swapped &= held.is_none() && packet + 1 < packets;
            if !self.send_packet(fate, &mut bytes, to, &mut tally).await {
                held = Some(bytes.clone());
            } else if let Some(earlier) = held.take() {
                self.send(&earlier, to, &mut tally).await;
            }
        }
        if let Some(last) = held {
            self.send(&last, to, &mut tally).await;
        }
        self.stats.note(|stats| {
            stats.frames_sent += 1;
            stats.add_packets(&tally);
        });
    }

    /// Answers a resend request.
    pub(super) async fn resend(&self, ring: &Ring, range: ResendRange, ids: IdMode, to: SocketAddrV4) {
        let mut tally = GigeStats::default();
        let found = ring.find(range.block);
        let packets = found.as_ref().map_or(0, |(block, ..)| block.packets());
        // The standard lets the last packet be all ones: to the end of the block. Of a block that is not there any more
        // every packet is refused; of one that is, at least the first that was asked for.
        let end = if found.is_some() { packets.saturating_sub(1).max(range.first) } else { u32::MAX };
        let last = range.last.min(end).min(range.first.saturating_add(RESEND_PACKETS_MAX - 1));
        let mut bytes = Vec::new();
        for packet in range.first..=last {
            let written = match &found {
                Some((block, ..)) => block.write_packet(packet, &mut bytes),
                None => false,
            };
            if let (true, Some((_, frame, attempt))) = (written, &found) {
                let key = PacketKey { frame: *frame, packet, packets, attempt: *attempt };
                let fate = PacketFate { swapped: false, ..self.faults.packet(key) };
                self.send_packet(fate, &mut bytes, to, &mut tally).await;
                tally.packets_resent += 1;
            } else {
                self.refuse(range.block, packet, ids, to, &mut tally).await;
            }
        }
        self.stats.note(|stats| stats.add_packets(&tally));
    }

    /// Answers a resend request with a refusal of every packet.
    pub(super) async fn refuse_resend(&self, range: ResendRange, ids: IdMode, to: SocketAddrV4) {
        let mut tally = GigeStats::default();
        let last = range.last.min(range.first.saturating_add(RESEND_PACKETS_MAX - 1));
        for packet in range.first..=last {
            self.refuse(range.block, packet, ids, to, &mut tally).await;
        }
        self.stats.note(|stats| stats.add_packets(&tally));
    }

    async fn refuse(&self, block: u64, packet: u32, ids: IdMode, to: SocketAddrV4, tally: &mut GigeStats) {
        tally.packets_refused += 1;
        self.send(&unavailable(ids, block, packet), to, tally).await;
    }
}

/// The last frames, for resend requests.
#[derive(Debug, Clone, Default)]
pub(super) struct Ring(Arc<Mutex<VecDeque<Kept>>>);

#[derive(Debug)]
struct Kept {
    block: Arc<Block>,
    frame: u64,
    attempts: u32,
}

impl Ring {
    pub(super) fn keep(&self, block: Arc<Block>, frame: u64) {
        let mut ring = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        ring.push_back(Kept { block, frame, attempts: 0 });
        let mut bytes: usize = ring.iter().map(|kept| kept.block.payload.len()).sum();
        while bytes > RESEND_BYTES_MAX && ring.len() > 1 {
            bytes -= ring.pop_front().map_or(0, |kept| kept.block.payload.len());
        }
    }

    /// The youngest block with this id, the ordinal of its frame, and how often it was asked for, this time included.
    fn find(&self, id: u64) -> Option<(Arc<Block>, u64, u32)> {
        let mut ring = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let kept = ring.iter_mut().rev().find(|kept| kept.block.id == id)?;
        kept.attempts = kept.attempts.saturating_add(1);
        Some((Arc::clone(&kept.block), kept.frame, kept.attempts))
    }

    pub(super) fn clear(&self) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clear();
    }
}

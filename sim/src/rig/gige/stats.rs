//! What the camera on the network has done, in numbers that its owner can read at any time.

use serde::{Deserialize, Serialize};
use std::sync::{Arc, Mutex, PoisonError};

/// Counts since switching on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct GigeStats {
    /// Commands heard.
    pub commands: u64,
    /// Acknowledges sent, repeated ones included.
    pub answers: u64,
    /// Acknowledges lost by a fault.
    pub answers_lost: u64,
    /// Acknowledges sent late by a fault.
    pub answers_late: u64,
    /// Commands heard again with the same id: answered as before, not carried out again.
    pub repeated: u64,
    /// Commands refused with any status but success.
    pub refused: u64,
    /// PENDING_ACK sent.
    pub pending: u64,
    /// Streams started.
    pub streams: u64,
    /// Frames that came from the camera behind.
    pub frames: u64,
    /// Frames put on the wire, whole or with packets lost.
    pub frames_sent: u64,
    /// Frames lost whole by a fault.
    pub frames_lost: u64,
    /// Frames that the camera behind itself lost: gaps of its ids.
    pub frames_missing: u64,
    /// Stream packets sent, resent and doubled ones included.
    pub packets_sent: u64,
    /// Packets lost by a fault.
    pub packets_dropped: u64,
    /// Packets sent behind their successor.
    pub packets_swapped: u64,
    /// Packets sent twice.
    pub packets_doubled: u64,
    /// Packets cut short.
    pub packets_cut: u64,
    /// Packets sent late.
    pub packets_late: u64,
    /// Packets that the system did not take.
    pub packets_failed: u64,
    /// Resend requests heard.
    pub resend_requests: u64,
    /// Packets sent again on request.
    pub packets_resent: u64,
    /// Packets asked for again that could not or must not be sent.
    pub packets_refused: u64,
    /// Test packets sent.
    pub test_packets: u64,
    /// Triggers made: by the camera's own clock and by command.
    pub triggers: u64,
    /// Triggers that came while the camera could not take one.
    pub triggers_missed: u64,
    /// Times that control was lost by silence.
    pub control_lost: u64,
    /// Restarts.
    pub restarts: u64,
    /// Non-uniformity corrections.
    pub corrections: u64,
    /// Times that a client has overwritten the factory gain. Must stay 0.
    pub spoilings: u64,
}

impl GigeStats {
    /// Adds what was counted while packets were sent.
    pub(super) fn add_packets(&mut self, tally: &Self) {
        self.packets_sent += tally.packets_sent;
        self.packets_failed += tally.packets_failed;
        self.packets_dropped += tally.packets_dropped;
        self.packets_swapped += tally.packets_swapped;
        self.packets_doubled += tally.packets_doubled;
        self.packets_cut += tally.packets_cut;
        self.packets_late += tally.packets_late;
        self.packets_resent += tally.packets_resent;
        self.packets_refused += tally.packets_refused;
    }
}

/// Stats that several tasks write.
#[derive(Debug, Clone, Default)]
pub(super) struct Shared(Arc<Mutex<GigeStats>>);

impl Shared {
    /// A copy of the present counts.
    pub(super) fn read(&self) -> GigeStats {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Changes the counts.
    pub(super) fn note(&self, change: impl FnOnce(&mut GigeStats)) {
        change(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner));
    }
}

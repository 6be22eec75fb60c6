//! The stream of a GigE camera: begun, ended, and its frames one by one.

use super::device::{Device, reading_alone, refused};
use super::frames::frame_of;
use super::names::Purpose;
use super::orders::Prepared;
use crate::error::DriverError;
use crate::instrument::Frame;
use aravis::glib::object::Cast;
use aravis::prelude::*;
use aravis::{Buffer, ChunkParser, GvStream, GvStreamPacketResend, GvStreamSocketBuffer, Stream};
use std::time::Duration;

/// How long a frame may lack packets before it is given up, in milliseconds. Three times the library's time for asking
/// again; beyond it the next frames wait.
const FRAME_RETENTION_MS: u32 = 200;

/// The stream's counters that say something about losses.
const COUNTERS: [&str; 12] = [
    "n_completed_buffers",
    "n_failures",
    "n_underruns",
    "n_timeouts",
    "n_missing_frames",
    "n_size_mismatch_errors",
    "n_received_packets",
    "n_ignored_packets",
    "n_missing_packets",
    "n_resend_requests",
    "n_resent_packets",
    "n_duplicated_packets",
];

/// A stream that has begun.
pub(super) struct Running {
    stream: Stream,
    pub(super) parser: Option<ChunkParser>,
    pub(super) prepared: Prepared,
    dropped: u64,
}

/// What became of a wait for a frame.
pub(super) enum Got {
    /// A frame.
    Frame(Frame),
    /// None yet.
    Nothing,
    /// The camera is no longer ours.
    Lost(DriverError),
    /// A frame that shows that the camera does not do what it was told.
    Wrong(DriverError),
}

impl Device {
    /// Begins to wait for triggers.
    pub(super) fn start(&mut self) -> Result<(), DriverError> {
        const DOING: &str = "starting the stream";
        self.stop();
        let Some(prepared) = self.prepared else {
            return Err(refused(&self.who, DOING, "no region was set", "Prepare the camera first."));
        };
        if self.is_lost() {
            return Err(self.lost(DOING, "it no longer obeys this program".to_owned()));
        }
        let stream = self.camera.create_stream().map_err(|error| self.trouble(DOING, &error))?;
        let bytes = self.settings.socket_buffer_bytes;
        if let Some(gv) = stream.downcast_ref::<GvStream>() {
            gv.set_socket_buffer(GvStreamSocketBuffer::Fixed);
            gv.set_socket_buffer_size(i32::try_from(bytes).unwrap_or(i32::MAX));
            gv.set_frame_retention(FRAME_RETENTION_MS * 1000);
            let resend =
                if self.settings.resend { GvStreamPacketResend::Always } else { GvStreamPacketResend::Never };
            gv.set_packet_resend(resend);
            // On a line that loses one packet in a hundred a quarter of a frame's packets is not enough.
            gv.set_packet_request_ratio(1.0);
        }
        let payload = self.camera.payload().map_err(|error| self.trouble(DOING, &error))?;
        for _ in 0..self.settings.buffers {
            stream.push_buffer(Buffer::new_allocate(payload as usize));
        }
        if let Some(arm) = self.names.of(Purpose::Arm) {
            self.camera.execute_command(arm).map_err(|error| self.trouble(DOING, &error))?;
        }
        self.camera.start_acquisition().map_err(|error| self.trouble(DOING, &error))?;
        let parser = prepared.chunks.then(|| {
            let _reading = reading_alone();
            self.camera.create_chunk_parser()
        });
        let parser = parser.flatten();
        self.numbers.restart();
        self.running = Some(Running { stream, parser, prepared, dropped: 0 });
        Ok(())
    }

    /// Ends the stream, whatever state it is in. A camera that is gone stops by itself when its heartbeat fails.
    pub(super) fn stop(&mut self) {
        let Some(running) = self.running.take() else { return };
        if !self.is_lost() {
            let _ = self.camera.stop_acquisition();
        }
        self.counters =
            COUNTERS.iter().map(|name| (*name, running.stream.info_uint64_by_name(name))).collect();
        self.counters.push(("n_dropped_frames", running.dropped));
    }

    /// What the last stream counted.
    pub(super) fn counters(&self) -> Vec<(&'static str, u64)> {
        self.counters.clone()
    }

    /// A frame was not wanted by anybody in time.
    pub(super) fn note_dropped(&mut self) {
        if let Some(running) = &mut self.running {
            running.dropped += 1;
        }
    }

    /// The next frame within `wait`.
    pub(super) fn next(&mut self, wait: Duration) -> Got {
        const DOING: &str = "waiting for a frame";
        let Some(running) = &self.running else { return Got::Nothing };
        let micros = u64::try_from(wait.as_micros()).unwrap_or(u64::MAX);
        let Some(buffer) = running.stream.timeout_pop_buffer(micros) else {
            if self.is_lost() {
                return Got::Lost(self.lost(DOING, "it no longer obeys this program".to_owned()));
            }
            return Got::Nothing;
        };
        let got = frame_of(&buffer, running, &mut self.numbers);
        running.stream.push_buffer(buffer);
        match got {
            Ok(Some(frame)) => Got::Frame(frame),
            Ok(None) => Got::Nothing,
            Err((why, hint)) => Got::Wrong(refused(&self.who, DOING, &why, hint)),
        }
    }
}

//! A simulated camera on the network: any camera behind a GigE Vision front.
//!
//! [`GigeCamera`] takes a [`Camera`](ditd_drivers::instrument::Camera), puts it on an address, and answers what
//! unmodified clients (Aravis and others) ask. On `AcquisitionStart` it prepares the camera behind with the present
//! registers, starts it and forwards every frame. What triggers frames: `TriggerMode` off: the server makes pulses at
//! `AcquisitionFrameRate`; software: one pulse per command; external: nothing, the camera behind has the rig's trigger
//! unit on its input.
//!
//! **Served** (GigE Vision 2.0, as Aravis 0.8.26's public headers and Wireshark's dissector describe it): DISCOVERY to
//! its address, READREG, WRITEREG (several per command), READMEM, WRITEMEM, PACKETRESEND, PENDING_ACK; repeated
//! request ids; control and exclusive control, heartbeat; one stream channel with leader, payload and trailer, standard
//! and 64-bit ids, packet size, packet delay, test packet, resend; images and images with chunks; timestamp latch and
//! reset; a GenICam description. **Not served**: FORCEIP, ACTION, message channel and events, switch-over, multicast,
//! several interfaces or channels, IEEE 1588, manifest, zipped description, all-in and multi-part payloads, sequencer,
//! `TriggerDelay` (stored, not obeyed: delays are the trigger unit's).
//!
//! Numbers: the clock ticks once a nanosecond (10⁹ ticks a second); block ids begin with 1 at every start and
//! rise by one per frame, by more when the camera behind lost one; [`RESEND_BYTES_MAX`] bytes of frames are kept
//! for resend requests.
//!
//! ```no_run
//! use ditd_sim::rig::gige::pattern::PatternCamera;
//! use ditd_sim::rig::gige::{GigeCamera, GigeFault, Preset, Sensor};
//!
//! # async fn example() -> Result<(), Box<dyn std::error::Error>> {
//! let (pulses, taken) = tokio::sync::mpsc::channel(8);
//! let camera = PatternCamera::new(512, 640, 14, taken);
//! let sensor = Sensor { rows: 512, columns: 640, bits: 14, shutter: true };
//! let server = GigeCamera::new(Box::new(camera), sensor)
//!     .preset(Preset::Flir)
//!     .pulses(pulses)
//!     .faults(vec![GigeFault::PacketLoss { probability: 0.01 }], 1)
//!     .serve("127.0.0.7".parse()?)
//!     .await?;
//! // … a client streams …
//! assert_eq!(server.stats().spoilings, 0);
//! # Ok(())
//! # }
//! ```

mod bootstrap;
mod control;
mod device;
pub mod fault;
mod feature;
mod gvcp;
mod gvsp;
mod image;
mod outlet;
pub mod pattern;
mod plan;
pub mod presets;
mod profile;
mod server;
mod stats;
mod stream;
#[cfg(test)]
mod tests;
mod xml;

pub use fault::GigeFault;
pub use outlet::RESEND_BYTES_MAX;
pub use presets::{Preset, Sensor};
pub use server::{GigeCamera, GigeServer};
pub use stats::GigeStats;

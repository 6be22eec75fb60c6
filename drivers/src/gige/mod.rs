//! GenICam cameras on GigE Vision, through the Aravis library.
//!
//! A GigE camera has one thread of its own ([`GigeCamera`], cargo feature `aravis`): calls into the library block up to five
//! seconds when a camera is gone, so none runs on the daemon's runtime. Frames leave the thread through a bounded queue;
//! a frame that finds it full is dropped and counted, and its missing number makes the campaign take its cycle again.
//!
//! Sources: EMVA Standard Features Naming Convention; Aravis 0.8 (`ArvCamera`, `ArvGvStream`); GigE Vision: a device stops its
//! stream when its controller has been silent for the heartbeat timeout. Makers' own names in [`names`].

pub mod discovery;
pub mod names;
pub mod pixels;
pub mod sequence;

#[cfg(feature = "aravis")]
mod camera;
#[cfg(feature = "aravis")]
mod device;
#[cfg(feature = "aravis")]
mod features;
#[cfg(feature = "aravis")]
mod frames;
#[cfg(feature = "aravis")]
mod orders;
#[cfg(feature = "aravis")]
pub mod probe;
#[cfg(feature = "aravis")]
mod stream;
#[cfg(feature = "aravis")]
mod worker;

#[cfg(feature = "aravis")]
pub use camera::GigeCamera;

use names::{Preset, Purpose};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Pictures that the library may fill while others are read out: with two of them and 200 frames a second 2 of 1000 were
/// lost, with eight none (measured); twice that for a machine under load. 10.5 MB at 640 × 512 pixels of two bytes.
const BUFFERS: u32 = 16;

/// Bytes that the system holds of a stream that is not read: six frames of 640 × 512. With the usual 213 kB eleven of 300
/// frames survived at 100 frames a second, with 4 MiB all (measured).
const SOCKET_BUFFER_BYTES: u32 = 4 << 20;

/// What is told to a GigE camera besides size, depth and integration time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GigeSettings {
    /// Whose names and habits.
    pub preset: Preset,
    /// Names of the camera's own for what the preset calls otherwise.
    pub features: BTreeMap<Purpose, String>,
    /// Further features, written as given and in this order of names, before everything else.
    pub set: BTreeMap<String, FeatureValue>,
    /// Input of the trigger; absent: the preset's.
    pub trigger_source: Option<String>,
    /// `Mono14` or `Mono16`; absent: what suits the bits of the sensor.
    pub pixel_format: Option<String>,
    /// First column of the region.
    pub first_column: u32,
    /// First row of the region.
    pub first_row: u32,
    /// What is written to the shutter's feature to open and to close it; absent: the preset's words.
    pub shutter_words: Option<[String; 2]>,
    /// Whether the camera takes a new offset at its shutter before every level, never inside one. Off: the offset cancels
    /// between a spray frame and its blanks, and a new one at every level is one more thing that changes.
    pub offset_correction: bool,
    /// Bytes of a packet with its headers; absent: as large as the network lets through.
    pub packet_size: Option<u32>,
    /// Pause between two packets, in nanoseconds; absent: the camera's own.
    pub packet_delay_ns: Option<u32>,
    /// Buffers, at least 8.
    pub buffers: u32,
    /// Bytes that the system may hold of the stream.
    pub socket_buffer_bytes: u32,
    /// Whether a packet socket may be used (needs the right `CAP_NET_RAW`); `false` forces an ordinary UDP socket.
    pub packet_socket: bool,
    /// Whether lost packets are asked for again.
    pub resend: bool,
    /// How long a camera that is gone is looked for, in seconds; 0: it is not.
    pub reconnect_s: f64,
}

impl Default for GigeSettings {
    fn default() -> Self {
        Self {
            preset: Preset::Generic,
            features: BTreeMap::new(),
            set: BTreeMap::new(),
            trigger_source: None,
            pixel_format: None,
            first_column: 0,
            first_row: 0,
            shutter_words: None,
            offset_correction: false,
            packet_size: None,
            packet_delay_ns: None,
            buffers: BUFFERS,
            socket_buffer_bytes: SOCKET_BUFFER_BYTES,
            packet_socket: true,
            resend: true,
            reconnect_s: 30.0,
        }
    }
}

/// The value of a feature.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum FeatureValue {
    /// Yes or no.
    Flag(bool),
    /// A whole number.
    Integer(i64),
    /// A number.
    Float(f64),
    /// A word of an enumeration, or a text.
    Text(String),
}

impl FeatureValue {
    /// As the library's parser wants it.
    pub fn as_text(&self) -> String {
        match self {
            Self::Flag(on) => on.to_string(),
            Self::Integer(value) => value.to_string(),
            Self::Float(value) => value.to_string(),
            Self::Text(text) => text.clone(),
        }
    }
}

impl GigeSettings {
    /// Whether the settings can be used.
    ///
    /// # Errors
    /// Names the key and what would be right.
    pub fn check(&self) -> Result<(), (&'static str, String)> {
        names::Names::new(self.preset, &self.features).map_err(|why| ("features", why))?;
        for name in self.set.keys() {
            names::refuse_forbidden(name).map_err(|why| ("set", why))?;
        }
        if let Some(format) = &self.pixel_format
            && !["Mono14", "Mono16"].contains(&format.as_str())
        {
            return Err(("pixel_format", format!("{format:?} carries no raw counts: Mono14 or Mono16")));
        }
        // 576: what every network lets through; 9000 and some: jumbo frames.
        if let Some(bytes) = self.packet_size
            && !(576..=16_000).contains(&bytes)
        {
            return Err(("packet_size", format!("{bytes} bytes: 576 to 16000")));
        }
        if !(8..=1024).contains(&self.buffers) {
            return Err(("buffers", format!("{}: 8 to 1024 (fewer lose frames)", self.buffers)));
        }
        if !(65_536..=1 << 30).contains(&self.socket_buffer_bytes) {
            return Err((
                "socket_buffer_bytes",
                format!("{}: 65536 to 1073741824", self.socket_buffer_bytes),
            ));
        }
        if !(0.0..=3600.0).contains(&self.reconnect_s) {
            return Err(("reconnect_s", format!("{} s: 0 to 3600", self.reconnect_s)));
        }
        Ok(())
    }
}

/// What to do when this program was built without the library.
pub const WITHOUT_ARAVIS: &str = "this ditd was built without GigE cameras. Install libaravis-dev and libusb-1.0-0-dev and build it \
with `cargo build --release --features aravis`";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_be_used_is_named() {
        let good = GigeSettings::default();
        assert_eq!(good.check(), Ok(()));
        let spoiling = BTreeMap::from([("CorrectionPerform".to_owned(), FeatureValue::Flag(true))]);
        for (wrong, key) in [
            (GigeSettings { pixel_format: Some("BayerRG8".to_owned()), ..good.clone() }, "pixel_format"),
            (GigeSettings { packet_size: Some(100), ..good.clone() }, "packet_size"),
            (GigeSettings { buffers: 2, ..good.clone() }, "buffers"),
            (GigeSettings { reconnect_s: f64::NAN, ..good.clone() }, "reconnect_s"),
            (GigeSettings { set: spoiling, ..good.clone() }, "set"),
        ] {
            assert_eq!(wrong.check().unwrap_err().0, key);
        }
    }
}

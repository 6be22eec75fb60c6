//! What a stream is made from: the registers read together, once, when it is started.

use super::bootstrap::*;
use super::device::Device;
use super::feature::word;
use super::gvsp::{IdMode, PayloadType};
use super::image::{Chunks, Layout, Writing};
use super::presets::{CHUNKS, MONO_14, Preset, SOURCE_SOFTWARE, SYNC_INTERNAL, SYNC_SOFTWARE};
use super::profile::Profile;
use ditd_drivers::instrument::CameraSettings;
use std::net::{Ipv4Addr, SocketAddrV4};

/// What makes frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Trigger {
    /// The camera's own clock.
    Free,
    /// A signal on its input.
    External,
    /// A command.
    Software,
}

/// What a stream is made from: the registers when it was started.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Plan {
    /// What the camera behind is told.
    pub(super) settings: CameraSettings,
    /// How an image is written.
    pub(super) layout: Layout,
    /// Who gets the stream; `None`: nobody.
    pub(super) destination: Option<SocketAddrV4>,
    /// Bytes of a packet.
    pub(super) packet_bytes: usize,
    /// Nanoseconds from packet to packet at least.
    pub(super) packet_delay_ns: u64,
    /// How blocks are numbered.
    pub(super) ids: IdMode,
    /// What makes frames.
    pub(super) trigger: Trigger,
    /// Frames per second when free.
    pub(super) rate_hz: f64,
    /// Frames after which the stream ends by itself.
    pub(super) frames_max: Option<u64>,
}

impl Device {
    /// Which chunks follow an image; `None` without chunk mode.
    pub(super) fn chunks(&self) -> Option<Chunks> {
        self.find("ChunkModeActive").filter(|&index| word(self.value(index)) == 1)?;
        let enable = self.index("ChunkEnable");
        let enabled = |number: u32| word(self.banked(enable, number)) == 1;
        let mut chunks = Chunks { enabled: [false; CHUNKS.len()] };
        for (number, on) in (0..).zip(&mut chunks.enabled) {
            *on = enabled(number);
        }
        Some(chunks)
    }

    /// What makes frames.
    pub(super) fn trigger(&self) -> Trigger {
        if self.profile().preset == Preset::Flir {
            return match self.integer("SyncSource") {
                SYNC_INTERNAL => Trigger::Free,
                SYNC_SOFTWARE => Trigger::Software,
                _ => Trigger::External,
            };
        }
        let selector = self.profile().preset.frame_selector();
        let of = |name: &str| word(self.banked(self.index(name), selector));
        match (of("TriggerMode"), of("TriggerSource")) {
            (0, _) => Trigger::Free,
            (_, SOURCE_SOFTWARE) => Trigger::Software,
            _ => Trigger::External,
        }
    }

    /// What a stream started now would be.
    pub(super) fn plan(&self) -> Plan {
        let Profile { preset, sensor, .. } = *self.profile();
        let header_rows = preset.header_rows();
        let (exposure, per_second) = preset.exposure();
        let integration_s = self.float(exposure) / per_second;
        let pixel_format = self.integer("PixelFormat");
        let writing = match (preset, self.find("IRFormat").map_or(0, |index| word(self.value(index)))) {
            (Preset::Flir, 1) => Writing::TemperatureLinear { per_kelvin: 10 },
            (Preset::Flir, 2) => Writing::TemperatureLinear { per_kelvin: 100 },
            (Preset::Flir, _) if pixel_format != MONO_14 => Writing::Shifted(2),
            _ => Writing::Counts,
        };
        let chunks = self.chunks();
        let port = u16::try_from(self.word(STREAM_PORT) & 0xFFFF).unwrap_or(0);
        let address = Ipv4Addr::from_bits(self.word(STREAM_ADDRESS));
        let destination = (port != 0 && !address.is_unspecified()).then(|| SocketAddrV4::new(address, port));
        let calibration_mode = self.find("CalibrationMode").map_or(0, |index| word(self.value(index)));
        Plan {
            settings: CameraSettings {
                rows: sensor.rows as usize,
                columns: sensor.columns as usize,
                integration_s,
                bits: sensor.bits,
            },
            layout: Layout {
                sensor,
                width: self.integer("Width"),
                rows: self.integer("Height") - header_rows,
                offset_x: self.integer("OffsetX"),
                offset_y: self.integer("OffsetY"),
                header_rows,
                pixel_format,
                writing,
                chunks,
                integration_s,
                rate_hz: self.float(preset.rate()),
                calibration_mode,
                payload_type: if chunks.is_some() {
                    PayloadType::ImageWithChunks
                } else {
                    PayloadType::Image
                },
            },
            destination,
            packet_bytes: (self.word(PACKET_SIZE) & 0xFFFF) as usize,
            packet_delay_ns: u64::from(self.word(PACKET_DELAY)),
            ids: self.ids(),
            trigger: self.trigger(),
            rate_hz: self.float(preset.rate()),
            frames_max: match self.integer("AcquisitionMode") {
                1 => Some(1),
                2 => Some(u64::from(self.integer("AcquisitionFrameCount"))),
                _ => None,
            },
        }
    }
}

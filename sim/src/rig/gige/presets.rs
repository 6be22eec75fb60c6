//! The makes of camera that can be played: their features and their quirks.
//!
//! Names of `generic` are those of the SFNC where it has one. `flir` and `telops` follow the public Python drivers
//! pyflir 0.2.4 and pyTelops 0.2.5, whose names come from the cameras' own descriptions; names that neither has are
//! ours and marked so. A quirk is here because a driver falls over it, not for completeness.

use super::feature::{Access, Bound, Feature, place};
use serde::{Deserialize, Serialize};

/// A make of camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Preset {
    /// By the book (SFNC).
    Generic,
    /// Counts four times too large in Mono16, milliseconds, a command that destroys the factory gain.
    Flir,
    /// Two header rows in every image, arming, status bits, numeric trigger sources.
    Telops,
}

/// The detector behind the network.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sensor {
    /// Rows.
    pub rows: u32,
    /// Columns.
    pub columns: u32,
    /// Bits of a sample.
    pub bits: u32,
    /// Whether there is a shutter or flag.
    pub shutter: bool,
}

/// Mono14, one sample in two bytes (PFNC).
pub(super) const MONO_14: u32 = 0x0110_0025;
/// Mono16 (PFNC).
pub(super) const MONO_16: u32 = 0x0110_0007;

/// Values of `TriggerSource` of a `generic` camera, and of `SyncSource` of a `flir`.
pub(super) const SOURCE_SOFTWARE: u32 = 0;

/// `SyncSource` of a `flir`: the camera's own clock, and software.
pub(super) const SYNC_INTERNAL: u32 = 0;
/// See [`SYNC_INTERNAL`].
pub(super) const SYNC_SOFTWARE: u32 = 2;

/// Chunks, by their number in `ChunkSelector`: name, chunk id.
pub(super) const CHUNKS: [(&str, u32); 3] =
    [("FrameID", 0x1000_0001), ("ExposureTime", 0x1000_0002), ("Timestamp", 0x1000_0003)];

/// Chunk id of the image itself.
pub(super) const CHUNK_IMAGE: u32 = 0x1000_0000;

/// Bytes of the header that a `telops` puts into its first rows.
pub(super) const TELOPS_HEADER_BYTES: u32 = 256;

impl Preset {
    /// Rows that precede the picture in every image.
    pub(super) fn header_rows(self) -> u32 {
        if self == Self::Telops { 2 } else { 0 }
    }

    /// Name of the integration time and how many of its units make a second.
    pub(super) fn exposure(self) -> (&'static str, f64) {
        if self == Self::Flir { ("PS0IntegrationTime", 1e3) } else { ("ExposureTime", 1e6) }
    }

    /// Name of the frame rate, in hertz.
    pub(super) fn rate(self) -> &'static str {
        if self == Self::Flir { "PS0FrameRate" } else { "AcquisitionFrameRate" }
    }

    /// Value of the trigger selector whose triggers make frames.
    pub(super) fn frame_selector(self) -> u32 {
        0
    }

    /// Name of the feature that moves the shutter: 1 or true closes it. Only the SFNC has none; all three are ours.
    pub(super) fn shutter(self) -> &'static str {
        match self {
            Self::Generic => "ShutterClosed",
            Self::Flir => "FlagPosition",
            Self::Telops => "ICUPosition",
        }
    }

    /// The features of such a camera, with addresses.
    pub(super) fn features(self, sensor: Sensor) -> Vec<Feature> {
        let mut features = Vec::new();
        device(self, &mut features);
        image(self, sensor, &mut features);
        acquisition(self, &mut features);
        match self {
            Self::Generic => {
                sfnc_trigger(&[("FrameStart", 0)], &[("Software", 0), ("Line1", 1)], &mut features)
            }
            Self::Flir => flir_trigger(&mut features),
            Self::Telops => sfnc_trigger(
                &[("AcquisitionStart", 0), ("Flagging", 1), ("Gating", 2)],
                // Numbers of pyTelops.
                &[("Software", 0), ("ExternalSignal", 48)],
                &mut features,
            ),
        }
        correction(self, sensor, &mut features);
        if self != Self::Flir {
            chunk(&mut features);
        }
        transport(&mut features);
        place(&mut features);
        features
    }
}

fn fixed(min: i64, max: i64) -> [Bound; 2] {
    [Bound::Value(min), Bound::Value(max)]
}

fn device(preset: Preset, to: &mut Vec<Feature>) {
    const CATEGORY: &str = "DeviceControl";
    to.push(
        Feature::float(CATEGORY, "DeviceTemperature", Access::ReadOnly, [-273.15, 200.0, 0.0], "C", 20.0)
            .says("Temperature of the detector, in degrees Celsius."),
    );
    to.push(
        Feature::command(CATEGORY, "DeviceReset").says("Restarts the camera: all registers as at power-on."),
    );
    if preset == Preset::Telops {
        to.push(Feature::count(CATEGORY, "TDCStatus", 0).says(
            "Bits that are set while the camera waits: 0 cooler, 1 sensor, 8 arm; bit 10: acquisition started.",
        ));
        to.push(
            Feature::boolean(CATEGORY, "DeviceNotReady", Access::ReadOnly)
                .says("True while cooler or sensor are not ready."),
        );
    }
}

fn image(preset: Preset, sensor: Sensor, to: &mut Vec<Feature>) {
    const CATEGORY: &str = "ImageFormatControl";
    let rows = sensor.rows + preset.header_rows();
    to.push(Feature::count(CATEGORY, "SensorWidth", sensor.columns).says("Columns of the detector."));
    to.push(Feature::count(CATEGORY, "SensorHeight", sensor.rows).says("Rows of the detector."));
    to.push(Feature::count(CATEGORY, "WidthMax", sensor.columns).says("Largest width."));
    to.push(Feature::count(CATEGORY, "HeightMax", rows).says("Largest height."));
    to.push(Feature::count("", "WidthRoom", sensor.columns));
    to.push(Feature::count("", "HeightRoom", rows));
    to.push(Feature::count("", "OffsetXRoom", 0));
    to.push(Feature::count("", "OffsetYRoom", 0));
    // The header of a telops must fit into its two rows of two bytes a pixel.
    let least = if preset == Preset::Telops { i64::from(TELOPS_HEADER_BYTES / 4) } else { 4 };
    let least = least.min(i64::from(sensor.columns));
    let grain = if sensor.columns.is_multiple_of(4) { 4 } else { 1 };
    let integer =
        |name, limits, inc, initial| Feature::integer(CATEGORY, name, Access::Locked, limits, inc, initial);
    let room = |min, name| [Bound::Value(min), Bound::Feature(name)];
    to.push(integer("Width", room(least, "WidthRoom"), grain, sensor.columns).says("Columns of the image."));
    let rows_least = i64::from(1 + preset.header_rows());
    let says = if preset == Preset::Telops {
        "Rows of the image, two header rows included."
    } else {
        "Rows of the image."
    };
    to.push(integer("Height", room(rows_least, "HeightRoom"), 1, rows).says(says));
    to.push(integer("OffsetX", room(0, "OffsetXRoom"), grain, 0).says("First column on the detector."));
    to.push(integer("OffsetY", room(0, "OffsetYRoom"), 1, 0).says("First row on the detector."));
    let mut formats = vec![("Mono16", MONO_16)];
    if sensor.bits <= 14 && preset != Preset::Telops {
        formats.push(("Mono14", MONO_14));
    }
    to.push(
        Feature::enumeration(CATEGORY, "PixelFormat", Access::Locked, &formats)
            .says("How a count is written."),
    );
    if preset == Preset::Flir {
        let formats = [("Radiometric", 0), ("TemperatureLinear100mK", 1), ("TemperatureLinear10mK", 2)];
        to.push(
            Feature::enumeration(CATEGORY, "IRFormat", Access::Locked, &formats)
                .says("Counts, or the camera's own idea of temperatures."),
        );
    }
}

fn acquisition(preset: Preset, to: &mut Vec<Feature>) {
    const CATEGORY: &str = "AcquisitionControl";
    let modes = [("Continuous", 0), ("SingleFrame", 1), ("MultiFrame", 2)];
    to.push(
        Feature::enumeration(CATEGORY, "AcquisitionMode", Access::Locked, &modes)
            .says("How many frames come."),
    );
    if preset == Preset::Telops {
        to.push(
            Feature::command(CATEGORY, "AcquisitionArm")
                .says("Makes ready to start; AcquisitionStart does it by itself if it was not done."),
        );
    }
    to.push(Feature::command(CATEGORY, "AcquisitionStart").says("Starts the stream."));
    to.push(Feature::command(CATEGORY, "AcquisitionStop").says("Stops the stream."));
    to.push(
        Feature::integer(CATEGORY, "AcquisitionFrameCount", Access::Locked, fixed(1, 65535), 1, 1)
            .says("Frames of MultiFrame."),
    );
    to.push(
        Feature::float(CATEGORY, preset.rate(), Access::Locked, [0.1, 1000.0, 0.0], "Hz", 100.0)
            .says("Frames per second when not triggered."),
    );
    // 1 us to 10 ms by 0.1 us: the limits and the grain of the simulated camera.
    let (name, per_second) = preset.exposure();
    let limits = [1e-6 * per_second, 1e-2 * per_second, 1e-7 * per_second];
    let unit = if preset == Preset::Flir { "ms" } else { "us" };
    to.push(
        Feature::float(CATEGORY, name, Access::Locked, limits, unit, 1e-3 * per_second)
            .says("Integration time."),
    );
    match preset {
        Preset::Generic => to.push(
            Feature::enumeration(CATEGORY, "ExposureMode", Access::Locked, &[("Timed", 1)])
                .says("Who ends the exposure."),
        ),
        Preset::Telops => {
            to.push(
                Feature::enumeration(CATEGORY, "ExposureMode", Access::Locked, &[("Timed", 1)])
                    .says("Who ends the exposure."),
            );
            to.push(
                Feature::enumeration(CATEGORY, "ExposureAuto", Access::Locked, &[("Off", 0)])
                    .says("Automatic exposure."),
            );
        }
        Preset::Flir => {}
    }
}

fn sfnc_trigger(selectors: &[(&'static str, u32)], sources: &[(&'static str, u32)], to: &mut Vec<Feature>) {
    const CATEGORY: &str = "AcquisitionControl";
    const SELECTOR: &str = "TriggerSelector";
    let enumeration =
        |name, entries: &[(&'static str, u32)]| Feature::enumeration(CATEGORY, name, Access::Locked, entries);
    to.push(
        Feature::enumeration(CATEGORY, SELECTOR, Access::ReadWrite, selectors)
            .says("Which trigger is meant."),
    );
    to.push(
        enumeration("TriggerMode", &[("Off", 0), ("On", 1)])
            .selected_by(SELECTOR)
            .says("Whether triggers make frames."),
    );
    to.push(enumeration("TriggerSource", sources).selected_by(SELECTOR).says("Where triggers come from."));
    to.push(
        enumeration("TriggerActivation", &[("RisingEdge", 0), ("FallingEdge", 1)])
            .selected_by(SELECTOR)
            .says("Edge of the signal."),
    );
    to.push(
        Feature::float(CATEGORY, "TriggerDelay", Access::Locked, [0.0, 1e6, 0.0], "us", 0.0)
            .selected_by(SELECTOR)
            .says("From the trigger to the exposure."),
    );
    to.push(Feature::command(CATEGORY, "TriggerSoftware").says("One trigger, when the source is Software."));
}

/// Trigger names of ours: pyflir does not trigger. Different from the SFNC on purpose.
fn flir_trigger(to: &mut Vec<Feature>) {
    const CATEGORY: &str = "AcquisitionControl";
    let sources = [("Internal", SYNC_INTERNAL), ("External", 1), ("Software", SYNC_SOFTWARE)];
    to.push(
        Feature::enumeration(CATEGORY, "SyncSource", Access::Locked, &sources).says("What makes frames."),
    );
    to.push(
        Feature::enumeration(CATEGORY, "SyncEdge", Access::Locked, &[("RisingEdge", 0), ("FallingEdge", 1)])
            .says("Edge of the external signal."),
    );
    to.push(
        Feature::float(CATEGORY, "SyncDelay", Access::Locked, [0.0, 1e3, 0.0], "ms", 0.0)
            .says("From the signal to the exposure."),
    );
    to.push(Feature::command(CATEGORY, "SyncSoftware").says("One frame, when the source is Software."));
}

fn correction(preset: Preset, sensor: Sensor, to: &mut Vec<Feature>) {
    const CATEGORY: &str = "CorrectionControl";
    if sensor.shutter {
        let name = preset.shutter();
        let shutter = match preset {
            Preset::Generic => Feature::boolean(CATEGORY, name, Access::ReadWrite),
            Preset::Flir => {
                Feature::enumeration(CATEGORY, name, Access::ReadWrite, &[("Open", 0), ("Closed", 1)])
            }
            Preset::Telops => {
                Feature::enumeration(CATEGORY, name, Access::ReadWrite, &[("Scene", 0), ("ICU", 1)])
            }
        };
        to.push(shutter.says("Position of the internal reference."));
        to.push(
            Feature::float(
                CATEGORY,
                "ShutterTemperature",
                Access::ReadOnly,
                [-273.15, 200.0, 0.0],
                "C",
                20.0,
            )
            .says("Temperature of the internal reference when it was last closed, in degrees Celsius."),
        );
    }
    match preset {
        Preset::Generic => to.push(
            Feature::command(CATEGORY, "NUCExecute")
                .says("Non-uniformity correction at the shutter; takes half a second."),
        ),
        Preset::Flir => {
            to.push(
                Feature::boolean(CATEGORY, "CorrectionAutoEnabled", Access::ReadWrite)
                    .says("Offset update at the flag by itself."),
            );
            to.push(
                Feature::command(CATEGORY, "CorrectionPerform")
                    .says("Computes gains anew and OVERWRITES the factory's. Needs two black bodies."),
            );
        }
        Preset::Telops => {
            let modes = [("NUC", 1), ("RAW0", 0), ("RT", 2), ("IBR", 3), ("IBI", 4), ("RAW", 255)];
            to.push(
                Feature::enumeration(CATEGORY, "CalibrationMode", Access::Locked, &modes)
                    .says("What the stream contains."),
            );
            to.push(
                Feature::command(CATEGORY, "ImageCorrection")
                    .says("Non-uniformity correction at the internal unit; takes half a second."),
            );
        }
    }
}

fn chunk(to: &mut Vec<Feature>) {
    const CATEGORY: &str = "ChunkDataControl";
    to.push(
        Feature::boolean(CATEGORY, "ChunkModeActive", Access::Locked)
            .says("Whether chunks follow the image."),
    );
    let names: Vec<(&'static str, u32)> =
        (0..).zip(CHUNKS).map(|(number, (name, _))| (name, number)).collect();
    to.push(
        Feature::enumeration(CATEGORY, "ChunkSelector", Access::ReadWrite, &names)
            .says("Which chunk is meant."),
    );
    to.push(
        Feature::boolean(CATEGORY, "ChunkEnable", Access::Locked)
            .selected_by("ChunkSelector")
            .says("Whether it comes."),
    );
}

fn transport(to: &mut Vec<Feature>) {
    to.push(
        Feature::count("TransportLayerControl", "PayloadSize", 0).says("Bytes of a block, chunks included."),
    );
    to.push(Feature::count("", "AcquisitionLock", 0));
}

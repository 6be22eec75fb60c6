//! One open GigE camera: features written and read back, the stream begun and ended. Blocks; lives in the camera's thread.

use super::GigeSettings;
use super::names::{Names, Purpose};
use super::pixels::{Layout, PixelFormat, TelopsHeader};
use super::sequence::Numbers;
use crate::error::DriverError;
use crate::instrument::{CameraClock, CameraSettings, Frame, Identity};
use crate::quantity::Kelvin;
use aravis::glib::object::Cast;
use aravis::prelude::*;
use aravis::{
    Buffer, BufferPayloadType, BufferStatus, Camera, ChunkParser, GcFeatureNode, GvStream, GvStreamOption,
    GvStreamPacketResend, GvStreamSocketBuffer, RangeCheckPolicy, Stream,
};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::time::Instant;

/// Longest difference between the integration time that was told and that of a frame's own data, relative.
const EXPOSURE_TOLERANCE: f64 = 1e-3;

/// How long a frame may lack packets before it is given up, in milliseconds. Three times the library's time for asking
/// again; beyond it the next frames wait.
const FRAME_RETENTION_MS: u32 = 200;

/// GigE Vision's control channel privilege register: bit 0 exclusive, bit 1 control.
const CONTROL_PRIVILEGE: u64 = 0x0A00;
const HAS_CONTROL: u32 = 0b11;

/// GigE Vision's clock, which stamps the leaders of frames: ticks in a second (two registers), its control (bit 1 latches
/// it), and what was latched (two registers).
const TICK_FREQUENCY: [u64; 2] = [0x093C, 0x0940];
const CLOCK_CONTROL: u64 = 0x0944;
const LATCH: u32 = 0b10;
const LATCHED: [u64; 2] = [0x0948, 0x094C];

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

/// An open camera.
pub(super) struct Device {
    who: String,
    camera: Camera,
    names: Names,
    settings: GigeSettings,
    control_lost: Arc<AtomicBool>,
    running: Option<Running>,
    prepared: Option<Prepared>,
    numbers: Numbers,
    /// Counters of the last stream that has ended.
    counters: Vec<(&'static str, u64)>,
}

#[derive(Debug, Clone, Copy)]
struct Prepared {
    layout: Layout,
    format: PixelFormat,
    integration_s: f64,
    chunks: bool,
}

struct Running {
    stream: Stream,
    parser: Option<ChunkParser>,
    prepared: Prepared,
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
    /// Opens a camera by its network address and takes control of it.
    pub(super) fn open(who: &str, address: &str, settings: &GigeSettings) -> Result<Self, DriverError> {
        let names = Names::new(settings.preset, &settings.features)
            .map_err(|why| refused(who, "reading the settings", &why, "Correct [camera.gige]."))?;
        let camera = Camera::new(Some(address)).map_err(|error| DriverError::Missing {
            who: who.to_owned(),
            why: error.message().to_owned(),
            hint: "Check power, cable, the camera's address (`ditd devices` lists what answers), and that no other program controls it."
                .to_owned(),
        })?;
        camera.set_range_check_policy(RangeCheckPolicy::Enable);
        if !settings.packet_socket {
            camera.gv_set_stream_options(GvStreamOption::PACKET_SOCKET_DISABLED);
        }
        let control_lost = Arc::new(AtomicBool::new(false));
        if let Some(device) = camera.device() {
            let flag = Arc::clone(&control_lost);
            // Comes from the library's heartbeat thread, 4 to 6 s after the camera has gone (measured).
            device.connect_control_lost(move |_| flag.store(true, Ordering::Release));
        }
        Ok(Self {
            who: who.to_owned(),
            camera,
            names,
            settings: settings.clone(),
            control_lost,
            running: None,
            prepared: None,
            numbers: Numbers::default(),
            counters: Vec::new(),
        })
    }

    /// Takes over the count of frames from the device that was there before.
    pub(super) fn go_on_from(&mut self, numbers: Numbers) {
        self.numbers = numbers;
    }

    /// The count of frames, for the next device.
    pub(super) fn numbers(&self) -> Numbers {
        self.numbers.clone()
    }

    /// Whether the camera has told that it is no longer ours.
    pub(super) fn is_lost(&self) -> bool {
        self.control_lost.load(Ordering::Acquire)
    }

    pub(super) fn identify(&self) -> Result<Identity, DriverError> {
        const DOING: &str = "asking who it is";
        let maker = self.camera.vendor_name().map_err(|error| self.trouble(DOING, &error))?;
        let model = self.camera.model_name().map_err(|error| self.trouble(DOING, &error))?;
        let serial = self
            .camera
            .device_serial_number()
            .or_else(|_| self.camera.string("DeviceID"))
            .map(|text| text.to_string())
            .unwrap_or_default();
        let firmware = ["DeviceFirmwareVersion", "DeviceVersion"]
            .iter()
            .find_map(|name| self.read(name).ok())
            .unwrap_or_default();
        Ok(Identity { maker: maker.to_string(), model: model.to_string(), serial, firmware })
    }

    /// Asks something harmless: an answer shows that the camera is there and ours.
    pub(super) fn check(&self) -> Result<(), DriverError> {
        const DOING: &str = "asking whether it is still there";
        if self.is_lost() {
            return Err(self.lost(DOING, "it no longer obeys this program".to_owned()));
        }
        if let Some(device) = self.camera.device().filter(|_| self.camera.is_gv_device()) {
            // A camera that has restarted answers, and has forgotten whom it obeys.
            let privilege = device.read_register(CONTROL_PRIVILEGE);
            let (_, value) = privilege.map_err(|error| self.lost(DOING, error.message().to_owned()))?;
            if value & HAS_CONTROL == 0 {
                return Err(self.lost(DOING, "it no longer obeys this program".to_owned()));
            }
            return Ok(());
        }
        let name = self.names.of(Purpose::Width).unwrap_or("Width");
        self.camera.integer(name).map(|_| ()).map_err(|error| self.lost(DOING, error.message().to_owned()))
    }

    /// What the clock shows that stamps the frames: latched between two moments of ours, then read. `None` for a camera
    /// that cannot do that; only one that is gone is an error.
    pub(super) fn clock(&self) -> Result<Option<CameraClock>, DriverError> {
        const DOING: &str = "asking for its clock";
        let Some(device) = self.camera.device().filter(|_| self.camera.is_gv_device()) else {
            return Ok(None);
        };
        let wide = |registers: [u64; 2]| -> Result<u64, aravis::glib::Error> {
            let [high, low] = registers;
            let (_, high) = device.read_register(high)?;
            let (_, low) = device.read_register(low)?;
            Ok(u64::from(high) << 32 | u64::from(low))
        };
        let latched = || -> Result<Option<CameraClock>, aravis::glib::Error> {
            let per_second = wide(TICK_FREQUENCY)?;
            let earliest = Instant::now();
            device.write_register(CLOCK_CONTROL, LATCH)?;
            let latest = Instant::now();
            let device_ns = nanoseconds(wide(LATCHED)?, per_second);
            Ok(device_ns.map(|device_ns| CameraClock { device_ns, earliest, latest }))
        };
        match latched() {
            Ok(clock) => Ok(clock),
            Err(error) => match self.trouble(DOING, &error) {
                gone @ DriverError::Lost { .. } => Err(gone),
                _ => Ok(None),
            },
        }
    }

    /// Writes everything that a campaign needs and reads it back.
    pub(super) fn prepare(&mut self, wanted: &CameraSettings) -> Result<CameraSettings, DriverError> {
        const DOING: &str = "setting region, format, integration time and trigger";
        self.stop();
        self.check()?;
        if let Some((name, value)) = self.names.raw_counts()
            && self.has(name)
        {
            self.write(name, value, DOING)?;
        }
        for (name, value) in &self.settings.set {
            self.write(name, &value.as_text(), DOING)?;
        }
        self.write_purpose(Purpose::AcquisitionMode, None, DOING)?;
        let format = self.set_format(wanted.bits, DOING)?;
        let header_rows = self.names.header_rows();
        // Offsets first to 0, so that no combination on the way is larger than the sensor.
        let rows = (wanted.rows + header_rows).to_string();
        for (purpose, value) in [
            (Purpose::OffsetX, "0".to_owned()),
            (Purpose::OffsetY, "0".to_owned()),
            (Purpose::Width, wanted.columns.to_string()),
            (Purpose::Height, rows),
            (Purpose::OffsetX, self.settings.first_column.to_string()),
            (Purpose::OffsetY, self.settings.first_row.to_string()),
        ] {
            self.write_purpose(purpose, Some(&value), DOING)?;
        }
        let unit_s = self.names.exposure_unit_s();
        let exposure = format!("{}", round_to(wanted.integration_s / unit_s, 1e-6));
        self.write_purpose(Purpose::Exposure, Some(&exposure), DOING)?;
        self.write_purpose(Purpose::TriggerSelector, None, DOING)?;
        let source = self.settings.trigger_source.clone();
        self.write_purpose(Purpose::TriggerSource, source.as_deref(), DOING)?;
        self.write_purpose(Purpose::TriggerActivation, None, DOING)?;
        self.write_purpose(Purpose::TriggerMode, None, DOING)?;
        let chunks = self.switch_chunks_on();
        self.set_packets(DOING)?;
        let taken = self.read_back(wanted, unit_s, DOING)?;
        let shift = if format == PixelFormat::Mono16 { self.names.shift_mono16(wanted.bits) } else { 0 };
        let layout =
            Layout { rows: taken.rows, columns: taken.columns, header_rows, shift, bits: wanted.bits };
        self.prepared = Some(Prepared { layout, format, integration_s: taken.integration_s, chunks });
        Ok(taken)
    }

    fn read_back(
        &self,
        wanted: &CameraSettings,
        unit_s: f64,
        doing: &str,
    ) -> Result<CameraSettings, DriverError> {
        let number = |purpose: Purpose| -> Result<f64, DriverError> {
            let name = self.names.of(purpose).unwrap_or_default();
            let text = self.read(name).map_err(|error| self.trouble(doing, &error))?;
            text.trim().parse().map_err(|_| DriverError::Garbled {
                who: self.who.clone(),
                doing: doing.to_owned(),
                answer: text.clone(),
                why: format!("{name} is no number"),
                hint: "Name another feature under [camera.gige.features].".to_owned(),
            })
        };
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "sides of a picture")]
        let side = |value: f64| value.max(0.0) as usize;
        let rows = side(number(Purpose::Height)?);
        Ok(CameraSettings {
            rows: rows.saturating_sub(self.names.header_rows()),
            columns: side(number(Purpose::Width)?),
            integration_s: number(Purpose::Exposure)? * unit_s,
            bits: wanted.bits,
        })
    }

    fn set_format(&self, bits: u32, doing: &str) -> Result<PixelFormat, DriverError> {
        let wanted = self.settings.pixel_format.as_deref();
        let choices: Vec<PixelFormat> = match wanted {
            Some("Mono14") => vec![PixelFormat::Mono14],
            Some(_) => vec![PixelFormat::Mono16],
            None if PixelFormat::for_bits(bits) == PixelFormat::Mono14 => {
                vec![PixelFormat::Mono14, PixelFormat::Mono16]
            }
            None => vec![PixelFormat::Mono16],
        };
        let name = self.names.of(Purpose::PixelFormat).unwrap_or("PixelFormat");
        let mut last = None;
        for format in choices {
            match self.write(name, format.name(), doing) {
                Ok(()) => return Ok(format),
                Err(error) => last = Some(error),
            }
        }
        Err(last.unwrap_or_else(|| {
            refused(&self.who, doing, "no pixel format carries the counts", "See `ditd probe`.")
        }))
    }

    /// Per-frame data, where the camera has it: the integration time of each frame is then checked.
    fn switch_chunks_on(&self) -> bool {
        self.has("ChunkModeActive") && self.camera.set_chunks("ExposureTime").is_ok()
    }

    fn set_packets(&self, doing: &str) -> Result<(), DriverError> {
        if !self.camera.is_gv_device() {
            return Ok(());
        }
        match self.settings.packet_size {
            Some(bytes) => {
                let bytes = i32::try_from(bytes).unwrap_or(i32::MAX);
                self.camera.gv_set_packet_size(bytes).map_err(|error| self.trouble(doing, &error))?;
            }
            // A camera that cannot send test packets keeps its own size.
            None => drop(self.camera.gv_auto_packet_size()),
        }
        if let Some(delay) = self.settings.packet_delay_ns {
            self.camera.gv_set_packet_delay(i64::from(delay)).map_err(|error| self.trouble(doing, &error))?;
        }
        Ok(())
    }

    /// Moves the shutter; its temperature when closed and known.
    pub(super) fn shutter(&self, closed: bool) -> Result<Option<Kelvin>, DriverError> {
        const DOING: &str = "moving the shutter";
        let Some(name) = self.names.of(Purpose::Shutter).filter(|name| self.has(name)) else {
            return Err(refused(
                &self.who,
                DOING,
                "it has no shutter that this program knows",
                "Name its feature under [camera.gige.features] shutter = \"…\", or take the offset with a cold plate before the lens.",
            ));
        };
        let word = match &self.settings.shutter_words {
            Some(words) => words[usize::from(closed)].as_str(),
            None => self.names.shutter_words()[usize::from(closed)],
        };
        self.write(name, word, DOING)?;
        if !closed {
            return Ok(None);
        }
        let celsius = self
            .names
            .of(Purpose::ShutterTemperature)
            .and_then(|name| self.read(name).ok())
            .and_then(|text| text.trim().parse::<f64>().ok())
            .filter(|celsius| celsius.is_finite());
        Ok(celsius.map(Kelvin::from_celsius))
    }

    /// A new offset at the shutter, where the settings ask for it.
    pub(super) fn correct_offset(&mut self) -> Result<(), DriverError> {
        const DOING: &str = "taking a new offset";
        if !self.settings.offset_correction {
            return Ok(());
        }
        // Never while pictures are taken.
        self.stop();
        let Some(name) = self.names.of(Purpose::OffsetCorrection).filter(|name| self.has(name)) else {
            return Err(refused(
                &self.who,
                DOING,
                "it has no offset correction that this program knows",
                "Name its command under [camera.gige.features] offset-correction = \"…\", or set offset_correction = false.",
            ));
        };
        super::names::refuse_forbidden(name)
            .map_err(|why| refused(&self.who, DOING, &why, "Name another command."))?;
        self.camera.execute_command(name).map_err(|error| self.trouble(DOING, &error))
    }

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
        let parser = prepared.chunks.then(|| self.camera.create_chunk_parser()).flatten();
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

    fn node(&self, name: &str) -> Option<GcFeatureNode> {
        self.camera.device()?.feature(name)?.downcast::<GcFeatureNode>().ok()
    }

    fn has(&self, name: &str) -> bool {
        self.camera.is_feature_available(name).unwrap_or(false)
    }

    fn read(&self, name: &str) -> Result<String, aravis::glib::Error> {
        match self.node(name) {
            Some(node) => node.value_as_string().map(|text| text.to_string()),
            None => self.camera.string(name).map(|text| text.to_string()),
        }
    }

    fn write_purpose(&self, purpose: Purpose, value: Option<&str>, doing: &str) -> Result<(), DriverError> {
        let Some(name) = self.names.of(purpose) else { return Ok(()) };
        let Some(value) = value.or_else(|| self.names.value_of(purpose)) else { return Ok(()) };
        if !self.names.is_required(purpose) && !self.has(name) {
            return Ok(());
        }
        self.write(name, value, doing)
    }

    fn write(&self, name: &str, value: &str, doing: &str) -> Result<(), DriverError> {
        super::names::refuse_forbidden(name)
            .map_err(|why| refused(&self.who, doing, &why, "Take it out of [camera.gige]."))?;
        let Some(node) = self.node(name) else {
            return Err(refused(
                &self.who,
                doing,
                &format!("it has no feature {name}"),
                "`ditd probe` lists what it has; give its name under [camera.gige.features].",
            ));
        };
        node.set_value_from_string(value).map_err(|error| {
            let bounds = self.camera.float_bounds(name).ok();
            let bounds = bounds.map(|(low, high)| format!(" (it takes {low} to {high})")).unwrap_or_default();
            self.trouble(&format!("{doing}: {name} = {value}{bounds}"), &error)
        })
    }

    /// The error for a call that failed: the library's words name the feature.
    fn trouble(&self, doing: &str, error: &aravis::glib::Error) -> DriverError {
        use aravis::DeviceError as Kind;
        let gone = matches!(
            error.kind::<Kind>(),
            Some(Kind::Timeout | Kind::NotConnected | Kind::TransferError | Kind::NotFound)
        );
        if gone || self.is_lost() {
            return self.lost(doing, error.message().to_owned());
        }
        refused(&self.who, doing, error.message(), "`ditd probe` prints what the camera offers.")
    }

    fn lost(&self, doing: &str, why: String) -> DriverError {
        DriverError::lost(
            &self.who,
            doing,
            why,
            "Check the camera's power and network cable, and that no other program controls it.",
        )
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        self.stop();
    }
}

/// The frame in a buffer; `None` for one that cannot be told where it belongs. What the camera says against its orders is
/// an error.
fn frame_of(
    buffer: &Buffer,
    running: &Running,
    numbers: &mut Numbers,
) -> Result<Option<Frame>, (String, &'static str)> {
    let status = buffer.status();
    // A camera without a clock of its own: the time of arrival has to do. A frame whose leader was lost has none either,
    // and cannot be told where it belongs.
    let stamp = match buffer.timestamp() {
        0 if status == BufferStatus::Success => buffer.system_timestamp(),
        device => device,
    };
    if matches!(status, BufferStatus::Aborted | BufferStatus::Cleared | BufferStatus::Filling) {
        return Ok(None);
    }
    let Some(numbered) = numbers.take(buffer.frame_id()) else { return Ok(None) };
    let prepared = &running.prepared;
    let layout = prepared.layout;
    let frame = |counts: Vec<u16>, complete: bool| Frame {
        id: numbered.number,
        device_ns: stamp,
        rows: layout.rows,
        columns: layout.columns,
        counts: counts.into(),
        complete,
    };
    if status != BufferStatus::Success {
        // What is missing of it is unknown: its counts are not looked at.
        return Ok((stamp != 0).then(|| frame(vec![0; layout.rows * layout.columns], false)));
    }
    let format = buffer.image_pixel_format().raw();
    if PixelFormat::of(format) != Some(prepared.format) {
        return Err((
            format!("a frame has pixel format {format:#010x} where {} was set", prepared.format.name()),
            "Another program may have changed the camera: stop it.",
        ));
    }
    let size = (buffer.image_width(), buffer.image_height());
    if size.0 != as_i32(layout.columns) || size.1 != as_i32(layout.rows + layout.header_rows) {
        return Err((
            format!("a frame has {} × {} pixels, not those that were set", size.0, size.1),
            "Another program may have changed the camera: stop it.",
        ));
    }
    let bytes = buffer.image_data();
    let header = (layout.header_rows > 0).then(|| TelopsHeader::read(&bytes)).flatten();
    let chunk_s = running
        .parser
        .as_ref()
        .filter(|_| buffer.has_chunks() || buffer.payload_type() == BufferPayloadType::ExtendedChunkData)
        .and_then(|parser| parser.float_value(buffer, "ChunkExposureTime").ok())
        .map(|micros| micros * 1e-6);
    if let Some(seconds) = chunk_s.or(header.map(|header| header.exposure_s))
        && (seconds / prepared.integration_s - 1.0).abs() > EXPOSURE_TOLERANCE
    {
        return Err((
            format!("a frame was exposed for {seconds:.3e} s, not for {:.3e} s", prepared.integration_s),
            "Switch the camera's automatic exposure off, and see that no other program controls it.",
        ));
    }
    let (counts, complete) = layout
        .counts(&bytes)
        .map_err(|why| (why, "Check bits and pixel_format in [camera], and the preset in [camera.gige]."))?;
    Ok(Some(frame(counts, complete)))
}

/// Ticks of a clock in nanoseconds; `None` for a clock that does not tick.
fn nanoseconds(ticks: u64, per_second: u64) -> Option<u64> {
    let ns = u128::from(ticks) * 1_000_000_000 / (per_second != 0).then_some(u128::from(per_second))?;
    u64::try_from(ns).ok()
}

fn as_i32(value: usize) -> i32 {
    i32::try_from(value).unwrap_or(i32::MAX)
}

/// To the nearest multiple of `grain`, so that 25 µs is written as 25 and not as 25.000000000000004.
fn round_to(value: f64, grain: f64) -> f64 {
    (value / grain).round() * grain
}

fn refused(who: &str, doing: &str, why: &str, hint: &str) -> DriverError {
    DriverError::refused(who, doing, why, hint)
}

//! What a GigE camera is told before frames are taken: region, format, integration time, trigger, shutter, offset.

use super::device::{Device, refused};
use super::names::Purpose;
use super::pixels::{Layout, PixelFormat};
use crate::error::DriverError;
use crate::instrument::CameraSettings;
use crate::quantity::Kelvin;
use aravis::prelude::*;

/// What was set, as the frames must show it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Prepared {
    pub(super) layout: Layout,
    pub(super) format: PixelFormat,
    pub(super) integration_s: f64,
    pub(super) chunks: bool,
}

impl Device {
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
}

/// To the nearest multiple of `grain`, so that 25 µs is written as 25 and not as 25.000000000000004.
fn round_to(value: f64, grain: f64) -> f64 {
    (value / grain).round() * grain
}

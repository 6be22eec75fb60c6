//! A frame of the camera behind, as the payload that goes over the wire: window, sample format, header rows, chunks.
//!
//! Pure: no packet, no socket. Rows from the top, samples of two bytes, little-endian; chunks big-endian.

use super::gvsp::PayloadType;
use super::presets::{CHUNK_IMAGE, CHUNKS, MONO_14, Sensor, TELOPS_HEADER_BYTES};
use ditd_drivers::instrument::Frame;

/// Bytes of a chunk's value: all have eight.
const CHUNK_BYTES: u32 = 8;

/// Bytes of a chunk's tag: id and length.
const TAG_BYTES: u32 = 8;

/// Which chunks follow an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Chunks {
    /// By their number in `ChunkSelector`.
    pub(super) enabled: [bool; CHUNKS.len()],
}

impl Chunks {
    /// Bytes after the image, its own tag included.
    pub(super) fn bytes(self) -> u32 {
        let each = CHUNK_BYTES + TAG_BYTES;
        TAG_BYTES + self.enabled.iter().map(|&on| u32::from(on) * each).sum::<u32>()
    }
}

/// How a count becomes a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Writing {
    /// As it is.
    Counts,
    /// Times 2^n: aligned to the upper end.
    Shifted(u32),
    /// What a camera makes of it that reports temperatures: 300 K and a hundredth of a kelvin per count (made up), in
    /// so many parts of a kelvin. Not counts: a driver must notice.
    TemperatureLinear {
        /// Sample values in a kelvin.
        per_kelvin: u32,
    },
}

/// How an image is laid out.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Layout {
    /// The detector.
    pub(super) sensor: Sensor,
    /// Columns.
    pub(super) width: u32,
    /// Rows of the picture, without header rows.
    pub(super) rows: u32,
    /// First column on the detector.
    pub(super) offset_x: u32,
    /// First row on the detector.
    pub(super) offset_y: u32,
    /// Rows before the picture.
    pub(super) header_rows: u32,
    /// PFNC code.
    pub(super) pixel_format: u32,
    /// How a count is written.
    pub(super) writing: Writing,
    /// Chunks; `None` without chunk mode.
    pub(super) chunks: Option<Chunks>,
    /// Integration time in seconds.
    pub(super) integration_s: f64,
    /// Frames per second.
    pub(super) rate_hz: f64,
    /// Calibration mode of a telops.
    pub(super) calibration_mode: u32,
    /// What the block contains.
    pub(super) payload_type: PayloadType,
}

/// What varies from frame to frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Stamp {
    /// Block id.
    pub(super) block: u64,
    /// Clock of the camera at the start of the exposure, in nanoseconds.
    pub(super) timestamp_ns: u64,
    /// The factory gain has been overwritten: the picture is worthless.
    pub(super) spoiled: bool,
}

impl Layout {
    /// Payload of a frame of the whole detector, and how many of its bytes exist (the camera behind loses the second
    /// half of a frame that it calls incomplete).
    ///
    /// # Errors
    /// Says so when the frame has another size than the detector.
    pub(super) fn payload(&self, frame: &Frame, stamp: Stamp) -> Result<(Vec<u8>, usize), String> {
        let (rows, columns) = (self.sensor.rows as usize, self.sensor.columns as usize);
        if (frame.rows, frame.columns) != (rows, columns) || frame.counts.len() != rows * columns {
            let (r, c, n) = (frame.rows, frame.columns, frame.counts.len());
            return Err(format!("a frame of {r}×{c} with {n} counts from a detector of {rows}×{columns}"));
        }
        let row_bytes = 2 * self.width as usize;
        let image_bytes = row_bytes * (self.rows + self.header_rows) as usize;
        let chunk_bytes = self.chunks.map_or(0, Chunks::bytes) as usize;
        let mut payload = Vec::with_capacity(image_bytes + chunk_bytes);
        if self.header_rows > 0 {
            payload.extend(self.header(stamp));
            payload.resize(row_bytes * self.header_rows as usize, 0);
        }
        let first = self.offset_x as usize;
        let window = self.offset_y as usize..(self.offset_y + self.rows) as usize;
        for row in window {
            let start = row * columns + first;
            self.write_row(&frame.counts[start..start + self.width as usize], stamp.spoiled, &mut payload);
        }
        let present = if frame.complete { image_bytes + chunk_bytes } else { image_bytes / 2 };
        if let Some(chunks) = self.chunks {
            self.write_chunks(chunks, stamp, &mut payload);
        }
        Ok((payload, present))
    }

    fn write_row(&self, counts: &[u16], spoiled: bool, out: &mut Vec<u8>) {
        let top = if self.pixel_format == MONO_14 { 0x3FFF } else { u16::MAX };
        let start = out.len();
        out.resize(start + 2 * counts.len(), 0);
        let (samples, _) = out[start..].as_chunks_mut::<2>();
        let mut write = |sample: &dyn Fn(u16) -> u16| {
            for (to, &count) in samples.iter_mut().zip(counts) {
                *to = sample(count).to_le_bytes();
            }
        };
        match self.writing {
            // A gain table of nonsense: halves everything and adds a step.
            _ if spoiled => write(&|count| (count / 2 + 1000).min(top)),
            Writing::Counts => {
                for (to, &count) in samples.iter_mut().zip(counts) {
                    *to = count.min(top).to_le_bytes();
                }
            }
            Writing::Shifted(bits) => {
                let most = u16::MAX >> bits;
                for (to, &count) in samples.iter_mut().zip(counts) {
                    *to = (count.min(most) << bits).to_le_bytes();
                }
            }
            Writing::TemperatureLinear { per_kelvin } => write(&|count| {
                let value = (30_000 + u32::from(count)) * per_kelvin / 100;
                u16::try_from(value).unwrap_or(u16::MAX).min(top)
            }),
        }
    }

    /// The header of a telops, little-endian (pyTelops 0.2.5 for the places). Width and height are those of the
    /// picture; the height without header rows is our choice, as is the length: that of the header itself.
    fn header(&self, stamp: Stamp) -> [u8; TELOPS_HEADER_BYTES as usize] {
        let mut header = [0; TELOPS_HEADER_BYTES as usize];
        let mut put = |at: usize, bytes: &[u8]| header[at..at + bytes.len()].copy_from_slice(bytes);
        put(0, b"TC");
        put(4, &256_u16.to_le_bytes());
        #[expect(clippy::cast_possible_truncation, reason = "the header's frame id wraps at 2^32")]
        put(8, &(stamp.block as u32).to_le_bytes());
        put(24, &whole(self.integration_s * 1e8).to_le_bytes());
        put(28, &[u8::try_from(self.calibration_mode).unwrap_or(u8::MAX)]);
        put(32, &u16::try_from(self.width).unwrap_or(u16::MAX).to_le_bytes());
        put(34, &u16::try_from(self.rows).unwrap_or(u16::MAX).to_le_bytes());
        put(44, &whole(self.rate_hz * 1e3).to_le_bytes());
        let seconds = stamp.timestamp_ns / 1_000_000_000;
        put(100, &u32::try_from(seconds).unwrap_or(u32::MAX).to_le_bytes());
        let ticks = stamp.timestamp_ns % 1_000_000_000 / 100;
        put(104, &u32::try_from(ticks).unwrap_or(u32::MAX).to_le_bytes());
        header
    }

    fn write_chunks(&self, chunks: Chunks, stamp: Stamp, out: &mut Vec<u8>) {
        let tag = |id: u32, bytes: u32| [id.to_be_bytes(), bytes.to_be_bytes()].concat();
        let image_bytes = 2 * self.width * (self.rows + self.header_rows);
        out.extend(tag(CHUNK_IMAGE, image_bytes));
        let values = [
            stamp.block.to_be_bytes(),
            (self.integration_s * 1e6).to_be_bytes(),
            stamp.timestamp_ns.to_be_bytes(),
        ];
        for ((on, value), (_, id)) in chunks.enabled.into_iter().zip(values).zip(CHUNKS) {
            if on {
                out.extend(value);
                out.extend(tag(id, CHUNK_BYTES));
            }
        }
    }
}

/// The nearest whole number that a register of four bytes holds.
fn whole(value: f64) -> u32 {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "limited to 0 … 2^32 − 1")]
    let limited = value.round().clamp(0.0, f64::from(u32::MAX)) as u32;
    limited
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::gige::presets::MONO_16;

    const SENSOR: Sensor = Sensor { rows: 6, columns: 128, bits: 14, shutter: false };
    const STAMP: Stamp = Stamp { block: 9, timestamp_ns: 12_345_678_900, spoiled: false };

    fn layout() -> Layout {
        Layout {
            sensor: SENSOR,
            width: 128,
            rows: 6,
            offset_x: 0,
            offset_y: 0,
            header_rows: 0,
            pixel_format: MONO_16,
            writing: Writing::Counts,
            chunks: None,
            integration_s: 25e-6,
            rate_hz: 100.0,
            calibration_mode: 1,
            payload_type: PayloadType::Image,
        }
    }

    fn frame() -> Frame {
        let counts: Vec<u16> = (0..6 * 128).map(|i| 1000 + i).collect();
        Frame { id: 3, device_ns: 5, rows: 6, columns: 128, counts: counts.into(), complete: true }
    }

    fn sample(payload: &[u8], index: usize) -> u16 {
        u16::from_le_bytes([payload[2 * index], payload[2 * index + 1]])
    }

    #[test]
    fn window_is_cut_where_it_should() {
        let cut = Layout { width: 64, rows: 2, offset_x: 16, offset_y: 3, ..layout() };
        let (payload, present) = cut.payload(&frame(), STAMP).unwrap();
        assert_eq!((payload.len(), present), (2 * 64 * 2, 2 * 64 * 2));
        assert_eq!(sample(&payload, 0), 1000 + 3 * 128 + 16);
        assert_eq!(sample(&payload, 64), 1000 + 4 * 128 + 16);
    }

    #[test]
    fn every_way_of_writing_a_count() {
        let write = |writing, pixel_format, spoiled| {
            let layout = Layout { writing, pixel_format, ..layout() };
            let (payload, _) = layout.payload(&frame(), Stamp { spoiled, ..STAMP }).unwrap();
            sample(&payload, 200)
        };
        assert_eq!(write(Writing::Counts, MONO_16, false), 1200);
        assert_eq!(write(Writing::Counts, MONO_14, false), 1200);
        assert_eq!(write(Writing::Shifted(2), MONO_16, false), 4800);
        assert_eq!(write(Writing::TemperatureLinear { per_kelvin: 10 }, MONO_16, false), 3120);
        assert_eq!(write(Writing::TemperatureLinear { per_kelvin: 100 }, MONO_16, false), 31_200);
        assert_eq!(write(Writing::Counts, MONO_16, true), 1600);
        let mut bright = frame();
        bright.counts = vec![65_000; 6 * 128].into();
        let top = |writing, pixel_format| {
            let (payload, _) = Layout { writing, pixel_format, ..layout() }.payload(&bright, STAMP).unwrap();
            sample(&payload, 0)
        };
        assert_eq!(top(Writing::Counts, MONO_14), 0x3FFF);
        assert_eq!(top(Writing::Shifted(2), MONO_16), 0xFFFC);
    }

    #[test]
    fn telops_header_stands_before_the_picture() {
        let (payload, _) = Layout { header_rows: 2, ..layout() }.payload(&frame(), STAMP).unwrap();
        assert_eq!(payload.len(), 2 * 128 * 8);
        assert_eq!(payload[..2], *b"TC");
        let word = |at: usize| u32::from_le_bytes(*payload[at..].first_chunk().unwrap());
        assert_eq!((word(8), word(24), payload[28]), (9, 2500, 1));
        assert_eq!((word(32), word(44)), (128 | 6 << 16, 100_000));
        assert_eq!((word(100), word(104)), (12, 3_456_789));
        assert_eq!(sample(&payload, 256), 1000);
        // 64 columns are the least: the header fills both rows.
        let narrow = Layout { header_rows: 2, width: 64, ..layout() };
        assert_eq!(sample(&narrow.payload(&frame(), STAMP).unwrap().0, 128), 1000);
    }

    #[test]
    fn chunks_are_read_from_the_end() {
        let chunks = Chunks { enabled: [true, false, true] };
        let (payload, present) =
            Layout { chunks: Some(chunks), ..layout() }.payload(&frame(), STAMP).unwrap();
        assert_eq!(payload.len(), 2 * 6 * 128 + chunks.bytes() as usize);
        assert_eq!(present, payload.len());
        let mut end = payload.len();
        let mut found = Vec::new();
        while end > 0 {
            let word = |at: usize| u32::from_be_bytes(*payload[at..].first_chunk().unwrap());
            let (id, length) = (word(end - 8), word(end - 4) as usize);
            found.push((id, payload[end - 8 - length..end - 8].to_vec()));
            end -= 8 + length;
        }
        assert_eq!(found.len(), 3);
        assert_eq!(found[0], (CHUNKS[2].1, 12_345_678_900_u64.to_be_bytes().to_vec()));
        assert_eq!(found[1], (CHUNKS[0].1, 9_u64.to_be_bytes().to_vec()));
        assert_eq!((found[2].0, found[2].1.len()), (CHUNK_IMAGE, 2 * 6 * 128));
    }

    #[test]
    fn incomplete_frames_have_their_first_half() {
        let half = Frame { complete: false, ..frame() };
        let (payload, present) = layout().payload(&half, STAMP).unwrap();
        assert_eq!((payload.len(), present), (1536, 768));
        let wrong = Frame { rows: 5, ..frame() };
        assert!(layout().payload(&wrong, STAMP).unwrap_err().contains("5×128"));
    }
}

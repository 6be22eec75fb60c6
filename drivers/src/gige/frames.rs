//! From a buffer of the library to a frame, with everything that a frame says of itself held against what was set.

use super::pixels::{PixelFormat, TelopsHeader};
use super::sequence::Numbers;
use super::stream::Running;
use crate::instrument::Frame;
use aravis::{Buffer, BufferPayloadType, BufferStatus};

/// Longest difference between the integration time that was told and that of a frame's own data, relative.
const EXPOSURE_TOLERANCE: f64 = 1e-3;

/// The frame in a buffer; `None` for one that cannot be told where it belongs. What the camera says against its orders is
/// an error.
pub(super) fn frame_of(
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

fn as_i32(value: usize) -> i32 {
    i32::try_from(value).unwrap_or(i32::MAX)
}

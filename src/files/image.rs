//! Floating-point pictures: OpenEXR with named channels, and TIFF for programs without EXR (Fiji, MATLAB).
//!
//! EXR: one part (some readers see only the first), f32, scan lines in increasing order, ZIP of single lines, and at
//! most one custom attribute, because several would be written in hash order.

use super::FileError;
use exr::meta::attribute::AttributeValue;
use exr::prelude::{
    AnyChannel, AnyChannels, Compression, Encoding, FlatSamples, Image, Layer, LayerAttributes, LineOrder,
    ReadChannels, ReadLayers, Text, WritableImage,
};
use std::io::Cursor;
use std::path::Path;

/// Name of the attribute that holds units, flag legend and versions as a JSON text.
pub const ATTRIBUTE: &str = "ditd";

/// A picture with named f32 channels, each `[rows · columns]` in row order, row 0 at the top.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// Rows.
    pub rows: usize,
    /// Columns.
    pub columns: usize,
    /// Names, without dots, and values. EXR sorts them by name.
    pub channels: Vec<(String, Vec<f32>)>,
    /// The JSON text, ASCII; empty for none.
    pub description: String,
}

/// The bytes of an OpenEXR file.
///
/// # Errors
///
/// When the picture is empty or the description is not plain text.
///
/// Panics when a name has a dot or a channel the wrong number of values: the caller's mistakes.
pub fn exr_to_bytes(picture: &Picture) -> std::io::Result<Vec<u8>> {
    let pixels = picture.rows * picture.columns;
    let channels = picture.channels.iter().map(|(name, values)| {
        assert!(!name.contains('.'), "a dot in {name} would make it a layer");
        assert!(values.len() == pixels, "one value of {name} per pixel");
        AnyChannel::new(name.as_str(), FlatSamples::F32(values.clone()))
    });
    let mut attributes = LayerAttributes::default();
    if !picture.description.is_empty() {
        let text = Text::new_or_none(&picture.description)
            .ok_or_else(|| std::io::Error::other("the description is not plain text"))?;
        attributes.other.insert(Text::from(ATTRIBUTE), AttributeValue::Text(text));
    }
    let encoding =
        Encoding { compression: Compression::ZIP1, line_order: LineOrder::Increasing, ..Encoding::default() };
    let encoding = Encoding { blocks: exr::image::Blocks::ScanLines, ..encoding };
    let layer = Layer::new(
        (picture.columns, picture.rows),
        attributes,
        encoding,
        AnyChannels::sort(channels.collect()),
    );
    let mut out = Cursor::new(Vec::new());
    Image::from_layer(layer).write().to_buffered(&mut out).map_err(std::io::Error::other)?;
    Ok(out.into_inner())
}

/// Reads the first part of an OpenEXR file; channels of other kinds become f32.
///
/// # Errors
///
/// When the file cannot be read or is not an OpenEXR file of flat channels.
pub fn read_exr(path: &Path) -> Result<Picture, FileError> {
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .from_file(path)
        .map_err(|e| FileError::format(path, e))?;
    let layer = image.layer_data;
    let channels = layer
        .channel_data
        .list
        .iter()
        .map(|channel| (channel.name.to_string(), channel.sample_data.values_as_f32().collect()))
        .collect();
    let description = match layer.attributes.other.get(&Text::from(ATTRIBUTE)) {
        Some(AttributeValue::Text(text)) => text.to_string(),
        _ => String::new(),
    };
    Ok(Picture { rows: layer.size.height(), columns: layer.size.width(), channels, description })
}

/// The bytes of a one-channel f32 TIFF, NaN kept, with `description` (ASCII; empty for none) in its ImageDescription.
///
/// # Errors
///
/// When the picture is empty or too large for TIFF.
pub fn tiff_to_bytes(
    rows: usize,
    columns: usize,
    values: &[f32],
    description: &str,
) -> std::io::Result<Vec<u8>> {
    let size = |axis: usize| u32::try_from(axis).map_err(std::io::Error::other);
    let mut out = Cursor::new(Vec::new());
    let mut encoder = tiff::encoder::TiffEncoder::new(&mut out).map_err(std::io::Error::other)?;
    let mut image = encoder
        .new_image::<tiff::encoder::colortype::Gray32Float>(size(columns)?, size(rows)?)
        .map_err(std::io::Error::other)?;
    if !description.is_empty() {
        let tag = tiff::tags::Tag::ImageDescription;
        image.encoder().write_tag(tag, description).map_err(std::io::Error::other)?;
    }
    image.write_data(values).map_err(std::io::Error::other)?;
    Ok(out.into_inner())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture() -> Picture {
        #[expect(clippy::cast_precision_loss, reason = "small numbers")]
        let ramp = (0..15 * 40).map(|i| if i == 7 { f32::NAN } else { i as f32 * 0.5 }).collect::<Vec<_>>();
        Picture {
            rows: 15,
            columns: 40,
            channels: vec![("temperature_k".into(), ramp.clone()), ("Y".into(), ramp)],
            description: "{\"units\":{\"temperature_k\":\"K\"}}".into(),
        }
    }

    #[test]
    fn exr_comes_back_and_is_reproducible() {
        let picture = picture();
        let bytes = exr_to_bytes(&picture).unwrap();
        assert_eq!(bytes, exr_to_bytes(&picture).unwrap());
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.exr");
        std::fs::write(&path, bytes).unwrap();
        let back = read_exr(&path).unwrap();
        assert_eq!((back.rows, back.columns, back.description), (15, 40, picture.description.clone()));
        assert_eq!(back.channels[0].0, "Y");
        let bits = |v: &[f32]| v.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&back.channels[1].1), bits(&picture.channels[0].1));
    }

    #[test]
    fn tiff_holds_the_values() {
        let picture = picture();
        let bytes = tiff_to_bytes(15, 40, &picture.channels[0].1, &picture.description).unwrap();
        let mut decoder = tiff::decoder::Decoder::new(Cursor::new(bytes)).unwrap();
        assert_eq!(decoder.dimensions().unwrap(), (40, 15));
        let text = decoder.get_tag_ascii_string(tiff::tags::Tag::ImageDescription).unwrap();
        assert_eq!(text, picture.description);
        let tiff::decoder::DecodingResult::F32(values) = decoder.read_image().unwrap() else { panic!("f32") };
        assert!(values[7].is_nan() && values[8].to_bits() == 4.0_f32.to_bits());
    }
}

//! The set of files of one map: dit.npz, dit.exr, temperature_k.tif and three previews.

use super::image::{Picture, exr_to_bytes, tiff_to_bytes};
use super::npy::{Array, Values};
use super::npz::{self, Packing};
use super::preview::kinds::{Kind, kinds_to_png};
use super::preview::{self, Colours, Preview};
use super::{FileError, npz::to_bytes};
use crate::estimate::budget::Part;
use crate::estimate::map::{CHANNELS, DitMap, flag};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Version of the set of channels and of their meaning.
pub const MAP_SCHEMA: u32 = 1;

/// What goes with a map into its files. Nothing of it may depend on time or host: equal results are equal bytes.
#[derive(Debug, Clone, PartialEq)]
pub struct ResultMeta {
    /// What the map is of: the campaign's or stack's name, above the previews.
    pub title: String,
    /// More for the JSON text in the EXR: calibration, gammas, sources. `Null` for nothing.
    pub more: serde_json::Value,
}

/// Writes all files of `map` into `dir`, each complete or not at all, and returns their paths.
///
/// # Errors
///
/// When the folder cannot be made or a file not be written.
pub fn write_result(dir: &Path, map: &DitMap, meta: &ResultMeta) -> Result<Vec<PathBuf>, FileError> {
    std::fs::create_dir_all(dir).map_err(FileError::io(dir))?;
    let mut files = vec![
        ("dit.npz", npz_bytes(map)),
        ("dit.exr", exr_bytes(map, meta)),
        ("temperature_k.tif", tiff_bytes(map, meta)),
    ];
    files.extend(previews(map, &meta.title).into_iter().map(|(name, _, bytes)| (name, bytes)));
    let mut paths = Vec::new();
    for (name, bytes) in files {
        let path = dir.join(name);
        let bytes = bytes.map_err(FileError::io(&path))?;
        write_atomic(&path, &bytes)?;
        paths.push(path);
    }
    Ok(paths)
}

/// Writes a file under another name, makes it durable, and renames it: readers see all of it or nothing.
///
/// # Errors
///
/// When it cannot be written or renamed.
pub fn write_atomic(path: &Path, bytes: &[u8]) -> Result<(), FileError> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let part = path.with_file_name(format!(".{name}.part"));
    let write = || -> std::io::Result<()> {
        let mut file = std::fs::File::create(&part)?;
        file.write_all(bytes)?;
        file.sync_all()?;
        std::fs::rename(&part, path)
    };
    write().map_err(FileError::io(path))
}

/// The bytes of dit.npz: f64 channels `[rows, columns]`, count and, if there are any,
/// rejected u32 `[levels, rows, columns]`, flags u32; and what the flags mean: flag_bits u32 `[flags]` and flag_names u8
/// `[flags, 24]`, ASCII filled up with zeros (`names.view("S24")` in NumPy).
///
/// # Errors
///
/// As [`npz::to_bytes`].
pub fn npz_bytes(map: &DitMap) -> std::io::Result<Vec<u8>> {
    let shape = vec![map.rows, map.columns];
    let plane = |values: &[f64]| Array { shape: shape.clone(), values: Values::F64(values.to_vec()) };
    let mut arrays: Vec<(&str, Array)> =
        CHANNELS.iter().zip(map.channels()).map(|((name, _), values)| (*name, plane(values))).collect();
    arrays.extend(parts(map).map(|part| (part.name, plane(&part.sigma_k))));
    let levels = vec![map.levels, map.rows, map.columns];
    arrays.push(("count", Array { shape: levels.clone(), values: Values::U32(map.count.clone()) }));
    if !map.rejected.is_empty() {
        arrays.push(("rejected", Array { shape: levels, values: Values::U32(map.rejected.clone()) }));
    }
    arrays.push(("flags", Array { shape: shape.clone(), values: Values::U32(map.flags.clone()) }));
    let legend = flag::LEGEND;
    let bits = legend.iter().map(|(bit, ..)| *bit).collect();
    arrays.push(("flag_bits", Array { shape: vec![legend.len()], values: Values::U32(bits) }));
    let names = legend.iter().flat_map(|(_, name, _)| padded(name)).collect();
    arrays.push(("flag_names", Array { shape: vec![legend.len(), NAME_BYTES], values: Values::U8(names) }));
    let borrowed: Vec<(&str, &Array)> = arrays.iter().map(|(name, array)| (*name, array)).collect();
    to_bytes(&borrowed, Packing::Stored)
}

/// Bytes of a flag's name in dit.npz.
const NAME_BYTES: usize = 24;

fn padded(name: &str) -> [u8; NAME_BYTES] {
    let mut out = [0; NAME_BYTES];
    assert!(name.is_ascii() && name.len() <= NAME_BYTES, "names of flags are short");
    out[..name.len()].copy_from_slice(name.as_bytes());
    out
}

/// Bits, names and meanings of all flags, as every JSON text has them.
pub fn flag_legend() -> serde_json::Value {
    let one = |(bit, name, meaning): &(u32, &str, &str)| serde_json::json!({ "bit": bit, "name": name, "meaning": meaning });
    flag::LEGEND.iter().map(one).collect()
}

/// A map's arrays as read from dit.npz, by name.
///
/// # Errors
///
/// As [`npz::read`].
pub fn read_npz(path: &Path) -> Result<Vec<(String, Array)>, FileError> {
    npz::read(path)
}

fn exr_bytes(map: &DitMap, meta: &ResultMeta) -> std::io::Result<Vec<u8>> {
    let mut channels: Vec<(String, Vec<f32>)> = CHANNELS
        .iter()
        .zip(map.channels())
        .map(|((name, _), values)| ((*name).to_owned(), narrow(values)))
        .collect();
    channels.extend(parts(map).map(|part| (part.name.to_owned(), narrow(&part.sigma_k))));
    channels.push(("Y".into(), narrow(&map.temperature_k)));
    // Bits up to 2²⁴ and counts below it are exact in f32.
    #[expect(clippy::cast_precision_loss, reason = "below 2^24")]
    let exact = |values: &[u32]| values.iter().map(|&v| v as f32).collect::<Vec<_>>();
    channels.push(("flags".into(), exact(&map.flags)));
    let pixels = map.rows * map.columns;
    for level in 0..map.levels {
        channels.push((format!("count_{level:02}"), exact(&map.count[level * pixels..(level + 1) * pixels])));
        if !map.rejected.is_empty() {
            let rejected = &map.rejected[level * pixels..(level + 1) * pixels];
            channels.push((format!("rejected_{level:02}"), exact(rejected)));
        }
    }
    let description = ascii_description(map, meta);
    exr_to_bytes(&Picture { rows: map.rows, columns: map.columns, channels, description })
}

/// The temperature alone, with the description that the EXR has; flags are in the other files.
fn tiff_bytes(map: &DitMap, meta: &ResultMeta) -> std::io::Result<Vec<u8>> {
    tiff_to_bytes(map.rows, map.columns, &narrow(&map.temperature_k), &ascii_description(map, meta))
}

/// The description in ASCII: EXR and TIFF texts are one byte per character, and JSON can say the rest in escapes.
fn ascii_description(map: &DitMap, meta: &ResultMeta) -> String {
    description(map, meta).to_string().chars().map(escaped).collect()
}

/// The parts of the uncertainty budget that are channels of their own.
fn parts(map: &DitMap) -> impl Iterator<Item = &Part> {
    map.budget.iter().flat_map(|budget| &budget.parts)
}

/// What the channels of the budget are, and what is not among them.
fn budget_legend(map: &DitMap) -> serde_json::Value {
    let Some(budget) = &map.budget else { return serde_json::Value::Null };
    let kind = |systematic| if systematic { "systematic, common to all pixels" } else { "statistical" };
    let noise =
        serde_json::json!({ "name": "sigma_t_noise_k", "of": "the camera's noise", "kind": kind(false) });
    let total = budget.parts.len().saturating_sub(1);
    let parts = budget.parts.iter().enumerate().map(|(i, part)| {
        let kind = if i == total { "statistical and systematic" } else { kind(part.systematic) };
        serde_json::json!({ "name": part.name, "of": part.of, "kind": kind })
    });
    serde_json::json!({
        "parts": std::iter::once(noise).chain(parts).collect::<Vec<_>>(),
        "not_in_it": budget.absent,
        "sigma_temperature_k": "sigma_t_noise_k and sigma_t_shots_k in squares",
    })
}

fn escaped(character: char) -> String {
    if character.is_ascii() {
        return character.to_string();
    }
    let mut units = [0; 2];
    character.encode_utf16(&mut units).iter().map(|unit| format!("\\u{unit:04x}")).collect()
}

/// Units, flag legend and versions: the JSON text in the EXR.
pub fn description(map: &DitMap, meta: &ResultMeta) -> serde_json::Value {
    let units: serde_json::Map<String, serde_json::Value> = CHANNELS
        .iter()
        .copied()
        .chain(parts(map).map(|part| (part.name, "K")))
        .map(|(name, unit)| (name.to_owned(), unit.into()))
        .collect();
    serde_json::json!({
        "schema": MAP_SCHEMA,
        "software": concat!("ditd ", env!("CARGO_PKG_VERSION")),
        "title": meta.title,
        "estimator": map.estimator.name(),
        "confidence": map.confidence,
        "units": units,
        "budget": budget_legend(map),
        "flags": flag_legend(),
        "more": meta.more,
    })
}

/// The previews: file name, caption and PNG bytes. Temperatures that are not resolved, or of an emissivity below
/// three of its standard deviations, are grey: outside the spray one pixel in forty is resolved by chance.
pub fn previews(map: &DitMap, title: &str) -> Vec<(&'static str, &'static str, std::io::Result<Vec<u8>>)> {
    let resolved = |values: &[f64]| -> Vec<f64> {
        let hidden = flag::NOT_RESOLVED
            | flag::NEGATIVE_EMISSIVITY
            | flag::NO_PLATE
            | flag::LOW_EMISSIVITY
            | flag::HIGH_SIGMA;
        let shown = |i: usize| {
            let weak = map.emissivity[i] < 3.0 * map.sigma_emissivity[i];
            map.flags[i] & hidden == 0 && !weak
        };
        values.iter().enumerate().map(|(i, &v)| if shown(i) { v } else { f64::NAN }).collect()
    };
    let temperature = resolved(&map.temperature_k);
    let sigma = resolved(&map.sigma_temperature_k);
    // Titles are drawn with the embedded font; a long one is cut rather than widening the picture.
    let title: String = title.chars().take(24).collect();
    let draw = |values: &[f64], range: (f64, f64), what: &str, unit: &str, colours: Colours| {
        let title = if title.is_empty() { what.to_owned() } else { format!("{title}: {what}") };
        preview::to_png(&Preview {
            rows: map.rows,
            columns: map.columns,
            values,
            low: range.0,
            high: range.1,
            title: &title,
            unit,
            colours,
        })
    };
    // A few hardly resolved pixels at the spray's edge shall not darken all others.
    let above_zero = |values: &[f64]| {
        let mut finite: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
        finite.sort_unstable_by(f64::total_cmp);
        let high = finite.get(finite.len() * 9 / 10).copied().unwrap_or(1.0).max(1e-6);
        let step = preview::tick_step(high);
        (0.0, (high / step).ceil() * step)
    };
    vec![
        (
            "preview_emissivity.png",
            "Emissivity",
            draw(&map.emissivity, (0.0, 1.0), "emissivity", "1", Colours::Viridis),
        ),
        (
            "preview_temperature.png",
            "Effective temperature",
            draw(&temperature, preview::round_range(&temperature), "T_eff", "K", Colours::Inferno),
        ),
        (
            "preview_sigma_temperature.png",
            "Standard deviation of the temperature",
            draw(&sigma, above_zero(&sigma), "sigma T", "K", Colours::Viridis),
        ),
        ("preview_flags.png", "Flags: the highest bit of each pixel", flags_picture(map, &title)),
    ]
}

/// Flags in colours, with their legend.
fn flags_picture(map: &DitMap, title: &str) -> std::io::Result<Vec<u8>> {
    let title = if title.is_empty() { "flags".to_owned() } else { format!("{title}: flags") };
    let legend: Vec<Kind<'_>> = flag::LEGEND
        .iter()
        .zip(map.flag_counts())
        .map(|(&(bit, name, _), (_, pixels))| Kind { bit, name, pixels })
        .collect();
    kinds_to_png(map.rows, map.columns, &map.flags, &legend, &title)
}

#[expect(clippy::cast_possible_truncation, reason = "pictures store f32")]
fn narrow(values: &[f64]) -> Vec<f32> {
    values.iter().map(|&v| v as f32).collect()
}

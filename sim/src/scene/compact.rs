//! Our own form of a spray at one time: one small file, also meant to be embedded in the program.
//!
//! Layout, little-endian: magic `DITSPRAY`, version u32, CRC-32 of the packed bytes u32, their number u64, then
//! the packed (zlib) bytes: length of a JSON head u32, the head, the columns one after another, each with its
//! bytes transposed (all first bytes, all second bytes …) because that packs better.
//!
//! What is given up: parcels and gas values are single precision (relative error 6e-8; places 2e-9 m at 30 mm),
//! the pressure is computed from density and temperature (2e-6, the rounding of molar masses), and the cells with the least
//! vapour are left out up to [`VAPOUR_LEFT_OUT`] of it all; their sums stay in [`Remainder`], so that totals
//! keep their values. Cell corners are exact.

use super::field::{CfdSpray, GAS_CONSTANT, GasCell, Parcel, Remainder};
use super::import::{Place, SceneError};
use flate2::{Compression, Crc, read::ZlibDecoder, write::ZlibEncoder};
use std::collections::HashMap;
use std::io::{Read, Write};
use std::path::Path;

/// Share of the vapour's mass that may be left out with the cells that hold the least of it.
pub const VAPOUR_LEFT_OUT: f64 = 1e-7;

/// Version of the layout that is written; older ones stay readable.
pub const VERSION: u32 = 1;

const MAGIC: &[u8; 8] = b"DITSPRAY";
const PREFIX: usize = 24;
/// No spray that we would accept unpacks to more than this; keeps a damaged file from asking for all memory.
const UNPACKED_MAX: u64 = 4 << 30;

#[derive(serde::Serialize, serde::Deserialize)]
struct Head {
    time_s: f64,
    parcels: Option<usize>,
    liquid_density: bool,
    cells: Option<usize>,
    shaped_cells: usize,
    remainder: Option<HeadRemainder>,
    domain_m: Option<[[f64; 3]; 2]>,
    fuel: String,
    fuel_molar_mass_kg_mol: Option<f64>,
    carrier_molar_mass_kg_mol: f64,
    /// Number of distinct corner coordinates along x, y, z.
    ticks: [usize; 3],
}

#[derive(serde::Serialize, serde::Deserialize)]
struct HeadRemainder {
    cells: u64,
    volume_m3: f64,
    vapour_kg: f64,
    temperature_min_k: f64,
    temperature_max_k: f64,
    temperature_mean_k: f64,
}

/// Name of the spray that ships with the program.
pub const SHIPPED: &str = "eighthole_4bar_523K_0.9ms";

/// The spray that ships with the program: eight holes, 4 bar, 523 K, n-heptane, at 0.9 ms.
///
/// # Errors
///
/// None in a sound build; a test reads it.
pub fn shipped() -> Result<CfdSpray, SceneError> {
    let bytes = include_bytes!("../../data/cfd/eighthole_4bar_523K_0.9ms.spray");
    unpack(bytes, Path::new("eighthole_4bar_523K_0.9ms.spray"))
}

/// Packs a spray.
pub fn pack(spray: &CfdSpray) -> Vec<u8> {
    let (cells, remainder) = thin(spray);
    let mut ticks: [Vec<f64>; 3] = Default::default();
    let mut corners: [Vec<u32>; 6] = Default::default();
    for axis in 0..3 {
        let mut known = HashMap::new();
        let lower = cells.iter().map(|c| c.lower_m[axis]).collect::<Vec<_>>();
        let upper = cells.iter().map(|c| c.upper_m[axis]).collect::<Vec<_>>();
        let mut sorted: Vec<f64> = lower.iter().chain(&upper).copied().collect();
        sorted.sort_by(f64::total_cmp);
        sorted.dedup_by(|a, b| a.to_bits() == b.to_bits());
        for (index, value) in sorted.iter().enumerate() {
            known
                .insert(value.to_bits(), u32::try_from(index).expect("fewer than 2³² corners fit in memory"));
        }
        corners[2 * axis] = lower.iter().map(|v| known[&v.to_bits()]).collect();
        corners[2 * axis + 1] = upper.iter().map(|v| known[&v.to_bits()]).collect();
        ticks[axis] = sorted;
    }
    let head = Head {
        time_s: spray.time_s,
        parcels: spray.parcels.as_ref().map(Vec::len),
        liquid_density: spray.liquid_density_kg_m3.is_some(),
        cells: spray.cells.as_ref().map(|_| cells.len()),
        shaped_cells: spray.shaped_cells,
        remainder: remainder.map(|r| HeadRemainder {
            cells: r.cells,
            volume_m3: r.volume_m3,
            vapour_kg: r.vapour_kg,
            temperature_min_k: r.temperature_min_k,
            temperature_max_k: r.temperature_max_k,
            temperature_mean_k: r.temperature_mean_k,
        }),
        domain_m: spray.domain_m,
        fuel: spray.fuel.clone(),
        fuel_molar_mass_kg_mol: Some(spray.fuel_molar_mass_kg_mol).filter(|m| m.is_finite()),
        carrier_molar_mass_kg_mol: spray.carrier_molar_mass_kg_mol,
        ticks: std::array::from_fn(|a| ticks[a].len()),
    };
    let json = serde_json::to_vec(&head).expect("a head of numbers and strings is always JSON");
    let mut raw = Vec::new();
    raw.extend(u32::try_from(json.len()).expect("a head is short").to_le_bytes());
    raw.extend(json);
    let parcels = spray.parcels.as_deref().unwrap_or_default();
    for axis in 0..3 {
        push(&mut raw, parcels.iter().map(|p| single(p.position_m[axis])));
    }
    push(&mut raw, parcels.iter().map(|p| single(p.diameter_m)));
    push(&mut raw, parcels.iter().map(|p| single(p.temperature_k)));
    push(&mut raw, parcels.iter().map(|p| single(p.droplets)));
    push(&mut raw, spray.liquid_density_kg_m3.iter().flatten().map(|&rho| single(rho)));
    for axis in &ticks {
        push(&mut raw, axis.iter().map(|v| v.to_le_bytes()));
    }
    for column in &corners {
        push(&mut raw, column.iter().map(|v| v.to_le_bytes()));
    }
    push(&mut raw, cells.iter().map(|c| single(c.temperature_k)));
    push(&mut raw, cells.iter().map(|c| single(c.density_kg_m3)));
    push(&mut raw, cells.iter().map(|c| single(c.fuel_mass_fraction)));
    frame(&raw)
}

/// Unpacks a spray; `file` is only named in errors.
///
/// # Errors
///
/// [`SceneError::Malformed`] for a foreign, truncated or newer file, [`SceneError::Checksum`] for a damaged one.
pub fn unpack(bytes: &[u8], file: &Path) -> Result<CfdSpray, SceneError> {
    let raw = unframe(bytes, file)?;
    let mut from = Columns { file, raw: &raw, at: 0 };
    let length = u32::from_le_bytes(from.take::<4>(1)?[0]) as usize;
    let json = from.bytes(length)?;
    let head: Head = serde_json::from_slice(json)
        .map_err(|e| SceneError::malformed(file, Place::Byte(4), "a head in JSON", e.to_string()))?;
    let parcels = from.parcels(head.parcels.unwrap_or(0))?;
    let density = from.singles(if head.liquid_density { parcels.len() } else { 0 })?;
    let cells = from.cells(&head)?;
    if from.at != raw.len() {
        let found = format!("{} bytes more", raw.len() - from.at);
        return Err(SceneError::malformed(file, Place::Byte(from.at), "the end", found));
    }
    Ok(CfdSpray {
        time_s: head.time_s,
        parcels: head.parcels.map(|_| parcels),
        liquid_density_kg_m3: head.liquid_density.then_some(density),
        cells: head.cells.map(|_| cells),
        shaped_cells: head.shaped_cells,
        remainder: head.remainder.map(|r| Remainder {
            cells: r.cells,
            volume_m3: r.volume_m3,
            vapour_kg: r.vapour_kg,
            temperature_min_k: r.temperature_min_k,
            temperature_max_k: r.temperature_max_k,
            temperature_mean_k: r.temperature_mean_k,
        }),
        domain_m: head.domain_m,
        fuel: head.fuel,
        fuel_molar_mass_kg_mol: head.fuel_molar_mass_kg_mol.unwrap_or(f64::NAN),
        carrier_molar_mass_kg_mol: head.carrier_molar_mass_kg_mol,
        notes: Vec::new(),
    })
}

/// The cells worth keeping, in their order, and the sums of the others.
fn thin(spray: &CfdSpray) -> (Vec<GasCell>, Option<Remainder>) {
    let Some(cells) = &spray.cells else { return (Vec::new(), None) };
    let mut order: Vec<usize> = (0..cells.len()).collect();
    let vapour: Vec<f64> = cells.iter().map(GasCell::vapour_kg).collect();
    order.sort_by(|&a, &b| vapour[a].total_cmp(&vapour[b]));
    let limit = VAPOUR_LEFT_OUT * vapour.iter().sum::<f64>();
    let mut rest = spray.remainder.unwrap_or(Remainder {
        cells: 0,
        volume_m3: 0.0,
        vapour_kg: 0.0,
        temperature_min_k: f64::MAX,
        temperature_max_k: 0.0,
        temperature_mean_k: 0.0,
    });
    let mut warmth = rest.temperature_mean_k * rest.volume_m3;
    let mut keep = vec![true; cells.len()];
    for index in order {
        if rest.vapour_kg + vapour[index] > limit {
            break;
        }
        let cell = &cells[index];
        keep[index] = false;
        rest.cells += 1;
        rest.volume_m3 += cell.volume_m3();
        rest.vapour_kg += vapour[index];
        rest.temperature_min_k = rest.temperature_min_k.min(cell.temperature_k);
        rest.temperature_max_k = rest.temperature_max_k.max(cell.temperature_k);
        warmth += cell.temperature_k * cell.volume_m3();
    }
    if rest.cells == 0 {
        return (cells.clone(), None);
    }
    rest.temperature_mean_k = warmth / rest.volume_m3;
    let kept = cells.iter().zip(&keep).filter(|(_, keep)| **keep).map(|(cell, _)| *cell).collect();
    (kept, Some(rest))
}

#[expect(clippy::cast_possible_truncation, reason = "single precision is what the format states")]
fn single(value: f64) -> [u8; 4] {
    (value as f32).to_le_bytes()
}

fn push<const N: usize>(raw: &mut Vec<u8>, column: impl Iterator<Item = [u8; N]> + Clone) {
    for byte in 0..N {
        raw.extend(column.clone().map(|value| value[byte]));
    }
}

fn frame(raw: &[u8]) -> Vec<u8> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::best());
    encoder.write_all(raw).expect("writing to memory does not fail");
    let packed = encoder.finish().expect("writing to memory does not fail");
    let mut bytes = Vec::with_capacity(packed.len() + PREFIX);
    bytes.extend(MAGIC);
    bytes.extend(VERSION.to_le_bytes());
    bytes.extend(checksum(&packed).to_le_bytes());
    bytes.extend((packed.len() as u64).to_le_bytes());
    bytes.extend(packed);
    bytes
}

fn unframe(bytes: &[u8], file: &Path) -> Result<Vec<u8>, SceneError> {
    let refuse = |at: usize, expected: String, found: String| {
        Err(SceneError::malformed(file, Place::Byte(at), expected, found))
    };
    if !bytes.starts_with(MAGIC) {
        let start = String::from_utf8_lossy(&bytes[..bytes.len().min(8)]).into_owned();
        return refuse(0, "DITSPRAY".into(), format!("{start:?}"));
    }
    let Some((prefix, packed)) = bytes.split_at_checked(PREFIX) else {
        return refuse(bytes.len(), format!("a prefix of {PREFIX} bytes"), "the end of the file".into());
    };
    let word = |at: usize| u32::from_le_bytes(std::array::from_fn(|i| prefix[at + i]));
    if word(8) != VERSION {
        return refuse(
            8,
            format!("version {VERSION}"),
            format!("version {}: a newer program wrote it", word(8)),
        );
    }
    let length = u64::from_le_bytes(std::array::from_fn(|i| prefix[16 + i]));
    if packed.len() as u64 != length {
        return refuse(bytes.len(), format!("{length} packed bytes"), packed.len().to_string());
    }
    let found = checksum(packed);
    if found != word(12) {
        return Err(SceneError::Checksum { file: file.to_owned(), expected: word(12), found });
    }
    let mut raw = Vec::new();
    let unpacked = ZlibDecoder::new(packed).take(UNPACKED_MAX).read_to_end(&mut raw);
    match unpacked {
        Ok(_) => Ok(raw),
        Err(e) => refuse(PREFIX, "packed bytes".into(), e.to_string()),
    }
}

fn checksum(bytes: &[u8]) -> u32 {
    let mut crc = Crc::new();
    crc.update(bytes);
    crc.sum()
}

/// Reads columns one after another.
struct Columns<'a> {
    file: &'a Path,
    raw: &'a [u8],
    at: usize,
}

impl<'a> Columns<'a> {
    fn bytes(&mut self, length: usize) -> Result<&'a [u8], SceneError> {
        let rest = &self.raw[self.at..];
        let taken = rest.get(..length).ok_or_else(|| {
            let found = format!("{} to the end", rest.len());
            SceneError::malformed(self.file, Place::Byte(self.at), format!("{length} unpacked bytes"), found)
        })?;
        self.at += length;
        Ok(taken)
    }

    fn take<const N: usize>(&mut self, count: usize) -> Result<Vec<[u8; N]>, SceneError> {
        let bytes = self.bytes(count.saturating_mul(N))?;
        Ok((0..count).map(|i| std::array::from_fn(|b| bytes[b * count + i])).collect())
    }

    fn singles(&mut self, count: usize) -> Result<Vec<f64>, SceneError> {
        Ok(self.take::<4>(count)?.into_iter().map(|b| f64::from(f32::from_le_bytes(b))).collect())
    }

    fn parcels(&mut self, count: usize) -> Result<Vec<Parcel>, SceneError> {
        let [x, y, z] = [self.singles(count)?, self.singles(count)?, self.singles(count)?];
        let [diameter, temperature, droplets] =
            [self.singles(count)?, self.singles(count)?, self.singles(count)?];
        Ok((0..count)
            .map(|i| Parcel {
                position_m: [x[i], y[i], z[i]],
                diameter_m: diameter[i],
                temperature_k: temperature[i],
                droplets: droplets[i],
            })
            .collect())
    }

    fn cells(&mut self, head: &Head) -> Result<Vec<GasCell>, SceneError> {
        let count = head.cells.unwrap_or(0);
        let mut ticks: [Vec<f64>; 3] = Default::default();
        for (axis, ticks) in ticks.iter_mut().enumerate() {
            *ticks = self.take::<8>(head.ticks[axis])?.into_iter().map(f64::from_le_bytes).collect();
        }
        let mut corners: [Vec<f64>; 6] = Default::default();
        for (column, values) in corners.iter_mut().enumerate() {
            for index in self.take::<4>(count)? {
                let index = u32::from_le_bytes(index) as usize;
                let tick = ticks[column / 2].get(index).ok_or_else(|| {
                    let expected = format!("a corner below {}", ticks[column / 2].len());
                    SceneError::malformed(self.file, Place::Byte(self.at), expected, index.to_string())
                })?;
                values.push(*tick);
            }
        }
        let [temperature, density, fraction] =
            [self.singles(count)?, self.singles(count)?, self.singles(count)?];
        let fuel = head.fuel_molar_mass_kg_mol.unwrap_or(f64::NAN);
        Ok((0..count)
            .map(|i| {
                let moles_per_kg = fraction[i] / fuel + (1.0 - fraction[i]) / head.carrier_molar_mass_kg_mol;
                GasCell {
                    lower_m: std::array::from_fn(|a| corners[2 * a][i]),
                    upper_m: std::array::from_fn(|a| corners[2 * a + 1][i]),
                    temperature_k: temperature[i],
                    pressure_pa: density[i] * GAS_CONSTANT * temperature[i] * moles_per_kg,
                    density_kg_m3: density[i],
                    fuel_mass_fraction: fraction[i],
                }
            })
            .collect())
    }
}

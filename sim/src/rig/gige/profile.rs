//! Who the camera is: make, detector, names, and with which values it starts.

use super::feature::{Bound, Kind};
use super::presets::{Preset, Sensor};
use ditd_drivers::instrument::Identity;
use std::net::Ipv4Addr;

/// Who the camera is and where.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Profile {
    /// Make.
    pub(super) preset: Preset,
    /// Detector.
    pub(super) sensor: Sensor,
    /// Names.
    pub(super) identity: Identity,
    /// Address on the network.
    pub(super) address: Ipv4Addr,
    /// Port that the stream comes from.
    pub(super) stream_port: u16,
    /// Nanoseconds after switching on until cooler and sensor are ready.
    pub(super) cool_down_ns: u64,
    /// Features that start with another value than the make's: name and register value.
    pub(super) initial: Vec<(String, f64)>,
}

/// A register's bytes for a number; `None` when the feature does not take it.
pub(super) fn encoded(kind: &Kind, value: f64) -> Option<Vec<u8>> {
    if let Kind::Float { .. } = kind {
        return kind.accept(&value.to_be_bytes(), |_| 0).ok();
    }
    let whole = (0.0..=f64::from(u32::MAX)).contains(&value) && value.fract().abs() < f64::EPSILON;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "from 0 to 2^32 − 1, whole")]
    let word = if whole { value as u32 } else { return None };
    // Limits that depend on other registers cannot be checked here; such features are not presettable.
    let free = !matches!(kind, Kind::Integer { max: Bound::Feature(_), .. });
    kind.accept(&word.to_be_bytes(), |_| 0).ok().filter(|_| free && *kind != Kind::Command)
}

impl Profile {
    /// Whether the camera can be made.
    ///
    /// # Errors
    /// Says what is impossible.
    pub(super) fn check(&self) -> Result<(), String> {
        let Sensor { rows, columns, bits, .. } = self.sensor;
        let least_columns = if self.preset == Preset::Telops { 64 } else { 1 };
        if !(1..=16384).contains(&rows) || !(least_columns..=16384).contains(&columns) {
            return Err(format!("{rows} rows × {columns} columns: expected {least_columns} to 16384"));
        }
        let bits_max = if self.preset == Preset::Flir { 14 } else { 16 };
        if !(1..=bits_max).contains(&bits) {
            return Err(format!("bits = {bits}: expected 1 to {bits_max} for this make"));
        }
        let features = self.preset.features(self.sensor);
        for (name, value) in &self.initial {
            let Some(feature) = features.iter().find(|feature| feature.name == name) else {
                return Err(format!("this make has no feature {name:?}"));
            };
            if encoded(&feature.kind, *value).is_none() {
                return Err(format!("{name} cannot start with {value}"));
            }
        }
        Ok(())
    }
}

//! A map as it lies in its folder, for what is made of it afterwards.

use super::super::CommandError;
use crate::estimate::calibration::SakumaHattori;
use crate::files::result;
use serde_json::Value;
use std::collections::HashMap;
use std::path::Path;

/// Planes of `dit.npz`, and the curve that it was made with.
pub(super) struct Fitted {
    pub(super) rows: usize,
    pub(super) columns: usize,
    pub(super) curve: SakumaHattori,
    planes: HashMap<String, Vec<f64>>,
}

impl Fitted {
    /// Reads the map in `out`.
    ///
    /// # Errors
    ///
    /// Status 1 when its files cannot be read.
    pub(super) fn read(out: &Path) -> Result<Self, CommandError> {
        let failed = |why: String| CommandError::failure(format!("fit: {why}"));
        let arrays = result::read_npz(&out.join("dit.npz")).map_err(|error| failed(error.to_string()))?;
        let shape =
            arrays.iter().find(|(name, _)| name == "emissivity").map(|(_, array)| array.shape.clone());
        let Some([rows, columns]) = shape.as_deref() else {
            return Err(failed("dit.npz has no emissivity".into()));
        };
        let (rows, columns) = (*rows, *columns);
        let planes = arrays.into_iter().map(|(name, array)| (name, array.to_f64())).collect();
        Ok(Self { rows, columns, curve: curve(out).map_err(failed)?, planes })
    }

    /// A plane by its name, `[rows · columns]`.
    ///
    /// # Errors
    ///
    /// Status 1 when the map has none of this name.
    pub(super) fn plane(&self, name: &str) -> Result<&[f64], CommandError> {
        let found = self.planes.get(name).filter(|plane| plane.len() == self.rows * self.columns);
        found
            .map(Vec::as_slice)
            .ok_or_else(|| CommandError::failure(format!("fit: dit.npz has no {name} of its size")))
    }
}

/// The curve that the map in `out` was made with, from its summary.
pub(super) fn curve(out: &Path) -> Result<SakumaHattori, String> {
    let path = out.join("summary.json");
    let text = std::fs::read_to_string(&path).map_err(|error| format!("{}: {error}", path.display()))?;
    let summary: Value = serde_json::from_str(&text).map_err(|error| error.to_string())?;
    let curve = summary.pointer("/inputs/curve").or_else(|| summary.pointer("/calibration/curve"));
    let curve = curve.ok_or_else(|| format!("{} names no curve", path.display()))?;
    serde_json::from_value(curve.clone()).map_err(|error| error.to_string())
}

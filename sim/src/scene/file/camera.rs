//! The `[camera]` table.

use super::tables::{CameraKind, CameraTable, FilterKind};
use super::{Reader, SceneError};
use crate::tracer::camera::{Camera, PixelFilter, Projection};

impl Reader<'_> {
    pub(super) fn camera(&self, table: &CameraTable) -> Result<Camera, SceneError> {
        let projection = match (&table.kind, table.horizontal_fov_deg, table.width_m) {
            (CameraKind::Pinhole, Some(horizontal_fov_deg), None) => {
                Projection::Pinhole { horizontal_fov_deg }
            }
            (CameraKind::Telecentric, None, Some(width_m)) => Projection::Telecentric { width_m },
            (CameraKind::Pinhole, ..) => {
                return Err(self.wrong("[camera] kind \"pinhole\" needs horizontal_fov_deg and no width_m"));
            }
            (CameraKind::Telecentric, ..) => {
                return Err(
                    self.wrong("[camera] kind \"telecentric\" needs width_m and no horizontal_fov_deg")
                );
            }
        };
        let pixel_filter = match table.pixel_filter {
            FilterKind::Box => PixelFilter::Box,
            FilterKind::Centre => PixelFilter::Centre,
        };
        let camera = Camera {
            projection,
            position_m: table.position_m,
            look_at_m: table.look_at_m,
            up: table.up,
            columns: table.columns,
            rows: table.rows,
            pixel_filter,
            lens: table.lens.as_ref().map(|lens| self.lens(table, lens, projection)).transpose()?,
        };
        camera.sights().map_err(|e| self.wrong(format!("[camera] {e}")))?;
        Ok(camera)
    }
}

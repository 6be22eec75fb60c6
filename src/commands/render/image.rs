//! Coefficient images: the mean over the exposure, and what is written of it.

use super::collected::{mirror_in, rendered};
use super::columns::Views;
use super::pictures::{Picture, write_pngs};
use super::report::{deposit_stats, optics_stats, report};
use super::{Args, IMAGE_TARGET, count};
use crate::commands::{CommandError, CommandResult};
use ditd_sim::scene::file::Scene;
use ditd_sim::scene::mirror::Mirror;
use ditd_sim::tracer::camera::Camera;
use ditd_sim::tracer::chamber::SIDES;
use std::path::Path;

/// Coefficient images, row-major, as they go into the EXR file.
pub(super) struct Images {
    pub(super) channels: Vec<(String, Vec<f32>)>,
    pub(super) stats: Vec<(String, f64)>,
}

impl Images {
    #[expect(clippy::cast_possible_truncation, reason = "EXR images hold f32")]
    fn scale(&mut self, weight: f64) {
        self.channels.iter_mut().for_each(|(_, v)| v.iter_mut().for_each(|v| *v *= weight as f32));
        self.stats.iter_mut().for_each(|(_, v)| *v *= weight);
    }

    /// Adds a weighted moment; standard errors as if they were fully correlated, which bounds them from above.
    #[expect(clippy::cast_possible_truncation, reason = "EXR images hold f32")]
    fn add(&mut self, other: &Self, weight: f64) -> Result<(), CommandError> {
        let names = |images: &Self| images.channels.iter().map(|c| c.0.clone()).collect::<Vec<_>>();
        if names(self) != names(other) {
            return Err(CommandError::usage(
                "render: the moments of the exposure have different numbers of spectral groups; leave out --groups, or \
                 give [band] samples a number",
            ));
        }
        for ((_, sum), (_, values)) in self.channels.iter_mut().zip(&other.channels) {
            sum.iter_mut().zip(values).for_each(|(s, v)| *s += weight as f32 * v);
        }
        for (name, value) in &mut self.stats {
            if let Some((_, other)) = other.stats.iter().find(|(n, _)| n == name) {
                *value += weight * other;
            }
        }
        Ok(())
    }
}

/// The mean over the moments of the exposure, or of the only one.
pub(super) fn image(scenes: Vec<(f64, Scene)>, pixels_moved: f64, args: &Args) -> CommandResult {
    let count = scenes.len();
    let mut mean: Option<(Images, Vec<Picture>, Camera, Scene)> = None;
    for (weight, scene) in scenes {
        let (images, pictures, camera, scene) = one_image(scene, args)?;
        let Some((sum, shown, ..)) = &mut mean else {
            let scaled = if count > 1 { weight } else { 1.0 };
            let mut first = (images, pictures, camera, scene);
            first.0.scale(scaled);
            first.1.iter_mut().for_each(|p| p.values.iter_mut().for_each(|v| *v *= scaled));
            mean = Some(first);
            continue;
        };
        sum.add(&images, weight)?;
        for (sum, picture) in shown.iter_mut().zip(&pictures) {
            sum.values.iter_mut().zip(&picture.values).for_each(|(s, v)| *s += weight * v);
        }
    }
    let Some((mut images, pictures, camera, scene)) = mean else {
        return Err(CommandError::usage("render: the exposure has no moment"));
    };
    if count > 1 {
        images.stats.push(("exposure_moments".to_owned(), count as f64));
        images.stats.push(("exposure_pixels".to_owned(), pixels_moved));
    }
    if let Some(png) = &args.png {
        write_pngs(png, &camera, &scene, &pictures)?;
    }
    if let Some(out) = &args.out {
        write_exr(out, &camera, &images)
            .map_err(|e| CommandError::failure(format!("render: writing {}: {e}", out.display())))?;
    }
    report(&images, args.json)
}

fn one_image(mut scene: Scene, args: &Args) -> Result<(Images, Vec<Picture>, Camera, Scene), CommandError> {
    let temperatures_k = plate_temperatures(&mut scene, args)?;
    let camera = camera_of(&scene)?;
    let target = args.target_error.unwrap_or(IMAGE_TARGET);
    let plate = scene.plate.as_ref().map(|p| &p.shape);
    let walls = scene.surroundings(&temperatures_k);
    let mut collected = rendered(&scene, &camera, walls, plate, target, args)?;
    let mut stats = std::mem::take(&mut collected.stats);
    if let Some(mirror) = Mirror::of(&scene) {
        let (back, more) = (mirror.camera(&camera), mirror.opening_of(&camera));
        let alike = walls.together();
        let mirrored = rendered(&scene, &back, alike, more.as_ref(), mirror.target(target), args)?;
        stats.extend(mirrored.stats.into_iter().map(|(name, value)| (format!("mirrored_{name}"), value)));
        for (pixel, shares) in collected.shares.iter_mut().enumerate() {
            // In the mirror left is right.
            let (row, column) = (pixel / camera.columns, pixel % camera.columns);
            let there = &mirrored.shares[row * camera.columns + camera.columns - 1 - column];
            mirror_in(shares, there);
        }
    }
    if scene.chamber.is_some() {
        // Walls that all shine alike are one.
        let skipped = if walls.apart().is_some() { 0 } else { SIDES };
        stats.push(("skipped_walls".to_owned(), count(skipped)));
    }
    stats.extend(scene.optics.iter().flat_map(optics_stats));
    stats.extend(scene.deposit.iter().flat_map(deposit_stats));
    let views = Views::new(&mut scene, &temperatures_k, args, walls)?;
    let (channels, pictures) = views.images(&collected);
    Ok((Images { channels, stats }, pictures, camera, scene))
}

pub(super) fn camera_of(scene: &Scene) -> Result<Camera, CommandError> {
    let camera = scene
        .camera
        .clone()
        .ok_or_else(|| CommandError::usage("render: the scene has no [camera]; add one or use --rays"))?;
    if camera.rows == 0 || camera.columns == 0 {
        return Err(CommandError::usage("render: the camera has no pixels"));
    }
    Ok(camera)
}

/// The plate temperatures of which images are wanted: those of the command, else of the scene.
pub(super) fn plate_temperatures(scene: &mut Scene, args: &Args) -> Result<Vec<f64>, CommandError> {
    let Some(plate) = &mut scene.plate else {
        if args.plate_temperatures.is_empty() {
            return Ok(Vec::new());
        }
        return Err(CommandError::usage("render: --plate-temperatures needs a scene with a [plate]"));
    };
    if args.plate_temperatures.is_empty() {
        return Ok(plate.temperatures_k.clone());
    }
    if let Some(bad) = args.plate_temperatures.iter().find(|t| !(t.is_finite() && **t >= 0.0)) {
        return Err(CommandError::usage(format!(
            "render: --plate-temperatures holds {bad}; each must be finite and not negative"
        )));
    }
    // Coefficients of a band are weighted with the plate's light: without a temperature of its own, the first one's.
    plate.temperature_k = plate.temperature_k.or(args.plate_temperatures.first().copied());
    Ok(args.plate_temperatures.clone())
}

pub(super) fn write_exr(path: &Path, camera: &Camera, images: &Images) -> exr::error::UnitResult {
    use exr::prelude::*;
    let list: SmallVec<[AnyChannel<FlatSamples>; 4]> = images
        .channels
        .iter()
        .map(|(name, values)| AnyChannel::new(name.as_str(), FlatSamples::F32(values.clone())))
        .collect();
    let encoding = Encoding { line_order: LineOrder::Increasing, ..Encoding::SMALL_LOSSLESS };
    let layer = Layer::new(
        (camera.columns, camera.rows),
        LayerAttributes::default(),
        encoding,
        AnyChannels::sort(list),
    );
    Image::from_layer(layer).write().to_file(path)
}

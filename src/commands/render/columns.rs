//! The columns of a table of rays and the channels of an image, from what the sights collect.

use super::Args;
use super::collected::Collected;
use super::pictures::{Picture, kelvin_name};
use crate::commands::CommandError;
use ditd_sim::scene::file::{MediumSource, Scene};
use ditd_sim::scene::lights::{EndShares, Lights, Share};
use ditd_sim::tracer::chamber::{ENDS, OUTSIDE, SIDE_NAMES, Walls};

/// Names and values of what is printed or written of each sight.
pub(super) struct Columns {
    lights: Lights,
    windows: bool,
    /// Whether the walls of a chamber are told apart.
    apart: bool,
    uneven: bool,
    /// Spectral groups to list.
    groups: usize,
}

impl Columns {
    pub(super) fn new(scene: &Scene, list_groups: bool, apart: bool) -> Self {
        let groups = match &scene.medium {
            Some(MediumSource::Spectral(grid, _)) => grid.groups,
            _ => 1,
        };
        Self {
            lights: Lights::new(scene),
            windows: scene.windows.any(),
            apart,
            uneven: scene.plate.as_ref().is_some_and(|p| p.deviation.is_some()),
            groups: if list_groups { groups } else { 0 },
        }
    }

    pub(super) fn names(&self) -> Vec<String> {
        let mut names: Vec<String> =
            ["a_plate", "a_walls", "a_medium", "se_plate", "se_walls", "se_medium"].map(String::from).into();
        let extra = ["a_window", "a_camera_side"];
        if self.windows {
            names.extend([extra[0], extra[1], "se_window"].map(String::from));
        }
        if self.uneven {
            names.push("plate_excess_k".to_owned());
        }
        let ends = || (0..if self.apart { ENDS } else { 0 }).map(end_name);
        if self.apart {
            names.extend(ends());
            names.push("se_wall".to_owned());
        }
        for g in 0..self.groups {
            names.extend(["a_plate", "a_walls", "a_medium"].map(|n| format!("{n}_g{g:02}")));
            names.extend(ends().map(|n| format!("{n}_g{g:02}")));
            if self.windows {
                names.extend(extra.map(|n| format!("{n}_g{g:02}")));
            }
        }
        names.extend(["radiance", "radiance_medium", "se_radiance"].map(String::from));
        names
    }

    pub(super) fn values(&self, (shares, ends): (&[Share], Option<&EndShares>)) -> Vec<f64> {
        let (seen, by_end) = match ends {
            Some(ends) => self.lights.see_apart(shares, ends),
            None => (self.lights.see(shares), [0.0; ENDS]),
        };
        let [se_plate, se_walls, se_medium, se_window] = seen.se;
        let mut values = vec![seen.plate, seen.walls, seen.medium, se_plate, se_walls, se_medium];
        if self.windows {
            values.extend([seen.window, seen.camera_side, se_window]);
        }
        if self.uneven {
            values.push(seen.plate_excess_k);
        }
        if let Some(ends) = ends {
            values.extend(by_end);
            values.push(ends.se.iter().copied().fold(0.0, f64::max));
        }
        for g in 0..self.groups {
            let seen = self.lights.see_group(shares, g);
            values.extend([seen.plate, seen.walls, seen.medium]);
            values.extend(ends.iter().flat_map(|ends| self.lights.ends_of_group(shares, ends, g)));
            if self.windows {
                values.extend([seen.window, seen.camera_side]);
            }
        }
        values.extend([seen.radiance, seen.radiance_medium, seen.se_radiance]);
        values
    }
}

/// The column or channel of a wall, or of the place outside.
fn end_name(end: usize) -> String {
    if end == OUTSIDE { "a_outside".to_owned() } else { format!("a_wall_{}", SIDE_NAMES[end]) }
}

/// What is made of the shares of all pixels: coefficients, and images at the plate's temperatures. Transport is linear, so
/// that those enter only here.
pub(super) struct Views {
    columns: Columns,
    at_plate: Vec<(f64, Lights)>,
}

impl Views {
    pub(super) fn new(
        scene: &mut Scene,
        temperatures_k: &[f64],
        args: &Args,
        walls: Walls,
    ) -> Result<Self, CommandError> {
        let columns = Columns::new(scene, args.groups, walls.apart().is_some());
        let mut at_plate = Vec::new();
        for &kelvin in temperatures_k {
            if let Some(plate) = &mut scene.plate {
                plate.temperature_k = Some(kelvin);
            }
            let lights = Lights::new(scene);
            if !lights.lit() {
                return Err(CommandError::usage(
                    "render: images at plate temperatures need [band], and temperatures of [walls] and [medium]",
                ));
            }
            at_plate.push((kelvin, lights));
        }
        Ok(Self { columns, at_plate })
    }

    /// Channels of an image file, and radiances to be shown.
    pub(super) fn images(&self, collected: &Collected) -> (Vec<(String, Vec<f32>)>, Vec<Picture>) {
        let mut channels = channels(&self.columns, collected);
        let lights = &self.columns.lights;
        if self.at_plate.is_empty() && lights.lit() {
            return (channels, vec![Picture { name: None, values: radiance(lights, collected) }]);
        }
        let mut pictures = Vec::new();
        for (kelvin, lights) in &self.at_plate {
            let values = radiance(lights, collected);
            #[expect(clippy::cast_possible_truncation, reason = "EXR images hold f32")]
            let single = values.iter().map(|&v| v as f32).collect();
            channels.push((format!("radiance_plate_{}", kelvin_name(*kelvin)), single));
            pictures.push(Picture { name: Some(*kelvin), values });
        }
        (channels, pictures)
    }
}

#[expect(clippy::cast_possible_truncation, reason = "EXR images hold f32")]
fn channels(columns: &Columns, collected: &Collected) -> Vec<(String, Vec<f32>)> {
    let pixels = collected.shares.len();
    let mut channels: Vec<(String, Vec<f32>)> =
        columns.names().into_iter().map(|name| (name, Vec::with_capacity(pixels))).collect();
    for pixel in 0..pixels {
        for (channel, value) in channels.iter_mut().zip(columns.values(collected.of(pixel))) {
            channel.1.push(value as f32);
        }
    }
    // Radiances of a scene that does not give all temperatures.
    if !columns.lights.lit() {
        channels.truncate(channels.len() - 3);
    }
    channels
}

fn radiance(lights: &Lights, collected: &Collected) -> Vec<f64> {
    (0..collected.shares.len())
        .map(|sight| match collected.of(sight) {
            (shares, Some(ends)) => lights.see_apart(shares, ends).0.radiance,
            (shares, None) => lights.see(shares).radiance,
        })
        .collect()
}

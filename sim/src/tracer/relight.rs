//! An operator at given temperatures: a few products per pixel, no ray.
//!
//! In the shifted form I = L_walls + a_plate (L_plate − L_walls) + (emission − a_medium L_walls) contrasts are linear
//! whatever their size, and an enclosure at one temperature is exactly uniform (the shift method of Soucasse et al., J.
//! Quant. Spectrosc. Radiat. Transfer 113, 2012).

use super::chamber::ENDS;
use super::error::TracerError;
use super::operator::Operator;
use rayon::prelude::*;

/// Pixels of one parallel task.
const TASK_PIXELS: usize = 1 << 13;

/// What shines, per spectral group in any unit of radiance (times the weight of the group, where groups are summed).
#[derive(Debug, Clone, PartialEq)]
pub struct Lighting {
    /// Radiance that leaves the plate, `[group]`.
    pub plate: Vec<f64>,
    /// Radiance that leaves the walls, `[group]`.
    pub walls: Vec<f64>,
    /// Radiances that leave the walls one by one, and of the place outside, `[end · groups + group]`; empty where they all
    /// shine as `walls` says. Else any `walls` gives the same image; near their mean, it is rounded least.
    pub ends: Vec<f64>,
    /// The channel that holds the medium's emission.
    pub channel: usize,
    /// What one of that channel's units shines, `[group]`: the radiance of the medium for channel 0.
    pub medium: Vec<f64>,
}

impl Operator {
    /// The image under some lighting, summed over the groups: row-major into `image`, in the unit of the lighting.
    ///
    /// Returns the number of pixels whose coefficients were read: none when plate, walls and medium shine alike.
    ///
    /// # Errors
    ///
    /// [`TracerError::Shape`] for a lighting or an image that does not fit the operator.
    pub fn relight(&self, light: &Lighting, image: &mut [f32]) -> Result<usize, TracerError> {
        let fits = |what, found, expected| {
            if found == expected { Ok(()) } else { Err(TracerError::Shape { what, found, expected }) }
        };
        fits("image", image.len(), self.plate_seen.len())?;
        for (what, list) in [("plate", &light.plate), ("walls", &light.walls), ("medium", &light.medium)] {
            fits(what, list.len(), self.groups)?;
        }
        if !light.ends.is_empty() {
            fits("walls one by one", light.ends.len(), ENDS * self.groups)?;
            fits("shares of the walls", self.ends_seen.len(), ENDS * self.plate_seen.len())?;
        }
        if light.channel >= self.channels {
            return Err(TracerError::Geometry { what: "the channel", condition: "one of the operator's" });
        }
        let walls: f64 = light.walls.iter().sum();
        let contrast: Vec<f64> = light.plate.iter().zip(&light.walls).map(|(p, w)| p - w).collect();
        let dark = contrast.iter().all(|c| *c == 0.0);
        let ends = self.end_contrasts(light);
        let alike = dark && light.channel == 0 && light.medium == light.walls && ends.is_empty();
        if alike {
            image.fill(narrow(walls));
            return Ok(0);
        }
        let plate: f64 = contrast.iter().sum();
        image.par_chunks_mut(TASK_PIXELS).enumerate().for_each(|(task, image)| {
            let start = task * TASK_PIXELS;
            for (out, &seen) in image.iter_mut().zip(&self.plate_seen[start..]) {
                *out = narrow(walls + f64::from(seen) * plate);
            }
            let at = |pixel: usize| self.pixels.partition_point(|&p| (p as usize) < pixel);
            let active = at(start)..at(start + image.len());
            if self.groups == 1 {
                self.one_group(light, contrast[0], active.clone(), start, image);
            } else {
                self.groups(light, &contrast, walls, active.clone(), start, image);
            }
            if !ends.is_empty() {
                self.ends(&ends, active, start, image);
            }
        });
        Ok(self.pixels.len())
    }

    /// What the walls shine more than `walls` says, `[end · groups + group]`; nothing where none differs.
    fn end_contrasts(&self, light: &Lighting) -> Vec<f64> {
        let contrasts: Vec<f64> =
            light.ends.iter().zip(light.walls.iter().cycle()).map(|(end, walls)| end - walls).collect();
        if contrasts.iter().all(|c| *c == 0.0) { Vec::new() } else { contrasts }
    }

    /// Adds the walls' contrasts to an image.
    fn ends(&self, contrasts: &[f64], active: std::ops::Range<usize>, start: usize, image: &mut [f32]) {
        let sum = |shares: &[f32], light: &[f64]| -> f64 {
            shares.iter().zip(light).map(|(share, light)| f64::from(*share) * light).sum()
        };
        let whole: Vec<f64> = contrasts.chunks_exact(self.groups).map(|groups| groups.iter().sum()).collect();
        let mut active = active.peekable();
        let seen = self.ends_seen[start * ENDS..].chunks_exact(ENDS);
        for ((pixel, out), seen) in (start..).zip(image).zip(seen) {
            let width = ENDS * self.groups;
            let more = match active.next_if(|&i| self.pixels[i] as usize == pixel) {
                Some(i) => sum(&self.a_ends[i * width..(i + 1) * width], contrasts),
                None => sum(seen, &whole),
            };
            *out = narrow(f64::from(*out) + more);
        }
    }

    fn one_group(
        &self,
        light: &Lighting,
        contrast: f64,
        active: std::ops::Range<usize>,
        start: usize,
        image: &mut [f32],
    ) {
        let (walls, medium, channels) = (light.walls[0], light.medium[0], self.channels);
        for i in active {
            let own = f64::from(self.emission[i * channels]);
            let emitted = if light.channel == 0 {
                own * (medium - walls)
            } else {
                f64::from(self.emission[i * channels + light.channel]) * medium - own * walls
            };
            let value = walls + f64::from(self.a_plate[i]) * contrast + emitted;
            image[self.pixels[i] as usize - start] = narrow(value);
        }
    }

    fn groups(
        &self,
        light: &Lighting,
        contrast: &[f64],
        walls: f64,
        active: std::ops::Range<usize>,
        start: usize,
        image: &mut [f32],
    ) {
        let groups = self.groups;
        for i in active {
            let plate = &self.a_plate[i * groups..(i + 1) * groups];
            let row = |channel: usize| {
                let first = (i * self.channels + channel) * groups;
                &self.emission[first..first + groups]
            };
            let (own, other) = (row(0), row(light.channel));
            let mut value = walls;
            for g in 0..groups {
                let emitted = if light.channel == 0 {
                    f64::from(own[g]) * (light.medium[g] - light.walls[g])
                } else {
                    f64::from(other[g]) * light.medium[g] - f64::from(own[g]) * light.walls[g]
                };
                value += f64::from(plate[g]) * contrast[g] + emitted;
            }
            image[self.pixels[i] as usize - start] = narrow(value);
        }
    }
}

#[expect(clippy::cast_possible_truncation, reason = "images hold f32")]
fn narrow(value: f64) -> f32 {
    value as f32
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "exact numbers")]
mod tests {
    use super::*;

    /// Two groups, two channels, one of three pixels active.
    fn operator() -> Operator {
        Operator {
            rows: 1,
            columns: 3,
            groups: 2,
            channels: 2,
            plate_seen: vec![1.0, 1.0, 0.25],
            pixels: vec![1],
            a_plate: vec![0.5, 0.25],
            emission: vec![0.25, 0.5, 300.0, 700.0],
            ..Operator::default()
        }
    }

    fn lighting(plate: [f64; 2], walls: [f64; 2], channel: usize, medium: [f64; 2]) -> Lighting {
        Lighting {
            plate: plate.into(),
            walls: walls.into(),
            ends: Vec::new(),
            channel,
            medium: medium.into(),
        }
    }

    #[test]
    fn every_share_gets_its_radiance() {
        let mut image = [0.0; 3];
        let light = lighting([10.0, 20.0], [1.0, 2.0], 0, [4.0, 8.0]);
        assert_eq!(operator().relight(&light, &mut image), Ok(1));
        // Walls are what is left: 0.25 in both groups.
        let middle = 0.5 * 10.0 + 0.25 * 20.0 + 0.25 * 1.0 + 0.25 * 2.0 + 0.25 * 4.0 + 0.5 * 8.0;
        assert_eq!(image, [30.0, middle, 0.25 * 30.0 + 0.75 * 3.0]);
        let light = lighting([10.0, 20.0], [1.0, 2.0], 1, [0.5, 2.0]);
        assert_eq!(operator().relight(&light, &mut image), Ok(1));
        let middle = 0.5 * 10.0 + 0.25 * 20.0 + 0.25 * 1.0 + 0.25 * 2.0 + 150.0 + 1400.0;
        assert_eq!(image[1], middle);
    }

    #[test]
    fn an_enclosure_at_one_temperature_reads_no_coefficient_and_is_uniform() {
        let mut image = [0.0; 3];
        let light = lighting([7.0, 0.1], [7.0, 0.1], 0, [7.0, 0.1]);
        assert_eq!(operator().relight(&light, &mut image), Ok(0));
        assert_eq!(image, [7.1; 3]);
        // A plate 1e-9 hotter: the contrast is linear, not the difference of two large numbers.
        let mut operator = operator();
        (operator.groups, operator.channels) = (1, 1);
        (operator.a_plate, operator.emission) = (vec![0.5], vec![0.25]);
        let mut one = |excess: f64| {
            let ends = Vec::new();
            let light =
                Lighting { plate: vec![excess], walls: vec![0.0], ends, channel: 0, medium: vec![0.0] };
            operator.relight(&light, &mut image).unwrap();
            image[1]
        };
        assert_eq!(one(2e-9), 2.0 * one(1e-9));
    }

    #[test]
    fn walls_that_are_told_apart_get_their_own_light() {
        let mut operator = operator();
        operator.ends_seen = vec![0.0; 3 * ENDS];
        // The first pixel sees the plate, the third wall 2 beside it.
        operator.ends_seen[2 * ENDS + 2] = 0.75;
        operator.a_ends = vec![0.0; ENDS * 2];
        // Closure: 0.25 in both groups, from walls 1 and 2.
        for (place, share) in [(2, 0.125), (3, 0.25), (4, 0.125)] {
            operator.a_ends[place] = share;
        }
        let mut light = lighting([10.0, 20.0], [1.0, 2.0], 0, [4.0, 8.0]);
        light.ends =
            [[1.0, 2.0], [3.0, 5.0], [7.0, 11.0], [1.0, 2.0], [1.0, 2.0], [1.0, 2.0], [1.0, 2.0]].concat();
        let mut image = [0.0; 3];
        assert_eq!(operator.relight(&light, &mut image), Ok(1));
        let walls = 0.125 * 3.0 + 0.25 * 5.0 + 0.125 * 7.0;
        let middle = 0.5 * 10.0 + 0.25 * 20.0 + walls + 0.25 * 4.0 + 0.5 * 8.0;
        assert_eq!(image, [30.0, middle, 0.25 * 30.0 + 0.75 * 18.0]);
        // All alike: nothing is read.
        let mut light = lighting([7.0, 0.5], [7.0, 0.5], 0, [7.0, 0.5]);
        light.ends = [7.0, 0.5].repeat(ENDS);
        assert_eq!(operator.relight(&light, &mut image), Ok(0));
        operator.ends_seen.clear();
        assert!(matches!(operator.relight(&light, &mut image), Err(TracerError::Shape { .. })));
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let light = lighting([1.0; 2], [1.0; 2], 2, [1.0; 2]);
        assert!(matches!(operator().relight(&light, &mut [0.0; 3]), Err(TracerError::Geometry { .. })));
        assert!(matches!(operator().relight(&light, &mut [0.0; 2]), Err(TracerError::Shape { .. })));
    }
}

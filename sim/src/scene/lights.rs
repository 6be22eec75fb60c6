//! From coefficients per spectral group inside the chamber to what the camera sees: through windows, over a band, lit.
//!
//! Everything is linear, so sums over groups are exact. Each coefficient of a band is weighted with response × B(λ, T)
//! of its own source: then coefficient × band radiance of the source is its light. Within a group all coefficients sum
//! to 1; over a band they do so when the medium is gray or all temperatures are equal. Traces nothing.
//!
//! Windows (one on either side, all sights of a side cross it):
//!
//! - near: a_* × T_n, a_window += A_n, a_camera_side += R_n (the laboratory, mirrored);
//! - far: a_plate × T_f, a_walls += a_plate · R_f (the chamber, mirrored), a_window += a_plate · A_f.
//!
//! Where the far window mirrors the chamber, what it mirrors has coefficients a', m', w' of its own (`mirror`): medium and
//! walls get a_plate · R_f · m' and a_plate · R_f · w'; a_plate · R_f · a' ends at the near window, which is T_n laboratory,
//! A_n itself, and R_n times the first sight again: all is divided by 1 − a_plate · a' · R_f · R_n. Exact for windows that
//! are parallel and met head on; that the second round trip sees what the first did errs by (R_f R_n)² at most where
//! they are not.
//!
//! An uneven plate shines like one of the mean temperature that a sight sees, T + δ, and half the variance of δ times
//! B'': exact where a sight sees one place, to the third moment of δ where it sees many.

use super::enclosure::{BEYOND, Enclosure, PLATE, SOURCES};
use super::file::{ChamberSource, MediumSource, PlateMirrors, Scene, WindowSource};
use crate::light::band::Band;
use crate::light::planck::{d_photon_radiance_dt, inverse_photon_radiance, photon_radiance};
use crate::light::window::PlateOptics;
use crate::tracer::chamber::{ENDS, SIDES};
use crate::tracer::medium::GridMedium;
use crate::tracer::plate::Plate;

/// What one sight collects inside the chamber in one spectral group.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Share {
    /// Share of the plate.
    pub plate: f64,
    /// Share of the walls.
    pub walls: f64,
    /// Share of the medium.
    pub medium: f64,
    /// Radiance of the medium by its own temperatures, in the unit of the medium's second channel; 0 without one.
    pub emission: f64,
    /// Standard errors of plate, walls and medium.
    pub se: [f64; 3],
    /// The plate's share times the deviation of its temperature in K, and times its square; 0 for an even plate.
    pub excess: [f64; 2],
    /// What the far window mirrors of the chamber; none: walls.
    pub mirrored: Option<Mirrored>,
}

/// What the sight that a far window mirrors collects on its way back, in one spectral group.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Mirrored {
    /// Share of the near window's opening.
    pub opening: f64,
    /// Share of the medium; what is left is that of the walls.
    pub medium: f64,
    /// As [`Share::emission`].
    pub emission: f64,
    /// Standard error of the share of the medium.
    pub se: f64,
}

/// What one sight collects from each wall of a chamber and from the place outside, ordered as
/// [`crate::tracer::chamber::ENDS`] says.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct EndShares {
    /// Shares per spectral group; those of a group sum to its [`Share::walls`].
    pub shares: Vec<[f64; ENDS]>,
    /// Standard errors.
    pub se: [f64; ENDS],
}

/// What the camera sees along one sight. Radiances are NaN where band or temperatures are not given.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Seen {
    /// Coefficient of the plate.
    pub plate: f64,
    /// Coefficient of the walls.
    pub walls: f64,
    /// Coefficient of the medium.
    pub medium: f64,
    /// Coefficient of the windows' own light.
    pub window: f64,
    /// Coefficient of the laboratory on the camera's side.
    pub camera_side: f64,
    /// Standard errors of plate, walls, medium and window.
    pub se: [f64; 4],
    /// Radiance: photons s⁻¹ m⁻² sr⁻¹ µm⁻¹ at one wavelength, its integral over a response.
    pub radiance: f64,
    /// Coefficient of the plate times the mean deviation of its temperature that is seen, in K.
    pub plate_excess_k: f64,
    /// The part of it that the medium emits.
    pub radiance_medium: f64,
    /// Standard error of the radiance.
    pub se_radiance: f64,
}

/// How the medium shines.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Glow {
    /// At one temperature.
    Temperature(f64),
    /// By its second channel, already integrated over the band.
    BandChannel,
    /// By its second channel, per µm in each group.
    GroupChannel,
}

/// One wavelength of the band.
#[derive(Debug, Clone, Copy)]
struct Sample {
    /// Response × Δλ.
    weight: f64,
    near: PlateOptics,
    far: PlateOptics,
    /// Normalised weights of plate, walls, medium, near window, far window and laboratory.
    share: [f64; 6],
    /// Radiances per µm of plate (with what it mirrors), walls, medium, near window, far window, laboratory.
    radiance: [f64; 6],
    um: f64,
    /// Of the plate.
    emissivity: f64,
}

/// The walls of a chamber at one wavelength.
#[derive(Debug, Clone, Copy)]
struct EndSample {
    /// Radiances per µm that leave the walls, and of the place outside.
    radiance: [f64; ENDS],
    /// Normalised weights.
    share: [f64; ENDS],
}

/// The light of a scene's band, temperatures and windows.
#[derive(Debug, Clone)]
pub struct Lights {
    samples: Vec<Sample>,
    /// The walls one by one, and the wall that a far window mirrors; none without a chamber.
    ends: Option<(Vec<EndSample>, usize)>,
    glow: Glow,
    lit: bool,
    plate_k: Option<f64>,
}

/// A window that is not there.
const OPENING: PlateOptics = PlateOptics { transmittance: 1.0, reflectance: 0.0, absorptance: 0.0 };

impl Lights {
    /// The lights of a scene whose spray is imported.
    pub fn new(scene: &Scene) -> Self {
        let band = match (&scene.medium, &scene.band) {
            (Some(MediumSource::Spectral(_, band)), _) => band.clone(),
            (_, Some(source)) => source.nodes(),
            (_, None) => Band::monochromatic(1.0),
        };
        let windows = &scene.windows;
        let walls_k = scene.walls.map(|w| w.temperature_k);
        let plate_k = scene.plate.as_ref().and_then(|p| p.temperature_k);
        // Behind a far window the plate stands in the laboratory, else in the chamber, and mirrors it.
        let laboratory = match scene.plate.as_ref().and_then(|p| p.mirrors) {
            Some(mirrors) => mirrors == PlateMirrors::Laboratory,
            None => windows.far.is_some(),
        };
        let mirrored_k = if laboratory { windows.lab_temperature_k } else { walls_k };
        let (glow, medium_k) = glow(scene);
        let temperatures = [
            plate_k,
            walls_k,
            medium_k,
            windows.near.as_ref().map(|w| w.temperature_k),
            windows.far.as_ref().map(|w| w.temperature_k),
            windows.lab_temperature_k,
        ];
        let spectral = scene.band.is_some();
        let at = |um: f64, t: Option<f64>| t.map_or(0.0, |t| photon_radiance(um, t));
        let optics = |window: Option<&WindowSource>, um: f64| {
            window.map_or(OPENING, |w| w.plate.optics(um, w.temperature_k))
        };
        let mut samples: Vec<Sample> = band
            .wavelengths_um
            .iter()
            .zip(&band.weights)
            .map(|(&um, &weight)| {
                let mut radiance = temperatures.map(|t| at(um, t));
                let emissivity = scene.plate.as_ref().map_or(1.0, |p| p.emissivity.at(um));
                radiance[0] = emissivity * radiance[0] + (1.0 - emissivity) * at(um, mirrored_k);
                // Without a temperature of its own a coefficient is weighted with the response alone.
                let share = temperatures.map(|t| match t {
                    Some(t) if spectral && t > 0.0 => weight * photon_radiance(um, t),
                    _ => weight,
                });
                let [near, far] = [&windows.near, &windows.far].map(|w| optics(w.as_ref(), um));
                Sample { weight, near, far, share, radiance, um, emissivity }
            })
            .collect();
        let ends = scene.chamber.as_ref().map(|chamber| ends(scene, chamber, &band, &mut samples));
        for k in 0..6 {
            let sum: f64 = samples.iter().map(|s| s.share[k]).sum();
            let response: f64 = samples.iter().map(|s| s.weight).sum();
            for s in &mut samples {
                // So cold that B underflows everywhere: the response alone.
                s.share[k] = if sum > 0.0 { s.share[k] / sum } else { s.weight / response };
            }
        }
        let lit = spectral
            && walls_k.is_some()
            && (scene.plate.is_none() || plate_k.is_some())
            && match &scene.medium {
                Some(MediumSource::Shape(_, t)) => t.is_some(),
                Some(MediumSource::Grid(_, hot)) => *hot,
                Some(MediumSource::Cfd(_) | MediumSource::Parametric(_)) => false,
                Some(MediumSource::Spectral(..)) | None => true,
            };
        Self { samples, ends, glow, lit, plate_k }
    }

    /// Whether radiances are known.
    pub fn lit(&self) -> bool {
        self.lit
    }

    /// What is seen of a sight with one share per spectral group, or a single one of a gray medium.
    ///
    /// Errors of different groups are taken as fully correlated, which bounds the error from above.
    pub fn see(&self, shares: &[Share]) -> Seen {
        assert!(
            shares.len() == 1 || shares.len() == self.samples.len(),
            "one share, or one per sample of the band"
        );
        let mut seen = self.sum(shares, &self.samples);
        if !self.lit {
            seen.radiance = f64::NAN;
            seen.radiance_medium = f64::NAN;
            seen.se_radiance = f64::NAN;
        }
        seen
    }

    /// The same where the walls of a chamber are told apart, with the coefficients of the walls and of the place outside,
    /// whose sum is that of the walls.
    ///
    /// Each is weighted over the band with the light that leaves its wall, what it mirrors included. A far window mirrors
    /// the wall opposite the plate.
    pub fn see_apart(&self, shares: &[Share], ends: &EndShares) -> (Seen, [f64; ENDS]) {
        let mut seen = self.see(shares);
        let Some((lights, opposite)) = &self.ends else { return (seen, [0.0; ENDS]) };
        assert_eq!(shares.len(), ends.shares.len(), "shares of the walls for every share");
        let (mut by_end, mut contrast, mut radiance) = ([0.0; ENDS], [0.0; ENDS], 0.0);
        for (g, (sample, light)) in self.samples.iter().zip(lights).enumerate() {
            let place = g.min(shares.len() - 1);
            let back = Back::of(&shares[place], &sample.far, &sample.near);
            let through = sample.near.transmittance * back.again;
            for end in 0..ENDS {
                let mirrored = if end == *opposite {
                    sample.far.reflectance * shares[place].plate * back.walls
                } else {
                    0.0
                };
                let share = through * (ends.shares[place][end] + mirrored);
                let more = sample.weight * (light.radiance[end] - sample.radiance[1]);
                by_end[end] += light.share[end] * share;
                contrast[end] += through * more;
                radiance += share * more;
            }
        }
        seen.walls = by_end.iter().sum();
        seen.radiance += radiance;
        let error: f64 = contrast.iter().zip(&ends.se).map(|(c, se)| (c * se).powi(2)).sum();
        seen.se_radiance = seen.se_radiance.hypot(error.sqrt());
        (seen, by_end)
    }

    /// Coefficients of the walls and of the place outside in one spectral group; of a gray medium those of the band.
    pub fn ends_of_group(&self, shares: &[Share], ends: &EndShares, group: usize) -> [f64; ENDS] {
        let (Some((_, opposite)), true) = (&self.ends, shares.len() > 1) else {
            return self.see_apart(shares, ends).1;
        };
        let Sample { near, far, .. } = &self.samples[group];
        let back = Back::of(&shares[group], far, near);
        let through = near.transmittance * back.again;
        let mut by_end = ends.shares[group].map(|share| through * share);
        by_end[*opposite] += through * far.reflectance * shares[group].plate * back.walls;
        by_end
    }

    /// Coefficients of one spectral group, its own sum being 1; of a gray medium those of the band.
    pub fn see_group(&self, shares: &[Share], group: usize) -> Seen {
        if shares.len() == 1 {
            return self.see(shares);
        }
        let sample = Sample { share: [1.0; 6], ..self.samples[group] };
        self.sum(&shares[group..=group], &[sample])
    }

    fn sum(&self, shares: &[Share], samples: &[Sample]) -> Seen {
        let mut seen = Seen::default();
        // Change of the radiance with plate and medium of each share, the walls giving way.
        let mut contrasts = vec![[0.0; 2]; shares.len()];
        let (mut through_mean, mut mirrored_mean) = (0.0, 0.0);
        for (g, sample) in samples.iter().enumerate() {
            let place = g.min(shares.len() - 1);
            let share = &shares[place];
            let Sample { weight, near, far, share: [wp, ww, wm, wn, wf, wl], radiance, .. } = *sample;
            let [lp, lw, lm, ln, lf, ll] = radiance;
            let back = Back::of(share, &far, &near);
            let through = near.transmittance * back.again;
            through_mean += wm * through;
            mirrored_mean += wm * through * far.reflectance;
            let plate = through * far.transmittance;
            let behind = through * far.absorptance;
            // What the far window mirrors of the near one: laboratory and window.
            let returned = through * far.reflectance * share.plate * back.opening;
            seen.plate += wp * plate * share.plate;
            seen.plate_excess_k += wp * plate * share.excess[0];
            seen.walls += ww * through * (share.walls + far.reflectance * share.plate * back.walls);
            seen.medium += wm * through * (share.medium + far.reflectance * share.plate * back.medium);
            seen.window += wf * behind * share.plate + wn * (near.absorptance + returned * near.absorptance);
            seen.camera_side += wl * (near.reflectance + returned * near.transmittance);
            let [sp, sw, sm] = share.se;
            let covariance = 0.5 * (sm * sm - sp * sp - sw * sw);
            let mirrored = sw * sw + (far.reflectance * sp).powi(2) + 2.0 * far.reflectance * covariance;
            seen.se[0] += wp * plate * sp;
            seen.se[1] += ww * through * (mirrored.max(0.0).sqrt() + far.reflectance * share.plate * back.se);
            seen.se[2] += wm * through * (sm + far.reflectance * share.plate * back.se);
            seen.se[3] += wf * behind * sp;
            let medium = match self.glow {
                Glow::Temperature(_) => {
                    weight * through * (share.medium + far.reflectance * share.plate * back.medium) * lm
                }
                Glow::GroupChannel => {
                    weight * through * (share.emission + far.reflectance * share.plate * back.emission)
                }
                Glow::BandChannel => 0.0,
            };
            seen.radiance_medium += medium;
            seen.radiance += weight
                * (plate * share.plate * lp
                    + through * (share.walls + far.reflectance * share.plate * back.walls) * lw
                    + behind * share.plate * lf
                    + near.absorptance * ln
                    + near.reflectance * ll);
            // Apart, so that nothing changes where there is nothing of it.
            if share.mirrored.is_some() {
                seen.radiance += weight * returned * (near.absorptance * ln + near.transmittance * ll);
            }
            if share.excess.iter().any(|e| *e != 0.0) && share.plate > 0.0 {
                seen.radiance += weight * plate * sample.excess(share, self.plate_k);
            }
            let own = match self.glow {
                Glow::GroupChannel if share.medium > 0.0 => share.emission / share.medium,
                _ => lm,
            };
            contrasts[place][0] +=
                weight * (plate * lp + through * (far.reflectance * back.walls - 1.0) * lw + behind * lf);
            if share.mirrored.is_some() {
                let window = back.opening * (near.absorptance * ln + near.transmittance * ll);
                contrasts[place][0] += weight * through * far.reflectance * (back.medium * own + window);
            }
            contrasts[place][1] += weight * through * (own - lw);
        }
        if self.glow == Glow::BandChannel {
            seen.radiance_medium = through_mean * shares[0].emission;
            if let Some(back) = shares[0].mirrored {
                seen.radiance_medium += mirrored_mean * shares[0].plate * back.emission;
            }
        }
        seen.radiance += seen.radiance_medium;
        seen.se_radiance = shares
            .iter()
            .zip(&contrasts)
            .map(|(share, [p, m])| {
                // By closure the walls carry minus the errors of the others; the covariance follows from their sum's.
                let [sp, sw, sm] = share.se.map(|s| s * s);
                (p * p * sp + m * m * sm + p * m * (sw - sp - sm)).max(0.0).sqrt()
            })
            .sum();
        seen
    }
}

/// The walls of a chamber one by one, and the wall opposite the plate. Into the samples go what the plate shines with what
/// it mirrors, and the walls' mean.
fn ends(
    scene: &Scene,
    source: &ChamberSource,
    band: &Band,
    samples: &mut [Sample],
) -> (Vec<EndSample>, usize) {
    let chamber = &source.chamber;
    let plate = scene.plate.as_ref().and_then(|p| Plate::new(&p.shape).ok());
    let enclosure = Enclosure::new(chamber, plate.as_ref());
    let middle = [0, 1, 2].map(|a: usize| 0.5 * (chamber.lower_m()[a] + chamber.upper_m()[a]));
    let opposite = plate.as_ref().map_or(0, |p| chamber.end(middle, p.facing()));
    let emissivity = source.walls.map(|w| w.emissivity);
    let windowed = scene.windows.far.is_some();
    let laboratory = scene.plate.as_ref().is_some_and(|p| p.mirrors == Some(PlateMirrors::Laboratory));
    let mut lights: Vec<EndSample> = samples
        .iter_mut()
        .zip(&band.wavelengths_um)
        .map(|(sample, &um)| {
            let mut sources = [0.0; SOURCES];
            for (to, wall) in sources.iter_mut().zip(&source.walls) {
                *to = photon_radiance(um, wall.temperature_k);
            }
            sources[BEYOND] = photon_radiance(um, source.outside_k);
            // Through a far window the chamber sees the plate, the glass, and itself.
            let far = sample.far;
            // A plate that mirrors the laboratory looks black to the walls: what it mirrors is its own light.
            let absorbs = match (windowed, laboratory) {
                (true, _) => (1.0 - far.reflectance).max(f64::MIN_POSITIVE),
                (false, true) => 1.0,
                (false, false) => sample.emissivity,
            };
            sources[PLATE] = if windowed {
                (far.transmittance * sample.radiance[0] + far.absorptance * sample.radiance[4]) / absorbs
            } else if laboratory {
                sample.radiance[0]
            } else {
                let kelvin = scene.plate.as_ref().and_then(|p| p.temperature_k);
                kelvin.map_or(0.0, |t| photon_radiance(um, t))
            };
            let (radiance, lit_plate) = enclosure.radiosity(&emissivity, absorbs).lit(&sources);
            if !windowed {
                sample.radiance[0] = lit_plate;
            }
            let first = radiance[0];
            sample.radiance[1] =
                first + radiance[..SIDES].iter().map(|r| r - first).sum::<f64>() / SIDES as f64;
            let share = radiance
                .map(|r| if scene.band.is_some() && r > 0.0 { sample.weight * r } else { sample.weight });
            EndSample { radiance, share }
        })
        .collect();
    for end in 0..ENDS {
        let sum: f64 = lights.iter().map(|l| l.share[end]).sum();
        lights.iter_mut().for_each(|l| l.share[end] /= sum);
    }
    (lights, opposite)
}

/// What comes back from the far window besides the plate and its own light, and how much everything grows by the light
/// that goes to and fro between the windows.
struct Back {
    walls: f64,
    medium: f64,
    emission: f64,
    opening: f64,
    again: f64,
    se: f64,
}

impl Back {
    fn of(share: &Share, far: &PlateOptics, near: &PlateOptics) -> Self {
        match share.mirrored {
            None => Self { walls: 1.0, medium: 0.0, emission: 0.0, opening: 0.0, again: 1.0, se: 0.0 },
            Some(Mirrored { opening, medium, emission, se }) => {
                let round = share.plate * opening * far.reflectance * near.reflectance;
                let walls = (1.0 - opening - medium).max(0.0);
                // Of two perfect mirrors with nothing between them nothing is seen.
                let again = if round < 1.0 { 1.0 / (1.0 - round) } else { 0.0 };
                Self { walls, medium, emission, opening, again, se }
            }
        }
    }
}

impl Sample {
    /// By how much the light of an uneven plate exceeds that of an even one, times the plate's share; per µm.
    fn excess(&self, share: &Share, plate_k: Option<f64>) -> f64 {
        let Some(even_k) = plate_k else { return 0.0 };
        let mean = share.excess[0] / share.plate;
        let variance = (share.excess[1] / share.plate - mean * mean).max(0.0);
        let kelvin = (even_k + mean).max(0.0);
        let plain = photon_radiance(self.um, kelvin) - photon_radiance(self.um, even_k);
        // B'' from differences of B' 1 K apart: of a small correction.
        let slope = |t: f64| if t > 0.0 { d_photon_radiance_dt(self.um, t) } else { 0.0 };
        let bend = slope(kelvin + 0.5) - slope((kelvin - 0.5).max(0.0));
        share.plate * self.emissivity * (plain + 0.5 * variance * bend)
    }
}

/// How the medium shines, and the temperature with which its coefficient is weighted over the band.
fn glow(scene: &Scene) -> (Glow, Option<f64>) {
    match &scene.medium {
        Some(MediumSource::Shape(_, t)) => (Glow::Temperature(t.unwrap_or(0.0)), *t),
        Some(MediumSource::Grid(grid, hot)) => {
            let mean = scene
                .band
                .as_ref()
                .filter(|_| *hot)
                .and_then(|b| mean_radiance(grid, 0, |r| b.nodes().inverse(r)));
            (Glow::BandChannel, mean)
        }
        Some(MediumSource::Spectral(grid, band)) => {
            // The group that emits most: its mean temperature stands for the medium.
            let sum = |g: usize| -> f64 {
                (0..grid.occupied()).map(|c| grid.emission[(2 * c + 1) * grid.groups + g]).sum()
            };
            let brightest = (0..grid.groups).max_by(|&a, &b| sum(a).total_cmp(&sum(b))).unwrap_or(0);
            let um = band.wavelengths_um[brightest];
            (Glow::GroupChannel, mean_radiance(grid, brightest, |r| inverse_photon_radiance(um, r)))
        }
        Some(MediumSource::Cfd(_) | MediumSource::Parametric(_)) | None => (Glow::Temperature(0.0), None),
    }
}

/// The temperature of a medium's mean radiance, weighted with what it absorbs.
fn mean_radiance(grid: &GridMedium, group: usize, inverse: impl Fn(f64) -> Option<f64>) -> Option<f64> {
    let sum = |channel: usize| -> f64 {
        (0..grid.occupied())
            .map(|cell| grid.emission[(cell * grid.channels + channel) * grid.groups + group])
            .sum()
    };
    inverse(sum(1) / sum(0))
}

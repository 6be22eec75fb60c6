//! What lies between the plate and the electrons but the medium: windows, walls, lens, band.
//!
//! Along a sight: plate — far window — chamber with medium — near window — lens — pixel. Knows nothing of images,
//! noise, time or triggers.

use super::RigError;
use super::config::DetectorConfig;
use crate::light::band::Band;
use crate::light::planck::{d_photon_radiance_dt, photon_radiance};
use crate::light::window;

/// Spectral samples of a band: signal = Σ weight · photon radiance.
#[derive(Debug, Clone, PartialEq)]
pub struct Spectrum {
    /// Wavelength of each group, in µm.
    pub wavelengths_um: Vec<f64>,
    /// Response (filter, lens, quantum efficiency) times width of each group, in µm.
    pub weights: Vec<f64>,
}

impl From<&Band> for Spectrum {
    fn from(band: &Band) -> Self {
        Self { wavelengths_um: band.wavelengths_um.clone(), weights: band.weights.clone() }
    }
}

/// One window at the wavelengths of the band. Transmittance + reflectance + absorptance = 1 in every group.
#[derive(Debug, Clone, PartialEq)]
pub struct WindowSpectrum {
    /// Transmittance, `[group]`.
    pub transmittance: Vec<f64>,
    /// Reflectance, `[group]`.
    pub reflectance: Vec<f64>,
    /// Absorptance (= emissivity), `[group]`.
    pub absorptance: Vec<f64>,
    /// Temperature, in kelvin.
    pub temperature_k: f64,
}

/// The chamber around the medium.
#[derive(Debug, Clone, PartialEq)]
pub struct Enclosure {
    /// Window on the camera's side.
    pub near: WindowSpectrum,
    /// Window on the plate's side.
    pub far: WindowSpectrum,
    /// Temperature of gas and left-over vapour, in kelvin.
    pub gas_temperature_k: f64,
    /// Temperature of the walls, in kelvin.
    pub wall_temperature_k: f64,
    /// Emissivity of the walls.
    pub wall_emissivity: f64,
    /// Part of the inner surface that is the far window.
    pub window_fraction: f64,
}

/// Everything between the plate and the electrons but the medium.
#[derive(Debug, Clone)]
pub struct Optics {
    spectrum: Spectrum,
    /// Electrons per second for one photon s⁻¹ m⁻² sr⁻¹ µm⁻¹ at the lens, `[group]`.
    sensitivity: Vec<f64>,
    plate_emissivity: Vec<f64>,
    lab_temperature_k: f64,
    enclosure: Option<Enclosure>,
    electrons_per_count: f64,
}

/// What the plate is made of and what it mirrors.
#[derive(Debug, Clone, PartialEq)]
pub struct PlateSurfaceSpectrum {
    /// Emissivity, `[group]`.
    pub emissivity: Vec<f64>,
    /// Temperature of the laboratory, in kelvin.
    pub lab_temperature_k: f64,
}

impl WindowSpectrum {
    /// A window at the wavelengths of a band.
    pub fn of(window: &window::Plate, band: &Band, temperature_k: f64) -> Self {
        let optics = || band.wavelengths_um.iter().map(|&um| window.optics(um, temperature_k));
        Self {
            transmittance: optics().map(|o| o.transmittance).collect(),
            reflectance: optics().map(|o| o.reflectance).collect(),
            absorptance: optics().map(|o| o.absorptance).collect(),
            temperature_k,
        }
    }

    /// An opening: all light passes.
    pub fn opening(band: &Band) -> Self {
        let groups = band.len();
        Self {
            transmittance: vec![1.0; groups],
            reflectance: vec![0.0; groups],
            absorptance: vec![0.0; groups],
            // Nothing of it is seen; any temperature will do.
            temperature_k: 300.0,
        }
    }
}

impl Optics {
    /// A camera that looks through a chamber.
    ///
    /// # Errors
    /// [`RigError::Shape`] when a table does not have one entry per group.
    pub fn chamber(
        spectrum: Spectrum,
        plate: PlateSurfaceSpectrum,
        enclosure: Enclosure,
        detector: &DetectorConfig,
    ) -> Result<Self, RigError> {
        let groups = spectrum.wavelengths_um.len();
        for window in [&enclosure.near, &enclosure.far] {
            for table in [&window.transmittance, &window.reflectance, &window.absorptance] {
                same("groups of a window", table.len(), groups)?;
            }
        }
        Ok(Self { enclosure: Some(enclosure), ..Self::bench(spectrum, plate, detector)? })
    }

    /// A camera that looks straight at the plate.
    ///
    /// # Errors
    /// [`RigError::Shape`] when a table does not have one entry per group.
    pub fn bench(
        spectrum: Spectrum,
        plate: PlateSurfaceSpectrum,
        detector: &DetectorConfig,
    ) -> Result<Self, RigError> {
        let groups = spectrum.wavelengths_um.len();
        same("weights of the band", spectrum.weights.len(), groups)?;
        same("emissivities of the plate", plate.emissivity.len(), groups)?;
        // Camera equation for a distant object: projected solid angle π / (4N² + 1).
        let solid_angle = std::f64::consts::PI / (4.0 * detector.f_number * detector.f_number + 1.0);
        let throughput =
            solid_angle * detector.pixel_pitch_m * detector.pixel_pitch_m * detector.response_factor;
        Ok(Self {
            sensitivity: spectrum.weights.iter().map(|w| w * throughput).collect(),
            spectrum,
            plate_emissivity: plate.emissivity,
            lab_temperature_k: plate.lab_temperature_k,
            enclosure: None,
            electrons_per_count: detector.electrons_per_count,
        })
    }

    /// Number of spectral groups.
    pub fn groups(&self) -> usize {
        self.sensitivity.len()
    }

    /// The chamber; `None` on a bench.
    pub fn enclosure(&self) -> Option<&Enclosure> {
        self.enclosure.as_ref()
    }

    /// Electrons that make one count.
    pub fn electrons_per_count(&self) -> f64 {
        self.electrons_per_count
    }

    /// Electrons per second of a pixel filled by a black body at `temperature_k`, without windows.
    pub fn black_body_electrons_per_s(&self, temperature_k: f64) -> f64 {
        self.sum(|g| self.black(g, temperature_k))
    }

    /// The exact calibration curve I_cal(T) = ε_B·I_BB(T) in counts: what the plate itself emits into a pixel,
    /// without windows, mirrored laboratory or offset, in `integration_s`.
    pub fn calibration_counts(&self, plate_k: f64, integration_s: f64) -> f64 {
        self.sum(|g| self.plate_emissivity[g] * self.black(g, plate_k)) * integration_s
            / self.electrons_per_count
    }

    /// Counts of the plate on the bench (with the laboratory that it mirrors), without offset.
    pub fn bench_counts(&self, plate_k: f64, integration_s: f64) -> f64 {
        self.sum(|g| self.plate(g, plate_k)) * integration_s / self.electrons_per_count
    }

    /// What reaches the medium from the plate's side besides the plate's own emission, in counts before the near
    /// window: E_f (the far window's own emission and the walls that it mirrors) and, through the far window, the
    /// laboratory that the plate mirrors. With it I_cal(T_eff) = ε_B·(S + this) holds exactly for a gray band.
    /// On a bench only the mirrored laboratory is left.
    pub fn far_window_counts(&self, integration_s: f64) -> f64 {
        let mirrored = |g: usize| {
            let through = self.enclosure.as_ref().map_or(1.0, |e| e.far.transmittance[g]);
            through * (1.0 - self.plate_emissivity[g]) * self.black(g, self.lab_temperature_k)
        };
        self.sum(|g| self.far_addition(g) + mirrored(g)) * integration_s / self.electrons_per_count
    }

    /// Transmittances (far, near) of the windows for black-body light of `temperature_k`; ones on a bench.
    pub fn window_transmittances(&self, temperature_k: f64) -> (f64, f64) {
        let Some(enclosure) = &self.enclosure else { return (1.0, 1.0) };
        let all = self.black_body_electrons_per_s(temperature_k);
        let through = |window: &WindowSpectrum| {
            self.sum(|g| window.transmittance[g] * self.black(g, temperature_k)) / all
        };
        (through(&enclosure.far), through(&enclosure.near))
    }

    /// Black-body light of group `g` at `temperature_k`, in photons s⁻¹ m⁻² sr⁻¹ µm⁻¹.
    pub(super) fn black(&self, g: usize, temperature_k: f64) -> f64 {
        photon_radiance(self.spectrum.wavelengths_um[g], temperature_k)
    }

    /// Electrons per second for unit radiance before the near window, in group `g`.
    pub(super) fn inside_sensitivity(&self, g: usize) -> f64 {
        self.sensitivity[g] * self.enclosure.as_ref().map_or(1.0, |e| e.near.transmittance[g])
    }

    fn sum(&self, radiance: impl Fn(usize) -> f64) -> f64 {
        (0..self.groups()).map(|g| self.sensitivity[g] * radiance(g)).sum()
    }

    fn plate(&self, g: usize, plate_k: f64) -> f64 {
        let emissivity = self.plate_emissivity[g];
        emissivity * self.black(g, plate_k) + (1.0 - emissivity) * self.black(g, self.lab_temperature_k)
    }

    fn far_addition(&self, g: usize) -> f64 {
        self.enclosure.as_ref().map_or(0.0, |e| {
            e.far.reflectance[g] * self.black(g, e.wall_temperature_k)
                + e.far.absorptance[g] * self.black(g, e.far.temperature_k)
        })
    }

    /// Radiances of group `g` inside the chamber for a plate at `plate_k`.
    pub(super) fn sources(&self, g: usize, plate_k: f64) -> Sources {
        let um = self.spectrum.wavelengths_um[g];
        let slope_of = |gamma: f64| gamma * self.plate_emissivity[g] * d_photon_radiance_dt(um, plate_k);
        let Some(e) = &self.enclosure else {
            return Sources {
                far: self.plate(g, plate_k),
                far_slope: slope_of(1.0),
                walls: self.black(g, self.lab_temperature_k),
                walls_per_far: 0.0,
                gas: 0.0,
                camera_side: 0.0,
                inside: self.sensitivity[g],
                outside: self.sensitivity[g],
            };
        };
        let gamma = e.far.transmittance[g];
        let far = gamma * self.plate(g, plate_k) + self.far_addition(g);
        // Radiosity of gray diffuse walls that see themselves and the far window.
        let mirrored = 1.0 - e.wall_emissivity;
        let loss = 1.0 - mirrored * (1.0 - e.window_fraction);
        let walls_per_far = mirrored * e.window_fraction / loss;
        Sources {
            far,
            far_slope: slope_of(gamma),
            walls: (1.0 - walls_per_far) * self.black(g, e.wall_temperature_k) + walls_per_far * far,
            walls_per_far,
            gas: self.black(g, e.gas_temperature_k),
            camera_side: e.near.reflectance[g] * self.black(g, self.lab_temperature_k)
                + e.near.absorptance[g] * self.black(g, e.near.temperature_k),
            inside: self.inside_sensitivity(g),
            outside: self.sensitivity[g],
        }
    }
}

/// Radiances of one group in photons s⁻¹ m⁻² sr⁻¹ µm⁻¹, and the sensitivity to them.
pub(super) struct Sources {
    /// Behind the medium, where the plate is seen: plate, far window and what it mirrors.
    pub(super) far: f64,
    /// Its derivative by the plate's temperature.
    pub(super) far_slope: f64,
    /// From the walls.
    pub(super) walls: f64,
    /// How much `walls` follows `far`.
    pub(super) walls_per_far: f64,
    /// A black body at the gas temperature.
    pub(super) gas: f64,
    /// From the near window: its own emission and what it mirrors.
    pub(super) camera_side: f64,
    /// Electrons per second for unit radiance inside the chamber.
    pub(super) inside: f64,
    /// Electrons per second for unit radiance at the lens.
    pub(super) outside: f64,
}

pub(super) fn same(what: &str, found: usize, expected: usize) -> Result<(), RigError> {
    if found == expected {
        Ok(())
    } else {
        Err(RigError::Shape { why: format!("{what}: {found} found, {expected} expected") })
    }
}

//! A parametric spray as a scene file describes it, with defaults of a gasoline injector. `check` knows what is allowed.
//!
//! Defaults: the Engine Combustion Network's Spray G (eight holes of 0.165 mm at 37° to the axis, 200 bar, 363 K into
//! 6 bar of nitrogen at 573 K, 10 mg in 0.78 ms) and, for the hollow cone, an outward-opening piezo injector.

use super::sizes::Correlation;
use serde::Deserialize;

/// A spray: `[medium] kind = "multi-hole"` or `"hollow-cone"`, after the type of its injector.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, bound(deserialize = "I: Default + Deserialize<'de>"))]
pub struct SpraySource<I> {
    /// Name of a shipped fuel, or the path of a fuel of the user's own (`.toml`), relative to the scene file.
    pub fuel: String,
    /// The shipped pure fuel whose vapour pressure, densities and heats are used; that of `fuel` if not given.
    pub evaporates_as: Option<String>,
    /// Time after the start of injection, s.
    #[serde(default = "time_s")]
    pub time_s: f64,
    /// Place of the injector's tip in the scene, m.
    #[serde(default)]
    pub tip_m: [f64; 3],
    /// Direction of the injector's axis; need not be a unit vector.
    #[serde(default = "axis")]
    pub axis: [f64; 3],
    /// The injector.
    #[serde(default)]
    pub injector: I,
    /// The gas that it sprays into.
    #[serde(default)]
    pub gas: Gas,
    /// How plumes or sheet open.
    #[serde(default)]
    pub plume: Plume,
    /// Sizes of the droplets.
    #[serde(default)]
    pub droplets: Droplets,
    /// How shots differ from their mean.
    #[serde(default)]
    pub shots: ShotLaw,
    /// Number of the shot that the scene shows; the mean over all shots if not given.
    pub shot: Option<u64>,
    /// Chooses all random numbers of the shots.
    #[serde(default = "seed")]
    pub seed: u64,
    /// Edge of the tracer's cells, m; a sixtieth of the spray's length within 0.25 … 2 mm if not given.
    pub cell_m: Option<f64>,
    /// Half angle in degrees of the cone within which scattered light counts as unscattered; none if not given.
    pub truncate_deg: Option<f64>,
}

fn time_s() -> f64 {
    0.7e-3
}

fn axis() -> [f64; 3] {
    [0.0, 0.0, -1.0]
}

fn seed() -> u64 {
    1
}

impl<I> SpraySource<I> {
    /// The same spray with another form of its injector.
    pub fn with_injector<J>(self, form: impl FnOnce(I) -> J) -> SpraySource<J> {
        SpraySource {
            fuel: self.fuel,
            evaporates_as: self.evaporates_as,
            time_s: self.time_s,
            tip_m: self.tip_m,
            axis: self.axis,
            injector: form(self.injector),
            gas: self.gas,
            plume: self.plume,
            droplets: self.droplets,
            shots: self.shots,
            shot: self.shot,
            seed: self.seed,
            cell_m: self.cell_m,
            truncate_deg: self.truncate_deg,
        }
    }
}

/// `[medium.injector]` of a multi-hole spray.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MultiHole {
    /// Number of holes, equally spaced.
    pub holes: u32,
    /// Diameter of a hole, m.
    pub hole_diameter_m: f64,
    /// Diameter of the circle on which the holes' exits are, m.
    pub pitch_circle_m: f64,
    /// Angle between a plume and the injector's axis, degrees.
    pub angle_deg: f64,
    /// Azimuth of the first plume, right-handed about the axis, degrees; 0 is the side of +x (of +y for an axis along x).
    pub first_azimuth_deg: f64,
    /// Mass flow over that of Bernoulli through the whole hole. 0.5: Spray G's 10 mg in 0.78 ms.
    pub discharge_coefficient: f64,
    /// Exit velocity over that of Bernoulli.
    pub velocity_coefficient: f64,
    /// Rail pressure, Pa.
    pub rail_pressure_pa: f64,
    /// Temperature of the fuel, K.
    pub fuel_temperature_k: f64,
    /// Duration of the injection, s.
    pub duration_s: f64,
}

impl Default for MultiHole {
    /// Spray G.
    fn default() -> Self {
        Self {
            holes: 8,
            hole_diameter_m: 165e-6,
            pitch_circle_m: 0.79e-3,
            angle_deg: 37.0,
            first_azimuth_deg: 0.0,
            discharge_coefficient: 0.5,
            velocity_coefficient: 0.9,
            rail_pressure_pa: 200e5,
            fuel_temperature_k: 363.0,
            duration_s: 0.78e-3,
        }
    }
}

/// `[medium.injector]` of a hollow cone.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct HollowCone {
    /// Diameter of the ring that the sheet leaves from, m.
    pub pintle_diameter_m: f64,
    /// Full angle of the cone, degrees.
    pub cone_angle_deg: f64,
    /// Thickness of the sheet at the ring, m.
    pub sheet_thickness_m: f64,
    /// As of [`MultiHole`].
    pub discharge_coefficient: f64,
    /// As of [`MultiHole`].
    pub velocity_coefficient: f64,
    /// As of [`MultiHole`].
    pub rail_pressure_pa: f64,
    /// As of [`MultiHole`].
    pub fuel_temperature_k: f64,
    /// As of [`MultiHole`].
    pub duration_s: f64,
}

impl Default for HollowCone {
    /// An outward-opening piezo injector: 90°, 30 µm, 200 bar; 13 mg in 0.4 ms.
    fn default() -> Self {
        Self {
            pintle_diameter_m: 4e-3,
            cone_angle_deg: 90.0,
            sheet_thickness_m: 30e-6,
            discharge_coefficient: 0.55,
            velocity_coefficient: 0.9,
            rail_pressure_pa: 200e5,
            fuel_temperature_k: 363.0,
            duration_s: 0.4e-3,
        }
    }
}

/// `[medium.gas]`.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Gas {
    /// What it is: N2.
    pub species: String,
    /// Pressure, Pa: 0.2 to 20 bar.
    pub pressure_pa: f64,
    /// Temperature, K: 280 to 700.
    pub temperature_k: f64,
}

impl Default for Gas {
    /// Spray G.
    fn default() -> Self {
        Self { species: "N2".to_owned(), pressure_pa: 6e5, temperature_k: 573.0 }
    }
}

/// `[medium.plume]`.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Plume {
    /// Full angle by which a plume or a sheet opens, degrees; by `angle_coefficient` if not given.
    pub angle_deg: Option<f64>,
    /// c in tan(θ/2) = c [(ρ_g/ρ_l)^0.19 − 0.0043 √(ρ_l/ρ_g)] of Naber and Siebers 1996, who found 0.26 for their
    /// diesel nozzle; 0.56 gives the 20° of Spray G's plumes.
    pub angle_coefficient: f64,
}

impl Default for Plume {
    fn default() -> Self {
        Self { angle_deg: None, angle_coefficient: 0.56 }
    }
}

/// `[medium.droplets]`.
#[derive(Debug, Clone, Copy, PartialEq, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Droplets {
    /// Sauter mean diameter at the nozzle, m; of `correlation` if not given.
    pub sauter_mean_m: Option<f64>,
    /// Correlation of the Sauter mean diameter; "elkotb", for a hollow cone "lefebvre", if not given.
    pub correlation: Option<Correlation>,
    /// Exponent of Rosin–Rammler's distribution; 3 if not given (2.5–3.5 are used for Spray G).
    pub spread: Option<f64>,
}

/// `[medium.shots]`: how a shot differs from the mean. All deviations are relative to the local mean density.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ShotLaw {
    /// Standard deviation of the turbulent factor on the density, in the middle of a plume; up to four times that at
    /// its edge.
    pub turbulence: f64,
    /// Integral scale of the turbulence over the distance from the tip.
    pub integral_scale: f64,
    /// Standard deviation of each plume's mass.
    pub mass: f64,
    /// Standard deviation of each plume's direction, in each of two directions, degrees.
    pub angle_deg: f64,
}

impl Default for ShotLaw {
    /// Fluctuations of concentration in the middle of a round jet are 0.2 of the mean, and more towards the edge
    /// (Dowling and Dimotakis 1990, J. Fluid Mech. 218, 109); the integral scale is about 0.7 of the half-width
    /// radius (Pope 2000, §5.1), which is 0.08 of the distance.
    fn default() -> Self {
        Self { turbulence: 0.3, integral_scale: 0.06, mass: 0.03, angle_deg: 0.5 }
    }
}

/// The injector of a spray.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Injector {
    /// Separate plumes.
    MultiHole(MultiHole),
    /// A conical sheet.
    HollowCone(HollowCone),
}

/// What both injectors have.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Feed {
    pub(super) discharge_coefficient: f64,
    pub(super) velocity_coefficient: f64,
    pub(super) rail_pressure_pa: f64,
    pub(super) fuel_temperature_k: f64,
    pub(super) duration_s: f64,
}

impl Injector {
    /// The kind of medium that has such an injector.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::MultiHole(_) => "multi-hole",
            Self::HollowCone(_) => "hollow-cone",
        }
    }

    pub(super) fn feed(&self) -> Feed {
        let (discharge_coefficient, velocity_coefficient, rail_pressure_pa, fuel_temperature_k, duration_s) =
            match *self {
                Self::MultiHole(i) => (
                    i.discharge_coefficient,
                    i.velocity_coefficient,
                    i.rail_pressure_pa,
                    i.fuel_temperature_k,
                    i.duration_s,
                ),
                Self::HollowCone(i) => (
                    i.discharge_coefficient,
                    i.velocity_coefficient,
                    i.rail_pressure_pa,
                    i.fuel_temperature_k,
                    i.duration_s,
                ),
            };
        Feed { discharge_coefficient, velocity_coefficient, rail_pressure_pa, fuel_temperature_k, duration_s }
    }
}

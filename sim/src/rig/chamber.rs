//! What the simulated camera looks at, at one moment: the chamber with its spray, or a plate on a bench.
//!
//! A pure function of the moment (plate, vapour, injection, exposure). Keeps the images of the last two
//! plate temperatures because making them anew for every frame would be waste. Knows nothing of triggers or clocks.

use super::RigError;
use super::config::{DetectorConfig, FluctuationConfig, ResidualConfig};
use super::detector::{Detector, Exposure};
use super::fluctuation::ShotLaw;
use super::level::{Illumination, Level, level_reference_k};
use super::radiometry::Optics;
use super::sights::Sights;
use serde::{Deserialize, Serialize};
use std::sync::{Arc, Mutex, PoisonError};

/// What a world is made of.
#[derive(Debug, Clone)]
pub struct WorldParts {
    /// Windows, walls, lens and band.
    pub optics: Optics,
    /// The rendered sights.
    pub sights: Sights,
    /// The detector.
    pub detector: DetectorConfig,
    /// How injections differ; `None` = all alike.
    pub fluctuation: Option<FluctuationConfig>,
    /// What an injection leaves behind; `None` = nothing.
    pub residual: Option<ResidualConfig>,
    /// Seed of everything random in it.
    pub seed: u64,
}

/// What lies before the pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Target {
    /// The closed internal shutter.
    Shutter,
    /// The chamber without spray.
    Blank,
    /// The spray of one injection, counted from 0 over the life of the rig.
    Spray {
        /// Ordinal of the injection.
        injection: u64,
    },
}

/// One exposure and the state of the world during it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moment {
    /// What lies before the pixels.
    pub target: Target,
    /// Plate, integration time, left-over vapour.
    pub light: Illumination,
    /// Which exposure.
    pub exposure: Exposure,
}

/// The world before the camera, with the camera's detector.
#[derive(Debug)]
pub struct World {
    optics: Optics,
    sights: Sights,
    detector: Detector,
    law: Option<ShotLaw>,
    residual: Option<ResidualConfig>,
    seed: u64,
    /// The two last used: a plate that wanders across the border of two grid temperatures needs both.
    levels: Mutex<[Option<Arc<Level>>; 2]>,
}

impl World {
    /// Puts a world together.
    ///
    /// # Errors
    /// [`RigError::Shape`] when sights and band do not fit, [`RigError::Config`] for impossible numbers, or for
    /// fluctuations that were not rendered.
    pub fn new(parts: WorldParts) -> Result<Self, RigError> {
        let WorldParts { optics, sights, detector, fluctuation, residual, seed } = parts;
        if let Some(law) = &fluctuation {
            law.validate()?;
            if law.sigma_temperature_k > 0.0 && !sights.has_temperature_offsets() {
                let why = "the operators have no temperature offsets (channels 2 and 3)".to_owned();
                return Err(RigError::Config { key: "rig.fluctuation.sigma_temperature_k".to_owned(), why });
            }
        }
        // Provokes the check of groups once, so that later levels cannot fail.
        Level::near(&sights, &optics, 300.0)?;
        Ok(Self {
            detector: Detector::new(detector, seed, sights.rows(), sights.columns())?,
            law: fluctuation.map(|law| ShotLaw::new(law, seed, sights.columns())),
            optics,
            sights,
            residual,
            seed,
            levels: Mutex::new([None, None]),
        })
    }

    /// Windows, walls, lens and band.
    pub fn optics(&self) -> &Optics {
        &self.optics
    }

    /// The rendered sights.
    pub fn sights(&self) -> &Sights {
        &self.sights
    }

    /// The detector.
    pub fn detector(&self) -> &Detector {
        &self.detector
    }

    /// How injections differ.
    pub fn law(&self) -> Option<&ShotLaw> {
        self.law.as_ref()
    }

    /// What an injection leaves behind.
    pub fn residual(&self) -> Option<ResidualConfig> {
        self.residual
    }

    /// Seed of everything random in it.
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// Expected electrons, `[row, column]`.
    pub fn expected_electrons(&self, moment: &Moment) -> Vec<f32> {
        let mut electrons = vec![0.0_f32; self.sights.rows() * self.sights.columns()];
        let light = moment.light;
        match moment.target {
            Target::Shutter => {
                // A camera without a shutter never asks; the plate's temperature stands in.
                let shutter_k = self.detector.config().shutter_temperature_k.unwrap_or(light.plate_k);
                let level = self.optics.black_body_electrons_per_s(shutter_k) * light.integration_s;
                #[expect(clippy::cast_possible_truncation, reason = "images are f32")]
                electrons.fill(level as f32);
            }
            Target::Blank => self.level(light.plate_k).expect_blank(&self.sights, light, &mut electrons),
            Target::Spray { injection } => {
                let shot = self.law.as_ref().map(|law| law.shot(injection));
                self.level(light.plate_k).expect_spray(&self.sights, light, shot.as_ref(), &mut electrons);
            }
        }
        electrons
    }

    /// The frame of a moment: raw counts, `[row, column]`.
    pub fn expose(&self, moment: &Moment) -> Vec<u16> {
        self.detector.read(moment.exposure, &self.expected_electrons(moment))
    }

    fn level(&self, plate_k: f64) -> Arc<Level> {
        let mut kept = self.levels.lock().unwrap_or_else(PoisonError::into_inner);
        let wanted = level_reference_k(plate_k).to_bits();
        let fits = |level: &&Arc<Level>| level.reference_k().to_bits() == wanted;
        if let Some(level) = kept.iter().flatten().find(fits).map(Arc::clone) {
            return level;
        }
        let level = Level::near(&self.sights, &self.optics, plate_k);
        let level = Arc::new(level.expect("groups were checked when the world was built"));
        kept.swap(0, 1);
        kept[0] = Some(Arc::clone(&level));
        level
    }
}

/// Vapour that injections have left in the chamber.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct ResidualVapour {
    /// Optical depth at `at_ns`, where the spray is opaque.
    depth: f64,
    /// Time of the last injection, in nanoseconds since the rig's start.
    at_ns: u64,
}

impl ResidualVapour {
    /// Optical depth at `now_ns`, not before the last injection.
    pub fn depth_at(&self, law: ResidualConfig, now_ns: u64) -> f64 {
        let age_s = now_ns.saturating_sub(self.at_ns) as f64 * 1e-9;
        self.depth * libm::exp(-age_s / law.decay_s)
    }

    /// Adds what an injection at `now_ns` leaves behind.
    pub fn inject(&mut self, law: ResidualConfig, now_ns: u64) {
        self.depth = self.depth_at(law, now_ns) + law.optical_depth;
        self.at_ns = now_ns;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::sample;

    fn moment(target: Target, plate_k: f64) -> Moment {
        let light = Illumination { plate_k, integration_s: 25e-6, vapour_depth: 0.0 };
        Moment { target, light, exposure: Exposure { ordinal: 0, at_s: 0.0, since_pause: 9 } }
    }

    /// Everything at one temperature: plate, walls, gas, medium, windows, laboratory. Whatever absorbs emits as
    /// much; each pixel must expect the Planck sum. Bound: f32 coefficients and images, a few 2⁻²⁴.
    #[test]
    fn isothermal_enclosure_is_uniform() {
        for wall_emissivity in [1.0, 0.6] {
            let world = sample::world(&sample::Choices {
                medium_k: 450.0,
                surroundings_k: 450.0,
                lab_k: 450.0,
                wall_emissivity,
                fluctuation: Some(sample::LAW_WITHOUT_SHIFT),
                ..sample::Choices::usual()
            });
            let expected = world.optics().black_body_electrons_per_s(450.0) * 25e-6;
            for target in [Target::Blank, Target::Spray { injection: 0 }, Target::Spray { injection: 7 }] {
                for vapour_depth in [0.0, 0.7] {
                    let mut at = moment(target, 450.0);
                    at.light.vapour_depth = vapour_depth;
                    for e in world.expected_electrons(&at) {
                        assert!((f64::from(e) / expected - 1.0).abs() < 1e-6, "{target:?} {e} {expected}");
                    }
                }
            }
        }
    }

    /// The bench shows the plate's own light and the mirrored laboratory, summed over the band by hand.
    #[test]
    fn bench_view_is_the_planck_sum() {
        let world = sample::bench(4, 5);
        let by_hand = |t: f64| {
            let planck = |um: f64, t: f64| {
                2e18 * 299_792_458.0 / um.powi(4) / (14_387.768_775_039_337 / (um * t)).exp_m1()
            };
            let band = sample::band();
            let sum: f64 = (band.wavelengths_um.iter().zip(&band.weights))
                .map(|(&um, &w)| w * (0.959 * planck(um, t) + 0.041 * planck(um, 296.0)))
                .sum();
            sum * std::f64::consts::PI / 17.0 * 15e-6 * 15e-6 * 25e-6
        };
        for t in [373.0, 449.1, 533.07] {
            let expected = by_hand(t);
            for e in world.expected_electrons(&moment(Target::Blank, t)) {
                // Second-order term of the expansion around a multiple of 0.25 K.
                assert!((f64::from(e) / expected - 1.0).abs() < 2e-5, "{t} {e} {expected}");
            }
            let counts = world.optics().bench_counts(t, 25e-6);
            assert!((counts * 427.0 / expected - 1.0).abs() < 1e-12);
        }
    }

    /// A gray absorbing medium at the rendered and at any other density obeys Beer's law.
    #[test]
    fn gray_absorber_obeys_beer_at_every_density() {
        let choices = sample::Choices { albedo: 0.0, gray: true, ..sample::Choices::usual() };
        let world = sample::world(&sample::Choices {
            fluctuation: Some(FluctuationConfig { sigma_ln_tau: 0.5, ..sample::LAW_WITHOUT_SHIFT }),
            ..choices
        });
        let sights = world.sights();
        let blank = world.expected_electrons(&moment(Target::Blank, 500.0));
        let spray = world.expected_electrons(&moment(Target::Spray { injection: 3 }, 500.0));
        let (mut ln_tau, mut shift) = (vec![0.0_f32; sights.columns()], vec![0.0_f32; sights.columns()]);
        let optics = world.optics();
        let emission: f64 = (0..optics.groups())
            .map(|g| optics.inside_sensitivity(g) * optics.black(g, choices.medium_k))
            .sum::<f64>()
            * 25e-6;
        let (_, near) = optics.window_transmittances(450.0);
        assert!(near < 1.0);
        for (i, &p) in sights.pixels().iter().enumerate() {
            let (row, column) = (p as usize / sights.columns(), p as usize % sights.columns());
            world.law().unwrap().shot(3).row(row, 0, &mut ln_tau, &mut shift);
            let tau = f64::from(sights.depth()[i]) * f64::from(ln_tau[column]).exp();
            let opacity = 1.0 - (-tau).exp();
            let seen = f64::from(blank[p as usize]);
            let plate_light = seen - sample::camera_side_electrons(optics) * 25e-6;
            let expected = seen + opacity * (emission - plate_light);
            let found = f64::from(spray[p as usize]);
            // Depths are rounded by 8e-4 at most; f32 electrons.
            let bound = 8e-4 * opacity * (emission - plate_light).abs() + 1e-6 * expected;
            assert!((found - expected).abs() < bound, "{i} {found} {expected}");
        }
    }

    #[test]
    fn residual_vapour_decays_and_adds_up() {
        let law = ResidualConfig { optical_depth: 0.5, decay_s: 4.0 };
        let mut vapour = ResidualVapour::default();
        assert!(vapour.depth_at(law, 1_000) <= 0.0);
        vapour.inject(law, 1_000_000_000);
        assert!((vapour.depth_at(law, 5_000_000_000) - 0.5 * (-1.0_f64).exp()).abs() < 1e-15);
        vapour.inject(law, 5_000_000_000);
        assert!((vapour.depth_at(law, 5_000_000_000) - 0.5 * (1.0 + (-1.0_f64).exp())).abs() < 1e-15);
    }

    /// A short pause biases: left-over vapour colder than the plate darkens blanks and changes the pair.
    #[test]
    fn residual_vapour_changes_blank_and_pair() {
        let world = sample::world(&sample::Choices::usual());
        let p = sample::opaque_pixel(world.sights());
        let at = |target, vapour_depth| {
            let mut moment = moment(target, 533.0);
            moment.light.vapour_depth = vapour_depth;
            world.expected_electrons(&moment)[p]
        };
        let blank = [at(Target::Blank, 0.0), at(Target::Blank, 0.2)];
        let spray = [at(Target::Spray { injection: 0 }, 0.0), at(Target::Spray { injection: 0 }, 0.2)];
        assert!(blank[1] < blank[0]);
        let pair = [spray[0] - blank[0], spray[1] - blank[1]];
        assert!((pair[1] - pair[0]).abs() > 0.02 * pair[0].abs(), "{pair:?}");
    }

    #[test]
    fn frames_have_the_same_bits_for_any_number_of_threads() {
        let frame = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let world = sample::world(&sample::Choices::usual());
                world.expose(&moment(Target::Spray { injection: 4 }, 449.3))
            })
        };
        assert_eq!(frame(1), frame(4));
    }

    #[test]
    fn shifts_without_rendered_offsets_are_refused() {
        let choices = sample::Choices { channels: 2, ..sample::Choices::usual() };
        let error = World::new(sample::parts(&choices)).unwrap_err().to_string();
        assert!(error.contains("sigma_temperature_k"), "{error}");
    }
}
